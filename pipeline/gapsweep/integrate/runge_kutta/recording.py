"""What happens to one lane after an attempt that needs attention: landings, ends, failures; and its
events, which are found by `probing`.
"""

import numpy as np

from gapsweep.integrate.jit import allocating

from . import lanes as ln
from . import laws
from .interpolant import roots
from .probing import (
    begin_probing,
    coefficients,
    count_dips,
    is_recording,
    passings,
    plan_probes,
    probed,
    record,
    return_to_start,
)


@allocating
def first_step(lane, settings, exponent, i):
    """Length of a first step from rest: ode45's rule (also the native one), from the size of y'
    alone.
    """
    threshold = settings[ln.S_ATOL] / settings[ln.S_RTOL]
    rate_x = abs(lane[ln.V, i]) / max(abs(lane[ln.X, i]), threshold)
    rate_v = abs(lane[ln.A, i]) / max(abs(lane[ln.V, i]), threshold)
    rate = max(rate_x, rate_v) / (0.8 * settings[ln.S_RTOL] ** exponent)
    left = ln.remaining(lane, i)
    h = min(lane[ln.H_MAX, i], left)
    if settings[ln.S_FIRST_STEP] > 0.0:
        return min(h, settings[ln.S_FIRST_STEP])
    return max(1.0 / rate if h * rate > 1.0 else h, lane[ln.H_MIN, i])


@allocating
def started(lane, lane_int, settings, exponent, i):
    """The acceleration at the start is known: choose the first step."""
    lane[ln.A, i] = lane[ln.A1, i]
    left = ln.remaining(lane, i)
    lane[ln.H_MAX, i] = 0.1 * left if settings[ln.S_ODE45] > 0.0 else lane[ln.PERIOD, i]
    lane[ln.H, i] = first_step(lane, settings, exponent, i)
    lane[ln.EXACT, i] = 0.0
    lane_int[ln.MODE, i] = ln.STEPPING


@allocating
def _heads_out(lane, q, i):
    """How many walls a start lies on and heads out over: to leave a wall is not to pass it."""
    heading = lane[ln.V, i] if lane[ln.V, i] != 0.0 else lane[ln.A, i]
    x = lane[ln.X, i]
    over_high = x == q[laws.WALL_HIGH, i] and heading > 0.0
    over_low = x == q[laws.WALL_LOW, i] and heading < 0.0
    return int(over_high) + int(over_low)


# --- steps cut at a wall or at the edge of a layer ------------------------------------------------


@allocating
def _first_root(scratch, target, best):
    b, found = scratch.b, scratch.found
    for j in range(6):
        b[j] -= target
    n = roots(b[:6], found, scratch.stack)
    for j in range(6):
        b[j] += target
    return min(best, found[0]) if n > 0 else best


@allocating
def _first_edge(lane, q, scratch, is_located, i):
    """Theta at which the step first reaches a wall (located) or layer; above 1 if never."""
    best, x = 2.0, lane[ln.OLD_X, i]
    low, high, half = q[laws.WALL_LOW, i], q[laws.WALL_HIGH, i], q[laws.LAYER, i]
    if is_located:
        if q[laws.ACTIVE_MODE, i] != 0.0:
            return _first_root(scratch, q[laws.ACTIVE_WALL, i], best)
        return _first_root(scratch, low, _first_root(scratch, high, best))
    for wall in (low, high):
        # Slightly inside, so that the landing counts as inside whatever its rounding.
        target = wall - 0.95 * half if x < wall else wall + 0.95 * half
        best = _first_root(scratch, target, best)
    return best


@allocating
def _revoke(lane, q, is_located, i):
    """Undo the accepted step: it is repeated in part."""
    if not is_located:
        lane[ln.N_CONTACTS, i] -= passings(q, lane[ln.OLD_X, i], lane[ln.X1, i], i)
    return_to_start(lane, i)
    for row in range(4):
        lane[ln.TANGENT + row, i] = lane[ln.OLD_TANGENT + row, i]
    lane[ln.N_STEPS, i] -= 1.0
    lane[ln.N_REJECTED, i] += 1.0
    lane[ln.EXACT, i] = 2.0


@allocating
def _cut(lane, lane_int, q, scratch, is_located, i):
    """Repeat the step up to the first edge; false if it does not reach one after all."""
    coefficients(lane, scratch.b, i)
    theta = _first_edge(lane, q, scratch, is_located, i)
    if theta > 1.0:
        return False
    _revoke(lane, q, is_located, i)
    lane[ln.H_SAVED, i] = lane[ln.OLD_H, i]
    lane[ln.H, i] = theta * lane[ln.OLD_H, i]
    lane_int[ln.LANDING, i] = 1
    lane_int[ln.TRIES, i] = 0
    return True


@allocating
def _landing_wall(lane, q, i):
    """The wall that a located landing aims at."""
    if q[laws.ACTIVE_MODE, i] != 0.0:
        return q[laws.ACTIVE_WALL, i]
    low, high = q[laws.WALL_LOW, i], q[laws.WALL_HIGH, i]
    return high if abs(lane[ln.X1, i] - high) < abs(lane[ln.X1, i] - low) else low


@allocating
def _n_walls(q, i):
    """Walls passed at once: where no gap lies between them one is left and the other entered."""
    return 2 if q[laws.WALL_LOW, i] == q[laws.WALL_HIGH, i] else 1


@allocating
def _landed(lane, lane_int, q, i):
    """Newton's method on the landing time; true when x is on the wall (and set to it exactly)."""
    wall = _landing_wall(lane, q, i)
    miss, v = lane[ln.X1, i] - wall, lane[ln.V1, i]
    close = abs(miss) <= 1e-15 * (abs(wall) + abs(lane[ln.OLD_X, i] - wall))
    if not close and v != 0.0 and lane_int[ln.TRIES, i] < 6:
        h = lane[ln.OLD_H, i]
        _revoke(lane, q, True, i)
        lane[ln.H, i] = min(max(h - miss / v, 0.5 * h), 2.0 * h)
        lane_int[ln.TRIES, i] += 1
        return False
    lane[ln.X, i] = wall
    lane_int[ln.LANDING, i] = 0
    lane_int[ln.LANDED, i] = 1
    lane[ln.N_CONTACTS, i] += _n_walls(q, i)
    return True


@allocating
def choose_mode(lane, q, i):
    """Contact mode of a located run from the present state: velocity, then acceleration, decide on
    a wall.
    """
    x = lane[ln.X, i]
    low, high = q[laws.WALL_LOW, i], q[laws.WALL_HIGH, i]
    heading = lane[ln.V, i] if lane[ln.V, i] != 0.0 else lane[ln.A, i]
    stiffness, wall, mode = 0.0, 0.0, 0.0
    if x > high or (x == high and heading > 0.0):
        stiffness, wall, mode = q[laws.STIFFNESS, i], high, 1.0
    elif x < low or (x == low and heading < 0.0):
        stiffness, wall, mode = q[laws.RATIO, i] * q[laws.STIFFNESS, i], low, -1.0
    q[laws.ACTIVE_STIFFNESS, i], q[laws.ACTIVE_WALL, i] = stiffness, wall
    q[laws.ACTIVE_MODE, i] = mode


@allocating
def _corrects_mode(lane, q, i):
    """Choose the mode of a start; true if the stiffness was another one."""
    before = q[laws.ACTIVE_STIFFNESS, i]
    choose_mode(lane, q, i)
    # On a wall both modes have the same acceleration, which has just decided between them.
    on_wall = lane[ln.X, i] == q[laws.WALL_LOW, i] or lane[ln.X, i] == q[laws.WALL_HIGH, i]
    return q[laws.ACTIVE_STIFFNESS, i] != before and not on_wall


# --- one lane's turn ------------------------------------------------------------------------------


@allocating
def _failure_status(lane, q, settings, committed, i):
    x = lane[ln.X1, i]
    if not (np.isfinite(x) and abs(x) <= settings[ln.S_BOUND]):
        return ln.DIVERGED
    if lane[ln.N_ATTEMPTS, i] > settings[ln.S_MAX_ATTEMPTS]:
        return ln.TIMED_OUT
    return ln.MODEL_INVALID if committed else ln.STEP_UNDERFLOW


@allocating
def after_events(lane, lane_int, q, i):
    """Go on after a step and all its events; true when the point has reached its end."""
    if lane_int[ln.LANDED, i]:
        lane_int[ln.LANDED, i] = 0
        choose_mode(lane, q, i)
        ln.begin_start(lane, lane_int, i)
        return False
    return lane[ln.TURNS, i] == lane[ln.END_TURNS, i] and lane[ln.TAU, i] == lane[ln.END_TAU, i]


@allocating
def attend(lane, lane_int, q, probes, scratch, events, counters, settings, outcome, is_located, i):
    """Look after lane i; the status if its point is over, else -1."""
    mode = lane_int[ln.MODE, i]
    bit = np.int64(1) << i
    if mode == ln.START:
        if not (np.isfinite(lane[ln.A1, i]) and abs(lane[ln.X, i]) <= settings[ln.S_BOUND]):
            return ln.DIVERGED
        started(lane, lane_int, settings, settings[ln.S_EXPONENT], i)
        if not is_located:
            lane[ln.N_CONTACTS, i] = -_heads_out(lane, q, i)
        if is_located and _corrects_mode(lane, q, i):
            ln.begin_start(lane, lane_int, i)  # the acceleration was that of another mode
            return -1
        return ln.OK if ln.remaining(lane, i) <= 0.0 else -1
    if mode == ln.PROBING:
        if not probed(lane, lane_int, q, probes, events, counters, i):
            return -1
        return ln.OK if after_events(lane, lane_int, q, i) else -1
    if outcome.failed & bit:
        if outcome.accepted & bit and not is_located:  # no part of the motion, nor what it passed
            lane[ln.N_CONTACTS, i] -= passings(q, lane[ln.OLD_X, i], lane[ln.X1, i], i)
        return _failure_status(lane, q, settings, outcome.accepted & bit != 0, i)
    if is_located and lane_int[ln.LANDING, i] and outcome.accepted & bit:
        if not _landed(lane, lane_int, q, i):
            return -1
        t = ln.elapsed(lane, i)
        if is_recording(lane, t, i):
            x, v = lane[ln.X, i], lane[ln.V, i]
            for _ in range(_n_walls(q, i)):
                record(lane, lane_int, events, counters, ln.CONTACT, t, x, v, i)
    elif outcome.stopped & bit and _cut(lane, lane_int, q, scratch, is_located, i):
        return -1
    has_dipped = outcome.dipped & bit != 0
    n_passed = 0 if is_located else passings(q, lane[ln.OLD_X, i], lane[ln.X1, i], i)
    if has_dipped:
        n_passed += count_dips(lane, q, scratch, i)
    if outcome.recorded & bit:
        if settings[ln.S_DENSE] > 0.0:
            start = lane[ln.OLD_TURNS, i] + (lane[ln.OLD_TAU, i] - lane[ln.PHASE_0, i])
            t, x, v = start * lane[ln.PERIOD, i], lane[ln.OLD_X, i], lane[ln.OLD_V, i]
            record(lane, lane_int, events, counters, ln.STEP, t, x, v, i)
        n_listed = n_passed if settings[ln.S_CONTACTS] > 0.0 else 0
        section_only = settings[ln.S_SECTION_ONLY] > 0.0
        plan_probes(lane, lane_int, q, probes, scratch, section_only, n_listed, has_dipped, i)
        if begin_probing(lane, lane_int, probes, i):
            return -1
    return ln.OK if after_events(lane, lane_int, q, i) else -1
