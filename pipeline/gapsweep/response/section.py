"""The stroboscopic section: repeats, contraction, and distances of orbits.

A section point is ``(x, v / (2π ω))``: both components in metres.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def scaled(section: Array, omega: float) -> Array:
    """Section ``(x, v)`` with the velocity divided by the angular forcing frequency [m]."""
    return section / (1.0, 2.0 * np.pi * omega)


def period_multiple(section: Array, tolerance: float, largest: int) -> int:
    """Smallest n for which the section repeats after n forcing periods; 0 if none does.

    Parameters
    ----------
    section : ndarray, shape (n_periods, 2)
        Scaled section points [m], one row per forcing period.
    tolerance : float
        Largest distance [m] of two points taken for the same.
    largest : int
        Largest n tried; at least 2 n rows are needed to find n.
    """
    for n in range(1, min(largest, len(section) // 2) + 1):
        if np.all(np.abs(section[n:] - section[:-n]) < tolerance):
            return n
    return 0


def converging_multiple(section: Array, closeness: float, largest: int) -> int:
    """Smallest n towards whose repeat the section is contracting; 0 if it does not.

    Each of the last four points must be within `closeness` of the one n periods before, and the
    later two of them not farther than the earlier two.

    Parameters
    ----------
    section : ndarray, shape (n_periods, 2)
        Scaled section points [m].
    closeness : float
        Distance [m] from which shooting is worth a try.
    largest : int
        Largest n tried; n + 4 rows are needed for n.
    """
    for n in range(1, min(largest, len(section) - 4) + 1):
        steps = np.hypot(*(section[-4:] - section[-4 - n : -n]).T)
        if np.all(steps < closeness) and steps[2:].max() <= steps[:2].max():
            return n
    return 0


def prime_multiple(orbit: Array, tolerance: float) -> int:
    """Smallest divisor of its length after which a closed orbit repeats itself.

    Parameters
    ----------
    orbit : ndarray, shape (n, 2)
        Scaled section points of one whole period of n forcing periods [m].
    """
    n = len(orbit)
    for d in range(1, n):
        if n % d == 0 and np.all(np.abs(np.roll(orbit, -d, axis=0) - orbit) < tolerance):
            return d
    return n


def orbit_distance(a: Array, b: Array) -> float:
    """Largest distance of two periodic orbits' section points, modulo a shift in time [m].

    Infinite if they have different numbers of points.
    """
    if len(a) != len(b):
        return float("inf")
    shifts = (np.abs(np.roll(a, s, axis=0) - b).max() for s in range(len(a)))
    return float(min(shifts))


def cloud_distance(a: Array, b: Array, share: float = 0.8) -> float:
    """Partial Hausdorff distance of two point clouds [m].

    The distance below which `share` of either cloud's points have a neighbour in the other:
    the full Hausdorff distance of chaotic samples is ruled by one outlier.
    """
    distances = np.hypot(*(a[:, None, :] - b[None, :, :]).transpose(2, 0, 1))
    nearest = (np.quantile(distances.min(axis=axis), share) for axis in (0, 1))
    return float(max(nearest))
