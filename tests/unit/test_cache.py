"""The point cache: exact round trip, damage, formats, versions."""

import gc
import math
import sqlite3
import subprocess
import sys
import weakref
import zlib
from contextlib import closing
from dataclasses import replace
from types import SimpleNamespace

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from tests.stored import KIND, keys, made

import gapsweep as gs
from gapsweep.cli.main import commands
from gapsweep.response.result import Responses
from gapsweep.store import filesystem, maintenance
from gapsweep.store.cache import SCHEMA_VERSION, Cache
from gapsweep.store.index import DAMAGED, MISSING
from gapsweep.store.slab import SLAB, sealed, stored
from gapsweep.study.points import NUMBERS
from gapsweep.user_code.package_digest import numerics_fingerprint

NOW = numerics_fingerprint()
finite = st.floats(allow_nan=False, allow_infinity=False)


def result(**values):
    return gs.Response(**({"status": gs.Status.OK, "x_max": 1e-3, "cpu_time": 0.25} | values))


def row(name, **values):
    """A row of the cache that holds one point."""
    (slab,) = made([name], [result(**values)])
    return slab


def seconds(cache, *names):
    return cache.seconds(keys(*names)).tolist()


responses = st.builds(
    gs.Response,
    status=st.sampled_from(gs.Status),
    extrema=st.lists(finite, max_size=5).map(tuple),
    section=st.lists(finite, max_size=3).map(lambda x: tuple(x + x)),
    multipliers=st.sampled_from([(), (0.5, 0.25, 0.5, -0.25)]),
    n_steps=st.integers(0, 2**62),
    x_max=st.floats(),
    message=st.text(st.characters(codec="utf-8"), max_size=20),
)


@given(st.lists(responses, min_size=1, max_size=5))
def test_responses_round_trip_exactly(given_ones):
    (slab,) = made(range(len(given_ones)), given_ones)
    assert slab.is_sound
    back = stored(slab).responses.rows()
    for one, other in zip(given_ones, back, strict=True):
        assert str(one) == str(other)  # NaN as well


def test_a_row_holds_but_so_many_points():
    names = range(3 * SLAB + 1)
    slabs = made(names, [result(x_max=float(name)) for name in names])
    assert [slab.n_points for slab in slabs] == [SLAB, SLAB, SLAB, 1]
    found = Responses.concatenated([stored(slab).responses for slab in slabs])
    assert found.columns["x_max"].tolist() == list(names)


def test_committed_rows_are_there_after_reopening(tmp_path):
    path = tmp_path / "new" / "cache.sqlite"
    with Cache(path) as cache:
        cache.commit([row(1), row(2, status=gs.Status.KILLED)])
    with Cache(path) as cache:
        assert cache.status(keys(1, 2, 3)).tolist() == [gs.Status.OK, gs.Status.KILLED, MISSING]
        found = cache.find(keys(3, 1))
        assert found.at.tolist() == [1]
        assert str(found.responses.row(0)) == str(result())
        assert seconds(cache, 1) == [0.25]
        assert math.isnan(*seconds(cache, 3))


def test_a_failure_never_takes_the_place_of_a_result(tmp_path):
    late = gs.Status.TIMED_OUT
    with Cache(tmp_path / "cache.sqlite") as cache:
        cache.commit([row(1), row(2, status=gs.Status.KILLED)])
        cache.commit([row(name, status=late) for name in (1, 2, 3)])
        assert cache.status(keys(1, 2, 3)).tolist() == [gs.Status.OK, late, late]
        cache.commit([row(2)])
        assert cache.status(keys(2)).tolist() == [gs.Status.OK]
    with Cache(tmp_path / "cache.sqlite") as cache:
        assert cache.status(keys(1, 2, 3)).tolist() == [gs.Status.OK, gs.Status.OK, late]


@given(st.lists(st.tuples(st.integers(0, 9), st.booleans()), min_size=1, max_size=40), st.data())
def test_the_latest_result_counts_in_whatever_pieces_it_came(history, data):
    status = {False: gs.Status.OK, True: gs.Status.KILLED}
    slabs = [row(n, status=status[failed], x_max=float(i)) for i, (n, failed) in enumerate(history)]
    expected = {}
    for i, (name, failed) in enumerate(history):
        if not failed or expected.get(name, (True, 0))[0]:
            expected[name] = failed, i
    with Cache(":memory:") as cache:
        while slabs:
            n = data.draw(st.integers(1, len(slabs)))
            cache.commit(slabs[:n])
            del slabs[:n]
            cache.status(keys(0))  # so that these are a piece of the index
        names = sorted(expected)
        found = cache.find(keys(*names))
        assert found.at.tolist() == list(range(len(names)))
        assert found.responses.columns["x_max"].tolist() == [expected[n][1] for n in names]


def test_more_keys_than_one_row_holds(tmp_path):
    names = range(1201)
    with Cache(tmp_path / "cache.sqlite") as cache:
        cache.commit(made(names, [result(x_max=float(name)) for name in names]))
        found = cache.find(keys(*names)[::-1])
        assert found.responses.columns["x_max"].tolist() == [*reversed(names)]


@pytest.mark.parametrize(
    "change",
    [
        "columns = X'00'",
        "columns = substr(columns, 1, 40) || X'00' || substr(columns, 42)",
        "status = X'03'",
        "seconds = 0.5",
        "seconds = NULL",
        "host = 'another'",
        "created = '2001-01-01'",
        'messages = \'{"0": "other"}\'',
        "identity = replace(identity, 'piecewise', 'otherwise')",
        "versions = X'ff00fe'",
        "checksum = X'00'",
    ],
)
def test_damaged_row_is_missing_and_counted(tmp_path, change):
    path = tmp_path / "cache.sqlite"
    with Cache(path) as cache:
        cache.commit([row(1), row(2)])
    with closing(sqlite3.connect(path)) as db, db:
        db.execute("PRAGMA ignore_check_constraints = ON")
        try:
            db.execute(f"UPDATE slabs SET {change} WHERE rowid = 1")
        except sqlite3.IntegrityError:
            return  # the table itself refuses it
    db.close()
    with Cache(path) as cache:
        assert cache.find(keys(1, 2)).at.tolist() == [1]
        assert cache.status(keys(1, 2)).tolist() == [DAMAGED, gs.Status.OK]
        assert maintenance.verify(cache).damaged == (keys(1)[0].tobytes().hex(),)


@pytest.mark.parametrize("change", ["keys = X'00'", "status = 'text'", "status = X''", "keys = ''"])
def test_a_row_whose_points_cannot_be_told_is_missing(tmp_path, change):
    path = tmp_path / "cache.sqlite"
    with Cache(path) as cache:
        cache.commit([row(1), row(2)])
    with closing(sqlite3.connect(path)) as db, db:
        db.execute(f"UPDATE slabs SET {change} WHERE rowid = 1")
    db.close()
    with Cache(path) as cache:
        assert cache.status(keys(1, 2)).tolist() == [MISSING, gs.Status.OK]
        assert len(maintenance.verify(cache).damaged) == 1


def test_results_under_the_keys_of_others_are_damaged(tmp_path):
    (slab,) = made([1, 2], [result(), result(x_max=2e-3)])
    swapped = sealed(replace(slab, keys=slab.keys[32:] + slab.keys[:32]))
    with Cache(tmp_path / "cache.sqlite") as cache:
        cache.commit([swapped])
        assert len(maintenance.verify(cache).damaged) == 2


def test_of_many_damaged_points_a_few_are_named_and_all_counted(tmp_path):
    path = tmp_path / "cache.sqlite"
    with Cache(path) as cache:
        cache.commit([replace(row(name), host="nobody") for name in range(8)])
    asked = ["cache", "verify", "--cache", str(path)]
    done = CliRunner().invoke(commands, asked, standalone_mode=False)
    assert (done.return_value, done.stdout) == (1, "8 points, 8 damaged\n")
    said = done.stderr.splitlines()
    assert [line.startswith("damaged point: ") for line in said] == 5 * [True] + 2 * [False]
    assert said[5] == "and 3 more"


def test_all_commands_advise_the_same_of_a_cache_of_which_nothing_is_left(tmp_path, tables):
    path = tmp_path / "cache.sqlite"
    with Cache(path) as cache:
        cache.commit([row(1)])
    path.write_bytes(path.read_bytes()[:100])
    (looked,) = raised_by(lambda: Cache(path, read_only=True))
    (ran,) = raised_by(lambda: gs.query(gs.Study.from_dict(tables), cache=path))
    advice = "move it away or choose another file with --cache"
    assert looked.endswith(f"if there are none, {advice}")
    assert ran.endswith(f"no row of a cache is left in it: {advice}")


def raised_by(call):
    with pytest.raises(gs.StoreError) as caught:
        call()
    return str(caught.value).splitlines()


def test_garbage_collection_keeps_what_the_present_code_computed(tmp_path):
    (old,) = made([2], [result()])
    old = sealed(replace(old, identity=old.identity.replace(NOW, "before")))
    with Cache(tmp_path / "cache.sqlite") as cache:
        cache.commit([row(1), old])
        assert maintenance.info(cache, NOW)["of_other_code"] == 1
        removable = maintenance.removable(cache, NOW)
        assert removable == {2}
        maintenance.remove(cache, removable)
    with Cache(tmp_path / "cache.sqlite") as cache:
        assert cache.find(keys(1, 2)).at.tolist() == [0]


def test_rows_deleted_and_given_back_by_another_process_mix_nothing_up(tmp_path):
    path = tmp_path / "cache.sqlite"
    with Cache(path) as cache, Cache(path) as other:
        cache.commit([row(n, x_max=float(n)) for n in range(4)])
        assert cache.status(keys(*range(4))).tolist() == [gs.Status.OK] * 4
        maintenance.remove(other, {1, 2})
        other.commit([row(n, x_max=float(n)) for n in (4, 5, 6)])
        for one in (cache, other):
            found = one.find(keys(*range(7)))
            assert set(found.at.tolist()) >= {2, 3, 4, 5, 6}
            # What it has read before it may still know.
            assert found.responses.columns["x_max"].tolist() == found.at.tolist()
        cache.delete_damaged()
        assert other.find(keys(*range(7))).at.tolist() == [2, 3, 4, 5, 6]


def test_export_copies_sound_rows_and_refuses_to_replace(tmp_path):
    path, copy = tmp_path / "cache.sqlite", tmp_path / "copy.sqlite"
    with Cache(path) as cache:
        cache.commit([row(1), row(2)])
        with cache.transaction():
            cache.db.execute("UPDATE slabs SET status = X'04' WHERE rowid = 1")
        assert maintenance.export(path, copy) == 1
        with pytest.raises(gs.StoreError, match="exists already"):
            maintenance.export(path, copy)
    with Cache(copy) as saved:
        assert saved.status(keys(1, 2)).tolist() == [MISSING, gs.Status.OK]


@pytest.mark.parametrize("text", ["nothing of a cache", ""])
def test_export_of_what_is_no_cache_leaves_nothing_behind(tmp_path, text):
    path, copy = tmp_path / "cache.sqlite", tmp_path / "copy.sqlite"
    with closing(sqlite3.connect(path)) as db, db:
        db.execute("PRAGMA user_version = 1")
    db.close()
    if text:
        path.write_text(text)
    with pytest.raises(gs.StoreError, match=r"cache.sqlite: "):
        maintenance.export(path, copy)
    assert [file.name for file in tmp_path.iterdir()] == ["cache.sqlite"]
    path.unlink()
    with Cache(path) as cache:
        cache.commit([row(1)])
    assert maintenance.export(path, copy) == 1


def test_a_closed_cache_is_freed_without_the_garbage_collector(tmp_path):
    gc.disable()
    try:
        with Cache(tmp_path / "cache.sqlite") as cache:
            cache.commit([row(1)])
            assert cache.find(keys(1)).at.size
        freed = weakref.ref(cache)
        del cache
        assert freed() is None
    finally:
        gc.enable()


@pytest.mark.parametrize(("fstype", "journal"), [("nfs4", "delete"), ("ext4", "wal")])
def test_no_write_ahead_log_on_network_file_systems(tmp_path, monkeypatch, fstype, journal):
    mounts = [SimpleNamespace(mountpoint="/", fstype="ext4")]
    mounts.append(SimpleNamespace(mountpoint=str(tmp_path), fstype=fstype))
    monkeypatch.setattr(filesystem.psutil, "disk_partitions", lambda all: mounts)
    with Cache(tmp_path / "cache.sqlite") as cache:
        cache.commit([row(1)])
        assert cache.on_network == (fstype == "nfs4")
        assert cache.db.execute("PRAGMA journal_mode").fetchone() == (journal,)
        assert cache.status(keys(1)).tolist() == [gs.Status.OK]


def test_file_that_is_no_database_is_refused(tmp_path):
    path = tmp_path / "cache.sqlite"
    path.write_text("not a database, but long enough to be taken for the head of one" * 20)
    with pytest.raises(gs.StoreError, match=r"cache.sqlite: file is not a database"):
        Cache(path)


@pytest.mark.parametrize("version", [1, 3, SCHEMA_VERSION + 1])
def test_cache_of_another_format_is_refused(tmp_path, version):
    path = tmp_path / "cache.sqlite"
    with closing(sqlite3.connect(path)) as db, db:
        db.execute("CREATE TABLE results (x)")
        db.execute(f"PRAGMA user_version = {version}")
    db.close()
    before = path.read_bytes()
    said = rf"format {version}, this gapsweep reads format {SCHEMA_VERSION}: move it away, or"
    for read_only in (False, True):
        with pytest.raises(gs.StoreError, match=said):
            Cache(path, read_only=read_only)
    assert path.read_bytes() == before


@pytest.mark.parametrize("bit", range(32))
def test_a_flipped_bit_in_the_format_of_the_header_loses_nothing(tmp_path, bit):
    path = tmp_path / "cache.sqlite"
    with Cache(path) as cache:
        cache.commit([row(1)])
    data = bytearray(path.read_bytes())
    data[60 + bit // 8] ^= 1 << bit % 8  # where SQLite keeps it
    path.write_bytes(data)
    for read_only in (True, False):
        with Cache(path, read_only=read_only) as cache:
            assert cache.status(keys(1)).tolist() == [gs.Status.OK]


def test_unwritable_folder_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(gs.StoreError, match=r"file: cannot be created.* with --cache"):
        Cache(tmp_path / "file" / "cache.sqlite")


def packed(**columns):
    """The columns of a row in another form than a run writes."""
    slab = row(1)
    return sealed(replace(slab, **{name: change(slab) for name, change in columns.items()}))


def _with_status(packed, status):
    unpacking = zlib.decompressobj()
    columns = unpacking.decompress(packed)
    at = 32 + 8 * len(NUMBERS)  # behind the key of the point before it, and its numbers
    assert columns[at : at + 1] == bytes([gs.Status.OK])
    changed = zlib.compress(columns[:at] + status + columns[at + 1 :])
    return changed + unpacking.unused_data


NO_RESULTS = {
    "too short": packed(columns=lambda slab: slab.columns[:-1]),
    "too long": packed(columns=lambda slab: slab.columns + b"0"),
    "not compressed": packed(columns=lambda slab: b"nonsense"),
    "another status": packed(status=lambda slab: b"\x03"),
    "a status that there is not": packed(
        status=lambda slab: b"\x63",
        columns=lambda slab: _with_status(slab.columns, b"\x63"),
    ),
    "messages": packed(messages=lambda slab: "[" * 100_000),
}


@pytest.mark.parametrize("slab", NO_RESULTS.values(), ids=NO_RESULTS.keys())
@pytest.mark.parametrize("identity", [KIND.identity, "nonsense", "[1]", "[" * 100_000])
def test_rows_that_no_run_has_written_are_one_line(tmp_path, slab, identity):
    with Cache(tmp_path / "cache.sqlite") as cache:
        cache.commit([row(2), sealed(replace(slab, identity=identity))])
        with pytest.raises(gs.StoreError, match="'gapsweep cache gc --apply' deletes it"):
            cache.find(keys(1, 2))
        assert maintenance.verify(cache).damaged == (keys(1)[0].tobytes().hex(),)
        assert maintenance.info(cache, NOW)["points"] == 2
        assert maintenance.removable(cache, NOW) == {2}


OPENING = """
import sys
from gapsweep.store.cache import Cache
for path in map(str.strip, sys.stdin):
    try:
        with Cache(path):
            print("opened", flush=True)
    except Exception as error:
        print(error, flush=True)
"""


def test_several_processes_open_a_new_cache_at_once(tmp_path):
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    openers = [subprocess.Popen([sys.executable, "-c", OPENING], **pipes) for _ in range(4)]
    answers = []
    for trial in range(60):
        for opener in openers:
            opener.stdin.write(f"{tmp_path / str(trial)}.sqlite\n")
            opener.stdin.flush()
        answers += [opener.stdout.readline().strip() for opener in openers]
    for opener in openers:
        opener.communicate()
    assert set(answers) == {"opened"}
