"""Section points of oscillators as complex numbers: another notation than the package's."""

import numpy as np


def complex_points(states, omega):
    """Section points ``x + i v / (2 π ω)`` [m] of states, shape (n, 2)."""
    states = np.reshape(states, (-1, 2))
    return states[:, 0] + 1j * states[:, 1] / (2.0 * np.pi * omega)


def parts(points):
    """Complex section points as the package has them: components along the first axis."""
    points = np.asarray(points, complex)
    return np.stack([points.real, points.imag])
