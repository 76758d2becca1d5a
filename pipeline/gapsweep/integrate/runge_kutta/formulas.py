"""Formulas of contact laws in vectors: ``F_c / m`` and its slope, for all lanes at once.

Numbers that differ between points are in the parameter block `q` of the contact; numbers that a
batch shares are in `law`.
"""

from numba import njit

from gapsweep.integrate import simd
from gapsweep.integrate.jit import inlined, internal
from gapsweep.integrate.lanes.parameters import (
    ACTIVE_STIFFNESS,
    ACTIVE_WALL,
    CENTRE,
    DECAY,
    HALF_GAP,
    OFFSET,
    OWN,
    RANGE,
    RATIO,
    SATURATION,
    SHARPNESS,
    STIFFNESS,
    WALL_HIGH,
    WALL_LOW,
)
from gapsweep.integrate.simd import bits, fma, load, select

_INV_PI = 0.3183098861837907

# --- tanh ---------------------------------------------------------------------------------------


@inlined
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
    e = simd.exp(z)
    ratio, one = load(q, RATIO), simd.splat(1.0)
    is_below = simd.copysign(one, y) < 0.0  # by the sign that the force gets, also of a zero
    weights = select(is_below, ratio, one), select(is_below, one, ratio)
    return y, near, far, weights, e, e * load(q, DECAY)


@inlined
def tanh_force(q, x):
    y, near, far, (w, w2), e, e2 = _tanh_parts(q, x)
    p, p2 = 1.0 + e, 1.0 + e2
    f = fma(w * near, p2, w2 * far * e2 * p) / (p * p2)
    # Where tanh is saturated the law *is* the piecewise one, exactly: no leak of e-18 into the gap.
    reach = load(q, SATURATION)
    f = select(near > reach, w * near, select((near < -reach) & (far > reach), 0.0, f))
    return simd.copysign(load(q, STIFFNESS), y) * f


@inlined
def tanh_slope(q, x):
    _, near, far, (w, w2), e, e2 = _tanh_parts(q, x)
    two_eps = 2.0 * load(q, SHARPNESS)
    s1, s2 = 1.0 / (1.0 + e), e2 / (1.0 + e2)
    t1 = fma(two_eps * near, s1 * (1.0 - s1), s1)
    t2 = fma(-two_eps * far, s2 * (1.0 - s2), s2)
    return load(q, STIFFNESS) * (w * t1 + w2 * t2)


# --- arctan and log-arctan ----------------------------------------------------------------------


@inlined
def arctan_force(q, x):
    eps = load(q, SHARPNESS)
    below, above = x - load(q, WALL_LOW), x - load(q, WALL_HIGH)
    t_below, t_above = simd.arctan(eps * below), simd.arctan(eps * above)
    below = load(q, RATIO) * below
    return load(q, STIFFNESS) * fma(
        0.5, below + above, _INV_PI * (above * t_above - below * t_below)
    )


@inlined
def arctan_slope(q, x):
    eps, ratio = load(q, SHARPNESS), load(q, RATIO)
    z1, z2 = eps * (x - load(q, WALL_LOW)), eps * (x - load(q, WALL_HIGH))
    d1 = simd.arctan(z1) + z1 / fma(z1, z1, 1.0)
    d2 = simd.arctan(z2) + z2 / fma(z2, z2, 1.0)
    return load(q, STIFFNESS) * fma(_INV_PI, d2 - ratio * d1, 0.5 + 0.5 * ratio)


@inlined
def logarctan_force(q, x):
    gamma, ratio = load(q, SHARPNESS), load(q, RATIO)
    below, above = x - load(q, WALL_LOW), x - load(q, WALL_HIGH)
    z1, z2 = gamma * below, gamma * above
    logarithm = simd.log(fma(z1, z1, 1.0) / fma(z2, z2, 1.0)) / (2.0 * gamma)
    more = ratio - 1.0
    if bits(simd.absolute(more) > 0.0) != 0:  # one more logarithm only for walls that differ
        logarithm = fma(more, simd.log(fma(z1, z1, 1.0)) / (2.0 * gamma), logarithm)
    arctans = above * simd.arctan(z2) - ratio * below * simd.arctan(z1)
    linear = (0.5 + 0.5 * ratio) * x
    return load(q, STIFFNESS) * fma(_INV_PI, arctans + logarithm + load(q, OFFSET), linear)


@inlined
def logarctan_slope(q, x):
    gamma, ratio = load(q, SHARPNESS), load(q, RATIO)
    t1 = simd.arctan(gamma * (x - load(q, WALL_LOW)))
    t2 = simd.arctan(gamma * (x - load(q, WALL_HIGH)))
    return load(q, STIFFNESS) * fma(_INV_PI, t2 - ratio * t1, 0.5 + 0.5 * ratio)


# --- exact --------------------------------------------------------------------------------------


@inlined
def piecewise_force(q, x):
    low, high = load(q, WALL_LOW), load(q, WALL_HIGH)
    below = load(q, RATIO) * (x - low)
    return load(q, STIFFNESS) * select(x > high, x - high, select(x < low, below, 0.0))


@inlined
def piecewise_slope(q, x):
    below = select(x < load(q, WALL_LOW), load(q, RATIO), 0.0)
    return load(q, STIFFNESS) * select(x > load(q, WALL_HIGH), 1.0, below)


@inlined
def located_force(q, x):
    return load(q, ACTIVE_STIFFNESS) * (x - load(q, ACTIVE_WALL))


@inlined
def located_slope(q, x):
    return load(q, ACTIVE_STIFFNESS)


# --- fits ---------------------------------------------------------------------------------------


@inlined
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


@inlined
def _clenshaw_value(c, u):
    b1, b2 = simd.splat(0.0), simd.splat(0.0)
    two_u = 2.0 * u
    for k in range(c.size - 1, 0, -1):
        b1, b2 = fma(two_u, b1, c[k] - b2), b1
    return fma(u, b1, c[0] - b2)


@inlined
def polynomial_force(law, q, x):
    return load(q, STIFFNESS) * _clenshaw_value(law.numerator, x / load(q, RANGE))


@inlined
def polynomial_slope(law, q, x):
    reach = load(q, RANGE)
    return load(q, STIFFNESS) * _clenshaw(law.numerator, x / reach)[1] / reach


@inlined
def rational_force(law, q, x):
    u = x / load(q, RANGE)
    return load(q, STIFFNESS) * (
        _clenshaw_value(law.numerator, u) / _clenshaw_value(law.denominator, u)
    )


@inlined
def rational_slope(law, q, x):
    reach = load(q, RANGE)
    n, dn = _clenshaw(law.numerator, x / reach)
    d, dd = _clenshaw(law.denominator, x / reach)
    return load(q, STIFFNESS) * (dn * d - n * dd) / (d * d) / reach


@inlined
def rational_denominator(law, q, x):
    return _clenshaw_value(law.denominator, x / load(q, RANGE))


# --- a table ------------------------------------------------------------------------------------


@internal
def _piece(points, x):
    """Number of points that are not above x; 0 for NaN."""
    low, high = 0, points.size
    while low < high:
        middle = (low + high) // 2
        if points[middle] <= x:
            low = middle + 1
        else:
            high = middle
    return low


@internal
def _table_terms(law, x):
    """Distance of every lane's x from the left end of its piece, and the piece's coefficients."""
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


@inlined
def table_force(law, q, x):
    d, c_3, c_2, c_1, c_0 = _table_terms(law, x)
    return load(q, STIFFNESS) * fma(fma(fma(c_3, d, c_2), d, c_1), d, c_0)


@inlined
def table_slope(law, q, x):
    d, c_3, c_2, c_1, _ = _table_terms(law, x)
    return load(q, STIFFNESS) * fma(fma(3.0 * c_3, d, 2.0 * c_2), d, c_1)


# --- a user's function --------------------------------------------------------------------------


@njit
def _each_lane(function, q, x):
    result = simd.splat(0.0)
    for lane in range(simd.WIDTH):
        named = q[OWN, lane], q[OWN + 1, lane], q[OWN + 2, lane], q[OWN + 3, lane]
        result = simd.with_lane(result, lane, function(simd.lane_value(x, lane), *named))
    return result


@inlined
def user_force(law, q, x):
    return load(q, STIFFNESS) * _each_lane(law.force, q, x)


@inlined
def user_slope(law, q, x):
    return load(q, STIFFNESS) * _each_lane(law.slope, q, x)
