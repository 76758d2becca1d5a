"""The inputs of a report."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import xarray as xr


@dataclass(frozen=True, slots=True, eq=False)
class Inputs:
    """Datasets, claims and user sections as stored in a run's folder.

    Attributes
    ----------
    agreement : Dataset, optional
        None if the exact law was not computed.
    attractors : Dataset, optional
        Drawn at points with several initial conditions.
    advice : Dataset, optional
        Present if ``auto`` is a representation.
    static : Dataset, optional
        Gives the parameter of tanh from which on it has no false well.
    work_precision, stability : Dataset, optional
        For the sections of the benchmark.
    branches : Dataset, optional
        Drawn behind extrema and attractors.
    curves : Dataset, optional
        ``curves.nc``, the curves of special points of the branches.
    claims : mapping, optional
        ``claims.json``.
    own_parts : sequence of mapping
        The sections in ``sections.json``.
    """

    responses: xr.Dataset
    timing: xr.Dataset
    agreement: xr.Dataset | None = None
    attractors: xr.Dataset | None = None
    advice: xr.Dataset | None = None
    static: xr.Dataset | None = None
    work_precision: xr.Dataset | None = None
    stability: xr.Dataset | None = None
    branches: xr.Dataset | None = None
    curves: xr.Dataset | None = None
    claims: Mapping[str, Any] | None = None
    own_parts: Sequence[Mapping[str, Any]] = ()
