"""Contact laws: the exact freeplay force and its continuous representations.

Every law has ``force(x)`` [N] and ``derivative(x)`` [N/m] on arrays of displacements [m],
for symmetric, asymmetric and zero gaps. Formulas and labels are those of the user guide;
`gapsweep.model.labels` builds any law from its label.

A law is one class, here or in `fitted`, `table` and `user_law`, with all properties that the rest
of the package uses, and one compiled form in `gapsweep.integrate.runge_kutta.laws`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError
from gapsweep.model.fit import unit_force
from gapsweep.model.oscillator import Gap, called_as, checked
from gapsweep.status import DIVERGED_AT

Array = NDArray[np.float64]
FIT_RANGE = 4e-3
_NOEVENTS = "noevents"
_HALVINGS = 60  # to the last digits of a double
_THIN = 30.0  # gap over the width of a layer


@dataclass(frozen=True)
class ContactLaw:
    """Base class of contact laws: force and slope over displacement.

    Parameters
    ----------
    K_c : float
        Contact stiffness [N/m], ``>= 0``; stiffness of the upper wall if the walls differ.
    gap : Gap
        Distances of the walls from the origin; a pair of numbers [m] is taken as well.
    K_ratio : float
        Stiffness of the lower wall over the stiffness of the upper wall [-], ``>= 0``.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> law.force([0.0, 0.5e-3]).round(3).tolist()  # in the gap, and a tenth of a millimetre beyond
    [0.0, 1.4]
    """

    # Beginning of the label.
    family: ClassVar[str] = ""
    # Whether laws of the family differ only in numbers, so that one compiled form takes them all.
    is_numbers: ClassVar[bool] = False
    # Whether the law has a convergence parameter: the larger, the closer to the exact law.
    is_sharpened: ClassVar[bool] = False

    K_c: float
    gap: Gap
    # Keyword-only: subclasses have positional parameters without a default after these two.
    K_ratio: float = field(default=1.0, kw_only=True)

    @classmethod
    def canonical(cls, label: str, parameter: str) -> str:
        """Return the canonical spelling of the parameter in a label.

        Raises
        ------
        ModelError
            If the parameter is invalid for this family.
        """
        raise NotImplementedError

    @classmethod
    def of_label(cls, parameter: str, fit_range: float) -> dict[str, Any]:
        """Return the parameters of the law, by name, from the parameter of a canonical label."""
        raise NotImplementedError

    @property
    def exact(self) -> "Piecewise":
        """The exact law with the same walls and stiffnesses."""
        return Piecewise(self.K_c, self.gap, K_ratio=self.K_ratio)

    @property
    def walls(self) -> tuple[float, float]:
        """Positions of the lower and upper wall [m]; ±`DIVERGED_AT` without stiffness."""
        low = -self.gap.j_1 if self.K_ratio * self.K_c else -DIVERGED_AT
        return low, self.gap.j_2 if self.K_c else DIVERGED_AT

    @property
    def is_symmetric(self) -> bool:
        """Whether the walls have equal distances and equal stiffnesses."""
        return self.gap.is_symmetric and self.K_ratio == 1.0

    @property
    def layer(self) -> float:
        """Thickness of the smoothing layer at a wall [m]; NaN for laws without a layer."""
        return math.nan

    @property
    def turns(self) -> tuple[float, ...] | None:
        """Displacements [m] that include all extrema of the force; None if unknown."""
        return None

    def __post_init__(self) -> None:
        for name in ("K_c", "K_ratio"):
            object.__setattr__(self, name, checked(name, getattr(self, name), low=0.0))
        object.__setattr__(self, "gap", checked_gap(self.gap))

    @property
    def valid_range(self) -> tuple[float, float]:
        """Lowest and highest displacement [m] at which the law is valid."""
        return -math.inf, math.inf

    def force(self, x: ArrayLike) -> Array:
        """Return the restoring force on the mass [N] at displacements `x` [m], of their shape."""
        raise NotImplementedError

    def derivative(self, x: ArrayLike) -> Array:
        """Return the slope dF_c/dx [N/m] at displacements `x` [m], of their shape."""
        raise NotImplementedError


@called_as("gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4)), in N/m and m")
@dataclass(frozen=True)
class Piecewise(ContactLaw):
    """Exact law: no force in the gap, stiffness times penetration beyond a wall.

    Parameters
    ----------
    located : bool
        Whether contact times are located within a step. False has the label
        ``piecewise-noevents``: the same force without event location.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> law.force(0.5e-3).round(3).item()
    1.4
    """

    family: ClassVar[str] = "piecewise"
    is_numbers: ClassVar[bool] = True

    located: bool = True

    @classmethod
    def canonical(cls, label: str, parameter: str) -> str:
        if label not in (cls.family, f"{cls.family}-{_NOEVENTS}"):
            raise ModelError(f"{label!r}: must be {cls.family} or {cls.family}-{_NOEVENTS}")
        return parameter

    @classmethod
    def of_label(cls, parameter: str, fit_range: float) -> dict[str, Any]:
        return {"located": not parameter}

    @property
    def turns(self) -> tuple[float, ...]:
        return ()

    def force(self, x: ArrayLike) -> Array:
        x = np.asarray(x, dtype=float)
        return np.asarray(self.K_c * unit_force(x, self.gap, self.K_ratio))

    def derivative(self, x: ArrayLike) -> Array:
        x = np.asarray(x, dtype=float)
        below = np.where(x < -self.gap.j_1, self.K_ratio * self.K_c, 0.0)
        return np.where(x > self.gap.j_2, self.K_c, below)


@dataclass(frozen=True)
class _Sharpened(ContactLaw):
    """A law with a convergence parameter [1/m], whose inverse is the width of its layer."""

    is_numbers: ClassVar[bool] = True
    is_sharpened: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        # A smooth law has a force everywhere: arctan K_c / (pi epsilon) at any distance.
        if self.K_c and (farthest := max(map(abs, self.walls))) > DIVERGED_AT:
            raise ModelError(
                f"wall at {farthest:g}: a smooth law needs walls within {DIVERGED_AT:g}, "
                "where motions count as diverged; a stop on one side has K_ratio = 0"
            )

    @property
    def sharpness(self) -> float:
        """The convergence parameter [1/m]."""
        raise NotImplementedError

    @property
    def layer(self) -> float:
        return 1.0 / self.sharpness

    @property
    def turns(self) -> tuple[float, ...] | None:
        return ()

    @classmethod
    def canonical(cls, label: str, parameter: str) -> str:
        try:
            value = float(parameter)
        except ValueError:
            raise ModelError(
                f"{label!r}: must be {cls.family} and its convergence parameter in 1/m, as "
                f"{cls.family}-1e4"
            ) from None
        if not (math.isfinite(value) and value > 0.0):
            raise ModelError(f"{label!r}: the convergence parameter must be > 0 and finite, in 1/m")
        digits, exponent = f"{value:.11e}".split("e")
        return f"{Decimal(digits).normalize():f}e{int(exponent)}"


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

    @classmethod
    def of_label(cls, parameter: str, fit_range: float) -> dict[str, Any]:
        return {"epsilon": float(parameter)}

    def _switch(self, z: Array) -> tuple[Array, Array]:
        """Value and derivative of the switch at scaled distance `z` [-]."""
        raise NotImplementedError

    def force(self, x: ArrayLike) -> Array:
        below, above = _penetrations(x, self.gap)
        s_below, _ = self._switch(self.epsilon * below)
        s_above, _ = self._switch(self.epsilon * above)
        blend = self.K_ratio * (1.0 - s_below) * below + (1.0 + s_above) * above
        return np.asarray(0.5 * self.K_c * blend)

    def derivative(self, x: ArrayLike) -> Array:
        below, above = _penetrations(x, self.gap)
        a, b = self.epsilon * below, self.epsilon * above
        s_below, d_below = self._switch(a)
        s_above, d_above = self._switch(b)
        slope = self.K_ratio * ((1.0 - s_below) - d_below * a) + (1.0 + s_above) + d_above * b
        return np.asarray(0.5 * self.K_c * slope)


@called_as("gs.Tanh(1.4e4, gs.Gap(4e-4, 4e-4), epsilon=1e4), in N/m, m and 1/m")
@dataclass(frozen=True)
class Tanh(_Switched):
    """Smooth approximation of the exact law by hyperbolic tangents.

    Parameters
    ----------
    epsilon : float
        Convergence parameter [1/m], ``> 0``; its reciprocal is the thickness of the layer.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Tanh(1.4e4, gs.Gap(0.4e-3, 0.4e-3), epsilon=1e4)
    >>> law.force(0.5e-3).round(2).item()  # the exact law's is 1.4
    1.23
    """

    family: ClassVar[str] = "tanh"

    @property
    def has_thin_layers(self) -> bool:
        """Whether the layers at both walls leave most of the gap free."""
        return self.epsilon * self.gap.width >= _THIN

    @cached_property
    def turns(self) -> tuple[float, ...] | None:
        """Both extrema of the force [m] between walls of equal stiffness; None for unequal ones.

        If the force has no extrema, both values are the middle of the gap.

        With walls ``w`` apart in ``u = ε (x - middle)`` the slope is ``h'(u - w/2) + h'(-u - w/2)``
        with ``h' = d/dz z (1 + tanh z)``. If the slope is negative in the middle, it changes sign
        once before each wall; if it is positive in the middle, it is positive everywhere.
        """
        if self.K_ratio != 1.0:
            return None
        half = 0.5 * self.epsilon * self.gap.width
        low, high = 0.0, half
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            falls = _blend_slope(middle - half) + _blend_slope(-middle - half) < 0.0
            low, high = (middle, high) if falls else (low, middle)
        centre, turn = 0.5 * (self.gap.j_2 - self.gap.j_1), low / self.epsilon
        return centre - turn, centre + turn

    def _switch(self, z: Array) -> tuple[Array, Array]:
        s = np.tanh(z)
        return s, 1.0 - s * s


def _blend_slope(z: float) -> float:
    s = math.tanh(z)
    return 1.0 + s + z * (1.0 - s * s)


@called_as("gs.Arctan(1.4e4, gs.Gap(4e-4, 4e-4), epsilon=1e4), in N/m, m and 1/m")
@dataclass(frozen=True)
class Arctan(_Switched):
    """Smooth approximation of the exact law by arctangents; its error decays algebraically.

    Parameters
    ----------
    epsilon : float
        Convergence parameter [1/m], ``> 0``.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Arctan(1.4e4, gs.Gap(0.4e-3, 0.4e-3), epsilon=1e4)
    >>> law.force(0.0).item()
    0.0
    """

    family: ClassVar[str] = "arctan"

    def _switch(self, z: Array) -> tuple[Array, Array]:
        return (2.0 / math.pi) * np.arctan(z), (2.0 / math.pi) / (1.0 + z * z)


@called_as("gs.LogArctan(1.4e4, gs.Gap(4e-4, 4e-4), gamma=1e4), in N/m, m and 1/m")
@dataclass(frozen=True)
class LogArctan(_Sharpened):
    """Smooth approximation: integral of an arctangent stiffness, with ``force(0) = 0``.

    Parameters
    ----------
    gamma : float
        Convergence parameter [1/m], ``> 0``.

    Notes
    -----
    The condition ``force(0) = 0`` shifts the force of an asymmetric contact by a constant; for
    ``j_1 = 0`` and equal stiffnesses about ``K_c (1 + ln(γ j_2)) / (π γ)``.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.LogArctan(1.4e4, gs.Gap(0.4e-3, 0.4e-3), gamma=1e4)
    >>> law.force(0.0).item()
    0.0
    """

    family: ClassVar[str] = "logarctan"

    gamma: float

    @property
    def sharpness(self) -> float:
        return self.gamma

    @classmethod
    def of_label(cls, parameter: str, fit_range: float) -> dict[str, Any]:
        return {"gamma": float(parameter)}

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "gamma", checked("gamma", self.gamma, low=0.0, strict=True))

    def _integral(self, x: Array) -> Array:
        below, above = _penetrations(x, self.gap)
        a, b = self.gamma * below, self.gamma * above
        logs = (self.K_ratio * np.log1p(a * a) - np.log1p(b * b)) / (2.0 * self.gamma)
        return np.asarray(above * np.arctan(b) - self.K_ratio * below * np.arctan(a) + logs)

    def force(self, x: ArrayLike) -> Array:
        x = np.asarray(x, dtype=float)
        anchored = self._integral(x) - self._integral(np.zeros(()))
        return np.asarray(self.K_c * (0.5 * (1.0 + self.K_ratio) * x + anchored / math.pi))

    def derivative(self, x: ArrayLike) -> Array:
        below, above = _penetrations(x, self.gap)
        angles = np.arctan(self.gamma * above) - self.K_ratio * np.arctan(self.gamma * below)
        return np.asarray(self.K_c * (0.5 * (1.0 + self.K_ratio) + angles / math.pi))


def checked_gap(gap: Gap | Sequence[float]) -> Gap:
    """Return a `Gap`, made from the distances of its two walls [m] if these are given.

    Raises
    ------
    ModelError
        If `gap` is neither.
    """
    if isinstance(gap, Gap):
        return gap
    if not isinstance(gap, Sequence) or isinstance(gap, str | bytes) or len(gap) != 2:
        raise ModelError(
            f"gap = {gap!r}: must be the distances of both walls in metres, as "
            "gs.Gap(4e-4, 4e-4) or (4e-4, 4e-4)"
        )
    return Gap(*gap)


def checked_law(law: ContactLaw) -> ContactLaw:
    """Return `law`; raise a `ModelError` if it is no contact law."""
    if not isinstance(law, ContactLaw):
        label = law if isinstance(law, str) else "tanh-1e4"
        remedy = "law(function" if callable(law) else f"contact_law({label!r}"
        raise ModelError(f"law = {law!r}: must be a contact law, as gs.{remedy}, K_c, gap)")
    return law


def _penetrations(x: ArrayLike, gap: Gap) -> tuple[Array, Array]:
    """Signed distances from the lower and the upper wall [m]."""
    x = np.asarray(x, dtype=float)
    return x + gap.j_1, x - gap.j_2
