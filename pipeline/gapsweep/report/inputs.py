"""The inputs of a report."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import xarray as xr

from gapsweep.report.verdicts import Contact, contacts


@dataclass(frozen=True, eq=False)
class Inputs:
    """Files of a run by name without suffix: datasets, and the contents of JSON files.

    Attributes
    ----------
    responses, timing : Dataset
    agreement : Dataset, optional
        None if the exact law was not computed.
    attractors : Dataset, optional
    advice : Dataset, optional
        Present if ``auto`` is a representation.
    static : Dataset, optional
        Force errors, and the parameter of tanh from which on it has no false well.
    work_precision, stability : Dataset, optional
        Results of the benchmark.
    branches, curves : Dataset, optional
        Branches of periodic orbits, and curves of their special points.
    risk : Dataset, optional
        Present if numbers are uncertain.
    fit : Dataset, optional
        Fit to measured sweeps, with the branches of the fitted model.
    gradients : Dataset, optional
        Derivatives of the quantities of attractors by parameters.
    claims : mapping, optional
        ``claims.json``.
    sections : sequence of mapping, optional
        The study's own sections of the report, as in ``sections.json``.
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
    risk: xr.Dataset | None = None
    fit: xr.Dataset | None = None
    gradients: xr.Dataset | None = None
    claims: Mapping[str, Any] | None = None
    sections: Sequence[Mapping[str, Any]] | None = None

    @cached_property
    def cases(self) -> list[Contact]:
        """Cases of the study with the verdicts on its laws; empty without the exact law."""
        if self.agreement is None:
            return []
        return contacts(self.agreement, self.static)
