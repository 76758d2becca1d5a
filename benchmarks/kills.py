"""A map of a million points, its run killed 25 times: what it costs, and whether anything changes.

    python benchmarks/kills.py FOLDER

FOLDER is that of `million.py`, with whose map the killed one is compared, value by value. Client
and workers are killed together, at random moments of the work. Ten minutes.
"""

import os
import random
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import netCDF4
import numpy as np

from gapsweep.store.cache import Cache
from gapsweep.store.maintenance import verify

RUN = "import sys; from gapsweep.cli import main; sys.argv[0] = 'gapsweep'; main()"
N_KILLS = 25


def started(folder: Path) -> subprocess.Popen:
    command = ["run", "million.toml", "--cache", "killed-cache", "--out", "killed"]
    return subprocess.Popen(
        [sys.executable, "-c", RUN, *command],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def n_stored(path: Path) -> int:
    """Points in the cache, each counted as often as it stands there."""
    if not path.exists():
        return 0
    with Cache(path, read_only=True) as store:
        return store.n_points


def differing(calm: Path, killed: Path) -> list[str]:
    """Variables that are not the same, processor time and machine left out."""
    found = []
    with netCDF4.Dataset(calm) as a, netCDF4.Dataset(killed) as b:
        for name in a.variables:
            if name in ("cpu_time", "host"):
                continue
            one, other = (np.ma.getdata(each[name][:]) for each in (a, b))
            if one.tobytes() != other.tobytes() and not np.array_equal(one, other):
                found.append(name)
    return found


def main(folder: Path) -> None:
    generator, cache = random.Random(1), folder / "killed-cache"
    n_points = n_stored(folder / "cache")
    begin, done, n_met = time.time(), 0, 0
    for kill in range(N_KILLS):
        process = started(folder)
        left = (n_points - done) // (N_KILLS - kill)
        wanted = done + generator.randrange(1, max(2, 2 * left))
        with Cache(cache) as store:
            while store.n_points < wanted and process.poll() is None:
                time.sleep(0.1)
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        n_met += process.wait() == -signal.SIGKILL
        before, done = done, n_stored(cache)
        assert done >= before, "stored points are kept"
    assert started(folder).wait() == 0, "the last run finishes"
    with Cache(cache, read_only=True) as store:
        sound = verify(store).is_sound
    names = [
        f"{file}: {name}"
        for file in ("responses.nc", "attractors.nc")
        for name in differing(folder / "out" / file, folder / "killed" / file)
    ]
    print(f"{n_met} of {N_KILLS} kills met a run at work, {time.time() - begin:.0f} s in all")
    print(f"stored twice: {n_stored(cache) - n_points} points; every row sound: {sound}")
    print(f"differing: {', '.join(names) or 'nothing'}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
