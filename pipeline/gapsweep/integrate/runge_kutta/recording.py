"""What happens to one lane after an attempt that needs attention: landings, ends, failures; and its
events, which are found by `probing`.
"""

import numpy as np

from gapsweep.integrate.jit import inlined, internal
from gapsweep.integrate.simd import fma, lane_value, load

from . import lanes as ln
from . import parameters, vecmath
from .attempt import clock
from .interpolant import derivative_coefficients, evaluate, position_coefficients, roots
from .probing import (
    begin_probing,
    coefficients,
    count_dips,
    is_recording,
    plan_probes,
    probed,
    record,
    return_to_start,
    step_passings,
)


@internal
def first_step(at, lane, settings, i):
    """Length of a first step from rest by the size of y' alone: ode45's rule, also the native."""
    threshold, rate = settings.atol / settings.rtol, 0.0
    for j in range(at.n_states):
        # Derivatives of the state: speeds, accelerations, rates of first-order states.
        slope = lane[at.v + j if j < at.n else at.a + j - at.n, i]
        rate = max(rate, abs(slope) / max(abs(lane[at.q + j, i]), threshold))
    rate /= 0.8 * settings.rtol**settings.exponent
    left = ln.remaining(at, lane, i)
    h = min(lane[at.h_max, i], left)
    if settings.first_step > 0.0:
        return min(h, settings.first_step)
    return max(1.0 / rate if h * rate > 1.0 else h, lane[at.h_min, i])


@internal
def begin_steps(run, i):
    """The derivative at the start is known: choose the first step."""
    at, lane, lane_int, settings = run.at, run.lane, run.lane_int, run.settings
    if settings.is_ode45:
        lane[at.h_max, i] = 0.1 * ln.remaining(at, lane, i)
    lane[at.h, i] = first_step(at, lane, settings, i)
    lane[at.exact, i] = 0.0
    lane_int[ln.MODE, i] = ln.STEPPING


@internal
def _heads_out(at, lane, q, contact, i):
    """How many walls a start lies on and heads out over: to leave a wall is not to pass it."""
    rows = ln.ends(at, at.gaps_from + contact)
    x, v, a = lane[rows[3], i], lane[rows[4], i], lane[rows[5], i]
    heading = v if v != 0.0 else a
    over_high = x == q[contact, parameters.WALL_HIGH, i] and heading > 0.0
    over_low = x == q[contact, parameters.WALL_LOW, i] and heading < 0.0
    return int(over_high) + int(over_low)


# --- steps cut at a wall or at the edge of a layer ------------------------------------------------


@internal
def _first_root(scratch, target, best):
    b, found = scratch.b, scratch.found
    for j in range(6):
        b[j] -= target
    n = roots(b[:6], found, scratch.stack)
    for j in range(6):
        b[j] += target
    return min(best, found[0]) if n > 0 else best


@inlined
def _first_edge(run, contact, i):
    """Theta at which the step first reaches a wall (located) or layer; above 1 if never."""
    at, lane, q, scratch = run.at, run.lane, run.q, run.scratch
    best, x = 2.0, lane[ln.ends(at, at.gaps_from + contact)[0], i]
    low, high = q[contact, parameters.WALL_LOW, i], q[contact, parameters.WALL_HIGH, i]
    if run.settings.is_located:
        if q[contact, parameters.ACTIVE_MODE, i] != 0.0:
            return _first_root(scratch, q[contact, parameters.ACTIVE_WALL, i], best)
        return _first_root(scratch, low, _first_root(scratch, high, best))
    half = q[contact, parameters.LAYER, i]
    for wall in (low, high):
        # Slightly inside, so that the landing counts as inside whatever its rounding. A step that
        # starts inside is not cut.
        if abs(x - low) > half and abs(x - high) > half and half > 0.0:
            target = wall - 0.95 * half if x < wall else wall + 0.95 * half
            best = _first_root(scratch, target, best)
    return best


@internal
def _led(b, theta, h, x, v, a, x_1, v_1, a_1):
    """Where the interpolant of a step leads, and how fast it is there; b: work space."""
    position_coefficients(h, x, v, a, x_1, v_1, a_1, b)
    derivative_coefficients(b, b[6:])
    return evaluate(b[:6], theta), 5.0 * evaluate(b[6:], theta) / h


@inlined
def _shorten(run, theta, i):
    """End the accepted step of an oscillator at theta, on its interpolant and its tangents'."""
    at, lane, k_tangent, b = run.at, run.lane, run.k_tangent, run.scratch.b
    h, n_stages = lane[at.old_h, i], k_tangent.shape[0] // 2
    lane[at.q_1, i], lane[at.v_1, i] = _led(
        b, theta, h, lane[at.old_q, i], lane[at.old_v, i], lane[at.old_a, i],
        lane[at.q_1, i], lane[at.v_1, i], lane[at.a_1, i],
    )  # fmt: skip
    for column in range(2 if run.settings.tangent else 0):
        old, new = at.old_tangent + 2 * column, at.tangent_state + 2 * column
        first, last = column * n_stages, (column + 1) * n_stages - 1
        lane[new, i], lane[new + 1, i] = _led(
            b, theta, h, lane[old, i], lane[old + 1, i], k_tangent[first, i],
            lane[new, i], lane[new + 1, i], k_tangent[last, i],
        )  # fmt: skip
    return_to_start(at, lane, i)
    lane[at.old_h, i] = theta * h
    tau, low, turns = clock(at, lane, load(lane, at.old_h))
    lane[at.tau, i], lane[at.tau_low, i] = lane_value(tau, i), lane_value(low, i)
    lane[at.turns, i], lane[at.v, i] = lane_value(turns, i), lane[at.v_1, i]


@internal
def _revoke(run, i):
    """Undo the accepted step: it is repeated in part."""
    at, lane = run.at, run.lane
    if not run.settings.is_located:
        _uncount(run, i)
    return_to_start(at, lane, i)
    for j in range(at.n_states * at.n_states):
        lane[at.tangent_state + j, i] = lane[at.old_tangent + j, i]
    lane[at.n_steps, i] -= 1.0
    lane[at.n_rejected, i] += 1.0
    lane[at.exact, i] = 2.0


@internal
def _uncount(run, i):
    """Take back what walls the last attempt has passed."""
    at, lane = run.at, run.lane
    for contact in range(at.contacts):
        lane[at.n_contacts + contact, i] -= step_passings(at, lane, run.q, contact, i)


@inlined
def _cut(run, i):
    """End the step at the first edge; whether it is repeated up to there.

    The interpolant is as accurate as steps of order 5: on it these end on a wall at once.
    """
    at, lane, lane_int, settings, theta = run.at, run.lane, run.lane_int, run.settings, 2.0
    for contact in range(at.contacts):
        coefficients(run, at.gaps_from + contact, i)
        theta = min(theta, _first_edge(run, contact, i))
    if theta > 1.0:
        return False
    if settings.is_located and settings.is_ode45:
        lane[at.h_saved, i] = lane[at.h, i]
        _shorten(run, theta, i)
        lane[at.a_1, i] = _stand_on(run, _landing_wall(at, lane, run.q, i), i)
        return False
    _revoke(run, i)
    lane[at.h_saved, i] = lane[at.old_h, i]
    lane[at.h, i] = theta * lane[at.old_h, i]
    lane_int[ln.LANDING, i] = 1
    lane_int[ln.TRIES, i] = 0
    return True


# Located contacts are those of oscillators: one coordinate, which is the gap.


@internal
def _landing_wall(at, lane, q, i):
    """The wall that a located landing aims at."""
    if q[0, parameters.ACTIVE_MODE, i] != 0.0:
        return q[0, parameters.ACTIVE_WALL, i]
    low, high = q[0, parameters.WALL_LOW, i], q[0, parameters.WALL_HIGH, i]
    return high if abs(lane[at.q_1, i] - high) < abs(lane[at.q_1, i] - low) else low


@internal
def _n_walls(q, i):
    """Walls passed at once: where no gap lies between them one is left and the other entered."""
    return 2 if q[0, parameters.WALL_LOW, i] == q[0, parameters.WALL_HIGH, i] else 1


@inlined
def _landed(run, i):
    """Newton's method on the landing time; true when x is on the wall."""
    at, lane, lane_int, q = run.at, run.lane, run.lane_int, run.q
    wall = _landing_wall(at, lane, q, i)
    miss, v = lane[at.q_1, i] - wall, lane[at.v_1, i]
    close = abs(miss) <= 1e-15 * (abs(wall) + abs(lane[at.old_q, i] - wall))
    if not close and v != 0.0 and lane_int[ln.TRIES, i] < 6:
        h = lane[at.old_h, i]
        _revoke(run, i)
        lane[at.h, i] = min(max(h - miss / v, 0.5 * h), 2.0 * h)
        lane_int[ln.TRIES, i] += 1
        return False
    _stand_on(run, wall, i)
    return True


@internal
def _stand_on(run, wall, i):
    """Put x on the wall exactly; the acceleration there, the same in both contact modes."""
    at, lane, lane_int, q = run.at, run.lane, run.lane_int, run.q
    lane[at.q, i] = wall
    lane_int[ln.LANDING, i] = 0
    lane_int[ln.LANDED, i] = 1
    lane[at.n_contacts, i] += _n_walls(q, i)
    x, v, cosine = load(lane, at.q), load(lane, at.v), vecmath.cos_turns(load(lane, at.tau))
    restoring = x * fma(load(lane, at.cubic) * x, x, load(lane, at.stiffness))
    driving = fma(load(lane, at.push), cosine, -restoring)
    lane[at.a, i] = lane_value(fma(-load(lane, at.damping), v, driving), i)
    lane[at.n_starts, i] += 1.0
    return lane[at.a, i]


@internal
def choose_mode(at, lane, q, i):
    """Contact mode of a located run from the present state: velocity, then acceleration, decide on
    a wall.
    """
    x = lane[at.q, i]
    low, high = q[0, parameters.WALL_LOW, i], q[0, parameters.WALL_HIGH, i]
    heading = lane[at.v, i] if lane[at.v, i] != 0.0 else lane[at.a, i]
    stiffness, wall, mode = 0.0, 0.0, 0.0
    if x > high or (x == high and heading > 0.0):
        stiffness, wall, mode = q[0, parameters.STIFFNESS, i], high, 1.0
    elif x < low or (x == low and heading < 0.0):
        stiffness, wall, mode = q[0, parameters.RATIO, i] * q[0, parameters.STIFFNESS, i], low, -1.0
    q[0, parameters.ACTIVE_STIFFNESS, i], q[0, parameters.ACTIVE_WALL, i] = stiffness, wall
    q[0, parameters.ACTIVE_MODE, i] = mode


@internal
def _corrects_mode(at, lane, q, i):
    """Choose the mode of a start; true if the stiffness was another one."""
    before = q[0, parameters.ACTIVE_STIFFNESS, i]
    choose_mode(at, lane, q, i)
    # On a wall both modes have the same acceleration, which has just decided between them.
    on_wall = (
        lane[at.q, i] == q[0, parameters.WALL_LOW, i]
        or lane[at.q, i] == q[0, parameters.WALL_HIGH, i]
    )
    return q[0, parameters.ACTIVE_STIFFNESS, i] != before and not on_wall


# --- one lane's turn ------------------------------------------------------------------------------


@internal
def _is_within(at, lane, settings, state, i):
    """Whether the coordinates in rows from `state` on are where a motion may be."""
    for j in range(at.n):
        x = lane[state + j, i]
        if not (np.isfinite(x) and abs(x) <= settings.bound):
            return False
    return True


@internal
def _failure_status(at, lane, settings, committed, i):
    if not _is_within(at, lane, settings, at.q_1, i):
        return ln.DIVERGED
    if lane[at.n_attempts, i] > settings.max_attempts:
        return ln.TIMED_OUT
    return ln.MODEL_INVALID if committed else ln.STEP_UNDERFLOW


@internal
def after_events(run, i):
    """Go on after a step and all its events; true when the point has reached its end."""
    at, lane, lane_int, q, settings = run.at, run.lane, run.lane_int, run.q, run.settings
    for j in range(at.n):
        lane[at.reach + j, i] = max(lane[at.reach + j, i], abs(lane[at.q + j, i]))
    if lane_int[ln.LANDED, i]:
        lane_int[ln.LANDED, i] = 0
        choose_mode(at, lane, q, i)
        lane[at.h, i] = lane[at.h_saved, i]
        if settings.restarts:
            begin_steps(run, i)
        return ln.remaining(at, lane, i) <= 0.0
    is_last = lane[at.turns, i] == lane[at.end_turns, i]
    return is_last and lane[at.tau, i] == lane[at.end_tau, i]


@inlined
def _begun(run, i):
    """What follows once the derivative at the start is known: a status, or -1."""
    at, lane, lane_int, q, settings = run.at, run.lane, run.lane_int, run.q, run.settings
    if not _is_within(at, lane, settings, at.q, i):
        return ln.DIVERGED
    for j in range(at.n_rates):
        if not np.isfinite(lane[at.a_1 + j, i]):
            return ln.DIVERGED
        lane[at.a + j, i] = lane[at.a_1 + j, i]
    begin_steps(run, i)
    if settings.is_located:
        if _corrects_mode(at, lane, q, i):
            ln.begin_start(at, lane, lane_int, i)  # the acceleration was that of another mode
            return -1
    else:
        for contact in range(at.contacts):
            lane[at.n_contacts + contact, i] = -_heads_out(at, lane, q, contact, i)
    return ln.OK if ln.remaining(at, lane, i) <= 0.0 else -1


@inlined
def _recorded(run, has_dipped, i):
    """Record what an accepted step holds; whether probes have been sent for it."""
    at, lane, settings = run.at, run.lane, run.settings
    if settings.dense:
        start = lane[at.old_turns, i] + (lane[at.old_tau, i] - lane[at.phase_0, i])
        t = start * lane[at.period, i]
        record(run, ln.STEP, t, at.old_q, i)
    plan_probes(run, has_dipped, i)
    return begin_probing(run, i)


@inlined
def attend(run, outcome, i):
    """Look after lane i; the status if its point is over, else -1."""
    at, lane, lane_int, q, settings = run.at, run.lane, run.lane_int, run.q, run.settings
    is_located = settings.is_located
    mode = lane_int[ln.MODE, i]
    bit = np.int64(1) << i
    if mode == ln.START:
        return _begun(run, i)
    if mode == ln.PROBING:
        if not probed(run, i):
            return -1
        return ln.OK if after_events(run, i) else -1
    if outcome.failed & bit:
        if outcome.accepted & bit and not is_located:  # no part of the motion, nor what it passed
            _uncount(run, i)
        return _failure_status(at, lane, settings, outcome.accepted & bit != 0, i)
    if is_located and lane_int[ln.LANDING, i] and outcome.accepted & bit:
        if not _landed(run, i):
            return -1
    elif outcome.stopped & bit and _cut(run, i):
        return -1
    t = ln.elapsed(at, lane, i)
    if lane_int[ln.LANDED, i] and is_recording(at, lane, t, i):
        for _ in range(_n_walls(q, i)):
            record(run, ln.CONTACT, t, at.q, i)
    has_dipped = outcome.dipped & bit != 0
    if has_dipped:
        for contact in range(at.contacts):
            count_dips(run, contact, i)
    if outcome.recorded & bit and _recorded(run, has_dipped, i):
        return -1
    return ln.OK if after_events(run, i) else -1
