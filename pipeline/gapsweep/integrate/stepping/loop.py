"""The stepping loop: vector steps of a method, and the scalar work for single lanes.

`advance` moves all lanes with a step of the method and looks after the lanes that it names: an
unclear crossing, the end of a point, a failure, something to record. Of the step it needs nothing
but the polynomial of the motion within it. All state lives in the arrays that are passed in, so the
loop can stop at any step (full buffer, step budget) and go on when called again.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from gapsweep.integrate.jit import chosen_by_type, counted, entry, inlined, internal
from gapsweep.integrate.runge_kutta.runge_kutta_step import runge_kutta_step
from gapsweep.integrate.taylor.taylor_step import taylor_step
from gapsweep.integrate.vectors import lowest_bit
from gapsweep.status import Status

from . import outcome
from .outcome import MAX_HALVINGS, SHORT_STEP, StepOutcome
from .passings import count_passings, record_passings
from .record import has_room, load_series, record_steps
from .roots import Work, first_exit, polynomial
from .start_rows import follow

# outcomes, as plain numbers for compiled code
RUNNING, OK, DIVERGED = -1, int(Status.OK), int(Status.DIVERGED)
STEP_UNDERFLOW, CHATTER = int(Status.STEP_UNDERFLOW), int(Status.CHATTER)
MODEL_INVALID = int(Status.MODEL_INVALID)
FINISHED, BUFFER_FULL, BUDGET_SPENT = 0, 1, 2
IDLE = -1
LARGEST = np.finfo(float).max
HALVED = 2.0**MAX_HALVINGS
_ROUNDING = 2.0**-40  # share of its reach by which the rounding of many steps moves a motion


@internal
def _interval(at, lanes, k, contact):
    """The part of its gap that a contact's mode allows in lane k."""
    mode = lanes[at.mode + contact, k]
    lower, upper = lanes[at.lower + contact, k], lanes[at.upper + contact, k]
    lo = -np.inf if mode < 0.0 else (upper if mode > 0.0 else lower)
    hi = np.inf if mode > 0.0 else (lower if mode < 0.0 else upper)
    return lo, hi


@internal
def _commit_clock(at, lanes, k, step, is_done):
    """Advance the clock of one lane."""
    if is_done:
        tau_1, low_1, cycle_1 = lanes[at.end_tau, k], 0.0, lanes[at.end_cycle, k]
    else:
        turned = lanes[at.tau_low, k] + lanes[at.omega, k] * step
        tau_1, cycle_1 = lanes[at.tau, k] + turned, lanes[at.cycle, k]
        low_1 = turned - (tau_1 - lanes[at.tau, k])
        whole = max(math.floor(tau_1), 0.0)
        tau_1, cycle_1 = tau_1 - whole, cycle_1 + whole
    lanes[at.tau, k], lanes[at.tau_low, k], lanes[at.cycle, k] = tau_1, low_1, cycle_1


@internal
def _pass_wall(at, lanes, k, contact, side):
    """Flip the mode of a contact at its wall on `side`, count."""
    lanes[at.side + contact, k] = side
    is_touching = lanes[at.mode + contact, k] != 0.0
    has_gap = lanes[at.lower + contact, k] < lanes[at.upper + contact, k]
    lanes[at.mode + contact, k] = 0.0 if is_touching and has_gap else side
    lanes[at.n_contacts, k] += 2.0 if is_touching and not has_gap else 1.0


@internal
def _find_exits(at, lanes, k, coefficients, work):
    """First exit of every contact from its mode, into `work.exits`; the time of the earliest."""
    h = lanes[at.step, k]
    earliest = h
    for contact in range(at.contacts):
        load_series(coefficients, (at.first_gap + contact) * at.n_terms, k, work.series)
        lo, hi = _interval(at, lanes, k, contact)
        g_1, _ = polynomial(work.series, at.order, h)
        t, side = first_exit(h, lo, hi, g_1, work)
        work.exits[contact, 0], work.exits[contact, 1] = t, side
        if side != 0.0:
            earliest = min(earliest, t)
    return earliest


@internal
def _advance_state(at, lanes, k, first, kept, step, coefficients, work):
    """Put a state, from row `first` on, to where its series, from `kept` on, lead it. If finite."""
    is_finite = True
    for i in range(at.n + at.m):
        load_series(coefficients, kept + i * at.n_terms, k, work.reduced)
        value, slope = polynomial(work.reduced, at.order, step)
        is_finite = is_finite and math.isfinite(value)
        if i < at.n:
            lanes[first + i, k], lanes[first + at.n + i, k] = value, slope
        else:
            lanes[first + at.n + i, k] = value
    return is_finite


@internal
def _commit_contacts(at, lanes, k, step, work):
    """Flip what is left after `step`, and put the gaps where they are; whether a wall is passed."""
    has_passed = False
    for contact in range(at.contacts):
        lo, hi = _interval(at, lanes, k, contact)
        side = work.exits[contact, 1]
        place = lanes[at.q, k]
        if not at.is_plain:
            place = 0.0
            for i in range(at.n):
                place += lanes[at.direction + contact * at.n + i, k] * lanes[at.q + i, k]
        # proved to be inside; only rounding can put the computed end past the wall
        place = min(max(place, lo), hi)
        if side != 0.0 and work.exits[contact, 0] <= step:
            _pass_wall(at, lanes, k, contact, side)
            place, has_passed = hi if side > 0.0 else lo, True
        lanes[at.q if at.is_plain else at.gap + contact, k] = place
    return has_passed


@internal
def _resolve(at, lanes, k, coefficients, work):
    """Commit the step of a lane whose crossing was unclear. True if that ends the point."""
    turns = lanes[at.end_cycle, k] - lanes[at.cycle, k]
    turns += lanes[at.end_tau, k] - lanes[at.tau, k] - lanes[at.tau_low, k]
    left = max(turns * lanes[at.period, k], 0.0)
    h = lanes[at.step, k]
    if h < lanes[at.min_step, k] and left <= h * HALVED:
        # halved as often as may be for a motion that stays on its wall, until nothing is left
        lanes[at.step, k] = h = left
    step = _find_exits(at, lanes, k, coefficients, work)
    if not _advance_state(at, lanes, k, at.q, 0, step, coefficients, work):
        return False
    has_passed = _commit_contacts(at, lanes, k, step, work)
    is_done = not has_passed and h == left
    _commit_clock(at, lanes, k, step, is_done)
    if has_passed:
        is_short = step * lanes[at.rate, k] < SHORT_STEP
        lanes[at.n_short, k] = lanes[at.n_short, k] + 1.0 if is_short else 0.0
    else:
        has_underflow = h < lanes[at.min_step, k] and not is_done
        lanes[at.n_short, k] = outcome.STEP_UNDERFLOW if has_underflow else 0.0
    lanes[at.is_fresh, k] = outcome.AT_WALL if has_passed else outcome.AT_NEW_STATE
    for i in range(at.n):
        lanes[at.reach + i, k] = max(lanes[at.reach + i, k], abs(lanes[at.q + i, k]))
    lanes[at.step, k] = step
    lanes[at.n_steps, k] += 1.0
    if at.tangent > 0:
        kept = at.n_series * at.n_terms
        for j in range(at.n_states):
            first = at.tangent_state + j * at.n_states
            _advance_state(at, lanes, k, first, kept, step, coefficients, work)
            kept += (at.n + at.m) * at.n_terms
    return is_done


@internal
def _failure(at, lanes, k, x_bound, max_short):
    """Status of lane k: RUNNING, or why it cannot go on."""
    for i in range(at.n_states):
        if not abs(lanes[at.q + i, k]) <= (x_bound if i < at.n else LARGEST):
            return DIVERGED
    if lanes[at.n_short, k] > max_short:
        return CHATTER
    reason = lanes[at.n_short, k]
    if reason == outcome.MODEL_INVALID:
        return MODEL_INVALID
    if reason == outcome.DIVERGED:
        return DIVERGED
    return STEP_UNDERFLOW if reason < 0.0 else RUNNING


@internal
def _part(at, lanes, k):
    """Move walls out of the way of a motion that stays on them but for rounding. Whether any was.

    Two masses that move alike neither leave the wall between them nor press on it. Where rounding
    alone passes it, on and on, it is put back by as little, for the rest of this run: by
    `_ROUNDING` of the largest displacement so far, each time.
    """
    is_parted = False
    for contact in range(at.contacts):
        place, speed, reach = lanes[at.q, k], lanes[at.v, k], lanes[at.reach, k]
        if not at.is_plain:
            place, speed, reach = lanes[at.gap + contact, k], 0.0, 0.0
            for i in range(at.n):
                along = lanes[at.direction + contact * at.n + i, k]
                speed += along * lanes[at.v + i, k]
                reach += abs(along) * lanes[at.reach + i, k]
        slack = _ROUNDING * reach
        lower, upper = lanes[at.lower + contact, k], lanes[at.upper + contact, k]
        is_on = place in (lower, upper)
        if is_on and abs(speed) <= slack * lanes[at.rate, k]:
            has_gap = lower < upper  # without one it stays in contact
            if has_gap and lanes[at.mode + contact, k] != 0.0:
                if lanes[at.side + contact, k] != 0.0:  # just passed: taken back
                    lanes[at.side + contact, k] = 0.0
                    lanes[at.n_contacts, k] -= 1.0
                else:
                    turns = lanes[at.cycle, k] + (lanes[at.tau, k] - lanes[at.tau_start, k])
                    now = lanes[at.t_start, k] + turns * lanes[at.period, k]
                    lanes[at.contact_time + contact, k] += now
            lanes[at.lower + contact, k] -= slack if place == lower else 0.0
            outward = slack if has_gap else -slack
            lanes[at.upper + contact, k] += outward if place == upper else 0.0
            lanes[at.mode + contact, k] = 0.0 if has_gap else 1.0
            is_parted = True
    if is_parted:
        lanes[at.n_short, k] = 0.0
    return is_parted


@internal
def _settle(at, unclear, lanes, coefficients, work):
    """Commit the steps of the lanes whose crossing was unclear. The lanes that end with it."""
    done = 0
    while unclear != 0:
        k = lowest_bit(unclear)
        unclear &= unclear - 1
        if _resolve(at, lanes, k, coefficients, work):
            done |= 1 << k
    return done


@internal
def _judged(at, suspects, lanes, x_bound, max_short):
    """Those of some lanes whose last step is no motion, and those that chatter and may go on."""
    failed = parted = 0
    while suspects != 0:
        k = lowest_bit(suspects)
        suspects &= suspects - 1
        status = _failure(at, lanes, k, x_bound, max_short)
        if status == CHATTER and _part(at, lanes, k):
            parted |= 1 << k
        elif status != RUNNING:
            failed |= 1 << k
    return failed, parted


@internal
def _attend(layout, named, run, limits):
    """See to the lanes that a step has named."""
    _, x_bound, max_short = limits
    at, lanes = run.at, run.lanes
    done, bad, recording = named.done, named.bad, named.recording
    count_passings(layout, named.miscounted, run)
    done |= _settle(at, named.unclear, lanes, run.coefficients, run.work)
    failed, parted = _judged(at, named.unclear | bad, lanes, x_bound, max_short)
    bad &= ~parted
    recording &= ~failed
    if recording != 0:
        record_steps(layout, recording, run)
        record_passings(layout, recording, run)
    ending = done | bad | failed
    while ending != 0:
        k = lowest_bit(ending)
        ending &= ending - 1
        status = _failure(at, lanes, k, x_bound, max_short)
        if status == RUNNING:
            status = OK if (done >> k) & 1 != 0 else STEP_UNDERFLOW
        _finish(at, run, k, status, limits)


@internal
def _load_next(at, run, k):
    """Put the next waiting point into lane k, or idle motion if none waits."""
    p = len(run.statuses)  # the table's last row is a point at rest without an end
    run.lane_point[k] = IDLE
    if run.progress[0] < len(run.queue):
        run.lane_point[k] = p = run.queue[run.progress[0]]
        run.progress[0] += 1
    for r in range(at.n_rows):
        run.lanes[r, k] = run.points[p, r]


@internal
def _finish(at, run, k, status, limits):
    """Hand lane k's state back to the table of points and load the next one.

    That is the one that follows; what follows a failure has failed.
    """
    rtol, _, _ = limits
    p = run.lane_point[k]
    for r in range(at.n_rows):
        run.points[p, r] = run.lanes[r, k]
    run.statuses[p] = status
    run.progress[1] += 1
    while run.follows[p + 1]:
        p += 1
        if status == OK:
            follow(at, run.points[p], run.points[p - 1], rtol)
            run.lane_point[k] = p
            for r in range(at.n_rows):
                run.lanes[r, k] = run.points[p, r]
            return
        run.statuses[p] = status
        run.progress[1] += 1
    _load_next(at, run, k)


class Taylor(NamedTuple):
    """The method whose polynomials are Taylor series; a `RowLayout` says of which degree."""

    is_users: bool = False


class LoopState(NamedTuple):
    """All that the loop works on; it can stop at any step and go on when called again.

    Attributes
    ----------
    at : record
        `RowLayout.numbers`.
    method : Taylor or RungeKutta
    lanes : array, shape (n_rows, width)
        State of the points under way.
    lane_point : int array, shape (width,)
        Row in `points` of each lane; -2 before the first call, `IDLE` when none is left.
    points : array, shape (n_points + 1, n_rows)
        One row per point: start on entry, end on return. The last row is the idle point.
    queue : int array
        The points that follow none in the order in which they are loaded.
    follows : bool array, shape (n_points + 1,)
        Which points begin where those before them end; not the idle one.
    statuses : int array, shape (n_points,)
        Outcome of each point, `RUNNING` while it is under way.
    progress : int array, shape (2,)
        How many points of the queue are loaded; how many have ended.
    coefficients : array
        Polynomials of the last step, as of `taylor_step`.
    logs : tuple of arrays
        Buffers of `record_steps`; with no rows: not wanted.
    fill : int array, shape (4,)
        Rows used in each. The caller drains the buffers and sets them to zero.
    sections : int array, shape (n_points, 2)
        The row of each motion's next section point, and where its rows end: they have places, and
        stay there. Empty: they are drained as all others are.
    work : roots.Work
        Work space for this degree.
    turns, contacts : bool
        Whether extrema are searched for; whether walls passed are recorded.
    """

    at: np.record
    method: Any
    lanes: np.ndarray
    lane_point: np.ndarray
    points: np.ndarray
    queue: np.ndarray
    follows: np.ndarray
    statuses: np.ndarray
    progress: np.ndarray
    coefficients: np.ndarray
    logs: tuple
    fill: np.ndarray
    sections: np.ndarray
    work: Work
    turns: bool
    contacts: bool


def method_step(layout, method, lanes, coefficients, limits):
    """Advance every lane by one step of a method: an `StepOutcome`."""
    raise NotImplementedError("compiled code only")


@chosen_by_type(method_step)
def _method_step(layout, method, lanes, coefficients, limits):
    one = _taylor if method.instance_class is Taylor else runge_kutta_step
    return lambda layout, method, lanes, coefficients, limits: one(
        layout, method, lanes, coefficients, limits
    )


@inlined
def _taylor(layout, method, lanes, coefficients, limits):
    rtol, x_bound, max_short = limits
    packed = taylor_step(layout, lanes, coefficients, rtol, x_bound, max_short)
    every, width = layout.all_lanes, layout.width
    return StepOutcome(
        packed & every,
        (packed >> width) & every,
        (packed >> 2 * width) & every,
        (packed >> 3 * width) & every,
        0,
    )


def _advance(layout, run, limits, budget):
    """Advance until every point has ended, a buffer is full, or `budget` vector steps are made.

    Parameters
    ----------
    layout : RowLayout
    run : LoopState
    limits : tuple of float
        rtol, x_bound [m], cap on successive short contact steps.
    budget : int
        Largest number of vector steps.

    Returns
    -------
    int
        FINISHED, BUFFER_FULL or BUDGET_SPENT.
    """
    # Out of the record, once: to take an array out of it counts a reference.
    at, method, lanes, coefficients = run.at, run.method, run.lanes, run.coefficients
    progress, n_points = run.progress, len(run.statuses)
    for k in range(at.width):
        if run.lane_point[k] < IDLE:
            _load_next(at, run, k)
    for _ in range(budget):
        if progress[1] == n_points:
            return FINISHED
        named = method_step(layout, method, lanes, coefficients, limits)
        if named.unclear | named.done | named.bad | named.recording | named.miscounted != 0:
            _attend(layout.of_motion, named, run, limits)
            if not has_room(at, run):
                return FINISHED if progress[1] == n_points else BUFFER_FULL
    return FINISHED if progress[1] == n_points else BUDGET_SPENT


advance = entry(_advance)
# A user's law is a type that exists in this process only: its code is not kept on disk.
advance_users = counted(njit(nogil=True)(_advance))
