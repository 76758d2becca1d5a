"""The function `respond`: steady responses of one or many points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError
from gapsweep.integrate.problem import DEFAULT_ENGINE, TIME_LIMIT, Models, Numbers, Solver, within
from gapsweep.integrate.simulate import AnyLaw, AnyModel, Several, cases, inputs_of
from gapsweep.model.doubts import doubts, warn_of
from gapsweep.model.oscillator import called_as
from gapsweep.response.autonomous import PoincareMap
from gapsweep.response.ensemble import Ensemble
from gapsweep.response.result import Response, Responses, Steady
from gapsweep.response.scene import Scene
from gapsweep.response.search import Search
from gapsweep.variables import objects

Array = NDArray[np.float64]

_STEADY = Steady()  # checked once


@called_as("gs.respond(oscillator, law, omega=9.0), in Hz")
def respond(
    oscillator: Several[AnyModel],
    law: Several[AnyLaw],
    omega: ArrayLike | None = None,
    x_0: ArrayLike = 0.0,
    v_0: ArrayLike = 0.0,
    *,
    q_0: ArrayLike = 0.0,
    z_0: ArrayLike = 0.0,
    engine: str = DEFAULT_ENGINE,
    rtol: float | None = None,
    atol: float | None = None,
    steady: Steady | None = None,
    time_limit: float = TIME_LIMIT,
) -> Response:
    """Return the steady response from an initial state, or an array of responses.

    Parameters
    ----------
    oscillator, law
        As in `gapsweep.simulate`.
    omega : float or array_like
        Forcing frequency [Hz], ``> 0``; None for an unforced system.
    x_0, v_0 : float or array_like
        Initial displacement [m] and velocity [m/s] at forcing phase zero; broadcast together with
        `omega` and sequences of models or laws. One call for 60 points takes a quarter of the CPU
        time of 60 calls.
    q_0, z_0 : float or array_like
        Initial coordinates [m] and first-order states of a system, along the last axis, as `v_0`.
    engine, rtol, atol
        As in `gapsweep.simulate`.
    steady : Steady, optional
        Convergence criteria.
    time_limit : float
        As in `gapsweep.simulate`.

    Returns
    -------
    Response
        Attributes are arrays of the common shape if an argument is an array or a sequence;
        `extrema`, `extremum_kind`, `multipliers` and `section` are then arrays of arrays.

    Raises
    ------
    ModelError
        If an argument is out of range. A numerical failure is a `status`, not an error.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> gs.respond(gs.systems.paper_oscillator(), law, omega=9.0).period_multiple
    1
    >>> gs.respond(gs.systems.paper_oscillator(), law, omega=[7.0, 9.0, 11.0]).amplitude.shape
    (3,)
    """
    solver, steady = Solver.of(engine, rtol, atol), _STEADY if steady is None else steady
    check_steady(steady)
    models, start, shape = cases(oscillator, law, omega, x_0, v_0, q_0, z_0)
    warn_of(doubts(objects(oscillator).ravel().tolist(), models.laws, models.omega, start))
    with within(time_limit):
        found = respond_models(models, solver, start, steady)
    inputs = inputs_of(oscillator, law, models, start, shape) | {
        "engine": solver.engine, "rtol": solver.rtol, "atol": solver.atol, "steady": steady
    }  # fmt: skip
    return found.shaped(shape, **inputs) if shape else found.rows(**inputs)[0]


def check_steady(steady: Steady) -> None:
    """Raise a `ModelError` if `steady` is no `Steady`."""
    if not isinstance(steady, Steady):
        raise ModelError(f"steady = {steady!r}: must be a gapsweep.Steady")


def respond_all(scenes: Sequence[Scene], starts: ArrayLike, steady: Steady) -> Responses:
    """Return the steady responses of many points, in their order.

    Points of a kind are integrated together; no response depends on the other points.

    `scenes`: all oscillators, or systems of one size.
    `starts`: shape (n, n_states) or (n_states,); initial displacements [m], velocities [m/s] and
    first-order states.
    """
    starts = np.asarray(starts, float)
    starts = np.broadcast_to(starts, (len(scenes), starts.shape[-1]))
    groups: dict[Solver, list[int]] = {}
    for i, scene in enumerate(scenes):
        groups.setdefault(scene.solver, []).append(i)
    found = []
    for solver, group in groups.items():
        some = [scenes[i] for i in group]
        columns = zip(*((one.oscillator, one.laws, one.omega) for one in some), strict=True)
        systems, laws, omega = map(list, columns)
        models = Models.of(systems, laws, np.array(omega))
        found.append(respond_models(models, solver, starts[group], steady))
    return _in_order(found, list(groups.values()))


def respond_models(models: Models, solver: Solver, starts: Array, steady: Steady) -> Responses:
    """Return the steady responses of models of any kinds, each from one initial state.

    `models`: all oscillators, or systems of one size.
    `starts`: shape (n, n_states); initial displacements [m], velocities [m/s] and first-order
    states.
    """
    groups, found = replace(models, start=starts).by_kind(), []
    for rows, some in groups:
        start = starts[rows].T
        is_forced = some.omega[0] > 0.0
        ensemble = Ensemble(some, solver) if is_forced else PoincareMap(some, solver, start)
        found.append(Search(ensemble, start, steady).responses())
    return _in_order(found, [rows for rows, _ in groups])


def _in_order(parts: Sequence[Responses], groups: Sequence[Sequence[int] | Numbers]) -> Responses:
    """Join the rows of all parts; `groups` are their row numbers in the result."""
    whole = Responses.concatenated(parts)
    return whole if len(parts) < 2 else whole.take(np.argsort(np.concatenate(groups)))
