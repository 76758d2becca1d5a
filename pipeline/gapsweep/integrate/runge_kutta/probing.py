"""Events inside an accepted step of one lane: extrema, section points and wall passings.

They are polished by *probes*: attempts of the same lane that repeat the accepted step from its
start with a length theta h and are never committed. So an event is as accurate as the steps
themselves, for any method and without an interpolant of its own, and a probe costs one attempt of
one lane while the other lanes go on.
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
    return Scratch(np.zeros(11), np.zeros(ln.MAX_TURNS), np.zeros(STACK_SHAPE))


# A probe this close to the extremum (in units of the step) leaves the parabola through it exact to
# rounding.
CLOSE_ENOUGH = 1e-5
MAX_TRIES = 8


@allocating
def coefficients(lane, b, i):
    """Interpolant of the last attempt: x into b[:6], its derivative into b[6:]."""
    position_coefficients(
        lane[ln.OLD_H, i], lane[ln.OLD_X, i], lane[ln.OLD_V, i], lane[ln.OLD_A, i],
        lane[ln.X1, i], lane[ln.V1, i], lane[ln.A1, i], b,
    )  # fmt: skip
    derivative_coefficients(b, b[6:])


@allocating
def passings(q, before, after, i):
    low, high = q[laws.WALL_LOW, i], q[laws.WALL_HIGH, i]
    return int((before > high) != (after > high)) + int((before < low) != (after < low))


@allocating
def count_dips(lane, q, scratch, i):
    """Wall passings inside a step (and leaving of a fit's range) that its ends do not tell of."""
    b, found = scratch.b, scratch.found
    coefficients(lane, b, i)
    n = roots(b[6:], found, scratch.stack)
    before = lane[ln.OLD_X, i]
    total = -passings(q, before, lane[ln.X1, i], i)
    for m in range(n + 1):
        after = evaluate(b[:6], found[m]) if m < n else lane[ln.X1, i]
        total += passings(q, before, after, i)
        if q[laws.RANGE, i] > 0.0 and abs(after - q[laws.CENTRE, i]) > q[laws.RANGE, i]:
            lane[ln.OUT_OF_RANGE, i] = 1.0
        before = after
    lane[ln.N_CONTACTS, i] += total
    return total


# --- records --------------------------------------------------------------------------------------


@allocating
def record(lane, lane_int, events, counters, kind, t, x, v, i):
    row = events[counters[ln.N_EVENTS]]
    row[ln.E_KIND], row[ln.E_POINT] = kind, lane_int[ln.POINT, i]
    row[ln.E_T], row[ln.E_X], row[ln.E_V] = t, x, v
    row[ln.E_H], row[ln.E_TAU] = lane[ln.OLD_H, i], lane[ln.OLD_TAU, i]
    counters[ln.N_EVENTS] += 1


@allocating
def is_recording(lane, t, i):
    """Whether time t (since the start) lies in the recorded part, to rounding."""
    turns = t * lane[ln.FREQUENCY, i] + lane[ln.PHASE_0, i]
    return turns >= lane[ln.RECORD_TURNS, i] - 1e-12 * abs(turns)


@allocating
def _add_probe(lane_int, probes, theta, kind, i):
    """Insert a probe in order of time."""
    n = lane_int[ln.N_PROBES, i]
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
def _is_outside(x, q, kind, i):
    return x > q[laws.WALL_HIGH, i] if kind == ln.CONTACT else x < q[laws.WALL_LOW, i]


@allocating
def _passing(b, q, kind, left, right, i):
    """Theta between `left` and `right`, which lie on different sides of a wall, where it is
    passed.
    """
    was_outside = _is_outside(evaluate(b[:6], left), q, kind, i)
    for _ in range(20):
        middle = 0.5 * (left + right)
        if _is_outside(evaluate(b[:6], middle), q, kind, i) == was_outside:
            left = middle
        else:
            right = middle
    return 0.5 * (left + right)


@allocating
def _plan_contacts(lane, lane_int, q, probes, scratch, n_turns, n_skipped, i):
    """List the wall passings of the accepted step, exactly those that were counted."""
    b, found = scratch.b, scratch.found
    left, before = 0.0, lane[ln.OLD_X, i]
    for m in range(n_turns + 1):
        right, after = 1.0, lane[ln.X1, i]
        if m < n_turns:
            right, after = found[m], evaluate(b[:6], found[m])
        for kind in (ln.CONTACT, ln.CONTACT_LOW):
            if _is_outside(before, q, kind, i) == _is_outside(after, q, kind, i):
                continue
            if n_skipped > 0:
                n_skipped -= 1
                continue
            _add_probe(lane_int, probes, _passing(b, q, kind, left, right, i), kind, i)
        left, before = right, after


@allocating
def plan_probes(lane, lane_int, q, probes, scratch, section_only, n_passed, has_dipped, i):
    """List the extrema inside the accepted step, and its wall passings if there are any to list."""
    lane_int[ln.N_PROBES, i] = lane_int[ln.PROBE, i] = lane_int[ln.TRIES, i] = 0
    lane[ln.PASSED_AT, i] = 0.0
    lane[ln.NEXT_WHOLE, i] = max(
        lane[ln.OLD_TURNS, i] + 1.0, np.ceil(lane[ln.RECORD_TURNS, i] - 1e-9)
    )
    if section_only:
        return
    b, found = scratch.b, scratch.found
    coefficients(lane, b, i)
    n_turns = roots(b[6:], found, scratch.stack)
    for m in range(n_turns):
        _add_probe(lane_int, probes, found[m], ln.EXTREMUM, i)
    if n_passed > 0:
        # The count is below zero until a start has left its wall.
        n_skipped = n_passed - lane[ln.N_CONTACTS, i]
        n_turns = n_turns if has_dipped else 0
        _plan_contacts(lane, lane_int, q, probes, scratch, n_turns, n_skipped, i)


@allocating
def _section_theta(lane, i):
    """Where in the accepted step the next section point lies; above 1 if in a later one."""
    whole = lane[ln.NEXT_WHOLE, i]
    if whole > lane[ln.KEPT_TURNS, i]:
        return 2.0
    until = ((whole - lane[ln.OLD_TURNS, i]) - lane[ln.OLD_TAU, i]) * lane[ln.PERIOD, i]
    return min(until / lane[ln.STEP_H, i], 1.0)


@allocating
def _send_probe(lane, lane_int, probes, i):
    """Send the probe of the next event, in order of time; false if the step holds no more.

    A step may pass any number of whole turns, so their section points are not listed.
    """
    j, theta = lane_int[ln.PROBE, i], _section_theta(lane, i)
    is_listed = j < lane_int[ln.N_PROBES, i]
    kind = ln.SECTION
    if is_listed and probes[j, i] < theta:
        theta, kind = probes[j, i], int(probes[ln.MAX_PROBES + j, i])
    lane_int[ln.KIND, i] = kind
    lane_int[ln.TRIES, i] = 0
    lane[ln.H, i] = theta * lane[ln.STEP_H, i]
    return theta <= 1.0


@allocating
def begin_probing(lane, lane_int, probes, i):
    """Set the lane back to the start of the step and send the first probe; false if there is
    none.
    """
    for offset in range(6):
        lane[ln.KEPT_X + offset, i] = lane[ln.X + offset, i]
    lane[ln.STEP_H, i] = lane[ln.OLD_H, i]
    if not _send_probe(lane, lane_int, probes, i):
        lane[ln.H, i] = lane[ln.KEPT_H, i]
        return False
    return_to_start(lane, i)
    lane[ln.EXACT, i] = 1.0
    lane_int[ln.MODE, i] = ln.PROBING
    return True


@allocating
def return_to_start(lane, i):
    for offset in range(5):
        lane[ln.X + offset, i] = lane[ln.OLD_X + offset, i]


@allocating
def _neighbours(lane, lane_int, probes, i):
    """Times within the step between which the probed wall passing lies: the extremum or passing
    before it, and the extremum after it.
    """
    low, step = lane[ln.PASSED_AT, i], lane[ln.STEP_H, i]
    for j in range(lane_int[ln.N_PROBES, i]):
        if probes[ln.MAX_PROBES + j, i] == ln.EXTREMUM:
            turn = max(low, probes[j, i] * step)
            if j > lane_int[ln.PROBE, i]:
                return low, turn
            low = turn
    return low, step


@allocating
def _improved(lane, lane_int, q, probes, i):
    """Newton's step from the probed time within the step to that of the event."""
    h, step = lane[ln.H, i], lane[ln.STEP_H, i]
    x, v, a = lane[ln.X1, i], lane[ln.V1, i], lane[ln.A1, i]
    if lane_int[ln.KIND, i] == ln.EXTREMUM:
        dt = -v / a if a != 0.0 else 0.0
        return h + min(max(dt, -0.25 * step), 0.25 * step)
    wall = q[laws.WALL_HIGH if lane_int[ln.KIND, i] == ln.CONTACT else laws.WALL_LOW, i]
    low, high = _neighbours(lane, lane_int, probes, i)
    dt = (wall - x) / v if v != 0.0 else 0.0
    return min(max(h + dt, low), high)


@allocating
def probed(lane, lane_int, q, probes, events, counters, i):
    """Judge one probe; true when the last event of the step is recorded."""
    kind = lane_int[ln.KIND, i]
    h, step = lane[ln.H, i], lane[ln.STEP_H, i]
    x, v, a = lane[ln.X1, i], lane[ln.V1, i], lane[ln.A1, i]
    if kind == ln.SECTION:
        t = (lane[ln.NEXT_WHOLE, i] - lane[ln.PHASE_0, i]) * lane[ln.PERIOD, i]
        lane[ln.NEXT_WHOLE, i] += 1.0
    else:
        at = _improved(lane, lane_int, q, probes, i)
        dt = at - h
        if abs(dt) > CLOSE_ENOUGH * step and lane_int[ln.TRIES, i] < MAX_TRIES:
            lane[ln.H, i] = min(max(at, 0.0), step)
            lane_int[ln.TRIES, i] += 1
            return False
        t = ln.elapsed(lane, i) + at
        if kind == ln.EXTREMUM:
            x, v = x + 0.5 * v * dt, 0.0
        else:
            x, v = x + v * dt, v + a * dt
            kind = ln.CONTACT
            lane[ln.PASSED_AT, i] = at
        lane_int[ln.PROBE, i] += 1
    if is_recording(lane, t, i):
        record(lane, lane_int, events, counters, kind, t, x, v, i)
    if _send_probe(lane, lane_int, probes, i):
        return False
    for offset in range(6):
        lane[ln.X + offset, i] = lane[ln.KEPT_X + offset, i]
    lane[ln.EXACT, i] = 0.0
    lane_int[ln.MODE, i] = ln.STEPPING
    return True
