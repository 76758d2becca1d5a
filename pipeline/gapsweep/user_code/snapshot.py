"""A study's own Python code as a value: the bytes of the files, read once.

A snapshot holds the named module and every user module that it imports, at any depth. Imports
are found in the syntax tree, inside functions too; no code runs. Installed packages are not read:
a snapshot holds their versions. A module names the data files that it reads in
``__data__ = ["k.csv"]``, relative to its folder; their bytes are part of the snapshot.
"""

import ast
import hashlib
import importlib
import json
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from itertools import accumulate
from pathlib import Path, PurePosixPath

from gapsweep.errors import ModelError

ABSENT = ""  # the version of a module that was not found
LOOSE = "_"  # package name for a file outside packages, so that it can import its neighbours
_INSTALLED = {"site-packages", "dist-packages"}
_OURS = "gapsweep"  # keys hold the digest of its source


@dataclass(frozen=True)
class Module:
    """A source file of user code, with its data files."""

    source: bytes
    path: str  # path for messages; not part of the key
    is_package: bool
    data: Mapping[str, bytes]  # data files by their name in ``__data__``


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The user code that a module consists of; snapshots are equal if their keys are."""

    main: str  # dotted name of the module
    modules: Mapping[str, Module]  # all user modules, by dotted name
    # Version of every distribution that they import, by module; `ABSENT` if there is none.
    versions: Mapping[str, str]

    @property
    def path(self) -> Path:
        """The file of the module."""
        return Path(self.modules[self.main].path)

    @cached_property
    def key(self) -> str:
        """SHA-256 of all bytes and versions, as 32 hex digits."""
        files = {
            name: [
                module.is_package,
                _sha256(module.source),
                {file: _sha256(data) for file, data in module.data.items()},
            ]
            for name, module in self.modules.items()
        }
        whole = json.dumps([self.main, files, dict(self.versions)], sort_keys=True)
        return _sha256(whole.encode())[:32]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Snapshot) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)

    def part(self, main: str) -> "Snapshot":
        """The snapshot of one of the modules and its imports."""
        needed: dict[str, Module] = {}
        others: dict[str, str] = {}
        waiting = [main]
        while waiting:
            for name in _with_parents(waiting.pop()):
                if name in self.modules and name not in needed:
                    needed[name] = self.modules[name]
                    waiting += _imports(name, needed[name])
                elif name in self.versions:
                    others[name] = self.versions[name]
        return Snapshot(main, needed, others)

    @classmethod
    def of_module(cls, name: str, folders: Iterable[Path] = ()) -> "Snapshot":
        """Read a module by its name, from Python's path or else from `folders`.

        Raises `ModelError` if it is not found, or one of its files cannot be read or is not Python.
        """
        search = _ImportScan(name.partition(".")[0], [*folders])
        search.follow(name)
        if name not in search.modules:
            where = ", ".join(dict.fromkeys(map(str, search.folders)))
            if search.own in sys.stdlib_module_names:
                raise ModelError(
                    f"No user module named {name!r}: the standard library has it; rename the file"
                )
            if name.endswith(".py"):
                raise ModelError(f"write {name[:-3]}, the name of the module, without .py")
            raise ModelError(
                f"No module named {name!r}; the file must lie in a folder of Python's path"
                + (f" or in {where}" if where else "")
            )
        if "." not in name and not search.modules[name].is_package:
            return cls.of_file(Path(search.modules[name].path), search.folders)
        return cls(name, search.modules, search.versions)

    @classmethod
    def of_file(cls, path: Path, folders: Iterable[Path] = ()) -> "Snapshot":
        """Read a file outside packages; it may import files of its folder, relatively too.

        Raises `ModelError` if a file cannot be read or is not Python.
        """
        path = path.absolute()
        name, search = f"{LOOSE}.{path.stem}", _ImportScan(path.stem, [path.parent, *folders])
        search.add_folder(LOOSE, [path.parent])
        search.add(name, path, is_package=False)
        return cls(name, search.modules, search.versions)


class _ImportScan:
    """Search for user modules that follows import statements.

    Parameters
    ----------
    own : str
        Top-level module that counts as user code even if it is installed.
    folders : list of Path
        Folders searched after Python's path.
    """

    def __init__(self, own: str, folders: Sequence[Path]) -> None:
        importlib.invalidate_caches()
        self.own, self.folders = own, folders
        self.modules: dict[str, Module] = {}
        self.versions: dict[str, str] = {}
        self._inside: dict[str, Sequence[Path]] = {}  # folders of packages

    def follow(self, name: str) -> None:
        """Add a module and the packages that contain it, if they are user code."""
        for each in _with_parents(name):
            parent = each.rpartition(".")[0]
            if each in self.modules or each in self.versions:
                continue
            if parent:
                self._take(each, self._inside.get(parent, ()))
            elif each not in sys.stdlib_module_names and each != _OURS:
                self._top(each)

    def _top(self, name: str) -> None:
        # One finder at a time: `importlib.util.find_spec` would return modules already imported.
        finders = (getattr(finder, "find_spec", None) for finder in sys.meta_path)
        found = (find(name, None) for find in finders if find is not None)
        spec = next((spec for spec in found if spec is not None), None)
        if spec is None or (spec.origin is None and not spec.submodule_search_locations):
            if not self._take(name, self.folders):
                self.versions[name] = ABSENT
        elif spec.origin is None or spec.has_location:
            folders = [*map(Path, spec.submodule_search_locations or ())]
            paths = folders if spec.origin is None else [Path(spec.origin)]
            is_installed = any(not _INSTALLED.isdisjoint(path.parts) for path in paths)
            if is_installed and name != self.own and version_of(name):
                self.versions[name] = version_of(name)
            elif spec.origin is None:
                self.add_folder(name, folders)
            else:
                self.add(name, paths[0], is_package=bool(folders))

    def _take(self, name: str, folders: Sequence[Path]) -> bool:
        """Add a module from the first folder that has it; False if none has."""
        last = name.rpartition(".")[2]
        for folder in folders:
            for path in (folder / last / "__init__.py", folder / f"{last}.py"):
                if path.is_file():
                    self.add(name, path, is_package=path.name == "__init__.py")
                    return True
        return self.add_folder(name, [f / last for f in folders if (f / last).is_dir()])

    def add_folder(self, name: str, folders: Sequence[Path]) -> bool:
        """Add a package without ``__init__.py``; False without folders."""
        if folders:
            self._inside[name] = folders
            self.modules[name] = Module(b"", str(folders[0]), is_package=True, data={})
        return bool(folders)

    def add(self, name: str, path: Path, *, is_package: bool) -> None:
        """Add a file and all modules that it imports."""
        if path.suffix != ".py":
            raise ModelError(f"{path}: must be a .py file or belong to an installed package")
        if is_package:
            self._inside[name] = [path.parent]
        try:
            source = path.read_bytes()
            module = Module(source, str(path), is_package, _data(path, source))
            imported = [*_imports(name, module)]
        except OSError as error:
            raise ModelError(f"{error.filename}: cannot be read: {error.strerror}") from None
        except (RecursionError, MemoryError):
            raise ModelError(
                f"{path}: nested too deeply for Python's parser; simplify the file"
            ) from None
        except SyntaxError as error:
            line = f":{error.lineno}" if error.lineno else ""
            raise ModelError(f"{path}{line}: SyntaxError: {error.msg}") from None
        except ValueError as error:
            raise ModelError(f"{path}: {error}") from None
        self.modules[name] = module
        for each in imported:
            self.follow(each)


@cache
def version_of(name: str) -> str:
    """Version of the distribution that contains a module; `ABSENT` if there is none."""
    try:
        return version(name)
    except PackageNotFoundError:
        names = sorted(set(packages_distributions().get(name, ())))
        return " ".join(map(version, names)) or ABSENT


def _imports(name: str, module: Module) -> Iterator[str]:
    """Dotted names in all import statements of a module, inside functions too."""
    parts = name.split(".")
    for node in ast.walk(ast.parse(module.source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            # Level 1 is the module's own package, level 2 the package above.
            above = parts[: len(parts) + module.is_package - node.level] if node.level else []
            start = ".".join([*above, *filter(None, [node.module])])
            yield from filter(None, [start])
            # A name imported from a package may be a module.
            names = (".".join(filter(None, [start, a.name])) for a in node.names if a.name != "*")
            yield from names
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            raise ValueError(
                f"line {node.lineno}: import_module: not supported; write an import statement"
            )


def _data(path: Path, source: bytes) -> dict[str, bytes]:
    """Contents of the data files that a module names in ``__data__``, by name."""
    found: dict[str, bytes] = {}
    for node in ast.parse(source).body:
        match node:
            case ast.Assign(targets=[ast.Name("__data__")], value=value):
                pass
            case ast.AnnAssign(target=ast.Name("__data__"), value=ast.expr() as value):
                pass
            case _:
                continue
        names = [".."]
        if isinstance(value, ast.List | ast.Tuple):
            with suppress(ValueError, TypeError):
                names = [str(PurePosixPath(name)) for name in ast.literal_eval(value)]
        for name in names:
            if ".." in PurePosixPath(name).parts or PurePosixPath(name).is_absolute():
                raise ValueError(
                    f"line {node.lineno}: __data__: must be a list of file names in the "
                    'folder of the module, as __data__ = ["k.csv"]'
                )
            found[name] = (path.parent / name).read_bytes()
    return found


def _with_parents(name: str) -> Iterator[str]:
    """``a``, ``a.b`` and ``a.b.c`` of ``a.b.c``: Python imports all of them."""
    return accumulate(name.split("."), "{}.{}".format)


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
