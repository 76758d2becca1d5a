"""The equation of motion written out and solved by scipy's DOP853: an oracle for one motion.

Contact forces are written from their formulas. Where a force has a kink, the integration ends and
begins again. No code of the engines is used.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.polynomial.chebyshev import chebval
from scipy.integrate import quad, solve_ivp
from scipy.interpolate import PchipInterpolator

import gapsweep as gs

W = 2.0 * math.pi


Force = Callable[[float], float]


def _switched(switch: Force) -> Callable[[Any], Force]:
    def force_of(law: Any) -> Force:
        def force(x: float) -> float:
            below, above = x + law.gap.j_1, x - law.gap.j_2
            lower = law.K_ratio * (1.0 - switch(law.epsilon * below)) * below
            return 0.5 * law.K_c * (lower + (1.0 + switch(law.epsilon * above)) * above)

        return force

    return force_of


def _logarctan(law: Any) -> Force:
    low, high, ratio, gamma = law.gap.j_1, law.gap.j_2, law.K_ratio, law.gamma

    def integral(u: float) -> float:
        return u * math.atan(gamma * u) - math.log1p((gamma * u) ** 2) / (2.0 * gamma)

    def force(x: float) -> float:
        angles = integral(x - high) - integral(-high) - ratio * (integral(x + low) - integral(low))
        return law.K_c * (0.5 * (1.0 + ratio) * x + angles / math.pi)

    return force


def _fitted(law: Any) -> Force:
    top, bottom = law.coefficients
    return lambda x: float(chebval(x / law.fit_range, top) / chebval(x / law.fit_range, bottom))


def _piecewise(law: Any) -> Force:
    low, high, ratio = law.gap.j_1, law.gap.j_2, law.K_ratio
    return lambda x: law.K_c * (max(x - high, 0.0) + ratio * min(x + low, 0.0))


FORCES = {
    gs.Piecewise: _piecewise,
    gs.Tanh: _switched(math.tanh),
    gs.Arctan: _switched(lambda z: 2.0 / math.pi * math.atan(z)),
    gs.LogArctan: _logarctan,
    gs.Polynomial: _fitted,
    gs.RationalPolynomial: _fitted,
    gs.ForceTable: lambda law: PchipInterpolator(law.x, law.F),
    gs.UserLaw: lambda law: law.function,
}


def force_of(law: Any, mode: int | None) -> Force:
    """The contact force; of a wall (-1, 1) or the gap (0) alone, as if the others were not."""
    if mode is None:
        return FORCES[type(law)](law)
    stiffness = law.K_c * {1: 1.0, 0: 0.0, -1: law.K_ratio}[mode]
    wall = law.gap.j_2 if mode > 0 else -law.gap.j_1
    return lambda x: stiffness * (x - wall)


@dataclass
class Motion:
    """Times of wall crossings by contact; times and values of extrema by coordinate; the motion."""

    t_contacts: list[Any]
    t_extrema: list[Any]
    extrema: list[Any]
    pieces: list[Any]

    def __call__(self, t: float) -> Any:
        """State (q, v, z) at a time."""
        return next(sol for end, sol in self.pieces if t <= end)(t)


def laws_of(model, law):
    """The contact laws of a model, in the order of its contacts."""
    if not isinstance(law, Mapping):
        return (law,) * len(model.contacts)
    return tuple(law[name] for name in model.contacts)


class Equation:
    """M q'' + C q' + K q + cubes + contacts + D z = loads and z' = E q' + G q + H z, as numbers."""

    def __init__(self, model: Any, laws: Any, omega: float | None) -> None:
        self.laws, self.rate = tuple(laws), W * (omega or 0.0)
        if isinstance(model, gs.Oscillator):
            w_n, m = W * model.omega_n, model.mass
            self.M, self.K = np.array([[m]]), np.array([[m * w_n**2]])
            self.C = np.array([[2.0 * model.zeta * w_n * m + model.c]])
            one = np.ones(1)
            self.directions, self.cubes, self.terms = [one], [(one, model.alpha)], [[]]
            self.loads = [(model.forcing * one, 1, 0.0), (model.mean_load * one, 0, 0.0)]
            # An unbalance, and a base y = a cos(W t): -m y'', and -c y' of damping to the ground.
            a, to_ground = model.base_amplitude, (1.0 - model.base_damping) * self.C[0]
            self.loads.append(((model.unbalance + m * a) * self.rate**2 * one, 1, 0.0))
            self.loads.append((to_ground * a * self.rate, 1, -0.25 * W))
            lags = None
        else:
            self.M, self.C, self.K = model.mass, model.damping, model.stiffness
            self.directions = list(model.contacts.values())
            self.cubes = [(each.along, each.alpha) for each in model.cubic]
            self.terms = [model.modulation.get(name, ()) for name in model.contacts]
            self.loads = [
                (h.amplitude * (h.k * self.rate) ** h.power, h.k, h.phase) for h in model.forcing
            ]
            lags = model.lags
        self.n, self.inverse = len(self.M), np.linalg.inv(self.M)
        self.D = np.zeros((self.n, 0)) if lags is None else lags.force
        shape = (0, 2 * self.n)
        self.lags = (
            np.zeros(shape)
            if lags is None
            else np.hstack([lags.of_place, lags.of_speed, lags.of_lags])
        )

    @property
    def trace(self) -> float:
        """Rate at which volumes of states grow, whatever the contacts do [1/s]."""
        own = self.lags[:, 2 * self.n :]
        return float(np.trace(own) - np.trace(self.inverse @ self.C))

    def energy(self, y: Any) -> float:
        """Energy of masses, springs and contacts [J]; conserved without damping and loads."""
        q, v = y[: self.n], y[self.n : 2 * self.n]
        energy = 0.5 * v @ self.M @ v + 0.5 * q @ self.K @ q
        energy += sum(0.25 * alpha * (a @ q) ** 4 for a, alpha in self.cubes)
        for law, b in zip(self.laws, self.directions, strict=True):
            kinks = sorted({0.0, *np.clip(law.walls, *sorted([0.0, b @ q])).tolist(), b @ q})
            parts = [quad(force_of(law, None), *ends, epsabs=0.0)[0] for ends in pairwise(kinks)]
            energy += sum(parts) if b @ q > 0.0 else -sum(parts)
        return float(energy)

    def load(self, t: Any) -> Any:
        """Generalised forces [N], along the last axis."""
        parts = [
            np.multiply.outer(np.cos(k * self.rate * t + phase), p) for p, k, phase in self.loads
        ]
        return sum(parts, np.zeros(self.n))

    def power(self, t: Any, y: Any) -> Any:
        """Power of loads and damping [W] at times `t` with states `y`."""
        v = y[..., self.n : 2 * self.n]
        return np.sum(v * (self.load(t) - v @ self.C.T), axis=-1)

    def rates(self, modes: Any) -> Callable[[float, Any], Any]:
        """The right-hand side with the contacts in some modes."""
        forces = [force_of(*pair) for pair in zip(self.laws, modes, strict=True)]

        def rhs(t: float, y: Any) -> Any:
            q, v, z = np.split(y, [self.n, 2 * self.n])
            push = self.load(t) - self.C @ v - self.K @ q - self.D @ z
            for a, alpha in self.cubes:
                push = push - alpha * (a @ q) ** 3 * a
            for force, b, terms in zip(forces, self.directions, self.terms, strict=True):
                share = sum(m.depth * math.cos(m.k * self.rate * t + m.phase) for m in terms)
                push = push - (1.0 + share) * force(b @ q) * b
            return np.concatenate([v, self.inverse @ push, self.lags @ y])

        return rhs

    def motion(self, start: Any, t_end: float) -> Motion:
        """Motion from a state strictly inside the gaps or the walls, in at least 400 steps.

        Contacts without a gap pass both walls at once.
        """
        t, y, walls = 0.0, np.array(start, float), [law.walls for law in self.laws]
        gaps = [b @ y[: self.n] for b in self.directions]
        modes: list[Any] = [
            int(g > high) - int(g < low) if isinstance(law, gs.Piecewise) else None
            for g, (low, high), law in zip(gaps, walls, self.laws, strict=True)
        ]
        contacts: list[list[float]] = [[] for _ in modes]
        turns: list[list[Any]] = [[] for _ in range(self.n)]
        pieces = []
        while True:
            ways = []
            for i, mode in enumerate(modes):
                both = {1: walls[i][1], -1: walls[i][0]}
                if mode is None:
                    ways += [(i, wall, 0) for wall in sorted(set(both.values()))]
                else:
                    ways += [(i, both[s], -s if mode else s) for s in ([mode] if mode else (1, -1))]
            events = [self._margin(*way) for way in ways]
            events += [self._speed(i) for i in range(self.n)]
            run = solve_ivp(
                self.rates(modes), (t, t_end), y, "DOP853", events=events, dense_output=True,
                rtol=1e-13, atol=1e-17 + 1e-13 * np.abs(y).max(), max_step=t_end / 400.0,
            )  # fmt: skip
            pieces.append((run.t[-1], run.sol))
            for i, (times, states) in enumerate(
                zip(run.t_events[len(ways) :], run.y_events[len(ways) :], strict=True)
            ):
                turns[i] += [(at, state[i]) for at, state in zip(times, states, strict=True)]
            for (i, _, direction), times in zip(ways, run.t_events, strict=False):
                is_closed = walls[i][0] == walls[i][1]
                contacts[i] += [*times] * (2 if is_closed else 1)
                if direction and times.size:
                    modes[i] = direction if is_closed or not modes[i] else 0
            t, y = run.t[-1], run.y[:, -1]
            if run.status == 0:
                found = [np.reshape(sorted(each), (-1, 2)).T for each in turns]
                return Motion(
                    [np.sort(each) for each in contacts],
                    [at for at, _ in found],
                    [values for _, values in found],
                    pieces,
                )

    def _margin(self, contact: int, wall: float, direction: int) -> Callable[[float, Any], float]:
        def margin(t: float, y: Any) -> float:
            return float(self.directions[contact] @ y[: self.n] - wall)

        margin.terminal, margin.direction = bool(direction), direction
        return margin

    def _speed(self, i: int) -> Callable[[float, Any], float]:
        return lambda t, y: float(y[self.n + i])
