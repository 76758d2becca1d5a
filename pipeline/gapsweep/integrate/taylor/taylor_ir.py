"""One Taylor step of the exact contact law, for all lanes at once, emitted as vector code.

Inside one contact mode the equation is polynomial, so the Taylor coefficients of x(t) follow
from two short convolutions (x^2 and x^3) and the series of the forcing [1]_. A mode is an
interval [lo, hi] of displacement that x may not leave: the gap itself, or one of the half lines
behind a wall. The step is cut where the step's own polynomial leaves the interval first.

What happens here, without any branch but one:

1. forcing phase to cosine and sine, Taylor coefficients, step size from the last two of them;
2. proof, from bounds on the coefficients, that x, v or the acceleration keep their place or
   sign on the whole step. It sorts the lanes into *inside* (no crossing possible), *crossing*
   (exactly one, decided by the end point) and *unclear*;
3. Newton's method for all crossing lanes together (the one branch: skipped if there is none);
4. commit: clock, state, mode, counters. *Unclear* lanes are left untouched; the caller isolates
   their roots one by one (`roots`).

References
----------
.. [1] A. Jorba, M. Zou, "A software package for the numerical integration of ODEs by means of
   high-order Taylor methods", Experimental Mathematics 14 (2005) 99-117.
"""

import math
from functools import reduce

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from . import lane_rows as row
from .lane_ir import (
    I64,
    Vec,
    absolute,
    copy_sign,
    fma,
    is_nonzero,
    load_row,
    maximum,
    minimum,
    nearest_integer,
    rough_exp2,
    rough_log2,
    splat,
    square_root,
    store_row,
    where,
)

# A step spans at most this part of a forcing period, so that it holds at most one section point.
MAX_PERIODS_PER_STEP = 0.5
# The step size comes from terms that the step still contains, h^N and h^(N-1). With this factor
# the energy of a free swing is kept to some 20 rtol over 50 cycles, whatever the spring.
SAFETY = 0.5
_STEPS_PER_PERIOD = 8192  # at a stiff wall: over so many the tangent's errors come to about rtol
_POLE = 1.854  # K(1/2), complete elliptic integral: of the stiffest, purely cubic swing
CLOCK_SLACK = 1e-9  # of a period: a record_from meant as a whole period includes its section
MAX_HALVINGS = 3
NEWTON_STEPS = 3
SHORT_STEP = 1e-6  # rad of the fastest frequency: contact steps shorter than this count as chatter
_EPS = 2.0**-52


def _sin_cos_of_period(tau):
    """cos and sin of 2 pi tau for tau in [0, 1], absolute error of a rounding."""
    quarter = nearest_integer(tau * 4.0)
    angle = (tau * 4.0 - quarter) * (math.pi / 2)  # within pi/4
    square = angle * angle
    sine = square.constant((-1) ** 7 / math.factorial(15))
    cosine = square.constant((-1) ** 8 / math.factorial(16))
    for k in range(6, -1, -1):
        sine = fma(sine, square, (-1.0) ** k / math.factorial(2 * k + 1))
    for k in range(7, -1, -1):
        cosine = fma(cosine, square, (-1.0) ** k / math.factorial(2 * k))
    sine = sine * angle
    is_odd = quarter.equals(1.0) | quarter.equals(3.0)
    c, s = where(is_odd, sine, cosine), where(is_odd, cosine, sine)
    c = where(quarter.equals(1.0) | quarter.equals(2.0), -c, c)
    s = where(quarter.equals(2.0) | quarter.equals(3.0), -s, s)
    return c, s


def _forcing_series(order, push, omega_rad, tau):
    """Taylor coefficients 0 .. order-2 of ``push * cos(2 pi tau + omega_rad * t)``."""
    c, s = _sin_cos_of_period(tau)
    minus_square = -(omega_rad * omega_rad)
    series = [push * c, -(push * omega_rad * s)]
    for n in range(order - 3):
        series.append(series[n] * (minus_square * (1.0 / ((n + 1) * (n + 2)))))
    return series[: order - 1]


def _square_term(x, n):
    """Coefficient n of x^2. The newest coefficient comes last: the sum waits for it alone."""
    if n == 0:
        return x[0] * x[0]
    total = None
    for i in range((n - 1) // 2, 0, -1):
        total = x[i] * x[n - i] if total is None else fma(x[i], x[n - i], total)
    total = x[0] * x[n] if total is None else fma(x[0], x[n], total)
    total = total * 2.0
    return total if n % 2 else fma(x[n // 2], x[n // 2], total)


def _product_term(a, b, n):
    """Coefficient n of a*b, newest factors last."""
    if n == 0:
        return a[0] * b[0]
    total = None
    for i in range(1, n):
        total = a[i] * b[n - i] if total is None else fma(a[i], b[n - i], total)
    total = a[0] * b[n] if total is None else fma(a[0], b[n], total)
    return fma(a[n], b[0], total)


def _displacement_series(order, x_0, v_0, forcing, equation):
    """Taylor coefficients 0 .. order of x, and 0 .. order-2 of x^2."""
    damping, cubic, stiffness, contact, wall = equation
    total_stiffness = stiffness + contact
    x, square = [x_0, v_0], []
    for n in range(order - 1):
        square.append(_square_term(x, n))
        cube = _product_term(square, x, n)
        if n == 0:
            # contact * (x - wall), not the difference of two large products
            total = forcing[0] - contact * (x_0 - wall)
            total = fma(-stiffness, x_0, total)
        else:
            total = fma(-total_stiffness, x[n], forcing[n])
        total = fma(-damping * float(n + 1), x[n + 1], total)
        total = fma(-cubic, cube, total)
        x.append(total * (1.0 / ((n + 1) * (n + 2))))
    return x, square


def _tangent_series(order, y_0, w_0, square, equation):
    """Taylor coefficients of a solution of the variational equation along x."""
    damping, cubic, stiffness, contact, _ = equation
    total_stiffness, triple = stiffness + contact, cubic * 3.0
    y = [y_0, w_0]
    for n in range(order - 1):
        total = fma(triple, _product_term(square, y, n), total_stiffness * y[n])
        total = fma(damping * float(n + 1), y[n + 1], total)
        y.append(-(total * (1.0 / ((n + 1) * (n + 2)))))
    return y


def _rough_root(a):
    return rough_exp2(rough_log2(a) * 0.5)


def _swing(depth, v, stiffness, cubic):
    """Speed and displacement that the springs would carry this state to, without all else.

    Both follow from the energy, twice and per unit mass: ``v^2 + stiffness depth^2 + cubic
    depth^4 / 2``. An error is small or large beside them, because at a turn and on a wall v or x
    alone is zero.

    Returns
    -------
    speed [m/s], reach [m] : Vec
        To 6 %.
    """
    square = depth * depth
    energy = fma(v, v, fma(cubic * 0.5, square, stiffness) * square)
    root = _rough_root(fma(stiffness, stiffness, cubic * energy * 2.0))
    log_energy = rough_log2(energy)
    log_reach = (log_energy + 1.0 - rough_log2(stiffness + root)) * 0.5
    return rough_exp2(log_energy * 0.5), rough_exp2(log_reach)


def _off_grid(logarithm):
    """A logarithm to 20 bits and a quarter of the last.

    `rough_log2` and `rough_exp2` round to 20 bits. What is divided in between then never lies
    halfway between two results, where the last bit of a double would decide: a motion in which
    time runs twice as fast takes the same steps.
    """
    return (math.floor(logarithm * 2**20) + 0.25) * 2.0**-20


def _step_size(order, x, scale, rtol, springs, hardening, damping):
    """Largest h (to about 6 %) that keeps the motion, and what becomes of its errors, accurate.

    The last two terms of the velocity stay below `scale` [m/s]; within a swing an error of x is
    smaller beside its own scale. Two bounds hold besides, because those terms may vanish:

    - A disturbance (an earlier step's error, the tangent) oscillates and decays no faster than the
      larger of ``sqrt(springs)`` and `damping` [1/s], and h spans no more of that than a series of
      this degree carries. Where x itself is slow or straight, it would come out as nonsense.
    - A cubic spring swings like an elliptic cosine, whose poles lie `_POLE` over the root of
      `hardening` [1/s^2] from the real axis: terms fall no faster than powers of h over that.
    """
    log_error = rough_log2(rtol * SAFETY)
    log_scale = rough_log2(scale * SAFETY)
    log_tangent = log_error - math.log2(_STEPS_PER_PERIOD)
    log_carried = (log_tangent + math.log2(math.factorial(order + 1))) * (1.0 / (order + 1))
    log_ratio = (log_error - math.log2(1.2 * (order + 1))) * (1.0 / order) + math.log2(_POLE)
    log_rate = maximum(rough_log2(springs) * 0.5, rough_log2(damping))
    limits = [
        (log_scale - _off_grid(math.log2(n)) - rough_log2(absolute(x[n]))) * (1.0 / (n - 1))
        for n in (order, order - 1)
    ]
    limits.append(log_carried - log_rate)
    limits.append(log_ratio - rough_log2(hardening) * 0.5)
    return rough_exp2(reduce(minimum, limits))


def value_and_slope(series, t):
    """Polynomial and derivative at t by Horner's rule."""
    value, slope = series[-1], None
    for a in reversed(series[:-1]):
        slope = value if slope is None else fma(slope, t, value)
        value = fma(value, t, a)
    return value, slope


def _tail_bound(series, h):
    """``sum(n (n-1) |x_n| h^n, n >= 4)``: bounds the tail of h^2 x'', thrice that of h x' and
    twelve times that of x (all tails from degree 4 on)."""
    order = len(series) - 1
    total = absolute(series[order]) * float(order * (order - 1))
    for n in range(order - 1, 3, -1):
        total = fma(total, h, absolute(series[n]) * float(n * (n - 1)))
    square = h * h
    return total * (square * square) * (1.0 + 1e-9)


class _Shape:
    """What is proved about a step: each attribute is a `Mask`, true only where proved."""

    def __init__(self, series, h, lo, hi):
        y_1, y_2, y_3 = series[1] * h, series[2] * (h * h), series[3] * (h * h * h)
        tail = _tail_bound(series, h)
        # Bernstein coefficients of the cubic part enclose it; the tail widens the enclosure,
        # and so do the roundings of this very computation.
        rounding = (absolute(y_1) + absolute(y_2) * 2.0 + absolute(y_3) * 6.0) * (16 * _EPS)
        self.falls, self.rises = _signs(
            [y_1, y_1 + y_2, y_1 + y_2 * 2.0 + y_3 * 3.0], tail * (1.0 / 3) + rounding
        )
        self.is_concave, self.is_convex = _signs([y_2, y_2 + y_3 * 3.0], tail * 0.5 + rounding)
        offsets = [y_1 * (1.0 / 3), fma(y_1, 2.0, y_2) * (1.0 / 3), y_1 + y_2 + y_3]
        low = minimum(minimum(offsets[0], offsets[1]), minimum(offsets[2], 0.0 * y_1))
        high = maximum(maximum(offsets[0], offsets[1]), maximum(offsets[2], 0.0 * y_1))
        slack = fma(tail, 1.0 / 12, fma(absolute(series[0]), 16 * _EPS, rounding))
        self.stays_above_lo = series[0] + (low - slack) >= lo
        self.stays_below_hi = series[0] + (high + slack) <= hi
        is_monotone = self.falls | self.rises
        # Inside at the start, x leaves over `lo` at most once if it is monotone or concave,
        # over `hi` at most once if monotone or convex: then the end point decides.
        self.is_decided = (self.stays_above_lo | is_monotone | self.is_concave) & (
            self.stays_below_hi | is_monotone | self.is_convex
        )


def _emit_decided_step(builder, series, h, lo, hi):
    """Shorten the step of lanes whose crossing is unclear, up to MAX_HALVINGS times.

    A shorter step costs a fifth of isolating roots for one lane, and its bounds are much tighter:
    each neglected degree halves once more.

    Returns
    -------
    h : Vec
        The step.
    shape : _Shape
        What is proved about it.
    """
    start = builder.block
    loop, done = builder.append_basic_block("halve"), builder.append_basic_block("decided")
    builder.branch(loop)
    builder.position_at_end(loop)
    step, count = builder.phi(h.value.type), builder.phi(I64)
    trial = Vec(builder, step)
    shape = _Shape(series, trial, lo, hi)
    halved = where(shape.is_decided, trial, trial * 0.5)
    step.add_incoming(h.value, start)
    step.add_incoming(halved.value, builder.block)
    count.add_incoming(ir.Constant(I64, 0), start)
    count.add_incoming(builder.add(count, ir.Constant(I64, 1)), builder.block)
    is_open = is_nonzero(builder, (~shape.is_decided).bits())
    may_go_on = builder.icmp_unsigned("<", count, ir.Constant(I64, MAX_HALVINGS))
    builder.cbranch(builder.and_(is_open, may_go_on), loop, done)
    builder.position_at_end(done)
    return trial, shape


def _signs(bernstein, slack):
    """Masks (all below zero, all above zero) of a polynomial from its Bernstein coefficients."""
    low = high = bernstein[0]
    for b in bernstein[1:]:
        low, high = minimum(low, b), maximum(high, b)
    return high + slack < 0.0, low - slack > 0.0


def _crossing(series, h, wall, x_1, v_1):
    """Last time before h at which x reaches `wall`, the velocity there, and the residual."""
    # The parabola through both ends and the slope at h is good to about 1e-3 of the step. Of its
    # two roots the later one is taken: the earlier may be the wall that the step started on.
    g_1, u_1 = x_1 - wall, v_1 * h
    bend = (series[0] - wall) - g_1 + u_1
    root = square_root(maximum(fma(u_1, u_1, -(bend * g_1 * 4.0)), 0.0 * g_1))
    back = g_1 * 2.0 / (u_1 + copy_sign(root, u_1))
    t = h - h * maximum(minimum(back, back.constant(1.0)), 0.0 * back)
    for _ in range(NEWTON_STEPS):
        value, slope = value_and_slope(series, t)
        t = t - (value - wall) / slope
    value, slope = value_and_slope(series, t)
    return t, slope, value - wall


def _emit_crossings(builder, series, h, end, outward, wants_root, wall):
    """Crossing time and velocity of the lanes in `wants_root`; skipped if there is none.

    Returns
    -------
    t, v : Vec
        Time and velocity at the crossing, where `is_found`.
    is_found : Mask
        Newton's method converged inside the step to an outward crossing.
    """
    x_1, v_1 = end
    mask_type = wants_root.value.type
    none = ir.Constant(mask_type, [ir.Constant(ir.IntType(1), 0)] * mask_type.count)
    before = builder.block
    with builder.if_then(is_nonzero(builder, wants_root.bits())):
        t, v, residual = _crossing(series, h, wall, x_1, v_1)
        size = absolute(series[0]) + (absolute(series[1]) + absolute(v)) * absolute(t)
        is_exact = absolute(residual) <= size * (8 * _EPS)  # as near as rounding lets it come
        is_found = is_exact & (t > 0.0) & (t <= h) & (v * outward > 0.0)
        inside = builder.block
    results = []
    for skipped, computed in ((h.value, t.value), (v_1.value, v.value), (none, is_found.value)):
        phi = builder.phi(computed.type)
        phi.add_incoming(skipped, before)
        phi.add_incoming(computed, inside)
        results.append(phi)
    return Vec(builder, results[0]), Vec(builder, results[1]), type(wants_root)(builder, results[2])


def _emit_step(builder, lanes, coefficients, order, has_tangent, scalars):
    """Emit the whole step; returns the packed masks (see `taylor_step`)."""
    width = row.WIDTH

    def load(r):
        return load_row(builder, lanes, r, width)

    def store(r, vec):
        store_row(lanes, r, vec)

    rtol, x_bound, max_short = (splat(builder, s, width) for s in scalars)
    x, v, tau, cycle, mode = (load(r) for r in (row.X, row.V, row.TAU, row.CYCLE, row.MODE))
    lower, upper = load(row.LOWER), load(row.UPPER)
    is_above, is_below = mode > 0.0, mode < 0.0
    is_touching = is_above | is_below
    contact = where(is_touching, load(row.CONTACT), 0.0)
    wall = where(
        is_above, upper, where(is_below, lower, 0.0)
    )  # finite: a wall at infinity is never touched
    lo = where(is_above, upper, where(is_below, lower.constant(-math.inf), lower))
    hi = where(is_below, lower, where(is_above, upper.constant(math.inf), upper))

    # 1. series and step size
    equation = load(row.DAMPING), load(row.CUBIC), load(row.STIFFNESS), contact, wall
    forcing = _forcing_series(order, load(row.PUSH), load(row.OMEGA_RAD), tau)
    series, square = _displacement_series(order, x, v, forcing, equation)
    for n, term in enumerate(series):
        store_row(coefficients, n, term)
    period = load(row.PERIOD)
    # In contact the depth is what counts: an error of x there is one of a much larger force.
    damping, cubic, stiffness, _, _ = equation
    cubic, square_wall = absolute(cubic), wall * wall
    at_wall = contact + cubic * square_wall * 3.0
    speed, reach = _swing(x - wall, v, stiffness + at_wall, cubic)
    farthest = absolute(wall) + reach
    hardening = cubic * (farthest * farthest)
    springs = fma(hardening, 3.0, stiffness + contact)
    scale = fma(speed, rtol, load(row.FLOOR))
    free_step = _step_size(order, series, scale, rtol, springs, hardening, damping)
    end_cycle, end_tau = load(row.END_CYCLE), load(row.END_TAU)
    left = maximum(((end_cycle - cycle) + (end_tau - tau)) * period, 0.0 * period)
    h = minimum(free_step, period * MAX_PERIODS_PER_STEP)
    is_last = h >= left
    h = where(is_last, left, h)

    # 2. which lanes leave their interval
    h, shape = _emit_decided_step(builder, series, h, lo, hi)
    is_last = is_last & (h >= left)
    x_1, v_1 = value_and_slope(series, h)
    leaves_up, leaves_down = x_1 >= hi, x_1 <= lo
    leaves = leaves_up | leaves_down
    outward = where(leaves_up, x.constant(1.0), -1.0)
    target = where(leaves_up, hi, lo)

    # 3. where exactly
    wants_root = leaves & shape.is_decided
    t, v_wall, is_found = _emit_crossings(
        builder, series, h, (x_1, v_1), outward, wants_root, target
    )
    crosses = wants_root & is_found
    is_unclear = (leaves & ~crosses) | ~shape.is_decided
    step = where(crosses, t, h)
    x_1, v_1 = where(crosses, target, x_1), where(crosses, v_wall, v_1)

    # 4. commit
    is_done = is_last & ~crosses & ~is_unclear
    tau_1 = fma(load(row.OMEGA), step, tau)
    is_stuck = (step < load(row.MIN_STEP)) & ~(crosses | is_last)
    wraps = tau_1 >= 1.0
    tau_1 = where(is_done, end_tau, where(wraps, tau_1 - 1.0, tau_1))
    cycle_1 = where(is_done, end_cycle, where(wraps, cycle + 1.0, cycle))
    has_gap = lower < upper
    # Leaving contact without a gap is entering contact with the other wall.
    next_mode = where(is_touching, where(has_gap, 0.0 * outward, outward), outward)
    n_walls = where(is_touching & ~has_gap, x.constant(2.0), 1.0)
    is_short = crosses & (step * load(row.RATE) < SHORT_STEP)
    n_short = where(is_short, load(row.N_SHORT) + 1.0, 0.0 * x.constant(1.0))
    is_bad = (
        ~((absolute(x_1) <= x_bound) & (absolute(v_1) < math.inf))
        | is_stuck
        | (n_short > max_short)
    )
    # an unclear lane ends here or earlier
    is_section = (cycle_1 > cycle) & (cycle_1 - load(row.RECORD_CLOCK) >= -CLOCK_SLACK)
    is_recording = is_section | (cycle_1 + tau_1 - load(row.EVENT_CLOCK) >= -CLOCK_SLACK)

    if has_tangent:
        for k in (0, 2):
            solution = _tangent_series(
                order, load(row.TANGENT + k), load(row.TANGENT + k + 1), square, equation
            )
            for n, term in enumerate(solution):
                store_row(coefficients, (order + 1) * (1 + k // 2) + n, term)
            y, w = value_and_slope(solution, step)
            store(row.TANGENT + k, where(is_unclear, solution[0], y))
            store(row.TANGENT + k + 1, where(is_unclear, solution[1], w))

    one = x.constant(1.0)
    store(row.X, where(is_unclear, x, x_1))
    store(row.V, where(is_unclear, v, v_1))
    reach = load(row.REACH)
    store(row.REACH, where(is_unclear, reach, maximum(reach, absolute(x_1))))
    store(row.TAU, where(is_unclear, tau, tau_1))
    store(row.CYCLE, where(is_unclear, cycle, cycle_1))
    store(row.MODE, where(crosses, next_mode, mode))
    store(row.N_STEPS, load(row.N_STEPS) + where(is_unclear, 0.0 * one, 1.0))
    store(row.N_CONTACTS, load(row.N_CONTACTS) + where(crosses, n_walls, 0.0))
    store(row.N_SHORT, where(is_unclear, load(row.N_SHORT), n_short))
    store(row.STEP, step)
    store(row.SIDE, where(crosses, outward, 0.0))
    store(row.TAU_0, tau)
    store(row.CYCLE_0, cycle)
    store(row.MODE_0, mode)

    packed = is_unclear.bits()
    for k, mask in enumerate((is_done, is_bad & ~is_unclear, is_recording), start=1):
        packed = builder.or_(packed, builder.shl(mask.bits(), ir.Constant(I64, k * width)))
    return packed


@intrinsic
def taylor_step(typingctx, lanes, coefficients, order, has_tangent, rtol, x_bound, max_short):
    """Advance every lane by one step.

    Parameters
    ----------
    lanes : array, shape (N_ROWS, WIDTH)
        Parameters and state (`lane_rows`), updated in place.
    coefficients : array, shape (n * (order + 1), WIDTH)
        Receives the Taylor coefficients of x, and of both tangent solutions if they are wanted
        (n = 3, otherwise n = 1).
    order, has_tangent : tuple of int
        Their *lengths* are the degree of the Taylor polynomial and 0 or 1. A tuple's length is
        part of its type, so each order is its own specialisation, compiled and cached by itself.
    rtol, x_bound, max_short : float
        Relative tolerance; bound of |x| [m]; cap on successive short contact steps.

    Returns
    -------
    int64
        Four masks of WIDTH bits, lowest first: lanes not advanced because their crossing is
        unclear; lanes at their end; lanes that failed; lanes that record (an unclear one perhaps).
    """
    signature = types.int64(lanes, coefficients, order, has_tangent, rtol, x_bound, max_short)
    n_order, n_tangent = len(order), len(has_tangent)

    def codegen(context, builder, signature, args):
        pointers = [
            context.make_array(t)(context, builder, a).data
            for t, a in zip(signature.args[:2], args[:2], strict=True)
        ]
        return _emit_step(builder, *pointers, n_order, n_tangent > 0, args[4:])

    return signature, codegen
