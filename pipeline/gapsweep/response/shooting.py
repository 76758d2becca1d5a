"""Periodic orbits by Newton shooting, and their Floquet multipliers.

The tangent equations carry the monodromy matrix along with the motion. The contact force is
continuous, so nothing jumps at a contact. The product of the multipliers over n periods T is
``exp(-r n T)`` for all forces that depend on positions only: r is ``2 ζ ω_n`` for an oscillator,
for a system ``tr(M⁻¹C) - tr H``.

All data are columns with a row per point: numpy needs more time for one small matrix than the
engine for its motion. No row depends on the others.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.motions import VANISHED
from gapsweep.response import thresholds as limit
from gapsweep.response.compiled import judge_steps, largest_parts, multiplier_pairs
from gapsweep.response.ragged import spans
from gapsweep.response.window_call import Call

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Mask = NDArray[np.bool_]
Numbers = NDArray[np.intp]


class NewtonShooting:
    """Newton's method on the map over n forcing periods, from a state near the orbit.

    Attributes
    ----------
    y : ndarray, shape (n_states, n_points)
        Present states of the iteration; states on the orbit if one is found.
    n : ndarray of int, shape (n_points,)
        Forcing periods of the orbits.
    multipliers : ndarray of complex, shape (n_points, n_states)
        Floquet multipliers over n periods of an orbit that was found, largest modulus first.
    n_multipliers : int
        Number of multipliers; further eigenvalues of a Poincaré map are zero.
    omega : ndarray, shape (n_points,)
        Section points per second [Hz] on an orbit that was found.
    section : ndarray, shape (n_states, n_points, longest orbit so far)
        Section points [m] of orbits that were found, the first `n` of each row.
    last_step : ndarray, shape (n_points,)
        Length of the last Newton step [m].
    """

    def __init__(self, n_states: int, n_points: int, n_multipliers: int) -> None:
        self.y, self.n_multipliers = np.empty((n_states, n_points)), n_multipliers
        self.n = np.zeros(n_points, np.int64)
        self.multipliers = np.zeros((n_points, n_states), complex)
        self.omega = np.full(n_points, np.nan)
        self.section = np.empty((n_states, n_points, 0))
        self._moved, self._tries = np.zeros_like(self.y), np.zeros(n_points, np.int64)
        # _apart: distance of the ends
        rows = self.last_step, self._apart, self._goal, self._noise, self._furthest = np.zeros(
            (5, n_points)
        )
        self._columns = self._moved, self._tries, *rows
        # By point: an orbit that was found, while shooting tries a part of its period.
        self._whole: dict[int, tuple[Any, ...]] = {}

    def start(
        self, points: Numbers, y: Array, n: Counts, goal: Array, noise: Array, furthest: Array
    ) -> None:
        """Start shooting from states near orbits.

        `points`: shape (m,).
        `y`: shape (n_states, m).
        `n`: shape (m,).
        `goal`: shape (m,); Newton step [m] at which the orbit counts as found.
        `noise`: shape (m,); distance [m] of an orbit's ends that solver noise may cause, if no step
        is shorter than `goal`.
        `furthest`: shape (m,); distance [m] from `y` beyond which shooting stops.
        """
        self.y[:, points], self.n[points] = y, n
        self._goal[points], self._noise[points], self._furthest[points] = goal, noise, furthest
        self._moved[:, points], self._tries[points] = 0.0, 0
        self.last_step[points] = self._apart[points] = np.inf
        for k in points.tolist():
            self._whole.pop(k, None)

    def shorten(self, points: Numbers, n: Counts, *, is_scattered: bool) -> None:
        """Restart shooting at orbits that were found, over fewer forcing periods.

        The shorter orbit must close much better than the parts of the whole one agree, or as well
        as the whole one closed: predicted noise may hide a doubled period. If it does not, the
        whole orbit is kept (`restore`). With a solver that scatters sections there is no such test.
        """
        kept = [] if is_scattered else zip(points.tolist(), n.tolist(), strict=True)
        for k, part in kept:
            section = self.section[:, k, : self.n[k]].copy()
            of_point = self.y[:, k].copy(), self.n[k], self.multipliers[k].copy(), self.omega[k]
            self._whole[k] = *of_point, section
            rolled = np.concatenate([section[:, -part:], section[:, :-part]], axis=1)
            unlike = np.abs(section - rolled).max()
            least = limit.ROUNDING * np.abs(section).max()
            self._goal[k] = min(self._goal[k], max(limit.PART_CLOSES * unlike, least))
            self._noise[k] = limit.AS_GOOD * self._apart[k]
        self.n[points], self._tries[points] = n, 0
        self.last_step[points] = self._apart[points] = np.inf

    def restore(self, points: Numbers) -> Mask:
        """Restore the whole orbits of points that tried parts of their periods; True for these."""
        is_part = np.array([k in self._whole for k in points.tolist()], bool)
        for k in points[is_part].tolist():
            self.y[:, k], self.n[k], self.multipliers[k], self.omega[k], section = self._whole.pop(
                k
            )
            self.section[:, k, : self.n[k]] = section
        return is_part

    def modulus(self, points: Numbers) -> Array:
        """Return the largest moduli of multipliers [-], at least 1e-12."""
        return np.asarray(np.maximum(np.abs(self.multipliers[points, 0]), 1e-12))

    def parts(self, points: Numbers, tolerance: Array) -> Counts:
        """Periods of the largest part after which each orbit repeats, or of the whole orbit.

        `points`: shape (m,); points with an orbit.
        `tolerance`: shape (m,); distances [m] within which two section points are the same.
        """
        return np.asarray(largest_parts(self.section, self.n, points, tolerance))

    def step(self, points: Numbers, call: Call) -> tuple[Mask, Mask]:
        """Do one step of Newton's method from the motions of a call.

        Parameters
        ----------
        points : ndarray of int, shape (m,)
            Points of the motions of the call, in this order.

        Returns
        -------
        is_found, is_lost : ndarray of bool, shape (m,)
            Points that have found their orbit, and points without one: their iteration went too
            far, did not converge or approached an equilibrium, or the motion failed.
        """
        y = self.y[:, points]
        with np.errstate(over="ignore", invalid="ignore"):  # for motions that failed
            missed = np.ascontiguousarray(((call.y - y) / call.unit).T)
            steps = newton_steps(call.monodromy, missed)
            multipliers = floquet_multipliers(call.monodromy, call.determinant)
            modulus, swing = np.abs(multipliers[:, 0]), np.full(len(points), call.swing)
            is_found, goes_on = judge_steps(
                points, missed, steps, modulus, call.is_ok, call.is_sound, swing, self._columns
            )
        if is_found.any():
            self._keep(points, is_found.nonzero()[0], multipliers, call)
        if goes_on.any():
            self.y[:, points[goes_on]] = (y + steps.T * call.unit)[:, goes_on]
        return is_found, ~(is_found | goes_on)

    def _keep(self, points: Numbers, found: Numbers, multipliers: Any, call: Call) -> None:
        points = points[found]
        self.multipliers[points], self.omega[points] = multipliers[found], call.omega[found]
        first, n = call.period_ends[found], self.n[points]
        room = int(n.max()) - self.section.shape[2]
        if room > 0:
            more = np.zeros((*self.section.shape[:2], room))
            self.section = np.concatenate([self.section, more], axis=2)
        self.section[:, np.repeat(points, n), spans(np.zeros_like(n), n)] = call.section[
            :, spans(first, n)
        ]


def newton_steps(monodromy: Array, moved: Array) -> Array:
    """Newton steps from initial states to fixed points of their maps; infinite if none is near.

    `monodromy`: shape (n, n_states, n_states); derivatives of end states with respect to initial
    states, as section points.
    `moved`: shape (n, n_states); ends minus starts, as section points [m].
    Result: shape (n, n_states).
    """
    matrices = np.eye(moved.shape[1]) - monodromy
    try:
        return np.asarray(np.linalg.solve(matrices, moved[:, :, None])[:, :, 0])
    except np.linalg.LinAlgError:
        return np.array(list(map(_solution, matrices, moved)))


def _solution(matrix: Array, right: Array) -> Array:
    try:
        return np.asarray(np.linalg.solve(matrix, right))
    except np.linalg.LinAlgError:
        return np.full(len(right), np.inf)


def floquet_multipliers(monodromy: Array, determinant: Array) -> NDArray[np.complex128]:
    """Eigenvalues of monodromy matrices, largest modulus first; NaN where the tangent overflowed.

    With two states, both follow from the trace and the determinant, which damping determines: a
    determinant computed from the matrix would be lost in rounding if the two differ much, and with
    it the smaller one. With more states, small eigenvalues are lost in rounding of the largest one.
    Eigenvalues below the smallest normal numbers are zero.

    `monodromy`: shape (n, n_states, n_states).
    `determinant`: shape (n,); exact determinants, >= 0.
    Result: shape (n, n_states).
    """
    if monodromy.shape[1] == 2:
        return np.asarray(multiplier_pairs(np.ascontiguousarray(monodromy), determinant))
    is_finite = np.asarray(np.isfinite(monodromy).all(axis=(1, 2)))
    found = np.linalg.eigvals(np.where(is_finite[:, None, None], monodromy, 0.0)).astype(complex)
    order = np.argsort(-np.abs(found), axis=1, kind="stable")
    found = np.take_along_axis(found, order, axis=1)
    found[np.abs(found) < VANISHED] = 0.0
    found[~is_finite] = complex(np.nan, np.nan)
    return found
