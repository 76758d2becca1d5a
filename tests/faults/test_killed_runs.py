"""Runs whose own process is killed again and again, and two runs on one cache."""

import json
import os
import random
import signal
import sys
import time
from contextlib import suppress

import psutil
import pytest
import xarray as xr
from tests.builders.cache import n_stored
from tests.builders.runs import ENTRY, in_a_process, started, wait_until
from tests.builders.studies import study_text
from tests.misbehaving.calls import killing_once

import gapsweep as gs
from gapsweep.errors import ClusterError
from gapsweep.execution.cluster import cluster
from gapsweep.execution.execute import responses_from
from gapsweep.execution.workers import worker_process
from gapsweep.store.cache import Cache
from gapsweep.store.maintenance import verify

BATCH = 4
# Two workers, three tasks in flight for each.
IN_FLIGHT = 2 * 3 * BATCH


def storm(n_points, settle_tol="1e-3"):
    """A study file of so many points, which leaves a mark wherever one of half of them begins."""
    omega = f"{{ start = 6.0, stop = 30.0, num = {n_points // 2} }}"
    solver = '[solver]\nengine = "scipy"\nrtol = 1e-4\natol = 1e-7'
    labels = ["piecewise", "tests.misbehaving.forces:counted"]
    text = study_text(labels, omega, name="storm", more=solver)
    return text.replace("settle_tol = 1e-2", f"settle_tol = {settle_tol}")


def start(folder, cache, out, *options, entry=ENTRY):
    return started(
        *(folder, "run", "storm.toml", "--cache", cache, "--out", out, *options),
        command=[sys.executable, "-c", entry],
        variables={"COUNTED_LAW_LOG": str(folder / f"{out}.log")},
    )


def finish(process):
    out, errors = process.communicate(timeout=1800)
    assert process.returncode == 0, errors
    return out


def same(a, b):
    with gs.open(a) as first, gs.open(b) as second:
        drop = [name for name in ("cpu_time",) if name in first]
        xr.testing.assert_identical(
            first.drop_vars(drop).drop_attrs(deep=False),
            second.drop_vars(drop).drop_attrs(deep=False),
        )


@pytest.mark.parametrize(
    ("n_points", "n_kills"), [(40, 3), pytest.param(2000, 50, marks=pytest.mark.slow)]
)
def test_storm_of_kills_loses_nothing(tmp_path, n_points, n_kills):
    (tmp_path / "storm.toml").write_text(storm(n_points))
    finish(start(tmp_path, "calm-cache", "calm"))
    generator = random.Random(1)
    cache = tmp_path / "storm-cache"
    done = n_killed = 0
    for _ in range(n_kills):
        process = start(tmp_path, "storm-cache", "storm", "--batch", str(BATCH))
        # Kill at a random moment of the work, not of the start-up.
        wanted = done + generator.randrange(1, max(2, 2 * (n_points - done) // n_kills))
        while n_stored(cache) < wanted and process.poll() is None:
            time.sleep(0.02)
        time.sleep(generator.uniform(0.0, 0.5))
        with suppress(ProcessLookupError):  # it may have finished just before
            os.killpg(process.pid, signal.SIGKILL)  # the driver and its workers
        process.communicate()
        n_killed += process.returncode == -signal.SIGKILL
        before, done = done, n_stored(cache)
        assert done >= before, "stored points are kept"
    assert n_killed > n_kills // 2, "most kills met a run at work"
    last = finish(start(tmp_path, "storm-cache", "storm"))
    assert f"{n_points} points: {done} from the cache, {n_points - done} computed" in last
    for name in ("responses.nc", "attractors.nc"):
        same(tmp_path / "calm" / name, tmp_path / "storm" / name)
    with Cache(cache) as store:
        assert verify(store).is_sound
    # Half of the points count themselves; a point counts itself as often in every run.
    once = (tmp_path / "calm.log").stat().st_size / (n_points // 2)
    again = (tmp_path / "storm.log").stat().st_size / once - n_points // 2
    print(f"{n_kills} kills: {again:g} of the counted half of {n_points} points computed again")
    assert again <= n_kills * (IN_FLIGHT + BATCH), "what was in flight, and one commit"


@pytest.mark.extended
def test_a_worker_killed_while_the_cluster_starts_costs_one_line_at_most(tmp_path):
    (tmp_path / "storm.toml").write_text(storm(4))
    process = start(tmp_path, "cache", "out")
    is_killed = False
    while process.poll() is None and not is_killed:
        for child in psutil.Process(process.pid).children(recursive=True):
            with suppress(psutil.NoSuchProcess):
                if "forkserver" in " ".join(child.cmdline()):
                    child.kill()
                    is_killed = True
        time.sleep(0.01)
    _, errors = process.communicate(timeout=60)
    assert is_killed
    if process.returncode:  # else it was started again
        assert process.returncode == 1, errors
        assert "error: no local cluster of 2 workers" in errors.splitlines()[-1]
    assert "Traceback" not in errors


@pytest.mark.extended
def test_a_killed_run_leaves_no_process_and_its_status_says_so(tmp_path):
    (tmp_path / "storm.toml").write_text(storm(400, settle_tol="1e-6"))
    process = start(tmp_path, "cache", "out", "--batch", "2")
    while n_stored(tmp_path / "cache") < 4:
        assert process.poll() is None
        time.sleep(0.05)
    assert status(tmp_path)["state"] == "running"
    workers = psutil.Process(process.pid).children(recursive=True)
    process.kill()
    process.communicate()
    assert len(workers) > 2
    assert not psutil.wait_procs(workers, timeout=10.0)[1], "no process outlives the run"
    state = status(tmp_path)
    assert state["state"] == "died"
    assert state["points"] == 400
    assert "run again to resume" in state["message"]


def status(folder):
    return json.loads(in_a_process(folder, "status", "out", "--json").stdout)


@pytest.mark.extended
@pytest.mark.parametrize(("locks", "second"), [("locks", "one"), ("no locks", "two")])
@pytest.mark.parametrize("n_points", [120, pytest.param(800, marks=pytest.mark.slow)])
def test_two_runs_on_one_cache_share_the_work(tmp_path, n_points, locks, second):
    """Into one folder or into two; without locks, as on two hosts, they may compute a point twice.

    Of the two folders every number is the same, though each run has computed others of them.
    """
    (tmp_path / "storm.toml").write_text(storm(n_points))
    without = "" if locks == "locks" else "import gapsweep.store.work_locks as w; w.fcntl = None; "
    options = ("--workers", "1")
    both = [
        start(tmp_path, "cache", out, *options, entry=without + ENTRY) for out in ("one", second)
    ]
    texts = [finish(process) for process in both]
    counts = [int(text.split(" from the cache, ")[1].split(" computed")[0]) for text in texts]
    assert n_points <= sum(counts) <= (1.05 if locks == "locks" else 2.0) * n_points, texts
    assert min(counts) > 0, "both took part"
    with gs.open(tmp_path / "one" / "responses.nc") as ds:
        assert (ds["status"] == gs.Status.OK).all()
    same(tmp_path / "one" / "responses.nc", tmp_path / second / "responses.nc")


@pytest.mark.extended
def test_disturbances_of_a_killed_worker_are_computed_again(tmp_path, monkeypatch):
    monkeypatch.setattr("gapsweep.execution.execute.respond_fixed", killing_once)
    with cluster(workers=1) as client:
        tables = [tmp_path / "one", tmp_path / "two"]
        assert responses_from(tables, client) == ["one", "two"]
        with pytest.raises(ClusterError, match="workers died"):
            responses_from([tmp_path / "never" / "there"], client)


@pytest.mark.extended
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_a_run_interrupted_while_it_computes_disturbances_prints_one_line(tmp_path, sent):
    omega = "[9.0, 10.0]"
    more = "initial_condition = [[0.0, 0.0], [1e-3, 0.0]]"
    table = "[attractors]\nrays = 8"
    text = study_text(["piecewise"], omega, name="storm", sweep=more, more=table)
    (tmp_path / "storm.toml").write_text(text)
    entry = (
        "import gapsweep.execution.execute as execute; from tests.misbehaving.calls import busy; "
        f"execute.respond_fixed = busy; {ENTRY}"
    )
    process = start(tmp_path, "cache", "out", entry=entry)
    wait_until(lambda: n_stored(tmp_path / "cache") == 4, seconds=120)
    time.sleep(1.0)  # the disturbances begin at once
    os.killpg(process.pid, sent)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert errors.splitlines()[-1] == "interrupted; run again to resume"
    assert "Traceback" not in errors


@pytest.mark.skipif(os.name != "posix", reason="needs process groups")
def test_the_folder_of_a_run_killed_while_it_starts_is_removed(tmp_path):
    folder = tmp_path / "temporary"
    folder.mkdir()
    with worker_process(str(folder)) as process:
        process.stdin.close()  # as the end of the process that started it
        process.wait(60)
    assert not folder.exists()


@pytest.mark.extended
def test_a_run_whose_workers_are_killed_with_their_nannies_ends(tmp_path, monkeypatch):
    monkeypatch.setenv("DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT", "3s")
    (tmp_path / "storm.toml").write_text(storm(400, settle_tol="1e-6"))
    process = start(tmp_path, "cache", "out", "--batch", "2")
    wait_until(lambda: n_stored(tmp_path / "cache") >= 4, seconds=120)
    (nannies,) = psutil.Process(process.pid).children()
    workers = nannies.children(recursive=True)
    nannies.kill()
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 1, errors
    assert "error: the cluster was lost" in errors.splitlines()[-1]
    assert "Traceback" not in errors
    assert not psutil.wait_procs(workers, timeout=10.0)[1]


@pytest.mark.extended
@pytest.mark.skipif(os.name != "posix", reason="workers are forks of one process")
def test_no_worker_outlives_a_run_that_is_killed_while_its_workers_connect(tmp_path):
    """Workers try to reach their scheduler until there is one."""
    (tmp_path / "storm.toml").write_text(storm(4))
    process = start(tmp_path, "cache", "out")

    def several():
        return psutil.Process(process.pid).children(recursive=True)

    def is_worker(child):
        with suppress(psutil.NoSuchProcess):
            return "forkserver" in " ".join(child.parent().cmdline())
        return False

    wait_until(lambda: any(map(is_worker, several())), seconds=60)
    family = several()
    process.kill()
    process.communicate()
    assert not psutil.wait_procs(family, timeout=15.0)[1]
