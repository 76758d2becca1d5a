"""A map of a million points, exact law, stiffness times frequency, from rest: what it costs.

Runs a study in fresh processes on two local workers, then again, and prints

* wall time times workers to the last stored point, over the processor time of the integrations;
* time of datasets and report behind that;
* the largest resident memory of the client, with the scheduler in it, and of a worker;
* processor time of the workers' processes per simulated second, beside that of `respond_all` on
  random points of the same study in this process, 4,096 at a time;
* bytes of the cache per point, beside the extrema and section values in it;
* how long it takes to open the cache, a second run to find that there is nothing to do, and a query
  of a thousand points;
* with ``--nothing``, the same with workers that answer at once: what the client sustains.

Run with ``python benchmarks/million.py FOLDER [POINTS]``; half an hour for a million.
"""

import json
import math
import subprocess
import sys
import time
from pathlib import Path

import psutil

STUDY = """
oscillator = {{ mass = 3.0, omega_n = 5.0, zeta = 0.03, forcing = 4.0, alpha = 7e8 }}
[study]
name = "million"
[[sweep]]
representation = "piecewise"
K_c = {{ start = 1e3, stop = 1e6, num = {n} }}
gap = [0.4e-3, 0.4e-3]
omega = {{ start = 1.0, stop = 30.0, num = {n} }}
"""
WORKERS = 2


def main(folder: Path, n_points: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    n = math.isqrt(n_points)
    (folder / "million.toml").write_text(STUDY.format(n=n))
    for what in ("first", "again"):
        print(what, measured(folder, what))
    print("tiles", measured(folder, "tiles"))
    print("query", measured(folder, "query"))


def measured(folder: Path, what: str) -> dict[str, float]:
    """What a fresh process says of itself, and the largest memory of it and of its workers."""
    command = [sys.executable, __file__, str(folder), what, *sys.argv[3:]]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        client, workers, spent = 0.0, 0.0, {}
        while process.poll() is None:
            time.sleep(0.5)
            try:
                one = psutil.Process(process.pid)
                client = max(client, one.memory_info().rss)
                for child in one.children(recursive=True):
                    workers = max(workers, child.memory_info().rss)
                    spent[child.pid] = sum(child.cpu_times()[:2])
            except psutil.Error:
                continue
        said = json.loads(process.stdout.read().splitlines()[-1])
    said |= {"client_mb": client / 1e6, "worker_mb": workers / 1e6}
    if "t_simulated" in said:
        said["workers_cpu"] = sum(spent.values())
        said["workers_us_per_s"] = 1e6 * said["workers_cpu"] / said["t_simulated"]
    return said


def child(folder: Path, what: str) -> None:
    begin = time.time()
    import numpy as np

    import gapsweep as gs
    from gapsweep import pipeline
    from gapsweep.store.cache import Cache

    study, cache = gs.Study.load(folder / "million.toml"), folder / "cache"
    if what == "query":
        began = time.time()
        with Cache(cache, read_only=True) as store:
            store.held(np.zeros(1, "V32"))["status"]
        opening = time.time() - began
        # The first one loads xarray and reads the package's own code for its keys.
        wanted = {
            "first": {"K_c": study.grid.K_c[-1]},
            "of_one_stiffness": {"K_c": study.grid.K_c[-2]},
            "of_one_frequency": {"omega": study.grid.omega[-1]},
        }
        found = {"opening": opening}
        for name, selected in wanted.items():
            began = time.time()
            with gs.query(study, cache=cache, **selected) as part:
                found[name] = time.time() - began
                assert part.attrs["n_hits"] == part.attrs["n_points"]
        print(json.dumps(found))
        return
    if what == "tiles":
        print(json.dumps({"response_us_per_s": responses_of(study)}))
        return
    last = {"computed": 0, "seconds": begin, "started": 0.0}

    def watch(progress) -> None:
        if progress.n_computed != last["computed"]:
            last.update(computed=progress.n_computed, seconds=time.time())
            last["client"] = time.process_time()
            if not last["started"]:
                last["started"] = last["seconds"]

    if "--nothing" in sys.argv:
        from overhead import do_nothing

        from gapsweep.execution.cluster import cluster

        with cluster(WORKERS) as client:
            client.run(do_nothing)
            pipeline.carry_out(study, client, out=folder / "out", cache=cache, on_progress=watch)
    else:
        pipeline.carry_out(
            study, out=folder / "out", cache=cache, workers=WORKERS, on_progress=watch
        )
    end = time.time()
    found = {"whole": end - begin, "behind_the_last_point": end - last["seconds"]}
    if last["computed"]:
        with Cache(cache, read_only=True) as store:
            sums = [(slab.seconds, *counted(slab)) for _, slab in store.slabs()]
        cpu, n_listed, simulated = map(sum, zip(*sums, strict=True))
        n_points = last["computed"]
        wall = last["seconds"] - begin
        found |= {
            "points": n_points,
            "to_the_first_points": last["started"] - begin,
            "to_the_last_point": wall,
            "client_cpu": last["client"],
            "t_simulated": simulated,
            "cpu_time": cpu,
            "wall_workers_over_cpu": WORKERS * wall / cpu if cpu else math.nan,
            "left_after_bound": WORKERS * wall - 1.1 * cpu - 20e-6 * n_points - 30.0,
            "cache_bytes_per_point": sum(p.stat().st_size for p in cache.iterdir()) / n_points,
            "cache_files": len(list(cache.iterdir())),
            "list_bytes_per_point": 8 * n_listed / n_points,
        }
    print(json.dumps(found))


def counted(slab) -> tuple[int, float]:
    """Stored extrema and section values, and simulated time [s]."""
    from gapsweep.store.slab import stored

    responses = stored(slab).responses
    n_listed = sum(len(responses.lists[name][0]) for name in ("extrema", "section"))
    return n_listed, float(responses.columns["t_simulated"].sum())


def responses_of(study, n_tiles: int = 6, n: int = 4096) -> float:
    """Processor time [µs] of responses of random points per simulated second."""
    import numpy as np

    from gapsweep.execution.task import Tile, respond_to

    cells = np.random.default_rng(1).permutation(study.grid.requested.size)
    spent = simulated = 0.0
    for tile in np.split(cells[: n_tiles * n], n_tiles):
        ((_, points),) = study.points(np.sort(tile))
        nothing = np.zeros(n, "V32")
        states = np.zeros((n, 2))
        asked = Tile(points, "", nothing, nothing, np.ones(n, int), states, nothing)
        respond_to(Tile.of_one(points.take([0]), states[0]))
        began = time.process_time()
        found = respond_to(asked)
        spent += time.process_time() - began
        simulated += float(found.columns["t_simulated"].sum())
    return 1e6 * spent / simulated


if __name__ == "__main__":
    if sys.argv[2:3] and sys.argv[2] in ("first", "again", "tiles", "query"):
        child(Path(sys.argv[1]), sys.argv[2])
    else:
        main(Path(sys.argv[1]), int(float(sys.argv[2])) if sys.argv[2:] else 10**6)
