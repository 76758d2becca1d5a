"""What moves scenes, at a single state: derivatives by time, and eigenvalues about a rest."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.reference_scenes import OscillatorScene, SystemScene
from gapsweep.model.system import System, first_order
from gapsweep.response.ensemble import Scene
from gapsweep.response.section import norm

Array = NDArray[np.float64]
Numbers = NDArray[np.intp]

# A rest this near to a wall, as a share of the gap and its place, is on it.
_ON_WALL = 1e-7
_STILL = 1e-10


def about_rest(scene: Scene, y: Array, unit: Array) -> tuple[float, float]:
    """What a state of rest does to a motion beside it, and how far off it lies.

    Returns
    -------
    rate : float
        Largest real part [1/s] of an eigenvalue of the motion about it. A rate beside which the
        fastest is so great that rounding makes it is zero. NaN on a wall, where the motion is not
        the same on either side.
    offset : float
        Distance [m] of `y` from the rest, as a section point, by Newton's step.
    """
    n = len(y)
    state = np.concatenate([y, np.eye(n).ravel()])
    found = np.asarray(right_side(scene, tangent=True)(0.0, state))
    speed, slopes = found[:n], found[n:].reshape(n, n)
    offset = float(norm(np.linalg.lstsq(slopes, speed)[0] / unit))
    growth = np.linalg.eigvals(slopes)
    largest = float(growth.real.max())
    if _is_on_wall(scene, y):
        return math.nan, offset
    return 0.0 if abs(largest) <= _STILL * np.abs(growth).max() else largest, offset


def _is_on_wall(scene: Scene, y: Array) -> bool:
    system = scene.oscillator
    assert isinstance(system, System), "an oscillator is forced"
    gaps = system.directions @ y[: system.n]
    return any(
        min(abs(gap - law.gap.j_2), abs(gap + law.gap.j_1)) <= _ON_WALL * (law.gap.width + abs(gap))
        for gap, law in zip(gaps, scene.laws, strict=True)
    )


def rates(scene: Scene, y: Array) -> Array:
    """Derivative of a state by time, at forcing phase zero."""
    return np.asarray(right_side(scene, tangent=False)(0.0, y))


def right_side(scene: Scene, *, tangent: bool) -> Callable[[float, Array], Any]:
    """The equation of motion, with the laws as they are."""
    form = SystemScene if isinstance(scene.oscillator, System) else OscillatorScene
    solver = scene.solver
    given = scene.omega, 0.0, solver.rtol, solver.atol
    return form(scene.oscillator, scene.laws, *given, tangent=tangent).rhs(None)


class Rates:
    """Derivatives by time of states of many systems of one size, at forcing phase zero.

    All at a time, number by number: what one is does not depend on the others by a bit.

    Parameters
    ----------
    scenes : sequence of Scene, length n
    """

    def __init__(self, scenes: Sequence[Scene]) -> None:
        systems = {id(scene.oscillator): scene.oscillator for scene in scenes}
        number = {which: i for i, which in enumerate(systems)}
        self._system = np.array([number[id(scene.oscillator)] for scene in scenes])
        laws = [tuple(map(id, scene.laws)) for scene in scenes]
        several = {these: scene.laws for these, scene in zip(laws, scenes, strict=True)}
        which = {these: i for i, these in enumerate(several)}
        self._law = np.array([which[these] for these in laws])
        self._laws = list(several.values())
        terms = [_terms(system) for system in systems.values()]
        self._linear, self._load, self._cubics, self._contacts = map(
            np.array, zip(*terms, strict=True)
        )

    def __call__(self, scenes: Numbers, y: Array) -> Array:
        """Derivatives, shape (n_states, m), of the states of scenes of some numbers."""
        of, n = self._system[scenes], self._load.shape[1]
        found, push = np.zeros_like(y), self._load[of].T.copy()
        for j, part in enumerate(y):
            found += self._linear[of, :, j].T * part
        for cubic in np.moveaxis(self._cubics[of], 0, -1):
            push -= cubic[n:] * _along(cubic[:n], y) ** 3
        for k, contact in enumerate(np.moveaxis(self._contacts[of], 0, -1)):
            gap = _along(contact[:n], y)
            push -= contact[n:] * self._force(k, self._law[scenes], gap)
        found[n : 2 * n] += push
        return found

    def _force(self, contact: int, law: Numbers, gap: Array) -> Array:
        force = np.empty_like(gap)
        for one in np.unique(law).tolist():
            force[law == one] = self._laws[one][contact].force(gap[law == one])
        return force


def _along(direction: Array, y: Array) -> Array:
    """Projections of the coordinates of states, shape (m,)."""
    parts = [of * q for of, q in zip(direction, y, strict=False)]
    return np.asarray(sum(parts[1:], start=parts[0]))


def _terms(system: Any) -> tuple[Array, ...]:
    """A system's linear part, its load, and what cubic terms and contacts push along and with.

    Returns
    -------
    linear : ndarray, shape (n_states, n_states)
    load : ndarray, shape (n,)
    cubics, contacts : ndarray, shape (number of them, 2 n)
    """
    n, inverse = system.n, np.linalg.inv(system.mass)
    load = np.zeros(n)
    for h in system.forcing:
        load += h.growth(0.0) * (inverse @ h.amplitude) * math.cos(h.phase)
    cubics = [np.concatenate([c.along, inverse @ c.along * c.alpha]) for c in system.cubic]
    contacts = []
    for name, direction in system.contacts.items():
        modulation = system.modulation.get(name, ())
        rate = 1.0 + sum(m.depth * math.cos(m.phase) for m in modulation)
        contacts.append(np.concatenate([direction, rate * (inverse @ direction)]))
    shaped = (np.reshape(each, (-1, 2 * n)) for each in (cubics, contacts))
    return first_order(system), load, *shaped
