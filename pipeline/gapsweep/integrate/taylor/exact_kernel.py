"""The stepping loop of the exact law: vector steps, and the scalar work for single lanes.

`advance` moves all lanes with `taylor_step` and looks after the lanes that it names: an unclear
crossing, the end of a point, a failure, something to record. All state lives in the arrays
that are passed in, so the loop can stop at any step (full buffer, step budget) and go on when
called again.
"""

import math

import numpy as np

from gapsweep.integrate.jit import entry, internal

from . import lane_rows as row
from .lane_ir import lowest_bit
from .record import load_series, record_steps
from .roots import first_exit, polynomial
from .taylor_ir import SHORT_STEP, taylor_step

# outcomes, with the numbers of the dataset's status flag
RUNNING, OK, DIVERGED, STEP_UNDERFLOW, CHATTER = -1, 0, 4, 6, 7
FINISHED, BUFFER_FULL, BUDGET_SPENT = 0, 1, 2
IDLE = -1


@internal
def _interval(lanes, k):
    """The displacements that lane k's contact mode allows."""
    mode = lanes[row.MODE, k]
    lo = -np.inf if mode < 0.0 else (lanes[row.UPPER, k] if mode > 0.0 else lanes[row.LOWER, k])
    hi = np.inf if mode > 0.0 else (lanes[row.LOWER, k] if mode < 0.0 else lanes[row.UPPER, k])
    return lo, hi


@internal
def _commit_clock(lanes, k, step, is_done):
    """As `taylor_ir` does for decided lanes."""
    if is_done:
        tau_1, cycle_1 = lanes[row.END_TAU, k], lanes[row.END_CYCLE, k]
    else:
        tau_1, cycle_1 = lanes[row.TAU, k] + lanes[row.OMEGA, k] * step, lanes[row.CYCLE, k]
        if tau_1 >= 1.0:
            tau_1, cycle_1 = tau_1 - 1.0, cycle_1 + 1.0
    lanes[row.TAU, k], lanes[row.CYCLE, k] = tau_1, cycle_1


@internal
def _commit_contact(lanes, k, side):
    """Flip the contact mode at the wall on `side`, put x on it, count."""
    lo, hi = _interval(lanes, k)
    lanes[row.X, k] = hi if side > 0.0 else lo
    is_touching = lanes[row.MODE, k] != 0.0
    has_gap = lanes[row.LOWER, k] < lanes[row.UPPER, k]
    lanes[row.MODE, k] = 0.0 if is_touching and has_gap else side
    lanes[row.N_CONTACTS, k] += 2.0 if is_touching and not has_gap else 1.0


@internal
def _resolve(lanes, k, has_tangent, coefficients, work):
    """Commit the step of a lane whose crossing was unclear. True if that ends the point."""
    h, series, order = lanes[row.STEP, k], work.series, len(work.series) - 1
    lo, hi = _interval(lanes, k)
    x_1, v_1 = polynomial(series, order, h)
    if not math.isfinite(x_1):
        lanes[row.X, k] = x_1
        return False
    step, side = first_exit(h, lo, hi, x_1, work)
    left = max(
        (
            (lanes[row.END_CYCLE, k] - lanes[row.CYCLE, k])
            + (lanes[row.END_TAU, k] - lanes[row.TAU, k])
        )
        * lanes[row.PERIOD, k],
        0.0,
    )
    is_done = side == 0.0 and h == left
    _commit_clock(lanes, k, step, is_done)
    if side != 0.0:
        _, v_1 = polynomial(series, order, step)
        _commit_contact(lanes, k, side)
        is_short = step * lanes[row.RATE, k] < SHORT_STEP
        lanes[row.N_SHORT, k] = lanes[row.N_SHORT, k] + 1.0 if is_short else 0.0
    else:
        # proved to be inside; only rounding can put the computed end past the wall
        lanes[row.X, k] = min(max(x_1, lo), hi)
        # negative: the step size has underflowed
        lanes[row.N_SHORT, k] = -1.0 if h < lanes[row.MIN_STEP, k] and not is_done else 0.0
    lanes[row.V, k] = v_1
    lanes[row.REACH, k] = max(lanes[row.REACH, k], abs(lanes[row.X, k]))
    lanes[row.STEP, k], lanes[row.SIDE, k] = step, side
    lanes[row.N_STEPS, k] += 1.0
    if has_tangent:
        for j in range(2):
            load_series(coefficients, (order + 1) * (1 + j), k, work.reduced)
            y, w = polynomial(work.reduced, order, step)
            lanes[row.TANGENT + 2 * j, k], lanes[row.TANGENT + 2 * j + 1, k] = y, w
    return is_done


@internal
def _failure(lanes, k, x_bound, max_short):
    """Status of lane k: RUNNING, or why it cannot go on."""
    if not (abs(lanes[row.X, k]) <= x_bound and abs(lanes[row.V, k]) < np.inf):
        return DIVERGED
    if lanes[row.N_SHORT, k] > max_short:
        return CHATTER
    if lanes[row.N_SHORT, k] < 0.0:
        return STEP_UNDERFLOW
    return RUNNING


@internal
def _load_next(lanes, k, lane_point, points, queue, progress):
    """Put the next waiting point into lane k, or idle motion if none waits."""
    p = len(queue)  # the table's last row is a point at rest without an end
    lane_point[k] = IDLE
    if progress[0] < len(queue):
        lane_point[k] = p = queue[progress[0]]
        progress[0] += 1
    for r in range(row.N_ROWS):
        lanes[r, k] = points[p, r]


@internal
def _finish(lanes, k, lane_point, points, queue, statuses, outcome, progress):
    """Hand lane k's state back to the table of points and load the next one."""
    p = lane_point[k]
    for r in range(row.N_ROWS):
        points[p, r] = lanes[r, k]
    statuses[p] = outcome
    progress[1] += 1
    _load_next(lanes, k, lane_point, points, queue, progress)


@internal
def _settle(unclear, lanes, has_tangent, coefficients, work):
    """Commit the steps of the lanes whose crossing was unclear. The lanes that end with it."""
    done = 0
    while unclear != 0:
        k = lowest_bit(unclear)
        unclear &= unclear - 1
        load_series(coefficients, 0, k, work.series)
        if _resolve(lanes, k, has_tangent, coefficients, work):
            done |= 1 << k
    return done


@internal
def _failed(suspects, lanes, x_bound, max_short):
    """Those of the lanes `suspects` whose last step is not part of the motion."""
    failed = 0
    while suspects != 0:
        k = lowest_bit(suspects)
        suspects &= suspects - 1
        if _failure(lanes, k, x_bound, max_short) != RUNNING:
            failed |= 1 << k
    return failed


@internal
def _attend(
    packed,
    lanes,
    lane_point,
    points,
    queue,
    statuses,
    progress,
    coefficients,
    order,
    limits,
    log,
    dense,
    fill,
    work,
):
    """See to the lanes that `taylor_step` named."""
    _, x_bound, max_short = limits
    has_tangent = len(coefficients) > len(work.series)
    unclear = packed & row.ALL_LANES
    done = (packed >> row.WIDTH) & row.ALL_LANES
    bad = (packed >> 2 * row.WIDTH) & row.ALL_LANES
    recording = (packed >> 3 * row.WIDTH) & row.ALL_LANES
    done |= _settle(unclear, lanes, has_tangent, coefficients, work)
    failed = _failed(unclear | bad, lanes, x_bound, max_short)
    recording &= ~failed
    if recording != 0:
        record_steps(lanes, recording, coefficients, order, lane_point, log, dense, fill, work)
    ending = done | bad | failed
    while ending != 0:
        k = lowest_bit(ending)
        ending &= ending - 1
        outcome = _failure(lanes, k, x_bound, max_short)
        if outcome == RUNNING:
            outcome = OK if (done >> k) & 1 != 0 else STEP_UNDERFLOW
        _finish(lanes, k, lane_point, points, queue, statuses, outcome, progress)


@entry
def advance(
    lanes,
    lane_point,
    points,
    queue,
    statuses,
    progress,
    coefficients,
    order,
    has_tangent,
    limits,
    log,
    dense,
    fill,
    work,
    budget,
):
    """Advance until every point has ended, a buffer is full, or `budget` vector steps are made.

    Parameters
    ----------
    lanes : array, shape (N_ROWS, WIDTH)
        State of the points under way.
    lane_point : int array, shape (WIDTH,)
        Row in `points` of each lane; -2 before the first call, `IDLE` when none is left.
    points : array, shape (n_points + 1, N_ROWS)
        One row per point: start on entry, end on return. The last row is the idle point.
    queue : int array, shape (n_points,)
        The points in the order in which they are loaded.
    statuses : int array, shape (n_points,)
        Outcome of each point, `RUNNING` while it is under way.
    progress : int array, shape (2,)
        How many points of the queue are loaded; how many have ended.
    coefficients, order, has_tangent
        As `taylor_step`.
    limits : tuple of float
        rtol, x_bound [m], cap on successive short contact steps.
    log, dense : arrays
        Buffers of `record_steps`; `dense` with no rows: not wanted.
    fill : int array, shape (2,)
        Rows used in `log` and `dense`. The caller drains the buffers and sets them to zero.
    work : roots.Work
        Work space for this degree.
    budget : int
        Largest number of vector steps.

    Returns
    -------
    int
        FINISHED, BUFFER_FULL or BUDGET_SPENT.
    """
    rtol, x_bound, max_short = limits
    for k in range(row.WIDTH):
        if lane_point[k] < IDLE:
            _load_next(lanes, k, lane_point, points, queue, progress)
    # a step of all lanes writes at most this many rows
    log_room = len(log) - row.WIDTH * (len(work.series) + 3)
    dense_room = len(dense) - row.WIDTH if len(dense) > 0 else 0
    for _ in range(budget):
        if progress[1] == len(statuses):
            return FINISHED
        if fill[0] > log_room or fill[1] > dense_room:
            return BUFFER_FULL
        packed = taylor_step(lanes, coefficients, order, has_tangent, rtol, x_bound, max_short)
        if packed != 0:
            _attend(
                packed,
                lanes,
                lane_point,
                points,
                queue,
                statuses,
                progress,
                coefficients,
                order,
                limits,
                log,
                dense,
                fill,
                work,
            )
    return FINISHED if progress[1] == len(statuses) else BUDGET_SPENT
