"""Execution of a snapshot: the bytes become modules of a package of their own.

The package's name holds the key, as ``gapsweep_user_<key>``. Its modules have an ``__import__`` of
their own, which takes the user's modules from the snapshot and all others from Python. So
``sys.path``, ``sys.meta_path``, byte code and modules of the same name play no part, and two
snapshots of one file live side by side. Module-level code that does not raise runs once per process
and snapshot.
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
from gapsweep.user_code.snapshot import ABSENT, BESIDE, Module, Snapshot, version_of

_PREFIX = "gapsweep_user_"
# Environment variable: the folder of temporary files that another process removes.
TEMPORARY = "GAPSWEEP_TEMPORARY"
_lock = threading.RLock()
# Where user code was compiled from, by the file name that its code objects have.
_paths: dict[str, str] = {}


def load(snapshot: Snapshot) -> ModuleType:
    """The module that a snapshot was taken of, executed in this process.

    Raises
    ------
    ClusterError
        If this process has other versions of the distributions that it imports.
    BaseException
        Whatever the user's code raises.
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
            with chdir("."):  # wherever the code goes, this process stays
                package.module(snapshot.main)
        return sys.modules[name]


def load_module(snapshot: Snapshot) -> ModuleType:
    """`load`; whatever the code raises becomes a `StudyError` of one line."""
    with user_errors(snapshot.path):
        return load(snapshot)


def load_for_law(snapshot: Snapshot, label: str) -> ModuleType:
    """`load`; whatever the code raises becomes a `ModelError` of one line."""
    try:
        return load(snapshot)
    except ModelError as error:  # of a table in it, say
        raise ModelError(f"{label!r}: {error}") from None
    except (KeyboardInterrupt, MemoryError, ClusterError):
        raise
    except BaseException as error:  # the user's code may raise anything, SystemExit too
        message = blame(snapshot.path, error, f"importing it raised {described(error)}")
        raise ModelError(f"{label!r}: {message}") from None


def plain(name: str) -> str:
    """A text without the names of these packages: a module's name as the user knows it."""
    return re.sub(rf"{_PREFIX}[0-9a-f]+\.?({BESIDE}\.)?", "", name)


def inner_name(module: str, snapshot: Snapshot) -> str | None:
    """A module's name in the snapshot that it was executed from; None if it was not."""
    name = module.removeprefix(f"{_PREFIX}{snapshot.key}.")
    return name if name != module and name in snapshot.modules else None


class _Package:
    """The package that the modules of a snapshot are executed in."""

    def __init__(self, snapshot: Snapshot) -> None:
        self.snapshot, self.name = snapshot, f"{_PREFIX}{snapshot.key}"
        self._tops = {name.partition(".")[0] for name in snapshot.modules}
        if self.name not in sys.modules:
            sys.modules[self.name] = ModuleType(self.name)
            sys.modules[self.name].__path__ = []

    def module(self, name: str) -> ModuleType:
        """A module of the snapshot, executed if it has not been."""
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
        made, loader = ModuleType(full), _Loader(source)
        made.__spec__ = ModuleSpec(full, loader, is_package=source.is_package)  # type: ignore[arg-type]
        made.__loader__ = loader  # type: ignore[assignment]
        made.__package__ = full if source.is_package else full.rpartition(".")[0]
        if source.is_package:
            made.__path__ = []
        vars(made)["__builtins__"] = {**vars(builtins), "__import__": self._import}
        return made

    def _execute(self, made: ModuleType, source: Module) -> None:
        try:
            place = _placed(self.snapshot.key, source)
        except OSError as error:  # the machine's trouble, and not the code's
            raise ClusterError(f"user code: {error.filename}: {error.strerror}") from None
        made.__file__ = str(place)
        # numba keeps machine code of @njit(cache=True) by file name and time: not for others.
        file = str(place) if "numba" in self.snapshot.versions else source.path
        _paths[file] = source.path
        exec(compile(source.source, file, "exec", dont_inherit=True), vars(made))

    def _import(
        self, name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0
    ) -> Any:
        """The function that import statements of the user's code call."""
        top = name.partition(".")[0]
        if level:
            absolute = resolve_name("." * level + name, globals["__package__"])
            name = absolute.removeprefix(self.name).lstrip(".")
        elif top not in self._tops:
            # What a library imports in compiled code comes here too.
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
    """Gives tracebacks the source of modules whose file is not there."""

    def __init__(self, source: Module) -> None:
        self._source = source

    def get_source(self, _name: str) -> str:
        return self._source.source.decode("utf-8", "replace")


@cache
def _folder() -> Path:
    """The private folder of this process, removed at its end; workers are multiprocessing's."""
    path = Path(tempfile.mkdtemp(prefix="gapsweep-user-code-", dir=os.environ.get(TEMPORARY)))
    Finalize(None, shutil.rmtree, (path, True), exitpriority=0)
    return path


def _placed(key: str, source: Module) -> Path:
    """Path of a module in this process: in a private folder with its data files only."""
    path = Path(source.path)
    number = _numbers.setdefault((key, str(path.parent)), len(_numbers))
    folder = _folder() / str(number)
    for name, data in {path.name: source.source, **source.data}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        if source.source or name in source.data:
            (folder / name).write_bytes(data)
    return folder / path.name


# Of every snapshot and folder the number of the private folder that stands for it.
_numbers: dict[tuple[str, str], int] = {}


@contextmanager
def user_errors(
    path: Path, what: str = "", function: Callable[..., Any] | None = None
) -> Iterator[None]:
    """Whatever a study's own code raises in this block becomes a `StudyError` of one line.

    Parameters
    ----------
    path : Path
        The file whose code runs.
    what : str
        The part of it, for the message.
    function : callable, optional
        The function that is called; its line is named if the error has none.
    """
    try:
        yield
    except (KeyboardInterrupt, GeneratorExit, StudyError, ClusterError):
        raise
    except BaseException as error:  # the user's code may raise anything, SystemExit too
        message = f"{what}: {described(error)}" if what else described(error)
        raise StudyError([blame(path, error, message, function)]) from None


def blame(path: Path | None, error: BaseException, message: str, function: Any = None) -> str:
    """A message after the file and the last line of the user's code that ran, or else a path."""
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
