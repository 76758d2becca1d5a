"""What happens to one lane after an attempt that needs attention: events, landings, ends, failures.

An extremum or a section point is polished by *probes*: attempts of the same lane that repeat the
accepted step from its start with a length theta h and are never committed. So an event is as
accurate
as the steps themselves, for any method and without an interpolant of its own, and a probe costs one
attempt of one lane while the other lanes go on.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.jit import allocating

from . import lanes as ln
from . import laws
from .interpolant import (
    STACK_SHAPE,
    derivative_coefficients,
    evaluate,
    position_coefficients,
    roots,
)


class Scratch(NamedTuple):
    """Work space for one lane: Bernstein coefficients of x and dx, roots, and the stack of the root
    finder.
    """

    b: NDArray[np.float64]
    found: NDArray[np.float64]
    stack: NDArray[np.float64]


def new_scratch():
    """Work space of the right shapes."""
    return Scratch(np.zeros(11), np.zeros(8), np.zeros(STACK_SHAPE))


# A probe this close to the extremum (in units of the step) leaves the parabola through it exact to
# rounding.
CLOSE_ENOUGH = 1e-5
MAX_TRIES = 8


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
    return max(1.0 / rate if h * rate > 1.0 else h, 1e-17 * lane[ln.PERIOD, i])


@allocating
def started(lane, lane_int, settings, exponent, i):
    """The acceleration at the start is known: choose the first step."""
    lane[ln.A, i] = lane[ln.A1, i]
    left = ln.remaining(lane, i)
    # Native steps stay within one period so that a step holds at most one section point.
    lane[ln.H_MAX, i] = 0.1 * left if settings[ln.S_ODE45] > 0.0 else lane[ln.PERIOD, i]
    lane[ln.H, i] = first_step(lane, settings, exponent, i)
    lane[ln.EXACT, i] = 0.0
    lane_int[ln.MODE, i] = ln.STEPPING


@allocating
def _coefficients(lane, b, i):
    """Interpolant of the last attempt: x into b[:6], its derivative into b[6:]."""
    position_coefficients(
        lane[ln.OLD_H, i], lane[ln.OLD_X, i], lane[ln.OLD_V, i], lane[ln.OLD_A, i],
        lane[ln.X1, i], lane[ln.V1, i], lane[ln.A1, i], b,
    )  # fmt: skip
    derivative_coefficients(b, b[6:])


@allocating
def _passings(q, before, after, i):
    low, high = q[laws.WALL_LOW, i], q[laws.WALL_HIGH, i]
    return int((before > high) != (after > high)) + int((before < low) != (after < low))


@allocating
def count_dips(lane, q, scratch, i):
    """Wall passings (and leaving of a fit's range) by extrema inside a step with both ends on one
    side.
    """
    b, found = scratch.b, scratch.found
    _coefficients(lane, b, i)
    n = roots(b[6:], found, scratch.stack)
    before = lane[ln.OLD_X, i]
    total = -_passings(q, before, lane[ln.X1, i], i)
    for m in range(n + 1):
        after = evaluate(b[:6], found[m]) if m < n else lane[ln.X1, i]
        total += _passings(q, before, after, i)
        if q[laws.RANGE, i] > 0.0 and abs(after) > q[laws.RANGE, i]:
            lane[ln.OUT_OF_RANGE, i] = 1.0
        before = after
    lane[ln.N_CONTACTS, i] += total


# --- records --------------------------------------------------------------------------------------


@allocating
def _record(lane, lane_int, events, counters, kind, t, x, v, i):
    row = events[counters[ln.N_EVENTS]]
    row[ln.E_KIND], row[ln.E_POINT] = kind, lane_int[ln.POINT, i]
    row[ln.E_T], row[ln.E_X], row[ln.E_V] = t, x, v
    row[ln.E_H], row[ln.E_TAU] = lane[ln.OLD_H, i], lane[ln.OLD_TAU, i]
    counters[ln.N_EVENTS] += 1


@allocating
def _is_recording(lane, t, i):
    """Whether time t (since the start) lies in the recorded part, to rounding."""
    turns = t * lane[ln.FREQUENCY, i] + lane[ln.PHASE_0, i]
    return turns >= lane[ln.RECORD_TURNS, i] - 1e-12 * (1.0 + abs(turns))


@allocating
def _add_probe(lane_int, probes, theta, kind, i):
    """Insert a probe in order of time."""
    n = lane_int[ln.N_PROBES, i]
    if n == ln.MAX_PROBES:
        return
    j = n
    while j > 0 and probes[j - 1, i] > theta:
        probes[j, i], probes[ln.MAX_PROBES + j, i] = (
            probes[j - 1, i],
            probes[ln.MAX_PROBES + j - 1, i],
        )
        j -= 1
    probes[j, i], probes[ln.MAX_PROBES + j, i] = theta, kind
    lane_int[ln.N_PROBES, i] = n + 1


@allocating
def _plan_probes(lane, lane_int, probes, scratch, i):
    """List the section points and extrema inside the accepted step."""
    lane_int[ln.N_PROBES, i] = lane_int[ln.PROBE, i] = lane_int[ln.TRIES, i] = 0
    whole = lane[ln.OLD_TURNS, i] + 1.0
    while whole <= lane[ln.TURNS, i]:
        until = ((whole - lane[ln.OLD_TURNS, i]) - lane[ln.OLD_TAU, i]) * lane[ln.PERIOD, i]
        if whole >= lane[ln.RECORD_TURNS, i] - 1e-9:
            _add_probe(lane_int, probes, min(until / lane[ln.OLD_H, i], 1.0), ln.SECTION, i)
        whole += 1.0
    b, found = scratch.b, scratch.found
    _coefficients(lane, b, i)
    for m in range(roots(b[6:], found, scratch.stack)):
        _add_probe(lane_int, probes, found[m], ln.EXTREMUM, i)


@allocating
def _begin_probing(lane, lane_int, probes, i):
    """Set the lane back to the start of the step and send the first probe."""
    for offset in range(6):
        lane[ln.KEPT_X + offset, i] = lane[ln.X + offset, i]
    _return_to_start(lane, i)
    lane[ln.STEP_H, i] = lane[ln.OLD_H, i]
    lane[ln.H, i] = probes[0, i] * lane[ln.OLD_H, i]
    lane[ln.EXACT, i] = 1.0
    lane_int[ln.MODE, i] = ln.PROBING


@allocating
def _return_to_start(lane, i):
    for offset in range(5):
        lane[ln.X + offset, i] = lane[ln.OLD_X + offset, i]


@allocating
def _probed(lane, lane_int, probes, events, counters, i):
    """Judge one probe; true when the last event of the step is recorded."""
    j = lane_int[ln.PROBE, i]
    kind = int(probes[ln.MAX_PROBES + j, i])
    h, step = lane[ln.H, i], lane[ln.STEP_H, i]
    x, v, a = lane[ln.X1, i], lane[ln.V1, i], lane[ln.A1, i]
    t = ln.elapsed(lane, i) + h
    if kind == ln.EXTREMUM:
        dt = -v / a if a != 0.0 else 0.0
        dt = min(max(dt, -0.25 * step), 0.25 * step)
        if abs(dt) > CLOSE_ENOUGH * step and lane_int[ln.TRIES, i] < MAX_TRIES:
            lane[ln.H, i] = min(max(h + dt, 0.0), step)
            lane_int[ln.TRIES, i] += 1
            return False
        x, v, t = x + 0.5 * v * dt, 0.0, t + dt
    else:
        whole = lane[ln.TURNS, i] + np.rint(lane[ln.TAU, i] + h * lane[ln.FREQUENCY, i])
        t = (whole - lane[ln.PHASE_0, i]) * lane[ln.PERIOD, i]
    if _is_recording(lane, t, i):
        _record(lane, lane_int, events, counters, kind, t, x, v, i)
    lane_int[ln.TRIES, i] = 0
    lane_int[ln.PROBE, i] = j + 1
    if j + 1 < lane_int[ln.N_PROBES, i]:
        lane[ln.H, i] = probes[j + 1, i] * step
        return False
    for offset in range(6):
        lane[ln.X + offset, i] = lane[ln.KEPT_X + offset, i]
    lane[ln.EXACT, i] = 0.0
    lane_int[ln.MODE, i] = ln.STEPPING
    return True


# --- steps cut at a wall or at the edge of a layer
# ----------------------------------------------------


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
        if q[laws.ACTIVE_STIFFNESS, i] != 0.0:
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
        lane[ln.N_CONTACTS, i] -= _passings(q, lane[ln.OLD_X, i], lane[ln.X1, i], i)
    _return_to_start(lane, i)
    for row in range(4):
        lane[ln.TANGENT + row, i] = lane[ln.OLD_TANGENT + row, i]
    lane[ln.N_STEPS, i] -= 1.0
    lane[ln.N_REJECTED, i] += 1.0
    lane[ln.EXACT, i] = 2.0


@allocating
def _cut(lane, lane_int, q, scratch, is_located, i):
    """Repeat the step up to the first edge; false if it does not reach one after all."""
    _coefficients(lane, scratch.b, i)
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
    if q[laws.ACTIVE_STIFFNESS, i] != 0.0:
        return q[laws.ACTIVE_WALL, i]
    low, high = q[laws.WALL_LOW, i], q[laws.WALL_HIGH, i]
    return high if abs(lane[ln.X1, i] - high) < abs(lane[ln.X1, i] - low) else low


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
    lane[ln.N_CONTACTS, i] += 1.0
    return True


@allocating
def choose_mode(lane, q, i):
    """Contact mode of a located run from the present state: velocity, then acceleration, decide on
    a wall.
    """
    x = lane[ln.X, i]
    low, high = q[laws.WALL_LOW, i], q[laws.WALL_HIGH, i]
    heading = lane[ln.V, i] if lane[ln.V, i] != 0.0 else lane[ln.A, i]
    q[laws.ACTIVE_STIFFNESS, i] = q[laws.ACTIVE_WALL, i] = 0.0
    if x > high or (x == high and heading > 0.0):
        q[laws.ACTIVE_STIFFNESS, i], q[laws.ACTIVE_WALL, i] = q[laws.STIFFNESS, i], high
    elif x < low or (x == low and heading < 0.0):
        q[laws.ACTIVE_STIFFNESS, i], q[laws.ACTIVE_WALL, i] = q[laws.STIFFNESS, i], low


@allocating
def _corrects_mode(lane, q, i):
    """Choose the mode of a start; true if the stiffness was another one."""
    before = q[laws.ACTIVE_STIFFNESS, i]
    choose_mode(lane, q, i)
    # On a wall both modes have the same acceleration, which has just decided between them.
    on_wall = lane[ln.X, i] == q[laws.WALL_LOW, i] or lane[ln.X, i] == q[laws.WALL_HIGH, i]
    return q[laws.ACTIVE_STIFFNESS, i] != before and not on_wall


# --- one lane's turn
# ------------------------------------------------------------------------------------


@allocating
def _failure_status(lane, q, settings, committed, i):
    x = lane[ln.X1, i]
    if not (np.isfinite(x) and abs(x) <= settings[ln.S_BOUND]):
        return ln.DIVERGED
    if committed and lane[ln.N_ATTEMPTS, i] <= settings[ln.S_MAX_ATTEMPTS]:
        return ln.MODEL_INVALID
    if lane[ln.N_ATTEMPTS, i] > settings[ln.S_MAX_ATTEMPTS]:
        return ln.TIMED_OUT
    return ln.STEP_UNDERFLOW


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
        if is_located and _corrects_mode(lane, q, i):
            ln.begin_start(lane, lane_int, i)  # the acceleration was that of another mode
            return -1
        return ln.OK if ln.remaining(lane, i) <= 0.0 else -1
    if mode == ln.PROBING:
        if not _probed(lane, lane_int, probes, events, counters, i):
            return -1
        return ln.OK if after_events(lane, lane_int, q, i) else -1
    if outcome.failed & bit:
        return _failure_status(lane, q, settings, outcome.accepted & bit != 0, i)
    if is_located and lane_int[ln.LANDING, i] and outcome.accepted & bit:
        if not _landed(lane, lane_int, q, i):
            return -1
        if _is_recording(lane, ln.elapsed(lane, i), i):
            _record(
                lane,
                lane_int,
                events,
                counters,
                ln.CONTACT,
                ln.elapsed(lane, i),
                lane[ln.X, i],
                lane[ln.V, i],
                i,
            )
    elif outcome.stopped & bit and _cut(lane, lane_int, q, scratch, is_located, i):
        return -1
    if outcome.dipped & bit:
        count_dips(lane, q, scratch, i)
    if outcome.recorded & bit:
        if settings[ln.S_DENSE] > 0.0:
            t = (lane[ln.OLD_TURNS, i] + (lane[ln.OLD_TAU, i] - lane[ln.PHASE_0, i])) * lane[
                ln.PERIOD, i
            ]
            _record(
                lane,
                lane_int,
                events,
                counters,
                ln.STEP,
                t,
                lane[ln.OLD_X, i],
                lane[ln.OLD_V, i],
                i,
            )
        _plan_probes(lane, lane_int, probes, scratch, i)
        if lane_int[ln.N_PROBES, i] > 0:
            _begin_probing(lane, lane_int, probes, i)
            return -1
    return ln.OK if after_events(lane, lane_int, q, i) else -1
