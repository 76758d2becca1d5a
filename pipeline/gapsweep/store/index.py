"""Index of content keys in memory: the place of each result in the cache."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gapsweep.response.ragged import spans
from gapsweep.status import Status
from gapsweep.study.points import KEY

MISSING = -1  # in place of a status
# Number of the slab in the order in which they were added, of the point in it, its status, and its
# rank: of several results of a point the one of the highest rank counts.
HELD = np.dtype([("slab", "i4"), ("row", "u1"), ("status", "i1"), ("rank", "i8")])
_COUNTS = 2**32  # added to the rank of what takes the place of any failure

Held = NDArray[Any]  # of HELD
# Of a slab its keys' words, their status, whether its points are of sweeps, and its serial number.
Entry = tuple[NDArray[np.uint64], bytes, bool, int]


def words(keys: bytes | NDArray[np.void]) -> NDArray[np.uint64]:
    """First and second eight bytes of keys: two keys that share these are as good as never."""
    return np.frombuffer(keys, np.uint64).reshape(-1, KEY.itemsize // 8)[:, :2]


class _Level(NamedTuple):
    """First and second eight bytes of keys, in order, each once, and where their results stand."""

    head: NDArray[np.uint64]
    next: NDArray[np.uint64]
    held: Held

    @classmethod
    def of(cls, parts: "Sequence[_Level]") -> "_Level":
        """All parts, older ones first, as one; the best result of each key."""
        whole = cls._make(map(np.concatenate, zip(*parts, strict=True)))
        head = whole.head
        order = np.argsort(head)  # takes a third of what a stable sort does
        if (head[order[1:]] == head[order[:-1]]).any():
            # Of equally good ones the latest comes last.
            order = np.lexsort((whole.held["rank"], head))
            order = order[np.append(head[order[1:]] != head[order[:-1]], True)]
        return cls._make(column.take(order) for column in whole)  # a tenth of the time of [order]

    def add_to(self, held: Held, asked: NDArray[np.uint64]) -> None:
        """Note what is here of keys, by their words, where it is no worse than what is noted."""
        head, following = asked.T
        at = np.minimum(np.searchsorted(self.head, head), len(self.head) - 1)
        is_here = (self.head[at] == head) & (self.next[at] == following)
        better = np.flatnonzero(is_here & (self.held["rank"].take(at) >= held["rank"]))
        held[better] = self.held.take(at[better])


class Index:
    """Content keys of all slabs of a cache, a million in 30 megabytes.

    Of several results of one point that of the highest serial number counts, but no failure takes
    the place of a result, save in a sweep, where the older one may have started elsewhere.
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
        """Places of the results of keys; slab -1 and status `MISSING` if not stored."""
        held = np.full(len(keys), np.array((-1, 0, MISSING, -1), HELD))
        for level in self._levels:
            level.add_to(held, words(np.ascontiguousarray(keys)))
        return held
