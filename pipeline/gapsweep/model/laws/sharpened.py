"""Bases of smooth approximations with a convergence parameter."""

import math
from dataclasses import dataclass, field
from decimal import Decimal
from math import atan
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError
from gapsweep.model.arithmetic import fma
from gapsweep.model.arrays import numbers
from gapsweep.model.contact import ContactLaw, Piecewise, penetrations
from gapsweep.model.contact_modes import NO_LOSSES, Losses
from gapsweep.model.oscillator import checked
from gapsweep.status import DIVERGED_AT

Array = NDArray[np.float64]
INVERSE_PI = 0.3183098861837907
# An arctangent decays like 1/z and never saturates: steps may skip nothing. Within 4 units of the
# wall it turns by 84 %; outside that the remaining curvature is on the scale of the distance
# itself, which the error estimate sees.
ARCTAN_LAYER = 4.0


def arctan_switch(x, low, high, sharpness):
    """Mean of 1 - s of the lower wall and 1 + s of the upper one, s = (2/π) arctan."""
    return fma(INVERSE_PI, atan(sharpness * (x - high)) - atan(sharpness * (x - low)), 1.0)


def arctan_switch_slope(x, low, high, sharpness):
    z1, z2 = sharpness * (x - low), sharpness * (x - high)
    return INVERSE_PI * sharpness * (1.0 / fma(z2, z2, 1.0) - 1.0 / fma(z1, z1, 1.0))


@dataclass(frozen=True)
class Sharpened(ContactLaw):
    """A law with a convergence parameter [1/m]; its inverse is the width of the layer at a wall.

    Parameters
    ----------
    damping : float
        Damping c of both walls [N s/m], ``>= 0``: a force c v, times the mean of the switches
        1 - s of the lower wall and 1 + s of the upper one, is added. The walls pull.
    """

    is_numbers: ClassVar[bool] = True
    is_sharpened: ClassVar[bool] = True

    damping: float = field(default=0.0, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "damping", checked("damping", self.damping, low=0.0))
        value = checked(self.symbol, getattr(self, self.symbol), low=0.0, strict=True)
        object.__setattr__(self, self.symbol, value)
        # A smooth law has a force everywhere: arctan K_c / (pi epsilon) at any distance.
        if self.K_c and (farthest := max(map(abs, self.walls))) > DIVERGED_AT:
            raise ModelError(
                f"wall at {farthest:g}: a smooth law needs walls within {DIVERGED_AT:g}, "
                "where motions count as diverged; a stop on one side has gs.Gap(None, 4e-4)"
            )

    @property
    def sharpness(self) -> float:
        """The convergence parameter [1/m]."""
        return float(getattr(self, self.symbol))

    @property
    def exact(self) -> Piecewise:
        """The exact law with the same walls, stiffnesses and damping: it pulls, as this one."""
        pulls, damping = self.damping > 0.0, self.damping
        return Piecewise(self.K_c, self.gap, K_ratio=self.K_ratio, damping=damping, pulls=pulls)

    @property
    def losses(self) -> Losses:
        return Losses(self.damping) if self.damping and self.K_c else NO_LOSSES

    @property
    def layer(self) -> float:
        return 1.0 / self.sharpness

    @property
    def turns(self) -> tuple[float, ...] | None:
        return ()

    @classmethod
    def of_label(cls, parameter: str, fit_range: float) -> dict[str, Any]:
        return {cls.symbol: float(parameter)}

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

    def _switch(self, z: Array) -> tuple[Array, Array]:
        """Value and derivative of the switch s from -1 to 1 at scaled distance `z` [-]."""
        return (2.0 / math.pi) * np.arctan(z), (2.0 / math.pi) / (1.0 + z * z)

    def _elastic(self, x: Array) -> Array:
        """Force [N] without damping."""
        raise NotImplementedError

    def _elastic_slope(self, x: Array) -> Array:
        """Slope [N/m] of the force without damping."""
        raise NotImplementedError

    def _share(self, x: Array) -> tuple[Array, Array]:
        """Share of the damping that acts [-], and its slope [1/m]."""
        (a, rate_a), (b, rate_b) = (self._switch(self.sharpness * (x - at)) for at in self.walls)
        return 0.5 * ((1.0 - a) + (1.0 + b)), 0.5 * self.sharpness * (rate_b - rate_a)

    def force(self, x: ArrayLike, v: ArrayLike = 0.0) -> Array:
        elastic = self._elastic(x := numbers("x", x))
        if not self.losses:
            return elastic
        return np.asarray(elastic + self.damping * self._share(x)[0] * numbers("v", v))

    def derivative(self, x: ArrayLike, v: ArrayLike = 0.0) -> Array:
        elastic = self._elastic_slope(x := numbers("x", x))
        if not self.losses:
            return elastic
        return np.asarray(elastic + self.damping * self._share(x)[1] * numbers("v", v))

    def derivative_by_speed(self, x: ArrayLike, v: ArrayLike = 0.0) -> Array:
        return np.asarray(
            self.losses.damping * self._share(numbers("x", x))[0] + 0.0 * numbers("v", v)
        )


@dataclass(frozen=True)
class Switched(Sharpened):
    """Both contact branches, each blended in by a switch ``s`` running from -1 to 1."""

    symbol: ClassVar[str] = "epsilon"

    epsilon: float

    def _elastic(self, x: Array) -> Array:
        (stiffness, ratio), (below, above) = self.scale, penetrations(x, self)
        s_below, _ = self._switch(self.epsilon * below)
        s_above, _ = self._switch(self.epsilon * above)
        blend = ratio * (1.0 - s_below) * below + (1.0 + s_above) * above
        return np.asarray(0.5 * stiffness * blend)

    def _elastic_slope(self, x: Array) -> Array:
        (stiffness, ratio), (below, above) = self.scale, penetrations(x, self)
        a, b = self.epsilon * below, self.epsilon * above
        s_below, d_below = self._switch(a)
        s_above, d_above = self._switch(b)
        slope = ratio * ((1.0 - s_below) - d_below * a) + (1.0 + s_above) + d_above * b
        return np.asarray(0.5 * stiffness * slope)
