"""Jumps along a curve, and how they are matched."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.builders.datasets import chaotic, datasets, failed, periodic, tables

from gapsweep.analysis.agreement.jumps import WINDOW, breaks, jump_shifts, jumps
from gapsweep.analysis.agreement.law_tables import law_table

OMEGA = np.round(np.arange(5.0, 9.0, 0.1), 12)
HALF_GAP = 0.4e-3


@pytest.fixture
def curve(tmp_path):
    """Slabs of two curves, given as functions of frequency to a response."""

    def slabs(exact, ours=None):
        answers = {"piecewise": exact, "tanh-1e4": ours or exact}
        study = tables(answers, OMEGA)
        files = datasets(tmp_path, study, lambda label, omega, _: answers[label](omega))
        return [law_table(*files, {"representation": r, "K_c": 0, "gap": 0}) for r in (1, 0)]

    return slabs


def folded(at, n=1):
    """A resonance that climbs to a fold, and what is left beyond it."""

    def answer(omega):
        amplitude = 1e-3 * (1.0 + 0.3 * (omega - 5.0)) if omega < at else 0.2e-3
        return periodic([[amplitude, 0.0]] * n, omega, [amplitude, -amplitude])

    return answer


def test_a_fold_is_one_jump_in_the_middle_of_its_step(curve):
    _, exact = curve(folded(7.05))
    found = jumps(exact, 0, np.arange(len(OMEGA)), HALF_GAP)
    assert_allclose(found.omega, [7.05])
    assert_allclose(OMEGA[found.at], [7.0])
    assert_allclose(found.step, [-1.4e-3])  # 1.6 mm at 7 Hz, then 0.2 mm


def test_a_steep_flank_is_no_jump(curve):
    _, exact = curve(lambda w: periodic([[1e-4 * np.exp(w - 5.0), 0.0]], w))
    assert jumps(exact, 0, np.arange(len(OMEGA)), HALF_GAP).omega.size == 0


@pytest.mark.parametrize(
    "beyond", [lambda w: chaotic([[2e-3, 0.0], [1e-3, 0.0]], w), lambda w: failed()]
)
def test_there_is_no_jump_to_a_response_that_is_not_periodic(curve, beyond):
    _, exact = curve(lambda w: periodic([[1e-3, 0.0]], w) if w < 6.95 else beyond(w))
    assert jumps(exact, 0, np.arange(len(OMEGA)), HALF_GAP).omega.size == 0


def test_shift_stands_at_the_exact_jump(curve):
    shift = jump_shifts(*curve(folded(7.05), folded(6.75)), HALF_GAP)
    assert_allclose(np.nansum(shift), -0.3)
    assert_allclose(OMEGA[np.isfinite(shift[:, 0])], [7.0])


def test_a_jump_too_far_off_is_not_matched(curve):
    shift = jump_shifts(*curve(folded(7.05), folded(7.15 + WINDOW)), HALF_GAP)
    assert np.isnan(shift).all()


def test_only_jumps_in_the_same_direction_are_matched(curve):
    def lifted(omega):
        return periodic([[0.2e-3 if omega < 7.05 else 1.6e-3, 0.0]], omega)

    shift = jump_shifts(*curve(folded(7.05), lifted), HALF_GAP)
    assert np.isnan(shift).all()


def resonance(omega):
    """A linear resonance, sampled coarsely."""
    return 1.0 / np.hypot(1.0 - omega**2, 0.06 * omega)


@pytest.mark.parametrize(
    ("values", "at"),
    [
        # The exact law of the quick study, 1 Hz apart [mm].
        ([0.904, 1.174, 0.976, 1.126, 1.353, 1.697, 0.354, 0.285, 0.235], [6]),
        ([1.0, 1.02, 1.05, 1.09, 3.0, 1.16, 1.19, 1.21], [4, 5]),  # one value on another branch
        ([1.0, 1.01, 0.3, 1.03, 0.31, 1.05, 1.06], [2, 3, 4, 5]),  # in turns
        ([1.0, 1.2, 1.5, 1.9, 2.4, 3.0], []),
        ([1.0, 1.5, 1.8, 1.9, 1.8, 1.5, 1.0], []),  # over a peak
        ([1.0, 1.01, 1.0, 1.01], []),  # what no eye sees
        ([1.0, 9.0], []),
        ([1.0], []),
        ([], []),
    ],
)
def test_a_line_is_broken_where_it_would_lead_to_another_branch(values, at):
    found = np.array(values)
    assert breaks(found).tolist() == at
    assert breaks(found[::-1]).tolist() == sorted(len(found) - i for i in at)
    assert breaks(1e-3 * found).tolist() == at


def test_a_resonance_is_one_branch():
    for step in (0.05, 0.01):
        assert breaks(resonance(np.arange(0.1, 3.0, step))).tolist() == []
