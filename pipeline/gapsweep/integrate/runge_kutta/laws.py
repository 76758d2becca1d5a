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
from gapsweep.integrate.lanes import parameters
from gapsweep.integrate.lanes.parameters import N_PARAMETERS, STIFFNESS
from gapsweep.integrate.simd import load, select, store
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
_EMPTY = np.zeros(0)


class Formula(NamedTuple):
    """A contact law of this package."""

    number: int  # number of the formula, as `LOCATED`
    # `numerator`, `denominator`: fits: Chebyshev series in x / range [N], `in_blocks`; the
    # denominator is positive in the range.
    numerator: NDArray[np.float64] = _EMPTY
    denominator: NDArray[np.float64] = _EMPTY
    # `points`, `pieces`: tables: left ends of the pieces [m], and `gapsweep.ForceTable.pieces`.
    points: NDArray[np.float64] = _EMPTY
    pieces: NDArray[np.float64] = np.zeros((1, 5))


class User(NamedTuple):
    """A compiled function F(x, a, b, c, d) [N] of displacement and numbers, and its slope [N/m]."""

    force: Any
    slope: Any


class UserOfSpeed(NamedTuple):
    """A compiled function F(x, v, low, high, a, b, c, d) [N] of displacement, velocity, interval of
    the gap in the present mode, and numbers; its derivatives by x [N/m] and by v [N s/m].
    """

    force: Any
    slope: Any
    damping: Any


USERS = User, UserOfSpeed


def acceleration(law, q, x):
    """F_c(x) / m of every lane [m/s^2]."""
    raise NotImplementedError("compiled code only")


def slope(law, q, x):
    """dF_c/dx / m of every lane [1/s^2]."""
    raise NotImplementedError("compiled code only")


def denominator(law, q, x):
    """Denominator of the law, positive where the law is valid; 1 for a law without one."""
    raise NotImplementedError("compiled code only")


def pressure(law, q, c, x, v):
    """F_c(x, v) / m of every lane [m/s^2]: the force of the spring, and that of the damping c / m.

    The force of a user's function is the first.
    """
    raise NotImplementedError("compiled code only")


def pressure_slopes(law, q, c, x, v):
    """Derivatives of both parts of `pressure` by x, and of their sum by v."""
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


@inlined
def _none(law, q, x):
    return simd.splat(0.0)


def _vectorised(name: str, otherwise: Any) -> Any:
    """Return the formula of a name of every law, as a compiled function."""
    several = [(getattr(law.formulas, name), law) for law in LAWS]
    return [vectorised(one, law) if one else otherwise for one, law in several]


_force_by_number = _by_number(
    [*_vectorised("force", None), formulas.located_force, formulas.table_force]
)
_slope_by_number = _by_number(
    [*_vectorised("slope", None), formulas.located_slope, formulas.table_slope]
)
_denominator_by_number = _by_number([*_vectorised("denominator", _one), _one])
_switch_by_number = _by_number([*_vectorised("switch", _none), _none])
_switch_slope_by_number = _by_number([*_vectorised("switch_slope", _none), _none])


def _is_users(law):
    return law.instance_class in USERS


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


@inlined
def _pressure_of_speed(law, q, c, x, v):
    return formulas.of_speed(law.force, q, x, v), simd.splat(0.0)


@inlined
def _slopes_of_speed(law, q, c, x, v):
    by_x, by_v = formulas.of_speed(law.slope, q, x, v), formulas.of_speed(law.damping, q, x, v)
    return by_x, simd.splat(0.0), by_v


@chosen_by_type(pressure)
def _pressure(law, q, c, x, v):
    if law.instance_class is UserOfSpeed:
        return lambda law, q, c, x, v: _pressure_of_speed(law, q, c, x, v)
    switch = _none if _is_users(law) else _switch_by_number
    return lambda law, q, c, x, v: (acceleration(law, q, x), c * switch(law, q, x) * v)


@chosen_by_type(pressure_slopes)
def _pressure_slopes(law, q, c, x, v):
    if law.instance_class is UserOfSpeed:
        return lambda law, q, c, x, v: _slopes_of_speed(law, q, c, x, v)
    switch, bend = _switch_by_number, _switch_slope_by_number
    if _is_users(law):
        switch = bend = _none
    return lambda law, q, c, x, v: (
        slope(law, q, x),
        c * bend(law, q, x) * v,
        c * switch(law, q, x),
    )


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
            store(lane, target, one(kinds[0], q[0], load(lane, source)))
            every(kinds[1:], q[1:], lane, source + 1, target + 1)

        return first_and_others

    return every


def pressures(at, kinds, q, lane, gap, speed, i):
    """Compute the `pressure` of every contact from contact i on, into rows `force` and `drag`.

    Gaps and their speeds are read from rows from `gap` and from `speed` on.
    """
    raise NotImplementedError("compiled code only")


@chosen_by_type(pressures)
def _pressures(at, kinds, q, lane, gap, speed, i):
    if not len(kinds):
        return lambda at, kinds, q, lane, gap, speed, i: None

    def first_and_others(at, kinds, q, lane, gap, speed, i):
        c, x, v = load(lane, at.contact_damping + i), load(lane, gap), load(lane, speed)
        force, drag = pressure(kinds[0], q[0], c, x, v)
        store(lane, at.force + i, force)
        store(lane, at.drag + i, drag)
        pressures(at, kinds[1:], q[1:], lane, gap + 1, speed + 1, i + 1)

    return first_and_others


def all_slopes(at, kinds, q, lane, gap, speed, i):
    """Compute derivatives of `pressures`: by x into the same rows, by v into rows `drag_rate`."""
    raise NotImplementedError("compiled code only")


@chosen_by_type(all_slopes)
def _all_slopes(at, kinds, q, lane, gap, speed, i):
    if not len(kinds):
        return lambda at, kinds, q, lane, gap, speed, i: None

    def first_and_others(at, kinds, q, lane, gap, speed, i):
        c, x, v = load(lane, at.contact_damping + i), load(lane, gap), load(lane, speed)
        by_x, drag, by_v = pressure_slopes(kinds[0], q[0], c, x, v)
        store(lane, at.force + i, by_x)
        store(lane, at.drag + i, drag)
        store(lane, at.drag_rate + i, by_v)
        all_slopes(at, kinds[1:], q[1:], lane, gap + 1, speed + 1, i + 1)

    return first_and_others


def set_active(at, kinds, q, lane, mode, i):
    """Write what the laws of located contacts need to know of their modes, in rows from `mode` on.

    For the law `LOCATED` stiffness and wall, for a user's function the interval of the gap.
    """
    raise NotImplementedError("compiled code only")


@chosen_by_type(set_active)
def _set_active(at, kinds, q, lane, mode, i):
    if not len(kinds):
        return lambda at, kinds, q, lane, mode, i: None
    one = _set_interval if kinds[0].instance_class is UserOfSpeed else _set_spring

    def first_and_others(at, kinds, q, lane, mode, i):
        one(at, q[0], lane, load(lane, mode), i)
        set_active(at, kinds[1:], q[1:], lane, mode + 1, i + 1)

    return first_and_others


@inlined
def _set_spring(at, q, lane, mode, i):
    none = simd.splat(0.0)
    upper, lower = load(lane, at.upper_stiffness + i), load(lane, at.lower_stiffness + i)
    stiffness = select(mode > 0.0, upper, select(mode < 0.0, lower, none))
    high, low = load(lane, at.upper + i), load(lane, at.lower + i)
    wall = select(mode > 0.0, high, select(mode < 0.0, low, none))
    store(q, parameters.ACTIVE_STIFFNESS, stiffness)
    store(q, parameters.ACTIVE_WALL, wall)


@inlined
def _set_interval(at, q, lane, mode, i):
    low, high = interval(at, lane, mode, i)
    store(q, parameters.ACTIVE_LOW, low)
    store(q, parameters.ACTIVE_HIGH, high)


@inlined
def interval(at, lane, mode, i):
    """Interval of a contact's gap that a mode allows."""
    lower, upper = load(lane, at.lower + i), load(lane, at.upper + i)
    low = select(mode > 0.0, upper, select(mode < 0.0, simd.splat(-np.inf), lower))
    return low, select(mode < 0.0, lower, select(mode > 0.0, simd.splat(np.inf), upper))


accelerations = _of_every_contact(acceleration)
slopes = _of_every_contact(slope)
denominators = _of_every_contact(denominator)
