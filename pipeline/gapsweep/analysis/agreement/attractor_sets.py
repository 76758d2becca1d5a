"""Attractor sets and basins of a law compared with those of the exact law (A10 to A12).

Two attractors are close if the distance of their stroboscopic sections is within a tolerance:

* ``0.05 G`` for the Hausdorff distance, for two equilibria at least their uncertainty;
* for two chaotic ones, or two tori, a quarter of the larger extent (or ``0.05 G``) for the
  distance below which 80 % of the points of either have a neighbour in the other.
  ``attractors.nc`` also joins responses to one attractor if their points are mixed, which is not
  sufficient for a match here.

For symmetric gaps mirror images count as one attractor: every attractor has an image, even if no
initial condition led to it. The section of an image is known if the image was found; if neither
law has it, its extrema are those of the attractor with the opposite sign.
"""

from dataclasses import dataclass

import numpy as np

from gapsweep.analysis.agreement.distances import hausdorff_in_plane, hausdorff_on_line
from gapsweep.analysis.agreement.law_tables import AttractorTable, LawTable
from gapsweep.analysis.agreement.matching import assignment
from gapsweep.analysis.dimensions import Array, Bools, Ints
from gapsweep.response.attractors import NONE
from gapsweep.response.result import ResponseClass
from gapsweep.response.section import CLOUD_CLOSE, CLOUD_SHARE
from gapsweep.response.thresholds import DEVIATIONS

# Tolerance of distances, as a share of the gap width.
CLOSE = 0.05


@dataclass(frozen=True, slots=True)
class Matching:
    """The best one-to-one matching of two attractor sets at every frequency.

    Sets hold the attractors reached from initial conditions that both representations share. An
    attractor also represents its mirror image: `own_class` and `exact_class` hold, for every
    attractor, the smaller number of the two.
    """

    # `own_class`, `exact_class`: shape (n_omega, n_attractors).
    own_class: Ints
    exact_class: Ints
    # `n`, `n_exact`, `n_matched`: shape (n_omega,); attractors of both sets, and pairs within the
    # tolerance.
    n: Ints
    n_exact: Ints
    n_matched: Ints
    # Shape (n_pairs, 3); frequency, attractor and exact attractor of all pairs, matched or not.
    pairs: Ints
    distance: Array  # shape (n_pairs,); distance of the two sections [m]
    # Shape (n_omega, n_attractors); the exact attractor that matches, `NONE` if none does.
    partner: Ints


def matching(ours: LawTable, theirs: LawTable, width: float, *, symmetric: bool) -> Matching:
    """Match the attractors of a representation with the exact ones.

    `width`: width of the gap [m], the scale of distances.
    `symmetric`: whether the gap is symmetric.
    """
    common = ours.requested & theirs.requested
    classes = [mirror_classes(table.found) for table in (ours, theirs)]
    present = [_present(*of, common) for of in zip((ours, theirs), classes, strict=True)]
    cost, distance = _costs(ours, theirs, classes, present, width, symmetric=symmetric)
    partner = np.full(classes[0].shape, NONE)
    pairs = []
    for w in np.flatnonzero(present[0].any(axis=1) & present[1].any(axis=1)).tolist():
        own, exact = (some[w].nonzero()[0] for some in present)
        costs = cost[w, own[:, None], exact]
        rows, columns = assignment(costs, limit=1.0)
        pairs += [(w, a, b) for a, b in zip(own[rows], exact[columns], strict=True)]
        close = costs[rows, columns] <= 1.0
        partner[w, own[rows[close]]] = exact[columns[close]]
    indices = np.array(pairs, dtype=np.int64).reshape(-1, 3)
    return Matching(
        own_class=classes[0],
        exact_class=classes[1],
        n=present[0].sum(axis=1),
        n_exact=present[1].sum(axis=1),
        n_matched=(partner != NONE).sum(axis=1),
        pairs=indices,
        distance=distance[tuple(indices.T)],
        partner=partner,
    )


def mirror_classes(found: AttractorTable) -> Ints:
    """Smallest number of every attractor and its mirror images, shape (n_omega, n_attractors)."""
    classes = np.broadcast_to(np.arange(found.size), found.mirror_of.shape).copy()
    w, a = np.nonzero(found.mirror_of != NONE)
    np.minimum.at(classes, (w, found.mirror_of[w, a]), a)
    np.minimum.at(classes, (w, a), found.mirror_of[w, a])
    while np.any((smaller := np.take_along_axis(classes, classes, axis=1)) != classes):
        classes = smaller
    return classes


def _present(table: LawTable, classes: Ints, common: Bools) -> Bools:
    """Mask of the classes that a common initial condition leads to, per frequency."""
    present = np.zeros(classes.shape, dtype=bool)
    w, s = np.nonzero(common & (table.attractor != NONE))
    present[w, classes[w, table.attractor[w, s]]] = True
    return present


def _costs(
    ours: LawTable,
    theirs: LawTable,
    classes: list[Ints],
    present: list[Bools],
    width: float,
    *,
    symmetric: bool,
) -> tuple[Array, Array]:
    """Distances of classes as multiples of the tolerance and in metres: minima over members."""
    members = [
        np.take_along_axis(some, own, axis=1) & (np.arange(own.shape[1]) < table.found.n[:, None])
        for table, own, some in zip((ours, theirs), classes, present, strict=True)
    ]
    w, a, b = np.nonzero(members[0][:, :, None] & members[1][:, None, :])
    distance, tolerance = _section_distance(ours.found, theirs.found, (w, a, b), width)
    if symmetric:
        distance = np.fmin(distance, _image_distance(ours, theirs, (w, a, b)))
    shape = (*members[0].shape, members[1].shape[1])
    smallest = []
    for values in (distance / tolerance, distance):
        table = np.full(shape, np.inf)
        np.minimum.at(table, (w, classes[0][w, a], classes[1][w, b]), values)
        smallest.append(table)
    return smallest[0], smallest[1]


def _section_distance(
    ours: AttractorTable, theirs: AttractorTable, at: tuple[Ints, Ints, Ints], width: float
) -> tuple[Array, Array]:
    """Distances of the sections of pairs of attractors, and tolerances for a match [m]."""
    w, a, b = at
    p, q = ours.section[w, a], theirs.section[w, b]
    own, other = ours.response_class[w, a], theirs.response_class[w, b]
    # Samples of chaos, or of a torus, share no point.
    chaotic = (own == other) & np.isin(own, (ResponseClass.CHAOTIC, ResponseClass.QUASIPERIODIC))
    distance, tolerance = np.empty(len(w)), np.full(len(w), CLOSE * width)
    distance[~chaotic] = hausdorff_in_plane(p[~chaotic], q[~chaotic])
    rests = (own == other) & (own == ResponseClass.EQUILIBRIUM)
    known = DEVIATIONS * (ours.noise[w, a] + theirs.noise[w, b])
    tolerance[rests] = np.maximum(tolerance, known)[rests]
    p, q = p[chaotic], q[chaotic]
    distance[chaotic] = hausdorff_in_plane(p, q, CLOUD_SHARE)
    if len(p):
        extent = np.maximum(*(np.nanmax(c, axis=1) - np.nanmin(c, axis=1) for c in (p, q)))
        tolerance[chaotic] = np.maximum(CLOSE * width, CLOUD_CLOSE * extent.max(axis=1))
    return distance, tolerance


def _image_distance(ours: LawTable, theirs: LawTable, at: tuple[Ints, Ints, Ints]) -> Array:
    """Distance to the mirror image by extrema, where neither side found the image; else NaN."""
    w, a, b = at
    lone = np.flatnonzero(
        (ours.found.mirror_of[w, a] == NONE)
        & (theirs.found.mirror_of[w, b] == NONE)
        & (ours.found.response_class[w, a] == theirs.found.response_class[w, b])
        & (ours.found.period_multiple[w, a] == theirs.found.period_multiple[w, b])
    )
    extrema, exact = (
        table.extrema[w[lone], np.argmax(table.attractor[w[lone]] == of[lone, None], axis=1)]
        for table, of in ((ours, a), (theirs, b))
    )
    distance = np.full(len(w), np.nan)
    distance[lone] = hausdorff_on_line(extrema, -exact)
    return distance


def set_metrics(
    found: Matching, ours: LawTable, theirs: LawTable, half_gap: float
) -> dict[str, Array]:
    """Metrics of the attractor sets at every frequency (A4, A10)."""
    w, a, b = found.pairs.T
    amplitude, exact = ours.found.amplitude[w, a], theirs.found.amplitude[w, b]
    error = np.abs(amplitude - exact) / np.maximum(exact, half_gap)
    n, n_exact, n_matched = (x.astype(float) for x in (found.n, found.n_exact, found.n_matched))
    with np.errstate(invalid="ignore"):
        return {
            "amplitude_error_paired": _mean_at(w, error, len(ours.omega)),
            "attractor_distance": _mean_at(w, found.distance, len(ours.omega)),
            "n_attractors": n,
            "n_attractors_exact": n_exact,
            "n_attractors_matched": n_matched,
            "precision": n_matched / n,
            "recall": n_matched / n_exact,
            "f1": 2.0 * n_matched / (n + n_exact),
        }


def _mean_at(w: Ints, values: Array, size: int) -> Array:
    """Mean of the values at every frequency, NaN where there is none."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.bincount(w, values, size) / np.bincount(w, minlength=size))


def basin_metrics(found: Matching, ours: LawTable, theirs: LawTable) -> dict[str, Array]:
    """Agreement of attractors per initial condition (A12), and distance of basin shares (A11).

    Result: `same_attractor` over frequency and initial condition; `basin_distance` and
    `basin_distance_error` over frequency.
    """
    own, exact = _labels(found, ours, theirs)
    common = ours.requested & theirs.requested
    same = np.where(common & ((own != NONE) | (exact != NONE)), own == exact, np.nan)
    counted = common & ours.fixed
    n = counted.sum(axis=1).astype(float)
    n_labels = int(max(own.max(initial=NONE), exact.max(initial=NONE))) + 2
    shares = []
    for labels in (own, exact):
        counts = np.zeros((len(n), n_labels))
        w, s = np.nonzero(counted)
        # The last column is the share of initial conditions that lead to no attractor.
        np.add.at(counts, (w, labels[w, s]), 1.0)
        # One initial condition is not a sample of a basin.
        shares.append(counts / np.where(n > 1.0, n, np.nan)[:, None])
    variance = sum((phi * (1.0 - phi)).sum(axis=1) for phi in shares) / np.maximum(n, 1.0)
    return {
        "same_attractor": same,
        "basin_distance": 0.5 * np.abs(shares[0] - shares[1]).sum(axis=1),
        "basin_distance_error": 0.5 * np.sqrt(variance),
    }


def _labels(found: Matching, ours: LawTable, theirs: LawTable) -> tuple[Ints, Ints]:
    """Attractor reached from each initial condition by both laws, numbered as the exact law's.

    Attractors without a match have numbers after those of the exact law.
    """
    w = np.arange(len(ours.omega))[:, None]
    own = found.own_class[w, np.maximum(ours.attractor, 0)]
    partner = found.partner[w, own]
    unmatched = theirs.found.size + own
    own = np.where(ours.attractor == NONE, NONE, np.where(partner == NONE, unmatched, partner))
    exact = found.exact_class[w, np.maximum(theirs.attractor, 0)]
    return own, np.where(theirs.attractor == NONE, NONE, exact)
