"""When this process began to load gapsweep, and that it loads what the sources say.

Python runs byte code that notes the date, to the second, and the size of its source. A source that
is put in place of another may have both, and the fingerprints in keys are of sources: results of
the old one would be kept under the key of the new one.
"""

import importlib.util
import marshal
import struct
import time
from pathlib import Path

from gapsweep.errors import ClusterError

LOADED = time.time()  # of the source, what is newer than this is not what this process runs
_HEADER = 16  # bytes before the code


def forget_old_byte_code(package: Path) -> None:
    """Delete byte code that was there before the source that it would be taken for.

    Raises
    ------
    ClusterError
        If it cannot be deleted, and is of another source.
    """
    for source in package.rglob("*.py"):
        kept = Path(importlib.util.cache_from_source(str(source)))
        try:
            # No date that a file can be given: when the source came to stand where it is.
            if LOADED >= kept.stat().st_mtime > source.stat().st_ctime:
                continue
        except OSError:  # there is none
            continue
        try:
            kept.unlink(missing_ok=True)
        except OSError:  # an installation that cannot be written, as in a container
            if _is_of_another(kept, source):
                raise ClusterError(f"{kept}: of another {source.name}: delete it") from None


def _is_of_another(kept: Path, source: Path) -> bool:
    """Whether byte code that this Python would run is not what it would make of the source."""
    found, stat = kept.read_bytes(), source.stat()
    if not found.startswith(importlib.util.MAGIC_NUMBER) or len(found) <= _HEADER:
        return False
    flags, date, size = struct.unpack("<3I", found[4:_HEADER])
    # As Python compares them (PEP 552).
    noted = int(stat.st_mtime) & 0xFFFFFFFF, stat.st_size & 0xFFFFFFFF
    if flags == 0 and (date, size) != noted:
        return False
    made = compile(source.read_bytes(), str(source), "exec", dont_inherit=True)
    try:
        # Equal code may have other paths in it.
        return bool(marshal.loads(found[_HEADER:]) != made)
    except (EOFError, TypeError, ValueError):  # cut off
        return True


# Before anything is imported that a result depends on.
forget_old_byte_code(Path(__file__).parent)
