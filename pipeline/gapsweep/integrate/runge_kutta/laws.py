"""Compiled contact laws: acceleration ``F_c(x) / m`` and its slope, for all lanes at once.

Each law is a named tuple *type*, and `acceleration` is an overload that looks at the type alone. So
the stepping loop is one numba function with one specialisation per law: the law is inlined, and
numba's disk cache finds the specialisation in another process (a law passed as a function would be
a new type, hence a cache miss, in every process).

What differs from point to point sits in the rows of a parameter block `q`, for every contact of
shape (N_PARAMETERS, WIDTH); what a batch shares (fit coefficients) sits in the named tuple.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from gapsweep.integrate import simd
from gapsweep.integrate.jit import inlined
from gapsweep.integrate.simd import load

from . import formulas
from .parameters import N_PARAMETERS, STIFFNESS


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
    """Quotient of Chebyshev series in x / range [N]; the denominator is positive in the range."""

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


# --- which function belongs to which type ---------------------------------------------------------


def _without_law(function):
    """Give a force that needs only parameters the common signature."""

    @inlined
    def with_law(law, q, x):
        return function(q, x)

    return with_law


_FORCES = {
    Tanh: _without_law(formulas.tanh_force),
    Arctan: _without_law(formulas.arctan_force),
    LogArctan: _without_law(formulas.logarctan_force),
    Piecewise: _without_law(formulas.piecewise_force),
    Located: _without_law(formulas.located_force),
    Polynomial: formulas.polynomial_force,
    RationalPolynomial: formulas.rational_force,
    Table: formulas.table_force,
    User: formulas.user_force,
}
_SLOPES = {
    Tanh: _without_law(formulas.tanh_slope),
    Arctan: _without_law(formulas.arctan_slope),
    LogArctan: _without_law(formulas.logarctan_slope),
    Piecewise: _without_law(formulas.piecewise_slope),
    Located: _without_law(formulas.located_slope),
    Polynomial: formulas.polynomial_slope,
    RationalPolynomial: formulas.rational_slope,
    Table: formulas.table_slope,
    User: formulas.user_slope,
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
        return lambda law, q, x: formulas.rational_denominator(law, q, x)
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
