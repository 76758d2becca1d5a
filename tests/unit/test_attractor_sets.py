"""Attractor sets and basins of two laws, made up so that the answer is known."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.builders.datasets import chaotic, datasets, failed, periodic, tables, unresolved

from gapsweep.analysis.agreement.attractor_sets import (
    CLOSE,
    basin_metrics,
    matching,
    mirror_classes,
    set_metrics,
)
from gapsweep.analysis.agreement.law_tables import AttractorTable, law_table

G = 0.8e-3
W = 7.0


@pytest.fixture
def compare(tmp_path):
    """All metrics of one frequency, from the responses of every start."""

    def metrics(ours, exact, gap=(0.0, G), sweeps=()):
        answers = {"piecewise": exact, "tanh-1e4": ours}
        study = tables(answers, [W], gap=gap, starts=len(exact) - len(sweeps), sweeps=sweeps)
        files = datasets(tmp_path, study, lambda label, _, i: answers[label][i])
        slabs = [law_table(*files, {"representation": r, "K_c": 0, "gap": 0}) for r in (1, 0)]
        found = matching(*slabs, G, symmetric=gap[0] == gap[1])
        found_metrics = set_metrics(found, *slabs, G / 2) | basin_metrics(found, *slabs)
        return {name: values.ravel().tolist() for name, values in found_metrics.items()}

    return metrics


def p1(x, extrema=None):
    return periodic([[x, 0.0]], W, extrema)


A, B, C = (p1(x) for x in (0.1e-3, 0.5e-3, 0.9e-3))
NEAR_B = p1(0.5e-3 + 0.9 * CLOSE * G)
FAR_B = p1(0.5e-3 + 1.1 * CLOSE * G)


def counts(result):
    return [result[f"n_attractors{s}"][0] for s in ("", "_exact", "_matched")]


def test_a_law_agrees_with_itself(compare):
    result = compare([A, B, A], [A, B, A])
    assert counts(result) == [2, 2, 2]
    assert result["precision"] == result["recall"] == result["f1"] == [1.0]
    assert result["amplitude_error_paired"] == result["attractor_distance"] == [0.0]
    assert result["same_attractor"] == [1.0, 1.0, 1.0]
    assert result["basin_distance"] == [0.0]


def test_precision_and_recall_tell_false_from_missed_attractors(compare):
    result = compare([A, C, B], [A, A, B])
    assert (result["precision"], result["recall"]) == ([2 / 3], [1.0])
    result = compare([A, A, A], [A, B, C])
    assert (result["precision"], result["recall"], result["f1"]) == ([1.0], [1 / 3], [0.5])


def test_threshold_is_a_share_of_the_gap(compare):
    assert counts(compare([NEAR_B], [B])) == [1, 1, 1]
    result = compare([FAR_B], [B])
    assert counts(result) == [1, 1, 0]
    # Paired all the same: the error is not cut off at the threshold.
    assert_allclose(result["attractor_distance"], [1.1 * CLOSE * G])
    assert_allclose(result["amplitude_error_paired"], [1.1 * CLOSE * G / 0.5e-3])


def test_one_attractor_cannot_match_two(compare):
    close = p1(0.5e-3 + 0.2 * CLOSE * G)
    result = compare([close, close], [B, p1(0.5e-3 + 0.4 * CLOSE * G)])
    assert counts(result) == [1, 2, 1]
    assert result["same_attractor"] == [1.0, 0.0] or result["same_attractor"] == [0.0, 1.0]


def test_attractors_have_no_order(compare):
    starts = [A, B, C, NEAR_B]
    results = [
        compare([starts[i] for i in order], starts) for order in ([0, 1, 2, 3], [3, 2, 1, 0])
    ]
    assert results[0]["f1"] == results[1]["f1"]
    assert results[0]["attractor_distance"] == results[1]["attractor_distance"]


def test_basin_distance_by_hand(compare):
    result = compare([A, A, A, B], [A, A, B, B])
    # 3/4, 1/4 against 1/2, 1/2.
    assert_allclose(result["basin_distance"], [0.25])
    variance = (2 * 3 / 16 + 2 / 4) / 4
    assert_allclose(result["basin_distance_error"], [0.5 * np.sqrt(variance)])
    assert result["same_attractor"] == [1.0, 1.0, 0.0, 1.0]


def test_unmatched_attractors_have_all_of_their_basin_to_themselves(compare):
    assert compare([C, C], [A, A])["basin_distance"] == [1.0]


def test_starts_without_an_attractor_count(compare):
    lost = failed()
    result = compare([A, lost, lost, unresolved([[1e-4, 0.0]], W)], [A, A, lost, lost])
    assert result["same_attractor"][:2] == [1.0, 0.0]
    assert np.isnan(result["same_attractor"][2:]).all()  # nothing to compare
    assert_allclose(result["basin_distance"], [0.25])  # none: 3/4 against 1/2
    assert counts(result) == [1, 1, 1]


def test_nothing_resolved_is_not_nothing_agreed(compare):
    result = compare([A], [failed()])
    assert counts(result) == [1, 0, 0]
    assert (result["precision"], result["f1"]) == ([0.0], [0.0])
    assert np.isnan([result["recall"][0], result["attractor_distance"][0]]).all()


def test_a_single_start_is_no_basin(compare):
    assert np.isnan(compare([A], [A])["basin_distance"]).all()


def test_sweeps_find_attractors_but_are_no_sample_of_basins(compare):
    result = compare([A, A, B], [A, A, C], sweeps=("sweep_up",))
    assert counts(result) == [2, 2, 1]
    assert result["same_attractor"] == [1.0, 1.0, 0.0]
    assert result["basin_distance"] == [0.0]


def test_sets_come_from_the_starts_that_both_were_asked_for(tmp_path):
    study = tables(["piecewise"], [W], gap=(0.0, G), starts=3)
    study["sweep"] += tables(["tanh-1e4"], [W], gap=(0.0, G), starts=1)["sweep"]
    files = datasets(tmp_path, study, lambda label, _, i: (A, B, C)[i])
    ours, exact = (law_table(*files, {"representation": r, "K_c": 0, "gap": 0}) for r in (1, 0))
    found = matching(ours, exact, G, symmetric=False)
    assert [found.n[0], found.n_exact[0], found.n_matched[0]] == [1, 1, 1]


# A periodic motion that is not its own image, and its image: extrema with the other sign.
LEFT = p1(0.3e-3, [0.2e-3, -0.5e-3])
RIGHT = p1(-0.1e-3, [0.5e-3, -0.2e-3])
SYMMETRIC = (0.4e-3, 0.4e-3)


@pytest.mark.parametrize(
    ("ours", "exact"),
    [
        ([LEFT, LEFT], [RIGHT, RIGHT]),  # neither found the image: told by the extrema
        ([LEFT, LEFT], [RIGHT, LEFT]),
        ([RIGHT, LEFT], [LEFT, LEFT]),
        ([RIGHT, LEFT], [LEFT, RIGHT]),
    ],
)
def test_mirror_images_are_one_where_the_gap_is_symmetric(compare, ours, exact):
    result = compare(ours, exact, gap=SYMMETRIC)
    assert counts(result) == [1, 1, 1]
    assert result["same_attractor"] == [1.0, 1.0]
    assert result["basin_distance"] == [0.0]
    assert compare(ours, exact)["same_attractor"] != [1.0, 1.0]


@pytest.mark.parametrize("mirror_of", [[1, 0], [1, 1], [0, 0], [1, -1], [-1, 0]])
def test_images_are_one_whichever_of_them_names_the_other(mirror_of):
    none = np.zeros((1, 2))
    found = AttractorTable(
        n=np.array([2]), response_class=none, period_multiple=none, amplitude=none,
        mirror_of=np.array([mirror_of]), section=none, noise=none,
    )  # fmt: skip
    assert mirror_classes(found).tolist() == [[0, 0]]


def test_an_image_has_the_same_period(compare):
    other = periodic([[-0.1e-3, 0.0], [-0.2e-3, 0.0]], W, [0.5e-3, -0.2e-3])
    assert counts(compare([LEFT], [other], gap=SYMMETRIC)) == [1, 1, 0]


def cloud(seed, width=1e-3, n=32):
    return np.random.default_rng(seed).uniform(-width / 2, width / 2, (n, 2))


def test_two_samples_of_one_chaotic_attractor_match(compare):
    assert counts(compare([chaotic(cloud(1), W)], [chaotic(cloud(2), W)])) == [1, 1, 1]
    moved = np.add(cloud(1), (1.5e-3, 0.0))
    assert counts(compare([chaotic(moved, W)], [chaotic(cloud(2), W)])) == [1, 1, 0]


def test_chaos_does_not_pass_for_a_periodic_motion(compare):
    assert counts(compare([chaotic(cloud(1), W)], [A])) == [1, 1, 0]
    # The classes differ, but the motions do not: a band thinner than the threshold.
    thin = np.add(cloud(1, 0.2 * CLOSE * G), (0.1e-3, 0.0))
    assert counts(compare([chaotic(thin, W)], [A])) == [1, 1, 1]
