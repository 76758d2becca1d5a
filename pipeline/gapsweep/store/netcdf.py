"""NetCDF files of a run: written atomically, read with a check of their SHA-256.

The netCDF library is not thread-safe: all writing happens in the main process, under one
lock. A file is read once before it takes its place. Its attribute `made_from` holds the digests
of its inputs, so that gapsweep rewrites it only when these have changed.
"""

import json
import os
import platform
import signal
import tempfile
import threading
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import STOPPING, GapsweepError, StoreError
from gapsweep.store.artefact import digests, is_intact, recording

if TYPE_CHECKING:
    import xarray as xr

LOCK = threading.RLock()
_RECORDED_PACKAGES = ("gapsweep", "numpy", "scipy", "numba", "dask", "distributed", "xarray")
_THREAD_SETTINGS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
CONVENTIONS = "CF-1.11"
SOURCE = "gapsweep"
_CHECKED = {"fletcher32": True, "zlib": True, "complevel": 1}


@contextmanager
def writing(path: Path, attributes: Mapping[str, Any]) -> Iterator[netCDF4.Dataset]:
    """An open netCDF4 dataset that becomes `path` once it is complete and readable.

    The block holds `LOCK` while it uses the dataset. Raises `StoreError` if the file cannot be
    written, or a file of other software has its name.
    """
    with recording(path, _is_ours) as temporary, _errors(path):
        with LOCK:
            dataset = netCDF4.Dataset(temporary, "w", format="NETCDF4")
        try:
            dataset.setncatts({**attributes, **provenance()})
            yield dataset
        finally:
            with LOCK:
                dataset.close()
        with LOCK, netCDF4.Dataset(temporary) as written:
            for variable in written.variables.values():
                _ = variable[(0,) * variable.ndim]


@contextmanager
def passing(attributes: Mapping[str, Any]) -> Iterator[netCDF4.Dataset]:
    """An open netCDF4 dataset in a temporary file, removed when the block ends."""
    with (
        LOCK,
        _errors(Path(tempfile.gettempdir())),
        tempfile.TemporaryDirectory() as folder,
        netCDF4.Dataset(Path(folder) / "passing.nc", "w") as dataset,
    ):
        dataset.setncatts({**attributes, **provenance()})
        yield dataset


def loaded(dataset: netCDF4.Dataset) -> "xr.Dataset":
    """Contents of an open netCDF4 dataset as an xarray Dataset in memory, as `read` returns it."""
    import xarray as xr

    dataset.set_auto_maskandscale(False)
    variables = {}
    for name, variable in dataset.variables.items():
        found = _plain(variable[:])
        along = variable.dimensions[: found.ndim]  # texts lose the dimension of characters
        variables[name] = xr.Variable(along, found, _attributes(variable))
    named = [getattr(each, "coordinates", "").split() for each in dataset.variables.values()]
    names = dict.fromkeys([*dataset.dimensions, *(name for each in named for name in each)])
    coords = {name: variables.pop(name) for name in names if name in variables}
    return xr.Dataset(variables, coords, _attributes(dataset))


def create_texts(
    dataset: netCDF4.Dataset, name: str, dimensions: tuple[str, ...], texts: NDArray[Any]
) -> "netCDF4.Variable[Any]":
    """A new variable of texts in an open dataset, stored as characters as in the CF conventions.

    Reading texts of variable length from a file that the process has open twice was seen to crash
    it (netCDF4 1.7.5, HDF5 2.2).
    """
    encoded = np.char.encode(np.asarray(texts, str), "utf-8")
    length = max(encoded.dtype.itemsize, 1)
    characters = f"string{length}"
    if characters not in dataset.dimensions:
        dataset.createDimension(characters, length)
    created = dataset.createVariable(name, "S1", (*dimensions, characters))
    created[:] = encoded.astype(f"S{length}").view("S1").reshape(*encoded.shape, length)
    created.setncattr("_Encoding", "utf-8")  # from now on the library returns texts
    return created


def _plain(values: NDArray[Any]) -> NDArray[Any]:
    """The values; texts with a string dtype of NumPy instead of objects."""
    return values.astype(str) if values.dtype == object else values


def _attributes(held: Any) -> dict[str, Any]:
    """Attributes of an open dataset or variable, except ``coordinates`` and ``_Encoding``."""
    return {
        name: held.getncattr(name)
        for name in held.ncattrs()
        if name not in ("coordinates", "_Encoding")
    }


def write(dataset: "xr.Dataset", path: Path, attributes: Mapping[str, Any]) -> None:
    """Write an xarray dataset in memory to a file, with attributes and provenance, as `writing`.

    Ctrl-C takes effect afterwards. Dask's synchronous scheduler is used, not the user's client.
    """
    import dask  # xarray has imported it

    with LOCK, _uninterrupted(), recording(path, _is_ours) as temporary, _errors(path):
        stamped = dataset.assign_attrs({**attributes, **provenance()})
        encoding = {
            name: {"_FillValue": None}
            | (_CHECKED if variable.ndim and variable.dtype.kind in "fiub" else {})
            | ({"dtype": "S1"} if variable.dtype.kind in "OU" else {})
            for name, variable in stamped.variables.items()
        }
        with dask.config.set(scheduler="synchronous"):
            stamped.to_netcdf(temporary, engine="netcdf4", format="NETCDF4", encoding=encoding)
        with netCDF4.Dataset(temporary) as written:
            for variable in written.variables.values():
                _ = variable[:]


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Delay Ctrl-C to the end of the block: within, it would leave xarray's lock held."""
    before = {number: signal.getsignal(number) for number in STOPPING}
    if None in before.values() or threading.current_thread() is not threading.main_thread():
        yield  # only the main thread gets signals; handlers that are not Python's are kept
        return
    waiting: list[int] = []
    for number in before:
        signal.signal(number, lambda number, _: waiting.append(number))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if waiting:
            signal.raise_signal(waiting[0])


@contextmanager
def _errors(path: Path) -> Iterator[None]:
    """Turn errors of the netCDF library (RuntimeError for a full disk) into a `StoreError`."""
    try:
        yield
    except GapsweepError:
        raise
    except (OSError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or error
        remedy = "check the folder and its disk space and run again"
        raise StoreError(f"{path}: cannot be written: {reason}; {remedy}") from None


def _is_ours(path: Path) -> bool:
    """Whether gapsweep wrote a file, by ``SHA256SUMS`` or its ``source``; then it is replaced."""
    return bool(digests(path)) or attributes(path).get("source") == SOURCE


def attributes(path: Path) -> dict[str, Any]:
    """Attributes of a NetCDF file; none if it is damaged or cannot be read."""
    if is_intact(path) is False:  # the library can search in damaged files without end
        return {}
    try:
        with netCDF4.Dataset(path) as dataset:
            return {name: dataset.getncattr(name) for name in dataset.ncattrs()}
    except (OSError, RuntimeError, UnicodeError, AttributeError):
        return {}


def values(path: Path, name: str) -> NDArray[Any]:
    """A small variable of a NetCDF file; empty if it cannot be read."""
    try:
        with netCDF4.Dataset(path) as dataset:
            return np.asarray(dataset[name][:])
    except (OSError, RuntimeError, IndexError):
        return np.empty(0)


def read(
    path: str | Path, *, lazy: bool = False, chunks: Mapping[str, int] | str | None = None
) -> "xr.Dataset":
    """Return the dataset of a NetCDF file of a run.

    The file is first compared with its SHA-256 in ``SHA256SUMS`` of its folder.

    Parameters
    ----------
    path : str or Path
        Path of the file, as ``data/runs/quick/responses.nc``.
    lazy : bool
        Whether to read values at first use, for files larger than the memory. The dataset must be
        closed before a run writes into its folder.
    chunks : mapping of str to int, or 'auto', optional
        Sizes of Dask arrays by dimension, as for `xarray.open_dataset`: ``{}`` takes the chunks of
        the file. Implies `lazy`.

    Raises
    ------
    StoreError
        If the file is missing, damaged or not a NetCDF file.

    Warns
    -----
    UserWarning
        If ``SHA256SUMS`` has no entry for the file.

    Examples
    --------
    >>> import gapsweep as gs
    >>> block = {"representation": "piecewise", "K_c": 1e4, "gap": [4e-4, 4e-4], "omega": 9.0}
    >>> m = {"mass": 3.0, "omega_n": 5.0, "zeta": 0.03, "forcing": 4.0}
    >>> study = gs.Study.from_dict({"study": {"name": "small"}, "oscillator": m, "sweep": [block]})
    >>> gs.run(study, out="small", cache="points-cache").close()
    >>> gs.open("small/attractors.nc")["n_attractors"].values.ravel().tolist()
    [1]
    """
    # takes half a second to import, which a run without work avoids
    import xarray as xr

    if not isinstance(path, str | os.PathLike):
        raise StoreError(f"path = {path!r:.80}: must be a path, as 'data/runs/quick/responses.nc'")
    path = Path(path)
    if path.is_dir():
        raise StoreError(f"{path}: is a folder; name a file, as {path / 'responses.nc'}")
    try:
        intact = is_intact(path)
        if intact is False:
            raise StoreError(
                f"{path}: damaged or changed since it was written (its SHA-256 differs from "
                "SHA256SUMS); 'gapsweep run' rewrites it from the cache"
            )
        is_lazy = lazy or chunks is not None
        opening = xr.open_dataset if is_lazy else xr.load_dataset
        opened = opening(path, engine="netcdf4", chunks=chunks)
        for coordinate in opened.coords.values():
            coordinate.load()  # otherwise xarray reads it at every combination of datasets
    except StoreError:
        raise
    except FileNotFoundError:
        raise StoreError(f"{path}: no such file; 'gapsweep run' writes it") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise StoreError(f"{path}: cannot be read as NetCDF: {reason}") from None
    if intact is None:
        warnings.warn(
            f"{path}: not checked for damage; copy the file SHA256SUMS to the same folder",
            stacklevel=2,
        )
    for variable in opened.variables.values():  # users may shorten texts and save them
        variable.encoding.pop("char_dim_name", None)
    return opened


def provenance() -> dict[str, str]:
    """File attributes: conventions, time, versions and machine of the file's creation."""
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return {
        "Conventions": CONVENTIONS,
        "source": SOURCE,
        "created": now,
        "history": f"{now} written by {SOURCE} {version(SOURCE)}",
        "references": f"{SOURCE} {version(SOURCE)}, CITATION.cff",
        "versions": json.dumps(
            {name: version(name) for name in _RECORDED_PACKAGES}
            | {"netCDF4": netCDF4.__version__, "python": platform.python_version()}
        ),
        "host": platform.node(),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, {platform.system()}",
        "thread_settings": json.dumps({k: os.environ.get(k, "") for k in _THREAD_SETTINGS}),
    }
