"""A Runge-Kutta method with its settings and work space."""

from typing import Any, NamedTuple

import numpy as np

from gapsweep.integrate.lanes.method import implement_step
from gapsweep.integrate.lanes.parameters import N_PARAMETERS
from gapsweep.integrate.lanes.row_layout import RowLayout, aligned

from .runge_kutta_step import runge_kutta_step
from .stage_values import LOSS_ROWS
from .tableaux import Tableau


class RungeKutta(NamedTuple):
    """A method with its work space."""

    kinds: Any  # the law of every contact, a named tuple of `laws`
    # Shape (n_contacts, N_PARAMETERS, WIDTH); parameters of the laws, a view of the rows of the
    # lanes.
    q: np.ndarray
    tableau: Tableau
    # `k`, `k_tangent`: shapes (n_all * n_rates, WIDTH) and (n_states times that, WIDTH);
    # derivatives of all stages, and those of the tangent columns. For contacts that lose energy `k`
    # has the rates of `contact_loss` too, in `LOSS_ROWS` more rows.
    k: np.ndarray
    k_tangent: np.ndarray
    is_ode45: bool  # whether error norm and step-size control are those of MATLAB's ode45
    # Whether the step size is chosen at a located contact as at the beginning of a motion.
    restarts: bool
    cuts_at_layers: bool  # whether steps are cut at the edges of smoothing layers
    has_range: bool  # whether a law is valid only within a range (fits, tables)
    tangent: bool  # whether the variational equation is integrated too
    # `dense`, `contacts`: whether every step is recorded; whether wall crossings are.
    dense: bool
    contacts: bool
    is_users: bool  # whether a law is a user's function

    @property
    def n_stages(self) -> int:
        """Stages of a step."""
        return self.tableau.n_stages

    def with_work_space(
        self, at: RowLayout, lanes: np.ndarray, *, tangent: bool, dense: bool, contacts: bool
    ) -> "RungeKutta":
        """Return the method with work space and options for one run in these lanes."""
        law = lanes[at.law : at.law + at.blocks["law"]]
        n_rows = self.tableau.c.size * (at.n + at.m) + LOSS_ROWS * at.is_damped
        return self._replace(
            q=law.reshape(at.contacts, N_PARAMETERS, at.width),
            k=aligned(n_rows, at.width),
            k_tangent=aligned(self.tableau.c.size * at.n_rates * at.n_states, at.width),
            tangent=tangent,
            dense=dense,
            contacts=contacts,
        )


implement_step(RungeKutta, runge_kutta_step)
