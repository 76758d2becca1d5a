"""Tables of systems whose laws a Runge-Kutta method integrates, for the stepping loop."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.lanes import parameters
from gapsweep.integrate.lanes.law_rows import with_law_rows
from gapsweep.integrate.lanes.outcome import AT_START
from gapsweep.integrate.lanes.scene_table import SceneTable
from gapsweep.integrate.problem import Solver
from gapsweep.model.laws.tanh import SATURATION

from . import laws, tableaux
from .laws import Formula, Law
from .method import RungeKutta

Array = NDArray[np.float64]

# At this tolerance and tighter the order-8 method is the cheaper one in the benchmark.
_HIGH_ORDER_FROM = 1e-2
_MIN_STEP = 1e-17  # of a period: stiff laws need far shorter steps than a Taylor series


def runge_kutta_scenes(
    exact: SceneTable, kernel_laws: Sequence[Law], mass: Array, solver: Solver
) -> tuple[SceneTable, RungeKutta]:
    """Return the table of the same systems with other laws, and their Runge-Kutta method.

    Parameters
    ----------
    exact : SceneTable
        n systems for the Taylor method: the equation of motion is the same.
    kernel_laws : sequence of Law
        Law of every contact; its parameters may be arrays, shape (n,).
    mass : ndarray, shape (n,)
        Mass by which contact forces are divided [kg]; 1 if `exact` contains the division.
    solver : Solver
        Settings of the method; the tolerances are those of `exact`.
    """
    is_ode45 = solver.controller == "ode45"
    kinds = tuple(law.kind for law in kernel_laws)
    located = any(
        isinstance(kind, laws.UserOfSpeed) or getattr(kind, "number", None) == laws.LOCATED
        for kind in kinds
    )
    if located and solver.contact_force == "as_written":
        kinds = (Formula(laws.PIECEWISE),) * len(kinds)  # the loop still ends steps at walls
    at = replace(exact.at, is_located=located, is_taylor=False, order=tableaux.DEGREE, tangent=0)
    rows = [law.rows(mass, len(exact.table) - 1) for law in kernel_laws]
    for each in rows:
        # Where the tail of tanh, exp(-2 |z|), is far below the tolerance, its layer has no edge.
        reach = (3.0 - 0.5 * np.log(exact.rtol)) / SATURATION
        each[each[:, parameters.SATURATION] > 0.0, parameters.LAYER] *= min(1.0, max(0.1, reach))
    scenes = with_law_rows(exact, at, rows)
    at, points = scenes.at, scenes.table[:-1]
    has_layer, has_range = (
        any((each[:, row] > 0.0).any() for each in rows)
        for row in (parameters.LAYER, parameters.RANGE)
    )
    highest = np.ones(len(points))
    for name in ("multiple", "depth_multiple"):
        block = slice(at.first[name], at.first[name] + at.blocks[name])
        highest = np.maximum(highest, points[:, block].max(axis=1, initial=1.0))
    # A tenth of the time span for ode45, as is known initially.
    points[:, at.h_max] = np.inf if is_ode45 else points[:, at.period] / highest
    fastest = points[:, at.stiffness] if at.is_plain else points[:, at.fastest]
    points[:, at.min_step] = _MIN_STEP / np.maximum(points[:, at.omega], np.sqrt(fastest))
    points[:, at.is_fresh] = AT_START
    method = RungeKutta(
        kinds=kinds,
        tableau=tableaux.DP5 if is_ode45 or exact.rtol > _HIGH_ORDER_FROM else tableaux.DOP853,
        q=np.empty((0, 0, 0)),
        k=np.empty((0, 0)),
        k_tangent=np.empty((0, 0)),
        is_ode45=is_ode45,
        restarts=solver.restart,
        cuts_at_layers=has_layer and not is_ode45,
        has_range=has_range,
        tangent=False,
        dense=False,
        contacts=False,
        is_users=any(isinstance(law.kind, laws.USERS) for law in kernel_laws),
    )
    return scenes, method
