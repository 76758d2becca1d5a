"""What the pipeline costs beside the numerics: points whose computation does nothing.

Prints, each from fresh processes:

* overhead per point of 10,000 points through two Dask workers with the durable cache, start-up,
  imports and final datasets included, and the number of files left;
* a warm re-run of 10,000 cached points: with its files up to date, and with `responses.nc` and
  `attractors.nc` to be written;
* the largest resident memory of client and scheduler (one process) at 10,000 and 100,000 points;
* CPU time per point of client and scheduler, and the number of tasks, for 2 to 256 workers: threads
  of this process that report the cost of a common point without computing it.

Run with ``python benchmarks/overhead.py``; ``--quick`` leaves out the 100,000 points and more than
two workers, and ``--clients`` measures the last item only.
"""

import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import dask

STUDY = """
oscillator = {{ mass = 3.0, omega_n = 5.0, zeta = 0.03, forcing = 4.0, alpha = 7e8 }}
[study]
name = "noop"
[[sweep]]
representation = ["piecewise"]
K_c = [{stiffnesses}]
gap = [[0.4e-3, 0.4e-3]]
omega = {{ start = 1.0, stop = 30.0, num = {n_omega} }}
"""
REPEATS = 3
WORKERS = (2, 16, 64, 256)
POINT_SECONDS = 180e-6  # CPU time of a common point of the exact law


def child(folder: str) -> None:
    """One run in which every response is the same; prints what it took."""
    begin = float(sys.argv[3])
    import gapsweep as gs
    from gapsweep import pipeline
    from gapsweep.execution.cluster import cluster

    study = gs.Study.load(Path(folder) / "noop.toml")
    with cluster(2) as client:
        client.run(do_nothing)
        pipeline.carry_out(study, client, out=Path(folder) / "out", cache=Path(folder) / "cache")
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    seconds = time.time() - begin
    with gs.open(Path(folder) / "out" / "responses.nc") as responses:
        simulated = float(responses["t_simulated"].sum())
    print(json.dumps({"seconds": seconds, "peak_mb": peak, "t_simulated": simulated}))


def client_child(folder: str, n_workers: int) -> None:
    """One computation by workers in this process; prints the cost to client and scheduler."""
    from dataclasses import replace

    from distributed import Client, LocalCluster

    import gapsweep as gs
    from gapsweep import pipeline
    from gapsweep.execution import execute
    from gapsweep.execution.cluster import _LOCAL_SETTINGS
    from gapsweep.execution.task import compute
    from gapsweep.store.cache import Cache

    done = []

    def costly(task):
        return replace(compute(task), seconds=POINT_SECONDS * sum(map(len, task.tiles)))

    async def of_loop() -> float:
        return time.thread_time()

    do_nothing()
    execute.compute = costly
    study = gs.Study.load(Path(folder) / "noop.toml")
    plan = pipeline.plan(study, Path(folder) / "none")
    options = {"processes": False, "threads_per_worker": 1, "dashboard_address": None}
    options["memory_limit"] = 0  # all workers are one process
    with (
        dask.config.set(_LOCAL_SETTINGS),
        LocalCluster(n_workers=n_workers, **options) as local,
        Client(local) as client,
        Cache(Path(folder) / "cache") as store,
    ):
        begin = time.thread_time() + client.sync(of_loop)
        execute.execute(replace(plan, cache=store), client, on_progress=lambda _: done.append(1))
        spent = time.thread_time() + client.sync(of_loop) - begin
    print(json.dumps({"us": 1e6 * spent / plan.n_points, "tasks": len(done) - 1}))


def do_nothing() -> None:
    """On a worker: give every sweep point one and the same response, without an integration."""
    import numpy as np

    from gapsweep.execution import task
    from gapsweep.response.result import Response, ResponseClass, Responses
    from gapsweep.status import Status

    same = Response(
        status=Status.OK,
        response_class=ResponseClass.PERIODIC,
        period_multiple=1,
        extrema=(1e-3, -1e-3),
        extremum_kind=(1, -1),
        n_extrema=2,
        x_max=1e-3,
        x_min=-1e-3,
        amplitude=1e-3,
        multipliers=(0.5 + 0.1j, 0.5 - 0.1j),
        multiplier_abs=0.51,
        section=(1e-3, 0.0),
        x_end=1e-3,
        v_end=0.0,
        cpu_time=1e-5,
    )
    one = Responses.of([same])
    task.respond_models = lambda models, *more: one.take(np.zeros(len(models), int))
    task._warm_up = lambda *kind: None


def run(folder: Path, n_points: int, *how: str) -> dict[str, float]:
    """A run of so many points in a fresh process, in slabs of 10,000."""
    slabs = max(1, n_points // 10_000)
    stiffnesses = ", ".join(f"{1e3 + i}" for i in range(slabs))
    text = STUDY.format(stiffnesses=stiffnesses, n_omega=n_points // slabs)
    (folder / "noop.toml").write_text(text)
    how = how or ("child", str(folder), str(time.time()))
    command = [sys.executable, __file__, *how]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def rerun(folder: Path) -> float:
    """Time from the start of the command to its end, or to the last dataset of responses."""
    begin = time.time()
    command = ["gapsweep", "run", "noop.toml", "--out", "out", "--cache", "cache"]
    fresh = not (folder / "out" / "responses.nc").exists()
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    end = os.stat(folder / "out" / "attractors.nc").st_ctime if fresh else time.time()
    return end - begin


def clients() -> None:
    for n_workers in WORKERS[: 1 if "--quick" in sys.argv else None]:
        with tempfile.TemporaryDirectory() as name:
            found = run(Path(name), 300_000, "client", name, str(n_workers))
        print(
            f"client of {n_workers} workers: {found['us']:.2f} us a point, {found['tasks']} tasks"
        )


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cold = []
        for _ in range(REPEATS):
            for path in folder.iterdir():
                shutil.rmtree(path) if path.is_dir() else path.unlink()
            cold.append(run(folder, 10_000))
        n_files = sum(path.is_file() and path.suffix != ".toml" for path in folder.rglob("*"))
        seconds = statistics.median(c["seconds"] for c in cold)
        print(f"10,000 points: {seconds:.2f} s, {seconds / 10:.3f} ms per point, {n_files} files")
        warm = statistics.median(rerun(folder) for _ in range(REPEATS))
        print(f"warm re-run, files up to date: {warm:.2f} s")
        written = []
        for _ in range(REPEATS):
            shutil.rmtree(folder / "out")
            written.append(rerun(folder))
        print(f"warm re-run, to written NetCDF: {statistics.median(written):.2f} s")
        small = statistics.median(c["peak_mb"] for c in cold)
    if "--quick" not in sys.argv:
        with tempfile.TemporaryDirectory() as name:
            large = run(Path(name), 100_000)
        growth = large["peak_mb"] / small - 1.0
        print(
            f"client and scheduler: {small:.0f} MB at 10,000, {large['peak_mb']:.0f} MB at "
            f"100,000 points ({growth:+.1%}); {large['seconds']:.0f} s"
        )
    clients()


if __name__ == "__main__":
    if sys.argv[1:2] == ["child"]:
        child(sys.argv[2])
    elif sys.argv[1:2] == ["client"]:
        client_child(sys.argv[2], int(sys.argv[3]))
    elif "--clients" in sys.argv:
        clients()
    else:
        main()
