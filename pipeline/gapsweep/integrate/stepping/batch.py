"""Integration of many points at once: arrays in, arrays and event lists out.

The compiled engine behind ``simulate(..., engine="compiled")``. `scenes` prepares one table row per
system, `run` writes initial states into copies of the rows, runs `loop.advance` on them and empties
its buffers.
"""

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.integrate.lanes.method import Method
from gapsweep.integrate.lanes.row_layout import RowLayout, aligned
from gapsweep.integrate.lanes.scene_table import SceneTable, check, set_modes_on_walls
from gapsweep.integrate.lanes.start_rows import BACKWARD, NOT_FINITE, ON_WALL, set_starts
from gapsweep.integrate.problem import Problems, is_late
from gapsweep.model.contact_modes import HOLD, ON
from gapsweep.status import DIVERGED_AT, Status

from . import record
from .loop import (
    BUDGET_SPENT,
    BUFFER_FULL,
    FINISHED,
    OK,
    RUNNING,
    LoopState,
    advance,
    advance_users,
)
from .roots import work_space
from .sample import sample_steps

Array = NDArray[np.float64]

# Crossings in a row, each within 1e-6 rad of the fastest oscillation, that end a point as chatter.
MOST_SHORT = 100.0
_LOG_VALUES = 1 << 16  # of a log: it stays in the cache until it is emptied
MOST_PLACED = 1 << 22  # section points for which rows are reserved before the motions begin
# Outcomes that become OUT_OF_FIT_RANGE if the motion has left the range of a fit.
_OF_MOTIONS = (Status.OK, Status.DIVERGED, Status.STEP_UNDERFLOW)
# Vector steps per call of the kernel, about 20 ms, between which time limits and Ctrl-C are
# answered. Users' laws may be slow: their calls grow while they are short.
_BUDGET, _USERS_BUDGET, _SHORT_CALL = 1 << 16, 1 << 10, 0.1  # s


class WorkSpace:
    """Arrays that a thread's runs of one layout use, one run after the other.

    Attributes
    ----------
    lanes, coefficients, lane_point, progress, fill, work
        As in `LoopState`.
    """

    def __init__(self, at: RowLayout) -> None:
        self.lanes = aligned(at.n_rows, at.width)
        self.coefficients = aligned(at.n_coefficients, at.width)
        self.lane_point = np.empty(at.width, np.int64)
        self.progress, self.fill = np.empty(2, np.int64), np.empty(len(record.LOGS), np.int64)
        self.work = work_space(at.order, at.contacts)
        per_step, widths = record.rows_per_step.py_func(at), _log_columns(at)
        self._sizes = [
            (max(_LOG_VALUES // columns, rows), columns)
            for columns, rows in zip(widths, per_step, strict=True)
        ]
        self._logs: list[Array] = [np.empty((0, columns)) for columns in widths]

    def logs(self, kept: Sequence[bool], n_sections: int) -> tuple[Array, ...]:
        """Return the logs, without rows if not `kept`; `n_sections`: reserved rows, -1: none."""
        for log in record.LOGS:
            if kept[log] and not len(self._logs[log]):
                self._logs[log] = np.empty(self._sizes[log])
        found = [log if is_kept else log[:0] for log, is_kept in zip(self._logs, kept, strict=True)]
        if n_sections >= 0 and kept[record.SECTIONS]:
            found[record.SECTIONS] = np.empty((n_sections, self._sizes[record.SECTIONS][1]))
        return tuple(found)


class _WorkSpaces(threading.local):
    """The work spaces of a thread, by layout."""

    def __init__(self) -> None:
        self.of: dict[RowLayout, WorkSpace] = {}


_SPACES = _WorkSpaces()


@dataclass(slots=True, eq=False)  # creating a frozen one takes three times as long
class Batch:
    """Outcome of `run`; arrays of shape (n,) unless noted, one entry per point.

    Attributes
    ----------
    at : RowLayout
    points : ndarray, shape (n, n_rows)
        Rows of the points at their ends; of failed points, at the failure.
    t_end : ndarray
        Requested ends [s].
    status : ndarray of int
        `gapsweep.status.Status` values.
    n_stages : int
        Stages of the method; 0 for a Taylor series.
    turns, contacts, sections : ndarray, shape (n_events, number of columns)
        Recorded events as in `record`, sorted by point, then in time for each `which`.
    steps : ndarray, shape (n_rows, DENSE_HEAD + (n + m) * n_terms), or None
        Recorded steps (point, start, length, coefficients of q and z), sorted by point and time.
    """

    at: RowLayout
    points: Array = field(repr=False)
    t_end: Array
    status: NDArray[np.int64]
    n_stages: int
    turns: Array = field(repr=False)
    contacts: Array = field(repr=False)
    sections: Array = field(repr=False)
    steps: Array | None = field(repr=False)

    def _rows(self, first: int, n: int) -> Array:
        return self.points[:, first : first + n]

    def _count(self, row: int) -> NDArray[np.int64]:
        return self.points[:, row].astype(np.int64)

    @property
    def state(self) -> Array:
        """States (q, v, z) at the ends, shape (n, n_states)."""
        return self._rows(self.at.q, self.at.n_states)

    @property
    def reach(self) -> Array:
        """Largest moduli of q initially and at the ends of steps, shape (n, n_coordinates)."""
        return self._rows(self.at.reach, self.at.n)

    @property
    def t(self) -> Array:
        """Times reached [s]: `t_end` where the status is OK."""
        if not self.status.any():
            return self.t_end.copy()
        at, table = self.at, self.points.T
        elapsed = table[at.cycle] + (table[at.tau] - table[at.tau_start])
        t = table[at.t_start] + elapsed * table[at.period]
        return np.asarray(np.where(self.status == OK, self.t_end, t))

    @property
    def t_sampled(self) -> Array:
        """Ends of what `sample` covers [s]; a failed motion is not recorded in its last step."""
        found = self.t
        if self.steps is not None and self.status.any():
            last = np.searchsorted(self.steps[:, 0], np.arange(len(found)) + 1) - 1
            for p in np.flatnonzero(self.status).tolist():
                step = self.steps[last[p]] if last[p] >= 0 else [-1]
                found[p] = step[1] + step[2] if step[0] == p else self.points[p, self.at.t_start]
        return found

    @property
    def contact_time(self) -> Array:
        """Times in which the forces of located contacts act [s], shape (n, n_contacts).

        Only where all events are recorded.
        """
        modes = np.abs(self._rows(self.at.mode, self.at.contacts))
        touches = (modes == ON) | (modes == HOLD)
        until_left = self._rows(self.at.contact_time, self.at.contacts)
        return np.asarray(until_left + np.where(touches, self.t[:, None], 0.0))

    @property
    def contact_loss(self) -> Array:
        """Contact loss as in `Motions`, shape (n,)."""
        if not (self.at.is_damped or self.at.has_impacts):
            return np.zeros(len(self.status))
        return self.points[:, self.at.contact_loss].copy()

    @property
    def contact_force(self) -> Array | None:
        """Largest forces of contacts that lose energy, of an oscillator per unit mass; else None.

        Shape (n, n_contacts); only where all events are recorded.
        """
        if not self.at.is_damped:
            return None
        found = self._rows(self.at.contact_force, self.at.contacts)
        if not self.at.has_impacts:
            return found
        return np.where(self._rows(self.at.rigid, self.at.contacts) > 0.0, np.nan, found)

    @property
    def monodromy(self) -> Array | None:
        """Derivatives of end states by initial states, shape (n, n_states, n_states), or None."""
        if not self.at.tangent:
            return None
        n = self.at.n_states
        # columns are the images of unit states
        columns = self._rows(self.at.tangent_state, n * n).reshape(-1, n, n)
        return columns.transpose(0, 2, 1).copy()

    @property
    def columns(self) -> Array | None:
        """Derivatives of end states by parameters, shape (n, n_states, n_columns), or None."""
        at = self.at
        if not at.columns:
            return None
        rows = self._rows(at.column, at.columns * at.column_size)
        return rows.reshape(-1, at.columns, at.column_size)[..., : at.n_states].transpose(0, 2, 1)

    @property
    def n_contacts(self) -> NDArray[np.int64]:
        """Numbers of wall crossings, in and out, each counted once."""
        # Below zero: the motion began on a wall and has not left it.
        return np.maximum(self._count(self.at.n_contacts), 0)

    @property
    def n_steps(self) -> NDArray[np.int64]:
        """Numbers of accepted steps."""
        return self._count(self.at.n_steps)

    @property
    def n_rejected(self) -> NDArray[np.int64]:
        """Numbers of rejected steps."""
        return self._count(self.at.n_rejected) if self.n_stages else np.zeros_like(self.status)

    @property
    def nfev(self) -> NDArray[np.int64]:
        """Right-hand sides of the motions; of a Taylor series, expansions."""
        if not self.n_stages:
            return self.n_steps
        n_tried = self.n_steps + self.n_rejected
        return n_tried * (self.n_stages - 1) + self._count(self.at.n_extra)

    def sample(self, t: ArrayLike) -> Array:
        """States between the steps, from their own series.

        Parameters
        ----------
        t : array_like, shape (n_t,) or (n, n_t)
            Times [s] within the recorded part; one row for all points or one for each.

        Returns
        -------
        ndarray, shape (n_states, n, n_t)

        Raises
        ------
        ValueError
            If the run has no dense output, or a time lies outside the recorded part.
        """
        if self.steps is None:
            raise ValueError("nothing to sample: needs dense_output=True")
        points = np.arange(len(self.status))
        times = np.broadcast_to(t, (len(points), np.shape(t)[-1]))
        first, last = (np.searchsorted(self.steps[:, 0], points + k) for k in (0, 1))
        states, outside = sample_steps(
            self.at.numbers, self.steps, first, last, np.ascontiguousarray(times, dtype=float)
        )
        if outside >= 0:
            raise ValueError(f"a time lies outside the recorded part of point {outside}")
        return np.asarray(states)


def run(
    prepared: SceneTable,
    method: Method,
    problems: Problems,
    queue: NDArray[np.intp],
    *,
    contacts: bool,
) -> Batch:
    """Integrate prepared systems from their initial states.

    Parameters
    ----------
    prepared : SceneTable
    method : Method
        Taylor or RungeKutta, without work space; its rows are in the table.
    problems : Problems
        Their `which` are rows of `prepared`. Initial states are no events: only events after `t_0`
        are recorded. With `dense_output`, every step's series is kept for `Batch.sample`.
    queue : ndarray of int
        Problems that follow no other, in the order in which lanes take them.
    contacts : bool
        Record wall crossings.
    """
    at, n = prepared.at.of_tangent if problems.tangent else prepared.at, len(problems)
    space = _SPACES.of.get(at)
    if space is None:
        space = _SPACES.of[at] = WorkSpace(at)
    dense_output, section_only = problems.dense_output, problems.section_only
    wanted = {"tangent": problems.tangent, "dense": dense_output, "contacts": contacts}
    method = method.with_work_space(at, space.lanes, **wanted)
    points, sections = np.empty((n + 1, at.n_rows)), np.empty((n, 2), np.int64)
    is_next = np.zeros(n + 1, bool)  # whether a point follows the one before
    if problems.follows is not None:
        is_next[:-1] = problems.follows
    times = {name: getattr(problems, name) for name in ("t_0", "t_end", "record_from")}
    given = problems.start, is_next, *times.values(), section_only and not dense_output
    tables = prepared.table, prepared.pieces, problems.which
    outcome, n_sections, is_recording = set_starts(
        at.numbers, points, *tables, *given, sections, prepared.rtol
    )
    if outcome == NOT_FINITE:
        check(start=problems.start, **times)
    if outcome == BACKWARD:
        raise ValueError("t_end lies before t_0")
    if outcome == ON_WALL:
        _set_on_walls(at, points, ~is_next)
    if at.is_tanh and (dense_output or problems.sampled):
        # No layer is crossed in one step: the motion within it is recorded.
        points[:-1, at.layer] = np.inf
    if n_sections < 0:
        sections = sections[:0]
        if not at.is_taylor:  # then a step records no more than one
            points[:, at.h_max] = np.minimum(points[:, at.h_max], points[:, at.period])
    # The section of an unforced motion is at extrema, which are then always searched for.
    has_events = is_recording and (not section_only or dense_output or at.is_free)
    kept = has_events, has_events and contacts, is_recording, dense_output
    space.lane_point.fill(-2)
    space.progress.fill(0)
    space.fill.fill(0)
    state = LoopState(
        at=at.numbers,
        method=method,
        lanes=space.lanes,
        lane_point=space.lane_point,
        points=points,
        pieces=prepared.pieces,
        queue=queue,
        follows=is_next,
        statuses=np.full(n, RUNNING),
        progress=space.progress,
        coefficients=space.coefficients,
        logs=space.logs(kept, n_sections),
        fill=space.fill,
        sections=sections,
        work=space.work,
        turns=not section_only,
        contacts=has_events and contacts,
    )
    turns, touches, returns, steps = _drained(at, state, (prepared.rtol, DIVERGED_AT, MOST_SHORT))
    ended, statuses = points[:-1], state.statuses
    if at.has_laws:
        left_range = ended[:, at.out_of_range] > 0.0
        has_failed = np.append(False, statuses[:-1] != OK) & is_next[:-1]
        if method.is_users:  # not far away: the force is no number beyond the last step
            is_far = np.abs(ended[:, at.q : at.q + at.n]).max(axis=1) > DIVERGED_AT
            statuses[(statuses == Status.DIVERGED) & ~is_far] = Status.MODEL_INVALID
        if left_range.any():
            statuses[left_range & np.isin(statuses, _OF_MOTIONS)] = Status.OUT_OF_FIT_RANGE
        # A point that follows a failed point has failed with the same status.
        source = np.maximum.accumulate(np.where(has_failed, 0, np.arange(n)))
        statuses = statuses[source]
    return Batch(
        at=at,
        points=ended,
        t_end=problems.t_end,
        status=statuses,
        n_stages=method.n_stages,
        turns=turns,
        contacts=touches,
        sections=returns,
        steps=steps if dense_output else None,
    )


def _set_on_walls(at: RowLayout, points: Array, is_head: NDArray[np.bool_]) -> None:
    """Set the contact modes of the points that follow no other, and their contact times."""
    is_head[-1] = False  # the idle point
    heads = points[is_head]
    set_modes_on_walls(at, heads)
    touches = np.abs(heads[:, at.mode : at.mode + at.contacts]) == ON
    heads[:, at.contact_time : at.contact_time + at.contacts] = np.where(
        touches, -heads[:, [at.t_start]], 0.0
    )
    points[is_head] = heads


def _drained(layout: RowLayout, run: LoopState, limits: tuple[float, ...]) -> list[Array]:
    """Call the kernel until all points have ended; return the logs, sorted by point."""
    pieces: list[list[Array]] = []
    users, ours = (advance_users, _USERS_BUDGET), (advance, _BUDGET)
    outcome, (step_on, budget) = BUDGET_SPENT, users if run.method.is_users else ours
    is_placed = len(run.sections) > 0
    while outcome != FINISHED:
        began = time.monotonic()
        outcome = step_on(layout, run, limits, budget)
        if time.monotonic() - began < _SHORT_CALL:
            budget = min(2 * budget, _BUDGET)
        if outcome != FINISHED and is_late():
            held = run.lane_point >= 0
            run.points[run.lane_point[held]] = run.lanes[:, held].T
            run.statuses[run.statuses == RUNNING] = Status.TIMED_OUT
            outcome = FINISHED
        if outcome in (BUFFER_FULL, FINISHED):
            filled = zip(run.logs, run.fill.tolist(), strict=True)
            pieces.append([log[:n_rows].copy() if n_rows else log[:0] for log, n_rows in filled])
            run.fill[:] = 0
    logs = [_by_point(each, len(run.statuses)) for each in zip(*pieces, strict=True)]
    if is_placed:
        logs[record.SECTIONS] = _written(run)
    return logs


def _log_columns(at: RowLayout) -> tuple[int, ...]:
    """Numbers of columns of the logs of `record`."""
    turns, contacts = record.VALUE + 1, record.VALUE
    steps = record.DENSE_HEAD + (at.n + at.m) * at.n_terms
    return turns, contacts, record.STATE + at.n_states, steps


def _written(run: LoopState) -> Array:
    """Return the rows of all section points that were written in reserved rows."""
    written, end = run.sections.T
    rows: Array = run.logs[record.SECTIONS]
    if (written == end).all():
        return rows
    first = np.append(0, end[:-1])
    return np.concatenate(
        [rows[i:j] for i, j in zip(first.tolist(), written.tolist(), strict=True)]
    )


def _by_point(pieces: Sequence[Array], n_points: int) -> Array:
    """Join all rows, sorted by point; rows of one point keep their order."""
    first = pieces[0]
    if len(pieces) == 1 and (n_points == 1 or not len(first)):
        return first
    points = [piece[:, record.POINT].astype(np.int64) for piece in pieces]
    counts = sum(np.bincount(each, minlength=n_points) for each in points)
    next_row = np.cumsum(counts) - counts
    rows = np.empty((sum(map(len, pieces)), first.shape[1]))
    for piece in pieces:
        record.place(piece, next_row, rows)
    return rows
