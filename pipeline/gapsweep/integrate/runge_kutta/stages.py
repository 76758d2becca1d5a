"""The stages of a Runge-Kutta step of all lanes, and of its tangents: an oscillator's, where
everything stays in registers, and a system's, whose stage stands in rows of the lane.
"""

from gapsweep.integrate import simd
from gapsweep.integrate.jit import chosen_by_type, inlined
from gapsweep.integrate.simd import fma, load, store

from . import laws, vecmath


def stages(at, kinds, q, lane, tableau, k, h):
    """Derivatives of all stages into `k`; end state and its derivative into the lane."""
    raise NotImplementedError("compiled code only")


def tangent_stages(at, kinds, q, lane, tableau, k, k_tangent, h):
    """The same step of the columns of the variational equation, along the stages in `k`; their ends
    into the rows of old ones.
    """
    raise NotImplementedError("compiled code only")


@chosen_by_type(stages)
def _stages(at, kinds, q, lane, tableau, k, h):
    one = _oscillator_stages if at.layout.is_plain else _system_stages
    return lambda at, kinds, q, lane, tableau, k, h: one(at, kinds, q, lane, tableau, k, h)


@chosen_by_type(tangent_stages)
def _tangent_stages(at, kinds, q, lane, tableau, k, k_tangent, h):
    one = _oscillator_tangents if at.layout.is_plain else _system_tangents
    return lambda at, kinds, q, lane, tableau, k, k_tangent, h: one(
        at, kinds, q, lane, tableau, k, k_tangent, h
    )


# --- one coordinate -----------------------------------------------------------------------------


@inlined
def _oscillator_stages(at, kinds, q, lane, tableau, k, h):
    x, v = load(lane, at.old_q), load(lane, at.old_v)
    frequency, tau = load(lane, at.omega), load(lane, at.old_tau)
    forcing, damping = load(lane, at.push), load(lane, at.damping)
    stiffness, cubic = load(lane, at.stiffness), load(lane, at.cubic)
    turns, h2 = h * frequency, h * h
    last = load(lane, at.old_a)
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
        restoring = fma(
            x_i, fma(cubic * x_i, x_i, stiffness), laws.acceleration(kinds[0], q[0], x_i)
        )
        last = fma(-damping, v_i, fma(forcing, phase, -restoring))
        store(k, i, last)
    store(lane, at.q_1, x_i)
    store(lane, at.v_1, v_i)
    store(lane, at.a_1, last)


@inlined
def _oscillator_tangents(at, kinds, q, lane, tableau, k, k_tangent, h):
    n, x, v = tableau.c.size, load(lane, at.old_q), load(lane, at.old_v)
    damping, stiffness = load(lane, at.damping), load(lane, at.stiffness)
    cubic, h2 = load(lane, at.cubic), h * h
    for i in range(n):
        sx = simd.splat(0.0)
        for j in range(i):
            sx = fma(load(k, j), tableau.abar[i, j], sx)
        x_i = fma(h2, sx, fma(h * tableau.c[i], v, x))
        stiffness_i = fma(3.0 * cubic * x_i, x_i, stiffness) + laws.slope(kinds[0], q[0], x_i)
        for column in range(2):
            row = at.tangent_state + 2 * column
            dx, dv = load(lane, row), load(lane, row + 1)
            tx, tv = simd.splat(0.0), simd.splat(0.0)
            for j in range(i):
                k_j = load(k_tangent, column * n + j)
                tx = fma(k_j, tableau.abar[i, j], tx)
                tv = fma(k_j, tableau.a[i, j], tv)
            dx_i = fma(h2, tx, fma(h * tableau.c[i], dv, dx))
            dv_i = fma(h, tv, dv)
            store(k_tangent, column * n + i, -fma(damping, dv_i, stiffness_i * dx_i))
            if i == n - 1:
                store(lane, at.old_tangent + 2 * column, dx_i)
                store(lane, at.old_tangent + 2 * column + 1, dv_i)


# --- several ------------------------------------------------------------------------------------


@inlined
def _system_stages(at, kinds, q, lane, tableau, k, h):
    for i in range(at.n_rates):
        store(k, i, load(lane, at.old_a + i))
    for stage in range(1, tableau.c.size):
        _set_stage(at, lane, at.old_q, tableau, k, 0, h, stage)
        _set_clock(at, lane, tableau.c[stage], h)
        project(at, lane, at.stage, at.gap)
        laws.accelerations(kinds, q, lane, at.gap, at.force)
        for i in range(at.contacts):
            store(lane, at.force + i, load(lane, at.force + i) * load(lane, at.rate + i))
        for i in range(at.cubics):
            place = _along(at, lane, i)
            store(lane, at.cube + i, place * place * place)
        _derivative(at, lane, at.harmonics, k, stage * at.n_rates)
    for i in range(at.n_states):
        store(lane, at.q_1 + i, load(lane, at.stage + i))
    for i in range(at.n_rates):
        store(lane, at.a_1 + i, load(k, (tableau.c.size - 1) * at.n_rates + i))
    for i in range(3):  # places, speeds, accelerations
        part = i * at.n + (at.m if i == 2 else 0)
        project(at, lane, at.old_q + part, at.gap_0 + i * at.contacts)
        project(at, lane, at.q_1 + part, at.gap_1 + i * at.contacts)


@inlined
def _system_tangents(at, kinds, q, lane, tableau, k, k_tangent, h):
    n, size = tableau.c.size, at.n_rates
    for stage in range(n):
        _set_stage(at, lane, at.old_q, tableau, k, 0, h, stage)
        _set_clock(at, lane, tableau.c[stage], h)
        project(at, lane, at.stage, at.gap)
        laws.slopes(kinds, q, lane, at.gap, at.force)
        for i in range(at.contacts):
            # From here on in the place of the rate: what a contact's force grows by with its gap.
            store(lane, at.rate + i, load(lane, at.force + i) * load(lane, at.rate + i))
        for i in range(at.cubics):
            place = _along(at, lane, i)
            store(lane, at.bend + i, 3.0 * place * place)
        for column in range(at.n_states):
            first = column * n * size
            state = at.tangent_state + column * at.n_states
            _set_stage(at, lane, state, tableau, k_tangent, first, h, stage)
            project(at, lane, at.stage, at.gap)
            for i in range(at.contacts):
                store(lane, at.force + i, load(lane, at.rate + i) * load(lane, at.gap + i))
            for i in range(at.cubics):
                store(lane, at.cube + i, load(lane, at.bend + i) * _along(at, lane, i))
            _derivative(at, lane, 0, k_tangent, first + stage * size)
            if stage == n - 1:
                for i in range(at.n_states):
                    row = at.old_tangent + column * at.n_states + i
                    store(lane, row, load(lane, at.stage + i))


@inlined
def _set_stage(at, lane, state, tableau, k, first, h, stage):
    """State at a stage, from that in rows from `state` on and derivatives in rows of `k`."""
    h2, c = h * h, h * tableau.c[stage]
    for i in range(at.n_rates):
        sx, sv = simd.splat(0.0), simd.splat(0.0)
        for j in range(stage):
            k_j = load(k, first + j * at.n_rates + i)
            sv = fma(k_j, tableau.a[stage, j], sv)
            if i < at.n:
                sx = fma(k_j, tableau.abar[stage, j], sx)
        v = load(lane, state + at.n + i)  # first-order states stand after the speeds
        store(lane, at.stage + at.n + i, fma(h, sv, v))
        if i < at.n:
            store(lane, at.stage + i, fma(h2, sx, fma(c, v, load(lane, state + i))))


@inlined
def _set_clock(at, lane, c, h):
    """Cosines of the loads at a stage, and by what the contacts' stiffness is multiplied."""
    turn = fma(h * load(lane, at.omega), c, load(lane, at.old_tau))
    for i in range(at.harmonics):
        if at.in_step:
            store(lane, at.cosine + i, vecmath.cos_turns(turn))
        else:
            phase = fma(load(lane, at.multiple + i), turn, load(lane, at.phase + i))
            store(lane, at.cosine + i, vecmath.cos_turns(phase))
    for i in range(at.contacts):
        store(lane, at.rate + i, simd.splat(1.0))
    for j in range(at.modulations):
        phase = fma(load(lane, at.depth_multiple + j), turn, load(lane, at.depth_phase + j))
        cosine = vecmath.cos_turns(phase)
        for i in range(at.contacts):
            depth = load(lane, at.depth + j * at.contacts + i)
            store(lane, at.rate + i, fma(depth, cosine, load(lane, at.rate + i)))


@inlined
def _along(at, lane, i):
    """How far the stage has gone along a cubic spring."""
    return _dot(lane, at.along + i * at.n, at.stage, at.n, simd.splat(0.0))


@inlined
def project(at, lane, source, target):
    """Gaps of the contacts, or their rates, of coordinates or theirs."""
    for i in range(at.contacts):
        direction = at.direction + i * at.n
        store(lane, target + i, _dot(lane, direction, source, at.n, simd.splat(0.0)))


@inlined
def _dot(lane, first, second, n, total):
    """`total` plus a product of two vectors of n rows."""
    for i in range(n):
        total = fma(load(lane, first + i), load(lane, second + i), total)
    return total


@inlined
def _derivative(at, lane, n_harmonics, out, row):
    """Accelerations and rates of first-order states at a stage, into rows of `out`."""
    n, m, v, z = at.n, at.m, at.stage + at.n, at.stage + 2 * at.n
    for i in range(n):
        total = _dot(lane, at.stiffness + i * n, at.stage, n, simd.splat(0.0))
        total = _dot(lane, at.damping + i * n, v, n, total)
        total = _dot(lane, at.lag_force + i * m, z, m, total)
        total = _dot(lane, at.cubic + i * at.cubics, at.cube, at.cubics, total)
        total = -_dot(lane, at.pull + i * at.contacts, at.force, at.contacts, total)
        for j in range(n_harmonics):
            total = fma(load(lane, at.push + j * n + i), load(lane, at.cosine + j), total)
        store(out, row + i, total)
    for i in range(m):
        total = _dot(lane, at.of_place + i * n, at.stage, n, simd.splat(0.0))
        total = _dot(lane, at.of_speed + i * n, v, n, total)
        store(out, row + n + i, _dot(lane, at.of_lag + i * m, z, m, total))
