"""One-to-one matching against all permutations."""

from itertools import permutations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_allclose

from gapsweep.analysis.agreement.matching import assignment, matches_on_line

LIMIT = 1.0
costs = hnp.arrays(
    float, st.tuples(st.integers(1, 4), st.integers(1, 4)), elements=st.floats(0.0, 3.0, width=16)
)


def merit(values):
    """Objective of the matching: number of matches first, then the total cost."""
    return -np.count_nonzero(values <= LIMIT), values.sum()


@given(costs)
def test_no_other_assignment_is_better(cost):
    n, m = cost.shape
    table = cost if n <= m else cost.T
    short, long = table.shape
    best = min(merit(table[range(short), list(p)]) for p in permutations(range(long), short))
    found = merit(cost[assignment(cost, LIMIT)])
    assert found[0] == best[0]
    assert_allclose(found[1], best[1])


@given(costs, st.integers(0, 1000))
def test_order_does_not_matter(cost, seed):
    rng = np.random.default_rng(seed)
    rows, columns = rng.permutation(cost.shape[0]), rng.permutation(cost.shape[1])
    shuffled = cost[np.ix_(rows, columns)]
    expected, found = (merit(c[assignment(c, LIMIT)]) for c in (cost, shuffled))
    assert_allclose(found, expected)


@given(costs)
def test_every_member_is_paired_at_most_once(cost):
    for indices in assignment(cost, LIMIT):
        assert len(set(indices.tolist())) == len(indices) == min(cost.shape)


def test_two_matches_are_better_than_one_cheap_one():
    cost = np.array([[0.0, 0.9], [0.9, 1.1]])  # the diagonal has the smaller sum
    assert cost[assignment(cost, LIMIT)].tolist() == [0.9, 0.9]


def test_an_impossible_distance_is_paired_last():
    cost = np.array([[np.inf, 0.5], [0.5, np.inf]])
    assert cost[assignment(cost, LIMIT)].tolist() == [0.5, 0.5]


def test_numbers_are_matched_within_the_limit_only():
    a, b = np.array([1.0, 5.0, 9.0]), np.array([9.3, 1.2, 3.0])
    rows, columns = matches_on_line(a, b, limit=0.5)
    assert list(zip(a[rows], b[columns], strict=True)) == [(1.0, 1.2), (9.0, 9.3)]


def test_nothing_matches_nothing():
    rows, columns = matches_on_line(np.empty(0), np.array([1.0]), limit=0.5)
    assert rows.size == columns.size == 0
