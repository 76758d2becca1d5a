"""Costs of each representation, from the costs stored with its points.

Processor times of different machines are never mixed: costs are those of the machine that computed
most points of a study; points of other machines are counted only.
"""

import warnings

import numpy as np
import xarray as xr
from scipy.special import stdtrit

from gapsweep.analysis.dimensions import Array, of_study, swept
from gapsweep.status import Status
from gapsweep.variables import flags_of

COSTS = {
    "cpu_time": ("s", "CPU time per point"),
    "nfev": ("1", "right-hand-side evaluations per point"),
    "n_steps": ("1", "accepted steps per point"),
    "n_rejected": ("1", "rejected steps per point"),
    "contacts_per_period": ("1", "contacts of steady responses per forcing period"),
}


def timing(responses: xr.Dataset) -> xr.Dataset:
    """Mean and median cost per point of every representation and parameter set.

    `responses`: as stored in ``responses.nc``.
    """
    host = responses["host"]
    requested = responses["status"] != Status.NOT_REQUESTED
    known = host.values[host.values >= 0]
    chosen = int(np.bincount(known).argmax()) if known.size else -1  # has the most points
    measured = requested & (host == chosen)
    variables = {}
    with warnings.catch_warnings():
        # numpy warns where no point was measured: NaN is correct there.
        warnings.simplefilter("ignore", RuntimeWarning)
        for name, (units, long_name) in COSTS.items():
            values = responses[name].where(measured)
            dims = swept(values)
            only = values.isel(dict.fromkeys(dims, 0), drop=True)
            is_only = all(values.sizes[dim] == 1 for dim in dims)
            for statistic in ("mean", "median"):
                # xarray would take 4 us for the median of a single point.
                value = only if is_only else getattr(values, statistic)(dims)
                attributes = {"units": units, "long_name": f"{long_name}, {statistic}"}
                variables[f"{name}_{statistic}"] = value.assign_attrs(attributes)
    for name, where in (("n_points", measured), ("n_points_elsewhere", requested & ~measured)):
        count = where.sum(swept(where)).astype("i4").drop_attrs(deep=False)
        long_name = "sweep points measured" if name == "n_points" else "points of other machines"
        variables[name] = count.assign_attrs(units="1", long_name=long_name)
    machine = flags_of(host).get(chosen, "")
    return xr.Dataset(variables).assign_attrs(of_study(responses), measured_on=machine)


def repeatability(ratios: Array) -> float:
    """Half-width of the 95 % interval of the logarithm of ratios of equal quantities.

    `ratios`: measured ratios; NaN if not measured.
    """
    known = np.log(ratios[np.isfinite(ratios) & (ratios > 0.0)])
    if not known.size:
        return np.nan
    return float(stdtrit(known.size, 0.975) * np.sqrt(np.mean(known**2)))


def widened(ratio: float, interval: Array, noise: float) -> tuple[float, float]:
    """Interval of a ratio that combines `interval` and its `repeatability` in quadrature."""
    with np.errstate(divide="ignore", invalid="ignore"):
        below, above = np.exp(np.hypot(np.log(ratio / np.asarray(interval)), noise))
        return float(ratio / below), float(ratio * above)
