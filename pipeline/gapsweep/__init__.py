"""gapsweep: simulation and parameter studies of mechanical systems with freeplay."""

import importlib
import re
from pathlib import Path
from typing import Any

# Module and name of every public name, from the type stub. numba, Dask, xarray and matplotlib take
# seconds to import; each is imported at first use.
_STUB = Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")
_IMPORT = re.compile(r"^(?:from (\S+) )?import (\S+) as (\S+)$", re.MULTILINE)
_PUBLIC = {public: (module, name) for module, name, public in _IMPORT.findall(_STUB)}
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
# These return datasets; importing one of them registers the accessor ``ds.gapsweep``.
_RETURN_DATASETS = (
    *("basins", "branches", "gradient", "open", "query", "risk", "run"),
    *("special_curve", "special_gradient"),
)

__all__ = sorted(_PUBLIC)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version("gapsweep")
    if name not in _PUBLIC:
        remedy = f"; use {_ELSEWHERE[name]}" if name in _ELSEWHERE else ""
        if not remedy and not name.startswith("_"):
            close = importlib.import_module("difflib").get_close_matches(name, __all__, n=1)
            remedy = f"; did you mean {close[0]}?" if close else ""
        raise AttributeError(f"module 'gapsweep' has no attribute {name!r}{remedy}")
    if name in _RETURN_DATASETS:
        importlib.import_module("gapsweep.report.accessor")
    module, own = _PUBLIC[name]
    found = importlib.import_module(module or own)
    return getattr(found, own) if module else found
