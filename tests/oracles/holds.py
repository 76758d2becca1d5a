"""Walls that hold several contacts at once: series of linear flows, and a search of all modes.

The equation is M q'' + C q' + K q + sum b N = F_0 + F_1 cos(omega t), with the depths
d = b.q - place of walls on one side and their rates u. Between events the motion is linear; its
Taylor series is exact to rounding. At an event rigid walls reverse speeds, one after the other.
Contacts at rest on their walls then have the modes that nothing violates in the next moment: a
contact leaves to its side, and forces of holds are within their limits. All combinations are tried.
B'M^-1 B of independent contacts is positive definite, so that there is one. No code of the engines
is used.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval

from tests.oracles.lossy_contacts import HOLD, OFF, ON, Wall

Real = np.longdouble
N_TERMS = 26  # of a series; a step is at most the inverse of the fastest rate
SLOW = 1e-11  # m/s: slower bodies rest on a wall
ZERO = 1e-11  # of the largest term: a derivative that is zero
_SAMPLES = np.linspace(0.0, 1.0, 65)


@dataclass
class Motion:
    """Parts (t, length, series of the state, modes) of a motion, and its end state."""

    parts: list[tuple[float, float, Any, tuple[int, ...]]] = field(default_factory=list)
    y: Any = None

    def holds(self) -> list[tuple[int, float, float]]:
        """Wall, beginning and end of every hold; the end is infinite for the last ones."""
        found, begun = [], {}
        for t, _, _, modes in self.parts:
            for k, mode in enumerate(modes):
                if mode == HOLD:
                    begun.setdefault(k, t)
                elif k in begun:
                    found.append((k, begun.pop(k), t))
        return found + [(k, t, math.inf) for k, t in begun.items()]


@dataclass
class Held:
    """A system with walls that hold: rigid ones, and others with a preload that may pull."""

    M: Any
    C: Any
    K: Any
    F_0: Any
    F_1: Any
    omega: float
    walls: Sequence[Wall]

    def __post_init__(self) -> None:
        self.n = len(self.M)
        self.inverse = _inverse(np.asarray(self.M, Real))
        self.b = np.array([wall.b for wall in self.walls], Real)
        self.places = np.array([wall.place for wall in self.walls], Real)
        self._flows: dict[tuple[int, ...], Any] = {}

    def run(self, q_0: Sequence[float], v_0: Sequence[float], t_end: float) -> Motion:
        """Motion from a state within the walls or on them."""
        n, run, t, modes = self.n, Motion(), Real(0.0), (OFF,) * len(self.walls)
        z = np.concatenate([q_0, v_0, [1.0, 0.0, 1.0]]).astype(Real)  # cos, sin, 1 of the loads
        on = {k for k in range(len(modes)) if abs(self.b[k] @ z[:n] - self.places[k]) < 1e-13}
        z, modes = self._event(z, modes, on)
        while t < t_end:
            series = self._series(z, modes)
            longest = h = min(1.0 / self._flow(modes)[2], Real(t_end) - t)
            hit = None
            for k, row, is_depth in self._watched(modes):
                p, size = series @ row, np.abs(row) @ np.abs(z)
                is_zero = k in on if is_depth else abs(p[0]) <= 1e-15 * size
                root = _first_zero(p, longest, is_zero, size)
                if root is not None and root < h:
                    h, hit = root, (k, is_depth)
            run.parts.append((float(t), float(h), series, modes))
            z, t = h ** np.arange(N_TERMS) @ series, t + h
            turned = Real(self.omega) * t
            z[-3:] = np.cos(turned), np.sin(turned), 1.0
            on = {k for k, mode in enumerate(modes) if mode == HOLD}
            if hit is None:
                z = self._stopped(z, modes)
                continue
            k, is_depth = hit
            if is_depth:
                on.add(k)
                off = self.b[k] @ z[:n] - self.places[k]
                z[:n] -= off * (self.inverse @ self.b[k]) / (self.b[k] @ self.inverse @ self.b[k])
            z, modes = self._event(z, modes, on)
        run.y = z[: 2 * n].astype(float)
        return run

    def _flow(self, modes: tuple[int, ...]) -> tuple[Any, dict[int, Any], Any]:
        """Matrix of z' = A z, rows of the forces of holds by wall, and the fastest rate."""
        if modes not in self._flows:
            n, b = self.n, self.b
            a = np.zeros((n, 2 * n + 3), Real)
            a[:, :n], a[:, n : 2 * n] = -np.asarray(self.K, Real), -np.asarray(self.C, Real)
            a[:, -3], a[:, -1] = self.F_1, self.F_0
            for k, mode in enumerate(modes):
                if mode == ON:
                    wall, force = self.walls[k], self.walls[k].k * self._depth(k)
                    force[n : 2 * n] += wall.c * b[k]
                    force[-1] += wall.preload
                    a -= np.outer(b[k], force)
            a = self.inverse @ a
            held = [k for k, mode in enumerate(modes) if mode == HOLD]
            pull = self.inverse @ b[held].T
            rows = _inverse(b[held] @ pull) @ (b[held] @ a)
            rates = np.zeros((2 * n + 3, 2 * n + 3), Real)
            rates[:n, n : 2 * n], rates[n : 2 * n] = np.eye(n), a - pull @ rows
            rates[-3, -2], rates[-2, -3] = -self.omega, self.omega
            rate = max(np.abs(np.linalg.eigvals(rates.astype(float))).max(), 0.5)
            self._flows[modes] = rates, dict(zip(held, rows, strict=True)), Real(rate)
        return self._flows[modes]

    def _depth(self, k: int) -> Any:
        return np.concatenate([self.b[k], np.zeros(self.n + 2, Real), [-self.places[k]]])

    def _series(self, z: Any, modes: tuple[int, ...]) -> Any:
        terms = [z]
        for j in range(1, N_TERMS):
            terms.append(self._flow(modes)[0] @ terms[-1] / j)
        return np.array(terms)

    def _watched(self, modes: tuple[int, ...]) -> list[tuple[int, Any, bool]]:
        """Walls, rows that stay positive in these modes, and whether they are depths."""
        found, forces = [], self._flow(modes)[1]
        for k, (wall, mode) in enumerate(zip(self.walls, modes, strict=True)):
            if mode == HOLD:
                found.append((k, forces[k], False))
                if wall.e is None:
                    most = np.zeros(2 * self.n + 3, Real)
                    most[-1] = wall.preload
                    found.append((k, most - forces[k], False))
            else:
                found.append((k, self._depth(k) if mode == ON else -self._depth(k), True))
        return found

    def _event(self, z: Any, modes: tuple[int, ...], on: set[int]) -> tuple[Any, tuple[int, ...]]:
        """State and modes after impacts and changes of contacts that are `on` their walls."""
        n, z = self.n, z.copy()
        while True:
            speeds = (self.b @ z[n : 2 * n]).astype(float)
            rigid = [k for k in sorted(on) if self.walls[k].e is not None and speeds[k] > SLOW]
            if not rigid:
                break
            k = rigid[0]
            pull = self.inverse @ self.b[k] / (self.b[k] @ self.inverse @ self.b[k])
            z[n : 2 * n] -= (1 + Real(self.walls[k].e)) * speeds[k] * pull
        choices = []
        for k, wall in enumerate(self.walls):
            if k not in on:
                choices.append([modes[k]])
            elif abs(speeds[k]) > SLOW:
                choices.append([ON if wall.e is None and speeds[k] > 0.0 else OFF])
            else:
                choices.append([OFF, HOLD, ON] if wall.e is None else [OFF, HOLD])
        rest = {k for k in on if abs(speeds[k]) <= SLOW}
        found = [each for each in itertools.product(*choices) if self._stays(z, each, rest)]
        assert len(found) == 1, f"{len(found)} combinations of modes"
        at_rest = tuple(HOLD if k in rest else mode for k, mode in enumerate(found[0]))
        return self._stopped(z, at_rest), found[0]

    def _stays(self, z: Any, modes: tuple[int, ...], rest: set[int]) -> bool:
        """Whether nothing is violated just after z, in which contacts `rest` on their walls."""
        held = [k for k, mode in enumerate(modes) if mode == HOLD]
        if np.linalg.matrix_rank(self.b[held].astype(float)) < len(held):
            return False
        series, powers = self._series(self._stopped(z, modes), modes), self._flow(modes)[2]
        for k, row, is_depth in self._watched(modes):
            if is_depth and k not in rest:
                continue
            first = 2 if is_depth else 0
            values = (series @ row)[first:6] / powers ** np.arange(first, 6)
            size = (np.abs(series[:6]) @ np.abs(row) / powers ** np.arange(6)).max()
            clear = values[np.abs(values) > ZERO * size]
            if clear.size and clear[0] < 0.0:
                return False
        return True

    def _stopped(self, z: Any, modes: tuple[int, ...]) -> Any:
        """z with held contacts on their walls, without speeds."""
        n, z = self.n, z.copy()
        held = [k for k, mode in enumerate(modes) if mode == HOLD]
        b = self.b[held]
        back = self.inverse @ b.T @ _inverse(b @ self.inverse @ b.T)
        z[n : 2 * n] -= back @ (b @ z[n : 2 * n])
        z[:n] -= back @ (b @ z[:n] - self.places[held])
        return z


def _inverse(matrix: Any) -> Any:
    """Inverse of a small matrix, by Newton's iteration from that in double precision."""
    found = np.linalg.inv(matrix.astype(float)).astype(Real)
    for _ in range(3):
        found = found @ (2 * np.eye(len(matrix), dtype=Real) - matrix @ found)
    return found


def _first_zero(p: Any, h: Any, is_zero: bool, size: Any) -> Any:
    """First time in (0, h] at which a polynomial falls through zero, or None.

    Zeros at 0 do not count, where it `is_zero`.
    """
    if is_zero:
        p, power = p[1:], h
        while len(p) > 1 and abs(p[0]) * power < 1e-15 * max(size, 1e-3):
            p, power = p[1:], power * h
    scaled = (p * h ** np.arange(len(p))).astype(float)
    if scaled[0] > np.abs(scaled[1:]).sum():
        return None
    if scaled[0] < 0.0:
        return Real(0.0)
    values, slopes = polyval(_SAMPLES, scaled), polyval(_SAMPLES, polyder(scaled))
    for i in range(64):
        if values[i + 1] <= 0.0:
            return _bisect(p, _SAMPLES[i] * h, _SAMPLES[i + 1] * h)
        if slopes[i] < 0.0 < slopes[i + 1]:  # a minimum between two samples
            low, high = _SAMPLES[i], _SAMPLES[i + 1]
            for _ in range(50):
                middle = 0.5 * (low + high)
                falls = polyval(middle, polyder(scaled)) < 0.0
                low, high = (middle, high) if falls else (low, middle)
            if polyval(low, scaled) < 0.0:
                return _bisect(p, _SAMPLES[i] * h, low * h)
    return None


def _bisect(p: Any, a: Any, b: Any) -> Any:
    """Root of a polynomial that is positive at a and negative at b."""
    for _ in range(75):
        middle = (a + b) / 2
        a, b = (middle, b) if polyval(middle, p) > 0.0 else (a, middle)
    return b
