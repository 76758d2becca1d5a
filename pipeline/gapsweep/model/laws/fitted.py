"""Contact laws that are fits of the exact force over a range: polynomial and rational."""

import math
import re
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError
from gapsweep.model.arithmetic import fma, splat
from gapsweep.model.arrays import numbers
from gapsweep.model.contact import FIT_RANGE, ContactLaw, Formulas
from gapsweep.model.fit import MAX_DEGREE, MAX_RATIONAL_DEGREE, Fit, polynomial_fit, rational_fit
from gapsweep.model.oscillator import called_as, checked

Array = NDArray[np.float64]


_BLOCK = 4  # coefficients


def in_blocks(c: ArrayLike) -> Array:
    """Return the coefficients of a Chebyshev series for `_series`.

    With ``T_(4j+i) = 2 T_4j T_i - T_(4j-i)`` the series is a sum of ``T_4j q_j``, in which each q_j
    has four terms: its value needs a third of the products of functions of u, and is as accurate.
    """
    given = np.asarray(c, dtype=float)
    blocks = np.zeros(-(-given.size // _BLOCK) * _BLOCK)
    blocks[: given.size] = given
    for first in range(blocks.size - _BLOCK, 0, -_BLOCK):
        for i in range(1, _BLOCK):
            blocks[first - i] -= blocks[first + i]
            blocks[first + i] *= 2.0
    return blocks


def _basis(u):
    """T_2, T_3 and T_4."""
    t2 = 2.0 * (u * u) - 1.0
    return t2, u * (2.0 * t2 - 1.0), 2.0 * (t2 * t2) - 1.0


def _block(c, j, u, t2, t3):
    k = 4 * j
    return fma(c[k + 3], t3, fma(c[k + 2], t2, fma(c[k + 1], u, c[k])))


def _slope_of_block(c, j, u, t2):
    k = 4 * j
    return fma(3.0 * c[k + 3], 2.0 * t2 + 1.0, fma(4.0 * c[k + 2], u, c[k + 1]))


def _series(c, u):
    """Chebyshev series at `u`, from its coefficients `in_blocks`, by Clenshaw's recurrence."""
    b1, b2 = splat(0.0), splat(0.0)
    t2, t3, t4 = _basis(u)
    for j in range(c.size // 4 - 1, 0, -1):
        b1, b2 = fma(2.0 * t4, b1, _block(c, j, u, t2, t3) - b2), b1
    return fma(t4, b1, _block(c, 0, u, t2, t3) - b2)


def _series_and_slope(c, u):
    """Chebyshev series at `u`, and its derivative with respect to `u`.

    The derivative is by Clenshaw's recurrence, differentiated.
    """
    b1, b2, d1, d2 = splat(0.0), splat(0.0), splat(0.0), splat(0.0)
    t2, t3, t4 = _basis(u)
    half = 16.0 * (u * t2)  # derivative of T_4
    for j in range(c.size // 4 - 1, 0, -1):
        slope = fma(2.0 * half, b1, _slope_of_block(c, j, u, t2) - d2)
        d1, d2 = fma(2.0 * t4, d1, slope), d1
        b1, b2 = fma(2.0 * t4, b1, _block(c, j, u, t2, t3) - b2), b1
    slope = fma(half, b1, _slope_of_block(c, 0, u, t2) - d2)
    return fma(t4, b1, _block(c, 0, u, t2, t3) - b2), fma(t4, d1, slope)


# Polynomials have a denominator, too, which they do not use: all fits have the same arguments.


def _polynomial_force(x, numerator, denominator, stiffness, fit_range):
    return stiffness * _series(numerator, x / fit_range)


def _polynomial_slope(x, numerator, denominator, stiffness, fit_range):
    return stiffness * _series_and_slope(numerator, x / fit_range)[1] / fit_range


def _rational_force(x, numerator, denominator, stiffness, fit_range):
    u = x / fit_range
    return stiffness * (_series(numerator, u) / _series(denominator, u))


def _rational_slope(x, numerator, denominator, stiffness, fit_range):
    n, dn = _series_and_slope(numerator, x / fit_range)
    d, dd = _series_and_slope(denominator, x / fit_range)
    return stiffness * (dn * d - n * dd) / (d * d) / fit_range


def _rational_denominator(x, numerator, denominator, fit_range):
    return _series(denominator, x / fit_range)


@dataclass(frozen=True)
class Fitted(ContactLaw):
    """A fit ``K_c N(u)/D(u)`` of the exact force, ``u = x / fit_range``."""

    adds_walls: ClassVar[bool] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        value = checked("fit range", self.fit_range, low=0.0, strict=True)
        object.__setattr__(self, "fit_range", value)
        lower = self.gap.j_1 if self.K_ratio else math.inf
        farther = max(abs(j) for j in (lower, self.gap.j_2) if j < math.inf)
        if value <= farther:
            raise ModelError(
                f"fit range = {value:g}: must be > {farther:g}, where the farther wall stands, "
                "whose contact the fit would leave out: raise it ([approximation] range of a study)"
            )
        _ = self.fit

    @property
    def valid_range(self) -> tuple[float, float]:
        return -self.fit_range, self.fit_range

    @property
    def fit_range(self) -> float:
        """Half-width of the fitted range [m]; a field of every subclass, after its degrees."""
        raise NotImplementedError

    @property
    def fit(self) -> Fit:
        """The fit per unit stiffness (cached by gap, stiffness ratio, degrees and range)."""
        raise NotImplementedError

    @property
    def coefficients(self) -> tuple[Array, Array]:
        """Chebyshev coefficients in `u`: numerator [N] and denominator [-], lowest first."""
        fit = self.fit
        return self.K_c * np.array(fit.numerator), np.array(fit.denominator)

    @cached_property
    def turns(self) -> tuple[float, ...]:
        top, bottom = self.coefficients
        slope = chebyshev.chebsub(
            chebyshev.chebmul(chebyshev.chebder(top), bottom),
            chebyshev.chebmul(top, chebyshev.chebder(bottom)),
        )
        if not slope.any():
            return ()
        # The real part of a complex root does no harm: `turns` may include other points.
        roots = chebyshev.chebroots(chebyshev.chebtrim(slope, 1e-14 * np.abs(slope).max()))
        return tuple((self.fit_range * np.unique(roots.real)).tolist())

    @property
    def rmse(self) -> float:
        """Root-mean-square force error over the fit points [N]."""
        return self.K_c * self.fit.rmse

    @property
    def r_squared(self) -> float:
        """Coefficient of determination over the fit points [-]; independent of `K_c`."""
        return self.fit.r_squared

    def force(self, x: ArrayLike, v: ArrayLike = 0.0) -> Array:
        u = numbers("x", x) / self.fit_range
        top, bottom = self.coefficients
        return np.asarray(chebyshev.chebval(u, top) / chebyshev.chebval(u, bottom))

    def derivative(self, x: ArrayLike, v: ArrayLike = 0.0) -> Array:
        u = numbers("x", x) / self.fit_range
        top, bottom = self.coefficients
        d_top, d_bottom = chebyshev.chebder(top), chebyshev.chebder(bottom)
        n, d = chebyshev.chebval(u, top), chebyshev.chebval(u, bottom)
        slope = chebyshev.chebval(u, d_top) - n / d * chebyshev.chebval(u, d_bottom)
        return np.asarray(slope / d / self.fit_range)


@called_as("gs.Polynomial(1.4e4, gs.Gap(4e-4, 4e-4), degree=13)")
@dataclass(frozen=True)
class Polynomial(Fitted):
    """Least-squares polynomial approximation of the exact law.

    Parameters
    ----------
    degree : int
        Polynomial degree, 1 to 60.
    fit_range : float
        Half-width of the fit range [m], larger than the distance of either wall.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Polynomial(1.4e4, gs.Gap(0.4e-3, 0.4e-3), degree=13)
    >>> law.r_squared > 0.99
    True
    """

    family: ClassVar[str] = "poly"
    symbol: ClassVar[str] = "degree"
    examples: ClassVar[tuple[str, ...]] = ("poly-13",)
    words: ClassVar[str] = "polynomial of the degree in its name, a least-squares fit"
    formulas: ClassVar[Formulas] = Formulas(_polynomial_force, _polynomial_slope)

    degree: int
    fit_range: float = FIT_RANGE

    @classmethod
    def canonical(cls, label: str, parameter: str) -> str:
        return str(_degree(label, parameter, MAX_DEGREE))

    @classmethod
    def of_label(cls, parameter: str, fit_range: float) -> dict[str, Any]:
        return {"degree": int(parameter), "fit_range": fit_range}

    @property
    def fit(self) -> Fit:
        return polynomial_fit(self.gap, self.degree, self.fit_range, self.K_ratio)


@called_as("gs.RationalPolynomial(1.4e4, gs.Gap(4e-4, 4e-4), numerator=5, denominator=3)")
@dataclass(frozen=True)
class RationalPolynomial(Fitted):
    """Least-squares rational approximation of the exact law, without poles in the fit range.

    Parameters
    ----------
    numerator, denominator : int
        Degrees, 1 to 20.
    fit_range : float
        Half-width of the fit range [m], larger than the distance of either wall.

    Raises
    ------
    ModelError
        If the best fit has a pole in the fit range.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.RationalPolynomial(1.4e4, gs.Gap(0.4e-3, 0.4e-3), numerator=5, denominator=3)
    >>> law.r_squared > 0.99
    True
    """

    family: ClassVar[str] = "ratpoly"
    examples: ClassVar[tuple[str, ...]] = ("ratpoly-5/3",)
    words: ClassVar[str] = "quotient of polynomials of the degrees in its name, a least-squares fit"
    formulas: ClassVar[Formulas] = Formulas(_rational_force, _rational_slope, _rational_denominator)

    numerator: int
    denominator: int
    fit_range: float = FIT_RANGE

    @classmethod
    def canonical(cls, label: str, parameter: str) -> str:
        top, _, bottom = parameter.partition("/")
        degrees = (_degree(label, text, MAX_RATIONAL_DEGREE) for text in (top, bottom))
        return "{}/{}".format(*degrees)

    @classmethod
    def of_label(cls, parameter: str, fit_range: float) -> dict[str, Any]:
        top, bottom = map(int, parameter.split("/"))
        return {"numerator": top, "denominator": bottom, "fit_range": fit_range}

    @property
    def fit(self) -> Fit:
        degrees = self.numerator, self.denominator
        return rational_fit(self.gap, *degrees, self.fit_range, self.K_ratio)


def _degree(label: str, text: str, largest: int) -> int:
    if not re.fullmatch(r"[0-9]{1,3}", text) or not 1 <= int(text) <= largest:
        raise ModelError(f"{label!r}: degree {text!r} must be a whole number in 1..{largest}")
    return int(text)
