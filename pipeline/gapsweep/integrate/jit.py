"""How the numerics are compiled, and where the machine code is kept.

numba compiles an entry point together with all it calls and keeps the result on disk. It knows
that a file has changed only for the file that holds the entry point: after an edit in a module
that this one imports, a new process would load old machine code and return old numbers. Hence
the folder of compiled code carries a hash of all sources in its name.
"""

import hashlib
import os
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from numba import config, njit

# Called from compiled code alone: without the wrappers for Python and C, which take longer to
# compile than a small function itself.
_BARE = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
allocating = njit(**_BARE)
# Nor does a function count references to arrays unless it makes one: its callers own those that
# it works on, and the atomic counts at each call would cost more than recording a step. numba
# refuses to compile a function that does allocate under this option.
internal = njit(**_BARE, _nrt=False)
inlined = njit(forceinline=True, **_BARE, _nrt=False)


def entry(function: Callable[..., Any]) -> Any:
    """Compile a function that Python calls, and keep the machine code on disk."""
    users_choice = config.CACHE_DIR
    # numba looks at the setting when it decorates, so the user's own functions never see ours.
    config.CACHE_DIR = str(code_folder())
    try:
        return njit(cache=True, nogil=True)(function)
    finally:
        config.CACHE_DIR = users_choice


@cache
def code_folder() -> Path:
    """Folder of compiled code: in ``NUMBA_CACHE_DIR``, the user's cache, or the temporary folder.

    The first one that can be written; a read-only installation is none of them.
    """
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    users = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    owner = os.getuid() if hasattr(os, "getuid") else "user"
    parents = [users, os.path.join(tempfile.gettempdir(), f"gapsweep-{owner}")]
    for parent in [chosen, *parents] if chosen else parents:
        folder = Path(parent) / "gapsweep" / f"compiled-{source_fingerprint()}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return folder
        except OSError:
            continue
    raise OSError("no folder for compiled code can be written: set NUMBA_CACHE_DIR to one")


def source_fingerprint() -> str:
    """Hash (16 hex digits) of all sources below this module's folder, names included."""
    here = Path(__file__).parent
    digest = hashlib.sha256()
    for path in sorted(here.rglob("*.py")):
        digest.update(path.relative_to(here).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]
