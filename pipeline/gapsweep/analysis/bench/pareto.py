"""The Pareto front of error and cost, and the cheapest method for a given error."""

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

# Errors for which reports name the cheapest method.
TARGETS = (1e-2, 1e-3, 1e-6, 1e-9)


def on_front(error: ArrayLike, cost: ArrayLike) -> NDArray[np.bool_]:
    """Mask of the Pareto front: no other point is better in one quantity and no worse in the other.

    Parameters
    ----------
    error, cost : array_like, one shape
        A point with NaN is not compared. Equal points are on the front together.

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
        here, its_cost = error.flat[i], cost.flat[i]
        if here < best or (here == best and its_cost == best_cost):
            best, best_cost = here, its_cost
            is_front.flat[i] = True
    return is_front


def cheapest(bench: xr.Dataset, target: float) -> xr.DataArray:
    """Cost of each method at its cheapest tolerance that meets an error, per scenario.

    Parameters
    ----------
    bench : Dataset
        As stored in ``work_precision.nc``.
    target : float
        Error against the exact law [-]. A point whose error is too small to be measured has
        the upper bound of its error.

    Returns
    -------
    DataArray
        `cpu_time` over `scene` and `method`; NaN if no tolerance meets the target.
    """
    return bench["cpu_time"].where(bench["bounded_error"] <= target).min("tolerance")


def corners(bench: xr.Dataset, target: float) -> list[tuple[float, str, xr.DataArray]]:
    """Geometric mean of `cheapest` over the scenarios of each contact stiffness and gap.

    Result: K_c, gap and the cost over method; NaN if a method misses the target in a scenario of
    this stiffness and gap.
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
