"""Systems with walls that lose energy, solved by scipy's DOP853 with an event at every change.

The equation is M q'' + C q' + K q + sum b N = F cos(omega t), with the depths d = b.q - wall of
one-sided walls and their rates u. No code of the engines is used: forces, events and jumps are
written out here. At a rigid wall u becomes -e u, and a wall with a slow body that a load presses on
it holds the body until the force for that is zero, or more than a preload.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import simpson, solve_ivp

OFF, ON, SLACK, HOLD = range(4)
SLOW = 1e-6  # speed after an impact from which on a rigid wall holds


@dataclass(frozen=True)
class Wall:
    """A wall on one side of a direction: N = k d (1 + chi u) + c u + preload while it is on.

    With a restitution e it is rigid.
    """

    b: Sequence[float]
    place: float
    k: float
    c: float = 0.0
    pulls: bool = True
    chi: float = 0.0
    preload: float = 0.0
    e: float | None = None

    def force(self, d: float, u: float) -> float:
        return self.k * d * (1.0 + self.chi * u) + self.c * u + self.preload

    def slopes(self, d: float, u: float) -> tuple[float, float]:
        return self.k * (1.0 + self.chi * u), self.c + self.k * self.chi * d


@dataclass(frozen=True)
class SmoothWall(Wall):
    """A wall of tanh, on everywhere: N = (k d + c u) (1 + tanh sharpness d) / 2."""

    sharpness: float = 1.0

    def force(self, d: float, u: float) -> float:
        return (self.k * d + self.c * u) * 0.5 * (1.0 + np.tanh(self.sharpness * d))

    def slopes(self, d: float, u: float) -> tuple[float, float]:
        switch = np.tanh(self.sharpness * d)
        bend = 0.5 * self.sharpness * (1.0 - switch * switch)
        by_d = self.k * 0.5 * (1.0 + switch) + (self.k * d + self.c * u) * bend
        return by_d, self.c * 0.5 * (1.0 + switch)


@dataclass(frozen=True)
class Motion:
    """End state, tangent, events and integrals of a motion."""

    y: Any
    tangent: Any
    n_contacts: int  # times at which a force begins or ends
    time: Any  # in which the force of every wall acts
    shrunk: float  # integral of -div f
    lost: float  # energy lost in dampers and walls
    worked: float  # work of the forcing
    largest: float  # force of a wall
    times: Any  # of contacts that begin or end


@dataclass(frozen=True)
class Lossy:
    M: Any
    C: Any
    K: Any
    F: Any
    omega: float
    walls: Sequence[Wall]

    def run(self, y_0: Sequence[float], t_end: float, *, rtol: float = 1e-12) -> Motion:
        n, inverse = len(self.M), np.linalg.inv(self.M)
        y = np.concatenate([y_0, np.eye(2 * n).ravel(), np.zeros(2)])
        modes = [self._begin(wall, y, n) for wall in self.walls]
        t, time, shrunk, largest = 0.0, np.zeros(len(self.walls)), 0.0, 0.0
        times: list[float] = []
        # a shorter contact would be missed
        is_short = any(wall.preload for wall in self.walls)
        longest = min(2.0 * math.pi / self.omega / 300.0, 0.004 if is_short else 0.02)
        modes = self._rest_on_preloads(t, y, modes, inverse)
        if HOLD in modes:
            shrunk = self._stop(y, modes, inverse)
        while t < t_end:
            events, about = self._events(modes, inverse)
            found = solve_ivp(
                self._rhs(modes, inverse), (t, t_end), y, "DOP853", rtol=rtol, atol=1e-3 * rtol,
                events=events, max_step=longest, dense_output=True,
            )  # fmt: skip
            assert found.status >= 0, found.message
            lasted = found.t[-1] - t
            shrunk += lasted * float(np.trace(inverse @ self.C))
            for k, wall in enumerate(self.walls):
                time[k] += lasted * (modes[k] in (ON, HOLD))
                if modes[k] != ON:
                    continue
                b = np.asarray(wall.b)
                n_samples = 20001 if isinstance(wall, SmoothWall) else 2001
                at = np.linspace(t, found.t[-1], n_samples)
                states = found.sol(at)
                d = b @ states[:n] - wall.place
                u = b @ states[n : 2 * n]
                rates = np.broadcast_to(wall.slopes(d, u)[1], d.shape)
                shrunk += float(b @ inverse @ b) * simpson(rates, x=at)
                forces = np.abs(wall.force(d, u))
                largest = max(largest, float(forces.max()))
            t, y = float(found.t[-1]), found.y[:, -1].copy()
            if found.status == 0:
                break
            which = next(i for i, times in enumerate(found.t_events) if times.size)
            k, new = about[which]
            wall, old = self.walls[k], modes[k]
            b = np.asarray(wall.b)
            u = float(b @ y[n : 2 * n])
            if wall.preload and HOLD not in (old, new):
                modes = self._rest_on_preloads(t, y, modes, inverse)
                new = modes[k] if modes[k] == HOLD else new
            if HOLD in (old, new) and wall.preload:
                times += [t] * ((old == OFF) != (new == OFF))
                modes[k] = new
                if new == HOLD:
                    shrunk = self._stop(y, modes, inverse)
                continue
            if wall.e is not None:
                y, modes, met = self._meet(k, t, y, modes, inverse)
                times += met
                is_last = HOLD in modes or not wall.e  # nothing is left of volumes
                shrunk += math.inf if is_last else -2.0 * math.log(wall.e) * (old == OFF)
                continue
            jump = (wall.force(0.0, u) / u if new == ON else 0.0) - (
                wall.force(0.0, u) / u if old == ON else 0.0
            )
            if {old, new} == {ON, SLACK}:
                jump = 0.0
                d = float(b @ y[:n] - wall.place)  # the wall relaxes without the body
                y[-2] += (0.5 if old == ON else -0.5) * wall.k * d * d
            tangent = y[2 * n : 2 * n + 4 * n * n].reshape(2 * n, 2 * n)  # columns of images
            tangent[n:] -= jump * np.outer(inverse @ b, b @ tangent[:n])
            times += [t] * ((old == ON) != (new == ON))
            modes[k] = new
        images = y[2 * n : 2 * n + 4 * n * n].reshape(2 * n, 2 * n)
        return Motion(
            y[: 2 * n], images, len(times), time, shrunk, y[-2], y[-1], largest, np.array(times)
        )

    def _stop(self, y: Any, modes: list[int], inverse: Any) -> float:
        """Remove speeds and images along held walls from y; return the integral of -div f."""
        n, project = len(self.M), self._projection(modes, inverse)
        y[n : 2 * n] = project @ y[n : 2 * n]
        images = y[2 * n : -2].reshape(2 * n, 2 * n)
        y[2 * n : -2] = (np.kron(np.eye(2), project) @ images).ravel()
        return math.inf

    def _rest_on_preloads(self, t: float, y: Any, modes: list[int], inverse: Any) -> list[int]:
        """Modes with holds of slow bodies that a load below the preload presses on a wall."""
        n, found = len(self.M), list(modes)
        for k, wall in enumerate(self.walls):
            b = np.asarray(wall.b)
            d, u = float(b @ y[:n]) - wall.place, float(b @ y[n : 2 * n])
            free = [OFF if i == k else mode for i, mode in enumerate(modes)]
            a = float(b @ self._rhs(free, inverse)(t, y)[n : 2 * n])
            most = wall.preload * float(b @ inverse @ b)
            if wall.preload and abs(d) < 1e-12 and abs(u) < SLOW and 0.0 <= a <= most:
                found[k] = HOLD
        return found

    def _meet(
        self, k: int, t: float, y: Any, modes: list[int], inverse: Any
    ) -> tuple[Any, list[int], list[float]]:
        """State, modes and times of contacts after wall k is met, or lets go."""
        n, wall, rigid = len(self.M), self.walls[k], self.walls[k].e
        assert rigid is not None
        b, images = np.asarray(wall.b), y[2 * n : -2].reshape(2 * n, 2 * n).copy()
        if modes[k] == HOLD:
            modes = [OFF if i == k else mode for i, mode in enumerate(modes)]
            y = y.copy()
            y[:n] -= 1e-15 * inverse @ b / (b @ inverse @ b)
            return y, modes, [t]
        u, beta = float(b @ y[n : 2 * n]), inverse @ b / (b @ inverse @ b)
        before = self._rhs(modes, inverse)(t, y)[: 2 * n]
        after = y.copy()
        after[:n] -= (float(b @ y[:n]) - wall.place + 1e-15) * beta
        after[n : 2 * n] -= (1.0 + rigid) * u * beta
        after[-2] += 0.5 * (1.0 - rigid**2) * u**2 / float(b @ inverse @ b)
        found = [t, t]
        for i, (other, mode) in enumerate(zip(self.walls, modes, strict=True)):
            d = float(np.dot(other.b, after[:n])) - other.place
            v = float(np.dot(other.b, after[n : 2 * n]))
            if mode in (ON, SLACK) and not other.pulls:
                new = ON if other.force(d, v) >= 0.0 else SLACK
                found += [t] * (new != mode)
                modes = [new if j == i else each for j, each in enumerate(modes)]
            if mode == HOLD and abs(v) > SLOW:
                found.append(t)
                modes = [OFF if j == i else each for j, each in enumerate(modes)]
                after[:n] -= 1e-15 * inverse @ np.asarray(other.b)
        r = np.eye(2 * n)
        r[n:, n:] -= (1.0 + rigid) * np.outer(beta, b)
        rates = self._rhs(modes, inverse)(t, after)[: 2 * n]
        jump = r + np.outer(rates - r @ before, np.append(b, np.zeros(n))) / u
        images = jump @ images
        pressing = float(b @ rates[n:])
        if rigid * u < SLOW and pressing > 0.0:
            rest = 2.0 * rigid * u / (pressing * (1.0 - rigid)) if rigid < 1.0 else 0.0
            found = [*found[2:], t + rest]
            modes = [HOLD if i == k else mode for i, mode in enumerate(modes)]
            project = self._projection(modes, inverse)
            after[n : 2 * n] = project @ after[n : 2 * n]
            images = np.kron(np.eye(2), project) @ images
        after[2 * n : -2] = images.ravel()
        for _ in range(20):  # just inside of all walls that do not hold
            for other, mode in zip(self.walls, modes, strict=True):
                d = float(np.dot(other.b, after[:n])) - other.place
                if other.e is not None and mode == OFF and -1e-15 < d < 1e-12:
                    after[:n] -= (d + 1e-15) * inverse @ np.asarray(other.b)
        return after, modes, found

    def _projection(self, modes: list[int], inverse: Any) -> Any:
        """Matrix that takes the components along held walls from velocities."""
        held = np.array([w.b for w, mode in zip(self.walls, modes, strict=True) if mode == HOLD])
        pull = inverse @ held.T
        return np.eye(len(self.M)) - pull @ np.linalg.solve(held @ pull, held)

    @staticmethod
    def _begin(wall: Wall, y: Any, n: int) -> int:
        d, u = np.dot(wall.b, y[:n]) - wall.place, np.dot(wall.b, y[n : 2 * n])
        if isinstance(wall, SmoothWall):
            return ON
        if d <= 0.0 or wall.e is not None:
            return OFF
        return ON if wall.pulls or wall.force(d, u) > 0.0 else SLACK

    def _events(self, modes: list[int], inverse: Any) -> tuple[list[Any], list[tuple[int, int]]]:
        n = len(self.M)
        events: list[Callable[..., float]] = []
        about: list[tuple[int, int]] = []

        def add(k: int, new: int, direction: float, *, is_force: bool) -> None:
            wall = self.walls[k]

            def event(t: float, y: Any) -> float:
                d = float(np.dot(wall.b, y[:n]) - wall.place)
                return wall.force(d, float(np.dot(wall.b, y[n : 2 * n]))) if is_force else d

            event.terminal, event.direction = True, direction  # type: ignore[attr-defined]  # of scipy
            events.append(event)
            about.append((k, new))

        for k, (wall, mode) in enumerate(zip(self.walls, modes, strict=True)):
            if isinstance(wall, SmoothWall):
                continue
            if mode == HOLD:
                for new, most in ((OFF, 0.0), (ON, wall.preload))[: 2 if wall.preload else 1]:

                    def event(t: float, y: Any, k: int = k, most: float = most) -> float:
                        return self._hold_forces(modes, inverse, t, y)[1][k] - most

                    event.terminal = True  # type: ignore[attr-defined]  # of scipy
                    event.direction = 1.0 if most else -1.0  # type: ignore[attr-defined]  # of scipy
                    events.append(event)
                    about.append((k, new))
            elif mode == OFF:
                add(k, ON, 1.0, is_force=False)
            elif mode == ON and not wall.pulls:
                add(k, SLACK, -1.0, is_force=True)
                if wall.preload:
                    add(k, OFF, -1.0, is_force=False)
            elif mode == ON:
                add(k, OFF, -1.0, is_force=False)
            else:
                add(k, OFF, -1.0, is_force=False)
                add(k, ON, 1.0, is_force=True)
        return events, about

    def _hold_forces(
        self, modes: list[int], inverse: Any, t: float, y: Any
    ) -> tuple[Any, dict[int, float]]:
        """Accelerations with held gaps, and the forces of the walls that hold them, by wall."""
        n, held = len(self.M), [k for k, mode in enumerate(modes) if mode == HOLD]
        free = self._rhs([OFF if mode == HOLD else mode for mode in modes], inverse)(t, y)
        directions = np.array([self.walls[k].b for k in held])
        pull = inverse @ directions.T
        forces = np.linalg.solve(directions @ pull, directions @ free[n : 2 * n])
        return free[n : 2 * n] - pull @ forces, dict(zip(held, forces.tolist(), strict=True))

    def _rhs(self, modes: list[int], inverse: Any) -> Callable[[float, Any], Any]:
        n = len(self.M)
        on = [wall for wall, mode in zip(self.walls, modes, strict=True) if mode == ON]

        def rhs(t: float, y: Any) -> Any:
            q, v = y[:n], y[n : 2 * n]
            load = np.asarray(self.F) * math.cos(self.omega * t)
            force, lost = load - self.C @ v - self.K @ q, float(v @ self.C @ v)
            by_q, by_v = -np.array(self.K, float), -np.array(self.C, float)
            for wall in on:
                b = np.asarray(wall.b)
                d, u = float(b @ q - wall.place), float(b @ v)
                force = force - b * wall.force(d, u)
                lost += (wall.force(d, u) - wall.k * d - wall.preload) * u
                slopes = wall.slopes(d, u)
                by_q -= slopes[0] * np.outer(b, b)
                by_v -= slopes[1] * np.outer(b, b)
            images = y[2 * n : -2].reshape(2 * n, 2 * n)
            accelerations = inverse @ force
            of_images = inverse @ (by_q @ images[:n] + by_v @ images[n:])
            if HOLD in modes:
                project = self._projection(modes, inverse)
                accelerations, of_images = project @ accelerations, project @ of_images
            turned = np.concatenate([images[n:], of_images])
            return np.concatenate([v, accelerations, turned.ravel(), [lost, float(load @ v)]])

        return rhs
