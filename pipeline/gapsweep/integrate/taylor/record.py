"""What a step leaves behind when recording is on: extrema, section points, contacts, the series.

Each record is a row (point, kind, t, x, v) of one log that all points share; a point's rows are
in the order of time within each kind. Extrema are all roots of the step's velocity polynomial,
isolated with the same proof as crossings.
"""

from gapsweep.integrate.jit import internal

from . import lane_rows as row
from .roots import DOUBLE, SIMPLE, isolate, polynomial

MINIMUM, MAXIMUM, INFLECTION, SECTION = 0, 1, 2, 3
ENTER_UPPER, LEAVE_UPPER, ENTER_LOWER, LEAVE_LOWER = 4, 5, 6, 7
POINT, KIND, TIME, DISPLACEMENT, VELOCITY = range(5)
N_FIELDS = 5
DENSE_HEAD = 3  # point, start time, length; then the coefficients

# A turn and its return that differ by less than this part of the displacement are rounding's
# picture of one inflection (v = 0 and a = 0).
_SAME_DISPLACEMENT = 4e-16
_TOUCH = 1e-12  # of the velocity: a closer approach to zero is a touch, by the same measure
_FLANK = 1e-5  # of the step
_CLOCK_SLACK = 1e-9  # of a period: a record_from meant as a whole period includes its section


@internal
def _write(log, fill, point, kind, t, x, v):
    i = fill[0]
    log[i, POINT], log[i, KIND], log[i, TIME] = point, kind, t
    log[i, DISPLACEMENT], log[i, VELOCITY] = x, v
    fill[0] += 1


@internal
def _start_time(lanes, k):
    """Time at which lane k's last step began [s]."""
    elapsed = lanes[row.CYCLE_0, k] + (lanes[row.TAU_0, k] - lanes[row.TAU_START, k])
    return lanes[row.T_START, k] + elapsed * lanes[row.PERIOD, k]


@internal
def _noise(degree, step, work):
    """Rounding error to expect in the velocity polynomial."""
    size, power = 0.0, 1.0
    for n in range(degree + 1):
        size += abs(work.reduced[n]) * power
        power *= step
    return _TOUCH * size


@internal
def _without_echoes(n_roots, step, work):
    """Drop touches next to a simple root or to the step's ends: they are the root's own flank."""
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
    """Zeros of v on (0, step], left in ``work.roots``: their number."""
    series, degree = work.series, len(work.series) - 1
    skipped = 1
    while skipped <= degree and series[skipped] == 0.0:
        skipped += 1  # an extremum at the start belongs to the step before
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
def _record_extrema(step, v_1, start, first, point, log, fill, work):
    n_roots = _velocity_roots(step, v_1, work)
    if n_roots == 0:
        return
    series, degree = work.series, len(work.series) - 1
    roots, multiplicity = work.roots, work.multiplicity
    rising = work.reduced[0] > 0.0  # sign of v right after the start; each simple root flips it
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
        if kind != INFLECTION:
            rising = not rising
        if t >= first:
            _write(log, fill, point, kind, start + t, x, 0.0)
        i += 1


@internal
def _record_section(lanes, k, step, point, log, fill, series):
    """The state at the whole period that the step passed or ended on."""
    x, v = lanes[row.X, k], lanes[row.V, k]
    if lanes[row.TAU, k] != 0.0:
        x, v = polynomial(
            series, len(series) - 1, min((1.0 - lanes[row.TAU_0, k]) * lanes[row.PERIOD, k], step)
        )
    t = (
        lanes[row.T_START, k]
        + (lanes[row.CYCLE, k] - lanes[row.TAU_START, k]) * lanes[row.PERIOD, k]
    )
    _write(log, fill, point, SECTION, t, x, v)


@internal
def _record_contact(lanes, k, side, end, point, log, fill):
    """One row for a wall passed; two where no gap lies between the walls."""
    x, v, mode = lanes[row.X, k], lanes[row.V, k], lanes[row.MODE, k]
    if mode == 0.0:
        # out of contact: over its upper wall downward (side -1), over its lower one upward
        _write(log, fill, point, LEAVE_UPPER if side < 0.0 else LEAVE_LOWER, end, x, v)
        return
    if lanes[row.LOWER, k] == lanes[row.UPPER, k] and lanes[row.MODE_0, k] != 0.0:
        _write(log, fill, point, LEAVE_UPPER if side < 0.0 else LEAVE_LOWER, end, x, v)
    _write(log, fill, point, ENTER_UPPER if side > 0.0 else ENTER_LOWER, end, x, v)


@internal
def record_step(lanes, k, is_unclear, point, log, dense, fill, work):
    """Record lane k's last step, from its `RECORD_CLOCK` on.

    `work.series` holds the step's Taylor coefficients; the lane itself is already at the step's
    end. `is_unclear`: the step's end was found after `taylor_step`, whose extremum does not count.
    """
    step, period = lanes[row.STEP, k], lanes[row.PERIOD, k]
    begun = lanes[row.CYCLE_0, k] + lanes[row.TAU_0, k] - lanes[row.RECORD_CLOCK, k]
    ended = lanes[row.CYCLE, k] + lanes[row.TAU, k] - lanes[row.RECORD_CLOCK, k]
    if ended < -_CLOCK_SLACK:
        return
    start = _start_time(lanes, k)
    first = -begun * period  # within the step; negative once recording is fully on
    if lanes[row.TURNS, k] == row.TURN_SINGLE and not is_unclear:
        t = lanes[row.TURN_TIME, k]
        if t >= first:
            kind = MAXIMUM if work.series[1] > 0.0 else MINIMUM
            _write(log, fill, point, kind, start + t, lanes[row.TURN_X, k], 0.0)
    elif is_unclear or lanes[row.TURNS, k] == row.TURN_UNCLEAR:
        _record_extrema(step, lanes[row.V, k], start, first, point, log, fill, work)
    whole_periods = lanes[row.CYCLE, k]
    if (
        whole_periods > lanes[row.CYCLE_0, k]
        and whole_periods - lanes[row.RECORD_CLOCK, k] >= -_CLOCK_SLACK
    ):
        _record_section(lanes, k, step, point, log, fill, work.series)
    if lanes[row.SIDE, k] != 0.0 and ended >= 0.0:
        _record_contact(lanes, k, lanes[row.SIDE, k], start + step, point, log, fill)
    if len(dense) > 0:
        i = fill[1]
        dense[i, 0], dense[i, 1], dense[i, 2] = point, start, step
        for n in range(len(work.series)):
            dense[i, DENSE_HEAD + n] = work.series[n]
        fill[1] += 1
