"""Datasets of systems, coordinate by coordinate, as those of an oscillator.

What compares representations looks at one displacement: of a system it looks at each of its
coordinates in turn.
"""

from collections.abc import Iterator

import numpy as np
import xarray as xr

from gapsweep.study.grid import CONTACT, COORDINATE, LAG, START

OF_SYSTEM = "of_system"  # attribute of what was taken from a system


def is_of_systems(dataset: xr.Dataset) -> bool:
    """Whether a dataset of a run is one of systems."""
    return COORDINATE in dataset.dims or OF_SYSTEM in dataset.attrs


def by_coordinate(dataset: xr.Dataset) -> Iterator[tuple[xr.Dataset, str]]:
    """A dataset of systems coordinate by coordinate, and what to say of which; others whole."""
    if COORDINATE not in dataset.dims:
        yield dataset, ""
        return
    for i, name in enumerate(dataset[COORDINATE].values.tolist()):
        yield dataset.isel({COORDINATE: i}), f", {name}"


def of_coordinate(dataset: xr.Dataset, number: int, rate: float) -> xr.Dataset:
    """The dataset of one coordinate, named as an oscillator's.

    Parameters
    ----------
    dataset : Dataset
        ``responses.nc`` or ``attractors.nc`` of systems.
    number : int
        Of the coordinate.
    rate : float
        Section points per second: what stands for `omega` where nothing is forced [Hz].
    """
    names = [name for name in dataset.variables if {CONTACT, LAG} & {*dataset[name].dims}]
    found = dataset.drop_vars(names).isel({COORDINATE: number}, drop=True)
    if "q_0" in found.coords:
        found = found.rename(q_0="x_0")
    if "omega" not in dataset.dims:
        at = list(found["response_class"].dims)
        axis = at.index(START) if START in at else len(at) - 1
        forced = {
            name: found[name].expand_dims(omega=[rate], axis=axis)
            for name in found.data_vars
            if {*at[:axis]} <= {*found[name].dims}
        }
        found = found.assign(forced)
    return found.assign_attrs({**dataset.attrs, OF_SYSTEM: 1})


def section_rate(responses: xr.Dataset) -> float:
    """How often per second the periodic responses that nothing forces pass their section."""
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = responses["period_multiple"].values / responses["period"].values
    known = rates[np.isfinite(rates)]
    return float(np.median(known)) if known.size else 1.0
