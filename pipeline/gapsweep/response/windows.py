"""Motions of many points and their recording windows: columns, a row per point."""

import math

import numpy as np
from numpy.typing import NDArray

from gapsweep.response.ensemble import Ensemble
from gapsweep.response.loads import contact_shares
from gapsweep.response.ragged import RaggedArrays, spans
from gapsweep.response.section import reach_of
from gapsweep.response.thresholds import DEVIATIONS
from gapsweep.response.window_call import Call
from gapsweep.status import Status

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Numbers = NDArray[np.intp]


class RecordedWindows:
    """Motions of all cases of an ensemble, which advance by whole periods, with their windows.

    Attributes
    ----------
    y : ndarray, shape (n_states, n)
        States at forcing phase zero.
    status : ndarray of int, shape (n,)
        `Status` values.
    n_periods : ndarray of int, shape (n,)
        Forcing periods since the initial time.
    section : ndarray, shape (n_states, n, longest window so far)
        Section points of the windows [m], the first `length` of each row.
    length : ndarray of int, shape (n,)
    reach : ndarray, shape (n,)
        Largest displacements of the windows, as section points [m].
    n_turning : int
        Number of quantities whose extrema are recorded: coordinates, then a system's gaps.
    extrema : RaggedArrays
        Zero-velocity points [m] of a window recorded with all events; `n_turning` lists a case.
    contact_share : ndarray, shape (n_contacts, n)
        Share of that window's time in which each contact's force acts [-].
    contact_force : ndarray, shape (n_contacts, n)
        Largest forces [N] in that window of contacts that lose energy; NaN: they follow from the
        extrema.
    contacts_per_period : ndarray, shape (n,)
        Contacts in that window per forcing period, or per section point of an unforced system [-].
    """

    def __init__(self, ensemble: Ensemble, y: Array) -> None:
        n = len(ensemble.omega)
        self.ensemble, self.y = ensemble, y
        self.status = np.full(n, int(Status.OK))
        self.n_periods, self.length = np.zeros(n, np.int64), np.zeros(n, np.int64)
        self._steps_per_period, self._extent = np.ones(n), np.zeros(n)
        self.section = np.empty((len(y), n, 0))
        self.reach = self._place(np.arange(n))
        self.n_turning = len(ensemble.turning(np.arange(n), y))
        self._elapsed, self.extrema = np.zeros(n), RaggedArrays(n * self.n_turning)
        self.contact_share = np.full(ensemble.walls.shape[1:], np.nan)
        self.contact_force = np.full(ensemble.walls.shape[1:], np.nan)
        self.contacts_per_period = np.full(n, np.nan)

    @property
    def t(self) -> Array:
        """Times since the initial one [s]."""
        return self.ensemble.duration(self.n_periods, self._elapsed)

    def step_error(self, points: Numbers) -> Array:
        """Errors of a step that the solver's tolerances allow [m]."""
        allowed = self.ensemble.solver.rtol * self.reach[points]
        return np.asarray(self.ensemble.atol[points] + allowed)

    def noise(self, points: Numbers, n_periods: Counts | int = 1) -> Array:
        """Predicted scatter [m] of section points `n_periods` forcing periods apart.

        It is the sum of the allowed errors of all steps in random directions. Scatter larger than
        `resolution` is not due to the solver.
        """
        return self.step_error(points) * np.sqrt(self._steps_per_period[points] * n_periods)

    def resolution(self, points: Numbers) -> Array:
        """Distances [m] below which two states are equal within the noise of the solver."""
        return DEVIATIONS * self.noise(points)

    def _place(self, points: Numbers) -> Array:
        """Return the largest moduli of the present displacements, as section points [m]."""
        unit = self.ensemble.unit[:, points]
        return reach_of(self.y[: self.ensemble.n_coordinates, points], unit)

    def rows(self, points: Numbers) -> Numbers:
        """Return the numbers of the lists of extrema of some cases, case after case."""
        return (points[:, None] * self.n_turning + np.arange(self.n_turning)).ravel()

    def has_extrema(self, points: Numbers) -> NDArray[np.bool_]:
        """Whether a window of cases was recorded with all events."""
        return np.asarray(self.extrema.counts[points * self.n_turning] >= 0)

    def discard_extrema(self, points: Numbers) -> None:
        """Discard recorded extrema of windows that turned out not to be the last."""
        self.extrema.counts[self.rows(points)] = -1

    def window(self, point: int) -> Array:
        """Section points [m] of one window, shape (n_states, length)."""
        return self.section[:, point, : self.length[point]]

    def clear(self, points: Numbers) -> None:
        """Discard section points; `reach` becomes that of the present states. Extrema are kept."""
        self.length[points], self._extent[points] = 0, 0.0
        self.reach[points] = self._place(points)

    def integrate(
        self, points: Numbers, transient: Counts, window: Counts, *, section_only: bool = True
    ) -> None:
        """Integrate transients, then periods that are added to the windows; either may be zero."""
        # The motions of a call: for each point a transient, a window, or both in succession.
        both = np.array((transient, window)).T
        of, part = both.nonzero()
        recorded = part == 1
        follows = recorded & (transient > 0)[of]
        last = (recorded | (window == 0)[of]).nonzero()[0]
        scenes, n_periods = points[of], both[of, part]
        call = self.ensemble.call(
            scenes, self.y[:, scenes], n_periods, np.where(recorded, 0.0, math.inf),
            section_only=section_only, follows=follows if follows.any() else None,
        )  # fmt: skip
        if not section_only:
            extrema, counts = self.extrema_of(call)
            self.extrema.put(self.rows(points), extrema, counts.ravel())
            self.keep_loads(points, self.y[:, points], call, n_periods)
        if recorded.any():
            self._add(scenes[recorded], recorded.nonzero()[0], call)
        self._elapsed[points] += np.bincount(of, call.t_end)
        if not call.is_ok.all():
            # A motion that failed in its transient keeps the state of the failure.
            first = last - follows[last]
            last = np.where(call.is_ok[first], last, first)
            # A failed motion ended within a period, and the motion that follows it was not begun.
            lasted = np.where(call.is_ok, n_periods, np.ceil(call.t * call.omega))
            transient, window = np.bincount(of, lasted).astype(np.int64), np.zeros_like(window)
        self._steps_per_period[points] = np.maximum(call.n_steps[last] / n_periods[last], 1.0)
        self.move_to(points, call.y[:, last], call.status[last], transient + window)

    def keep_loads(
        self, points: Numbers, y: Array, call: Call, n_periods: Counts, *, closed: bool = False
    ) -> None:
        """Keep contact shares, contacts per period and, of contacts that lose energy, forces.

        Parameters are those of `contact_shares`, and the number of periods of each motion.
        """
        self.contact_share[:, points] = contact_shares(
            self.ensemble, points, y, call, closed=closed
        )
        self.contacts_per_period[points] = 0.5 * call.n_contacts / n_periods
        if call.contact_force is not None:
            self.contact_force[:, points] = call.contact_force.T

    def extrema_of(self, call: Call) -> tuple[Array, Counts]:
        """Zero-velocity points [m] of a call, and their number for each motion's quantities.

        Returns
        -------
        extrema : ndarray
            By motion, then by quantity, then in the order of time.
        counts : ndarray of int, shape (n, n_turning)
        """
        events, n = call.events, self.n_turning
        if n == 1:
            return events.extrema, events.n_extrema[:, None]
        row = np.repeat(np.arange(len(events.n_extrema)), events.n_extrema) * n + events.extrema_of
        counts = np.bincount(row, minlength=len(events.n_extrema) * n).reshape(-1, n)
        return events.extrema[np.lexsort((events.t_extrema, row))], counts

    def _add(self, points: Numbers, motions: Numbers, call: Call) -> None:
        """Add recorded motions of a call to the windows of their points."""
        self._extent[points] = np.maximum(self._extent[points], call.reach[motions])
        new = call.passings[1][motions]
        room = int((self.length[points] + new).max()) - self.section.shape[2]
        if room > 0:
            more = np.zeros((*self.section.shape[:2], room))
            self.section = np.concatenate([self.section, more], axis=2)
        rows, columns = np.repeat(points, new), spans(self.length[points], new)
        # Events are sorted by motion, and motions that were not recorded have none.
        self.section[:, rows, columns] = call.section
        self.length[points] += new

    def move_to(self, points: Numbers, y: Array, status: Counts, n_periods: Counts) -> None:
        """Set the states and status of points after `n_periods` more periods."""
        self.y[:, points], self.status[points] = y, status
        self.n_periods[points] += n_periods
        self.reach[points] = np.maximum(self._extent[points], self._place(points))
