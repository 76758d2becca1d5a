"""Datasets coordinate by coordinate, with a frequency where nothing is forced.

A comparison of representations looks at one displacement: in turn at each coordinate.
"""

from collections.abc import Iterator

import numpy as np
import xarray as xr

from gapsweep.study.grid import COORDINATE, START


def in_metres(responses: xr.Dataset) -> bool:
    """Whether displacements are known to be in metres, and so to be comparable with the gap.

    Coordinates of systems are in a unit of the user's, and a contact feels a combination of them.
    """
    return responses["x_max"].attrs.get("units") == "m"


def by_coordinate(dataset: xr.Dataset) -> Iterator[tuple[xr.Dataset, str]]:
    """A dataset coordinate by coordinate, and the words that name each in a caption."""
    if COORDINATE not in dataset.dims:
        yield dataset, ""
        return
    for i, name in enumerate(dataset[COORDINATE].values.tolist()):
        yield dataset.isel({COORDINATE: i}), f", {name}"


def with_rate(dataset: xr.Dataset, rate: float) -> xr.Dataset:
    """A dataset of unforced responses with a dimension `omega` of one frequency.

    Parameters
    ----------
    dataset : Dataset
        ``responses.nc`` or ``attractors.nc``.
    rate : float
        Section points per second [Hz].
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
    """How often per second unforced periodic responses pass their section."""
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = responses["period_multiple"].values / responses["period"].values
    known = rates[np.isfinite(rates)]
    return float(np.median(known)) if known.size else 1.0
