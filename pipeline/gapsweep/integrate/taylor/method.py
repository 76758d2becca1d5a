"""The Taylor series method, as the stepping loop calls it."""

from typing import Any, NamedTuple

import numpy as np

from gapsweep.integrate.jit import inlined
from gapsweep.integrate.lanes.method import implement_step
from gapsweep.integrate.lanes.outcome import StepOutcome
from gapsweep.integrate.lanes.row_layout import RowLayout

from .tangent import tangent_step
from .taylor_step import taylor_step


class Taylor(NamedTuple):
    """The Taylor series method; its degree is the `order` of the `RowLayout`."""

    is_users: bool = False  # always False, see `Method`
    tangent: bool = False  # whether the variational equation is integrated too

    @property
    def n_stages(self) -> int:
        """Return 0: each step is one expansion."""
        return 0

    def with_work_space(
        self, at: RowLayout, lanes: np.ndarray, *, tangent: bool, **_options: bool
    ) -> "Taylor":
        """Return the method for a run; its only work space are the coefficients of the loop."""
        return self._replace(tangent=tangent)


@inlined
def _step(layout: Any, method: Any, lanes: Any, coefficients: Any, limits: Any) -> StepOutcome:
    rtol, x_bound, max_short = limits
    packed = taylor_step(layout, lanes, coefficients, rtol, x_bound, max_short)
    every, width = layout.all_lanes, layout.width
    first = packed & every
    unclear, miscounted = (first, 0) if layout.is_located else (0, first)
    if method.tangent:
        tangent_step(layout, lanes, coefficients, rtol, unclear)
    return StepOutcome(
        unclear,
        (packed >> width) & every,
        (packed >> 2 * width) & every,
        (packed >> 3 * width) & every,
        miscounted,
    )


implement_step(Taylor, _step)
