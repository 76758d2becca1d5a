"""Smooth approximation by arctangents."""

from dataclasses import dataclass
from math import atan
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from gapsweep.model.arithmetic import fma
from gapsweep.model.contact import Formulas
from gapsweep.model.laws.sharpened import (
    ARCTAN_LAYER,
    INVERSE_PI,
    Switched,
    arctan_switch,
    arctan_switch_slope,
)
from gapsweep.model.oscillator import called_as

Array = NDArray[np.float64]


def _force(x, stiffness, low, high, ratio, sharpness):
    t1, t2 = atan(sharpness * (x - low)), atan(sharpness * (x - high))
    t1 = ratio * t1
    # one product of functions of x: a Taylor series of the force has one convolution less
    switched = x * (t2 - t1) - (high * t2 - low * t1)
    linear = (0.5 + 0.5 * ratio) * x - 0.5 * (high + ratio * low)
    return stiffness * fma(INVERSE_PI, switched, linear)


def _slope(x, stiffness, low, high, ratio, sharpness):
    z1, z2 = sharpness * (x - low), sharpness * (x - high)
    d1 = atan(z1) + z1 / fma(z1, z1, 1.0)
    d2 = atan(z2) + z2 / fma(z2, z2, 1.0)
    return stiffness * fma(INVERSE_PI, d2 - ratio * d1, 0.5 + 0.5 * ratio)


@called_as("gs.Arctan(1.4e4, gs.Gap(4e-4, 4e-4), epsilon=1e4), in N/m, m and 1/m")
@dataclass(frozen=True)
class Arctan(Switched):
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
    examples: ClassVar[tuple[str, ...]] = ("arctan-1e4",)
    words: ClassVar[str] = (
        "½ K_c [r (1 − s₁) (x + j₁) + (1 + s₂) (x − j₂)], s₁ = (2/π) arctan ε(x + j₁), "
        "s₂ = (2/π) arctan ε(x − j₂), ε [1/m] in its name; "
        "with damping c, ½ c (2 − s₁ + s₂) v is added"
    )
    formulas: ClassVar[Formulas] = Formulas(
        _force, _slope, switch=arctan_switch, switch_slope=arctan_switch_slope
    )

    @classmethod
    def rows(cls, low: Array, high: Array, ratio: Array, sharpness: Array) -> dict[str, Array]:
        return {"sharpness": sharpness, "layer": ARCTAN_LAYER / sharpness}
