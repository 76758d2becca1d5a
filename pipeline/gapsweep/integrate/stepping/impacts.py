"""Impacts on rigid walls, and holds there and on preloads, for single lanes at the end of a step.

An impact changes the speed of the gap from u to -e u. A body that a load presses on the wall with
the acceleration a bounces in ever shorter flights to the height ``(e u)^2 / (2 a)``. From a height
below the row `low` times the largest displacement on, all further flights are summed: after
``2 e u / (a (1 - e))`` the wall holds the body. The hold ends where its force falls to zero.

A wall with a preload N_0 turns the acceleration a of a body that is pressed on it to
``a - N_0 b'M^-1 b``. If both point to the wall, the body bounces from side to side without a loss.
The wall holds it if the flights of both sides are lower than the row `low` says. That hold
ends where its force falls to zero, or exceeds the preload.

Impacts that meet at one time are taken one after the other, by the numbers of their contacts. One
that moves a held body ends its hold.
"""

import math

import numpy as np

from gapsweep.integrate.jit import internal
from gapsweep.integrate.lanes.outcome import MODEL_INVALID
from gapsweep.model.contact_modes import HOLD, ON, SLACK

from .record import load_series
from .roots import polynomial

# Flights are summed only if they end within this time, in rad of the fastest frequency.
_LONGEST_REST = 1e-3
_STILL = 64.0 * np.finfo(float).eps  # of the speeds that a gap's speed is the sum of
# Speed of impacts, over the largest displacement per rad, below which rounding errors of the times
# of impacts are too large for parameter columns.
_SLOW = 1e-9
_ACCURATE = 0.1  # of the relative tolerance: last terms of the series of a hold force
_DEPENDENT = 1e-12  # of b'M^-1 b: with the other contacts held, a smaller remainder is zero


@internal
def _along(at, lanes, k, contact, first):
    """Component along a contact's direction of the vector in rows from `first` on; its size."""
    if at.is_plain:
        return lanes[first, k], abs(lanes[first, k])
    total = size = 0.0
    for i in range(at.n):
        part = lanes[at.direction + contact * at.n + i, k] * lanes[first + i, k]
        total, size = total + part, size + abs(part)
    return total, size


@internal
def _pull(at, lanes, k, i, contact):
    """Acceleration of coordinate i by a unit force of a contact."""
    return 1.0 if at.is_plain else lanes[at.pull + i * at.contacts + contact, k]


@internal
def _second(series, t):
    """Second derivative of a series at time t."""
    total = 0.0
    for n in range(len(series) - 1, 1, -1):
        total = total * t + n * (n - 1) * series[n]
    return total


@internal
def settle_on_wall(at, lanes, k, contact, series):
    """Drop rounding errors from the gap's series of a body at rest on a wall that may hold it."""
    is_on = series[0] in (lanes[at.lower + contact, k], lanes[at.upper + contact, k])
    if not is_on or lanes[at.low + contact, k] == 0.0:
        return
    was_held = lanes[at.switched + contact, k] < 0.0
    _, size = _along(at, lanes, k, contact, at.v)
    if was_held or abs(series[1]) <= _STILL * size:
        series[1] = 0.0
    if was_held:
        series[2] = 0.0


@internal
def while_accurate(at, lanes, k, coefficients, h, rtol, work):
    """Part of a step h in which the series of all hold forces are accurate."""
    series = work.series
    for contact in range(at.contacts):
        if abs(lanes[at.mode + contact, k]) != HOLD:
            continue
        load_series(coefficients, (at.first_hold + contact) * at.n_terms, k, series)
        is_accurate = False
        while not is_accurate and h > lanes[at.min_step, k]:
            size = last = 0.0
            power = 1.0
            for n in range(at.order - 1):  # as far as it is known
                term = abs(series[n]) * power
                size, last = size + term, last + (term if n >= at.order - 3 else 0.0)
                power *= h
            is_accurate = last <= _ACCURATE * rtol * size
            h *= 1.0 if is_accurate else 0.75
    return h


@internal
def set_held(at, lanes, k):
    """Store the inverse of B'M^-1 B of the held contacts; without one, the motion has failed.

    By elimination in place: the matrix is symmetric and positive.
    """
    n = at.contacts
    for i in range(n):
        for j in range(n):
            value = 1.0 if i == j else 0.0
            if abs(lanes[at.mode + i, k]) == HOLD and abs(lanes[at.mode + j, k]) == HOLD:
                value = 1.0 if at.is_plain else 0.0
                for c in range(0 if at.is_plain else at.n):
                    value += lanes[at.direction + i * at.n + c, k] * _pull(at, lanes, k, c, j)
            lanes[at.held + i * n + j, k] = value
    for p in range(n):
        pivot = lanes[at.held + p * n + p, k]
        compliance = 1.0 if at.is_plain else lanes[at.compliance + p, k]
        is_held = abs(lanes[at.mode + p, k]) == HOLD
        if is_held and not pivot > _DEPENDENT * compliance:
            lanes[at.n_short, k] = MODEL_INVALID
            return
        for i in range(n):
            if i != p:
                factor = lanes[at.held + i * n + p, k] / pivot
                for j in range(n):
                    if j != p:
                        lanes[at.held + i * n + j, k] -= factor * lanes[at.held + p * n + j, k]
                lanes[at.held + i * n + p, k] = -factor
        for j in range(n):
            if j != p:
                lanes[at.held + p * n + j, k] /= pivot
        lanes[at.held + p * n + p, k] = 1.0 / pivot
    for p in range(n):
        if abs(lanes[at.mode + p, k]) != HOLD:
            lanes[at.held + p * n + p, k] = 0.0


@internal
def _project(at, lanes, k, first, is_column):
    """Remove components along held contacts from the vector in rows from `first` on.

    Those of the places of a parameter column become the derivatives of the walls' places. The
    impulses that stop the motion are added to those of the contacts.
    """
    n = at.contacts
    for i in range(at.n):
        lanes[at.unprojected + i, k] = lanes[first + i, k]
    for j in range(n):
        along = 0.0
        for i in range(n):
            for c in range(at.n):
                part = 1.0 if at.is_plain else lanes[at.direction + i * at.n + c, k]
                along += lanes[at.held + j * n + i, k] * part * lanes[at.unprojected + c, k]
            if is_column:
                wall = at.upper_source if lanes[at.mode + i, k] > 0.0 else at.lower_source
                along -= lanes[at.held + j * n + i, k] * lanes[first + wall + i, k]
        if first == at.v:
            lanes[at.impulse + j, k] += along
        for c in range(at.n):
            lanes[first + c, k] -= _pull(at, lanes, k, c, j) * along
    for c in range(at.n):
        if abs(lanes[first + c, k]) <= _STILL * abs(lanes[at.unprojected + c, k]):
            lanes[first + c, k] = 0.0


@internal
def hold_limits(at, lanes, k, contact):
    """Smallest and largest force, upwards, with which a wall holds a contact."""
    most = np.inf
    if at.has_preload and lanes[at.rigid + contact, k] == 0.0:
        most = lanes[at.preload + contact, k]
        if lanes[at.lower + contact, k] == lanes[at.upper + contact, k]:
            return -most, most
    return (0.0, most) if lanes[at.mode + contact, k] > 0.0 else (-most, 0.0)


@internal
def _begins(at, lanes, k, step):
    """Whether a step ends in the initial state."""
    is_start = lanes[at.cycle, k] == 0.0 and lanes[at.tau, k] == lanes[at.tau_start, k]
    return is_start and lanes[at.tau_low, k] == 0.0 and step == 0.0


@internal
def release(at, lanes, k, contact, side, step):
    """End the hold of a contact that leaves its place upwards or downwards, `step` ahead."""
    limits = hold_limits(at, lanes, k, contact)
    new = side if 0.0 < abs(limits[int(side > 0.0)]) < np.inf else 0.0  # beyond a preload
    lanes[at.side + contact, k] = math.copysign(1.0, lanes[at.mode + contact, k])
    lanes[at.mode + contact, k] = new
    if _begins(at, lanes, k, step):  # others, which are held, move it: there was no contact
        lanes[at.side + contact, k] = lanes[at.lost_force + contact, k] = 0.0
        lanes[at.contact_time + contact, k] = -lanes[at.t_start, k] if new != 0.0 else 0.0
    elif new == 0.0:
        lanes[at.n_contacts, k] += 1.0
    set_held(at, lanes, k)


@internal
def begin_impacts(at, lanes, k, step, coefficients, work):
    """Store speeds and accelerations at the end of a step, before impacts there."""
    for contact in range(at.contacts):
        lanes[at.impact_share + contact, k] = lanes[at.impulse + contact, k] = 0.0
        lanes[at.lost_force + contact, k] = 0.0
    for i in range(at.n):
        lanes[at.v_in + i, k] = lanes[at.v + i, k]
        load_series(coefficients, i * at.n_terms, k, work.series)
        lanes[at.acceleration + i, k] = _second(work.series, step)


@internal
def speed_along(at, lanes, k, contact):
    """Speed of a gap at the end of a step, before impacts there."""
    return _along(at, lanes, k, contact, at.v_in)[0]


@internal
def _compliance(at, lanes, k, contact):
    return 1.0 if at.is_plain else lanes[at.compliance + contact, k]


@internal
def _reach(at, lanes, k, contact):
    """Bound of the largest displacement of a gap so far."""
    if at.is_plain:
        return lanes[at.reach, k]
    reach = 0.0
    for i in range(at.n):
        reach += abs(lanes[at.direction + contact * at.n + i, k]) * lanes[at.reach + i, k]
    return reach


@internal
def _is_low(at, lanes, k, contact, speed, pressing):
    """Whether a body that leaves a wall at a speed comes back, from a height below `low`.

    `pressing` is its acceleration towards the wall. From a preload it comes back on both sides.
    """
    reach = max(_reach(at, lanes, k, contact), lanes[at.least_reach, k])
    low = lanes[at.low + contact, k]
    if at.has_preload and lanes[at.preload + contact, k] > 0.0:
        change = lanes[at.preload + contact, k] * _compliance(at, lanes, k, contact)
        has_gap = lanes[at.lower + contact, k] < lanes[at.upper + contact, k]
        pressing = min(pressing + (0.0 if has_gap else change), change - pressing)
    return pressing >= 0.0 and speed * speed <= 2.0 * pressing * low * reach


@internal
def is_caught(at, lanes, k, contact, side, step, coefficients, work):
    """Begin the hold of a gap that passes a wall with a preload, if it does not get far from it."""
    if not at.has_preload or lanes[at.preload + contact, k] == 0.0:
        return False
    mode = lanes[at.mode + contact, k]
    side = math.copysign(1.0, mode) if mode != 0.0 else side
    speed, _ = _along(at, lanes, k, contact, at.v)
    load_series(coefficients, (at.first_gap + contact) * at.n_terms, k, work.series)
    settle_on_wall(at, lanes, k, contact, work.series)
    pressing = side * _second(work.series, step)
    if step == 0.0 and work.series[1] == 0.0:
        speed = 0.0
    if abs(mode) == ON:
        force = _force(at, lanes, k, contact, mode)
        pressing += side * force * _compliance(at, lanes, k, contact)
    if not _is_low(at, lanes, k, contact, speed, pressing):
        return False
    lanes[at.switched + contact, k] = 0.0
    _hold(at, lanes, k, contact, side, 0.0, step, 0.0 if abs(mode) == ON else 1.0)
    return True


@internal
def _hold(at, lanes, k, contact, side, rest, step, n_begun):
    """Begin a hold, after the time `rest`, with a number of contacts that begin."""
    lanes[at.mode + contact, k] = side * HOLD
    lanes[at.lag, k] = rest
    lanes[at.contact_loss, k] = math.inf
    if _begins(at, lanes, k, step):
        lanes[at.contact_time + contact, k] = -lanes[at.t_start, k]
    else:
        lanes[at.side + contact, k] = side
        lanes[at.n_contacts, k] += n_begun
    set_held(at, lanes, k)
    _project(at, lanes, k, at.v, False)


@internal
def meet(at, lanes, k, contact, side, step, coefficients, work):
    """Reverse the speed of a gap that meets a rigid wall, or begin a hold."""
    speed, size = _along(at, lanes, k, contact, at.v)
    speed *= side
    series, e = work.series, lanes[at.restitution + contact, k]
    load_series(coefficients, (at.first_gap + contact) * at.n_terms, k, series)
    settle_on_wall(at, lanes, k, contact, series)
    pressing = side * _second(series, step)
    if step == 0.0 and series[1] == 0.0:
        speed = 0.0
    lanes[at.switched + contact, k] = 0.0
    if speed < 0.0 or (speed == 0.0 and pressing < 0.0):  # turned by another impact, or at rest
        return
    pressing += side * _rebound(at, lanes, k, contact, side * speed, step, coefficients, work)
    holds, rest = _is_low(at, lanes, k, contact, e * speed, pressing), 0.0
    if holds and e * speed > 0.0:
        holds = e < 1.0
        if holds:
            rest = 2.0 * e * speed / (pressing * (1.0 - e))
            holds = rest * lanes[at.rate, k] <= _LONGEST_REST
    if not holds:
        lanes[at.side + contact, k] = side
        lanes[at.n_contacts, k] += 2.0
        lanes[at.contact_loss, k] += lanes[at.of_impact + contact, k]
        if speed <= _SLOW * _reach(at, lanes, k, contact) * lanes[at.rate, k]:
            lanes[at.impulse + contact, k] = math.nan  # columns become NaN
        return
    # solutions of the variational equation have the rates that the speeds of the hold have
    per_speed = side / speed if speed > _STILL * size else 0.0
    kick = at.impact_kick + contact * (at.n + at.m)
    _add_rates(at, lanes, k, -per_speed, kick)
    _hold(at, lanes, k, contact, side, rest, step, 1.0)
    _add_rates(at, lanes, k, per_speed, kick)


@internal
def _rebound(at, lanes, k, contact, speed, step, coefficients, work):
    """Change speeds by an impact of a gap at `speed`; return the change of its acceleration.

    Store what solutions of the variational equation need, as `tangent._impacts` does.
    """
    n, kick = at.n, at.impact_kick + contact * (at.n + at.m)
    _, size = _along(at, lanes, k, contact, at.v)
    per_speed = 1.0 / speed if abs(speed) > _STILL * size else 0.0
    compliance = _compliance(at, lanes, k, contact)
    share = (1.0 + lanes[at.restitution + contact, k]) / compliance
    towards = changed = 0.0
    for i in range(n):
        direction = 1.0 if at.is_plain else lanes[at.direction + contact * n + i, k]
        towards += share * direction * lanes[at.acceleration + i, k]
    for i in range(n + at.m):
        lanes[kick + i, k] = 0.0
    _add_rates(at, lanes, k, -1.0, kick)
    for j in range(at.contacts):  # as without holds
        lanes[at.hold_force + j, k] = force = 0.0
        if abs(lanes[at.mode + j, k]) == HOLD:
            load_series(coefficients, (at.first_hold + j) * at.n_terms, k, work.series)
            force, _ = polynomial(work.series, at.order, step)
            lanes[at.hold_force + j, k] = force
            for i in range(n):
                lanes[kick + i, k] += _pull(at, lanes, k, i, j) * force
    for i in range(n):
        before = lanes[at.v + i, k]
        after = before - share * speed * _pull(at, lanes, k, i, contact)
        lanes[at.v + i, k] = 0.0 if abs(after) <= _STILL * abs(before) else after
    _change_others(at, lanes, k, contact, step)
    _add_rates(at, lanes, k, 1.0, kick)
    lanes[at.impact_share + contact, k], lanes[at.impulse + contact, k] = share, share * speed
    _hold_rates(at, lanes, k, kick, step)
    for i in range(n):
        change, pull = lanes[kick + i, k], _pull(at, lanes, k, i, contact)
        lanes[kick + i, k] = (change + towards * pull) * per_speed
        lanes[at.acceleration + i, k] += change
        changed += change * (1.0 if at.is_plain else lanes[at.direction + contact * n + i, k])
    for i in range(at.m):
        lanes[kick + n + i, k] *= per_speed
    return changed


@internal
def _hold_rates(at, lanes, k, change, step):
    """Remove accelerations along held contacts from the sum of accelerations and their change.

    The change is in rows from `change` on. A hold whose force is beyond its limits ends.
    """
    n = at.contacts
    is_settled = False
    while not is_settled:
        is_settled = True
        for j in range(n):
            force = 0.0
            for i in range(n):
                for c in range(at.n):
                    part = 1.0 if at.is_plain else lanes[at.direction + i * at.n + c, k]
                    rate = lanes[at.acceleration + c, k] + lanes[change + c, k]
                    force += lanes[at.held + j * n + i, k] * part * rate
            lanes[at.hold_force + j, k] = force
        for j in range(n):
            force = lanes[at.hold_force + j, k]
            low, high = hold_limits(at, lanes, k, j)
            if is_settled and abs(lanes[at.mode + j, k]) == HOLD and not low <= force <= high:
                is_settled = False
                for c in range(at.n):
                    lanes[change + c, k] -= _pull(at, lanes, k, c, j) * min(max(force, low), high)
                release(at, lanes, k, j, 1.0 if force > high else -1.0, step)
    for j in range(n):
        for c in range(at.n):
            lanes[change + c, k] -= _pull(at, lanes, k, c, j) * lanes[at.hold_force + j, k]


@internal
def _add_rates(at, lanes, k, sign, first):
    """Add what speeds contribute to accelerations and rates of first-order states, in rows."""
    n = at.n
    for i in range(n):
        for j in range(n):
            lanes[first + i, k] -= sign * lanes[at.damping + i * n + j, k] * lanes[at.v + j, k]
    for i in range(at.m):
        for j in range(n):
            lanes[first + n + i, k] += sign * lanes[at.of_speed + i * n + j, k] * lanes[at.v + j, k]
    for contact in range(at.contacts if at.is_damped else 0):
        mode = lanes[at.mode + contact, k]
        if abs(mode) == ON:
            force = _force(at, lanes, k, contact, mode)
            for i in range(n):
                lanes[first + i, k] -= sign * _pull(at, lanes, k, i, contact) * force


@internal
def _force(at, lanes, k, contact, mode):
    """Force of a contact with damping beyond the wall of a mode, as if it pulled."""
    depth, _ = _along(at, lanes, k, contact, at.q)
    speed, _ = _along(at, lanes, k, contact, at.v)
    is_up = mode > 0.0
    rests = (at.lower_rest, at.upper_rest) if at.has_preload else (at.lower, at.upper)
    depth -= lanes[rests[int(is_up)] + contact, k]
    stiffness = lanes[(at.upper_stiffness if is_up else at.lower_stiffness) + contact, k]
    force = stiffness * depth + lanes[at.contact_damping + contact, k] * speed
    if at.has_chi:
        force += stiffness * math.copysign(lanes[at.chi + contact, k], mode) * depth * speed
    return force


@internal
def _change_others(at, lanes, k, contact, step):
    """Change the modes of the other contacts that an impact ends: holds, and on and slack."""
    is_disturbed = False
    for j in range(at.contacts):
        mode = lanes[at.mode + j, k]
        if j == contact or mode == 0.0:
            continue
        if abs(mode) == HOLD:
            speed, size = _along(at, lanes, k, j, at.v)
            pressing = (
                math.copysign(1.0, mode) * lanes[at.hold_force + j, k] * lanes[at.compliance + j, k]
            )
            if abs(speed) <= _STILL * size:
                continue
            if _is_low(at, lanes, k, j, speed, pressing):
                is_disturbed = True
            else:
                release(at, lanes, k, j, math.copysign(1.0, speed), step)
        elif at.has_slack and lanes[at.slack_damping + j, k] > 0.0:
            side = math.copysign(1.0, mode)
            new = side * (ON if side * _force(at, lanes, k, j, mode) >= 0.0 else SLACK)
            if new != mode:
                lanes[at.mode + j, k] = new
                lanes[at.side + j, k] = side
                lanes[at.n_contacts, k] += 1.0
    if is_disturbed:
        _project(at, lanes, k, at.v, False)


@internal
def turn_tangent(at, lanes, k, first, is_column):
    """Apply the impacts of a step to a solution of the variational equation, rows from `first`.

    A parameter column has the place of the gap less the derivative of the wall's place.
    """
    is_held = False
    for contact in range(at.contacts):
        share = lanes[at.impact_share + contact, k]
        is_held = is_held or abs(lanes[at.mode + contact, k]) == HOLD
        if share != 0.0:
            place, _ = _along(at, lanes, k, contact, first)
            speed, _ = _along(at, lanes, k, contact, first + at.n)
            if is_column:
                is_above = lanes[at.impulse + contact, k] > 0.0
                wall = at.upper_source if is_above else at.lower_source
                place -= lanes[first + wall + contact, k]
            for i in range(at.n):
                pull = share * _pull(at, lanes, k, i, contact)
                lanes[first + i, k] -= pull * place
                lanes[first + at.n + i, k] -= pull * speed
            kick = at.impact_kick + contact * (at.n + at.m)
            for i in range(at.n + at.m):
                lanes[first + at.n + i, k] += lanes[kick + i, k] * place
        if is_column:
            _rebound_of_column(at, lanes, k, contact, first)
        if lanes[at.lost_force + contact, k] != 0.0:
            _lose_force(at, lanes, k, contact, first, is_column)
    if is_held:  # also of what the damping of other contacts adds
        _project(at, lanes, k, first, is_column)
        _project(at, lanes, k, first + at.n, False)


@internal
def _lose_force(at, lanes, k, contact, first, is_column):
    """Change the speeds of a solution as a hold force ends at once, at a wall that another passes.

    The time of its end is that at which this other contact reaches the wall.
    """
    for j in range(at.contacts):
        gap, size = _along(at, lanes, k, j, at.q)
        speed, fastest = _along(at, lanes, k, j, at.v)
        upper = lanes[at.upper + j, k]
        is_above = abs(upper - gap) < abs(gap - lanes[at.lower + j, k])
        off = gap - (upper if is_above else lanes[at.lower + j, k])
        is_moving = abs(speed) > _STILL * fastest and abs(lanes[at.mode + j, k]) != HOLD
        if is_moving and abs(off) <= _STILL * max(size, _reach(at, lanes, k, j)):
            late, _ = _along(at, lanes, k, j, first)
            if is_column:
                wall = at.upper_source if is_above else at.lower_source
                late -= lanes[first + wall + j, k]
            late *= lanes[at.lost_force + contact, k] / speed
            for i in range(at.n):
                lanes[first + at.n + i, k] += _pull(at, lanes, k, i, contact) * late
            return  # others that pass now do so at the same time


@internal
def _rebound_of_column(at, lanes, k, contact, first):
    """Change the speeds of a parameter column by the impulse of a contact, as `Source.rebound`.

    The derivative of the impulse of a hold is along held contacts, and hence not needed.
    """
    impulse, share = lanes[at.impulse + contact, k], lanes[at.impact_share + contact, k]
    if impulse == 0.0:
        return
    more = 0.0
    if share != 0.0:
        more = lanes[first + at.restitution_source + contact, k] * impulse / share
    moved = first + at.pull_source + contact
    if not at.is_plain:
        for i in range(at.n):
            along = lanes[at.direction + contact * at.n + i, k]
            more -= impulse * along * lanes[moved + i * at.contacts, k]
    more /= _compliance(at, lanes, k, contact)
    for i in range(at.n):
        change = more * _pull(at, lanes, k, i, contact)
        if not at.is_plain:
            change += impulse * lanes[moved + i * at.contacts, k]
        lanes[first + at.n + i, k] -= change
