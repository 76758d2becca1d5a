"""gapsweep: simulation and parameter studies of mechanical systems with freeplay."""

import importlib
from typing import TYPE_CHECKING, Any

from gapsweep.errors import (
    ClusterError,
    DatasetError,
    GapsweepError,
    ModelError,
    StoreError,
    StudyError,
)
from gapsweep.model.oscillator import Gap, Oscillator
from gapsweep.status import Status

if TYPE_CHECKING:
    from gapsweep.analysis.datasets.basins import basins
    from gapsweep.analysis.datasets.contact_errors import static_error
    from gapsweep.continuation.curves import special_curve
    from gapsweep.continuation.follow import branches
    from gapsweep.continuation.gradient import gradient
    from gapsweep.continuation.special_gradient import special_gradient
    from gapsweep.design.choose import Choice, choose
    from gapsweep.design.demands import (
        Demand,
        at_least,
        at_most,
        no_chaos,
        no_contact,
        periodic,
    )
    from gapsweep.design.fit import Fit, fit
    from gapsweep.explorer.widget import explore
    from gapsweep.integrate.simulate import simulate
    from gapsweep.integrate.trajectory import SystemTrajectory, Trajectory
    from gapsweep.model import systems
    from gapsweep.model.contact import ContactLaw, HuntCrossley, Piecewise, Rigid
    from gapsweep.model.labels import canonical_label, contact_law, law
    from gapsweep.model.laws.arctan import Arctan
    from gapsweep.model.laws.fitted import Polynomial, RationalPolynomial
    from gapsweep.model.laws.logarctan import LogArctan
    from gapsweep.model.laws.tanh import Tanh
    from gapsweep.model.system import (
        BaseMotion,
        Cubic,
        Harmonic,
        Lags,
        Modulation,
        System,
        Unbalance,
    )
    from gapsweep.model.table import ForceTable
    from gapsweep.model.user_law import UserLaw
    from gapsweep.model.waves import PeriodicForce, Record, Switched
    from gapsweep.pipeline import plan, query, risk, run
    from gapsweep.report.model_figures import frequency_response
    from gapsweep.report.model_figures import parameter_map as map
    from gapsweep.report.motion import plot
    from gapsweep.response.absolute import absolute_range
    from gapsweep.response.respond import respond
    from gapsweep.response.result import Response, ResponseClass, Steady
    from gapsweep.store.netcdf import read as open
    from gapsweep.study.least_model import advise
    from gapsweep.study.study import Study

# numba, Dask, xarray and matplotlib take seconds to import; each is imported at first use.
_ON_DEMAND = {
    **dict.fromkeys(("Response", "ResponseClass", "Steady"), "response.result"),
    **dict.fromkeys(("canonical_label", "contact_law", "law"), "model.labels"),
    **dict.fromkeys(("Arctan", "LogArctan", "Piecewise", "Polynomial"), "model.laws"),
    **dict.fromkeys(("RationalPolynomial", "Tanh"), "model.laws"),
    **dict.fromkeys(("ContactLaw", "HuntCrossley", "Rigid"), "model.contact"),
    **dict.fromkeys(("BaseMotion", "Cubic", "Harmonic", "Lags"), "model.system"),
    **dict.fromkeys(("Modulation", "System", "Unbalance"), "model.system"),
    **dict.fromkeys(("SystemTrajectory", "Trajectory"), "integrate.trajectory"),
    **dict.fromkeys(("plan", "query", "risk", "run"), "pipeline"),
    **dict.fromkeys(("Choice", "choose"), "design.choose"),
    **dict.fromkeys(("Demand", "at_least", "at_most"), "design.demands"),
    **dict.fromkeys(("no_chaos", "no_contact", "periodic"), "design.demands"),
    **dict.fromkeys(("Fit", "fit"), "design.fit"),
    "ForceTable": "model.table",
    **dict.fromkeys(("PeriodicForce", "Record", "Switched"), "model.waves"),
    "UserLaw": "model.user_law",
    "Study": "study.study",
    "advise": "study.least_model",
    "absolute_range": "response.absolute",
    "basins": "analysis.datasets.basins",
    "branches": "continuation.follow",
    "explore": "explorer.widget",
    "frequency_response": "report.model_figures",
    "gradient": "continuation.gradient",
    "map": "report.model_figures",
    "open": "store.netcdf",
    "plot": "report.motion",
    "respond": "response.respond",
    "simulate": "integrate.simulate",
    "special_curve": "continuation.curves",
    "special_gradient": "continuation.special_gradient",
    "static_error": "analysis.datasets.contact_errors",
    "systems": "model.systems",
}
# Names of functions that differ here, to keep Python's own names free elsewhere.
_NAMES = {"map": "parameter_map", "open": "read"}
# Names that users of other software try, and what they find here.
_ELSEWHERE = {
    "attractors": "gs.basins(...), or attractors.nc of a study with several initial conditions",
    "basin": "gs.basins(...)",
    "bifurcation": "ds.gapsweep.bifurcation() of a dataset, as from gs.query(...)",
    "continuation": "gs.branches(...)",
    "floquet": "gs.respond(...).multipliers",
    "integrate": "gs.simulate(...)",
    "load": "gs.open(...)",
    "lyapunov": "gs.respond(...).lyapunov",
    "phase_portrait": "gs.plot(gs.respond(...))",
    "poincare": "gs.respond(...).section, or gs.plot(gs.simulate(...))",
    "read_csv": "gs.ForceTable.from_csv(...)",
    "solve": "gs.simulate(...)",
    "spectrum": "gs.plot(gs.simulate(...)), or [[history]] of a study",
    "steady": "gs.respond(...)",
    "sweep": "gs.frequency_response(...), or initial_condition = 'sweep_up' of a study",
    "time_history": "gs.simulate(...)",
    "to_csv": "ds.gapsweep.to_csv() of a dataset, or gapsweep query --to csv",
}
# Names of modules.
_MODULES = ("systems",)

# These return datasets; importing one of them registers the accessor ``ds.gapsweep``.
_RETURN_DATASETS = (
    *("basins", "branches", "gradient", "open", "query", "risk", "run"),
    *("special_curve", "special_gradient"),
)

__all__ = [
    "Arctan",
    "BaseMotion",
    "Choice",
    "ClusterError",
    "ContactLaw",
    "Cubic",
    "DatasetError",
    "Demand",
    "Fit",
    "ForceTable",
    "Gap",
    "GapsweepError",
    "Harmonic",
    "HuntCrossley",
    "Lags",
    "LogArctan",
    "ModelError",
    "Modulation",
    "Oscillator",
    "PeriodicForce",
    "Piecewise",
    "Polynomial",
    "RationalPolynomial",
    "Record",
    "Response",
    "ResponseClass",
    "Rigid",
    "Status",
    "Steady",
    "StoreError",
    "Study",
    "StudyError",
    "Switched",
    "System",
    "SystemTrajectory",
    "Tanh",
    "Trajectory",
    "Unbalance",
    "UserLaw",
    "absolute_range",
    "advise",
    "at_least",
    "at_most",
    "basins",
    "branches",
    "canonical_label",
    "choose",
    "contact_law",
    "explore",
    "fit",
    "frequency_response",
    "gradient",
    "law",
    "map",
    "no_chaos",
    "no_contact",
    "open",
    "periodic",
    "plan",
    "plot",
    "query",
    "respond",
    "risk",
    "run",
    "simulate",
    "special_curve",
    "special_gradient",
    "static_error",
    "systems",
]


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version("gapsweep")
    if name not in _ON_DEMAND:
        remedy = f"; use {_ELSEWHERE[name]}" if name in _ELSEWHERE else ""
        if not remedy and not name.startswith("_"):
            close = importlib.import_module("difflib").get_close_matches(name, __all__, n=1)
            remedy = f"; did you mean {close[0]}?" if close else ""
        raise AttributeError(f"module 'gapsweep' has no attribute {name!r}{remedy}")
    if name in _RETURN_DATASETS:
        importlib.import_module("gapsweep.report.accessor")
    module = importlib.import_module(f"gapsweep.{_ON_DEMAND[name]}")
    if name in _MODULES:
        return module
    return getattr(module, _NAMES.get(name, name))
