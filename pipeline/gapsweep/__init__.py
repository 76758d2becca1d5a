"""gapsweep: distributed parameter studies of oscillators with freeplay."""

from importlib.metadata import version

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
from gapsweep.store.netcdf import read as open
from gapsweep.study.study import Study
from gapsweep.workflow import run

__version__ = version("gapsweep")

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
    "canonical_label",
    "contact_law",
    "law",
    "open",
    "respond",
    "run",
    "simulate",
    "static_error",
]
