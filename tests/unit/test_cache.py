"""The point cache: exact round trip, precedence, merging, foreign and hostile files."""

import gc
import json
import math
import os
import shutil
import tracemalloc
import weakref
import zlib
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from tests.builders.cache import KIND, keys, made
from tests.builders.studies import small_study

import gapsweep as gs
from gapsweep import pipeline
from gapsweep.cli.main import commands
from gapsweep.execution.plan import plan
from gapsweep.execution.task import Tile
from gapsweep.response.result import Response, Responses
from gapsweep.status import Status
from gapsweep.store import maintenance
from gapsweep.store.cache import Cache
from gapsweep.store.index import MISSING
from gapsweep.store.segments import packed, scan, write
from gapsweep.store.slab import SLAB, stored
from gapsweep.study.points import KEY
from gapsweep.user_code.package_digest import numerics_fingerprint

NOW = numerics_fingerprint()
OK, KILLED, LATE = gs.Status.OK, gs.Status.KILLED, gs.Status.TIMED_OUT
finite = st.floats(allow_nan=False, allow_infinity=False)


def result(**values):
    return gs.Response(**({"status": OK, "x_max": 1e-3, "cpu_time": 0.25} | values))


def one(name, **values):
    """A slab that holds one point."""
    (slab,) = made([name], [result(**values)])
    return slab


def peaks(cache, *names):
    found = cache.found(cache.recorded(keys(*names)))
    return dict(zip(found.at.tolist(), found.responses.columns["x_max"].tolist(), strict=True))


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
    back = stored(slab).responses.rows()
    for response, other in zip(given_ones, back, strict=True):
        assert str(response) == str(other)  # NaN as well


def test_a_slab_holds_but_so_many_points():
    names = range(3 * SLAB + 1)
    slabs = made(names, [result(x_max=float(name)) for name in names])
    assert [slab.n_points for slab in slabs] == [SLAB, SLAB, SLAB, 1]
    found = Responses.concatenated([stored(slab).responses for slab in slabs])
    assert found.columns["x_max"].tolist() == list(names)


def test_committed_slabs_are_there_after_reopening(tmp_path):
    path, names = tmp_path / "new" / "cache", range(1201)
    with Cache(path) as cache:
        cache.commit(made(names, [result(x_max=float(name)) for name in names]))
        cache.commit([one(2000, status=KILLED)])
    with Cache(path, read_only=True) as cache:
        assert cache.held(keys(1, 2000, 3000))["status"].tolist() == [OK, KILLED, MISSING]
        assert peaks(cache, *reversed(names)) == dict(enumerate(reversed(names)))
        assert cache.seconds(cache.held(keys(1))).tolist() == [0.25]
        assert math.isnan(*cache.seconds(cache.held(keys(3000))))


@given(st.lists(st.tuples(st.integers(0, 9), st.booleans()), min_size=1, max_size=40), st.data())
def test_the_latest_result_counts_and_no_failure_takes_its_place(tmp_path_factory, history, data):
    """Whatever pieces it came in, which process wrote it, and whether it was merged meanwhile."""
    slabs = [
        one(name, status=KILLED if failed else OK, x_max=float(i))
        for i, (name, failed) in enumerate(history)
    ]
    expected = {}
    for i, (name, failed) in enumerate(history):
        if not failed or expected.get(name, (True, 0))[0]:
            expected[name] = failed, float(i)
    path = tmp_path_factory.mktemp("cache")
    with Cache(path) as first, Cache(path) as second:
        while slabs:
            n = data.draw(st.integers(1, len(slabs)))
            writer = data.draw(st.sampled_from([first, second]))
            writer.commit(slabs[:n])
            del slabs[:n]
            if data.draw(st.booleans()):
                writer.merge()
        with Cache(path) as third:
            for cache in (first, second, third):
                assert peaks(cache, *expected) == dict(enumerate(v for _, v in expected.values()))


def test_merging_leaves_one_file_with_every_result(tmp_path):
    with Cache(tmp_path) as cache, Cache(tmp_path, read_only=True) as reader:
        for name in range(9):
            cache.commit([one(name, x_max=float(name))])
        assert len(peaks(reader, 0)) == 1
        shutil.copy(next(tmp_path.glob("*.seg")), tmp_path / "copy.seg")
        (tmp_path / "notes.txt").write_text("mine")
        cache.merge()
        assert len(list(tmp_path.glob("*.seg"))) == 1
        for each in (cache, reader):
            assert peaks(each, *range(9)) == {n: float(n) for n in range(9)}
        assert cache.n_points == 9
    assert maintenance.verify(Cache(tmp_path)).is_sound
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_many_commits_leave_few_files(tmp_path):
    with Cache(tmp_path) as cache:
        for name in range(100):
            cache.commit([one(name)])
        assert len(list(tmp_path.iterdir())) < 40
        assert cache.n_points == 100


def test_garbage_collection_keeps_what_the_present_code_computed(tmp_path):
    (old,) = made([2], [result()])
    old = replace(old, identity=old.identity.replace(NOW, "before"))
    with Cache(tmp_path) as cache:
        cache.commit([one(1), old])
        assert maintenance.info(cache, NOW)["of_other_code"] == 1
    call("gc", tmp_path)
    with Cache(tmp_path) as cache:
        assert list(peaks(cache, 1, 2)) == [0, 1]
    assert "1 points" in call("gc", tmp_path, "--apply").stdout
    with Cache(tmp_path) as cache:
        assert list(peaks(cache, 1, 2)) == [0]


def call(command, path, *options):
    asked = ["cache", command, "--cache", str(path), *options]
    return CliRunner().invoke(commands, asked, standalone_mode=False)


def test_what_a_cache_holds_is_said_by_status(tmp_path):
    with Cache(tmp_path) as cache:
        cache.commit([*made([1, 2], [result(), result()]), one(3, status=LATE)])
    told = json.loads(call("info", tmp_path, "--json").stdout)
    assert (told["points"], told["status"]) == (3, {"ok": 2, "timed_out": 1})
    assert told["bytes"] == sum(path.stat().st_size for path in tmp_path.iterdir())


def test_a_closed_cache_is_freed_without_the_garbage_collector(tmp_path):
    gc.disable()
    try:
        with Cache(tmp_path) as cache:
            cache.commit([one(1)])
            assert cache.found(cache.recorded(keys(1))).at.size
        freed = weakref.ref(cache)
        del cache
        assert freed() is None
    finally:
        gc.enable()


@pytest.mark.parametrize("make", [lambda p: p.write_bytes(b"SQLite format 3\0" * 99), os.mkfifo])
def test_what_is_no_folder_is_refused_in_one_line(tmp_path, tables, make):
    path = tmp_path / "cache.sqlite"
    make(path)
    study = gs.Study.from_dict(tables)
    for use in (Cache, lambda p: pipeline.plan(study, p), lambda p: gs.query(study, cache=p)):
        with pytest.raises(gs.StoreError, match=r"cache\.sqlite: .*choose a folder") as told:
            use(path)
        assert "\n" not in str(told.value)


def test_a_folder_that_cannot_be_made_is_refused_in_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(gs.StoreError, match=r"file.* with --cache"):
        Cache(tmp_path / "file" / "cache")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_where_nothing_can_be_written_is_read(tmp_path):
    with Cache(tmp_path) as cache:
        cache.commit([one(1)])
        tmp_path.chmod(0o555)
        with pytest.raises(gs.StoreError, match="cannot be written"):
            cache.commit([one(2)])
    with Cache(tmp_path, read_only=True) as cache:
        assert list(peaks(cache, 1, 2)) == [0]
    tmp_path.chmod(0o755)


def _with_status(columns, status):
    unpacking = zlib.decompressobj()
    data = unpacking.decompress(columns)
    at = 32 + 8 * len(KIND.numbers)  # behind the key of the point before it, and its numbers
    assert data[at : at + 1] == bytes([OK])
    return zlib.compress(data[:at] + status + data[at + 1 :])


SOUND = one(1)
HOSTILE = {
    "too short": {"columns": SOUND.columns[:-1]},
    "too long": {"columns": SOUND.columns + b"0"},
    "not compressed": {"columns": b"nonsense"},
    "a bomb": {"columns": zlib.compress(bytes(2**28))},
    "another status": {"status": b"\x03"},
    "no status": {"status": b"\x63", "columns": _with_status(SOUND.columns, b"\x63")},
    "messages": {"messages": "[" * 100_000},
    "identity": {"identity": "[" * 100_000},
    "no identity": {"identity": "[1]"},
}


@pytest.mark.parametrize("change", HOSTILE.values(), ids=HOSTILE)
def test_a_hostile_frame_with_sound_checksums_is_one_line_and_can_be_removed(tmp_path, change):
    with Cache(tmp_path) as cache:
        cache.commit([one(2), replace(SOUND, **change)])
        with pytest.raises(gs.StoreError, match="'gapsweep cache gc --apply' removes it"):
            cache.found(cache.recorded(keys(1, 2)))
        assert maintenance.info(cache, NOW)["points"] == 2
    assert call("verify", tmp_path).return_value == 1
    call("gc", tmp_path, "--apply")
    assert call("verify", tmp_path).return_value == 0
    with Cache(tmp_path) as cache:
        assert list(peaks(cache, 1, 2)) == [1]


def test_results_under_the_keys_of_others_are_damage(tmp_path):
    (slab,) = made([1, 2], [result(), result(x_max=2e-3)])
    with Cache(tmp_path) as cache:
        cache.commit([replace(slab, keys=slab.keys[32:] + slab.keys[:32])])
        assert not maintenance.verify(cache).is_sound


def test_points_of_a_sweep_after_one_without_an_end_are_sound(tmp_path):
    """They start where an earlier point ended, while their keys name the one before."""
    tables = small_study()
    tables["sweep"][0] |= {"representation": "poly-13", "initial_condition": "sweep_up"}
    study = gs.Study.from_dict(tables)
    (block,) = plan(study).blocks()
    ((rows, table),) = block.tables
    about = table.kind.identity, block.keys, block.previous(rows), np.array([3])
    tile = Tile(table, *about, np.zeros((1, 2)), np.zeros(1, KEY))
    ended = result(x_end=1e-3, v_end=0.0)
    lost = Response(status=Status.OUT_OF_FIT_RANGE, message="left the range of the fit")
    (slab,) = tile.slabs(Responses.of([ended, lost, ended]), "machine")
    with Cache(tmp_path) as cache:
        cache.commit([slab])
        assert maintenance.verify(cache) == maintenance.Verdict(3, ())
        assert maintenance.clean(cache, NOW, apply=True) == (0, 0)


@pytest.mark.parametrize("at", [44, 48, 52])
def test_forged_sizes_allocate_nothing(tmp_path, at):
    """Number of points, bytes of text, bytes of columns."""
    frame = bytearray(packed(SOUND, 1))
    frame[at : at + 4] = b"\xff\xff\xff\x7f"
    write(tmp_path, [bytes(frame)])
    (path,) = tmp_path.iterdir()
    os.truncate(path, 2**28)  # a hole that could hold them
    tracemalloc.start()
    try:
        assert scan(path) == ([], False)
        assert tracemalloc.get_traced_memory()[1] < 2**23
    finally:
        tracemalloc.stop()


def test_a_forged_number_of_a_commit_does_not_end_the_numbers(tmp_path):
    write(tmp_path, [packed(one(1), 2**40)])
    with Cache(tmp_path) as cache:
        cache.commit([one(1, x_max=5.0)])
        assert cache.held(keys(1))["status"].tolist() == [OK]
