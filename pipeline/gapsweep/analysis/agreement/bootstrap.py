"""Confidence intervals by block bootstrap over frequency.

Responses at neighbouring frequencies are similar, as are those from different initial conditions
at one frequency: they are no independent sample. So whole blocks of frequencies are drawn, with
replacement, each with all of its points (Künsch 1989; blocks that do not overlap, Carlstein
1986). The interval holds the middle 95 % of the statistic over the draws (percentile method).
The draws are the same in every run. Where the points of a block are nearly the same, intervals
of a median or a mean hold the true value in 91 to 94 % of tests (10 to 60 blocks, synthetic data),
those of a 95th percentile in 70 to 88 % (20 to 60 blocks): few blocks contain values of the tail.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gapsweep.analysis.dimensions import Array, Ints

BLOCK = 0.5
N_DRAWS = 200
LEVEL = 0.95
# With fewer blocks there is no interval: their spread is too uncertain.
FEWEST_BLOCKS = 5
_SEED = 20240229
_ROUNDING = 1e-9
_NO_INTERVAL = np.full(2, np.nan)


def blocks(omega: Array) -> Ints:
    """Number of the block of every frequency: `BLOCK` [Hz] wide, from the lowest on."""
    numbers = np.floor((omega - omega.min()) / BLOCK + _ROUNDING)
    return np.asarray(numbers.astype(np.int64))


def quantiles(values: Array, block: Ints, q: tuple[float, ...]) -> tuple[Array, Array]:
    """Quantiles of some values, and the confidence interval of each.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Without NaN.
    block : ndarray of int, shape (n,)
        The block of every value.

    Returns
    -------
    estimates : ndarray, shape (len(q),)
        Quantiles as from `numpy.quantile`; NaN if there are no values.
    intervals : ndarray, shape (len(q), 2)
        NaN if there are fewer than `FEWEST_BLOCKS` blocks, or on average less than one beyond the
        quantile.
    """
    if not values.size:
        return np.full(len(q), np.nan), np.full((len(q), 2), np.nan)
    order = np.argsort(values)
    values, (used, block) = values[order], np.unique(block[order], return_inverse=True)
    estimates = _quantile(values, q)
    if used.size < FEWEST_BLOCKS:
        return estimates, np.full((len(q), 2), np.nan)
    # Number of drawn values up to each value: positions in the drawn, sorted sample.
    upto = np.cumsum(draws(used.size)[:, block], axis=1, dtype=np.int32)
    intervals = [
        _interval(_drawn_quantile(values, upto, share))
        if used.size * (1.0 - share) > 1.0 - _ROUNDING
        else _NO_INTERVAL
        for share in q
    ]
    return estimates, np.stack(intervals)


def _drawn_quantile(values: Array, upto: NDArray[np.int32], share: float) -> Array:
    position = share * (upto[:, -1] - 1)
    low = np.floor(position).astype(np.int32)
    below, above = (
        values[np.argmax(upto > at[:, None], axis=1)]
        for at in (low, np.minimum(low + 1, upto[:, -1] - 1))
    )
    return np.asarray(below + (position - low) * (above - below))


def pooled(sums: Array, block: Ints) -> tuple[float, Array]:
    """The `ratio` of sums over frequencies, and its confidence interval.

    Parameters
    ----------
    sums : ndarray, shape (n, k)
        Terms of the sums, per frequency.
    block : ndarray of int, shape (n,)
        The block of every frequency, ascending.

    Returns
    -------
    estimate : float
    interval : ndarray, shape (2,)
        NaN if fewer than `FEWEST_BLOCKS` blocks hold anything.
    """
    estimate = float(ratio(sums.sum(axis=0)))
    by_block = np.add.reduceat(sums, np.flatnonzero(np.diff(block, prepend=-1)))
    by_block = by_block[np.any(by_block != 0.0, axis=1)]
    if len(by_block) < FEWEST_BLOCKS:
        return estimate, _NO_INTERVAL
    # No matrix product: for so few numbers its threads take longer than the sum.
    drawn = np.einsum("db,bk->dk", draws(len(by_block)), by_block)
    return estimate, _interval(ratio(drawn))


def ratio(sums: Array) -> Array:
    """Ratio of two sums on the last axis, NaN for 0/0; of four sums, the ratio of two ratios.

    Four sums give the ratio of the first two divided by the ratio of the last two.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        ratios = sums[..., ::2] / sums[..., 1::2]
        return np.asarray(
            ratios[..., 0] if ratios.shape[-1] == 1 else ratios[..., 0] / ratios[..., 1]
        )


@lru_cache(maxsize=64)
def draws(n: int) -> NDArray[np.int32]:
    """Number of times that each of `n` blocks is drawn, shape (N_DRAWS, n)."""
    counts = np.random.default_rng(_SEED).multinomial(n, np.full(n, 1.0 / n), size=N_DRAWS)
    return np.asarray(counts, dtype=np.int32)


def _interval(drawn: Array) -> Array:
    """Ends of the 95 % interval of a statistic over its draws, without draws that are NaN."""
    known = drawn[np.isfinite(drawn)]
    if not known.size:
        return _NO_INTERVAL
    tail = 0.5 * (1.0 - LEVEL)
    return _quantile(np.sort(known), (tail, 1.0 - tail))


def _quantile(values: Array, q: tuple[float, ...]) -> Array:
    """Quantiles of sorted values as from `numpy.quantile`, ten times as fast for few values."""
    return np.interp(np.multiply(q, len(values) - 1), np.arange(len(values)), values)
