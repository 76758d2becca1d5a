"""Periodic orbits by shooting, their Floquet multipliers, and Lyapunov exponents.

The tangent equations carry the monodromy matrix along with the motion. The contact force is
continuous, so nothing jumps at a contact. Two facts hold for every force that depends on x
alone and check all of it: the product of the multipliers over n periods T is
``exp(-2 ζ ω_n n T)``, and the two Lyapunov exponents add up to ``-2 ζ ω_n``.
"""

import math
from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from gapsweep.response.section import prime_multiple
from gapsweep.response.walk import Part, State, Stretch, Walk
from gapsweep.status import Status

_MAX_NEWTON = 6
# Newton may move this share of the response's reach; from farther away it leads anywhere.
_SMALL_STEP = 0.2
# Before an orbit counts as its own, the motion must come within this share of the reach of it,
# and this much closer than it was.
_NEAR = 1e-2
_CLOSER = 0.5
# A multiplier this close to the circle belongs to a bifurcation: shooting decides nothing there.
_INSIDE = 1.0 - 1e-6

# Lyapunov exponent: as many blocks, each at least this long [s], after one to align the vector.
_N_BLOCKS = 60
_BLOCK_SECONDS = 0.5
_BATCH = 6  # blocks per batch mean: neighbouring blocks are correlated


@dataclass(frozen=True, slots=True)
class Orbit:
    """A periodic orbit found by shooting.

    Attributes
    ----------
    y : (float, float)
        Its state at phase zero [m], [m/s].
    n : int
        Forcing periods in its period.
    multipliers : (complex, complex)
        Floquet multipliers over n periods, largest modulus first.
    part : Part
        Its recorded motion over n periods.
    """

    y: State
    n: int
    multipliers: tuple[complex, complex]
    part: Part


def shoot(walk: Walk, n: int) -> Generator[Stretch, Part, Orbit | None]:
    """Newton on the map over n forcing periods, from where the motion is now.

    Returns
    -------
    Orbit or None
        None if a step was too large, Newton did not converge, the period is not prime, or a
        multiplier lies outside the unit circle: then the motion has to go on by itself.
    """
    x, v = walk.y
    weight = 1.0 / walk.omega_rad
    goal = max(1e-10 * walk.reach, 0.1 * walk.noise if walk.scene.solver.rtol > 1e-8 else 0.0)
    furthest = _SMALL_STEP * walk.reach
    moved_x = moved_v = 0.0
    for _ in range(_MAX_NEWTON):
        part = yield Stretch((x, v), n, True, True)
        if part.status is not Status.OK:
            return None
        x_end, v_end = part.y
        if abs(complex(x_end - x, (v_end - v) * weight)) <= goal:
            return _accepted(walk, (x, v), n, part)
        step_x, step_v = part.newton_step
        moved_x, moved_v = moved_x + step_x, moved_v + step_v
        if not abs(complex(moved_x, moved_v * weight)) <= furthest:
            return None
        x, v = x + step_x, v + step_v
    return None


def _accepted(walk: Walk, y: State, n: int, part: Part) -> Orbit | None:
    same = max(10.0 * walk.noise, 1e-6 * walk.reach)
    is_stable = abs(part.multipliers[0]) < _INSIDE
    if not is_stable or prime_multiple(part.section, same) != n:
        return None
    return Orbit(y, n, part.multipliers, part)


def is_own(walk: Walk, orbit: Orbit) -> Generator[Stretch, Part, bool]:
    """Whether the motion itself approaches an orbit: the guard against a swapped attractor.

    It is, if it is near and came closer over its recorded window. Else it goes on, unrecorded,
    for as long as its slowest multiplier needs to come near, and must be near then.
    """
    before = _distance(walk, orbit)
    if before <= max(walk.noise, min(_NEAR * walk.reach, _CLOSER * _first_distance(walk, orbit))):
        return True
    goal = max(min(_CLOSER * before, _NEAR * walk.reach), walk.noise)
    modulus = max(abs(orbit.multipliers[0]), 1e-12)
    # One factor of two more: the state's two directions do not shrink as one.
    repeats = max(1, math.ceil(math.log(0.5 * goal / before) / math.log(modulus)))
    yield from walk.advance(repeats * orbit.n, record=False)
    return walk.status is Status.OK and _distance(walk, orbit) <= goal


def _distance(walk: Walk, orbit: Orbit) -> float:
    """Distance of the motion, at whole periods of the orbit, from its starting point [m]."""
    (x, v), (x_orbit, v_orbit) = walk.y, orbit.y
    return abs(complex(x - x_orbit, (v - v_orbit) / walk.omega_rad))


def _first_distance(walk: Walk, orbit: Orbit) -> float:
    """As `_distance`, at the first section point of the window that has the same phase [m]."""
    first = walk.section[(len(walk.section) - 1) % orbit.n]
    x, v = orbit.y
    return abs(first - complex(x, v / walk.omega_rad))


@dataclass(frozen=True, slots=True)
class Exponents:
    """Largest Lyapunov exponent [1/s] and its standard error."""

    largest: float
    error: float

    @property
    def is_positive(self) -> bool:
        """Beyond three standard errors."""
        return self.largest > 3.0 * self.error


def lyapunov(walk: Walk) -> Generator[Stretch, Part, Exponents | None]:
    """Largest Lyapunov exponent by the growth of one tangent vector along the motion.

    The second exponent is ``-2 ζ ω_n`` minus the first. The error is that of batch means.
    None if the motion failed on the way.
    """
    n_periods = max(1, math.ceil(_BLOCK_SECONDS * walk.omega))
    weight = 1.0 / walk.omega_rad
    direction = np.array([1.0, 0.0])
    growth = []
    for block in range(_N_BLOCKS + 1):
        part = yield Stretch(walk.y, n_periods, tangent=True)
        if part.status is not Status.OK:
            walk.status = part.status
            return None
        walk.y = part.y
        walk.n_periods += n_periods
        x, v = (part.monodromy @ direction).tolist()
        length = abs(complex(x, v * weight))
        direction = np.array((x / length, v / length))
        if block:  # the first one turns the vector into the direction of growth
            growth.append(math.log(length) * walk.omega / n_periods)
    batches = np.reshape(growth, (-1, _BATCH)).mean(axis=1)
    return Exponents(float(batches.mean()), float(batches.std(ddof=1) / math.sqrt(len(batches))))
