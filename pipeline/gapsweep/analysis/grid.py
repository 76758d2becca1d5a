"""The dimensions of a run's datasets: which ones a scene has, and how all scenes are gone over.

A scene is all that is swept at one stiffness, gap and further parameters: every dimension but the
representation, the frequency and the start is one of scenes.
"""

from collections.abc import Hashable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr

from gapsweep.study.schema import POINT_DIMS

REPRESENTATION, SWEPT = "representation", ("omega", "initial_condition")

At = Mapping[str, int]
# What a dataset says of the study, and of the code behind its points.
_OF_STUDY = (
    "title", "study", "study_json", "system_json", "creator_name", "license",
    "numerics_fingerprint",
)  # fmt: skip


def of_study(responses: xr.Dataset) -> dict[str, Any]:
    """Attributes that a dataset made from responses has from them."""
    return {name: responses.attrs[name] for name in _OF_STUDY if name in responses.attrs}


def swept(values: xr.DataArray) -> list[str]:
    """The dimensions that are swept in a scene: nothing that is not forced has frequencies."""
    return [dim for dim in SWEPT if dim in values.dims]


def point_dims(responses: xr.Dataset) -> tuple[str, ...]:
    """Dimensions of a sweep point, in the order of the file."""
    return tuple(str(dim) for dim in responses["status"].dims)


def scene_dims(dims: Iterable[Hashable]) -> list[str]:
    """Those among a sweep point's dimensions that are of scenes, in their order."""
    return [str(dim) for dim in dims if dim not in (REPRESENTATION, *SWEPT)]


def over(dims: tuple[str, ...], of_points: tuple[str, ...]) -> tuple[str, ...]:
    """Dimensions of a metric in a study, from those in a study of stiffness and gap alone.

    Parameters
    ----------
    dims : tuple of str
        Some of `POINT_DIMS`, and dimensions of the metric's own.
    of_points : tuple of str
        As from `point_dims`.
    """
    left_out = {REPRESENTATION, *SWEPT} - set(dims)
    own = (dim for dim in dims if dim not in POINT_DIMS)
    return (*(dim for dim in of_points if dim not in left_out), *own)


def scenes(dataset: xr.Dataset, dims: Iterable[str]) -> Iterator[dict[str, int]]:
    """Every position along some dimensions, the last one fastest."""
    names = list(dims)
    for position in np.ndindex(*(dataset.sizes[name] for name in names)):
        yield dict(zip(names, position, strict=True))


def cells(dims: Iterable[str], at: At) -> tuple[int | slice, ...]:
    """Where in an array over the dimensions the values at a position lie."""
    return tuple(at.get(dim, slice(None)) for dim in dims)
