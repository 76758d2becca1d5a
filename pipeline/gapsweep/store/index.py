"""Where in the cache the result of a point stands: an index of content keys, in memory."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gapsweep.response.lists import spans
from gapsweep.status import Status
from gapsweep.study.points import KEY

# In place of a status: nothing is stored, or what is stored fails its checksum.
MISSING, DAMAGED = -1, -2

_PART = 65_536  # keys that are looked for at a time


class Held(NamedTuple):
    """Where the results of n keys stand.

    Attributes
    ----------
    slab, row : ndarray of int, shape (n,)
        Position in `Index.ids`, and number of the point there.
    status : ndarray of int8, shape (n,)
    """

    slab: NDArray[np.int32]
    row: NDArray[np.int32]
    status: NDArray[np.int8]


class _Level(NamedTuple):
    """Keys in the order of their first eight bytes, each once, and where their results stand.

    Of a key its first eight bytes and the next eight are kept: two keys that share these are as
    good as never.
    """

    head: NDArray[np.uint64]
    next: NDArray[np.uint64]
    slab: NDArray[np.int32]
    row: NDArray[np.int32]
    status: NDArray[np.int8]
    counts: NDArray[np.bool_]  # against older ones that are results

    @classmethod
    def of(cls, parts: "Sequence[_Level]") -> "_Level":
        """All parts, older ones first, as one; the best result of each key."""
        whole = (
            parts[0]
            if len(parts) == 1
            else cls._make(map(np.concatenate, zip(*parts, strict=True)))
        )
        head = whole.head
        order = np.argsort(head)  # takes a third of what a stable sort does
        if (head[order[1:]] == head[order[:-1]]).any():
            # Of equally good ones the latest comes last.
            order = np.lexsort((whole.counts, head))
            order = order[np.append(head[order[1:]] != head[order[:-1]], True)]
        return cls._make(column[order] for column in whole)

    def add_to(self, held: Held, words: NDArray[np.uint64]) -> None:
        """Note what is here of the keys of these words, where it is better than what is noted."""
        head = words[:, 0]
        at = np.minimum(np.searchsorted(self.head, head), len(self.head) - 1)
        asked = np.flatnonzero((self.head[at] == head) & (self.next[at] == words[:, 1]))
        is_better = self.counts[at[asked]] | ~_is_result(held.status[asked])
        asked = asked[is_better]
        held.slab[asked], held.row[asked] = self.slab[at[asked]], self.row[at[asked]]
        held.status[asked] = self.status[at[asked]]


class Index:
    """Content keys of all rows of a cache, a million in 25 megabytes.

    Of several results of one point the latest counts, but no failure takes the place of a result,
    save in a sweep, where the older one may have started elsewhere.

    Attributes
    ----------
    last : int
        Number of the last row of the cache that was added.
    ids : list of int
        Numbers of the rows, in the order in which they were added.
    """

    def __init__(self) -> None:
        self.last = 0
        self.ids: list[int] = []
        # Each much larger than the next: a run adds few keys at a time to a million.
        self._levels: list[_Level] = []

    def add(self, rows: Sequence[tuple[int, Any, Any, Any]]) -> None:
        """Add rows: number, keys, status, whether of sweeps. Torn ones hold nothing."""
        self.last = rows[-1][0]
        whole = [row for row in rows if _is_whole(*row[1:3])]
        if not whole:
            return
        ids, keys, status, is_swept = zip(*whole, strict=True)
        counts = np.array(list(map(len, status)), np.int32)
        words = _words(b"".join(keys))
        slab = np.repeat(np.arange(len(ids), dtype=np.int32) + len(self.ids), counts)
        row = spans(np.zeros_like(counts), counts).astype(np.int32)
        every = np.frombuffer(b"".join(status), np.int8)
        counting = _is_result(every) | np.repeat(np.array(is_swept, bool), counts)
        self.ids += ids
        level = _Level(words[:, 0], words[:, 1], slab, row, every, counting)
        self._levels.append(_Level.of([level]))
        while len(self._levels) > 1 and _n_keys(self._levels[-2]) < 2 * _n_keys(self._levels[-1]):
            self._levels[-2:] = [_Level.of(self._levels[-2:])]

    def find(self, keys: NDArray[np.void]) -> Held:
        """Where the results of keys stand; slab -1 and status `MISSING` of those not stored."""
        n, words = len(keys), _words(np.ascontiguousarray(keys))
        slab, row = np.full(n, -1, np.int32), np.zeros(n, np.int32)
        status = np.full(n, MISSING, np.int8)
        for first in range(0, n, _PART):
            part = slice(first, first + _PART)
            for level in self._levels:
                level.add_to(Held(slab[part], row[part], status[part]), words[part])
        return Held(slab, row, status)


def _n_keys(level: _Level) -> int:
    return len(level.head)


def _is_whole(keys: Any, status: Any) -> bool:
    """Whether every point of a row has its key and its status."""
    are_bytes = isinstance(keys, bytes) and isinstance(status, bytes)
    return are_bytes and len(keys) == len(status) * KEY.itemsize > 0


def _is_result(status: NDArray[np.int8]) -> NDArray[np.bool_]:
    return np.asarray((status >= 0) & (status <= Status.OUT_OF_FIT_RANGE))


def _words(keys: Any) -> NDArray[np.uint64]:
    """Keys as whole numbers of eight bytes, shape (n, 4)."""
    return np.frombuffer(keys, np.uint64).reshape(-1, KEY.itemsize // 8)
