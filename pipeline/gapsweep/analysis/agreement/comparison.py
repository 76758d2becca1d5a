"""Agreement of each representation with the exact law: ``agreement.nc``.

Every representation, the exact law with other solver settings included, is compared with the
one labelled ``piecewise``: by point, by attractor, and in summaries of each parameter set.
`gapsweep.analysis.agreement.metrics` defines the variables.
"""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.analysis.agreement.attractor_sets import basin_metrics, matching, set_metrics
from gapsweep.analysis.agreement.jumps import jump_shifts
from gapsweep.analysis.agreement.law_tables import LawTable, law_table
from gapsweep.analysis.agreement.metrics import BOUND, BOUNDS, REGIME, REGIMES, variables
from gapsweep.analysis.agreement.pointwise import start_metrics
from gapsweep.analysis.agreement.pooling import summaries
from gapsweep.analysis.agreement.self_agreement import floor_labels
from gapsweep.analysis.dimensions import (
    REPRESENTATION,
    SWEPT,
    At,
    by_coordinate,
    cells,
    of_oscillator,
    of_study,
    over,
    point_dims,
    scene_dims,
    scenes,
    section_rate,
    with_rate,
)
from gapsweep.model.labels import EXACT, Representation
from gapsweep.response.thresholds import DEVIATIONS
from gapsweep.status import Status
from gapsweep.study.grid import COORDINATE

_VARIABLES = dict(variables())
_TINY = 1e-300
_WALLS = ("j_1", "j_2", "K_ratio", "mean_load")

Tables = dict[str, NDArray[Any]]


def agreement(responses: xr.Dataset, attractors: xr.Dataset) -> xr.Dataset:
    """Compare every representation with the swept `piecewise`.

    `responses` and `attractors`: as in ``responses.nc`` and ``attractors.nc``; parameter sets are
    read one by one. Result: the variables of `gapsweep.analysis.agreement.metrics.variables`.
    """
    if COORDINATE in responses.dims:
        parts = zip(by_coordinate(responses), by_coordinate(attractors), strict=True)
        found = [agreement(one, other) for (one, _), (other, _) in parts]
        how: Any = {"coords": "different", "compat": "equals", "combine_attrs": "override"}
        return xr.concat(found, COORDINATE, **how).transpose(..., COORDINATE)
    if "omega" not in responses.dims:
        rate = section_rate(responses)
        forced = agreement(with_rate(responses, rate), with_rate(attractors, rate))
        return forced.isel(omega=0, drop=True)
    labels = [Representation(label) for label in responses["representation"].values]
    study = json.loads(responses.attrs.get("study_json", "{}"))
    mean_load = study.get("oscillator", {}).get("mean_load", 0.0)
    forces = json.loads(responses.attrs.get("tables_json", "{}"))
    uneven = {label for label, force in forces.items() if not force["is_odd"]}
    floors = floor_labels(responses.attrs.get("study_json", ""), labels)
    dims = point_dims(responses)
    sizes = {**responses.sizes, REGIME: len(REGIMES), BOUND: len(BOUNDS)}
    tables: Tables = {}
    for name, metric in _VARIABLES.items():
        missing = 0 if metric.dtype == "i4" else np.nan
        shape = [sizes[dim] for dim in over(metric.dims, dims)]
        tables[name] = np.full(shape, missing, metric.dtype)

    def place(name: str, at: At, values: Any) -> None:
        tables[name][cells(over(_VARIABLES[name].dims, dims), at)] = values

    requested = (responses["status"] != Status.NOT_REQUESTED).any(SWEPT)
    for at in scenes(responses, scene_dims(dims)):
        swept = np.flatnonzero(requested.isel(at)).tolist()
        if not swept:
            continue
        exact = law_table(responses, attractors, {**at, REPRESENTATION: labels.index(EXACT)})
        walls = responses[[name for name in _WALLS if name in responses.coords]]
        walls = walls.isel(at, missing_dims="ignore")
        width, is_symmetric = length_scale(0.0, exact), False
        if of_oscillator(responses):  # then the walls bound the displacement
            j_1, j_2 = float(walls["j_1"]), float(walls["j_2"])
            is_symmetric = j_1 == j_2 and float(walls.get("K_ratio", 1.0)) == 1.0
            is_symmetric &= float(walls.get("mean_load", mean_load)) == 0.0
            width = length_scale(j_1 + j_2, exact)
        for r in swept:
            here = {**at, REPRESENTATION: r}
            ours = exact if labels[r] == EXACT else law_table(responses, attractors, here)
            # Infinity and NaN result from responses that diverged or are missing.
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                symmetric = is_symmetric and labels[r].law not in uneven
                for name, values in _compared(ours, exact, width, symmetric=symmetric):
                    place(name, here, values)
    _set_floors(tables, [r for r, label in enumerate(labels) if label in floors])
    return _dataset(tables, responses, floors)


def length_scale(gap: float, exact: LawTable) -> float:
    """Scale of lengths [m]: the width of the gap, at most the largest range of a motion.

    Distant walls do not affect the scale of errors. Without a gap: the median range of motions;
    without motions: twice the distance of the farthest equilibrium from zero.
    """
    amplitude, noise = exact.amplitude[exact.exists], exact.noise[exact.exists]
    moving = amplitude[(amplitude > 0.0) & ~(amplitude <= DEVIATIONS * noise)]
    if 0.0 < gap < np.inf:
        return float(min(gap, 2.0 * moving.max(initial=0.0) or gap))
    places = np.abs(exact.found.section[..., 0])
    scale = np.median(moving) if moving.size else np.nanmax(places, initial=0.0)
    return max(2.0 * float(scale), _TINY)


def _compared(
    ours: LawTable, exact: LawTable, width: float, *, symmetric: bool
) -> Iterator[tuple[str, Any]]:
    """All variables of one law in one parameter set, except ``_floor``, by name."""
    found = matching(ours, exact, width, symmetric=symmetric)
    values = {"jump_shift": jump_shifts(ours, exact, 0.5 * width)}
    values |= start_metrics(ours, exact, 0.5 * width)
    values |= set_metrics(found, ours, exact, 0.5 * width)
    values |= basin_metrics(found, ours, exact)
    yield from values.items()
    yield from summaries(ours, exact, values)


def _set_floors(tables: Tables, floors: list[int]) -> None:
    """Set the variables ``_floor``: the worst values of the exact law against itself."""
    for name, metric in _VARIABLES.items():
        if floors and f"{name}_floor" in tables:
            values = tables[name][floors]
            lowest = metric.worst == "min"
            worst = np.fmin.reduce(values) if lowest else np.fmax.reduce(np.abs(values))
            tables[f"{name}_floor"][...] = worst


def _dataset(tables: Tables, responses: xr.Dataset, floors: list[str]) -> xr.Dataset:
    dims = point_dims(responses)
    coordinates = {name: c for name, c in responses.coords.items() if set(c.dims) <= {*dims}}
    for dim, values in ((REGIME, REGIMES), (BOUND, BOUNDS)):
        coordinates[dim] = xr.DataArray(list(values), dims=dim, attrs={"long_name": dim})
    result = xr.Dataset(
        {
            name: (
                over(metric.dims, dims),
                tables[name],
                {
                    "units": metric.units,
                    "long_name": metric.long_name,
                    "metric": metric.number,
                    "definition": metric.definition,
                },
            )
            for name, metric in _VARIABLES.items()
        },
        coordinates,
    )
    return result.assign_attrs(
        of_study(responses),
        reference=EXACT,
        floor_representations=" ".join(floors),
    )
