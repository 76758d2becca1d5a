"""When this process began to load gapsweep, and that it loads what the sources say.

Python runs byte code that notes the date, to the second, and the size of its source. A source that
is put in place of another may have both, and the fingerprints in keys are of sources: results of
the old one would be kept under the key of the new one.
"""

import importlib.util
import time
from importlib.machinery import SourceFileLoader
from pathlib import Path

from gapsweep.errors import ClusterError

LOADED = time.time()  # of the source, what is newer than this is not what this process runs


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
            if _is_of_another(source):
                raise ClusterError(f"{kept}: of another {source.name}: delete it") from None


def _is_of_another(source: Path) -> bool:
    """Whether Python would run what it would not make of the source."""
    loader = SourceFileLoader(source.stem, str(source))
    made = loader.source_to_code(source.read_bytes(), str(source))
    try:
        return bool(loader.get_code(source.stem) != made)
    except (EOFError, TypeError, ValueError):  # cut off
        return True


# Before anything is imported that a result depends on.
forget_old_byte_code(Path(__file__).parent)
