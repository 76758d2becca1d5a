"""Lists of different lengths as flat arrays: one row's items after the other's."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Counts = NDArray[np.int64]


def spans(first: NDArray[np.integer], counts: NDArray[np.integer]) -> Counts:
    """Positions ``first, first + 1, ...`` of as many items as each row has, row after row.

    Parameters
    ----------
    first, counts : ndarray of int, shape (n,)

    Returns
    -------
    ndarray of int, shape (sum of counts,)
    """
    begin = (first - counts.cumsum() + counts).repeat(counts)
    return np.asarray(begin + np.arange(len(begin)))


class RaggedArrays:
    """A list of numbers for each of n rows, as it was put last.

    Attributes
    ----------
    counts : ndarray of int, shape (n,)
        How long each is; -1 where none was put.
    """

    def __init__(self, n: int) -> None:
        self.counts, self._first = np.full(n, -1), np.zeros(n, np.int64)
        self._pieces: list[NDArray[Any]] = [np.empty(0)]
        self._size = 0

    def put(self, rows: NDArray[np.intp], items: NDArray[Any], counts: NDArray[np.integer]) -> None:
        """Put lists of some rows; `items` are those of the first row, of the second, and so on."""
        self._first[rows], self.counts[rows] = self._size + np.cumsum(counts) - counts, counts
        self._pieces.append(items)
        self._size += len(items)

    def of(self, rows: NDArray[np.intp]) -> tuple[NDArray[Any], Counts]:
        """Lists of some rows, each of which has one: all items, and how many are each row's."""
        counts = self.counts[rows]
        return np.concatenate(self._pieces)[spans(self._first[rows], counts)], counts
