"""Taylor series of an oscillator whose contact force is smoothed by tanh, and its thin layers.

At a distance y beyond a wall of stiffness K the force is ``K y (1 + tanh(eps y)) / 2``. In a
contact mode, in which y has the sign s, that is the exact force less::

    K |y| p,    p = 1 / (1 + exp(2 eps s y)),    dp/dt = -2 eps s v (p - p^2)

so that the series need two more products for each wall. *Near* lanes compute them.

*Far* lanes have the series of the exact force. Outside the layers ``|y| < w`` that is the force to
the tolerance, and a layer that is crossed fast acts as a step of the potential does. With
``k = K / mass`` and, away from the gap, velocity v and acceleration a at the wall, the layer adds
to ``v^2 / 2`` and to the time::

    +- pi^2/24 k / eps^2 - I (da/dt + c a) k / (eps^4 v^3),    -3 I a k / (eps^4 v^5) + ..

with + into contact, - out of it, the damping c and the change da/dt of the forcing. The first term
holds for any v, because the force depends on the place only. The others come from what the layer
does to speed and time meanwhile, integrated over the layer: at the wall itself it has added
``-+ J k / (eps^3 v^3)`` to the time. The smoothing is even in y: what follows is smaller by
``kappa = k / (eps v)^2`` or by the square of ``beta = a / (eps v^2)``.

A far lane whose step turns back in a layer or crosses it too slowly repeats it as a near one.
"""

import math
from dataclasses import dataclass
from typing import Any

from gapsweep.integrate.elementary import exp
from gapsweep.integrate.lanes.rows import value_and_slope
from gapsweep.integrate.vectors import (
    absolute,
    branch,
    copysign,
    fma,
    is_nonzero,
    minimum,
    nearest,
    sqrt,
    where,
)

from .series import StepSeries, extend
from .terms import product_term, square_term

# With w(y), the integral of s / (1 + exp(2 s)) from y to infinity, and integrals over y from 0 on:
# I = 2 int(y w), and of the delay k^2 / (eps v)^5: 3/2 int(y^2 w - pi^2/12 w + 2 w^2).
# J = int(w).
_MOMENT, _FURTHER, _HALFWAY = 7 * math.pi**4 / 1920, 0.17632061159, 0.225385669342
_HIGHER_ORDERS = 4.0, 30.0  # of the neglected part of a delay: factors of kappa and of beta^2
_SHARE = 0.1  # of a step's tolerance, for the neglected higher orders
_MOST_BENT = 0.1  # largest beta


def _bend_and_jerk(series, t):
    """Second and third derivative of a polynomial at t."""
    bend, jerk = None, None
    for n in range(len(series) - 1, 1, -1):
        term = series[n] * float(n * (n - 1))
        if bend is not None:
            jerk = bend if jerk is None else fma(jerk, t, bend)
        bend = term if bend is None else fma(bend, t, term)
    return bend, jerk


@dataclass(frozen=True)
class _Share:
    """Part ``force * depth * p`` by which smoothing reduces a wall's force (see the module).

    Attributes
    ----------
    p, slope : list of Vec
        Series of p and of its derivative by the place.
    force, offset : Vec
        The wall's stiffness with the sign of the depth, and that times the position of the wall.
    depth : Vec
        Displacement beyond the wall at the beginning of the step.
    rate : Vec
        ``-2 eps s``.
    """

    p: list
    slope: list
    force: Any
    offset: Any
    depth: Any
    rate: Any

    def extend(self, n, speed):
        """Append coefficient n + 1 of p."""
        self.slope.append((self.p[n] - square_term(self.p, n)) * self.rate)
        self.p.append(product_term(self.slope, speed, n) * (1.0 / (n + 1)))


def _both(values):
    """Sum over both walls, equal to the last bit for a motion and its mirror image."""
    upper, lower = values
    return upper + lower


class TanhMotion(StepSeries):
    """Taylor coefficients of a step of an oscillator with a contact smoothed by tanh.

    Attributes
    ----------
    is_near : Mask
    slope : list of Vec
        Series of the slope of the force without linear springs and the present contact. Only with a
        tangent, as `stiffening`.
    stiffening : Vec
        Largest stiffness that the layers add within the step.
    """

    def __init__(self, lanes, modes, equation):
        self.equation, self.forcing, self.z = equation, equation.forcing(), []
        self.is_near = lanes["is_near"] > 0.0
        x = [lanes["q"], lanes["v"]]
        self.q, self.gaps, self.depths = [x], [x], [[x[0] - modes.wall[0]]]
        if lanes.layout.tangent:
            zero = equation.zero
            shares = self._shares(lanes)
            x += self._further(shares)
            self.slope = self._slope(shares)
            # p within the step: its depth halves and loses two layers more, see `Layers`
            reached = [minimum(sqrt(share.p[0]) * math.exp(4.0), zero + 1.0) for share in shares]
            pairs = zip(shares, reached, strict=True)
            self.stiffening = _both(absolute(share.force) * part for share, part in pairs)
        else:
            x += branch(
                lanes.builder,
                is_nonzero(lanes.builder, self.is_near.bits()),
                lambda: self._further(self._shares(lanes)),
                lambda: self._further([]),
            )

    def _shares(self, lanes):
        """Return the `_Share` of both walls, zero in far lanes."""
        zero, mode, x = self.equation.zero, lanes["mode"], self.q[0][0]
        sides = where(mode > 0.0, zero + 1.0, -1.0), where(mode < 0.0, zero + 1.0, -1.0)
        shares = []
        for name, side, way in zip(("upper", "lower"), sides, (1.0, -1.0), strict=True):
            wall, force = lanes[name], lanes[f"{name}_stiffness"] * side
            depth, rate = x - wall, -(side * way) * lanes["sharpness"]
            e = exp(rate * depth)
            p = where(self.is_near, e / (e + 1.0), 0.0)
            shares.append(_Share([p], [], force, force * wall, depth, rate))
        return shares

    def _further(self, shares):
        """Return the Taylor coefficients of the displacement from degree 2 on."""
        one, x = self.equation, list(self.q[0][:2])
        (contact,), ((depth, *_),), cubic = one.contact, self.depths, one.cubic[0][0]
        speed, bend, self.square = [], [], []

        def to(order):
            for n in range(len(x) - 2, order - 1):
                speed.append(x[n + 1] * float(n + 1))
                self.square.append(square_term(x, n))
                bend.append(cubic * self.square[n])
                total = fma(-one.damping[0][0], speed[n], self.forcing[0][n])
                if n == 0:
                    # K (x - wall), not the difference of two large products
                    total = fma(-contact, depth, total)
                    total = fma(-one.stiffness[0][0], x[0], fma(-bend[0], x[0], total))
                else:
                    total = fma(-one.springs[0][0], x[n], total)
                if shares:
                    bend[n] = bend[n] - _both(share.force * share.p[n] for share in shares)
                    if n == 0:
                        total = total + _both(
                            share.force * share.p[0] * share.depth for share in shares
                        )
                    else:
                        total = total - _both(share.offset * share.p[n] for share in shares)
                    for share in shares:
                        share.extend(n, speed)
                total = total - product_term(bend, x, n) if n else total
                x.append(total * (1.0 / ((n + 1) * (n + 2))))

        parts = [part for share in shares for part in (share.p, share.slope)]
        extend(one, [x, self.square, *parts], to)
        return x[2:]

    def _slope(self, shares):
        (x,), cubic, terms = self.q, self.equation.cubic[0][0] * 3.0, []
        steep = []
        for n, square in enumerate(self.square):
            steep.append(_both(share.force * share.slope[n] for share in shares))
            total = fma(cubic, square, -product_term(steep, x, n))
            total = total - _both(share.force * share.p[n] for share in shares)
            total = total + _both(share.offset * share.slope[n] for share in shares)
            terms.append(total)
        return terms


def variation(lanes, motion):
    """Series of the solution in the tangent's first rows, along a `TanhMotion`."""
    one, first = motion.equation, lanes.layout.tangent_state
    y, slope = [lanes[first], lanes[first + 1]], motion.slope
    springs, damping = one.springs[0][0], one.damping[0][0]

    def to(order):
        for n in range(len(y) - 2, order - 1):
            total = fma(springs, y[n], product_term(slope, y, n))
            total = -fma(damping * float(n + 1), y[n + 1], total)
            y.append(total * (1.0 / ((n + 1) * (n + 2))))

    extend(one, [y], to)
    return [y], []


class Layers:
    """Smoothing layers in a step: longest step, lanes that repeat it, and crossings of layers.

    Attributes
    ----------
    longest : Vec
        Longest step [s] of a near lane: it comes closer to a wall by at most half its distance and
        two layers more, as the series does not show a layer that is still far away; and of a far
        lane that repeats a step within a layer.
    repeats : Mask
        Far lanes that repeat the step: as near ones, or shorter on the way out of a layer.
    delay : Vec
        Time that the layer adds to the step [s].
    """

    def __init__(self, lanes, modes, motion):
        self.lanes, self.modes, self.motion = lanes, modes, motion
        self.width = lanes["layer"]
        self.length = self.width.constant(2.0) / lanes["sharpness"]
        x, v, bend = motion.q[0][:3]
        to_wall = minimum(absolute(x - lanes["lower"]), absolute(x - lanes["upper"]))
        most = fma(to_wall, 0.25, self.length)
        longest = minimum(most / absolute(v), sqrt(most / absolute(bend)))
        self.longest = where(motion.is_near, longest, lanes["longest"])
        # A far lane leaves a layer that it has crossed: its state already includes the layer.
        self._is_leaving = (to_wall <= self.width) & ~motion.is_near

    def ends_in_one(self, shape, h):
        """Whether a step of far lanes ends in a layer that it has not crossed."""
        x, _ = value_and_slope(self.motion.q[0], h)
        (lo,), (hi,) = self.modes.lo, self.modes.hi
        is_low = (x > lo) & (x < lo + self.width) & ~shape.rises
        is_high = (x < hi) & (x > hi - self.width) & ~shape.falls
        return (is_low | is_high) & ~self.motion.is_near

    def cross(self, exits, left, tolerance):
        """Move far lanes that pass a wall across its layer; mark lanes that repeat the step.

        Parameters
        ----------
        exits : _Exits
            Changed accordingly.
        left : Vec
            Time until the end of the point [s].
        tolerance : Vec
            Tolerance of a step's velocity [m/s].
        """
        (side,), ((x, v),) = exits.sides, exits.ends
        none = 0.0 * v
        self.repeats, v, self.delay, self._lag, self._stretch, self._turn = branch(
            v.builder,
            is_nonzero(v.builder, (~self.motion.is_near).bits()),
            lambda: self._crossed(exits, left, tolerance),
            lambda: (v < v, v, none, none, none + 1.0, none),
        )
        exits.crosses = exits.crosses & ~self.repeats
        exits.is_unclear = exits.is_unclear & ~self.repeats
        exits.passes, exits.sides = [exits.crosses], [where(exits.crosses, side, 0.0)]
        exits.ends = [(x, v)]

    def _crossed(self, exits, left, tolerance):
        """Return the lanes that repeat the step, and the changes at the end of the step."""
        (side,), ((x, v),) = exits.sides, exits.ends
        passage = self._passage(side, x, v, exits.step, left, tolerance)
        is_fast, after, delay, lag, bend = passage
        (shape,), (lo,), (hi,) = exits.shapes, self.modes.lo, self.modes.hi
        lo, hi = lo + self.width, hi - self.width
        # as in `_Shape`, or on the way out of a layer that was crossed
        is_above = (shape.bottom >= lo) | shape.rises
        is_above = is_above | ((shape.falls | shape.is_concave) & (x >= lo))
        is_below = (shape.top <= hi) | shape.falls
        is_below = is_below | ((shape.rises | shape.is_convex) & (x <= hi))
        is_clear = (is_above | (is_fast & (side < 0.0))) & (is_below | (is_fast & (side > 0.0)))
        is_near = self.motion.is_near
        repeats = ~(is_near | (is_clear & ~exits.is_unclear))
        is_across = exits.crosses & ~(is_near | repeats)
        # Variational equation: displacements are scaled as the speed is, areas are conserved. The
        # accelerations on both sides differ only by the damping.
        turn = bend - self.motion.equation.damping[0][0] * (after - v) - bend * v / after
        changes = (after, v), (delay, 0.0), (lag, 0.0), (after / v, 1.0), (turn / v, 0.0)
        return repeats, *(where(is_across, *change) for change in changes)

    def _passage(self, side, wall, v, t, left, tolerance):
        """Return the lanes that cross a layer fast enough, and the changes of speed and time."""
        lanes, length, width = self.lanes, self.length, self.width
        (touching,), (touched,) = self.modes.touching, self.modes.stiffness
        upper, lower = lanes["upper_stiffness"], lanes["lower_stiffness"]
        k = where(touching, touched, where(side > 0.0, upper, lower))
        k_l = k * length  # [m/s^2]
        jump = k_l * length * where(touching, v.constant(-(math.pi**2) / 12), math.pi**2 / 12)
        square = fma(v, v, jump)
        outward = where(touching, -side, side)
        bend, jerk = _bend_and_jerk(self.motion.q[0], t)
        hurry = absolute(fma(touched, v, jerk))  # without contact, as `bend` is at the wall
        springs = fma(lanes["cubic"] * 3.0, wall * wall, lanes["stiffness"] + touched)
        push = outward * (jerk + springs * v + lanes["damping"] * bend * 2.0)
        outward = outward * bend
        middle = fma(v, v, jump * 0.5)
        speed = sqrt(middle)
        rate = k_l * (length * length * length) / (middle * middle)  # [m] per m/s^2
        after = copysign(sqrt(fma(rate * speed * -2.0 * _MOMENT, push, square)), v)
        delay = rate * fma(-outward, 3.0 * _MOMENT, k_l * _FURTHER) / speed
        lag = where(touching, rate, -rate) * speed * _HALFWAY / length - delay
        size = rate * fma(absolute(outward), 3.0 * _MOMENT, k_l * _FURTHER)
        beta, kappa = absolute(outward) * length / middle, k_l * length / middle
        left_out = size * fma(beta * beta, _HIGHER_ORDERS[1], kappa * _HIGHER_ORDERS[0])
        is_fast = left_out * lanes["rate"] <= tolerance * _SHARE
        is_fast = is_fast & (beta <= _MOST_BENT) & (kappa <= _MOST_BENT)
        # It turns back beyond the layer, the other wall's layer is farther, and no section point or
        # end of the motion falls within.
        # Slowed down by the contact, by the acceleration at the wall and by its growth, it
        # needs v^2 = k w^2, 2 |a| w and 9 |a'| w^2 / (8 |v|) to get through a layer of width w.
        braking = fma(hurry * 3.0, width / speed, fma(k, width * 1.5, absolute(outward) * 3.0))
        is_fast = is_fast & (middle >= braking * width)
        is_fast = is_fast & (lanes["upper"] - lanes["lower"] >= width * 4.0)
        turned = fma(lanes["omega"], t, lanes["tau"])
        until = absolute(turned - nearest(turned)) * lanes["period"]
        is_fast = is_fast & (minimum(until, left - t) * absolute(v) >= width * 2.0)
        return is_fast, after, delay, lag, bend

    def jump(self, y, v):
        """Return a solution of the variational equation after the layer, from that before it."""
        return y * self._stretch, fma(self._turn, y, v / self._stretch)

    def commit(self, state, h, keeps):
        """Store which lanes are near.

        Parameters
        ----------
        state : list of Vec
            Displacement and velocity at the end of the step.
        h : Vec
            The step that was tried [s].
        keeps : Mask
            Lanes that do not move in this step.
        """
        lanes, (x, v) = self.lanes, state
        above, below = x - lanes["upper"], x - lanes["lower"]
        is_out = minimum(absolute(above), absolute(below)) > self.width
        leaves = where(absolute(above) < absolute(below), above, below) * v > 0.0
        is_near = where(is_out & leaves & ~keeps, 0.0, lanes["is_near"])
        lanes["is_near"] = where(self.repeats & ~self._is_leaving, 1.0, is_near)
        lanes["longest"] = where(self.repeats & self._is_leaving, h * 0.5, math.inf)
        lanes["lag"] = self._lag
