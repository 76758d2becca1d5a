"""Special points of branches: test functions that change their signs there, and their names.

With multipliers μ of the orbit, its tangent t, the equations' derivatives J and the turning points
g of a contact's gap, a branch has

- a fold (LP) where the parameter's component of t is zero,
- a period doubling (PD) where the product of all ``1 + μ`` is zero,
- a torus bifurcation (NS) where that of all ``1 - μ_i μ_j``, i < j, is, and two are not real,
- a crossing of branches (BP) where J has one rank less (`gapsweep.continuation.crossing`); of
  symmetric orbits it breaks their symmetry (SB),
- a graze (GR) where one more, or one fewer, of the g lies beyond a wall. Where the multipliers jump
  there (`gapsweep.continuation.border`), it is a border fold (BLP) if the number of real
  ``μ > 1`` changes by an odd number, a border flip (BPD) if the number of real ``μ < -1`` does.

A curve of special points has a cusp (CP) of folds where its tangent has no part along the
parameters, and a resonance 1:1 (R1) or 1:2 (R2) where two μ are 1 or -1.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.continuation.orbits import Orbit, OrbitEquations, motions
from gapsweep.continuation.thresholds import AT_DOUBLE, AT_VALUE, ON_WALL, REAL, UNLIKE, VERTICAL

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SignChange:
    """A test function that changes its sign over a step."""

    kind: int  # as of `Special`, or negative: the end of the window
    value: Callable[[Orbit], float]

    def is_at(self, orbit: Orbit) -> bool:
        """Whether a located orbit is the special point, not one where the function jumps."""
        if self.kind == Special.PERIOD_DOUBLING:
            return bool(np.abs(orbit.multipliers + 1.0).min() <= AT_VALUE)
        if self.kind in RESONANCES:
            apart = np.sort(np.abs(orbit.multipliers - RESONANCES[self.kind]))
            return bool(apart[:2].max() <= AT_DOUBLE)
        if self.kind == Special.TORUS:
            pairs = orbit.multipliers[np.abs(orbit.multipliers.imag) > REAL]
            return bool(np.abs(np.abs(pairs) - 1.0).min(initial=np.inf) <= AT_VALUE)
        if isinstance(self.value, Graze):
            return abs(self.value(orbit)) <= on_wall(orbit, self.value.contact)
        return True


class Special(IntEnum):
    """Kinds of points of a branch; the order is part of the schema."""

    NONE = 0
    FOLD = 1
    PERIOD_DOUBLING = 2
    TORUS = 3
    BRANCH_POINT = 4
    GRAZING = 5
    SYMMETRY_BREAKING = 6
    HOPF = 7
    UNRESOLVED = 8
    CUSP = 9
    RESONANCE_1_1 = 10
    RESONANCE_1_2 = 11
    BORDER_FOLD = 12
    BORDER_FLIP = 13

    @property
    def symbol(self) -> str:
        """The field's abbreviation."""
        symbols = "", "LP", "PD", "NS", "BP", "GR", "SB", "H", "?", "CP", "R1", "R2", "BLP", "BPD"
        return symbols[self]


# Kinds of points at which a turning point of a gap touches a wall.
GRAZES = Special.GRAZING, Special.BORDER_FOLD, Special.BORDER_FLIP
# Value of two multipliers at a strong resonance.
RESONANCES: dict[int, float] = {Special.RESONANCE_1_1: 1.0, Special.RESONANCE_1_2: -1.0}


def sign_changes(before: Orbit, after: Orbit, equations: OrbitEquations) -> Iterator[SignChange]:
    """Test functions that change their sign from one orbit of a branch to the next."""
    if equations.kind:  # all are special points
        # The polynomial itself is zero on a curve of folds or doublings, of grazes anywhere.
        for kind, at in RESONANCES.items():
            value = partial(characteristic, at=at, order=int(equations.kind != Special.TORUS))
            if equations.kind != Special.GRAZING and value(before) * value(after) < 0.0:
                yield SignChange(kind, value)
        a, b = before.tangent[-2:], after.tangent[-2:]
        if a @ b < 0.0:  # the curve turns back in the plane of its parameters
            yield SignChange(Special.CUSP, lambda orbit: float(orbit.tangent[-2:] @ (b - a)))
        return
    if Special.GRAZING in (before.special, after.special) and before.n_contacts != after.n_contacts:
        return  # between a graze and an orbit with an impact past it, where multipliers are large
    if before.special == Special.BORDER_FLIP and before.across is not None:
        return  # on the branch of twice the period that begins there
    if not equations.family.is_conservative:
        tests = {Special.FOLD: fold, Special.PERIOD_DOUBLING: doubling, Special.TORUS: torus}
        for kind, test in tests.items():
            if before.across is not None and before.special == kind:  # it starts there
                continue
            values = test(before), test(after)
            # Along a family at one parameter value its component of the tangent is rounding.
            is_rounding = kind == Special.FOLD and max(map(abs, values)) < VERTICAL
            if values[0] * values[1] < 0.0 and not is_rounding:
                yield SignChange(kind, test)
    for contact, may_hold in enumerate(equations.may_hold):
        for side in (1, -1) if not may_hold else ():  # continuation locates these grazes
            yield from _grazes(before, after, equations, contact, side)


def fold(orbit: Orbit) -> float:
    """Component of the tangent along the parameter [-]."""
    return float(orbit.tangent[-1])


def doubling(orbit: Orbit) -> float:
    """Product of all ``1 + μ`` [-]."""
    return float(np.prod(1.0 + orbit.multipliers).real)


def characteristic(orbit: Orbit, at: float, order: int = 0) -> float:
    """Characteristic polynomial of the multipliers, or its derivative of an order, at a value."""
    polynomial = np.poly1d(np.poly(orbit.multipliers))
    return float(np.real(polynomial.deriv(order)(at)))


def torus(orbit: Orbit) -> float:
    """Product of all ``1 - μ_i μ_j`` [-]; 1 of fewer than two multipliers."""
    i, j = _pairs(len(orbit.multipliers))
    return float(np.prod(1.0 - orbit.multipliers[i] * orbit.multipliers[j]).real)


@cache
def _pairs(n: int) -> tuple[Any, Any]:
    """Numbers of all pairs of n items."""
    return np.triu_indices(n, 1)


def crossing_kind(equations: OrbitEquations, orbit: Orbit) -> Special:
    """Kind of a crossing: with a branch of half the period, of symmetric orbits, or another one."""
    if orbit.identity.halves <= UNLIKE:
        return Special.PERIOD_DOUBLING
    if orbit.identity.asymmetry > UNLIKE:
        return Special.BRANCH_POINT
    models = equations.models_at(orbit)
    later = motions(models, equations.solver, orbit.state[None, :], 0.5 * orbit.period, np.inf)
    apart = np.abs(later.state[0] + orbit.state).max() / np.abs(orbit.state).max()
    return Special.SYMMETRY_BREAKING if apart <= UNLIKE else Special.BRANCH_POINT


class Graze:
    """Distance [m] of a turning point of a contact's gap beyond a wall.

    Side 1 is the upper wall, -1 the lower. Outer turning points lie away from the other wall; the
    rank is the number of points of this kind that are farther beyond.
    """

    def __init__(
        self, equations: OrbitEquations, contact: int, side: int, is_outer: bool, rank: int
    ) -> None:
        self.equations, self.contact, self.side = equations, contact, side
        self.is_outer, self.rank = is_outer, rank

    def __call__(self, orbit: Orbit) -> float:
        wall = walls(self.equations, orbit, self.contact)[self.side]
        if wall is None:  # it has lost its stiffness: the curve ends
            return np.nan
        values = beyond(orbit, self.contact, self.side, wall)[0 if self.is_outer else 1]
        least = -abs(wall) - 1e-9
        return float(values[self.rank]) if self.rank < len(values) else least


def on_wall(orbit: Orbit, contact: int) -> float:
    """Distance [m] from a wall within which a turning point of a contact is on it."""
    return ON_WALL * max(float(np.abs(x).max(initial=0.0)) for x in orbit.turning[contact])


def nearest_graze(equations: OrbitEquations, orbit: Orbit) -> Graze:
    """The turning point of a gap that is nearest to a wall."""
    every = [
        Graze(equations, contact, side, is_outer, rank)
        for contact, turning in enumerate(orbit.turning)
        for side in (1, -1)
        if walls(equations, orbit, contact)[side] is not None
        for is_outer, values in zip((True, False), turning[::side], strict=True)
        for rank in range(len(values))
    ]
    return min(every, key=lambda graze: abs(graze(orbit)))


def walls(equations: OrbitEquations, orbit: Orbit, contact: int) -> dict[int, float | None]:
    """Places of the walls [m] by side; None of one that is not felt."""
    family = equations.family
    names = (window.name for window in equations.windows)
    values = dict(family.values) | dict(zip(names, orbit.parameters, strict=False))
    law = family.laws_at(values)[contact]
    low, high = law.walls
    lower, upper = law.stiffnesses
    if low == high:
        return {1: high if lower != upper else None, -1: None}
    return {1: high if upper else None, -1: low if lower else None}


def beyond(orbit: Orbit, contact: int, side: int, wall: float) -> tuple[Array, Array]:
    """Distances of outer and inner turning points beyond a wall [m], in descending order."""
    maxima, minima = orbit.turning[contact]
    if side > 0:
        return maxima - wall, minima - wall
    return -minima[::-1] + wall, -maxima[::-1] + wall


def _grazes(
    before: Orbit, after: Orbit, equations: OrbitEquations, contact: int, side: int
) -> Iterator[SignChange]:
    counts = []
    for orbit in (before, after):
        wall = walls(equations, orbit, contact)[side]
        if wall is None:
            return
        counts.append([int((x > 0.0).sum()) for x in beyond(orbit, contact, side, wall)])
    (outer, inner), (outer_after, inner_after) = counts
    # An outer and an inner point that appear together beyond the wall touch nothing.
    common = 0
    if (outer_after - outer) * (inner_after - inner) > 0:
        common = min(outer_after - outer, inner_after - inner, key=abs)
    for is_outer, n, m in (
        (True, outer, outer_after - common),
        (False, inner, inner_after - common),
    ):
        for rank in range(min(n, m), max(n, m)):
            value = Graze(equations, contact, side, is_outer, rank)
            if value(before) * value(after) < 0.0:
                yield SignChange(Special.GRAZING, value)
