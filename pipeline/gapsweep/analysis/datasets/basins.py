"""Basins of attraction: the attractor of every initial condition on a grid."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from gapsweep.analysis.dimensions import Array
from gapsweep.errors import ModelError
from gapsweep.execution.cluster import check_workers
from gapsweep.integrate.problem import DEFAULT_ENGINE, Model, Models, Solver
from gapsweep.integrate.simulate import AnyLaw, cases
from gapsweep.model.arrays import numbers
from gapsweep.model.doubts import doubts, warn_of
from gapsweep.model.oscillator import Oscillator, called_as
from gapsweep.model.system import System
from gapsweep.model.user_law import UserLaw
from gapsweep.response.attractors import Attractors, Grouping
from gapsweep.response.respond import check_steady, respond_models
from gapsweep.response.result import Responses, Steady
from gapsweep.variables import COORDINATE, INPUTS, Variable

_MAX_STARTS = 10**6
_PART = 4096  # initial conditions computed in one call
_NUMBER = "attractor_number"
_ATTRIBUTES = {
    "attractor": Variable("i8", "1", "number of the attractor, -1: none"),
    "x_max": Variable("f8", "m", "peak displacement of the attractor"),
    "x_min": Variable("f8", "m", "trough displacement of the attractor"),
    "period_multiple": Variable("i4", "1", "forcing periods in one period, 0: none"),
    "multiplier_abs": Variable("f8", "1", "largest modulus of the Floquet multipliers"),
    "lyapunov": Variable("f8", "s-1", "largest Lyapunov exponent"),
    "basin_share": Variable("f8", "1", "share of the initial conditions that lead to it"),
    "basin_share_error": Variable("f8", "1", "standard error of the share"),
}


@called_as("gs.basins(oscillator, law, 9.0, x=[0.0, 1e-3], v=[0.0]), in Hz, m and m/s")
def basins(
    oscillator: Model,
    law: AnyLaw | None = None,
    omega: float | None = None,
    *,
    x: ArrayLike | tuple[str, ArrayLike],
    v: ArrayLike | tuple[str, ArrayLike],
    engine: str = DEFAULT_ENGINE,
    rtol: float | None = None,
    atol: float | None = None,
    steady: Steady | None = None,
    client: Any = None,
) -> xr.Dataset:
    """Return the attractors over a grid of initial states.

    Parameters
    ----------
    oscillator : Oscillator or System
    law : ContactLaw or mapping of str to ContactLaw
        As in `gapsweep.simulate`; None of a System without contacts.
    omega : float
        Forcing frequency [Hz], ``> 0``; None for an unforced system.
    x, v : array_like, shape (n_x,), (n_v,), or tuple of (str, array_like)
        Initial displacements [m] and velocities [m/s], at forcing phase zero, of the first
        coordinate; or the name of any state and its values: ``"h"`` for a coordinate h, ``"v_h"``
        for its velocity, ``"z_1"`` for a first-order state. The other states are 0.
    engine, rtol, atol, steady
        As in `gapsweep.respond`.
    client : distributed.Client, optional
        Dask cluster to use; None computes in this process. Not for user laws, since workers may
        have other code; use a study with a grid of initial conditions instead.

    Returns
    -------
    Dataset
        ``attractor(v_0, x_0)``, the number of the attractor of each initial condition (-1: none),
        and properties of the attractors over ``attractor_number``. States given by name have
        dimensions of that name.

    Raises
    ------
    ModelError
        If an argument is out of range.
    ClusterError
        If the workers have another version of the code.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> ds = gs.basins(gs.systems.paper_oscillator(), law, 9.0, x=[-1e-3, 0.0, 1e-3], v=[0.0, 0.1])
    >>> ds["attractor"].shape
    (2, 3)
    """
    steady = Steady() if steady is None else steady
    check_steady(steady)
    if not isinstance(oscillator, Oscillator | System):
        raise ModelError(f"oscillator = {oscillator!r:.80}: must be an Oscillator or a System")
    names = _states(oscillator)
    axes = dict([_axis("v", v, names, oscillator.n), _axis("x", x, names, 0)])
    if len(axes) < 2:
        raise ModelError(f"x and v: both are {names[next(iter(axes))]!r}; give two states")
    shape = tuple(map(len, axes.values()))
    if math.prod(shape) > _MAX_STARTS:
        size = " x ".join(map(str, shape[::-1]))
        raise ModelError(f"{size} initial conditions: must be <= {_MAX_STARTS}")
    states = np.zeros((*shape, oscillator.n_states))
    for number, values in zip(axes, np.meshgrid(*axes.values(), indexing="ij"), strict=True):
        states[..., number] = values
    law = {} if law is None else law
    models, start, _ = cases(oscillator, law, omega, **arguments(oscillator, states))
    (laws,) = models.laws
    if client is not None:
        check_workers(client)
        if any(isinstance(each, UserLaw) for each in laws):
            raise ModelError(
                "client: not allowed with user laws; leave it out, or name the law in a study file"
            )
    warn_of(doubts([oscillator], [laws], models.omega[0], start))
    parts = np.split(np.arange(len(start)), range(_PART, len(start), _PART))
    settings = Solver.of(engine, rtol, atol), steady
    rate = 2.0 * np.pi * np.array([models.omega[0] or oscillator.slowest or 1.0])
    grouping = Grouping(np.array(oscillator.unit(rate)))
    for answer in _answers([(models.take(i), start[i]) for i in parts], settings, client):
        grouping.add(answer, np.zeros(len(answer), int))
    is_odd = isinstance(oscillator, Oscillator) and oscillator.mean_load == 0.0
    found = grouping.attractors(is_odd and laws[0].is_symmetric)
    named = {names[number]: values for number, values in axes.items()}
    dataset = _dataset(found, oscillator, named)
    if isinstance(oscillator, Oscillator):
        of = laws[0]
        dataset.attrs |= {"K_c": of.K_c, "K_ratio": of.K_ratio, "gap": of.gap.label}
    return dataset if omega is None else dataset.assign_attrs(omega=float(models.omega[0]))


def _states(model: Model) -> list[str]:
    """Names of the states of a model, in their order; as in other datasets for an oscillator."""
    if isinstance(model, Oscillator):
        return ["x_0", "v_0"]
    names = [*model.coordinates]
    return [*names, *(f"v_{name}" for name in names), *(f"z_{i + 1}" for i in range(model.n_lags))]


def arguments(model: Model, states: Array) -> dict[str, Any]:
    """Initial states, shape (..., n_states), as arguments of `simulate`."""
    n = model.n
    q, v, z = np.split(states, [n, 2 * n], axis=-1)
    if isinstance(model, Oscillator):
        return {"x_0": q[..., 0], "v_0": v[..., 0], "q_0": 0.0, "z_0": 0.0}
    return {"x_0": 0.0, "q_0": q, "v_0": v, "z_0": z if z.size else 0.0}


def _dataset(found: Attractors, model: Model, axes: Mapping[str, Array]) -> xr.Dataset:
    """The dataset that `basins` returns, from the grouped attractors."""
    columns, shape = found.leaders.columns, tuple(map(len, axes.values()))
    is_system = isinstance(model, System)
    data: dict[str, Any] = {"attractor": ((*axes,), found.numbers.reshape(shape))}
    for name in [*_ATTRIBUTES][1:]:
        values = columns[name] if name in columns else getattr(found, name)
        data[name] = ((_NUMBER, COORDINATE)[: values.ndim], values)
    dataset = xr.Dataset(data)
    for name, variable in _ATTRIBUTES.items():
        described = variable.in_units(model.part_units)
        dataset[name].attrs.update(described.attributes)
    for name, values in axes.items():
        known = {"long_name": f"initial {name}"} if is_system else INPUTS[name].attributes
        dataset = dataset.assign_coords({name: (name, values, known)})
    if COORDINATE in dataset.dims:
        dataset = dataset.assign_coords({COORDINATE: [*model.parts[COORDINATE]]})
    return dataset


def _answers(
    parts: list[tuple[Models, Array]], settings: tuple[Solver, Steady], client: Any
) -> Iterator[Responses]:
    """Responses of all parts in order; each is released when the next is requested."""
    if client is None:
        yield from (_answer(part, *settings) for part in parts)
        return
    futures = [client.submit(_answer, part, *settings) for part in parts]
    while futures:
        yield futures.pop(0).result()


def _answer(part: tuple[Models, Array], solver: Solver, steady: Steady) -> Responses:
    return respond_models(part[0], solver, part[1], steady)


def _axis(which: str, given: Any, names: list[str], default: int) -> tuple[int, Array]:
    """The number of a state, and its values."""
    number, values = default, given
    if isinstance(given, tuple) and given and isinstance(given[0], str):
        if len(given) != 2 or given[0] not in names:
            said = "must be values, or a state and its values"
            raise ModelError(f"{which} = ({given[0]!r}, ...): {said}; states: {', '.join(names)}")
        number, values = names.index(given[0]), given[1]
    axis = np.ravel(numbers(which, values, "finite numbers and not empty"))
    if not axis.size or not np.all(np.isfinite(axis)):
        raise ModelError(f"{which} = {given!r:.80}: must be finite numbers and not empty")
    return number, axis
