"""Datasets as tables: one row per sweep point, lists left out."""

from typing import Any

import numpy as np
import xarray as xr

from gapsweep.status import Status
from gapsweep.study.grid import CONTACT, COORDINATE


def to_dataframe(dataset: xr.Dataset) -> Any:
    """Values of a dataset's sweep points, as a `pandas.DataFrame`.

    Parameters
    ----------
    dataset : Dataset
        As ``responses.nc``, or a part of it.

    Returns
    -------
    DataFrame
        Columns are dimensions, then variables with one value per point; values of every coordinate
        or contact of a system have their own, as ``x_max[h]``. Flags are words. Cells that are no
        sweep point are left out.
    """
    frame = _in_words(xr.Dataset(_per_point(dataset))).to_dataframe().reset_index()
    return frame[frame["status"] != Status.NOT_REQUESTED.label]


def _per_point(dataset: xr.Dataset) -> dict[str, xr.DataArray]:
    """The variables that have one value per point, and those of every coordinate or contact."""
    points = dataset["status"].dims
    starts = [name for name, held in dataset.coords.items() if held.ndim > 1]
    columns: dict[str, xr.DataArray] = {}
    for name, variable in dataset.drop_vars(starts).data_vars.items():
        if variable.dims == points:
            columns[str(name)] = variable
        elif variable.dims[:-1] == points and variable.dims[-1] in (COORDINATE, CONTACT):
            for part in variable.transpose(variable.dims[-1], ...):
                of = part[variable.dims[-1]].item()
                columns[f"{name}[{of}]"] = part.drop_vars(variable.dims[-1])
    return columns


def _in_words(dataset: xr.Dataset) -> xr.Dataset:
    words = {}
    for name, variable in dataset.data_vars.items():
        if "flag_meanings" in variable.attrs:
            meanings = variable.attrs["flag_meanings"].split()
            values = np.atleast_1d(variable.attrs["flag_values"]).tolist()
            known = dict(zip(values, meanings, strict=True))
            text = [known.get(value, "") for value in variable.values.ravel().tolist()]
            words[name] = (variable.dims, np.array(text, dtype=object).reshape(variable.shape))
    return dataset.assign(words)
