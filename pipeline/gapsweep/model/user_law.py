"""Contact law defined by a user's Python function of the displacement, and of the velocity."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from inspect import Parameter, signature
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError, described
from gapsweep.model.arrays import numbers
from gapsweep.model.contact import ContactLaw
from gapsweep.model.contact_modes import NO_LOSSES, Losses
from gapsweep.model.oscillator import called_as, checked
from gapsweep.quantities import without_units
from gapsweep.user_code.load import blame, plain

Array = NDArray[np.float64]

# Slopes are central differences: over the part of x that balances truncation
# and rounding, and of SLOPE_LENGTH [m] for smaller x, as motions are larger than that.
SLOPE_STEP, SLOPE_LENGTH = 6e-6, 1e-9
MOST_PARAMETERS = 4  # the compiled laws have that many free rows
# Displacements between which jumps are searched for, the share of the gap beyond its walls, and the
# smallest jump over the largest force there: neighbouring floats of tanh(1e12 x) differ by less.
_PROBES, _BEYOND, _JUMP = 65, 0.01, 1e-3
SPEED = "v"  # name of a second argument that is the velocity
# A force at a wall is that of this share of the wall's displacement inside the mode's interval.
_INSIDE = 1e-10


class Continued(NamedTuple):
    """A function's force [N], and its derivatives by displacement [N/m] and velocity [N s/m].

    Each is a function of ``x, v, low, high`` and named numbers: in the interval [low, high] of
    displacements, between walls or beyond one. A step that ends at a wall has stages beyond it,
    where the force continues by point reflection: exactly if it is linear in the depth.
    """

    force: Callable[..., Any]
    slope: Callable[..., Any]
    damping: Callable[..., Any]


def continued(function: Callable[..., Any]) -> Continued:
    """Return the `Continued` forms of a function of displacement and velocity.

    Both engines use them: the compiled one compiles them.
    """

    def force(x: float, v: float, low: float, high: float, *named: float) -> Any:
        low, high = low + _INSIDE * abs(low), high - _INSIDE * abs(high)
        at = min(max(x, low), high)
        if at == x:
            return function(x, v, *named)
        inside = min(max(2.0 * at - x, low), high)
        return 2.0 * function(at, v, *named) - function(inside, v, *named)

    def slope(x: float, v: float, low: float, high: float, *named: float) -> Any:
        h = SLOPE_STEP * max(abs(x), SLOPE_LENGTH)
        after, before = force(x + h, v, low, high, *named), force(x - h, v, low, high, *named)
        return (after - before) / (2.0 * h)

    def damping(x: float, v: float, low: float, high: float, *named: float) -> Any:
        h = SLOPE_STEP * max(abs(v), abs(x), SLOPE_LENGTH)  # x: to exceed a rounding at rest
        after, before = force(x, v + h, low, high, *named), force(x, v - h, low, high, *named)
        return (after - before) / (2.0 * h)

    return Continued(force, slope, damping)


@called_as("gs.UserLaw(1.4e4, gs.Gap(4e-4, 4e-4), function), in N/m and m")
@dataclass(frozen=True)
class UserLaw(ContactLaw):
    """A user law: a function of the displacement, or of displacement and velocity.

    Parameters
    ----------
    function : callable
        Restoring force [N] as a function of the displacement [m], both scalars, and of the named
        numbers. A second argument with the name ``v`` is the velocity [m/s]. `K_c`, `K_ratio` and
        `gap` do not enter the force; they define the walls at which contacts are counted, and
        located if the force depends on the velocity. A wall of zero stiffness counts no contacts.
    parameters : mapping of str to float
        Values of the function's other arguments, 4 at most.

    Raises
    ------
    ModelError
        If the function raises at 0, needs other arguments, or jumps at or between the walls.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.UserLaw(1.0, gs.Gap(0.0, 0.0), lambda x: 2e4 * x)
    >>> law.force(1e-3).item()
    20.0
    >>> drag = gs.UserLaw(0.0, gs.Gap(0.0, 0.0), lambda x, v: 3.0 * v * abs(v))
    >>> drag.force(1e-3, 2.0).item()
    12.0
    """

    adds_walls: ClassVar[bool] = False

    function: Callable[..., float]
    parameters: Mapping[str, float] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not callable(self.function):
            raise ModelError(
                f"function = {self.function!r}: must be a function of x; "
                "a gapsweep.ForceTable is a law already; "
                "for the law of a label use gapsweep.contact_law(label, K_c, gap)"
            )
        object.__setattr__(self, "parameters", self._named())
        try:
            value = self._at(0.0)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # the user's code may raise anything, SystemExit too
            message = f"{self.name}(0.0) raised {described(error)}"
            raise ModelError(blame(None, error, message)) from error
        if not math.isfinite(value):
            raise ModelError(f"{self.name}(0.0) = {value}: must be finite")
        self._refuse_jumps()

    def _named(self) -> dict[str, float]:
        """Return the parameters in the order of the function's arguments; refuse other names."""
        names = parameters_of(self.function)
        if {*names} != {*self.parameters} or len(names) > MOST_PARAMETERS:
            first = ["x", SPEED] if self.is_of_speed else ["x"]
            raise ModelError(
                f"{self.name}({', '.join([*first, *names])}) with {dict(self.parameters)}: must "
                f"be a function of x, or of x and the velocity {SPEED}, and of up to "
                f"{MOST_PARAMETERS} numbers with values, as gs.law(function, K_c, gap, n=1.5) or "
                "n = 1.5 in [parameters]"
            )
        numbers = {name: without_units(name, self.parameters[name], "") for name in names}
        return {name: checked(name, number) for name, number in numbers.items()}

    def _refuse_jumps(self) -> None:
        """Raise a `ModelError` if the force jumps; bisection locates jumps."""
        low, high = (min(j, self.gap.size) for j in (self.gap.j_1, self.gap.j_2))
        low = -low  # without a wall as far as the other one
        beyond, tiny = _BEYOND * (high - low), math.ulp(0.0)
        grid = np.linspace(low - beyond, high + beyond, _PROBES).tolist()
        x = sorted({*grid, low, high, -tiny, 0.0, tiny})
        forces = [*map(self._known, x)]
        ends = map(self._known, (x[0] - SLOPE_LENGTH, x[-1] + SLOPE_LENGTH))
        scale = max(abs(force) for force in (0.0, *forces, *ends) if force == force)
        for a, b, before, after in zip(x[:-1], x[1:], forces[:-1], forces[1:], strict=True):
            while abs(after - before) > _JUMP * scale and (middle := 0.5 * (a + b)) not in (a, b):
                force = self._known(middle)
                if abs(force - before) >= abs(after - force):
                    b, after = middle, force
                else:
                    a, before = middle, force
            # Next to a pole the force grows without bounds: that is no jump.
            if _JUMP * scale < abs(after - before) <= 3.0 * scale:
                raise ModelError(
                    f"{self.name}: the force jumps by {abs(after - before):.3g} N at x = {b:.6g} "
                    "m, which is not covered: use Siconos, or join both sides by a steep line, as "
                    "5.0 * min(max(x / 1e-6, -1.0), 1.0)"
                )

    @cached_property
    def is_of_speed(self) -> bool:
        """Whether the function has the velocity as its second argument."""
        return SPEED in _arguments(self.function)[1:2]

    @property
    def has_modes(self) -> bool:
        return self.is_of_speed

    @property
    def is_located(self) -> bool:
        return self.is_of_speed

    @property
    def losses(self) -> Losses:
        return Losses(by_function=True) if self.is_of_speed else NO_LOSSES

    def _at(self, x: float, v: float = 0.0) -> float:
        state = (x, v) if self.is_of_speed else (x,)
        return _number(self.function(*state, **self.parameters))

    def _as_compiled(self, x: float, v: float) -> float:
        """Return the force [N] at `x` [m] and `v` [m/s].

        NaN where arithmetic has no result, as compiled code.
        """
        try:
            return self._at(x, v)
        except (ValueError, OverflowError, ZeroDivisionError):  # as sqrt(-1.0)
            return math.nan

    @property
    def continued(self) -> Continued:
        """The force and its derivatives in an interval of displacements."""
        return continued(self._as_compiled)

    def _known(self, x: float) -> float:
        """Return the force [N] at `x` [m]; NaN if the function raises."""
        try:
            return self._at(x)
        except KeyboardInterrupt:
            raise
        except BaseException:  # the user's code may raise anything, SystemExit too
            return math.nan

    @property
    def name(self) -> str:
        """Module and name of the function, as ``"module:function"``."""
        module = plain(str(self.function.__module__))
        return f"{module}:{getattr(self.function, '__qualname__', '?')}"

    def __str__(self) -> str:
        return self.name

    def force(self, x: ArrayLike, v: ArrayLike = 0.0) -> Array:
        return _each(self._as_compiled, x, v)

    def derivative(self, x: ArrayLike, v: ArrayLike = 0.0) -> Array:
        return _each(partial(self.continued.slope, low=-math.inf, high=math.inf), x, v)

    def derivative_by_speed(self, x: ArrayLike, v: ArrayLike = 0.0) -> Array:
        return _each(partial(self.continued.damping, low=-math.inf, high=math.inf), x, v)


def _each(function: Callable[[float, float], float], x: ArrayLike, v: ArrayLike) -> Array:
    """Return the values of a function of displacement and velocity, one after the other."""
    states = np.broadcast_arrays(numbers("x", x), numbers("v", v))
    pairs = zip(*(each.ravel().tolist() for each in states), strict=True)
    return np.reshape([function(*pair) for pair in pairs], states[0].shape)


def parameters_of(function: Callable[..., Any]) -> list[str]:
    """Names of a law's arguments after the displacement and, if it has one, the velocity."""
    names = _arguments(function)[1:]
    return names[1:] if names[:1] == [SPEED] else names


def _arguments(function: Callable[..., Any]) -> list[str]:
    """Names of a function's arguments; none if they cannot be known."""
    try:
        arguments = (
            [] if isinstance(function, np.ufunc) else signature(function).parameters.values()
        )
    except (TypeError, ValueError):  # of functions written in C
        return []
    several = Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD
    return [each.name for each in arguments if each.kind not in several]


def _number(force: Any) -> float:
    """Return the result of a user's function as a float; refuse text and booleans."""
    if np.asarray(force).dtype.kind in "bSU":
        raise TypeError(f"must return a number, not {force!r:.40}")
    return math.nan if isinstance(force, complex) else float(force)  # as (-1.0) ** 0.5
