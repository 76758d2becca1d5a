"""The part of a dataset that a plot shows: selected by coordinate, with the dimensions it needs."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.errors import DatasetError, ModelError
from gapsweep.model.labels import canonical_label
from gapsweep.study.points import canonical

SHOWN_VALUES = 6
_NAMELESS = "response"  # where a selection has dropped the representation's label


def scene(
    dataset: xr.Dataset, variables: Mapping[str, Sequence[str]], wanted: Mapping[str, Any]
) -> xr.Dataset:
    """Variables, each over exactly the dimensions that a plot has room for.

    Dimensions of one value are dropped, and those that a selection has reduced to a scalar come
    back with one value.

    Parameters
    ----------
    dataset : Dataset
        Any selection of a dataset.
    variables : mapping of str to sequence of str
        What is drawn, and over which dimensions.
    wanted : mapping
        Coordinates to values, lists or slices; see `selected`.

    Raises
    ------
    DatasetError
        If a variable is missing, or a dimension is left that must be reduced to one value.
    """
    for name in variables:
        if name not in dataset.data_vars:
            raise DatasetError(missing_variable(dataset, name))
    part = selected(dataset, wanted)[list(variables)]
    needed = {dim for dims in variables.values() for dim in dims}
    if "representation" in needed and "representation" not in part.coords:
        part = part.assign_coords(representation=_NAMELESS)
    part = part.squeeze([dim for dim in part.dims if dim not in needed and part.sizes[dim] == 1])
    for dim in part.dims:
        if dim not in needed:
            raise DatasetError(_too_many(part, str(dim)))
    return xr.Dataset(
        {name: _over(part, name, dims) for name, dims in variables.items()}, attrs=part.attrs
    ).load()


def _over(part: xr.Dataset, name: str, dims: Sequence[str]) -> xr.DataArray:
    """A variable over all the dimensions; repeated along those that only others have."""
    missing = [dim for dim in dims if dim not in part[name].dims]
    repeated = {dim: part.sizes[dim] for dim in missing if dim in part.dims}
    alone = [dim for dim in missing if dim not in part.dims]
    return part[name].expand_dims(repeated).expand_dims(alone)


def selected(dataset: xr.Dataset, wanted: Mapping[str, Any]) -> xr.Dataset:
    """A selection by any coordinate of one dimension.

    A value of a dimension's own coordinate reduces it to a scalar; lists, slices (both ends
    included) and other coordinates (``start="sweep_up"``) keep the dimension. Numbers are
    compared after rounding to 12 significant digits.

    Raises
    ------
    DatasetError
        If a name is no coordinate or nothing has the value.
    """
    for name, value in wanted.items():
        if name not in dataset.coords:
            known = ", ".join(str(coordinate) for coordinate in dataset.coords)
            raise DatasetError(f"{name}: no coordinate of this dataset; it has {known}")
        coordinate = dataset[name]
        matches = _matches(name, coordinate, value)
        if coordinate.ndim:
            (dim,) = coordinate.dims
            where = np.flatnonzero(matches)
            is_one = name == dim and not isinstance(value, (list, tuple, slice, np.ndarray))
            dataset = dataset.isel({dim: int(where[0]) if is_one else where})
    return dataset


def missing_variable(dataset: xr.Dataset, name: str) -> str:
    """Why a variable cannot be drawn, and where it is."""
    known = ", ".join(str(variable) for variable in list(dataset.data_vars)[:SHOWN_VALUES])
    file = next((file for file, names in _FILES.items() if name in names), "")
    remedy = f"; it is in {file}, which gs.open opens" if file else ""
    return f"{name}: no variable of this dataset (it has {known or 'none'}, ...){remedy}"


_FILES = {
    "responses.nc": ("amplitude", "x_max", "extrema", "response_class"),
    "attractors.nc": ("basin_share", "section_x", "section_v"),
    "work_precision.nc": ("trajectory_error", "cpu_time"),
}


def _matches(name: str, coordinate: xr.DataArray, value: Any) -> NDArray[np.bool_]:
    """Which values of a coordinate are wanted; every wanted one must be there."""
    held = np.atleast_1d(coordinate.values)
    if isinstance(value, slice):
        if held.dtype.kind not in "iuf":
            raise DatasetError(f"{name}: holds text, which has no range; give a list instead")
        low = -np.inf if value.start is None else canonical(value.start)
        high = np.inf if value.stop is None else canonical(value.stop)
        matches = (held >= low) & (held <= high)
        absent = [] if matches.any() else [value]
    else:
        values = value if isinstance(value, (list, tuple, np.ndarray)) else [value]
        each = [held == _canonical(name, one, held) for one in values]
        matches = np.logical_or.reduce(each, axis=0) if each else np.zeros(held.shape, bool)
        absent = [one for one, found in zip(values, each, strict=True) if not found.any()]
    if absent or not matches.any():
        missing = ", ".join(map(repr, absent)) or "nothing"
        raise DatasetError(f"{name} = {missing}: not in this dataset; it has {listed(coordinate)}")
    return matches


def _canonical(name: str, value: Any, held: NDArray[Any]) -> Any:
    if held.dtype.kind in "iuf" and not isinstance(value, str):
        return canonical(value)
    if name == "representation":
        label, at, protocol = str(value).partition("@")
        try:
            return canonical_label(label) + at + protocol
        except ModelError as error:
            raise DatasetError(str(error)) from None
    return value


def _too_many(part: xr.Dataset, dim: str) -> str:
    values = listed(part[dim]) if dim in part.coords else f"0 to {part.sizes[dim] - 1}"
    one = part[dim].values[0]
    example = f"{one:g}" if isinstance(one, float) else repr(str(one))
    how = f"{dim}={example}" if dim in part.coords else f".isel({dim}=0)"
    return f"{dim}: this plot has room for one value and the dataset has {values}; choose: {how}"


def listed(coordinate: xr.DataArray) -> str:
    """The first values of a coordinate, and how many more there are."""
    words = as_words(np.atleast_1d(coordinate.values))
    more = len(words) - SHOWN_VALUES
    return ", ".join(words[:SHOWN_VALUES]) + (f" and {more} more" if more > 0 else "")


def as_words(values: NDArray[Any]) -> list[str]:
    """Values as they are printed."""
    return [f"{v:g}" if isinstance(v, float) else str(v) for v in values.tolist()]
