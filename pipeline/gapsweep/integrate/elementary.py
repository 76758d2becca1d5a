"""Elementary functions of a `Vec`, all lanes at once, to about two units in the last place.

Each is an argument reduction and a polynomial interpolated at Chebyshev nodes with 50 digits
(relative truncation errors: exp 4e-18, sine 3e-19, arctangent 5e-20, logarithm 1e-18). Vectors of
the C library are not used: numba cannot rely on one being installed, and results must not depend on
it. Every function is exactly odd or even where its name promises it, so mirrored runs stay
mirrored.
"""

from .vectors import (
    absolute,
    copysign,
    exponent,
    fma,
    maximum,
    minimum,
    nearest,
    power_of_two,
    where,
)

_E = (
    1.0,
    1.0,
    0.5000000000000019,
    0.1666666666666668,
    0.04166666666648666,
    0.00833333333331949,
    0.0013888888952696516,
    0.00019841269890340666,
    2.4801485074105115e-05,
    2.7557240604663896e-06,
    2.763279054211718e-07,
    2.511015364692893e-08,
)
_S = (
    6.283185307179586,
    -41.341702240399755,
    81.60524927607362,
    -76.70585975282492,
    42.058693925428685,
    -15.0946416761179,
    3.8199280942271643,
    -0.7177337921413454,
    0.10089695501646812,
)
_A = (
    1.0,
    -0.33333333333333326,
    0.19999999999997012,
    -0.1428571428532936,
    0.11111111085301238,
    -0.0909090805829841,
    0.07692281083678901,
    -0.06666205023178091,
    0.058768317098427496,
    -0.05217297919655059,
    0.044994415067496046,
    -0.03338645225903317,
    0.01511237643149517,
)
_L = (
    2.0,
    0.6666666666666765,
    0.3999999999929807,
    0.2857142876160948,
    0.22222196953363016,
    0.181836372994809,
    0.1531237773583146,
    0.1481128256774903,
)

_LOG2_E = 1.4426950408889634
_LN2_HIGH = 0.6931471803691238  # 33 bits: its product with any exponent is exact
_LN2_LOW = 1.9082149292705877e-10
_TAN_PI_8 = 0.41421356237309503
_COT_PI_8 = 2.414213562373095
_PI_4 = 0.7853981633974483
_PI_2 = 1.5707963267948966
_SQRT_2 = 1.4142135623730951


def exp(z):
    """e**z for ``|z| <= 700``; outside it the argument is clipped."""
    z = minimum(maximum(z, -700.0), 700.0)
    whole = nearest(z * _LOG2_E)
    r = fma(whole, -_LN2_LOW, fma(whole, -_LN2_HIGH, z))
    # Estrin's scheme: four short chains instead of one of eleven steps, bound by its latency.
    r2 = r * r
    r4 = r2 * r2
    p0 = fma(fma(r, _E[3], _E[2]), r2, fma(r, _E[1], _E[0]))
    p1 = fma(fma(r, _E[7], _E[6]), r2, fma(r, _E[5], _E[4]))
    p2 = fma(fma(r, _E[11], _E[10]), r2, fma(r, _E[9], _E[8]))
    return fma(fma(p2, r4, p1), r4, p0) * power_of_two(whole)


def cos_turns(turns):
    """cos(2 pi turns); the argument counts whole revolutions, so its reduction is exact."""
    r = turns - nearest(turns)
    y = 0.25 - absolute(r)  # cos(2 pi r) = sin(2 pi (1/4 - |r|))
    u = y * y
    u2 = u * u
    u4 = u2 * u2
    p0 = fma(fma(u, _S[3], _S[2]), u2, fma(u, _S[1], _S[0]))
    p1 = fma(fma(u, _S[7], _S[6]), u2, fma(u, _S[5], _S[4]))
    return y * fma(fma(u4, _S[8], p1), u4, p0)


def arctan(z):
    """Arctangent, odd, one division."""
    s = absolute(z)
    is_far = s > _COT_PI_8
    is_middle = (s > _TAN_PI_8) & ~is_far
    numerator = where(is_far, -1.0, where(is_middle, s - 1.0, s))
    denominator = where(is_far, s, where(is_middle, s + 1.0, 1.0))
    offset = where(is_far, _PI_2, where(is_middle, z.constant(_PI_4), 0.0))
    t = numerator / denominator
    u = t * t
    u2 = u * u
    u4 = u2 * u2
    p0 = fma(fma(u, _A[3], _A[2]), u2, u * _A[1])
    p1 = fma(fma(u, _A[7], _A[6]), u2, fma(u, _A[5], _A[4]))
    p2 = fma(fma(u, _A[11], _A[10]), u2, fma(u, _A[9], _A[8]))
    p = fma(fma(fma(u4, _A[12], p2), u4, p1), u4, p0)
    return copysign(offset + fma(t, p, t), z)


def log(z):
    """Natural logarithm of a positive normal number."""
    whole = exponent(z)
    m = z * power_of_two(-whole)
    is_high = m > _SQRT_2
    m = where(is_high, m * 0.5, m)
    whole = where(is_high, whole + 1.0, whole)
    f = (m - 1.0) / (m + 1.0)
    u = f * f
    u2 = u * u
    p0 = fma(fma(u, _L[3], _L[2]), u2, u * _L[1])
    p1 = fma(fma(u, _L[7], _L[6]), u2, fma(u, _L[5], _L[4]))
    p = fma(p1, u2 * u2, p0)
    return fma(whole, _LN2_HIGH, fma(whole, _LN2_LOW, fma(f, p, 2.0 * f)))


def power(z, index):
    """z**index for positive z; used for step sizes only."""
    return exp(index * log(maximum(z, 1e-300)))
