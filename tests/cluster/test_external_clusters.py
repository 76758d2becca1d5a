"""Clusters started by hand: other code, TLS, lost schedulers, workers that come and go."""

import asyncio
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path

import numpy as np
import psutil
import pytest
import xarray as xr
from benchmarks import overhead
from distributed import Client, LocalCluster
from tests.builders.cache import n_stored
from tests.builders.runs import in_a_process, started, wait_until
from tests.builders.studies import study_text

import gapsweep as gs

pytestmark = pytest.mark.extended

SOURCES = Path(gs.__file__).parent
ROOT = Path(__file__).parents[2]


@contextmanager
def dask(*arguments, **environment):
    """A ``dask`` command in the background, ended with the block."""
    command = [sys.executable, "-m", "dask", *arguments]
    process = subprocess.Popen(
        command,
        env={"PYTHONPATH": str(ROOT)} | os.environ | environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextmanager
def scheduler(*arguments, protocol="tcp", **environment):
    address = f"{protocol}://127.0.0.1:{(port := free_port())}"
    options = ["--host", f"{protocol}://127.0.0.1", "--port", str(port), "--no-dashboard"]
    with dask("scheduler", *options, *arguments, **environment) as process:
        deadline = time.monotonic() + 60
        while True:
            try:
                socket.create_connection(("127.0.0.1", port), timeout=1).close()
                break
            except OSError:
                assert process.poll() is None
                assert time.monotonic() < deadline
                time.sleep(0.1)
        yield address, process


def worker(address, *arguments, **environment):
    options = ["--nthreads", "1", "--no-dashboard", "--host", "127.0.0.1"]
    return dask("worker", address, *options, *arguments, **environment)


def run(tables, folder, address, **options):
    study = gs.Study.from_dict(tables)
    return gs.run(study, out=folder / "out", cache=folder / "c-cache", scheduler=address, **options)


def stored(folder):
    return n_stored(folder / "c-cache")


@pytest.fixture
def slow(tables):
    """A study of many points of some tenths of a second."""
    tables["sweep"][0] |= {"representation": ["piecewise"]}
    tables["sweep"][0]["omega"] = {"start": 8.0, "stop": 30.0, "num": 36}
    tables["solver"] = {"engine": "scipy", "rtol": 1e-8}
    return tables


def test_cluster_started_by_hand_computes_the_study(tables, tmp_path):
    with (
        scheduler() as (address, _),
        worker(address),
        worker(address, "--no-nanny"),
        run(tables, tmp_path, address) as ds,
    ):
        assert (ds["status"] == gs.Status.OK).all()


def with_other_numerics(folder):
    copy = shutil.copytree(SOURCES, folder / "other" / "gapsweep")
    status = copy / "status.py"
    status.write_text(
        status.read_text().replace("NOT_REQUESTED = 1", "NOT_REQUESTED = 1\n    X = 12")
    )
    return copy.parent


def without_gapsweep(folder):
    broken = folder / "broken" / "gapsweep"
    broken.mkdir(parents=True)
    (broken / "__init__.py").write_text("raise ImportError('no gapsweep here')")
    return broken.parent


@pytest.mark.parametrize(
    ("installed", "reason"),
    [
        (with_other_numerics, r"tcp://.* runs gapsweep with the sources .*install the"),
        (without_gapsweep, r"cannot run gapsweep .* install the same version"),
    ],
)
class TestWorkerWithOtherCode:
    def test_a_cluster_of_such_workers_is_refused(self, installed, reason, tables, tmp_path):
        with (
            scheduler() as (address, _),
            worker(address, PYTHONPATH=str(installed(tmp_path))),
            pytest.raises(gs.ClusterError, match=reason),
        ):
            run(tables, tmp_path, address)
        assert stored(tmp_path) == 0

    def test_one_that_joins_late_leaves_and_the_run_goes_on(
        self, installed, reason, slow, tmp_path, recwarn
    ):
        other = {"PYTHONPATH": str(installed(tmp_path))}
        with ExitStack() as joined, scheduler() as (address, _), worker(address):

            def join(progress):
                if progress.n_computed >= 3 and not late:
                    late.append(joined.enter_context(worker(address, **other)))

            late = []
            with run(slow, tmp_path, address, batch=1, on_progress=join) as ds:
                assert (ds["status"] == gs.Status.OK).all()
            assert late[0].wait(timeout=30) == 0
        if installed is with_other_numerics:  # without gapsweep it closes itself
            (told,) = [
                str(each.message) for each in recwarn if "stopped using" in str(each.message)
            ]
            assert re.search(reason, told)


def test_a_cluster_that_starts_workers_when_there_is_work_gets_it(tables, tmp_path):
    stages = []
    with (
        LocalCluster(n_workers=0, processes=False, dashboard_address=":0") as started,
        Client(started) as client,
    ):
        started.adapt(minimum=0, maximum=2, interval="100ms")
        study = gs.Study.from_dict(tables)
        with gs.run(
            study, client, out=tmp_path / "out", cache=tmp_path / "c-cache",
            on_progress=lambda progress: stages.append(progress.stage),
        ) as ds:  # fmt: skip
            assert (ds["status"] == gs.Status.OK).all()
    assert "waiting for workers" in stages
    assert any(re.search("kernels of (piecewise|tanh)", stage) for stage in stages)


def test_a_run_waits_until_the_first_worker_joins_and_says_so(tables, tmp_path):
    with ExitStack() as joined, scheduler() as (address, _):

        def join(progress):
            if progress.stage == "waiting for workers" and not workers:
                heard_of.add(json.loads((tmp_path / "out" / "run.json").read_text())["updated"])
                if len(heard_of) > 1 or time.monotonic() > deadline:
                    workers.append(joined.enter_context(worker(address)))

        heard_of, workers, deadline = set(), [], time.monotonic() + 15
        with run(tables, tmp_path, address, on_progress=join) as ds:
            assert (ds["status"] == gs.Status.OK).all()
    assert len(heard_of) > 1, "the state of the run is kept up to date meanwhile"


def test_lost_scheduler_is_a_clear_error_and_the_run_resumes(client, slow, tmp_path):
    with scheduler() as (address, process), worker(address):

        def kill():
            while stored(tmp_path) < 3:
                time.sleep(0.1)
            os.killpg(process.pid, signal.SIGKILL)

        killer = threading.Thread(target=kill)
        killer.start()
        with pytest.raises(gs.ClusterError, match=r"lost.*run again to resume"):
            run(slow, tmp_path, address, batch=1)
        killer.join()
    kept = stored(tmp_path)
    assert 3 <= kept < 36
    study = gs.Study.from_dict(slow)
    counts = []
    with gs.run(
        study, client, out=tmp_path / "out", cache=tmp_path / "c-cache",
        on_progress=lambda p: counts.append((p.n_hits, p.n_computed)),
    ):  # fmt: skip
        assert counts[-1] == (kept, 36 - kept)


def test_a_run_prints_one_line_of_a_lost_scheduler(tmp_path):
    omega = "{ start = 8.0, stop = 30.0, num = 36 }"
    solver = '[solver]\nengine = "scipy"\nrtol = 1e-8'
    (tmp_path / "tiny.toml").write_text(study_text(["piecewise"], omega, more=solver))
    with scheduler() as (address, process), worker(address):
        where = "--cache", "c-cache", "--scheduler", address
        command = started(tmp_path, "run", "tiny.toml", "--batch", "1", *where)
        wait_until(lambda: stored(tmp_path) >= 3)
        os.killpg(process.pid, signal.SIGKILL)
        _, errors = command.communicate(timeout=60)
    assert command.returncode == 1
    assert errors.splitlines()[-1].startswith("error: the cluster was lost")
    assert "Traceback" not in errors
    assert " - ERROR - " not in errors


def test_workers_may_join_and_leave(slow, tmp_path):
    with scheduler() as (address, _), worker(address):

        def come_and_go():
            while stored(tmp_path) < 3:
                time.sleep(0.1)
            with worker(address):
                reached = stored(tmp_path)
                while stored(tmp_path) < reached + 8:
                    time.sleep(0.1)

        other = threading.Thread(target=come_and_go)
        other.start()
        with run(slow, tmp_path, address, batch=1) as ds:
            assert (ds["status"] == gs.Status.OK).all()
        other.join()


def test_local_cluster_listens_on_the_loopback_only(client):
    mine = psutil.Process()
    processes = [mine, *mine.children(recursive=True)]
    listening = {c.laddr.ip for p in processes for c in p.net_connections() if c.status == "LISTEN"}
    assert listening == {"127.0.0.1"}
    assert re.match(r"http://127\.0\.0\.1:\d+/", client.dashboard_link)


STRANGER = """
import os, sys
from distributed import Client
with Client(sys.argv[1], timeout=5) as client:
    print(client.run_on_scheduler(os.getpid), client.run(os.getpid))
"""


def test_another_process_cannot_join_the_local_cluster(client):
    address = client.scheduler_info()["address"]
    port = address.rsplit(":", 1)[1]
    for there in (address, f"tcp://127.0.0.1:{port}"):
        command = [sys.executable, "-c", STRANGER, there]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
        assert done.returncode != 0
        assert done.stdout == ""


@pytest.fixture
def certificate(tmp_path):
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("needs the openssl command")
    key, certificate = tmp_path / "key.pem", tmp_path / "cert.pem"
    command = [
        openssl, "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj",
        "/CN=localhost", "-keyout", str(key), "-out", str(certificate),
    ]  # fmt: skip
    subprocess.run(command, check=True, capture_output=True)
    return key, certificate


def test_tls_address_passes_through(tables, tmp_path, certificate):
    key, cert = map(str, certificate)
    files = ["--tls-ca-file", cert, "--tls-cert", cert, "--tls-key", key]
    tls = "DASK_DISTRIBUTED__COMM__TLS__"
    settings = {f"{tls}CA_FILE": cert, f"{tls}CLIENT__CERT": cert, f"{tls}CLIENT__KEY": key}
    study = tmp_path / "tls.toml"
    study.write_text(study_text(["piecewise"], "[12.0]", name="tls"))
    with scheduler(*files, protocol="tls") as (address, _), worker(address, *files):
        command = (tmp_path, "run", "tls.toml", "--scheduler", address)
        in_a_process(*command, variables=settings)
        without = in_a_process(*command, "--cache", "other-cache", code=1)
    *_, line = without.stderr.splitlines()  # behind what the run has said of its progress
    assert f"scheduler {address}: cannot be reached" in line


def test_basins_on_a_cluster_are_those_of_one_process(client):
    axes = {"x": np.linspace(-1e-3, 1e-3, 70), "v": np.linspace(-0.05, 0.05, 60)}
    law = gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4))
    asked = (gs.systems.paper_oscillator(), law, 19.0)
    steady = gs.Steady(settle_tol=1e-2, n_periods=16, max_period_multiple=8)
    here = gs.basins(*asked, **axes, steady=steady)
    there = gs.basins(*asked, **axes, steady=steady, client=client)
    xr.testing.assert_identical(here, there)
    own = gs.law(lambda x: 0.0, 1.0, gs.Gap(0.0, 0.0))
    with pytest.raises(gs.ModelError, match="client: not allowed with user laws"):
        gs.basins(gs.systems.paper_oscillator(), own, 19.0, **axes, client=client)


def test_an_asynchronous_client_is_refused_and_disturbs_no_run_without_it(tables, tmp_path):
    study, cache = gs.Study.from_dict(tables), tmp_path / "c-cache"

    async def main():
        options = {"processes": False, "asynchronous": True, "dashboard_address": ":0"}
        async with (
            LocalCluster(n_workers=1, **options) as started,
            Client(started, asynchronous=True) as client,
        ):
            for call in (partial(gs.run, out=tmp_path / "out"), gs.query):
                with pytest.raises(gs.ClusterError, match="must be synchronous"):
                    call(study, client, cache=cache)
            assert stored(tmp_path) == 0
            with gs.run(study, out=tmp_path / "out", cache=cache) as ds:
                assert (ds["status"] == gs.Status.OK).all()

    asyncio.run(main())


def test_the_benchmark_of_overhead_integrates_nothing(tmp_path):
    assert overhead.run(tmp_path, 60)["t_simulated"] == 0.0
