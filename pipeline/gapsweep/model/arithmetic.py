"""Operations of the formulas of contact laws that Python and ``math`` lack.

A formula is a function of numbers. The compiled engine computes a copy of it for vectors, in which
these functions, ``abs``, ``min``, ``max`` and those of ``math`` are its own
(`gapsweep.integrate.runge_kutta.formulas`), and of some laws another copy for Taylor series
(`gapsweep.integrate.taylor.law_series`).
"""


def fma(a: float, b: float, c: float) -> float:
    """Return ``a b + c``; in compiled code with one rounding."""
    return a * b + c


def select(condition: bool, a: float, b: float) -> float:
    """Return `a` where the condition holds, `b` elsewhere."""
    return a if condition else b


def is_any(condition: bool) -> bool:
    """Whether the condition holds for any number of a vector."""
    return bool(condition)


def splat(a: float) -> float:
    """Return `a`, as a vector in compiled code: the initial value of a variable of a loop."""
    return a
