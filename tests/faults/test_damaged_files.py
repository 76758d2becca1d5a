"""Damaged files: a clear error or a repair, never a wrong number."""

import os
import random
import shutil

import numpy as np
import pytest
import xarray as xr
from tests.builders.cache import damaged_row, keys, made
from tests.builders.datasets import tables

import gapsweep as gs
from gapsweep import pipeline
from gapsweep.store import maintenance
from gapsweep.store.cache import Cache
from gapsweep.store.maintenance import verify
from gapsweep.user_code.package_digest import numerics_fingerprint

FLIPS, TRUNCATIONS = 500, 100


@pytest.fixture(scope="module")
def sound(tmp_path_factory, client):
    """A finished run: its study, its folder and what it computed."""
    folder = tmp_path_factory.mktemp("sound")
    steady = {"settle_tol": 1e-2, "n_periods": 16, "max_period_multiple": 8}
    whole = tables(["piecewise"], np.linspace(10.0, 20.0, 40), steady=steady)
    study = gs.Study.from_dict(whole)
    with gs.run(study, client, out=folder / "out", cache=folder / "cache") as ds:
        return study, folder, ds.load()


def damages(path, n_flips, n_truncations, seed):
    """Damaged versions of a file: one bit flipped, or the end cut off; each with a name."""
    whole = path.read_bytes()
    generator = random.Random(seed)
    for _ in range(n_flips):
        at, bit = generator.randrange(len(whole)), 1 << generator.randrange(8)
        yield f"bit {bit} at {at}", whole[:at] + bytes([whole[at] ^ bit]) + whole[at + 1 :]
    for _ in range(n_truncations):
        size = generator.randrange(len(whole))
        yield f"cut to {size}", whole[:size]


amounts = pytest.mark.parametrize(
    ("n_flips", "n_truncations"),
    [(40, 10), pytest.param(FLIPS, TRUNCATIONS, marks=pytest.mark.slow)],
)


def peak(n, generator):
    """A response of its own length."""
    extrema = tuple(generator.uniform(-1e-3, 1e-3) for _ in range(generator.randrange(300)))
    return gs.Response(status=gs.Status.OK, x_max=float(n), extrema=extrema)


def filled(path, n_points=240):
    """A cache of three segments; the bytes of every frame of each."""
    generator = random.Random(1)
    with Cache(path) as cache:
        for names in np.array_split(np.arange(n_points), 3):
            cache.commit([made([n], [peak(n, generator)])[0] for n in names.tolist()])
        found = {}
        for frame, slab in cache.slabs():
            data = frame.path.read_bytes()[frame.at : frame.end]
            found.setdefault(frame.path, {})[data] = slab.keys
    return found


def at_random(data, generator, size=1):
    return generator.randrange(len(data) - size)


def patched(data, at, new):
    return data[:at] + new + data[at + len(new) :]


def flipped(data, frames, generator):
    at = at_random(data, generator)
    return patched(data, at, bytes([data[at] ^ 1 << generator.randrange(8)]))


def zeroed(data, frames, generator):
    return patched(data, at_random(data, generator, 4096), bytes(4096))


def holed(data, frames, generator):
    at = at_random(data, generator, 3000)
    return data[:at] + data[at + 3000 :]


def inserted(data, frames, generator):
    at = at_random(data, generator)
    return data[:at] + generator.randbytes(3000) + data[at:]


def swapped(data, frames, generator):
    return b"".join(generator.sample(frames, len(frames)))


def in_head(first, size):
    """Damage of a field in the head of one frame."""

    def damaged(data, frames, generator):
        at = data.index(generator.choice(frames)) + first
        return patched(data, at, generator.randbytes(size))

    return damaged


DAMAGES = {
    "cut": lambda data, frames, generator: data[: at_random(data, generator)],
    "flipped bit": flipped,
    "zeroed page": zeroed,
    "hole": holed,
    "inserted garbage": inserted,
    "appended garbage": lambda data, frames, generator: data + generator.randbytes(5000),
    "swapped frames": swapped,
    "doubled": lambda data, frames, generator: data + data,
    "empty": lambda data, frames, generator: b"",
    "mark": in_head(0, 8),
    "serial number": in_head(40, 4),
    "lengths": in_head(44, 12),
    "digests": in_head(8, 32),
    "another version": lambda data, frames, generator: b"".join(
        patched(frame, 7, b"\x63") for frame in frames
    ),
}


@pytest.mark.filterwarnings("ignore:.*damaged, or of another version")
@pytest.mark.parametrize("what", DAMAGES)
@pytest.mark.parametrize(
    "n_trials", [10, pytest.param(60, marks=pytest.mark.slow)], ids=["few", "many"]
)
def test_damage_costs_the_frames_that_it_touches(tmp_path, what, n_trials):
    held = filled(tmp_path / "whole")
    every = keys(*range(240))
    for trial in range(n_trials):
        generator, path = random.Random(trial), tmp_path / str(trial)
        shutil.copytree(tmp_path / "whole", path)
        whole = generator.choice(list(held))
        data = DAMAGES[what](whole.read_bytes(), list(held[whole]), generator)
        (path / whole.name).write_bytes(data)
        lost = {key for frame, key in held[whole].items() if frame not in data}
        with Cache(path) as cache:
            is_there = cache.held(every)["status"] >= 0
            found = cache.found(cache.recorded(every))
            assert {every[n].tobytes() for n in np.flatnonzero(~is_there)} == lost
            assert found.at.tolist() == np.flatnonzero(is_there).tolist()
            assert found.responses.columns["x_max"].tolist() == found.at.tolist()
            assert not lost or cache.damaged == {path / whole.name}
            # What a run does: it computes what is missing, and leaves no damage behind.
            cache.commit(
                [made([n], [peak(n, generator)])[0] for n in np.flatnonzero(~is_there).tolist()]
            )
            cache.merge()
        with Cache(path) as cache:
            assert (cache.held(every)["status"] == gs.Status.OK).all()
            maintenance.clean(cache, numerics_fingerprint(), apply=True)
            assert verify(cache).is_sound
        shutil.rmtree(path)


@pytest.mark.parametrize("what", ["renamed", "removed", "copied", "foreign files"])
def test_files_that_come_and_go_change_no_number(tmp_path, what):
    held = filled(tmp_path)
    path = next(iter(held))
    if what == "renamed":
        path.rename(tmp_path / "mine.seg")
    elif what == "removed":
        path.unlink()
    elif what == "copied":
        shutil.copy(path, tmp_path / "copy.seg")
    else:
        (tmp_path / "folder.seg").mkdir()
        os.mkfifo(tmp_path / "pipe.seg")
        (tmp_path / "notes.txt").write_text("mine")
    with Cache(tmp_path) as cache:
        found = cache.found(cache.recorded(keys(*range(240))))
        assert len(found.at) == (240 - len(held[path]) if what == "removed" else 240)
        assert found.responses.columns["x_max"].tolist() == found.at.tolist()


@pytest.mark.filterwarnings("error")
def test_a_file_that_is_no_segment_is_told_and_left_alone_by_a_run(tmp_path):
    filled(tmp_path)
    (tmp_path / "theirs.seg").write_text("my own notes " * 1000)
    said = r"theirs\.seg: .*'gapsweep cache gc --apply'"
    with pytest.warns(UserWarning, match=said):
        cache = Cache(tmp_path)
    cache.merge()
    assert len(cache.found(cache.recorded(keys(*range(240)))).at) == 240
    assert (tmp_path / "theirs.seg").exists()


@pytest.mark.extended
def test_run_repairs_damaged_rows(sound, client, tmp_path):
    study, folder, truth = sound
    cache = shutil.copytree(folder / "cache", tmp_path / "cache")
    n_lost = damaged_row(cache)
    assert 0 < n_lost < 40
    with pytest.warns(UserWarning, match=r"\.seg: damaged, .* the next run recomputes"):
        repaired = gs.run(study, client, out=tmp_path / "out", cache=cache)
    with repaired:
        xr.testing.assert_equal(repaired["x_max"].load(), truth["x_max"])
    with Cache(cache) as store:
        assert verify(store).is_sound


@amounts
def test_damaged_dataset_is_refused(sound, tmp_path, n_flips, n_truncations):
    _, folder, _ = sound
    run = shutil.copytree(folder / "out", tmp_path / "out")
    for what, data in damages(run / "responses.nc", n_flips, n_truncations, seed=2):
        (run / "responses.nc").write_bytes(data)
        for use in (read_peaks, pipeline.report):
            with pytest.raises(gs.StoreError, match=r"responses.nc: damaged .* SHA256SUMS"):
                print(what, use(run))


@pytest.mark.extended
@pytest.mark.filterwarnings("ignore:.*not checked for damage")
def test_damaged_digests_never_change_a_number(sound, tmp_path):
    _, folder, truth = sound
    run = shutil.copytree(folder / "out", tmp_path / "out")
    refused = 0
    for _, data in damages(run / "SHA256SUMS", 200, 20, seed=3):
        (run / "SHA256SUMS").write_bytes(data)
        try:
            np.testing.assert_array_equal(read_peaks(run), truth["x_max"].values)
        except gs.StoreError:
            refused += 1
    assert refused > 10


def read_peaks(run):
    with gs.open(run / "responses.nc") as ds:
        return ds["x_max"].values


def test_run_writes_a_damaged_dataset_again(sound, tmp_path):
    study, folder, truth = sound
    run = shutil.copytree(folder / "out", tmp_path / "out")
    for name in ("responses.nc", "timing.nc"):
        data = bytearray((run / name).read_bytes())
        data[len(data) // 2] ^= 1
        (run / name).write_bytes(data)
    with pytest.warns(UserWarning, match="rewrites it") as told:
        again = gs.run(study, out=run, cache=folder / "cache")
    with again:
        xr.testing.assert_equal(again["x_max"].load(), truth["x_max"])
    assert [str(one.message).split(":")[0] for one in told] == [
        str(run / name) for name in ("responses.nc", "timing.nc")
    ]


def test_files_of_others_are_never_replaced(sound, tmp_path):
    study, folder, _ = sound
    out = tmp_path / "out"
    out.mkdir()
    theirs = xr.Dataset({"x": ("t", [1.0, 2.0])})
    theirs.to_netcdf(out / "timing.nc", engine="netcdf4")
    before = (out / "timing.nc").read_bytes()
    with pytest.raises(gs.StoreError, match="not written by gapsweep; move the file"):
        gs.run(study, out=out, cache=folder / "cache")
    assert (out / "timing.nc").read_bytes() == before
    (out / "timing.nc").unlink()
    (out / "report").mkdir(exist_ok=True)
    (out / "report" / "index.html").write_text("<html>my own page</html>")
    with pytest.raises(gs.StoreError, match=r"index.html: not written by gapsweep"):
        gs.run(study, out=out, cache=folder / "cache")
    assert "my own page" in (out / "report" / "index.html").read_text()
