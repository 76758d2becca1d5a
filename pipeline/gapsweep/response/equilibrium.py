"""Right-hand sides at single states: time derivatives, and linear stability of equilibria."""

import math
from collections.abc import Callable, Iterator
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.problem import Models
from gapsweep.integrate.reference_impacts import rates_on_walls
from gapsweep.integrate.reference_scenes import scene_of
from gapsweep.model.structure import with_walls_apart
from gapsweep.model.system import first_order
from gapsweep.response.ensemble import Ensemble
from gapsweep.response.section import norm
from gapsweep.response.thresholds import REST

Array = NDArray[np.float64]
Numbers = NDArray[np.intp]

# An equilibrium this close to a wall, as a share of the gap and its position, is on the wall.
_ON_WALL = 1e-7
_STILL = 1e-10


def linear_stability(ensemble: Ensemble, scene: int, y: Array) -> tuple[float, float]:
    """Growth rate of disturbances of an equilibrium, and its distance from a state.

    Parameters
    ----------
    scene : int
        Number of the case.
    y : ndarray, shape (n_states,)
        The state.

    Returns
    -------
    rate : float
        Largest real part [1/s] of the eigenvalues of the linearised motion; zero if it is within
        rounding of the fastest rate. On a wall the linearisations of both sides differ, and the
        rate is NaN, unless the motion leaves along an eigenvector of one side (its eigenvalue), or
        volumes grow on all sides (a lower bound).
    offset : float
        Distance [m] of `y` from the equilibrium, as a section point, by Newton's step.
    """
    found = [_linearised(ensemble, scene, y, modes) for modes in _sides(ensemble, scene, y)]
    unit = ensemble.unit[:, scene]
    offset = min(float(norm(np.linalg.lstsq(a, v)[0] / unit)) for v, a in found)
    growth = [np.linalg.eigvals(a) for _, a in found]
    if len(growth) > 1:
        leaving = [float(rate.real) for each in growth for rate in each if not rate.imag]
        # If volumes grow on every side, they grow along any motion between the sides.
        spreading = min(float(each.real.mean()) for each in growth)
        largest = max([spreading, *leaving])
        return (largest if largest > 0.0 else math.nan), offset
    largest = float(growth[0].real.max())
    return (0.0 if abs(largest) <= _STILL * np.abs(growth).max() else largest), offset


def _linearised(ensemble: Ensemble, scene: int, y: Array, modes: Any) -> tuple[Array, Array]:
    """Return the right-hand side at a state, and its Jacobian with respect to the state."""
    n, state = len(y), np.concatenate([y, np.eye(len(y)).ravel()])
    found = np.asarray(_right_side(ensemble, scene, tangent=True, modes=modes)(0.0, state))
    return found[:n], found[n:].reshape(n, n).T  # images of unit states, one after the other


def _sides(ensemble: Ensemble, scene: int, y: Array) -> Iterator[Any]:
    """Yield the contact modes on all sides of the walls that a state lies on; None: the modes of
    the state.
    """
    (system, laws), swing = _apart(ensemble, scene), ensemble.swing[scene]
    choices = []
    for gap, law in zip(np.asarray(system.directions) @ y[: system.n], laws, strict=True):
        near = _ON_WALL * (law.gap.size + abs(gap)) + REST * swing
        low, high = law.walls
        modes = {int(gap > high) - int(gap < low)}
        for wall, mode in ((high, 1), (low, -1)):
            if law.has_modes and abs(gap - wall) <= near:
                modes |= {0, mode}
        # With zero gap there is no free mode between the walls.
        choices.append(sorted(modes - {0} if low == high and len(modes) > 1 else modes))
    if all(len(modes) == 1 for modes in choices):
        # The modes have the damping of contacts, too.
        is_lossy = any(law.losses for law in laws)
        yield tuple(mode for (mode,) in choices) if is_lossy else None
    elif all(law.has_modes for law in laws):
        yield from product(*choices)
    else:
        yield from (None, None)  # with other laws: only this side, and no exponent


def rates(ensemble: Ensemble, scene: int, y: Array) -> Array:
    """Return the time derivative of a state, at forcing phase zero."""
    return np.asarray(_right_side(ensemble, scene, tangent=False)(0.0, y))


def _right_side(
    ensemble: Ensemble, scene: int, *, tangent: bool, modes: Any = None
) -> Callable[[float, Array], Any]:
    """Return the right-hand side, with the laws as they are or, if exact, in contact `modes`."""
    (system, laws), solver = _apart(ensemble, scene), ensemble.solver
    given = float(ensemble.models.omega[scene]), 0.0, solver.rtol, float(ensemble.atol[scene])
    return scene_of(system)(system, laws, *given, tangent=tangent).rhs(modes)


def _apart(ensemble: Ensemble, scene: int) -> tuple[Any, Any]:
    """Model and laws of a case, each wall of a pair that overlaps as a contact."""
    return with_walls_apart(ensemble.system(scene), ensemble.laws(scene))


class Rates:
    """Time derivatives of states of many systems of one size, at forcing phase zero.

    Computed for all states together, but elementwise: no result depends on the other states.

    Parameters
    ----------
    models : Models
    """

    def __init__(self, models: Models) -> None:
        self._system, self._law, self._laws = models.system, models.law, models.laws
        self._models = models
        terms = [_terms(system) for system in models.systems]
        self._linear, self._load, self._cubics, self._contacts = map(
            np.array, zip(*terms, strict=True)
        )

    def __call__(self, scenes: Numbers, y: Array) -> Array:
        """Return the time derivatives of states `y` of some cases, shape (n_states, m)."""
        of, n = self._system[scenes], self._load.shape[1]
        found, push = np.zeros_like(y), self._load[of].T.copy()
        for j, part in enumerate(y):
            found += self._linear[of, :, j].T * part
        for cubic in np.moveaxis(self._cubics[of], 0, -1):
            push -= cubic[n:] * _along(cubic[:n], y) ** 3
        for k, contact in enumerate(np.moveaxis(self._contacts[of], 0, -1)):
            gap = _along(contact[:n], y)
            speed = _along(contact[:n], y[n : 2 * n])
            push -= contact[n:] * self._force(k, self._law[scenes], gap, speed)
        found[n : 2 * n] += push
        for j, scene in enumerate(scenes.tolist()):
            laws = self._laws[self._law[scene]]
            if any(law.losses.may_hold for law in laws):
                system = self._models.systems[self._system[scene]]
                omega, size = float(self._models.omega[scene]), float(np.abs(y[:, j]).max())
                here = scene_of(system)(system, laws, omega, 0.0, 0.0, _ON_WALL * size, False)
                held = rates_on_walls(here, tuple(y[:, j].tolist()))
                found[:, j] = found[:, j] if held is None else held
        return found

    def _force(self, contact: int, law: Numbers, gap: Array, speed: Array) -> Array:
        force = np.empty_like(gap)
        for one in np.unique(law).tolist():
            here = law == one
            law_here = self._laws[one][contact]
            force[here] = 0.0  # of a rigid wall: impacts have no finite force
            if not law_here.losses.is_rigid:
                force[here] = law_here.force(gap[here], speed[here])
        return force


def _along(direction: Array, y: Array) -> Array:
    """Projections of the coordinates of states on directions, shape (m,)."""
    parts = [of * q for of, q in zip(direction, y, strict=False)]
    return np.asarray(sum(parts[1:], start=parts[0]))


def _terms(system: Any) -> tuple[Array, ...]:
    """Linear part of a system, its load, and directions and accelerations of cubics and contacts.

    Returns
    -------
    linear : ndarray, shape (n_states, n_states)
    load : ndarray, shape (n,)
    cubics, contacts : ndarray, shape (number of them, 2 n)
    """
    n, inverse = system.n, np.linalg.inv(system.mass)
    load = np.zeros(n)
    for h in system.forcing:
        load += h.growth(0.0) * (inverse @ h.amplitude) * h.start
    cubics = [np.concatenate([c.along, inverse @ c.along * c.alpha]) for c in system.cubic]
    contacts = []
    for name, direction in system.contacts.items():
        modulation = system.modulation.get(name, ())
        rate = 1.0 + sum(m.depth * math.cos(m.phase) for m in modulation)
        contacts.append(np.concatenate([direction, rate * (inverse @ direction)]))
    shaped = (np.reshape(each, (-1, 2 * n)) for each in (cubics, contacts))
    return first_order(system), load, *shaped
