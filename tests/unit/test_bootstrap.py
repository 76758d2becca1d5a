"""Block bootstrap: its quantiles, its pooling, and whether its intervals hold what they say."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from gapsweep.analysis.agreement import bootstrap
from gapsweep.analysis.agreement.bootstrap import blocks, pooled, quantiles, ratio

Q = (0.5, 0.95)


def test_blocks_are_half_a_hertz_wide():
    omega = np.round(np.arange(1.0, 3.0, 0.1), 12)
    assert np.bincount(blocks(omega)).tolist() == [5, 5, 5, 5]
    assert blocks(np.array([1.0, 7.2])).tolist() == [0, 12]


@given(
    st.lists(st.tuples(st.floats(0, 1e3), st.integers(0, 29)), min_size=1, max_size=60),
    st.integers(5, 30),
)
def test_quantiles_and_intervals_are_those_of_the_samples_drawn(cells, n_blocks):
    values, block = (np.array(column) for column in zip(*cells, strict=True))
    block = block % n_blocks
    estimates, intervals = quantiles(values, block, Q)
    assert_allclose(estimates, np.quantile(values, Q))
    used = np.unique(block)
    if used.size < bootstrap.FEWEST_BLOCKS:
        assert np.isnan(intervals).all()
        return
    draws = bootstrap.draws(used.size)
    of = np.searchsorted(used, block)
    samples = [np.quantile(np.repeat(values, draw[of]), Q) for draw in draws]
    expected = np.quantile(samples, (0.025, 0.975), axis=0).T
    if used.size < 20:
        expected[1] = np.nan  # less than one block is beyond the 95th percentile
    assert_allclose(intervals, expected)


def test_pooled_statistics_are_those_of_the_blocks_drawn():
    rng = np.random.default_rng(0)
    sums, block = rng.uniform(size=(30, 2)), np.repeat(np.arange(10), 3)
    estimate, interval = pooled(sums, block)
    assert_allclose(estimate, sums[:, 0].sum() / sums[:, 1].sum())
    by_block = sums.reshape(10, 3, 2).sum(axis=1)
    drawn = [ratio((draw[:, None] * by_block).sum(axis=0)) for draw in bootstrap.draws(10)]
    assert_allclose(interval, np.quantile(drawn, (0.025, 0.975)))


def test_blocks_that_hold_nothing_are_not_drawn():
    sums = np.zeros((12, 2))
    sums[:5] = 1.0, 2.0
    estimate, interval = pooled(sums, np.arange(12))
    assert (estimate, *interval) == (0.5, 0.5, 0.5)
    assert np.isnan(pooled(sums[1:], np.arange(11))[1]).all()  # four blocks are too few


def test_nothing_has_no_quantile():
    estimates, intervals = quantiles(np.empty(0), np.empty(0, dtype=int), Q)
    assert np.isnan(estimates).all()
    assert np.isnan(intervals).all()
    assert np.isnan(pooled(np.zeros((3, 2)), np.arange(3))[0])


def correlated(rng, n_blocks=40, in_block=6):
    """Values that are alike within a block, as responses at neighbouring frequencies are."""
    level = np.repeat(rng.normal(size=n_blocks), in_block)
    return level + 0.3 * rng.normal(size=level.size), np.repeat(np.arange(n_blocks), in_block)


@pytest.mark.parametrize("estimate", ["median", "mean"])
def test_intervals_hold_the_truth_about_as_often_as_they_say(estimate):
    rng = np.random.default_rng(7)
    held = 0
    for _ in range(200):
        values, block = correlated(rng)
        if estimate == "median":
            low, high = quantiles(values, block, (0.5,))[1][0]
        else:
            low, high = pooled(np.stack([values, np.ones_like(values)], axis=1), block)[1]
        held += low <= 0.0 <= high
    # A bootstrap that took the values for independent would hold it in about 60 % of the cases.
    assert 0.88 <= held / 200 <= 0.99


def test_intervals_are_the_same_in_every_run():
    values, block = correlated(np.random.default_rng(3))
    first = quantiles(values, block, Q)[1]
    bootstrap.draws.cache_clear()
    assert quantiles(values, block, Q)[1].tolist() == first.tolist()
