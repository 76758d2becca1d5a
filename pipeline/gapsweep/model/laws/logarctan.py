"""Smooth approximation by the integral of an arctangent stiffness."""

import math
from dataclasses import dataclass
from math import atan, log
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import ModelError
from gapsweep.model.arithmetic import fma, is_any
from gapsweep.model.contact import Formulas, penetrations
from gapsweep.model.laws.sharpened import (
    ARCTAN_LAYER,
    INVERSE_PI,
    Sharpened,
    arctan_switch,
    arctan_switch_slope,
)
from gapsweep.model.oscillator import called_as

Array = NDArray[np.float64]


def _force(x, stiffness, low, high, ratio, sharpness, offset):
    below, above = x - low, x - high
    z1, z2 = sharpness * below, sharpness * above
    logarithm = log(fma(z1, z1, 1.0) / fma(z2, z2, 1.0)) / (2.0 * sharpness)
    more = ratio - 1.0
    if is_any(abs(more) > 0.0):  # one more logarithm only for walls that differ
        logarithm = fma(more, log(fma(z1, z1, 1.0)) / (2.0 * sharpness), logarithm)
    arctans = above * atan(z2) - ratio * below * atan(z1)
    linear = (0.5 + 0.5 * ratio) * x
    return stiffness * fma(INVERSE_PI, arctans + logarithm + offset, linear)


def _slope(x, stiffness, low, high, ratio, sharpness):
    t1 = atan(sharpness * (x - low))
    t2 = atan(sharpness * (x - high))
    return stiffness * fma(INVERSE_PI, t2 - ratio * t1, 0.5 + 0.5 * ratio)


@called_as("gs.LogArctan(1.4e4, gs.Gap(4e-4, 4e-4), gamma=1e4), in N/m, m and 1/m")
@dataclass(frozen=True)
class LogArctan(Sharpened):
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
    symbol: ClassVar[str] = "gamma"
    examples: ClassVar[tuple[str, ...]] = ("logarctan-1e4",)
    words: ClassVar[str] = (
        "0 at x = 0, of slope ½ K_c [r (1 − s₁) + 1 + s₂], s₁ = (2/π) arctan γ(x + j₁), "
        "s₂ = (2/π) arctan γ(x − j₂), γ [1/m] in its name; "
        "with damping c, ½ c (2 − s₁ + s₂) v is added"
    )
    formulas: ClassVar[Formulas] = Formulas(
        _force, _slope, switch=arctan_switch, switch_slope=arctan_switch_slope
    )

    gamma: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if (nearest := min(self.gap.distances)) < 0.0:
            raise ModelError(
                f"gap: {nearest:g}: LogArctan has no force at x = 0, which must not lie beyond a "
                "wall; use gs.Piecewise or gs.Tanh"
            )

    @classmethod
    def rows(cls, low: Array, high: Array, ratio: Array, sharpness: Array) -> dict[str, Array]:
        below, above = -low, -high  # distances of x = 0 from the walls
        square = 1.0 + (sharpness * below) ** 2
        logarithm = np.log(square / (1.0 + (sharpness * above) ** 2))
        logarithm = logarithm + (ratio - 1.0) * np.log(square)
        at_zero = (
            above * np.arctan(sharpness * above)
            - ratio * below * np.arctan(sharpness * below)
            + logarithm / (2.0 * sharpness)
        )
        return {"sharpness": sharpness, "offset": -at_zero, "layer": ARCTAN_LAYER / sharpness}

    def _integral(self, x: Array) -> Array:
        (_, ratio), (below, above) = self.scale, penetrations(x, self)
        a, b = self.gamma * below, self.gamma * above
        logs = (ratio * np.log1p(a * a) - np.log1p(b * b)) / (2.0 * self.gamma)
        return np.asarray(above * np.arctan(b) - ratio * below * np.arctan(a) + logs)

    def _elastic(self, x: Array) -> Array:
        stiffness, ratio = self.scale
        anchored = self._integral(x) - self._integral(np.zeros(()))
        return np.asarray(stiffness * (0.5 * (1.0 + ratio) * x + anchored / math.pi))

    def _elastic_slope(self, x: Array) -> Array:
        (stiffness, ratio), (below, above) = self.scale, penetrations(x, self)
        angles = np.arctan(self.gamma * above) - ratio * np.arctan(self.gamma * below)
        return np.asarray(stiffness * (0.5 * (1.0 + ratio) + angles / math.pi))
