"""Extrema within a step, found for all lanes at once, as vector code.

Descartes' rule proves that a velocity has no zero there or one, which Newton's method then finds.
"""

import math

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from gapsweep.integrate.lanes.rows import dot, rows_of, value_and_slope
from gapsweep.integrate.vectors import I64, absolute, branch, copysign, is_nonzero, where

TOUCH = 1e-12  # of the velocity: a closer approach to zero is a touch, by the same measure
_NEWTON_STEPS = 3
_CLOSE = 1e-7  # of the step: largest last correction; the error left is about its square


def _velocity_terms(series, h):
    """Coefficients of v in powers of t / h, times the sign that makes v_0 positive; that sign."""
    sign = copysign(h.constant(1.0), series[1])
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
    """Count, by Descartes' rule, the zeros on (0, 1) of a polynomial that is positive at 0.

    The end values are exact; an inner coefficient within `noise` may have either sign.

    Returns
    -------
    is_single, is_none : Mask
        Proved: exactly one zero; no zero and no value within `noise`.
    crossing : Vec
        Position at which the control polygon crosses zero, for a single zero.
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
    """Emit the search for the zero of a velocity on (0, h].

    Returns
    -------
    is_single, is_none : Mask
        Proved: exactly one zero, and found; none at all. Lanes outside `among` are undefined.
    t, x : Vec
        Time of the single zero within the step, and displacement there.
    """
    terms, sign = _velocity_terms(series, h)
    size = absolute(terms[0])
    for term in terms[1:]:
        size = size + absolute(term)
    bernstein = _bernstein_form(terms)
    # The next step starts from this very number: no zero is seen twice or never.
    bernstein[-1] = v_1 * sign
    is_single, is_none, part = _sign_change(bernstein, size * TOUCH)
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


def _turns_of(speed):
    """Return an intrinsic that finds the zeros of a velocity within the last step of some lanes.

    Parameters
    ----------
    speed : callable
        Function of lanes and `number` that returns the velocity at the end of the step.

    Returns
    -------
    intrinsic
        Function of ``at, lanes, coefficients, number, series, among, order``, called after
        `find_passed`: numbers of the velocity and of its series, degree of the series. Sets
        `turn_time`, `turn_x` and `turn_v`. Returns two masks of `at.width` bits, lowest first:
        lanes with a single zero; lanes whose zeros need `isolate`.
    """

    def find_turns(typingctx, at, lanes, coefficients, number, series, among, order):
        layout = at.layout
        signature = types.int64(at, lanes, coefficients, *[types.int64] * 4)

        def codegen(context, builder, signature, args):
            state, kept = rows_of(context, builder, signature, args)
            number, series, among, order = args[3:]
            terms = kept.below(series, layout.n_terms)
            v_1 = speed(state, number)
            if v_1 is None:
                return ir.Constant(I64, 0)
            x = [terms[n] for n in range(layout.n_terms)]
            h, (low, *high) = state["step"], layout.degrees

            def turns(degree):
                return _emit_turns(builder, x[: degree + 1], h, v_1, among)

            is_high = builder.icmp_signed(">", order, ir.Constant(I64, low))
            is_single, is_none, t, turn = (
                branch(builder, is_high, lambda: turns(*high), lambda: turns(low))
                if high
                else turns(low)
            )
            # recording may begin within the step
            begun = (state["event_clock"] - (state["cycle_0"] + state["tau_0"])) * state["period"]
            state["turn_time"], state["turn_x"] = state["start_time"] + t, turn
            state["turn_v"] = v_1
            single, unclear = is_single & (t >= begun), ~(is_single | is_none)
            masks = [builder.and_(mask.bits(), among) for mask in (single, unclear)]
            return builder.or_(masks[0], builder.shl(masks[1], ir.Constant(I64, layout.width)))

        return signature, codegen

    return intrinsic(find_turns)


def _gap_speed(state, contact):
    """Rate of a contact's gap at the step's end, bit-equal to that in the next step's series."""
    layout = state.layout
    if layout.is_plain:
        return None  # its gap is its coordinate
    direction = state.below(contact, layout.n)
    rows = [direction[layout.direction + i] for i in range(layout.n)]
    return dot(rows, state.rows(_end_speed(layout)), state["tau"].constant(0.0))


def _end_speed(layout):
    """Name of the rows of the speeds at the end of a step, before impacts there."""
    return "v_in" if layout.has_impacts else "v"


find_coordinate_turns = _turns_of(
    lambda state, i: state.below(i, 1)[state.layout.first[_end_speed(state.layout)]]
)
find_gap_turns = _turns_of(_gap_speed)
