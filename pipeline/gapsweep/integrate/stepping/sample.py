"""States between steps, from the recorded series."""

import numpy as np

from gapsweep.integrate.jit import entry

from .record import DENSE_HEAD
from .roots import polynomial


@entry
def sample_steps(numbers, steps, first, last, times):
    """Return the states at some times, from the series of recorded steps.

    Parameters
    ----------
    steps : array, shape (n_steps, DENSE_HEAD + (n + m) * n_terms)
        Rows (point, start, length, coefficients of q and z), sorted by point and time.
    first, last : int array, shape (n_points,)
        Rows of each point.
    times : array, shape (n_points, n_t)
        Times [s], in any order.
    numbers : array, shape (1,)
        `RowLayout.numbers`.

    Returns
    -------
    states : ndarray, shape (n_states, n_points, n_t)
        (q, v, z).
    outside : int
        A point with a time outside its recorded part (beyond a rounding of the clock), or -1.
    """
    at = numbers[0]
    states = np.empty((at.n_states, *times.shape))
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
            for c in range(at.n + at.m):
                series = step[DENSE_HEAD + c * at.n_terms :]
                value, slope = polynomial(series, at.order, t)
                if c < at.n:
                    states[c, p, i], states[at.n + c, p, i] = value, slope
                else:
                    states[at.n + c, p, i] = value
    return states, outside
