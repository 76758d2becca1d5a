"""x(t) and v(t) between steps, from the recorded series."""

import numpy as np

from gapsweep.integrate.jit import entry

from .record import DENSE_HEAD
from .roots import polynomial


@entry
def sample_steps(steps, first, last, times):
    """Evaluate recorded steps.

    Parameters
    ----------
    steps : array, shape (n_steps, DENSE_HEAD + degree + 1)
        Rows (point, start, length, coefficients), sorted by point and time.
    first, last : int array, shape (n_points,)
        Rows of each point.
    times : array, shape (n_points, n_t)
        Times [s], in any order.

    Returns
    -------
    x, v : ndarray, shape (n_points, n_t)
        Displacement [m] and velocity [m/s].
    outside : int
        A point asked for a time outside its recorded part (beyond a rounding of the clock), or -1.
    """
    x, v = np.empty(times.shape), np.empty(times.shape)
    degree = steps.shape[1] - DENSE_HEAD - 1
    outside = -1
    for p in range(len(times)):
        starts = steps[first[p] : last[p], 1]
        if len(starts) == 0:
            outside = p
            continue
        for i in range(times.shape[1]):
            j = max(np.searchsorted(starts, times[p, i], side="right") - 1, 0)
            step = steps[first[p] + j]
            t = times[p, i] - step[1]
            slack = 1e-9 * step[2] + 4e-16 * abs(times[p, i])
            if not -slack <= t <= step[2] + slack:
                outside = p
            x[p, i], v[p, i] = polynomial(step[DENSE_HEAD:], degree, t)
    return x, v, outside
