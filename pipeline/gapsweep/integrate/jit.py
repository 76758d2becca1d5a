"""Compilation of the numerics, and the cache of machine code on disk.

An entry point is compiled together with all functions that it calls, and kept on disk in a file
named by a hash of all sources of this folder and of the target: after an edit of any source, no
process loads outdated machine code.

Machine code may also come with the package (``tools/machine_code.py``), for a level of x86-64 that
many processors have in common: numba compiles it from the same sources for that level, and it gives
the same bits. If none fits the processor, Python, numba and sources, the code is compiled here.
"""

import hashlib
import os
import pickle  # numba's own form of machine code; loaded only from checked folders of this user
import stat
import sys
import sysconfig
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any
from uuid import uuid4

import numba
from filelock import FileLock, Timeout
from llvmlite.binding import get_host_cpu_features
from numba import config, njit
from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.serialize import dumps
from numba.core.sigutils import normalize_signature
from numba.extending import overload

from gapsweep.integrate.problem import LOADING


class InlinedCode(JITCodeLibrary):
    """Code of a function that runs only inside its callers and is optimised together with them.

    numba would also optimise and compile every function separately, with all functions it calls:
    the innermost as often as calls are nested, a third of the compile time in all.
    """

    def _optimize_final_module(self) -> None:
        """Do nothing: the code is optimised as part of its callers."""

    def _finalize_final_module(self) -> None:
        self._finalized = True

    def get_pointer_to_function(self, _name: str) -> int:
        """Return 0: there is no machine code."""
        return 0

    @property
    def codegen(self) -> "InlinedCode":
        return self

    def set_env(self, _name: str, _environment: Any) -> None:
        """Do nothing: functions hold no Python objects."""


class _PartCompiler(Compiler):
    def compile_extra(self, function: Callable[..., Any]) -> Any:
        self.state.library = InlinedCode(self.state.targetctx.codegen(), function.__qualname__)
        return super().compile_extra(function)


# Called only from compiled code: without the wrappers for Python and C, which take longer to
# compile than a small function itself.
_PART = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "pipeline_class": _PartCompiler}
# Nor does a function count references to arrays unless it makes one: its callers own those that
# it works on, and the atomic counts at each call would cost more than recording a step. numba
# refuses to compile a function that does allocate under this option.
internal = njit(**_PART, _nrt=False)
inlined = njit(forceinline=True, **_PART, _nrt=False)
# not inlined even where its callers are: numba would inherit their setting
separate = njit(forceinline=False, **_PART, _nrt=False)


def chosen_by_type(function: Callable[..., Any]) -> Any:
    """Decorator of a function that selects the implementation of `function` by argument types."""
    return overload(function, jit_options={**_PART, "_nrt": False})


# Levels of x86-64, the best first, and the features of each beyond the next. Lower levels, without
# fused multiply-add, would give other bits.
LEVELS = {
    "x86-64-v4": {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"},
    "x86-64-v3": {"avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe"},
}
CHECKSUM = hashlib.sha256().digest_size
_LONGEST_WAIT = 120.0  # seconds, for another process that compiles the same code
SHIPPED = Path(__file__).parents[1] / "machine_code"
# Environment variable with the folder to which machine code to be shipped is written.
SHIP_TO = "GAPSWEEP_SHIP_TO"


class _Code:
    """Machine code of a function in a folder: one file for every key, with its checksum.

    numba's own cache has an index, in which processes that compile two signatures at once can
    exchange the names of their codes; and it does not detect a damaged file.
    """

    def __init__(self, folder: Path, function: Callable[..., Any]) -> None:
        self._folder, self._name = folder, f"{function.__module__}.{function.__qualname__}"

    def _file(self, key: Any) -> Path:
        made_with = source_fingerprint(), numba.__version__, sys.version_info[:2]
        digest = hashlib.sha256(repr((*made_with, key)).encode()).hexdigest()
        return self._folder / f"{self._name}-{digest[:32]}.code"

    def load(self, key: Any) -> Any:
        """Return the saved code of a key; None if there is none, or its file is damaged."""
        try:
            found = self._file(key).read_bytes()
        except OSError:
            return None
        checksum, data = found[:CHECKSUM], found[CHECKSUM:]
        if hashlib.sha256(data).digest() != checksum:
            return None
        return pickle.loads(data)  # machine code, checksum right, from a folder only we can write

    def save(self, key: Any, code: Any) -> None:
        """Write the code of a key to its file; a failure to write is ignored."""
        data, file = dumps(code), self._file(key)
        temporary = file.with_name(f"{file.stem}.{uuid4().hex}")
        try:
            temporary.write_bytes(hashlib.sha256(data).digest() + data)
            temporary.replace(file)
        except OSError:
            with suppress(OSError):
                temporary.unlink()


class MachineCodeCache(FunctionCache):
    """numba's cache of a function on disk; code shipped with the package is tried first."""

    def __init__(self, function: Callable[..., Any]) -> None:
        # numba searches for a cache folder and refuses the function if it finds none.
        users, config.CACHE_DIR = config.CACHE_DIR, str(code_folder())
        try:
            super().__init__(function)
        finally:
            config.CACHE_DIR = users
        self._kept = _Code(code_folder(), function)
        self._came = [_Code(SHIPPED / folder, function) for folder in shipped_for()]
        target = os.environ.get(SHIP_TO)
        self._made = _Code(Path(target), function) if target else None

    def _load_overload(self, signature: Any, target: Any) -> Any:
        places = [(each, signature) for each in self._came]
        places.append((self._kept, self._index_key(signature, target.codegen())))
        for place, key in places:
            data = place.load(key)
            if data is not None:
                found = self._impl.rebuild(target, data)
                if found.signature.args == normalize_signature(signature)[0]:
                    return found
        return None

    def _save_overload(self, signature: Any, data: Any) -> None:
        if not self._impl.check_cachable(data):  # it holds addresses of this process
            return
        code = self._impl.reduce(data)
        self._kept.save(self._index_key(signature, data.codegen), code)
        if self._made is not None:
            self._made.save(signature, code)


@cache
def shipped_for() -> tuple[str, ...]:
    """Names of the folders whose machine code runs here, the best first.

    Empty if the user has set the processor or features for which numba compiles.
    """
    if config.CPU_NAME or config.CPU_FEATURES is not None:
        return ()
    features = {name for name, has in get_host_cpu_features().items() if has}
    several, fit = list(LEVELS), []
    for i, level in enumerate(several):
        if set().union(*(LEVELS[each] for each in several[i:])) <= features:
            fit.append(folder_of(level))
    return tuple(fit)


def folder_of(level: str) -> str:
    """Name of the folder of the machine code for a level, for this Python and operating system."""
    version = f"cp{sys.version_info.major}{sys.version_info.minor}"
    return f"{level}-{version}-{sysconfig.get_platform()}"


def entry(function: Callable[..., Any]) -> Any:
    """Compile a function that Python calls, and keep the machine code on disk."""
    found = njit(nogil=True)(function)
    found._cache = MachineCodeCache(function)
    found.compile = _by_one_process(function, found.compile)
    return counted(found)


def counted(dispatcher: Any) -> Any:
    """Make a dispatcher add the time of loading or compiling to `LOADING`; return it."""
    usual = dispatcher._compile_for_args

    def compiled(*args: Any, **kwargs: Any) -> Any:
        worked, began = time.thread_time(), time.monotonic()
        try:
            return usual(*args, **kwargs)
        finally:
            LOADING.seconds += time.thread_time() - worked
            LOADING.elapsed += time.monotonic() - began

    dispatcher._compile_for_args = compiled
    return dispatcher


def _by_one_process(function: Callable[..., Any], usual: Callable[..., Any]) -> Callable[..., Any]:
    """Return a dispatcher's `compile` under a file lock: other processes wait and load its code."""

    def compiled(signature: Any) -> Any:
        what = hashlib.sha256(str(signature).encode()).hexdigest()[:16]
        lock = FileLock(code_folder() / f"{function.__name__}-{what}.lock", timeout=_LONGEST_WAIT)
        try:
            lock.acquire()
        except (Timeout, OSError, NotImplementedError):  # a file system without locks, too
            return usual(signature)
        try:
            return usual(signature)
        finally:
            lock.release()

    return compiled


@cache
def code_folder() -> Path:
    """Folder of compiled code: in ``NUMBA_CACHE_DIR``, the user's cache, or the temporary folder.

    The first writable one of these is used; the installation itself may be read-only.
    """
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    users = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    for parent in filter(None, (chosen, users)):
        with suppress(OSError):
            return _made(Path(parent))
    try:
        return _made(_private())
    except OSError:
        message = "no writable folder for compiled code; set NUMBA_CACHE_DIR to a folder"
        raise OSError(message) from None


def _made(parent: Path) -> Path:
    folder = parent / "gapsweep" / f"compiled-{source_fingerprint()}"
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=folder):
        return folder


def _private() -> Path:
    """Return a temporary folder that only this user can write to: code in it will be run."""
    if not hasattr(os, "getuid"):  # Windows, where temporary folders are of one user
        return Path(tempfile.gettempdir())
    folder = Path(tempfile.gettempdir()) / f"gapsweep-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    is_closed = stat.S_ISDIR(found.st_mode) and not found.st_mode & 0o022
    if is_closed and found.st_uid == os.getuid():
        return folder
    return Path(tempfile.mkdtemp(prefix="gapsweep-"))


@cache
def source_fingerprint() -> str:
    """Hash (16 hex digits) of all sources below this module's folder, names included.

    The sources of the formulas of contact laws and of the search's loops are included, and modules
    whose numbers are constants of the code.
    """
    here = Path(__file__).parent
    of_laws, search = here.parent / "model", here.parent / "response"
    others = [here.parent / "status.py", search / "compiled.py", search / "thresholds.py"]
    others += [of_laws / "arithmetic.py", of_laws / "contact.py"]
    digest = hashlib.sha256()
    for path in sorted([*here.rglob("*.py"), *(of_laws / "laws").rglob("*.py"), *others]):
        digest.update(path.relative_to(here.parent).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]
