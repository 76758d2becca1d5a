"""Basins of attraction: the attractor of every initial condition on a grid."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from gapsweep.analysis.dimensions import Array
from gapsweep.errors import ModelError
from gapsweep.execution.cluster import check_workers
from gapsweep.integrate.problem import DEFAULT_ENGINE, Solver
from gapsweep.model.contact import ContactLaw
from gapsweep.model.doubts import doubts, warn_of
from gapsweep.model.oscillator import Oscillator, called_as, checked
from gapsweep.model.system import floats
from gapsweep.model.user_law import UserLaw
from gapsweep.response.attractors import Attractors, Grouping
from gapsweep.response.respond import check_steady, respond_all
from gapsweep.response.result import Responses, Steady
from gapsweep.response.scene import Scene
from gapsweep.response.section import unit_of

_MAX_STARTS = 10**6
_PART = 4096  # initial conditions computed in one call
_ATTRIBUTES = {
    "attractor": ("1", "number of the attractor, -1: none"),
    "x_max": ("m", "peak displacement of the attractor"),
    "x_min": ("m", "trough displacement of the attractor"),
    "period_multiple": ("1", "forcing periods in one period of the attractor, 0: none"),
    "multiplier_abs": ("1", "largest modulus of the Floquet multipliers"),
    "lyapunov": ("s-1", "largest Lyapunov exponent"),
    "basin_share": ("1", "share of the initial conditions that lead to the attractor"),
    "basin_share_error": ("1", "standard error of the share"),
}


@called_as("gs.basins(oscillator, law, 9.0, x=[0.0, 1e-3], v=[0.0]), in Hz, m and m/s")
def basins(
    oscillator: Oscillator,
    law: ContactLaw,
    omega: float | None = None,
    *,
    x: ArrayLike,
    v: ArrayLike,
    engine: str = DEFAULT_ENGINE,
    rtol: float | None = None,
    atol: float | None = None,
    steady: Steady | None = None,
    client: Any = None,
) -> xr.Dataset:
    """Return the attractors over a grid of initial states.

    Parameters
    ----------
    oscillator : Oscillator
    law : ContactLaw
    omega : float
        Forcing frequency [Hz], ``> 0``.
    x, v : array_like, shape (n_x,), (n_v,)
        Initial displacements [m] and velocities [m/s], at forcing phase zero.
    engine, rtol, atol, steady
        As in `gapsweep.respond`.
    client : distributed.Client, optional
        Dask cluster to use; None computes in this process. Not for user laws, since workers may
        have other code; use a study with a grid of initial conditions instead.

    Returns
    -------
    Dataset
        ``attractor(v_0, x_0)``, the number of the attractor of each initial condition (-1: none),
        and properties of the attractors over ``attractor_number``.

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
    if not isinstance(oscillator, Oscillator):
        raise ModelError(
            "oscillator: must be a gapsweep.Oscillator; for a System pass arrays of initial "
            "states to gapsweep.respond"
        )
    if omega is None:
        raise ModelError("omega: missing; give the forcing frequency [Hz], as 9.0")
    if client is not None:
        check_workers(client)
        if isinstance(law, UserLaw):
            raise ModelError(
                "client: not allowed with user laws; leave it out, or name the law in a study file"
            )
    starts_x, starts_v = (_axis(name, values) for name, values in (("x", x), ("v", v)))
    if starts_x.size * starts_v.size > _MAX_STARTS:
        raise ModelError(
            f"{starts_x.size} x {starts_v.size} initial conditions: must be <= {_MAX_STARTS}"
        )
    scene = Scene(
        oscillator=oscillator,
        law=law,
        omega=checked("omega", omega, low=0.0, strict=True),
        solver=Solver.of(engine, rtol, atol),
    )
    v_0, x_0 = (each.ravel() for each in np.meshgrid(starts_v, starts_x, indexing="ij"))
    warn_of(doubts([oscillator], [(law,)], scene.omega, np.stack([x_0, v_0], axis=1)))
    parts = [(x_0[i : i + _PART], v_0[i : i + _PART]) for i in range(0, x_0.size, _PART)]
    grouping = Grouping(unit_of(scene.omega))
    for answer in _answers(parts, scene, steady, client):
        grouping.add(answer, np.zeros(len(answer), int))
    is_symmetric = law.is_symmetric and oscillator.mean_load == 0.0
    return _dataset(grouping.attractors(is_symmetric), scene, starts_x, starts_v)


def _dataset(found: Attractors, scene: Scene, starts_x: Array, starts_v: Array) -> xr.Dataset:
    """The dataset that `basins` returns, from the grouped attractors."""
    (law,), columns = scene.laws, found.leaders.columns
    dataset = xr.Dataset(
        {
            "attractor": (
                ("v_0", "x_0"),
                found.numbers.reshape(starts_v.size, starts_x.size),
            ),
            **{
                name: (
                    "attractor_number",
                    columns[name] if name in columns else getattr(found, name),
                )
                for name in list(_ATTRIBUTES)[1:]
            },
        },
        coords={
            "x_0": ("x_0", starts_x, {"units": "m", "long_name": "initial displacement"}),
            "v_0": ("v_0", starts_v, {"units": "m s-1", "long_name": "initial velocity"}),
        },
        attrs={"omega": scene.omega, "K_c": law.K_c, "K_ratio": law.K_ratio, "gap": law.gap.label},
    )
    for name, (units, long_name) in _ATTRIBUTES.items():
        dataset[name].attrs.update(units=units, long_name=long_name)
    return dataset


def _answers(
    parts: list[tuple[Array, Array]], scene: Scene, steady: Steady, client: Any
) -> Iterator[Responses]:
    """Responses of all parts in order; each is released when the next is requested."""
    if client is None:
        yield from (_answer(part, scene, steady) for part in parts)
        return
    futures = [client.submit(_answer, part, scene, steady) for part in parts]
    while futures:
        yield futures.pop(0).result()


def _answer(starts: tuple[Array, Array], scene: Scene, steady: Steady) -> Responses:
    return respond_all([scene] * len(starts[0]), np.stack(starts, axis=1), steady)


def _axis(name: str, values: ArrayLike) -> np.ndarray:
    try:
        axis = np.ravel(floats(values))
    except (TypeError, ValueError, OverflowError):
        axis = np.empty(0)
    if not axis.size or not np.all(np.isfinite(axis)):
        raise ModelError(f"{name} = {values!r}: must be finite numbers and not empty")
    return axis
