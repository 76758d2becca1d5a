"""Points that raise, hang, kill their process or return NaN, and workers that are killed."""

import os
import signal
import threading
import time

import numpy as np
import pytest
import xarray as xr
from tests.builders.cache import messages
from tests.builders.runs import run

import gapsweep as gs
from gapsweep.execution.cluster import cluster
from gapsweep.store.cache import Cache

pytestmark = pytest.mark.extended

LAWS = "tests.misbehaving.forces"


def message(tables, folder, index):
    study = gs.Study.from_dict(tables)
    with Cache(folder / "out-cache") as cache:
        return messages(study, cache)[index]


@pytest.fixture
def poisoned(tables):
    """Four poisons among innocent points, on the engine in which Python code can do harm."""
    names = ("raising", "killing", "leaving", "hanging", "undefined")
    tables["sweep"][0] |= {
        "representation": ["piecewise", *(f"{LAWS}:{name}" for name in names)],
        "omega": [12.0],
    }
    tables["sweep"].append(
        tables["sweep"][0] | {"representation": ["piecewise"], "omega": [9.0, 10.0, 20.0, 25.0]}
    )
    tables["solver"] = {"engine": "scipy"}
    return tables


def test_poison_points_get_their_own_status_and_all_others_complete(poisoned, tmp_path):
    with cluster(workers=2) as fragile:
        ds = run(poisoned, fragile, tmp_path, batch=9, timeout=5.0)
    status = {str(r): ds["status"].sel(representation=r).squeeze() for r in ds.representation.data}
    assert set(status.pop("piecewise").values.tolist()) == {gs.Status.OK}
    found = {name.split(":")[1]: s.sel(omega=12.0).item() for name, s in status.items()}
    assert found == {
        "raising": gs.Status.ERROR,
        "killing": gs.Status.KILLED,
        "leaving": gs.Status.KILLED,
        "hanging": gs.Status.TIMED_OUT,
        "undefined": gs.Status.MODEL_INVALID,
    }
    omega = ds.omega.values.tolist().index(12.0)
    said = [message(poisoned, tmp_path, (r, 0, 0, omega, 0)) for r in range(1, 6)]
    assert said[0] == "ArithmeticError: no force here"
    assert said[1] == "its process was ended by SIGKILL"
    assert said[2] == "its process ended with exit code 7"
    assert said[3] == "exceeded the time limit of 5 s"
    assert said[4].startswith("model_invalid before t = ")


def test_hanging_point_in_a_sweep_does_not_end_the_sweep(poisoned, tmp_path):
    block = poisoned["sweep"][0] | {"representation": [f"{LAWS}:spinning"], "omega": [12.0, 14.0]}
    poisoned["sweep"] = [block | {"initial_condition": "sweep_up"}]
    with cluster(workers=1) as fragile:
        ds = run(poisoned, fragile, tmp_path, timeout=2.0)
    assert set(ds["status"].values.ravel().tolist()) == {gs.Status.TIMED_OUT}


def test_in_process_workers_never_end_their_process(tables, tmp_path):
    tables["sweep"][0] |= {"representation": ["piecewise"], "omega": [12.0]}
    from distributed import Client

    with Client(processes=False, n_workers=1, threads_per_worker=1, dashboard_address=":0") as own:
        ds = run(tables, own, tmp_path, timeout=1e-3)
    assert ds["status"].item() == gs.Status.OK


@pytest.mark.parametrize("n_kills", [2, pytest.param(12, marks=pytest.mark.slow)])
def test_killed_workers_cost_no_point_and_blame_none(client, tables, tmp_path, n_kills):
    tables["sweep"][0] |= {"representation": ["piecewise"]}
    tables["sweep"][0]["omega"] = {"start": 6.0, "stop": 30.0, "num": 20 * n_kills}
    tables["solver"] = {"engine": "scipy"}
    quiet = run(tables, client, tmp_path / "quiet")
    with cluster(workers=2) as fragile:
        ended = threading.Event()
        kills = threading.Thread(target=kill_workers, args=(fragile, n_kills, ended))
        kills.start()
        ds = run(tables, fragile, tmp_path / "killed", batch=4)
        ended.set()
        kills.join()
    assert set(ds["status"].values.ravel().tolist()) == {gs.Status.OK}
    drop = ["cpu_time"]
    xr.testing.assert_identical(quiet.drop_vars(drop).drop_attrs(), ds.drop_vars(drop).drop_attrs())


def kill_workers(client, n_kills, ended):
    for _ in range(n_kills):
        if ended.wait(1.0):
            return
        pids = [pid for pid in client.run(os.getpid, on_error="ignore").values() if pid]
        if pids:
            os.kill(int(np.random.default_rng().choice(pids)), signal.SIGKILL)
        time.sleep(0.5)
