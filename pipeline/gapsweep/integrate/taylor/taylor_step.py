"""One Taylor step of a system with located contacts, for all lanes at once, as vector code.

A contact mode is an interval [lo, hi] that the contact's gap b.q may not leave: the freeplay
itself, or one of the half lines behind a wall. The step is cut where its own polynomial leaves an
interval first. A step has four parts, and only two branches:

1. Taylor coefficients (`series`), and the step that the last two of them allow (`step_size`);
2. proof, from bounds on the coefficients of every gap, that it, its slope or its curvature keep
   their place or sign on the whole step. It sorts the lanes into *inside* (no crossing possible),
   *crossing* (exactly one, decided by the end point) and *unclear*;
3. Newton's method for all crossing lanes together (skipped if there is none); the earliest counts;
4. commit: clock, state, modes, counters. *Unclear* lanes are left untouched; the caller isolates
   their roots one by one (`roots`).
"""

import math
from functools import reduce

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from gapsweep.integrate.lanes.outcome import (
    CLOCK_SLACK,
    MAX_HALVINGS,
    MODEL_INVALID,
    SHORT_STEP,
)
from gapsweep.integrate.lanes.parameters import RANGE
from gapsweep.integrate.lanes.rows import dot, rows_of, value_and_slope
from gapsweep.integrate.vectors import (
    F64,
    I64,
    Vec,
    absolute,
    branch,
    copysign,
    fma,
    is_nonzero,
    maximum,
    minimum,
    splat,
    sqrt,
    where,
)
from gapsweep.model.contact_modes import MODES

from .series import Equation, Modes, StepSeries
from .step_size import Sizes, longest_step, step_size
from .tangent import commit_solution, solution_rows
from .tanh import Layers, TanhMotion, variation

# A step spans at most this part of a forcing period, so that it holds at most one section point.
MAX_PERIODS_PER_STEP = 0.5
NEWTON_STEPS = 3
_EPS = 2.0**-52


def compensated_sum(total, term):
    """Return the sum and its rounding error (Kahan), to the rounding of `term`.

    A clock that adds many short steps to a long period would otherwise lose it at every step.
    """
    rounded = total + term
    return rounded, term - (rounded - total)


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
    """Bounds of a gap within a step, and masks of its proved properties: true only if proved."""

    def __init__(self, series, lo, hi, h):
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
        self.bottom, self.top = series[0] + (low - slack), series[0] + (high + slack)
        is_monotone = self.falls | self.rises
        # If x is inside initially, it leaves over `lo` at most once if it is monotone or concave,
        # over `hi` at most once if monotone or convex: then the end point decides.
        self.is_decided = ((self.bottom >= lo) | is_monotone | self.is_concave) & (
            (self.top <= hi) | is_monotone | self.is_convex
        )


def _emit_decided_step(builder, watched, h, layers):
    """Shorten the step of lanes whose crossing is unclear, up to MAX_HALVINGS times.

    A shorter step costs a fifth of isolating roots for one lane, and its bounds are much tighter:
    each neglected degree halves once more.

    Returns
    -------
    h : Vec
        The step.
    is_decided : Mask
        No gap leaves its interval, or it leaves once and ends beyond.
    shapes : list of _Shape
        Shapes of the watched series.
    """
    if not watched:
        return h, h <= h, []
    start = builder.block
    loop, done = builder.append_basic_block("halve"), builder.append_basic_block("decided")
    builder.branch(loop)
    builder.position_at_end(loop)
    step, count = builder.phi(h.value.type), builder.phi(I64)
    trial = Vec(builder, step)
    shapes = [_Shape(*each, trial) for each in watched]
    is_decided = reduce(lambda a, b: a & b, [shape.is_decided for shape in shapes])
    if layers:
        is_decided = is_decided & ~layers.ends_in_one(shapes[0], trial)
    halved = where(is_decided, trial, trial * 0.5)
    step.add_incoming(h.value, start)
    step.add_incoming(halved.value, builder.block)
    count.add_incoming(ir.Constant(I64, 0), start)
    count.add_incoming(builder.add(count, ir.Constant(I64, 1)), builder.block)
    is_open = is_nonzero(builder, (~is_decided).bits())
    may_go_on = builder.icmp_unsigned("<", count, ir.Constant(I64, MAX_HALVINGS))
    builder.cbranch(builder.and_(is_open, may_go_on), loop, done)
    builder.position_at_end(done)
    return trial, is_decided, shapes


def _signs(bernstein, slack):
    """Masks (all below zero, all above zero) of a polynomial from its Bernstein coefficients."""
    low = high = bernstein[0]
    for b in bernstein[1:]:
        low, high = minimum(low, b), maximum(high, b)
    return high + slack < 0.0, low - slack > 0.0


def _crossing(series, h, wall, x_1, v_1):
    """Last time before h at which x reaches `wall`, the velocity there, and the residual."""
    # The parabola through both ends and the slope at h is good to about 1e-3 of the step. The
    # later of its two roots is taken: the earlier may be the wall that the step started on.
    g_1, u_1 = x_1 - wall, v_1 * h
    bend = (series[0] - wall) - g_1 + u_1
    root = sqrt(maximum(fma(u_1, u_1, -(bend * g_1 * 4.0)), 0.0 * g_1))
    back = g_1 * 2.0 / (u_1 + copysign(root, u_1))
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

    def found():
        t, v, residual = _crossing(series, h, wall, x_1, v_1)
        size = absolute(series[0]) + (absolute(series[1]) + absolute(v)) * absolute(t)
        is_exact = absolute(residual) <= size * (8 * _EPS)  # as near as rounding lets it come
        return t, v, is_exact & (t > 0.0) & (t <= h) & (v * outward > 0.0)

    is_wanted = is_nonzero(builder, wants_root.bits())
    return branch(builder, is_wanted, found, lambda: (h, v_1, h < h))


class _Exits:
    """Exits of contacts from their modes within a step, and the time of each lane's first exit.

    Attributes
    ----------
    step : Vec
        The step, cut where a wall is passed.
    passes : list of Mask
        For every watched series (`Modes.watched`), the lanes whose step ends on one of its ends.
    sides : list of Vec
        For every watched series +1 or -1 there, for the upper or lower end, else 0.
    crosses : Mask
        Lanes whose step ends on a wall.
    is_unclear : Mask
    ends : list of tuple of Vec
        For every watched series, its value and rate at its exit or the end of the step.
    shapes : list of _Shape
    """

    def __init__(self, builder, lanes, motion, modes, h, layers):
        watched, layout = modes.watched(motion.gaps), lanes.layout
        h, is_decided, self.shapes = _emit_decided_step(builder, watched, h, layers)
        found = [self._crossing_of(builder, *each, h, is_decided) for each in watched]
        self.h, self.is_unclear = h, ~is_decided
        for leaves, crosses, *_ in found:
            self.is_unclear = self.is_unclear | (leaves & ~crosses)
        for pressure, gap, shape in zip(modes.pressures, motion.gaps, self.shapes, strict=False):
            self.is_unclear = self.is_unclear | _may_end_by_force(pressure, gap, shape, h)
        for rigid, e, held, (_, crosses, t, *_) in zip(
            lanes.rows("rigid"), lanes.rows("restitution"), modes.held, found, strict=False
        ):
            # what may begin or end in a hold, or change other modes, is for code of single lanes
            meets = crosses & (rigid > 0.0)
            if not layout.has_slack:
                meets = meets & ((t * lanes["rate"] < SHORT_STEP) | ~(e > 0.0))
            self.is_unclear = self.is_unclear | held | meets
        for bounces in _low_bounces(lanes, motion.equation, found) if layout.has_preload else ():
            self.is_unclear = self.is_unclear | bounces
        is_alone = len(found) == 1 and not (modes.held or modes.pressures)
        first = found[0] if is_alone else None
        self.step = (
            where(first[1], first[2], h)
            if first
            else reduce(minimum, [where(crosses, t, h) for _, crosses, t, *_ in found], h)
        )
        # the caller, who resolves unclear lanes, must not take one contact's crossing for the step
        self.step = where(self.is_unclear, h, self.step)
        self.passes, self.sides, self.crosses = [], [], h < h
        for _, crosses, t, outward, _ in found:
            is_first = crosses if first else crosses & (t <= self.step) & ~self.is_unclear
            self.passes.append(is_first)
            self.sides.append(where(is_first, outward, 0.0))
            self.crosses = is_first if first else self.crosses | is_first
        self.ends = [end for *_, end in found]

    @staticmethod
    def _crossing_of(builder, gap, lo, hi, h, is_decided):
        g_1, u_1 = value_and_slope(gap, h)
        leaves_up, leaves_down = g_1 >= hi, g_1 <= lo
        leaves = leaves_up | leaves_down
        outward = where(leaves_up, h.constant(1.0), -1.0)
        target = where(leaves_up, hi, lo)
        wants_root = leaves & is_decided
        t, u, is_found = _emit_crossings(builder, gap, h, (g_1, u_1), outward, wants_root, target)
        crosses = wants_root & is_found
        end = where(crosses, target, g_1), where(crosses, u, u_1)
        return leaves, crosses, t, outward, end


def _low_bounces(lanes, equation, found):
    """Yield, for every contact, the lanes that may begin a hold on a wall with a preload.

    The acceleration changes by preload times compliance there: flights of at least one side are
    higher than the height that is left out if the square of the speed exceeds their product.
    """
    layout = lanes.layout
    for k, (_, crosses, *_, (_, speed)) in enumerate(found):
        change, reach = lanes[layout.preload + k], lanes["reach"]
        if not layout.is_plain:
            change = change * lanes[layout.compliance + k]
            along = [absolute(b) for b in equation.direction[k]]
            reach = dot(along, lanes.rows("reach"), 0.0 * change)
        reach = maximum(reach, lanes["least_reach"])
        yield crosses & (speed * speed <= change * lanes[layout.low + k] * reach)


def _may_end_by_force(pressure, gap, shape, h):
    """Lanes in modes of the gap that the force may end, which only code for single lanes locates.

    These are mode slack, and mode on of a contact with a preload. In mode slack, a gap that falls
    and is concave, or rises and is convex, takes the force away from zero. This is almost always
    so; bounds of the force are needed for other lanes only.
    """
    leaves = (shape.falls & shape.is_concave) | (shape.rises & shape.is_convex)
    is_open = pressure.is_slack & ~leaves
    if pressure.may_decide:
        is_open = is_open | pressure.may_decide

    def by_bounds():
        force, lo, hi = pressure.series(gap), pressure.lo, pressure.hi
        end, _ = value_and_slope(force, h)
        stays = _Shape(force, lo, hi, h).is_decided & (end > lo) & (end < hi)
        return [is_open & ~stays]

    is_any = is_nonzero(h.builder, is_open.bits())
    (found,) = branch(h.builder, is_any, by_bounds, lambda: [is_open])
    return found


class _Passings:
    """Walls that gaps pass within a step that does not end there.

    Attributes
    ----------
    h, step : Vec
        The step.
    crosses, is_unclear : Mask
        No lanes.
    n_walls : Vec
        Number of walls that lie between both ends of the step.
    is_miscounted : Mask
        Lanes in which a gap may have passed a wall, or have left its law's range, and come back.
    is_out, has_pole : Mask
        Lanes in which a gap ends outside the range of its law, or beyond a pole.
    ends : list of tuple of Vec
        For every contact, the gap and its rate at the end of the step.
    """

    def __init__(self, lanes, motion, h, is_last):
        none, one = h < h, h.constant(1.0)
        self.h = self.step = h
        self.crosses = self.is_unclear = none
        self.is_miscounted, self.is_out, self.has_pole = none, none, none
        self.n_walls, is_first = 0.0 * h, lanes["n_steps"].equals(0.0)
        self.ends = [value_and_slope(gap, h) for gap in motion.gaps]
        walls = lanes.rows("lower"), lanes.rows("upper")
        for law, gap, (end, _), low, high in zip(
            motion.laws, motion.gaps, self.ends, *walls, strict=True
        ):
            shape = _Shape(gap, low, high, h)
            turns = ~(shape.rises | shape.falls)
            heading = where(gap[1].equals(0.0), gap[2], gap[1])
            for wall, side in ((low, -1.0), (high, 1.0)):
                was, is_ = (gap[0] - wall) * side > 0.0, (end - wall) * side > 0.0
                self.n_walls = self.n_walls + where((was & ~is_) | (is_ & ~was), one, 0.0)
                # a motion that begins on the wall and moves outwards has not passed it
                begins = is_first & gap[0].equals(wall) & (heading * side > 0.0)
                self.n_walls = self.n_walls - where(begins, one, 0.0)
                is_near = (shape.bottom <= wall) & (shape.top >= wall)
                self.is_miscounted = self.is_miscounted | (turns & is_near)
            if law.has_range:
                reach = law.row(RANGE)
                is_within = (shape.top <= reach) & (shape.bottom >= -reach)
                self.is_miscounted = self.is_miscounted | (turns & ~is_within)
                self.is_out = self.is_out | (absolute(end) > reach)
                denominator = law.value("denominator", end)
                if denominator is not None:
                    # a step next to a pole is short, as the series converges up to the pole only
                    is_next = (h < lanes["min_step"]) & ~is_last
                    self.has_pole = self.has_pole | is_next | (denominator <= 0.0)


def _state_at(motion, step):
    """q, v and z after a part of the step, as one list."""
    pairs = [value_and_slope(q, step) for q in motion.q]
    lags = [value_and_slope(z, step)[0] for z in motion.z]
    return [q for q, _ in pairs] + [v for _, v in pairs] + lags


def _commit_contacts(lanes, modes, motion, exits, state):
    """Store modes, sides and gaps for the next step; return the number of walls passed."""
    layout = lanes.layout
    if layout.has_slack:
        return _commit_slack(lanes, modes, motion, exits, state)
    n_walls = lanes["tau"].constant(0.0)
    for k, side in enumerate(exits.sides):
        passes, touching = exits.passes[k], modes.touching[k]
        if layout.has_impacts:  # which leave the mode, and end a contact at once
            is_rigid = lanes[layout.rigid + k] > 0.0
            n_walls = n_walls + where(passes & is_rigid, 2.0, 0.0 * n_walls)
            passes = passes & ~is_rigid
        mode, has_gap = lanes[layout.mode + k], lanes[layout.lower + k] < lanes[layout.upper + k]
        # Leaving contact without a gap is entering contact with the other wall.
        lanes[layout.mode + k] = where(passes, where(touching & has_gap, 0.0 * side, side), mode)
        lanes[layout.mode_0 + k], lanes[layout.side + k] = mode, side
        n_walls = n_walls + where(passes, where(touching & ~has_gap, side.constant(2.0), 1.0), 0.0)
        if not layout.is_plain:
            # Exactly on the wall that it passes; proved to be inside of the others.
            lo, hi, old = modes.lo[k], modes.hi[k], motion.gaps[k][0]
            gap = dot(motion.equation.direction[k], state[: layout.n], old.constant(0.0))
            gap = minimum(maximum(gap, lo), hi)
            gap = where(exits.passes[k], where(side > 0.0, hi, lo), gap)
            lanes[layout.gap + k] = where(exits.is_unclear, old, gap)
    return n_walls


def _meet_rigid_walls(lanes, motion, exits, state):
    """Reverse the speeds of gaps in `state` that meet rigid walls; return the contact loss."""
    layout = lanes.layout
    n, none = layout.n, lanes["tau"].constant(0.0)
    lost = none
    for i in range(n):
        lanes[layout.v_in + i] = state[n + i]
    for k in range(layout.contacts):
        speed, pull, compliance = state[n], [1.0], none + 1.0
        if not layout.is_plain:
            speed = dot(motion.equation.direction[k], state[n : 2 * n], none)
            pull = [row[k] for row in motion.equation.pull]
            compliance = lanes[layout.compliance + k]
        # not where an impact of another contact has turned it
        meets = exits.passes[k] & (lanes[layout.rigid + k] > 0.0) & (speed * exits.sides[k] > 0.0)
        change = where(meets, (lanes[layout.restitution + k] + 1.0) * speed / compliance, 0.0)
        for i in range(n):
            state[n + i] = state[n + i] - change * pull[i]
        lost = lost + where(meets, lanes[layout.of_impact + k], 0.0)
    return lost


def _commit_slack(lanes, modes, motion, exits, state):
    """Do what `_commit_contacts` does, for contacts that may never pull; the gap of an oscillator
    is set in `state`."""
    layout = lanes.layout
    n, none = layout.contacts, lanes["tau"].constant(0.0)
    n_changes = none
    for k in range(n):
        mode, has_gap = lanes[layout.mode + k], lanes[layout.lower + k] < lanes[layout.upper + k]
        passes, side, decides = exits.passes[k], exits.sides[k], modes.pressures[k].decides
        at_wall, at_zero = passes & ~decides, passes & decides
        new, acted, acts = mode, none, none
        for number, row in enumerate(MODES):
            is_here = absolute(mode).equals(number)
            beyond = side if row.after_wall else where(has_gap, none, side)
            zero = copysign(none + row.after_zero, mode)
            new = where(is_here & at_wall, beyond, where(is_here & at_zero, zero, new))
            acted = where(is_here, float(row.acts), acted)
        for number, row in enumerate(MODES):
            acts = where(absolute(new).equals(number), float(row.acts), acts)
        # from one wall to the other one without a gap
        is_swapped = at_wall & (acted > 0.0) & (acts > 0.0)
        changes = where(is_swapped, 2.0, absolute(acts - acted))
        n_changes = n_changes + changes
        lanes[layout.mode + k], lanes[layout.mode_0 + k] = new, mode
        lanes[layout.side + k] = side
        switched = where(at_zero, 1.0, none)
        old = lanes[layout.switched + k]
        lanes[layout.switched + k] = where(exits.is_unclear, old, switched)
        lo, hi, gap = modes.lo[k], modes.hi[k], state[0]
        if not layout.is_plain:
            gap = dot(motion.equation.direction[k], state[: layout.n], none)
        gap = minimum(maximum(gap, lo), hi)
        gap = where(at_wall, where(side > 0.0, hi, lo), gap)
        if layout.is_plain:
            state[0] = gap
        else:
            lanes[layout.gap + k] = where(exits.is_unclear, motion.gaps[k][0], gap)
    return n_changes


def _emit_step(builder, lanes, coefficients, scalars):
    """Emit the whole step; returns the packed masks (see `taylor_step`).

    One function: its parts follow the order of the step, and each uses results of those before.
    """
    layout = lanes.layout
    rtol, x_bound, max_short = (splat(builder, s, layout.width) for s in scalars)

    # 1. series and step size
    modes = Modes(lanes)
    is_tight = builder.fcmp_ordered("<", scalars[0], ir.Constant(F64, layout.tight))
    equation = Equation(lanes, coefficients, modes, is_tight)
    motion = (TanhMotion if layout.is_tanh else StepSeries)(lanes, modes, equation)
    kept = motion.q if layout.is_plain else motion.q + motion.z + motion.gaps
    padding = [equation.zero] * layout.n_terms
    kept = kept + [(force + padding)[: layout.n_terms] for force in motion.forces]
    for number, series in enumerate(kept):
        for n, term in enumerate(series):
            coefficients[number * layout.n_terms + n] = term
    sizes, layers = Sizes(lanes, modes, motion), None
    if layout.is_tanh and layout.tangent:
        sizes.springs = sizes.springs + motion.stiffening
    (free_step,) = branch(
        builder,
        is_tight,
        *(lambda n=n: [step_size(lanes, motion, sizes, rtol, n)] for n in layout.degrees[::-1]),
    )
    if layout.is_tanh:
        layers = Layers(lanes, modes, motion)
        free_step = minimum(free_step, layers.longest)
    free_step = minimum(longest_step(motion), free_step) if motion.laws else free_step
    period, tau, tau_low, cycle = (lanes[name] for name in ("period", "tau", "tau_low", "cycle"))
    end_cycle, end_tau = lanes["end_cycle"], lanes["end_tau"]
    left = maximum(((end_cycle - cycle) + (end_tau - tau) - tau_low) * period, 0.0 * period)
    h = minimum(free_step, period * MAX_PERIODS_PER_STEP)
    for pressure, gap in zip(modes.pressures, motion.gaps, strict=False):
        h = minimum(h, pressure.longest(gap, h))
    is_last = h >= left
    h = where(is_last, left, h)

    # 2., 3. which lanes leave their intervals, and where exactly
    if layout.is_located:
        exits = _Exits(builder, lanes, motion, modes, h, layers)
    else:
        exits = _Passings(lanes, motion, h, is_last)
    if layers:
        layers.cross(exits, left, fma(sizes.speed, rtol, lanes["floor"]))
    step, crosses, is_unclear = exits.step, exits.crosses, exits.is_unclear
    keeps = is_unclear | layers.repeats if layers else is_unclear  # lanes that do not move
    # a step that is halved in search of a crossing may be as short as it likes
    is_stuck = (h < lanes["min_step"]) & ~(crosses | is_last)
    is_last = is_last & (exits.h >= left)
    is_one = layout.is_plain and not layout.has_slack  # watched series
    state = list(exits.ends[0]) if is_one else _state_at(motion, step)
    lost = _meet_rigid_walls(lanes, motion, exits, state) if layout.has_impacts else None

    # 4. commit
    if layers and layout.tangent:
        for number in range(layout.n_states):
            rows, kept = solution_rows(lanes, coefficients, ir.Constant(I64, number))
            commit_solution(rows, kept, variation(rows, motion), step, keeps, layers.jump)
    step = step + layers.delay if layers else step
    is_done = is_last & ~crosses & ~keeps
    tau_1, low_1 = compensated_sum(tau, fma(lanes["omega"], step, tau_low))
    wraps = tau_1 >= 1.0
    tau_1 = where(is_done, end_tau, where(wraps, tau_1 - 1.0, tau_1))
    cycle_1 = where(is_done, end_cycle, where(wraps, cycle + 1.0, cycle))
    is_short = crosses & (step * lanes["rate"] < SHORT_STEP)
    one = step.constant(1.0)
    n_short = where(is_short, lanes["n_short"] + 1.0, 0.0 * one)
    is_fine = one <= one
    for i, value in enumerate(state):
        is_fine = is_fine & (
            absolute(value) <= x_bound if i < layout.n else absolute(value) < math.inf
        )
    is_bad = ~is_fine | is_stuck | (n_short > max_short)
    # an unclear lane ends here or earlier
    is_section = (cycle_1 > cycle) & (cycle_1 - lanes["record_clock"] >= -CLOCK_SLACK)
    is_recording = is_section | (cycle_1 + tau_1 - lanes["event_clock"] >= -CLOCK_SLACK)

    if layout.is_located:
        n_walls = _commit_contacts(lanes, modes, motion, exits, state)
    else:
        n_walls = exits.n_walls
        is_bad = is_bad | exits.has_pole
        n_short = where(exits.has_pole & is_fine, MODEL_INVALID, n_short)
        lanes["out_of_range"] = where(exits.is_out, 1.0, lanes["out_of_range"])
        if not layout.is_plain:
            for k, (end, _) in enumerate(exits.ends):
                lanes[layout.gap + k] = end
    before = lanes.rows("q") + lanes.rows("v") + lanes.rows("z")
    for i, (old, new) in enumerate(zip(before, state, strict=True)):
        lanes[layout.q + i] = where(keeps, old, new)
    for i, reach in enumerate(lanes.rows("reach")):
        lanes[layout.reach + i] = where(keeps, reach, maximum(reach, absolute(state[i])))
    lanes["tau"] = where(keeps, tau, tau_1)
    lanes["tau_low"] = where(keeps, tau_low, where(is_done, 0.0 * one, low_1))
    lanes["cycle"] = where(keeps, cycle, cycle_1)
    lanes["n_steps"] = lanes["n_steps"] + where(keeps, 0.0 * one, 1.0)
    lanes["n_contacts"] = lanes["n_contacts"] + n_walls
    if layout.is_damped:
        of_damping = modes.loss(lanes, motion.gaps, step)
        lost = lost + of_damping if lost else of_damping
    if lost:
        lanes["contact_loss"] = lanes["contact_loss"] + where(keeps, 0.0 * one, lost)
    lanes["n_short"] = where(keeps, lanes["n_short"], n_short)
    lanes["step"], lanes["tau_0"], lanes["cycle_0"] = step, tau, cycle

    if layers:
        layers.commit(state, exits.h, keeps)
        is_recording = is_recording & ~layers.repeats
    packed = (is_unclear if layout.is_located else exits.is_miscounted).bits()
    for k, mask in enumerate((is_done, is_bad & ~keeps, is_recording), start=1):
        packed = builder.or_(packed, builder.shl(mask.bits(), ir.Constant(I64, k * layout.width)))
    return packed


@intrinsic
def taylor_step(typingctx, at, lanes, coefficients, rtol, x_bound, max_short):
    """Advance every lane by one step.

    Parameters
    ----------
    at : RowLayout
    lanes : array, shape (at.n_rows, at.width)
        Parameters and state, updated in place.
    coefficients : array, shape (n * at.n_terms, at.width)
        Receives the Taylor coefficients of the kept series, then, with a tangent, those of every
        solution of the variational equation.
    rtol, x_bound, max_short : float
        Relative tolerance; bound of every |q|; cap on successive short contact steps.

    Returns
    -------
    int64
        Four masks of `at.width` bits, lowest first: lanes not advanced because a crossing is
        unclear, or, where contacts are not located, lanes whose walls may be miscounted; lanes at
        their end; lanes that failed; lanes that record (an unclear one perhaps).
    """
    signature = types.int64(at, lanes, coefficients, rtol, x_bound, max_short)

    def codegen(context, builder, signature, args):
        return _emit_step(builder, *rows_of(context, builder, signature, args), args[3:])

    return signature, codegen
