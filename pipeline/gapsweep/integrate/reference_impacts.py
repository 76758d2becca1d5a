"""Impacts on rigid walls, and holds, for the reference engine; as `stepping.impacts`."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.problem import low_bounce
from gapsweep.integrate.reference_scenes import ReferenceScene, State, Watched
from gapsweep.model.contact_modes import HOLD, MODES, ON, SLACK

Array = NDArray[np.float64]

_LOW = 1e-13  # of the wall's distance: height of flights that are summed
_LEAST = 1e-3  # of the absolute tolerance: height of flights at preloads that are left out
_LONGEST_REST = 1e-3  # of a radian of the forcing and of the fastest oscillation
_STEP = 0.3  # in rad of the fastest oscillation, while walls hold contacts
_AT_WALL = 16.0 * np.finfo(float).eps  # of the displacements that a gap is the sum of
_CLEAR = 1e-9  # of a force or acceleration: how far beyond its limit it ends or begins a hold
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


def hold_ends(scene: ReferenceScene, modes: tuple[int, ...], contact: int) -> list[Watched]:
    """Return what ends a hold: a force of zero, and one above the preload."""
    side, force = (1 if modes[contact] > 0 else -1), hold_force(scene, modes, contact)
    law = scene.laws[contact]
    most = side * law.losses.preload
    low = -most if law.walls[0] == law.walls[1] else 0.0
    found = [Watched(contact, side, True, low, hold=force)]
    return [*found, Watched(contact, side, False, most, hold=force)] if most else found


def longest_step(scene: ReferenceScene, modes: tuple[int, ...]) -> float:
    """Longest step [s] in which the forces of holds are known: they need no steps of the motion."""
    waves = [abs(h.k) for h in getattr(scene.system, "harmonics", ())]
    rate = _rate(scene) * max([1, *waves])
    return _STEP / rate if rate and _held(scene, modes) else math.inf


def is_caught(
    scene: ReferenceScene,
    t: float,
    y: State,
    modes: tuple[int, ...],
    contact: int,
    side: int,
    reach: Array,
) -> bool:
    """Whether a preload holds a gap on its wall: the flights of both sides are below `low_bounce`.

    `reach` has the largest displacements so far.
    """
    law, n, b = scene.laws[contact], scene.n, scene.directions[contact]
    change = law.losses.preload * scene.compliance[contact]
    free = (*modes[:contact], 0, *modes[contact + 1 :])
    pressing = side * float(b @ np.asarray(moving(scene, free)(t, np.array(y)))[n : 2 * n])
    least = -change if law.walls[0] == law.walls[1] else 0.0
    slowest = min(pressing - least, change - pressing)
    height = max(low_bounce(scene.rtol) * float(np.abs(b) @ reach), _LEAST * scene.atol)
    speed = scene.gap(contact, y[n:])
    return bool(change > 0.0 and slowest >= 0.0 and 0.5 * speed**2 <= slowest * height)


def stopped(scene: ReferenceScene, y: State, modes: tuple[int, ...]) -> State:
    """Return a state without the speeds along held contacts, and its tangent."""
    n, found = scene.n, np.array(y)
    found[n : 2 * n] = _projection(scene, _held(scene, modes)) @ found[n : 2 * n]
    return held_tangent(scene, tuple(found.tolist()), modes)


def turned(
    scene: ReferenceScene,
    t: float,
    y: State,
    before: tuple[int, ...],
    modes: tuple[int, ...],
    contact: int,
) -> State:
    """Return the state after ends of holds, at a wall that a contact passes: the tangent jumps."""
    n, n_states, found = scene.n, scene.n_states, np.array(y)
    speed = scene.gap(contact, y[n:])
    if speed and abs(modes[contact]) != HOLD:
        rates = [np.asarray(moving(scene, each)(t, found))[:n_states] for each in (before, modes)]
        images = found[n_states:].reshape(-1, n_states)  # a view
        along = images[:, :n] @ scene.directions[contact]
        images += np.outer(along / speed, rates[1] - rates[0])
    return tuple(found.tolist())


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


def still(scene: ReferenceScene, contact: int, y: State | Array) -> float:
    """Speed of a gap [m/s] that may be rounding."""
    return _STILL * float(np.abs(scene.directions[contact]) @ np.abs(y[scene.n : 2 * scene.n]))


def on_walls(scene: ReferenceScene, y: State) -> dict[int, int]:
    """Sides of contacts that are up to rounding on walls that may hold, and do not leave them.

    A moving gap is on a rigid wall only.
    """
    found = {}
    for k, law in enumerate(scene.laws):
        before, beyond = _near(scene, k, y)
        for side in (1, -1) if law.losses.may_hold else ():
            speed = side * scene.gap(k, y[scene.n :])
            depth, slow = side * (scene.gap(k, y) - scene.wall(k, side)), still(scene, k, y)
            if law.losses.is_rigid:
                is_on = -before <= depth <= beyond and speed >= -slow
            else:
                is_on = abs(depth) <= before and abs(speed) <= slow
            if is_on:
                found[k] = side
                break
    return found


def settled(
    scene: ReferenceScene, t: float, y: State, modes: tuple[int, ...], on: dict[int, int]
) -> tuple[int, ...]:
    """Return the modes in which walls hold the contacts at rest `on` them, all decided together.

    Forces of holds within their limits and accelerations away from the walls are a linear
    complementarity problem with the positive definite matrix B'M^-1 B: it has one solution. By
    Murty's method the mode of the first contact that violates it changes, until none does [1]_.

    References
    ----------
    .. [1] K. G. Murty, "Note on a Bard-type scheme for solving the complementarity problem",
       Opsearch 11 (1974) 123-130.
    """
    resting = {
        k: side
        for k, side in sorted(on.items())
        if scene.laws[k].losses.may_hold
        and (abs(modes[k]) == HOLD or abs(scene.gap(k, y[scene.n :])) <= still(scene, k, y))
    }
    for _ in range(3 ** len(resting)):
        if has_dependent_holds(scene, modes):
            return modes
        rates = np.asarray(moving(scene, modes)(t, np.array(y)))[scene.n : 2 * scene.n]
        for k, side in resting.items():
            new = _of_rest(scene, t, y, modes, k, side, rates)
            if new != modes[k]:
                modes = (*modes[:k], new, *modes[k + 1 :])
                break
        else:
            break
    return modes


def rates_on_walls(scene: ReferenceScene, y: State) -> Array | None:
    """Time derivative of a state in which walls may hold contacts; None away from these walls."""
    if on := dict(on_walls(scene, y)):
        modes = settled(scene, 0.0, y, scene.modes_at(0.0, y), on)
        if not has_dependent_holds(scene, modes):
            return np.asarray(moving(scene, modes)(0.0, np.array(y)))
    return None


def _of_rest(
    scene: ReferenceScene,
    t: float,
    y: State,
    modes: tuple[int, ...],
    contact: int,
    side: int,
    rates: Array,
) -> int:
    """Mode of a contact at rest on a wall, while those of others and their accelerations stay."""
    b = scene.directions[contact]
    if abs(modes[contact]) != HOLD:
        towards = side if not modes[contact] else -side
        pressing = towards * float(b @ rates)
        holds = pressing > _CLEAR * float(np.abs(b) @ np.abs(rates))
        return side * HOLD if holds else modes[contact]
    force = hold_force(scene, modes, contact)(t, np.array(y))
    most = float(np.abs(b) @ np.abs(rates)) / scene.compliance[contact]
    for end in hold_ends(scene, modes, contact):
        beyond = end.side * (end.at - force) * (1.0 if end.falls else -1.0)
        if beyond > _CLEAR * max(abs(force), most):
            return scene.passed(t, y, modes, end)[contact]
    return modes[contact]


def meet(
    scene: ReferenceScene, t: float, y: State, modes: tuple[int, ...], contact: int, side: int
) -> Meeting:
    """Reverse the speed of a gap that meets a rigid wall faster than `still`, or begin a hold."""
    n, n_states, losses = scene.n, scene.n_states, scene.laws[contact].losses
    b, pull, e = scene.directions[contact], scene.pull[:, contact], losses.restitution
    state, images = np.array(y[:n_states]), np.reshape(y[n_states:], (-1, n_states))
    speed = float(b @ state[n : 2 * n])
    turn = np.eye(n_states)
    turn[n : 2 * n, n : 2 * n] -= (1.0 + e) * np.outer(pull, b) / (b @ pull)
    before = np.asarray(moving(scene, modes)(t, np.array(y)))[:n_states]
    after = turn @ state
    on_walls = [(k, 1 if modes[k] > 0 else -1) for k in _held(scene, modes)] + [(contact, side)]
    for k, of in on_walls:  # rounding errors would become impacts
        off = scene.gap(k, after) - scene.wall(k, of)
        after[:n] -= off * scene.pull[:, k] / scene.compliance[k]
    moved, changes = _others(scene, t, y, after, modes, contact)
    sides = {k: 1 if moved[k] > 0 else -1 for k in _held(scene, moved)}
    found = settled(scene, t, (*after, *images.ravel()), moved, sides)
    changes += changed(t, moved, found)
    rates = np.asarray(moving(scene, found)(t, np.append(after, images)))[:n_states]
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
            pressing = side * hold_force(scene, modes, j)(t, np.array(y)) * scene.compliance[j]
            is_low, beyond = 0.5 * speed**2 <= pressing * _height(scene, j, side), 0
            if scene.laws[j].losses.preload:
                moved, low, high = (*after, *y[scene.n_states :]), *scene.laws[j].walls
                is_low = is_caught(scene, t, moved, modes, j, side, np.abs(y[:n]))
                outward = 1 if speed > 0.0 else -1
                beyond = outward if outward == side or low == high else 0
            if abs(speed) > still(scene, j, after) and not is_low:
                found[j] = beyond
        elif scene.laws[j].losses.never_pulls:
            force = scene.pressure(j, mode)(scene.gap(j, after), speed)
            found[j] = side * (ON if side * force >= 0.0 else SLACK)
    return tuple(found), changed(t, modes, found)


def changed(t: float, before: Sequence[int], after: Sequence[int]) -> list[tuple[float, int]]:
    """Times and contacts of beginnings and ends: with both walls in one place, two at once."""
    found = []
    for k, (old, new) in enumerate(zip(before, after, strict=True)):
        acts = [MODES[abs(mode)].acts for mode in (old, new)]
        found += [(t, k)] * (2 * (old == -new) if all(acts) else int(acts[0] != acts[1]))
    return found
