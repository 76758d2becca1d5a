"""The rule by which smooth laws are chosen: its test on drawn machines, and the page it makes."""

import math
import re

import numpy as np
import pytest
from benchmarks import rule
from matplotlib.image import imread
from numpy.testing import assert_allclose
from scipy.stats import binomtest, mannwhitneyu
from tests.unit.test_advice import rms_by_sums

import gapsweep as gs
from gapsweep.analysis.datasets.contact_errors import FORCE_ERRORS, TOO_COARSE

PAGE = rule.PAGE.read_text()


def between(name):
    (text,) = re.findall(f"<!-- {name} -->(.*?)<!-- /{name} -->", PAGE, re.DOTALL)
    return text


def test_page_has_the_limits_of_the_code_and_they_are_on_the_safe_side_of_the_fit():
    rows = re.findall(r"\| ([\d.]+) \| at (?:most|least) \*\*([\d.]+)\*\* \|", between("limits"))
    fitted, used = np.array(rows, dtype=float).T
    assert used.tolist() == [*FORCE_ERRORS.values(), TOO_COARSE]
    assert (used[:-1] <= fitted[:-1]).all()
    assert used[-1] >= fitted[-1]


def test_page_says_that_adequate_and_coarse_laws_of_other_machines_are_told_apart():
    (row,) = re.findall(r"^\| all \| (.*) \| .* \| (.*) \|$", between("parts"), re.MULTILINE)
    (use, n_use), (no, n_no) = (
        map(float, re.search(r"^(\d+)% .* of (\d+)$", text).groups()) for text in row
    )
    assert (use >= 95.0, no <= 5.0) == (True, True)
    assert min(n_use, n_no) > 100
    height, width, _ = imread(rule.PICTURE).shape
    assert width >= 640
    assert height >= 400


def attractors(*of_starts, period=1):
    x = np.array([of_starts], dtype=float)
    return x, np.full(x.shape[:2], period)


def test_attractors_of_the_exact_law_are_sought_among_those_of_the_same_period():
    """Rows: highest and lowest displacement from two starts at one frequency."""
    exact = attractors([2.0, -1.0], [3.0, -1.0])
    near = attractors([3.06, -1.0], [9.0, 9.0])
    assert_allclose(rule.errors(exact, near, 1.0, 1), [1.06 / 1.5, 0.06 / 2.0])
    assert np.isinf(rule.errors(exact, attractors([2.0, -1.0], period=2), 1.0, 1)).all()
    image = attractors([1.0, -2.0], [1.0, -3.0])
    assert_allclose(rule.errors(exact, image, 1.0, 2), [0.0, 0.0])
    assert (rule.errors(exact, image, 1.0, 1) > 0.5).all()
    twice = attractors([2.0, -1.0], [1.0, -2.0])
    assert [len(rule.errors(twice, twice, 1.0, n)) for n in (1, 2)] == [2, 1]
    chaotic = exact[0], np.array([[1, 0]])
    assert len(rule.errors(chaotic, exact, 1.0, 1)) == 1


def test_intervals_and_sorting_are_those_of_scipy():
    rng = np.random.default_rng(5)
    cases = [
        {"machine": n, "found": f, "RMS": 1 - f} for n, f in enumerate(rng.uniform(0.8, 1, 40))
    ]
    n = sum(map(rule.is_adequate, cases))
    expected = binomtest(n, 40).proportion_ci(method="wilson")
    assert_allclose(rule.wilson(cases, rule.is_adequate), [n / 40, *expected], rtol=1e-4)
    for case in cases:
        case["RMS"] += rng.normal(0.0, 0.1)
    good, bad = ([c["RMS"] for c in cases if rule.is_adequate(c) is want] for want in (True, False))
    u = mannwhitneyu(bad, good).statistic
    assert_allclose(rule.sorting(cases, "RMS"), u / len(good) / len(bad))


@pytest.mark.extended
@pytest.mark.parametrize("coupled", [False, True])
def test_a_drawn_machine_decides_both_ways(coupled, monkeypatch, tmp_path, client):
    monkeypatch.setattr(rule, "N_OMEGA", 12 if coupled else 5)
    monkeypatch.setattr(rule, "FITTED_BELOW", 0.0)
    monkeypatch.setattr(rule, "DRAWN", {"tanh": (-1.5, -0.5, 1), "arctan": (2.0, 2.8, 1)})
    machine = (11 if coupled else 0), coupled
    cases = rule.measured(machine, str(tmp_path), client)
    exact, shifted, coarse, fine = cases
    assert (exact["found"], exact["error"]) == (1.0, 0.0)
    assert shifted["found"] == 1.0
    assert rule.is_adequate(fine) > rule.is_adequate(coarse)
    assert fine["RMS"] < FORCE_ERRORS[0.95] < coarse["RMS"]
    if coupled:
        return
    tables, groups, _ = rule.drawn(*machine)
    (sweep,) = tables["sweep"]
    law = gs.contact_law(coarse["law"], sweep["K_c"], gs.Gap(*sweep["gap"]))
    oscillator = gs.Oscillator(**tables["oscillator"])
    starts = [x for x, _ in sweep["initial_condition"]]
    ends = [
        gs.respond(oscillator, law.exact, omega, x_0=x) for omega in sweep["omega"] for x in starts
    ]
    low, high = min(r.x_min for r in ends), max(r.x_max for r in ends)
    assert all(r.period_multiple > 0 for r in ends)
    p = tables["oscillator"]["forcing"]
    assert math.isclose(p * groups["K_c/p"], sweep["K_c"])
    assert_allclose(coarse["RMS"], rms_by_sums(law, low, high) / p, rtol=1e-4)
