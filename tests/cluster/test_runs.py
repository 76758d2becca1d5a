"""Whole runs on real worker processes."""

import os
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from tests.builders.cache import commit, messages, n_stored, point, stored, tile_rows
from tests.builders.runs import run, wait_until
from tests.builders.studies import PAPER

import gapsweep as gs
from gapsweep import pipeline
from gapsweep.execution import execute, portions
from gapsweep.execution.cluster import cluster
from gapsweep.execution.plan import plan
from gapsweep.execution.portions import Costs
from gapsweep.model.labels import contact_law
from gapsweep.model.structure import OscillatorStructure
from gapsweep.response.result import exists
from gapsweep.store.cache import Cache
from gapsweep.study.schema import POINT_DIMS, VARIABLES, coordinates
from gapsweep.study.software import versions
from gapsweep.variables import METRES

pytestmark = pytest.mark.extended


@pytest.fixture
def responses(tables, client, tmp_path):
    return run(tables, client, tmp_path)


def test_dataset_has_every_dimension_unit_and_flag(responses):
    assert responses["x_max"].dims == POINT_DIMS
    assert responses["extrema"].dims == (*POINT_DIMS, "extremum")
    held = {name for name in VARIABLES if exists(name, OscillatorStructure())}
    assert held == {*responses.data_vars}
    for name in held:
        variable = VARIABLES[name]
        assert responses[name].attrs["units"] == variable.units
        assert responses[name].attrs["long_name"]
        if variable.dtype.startswith("i"):
            assert responses[name].dtype.kind == "i"
            assert "_FillValue" not in responses[name].encoding
    for name, (along, variable) in coordinates(POINT_DIMS, OscillatorStructure(), METRES).items():
        assert responses.coords[name].dims == along
        assert responses[name].attrs["units"] == variable.units
    meanings = responses["status"].attrs["flag_meanings"].split()
    assert meanings == [status.label for status in gs.Status]
    assert len(responses["response_class"].attrs["flag_values"]) == 1 + len(gs.ResponseClass)
    assert {"study_json", "numerics_fingerprint", "versions", "host"} <= set(responses.attrs)
    for library in ("Python", "numba", "llvmlite", "numpy", "scipy"):
        assert f"{library} {versions()[library]}" in responses.attrs["computed_with"]


def test_dataset_holds_what_respond_returns(tables, client, tmp_path):
    tables["sweep"][0]["initial_condition"] = [[0.0, 0.0], [5e-3, 0.0]]
    tables["oscillator"] = PAPER | {"alpha": -7e8}  # the second start is lost
    responses, study = run(tables, client, tmp_path), gs.Study.from_dict(tables)
    for at, label in enumerate(responses["representation"].values.tolist()):
        table = point(study, at, 0, 0, 1, 0)
        solver = table.kind.solver
        found = gs.respond(
            gs.systems.paper_oscillator(alpha=-7e8),
            contact_law(label, 1.4e4, table.gap(0)),
            responses["omega"].values[:, None],
            responses["x_0"].values,
            responses["v_0"].values,
            engine=solver.engine, rtol=solver.rtol, atol=solver.atol, steady=table.kind.steady,
        )  # fmt: skip
        expected = responses.sel(representation=label).squeeze(["K_c", "gap"])
        dataset = found.to_dataset()
        assert {"failed", "periodic"} <= {*found.to_dataframe()["response_class"]}
        assert {*expected} - {*dataset} == {"attractor", "host"}
        for name in {*expected} & {*dataset} - {"cpu_time"} | {"omega", "x_0", "v_0"}:
            # Names of dimensions, types, bits, units, long names, flags.
            xr.testing.assert_identical(dataset[name].variable, expected[name].variable)
        assert tuple(dataset["extrema"].dropna("extremum", how="all").values[1, 0]) == (
            *found.extrema[1, 0],
        )


def test_workers_and_batches_do_not_change_a_bit(tables, client, tmp_path):
    tables["sweep"].append(
        tables["sweep"][0] | {"representation": ["piecewise"], "initial_condition": "sweep_down"}
    )
    first = run(tables, client, tmp_path, "one", batch=1)
    second = run(tables, client, tmp_path, "seven", batch=7)
    with cluster(workers=1) as alone:
        third = run(tables, alone, tmp_path, "alone")
    for other in (second, third):
        xr.testing.assert_identical(
            first.drop_vars("cpu_time").drop_attrs(), other.drop_vars("cpu_time").drop_attrs()
        )


@pytest.mark.parametrize("timeout", [0.5, 5.0, 600.0])
def test_a_task_aims_at_less_than_the_time_that_a_point_may_take(timeout):
    costs = Costs("compiled", timeout, 1)
    costs.add((0, 0), n_points=100, seconds=1.0, spent=1.0)
    assert 1 < costs.room((0, 0)) <= 0.5 * timeout * 100


@pytest.mark.parametrize("n_threads", [2, 64, 256])
@pytest.mark.parametrize("cost", [180e-6, 0.1])
def test_the_fewest_points_of_a_task_let_one_client_feed_all_threads(n_threads, cost):
    costs = Costs("compiled", 600.0, 1)
    assert costs.least((0, 0), n_threads) == 0
    costs.add((0, 0), n_points=1000, seconds=1000 * cost, spent=1000 * cost)
    tasks_per_second = n_threads / ((costs.least((0, 0), n_threads) + 1) * cost)
    assert tasks_per_second <= 100.0
    # At most one more point than that, so that all threads end together.
    assert costs.least((0, 0), n_threads) * cost <= n_threads / 100.0 * 1.001


def test_points_without_measured_time_do_not_keep_tasks_small(
    tables, client, tmp_path, monkeypatch
):
    """Refused models take no time, but each task does."""
    sizes = []
    keep = execute._Execution._keep

    def watch(run, job, result):
        sizes.append(len(job.rows))
        keep(run, job, result)

    monkeypatch.setattr(execute._Execution, "_keep", watch)
    sweep = tables["sweep"][0]
    sweep |= {"representation": ["poly-5"], "gap": [2.0, 2.0]}  # beyond the range of the fit
    sweep |= {"omega": {"start": 5.0, "stop": 9.0, "num": 400}}
    with run(tables, client, tmp_path) as ds:
        assert (ds["status"] == gs.Status.MODEL_INVALID).all()
    assert max(sizes) > portions._FIRST_BATCH["compiled"]


def test_the_time_left_is_that_of_what_is_left(monkeypatch):
    """On a machine on which tasks get one second of processor time per second."""
    now = [0.0]
    monkeypatch.setattr(portions, "time", SimpleNamespace(monotonic=lambda: now[0]))
    costs, n_left = Costs("compiled", 600.0, 3), np.array([[10_000, 0], [1000, 0], [0, 0]])
    for label, now[0] in ((0, 30.0), (1, 60.0)):  # half a minute of compiling each
        assert costs.seconds_left(n_left) is None
        costs.add((label, 0), n_points=16, seconds=0.16, spent=25.0)
    assert costs.seconds_left(n_left) is None, "no task has come back since"
    for label, n_points, now[0] in ((0, 20_000, 80.0), (1, 10_000, 180.0)):
        seconds = 0.001 * 10**label * n_points
        costs.add((label, 0), n_points, seconds, spent=seconds)
    assert costs.seconds_left(n_left) == pytest.approx(20.0, rel=0.05)
    assert costs.seconds_left(np.add(n_left, [[0, 0], [0, 0], [5, 0]])) is None, "not compiled yet"
    assert costs.seconds_left(np.add(n_left, [[0, 5], [0, 0], [0, 0]])) is None, "no sweep is known"
    for label, now[0] in ((0, 190.0), (0, 200.0)):
        costs.add((label, 1), n_points=100, seconds=10.0, spent=10.0)
    with_sweeps = costs.seconds_left(np.add(n_left, [[0, 80], [0, 20], [0, 0]]))
    assert with_sweeps == pytest.approx(20.0 + 10.0, rel=0.05), "of other laws they cost as much"


def test_runs_begin_at_different_points_and_cut_no_sweep(tables):
    tables["sweep"][0]["omega"] = {"start": 6.0, "stop": 30.0, "num": 50}
    starts = [[0.0, 0.0], "sweep_up", "sweep_down", [1e-4, 0.0]]
    tables["sweep"][0]["initial_condition"] = starts
    planned = plan(gs.Study.from_dict(tables))
    firsts = set()
    for _ in range(40):
        several = list(portions.shuffled(planned))
        numbers = [block.numbers[rows] for block, rows in several]
        firsts.add(int(numbers[0][0]))
        assert np.array_equal(np.sort(np.concatenate(numbers)), np.arange(planned.n_points))
        assert all((np.diff(each) == 1).all() for each in numbers)
        assert not any(block.follows[rows[0]] for block, rows in several)
        kinds = [block.representation for block, _ in several[:3]]
        assert kinds == [0, 1, 2], "one of each representation leads"
    assert len(firsts) > 10


def test_parts_of_sweeps_are_longer_if_few_sweeps_fill_a_task():
    """A part of one sweep leaves room for that of the other direction."""
    for n_sweeps, lengths in ((1, [32]), (3, [21, 21, 21]), (10, [16, 16, 16, 16])):
        rows = np.arange(100 * n_sweeps)
        drawn, rest, others = portions.cut(rows, rows % 100 > 0, room=64)
        assert np.bincount(drawn // 100).tolist() == lengths
        assert np.array_equal(np.sort(np.concatenate([drawn, rest, others])), rows)
        assert not {*(others // 100)} & {*(drawn // 100)}, "a sweep stays in one task"


def test_equal_points_under_two_labels_are_computed_once(tables, client, tmp_path):
    tables["protocol"] = {"twin": {}}
    tables["sweep"][0] |= {"representation": ["piecewise", "piecewise@twin"]}
    study = gs.Study.from_dict(tables)
    where = {"out": tmp_path / "out", "cache": tmp_path / "cache"}
    progress = pipeline.carry_out(study, client, **where).progress
    assert (progress.n_computed, progress.n_shared) == (progress.n_points, 0)
    assert n_stored(tmp_path / "cache") == progress.n_points // 2


def test_points_in_no_block_are_not_requested(tables, client, tmp_path):
    tables["sweep"].append(tables["sweep"][0] | {"representation": ["piecewise"], "omega": [3.0]})
    status = run(tables, client, tmp_path)["status"].sel(omega=3.0).squeeze()
    assert status.values.tolist() == [0, gs.Status.NOT_REQUESTED, gs.Status.NOT_REQUESTED]


def test_second_run_computes_nothing_and_starts_no_cluster(tables, client, tmp_path, monkeypatch):
    first = run(tables, client, tmp_path)
    monkeypatch.setattr("gapsweep.execution.cluster.cluster", None)
    second = run(tables, None, tmp_path)
    xr.testing.assert_identical(first.drop_attrs(), second.drop_attrs())


def test_upward_sweep_stays_on_the_upper_branch(tables, client, tmp_path):
    block = tables["sweep"][0] | {"representation": ["piecewise"], "omega": [9.0, 10.0, 11.0]}
    tables["sweep"] = [block, block | {"initial_condition": "sweep_up"}]
    tables["solver"] = {"rtol": 1e-7, "atol": 1e-10}
    amplitude = run(tables, client, tmp_path)["amplitude"].sel(omega=11.0).squeeze()
    from_rest, swept = amplitude.values
    assert swept > 4 * from_rest


def test_interrupted_sweep_goes_on_where_it_was(tables, client, tmp_path):
    block = tables["sweep"][0] | {"representation": ["piecewise"], "initial_condition": "sweep_up"}
    tables["sweep"] = [block]
    whole = run(tables, client, tmp_path, "whole")
    study = gs.Study.from_dict(tables)
    with Cache(tmp_path / "whole-cache") as full:
        answers = stored(study, full)
    with Cache(tmp_path / "part-cache") as part:
        commit(part, study, lambda at: answers[tuple(at.values())] if at["omega"] == 0 else None)
    resumed = run(tables, client, tmp_path, "part")
    for name in ("x_max", "x_min", "n_steps", "extrema"):
        xr.testing.assert_equal(whole[name], resumed[name])


def test_a_sweep_that_goes_on_after_a_failure_says_so(tables, client, tmp_path):
    block = tables["sweep"][0] | {"representation": ["piecewise"], "initial_condition": "sweep_up"}
    tables["sweep"] = [block]
    study, failed = gs.Study.from_dict(tables), gs.Response(status=gs.Status.KILLED)
    with Cache(tmp_path / "out-cache") as cache:
        commit(cache, study, lambda at: failed if at["omega"] == 0 else None)
        run(tables, client, tmp_path)
        said = list(messages(study, cache).values())
    assert [bool(text) for text in said] == [False, True, False]


def test_what_started_elsewhere_counts_no_more_once_the_failure_is_repaired(
    tables, client, tmp_path
):
    block = tables["sweep"][0] | {"representation": ["piecewise"], "initial_condition": "sweep_up"}
    tables["sweep"] = [block]
    study, failed = gs.Study.from_dict(tables), gs.Response(status=gs.Status.KILLED)
    calm = run(tables, client, tmp_path, "calm")
    with Cache(tmp_path / "out-cache") as cache:
        commit(cache, study, lambda at: failed if at["omega"] == 0 else None)
    run(tables, client, tmp_path)
    first = tables | {"sweep": [block | {"omega": block["omega"][:1]}]}
    options = {"cache": tmp_path / "out-cache", "retry_failed": True}
    gs.run(gs.Study.from_dict(first), client, out=tmp_path / "first", **options).close()
    assert pipeline.plan(study, tmp_path / "out-cache").n_missing == 2
    xr.testing.assert_equal(run(tables, client, tmp_path)["x_max"], calm["x_max"])
    assert pipeline.plan(study, tmp_path / "out-cache").n_missing == 0


def test_long_sweep_in_parts_equals_one_in_a_piece(tables, client, tmp_path):
    omega = {"start": 8.0, "stop": 12.0, "num": 37}
    block = tables["sweep"][0] | {"representation": ["piecewise"], "omega": omega}
    tables["sweep"] = [block | {"initial_condition": "sweep_up"}]
    parts = run(tables, client, tmp_path)
    study = gs.Study.from_dict(tables)
    whole = tile_rows(study)
    assert parts["x_max"].values.ravel().tolist() == [r.x_max for r in whole]


def test_law_that_raises_is_a_result_with_its_message(tables, client, tmp_path):
    label = "tests.misbehaving.forces:raising"
    tables["sweep"][0] |= {"representation": ["piecewise", label], "omega": [12.0]}
    tables["solver"] = {"engine": "scipy"}  # else its force is searched for jumps before the run
    status = run(tables, client, tmp_path)["status"].sel(representation=label)
    assert set(status.values.ravel().tolist()) == {gs.Status.ERROR}
    study = gs.Study.from_dict(tables)
    with Cache(tmp_path / "out-cache") as cache:
        assert messages(study, cache)[1, 0, 0, 0, 0] == "ArithmeticError: no force here"


def test_no_worker_is_left_behind(tables, tmp_path):
    with cluster(workers=2) as own:
        pids = list(own.run(os.getpid).values())
    wait_until(lambda: not any(os.path.exists(f"/proc/{pid}") for pid in pids), 20)


_HOLDER = """
import sys, time
from pathlib import Path
from gapsweep.store.cache import Cache
from gapsweep.store.work_locks import WorkLocks
cache, keys, wanted = Path(sys.argv[1]), bytes.fromhex(sys.argv[2]), int(sys.argv[3])
with WorkLocks(cache, keys) as claims:
    assert claims.take(0, 0)
    print("held", flush=True)
    count = 0
    while count < wanted:
        time.sleep(0.05)
        with Cache(cache, read_only=True) as store:
            count = store.n_points
"""


def test_a_run_that_waits_for_another_first_lets_go_of_what_it_has(
    tables, client, tmp_path, monkeypatch
):
    # Two runs that each waited for points which the other had computed but not yet stored
    # once waited for ever.
    monkeypatch.setattr(execute, "COMMIT_SECONDS", 1e9)
    study, cache = gs.Study.from_dict(tables), tmp_path / "cache"
    with Cache(cache):
        pass  # the other one looks into it
    planned = plan(study)
    arguments = [str(cache), planned.mark.hex(), str(planned.n_points - 1)]
    command = [sys.executable, "-c", _HOLDER, *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout.readline() == "held\n"
        killer = threading.Timer(60.0, other.kill)
        killer.start()
        gs.run(study, client, out=tmp_path / "out", cache=cache, batch=1).close()
        killer.cancel()
        assert other.wait() == 0, "it waited until it was killed"


@pytest.mark.parametrize("walls", [{"gap": [4e-4, 4e-4]}, {"j_1": 4e-4, "j_2": [2e-4, 4e-4]}])
def test_further_axes_are_dimensions_after_the_frequency(tables, client, tmp_path, walls):
    block = {"representation": "piecewise", "K_c": 1.4e4, "omega": [8.0, 12.0]}
    starts = [[0.0, 0.0], [1e-3, 0.0]]
    tables["sweep"] = [block | walls | {"forcing": [2.0, 6.0], "initial_condition": starts}]
    found = run(tables, client, tmp_path)
    assert found["x_max"].dims == tuple(gs.Study.from_dict(tables).grid.dims)
    assert found["forcing"].attrs["units"] == "N"
    here = found.sel(forcing=6.0, omega=12.0).isel(initial_condition=1)
    here = here.isel(gap=0) if "gap" in walls else here.sel(j_1=4e-4, j_2=4e-4)
    law = gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4))
    steady = gs.Steady(**tables["steady"])
    expected = gs.respond(gs.systems.paper_oscillator(forcing=6.0), law, 12.0, 1e-3, steady=steady)
    assert here["x_max"].item() == expected.x_max
    assert here["contact_share"].item() == expected.contact_share
    study = gs.Study.from_dict(tables)
    part = gs.query(study, client, cache=tmp_path / "out-cache", forcing=slice(5.0, 7.0))
    assert part.attrs["n_computed"] == 0
    xr.testing.assert_equal(part["x_max"], found["x_max"].sel(forcing=[6.0]))
    with gs.open(tmp_path / "out" / "attractors.nc") as sets:
        assert sets["x_max"].dims == (*found["x_max"].dims[:-1], "attractor")
        assert (sets["n_attractors"] > 0).all()


_LEFTOVERS = """
import sys, urllib.request
import gapsweep as gs
from gapsweep.execution.cluster import cluster

def answer(port):
    try:
        return urllib.request.urlopen(f"http://127.0.0.1:{port}{path}").status
    except urllib.error.HTTPError as error:
        return error.code

for dashboard in (False, True):
    with cluster(1, dashboard=dashboard) as client:
        ports = [client.cluster.scheduler.http_server.port]
        ports += client.run(lambda dask_worker: dask_worker.http_server.port).values()
        for path in ("/status", "/info/main/workers.html", "/health", "/metrics"):
            print(dashboard, path, *map(answer, ports))
study = gs.Study.load("own.toml")
gs.run(study, out="out", cache="cache", workers=1).close()
"""


def test_a_run_serves_no_page_and_leaves_no_temporary_file(tables, tmp_path):
    """Though its processes end with a kill, and the code of the study has a folder of its own."""
    temporary = Path(tempfile.mkdtemp())  # short: sockets have paths of 107 characters at most
    (tmp_path / "own.py").write_text("def soft(x):\n    return 1e4 * x\n")
    (tmp_path / "own.toml").write_text(
        '[study]\nname = "own"\n'
        "[oscillator]\nmass = 3.0\nomega_n = 5.0\nzeta = 0.03\nforcing = 4.0\n"
        '[[sweep]]\nrepresentation = "own:soft"\nK_c = 1e4\n'
        'gap = [4e-4, 4e-4]\nomega = [9.0, 20.0]\n[solver]\nengine = "scipy"\nrtol = 1e-4\n'
    )
    done = subprocess.run(
        [sys.executable, "-c", _LEFTOVERS], cwd=tmp_path, capture_output=True, text=True,
        env=os.environ | {"TMPDIR": str(temporary)}, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    answers = [line.split() for line in done.stdout.splitlines()]
    off = [codes for dashboard, _, *codes in answers if dashboard == "False"]
    assert off == [["404", "404"]] * 4, done.stdout
    assert ["True", "/status", "200"] in [line[:3] for line in answers], done.stdout
    wait_until(lambda: not [*temporary.iterdir()], 10)
    temporary.rmdir()
