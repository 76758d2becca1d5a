"""The model of a run, as a report tells it: its equation, its numbers, the forces of its laws."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from gapsweep.analysis.systems import is_of_systems
from gapsweep.model.labels import AUTO, family, is_fitted, law_of
from gapsweep.report.drawing import labels_of
from gapsweep.report.scales import plain, shortened

_EQUATION = "ẍ + 2ζω_n ẋ + ω_n² x + (α x³ + F) / m = (p / m) cos ωt, with ω and ω_n in rad/s"
# Its numbers, in the order in which they are told: symbol and unit.
_NUMBERS = {
    "zeta": ("ζ", ""),
    "omega_n": ("ω_n", "Hz"),
    "mass": ("m", "kg"),
    "alpha": ("α", "N/m³"),
    "forcing": ("p", "N"),
    "K_c": ("K_c", "N/m"),
    "K_ratio": ("r", "(lower wall's stiffness over K_c)"),
    "omega": ("ω", "Hz"),
}
_FORCES = {
    "piecewise": "K_c (x − j₂) for x > j₂, r K_c (x + j₁) for x < −j₁, 0 between; of -noevents "
    "too, whose contacts are not located",
    "poly": "polynomial of the degree in its name, a least-squares fit",
    "ratpoly": "quotient of polynomials of the degrees in its name, a least-squares fit",
    "tanh": "½ K_c [r (1 − s₁) (x + j₁) + (1 + s₂) (x − j₂)], s₁ = tanh ε(x + j₁), "
    "s₂ = tanh ε(x − j₂), ε [1/m] in its name",
    "arctan": "½ K_c [r (1 − s₁) (x + j₁) + (1 + s₂) (x − j₂)], s₁ = (2/π) arctan ε(x + j₁), "
    "s₂ = (2/π) arctan ε(x − j₂), ε [1/m] in its name",
    "logarctan": "0 at x = 0, of slope ½ K_c [r (1 − s₁) + 1 + s₂], s₁ = (2/π) arctan γ(x + j₁), "
    "s₂ = (2/π) arctan γ(x − j₂), γ [1/m] in its name",
}
_EQUATION_OF_SYSTEMS = "M q̈ + C q̇ + K q + Σ α (a·q)³ a + Σ F(b·q) b = loads"
_EQUATION_OF_LAGS = " − D z, ż = E q̇ + G q + H z"
_MATRICES = {"mass": "M", "damping": "C", "stiffness": "K"}
_OF_LAGS = {"force": "D", "of_speed": "E", "of_place": "G", "of_lags": "H"}
_MANY = 5  # values of a number, of which more are told by their ends


def model(responses: xr.Dataset) -> list[tuple[str, str]]:
    """The equation of a run, its numbers and its laws, by name.

    Parameters
    ----------
    responses : Dataset
        As stored in ``responses.nc``.
    """
    if is_of_systems(responses):
        return _system(responses)
    study = json.loads(responses.attrs["study_json"])
    fixed = {"K_ratio": 1.0} | study["oscillator"]
    held = {n: responses[n].values if n in responses else fixed[n] for n in _NUMBERS}
    told = [
        f"{symbol} {_told(held[name])} {unit}".strip() for name, (symbol, unit) in _NUMBERS.items()
    ]
    told.append(_walls(responses))
    labels = [label for label in labels_of(responses) if label != AUTO]
    if any(map(is_fitted, labels)):
        told.append(f"fits over ±{1e3 * study['fit']['range']:g} mm")
    return [
        ("Equation", _EQUATION),
        ("Numbers", ", ".join(told)),
        *dict(map(_law, labels)).items(),
    ]


def _system(responses: xr.Dataset) -> list[tuple[str, str]]:
    """Of systems the one at the values in [parameters]; the walls of its contacts in their unit."""
    held, study = (json.loads(responses.attrs[f"{name}_json"]) for name in ("system", "study"))
    at = ", ".join(f"{name} = {plain(value)}" for name, value in study["parameters"].items())
    told = [
        (f"{symbol}{f' at {at}' if at else ''}", _rows(held[name]))
        for name, symbol in _MATRICES.items()
    ]
    lags = held["lags"] or {}
    told += [(symbol, _rows(lags[name])) for name, symbol in _OF_LAGS.items() if lags]
    told += [(f"b of {name}", _rows(along)) for name, along in held["contacts"].items()]
    told += [("a, α", f"{_rows(each['along'])}, {plain(each['alpha'])}") for each in held["cubic"]]
    for load in held["forcing"]:
        size = f"{_rows(load['amplitude'])}{' (2πkω)²' if load['inertial'] else ''}"
        told.append(("Load", f"{size}{_turning(load)}"))
    for name, terms in held["modulation"].items():
        parts = (f"{plain(term['depth'])}{_turning(term)}" for term in terms)
        told.append((f"F of {name}", f"times 1 + {' + '.join(parts)}"))
    told += [(_NUMBERS["K_c"][0], _told(responses["K_c"].values))] if "K_c" in responses else []
    if "gap" in responses:
        gaps = _listed([shortened(str(gap)) for gap in responses["gap"].values])
        told.append(("j₁/j₂", gaps))
    equation = _EQUATION_OF_SYSTEMS + (_EQUATION_OF_LAGS if lags else "")
    labels = [label for label in labels_of(responses) if label != AUTO]
    names = ", ".join(held["coordinates"])
    return [
        ("Equation", f"{equation}; x = b·q, q = ({names})"),
        *told,
        *dict(map(_law, labels)).items(),
    ]


def _turning(term: Any) -> str:
    """The cosine that a load or a modulation is multiplied by; of a constant one nothing."""
    phase = f" + {plain(term['phase'])}" if term["phase"] else ""
    return f" cos({term['k']}·2πωt{phase})" if term["k"] or phase else ""


def _rows(numbers: Any) -> str:
    """Numbers of a vector or of a matrix, row by row."""
    if numbers and isinstance(numbers[0], list):
        return f"[{', '.join(map(_rows, numbers))}]"
    return f"[{', '.join(plain(number + 0.0) for number in numbers)}]"  # -0.0 as 0


def _walls(responses: xr.Dataset) -> str:
    """Where the walls are; their distances stand in place of the gap where these are swept."""
    if "gap" in responses:
        gaps = _listed([shortened(str(gap)) for gap in responses["gap"].values])
        return f"walls at −j₁ and j₂: {gaps} mm"
    j_1, j_2 = (_told(1e3 * responses[name].values) for name in ("j_1", "j_2"))
    return f"walls at −j₁ and j₂: j₁ {j_1} mm, j₂ {j_2} mm"


def _told(values: Any) -> str:
    return _listed([plain(number) for number in np.ravel(values)])


def _listed(texts: Sequence[str]) -> str:
    return ", ".join(texts) if len(texts) <= _MANY else f"{texts[0]} to {texts[-1]}"


def _law(label: str) -> tuple[str, str]:
    """What the force is, under the name of the law's family or of the user's function."""
    law = family(label)
    if law is None:
        return f"F of {law_of(label)}", "the user's own"
    return f"F of {law.family}", _FORCES[law.family]
