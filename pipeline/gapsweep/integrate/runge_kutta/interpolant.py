"""Roots of a step's interpolant, on [0, 1], by Bernstein coefficients: none can be missed.

A polynomial has at most as many roots in (0, 1) as its Bernstein coefficients have sign changes,
and exactly as many modulo two. So no change proves "no root", one change proves "one root";
anything else is halved (de Casteljau) until one of the two holds. This is the proof that end-point
signs cannot give.
"""

import numpy as np

from gapsweep.integrate.jit import internal

MAX_DEPTH = 24
STACK_SHAPE = (MAX_DEPTH + 2, 8)
_START, _LEVEL = 6, 7
_BINOMIAL = np.array([[1.0, 4.0, 6.0, 4.0, 1.0, 0.0], [1.0, 5.0, 10.0, 10.0, 5.0, 1.0]])
# Good enough to start the polishing by probes, which decides the accuracy of an event.
_THETA_TOLERANCE = 1e-10


@internal
def position_coefficients(h, x, v, a, x1, v1, a1, b):
    """Bernstein coefficients of the quintic Hermite interpolant of x, into `b` (6,)."""
    b[0], b[5] = x, x1
    b[1], b[4] = x + 0.2 * h * v, x1 - 0.2 * h * v1
    b[2] = x + 0.4 * h * v + 0.05 * h * h * a
    b[3] = x1 - 0.4 * h * v1 + 0.05 * h * h * a1


@internal
def evaluate(b, theta):
    """Value of a quartic or quintic Bernstein polynomial at theta in [0, 1] (Farin's nested form:
    no copy, all terms of one scale).
    """
    n = b.size - 1
    rest, power = 1.0 - theta, 1.0
    value = b[0] * rest
    for j in range(1, n):
        power *= theta
        value = (value + power * _BINOMIAL[n - 4, j] * b[j]) * rest
    return value + power * theta * b[n]


@internal
def _sign_changes(b):
    """Sign changes of the coefficients, zeros skipped; and the last sign."""
    changes, sign = 0, 0.0
    for j in range(b.size):
        if b[j] != 0.0:
            here = 1.0 if b[j] > 0.0 else -1.0
            changes += here == -sign
            sign = here
    return changes


@internal
def _monomials(b):
    """Power-basis coefficients, as six scalars, of a quartic or quintic Bernstein polynomial."""
    d1, d2, d3 = b[1] - b[0], b[2] - 2.0 * b[1] + b[0], b[3] - 3.0 * (b[2] - b[1]) - b[0]
    d4 = b[4] - 4.0 * (b[3] + b[1]) + 6.0 * b[2] + b[0]
    if b.size == 5:
        return b[0], 4.0 * d1, 6.0 * d2, 4.0 * d3, d4, 0.0
    d5 = b[5] - b[0] - 5.0 * (b[4] - b[1]) + 10.0 * (b[3] - b[2])
    return b[0], 5.0 * d1, 10.0 * d2, 10.0 * d3, 5.0 * d4, d5


@internal
def _single_root(b):
    """The one root of a polynomial with one sign change: Newton's method in a shrinking bracket."""
    p0, p1, p2, p3, p4, p5 = _monomials(b)
    low, high = 0.0, 1.0
    rises = b[b.size - 1] > 0.0
    theta = 0.5 if b[0] == 0.0 else b[0] / (b[0] - b[b.size - 1])
    for _ in range(60):
        f = ((((p5 * theta + p4) * theta + p3) * theta + p2) * theta + p1) * theta + p0
        slope = (((5.0 * p5 * theta + 4.0 * p4) * theta + 3.0 * p3) * theta + 2.0 * p2) * theta + p1
        if f == 0.0:  # the bracket would push the iteration off the root it has hit
            return theta
        if (f > 0.0) == rises:
            high = theta
        else:
            low = theta
        after = theta - f / slope if slope != 0.0 else -1.0
        if not low < after < high:
            after = 0.5 * (low + high)
        if abs(after - theta) < _THETA_TOLERANCE:
            return after
        theta = after
    return theta


@internal
def _halve(stack, top, n):
    """Replace the piece in row `top` by its right half, and put its left half on top of it."""
    for m in range(n):
        stack[top + 1, m] = stack[top, 0]
        for j in range(n - 1 - m):
            stack[top, j] = 0.5 * (stack[top, j] + stack[top, j + 1])


@internal
def roots(b, found, stack):
    """Roots in (0, 1], ascending, into `found`; their number is returned.

    A root at 0 is left out: it was the root at 1 of the step before. Where halving does not
    separate two roots by `MAX_DEPTH` (a touching root, or one blurred by rounding) the interval
    counts as one root, an inflection. `stack` is work space of shape (MAX_DEPTH + 2, 8):
    coefficients, start, depth.
    """
    n, count, top = b.size, 0, 1
    for j in range(n):
        stack[0, j] = b[j]
    stack[0, _START] = stack[0, _LEVEL] = 0.0
    while top > 0 and count < found.size:
        top -= 1
        piece, left, level = stack[top, :n], stack[top, _START], stack[top, _LEVEL]
        width = 0.5**level
        changes = _sign_changes(piece)
        at_end = piece[n - 1] == 0.0
        if changes == 0:
            if at_end and left + width == 1.0:
                found[count] = 1.0
                count += 1
        elif changes == 1 and not at_end:
            found[count] = left + width * _single_root(piece)
            count += 1
        elif level >= MAX_DEPTH:
            found[count] = left + 0.5 * width
            count += 1
        else:
            # The right half stays under the left one, so roots come out in order of time.
            _halve(stack, top, n)
            stack[top + 1, _START], stack[top, _START] = left, left + 0.5 * width
            stack[top + 1, _LEVEL] = stack[top, _LEVEL] = level + 1
            top += 2
    return count


@internal
def derivative_coefficients(b, d):
    """Bernstein coefficients of the derivative by theta, over the degree."""
    for j in range(d.size):
        d[j] = b[j + 1] - b[j]
