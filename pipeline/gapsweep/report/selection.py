"""Selection of the part of a dataset that a plot shows, with exactly the dimensions it needs."""

from collections.abc import Mapping, Sequence
from typing import Any

import xarray as xr

from gapsweep.analysis.dimensions import selected
from gapsweep.errors import DatasetError
from gapsweep.model.contact import OF_WALLS
from gapsweep.model.oscillator import OSCILLATOR, Gap
from gapsweep.report.scales import shortened
from gapsweep.study.axis_selection import listed
from gapsweep.study.grid import START
from gapsweep.study.schema import PARAMETER

_SHOWN_NAMES = 6
_PLACE = ("K_c", "gap", "j_1", "j_2", "omega", *OSCILLATOR, *OF_WALLS)
_NAMELESS = "response"  # label if a selection has dropped the representation's label


def scene(
    dataset: xr.Dataset, variables: Mapping[str, Sequence[str]], wanted: Mapping[str, Any]
) -> xr.Dataset:
    """Dataset of variables, each over exactly the dimensions that a plot needs.

    Dimensions of one value are dropped, and those that a selection has reduced to a scalar come
    back with one value. Raises `DatasetError` if a variable is missing, or another dimension has
    several values.

    `dataset`: any selection of a dataset.
    `variables`: names of variables, and the dimensions of each.
    `wanted`: coordinates to values, lists or slices; see `selected`.
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
            raise DatasetError(too_many(part, str(dim)))
    shown = xr.Dataset(
        {name: _over(part, name, dims) for name, dims in variables.items()}, attrs=part.attrs
    ).load()
    # A single initial condition needs no name.
    return shown.drop_vars(START, errors="ignore") if dataset.sizes.get(START) == 1 else shown


def _over(part: xr.Dataset, name: str, dims: Sequence[str]) -> xr.DataArray:
    """A variable over all the dimensions, repeated along those that it lacks."""
    missing = [dim for dim in dims if dim not in part[name].dims]
    repeated = {dim: part.sizes[dim] for dim in missing if dim in part.dims}
    absent = [dim for dim in missing if dim not in part.dims]
    return part[name].expand_dims(repeated).expand_dims(absent)


def places(dataset: xr.Dataset) -> list[str]:
    """Names of the parameters of a dataset, without representation and initial condition."""
    # The label of a gap holds both distances.
    walls = ("j_1", "j_2") if "gap" in dataset.coords else ()
    ours = [name for name in _PLACE if name in dataset.coords and name not in walls]
    words = {str(name): held.attrs.get("long_name", "") for name, held in dataset.coords.items()}
    of_system = [name for name, text in words.items() if str(text).startswith(f"{PARAMETER} ")]
    return [*dict.fromkeys(ours + of_system)]


def other_parameters(scene: xr.Dataset) -> list[str]:
    """Parameters with one value, except stiffness and gap."""
    own = {"K_c", "gap", "j_1", "j_2"}
    return [name for name in places(scene) if name not in own and scene[name].ndim == 0]


def gap_label(scene: xr.Dataset) -> str:
    """Text of the wall distances of a parameter set, in mm if they are lengths."""
    if "gap" in scene.coords:
        return shortened(str(scene["gap"].item()))
    if "j_1" not in scene.coords:  # of a system in which every contact has its own
        return ""
    scale = 1.0 if scene["j_1"].attrs.get("units", "m") == "m" else 1e-3
    return shortened(Gap(scale * float(scene["j_1"]), scale * float(scene["j_2"])).label)


def anchor_of(at: Mapping[str, int]) -> str:
    """The id of a parameter set in the page, from its position along the dimensions."""
    return "-".join(["scene", *map(str, at.values())])


def missing_variable(dataset: xr.Dataset, name: str) -> str:
    """Message that a variable is missing, with the file that has it."""
    known = ", ".join(str(variable) for variable in list(dataset.data_vars)[:_SHOWN_NAMES])
    file = next((file for file, names in _FILES.items() if name in names), "")
    remedy = f"; it is in {file}, which gs.open opens" if file else ""
    return f"{name}: no variable of this dataset (it has {known or 'none'}, ...){remedy}"


_FILES = {
    "responses.nc": ("amplitude", "x_max", "extrema", "response_class", "period_multiple"),
    "attractors.nc": ("n_attractors", "basin_share", "section_x", "section_v"),
    "work_precision.nc": ("total_error", "trajectory_error", "cpu_time"),
}


def too_many(part: xr.Dataset, dim: str) -> str:
    """Message that a dimension has several values, with an example of a selection."""
    values = listed(part[dim].values) if dim in part.coords else f"0 to {part.sizes[dim] - 1}"
    one = part[dim].values.tolist()[0]
    example = f"{one:.12g}" if isinstance(one, float | int) else repr(str(one))
    how = f"{dim}={example}" if dim in part.coords else f".isel({dim}=0)"
    return f"{dim}: this plot has room for one value and the dataset has {values}; choose: {how}"
