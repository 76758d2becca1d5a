"""Smooth approximation by hyperbolic tangents."""

import math
from dataclasses import dataclass
from functools import cached_property
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
    """x - centre; of the near and the far wall the distances, switches, exponential, stiffnesses.

    With s = |x - centre|, F/K = sign * ((s - g) p + (s + g) p2), where p = 1 / (1 + exp(-2 eps d))
    is the switch at a distance d beyond a wall. Exponentials of negative arguments do not overflow,
    and keep all digits of a small switch. A force between equal walls is odd about the centre to
    the last bit. The stiffnesses are those of the near and the far wall over that of the upper one.
    """
    y = x - centre
    s = abs(y)
    near, far = s - half_gap, s + half_gap
    e, e2 = exp(-2.0 * sharpness * abs(near)), exp(-2.0 * sharpness * far)
    p, p2 = select(near > 0.0, 1.0, e) / (1.0 + e), 1.0 / (1.0 + e2)
    is_below = copysign(1.0, y) < 0.0  # by the sign that the force gets, also of a zero
    weights = select(is_below, ratio, 1.0), select(is_below, 1.0, ratio)
    return y, near, far, (p, p2), e2, weights


def _force(x, stiffness, ratio, sharpness, centre, half_gap):
    y, near, far, (p, p2), e2, (w, w2) = _parts(x, ratio, sharpness, centre, half_gap)
    return copysign(stiffness, y) * fma(w * near, p, w2 * far * (e2 * p2))


def _slope(x, stiffness, ratio, sharpness, centre, half_gap):
    _, near, far, (p, p2), e2, (w, w2) = _parts(x, ratio, sharpness, centre, half_gap)
    two_eps = 2.0 * sharpness
    s2 = e2 * p2
    t1 = fma(two_eps * near, p * (1.0 - p), p)
    t2 = fma(-two_eps * far, s2 * p2, s2)
    return stiffness * (w * t1 + w2 * t2)


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
