"""Part of a dataset, selected by coordinate."""

from collections.abc import Mapping
from typing import Any

import xarray as xr

from gapsweep.errors import DatasetError
from gapsweep.study.axis_selection import is_several, positions


def selected(dataset: xr.Dataset, wanted: Mapping[str, Any]) -> xr.Dataset:
    """A selection by any coordinate of one dimension.

    A value of a dimension's own coordinate reduces it to a scalar; lists, slices (both ends
    included) and other coordinates (``start="sweep_up"``) keep the dimension. What is equal, see
    `gapsweep.study.axis_selection`.

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
        try:
            where = positions(name, coordinate.values, value)
        except ValueError as error:
            raise DatasetError(str(error)) from None
        if coordinate.ndim:
            (dim,) = coordinate.dims
            is_one = name == dim and not is_several(value)
            dataset = dataset.isel({dim: int(where[0]) if is_one else where})
    return dataset
