"""Step size of the Taylor series method."""

import math
from functools import reduce

from gapsweep.integrate.lanes.parameters import WALL_HIGH, WALL_LOW
from gapsweep.integrate.lanes.rows import dot
from gapsweep.integrate.vectors import (
    absolute,
    fma,
    maximum,
    minimum,
    rough_exp2,
    rough_log2,
    sqrt,
)

# The step size comes from terms that the step still contains, h^N and h^(N-1). With this factor
# the energy of a free swing is kept to some 20 rtol over 50 cycles, whatever the spring.
SAFETY = 0.5
_STEPS_PER_PERIOD = 8192  # at a stiff wall: over so many the tangent's errors come to about rtol
# How much closer to a wall with a smoothing layer a step may come: part of its distance, and
# layers. At its beginning the series shows little of a layer that is still far away.
_CLOSER, _LAYERS = 0.75, 4.0
_POLE = 1.854  # K(1/2), complete elliptic integral: of the stiffest, purely cubic swing


def _rough_root(a):
    return rough_exp2(rough_log2(a) * 0.5)


def _reach(energy, stiffness, cubic):
    """Displacement that springs allow a state of an energy (doubled, see `Sizes`), to 6 %."""
    root = _rough_root(fma(stiffness, stiffness, cubic * energy * 2.0))
    return rough_exp2((rough_log2(energy) + 1.0 - rough_log2(stiffness + root)) * 0.5)


class Sizes:
    """Scales of the errors of a step.

    An error is relative to the largest speed and displacement that the state would reach on the
    springs only, because v vanishes at an extremum and x at a wall. Both follow from the energy,
    doubled and, for a plain oscillator, per unit mass:
    ``v^2 + stiffness depth^2 + cubic depth^4 / 2``.

    Attributes
    ----------
    speed : Vec
        Largest speed [m/s]; for several coordinates in their mass norm, as all velocities here.
    springs, hardening : Vec
        Squares of the fastest rate of disturbances, and of the cubic springs' part in it [1/s^2].
    damping : Vec
        Decay rate of disturbances [1/s].
    """

    def __init__(self, lanes, modes, motion):
        if lanes.layout.is_plain:
            self._of_one(lanes, modes, motion)
        else:
            self._of_many(lanes, modes, motion)
        if motion.laws:
            self._add_laws(lanes, motion)

    def _of_one(self, lanes, modes, motion):
        # In contact the depth is what counts: an error of x there is one of a much larger force.
        (contact,), (wall,), ((place, *_),) = modes.stiffness, modes.wall, motion.gaps
        depth = place - wall
        v, cubic, stiffness = lanes["v"], absolute(lanes["cubic"]), lanes["stiffness"]
        at_wall = contact + cubic * (wall * wall) * 3.0
        square, total = depth * depth, stiffness + at_wall
        energy = fma(v, v, fma(cubic * 0.5, square, total) * square)
        self.speed = _rough_root(energy)
        farthest = absolute(wall) + _reach(energy, total, cubic)
        self.hardening = cubic * (farthest * farthest)
        self.springs = fma(self.hardening, 3.0, stiffness + contact)
        self.damping = lanes["damping"]
        if lanes.layout.is_damped:
            self.damping = self.damping + modes.decay(lanes, energy)

    def _add_laws(self, lanes, motion):
        """Add energy and stiffness of contacts that are not located."""
        names = "lower", "upper", "lower_stiffness", "upper_stiffness"
        energy = self.speed * self.speed
        for gap, lower, upper, below, above in zip(
            motion.gaps, *map(lanes.rows, names), strict=True
        ):
            depth = maximum(gap[0] - upper, 0.0 * upper)
            energy = fma(above, depth * depth, energy)
            depth = maximum(lower - gap[0], 0.0 * lower)
            energy = fma(below, depth * depth, energy)
        self.speed = _rough_root(energy)
        compliances = [1.0] if lanes.layout.is_plain else lanes.rows("compliance")
        for law, gap, compliance in zip(motion.laws, motion.gaps, compliances, strict=True):
            self.springs = self.springs + absolute(law.value("slope", gap[0])) * compliance

    def _of_many(self, lanes, modes, motion):
        place, speed = [q[0] for q in motion.q], [q[1] for q in motion.q]
        energy = _square_norm(lanes, "mass_root", speed)
        energy = energy + _square_norm(lanes, "spring_root", place)
        for contact, gap, wall in zip(modes.stiffness, motion.gaps, modes.wall, strict=True):
            depth = gap[0] - wall
            energy = fma(contact, depth * depth, energy)

        def alpha_of(spring):
            (alpha,) = lanes.item("alpha", spring)
            return absolute(alpha)

        def stored(spring, totals):
            (total,), along = totals, lanes.item("along", spring, len(place))
            depth = dot(along, place, 0.0 * total)
            square = depth * depth
            return [fma(alpha_of(spring) * 0.5, square * square, total)]

        (energy,) = lanes.each("cubics", [energy], stored)

        def hardened(spring, totals):
            (total,), alpha = totals, alpha_of(spring)
            (holding,), (softness,) = lanes.item("holding", spring), lanes.item("softness", spring)
            reach = _reach(energy, holding, alpha)
            return [fma(alpha * softness, reach * reach, total)]

        self.speed = _rough_root(energy)
        (self.hardening,) = lanes.each("cubics", [0.0 * energy], hardened)
        self.springs = fma(self.hardening, 3.0, lanes["fastest"])
        for contact, compliance in zip(modes.stiffness, lanes.rows("compliance"), strict=True):
            self.springs = self.springs + contact * compliance
        self.damping = lanes["decay"]
        if lanes.layout.is_damped:
            self.damping = self.damping + modes.decay(lanes, energy)


def _square_norm(lanes, block, values):
    """Squared norm of a vector; `block` holds the root of its matrix."""
    total = None
    for row in lanes.matrix(block, len(values)):
        part = dot(row, values, values[0].constant(0.0))
        total = part * part if total is None else fma(part, part, total)
    return total


def _log_speed(lanes, motion, n):
    """Base-2 logarithm of the norm of coefficient n of the coordinates."""
    terms = [q[n] for q in motion.q]
    if lanes.layout.is_plain:
        return rough_log2(absolute(terms[0]))
    return rough_log2(_square_norm(lanes, "mass_root", terms)) * 0.5


def _off_grid(logarithm):
    """Round a logarithm down to 20 bits, plus a quarter of the last bit.

    `rough_log2` and `rough_exp2` round to 20 bits. Quotients in between then never lie halfway
    between two results, where the last bit of a double would decide: a motion whose time is scaled
    by two takes the same steps.
    """
    return (math.floor(logarithm * 2**20) + 0.25) * 2.0**-20


def longest_step(motion):
    """Longest step [s] of gaps near smoothing layers, see `_CLOSER`; infinite without layers."""
    found = motion.q[0][0].constant(math.inf)
    for law, (x, v, bend, *_) in zip(motion.laws, motion.gaps, strict=True):
        if law.sharpness is not None:
            to_wall = minimum(*(absolute(x - law.row(wall)) for wall in (WALL_LOW, WALL_HIGH)))
            # half of it by the speed, half by the acceleration
            most = fma(to_wall, 0.5 * _CLOSER, 0.5 * _LAYERS / law.sharpness)
            found = minimum(found, minimum(most / absolute(v), sqrt(most / absolute(bend))))
    return found


def step_size(lanes, motion, sizes, rtol, order):
    """Largest h [s] (to about 6 %) for which the motion and the growth of errors are accurate.

    The last two terms of the velocity stay below `rtol` of the speed; within an oscillation an
    error of x is smaller relative to its scale. Two more bounds hold, because those terms may
    vanish:

    - A disturbance (an earlier step's error, the tangent) oscillates and decays no faster than the
      larger of ``sqrt(springs)`` and `damping`, and h is no longer than a series of degree `order`
      can follow it. Where x itself is slow or straight, disturbances would be wrong otherwise.
    - A cubic spring swings like an elliptic cosine, whose poles lie `_POLE` over the root of
      `hardening` from the real axis: terms fall no faster than powers of h over that.

    A contact smoothed by tanh has its poles at imaginary depths. In a motion from rest on the wall
    the depth is the square of time, and three terms in four vanish. So the two terms before the
    last ones count too, with the size that they would have in a geometric series.

    Errors of first-order states stay below `rtol` of their size, or of their change in a radian.
    """
    log_error = rough_log2(rtol * SAFETY)
    log_scale = rough_log2(fma(sizes.speed, rtol, lanes["floor"]) * SAFETY)
    log_tangent = log_error - math.log2(_STEPS_PER_PERIOD)
    log_carried = (log_tangent + math.log2(math.factorial(order + 1))) * (1.0 / (order + 1))
    log_ratio = (log_error - math.log2(1.2 * (order + 1))) * (1.0 / order) + math.log2(_POLE)
    log_rate = maximum(rough_log2(sizes.springs) * 0.5, rough_log2(sizes.damping))
    limits = [
        (log_scale - _off_grid(math.log2(n)) - _log_speed(lanes, motion, n)) * (1.0 / (n - 1))
        for n in (order, order - 1)
    ]
    if lanes.layout.is_smooth:
        for n in (order - 2, order - 3):
            log_n = log_scale - log_error * ((order - n) / (order - 1)) - math.log2(n)
            limits.append((log_n - _log_speed(lanes, motion, n)) * (1.0 / (n - 1)))
    limits.append(log_carried - log_rate)
    limits.append(log_ratio - rough_log2(sizes.hardening) * 0.5)
    for z, floor in zip(motion.z, lanes.rows("lag_floor"), strict=True):
        size = fma(absolute(z[0]) + absolute(z[1]) / lanes["rate"], rtol, floor)
        log_size = rough_log2(size * SAFETY)
        limits += [(log_size - rough_log2(absolute(z[n]))) * (1.0 / n) for n in (order, order - 1)]
    return rough_exp2(reduce(minimum, limits))
