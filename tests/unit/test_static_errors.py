"""The static part: quoted figures, closed forms, invariances, refusals.

Quoted figures are those of the paper and of the notes made from it; closed forms are derived
beside the test. `test_equilibria` tests the search for equilibria.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from numpy.testing import assert_allclose
from tests.builders import strategies as own
from tests.builders.studies import PAPER

import gapsweep as gs
from gapsweep.analysis.datasets.contact_errors import expected_range
from gapsweep.analysis.datasets.static import displacements, static
from gapsweep.model.equilibria import linear_stiffness
from gapsweep.store import netcdf

RANGE = 4e-3
VERY_SOFT, SOFT, HARD = 1.4e3, 1.4e4, 1.4e6
SYMMETRIC, ASYMMETRIC = gs.Gap(0.4e-3, 0.4e-3), gs.Gap(0.0, 0.8e-3)
OSCILLATOR = gs.systems.paper_oscillator()
LABELS = [
    "piecewise",
    "piecewise-noevents",
    "poly-13",
    "poly-21",
    "ratpoly-5/3",
    "tanh-1e4",
    "tanh-1e6",
    "arctan-1e4",
    "logarctan-1e4",
    "tanh-1e4@paper",
]


def study(labels=LABELS, K_c=(VERY_SOFT, SOFT, HARD), gaps=(SYMMETRIC, ASYMMETRIC), **tables):
    sweep = {
        "representation": list(labels),
        "K_c": list(K_c),
        "gap": [[gap.j_1, gap.j_2] for gap in gaps],
        "omega": [7.0],
    }
    return gs.Study.from_dict(
        {
            "study": {"name": "static"},
            "oscillator": PAPER,
            "sweep": [sweep],
            "protocol": {"paper": {}},
        }
        | tables
    )


@pytest.fixture(scope="module")
def dataset():
    return static(study())


def at(dataset, label, K_c=SOFT, gap="0.4/0.4"):
    return dataset.sel(representation=label, K_c=K_c, gap=gap)


# --- the dataset -----------------------------------------------------------------------------


def test_protocols_are_dropped_and_labels_listed_once(dataset):
    assert dataset["representation"].values.tolist() == LABELS[:-1]


def test_every_variable_has_a_unit_and_a_name(dataset):
    for name, variable in dataset.variables.items():
        assert variable.attrs["units"], name
        assert variable.attrs["long_name"], name
    assert {"title", "study", "study_json"} <= set(dataset.attrs)


def test_file_round_trip_is_identity(dataset, tmp_path):
    netcdf.write(dataset, tmp_path / "static.nc", {})
    with netcdf.read(tmp_path / "static.nc") as written:
        xr.testing.assert_equal(written, dataset)


def test_lists_are_padded_and_counted(dataset):
    count = dataset["n_equilibria"]
    assert (dataset["equilibrium_x"].notnull().sum("equilibrium") == count).all()
    assert ((dataset["equilibrium_stable"] >= 0).sum("equilibrium") == count).all()
    assert ((dataset["equilibrium_stable"] == 1).sum("equilibrium") == dataset["n_wells"]).all()
    assert dataset["equilibrium_stable"].attrs["flag_meanings"] == "none unstable stable"


def test_unlocated_contacts_have_the_same_force(dataset):
    one, other = (dataset.sel(representation=label, drop=True) for label in LABELS[:2])
    xr.testing.assert_identical(one, other)


def test_walls_are_on_the_displacement_grid():
    gaps = SYMMETRIC, ASYMMETRIC
    for gap, x in zip(gaps, displacements(gaps, RANGE), strict=True):
        assert {-gap.j_1, 0.0, gap.j_2, -RANGE, RANGE} <= set(x.tolist())
        assert (np.diff(x) >= 0.0).all()
        assert np.sum(np.abs(x - gap.j_2) < 1e-9) > 10


def test_force_curves_do_not_grow_with_the_number_of_gaps():
    one, many = (
        displacements([gs.Gap(j, j) for j in np.linspace(1e-4, 1e-3, n)], RANGE).shape[1]
        for n in (1, 60)
    )
    assert many == one


def test_errors_are_those_of_static_error(dataset):
    for label in LABELS[:-1]:
        scene = at(dataset, label, gap="0/0.8")
        rmse, r_squared, *_ = gs.static_error(gs.contact_law(label, SOFT, ASYMMETRIC))
        assert (float(scene["rmse"]), float(scene["r_squared"])) == (rmse, r_squared)


@pytest.mark.parametrize(
    "label", ["tanh-1e9", "tanh-1e6", "arctan-1e5", "logarctan-1e7", "poly-13"]
)
@pytest.mark.parametrize("gap", [SYMMETRIC, ASYMMETRIC])
def test_static_error_is_an_integral_however_thin_the_layer(label, gap):
    law = gs.contact_law(label, SOFT, gap, K_ratio=0.3)
    steps = np.geomspace(1e-12, 2.0 * RANGE, 20_001)
    near = np.add.outer([-gap.j_1, gap.j_2], [*-steps, 0.0, *steps]).ravel()
    x = np.union1d(np.clip(near, -RANGE, RANGE), np.linspace(-RANGE, RANGE, 20_001))
    exact = gs.Piecewise(SOFT, gap, K_ratio=0.3).force(x)
    residual = np.trapezoid((law.force(x) - exact) ** 2, x)
    mean = np.trapezoid(exact, x) / (2.0 * RANGE)
    rmse, r_squared, *_ = gs.static_error(law)
    assert_allclose(rmse, math.sqrt(residual / (2.0 * RANGE)), rtol=1e-5)
    lost = residual / np.trapezoid((exact - mean) ** 2, x)
    assert_allclose(1.0 - r_squared, lost, rtol=1e-5, atol=4e-16)


def test_fit_range_of_the_study_is_used():
    wide = static(study(["poly-13"], [SOFT], [SYMMETRIC], approximation={"range": 8e-3}))
    assert float(wide["x"].max()) == 8e-3
    law = gs.contact_law("poly-13", SOFT, SYMMETRIC, 8e-3)
    assert_allclose(wide["fit_rmse"].item(), law.rmse)


# --- quoted figures --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("label", "rmse"),
    [
        ("poly-13", "0.409"),
        ("tanh-1e4", "0.044"),
        ("arctan-1e4", "0.056"),
        ("logarctan-1e4", "0.376"),
    ],
)
def test_symmetric_soft_errors(dataset, label, rmse):
    scene = at(dataset, label)
    assert f"{float(scene['rmse']):.3f}" == rmse
    assert float(scene["r_squared"]) > 0.998


def test_rational_error_is_the_quoted_one_on_the_points_of_its_fit(dataset):
    scene = at(dataset, "ratpoly-5/3")
    assert f"{float(scene['fit_rmse']):.3f}" == "0.130"
    # As an integral the two ends of the range weigh less.
    assert f"{float(scene['rmse']):.3f}" == "0.129"
    assert float(scene["r_squared"]) > 0.998


def test_asymmetric_logarctan_breaks_the_quality_rule(dataset):
    scene = at(dataset, "logarctan-1e4", gap="0/0.8")
    assert f"{float(scene['rmse']):.3f}" == "1.415"
    assert f"{float(scene['r_squared']):.4f}" == "0.9974"


@pytest.mark.parametrize(("label", "force"), [("poly-13", "1.45"), ("poly-21", "0.66")])
def test_in_gap_force_of_polynomials(dataset, label, force):
    scene = at(dataset, label)
    assert f"{float(scene['in_gap_force']):.2f}" == force


def test_force_error_is_over_the_displacements_that_the_exact_law_visits():
    labels, levels, frequencies = ["piecewise", "tanh-1e4", "poly-13"], [2.0, 8.0], [7.0, 9.0]
    axes = {"omega": frequencies, "forcing": levels, "zeta": [0.03, 0.1]}
    sweep = {"representation": labels, "K_c": [SOFT], "gap": [[0.0, 0.8e-3]]} | axes
    one = gs.Study.from_dict({"study": {"name": "s"}, "oscillator": PAPER, "sweep": [sweep]})
    ends = {"x_min": -np.linspace(1e-3, 2e-3, 24), "x_max": np.linspace(0.7e-3, 3e-3, 24)}
    dims = ("representation", "K_c", "gap", "omega", "forcing", "zeta", "initial_condition")
    shape = (3, 1, 1, 2, 2, 2, 1)
    responses = xr.Dataset(
        {name: (dims, np.reshape(values, shape)) for name, values in ends.items()},
        {"representation": labels},
    )
    found = static(one, responses)
    assert found["force_error_ratio"].dims == ("representation", "K_c", "gap", "forcing")
    for i, p in enumerate(levels):
        low = responses["x_min"][0, 0, 0, :, i].values.min()
        high = responses["x_max"][0, 0, 0, :, i].values.max()
        here = found.isel(forcing=i)
        assert (here["visited_min"].item(), here["visited_max"].item()) == (low, high)
        assert here["force_error_ratio"].sel(representation="piecewise").item() == 0.0
        for label in labels[1:]:
            law = gs.contact_law(label, SOFT, ASYMMETRIC)
            x = np.linspace(low, high, 400_001)
            error = law.force(x) - SOFT * (np.minimum(x, 0.0) + np.maximum(x - 0.8e-3, 0.0))
            rms = math.sqrt(np.trapezoid(error**2, x) / (high - low)) / p
            assert_allclose(here["force_error_ratio"].sel(representation=label), rms, rtol=1e-5)
    no_range = static(one, responses * np.nan)["force_error_ratio"]
    assert no_range.isnull().all()
    without = static(one)
    expected = [expected_range(replace(OSCILLATOR, forcing=p), gs.Piecewise(SOFT, ASYMMETRIC))
                for p in levels]  # fmt: skip
    assert_allclose(without["visited_max"].squeeze(), [high for _, high in expected])
    assert (
        without["force_error_ratio"].attrs["visited"] != found["force_error_ratio"].attrs["visited"]
    )


@pytest.mark.parametrize(
    ("label", "K_c", "frequency"),
    [
        ("poly-13", HARD, "46"),
        ("logarctan-1e4", HARD, "43"),
        ("arctan-1e4", HARD, "10"),
        ("poly-13", SOFT, "7"),
        ("logarctan-1e4", SOFT, "7"),
        ("piecewise", HARD, "5"),
    ],
)
def test_in_gap_frequencies(dataset, label, K_c, frequency):
    scene = at(dataset, label, K_c)
    assert f"{float(scene['in_gap_frequency']):.0f}" == frequency
    assert_allclose(scene["in_gap_frequency_error"], scene["in_gap_frequency"] / 5.0 - 1.0)


def test_false_wells_at_hard_contact(dataset):
    for label, where in (("tanh-1e4", "0.398"), ("poly-21", "0.246")):
        scene = at(dataset, label, HARD)
        x = scene["equilibrium_x"].values[scene["equilibrium_stable"].values == 1]
        assert [f"{1e3 * v:.3f}" for v in x] == [f"-{where}", where]
        assert np.isnan(scene["in_gap_frequency"])  # the middle of the gap is a hilltop
    tanh = at(dataset, "tanh-1e4", HARD)
    assert f"{1e3 * float(tanh['lowest_barrier']):.1f}" == "2.6"
    assert f"{float(tanh['equilibrium_frequency'][0]):.1f}" == "75.7"


def test_a_single_well_has_no_barrier(dataset):
    scene = at(dataset, "piecewise", HARD)
    assert (int(scene["n_equilibria"]), int(scene["n_wells"])) == (1, 1)
    assert np.isnan(scene["lowest_barrier"])


# --- independent of stiffness ----------------------------------------------------------------


@given(own.smooth_labels | own.fitted_labels, own.gaps, own.stiffnesses)
def test_force_is_proportional_to_stiffness_and_so_r_squared_is_not(label, gap, K_c):
    x = np.linspace(-RANGE, RANGE, 101)
    unit, law = gs.contact_law(label, 1.0, gap), gs.contact_law(label, K_c, gap)
    assert_allclose(law.force(x), K_c * unit.force(x), atol=1e-12 * K_c * RANGE)
    (rmse, r_squared, *_), (unit_rmse, unit_r_squared, *_) = map(gs.static_error, (law, unit))
    assert_allclose(rmse, K_c * unit_rmse, rtol=1e-6, atol=1e-12 * K_c * RANGE)
    assert_allclose(r_squared, unit_r_squared, atol=1e-12)


def test_r_squared_of_a_study_does_not_depend_on_stiffness(dataset):
    r_squared = dataset["r_squared"]
    assert float((r_squared - r_squared.isel(K_c=0)).max()) < 1e-12
    assert float((dataset["rmse"] / dataset["K_c"]).std("K_c").max()) < 1e-12


# --- closed forms ----------------------------------------------------------------------------


@pytest.mark.parametrize("K_c", [SOFT, HARD])
def test_offset_of_asymmetric_arctan(dataset, K_c):
    # At x = 0 the lower branch is switched half-way with no penetration; the upper one leaks.
    j, epsilon = ASYMMETRIC.j_2, 1e4
    leak = -K_c * j * (0.5 - math.atan(epsilon * j) / math.pi)
    scene = at(dataset, "arctan-1e4", K_c, "0/0.8")
    assert_allclose(scene["force_at_zero"], leak, rtol=1e-12)
    assert f"{leak:.2g}" == {SOFT: "-0.44", HARD: "-44"}[K_c]
    assert float(scene["equilibrium_x"][0]) > 1e-5  # the mean is pushed off the wall


def test_offset_of_asymmetric_logarctan(dataset):
    # Far outside, the error tends to the constant K_c (1 + ln(γ j_2))/(π γ) of its anchor.
    gamma = 1e4
    offset = SOFT * (1.0 + math.log(gamma * ASYMMETRIC.j_2)) / (math.pi * gamma)
    scene = at(dataset, "logarctan-1e4", gap="0/0.8")
    ends = scene["force_error"].isel(displacement=[0, -1])
    assert_allclose(ends.mean(), offset, rtol=0.02)
    assert f"{offset:.2f}" == "1.37"


@pytest.mark.parametrize("gap", [SYMMETRIC, ASYMMETRIC])
def test_frequency_of_the_logarctan_by_its_slope(dataset, gap):
    middle = 0.5 * (gap.j_2 - gap.j_1)
    angle = math.atan(1e4 * (middle - gap.j_2)) - math.atan(1e4 * (middle + gap.j_1))
    stiffness = linear_stiffness(OSCILLATOR) + HARD * (1.0 + angle / math.pi)
    scene = at(dataset, "logarctan-1e4", HARD, gap.label)
    expected = math.sqrt(stiffness / 3.0) / (2.0 * math.pi)
    assert_allclose(scene["in_gap_frequency"], expected, rtol=1e-9)


def test_frequency_at_zero_of_an_asymmetric_gap_is_that_of_the_wall(dataset):
    # tanh switches half the contact stiffness on at a wall, the exact law none within.
    stiffness = linear_stiffness(OSCILLATOR) + 0.5 * HARD
    scene = at(dataset, "tanh-1e6", HARD, "0/0.8")
    expected = math.sqrt(stiffness / 3.0) / (2.0 * math.pi)
    assert_allclose(scene["frequency_at_zero"], expected, rtol=1e-6)
    assert_allclose(scene["in_gap_frequency"], 5.0, rtol=1e-6)
    assert float(at(dataset, "piecewise", HARD, "0/0.8")["frequency_at_zero"]) == pytest.approx(5.0)


# --- a user's law ----------------------------------------------------------------------------


def test_code_of_a_users_law_is_not_run(tmp_path, monkeypatch):
    (tmp_path / "own_laws.py").write_text("raise SystemExit\n")
    monkeypatch.syspath_prepend(tmp_path)
    found = static(study(["piecewise", "own_laws:spring"], [SOFT], [SYMMETRIC])).squeeze()
    exact, own = (found.isel(representation=i) for i in (0, 1))
    assert (exact["refusal"].item(), int(exact["n_equilibria"])) == ("", 1)
    assert own["refusal"].item() == "user law: not evaluated"
    assert np.isnan(own["force"]).all()
    assert int(own["n_equilibria"]) == 0


def test_a_fit_that_cannot_be_made_is_refused_alone(monkeypatch):
    def no_fit(*args):
        raise gs.ModelError("pole at x = 1 mm")

    monkeypatch.setattr("gapsweep.model.laws.fitted.rational_fit", no_fit)
    found = static(study(["piecewise", "ratpoly-3/2"], [SOFT], [SYMMETRIC])).squeeze()
    assert found["refusal"].values.tolist() == ["", "pole at x = 1 mm"]


def test_thresholds_of_tanh_part_one_well_from_several(dataset):
    found = dataset["tanh_threshold"].sel(gap="0.4/0.4")
    assert np.isnan(found.sel(K_c=[VERY_SOFT, SOFT])).all()
    assert f"{float(found.sel(K_c=HARD)):.1e}" == "1.6e+05"
    wells = dataset["n_wells"].sel(K_c=HARD, gap="0.4/0.4", representation=["tanh-1e4", "tanh-1e6"])
    assert wells[0] > 1
    assert wells[1] == 1


def test_thresholds_of_tanh_are_sought_only_where_it_is_swept():
    assert "tanh_threshold" not in static(study(["piecewise", "poly-13"], [SOFT], [SYMMETRIC]))


def test_what_is_swept_of_the_oscillator_is_what_statics_are_of():
    """Every setting has the numbers of a study whose only oscillator it is."""
    swept = {"omega_n": [5.0, 20.0], "mass": [1.0, 3.0], "alpha": [1e9], "K_ratio": [0.1, 1.0]}
    sweep = {
        "representation": ["tanh-1e4", "poly-13"],
        "K_c": [HARD],
        "gap": [[0.4e-3, 0.4e-3]],
        "omega": [7.0],
        "forcing": [20.0, 40.0],
    }
    whole = static(
        gs.Study.from_dict(
            {"study": {"name": "swept"}, "oscillator": PAPER, "sweep": [sweep | swept]}
        )
    )
    assert whole["force"].dims == ("representation", "K_c", "gap", "K_ratio", "displacement")
    compared = 0
    for omega_n in swept["omega_n"]:
        for mass in swept["mass"]:
            for K_ratio in swept["K_ratio"]:
                for forcing in sweep["forcing"]:
                    one = static(
                        gs.Study.from_dict(
                            {
                                "study": {"name": "one"},
                                "oscillator": {
                                    "zeta": 0.03,
                                    "omega_n": omega_n,
                                    "mass": mass,
                                    "alpha": 1e9,
                                    "forcing": forcing,
                                },
                                "sweep": [
                                    {k: v for k, v in sweep.items() if k != "forcing"}
                                    | {"K_ratio": [K_ratio]}
                                ],
                            }
                        )
                    )
                    at = {"omega_n": omega_n, "mass": mass, "alpha": 1e9, "forcing": forcing}
                    here = whole.sel(at | {"K_ratio": [K_ratio]})
                    n = one.sizes["equilibrium"]
                    for name in {*one.data_vars} - {"forcing"}:
                        ours = here[name].isel(equilibrium=slice(n), missing_dims="ignore")
                        np.testing.assert_array_equal(ours.values, one[name].values, err_msg=name)
                        compared += 1
    assert compared > 16 * 20
    wells = whole["n_wells"].sel(representation="tanh-1e4", mass=3.0, K_ratio=1.0)
    assert wells.sel(omega_n=5.0).item() < wells.sel(omega_n=20.0).item()
