"""Lists of different lengths as flat arrays: the items of all rows, row after row."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Counts = NDArray[np.int64]


def spans(first: NDArray[np.integer], counts: NDArray[np.integer]) -> Counts:
    """Positions ``first, ..., first + counts - 1`` of the items of each row, row after row.

    `first` and `counts`: shape (n,). Result: shape (sum of counts,).
    """
    begin = (first - counts.cumsum() + counts).repeat(counts)
    return np.asarray(begin + np.arange(len(begin)))


class RaggedArrays:
    """A list of numbers for each of n rows; a later list of a row replaces the earlier one.

    Attributes
    ----------
    counts : ndarray of int, shape (n,)
        Length of each list; -1 for rows without a list.
    """

    def __init__(self, n: int) -> None:
        self.counts, self._first = np.full(n, -1), np.zeros(n, np.int64)
        self._pieces: list[NDArray[Any]] = [np.empty(0)]
        self._size = 0

    def put(self, rows: NDArray[np.intp], items: NDArray[Any], counts: NDArray[np.integer]) -> None:
        """Store the lists of some rows; `items` are those of all rows, row after row."""
        self._first[rows], self.counts[rows] = self._size + np.cumsum(counts) - counts, counts
        self._pieces.append(items)
        self._size += len(items)

    def of(self, rows: NDArray[np.intp]) -> tuple[NDArray[Any], Counts]:
        """Return the lists of some rows: all items, row after row, and the number of each row."""
        counts = self.counts[rows]
        return np.concatenate(self._pieces)[spans(self._first[rows], counts)], counts
