"""Motions of the reference engine as piecewise polynomials; their extrema, roots and sections."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import OdeSolution
from scipy.interpolate import PPoly

from gapsweep.integrate.reference_scenes import OscillatorScene, ReferenceScene

Array = NDArray[np.float64]

# A polynomial of this degree reproduces the dense output of both methods exactly.
_DEGREE = 7
_NODES = 0.5 - 0.5 * np.cos(np.pi * np.arange(_DEGREE + 1) / _DEGREE)
_TO_POWERS = np.linalg.inv(np.vander(_NODES, _DEGREE + 1))
_STILL = 64.0 * np.finfo(float).eps  # of a state: a step with a smaller change is a straight line


def gap_of(scene: ReferenceScene, motion: PPoly, contact: int) -> PPoly:
    """Return a contact's gap and its rate along a motion."""
    n, direction = scene.n, scene.directions[contact]
    parts = [motion.c[:, :, i * n : (i + 1) * n] @ direction for i in (0, 1)]
    return PPoly.construct_fast(np.stack(parts, axis=-1), motion.x)


def resting(t: float, y: Array) -> PPoly:
    """Return a motion that stays in state `y`, from `t` to the next float."""
    powers = np.zeros((_DEGREE + 1, 1, len(y)))
    powers[-1] = y
    return PPoly.construct_fast(powers, np.array([t, np.nextafter(t, math.inf)]))


def polynomial(solution: OdeSolution) -> PPoly:
    """Return the dense output of `solve_ivp` as one piecewise polynomial of the state."""
    breaks = np.asarray(solution.ts)
    nodes = breaks[:-1, None] + np.diff(breaks)[:, None] * _NODES
    # Shared step ends belong to the step on their left or right: both give the same value.
    values = solution(nodes.ravel()).reshape(-1, len(breaks) - 1, _DEGREE + 1)
    return _through(breaks, values)


def sampled(motion: PPoly, value: Callable[[float, Array], float]) -> PPoly:
    """Return a function of time and state along a motion, and its rate, as polynomials."""
    nodes = motion.x[:-1, None] + np.diff(motion.x)[:, None] * _NODES
    values = np.array([[value(t, motion(t)) for t in row] for row in nodes.tolist()])
    powers = _through(motion.x, values[None]).c[:, :, 0]
    rates = np.zeros_like(powers)
    rates[1:] = PPoly.construct_fast(powers, motion.x).derivative().c
    return PPoly.construct_fast(np.stack([powers, rates], axis=-1), motion.x)


def _through(breaks: Array, values: Array) -> PPoly:
    """Polynomials through values at the nodes, shape (n_components, n_pieces, n_nodes)."""
    h = np.diff(breaks)
    powers = np.einsum("pn,ysn->psy", _TO_POWERS, values)
    # A motion that begins next to a wall by rounding reaches it in nearly no time: the higher
    # coefficients are rounding errors over powers of that time.
    still = np.maximum(_STILL * np.abs(values).max(axis=2), np.finfo(float).tiny)
    is_straight = (np.ptp(values, axis=2) <= still).all(axis=0)
    is_straight |= h <= 64.0 * np.spacing(np.abs(breaks[1:]))
    powers[:-2, is_straight] = 0.0
    powers[-2, is_straight] = (values[:, is_straight, -1] - values[:, is_straight, 0]).T
    scale = np.where(is_straight, 1.0, h)[:, None] ** np.arange(_DEGREE, -1, -1)
    scale[is_straight, -2] = h[is_straight]
    powers /= scale.T[:, :, None]
    return PPoly.construct_fast(powers, breaks)


def joined(pieces: list[PPoly]) -> PPoly:
    coefficients = np.concatenate([piece.c for piece in pieces], axis=1)
    breaks = np.concatenate([pieces[0].x[:1], *(piece.x[1:] for piece in pieces)])
    return PPoly.construct_fast(coefficients, breaks)


def roots(motion: PPoly, component: int, value: float) -> Array:
    """Times after the initial one at which a component of a motion takes a value."""
    single = PPoly.construct_fast(np.ascontiguousarray(motion.c[:, :, component]), motion.x)
    roots = np.sort(single.solve(value, discontinuity=False, extrapolate=False))
    roots = roots[np.isfinite(roots)]
    # A root at a step end is reported by both steps; an initial root is not counted.
    resolution = 1e-9 * float(np.min(np.diff(motion.x)))
    after_start = np.diff(roots, prepend=motion.x[0]) > resolution
    return np.asarray(roots[after_start])


def turning(scene: ReferenceScene, motion: PPoly) -> list[PPoly]:
    """Return the quantities whose extrema are recorded, with rates: coordinates, system gaps."""
    n = scene.n
    coordinates = [
        PPoly.construct_fast(motion.c[:, :, i : n + i + 1 : n], motion.x) for i in range(n)
    ]
    gaps = [] if isinstance(scene, OscillatorScene) else range(len(scene.laws))
    return coordinates + [gap_of(scene, motion, contact) for contact in gaps]


def extrema_of(motion: PPoly) -> tuple[Array, Array]:
    """Times and values of a quantity where its rate is zero; components are value and rate."""
    t = roots(motion, 1, 0.0)
    return t, motion(t)[:, 0] if t.size else t


def section_of(
    motion: PPoly, scene: ReferenceScene, since: float, t_end: float
) -> tuple[Array, Array]:
    """Times and states at every whole forcing period, from the time `since` on.

    The section of an unforced motion is at the maxima of its first coordinate.
    """
    if scene.omega:
        phase = scene.theta_0 / (2.0 * math.pi)
        last = math.floor(scene.omega * t_end + phase + 1e-9)
        t = (np.arange(math.floor(phase + 1e-9) + 1, last + 1) - phase) / scene.omega
    else:
        t = roots(motion, scene.n, 0.0)
        t = t[motion(t, 1)[:, scene.n] < 0.0] if t.size else t
    t = np.minimum(t[t >= since], t_end)
    states = np.asarray(motion(t)).reshape(t.size, motion.c.shape[2])[:, : scene.n_states]
    if not scene.omega:
        states[:, scene.n] = 0.0  # to the last bit: the next motion begins here
    return t, states
