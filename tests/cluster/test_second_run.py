"""The second run of a study computes nothing and makes nothing, whatever the first one met."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.builders.cache import stored
from tests.builders.studies import PAPER

import gapsweep as gs
from gapsweep import pipeline
from gapsweep.execution import task
from gapsweep.execution.execute import execute
from gapsweep.execution.plan import plan
from gapsweep.response.result import Responses
from gapsweep.store.cache import Cache

WORKFLOWS = Path(__file__).parents[2] / "workflows"
STUDIES = [str(path.relative_to(WORKFLOWS)) for path in sorted(WORKFLOWS.rglob("*.toml"))]


def files(folder):
    """When each file of a run was written, but for the run's own state."""
    found = (path for path in folder.rglob("*") if path.is_file() and path.name != "run.json")
    return {path: path.stat().st_mtime_ns for path in found}


def run_twice(study, client, folder):
    """The first outcome; the second run must find everything."""
    where = {"out": folder / "out", "cache": folder / "c-cache"}
    first = pipeline.carry_out(study, client, **where)
    made = files(folder / "out")
    planned = pipeline.plan(study, where["cache"])
    assert planned.n_missing == 0
    assert not any(pipeline.stage_reasons(study, planned, where["out"]).values())
    again = pipeline.carry_out(study, client, **where)
    assert (again.progress.n_hits, again.progress.n_computed) == (planned.n_points, 0)
    assert again.failures == first.failures
    assert files(folder / "out") == made
    return first


def thinned(values, n):
    """A few numbers of a range, or values of a list."""
    if isinstance(values, dict):
        return np.linspace(values["start"], values["stop"], n).tolist()
    return values[:n] if isinstance(values, list) else values


def reduced(tables):
    """A study of the same form with a few points of its first block, and few short motions."""
    block = tables["sweep"][0]
    starts = block.get("initial_condition", [])
    for one in starts if isinstance(starts, list) else [starts]:
        if isinstance(one, dict):
            one["sobol"] = 2
    n_omega = 1 if tables.get("solver", {}).get("engine") == "scipy" else 3
    sizes = {"omega": n_omega, "speed": 2, "mean_load": 1}
    block |= {name: thinned(block[name], n) for name, n in sizes.items() if name in block}
    if isinstance(block["representation"], list):
        block["representation"] = block["representation"][::4]
    for history in tables.get("history", []):
        history["t_end"] = 1.0
    if bench := tables.get("bench"):
        bench |= {"method": bench["method"][:2], "scene": bench["scene"][-1:], "repeats": 1}
        for method in bench["method"]:
            method["rtol"] = [1e-4]
    if tables.pop("claims", None):  # the paper's need its whole grid
        tables.pop("report")  # table2 has the same
    return tables | {"sweep": [block]}


@pytest.mark.extended
@pytest.mark.parametrize("name", STUDIES)
def test_of_our_own_studies(client, tmp_path, name):
    path = WORKFLOWS / name
    tables = reduced(tomllib.loads(path.read_text(encoding="utf-8")))
    run_twice(gs.Study.from_dict(tables, str(path)), client, tmp_path)


def swept(label, omega, **others):
    block = {"representation": label, "K_c": 1.4e4, "gap": [0.4e-3, 0.4e-3], "omega": omega}
    block["initial_condition"] = ["sweep_up", "sweep_down"]
    return gs.Study.from_dict(
        {"study": {"name": "swept"}, "oscillator": PAPER, "sweep": [block]} | others
    )


@pytest.mark.extended
def test_of_a_sweep_through_a_polynomial_that_runs_away(client, tmp_path):
    """Its motion leaves the fitted range, which is a result, and has no end state."""
    study = swept("poly-13", {"start": 1.0, "stop": 30.0, "step": 1.0})
    run_twice(study, client, tmp_path)
    with Cache(tmp_path / "c-cache", read_only=True) as cache:
        found = list(stored(study, cache).values())
    left = [one for one in found if one.status == gs.Status.OUT_OF_FIT_RANGE]
    assert any(np.isnan(one.x_end) for one in left)
    assert any(np.isfinite(one.x_end) for one in found)


@pytest.mark.extended
@pytest.mark.parametrize("force", ["raising", "undefined"])
def test_of_a_sweep_through_failures(client, tmp_path, force):
    """The law fails beyond a displacement that is reached at resonance alone."""
    label = f"tests.misbehaving.forces:{force}"
    others = {"solver": {"engine": "scipy", "rtol": 1e-4}}
    others["oscillator"] = PAPER | {"zeta": 0.3, "forcing": 0.2}
    study = swept(label, [1.0, 5.0, 12.0, 20.0], **others)
    assert 0 < sum(run_twice(study, client, tmp_path).failures.values()) < 8


N = 40  # points, more than a part of a sweep
ENDED = [(status, True) for status in gs.Status if not status.failed]
LOST = [(status, False) for status in gs.Status if status >= gs.Status.OUT_OF_FIT_RANGE]


def end_of(outcome, state, omega):
    """A made-up end state, in which every earlier one can be seen."""
    return (0.5 * state[0] + omega, state[1] + 1.0) if outcome[1] else (np.nan, np.nan)


_usual = task.respond_to


def answer(outcomes):
    """Have a worker answer with drawn outcomes, by frequency; without any, as usual."""

    def ask(points, states):
        found = []
        for state, omega in zip(states.tolist(), points.column("omega").tolist(), strict=True):
            outcome = outcomes[int(omega) - 1]
            x, v = end_of(outcome, state, omega)
            found.append(gs.Response(status=outcome[0], x_end=x, v_end=v))
        return Responses.of(found)

    task.respond_to = (lambda tile: _usual(tile, ask)) if outcomes else _usual


@pytest.fixture
def answering(client):
    """A cluster that computes nothing; see `answer`."""
    yield client
    client.run(answer, [])


def ends(outcomes, order):
    """End states of a sweep, point by point."""
    found, state = {}, (0.0, 0.0)
    for k in order:
        found[k] = end_of(outcomes[k], state, k + 1.0)
        state = found[k] if outcomes[k][1] else state
    return [found[k] for k in sorted(found)]


drawn = st.lists(st.sampled_from(ENDED + LOST), min_size=N, max_size=N)


@settings(max_examples=10, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(first=drawn, later=drawn, batch=st.sampled_from([7, 100]))
def test_of_sweeps_through_every_status(answering, tmp_path_factory, first, later, batch):
    """A sweep goes on from its last point with an end state, in one part or in several.

    With --retry-failed, a failed point and all behind it are computed again, and may fail.
    """
    study, orders = swept("piecewise", np.arange(1.0, N + 1.0).tolist()), (range(N), range(N)[::-1])
    known = [list(first), list(first)]
    with Cache(tmp_path_factory.mktemp("drawn") / "c-cache") as cache:
        for outcomes, options in ((first, {}), (later, {"retry_failed": True})):
            answering.run(answer, outcomes)
            execute(plan(study, cache, **options), answering, batch=batch, **options)
            found = stored(study, cache)
            for start, order in enumerate(orders):
                begun = [k for k in order if outcomes is first or first[k][0].failed][:1]
                for k in order[order.index(begun[0]) :] if begun else ():
                    known[start][k] = outcomes[k]
                points = [found[0, 0, 0, k, start] for k in range(N)]
                made = [(one.x_end, one.v_end) for one in points]
                np.testing.assert_array_equal(made, ends(known[start], order))
                assert [one.status for one in points] == [status for status, _ in known[start]]
            assert plan(study, cache).n_missing == 0


@pytest.mark.extended
def test_a_fit_outlives_an_interrupted_run_and_follows_its_file(client, tmp_path, monkeypatch):
    omega, law = [7.0, 7.5, 8.0, 8.5], gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))

    def study_of(law):
        amplitude = gs.respond(gs.Oscillator(**PAPER), law, omega=omega).amplitude
        rows = [f"{w}, {float(x)!r}" for w, x in zip(omega, amplitude, strict=True)]
        (tmp_path / "sweep.csv").write_text("\n".join(["frequency [Hz], amplitude [m]", *rows]))
        block = {"representation": "piecewise", "K_c": 1.4e4, "gap": [3e-4, 3e-4], "omega": 8.0}
        fit = {"data": "sweep.csv", "free": {"gap": [2e-4, 8e-4]}, "noise": 1e-6}
        tables = {"study": {"name": "fit"}, "oscillator": PAPER, "sweep": [block], "fit": fit}
        return gs.Study.from_dict(tables, str(tmp_path / "study.toml"))

    def fitted():
        with xr.open_dataset(tmp_path / "out" / "fit.nc") as found:
            return found["value"].item()

    where = {"out": tmp_path / "out", "cache": tmp_path / "c-cache"}
    with monkeypatch.context() as patch:
        patch.setattr("gapsweep.stages.write_page", interrupted)
        with pytest.raises(KeyboardInterrupt):
            pipeline.carry_out(study_of(law), client, **where)
    made = (tmp_path / "out" / "fit.nc").stat().st_mtime_ns
    run_twice(study_of(law), client, tmp_path)
    assert (tmp_path / "out" / "fit.nc").stat().st_mtime_ns == made
    assert fitted() == pytest.approx(4e-4, abs=1e-6)
    assert "gap = 0.4" in (tmp_path / "out" / "report" / "index.html").read_text()
    run_twice(study_of(gs.Piecewise(1.4e4, gs.Gap(0.5e-3, 0.5e-3))), client, tmp_path)
    assert fitted() == pytest.approx(5e-4, abs=1e-6)


def interrupted(*_):
    raise KeyboardInterrupt
