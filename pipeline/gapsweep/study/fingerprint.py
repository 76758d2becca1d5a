"""Fingerprints of gapsweep's own code, without comments, docstrings and formatting.

The fingerprint of the numerics enters every cache key, so that results of other code are never
taken for these. The fingerprint of a stage's code says whether its dataset is up to date.
Both are taken once per process: an edit during a run changes nothing in it.
"""

import hashlib
import time
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import gapsweep.model
from gapsweep.errors import ClusterError
from gapsweep.source import Source, read, short_digest, with_parents

_PACKAGE = Path(gapsweep.model.__file__).parents[1]
# What decides a result, from a point's numbers to its response.
NUMERICS = (
    *("status.py", "model", "integrate", "response"),
    *("study/points.py", "execution/task.py", "execution/sweeps.py"),
)


@cache
def numerics_fingerprint(package: Path = _PACKAGE) -> str:
    """SHA-256 (16 hex digits) of the modules in `NUMERICS`.

    Raises
    ------
    ClusterError
        If one was edited since this process has begun to load the package: it may run either.
    """
    return _digest(package, _numerics(package))


@cache
def numerics_bytes() -> str:
    """SHA-256 (16 hex digits) of the same modules to the last byte, comments included.

    By this two processes know in no time whether they run the same; the other one is for keys.

    Raises
    ------
    ClusterError
        As `numerics_fingerprint`.
    """
    files = sorted(_numerics(_PACKAGE))
    parts = ((path.relative_to(_PACKAGE).as_posix().encode(), path.read_bytes()) for path in files)
    return short_digest(b"\0".join(part for named in parts for part in named))


def check_unedited() -> None:
    """Whether what is loaded from now on is what the fingerprints are of.

    Raises
    ------
    ClusterError
        As `numerics_fingerprint`.
    """
    _numerics(_PACKAGE)


def _numerics(package: Path) -> list[Path]:
    """The files of the modules in `NUMERICS`, if none was edited since they were loaded."""
    paths = (package / name for name in NUMERICS)
    files = [m for p in paths for m in (p.rglob("*.py") if p.is_dir() else [p])]
    if package == _PACKAGE:
        _check_unedited(files)
    return files


def _check_unedited(files: Iterable[Path]) -> None:
    """Whether none of our files was edited since this process began to load them."""
    now = time.time()
    for file in files:
        stat = file.stat()
        # A file that is put in place of another may keep its date. A clock that is ahead on
        # another machine is no edit.
        if any(gapsweep.LOADED < at <= now for at in (stat.st_mtime, stat.st_ctime)):
            raise ClusterError(f"{file}: edited after this process loaded gapsweep: start it again")


@cache
def code_fingerprint(name: str) -> str:
    """SHA-256 (16 hex digits) of a module and of all of ours that it imports, at any depth.

    Parameters
    ----------
    name : str
        Path of the module in the package, as ``"analysis/timing.py"``.

    Raises
    ------
    ClusterError
        As `numerics_fingerprint`: what the old code makes must not count as the new one's.
    """
    needed = modules(_PACKAGE / name, _PACKAGE)
    _check_unedited(needed)
    templates = {path for module in needed for path in (module.parent / "templates").glob("*")}
    return _digest(_PACKAGE, needed | templates)


def imports_fingerprint(names: Iterable[str]) -> str:
    """SHA-256 (16 hex digits) of all of ours that others import, at any depth.

    Parameters
    ----------
    names : iterable of str
        Dotted names, as in import statements. The package itself stands for all there is.
    """
    named = set(names)
    if _PACKAGE.name in named:
        return _digest(_PACKAGE, _PACKAGE.rglob("*.py"))
    found = {path for name in named for path in _files(name, _PACKAGE)}
    return _digest(_PACKAGE, modules(found, _PACKAGE))


def modules(paths: Path | Iterable[Path], package: Path) -> set[Path]:
    """Modules of the package, and all of the package that they import, at any depth."""
    needed = {paths} if isinstance(paths, Path) else set(paths)
    waiting = list(needed)
    while waiting:
        new = set(_imported(waiting.pop(), package)) - needed
        needed |= new
        waiting += new
    return needed


def _digest(package: Path, files: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for path in sorted(files):
        digest.update(path.relative_to(package).as_posix().encode())
        is_code = path.suffix == ".py"
        digest.update(_read(path, package).digest.encode() if is_code else path.read_bytes())
    return digest.hexdigest()[:16]


@cache
def _read(path: Path, package: Path) -> Source:
    return read(path, _name(path, package))


def _name(path: Path, package: Path) -> str:
    parts = path.relative_to(package.parent).with_suffix("").parts
    return ".".join(parts if parts[-1] != "__init__" else parts[:-1])


def _imported(path: Path, package: Path) -> Iterator[Path]:
    """Modules of the package that a module imports, and the packages that all of them stand in."""
    for name in (_name(path, package), *_read(path, package).imports):
        yield from _files(name, package)


def _files(name: str, package: Path) -> Iterator[Path]:
    """The module of a dotted name and the packages that it stands in; none if it is not ours."""
    for each in with_parents(name):
        top, *parts = each.split(".")
        # The top package only hands out names: it imports everything, when it is asked to.
        if top == package.name and parts:
            place = package.joinpath(*parts)
            yield from filter(Path.is_file, (place.with_suffix(".py"), place / "__init__.py"))
