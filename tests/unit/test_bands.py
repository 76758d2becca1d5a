"""Pixels of the bifurcation diagram, against sets of integers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from gapsweep.analysis.bands import FINENESS, band_metrics
from gapsweep.analysis.slab import Found, Slab

G = 0.8e-3
PIXEL = G / FINENESS


def slab(heights, omega=(7.0,)):
    """A slab whose extrema are in the middle of these pixels; other fields are of no concern."""
    extrema = np.array(heights, dtype=float) * PIXEL
    shape = extrema.shape[:2]
    none, zeros = np.zeros(shape), np.zeros(shape, dtype=int)
    return Slab(
        omega=np.array(omega), fixed=np.ones(shape[1], bool), requested=np.ones(shape, bool),
        class_number=zeros, attractor=zeros, host=zeros, amplitude=none, lyapunov=none,
        lyapunov_error=none, extrema=extrema, noise=none, costs={},
        found=Found(n=zeros, response_class=zeros, period_multiple=zeros, mirror_of=zeros,
                    amplitude=none, noise=none, section=np.zeros((*shape, 1, 2))),
    )  # fmt: skip


def jaccard(a, b, *, symmetric=False):
    found = band_metrics(slab([[a]]), slab([[b]]), G, symmetric=symmetric)
    return [float(found[f"band_jaccard{suffix}"][0]) for suffix in ("", "_tolerant")]


heights = st.lists(st.integers(-300, 300), min_size=1, max_size=12)


@given(heights, heights, st.booleans())
def test_index_is_that_of_the_sets_of_pixels(a, b, symmetric):
    p, q = set(a), set(b)
    if symmetric:
        p, q = p | {-x for x in p}, q | {-x for x in q}
    found = jaccard(a, b, symmetric=symmetric)
    assert_allclose(found[0], len(p & q) / len(p | q))
    near = [sum(any(abs(x - y) <= 1 for y in v) for x in u) for u, v in ((p, q), (q, p))]
    hits = sum(near) / 2
    assert_allclose(found[1], hits / (len(p) + len(q) - hits))
    assert found[1] >= found[0]


def test_a_shift_by_one_pixel_is_tolerated():
    assert jaccard([3, 8], [4, 9]) == [0.0, 1.0]
    assert jaccard([3, 8], [5, 10]) == [0.0, 0.0]


@given(heights)
def test_images_are_the_same_band_where_the_gap_is_symmetric(a):
    assert jaccard(a, [-x for x in a], symmetric=True) == [1.0, 1.0]


def test_frequencies_and_starts():
    nan = np.nan
    ours = slab([[[1, nan], [2, 5]], [[7, nan], [7, nan]]], (7.0, 8.0))
    exact = slab([[[5, nan], [1, 2]], [[9, nan], [8, 7]]], (7.0, 8.0))
    found = band_metrics(ours, exact, G, symmetric=False)
    assert found["band_jaccard"].tolist() == [1.0, 1 / 3]


@pytest.mark.parametrize("far", [150 * FINENESS, 1e9])
def test_what_is_far_out_is_one_pixel(far):
    assert jaccard([far], [200 * FINENESS]) == [1.0, 1.0]
    assert jaccard([far], [-far]) == [0.0, 0.0]


def test_no_response_no_index():
    empty = slab([[[np.nan]]])
    assert np.isnan(band_metrics(empty, empty, G, symmetric=False)["band_jaccard"]).all()
