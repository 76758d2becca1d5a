"""The stepping loop: vector steps of a method, and the scalar work for single lanes.

`advance` moves all lanes with a step of the method and treats the lanes that the step reports: an
unclear crossing, the end of a point, a failure, something to record. For these it needs only the
polynomial of the motion within the step. All state is in the arrays that are passed in, so the loop
can stop at any step (full buffer, step budget) and go on when called again.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from gapsweep.integrate.jit import counted, entry, internal
from gapsweep.integrate.lanes import outcome
from gapsweep.integrate.lanes.method import method_step
from gapsweep.integrate.lanes.outcome import MAX_HALVINGS, SHORT_STEP
from gapsweep.integrate.lanes.pieces import enter_next_piece
from gapsweep.integrate.lanes.start_rows import acts, follow
from gapsweep.integrate.vectors import lowest_bit
from gapsweep.model.contact_modes import HOLD, ON, SLACK
from gapsweep.status import Status

from .impacts import (
    begin_impacts,
    hold_limits,
    is_caught,
    meet,
    release,
    set_held,
    settle_on_wall,
    speed_along,
    turn_tangent,
    while_accurate,
)
from .passings import count_passings, record_passings
from .record import has_room, load_depth, load_series, record_steps
from .roots import Work, first_exit, polynomial

# outcomes, as plain numbers for compiled code
RUNNING, OK, DIVERGED = -1, int(Status.OK), int(Status.DIVERGED)
STEP_UNDERFLOW, CHATTER = int(Status.STEP_UNDERFLOW), int(Status.CHATTER)
MODEL_INVALID = int(Status.MODEL_INVALID)
FINISHED, BUFFER_FULL, BUDGET_SPENT = 0, 1, 2
IDLE = -1
LARGEST = np.finfo(float).max
HALVED = 2.0**MAX_HALVINGS
_ROUNDING = 2.0**-40  # of the largest displacement: rounding error of a motion over many steps


@internal
def _interval(at, lanes, k, contact):
    """Interval of the gap that a contact's mode allows in lane k."""
    mode = lanes[at.mode + contact, k]
    is_free = not at.has_preload or lanes[at.preload + contact, k] == 0.0
    if at.has_slack and abs(mode) == ON and lanes[at.slack_damping + contact, k] > 0.0 and is_free:
        return -np.inf, np.inf  # its force ends the mode
    if abs(mode) == HOLD:
        return -np.inf, np.inf
    lower, upper = lanes[at.lower + contact, k], lanes[at.upper + contact, k]
    lo = -np.inf if mode < 0.0 else (upper if mode > 0.0 else lower)
    hi = np.inf if mode > 0.0 else (lower if mode < 0.0 else upper)
    return lo, hi


@internal
def _watched(at, lanes, k, number, coefficients, series):
    """Put a watched series of lane k into `series`; return the interval that its mode allows.

    Gaps come first, then the forces of contacts that never pull, as in `Modes.watched`, or are
    held on a wall.
    """
    contact = number % at.contacts
    load_series(coefficients, (at.first_gap + contact) * at.n_terms, k, series)
    mode = lanes[at.mode + contact, k]
    if number < at.contacts:
        if at.has_impacts:
            settle_on_wall(at, lanes, k, contact, series)
        return _interval(at, lanes, k, contact)
    if abs(mode) == HOLD:
        load_series(coefficients, (at.first_hold + contact) * at.n_terms, k, series)
        return hold_limits(at, lanes, k, contact)
    damping = lanes[at.slack_damping + contact, k] if at.has_slack else 0.0
    if mode == 0.0 or damping == 0.0:
        return -np.inf, np.inf
    stiffness, _ = load_depth(at, lanes, coefficients, k, contact, mode, series)
    for n in range(len(series)):
        rate = (n + 1) * series[n + 1] if n + 1 < len(series) else 0.0
        series[n] = stiffness * series[n] + damping * rate
    if lanes[at.switched + contact, k] > 0.0:
        series[0] = 0.0
    is_on = abs(mode) == ON
    return (0.0, np.inf) if is_on == (mode > 0.0) else (-np.inf, 0.0)


@internal
def _commit_clock(at, lanes, k, step, is_done):
    """Advance the clock of one lane by a step, or set it to the end of the motion if `is_done`."""
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
    """Change the mode of a contact that passes its wall on `side`, and count the crossing."""
    lanes[at.side + contact, k] = side
    mode = lanes[at.mode + contact, k]
    has_gap = lanes[at.lower + contact, k] < lanes[at.upper + contact, k]
    is_left = mode != 0.0 and has_gap
    lanes[at.mode + contact, k] = 0.0 if is_left else side
    lanes[at.n_contacts, k] += (1.0 if abs(mode) == ON else 0.0) + (0.0 if is_left else 1.0)


@internal
def _pass_zero(at, lanes, k, contact, side, when, coefficients):
    """Change the mode of a contact where its force passes zero, and count it."""
    mode = lanes[at.mode + contact, k]
    if abs(mode) == HOLD:
        if when == 0.0:
            force = coefficients[(at.first_hold + contact) * at.n_terms, k]
            limit = hold_limits(at, lanes, k, contact)[int(side > 0.0)]
            lanes[at.lost_force + contact, k] = force - limit
        release(at, lanes, k, contact, side, when)
        # at once: another contact changed the force, and the gap's acceleration is not zero
        lanes[at.switched + contact, k] = -1.0 if when > 0.0 else 0.0
    else:
        lanes[at.side + contact, k] = side
        lanes[at.mode + contact, k] = math.copysign(SLACK if abs(mode) == ON else ON, mode)
        lanes[at.n_contacts, k] += 1.0
        lanes[at.switched + contact, k] = 1.0


@internal
def _find_exits(at, lanes, k, coefficients, work):
    """Find the first exit of every watched series, for `work.exits`; return the earliest."""
    h = lanes[at.step, k]
    earliest = h
    for number in range(at.contacts * (1 + at.has_forces)):
        lo, hi = _watched(at, lanes, k, number, coefficients, work.series)
        end, _ = polynomial(work.series, at.order, h)
        t, side = first_exit(h, lo, hi, end, work)
        work.exits[number, 0], work.exits[number, 1] = t, side
        if side != 0.0:
            earliest = min(earliest, t)
    return earliest


@internal
def _advance_state(at, lanes, k, first, kept, step, coefficients, work):
    """Set the state in rows from `first` on to its series at time `step`; True if finite."""
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
def _commit_contacts(at, lanes, k, step, coefficients, work):
    """Change modes that end within `step`, and set the gaps; True if a wall is passed."""
    has_passed = False
    if at.has_impacts:
        begin_impacts(at, lanes, k, step, coefficients, work)
    for contact in range(at.contacts):
        lo, hi = _interval(at, lanes, k, contact)
        side = work.exits[contact, 1]
        place = lanes[at.q if at.is_plain else at.gap + contact, k]
        if not at.is_plain and abs(lanes[at.mode + contact, k]) != HOLD:  # which keeps its place
            place = 0.0
            for i in range(at.n):
                place += lanes[at.direction + contact * at.n + i, k] * lanes[at.q + i, k]
        # proved to be inside; only rounding can put the computed end past the wall
        place = min(max(place, lo), hi)
        if side != 0.0 and work.exits[contact, 0] <= step:
            place, has_passed = hi if side > 0.0 else lo, True
            if at.has_impacts and lanes[at.rigid + contact, k] > 0.0:
                meet(at, lanes, k, contact, side, step, coefficients, work)
            elif not is_caught(at, lanes, k, contact, side, step, coefficients, work):
                _pass_wall(at, lanes, k, contact, side)
        elif at.has_forces:
            side, when = work.exits[at.contacts + contact, 1], work.exits[at.contacts + contact, 0]
            lanes[at.switched + contact, k] = 0.0
            is_same = lanes[at.mode + contact, k] == lanes[at.mode_0 + contact, k]
            if side != 0.0 and when <= step and is_same:
                _pass_zero(at, lanes, k, contact, side, when, coefficients)
                has_passed = True
        lanes[at.q if at.is_plain else at.gap + contact, k] = place
    return has_passed


@internal
def _resolve(at, lanes, k, coefficients, work, rtol):
    """Commit the step of a lane whose crossing was unclear. True if that ends the point."""
    turns = lanes[at.end_cycle, k] - lanes[at.cycle, k]
    turns += lanes[at.end_tau, k] - lanes[at.tau, k] - lanes[at.tau_low, k]
    left = max(turns * lanes[at.period, k], 0.0)
    h = lanes[at.step, k]
    if at.has_impacts:
        if lanes[at.n_short, k] == outcome.MODEL_INVALID:
            return False
        lanes[at.step, k] = h = while_accurate(at, lanes, k, coefficients, h, rtol, work)
    if h < lanes[at.min_step, k] and left <= h * HALVED:
        # halved as often as may be for a motion that stays on its wall, until nothing is left
        lanes[at.step, k] = h = left
    step = _find_exits(at, lanes, k, coefficients, work)
    if not _advance_state(at, lanes, k, at.q, 0, step, coefficients, work):
        return False
    if at.is_damped and at.is_taylor:
        _lose(at, lanes, k, step, coefficients, work)
    elif at.is_damped:
        for n in range(at.n_terms):
            work.series[n] = lanes[at.loss + n, k]
        lanes[at.contact_loss, k] += polynomial(work.series, at.order, step)[0]
    has_passed = _commit_contacts(at, lanes, k, step, coefficients, work)
    is_done = not has_passed and h == left
    _commit_clock(at, lanes, k, step, is_done)
    if at.has_impacts and lanes[at.n_short, k] == outcome.MODEL_INVALID:
        return False
    if has_passed:
        # bounces on rigid walls become as short
        shortest = SHORT_STEP * (SHORT_STEP if at.has_impacts else 1.0)
        is_short = step * lanes[at.rate, k] < shortest
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
        for j in range(at.n_states + at.columns):
            first = at.tangent_state + j * at.n_states
            if j >= at.n_states:
                first = at.column + (j - at.n_states) * at.column_size
            _advance_state(at, lanes, k, first, kept, step, coefficients, work)
            kept += (at.n + at.m) * at.n_terms
            if at.is_damped and at.is_taylor:
                _jump(at, lanes, k, first, j >= at.n_states)
            if at.has_impacts and has_passed:
                turn_tangent(at, lanes, k, first, j >= at.n_states)
    return is_done


@internal
def _lose(at, lanes, k, step, coefficients, work):
    """Add what contacts of lane k shrink volumes in state space in a step, see `Modes.loss`."""
    for contact in range(at.contacts):
        mode = lanes[at.mode + contact, k]
        if abs(mode) == ON:
            compliance = 1.0 if at.is_plain else lanes[at.compliance + contact, k]
            lost = lanes[at.contact_damping + contact, k] * step
            if at.has_chi:
                stiffness, chi = load_depth(at, lanes, coefficients, k, contact, mode, work.series)
                total = 0.0
                for n in range(at.order, -1, -1):
                    total = total * step + work.series[n] / (n + 1)
                lost += stiffness * chi * total * step
            lanes[at.contact_loss, k] += lost * compliance


@internal
def _jump(at, lanes, k, first, is_column):
    """Change a solution of the variational equation, in rows from `first` on, where the damping of
    contacts begins or ends, as `tangent._jump` does; a column has derivatives of the walls."""
    for contact in range(at.contacts):
        mode, before = lanes[at.mode + contact, k], lanes[at.mode_0 + contact, k]
        if mode in (before, 2.0 * before) or before == 2.0 * mode:
            continue
        if HOLD in (abs(mode), abs(before)):
            continue
        damping = lanes[at.contact_damping + contact, k]
        along = lanes[first, k] if at.is_plain else 0.0
        if not at.is_plain:
            for i in range(at.n):
                along += lanes[at.direction + contact * at.n + i, k] * lanes[first + i, k]
        change = per_speed = 0.0
        if at.has_preload and lanes[at.preload + contact, k] > 0.0:
            per_speed = lanes[at.preload + contact, k] / abs(speed_along(at, lanes, k, contact))
        for of, sign in (
            (before, -1.0),
            (mode, 1.0),
        ):  # walls left and reached, at once without a gap
            moving = 0.0
            if is_column:
                wall = at.upper_source if of > 0.0 else at.lower_source
                moving = lanes[first + wall + contact, k]
            if abs(of) == ON:
                change += (sign * damping + per_speed) * (along - moving)
        if at.is_plain:
            lanes[first + 1, k] -= change
        else:
            for i in range(at.n):
                lanes[first + at.n + i, k] -= lanes[at.pull + i * at.contacts + contact, k] * change


@internal
def _failure(at, lanes, k, x_bound, max_short):
    """Return the status of lane k: RUNNING, or the reason of its failure."""
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
    """Move walls away from a motion that only rounding takes across them. True if any was moved.

    Two masses that move together neither leave the wall between them nor press on it. A wall that
    only rounding errors pass again and again is moved by `_ROUNDING` of the largest displacement so
    far, each time, for the rest of this run.
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
            if has_gap and acts(lanes[at.mode + contact, k]):
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
        if at.has_impacts:
            set_held(at, lanes, k)
        lanes[at.n_short, k] = 0.0
    return is_parted


@internal
def _settle(at, unclear, lanes, coefficients, work, rtol):
    """Commit the steps of lanes whose crossing was unclear; return those whose point ends."""
    done = 0
    while unclear != 0:
        k = lowest_bit(unclear)
        unclear &= unclear - 1
        if _resolve(at, lanes, k, coefficients, work, rtol):
            done |= 1 << k
    return done


@internal
def _judged(at, suspects, lanes, x_bound, max_short):
    """Among `suspects`, the lanes that have failed, and chattering ones whose walls were moved."""
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
    """Do the scalar work for lanes that a step has reported: crossings, records, ends."""
    rtol, x_bound, max_short = limits
    at, lanes = run.at[0], run.lanes
    done, bad, recording = named.done, named.bad, named.recording
    count_passings(layout, named.miscounted, run)
    done |= _settle(at, named.unclear, lanes, run.coefficients, run.work, rtol)
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
        is_at_end = status == RUNNING and (done >> k) & 1 != 0
        if at.pieces and is_at_end and enter_next_piece(at, lanes[:, k], run.pieces):
            lanes[at.is_fresh, k] = outcome.AT_NEW_STATE
            continue
        if status == RUNNING:
            status = OK if (done >> k) & 1 != 0 else STEP_UNDERFLOW
        _finish(at, run, k, status, limits)


@internal
def _load_next(at, run, k):
    """Load the next point of the queue into lane k, or the idle point if none is left."""
    p = len(run.statuses)  # the table's last row is a point at rest without an end
    run.lane_point[k] = IDLE
    if run.progress[0] < len(run.queue):
        run.lane_point[k] = p = run.queue[run.progress[0]]
        run.progress[0] += 1
    for r in range(at.n_rows):
        run.lanes[r, k] = run.points[p, r]


@internal
def _finish(at, run, k, status, limits):
    """Copy lane k back to the table of points and load the next point.

    A point that follows this one is loaded first; if this one has failed, so have its followers.
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


class LoopState(NamedTuple):
    """State of the loop, which can stop at any step and go on when called again.

    Attributes
    ----------
    at : array, shape (1,)
        `RowLayout.numbers`.
    method : Method
    lanes : array, shape (n_rows, width)
        State of the points under way.
    lane_point : int array, shape (width,)
        Row in `points` of each lane; -2 before the first call, `IDLE` when none is left.
    points : array, shape (n_points + 1, n_rows)
        One row per point: start on entry, end on return. The last row is the idle point.
    pieces : array, shape (n_pieces, n_columns)
        Loads by pieces, as in `SceneTable`.
    queue : int array
        Points that follow no other, in the order in which they are loaded.
    follows : bool array, shape (n_points + 1,)
        Points that begin in the end state of the one before; False for the idle point.
    statuses : int array, shape (n_points,)
        Outcome of each point, `RUNNING` while it is under way.
    progress : int array, shape (2,)
        Numbers of points loaded from the queue, and of points that have ended.
    coefficients : array
        Polynomials of the last step, as in `taylor_step`.
    logs : tuple of arrays
        Buffers of `record_steps`; without rows: nothing is recorded.
    fill : int array, shape (4,)
        Rows used in each. The caller empties the buffers and sets the numbers to zero.
    sections : int array, shape (n_points, 2)
        Row of each motion's next section point, and end of the rows reserved for it. Empty: no rows
        are reserved, and section points are buffered as all other events.
    work : roots.Work
        Work space for this degree.
    turns, contacts : bool
        Whether extrema are searched for; whether wall crossings are recorded.
    """

    at: np.ndarray
    method: Any
    lanes: np.ndarray
    lane_point: np.ndarray
    points: np.ndarray
    pieces: np.ndarray
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


def _advance(layout, run, limits, budget):
    """Advance all lanes until every point has ended, a buffer is full or `budget` is used up.

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
    at, method, lanes, coefficients = run.at[0], run.method, run.lanes, run.coefficients
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
