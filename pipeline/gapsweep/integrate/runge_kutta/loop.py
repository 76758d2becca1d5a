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


def _advance(rows, kinds, tableau, run):
    """Run lanes until all points are done or the event buffer could overflow.

    All state is in the arguments, so calling again goes on where this call left off. One function,
    for it is the stepping loop: what it calls is compiled into it. An attempt is compiled for its
    `rows`; what looks after a lane takes the same numbers from the record `run.at`.
    """
    all_lanes = (np.int64(1) << simd.WIDTH) - 1
    watched = all_lanes  # lanes that are not simply stepping
    q, lane, lane_int, k, k_tangent = run.q, run.lane, run.lane_int, run.k, run.k_tangent
    counters, settings = run.counters, run.settings
    for _ in range(_ATTEMPTS_PER_CALL):
        if counters[ln.N_EVENTS] > run.events.shape[0] - 3 * simd.WIDTH:
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
                status = attend(run, outcome, i)
                if status >= 0:
                    unload_point(run, status, tableau.c.size - 1, i)
                    is_loaded = load_following(run, status, i)
                    if not is_loaded and counters[ln.NEXT_POINT] < run.queue.shape[0]:
                        load_point(run, run.queue[counters[ln.NEXT_POINT]], i)
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
    settings: ln.Settings,
) -> tuple[Array, Array]:
    """Result table and records of a point table; its order: `run`'s queue and what follows."""
    queue, follows = order
    width, n_stages = simd.WIDTH, tableau.c.size
    records_on = settings.dense or bool(np.any(np.isfinite(table[:, at.record_turns])))
    # One attempt writes up to 3 rows per lane.
    n_rows = max(_BUFFER_ROWS if records_on else 0, 4 * width)
    run = ln.Run(
        at=at.numbers,
        lane=aligned(at.n_rows, width),
        lane_int=np.zeros((ln.N_INT_ROWS, width), np.int64),
        q=aligned(at.contacts, parameters.N_PARAMETERS, width),
        k=aligned(n_stages * at.n_rates, width),
        k_tangent=aligned(at.n_states * n_stages * at.n_rates, width),
        probes=np.zeros((3 * at.max_probes, width)),
        scratch=new_scratch(),
        events=np.empty((n_rows, at.n_event_columns)),
        counters=np.zeros(2, np.int64),
        table=table,
        queue=queue,
        follows=follows,
        results=np.zeros((len(table), at.n_results)),
        settings=settings,
    )
    run.lane[at.exact] = 1.0
    run.lane[at.period] = 1.0
    load_first_points(run)
    # An idle lane computes along with length zero; harmless numbers keep it off the slow paths.
    run.q[..., len(queue) :] = run.q[..., :1]
    is_users = any(isinstance(kind, laws.User) for kind in kinds)
    advance = _advance_user if is_users else _advance_cached
    parts, state = [], _PAUSED
    while state != _DONE:
        state = advance(at, kinds, tableau, run)
        if run.counters[ln.N_EVENTS]:
            parts.append(run.events[: run.counters[ln.N_EVENTS]].copy())
            run.counters[ln.N_EVENTS] = 0
    if not parts:
        return run.results, np.empty((0, at.n_event_columns))
    records = np.concatenate(parts)
    order_of_points = np.argsort(records[:, ln.E_POINT], kind="stable")
    return run.results, records.take(order_of_points, axis=0)
