"""Ladders, thresholds and the errors of one law: closed forms and other ways to compute them."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.special import lambertw
from tests.builders.studies import PAPER
from workflows.paper import ladders as ladder

import gapsweep as gs
from gapsweep.analysis.datasets import contact_errors as thresholds
from gapsweep.analysis.datasets.contact_errors import error_of_parts, largest_in_gap
from gapsweep.model.equilibria import equilibria

RANGE = 4e-3
VERY_SOFT, SOFT, HARD = 1.4e3, 1.4e4, 1.4e6
SYMMETRIC, ASYMMETRIC = gs.Gap(0.4e-3, 0.4e-3), gs.Gap(0.0, 0.8e-3)
OSCILLATOR = gs.systems.paper_oscillator()
NO_LINEAR = "no constant or linear term"


def ladders_of(gaps, degrees, ratios):
    """The paper's ladders of some gaps, of fewer degrees: all take most of a minute."""
    sweep = {
        "representation": ["piecewise"],
        "K_c": [VERY_SOFT, SOFT, HARD],
        "gap": [[gap.j_1, gap.j_2] for gap in gaps],
        "omega": [7.0],
    }
    study = {"study": {"name": "rungs"}, "oscillator": PAPER, "sweep": [sweep]}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ladder, "DEGREES", degrees)
        patch.setattr(ladder, "RATIOS", ratios)
        return ladder.ladders(gs.Study.from_dict(study))


@pytest.fixture(scope="module")
def rungs():
    return ladders_of((SYMMETRIC, ASYMMETRIC), ladder.DEGREES, ("3/2", "5/3"))


@pytest.mark.extended
def test_in_gap_force_of_a_high_degree_at_hard_contact(rungs):
    rung = rungs["poly_in_gap_force"].sel(gap="0.4/0.4", constraint="none", degree=45)
    assert f"{HARD * float(rung):.0f}" == "39"


@pytest.mark.extended
def test_best_rational_fit_of_low_degree_is_odd(rungs):
    rung = rungs.sel(gap="0.4/0.4", ratio="3/2")
    law = gs.contact_law("ratpoly-3/2", SOFT, SYMMETRIC)
    assert abs(float(law.force(0.0))) < SOFT * 1e-12
    assert f"{law.rmse:.3f}" == "0.232"
    assert f"{SOFT * float(rung['ratpoly_in_gap_force']):.2f}" == "0.79"
    better = rungs.sel(gap="0.4/0.4", ratio="5/3")
    assert f"{SOFT * float(better['ratpoly_in_gap_force']):.2f}" == "0.65"


def test_depth_of_the_tanh_lobe():
    # z(1 - tanh z)/2 is stationary where z(1 + tanh z) = 1, which 2z - 1 = W(1/e) solves.
    assert_allclose(thresholds.TANH_LOBE, lambertw(1.0 / math.e).real / 2.0, rtol=1e-10)


@pytest.mark.parametrize("epsilon", [1e5, 1e7, 1e9])
def test_in_gap_force_of_tanh_is_its_lobe(epsilon):
    force = largest_in_gap(gs.Tanh(HARD, SYMMETRIC, epsilon), RANGE)
    assert_allclose(force, thresholds.TANH_LOBE * HARD / epsilon, rtol=1e-9)


@pytest.mark.parametrize("epsilon", [1e5, 1e7, 1e9])
def test_resolved_error_of_a_thin_tanh_layer(epsilon):
    # Each of four half-layers is off by K_c/ε z(1 - tanh z)/2.
    lobe, _ = quad(lambda z: (z * (1.0 - math.tanh(z)) / 2.0) ** 2, 0.0, 30.0)
    squares = 4.0 * (HARD / epsilon) ** 2 * lobe / epsilon
    law = gs.Tanh(HARD, SYMMETRIC, epsilon)
    within, rest = error_of_parts(law, RANGE)
    assert_allclose(gs.static_error(law)[0], math.sqrt(squares / (2.0 * RANGE)), rtol=1e-6)
    assert_allclose(within, math.sqrt(squares / 2.0 / SYMMETRIC.width), rtol=1e-6)
    assert_allclose(rest, math.sqrt(squares / 2.0 / (2.0 * RANGE - SYMMETRIC.width)), rtol=1e-6)


def test_parts_that_do_not_exist_have_no_error():
    law = gs.Arctan(SOFT, gs.Gap(0.0, 0.0), 1e4)
    assert np.isnan(error_of_parts(law, RANGE)[0])
    law = gs.Arctan(SOFT, gs.Gap(5e-3, 5e-3), 1e4)
    assert np.isnan(error_of_parts(law, RANGE)[1])


@pytest.mark.parametrize("gap", [SYMMETRIC, ASYMMETRIC, gs.Gap(3e-3, 3e-3)])
@pytest.mark.parametrize("degree", [3, 7])
def test_constrained_polynomials_lack_constant_and_linear_term(gap, degree):
    x = np.linspace(-RANGE, RANGE, 8001)
    exact = gs.Piecewise(1.0, gap).force(x)
    columns = np.vander(x / RANGE, degree + 1, increasing=True)[:, 2:]
    fit = columns @ np.linalg.lstsq(columns, exact, rcond=None)[0]
    law = ladder.polynomial(gap, degree, RANGE, lowest=2)
    assert_allclose(law(x), fit, atol=1e-12 * RANGE)
    errors = ladders_of([gap], (degree,), ("3/2",)).sel(constraint=NO_LINEAR).squeeze()
    assert_allclose(errors["poly_rmse"], np.sqrt(np.mean((fit - exact) ** 2)), rtol=1e-9)
    worst = np.max(np.abs(fit - exact)[exact != 0.0])
    assert_allclose(errors["poly_outside_error"], worst, rtol=1e-9)


@pytest.mark.extended
def test_more_terms_never_fit_worse_and_a_constraint_never_better(rungs):
    rmse = rungs["poly_rmse"]
    assert (rmse.diff("degree") <= 1e-15).all()
    free, constrained = (rmse.sel(constraint=name) for name in ladder.CONSTRAINTS)
    assert (constrained >= free).all()


@pytest.mark.extended
@pytest.mark.parametrize(("unit", "metre"), [("m", 1.0), ("mm", 1e3), ("4 mm", 250.0)])
def test_the_condition_grows_at_least_as_the_sizes_of_the_columns_differ(rungs, unit, metre):
    # The columns of 1 and of the leading monomial, whose mean square is range**(2 n) / (2 n + 1).
    n = rungs["degree"].astype(float)
    sizes = (RANGE * metre) ** n / np.sqrt(2.0 * n + 1.0)
    assert (rungs["poly_condition"].sel(unit=unit) > np.maximum(sizes, 1.0 / sizes)).all()


@pytest.mark.extended
def test_harder_contact_needs_a_higher_degree(rungs):
    degree = rungs["poly_smallest_degree"].sel(gap="0.4/0.4").values.tolist()
    assert degree == [5, 45, 0]


@pytest.mark.extended
def test_static_error_falls_fastest_for_tanh_and_slowest_for_logarctan(rungs):
    rmse = rungs["smooth_rmse"].sel(gap="0.4/0.4")
    tanh, arctan, logarctan = (rmse.sel(family=name) for name in ladder.TANGENTS)
    assert ((tanh < arctan) & (arctan < logarctan)).all()
    # Layers of width 1/ε with an error of order 1/ε in them: order 3/2. Log-arctan: order 1
    # within a logarithm, from its slowly decaying tails.
    decades = {"tanh": 1.5, "arctan": 1.5, "logarctan": 1.0}
    for family, order in decades.items():
        last = rmse.sel(family=family).values[-3:]
        assert_allclose(np.log10(last[0] / last[-1]), order, atol=1e-2)


@pytest.mark.parametrize("gap", [SYMMETRIC, ASYMMETRIC, gs.Gap(1.2e-3, 0.4e-3)])
def test_false_wells_of_tanh_vanish_at_the_predicted_threshold(gap):
    epsilon = thresholds.tanh_threshold(OSCILLATOR, HARD, gap, RANGE)
    assert_allclose(epsilon, thresholds.predicted_threshold(OSCILLATOR, HARD, gap), rtol=0.02)
    wells = [
        int(equilibria(OSCILLATOR, gs.Tanh(HARD, gap, factor * epsilon), RANGE).stable.sum())
        for factor in (0.999, 1.001, 10.0, 1e3)
    ]
    assert wells[0] > 1
    assert wells[1:] == [1, 1, 1]


def test_predicted_threshold_at_hard_contact():
    predicted = thresholds.predicted_threshold(OSCILLATOR, HARD, SYMMETRIC)
    assert f"{predicted:.1e}" == "1.6e+05"


@pytest.mark.parametrize("K_c", [VERY_SOFT, SOFT])
@pytest.mark.parametrize("gap", [SYMMETRIC, ASYMMETRIC])
def test_softer_contacts_have_no_false_well_at_any_sharpness(K_c, gap):
    assert np.isnan(thresholds.tanh_threshold(OSCILLATOR, K_c, gap, RANGE))
    for epsilon in np.geomspace(1e2, 1e9, 57).tolist():
        assert equilibria(OSCILLATOR, gs.Tanh(K_c, gap, epsilon), RANGE).x.size == 1


def test_without_a_distance_to_a_wall_there_is_no_threshold():
    nowhere = gs.Gap(0.0, 0.0)
    assert np.isnan(thresholds.tanh_threshold(OSCILLATOR, HARD, nowhere, RANGE))


@pytest.mark.extended
@pytest.mark.parametrize("label", ["poly-13", "ratpoly-5/3", "tanh-1e4", "logarctan-1e4"])
@pytest.mark.parametrize("gap", [SYMMETRIC, ASYMMETRIC])
def test_ladders_hold_the_errors_of_the_laws(rungs, label, gap):
    family, _, value = label.partition("-")
    select = {
        "poly": {"constraint": "none", "degree": 13},
        "ratpoly": {"ratio": value},
        "smooth": {"family": family, "parameter": 1e4},
    }
    kind = family if family in select else "smooth"
    rung = rungs.sel(gap=gap.label, **select[kind])
    law = gs.contact_law(label, HARD, gap)
    fitted = (law.rmse, law.r_squared) if kind == "poly" else None  # on the points of the fit
    rmse, r_squared = fitted or gs.static_error(law)[:2]
    assert_allclose(rung[f"{kind}_r_squared"], r_squared, rtol=1e-9)
    if kind != "smooth":
        assert_allclose(HARD * rung[f"{kind}_rmse"], rmse, rtol=1e-9)
        in_gap = largest_in_gap(law, RANGE)
        assert_allclose(HARD * rung[f"{kind}_in_gap_force"], in_gap, rtol=1e-5)


@pytest.mark.extended
def test_every_variable_has_a_unit_and_a_name(rungs):
    for name, variable in rungs.data_vars.items():
        assert variable.attrs["units"], name
        assert variable.attrs["long_name"], name


def test_a_fit_that_cannot_be_made_is_left_out(monkeypatch):
    def no_fit(*args):
        raise gs.ModelError("pole at x = 1 mm")

    monkeypatch.setattr("gapsweep.model.laws.fitted.rational_fit", no_fit)
    assert np.isnan(ladders_of([SYMMETRIC], (3,), ("3/2",))["ratpoly_rmse"]).all()
