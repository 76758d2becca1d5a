"""Formulas of contact laws in vectors: ``F_c / m`` and its slope, for all lanes at once.

Laws with a label bring their formulas (`gapsweep.model.laws`); located contacts, tables and user
functions have theirs here. Numbers that differ between points are in the parameter block `q` of the
contact; numbers that a batch shares are in `law`.
"""

import builtins
import math
from collections.abc import Callable
from inspect import signature
from types import BuiltinFunctionType, CellType, FunctionType
from typing import Any

from numba import njit

from gapsweep.integrate import simd
from gapsweep.integrate.jit import inlined, internal
from gapsweep.integrate.lanes import parameters
from gapsweep.integrate.lanes.parameters import ACTIVE_STIFFNESS, ACTIVE_WALL, OWN, STIFFNESS
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
# Rows of the arguments that are numbers of every law.
_ROWS = {
    "stiffness": STIFFNESS,
    "low": parameters.WALL_LOW,
    "high": parameters.WALL_HIGH,
    "ratio": parameters.RATIO,
    "layer": parameters.LAYER,
    "saturation": parameters.SATURATION,
    "fit_range": parameters.RANGE,
}


# Arguments that are series of a fit: fields of the compiled law.
_SERIES = ("numerator", "denominator")


def rows_of(law: type[ContactLaw]) -> dict[str, int]:
    """Return the rows of the arguments of a law's formulas: own numbers from row `OWN` on."""
    several = filter(None, law.formulas)
    names = dict.fromkeys(name for each in several for name in _arguments(each))
    own = [name for name in names if name not in _ROWS and name not in _SERIES]
    free = parameters.LAYER - OWN
    assert len(own) <= free, f"{law.family}: {own}: a law has at most {free} own numbers"
    return _ROWS | {name: OWN + i for i, name in enumerate(own)}


def vectorised(formula: Callable[..., Any], law: type[ContactLaw]) -> Any:
    """Return a formula of a law as a compiled function of ``(law, q, x)``, of all lanes at once."""
    called, rows = with_callees(formula, dict(_VECTORS), inlined), rows_of(law)
    values = simd.loads([rows[name] for name in _arguments(formula) if name not in _SERIES])
    if "numerator" in _arguments(formula):
        return inlined(lambda law, q, x: called(x, law.numerator, law.denominator, *values(q)))
    return inlined(lambda law, q, x: called(x, *values(q)))


def _arguments(formula: Callable[..., Any]) -> list[str]:
    """Names of a formula's arguments after the displacement."""
    return [*signature(formula).parameters][1:]


def with_callees(function: Any, known: dict[Any, Any], compiled: Callable[..., Any]) -> Any:
    """Compile a function, and the plain Python functions that it calls by name.

    Parameters
    ----------
    function : callable
        Returned as it is if it is neither known nor a plain function.
    known : dict
        Compiled functions by function, which take their place; new ones are added.
    compiled : callable
        Compiles one function, as ``numba.njit``.
    """
    if isinstance(function, BuiltinFunctionType):
        return known.get(function, function)
    if not isinstance(function, FunctionType):
        return function
    if function not in known:
        names, code = {**vars(builtins), **function.__globals__}, function.__code__
        cells = [CellType(cell.cell_contents) for cell in function.__closure__ or ()]
        defaults = function.__defaults__
        copy = FunctionType(code, names, function.__name__, defaults, tuple(cells))
        known[function] = compiled(copy)  # before its callees: it may call itself
        for name in names.keys() & {*code.co_names}:
            names[name] = with_callees(names[name], known, compiled)
        for cell in cells:
            cell.cell_contents = with_callees(cell.cell_contents, known, compiled)
    return known[function]


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
