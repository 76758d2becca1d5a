"""Where in the cache the result of a point stands: an index of content keys, in memory."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.status import Status
from gapsweep.study.points import KEY

# In place of a status: nothing is stored, or what is stored fails its checksum.
MISSING, DAMAGED = -1, -2


@dataclass(frozen=True, slots=True, eq=False)
class _Level:
    """Keys in the order of their first bytes, each once, and where their results stand.

    Attributes
    ----------
    keys : ndarray of void, shape (n,)
    slab, row : ndarray of int, shape (n,)
        Position in `Index.ids`, and number of the point there.
    status : ndarray of int8, shape (n,)
    """

    keys: NDArray[np.void]
    slab: NDArray[np.int32]
    row: NDArray[np.int32]
    status: NDArray[np.int8]

    def __len__(self) -> int:
        return len(self.keys)

    @classmethod
    def of(cls, parts: "Sequence[_Level]") -> "_Level":
        """All parts as one; the best result of each key."""
        columns = zip(*((p.keys, p.slab, p.row, p.status) for p in parts), strict=True)
        keys, slab, row, status = map(np.concatenate, columns)
        head = _head(keys)
        order = np.lexsort((row, slab, _is_result(status), head))
        order = order[np.append(head[order[1:]] != head[order[:-1]], True)]
        return cls(keys[order], slab[order], row[order], status[order])

    def find(self, keys: NDArray[np.void]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Which of some keys are here, and where."""
        at = np.minimum(np.searchsorted(_head(self.keys), _head(keys)), len(self) - 1)
        # Two keys with one head are as good as never; the one not found is computed again.
        asked = np.flatnonzero(self.keys[at] == keys)
        return asked, at[asked]


class Index:
    """Content keys of all rows of a cache, a million in about fifty megabytes.

    Of several results of one point the latest counts, but no failure takes the place of a result.

    Attributes
    ----------
    last : int
        Number of the last row of the cache that was added.
    ids : list of int
        Numbers of the rows, in the order in which they were added.
    checksums : list of bytes
        Of these rows.
    seconds : list of float
        Processor time [s] of a point of each, on average.
    """

    def __init__(self) -> None:
        self.last = 0
        self.ids: list[int] = []
        self.checksums: list[bytes] = []
        self.seconds: list[float] = []
        # Each much larger than the next: a run adds few keys at a time to a million.
        self._levels: list[_Level] = []

    def add(self, rows: Iterable[tuple[Any, ...]]) -> None:
        """Add rows: number, keys, status, seconds, checksum. Torn ones hold nothing."""
        new = []
        for number, keys, status, seconds, checksum in rows:
            self.last = number
            n = len(status) if isinstance(status, bytes) else 0
            if not n or not isinstance(keys, bytes) or len(keys) != n * KEY.itemsize:
                continue
            slab, row = np.full(n, len(self.ids), np.int32), np.arange(n, dtype=np.int32)
            new.append(_Level(np.frombuffer(keys, KEY), slab, row, np.frombuffer(status, np.int8)))
            self.ids.append(number)
            self.checksums.append(checksum if isinstance(checksum, bytes) else b"")
            self.seconds.append(seconds / n if isinstance(seconds, float) else np.nan)
        if new:
            self._levels.append(_Level.of(new))
            while len(self._levels) > 1 and len(self._levels[-2]) < 2 * len(self._levels[-1]):
                self._levels[-2:] = [_Level.of(self._levels[-2:])]

    def find(self, keys: NDArray[np.void]) -> _Level:
        """Where the results of keys stand; slab -1 and status `MISSING` of those not stored."""
        n = len(keys)
        slab, row, status = (
            np.full(n, -1, np.int32),
            np.zeros(n, np.int32),
            np.full(n, MISSING, np.int8),
        )
        for level in self._levels:
            asked, at = level.find(keys)
            is_better = _is_result(level.status[at]) | ~_is_result(status[asked])
            asked, at = asked[is_better], at[is_better]
            slab[asked], row[asked] = level.slab[at], level.row[at]
            status[asked] = level.status[at]
        return _Level(keys, slab, row, status)


def _is_result(status: NDArray[np.int8]) -> NDArray[np.bool_]:
    return np.asarray((status >= 0) & (status <= Status.OUT_OF_FIT_RANGE))


def _head(keys: NDArray[np.void]) -> NDArray[np.uint64]:
    """The first eight bytes of each key, by which they are sorted."""
    whole = np.ascontiguousarray(keys)
    return np.ascontiguousarray(whole.view(np.uint64).reshape(-1, 4)[:, 0])
