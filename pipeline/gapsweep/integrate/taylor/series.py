"""Taylor series of a motion within its contact modes.

Inside a mode the equation is polynomial, so the coefficients of q(t) follow from short
convolutions and from the series of the forcing [1]_::

    q'' = push(t) - C q' - K q - D z - sum cubic (a.q)^3 - sum pull K_c s(t) (b.q - wall)
    z'  = E q' + G q + H z

with all matrices per unit mass, and s(t) the periodic part of a contact's stiffness. Everything
here emits code for all lanes (`vectors`); sums over coordinates and degrees are unrolled.

References
----------
.. [1] A. Jorba, M. Zou, "A software package for the numerical integration of ODEs by means of
   high-order Taylor methods", Experimental Mathematics 14 (2005) 99-117.
"""

import math
from functools import reduce
from itertools import chain

from gapsweep.integrate.lanes.pieces import piece_series
from gapsweep.integrate.lanes.rows import dot
from gapsweep.integrate.vectors import (
    absolute,
    branch,
    copysign,
    floor,
    fma,
    maximum,
    nearest,
    rough_exp2,
    rough_log2,
    sqrt,
    where,
)
from gapsweep.model.contact_modes import HOLD, ON, SLACK

from .law_series import contact_forces
from .terms import product_term, square_term


def _cos_sin_of_period(tau):
    """cos and sin of 2 pi tau for tau in [0, 1], absolute error of a rounding."""
    quarter = nearest(tau * 4.0)
    angle = (tau * 4.0 - quarter) * (math.pi / 2)  # within pi/4
    square = angle * angle
    sine = square.constant((-1) ** 7 / math.factorial(15))
    cosine = square.constant((-1) ** 8 / math.factorial(16))
    for k in range(6, -1, -1):
        sine = fma(sine, square, (-1.0) ** k / math.factorial(2 * k + 1))
    for k in range(7, -1, -1):
        cosine = fma(cosine, square, (-1.0) ** k / math.factorial(2 * k))
    sine = sine * angle
    is_odd = quarter.equals(1.0) | quarter.equals(3.0)
    c, s = where(is_odd, sine, cosine), where(is_odd, cosine, sine)
    c = where(quarter.equals(1.0) | quarter.equals(2.0), -c, c)
    s = where(quarter.equals(2.0) | quarter.equals(3.0), -s, s)
    return c, s


def _harmonic(amplitudes, rate, turn, n_terms):
    """Series of ``amplitude * cos(2 pi turn + rate * t)`` for each amplitude.

    Parameters
    ----------
    rate : Vec
        [rad/s].
    turn : Vec
        Phase in periods, in [0, 1].
    """
    c, s = _cos_sin_of_period(turn)
    minus_square = -(rate * rate)
    series = [[a * c, -(a * rate * s)] for a in amplitudes]
    for terms in series:
        for n in range(n_terms - 2):
            terms.append(terms[n] * (minus_square * (1.0 / ((n + 1) * (n + 2)))))
    return series


def _harmonics(lanes, tau, amplitudes, n, names):
    """Series of sums of harmonics, for `n` quantities.

    Parameters
    ----------
    tau : Vec
        Phase of the clock at the beginning of the step.
    amplitudes : callable
        Function of the number of a harmonic that emits its `n` amplitudes.
    names : (str, str, str)
        Name of the number of harmonics, blocks of their multiples and phases; for a plain
        oscillator frequency and phase are those of the clock.
    """
    omega_rad, n_terms = lanes["omega_rad"], lanes.layout.n_terms - 2
    count, multiples, phases = names

    def add(index, totals):
        rate, turn = omega_rad, tau
        if not lanes.layout.is_plain:
            (multiple,), (phase,) = lanes.item(multiples, index), lanes.item(phases, index)
            rate, turn = omega_rad * multiple, fma(multiple, tau, phase)
            turn = turn - floor(turn)
        new = _harmonic(amplitudes(index), rate, turn, n_terms)
        return [a + b for a, b in zip(totals, chain(*new), strict=True)]

    nothing = [tau.constant(-0.0)] * (n * n_terms)  # -0.0 + x is x, also for x = -0.0
    flat = lanes.each(count, nothing, add)
    return [flat[i * n_terms : (i + 1) * n_terms] for i in range(n)]


def extend(equation, series, to):
    """Extend series to the degree of the step; the terms beyond it, up to the last row, are zero.

    Parameters
    ----------
    series : list of list of Vec
        All series that code after this reads.
    to : callable
        Function of a degree that emits the next terms of all series up to it.
    """
    low, *high = equation.degrees
    to(low)
    if not high:
        return
    sizes = [len(each) for each in series]

    def terms():
        return [term for each, size in zip(series, sizes, strict=True) for term in each[size:]]

    def further():
        to(*high)
        return terms()

    merged = branch(
        equation.zero.builder,
        equation.is_tight,
        further,
        lambda: [equation.zero] * len(terms()),
    )
    for each, size in zip(series, sizes, strict=True):
        n = len(each) - size
        each[size:], merged = merged[:n], merged[n:]


_HELD = 1e-14  # of an acceleration: what rounding leaves of it in a held direction
_TO_WALL = 2.0  # step in mode slack, over the time to the wall at the present speed


class Modes:
    """Contact modes at the beginning of a step: lists with an entry for every contact.

    Attributes
    ----------
    touching : list of Mask
    wall : list of Vec
        Wall in contact; 0 if none is: a wall at infinity is never touched.
    rest : list of Vec
        Place where the spring of this wall has no force: with a preload it is before the wall.
    lo, hi : list of Vec
        Interval of the gap that the mode allows.
    stiffness : list of Vec
        Stiffness of the wall in contact; 0 if none is.
    damping : list of Vec
        Damping of the wall in contact; 0 if none is. Empty for elastic contacts.
    chi : list of Vec
        Factor of depth times speed in the force, by depth and speed upwards; 0 if no wall is in
        contact. Empty where no contact has one.
    pressures : list of Pressure
        Forces that decide modes; empty without contacts that never pull.
    held : list of Mask
        Contacts in mode hold: code for single lanes decides where it ends. Empty without rigid
        walls and preloads.

    Where contacts are not located, no wall is in contact, and a mode has no ends. A wall in mode
    slack is not in contact.
    """

    def __init__(self, lanes, mode_rows="mode"):
        layout = lanes.layout
        self.touching, self.wall, self.lo, self.hi, self.stiffness = [], [], [], [], []
        self.pressures, self.held = [], []
        names = mode_rows, "lower", "upper", "lower_stiffness", "upper_stiffness"
        for mode, lower, upper, *stiffness in zip(*map(lanes.rows, names), strict=True):
            mode = mode if layout.is_located else 0.0 * mode
            above, below = mode > 0.0, mode < 0.0
            lo = where(above, upper, where(below, lower.constant(-math.inf), lower))
            hi = where(below, lower, where(above, upper.constant(math.inf), upper))
            if layout.has_slack:
                pressure = Pressure(lanes, len(self.lo), mode, (lower, upper), stiffness)
                lo, hi = (
                    where(pressure.decides, -math.inf, lo),
                    where(pressure.decides, math.inf, hi),
                )
                self.pressures.append(pressure)
            if layout.has_impacts:
                self.held.append(absolute(mode).equals(HOLD))
                lo = where(self.held[-1], -math.inf, lo)
                hi = where(self.held[-1], math.inf, hi)
            if layout.has_forces:
                above, below = mode.equals(ON), mode.equals(-ON)
            self.lo.append(lo)
            self.hi.append(hi)
            self.touching.append(above | below)
            self.stiffness.append(where(above, stiffness[1], where(below, stiffness[0], 0.0)))
            self.wall.append(where(above, upper, where(below, lower, 0.0)))
        self.rest = self.wall
        if layout.has_preload:
            rests = zip(
                self.touching,
                *map(lanes.rows, (mode_rows, "lower_rest", "upper_rest")),
                strict=True,
            )
            self.rest = [
                where(here, where(mode > 0.0, upper, lower), 0.0)
                for here, mode, lower, upper in rests
            ]
        damping = lanes.rows("contact_damping")
        self.damping = [
            where(here, c, 0.0) for here, c in zip(self.touching, damping, strict=False)
        ]

        self.chi = []
        for chi, stiffness, mode in zip(
            lanes.rows("chi"), self.stiffness, lanes.rows(mode_rows), strict=False
        ):
            self.chi.append(copysign(chi * stiffness, mode))

    def decay(self, lanes, energy):
        """Largest rate [1/s] at which contacts shrink volumes in state space, at an energy of the
        motion (doubled, see `Sizes`)."""
        rates = list(self.damping)
        for k, (chi, stiffness) in enumerate(zip(self.chi, self.stiffness, strict=False)):
            deepest = rough_exp2(0.5 * (rough_log2(energy) - rough_log2(stiffness)))
            rates[k] = rates[k] + where(stiffness > 0.0, absolute(chi) * deepest, 0.0)
        return self._summed(lanes, rates)

    def loss(self, lanes, gaps, step):
        """Integral of the rate at which contacts shrink volumes, over a step."""
        lost = [c * step for c in self.damping]
        for k, (chi, gap) in enumerate(zip(self.chi, gaps, strict=False)):
            mean = gap[-1] * (1.0 / len(gap))  # of the depth
            for n in range(len(gap) - 2, 0, -1):
                mean = fma(mean, step, gap[n] * (1.0 / (n + 1)))
            mean = fma(mean, step, gap[0] - self.wall[k])
            lost[k] = fma(chi, mean * step, lost[k])
        return self._summed(lanes, lost)

    @staticmethod
    def _summed(lanes, values):
        compliance = [1.0] if lanes.layout.is_plain else lanes.rows("compliance")
        pairs = zip(values, compliance, strict=True)
        return reduce(lambda a, b: a + b, [value * b for value, b in pairs])

    def watched(self, gaps):
        """For every contact, the series that may not leave an interval in the present mode.

        Returns
        -------
        list of (list of Vec, Vec, Vec)
            The gap, or the force where it decides, and both ends of the interval.
        """
        found = list(zip(gaps, self.lo, self.hi, strict=True))
        for k, pressure in enumerate(self.pressures):
            found[k] = pressure.watched(*found[k])
        return found


class Pressure:
    """The force of a contact that never pulls, as if it pulled: its zeros end modes on and slack.

    Attributes
    ----------
    decides, is_slack : Mask
        Whether the force ends the present mode *on*, which no wall ends then; whether the mode is
        *slack*.
    may_decide : Mask
        Whether the force or the wall ends the present mode *on*, as with a preload; None without
        preloads.
    lo, hi : Vec
        Interval of the force that the mode allows; infinite for modes that it does not end.
    """

    def __init__(self, lanes, contact, mode, walls, stiffness):
        layout = lanes.layout
        damping = lanes[layout.slack_damping + contact]
        above = mode > 0.0
        is_on = (damping > 0.0) & absolute(mode).equals(ON)
        self.is_slack = (damping > 0.0) & absolute(mode).equals(SLACK)
        is_watched = is_on | self.is_slack
        self._wall = self._rest = where(above, walls[1], walls[0])
        self.decides, self.may_decide = is_on, None
        if layout.has_preload:
            rests = lanes[layout.upper_rest + contact], lanes[layout.lower_rest + contact]
            self._rest = where(above, *rests)
            self.decides = is_on & ~(lanes[layout.preload + contact] > 0.0)
            self.may_decide = is_on & ~self.decides
        self._stiffness = where(is_watched, where(above, stiffness[1], stiffness[0]), 0.0)
        self._damping = where(is_watched, damping, 0.0)
        self._switched = lanes[layout.switched + contact] > 0.0
        pushes_up = (is_on & above) | (self.is_slack & ~above)
        self.lo = where(pushes_up, 0.0, mode.constant(-math.inf))
        self.hi = where(is_watched & ~pushes_up, 0.0, mode.constant(math.inf))

    def longest(self, gap, h):
        """Longest step in mode slack: twice the time to the wall at the present acceleration.

        In a much longer step, the proof that the gap passes the wall once would fail, and the
        crossing would be next to the beginning. At least a thousandth of the step `h`.
        """
        depth, speed = gap[0] - self._wall, gap[1]
        root = sqrt(maximum(fma(speed, speed, depth * gap[2] * -4.0), 0.0 * speed))
        leaves = absolute(depth) * (2.0 * _TO_WALL) / (absolute(speed) + root)
        return where(self.is_slack, maximum(leaves, h * 1e-3), h)

    def watched(self, gap, lo, hi):
        """Series and interval of the force where it decides, elsewhere those of the gap."""
        pairs = zip([*self.series(gap), self.lo, self.hi], [*gap, lo, hi], strict=True)
        *series, lo, hi = [where(self.decides, a, b) for a, b in pairs]
        return series, lo, hi

    def series(self, gap):
        """Series of the force, from the series of the gap."""
        terms = [self._stiffness * x for x in gap]
        terms[0] = self._stiffness * (gap[0] - self._rest)
        for n in range(len(gap) - 1):
            terms[n] = fma(self._damping * float(n + 1), gap[n + 1], terms[n])
        terms[0] = where(self._switched, 0.0, terms[0])
        return terms


class Spring:
    """A cubic spring of a system in a loop over all, whose series are kept in memory.

    Attributes
    ----------
    along, cubic : list of Vec
        Its direction a, and its factor of the cube, by coordinate.
    """

    ALONG, SQUARE, TANGENT = range(3)  # series of a.q, of its square, and of a.y of a tangent y

    def __init__(self, lanes, coefficients, index):
        n, self._n_terms = lanes.layout.n, lanes.layout.n_terms
        self.along, self.cubic = lanes.item("along", index, n), lanes.item("cubic", index, n)
        self._kept = coefficients.of_item("spring_series", index, 3 * self._n_terms)

    def series(self, which, n):
        """Return coefficients 0 to n of a series."""
        return [self._kept[which * self._n_terms + i] for i in range(n + 1)]

    def extended(self, which, n, term):
        """Keep coefficient n of a series; return it with all before."""
        self._kept[which * self._n_terms + n] = term
        return [*self.series(which, n - 1), term]


class Equation:
    """The equation of motion in the present modes, per unit mass: lists of rows of matrices.

    Attributes
    ----------
    stiffness, springs : list of list of Vec
        Stiffness of the springs only, and with the walls in contact.
    damping : list of list of Vec
    direction : list of list of Vec
        Directions of contacts; empty for a plain oscillator, where it is one.
    pull : list of list of Vec
        Acceleration by a unit force of each contact, by coordinate; empty for a plain oscillator.
    others : list of list of Vec
        Factors of the first-order states, by coordinate.
    cubic : list of list of Vec
        Factor of a plain oscillator's cube; of a system empty, see `each_spring`.
    lags : list of list of Vec
        Factors of speeds, coordinates and first-order states, by first-order state.
    rates : list of list of Vec
        Series of the contacts' stiffness where it is periodic, empty where it is constant.
    holding : list of list of Vec
        Inverse of B'M^-1 B of the held contacts, zero for others; empty without rigid walls.
    is_tight : value
        Condition of the larger one of the `degrees`.
    """

    def __init__(self, lanes, coefficients, modes, is_tight, clock="tau"):
        layout = lanes.layout
        self._lanes, self._coefficients, self._clock = lanes, coefficients, clock
        self.is_tight, self.degrees = is_tight, layout.degrees
        n, m = layout.n, layout.m
        self.zero = lanes["tau"].constant(0.0)
        self.damping, self.stiffness = lanes.matrix("damping", n), lanes.matrix("stiffness", n)
        self.others = lanes.matrix("lag_force", n)
        parts = (lanes.matrix(name, m) for name in ("of_speed", "of_place", "of_lag"))
        self.lags = [a + b + c for a, b, c in zip(*parts, strict=True)]
        self.is_plain = layout.is_plain
        self.direction = [] if self.is_plain else lanes.matrix("direction", layout.contacts)
        self.cubic = lanes.matrix("cubic", n) if self.is_plain else []
        self.pull = lanes.matrix("pull", n)
        self.holding = lanes.matrix("held", layout.contacts if layout.has_impacts else 0)
        self.is_located, self.chi = layout.is_located, modes.chi
        self.contact = modes.stiffness if self.is_located else [self.zero + 1.0] * layout.contacts
        self.rates = self._rates(lanes)
        if layout.is_damped:
            self.damping = self._with_contacts(self.damping, modes.damping)
        is_spring = self.is_located and not self.rates
        self.springs = self.stiffness
        if is_spring:
            self.springs = self._with_contacts(self.stiffness, self.contact)

    def forcing(self):
        """Series of the forcing, by coordinate."""
        lanes, n = self._lanes, self._lanes.layout.n
        found = self.harmonics(lambda i: lanes.item("push", i, n))
        if lanes.layout.pieces:
            for total, piece in zip(found, piece_series(lanes), strict=True):
                total[: len(piece)] = [a + b for a, b in zip(total, piece, strict=False)]
        return found

    def harmonics(self, amplitudes):
        """Series of loads with the amplitudes of a function of their number, by coordinate."""
        lanes, n = self._lanes, self._lanes.layout.n
        names = "harmonics", "multiple", "phase"
        return _harmonics(lanes, lanes[self._clock], amplitudes, n, names)

    def each_spring(self, totals, body):
        """Emit `body`, a function of a `Spring` and of totals, for every spring of a system."""
        lanes, kept = self._lanes, self._coefficients
        return lanes.each("cubics", totals, lambda i, now: body(Spring(lanes, kept, i), now))

    def _rates(self, lanes):
        layout = lanes.layout
        if not layout.modulations:
            return []

        def scaled(i):
            depths = lanes.item("depth", i, layout.contacts)
            return [k * d for k, d in zip(self.contact, depths, strict=True)]

        names = "modulations", "depth_multiple", "depth_phase"
        rates = _harmonics(lanes, lanes[self._clock], scaled, layout.contacts, names)
        return [
            [k + first, *others] for k, (first, *others) in zip(self.contact, rates, strict=True)
        ]

    def _with_contacts(self, matrix, factors):
        """A matrix of the equation plus the contacts', of which each has a factor."""
        if self.is_plain:
            return [[reduce(lambda a, b: a + b, factors, matrix[0][0])]]
        return [
            [
                dot(pull, [k * d[j] for k, d in zip(factors, self.direction, strict=True)], s)
                for j, s in enumerate(row)
            ]
            for row, pull in zip(matrix, self.pull, strict=True)
        ]

    def contact_forces(self, n, depths):
        """Coefficient n of contact forces that `springs` lacks, from the series of depths.

        Where contacts are not located, from the series of constant contacts' forces.
        """
        if self.rates:
            return [product_term(*pair, n) for pair in zip(self.rates, depths, strict=True)]
        if not self.is_located:
            return [force[n] for force in depths]
        # At degree 0 K (x - wall), not the difference of two large products.
        found = [] if n else [k * d[0] for k, d in zip(self.contact, depths, strict=True)]
        if not self.chi:
            return found
        rates = [product_term(depth, speeds(depth), n) for depth in depths]
        more = [chi * rate for chi, rate in zip(self.chi, rates, strict=True)]
        return [a + b for a, b in zip(found, more, strict=True)] if found else more

    def held(self, accelerations):
        """Return accelerations less those of held gaps, and the forces of all contacts for this."""
        if not self.holding:
            return accelerations, []
        along = accelerations
        if not self.is_plain:
            along = [dot(b, accelerations, self.zero) for b in self.direction]
        forces = [dot(row, along, self.zero) for row in self.holding]
        found = []
        for i, before in enumerate(accelerations):
            after = self.pulled(i, forces, before)
            found.append(where(absolute(after) <= absolute(before) * _HELD, 0.0, after))
        return found, forces

    def pulled(self, i, forces, total):
        """Return the acceleration `total` of coordinate i minus that due to contact forces."""
        for k, force in enumerate(forces):
            total = total - force if self.is_plain else fma(-self.pull[i][k], force, total)
        return total


def speeds(series):
    """Series of the rate of a series, as far as it is known."""
    return [term * float(n + 1) for n, term in enumerate(series[1:])]


class StepSeries:
    """Taylor coefficients of a step, lists from degree 0 on.

    Attributes
    ----------
    q, z : list of list of Vec
        Series of every coordinate and every first-order state, up to the largest degree.
    gaps : list of list of Vec
        Series of every contact's b.q; for a plain oscillator, of the coordinate.
    depths : list of list of Vec
        Series of every contact's b.q less the place without force of the spring in contact.
    square : list of Vec
        Series of the square of a plain oscillator's coordinate, up to two degrees less.
    laws : list of ContactForce
        Forces of contacts that are not located.
    forces : list of list of Vec
        Series of the forces that hold contacts on walls, upwards; empty without such walls.
    """

    laws = forces = _held = ()

    def __init__(self, lanes, modes, equation):
        layout = lanes.layout
        self.equation, self.forcing = equation, equation.forcing()
        self.q = [[x, v] for x, v in zip(lanes.rows("q"), lanes.rows("v"), strict=True)]
        self.z = [[z] for z in lanes.rows("z")]
        self.gaps = [self.q[0]] if layout.is_plain else [[g] for g in lanes.rows("gap")]
        self.depths = [[g[0] - w] for g, w in zip(self.gaps, modes.rest, strict=True)]
        self.laws = contact_forces(lanes, self.gaps)
        self._pressed = [law.force() for law in self.laws] or self.depths
        self.square, self._held = [], modes.held
        self.forces = [[] for _ in modes.held]
        others = [self.square] if layout.is_plain else self.gaps
        others = [*others, *self.forces]
        extend(equation, [*self.q, *self.z, *others], self._to)

    def _to(self, order):
        """Extend all series to a degree."""
        for n in range(len(self.q[0]) - 2, order - 1):
            self._project_gaps(n)
            if self.equation.chi:
                self._project_gaps(n + 1)
            self._extend(n)
            extend_lags(self.equation, self.q, self.z, n)
        extend_lags(self.equation, self.q, self.z, order - 1)
        for n in (order - 1, order):
            self._project_gaps(n)

    def _across(self, direction, n):
        """Coefficient n of the motion along a direction."""
        return dot(direction, [q[n] for q in self.q], self.equation.zero)

    def _project_gaps(self, n):
        if len(self.depths[0] if self.depths else ()) > n:
            return
        for k, direction in enumerate(self.equation.direction):
            term = self._across(direction, n)
            self.gaps[k].append(where(self._held[k], 0.0, term) if self._held else term)
        for depth, gap in zip(self.depths, self.gaps, strict=True):
            depth.append(gap[n])

    def _less_cubes(self, n, totals):
        """Accelerations less those due to cubic springs, of coefficient n."""
        if self.equation.is_plain:
            (x,), ((cubic,),), (total,) = self.q, self.equation.cubic, totals
            self.square.append(square_term(x, n))
            return [fma(-cubic, product_term(self.square, x, n), total)]

        def less(spring, totals):
            along = spring.extended(Spring.ALONG, n, self._across(spring.along, n))
            square = spring.extended(Spring.SQUARE, n, square_term(along, n))
            cube = product_term(square, along, n)
            return [fma(-a, cube, total) for a, total in zip(spring.cubic, totals, strict=True)]

        return self.equation.each_spring(totals, less)

    def _extend(self, n):
        """Append coefficient n + 2 to the series of the coordinates."""
        one = self.equation
        forces = one.contact_forces(n, self._pressed)
        totals = []
        for i, springs in enumerate(one.springs if n else one.stiffness):
            total = one.pulled(i, forces, self.forcing[i][n])
            for k, q in zip(springs, self.q, strict=True):
                total = fma(-k, q[n], total)
            for c, q in zip(one.damping[i], self.q, strict=True):
                total = fma(-c * float(n + 1), q[n + 1], total)
            for a, z in zip(one.others[i], self.z, strict=True):
                total = fma(-a, z[n], total)
            totals.append(total)
        accelerations, forces = one.held(self._less_cubes(n, totals))
        for series, force in zip(self.forces, forces, strict=True):
            series.append(force)
        for q, total in zip(self.q, accelerations, strict=True):
            q.append(total * (1.0 / ((n + 1) * (n + 2))))


def extend_lags(equation, q, z, n, source=None):
    """Append coefficient n + 1 to the series of the first-order states.

    `source` returns coefficient n of what else changes the states, by state.
    """
    if not z or len(z[0]) > n + 1:
        return
    state = [x[n + 1] * float(n + 1) for x in q] + [x[n] for x in q] + [x[n] for x in z]
    more = source(n) if source else [equation.zero] * len(z)
    rates = [dot(row, state, total) for row, total in zip(equation.lags, more, strict=True)]
    new = [rate * (1.0 / (n + 1)) for rate in rates]
    for series, term in zip(z, new, strict=True):
        series.append(term)
