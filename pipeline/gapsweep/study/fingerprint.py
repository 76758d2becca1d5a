"""Fingerprints of gapsweep's own code, without comments, docstrings and formatting.

The fingerprint of the numerics enters every cache key, so that results of other code are never
taken for these. The fingerprint of a stage's code says whether its dataset is up to date.
Both are of the bytes that this process read as it imported this module: an edit during a run
changes neither.
"""

import hashlib
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
def _bytes(path: Path) -> bytes:
    """A file as this process first read it."""
    return path.read_bytes()


for _source in _PACKAGE.rglob("*.py"):
    _bytes(_source)  # now, before the engines and the stages are imported


@cache
def numerics_fingerprint(package: Path = _PACKAGE) -> str:
    """SHA-256 (16 hex digits) of the modules in `NUMERICS`."""
    return _digest(package, _numerics(package))


@cache
def numerics_bytes() -> str:
    """SHA-256 (16 hex digits) of the same modules to the last byte, comments included.

    By this two processes know in no time whether they run the same; the other one is for keys.
    """
    files = sorted(_numerics(_PACKAGE))
    parts = ((path.relative_to(_PACKAGE).as_posix().encode(), _bytes(path)) for path in files)
    return short_digest(b"\0".join(part for named in parts for part in named))


def check_unedited() -> None:
    """Raise `ClusterError` if a module in `NUMERICS` is no longer what this process has read."""
    for path in _numerics(_PACKAGE):
        if path.read_bytes() != _bytes(path):
            raise ClusterError(f"{path}: edited after this process loaded gapsweep: start it again")


def _numerics(package: Path) -> list[Path]:
    paths = (package / name for name in NUMERICS)
    return [m for p in paths for m in (p.rglob("*.py") if p.is_dir() else [p])]


@cache
def code_fingerprint(name: str) -> str:
    """SHA-256 (16 hex digits) of a module and of all of ours that it imports, at any depth.

    Parameters
    ----------
    name : str
        Path of the module in the package, as ``"analysis/timing.py"``.
    """
    needed = modules(_PACKAGE / name, _PACKAGE)
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
        digest.update(_read(path, package).digest.encode() if is_code else _bytes(path))
    return digest.hexdigest()[:16]


@cache
def _read(path: Path, package: Path) -> Source:
    return read(path, _name(path, package), _bytes(path))


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
