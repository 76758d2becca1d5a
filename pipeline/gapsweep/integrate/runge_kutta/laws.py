"""Compiled contact laws: acceleration ``F_c(x) / m`` and its slope, for all lanes at once.

The laws of this package are one type, `Formula`, with a number that selects the formula: the
stepping loop is compiled once for all of them and branches on the number where it needs a force.
(All lanes have the same law: the branch is predicted.) A user's function is part of its type,
`User`: the loop is compiled with it.

Numbers that differ between points are in the rows of a parameter block `q` of every contact, shape
(N_PARAMETERS, WIDTH); numbers that a batch shares (fit coefficients) are in the named tuple.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate import simd
from gapsweep.integrate.jit import chosen_by_type, inlined
from gapsweep.integrate.lanes.parameters import N_PARAMETERS, STIFFNESS
from gapsweep.integrate.simd import load
from gapsweep.model.contact import Piecewise
from gapsweep.model.laws import LAWS

from . import formulas
from .formulas import vectorised


@dataclass(frozen=True, slots=True)
class Law:
    """A compiled law with the parameters of its points; constructors are in `representations`."""

    kind: Any
    q: NDArray[np.float64]

    def rows(self, mass: NDArray[np.float64], n: int) -> NDArray[np.float64]:
        """Parameter rows of n points, stiffness over mass, shape (n, N_PARAMETERS)."""
        rows = np.array(np.broadcast_to(self.q, (n, N_PARAMETERS)))
        rows[:, STIFFNESS] /= mass
        return rows


# Numbers of the formulas: places in `LAWS`, then the two without a label. PIECEWISE chooses its
# branch at every stage: a step does not know that it crosses a wall. LOCATED is one contact mode,
# frozen inside a step: the loop ends steps at walls.
PIECEWISE = LAWS.index(Piecewise)
LOCATED, TABLE = len(LAWS), len(LAWS) + 1
_NONE = np.zeros(0)


class Formula(NamedTuple):
    """A contact law of this package.

    Attributes
    ----------
    number : int
        Number of the formula, as `LOCATED`.
    numerator, denominator : ndarray
        Fits: Chebyshev series in x / range [N], `in_blocks`; the denominator is positive in the
        range.
    points, pieces : ndarray
        Tables: left ends of the pieces [m], and `gapsweep.ForceTable.pieces`.
    """

    number: int
    numerator: NDArray[np.float64] = _NONE
    denominator: NDArray[np.float64] = _NONE
    points: NDArray[np.float64] = _NONE
    pieces: NDArray[np.float64] = np.zeros((1, 5))


class User(NamedTuple):
    """A compiled function F(x, a, b, c, d) [N] of displacement and numbers, and its slope [N/m]."""

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


# --- which function belongs to which law ----------------------------------------------------------


def _by_number(functions: Sequence[Any], number: int = 0) -> Any:
    """Return a compiled function that calls the one of these that belongs to the law's number."""
    function = functions[number]
    if number == len(functions) - 1:
        return function
    others = _by_number(functions, number + 1)

    @inlined
    def chosen(law, q, x):
        if law.number == number:
            return function(law, q, x)
        return others(law, q, x)

    return chosen


@inlined
def _one(law, q, x):
    return simd.splat(1.0)


_forces = [vectorised(law.formulas.force, law) for law in LAWS]
_slopes = [vectorised(law.formulas.slope, law) for law in LAWS]
_denominators = [
    vectorised(law.formulas.denominator, law) if law.formulas.denominator else _one for law in LAWS
]
_force_by_number = _by_number([*_forces, formulas.located_force, formulas.table_force])
_slope_by_number = _by_number([*_slopes, formulas.located_slope, formulas.table_slope])
_denominator_by_number = _by_number([*_denominators, _one])


def _is_users(law):
    return law.instance_class is User


@chosen_by_type(acceleration)
def _acceleration(law, q, x):
    function = formulas.user_force if _is_users(law) else _force_by_number
    return lambda law, q, x: function(law, q, x)


@chosen_by_type(slope)
def _slope(law, q, x):
    function = formulas.user_slope if _is_users(law) else _slope_by_number
    return lambda law, q, x: function(law, q, x)


@chosen_by_type(denominator)
def _denominator(law, q, x):
    function = _one if _is_users(law) else _denominator_by_number
    return lambda law, q, x: function(law, q, x)


def _of_every_contact(one):
    """Return a function that calls `one` for every contact, whose laws may differ.

    The gaps of the contacts are read from rows `source`, `source + 1`, ..., and the results are
    stored in rows `target`, `target + 1`, ....
    """

    def every(kinds, q, lane, source, target):
        raise NotImplementedError("compiled code only")

    @chosen_by_type(every)
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
