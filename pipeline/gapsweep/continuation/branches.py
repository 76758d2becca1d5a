"""Branches of a model: from attractors, and from the special points of other branches."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gapsweep.continuation.arclength import Continuation, Half, reversed_orbit
from gapsweep.continuation.border import both_sides, doubled
from gapsweep.continuation.locate import Step, roots
from gapsweep.continuation.orbits import Orbit, OrbitEquations, Reference
from gapsweep.continuation.recognise import Branch, holders, is_known, own_part
from gapsweep.continuation.seed import Attractor, seeds
from gapsweep.continuation.special import (
    GRAZES,
    RESONANCES,
    SignChange,
    Special,
    fold,
    nearest_graze,
    sign_changes,
)
from gapsweep.continuation.switch import switched, with_direction
from gapsweep.continuation.thresholds import AT_ONCE, AT_VALUE, BESIDE_GRAZE, SHORTEST

Array = NDArray[np.float64]

_WINDOW = -1  # kind of the sign change that is the window's end


@dataclass(kw_only=True)
class Branches:
    """The branches of one family."""

    equations: OrbitEquations
    max_steps: int  # most orbits of a branch on either side of its first one
    found: list[Branch] = field(default_factory=list)
    attractors: list[Attractor] = field(default_factory=list)
    n_lost: int = 0  # starts, special points and branches that Newton's method did not find

    def __post_init__(self) -> None:
        self.window = self.equations.windows[0]
        self.continuation = Continuation(self.equations, self.max_steps)
        self._n_left = 0  # branches whose special points have been followed

    def add(self, attractors: Sequence[Attractor]) -> None:
        """Follow the branches of attractors, those of one parameter value together."""
        self.attractors += attractors
        found = seeds(self.equations, attractors)
        self.n_lost += len(attractors) - len(found)
        while found:
            self._find([attractor for *_, attractor in found])
            found = [each for each in found if each[2].branch < 0]
            if not found:
                return
            values = [attractor.value for *_, attractor in found]
            value = max(set(values), key=values.count)
            starts, references, now = zip(
                *(each for each in found if each[2].value == value), strict=True
            )
            found = [each for each in found if each[2].value != value]
            first = len(self.found)
            several = self._followed(starts, Reference.joined(references))
            for branch, attractor in zip(several, now, strict=True):
                self._find([attractor], first)
                if attractor.branch < 0:
                    self.found.append(branch)
                    attractor.branch = len(self.found) - 1

    def follow(self) -> None:
        """Follow the branches that leave those of the last generation, each once."""
        branches, first = list(self.found), self._n_left
        self._n_left = len(branches)
        for number in range(first, len(branches)):
            for orbit in branches[number].orbits:
                if orbit.across is None or self._is_used(orbit):
                    continue
                start = switched(self.equations, orbit, branches[number].reference)
                if start is None:
                    self.n_lost += 1
                    continue
                # The other side of a pitchfork has the same orbits later, or mirror images.
                is_pitchfork = abs(start[0].tangent[-1]) < abs(orbit.tangent[-1])
                is_pitchfork &= orbit.special != Special.BRANCH_POINT
                is_pitchfork |= orbit.special == Special.BORDER_FLIP  # to one side only
                (found,) = self._followed([start[0]], start[1], one_sided=is_pitchfork)
                if len(found.orbits) < SHORTEST:
                    self.n_lost += 1
                elif not is_known(self.equations, found, self.found):
                    if orbit is branches[number].orbits[-1] or orbit is branches[number].orbits[0]:
                        branches[number].parent = len(self.found)
                    else:
                        found.parent = number
                    self.found.append(found)

    def _is_used(self, orbit: Orbit) -> bool:
        """Whether a branch that was found from another one begins or ends at a special point."""
        ends = [branch.orbits[k] for branch in self.found[self._n_left :] for k in (0, -1)]
        return any(
            end.special == orbit.special
            and np.abs(end.unknowns[-1] - orbit.unknowns[-1]) <= BESIDE_GRAZE
            and end.identity.is_same(orbit.identity)
            for end in ends
        )

    def _followed(
        self, starts: Sequence[Orbit], reference: Reference, *, one_sided: bool = False
    ) -> list[Branch]:
        """Branches through orbits, or from orbits to one side."""
        n = len(starts)
        others = [] if one_sided else list(map(reversed_orbit, starts))
        lanes = np.arange(n + len(others)) % n
        halves = self.continuation.follow([*starts, *others], reference.take(lanes))
        rows = self.with_special_points(halves)
        found: list[Branch] = []
        for k in range(n):
            forward, backward = rows[k], [] if one_sided else rows[n + k]
            orbits = [reversed_orbit(orbit) for orbit in backward[:0:-1]] + forward
            ends = "branch_point" if one_sided else halves[n + k].end, halves[k].end
            if halves[k].end == "closed":
                orbits, ends = forward[:-1], ("closed", "closed")
            start = max(len(orbits) - len(forward), 0)
            orbits[start] = replace(orbits[start], across=None)
            branch = Branch(orbits=orbits, ends=ends, reference=reference.take([k]))
            if ends == ("max_steps", "max_steps"):  # of a loop, each may hold a part of the other
                before, after = (
                    replace(branch, orbits=x) for x in (orbits[:start], orbits[start:])
                )
                cut, _ = own_part(self.equations, before, start, [after])
                if cut:
                    branch.orbits, branch.ends = orbits[cut:], ("closed", "closed")
                    start -= cut
            known = [each for each in [*self.found, *found] if "max_steps" in each.ends]
            first, last = own_part(self.equations, branch, start, known)
            branch.orbits = branch.orbits[first:last]
            found.append(branch)
        return found

    def with_special_points(self, halves: Sequence[Half]) -> list[list[Orbit]]:
        """The orbits of halves, special points and ends of the window among them."""
        tasks: list[tuple[Half, int, SignChange]] = []
        steps = []
        for half in halves:
            for i in range(len(half.orbits) - 1):
                step = _tested(half, i)
                tests = list(sign_changes(step.before, step.after, self.equations))
                if i == len(half.orbits) - 2 and half.end == "window":
                    tests += self._window_end(half.orbits[-1])
                tasks += [(half, i, test) for test in tests]
                steps += [step] * len(tests)
        located = roots(self.continuation.corrector, steps, [change.value for *_, change in tasks])
        points: dict[tuple[int, int], list[tuple[float, int, Orbit]]] = {}
        for (half, i, change), point in zip(tasks, located, strict=True):
            if point is None or not point[1].identity.is_part_of(half.orbits[i].identity):
                self.n_lost += change.kind != _WINDOW
                continue
            is_at = change.is_at(point[1])
            # Two real multipliers with product 1, or one at the value of a resonance.
            if change.kind in (Special.TORUS, *RESONANCES) and not is_at:
                continue
            kind = change.kind if is_at else Special.UNRESOLVED
            points.setdefault((id(half), i), []).append((point[0], kind, point[1]))
        rows = []
        for half in halves:
            orbits = [half.orbits[0]]
            for i, after in enumerate(half.orbits[1:]):
                named = self._named(half, i, points.get((id(half), i), []))
                # Also a branch that starts at an end of its window goes no farther.
                is_outside = half.end == "window" and self.equations.family.is_conservative
                is_outside &= i == len(half.orbits) - 2
                orbits += [replace(each, special=max(each.special, 0)) for each in named]
                orbits += [] if is_outside else [after]
            self.n_lost += sum(each.special == Special.UNRESOLVED for each in orbits)
            rows.append(orbits)
        return rows

    def _named(self, half: Half, i: int, points: list[tuple[float, int, Orbit]]) -> list[Orbit]:
        """Special points of one step in their order, up to the end of the window."""
        equations, step = self.equations, half.step(i)
        cross = half.crossings.get(i)
        if cross is not None and cross is not step.after:  # else the branch ends there
            share = float((cross.unknowns - step.before.unknowns) @ step.chord) / step.size**2
            points = [*points, (share, cross.special, cross)]
        grazes = [orbit for _, kind, orbit in points if kind == Special.GRAZING]
        borders = [both_sides(equations, graze, step.reference) for graze in grazes]
        corners = [graze for graze, sides in zip(grazes, borders, strict=True) if sides]
        found: list[Orbit] = []
        for _, kind, orbit in sorted(points, key=lambda point: point[0]):
            if kind == Special.FOLD and cross is not None and _is_near(orbit, cross):
                continue
            is_jump = kind == Special.FOLD and abs(fold(orbit)) > AT_VALUE
            if is_jump and any(_is_near(orbit, corner) for corner in corners):
                continue
            # Multipliers jump at a graze.
            if kind == Special.UNRESOLVED and any(_is_near(orbit, graze) for graze in grazes):
                continue
            if kind == Special.GRAZING:
                # Symmetric orbits touch both walls together.
                if any(x.special in GRAZES and _apart(x, orbit) <= AT_ONCE for x in found[-2:]):
                    continue
                sides = borders[next(i for i, graze in enumerate(grazes) if graze is orbit)]
                if sides:
                    graze = nearest_graze(equations, orbit)
                    is_entry = (graze(step.before) < graze(step.after)) == graze.is_outer
                    if sides[1].special == Special.BORDER_FLIP and graze.is_outer:
                        free = step.before if is_entry else step.after
                        across = doubled(self.continuation.corrector, free, step.reference)
                        sides[1] = replace(sides[1], across=across)
                    found += sides if is_entry else sides[::-1]
                    continue
            point = replace(orbit, special=int(kind))
            if kind == Special.PERIOD_DOUBLING:
                point = with_direction(equations, point, step.reference)
            found.append(point)
            if kind == _WINDOW:
                break
        return found

    def _window_end(self, last: Orbit) -> list[SignChange]:
        """The end of the window of amplitudes that the last orbit of a half is outside of."""
        if not self.equations.family.is_conservative:
            return []
        place = self.equations.place
        bound = float(place(last) > 0.5)
        return [SignChange(_WINDOW, lambda orbit: place(orbit) - bound)]

    def _find(self, attractors: Sequence[Attractor], first: int = 0) -> None:
        """Look for the branches that attractors lie on, from a number on."""
        points = [(float(self.window.place(a.value)), a.section, a.multiple) for a in attractors]
        numbers = holders(self.equations, points, self.found[first:])
        for attractor, number in zip(attractors, numbers, strict=True):
            attractor.branch = first + number if number >= 0 else -1


def _is_near(one: Orbit, other: Orbit) -> bool:
    return _apart(one, other) <= BESIDE_GRAZE


def _apart(one: Orbit, other: Orbit) -> float:
    return float(np.abs(one.unknowns - other.unknowns).max())


def _tested(half: Half, i: int) -> Step:
    """A step whose ends have tangents along it where they are special points: there the tangent of
    a pitchfork has no part along the parameter, and that at an impact is one past the graze.
    """
    step = half.step(i)
    along = step.chord / step.size
    before, after = step.before, step.after
    if before.across is not None and i == 0:
        before = replace(before, tangent=along)
    if after.across is not None or after.special in (Special.HOPF, Special.GRAZING):
        after = replace(after, tangent=along)
    return replace(step, before=before, after=after)
