"""Jumps and changes of class along a curve, and how they are matched."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.made import chaotic, datasets, failed, periodic, tables, unresolved

from gapsweep.analysis.curves import WINDOW, changes, curve_metrics, jumps
from gapsweep.analysis.slab import slab

OMEGA = np.round(np.arange(5.0, 9.0, 0.1), 12)
HALF_GAP = 0.4e-3


@pytest.fixture
def curve(tmp_path):
    """Slabs of two curves, given as functions of frequency to a response."""

    def slabs(exact, ours=None):
        answers = {"piecewise": exact, "tanh-1e4": ours or exact}
        study = tables(answers, OMEGA)
        files = datasets(tmp_path, study, lambda label, omega, _: answers[label](omega))
        return [slab(*files, {"representation": r, "K_c": 0, "gap": 0}) for r in (1, 0)]

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
    assert found.kind.tolist() == [-1]
    assert_allclose(OMEGA[found.at], [7.0])
    assert_allclose(found.size, [1.4e-3])  # 1.6 mm at 7 Hz, then 0.2 mm


def test_a_steep_flank_is_no_jump(curve):
    _, exact = curve(lambda w: periodic([[1e-4 * np.exp(w - 5.0), 0.0]], w))
    assert jumps(exact, 0, np.arange(len(OMEGA)), HALF_GAP).omega.size == 0


def test_beside_chaos_there_is_a_change_but_no_jump(curve):
    def answer(omega):
        if omega < 6.95:
            return periodic([[1e-3, 0.0]], omega)
        return chaotic([[2e-3, 0.0], [1e-3, 0.0]], omega)

    _, exact = curve(answer)
    along = np.arange(len(OMEGA))
    assert jumps(exact, 0, along, HALF_GAP).omega.size == 0
    assert_allclose(changes(exact, 0, along).omega, [6.95])


@pytest.mark.parametrize("gone", [lambda w: failed(), lambda w: unresolved([[1e-3, 0.0]], w)])
def test_what_is_unresolved_or_failed_is_no_bifurcation(curve, gone):
    _, exact = curve(lambda w: gone(w) if abs(w - 7.0) < 0.2 else periodic([[1e-3, 0.0]], w))
    assert changes(exact, 0, np.arange(len(OMEGA))).omega.size == 0


def test_shift_stands_at_the_exact_jump(curve):
    points, curves = curve_metrics(*curve(folded(7.05), folded(6.75)), HALF_GAP)
    assert_allclose(np.nansum(points["jump_shift"]), -0.3)
    assert_allclose(OMEGA[np.isfinite(points["jump_shift"][:, 0])], [7.0])
    assert_allclose(curves["largest_jump"], [6.75])
    assert_allclose(curves["largest_jump_shift"], [-0.3])
    assert curves["n_jumps"] == [1]


def test_a_jump_too_far_off_is_counted_but_not_matched(curve):
    points, curves = curve_metrics(*curve(folded(7.05), folded(7.15 + WINDOW)), HALF_GAP)
    assert np.isnan(points["jump_shift"]).all()
    assert curves["n_jumps"] == [1]


def test_only_like_changes_are_matched(curve):
    def doubling(at, n):
        return lambda w: periodic([[1e-3, 0.0]] + [[1.01e-3, 0.0]] * (n - 1) * (w > at), w)

    points, curves = curve_metrics(*curve(doubling(7.05, 2), doubling(7.25, 2)), HALF_GAP)
    assert_allclose(np.nansum(points["change_shift"]), 0.2)
    points, curves = curve_metrics(*curve(doubling(7.05, 2), doubling(7.25, 3)), HALF_GAP)
    assert np.isnan(points["change_shift"]).all()
    assert curves["n_changes"] == [1]
