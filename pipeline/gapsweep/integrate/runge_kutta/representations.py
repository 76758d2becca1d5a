"""Constructors of compiled contact laws, from numbers or from arrays over points."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from types import CellType, FunctionType
from typing import Any

import numpy as np
from numba import float64, njit
from numba.core.errors import TypingError
from numba.core.types import Number
from numpy.typing import ArrayLike, NDArray

from gapsweep.integrate.lanes import parameters
from gapsweep.model.user_law import SLOPE_LENGTH, SLOPE_STEP

from . import laws
from .laws import Formula, Law

Array = NDArray[np.float64]

_WALLS = parameters.STIFFNESS, parameters.WALL_LOW, parameters.WALL_HIGH, parameters.RATIO


def _rows(
    K_c: ArrayLike,
    j_1: ArrayLike,
    j_2: ArrayLike,
    K_ratio: ArrayLike = 1.0,
    **extra: ArrayLike,
) -> tuple[Array, Sequence[Array]]:
    """Parameter rows with the walls set, and `extra` broadcast to them: one row, or one a point."""
    given = K_c, -np.asarray(j_1), j_2, K_ratio, *extra.values()
    values = np.broadcast_arrays(*(np.asarray(a, dtype=float) for a in given))
    q = np.zeros((*values[0].shape, parameters.N_PARAMETERS))
    for row, value in zip(_WALLS, values, strict=False):
        q[..., row] = value
    others = values[len(_WALLS) :]
    if q.ndim == 1:
        return q, others
    return q.reshape(-1, parameters.N_PARAMETERS), [each.ravel() for each in others]


def tanh(
    K_c: ArrayLike, j_1: ArrayLike, j_2: ArrayLike, epsilon: ArrayLike, K_ratio: ArrayLike = 1.0
) -> Law:
    """Freeplay smoothed with tanh; K_c [N/m], j_1, j_2 [m], epsilon [1/m], K_ratio [-]."""
    q, (sharpness,) = _rows(K_c, j_1, j_2, K_ratio, epsilon=epsilon)
    high = q[..., parameters.WALL_HIGH]
    # A lower wall without stiffness is far away: the gap's centre would lose digits with it.
    low = np.where(q[..., parameters.RATIO] == 0.0, high, q[..., parameters.WALL_LOW])
    half_gap = 0.5 * (high - low)
    q[..., parameters.SHARPNESS], q[..., parameters.HALF_GAP] = sharpness, half_gap
    q[..., parameters.CENTRE] = 0.5 * (high + low)
    q[..., parameters.DECAY] = np.exp(-4.0 * sharpness * half_gap)
    layer = parameters.TANH_SATURATION / sharpness
    q[..., parameters.LAYER] = q[..., parameters.SATURATION] = layer
    return Law(Formula(laws.TANH), q)


def arctan(
    K_c: ArrayLike, j_1: ArrayLike, j_2: ArrayLike, epsilon: ArrayLike, K_ratio: ArrayLike = 1.0
) -> Law:
    """Freeplay smoothed with (2/pi) arctan; epsilon [1/m]."""
    q, (sharpness,) = _rows(K_c, j_1, j_2, K_ratio, epsilon=epsilon)
    q[..., parameters.SHARPNESS] = sharpness
    q[..., parameters.LAYER] = parameters.ARCTAN_LAYER / q[..., parameters.SHARPNESS]
    return Law(Formula(laws.ARCTAN), q)


def log_arctan(
    K_c: ArrayLike, j_1: ArrayLike, j_2: ArrayLike, gamma: ArrayLike, K_ratio: ArrayLike = 1.0
) -> Law:
    """Integral of the arctan-smoothed stiffness, anchored at F_c(0) = 0; gamma [1/m]."""
    q, (sharpness,) = _rows(K_c, j_1, j_2, K_ratio, gamma=gamma)
    below, above = -q[..., parameters.WALL_LOW], -q[..., parameters.WALL_HIGH]  # x - wall at x = 0
    ratio, square = q[..., parameters.RATIO], 1.0 + (sharpness * below) ** 2
    logarithm = np.log(square / (1.0 + (sharpness * above) ** 2)) + (ratio - 1.0) * np.log(square)
    at_zero = (
        above * np.arctan(sharpness * above)
        - ratio * below * np.arctan(sharpness * below)
        + logarithm / (2.0 * sharpness)
    )
    q[..., parameters.SHARPNESS], q[..., parameters.OFFSET] = sharpness, -at_zero
    q[..., parameters.LAYER] = parameters.ARCTAN_LAYER / sharpness
    return Law(Formula(laws.LOG_ARCTAN), q)


def piecewise(
    K_c: ArrayLike,
    j_1: ArrayLike,
    j_2: ArrayLike,
    K_ratio: ArrayLike = 1.0,
    *,
    located: bool = False,
) -> Law:
    """Exact freeplay; with `located` steps end at its contacts."""
    q, _ = _rows(K_c, j_1, j_2, K_ratio)
    return Law(Formula(laws.LOCATED if located else laws.PIECEWISE), q)


def polynomial(coefficients: ArrayLike, fit_range: float, j_1: float, j_2: float) -> Law:
    """Polynomial of Chebyshev coefficients [N] in x / fit_range; walls only count contacts."""
    q, _ = _rows(1.0, j_1, j_2)
    q[parameters.RANGE] = fit_range
    series = np.ascontiguousarray(coefficients, dtype=float)
    return Law(Formula(laws.POLYNOMIAL, numerator=series), q)


def rational_polynomial(
    numerator: ArrayLike, denominator: ArrayLike, fit_range: float, j_1: float, j_2: float
) -> Law:
    """Quotient of Chebyshev series in x / fit_range, numerator in N."""
    q, _ = _rows(1.0, j_1, j_2)
    q[parameters.RANGE] = fit_range
    top, bottom = np.array(numerator, dtype=float), np.array(denominator, dtype=float)
    # To the loop a denominator that is not positive means that a pole was passed.
    sign = np.sign(np.polynomial.chebyshev.chebval(0.0, bottom))
    return Law(Formula(laws.RATIONAL, numerator=sign * top, denominator=sign * bottom), q)


def table(points: ArrayLike, pieces: ArrayLike, j_1: float, j_2: float) -> Law:
    """Piecewise cubic curve of a `gapsweep.ForceTable`; walls only count contacts."""
    points = np.ascontiguousarray(points, dtype=float)
    q, _ = _rows(1.0, j_1, j_2)
    q[parameters.CENTRE] = 0.5 * (points[0] + points[-1])
    q[parameters.RANGE] = 0.5 * (points[-1] - points[0])
    kept = np.ascontiguousarray(pieces, dtype=float)
    return Law(Formula(laws.TABLE, points=points, pieces=kept), q)


def user(
    function: Callable[..., float],
    j_1: ArrayLike = np.inf,
    j_2: ArrayLike = np.inf,
    named: ArrayLike = (),
) -> Law:
    """User law F(x, ...) [N], compiled once per process; `named` has the values of its other
    arguments along the last axis. The tangent equations use central differences.

    Raises
    ------
    NumbaError
        If the function cannot be compiled.
    """
    q, _ = _rows(1.0, j_1, j_2)
    n = np.shape(named)[-1]
    q[..., parameters.OWN : parameters.OWN + n] = named
    return Law(_user_kind(function, n), q)


# The dispatchers are part of the kernel's type: new ones would recompile the kernel. A function
# that numba refuses is not cached: the user may correct it.
@lru_cache(maxsize=64)
def _user_kind(function: Any, n: int) -> laws.User:
    called = _compiled(function, {})

    @njit
    def force(x: float, a: float, b: float, c: float, d: float) -> Any:
        return called(x, *(a, b, c, d)[:n])

    @njit
    def slope(x: float, *named: float) -> Any:
        h = SLOPE_STEP * max(abs(x), SLOPE_LENGTH)
        return (force(x + h, *named) - force(x - h, *named)) / (2.0 * h)

    force.compile((float64,) * 5)
    returned = force.nopython_signatures[0].return_type
    if not isinstance(returned, Number):
        raise TypingError(f"it returns {returned}, not a number")
    return laws.User(force, slope)


def _compiled(function: Any, known: dict[Any, Any]) -> Any:
    """Compile a function, and the plain Python functions that it calls by name."""
    if not isinstance(function, FunctionType):
        return function
    if function not in known:
        names, code = dict(function.__globals__), function.__code__
        cells = [CellType(cell.cell_contents) for cell in function.__closure__ or ()]
        defaults = function.__defaults__
        copy = FunctionType(code, names, function.__name__, defaults, tuple(cells))
        # Before its callees: it may call itself. As in NumPy, x / 0.0 is infinite: no exception.
        known[function] = njit(copy, error_model="numpy")
        for name in names.keys() & {*code.co_names}:
            names[name] = _compiled(names[name], known)
        for cell in cells:
            cell.cell_contents = _compiled(cell.cell_contents, known)
    return known[function]
