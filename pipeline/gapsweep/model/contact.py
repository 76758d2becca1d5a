"""The base class of contact laws, and the exact freeplay force.

Every law has ``force(x, v)`` [N] and ``derivative(x)`` [N/m] on arrays of displacements [m] and
velocities [m/s], for symmetric, asymmetric and zero gaps. `gapsweep.model.labels` builds any law
from its label.

The exact law is in this file. The approximations are classes in files of `gapsweep.model.laws`,
each with all that the rest of the package uses: label, texts, force, and the formulas that the
compiled engine uses.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError
from gapsweep.model.arithmetic import select
from gapsweep.model.arrays import numbers
from gapsweep.model.contact_modes import NO_LOSSES, Losses
from gapsweep.model.oscillator import LARGEST, Gap, called_as, checked, share
from gapsweep.status import DIVERGED_AT

Array = NDArray[np.float64]
FIT_RANGE = 4e-3
# Parameters of a contact in addition to its stiffness and gap, with the values of elastic contacts
# with equal walls. Each applies to both walls.
OF_WALLS: Mapping[str, float] = {
    **{"K_ratio": 1.0, "damping": 0.0, "preload": 0.0},
    **{"chi": 0.0, "restitution": 1.0},
}
# Parameters of one law each: the label of the law may have the value.
OF_LABELS = ("chi", "restitution")
_NOEVENTS = "noevents"
# Stiffness of a missing upper wall over that of the lower one, where formulas divide by it: its
# force is below rounding.
_NO_WALL = 2.0**-100


class Formulas(NamedTuple):
    """Force [N] and slope [N/m] of a law as the compiled engine computes them.

    Each is a function of the displacement x [m] and of the numbers that its other arguments name:
    ``stiffness`` [N/m] (of the upper wall; 1 for fits), ``low`` and ``high`` (positions of the
    walls [m]), ``ratio`` (`ContactLaw.K_ratio`), ``fit_range`` [m], and those of
    `ContactLaw.rows`, four at most. A fit has its Chebyshev series, ``numerator`` and
    ``denominator`` (`fitted.in_blocks`), directly after x. A formula is written with operators,
    constants, ``abs``, ``min``, ``max``, the functions ``sqrt``, ``exp``, ``log``, ``atan`` and
    ``copysign`` of ``math``, those of `gapsweep.model.arithmetic` and functions of the same file.
    """

    force: Callable[..., Any]
    slope: Callable[..., Any]
    # Positive where the law is valid.
    denominator: Callable[..., Any] | None = None
    # Share of the walls' damping that acts [-], and its slope [1/m], of laws that take damping.
    switch: Callable[..., Any] | None = None
    switch_slope: Callable[..., Any] | None = None


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
    # Whether the force is the sum of the forces of both walls, which then may overlap.
    adds_walls: ClassVar[bool] = True
    # Whether the law has a convergence parameter: the larger, the closer to the exact law.
    is_sharpened: ClassVar[bool] = False
    # Name of the field that the label holds, if the law errs less the larger it is.
    symbol: ClassVar[str] = ""
    # For laws with a label: labels, the first one for a first trial; and the force in words.
    examples: ClassVar[tuple[str, ...]] = ()
    words: ClassVar[str] = ""
    formulas: ClassVar[Formulas]

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

    @classmethod
    def rows(cls, low: Array, high: Array, ratio: Array, sharpness: Array) -> Mapping[str, Array]:
        """Return further numbers of the `formulas` of n laws, by name, each of shape (n,).

        ``layer``, no argument of a formula, is the half-width [m] of the layers at the walls, which
        steps resolve.

        Parameters
        ----------
        low, high : ndarray, shape (n,)
            Positions of the walls [m].
        ratio : ndarray, shape (n,)
            Stiffness of the lower wall over the stiffness of the upper wall [-].
        sharpness : ndarray, shape (n,)
            Values of the field `symbol`; NaN for a law without one.
        """
        return {}

    @classmethod
    def made(cls, K_c: float, gap: Gap, **numbers: Any) -> "ContactLaw":
        """Return the law with a stiffness [N/m], a gap and other parameters by name."""
        return cls(K_c, gap, **numbers)

    @classmethod
    def takes(cls, name: str) -> bool:
        """Whether the law has a parameter, as ``"damping"``."""
        return any(each.name == name and each.init for each in fields(cls))

    @property
    def exact(self) -> "Piecewise":
        """The exact law with the same walls and stiffnesses; of a smooth law with its damping."""
        return Piecewise(self.K_c, self.gap, K_ratio=self.K_ratio)

    @property
    def losses(self) -> Losses:
        """Energy losses of the contact; none of an elastic contact."""
        return NO_LOSSES

    @property
    def has_modes(self) -> bool:
        """Whether the force has a kink or a jump at the walls, between the modes of a contact."""
        return False

    @property
    def is_located(self) -> bool:
        """Whether the times at which walls are passed are located."""
        return False

    @property
    def stiffnesses(self) -> tuple[float, float]:
        """Stiffnesses of the lower and the upper wall [N/m]; 0 without a wall."""
        gap, K_c = self.gap, self.K_c
        return self.K_ratio * K_c * (gap.j_1 < math.inf), K_c * (gap.j_2 < math.inf)

    @property
    def scale(self) -> tuple[float, float]:
        """Stiffness of the upper wall [N/m], and that of the lower wall over it, in `formulas`."""
        if self.gap.j_2 == math.inf:
            return self.K_c * _NO_WALL, self.K_ratio / _NO_WALL
        return self.K_c, self.K_ratio if self.gap.j_1 < math.inf else 0.0

    @property
    def walls(self) -> tuple[float, float]:
        """Positions of the lower and upper wall [m]; ±`DIVERGED_AT` without stiffness."""
        lower, upper = self.stiffnesses
        return -self.gap.j_1 if lower else -DIVERGED_AT, self.gap.j_2 if upper else DIVERGED_AT

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
        if self.gap.width < 0.0 and not self.adds_walls:
            raise ModelError(
                f"gap = {self.gap.j_1:g}, {self.gap.j_2:g}: the walls overlap (j_1 + j_2 < 0), "
                f"which {type(self).__name__} does not cover; use gs.Piecewise or gs.Tanh"
            )

    @property
    def of_walls(self) -> "tuple[ContactLaw, ...]":
        """The law; for walls that overlap the laws of the upper and of the lower wall."""
        if self.gap.width >= 0.0:
            return (self,)
        walls = Gap(math.inf, self.gap.j_2), Gap(self.gap.j_1, math.inf)
        return tuple(replace(self, gap=gap) for gap in walls)

    @property
    def valid_range(self) -> tuple[float, float]:
        """Lowest and highest displacement [m] at which the law is valid."""
        return -math.inf, math.inf

    def force(self, x: ArrayLike, v: ArrayLike = 0.0) -> Array:
        """Return the restoring force on the mass [N] at displacements `x` [m], of their shape.

        Velocities `v` [m/s], of the same shape or one number, matter to contacts that lose energy.
        """
        raise NotImplementedError

    def derivative(self, x: ArrayLike, v: ArrayLike = 0.0) -> Array:
        """Return the slope dF_c/dx [N/m] at displacements `x` [m] and velocities `v` [m/s]."""
        raise NotImplementedError

    def derivative_by_speed(self, x: ArrayLike, v: ArrayLike = 0.0) -> Array:
        """Return dF_c/dv [N s/m] at displacements `x` [m] and velocities `v` [m/s]."""
        return np.zeros(np.broadcast_shapes(np.shape(x), np.shape(v)))


def _piecewise_force(x: Any, stiffness: Any, low: Any, high: Any, ratio: Any) -> Any:
    below = ratio * (x - low)
    return stiffness * select(x > high, x - high, select(x < low, below, 0.0))


def _piecewise_slope(x: Any, stiffness: Any, low: Any, high: Any, ratio: Any) -> Any:
    below = select(x < low, ratio, 0.0)
    return stiffness * select(x > high, 1.0, below)


@called_as("gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4)), in N/m and m")
@dataclass(frozen=True)
class Piecewise(ContactLaw):
    """Exact law: no force in the gap, stiffness times penetration beyond a wall.

    Parameters
    ----------
    located : bool
        Whether contact times are located within a step. False has the label
        ``piecewise-noevents``: the same force without event location.
    damping : float
        Damping c of both walls [N s/m], ``>= 0``: beyond a wall, a force c times the speed of
        penetration is added; 0 by default. It needs located contacts.
    pulls : bool
        Whether a wall with damping pulls the mass back while it leaves. By default it never pulls:
        the force ends where it falls to zero, before the mass has left the wall.
    preload : float
        Force N₀ [N], ``>= 0``, with which the spring of each wall is compressed already when the
        mass touches it, whatever `K_ratio`: beyond a wall the force is N₀ plus K_c times the
        penetration; 0 by default. A mass that a load below N₀ presses on such a wall comes to rest
        there. It needs located contacts.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> law.force(0.5e-3).round(3).item()
    1.4
    >>> stop = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3), damping=60.0)
    >>> stop.force(0.5e-3, [0.01, 0.0, -0.1]).round(3).tolist()  # inwards, at rest, outwards
    [2.0, 1.4, 0.0]
    >>> clutch = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3), preload=5.0)
    >>> clutch.force([0.4e-3, 0.5e-3, -0.5e-3]).round(3).tolist()
    [0.0, 6.4, -6.4]
    """

    family: ClassVar[str] = "piecewise"
    is_numbers: ClassVar[bool] = True
    examples: ClassVar[tuple[str, ...]] = ("piecewise", "piecewise-noevents")
    words: ClassVar[str] = (
        "K_c (x − j₂) for x > j₂, r K_c (x + j₁) for x < −j₁, 0 between; with damping c, c ẋ is "
        "added beyond a wall, and the wall pulls only with pulls = true; also of "
        "piecewise-noevents, which does not locate contacts"
    )
    formulas: ClassVar[Formulas] = Formulas(_piecewise_force, _piecewise_slope)

    located: bool = True
    damping: float = field(default=0.0, kw_only=True)
    pulls: bool = field(default=False, kw_only=True)
    preload: float = field(default=0.0, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("damping", "preload"):
            object.__setattr__(self, name, checked(name, getattr(self, name), low=0.0))
        for name in ("located", "pulls"):
            if getattr(self, name) not in (True, False):
                raise ModelError(f"{name} = {getattr(self, name)!r}: must be True or False")
        if not self.located and self.losses:
            raise ModelError(f"{self.losses}: needs located contacts; leave located=False out")

    @property
    def losses(self) -> Losses:
        if not (self.damping or self.preload):
            return NO_LOSSES
        never_pulls = self.damping > 0.0 and not self.pulls
        return Losses(self.damping, never_pulls, preload=self.preload)

    @property
    def has_modes(self) -> bool:
        return True

    @property
    def is_located(self) -> bool:
        return self.located

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

    def force(self, x: ArrayLike, v: ArrayLike = 0.0) -> Array:
        x, v, (low, high) = numbers("x", x), numbers("v", v), self.walls
        above = self._pressure(x - high, v, 1.0)
        return np.asarray(above - self._pressure(low - x, -v, self.K_ratio))

    def _pressure(self, depth: Array, speed: Array, ratio: float) -> Array:
        """Force of a wall [N], ``ratio`` times as stiff as the upper one, at a depth [m]."""
        spring = self.K_c * (ratio * np.maximum(depth, 0.0))
        if self.preload:
            spring = spring + np.where(depth > 0.0, self.preload, 0.0)
        if not self.damping:
            return spring
        damper = np.where(depth > 0.0, self.damping * speed, 0.0)
        return spring + damper if self.pulls else np.maximum(spring + damper, 0.0)

    def derivative(self, x: ArrayLike, v: ArrayLike = 0.0) -> Array:
        return self._both(x, v, 0)

    def derivative_by_speed(self, x: ArrayLike, v: ArrayLike = 0.0) -> Array:
        return self._both(x, v, 1)

    def _both(self, x: ArrayLike, v: ArrayLike, which: int) -> Array:
        """One of the `_slopes`, summed over both walls."""
        x, v, (low, high) = numbers("x", x), numbers("v", v), self.walls
        above = self._slopes(x - high, v, 1.0)[which]
        return np.asarray(above + self._slopes(low - x, -v, self.K_ratio)[which])

    def _slopes(self, depth: Array, speed: Array, ratio: float) -> tuple[Array, Array]:
        """Derivatives of `_pressure` by depth [N/m] and by speed [N s/m]."""
        acts = depth + 0.0 * speed > 0.0
        if self.losses.never_pulls:
            acts = acts & (self._pressure(depth, speed, ratio) > 0.0)
        return np.where(acts, ratio * self.K_c, 0.0), np.where(acts, self.damping, 0.0)


@called_as("gs.HuntCrossley(1.4e4, gs.Gap(4e-4, 4e-4), chi=0.3), in N/m, m and s/m")
@dataclass(frozen=True)
class HuntCrossley(Piecewise):
    """Hunt–Crossley contact: stiffness times depth d times 1 + χ times the speed of penetration.

    The force is zero where a contact begins and ends. Label: ``huntcrossley-0.3`` for χ = 0.3 s/m,
    or ``huntcrossley`` with χ as a parameter of the study.

    Parameters
    ----------
    chi : float
        Factor χ of the speed of penetration [s/m], ``>= 0``: a body that meets the wall at a low
        speed u leaves it with the coefficient of restitution 1 − 2χu/3.

    Examples
    --------
    >>> import gapsweep as gs
    >>> stop = gs.HuntCrossley(1.4e4, gs.Gap(0.4e-3, 0.4e-3), chi=2.0)
    >>> stop.force(0.5e-3, [0.01, 0.0, -0.1]).round(3).tolist()  # inwards, at rest, outwards
    [1.428, 1.4, 1.12]
    """

    family: ClassVar[str] = "huntcrossley"
    examples: ClassVar[tuple[str, ...]] = ("huntcrossley-0.3",)
    words: ClassVar[str] = (
        "K_c d (1 + χ u) with the depth d beyond a wall (r K_c d at the lower one) and its rate u, "
        "0 between; χ [s/m] in the label, or the parameter chi"
    )

    located: bool = field(default=True, init=False)
    damping: float = field(default=0.0, init=False)
    pulls: bool = field(default=False, init=False)
    preload: float = field(default=0.0, init=False)
    chi: float = field(kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "chi", checked("chi", self.chi, low=0.0))

    @property
    def losses(self) -> Losses:
        return Losses(chi=self.chi)

    @classmethod
    def canonical(cls, label: str, parameter: str) -> str:
        if label == cls.family:
            return parameter
        try:
            return f"{checked('chi', float(parameter), low=0.0):.12g}"
        except ValueError:
            raise ModelError(
                f"{label!r}: must be {cls.family} and its χ >= 0 in s/m, as {cls.examples[0]}"
            ) from None

    @classmethod
    def of_label(cls, parameter: str, fit_range: float) -> dict[str, Any]:
        return {"chi": float(parameter)} if parameter else {}

    def _pressure(self, depth: Array, speed: Array, ratio: float) -> Array:
        return super()._pressure(depth, speed, ratio) * (1.0 + self.chi * speed)

    def _slopes(self, depth: Array, speed: Array, ratio: float) -> tuple[Array, Array]:
        spring, stiffness = (
            super()._pressure(depth, speed, ratio),
            super()._slopes(depth, speed, ratio),
        )
        return stiffness[0] * (1.0 + self.chi * speed), self.chi * spring


@called_as("gs.Rigid(gs.Gap(4e-4, 4e-4), restitution=0.8), in m")
@dataclass(frozen=True)
class Rigid(Piecewise):
    """Rigid walls: a body that meets a wall at a speed leaves it at the restitution times this.

    Label: ``rigid-0.8`` for the coefficient of restitution e = 0.8, or ``rigid`` with e as a
    parameter of the study. A body that a load presses on the wall comes to rest there after ever
    shorter flights, and stays until the load lets go.

    Parameters
    ----------
    restitution : float
        Coefficient of restitution e [-], 0 to 1: 1 loses no energy, at 0 the body stays on the
        wall.
    K_ratio : float
        0: no lower wall; all other values, as 1 by default, make no difference.

    Examples
    --------
    >>> import gapsweep as gs
    >>> stop = gs.Rigid(gs.Gap(0.4e-3, 0.4e-3), restitution=0.8)
    >>> stop.force([0.0, 0.4e-3]).tolist()  # in the gap; an impact has no finite force
    [0.0, inf]
    """

    family: ClassVar[str] = "rigid"
    examples: ClassVar[tuple[str, ...]] = ("rigid-0.8",)
    words: ClassVar[str] = (
        "0 between the walls; at a wall the speed u of approach becomes −e u, with the "
        "coefficient of restitution e in the label, or the parameter restitution"
    )

    K_c: float = field(default=0.0, init=False)
    located: bool = field(default=True, init=False)
    damping: float = field(default=0.0, init=False)
    pulls: bool = field(default=False, init=False)
    preload: float = field(default=0.0, init=False)
    restitution: float = field(kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "restitution", share("restitution", self.restitution))
        if self.walls[0] >= self.walls[1]:
            raise ModelError(
                f"gap = {self.gap.j_1:g}/{self.gap.j_2:g}: no motion fits between rigid walls "
                "without a gap; write gs.Rigid(gs.Gap(4e-4, 4e-4), restitution=0.8)"
            )

    @property
    def exact(self) -> Piecewise:
        raise ModelError(
            f"{self.family}: an impact has no finite force to compare; "
            "compare responses instead, or take gs.Piecewise(1.4e4, gap)"
        )

    @classmethod
    def made(cls, K_c: float, gap: Gap, **numbers: Any) -> "Rigid":
        return cls(gap, **numbers)

    @property
    def losses(self) -> Losses:
        return Losses(is_rigid=True, restitution=self.restitution)

    @property
    def stiffnesses(self) -> tuple[float, float]:
        return (
            LARGEST * (self.K_ratio > 0.0 and self.gap.j_1 < math.inf),
            LARGEST * (self.gap.j_2 < math.inf),
        )

    @classmethod
    def canonical(cls, label: str, parameter: str) -> str:
        if label == cls.family:
            return parameter
        try:
            return f"{share('restitution', float(parameter)):.12g}"
        except ValueError:
            raise ModelError(
                f"{label!r}: must be {cls.family} and its restitution from 0 to 1, as "
                f"{cls.examples[0]}"
            ) from None

    @classmethod
    def of_label(cls, parameter: str, fit_range: float) -> dict[str, Any]:
        return {"restitution": float(parameter)} if parameter else {}

    def force(self, x: ArrayLike, v: ArrayLike = 0.0) -> Array:
        x, (low, high) = numbers("x", x), self.walls
        return np.where(x >= high, math.inf, np.where(x <= low, -math.inf, 0.0))

    def derivative(self, x: ArrayLike, v: ArrayLike = 0.0) -> Array:
        return np.abs(self.force(x))


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
            "gs.Gap(4e-4, 4e-4) or (4e-4, 4e-4); None: no wall on that side"
        )
    return Gap(*gap)


def checked_law(law: ContactLaw) -> ContactLaw:
    """Return `law`; raise a `ModelError` if it is no contact law."""
    if not isinstance(law, ContactLaw):
        label = law if isinstance(law, str) else "tanh-1e4"
        remedy = "law(function" if callable(law) else f"contact_law({label!r}"
        raise ModelError(f"law = {law!r}: must be a contact law, as gs.{remedy}, K_c, gap)")
    return law


def penetrations(x: ArrayLike, law: ContactLaw) -> tuple[Array, Array]:
    """Return the signed distances from the lower and the upper wall [m]."""
    x, (low, high) = numbers("x", x), law.walls
    return x - low, x - high
