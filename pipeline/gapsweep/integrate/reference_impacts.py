"""Impacts on rigid walls and holds there, for the reference engine; as `stepping.impacts`."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.reference_scenes import ReferenceScene, State
from gapsweep.model.contact_modes import HOLD, ON, SLACK

Array = NDArray[np.float64]

_LOW = 1e-13  # of the wall's distance: height of flights that are summed
_LONGEST_REST = 1e-3  # of a radian of the forcing and of the fastest oscillation
_AT_WALL = 16.0 * np.finfo(float).eps  # of the displacements that a gap is the sum of
_STILL = 64.0 * np.finfo(float).eps  # of the speeds that a gap's speed is the sum of


class Meeting(NamedTuple):
    """A contact's meeting of a rigid wall.

    Attributes
    ----------
    y : tuple of float
        State after it, with the tangent.
    modes : tuple of int
        Contact modes after it.
    changes : list of (float, int)
        Times and contacts of beginnings and ends of contacts.
    rest : float
        Time [s] of the flights until the wall holds.
    loss : float
        Part of `Motions.contact_loss`.
    """

    y: State
    modes: tuple[int, ...]
    changes: list[tuple[float, int]]
    rest: float
    loss: float


def moving(scene: ReferenceScene, modes: tuple[int, ...]) -> Callable[[float, Array], State]:
    """Return the right-hand side in contact modes, with held gaps."""
    free, held = scene.rhs(modes), _held(scene, modes)
    if not held:
        return free
    n, n_states, project = scene.n, scene.n_states, _projection(scene, held)

    def f(t: float, y: Array) -> State:
        rates = np.array(free(t, y), dtype=float)
        rates[n : 2 * n] = project @ rates[n : 2 * n]
        images = rates[n_states:].reshape(-1, n_states)
        images[:, n : 2 * n] = images[:, n : 2 * n] @ project.T
        return tuple(rates.tolist())

    return f


def hold_force(scene: ReferenceScene, modes: tuple[int, ...], contact: int) -> Callable[..., float]:
    """Return the force that holds a contact on its wall, upwards, as a function of time, state."""
    free, held, n = scene.rhs(modes), _held(scene, modes), scene.n
    b, pull = scene.directions[held], scene.pull[:, held]
    row = np.linalg.inv(b @ pull)[held.index(contact)] @ b

    def force(t: float, y: Array) -> float:
        return float(row @ np.asarray(free(t, y))[n : 2 * n])

    return force


def _held(scene: ReferenceScene, modes: tuple[int, ...]) -> list[int]:
    return [k for k, mode in enumerate(modes) if abs(mode) == HOLD]


def _projection(scene: ReferenceScene, held: list[int]) -> Array:
    """Matrix that takes the components along held contacts from accelerations."""
    b, pull = scene.directions[held], scene.pull[:, held]
    found = np.eye(scene.n) - pull @ np.linalg.solve(b @ pull, b)
    return np.where(np.abs(found) <= _STILL, 0.0, found)


def has_dependent_holds(scene: ReferenceScene, modes: tuple[int, ...]) -> bool:
    """Whether a held gap cannot move because of the other held ones: no forces follow."""
    held = _held(scene, modes)
    return bool(np.linalg.matrix_rank(scene.directions[held]) < len(held))


def is_inside(scene: ReferenceScene, y: State) -> bool:
    """Whether all gaps are between their rigid walls, or pass them by less than the tolerance."""
    for k, law in enumerate(scene.laws):
        if law.losses.is_rigid:
            gap, (low, high), (_, slack) = scene.gap(k, y), law.walls, _near(scene, k, y)
            if not low - slack <= gap <= high + slack:
                return False
    return True


def _near(scene: ReferenceScene, contact: int, y: State) -> tuple[float, float]:
    """Distances [m] before and beyond a rigid wall within which a gap is on it.

    At a wall at zero, the size of the gap is no scale of rounding.
    """
    slack = _AT_WALL * float(np.abs(scene.directions[contact]) @ np.abs(y[: scene.n]))
    return slack, max(slack, scene.atol)


def on_rigid_walls(scene: ReferenceScene, y: State) -> list[tuple[int, int]]:
    """Contacts, and sides, that are on rigid walls up to rounding and do not leave them."""
    found = []
    for k, law in enumerate(scene.laws):
        before, beyond = _near(scene, k, y)
        for side in (1, -1) if law.losses.is_rigid else ():
            size = _STILL * float(np.abs(scene.directions[k]) @ np.abs(y[scene.n : 2 * scene.n]))
            speed = side * scene.gap(k, y[scene.n :])
            depth = side * (scene.gap(k, y) - scene.wall(k, side))
            if -before <= depth <= beyond and speed >= -size:
                found.append((k, side))
    return found


def meet(
    scene: ReferenceScene, t: float, y: State, modes: tuple[int, ...], contact: int, side: int
) -> Meeting:
    """Reverse the speed of a gap that meets a rigid wall, or begin a hold."""
    n, n_states, losses = scene.n, scene.n_states, scene.laws[contact].losses
    b, pull, e = scene.directions[contact], scene.pull[:, contact], losses.restitution
    state, images = np.array(y[:n_states]), np.reshape(y[n_states:], (-1, n_states))
    speed = float(b @ state[n : 2 * n])
    if side * speed < 0.0:  # turned by another impact
        return Meeting(y, modes, [], 0.0, 0.0)
    turn = np.eye(n_states)
    turn[n : 2 * n, n : 2 * n] -= (1.0 + e) * np.outer(pull, b) / (b @ pull)
    before = np.asarray(moving(scene, modes)(t, np.array(y)))[:n_states]
    after = turn @ state
    on_walls = [(k, 1 if modes[k] > 0 else -1) for k in _held(scene, modes)] + [(contact, side)]
    for k, of in on_walls:  # rounding errors would become impacts
        off = scene.gap(k, after) - scene.wall(k, of)
        after[:n] -= off * scene.pull[:, k] / scene.compliance[k]
    found, changes = _others(scene, t, y, after, modes, contact)
    rates = np.asarray(moving(scene, found)(t, np.append(after, images)))[:n_states]
    if abs(speed) > _STILL * float(np.abs(b) @ np.abs(state[n : 2 * n])):
        normal = np.append(b, np.zeros(n_states - n)) / speed
        turn += np.outer(rates - turn @ before, normal)
    images = images @ turn.T
    pressing, left = side * float(b @ rates[n : 2 * n]), e * abs(speed)
    rest = 0.0
    holds = pressing >= 0.0 and 0.5 * left**2 <= pressing * _height(scene, contact, side)
    if holds and left > 0.0:
        rest = 2.0 * left / (pressing * (1.0 - e)) if e < 1.0 else math.inf
        holds = rest * _rate(scene) <= _LONGEST_REST
    if holds:
        found = (*found[:contact], side * HOLD, *found[contact + 1 :])
    changes += [(t + rest, contact)] if holds else [(t, contact)] * 2
    loss = math.inf if holds else losses.of_impact
    if has_dependent_holds(scene, found):
        return Meeting(y, found, [], 0.0, loss)
    if held := _held(scene, found):
        after[n : 2 * n] = _projection(scene, held) @ after[n : 2 * n]
    met = held_tangent(scene, (*after, *images.ravel()), found)
    return Meeting(met, found, changes, rest, loss)


def held_tangent(scene: ReferenceScene, y: State, modes: tuple[int, ...]) -> State:
    """Return a state, the tangent of which is without the components along held contacts."""
    n, n_states, found = scene.n, scene.n_states, np.array(y)
    if held := _held(scene, modes):
        images = found[n_states:].reshape(-1, n_states)  # a view
        for part in (images[:, :n], images[:, n : 2 * n]):
            part[:] = part @ _projection(scene, held).T
    return tuple(found.tolist())


def _height(scene: ReferenceScene, contact: int, side: int) -> float:
    """Height [m] of flights that are summed: lower ones are below the tolerance, or rounding."""
    return scene.atol + _LOW * abs(scene.wall(contact, side))


def _rate(scene: ReferenceScene) -> float:
    """Fastest angular frequency [rad/s] of the forcing and the linear parts."""
    return 2.0 * math.pi * max(scene.omega, float(scene.system.fastest))


def _others(
    scene: ReferenceScene,
    t: float,
    y: State,
    after: Array,
    modes: tuple[int, ...],
    contact: int,
) -> tuple[tuple[int, ...], list[tuple[float, int]]]:
    """Modes of the other contacts after an impact; times of contacts that begin or end."""
    found, n = list(modes), scene.n
    for j, mode in enumerate(modes):
        if j == contact or not mode:
            continue
        side = 1 if mode > 0 else -1
        speed = scene.gap(j, after[n:])
        if abs(mode) == HOLD:
            size = float(np.abs(scene.directions[j]) @ np.abs(after[n : 2 * n]))
            pressing = side * hold_force(scene, modes, j)(t, np.array(y)) * scene.compliance[j]
            if abs(speed) > _STILL * size and 0.5 * speed**2 > pressing * _height(scene, j, side):
                found[j] = 0
        elif scene.laws[j].losses.never_pulls:
            force = scene.pressure(j, mode)(scene.gap(j, after), speed)
            found[j] = side * (ON if side * force >= 0.0 else SLACK)
    changes = [(t, j) for j, (a, b) in enumerate(zip(modes, found, strict=True)) if a != b]
    return tuple(found), changes
