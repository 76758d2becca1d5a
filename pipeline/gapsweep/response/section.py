"""Poincaré sections: period multiples, contraction, and distances of orbits.

A section point is a state in metres: each component divided by its value for one metre
(`gapsweep.response.ensemble.Ensemble.unit`). Components are along the first axis. Points are the
same if no component differs.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.response.thresholds import ALIKE, AS_GOOD

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Mask = NDArray[np.bool_]
Numbers = NDArray[np.intp]

# Two samples of one attractor: this share of either has a neighbour in the other, closer than
# that share of their extent.
CLOUD_SHARE = 0.8
CLOUD_CLOSE = 0.25


def unit_of(omega: ArrayLike) -> Array:
    """Displacement and velocity of an oscillator that correspond to one metre of the section.

    `omega`: shape (n,); forcing frequency [Hz]. Result: shape (2, n).
    """
    omega_rad = 2.0 * np.pi * np.atleast_1d(np.asarray(omega, dtype=float))
    return np.stack((np.ones_like(omega_rad), omega_rad))


def scaled(states: ArrayLike, unit: Array) -> Array:
    """Return the section points of states.

    `states`: shape (n, n_states); displacements [m], velocities [m/s], first-order states.
    `unit`: shape (n_states, n) or (n_states, 1).
    Result: shape (n_states, n); in metres.
    """
    return np.asarray(np.asarray(states, dtype=float).T / unit)


def norm(parts: Array) -> Array:
    """Euclidean norms of vectors with components along the first axis."""
    # One after the other: numpy's sum of eight and more depends on the number of vectors.
    total, *squares = np.square(parts)
    for square in squares:
        total = total + square
    return np.asarray(np.sqrt(total))


def reach_of(q: Array, unit: Array) -> Array:
    """Largest moduli [m] over coordinates, in metres of the section, shape (n,).

    `q`: shape (n_coordinates, n).
    `unit`: shape (n_states, n).
    """
    return np.asarray((np.abs(q) / unit[: len(q)]).max(axis=0))


def period_multiple(section: Array, tolerance: float, largest: int) -> int:
    """Return the period multiple of one section, shape (n_states, n_periods); 0 if none."""
    length, first = np.array([section.shape[1]]), np.zeros(1, np.intp)
    found = period_multiples(section[:, None], length, first, np.array([tolerance]), largest)
    return int(found[0])


def period_multiples(
    sections: Array, lengths: Counts, points: Numbers, tolerance: Array, largest: int
) -> Counts:
    """Smallest n for which sections repeat every n forcing periods; 0 if none does.

    All points n, 2n, ... periods apart must be the same: a slowly drifting motion repeats well from
    one period to the next.

    Parameters
    ----------
    sections : ndarray, shape (n_states, n, longest)
        Section points [m], one per forcing period.
    lengths : ndarray of int, shape (n,)
        Number of section points in each row.
    points : ndarray of int, shape (m,)
        Numbers of the rows.
    tolerance : ndarray, shape (m,)
        Largest distance [m] of two points one forcing period apart, in any component, that count as
        the same. It grows with the root of n, as random errors do.
    largest : int
        Largest n tried; at least 2 n points are needed to find n.

    Returns
    -------
    ndarray of int, shape (m,)
    """
    found = np.zeros(len(points), np.int64)
    if sections.shape[2] < 2:
        return found
    latest = _latest(sections, lengths, points, largest)
    allowed = tolerance[:, None] * np.sqrt(np.arange(1, largest + 1))
    with np.errstate(invalid="ignore"):
        may = _are_near(latest[..., 1:], latest[..., :1], allowed)  # this decides most cases
    may &= 2 * np.arange(1, largest + 1) <= lengths[points, None]
    for k in np.flatnonzero(may.any(axis=1)).tolist():
        section = sections[:, points[k], : lengths[points[k]]]
        last = section.shape[1] - 1
        for n in (np.flatnonzero(may[k]) + 1).tolist():
            same_phase = section[:, last - np.arange(last, -1, -1) % n]
            if _are_near(section, same_phase, allowed[k, n - 1]).all():
                found[k] = n
                break
    return found


def likely_multiple(
    section: Array, closeness: float, largest: int, scatter: float = math.inf
) -> int:
    """Smallest n after which a noisy section repeats as well as after any; 0 if none is close.

    `section`: shape (n_states, n_periods); section points [m].
    `closeness`: largest distance [m] of a point from the one n periods before.
    `largest`: largest n tried; at least 2 n points are needed to find n.
    `scatter`: largest root of these distances' mean square [m].
    """
    n_points = section.shape[1]
    distances = [
        norm(section[:, n:] - section[:, :-n]) for n in range(1, min(largest, n_points // 2) + 1)
    ]
    spreads = [float(np.sqrt(np.mean(each**2))) for each in distances]
    for n, (distance, spread) in enumerate(zip(distances, spreads, strict=True), start=1):
        # A disturbance that rotates as it decays repeats better after some periods than others, ...
        if distance.max() < closeness and spread <= min(AS_GOOD * min(spreads), scatter):
            # ... although the points scatter about fewer positions.
            phases = section[:, n_points % n :].reshape(len(section), -1, n)
            places = phases.mean(axis=1)
            scatter = float(np.sqrt(np.mean(norm(phases - places[:, None]) ** 2)))
            return prime_multiple(places, AS_GOOD * scatter / math.sqrt(phases.shape[1]))
    return 0


def _latest(sections: Array, lengths: Counts, points: Numbers, n: int) -> Array:
    """The last n + 1 points of some rows, the last one first; NaN where there are fewer."""
    column = lengths[points, None] - 1 - np.arange(n + 1)
    inside = column >= 0
    found = sections[:, points[:, None], np.where(inside, column, 0)]
    return found if inside.all() else np.where(inside, found, np.nan)


def repeat_nearly(sections: Array, lengths: Counts, error: Array, largest: int) -> Mask:
    """Whether sections repeat so well that they cannot be distinguished from periodic ones.

    Each component relative to its largest modulus: a large one must not hide chaos of another.

    `sections`: shape (n_states, m, longest); section points [m].
    `lengths`: shape (m,); number of section points in each row.
    `error`: shape (m,); error of the points of each row, from the solver's tolerances [m].
    `largest`: largest multiple of a forcing period tried.
    """
    every = np.arange(len(lengths))
    inside = np.arange(sections.shape[2]) < lengths[:, None]
    extent = np.where(inside, np.abs(sections), 0.0).max(axis=2, initial=0.0)
    moves = extent > error / ALIKE
    # A component that does not move repeats in any case.
    shares = sections * np.where(moves, 1.0 / np.where(moves, extent, 1.0), 0.0)[..., None]
    found = period_multiples(sections, lengths, every, error, largest) > 0
    alike = np.full(len(lengths), ALIKE)
    also = period_multiples(shares, lengths, every, alike, largest) > 0
    return np.asarray(found | (also & moves.any(axis=0)))


def drifts(sections: Array, lengths: Counts) -> Mask:
    """Whether motions move one way along a coordinate, in every period of their windows.

    Such a motion is a transient or unbounded; rounding errors that grow with its distance amplify
    disturbances as chaos does.

    `sections`: shape (n_coordinates, m, longest); displacements of section points [m].
    `lengths`: shape (m,); number of section points in each row.
    """
    moves = np.diff(sections, axis=2)
    outside = np.arange(moves.shape[2]) >= lengths[:, None] - 1
    one_way = [(outside | (way * moves > 0.0)).all(axis=2) for way in (1.0, -1.0)]
    return np.asarray((one_way[0] | one_way[1]).any(axis=0) & (lengths > 2))


def repeats(shares: Array, modulus: Array) -> Counts:
    """Number of periods of an orbit until disturbances have shrunk to given shares < 1.

    `shares` and `modulus`: shape (m,); the shares, and the largest multiplier's modulus, < 1 [-].
    """
    # numpy's logarithm differs between processors.
    pairs = zip(shares.tolist(), modulus.tolist(), strict=True)
    found = [max(1, math.ceil(math.log(share) / math.log(each))) for share, each in pairs]
    return np.array(found, np.int64)


def prime_multiple(orbit: Array, tolerance: float) -> int:
    """Smallest divisor of the length of a closed orbit after which the orbit repeats itself.

    `orbit`: shape (n_states, n); section points of one whole period of n forcing periods [m].
    `tolerance`: largest distance [m] of two points, in any component, taken for the same.
    """
    n = orbit.shape[1]
    divisors = [d for d in range(1, n) if n % d == 0]
    return next((d for d in divisors if _are_near(orbit, np.roll(orbit, d, 1), tolerance).all()), n)


def _are_near(p: Array, q: Array, tolerance: Any) -> NDArray[np.bool_]:
    """Whether section points are the same in every component."""
    # Component by component: several times as fast as a reduction along the first axis.
    near = np.abs(p[0] - q[0]) < tolerance
    for a, b in zip(p[1:], q[1:], strict=True):
        near &= np.abs(a - b) < tolerance
    return np.asarray(near)


def cloud_distances(a: Array, b: Array) -> Array:
    """Partial Hausdorff distances of pairs of point clouds [m].

    The distance below which `CLOUD_SHARE` of either cloud's points have a neighbour in the
    other: the full Hausdorff distance of chaotic samples is ruled by one outlier.

    `a` and `b`: shape (n_states, m, n_a), (n_states, m, n_b). Result: shape (m,).
    """
    distances = _apart(a, b)
    nearest = [np.quantile(distances.min(axis=axis), CLOUD_SHARE, axis=1) for axis in (1, 2)]
    return np.asarray(np.maximum(*nearest))


def own_neighbours(a: Array, b: Array) -> Array:
    """Share of the points of two clouds whose nearest other point is of the same cloud [-].

    Half of them if both are samples of one distribution, all if they lie apart, whatever their
    shape and the number of states (Schilling 1986).

    `a` and `b`: shape (n_states, m, n_a), (n_states, m, n_b). Result: shape (m,).
    """
    apart = _apart(a, b)
    own = [_nearest_own(cloud) < apart.min(axis=axis) for cloud, axis in ((a, 2), (b, 1))]
    return np.asarray(np.concatenate(own, axis=1).mean(axis=1))


def _apart(a: Array, b: Array) -> Array:
    """Distances of every point of a cloud from every one of another, shape (m, n_a, n_b)."""
    return norm(a[..., :, None] - b[..., None, :])


def _nearest_own(a: Array) -> Array:
    """Distances of a cloud's points from the nearest other one of it, shape (m, n)."""
    distances = _apart(a, a)
    distances[:, np.eye(a.shape[2], dtype=bool)] = np.inf
    return np.asarray(distances.min(axis=2))
