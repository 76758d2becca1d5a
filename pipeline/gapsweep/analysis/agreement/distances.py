"""Distances of finite sets, many pairs of sets in one call.

A row holds one set; NaN at the end of a row is padding. Rows are computed in batches of
similar size, so that a few long ones (chaotic responses) do not slow down the many short ones.
The distance to an empty set is NaN.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from gapsweep.analysis.dimensions import Array, Ints

# Numbers in one temporary array: small enough to stay in cache.
_BATCH = 2**19


def hausdorff_on_line(a: Array, b: Array) -> Array:
    """Hausdorff distance of sets of numbers: the largest distance of a member to the other set.

    `a` and `b`: shape (n, ...); sets, one per row. Result: shape (n,).
    """
    return _by_size(_hausdorff_on_line, a, b, power=1)


def hausdorff_in_plane(a: Array, b: Array, share: float = 1.0) -> Array:
    """Hausdorff distance of two sets of points in the plane, or the partial one.

    `a` and `b`: shape (n, ..., 2); sets, one per row.
    `share`: quantile of the distances to the nearest member of the other set; 1 is their maximum,
    the Hausdorff distance, which a single outlier of a chaotic sample determines.
    Result: shape (n,).
    """
    return _by_size(partial(_hausdorff_in_plane, share=share), a, b, power=2)


def _by_size(distance: Callable[[Array, Array], Array], a: Array, b: Array, power: int) -> Array:
    """`distance` of all rows, computed in batches of similar size without their padding.

    The work for two sets of n members grows like n to the `power`.
    """
    result = np.full(len(a), np.nan)
    n_a, n_b = _sizes(a), _sizes(b)
    some = np.flatnonzero((n_a > 0) & (n_b > 0))
    # The next power of two, so that there are few sizes and little padding.
    size = 2 ** np.ceil(np.log2(np.maximum(n_a, n_b)[some])).astype(np.int64)
    for n in np.unique(size).tolist():
        rows, step = some[size == n], max(1, _BATCH // n**power)
        for batch in (rows[at : at + step] for at in range(0, len(rows), step)):
            result[batch] = distance(a[batch, :n], b[batch, :n])
    return result


def _sizes(sets: Array) -> Ints:
    finite = np.isfinite(sets if sets.ndim == 2 else sets[..., 0])
    return np.asarray(np.count_nonzero(finite, axis=1))


def _hausdorff_on_line(a: Array, b: Array) -> Array:
    both = np.concatenate([a, b], axis=1)
    order = np.argsort(both, axis=1)
    values, of_a = np.take_along_axis(both, order, axis=1), order < a.shape[1]
    nearest = np.full(values.shape, np.inf)
    for own in (of_a, ~of_a):
        others = ~own & np.isfinite(values)
        below = np.maximum.accumulate(np.where(others, values, -np.inf), axis=1)
        above = np.minimum.accumulate(np.where(others, values, np.inf)[:, ::-1], axis=1)[:, ::-1]
        nearest = np.where(own, np.minimum(values - below, above - values), nearest)
    return np.asarray(np.nanmax(nearest, axis=1))


def _hausdorff_in_plane(a: Array, b: Array, share: float) -> Array:
    squares = np.zeros((len(a), a.shape[1], b.shape[1]))
    for axis in (0, 1):
        squares += (a[:, :, None, axis] - b[:, None, :, axis]) ** 2
    # Padding is at infinite distance.
    squares[np.isnan(squares)] = np.inf
    directed = [
        _quantile(squares.min(axis=axis), n, share) for axis, n in ((2, _sizes(a)), (1, _sizes(b)))
    ]
    return np.asarray(np.maximum(*directed))


def _quantile(squares: Array, n: Ints, share: float) -> Array:
    """Quantile `share` of the square roots of the `n` smallest numbers of every row."""
    roots = np.sqrt(np.sort(squares, axis=1))
    position = share * (n - 1)
    low = np.floor(position).astype(np.int64)
    rows = np.arange(len(n))
    below, above = roots[rows, low], roots[rows, np.minimum(low + 1, n - 1)]
    return np.asarray(below + (position - low) * (above - below))
