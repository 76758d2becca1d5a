"""Coefficients of products of Taylor series."""

from gapsweep.integrate.vectors import fma


def square_term(x, n):
    """Coefficient n of x^2. The newest coefficient comes last: only the last product waits."""
    if n == 0:
        return x[0] * x[0]
    total = None
    for i in range((n - 1) // 2, 0, -1):
        total = x[i] * x[n - i] if total is None else fma(x[i], x[n - i], total)
    total = x[0] * x[n] if total is None else fma(x[0], x[n], total)
    total = total * 2.0
    return total if n % 2 else fma(x[n // 2], x[n // 2], total)


def product_term(a, b, n):
    """Coefficient n of a*b, newest factors last."""
    if n == 0:
        return a[0] * b[0]
    total = None
    for i in range(1, n):
        total = a[i] * b[n - i] if total is None else fma(a[i], b[n - i], total)
    total = a[0] * b[n] if total is None else fma(a[0], b[n], total)
    return fma(a[n], b[0], total)
