"""Compiled contact laws: acceleration ``F_c(x) / m`` and its slope, for all lanes at once.

Each law is a named tuple *type*, and `acceleration` is an overload that looks at the type alone. So
the stepping loop is one numba function with one specialisation per law: the law is inlined, and
numba's disk cache finds the specialisation in another process (a law passed as a function would be
a
new type, hence a cache miss, in every process).

What differs from point to point sits in the rows of a parameter block `q`, for every contact of
shape (N_PARAMETERS, WIDTH); what a batch shares (fit coefficients) sits in the named tuple.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numba.extending import overload
from numpy.typing import NDArray

from gapsweep.integrate import simd
from gapsweep.integrate.simd import bits, fma, load, select

from . import vecmath

# Rows of the parameter block.
STIFFNESS = 0  # K_c / m of the upper wall [1/s^2]; 1 / m for a fit or a user's law
WALL_LOW, WALL_HIGH = 1, 2  # -j_1 and j_2 [m]
SHARPNESS = 3  # epsilon or gamma [1/m]
CENTRE, HALF_GAP, DECAY = 4, 5, 6  # tanh: of the gap [m, m, -]; tables: centre of the range
OFFSET = 4  # log-arctan: A_c [m]
# Located contact: of the present mode, and the mode itself (1 upper wall, -1 lower wall, 0 none): a
# wall may have no stiffness or lie at zero, so neither tells whether it is touched.
ACTIVE_STIFFNESS, ACTIVE_WALL, ACTIVE_MODE = 3, 4, 5
LAYER = 7  # half-width of the smoothing layer around each wall [m]; 0: none
RANGE = 8  # fits and tables: half of the range in which they hold [m]; 0: no range
SATURATION = 9  # tanh: distance from a wall beyond which the law is exactly piecewise [m]
RATIO = 10  # stiffness of the lower wall over that of the upper
N_PARAMETERS = 11

_INV_PI = 0.3183098861837907
# |epsilon (x - j)| from which tanh is exactly +-1 in double precision, so the force exactly
# piecewise.
TANH_SATURATION = 19.0625
# arctan only decays like 1/z and never saturates: nothing may be skipped. Within 4 units of the
# wall it turns by 84 %; outside that the remaining curvature is on the scale of the distance
# itself,
# which the error estimate sees.
ARCTAN_LAYER = 4.0


@dataclass(frozen=True, slots=True)
class Law:
    """A law with its numbers, ready for the loop; see the constructors in `representations`."""

    kind: Any
    q: NDArray[np.float64]

    def rows(self, mass: NDArray[np.float64], n: int) -> NDArray[np.float64]:
        """Parameter rows of n points, stiffness over mass, shape (n, N_PARAMETERS)."""
        rows = np.array(np.broadcast_to(self.q, (n, N_PARAMETERS)))
        rows[:, STIFFNESS] /= mass
        return rows


class Tanh(NamedTuple):
    """Walls smoothed with tanh; `unused` only because numba has no empty named tuple."""

    unused: float = 0.0


class Arctan(NamedTuple):
    """Walls smoothed with arctan."""

    unused: float = 0.0


class LogArctan(NamedTuple):
    """Integral of the arctan-smoothed stiffness."""

    unused: float = 0.0


class Piecewise(NamedTuple):
    """Exact force, branch chosen at every stage: a step does not know that it crosses a wall."""

    unused: float = 0.0


class Located(NamedTuple):
    """Exact force of one contact mode, frozen inside a step; the loop ends steps at the walls."""

    unused: float = 0.0


class Polynomial(NamedTuple):
    """Chebyshev series in x / range [N]."""

    coefficients: NDArray[np.float64]


class RationalPolynomial(NamedTuple):
    """Quotient of two Chebyshev series in x / range [N]; the denominator is positive inside the
    range.
    """

    numerator: NDArray[np.float64]
    denominator: NDArray[np.float64]


class Table(NamedTuple):
    """Piecewise cubic: points [m], and `gapsweep.ForceTable.pieces`."""

    points: NDArray[np.float64]
    pieces: NDArray[np.float64]


class User(NamedTuple):
    """A compiled scalar function F(x) [N] and its slope [N/m]."""

    force: Any
    slope: Any


def acceleration(law, q, x):
    """F_c(x) / m of every lane [m/s^2]."""
    raise NotImplementedError("compiled code only")


def slope(law, q, x):
    """dF_c/dx / m of every lane [1/s^2]."""
    raise NotImplementedError("compiled code only")


def denominator(law, q, x):
    """Denominator of the law, positive where the law is valid; 1 for a law without one."""
    raise NotImplementedError("compiled code only")


def has_layer(kinds):
    """Whether one of some laws has a smoothing layer (a compile-time constant)."""
    raise NotImplementedError("compiled code only")


def is_located(kinds):
    """Whether the loop has to end steps at the walls (a compile-time constant)."""
    raise NotImplementedError("compiled code only")


def has_range(kinds):
    """Whether one is a fit or a table, with a range (a compile-time constant)."""
    raise NotImplementedError("compiled code only")


# --- tanh ---------------------------------------------------------------------------------------


@njit(forceinline=True)
def _tanh_parts(q, x):
    """Side of the gap's centre, distances to both walls, their weights, and the two exponentials.

    With s = |x - centre|, F/K = sign * ((s - g) / (1 + E) + (s + g) E2 / (1 + E2)) where
    E = exp(-2 eps (s - g)) and E2 = exp(-2 eps (s + g)) = E exp(-4 eps g): one exponential for two
    walls, and a force between equal walls that is odd about the centre to the last bit. The clip at
    40 > 2 * 19.06 only touches arguments where tanh is +-1 in double anyway, and keeps E finite.
    The weights are the stiffnesses of the near and of the far wall over that of the upper one.
    """
    y = x - load(q, CENTRE)
    s = simd.absolute(y)
    g = load(q, HALF_GAP)
    near, far = s - g, s + g
    z = simd.minimum(simd.maximum(-2.0 * load(q, SHARPNESS) * near, -40.0), 40.0)
    e = vecmath.exp(z)
    ratio, one = load(q, RATIO), simd.splat(1.0)
    is_below = simd.copysign(one, y) < 0.0  # by the sign that the force gets, also of a zero
    weights = select(is_below, ratio, one), select(is_below, one, ratio)
    return y, near, far, weights, e, e * load(q, DECAY)


@njit(forceinline=True)
def _tanh_force(q, x):
    y, near, far, (w, w2), e, e2 = _tanh_parts(q, x)
    p, p2 = 1.0 + e, 1.0 + e2
    f = fma(w * near, p2, w2 * far * e2 * p) / (p * p2)
    # Where tanh is saturated the law *is* the piecewise one, exactly: no leak of e-18 into the gap.
    reach = load(q, SATURATION)
    f = select(near > reach, w * near, select((near < -reach) & (far > reach), 0.0, f))
    return simd.copysign(load(q, STIFFNESS), y) * f


@njit(forceinline=True)
def _tanh_slope(q, x):
    _, near, far, (w, w2), e, e2 = _tanh_parts(q, x)
    two_eps = 2.0 * load(q, SHARPNESS)
    s1, s2 = 1.0 / (1.0 + e), e2 / (1.0 + e2)
    t1 = fma(two_eps * near, s1 * (1.0 - s1), s1)
    t2 = fma(-two_eps * far, s2 * (1.0 - s2), s2)
    return load(q, STIFFNESS) * (w * t1 + w2 * t2)


# --- arctan and log-arctan ----------------------------------------------------------------------


@njit(forceinline=True)
def _arctan_force(q, x):
    eps = load(q, SHARPNESS)
    below, above = x - load(q, WALL_LOW), x - load(q, WALL_HIGH)
    t_below, t_above = vecmath.arctan(eps * below), vecmath.arctan(eps * above)
    below = load(q, RATIO) * below
    return load(q, STIFFNESS) * fma(
        0.5, below + above, _INV_PI * (above * t_above - below * t_below)
    )


@njit(forceinline=True)
def _arctan_slope(q, x):
    eps, ratio = load(q, SHARPNESS), load(q, RATIO)
    z1, z2 = eps * (x - load(q, WALL_LOW)), eps * (x - load(q, WALL_HIGH))
    d1 = vecmath.arctan(z1) + z1 / fma(z1, z1, 1.0)
    d2 = vecmath.arctan(z2) + z2 / fma(z2, z2, 1.0)
    return load(q, STIFFNESS) * fma(_INV_PI, d2 - ratio * d1, 0.5 + 0.5 * ratio)


@njit(forceinline=True)
def _logarctan_force(q, x):
    gamma, ratio = load(q, SHARPNESS), load(q, RATIO)
    below, above = x - load(q, WALL_LOW), x - load(q, WALL_HIGH)
    z1, z2 = gamma * below, gamma * above
    logarithm = vecmath.log(fma(z1, z1, 1.0) / fma(z2, z2, 1.0)) / (2.0 * gamma)
    more = ratio - 1.0
    if bits(simd.absolute(more) > 0.0) != 0:  # one more logarithm only for walls that differ
        logarithm = fma(more, vecmath.log(fma(z1, z1, 1.0)) / (2.0 * gamma), logarithm)
    arctans = above * vecmath.arctan(z2) - ratio * below * vecmath.arctan(z1)
    linear = (0.5 + 0.5 * ratio) * x
    return load(q, STIFFNESS) * fma(_INV_PI, arctans + logarithm + load(q, OFFSET), linear)


@njit(forceinline=True)
def _logarctan_slope(q, x):
    gamma, ratio = load(q, SHARPNESS), load(q, RATIO)
    t1 = vecmath.arctan(gamma * (x - load(q, WALL_LOW)))
    t2 = vecmath.arctan(gamma * (x - load(q, WALL_HIGH)))
    return load(q, STIFFNESS) * fma(_INV_PI, t2 - ratio * t1, 0.5 + 0.5 * ratio)


# --- exact --------------------------------------------------------------------------------------


@njit(forceinline=True)
def _piecewise_force(q, x):
    low, high = load(q, WALL_LOW), load(q, WALL_HIGH)
    below = load(q, RATIO) * (x - low)
    return load(q, STIFFNESS) * select(x > high, x - high, select(x < low, below, 0.0))


@njit(forceinline=True)
def _piecewise_slope(q, x):
    below = select(x < load(q, WALL_LOW), load(q, RATIO), 0.0)
    return load(q, STIFFNESS) * select(x > load(q, WALL_HIGH), 1.0, below)


@njit(forceinline=True)
def _located_force(q, x):
    return load(q, ACTIVE_STIFFNESS) * (x - load(q, ACTIVE_WALL))


# --- fits ---------------------------------------------------------------------------------------


@njit(forceinline=True)
def _clenshaw(c, u):
    """Chebyshev series at u, and its derivative with respect to u (Clenshaw's recurrence,
    differentiated).
    """
    b1, b2, d1, d2 = simd.splat(0.0), simd.splat(0.0), simd.splat(0.0), simd.splat(0.0)
    two_u = 2.0 * u
    for k in range(c.size - 1, 0, -1):
        d1, d2 = fma(two_u, d1, fma(2.0, b1, -d2)), d1
        b1, b2 = fma(two_u, b1, c[k] - b2), b1
    return fma(u, b1, c[0] - b2), fma(u, d1, b1 - d2)


@njit(forceinline=True)
def _clenshaw_value(c, u):
    b1, b2 = simd.splat(0.0), simd.splat(0.0)
    two_u = 2.0 * u
    for k in range(c.size - 1, 0, -1):
        b1, b2 = fma(two_u, b1, c[k] - b2), b1
    return fma(u, b1, c[0] - b2)


@njit(forceinline=True)
def _polynomial_force(law, q, x):
    return load(q, STIFFNESS) * _clenshaw_value(law.coefficients, x / load(q, RANGE))


@njit(forceinline=True)
def _polynomial_slope(law, q, x):
    reach = load(q, RANGE)
    return load(q, STIFFNESS) * _clenshaw(law.coefficients, x / reach)[1] / reach


@njit(forceinline=True)
def _rational_force(law, q, x):
    u = x / load(q, RANGE)
    return load(q, STIFFNESS) * (
        _clenshaw_value(law.numerator, u) / _clenshaw_value(law.denominator, u)
    )


@njit(forceinline=True)
def _rational_slope(law, q, x):
    reach = load(q, RANGE)
    n, dn = _clenshaw(law.numerator, x / reach)
    d, dd = _clenshaw(law.denominator, x / reach)
    return load(q, STIFFNESS) * (dn * d - n * dd) / (d * d) / reach


@njit(forceinline=True)
def _rational_denominator(law, q, x):
    return _clenshaw_value(law.denominator, x / load(q, RANGE))


# --- a table ------------------------------------------------------------------------------------


@njit
def _piece(points, x):
    """How many points are not above x; 0 of NaN."""
    low, high = 0, points.size
    while low < high:
        middle = (low + high) // 2
        if points[middle] <= x:
            low = middle + 1
        else:
            high = middle
    return low


@njit
def _table_terms(law, x):
    """Distance from where the piece of every lane begins, and the piece's coefficients."""
    d = c_3 = c_2 = c_1 = c_0 = simd.splat(0.0)
    for lane in range(simd.WIDTH):
        at = simd.lane_value(x, lane)
        piece = law.pieces[_piece(law.points, at)]
        d = simd.with_lane(d, lane, at - piece[0])
        c_3 = simd.with_lane(c_3, lane, piece[1])
        c_2 = simd.with_lane(c_2, lane, piece[2])
        c_1 = simd.with_lane(c_1, lane, piece[3])
        c_0 = simd.with_lane(c_0, lane, piece[4])
    return d, c_3, c_2, c_1, c_0


@njit(forceinline=True)
def _table_force(law, q, x):
    d, c_3, c_2, c_1, c_0 = _table_terms(law, x)
    return load(q, STIFFNESS) * fma(fma(fma(c_3, d, c_2), d, c_1), d, c_0)


@njit(forceinline=True)
def _table_slope(law, q, x):
    d, c_3, c_2, c_1, _ = _table_terms(law, x)
    return load(q, STIFFNESS) * fma(fma(3.0 * c_3, d, 2.0 * c_2), d, c_1)


# --- a user's function --------------------------------------------------------------------------


@njit
def _each_lane(function, x):
    result = simd.splat(0.0)
    for lane in range(simd.WIDTH):
        result = simd.with_lane(result, lane, function(simd.lane_value(x, lane)))
    return result


@njit(forceinline=True)
def _user_force(law, q, x):
    return load(q, STIFFNESS) * _each_lane(law.force, x)


@njit(forceinline=True)
def _user_slope(law, q, x):
    return load(q, STIFFNESS) * _each_lane(law.slope, x)


# --- which function belongs to which type ---------------------------------------------------------


def _without_law(function):
    """Give a force that needs only parameters the common signature."""

    @njit(forceinline=True)
    def with_law(law, q, x):
        return function(q, x)

    return with_law


_FORCES = {
    Tanh: _without_law(_tanh_force),
    Arctan: _without_law(_arctan_force),
    LogArctan: _without_law(_logarctan_force),
    Piecewise: _without_law(_piecewise_force),
    Located: _without_law(_located_force),
    Polynomial: _polynomial_force,
    RationalPolynomial: _rational_force,
    Table: _table_force,
    User: _user_force,
}
_SLOPES = {
    Tanh: _without_law(_tanh_slope),
    Arctan: _without_law(_arctan_slope),
    LogArctan: _without_law(_logarctan_slope),
    Piecewise: _without_law(_piecewise_slope),
    Located: _without_law(njit(lambda q, x: load(q, ACTIVE_STIFFNESS))),
    Polynomial: _polynomial_slope,
    RationalPolynomial: _rational_slope,
    Table: _table_slope,
    User: _user_slope,
}


def _kind(law):
    return getattr(law, "instance_class", None)


@overload(acceleration)
def _acceleration(law, q, x):
    function = _FORCES[_kind(law)]
    return lambda law, q, x: function(law, q, x)


@overload(slope)
def _slope(law, q, x):
    function = _SLOPES[_kind(law)]
    return lambda law, q, x: function(law, q, x)


@overload(denominator)
def _denominator(law, q, x):
    if _kind(law) is RationalPolynomial:
        return lambda law, q, x: _rational_denominator(law, q, x)
    return lambda law, q, x: simd.splat(1.0)


def _of_every_contact(one):
    """Have a function of a law called for every contact, whose laws may differ.

    It is given the gap in row `source`, that of the next contact in the next row, and so on; what
    it says goes into rows from `target` on.
    """

    def every(kinds, q, lane, source, target):
        raise NotImplementedError("compiled code only")

    @overload(every)
    def _every(kinds, q, lane, source, target):
        if not len(kinds):
            return lambda kinds, q, lane, source, target: None

        def first_and_others(kinds, q, lane, source, target):
            simd.store(lane, target, one(kinds[0], q[0], load(lane, source)))
            every(kinds[1:], q[1:], lane, source + 1, target + 1)

        return first_and_others

    return every


accelerations = _of_every_contact(acceleration)
slopes = _of_every_contact(slope)
denominators = _of_every_contact(denominator)


def _compile_time_flag(name, families):
    def typed(kinds):
        value = any(_kind(law) in families for law in kinds.types)
        return lambda kinds: value

    overload(name, inline="always")(typed)


_compile_time_flag(has_layer, (Tanh, Arctan, LogArctan))
_compile_time_flag(is_located, (Located,))
_compile_time_flag(has_range, (Polynomial, RationalPolynomial, Table))
