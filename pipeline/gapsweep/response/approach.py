"""Whether motions approach orbits that shooting found: the guard against a swapped attractor."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gapsweep.response.section import norm, repeats
from gapsweep.response.shooting import Shots
from gapsweep.response.walks import Walks

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Mask = NDArray[np.bool_]
Numbers = NDArray[np.intp]

# Before an orbit counts as its own, the motion must come within this share of the reach of it,
# and this much closer than it was.
NEAR = 1e-2
_CLOSER = 0.5
# Where a window shrinks a disturbance by less, no single point of it tells: a torus may pass the
# orbit as near, again and again.
_SLOW = 0.5


class Approach(NamedTuple):
    """Where m motions are beside their orbits.

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
        Forcing periods that their multipliers need for that.
    """

    is_own: Mask
    has_shrunk: Mask
    is_near: Mask
    goal: Array
    stretch: Counts


def approach(walks: Walks, shots: Shots, points: Numbers, slow: Mask) -> Approach:
    """Compare the windows of motions with orbits that were found for them.

    Parameters
    ----------
    walks : Walks
    shots : Shots
    points : ndarray of int, shape (m,)
    slow : ndarray of bool, shape (m,)
        As `is_slow` says.
    """
    n, last = shots.n[points], walks.length[points] - 1
    same, near = walks.same[points], NEAR * walks.reach[points]
    first = norm(walks.section[:, points, last % n] - _orbits(walks, shots, points))
    modulus = _modulus(shots, points)
    has_shrunk = _last(walks, shots, points) <= 0.5 * (1.0 + modulus ** (last // n)) * first
    far = farthest(walks, shots, points, slow)
    # About a slow orbit the solver's noise adds up until as much is lost as comes anew.
    rattled = same / np.sqrt(1.0 - modulus ** (2.0 / n))
    same = np.where(slow, np.maximum(same, np.minimum(rattled, near)), same)
    goal = np.maximum(np.minimum(_CLOSER * far, near), same)
    # One factor of two more: a state's directions do not shrink as one.
    stretch = repeats(0.5 * goal / np.maximum(far, goal), modulus) * n
    is_own = far <= np.maximum(same, np.minimum(near, _CLOSER * first))
    return Approach(is_own, has_shrunk, far <= near, goal, stretch)


def is_slow(shots: Shots, points: Numbers, n_periods: int) -> Mask:
    """Whether a window of so many forcing periods shrinks disturbances of orbits but little."""
    return np.asarray(_modulus(shots, points) ** (n_periods / shots.n[points]) > _SLOW)


def farthest(walks: Walks, shots: Shots, points: Numbers, slow: Mask) -> Array:
    """Distances of motions, at whole periods of their orbits, from these' starts [m].

    The last ones; where orbits are slow, the largest in the windows.

    Parameters
    ----------
    walks, shots, points, slow
        As of `approach`.
    """
    found = _last(walks, shots, points)
    for k in np.flatnonzero(slow).tolist():
        every = walks.window(points[k])[:, :: -shots.n[points[k]]]
        away = norm(every - _orbits(walks, shots, points[[k]]))
        found[k] = max(found[k], away.max(initial=0.0))
    return found


def _last(walks: Walks, shots: Shots, points: Numbers) -> Array:
    return norm((walks.y[:, points] - shots.y[:, points]) / walks.ensemble.unit[:, points])


def _orbits(walks: Walks, shots: Shots, points: Numbers) -> Array:
    return np.asarray(shots.y[:, points] / walks.ensemble.unit[:, points])


def _modulus(shots: Shots, points: Numbers) -> Array:
    return np.asarray(np.maximum(np.abs(shots.multipliers[points, 0]), 1e-12))
