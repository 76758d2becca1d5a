"""Pseudo-arclength continuation of many branches together.

From an orbit u with unit tangent t the next one is sought by Newton's method on the hyperplane at
a distance h: ``t . (v - u) = h``. So folds are no different from other points [1]_. A step is
repeated with half of h where Newton's method fails or goes far, or where the tangent or the
multipliers change much. What changes its sign over a step is located on the same hyperplanes, by
bisection and inverse quadratic interpolation [2]_.

.. [1] H. B. Keller, in: Applications of Bifurcation Theory, Academic Press 1977, 359-384.
.. [2] T. R. Chandrupatla, Adv. Eng. Softw. 28 (1997) 145-149.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.continuation.orbits import Evaluation, Orbit, OrbitEquations, Reference

Array = NDArray[np.float64]
Numbers = NDArray[np.intp]

# Lengths in scaled unknowns: sizes of states and windows of parameters are 1.
_CLOSED, _NEARLY = 1e-10, 1e-7  # Newton steps: of an orbit; where they do not shrink any more
_NEAR, _LEAST = 0.01, 1e-13  # the same over the length of a step, and at least
_NEWTON_STEPS = 12
_FIRST, SMALLEST, _LARGEST = 1e-3, 1e-9, 0.03
_GROWS, _FEW_STEPS = 1.5, 4
_TURN, _SLIGHT_TURN = 0.3, 0.1  # of the tangent in a step [rad]
_MET = 1e-5, 1e-7  # of the size: halves of orbits that differ, and that do not
_STATIONARY = 1e-3  # of the window: a parameter that changes less over two steps is at a fold
_ASIDE = 0.5  # correction over step
# Change of multipliers in a step, but not where they change ever so fast, as beside a graze.
_CHANGE, _FAST = 0.4, 1e-4
_LOCATIONS, _LOCATED, _ON = 60, 1e-14, 1e-13
# Distances at which a branch is sought again behind a kink, and where it is no longer there.
_BESIDE = 1e-3  # where branches cross: distance of the orbits that are interpolated
_BEHIND, _ASTRAY = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3), 3.0


@dataclass(frozen=True, slots=True)
class Crossing:
    """A function of orbits that changes its sign over a step.

    Attributes
    ----------
    kind : int
        As of `Special`, or negative: the end of the window.
    value : callable
    """

    kind: int
    value: Callable[[Orbit], float]


@dataclass(slots=True)
class Half:
    """A branch on one side of its first orbit.

    Attributes
    ----------
    orbits : list of Orbit
    steps : list of ndarray, shape (d,)
        The steps between them: from each to a point of the hyperplane of the next.
    end : str
        Why it ends.
    """

    orbits: list[Orbit]
    steps: list[Array] = field(default_factory=list)
    references: list[Reference] = field(default_factory=list)
    end: str = ""


class Corrector:
    """Newton's method on hyperplanes, many orbits at a time."""

    def __init__(self, equations: Any) -> None:
        self.equations = equations
        self._is_conservative = equations.family.is_conservative

    def orbits(
        self, guess: Array, direction: Array, reference: Reference, furthest: Array
    ) -> tuple[list[Orbit | None], NDArray[np.int64]]:
        """Orbits on hyperplanes through guesses; None where none is found.

        Parameters
        ----------
        guess, direction : ndarray, shape (m, d)
            A point of each hyperplane and its normal.
        reference : Reference
        furthest : ndarray, shape (m,)
            Distance from the guess beyond which the search is given up.

        Returns
        -------
        list of Orbit or None
        ndarray of int, shape (m,)
            Newton steps.
        """
        u, m = guess.copy(), len(guess)
        found: list[Orbit | None] = [None] * m
        n_steps, last = np.zeros(m, np.int64), np.full(m, np.inf)
        left = np.arange(m)
        for _ in range(_NEWTON_STEPS):
            if not left.size:
                break
            here = reference.take(left)
            equations = self.equations.evaluate(u[left], here)
            off = ((u[left] - guess[left]) * direction[left]).sum(axis=1)
            step, tangent = self._solved(equations, off, direction[left])
            length = np.sqrt((step**2).sum(axis=1))
            is_ok = equations.is_ok & np.isfinite(length)
            near = np.clip(_NEAR * furthest[left], _LEAST, _CLOSED)
            is_best = (length <= _NEARLY * furthest[left]) & (length > 0.3 * last[left])
            closed = np.flatnonzero(is_ok & ((length <= near) | is_best))
            if closed.size:
                rows = left[closed]
                some = self.equations.orbits(
                    u[rows], tangent[closed], reference.take(rows), equations, closed
                )
                for row, orbit in zip(rows.tolist(), some, strict=True):
                    found[row] = orbit
            moved = u[left] + step - guess[left]
            goes_on = is_ok & (np.sqrt((moved**2).sum(axis=1)) <= furthest[left])
            goes_on[closed] = False
            last[left], n_steps[left] = length, n_steps[left] + 1
            u[left[goes_on]] += step[goes_on]
            left = left[goes_on]
        return found, n_steps

    def _solved(self, equations: Evaluation, off: Array, direction: Array) -> tuple[Array, Array]:
        """Newton steps and unit tangents."""
        matrix = np.concatenate([equations.jacobian, direction[:, None, :]], axis=1)
        right = np.zeros((len(off), matrix.shape[1], 2))
        right[:, :-1, 0], right[:, -1, 0], right[:, -1, 1] = -equations.residual, -off, 1.0
        matrix[~equations.is_ok], right[~equations.is_ok] = 0.0, np.nan
        both = _solve(matrix, right, least_squares=self._is_conservative)
        step, tangent = both[:, :, 0], both[:, :, 1]
        with np.errstate(all="ignore"):
            return step, tangent / np.sqrt((tangent**2).sum(axis=1))[:, None]


def _solve(matrix: Array, right: Array, *, least_squares: bool) -> Array:
    """Solutions of linear equations, of surplus ones in the sense of least squares."""
    is_finite = np.isfinite(right).all(axis=(1, 2))
    found = np.full((len(matrix), matrix.shape[2], right.shape[2]), np.nan)
    some, other = matrix[is_finite], right[is_finite]
    if not len(some):
        return found
    if not least_squares:
        try:
            found[is_finite] = np.linalg.solve(some, other)
            return found
        except np.linalg.LinAlgError:  # where branches cross
            pass
    found[is_finite] = np.linalg.pinv(some, rcond=1e-9 if least_squares else 1e-15) @ other
    return found


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
        left = np.arange(n)
        while left.size:
            now = [halves[i].orbits[-1] for i in left.tolist()]
            u, t = (np.array([getattr(o, name) for o in now]) for name in ("unknowns", "tangent"))
            if self.equations.has_period:
                states = np.array([orbit.state for orbit in now])
                reference.y[left] = states
                reference.rate[left] = self.equations.rates(states, u)
            here = reference.take(left)
            guess = u + size[left, None] * t
            found, n_steps = self.corrector.orbits(guess, t, here, _ASIDE * size[left])
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
                        half.end, goes_on[k] = "step_too_small", False
                        continue
                    size[i], turn = (
                        0.1 * float(np.abs(orbit.unknowns - half.orbits[-1].unknowns).max()),
                        math.inf,
                    )
                assert orbit is not None
                half.steps.append(orbit.unknowns - half.orbits[-1].unknowns)
                if turn < math.inf:
                    half.steps[-1] = step * half.orbits[-1].tangent
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
        turn = math.acos(min(1.0, max(-1.0, float(before.tangent @ orbit.tangent))))
        if turn > _TURN:
            return turn, False
        if step > _FAST and _change(before.multipliers, orbit.multipliers) > _CHANGE:
            return turn, False
        return turn, True

    def _behind_kink(self, orbits: list[Orbit], reference: Reference) -> Orbit | None:
        """The branch's next orbit where it turns at a graze more sharply than steps can follow.

        Hard contacts bend a branch within 1e-9 and less. Orbits are sought at several distances on
        hyperplanes in many directions; the nearest one with other contacts is taken.
        """
        last = orbits[-1]
        u, d = last.unknowns, len(last.unknowns)
        axes = np.array([way for way in product((-1.0, 0.0, 1.0), repeat=d) if np.any(way)])
        axes = axes[(axes != 0.0).sum(axis=1) <= 2]
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
        if not behind:
            return None
        nearest = min(behind, key=lambda each: float(((each.unknowns - u) ** 2).sum()))
        # J changes across a graze, but not along it: the determinant keeps its sign.
        is_ahead = nearest.branching * last.branching > 0.0
        return nearest if is_ahead else reversed_orbit(nearest)

    def _end(self, half: Half) -> str:
        """Why a half ends at its last orbit; nothing if it goes on."""
        first, before, last = half.orbits[0], half.orbits[-2], half.orbits[-1]
        places = np.array([self.equations.window_places(orbit) for orbit in (before, last)])
        leaves = np.where(places[1] < 0.5, -places, places - 1.0)
        if ((leaves[1] > 0.0) & (leaves[1] > leaves[0])).any():
            return "window"
        if self._is_pitchfork(half.orbits[-3:]):
            return "branch_point"
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
        return folds and crosses and max(places) - min(places) <= _STATIONARY

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

    def crossing(self, half: Half, i: int, value: Callable[[Orbit], float]) -> Orbit | None:
        """The orbit of a step at which another branch crosses.

        There Newton's method finds either branch: it is interpolated between orbits at both sides.
        """
        base, size = half.orbits[i].unknowns, float(np.sqrt((half.steps[i] ** 2).sum()))
        along = half.steps[i] / size
        ends, f = [0.0, size], [value(half.orbits[i]), value(half.orbits[i + 1])]
        apart = min(_BESIDE, 0.125 * size)

        def orbits(x: Any) -> list[Orbit | None]:
            n = len(x)
            return self.corrector.orbits(
                base + np.outer(x, along),
                np.tile(along, (n, 1)),
                half.references[i].take(np.zeros(n, int)),
                np.full(n, size),
            )[0]

        while ends[1] - ends[0] > 8.0 * apart:
            middle = 0.5 * (ends[0] + ends[1])
            (orbit,) = orbits([middle])
            if orbit is None:
                return None
            side = 0 if value(orbit) * f[0] > 0.0 else 1
            ends[side], f[side] = middle, value(orbit)
        x = (ends[0] * f[1] - ends[1] * f[0]) / (f[1] - f[0]) + apart * np.array([-3, -1, 1, 3])
        found = [orbit for orbit in orbits(x) if orbit is not None]
        if len(found) < len(x):
            return None
        values = np.array([value(orbit) for orbit in found])
        at = float(_lagrange(values, x, 0.0))
        if abs(at - x.mean()) > 3.0 * apart:
            return None
        u, t = (
            _lagrange(x, np.array([getattr(o, name) for o in found]), at)[None, :]
            for name in ("unknowns", "tangent")
        )
        reference = half.references[i]
        equations = self.equations.evaluate(u, reference)
        if not equations.is_ok[0]:
            return None
        (orbit,) = self.equations.orbits(u, t, reference, equations, np.zeros(1, np.intp))
        return orbit

    def located(
        self, steps: Sequence[tuple[Half, int, Crossing]]
    ) -> list[tuple[float, Orbit] | None]:
        """Where functions change their signs: parts of steps, and the orbits there.

        Parameters
        ----------
        steps : sequence of (Half, int, Crossing)
            The number is that of the orbit at which the step begins.
        """
        if not steps:
            return []
        n = len(steps)
        u = []
        along = np.array([half.steps[i] for half, i, _ in steps])
        size = np.sqrt((along**2).sum(axis=1))
        along /= size[:, None]
        values = np.empty((2, n))
        best: list[tuple[float, Orbit] | None] = [None] * n
        for k, (half, i, crossing) in enumerate(steps):
            u.append(half.orbits[i].unknowns)
            values[:, k] = crossing.value(half.orbits[i]), crossing.value(half.orbits[i + 1])
        references = [half.references[i] for half, i, _ in steps]
        reference = Reference(
            **{
                name: np.concatenate([getattr(each, name) for each in references])
                for name in ("size", "duration", "multiple", "y", "rate")
            }
        )
        base = np.array(u)
        least = np.full(n, np.inf)
        # The points of Chandrupatla's method: b is the last one, a on the other side, c before.
        b, a = np.zeros(n), np.ones(n)
        f_b, f_a = values
        c, f_c, part = a.copy(), f_a.copy(), np.full(n, 0.5)
        for k in np.flatnonzero(np.abs(f_b) <= _ON).tolist():
            half, i, _ = steps[k]
            best[k] = 0.0, half.orbits[i]
        left = np.flatnonzero(np.abs(f_b) > _ON)
        for _ in range(_LOCATIONS):
            if not left.size:
                break
            x = b[left] + part[left] * (a[left] - b[left])
            guess = base[left] + (x * size[left])[:, None] * along[left]
            found, _ = self.corrector.orbits(
                guess, along[left], reference.take(left), np.maximum(size[left], 1e-7)
            )
            f = np.full(len(left), np.nan)
            for k, orbit in enumerate(found):
                i = left[k]
                if orbit is None:
                    continue
                f[k] = steps[i][2].value(orbit)
                if abs(f[k]) <= least[i]:
                    least[i], best[i] = abs(f[k]), (float(x[k]), orbit)
            is_same = np.sign(f) == np.sign(f_b[left])
            c[left], f_c[left] = (
                np.where(is_same, b[left], a[left]),
                np.where(is_same, f_b[left], f_a[left]),
            )
            other = np.where(is_same, a[left], b[left])
            f_other = np.where(is_same, f_a[left], f_b[left])
            b[left], f_b[left], a[left], f_a[left] = x, f, other, f_other
            part[left] = _next_part(a[left], b[left], c[left], f_a[left], f_b[left], f_c[left])
            goes_on = (f != 0.0) & np.isfinite(f)
            goes_on &= np.abs(a[left] - b[left]) > _LOCATED / size[left]
            left = left[goes_on]
        return best


def _lagrange(x: Array, values: Array, at: float) -> Any:
    """Polynomial through values at some x, at another one."""
    weights = [np.prod([(at - other) / (one - other) for other in x if other != one]) for one in x]
    return np.tensordot(weights, values, axes=1)


def reversed_orbit(orbit: Orbit) -> Orbit:
    """The same orbit of a branch that is followed the other way."""
    return replace(orbit, tangent=-orbit.tangent, branching=-orbit.branching)


def _next_part(a: Array, b: Array, c: Array, f_a: Array, f_b: Array, f_c: Array) -> Array:
    """Where to look next, as a part of the way from b to a."""
    with np.errstate(all="ignore"):
        xi, phi = (b - a) / (c - a), (f_b - f_a) / (f_c - f_a)
        inverse = f_b / (f_b - f_a) * f_c / (f_c - f_a)
        inverse -= (c - b) / (a - b) * f_b / (f_c - f_b) * f_a / (f_a - f_c)
        may = (1.0 - np.sqrt(1.0 - xi) < phi) & (phi < np.sqrt(xi)) & np.isfinite(inverse)
    part = np.where(may, inverse, 0.5)
    least = np.minimum(1e-15 / np.maximum(np.abs(a - b), 1e-300), 0.5)
    return np.asarray(np.clip(part, least, 1.0 - least))


def _change(before: NDArray[np.complex128], after: NDArray[np.complex128]) -> float:
    """Largest distance of a multiplier from the nearest one before, relative where it is large."""
    if not len(before):
        return 0.0
    apart = np.abs(after[:, None] - before[None, :]).min(axis=1)
    return float((apart / (1.0 + np.abs(after))).max())
