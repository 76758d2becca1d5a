"""Claims on points, so that two runs of one study on one cache share the work.

A claim is a lock on a range of a file in the cache: from the number of a task's first point in its
plan to that of its last, at an offset that is a hash of the plan's points. The operating system
releases it when the process ends. Claims only save work: without such locks every claim succeeds,
and points may be computed and stored twice.
"""

import errno
import hashlib
from pathlib import Path

from gapsweep.errors import StoreError
from gapsweep.store.filesystem import fcntl

_HELD_BY_OTHERS = {errno.EAGAIN, errno.EACCES}
_ROOM = 2**32  # more points than a study can have; offsets in a file have 63 bits


class WorkLocks:
    """The claims of this process on points of one study and cache; a context manager.

    Parameters
    ----------
    cache : Path
    points : bytes-like
        Keys of all points of the study, which give the offset of its claims.
    """

    def __init__(self, cache: Path, points: bytes | memoryview) -> None:
        file = cache / "claims"
        if file.is_symlink() or (file.exists() and not file.is_file()):
            raise StoreError(f"{file}: must be a regular file; remove it")
        self._file = file.open("ab")
        self._place = (int.from_bytes(hashlib.sha256(points).digest()[:4], "big") >> 1) * _ROOM

    def __enter__(self) -> "WorkLocks":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def take(self, first: int, last: int) -> bool:
        """Claim the points `first` to `last`; False if another process holds some of them."""
        return fcntl is None or self._lock(fcntl.LOCK_EX | fcntl.LOCK_NB, first, last)

    def release(self, first: int, last: int) -> None:
        """Release the claim on the points `first` to `last`."""
        if fcntl is not None:
            self._lock(fcntl.LOCK_UN, first, last)

    def _lock(self, how: int, first: int, last: int) -> bool:
        try:
            fcntl.lockf(self._file, how, last - first + 1, self._place + first)
        except OSError as error:
            return error.errno not in _HELD_BY_OTHERS
        return True
