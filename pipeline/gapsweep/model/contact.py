"""Contact laws: the exact freeplay force and its continuous representations.

Every law has ``force(x)`` [N] and ``derivative(x)`` [N/m] on arrays of displacements [m],
for symmetric, asymmetric and zero gaps. Formulas and labels are those of the user guide;
`gapsweep.model.labels` builds any law from its label.

A law is one class here, with all that the rest of the package asks of it, and one compiled form in
`gapsweep.integrate.runge_kutta.laws`.
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from typing import ClassVar

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError, described
from gapsweep.model.fit import (
    MAX_DEGREE,
    MAX_RATIONAL_DEGREE,
    N_FIT_POINTS,
    Fit,
    goodness,
    polynomial_fit,
    rational_fit,
    unit_force,
)
from gapsweep.model.oscillator import Gap, checked

Array = NDArray[np.float64]
FIT_RANGE = 4e-3
_NOEVENTS = "noevents"
# A user's law has central differences for its slope: over the part of x that balances truncation
# and rounding, and never less than of a length [m] below which nothing moves.
SLOPE_STEP, SLOPE_LENGTH = 6e-6, 1e-9


@dataclass(frozen=True)
class ContactLaw:
    """What every contact law has.

    Parameters
    ----------
    K_c : float
        Contact stiffness [N/m], ``>= 0``.
    gap : Gap
        Distances of the two walls from the origin.
    """

    # What its label begins with, and its colour in every figure (Okabe & Ito, 2008: safe for
    # colour-blind readers).
    family: ClassVar[str] = ""
    colour: ClassVar[str] = "#56B4E9"
    # Whether laws of the family differ in numbers alone, so that one compiled form takes them all.
    is_numbers: ClassVar[bool] = False
    # Whether it has a convergence parameter: the larger, the nearer to the exact law.
    is_sharpened: ClassVar[bool] = False

    K_c: float
    gap: Gap

    @classmethod
    def canonical(cls, label: str, parameter: str) -> str:
        """The one spelling of what follows the family in a label.

        Raises
        ------
        ModelError
            If it is none of this family.
        """
        raise NotImplementedError

    @classmethod
    def from_label(cls, parameter: str, K_c: float, gap: Gap, fit_range: float) -> "ContactLaw":
        """The law of a canonical label, by what follows its family there."""
        raise NotImplementedError

    @property
    def layer(self) -> float:
        """Thickness of the smoothing layer at a wall [m]; NaN if it has none."""
        return math.nan

    def __post_init__(self) -> None:
        object.__setattr__(self, "K_c", checked("K_c", self.K_c, low=0.0))
        if not isinstance(self.gap, Gap):
            raise ModelError(f"gap = {self.gap!r}: must be a gapsweep.Gap(j_1, j_2)")

    @property
    def valid_range(self) -> float:
        """Largest displacement [m] at which the law represents the contact."""
        return math.inf

    def force(self, x: ArrayLike) -> Array:
        """Restoring force on the mass [N], shape of `x` [m]."""
        raise NotImplementedError

    def derivative(self, x: ArrayLike) -> Array:
        """Slope dF_c/dx [N/m], shape of `x` [m]."""
        raise NotImplementedError


@dataclass(frozen=True)
class Piecewise(ContactLaw):
    """Exact freeplay: zero in the gap, ``K_c`` times the penetration outside.

    Parameters
    ----------
    located : bool
        Whether integration stops at every contact. False is the label
        ``piecewise-noevents``: the same force, its kinks left to step-size control.
    """

    family: ClassVar[str] = "piecewise"
    colour: ClassVar[str] = "#000000"
    is_numbers: ClassVar[bool] = True

    located: bool = True

    @classmethod
    def canonical(cls, label: str, parameter: str) -> str:
        if label not in (cls.family, f"{cls.family}-{_NOEVENTS}"):
            raise ModelError(f"{label!r}: must be {cls.family} or {cls.family}-{_NOEVENTS}")
        return parameter

    @classmethod
    def from_label(cls, parameter: str, K_c: float, gap: Gap, fit_range: float) -> "ContactLaw":
        return cls(K_c, gap, located=not parameter)

    def force(self, x: ArrayLike) -> Array:
        return np.asarray(self.K_c * unit_force(np.asarray(x, dtype=float), self.gap))

    def derivative(self, x: ArrayLike) -> Array:
        x = np.asarray(x, dtype=float)
        return np.where((x < -self.gap.j_1) | (x > self.gap.j_2), self.K_c, 0.0)


@dataclass(frozen=True)
class _Sharpened(ContactLaw):
    """A law with a convergence parameter [1/m], whose inverse is the width of its layer."""

    is_numbers: ClassVar[bool] = True
    is_sharpened: ClassVar[bool] = True

    @property
    def sharpness(self) -> float:
        """The convergence parameter [1/m]."""
        raise NotImplementedError

    @property
    def layer(self) -> float:
        return 1.0 / self.sharpness

    @classmethod
    def canonical(cls, label: str, parameter: str) -> str:
        try:
            value = float(parameter)
        except ValueError:
            raise ModelError(f"{label!r}: {parameter!r} is not a number, as in tanh-1e4") from None
        if not (math.isfinite(value) and value > 0.0):
            raise ModelError(f"{label!r}: the convergence parameter must be > 0 and finite, in 1/m")
        digits, exponent = f"{value:.11e}".split("e")
        return f"{Decimal(digits).normalize():f}e{int(exponent)}"

    @classmethod
    def from_label(cls, parameter: str, K_c: float, gap: Gap, fit_range: float) -> "ContactLaw":
        return cls(K_c, gap, float(parameter))  # type: ignore[call-arg]  # of every law of this kind


@dataclass(frozen=True)
class _Switched(_Sharpened):
    """Both contact branches, each blended in by a switch ``s`` running from -1 to 1."""

    epsilon: float

    def __post_init__(self) -> None:
        super().__post_init__()
        value = checked("epsilon", self.epsilon, low=0.0, strict=True)
        object.__setattr__(self, "epsilon", value)

    @property
    def sharpness(self) -> float:
        return self.epsilon

    def _switch(self, z: Array) -> tuple[Array, Array]:
        """Value and derivative of the switch at scaled distance `z` [-]."""
        raise NotImplementedError

    def force(self, x: ArrayLike) -> Array:
        below, above = _penetrations(x, self.gap)
        s_below, _ = self._switch(self.epsilon * below)
        s_above, _ = self._switch(self.epsilon * above)
        blend = (1.0 - s_below) * below + (1.0 + s_above) * above
        return np.asarray(0.5 * self.K_c * blend)

    def derivative(self, x: ArrayLike) -> Array:
        below, above = _penetrations(x, self.gap)
        a, b = self.epsilon * below, self.epsilon * above
        s_below, d_below = self._switch(a)
        s_above, d_above = self._switch(b)
        slope = (1.0 - s_below) - d_below * a + (1.0 + s_above) + d_above * b
        return np.asarray(0.5 * self.K_c * slope)


@dataclass(frozen=True)
class Tanh(_Switched):
    """Hyperbolic-tangent blending.

    Parameters
    ----------
    epsilon : float
        Convergence parameter [1/m], ``> 0``; its inverse is the width of the layer.
    """

    family: ClassVar[str] = "tanh"
    colour: ClassVar[str] = "#0072B2"

    def _switch(self, z: Array) -> tuple[Array, Array]:
        s = np.tanh(z)
        return s, 1.0 - s * s


@dataclass(frozen=True)
class Arctan(_Switched):
    """Inverse-tangent blending, with algebraic tails far outside its layer.

    Parameters
    ----------
    epsilon : float
        Convergence parameter [1/m], ``> 0``.
    """

    family: ClassVar[str] = "arctan"
    colour: ClassVar[str] = "#009E73"

    def _switch(self, z: Array) -> tuple[Array, Array]:
        return (2.0 / math.pi) * np.arctan(z), (2.0 / math.pi) / (1.0 + z * z)


@dataclass(frozen=True)
class LogArctan(_Sharpened):
    """Integral of the arctan-smoothed stiffness, anchored so that ``force(0) = 0``.

    Parameters
    ----------
    gamma : float
        Convergence parameter [1/m], ``> 0``.

    Notes
    -----
    The anchor moves the force of an asymmetric gap by a constant, about
    ``K_c (1 + ln(γ j_2)) / (π γ)`` for ``j_1 = 0``.
    """

    family: ClassVar[str] = "logarctan"
    colour: ClassVar[str] = "#D55E00"

    gamma: float

    @property
    def sharpness(self) -> float:
        return self.gamma

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "gamma", checked("gamma", self.gamma, low=0.0, strict=True))

    def _integral(self, x: Array) -> Array:
        below, above = _penetrations(x, self.gap)
        a, b = self.gamma * below, self.gamma * above
        logs = (np.log1p(a * a) - np.log1p(b * b)) / (2.0 * self.gamma)
        return np.asarray(above * np.arctan(b) - below * np.arctan(a) + logs)

    def force(self, x: ArrayLike) -> Array:
        x = np.asarray(x, dtype=float)
        anchored = self._integral(x) - self._integral(np.zeros(()))
        return np.asarray(self.K_c * (x + anchored / math.pi))

    def derivative(self, x: ArrayLike) -> Array:
        below, above = _penetrations(x, self.gap)
        angles = np.arctan(self.gamma * above) - np.arctan(self.gamma * below)
        return np.asarray(self.K_c * (1.0 + angles / math.pi))


@dataclass(frozen=True)
class Fitted(ContactLaw):
    """A fit ``K_c N(u)/D(u)`` of the exact force, ``u = x / valid_range``."""

    @property
    def fit(self) -> Fit:
        """The fit per unit stiffness (computed once per gap, degrees and range)."""
        raise NotImplementedError

    @property
    def coefficients(self) -> tuple[Array, Array]:
        """Chebyshev coefficients in `u`: numerator [N] and denominator [-], lowest first."""
        fit = self.fit
        return self.K_c * np.array(fit.numerator), np.array(fit.denominator)

    @property
    def rmse(self) -> float:
        """Root-mean-square force error over the fit points [N]."""
        return self.K_c * self.fit.rmse

    @property
    def r_squared(self) -> float:
        """Coefficient of determination over the fit points [-]; independent of `K_c`."""
        return self.fit.r_squared

    def force(self, x: ArrayLike) -> Array:
        u = np.asarray(x, dtype=float) / self.valid_range
        top, bottom = self.coefficients
        return np.asarray(chebyshev.chebval(u, top) / chebyshev.chebval(u, bottom))

    def derivative(self, x: ArrayLike) -> Array:
        u = np.asarray(x, dtype=float) / self.valid_range
        top, bottom = self.coefficients
        d_top, d_bottom = chebyshev.chebder(top), chebyshev.chebder(bottom)
        n, d = chebyshev.chebval(u, top), chebyshev.chebval(u, bottom)
        slope = chebyshev.chebval(u, d_top) - n / d * chebyshev.chebval(u, d_bottom)
        return np.asarray(slope / d / self.valid_range)


@dataclass(frozen=True)
class Polynomial(Fitted):
    """Least-squares polynomial.

    Parameters
    ----------
    degree : int
        Polynomial degree, 1 to 60.
    fit_range : float
        Half-width of the fitted range [m], ``> 0``.
    """

    family: ClassVar[str] = "poly"
    colour: ClassVar[str] = "#E69F00"

    degree: int
    fit_range: float = FIT_RANGE

    @classmethod
    def canonical(cls, label: str, parameter: str) -> str:
        return str(_degree(label, parameter, MAX_DEGREE))

    @classmethod
    def from_label(cls, parameter: str, K_c: float, gap: Gap, fit_range: float) -> "ContactLaw":
        return cls(K_c, gap, int(parameter), fit_range)

    def __post_init__(self) -> None:
        super().__post_init__()
        value = checked("fit range", self.fit_range, low=0.0, strict=True)
        object.__setattr__(self, "fit_range", value)
        _ = self.fit

    @property
    def valid_range(self) -> float:
        return self.fit_range

    @property
    def fit(self) -> Fit:
        return polynomial_fit(self.gap, self.degree, self.fit_range)


@dataclass(frozen=True)
class RationalPolynomial(Fitted):
    """Least-squares rational polynomial without a pole in the fitted range.

    Parameters
    ----------
    numerator, denominator : int
        Degrees, 1 to 20.
    fit_range : float
        Half-width of the fitted range [m], ``> 0``.

    Raises
    ------
    ModelError
        If the best fit has a pole in the range; the message names it.
    """

    family: ClassVar[str] = "ratpoly"
    colour: ClassVar[str] = "#CC79A7"

    numerator: int
    denominator: int
    fit_range: float = FIT_RANGE

    @classmethod
    def canonical(cls, label: str, parameter: str) -> str:
        top, _, bottom = parameter.partition("/")
        degrees = (_degree(label, text, MAX_RATIONAL_DEGREE) for text in (top, bottom))
        return "{}/{}".format(*degrees)

    @classmethod
    def from_label(cls, parameter: str, K_c: float, gap: Gap, fit_range: float) -> "ContactLaw":
        top, bottom = parameter.split("/")
        return cls(K_c, gap, int(top), int(bottom), fit_range)

    def __post_init__(self) -> None:
        super().__post_init__()
        value = checked("fit range", self.fit_range, low=0.0, strict=True)
        object.__setattr__(self, "fit_range", value)
        _ = self.fit

    @property
    def valid_range(self) -> float:
        return self.fit_range

    @property
    def fit(self) -> Fit:
        return rational_fit(self.gap, self.numerator, self.denominator, self.fit_range)


@dataclass(frozen=True)
class UserLaw(ContactLaw):
    """A user's own contact law.

    Parameters
    ----------
    function : callable
        Scalar force [N] as a function of the displacement [m]. It must live in a module
        that the workers can import. `K_c` and `gap` only label it and place the walls at
        which contacts are counted.
    """

    function: Callable[[float], float]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not callable(self.function):
            raise ModelError(
                f"function = {self.function!r}: must be a function of x; "
                "for the law of a label use gapsweep.contact_law"
            )
        try:
            value = float(self.function(0.0))
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # the user's code may raise anything, SystemExit too
            raise ModelError(f"{self.name}(0.0) raised {described(error)}") from error
        if not math.isfinite(value):
            raise ModelError(f"{self.name}(0.0) = {value}: must be finite")

    @property
    def name(self) -> str:
        """Where the function lives, as ``"module:function"``."""
        return f"{self.function.__module__}:{getattr(self.function, '__qualname__', '?')}"

    def __str__(self) -> str:
        return self.name

    def force(self, x: ArrayLike) -> Array:
        x = np.asarray(x, dtype=float)
        return np.reshape([float(self.function(float(v))) for v in x.ravel()], x.shape)

    def derivative(self, x: ArrayLike) -> Array:
        x = np.asarray(x, dtype=float)
        h = SLOPE_STEP * np.maximum(np.abs(x), SLOPE_LENGTH)
        return np.asarray((self.force(x + h) - self.force(x - h)) / (2.0 * h))


# Every law that a label names, by its family, in the order of the user guide.
FAMILIES: dict[str, type[ContactLaw]] = {
    law.family: law for law in (Piecewise, Polynomial, RationalPolynomial, Tanh, Arctan, LogArctan)
}


def family(label: str) -> type[ContactLaw] | None:
    """The class of a label's law; None of ``auto`` and of users' laws."""
    return FAMILIES.get(label.partition("-")[0])


def _degree(label: str, text: str, largest: int) -> int:
    if not re.fullmatch(r"[0-9]{1,3}", text) or not 1 <= int(text) <= largest:
        raise ModelError(f"{label!r}: degree {text!r} must be a whole number in 1..{largest}")
    return int(text)


def checked_law(law: ContactLaw) -> ContactLaw:
    """`law`, or a `ModelError` if it is none."""
    if not isinstance(law, ContactLaw):
        raise ModelError(
            f"law = {law!r}: must be a contact law, as gapsweep.contact_law(label, K_c, gap) is"
        )
    return law


def static_error(law: ContactLaw, fit_range: float = FIT_RANGE) -> tuple[float, float]:
    """RMSE [N] and R² [-] of any law against the exact force on 8001 uniform points."""
    x = np.linspace(-fit_range, fit_range, N_FIT_POINTS)
    return goodness(checked_law(law).force(x), law.K_c * unit_force(x, law.gap))


def _penetrations(x: ArrayLike, gap: Gap) -> tuple[Array, Array]:
    """Signed distances from the lower and the upper wall [m]."""
    x = np.asarray(x, dtype=float)
    return x + gap.j_1, x - gap.j_2
