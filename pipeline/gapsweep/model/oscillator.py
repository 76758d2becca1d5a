"""The forced Duffing oscillator and its freeplay gap: frozen, checked parameters.

The equation of motion, with `F_c` the contact force of `gapsweep.model.contact`::

    x'' + (2 ζ ω_n + c/m) x' + ω_n² x + (α/m) x³ + F_c(x)/m
        = p_0/m + (p/m + (u/m + a) ω²) cos(ω t) + (1 - s) (2 ζ ω_n + c/m) a ω sin(ω t)

with an unbalance u, and a base that moves by a cos(ω t). The displacement x is relative to the
base, to which the spring, the walls and a share s of the damping are connected. A forcing by pieces
has a wave in place of the cosine of p.
"""

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import wraps
from inspect import signature
from operator import index
from typing import Any, ClassVar, TypeVar, cast

from gapsweep.errors import ModelError, shown
from gapsweep.quantities import allowed_of, without_units
from gapsweep.variables import METRES, Units

# Within these bounds no product or quotient of model parameters overflows, not even squared
# frequencies times ratios; they are far beyond any machine.
SMALLEST, LARGEST = 1e-50, 1e50

# The numbers of an oscillator in the order of every table: first those of a classic oscillator.
CLASSIC = ("zeta", "omega_n", "mass", "alpha", "forcing")
OSCILLATOR = (*CLASSIC, "mean_load", "c", "unbalance", "base_amplitude", "base_damping")


C = TypeVar("C", bound=Callable[..., Any])


_LOSSES = frozenset(("damping", "restitution", "friction"))
NO_LOSS = (
    "a contact that loses energy is gs.Piecewise or gs.Tanh with damping=60.0, gs.HuntCrossley, "
    "gs.Rigid(gap, restitution=0.8) or an own function f(x, v); friction is not covered"
)


def called_as(example: str) -> Callable[[C], C]:
    """Decorator: a call with wrong arguments raises a `ModelError` that shows this example."""

    def decorated(kind: C) -> C:
        is_class = isinstance(kind, type)
        function: Any = kind.__init__ if is_class else kind

        @wraps(function)
        def called(*values: Any, **named: Any) -> Any:
            try:
                return function(*values, **named)
            except TypeError:
                try:  # a wrong name first, then one left out
                    signature(function).bind_partial(*values, **named)
                    signature(function).bind(*values, **named)
                except TypeError as error:
                    arguments = list(signature(function).parameters.values())[is_class:]
                    # The text of an argument has the stars of `**parameters`; its type goes.
                    known = [str(each).partition(":")[0] for each in arguments] or ["none"]
                    why = f": {NO_LOSS}" if _LOSSES.intersection(named).difference(known) else ""
                    raise ModelError(
                        f"{kind.__name__}: {error}{why}; its parameters are {', '.join(known)}: "
                        f"write {example}"
                    ) from None
                raise

        if is_class:
            cast(Any, kind).__init__ = called
        return kind if is_class else cast(C, called)

    return decorated


def is_number(value: Any) -> bool:
    """Whether a value is a number; text, booleans and None are none."""
    kind: str = getattr(getattr(value, "dtype", None), "kind", "O")
    return kind in "iufO" and not isinstance(value, str | bytes | bool | None)


def checked(name: str, value: float, *, low: float = -math.inf, strict: bool = False) -> float:
    """Return `value` as a finite float above `low`; raise a `ModelError` that names it otherwise.

    A quantity of pint becomes a number in the unit of the parameter.
    A strictly positive number (``low=0.0, strict=True``) must be at least `SMALLEST`, and no number
    may be larger than `LARGEST`.
    """
    number = value if type(value) is float else _number(name, value)
    if not math.isfinite(number):
        raise ModelError(f"{name} = {number}: must be finite")
    if number < low or (strict and number == low):
        raise ModelError(f"{name} = {number:g}: must be {'>' if strict else '>='} {low:g}")
    if strict and number - low < SMALLEST:
        raise ModelError(f"{name} = {number:g}: must be >= {low + SMALLEST:g}")
    if abs(number) > LARGEST:
        raise ModelError(f"{name} = {number:g}: must be within -{LARGEST:g}..{LARGEST:g}")
    return number


def checked_distance(name: str, value: float | None) -> float:
    """Return the distance of a wall [m] as a float; infinity for None, no wall."""
    value = without_units(name, value)
    is_none = value is None or (is_number(value) and value == math.inf)
    return math.inf if is_none else checked(name, value)


def _number(name: str, value: Any) -> float:
    """Return a value or a quantity as a float; raise a `ModelError` that names it otherwise."""
    value = without_units(name, value)
    with suppress(TypeError, ValueError, OverflowError):
        if is_number(value):
            return float(value)
    is_load = name == "forcing" and value is not None
    remedy = ", or a force as gs.PeriodicForce.from_csv('force.csv', period=0.02)"
    said = allowed_of(name) + remedy * is_load
    raise ModelError(f"{name} = {shown(value)}: must be {said}")


def share(name: str, value: float) -> float:
    """Return `value` as a float in 0..1; raise a `ModelError` that names it otherwise."""
    number = checked(name, value)
    if not 0.0 <= number <= 1.0:
        raise ModelError(f"{name} = {number:g}: must be in 0..1")
    return number


def whole(name: str, value: int, low: int, high: int) -> int:
    """Return `value` as an int in ``low..high``; raise a `ModelError` that names it otherwise."""
    try:
        number = index(value) if is_number(value) else low - 1
    except TypeError:
        number = low - 1
    if not low <= number <= high:
        raise ModelError(f"{name} = {value!r}: must be a whole number in {low}..{high}")
    return number


@called_as(
    "gs.Oscillator(mass=3.0, omega_n=5.0, zeta=0.03, forcing=4.0), with omega_n = sqrt(k/m)/(2 pi) "
    "in Hz"
)
@dataclass(frozen=True, slots=True, kw_only=True)
class Oscillator:
    """Mass on a linear and a cubic spring, with damping and harmonic forcing.

    Parameters
    ----------
    zeta : float
        Damping ratio [-], ``>= 0``.
    omega_n : float
        Natural frequency without contact and cubic spring [Hz], ``>= 0``; 0 for a mass without a
        spring, such as a gear.
    mass : float
        Mass m [kg], ``> 0``.
    forcing : float, PeriodicForce, Switched or Record
        Forcing amplitude p [N] of a cosine; or a force by pieces, kept as its `wave` and, as
        `forcing`, its largest modulus.
    alpha : float
        Cubic stiffness α [N/m³], 0 by default; negative values soften.
    mean_load : float
        Constant load p_0 [N], such as a weight; 0 by default.
    c : float
        Viscous damping c [N s/m] in addition to `zeta`, ``>= 0``; 0 by default. `zeta` needs a
        spring.
    unbalance : float
        Rotating unbalance u, mass times eccentricity [kg m]: a force u ω² cos(ω t); 0 by default.
    base_amplitude : float
        Amplitude a of a base that moves by a cos(ω t) [m]; 0 by default. Displacements are those
        from the base; `base` returns its displacement.
    base_damping : float
        Share s of the damping that is connected to the base [-], 0 to 1; 1 by default. The rest is
        connected to the ground.
    wave : Wave, optional
        Values of the forcing over its amplitude during a period; None, the default: those of a
        cosine. A force by pieces sets it, and ``dataclasses.replace(oscillator, forcing=2.0)``
        keeps it.

    Examples
    --------
    >>> import gapsweep as gs
    >>> gs.Oscillator(mass=12.0, omega_n=18.0, zeta=0.02, forcing=50.0).alpha
    0.0
    >>> gear = gs.Oscillator(mass=3.0, omega_n=0.0, zeta=0.0, forcing=4.0, c=20.0, mean_load=2.0)
    >>> gs.respond(gear, gs.Piecewise(1e5, gs.Gap(1e-4, 1e-4)), omega=20.0).status.label
    'ok'
    """

    # Properties of a `System` of one coordinate; without numpy, which takes time to import.
    n: ClassVar[int] = 1
    n_lags: ClassVar[int] = 0
    n_states: ClassVar[int] = 2
    coordinates: ClassVar[tuple[str, ...]] = ("x",)
    contacts: ClassVar[tuple[str, ...]] = ("x",)
    parts: ClassVar[dict[str, tuple[str, ...]]] = {}
    part_units: ClassVar[Units] = METRES
    sizes: ClassVar[tuple[int, ...]] = ()
    directions: ClassVar[tuple[tuple[float, ...], ...]] = ((1.0,),)
    is_modulated: ClassVar[tuple[bool, ...]] = (False,)

    zeta: float
    omega_n: float
    mass: float
    alpha: float = 0.0
    forcing: float
    mean_load: float = 0.0
    c: float = 0.0
    unbalance: float = 0.0
    base_amplitude: float = 0.0
    base_damping: float = 1.0
    wave: Any = None

    def __post_init__(self) -> None:
        if (wave := getattr(self.forcing, "wave", None)) is not None:
            force = cast(Any, self.forcing)
            if force.along is not None:
                raise ModelError(f"forcing = {force!r}: along is for systems; leave it out")
            object.__setattr__(self, "wave", wave)
            object.__setattr__(self, "forcing", force.peak)
        positive = ("zeta", "omega_n", "mass", "c", "base_damping")
        for name in OSCILLATOR:
            low = 0.0 if name in positive else -math.inf
            value = checked(name, getattr(self, name), low=low, strict=name == "mass")
            object.__setattr__(self, name, value)
        if 0.0 < self.omega_n < SMALLEST:
            raise ModelError(f"omega_n = {self.omega_n:g}: must be 0 or >= {SMALLEST:g}")
        share("base_damping", self.base_damping)

    @property
    def is_classic(self) -> bool:
        """Whether there is a spring, and all loads are cosines in phase, as in classic kernels."""
        is_cosine = self.wave is None and not self.damper_load
        return self.omega_n > 0.0 and self.mean_load == 0.0 and is_cosine

    @property
    def is_forced(self) -> bool:
        """Whether there is a forcing frequency, which a record lacks."""
        moves = self.unbalance or self.base_amplitude
        return bool(moves) or self.wave is None or not self.wave.in_seconds

    @property
    def inertial_load(self) -> float:
        """Amplitude of the loads that grow with the square of the angular frequency [kg m]."""
        return self.unbalance + self.mass * self.base_amplitude

    @property
    def damper_load(self) -> float:
        """Amplitude of the load that grows with the angular frequency [N s], a quarter period late.

        The damping between the mass and the ground causes it, as x is measured from the base.
        """
        return 2.0 * self.mass * self.decay_rate * (1.0 - self.base_damping) * self.base_amplitude

    @property
    def is_loaded(self) -> bool:
        """Whether a load varies with time."""
        return bool(self.forcing or self.inertial_load or self.damper_load)

    def at(self, omega: float) -> "Oscillator":
        """Return the oscillator with the loads of one frequency [Hz] as its `forcing`.

        Its steady motions have the same amplitudes, and the same phase if it `is_classic`. Waves
        become cosines of the same largest force.
        """
        if not (self.unbalance or self.base_amplitude or self.wave):
            return self
        rate = 2.0 * math.pi * checked("omega", omega)
        load, late = self.forcing + self.inertial_load * rate**2, self.damper_load * rate
        amplitude = math.hypot(load, late) if late else load
        none: dict[str, Any] = {"unbalance": 0.0, "base_amplitude": 0.0, "wave": None}
        return replace(self, forcing=amplitude, base_damping=1.0, **none)

    def base(self, omega: float, t: Any) -> Any:
        """Return the displacement of the base [m] at a frequency [Hz] and times [s]."""
        import numpy as np  # not needed to describe a model

        rate = 2.0 * math.pi * checked("omega", omega)
        return self.base_amplitude * np.cos(rate * np.asarray(without_units("t", t), float))

    @property
    def damping_ratio(self) -> float:
        """Damping ratio due to `zeta` and `c` together [-]."""
        return self.zeta + (0.5 * self.c / (self.mass * self.omega_n_rad) if self.omega_n else 0.0)

    @property
    def is_held(self) -> bool:
        """Whether the mass has a linear spring."""
        return self.omega_n > 0.0

    @property
    def slowest(self) -> float:
        """Smallest natural frequency [Hz]."""
        return self.omega_n

    @property
    def fastest(self) -> float:
        """Largest natural frequency [Hz]."""
        return self.omega_n

    def unit(self, omega_rad: Any) -> tuple[Any, Any]:
        """Return the scales of displacement [m] and velocity [m/s] of a motion of one metre.

        Parameters
        ----------
        omega_rad : float or ndarray
            Angular frequency of the motion [rad/s].
        """
        return 0.0 * omega_rad + 1.0, omega_rad

    @property
    def deflection(self) -> float:
        """Estimate of the static displacement under the loads [m], with the cubic stiffness.

        Loads that grow with the frequency move the mass as without a spring.
        """
        spring, free = self.mass * self.omega_n_rad**2, abs(self.inertial_load) / self.mass
        free += abs(self.damper_load) / (2.0 * self.mass * self.decay_rate or 1.0)
        load = abs(self.forcing) + spring * free
        stiffness = spring + math.cbrt(abs(self.alpha) * load**2)
        return load / stiffness if stiffness else free

    @property
    def omega_n_rad(self) -> float:
        """Natural angular frequency [rad/s]."""
        return 2.0 * math.pi * self.omega_n

    @property
    def decay_rate(self) -> float:
        """Rate ζω_n + c/(2m) at which free oscillations of the linear system decay [1/s]."""
        return self.zeta * self.omega_n_rad + 0.5 * self.c / self.mass

    @property
    def settling_rate(self) -> float:
        """Smallest decay rate of a free motion of the linear system [1/s].

        It equals `decay_rate` up to critical damping and is smaller beyond.
        """
        if not self.omega_n:
            return self.decay_rate
        zeta = self.damping_ratio
        if zeta <= 1.0:
            return self.decay_rate
        return self.omega_n_rad / (zeta + math.sqrt(zeta - 1.0) * math.sqrt(zeta + 1.0))


@called_as("gs.Gap(1e-4, 1e-4), the distances of the lower and the upper wall in metres")
@dataclass(frozen=True, slots=True)
class Gap:
    """Distances of the walls: there is no contact while ``-j_1 <= x <= j_2``.

    A negative distance is prestress: that wall presses on the mass at the origin. If the walls
    overlap, ``j_1 + j_2 < 0``, both act between ``j_2`` and ``-j_1``, and one of them beyond.

    Parameters
    ----------
    j_1, j_2 : float or None
        Distances of the lower and the upper wall from the origin [m]. None, kept as ``inf``: no
        wall on that side.

    Raises
    ------
    ModelError
        If a distance is out of range, or there is no wall on either side.

    Examples
    --------
    >>> import gapsweep as gs
    >>> gap = gs.Gap(0.0, 0.8e-3)
    >>> gap.label, gap.is_symmetric
    ('0/0.8', False)
    >>> gs.Gap(None, 0.4e-3)  # a stop on the upper side only
    Gap(j_1=inf, j_2=0.0004)
    """

    j_1: float
    j_2: float

    def __post_init__(self) -> None:
        for name in ("j_1", "j_2"):
            object.__setattr__(self, name, checked_distance(name, getattr(self, name)))
        if not self.distances:
            raise ModelError(
                "gap: no wall on either side; give one distance, as gs.Gap(None, 4e-4)"
            )

    @property
    def distances(self) -> tuple[float, ...]:
        """Distances of the walls that exist [m], of the lower one first."""
        return tuple(j for j in (self.j_1, self.j_2) if j < math.inf)

    def at(self, distance: float) -> "Gap":
        """Return the gap with every wall that exists at this distance from the origin [m]."""
        return Gap(*(distance if j < math.inf else j for j in (self.j_1, self.j_2)))

    @property
    def width(self) -> float:
        """Distance between the walls [m]; infinite for one wall, negative if they overlap."""
        return self.j_1 + self.j_2

    @property
    def size(self) -> float:
        """Sum of the walls' distances without sign [m], to which rounding errors relate."""
        return sum(map(abs, self.distances))

    @property
    def is_symmetric(self) -> bool:
        """Whether both walls are equally far from the origin."""
        return self.j_1 == self.j_2

    @property
    def label(self) -> str:
        """Wall distances in millimetres, as ``"0.4/0.4"``."""
        return f"{self.j_1 * 1e3:.12g}/{self.j_2 * 1e3:.12g}"
