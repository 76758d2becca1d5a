"""The stepping loop of the Runge-Kutta methods: lanes that each take the next point when done."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gapsweep.integrate import simd
from gapsweep.integrate.jit import counted, entry
from gapsweep.integrate.taylor.layout import aligned

from . import lanes as ln
from . import laws, parameters
from .attempt import attempt
from .lanes import load_first_points, load_following, load_point, unload_point
from .probing import new_scratch
from .recording import attend
from .tableaux import Tableau

Array = NDArray[np.float64]

# Attempts per call: keyboard interrupts are seen between calls.
_ATTEMPTS_PER_CALL = 2_000_000
# Rows of the record buffer; a full buffer is drained and the loop entered again.
_BUFFER_ROWS = 65536
_DONE, _PAUSED = 0, 1


def _advance(
    rows,
    at,
    kinds,
    tableau,
    lane,
    lane_int,
    q,
    k,
    k_tangent,
    probes,
    scratch,
    events,
    counters,
    table,
    queue,
    follows,
    results,
    settings,
):
    """Run lanes until all points are done or the event buffer could overflow.

    All state is in the arguments, so calling again goes on where this call left off. One function,
    for it is the stepping loop: what it calls is compiled into it. An attempt is compiled for its
    `rows`; what looks after a lane takes the same numbers from the record `at`.
    """
    all_lanes = (np.int64(1) << simd.WIDTH) - 1
    watched = all_lanes  # lanes that are not simply stepping
    for _ in range(_ATTEMPTS_PER_CALL):
        if counters[ln.N_EVENTS] > events.shape[0] - 3 * simd.WIDTH:
            return _PAUSED
        outcome = attempt(rows, kinds, q, lane, tableau, k, k_tangent, settings)
        attention = (
            watched
            | outcome.ended
            | outcome.failed
            | outcome.stopped
            | outcome.recorded
            | outcome.dipped
        )
        if attention == 0:
            continue
        n_idle = 0
        watched = 0
        for i in range(simd.WIDTH):
            if (attention >> i) & 1 and lane_int[ln.MODE, i] != ln.IDLE:
                status = attend(
                    at,
                    lane,
                    lane_int,
                    q,
                    k_tangent,
                    probes,
                    scratch,
                    events,
                    counters,
                    settings,
                    outcome,
                    i,
                )
                if status >= 0:
                    unload_point(at, lane, lane_int, results, status, tableau.c.size - 1, i)
                    is_loaded = load_following(
                        at, lane, lane_int, q, table, follows, results, status, i
                    )
                    if not is_loaded and counters[ln.NEXT_POINT] < queue.shape[0]:
                        point = queue[counters[ln.NEXT_POINT]]
                        load_point(at, lane, lane_int, q, table, point, i)
                        counters[ln.NEXT_POINT] += 1
            n_idle += lane_int[ln.MODE, i] == ln.IDLE
            # An idle lane repeats attempts of length zero; nobody looks at it any more.
            if lane_int[ln.MODE, i] != ln.STEPPING and lane_int[ln.MODE, i] != ln.IDLE:
                watched |= np.int64(1) << i
        if n_idle == simd.WIDTH:
            return _DONE
    return _PAUSED


# One function for all laws of this package. A user's law is a type that exists in this process
# only, so it goes through a second dispatcher that leaves the disk cache alone.
_advance_cached = entry(_advance)
_advance_user = counted(njit(nogil=True)(_advance))


def drained(
    at: ln.Rows,
    kinds: tuple[Any, ...],
    tableau: Tableau,
    table: Array,
    order: tuple[NDArray[np.intp], NDArray[np.bool_]],
    settings: Array,
) -> tuple[Array, Array]:
    """Result table and records of a point table; its order: `run`'s queue and what follows."""
    queue, follows = order
    width, n_stages = simd.WIDTH, tableau.c.size
    lane, q = aligned(at.n_rows, width), aligned(at.contacts, parameters.N_PARAMETERS, width)
    lane_int = np.zeros((ln.N_INT_ROWS, width), np.int64)
    k = aligned(n_stages * at.n_rates, width)
    k_tangent = aligned(at.n_states * n_stages * at.n_rates, width)
    probes, scratch = np.zeros((3 * at.max_probes, width)), new_scratch()
    records_on = settings[ln.S_DENSE] > 0.0 or bool(np.any(np.isfinite(table[:, at.record_turns])))
    rows = max(
        _BUFFER_ROWS if records_on else 0, 4 * width
    )  # one attempt writes up to 3 rows per lane
    events = np.empty((rows, at.n_event_columns))
    counters = np.zeros(2, np.int64)
    results = np.zeros((len(table), at.n_results))
    lane[at.exact] = 1.0
    lane[at.period] = 1.0
    counters[ln.NEXT_POINT] = load_first_points(at.numbers, lane, lane_int, q, table, queue)
    # An idle lane computes along with length zero; harmless numbers keep it off the slow paths.
    q[..., len(queue) :] = q[..., :1]
    is_users = any(isinstance(kind, laws.User) for kind in kinds)
    advance = _advance_user if is_users else _advance_cached
    work = k, k_tangent, probes, scratch, events, counters
    parts, state = [], _PAUSED
    while state != _DONE:
        state = advance(
            at,
            at.numbers,
            kinds,
            tableau,
            lane,
            lane_int,
            q,
            *work,
            table,
            queue,
            follows,
            results,
            settings,
        )
        if counters[ln.N_EVENTS]:
            parts.append(events[: counters[ln.N_EVENTS]].copy())
            counters[ln.N_EVENTS] = 0
    if not parts:
        return results, np.empty((0, at.n_event_columns))
    records = np.concatenate(parts)
    return results, records.take(np.argsort(records[:, ln.E_POINT], kind="stable"), axis=0)
