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
from gapsweep.integrate.lanes.rows import LaneRows, dot, pointers, value_and_slope
from gapsweep.integrate.motions import VANISHED
from gapsweep.integrate.vectors import F64, I64, absolute, fma, mask_of, where

from .law_series import contact_forces
from .series import Equation, Modes, extend, extend_lags
from .terms import product_term, square_term


class _Factors:
    """Series with which the variational equation multiplies solutions.

    Attributes
    ----------
    squares : list of list of Vec
        Of (a.q)^2 of every cubic spring.
    slopes : list of list of Vec
        Of the slope of every contact's force, where contacts are not located.
    """

    def __init__(self, lanes, coefficients, one):
        layout = coefficients.layout
        along, self.squares = ([[] for _ in range(layout.cubics)] for _ in range(2))
        self.slopes = [[] for _ in layout.laws]
        gaps = [
            [
                coefficients[(layout.first_gap + k) * layout.n_terms + n]
                for n in range(layout.n_terms)
            ]
            for k in range(len(layout.laws))
        ]
        laws = [law.slope() for law in contact_forces(lanes, gaps)]

        def to(order):
            for n in range(len((self.squares + self.slopes)[0]), order - 1):
                q = [coefficients[i * layout.n_terms + n] for i in range(layout.n)]
                for number, (terms, square) in enumerate(zip(along, self.squares, strict=True)):
                    terms.append(dot(one.along[number], q, one.zero) if one.along else q[0])
                    square.append(square_term(terms, n))
                for terms, law in zip(self.slopes, laws, strict=True):
                    terms.append(law[n])

        if self.squares + self.slopes:
            extend(one, self.squares + self.slopes, to)


def _variation(lanes, one, factors):
    """Series, of coordinates and of first-order states, of the solution in the first rows."""
    layout = lanes.layout
    state = [lanes[layout.tangent_state + i] for i in range(layout.n_states)]
    y = [[state[i], state[layout.n + i]] for i in range(layout.n)]
    z = [[value] for value in state[2 * layout.n :]]
    gaps, along = [[] for _ in range(layout.contacts)], [[] for _ in range(layout.cubics)]
    pressed = gaps
    if factors.slopes:
        pressed = [[] for _ in gaps]

    def to(order):
        for n in range(len(y[0]) - 2, order - 1):
            for series, directions in ((gaps, one.direction), (along, one.along)):
                for k, terms in enumerate(series):
                    place = [x[n] for x in y]
                    terms.append(dot(directions[k], place, one.zero) if directions else place[0])
            bends = [product_term(*pair, n) for pair in zip(factors.squares, along, strict=True)]
            for terms, *pair in zip(pressed, factors.slopes, gaps, strict=False):
                terms.append(product_term(*pair, n))
            is_spring = one.is_located and not one.rates
            forces = [] if is_spring else one.contact_forces(n, pressed)
            new = []
            for i, springs in enumerate(one.springs):
                total = None
                for k, x in zip(springs, y, strict=True):
                    total = k * x[n] if total is None else fma(k, x[n], total)
                for a, bend in zip(one.cubic[i], bends, strict=True):
                    total = fma(a * 3.0, bend, total)
                for c, x in zip(one.damping[i], y, strict=True):
                    total = fma(c * float(n + 1), x[n + 1], total)
                for a, x in zip(one.others[i], z, strict=False):
                    total = fma(a, x[n], total)
                total = one.pulled(i, forces, -total)
                new.append(total * (1.0 / ((n + 1) * (n + 2))))
            extend_lags(one, y, z, n)
            for series, term in zip(y, new, strict=True):
                series.append(term)
        extend_lags(one, y, z, order - 1)

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
        Function of the end state that returns the state after a layer.
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
        rows, series = (
            LaneRows(builder, p, layout) for p in pointers(context, builder, signature, args)
        )
        is_tight = builder.fcmp_ordered("<", args[3], ir.Constant(F64, layout.tight))
        one = Equation(rows, Modes(rows, "mode_0"), is_tight, "tau_0")
        factors, step = _Factors(rows, series, one), rows["step"]
        keeps = mask_of(builder, args[4], layout.width)

        def advance(number):
            solution, kept = solution_rows(rows, series, number)
            commit_solution(solution, kept, _variation(solution, one, factors), step, keeps)

        if layout.is_plain:  # a loop would take a tenth longer
            advance(ir.Constant(I64, 0))
            advance(ir.Constant(I64, 1))
        else:
            with cgutils.for_range(builder, ir.Constant(I64, layout.n_states)) as loop:
                advance(loop.index)
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
