"""Preparation of points for the kernel: row of the model, initial state, clocks.

Compiled, because calls of few points would otherwise spend more time on it than on their motion.
"""

import math
from math import isfinite

import numpy as np

from gapsweep.integrate.jit import entry, internal
from gapsweep.model.contact_modes import HOLD, MODES, SLACK

from .outcome import CLOCK_SLACK, MODEL_INVALID
from .pieces import set_first_piece

# The absolute part of a step's tolerance never exceeds rtol times this part of the motion's
# natural size: a step at high order costs so little more that a generous atol buys nothing, and
# would only spoil motions much smaller than a metre. It is never zero in motion, so that a
# start at rest, without an amplitude, gets a finite step.
FLOOR_SHARE = 1e-3
# Least reach of a motion, as a share of its expected size: at the origin there is none so far.
LEAST_REACH = 1e-6
READY, ON_WALL, NOT_FINITE, BACKWARD = range(4)
MOST_PLACED = 1 << 22  # section points for which rows are reserved before the motions begin
CLOCK_ROUNDING = 4.0 * np.finfo(float).eps
_AT_WALL = 16.0 * np.finfo(float).eps  # of a gap: on a rigid wall, up to rounding
_ACTS = tuple(mode.acts for mode in MODES)
PRODUCT_ROUNDING = 1.5 * np.finfo(float).eps  # of the rounded product of two rounded numbers


@entry
def set_starts(
    numbers, points, table, pieces, which, start, follows, t_0, t_end, record_from, section_only,
    sections, rtol,
):  # fmt: skip
    """Copy rows of a table of models and write initial states and times into the copies.

    Parameters
    ----------
    numbers : array, shape (1,)
        `RowLayout.numbers`.
    points : array, shape (n + 1, n_rows)
        Receives the points, and the table's last row, the idle point, as its last one.
    table : array, shape (n_scenes + 1, n_rows)
        Rows of `scenes.SceneTable`.
    pieces : array, shape (n_pieces, n_columns)
        Loads by pieces, see `SceneTable`.
    which : int array, shape (n,)
        Row of the model of each point.
    start : array, shape (n, n_states)
        States (q, v, z).
    follows : bool array, shape (n + 1,)
        Points whose initial state is set later by `follow`.
    t_0, t_end, record_from : arrays, shape (n,)
    section_only : bool
        As in `problem.Problems`.
    sections : int array, shape (n, 2)
        Receives the first row and the end of the rows reserved for each motion's section points.

    Returns
    -------
    outcome : int
        READY; ON_WALL: points start on a wall, the caller sets their modes; NOT_FINITE or BACKWARD:
        a value is not finite, or an end lies before its initial time.
    n_sections : int
        Number of reserved rows; -1 if they are too many, or the motions are unforced.
    is_recording : bool
        Whether a motion is recorded.
    """
    at, n_sections, is_recording = numbers[0], 0, False
    # by loops: compiling an assignment of rows takes a second, for its errors about wrong shapes
    for r in range(at.n_rows):
        points[len(which), r] = table[len(table) - 1, r]
    outcome = READY
    for i in range(len(which)):
        if not (isfinite(t_0[i]) and isfinite(t_end[i])):
            return NOT_FINITE, -1, False
        if math.isnan(record_from[i]):
            return NOT_FINITE, -1, False
        if t_end[i] < t_0[i]:
            return BACKWARD, -1, False
        point = points[i]
        for r in range(at.n_rows):
            point[r] = table[which[i], r]
        _set_clocks(at, point, t_0[i], t_end[i], record_from[i])
        is_found_by_clock = section_only and not at.is_free
        point[at.event_clock] = np.inf if is_found_by_clock else point[at.record_clock]
        is_recording |= isfinite(record_from[i])
        if n_sections >= 0:
            n_due = point[at.end_cycle] - first_section(point[at.record_clock]) + 1.0
            sections[i, 0] = n_sections
            is_placed = not at.is_free and n_sections + max(n_due, 0.0) <= MOST_PLACED
            n_sections = n_sections + int(max(n_due, 0.0)) if is_placed else -1
            sections[i, 1] = n_sections
        if at.pieces:
            set_first_piece(at, point, pieces)
        if follows[i]:
            continue
        for j in range(at.n_states):
            if not isfinite(start[i, j]):
                return NOT_FINITE, -1, False
        if _set_state(at, point, start[i], rtol):
            outcome = ON_WALL
        for contact in range(at.contacts):
            _set_contact_time(at, point, contact)
    return outcome, n_sections, is_recording


@internal
def first_section(record_clock):
    """Number of the first whole period at which a section point is recorded."""
    return max(1.0, np.ceil(record_clock - CLOCK_SLACK))


@internal
def acts(mode):
    """Whether a contact's force acts in a mode."""
    return _ACTS[int(abs(mode))]


@internal
def _set_contact_time(at, point, contact):
    """Begin the sum of a contact's time: the initial time is subtracted if it is closed."""
    point[at.contact_time + contact] = -point[at.t_start] if acts(point[at.mode + contact]) else 0.0


@internal
def _set_state(at, point, state, rtol):
    """Set the initial state of a point; True if a contact is on a wall."""
    for j in range(at.n_states):
        point[at.q + j] = state[j]
    for j in range(at.n):
        point[at.reach + j] = abs(state[j])
    _set_floors(at, point, rtol)
    return _set_modes(at, point)


@internal
def follow(at, point, ended, rtol):
    """Set the initial state of a point to the end state of another one."""
    # on a wall it keeps the other point's contact modes
    is_on_wall = _set_state(at, point, ended[at.q : at.q + at.n_states], rtol)
    for contact in range(at.contacts):
        # a wall holds from the first step on if it does
        is_held = abs(ended[at.mode + contact]) == HOLD
        if is_on_wall and not is_held and not (at.has_impacts and point[at.rigid + contact] > 0.0):
            point[at.mode + contact] = ended[at.mode + contact]
        _set_contact_time(at, point, contact)


@internal
def _set_floors(at, point, rtol):
    """Set the absolute parts of the tolerances from the expected size of the motion."""
    if at.is_plain:
        size = max(point[at.floor], _swing(at, point))
        scale = math.sqrt(point[at.stiffness])
    else:
        # of speeds, in the norm of the masses
        energy = _square_norm(at, point, at.mass_root, at.v)
        energy += _square_norm(at, point, at.spring_root, at.q)
        speed = max(point[at.floor], math.sqrt(energy))
        size = max(speed, _pushed_speed(at, point)) / point[at.slow]
        scale = point[at.slow]
    floor, atol = rtol * FLOOR_SHARE * size, point[at.atol]
    floor = min(floor, atol) if atol > 0.0 else floor
    point[at.floor] = floor * scale
    if at.has_impacts:  # a motion may begin at the origin, with walls there
        point[at.least_reach] = LEAST_REACH * size
    for i in range(at.m):
        point[at.lag_floor + i] *= floor


@internal
def _pushed_speed(at, point):
    """Speed to which first-order states and springs push a point at rest, in the mass norm.

    Circulatory springs and lags push without any energy. If no force acts at first, the strongest
    force of a lag is used, for lags that act on coordinates only through other lags.
    """
    rate = max(math.sqrt(point[at.fastest]), point[at.omega_rad])
    square, strongest, sum_of_lags = 0.0, 0.0, 0.0
    for i in range(at.n):
        total = 0.0
        for j in range(at.n):
            total += _rooted(at, point, i, at.stiffness + j, at.n) * point[at.q + j]
        for j in range(at.m):
            push = _rooted(at, point, i, at.lag_force + j, at.m)
            total += push * point[at.z + j]
            strongest = max(strongest, abs(push))
        square += total * total
    for j in range(at.m):
        sum_of_lags += abs(point[at.z + j])
    push = math.sqrt(square)
    return (push if push > 0.0 else strongest * sum_of_lags) / rate


@internal
def _rooted(at, point, i, first, n_columns):
    """Row i of the mass matrix's root times a matrix column that begins in row `first`."""
    total = 0.0
    for j in range(at.n):
        total += point[at.mass_root + i * at.n + j] * point[first + j * n_columns]
    return total


@internal
def _square_norm(at, point, root, first):
    """Squared norm of the vector in rows from `first` on; `root` is the root of its matrix."""
    total = 0.0
    for i in range(at.n):
        part = 0.0
        for j in range(at.n):
            part += point[root + i * at.n + j] * point[first + j]
        total += part * part
    return total


@internal
def _set_modes(at, point):
    """Set initial gaps and contact modes; True if a contact is on a wall."""
    is_on_wall = False
    for contact in range(at.contacts):
        gap = point[at.q]
        if not at.is_plain:
            gap = 0.0
            for i in range(at.n):
                gap += point[at.direction + contact * at.n + i] * point[at.q + i]
            point[at.gap + contact] = gap
        lower, upper = point[at.lower + contact], point[at.upper + contact]
        if at.has_impacts and point[at.rigid + contact] > 0.0:
            gap = _set_on_rigid_wall(at, point, contact, gap)
        is_on_wall |= gap in (upper, lower)
        mode = 1.0 if gap > upper else -1.0 if gap < lower else 0.0
        if at.has_impacts and mode != 0.0 and point[at.rigid + contact] > 0.0:
            mode, point[at.n_short] = mode * HOLD, MODEL_INVALID
        if at.has_slack and mode * _force(at, point, contact, gap, mode) < 0.0:
            mode *= SLACK
        point[at.mode + contact] = mode
    return is_on_wall


@internal
def _set_on_rigid_wall(at, point, contact, gap):
    """Return the gap, on a rigid wall that only rounding separates from it.

    Also on one that it passes by less than the absolute tolerance: at a wall at zero, the size of
    the gap is no scale of rounding.
    """
    size = abs(gap)
    if not at.is_plain:
        size = 0.0
        for i in range(at.n):
            size += abs(point[at.direction + contact * at.n + i] * point[at.q + i])
    for side in (-1.0, 1.0):
        wall = point[(at.upper if side > 0.0 else at.lower) + contact]
        slack = _AT_WALL * size
        if -slack <= side * (gap - wall) <= max(slack, point[at.atol]):
            gap = wall
    point[at.q if at.is_plain else at.gap + contact] = gap
    return gap


@internal
def _force(at, point, contact, gap, side):
    """Force of a contact that never pulls, as if it pulled; 0 of other contacts and in the gap."""
    damping = point[at.slack_damping + contact]
    if side == 0.0 or damping == 0.0:
        return 0.0
    stiffness = point[(at.upper_stiffness if side > 0.0 else at.lower_stiffness) + contact]
    rests = (at.lower_rest, at.upper_rest) if at.has_preload else (at.lower, at.upper)
    rest = point[rests[int(side > 0.0)] + contact]
    speed = point[at.v]
    if not at.is_plain:
        speed = 0.0
        for i in range(at.n):
            speed += point[at.direction + contact * at.n + i] * point[at.v + i]
    return stiffness * (gap - rest) + damping * speed


@internal
def _swing(at, point):
    """Largest displacement [m] of the state's free motion on the springs, as in `step_size`."""
    x, v = point[at.q], point[at.v]
    stiffness, cubic = point[at.stiffness], abs(point[at.cubic])
    energy = v * v + (stiffness + 0.5 * cubic * x * x) * x * x
    return math.sqrt(
        2.0 * energy / (stiffness + math.sqrt(stiffness * stiffness + 2.0 * cubic * energy))
    )


@internal
def _periods(t, omega):
    """Forcing periods in time t; a whole number if only rounding errors separate it from one.

    These are the errors of t, omega and their product. An initial time next to a whole period would
    have a section point just after it, and two successive runs would have the point between them
    twice or never.
    """
    found = t * omega
    whole = np.rint(found)
    return whole if abs(found - whole) <= PRODUCT_ROUNDING * abs(found) else found


@internal
def _set_clocks(at, point, t_0, t_end, record_from):
    omega = point[at.omega]
    start, stop = _periods(t_0, omega), _periods(t_end, omega)
    # All later times count from the initial time, so that no more digits are lost.
    tau = start - np.floor(start)
    end = tau + (t_end - t_0) * omega
    if tau == 0.0 and stop == np.rint(stop):
        end = stop - start
    # An end that only rounding separates from a whole period is set to it: else its section point
    # would be lost. No end is set to zero time.
    whole = np.rint(end)
    if whole > 0.0 and abs(end - whole) <= CLOCK_ROUNDING * (1.0 + end):
        end = whole
    point[at.tau] = point[at.tau_start] = tau
    point[at.t_start] = t_0
    # A clock that starts at a phase cannot resolve shorter steps.
    coarse = CLOCK_ROUNDING * tau * point[at.period]
    point[at.min_step] = max(point[at.min_step], coarse)
    point[at.end_cycle] = np.floor(end)
    point[at.end_tau] = end - np.floor(end)
    point[at.record_clock] = tau + (record_from - t_0) * omega
