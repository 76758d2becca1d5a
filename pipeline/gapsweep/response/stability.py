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
from numpy.typing import NDArray

from gapsweep.response.section import prime_multiple, scaled
from gapsweep.response.walk import Part, State, Stretch, Walk
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
    multipliers : ndarray of complex, shape (2,)
        Floquet multipliers over n periods, largest modulus first.
    part : Part
        Its recorded motion over n periods.
    section : ndarray, shape (n, 2)
        Its scaled section points [m].
    """

    y: State
    n: int
    multipliers: NDArray[np.complex128]
    part: Part
    section: Array


def shoot(walk: Walk, n: int) -> Generator[Stretch, Part, Orbit | None]:
    """Newton on the map over n forcing periods, from where the motion is now.

    Returns
    -------
    Orbit or None
        None if a step was too large, Newton did not converge, the period is not prime, or a
        multiplier lies outside the unit circle: then the motion has to go on by itself.
    """
    y = np.array(walk.y)
    weight = np.array([1.0, 1.0 / (2.0 * math.pi * walk.omega)])
    goal = max(1e-10 * walk.reach, 0.1 * walk.noise if walk.scene.solver.rtol > 1e-8 else 0.0)
    moved = np.zeros(2)
    for _ in range(_MAX_NEWTON):
        part = yield from walk.probe((float(y[0]), float(y[1])), n, record=True)
        if part.status is not Status.OK or part.monodromy is None:
            return None
        residual = np.array(part.y) - y
        if np.hypot(*(residual * weight)) <= goal:
            return _accepted(walk, (float(y[0]), float(y[1])), n, part)
        step = _newton_step(part.monodromy, residual)
        moved = moved + step
        if not np.hypot(*(moved * weight)) <= _SMALL_STEP * walk.reach:
            return None
        y = y + step
    return None


def _newton_step(monodromy: Array, residual: Array) -> Array:
    """Step towards the fixed point; infinite where the map has none nearby."""
    try:
        return np.asarray(np.linalg.solve(np.eye(2) - monodromy, residual), dtype=float)
    except np.linalg.LinAlgError:
        return np.full(2, np.inf)


def _accepted(walk: Walk, y: State, n: int, part: Part) -> Orbit | None:
    assert part.monodromy is not None
    multipliers = floquet_multipliers(part.monodromy)
    section = scaled(part.events.section, walk.omega)
    same = max(10.0 * walk.noise, 1e-6 * walk.reach)
    if abs(multipliers[0]) >= _INSIDE or prime_multiple(section, same) != n:
        return None
    return Orbit(y, n, multipliers, part, section)


def floquet_multipliers(monodromy: Array) -> NDArray[np.complex128]:
    """Eigenvalues of a monodromy matrix, largest modulus first."""
    values = np.linalg.eigvals(monodromy).astype(complex)
    return values[np.argsort(-np.abs(values), kind="stable")]


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
    gap = np.array(walk.y) - np.array(orbit.y)
    return float(np.hypot(gap[0], gap[1] / (2.0 * math.pi * walk.omega)))


def _first_distance(walk: Walk, orbit: Orbit) -> float:
    """As `_distance`, at the first section point of the window that has the same phase [m]."""
    first = walk.section[(len(walk.section) - 1) % orbit.n]
    return float(np.hypot(*(first - scaled(np.array(orbit.y), walk.omega))))


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
    weight = np.array([1.0, 1.0 / (2.0 * math.pi * walk.omega)])
    direction = np.array([1.0, 0.0])
    growth = []
    for block in range(_N_BLOCKS + 1):
        part = yield from walk.probe(walk.y, n_periods)
        if part.status is not Status.OK or part.monodromy is None:
            walk.status = part.status
            return None
        walk.y = part.y
        walk.n_periods += n_periods
        direction = part.monodromy @ direction
        length = float(np.hypot(*(direction * weight)))
        direction = direction / length
        if block:  # the first one turns the vector into the direction of growth
            growth.append(math.log(length) * walk.omega / n_periods)
    batches = np.reshape(growth, (-1, _BATCH)).mean(axis=1)
    return Exponents(float(batches.mean()), float(batches.std(ddof=1) / math.sqrt(len(batches))))
