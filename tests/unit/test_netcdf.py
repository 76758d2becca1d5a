"""NetCDF files: complete or absent."""

import signal
import subprocess
import sys

import numpy as np
import psutil
import pytest
import xarray as xr
from tests.builders.datasets import datasets_by_place, periodic, tables

import gapsweep as gs
from gapsweep.errors import STOPPING
from gapsweep.execution.assemble import export
from gapsweep.execution.plan import plan
from gapsweep.store import netcdf
from gapsweep.store.cache import Cache


def small():
    return xr.Dataset({"x": ("t", np.arange(3.0), {"units": "m", "long_name": "displacement"})})


def test_a_folder_is_no_dataset(tmp_path):
    with pytest.raises(gs.StoreError, match=r"is a folder; name a file, as .*responses\.nc$"):
        gs.open(tmp_path)


def test_written_dataset_is_read_back(tmp_path):
    netcdf.write(small(), tmp_path / "sub" / "small.nc", {})
    with gs.open(tmp_path / "sub" / "small.nc") as read:
        xr.testing.assert_identical(read["x"].load(), small()["x"])
        assert {"created", "versions", "host", "thread_settings"} <= set(read.attrs)


def test_files_of_points_are_written_piece_by_piece_while_points_arrive(tmp_path, monkeypatch):
    monkeypatch.setattr("gapsweep.execution.layout.PIECE", 3)
    study = gs.Study.from_dict(tables(["piecewise"], np.arange(1.0, 13.0)))
    folder = tmp_path / "whole"
    whole, _ = datasets_by_place(
        folder, study, lambda at: periodic([[1e-4, 0.0]], 1.0 + at["omega"])
    )
    paths = tmp_path / "responses.nc", tmp_path / "attractors.nc"
    with Cache(folder / "cache", read_only=True) as cache:
        planned = plan(study, cache)
        planned.is_missing[[4, 11]] = True
        steps = export(planned, *paths)
        assert [next(steps) for _ in range(4)] == [True, True, False, False]
        planned.is_missing[4] = False
        assert [next(steps) for _ in range(2)] == [True, False]
        assert not any(path.exists() for path in paths)
        planned.is_missing[11] = False
        assert list(steps) == [True]
        with xr.open_dataset(paths[0]) as found:
            xr.testing.assert_equal(found.load(), whole)
        before = paths[0].stat().st_mtime_ns
        steps = export(planned, *paths)
        next(steps)
        steps.close()
    assert paths[0].stat().st_mtime_ns == before
    assert {*tmp_path.iterdir()} == {folder, *paths, tmp_path / "SHA256SUMS"}, "no temporary file"


@pytest.mark.filterwarnings("ignore:.*not checked for damage")
def test_gaps_are_selected_by_the_distances_of_their_walls(tmp_path):
    gaps = [[0.4e-3, 0.4e-3], [0.2e-3, 0.4e-3], [0.4e-3, 0.2e-3], [0.0, 0.7e-3]]
    study = tables(["piecewise"], [9.0])
    study["sweep"][0]["gap"] = gaps

    def answer(place):
        return periodic([(1e-4 * (1 + place["gap"]), 0.0)], 9.0)

    datasets_by_place(tmp_path, gs.Study.from_dict(study), answer)
    with gs.open(tmp_path / "responses.nc") as ds:
        for i, (j_1, j_2) in enumerate(gaps):
            one = ds.sel(gap=(ds.j_1 == j_1) & (ds.j_2 == j_2))
            assert one["gap"].values.tolist() == [f"{1e3 * j_1:g}/{1e3 * j_2:g}"]
            assert one["x_max"].values.ravel().tolist() == [1e-4 * (1 + i)]
        wide = ds.sel(gap=ds.j_1 + ds.j_2 > 0.65e-3)
        assert wide["gap"].values.tolist() == ["0.4/0.4", "0/0.7"]


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


@pytest.mark.parametrize("number", STOPPING)
def test_an_interrupt_waits_until_a_file_is_written(tmp_path, monkeypatch, number):
    """Within xarray it would leave its lock held: the next file would wait for ever."""
    original = xr.Dataset.to_netcdf

    def interrupted(dataset, *arguments, **options):
        signal.raise_signal(number)
        return original(dataset, *arguments, **options)

    before = signal.signal(number, signal.default_int_handler)  # as the command line has it
    monkeypatch.setattr(xr.Dataset, "to_netcdf", interrupted)
    with pytest.raises(KeyboardInterrupt):
        netcdf.write(small(), tmp_path / "small.nc", {})
    with gs.open(tmp_path / "small.nc") as read:
        assert read.sizes == {"t": 3}
    assert signal.signal(number, before) is signal.default_int_handler


@pytest.mark.parametrize("size", [0, 1, 100, 4000])
def test_torn_file_is_refused_by_name(tmp_path, size):
    path = tmp_path / "small.nc"
    netcdf.write(small(), path, {})
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(gs.StoreError, match=r"small.nc: damaged or changed since it was written"):
        gs.open(path)


def test_missing_file_is_refused_by_name(tmp_path):
    with pytest.raises(gs.StoreError, match=r"none.nc: no such file; 'gapsweep run' writes it"):
        gs.open(tmp_path / "none.nc")


def test_a_dataset_holds_its_values_unless_it_is_lazy(tmp_path):
    path = tmp_path / "small.nc"
    netcdf.write(small(), path, {})
    opened = gs.open(path)
    with gs.open(path, lazy=True) as lazy:
        assert not lazy["x"].variable._in_memory
        xr.testing.assert_identical(lazy.load(), opened)
    netcdf.write(small() + 1.0, path, {})
    np.testing.assert_array_equal(opened["x"], np.arange(3.0))
    np.testing.assert_array_equal(gs.open(path)["x"], np.arange(1.0, 4.0))
    assert not any(file.path == str(path) for file in psutil.Process().open_files())


def test_chunks_are_those_of_dask(tmp_path):
    path = tmp_path / "small.nc"
    netcdf.write(small(), path, {})
    with gs.open(path, chunks={}) as lazy, gs.open(path, chunks={"t": 3}) as whole:
        assert lazy["x"].chunks is not None
        assert whole["x"].chunks == ((3,),)
        xr.testing.assert_identical(lazy.compute(), gs.open(path))


@pytest.mark.parametrize("wrong", [None, 3, []])
def test_what_is_no_path_is_refused(wrong):
    with pytest.raises(gs.StoreError, match=r"^path = .*: must be a path, as 'data"):
        gs.open(wrong)


def test_texts_are_characters_and_come_back_as_texts(tmp_path):
    texts = np.array([["", "tanh-1e4"], ["größer", "a"]])
    with netcdf.writing(tmp_path / "texts.nc", {}) as dataset:
        for name in ("row", "column"):
            dataset.createDimension(name, 2)
        netcdf.create_texts(dataset, "label", ("row", "column"), texts)
        assert netcdf.loaded(dataset)["label"].values.tolist() == texts.tolist()
    with gs.open(tmp_path / "texts.nc") as read:
        assert read["label"].dims == ("row", "column")
        assert read["label"].values.tolist() == texts.tolist()


# More than one handle of a file with texts of variable length ended the process.
HELD = """
import gapsweep as gs, xarray as xr
block = {"representation": "piecewise", "K_c": 1e4, "gap": [4e-4, 4e-4], "omega": 9.0}
machine = {"mass": 3.0, "omega_n": 5.0, "zeta": 0.03, "forcing": 4.0}
study = gs.Study.from_dict({"study": {"name": "small"}, "oscillator": machine, "sweep": [block]})
held = gs.run(study, out="small", cache="c-cache"), xr.open_dataset("small/responses.nc").load()
for _ in range(4):
    again = gs.run(study, out="small", cache="c-cache")
print(held[0]["representation"].item(), again["gap"].item())
"""


@pytest.mark.parametrize("written_by", ["whole", "part by part"])
def test_texts_that_are_cut_or_joined_are_saved_again_without_a_warning(tmp_path, written_by):
    labels = np.array(["piecewise", "piecewise-noevents"])
    path, again = tmp_path / "labels.nc", tmp_path / "again.nc"
    if written_by == "whole":
        netcdf.write(xr.Dataset(coords={"law": labels}), path, {})
    else:
        with netcdf.writing(path, {}) as dataset:
            dataset.createDimension("law", 2)
            netcdf.create_texts(dataset, "law", ("law",), labels)
    with gs.open(path) as whole:
        parts = [whole.isel(law=[i]) for i in (1, 0, 1)]
        for some in (parts[1], xr.concat(parts, "law")):
            some.to_netcdf(again)  # warnings are errors here
            with xr.open_dataset(again) as read:
                assert read["law"].values.tolist() == some["law"].values.tolist()


def test_a_run_goes_on_beside_datasets_that_are_held(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", HELD], cwd=tmp_path, capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["piecewise", "0.4/0.4"]
