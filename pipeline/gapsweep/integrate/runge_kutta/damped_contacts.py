"""Jumps, determinants and largest forces of contacts that lose energy, in Runge-Kutta steps."""

from gapsweep.integrate import simd
from gapsweep.integrate.jit import chosen_by_type, inlined
from gapsweep.integrate.lanes.outcome import AT_WALL, CLOCK_SLACK
from gapsweep.integrate.simd import fma, load, maximum, select, store

from . import laws
from .stage_values import LOSS_ROWS, project

_SAMPLES = 16  # of a force, in a step


def enter_modes(at, method, lane):
    """Apply jumps of forces to tangents and records, in lanes where the last step ended at a wall.

    Only forces that depend on the speed jump: those of contacts that lose energy.
    """
    raise NotImplementedError("compiled code only")


def add_loss(at, method, lane, commit, h):
    """Add the `contact_loss` of a step."""
    raise NotImplementedError("compiled code only")


def store_loss(at, method, lane, h):
    """Store the series of the `contact_loss` within a step."""
    raise NotImplementedError("compiled code only")


def record_forces(at, method, lane, coefficients, h, among):
    """Keep the largest forces of contacts that lose energy within the last step of some lanes."""
    raise NotImplementedError("compiled code only")


@chosen_by_type(enter_modes)
def _enter_modes(at, method, lane):
    one = _enter if at.layout.is_damped and at.layout.is_located else _nothing
    return lambda at, method, lane: one(at, method, lane)


@chosen_by_type(add_loss)
def _add_loss(at, method, lane, commit, h):
    if not at.layout.is_damped:
        return lambda at, method, lane, commit, h: None

    def damped(at, method, lane, commit, h):
        tableau, total = method.tableau, simd.splat(0.0)
        for j in range(tableau.n_stages if method.tangent else 0):
            rate = load(method.k, len(method.k) - LOSS_ROWS + j)
            total = fma(rate, tableau.a[tableau.n_stages - 1, j], total)
        lost = select(commit, h * total, 0.0)
        store(lane, at.contact_loss, load(lane, at.contact_loss) + lost)

    return damped


@chosen_by_type(store_loss)
def _store_loss(at, method, lane, h):
    if not at.layout.is_damped:
        return lambda at, method, lane, h: None

    def damped(at, method, lane, h):
        tableau, power = method.tableau, simd.splat(1.0)
        for n in range(at.n_terms):
            total = simd.splat(0.0)
            for j in range(tableau.c.size if n and method.tangent else 0):
                rate = load(method.k, len(method.k) - LOSS_ROWS + j)
                total = fma(rate, tableau.dense[j, n], total)
            if n > 1:
                power = power / h
            store(lane, at.loss + n, total * power)

    return damped


@chosen_by_type(record_forces)
def _record_forces(at, method, lane, coefficients, h, among):
    if not at.layout.is_damped:
        return lambda at, method, lane, coefficients, h, among: None
    return lambda at, method, lane, coefficients, h, among: _largest_forces(
        at, method, lane, coefficients, h, among
    )


@inlined
def _nothing(at, method, lane):
    """Do nothing: forces do not jump."""


@inlined
def _enter(at, method, lane):
    kinds, q = method.kinds, method.q
    is_at_wall = load(lane, at.is_fresh) == AT_WALL
    if simd.bits(is_at_wall) == 0:
        return
    gap, speed = at.q, at.v
    if not at.is_plain:
        gap, speed = at.gap, at.stage_speed
        project(at, lane, at.v, speed)
    laws.set_active(at, kinds, q, lane, at.mode_0, 0)
    laws.pressures(at, kinds, q, lane, gap, speed, 0)
    for i in range(at.contacts):
        store(lane, at.drag_rate + i, load(lane, at.force + i) + load(lane, at.drag + i))
    laws.set_active(at, kinds, q, lane, at.mode, 0)
    laws.pressures(at, kinds, q, lane, gap, speed, 0)
    since = load(lane, at.cycle) + load(lane, at.tau) - load(lane, at.event_clock)
    for i in range(at.contacts):
        before, u = load(lane, at.drag_rate + i), load(lane, speed + i)
        after = load(lane, at.force + i) + load(lane, at.drag + i)
        largest = maximum(simd.absolute(before), simd.absolute(after))
        _keep_largest(at, lane, i, is_at_wall & (since >= -CLOCK_SLACK), largest)
        passes = is_at_wall & (simd.absolute(load(lane, at.side + i)) > 0.0)
        passes = passes & (simd.absolute(u) > 0.0)
        rate = select(passes, (after - before) / u, 0.0)
        if method.tangent:
            for column in range(at.n_states):
                _jump(at, lane, i, at.tangent_state + column * at.n_states, rate)


@inlined
def _jump(at, lane, contact, column, rate):
    """Subtract from the speeds of a column, along a contact, `rate` times its displacement."""
    if at.is_plain:
        changed = fma(-rate, load(lane, column), load(lane, column + 1))
        store(lane, column + 1, changed)
    else:
        along = simd.splat(0.0)
        for i in range(at.n):
            along = fma(
                load(lane, at.direction + contact * at.n + i), load(lane, column + i), along
            )
        for i in range(at.n):
            pull, row = load(lane, at.pull + i * at.contacts + contact), column + at.n + i
            store(lane, row, fma(-rate * along, pull, load(lane, row)))


@inlined
def _keep_largest(at, lane, contact, among, force):
    known = load(lane, at.contact_force + contact)
    store(lane, at.contact_force + contact, select(among, maximum(known, force), known))


@inlined
def _largest_forces(at, method, lane, coefficients, h, among):
    """Sample the forces along the polynomials of a step; a parabola refines the largest ones."""
    last, n_samples = at.n_terms - 1, _SAMPLES
    for i in range(at.contacts):
        store(lane, at.stage_speed + i, simd.splat(0.0))
        _keep_samples(at, lane, i, simd.splat(0.0), simd.splat(0.0))
    for sample in range(n_samples + 1):
        t = h * (sample / n_samples)
        for i in range(at.contacts):
            first = (at.first_gap + i) * at.n_terms
            x, v = load(coefficients, first + last), simd.splat(0.0)
            for n in range(last - 1, -1, -1):
                v = fma(v, t, x)
                x = fma(x, t, load(coefficients, first + n))
            store(lane, at.stage_gap + i, x)
            store(lane, at.stage_speed + i, v)
        laws.pressures(at, method.kinds, method.q, lane, at.stage_gap, at.stage_speed, 0)
        for i in range(at.contacts):
            x, force = load(lane, at.stage_gap + i), load(lane, at.force + i)
            force = simd.absolute(force + load(lane, at.drag + i))
            if at.is_located:
                low, high = laws.interval(at, lane, load(lane, at.mode + i), i)
                force = select((x >= low) & (x <= high), force, 0.0)
            before, middle = load(lane, at.drag_rate + i), load(lane, at.sampled + i)
            bend = 2.0 * middle - before - force
            peak = middle + (before - force) * (before - force) / (8.0 * maximum(bend, 1e-300))
            is_peak = (middle > before) & (middle >= force) & (before > 0.0) & (force > 0.0)
            _keep_largest(at, lane, i, among, maximum(force, select(is_peak, peak, 0.0)))
            _keep_samples(at, lane, i, middle, force)


@inlined
def _keep_samples(at, lane, contact, before, middle):
    store(lane, at.drag_rate + contact, before)
    store(lane, at.sampled + contact, middle)
