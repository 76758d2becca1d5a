"""Records of steps: extrema, section points, wall crossings, and series for dense output.

A section point is a row (point, t, q, v, z) of its log, in the order of time. An extremum is a row
(point, t, which, value), in the order of time for each `which`: a coordinate, or a contact's gap
after all coordinates. A wall crossing is a row (point, t, contact).

Extrema are all zeros of a velocity polynomial. Vector code proves by Descartes' rule, for all lanes
at once, that there is none or one, and finds it (`turns`). In one step of some hundreds this fails:
its zeros are isolated by the same rule on parts of the step (`roots`).
"""

import math

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from gapsweep.integrate.jit import entry, internal
from gapsweep.integrate.lanes.outcome import CLOCK_SLACK
from gapsweep.integrate.lanes.rows import rows_of
from gapsweep.integrate.lanes.start_rows import acts, first_section
from gapsweep.integrate.vectors import (
    I64,
    absolute,
    lowest_bit,
)
from gapsweep.model.contact_modes import HOLD, ON

from .roots import DOUBLE, SIMPLE, isolate, polynomial
from .turns import TOUCH, find_coordinate_turns, find_gap_turns

MINIMUM, MAXIMUM, INFLECTION = 0, 1, 2
LOGS = TURNS, CONTACTS, SECTIONS, STEPS = range(4)
POINT, TIME, WHICH, VALUE = range(4)
STATE = 2  # of a section point
DENSE_HEAD = 3  # of a step: point, start time, length; then the coefficients of q and z

# Two successive extrema that differ by less than this part of the displacement are one inflection
# (v = 0 and a = 0) with rounding errors.
_SAME_DISPLACEMENT = 4e-16
_FLANK = 1e-5  # of the step


@internal
def rows_per_step(at):
    """Largest numbers of rows that a step of all lanes writes to the logs."""
    n_turns = at.n_turning * (at.order + 1)
    n_sections = at.order + 1 if at.is_free else 1
    n_passings = 2 * at.contacts * (1 if at.is_located else at.order + 1)
    return at.width * n_turns, at.width * n_passings, at.width * n_sections, at.width


@internal
def has_room(at, run):
    """Whether the logs in use have room for another step of all lanes."""
    needed, fits = rows_per_step(at), True
    for log in range(4):
        n_rows, is_placed = len(run.logs[log]), log == SECTIONS and len(run.sections) > 0
        fits = fits and (is_placed or n_rows == 0 or run.fill[log] + needed[log] <= n_rows)
    return fits


@internal
def write_row(run, log, k, t, which):
    """Add a row to a log; return its number."""
    i, rows = run.fill[log], run.logs[log]
    rows[i, POINT], rows[i, TIME], rows[i, WHICH] = run.lane_point[k], t, which
    run.fill[log] += 1
    return i


@internal
def _write_turn(run, k, t, which, value):
    i = write_row(run, TURNS, k, t, which)
    run.logs[TURNS][i, VALUE] = value


@internal
def load_series(coefficients, first, k, series):
    """Copy lane k's coefficients, in rows from `first` on, to the array `series`."""
    for n in range(len(series)):
        series[n] = coefficients[first + n, k]


@internal
def load_depth(at, lanes, coefficients, k, contact, mode, series):
    """Put the length of a contact's spring at the wall of a mode into `series`, upwards.

    It is the depth beyond the wall, with a preload more.

    Returns
    -------
    stiffness, chi : float
        Of that wall; `Losses.chi` for speeds upwards.
    """
    load_series(coefficients, (at.first_gap + contact) * at.n_terms, k, series)
    is_up = mode > 0.0
    rests = (at.lower_rest, at.upper_rest) if at.has_preload else (at.lower, at.upper)
    series[0] -= lanes[rests[int(is_up)] + contact, k]
    chi = 0.0
    if at.has_chi:
        chi = math.copysign(lanes[at.chi + contact, k], mode)
    return lanes[(at.upper_stiffness if is_up else at.lower_stiffness) + contact, k], chi


@internal
def _write_state(at, run, k, rows, i, elapsed):
    """Put the state `elapsed` after the last step's beginning into a section's row."""
    for j in range(at.n + at.m):
        value, slope = 0.0, 0.0
        for term in range(at.order, -1, -1):
            slope = slope * elapsed + value
            value = value * elapsed + run.coefficients[j * at.n_terms + term, k]
        if j < at.n:
            rows[i, STATE + j], rows[i, STATE + at.n + j] = value, slope
        else:
            rows[i, STATE + at.n + j] = value


@internal
def _write_section(at, run, k, i, t, elapsed):
    """Write section point i at time t, from the last step's series at time `elapsed` in it."""
    rows = run.logs[SECTIONS]
    rows[i, POINT], rows[i, TIME] = run.lane_point[k], t
    _write_state(at, run, k, rows, i, elapsed)


@internal
def _write_return(at, run, k, start, t):
    """Record a section point of an unforced motion: a maximum of the first coordinate."""
    i = run.fill[SECTIONS]
    run.fill[SECTIONS] += 1
    _write_section(at, run, k, i, start + t, t)
    run.logs[SECTIONS][i, STATE + at.n] = 0.0  # to the last bit: the next motion begins here


@internal
def _record_sections(at, among, run):
    """Record the section points that forced motions have passed or reached in their last step."""
    lanes = run.lanes
    while among != 0:
        k = lowest_bit(among)
        among &= among - 1
        whole = max(lanes[at.cycle_0, k] + 1.0, first_section(lanes[at.record_clock, k]))
        while whole <= lanes[at.cycle, k]:
            _record_section(at, run, k, whole)
            whole += 1.0


@internal
def _record_section(at, run, k, whole):
    """Record the section point after `whole` periods, in the reserved rows if there are any."""
    lanes = run.lanes
    if len(run.sections) > 0:
        places = run.sections[run.lane_point[k]]
        i = places[0]
        if i == places[1]:  # more points are due to rounding
            return
        places[0] += 1
    else:
        i = run.fill[SECTIONS]
        run.fill[SECTIONS] += 1
    period = lanes[at.period, k]
    t = lanes[at.t_start, k] + (whole - lanes[at.tau_start, k]) * period
    until = ((whole - lanes[at.cycle_0, k]) - lanes[at.tau_0, k]) * period
    _write_section(at, run, k, i, t, min(until, lanes[at.step, k]))
    if whole == lanes[at.cycle, k] and lanes[at.tau, k] == 0.0:
        for j in range(at.n_states):
            run.logs[SECTIONS][i, STATE + j] = lanes[at.q + j, k]


@internal
def _noise(degree, step, work):
    """Value below which the velocity polynomial of a step may be zero up to rounding."""
    size, power = 0.0, 1.0
    for n in range(degree + 1):
        size += abs(work.reduced[n]) * power
        power *= step
    return TOUCH * size


@internal
def _without_echoes(n_roots, step, work):
    """Drop double roots due to rounding, next to a simple root or a step end; return the number."""
    roots, multiplicity, kept = work.roots, work.multiplicity, 0
    for i in range(n_roots):
        t = roots[i]
        is_echo = min(t, step - t) <= _FLANK * step
        for j in (i - 1, i + 1):
            if (
                0 <= j < n_roots
                and abs(roots[j] - t) <= _FLANK * step
                and (multiplicity[j] == SIMPLE or j < i)
            ):
                is_echo = True
        if multiplicity[i] == SIMPLE or not is_echo:
            roots[kept], multiplicity[kept] = t, multiplicity[i]
            kept += 1
    return kept


@internal
def _velocity_roots(step, v_1, work):
    """Find the zeros of v on (0, step], into ``work.roots``; return their number."""
    series, degree = work.series, len(work.series) - 1
    skipped = 1
    while skipped <= degree and series[skipped] == 0.0:
        skipped += 1  # an extremum at the beginning belongs to the step before
    if skipped > degree or step <= 0.0:
        return 0
    for n in range(skipped, degree + 1):
        work.reduced[n - skipped] = n * series[n]
    n_roots = isolate(
        degree - skipped,
        step,
        v_1 / step ** (skipped - 1),
        _noise(degree - skipped, step, work),
        work,
    )
    n_roots = _without_echoes(n_roots, step, work)
    if v_1 == 0.0:
        work.roots[n_roots], work.multiplicity[n_roots] = step, SIMPLE
        n_roots += 1
    return n_roots


@internal
def _record_extrema(at, run, k, which, first):
    """Record the extrema of a quantity in a step for which vector code (`turns`) was undecided."""
    lanes, work = run.lanes, run.work
    load_series(run.coefficients, first, k, work.series)
    n_roots = _velocity_roots(lanes[at.step, k], lanes[at.turn_v, k], work)
    if n_roots == 0:
        return
    start = lanes[at.start_time, k]
    begun = lanes[at.cycle_0, k] + lanes[at.tau_0, k] - lanes[at.event_clock, k]
    first = -begun * lanes[at.period, k]  # within the step; negative once recording is fully on
    series, degree = work.series, len(work.series) - 1
    roots, multiplicity = work.roots, work.multiplicity
    rising = work.reduced[0] > 0.0  # sign of v right after the beginning; each simple root flips it
    halt = math.nan  # displacement of the last inflection: rounding may show one as several
    i = 0
    while i < n_roots:
        t = roots[i]
        x, _ = polynomial(series, degree, t)
        kind = MAXIMUM if rising else MINIMUM
        if multiplicity[i] == DOUBLE:
            kind = INFLECTION
        elif i + 1 < n_roots and multiplicity[i + 1] != DOUBLE:
            x_next, _ = polynomial(series, degree, roots[i + 1])
            if abs(x_next - x) <= _SAME_DISPLACEMENT * abs(x):
                kind, t = INFLECTION, 0.5 * (t + roots[i + 1])
                i += 1
        is_again = False
        if kind != INFLECTION:
            rising = not rising
        else:
            is_again = abs(x - halt) <= _SAME_DISPLACEMENT * abs(x)
            halt = x
        if t >= first and not is_again:
            _write_turn(run, k, start + t, which, x)
            if at.is_free and which == 0 and kind == MAXIMUM:
                _write_return(at, run, k, start, t)
        i += 1


@internal
def _record_contact(at, run, k, contact):
    """Record a contact that begins or ends, both if the gap is zero: its time, and rows if kept."""
    lanes = run.lanes
    end = lanes[at.start_time, k] + lanes[at.step, k]
    mode, mode_0 = lanes[at.mode + contact, k], lanes[at.mode_0 + contact, k]
    if at.is_tanh or abs(mode) == HOLD:
        end += lanes[at.lag, k]
    has_gap = lanes[at.lower + contact, k] < lanes[at.upper + contact, k]
    is_left, is_made = mode == 0.0 or (not has_gap and mode_0 != 0.0), mode != 0.0
    if at.has_forces:
        is_left, is_made = acts(mode_0), acts(mode)
    if at.has_impacts and mode_0 == 0.0 and mode == 0.0:  # an impact
        is_left = is_made = True
    if is_left and is_made and HOLD in (abs(mode), abs(mode_0)):  # pressed on
        is_left = is_made = False
    if is_left:
        lanes[at.contact_time + contact, k] += end
        if run.contacts:
            write_row(run, CONTACTS, k, end, contact)
    if is_made:
        lanes[at.contact_time + contact, k] -= end
        if run.contacts:
            write_row(run, CONTACTS, k, end, contact)


@internal
def _record_rebounds(at, run, k):
    """Record extrema of lane k on rigid walls: of quantities with a speed that impacts turn."""
    lanes = run.lanes
    end = lanes[at.start_time, k] + lanes[at.step, k]
    for i in range(at.n):
        if lanes[at.v_in + i, k] != 0.0 and lanes[at.v_in + i, k] * lanes[at.v + i, k] <= 0.0:
            _write_turn(run, k, end, i, lanes[at.q + i, k])
    for contact in range(at.n_turning - at.n):
        mode, mode_0 = lanes[at.mode + contact, k], lanes[at.mode_0 + contact, k]
        before = after = 0.0
        for i in range(at.n if abs(mode_0) != HOLD else 0):
            along = lanes[at.direction + contact * at.n + i, k]
            before += along * lanes[at.v_in + i, k]
            after += along * lanes[at.v + i, k]
        if before != 0.0 and (before * after <= 0.0 or abs(mode) == HOLD):
            _write_turn(run, k, end, at.n + contact, lanes[at.gap + contact, k])


@internal
def _record_forces(at, run, among):
    """Keep the largest force of every damped contact within the last step of some lanes.

    It is at an end of the step or where the rate of the force is zero.
    """
    lanes, work = run.lanes, run.work
    while among != 0:
        k = lowest_bit(among)
        among &= among - 1
        for contact in range(at.contacts):
            mode, step = lanes[at.mode_0 + contact, k], lanes[at.step, k]
            is_held = abs(mode) == HOLD and at.has_preload and lanes[at.rigid + contact, k] == 0.0
            if abs(mode) != ON and not is_held:
                continue
            series, depth = work.series, work.reduced
            if is_held:
                load_series(run.coefficients, (at.first_hold + contact) * at.n_terms, k, series)
            spring, chi = load_depth(at, lanes, run.coefficients, k, contact, mode, depth)
            for n in range(0 if is_held else len(series)):
                rate = (n + 1) * depth[n + 1] if n + 1 < len(series) else 0.0
                series[n] = spring * depth[n] + lanes[at.contact_damping + contact, k] * rate
                for i in range(min(n + 1, len(series) - 1) if chi != 0.0 else 0):
                    series[n] += spring * chi * (i + 1) * depth[i + 1] * depth[n - i]
            end, rate = polynomial(series, at.order, step)
            largest = max(lanes[at.contact_force + contact, k], abs(series[0]), abs(end))
            for i in range(_velocity_roots(step, rate, work)):
                value, _ = polynomial(series, at.order, work.roots[i])
                largest = max(largest, abs(value))
            lanes[at.contact_force + contact, k] = largest


@internal
def _record_dense(at, run, k):
    """Record the step's series of coordinates and first-order states for dense output."""
    lanes, steps, i = run.lanes, run.logs[STEPS], run.fill[STEPS]
    steps[i, 0], steps[i, 1] = run.lane_point[k], lanes[at.start_time, k]
    steps[i, 2] = lanes[at.step, k]
    load_series(run.coefficients, 0, k, steps[i, DENSE_HEAD:])
    run.fill[STEPS] += 1


def _emit_passed(builder, lanes, among):
    """Emit `find_passed`; returns its packed masks."""
    step, period, event_clock = lanes["step"], lanes["period"], lanes["event_clock"]
    cycle_0, tau_0, cycle = lanes["cycle_0"], lanes["tau_0"], lanes["cycle"]
    start = lanes["t_start"] + (cycle_0 + (tau_0 - lanes["tau_start"])) * period
    lanes["start_time"] = start
    since = cycle + lanes["tau"] - event_clock
    has_passed = step < step
    for side in lanes.rows("side"):
        has_passed = has_passed | (absolute(side) > 0.0)
    packed = ir.Constant(I64, 0)
    masks = has_passed & (since >= 0.0), since >= -CLOCK_SLACK
    for k, mask in enumerate(masks):
        bits = builder.and_(mask.bits(), among)
        packed = builder.or_(packed, builder.shl(bits, ir.Constant(I64, k * lanes.layout.width)))
    return packed


@intrinsic
def find_passed(typingctx, at, lanes, among):
    """Find which lanes in `among` ended on a wall, and which record events, in their last step.

    Parameters
    ----------
    at, lanes
        As in `taylor_step`, after the step; unclear crossings are resolved. Sets `start_time`.
    among : int64
        The lanes that record, one bit each.

    Returns
    -------
    int64
        Two masks of `at.width` bits, lowest first: lanes that ended on a wall; lanes that record
        all events.
    """
    signature = types.int64(at, lanes, types.int64)

    def codegen(context, builder, signature, args):
        (lanes,) = rows_of(context, builder, signature, args)
        return _emit_passed(builder, lanes, args[2])

    return signature, codegen


@internal
def _write_turns(at, run, events, which, series):
    """Record the extrema that `find_coordinate_turns` or `find_gap_turns` found."""
    first = series * at.n_terms
    turns = events & at.all_lanes
    unclear = (events >> at.width) & at.all_lanes
    while turns != 0:
        k = lowest_bit(turns)
        turns &= turns - 1
        slope = run.coefficients[first + 1, k]
        t, x = run.lanes[at.turn_time, k], run.lanes[at.turn_x, k]
        _write_turn(run, k, t, which, x)
        if at.is_free and which == 0 and slope > 0.0:
            start = run.lanes[at.start_time, k]
            _write_return(at, run, k, start, t - start)
    while unclear != 0:
        k = lowest_bit(unclear)
        unclear &= unclear - 1
        _record_extrema(at, run, k, which, first)


@internal
def record_steps(layout, among, run):
    """Write what happened in the last step of the lanes with a bit in `among` to the logs of `run`.

    Section points of forced motions first; then, if a log of extrema is kept, extrema, contact
    times and, for dense output, the step itself, if it ends after the lane has begun to record.
    """
    at = run.at[0]
    if not at.is_free:
        _record_sections(at, among, run)
    if len(run.logs[TURNS]) == 0:  # only sections are recorded
        return
    passed = find_passed(layout, run.lanes, among)
    contacts = passed & at.all_lanes
    all_events = (passed >> at.width) & at.all_lanes
    if all_events != 0 and (run.turns or at.is_free):
        for i in range(at.n if run.turns else 1):
            events = find_coordinate_turns(
                layout, run.lanes, run.coefficients, i, i, all_events, at.order
            )
            _write_turns(at, run, events, i, i)
        for i in range(at.n_turning - at.n if run.turns else 0):
            series = at.first_gap + i
            events = find_gap_turns(
                layout, run.lanes, run.coefficients, i, series, all_events, at.order
            )
            _write_turns(at, run, events, at.n + i, series)
    if at.is_damped and at.is_taylor:  # Runge-Kutta steps record them
        _record_forces(at, run, all_events)
    while contacts != 0:
        k = lowest_bit(contacts)
        contacts &= contacts - 1
        if at.has_impacts and run.turns:
            _record_rebounds(at, run, k)
        for contact in range(at.contacts):
            if run.lanes[at.side + contact, k] != 0.0:
                _record_contact(at, run, k, contact)
    if len(run.logs[STEPS]) > 0:
        while all_events != 0:
            k = lowest_bit(all_events)
            all_events &= all_events - 1
            _record_dense(at, run, k)


@entry
def place(rows, next_row, placed):
    """Copy rows of a log, in the order of time, behind the earlier rows of the same points.

    Parameters
    ----------
    rows : array, shape (n_rows, n_columns)
    next_row : int array, shape (n_points,)
        Row of `placed` for the next row of each point; incremented.
    placed : array, shape (at least n_rows, n_columns)
        Receives the rows.
    """
    for i in range(len(rows)):
        point = int(rows[i, POINT])
        row = next_row[point]
        next_row[point] = row + 1
        for column in range(rows.shape[1]):
            placed[row, column] = rows[i, column]
