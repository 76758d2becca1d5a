"""Batched distances against scipy and brute force, and the axioms of a metric."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_allclose
from scipy.spatial.distance import directed_hausdorff
from scipy.stats import wasserstein_distance

from gapsweep.analysis.distances import hausdorff_in_plane, hausdorff_on_line, wasserstein

finite = st.floats(-1e3, 1e3).map(lambda x: round(x, 6))
samples = st.lists(finite, min_size=1, max_size=9).map(np.array)
clouds = hnp.arrays(float, st.tuples(st.integers(1, 9), st.just(2)), elements=finite)


def one(distance, a, b, *more):
    return float(distance(a[None], b[None], *more)[0])


@given(samples, samples)
def test_wasserstein_is_scipys(a, b):
    assert_allclose(one(wasserstein, a, b), wasserstein_distance(a, b), rtol=1e-9, atol=1e-9)


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


ON_LINE = [wasserstein, hausdorff_on_line]


@pytest.mark.parametrize("distance", ON_LINE)
@given(a=samples, b=samples, c=samples)
def test_distances_on_the_line_are_metrics(distance, a, b, c):
    assert one(distance, a, np.flip(a)) == 0.0
    assert one(distance, a, b) == one(distance, b, a)
    longest = one(distance, a, b) + one(distance, b, c)
    assert one(distance, a, c) <= longest * (1.0 + 1e-12) + 1e-9


@given(clouds, clouds, clouds)
def test_hausdorff_in_the_plane_is_a_metric(a, b, c):
    assert one(hausdorff_in_plane, a, np.flip(a, axis=0)) == 0.0
    assert one(hausdorff_in_plane, a, b) == one(hausdorff_in_plane, b, a)
    longest = one(hausdorff_in_plane, a, b) + one(hausdorff_in_plane, b, c)
    assert one(hausdorff_in_plane, a, c) <= longest * (1.0 + 1e-12) + 1e-9


@pytest.mark.parametrize("distance", ON_LINE)
@given(a=samples, b=samples, seed=st.integers(0, 100))
def test_order_sign_and_repeats_do_not_matter(distance, a, b, seed):
    expected = one(distance, a, b)
    shuffled = np.random.default_rng(seed).permutation(a)
    assert one(distance, shuffled, b) == expected
    assert_allclose(one(distance, -a, -b), expected, rtol=1e-9, atol=1e-9)
    assert_allclose(one(distance, np.tile(a, 3), b), expected, rtol=1e-9, atol=1e-9)


def test_distance_to_an_empty_set_is_unknown():
    none, some = np.full((1, 3), np.nan), np.ones((1, 2))
    assert np.isnan([d(none, some)[0] for d in ON_LINE]).all()
    assert np.isnan(hausdorff_in_plane(np.full((1, 3, 2), np.nan), np.ones((1, 2, 2)))[0])


def padded(sets, shape):
    table = np.full((len(sets), *shape), np.nan)
    for row, members in zip(table, sets, strict=True):
        row[: len(members)] = members
    return table


@given(st.lists(st.tuples(samples, samples), min_size=1, max_size=6))
def test_rows_do_not_see_each_other_on_the_line(pairs):
    a, b = (padded(sets, (9,)) for sets in zip(*pairs, strict=True))
    for distance in ON_LINE:
        assert_allclose(distance(a, b), [one(distance, *pair) for pair in pairs], rtol=1e-12)


@given(st.lists(st.tuples(clouds, clouds), min_size=1, max_size=6))
def test_rows_do_not_see_each_other_in_the_plane(pairs):
    a, b = (padded(sets, (9, 2)) for sets in zip(*pairs, strict=True))
    for share in (1.0, 0.95):
        alone = [one(hausdorff_in_plane, *pair, share) for pair in pairs]
        assert_allclose(hausdorff_in_plane(a, b, share), alone, rtol=1e-12)


def test_many_rows_are_worked_off_in_batches(monkeypatch):
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 50, 7, 2))
    whole = hausdorff_in_plane(a, b)
    monkeypatch.setattr("gapsweep.analysis.distances._BATCH", 100)
    assert hausdorff_in_plane(a, b).tolist() == whole.tolist()
