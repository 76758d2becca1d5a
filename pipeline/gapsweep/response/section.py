"""The stroboscopic section: which period multiple a steady response has."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def period_multiple(section: Array, tolerance: float, largest: int) -> int:
    """Smallest n for which the section repeats after n forcing periods; 0 if none does.

    Parameters
    ----------
    section : ndarray, shape (n_periods, 2)
        Displacement [m] and velocity over angular forcing frequency [m], one row per
        forcing period.
    tolerance : float
        Largest distance [m] of two points taken for the same.
    largest : int
        Largest n tried; at least 2 n rows are needed to find n.
    """
    for n in range(1, min(largest, len(section) // 2) + 1):
        if np.all(np.abs(section[n:] - section[:-n]) < tolerance):
            return n
    return 0
