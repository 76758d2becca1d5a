"""NetCDF files: complete or absent."""

import gc
from contextlib import suppress

import numpy as np
import psutil
import pytest
import xarray as xr

import gapsweep as gs
from gapsweep.store import netcdf


def small():
    return xr.Dataset({"x": ("t", np.arange(3.0), {"units": "m", "long_name": "displacement"})})


def test_a_folder_is_no_dataset(tmp_path):
    with pytest.raises(gs.StoreError, match=r"is a folder; name a file in it, as .*responses\.nc$"):
        gs.open(tmp_path)


def test_written_dataset_is_read_back(tmp_path):
    netcdf.write(small(), tmp_path / "sub" / "small.nc", {})
    with gs.open(tmp_path / "sub" / "small.nc") as read:
        xr.testing.assert_identical(read["x"].load(), small()["x"])
        assert {"created", "versions", "host", "thread_settings"} <= set(read.attrs)


def test_writer_that_fails_leaves_the_old_file_and_no_other(tmp_path):
    path = tmp_path / "small.nc"
    netcdf.write(small(), path, {})
    before = path.read_bytes()

    def write_half():
        with netcdf.writing(path, {}) as dataset:
            dataset.createDimension("t", 3)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_half()
    assert path.read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["SHA256SUMS", "small.nc"]


@pytest.mark.parametrize("size", [0, 1, 100, 4000])
def test_torn_file_is_refused_by_name(tmp_path, size):
    path = tmp_path / "small.nc"
    netcdf.write(small(), path, {})
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(gs.StoreError, match=r"small.nc: damaged or changed since it was written"):
        gs.open(path)


def test_missing_file_is_refused_by_name(tmp_path):
    with pytest.raises(gs.StoreError, match=r"none.nc: cannot be read"):
        gs.open(tmp_path / "none.nc")


def test_a_file_that_xarray_cannot_open_is_closed_by_the_next_reader(tmp_path, monkeypatch):
    netcdf.write(small(), tmp_path / "small.nc", {})
    closed, close = [], xr.backends.NetCDF4DataStore.close
    monkeypatch.setattr(
        xr.backends.NetCDF4DataStore, "close", lambda self: closed.append(self) or close(self)
    )

    def refuse(store):
        raise ValueError("cannot decode")

    with monkeypatch.context() as patched:
        patched.setattr(xr, "open_dataset", refuse)
        with suppress(gs.StoreError):  # which pytest would keep, and with it what it came from
            pytest.fail(f"opened: {netcdf.read(tmp_path / 'small.nc')}")
    with netcdf.read(tmp_path / "small.nc"):
        assert len(closed) == 1


def test_files_are_closed_by_the_next_reader_and_not_by_the_garbage_collector(tmp_path):
    paths = [tmp_path / f"{n}.nc" for n in range(3)]
    for path in paths:
        netcdf.write(xr.Dataset({"x": ("n", np.arange(3.0))}), path, {})

    def is_open(path):
        return any(file.path == str(path) for file in psutil.Process().open_files())

    part = netcdf.read(paths[0])["x"]
    netcdf.read(paths[1])
    gc.collect()
    assert is_open(paths[0])
    assert is_open(paths[1]), "until somebody reads again"
    with netcdf.read(paths[2]):
        assert not is_open(paths[1])
        assert part.sum() == 3.0, "what was selected still can be read"
