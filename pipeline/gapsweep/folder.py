"""The folder of a run: whose it is, who may write there."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from gapsweep.errors import StoreError
from gapsweep.stages import RESPONSES, STABILITY, WORK_PRECISION
from gapsweep.store import netcdf
from gapsweep.store.artefact import alone_in
from gapsweep.store.state import NO_FOLDER, RunState
from gapsweep.study.study import Study

RUNS = Path("data/runs")
# The files by which one sees whose folder it is.
_OWNED = (RESPONSES, WORK_PRECISION, STABILITY)


def run_folder(study: Study, out: str | Path | None) -> Path:
    """Where a run leaves its files: the argument, else ``data/runs/<study name>``.

    Absolute, as `cache_path`: code of the user's may change the current folder.
    """
    return (Path(out) if out is not None else RUNS / study.name).absolute()


@contextmanager
def alone_in_run(folder: Path) -> Iterator[None]:
    """Keep others from writing into the folder of a run.

    Raises
    ------
    StoreError
        If it holds none.
    """
    if folder.is_file():
        raise StoreError(f"{folder}: {NO_FOLDER}")
    if not (folder / RESPONSES).exists():
        raise StoreError(f"{folder / RESPONSES}: no such file; 'gapsweep run' makes it")
    with alone_in(folder):
        yield


def check_owner(study: Study, folder: Path) -> None:
    """Refuse a folder in which another study has left its files.

    Raises
    ------
    StoreError
        If its run or one of its datasets is that of a study with another name.
    """
    owners = {str(netcdf.attributes(folder / name).get("study", study.name)) for name in _OWNED}
    with suppress(StoreError):  # no run yet, or its state is damaged
        owners.add(str(RunState.read(folder).study))
    for owner in owners - {study.name}:
        raise StoreError(
            f"{folder}: holds the files of study {owner!r}, this one is {study.name!r}: choose "
            "another folder with --out, or delete this one"
        )


def check_writable(folder: Path, other: str = "another folder with --out") -> None:
    """Fail before anything is computed if the results could not be stored.

    Raises
    ------
    StoreError
        If nothing can be written in a folder; `other` is what to name then.
    """
    if folder.is_symlink() and not folder.exists():
        raise StoreError(f"{folder}: is a link to nothing; remove it, or name {other}")
    existing = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    try:
        str(folder).encode()  # netCDF takes no other names
        with tempfile.TemporaryFile(dir=existing):
            pass
    except (OSError, UnicodeError) as error:
        why = getattr(error, "strerror", None) or f"not UTF-8: {error}"
        raise StoreError(f"{folder}: cannot be written: {existing}: {why}; name {other}") from None
