"""The distance of two orbits, plainly."""

import numpy as np


def orbit_distance(a, b):
    """Largest distance of two periodic orbits' section points, modulo a shift in time [m].

    Infinite if they have different numbers of points.
    """
    if len(a) != len(b):
        return float("inf")
    gaps = (np.roll(a, s) - b for s in range(len(a)))
    return float(min(max(np.abs(gap.real).max(), np.abs(gap.imag).max()) for gap in gaps))
