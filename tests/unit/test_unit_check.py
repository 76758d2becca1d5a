"""Numbers of a study that are probably in another unit."""

import numpy as np
import pytest

from gapsweep.analysis.unit_check import doubtful_numbers

USUAL = {"zeta": 0.03, "omega_n": 5.0, "mass": 3.0, "omega": np.linspace(1, 30), "K_c": 1.4e3}
USUAL |= {"forcing": 4.0, "mean_load": 0.0, "wall": [4e-4, 1e-3]}


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({}, None),
        ({"zeta": np.array([0.01, 2.0])}, "zeta = 2"),
        ({"omega": np.array([1e3, 9425.0])}, "omega = 9425 Hz"),
        ({"K_c": 0.1}, "K_c = 0.1 N/m"),
        ({"K_c": 0.0}, None),
        ({"wall": [0.4, 1.0]}, "gap = 0.4 m"),  # the resonance is of 4/(2 0.03 2961) m = 23 mm
        ({"wall": [0.2, 1.0]}, None),
        ({"wall": [0.4], "zeta": 0.0}, None),  # without a bound
        ({"omega_n": 0.0, "omega": 9425.0}, None),  # no spring, so nothing to compare with
    ],
)
def test_numbers_far_from_what_machines_have_are_named(changed, named):
    found = list(doubtful_numbers(USUAL | changed))
    assert len(found) == (named is not None)
    assert all(text.startswith(named) for text in found)
