"""The point cache: exact round trip, damage, formats, versions."""

import math
import shutil
import sqlite3
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import gapsweep as gs
from gapsweep.store.cache import SCHEMA_VERSION, Cache, Row, _decoded, _encoded

FIRST_VERSION = Path(__file__).parents[1] / "data" / "cache-v1.sqlite"
finite = st.floats(allow_nan=False, allow_infinity=False)


def row(key="k", **values):
    given = {"status": gs.Status.OK, "x_max": 1e-3, "cpu_time": 0.25} | values
    return Row(key, gs.Response(**given), "machine")


@given(st.lists(finite, max_size=5), finite, st.sampled_from(gs.Status), st.text(max_size=20))
def test_responses_round_trip_exactly(extrema, x_max, status, message):
    response = gs.Response(status=status, extrema=tuple(extrema), x_max=x_max, message=message)
    back = _decoded(_encoded(response))
    assert back.extrema == response.extrema
    assert (back.x_max, back.status, back.message) == (x_max, status, message)
    assert math.isnan(back.amplitude)


def test_committed_rows_are_there_after_reopening(tmp_path):
    path = tmp_path / "new" / "cache.sqlite"
    with Cache(path) as cache:
        cache.commit([(row("a"), {"omega": 1.0}), (row("b", status=gs.Status.KILLED), {})])
    with Cache(path) as cache:
        assert cache.statuses(["a", "b", "c"]) == {"a": gs.Status.OK, "b": gs.Status.KILLED}
        assert cache.rows(["a"])["a"].response.x_max == 1e-3
        assert cache.cpu_times(["a"]) == {"a": 0.25}


def test_more_keys_than_one_query_takes(tmp_path):
    keys = [f"{i:064d}" for i in range(1201)]
    with Cache(tmp_path / "cache.sqlite") as cache:
        cache.commit([(row(key), {}) for key in keys])
        assert set(cache.rows(keys)) == set(keys)


def test_damaged_row_is_missing(tmp_path):
    path = tmp_path / "cache.sqlite"
    with Cache(path) as cache:
        cache.commit([(row("a"), {}), (row("b"), {})])
    with sqlite3.connect(path) as db:
        db.execute(
            "UPDATE results SET response = replace(response, '0.001', '0.002') WHERE key='a'"
        )
    db.close()
    with Cache(path) as cache:
        assert set(cache.rows(["a", "b"])) == {"b"}
        assert set(cache.statuses(["a", "b"])) == {"b"}, "a plan must see it as missing"


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
    with pytest.raises(gs.StoreError, match=r"format 2.*choose another file with --cache"):
        Cache(path)


def test_cache_of_the_first_version_is_readable(tmp_path):
    path = tmp_path / "cache.sqlite"
    shutil.copyfile(FIRST_VERSION, path)
    with Cache(path) as cache:
        keys = [k for (k,) in cache._db.execute("SELECT key FROM results")]
        rows = cache.rows(keys)
    assert len(rows) == len(keys) == 9
    assert all(r.response.status is gs.Status.OK for r in rows.values())


def test_unwritable_folder_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(gs.StoreError, match="file: cannot be created"):
        Cache(tmp_path / "file" / "cache.sqlite")
