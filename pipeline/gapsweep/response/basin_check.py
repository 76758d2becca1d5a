"""Basin check: test that motions approach the orbits that shooting found, and not other ones."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gapsweep.response.section import norm, repeats
from gapsweep.response.shooting import NewtonShooting
from gapsweep.response.thresholds import CLOSER, NEAR, SLOW
from gapsweep.response.windows import RecordedWindows

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Mask = NDArray[np.bool_]
Numbers = NDArray[np.intp]


class Approach(NamedTuple):
    """Approach of m motions to their orbits."""

    is_own: Mask  # shape (m,); whether the motion is near its orbit and came closer over its window
    # Shape (m,); whether it came closer by at least half as much as the orbit's multiplier
    # predicts.
    has_shrunk: Mask
    is_near: Mask  # shape (m,)
    goal: Array  # shape (m,); distance [m] that the motion must reach
    stretch: Counts  # shape (m,); periods that it needs for that at the rate of the multiplier


def basin_check(
    windows: RecordedWindows, shooting: NewtonShooting, points: Numbers, slow: Mask
) -> Approach:
    """Compare the windows of motions with their orbits; `slow` is the result of `is_slow`."""
    n, last = shooting.n[points], windows.length[points] - 1
    resolution, near = windows.resolution(points), NEAR * windows.reach[points]
    first = norm(windows.section[:, points, last % n] - _orbits(windows, shooting, points))
    modulus = shooting.modulus(points)
    has_shrunk = _last(windows, shooting, points) <= 0.5 * (1.0 + modulus ** (last // n)) * first
    far = distances(windows, shooting, points, slow)
    # Near a slow orbit the solver's noise accumulates until decay balances it.
    noise = resolution / np.sqrt(1.0 - modulus ** (2.0 / n))
    resolution = np.where(slow, np.maximum(resolution, np.minimum(noise, near)), resolution)
    goal = np.maximum(np.minimum(CLOSER * far, near), resolution)
    # Another factor of two: directions of a state shrink at different rates.
    stretch = repeats(0.5 * goal / np.maximum(far, goal), modulus) * n
    is_own = far <= np.maximum(resolution, np.minimum(near, CLOSER * first))
    return Approach(is_own, has_shrunk, far <= near, goal, stretch)


def is_slow(shooting: NewtonShooting, points: Numbers, n_periods: int) -> Mask:
    """Whether disturbances of orbits shrink only little over a window of `n_periods`."""
    return np.asarray(shooting.modulus(points) ** (n_periods / shooting.n[points]) > SLOW)


def distances(
    windows: RecordedWindows, shooting: NewtonShooting, points: Numbers, slow: Mask
) -> Array:
    """Distances [m] of motions, at whole periods of their orbits, from the orbits' first points.

    The distance is that of the last state; for slow orbits, the largest one in the window.
    """
    found = _last(windows, shooting, points)
    for k in np.flatnonzero(slow).tolist():
        every = windows.window(points[k])[:, :: -shooting.n[points[k]]]
        away = norm(every - _orbits(windows, shooting, points[[k]]))
        found[k] = max(found[k], away.max(initial=0.0))
    return found


def _last(windows: RecordedWindows, shooting: NewtonShooting, points: Numbers) -> Array:
    return norm((windows.y[:, points] - shooting.y[:, points]) / windows.ensemble.unit[:, points])


def _orbits(windows: RecordedWindows, shooting: NewtonShooting, points: Numbers) -> Array:
    return np.asarray(shooting.y[:, points] / windows.ensemble.unit[:, points])
