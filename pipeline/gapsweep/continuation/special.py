"""Special points of branches: test functions that change their signs there, and their names.

With multipliers μ of the orbit, its tangent t, the equations' derivatives J and the turning points
g of a contact's gap, a branch has

- a fold (LP) where the parameter's component of t is zero,
- a period doubling (PD) where the product of all ``1 + μ`` is zero,
- a torus bifurcation (NS) where that of all ``1 - μ_i μ_j``, i < j, is, and two are not real,
- a crossing of branches (BP) where the determinant of J and t is zero; of symmetric orbits it
  breaks their symmetry (SB),
- a graze (GR) where one more, or one fewer, of the g lies beyond a wall.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from gapsweep.continuation.orbits import Orbit, OrbitEquations

Array = NDArray[np.float64]


_VERTICAL = 1e-7


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

    @property
    def symbol(self) -> str:
        """The field's abbreviation."""
        return ("", "LP", "PD", "NS", "BP", "GR", "SB", "H", "?", "CP")[self]


def crossings(
    before: Orbit, after: Orbit, equations: OrbitEquations, *, is_first: bool
) -> Iterator[Crossing]:
    """What changes its sign from one orbit of a branch to the next.

    Parameters
    ----------
    is_first : bool
        Whether the branch begins at the first one, where another branch crosses it.
    """
    if len(equations.windows) > 1:  # all are special points
        a, b = before.tangent[-2:], after.tangent[-2:]
        if a @ b < 0.0:  # the curve turns back in the plane of its parameters
            yield Crossing(Special.CUSP, lambda orbit: float(orbit.tangent[-2:] @ (b - a)))
        return
    if not equations.family.is_conservative:
        tests = {Special.PERIOD_DOUBLING: doubling, Special.TORUS: torus}
        if not is_first:
            tests |= {Special.FOLD: fold, Special.BRANCH_POINT: branching}
        for kind, test in tests.items():
            if is_first and before.special == kind:
                continue
            values = test(before), test(after)
            # Along a family at one parameter value its component of the tangent is rounding.
            is_rounding = kind == Special.FOLD and max(map(abs, values)) < _VERTICAL
            if values[0] * values[1] < 0.0 and not is_rounding:
                yield Crossing(kind, test)
    for contact in range(len(before.turning)):
        for side in (1, -1):
            yield from _grazes(before, after, equations, contact, side)


def fold(orbit: Orbit) -> float:
    """Component of the tangent along the parameter [-]."""
    return float(orbit.tangent[-1])


def branching(orbit: Orbit) -> float:
    """Determinant of the equations and the tangent [-]."""
    return orbit.branching


def crossing_test(orbit: Orbit) -> float:
    """Product of all ``1 - μ`` [-]: zero where a branch that goes through is crossed, and at folds.

    Unlike `branching` it has no part in the rounding of derivatives by parameters.
    """
    return float(np.prod(1.0 - orbit.multipliers).real)


def doubling(orbit: Orbit) -> float:
    """Product of all ``1 + μ`` [-]."""
    return float(np.prod(1.0 + orbit.multipliers).real)


def torus(orbit: Orbit) -> float:
    """Product of all ``1 - μ_i μ_j`` [-]; 1 of fewer than two multipliers."""
    i, j = np.triu_indices(len(orbit.multipliers), 1)
    return float(np.prod(1.0 - orbit.multipliers[i] * orbit.multipliers[j]).real)


def is_torus(orbit: Orbit) -> bool:
    """Whether of the pair of multipliers whose product is nearest to 1 neither is real."""
    i, j = np.triu_indices(len(orbit.multipliers), 1)
    nearest = int(np.argmin(np.abs(1.0 - orbit.multipliers[i] * orbit.multipliers[j])))
    return abs(float(orbit.multipliers[i[nearest]].imag)) > 1e-9


class Graze:
    """Distance [m] of a turning point of a contact's gap beyond a wall.

    Parameters
    ----------
    contact : int
    side : int
        1: the upper wall, -1: the lower.
    is_outer : bool
        Whether it is a turning point away from the other wall.
    rank : int
        How many such points are farther beyond.
    """

    def __init__(
        self, equations: OrbitEquations, contact: int, side: int, is_outer: bool, rank: int
    ) -> None:
        self.equations, self.contact, self.side = equations, contact, side
        self.is_outer, self.rank = is_outer, rank

    def __call__(self, orbit: Orbit) -> float:
        wall = walls(self.equations, orbit, self.contact)[self.side]
        assert wall is not None
        beyond = _beyond(orbit, self.contact, self.side, wall)[0 if self.is_outer else 1]
        least = -abs(wall) - 1e-9
        return float(beyond[self.rank]) if self.rank < len(beyond) else least


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
    if law.K_c == 0.0 or (low == high and law.K_ratio == 1.0):
        return {1: None, -1: None}
    return {1: high, -1: None if law.K_ratio == 0.0 or low == high else low}


def _beyond(orbit: Orbit, contact: int, side: int, wall: float) -> tuple[Array, Array]:
    """How far outer and inner turning points lie beyond a wall [m], in descending order."""
    maxima, minima = orbit.turning[contact]
    if side > 0:
        return maxima - wall, minima - wall
    return -minima[::-1] + wall, -maxima[::-1] + wall


def _grazes(
    before: Orbit, after: Orbit, equations: OrbitEquations, contact: int, side: int
) -> Iterator[Crossing]:
    counts = []
    for orbit in (before, after):
        wall = walls(equations, orbit, contact)[side]
        if wall is None:
            return
        counts.append([int((x > 0.0).sum()) for x in _beyond(orbit, contact, side, wall)])
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
                yield Crossing(Special.GRAZING, value)
