"""Who is computing what: so that two runs on one cache do not do the same work twice.

A claim is a lock on one byte of a file beside the cache, at a place that the point's key
gives. The operating system drops it when the process ends, however it ends: a killed run
leaves no claim behind. Claims only save work; that no result is lost or mixed up is the
cache's business. Where such locks do not exist, every point can be claimed.
"""

import errno
from pathlib import Path
from types import TracebackType

try:
    import fcntl
except ImportError:  # not a POSIX system
    fcntl = None  # type: ignore[assignment]  # a module that is not there is tested for below

_HELD_BY_OTHERS = {errno.EAGAIN, errno.EACCES}


class Claims:
    """This process' claims on the points of one cache; a context manager."""

    def __init__(self, cache: Path) -> None:
        self._file = cache.with_name(f"{cache.name}-claims").open("ab")

    def __enter__(self) -> "Claims":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()

    def take(self, key: bytes) -> bool:
        """Claim a point; False if another process holds it."""
        if fcntl is None:
            return True
        try:
            fcntl.lockf(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, _place(key))
        except OSError as error:
            return error.errno not in _HELD_BY_OTHERS
        return True

    def release(self, key: bytes) -> None:
        """Give a point up."""
        if fcntl is not None:
            fcntl.lockf(self._file, fcntl.LOCK_UN, 1, _place(key))


def _place(key: bytes) -> int:
    # Places have 63 bits; that two of a million points share one is unlikely and harmless.
    return int.from_bytes(key[:7], "big")
