"""Bases of smooth approximations with a convergence parameter."""

import math
from dataclasses import dataclass
from decimal import Decimal
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError
from gapsweep.model.contact import ContactLaw, penetrations
from gapsweep.model.oscillator import checked
from gapsweep.status import DIVERGED_AT

Array = NDArray[np.float64]
INVERSE_PI = 0.3183098861837907
# An arctangent decays like 1/z and never saturates: steps may skip nothing. Within 4 units of the
# wall it turns by 84 %; outside that the remaining curvature is on the scale of the distance
# itself, which the error estimate sees.
ARCTAN_LAYER = 4.0


@dataclass(frozen=True)
class Sharpened(ContactLaw):
    """A law with a convergence parameter [1/m], whose inverse is the width of its layer."""

    is_numbers: ClassVar[bool] = True
    is_sharpened: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
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


@dataclass(frozen=True)
class Switched(Sharpened):
    """Both contact branches, each blended in by a switch ``s`` running from -1 to 1."""

    symbol: ClassVar[str] = "epsilon"

    epsilon: float

    def _switch(self, z: Array) -> tuple[Array, Array]:
        """Value and derivative of the switch at scaled distance `z` [-]."""
        raise NotImplementedError

    def force(self, x: ArrayLike, v: ArrayLike = 0.0) -> Array:
        (stiffness, ratio), (below, above) = self.scale, penetrations(x, self)
        s_below, _ = self._switch(self.epsilon * below)
        s_above, _ = self._switch(self.epsilon * above)
        blend = ratio * (1.0 - s_below) * below + (1.0 + s_above) * above
        return np.asarray(0.5 * stiffness * blend)

    def derivative(self, x: ArrayLike) -> Array:
        (stiffness, ratio), (below, above) = self.scale, penetrations(x, self)
        a, b = self.epsilon * below, self.epsilon * above
        s_below, d_below = self._switch(a)
        s_above, d_above = self._switch(b)
        slope = ratio * ((1.0 - s_below) - d_below * a) + (1.0 + s_above) + d_above * b
        return np.asarray(0.5 * stiffness * slope)
