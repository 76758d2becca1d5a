"""Python sources: what they import, and what they say apart from comments and formatting."""

import ast
import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Source:
    """What a module's file says.

    Attributes
    ----------
    digest : str
        SHA-256 (16 hex digits) of the normalised source.
    imports : tuple of str
        Absolute dotted names of all that its import statements name, wherever they stand; the
        name that a ``from`` takes out of a module may be a module too.
    """

    digest: str
    imports: tuple[str, ...]


def read(path: Path, module: str, data: bytes | None = None) -> Source:
    """Read a file, or bytes of it that are known, as the module of that dotted name.

    Raises
    ------
    OSError, SyntaxError, ValueError
        If it cannot be read, or is not Python.
    """
    tree = ast.parse(path.read_bytes() if data is None else data)
    package = module if path.stem == "__init__" else module.rpartition(".")[0]
    statements = list(_statements(tree))
    names = tuple(_imported(statements, package))
    return Source(short_digest(_normalised(tree, statements).encode()), names)


def short_digest(data: bytes) -> str:
    """SHA-256 of some bytes, the first 16 hex digits."""
    return hashlib.sha256(data).hexdigest()[:16]


def with_parents(name: str) -> Iterator[str]:
    """``a``, ``a.b`` and ``a.b.c`` of ``a.b.c``: Python runs them all."""
    parts = name.split(".")
    return (".".join(parts[: n + 1]) for n in range(len(parts)))


def _statements(node: ast.AST) -> Iterator[ast.AST]:
    """A module and the statements in it, at any depth: of expressions there are ten times more."""
    yield node
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.stmt | ast.excepthandler | ast.match_case):
            yield from _statements(child)


def _imported(statements: Iterable[ast.AST], package: str) -> Iterator[str]:
    for node in statements:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            # Of level 1 is the package itself, of level 2 the one above it.
            above = package.split(".")[: len(package.split(".")) + 1 - node.level]
            start = ".".join(filter(None, [*(above if node.level else []), node.module or ""]))
            yield start
            yield from (f"{start}.{alias.name}" for alias in node.names if alias.name != "*")


def _normalised(tree: ast.Module, statements: Iterable[ast.AST]) -> str:
    for node in statements:
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = [s for s in node.body if not _is_text(s)] or [ast.Pass()]
    return ast.dump(tree)


def _is_text(statement: ast.stmt) -> bool:
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    )
