"""Stages of a Runge-Kutta step of all lanes and of its tangents, and polynomials between steps.

The stages of an oscillator stay in registers; those of a system are stored in rows of the lane.
"""

from gapsweep.integrate import simd
from gapsweep.integrate.jit import chosen_by_type, inlined
from gapsweep.integrate.simd import fma, load, store

from . import laws


def stages(at, kinds, q, lane, tableau, k, h):
    """Compute a step's stages: derivatives into `k`, end state and its derivative into the lane."""
    raise NotImplementedError("compiled code only")


def stage_derivative(at, kinds, q, lane, tableau, k, h, stage):
    """Compute the derivative of one more stage into `k`."""
    raise NotImplementedError("compiled code only")


def tangent_stages(at, kinds, q, lane, tableau, k, k_tangent, h, some):
    """Compute stages ``some[0] <= i < some[1]`` of the tangent's columns (variational equation),
    along the motion's stages in `k`; with the last stage, store the columns' ends in the lane.
    """
    raise NotImplementedError("compiled code only")


@chosen_by_type(stages)
def _stages(at, kinds, q, lane, tableau, k, h):
    one = _oscillator_stages if at.layout.is_plain else _system_stages
    return lambda at, kinds, q, lane, tableau, k, h: one(at, kinds, q, lane, tableau, k, h)


@chosen_by_type(stage_derivative)
def _stage_derivative(at, kinds, q, lane, tableau, k, h, stage):
    one = _oscillator_stage if at.layout.is_plain else _system_stage
    return lambda at, kinds, q, lane, tableau, k, h, stage: one(
        at, kinds, q, lane, tableau, k, h, stage
    )


@chosen_by_type(tangent_stages)
def _tangent_stages(at, kinds, q, lane, tableau, k, k_tangent, h, some):
    one = _oscillator_tangents if at.layout.is_plain else _system_tangents
    return lambda at, kinds, q, lane, tableau, k, k_tangent, h, some: one(
        at, kinds, q, lane, tableau, k, k_tangent, h, some
    )


def plain_force(at, kinds, q, lane, x, v):
    """Acceleration by the contact of an oscillator [m/s^2]."""
    raise NotImplementedError("compiled code only")


def plain_slopes(at, kinds, q, lane, tableau, k, h, i, x):
    """Derivatives of a stage's acceleration by the contact and the damper: by x, and by v."""
    raise NotImplementedError("compiled code only")


def contact_forces(at, kinds, q, lane):
    """Compute the contact forces of a system's stage into rows `force`."""
    raise NotImplementedError("compiled code only")


def contact_slopes(at, kinds, q, lane, k, stage):
    """Compute slopes of a stage's contact forces, times the factors in rows `modulation`, there."""
    raise NotImplementedError("compiled code only")


def column_forces(at, lane):
    """Compute the contact forces of a tangent's column at a stage into rows `force`."""
    raise NotImplementedError("compiled code only")


# Contacts that lose energy have other code; their rates of `contact_loss`, with a tangent, are in
# the last rows of `k`.
LOSS_ROWS = 16  # as many as stages


@chosen_by_type(plain_force)
def _plain_force(at, kinds, q, lane, x, v):
    if not at.layout.is_damped:
        return lambda at, kinds, q, lane, x, v: laws.acceleration(kinds[0], q[0], x)

    def damped(at, kinds, q, lane, x, v):
        force, drag = laws.pressure(kinds[0], q[0], load(lane, at.contact_damping), x, v)
        return force + drag

    return damped


@chosen_by_type(plain_slopes)
def _plain_slopes(at, kinds, q, lane, tableau, k, h, i, x):
    if not at.layout.is_damped:
        return lambda at, kinds, q, lane, tableau, k, h, i, x: (
            laws.slope(kinds[0], q[0], x),
            load(lane, at.damping),
        )

    def damped(at, kinds, q, lane, tableau, k, h, i, x):
        sv = simd.splat(0.0)
        for j in range(i):
            sv = fma(load(k, j), tableau.a[i, j], sv)
        c, v = load(lane, at.contact_damping), fma(h, sv, load(lane, at.v))
        by_x, drag, by_v = laws.pressure_slopes(kinds[0], q[0], c, x, v)
        store(k, len(k) - LOSS_ROWS + i, by_v)
        return by_x + drag, load(lane, at.damping) + by_v

    return damped


@chosen_by_type(contact_forces)
def _contact_forces(at, kinds, q, lane):
    one = _damped_forces if at.layout.is_damped else _elastic_forces
    return lambda at, kinds, q, lane: one(at, kinds, q, lane)


@chosen_by_type(contact_slopes)
def _contact_slopes(at, kinds, q, lane, k, stage):
    one = _damped_slopes if at.layout.is_damped else _elastic_slopes
    return lambda at, kinds, q, lane, k, stage: one(at, kinds, q, lane, k, stage)


@chosen_by_type(column_forces)
def _column_forces(at, lane):
    one = _damped_column if at.layout.is_damped else _elastic_column
    return lambda at, lane: one(at, lane)


@inlined
def polynomials(at, tableau, lane, state, k, first, h, coefficients, row):
    """Compute the coefficients, by powers of time, of a motion or a tangent within a step.

    They are stored from `row` on. The state at the beginning is in rows from `state` on, the
    stages' derivatives are in `k` from `first` on.
    """
    for i in range(at.n_rates):
        is_place = i < at.n
        store(coefficients, row, load(lane, state + i if is_place else state + at.n + i))
        if is_place:
            store(coefficients, row + 1, load(lane, state + at.n + i))
        power = simd.splat(1.0)
        for n in range(2 if is_place else 1, at.n_terms):
            total = simd.splat(0.0)
            for j in range(tableau.c.size):
                weight = tableau.dense_bar[j, n] if is_place else tableau.dense[j, n]
                total = fma(load(k, first + j * at.n_rates + i), weight, total)
            if n > (2 if is_place else 1):
                power = power / h
            store(coefficients, row + n, total * power)
        row += at.n_terms


# --- one coordinate -----------------------------------------------------------------------------


@inlined
def _oscillator_stages(at, kinds, q, lane, tableau, k, h):
    x, v = load(lane, at.q), load(lane, at.v)
    frequency, tau = load(lane, at.omega), load(lane, at.tau)
    forcing, damping = load(lane, at.push), load(lane, at.damping)
    stiffness, cubic = load(lane, at.stiffness), load(lane, at.cubic)
    turns, h2 = h * frequency, h * h
    last = load(lane, at.a)
    store(k, 0, last)
    x_i, v_i = x, v
    for i in range(1, tableau.n_stages):
        sx, sv = simd.splat(0.0), simd.splat(0.0)
        for j in range(i - 1):
            k_j = load(k, j)
            sx = fma(k_j, tableau.abar[i, j], sx)
            sv = fma(k_j, tableau.a[i, j], sv)
        sv = fma(last, tableau.a[i, i - 1], sv)
        x_i = fma(h2, sx, fma(h * tableau.c[i], v, x))
        v_i = fma(h, sv, v)
        phase = simd.cos_turns(fma(turns, tableau.c[i], tau))
        # An elastic law depends on x_i only, which does not wait for the previous stage: the
        # processor overlaps this law with the previous one.
        restoring = fma(
            x_i,
            fma(cubic * x_i, x_i, stiffness),
            plain_force(at, kinds, q, lane, x_i, v_i),
        )
        last = fma(-damping, v_i, fma(forcing, phase, -restoring))
        store(k, i, last)
    store(lane, at.q_1, x_i)
    store(lane, at.v_1, v_i)
    store(lane, at.a_1, last)


@inlined
def _oscillator_stage(at, kinds, q, lane, tableau, k, h, stage):
    x, v = load(lane, at.q), load(lane, at.v)
    sx, sv = simd.splat(0.0), simd.splat(0.0)
    for j in range(stage):
        k_j = load(k, j)
        sx = fma(k_j, tableau.abar[stage, j], sx)
        sv = fma(k_j, tableau.a[stage, j], sv)
    x, v = fma(h * h, sx, fma(h * tableau.c[stage], v, x)), fma(h, sv, v)
    turn = fma(h * load(lane, at.omega), tableau.c[stage], load(lane, at.tau))
    stiffness = fma(load(lane, at.cubic) * x, x, load(lane, at.stiffness))
    restoring = fma(x, stiffness, plain_force(at, kinds, q, lane, x, v))
    driving = fma(load(lane, at.push), simd.cos_turns(turn), -restoring)
    store(k, stage, fma(-load(lane, at.damping), v, driving))


@inlined
def _oscillator_tangents(at, kinds, q, lane, tableau, k, k_tangent, h, some):
    n, x, v, stiffness = (
        tableau.c.size,
        load(lane, at.q),
        load(lane, at.v),
        load(lane, at.stiffness),
    )
    cubic, h2 = load(lane, at.cubic), h * h
    for i in range(some[0], some[1]):
        sx = simd.splat(0.0)
        for j in range(i):
            sx = fma(load(k, j), tableau.abar[i, j], sx)
        x_i = fma(h2, sx, fma(h * tableau.c[i], v, x))
        slope, damping = plain_slopes(at, kinds, q, lane, tableau, k, h, i, x_i)
        stiffness_i = fma(3.0 * cubic * x_i, x_i, stiffness) + slope
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
            if i == tableau.n_stages - 1:
                store(lane, at.tangent_1 + 2 * column, dx_i)
                store(lane, at.tangent_1 + 2 * column + 1, dv_i)


# --- several ------------------------------------------------------------------------------------


@inlined
def _system_stages(at, kinds, q, lane, tableau, k, h):
    for i in range(at.n_rates):
        store(k, i, load(lane, at.a + i))
    for stage in range(1, tableau.n_stages):
        _system_stage(at, kinds, q, lane, tableau, k, h, stage)
    for i in range(at.n_states):
        store(lane, at.q_1 + i, load(lane, at.stage + i))
    for i in range(at.n_rates):
        store(lane, at.a_1 + i, load(k, (tableau.n_stages - 1) * at.n_rates + i))
    rows = (at.q, at.q_1), (at.v, at.v_1), (at.a, at.a_1)
    for i in range(3):
        project(at, lane, rows[i][0], at.gap_0 + i * at.contacts)
        project(at, lane, rows[i][1], at.gap_1 + i * at.contacts)
    if at.is_located:  # on the wall to the last bit where it has just been passed
        for i in range(at.contacts):
            store(lane, at.gap_0 + i, load(lane, at.gap + i))


@inlined
def _system_stage(at, kinds, q, lane, tableau, k, h, stage):
    _set_stage(at, lane, at.q, tableau, k, 0, h, stage)
    _set_clock(at, lane, tableau.c[stage], h)
    project(at, lane, at.stage, at.stage_gap)
    contact_forces(at, kinds, q, lane)
    for i in range(at.cubics):
        place = _along(at, lane, i)
        store(lane, at.cube + i, place * place * place)
    _derivative(at, lane, at.harmonics, k, stage * at.n_rates)
    if at.pieces:
        _add_piece(at, lane, tableau.c[stage], h, k, stage * at.n_rates)


@inlined
def _system_tangents(at, kinds, q, lane, tableau, k, k_tangent, h, some):
    n, size = tableau.c.size, at.n_rates
    for stage in range(some[0], some[1]):
        _set_stage(at, lane, at.q, tableau, k, 0, h, stage)
        _set_clock(at, lane, tableau.c[stage], h)
        project(at, lane, at.stage, at.stage_gap)
        contact_slopes(at, kinds, q, lane, k, stage)
        for i in range(at.cubics):
            place = _along(at, lane, i)
            store(lane, at.bend + i, 3.0 * place * place)
        for column in range(at.n_states):
            first = column * n * size
            state = at.tangent_state + column * at.n_states
            _set_stage(at, lane, state, tableau, k_tangent, first, h, stage)
            project(at, lane, at.stage, at.stage_gap)
            column_forces(at, lane)
            for i in range(at.cubics):
                store(lane, at.cube + i, load(lane, at.bend + i) * _along(at, lane, i))
            _derivative(at, lane, 0, k_tangent, first + stage * size)
            if stage == tableau.n_stages - 1:
                for i in range(at.n_states):
                    row = at.tangent_1 + column * at.n_states + i
                    store(lane, row, load(lane, at.stage + i))


@inlined
def _elastic_forces(at, kinds, q, lane):
    laws.accelerations(kinds, q, lane, at.stage_gap, at.force)
    for i in range(at.contacts):
        store(lane, at.force + i, load(lane, at.force + i) * load(lane, at.modulation + i))


@inlined
def _damped_forces(at, kinds, q, lane):
    project(at, lane, at.stage + at.n, at.stage_speed)
    laws.pressures(at, kinds, q, lane, at.stage_gap, at.stage_speed, 0)
    for i in range(at.contacts):
        factor, drag = load(lane, at.modulation + i), load(lane, at.drag + i)
        store(lane, at.force + i, fma(load(lane, at.force + i), factor, drag))


@inlined
def _elastic_slopes(at, kinds, q, lane, k, stage):
    laws.slopes(kinds, q, lane, at.stage_gap, at.force)
    for i in range(at.contacts):
        slope = load(lane, at.force + i) * load(lane, at.modulation + i)
        store(lane, at.modulation + i, slope)


@inlined
def _damped_slopes(at, kinds, q, lane, k, stage):
    project(at, lane, at.stage + at.n, at.stage_speed)
    laws.all_slopes(at, kinds, q, lane, at.stage_gap, at.stage_speed, 0)
    lost = simd.splat(0.0)
    for i in range(at.contacts):
        factor, drag = load(lane, at.modulation + i), load(lane, at.drag + i)
        store(lane, at.modulation + i, fma(load(lane, at.force + i), factor, drag))
        lost = fma(load(lane, at.drag_rate + i), load(lane, at.compliance + i), lost)
    store(k, len(k) - LOSS_ROWS + stage, lost)


@inlined
def _elastic_column(at, lane):
    for i in range(at.contacts):
        force = load(lane, at.modulation + i) * load(lane, at.stage_gap + i)
        store(lane, at.force + i, force)


@inlined
def _damped_column(at, lane):
    _elastic_column(at, lane)
    project(at, lane, at.stage + at.n, at.stage_speed)
    for i in range(at.contacts):
        drag = load(lane, at.drag_rate + i) * load(lane, at.stage_speed + i)
        store(lane, at.force + i, load(lane, at.force + i) + drag)


@inlined
def _set_stage(at, lane, state, tableau, k, first, h, stage):
    """Compute the state at a stage from the state in rows from `state` on and rows of `k`."""
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
    """Compute the cosines of the loads and the factors of the contacts' stiffness at a stage."""
    turn = fma(h * load(lane, at.omega), c, load(lane, at.tau))
    for i in range(at.harmonics):
        phase = fma(load(lane, at.multiple + i), turn, load(lane, at.phase + i))
        store(lane, at.cosine + i, simd.cos_turns(phase))
    for i in range(at.contacts):
        store(lane, at.modulation + i, simd.splat(1.0))
    for j in range(at.modulations):
        phase = fma(load(lane, at.depth_multiple + j), turn, load(lane, at.depth_phase + j))
        cosine = simd.cos_turns(phase)
        for i in range(at.contacts):
            depth = load(lane, at.depth + j * at.contacts + i)
            store(lane, at.modulation + i, fma(depth, cosine, load(lane, at.modulation + i)))


@inlined
def _along(at, lane, i):
    """Displacement of the stage along cubic spring i."""
    return _dot(lane, at.along + i * at.n, at.stage, at.n, simd.splat(0.0))


@inlined
def project(at, lane, source, target):
    """Project coordinates on the contacts' directions: their gaps; likewise for rates."""
    for i in range(at.contacts):
        direction = at.direction + i * at.n
        store(lane, target + i, _dot(lane, direction, source, at.n, simd.splat(0.0)))


@inlined
def _dot(lane, first, second, n, total):
    """`total` plus the scalar product of two vectors of n rows."""
    for i in range(n):
        total = fma(load(lane, first + i), load(lane, second + i), total)
    return total


@inlined
def _add_piece(at, lane, c, h, out, row):
    """Add the loads by pieces to the accelerations of a stage."""
    turns = (load(lane, at.tau) - load(lane, at.knot_tau)) + load(lane, at.tau_low)
    turns = (load(lane, at.cycle) - load(lane, at.knot_cycle)) + turns
    since = fma(h, c, turns * load(lane, at.period))
    for i in range(at.n):
        total = simd.splat(0.0)
        for k in range(at.pieces):
            term = load(lane, at.piece + (i + 1) * at.pieces - 1 - k)
            total = fma(total, since, term)
        store(out, row + i, load(out, row + i) + total)


@inlined
def _derivative(at, lane, n_harmonics, out, row):
    """Compute accelerations and rates of first-order states at a stage, into rows of `out`."""
    n, m, v, z = at.n, at.m, at.stage + at.n, at.stage + 2 * at.n
    for i in range(n):
        total = _dot(lane, at.stiffness + i * n, at.stage, n, simd.splat(0.0))
        total = _dot(lane, at.damping + i * n, v, n, total)
        total = _dot(lane, at.lag_force + i * m, z, m, total)
        for j in range(at.cubics):
            total = fma(load(lane, at.cubic + j * n + i), load(lane, at.cube + j), total)
        total = -_dot(lane, at.pull + i * at.contacts, at.force, at.contacts, total)
        for j in range(n_harmonics):
            total = fma(load(lane, at.push + j * n + i), load(lane, at.cosine + j), total)
        store(out, row + i, total)
    for i in range(m):
        total = _dot(lane, at.of_place + i * n, at.stage, n, simd.splat(0.0))
        total = _dot(lane, at.of_speed + i * n, v, n, total)
        store(out, row + n + i, _dot(lane, at.of_lag + i * m, z, m, total))
