"""Integration of many points at once: arrays in, arrays and event lists out.

The compiled engine behind ``simulate(..., engine="compiled")``. `scenes` prepares one table row per
system, `run` writes initial states into copies of the rows, runs `loop.advance` on them and empties
its buffers.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.integrate.lanes.method import Method
from gapsweep.integrate.lanes.outcome import CLOCK_SLACK
from gapsweep.integrate.lanes.row_layout import RowLayout, aligned
from gapsweep.integrate.lanes.scene_table import SceneTable, check, set_modes_on_walls
from gapsweep.integrate.lanes.start_rows import BACKWARD, NOT_FINITE, ON_WALL, set_starts
from gapsweep.integrate.problem import is_late
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


@dataclass(frozen=True, slots=True)
class Batch:
    """Outcome of `run`; arrays of shape (n,) unless noted, one entry per point.

    Attributes
    ----------
    at : RowLayout
    state : ndarray, shape (n, n_states)
        (q, v, z) at the end; of a failed point, at the failure.
    t : ndarray
        Time reached [s]; `t_end` where status is OK.
    status : ndarray of int
        `gapsweep.status.Status` values.
    n_contacts, n_steps, n_rejected, nfev : ndarray of int
        Wall crossings, in and out, each counted once; accepted and rejected steps; right-hand sides
        of the motion itself (of a Taylor series, expansions).
    reach : ndarray, shape (n, n_coordinates)
        Largest modulus of q initially and at the ends of steps.
    contact_time : ndarray, shape (n, n_contacts)
        Time spent beyond the walls of every located contact [s], where all events are recorded.
    monodromy : ndarray, shape (n, n_states, n_states), or None
        Derivative of the end state with respect to the initial state.
    turns, contacts, sections : ndarray, shape (n_events, number of columns)
        Recorded events as in `record`, sorted by point, then in time for each `which`.
    steps : ndarray, shape (n_rows, DENSE_HEAD + (n + m) * n_terms), or None
        Recorded steps (point, start, length, coefficients of q and z), sorted by point and time.
    """

    at: RowLayout
    state: Array
    t: Array
    status: NDArray[np.int64]
    n_contacts: NDArray[np.int64]
    n_steps: NDArray[np.int64]
    n_rejected: NDArray[np.int64]
    nfev: NDArray[np.int64]
    reach: Array
    contact_time: Array
    monodromy: Array | None
    turns: Array = field(repr=False)
    contacts: Array = field(repr=False)
    sections: Array = field(repr=False)
    steps: Array | None = field(repr=False)

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
        points = np.arange(len(self.t))
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
    which: NDArray[np.intp],
    start: Array,
    t_0: Array,
    t_end: Array,
    record_from: Array,
    *,
    queue: NDArray[np.intp] | None = None,
    follows: NDArray[np.bool_] | None = None,
    section_only: bool = False,
    tangent: bool = False,
    dense_output: bool = False,
    sampled: bool = False,
    contacts: bool = True,
) -> Batch:
    """Integrate prepared systems from their initial states.

    Parameters
    ----------
    prepared : SceneTable
    method : Method
        Taylor or RungeKutta, without work space; its rows are in the table.
    which : ndarray of int, shape (n,)
        Row of `prepared` of each point.
    start : ndarray, shape (n, n_states)
        States (q, v, z).
    t_0, t_end : ndarray, shape (n,)
        Start and end [s].
    record_from : ndarray, shape (n,)
        Time from which extrema, contacts and section points are recorded [s]. The initial
        state is not an event: only events after `t_0` are recorded.
    queue : ndarray of int, optional
        Points that follow no other, in the order in which lanes take them; default ascending.
    follows : ndarray of bool, shape (n,), optional
        Points that begin in the end state of the one before; default none. Their `start` is not
        read. A point that follows a failed point has failed.
    section_only : bool
        Record section points only: a search for extrema in every step costs as much as the step.
    tangent : bool
        Also integrate the variational equation. Its jump at a contact is the identity, because
        the contact force is continuous.
    dense_output : bool
        Keep every step's series from `record_from` on, for `Batch.sample`.
    sampled : bool
        Take the steps that a run with `dense_output` takes.
    contacts : bool
        Record wall crossings.
    """
    at = prepared.at.of_tangent if tangent else prepared.at
    lanes = aligned(at.n_rows, at.width)
    wanted = {"tangent": tangent, "dense": dense_output, "contacts": contacts}
    method = method.with_work_space(at, lanes, **wanted)
    points = np.empty((len(which) + 1, at.n_rows))
    follows = np.append(np.zeros(len(which), bool) if follows is None else follows, False)
    given = start, follows, t_0, t_end, record_from, section_only and not dense_output
    outcome = set_starts(at.numbers, points, prepared.table, which, *given, prepared.rtol)
    if outcome == NOT_FINITE:
        check(start=start, t_0=t_0, t_end=t_end, record_from=record_from)
    if outcome == BACKWARD:
        raise ValueError("t_end lies before t_0")
    if outcome == ON_WALL:
        heads = points[:-1][~follows[:-1]]
        set_modes_on_walls(at, heads)
        points[:-1][~follows[:-1]] = heads
    if at.is_tanh and (dense_output or sampled):
        points[:-1, at.layer] = (
            np.inf
        )  # no layer is crossed in one step: the motion within it is recorded
    statuses = np.full(len(which), RUNNING)
    limits = prepared.rtol, DIVERGED_AT, MOST_SHORT
    queue = np.flatnonzero(~follows[:-1]) if queue is None else queue
    is_recording = bool(np.isfinite(record_from).any())
    # The section of an unforced motion is at extrema, which are then always searched for.
    has_events = is_recording and (not section_only or dense_output or at.is_free)
    kept = has_events, has_events and contacts, is_recording, dense_output
    mode, contact_time = (
        points[:-1, first : first + at.contacts] for first in (at.mode, at.contact_time)
    )
    contact_time[:] = np.where(mode != 0.0, -t_0[:, None], 0.0)
    *events, steps = _drained(
        at, method, lanes, points, queue, follows, statuses, limits, kept, not section_only
    )
    ended = points[:-1]
    if at.has_laws:
        left_range = ended[:, at.out_of_range] > 0.0
        has_failed = np.append(False, statuses[:-1] != OK) & follows[:-1]
        if method.is_users:  # not far away: the force is no number beyond the last step
            is_far = np.abs(ended[:, at.q : at.q + at.n]).max(axis=1) > DIVERGED_AT
            statuses[(statuses == Status.DIVERGED) & ~is_far] = Status.MODEL_INVALID
        statuses[left_range & np.isin(statuses, _OF_MOTIONS)] = Status.OUT_OF_FIT_RANGE
        # A point that follows a failed point has failed with the same status.
        source = np.maximum.accumulate(np.where(has_failed, 0, np.arange(len(statuses))))
        statuses = statuses[source]
    counts = _counts(at, ended, method.n_stages)
    return _outcome(at, ended, statuses, t_end, events, steps if dense_output else None, counts)


def _drained(
    at: RowLayout,
    method: Method,
    lanes: Array,
    points: Array,
    queue: NDArray[np.intp],
    follows: NDArray[np.bool_],
    statuses: NDArray[np.int64],
    limits: tuple[float, ...],
    kept: Sequence[bool],
    turns: bool,
) -> list[Array]:
    """Call the kernel until all points have ended; return the logs, sorted by point."""
    n_kept = at.n_series + at.tangent * at.n_states * (at.n + at.m)
    per_step, widths = record.rows_per_step.py_func(at), _log_columns(at)
    capacities = [
        max(_LOG_VALUES // columns, rows) for columns, rows in zip(widths, per_step, strict=True)
    ]
    sections = _section_rows(at, points[:-1])
    if len(sections):
        capacities[record.SECTIONS] = int(sections[-1, 1])
    elif not at.is_taylor:  # then a step records no more than one
        points[:, at.h_max] = np.minimum(points[:, at.h_max], points[:, at.period])
    run = LoopState(
        at=at.numbers,
        method=method,
        lanes=lanes,
        lane_point=np.full(at.width, -2),
        points=points,
        queue=queue,
        follows=follows,
        statuses=statuses,
        progress=np.zeros(2, np.int64),
        coefficients=aligned(n_kept * at.n_terms, at.width),
        logs=tuple(
            np.empty((rows if is_kept else 0, columns))
            for is_kept, rows, columns in zip(kept, capacities, widths, strict=True)
        ),
        fill=np.zeros(len(kept), np.int64),
        sections=sections.copy(),
        work=work_space(at.order, at.contacts),
        turns=turns,
        contacts=bool(kept[record.CONTACTS]),
    )
    pieces: list[list[Array]] = [[] for _ in kept]
    users, ours = (advance_users, _USERS_BUDGET), (advance, _BUDGET)
    outcome, (step_on, budget) = BUDGET_SPENT, users if method.is_users else ours
    while outcome != FINISHED:
        began = time.monotonic()
        outcome = step_on(at, run, limits, budget)
        if time.monotonic() - began < _SHORT_CALL:
            budget = min(2 * budget, _BUDGET)
        if outcome != FINISHED and is_late():
            held = run.lane_point >= 0
            points[run.lane_point[held]] = lanes[:, held].T
            statuses[statuses == RUNNING] = Status.TIMED_OUT
            outcome = FINISHED
        if outcome in (BUFFER_FULL, FINISHED):
            for piece, log, n_rows in zip(pieces, run.logs, run.fill.tolist(), strict=True):
                piece.append(log[:n_rows].copy())
            run.fill[:] = 0
    logs = [_by_point(each, len(statuses)) for each in pieces]
    if len(sections):
        logs[record.SECTIONS] = _written(
            run.logs[record.SECTIONS], sections[:, 0], run.sections[:, 0]
        )
    return logs


def _log_columns(at: RowLayout) -> tuple[int, ...]:
    """Numbers of columns of the logs of `record`."""
    turns, contacts = record.VALUE + 1, record.VALUE
    steps = record.DENSE_HEAD + (at.n + at.m) * at.n_terms
    return turns, contacts, record.STATE + at.n_states, steps


def _section_rows(at: RowLayout, points: Array) -> NDArray[np.int64]:
    """First row and end of the rows reserved for each motion's section points, shape (n, 2).

    Empty if the rows would be too many, or the motions are unforced.
    """
    first = np.maximum(1.0, np.ceil(points[:, at.record_clock] - CLOCK_SLACK))  # `first_section`
    counts = np.maximum(points[:, at.end_cycle] - first + 1.0, 0.0)
    if at.is_free or not counts.sum() <= MOST_PLACED:
        return np.empty((0, 2), np.int64)
    end = np.cumsum(counts.astype(np.int64))
    return np.stack([end - counts.astype(np.int64), end], axis=1)


def _written(rows: Array, first: NDArray[np.int64], end: NDArray[np.int64]) -> Array:
    """Return the rows from `first` to `end` of each point: all that were written."""
    if (end - first).sum() == len(rows):
        return rows
    return np.concatenate([rows[i:j] for i, j in zip(first.tolist(), end.tolist(), strict=True)])


def _by_point(pieces: list[Array], n_points: int) -> Array:
    """Join all rows, sorted by point; rows of one point keep their order."""
    if not any(map(len, pieces)):
        return pieces[0]
    points = [piece[:, record.POINT].astype(np.int64) for piece in pieces]
    counts = sum(np.bincount(each, minlength=n_points) for each in points)
    next_row = np.cumsum(counts) - counts
    rows = np.empty((sum(map(len, pieces)), pieces[0].shape[1]))
    for piece in pieces:
        record.place(piece, next_row, rows)
    return rows


def _outcome(
    at: RowLayout,
    points: Array,
    statuses: NDArray[np.int64],
    t_end: Array,
    events: Sequence[Array],
    steps: Array | None,
    counts: dict[str, NDArray[np.int64]],
) -> Batch:
    table = points.T
    turns, contacts, sections = events
    elapsed = table[at.cycle] + (table[at.tau] - table[at.tau_start])
    monodromy = None
    if at.tangent:
        # columns are the images of unit states
        n = at.n_states
        columns = table[at.tangent_state : at.tangent_state + n * n].T.reshape(-1, n, n)
        monodromy = columns.transpose(0, 2, 1).copy()
    t = np.where(statuses == OK, t_end, table[at.t_start] + elapsed * table[at.period])
    touches = points[:, at.mode : at.mode + at.contacts] != 0.0
    until_left = points[:, at.contact_time : at.contact_time + at.contacts]
    return Batch(
        at=at,
        state=points[:, at.q : at.q + at.n_states].copy(),
        t=t,
        status=statuses,
        reach=points[:, at.reach : at.reach + at.n].copy(),
        contact_time=until_left + np.where(touches, t[:, None], 0.0),
        monodromy=monodromy,
        turns=turns,
        contacts=contacts,
        sections=sections,
        steps=steps,
        **counts,
    )


def _counts(at: RowLayout, points: Array, n_stages: int) -> dict[str, NDArray[np.int64]]:
    """Counts of contacts, steps and right-hand sides; `n_stages` of the method, 0 for Taylor."""
    n_steps = points[:, at.n_steps]
    n_rejected = points[:, at.n_rejected] if n_stages else np.zeros_like(n_steps)
    nfev = n_steps
    if n_stages:
        nfev = (n_steps + n_rejected) * (n_stages - 1) + points[:, at.n_extra]
    # Below zero: the motion began on a wall and has not left it.
    n_contacts = np.maximum(points[:, at.n_contacts], 0.0)
    given = {"n_contacts": n_contacts, "n_steps": n_steps, "n_rejected": n_rejected, "nfev": nfev}
    return {name: values.astype(np.int64) for name, values in given.items()}
