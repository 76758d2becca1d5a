"""Branches in a study: `branches.nc` from real worker processes."""

import math
import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from tests.builders.datasets import branches as made_branches
from tests.builders.runs import started
from tests.misbehaving.calls import Deadly

import gapsweep as gs
from gapsweep import pipeline
from gapsweep.analysis.agreement.branch_agreement import compared
from gapsweep.analysis.datasets import branches_file as branches_of_study
from gapsweep.continuation.orbits import integrated
from gapsweep.execution import branch_tasks
from gapsweep.integrate.problem import Models, Solver
from gapsweep.model.labels import Representation
from gapsweep.model.own_law import OwnLaw

# The oscillator of pyvib: m = 1, c = .05, k = 1, 3 more beyond ±.1745, force .03.
ONE_RAD = 1.0 / (2.0 * math.pi)
OSCILLATOR = {"mass": 1.0, "omega_n": ONE_RAD, "zeta": 0.025, "alpha": 0.0, "forcing": 0.03}
FOLDS = 1.078508348107, 1.534979533623  # rad/s
GRAZES = 0.913376663806, 1.078537468063
STUDY = f"""
[study]
name = "folds"
[oscillator]
mass = 1.0
omega_n = {ONE_RAD!r}
zeta = 0.025
alpha = 0.0
forcing = 0.03
[[sweep]]
representation = ["piecewise", "piecewise-noevents", "tanh-1e3"]
K_c = 3.0
gap = [0.1745, 0.1745]
omega = {{ start = 0.1, stop = 0.3, num = 21 }}
initial_condition = [[0.0, 0.0], [0.35, 0.0]]
[branches]
"""


def tables(**changes):
    return {
        "study": {"name": "folds"},
        "oscillator": OSCILLATOR,
        "sweep": [
            {
                "representation": ["piecewise", "piecewise-noevents", "tanh-1e3"],
                "K_c": [3.0],
                "gap": [[0.1745, 0.1745]],
                "omega": {"start": 0.1, "stop": 0.3, "num": 21},
                "initial_condition": [[0.0, 0.0], [0.35, 0.0]],
            }
        ],
        "branches": {},
    } | changes


def run(study, client, folder):
    gs.run(study, client, out=folder / "out", cache=folder / "c").close()
    return gs.open(folder / "out" / "branches.nc")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("branches")


@pytest.fixture(scope="module")
def branches(client, folder):
    return run(gs.Study.from_dict(tables()), client, folder)


def of_law(branches, label):
    return branches.isel(branch=branches["representation"].values == label)


def special(found, kind):
    return np.sort(found["omega"].values[found["special"].values == kind]) / ONE_RAD


@pytest.mark.extended
def test_special_points_are_those_of_the_exact_law(branches):
    exact = of_law(branches, "piecewise")
    np.testing.assert_allclose(special(exact, 1), FOLDS, rtol=1e-11)
    np.testing.assert_allclose(special(exact, 5), GRAZES, rtol=1e-11)


@pytest.mark.extended
def test_folds_are_those_that_the_call_finds(branches):
    law = gs.Tanh(3.0, gs.Gap(0.1745, 0.1745), 1e3)
    called = gs.branches(gs.systems.paper_oscillator(**OSCILLATOR), law, between=(0.1, 0.3))
    ours = special(of_law(branches, "tanh-1e3"), 1)
    assert len(ours) == 2
    np.testing.assert_allclose(ours, special(called, 1), rtol=1e-9)


@pytest.mark.extended
def test_a_special_point_of_the_file_is_continued_in_a_second_parameter(branches):
    """A graze between linear orbits: force over amplitude is the spring's dynamic stiffness."""
    table = branches.gapsweep.special_points()
    assert {"representation", "K_c", "gap"} <= set(table.columns)
    point = table.index[(table["kind"] == "grazing") & (table["representation"] == "piecewise")][0]
    law = gs.contact_law("piecewise", 3.0, gs.Gap(0.1745, 0.1745))
    given = {"oscillator": gs.Oscillator(**OSCILLATOR), "law": law}
    curve = gs.special_curve(branches, int(point), "forcing", (0.02, 0.05), **given)
    rate = curve["omega"].values / ONE_RAD
    expected = 0.1745 * np.hypot(1.0 - rate**2, 0.05 * rate)
    np.testing.assert_allclose(curve["forcing"], expected, rtol=1e-8)
    assert "attractors.nc" in branches.attrs["initial_conditions"]


@pytest.mark.extended
def test_every_periodic_attractor_lies_on_a_branch_that_is_stable_there(branches, folder):
    with gs.open(folder / "out" / "attractors.nc") as attractors:
        labels = attractors["representation"] != "piecewise-noevents"
        n_orbits = int(((attractors["response_class"] == 0) & labels).sum())
    assert branches.sizes["attractor"] == n_orbits > 42, "two attractors between the folds"
    for one in range(n_orbits):
        here = branches.isel(attractor=one)
        assert here["attractor_on_branch"] >= 0
        branch = branches.sel(branch=int(here["attractor_on_branch"]))
        assert branch["representation"] == here["attractor_representation"]
        beyond = branch["omega"].values - float(here["attractor_omega"])
        passes = np.flatnonzero(beyond[:-1] * beyond[1:] <= 1e-15)  # the window ends at some
        assert (branch["stable"].values[np.concatenate([passes, passes + 1])] == 1).any()


@pytest.mark.extended
def test_attractors_of_a_loose_solver_start_no_copies(client, tmp_path):
    found = run(gs.Study.from_dict(tables(solver={"rtol": 1e-5, "atol": 1e-8})), client, tmp_path)
    assert found["representation"].values.tolist() == ["piecewise", "tanh-1e3"]


@pytest.mark.extended
def test_scenes_and_settings_stand_in_the_file(branches):
    assert branches["representation"].values.tolist() == ["piecewise", "tanh-1e3"]
    assert (branches["attractor_status"] == 0).all()
    assert branches["n_lost"].values.tolist() == [0, 0]
    assert branches["omega"].attrs["units"] == "Hz"
    assert branches.attrs["along"] == "omega"
    assert branches.attrs["rtol"] == 1e-11
    assert {"study_json", "made_from", "numerics_fingerprint", "created"} <= set(branches.attrs)


@pytest.mark.extended
def test_attractors_are_those_of_the_other_file(branches, folder):
    with gs.open(folder / "out" / "attractors.nc") as attractors:
        names = [name for name in branches.coords if str(name).startswith("attractor_")]
        at = {
            name.removeprefix("attractor_"): branches[name]
            for name in names
            if name.removeprefix("attractor_") in attractors.dims
        }
        assert set(at) == {"representation", "K_c", "gap", "omega"}
        same = attractors.rename(attractor="number").sel(at)
        same = same.isel(number=branches["attractor_number"])
        assert (same["response_class"] == 0).all()
        heights = same["x_max"].values
        np.testing.assert_array_equal(branches["attractor_x_max"], heights)
        times = same["period_multiple"].values
        np.testing.assert_array_equal(branches["attractor_period_multiple"], times)
    exact = np.isclose(branches["attractor_omega"], 0.2) & (branches["attractor_K_c"] == 3.0)
    assert len(np.unique(heights[exact.values].round(6))) >= 2


@pytest.mark.extended
def test_a_state_of_each_attractor_returns_after_its_period(branches):
    law = gs.contact_law("piecewise", 3.0, gs.Gap(0.1745, 0.1745))
    label = branches["attractor_representation"].values
    for one in np.flatnonzero(label == "piecewise")[::7]:
        here = branches.isel(attractor=one)
        x, v = here["attractor_start_state"].values
        omega = float(here["attractor_omega"])
        n = int(here["attractor_period_multiple"])
        motion = gs.simulate(gs.Oscillator(**OSCILLATOR), law, omega, x, v, n_periods=n)
        assert motion.x_end == pytest.approx(x, abs=1e-6)


@pytest.mark.extended
def test_branches_follow_chi_and_are_continued_once_where_a_law_has_none(client, tmp_path):
    """Along chi, branches are those of the call; along omega, a law without chi has one branch."""
    (block,) = tables()["sweep"]
    block |= {"representation": ["piecewise", "huntcrossley"], "initial_condition": [0.35, 0.0]}
    swept = block | {"omega": 0.24, "chi": [0.1, 0.5, 1.0]}
    along = tables(sweep=[swept], branches={"along": "chi"})
    found = run(gs.Study.from_dict(along), client, tmp_path).load()
    assert {*found["representation"].values} == {"huntcrossley"}
    law = gs.HuntCrossley(3.0, gs.Gap(0.1745, 0.1745), chi=0.1)
    expected = gs.branches(gs.Oscillator(**OSCILLATOR), law, "chi", (0.1, 1.0), omega=0.24)
    for one in (found, expected):
        assert one["chi"].min() == pytest.approx(0.1)
        assert one["chi"].max() == pytest.approx(1.0)
    (peaks, others) = (
        np.interp([0.2, 0.4, 0.8], *(np.ravel(one[name]) for name in ("chi", "x_max")))
        for one in (found, expected)
    )
    assert peaks == pytest.approx(others, rel=1e-3)

    both = tables(sweep=[block | {"chi": [0.1, 0.5], "omega": [0.15, 0.16, 0.17]}])
    found = run(gs.Study.from_dict(both), client, tmp_path / "omega").load()
    exact = found.isel(branch=found["representation"].values == "piecewise")
    assert exact["chi"].values.tolist() == [0.1, 0.5]
    np.testing.assert_array_equal(*exact["x_max"].values)
    assert len([*(tmp_path / "omega" / "c" / "branches").iterdir()]) == 1 + 2


@pytest.mark.extended
def test_branches_along_chi_have_the_range_of_the_laws_with_chi(client, tmp_path):
    """A block without chi has the value of an elastic contact, 0, on the axis of the study."""
    (block,) = tables()["sweep"]
    block |= {"initial_condition": [0.35, 0.0], "omega": 0.24}
    swept = block | {"representation": ["huntcrossley"], "chi": [0.1, 1.0]}
    other = block | {"representation": ["piecewise"]}
    study = gs.Study.from_dict(tables(sweep=[swept, other], branches={"along": "chi"}))
    assert study.grid.axes["chi"][0] == 0.0
    found = run(study, client, tmp_path).load()
    assert {*found["representation"].values} == {"huntcrossley"}
    assert found["chi"].min() == pytest.approx(0.1, rel=1e-12)
    assert found["chi"].max() == pytest.approx(1.0, rel=1e-12)


@pytest.mark.extended
def test_special_points_of_laws_are_compared(branches):
    assert branches["match_kind"].values.tolist() == [1, 1, 5, 5]
    exact, law = branches["match_exact"].values, branches["match_law"].values
    np.testing.assert_allclose(sorted(exact / ONE_RAD), sorted([*FOLDS, *GRAZES]), rtol=1e-11)
    np.testing.assert_array_equal(branches["match_difference"], law - exact)
    for kind in (1, 5):
        here = np.sort(law[branches["match_kind"] == kind])
        np.testing.assert_array_equal(here / ONE_RAD, special(of_law(branches, "tanh-1e3"), kind))


@pytest.mark.extended
def test_the_end_of_a_doubled_branch_is_the_point_where_it_leaves():
    """Both rows are at 6 Hz: on the branch of period 1, and at the end of that of period 2."""
    stable, special = [[1, 1, 0], [1, 1, 1]], [[0, 1, 2], [0, 0, 2]]
    found = made_branches(stable, special)
    table, _ = compared(
        [({"representation": 0}, found), ({"representation": 1}, found)],
        ["piecewise", "tanh-1e4"],
        "omega",
    )
    assert table["match_kind"].values.tolist() == [1, 2]
    assert table["match_period_multiple"].values.tolist() == [1, 1]


@pytest.mark.extended
def test_a_second_run_makes_nothing_and_a_new_folder_takes_all_from_the_cache(
    branches, client, folder, tmp_path, monkeypatch
):
    study = gs.Study.from_dict(tables())
    before = (folder / "out" / "branches.nc").stat().st_mtime_ns
    planned = pipeline.plan(study, folder / "c")
    assert not any(pipeline.stage_reasons(study, planned, folder / "out").values())
    monkeypatch.setattr(branches_of_study, "followed", None)
    gs.run(study, client, out=folder / "out", cache=folder / "c").close()
    assert (folder / "out" / "branches.nc").stat().st_mtime_ns == before
    gs.run(study, client, out=tmp_path / "other", cache=folder / "c").close()
    found = gs.open(tmp_path / "other" / "branches.nc")
    xr.testing.assert_identical(found.drop_attrs(deep=False), branches.drop_attrs(deep=False))


@pytest.mark.extended
def test_damaged_branches_of_a_scene_are_computed_again(branches, client, folder, tmp_path):
    stored = sorted((folder / "c" / "branches").glob("*/scene.nc"))
    assert len(stored) == 2
    stored[0].write_bytes(stored[0].read_bytes()[:-1])
    gs.run(gs.Study.from_dict(tables()), client, out=tmp_path / "out", cache=folder / "c").close()
    found = gs.open(tmp_path / "out" / "branches.nc")
    xr.testing.assert_identical(found.drop_attrs(deep=False), branches.drop_attrs(deep=False))


@pytest.mark.extended
@pytest.mark.parametrize(("along", "omega"), [("forcing", 0.2), ("K_c", [0.2, 0.25])])
def test_branches_along_another_parameter(along, omega, client, tmp_path):
    block = tables()["sweep"][0] | {"omega": omega, along: [2.0, 3.0, 4.0]}
    if along == "forcing":
        block["forcing"] = [0.01, 0.03, 0.05]
    found = run(
        gs.Study.from_dict(tables(sweep=[block], branches={"along": along})), client, tmp_path
    )
    assert (found["attractor_on_branch"] >= 0).all()
    assert found[along].dims == ("branch", "step")
    assert found["omega"].dims == ("branch",)
    assert np.nanmax(found[along]) <= block[along][-1] * (1.0 + 1e-12)
    np.testing.assert_allclose(
        found["period"],
        (1.0 / found["omega"]).broadcast_like(found["period"]).where(found["period"].notnull()),
    )


@pytest.mark.extended
def test_laws_that_are_fitted_at_every_value_are_refused_in_their_scene(client, tmp_path):
    block = tables()["sweep"][0] | {"representation": ["poly-13", "piecewise"], "omega": 0.2}
    block["K_c"] = [2.0, 3.0]
    study = gs.Study.from_dict(
        tables(sweep=[block], branches={"along": "K_c"}, approximation={"range": 0.5})
    )
    found = run(study, client, tmp_path)
    is_fit = found["attractor_representation"].values == "poly-13"
    assert is_fit.any()
    np.testing.assert_array_equal(found["attractor_status"], is_fit * gs.Status.MODEL_INVALID)
    assert "use 'omega'" in str(found["attractor_message"].values[is_fit][0])
    assert (found["attractor_on_branch"].values[~is_fit] >= 0).all()


@pytest.mark.extended
def test_orbits_of_laws_of_several_kinds_are_integrated_each_with_its_own():
    laws = [gs.Tanh(1.4e4, gs.Gap(4e-4, 4e-4), epsilon) for epsilon in (1e3, 1e6, 1e3, 1e6)]
    assert {law.has_thin_layers for law in laws} == {False, True}
    models = Models.of([gs.systems.paper_oscillator()], [(law,) for law in laws], np.full(4, 9.0))
    states, span = np.array([[1e-3, 0.0]] * 4), np.full(4, 0.25)
    found = integrated(models, Solver.of(), states, span, np.zeros(4), tangent=True)
    runs = [
        gs.simulate(gs.systems.paper_oscillator(), law, 9.0, 1e-3, 0.0, t_end=0.25) for law in laws
    ]
    np.testing.assert_allclose(found.state[:, 0], [each.x_end for each in runs], rtol=1e-6)
    assert len(np.unique(found.state[:, 0])) == 2


@pytest.mark.extended
def test_branches_of_a_system_along_a_parameter_of_its_function(client, tmp_path):
    study = gs.Study.from_dict(
        {
            "study": {"name": "masses"},
            "system": {"function": "typical_section"},
            "parameters": {"speed": 12.0},
            "sweep": [
                {
                    "representation": "piecewise",
                    "K_c": 3.9,
                    "gap": [0.037001, 0.037001],
                    "speed": [15.0, 16.0, 17.0],
                    "initial_condition": [[0.0, 0.05, 0.0, 0.0, 0.0, 0.0]],
                }
            ],
            "branches": {"along": "speed"},
        }
    )
    found = run(study, client, tmp_path)
    assert found.sizes["attractor"] == 3
    assert (found["attractor_on_branch"] >= 0).all()
    assert found["x_max"].dims == ("branch", "step", "coordinate")
    assert found["coordinate"].values.tolist() == list(gs.systems.typical_section(15.0).coordinates)


def scene(folder):
    """The scene of the exact law, of a run that is stored."""
    study = gs.Study.from_dict(tables())
    with gs.open(folder / "out" / "attractors.nc") as attractors:
        return next(branches_of_study.cases(study, attractors)).scene


@pytest.mark.extended
def test_what_becomes_of_a_scene_whose_process_ends_or_hangs_is_its_status(
    branches, client, folder
):
    sound = scene(folder)
    own = OwnLaw.of("tests.misbehaving.forces:spinning", [Path(__file__).parents[2]])
    point = replace(
        sound.point, kind=replace(sound.point.kind, contacts=(Representation(own.label),), own=own)
    )
    scenes = [Deadly(), replace(sound, point=point), sound]
    found = dict(branch_tasks.followed(scenes, client, 3.0, lambda: None, ()))
    assert found[0].status == gs.Status.KILLED
    assert found[0].message == "its process ended with exit code 7"
    assert found[1].status == gs.Status.TIMED_OUT
    assert found[2].status == gs.Status.OK


@pytest.mark.extended
def test_failed_scenes_are_in_the_file_and_are_tried_again_if_asked(client, tmp_path, monkeypatch):
    study = gs.Study.from_dict(tables())
    failing = branch_tasks.Followed(gs.Status.ERROR, "lost")

    def fails(scenes, *_):
        sound = branch_tasks.followed(scenes[:1], client, 60.0, lambda: None, ())
        yield from ((number, one) for number, one in sound)
        yield from ((number, failing) for number in range(1, len(scenes)))

    with monkeypatch.context() as patched:
        patched.setattr(branches_of_study, "followed", fails)
        found = run(study, client, tmp_path)
    lost = found["attractor_representation"].values == "tanh-1e3"
    np.testing.assert_array_equal(found["attractor_status"], lost * gs.Status.ERROR)
    assert {*found["attractor_message"].values[lost]} == {"lost"}
    assert (of_attractors(found, "tanh-1e3") == -1).all()
    assert (of_attractors(found, "piecewise") == 0).all()
    assert not found.sizes["match"]
    where = {"out": tmp_path / "out", "cache": tmp_path / "c"}
    gs.run(study, client, **where, retry_failed=True).close()
    found = gs.open(tmp_path / "out" / "branches.nc")
    assert (found["attractor_status"] == 0).all()
    assert (found["attractor_on_branch"] >= 0).all()


def test_an_interrupt_between_two_cases_cancels_the_others_at_once(
    branches, folder, tmp_path, monkeypatch
):
    """When the error is handled, the cluster has ended: to cancel a task then takes for ever."""
    ended = []

    def one_of_several(*_):
        try:
            yield 0, branch_tasks.Followed(gs.Status.ERROR, "lost")
        finally:
            ended.append(True)

    def interrupted(_):
        raise KeyboardInterrupt

    monkeypatch.setattr(branches_of_study, "followed", one_of_several)
    study = gs.Study.from_dict(tables())
    how = (tmp_path, lambda: None, 1.0, interrupted, ())
    # The interrupt keeps the frames that it passed, and what these refer to.
    with (
        gs.open(folder / "out" / "attractors.nc") as attractors,
        pytest.raises(KeyboardInterrupt) as _kept,
    ):
        branches_of_study.branches(study, attractors, *how)
    assert ended


@pytest.mark.extended
def test_curves_do_not_repeat_failed_branches(client, tmp_path, monkeypatch):
    block = tables()["sweep"][0] | {"representation": ["piecewise", "tanh-1e3"]}
    given = {"second": "forcing", "range": [0.02, 0.04]}
    seen = []

    def fails(scenes, *how):
        seen.append([scene.points is not None for scene in scenes])
        if seen == [[False, False]]:
            yield from branch_tasks.followed(scenes[:1], *how)
            yield 1, branch_tasks.Followed(gs.Status.ERROR, "lost")
        else:
            yield from branch_tasks.followed(scenes, *how)

    monkeypatch.setattr(branches_of_study, "followed", fails)
    run(gs.Study.from_dict(tables(sweep=[block], branches=given)), client, tmp_path).close()
    assert seen == [[False, False], [True]]
    with gs.open(tmp_path / "out" / "curves.nc") as curves:
        assert {*curves["attractor_representation"].values} == {"piecewise"}


def of_attractors(found, label):
    return found["attractor_on_branch"].values[found["attractor_representation"].values == label]


@pytest.mark.extended
def test_a_killed_run_computes_only_the_scene_that_it_lacks(branches, run_command, tmp_path):
    (tmp_path / "folds.toml").write_text(STUDY)
    command = ["run", "folds.toml", "--workers", "1", "--out", "out", "--cache", "c"]

    def stored():
        return {path: path.stat().st_mtime_ns for path in tmp_path.glob("c/branches/*/scene.nc")}

    process = started(tmp_path, *command, stdout=None, stderr=None)
    while not stored() and process.poll() is None:
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    before = stored()
    assert len(before) == 1, "killed at work"
    assert not (tmp_path / "out" / "branches.nc").exists()
    run_command(tmp_path, *command)
    after = stored()
    assert len(after) == 2
    assert {path: after[path] for path in before} == before
    found = gs.open(tmp_path / "out" / "branches.nc")
    xr.testing.assert_identical(found.drop_attrs(deep=False), branches.drop_attrs(deep=False))


def test_curves_of_special_points_over_a_second_parameter(client, tmp_path, monkeypatch):
    """Both grazes lie on one curve: force over amplitude is the spring's dynamic stiffness."""
    block = tables()["sweep"][0] | {"representation": ["piecewise"]}
    given = {"second": "forcing", "range": [0.005, 0.05]}
    study = gs.Study.from_dict(tables(sweep=[block], branches=given))
    run(study, client, tmp_path).close()
    found = gs.open(tmp_path / "out" / "curves.nc")
    assert (found["attractor_status"] == 0).all()
    assert (found["n_lost"] == 0).all()
    kinds = found["curve_kind"].values
    assert (kinds == 5).sum() == 1
    assert (kinds == 1).any()
    curve = found.isel(branch=int(np.flatnonzero(kinds == 5)[0])).dropna("step", subset=["omega"])
    rate = curve["omega"].values / ONE_RAD
    expected = 0.1745 * np.hypot(1.0 - rate**2, 0.05 * rate)
    np.testing.assert_allclose(curve["forcing"], expected, rtol=1e-8)
    assert float(curve["forcing"].max()) == 0.05
    assert rate.min() < GRAZES[0]
    assert rate.max() > GRAZES[1]
    assert found.gapsweep.branches(y="forcing").get_xlabel().startswith("forcing frequency")
    page = (tmp_path / "out" / "report" / "index.html").read_text(encoding="utf-8")
    assert "Curves of special points" in page
    # Nothing is computed for another folder, and another range leaves the branches as they are.
    for number, scenes in enumerate(((), (0,))):
        given["range"][0] += 0.005 * number
        monkeypatch.setattr(branches_of_study, "followed", counted(scenes))
        study = gs.Study.from_dict(tables(sweep=[block], branches=given))
        gs.run(study, client, out=tmp_path / f"{number}", cache=tmp_path / "c").close()


def counted(expected):
    """`followed`, which is called with so many scenes of curves."""

    def each(scenes, *how):
        assert [number for number, _ in enumerate(scenes)] == [*expected]
        assert all(scene.points is not None for scene in scenes)
        return branch_tasks.followed(scenes, *how)

    return each


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"second": "mas", "range": [1.0, 2.0]}, "branches.second = 'mas': must be one of K_c"),
        ({"second": "omega", "range": [1.0, 2.0]}, "branches.second = 'omega'"),
        ({"second": "forcing"}, "give both or neither"),
        ({"second": "forcing", "range": [0.04, 0.02]}, r"must be ascending"),
        ({"second": "forcing", "range": [0.04, 0.05]}, "must contain forcing = 0.03"),
        ({"second": "gap", "range": [0.2, 0.3]}, "must contain gap = 0.1745"),
        ({"second": "zeta", "range": [-0.1, 2.0]}, "zeta = -0.1: must be >= 0"),
        ({"second": "K_c", "range": [1.0, 3.0]}, "branches.second = 'K_c': must have one value"),
        ({"range": [0.02, 0.04]}, "give both or neither"),
    ],
)
def test_a_second_parameter_that_cannot_be_gives_one_line(given, words):
    block = tables()["sweep"][0] | {"K_c": [2.0, 3.0]}
    with pytest.raises(gs.StudyError, match=words) as refused:
        gs.Study.from_dict(tables(sweep=[block], branches=given))
    assert len(refused.value.problems) == 1
