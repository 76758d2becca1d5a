"""Constructors of compiled contact laws, from numbers or from arrays over points."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numba import float64, njit
from numba.core.errors import TypingError
from numba.core.types import Number
from numpy.typing import ArrayLike, NDArray

from gapsweep.integrate.lanes import parameters
from gapsweep.integrate.lanes.law_rows import rows_of_law, with_callees
from gapsweep.model.contact import ContactLaw
from gapsweep.model.laws import LAWS
from gapsweep.model.laws.fitted import in_blocks
from gapsweep.model.user_law import SLOPE_LENGTH, SLOPE_STEP, continued

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


def of_numbers(
    law: type[ContactLaw],
    K_c: ArrayLike,
    j_1: ArrayLike,
    j_2: ArrayLike,
    K_ratio: ArrayLike,
    sharpness: ArrayLike,
) -> Law:
    """Compiled law of a class of laws that differ in numbers only, from the numbers of n laws.

    K_c [N/m], j_1, j_2 [m], K_ratio [-] and the field `ContactLaw.symbol`, each of shape (n,).
    """
    q, (sharpness,) = _rows(K_c, j_1, j_2, K_ratio, sharpness=sharpness)
    rows = rows_of_law(law)
    low, high, ratio = (q[..., rows[name]] for name in ("low", "high", "ratio"))
    for name, values in law.rows(low, high, ratio, sharpness).items():
        q[..., rows[name]] = values
    return Law(Formula(LAWS.index(law)), q)


def located(K_c: ArrayLike, j_1: ArrayLike, j_2: ArrayLike, K_ratio: ArrayLike) -> Law:
    """Exact law whose contacts are located: steps end there."""
    return Law(Formula(laws.LOCATED), _rows(K_c, j_1, j_2, K_ratio)[0])


def fitted(
    law: type[ContactLaw],
    numerator: ArrayLike,
    denominator: ArrayLike,
    fit_range: float,
    j_1: float,
    j_2: float,
) -> Law:
    """Quotient of Chebyshev series in x / fit_range, numerator in N; walls only count contacts."""
    q, _ = _rows(1.0, j_1, j_2)
    q[parameters.RANGE] = fit_range
    top, bottom = np.array(numerator, dtype=float), np.array(denominator, dtype=float)
    # To the loop a denominator that is not positive means that a pole was passed.
    sign = np.sign(np.polynomial.chebyshev.chebval(0.0, bottom))
    series = {"numerator": in_blocks(sign * top), "denominator": in_blocks(sign * bottom)}
    return Law(Formula(LAWS.index(law), **series), q)


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
    *,
    is_of_speed: bool = False,
) -> Law:
    """User law F(x, ...) or F(x, v, ...) [N], compiled once per process; `named` has the values of
    its other arguments along the last axis. The tangent equations use central differences.

    Raises `NumbaError` if the function cannot be compiled.
    """
    q, _ = _rows(1.0, j_1, j_2)
    n = np.shape(named)[-1]
    q[..., parameters.OWN : parameters.OWN + n] = named
    return Law(_user_kind(function, n, is_of_speed), q)


# The dispatchers are part of the kernel's type: new ones would recompile the kernel. A function
# that numba refuses is not cached: the user may correct it.
@lru_cache(maxsize=64)
def _user_kind(function: Any, n: int, is_of_speed: bool) -> laws.User | laws.UserOfSpeed:
    # As in NumPy, x / 0.0 is infinite: no exception.
    compiled = njit(error_model="numpy")
    if is_of_speed:
        forms = (with_callees(each, {}, compiled) for each in continued(function))
        return laws.UserOfSpeed(*(_of_four_numbers(each, n) for each in forms))
    called = with_callees(function, {}, compiled)

    @njit
    def force(x: float, a: float, b: float, c: float, d: float) -> Any:
        return called(x, *(a, b, c, d)[:n])

    @njit
    def slope(x: float, *named: float) -> Any:
        h = SLOPE_STEP * max(abs(x), SLOPE_LENGTH)
        return (force(x + h, *named) - force(x - h, *named)) / (2.0 * h)

    _check_compiled(force, 5)
    return laws.User(force, slope)


def _of_four_numbers(called: Any, n: int) -> Any:
    """Return a compiled function F(x, v, low, high, a, b, c, d) of one that takes n numbers."""

    @njit
    def function(
        x: float, v: float, low: float, high: float, a: float, b: float, c: float, d: float
    ) -> Any:
        return called(x, v, low, high, *(a, b, c, d)[:n])

    _check_compiled(function, 8)
    return function


def _check_compiled(function: Any, n: int) -> None:
    """Compile a function of n numbers; refuse a result that is no number."""
    function.compile((float64,) * n)
    returned = function.nopython_signatures[0].return_type
    if not isinstance(returned, Number):
        raise TypingError(f"it returns {returned}, not a number")
