"""Solutions of the variational equation over a Taylor step, for all lanes at once, as vector code.

The step does not compute them, except near a layer of tanh: code for both in one place would take
turns in the registers, and a step without a tangent half as much time again. Everything that the
equation needs of the step is in the rows of the lanes and in the coefficients of the motion. One
piece of code serves all solutions of a system, in a loop.
"""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from gapsweep.integrate.jit import separate
from gapsweep.integrate.lanes.rows import dot, rows_of, value_and_slope
from gapsweep.integrate.motions import VANISHED
from gapsweep.integrate.vectors import F64, I64, absolute, fma, mask_of, where
from gapsweep.model.contact_modes import ON

from .law_series import contact_forces
from .series import Equation, Modes, Spring, extend, extend_lags, speeds
from .source import Source, column_rows
from .terms import product_term, square_term


def _square(coefficients, one):
    """Series of the square of a plain oscillator's coordinate."""
    square = []

    def to(order):
        x = [coefficients[n] for n in range(order - 1)]
        square.extend(square_term(x, n) for n in range(len(square), order - 1))

    extend(one, [square], to)
    return square


def _slopes(lanes, coefficients, one):
    """Series of the slopes of contact forces; none where contacts are located."""
    n_terms, first = lanes.layout.n_terms, lanes.layout.first_gap
    gaps = [
        [coefficients[(first + k) * n_terms + n] for n in range(n_terms)]
        for k in range(len(lanes.layout.laws))
    ]
    found = [law.slope() for law in contact_forces(lanes, gaps)]
    slopes = [[] for _ in found]

    def to(order):
        for terms, slope in zip(slopes, found, strict=True):
            terms.extend(slope[n] for n in range(len(terms), order - 1))

    if slopes:
        extend(one, slopes, to)
    return slopes


def _variation(lanes, one, square, slopes, depths, source=None):
    """Series, of coordinates and of first-order states, of the solution in the first rows.

    A parameter column has a `Source`.
    """
    layout = lanes.layout
    state = [lanes[layout.tangent_state + i] for i in range(layout.n_states)]
    y = [[state[i], state[layout.n + i]] for i in range(layout.n)]
    z = [[value] for value in state[2 * layout.n :]]
    gaps = [y[0]] if one.is_plain else [[] for _ in one.direction]
    along = [[] for _ in depths]
    pressed = [[] for _ in slopes] or gaps

    def bent(n, totals):
        """Add the forces of cubic springs, coefficient n, to `totals`."""
        place = [x[n] for x in y]
        if one.is_plain:
            (x,), ((cubic,),), (total,) = y, one.cubic, totals
            return [fma(cubic * 3.0, product_term(square, x, n), total)]

        def add(spring, totals):
            along = spring.extended(Spring.TANGENT, n, dot(spring.along, place, one.zero))
            bend = product_term(spring.series(Spring.SQUARE, n), along, n)
            return [fma(a * 3.0, bend, t) for a, t in zip(spring.cubic, totals, strict=True)]

        return one.each_spring(totals, add)

    of_lags = source.lags if source else None

    def to(order):
        for n in range(len(y[0]) - 2, order - 1):
            for terms, direction in zip(gaps, one.direction, strict=False):
                terms.append(dot(direction, [x[n] for x in y], one.zero))
            for terms, *pair in zip(pressed, slopes, gaps, strict=False):
                terms.append(product_term(*pair, n))
            forces = one.contact_forces(n, pressed) if one.rates or slopes else []
            for k, terms in enumerate(along):
                for i in range(len(terms), n + 2):
                    place = [x[i] for x in y]
                    whole = place[0] if one.is_plain else dot(one.direction[k], place, one.zero)
                    terms.append(whole)
            for chi, depth, terms in zip(one.chi, depths, along, strict=True):
                of_speed = product_term(depth, speeds(terms), n)
                forces = [*forces, chi * (of_speed + product_term(speeds(depth), terms, n))]
            totals, new = [], []
            more = source.accelerations(n) if source else None
            for springs in one.springs:
                total = None
                for k, x in zip(springs, y, strict=True):
                    total = k * x[n] if total is None else fma(k, x[n], total)
                totals.append(total)
            for i, total in enumerate(bent(n, totals)):
                for c, x in zip(one.damping[i], y, strict=True):
                    total = fma(c * float(n + 1), x[n + 1], total)
                for a, x in zip(one.others[i], z, strict=True):
                    total = fma(a, x[n], total)
                new.append(one.pulled(i, forces, more[i] - total if source else -total))
            extend_lags(one, y, z, n, of_lags)
            for series, total in zip(y, one.held(new)[0], strict=True):
                series.append(total * (1.0 / ((n + 1) * (n + 2))))
        extend_lags(one, y, z, order - 1, of_lags)

    extend(one, y + z, to)
    return y, z


def commit_solution(lanes, coefficients, solution, step, keeps, jump=None):
    """Advance the solution in the first rows of the tangent, and keep its series.

    Parameters
    ----------
    lanes, coefficients : LaneRows
        From the solution's rows on; its series are kept after those of the motion.
    solution : (list of list of Vec, list of list of Vec)
        Series of the coordinates and of the first-order states.
    step : Vec
        Length of the step [s].
    keeps : Mask
        Lanes that do not move in this step.
    jump : callable, optional
        Function of the end state that returns the state after a layer or a change of modes.
    """
    layout, (y, z) = lanes.layout, solution
    kept = layout.n_series * layout.n_terms
    for number, series in enumerate(y + z):
        for n, term in enumerate(series):
            coefficients[kept + number * layout.n_terms + n] = term
    pairs = [value_and_slope(series, step) for series in y]
    ends = [a for a, _ in pairs] + [b for _, b in pairs]
    ends += [value_and_slope(series, step)[0] for series in z]
    ends = jump(*ends) if jump else ends
    starts = [s[0] for s in y] + [s[1] for s in y] + [s[0] for s in z]
    for i, (start, end) in enumerate(zip(starts, ends, strict=True)):
        end = where(absolute(end) < VANISHED, 0.0, end)
        lanes[layout.tangent_state + i] = where(keeps, start, end)


def _depths(lanes, coefficients, modes):
    """Series of the depths of contacts if a force has their product with speeds; else none."""
    n_terms, first, found = lanes.layout.n_terms, lanes.layout.first_gap, []
    for k, wall in enumerate(modes.wall[: len(modes.chi)]):
        depth = [coefficients[(first + k) * n_terms + n] for n in range(n_terms)]
        found.append([depth[0] - wall, *depth[1:]])
    return found


def _jump(lanes, one, source=None):
    """Return a function of an end state that returns the state after changes of contact modes.

    The speed changes by ``-(c + N_0 / |u|) (b.y) M^-1 b`` where a force with damping c and preload
    N_0 begins at a wall, at a speed u, and by ``(c - N_0 / |u|) (b.y) M^-1 b`` where it ends at a
    wall; the force of a contact that never pulls ends and begins at zero. A parameter column, with
    a `Source`, has ``b.y`` less the derivative of the wall's place.
    """
    layout, changes = lanes.layout, []
    rows = map(lanes.rows, ("mode", "mode_0", "contact_damping"))
    for k, (mode, before, damping) in enumerate(zip(*rows, strict=True)):
        is_on, was_on = (absolute(each).equals(ON) for each in (mode, before))
        is_at_zero = mode.equals(before * 2.0) | before.equals(mode * 2.0)
        enters, leaves = damping, -damping
        if layout.has_preload:
            speed = lanes[layout.v_in]
            if not one.is_plain:
                speed = dot(one.direction[k], lanes.rows("v_in"), one.zero)
            step = lanes[layout.preload + k] / absolute(speed)
            enters, leaves = enters + step, leaves + step
            is_at_zero = is_at_zero | mode.equals(before)
        # without a gap, one wall is left and the other one is reached at once
        reached, left = where(is_on, enters, 0.0), where(was_on, leaves, 0.0)
        sides = ((reached, mode > 0.0), (left, before > 0.0))
        changes.append([(where(is_at_zero, 0.0, by), is_above) for by, is_above in sides])

    def jump(*state):
        ends, n = list(state), layout.n
        for k, sides in enumerate(changes):
            along = ends[0] if one.is_plain else dot(one.direction[k], ends[:n], one.zero)
            change = sum(
                by * (along - source.moving(k, is_above) if source else along)
                for by, is_above in sides
            )
            for i in range(n):
                ends[n + i] -= change if one.is_plain else one.pull[i][k] * change
        return ends

    return jump


def _impacts(lanes, coefficients, one, depths):
    """Return a function of an end state that returns the state after impacts on rigid walls.

    With ``beta = M^-1 b / (b'M^-1 b)`` and R, which takes ``(1 + e) beta (b.v)`` from the speed,
    the state is multiplied by ``R + (f_after - R f_before) n' / (n'f_before)``. The rate of the
    state is f, and n'f_before the speed of the gap: the time of the impact depends on the state.
    A parameter column, with a `Source`, has the place of the gap less the derivative of the wall's,
    and the derivative of R.
    """
    layout, step = lanes.layout, lanes["step"]
    n, n_terms, none = layout.n, layout.n_terms, one.zero
    v, rates = lanes.rows("v_in"), []
    for i in range(n):
        speed = [coefficients[i * n_terms + k] * float(k) for k in range(1, n_terms)]
        rates.append(value_and_slope(speed, step)[1])
    meetings = []
    for k, side in enumerate(lanes.rows("side")):
        direction = [none + 1.0] if one.is_plain else one.direction[k]
        pull = [none + 1.0] if one.is_plain else [row[k] for row in one.pull]
        compliance = none + 1.0 if one.is_plain else lanes[layout.compliance + k]
        speed = dot(direction, v, none)
        meets = (lanes[layout.rigid + k] > 0.0) & (speed * side > 0.0)
        share = where(meets, (lanes[layout.restitution + k] + 1.0) / compliance, 0.0)
        change = [-(share * speed * each) for each in pull]
        kick = [-dot(row, change, none) for row in one.damping]
        for j, (chi, depth) in enumerate(zip(one.chi, depths, strict=True)):
            along = change[0] if one.is_plain else dot(one.direction[j], change, none)
            force = chi * value_and_slope(depth, step)[0] * along
            kick = [one.pulled(i, [none] * j + [force], total) for i, total in enumerate(kick)]
        per_speed = where(meets, 1.0 / speed, 0.0)
        towards = share * dot(direction, rates, none)
        rates = [a + b for a, b in zip(rates, kick, strict=True)]
        kick = [(a + towards * each) * per_speed for a, each in zip(kick, pull, strict=True)]
        kick += [dot(row[:n], change, none) * per_speed for row in one.lags]
        about = k, speed, share, compliance
        meetings.append((direction, [share * each for each in pull], kick, side > 0.0, about))
        v = [a + b for a, b in zip(v, change, strict=True)]

    def after(state, source=None):
        ends = list(state)
        for direction, beta, kick, is_above, about in meetings:
            place, speed = dot(direction, ends[:n], none), dot(direction, ends[n : 2 * n], none)
            if source:
                place = place - source.moving(about[0], is_above)
                for i, each in enumerate(source.rebound(*about)):
                    ends[n + i] = ends[n + i] + each
            for i, each in enumerate(beta):
                ends[i] = fma(-each, place, ends[i])
                ends[n + i] = fma(-each, speed, ends[n + i])
            for i, each in enumerate(kick):
                ends[n + i] = fma(each, place, ends[n + i])
        return ends

    return after


def solution_rows(lanes, coefficients, number):
    """Return lanes and coefficients from the rows of a solution on, for a run-time `number`."""
    layout = lanes.layout
    series = coefficients.below(number, (layout.n + layout.m) * layout.n_terms)
    return lanes.below(number, layout.n_states), series


@intrinsic
def _tangent_step(typingctx, at, lanes, coefficients, rtol, unclear):
    """Emit `tangent_step`."""
    signature = types.void(at, lanes, coefficients, rtol, types.int64)

    def codegen(context, builder, signature, args):
        layout = at.layout
        if layout.is_tanh:
            return context.get_dummy_value()
        builder.function.attributes.add("noinline")  # within the loop it would slow every step
        rows, series = rows_of(context, builder, signature, args)
        is_tight = builder.fcmp_ordered("<", args[3], ir.Constant(F64, layout.tight))
        modes = Modes(rows, "mode_0")
        one = Equation(rows, series, modes, is_tight, "tau_0")
        square, step = _square(series, one) if layout.is_plain else [], rows["step"]
        slopes, depths = _slopes(rows, series, one), _depths(rows, series, modes)
        keeps = mask_of(builder, args[4], layout.width)
        impacts = _impacts(rows, series, one, depths) if layout.has_impacts else None

        def jump_of(source=None):
            damping = _jump(rows, one, source) if layout.is_damped else None

            def jump(*state):
                state = damping(*state) if damping else state
                return impacts(state, source) if impacts else state

            return jump

        jump = jump_of()

        def advance(number):
            solution, kept = solution_rows(rows, series, number)
            found = _variation(solution, one, square, slopes, depths)
            commit_solution(solution, kept, found, step, keeps, jump)

        if layout.is_plain:  # a loop would take a tenth longer
            advance(ir.Constant(I64, 0))
            advance(ir.Constant(I64, 1))
        else:
            with cgutils.for_range(builder, ir.Constant(I64, layout.n_states)) as loop:
                advance(loop.index)
        if layout.columns:
            with cgutils.for_range(builder, rows.counts["columns"]) as loop:
                column, kept = column_rows(rows, series, loop.index)
                source = Source(rows, series, one, modes, square, column)
                found = _variation(column, one, square, slopes, depths, source)
                commit_solution(column, kept, found, step, keeps, jump_of(source))
        return context.get_dummy_value()

    return signature, codegen


@separate
def tangent_step(at, lanes, coefficients, rtol, unclear):
    """Advance all solutions of the variational equation by the step that `taylor_step` has taken.

    Parameters
    ----------
    at, lanes, coefficients, rtol
        As in `taylor_step`, after each step of which this is called if there is a tangent. For tanh
        that has advanced the solutions already.
    unclear : int64
        Lanes that have not moved.
    """
    _tangent_step(at, lanes, coefficients, rtol, unclear)
