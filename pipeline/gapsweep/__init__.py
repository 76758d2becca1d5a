"""gapsweep: distributed parameter studies of oscillators with freeplay."""

import importlib
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from gapsweep.errors import ClusterError, GapsweepError, ModelError, StoreError, StudyError
from gapsweep.integrate.simulate import simulate
from gapsweep.integrate.trajectory import Trajectory
from gapsweep.model.contact import (
    Arctan,
    ContactLaw,
    LogArctan,
    Piecewise,
    Polynomial,
    RationalPolynomial,
    Tanh,
    UserLaw,
    static_error,
)
from gapsweep.model.labels import canonical_label, contact_law, law
from gapsweep.model.oscillator import Gap, Oscillator
from gapsweep.response.respond import Response, ResponseClass, Steady, respond
from gapsweep.status import Status

if TYPE_CHECKING:
    from gapsweep.analysis.basins import basins
    from gapsweep.store.netcdf import read as open
    from gapsweep.study.study import Study
    from gapsweep.workflow import run

__version__ = version("gapsweep")

# Studies bring Dask, xarray and matplotlib; whoever only simulates need not wait for them.
_ON_DEMAND = {
    "Study": ("gapsweep.study.study", "Study"),
    "basins": ("gapsweep.analysis.basins", "basins"),
    "open": ("gapsweep.store.netcdf", "read"),
    "run": ("gapsweep.workflow", "run"),
}

__all__ = [
    "Arctan",
    "ClusterError",
    "ContactLaw",
    "Gap",
    "GapsweepError",
    "LogArctan",
    "ModelError",
    "Oscillator",
    "Piecewise",
    "Polynomial",
    "RationalPolynomial",
    "Response",
    "ResponseClass",
    "Status",
    "Steady",
    "StoreError",
    "Study",
    "StudyError",
    "Tanh",
    "Trajectory",
    "UserLaw",
    "basins",
    "canonical_label",
    "contact_law",
    "law",
    "open",
    "respond",
    "run",
    "simulate",
    "static_error",
]


def __getattr__(name: str) -> Any:
    if name not in _ON_DEMAND:
        raise AttributeError(f"module 'gapsweep' has no attribute {name!r}")
    module, attribute = _ON_DEMAND[name]
    return getattr(importlib.import_module(module), attribute)
