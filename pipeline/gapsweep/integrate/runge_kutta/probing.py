"""Events inside an accepted step of one lane: extrema, section points and wall passings.

They are polished by *probes*: attempts of the same lane that repeat the accepted step from its
start with a length theta h and are never committed. So an event is as accurate as the steps
themselves, for any method and without an interpolant of its own, and a probe costs one attempt of
one lane while the other lanes go on.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.jit import inlined, internal

from . import lanes as ln
from . import parameters
from .interpolant import (
    STACK_SHAPE,
    derivative_coefficients,
    evaluate,
    position_coefficients,
    roots,
)


class Scratch(NamedTuple):
    """Work space for one lane: Bernstein coefficients of x and dx, roots, the finder's stack."""

    b: NDArray[np.float64]
    found: NDArray[np.float64]
    stack: NDArray[np.float64]


def new_scratch():
    """Work space of the right shapes."""
    return Scratch(np.zeros(11), np.zeros(ln.MAX_TURNS), np.zeros(STACK_SHAPE))


# A probe this close to the extremum (in steps) leaves the parabola through it exact to rounding.
CLOSE_ENOUGH = 1e-5
CLOSE_TO_RETURN = 1e-8
MAX_TRIES = 8


@internal
def coefficients(run, which, i):
    """Interpolant of a coordinate or a gap over the last attempt in `scratch.b`: six coefficients,
    and those of its slope.
    """
    at, lane, b = run.at, run.lane, run.scratch.b
    r = ln.ends(at, which)
    position_coefficients(
        lane[at.old_h, i], lane[r[0], i], lane[r[1], i], lane[r[2], i],
        lane[r[3], i], lane[r[4], i], lane[r[5], i], b,
    )  # fmt: skip
    derivative_coefficients(b, b[6:])


@internal
def passings(q, before, after, contact, i):
    low, high = q[contact, parameters.WALL_LOW, i], q[contact, parameters.WALL_HIGH, i]
    return int((before > high) != (after > high)) + int((before < low) != (after < low))


@internal
def step_passings(at, lane, q, contact, i):
    """How many walls of a contact lie between both ends of the last attempt."""
    rows = ln.ends(at, at.gaps_from + contact)
    return passings(q, lane[rows[0], i], lane[rows[3], i], contact, i)


@internal
def _passings_between_turns(run, n_turns, contact, i):
    """Walls passed in the last attempt by the pieces into which turns in `scratch` divide it; and
    whether one leaves the range of a fit.
    """
    at, lane, q, scratch = run.at, run.lane, run.q, run.scratch
    rows, range_ = ln.ends(at, at.gaps_from + contact), q[contact, parameters.RANGE, i]
    before, total, leaves = lane[rows[0], i], 0, False
    for m in range(n_turns + 1):
        after = evaluate(scratch.b[:6], scratch.found[m]) if m < n_turns else lane[rows[3], i]
        total += passings(q, before, after, contact, i)
        leaves = leaves or (range_ > 0.0 and abs(after - q[contact, parameters.CENTRE, i]) > range_)
        before = after
    return total, leaves


@inlined
def count_dips(run, contact, i):
    """Wall passings inside a step (and leaving of a fit's range) that its ends do not tell of."""
    at, lane, q, scratch = run.at, run.lane, run.q, run.scratch
    coefficients(run, at.gaps_from + contact, i)
    n = roots(scratch.b[6:], scratch.found, scratch.stack)
    total, leaves = _passings_between_turns(run, n, contact, i)
    if leaves:
        lane[at.out_of_range, i] = 1.0
    lane[at.n_contacts + contact, i] += total - step_passings(at, lane, q, contact, i)


# --- records --------------------------------------------------------------------------------------


@internal
def record(run, kind, t, state, i):
    """A record with the state in rows from `state` on."""
    at, lane, events = run.at, run.lane, run.events
    row = _begin_record(run, kind, t, 0, i)
    for j in range(at.n_states):
        events[row, ln.E_STATE + j] = lane[state + j, i]


@internal
def _begin_record(run, kind, t, which, i):
    """Number of a new row, whose state is left to the caller."""
    at, lane, lane_int, events, counters = run.at, run.lane, run.lane_int, run.events, run.counters
    row = counters[ln.N_EVENTS]
    events[row, ln.E_KIND], events[row, ln.E_POINT] = kind, lane_int[ln.POINT, i]
    events[row, ln.E_T], events[row, ln.E_WHICH] = t, which
    events[row, ln.E_H], events[row, ln.E_TAU] = lane[at.old_h, i], lane[at.old_tau, i]
    counters[ln.N_EVENTS] += 1
    return row


@internal
def is_recording(at, lane, t, i):
    """Whether time t (since the start) lies in the recorded part, to rounding."""
    turns = t * lane[at.omega, i] + lane[at.phase_0, i]
    return turns >= lane[at.record_turns, i] - 1e-12 * abs(turns)


@internal
def _add_probe(run, theta, kind, which, i):
    """Insert a probe in order of time."""
    at, lane_int, probes = run.at, run.lane_int, run.probes
    n = lane_int[ln.N_PROBES, i]
    j, size = n, at.max_probes
    while j > 0 and probes[j - 1, i] > theta:
        for row in (j, size + j, 2 * size + j):
            probes[row, i] = probes[row - 1, i]
        j -= 1
    probes[j, i], probes[size + j, i], probes[2 * size + j, i] = theta, kind, which
    lane_int[ln.N_PROBES, i] = n + 1


@internal
def _is_outside(x, q, kind, contact, i):
    if kind == ln.CONTACT:
        return x > q[contact, parameters.WALL_HIGH, i]
    return x < q[contact, parameters.WALL_LOW, i]


@internal
def _passing(b, q, kind, contact, left, right, i):
    """Theta at which a wall is passed between `left` and `right`, on different sides of it."""
    was_outside = _is_outside(evaluate(b[:6], left), q, kind, contact, i)
    for _ in range(20):
        middle = 0.5 * (left + right)
        if _is_outside(evaluate(b[:6], middle), q, kind, contact, i) == was_outside:
            left = middle
        else:
            right = middle
    return 0.5 * (left + right)


@inlined
def _plan_contacts(run, n_turns, contact, i):
    """List a contact's wall passings of the accepted step, exactly those that were counted."""
    at, lane, q, b, found = run.at, run.lane, run.q, run.scratch.b, run.scratch.found
    rows = ln.ends(at, at.gaps_from + contact)
    n_passed, _ = _passings_between_turns(run, n_turns, contact, i)
    # The count is below zero until a start has left its wall.
    n_skipped = n_passed - lane[at.n_contacts + contact, i]
    left, before = 0.0, lane[rows[0], i]
    for m in range(n_turns + 1):
        right, after = 1.0, lane[rows[3], i]
        if m < n_turns:
            right, after = found[m], evaluate(b[:6], found[m])
        for kind in (ln.CONTACT, ln.CONTACT_LOW):
            outside = _is_outside(before, q, kind, contact, i)
            if outside == _is_outside(after, q, kind, contact, i):
                continue
            if n_skipped > 0:
                n_skipped -= 1
                continue
            theta = _passing(b, q, kind, contact, left, right, i)
            _add_probe(run, theta, kind, contact, i)
        left, before = right, after


@internal
def _turns(run, which, i):
    """List where in the accepted step a quantity turns; their number.

    Of a step that hardly moves it speeds alone are left: differences of rounded places are noise.
    """
    lane, scratch, rows = run.lane, run.scratch, ln.ends(run.at, which)
    x, v_0, v_1 = lane[rows[3], i], lane[rows[1], i], lane[rows[4], i]
    if max(abs(v_0), abs(v_1)) * lane[run.at.step_h, i] > 1e-14 * abs(x):
        return roots(scratch.b[6:], scratch.found, scratch.stack)
    if v_0 * v_1 < 0.0:
        scratch.found[0] = v_0 / (v_0 - v_1)
        return 1
    return 0


@inlined
def plan_probes(run, has_dipped, i):
    """List the extrema inside the accepted step, and its wall passings if they are asked for.

    Where nothing forces the motion, its section points are maxima of the first coordinate.
    """
    at, lane, lane_int, settings = run.at, run.lane, run.lane_int, run.settings
    lane_int[ln.N_PROBES, i] = lane_int[ln.PROBE, i] = lane_int[ln.TRIES, i] = 0
    for contact in range(at.contacts):
        lane[at.passed_at + contact, i] = 0.0
    whole = max(lane[at.old_turns, i] + 1.0, np.ceil(lane[at.record_turns, i] - 1e-9))
    lane[at.next_whole, i] = np.inf if at.is_free else whole
    n_turning = at.n_turning
    lists_passings = settings.contacts and not (settings.is_located or settings.section_only)
    if settings.section_only:
        n_turning = 1 if at.is_free else 0
    for which in range(n_turning):
        coefficients(run, which, i)
        n_turns = _turns(run, which, i)
        for m in range(n_turns):
            _add_probe(run, run.scratch.found[m], ln.EXTREMUM, which, i)
        if which >= at.gaps_from and lists_passings:
            n_pieces = n_turns if has_dipped else 0
            contact = which - at.gaps_from
            _plan_contacts(run, n_pieces, contact, i)


@internal
def _section_theta(at, lane, i):
    """Where in the accepted step the next section point lies; above 1 if in a later one."""
    whole = lane[at.next_whole, i]
    if whole > lane[at.kept + at.turns, i]:
        return 2.0
    turns = whole - lane[at.old_turns, i] - lane[at.old_tau, i] - lane[at.old_tau_low, i]
    until = turns * lane[at.period, i]  # as long as the step that ends there, to the last bit
    return min(until / lane[at.step_h, i], 1.0)


@internal
def _send_probe(run, i):
    """Send the probe of the next event, in order of time; false if the step holds no more.

    A step may pass any number of whole turns, so their section points are not listed.
    """
    at, lane, lane_int, probes = run.at, run.lane, run.lane_int, run.probes
    j, theta, size = lane_int[ln.PROBE, i], _section_theta(at, lane, i), at.max_probes
    is_listed = j < lane_int[ln.N_PROBES, i]
    kind = ln.SECTION
    if is_listed and probes[j, i] < theta:
        theta, kind = probes[j, i], int(probes[size + j, i])
        lane_int[ln.WHICH, i] = int(probes[2 * size + j, i])
    lane_int[ln.KIND, i] = kind
    lane_int[ln.TRIES, i] = 0
    lane[at.h, i] = theta * lane[at.step_h, i]
    return theta <= 1.0


@internal
def begin_probing(run, i):
    """Set the lane back to the step's start and send the first probe; false if there is none."""
    at, lane, lane_int = run.at, run.lane, run.lane_int
    for j in range(at.n_start):
        lane[at.kept + j, i] = lane[at.q + j, i]
    lane[at.step_h, i] = lane[at.old_h, i]
    if not _send_probe(run, i):
        lane[at.h, i] = lane[at.kept + at.h, i]
        return False
    return_to_start(at, lane, i)
    lane[at.exact, i] = 1.0
    lane_int[ln.MODE, i] = ln.PROBING
    return True


@internal
def return_to_start(at, lane, i):
    for j in range(at.n_start - 1):
        lane[at.q + j, i] = lane[at.old_q + j, i]


@inlined
def _neighbours(run, i):
    """Times within the step between which the probed wall passing lies: the extremum or passing
    before it, and the extremum after it.
    """
    at, lane, lane_int, probes = run.at, run.lane, run.lane_int, run.probes
    which, step, size = lane_int[ln.WHICH, i], lane[at.step_h, i], at.max_probes
    low = lane[at.passed_at + which, i]
    for j in range(lane_int[ln.N_PROBES, i]):
        is_its = probes[2 * size + j, i] == at.gaps_from + which
        if is_its and probes[size + j, i] == ln.EXTREMUM:
            turn = max(low, probes[j, i] * step)
            if j > lane_int[ln.PROBE, i]:
                return low, turn
            low = turn
    return low, step


@inlined
def _improved(run, i):
    """Newton's step from the probed time within the step to that of the event."""
    at, lane, lane_int, q = run.at, run.lane, run.lane_int, run.q
    h, step, which = lane[at.h, i], lane[at.step_h, i], lane_int[ln.WHICH, i]
    if lane_int[ln.KIND, i] == ln.EXTREMUM:
        rows = ln.ends(at, which)
        v, a = lane[rows[4], i], lane[rows[5], i]
        dt = -v / a if a != 0.0 else 0.0
        return h + min(max(dt, -0.25 * step), 0.25 * step)
    rows = ln.ends(at, at.gaps_from + which)
    x, v = lane[rows[3], i], lane[rows[4], i]
    is_high = lane_int[ln.KIND, i] == ln.CONTACT
    wall = q[which, parameters.WALL_HIGH if is_high else parameters.WALL_LOW, i]
    low, high = _neighbours(run, i)
    dt = (wall - x) / v if v != 0.0 else 0.0
    return min(max(h + dt, low), high)


@internal
def _is_return(at, lane, lane_int, i):
    """Whether the probed event is a maximum that is a section point."""
    is_first = lane_int[ln.KIND, i] == ln.EXTREMUM and lane_int[ln.WHICH, i] == 0
    return at.is_free and is_first and lane[at.a_1, i] < 0.0


@internal
def _record_moved(run, kind, t, dt, i):
    """A record with the state a short time after the probe."""
    at, lane, lane_int, events = run.at, run.lane, run.lane_int, run.events
    which = lane_int[ln.WHICH, i] if kind == ln.CONTACT else 0
    row = _begin_record(run, kind, t, which, i)
    for j in range(at.n):
        v, a = lane[at.v_1 + j, i], lane[at.a_1 + j, i]
        events[row, ln.E_STATE + j] = lane[at.q_1 + j, i] + v * dt
        events[row, ln.E_STATE + at.n + j] = v + a * dt
    for j in range(at.m):
        rate = lane[at.w_1 + j, i]
        events[row, ln.E_STATE + 2 * at.n + j] = lane[at.z_1 + j, i] + rate * dt
    if kind == ln.SECTION:
        events[row, ln.E_STATE + at.n] = 0.0  # to the last bit: the next motion begins here


@inlined
def _record_probed(run, kind, t, dt, i):
    """Record the probed event, which lies dt after the probe."""
    at, lane, lane_int, events = run.at, run.lane, run.lane_int, run.events
    if kind == ln.SECTION:
        record(run, kind, t, at.q_1, i)
    elif kind == ln.EXTREMUM:
        if _is_return(at, lane, lane_int, i):
            _record_moved(run, ln.SECTION, t, dt, i)
        which = lane_int[ln.WHICH, i]
        rows = ln.ends(at, which)
        row = _begin_record(run, kind, t, which, i)
        for j in range(1, at.n_states):
            events[row, ln.E_STATE + j] = 0.0
        events[row, ln.E_STATE] = lane[rows[3], i] + 0.5 * lane[rows[4], i] * dt
    else:
        _record_moved(run, ln.CONTACT, t, dt, i)


@inlined
def probed(run, i):
    """Judge one probe; true when the last event of the step is recorded."""
    at, lane, lane_int = run.at, run.lane, run.lane_int
    kind, dt = lane_int[ln.KIND, i], 0.0
    h, step = lane[at.h, i], lane[at.step_h, i]
    if kind == ln.SECTION:
        t = (lane[at.next_whole, i] - lane[at.phase_0, i]) * lane[at.period, i]
        lane[at.next_whole, i] += 1.0
    else:
        improved = _improved(run, i)
        dt = improved - h
        # A section point has to be as good as the motion: all of its state, not its height alone.
        close = CLOSE_TO_RETURN if _is_return(at, lane, lane_int, i) else CLOSE_ENOUGH
        if abs(dt) > close * step and lane_int[ln.TRIES, i] < MAX_TRIES:
            lane[at.h, i] = min(max(improved, 0.0), step)
            lane_int[ln.TRIES, i] += 1
            return False
        t = ln.elapsed(at, lane, i) + improved
        if kind != ln.EXTREMUM:
            lane[at.passed_at + lane_int[ln.WHICH, i], i] = improved
        lane_int[ln.PROBE, i] += 1
    if is_recording(at, lane, t, i):
        _record_probed(run, kind, t, dt, i)
    if _send_probe(run, i):
        return False
    for j in range(at.n_start):
        lane[at.q + j, i] = lane[at.kept + j, i]
    lane[at.exact, i] = 0.0
    lane_int[ln.MODE, i] = ln.STEPPING
    return True
