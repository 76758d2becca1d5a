"""Numbers of a study that are probably in another unit."""

import numpy as np
import pytest

import gapsweep as gs
from gapsweep.analysis.unit_check import default_spring, doubtful_numbers

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


@pytest.mark.parametrize(
    ("oscillator", "n"),
    [({}, 0), ({"zeta": 0.1}, 0), ({"mass": 2.0}, 1), ({"omega_n": 8.0, "alpha": 7e8}, 0)],
)
def test_the_default_spring_of_another_machine_is_named(oscillator, n):
    block = {"representation": "piecewise", "K_c": 1e4, "gap": [4e-4, 4e-4], "omega": 9.0}
    tables = {"study": {"name": "s"}, "oscillator": oscillator, "sweep": [block]}
    assert sum("alpha = 7e+08" in text for text in default_spring(gs.Study.from_dict(tables))) == n
