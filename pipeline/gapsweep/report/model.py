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
