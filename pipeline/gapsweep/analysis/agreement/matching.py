"""One-to-one matching with the largest number of matches, and then the least total cost."""

import numpy as np
from scipy.optimize import linear_sum_assignment

from gapsweep.analysis.dimensions import Array, Ints

_LARGEST = 1e12


def assignment(cost: Array, limit: float) -> tuple[Ints, Ints]:
    """Pair the members of two sets, each at most once, until one set has no members left.

    The assignment has the largest number of pairs with a cost within `limit`, and among these
    assignments the least total cost (Kuhn 1955, the Hungarian method).

    Parameters
    ----------
    cost : ndarray, shape (n, m)
        Cost of each pair, ``>= 0``.
    limit : float
        Largest cost of a match; pairs of larger cost are returned, but never replace a match.

    Returns
    -------
    rows, columns : ndarray, shape (min(n, m),)
    """
    if cost.size == 1:
        return np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64)
    cost = np.minimum(cost, _LARGEST)
    # A pair beyond the limit costs more than all costs together: fewer of them come first.
    penalty = np.where(cost > limit, cost.sum() + limit, 0.0)
    rows, columns = linear_sum_assignment(cost + penalty)
    return np.asarray(rows), np.asarray(columns)


def matches_on_line(a: Array, b: Array, limit: float) -> tuple[Ints, Ints]:
    """Positions of matching numbers, which differ by at most `limit`; see `assignment`."""
    apart = np.abs(a[:, None] - b[None, :])
    rows, columns = assignment(apart, limit)
    kept = apart[rows, columns] <= limit
    return rows[kept], columns[kept]
