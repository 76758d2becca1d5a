"""The folder of a run: its files, the study they belong to, and whether they are up to date.

The attribute `made_from` of a file holds the digests of its inputs and of the code.
"""

import html
import json
import os
import re
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gapsweep.errors import StoreError
from gapsweep.store import artefact, netcdf
from gapsweep.store.artefact import alone_in, digests, is_intact, is_recorded, recording, sha256
from gapsweep.store.state import NO_FOLDER, RunState
from gapsweep.study.study import Study

if TYPE_CHECKING:
    import xarray as xr

RUNS, DEFAULT_CACHE = Path("data/runs"), Path("data/cache")

RESPONSES, ATTRACTORS = "responses.nc", "attractors.nc"
STATIC, AGREEMENT, TIMING = "static.nc", "agreement.nc", "timing.nc"
HISTORIES, ADVICE, GRADIENTS = "histories.nc", "advice.nc", "gradients.nc"
BRANCHES, CURVES, RISK, FIT = "branches.nc", "curves.nc", "risk.nc", "fit.nc"
WORK_PRECISION, STABILITY = "work_precision.nc", "stability.nc"
CLAIMS, SECTIONS = "claims.json", "sections.json"
REPORT = "report/index.html"

STUDY = "study"  # the key in `made_from` of the study's settings
DAMAGED = "damaged"  # the reason to make a file that is not as it was written
_META = r'<meta name="gapsweep-made-from" content="([^"]*)">'

MadeFrom = Mapping[str, str]


def run_folder(study: Study, out: str | Path | None) -> Path:
    """The folder of a run: the argument, else ``data/runs/<study name>``.

    Absolute, as `cache_path`: the user's code may change the current folder.
    """
    return _path("out", RUNS / study.name if out is None else out)


def cache_path(cache: str | Path | None) -> Path:
    """The folder of the cache: the argument, else ``GAPSWEEP_CACHE``, else ``data/cache``."""
    given = os.environ.get("GAPSWEEP_CACHE") or DEFAULT_CACHE if cache is None else cache
    return _path("cache", given)


def _path(name: str, value: Any) -> Path:
    """The absolute path of an argument; a StoreError if it is no valid path."""
    try:
        with suppress(FileNotFoundError, NotADirectoryError, PermissionError):
            os.stat(value)
        return Path(value).absolute()
    except (TypeError, ValueError, OSError) as error:
        why = f"{name} = {value!r:.80}: must be the path of a folder: {error!s:.80}"
        raise StoreError(why) from None


def check_owner(study: Study, folder: Path) -> None:
    """Refuse a folder in which another study has left its files.

    Raises `StoreError` if its run, or without a run one of its datasets, belongs to a study of
    another name.
    """
    try:
        owners = [str(RunState.read(folder).study)]
    except StoreError:  # no run yet, or its state is damaged
        files = (folder / name for name in (RESPONSES, WORK_PRECISION, STABILITY))
        owners = [str(netcdf.attributes(file).get("study", study.name)) for file in files]
    for owner in owners:
        if owner != study.name:
            raise StoreError(
                f"{folder}: has the files of study {owner!r}, not of {study.name!r}; choose "
                "another folder with --out, or delete this folder"
            )


def check_writable(folder: Path, other: str = "another folder with --out") -> None:
    """Raise an error before the computation if the results could not be stored.

    Raises `StoreError` if the folder is not writable; the message recommends `other`.
    """
    if folder.is_symlink() and not folder.exists():
        raise StoreError(f"{folder}: is a broken symbolic link; remove it, or choose {other}")
    existing = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    try:
        str(folder).encode()  # netCDF takes no other names
        with tempfile.TemporaryFile(dir=existing):
            pass
    except (OSError, UnicodeError) as error:
        why = getattr(error, "strerror", None) or f"not UTF-8: {error}"
        raise StoreError(
            f"{folder}: cannot be written: {existing}: {why}; choose {other}"
        ) from None


@contextmanager
def locked_run(folder: Path) -> Iterator[None]:
    """Lock the folder of a run in the block, so that no other run writes into it.

    Waits while another process holds the lock. Raises `StoreError` if the folder holds no run.
    """
    if folder.is_file():
        raise StoreError(f"{folder}: {NO_FOLDER}")
    if not (folder / RESPONSES).exists():
        raise StoreError(f"{folder / RESPONSES}: no such file; 'gapsweep run' writes it")
    with alone_in(folder):
        yield


def write(path: Path, content: "xr.Dataset | dict[str, Any]", made_from: str) -> None:
    """Write a dataset as NetCDF, or a dict as JSON, with the digests of its inputs."""
    if not isinstance(content, dict):
        netcdf.write(content, path, {"made_from": made_from})
        return
    whole: dict[str, Any] = {"made_from": json.loads(made_from), **netcdf.provenance(), **content}
    with recording(path, is_recorded) as temporary:
        text = json.dumps(whole, indent=1, ensure_ascii=False, allow_nan=False)
        temporary.write_text(f"{text}\n", encoding="utf-8")


def read_json(path: Path) -> dict[str, Any] | None:
    """Content of ``claims.json`` or ``sections.json``; None if absent or of other responses.

    Raises `StoreError` if the file is damaged.
    """
    if not path.exists():
        return None
    if not (intact := is_intact(path)):
        command = "claims" if path.name == CLAIMS else "report"
        why = "damaged" if intact is False else "has no checksum in SHA256SUMS"
        raise StoreError(
            f"{path}: {why}; 'gapsweep {command} {path.parent} --study FILE' rewrites it"
        )
    found: dict[str, Any] = json.loads(artefact.text_of(path))
    return found if is_of_run(path) else None


def as_text(made_from: MadeFrom) -> str:
    """The digests of a file's inputs as JSON text, for its attribute or meta element."""
    return json.dumps(dict(made_from), sort_keys=True)


def reason_to_make(path: Path, now: MadeFrom) -> str | None:
    """Why a file must be rewritten, given the present digests `now`; None if it is up to date."""
    if not path.exists():
        return "absent"
    if not (intact := is_intact(path)):
        return DAMAGED if intact is False else "no checksum in SHA256SUMS"
    before = _recorded(path)
    if not before:
        return "inputs unknown"
    changed = [name for name in {**now, **before} if now.get(name) != before.get(name)]
    if changed:
        return f"{', '.join(changed)} changed"
    lost = next((each for each in _linked(path) if not (each.exists() and is_intact(each))), None)
    return f"{lost.name} missing or damaged" if lost else None


def _linked(path: Path) -> Iterator[Path]:
    """Paths of the files in subfolders to which a page links."""
    if path.suffix == ".html":
        page = artefact.text_of(path)
        for name in dict.fromkeys(re.findall(r'href="(\w+/[\w.-]+)"', page)):
            yield path.parent / name


def is_of_run(path: Path) -> bool:
    """Whether a file belongs to the responses in its folder, and not to an earlier run.

    If it records their digest, this must be the present one. Otherwise it must be newer than the
    responses, or of the same study settings: a benchmark may change without a new sweep.
    """
    responses, before = path.with_name(RESPONSES), _recorded(path)
    if RESPONSES in before:
        present = digests(responses) or [sha256(responses)]  # copied without SHA256SUMS
        return before[RESPONSES] == " ".join(present)
    ours, theirs = (netcdf.attributes(file).get("created", "") for file in (path, responses))
    return ours >= theirs or before.get(STUDY) == _recorded(responses).get(STUDY)


def _recorded(path: Path) -> MadeFrom:
    """Digests that a file records of its inputs; empty if they cannot be read."""
    try:
        if path.suffix == ".nc":
            return dict(json.loads(netcdf.attributes(path).get("made_from", "{}")))
        if path.suffix == ".json":
            return dict(json.loads(artefact.text_of(path))["made_from"])
        found = re.search(_META, artefact.text_of(path))
        return dict(json.loads(html.unescape(found[1]))) if found else {}
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return {}
