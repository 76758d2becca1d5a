"""What a step leaves behind when recording is on: extrema, section points, contacts, the series.

Each record is a row (point, kind, t, x, v) of one log that all points share; a point's rows are
in the order of time within each kind.

Extrema are all zeros of the step's velocity polynomial. Vector code proves by Descartes' rule,
for all lanes at once, that there is none or one, and finds it (`find_events`). That leaves one
step in some hundreds: its zeros are isolated by the same rule on parts of the step (`roots`).
"""

import math

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from gapsweep.integrate.jit import internal

from . import lane_rows as row
from .lane_ir import (
    I64,
    absolute,
    copy_sign,
    is_nonzero,
    load_row,
    lowest_bit,
    minimum,
    store_row,
    where,
)
from .roots import DOUBLE, SIMPLE, isolate, polynomial
from .taylor_ir import CLOCK_SLACK, value_and_slope

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
_NEWTON_STEPS = 4
_CLOSE = 1e-7  # of the step: largest last correction; the error left is about its square


@internal
def _write(log, fill, point, kind, t, x, v):
    i = fill[0]
    log[i, POINT], log[i, KIND], log[i, TIME] = point, kind, t
    log[i, DISPLACEMENT], log[i, VELOCITY] = x, v
    fill[0] += 1


@internal
def load_series(coefficients, first, k, series):
    """Copy lane k's coefficients out of the lane-major array, from row `first` on."""
    for n in range(len(series)):
        series[n] = coefficients[first + n, k]


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
def _record_extrema(lanes, k, point, log, fill, work):
    """The zeros of the velocity of a step (in `work.series`) that `find_events` left unclear."""
    n_roots = _velocity_roots(lanes[row.STEP, k], lanes[row.V, k], work)
    if n_roots == 0:
        return
    start = lanes[row.START_TIME, k]
    begun = lanes[row.CYCLE_0, k] + lanes[row.TAU_0, k] - lanes[row.EVENT_CLOCK, k]
    first = -begun * lanes[row.PERIOD, k]  # within the step; negative once recording is fully on
    series, degree = work.series, len(work.series) - 1
    roots, multiplicity = work.roots, work.multiplicity
    rising = work.reduced[0] > 0.0  # sign of v right after the start; each simple root flips it
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
            _write(log, fill, point, kind, start + t, x, 0.0)
        i += 1


@internal
def _record_contact(lanes, k, point, log, fill):
    """One row for a wall passed; two where no gap lies between the walls."""
    side, end = lanes[row.SIDE, k], lanes[row.START_TIME, k] + lanes[row.STEP, k]
    x, v, mode = lanes[row.X, k], lanes[row.V, k], lanes[row.MODE, k]
    if mode == 0.0:
        # out of contact: over its upper wall downward (side -1), over its lower one upward
        _write(log, fill, point, LEAVE_UPPER if side < 0.0 else LEAVE_LOWER, end, x, v)
        return
    if lanes[row.LOWER, k] == lanes[row.UPPER, k] and lanes[row.MODE_0, k] != 0.0:
        _write(log, fill, point, LEAVE_UPPER if side < 0.0 else LEAVE_LOWER, end, x, v)
    _write(log, fill, point, ENTER_UPPER if side > 0.0 else ENTER_LOWER, end, x, v)


@internal
def _record_dense(lanes, k, coefficients, point, dense, fill):
    """The whole step's series."""
    i = fill[1]
    dense[i, 0], dense[i, 1], dense[i, 2] = point, lanes[row.START_TIME, k], lanes[row.STEP, k]
    load_series(coefficients, 0, k, dense[i, DENSE_HEAD:])
    fill[1] += 1


def _velocity_terms(series, h):
    """Coefficients of v in powers of t / h, with the sign that makes v_0 positive; that sign."""
    sign = copy_sign(h.constant(1.0), series[1])
    terms, power = [], sign
    for n in range(1, len(series)):
        terms.append(series[n] * power * float(n))
        power = power * h
    return terms, sign


def _bernstein_form(terms):
    """Bernstein coefficients on [0, 1] of ``sum(terms[n] s**n)``."""
    degree = len(terms) - 1
    b = [a * (1.0 / math.comb(degree, n)) for n, a in enumerate(terms)]
    for k in range(degree - 1, -1, -1):
        for j in range(k, degree):
            b[j + 1] = b[j + 1] + b[j]
    return b


def _sign_change(bernstein, noise):
    """What Descartes' rule proves about the zeros on (0, 1) of a polynomial positive at 0.

    Its end values are exact; an inner coefficient within `noise` may have either sign.

    Returns
    -------
    is_single, is_none : Mask
        Proved: exactly one zero; no zero and no value within `noise`.
    crossing : Vec
        Where the control polygon crosses zero, for a single zero.
    """
    degree, first, end = len(bernstein) - 1, bernstein[0], bernstein[-1]
    # One zero: positive up to some coefficient, the next one anything, negative from there on.
    is_positive, has_turned = first > 0.0, first < 0.0
    last, following, index = first, end, 0.0 * first
    for j, b in enumerate(bernstein[1:-1], start=1):
        following = where(is_positive, b, following)
        has_turned = (has_turned & (b < -noise)) | is_positive
        is_positive = is_positive & (b > noise)
        last, index = where(is_positive, b, last), where(is_positive, b.constant(j), index)
    following = where(is_positive, end, following)
    is_single = (has_turned | is_positive) & (end < 0.0)
    is_none = is_positive & (first > noise) & (end > noise)
    return is_single, is_none, (index + last / (last - following)) * (1.0 / degree)


def _emit_turns(builder, series, h, v_1, among):
    """Zeros of the velocity on (0, h].

    Returns
    -------
    is_single, is_none : Mask
        Proved: exactly one zero, and found; none at all. Lanes outside the bits `among` do not
        matter.
    t, x : Vec
        Time of the single one within the step, and displacement there.
    """
    terms, sign = _velocity_terms(series, h)
    size = absolute(terms[0])
    for term in terms[1:]:
        size = size + absolute(term)
    bernstein = _bernstein_form(terms)
    # The next step starts from this very number: no zero is seen twice or never.
    bernstein[-1] = v_1 * sign
    is_single, is_none, part = _sign_change(bernstein, size * _TOUCH)
    before = builder.block
    with builder.if_then(is_nonzero(builder, builder.and_(is_single.bits(), among))):
        for _ in range(_NEWTON_STEPS):
            value, slope = value_and_slope(terms, part)
            correction = value / slope
            part = part - correction
        is_found = is_single & (part > 0.0) & (part <= 1.0) & (absolute(correction) <= _CLOSE)
        t = part * h
        x, _ = value_and_slope(series, t)
        inside = builder.block
    results = []
    for skipped, computed in ((is_single, is_found), (h, t), (h, x)):
        phi = builder.phi(computed.value.type)
        phi.add_incoming(skipped.value, before)
        phi.add_incoming(computed.value, inside)
        results.append(type(computed)(builder, phi))
    is_found, t, x = results
    return is_found, is_none, t, x


def _emit_section(builder, series, step, load, store, is_section, among):
    """Store the state at the whole period that a step passed or ended on; skipped if none did."""
    with builder.if_then(is_nonzero(builder, builder.and_(is_section.bits(), among))):
        period = load(row.PERIOD)
        t = minimum((1.0 - load(row.TAU_0)) * period, step)
        x, v = value_and_slope(series, t)
        is_at_end = load(row.TAU).equals(0.0)
        store(row.SECTION_X, where(is_at_end, load(row.X), x))
        store(row.SECTION_V, where(is_at_end, load(row.V), v))
        elapsed = load(row.CYCLE) - load(row.TAU_START)
        store(row.SECTION_TIME, load(row.T_START) + elapsed * period)


def _emit_events(builder, lanes, coefficients, order, among):
    """Emit the whole search; returns the packed masks (see `find_events`)."""

    def load(r):
        return load_row(builder, lanes, r, row.WIDTH)

    def store(r, vec):
        store_row(lanes, r, vec)

    series = [load_row(builder, coefficients, n, row.WIDTH) for n in range(order + 1)]
    step, period, event_clock = load(row.STEP), load(row.PERIOD), load(row.EVENT_CLOCK)
    cycle_0, tau_0, cycle = load(row.CYCLE_0), load(row.TAU_0), load(row.CYCLE)
    start = load(row.T_START) + (cycle_0 + (tau_0 - load(row.TAU_START))) * period
    store(row.START_TIME, start)

    is_section = (cycle > cycle_0) & (cycle - load(row.RECORD_CLOCK) >= -CLOCK_SLACK)
    _emit_section(builder, series, step, load, store, is_section, among)

    side, since = load(row.SIDE), cycle + load(row.TAU) - event_clock
    has_passed = (absolute(side) > 0.0) & (since >= 0.0)
    before, all_of = builder.block, builder.and_((since >= -CLOCK_SLACK).bits(), among)
    with builder.if_then(is_nonzero(builder, all_of)):
        is_single, is_none, t, x = _emit_turns(builder, series, step, load(row.V), all_of)
        # recording may begin within the step
        is_turn = is_single & (t >= (event_clock - (cycle_0 + tau_0)) * period)
        store(row.TURN_TIME, start + t)
        store(row.TURN_X, x)
        turns = [builder.and_(mask.bits(), all_of) for mask in (is_turn, ~(is_single | is_none))]
        inside = builder.block
    packed = ir.Constant(I64, 0)
    for k, found in enumerate(turns):
        bits = builder.phi(I64)
        bits.add_incoming(ir.Constant(I64, 0), before)
        bits.add_incoming(found, inside)
        turns[k] = bits
    passed = [builder.and_(mask.bits(), among) for mask in (is_section, has_passed)]
    for k, bits in enumerate(turns + passed):
        packed = builder.or_(packed, builder.shl(bits, ir.Constant(I64, k * row.WIDTH)))
    return packed


@intrinsic
def find_events(typingctx, lanes, coefficients, order, among):
    """What happened within the last step of the lanes in `among`, for all lanes at once.

    Parameters
    ----------
    lanes, coefficients, order
        As `taylor_step`, after it; the lanes whose crossing was unclear are at their end too.
        The rows from `START_TIME` on receive times and places.
    among : int64
        The lanes that record, one bit each.

    Returns
    -------
    int64
        Four masks of WIDTH bits, lowest first: lanes with a single zero of the velocity; lanes
        whose zeros need `isolate`; lanes with a section point; lanes that ended on a wall.
    """
    signature = types.int64(lanes, coefficients, order, types.int64)
    n_order = len(order)

    def codegen(context, builder, signature, args):
        pointers = [
            context.make_array(t)(context, builder, a).data
            for t, a in zip(signature.args[:2], args[:2], strict=True)
        ]
        return _emit_events(builder, *pointers, n_order, args[3])

    return signature, codegen


@internal
def record_steps(lanes, among, coefficients, order, lane_point, log, dense, fill, work):
    """Record the last step of the lanes in the bits `among`, from their clocks on."""
    events = find_events(lanes, coefficients, order, among)
    turns = events & row.ALL_LANES
    unclear = (events >> row.WIDTH) & row.ALL_LANES
    sections = (events >> 2 * row.WIDTH) & row.ALL_LANES
    contacts = (events >> 3 * row.WIDTH) & row.ALL_LANES
    while turns != 0:
        k = lowest_bit(turns)
        turns &= turns - 1
        kind = MAXIMUM if coefficients[1, k] > 0.0 else MINIMUM
        t, x = lanes[row.TURN_TIME, k], lanes[row.TURN_X, k]
        _write(log, fill, lane_point[k], kind, t, x, 0.0)
    while unclear != 0:
        k = lowest_bit(unclear)
        unclear &= unclear - 1
        load_series(coefficients, 0, k, work.series)
        _record_extrema(lanes, k, lane_point[k], log, fill, work)
    while sections != 0:
        k = lowest_bit(sections)
        sections &= sections - 1
        t, x, v = lanes[row.SECTION_TIME, k], lanes[row.SECTION_X, k], lanes[row.SECTION_V, k]
        _write(log, fill, lane_point[k], SECTION, t, x, v)
    while contacts != 0:
        k = lowest_bit(contacts)
        contacts &= contacts - 1
        _record_contact(lanes, k, lane_point[k], log, fill)
    if len(dense) > 0:
        while among != 0:
            k = lowest_bit(among)
            among &= among - 1
            clock = lanes[row.CYCLE, k] + lanes[row.TAU, k] - lanes[row.EVENT_CLOCK, k]
            if clock >= -CLOCK_SLACK:
                _record_dense(lanes, k, coefficients, lane_point[k], dense, fill)
