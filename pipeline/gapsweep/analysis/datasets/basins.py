"""Basins of attraction: the attractor of every initial condition on a grid."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from gapsweep.analysis.dimensions import Array
from gapsweep.errors import ModelError
from gapsweep.execution.cluster import check_workers
from gapsweep.integrate.problem import DEFAULT_ENGINE, Model, Models, Solver
from gapsweep.integrate.simulate import AnyLaw, cases
from gapsweep.model.arrays import numbers
from gapsweep.model.doubts import doubts, warn_of
from gapsweep.model.oscillator import Oscillator, called_as, whole
from gapsweep.model.system import System
from gapsweep.model.user_law import UserLaw
from gapsweep.response.attractors import Attractors, Grouping
from gapsweep.response.disturbances import DISTURBANCES, smallest_disturbances
from gapsweep.response.respond import check_steady, respond_models
from gapsweep.response.result import Responses, Steady
from gapsweep.variables import COORDINATE, INPUTS, LAG, Variable

_MAX_STARTS = 10**6
_MAX_RAYS = 4096
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
    rays: int = 0,
    client: Any = None,
) -> xr.Dataset:
    """Return the attractors over a grid of initial states, and the disturbances that leave them.

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
    rays : int
        Rays from every attractor on which the smallest disturbance of the state that leaves it is
        searched, 0 to 4096; 0, the default: no search. 32 are many for an oscillator, systems with
        more states need more. Disturbances are searched up to the farthest of the initial states.
    client : distributed.Client, optional
        Dask cluster to use; None computes in this process. Not for user laws, since workers may
        have other code; use a study with a grid of initial conditions instead.

    Returns
    -------
    Dataset
        ``attractor(v_0, x_0)``, the number of the attractor of each initial condition (-1: none),
        and properties of the attractors over ``attractor_number``. States given by name have
        dimensions of that name. With `rays`, ``disturbance`` is the norm of the smallest
        disturbance found [m], an upper bound: the root of the sum of squares of its parts, each
        divided by its value for a motion of one metre. These are 1 for a displacement and the
        angular frequency for a velocity of an oscillator, `System.unit` for a system.
        ``disturbed_x`` and ``disturbed_v`` are the state that is disturbed, at forcing phase zero,
        ``disturbance_x`` and ``disturbance_v`` the changes; ``single_up_v`` is the smallest
        increase of the velocity that leaves without another change. NaN: none was found.

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
    rays = whole("rays", rays, 0, _MAX_RAYS)
    states = np.zeros((*shape, oscillator.n_states))
    for number, values in zip(axes, np.meshgrid(*axes.values(), indexing="ij"), strict=True):
        states[..., number] = values
    law = {} if law is None else law
    models, start, found_shape = cases(oscillator, law, omega, **arguments(oscillator, states))
    if found_shape != shape or len(models.laws) > 1 or np.ptp(models.omega) > 0.0:
        raise ModelError(
            f"omega = {omega!r:.80}: must be one frequency with one law; call gs.basins for each"
        )
    (laws,) = models.laws
    if client is not None:
        check_workers(client)
        if any(isinstance(each, UserLaw) for each in laws):
            raise ModelError(
                "client: not allowed with user laws; leave it out, or name the law in a study file"
            )
    warn_of(doubts([oscillator], [laws], models.omega[0], start))
    settings = Solver.of(engine, rtol, atol), steady
    rate = 2.0 * np.pi * np.array([models.omega[0] or oscillator.slowest or 1.0])
    unit = np.array(oscillator.unit(rate))
    grouping = Grouping(unit)
    for answer in _answers(models, start, settings, client):
        grouping.add(answer, np.zeros(len(answer), int))
    is_odd = isinstance(oscillator, Oscillator) and oscillator.mean_load == 0.0
    found = grouping.attractors(is_odd and laws[0].is_symmetric)
    named = {names[number]: values for number, values in axes.items()}
    left: dict[str, Array] = {}
    if rays:

        def respond_all(of: NDArray[np.intp], states: Array) -> Responses:
            some = models.take(np.zeros_like(of))
            return Responses.concatenated([*_answers(some, states, settings, client)])

        of_all = found.leaders, np.repeat(unit, len(found.leaders), axis=1)
        left = smallest_disturbances(*of_all, start, rays, respond_all).arrays(oscillator.n)
    dataset = _dataset(found, left, oscillator, named)
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


def _dataset(
    found: Attractors, left: dict[str, Array], model: Model, axes: Mapping[str, Array]
) -> xr.Dataset:
    """The dataset that `basins` returns, from the grouped attractors and their disturbances."""
    columns, shape = found.leaders.columns | left, tuple(map(len, axes.values()))
    is_system = isinstance(model, System)
    data: dict[str, Any] = {"attractor": ((*axes,), found.numbers.reshape(shape))}
    variables = _ATTRIBUTES | {name: DISTURBANCES[name] for name in left}
    for name in [*variables][1:]:
        values = columns[name] if name in columns else getattr(found, name)
        part = LAG if LAG in variables[name].dims else COORDINATE
        data[name] = ((_NUMBER, part)[: values.ndim], values)
    dataset = xr.Dataset(data)
    for name, variable in variables.items():
        described = variable.in_units(model.part_units)
        dataset[name].attrs.update(described.attributes)
    for name, values in axes.items():
        known = {"long_name": f"initial {name}"} if is_system else INPUTS[name].attributes
        dataset = dataset.assign_coords({name: (name, values, known)})
    names = {dim: [*labels] for dim, labels in model.parts.items() if dim in dataset.dims}
    return dataset.assign_coords(names)


def _answers(
    models: Models, start: Array, settings: tuple[Solver, Steady], client: Any
) -> Iterator[Responses]:
    """Responses in order, in parts; each is released when the next is requested."""
    rows = np.split(np.arange(len(start)), range(_PART, len(start), _PART))
    parts = [(models.take(some), start[some]) for some in rows]
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
