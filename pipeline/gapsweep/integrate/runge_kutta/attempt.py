"""One attempted Runge-Kutta step of all lanes: stages, error, step control, what needs attention.

Everything here is branch-free over lanes. The outcome is one word of lane bits per question
(`Outcome`); only lanes with a bit set are looked at one by one afterwards.
"""

from typing import Any, NamedTuple

import numpy as np

from gapsweep.integrate import simd
from gapsweep.integrate.jit import inlined
from gapsweep.integrate.motion import VANISHED
from gapsweep.integrate.simd import fma, load, maximum, minimum, select, store

from . import lanes as ln
from . import laws, parameters, vecmath
from .stages import stages, tangent_stages
from .tableaux import E3, E5, OTHER_E5

# Measured on the tanh law at 1e-3 to 1e-9: 0.9 and 6 reject a quarter of all attempts and cost a
# tenth more.
SAFETY = 0.75
GROW_LIMIT, SHRINK_LIMIT = 3.0, 0.2
# An attempt within 10 % of the end is stretched to it (ode45's rule, kept for both controllers).
STRETCH = 1.1
# A tangent need not be better than this; nor a coordinate of it that moves by less than this share.
TANGENT_RTOL, FAINT = 1e-8, 1e-3


class Outcome(NamedTuple):
    """Bit i of each word answers for lane i."""

    accepted: int  # the attempt met the tolerance and was committed
    ended: int  # it landed on the end of the point
    # the step is as small as it may be and still fails, or left the bounds, or ran out of attempts
    failed: int
    stopped: int  # it has to be cut at a wall or at the edge of a smoothing layer
    recorded: int  # it may hold an event to record
    dipped: int  # it turns back near a wall or the edge of a fit's range: look at its pieces


@inlined
def _error(at, tableau, lane, k, settings, h):
    """Error estimate over tolerance; up to 1: accepted. Largest for ode45, else mean square."""
    rtol, atol = settings.rtol, settings.atol
    worst, lost = simd.splat(0.0), simd.splat(0.0)
    e5, e3, other = simd.splat(0.0), simd.splat(0.0), simd.splat(0.0)
    for i in range(at.n_rates):
        size_v = _size(lane, at.old_v + i, at.v_1 + i)  # first-order states stand after the speeds
        size_x = _size(lane, at.old_q + i, at.q_1 + i) if i < at.n else size_v
        if settings.is_ode45:
            ex, ev = _missed(at, tableau, k, E5, 0, i)
            rv = simd.absolute(ev) / maximum(size_v, atol / rtol)
            rx = simd.absolute(ex) * h / maximum(size_x, atol / rtol)
            worst, lost = maximum(worst, maximum(rx * h, rv * h)), lost + 0.0 * (rx + rv)
        else:
            wx, wv = h * h / fma(rtol, size_x, atol), h / fma(rtol, size_v, atol)
            e5 = e5 + _squared(at, tableau, k, E5, 0, i, wx, wv)
            e3 = e3 + _squared(at, tableau, k, E3, 0, i, wx, wv)
            other = other + _squared(at, tableau, k, OTHER_E5, 0, i, wx, wv)
    if settings.is_ode45:
        # `maximum` hides a NaN in its first argument; the sum does not.
        return worst / rtol + lost
    return _joint(at, e5, e3, other) + 0.0 * e5


@inlined
def _joint(at, e5, e3, other):
    """Error of order 8 over tolerance, from the squares of what formulas of order 5 and 3 miss.

    The former passes zero in steps that are much too long. The other formula of order 5 seldom does
    so in the same ones (docs/decisions/0025-estimates-that-pass-zero.md).
    """
    e5 = maximum(e5, other)
    return e5 / simd.sqrt(maximum(float(at.n_states) * fma(0.01, e3, e5), 1e-300))


@inlined
def _missed(at, tableau, k, formula, first, i):
    """What a formula of the tableau misses of place i, over h squared, and of its rate, over h.

    Of the derivatives in rows of `k` from `first` on. What is no speed has no place: zero.
    """
    ex, ev = simd.splat(0.0), simd.splat(0.0)
    for j in range(tableau.c.size):
        k_j = load(k, first + j * at.n_rates + i)
        ev = fma(k_j, tableau.e[formula, j], ev)
        if i < at.n:
            ex = fma(k_j, tableau.ebar[formula, j], ex)
    return ex, ev


@inlined
def _squared(at, tableau, k, formula, first, i, wx, wv):
    """Squares of what `_missed` tells, of place and rate in units of these weights, added."""
    ex, ev = _missed(at, tableau, k, formula, first, i)
    rx, rv = ex * wx, ev * wv
    return fma(rx, rx, rv * rv)


@inlined
def _tangent_error(at, tableau, lane, k, settings, h):
    """The same of the tangent's columns: the largest of them, each beside its own size.

    A tangent swings on where its motion has come to rest against a wall, and is damped by steps
    that are too long for it. Zero where it has overflowed: that is no fault of the motion.
    """
    tol, worst = max(settings.rtol, TANGENT_RTOL), simd.splat(0.0)
    for column in range(at.n_states):
        before = at.tangent_state + column * at.n_states
        after = at.old_tangent + column * at.n_states
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
        error = simd.sqrt(e5) if settings.is_ode45 else _joint(at, e5, e3, other)
        worst = maximum(worst, select(error < 1e300, error, 0.0))
    return worst


@inlined
def _tangent_size(at, lane, before, after, i, h):
    """How far a column leads in a step: the place alone may be passing zero."""
    return fma(
        h, _size(lane, before + at.n + i, after + at.n + i), _size(lane, before + i, after + i)
    )


@inlined
def _size(lane, before, after):
    return maximum(simd.absolute(load(lane, before)), simd.absolute(load(lane, after)))


@inlined
def _next_step(settings, error, h, after_failure, accepted):
    """The controller's next step length."""
    scaled = vecmath.power(maximum(error, 1e-16), -settings.exponent)
    if settings.is_ode45:
        grown = select(after_failure, h, h * minimum(0.8 * scaled, 5.0))
        shrunk = select(after_failure, 0.5 * h, h * maximum(0.8 * scaled, 0.1))
        # A NaN error: ode45 would end in NaN; here the step is halved until it underflows.
        return select(accepted, grown, select(error > 1.0, shrunk, 0.5 * h))
    factor = minimum(
        maximum(SAFETY * scaled, SHRINK_LIMIT), select(after_failure, simd.splat(1.0), GROW_LIMIT)
    )
    return h * select(accepted | (error > 1.0), factor, SHRINK_LIMIT)


@inlined
def _passed(before, after, wall):
    return ((before > wall) & ~(after > wall)) | (~(before > wall) & (after > wall))


@inlined
def _wall_passings(x, x1, low, high):
    """How many walls lie between the two ends, as a float vector."""
    at_high = select(_passed(x, x1, high), simd.splat(1.0), 0.0)
    return at_high + select(_passed(-x, -x1, -low), simd.splat(1.0), 0.0)


@inlined
def _keep_start(at, lane, h):
    for i in range(at.n_start - 1):
        store(lane, at.old_q + i, load(lane, at.q + i))
    store(lane, at.old_h, h)


@inlined
def clock(at, lane, h):
    """Phase, the digits that its sum loses, and whole turns, h after the start of an attempt.

    The clock counts turns of the forcing: the phase stays in [0, 1) however long the run is. What
    the sum's rounding cuts off is kept (Kahan): many short steps of a long period lose nothing.
    """
    tau = load(lane, at.tau)
    turned = fma(h, load(lane, at.omega), load(lane, at.tau_low))
    tau_1 = tau + turned
    # A landing rounded up to a whole turn is past it: what it owes takes it below, but not back.
    whole = maximum(simd.floor(tau_1), simd.splat(0.0))
    return tau_1 - whole, turned - (tau_1 - tau), load(lane, at.turns) + whole


@inlined
def _commit(at, lane, commit, moved, ended, h):
    """Move committed lanes to the end of the step; returns which of them passed a whole turn.

    `moved`: those of them whose end is the motion's, whether or not the step is cut.
    """
    for i in range(at.n_states + at.n_rates):
        store(lane, at.q + i, select(commit, load(lane, at.q_1 + i), load(lane, at.q + i)))
    for i in range(at.n):
        reach = load(lane, at.reach + i)
        farther = maximum(reach, simd.absolute(load(lane, at.q_1 + i)))
        store(lane, at.reach + i, select(moved, farther, reach))
    tau, tau_low, turns = load(lane, at.tau), load(lane, at.tau_low), load(lane, at.turns)
    tau_1, low_1, turns_1 = clock(at, lane, h)
    tau_1 = select(ended, load(lane, at.end_tau), tau_1)
    turns_1 = select(ended, load(lane, at.end_turns), turns_1)
    store(lane, at.tau, select(commit, tau_1, tau))
    store(lane, at.tau_low, select(commit, select(ended, 0.0, low_1), tau_low))
    store(lane, at.turns, select(commit, turns_1, turns))
    return commit & (turns_1 > turns)


@inlined
def _commit_tangent(at, lane, commit):
    for i in range(at.n_states * at.n_states):
        before, after = load(lane, at.tangent_state + i), load(lane, at.old_tangent + i)
        store(lane, at.old_tangent + i, before)
        after = select(simd.absolute(after) < VANISHED, 0.0 * after, after)
        store(lane, at.tangent_state + i, select(commit, after, before))


@inlined
def _count(at, lane, commit, rejected):
    store(lane, at.n_attempts, load(lane, at.n_attempts) + 1.0)
    store(lane, at.n_steps, load(lane, at.n_steps) + select(commit, simd.splat(1.0), 0.0))
    store(lane, at.n_rejected, load(lane, at.n_rejected) + select(rejected, simd.splat(1.0), 0.0))


class _Hull(NamedTuple):
    """Bounds of a coordinate or a gap over a step, both ends, and whether it may turn back."""

    low: Any
    high: Any
    x: Any
    x_1: Any
    v_1: Any
    turns_back: Any


@inlined
def _hull(at, lane, which, h):
    # Quintic Hermite interpolant in Bernstein form: its coefficients bound x, their differences v.
    # Accelerations enter with h^2, so the interpolant costs nothing beyond the step itself.
    rows = ln.ends(at, which)
    x, v, a = load(lane, rows[0]), load(lane, rows[1]), load(lane, rows[2])
    x1, v1, a1 = load(lane, rows[3]), load(lane, rows[4]), load(lane, rows[5])
    b1, b4 = fma(0.2 * h, v, x), fma(-0.2 * h, v1, x1)
    b2 = fma(0.05 * h * h, a, fma(0.4 * h, v, x))
    b3 = fma(0.05 * h * h, a1, fma(-0.4 * h, v1, x1))
    low = minimum(minimum(minimum(x, x1), minimum(b1, b4)), minimum(b2, b3))
    high = maximum(maximum(maximum(x, x1), maximum(b1, b4)), maximum(b2, b3))
    rise = minimum(minimum(v, v1), minimum(minimum(b2 - b1, b4 - b3), b3 - b2))
    fall = maximum(maximum(v, v1), maximum(maximum(b2 - b1, b4 - b3), b3 - b2))
    return _Hull(low, high, x, x1, v1, (rise <= 0.0) & (fall >= 0.0))


class _Layers(NamedTuple):
    """What smoothing layers ask of a step."""

    cut: Any  # it has to be cut at one
    leaves: Any  # it leaves one
    limit: Any  # longest next step inside one [s]; infinity outside


@inlined
def _layers(q, hull, commit, ordinary, before):
    """Keep steps from jumping over a thin layer.

    A step that starts outside a layer, whose hull reaches it, and that moves farther than the
    layer's half-width is cut at the layer's edge. Inside, at least four steps are taken per
    passage, and on leaving the step goes back to its length before the layer.
    """
    half = load(q, parameters.LAYER)
    low, high = load(q, parameters.WALL_LOW), load(q, parameters.WALL_HIGH)
    has_one = half > 0.0
    starts_inside = (simd.absolute(hull.x - low) <= half) | (simd.absolute(hull.x - high) <= half)
    ends_inside = (simd.absolute(hull.x_1 - low) <= half) | (simd.absolute(hull.x_1 - high) <= half)
    reaches = ((hull.high > low - half) & (hull.low < low + half)) | (
        (hull.high > high - half) & (hull.low < high + half)
    )
    cut = commit & ordinary & ~starts_inside & reaches & (hull.high - hull.low > half) & has_one
    limit = half / maximum(2.0 * simd.absolute(hull.v_1), 1e-300)
    limit = select(ends_inside & has_one, minimum(before.limit, limit), before.limit)
    leaves = commit & starts_inside & ~ends_inside & has_one
    return _Layers(before.cut | cut, before.leaves | leaves, limit)


@inlined
def _leaves_mode(q, hull):
    """Whether the step's hull leaves the region of the present contact mode."""
    in_gap = load(q, parameters.ACTIVE_MODE) == 0.0
    low, high, wall = (
        load(q, parameters.WALL_LOW),
        load(q, parameters.WALL_HIGH),
        load(q, parameters.ACTIVE_WALL),
    )
    out_of_gap = (hull.high > high) | (hull.low < low)
    at_high = wall == high
    back = select(at_high, hull.low, -hull.high) < select(at_high, wall, -wall)
    return (in_gap & out_of_gap) | (~in_gap & back)


class _Walls(NamedTuple):
    """What contacts ask of a step: masks, and the next step [s]."""

    turns_back: Any
    dipped: Any
    stopped: Any
    passes: Any
    h_next: Any


@inlined
def _walls(at, q, lane, settings, commit, ordinary, h, h_next):
    """Look at the gap of every contact; counts what walls are passed."""
    none = ordinary & (h < 0.0)
    turns_back, dipped, stopped, passes = none, none, none, none
    layers = _Layers(none, none, simd.splat(np.inf))
    for i in range(at.contacts):
        q_i, hull = q[i], _hull(at, lane, at.gaps_from + i, h)
        low, high = load(q_i, parameters.WALL_LOW), load(q_i, parameters.WALL_HIGH)
        turns_back = turns_back | hull.turns_back
        # Where the motion turns back, its ends do not tell how often it has passed a wall.
        dips = ((hull.low <= high) & (hull.high > high)) | ((hull.low < low) & (hull.high >= low))
        if settings.has_range:
            centre, reach = load(q_i, parameters.CENTRE), load(q_i, parameters.RANGE)
            has_one = reach > 0.0
            out = commit & (simd.absolute(hull.x_1 - centre) > reach) & has_one
            store(lane, at.out_of_range, select(out, 1.0, load(lane, at.out_of_range)))
            dips = dips | (((hull.high - centre > reach) | (hull.low - centre < -reach)) & has_one)
        if settings.cuts_at_layers:
            layers = _layers(q_i, hull, commit, ordinary, layers)
        if settings.is_located:
            # Passings are counted where the step is cut: x is exactly on the wall there.
            stopped = stopped | (commit & ordinary & _leaves_mode(q_i, hull))
        else:
            dipped = dipped | (commit & hull.turns_back & dips)
            passings = _wall_passings(hull.x, hull.x_1, low, high)
            passes = passes | (passings > 0.0)
            count = load(lane, at.n_contacts + i)
            store(lane, at.n_contacts + i, count + select(commit, passings, 0.0))
    if settings.cuts_at_layers:
        back = select(layers.leaves, maximum(h_next, load(lane, at.h_saved)), h_next)
        h_next, stopped = minimum(back, layers.limit), layers.cut
    return _Walls(turns_back, dipped, stopped, passes, h_next)


@inlined
def _may_turn(at, lane, h, found):
    """Lanes where an extremum of a coordinate may lie in the step, or of a gap as `found`."""
    if not at.is_plain:
        for i in range(at.n):
            found = found | _hull(at, lane, i, h).turns_back
    return found


@inlined
def _is_invalid(at, kinds, q, lane, settings):
    """Lanes whose attempt ends where no motion is."""
    invalid = simd.absolute(load(lane, at.q_1)) > settings.bound
    for i in range(1, at.n):
        invalid = invalid | (simd.absolute(load(lane, at.q_1 + i)) > settings.bound)
    if settings.has_range:
        for i in range(at.contacts):
            store(lane, at.gap + i, load(lane, ln.ends(at, at.gaps_from + i)[3]))
        laws.denominators(kinds, q, lane, at.gap, at.force)
        for i in range(at.contacts):
            invalid = invalid | (load(lane, at.force + i) <= 0.0)
    return invalid


@inlined
def attempt(at, kinds, q, lane, tableau, k, k_tangent, settings):
    """Advance every lane by one attempt.

    One function: what a step decides, with wide values in registers that no call would keep there.

    Parameters
    ----------
    at : Rows
        With the types of the laws it decides the specialisation.
    kinds : tuple of named tuples of `laws`
        The law of every contact.
    q, lane : ndarray, shapes (n_contacts, N_PARAMETERS, WIDTH) and (n_rows, WIDTH)
        Law parameters and lane state; `lane` is updated.
    tableau : Tableau
    k, k_tangent : ndarray, shapes (n_stages * n_rates, WIDTH) and (n_states times that, WIDTH)
        Work space.
    settings : Settings

    Returns
    -------
    Outcome
    """
    exact = load(lane, at.exact)
    probing, ordinary = exact == 1.0, exact == 0.0
    h_asked = load(lane, at.h)
    left = (load(lane, at.end_turns) - load(lane, at.turns)) + (
        load(lane, at.end_tau) - load(lane, at.tau)
    )
    # a landing's rounding may pass the end
    left = maximum((left - load(lane, at.tau_low)) * load(lane, at.period), simd.splat(0.0))
    to_end = ordinary & (h_asked * STRETCH >= left)
    h = select(to_end, left, h_asked)

    _keep_start(at, lane, h)
    stages(at, kinds, q, lane, tableau, k, h)
    error = _error(at, tableau, lane, k, settings, h)
    if settings.tangent:
        tangent_stages(at, kinds, q, lane, tableau, k, k_tangent, h)
        error = maximum(_tangent_error(at, tableau, lane, k_tangent, settings, h), error)
    # A landing repeats an accepted step in part; its error is smaller and must not be judged anew.
    accepted = (error <= 1.0) | ((exact == 2.0) & (error < 1e300))
    commit = accepted & ~probing
    after_failure = load(lane, at.failed) > 0.0
    h_next = _next_step(settings, error, h, after_failure, accepted)
    walls = _walls(at, q, lane, settings, commit, ordinary, h, h_next)
    stopped, moved = walls.stopped, commit
    if settings.is_located:
        stopped = stopped | (commit & (exact == 2.0))
        moved = commit & ~stopped  # the contact mode ends before the step does

    turns = load(lane, at.turns) + (load(lane, at.tau) - load(lane, at.phase_0))
    since_start = turns * load(lane, at.period)
    h_min = maximum(3.6e-15 * since_start, load(lane, at.h_min))
    underflow = ~accepted & ~probing & (h <= h_min)
    exhausted = load(lane, at.n_attempts) >= settings.max_attempts
    failed = underflow | exhausted | (commit & _is_invalid(at, kinds, q, lane, settings))

    ended = commit & to_end
    passed_turn = _commit(at, lane, commit, moved, ended, h)
    if settings.tangent:
        _commit_tangent(at, lane, commit)
    h_next = minimum(maximum(walls.h_next, h_min), load(lane, at.h_max))
    store(lane, at.h, select(probing, h_asked, h_next))
    has_failed = select(accepted, simd.splat(0.0), 1.0)
    store(lane, at.failed, select(probing, load(lane, at.failed), has_failed))
    store(lane, at.exact, select(probing, exact, 0.0))
    _count(at, lane, commit, ~accepted & ~probing)

    recording = commit & (load(lane, at.turns) + load(lane, at.tau) >= load(lane, at.record_turns))
    eventful = commit
    if not settings.dense:
        eventful = passed_turn
        if not settings.section_only:
            eventful = passed_turn | _may_turn(at, lane, h, walls.turns_back)
        elif at.is_free:
            eventful = _hull(at, lane, 0, h).turns_back
        if settings.contacts:
            eventful = eventful | walls.passes
    return Outcome(
        simd.bits(commit),
        simd.bits(ended),
        simd.bits(failed),
        simd.bits(stopped),
        simd.bits(recording & eventful),
        simd.bits(walls.dipped),
    )
