"""Pseudo-arclength continuation of many branches together.

From an orbit u with unit tangent t the next one is sought by Newton's method on the hyperplane at
a distance h: ``t . (v - u) = h``. So folds are no different from other points [1]_. A step is
repeated with half of h where Newton's method fails or goes far, or where the tangent or the
multipliers change much.

.. [1] H. B. Keller, in: Applications of Bifurcation Theory, Academic Press 1977, 359-384.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations_with_replacement, pairwise

import numpy as np
from numpy.typing import NDArray

from gapsweep.continuation.locate import Step
from gapsweep.continuation.newton import Corrector
from gapsweep.continuation.orbits import Orbit, OrbitEquations, Reference
from gapsweep.continuation.special import crossing_test

Array = NDArray[np.float64]
Numbers = NDArray[np.intp]

# Lengths in scaled unknowns: sizes of states and windows of parameters are 1.
_FIRST, SMALLEST, _LARGEST = 1e-3, 1e-9, 0.03
_GROWS, _FEW_STEPS = 2.0, 4
_TURN, _SLIGHT_TURN = 0.3, 0.1  # of the tangent in a step [rad]
_MET = 1e-5, 1e-7  # of the size: halves of orbits that differ, and that do not
_NEAR_ONE = 0.02  # a multiplier of an orbit near which branches may cross
_STATIONARY = 0.2  # of the way: a parameter that changes less over two steps is at a fold
_ASIDE = 0.5  # correction over step
# Of a window: an orbit so near its end, on the way out, is at the end; also if steps are too small.
_EDGE, _NEAR_EDGE = 1e-12, 1e-6
# Change of multipliers in a step, but not where they jump, as near a graze.
_CHANGE, _INNER, _FAST = 0.4, 0.7, 1e-4
# Distances at which a branch is sought again behind a kink, and where it is no longer there.
_BEHIND, _ASTRAY = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3), 3.0
_ON_CHORD = 0.1  # of a step: an orbit so near the line between two others lies between them


@dataclass(slots=True)
class Half:
    """A branch on one side of its first orbit.

    Attributes
    ----------
    orbits : list of Orbit
    references : list of Reference
        With which each but the first was found.
    end : str
        Why it ends.
    """

    orbits: list[Orbit]
    references: list[Reference] = field(default_factory=list)
    end: str = ""

    def step(self, i: int) -> Step:
        """From the i-th orbit to the next one."""
        return Step(self.orbits[i], self.orbits[i + 1], self.references[i])


class Continuation:
    """Branches that are followed together, each from an orbit in one direction.

    Parameters
    ----------
    equations : OrbitEquations or like it
    max_steps : int
        Orbits of a half at most.
    """

    def __init__(self, equations: OrbitEquations, max_steps: int) -> None:
        self.equations, self.max_steps = equations, max_steps
        self.corrector = Corrector(equations)

    def follow(self, starts: Sequence[Orbit], reference: Reference) -> list[Half]:
        """The halves that begin at orbits, in the direction of their tangents."""
        halves = [Half([start]) for start in starts]
        n = len(halves)
        size, reference = np.full(n, _FIRST), reference.take(np.arange(n))
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
            bend[np.abs(bend).max(axis=1) > _SLIGHT_TURN] = 0.0  # at a kink
            guess = u + size[left, None] * (t + 0.5 * bend)
            guess, normal = self._within(u, guess, t)
            found, n_steps = self.corrector.orbits(guess, normal, here, _ASIDE * size[left])
            goes_on = np.ones(len(left), bool)
            for k, (i, orbit) in enumerate(zip(left.tolist(), found, strict=True)):
                half, step = halves[i], float(size[i])
                turn, is_good = self._judged(half.orbits, orbit, step)
                if not is_good:
                    size[i] = 0.5 * step
                    if size[i] >= SMALLEST:
                        continue
                    orbit = self._behind_kink(half.orbits, here.take([k]))
                    if orbit is None:
                        is_out = self._leaves(half.orbits[-1], _NEAR_EDGE)
                        half.end, goes_on[k] = "window" if is_out else "step_too_small", False
                        continue
                    turn = math.inf
                    size[i] = 0.1 * float(np.abs(orbit.unknowns - half.orbits[-1].unknowns).max())
                assert orbit is not None
                half.orbits.append(orbit)
                half.references.append(here.take([k]))
                half.end = self._end(half)
                goes_on[k] = not half.end
                if 2.0 * _SLIGHT_TURN < turn < math.inf:
                    size[i] = 0.7 * step
                elif n_steps[k] <= _FEW_STEPS and turn < _SLIGHT_TURN:
                    largest = _LARGEST * max(1.0, float(np.abs(orbit.unknowns).max()))
                    size[i] = min(_GROWS * step, largest)
            left = left[goes_on]
        return halves

    def _leaves(self, orbit: Orbit, edge: float = _EDGE) -> bool:
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

    def _judged(self, orbits: list[Orbit], orbit: Orbit | None, step: float) -> tuple[float, bool]:
        """Turn of the tangent [rad], and whether the step is accepted."""
        if orbit is None:
            return math.inf, False
        before = orbits[-1]
        if len(orbits) == 1 and before.special:  # where branches cross, tangents mean nothing
            return 0.0, True
        met = zip(before.unlike, orbit.unlike, strict=True)
        if any(one > _MET[0] and other < _MET[1] for one, other in met):  # on the other branch
            return math.inf, False
        # Behind a graze at which the branch turns back the way is another one.
        if before.branching * orbit.branching < 0.0 and not _may_cross((before, orbit)):
            return math.inf, False
        turn = math.acos(min(1.0, max(-1.0, float(before.tangent @ orbit.tangent))))
        if turn > _TURN:
            return turn, False
        if step > _FAST and _change(before.multipliers, orbit.multipliers) > _CHANGE:
            return turn, False
        return turn, True

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
        normals = np.tile(axes, (len(_BEHIND), 1))
        distances = np.repeat(_BEHIND, len(axes))
        found, _ = self.corrector.orbits(
            u + distances[:, None] * normals,
            normals,
            reference.take(np.zeros(len(normals), int)),
            _ASTRAY * distances,
        )
        # Those that pass as many contacts lie on this side.
        behind = [each for each in found if each and each.n_contacts != last.n_contacts]
        behind = [each for each in behind if not _is_passed(orbits, each)]
        if not behind:
            return None
        nearest = min(behind, key=lambda each: float(((each.unknowns - u) ** 2).sum()))
        # J changes across a graze, but not along it: the determinant keeps its sign.
        is_ahead = nearest.branching * last.branching > 0.0
        return nearest if is_ahead else reversed_orbit(nearest)

    def _end(self, half: Half) -> str:
        """Why a half ends at its last orbit; nothing if it goes on."""
        first, before, last = half.orbits[0], half.orbits[-2], half.orbits[-1]
        places = [float(self.equations.window_places(orbit)[0]) for orbit in (before, last)]
        is_free = self.equations.family.is_conservative
        passed = (
            is_free and not 0.0 <= places[1] <= 1.0 and abs(places[1] - 0.5) > abs(places[0] - 0.5)
        )
        if passed or self._leaves(last):
            return "window"
        if self._is_pitchfork(half.orbits[-3:]):
            return "branch_point"
        n = len(last.state)
        if self.equations.has_period and before.unknowns[:n] @ last.unknowns[:n] < 0.0:
            return "equilibrium"  # it passed through: behind it lie the same orbits
        if len(half.orbits) > 5 and self._is_closed(first, before, last):
            return "closed"
        return "max_steps" if len(half.orbits) > self.max_steps else ""

    def _is_pitchfork(self, orbits: list[Orbit]) -> bool:
        """Whether a branch folds where it crosses another one: it was followed to its end.

        Behind it lie the same orbits half a period later, or their mirror images.
        """
        if len(self.equations.windows) > 1:
            return False
        steps = [pair for pair in pairwise(orbits) if not pair[0].special]
        folds = any(a.tangent[-1] * b.tangent[-1] < 0.0 for a, b in steps)
        crosses = any(a.branching * b.branching < 0.0 for a, b in steps)
        places = [self.equations.window_places(orbit)[0] for orbit in orbits]
        way = float(np.sqrt(((orbits[-1].unknowns - orbits[0].unknowns) ** 2).sum()))
        is_still = max(places) - min(places) <= _STATIONARY * way
        return folds and crosses and is_still and _may_cross(orbits)

    def _is_closed(self, first: Orbit, before: Orbit, last: Orbit) -> bool:
        """Whether the first orbit lies between the last two."""
        if self.equations.has_period:  # orbits start anywhere along their motion
            a, b, c = (
                np.array([*o.parameters, o.period, *o.x_max, *o.x_min])
                for o in (before, last, first)
            )
            scale = np.maximum(np.abs(a), np.abs(b)) + 1e-300
            a, b, c = a / scale, b / scale, c / scale
        else:
            a, b, c = before.unknowns, last.unknowns, first.unknowns
        along = b - a
        length = float(along @ along)
        if not length or not 0.0 <= float((c - a) @ along) <= length:
            return False
        aside = (c - a) - along * float((c - a) @ along) / length
        return float(np.sqrt(aside @ aside)) <= 0.1 * math.sqrt(length)


def _is_passed(orbits: Sequence[Orbit], orbit: Orbit) -> bool:
    """Whether an orbit lies between two successive ones of a half, with as many contacts."""
    alike = np.array([each.n_contacts == orbit.n_contacts for each in orbits])
    (rows,) = np.nonzero(alike[:-1] & alike[1:])
    places = np.array([each.unknowns for each in orbits])
    chords, to = places[rows + 1] - places[rows], orbit.unknowns - places[rows]
    squares = np.maximum((chords**2).sum(axis=1), np.finfo(float).tiny)
    share = (chords * to).sum(axis=1) / squares
    aside = ((to - share[:, None] * chords) ** 2).sum(axis=1)
    return bool(((share >= 0.0) & (share <= 1.0) & (aside <= _ON_CHORD**2 * squares)).any())


def _may_cross(orbits: Sequence[Orbit]) -> bool:
    """Whether branches may cross between orbits: a multiplier passes 1 there, or comes near it."""
    sides = [crossing_test(orbit) for orbit in orbits]
    nearest = min(np.abs(orbit.multipliers - 1.0).min(initial=np.inf) for orbit in orbits)
    return min(sides) < 0.0 < max(sides) or bool(nearest < _NEAR_ONE)


def _bend(orbits: list[Orbit]) -> Array:
    """Change of the tangent along a branch at its last orbit, as over the step to it."""
    if len(orbits) < 2 or orbits[-2].special:
        return np.zeros_like(orbits[-1].tangent)
    before, last = orbits[-2:]
    apart = last.unknowns - before.unknowns
    return (last.tangent - before.tangent) / float(np.sqrt(apart @ apart))


def reversed_orbit(orbit: Orbit) -> Orbit:
    """The same orbit of a branch that is followed the other way."""
    return replace(orbit, tangent=-orbit.tangent, branching=-orbit.branching)


def _change(before: NDArray[np.complex128], after: NDArray[np.complex128]) -> float:
    """Largest distance of a multiplier from the nearest one before, relative where it is large.

    Zero far inside the unit circle: there multipliers may turn quickly, as of a fast oscillation
    within a long period, and nothing happens.
    """
    if max(np.abs(before).max(initial=0.0), np.abs(after).max(initial=0.0)) < _INNER:
        return 0.0
    apart = np.abs(after[:, None] - before[None, :]).min(axis=1)
    return float((apart / (1.0 + np.abs(after))).max())
