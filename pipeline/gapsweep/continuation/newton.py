"""Newton's method for orbits on hyperplanes, many at a time."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.continuation import thresholds as limit
from gapsweep.continuation.orbits import Evaluation, Orbit, Reference

Array = NDArray[np.float64]


class Corrector:
    """Newton's method on hyperplanes, many orbits at a time."""

    def __init__(self, equations: Any) -> None:
        self.equations = equations
        self._is_conservative = equations.family.is_conservative

    def orbits(
        self, guess: Array, direction: Array, reference: Reference, furthest: Array
    ) -> tuple[list[Orbit | None], NDArray[np.int64]]:
        """Orbits on hyperplanes through guesses, None where none is found, and Newton's steps.

        Directions are the normals, shape (m, d); the search ends at the furthest distance from the
        guess.
        """
        u, m = guess.copy(), len(guess)
        found: list[Orbit | None] = [None] * m
        n_steps, last = np.zeros(m, np.int64), np.full(m, np.inf)
        left = np.arange(m)
        for _ in range(limit.NEWTON_STEPS):
            if not left.size:
                break
            here = reference.take(left)
            equations = self.equations.evaluate(u[left], here)
            off = ((u[left] - guess[left]) * direction[left]).sum(axis=1)
            step, tangent = self._solved(equations, off, direction[left])
            length = np.sqrt((step**2).sum(axis=1))
            is_ok = equations.is_ok & np.isfinite(length)
            near = np.clip(limit.NEAR * furthest[left], limit.ROUNDING, limit.CLOSED)
            is_best = (length <= limit.NEARLY * furthest[left]) & (
                length > limit.SHRINKS * last[left]
            )
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
            goes_on &= ~(length > limit.WIDER * last[left])
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
