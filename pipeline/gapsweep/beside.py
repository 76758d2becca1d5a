"""Python files beside a study: loaded as a package of their folder, digested with what they use.

A file is a member of a package that exists only here, whose folder is the file's: so it imports its
neighbours relatively (``from .ladders import ladders``), wherever the folder lies and whatever else
has that name. The digest follows these imports and runs nothing. No byte code is read or written:
it is recognised by the second and the size, so that an edit could be missed.
"""

import importlib
import inspect
import json
import os
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

from gapsweep.errors import StudyError, described
from gapsweep.source import read, short_digest, with_parents

_PACKAGES = "gapsweep_beside_"
# The modules that are loaded, and the digests of the sources they were loaded from, by package.
_loaded: dict[str, tuple[str, ModuleType]] = {}


@dataclass(frozen=True, slots=True)
class Sources:
    """A file and all neighbours that it imports relatively, at any depth.

    Attributes
    ----------
    digests : dict of str to str
        Of what the files say, comments and formatting apart, by dotted name within the folder.
    imports : frozenset of str
        Dotted names of all that they import from elsewhere.
    """

    digests: dict[str, str]
    imports: frozenset[str]

    @property
    def digest(self) -> str:
        """Digest of all of them."""
        return short_digest(json.dumps(self.digests).encode())


def sources(path: Path) -> Sources:
    """Follow the relative imports of a file.

    Raises
    ------
    StudyError
        If one of the files cannot be read or is not Python; one line.
    """
    package = _package(path)
    digests: dict[str, str] = {}
    imports: set[str] = set()
    waiting, seen = [f"{package}.{path.stem}"], {package}
    while waiting:
        name = waiting.pop()
        if name not in seen:
            seen.add(name)
            file = path if not digests else _file(path.parent, name.partition(".")[2])
            if file is not None:
                with blaming(file):
                    source = read(file, name)
                digests[name.partition(".")[2]] = source.digest
                ours = [n for n in source.imports if n.partition(".")[0] == package]
                imports.update(set(source.imports).difference(ours))
                waiting += [each for n in ours for each in with_parents(n)]
    return Sources(dict(sorted(digests.items())), frozenset(imports))


def digest(path: Path) -> str:
    """Digest of a file's code and of that of all neighbours that it imports; see `sources`."""
    return sources(path).digest


def load(path: Path) -> ModuleType:
    """Import a file, anew if it or a neighbour has changed since.

    Raises
    ------
    StudyError
        If it cannot be imported, whatever it raises; one line with file, line and exception.
    """
    package, now = _package(path), digest(path)
    before = _loaded.pop(package, ("", None))
    if before[0] != now or before[1] is None:
        for name in [n for n in sys.modules if n.partition(".")[0] == package]:
            del sys.modules[name]
        sys.modules[package] = folder = ModuleType(package)
        folder.__path__ = [str(path.absolute().parent)]
        with blaming(path):
            before = now, importlib.import_module(f"{package}.{path.stem}")
    _loaded[package] = before
    return before[1]


def digest_of(function: Any, path: Path) -> tuple[str, frozenset[str]]:
    """Digest of what a callable that a file names is made of, and what that imports.

    That of a function of a neighbour depends on this neighbour alone: what else the file says may
    be edited. All else, such as a closure, is made by the file.
    """
    name = getattr(function, "__qualname__", "")
    module = sys.modules.get(getattr(function, "__module__", None) or "")
    if (
        module is not None
        and module.__name__.startswith(f"{_package(path)}.")
        and isinstance(function, FunctionType)
        and vars(module).get(name) is function
    ):
        found = sources(Path(str(module.__file__)))
        return f"{name} {found.digest}", found.imports
    found = sources(path)
    return found.digest, found.imports


@contextmanager
def blaming(
    path: Path, what: str = "", function: Callable[..., Any] | None = None
) -> Iterator[None]:
    """Whatever code beside a study raises in this block becomes a `StudyError` of one line.

    Parameters
    ----------
    path : Path
        The file whose code is run.
    what : str
        What of it, for the message.
    function : callable, optional
        What is called, for the line of what it returns.
    """
    try:
        yield
    except (KeyboardInterrupt, GeneratorExit, StudyError):
        raise
    except BaseException as error:  # the user's code may raise anything, SystemExit too
        raise StudyError([blame(path, error, what, function)]) from None


def blame(path: Path, error: BaseException, what: str, function: Any = None) -> str:
    """File, line and exception: the last line that ran in the folder of a file."""
    where, said = str(path), described(error).replace(f"{_package(path)}.", ".")
    folder = path.absolute().parent
    code = getattr(inspect.unwrap(function), "__code__", None) if callable(function) else None
    ran = [(frame.f_code, line) for frame, line in traceback.walk_tb(error.__traceback__)]
    for each, line in ([(code, code.co_firstlineno)] if code else []) + ran:
        file = Path(each.co_filename)
        if folder in file.parents:
            where = f"{path.parent / file.relative_to(folder)}:{line}"
    if isinstance(error, SyntaxError):
        where = f"{where}:{error.lineno}" if error.lineno else where
        said = f"SyntaxError: {error.msg}"
    elif isinstance(error, OSError) and error.filename == str(path):
        said = f"cannot be read: {error.strerror}"
    elif isinstance(error, ModuleNotFoundError) and (folder / f"{error.name}.py").exists():
        said += f"; a neighbour is imported relatively: from .{error.name} import ..."
    return ": ".join(filter(None, [where, what, said]))


def _package(path: Path) -> str:
    """Name of the package that one file is loaded in, its own: an edit reloads no other's."""
    return f"{_PACKAGES}{short_digest(os.fsencode(path.absolute()))}"


def _file(folder: Path, name: str) -> Path | None:
    place = folder.joinpath(*name.split("."))
    files = (place.with_name(f"{place.name}.py"), place / "__init__.py")
    return next((file for file in files if file.is_file()), None)


class _Loader(SourceFileLoader):
    """Compiles the source each time."""

    def get_code(self, fullname: str) -> CodeType:
        path = self.get_filename(fullname)
        return self.source_to_code(self.get_data(path), path)


class _Finder:
    """Finds the modules of these packages, also those that a function imports when it is called."""

    @staticmethod
    def find_spec(
        name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if not path or not name.startswith(_PACKAGES):
            return None
        file = _file(Path(path[0]), name.rpartition(".")[2])
        return spec_from_file_location(name, loader=_Loader(name, str(file))) if file else None


sys.meta_path.insert(0, _Finder)
