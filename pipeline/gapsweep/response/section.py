"""The stroboscopic section: repeats, contraction, and distances of orbits.

A section point is the complex number ``x + i v / (2π ω)`` [m]: the modulus of a difference is the
distance of two states.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Numbers = NDArray[np.intp]
Section = NDArray[np.complex128]

DEVIATIONS = 4.0  # of the predicted scatter, within which two points are the same
_AS_WELL = 5.0  # as the best, or as means do that differ by chance


def scaled(states: ArrayLike, omega: ArrayLike) -> Section:
    """Section points of states.

    Parameters
    ----------
    states : array_like, shape (n, 2)
        Displacements [m] and velocities [m/s].
    omega : float or array_like, shape (n,)
        Forcing frequency [Hz].
    """
    states = np.asarray(states, dtype=float)
    section = np.empty(len(states), complex)
    section.real, section.imag = states[:, 0], states[:, 1] / (2.0 * np.pi * np.asarray(omega))
    return section


def period_multiple(section: Sequence[complex], tolerance: float, largest: int) -> int:
    """Smallest n for which the section repeats every n forcing periods; 0 if none does.

    All points n, 2n, ... periods apart must be the same: a motion that still creeps along repeats
    well from one period to the next.

    Parameters
    ----------
    section : sequence of complex, length n_periods
        Section points [m], one per forcing period.
    tolerance : float
        Largest distance [m] of two points one forcing period apart, in either component, taken for
        the same. It grows with the root of n, as random errors do.
    largest : int
        Largest n tried; at least 2 n points are needed to find n.
    """
    last = len(section) - 1
    for n in range(1, min(largest, len(section) // 2) + 1):
        allowed = tolerance * math.sqrt(n)
        # Mostly the last point alone decides.
        if _is_near(section[last], section[last - n], allowed) and all(
            _is_near(section[k], section[last - (last - k) % n], allowed) for k in range(last)
        ):
            return n
    return 0


def likely_multiple(
    section: Sequence[complex], closeness: float, largest: int, scatter: float = math.inf
) -> int:
    """Smallest n after which a rattled section repeats as well as after any; 0 if none is close.

    Parameters
    ----------
    section : sequence of complex, length n_periods
        Section points [m].
    closeness : float
        Largest distance [m] of a point from the one n periods before.
    largest : int
        Largest n tried; at least 2 n points are needed to find n.
    scatter : float
        Largest root of these distances' mean square [m].
    """
    points = np.array(section)
    distances = [
        np.abs(points[n:] - points[:-n]) for n in range(1, min(largest, len(points) // 2) + 1)
    ]
    spreads = [float(np.sqrt(np.mean(each**2))) for each in distances]
    for n, (distance, spread) in enumerate(zip(distances, spreads, strict=True), start=1):
        # A disturbance that turns as it decays repeats better after some periods than others, ...
        if distance.max() < closeness and spread <= min(_AS_WELL * min(spreads), scatter):
            # ... though the points scatter about fewer places.
            phases = points[len(points) % n :].reshape(-1, n)
            places = phases.mean(axis=0)
            scatter = float(np.sqrt(np.mean(np.abs(phases - places) ** 2)))
            return prime_multiple(places.tolist(), _AS_WELL * scatter / math.sqrt(len(phases)))
    return 0


def period_multiples(
    sections: Section, lengths: Counts, points: Numbers, tolerance: Array, largest: int
) -> Counts:
    """`period_multiple` of some rows of `sections`, with only so many points in each.

    Parameters
    ----------
    sections : ndarray, shape (n, longest)
    lengths : ndarray of int, shape (n,)
    points : ndarray of int, shape (m,)
        Numbers of the rows.
    tolerance : ndarray, shape (m,)
    largest : int

    Returns
    -------
    ndarray of int, shape (m,)
    """
    latest = _latest(sections[points], lengths[points], largest)
    allowed = tolerance[:, None] * np.sqrt(np.arange(1, largest + 1))
    with np.errstate(invalid="ignore"):
        may = _is_near(latest[:, 1:], latest[:, :1], allowed)  # mostly this alone decides
    found = np.zeros(len(points), np.int64)
    for k in np.flatnonzero(may.any(axis=1)).tolist():
        section = sections[points[k], : lengths[points[k]]].tolist()
        found[k] = period_multiple(section, float(tolerance[k]), largest)
    return found


def converging_multiples(
    sections: Section, lengths: Counts, closeness: Array, largest: int
) -> Counts:
    """Smallest n towards whose repeat each section is contracting; 0 if it does not.

    Each of the last four points must be within `closeness` of the one n periods before, and the
    later two of them not farther than the earlier two.

    Parameters
    ----------
    sections : ndarray, shape (m, longest)
        Section points [m].
    lengths : ndarray of int, shape (m,)
        How many there are in each row.
    closeness : ndarray, shape (m,)
        Distance [m] from which shooting is worth a try.
    largest : int
        Largest n tried; n + 4 points are needed for n.

    Returns
    -------
    ndarray of int, shape (m,)
    """
    # Early windows are short: no more columns than the longest of them has points.
    longest = int(lengths.max(initial=0))
    latest = _latest(sections, lengths, max(3, min(largest + 3, longest - 1)))
    # From the last one backwards; where there are too few points, NaN.
    earlier = sliding_window_view(latest, 4, axis=1)[:, 1:]
    with np.errstate(invalid="ignore"):
        may = _is_near(latest[:, :1], earlier[:, :, 0], closeness[:, None])
    # Mostly the last point alone decides. In the order of the sections, then of n.
    section, before = np.nonzero(may)
    apart = latest[section, :4] - earlier[section, before]
    steps = np.hypot(apart.real, apart.imag)
    contracts = steps[:, :2].max(axis=1) <= steps[:, 2:].max(axis=1)
    converging = (steps.max(axis=1) < closeness[section]) & contracts
    found = np.zeros(len(sections), np.int64)
    hits, first = np.unique(section[converging], return_index=True)
    found[hits] = before[converging][first] + 1
    return found


def _latest(sections: Section, lengths: Counts, n: int) -> Section:
    """The last n + 1 points of each row, the last one first; NaN where there are fewer."""
    column = lengths[:, None] - 1 - np.arange(n + 1)
    inside = column >= 0
    rows = np.arange(len(sections))[:, None]
    return np.where(inside, sections[rows, np.where(inside, column, 0)], complex(np.nan, np.nan))


def prime_multiple(orbit: Sequence[complex], tolerance: float) -> int:
    """Smallest divisor of its length after which a closed orbit repeats itself.

    Parameters
    ----------
    orbit : sequence of complex, length n
        Section points of one whole period of n forcing periods [m].
    tolerance : float
        Largest distance [m] of two points, in either component, taken for the same.
    """
    n = len(orbit)
    for d in range(1, n):
        if n % d == 0 and all(_is_near(orbit[k], orbit[k - d], tolerance) for k in range(n)):
            return d
    return n


def _is_near(p: Any, q: Any, tolerance: Any) -> Any:
    """Whether section points are the same in either component; numbers or arrays."""
    apart = p - q
    return (abs(apart.real) < tolerance) & (abs(apart.imag) < tolerance)


def cloud_distances(a: Section, b: Section, share: float = 0.8) -> Array:
    """Partial Hausdorff distances of pairs of point clouds [m].

    The distance below which `share` of either cloud's points have a neighbour in the other:
    the full Hausdorff distance of chaotic samples is ruled by one outlier.

    Parameters
    ----------
    a, b : ndarray of complex, shape (m, n_a), (m, n_b)

    Returns
    -------
    ndarray, shape (m,)
    """
    distances = np.abs(a[:, :, None] - b[:, None, :])
    nearest = [np.quantile(distances.min(axis=axis), share, axis=1) for axis in (1, 2)]
    return np.asarray(np.maximum(*nearest))
