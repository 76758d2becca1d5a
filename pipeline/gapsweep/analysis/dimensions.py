"""Dimensions of the datasets of a run, and selections along them.

A parameter set has one stiffness, one gap and one value of every further parameter: its dimensions
are all except representation, frequency and initial condition.
"""

from collections.abc import Hashable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.errors import DatasetError
from gapsweep.study.axis_selection import is_several, numbers_of_sweeps, positions
from gapsweep.study.grid import COORDINATE, START
from gapsweep.study.schema import POINT_DIMS

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

REPRESENTATION, SWEPT = "representation", ("omega", "initial_condition")

At = Mapping[str, int]
# Attributes of a dataset that describe the study and the code of its points.
_OF_STUDY = (
    "title", "study", "study_json", "system_json", "creator_name", "license",
    "numerics_fingerprint",
)  # fmt: skip


def of_study(responses: xr.Dataset) -> dict[str, Any]:
    """Attributes of responses that datasets made from them inherit."""
    return {name: responses.attrs[name] for name in _OF_STUDY if name in responses.attrs}


def swept(values: xr.DataArray) -> list[str]:
    """The dimensions within a parameter set; unforced systems have no frequencies."""
    return [dim for dim in SWEPT if dim in values.dims]


def point_dims(responses: xr.Dataset) -> tuple[str, ...]:
    """Dimensions of a sweep point, in the order of the file."""
    return tuple(str(dim) for dim in responses["status"].dims)


def scene_dims(dims: Iterable[Hashable]) -> list[str]:
    """The given dimensions except representation, frequency and initial condition, in order."""
    return [str(dim) for dim in dims if dim not in (REPRESENTATION, *SWEPT)]


def over(dims: tuple[str, ...], of_points: tuple[str, ...]) -> tuple[str, ...]:
    """Dimensions of a metric in a study, from those in a study that sweeps stiffness and gap.

    `dims`: some of `POINT_DIMS`, and further dimensions of the metric.
    `of_points`: dimensions of a sweep point, as from `point_dims`.
    """
    left_out = {REPRESENTATION, *SWEPT} - set(dims)
    own = (dim for dim in dims if dim not in POINT_DIMS)
    return (*(dim for dim in of_points if dim not in left_out), *own)


def scenes(dataset: xr.Dataset, dims: Iterable[str]) -> Iterator[dict[str, int]]:
    """Positions along some dimensions, as index by name; the last dimension varies fastest."""
    names = list(dims)
    for position in np.ndindex(*(dataset.sizes[name] for name in names)):
        yield dict(zip(names, position, strict=True))


def cells(dims: Iterable[str], at: At) -> tuple[int | slice, ...]:
    """Index of the values at a position in an array over the dimensions."""
    return tuple(at.get(dim, slice(None)) for dim in dims)


def of_oscillator(responses: xr.Dataset) -> bool:
    """Whether the displacement is that of the contact, and so comparable with the gap.

    A contact of a system acts on a combination of its coordinates.
    """
    return "system_json" not in responses.attrs


def by_coordinate(dataset: xr.Dataset) -> Iterator[tuple[xr.Dataset, str]]:
    """Parts of a dataset, one per coordinate of a system, each with its name for captions."""
    if COORDINATE not in dataset.dims:
        yield dataset, ""
        return
    for i, name in enumerate(dataset[COORDINATE].values.tolist()):
        yield dataset.isel({COORDINATE: i}), f", {name}"


def with_rate(dataset: xr.Dataset, rate: float) -> xr.Dataset:
    """A dataset of unforced responses with a dimension `omega` of one frequency.

    `dataset`: ``responses.nc`` or ``attractors.nc``.
    `rate`: section points per second [Hz].
    """
    at = list(dataset["response_class"].dims)
    axis = at.index(START) if START in at else len(at) - 1
    return dataset.assign(
        {
            name: variable.expand_dims(omega=[rate], axis=axis)
            for name, variable in dataset.data_vars.items()
            if {*at[:axis]} <= {*variable.dims}
        }
    )


def section_rate(responses: xr.Dataset) -> float:
    """Median section points per second [Hz] of unforced periodic responses; 1 if unknown."""
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = responses["period_multiple"].values / responses["period"].values
    known = rates[np.isfinite(rates)]
    return float(np.median(known)) if known.size else 1.0


def selected(dataset: xr.Dataset, wanted: Mapping[str, Any]) -> xr.Dataset:
    """Select a part of a dataset by coordinates that have one dimension.

    A value of a dimension's own coordinate reduces it to a scalar; lists, slices (both ends
    included) and other coordinates (``start="fixed"``) keep the dimension. A sweep is selected by
    its name, ``initial_condition="sweep_up"``.
    `gapsweep.study.axis_selection` defines which values are equal.

    Raises `DatasetError` if a name is no coordinate or nothing has the value.
    """
    for name, value in wanted.items():
        if name not in dataset.coords:
            known = ", ".join(str(coordinate) for coordinate in dataset.coords)
            raise DatasetError(f"{name}: not a coordinate of this dataset; choose from {known}")
        coordinate = dataset[name]
        if name == START and "start" in dataset.coords:
            value = numbers_of_sweeps(value, np.atleast_1d(dataset["start"]).tolist())
        try:
            where = positions(name, coordinate.values, value)
        except ValueError as error:
            raise DatasetError(str(error)) from None
        if coordinate.ndim:
            (dim,) = coordinate.dims
            is_one = name == dim and not is_several(value)
            dataset = dataset.isel({dim: int(where[0]) if is_one else where})
    return dataset
