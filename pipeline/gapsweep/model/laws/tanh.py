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
_ONLY_LOWER = 2.0**50  # stiffness of the lower wall over that of a missing upper one
_THIN = 30.0  # gap over the width of a layer


def _parts(x, ratio, sharpness, centre, half_gap, decay):
    """Side of the gap's centre, distances to both walls, their weights, and the two exponentials.

    With s = |x - centre|, F/K = sign * ((s - g) / (1 + E) + (s + g) E2 / (1 + E2)) where
    E = exp(-2 eps (s - g)) and E2 = exp(-2 eps (s + g)) = E exp(-4 eps g): one exponential for two
    walls, and a force between equal walls that is odd about the centre to the last bit. The clip at
    40 > 2 * 19.06 only touches arguments where tanh is +-1 in double anyway, and keeps E finite.
    The weights are the stiffnesses of the near and of the far wall over that of the upper one.
    """
    y = x - centre
    s = abs(y)
    near, far = s - half_gap, s + half_gap
    e = exp(min(max(-2.0 * sharpness * near, -40.0), 40.0))
    is_below = copysign(1.0, y) < 0.0  # by the sign that the force gets, also of a zero
    weights = select(is_below, ratio, 1.0), select(is_below, 1.0, ratio)
    return y, near, far, weights, e, e * decay


def _force(x, stiffness, ratio, sharpness, centre, half_gap, decay, saturation):
    y, near, far, (w, w2), e, e2 = _parts(x, ratio, sharpness, centre, half_gap, decay)
    p, p2 = 1.0 + e, 1.0 + e2
    f = fma(w * near, p2, w2 * far * e2 * p) / (p * p2)
    # Where tanh is saturated the law *is* the piecewise one, exactly: no leak of e-18 into the gap.
    f = select(
        near > saturation,
        w * near,
        select((near < -saturation) & (far > saturation), 0.0, f),
    )
    return copysign(stiffness, y) * f


def _slope(x, stiffness, ratio, sharpness, centre, half_gap, decay):
    _, near, far, (w, w2), e, e2 = _parts(x, ratio, sharpness, centre, half_gap, decay)
    two_eps = 2.0 * sharpness
    s1, s2 = 1.0 / (1.0 + e), e2 / (1.0 + e2)
    t1 = fma(two_eps * near, s1 * (1.0 - s1), s1)
    t2 = fma(-two_eps * far, s2 * (1.0 - s2), s2)
    return stiffness * (w * t1 + w2 * t2)


def _switches(x, low, high, sharpness):
    """Half of 1 - s of the lower wall, and half of 1 + s of the upper one, s = tanh."""
    below, above = -2.0 * sharpness * (low - x), -2.0 * sharpness * (x - high)
    s1 = 1.0 / (1.0 + exp(min(max(below, -40.0), 40.0)))
    return s1, 1.0 / (1.0 + exp(min(max(above, -40.0), 40.0)))


def _share(x, low, high, sharpness):
    s1, s2 = _switches(x, low, high, sharpness)
    return s1 + s2


def _share_slope(x, low, high, sharpness):
    s1, s2 = _switches(x, low, high, sharpness)
    return 2.0 * sharpness * (s2 * (1.0 - s2) - s1 * (1.0 - s1))


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
        "s₂ = tanh ε(x − j₂), ε [1/m] in its name; "
        "with damping c, ½ c (2 − s₁ + s₂) v is added"
    )
    formulas: ClassVar[Formulas] = Formulas(
        _force, _slope, switch=_share, switch_slope=_share_slope
    )

    @classmethod
    def rows(cls, low: Array, high: Array, ratio: Array, sharpness: Array) -> dict[str, Array]:
        # A missing wall is far away: the gap's centre would lose digits with it.
        low, high = np.where(ratio == 0.0, high, low), np.where(ratio > _ONLY_LOWER, low, high)
        half_gap = 0.5 * (high - low)
        layer = SATURATION / sharpness
        return {
            "sharpness": sharpness,
            "half_gap": half_gap,
            "centre": 0.5 * (high + low),
            "decay": np.exp(-4.0 * sharpness * half_gap),
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

        If the force has no extrema, both values are the middle of the gap. None, too, for one wall
        and for walls that overlap.

        With walls ``w`` apart in ``u = ε (x - middle)`` the slope is ``h'(u - w/2) + h'(-u - w/2)``
        with ``h' = d/dz z (1 + tanh z)``. If the slope is negative in the middle, it changes sign
        once before each wall; if it is positive in the middle, it is positive everywhere.
        """
        if self.K_ratio != 1.0 or not 0.0 <= self.gap.width < math.inf:
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
