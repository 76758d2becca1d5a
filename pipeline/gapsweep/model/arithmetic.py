"""Arithmetic of the formulas of contact laws.

A formula is a function of numbers, written with operators and with these functions. The compiled
engine replaces each function by the instruction, or the function of `gapsweep.integrate`, for
vectors of numbers (`gapsweep.integrate.runge_kutta.formulas`).
"""

import math


def fma(a: float, b: float, c: float) -> float:
    """Return ``a b + c``; in compiled code with one rounding."""
    return a * b + c


def select(condition: bool, a: float, b: float) -> float:
    """Return `a` where the condition holds, `b` elsewhere."""
    return a if condition else b


def splat(a: float) -> float:
    """Return `a`, as a vector in compiled code: the initial value of a variable of a loop."""
    return a


def is_any(condition: bool) -> bool:
    """Whether the condition holds for any number of a vector."""
    return bool(condition)


def absolute(a: float) -> float:
    """Return the magnitude of `a`."""
    return abs(a)


def copysign(a: float, b: float) -> float:
    """Return `a` with the sign of `b`, also of a zero."""
    return math.copysign(a, b)


def minimum(a: float, b: float) -> float:
    """Return the smaller number."""
    return min(a, b)


def maximum(a: float, b: float) -> float:
    """Return the larger number."""
    return max(a, b)


def sqrt(a: float) -> float:
    """Return the square root of `a`, which is not negative."""
    return math.sqrt(a)


def exp(a: float) -> float:
    """Return the exponential of `a`, of magnitude 700 at most."""
    return math.exp(a)


def log(a: float) -> float:
    """Return the natural logarithm of a positive number."""
    return math.log(a)


def arctan(a: float) -> float:
    """Return the arctangent of `a`."""
    return math.atan(a)
