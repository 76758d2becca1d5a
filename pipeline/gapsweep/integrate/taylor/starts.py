"""Points made ready for the kernel: a scene's row, its start, its clocks.

Compiled, because calls of few points would otherwise spend more on this than on their motion.
"""

import math
from math import isfinite

import numpy as np

from gapsweep.integrate.jit import entry, internal

from . import lane_rows as row

# The absolute part of a step's tolerance never exceeds rtol times this part of the motion's
# natural size: a step at high order costs so little more that a generous atol buys nothing, and
# would only spoil motions much smaller than a metre. It is never zero in motion, so that a
# start at rest, without an amplitude of its own, gets a finite step.
FLOOR_SHARE = 1e-3
READY, ON_WALL, NOT_FINITE, BACKWARD = range(4)
_CLOCK_ROUNDING = 4.0 * np.finfo(float).eps


@entry
def set_starts(points, table, which, x_0, v_0, t_0, t_end, record_from, section_only, rtol, atol):
    """Copy rows of a table of scenes and put starts and ends into the copies.

    Parameters
    ----------
    points : array, shape (n + 1, N_ROWS)
        Receives the points, and the table's last row, the idle point, as its last one.
    table : array, shape (n_scenes + 1, N_ROWS)
        Rows of `exact.Scenes`.
    which : int array, shape (n,)
        Number of the scene of each point.
    x_0, v_0, t_0, t_end, record_from : arrays, shape (n,)
    section_only : bool
        As in `exact.run`.

    Returns
    -------
    int
        READY; ON_WALL: points start on a wall, their `MODE` is left to the caller; NOT_FINITE or
        BACKWARD: a value is not a number, or an end lies before its start.
    """
    points[-1] = table[-1]
    outcome = READY
    for i in range(len(which)):
        if not (isfinite(x_0[i]) and isfinite(v_0[i]) and isfinite(t_0[i]) and isfinite(t_end[i])):
            return NOT_FINITE
        if math.isnan(record_from[i]):
            return NOT_FINITE
        if t_end[i] < t_0[i]:
            return BACKWARD
        point = points[i]
        point[:] = table[which[i]]
        x, v = x_0[i], v_0[i]
        point[row.X], point[row.V] = x, v
        size = max(point[row.FLOOR], _swing(x, v, point))
        floor = rtol * FLOOR_SHARE * size
        floor = min(floor, atol) if atol > 0.0 else floor
        point[row.FLOOR] = floor * math.sqrt(point[row.STIFFNESS])
        _set_clocks(point, t_0[i], t_end[i], record_from[i])
        point[row.EVENT_CLOCK] = np.inf if section_only else point[row.RECORD_CLOCK]
        point[row.REACH] = abs(x)
        if x == point[row.UPPER] or x == point[row.LOWER]:
            outcome = ON_WALL
        point[row.MODE] = 1.0 if x > point[row.UPPER] else -1.0 if x < point[row.LOWER] else 0.0
    return outcome


@internal
def _swing(x, v, point):
    """Displacement [m] that the free springs would carry the state to, as in `taylor_ir`."""
    stiffness, cubic = point[row.STIFFNESS], abs(point[row.CUBIC])
    energy = v * v + (stiffness + 0.5 * cubic * x * x) * x * x
    return math.sqrt(
        2.0 * energy / (stiffness + math.sqrt(stiffness * stiffness + 2.0 * cubic * energy))
    )


@internal
def _set_clocks(point, t_0, t_end, record_from):
    # The product is rounded to a whole number if t_0 was meant as one: its rounding and that of
    # t_0 are of one size. Everything later counts from the start, so nothing else is lost.
    omega = point[row.OMEGA]
    start, stop = t_0 * omega, t_end * omega
    tau = start - np.floor(start)
    end = tau + (t_end - t_0) * omega
    if tau == 0.0 and stop == np.rint(stop):
        end = stop - start
    # An end that rounding alone separates from a whole period is meant as one: else its section
    # point would be lost. None is meant as no time at all.
    whole = np.rint(end)
    if whole > 0.0 and abs(end - whole) <= _CLOCK_ROUNDING * (1.0 + end):
        end = whole
    point[row.TAU] = point[row.TAU_START] = tau
    point[row.T_START] = t_0
    point[row.END_CYCLE] = np.floor(end)
    point[row.END_TAU] = end - np.floor(end)
    point[row.RECORD_CLOCK] = tau + (record_from - t_0) * omega
