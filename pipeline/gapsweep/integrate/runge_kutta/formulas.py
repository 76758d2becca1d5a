"""Formulas of contact laws in vectors: ``F_c / m`` and its slope, for all lanes at once.

Laws with a label bring their formulas (`gapsweep.model.laws`); located contacts, tables and user
functions have theirs here. Numbers that differ between points are in the parameter block `q` of the
contact; numbers that a batch shares are in `law`.
"""

import math
from collections.abc import Callable
from typing import Any

from numba import njit

from gapsweep.integrate import simd
from gapsweep.integrate.jit import inlined, internal
from gapsweep.integrate.lanes.law_rows import SERIES, arguments, rows_of_law, with_callees
from gapsweep.integrate.lanes.parameters import (
    ACTIVE_HIGH,
    ACTIVE_LOW,
    ACTIVE_STIFFNESS,
    ACTIVE_WALL,
    OWN,
    STIFFNESS,
)
from gapsweep.integrate.simd import bits, fma, load
from gapsweep.model import arithmetic
from gapsweep.model.contact import ContactLaw

# --- laws with a label --------------------------------------------------------------------------


@inlined
def _is_any(condition):
    return bits(condition) != 0


# Forms for vectors of the functions that formulas call.
_VECTORS = {
    **{abs: simd.absolute, min: simd.minimum, max: simd.maximum, math.copysign: simd.copysign},
    **{math.sqrt: simd.sqrt, math.exp: simd.exp, math.log: simd.log, math.atan: simd.arctan},
    **{arithmetic.fma: simd.fma, arithmetic.select: simd.select, arithmetic.splat: simd.splat},
    arithmetic.is_any: _is_any,
}


def vectorised(formula: Callable[..., Any], law: type[ContactLaw]) -> Any:
    """Return a formula of a law as a compiled function of ``(law, q, x)``, of all lanes at once."""
    called, rows = with_callees(formula, dict(_VECTORS), inlined), rows_of_law(law)
    values = simd.loads([rows[name] for name in arguments(formula) if name not in SERIES])
    if "numerator" in arguments(formula):
        return inlined(lambda law, q, x: called(x, law.numerator, law.denominator, *values(q)))
    return inlined(lambda law, q, x: called(x, *values(q)))


# --- located contacts ---------------------------------------------------------------------------


@inlined
def located_force(law, q, x):
    return load(q, ACTIVE_STIFFNESS) * (x - load(q, ACTIVE_WALL))


@inlined
def located_slope(law, q, x):
    return load(q, ACTIVE_STIFFNESS)


# --- a table ------------------------------------------------------------------------------------


@internal
def _piece(points, x):
    """Number of points that are not above x; 0 for NaN."""
    low, high = 0, points.size
    while low < high:
        middle = (low + high) // 2
        if points[middle] <= x:
            low = middle + 1
        else:
            high = middle
    return low


@internal
def _table_terms(law, x):
    """Distance of every lane's x from the left end of its piece, and the piece's coefficients."""
    d = c_3 = c_2 = c_1 = c_0 = simd.splat(0.0)
    for lane in range(simd.WIDTH):
        at = simd.lane_value(x, lane)
        piece = law.pieces[_piece(law.points, at)]
        d = simd.with_lane(d, lane, at - piece[0])
        c_3 = simd.with_lane(c_3, lane, piece[1])
        c_2 = simd.with_lane(c_2, lane, piece[2])
        c_1 = simd.with_lane(c_1, lane, piece[3])
        c_0 = simd.with_lane(c_0, lane, piece[4])
    return d, c_3, c_2, c_1, c_0


@inlined
def table_force(law, q, x):
    d, c_3, c_2, c_1, c_0 = _table_terms(law, x)
    return load(q, STIFFNESS) * fma(fma(fma(c_3, d, c_2), d, c_1), d, c_0)


@inlined
def table_slope(law, q, x):
    d, c_3, c_2, c_1, _ = _table_terms(law, x)
    return load(q, STIFFNESS) * fma(fma(3.0 * c_3, d, 2.0 * c_2), d, c_1)


# --- a user's function --------------------------------------------------------------------------


@njit
def _each_lane(function, q, x):
    result = simd.splat(0.0)
    for lane in range(simd.WIDTH):
        named = q[OWN, lane], q[OWN + 1, lane], q[OWN + 2, lane], q[OWN + 3, lane]
        result = simd.with_lane(result, lane, function(simd.lane_value(x, lane), *named))
    return result


@inlined
def user_force(law, q, x):
    return load(q, STIFFNESS) * _each_lane(law.force, q, x)


@inlined
def user_slope(law, q, x):
    return load(q, STIFFNESS) * _each_lane(law.slope, q, x)


# --- a user's function of displacement and velocity ---------------------------------------------


@njit
def _each_lane_of_speed(function, q, x, v):
    result = simd.splat(0.0)
    for lane in range(simd.WIDTH):
        named = q[OWN, lane], q[OWN + 1, lane], q[OWN + 2, lane], q[OWN + 3, lane]
        state = simd.lane_value(x, lane), simd.lane_value(v, lane)
        interval = q[ACTIVE_LOW, lane], q[ACTIVE_HIGH, lane]
        result = simd.with_lane(result, lane, function(*state, *interval, *named))
    return result


@inlined
def of_speed(function, q, x, v):
    """A function of displacement and velocity, over mass."""
    return load(q, STIFFNESS) * _each_lane_of_speed(function, q, x, v)
