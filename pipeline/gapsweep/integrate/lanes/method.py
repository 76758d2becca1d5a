"""Methods that advance lanes, as the stepping loop calls them."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.jit import chosen_by_type

from .row_layout import RowLayout

Array = NDArray[np.float64]


class Method(Protocol):
    """A method with its settings: a named tuple, the step of which `implement_step` names.

    Attributes
    ----------
    is_users : bool
        Whether the step calls a user's function: its code belongs to one process.
    n_stages : int
        Stages of a Runge-Kutta step; 0 for a Taylor series.
    """

    @property
    def is_users(self) -> bool: ...

    @property
    def n_stages(self) -> int: ...

    def with_work_space(
        self, at: RowLayout, lanes: Array, *, tangent: bool, dense: bool, contacts: bool
    ) -> "Method":
        """Return the method with work space and options for one run in these lanes."""
        ...


def method_step(layout, method, lanes, coefficients, limits):
    """Advance every lane by one step of a method; return its `StepOutcome`."""
    raise NotImplementedError("compiled code only")


def implement_step(of: type, step: Any) -> None:
    """Make `step`, a compiled function, the `method_step` of methods of the type `of`."""

    @chosen_by_type(method_step)
    def _step_of(layout, method, lanes, coefficients, limits):
        if method.instance_class is not of:
            return None
        return lambda layout, method, lanes, coefficients, limits: step(
            layout, method, lanes, coefficients, limits
        )
