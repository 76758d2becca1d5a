"""Fingerprint of the code that makes the numbers.

It enters every cache key, so that results of other code are never taken for these. It is
computed from the syntax trees of the modules that can move a number, without comments,
docstrings and formatting: those may change freely.
"""

import ast
import hashlib
from functools import cache
from pathlib import Path

import gapsweep.model

_PACKAGE = Path(gapsweep.model.__file__).parents[1]
NUMERICS = ("status.py", "model", "integrate", "response")


@cache
def numerics_fingerprint(package: Path = _PACKAGE) -> str:
    """SHA-256 (16 hex digits) of the modules in `NUMERICS`, read once per process."""
    digest = hashlib.sha256()
    for name in NUMERICS:
        path = package / name
        for module in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            digest.update(module.relative_to(package).as_posix().encode())
            digest.update(normalised_source(module.read_text(encoding="utf-8")).encode())
    return digest.hexdigest()[:16]


def normalised_source(source: str) -> str:
    """Syntax tree of a source as text, docstrings left out."""
    tree = ast.parse(source)
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
