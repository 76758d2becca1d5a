"""The Pareto front of error and cost, and the cheapest method that meets an error."""

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

# Errors for which reports name the cheapest method.
TARGETS = (1e-2, 1e-3, 1e-6, 1e-9)


def on_front(error: ArrayLike, cost: ArrayLike) -> NDArray[np.bool_]:
    """Points on the Pareto front: no other has less of one quantity and no more of the other.

    Parameters
    ----------
    error, cost : array_like, one shape
        NaN in either takes a point out of the comparison. Equal points are on the front together.

    Returns
    -------
    ndarray of bool
        In the shape of the arguments.
    """
    error, cost = np.asarray(error, dtype=float), np.asarray(cost, dtype=float)
    is_front = np.zeros(error.shape, dtype=bool)
    points = np.flatnonzero(np.isfinite(error.ravel()) & np.isfinite(cost.ravel()))
    points = points[np.lexsort((error.ravel()[points], cost.ravel()[points]))]
    best, best_cost = np.inf, np.nan
    for i in points.tolist():
        here, price = error.flat[i], cost.flat[i]
        if here < best or (here == best and price == best_cost):
            best, best_cost = here, price
            is_front.flat[i] = True
    return is_front


def cheapest(bench: xr.Dataset, target: float) -> xr.DataArray:
    """Cost of each method at its cheapest tolerance that meets an error, per scene.

    Parameters
    ----------
    bench : Dataset
        As stored in ``work_precision.nc``.
    target : float
        Error against the exact law [-]. A point whose error is too small to be measured has
        the largest error that it can have.

    Returns
    -------
    DataArray
        `cpu_time` over scene and method; NaN where no tolerance meets the target.
    """
    return bench["cpu_time"].where(bench["bounded_error"] <= target).min("tolerance")


def corners(bench: xr.Dataset, target: float) -> list[tuple[float, str, xr.DataArray]]:
    """Geometric mean of `cheapest` over the scenes of each contact stiffness and gap.

    Returns
    -------
    list of (K_c, gap, cost)
        Cost over method; NaN if a method misses the target in one of the corner's scenes.
    """
    cost = cheapest(bench, target)
    pairs = list(zip(bench["K_c"].values.tolist(), bench["gap"].values.tolist(), strict=True))
    found = []
    for K_c, gap in dict.fromkeys(pairs):
        here = [pair == (K_c, gap) for pair in pairs]
        logs = np.log(cost.isel(scene=np.flatnonzero(here)))
        mean: xr.DataArray = xr.DataArray(logs).mean("scene", skipna=False)
        found.append((K_c, gap, mean.copy(data=np.exp(mean.values))))
    return found
