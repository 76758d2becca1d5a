"""How well each representation agrees with the exact law, point by point.

Definitions (A: half the range of the steady response, G: width of the gap):

* amplitude error [-]: ``|A - A_exact| / max(A_exact, G/2)``;
* extrema distance [m]: Hausdorff distance of the two sets of steady extrema, the largest
  distance from a member of either set to the other set;
* class agreement [-]: 1 if response class and period multiple are the same, else 0.

A point counts only where both responses exist (resolved or not); all others are counted in
`n_compared` against `n_points`, never dropped in silence.
"""

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.analysis.statistics import SWEPT, mean, quantile
from gapsweep.status import Status
from gapsweep.study.schema import POINT_DIMS

REFERENCE = "piecewise"

Array = NDArray[np.float64]


def agreement(responses: xr.Dataset) -> xr.Dataset | None:
    """Compare every representation with `piecewise`; None if the exact law was not swept.

    Parameters
    ----------
    responses : Dataset
        As stored in ``responses.nc``.

    Returns
    -------
    Dataset
        Point-wise metrics over all dimensions, and their medians and 95th percentiles over
        frequencies and starts.
    """
    if REFERENCE not in responses["representation"].values:
        return None
    exact = responses.sel(representation=REFERENCE, drop=True)
    gap_width = (responses["j_1"] + responses["j_2"]).drop_vars(("j_1", "j_2"), errors="ignore")
    both = _exists(responses) & _exists(exact)
    scale = exact["amplitude"].clip(min=0.5 * gap_width)
    amplitude_error = (abs(responses["amplitude"] - exact["amplitude"]) / scale).where(both)
    same = (responses["response_class"] == exact["response_class"]) & (
        responses["period_multiple"] == exact["period_multiple"]
    )
    distance = _extrema_distance(responses, exact).where(both)
    requested = responses["status"] != Status.NOT_REQUESTED
    metrics = {
        "amplitude_error": (amplitude_error, "1", "amplitude error relative to the exact law"),
        "extrema_distance": (distance, "m", "Hausdorff distance of the steady extrema"),
        "class_agreement": (same.where(both), "1", "same class and period multiple"),
    }
    variables = {}
    for name, (values, units, long_name) in metrics.items():
        variables[name] = _labelled(values, units, long_name)
        for suffix, label, value in _summaries(name, values):
            variables[f"{name}_{suffix}"] = _labelled(value, units, f"{long_name}, {label}")
    counts = {"n_compared": both, "n_points": requested}
    for name, what in counts.items():
        count = what.sum(SWEPT).astype("i4")
        variables[name] = _labelled(count, "1", f"sweep points {name.removeprefix('n_')}")
    result = xr.Dataset(variables).transpose(*POINT_DIMS)
    return result.assign_attrs(_kept(responses), reference=REFERENCE)


def _kept(responses: xr.Dataset) -> dict[str, str]:
    names = ("title", "study", "study_json", "numerics_fingerprint")
    return {name: responses.attrs[name] for name in names}


def _exists(responses: xr.Dataset) -> xr.DataArray:
    return responses["amplitude"].notnull()


def _summaries(name: str, values: xr.DataArray) -> list[tuple[str, str, xr.DataArray]]:
    if name == "class_agreement":
        return [("mean", "share of the compared points", mean(values))]
    return [
        ("median", "median over frequencies and starts", quantile(values, 0.5)),
        ("p95", "95th percentile", quantile(values, 0.95)),
    ]


def _labelled(values: xr.DataArray, units: str, long_name: str) -> xr.DataArray:
    return values.assign_attrs(units=units, long_name=long_name)


def _extrema_distance(responses: xr.Dataset, exact: xr.Dataset) -> xr.DataArray:
    distance = xr.full_like(responses["amplitude"], np.nan)
    for label in responses["representation"].values:
        here = {"representation": label}
        ours = responses["extrema"].sel(here).values
        theirs = exact["extrema"].values
        cells = [hausdorff(ours[at], theirs[at]) for at in np.ndindex(ours.shape[:-1])]
        distance.loc[here] = np.reshape(cells, ours.shape[:-1])
    return distance


def hausdorff(a: Array, b: Array) -> float:
    """Hausdorff distance of two sets of numbers; NaN entries are padding, NaN if one is empty."""
    a, b = np.sort(a[np.isfinite(a)]), np.sort(b[np.isfinite(b)])
    if not a.size or not b.size:
        return float("nan")
    return max(_directed(a, b), _directed(b, a))


def _directed(a: Array, b: Array) -> float:
    """Largest distance from a member of sorted `a` to the nearest member of sorted `b`."""
    right = np.searchsorted(b, a)
    above = np.abs(b[np.minimum(right, b.size - 1)] - a)
    below = np.abs(b[np.maximum(right - 1, 0)] - a)
    return float(np.max(np.minimum(above, below)))
