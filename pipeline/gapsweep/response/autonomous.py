"""Autonomous motions on a Poincaré section: the maxima of the first coordinate.

A period is a return to the section here, of any duration. The Poincaré map has one multiplier less
than the motion: without the multiplier 1 along the motion.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.motions import Motions
from gapsweep.integrate.problem import Models, Solver
from gapsweep.response.ensemble import ASTRAY, AT_REST, Ensemble
from gapsweep.response.equilibrium import Rates
from gapsweep.response.section import norm, reach_of
from gapsweep.response.thresholds import FARTHER, FIRST_WINDOW, PERSISTENCE, REST
from gapsweep.response.window_call import Call
from gapsweep.status import Status

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Mask = NDArray[np.bool_]
Numbers = NDArray[np.intp]

# Factors of the expected time that a motion may take to return at first and in each further try,
# and number of tries.
_MARGIN, _LONGER, _TRIES = 1.1, 4.0, 5
# Maxima of a coordinate that moves by less than this share of the motion are rounding errors.
_FAINT = 1e-10
_MOST_RETURNS = 2**18  # recorded at a time: some tens of megabytes
_FIRST = 16  # returns from which their rate is computed
# A state this close to the section, as a share of the amplitude, is on it.
_ON = 1e-10
_BEYOND = 1e-10  # of the time, by which the last maximum is passed to be recorded


class Returned(Call):
    """Motions of one call of the engine, up to a return to the section.

    Parameters
    ----------
    passings : tuple of ndarray, shape (number of returns, n_states), and ndarray of int, shape (n,)
    speed : ndarray, shape (n_states, n)
        Time derivatives of the end states, as section points [m/s].
    swing : ndarray, shape (n,)
        Amplitude of the motions [m].
    normal : int
        Component of a state that is zero on the section.
    *given
        As in `Call`.
    """

    def __init__(
        self,
        passings: tuple[Array, Counts],
        speed: Array,
        swing: Array,
        normal: int,
        *given: Any,
    ) -> None:
        super().__init__(*given)
        self._passings, self._speed, self._normal = passings, speed, normal
        self.swing = swing

    @property
    def passings(self) -> tuple[Array, Counts]:
        return self._passings

    @property
    def monodromy(self) -> Array:
        # Disturbances off the section are projected along the motion back onto it.
        across = self.tangent[:, self._normal, :]
        with np.errstate(all="ignore"):  # for motions that failed, or are at rest
            along = (self._speed / self._speed[self._normal]).T
            return np.asarray(self.tangent - along[:, :, None] * across[:, None, :])

    @property
    def determinant(self) -> Array:
        return np.zeros(len(self.t_end))


class PoincareMap(Ensemble):
    """Ensemble of autonomous systems; in all methods a period is a return to the section."""

    is_chained = False  # only the call itself finds the times of returns

    def __init__(self, models: Models, solver: Solver, start: Array) -> None:
        super().__init__(models, solver)
        self._rates = Rates(models)
        self.n_multipliers -= 1
        self.has_families = self.settling_rate == 0.0
        self._rate = self.omega.copy()  # returns per second in the last call
        # Time is counted in returns, not in periods of the slowest mode.
        n = np.full(len(models), _FIRST)
        every, kept = np.arange(len(models)), np.zeros(len(models), bool)
        found, (_, counts) = self._returned(every, start, n, kept, is_shot=False)
        self._rate = np.divide(n, found.t, out=self._rate, where=counts == _FIRST)
        self.set_clock(self._rate.copy())

    def call(
        self,
        scenes: Numbers,
        y: Array,
        n_periods: Counts,
        record_from: Array,
        *,
        section_only: bool = True,
        tangent: bool = False,
        follows: Mask | None = None,
    ) -> Call:
        assert follows is None
        normal, swing = self.n_coordinates, norm(y / self.unit[:, scenes])
        off = np.abs(y[normal]) / self.unit[normal, scenes]
        y = y.copy()
        y[normal, off <= _ON * swing] = 0.0
        is_recorded = np.isfinite(record_from)
        found, passings = self._returned(scenes, y, n_periods, is_recorded, is_shot=tangent)
        is_back, t_end = passings[1] >= n_periods, found.t
        # A motion that starts where it counts as diverged takes no time.
        rate = np.divide(n_periods, t_end, out=self._rate[scenes], where=t_end > 0.0)
        if not tangent:  # shots may lead anywhere
            self._rate[scenes[is_back]] = rate[is_back]
        tangents: tuple[Array | None, Array] = None, found.state.T
        if tangent or not section_only:
            beyond = t_end if tangent else t_end * (1.0 + _BEYOND)
            again, tangents = self._run(
                scenes, y, t_end * self.omega[scenes], beyond, record_from,
                section_only=section_only, tangent=tangent, is_motion=False,
            )  # fmt: skip
            found = replace(again, t=t_end, state=found.state, status=found.status)
        passings = passings[0], np.where(is_recorded, passings[1], 0)
        speed = self._speed(scenes, found.state.T)
        swing = norm(speed) / (2.0 * math.pi * self.omega[scenes])
        faint = np.abs(speed[normal]) <= _FAINT * norm(speed)
        is_ok, at_rest = found.status == Status.OK, swing <= REST * self.swing[scenes]
        found.status[is_ok & (faint | ~is_back)] = ASTRAY
        found.status[is_ok & at_rest] = AT_REST
        given = self.unit[:, scenes], rate, t_end, self._shrinks(scenes), *tangents
        return Returned(passings, speed, swing, normal, found, *given)

    def duration(self, n_periods: Counts, elapsed: Array) -> Array:
        return elapsed  # returns have no fixed duration

    def bounded_transient(self, transient: Counts, n_periods: Counts) -> Counts:
        # When a motion grows, damping about the equilibrium does not predict the transient.
        return np.minimum(transient, np.maximum(n_periods, FIRST_WINDOW))

    def stays_bounded(self, scenes: Numbers, y: Array) -> Mask:
        """Motions that do not exceed their largest displacement so far twice in succession.

        Unbounded growth amplifies disturbances as chaos does; chaos exceeds its largest
        displacement by chance, but hardly twice.
        """
        stays, y, left = np.ones(len(scenes), bool), y.copy(), np.arange(len(scenes))
        for n_returns in (PERSISTENCE, 4 * PERSISTENCE):
            if not left.size:
                break
            at, n = scenes[left], np.full(len(left), n_returns)
            before = self.swing[at]
            call = self.call(at, y[:, left], n, np.full(len(left), np.inf))
            farther, y[:, left] = self.swing[at] > FARTHER * before, call.y
            stays[left] = call.is_ok & ~farther
            left = left[call.is_ok & farther]
        return stays

    def _returned(
        self, scenes: Numbers, y: Array, n: Counts, kept: Mask, *, is_shot: bool
    ) -> tuple[Motions, tuple[Array, Counts]]:
        """Return motions up to their n-th return, section states of those `kept`, and all counts.

        Motions are integrated in parts, because all their returns are recorded.
        """
        t_end, states = _MARGIN * n / self._rate[scenes], [np.empty((0, len(y)))] * len(scenes)
        counts, left = np.zeros(len(scenes), np.int64), np.arange(len(scenes))
        columns: dict[str, Any] = {}
        for _ in range(_TRIES):
            parts = np.flatnonzero(np.diff((np.cumsum(n[left]) - 1) // _MOST_RETURNS)) + 1
            left_over = []
            for some in np.split(left, parts):
                which, from_start = scenes[some], np.zeros(len(some))
                expected = t_end[some] * self.omega[which]
                run, _ = self._run(
                    which, y[:, some], expected, t_end[some], from_start,
                    section_only=True, tangent=False, is_motion=not is_shot,
                )  # fmt: skip
                events = run.events()
                first = np.cumsum(events.n_section) - events.n_section
                is_back = events.n_section >= n[some]
                last = (first + n[some] - 1)[is_back]
                run.t[is_back], run.state[is_back] = events.t_section[last], events.section[last]
                run.status[is_back] = Status.OK
                run.t[run.t == 0.0] = t_end[some][run.t == 0.0]  # not begun in time
                for name in ("t", "state", "status", "reach", "n_steps"):
                    values = getattr(run, name)
                    whole = np.zeros((len(scenes), *values.shape[1:]), values.dtype)
                    columns.setdefault(name, whole)[some] = values
                counts[some] = np.minimum(events.n_section, n[some])
                for k in np.flatnonzero(kept[some]).tolist():
                    end = first[k] + counts[some[k]]
                    states[some[k]] = events.section[first[k] : end].copy()
                swing = norm(self._speed(which, run.state.T)) / (2.0 * math.pi * self.omega[which])
                if not is_shot:  # shots may lead anywhere
                    reach = reach_of(run.reach.T, self.unit[:, which])
                    self.swing[which] = np.maximum(self.swing[which], reach)
                goes_on = (run.status == Status.OK) & (swing > REST * self.swing[which])
                left_over.append(some[~is_back & goes_on])
            left = np.concatenate(left_over)
            if not left.size:
                break
            t_end[left] *= _LONGER
        return replace(run, **columns), (np.concatenate(states), counts)

    def _speed(self, scenes: Numbers, y: Array) -> Array:
        """Time derivatives of states, as section points [m/s]."""
        return np.asarray(self._rates(scenes, y) / self.unit[:, scenes])
