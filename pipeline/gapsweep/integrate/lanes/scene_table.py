"""Tables of models for the kernel: a row has a model with its walls, forcing and tolerances."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gapsweep.model.contact_modes import ON

from .row_layout import RowLayout, oscillator_layout
from .start_rows import FLOOR_SHARE

Array = NDArray[np.float64]

# Shortest step that makes progress, in rad of the natural or forcing frequency: a stiffness of 1e9
# N/m takes steps a million times longer, and a run of shorter ones would never end.
MIN_STEP = 1e-10
_MIN_STEP_IN_LAYERS = 1e-15  # a layer of 1e-11 m is passed in a few steps of 1e-14 rad
# The force that is left out beyond a layer, K |y| exp(-2 eps |y|): within exp(-6) of the tolerance.
_TAIL = 6.0
_STRONGEST = 0.2785  # largest s / (1 + exp(s)): pull of a smoothed wall before it is met


@dataclass(frozen=True, slots=True)
class SceneTable:
    """Table of models for the kernel: all numbers of a point except initial state and times.

    Attributes
    ----------
    at : RowLayout
    table : ndarray, shape (n + 1, n_rows)
        Rows as the kernel reads them, the idle point last. Row `floor` of `at` is the size of the
        motion that the forcing maintains against all springs.
    rtol : float
        As in `scenes`.
    pieces : ndarray, shape (n_pieces, 1 + at.n * at.pieces)
        Loads by pieces of all systems, see `lanes.pieces`; without columns if there are none.
    """

    at: RowLayout
    table: Array
    rtol: float
    pieces: Array = field(default_factory=partial(np.empty, (0, 0)))


def scenes(
    zeta: Array,
    omega_n: Array,
    mass: Array,
    alpha: Array,
    forcing: Array,
    K_c: Array,
    j_1: Array,
    j_2: Array,
    omega: Array,
    K_ratio: Array,
    epsilon: Array | None = None,
    *,
    rtol: float,
    atol: Array | float,
) -> SceneTable:
    """Return the table of n oscillators, which `batch.run` integrates from initial states.

    Parameters
    ----------
    zeta, mass, alpha, forcing, K_c, K_ratio : ndarray, shape (n,)
        Damping ratio [-], mass [kg], cubic stiffness [N/m^3], forcing [N], stiffness of the upper
        wall [N/m], and that of the lower one over it [-].
    omega_n, omega : ndarray, shape (n,)
        Natural and forcing frequency [Hz], both > 0.
    j_1, j_2 : ndarray, shape (n,)
        Distances of the walls from the origin [m]; infinity: no wall.
    epsilon : ndarray, shape (n,), optional
        Convergence parameter [1/m] of contacts that are smoothed by tanh.
    rtol, atol : float, or of the latter an array, shape (n,)
        A step's error in velocity is kept below about `rtol` times the speed that the state's
        energy amounts to, in the gap or in contact, whichever springs hold it; that of a
        disturbance below a part of `rtol` of its size. `atol` [m] can only tighten: it is limited
        to ``1e-3 * rtol`` of the motion's natural size.
    """
    n_rad = 2 * np.pi * omega_n
    at = oscillator_layout(rtol, is_tanh=epsilon is not None)
    points, table = empty_table(at, len(zeta))
    table[at.stiffness], table[at.damping] = n_rad**2, 2 * zeta * n_rad
    table[at.cubic], table[at.push] = alpha / mass, forcing / mass
    table[at.lower], table[at.upper] = -j_1, j_2
    table[at.lower_stiffness], table[at.upper_stiffness] = K_ratio * K_c / mass, K_c / mass
    if epsilon is not None:
        table[at.sharpness] = 2.0 * epsilon
        table[at.layer] = (_TAIL - math.log(rtol)) / table[at.sharpness]
        table[at.is_near], table[at.longest] = 1.0, np.inf
    set_clock(at, table, omega)
    table[at.atol] = atol
    stiffnesses = table[at.lower_stiffness], table[at.upper_stiffness]
    table[at.floor] = np.minimum(*map(partial(_forced_size, at, table), (j_1, j_2), stiffnesses))
    if epsilon is not None:
        # An atol tighter than that of steps: the displacement due to the tail that is left out must
        # stay below it.
        least, stiffest = FLOOR_SHARE * rtol * table[at.floor], np.maximum(*stiffnesses)
        held = 2.0 * table[at.layer] * stiffest / (n_rad**2 * np.maximum(table[at.atol], 1e-300))
        wider = np.log(np.maximum(held, 1.0)) / table[at.sharpness]
        is_tighter = (table[at.atol] > 0.0) & (table[at.atol] < least)
        table[at.layer] = np.where(is_tighter, np.maximum(table[at.layer], wider), table[at.layer])
    table[at.rate] = np.sqrt(n_rad**2 + np.maximum(*stiffnesses)) + table[at.omega_rad]
    shortest = _MIN_STEP_IN_LAYERS if at.is_tanh else MIN_STEP
    table[at.min_step] = shortest / np.maximum(n_rad, table[at.omega_rad])
    return SceneTable(at, points, rtol)


def empty_table(at: RowLayout, n: int) -> tuple[Array, Array]:
    """Return a table for n models and the idle point, and a view of the models as columns."""
    points = np.zeros((n + 1, at.n_rows))
    table = points[:-1].T
    for i in range(at.n_states):
        table[at.tangent_state + i * (at.n_states + 1)] = 1.0
    _set_idle(at, points[-1])
    return points, table


def set_clock(at: RowLayout, table: Array, omega: Array) -> None:
    """Write frequency [Hz], angular frequency [rad/s] and period [s] into every column."""
    table[at.omega], table[at.omega_rad], table[at.period] = omega, 2 * np.pi * omega, 1.0 / omega


def check(**values: Array) -> None:
    """Refuse values that are not finite (`record_from`: no numbers); the error names the value."""
    for name, array in values.items():
        may_be_infinite = name == "record_from"
        is_bad = np.isnan(array) if may_be_infinite else ~np.isfinite(array)
        if is_bad.any():
            rule = "a number" if may_be_infinite else "finite"
            raise ValueError(f"{name} = {array[is_bad][0]}: must be {rule}")


def _forced_size(at: RowLayout, table: Array, to_wall: Array, contact: Array) -> Array:
    """Displacement [m] that the forcing maintains against the springs, and the wall if reached.

    A smoothed wall pushes too: without that a motion from rest would have no scale, and no step.
    """
    push = np.abs(table[at.push])
    if at.is_tanh:
        push = push + contact * (_STRONGEST / table[at.sharpness])
    cubic = np.cbrt(np.abs(table[at.cubic]) * push**2)
    springs = table[at.stiffness] + cubic + table[at.omega_rad] ** 2
    free = push / springs
    beyond = np.maximum(free - np.maximum(to_wall, 0.0), 0.0)
    return np.asarray(free - beyond * (contact / (springs + contact)))


def set_modes_on_walls(at: RowLayout, points: Array) -> None:
    """Set the contact modes of points that start on a wall.

    The first nonzero time derivative of the gap decides. It does not depend on this contact's mode
    as long as the lower ones are zero. If as many are zero as there are states, the contact stays
    on the wall, with the mode of the gap if there is one. A wall that may hold it does so from the
    first step on.

    Parameters
    ----------
    points : ndarray, shape (n, n_rows)
        Changed in place.
    """
    first = at.q if at.is_plain else at.gap
    for contact in range(at.contacts):
        gap, mode = points[:, first + contact], points[:, at.mode + contact]
        is_high = gap == points[:, at.upper + contact]
        is_low = gap == points[:, at.lower + contact]
        here = np.flatnonzero(is_high | is_low)
        if not here.size:
            continue
        slopes, has_gap = _slopes(at, points[here], contact), ~(is_high & is_low)[here]
        speed, bend = next(slopes), next(slopes)
        heading = np.sign(np.where(speed, speed, bend))
        for slope in slopes:
            if heading.all():
                break
            heading = np.where(heading == 0.0, np.sign(slope), heading)
        heading[(heading == 0.0) & ~has_gap] = 1.0
        if at.has_impacts:  # a rigid wall holds from the first step on if it does
            heading[points[here, at.rigid + contact] > 0.0] = 0.0
        if at.has_preload:
            change = points[here, at.preload + contact]
            change = change if at.is_plain else change * points[here, at.compliance + contact]
            may_hold = (change > 0.0) & (speed == 0.0) & (2.0 * np.abs(bend) <= change)
            heading[may_hold & has_gap] = 0.0
        mode[here] = (is_high[here] & (heading > 0.0)) * 1.0 - (is_low[here] & (heading < 0.0))


def _slopes(at: RowLayout, points: Array, contact: int) -> Iterator[Array]:
    """Yield the Taylor coefficients of a contact's gap from degree 1 on, as if out of contact."""

    def matrix(name: str, *shape: int) -> Array:
        block = slice(at.first[name], at.first[name] + at.blocks[name])
        return points[:, block].reshape(len(points), *shape)

    def series(name: str, size: int, multiple: str, phase: str, k: int) -> Array:
        """Taylor coefficient k of a sum of harmonics, with amplitudes in block `name`."""
        amplitudes = matrix(name, -1, size)
        multiples = matrix(multiple, -1) if at.blocks[multiple] else np.ones(amplitudes.shape[:2])
        turns = multiples * points[:, [at.tau]]
        turns = turns + matrix(phase, -1) if at.blocks[phase] else turns
        cosine, sine = _cos_sin_of_period(turns)
        rates = (multiples * points[:, [at.omega_rad]]) ** k / math.factorial(k)
        factors = rates * (cosine, -sine, -cosine, sine)[k % 4]
        return np.asarray(np.einsum("ph,phi->pi", factors, amplitudes))

    n, m, c = at.n, at.m, at.contacts
    ones = np.ones((len(points), 1, 1))
    direction = ones if at.is_plain else matrix("direction", c, n)
    along = ones if at.is_plain else matrix("along", at.cubics, n)
    pull = ones if at.is_plain else matrix("pull", n, c)
    mode = matrix("mode", c).copy()
    mode[:, contact] = 0.0
    # finite: a wall at infinity is never touched
    is_on = [mode == ON, mode == -ON]
    places = ("upper_rest", "lower_rest") if at.has_preload else ("upper", "lower")
    rest = np.select(is_on, [matrix(name, c) for name in places], 0.0)
    stiffnesses = [matrix("upper_stiffness", c), matrix("lower_stiffness", c)]
    spring = np.select(is_on, stiffnesses, 0.0)
    damper = np.abs(mode) == ON
    damper = damper * matrix("contact_damping", c) if at.is_damped else 0.0 * damper
    q, z = [matrix("q", n), matrix("v", n)], [matrix("z", m)]
    yield _along(direction, q[1])[:, contact]
    depths, bends, rates = [], [], []
    with np.errstate(over="ignore", invalid="ignore"):  # such a motion diverges in the kernel
        for k in range(2 * at.n_states - 1):
            depths.append(_along(direction, q[k]) - (rest if k == 0 else 0.0))
            bends.append(_along(along, q[k]))
            rates.append(np.full_like(spring, float(k == 0)))
            if at.modulations:
                rates[k] += series("depth", c, "depth_multiple", "depth_phase", k)
            force = series("push", n, "multiple", "phase", k) if at.harmonics else 0.0
            force = force + (_of_pieces(at, points, k) if at.pieces else 0.0)
            force = force - _along(matrix("damping", n, n), (k + 1) * q[k + 1])
            force = force - _along(matrix("stiffness", n, n), q[k])
            force = force - _along(matrix("lag_force", n, m), z[k])
            cubes = _convolved(_convolved(bends, bends, k, whole=True), bends, k)
            force = force - np.einsum("pji,pj->pi", matrix("cubic", at.cubics, n), cubes[0])
            pressed = spring * _convolved(rates, depths, k)[0]
            pressed = pressed + damper * (k + 1) * _along(direction, q[k + 1])
            force = force - _along(pull, pressed)
            q.append(force / ((k + 1) * (k + 2)))
            yield _along(direction, q[-1])[:, contact]
            new = _along(matrix("of_speed", m, n), (k + 1) * q[k + 1])
            new = new + _along(matrix("of_place", m, n), q[k])
            z.append((new + _along(matrix("of_lag", m, m), z[k])) / (k + 1))


def _of_pieces(at: RowLayout, points: Array, k: int) -> Array:
    """Taylor coefficient k of the loads by pieces at the beginning of motions, by coordinate."""
    turns = points[:, [at.tau]] - points[:, [at.knot_tau]] - points[:, [at.knot_cycle]]
    since, found = turns * points[:, [at.period]], np.zeros((len(points), at.n))
    for j in range(k, at.pieces):
        terms = points[:, at.piece + j : at.piece + at.n * at.pieces : at.pieces]
        found += math.comb(j, k) * since ** (j - k) * terms
    return found


def _convolved(a: list[Array], b: list[Array], k: int, *, whole: bool = False) -> list[Array]:
    """List of coefficient k of a product of series; with `whole`, of all coefficients up to k."""
    wanted = range(k + 1) if whole else (k,)
    return [np.sum([a[i] * b[j - i] for i in range(j + 1)], axis=0) for j in wanted]


def _along(directions: Array, vectors: Array) -> Array:
    """Projections, shape (n, k), of vectors, shape (n, m), on directions, shape (n, k, m)."""
    return np.asarray(np.einsum("pij,pj->pi", directions, vectors))


def _cos_sin_of_period(tau: Array) -> tuple[Array, Array]:
    """cos and sin of 2 pi tau, exactly 0 or 1 at quarter periods as in the kernel."""
    quarter = np.rint(4 * tau)
    angle = (4 * tau - quarter) * (np.pi / 2)
    z = np.exp(1j * angle) * np.array([1, 1j, -1, -1j])[quarter.astype(int) % 4]
    return z.real, z.imag


def _set_idle(at: RowLayout, point: Array) -> None:
    """Set the idle point, at rest without forcing or end, for lanes without a point."""
    point[[at.omega, at.period, at.floor, at.rate, at.atol]] = 1.0
    point[at.lower : at.lower + at.contacts] = -1.0
    point[at.upper : at.upper + at.contacts] = 1.0
    if not at.is_plain:
        point[at.slow] = 1.0
    if at.is_tanh:
        point[at.sharpness], point[at.longest] = 1.0, np.inf
    point[[at.record_clock, at.event_clock]] = np.inf
    # No motion gets there. It is finite, so that its products with zeros of pieces are zero.
    point[at.end_cycle] = 1e300
    if at.pieces:
        point[[at.last_cycle, at.knot_cycle]] = 1e300
