"""Periodic orbits with impacts by exact linear flows, and their derivatives by complex steps.

Between two events the motion is a matrix exponential. The initial state of the orbit and the times
of its events solve one system of equations. All equations are analytic in the unknowns and in the
parameters, so that imaginary steps of 1e-30 differentiate them without truncation. No tangent, no
jump of a tangent and no code of the package is used.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Array = NDArray[np.complex128]
STEP = 1e-30
SAMPLES = 400  # of every flight, among which extrema are searched for


class Wall(NamedTuple):
    """Walls of the gap b . q: rigid with a restitution e, or elastic with a stiffness k."""

    b: NDArray[np.float64]
    low: complex
    high: complex
    e: complex | None = None
    k: complex = 0.0


class Event(NamedTuple):
    """A wall is met on one side: an impact, or a crossing of an elastic wall."""

    wall: int
    side: int
    is_impact: bool


@dataclass(frozen=True)
class Machine:
    """M q'' + C q' + K q + contacts = F cos(omega t) + F_0."""

    M: Array
    C: Array
    K: Array
    F: Array
    F_0: Array
    omega: complex
    walls: list[Wall]

    @property
    def n(self) -> int:
        return len(self.M)

    def generator(self, modes: tuple[int, ...]) -> Array:
        """Matrix of the linear equation of (q, v, cos, -sin, 1)."""
        n, inverse = self.n, np.linalg.inv(self.M)
        stiffness, load = self.K.astype(complex), np.zeros((n, 3), complex)
        load[:, 0], load[:, 2] = self.F, self.F_0
        for wall, mode in zip(self.walls, modes, strict=True):
            if mode:
                stiffness = stiffness + wall.k * np.outer(wall.b, wall.b)
                load[:, 2] += wall.k * wall.b * (wall.high if mode > 0 else wall.low)
        found = np.zeros((2 * n + 3, 2 * n + 3), complex)
        found[:n, n : 2 * n] = np.eye(n)
        found[n : 2 * n] = inverse @ np.hstack([-stiffness, -self.C, load])
        found[2 * n, 2 * n + 1], found[2 * n + 1, 2 * n] = self.omega, -self.omega
        return found

    def after(self, state: Array, event: Event) -> Array:
        if not event.is_impact:
            return state
        n, wall, inverse = self.n, self.walls[event.wall], np.linalg.inv(self.M)
        assert wall.e is not None
        speed, found = wall.b @ state[n : 2 * n], state.copy()
        found[n : 2 * n] -= (1.0 + wall.e) * speed * inverse @ wall.b / (wall.b @ inverse @ wall.b)
        return found


class Orbit:
    """A periodic orbit and its derivatives.

    Parameters
    ----------
    make : callable
        Returns the machine for parameters, shape (p,).
    parameters : array, shape (p,)
    state : array
        State near that at time 0.
    events : list of (float, Event)
        In the order of their times, which are near those of the orbit.
    modes : tuple of int
        Sides of the elastic walls in contact at time 0.
    multiple : int
        Forcing periods of the orbit.
    """

    def __init__(
        self,
        make: Callable[[Array], Machine],
        parameters: list[float],
        state: NDArray[np.float64],
        events: list[tuple[float, Event]],
        modes: tuple[int, ...],
        multiple: int,
    ) -> None:
        self._make, self._events = make, [event for _, event in events]
        self._modes, self._multiple = modes, multiple
        self._p = np.array(parameters, complex)
        self._u = np.concatenate([state, [t for t, _ in events]]).astype(complex)
        unknowns = np.eye(len(self._u))
        for _ in range(20):
            by = [self._slope(each, 0.0 * self._p) for each in unknowns]
            step = np.linalg.solve(np.array(by).T, -self._missed(self._u, self._p).real)
            self._u = self._u + step
            if np.abs(step).max() < 1e-13 * np.abs(self._u).max():
                break
        else:
            raise RuntimeError("no orbit")
        matrix = np.array([self._slope(each, 0.0 * self._p) for each in unknowns]).T
        right = [self._slope(0.0 * self._u, each) for each in np.eye(len(self._p))]
        self._moved = -np.linalg.solve(matrix, np.array(right).T).T
        self.state, self.multiple = self._u[: len(state)].real, multiple  # at time 0
        # its derivatives, shape (p, n_states)
        self.state_gradient = self._moved[:, : len(state)]

    def _slope(self, du: Array, dp: Array) -> NDArray[np.float64]:
        found = self._missed(self._u + 1j * STEP * du, self._p + 1j * STEP * dp)
        return np.asarray(found.imag / STEP)

    def _flights(self, u: Array, p: Array) -> Iterator[tuple[Machine, Array, Array, complex]]:
        """Machine, generator, initial state and length of every flight; then the end state."""
        machine, modes, t = self._make(p), self._modes, 0.0 + 0.0j
        n_states = 2 * machine.n
        state = np.concatenate([u[:n_states], [1.0, 0.0, 1.0]])
        period = self._multiple * 2.0 * math.pi / machine.omega
        for event, end in [*zip(self._events, u[n_states:], strict=True), (None, period)]:
            generator, length = machine.generator(modes), end - t
            yield machine, generator, state, length
            state, t = expm(generator * length) @ state, end
            if event is None:
                break
            state = machine.after(state, event)
            if not event.is_impact:
                mode = 0 if modes[event.wall] else event.side
                modes = (*modes[: event.wall], mode, *modes[event.wall + 1 :])
        yield machine, generator, state, 0.0j

    def _missed(self, u: Array, p: Array) -> Array:
        """What is missing to the walls at events, and to the initial state at the end."""
        *flights, (machine, _, state, _) = self._flights(u, p)
        n, found = machine.n, []
        for (_, generator, start, length), event in zip(flights, self._events, strict=False):
            wall = machine.walls[event.wall]
            gap = wall.b @ (expm(generator * length) @ start)[:n]
            found.append(gap - (wall.high if event.side > 0 else wall.low))
        return np.concatenate([state[: 2 * n] - u[: 2 * n], found])

    def largest(self, along: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Largest value of along . q and its derivatives, shape (p,)."""
        *flights, (machine, *_) = self._flights(self._u, self._p)
        n, best, t = machine.n, (-math.inf, 0, 0.0, False), 0.0
        for number, (_, generator, state, length) in enumerate(flights):
            end, real = length.real, generator.real
            flow, at = expm(real * end / SAMPLES), [state.real]
            for _ in range(SAMPLES):
                at.append(flow @ at[-1])
            speed = np.array(at)[:, n : 2 * n] @ along
            turns = np.flatnonzero((speed[:-1] > 0.0) & (speed[1:] <= 0.0))
            inner = [self._turn(real, state.real, along, (k + 0.5) * end / SAMPLES) for k in turns]
            for place in (*inner, end):
                value = float(along @ (expm(real * place) @ state.real)[:n])
                is_event = place == end and number < len(self._events)
                best = max(best, (value, number, t + place, is_event))
            t += end
        value, number, place, is_event = best
        slopes = []
        for moved, own in zip(self._moved, np.eye(len(self._p)), strict=True):
            u, p = self._u + 1j * STEP * moved, self._p + 1j * STEP * own
            flights = list(self._flights(u, p))
            _, generator, state, length = flights[number]
            if not is_event:
                length = place - sum((each[3] for each in flights[:number]), 0.0j)
            slopes.append((along @ (expm(generator * length) @ state)[:n]).imag / STEP)
        return value, np.array(slopes)

    @staticmethod
    def _turn(
        generator: NDArray[np.float64],
        state: NDArray[np.float64],
        along: NDArray[np.float64],
        t: float,
    ) -> float:
        n = len(along)
        for _ in range(20):  # Newton's method
            here = expm(generator * t) @ state
            step = (along @ here[n : 2 * n]) / (along @ (generator @ here)[n : 2 * n])
            t -= step
            if abs(step) < 1e-15 * abs(t):
                break
        return float(t)
