"""Rows of systems for the kernel: their matrices per unit mass, and the scales of step errors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gapsweep.model.system import System, fraction
from gapsweep.model.waves import N_TERMS

from .row_layout import RowLayout
from .scene_table import (
    MIN_STEP,
    SceneTable,
    empty_table,
    set_clock,
)

Array = NDArray[np.float64]
# Writes the rows of one block.
Put = Callable[[str, Array], None]

# An eigenvalue of the springs below this part of the largest is zero: a rigid-body mode.
_LOOSE = 1e-12


@dataclass(frozen=True, slots=True)
class Walls:
    """The contacts of some points, arrays of shape (n_points, n_contacts)."""

    K_c: Array  # stiffness of the upper walls [N/m]
    K_ratio: Array  # stiffness of the lower walls over that of the upper ones [-]
    # `j_1`, `j_2`: distances of the walls from the origin [m]; infinity: no wall.
    j_1: Array
    j_2: Array


def layout_of(system: System) -> RowLayout:
    """Return the row layout of a system."""
    terms = sum(map(len, system.modulation.values()))
    return RowLayout(
        n=system.n,
        m=system.n_lags,
        contacts=len(system.contacts),
        cubics=len(system.cubic),
        harmonics=len(system.harmonics),
        modulations=terms,
        pieces=N_TERMS if system.waves else 0,
        is_plain=False,
        is_free=not system.is_forced,
    )


def system_scenes(
    systems: Sequence[System],
    which: NDArray[np.intp],
    walls: Walls,
    omega: Array,
    *,
    rtol: float,
    atol: Array | float,
) -> SceneTable:
    """Return the table of n points of systems, which `batch.run` integrates from initial states.

    Parameters
    ----------
    systems : sequence of System
        All of one layout.
    which : ndarray of int, shape (n,)
        The system of each point.
    omega : ndarray, shape (n,)
        Forcing frequency [Hz]; 0 if unforced: the clock then counts periods of the slowest mode.
    rtol, atol
        As in `scenes`; errors are measured in the mass norm, ``v'Mv``.
    """
    (layout,) = {layout_of(system) for system in systems}
    at = layout.with_degree(rtol)
    points, table = empty_table(at, len(which))
    stiffnesses = walls.K_ratio * walls.K_c, walls.K_c
    pieces, n_pieces = [], 0
    for number, system in enumerate(systems):
        here = np.flatnonzero(which == number)
        stiffest, linear = np.maximum(*stiffnesses)[here], _Linear(system)
        _fill(at, points, here, linear, stiffest, omega[here])
        if at.pieces:
            pieces.append(pieces_of(system, linear.inverse))
            rows = n_pieces, n_pieces + len(pieces[-1]), any(not load.k for load in system.waves)
            points[here[:, None], [at.first_piece, at.no_piece, at.is_record]] = rows
            n_pieces = rows[1]
    blocks = at.lower, at.upper, at.lower_stiffness, at.upper_stiffness
    for block, values in zip(blocks, (-walls.j_1, walls.j_2, *stiffnesses), strict=True):
        table[block : block + at.contacts] = values.T
    table[at.atol] = atol
    if pieces:
        return SceneTable(at, points, rtol, np.concatenate(pieces))
    return SceneTable(at, points, rtol)


def pieces_of(system: System, inverse: Array) -> Array:
    """Return the loads by pieces of a system, per unit mass, as rows of `SceneTable.pieces`.

    Loads with different knots are joined: the pieces end at the knots of all.
    """
    loads = system.waves
    ends = np.unique(np.concatenate([load.wave.table[0] for load in loads]))
    found = np.zeros((len(ends), 1 + system.n * N_TERMS))
    found[:, 0] = ends
    for load in loads:
        own_ends, coefficients = load.wave.table
        piece = np.searchsorted(own_ends, ends)
        shift = (
            np.where(np.isfinite(ends), ends, 0.0)
            - np.where(np.isfinite(own_ends), own_ends, 0.0)[piece]
        )
        terms = _shifted(coefficients[piece], shift)
        along = inverse @ load.amplitude
        found[:, 1:] += (along[:, None] * terms[:, None, :]).reshape(len(ends), -1)
    return found


def _shifted(coefficients: Array, shift: Array) -> Array:
    """Coefficients of polynomials, shape (n, N_TERMS), by powers of a time that begins later."""
    terms = coefficients.copy()
    for low in range(N_TERMS - 1):
        for k in range(N_TERMS - 2, low - 1, -1):
            terms[:, k] += terms[:, k + 1] * shift
    return terms


class _Linear:
    """Linear part of a system in its mass norm.

    Attributes
    ----------
    inverse : ndarray, shape (n, n)
        Inverse of the mass matrix.
    mass_root, spring_root : ndarray, shape (n, n)
        R and S with R'R = M and S'S = \\|K\\|, the springs with the moduli of their eigenvalues.
    slowest : float
        Smallest natural frequency that is not zero [rad/s]; 1 if there is none.
    """

    def __init__(self, system: System) -> None:
        self.system = system
        self.inverse = np.linalg.inv(system.mass)
        self.mass_root = np.linalg.cholesky(system.mass).T
        unroot = np.linalg.inv(self.mass_root)
        springs = unroot.T @ (0.5 * (system.stiffness + system.stiffness.T)) @ unroot
        squares, modes = np.linalg.eigh(springs)
        squares = np.abs(squares)
        self.spring_root = np.sqrt(squares)[:, None] * (modes.T @ self.mass_root)
        held = squares > _LOOSE * squares.max(initial=0.0)
        self.slowest = float(np.sqrt(squares[held].min())) if held.any() else 1.0
        self.decay = float(np.linalg.norm(unroot.T @ system.damping @ unroot, 2))
        self.unroot = unroot

    def holding(self, direction: Array) -> float:
        """Stiffness [N/m] of the springs against a force along a direction; 0: rigid-body mode."""
        bent, _, rank, _ = np.linalg.lstsq(self.spring_root.T, direction, rcond=1e-6)
        if rank < self.system.n:
            return 0.0
        return 1.0 / float(bent @ bent)


def _fill(
    at: RowLayout,
    points: Array,
    here: NDArray[np.intp],
    linear: _Linear,
    stiffest: Array,
    omega: Array,
) -> None:
    """Write the rows of one system's points except walls; `stiffest` is the stiffest wall [N/m]."""
    system, inverse = linear.system, linear.inverse
    table = np.zeros((at.n_rows, len(here)))

    def put(block: str, values: Array) -> None:
        if n := at.blocks[block]:
            table[at.first[block] : at.first[block] + n] = np.reshape(values, (n, -1))

    put("stiffness", inverse @ system.stiffness)
    put("damping", inverse @ system.damping)
    put("mass_root", linear.mass_root)
    put("spring_root", linear.spring_root)
    directions = system.directions
    compliance = np.einsum("ki,ij,kj->k", directions, inverse, directions)
    put("direction", directions)
    put("pull", inverse @ directions.T)
    put("compliance", compliance)
    along = np.array([each.along for each in system.cubic]).reshape(-1, system.n)
    alpha = np.array([each.alpha for each in system.cubic])
    put("along", along)
    put("alpha", alpha)
    put("cubic", (inverse @ along.T * alpha).T)
    put("softness", np.einsum("ki,ij,kj->k", along, inverse, along))
    put("holding", np.array([linear.holding(a) for a in along]))
    fastest = 2.0 * np.pi * system.fastest
    clock = np.where(omega > 0.0, omega, linear.slowest / (2.0 * np.pi))
    set_clock(at, table, clock)
    _put_loads(at, table, put, linear)
    # In the mass norm of errors the forced motion of a light part hardly counts.
    highest = max([load.k for load in system.forcing], default=0) * table[at.omega_rad]
    table[at.fastest] = np.maximum(fastest, highest) ** 2
    table[at.decay] = linear.decay
    lightest = float(np.sqrt(np.diag(system.mass).min()))
    table[at.slow] = linear.slowest * lightest
    table[at.rate] = np.sqrt(fastest**2 + (stiffest * compliance).sum(axis=1)) + highest
    table[at.min_step] = MIN_STEP / np.maximum(fastest, table[at.omega_rad])
    if system.lags is not None:
        _put_lags(put, linear)
    tangent = slice(at.tangent_state, at.tangent_state + at.n_states**2)
    table[tangent] = points[here].T[tangent]
    points[here] = table.T


def _put_loads(at: RowLayout, table: Array, put: Put, linear: _Linear) -> None:
    """Write forcing, periodic stiffness, and the speed that the forcing maintains."""
    system = linear.system
    omega_rad, speed = table[at.omega_rad], np.zeros(table.shape[1])
    for load in system.forcing:
        growth = load.growth(omega_rad)
        force = float(np.linalg.norm(linear.unroot.T @ load.amplitude))
        speed += force * growth / (load.k * omega_rad + linear.slowest)
    table[at.floor] = speed
    harmonics = system.harmonics
    pushes = [np.outer(linear.inverse @ x.amplitude, x.growth(omega_rad)) for x in harmonics]
    put("push", np.array(pushes))
    put("multiple", np.array([float(load.k) for load in harmonics]))
    put("phase", np.array([fraction(load.phase) for load in harmonics]))
    names = list(system.contacts)
    terms = [(names.index(name), m) for name, ms in system.modulation.items() for m in ms]
    for i, (contact, term) in enumerate(terms):
        table[at.depth + i * at.contacts + contact] = term.depth
        table[at.depth_multiple + i] = term.k
        table[at.depth_phase + i] = fraction(term.phase)


def _put_lags(put: Put, linear: _Linear) -> None:
    lags = linear.system.lags
    assert lags is not None, "called only for systems with lags"
    put("lag_force", linear.inverse @ lags.force)
    put("of_speed", lags.of_speed)
    put("of_place", lags.of_place)
    put("of_lag", lags.of_lags)
    driven = np.abs(lags.of_place).max(axis=1) + linear.slowest * np.abs(lags.of_speed).max(axis=1)
    rates = np.maximum(np.abs(np.linalg.eigvals(lags.of_lags)).max(), linear.slowest)
    put("lag_floor", driven / rates)
