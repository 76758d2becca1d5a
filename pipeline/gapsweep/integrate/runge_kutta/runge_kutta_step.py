"""One attempted Runge-Kutta step of all lanes: stages, error, step control, lanes to attend to.

Everything here is branch-free over lanes. The outcome is one word of lane bits per question
(`StepOutcome`); only lanes with a bit set are treated one by one afterwards, with the polynomials
of the step, as in a Taylor step.
"""

from typing import Any, NamedTuple

import numpy as np

from gapsweep.integrate import simd
from gapsweep.integrate.jit import inlined, internal
from gapsweep.integrate.lanes import parameters
from gapsweep.integrate.lanes.outcome import (
    AT_START,
    AT_WALL,
    CLOCK_SLACK,
    DIVERGED,
    MODEL_INVALID,
    STEP_UNDERFLOW,
    StepOutcome,
)
from gapsweep.integrate.motions import VANISHED
from gapsweep.integrate.simd import fma, load, maximum, minimum, select, store

from . import laws
from .damped_contacts import add_loss, enter_modes, record_forces, store_loss
from .stage_values import polynomials, stage_derivative, stages, tangent_stages
from .tableaux import E3, E5, OTHER_E5

# Measured on the tanh law at 1e-3 to 1e-9: 0.9 and 6 reject a quarter of all attempts and cost a
# tenth more.
SAFETY = 0.75
GROW_LIMIT, SHRINK_LIMIT = 3.0, 0.2
# An attempt within 10 % of the end is stretched to it (ode45's rule, kept for both controllers).
STRETCH = 1.1
# Smallest tolerance of a tangent, and the share of its largest coordinate added to each scale.
TANGENT_RTOL, FAINT = 1e-8, 1e-3
# In the row `failed`: the last step was too long, or is to be repeated up to the edge of a layer.
_FAILED, _CUT = 1.0, 2.0


@inlined
def _error(at, method, lane, h, rtol):
    """Error estimate over tolerance (accepted if <= 1): maximum norm for ode45, else rms norm."""
    tableau, k, atol = method.tableau, method.k, load(lane, at.atol)
    worst, lost = simd.splat(0.0), simd.splat(0.0)
    e5, e3, other = simd.splat(0.0), simd.splat(0.0), simd.splat(0.0)
    for i in range(at.n_rates):
        size_v = _size(lane, at.v + i, at.v_1 + i)  # first-order states stand after the speeds
        size_x = _size(lane, at.q + i, at.q_1 + i) if i < at.n else size_v
        if method.is_ode45:
            ex, ev = _missed(at, tableau, k, E5, 0, i)
            rv = simd.absolute(ev) / maximum(size_v, atol / rtol)
            rx = simd.absolute(ex) * h / maximum(size_x, atol / rtol)
            worst, lost = maximum(worst, maximum(rx * h, rv * h)), lost + 0.0 * (rx + rv)
        else:
            wx, wv = h * h / fma(rtol, size_x, atol), h / fma(rtol, size_v, atol)
            e5 = e5 + _squared(at, tableau, k, E5, 0, i, wx, wv)
            e3 = e3 + _squared(at, tableau, k, E3, 0, i, wx, wv)
            other = other + _squared(at, tableau, k, OTHER_E5, 0, i, wx, wv)
    if method.is_ode45:
        # `maximum` hides a NaN in its first argument; the sum does not.
        return worst / rtol + lost
    return _joint(at, e5, e3, other) + 0.0 * e5


@inlined
def _joint(at, e5, e3, other):
    """Error of order 8 over tolerance, from the squared error estimates of order 5 and 3.

    The estimate of order 5 may vanish in steps that are much too long. The other one of order 5
    seldom vanishes in the same steps (docs/decisions/0025-estimates-that-pass-zero.md).
    """
    e5 = maximum(e5, other)
    return e5 / simd.sqrt(maximum(float(at.n_states) * fma(0.01, e3, e5), 1e-300))


@inlined
def _missed(at, tableau, k, formula, first, i):
    """Error estimates of displacement i over h squared, and of its velocity over h.

    They follow from the derivatives in rows of `k` from `first` on. A first-order state (i >= n)
    has only the second one.
    """
    ex, ev = simd.splat(0.0), simd.splat(0.0)
    for j in range(tableau.n_stages):
        k_j = load(k, first + j * at.n_rates + i)
        ev = fma(k_j, tableau.e[formula, j], ev)
        if i < at.n:
            ex = fma(k_j, tableau.ebar[formula, j], ex)
    return ex, ev


@inlined
def _squared(at, tableau, k, formula, first, i, wx, wv):
    """Sum of the squares of both errors of `_missed`, multiplied by the weights `wx` and `wv`."""
    ex, ev = _missed(at, tableau, k, formula, first, i)
    rx, rv = ex * wx, ev * wv
    return fma(rx, rx, rv * rv)


@inlined
def _tangent_error(at, method, lane, h, rtol):
    """Error estimate of the tangent over its tolerance: the largest over the tangent's columns.

    Each column has its own scale. A tangent still oscillates when its motion has come to rest
    against a wall; too long steps would damp it. An overflowed column counts as zero error.
    """
    tableau, k = method.tableau, method.k_tangent
    tol, worst = max(rtol, TANGENT_RTOL), simd.splat(0.0)
    for column in range(at.n_states):
        before = at.tangent_state + column * at.n_states
        after = at.tangent_1 + column * at.n_states
        first, largest = column * tableau.c.size * at.n_rates, simd.splat(1e-300)
        for i in range(at.n):
            largest = maximum(largest, _tangent_size(at, lane, before, after, i, h))
        e5, e3, other = simd.splat(0.0), simd.splat(0.0), simd.splat(0.0)
        for i in range(at.n_rates):
            if i < at.n:
                size = fma(FAINT, largest, _tangent_size(at, lane, before, after, i, h))
                w = h * h / (tol * size)
            else:
                w = h / (tol * maximum(_size(lane, before + at.n + i, after + at.n + i), 1e-300))
            e5 = e5 + _squared(at, tableau, k, E5, first, i, w, w)
            e3 = e3 + _squared(at, tableau, k, E3, first, i, w, w)
            other = other + _squared(at, tableau, k, OTHER_E5, first, i, w, w)
        error = simd.sqrt(e5) if method.is_ode45 else _joint(at, e5, e3, other)
        worst = maximum(worst, select(error < 1e300, error, 0.0))
    return worst


@inlined
def _tangent_size(at, lane, before, after, i, h):
    """Scale of coordinate i of a column: displacement plus h times velocity; either may be 0."""
    return fma(
        h, _size(lane, before + at.n + i, after + at.n + i), _size(lane, before + i, after + i)
    )


@inlined
def _size(lane, before, after):
    return maximum(simd.absolute(load(lane, before)), simd.absolute(load(lane, after)))


@inlined
def _next_step(method, error, h, after_failure, accepted):
    """Next step size of the controller [s]."""
    scaled = simd.power(maximum(error, 1e-16), -method.tableau.exponent)
    if method.is_ode45:
        grown = select(after_failure, h, h * minimum(0.8 * scaled, 5.0))
        shrunk = select(after_failure, 0.5 * h, h * maximum(0.8 * scaled, 0.1))
        # A NaN error: ode45 would end in NaN; here the step is halved until it underflows.
        return select(accepted, grown, select(error > 1.0, shrunk, 0.5 * h))
    factor = minimum(
        maximum(SAFETY * scaled, SHRINK_LIMIT), select(after_failure, simd.splat(1.0), GROW_LIMIT)
    )
    return h * select(accepted | (error > 1.0), factor, SHRINK_LIMIT)


@inlined
def ends(at, which):
    """Rows of displacement, velocity and acceleration of a coordinate or gap, at both step ends."""
    if which < at.n:
        return (
            at.q + which,
            at.v + which,
            at.a + which,
            at.q_1 + which,
            at.v_1 + which,
            at.a_1 + which,
        )
    old, new, k = at.gap_0 + which - at.n, at.gap_1 + which - at.n, at.contacts
    return old, old + k, old + 2 * k, new, new + k, new + 2 * k


@inlined
def _gap(at, contact):
    """Number of a contact's gap among coordinates and gaps; 0, the coordinate, of an oscillator."""
    return contact if at.is_plain else at.n + contact


class _Hull(NamedTuple):
    """A coordinate or a gap over a step: bounds, ends, inner Bernstein coefficients of its quintic
    interpolant, and whether it may turn back.
    """

    low: Any
    high: Any
    x: Any
    x_1: Any
    v_1: Any
    a_1: Any
    inner: Any
    turns_back: Any


@inlined
def _hull(at, lane, which, h):
    # Quintic Hermite interpolant in Bernstein form: its coefficients bound x, their differences v.
    # Accelerations enter with h^2, so the interpolant costs nothing beyond the step itself.
    rows = ends(at, which)
    x, v, a = load(lane, rows[0]), load(lane, rows[1]), load(lane, rows[2])
    x1, v1, a1 = load(lane, rows[3]), load(lane, rows[4]), load(lane, rows[5])
    b1, b4 = fma(0.2 * h, v, x), fma(-0.2 * h, v1, x1)
    b2 = fma(0.05 * h * h, a, fma(0.4 * h, v, x))
    b3 = fma(0.05 * h * h, a1, fma(-0.4 * h, v1, x1))
    low = minimum(minimum(minimum(x, x1), minimum(b1, b4)), minimum(b2, b3))
    high = maximum(maximum(maximum(x, x1), maximum(b1, b4)), maximum(b2, b3))
    rise = minimum(minimum(v, v1), minimum(minimum(b2 - b1, b4 - b3), b3 - b2))
    fall = maximum(maximum(v, v1), maximum(maximum(b2 - b1, b4 - b3), b3 - b2))
    return _Hull(low, high, x, x1, v1, a1, (b1, b2, b3, b4), (rise <= 0.0) & (fall >= 0.0))


@inlined
def _horner(c, s):
    c0, c1, c2, c3, c4, c5 = c
    return fma(fma(fma(fma(fma(c5, s, c4), s, c3), s, c2), s, c1), s, c0)


@inlined
def _first_beyond(hull, target, at_end):
    """Fraction of the step after which its interpolant is first beyond a target; above 1: never.

    A bracket is searched at the end of steps that end beyond it (`at_end`), and at eighths of steps
    that do so or may turn back; the rule of false position refines it.
    """
    b1, b2, b3, b4 = hull.inner
    c0, c1, c2 = hull.x - target, 5.0 * (b1 - hull.x), 10.0 * (b2 - 2.0 * b1 + hull.x)
    c3 = 10.0 * (b3 - 3.0 * (b2 - b1) - hull.x)
    c4 = 5.0 * (b4 - 4.0 * (b3 + b1) + 6.0 * b2 + hull.x)
    c5 = hull.x_1 - hull.x - 5.0 * (b4 - b1) + 10.0 * (b3 - b2)
    c = c0, c1, c2, c3, c4, c5
    last = select(at_end, simd.splat(1.0), 2.0)
    for i in range(7, 0, -1):
        s = simd.splat(0.125 * i)
        is_beyond = (at_end | hull.turns_back) & (_horner(c, s) * c0 <= 0.0)
        last = select(is_beyond, s, last)
    is_met, first = last <= 1.0, last - 0.125
    before, beyond = _horner(c, first), _horner(c, last)
    for _ in range(2):
        s = first + (last - first) * (before / (before - beyond))
        value = _horner(c, s)
        is_before = value * c0 > 0.0
        first, before = select(is_before, s, first), select(is_before, value, before)
        last, beyond = select(is_before, last, s), select(is_before, beyond, value)
    return select(is_met, first + (last - first) * (before / (before - beyond)), 2.0)


class _LayerCheck(NamedTuple):
    """Limits of a step due to smoothing layers."""

    cut: Any  # the step jumps over a layer and has to be repeated
    part: Any  # up to this fraction of it
    leaves: Any  # the step leaves a layer
    limit: Any  # longest next step inside a layer [s]; infinity outside


@inlined
def _layers(q, hull, v, accepted, before):
    """Keep steps from jumping over a thin layer.

    A step that starts outside a layer, enters it and moves farther than the layer's half-width is
    repeated up to the layer's edge. Inside, at least four steps are taken per passage, and on
    leaving the step goes back to its length before the layer.
    """
    half = load(q, parameters.LAYER)
    low, high = load(q, parameters.WALL_LOW), load(q, parameters.WALL_HIGH)
    has_one = half > 0.0
    starts_inside = (simd.absolute(hull.x - low) <= half) | (simd.absolute(hull.x - high) <= half)
    ends_inside = (simd.absolute(hull.x_1 - low) <= half) | (simd.absolute(hull.x_1 - high) <= half)
    at_low = (hull.high > low - half) & (hull.low < low + half)
    at_high = (hull.high > high - half) & (hull.low < high + half)
    cut = accepted & ~starts_inside & (hull.high - hull.low > half) & (at_low | at_high) & has_one
    part = before.part
    if simd.bits(cut) != 0:
        # Slightly inside of the edge that is met first.
        to_high = (hull.x > high) | ((hull.x > low) & at_high & ~(at_low & (v < 0.0)))
        wall = select(to_high, high, low)
        side = simd.copysign(simd.splat(1.0), hull.x - wall)
        is_deep = (hull.x_1 - wall) * side < 0.8 * half
        where = _first_beyond(hull, wall + side * (0.95 * half), is_deep)
        cut = cut & (where <= 1.0)
        part = select(cut, minimum(part, where), part)
    limit = half / maximum(2.0 * simd.absolute(hull.v_1), 1e-300)
    limit = minimum(limit, simd.sqrt(half / maximum(2.0 * simd.absolute(hull.a_1), 1e-300)))
    limit = select(ends_inside & has_one, minimum(before.limit, limit), before.limit)
    leaves = accepted & starts_inside & ~ends_inside & has_one
    return _LayerCheck(before.cut | cut, part, before.leaves | leaves, limit)


@inlined
def _passings(q, x, x_1):
    """Number of walls between both ends of the step, as a float vector."""
    total = simd.splat(0.0)
    for row in (parameters.WALL_LOW, parameters.WALL_HIGH):
        wall, sign = load(q, row), -1.0 if row == parameters.WALL_LOW else 1.0
        was, is_ = sign * (x - wall) > 0.0, sign * (x_1 - wall) > 0.0
        total = total + select((was & ~is_) | (~was & is_), simd.splat(1.0), 0.0)
    return total


class _Contacts(NamedTuple):
    """Lanes whose step needs attention because of contacts, and limits due to layers."""

    turns_back: Any  # a gap may turn back
    miscounted: (
        Any  # ... and its ends do not show how often it has passed a wall, or left a fit's range
    )
    leaves_mode: Any  # a located contact may leave its mode
    layers: Any


@inlined
def _contacts(at, method, q, lane, accepted, h):
    """Check the gaps of all contacts over the step."""
    none = accepted & (h < 0.0)
    turns_back, miscounted, leaves_mode = none, none, none
    layers = _LayerCheck(none, simd.splat(1.0), none, simd.splat(np.inf))
    for i in range(at.contacts):
        q_i, hull = q[i], _hull(at, lane, _gap(at, i), h)
        low, high = load(lane, at.lower + i), load(lane, at.upper + i)
        turns_back = turns_back | hull.turns_back
        if at.is_located:
            mode = load(lane, at.mode + i)
            over_high = (hull.high > high) & (mode <= 0.0)
            under_low = (hull.low < low) & (mode >= 0.0)
            back = ((mode > 0.0) & (hull.low < high)) | ((mode < 0.0) & (hull.high > low))
            leaves_mode = leaves_mode | over_high | under_low | back
        else:
            dips = ((hull.low <= high) & (hull.high > high)) | (
                (hull.low < low) & (hull.high >= low)
            )
            if method.has_range:
                centre, reach = load(q_i, parameters.CENTRE), load(q_i, parameters.RANGE)
                leaves = (hull.high - centre > reach) | (hull.low - centre < -reach)
                dips = dips | (leaves & (reach > 0.0))
            miscounted = miscounted | (hull.turns_back & dips)
            if method.cuts_at_layers:
                v = load(lane, ends(at, _gap(at, i))[1])
                layers = _layers(q_i, hull, v, accepted, layers)
    return _Contacts(turns_back, miscounted, leaves_mode, layers)


@inlined
def _count_passings(at, method, q, lane, commit):
    """Count the walls between the ends of committed steps; return the lanes that passed any."""
    total = simd.splat(0.0)
    for i in range(at.contacts):
        rows, q_i = ends(at, _gap(at, i)), q[i]
        x, x_1 = load(lane, rows[0]), load(lane, rows[3])
        total = total + _passings(q_i, x, x_1)
        if method.has_range:
            centre, reach = load(q_i, parameters.CENTRE), load(q_i, parameters.RANGE)
            is_out = commit & (simd.absolute(x_1 - centre) > reach) & (reach > 0.0)
            store(lane, at.out_of_range, select(is_out, 1.0, load(lane, at.out_of_range)))
    total = select(commit, total, 0.0)
    store(lane, at.n_contacts, load(lane, at.n_contacts) + total)
    return total > 0.0


@inlined
def _take_back_starts(at, q, lane, starts):
    """Subtract the crossing that an initial state on a wall, heading outwards, will count."""
    for i in range(at.contacts):
        rows, q_i = ends(at, _gap(at, i)), q[i]
        x, v, a = load(lane, rows[0]), load(lane, rows[1]), load(lane, rows[5])
        heading = select((v > 0.0) | (v < 0.0), v, a)
        over_high = (x == load(q_i, parameters.WALL_HIGH)) & (heading > 0.0)
        over_low = (x == load(q_i, parameters.WALL_LOW)) & (heading < 0.0)
        count = load(lane, at.n_contacts) - select(starts & over_high, simd.splat(1.0), 0.0)
        store(lane, at.n_contacts, count - select(starts & over_low, simd.splat(1.0), 0.0))


@inlined
def _may_turn(at, lane, h, found):
    """Lanes whose step may have an extremum of a coordinate, or of a gap (those in `found`)."""
    if not at.is_plain:
        for i in range(at.n):
            found = found | _hull(at, lane, i, h).turns_back
    return found


@inlined
def _is_within(at, lane, first, bound):
    """Lanes whose coordinates, in rows from `first` on, have moduli up to `bound`."""
    within = simd.absolute(load(lane, first)) <= bound
    for i in range(1, at.n):
        within = within & (simd.absolute(load(lane, first + i)) <= bound)
    return within


@inlined
def _has_pole(at, method, q, lane, none):
    """Lanes whose step ends beyond a pole of a fit."""
    if method.has_range:
        for i in range(at.contacts):
            store(lane, at.stage_gap + i, load(lane, ends(at, _gap(at, i))[3]))
        laws.denominators(method.kinds, q, lane, at.stage_gap, at.force)
        for i in range(at.contacts):
            none = none | (load(lane, at.force + i) <= 0.0)
    return none


@inlined
def _begin(at, method, lane, rtol, left):
    """Step size after the derivative was evaluated: initially by ode45's rule, from y and y';
    at a wall the previous step size, or the same rule if the method restarts.
    """
    threshold, rate = load(lane, at.atol) / rtol, simd.splat(0.0)
    chosen = load(lane, at.is_fresh) >= (AT_WALL if method.restarts else AT_START)
    for j in range(at.n_states):
        # Derivatives of the state: speeds, accelerations, rates of first-order states.
        slope = load(lane, at.v + j if j < at.n else at.a_1 + j - at.n)
        size = maximum(simd.absolute(load(lane, at.q + j)), threshold)
        rate = maximum(rate, simd.absolute(slope) / size)
    rate = rate / (0.8 * rtol**method.tableau.exponent)
    longest = load(lane, at.h_max)
    if method.is_ode45:
        longest = select(chosen, minimum(longest, 0.1 * left), longest)
        store(lane, at.h_max, longest)
    h = minimum(longest, left)
    h = select(h * rate > 1.0, 1.0 / rate, h)
    return select(chosen, h, load(lane, at.h))


@inlined
def _commit(at, method, lane, commit, fresh):
    """Move committed lanes to the end of the step."""
    for i in range(at.n_states):
        store(lane, at.q + i, select(commit, load(lane, at.q_1 + i), load(lane, at.q + i)))
    has_rates = commit | fresh
    for i in range(at.n_rates):
        store(lane, at.a + i, select(has_rates, load(lane, at.a_1 + i), load(lane, at.a + i)))
    for i in range(at.n):
        reach = load(lane, at.reach + i)
        farther = maximum(reach, simd.absolute(load(lane, at.q_1 + i)))
        store(lane, at.reach + i, select(commit, farther, reach))
    if at.is_located and not at.is_plain:
        for i in range(at.contacts):
            low, high = laws.interval(at, lane, load(lane, at.mode + i), i)
            gap = minimum(maximum(load(lane, at.gap_1 + i), low), high)
            store(lane, at.gap + i, select(commit, gap, load(lane, at.gap + i)))
    if method.tangent:
        for i in range(at.n_states * at.n_states):
            after = load(lane, at.tangent_1 + i)
            after = select(simd.absolute(after) < VANISHED, 0.0 * after, after)
            store(
                lane,
                at.tangent_state + i,
                select(commit, after, load(lane, at.tangent_state + i)),
            )


@inlined
def _add(lane, row, lanes):
    """Add 1 to a row of counts in the lanes of a mask."""
    store(lane, row, load(lane, row) + select(lanes, simd.splat(1.0), 0.0))


@internal
def _polynomials(at, method, q, lane, coefficients, h):
    """Compute the step's polynomials of coordinates, first-order states, gaps and tangents."""
    tableau, row = method.tableau, at.n_series * at.n_terms
    for stage in range(tableau.n_stages, tableau.c.size):
        stage_derivative(at, method.kinds, q, lane, tableau, method.k, h, stage)
    polynomials(at, tableau, lane, at.q, method.k, 0, h, coefficients, 0)
    if not at.is_plain:
        for i in range(at.contacts):
            for n in range(at.n_terms):
                total = simd.splat(0.0)
                for j in range(at.n):
                    of_place = load(coefficients, j * at.n_terms + n)
                    total = fma(load(lane, at.direction + i * at.n + j), of_place, total)
                store(coefficients, (at.first_gap + i) * at.n_terms + n, total)
            if at.is_located:
                store(coefficients, (at.first_gap + i) * at.n_terms, load(lane, at.gap_0 + i))
    if at.is_located and method.tangent:
        more = tableau.n_stages, tableau.c.size
        tangent_stages(at, method.kinds, q, lane, tableau, method.k, method.k_tangent, h, more)
        for column in range(at.n_states):
            state = at.tangent_state + column * at.n_states
            first = column * tableau.c.size * at.n_rates
            polynomials(at, tableau, lane, state, method.k_tangent, first, h, coefficients, row)
            row += at.n_rates * at.n_terms
        store_loss(at, method, lane, h)


@inlined
def runge_kutta_step(at, method, lane, coefficients, limits):
    """Attempt a step of every lane.

    One function, because calls would not keep the wide values of a step in registers.

    Parameters
    ----------
    at : RowLayout
        The code is specialised to it and to the types of the laws.
    method : RungeKutta
    lane : ndarray, shape (n_rows, WIDTH)
        State of the lanes, updated.
    coefficients : ndarray
        Receives the polynomials of the step if the outcome names a lane.
    limits : tuple of float
        As in `advance`.

    Returns
    -------
    StepOutcome
    """
    rtol, bound, _ = limits
    tableau, k, kinds, q = method.tableau, method.k, method.kinds, method.q
    fresh = load(lane, at.is_fresh) > 0.0
    h_wanted = select(fresh, simd.splat(0.0), load(lane, at.h))
    period, tau, cycle = load(lane, at.period), load(lane, at.tau), load(lane, at.cycle)
    left = (load(lane, at.end_cycle) - cycle) + (load(lane, at.end_tau) - tau)
    left = maximum((left - load(lane, at.tau_low)) * period, simd.splat(0.0))
    failed = load(lane, at.failed)
    stretched = h_wanted * select(failed == _CUT, simd.splat(1.0), STRETCH)
    to_end = ~fresh & (stretched >= left)
    h = select(to_end, left, h_wanted)
    if at.is_located:
        enter_modes(at, method, lane)
        laws.set_active(at, kinds, q, lane, at.mode, 0)

    stages(at, kinds, q, lane, tableau, k, h)
    error = _error(at, method, lane, h, rtol)
    if method.tangent:
        all_ = 0, tableau.n_stages
        tangent_stages(at, kinds, q, lane, tableau, k, method.k_tangent, h, all_)
        error = maximum(_tangent_error(at, method, lane, h, rtol), error)
    accepted = (error <= 1.0) & ~fresh
    h_next = _next_step(method, error, h, failed == _FAILED, accepted)
    if at.pieces:  # a step that is cut at a knot does not shorten the next one
        h_next = select(to_end & accepted, maximum(h_next, h_wanted), h_next)
    contacts = _contacts(at, method, q, lane, accepted, h)
    layers = contacts.layers
    unclear = accepted & contacts.leaves_mode
    commit = accepted & ~unclear & ~layers.cut

    turns = cycle + (tau - load(lane, at.tau_start))
    h_min = maximum(3.6e-15 * (turns * period), load(lane, at.min_step))
    within = _is_within(at, lane, at.q_1, bound)
    pole = commit & _has_pole(at, method, q, lane, fresh & ~fresh)
    bad = (~accepted & ~fresh & (h <= h_min)) | pole | (commit & ~within)
    if at.is_located:
        store(lane, at.n_short, select(commit, 0.0, load(lane, at.n_short)))

    if simd.bits(fresh) != 0:
        h_next = select(fresh, _begin(at, method, lane, rtol, left), h_next)
        for i in range(at.n_rates):
            within = within & (~fresh | (simd.absolute(load(lane, at.a_1 + i)) < np.inf))
        bad = bad | (fresh & ~within)
        if not at.is_located:
            _take_back_starts(at, q, lane, load(lane, at.is_fresh) >= AT_START)
        _add(lane, at.n_extra, fresh)
        store(lane, at.is_fresh, simd.splat(0.0))
    if method.cuts_at_layers:
        h_next = select(layers.leaves, maximum(h_next, load(lane, at.h_saved)), h_next)
        h_next = select(layers.cut, layers.part * h, minimum(h_next, layers.limit))
        store(lane, at.h_saved, select(layers.cut, h, load(lane, at.h_saved)))
    if simd.bits(bad) != 0:
        reason = select(pole, MODEL_INVALID, simd.splat(STEP_UNDERFLOW))
        reason = select(within, reason, DIVERGED)
        store(lane, at.n_short, select(bad, reason, load(lane, at.n_short)))
    store(lane, at.h, minimum(maximum(h_next, h_min), load(lane, at.h_max)))
    failed = select(accepted | fresh, simd.splat(0.0), _FAILED)
    store(lane, at.failed, select(layers.cut, _CUT, failed))

    # Clock, recording, polynomials.
    turned = fma(h, load(lane, at.omega), load(lane, at.tau_low))
    tau_1 = tau + turned
    low_1 = turned - (tau_1 - tau)
    whole = maximum(simd.floor(tau_1), simd.splat(0.0))
    ended = commit & to_end
    cycle_1 = select(ended, load(lane, at.end_cycle), cycle + whole)
    tau_1 = select(ended, load(lane, at.end_tau), tau_1 - whole)
    is_section = (cycle_1 > cycle) & (cycle_1 - load(lane, at.record_clock) >= -CLOCK_SLACK)
    is_event = cycle_1 + tau_1 - load(lane, at.event_clock) >= -CLOCK_SLACK
    passes = contacts.leaves_mode
    if not at.is_located:
        passes = _count_passings(at, method, q, lane, commit)
    eventful = unclear | _may_turn(at, lane, h, contacts.turns_back)
    if method.contacts:
        eventful = eventful | passes
    if method.dense or at.is_damped:
        eventful = commit | unclear
    recording = (commit | unclear) & (is_section | (is_event & eventful))
    miscounted = commit & contacts.miscounted
    needed = recording | unclear | miscounted
    if simd.bits(needed) != 0:
        _polynomials(at, method, q, lane, coefficients, h)
        record_forces(at, method, lane, coefficients, h, recording & is_event)
        # Right-hand sides to locate a wall count as cost of the motion, those for records do not.
        n_more = select(unclear, float(tableau.c.size - tableau.n_stages), simd.splat(0.0))
        store(lane, at.n_extra, load(lane, at.n_extra) + n_more)
        store(lane, at.step, h)
        store(lane, at.tau_0, tau)
        store(lane, at.cycle_0, cycle)
        for i in range(at.contacts):
            store(lane, at.mode_0 + i, load(lane, at.mode + i))
            store(lane, at.side + i, simd.splat(0.0))

    _commit(at, method, lane, commit, fresh)
    add_loss(at, method, lane, commit, h)
    store(lane, at.tau, select(commit, tau_1, tau))
    tau_low = load(lane, at.tau_low)
    store(lane, at.tau_low, select(commit, select(ended, 0.0 * low_1, low_1), tau_low))
    store(lane, at.cycle, select(commit, cycle_1, cycle))
    _add(lane, at.n_steps, commit)
    _add(lane, at.n_rejected, (~accepted & ~fresh) | layers.cut)
    return StepOutcome(
        simd.bits(unclear),
        simd.bits(ended),
        simd.bits(bad),
        simd.bits(recording),
        simd.bits(miscounted),
    )
