"""The inputs of a report."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import xarray as xr

from gapsweep.report.verdicts import Contact, contacts


@dataclass(frozen=True, eq=False)
class Inputs:
    """Files of a run by name without suffix: datasets, and the contents of JSON files."""

    responses: xr.Dataset
    timing: xr.Dataset
    agreement: xr.Dataset | None = None  # None if the exact law was not computed
    attractors: xr.Dataset | None = None
    advice: xr.Dataset | None = None  # present if ``auto`` is a representation
    # Force errors, and the parameter of tanh from which on it has no false well.
    static: xr.Dataset | None = None
    # `work_precision`, `stability`: results of the benchmark.
    work_precision: xr.Dataset | None = None
    stability: xr.Dataset | None = None
    # `branches`, `curves`: branches of periodic orbits, and curves of their special points.
    branches: xr.Dataset | None = None
    curves: xr.Dataset | None = None
    risk: xr.Dataset | None = None  # present if numbers are uncertain
    fit: xr.Dataset | None = None  # fit to measured sweeps, with the branches of the fitted model
    gradients: xr.Dataset | None = None  # derivatives of the quantities of attractors by parameters
    claims: Mapping[str, Any] | None = None  # ``claims.json``
    # The study's own sections of the report, as in ``sections.json``.
    sections: Sequence[Mapping[str, Any]] | None = None

    @cached_property
    def cases(self) -> list[Contact]:
        """Cases of the study with the verdicts on its laws; empty without the exact law."""
        if self.agreement is None:
            return []
        return contacts(self.agreement, self.static)
