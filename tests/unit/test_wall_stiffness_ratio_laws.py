"""Laws between walls of different stiffness, and studies that sweep the ratio."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from tests.builders import strategies as own
from tests.builders.cache import all_keys

import gapsweep as gs
from gapsweep.analysis.datasets.contact_errors import (
    expected_range,
    predicted_threshold,
    tanh_threshold,
)
from gapsweep.analysis.datasets.recommendations import advice, sentences
from gapsweep.analysis.datasets.static import static
from gapsweep.execution.layout import Layout
from gapsweep.model.equilibria import equilibria
from gapsweep.model.fit import Fit
from gapsweep.model.laws.fitted import Fitted

SOFT, HARD, RANGE = 1.4e4, 1.4e6, 4e-3
SYMMETRIC = gs.Gap(0.4e-3, 0.4e-3)
SMOOTH = ("poly-13", "ratpoly-5/3", "tanh-1e4", "arctan-1e4", "logarctan-1e4")
ratios = st.sampled_from([0.0, 0.2, 1.0, 5.0])


@given(own.gaps, own.displacements, ratios)
def test_the_exact_force_is_that_of_either_wall(gap, x, K_ratio):
    law = gs.Piecewise(SOFT, gap, K_ratio=K_ratio)
    above, below = SOFT * max(x - gap.j_2, 0.0), SOFT * K_ratio * min(x + gap.j_1, 0.0)
    assert_allclose(law.force(x), above + below, rtol=1e-15)
    slope = SOFT if x > gap.j_2 else K_ratio * SOFT if x < -gap.j_1 else 0.0
    assert law.derivative(x) == slope


@given(own.smooth_labels | own.fitted_labels, own.gaps, own.displacements, ratios)
def test_derivative_is_the_slope_of_the_force(label, gap, x, K_ratio):
    law, h = gs.contact_law(label, SOFT, gap, K_ratio=K_ratio), 1e-9
    slope = (law.force(x + h) - law.force(x - h)) / (2 * h)
    epsilon = getattr(law, "epsilon", getattr(law, "gamma", 1e4))
    tolerance = SOFT * max(K_ratio, 1.0) * (1e-4 + 2.0 * epsilon * h)
    assert_allclose(law.derivative(x), slope, atol=tolerance, rtol=1e-4)


@given(
    own.smooth_labels | st.sampled_from(["piecewise", "poly-13", "huntcrossley-0.3"]),
    own.gaps,
    own.displacements,
    st.sampled_from([0.25, 1.0, 4.0]),
)
def test_a_missing_wall_has_no_force(label, gap, x, K_ratio):
    without = gs.contact_law(label, SOFT, gap, K_ratio=0.0)
    above = gs.contact_law(label, SOFT, gs.Gap(None, gap.j_2), K_ratio=K_ratio)
    if not label.startswith("poly"):  # a fit has other points between the walls
        assert (above.force(x), above.derivative(x)) == (without.force(x), without.derivative(x))
    below = gs.contact_law(label, SOFT / K_ratio, gs.Gap(gap.j_2, None), K_ratio=K_ratio)
    assert_allclose(below.force(-x), -above.force(x), atol=1e-9 * SOFT * RANGE)


@given(
    own.smooth_labels | st.sampled_from(["piecewise", "poly-13"]),
    own.gaps,
    own.displacements,
    st.sampled_from([0.25, 1.0, 4.0]),
)
def test_walls_exchanged_mirror_the_force(label, gap, x, K_ratio):
    here = gs.contact_law(label, SOFT, gap, K_ratio=K_ratio)
    swapped = gs.Gap(gap.j_2, gap.j_1)
    there = gs.contact_law(label, K_ratio * SOFT, swapped, K_ratio=1.0 / K_ratio)
    assert_allclose(there.force(-x), -here.force(x), atol=1e-9 * SOFT * RANGE * max(K_ratio, 1.0))


@pytest.mark.parametrize("label", SMOOTH)
def test_equal_walls_are_walls_of_no_ratio(label):
    x = np.linspace(-RANGE, RANGE, 1001)
    plain, equal = (gs.contact_law(label, SOFT, SYMMETRIC, **r) for r in ({}, {"K_ratio": 1}))
    assert plain == equal
    assert equal.is_symmetric
    assert_array_equal(plain.force(x), equal.force(x))
    assert not gs.contact_law(label, SOFT, SYMMETRIC, K_ratio=0.2).is_symmetric


@pytest.mark.parametrize("family", ["tanh", "arctan", "logarctan"])
@pytest.mark.parametrize("K_ratio", [0.0, 0.2, 5.0])
def test_smooth_laws_tend_to_the_exact_one(family, K_ratio):
    laws = [gs.contact_law(f"{family}-1e{e}", SOFT, SYMMETRIC, K_ratio=K_ratio) for e in (4, 6, 8)]
    errors = [gs.static_error(law)[0] for law in laws]
    assert errors[1] < 0.1 * errors[0]
    assert errors[2] < 0.1 * errors[1] + 1e-13
    assert laws[2].exact == gs.Piecewise(SOFT, SYMMETRIC, K_ratio=K_ratio)


@pytest.mark.parametrize("label", SMOOTH[:2])
@pytest.mark.parametrize("K_ratio", [0.2, 5.0])
def test_fits_are_those_of_the_uneven_force(label, K_ratio):
    law = gs.contact_law(label, SOFT, SYMMETRIC, K_ratio=K_ratio)
    assert isinstance(law, Fitted)
    # With odd terms alone, as between equal walls, half of the lower wall's force would be lost.
    assert law.r_squared > 0.999
    assert_allclose(gs.static_error(law)[0], law.rmse, rtol=0.02)
    assert np.any(np.abs(law.coefficients[0][::2]) > 1e-3)


@pytest.mark.parametrize("K_ratio", [0.2, 5.0])
def test_a_refused_fit_says_between_which_walls(monkeypatch, K_ratio):
    with_pole = Fit((0.0, 1.0), (1.0, 2.0), rmse=1.0, r_squared=0.9)
    monkeypatch.setattr("gapsweep.model.fit.rational_candidates", lambda *_, **__: [with_pole])
    walls = f"gap 0.4/0.4 mm, K_ratio = {K_ratio:g}"
    with pytest.raises(gs.ModelError, match=f"ratpoly-1/2 for {walls}: the best fit .* pole"):
        gs.contact_law("ratpoly-1/2", SOFT, SYMMETRIC, K_ratio=K_ratio)


@pytest.mark.parametrize(("K_ratio", "rule"), [(-0.1, ">= 0"), (np.nan, "finite"), ("x", "a num")])
def test_ratios_out_of_range_are_refused(K_ratio, rule):
    with pytest.raises(gs.ModelError, match=rf"K_ratio = .*: must be {rule}"):
        gs.Piecewise(SOFT, SYMMETRIC, K_ratio=K_ratio)


def test_a_users_law_carries_the_ratio():
    law = gs.law(abs, SOFT, SYMMETRIC, K_ratio=0.2)
    assert law.exact.K_ratio == 0.2


def test_tanh_has_one_well_from_the_stiffer_wall_on():
    o, gap = gs.systems.paper_oscillator(), gs.Gap(0.3e-3, 0.4e-3)
    assert predicted_threshold(o, HARD, gap, 0.0) < predicted_threshold(o, HARD, gap, 1.0)
    for K_ratio in (0.1, 5.0):
        epsilon = tanh_threshold(o, HARD, gap, RANGE, K_ratio)
        assert_allclose(epsilon, predicted_threshold(o, HARD, gap, K_ratio), rtol=0.05)
        wells = [
            int(equilibria(o, gs.Tanh(HARD, gap, f * epsilon, K_ratio=K_ratio), RANGE).stable.sum())
            for f in (0.95, 1.05)
        ]
        assert wells[0] > wells[1] == 1


# ---------------------------------------------------------------- studies


def swept(tables, K_ratio, **changes):
    block = tables["sweep"][0] | {"K_ratio": K_ratio} | changes
    return gs.Study.from_dict(tables | {"sweep": [block]})


def test_the_ratio_is_a_dimension_behind_those_of_the_oscillator(tables):
    study = swept(tables, [0.2, 1.0], forcing=[2.0, 4.0])
    assert study.grid.dims == (
        "representation", "K_c", "gap", "omega", "forcing", "K_ratio", "initial_condition",
    )  # fmt: skip
    assert swept(tables, {"start": 0.5, "stop": 2.0, "num": 4}).grid.axes["K_ratio"] == (
        0.5, 1.0, 1.5, 2.0,
    )  # fmt: skip
    block = tables["sweep"][0]
    silent = gs.Study.from_dict(tables | {"sweep": [block, block | {"K_ratio": 2.0}]})
    assert silent.grid.axes["K_ratio"] == (1.0, 2.0)


def test_equal_walls_have_the_keys_of_studies_without_a_ratio(tables):
    tables["sweep"][0]["initial_condition"] = [[0.0, 0.0]]
    plain = set(all_keys(gs.Study.from_dict(tables)).values())
    study = swept(tables, [0.2, 1.0, 5.0], initial_condition=[[0.0, 0.0]])
    keys = all_keys(study)
    at = study.grid.dims.index("K_ratio")
    by_ratio = [{key for place, key in keys.items() if place[at] == i} for i in range(3)]
    assert by_ratio[1] == plain
    assert len(set.union(*by_ratio)) == 3 * len(plain)


def test_sweeps_of_every_ratio_are_chains_of_their_own(tables):
    alone = [swept(tables, [r], initial_condition="sweep_up") for r in (0.2, 1.0)]
    both = swept(tables, [0.2, 1.0], initial_condition="sweep_up")
    apart = set.union(*(set(all_keys(study).values()) for study in alone))
    assert set(all_keys(both).values()) == apart


def test_scenes_are_symmetric_between_equal_walls_alone(tables):
    study = swept(tables, [0.5, 1.0], gap=[[0.4e-3, 0.4e-3], [0.0, 0.8e-3]], omega=7.0)
    layout = Layout.of(study.grid, study.steady)
    found = np.concatenate([layout.is_symmetric(piece) for piece in layout.pieces()])
    assert found.sum() == len(found) // 4


def test_advice_compares_with_the_force_of_the_walls(tables):
    study = swept(tables, [0.2, 5.0], representation=["piecewise", "tanh-1e4"], omega=7.0)
    found = advice(study, 1e-3)
    error = found.force_error.sel(approximation="tanh-1e4").squeeze()
    assert error.dims == ("K_ratio",)
    # Squares of the walls' stiffnesses add up, over the length of the range.
    gap = gs.Gap(*(float(found[name].item()) for name in ("j_1", "j_2")))
    lengths = [
        np.ptp(expected_range(study.oscillator, gs.Piecewise(found["K_c"].item(), gap, K_ratio=r)))
        for r in (0.2, 5.0)
    ]
    expected = np.sqrt((1.0 + 25.0) / lengths[1] / ((1.0 + 0.04) / lengths[0]))
    assert_allclose(error.values[1] / error.values[0], expected, rtol=1e-3)
    assert [scene["K_ratio"] for scene in sentences(found)] == [0.2, 5.0]


def test_the_static_part_has_every_ratio(tables):
    tables["sweep"][0]["representation"] = ["piecewise", "poly-13", "tanh-1e4"]
    whole = static(swept(tables, [0.2, 1.0]))
    assert whole.rmse.dims == ("representation", "K_c", "gap", "K_ratio")
    assert whole.tanh_threshold.dims == ("K_c", "gap", "K_ratio")
    assert not whole.force_error.sel(representation="piecewise").values.any()
    plain = static(gs.Study.from_dict(tables))
    assert plain.rmse.dims == ("representation", "K_c", "gap")
    for name in plain.data_vars:
        mine = whole[name].sel(K_ratio=1.0) if "K_ratio" in whole[name].dims else whole[name]
        padded = mine.values[tuple(slice(n) for n in plain[name].shape)]
        assert_array_equal(padded, plain[name].values)
    law = gs.contact_law("tanh-1e4", SOFT, SYMMETRIC, K_ratio=0.2)
    curve = whole.force.sel(representation="tanh-1e4", K_ratio=0.2).squeeze()
    assert_array_equal(curve.values, law.force(curve["x"].values))
