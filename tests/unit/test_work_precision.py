"""Work-precision: fronts are computed, errors are told apart, the whole path keeps them."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from tests.builders.studies import PAPER
from tests.readers.figures import overlaps

import gapsweep as gs
from gapsweep import pipeline
from gapsweep.analysis.bench.pareto import cheapest, corners, on_front
from gapsweep.analysis.bench.references import LARGEST_GROWTH, growth, motion
from gapsweep.analysis.bench.scenarios import scenarios
from gapsweep.analysis.bench.work_precision import find_fronts, followed, work_precision
from gapsweep.cli.main import commands
from gapsweep.report.bench_figures import tolerance_figure, work_precision_figure
from gapsweep.report.sections.benchmarks import beaten, conclusions
from gapsweep.status import Status
from gapsweep.store import netcdf

WORKFLOWS = Path(__file__).parents[2] / "workflows"
SWEEP = {"representation": ["piecewise"], "K_c": [1.4e4], "gap": [[4e-4, 4e-4]], "omega": [7.0]}
SOFT = {"name": "soft", "K_c": 1.4e4, "gap": [4e-4, 4e-4], "omega": 9.0}
METHODS = [
    {"label": "piecewise", "rtol": [1e-2, 1e-5, 1e-9]},
    {"label": "piecewise-noevents", "rtol": [1e-2, 1e-5, 1e-9]},
    {"label": "tanh-1e4", "rtol": [1e-5, 1e-9]},
    {"label": "piecewise@scipy", "rtol": [1e-4]},
]
QUICK = {"horizon": 4, "repeats": 2, "lanes": 4}


def tables_of(*given_scenes, methods=METHODS, **more):
    bench = QUICK | {"scene": list(given_scenes), "method": methods}
    whole = {"study": {"name": "bench"}, "oscillator": PAPER, "sweep": [SWEEP], "bench": bench}
    return whole | {"protocol": {"scipy": {"engine": "scipy"}}} | more


def study_of(*given_scenes, **more):
    return gs.Study.from_dict(tables_of(*given_scenes, **more))


@pytest.fixture(scope="module")
def measured():
    return work_precision(study_of(SOFT))


# ---- The front --------------------

# Few values, so that ties and equal points are common.
QUANTITY = st.sampled_from([1.0, 2.0, 3.0, 4.0, 5.0, np.nan])


def beats(a, b):
    return a[0] <= b[0] and a[1] <= b[1] and a != b


@given(st.lists(st.tuples(QUANTITY, QUANTITY), max_size=12))
def test_front_is_what_nothing_beats(points):
    error, cost = np.reshape(points, (-1, 2)).T
    whole = [p for p in points if np.isfinite(p).all()]
    wanted = [np.isfinite(p).all() and not any(beats(q, p) for q in whole) for p in points]
    assert on_front(error, cost).tolist() == wanted


def test_front_in_the_file_is_that_of_its_errors_and_costs(measured):
    one = measured.isel(scene=0)
    usable = (one["status"] == Status.OK).values & np.isfinite(one["cpu_time"].values)
    points = [
        (float(one["bounded_error"].values[i]), float(one["cpu_time"].values[i]), i)
        for i in zip(*np.nonzero(usable), strict=True)
    ]
    for *p, i in points:
        unbeaten = not any(beats(tuple(q), tuple(p)) for *q, _ in points)
        assert one["on_front"].values[i] == (unbeaten and not one["at_reference_floor"].values[i])
    assert one["on_front"].values.sum() >= 1


def test_front_is_that_of_the_error_against_the_exact_law():
    arrays = {
        "status": np.array([[[0, 0], [0, Status.DIVERGED]]]),
        "bounded_error": np.array([[[1e-2, 1e-5], [1e-1, 1e-9]]]),
        "trajectory_error": np.array([[[1e-2, 1e-5], [1e-8, 1e-9]]]),
        "at_reference_floor": np.array([[[0, 1], [0, 0]]]),
        "cpu_time": np.array([[[1.0, 2.0], [3.0, 0.5]]]),
        "on_front": np.zeros((1, 2, 2), dtype="i1"),
    }
    find_fronts(arrays)
    # The second beats the last two, though it is too close to the truth to be shown itself.
    assert arrays["on_front"].tolist() == [[[1, 0], [0, 0]]]


def made(costs, errors):
    """Two scenes of one corner, methods a and b with two rungs."""
    dims = ("scene", "method", "tolerance")
    return xr.Dataset(
        {"cpu_time": (dims, costs), "bounded_error": (dims, errors)},
        {
            "method": ["a", "b"],
            "K_c": ("scene", [1.0, 1.0]),
            "gap": ("scene", ["0.4/0.4", "0.4/0.4"]),
        },
    )


def test_cheapest_is_the_cheapest_rung_that_meets_the_target():
    costs = np.array([[[1.0, 2.0], [3.0, 4.0]], [[1.0, 8.0], [3.0, 4.0]]])
    errors = np.array([[[1e-1, 1e-4], [1e-3, 1e-5]], [[1e-1, 1e-4], [1e-1, 1e-1]]])
    bench = made(costs, errors)
    assert_array_equal(cheapest(bench, 1e-3), [[2.0, 3.0], [8.0, np.nan]])
    [(K_c, gap, cost)] = corners(bench, 1e-3)
    assert (K_c, gap) == (1.0, "0.4/0.4")
    assert_allclose(cost, [4.0, np.nan])  # geometric; b misses the target in one scene


# ---- Errors --------------------


def test_solver_error_falls_and_model_error_stays(measured):
    one = measured.isel(scene=0)
    exact, tanh = one.sel({"method": "piecewise"}), one.sel({"method": "tanh-1e4"})
    assert_allclose(exact["model_error"], 0.0)
    assert np.all(np.diff(exact["trajectory_error"]) < 0.0)
    assert_allclose(exact["trajectory_error"], exact["total_error"])
    assert exact["trajectory_error"][-1] < 1e-7
    assert tanh["trajectory_error"][1] < 1e-6 < 1e-3 < tanh["model_error"]
    assert_allclose(tanh["total_error"][1], tanh["model_error"], rtol=1e-4)
    assert (one["reference_distance"] < 1e-9).all()


def test_contact_times_are_those_of_located_methods(measured):
    one = measured.isel(scene=0)
    located = np.isfinite(one["event_time_error"]).any("tolerance")
    assert located.values.tolist() == [True, False, False, True]
    assert float(one["event_time_error"].sel({"method": "piecewise"})[-1]) < 1e-9


def test_statistics_converge_to_the_laws_own(measured):
    one = measured.isel(scene=0)
    exact, tanh = one.sel({"method": "piecewise"}), one.sel({"method": "tanh-1e4"})
    assert float(exact["amplitude_error"][-1]) < 1e-7
    assert float(tanh["amplitude_error"][1]) < 1e-6


def test_costs_are_spread_and_counted(measured):
    asked = measured["rtol"].notnull() & xr.ones_like(measured["cpu_time"], dtype=bool)
    low, middle, high = (measured[f"cpu_time{s}"] for s in ("_q25", "", "_q75"))
    assert bool(((low <= middle) & (middle <= high) & (low > 0.0)).where(asked, True).all())
    assert bool((measured["n_steps"] > 0).where(asked, True).all())
    assert np.isnan(middle.where(~asked)).all()
    assert measured["n_lanes"].values.tolist() == [4, 4, 4, 1]


def test_horizon_ends_where_disturbances_have_grown():
    [chaotic] = scenarios(study_of(SOFT | {"K_c": 1.4e6, "omega": 2.0}), with_answer=False)
    cut = followed(chaotic)
    assert 1 <= cut.n_periods < chaotic.n_periods == 4
    law = chaotic.law("piecewise")
    grown = growth(chaotic, law, motion(chaotic, law, study_of(SOFT).solver("piecewise")).section)
    assert grown[cut.n_periods] > LARGEST_GROWTH


def test_failures_keep_their_status():
    strong = SOFT | {"oscillator": {"forcing": 100.0}}
    fits = [{"label": "poly-13", "rtol": [1e-6]}, {"label": "piecewise", "rtol": [1e-6]}]
    whole = work_precision(study_of(strong, methods=fits))
    one = whole.isel(scene=0, tolerance=0)
    assert one["status"].values.tolist() == [Status.OUT_OF_FIT_RANGE, Status.OK]
    assert np.isnan(one["total_error"][0])
    assert not one["on_front"][0]
    assert "poly-13 out of fit range 1" in " ".join(conclusions(whole).sentences)
    assert overlaps(work_precision_figure(whole)) == []


@pytest.mark.parametrize("error", [6.6339183804184736e-06, 1.7613316680736491e-09, 3e-8])
def test_axis_of_a_single_error_does_not_hang_on_its_last_digit(measured, error):
    one = measured.isel(scene=[0], tolerance=[1]).sel({"method": ["piecewise"]})
    figure = work_precision_figure(one.assign(total_error=one["total_error"] * 0.0 + error))
    low, high = figure.axes[0].get_xlim()
    assert low < error < high
    assert high > 5.0 * low
    assert overlaps(figure) == []


# ---- From study to report --------------------


def test_bench_measures_afresh_and_the_report_shows_it(tmp_path):
    path, out = tmp_path / "bench.toml", tmp_path / "out"
    path.write_text(
        f"""
        oscillator = {{ mass = 3.0, omega_n = 5.0, zeta = 0.03, forcing = 4.0, alpha = 7e8 }}
        [study]
        name = "bench"
        [[sweep]]
        representation = ["piecewise"]
        K_c = [1.4e4]
        gap = [[4e-4, 4e-4]]
        omega = [9.0]
        [bench]
        repeats = 1
        lanes = 2
        horizon = 2
        {
            "".join(
                f'''
        [[bench.scene]]
        name = "{name}"
        K_c = 1.4e4
        gap = [4e-4, 4e-4]
        omega = 9.0
        {more}
        '''
                for name, more in (("plain", ""), ("known", 'expected = "reference"'))
            )
        }
        [[bench.method]]
        label = "piecewise"
        rtol = [1e-3, 1e-6]
        """
    )
    ran = CliRunner().invoke(commands, ["bench", str(path), "--out", str(out), "--json"])
    assert ran.exit_code == 0, ran.output
    said = json.loads(ran.stdout)
    assert "scenario known" in ran.stderr
    assert said["stability.nc"]["n_silent_wrong"] == 0
    assert said["work_precision.nc"]["not_exact_on_front"] == {}
    study = gs.Study.load(path)
    created = [netcdf.attributes(out / name)["created"] for name in said if name.endswith(".nc")]
    assert len(created) == 2
    stages = pipeline.stage_reasons(study, pipeline.plan(study, tmp_path / "c"), out)
    assert {"work_precision.nc", "stability.nc"} <= set(stages)
    with netcdf.read(out / "work_precision.nc") as bench:
        assert all({"units", "long_name"} <= set(v.attrs) for v in bench.variables.values())
        assert bench.attrs["machine"]


def test_study_without_benchmark_is_refused(tmp_path):
    plain = gs.Study.from_dict({"study": {"name": "plain"}, "oscillator": PAPER, "sweep": [SWEEP]})
    with pytest.raises(gs.StudyError, match="bench: missing"):
        pipeline.bench(plain, tmp_path)


def test_figures_have_no_overlapping_texts(measured):
    for figure in (work_precision_figure(measured), tolerance_figure(measured)):
        assert overlaps(figure) == []


def test_another_law_on_the_front_is_named(measured):
    changed = measured.copy(deep=True)
    # Whatever stands on the front as measured: what ran beside it decides that too.
    front = {"piecewise": 1e-3, "piecewise-noevents": 0.02, "tanh-1e4": 1e-3}
    for method in changed["method"].values.tolist():
        changed["on_front"].loc[{"method": method}] = method in front
        changed["total_error"].loc[{"method": method}] = front.get(method, 1e-3)
    assert beaten(changed) == {"soft": ["tanh-1e4"]}
    said = " ".join(conclusions(changed).sentences)
    assert "in 0 of 1 scenarios. In soft, tanh-1e4 is on the front, too." in said


# ---- The tables --------------------


@pytest.mark.parametrize(
    ("scene", "method", "named"),
    [
        ({"expected": "guess"}, {}, "bench.scene[0].expected"),
        ({"expected": "energy"}, {}, "needs zeta = 0 and forcing = 0"),
        ({"expected": "linear"}, {}, "needs alpha = 0"),
        ({"expected": "mirror", "gap": [0.0, 8e-4]}, {}, "needs j_1 = j_2"),
        ({"oscillator": {"speed": 1.0}}, {}, "bench.scene[0].oscillator.speed"),
        ({"horizon": 0}, {}, "bench.scene[0].horizon"),
        ({"without": ["tanh-1e4"]}, {}, "without tanh-1e4: no such method"),
        ({}, {"rtol": [1e-6, 1e-3]}, "rtol must be descending"),
        ({}, {"rtol": [1.0]}, "bench.method[0].rtol[0]"),
        ({}, {"atol": [1e-6, 1e-9]}, "atol has 2 values, rtol has 1"),
        ({}, {"label": "piecewise@none"}, "protocol 'none'"),
        ({}, {"label": "sinh-3"}, "bench.method[0].label"),
    ],
)
def test_wrong_tables_are_refused(scene, method, named):
    one = {"label": "piecewise", "rtol": [1e-6]} | method
    with pytest.raises(gs.StudyError) as caught:
        study_of(SOFT | scene, methods=[one])
    assert named in "\n".join(caught.value.problems)


def test_names_are_given_once():
    with pytest.raises(gs.StudyError, match="soft, piecewise: must occur once only"):
        study_of(SOFT, SOFT, methods=[METHODS[0], METHODS[0]])


def test_scene_merges_its_oscillator_into_the_studys():
    study = study_of(SOFT | {"oscillator": {"zeta": 0.1}}, oscillator=PAPER | {"mass": 2.0})
    [scene] = scenarios(study, with_answer=False)
    assert (scene.oscillator.zeta, scene.oscillator.mass) == (0.1, 2.0)


@pytest.mark.parametrize("name", ["work_precision", "stability"])
def test_workflows_can_be_read(name):
    assert gs.Study.load(WORKFLOWS / f"{name}.toml").spec.bench is not None
