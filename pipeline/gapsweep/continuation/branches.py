"""Branches of a model: where they start, their special points, and which attractors they hold."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.continuation.arclength import Continuation, Half, reversed_orbit
from gapsweep.continuation.locate import Step, crossing, roots
from gapsweep.continuation.orbits import Orbit, OrbitEquations, Reference, integrated, swing
from gapsweep.continuation.special import (
    Crossing,
    Special,
    crossing_test,
    crossings,
    doubling,
    is_torus,
)
from gapsweep.integrate.motions import Events
from gapsweep.integrate.problem import Solver

Array = NDArray[np.float64]

_OFF_TURNING = 0.137  # of a period: orbits start off turning points, which would come and go
_SAME = 1e-6  # orbits that are nearer, as a share of their size, are the same
_HALVES = 1e-2  # of a state: near a pitchfork, halves of a period are this much alike
_PITCHFORK = (Special.FOLD, Special.BRANCH_POINT)
_ROUNDING = 1e-12  # of parameter values
_ON_EITHER_SIDE = 1e-6, 1e-5, 1e-4, 1e-3  # of a window, about a doubling
_DIRECTIONS, _CLEAR = 12, 1e-3  # in which, and how far from a crossing, orbits are sought
_SHORTEST = 4  # orbits of a branch that leaves another one
_AT_ONCE = 1e-9  # grazes that are nearer in scaled unknowns are one
_WINDOW = -1  # kind of the crossing that is the window's end


@dataclass(slots=True, kw_only=True)
class Attractor:
    """A periodic orbit that is known: a start for a branch.

    Attributes
    ----------
    value : float
        Of the parameter.
    section : ndarray, shape (n, n_states)
        States on it at whole forcing periods, or at maxima of the first coordinate.
    period : float
        [s]; NaN where the forcing sets it.
    multiple : int
    branch : int
        Which branch it lies on; -1: none.
    """

    value: float
    section: Array
    period: float
    multiple: int
    branch: int = -1


@dataclass(slots=True, kw_only=True)
class Branch:
    """Periodic orbits in the order of a branch.

    Attributes
    ----------
    orbits : list of Orbit
    ends : tuple of str
        Why it ends before the first and after the last one.
    reference : Reference
        Sizes that its unknowns are scaled by.
    parent : int
        The branch that it leaves at its first orbit; -1: none.
    """

    orbits: list[Orbit]
    ends: tuple[str, str]
    reference: Reference
    parent: int = -1


@dataclass(kw_only=True)
class Branches:
    """The branches of one family.

    Attributes
    ----------
    equations : OrbitEquations
    max_steps : int
        Orbits of a branch on either side of its start, at most.
    found : list of Branch
    attractors : list of Attractor
    n_lost : int
        Starts, special points and branches from there that Newton's method did not find.
    """

    equations: OrbitEquations
    max_steps: int
    found: list[Branch] = field(default_factory=list)
    attractors: list[Attractor] = field(default_factory=list)
    n_lost: int = 0

    def __post_init__(self) -> None:
        self.window = self.equations.windows[0]
        self.continuation = Continuation(self.equations, self.max_steps)

    def _place(self, orbit: Orbit) -> float:
        return float(self.equations.window_places(orbit)[0])

    def add(self, attractors: Sequence[Attractor]) -> None:
        """Follow the branches of attractors, those of one parameter value together.

        Their sections become those of the orbits that Newton's method finds: of settled motions
        they are known to the tolerance of another solver.
        """
        self.attractors += attractors
        if not attractors:
            return
        starts, reference, kept = self._starts(attractors)
        self.n_lost += len(attractors) - len(starts)
        for orbit, attractor in zip(starts, kept, strict=True):
            attractor.section = self._whole_section(orbit)
        left = list(range(len(kept)))
        while left:
            self._find([kept[k] for k in left])
            left = [k for k in left if kept[k].branch < 0]
            if not left:
                return
            values = [kept[k].value for k in left]
            value = max(set(values), key=values.count)
            now = [k for k in left if kept[k].value == value]
            left = [k for k in left if kept[k].value != value]
            several = self._followed([starts[k] for k in now], reference.take(now))
            first = len(self.found)
            for branch, k in zip(several, now, strict=True):
                self._find([kept[k]], first)
                if kept[k].branch < 0:
                    self.found.append(branch)
                    kept[k].branch = len(self.found) - 1

    def _starts(
        self, attractors: Sequence[Attractor]
    ) -> tuple[list[Orbit], Reference, list[Attractor]]:
        """Orbits of attractors at their parameter values."""
        equations, n = self.equations, len(attractors)
        states = np.array([each.section[0] for each in attractors])
        values = np.array([[each.value] for each in attractors])
        period = np.array([each.period for each in attractors])
        places = np.asarray(self.window.place(values))
        models = equations.family.models(equations.windows, places)
        multiple = np.array([each.multiple for each in attractors])
        if equations.has_period:
            states = _ends(models, equations.solver, states, _OFF_TURNING * period)
            rate = 2.0 * np.pi / period
        else:
            period, rate = np.ones(n), 2.0 * np.pi * models.omega
        size = np.empty_like(states)
        for i in range(n):
            unit = np.asarray(models.systems[models.system[i]].unit(rate[i]), float)
            sections = np.concatenate([states[i : i + 1], attractors[i].section])
            size[i] = unit * swing(sections / unit)
        reference = Reference(
            size=size, duration=period, multiple=multiple, y=states, rate=np.zeros_like(states)
        )
        unknowns = equations.unknowns(states, period, values, reference)
        if equations.has_period:
            reference.rate = equations.rates(states, unknowns)
        direction = np.zeros_like(unknowns)
        direction[:, 0 if equations.family.is_conservative else -1] = 1.0
        found, _ = self.continuation.corrector.orbits(
            unknowns, direction, reference, np.full(n, 0.5)
        )
        is_found = [k for k, orbit in enumerate(found) if orbit is not None]
        orbits = [orbit for orbit in found if orbit is not None]
        return orbits, reference.take(is_found), [attractors[k] for k in is_found]

    def _followed(
        self, starts: Sequence[Orbit], reference: Reference, parents: Sequence[int] = ()
    ) -> list[Branch]:
        """Branches through orbits; with parents to one side only, from where these cross."""
        n = len(starts)
        if not n:
            return []
        others = [] if parents else list(map(reversed_orbit, starts))
        lanes = np.concatenate([np.arange(n)] * (1 if parents else 2))
        halves = self.continuation.follow([*starts, *others], reference.take(lanes))
        rows = self.with_special_points(halves)
        found = []
        for k in range(n):
            forward, backward = rows[k], [] if parents else rows[n + k]
            orbits = [reversed_orbit(orbit) for orbit in backward[:0:-1]] + forward
            ends = "branch_point" if parents else halves[n + k].end, halves[k].end
            if halves[k].end == "closed":
                orbits = forward
            branch = Branch(
                orbits=orbits,
                ends=ends,
                reference=reference.take([k]),
                parent=parents[k] if parents else -1,
            )
            for place in (0, -1):
                if ends[place] == "branch_point" and not (parents and place == 0):
                    orbits[place] = self._refined(branch, orbits[place])
            found.append(branch)
        return found

    def _refined(self, branch: Branch, end: Orbit) -> Orbit:
        """The end of a branch where it meets another one, located on that one.

        There the equations are regular; along the branch that ends they are twice singular.
        """
        if end.special == Special.PERIOD_DOUBLING:
            return self._refined_doubling(branch, end)
        step = self._across(branch, end)
        found = step and crossing(self.continuation.corrector, step, crossing_test)
        if not found:
            return end
        return replace(found, special=int(self._crossing(found)), tangent=end.tangent)

    def _refined_doubling(self, branch: Branch, end: Orbit) -> Orbit:
        """The end of a branch of doubled period, located on the branch of half the period."""
        equations, corrector = self.equations, self.continuation.corrector
        half, unknowns = self._reference(branch, end), np.tile(end.unknowns, (2, 1))
        half.multiple = np.maximum(half.multiple // 2, 1)
        if equations.has_period:
            unknowns[:, equations.n_states] *= 0.5
        along = np.tile(np.eye(unknowns.shape[1])[-1], (2, 1))
        for apart in _ON_EITHER_SIDE:
            sides = unknowns.copy()
            sides[:, -1] = np.clip(sides[:, -1] + np.array([-apart, apart]), 0.0, 1.0)
            (low, high), _ = corrector.orbits(
                sides, along, half.take(np.zeros(2, int)), np.full(2, 0.1)
            )
            if low is None or high is None or doubling(low) * doubling(high) >= 0.0:
                continue
            (point,) = roots(corrector, [Step(low, high, half)], [doubling])
            if point is not None:
                orbit = replace(point[1], special=int(Special.PERIOD_DOUBLING))
                start = self._switched(replace(branch, reference=half), orbit)
                return end if start is None else replace(start[0], tangent=end.tangent)
        return end

    def _across(self, branch: Branch, end: Orbit) -> Step | None:
        """A step of the branch that goes through the end of another one.

        The equations have two null vectors there. Of the directions between them it is one in which
        orbits on both sides lie on different sides of the crossing.
        """
        unknowns, reference = end.unknowns[None, :], self._reference(branch, end)
        found = self.equations.evaluate(unknowns, reference)
        if not found.is_ok[0]:
            return None
        plane = np.linalg.svd(found.jacobian[0])[2][-2:]
        angles = np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
        ways = np.stack([np.cos(angles), np.sin(angles)], axis=1) @ plane
        both = np.concatenate([-ways, ways])
        orbits, _ = self.continuation.corrector.orbits(
            unknowns + _CLEAR * both,
            both,
            reference.take(np.zeros(len(both), int)),
            np.full(len(both), _CLEAR),
        )
        steps = [
            Step(reversed_orbit(low), high, reference)
            for low, high in zip(orbits[:_DIRECTIONS], orbits[_DIRECTIONS:], strict=True)
            if low and high and crossing_test(low) * crossing_test(high) < 0.0
        ]
        # Along the branch that ends the parameter changes with the square of the distance.
        return max(steps, key=lambda step: abs(float(step.chord[-1])), default=None)

    def with_special_points(self, halves: Sequence[Half]) -> list[list[Orbit]]:
        """The orbits of halves, special points and ends of the window among them."""
        tasks: list[tuple[Half, int, Crossing]] = []
        for half in halves:
            for i, (before, after) in enumerate(zip(half.orbits, half.orbits[1:], strict=False)):
                is_first = i == 0 and before.special > 0
                found = crossings(before, after, self.equations, is_first=is_first)
                tasks += [(half, i, test) for test in found]
            if half.end == "window" and self.equations.family.is_conservative:
                tasks.append((half, len(half.orbits) - 2, self._window_end(half.orbits[-1])))
        corrector = self.continuation.corrector
        steps = [half.step(i) for half, i, _ in tasks]
        located = roots(corrector, steps, [test.value for *_, test in tasks])
        by_step: dict[tuple[int, int], list[tuple[float, int, Orbit]]] = {}
        for (half, i, test), step, point in zip(tasks, steps, located, strict=True):
            if point is None:
                self.n_lost += 1
                continue
            part, orbit = point
            if test.kind == Special.BRANCH_POINT:
                orbit = crossing(corrector, step, crossing_test) or orbit
            if test.kind == Special.TORUS and not is_torus(orbit):
                continue
            by_step.setdefault((id(half), i), []).append((part, test.kind, orbit))
        rows = []
        for half in halves:
            orbits = [half.orbits[0]]
            for i, after in enumerate(half.orbits[1:]):
                points = sorted(by_step.get((id(half), i), []), key=lambda point: point[0])
                if half.end == "branch_point" and i >= len(half.orbits) - 3:
                    ends = [orbit for _, kind, orbit in points if kind in _PITCHFORK]
                    if ends:
                        orbits.append(replace(ends[0], special=int(self._crossing(ends[0]))))
                        break
                ends = [orbit for _, kind, orbit in points if kind == _WINDOW]
                orbits += self._points(points)
                # A branch that starts at an end of its window goes no farther.
                is_last = half.end == "window" and self.equations.family.is_conservative
                is_last &= i == len(half.orbits) - 2
                orbits += ends if is_last else [after]
            rows.append(orbits)
        return rows

    def _points(self, points: list[tuple[float, int, Orbit]]) -> list[Orbit]:
        """Special points of one step by name, up to the end of the window."""
        found: list[Orbit] = []
        for _, kind, orbit in points:
            if kind == _WINDOW:
                break
            if kind == Special.BRANCH_POINT:
                kind = self._crossing(orbit)
            # Symmetric orbits touch both walls together.
            same = kind == Special.GRAZING and found and found[-1].special == kind
            if same and np.abs(found[-1].unknowns - orbit.unknowns).max() <= _AT_ONCE:
                continue
            found.append(replace(orbit, special=int(kind)))
        return found

    def _window_end(self, last: Orbit) -> Crossing:
        """The end of the window of amplitudes that the last orbit of a half is outside of."""
        bound = float(self._place(last) > 0.5)
        return Crossing(_WINDOW, lambda orbit: self._place(orbit) - bound)

    def _crossing(self, orbit: Orbit) -> Special:
        """What crosses a branch: that of half the period, of symmetric orbits, or another one."""
        models = self.equations.family.models(
            self.equations.windows, self.equations.places(orbit.unknowns[None, :])
        )
        state = orbit.state
        later = _ends(models, self.equations.solver, state[None, :], [0.5 * orbit.period])[0]
        allowed = _HALVES * np.abs(state).max()
        if orbit.period_multiple % 2 == 0 and (np.abs(later - state) <= allowed).all():
            return Special.PERIOD_DOUBLING
        is_symmetric = bool((np.abs(later + state) <= allowed).all())
        return Special.SYMMETRY_BREAKING if is_symmetric else Special.BRANCH_POINT

    def follow(self) -> None:
        """Follow what leaves the branches at their period doublings and crossings."""
        kinds = (Special.PERIOD_DOUBLING, Special.SYMMETRY_BREAKING, Special.BRANCH_POINT)
        for number, branch in enumerate(list(self.found)):
            for place, orbit in enumerate(branch.orbits):
                is_first, is_last = place == 0, place == len(branch.orbits) - 1
                is_end = (is_first and branch.ends[0] == "branch_point") or (
                    is_last and branch.ends[1] == "branch_point"
                )
                is_parent = is_first and branch.parent >= 0
                is_halved = is_end and orbit.special == Special.PERIOD_DOUBLING
                if orbit.special not in kinds or is_parent or is_halved:
                    continue
                # A branch that ends here meets another one, which goes through.
                start = self._switched(branch, orbit)
                if is_end and (step := self._across(branch, orbit)):
                    start = step.after, step.reference
                if start is None:
                    self.n_lost += 1
                    continue
                first, reference = start
                parents = [] if is_end else [number]
                (found,) = self._followed([first], reference, parents)
                if len(found.orbits) < _SHORTEST:
                    self.n_lost += 1
                elif not self._is_known(found):
                    found.parent = number
                    self.found.append(found)

    def _switched(self, branch: Branch, orbit: Orbit) -> tuple[Orbit, Reference] | None:
        """The first orbit of a branch that crosses another one, its tangent along it."""
        equations, reference = self.equations, self._reference(branch, orbit)
        unknowns = orbit.unknowns[None, :].copy()
        size, n = reference.size[0], equations.n_states
        if orbit.special == Special.PERIOD_DOUBLING:
            reference.multiple = 2 * reference.multiple
            if equations.has_period:
                unknowns[0, n] *= 2.0
            matrix = orbit.monodromy * size[None, :] / size[:, None] + np.eye(n)
            if equations.has_period:
                normal = reference.rate[0] / size
                matrix = np.vstack([matrix, normal / np.sqrt(normal @ normal)])
            along = np.zeros(unknowns.shape[1])
            along[:n] = np.linalg.svd(matrix)[2][-1]
        else:
            found = equations.evaluate(unknowns, reference)
            both = np.linalg.svd(found.jacobian[0])[2][-2:]
            across = both - (both @ orbit.tangent)[:, None] * orbit.tangent
            along = max(across, key=lambda each: float(each @ each))
        along = along / np.sqrt(along @ along)
        found = equations.evaluate(unknowns, reference)
        if not found.is_ok[0]:
            return None
        (first,) = equations.orbits(
            unknowns, along[None, :], reference, found, np.zeros(1, np.intp)
        )
        return replace(first, special=orbit.special), reference

    def _reference(self, branch: Branch, orbit: Orbit) -> Reference:
        """With which orbits near one of a branch are sought."""
        reference = branch.reference.take(np.zeros(1, int))
        if self.equations.has_period:
            reference.y = orbit.state[None, :]
            reference.rate = self.equations.rates(reference.y, orbit.unknowns[None, :])
        return reference

    def _is_known(self, branch: Branch) -> bool:
        """Whether another branch holds the middle of this one."""
        middle = branch.orbits[len(branch.orbits) // 2]
        attractor = Attractor(
            value=self.window.value(self._place(middle)),
            section=self._whole_section(middle),
            period=middle.period,
            multiple=middle.period_multiple,
        )
        self._find([attractor])
        return attractor.branch >= 0

    def _whole_section(self, orbit: Orbit) -> Array:
        """States at all whole forcing periods of an orbit; of an unforced one at maxima."""
        models = self.equations.family.models(
            self.equations.windows, self.equations.places(orbit.unknowns[None, :])
        )
        events = _events(models, self.equations.solver, orbit.state[None, :], [orbit.period])
        return events.section if len(events.section) else orbit.state[None, :]

    def _find(self, attractors: Sequence[Attractor], first: int = 0) -> None:
        """Look for the branches that attractors lie on, from a number on."""
        tasks = []
        for number in range(first, len(self.found)):
            orbits = self.found[number].orbits
            values = np.array([self._value(orbit) for orbit in orbits])
            low, high = np.sort([values[:-1], values[1:]], axis=0)
            for attractor in attractors:
                alike = orbits[0].period_multiple == attractor.multiple or self.equations.has_period
                there = (low - _ROUNDING <= attractor.value) & (attractor.value <= high + _ROUNDING)
                for i in np.flatnonzero(there & alike).tolist():
                    part = attractor.value - values[i], values[i + 1] - values[i]
                    share = part[0] / part[1] if part[1] else 0.0
                    tasks.append((attractor, number, orbits[i], orbits[i + 1], share))
        if not tasks:
            return
        guess, direction, references = [], [], []
        for attractor, number, before, after, share in tasks:
            u = before.unknowns + share * (after.unknowns - before.unknowns)
            if not self.equations.family.is_conservative:
                u[-1] = self.window.place(attractor.value)
            guess.append(u)
            along = np.zeros(len(u))
            along[0 if self.equations.family.is_conservative else -1] = 1.0
            direction.append(along)
            references.append(self._reference(self.found[number], before))
        reference = Reference.joined(references)
        nearby, _ = self.continuation.corrector.orbits(
            np.array(guess), np.array(direction), reference, np.full(len(tasks), 0.2)
        )
        for (attractor, number, *_), orbit in zip(tasks, nearby, strict=True):
            if orbit is None or attractor.branch >= 0:
                continue
            section = attractor.section
            own = self._whole_section(orbit) if self.equations.has_period else orbit.state[None, :]
            size = np.abs(section).max(axis=0) + 1e-3 * reference.size[0]
            apart = np.abs(own[:1, None, :] - section[None, :, :]) / size
            if apart.max(axis=2).min() <= _SAME:
                attractor.branch = number

    def _value(self, orbit: Orbit) -> float:
        return float(self.window.value(self._place(orbit)))


def _events(models: Any, solver: Solver, states: Array, t_end: ArrayLike) -> Events:
    events: Events = motions(models, solver, states, t_end, 0.0).events()
    return events


def _ends(models: Any, solver: Solver, states: Array, t_end: ArrayLike) -> Array:
    """States after some time [s]."""
    return np.asarray(motions(models, solver, states, t_end, np.inf).state)


def motions(
    models: Any, solver: Solver, states: Array, t_end: ArrayLike, record_from: float
) -> Any:
    """Motions from states over some time [s], recorded from a time on."""
    ends, begin = np.asarray(t_end, float), np.full(len(states), record_from)
    return integrated(models, solver, states, ends, begin, tangent=False)
