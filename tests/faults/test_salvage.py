"""Damaged caches: what is sound in them is saved, the rest is computed again."""

import os
import random
import shutil
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest
from tests.stored import keys, made, point

import gapsweep as gs
from gapsweep.store.cache import Cache, DamagedCacheError
from gapsweep.store.maintenance import export, verify
from gapsweep.store.salvage import salvage, sound_slabs
from gapsweep.store.slab import sealed

COMMAND = Path(sys.executable).with_name("gapsweep")
STUDY = """
[study]
name = "tiny"
[[sweep]]
representation = ["piecewise"]
K_c = [1.4e4]
gap = [[0.4e-3, 0.4e-3]]
omega = { start = 10.0, stop = 20.0, num = 300 }
[steady]
settle_tol = 1e-2
n_periods = 16
max_period_multiple = 8
"""
N_ROWS = 200


def response(n, **more):
    """A response; every tenth is too long for a page."""
    generator = random.Random(n)
    extrema = tuple(generator.uniform(-1e-3, 1e-3) for _ in range(800 if n % 10 == 0 else 60))
    values = {"status": gs.Status.OK, "x_max": float(n), "extrema": extrema, "cpu_time": 0.5}
    return gs.Response(**values | more)


def row(n, **more):
    """A row of the cache that holds one point."""
    (slab,) = made([n], [response(n, **more)])
    return slab


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "c.sqlite"
    with Cache(path) as cache:
        cache.commit([row(n) for n in range(N_ROWS)])
    return path


def zeroed(data, generator, pages):
    for _ in range(pages):
        at = 4096 * generator.randrange(len(data) // 4096)
        data[at : at + 4096] = bytes(4096)


def flipped(data, generator, bits):
    for _ in range(bits):
        data[generator.randrange(len(data))] ^= 1 << generator.randrange(8)


def swapped(data, generator, pages):
    one, other = (4096 * generator.randrange(1, len(data) // 4096) for _ in range(2))
    data[one : one + 4096] = data[other : other + 4096]


def cut(data, generator, size):
    del data[-size:]


# What was done, and how many rows it may cost.
DAMAGES = {
    "one page of the root": (lambda d, g: d.__setitem__(slice(0, 100), bytes(100)), 0),
    "tail of 5 kB": (lambda d, g: cut(d, g, 5000), 8),
    "half": (lambda d, g: cut(d, g, len(d) // 2), 130),
    "20 bits": (lambda d, g: flipped(d, g, 20), 25),
    "200 bits": (lambda d, g: flipped(d, g, 200), 120),
    "3 zeroed pages": (lambda d, g: zeroed(d, g, 3), 20),
    "a doubled page": (lambda d, g: swapped(d, g, 1), 8),
    "first page of 0xff": (lambda d, g: d.__setitem__(slice(0, 4096), b"\xff" * 4096), 4),
}


@pytest.mark.parametrize("what", DAMAGES)
@pytest.mark.parametrize("seed", range(3))
def test_sound_rows_are_saved_and_no_other(whole, tmp_path, what, seed):
    path = tmp_path / "c.sqlite"
    harm, cost = DAMAGES[what]
    data = bytearray(whole.read_bytes())
    harm(data, random.Random(seed))
    path.write_bytes(data)
    line = salvage(path)
    if line is None:
        assert what in ("20 bits", "3 zeroed pages", "a doubled page")
        return
    assert (tmp_path / "c.sqlite.damaged").read_bytes() == data
    with Cache(path) as cache:
        verdict = verify(cache)
        assert verdict.is_sound
        assert N_ROWS - cost <= verdict.n_points <= N_ROWS
        assert f"damaged; {verdict.n_points} sound results saved" in line
        found = cache.find(keys(*range(N_ROWS)))
        assert len(found.at) == verdict.n_points
        for n, one in zip(found.at.tolist(), found.responses.rows(), strict=True):
            assert str(one) == str(response(n))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["c.sqlite", "c.sqlite.damaged"]


def interrupted(*_):
    raise KeyboardInterrupt


def test_what_a_killed_salvage_had_saved_is_not_lost(whole, tmp_path, monkeypatch):
    """Killed after it had set the log aside: its rows are in the file that it was making."""
    path = tmp_path / "c.sqlite"
    shutil.copyfile(whole, path)
    with Cache(tmp_path / ".c.sqlite.salvaged") as cache:
        cache.commit([row(N_ROWS + n) for n in range(20)])
    data = bytearray(path.read_bytes())
    data[:100] = bytes(100)
    path.write_bytes(data)
    with monkeypatch.context() as killed:
        killed.setattr(Cache, "insert", interrupted)  # once more, as it writes the new file
        with pytest.raises(KeyboardInterrupt):
            salvage(path)
    assert f"{N_ROWS + 20} sound results saved" in salvage(path)
    with Cache(path) as cache:
        assert len(cache.find(keys(*range(N_ROWS + 20))).at) == N_ROWS + 20


def test_rows_of_the_log_are_saved_and_the_latest_success_wins(whole, tmp_path):
    path = tmp_path / "c.sqlite"
    shutil.copyfile(whole, path)
    other = Cache(path)  # kept open: what it commits stays in the log
    other.db.execute("PRAGMA wal_autocheckpoint = 0")
    other.commit([row(N_ROWS + n) for n in range(20)])
    other.commit([row(3, status=gs.Status.KILLED), row(4, x_max=-1.0)])
    found = sound_slabs(path).values()
    other.db.close()
    assert len(found) == N_ROWS + 22
    with Cache(tmp_path / "saved.sqlite") as saved:
        saved.commit(list(found))
        held = saved.find(keys(*range(N_ROWS + 20)))
    assert len(held.at) == N_ROWS + 20
    assert held.responses.columns["x_max"][3] == 3.0
    assert held.responses.columns["x_max"][4] in (4.0, -1.0)  # stored within one second


def test_megabytes_that_look_like_anything_are_no_obstacle(tmp_path):
    """Compressed numbers look like the head of a row some ten times in a megabyte."""
    path = tmp_path / "c.sqlite"
    generator = np.random.default_rng(1)
    with Cache(path) as cache:
        for first in range(0, 6400, 64):
            names = range(first, first + 64)
            columns = {
                name: generator.uniform(size=(64, 250 if name == "extrema" else 1)).tolist()
                for name in ("extrema", "section", "multipliers")
            }
            answers = [
                gs.Response(
                    status=gs.Status.OK,
                    cpu_time=float(n % 3),  # whole numbers, too, are stored as what they are
                    **{name: tuple(values[n - first]) for name, values in columns.items()},
                )
                for n in names
            ]
            cache.commit(made(names, answers))
    data = bytearray(path.read_bytes())
    assert len(data) > 8e6
    data[:100] = bytes(100)
    path.write_bytes(data)
    begin = time.monotonic()
    assert "6400 sound results saved" in salvage(path)
    assert time.monotonic() - begin < 30.0


@pytest.mark.parametrize("cpu_time", [0.0, 1.0, 2.0, 1e6, float("nan"), 0.1])
def test_whole_seconds_are_saved(tmp_path, cpu_time):
    path = tmp_path / "c.sqlite"
    with Cache(path) as cache:
        cache.commit([row(1, cpu_time=cpu_time)])
    (found,) = sound_slabs(path).values()
    assert found.n_points == 1


def test_files_of_others_are_left_alone(tmp_path):
    path = tmp_path / "c.sqlite"
    path.write_text("my own notes, and quite a lot of them " * 300)
    before = path.read_bytes()
    with pytest.raises(gs.StoreError, match=r"c.sqlite: file is not a database, or no row"):
        salvage(path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["c.sqlite"]


def gapsweep(folder, *arguments):
    environment = os.environ | {"GAPSWEEP_CACHE": "c.sqlite"}
    return subprocess.run(
        [COMMAND, *arguments], cwd=folder, env=environment, capture_output=True, text=True,
        timeout=100,
    )  # fmt: skip


def test_a_run_salvages_a_torn_cache_says_so_and_goes_on(tmp_path):
    (tmp_path / "tiny.toml").write_text(STUDY)
    done = gapsweep(tmp_path, "run", "tiny.toml", "--out", "out")
    assert done.returncode == 0, done.stderr
    path = tmp_path / "c.sqlite"
    torn = path.read_bytes()[:-5000]
    path.write_bytes(torn)

    planned = gapsweep(tmp_path, "plan", "tiny.toml")
    assert planned.returncode == 1
    assert planned.stderr.count("\n") == 1
    assert "the next run sets it aside and saves the sound rows" in planned.stderr
    assert path.read_bytes() == torn, "to plan is not to repair"

    exported = gapsweep(tmp_path, "cache", "export", "copy.sqlite")
    assert exported.returncode == 0, exported.stderr
    n_saved = int(exported.stdout.split(" points in ")[0])
    assert 100 < n_saved < 300

    done = gapsweep(tmp_path, "run", "tiny.toml", "--out", "out")
    assert done.returncode == 0, done.stderr
    assert f"300 points: {n_saved} from the cache, {300 - n_saved} computed" in done.stdout
    warning = f"c.sqlite: damaged; {n_saved} sound results saved, the damaged file is now"
    assert [warning in line for line in done.stderr.splitlines()].count(True) == 1
    assert (tmp_path / "c.sqlite.damaged").read_bytes() == torn
    with Cache(path) as cache:
        assert verify(cache).is_sound


def test_reading_commands_need_no_room_beside_the_cache(tmp_path):
    (tmp_path / "tiny.toml").write_text(STUDY.replace("num = 300", "num = 3"))
    done = gapsweep(tmp_path, "run", "tiny.toml", "--out", "out")
    assert done.returncode == 0, done.stderr
    # As on a file system that is mounted read-only: SQLite finds no room for its log.
    for suffix in ("-wal", "-shm"):
        (tmp_path / f"c.sqlite{suffix}").mkdir()
    before = (tmp_path / "c.sqlite").read_bytes()
    with (
        pytest.raises(sqlite3.OperationalError),
        closing(sqlite3.connect(tmp_path / "c.sqlite")) as db,
    ):
        db.execute("SELECT count(*) FROM slabs")
    for arguments, said in (
        (("plan", "tiny.toml", "--out", "out"), "hits  3"),
        (("query", "tiny.toml"), "piecewise"),
        (("cache", "export", "copy.sqlite"), "3 points in copy.sqlite"),
    ):
        done = gapsweep(tmp_path, *arguments)
        assert done.returncode == 0, done.stderr
        assert said in done.stdout
    assert (tmp_path / "c.sqlite").read_bytes() == before


def test_plan_writes_nothing(whole, tmp_path):
    path = tmp_path / "c.sqlite"
    shutil.copyfile(whole, path)
    path.chmod(0o444)
    with Cache(path, read_only=True) as cache, pytest.raises(sqlite3.OperationalError):
        cache.db.execute("DELETE FROM slabs")
    path.write_bytes(b"")
    # A run was killed before it made the table, or somebody cut the file: who knows?
    with (
        pytest.warns(UserWarning, match=r"c\.sqlite: empty, no point is stored in it"),
        Cache(path, read_only=True) as cache,
    ):
        assert list(cache.slabs()) == []
    assert path.read_bytes() == b""


def test_an_empty_cache_is_told_once(tmp_path):
    (tmp_path / "tiny.toml").write_text(STUDY)
    (tmp_path / "c.sqlite").touch()
    planned = gapsweep(tmp_path, "plan", "tiny.toml")
    assert planned.stderr.count("c.sqlite: empty, no point is stored in it\n") == 1
    assert planned.stderr.count("\n") == 1


def test_a_cache_that_cannot_be_prepared_is_closed(tmp_path):
    path = tmp_path / "c.sqlite"
    path.write_bytes(b"no database " * 1000)
    for read_only in (False, True):
        with pytest.raises(DamagedCacheError):
            Cache(path, read_only=read_only)
    opened = [file.path for file in psutil.Process().open_files()]
    assert str(path) not in opened


def test_a_row_that_no_run_has_written_is_one_line_and_can_be_deleted(tmp_path):
    (tmp_path / "tiny.toml").write_text(STUDY.replace("num = 300", "num = 1"))
    study = gs.Study.load(tmp_path / "tiny.toml")
    table = point(study, 0, 0, 0, 0, 0)
    (slab,) = made([1], [gs.Response(status=gs.Status.OK)])
    forged = replace(slab, keys=table.keys().tobytes(), columns=b"mystery")
    with Cache(tmp_path / "c.sqlite") as cache:
        cache.commit([sealed(forged)])
    for command in ("query", "explain"):
        done = gapsweep(tmp_path, command, "tiny.toml")
        assert done.returncode == 1
        assert done.stderr.count("\n") == 1
        assert "'gapsweep cache gc --apply' deletes it" in done.stderr
    assert "1 points deleted" in gapsweep(tmp_path, "cache", "gc", "--apply").stdout
    assert gapsweep(tmp_path, "plan", "tiny.toml").returncode == 0


def logged(path, n_rows):
    """A cache whose rows are in its log alone, as a killed process leaves it."""
    with Cache(path.with_name("live.sqlite")) as live:
        live.db.execute("PRAGMA wal_autocheckpoint = 0")
        live.commit([row(n) for n in range(n_rows)])
        shutil.copy(f"{live.path}-wal", f"{path}-wal")
        shutil.copy(live.path, path)


def test_an_empty_file_beside_its_log_is_damage(tmp_path):
    path = tmp_path / "c.sqlite"
    logged(path, 9)
    path.write_bytes(b"")
    for read_only in (True, False):
        with pytest.raises(DamagedCacheError, match="it is empty, but its log is not"):
            Cache(path, read_only=read_only)
    assert "9 sound results saved" in salvage(path)
    with Cache(path) as cache:
        assert len(list(cache.slabs())) == 9


def test_a_link_is_salvaged_where_the_file_lies(tmp_path):
    (tmp_path / "disk").mkdir()
    path, link = tmp_path / "disk" / "c.sqlite", tmp_path / "c.sqlite"
    logged(path, 9)
    path.write_bytes(b"")
    link.symlink_to(path)
    assert "9 sound results saved" in salvage(link)
    assert link.is_symlink()
    with Cache(link) as cache:
        assert len(list(cache.slabs())) == 9


def test_a_copy_is_not_put_beside_the_log_of_another(whole, tmp_path):
    target = tmp_path / "copy.sqlite"
    logged(target, 1)
    target.unlink()
    with pytest.raises(gs.StoreError, match="log of a cache that has gone: remove it"):
        export(whole, target)
    target.with_name("copy.sqlite-wal").unlink()
    assert export(whole, target) == N_ROWS
