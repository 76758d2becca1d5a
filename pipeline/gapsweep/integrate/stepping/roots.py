"""Every real root of a polynomial on (0, h], proved complete by Descartes' rule of signs.

A polynomial in Bernstein form on an interval has at most as many roots there as its coefficients
have sign changes, and exactly one if they change once. Intervals with more changes are halved
(de Casteljau) until that decides, leftmost first. Only single lanes come here: those whose crossing
`step`, or whose extrema `record`, could not decide for all lanes at once.
"""

import math
from typing import NamedTuple

import numpy as np

from gapsweep.integrate.jit import internal

# Two roots closer than this part of the step differ by less than rounding in the polynomial's
# value (2**-26 squared is 2**-52): they count as one double root, a touch.
MAX_DEPTH = 26
TOUCH_WIDTH = 2.0**-19  # of intervals in which a touch is searched: values of 1e-12 are reached
MAX_DEGREE = 32
SIMPLE, DOUBLE = 1, 2
_CLOSE = 1e-9  # of the bracket: the error of Newton's next iterate is about its square
_TOUCHES = 1000  # an even number of sign changes that no polynomial here has

_INVERSE_BINOMIALS = 1.0 / np.array(
    [[max(math.comb(n, k), 1) for k in range(MAX_DEGREE + 1)] for n in range(MAX_DEGREE + 1)],
    dtype=float,
)


class Work(NamedTuple):
    """Work space of the root finder, allocated once per run; it holds the results too."""

    series: np.ndarray  # shape (degree + 1,): the step's Taylor coefficients of x
    reduced: np.ndarray  # the polynomial whose roots are wanted
    bernstein: np.ndarray  # of the waiting intervals, one row each
    ends: np.ndarray  # of the same intervals, as parts of the step
    roots: np.ndarray
    multiplicity: np.ndarray
    # shape (2 n_contacts, 2): time and side at which a gap, or then a force, leaves its interval
    exits: np.ndarray


def work_space(degree: int, n_contacts: int) -> Work:
    """Return work space for polynomials up to `degree`."""
    n, depth = degree + 1, MAX_DEPTH + 3
    return Work(
        np.empty(n),
        np.empty(n),
        np.empty((depth, n)),
        np.empty((depth, 2)),
        np.empty(n),
        np.empty(n, np.int64),
        np.empty((2 * n_contacts, 2)),
    )


@internal
def polynomial(series, degree, t):
    """Value and derivative of ``sum(series[n] t**n)``."""
    value, slope = series[degree], 0.0
    for n in range(degree - 1, -1, -1):
        slope = slope * t + value
        value = value * t + series[n]
    return value, slope


@internal
def _to_bernstein(series, degree, h, out):
    power = 1.0
    for i in range(degree + 1):
        out[i] = series[i] * power * _INVERSE_BINOMIALS[degree, i]
        power *= h
    for k in range(degree - 1, -1, -1):
        for j in range(k, degree):
            out[j + 1] += out[j]


@internal
def _sign_changes(bernstein, degree):
    changes, last = 0, 0.0
    for j in range(degree + 1):
        b = bernstein[j]
        if b != 0.0:
            if (b > 0.0) != (last > 0.0) and last != 0.0:
                changes += 1
            last = b
    return changes


@internal
def _split(whole, left, right, degree, part):
    """Compute the Bernstein coefficients of both parts of an interval that is cut at `part`."""
    for j in range(degree + 1):
        left[j] = whole[j]
    right[degree] = left[degree]
    for k in range(1, degree + 1):
        for j in range(degree, k - 1, -1):
            left[j] += (1.0 - part) * (left[j - 1] - left[j])
        right[degree - k] = left[degree]


@internal
def _refine(series, degree, a, b, value_a, value_b):
    """Return the single root in [a, b] by Newton's method, with bisection as safeguard."""
    is_positive_before = value_a > 0.0
    close = _CLOSE * (b - a)
    t = a + (b - a) * (value_a / (value_a - value_b))
    if not a < t < b:
        t = 0.5 * (a + b)
    for _ in range(80):
        value, slope = polynomial(series, degree, t)
        if value == 0.0:
            break
        if (value > 0.0) == is_positive_before:
            a = t
        else:
            b = t
        following = t - value / slope if slope != 0.0 else a
        is_newton = a < following < b
        if not is_newton:
            following = 0.5 * (a + b)
        is_close = abs(following - t) <= close
        t = following
        if is_close and (is_newton or b - a <= 4e-16 * b):
            break
    return t


@internal
def _comes_near(bernstein, degree, slack):
    """Whether a value within rounding of zero is possible on an interval without a sign change."""
    closest = np.inf
    for j in range(degree + 1):
        closest = min(closest, abs(bernstein[j]))
    return closest <= slack


@internal
def isolate(degree, h, end_value, slack, work):
    """Roots of the power series `work.reduced` on (0, h), in increasing order.

    Parameters
    ----------
    degree : int
        Degree of the series. ``work.reduced[0]`` must not be zero (divide by t before).
    h : float
        End of the interval.
    end_value : float
        Value at h as the caller knows it. The next step starts from that very number, so using its
        sign here keeps a root next to the step's end from being seen twice or never.
    slack : float
        Values below it count as zero where the polynomial touches zero without changing sign:
        such a touch is reported as DOUBLE although rounding may have lifted it off.
    work : Work
        Receives ``roots`` and their ``multiplicity``: SIMPLE (sign change) or DOUBLE (unresolved
        pair, no sign change).

    Returns
    -------
    int
        Number of roots.
    """
    series, coefficients, ends = work.reduced, work.bernstein, work.ends
    roots, multiplicity = work.roots, work.multiplicity
    _to_bernstein(series, degree, h, coefficients[0])
    coefficients[0, degree] = end_value
    ends[0, 0], ends[0, 1] = 0.0, 1.0
    n_waiting, n_roots = 1, 0
    while n_waiting > 0 and n_roots < len(roots):
        current = coefficients[n_waiting - 1]
        a, b = ends[n_waiting - 1]
        n_waiting -= 1
        changes = _sign_changes(current, degree)
        if changes == 0:
            if not _comes_near(current, degree, slack):
                continue
            if b - a < TOUCH_WIDTH:
                changes = _TOUCHES
        if changes == 1:
            roots[n_roots] = _refine(series, degree, a * h, b * h, current[0], current[degree])
            multiplicity[n_roots] = SIMPLE
            n_roots += 1
        elif changes == _TOUCHES or b - a < 2.0**-MAX_DEPTH:
            roots[n_roots] = 0.5 * (a + b) * h
            # an even number of crossings within rounding is a touch, an odd one a crossing
            multiplicity[n_roots] = SIMPLE if changes % 2 else DOUBLE
            n_roots += 1
        else:
            n_waiting = _halve(coefficients, ends, n_waiting, degree, a, b)
    return n_roots


@internal
def _halve(coefficients, ends, top, degree, a, b):
    """Replace interval `top` of the stack by its halves, the left one on top; return the size."""
    left, right, whole = (
        coefficients[top + 1],
        coefficients[top],
        coefficients[len(coefficients) - 1],
    )
    for j in range(degree + 1):
        whole[j] = right[j]
    part = 0.5
    _split(whole, left, right, degree, part)
    if right[0] == 0.0:
        # A root exactly on the cut would belong to neither side: cut elsewhere.
        part = 0.4375
        _split(whole, left, right, degree, part)
    middle = a + part * (b - a)
    ends[top, 0], ends[top, 1] = middle, b
    ends[top + 1, 0], ends[top + 1, 1] = a, middle
    return top + 2


@internal
def first_exit(h, lo, hi, x_1, work):
    """Time and side at which x(t), the series `work.series`, first leaves [lo, hi] on (0, h].

    Parameters
    ----------
    x_1 : float
        Displacement at h as the step computed it.

    Returns
    -------
    t, side : float
        Time, and +1 over `hi`, -1 over `lo`, 0 never. Zero time: x starts on the wall and its
        first derivative that is not zero points outward.
    """
    t, side = h, 0.0
    # one loop, not two calls: inlined twice, the root finder would take twice as long to compile
    for i in range(2):
        wall, outward = (hi, 1.0) if i == 0 else (lo, -1.0)
        if abs(wall) < np.inf:
            when = _first_zero(h, wall, -outward, x_1, work)
            if when >= 0.0 and (side == 0.0 or when < t):
                t, side = when, outward
    return t, side


@internal
def _first_zero(h, wall, inward, x_1, work):
    """First time on [0, h] at which ``inward * (x - wall)`` becomes negative, or -1."""
    series, gap = work.series, work.reduced
    degree, skipped = len(series) - 1, 0
    if series[0] == wall:
        skipped = 1
        while skipped <= degree and series[skipped] == 0.0:
            skipped += 1
        if skipped > degree:
            return -1.0  # at rest on the wall
    for n in range(skipped, degree + 1):
        gap[n - skipped] = inward * series[n]
    if skipped == 0:
        gap[0] = inward * (series[0] - wall)
    if gap[0] < 0.0:
        return 0.0
    if h <= 0.0:
        return -1.0
    end_value = inward * (x_1 - wall)
    n_roots = isolate(degree - skipped, h, end_value / h**skipped, -1.0, work)
    for i in range(n_roots):
        if work.multiplicity[i] == SIMPLE:
            return work.roots[i]
    if end_value == 0.0 and inward * polynomial(series, degree, h)[1] < 0.0:
        return h
    return -1.0
