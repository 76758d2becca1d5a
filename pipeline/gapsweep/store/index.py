"""Index of the cache in memory: from content keys to places of results in slabs."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gapsweep.response.ragged import spans
from gapsweep.status import Status
from gapsweep.study.points import KEY

MISSING = -1  # status of a key that is not stored
# Number of the slab in the order in which they were added, row of the point in it, its status, and
# its rank: if a point has several results, the one of the highest rank counts.
HELD = np.dtype([("slab", "i4"), ("row", "u1"), ("status", "i1"), ("rank", "i8")])
PLACE = np.dtype([("slab", "i4"), ("row", "u1")])  # of a result, without its status
_COUNTS = 2**32  # added to the rank of results that replace any failure

Held = NDArray[Any]  # array of dtype HELD
# Words of the keys of a slab, their status, whether its points are of sweeps, its serial number.
Entry = tuple[NDArray[np.uint64], bytes, bool, int]


def words(keys: bytes | NDArray[np.void]) -> NDArray[np.uint64]:
    """First and second eight bytes of keys, shape (n, 2); enough to tell keys from each other."""
    return np.frombuffer(keys, np.uint64).reshape(-1, KEY.itemsize // 8)[:, :2]


class _Level(NamedTuple):
    """Distinct keys, sorted, as their first and second eight bytes, with places of results."""

    head: NDArray[np.uint64]
    next: NDArray[np.uint64]
    held: Held

    @classmethod
    def of(cls, parts: "Sequence[_Level]") -> "_Level":
        """Merge of several levels, older ones first; the best result of each key is kept."""
        whole = cls._make(map(np.concatenate, zip(*parts, strict=True)))
        head = whole.head
        order = np.argsort(head)  # takes a third of what a stable sort does
        if (head[order[1:]] == head[order[:-1]]).any():
            # Among results of equal rank the latest comes last.
            order = np.lexsort((whole.held["rank"], head))
            order = order[np.append(head[order[1:]] != head[order[:-1]], True)]
        return cls._make(column.take(order) for column in whole)  # a tenth of the time of [order]

    def add_to(self, held: Held, asked: NDArray[np.uint64]) -> None:
        """Enter this level's results of the keys `asked` in `held` if their rank is not lower."""
        head, following = asked.T
        at = np.minimum(np.searchsorted(self.head, head), len(self.head) - 1)
        is_here = (self.head[at] == head) & (self.next[at] == following)
        better = np.flatnonzero(is_here & (self.held["rank"].take(at) >= held["rank"]))
        held[better] = self.held.take(at[better])


class Index:
    """Content keys of all slabs of a cache, a million in 30 megabytes.

    If a point has several results, the one of the highest serial number counts. A failure replaces
    a result only in a sweep, where the older result may have started from another state.
    """

    def __init__(self) -> None:
        self._n_slabs = 0
        # Each much larger than the next: a run adds few keys at a time to a million.
        self._levels: list[_Level] = []

    def add(self, entries: Sequence[Entry]) -> None:
        """Add slabs; each has a status for every key."""
        if not entries:
            return
        keys, status, is_swept, serial = zip(*entries, strict=True)
        counts = np.array(list(map(len, status)))
        held = np.empty(counts.sum(), HELD)
        held["slab"] = np.repeat(np.arange(len(entries)) + self._n_slabs, counts)
        held["row"] = spans(np.zeros_like(counts), counts)
        held["status"] = every = np.frombuffer(b"".join(status), np.int8)
        is_result = (every >= 0) & (every <= Status.OUT_OF_FIT_RANGE)
        held["rank"] = np.repeat(serial, counts)
        held["rank"] += _COUNTS * (is_result | np.repeat(is_swept, counts))
        head, following = np.concatenate(keys).T
        self._n_slabs += len(entries)
        self._levels.append(_Level.of([_Level(head, following, held)]))
        while self._levels[1:] and len(self._levels[-2].head) < 2 * len(self._levels[-1].head):
            self._levels[-2:] = [_Level.of(self._levels[-2:])]

    def find(self, keys: NDArray[np.void]) -> Held:
        """Slab, row, status and rank of each key; slab -1 and `MISSING` if it is not stored."""
        held = np.full(len(keys), np.array((-1, 0, MISSING, -1), HELD))
        asked = words(np.ascontiguousarray(keys))
        order = np.argsort(asked[:, 0])  # neighbours in a level are near in memory
        for level in self._levels:
            level.add_to(held, asked[order])
        found = np.empty_like(held)
        found[order] = held
        return found
