"""Contact laws: the exact freeplay force and its continuous representations.

Every law has ``force(x)`` [N] and ``derivative(x)`` [N/m] on arrays of displacements [m],
for symmetric, asymmetric and zero gaps. Formulas and labels are those of the user guide;
`gapsweep.model.labels` builds any law from its label.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError, described
from gapsweep.model.fit import N_FIT_POINTS, Fit, goodness, polynomial_fit, rational_fit, unit_force
from gapsweep.model.oscillator import Gap, checked

Array = NDArray[np.float64]
FIT_RANGE = 4e-3
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

    K_c: float
    gap: Gap

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

    located: bool = True

    def force(self, x: ArrayLike) -> Array:
        return np.asarray(self.K_c * unit_force(np.asarray(x, dtype=float), self.gap))

    def derivative(self, x: ArrayLike) -> Array:
        x = np.asarray(x, dtype=float)
        return np.where((x < -self.gap.j_1) | (x > self.gap.j_2), self.K_c, 0.0)


@dataclass(frozen=True)
class _Switched(ContactLaw):
    """Both contact branches, each blended in by a switch ``s`` running from -1 to 1."""

    epsilon: float

    def __post_init__(self) -> None:
        super().__post_init__()
        value = checked("epsilon", self.epsilon, low=0.0, strict=True)
        object.__setattr__(self, "epsilon", value)

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

    def _switch(self, z: Array) -> tuple[Array, Array]:
        return (2.0 / math.pi) * np.arctan(z), (2.0 / math.pi) / (1.0 + z * z)


@dataclass(frozen=True)
class LogArctan(ContactLaw):
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

    gamma: float

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
class _Fitted(ContactLaw):
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
class Polynomial(_Fitted):
    """Least-squares polynomial.

    Parameters
    ----------
    degree : int
        Polynomial degree, 1 to 60.
    fit_range : float
        Half-width of the fitted range [m], ``> 0``.
    """

    degree: int
    fit_range: float = FIT_RANGE

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
class RationalPolynomial(_Fitted):
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

    numerator: int
    denominator: int
    fit_range: float = FIT_RANGE

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
