"""Taylor series of contact forces, from the formulas of their laws.

A law has one formula for its force and one for its slope (`gapsweep.model.contact.Formulas`). Here
both are emitted with a `Series` as displacement: each operation and each function of a formula is
a recurrence for the coefficients of its result [1]_. A law therefore needs no code for its series,
and the variational equation has the series of its slope in the same way. Only functions have forms
here that arctan, log-arctan and fits call: Runge-Kutta steps integrate the other laws.

References
----------
.. [1] A. Griewank, A. Walther, "Evaluating Derivatives", 2nd ed., SIAM 2008, section 13.2.
"""

import math
from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import Any

from gapsweep.integrate import elementary, vectors
from gapsweep.integrate.lanes.law_rows import SERIES, arguments, rows_of_law, with_callees
from gapsweep.integrate.lanes.parameters import N_PARAMETERS
from gapsweep.integrate.vectors import Vec, absolute
from gapsweep.model import arithmetic
from gapsweep.model.laws import LAWS

from .terms import product_term, square_term


class Series:
    """Taylor coefficients of a function of time, each emitted when it is first read.

    Coefficient n is emitted in the block in which it is read first: later code that reads it must
    not be reached without that block.

    Parameters
    ----------
    term : callable
        Function of n that returns coefficient n; it may read lower coefficients of this series.
    parts : iterable of Series
        The series that `term` reads.
    cost : float
        Multiplications for a coefficient, over its degree.
    """

    def __init__(self, term, parts=(), cost=0.0):
        self._term, self._parts, self._cost, self._terms = term, parts, cost, []

    def __getitem__(self, n):
        while len(self._terms) <= n:
            self._terms.append(self._term(len(self._terms)))
        return self._terms[n]

    def cost(self):
        """Multiplications for a coefficient of this series and of all that it depends on."""
        several, waiting = {}, [self]
        while waiting:
            one = waiting.pop()
            if id(one) not in several:
                several[id(one)] = one._cost
                waiting += one._parts
        return sum(several.values())

    @cached_property
    def squared(self):
        return Series(lambda n: square_term(self, n), [self], 0.5)

    @cached_property
    def rate(self):
        """The derivative by time."""
        return Series(lambda n: self[n + 1] * float(n + 1), [self])

    def _each(self, function):
        """Apply a linear function to every coefficient."""
        return Series(lambda n: function(self[n]), [self])

    def __add__(self, other):
        if isinstance(other, Series):
            return Series(lambda n: self[n] + other[n], [self, other])
        return Series(lambda n: self[0] + other if n == 0 else self[n], [self])

    def __neg__(self):
        return self._each(lambda a: -a)

    def __sub__(self, other):
        if isinstance(other, Series):
            return Series(lambda n: self[n] - other[n], [self, other])
        return self + -other

    def __rsub__(self, other):
        return -self + other

    def __mul__(self, other):
        if other is self:
            return self.squared
        if isinstance(other, Series):
            return Series(lambda n: product_term(self, other, n), [self, other], 1.0)
        return self._each(lambda a: a * other)

    def __truediv__(self, other):
        if isinstance(other, Series):
            return _quotient(self, other)
        inverse = Series(
            lambda n: 1.0 / other if isinstance(other, float) else other.constant(1.0) / other
        )
        return Series(lambda n: self[n] * inverse[0] if n else self[0] / other, [self])

    def __rtruediv__(self, other):
        return _quotient(other, self)

    __radd__ = __add__
    __rmul__ = __mul__


def _at(a, n):
    """Coefficient n of a series or of a constant."""
    return a[n] if isinstance(a, Series) else 0.0 if n else a


def _quotient(a, b):
    """Return the series of ``a / b`` for a series b."""
    inverse = Series(lambda n: b[0].constant(1.0) / b[0])

    def term(n):
        if n == 0:
            first = _at(a, 0)
            return first / b[0] if isinstance(first, Vec) else inverse[0] * first
        total = a[n] if isinstance(a, Series) else None
        for i in range(n):
            total = (
                -(series[i] * b[n - i])
                if total is None
                else vectors.fma(-series[i], b[n - i], total)
            )
        return total * inverse[0]

    series = Series(term, [a, b] if isinstance(a, Series) else [b], 1.0)
    return series


def _integral(rate, first):
    """Return the series with a derivative, from its value."""
    return Series(lambda n: rate[n - 1] * (1.0 / n) if n else first(), [rate])


def _log(a):
    return _integral(a.rate / a, lambda: elementary.log(a[0]))


def _atan(a):
    return _integral(a.rate / (a.squared + 1.0), lambda: elementary.arctan(a[0]))


def _fma(a, b, c):
    if not any(isinstance(each, Series) for each in (a, b, c)):
        vec = next((each for each in (a, b, c) if isinstance(each, Vec)), None)
        if vec is None:
            return a * b + c
        return vectors.fma(*(e if isinstance(e, Vec) else vec.constant(e) for e in (a, b, c)))
    if isinstance(a, Series) and isinstance(b, Series):
        return a * b + c
    if isinstance(b, Series):
        a, b = b, a
    if isinstance(b, float) and b == 0.0:
        return c
    if not isinstance(a, Series):
        return c + a * b
    several = [each for each in (a, c) if isinstance(each, Series)]
    return Series(lambda n: _fma(a[n], b, _at(c, n)), several)


def _of(series, vector):
    """Return a function of a series or of a constant."""
    return lambda a: series(a) if isinstance(a, Series) else vector(a)


# Forms of the functions that formulas call: for series, or for vectors where no series is given.
_FORMS = {
    **{abs: absolute, arithmetic.fma: _fma, arithmetic.splat: lambda a: a},
    **{math.log: _of(_log, elementary.log), math.atan: _of(_atan, elementary.arctan)},
    arithmetic.is_any: lambda condition: True,
}


@lru_cache
def _emitted(formula: Callable[..., Any]) -> Any:
    """Return a formula as a function that emits code for series or vectors."""
    return with_callees(formula, dict(_FORMS), lambda copy: copy)


class _Coefficients(list):
    """Coefficients of a fit, as formulas read them."""

    @property
    def size(self):
        return len(self)


class ContactForce:
    """Force of a contact per unit mass, and its slope, as series of the contact's gap.

    Parameters
    ----------
    lanes : LaneRows
    number : int
        Number of the contact.
    gap : list of Vec
        Series of the contact's b.q, to which the caller adds coefficients.
    """

    def __init__(self, lanes, number, gap):
        laws = lanes.layout.laws
        place, n_top, n_bottom = laws[number]
        self._law = LAWS[place]
        self._lanes, self._gap = lanes, Series(gap.__getitem__)
        self._first = lanes.layout.first["law"] + number * N_PARAMETERS
        fit = lanes.rows("fit")[sum(top + bottom for _, top, bottom in laws[:number]) :]
        self._fit = {"numerator": fit[:n_top], "denominator": fit[n_top : n_top + n_bottom]}
        self.sharpness = None  # convergence parameter [1/m] of a law with layers
        if self._law.is_sharpened:
            self.sharpness = self.row(rows_of_law(self._law)["sharpness"])
        self.has_range = "fit_range" in arguments(self._law.formulas.force)

    def row(self, number):
        """Return a row of the parameters of the law."""
        return self._lanes[self._first + number]

    def value(self, name, x):
        """Return the formula of a name at a gap, a `Vec` or a `Series`; None without a formula."""
        formula, rows = getattr(self._law.formulas, name), rows_of_law(self._law)
        if formula is None:
            return None
        given = [
            _Coefficients(self._fit[each]) if each in SERIES else self.row(rows[each])
            for each in arguments(formula)
        ]
        return _emitted(formula)(x, *given)

    def force(self):
        """Return the series of the force, in the cheaper of two ways.

        The formula of the force gives it, or that of the slope S, as ``dF/dt = S(x) dx/dt``.
        """
        direct = self.value("force", self._gap)
        indirect = _integral(self.slope() * self._gap.rate, lambda: direct[0])
        return min(direct, indirect, key=Series.cost)

    def slope(self):
        """Return the series of the slope of the force."""
        return self.value("slope", self._gap)


def contact_forces(lanes, gaps):
    """Return the `ContactForce` of every contact; none where contacts are located."""
    if lanes.layout.is_located:
        return []
    return [ContactForce(lanes, number, gap) for number, gap in enumerate(gaps)]
