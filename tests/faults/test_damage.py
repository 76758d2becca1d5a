"""Damaged files: a clear error or a repair, never a wrong number."""

import random
import shutil
from contextlib import closing

import numpy as np
import pytest
import xarray as xr
from tests.stored import damaged_row

import gapsweep as gs
from gapsweep import lookup, make
from gapsweep.store.cache import Cache
from gapsweep.store.maintenance import export, verify

FLIPS, TRUNCATIONS = 500, 100


@pytest.fixture(scope="module")
def sound(tmp_path_factory, client):
    """A finished run: its study, its folder and what it computed."""
    folder = tmp_path_factory.mktemp("sound")
    tables = {
        "study": {"name": "small"},
        "sweep": [
            {
                "representation": ["piecewise"],
                "K_c": [1.4e4],
                "gap": [[0.4e-3, 0.4e-3]],
                "omega": {"start": 10.0, "stop": 20.0, "num": 40},
            }
        ],
        "steady": {"settle_tol": 1e-2, "n_periods": 16, "max_period_multiple": 8},
    }
    study = gs.Study.from_dict(tables)
    with gs.run(study, client, out=folder / "out", cache=folder / "cache.sqlite") as ds:
        return study, folder, ds.load()


def damages(path, n_flips, n_truncations, seed):
    """The same file with one bit, or its end, changed."""
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


@amounts
def test_damaged_cache_is_refused_or_repaired(sound, tmp_path, n_flips, n_truncations):
    study, folder, truth = sound
    path = tmp_path / "cache.sqlite"
    outcomes = {"refused": 0, "repaired": 0, "unharmed": 0}
    for what, data in damages(folder / "cache.sqlite", n_flips, n_truncations, seed=1):
        for old in tmp_path.glob("cache.sqlite*"):
            old.unlink()
        path.write_bytes(data)
        try:
            planned = lookup.plan(study, path)
            with closing(Cache(path).db) as db, Cache(path) as cache:
                del db
                found = cache.find(planned.keys)
        except gs.StoreError as error:
            outcomes["refused"] += str(path) in str(error)
            continue
        peaks = truth["x_max"].values.ravel()
        assert np.array_equal(found.responses.columns["x_max"], peaks[found.at]), what
        missing = planned.n_missing
        assert missing == len(planned.keys) - len(found.at), what
        outcomes["repaired" if missing else "unharmed"] += 1
    print(f"cache: {outcomes}")
    assert sum(outcomes.values()) == n_flips + n_truncations, "each refusal names the file"
    assert min(outcomes.values()) > 0


def test_run_repairs_damaged_rows(sound, client, tmp_path):
    study, folder, truth = sound
    shutil.copyfile(folder / "cache.sqlite", tmp_path / "cache.sqlite")
    n_lost = damaged_row(tmp_path / "cache.sqlite")
    assert 0 < n_lost < 40
    with pytest.warns(UserWarning, match=f"{n_lost} damaged results, computed again"):
        repaired = gs.run(study, client, out=tmp_path / "out", cache=tmp_path / "cache.sqlite")
    with repaired:
        xr.testing.assert_equal(repaired["x_max"].load(), truth["x_max"])
    with Cache(tmp_path / "cache.sqlite") as cache:
        assert verify(cache).is_sound


def test_export_saves_what_a_torn_cache_still_holds(sound, tmp_path):
    _, folder, _ = sound
    path = tmp_path / "cache.sqlite"
    data = bytearray((folder / "cache.sqlite").read_bytes())
    data[len(data) // 2 : len(data) // 2 + 4096] = bytes(4096)
    path.write_bytes(data)
    with Cache(path) as cache:
        assert not verify(cache).is_sound
    n_saved = export(path, tmp_path / "copy.sqlite")
    with Cache(tmp_path / "copy.sqlite") as copy:
        verdict = verify(copy)
    assert verdict.is_sound
    assert verdict.n_points == n_saved


@amounts
def test_damaged_dataset_is_refused(sound, tmp_path, n_flips, n_truncations):
    _, folder, _ = sound
    run = shutil.copytree(folder / "out", tmp_path / "out")
    for what, data in damages(run / "responses.nc", n_flips, n_truncations, seed=2):
        (run / "responses.nc").write_bytes(data)
        for use in (read_peaks, make.report):
            with pytest.raises(gs.StoreError, match=r"responses.nc: damaged .* SHA256SUMS"):
                print(what, use(run))


@pytest.mark.filterwarnings("ignore:.*no SHA-256 beside it")
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
    with pytest.warns(UserWarning, match="made again") as told:
        again = gs.run(study, out=run, cache=folder / "cache.sqlite")
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
    with pytest.raises(gs.StoreError, match="not written by gapsweep, so it is left alone"):
        gs.run(study, out=out, cache=folder / "cache.sqlite")
    assert (out / "timing.nc").read_bytes() == before
    (out / "timing.nc").unlink()
    (out / "report").mkdir(exist_ok=True)
    (out / "report" / "index.html").write_text("<html>my own page</html>")
    with pytest.raises(gs.StoreError, match=r"index.html: not written by gapsweep"):
        gs.run(study, out=out, cache=folder / "cache.sqlite")
    assert "my own page" in (out / "report" / "index.html").read_text()
