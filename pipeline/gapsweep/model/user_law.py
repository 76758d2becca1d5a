"""A user's own contact law: a Python function of the displacement."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError, described
from gapsweep.model.contact import ContactLaw
from gapsweep.user_code.load import blame, plain

Array = NDArray[np.float64]

# Slopes are central differences: over the part of x that balances truncation
# and rounding, and of SLOPE_LENGTH [m] where x is smaller, as nothing moves by less.
SLOPE_STEP, SLOPE_LENGTH = 6e-6, 1e-9


@dataclass(frozen=True)
class UserLaw(ContactLaw):
    """A user law: a function of the displacement.

    Parameters
    ----------
    function : callable
        Restoring force [N] as a function of the displacement [m], both scalars. `K_c`, `K_ratio`
        and `gap` do not enter the force; they define the walls at which contacts are counted. A
        wall of zero stiffness counts no contacts.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.UserLaw(1.0, gs.Gap(0.0, 0.0), lambda x: 2e4 * x)
    >>> law.force(1e-3).item()
    20.0
    """

    function: Callable[[float], float]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not callable(self.function):
            raise ModelError(
                f"function = {self.function!r}: must be a function of x; "
                "a gapsweep.ForceTable is a law already; "
                "for the law of a label use gapsweep.contact_law(label, K_c, gap)"
            )
        try:
            value = _number(self.function(0.0))
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # the user's code may raise anything, SystemExit too
            message = f"{self.name}(0.0) raised {described(error)}"
            raise ModelError(blame(None, error, message)) from error
        if not math.isfinite(value):
            raise ModelError(f"{self.name}(0.0) = {value}: must be finite")

    @property
    def name(self) -> str:
        """Module and name of the function, as ``"module:function"``."""
        module = plain(str(self.function.__module__))
        return f"{module}:{getattr(self.function, '__qualname__', '?')}"

    def __str__(self) -> str:
        return self.name

    def force(self, x: ArrayLike) -> Array:
        x = np.asarray(x, dtype=float)
        return np.reshape([_number(self.function(float(v))) for v in x.ravel()], x.shape)

    def derivative(self, x: ArrayLike) -> Array:
        x = np.asarray(x, dtype=float)
        h = SLOPE_STEP * np.maximum(np.abs(x), SLOPE_LENGTH)
        return np.asarray((self.force(x + h) - self.force(x - h)) / (2.0 * h))


def _number(force: Any) -> float:
    """What a function returned, if it is a number: `float` would read text and truth as one."""
    if np.asarray(force).dtype.kind in "bSU":
        raise TypeError(f"must return a number, not {force!r:.40}")
    return float(force)
