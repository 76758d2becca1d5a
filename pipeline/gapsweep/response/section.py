"""The stroboscopic section: repeats, contraction, and distances of orbits.

A section point is the complex number ``x + i v / (2π ω)`` [m]: the modulus of a difference is the
distance of two states.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Section = NDArray[np.complex128]

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


def likely_multiple(section: Sequence[complex], closeness: float, largest: int) -> int:
    """Smallest n after which a rattled section repeats as well as after any; 0 if none is close.

    Parameters
    ----------
    section : sequence of complex, length n_periods
        Section points [m].
    closeness : float
        Largest distance [m] of a point from the one n periods before.
    largest : int
        Largest n tried; at least 2 n points are needed to find n.
    """
    points = np.array(section)
    distances = [
        np.abs(points[n:] - points[:-n]) for n in range(1, min(largest, len(points) // 2) + 1)
    ]
    spreads = [float(np.sqrt(np.mean(each**2))) for each in distances]
    for n, (distance, spread) in enumerate(zip(distances, spreads, strict=True), start=1):
        # A disturbance that turns as it decays repeats better after some periods than others, ...
        if distance.max() < closeness and spread <= _AS_WELL * min(spreads):
            # ... though the points scatter about fewer places.
            phases = points[len(points) % n :].reshape(-1, n)
            places = phases.mean(axis=0)
            scatter = float(np.sqrt(np.mean(np.abs(phases - places) ** 2)))
            return prime_multiple(places.tolist(), _AS_WELL * scatter / math.sqrt(len(phases)))
    return 0


def converging_multiple(section: Sequence[complex], closeness: float, largest: int) -> int:
    """Smallest n towards whose repeat the section is contracting; 0 if it does not.

    Each of the last four points must be within `closeness` of the one n periods before, and the
    later two of them not farther than the earlier two.

    Parameters
    ----------
    section : sequence of complex, length n_periods
        Section points [m].
    closeness : float
        Distance [m] from which shooting is worth a try.
    largest : int
        Largest n tried; n + 4 points are needed for n.
    """
    for n in range(1, min(largest, len(section) - 4) + 1):
        # Mostly the last point alone decides.
        if abs(section[-1] - section[-1 - n]) < closeness:
            steps = [abs(section[k] - section[k - n]) for k in (-4, -3, -2, -1)]
            if max(steps) < closeness and max(steps[2:]) <= max(steps[:2]):
                return n
    return 0


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


def _is_near(p: complex, q: complex, tolerance: float) -> bool:
    return abs(p.real - q.real) < tolerance and abs(p.imag - q.imag) < tolerance


def orbit_distance(a: Section, b: Section) -> float:
    """Largest distance of two periodic orbits' section points, modulo a shift in time [m].

    Infinite if they have different numbers of points.
    """
    if len(a) != len(b):
        return float("inf")
    gaps = (np.roll(a, s) - b for s in range(len(a)))
    return float(min(max(np.abs(gap.real).max(), np.abs(gap.imag).max()) for gap in gaps))


def cloud_distance(a: Section, b: Section, share: float = 0.8) -> float:
    """Partial Hausdorff distance of two point clouds [m].

    The distance below which `share` of either cloud's points have a neighbour in the other:
    the full Hausdorff distance of chaotic samples is ruled by one outlier.
    """
    distances = np.abs(a[:, None] - b[None, :])
    nearest = (np.quantile(distances.min(axis=axis), share) for axis in (0, 1))
    return float(max(nearest))
