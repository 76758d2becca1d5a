"""Tables of the report: rows of texts, from the datasets of a run."""

import warnings
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr

from gapsweep.analysis.grid import scene_dims
from gapsweep.analysis.metrics import BOUND
from gapsweep.report.style import colour

Row = dict[str, Any]

_COUNTS = ("nfev", "n_steps", "n_rejected", "n_contacts")
# Worst first: what a reader looks for.
VERDICTS = ("refuted", "partly", "confirmed", "undecidable")


def agreement_rows(agreement: xr.Dataset, labels: list[str]) -> Iterator[Row]:
    """Agreement of representations with the exact law, and the floors at the end.

    Parameters
    ----------
    agreement : Dataset
        One scene of ``agreement.nc``, or more: then medians over scenes, without intervals.
    labels : list of str
        Representations swept there.
    """
    pooled = condensed(agreement[list(_SHOWN)].sel(regime="all").load())
    floors = str(agreement.attrs["floor_representations"]).split()
    for label in labels:
        if label not in (agreement.attrs["reference"], *floors):
            row = pooled.sel(representation=label)
            yield {
                "representation": label,
                "colour": colour(label),
                "compared": f"{row['n_compared'].item()} of {row['n_points'].item()}",
                **_agreement(row),
            }
    if floors:
        yield {
            "representation": "exact against exact",
            "colour": colour("piecewise"),
            "compared": "",
            **_agreement(pooled, floor="_floor"),
        }


_POOLED = (
    "amplitude_error_median",
    "amplitude_error_p95",
    "recall_pooled",
    "precision_pooled",
    "class_agreement_mean",
    "basin_distance_mean",
)
_SHOWN = (
    *_POOLED,
    *(f"{name}_floor" for name in _POOLED),
    "amplitude_error_median_ci",
    "n_compared",
    "n_points",
)


def _agreement(row: xr.Dataset, floor: str = "") -> Row:
    def value(name: str) -> float:
        return float(row[name + floor])

    return {
        "amplitude_median": percent(value("amplitude_error_median")),
        "amplitude_interval": "" if floor else _interval(row["amplitude_error_median_ci"]),
        "amplitude_p95": percent(value("amplitude_error_p95")),
        "recall": percent(value("recall_pooled")),
        "precision": percent(value("precision_pooled")),
        "same_class": percent(value("class_agreement_mean")),
        "basin_distance": number(value("basin_distance_mean")),
    }


def _interval(bounds: xr.DataArray) -> str:
    low, high = (percent(float(bound)) for bound in bounds)
    return f"{low.removesuffix(' %')} to {high}" if "–" not in (low, high) else ""


def timing_rows(timing: xr.Dataset, labels: list[str]) -> Iterator[Row]:
    """Median costs per sweep point in one scene of ``timing.nc``, or medians over its scenes."""
    timing = condensed(timing.load())
    for label in labels:
        row = timing.sel(representation=label)
        yield {
            "representation": label,
            "colour": colour(label),
            "cpu": number(1e3 * row["cpu_time_median"].item()),
            **{n: number(row[f"{n}_median"].item()) for n in _COUNTS},
            "n_points": row["n_points"].item(),
            "n_elsewhere": row["n_points_elsewhere"].item(),
        }


def condensed(dataset: xr.Dataset) -> xr.Dataset:
    """Medians over scenes, and sums of what is counted; one scene as it is."""
    dims = [dim for dim in scene_dims(dataset.dims) if dim != BOUND]
    if not dims:
        return dataset
    counted = [name for name, variable in dataset.items() if variable.dtype.kind == "i"]
    # The median of intervals would be none.
    intervals = {name: np.nan * dataset[name] for name in dataset if str(name).endswith("_ci")}
    with warnings.catch_warnings():
        # numpy warns where no scene has a number: NaN is what we want there.
        warnings.simplefilter("ignore", RuntimeWarning)
        middle = dataset.drop_vars(counted).assign(intervals).median(dims)
    return middle.assign(dataset[counted].sum(dims))


def claim_rows(decided: Mapping[str, Any]) -> Iterator[Row]:
    """The claims of ``claims.json``, their tests as texts."""
    for claim in decided["claims"]:
        tests = [
            {
                "says": test["says"],
                "outcome": outcome(test),
                "floor": number(test["floor"]) if test["floor"] else "–",
                "n": test["n"],
            }
            for test in claim["tests"]
        ]
        yield {**claim, "sign": _SIGNS[claim["verdict"]], "tests": tests}


def outcome(test: Mapping[str, Any]) -> str:
    """What came of a test of ``claims.json``, in a few words."""
    value, threshold = (
        "no finite number" if test[name] is None else number(test[name])
        for name in ("value", "threshold")
    )
    wanted = f"{_SHOWN_AS.get(test['op'], test['op'])} {threshold}"
    if test["holds"] is not None:
        return f"{value} {wanted} holds" if test["holds"] else f"{value}, not {wanted}"
    if None in (test["value"], test["threshold"]):
        return f"open: {value}, asked for {wanted}"
    return f"open: {value} is within its floor of {wanted}"


_SHOWN_AS = {"<=": "≤", ">=": "≥"}
_SIGNS = {"confirmed": "✓", "refuted": "✗", "partly": "◐", "undecidable": "?"}


def number(value: float) -> str:
    """Three significant digits, exponents only where they help."""
    if not np.isfinite(value):
        return "–"
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{float(mantissa):g}e{int(exponent)}"


def percent(value: float) -> str:
    """A share or a relative error, three significant digits."""
    if not np.isfinite(value):
        return "–"
    return f"{100.0 * value:.0f} %" if abs(value) >= 1.0 else f"{number(100.0 * value)} %"
