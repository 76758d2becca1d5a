"""The inputs of a report."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import xarray as xr


@dataclass(frozen=True, slots=True, eq=False)
class Inputs:
    """Datasets as stored in a run's folder, by their files, its claims and its own sections.

    Attributes
    ----------
    agreement : Dataset, optional
        None if the exact law was not computed.
    attractors : Dataset, optional
        Drawn where there are several initial conditions.
    advice : Dataset, optional
        Where ``auto`` is a representation.
    static : Dataset, optional
        Says from which parameter on tanh has no false well.
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
