"""Execution of a snapshot: its files become modules of a private package.

The package's name holds the key, as ``gapsweep_user_<key>``. Its modules have a private
``__import__``, which takes the user's modules from the snapshot and all others from Python. So
``sys.path``, ``sys.meta_path``, byte code and modules of the same name have no effect, and a
process can load two snapshots of one file. Module-level code that does not raise runs once per
process and snapshot.
"""

import builtins
import inspect
import os
import re
import shutil
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager
from functools import cache
from importlib.machinery import ModuleSpec
from importlib.util import resolve_name
from multiprocessing.util import Finalize
from pathlib import Path
from types import ModuleType
from typing import Any

from gapsweep.errors import ClusterError, ModelError, StudyError, described
from gapsweep.user_code.snapshot import ABSENT, LOOSE, Module, Snapshot, version_of

_PREFIX = "gapsweep_user_"
# Environment variable: a folder for temporary files, which another process removes.
TEMPORARY = "GAPSWEEP_TEMPORARY"
_lock = threading.RLock()
# Path of each file of user code by the file name in its code objects.
_paths: dict[str, str] = {}


def load(snapshot: Snapshot) -> ModuleType:
    """The main module of a snapshot, executed in this process.

    Raises `ClusterError` if this process has another version of a distribution that the code
    imports, and any error that the user's code raises.
    """
    with _lock:
        package = _Package(snapshot)
        name = f"{package.name}.{snapshot.main}"
        if name not in sys.modules:
            for module, wanted in snapshot.versions.items():
                if wanted != ABSENT and (here := version_of(module)) != wanted:
                    raise ClusterError(
                        f"{snapshot.main}: imports {module} {wanted}, but a process has "
                        f"{here or 'none'}; install the same version for client and workers"
                    )
            with chdir("."):  # restores the folder if the code changes it
                package.module(snapshot.main)
        return sys.modules[name]


def load_module(snapshot: Snapshot) -> ModuleType:
    """Load a snapshot; errors of its code become a `StudyError` of one line."""
    with user_errors(snapshot.path):
        return load(snapshot)


def load_for_law(snapshot: Snapshot, label: str) -> ModuleType:
    """Load a snapshot; errors of its code become a `ModelError` of one line."""
    try:
        return load(snapshot)
    except ModelError as error:  # as of an invalid table in it
        raise ModelError(f"{label!r}: {error}") from None
    except (KeyboardInterrupt, MemoryError, ClusterError):
        raise
    except BaseException as error:  # the user's code may raise anything, SystemExit too
        message = blame(snapshot.path, error, f"importing it raised {described(error)}")
        raise ModelError(f"{label!r}: {message}") from None


def plain(name: str) -> str:
    """The text with module names as the user knows them, without the private package."""
    return re.sub(rf"{_PREFIX}[0-9a-f]+\.?({LOOSE}\.)?", "", name)


def inner_name(module: str, snapshot: Snapshot) -> str | None:
    """The name in a snapshot of a loaded module; None if it is not of this snapshot."""
    name = module.removeprefix(f"{_PREFIX}{snapshot.key}.")
    return name if name != module and name in snapshot.modules else None


class _Package:
    """The private package in which the modules of a snapshot are executed."""

    def __init__(self, snapshot: Snapshot) -> None:
        self.snapshot, self.name = snapshot, f"{_PREFIX}{snapshot.key}"
        self._tops = {name.partition(".")[0] for name in snapshot.modules}
        if self.name not in sys.modules:
            sys.modules[self.name] = ModuleType(self.name)
            sys.modules[self.name].__path__ = []

    def module(self, name: str) -> ModuleType:
        """The module of a name in the snapshot, executed at the first call."""
        full, above = f"{self.name}.{name}", name.rpartition(".")[0]
        with _lock:
            if full in sys.modules:
                return sys.modules[full]
            if name not in self.snapshot.modules:
                raise ModuleNotFoundError(f"No module named {name!r}", name=name)
            parent = self.module(above) if above else sys.modules[self.name]
            made = sys.modules[full] = self._new(full, self.snapshot.modules[name])
            try:
                self._execute(made, self.snapshot.modules[name])
            except BaseException:
                del sys.modules[full]
                raise
            setattr(parent, name.rpartition(".")[2], made)
        return made

    def _new(self, full: str, source: Module) -> ModuleType:
        made = ModuleType(full)
        loader: Any = _Loader(source)  # for tracebacks only: not one of importlib
        made.__spec__ = ModuleSpec(full, loader, is_package=source.is_package)
        made.__loader__ = loader
        made.__package__ = full if source.is_package else full.rpartition(".")[0]
        if source.is_package:
            made.__path__ = []
        vars(made)["__builtins__"] = {**vars(builtins), "__import__": self._import}
        return made

    def _execute(self, made: ModuleType, source: Module) -> None:
        try:
            place = _placed(self.snapshot.key, source)
        except OSError as error:  # an error of the machine, not of the code
            raise ClusterError(f"user code: {error.filename}: {error.strerror}") from None
        made.__file__ = str(place)
        # numba caches machine code by file name and time: others keep the name of their source.
        file = str(place) if "numba" in self.snapshot.versions else source.path
        _paths[file] = source.path
        exec(compile(source.source, file, "exec", dont_inherit=True), vars(made))

    def _import(
        self, name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0
    ) -> Any:
        """The ``__import__`` of user code: its modules are of the snapshot, others of Python."""
        top = name.partition(".")[0]
        if level:
            absolute = resolve_name("." * level + name, globals["__package__"])
            name = absolute.removeprefix(self.name).lstrip(".")
        elif top not in self._tops:
            # Imports by compiled code of libraries arrive here, too.
            is_known = top in sys.modules or top in sys.stdlib_module_names or version_of(top)
            if self.snapshot.versions.get(top) == ABSENT or not is_known:
                raise ModuleNotFoundError(f"No module named {name!r}", name=name)
            return builtins.__import__(name, globals, locals, fromlist, level)
        found = self.module(name) if name else sys.modules[self.name]
        if not fromlist:
            return self.module(top)
        names = [*fromlist, *(getattr(found, "__all__", ()) if "*" in fromlist else ())]
        for each in names:
            inner = f"{name}.{each}".lstrip(".")
            if not hasattr(found, each) and inner in self.snapshot.modules:
                self.module(inner)
        return found


class _Loader:
    """Loader that gives tracebacks the source of modules without a file."""

    def __init__(self, source: Module) -> None:
        self._source = source

    def get_source(self, _name: str) -> str:
        return self._source.source.decode("utf-8", "replace")


@cache
def _folder() -> Path:
    """The private temporary folder of this process, removed at its end (in workers, too)."""
    path = Path(tempfile.mkdtemp(prefix="gapsweep-user-code-", dir=os.environ.get(TEMPORARY)))
    Finalize(None, shutil.rmtree, (path, True), exitpriority=0)
    return path


def _placed(key: str, source: Module) -> Path:
    """Path of a module in a private folder of this process, after its data files are written."""
    path = Path(source.path)
    number = _numbers.setdefault((key, str(path.parent)), len(_numbers))
    folder = _folder() / str(number)
    for name, data in {path.name: source.source, **source.data}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        if source.source or name in source.data:
            (folder / name).write_bytes(data)
    return folder / path.name


# Number of the private folder for each snapshot and folder.
_numbers: dict[tuple[str, str], int] = {}


@contextmanager
def user_errors(
    path: Path, what: str = "", function: Callable[..., Any] | None = None
) -> Iterator[None]:
    """Turn errors of user code in the block into a `StudyError` of one line.

    `path`: the file whose code runs.
    `what`: name of the part of the file that runs, for the message.
    `function`: the function that is called; its line is named if the error has none.
    """
    try:
        yield
    except (KeyboardInterrupt, GeneratorExit, StudyError, ClusterError):
        raise
    except BaseException as error:  # the user's code may raise anything, SystemExit too
        message = f"{what}: {described(error)}" if what else described(error)
        raise StudyError(blame(path, error, message, function)) from None


def blame(path: Path | None, error: BaseException, message: str, function: Any = None) -> str:
    """The message with file and line of the user code that ran last before it, or else `path`."""
    where = "" if path is None else f"{path}: "
    if isinstance(error, FileNotFoundError) and str(_folder()) in str(error.filename):
        name = Path(error.filename).name
        message = f'{name}: not a declared data file; add __data__ = ["{name}"] to the module'
    code = getattr(inspect.unwrap(function), "__code__", None) if callable(function) else None
    ran = [(frame.f_code, line) for frame, line in traceback.walk_tb(error.__traceback__)]
    for each, line in ([(code, code.co_firstlineno)] if code else []) + ran:
        if each.co_filename in _paths:
            where = f"{_paths[each.co_filename]}:{line}: "
    return f"{where}{plain(message)}"
