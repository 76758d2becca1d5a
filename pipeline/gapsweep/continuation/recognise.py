"""Recognition of branches: the one that an orbit lies on."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gapsweep.continuation.identity import Identity
from gapsweep.continuation.locate import Step, roots
from gapsweep.continuation.newton import Corrector
from gapsweep.continuation.orbits import Orbit, OrbitEquations, Reference
from gapsweep.continuation.special import Special
from gapsweep.continuation.thresholds import ALIKE, ASIDE_KNOWN, COMPARED, EDGE

Array = NDArray[np.float64]
_PARTS = np.linspace(0.0, 1.0, 65)


@dataclass(slots=True, kw_only=True)
class Branch:
    """Periodic orbits in the order of a branch."""

    orbits: list[Orbit]
    ends: tuple[str, str]  # why it ends before the first and after the last orbit
    reference: Reference  # with the sizes that its unknowns are scaled by
    parent: int = -1  # the branch that it leaves, or that ends on it; -1: none
    kind: Special = Special.NONE  # of special points whose curve it is


def is_known(equations: OrbitEquations, branch: Branch, others: Sequence[Branch]) -> bool:
    """Whether one of some branches holds orbits of this one.

    Two branches share no orbit but where they cross, so one shared orbit between is enough.
    """
    inner = branch.orbits[1:-1]
    parts = np.array_split(np.arange(len(inner)), min(COMPARED, len(inner)))
    # The orbit of each part that is farthest from a fold.
    numbers = [max(part.tolist(), key=lambda i: abs(float(inner[i].tangent[-1]))) for part in parts]
    some = replace(branch, orbits=[inner[i] for i in numbers if not inner[i].special])
    return any(number >= 0 for number in on_branches(equations, some, others))


def on_branches(equations: OrbitEquations, branch: Branch, others: Sequence[Branch]) -> list[int]:
    """For each orbit of a branch the number of another branch that holds it; -1: none."""
    size, place = branch.reference.size[0], equations.place
    points = [(place(o), o.identity.section * size, o.period_multiple) for o in branch.orbits]
    return holders(equations, points, others)


def own_part(
    equations: OrbitEquations, branch: Branch, start: int, others: Sequence[Branch]
) -> tuple[int, int]:
    """First orbit of a branch, and the one after its last, up to which no other branch holds them.

    The branch was followed from the orbit number `start` in both directions.
    """
    held = np.array(on_branches(equations, branch, others)) >= 0
    before, after = np.flatnonzero(held[:start]), np.flatnonzero(held[start + 1 :])
    first = int(before[-1]) + 1 if before.size else 0
    return first, start + 1 + int(after[0]) if after.size else len(held)


def holders(
    equations: OrbitEquations,
    points: Sequence[tuple[float, Array, int]],
    branches: Sequence[Branch],
) -> list[int]:
    """Numbers of the branches that hold orbits; -1 for an orbit that no branch holds.

    An orbit has a place in the window, a section, shape (k, n_states), and a period multiple.
    """
    found, tasks = [-1] * len(points), []
    along = np.zeros(equations.n_unknowns)
    along[-1] = 1.0
    for number, branch in enumerate(branches):
        of = np.array([equations.place(orbit) for orbit in branch.orbits])
        low, high = np.sort([of[:-1], of[1:]], axis=0)
        for k, (place, _, multiple) in enumerate(points):
            if not equations.has_period and branch.orbits[0].period_multiple != multiple:
                continue
            there = (low - EDGE <= place) & (place <= high + EDGE)
            for i in np.flatnonzero(there).tolist():
                before, after = branch.orbits[i : i + 2]
                reference = equations.reference_at(branch.reference, before)
                tasks.append((k, number, Step(before, after, reference)))
    if not tasks:
        return found
    steps, corrector = [step for *_, step in tasks], Corrector(equations)
    nearby: Sequence[Orbit | None]
    if equations.family.is_conservative:  # the amplitude is no unknown
        values = [partial(_beyond, equations, points[k][0]) for k, *_ in tasks]
        nearby = [root and root[1] for root in roots(corrector, steps, values)]
    else:
        nearby, _ = corrector.orbits(
            np.array([_guess(step, points[k][0]) for k, _, step in tasks]),
            np.tile(along, (len(tasks), 1)),
            Reference.joined([step.reference for step in steps]),
            np.array([max(ASIDE_KNOWN * step.size, ALIKE) for step in steps]),
        )
    for (k, number, step), orbit in zip(tasks, nearby, strict=True):
        if orbit is not None and found[k] < 0:
            section = Identity(points[k][1] / step.reference.size[0], 0.0)
            found[k] = number if orbit.identity.is_same(section) else -1
    return found


def _beyond(equations: OrbitEquations, place: float, orbit: Orbit) -> float:
    return equations.place(orbit) - place


def _guess(step: Step, place: float) -> Array:
    """Unknowns near a step's orbit at a place of the parameter."""
    points = np.array([step.point(s) for s in _PARTS])
    guess: Array = points[np.abs(points[:, -1] - place).argmin()].copy()
    guess[-1] = place
    return guess
