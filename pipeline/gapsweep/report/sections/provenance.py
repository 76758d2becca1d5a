"""Provenance of a run for its report: study, solver, machine, CPU time."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, fields
from typing import Any

from gapsweep.integrate.problem import Solver
from gapsweep.report.inputs import Inputs
from gapsweep.report.parts import Part
from gapsweep.report.scales import plain
from gapsweep.status import Status


def sections(inputs: Inputs) -> Iterator[Part]:
    """The provenance of a run as pairs of name and text, its settings, and how to cite it."""
    responses = inputs.responses
    attributes = responses.attrs
    asked = responses["status"].values != Status.NOT_REQUESTED
    seconds = float(responses["cpu_time"].where(asked).sum())
    versions = json.loads(attributes["versions"])
    study = json.loads(attributes["study_json"])
    usual, protocols = study.get("solver", {}), study.get("protocol", {})
    pairs = [
        ("Study", attributes["study"]),
        ("Solver", _solver(usual)),
        *((f"Solver of @{name}", _solver(usual, own)) for name, own in protocols.items()),
        ("Created", attributes["created"]),
        ("Processor time", f"{seconds / 60.0:.3g} min for {asked.sum()} sweep points"),
        ("Numerics fingerprint", attributes["numerics_fingerprint"]),
        ("Machine", f"{attributes['host']} ({attributes['machine']})"),
        ("Versions", ", ".join(f"{name} {number}" for name, number in versions.items())),
    ]
    cited = (
        f"gapsweep {versions.get('gapsweep', '')}, study {attributes['study']}, numerics "
        f"fingerprint {attributes['numerics_fingerprint']}: parameter studies of oscillators with "
        "freeplay."
    )
    settings = json.dumps(study, indent=2, ensure_ascii=False)
    content = {"pairs": pairs, "settings": settings, "cited": cited}
    yield Part("provenance", "Provenance", [], content=content)


def _solver(*tables: Mapping[str, Any]) -> str:
    """All settings of a solver in words; later tables override earlier ones and the defaults."""
    unset = "start_jitter", 0.0
    given = dict(item for table in tables for item in table.items() if item != unset)
    own = {each.name: given.pop(each.name) for each in fields(Solver) if each.name in given}
    settings = asdict(Solver.of(**own)) | given  # with settings of no Solver, as start_jitter
    settings["atol"] = settings["atol"] or "rtol × static deflection"
    shown = {name: value for name, value in settings.items() if value}
    return ", ".join(
        f"{name} {plain(value) if isinstance(value, float) else value}"
        for name, value in shown.items()
    )
