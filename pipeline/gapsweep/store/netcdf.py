"""NetCDF files: complete or absent, never torn.

A file is written under a temporary name in its own folder, flushed to disk, opened again
and only then renamed into place. The netCDF library is not thread-safe: all writing
happens in the main process, under one lock.
"""

import json
import os
import platform
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import netCDF4
import xarray as xr

from gapsweep.errors import StoreError

_LOCK = threading.Lock()
_RECORDED_PACKAGES = ("gapsweep", "numpy", "scipy", "numba", "dask", "distributed", "xarray")
_THREAD_SETTINGS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
CONVENTIONS = "CF-1.11"


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path that takes the place of `path` when the block ends without error.

    Raises
    ------
    StoreError
        If the folder or file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        os.close(handle)
    except OSError as error:
        raise StoreError(f"{path}: cannot be written: {error.strerror}") from None
    temporary = Path(name)
    try:
        yield temporary
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)  # mkstemp makes it private
        temporary.replace(path)
        _sync_folder(path.parent)
    except OSError as error:
        raise StoreError(f"{path}: cannot be written: {error}") from error
    finally:
        with suppress(FileNotFoundError):
            temporary.unlink()


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def writing(path: Path, attributes: dict[str, Any]) -> Iterator[netCDF4.Dataset]:
    """An open netCDF4 dataset that becomes `path` once it is complete and readable."""
    with _LOCK, replacing(path) as temporary:
        with netCDF4.Dataset(temporary, "w", format="NETCDF4") as dataset:
            dataset.setncatts(attributes | provenance())
            yield dataset
        with netCDF4.Dataset(temporary) as dataset:
            for variable in dataset.variables.values():
                _ = variable[(0,) * variable.ndim]


def write(dataset: xr.Dataset, path: Path) -> None:
    """Write a small dataset as a whole, with provenance; atomic like `writing`."""
    with _LOCK, replacing(path) as temporary:
        stamped = dataset.assign_attrs(provenance())
        encoding = {name: {"_FillValue": None} for name in stamped.variables}
        stamped.to_netcdf(temporary, engine="netcdf4", format="NETCDF4", encoding=encoding)
        with xr.open_dataset(temporary, engine="netcdf4") as written:
            written.load()


def read(path: str | Path) -> xr.Dataset:
    """Open a NetCDF file of a run; values are read when used.

    Raises
    ------
    StoreError
        If the file is missing, damaged or no NetCDF file.
    """
    try:
        return xr.open_dataset(path, engine="netcdf4")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise StoreError(f"{path}: cannot be read as NetCDF: {reason}") from None


def provenance() -> dict[str, str]:
    """File attributes that say where and by what a file was made."""
    return {
        "Conventions": CONVENTIONS,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": json.dumps(
            {name: version(name) for name in _RECORDED_PACKAGES}
            | {"netCDF4": netCDF4.__version__, "python": platform.python_version()}
        ),
        "host": platform.node(),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, {platform.system()}",
        "thread_settings": json.dumps({k: os.environ.get(k, "") for k in _THREAD_SETTINGS}),
    }
