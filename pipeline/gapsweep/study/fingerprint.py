"""Fingerprints of code, without comments, docstrings and formatting.

The fingerprint of the numerics enters every cache key, so that results of other code are never
taken for these. The fingerprint of a stage's code says whether its dataset is up to date.
Both are taken once per process: an edit during a run changes nothing in it.
"""

import ast
import hashlib
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import gapsweep.model

_PACKAGE = Path(gapsweep.model.__file__).parents[1]
NUMERICS = ("status.py", "model", "integrate", "response")


@cache
def numerics_fingerprint(package: Path = _PACKAGE) -> str:
    """SHA-256 (16 hex digits) of the modules in `NUMERICS`."""
    paths = (package / name for name in NUMERICS)
    return _digest(package, (m for p in paths for m in (p.rglob("*.py") if p.is_dir() else [p])))


@cache
def code_fingerprint(name: str, package: Path = _PACKAGE) -> str:
    """SHA-256 (16 hex digits) of a module and of all of ours that it imports, at any depth.

    Parameters
    ----------
    name : str
        Path of the module in the package, as ``"analysis/timing.py"``.
    """
    needed = {package / name}
    waiting = list(needed)
    while waiting:
        new = set(_imported(waiting.pop(), package)) - needed
        needed |= new
        waiting += new
    templates = {path for module in needed for path in (module.parent / "templates").glob("*")}
    return _digest(package, needed | templates)


def normalised_source(source: str) -> str:
    """Syntax tree of a source as text, docstrings left out."""
    return _normalised(ast.parse(source))


def _digest(package: Path, files: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for path in sorted(files):
        digest.update(path.relative_to(package).as_posix().encode())
        digest.update(_scanned(path)[0] if path.suffix == ".py" else path.read_bytes())
    return digest.hexdigest()[:16]


@cache
def _scanned(module: Path) -> tuple[bytes, tuple[str, ...]]:
    """SHA-256 of a module's normalised source, and the names that it imports."""
    tree = ast.parse(module.read_text(encoding="utf-8"))
    names: list[str] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            names += (node.module, *(f"{node.module}.{alias.name}" for alias in node.names))
    return hashlib.sha256(_normalised(tree).encode()).digest(), tuple(names)


def _imported(module: Path, package: Path) -> Iterator[Path]:
    """Modules of the package that a module imports."""
    for name in _scanned(module)[1]:
        top, *parts = name.split(".")
        path = package.joinpath(*parts).with_suffix(".py")
        if top == package.name and parts and path.is_file():
            yield path


def _normalised(tree: ast.Module) -> str:
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = [s for s in node.body if not _is_text(s)] or [ast.Pass()]
    return ast.dump(tree)


def _is_text(statement: ast.stmt) -> bool:
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    )
