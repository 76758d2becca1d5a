"""Where a report comes from: the model, the study, its solver, the machine, what it took."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, fields
from typing import Any

import numpy as np
import xarray as xr

from gapsweep.analysis.systems import is_of_systems
from gapsweep.integrate.problem import Solver
from gapsweep.model.contact import ContactLaw
from gapsweep.model.labels import AUTO, family, is_fitted, law_of
from gapsweep.report.drawing import labels_of
from gapsweep.report.scales import plain, shortened
from gapsweep.status import Status

_EQUATION = "ẍ + 2ζω_n ẋ + ω_n² x + (α x³ + F) / m = (p / m) cos ωt, with ω and ω_n in rad/s"
# Its numbers, in the order in which they are told: symbol and unit.
_NUMBERS = {
    "zeta": ("ζ", ""),
    "omega_n": ("ω_n", "Hz"),
    "mass": ("m", "kg"),
    "alpha": ("α", "N/m³"),
    "forcing": ("p", "N"),
    "K_c": ("K_c", "N/m"),
    "K_ratio": ("lower wall's K_c over that of the upper", ""),
    "omega": ("ω", "Hz"),
}
_MANY = 5  # values of a number, of which more are told by their ends


def model(responses: xr.Dataset) -> list[tuple[str, str]]:
    """The equation of a run, its numbers and its laws, by name; nothing of a run of systems.

    Parameters
    ----------
    responses : Dataset
        As stored in ``responses.nc``.
    """
    if is_of_systems(responses):
        return []
    study = json.loads(responses.attrs["study_json"])
    fixed = study["oscillator"]
    held = {n: responses[n].values if n in responses else fixed.get(n) for n in _NUMBERS}
    told = [
        f"{symbol} {_told(held[name])} {unit}".strip()
        for name, (symbol, unit) in _NUMBERS.items()
        if held[name] is not None
    ]
    gaps = _listed([shortened(str(gap)) for gap in responses["gap"].values])
    told.append(f"walls at −j₁ and j₂: {gaps} mm")
    labels = [label for label in labels_of(responses) if label != AUTO]
    if any(map(is_fitted, labels)):
        told.append(f"fits over ±{1e3 * study['fit']['range']:g} mm")
    return [
        ("Equation", _EQUATION),
        ("Numbers", ", ".join(told)),
        *dict(map(_law, labels)).items(),
    ]


def _told(values: Any) -> str:
    numbers = np.ravel(values)
    return _listed([plain(number) for number in numbers])


def _listed(texts: Sequence[str]) -> str:
    return ", ".join(texts) if len(texts) <= _MANY else f"{texts[0]} to {texts[-1]}"


def _law(label: str) -> tuple[str, str]:
    """What the force is, under the name of the law's family or of the user's function."""
    law = family(label)
    if law is None:
        return f"F of {law_of(label)}", ContactLaw.formula
    return f"F of {law.family}", law.formula


def provenance(responses: xr.Dataset) -> list[tuple[str, str]]:
    """Facts about a run, by name.

    Parameters
    ----------
    responses : Dataset
        As stored in ``responses.nc``.
    """
    attributes = responses.attrs
    asked = responses["status"].values != Status.NOT_REQUESTED
    seconds = float(responses["cpu_time"].where(asked).sum())
    versions = json.loads(attributes["versions"]).items()
    study = json.loads(attributes["study_json"])
    usual, protocols = study.get("solver", {}), study.get("protocol", {})
    return [
        ("Study", attributes["study"]),
        ("Solver", _solver(usual)),
        *((f"Solver of @{name}", _solver(usual, own)) for name, own in protocols.items()),
        ("Created", attributes["created"]),
        ("Processor time", f"{seconds / 60.0:.3g} min for {asked.sum()} sweep points"),
        ("Numerics fingerprint", attributes["numerics_fingerprint"]),
        ("Machine", f"{attributes['host']} ({attributes['machine']})"),
        ("Versions", ", ".join(f"{name} {number}" for name, number in versions)),
    ]


def _solver(*tables: Mapping[str, Any]) -> str:
    """All settings of a solver: what later tables give, then earlier ones, then the defaults."""
    unset = "start_jitter", 0.0
    given = dict(item for table in tables for item in table.items() if item != unset)
    own = {each.name: given.pop(each.name) for each in fields(Solver) if each.name in given}
    settings = asdict(Solver.of(**own)) | given  # what is no solver's own: how starts are moved
    shown = {name: value for name, value in settings.items() if value}
    return ", ".join(
        f"{name} {plain(value) if isinstance(value, float) else value}"
        for name, value in shown.items()
    )


def as_toml(study: Mapping[str, Any]) -> str:
    """A study as TOML, which makes the same study again.

    Parameters
    ----------
    study : mapping
        What attribute ``study_json`` of a dataset holds.
    """
    return "\n\n".join(block for name in study for block in _blocks(name, study[name]))


def _blocks(name: str, table: Any) -> Iterator[str]:
    """Its tables; a list holds one after the other."""
    head = f"[[{name}]]" if isinstance(table, list) else f"[{name}]"
    for one in table if isinstance(table, list) else [table]:
        rows = (f"{_key(key)} = {_value(value)}" for key, value in one.items() if value is not None)
        yield "\n".join([head, *rows])


def _key(name: str) -> str:
    """A key as TOML writes it: bare if it may be."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)


def _value(value: Any) -> str:
    """A value as TOML writes it, which is JSON but for tables."""
    if isinstance(value, Mapping):
        inside = (f"{_key(key)} = {_value(held)}" for key, held in value.items())
        return f"{{ {', '.join(inside)} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    return json.dumps(value, ensure_ascii=False)
