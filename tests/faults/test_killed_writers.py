"""Writers of one cache, killed while they write and merge, and at once without any lock."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tests.builders.cache import keys

from gapsweep.store.cache import Cache
from gapsweep.store.maintenance import verify

pytestmark = pytest.mark.extended

ROOT = Path(__file__).parents[2]
WRITER = """
import sys
import gapsweep as gs
from gapsweep.store.cache import Cache
from tests.builders.cache import made
path, first, n, often = sys.argv[1], *map(int, sys.argv[2:])
with Cache(path) as cache:
    made([first], [gs.Response(status=gs.Status.OK)])  # reads the package's code once
    print("open", flush=True)
    for name in range(first, first + n):
        extrema = (float(name),) * 200
        response = gs.Response(status=gs.Status.OK, x_max=float(name), extrema=extrema)
        cache.commit(made([name], [response]))
        if name % often == 0:
            cache.merge()
        print(name, flush=True)
"""


def writer(path, first, n, often):
    command = [sys.executable, "-c", WRITER, *map(str, (path, first, n, often))]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "open\n"
    return process


def held(path, names):
    """The names of points that a cache holds, after a check of their results."""
    with Cache(path) as cache:
        found = cache.found(cache.recorded(keys(*names)))
        there = [names[i] for i in found.at.tolist()]
        assert found.responses.columns["x_max"].tolist() == there
        assert verify(cache).is_sound
    return set(there)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("n_kills", [6, pytest.param(100, marks=pytest.mark.slow)])
def test_a_kill_at_any_moment_loses_nothing_that_was_stored(tmp_path, n_kills):
    generator, said, n_met = random.Random(1), set(), 0
    for kill in range(n_kills):
        process = writer(tmp_path, 1000 * kill, 1000, 3)
        time.sleep(generator.uniform(0.0, 0.3))
        process.send_signal(signal.SIGKILL)
        # Its last line may be cut.
        said |= {int(line) for line in process.stdout.read().splitlines(True) if "\n" in line}
        process.stdout.close()
        n_met += process.wait() == -signal.SIGKILL
        assert held(tmp_path, range(1000 * (kill + 1))) >= said
    assert n_met > n_kills // 2, "most kills met a writer at work"
    assert len(said) > n_kills


@pytest.mark.filterwarnings("error")
def test_writers_at_once_need_no_lock(tmp_path):
    """Three of them merge each other's files, and two store the same points."""
    writers = [writer(tmp_path, first, 120, often) for first, often in ((0, 2), (0, 5), (60, 3))]
    with Cache(tmp_path, read_only=True) as reader:
        seen = set()
        while any(process.poll() is None for process in writers):
            found = reader.found(reader.recorded(keys(*range(180))))
            assert found.responses.columns["x_max"].tolist() == found.at.tolist()
            assert set(found.at.tolist()) >= seen, "what was there is there"
            seen = set(found.at.tolist())
    assert [process.wait() for process in writers] == [0, 0, 0]
    for process in writers:
        process.stdout.close()
    assert held(tmp_path, range(180)) == set(range(180))
    assert len(list(tmp_path.iterdir())) < 40
