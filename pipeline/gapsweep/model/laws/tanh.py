"""Smooth approximation by hyperbolic tangents."""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import copysign, exp
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from gapsweep.model.arithmetic import fma, select
from gapsweep.model.contact import Formulas
from gapsweep.model.laws.sharpened import Switched
from gapsweep.model.oscillator import called_as

Array = NDArray[np.float64]
# |epsilon (x - j)| from which tanh is +-1 in double precision, so the force exactly piecewise.
SATURATION = 19.0625
_HALVINGS = 60  # to the last digits of a double
_THIN = 30.0  # gap over the width of a layer


def _parts(x, ratio, sharpness, centre, half_gap):
    """Parts of both formulas; `near` and `far` of a name belong to the near and the far wall.

    With s = |x - centre| the force over K is the sign of x - centre times
    ``max(s - g, 0) - |s - g| q + (s + g) q2``, where q = 1 / (1 + exp(2 eps d)) for a wall at the
    distance d reduces the exact law. It keeps all digits where it is small, its exponential does
    not overflow, and a force between equal walls is odd about the centre to the last bit. The
    stiffnesses are relative to that of the upper wall.
    """
    y = x - centre
    sign = copysign(1.0, y)
    s = sign * y
    near, far = s - half_gap, s + half_gap
    side = copysign(1.0, near)
    e, e2 = exp(side * (-2.0 * sharpness) * near), exp(-2.0 * sharpness * far)
    is_below = sign < 0.0  # by the sign that the force gets, also of a zero
    weights = select(is_below, ratio, 1.0), select(is_below, 1.0, ratio)
    return sign, s, near, far, side, (e / (1.0 + e), e2 / (1.0 + e2)), weights


def _force(x, stiffness, ratio, sharpness, centre, half_gap):
    parts = _parts(x, ratio, sharpness, centre, half_gap)
    sign, s, near, _, side, (q, q2), (w, w2) = parts
    q, q2 = side * w * q, w2 * q2
    exact = select(side > 0.0, w, 0.0) * near
    # one product of functions of x: a Taylor series of the force has one convolution less
    return stiffness * sign * (exact + fma(s, q2 - q, half_gap * (q2 + q)))


def _slope(x, stiffness, ratio, sharpness, centre, half_gap):
    parts = _parts(x, ratio, sharpness, centre, half_gap)
    _, _, near, far, side, (q, q2), (w, w2) = parts
    two_eps = 2.0 * sharpness
    t = side * q - two_eps * near * (q - q * q)
    t2 = q2 - two_eps * far * (q2 - q2 * q2)
    return stiffness * (select(side > 0.0, w, 0.0) + w2 * t2 - w * t)


@called_as("gs.Tanh(1.4e4, gs.Gap(4e-4, 4e-4), epsilon=1e4), in N/m, m and 1/m")
@dataclass(frozen=True)
class Tanh(Switched):
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
    examples: ClassVar[tuple[str, ...]] = ("tanh-1e4",)
    words: ClassVar[str] = (
        "½ K_c [r (1 − s₁) (x + j₁) + (1 + s₂) (x − j₂)], s₁ = tanh ε(x + j₁), "
        "s₂ = tanh ε(x − j₂), ε [1/m] in its name"
    )
    formulas: ClassVar[Formulas] = Formulas(_force, _slope)
    approach: ClassVar[tuple[float, float]] = 0.5, 2.0

    @classmethod
    def rows(cls, low: Array, high: Array, ratio: Array, sharpness: Array) -> dict[str, Array]:
        # A lower wall without stiffness is far away: the gap's centre would lose digits with it.
        low = np.where(ratio == 0.0, high, low)
        half_gap = 0.5 * (high - low)
        layer = SATURATION / sharpness
        return {
            "sharpness": sharpness,
            "half_gap": half_gap,
            "centre": 0.5 * (high + low),
            "layer": layer,
            "saturation": layer,
        }

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
        turn = _turn(0.5 * self.epsilon * self.gap.width) / self.epsilon
        centre = 0.5 * (self.gap.j_2 - self.gap.j_1)
        return centre - turn, centre + turn

    def _switch(self, z: Array) -> tuple[Array, Array]:
        s = np.tanh(z)
        return s, 1.0 - s * s


@lru_cache(maxsize=1024)
def _turn(half: float) -> float:
    """Return the extremum u > 0 of the force between walls at ±half, for all stiffnesses alike."""
    low, high = 0.0, half
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        falls = _blend_slope(middle - half) + _blend_slope(-middle - half) < 0.0
        low, high = (middle, high) if falls else (low, middle)
    return low


def _blend_slope(z: float) -> float:
    s = math.tanh(z)
    return 1.0 + s + z * (1.0 - s * s)
