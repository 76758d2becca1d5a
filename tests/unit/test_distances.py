"""Batched distances against scipy and brute force, and the axioms of a metric."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_allclose
from scipy.spatial.distance import directed_hausdorff

from gapsweep.analysis.agreement.distances import hausdorff_in_plane, hausdorff_on_line

finite = st.floats(-1e3, 1e3).map(lambda x: round(x, 6))
samples = st.lists(finite, min_size=1, max_size=9).map(np.array)
clouds = hnp.arrays(float, st.tuples(st.integers(1, 9), st.just(2)), elements=finite)


def one(distance, a, b, *more):
    return float(distance(a[None], b[None], *more)[0])


@given(samples, samples)
def test_hausdorff_on_the_line_is_the_largest_nearest_distance(a, b):
    table = np.abs(a[:, None] - b[None, :])
    expected = max(table.min(axis=0).max(), table.min(axis=1).max())
    assert one(hausdorff_on_line, a, b) == expected


@given(clouds, clouds)
def test_hausdorff_in_the_plane_is_scipys(a, b):
    expected = max(directed_hausdorff(a, b)[0], directed_hausdorff(b, a)[0])
    assert_allclose(one(hausdorff_in_plane, a, b), expected, rtol=1e-12)


@given(clouds, clouds, st.floats(0.0, 1.0))
def test_partial_hausdorff_is_a_quantile_of_the_nearest_distances(a, b, share):
    table = np.hypot(*(a[:, None] - b[None, :]).transpose(2, 0, 1))
    expected = max(np.quantile(table.min(axis=axis), share) for axis in (0, 1))
    assert_allclose(one(hausdorff_in_plane, a, b, share), expected, rtol=1e-9, atol=1e-12)


@given(samples, samples, samples)
def test_hausdorff_on_the_line_is_a_metric(a, b, c):
    assert one(hausdorff_on_line, a, np.flip(a)) == 0.0
    assert one(hausdorff_on_line, a, b) == one(hausdorff_on_line, b, a)
    longest = one(hausdorff_on_line, a, b) + one(hausdorff_on_line, b, c)
    assert one(hausdorff_on_line, a, c) <= longest * (1.0 + 1e-12) + 1e-9


@given(clouds, clouds, clouds)
def test_hausdorff_in_the_plane_is_a_metric(a, b, c):
    assert one(hausdorff_in_plane, a, np.flip(a, axis=0)) == 0.0
    assert one(hausdorff_in_plane, a, b) == one(hausdorff_in_plane, b, a)
    longest = one(hausdorff_in_plane, a, b) + one(hausdorff_in_plane, b, c)
    assert one(hausdorff_in_plane, a, c) <= longest * (1.0 + 1e-12) + 1e-9


@given(samples, samples, st.integers(0, 100))
def test_order_sign_and_repeats_do_not_matter(a, b, seed):
    expected = one(hausdorff_on_line, a, b)
    shuffled = np.random.default_rng(seed).permutation(a)
    assert one(hausdorff_on_line, shuffled, b) == expected
    assert_allclose(one(hausdorff_on_line, -a, -b), expected, rtol=1e-9, atol=1e-9)
    assert_allclose(one(hausdorff_on_line, np.tile(a, 3), b), expected, rtol=1e-9, atol=1e-9)


def test_distance_to_an_empty_set_is_unknown():
    none, some = np.full((1, 3), np.nan), np.ones((1, 2))
    assert np.isnan(hausdorff_on_line(none, some)).all()
    assert np.isnan(hausdorff_in_plane(np.full((1, 3, 2), np.nan), np.ones((1, 2, 2)))[0])


def padded(sets, shape):
    table = np.full((len(sets), *shape), np.nan)
    for row, members in zip(table, sets, strict=True):
        row[: len(members)] = members
    return table


@given(st.lists(st.tuples(samples, samples), min_size=1, max_size=6))
def test_rows_do_not_see_each_other_on_the_line(pairs):
    a, b = (padded(sets, (9,)) for sets in zip(*pairs, strict=True))
    isolated = [one(hausdorff_on_line, *pair) for pair in pairs]
    assert_allclose(hausdorff_on_line(a, b), isolated, rtol=1e-12)


@given(st.lists(st.tuples(clouds, clouds), min_size=1, max_size=6))
def test_rows_do_not_see_each_other_in_the_plane(pairs):
    a, b = (padded(sets, (9, 2)) for sets in zip(*pairs, strict=True))
    for share in (1.0, 0.95):
        alone = [one(hausdorff_in_plane, *pair, share) for pair in pairs]
        assert_allclose(hausdorff_in_plane(a, b, share), alone, rtol=1e-12)


def test_many_rows_are_worked_off_in_batches():
    a, b = np.random.default_rng(1).normal(size=(2, 9000, 7, 2))  # a batch holds 2**19 / 8**2 rows
    parts = [hausdorff_in_plane(*some) for some in zip(np.split(a, 3), np.split(b, 3), strict=True)]
    assert hausdorff_in_plane(a, b).tolist() == np.concatenate(parts).tolist()
