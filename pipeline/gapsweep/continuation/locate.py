"""Location of sign changes of a function of orbits along a step of a branch.

Orbits of a step are sought on hyperplanes across its chord, from cubic polynomials through its
ends and along their tangents. Roots are those of Chandrupatla's method.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import elementwise

from gapsweep.continuation.newton import Corrector
from gapsweep.continuation.orbits import Orbit, Reference
from gapsweep.continuation.thresholds import LOCATED

Array = NDArray[np.float64]
Value = Callable[[Orbit], float]


@dataclass(frozen=True, slots=True)
class Step:
    """Two orbits of a branch, one after the other."""

    before: Orbit
    after: Orbit
    reference: Reference  # with which the second one was found

    @property
    def chord(self) -> Array:
        """From the first to the second orbit, in unknowns."""
        return self.after.unknowns - self.before.unknowns

    @property
    def size(self) -> float:
        """Length of the chord."""
        return float(np.sqrt((self.chord**2).sum()))

    def point(self, s: float) -> Array:
        """Unknowns near those of the branch, for s from 0 to 1."""
        a, b, size = self.before, self.after, self.size
        bent = float(a.tangent @ b.tangent) < 0.5  # at a kink
        if bent:
            return a.unknowns + s * self.chord
        slope = s * (1.0 - s) ** 2 * a.tangent - s**2 * (1.0 - s) * b.tangent
        return a.unknowns + s**2 * (3.0 - 2.0 * s) * self.chord + size * slope


def orbits_at(
    corrector: Corrector, steps: Sequence[Step], parts: Sequence[float] | Array
) -> list[Orbit | None]:
    """Orbits at parts of steps, 0 to 1; None where none is found."""
    chords = np.array([step.chord / step.size for step in steps])
    return corrector.orbits(
        np.array([step.point(s) for step, s in zip(steps, parts, strict=True)]),
        chords,
        Reference.joined([step.reference for step in steps]),
        np.array([max(step.size, 1e-7) for step in steps]),
    )[0]


def roots(
    corrector: Corrector, steps: Sequence[Step], values: Sequence[Value]
) -> list[tuple[float, Orbit] | None]:
    """Parts of steps at which functions change their signs, and the orbits there."""
    found: list[tuple[float, Orbit] | None] = [None] * len(steps)
    nearest = np.full(len(steps), np.inf)
    at_ends = np.array(
        [[value(x) for x in (s.before, s.after)] for s, value in zip(steps, values, strict=True)]
    )

    def value(parts: Array, which: Any) -> Array:
        tasks = np.ravel(which).astype(int)
        f = at_ends[tasks, np.ravel(parts).astype(int)]
        inner = np.flatnonzero((np.ravel(parts) > 0.0) & (np.ravel(parts) < 1.0))
        some, at = tasks[inner].tolist(), np.ravel(parts)[inner].tolist()
        orbits = orbits_at(corrector, [steps[k] for k in some], at) if some else []
        for i, k, s, orbit in zip(inner.tolist(), some, at, orbits, strict=True):
            f[i] = np.nan if orbit is None else values[k](orbit)
            if orbit is not None and abs(f[i]) <= nearest[k]:
                nearest[k], found[k] = abs(f[i]), (s, orbit)
        return np.asarray(f.reshape(np.shape(parts)))

    inside = np.flatnonzero(np.abs(at_ends[:, 0]) > LOCATED) if len(steps) else np.empty(0, int)
    for k in set(range(len(steps))) - set(inside.tolist()):
        found[k] = 0.0, steps[k].before
    if len(inside):
        tolerances = {"xatol": LOCATED, "xrtol": 0.0, "fatol": 0.0, "frtol": 0.0}
        ends = np.zeros(len(inside)), np.ones(len(inside))
        elementwise.find_root(value, ends, args=(inside.astype(float),), tolerances=tolerances)
    return found
