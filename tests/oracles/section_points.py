"""Section points as complex numbers, another notation than the package's, and their distance."""

import numpy as np


def complex_points(states, omega):
    """Section points ``x + i v / (2 π ω)`` [m] of states, shape (n, 2)."""
    states = np.reshape(states, (-1, 2))
    return states[:, 0] + 1j * states[:, 1] / (2.0 * np.pi * omega)


def parts(points):
    """Complex section points as the package has them: components along the first axis."""
    points = np.asarray(points, complex)
    return np.stack([points.real, points.imag])


def orbit_distance(a, b):
    """Largest distance of two periodic orbits' section points, modulo a shift in time [m].

    Infinite if they have different numbers of points.
    """
    if len(a) != len(b):
        return float("inf")
    gaps = (np.roll(a, s) - b for s in range(len(a)))
    return float(min(max(np.abs(gap.real).max(), np.abs(gap.imag).max()) for gap in gaps))
