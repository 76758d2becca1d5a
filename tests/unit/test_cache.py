"""The point cache: exact round trip, damage, formats, versions."""

import json
import math
import shutil
import sqlite3
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

import gapsweep as gs
from gapsweep.store import filesystem, maintenance
from gapsweep.store.cache import (
    DAMAGED,
    MISSING,
    SCHEMA_VERSION,
    Cache,
    Row,
    _decoded,
    _encoded,
    _record,
)
from gapsweep.study.points import content_key

FIRST_VERSION = Path(__file__).parents[1] / "data" / "cache-v1.sqlite"
finite = st.floats(allow_nan=False, allow_infinity=False)


def row(name="k", **values):
    given = {"status": gs.Status.OK, "x_max": 1e-3, "cpu_time": 0.25} | values
    identity = f'{{"numerics":"now","point":{{"name":"{name}"}}}}'
    return Row(content_key(identity), identity, gs.Response(**given), "machine")


def key(name):
    return row(name).key


@given(st.lists(finite, max_size=5), finite, st.sampled_from(gs.Status), st.text(max_size=20))
def test_responses_round_trip_exactly(extrema, x_max, status, message):
    response = gs.Response(status=status, extrema=tuple(extrema), x_max=x_max, message=message)
    back, _ = _decoded(_encoded(response))
    assert back.extrema == response.extrema
    assert (back.x_max, back.status, back.message) == (x_max, status, message)
    assert math.isnan(back.amplitude)


@given(st.sampled_from([float("inf"), float("-inf")]))
def test_infinities_round_trip(value):
    back, _ = _decoded(_encoded(gs.Response(status=gs.Status.OK, lyapunov=value, message="inf")))
    assert back.lyapunov == value
    assert back.message == "inf"


def test_committed_rows_are_there_after_reopening(tmp_path):
    path = tmp_path / "new" / "cache.sqlite"
    with Cache(path) as cache:
        cache.commit([row("a"), row("b", status=gs.Status.KILLED)])
    with Cache(path) as cache:
        stored = cache.status([key("a"), key("b"), key("c")])
        assert stored.tolist() == [gs.Status.OK, gs.Status.KILLED, MISSING]
        assert cache.rows([key("a")])[key("a")].response.x_max == 1e-3
        assert cache.cpu_times([key("a")]) == {key("a"): 0.25}


def test_a_failure_never_takes_the_place_of_a_result(tmp_path):
    late = gs.Status.TIMED_OUT
    with Cache(tmp_path / "cache.sqlite") as cache:
        cache.commit([row("a"), row("b", status=gs.Status.KILLED), row("c")])
        with cache.transaction():
            cache.db.execute("UPDATE results SET host = 'damage' WHERE key = ?", [key("c")])
        cache.commit([row(name, status=late) for name in "abcd"])
        found = cache.status([key(name) for name in "abcd"])
        assert found.tolist() == [gs.Status.OK, late, late, late]
        cache.commit([row("b")])
        assert cache.status([key("b")]).tolist() == [gs.Status.OK]


def test_more_keys_than_one_query_takes(tmp_path):
    rows = [row(str(i)) for i in range(1201)]
    with Cache(tmp_path / "cache.sqlite") as cache:
        cache.commit(rows)
        assert set(cache.rows([r.key for r in rows])) == {r.key for r in rows}


@pytest.mark.parametrize(
    "change",
    [
        "response = replace(response, '0.001', '0.002')",
        "status = 3",
        "cpu_time = 0.5",
        "cpu_time = NULL",
        "host = 'another'",
        "created = '2001-01-01'",
        "identity = replace(identity, 'now', 'old')",
        "response = X'ff00fe'",
        "status = 'text'",
    ],
)
def test_damaged_row_is_missing_and_counted(tmp_path, change):
    path = tmp_path / "cache.sqlite"
    with Cache(path) as cache:
        cache.commit([row("a"), row("b")])
    with sqlite3.connect(path) as db:
        db.execute(f"UPDATE results SET {change} WHERE key = ?", [key("a")])
    db.close()
    with Cache(path) as cache:
        keys = [key("a"), key("b")]
        assert set(cache.rows(keys)) == {key("b")}
        assert cache.status(keys).tolist() == [DAMAGED, gs.Status.OK]
        assert set(cache.cpu_times(keys)) == {key("b")}
        assert maintenance.verify(cache).damaged == (key("a").hex(),)


def test_row_under_the_key_of_another_is_damaged(tmp_path):
    path = tmp_path / "cache.sqlite"
    with Cache(path) as cache:
        cache.commit([row("a"), row("b", x_max=2e-3)])
    with sqlite3.connect(path) as db:
        db.execute("DELETE FROM results WHERE key = ?", [key("b")])
        db.execute("UPDATE results SET key = ? WHERE key = ?", [key("b"), key("a")])
    db.close()
    with Cache(path) as cache:
        assert cache.status([key("b")]).tolist() == [DAMAGED]


def test_garbage_collection_keeps_what_the_present_code_computed(tmp_path):
    old = '{"numerics":"before","point":{}}'
    with Cache(tmp_path / "cache.sqlite") as cache:
        cache.commit([row("a"), Row(content_key(old), old, row().response, "machine")])
        assert maintenance.info(cache, "now")["of_other_code"] == 1
        keys = maintenance.removable(cache, "now")
        assert keys == [content_key(old)]
        maintenance.remove(cache, keys)
        assert set(cache.rows([key("a"), content_key(old)])) == {key("a")}


def test_export_copies_sound_rows_and_refuses_to_replace(tmp_path):
    path, copy = tmp_path / "cache.sqlite", tmp_path / "copy.sqlite"
    with Cache(path) as cache:
        cache.commit([row("a"), row("b")])
        with cache.transaction():
            cache.db.execute("UPDATE results SET status = 4 WHERE key = ?", [key("a")])
        assert maintenance.export(path, copy) == 1
        with pytest.raises(gs.StoreError, match="exists already"):
            maintenance.export(path, copy)
    with Cache(copy) as saved:
        assert saved.status([key("a"), key("b")]).tolist() == [MISSING, gs.Status.OK]


@pytest.mark.parametrize(("fstype", "journal"), [("nfs4", "delete"), ("ext4", "wal")])
def test_no_write_ahead_log_on_network_file_systems(tmp_path, monkeypatch, fstype, journal):
    mounts = [SimpleNamespace(mountpoint="/", fstype="ext4")]
    mounts.append(SimpleNamespace(mountpoint=str(tmp_path), fstype=fstype))
    monkeypatch.setattr(filesystem.psutil, "disk_partitions", lambda all: mounts)
    with Cache(tmp_path / "cache.sqlite") as cache:
        cache.commit([row("a")])
        assert cache.on_network == (fstype == "nfs4")
        assert cache.db.execute("PRAGMA journal_mode").fetchone() == (journal,)
        assert cache.status([key("a")]).tolist() == [gs.Status.OK]


def test_file_that_is_no_database_is_refused(tmp_path):
    path = tmp_path / "cache.sqlite"
    path.write_text("not a database, but long enough to be taken for the head of one" * 20)
    with pytest.raises(gs.StoreError, match=r"cache.sqlite: file is not a database"):
        Cache(path)


def test_cache_of_another_format_is_refused(tmp_path):
    path = tmp_path / "cache.sqlite"
    with sqlite3.connect(path) as db:
        db.execute("CREATE TABLE other (x)")
        db.execute(f"PRAGMA user_version = {SCHEMA_VERSION + 1}")
    db.close()
    with pytest.raises(gs.StoreError, match=r"format 3.*choose another file with --cache"):
        Cache(path)


def test_cache_of_the_first_version_is_migrated(tmp_path):
    path = tmp_path / "cache.sqlite"
    shutil.copyfile(FIRST_VERSION, path)
    with sqlite3.connect(path) as db:
        before = dict(db.execute("SELECT key, response FROM results"))
    db.close()
    with Cache(path) as cache:
        rows = cache.rows([bytes.fromhex(k) for k in before])
        verdict = maintenance.verify(cache)
    peaks = {k: json.loads(text)["x_max"] for k, text in before.items()}
    assert {k.hex(): r.response.x_max for k, r in rows.items()} == peaks
    assert len(peaks) == 9
    assert verdict.is_sound


def test_rows_of_the_first_version_that_were_damaged_are_not_taken_over(tmp_path):
    path = tmp_path / "cache.sqlite"
    shutil.copyfile(FIRST_VERSION, path)
    with sqlite3.connect(path) as db:
        (first,) = db.execute("SELECT key FROM results").fetchone()
        db.execute("UPDATE results SET response = replace(response, '1', '2') WHERE key=?", [first])
    db.close()
    with Cache(path) as cache:
        assert cache.status([bytes.fromhex(first)]).tolist() == [MISSING]
        assert maintenance.verify(cache).n_rows == 8


def test_unwritable_folder_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(gs.StoreError, match="file: cannot be created"):
        Cache(tmp_path / "file" / "cache.sqlite")


NO_RESULTS = {
    "unknown field": '{"status":0,"mystery":1}',
    "status that there is not": '{"status":99}',
    "no status": "{}",
    "no JSON": "nonsense",
    "a list": "[]",
    "nested": "[" * 100_000,
    "text for numbers": '{"status":0,"extrema":["a"]}',
    "a number for numbers": '{"status":0,"section":1}',
    "text for a number": '{"status":0,"n_steps":"many"}',
    "number for a text": '{"status":0,"message":1}',
    "object for a number": '{"status":0,"x_max":{}}',
}


@pytest.mark.parametrize("text", NO_RESULTS.values(), ids=NO_RESULTS.keys())
@pytest.mark.parametrize("identity", [row("a").identity, "nonsense", "[1]", "[" * 100_000])
def test_rows_that_no_run_has_written_are_one_line(tmp_path, text, identity):
    with Cache(tmp_path / "cache.sqlite") as cache:
        cache.commit([row("b")])
        with cache.transaction():
            cache.insert([_record(key("a"), identity, text, 0, None, "there", "2001-01-01")])
        with pytest.raises(gs.StoreError, match="'gapsweep cache gc --apply' deletes it"):
            cache.rows([key("a"), key("b")])
        assert maintenance.verify(cache).damaged == (key("a").hex(),)
        assert maintenance.info(cache, "now")["rows"] == 2
        assert maintenance.removable(cache, "now") == [key("a")]


@pytest.mark.parametrize("status", [99, -7, 10**6])
def test_a_status_that_there_is_not_is_damage(tmp_path, status):
    with Cache(tmp_path / "cache.sqlite") as cache, cache.transaction():
        text = _encoded(row("a").response)
        cache.insert([_record(key("a"), row("a").identity, text, status, None, "", "2001-01-01")])
        assert cache.status([key("a")]).tolist() == [DAMAGED]
