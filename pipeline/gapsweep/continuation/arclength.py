"""Pseudo-arclength continuation of many branches together.

From an orbit u with unit tangent t the next one is sought by Newton's method on the hyperplane at
a distance h: ``t . (v - u) = h``. So folds are no different from other points [1]_. A step is
repeated with half of h where Newton's method fails or goes far, where the tangent or the
multipliers change much, or where the determinant of the equations changes its sign and no other
branch is found to cross: then the orbit lies on another branch, near the one that is followed.

.. [1] H. B. Keller, in: Applications of Bifurcation Theory, Academic Press 1977, 359-384.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.continuation import thresholds as limit
from gapsweep.continuation.border import behind_start, sharp_graze
from gapsweep.continuation.crossing import crossing
from gapsweep.continuation.hopf import hopf_point
from gapsweep.continuation.locate import Step, orbits_at
from gapsweep.continuation.newton import Corrector
from gapsweep.continuation.orbits import Orbit, OrbitEquations, Reference
from gapsweep.continuation.special import Special, crossing_kind

Array = NDArray[np.float64]
Numbers = NDArray[np.intp]


@dataclass(slots=True)
class Half:
    """A branch on one side of its first orbit."""

    orbits: list[Orbit]
    references: list[Reference] = field(default_factory=list)  # of each orbit but the first
    crossings: dict[int, Orbit] = field(default_factory=dict)  # by the orbit before the step
    end: str = ""  # why it ends
    kinks: list[Orbit] = field(default_factory=list)  # orbits behind which it was searched

    def step(self, i: int) -> Step:
        """From the i-th orbit to the next one."""
        return Step(self.orbits[i], self.orbits[i + 1], self.references[i])


class Continuation:
    """Branches that are followed together, each from an orbit in one direction."""

    def __init__(self, equations: OrbitEquations, max_steps: int) -> None:
        self.equations, self.max_steps = equations, max_steps
        self.corrector = Corrector(equations)

    def follow(self, starts: Sequence[Orbit], reference: Reference) -> list[Half]:
        """The halves that begin at orbits, in the direction of their tangents."""
        halves = [Half([start]) for start in starts]
        n = len(halves)
        size, reference = np.full(n, limit.FIRST), reference.take(np.arange(n))
        for half in halves:
            half.end = "window" if self._leaves(half.orbits[0]) else ""
        left = np.array([i for i, half in enumerate(halves) if not half.end], int)
        while left.size:
            now = [halves[i].orbits[-1] for i in left.tolist()]
            u, t = (np.array([getattr(o, name) for o in now]) for name in ("unknowns", "tangent"))
            if self.equations.has_period:
                states = np.array([orbit.state for orbit in now])
                reference.y[left] = states
                reference.rate[left] = self.equations.rates(states, u)
            here = reference.take(left)
            bend = size[left, None] * np.array([_bend(halves[i].orbits) for i in left.tolist()])
            bend[np.abs(bend).max(axis=1) > limit.SLIGHT_TURN] = 0.0  # at a kink
            guess = u + size[left, None] * (t + 0.5 * bend)
            guess, normal = self._within(u, guess, t)
            found, n_steps = self.corrector.orbits(guess, normal, here, limit.ASIDE * size[left])
            for k, (i, orbit) in enumerate(zip(left.tolist(), found, strict=True)):
                half, step, of = halves[i], float(size[i]), here.take([k])
                turn = self._turn(half, orbit, step, of)
                passed = None if turn is None else orbit
                graze = sharp_graze(self.corrector, half.orbits, passed, step, of)
                if graze:
                    half.orbits += graze[:-1]
                    half.references += [of] * (len(graze) - 1)
                    orbit, turn, size[i] = graze[-1], math.inf, limit.PAST_SHARP[-1]
                if turn is None:
                    size[i] = 0.5 * step
                    if size[i] >= limit.SMALLEST:
                        continue
                    orbit = self._ahead(half, orbit, of)
                    if orbit is None:
                        continue
                    turn = math.inf
                    apart = np.abs(orbit.unknowns - half.orbits[-1].unknowns).max()
                    size[i] = max(0.1 * float(apart), 2.0 * limit.SMALLEST)
                assert orbit is not None
                half.orbits.append(orbit)
                half.references.append(of)
                half.end = self._end(half)
                if 2.0 * limit.SLIGHT_TURN < turn < math.inf:
                    size[i] = 0.7 * step
                elif n_steps[k] <= limit.FEW_STEPS and turn < limit.SLIGHT_TURN:
                    largest = limit.LARGEST * max(1.0, float(np.abs(orbit.unknowns).max()))
                    size[i] = min(limit.GROWS * step, largest)
            left = np.array([i for i in left.tolist() if not halves[i].end], int)
        return halves

    def _leaves(self, orbit: Orbit, edge: float = limit.EDGE) -> bool:
        """Whether an orbit at the end of a window is on the way out."""
        first = len(orbit.unknowns) - self.equations.n_parameters
        u, t = orbit.unknowns[first:], orbit.tangent[first:]
        return bool((((u <= edge) & (t < 0.0)) | ((u >= 1.0 - edge) & (t > 0.0))).any())

    def _within(self, u: Array, guess: Array, tangent: Array) -> tuple[Array, Array]:
        """Guesses and normals of hyperplanes; of steps out of a window the plane at its end."""
        normal, first = tangent.copy(), u.shape[1] - self.equations.n_parameters
        for k in range(first, u.shape[1]):
            end = np.clip(guess[:, k], 0.0, 1.0)
            out = np.flatnonzero(guess[:, k] != end)
            part = (end[out] - u[out, k]) / (guess[out, k] - u[out, k])
            guess[out] = u[out] + part[:, None] * (guess[out] - u[out])
            guess[out, k], normal[out] = end[out], np.eye(u.shape[1])[k]
            normal[out, k] = np.where(end[out] > 0.5, 1.0, -1.0)
        return guess, normal

    def _turn(
        self, half: Half, orbit: Orbit | None, step: float, reference: Reference
    ) -> float | None:
        """Turn of the tangent [rad] in a step; None if the step is refused."""
        before = half.orbits[-1]
        if orbit is None:
            return None
        if len(half.orbits) == 1 and before.across is not None:
            return 0.0 if _leaves_crossing(before, orbit) else None
        turn = _turned(before, orbit)
        if turn > limit.TURN:
            return None
        if step > limit.FAST and _change(before.multipliers, orbit.multipliers) > limit.CHANGE:
            return None
        if step > limit.FAST and before.n_contacts != orbit.n_contacts:
            # A kink that the step jumps over has no orbits on its chord.
            whole = Step(before, orbit, reference)
            if orbits_at(self.corrector, [whole], [0.5])[0] is None:
                return None
        # Curves of special points have more equations, whose determinant tells nothing of orbits.
        if before.branching * orbit.branching < 0.0 and len(self.equations.windows) == 1:
            found = crossing(self.equations, Step(before, orbit, reference))
            if found is None:
                return None
            kind = crossing_kind(self.equations, found)
            half.crossings[len(half.orbits) - 1] = replace(found, special=int(kind))
        return turn

    def _ahead(self, half: Half, orbit: Orbit | None, reference: Reference) -> Orbit | None:
        """The next orbit where steps are at their smallest; a half without one ends."""
        last = half.orbits[-1]
        if orbit is not None and orbit.identity.is_prime < last.identity.is_prime:
            half.end = "branch_point"  # near an orbit of a part of the period
            return None
        behind = behind_start(self.corrector, last, reference)
        if behind is not None:
            return behind
        # A branch that comes back to a kink has turned round there.
        ways = (np.abs(last.unknowns - kink.unknowns).max() for kink in half.kinks)
        is_first = all(way > limit.SAME_KINK for way in ways)
        behind = self._behind_kink(half.orbits, reference) if is_first else None
        if behind is not None:
            half.kinks.append(last)
            return behind
        if (
            orbit is not None
            and last.special != Special.UNRESOLVED
            and last.branching * orbit.branching < 0.0
            and _turned(last, orbit) < limit.TURN
        ):  # two branches are nearer than the smallest step, or cross: it may lie on either
            return replace(orbit, special=int(Special.UNRESOLVED))
        half.end = "window" if self._leaves(last, limit.NEAR_EDGE) else "step_too_small"
        return None

    def _behind_kink(self, orbits: list[Orbit], reference: Reference) -> Orbit | None:
        """The branch's next orbit where it turns at a graze more sharply than steps can follow.

        Hard contacts bend a branch within 1e-9 and less. Orbits are sought at several distances on
        hyperplanes in many directions; the nearest one with other contacts is taken, unless the
        branch has passed there: it would return to this kink for ever.
        """
        last = orbits[-1]
        u, d = last.unknowns, len(last.unknowns)
        ways = np.concatenate([np.eye(d), -np.eye(d)])
        axes = np.array([a + b for a, b in combinations_with_replacement(ways, 2) if (a + b).any()])
        axes /= np.sqrt((axes**2).sum(axis=1))[:, None]
        normals = np.tile(axes, (len(limit.BEHIND), 1))
        distances = np.repeat(limit.BEHIND, len(axes))
        found, _ = self.corrector.orbits(
            u + distances[:, None] * normals,
            normals,
            reference.take(np.zeros(len(normals), int)),
            limit.ASTRAY * distances,
        )
        # Orbits with as many contacts lie on this side.
        behind = [
            each
            for each in found
            if each is not None
            and each.n_contacts != last.n_contacts
            and _turned(last, each) < math.inf
            and not _is_passed(orbits, each)
        ]
        if not behind:
            return None
        nearest = min(behind, key=lambda each: float(((each.unknowns - u) ** 2).sum()))
        # J changes across a graze, but not along it: the determinant keeps its sign.
        is_ahead = nearest.branching * last.branching > 0.0
        return nearest if is_ahead else reversed_orbit(nearest)

    def _end(self, half: Half) -> str:
        """Why a half ends at its last orbit; nothing if it goes on."""
        first, before, last = half.orbits[0], half.orbits[-2], half.orbits[-1]
        aside, far = (abs(self.equations.place(orbit) - 0.5) for orbit in (before, last))
        passed = self.equations.family.is_conservative and far > max(aside, 0.5)
        found = half.crossings.get(len(half.orbits) - 2)
        if found is not None and _ends_on(found):
            # Behind it lie the same orbits half a period later, or their mirror images.
            half.orbits[-1] = found
            return "branch_point"
        if last.special == Special.GRAZING and before.identity.is_prime > last.identity.is_prime:
            return "branch_point"  # at an orbit of a part of the period
        if passed or self._leaves(last):
            return "window"
        if self.equations.has_period and self._ends_at_equilibrium(half):
            return "equilibrium"
        if half.kinks and _is_passed(half.orbits[:-1], last):  # it has turned round at a kink
            del half.orbits[-1], half.references[-1]
            return "step_too_small"
        closing = self._closing(first, half) if len(half.orbits) >= limit.SHORTEST_LOOP else None
        if closing is not None:
            half.orbits[-1] = closing
            return "closed"
        return "max_steps" if len(half.orbits) > self.max_steps else ""

    def _ends_at_equilibrium(self, half: Half) -> bool:
        """Whether cycles shrink to an equilibrium; their Hopf point becomes the last orbit."""
        before, last, reference = half.orbits[-2], half.orbits[-1], half.references[-1]
        swing = [self._swing(orbit, reference) for orbit in (before, last)]
        if not min(swing) < 3.0 * limit.LARGEST:
            return False
        n, size = self.equations.n, reference.size[0, : 2 * self.equations.n]
        centre = np.concatenate([0.5 * (before.x_max + before.x_min), np.zeros(n)])
        sides = [(orbit.state[: 2 * n] - centre) / size for orbit in (before, last)]
        # Through the equilibrium the branch goes on with the same orbits, half a period later.
        has_passed = float(sides[0] @ sides[1]) < 0.0
        if not has_passed and not swing[1] < min(swing[0], limit.SMALL_CYCLE):
            return False
        if has_passed:
            del half.orbits[-1], half.references[-1]
        point = hopf_point(self.equations, half.orbits[-1], reference)
        if point is not None:
            half.orbits.append(point)
            half.references.append(reference)
        return has_passed or point is not None

    def _swing(self, orbit: Orbit, reference: Reference) -> float:
        return float(((orbit.x_max - orbit.x_min) / reference.size[0, : self.equations.n]).max())

    def _closing(self, first: Orbit, half: Half) -> Orbit | None:
        """The first orbit, in any phase, if it lies between the last two."""
        step, n = half.step(len(half.orbits) - 2), self.equations.n_states
        if _jumps(step.chord, step.before.tangent):
            return None
        if self.equations.has_period:
            parts = [_between(step.before, first, step.after)]
            normal = np.eye(len(first.unknowns))[-1]
        else:  # a branch may come back to its first orbit some forcing periods later
            states = first.identity.section
            points = [np.concatenate([state, first.unknowns[n:]]) for state in states]
            parts = [_share(step.before.unknowns, step.after.unknowns, point) for point in points]
            normal = step.chord / step.size
        for part in parts:
            if part is None:
                continue
            guess = step.before.unknowns + part * step.chord
            if self.equations.has_period:
                guess[-1] = first.unknowns[-1]
            (found,), _ = self.corrector.orbits(
                guess[None, :], normal[None, :], step.reference, np.array([step.size])
            )
            if found is not None and found.identity.is_same(first.identity):
                return found
        return None


def _turned(before: Orbit, orbit: Orbit) -> float:
    """Turn of the tangent [rad] between orbits; inf of orbits that no branch has one by one."""
    if not orbit.identity.is_prime or not before.identity.is_kept(orbit.identity):
        return math.inf
    return math.acos(min(1.0, max(-1.0, float(before.tangent @ orbit.tangent))))


def _ends_on(crossing: Orbit) -> bool:
    """Whether a branch ends where it crosses one of half its period, or of symmetric orbits."""
    if crossing.special == Special.PERIOD_DOUBLING:
        return True
    assert crossing.across is not None
    is_stationary = abs(crossing.tangent[-1]) < abs(crossing.across[-1])
    return crossing.special == Special.SYMMETRY_BREAKING and is_stationary


def _leaves_crossing(first: Orbit, orbit: Orbit) -> bool:
    """Whether the second orbit of a branch lies on it, not on the one that crosses it."""
    assert first.across is not None
    way = orbit.unknowns - first.unknowns
    own, other = (way - (way @ t) * t for t in (first.tangent, first.across))
    if not own @ own < other @ other:
        return False
    # The branch whose parameter is stationary has orbits of twice the period, or less symmetry.
    is_double = first.identity.halves <= limit.UNLIKE
    is_symmetric = first.special == Special.SYMMETRY_BREAKING
    if abs(first.tangent[-1]) < abs(first.across[-1]) and (is_double or is_symmetric):
        unlike = orbit.identity.halves if is_double else orbit.identity.asymmetry
        return unlike > limit.UNLIKE
    return True


def _share(before: Array, last: Array, point: Array) -> float | None:
    """Part of the chord of a step at a point; None of a point farther away than it is long."""
    along = last - before
    square = float(along @ along)
    if not square or not 0.0 <= float((point - before) @ along) <= square:
        return None
    share = float((point - before) @ along) / square
    aside = point - before - share * along
    return share if float(aside @ aside) <= square else None


def _between(before: Orbit, orbit: Orbit, last: Orbit) -> float | None:
    """Part of a step at an unforced orbit that may start anywhere along its motion."""
    ends = [np.array([*o.parameters, o.period, *o.x_max, *o.x_min]) for o in (before, last, orbit)]
    scale = np.maximum(np.abs(ends[0]), np.abs(ends[1])) + np.finfo(float).tiny
    return _share(*(each / scale for each in ends))


def _is_passed(orbits: Sequence[Orbit], orbit: Orbit) -> bool:
    """Whether an orbit lies on earlier ones of a half with as many contacts, or between them."""
    alike = np.array([each.n_contacts == orbit.n_contacts for each in orbits])
    places = np.array([each.unknowns for each in orbits])
    way = float(((orbit.unknowns - places[-1]) ** 2).sum())
    apart = ((orbit.unknowns - places[alike]) ** 2).sum(axis=1)
    if apart.min(initial=np.inf) <= limit.ON_CHORD**2 * way:
        return True
    chords, tangents = np.diff(places, axis=0), np.array([each.tangent for each in orbits])
    (rows,) = np.nonzero(alike[:-1] & alike[1:] & ~_jumps(chords, tangents[:-1]))
    chords, to = chords[rows], orbit.unknowns - places[rows]
    squares = np.maximum((chords**2).sum(axis=1), np.finfo(float).tiny)
    share = (chords * to).sum(axis=1) / squares
    aside = ((to - share[:, None] * chords) ** 2).sum(axis=1)
    return bool(((share >= 0.0) & (share <= 1.0) & (aside <= limit.ON_CHORD**2 * squares)).any())


def _jumps(chord: Array, tangent: Array) -> Any:
    """Whether chords are no parts of a branch, as where the initial state changes at once."""
    return (chord * tangent).sum(axis=-1) < 0.5 * np.sqrt((chord**2).sum(axis=-1))


def _bend(orbits: list[Orbit]) -> Array:
    """Change of the tangent along a branch at its last orbit, as over the step to it."""
    if len(orbits) < 2 or orbits[-2].across is not None:
        return np.zeros_like(orbits[-1].tangent)
    before, last = orbits[-2:]
    apart = last.unknowns - before.unknowns
    return (last.tangent - before.tangent) / float(np.sqrt(apart @ apart))


def reversed_orbit(orbit: Orbit) -> Orbit:
    """Reverse the direction in which a branch is followed from an orbit."""
    return replace(orbit, tangent=-orbit.tangent, branching=-orbit.branching)


def _change(before: NDArray[np.complex128], after: NDArray[np.complex128]) -> float:
    """Largest distance of a multiplier from the nearest one before, relative where it is large.

    Zero far inside the unit circle: there multipliers may turn quickly, as of a fast oscillation
    within a long period, and nothing happens.
    """
    if max(np.abs(before).max(initial=0.0), np.abs(after).max(initial=0.0)) < limit.INNER:
        return 0.0
    apart = np.abs(after[:, None] - before[None, :]).min(axis=1)
    return float((apart / (1.0 + np.abs(after))).max())
