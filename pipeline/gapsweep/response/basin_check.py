"""Basin check: whether motions approach the orbits that shooting found, and not other ones."""

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
    """How m motions approach their orbits.

    Attributes
    ----------
    is_own : ndarray of bool, shape (m,)
        Whether they are near and came closer over their windows.
    has_shrunk : ndarray of bool, shape (m,)
        Whether they did at least half as much as the orbits' multipliers say.
    is_near : ndarray of bool, shape (m,)
    goal : ndarray, shape (m,)
        Distance [m] within which they must come.
    stretch : ndarray of int, shape (m,)
        Periods that their multipliers need for that.
    """

    is_own: Mask
    has_shrunk: Mask
    is_near: Mask
    goal: Array
    stretch: Counts


def basin_check(
    windows: RecordedWindows, shooting: NewtonShooting, points: Numbers, slow: Mask
) -> Approach:
    """Compare the windows of motions with orbits; `slow` as from `is_slow`."""
    n, last = shooting.n[points], windows.length[points] - 1
    resolution, near = windows.resolution[points], NEAR * windows.reach[points]
    first = norm(windows.section[:, points, last % n] - _orbits(windows, shooting, points))
    modulus = shooting.modulus(points)
    has_shrunk = _last(windows, shooting, points) <= 0.5 * (1.0 + modulus ** (last // n)) * first
    far = distances(windows, shooting, points, slow)
    # About a slow orbit the solver's noise adds up until as much is lost as comes anew.
    noise = resolution / np.sqrt(1.0 - modulus ** (2.0 / n))
    resolution = np.where(slow, np.maximum(resolution, np.minimum(noise, near)), resolution)
    goal = np.maximum(np.minimum(CLOSER * far, near), resolution)
    # One factor of two more: a state's directions do not shrink as one.
    stretch = repeats(0.5 * goal / np.maximum(far, goal), modulus) * n
    is_own = far <= np.maximum(resolution, np.minimum(near, CLOSER * first))
    return Approach(is_own, has_shrunk, far <= near, goal, stretch)


def is_slow(shooting: NewtonShooting, points: Numbers, n_periods: int) -> Mask:
    """Whether a window of so many periods shrinks disturbances of orbits but little."""
    return np.asarray(shooting.modulus(points) ** (n_periods / shooting.n[points]) > SLOW)


def distances(
    windows: RecordedWindows, shooting: NewtonShooting, points: Numbers, slow: Mask
) -> Array:
    """Distances [m] of motions, at whole periods of their orbits, from the orbits' first points.

    The last ones; where orbits are slow, the largest in the windows.
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
