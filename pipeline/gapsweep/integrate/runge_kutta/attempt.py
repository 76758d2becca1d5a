"""One attempted Runge-Kutta step of all lanes: stages, error, step control, and what needs
attention.

Everything here is branch-free over lanes. The outcome is one word of lane bits per question
(`Outcome`); only lanes with a bit set are looked at one by one afterwards.
"""

from typing import NamedTuple

from numba import njit

from gapsweep.integrate import simd
from gapsweep.integrate.simd import fma, load, maximum, minimum, select, store

from . import lanes as ln
from . import laws, vecmath

# Measured on the tanh law at 1e-3 to 1e-9: 0.9 and 6 reject a quarter of all attempts and cost a
# tenth more.
SAFETY = 0.75
GROW_LIMIT, SHRINK_LIMIT = 3.0, 0.2
# An attempt within 10 % of the end is stretched to it (ode45's rule, kept for both controllers).
STRETCH = 1.1


class Outcome(NamedTuple):
    """Bit i of each word answers for lane i."""

    accepted: int  # the attempt met the tolerance and was committed
    ended: int  # it landed on the end of the point
    # the step is as small as it may be and still fails, or left the bounds, or ran out of attempts
    failed: int
    stopped: int  # it has to be cut at a wall or at the edge of a smoothing layer
    recorded: int  # it may hold an event to record
    dipped: (
        int  # it turns back near a wall (or the edge of a fit's range): pieces must be looked at
    )


@njit(forceinline=True)
def _stages(law, q, lane, tableau, k, h, x, v):
    """Accelerations of all stages into `k`; end state and its acceleration returned."""
    frequency, tau = load(lane, ln.FREQUENCY), load(lane, ln.TAU)
    forcing, damping = load(lane, ln.FORCING), load(lane, ln.DAMPING)
    stiffness, cubic = load(lane, ln.STIFFNESS), load(lane, ln.CUBIC)
    turns, h2 = h * frequency, h * h
    last = load(lane, ln.A)
    store(k, 0, last)
    x_i, v_i = x, v
    for i in range(1, tableau.c.size):
        sx, sv = simd.splat(0.0), simd.splat(0.0)
        for j in range(i - 1):
            k_j = load(k, j)
            sx = fma(k_j, tableau.abar[i, j], sx)
            sv = fma(k_j, tableau.a[i, j], sv)
        sv = fma(last, tableau.a[i, i - 1], sv)
        x_i = fma(h2, sx, fma(h * tableau.c[i], v, x))
        v_i = fma(h, sv, v)
        phase = vecmath.cos_turns(fma(turns, tableau.c[i], tau))
        # The law depends on x_i alone, which does not wait for the previous stage: the processor
        # overlaps this law with the previous one.
        restoring = fma(x_i, fma(cubic * x_i, x_i, stiffness), laws.acceleration(law, q, x_i))
        last = fma(-damping, v_i, fma(forcing, phase, -restoring))
        store(k, i, last)
    return x_i, v_i, last


@njit(forceinline=True)
def _tangent_stages(law, q, lane, tableau, k, k_tangent, h, x, v):
    """The same step of the two columns of the variational equation, along the stages in `k`."""
    n = tableau.c.size
    damping, stiffness, cubic = (
        load(lane, ln.DAMPING),
        load(lane, ln.STIFFNESS),
        load(lane, ln.CUBIC),
    )
    h2 = h * h
    for i in range(n):
        sx = simd.splat(0.0)
        for j in range(i):
            sx = fma(load(k, j), tableau.abar[i, j], sx)
        x_i = fma(h2, sx, fma(h * tableau.c[i], v, x))
        stiffness_i = fma(3.0 * cubic * x_i, x_i, stiffness) + laws.slope(law, q, x_i)
        for column in range(2):
            dx, dv = load(lane, ln.TANGENT + 2 * column), load(lane, ln.TANGENT + 2 * column + 1)
            tx, tv = simd.splat(0.0), simd.splat(0.0)
            for j in range(i):
                k_j = load(k_tangent, column * n + j)
                tx = fma(k_j, tableau.abar[i, j], tx)
                tv = fma(k_j, tableau.a[i, j], tv)
            dx_i = fma(h2, tx, fma(h * tableau.c[i], dv, dx))
            dv_i = fma(h, tv, dv)
            store(k_tangent, column * n + i, -fma(damping, dv_i, stiffness_i * dx_i))
            if i == n - 1:
                store(k_tangent, 2 * n + 2 * column, dx_i)
                store(k_tangent, 2 * n + 2 * column + 1, dv_i)


@njit(forceinline=True)
def _commit_tangent(lane, k_tangent, n, commit):
    for row in range(4):
        before = load(lane, ln.TANGENT + row)
        store(lane, ln.OLD_TANGENT + row, before)
        store(lane, ln.TANGENT + row, select(commit, load(k_tangent, 2 * n + row), before))


@njit(forceinline=True)
def _error(tableau, k, settings, h, x, v, x1, v1):
    """Error estimate over tolerance; accepted up to 1. Maximum norm for ode45, root mean square
    else.
    """
    ex5, ev5, ex3, ev3 = simd.splat(0.0), simd.splat(0.0), simd.splat(0.0), simd.splat(0.0)
    for j in range(tableau.c.size):
        k_j = load(k, j)
        ex5, ev5 = fma(k_j, tableau.ebar[0, j], ex5), fma(k_j, tableau.e[0, j], ev5)
        ex3, ev3 = fma(k_j, tableau.ebar[1, j], ex3), fma(k_j, tableau.e[1, j], ev3)
    rtol, atol = settings[ln.S_RTOL], settings[ln.S_ATOL]
    size_x = maximum(simd.absolute(x), simd.absolute(x1))
    size_v = maximum(simd.absolute(v), simd.absolute(v1))
    if settings[ln.S_ODE45] > 0.0:
        threshold = atol / rtol
        rx = simd.absolute(ex5) * h / maximum(size_x, threshold)
        rv = simd.absolute(ev5) / maximum(size_v, threshold)
        # `maximum` hides a NaN in its first argument; the sum does not.
        return maximum(rx * h, rv * h) / rtol + 0.0 * (rx + rv)
    wx, wv = h * h / fma(rtol, size_x, atol), h / fma(rtol, size_v, atol)
    rx5, rv5, rx3, rv3 = ex5 * wx, ev5 * wv, ex3 * wx, ev3 * wv
    e5, e3 = fma(rx5, rx5, rv5 * rv5), fma(rx3, rx3, rv3 * rv3)
    return e5 / simd.sqrt(maximum(2.0 * fma(0.01, e3, e5), 1e-300)) + 0.0 * e5


@njit(forceinline=True)
def _next_step(settings, error, h, after_failure, accepted):
    """The controller's next step length."""
    scaled = vecmath.power(maximum(error, 1e-16), -settings[ln.S_EXPONENT])
    if settings[ln.S_ODE45] > 0.0:
        grown = select(after_failure, h, h * minimum(0.8 * scaled, 5.0))
        shrunk = select(after_failure, 0.5 * h, h * maximum(0.8 * scaled, 0.1))
        # A NaN error: ode45 would end in NaN; here the step is halved until it underflows with a
        # status.
        return select(accepted, grown, select(error > 1.0, shrunk, 0.5 * h))
    factor = minimum(
        maximum(SAFETY * scaled, SHRINK_LIMIT), select(after_failure, simd.splat(1.0), GROW_LIMIT)
    )
    return h * select(accepted | (error > 1.0), factor, SHRINK_LIMIT)


@njit(forceinline=True)
def _passed(before, after, wall):
    return ((before > wall) & ~(after > wall)) | (~(before > wall) & (after > wall))


@njit(forceinline=True)
def _wall_passings(x, x1, low, high):
    """How many walls lie between the two ends, as a float vector."""
    at_high = select(_passed(x, x1, high), simd.splat(1.0), 0.0)
    return at_high + select(_passed(-x, -x1, -low), simd.splat(1.0), 0.0)


@njit(forceinline=True)
def _keep_start(lane, x, v, h):
    store(lane, ln.OLD_X, x)
    store(lane, ln.OLD_V, v)
    store(lane, ln.OLD_A, load(lane, ln.A))
    store(lane, ln.OLD_TAU, load(lane, ln.TAU))
    store(lane, ln.OLD_TURNS, load(lane, ln.TURNS))
    store(lane, ln.OLD_H, h)


@njit(forceinline=True)
def _commit(lane, commit, ended, h, x1, v1, a1):
    """Move committed lanes to the end of the step; the mask of those that passed a whole turn is
    returned.
    """
    store(lane, ln.X1, x1)
    store(lane, ln.V1, v1)
    store(lane, ln.A1, a1)
    store(lane, ln.X, select(commit, x1, load(lane, ln.X)))
    reach = load(lane, ln.REACH)
    store(lane, ln.REACH, select(commit, maximum(reach, simd.absolute(x1)), reach))
    store(lane, ln.V, select(commit, v1, load(lane, ln.V)))
    store(lane, ln.A, select(commit, a1, load(lane, ln.A)))
    tau, turns = load(lane, ln.TAU), load(lane, ln.TURNS)
    # The clock counts turns of the forcing: the phase stays in [0, 1) however long the run is.
    tau1 = fma(h, load(lane, ln.FREQUENCY), tau)
    whole = simd.floor(tau1)
    tau1 = select(ended, load(lane, ln.END_TAU), tau1 - whole)
    turns1 = select(ended, load(lane, ln.END_TURNS), turns + whole)
    store(lane, ln.TAU, select(commit, tau1, tau))
    store(lane, ln.TURNS, select(commit, turns1, turns))
    return commit & (turns1 > turns)


@njit(forceinline=True)
def _count(lane, commit, rejected, passings):
    store(lane, ln.N_ATTEMPTS, load(lane, ln.N_ATTEMPTS) + 1.0)
    store(lane, ln.N_STEPS, load(lane, ln.N_STEPS) + select(commit, simd.splat(1.0), 0.0))
    store(lane, ln.N_REJECTED, load(lane, ln.N_REJECTED) + select(rejected, simd.splat(1.0), 0.0))
    store(lane, ln.N_CONTACTS, load(lane, ln.N_CONTACTS) + select(commit, passings, 0.0))


@njit(forceinline=True)
def _layer_control(
    law, q, lane, settings, commit, ordinary, x, x1, v1, hull_low, hull_high, h_next
):
    """Keep steps from jumping over a thin layer; the next step, and the mask of steps to cut.

    A step that starts outside a layer, whose hull reaches it, and that moves farther than the
    layer's half-width is cut at the layer's edge. Inside, at least four steps are taken per
    passage, and on leaving the step goes back to its length before the layer.
    """
    half = load(q, laws.LAYER)
    low, high = load(q, laws.WALL_LOW), load(q, laws.WALL_HIGH)
    starts_inside = (simd.absolute(x - low) <= half) | (simd.absolute(x - high) <= half)
    ends_inside = (simd.absolute(x1 - low) <= half) | (simd.absolute(x1 - high) <= half)
    reaches = ((hull_high > low - half) & (hull_low < low + half)) | (
        (hull_high > high - half) & (hull_low < high + half)
    )
    cut = commit & ordinary & ~starts_inside & reaches & (hull_high - hull_low > half)
    inside_limit = half / maximum(2.0 * simd.absolute(v1), 1e-300)
    limited = select(ends_inside, minimum(h_next, inside_limit), h_next)
    leaves = commit & starts_inside & ~ends_inside
    return select(leaves, maximum(limited, load(lane, ln.H_SAVED)), limited), cut


@njit(forceinline=True)
def _leaves_mode(q, x, hull_low, hull_high):
    """Whether the step's hull leaves the region of the present contact mode."""
    in_gap = load(q, laws.ACTIVE_MODE) == 0.0
    low, high, wall = load(q, laws.WALL_LOW), load(q, laws.WALL_HIGH), load(q, laws.ACTIVE_WALL)
    out_of_gap = (hull_high > high) | (hull_low < low)
    at_high = wall == high
    back = select(at_high, hull_low, -hull_high) < select(at_high, wall, -wall)
    return (in_gap & out_of_gap) | (~in_gap & back)


@njit(forceinline=True)
def attempt(law, q, lane, tableau, k, k_tangent, settings):
    """Advance every lane by one attempt.

    Parameters
    ----------
    law : named tuple of `laws`
        Decides the specialisation.
    q, lane : ndarray, shapes (N_PARAMETERS, WIDTH) and (N_ROWS, WIDTH)
        Law parameters and lane state; `lane` is updated.
    tableau : Tableau
    k, k_tangent : ndarray, shapes (n_stages, WIDTH) and (2 n_stages + 4, WIDTH)
        Work space.
    settings : ndarray, shape (N_SETTINGS,)

    Returns
    -------
    Outcome
    """
    x, v = load(lane, ln.X), load(lane, ln.V)
    exact = load(lane, ln.EXACT)
    probing, ordinary = exact == 1.0, exact == 0.0
    h_asked = load(lane, ln.H)
    left = (load(lane, ln.END_TURNS) - load(lane, ln.TURNS)) + (
        load(lane, ln.END_TAU) - load(lane, ln.TAU)
    )
    left = left * load(lane, ln.PERIOD)
    to_end = ordinary & (h_asked * STRETCH >= left)
    h = select(to_end, left, h_asked)

    x1, v1, a1 = _stages(law, q, lane, tableau, k, h, x, v)
    error = _error(tableau, k, settings, h, x, v, x1, v1)
    # A landing repeats an accepted step in part; its error is smaller and must not be judged anew.
    accepted = (error <= 1.0) | ((exact == 2.0) & (error < 1e300))
    commit = accepted & ~probing
    after_failure = load(lane, ln.FAILED) > 0.0
    h_next = _next_step(settings, error, h, after_failure, accepted)

    # Quintic Hermite interpolant of x in Bernstein form: its coefficients bound x, their
    # differences v.
    # Accelerations enter with h^2, so the interpolant costs nothing beyond the step itself.
    a = load(lane, ln.A)
    b1, b4 = fma(0.2 * h, v, x), fma(-0.2 * h, v1, x1)
    b2 = fma(0.05 * h * h, a, fma(0.4 * h, v, x))
    b3 = fma(0.05 * h * h, a1, fma(-0.4 * h, v1, x1))
    hull_low = minimum(minimum(minimum(x, x1), minimum(b1, b4)), minimum(b2, b3))
    hull_high = maximum(maximum(maximum(x, x1), maximum(b1, b4)), maximum(b2, b3))
    rise = minimum(minimum(v, v1), minimum(minimum(b2 - b1, b4 - b3), b3 - b2))
    fall = maximum(maximum(v, v1), maximum(maximum(b2 - b1, b4 - b3), b3 - b2))
    turns_back = (rise <= 0.0) & (fall >= 0.0)

    low, high = load(q, laws.WALL_LOW), load(q, laws.WALL_HIGH)
    # Where the motion turns back, its ends do not tell how often it has passed a wall.
    dipped = (
        commit
        & turns_back
        & (((hull_low <= high) & (hull_high > high)) | ((hull_low < low) & (hull_high >= low)))
    )
    invalid = simd.absolute(x1) > settings[ln.S_BOUND]
    if laws.has_range(law):
        centre, reach = load(q, laws.CENTRE), load(q, laws.RANGE)
        out = commit & (simd.absolute(x1 - centre) > reach)
        store(lane, ln.OUT_OF_RANGE, select(out, 1.0, load(lane, ln.OUT_OF_RANGE)))
        leaves = (hull_high - centre > reach) | (hull_low - centre < -reach)
        dipped = dipped | (commit & turns_back & leaves)
        invalid = invalid | (laws.denominator(law, q, x1) <= 0.0)
    stopped = ordinary & (h < 0.0)
    if laws.has_layer(law) and settings[ln.S_STOP_AT_LAYER] > 0.0:
        h_next, stopped = _layer_control(
            law, q, lane, settings, commit, ordinary, x, x1, v1, hull_low, hull_high, h_next
        )
    if laws.is_located(law):
        stopped = (commit & ordinary & _leaves_mode(q, x, hull_low, hull_high)) | (
            commit & (exact == 2.0)
        )

    since_start = (
        (load(lane, ln.TURNS) - 0.0) + (load(lane, ln.TAU) - load(lane, ln.PHASE_0))
    ) * load(lane, ln.PERIOD)
    h_min = maximum(3.6e-15 * since_start, load(lane, ln.H_MIN))
    underflow = ~accepted & ~probing & (h <= h_min)
    exhausted = load(lane, ln.N_ATTEMPTS) >= settings[ln.S_MAX_ATTEMPTS]
    failed = underflow | exhausted | (commit & invalid)

    _keep_start(lane, x, v, h)
    ended = commit & to_end
    passed_turn = _commit(lane, commit, ended, h, x1, v1, a1)
    if settings[ln.S_TANGENT] > 0.0:
        # After the commit of (x, v): the stages are recomputed from the kept start.
        _tangent_stages(law, q, lane, tableau, k, k_tangent, h, x, v)
        _commit_tangent(lane, k_tangent, tableau.c.size, commit)
    h_next = minimum(maximum(h_next, h_min), load(lane, ln.H_MAX))
    store(lane, ln.H, select(probing, h_asked, h_next))
    store(
        lane,
        ln.FAILED,
        select(probing, load(lane, ln.FAILED), select(accepted, simd.splat(0.0), 1.0)),
    )
    store(lane, ln.EXACT, select(probing, exact, 0.0))
    passings = _wall_passings(x, x1, low, high)
    if laws.is_located(law):
        passings = simd.splat(0.0)  # counted where the step is cut: x is exactly on the wall there
        dipped = ordinary & (h < 0.0)
    _count(lane, commit, ~accepted & ~probing, passings)

    recording = commit & (load(lane, ln.TURNS) + load(lane, ln.TAU) >= load(lane, ln.RECORD_TURNS))
    eventful = passed_turn if settings[ln.S_SECTION_ONLY] > 0.0 else turns_back | passed_turn
    if settings[ln.S_CONTACTS] > 0.0:
        eventful = eventful | (passings > 0.0)
    if settings[ln.S_DENSE] > 0.0:
        eventful = commit
    return Outcome(
        simd.bits(commit),
        simd.bits(ended),
        simd.bits(failed),
        simd.bits(stopped),
        simd.bits(recording & eventful),
        simd.bits(dipped),
    )
