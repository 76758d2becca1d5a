"""Periodic orbits by shooting, their Floquet multipliers, and Lyapunov exponents.

The tangent equations carry the monodromy matrix along with the motion. The contact force is
continuous, so nothing jumps at a contact. Two facts hold for every force that depends on x
alone and check all of it: the product of the multipliers over n periods T is
``exp(-2 ζ ω_n n T)``, and the two Lyapunov exponents add up to ``-2 ζ ω_n``.

A point asks for an orbit by a `Shot` and for the growth of a disturbance by a `Growth`; `orbits`
and `growths` answer for all points that ask at once.
"""

import math
from collections.abc import Generator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gapsweep.response.maps import floquet_multipliers, newton_steps
from gapsweep.response.section import prime_multiple
from gapsweep.response.walk import Ensemble, Part, State, Stretch, Walk
from gapsweep.status import Status

Array = NDArray[np.float64]

_MAX_NEWTON = 6
# Newton may move this share of the response's reach; from farther away it leads anywhere.
_SMALL_STEP = 0.2
# Before an orbit counts as its own, the motion must come within this share of the reach of it,
# and this much closer than it was.
_NEAR = 1e-2
_CLOSER = 0.5
# A multiplier this close to the circle belongs to a bifurcation: shooting decides nothing there.
_INSIDE = 1.0 - 1e-6

# Lyapunov exponent: as many blocks, each at least this part of the decay time, after one to align
# the vector.
_N_BLOCKS = 60
_BLOCK = 0.47
_BATCH = 6  # blocks per batch mean: neighbouring blocks are correlated


class Shot(NamedTuple):
    """What a point asks for: the orbit near a state that closes after whole forcing periods.

    Attributes
    ----------
    y : (float, float)
        The state [m], [m/s].
    n : int
        Forcing periods of the orbit.
    goal : float
        Distance [m] of its ends below which an orbit is closed.
    furthest : float
        Distance [m] from `y` beyond which it is given up.
    """

    y: State
    n: int
    goal: float
    furthest: float


@dataclass(frozen=True, slots=True)
class Orbit:
    """A periodic orbit found by shooting.

    Attributes
    ----------
    y : (float, float)
        Its state at phase zero [m], [m/s].
    n : int
        Forcing periods in its period.
    multipliers : list of complex, length 2
        Floquet multipliers over n periods, largest modulus first.
    part : Part
        Its recorded motion over n periods.
    """

    y: State
    n: int
    multipliers: list[complex]
    part: Part


def orbits(ensemble: Ensemble, asked: Mapping[int, Shot]) -> list[Orbit | None]:
    """Answers to shots, by number of their scene: Newton on the map over n forcing periods.

    None where Newton went too far or did not converge, or where a motion failed.
    """
    found: dict[int, Orbit] = {}
    scenes = np.fromiter(asked, np.intp, len(asked))
    start, n, goal, furthest = map(np.array, zip(*asked.values(), strict=True))
    y, moved = start.T, np.zeros_like(start.T)
    for _ in range(_MAX_NEWTON):
        call = ensemble.call(scenes, y, n, np.zeros(len(scenes)), tangent=True)
        with np.errstate(over="ignore", invalid="ignore"):  # of motions that failed
            missed = (call.y - y) / call.unit
            is_near = np.hypot(*missed) <= goal
        is_closed = call.is_ok & call.is_sound & is_near
        closed = is_closed.nonzero()[0]
        if closed.size:
            multipliers = floquet_multipliers(call.monodromy[closed]).tolist()
            for k, pair in zip(closed.tolist(), multipliers, strict=True):
                found[int(scenes[k])] = Orbit(_state(y, k), int(n[k]), pair, call.part(k))
        if closed.size == len(scenes):
            break
        with np.errstate(over="ignore", invalid="ignore"):
            step = newton_steps(call.monodromy, missed.T).T
            y, moved = y + step * call.unit, moved + step
            is_near = np.hypot(*moved) <= furthest
        left = (is_near & call.is_ok & ~is_closed).nonzero()[0]
        if not left.size:
            break
        y, moved = y[:, left], moved[:, left]
        scenes, n, goal, furthest = scenes[left], n[left], goal[left], furthest[left]
    return [found.get(scene) for scene in asked]


def shoot(walk: Walk, n: int) -> Generator[Shot, Any, Orbit | None]:
    """The orbit over n forcing periods near where the motion is now.

    Returns
    -------
    Orbit or None
        None if none was found, the period is not prime, or a multiplier lies outside the unit
        circle: then the motion has to go on by itself.
    """
    reach, same = walk.reach, walk.same
    # Below the solver's own noise Newton makes no orbit close better.
    goal = max(1e-10 * reach, 0.1 * same)
    orbit: Orbit | None = yield Shot(walk.y, n, goal, _SMALL_STEP * reach)
    if orbit is None or not abs(orbit.multipliers[0]) < _INSIDE:
        return None
    is_prime = prime_multiple(orbit.part.section, max(10.0 * same, 1e-6 * reach)) == n
    return orbit if is_prime else None


def is_own(walk: Walk, orbit: Orbit, n_left: int) -> Generator[Stretch, Any, bool]:
    """Whether the motion itself approaches an orbit: the guard against a swapped attractor.

    It is, if it is near and came closer over its recorded window. Else it goes on, unrecorded,
    for as long as its slowest multiplier needs to come near, and must be near then. What needs
    more than `n_left` forcing periods for that is not waited for: near the orbit it must have
    shrunk at least half as much over its window as the multiplier says.
    """
    before = _distance(walk, orbit)
    if before <= max(walk.same, min(_NEAR * walk.reach, _CLOSER * _first_distance(walk, orbit))):
        return True
    goal = max(min(_CLOSER * before, _NEAR * walk.reach), walk.same)
    modulus = max(abs(orbit.multipliers[0]), 1e-12)
    # One factor of two more: the state's two directions do not shrink as one.
    repeats = max(1, math.ceil(math.log(0.5 * goal / before) / math.log(modulus)))
    if repeats * orbit.n > n_left:
        expected = modulus ** ((len(walk.section) - 1) // orbit.n)
        shrunk = before <= 0.5 * (1.0 + expected) * _first_distance(walk, orbit)
        return shrunk and before <= _NEAR * walk.reach
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


class Growth(NamedTuple):
    """What a point asks for: how a disturbance of its motion grows.

    Attributes
    ----------
    y : (float, float)
        State to start from [m], [m/s].
    n_periods : int
        Forcing periods in each of the blocks.
    """

    y: State
    n_periods: int


class Grown(NamedTuple):
    """How a disturbance grew.

    Attributes
    ----------
    y : (float, float)
        Where the motion ended [m], [m/s].
    status : Status
        How its last block ended; only those before have a factor.
    factors : list of float
        What each block multiplied the disturbance's length by; NaN where the tangent was unsound.
    """

    y: State
    status: Status
    factors: list[float]


def growths(ensemble: Ensemble, asked: Mapping[int, Growth]) -> list[Grown]:
    """Answers to questions for growth, by number of their scene."""
    found: dict[int, Grown] = {}
    factors: dict[int, list[float]] = {scene: [] for scene in asked}
    scenes = np.fromiter(asked, np.intp, len(asked))
    start, n_periods = map(np.array, zip(*asked.values(), strict=True))
    y, direction = start.T, np.tile((1.0, 0.0), (len(asked), 1))
    for _ in range(1 + _N_BLOCKS):
        call = ensemble.call(scenes, y, n_periods, np.full(len(scenes), math.inf), tangent=True)
        with np.errstate(all="ignore"):  # of motions that failed
            direction = np.matmul(call.monodromy, direction[:, :, None])[:, :, 0]
            length = np.hypot(*direction.T)
            direction = direction / length[:, None]
        length[~call.is_sound] = np.nan
        is_ok = call.is_ok
        for k in np.flatnonzero(~is_ok).tolist():
            scene = int(scenes[k])
            found[scene] = Grown(_state(y, k), Status(call.status[k]), factors[scene])
        scenes, n_periods, length = scenes[is_ok], n_periods[is_ok], length[is_ok]
        y, direction = call.y[:, is_ok], direction[is_ok]
        for scene, factor in zip(scenes.tolist(), length.tolist(), strict=True):
            factors[scene].append(factor)
        if not scenes.size:
            break
    for k, scene in enumerate(scenes.tolist()):
        found[scene] = Grown(_state(y, k), Status.OK, factors[scene])
    return [found[scene] for scene in asked]


def _state(y: Array, k: int) -> State:
    """State of one motion out of an array of shape (2, n)."""
    return float(y[0, k]), float(y[1, k])


@dataclass(frozen=True, slots=True)
class Exponents:
    """Largest Lyapunov exponent [1/s] and its standard error."""

    largest: float
    error: float

    @property
    def is_positive(self) -> bool:
        """Beyond three standard errors."""
        return self.largest > 3.0 * self.error


def lyapunov(walk: Walk, longest: int) -> Generator[Growth, Grown, Exponents | None]:
    """Largest Lyapunov exponent by the growth of one tangent vector along the motion.

    It takes about `longest` forcing periods at most.

    The second exponent is ``-2 ζ ω_n`` minus the first. The error is that of batch means.
    None if the motion failed on the way; NaN without damping, for then nothing is long enough,
    and where the tangent was unsound.
    """
    rate = walk.scene.oscillator.settling_rate
    if rate == 0.0:
        return Exponents(math.nan, math.nan)
    wanted = min(_BLOCK / rate * walk.omega, longest / (_N_BLOCKS + 1))
    n_periods = max(1, math.ceil(wanted))
    grown = yield Growth(walk.y, n_periods)
    walk.arrive(grown.y, grown.status, n_periods * len(grown.factors))
    if walk.status is not Status.OK:
        return None
    # The first block turns the vector into the direction of growth.
    rates = [math.log(factor) * walk.omega / n_periods for factor in grown.factors[1:]]
    batches = np.reshape(rates, (-1, _BATCH)).mean(axis=1)
    return Exponents(float(batches.mean()), float(batches.std(ddof=1) / math.sqrt(len(batches))))
