"""Where motions are, and the windows of them recorded last: columns, a row per point."""

import math

import numpy as np
from numpy.typing import NDArray

from gapsweep.response.ensemble import Call, Ensemble
from gapsweep.response.lists import Lists
from gapsweep.response.loads import contact_shares
from gapsweep.response.section import DEVIATIONS
from gapsweep.status import Status

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Numbers = NDArray[np.intp]


class Walks:
    """Motions that advance by whole forcing periods, all scenes of an ensemble.

    Attributes
    ----------
    y : ndarray, shape (2, n)
        States [m], [m/s], at forcing phase zero.
    status : ndarray of int, shape (n,)
        `Status` values.
    n_periods : ndarray of int, shape (n,)
        Forcing periods since the start.
    section : ndarray of complex, shape (n, longest window so far)
        Section points of the windows [m], the first `length` of each row.
    length : ndarray of int, shape (n,)
    reach : ndarray, shape (n,)
        Largest displacements of the windows [m].
    extrema : Lists
        Displacements [m] of the zero-velocity points of a window recorded with all events.
    contact_share : ndarray, shape (n,)
        Share of that window's time spent beyond the walls [-].
    """

    def __init__(self, ensemble: Ensemble, y: Array) -> None:
        n = len(ensemble.omega)
        self.ensemble, self.y = ensemble, y
        self.status = np.full(n, int(Status.OK))
        self.n_periods, self.length = np.zeros(n, np.int64), np.zeros(n, np.int64)
        self._steps_per_period, self._extent = np.ones(n), np.zeros(n)
        self.section = np.empty((n, 0), complex)
        self.reach = np.abs(y[0])
        self.extrema, self.contact_share = Lists(n), np.full(n, np.nan)

    @property
    def t(self) -> Array:
        """Times since the start [s]."""
        return np.asarray(self.n_periods / self.ensemble.omega)

    @property
    def step_error(self) -> Array:
        """What the solver's tolerances admit in a step [m]."""
        solver = self.ensemble.solver
        return np.asarray(solver.atol + solver.rtol * self.reach)

    def noise(self, n_periods: Counts | int = 1) -> Array:
        """Predicted scatter [m] of section points so many forcing periods apart.

        It is what the solver's tolerances admit in each step, in as many random steps as it
        takes. What scatters more than `same` is not the solver's doing.
        """
        return self.step_error * np.sqrt(self._steps_per_period * n_periods)

    @property
    def same(self) -> Array:
        """Distances [m] below which two states are the same to this solver."""
        return DEVIATIONS * self.noise()

    def window(self, point: int) -> NDArray[np.complex128]:
        """Section points [m] of one window."""
        return self.section[point, : self.length[point]]

    def forget(self, points: Numbers) -> None:
        """Start empty windows here."""
        self.length[points], self._extent[points] = 0, 0.0
        self.reach[points] = np.abs(self.y[0, points])

    def advance(
        self,
        points: Numbers,
        n_periods: Counts,
        recorded: NDArray[np.bool_],
        *,
        section_only: bool = True,
    ) -> None:
        """Go on for whole periods; what is recorded is added to the windows."""
        record_from = np.where(recorded, 0.0, math.inf)
        y = self.y[:, points]
        call = self.ensemble.call(points, y, n_periods, record_from, section_only=section_only)
        if not section_only:
            self.extrema.put(points, call.events.extrema, call.events.n_extrema)
            walls = self.ensemble.walls[:, points]
            self.contact_share[points] = contact_shares(call, y[0], walls, closed=False)
        self._steps_per_period[points] = np.maximum(call.n_steps / n_periods, 1.0)
        if recorded.any():
            self._add(points[recorded], np.flatnonzero(recorded), call)
        self.arrive(points, call.y, call.status, n_periods)

    def _add(self, points: Numbers, motions: Numbers, call: Call) -> None:
        """Add recorded motions of a call to the windows of their points."""
        self._extent[points] = np.maximum(self._extent[points], call.reach[motions])
        new = np.diff(call.period_ends)[motions]
        room = int((self.length[points] + new).max()) - self.section.shape[1]
        if room > 0:
            self.section = np.pad(self.section, ((0, 0), (0, room)))
        # Events stand motion by motion, and motions that were not recorded have none.
        column = np.arange(new.sum()) - np.repeat(np.cumsum(new) - new, new)
        self.section[np.repeat(points, new), np.repeat(self.length[points], new) + column] = (
            call.section
        )
        self.length[points] += new

    def arrive(self, points: Numbers, y: Array, status: Counts, n_periods: Counts) -> None:
        """Be at states that whole periods of motion led to."""
        self.y[:, points], self.status[points] = y, status
        self.n_periods[points] += n_periods
        self.reach[points] = np.maximum(self._extent[points], np.abs(y[0]))
