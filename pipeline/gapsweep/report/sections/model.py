"""The model section of a report: the equation, its numbers and the forces of the laws."""

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from gapsweep.model.contact import OF_LABELS, OF_WALLS
from gapsweep.report.drawing import labels_of
from gapsweep.report.inputs import Inputs
from gapsweep.report.parts import Part
from gapsweep.report.scales import plain, shortened

_EQUATION = "ẍ + {damping} ẋ + ω_n² x + {force} = {load}{moving}, with ω and ω_n in rad/s"
# Terms of an unbalance and a moving base, and their numbers: shown if there is one.
_MOVING = " + (u / m + a) ω² cos ωt + (1 − s) {damping} a ω sin ωt"
_OF_MOVING = ("unbalance", "base_amplitude", "base_damping")
# Terms that are shown if they are not zero.
_OPTIONAL = ("alpha", "mean_load", "c", "damping", "preload")
# Parameters of the equation in the order of the section: symbol and unit.
_NUMBERS = {
    "zeta": ("ζ", ""),
    "omega_n": ("ω_n", "Hz"),
    "mass": ("m", "kg"),
    "alpha": ("α", "N/m³"),
    "forcing": ("p", "N"),
    "mean_load": ("p₀", "N"),
    "c": ("c", "N s/m"),
    "unbalance": ("u", "kg m"),
    "base_amplitude": ("a", "m"),
    "base_damping": ("s", "(share of the damping at the base)"),
    "K_c": ("K_c", "N/m"),
    "K_ratio": ("r", "(stiffness of the lower wall / K_c)"),
    "damping": ("c_c", "N s/m (of both walls)"),
    "preload": ("N₀", "N (of both walls)"),
    "chi": ("χ", "s/m"),
    "restitution": ("e", ""),
    "omega": ("ω", "Hz"),
}
_RATIO = _NUMBERS["K_ratio"]
_LOSSES = ("damping", "preload", *OF_LABELS)
# Settings that a contact may have separately.
_OWN = {"representation": "", "K_c": "K_c", "gap": "j₁/j₂", "K_ratio": "r"}
_OWN |= {name: _NUMBERS[name][0] for name in _LOSSES}
_EQUATION_OF_SYSTEMS = "M q̈ + C q̇ + K q{cubic} + Σ F(b·q) b = loads"
_EQUATION_OF_LAGS = " − D z, ż = E q̇ + G q + H z"
_MATRICES = {"mass": "M", "damping": "C", "stiffness": "K"}
_OF_LAGS = {"force": "D", "of_speed": "E", "of_place": "G", "of_lags": "H"}
_MANY = 5  # values of a parameter; of more, the first and the last are shown


def sections(inputs: Inputs) -> Iterator[Part]:
    """The equation of a run, its parameters and its contact laws, as pairs of name and text."""
    of_model = _system if "system_json" in inputs.responses.attrs else _oscillator
    pairs = of_model(inputs.responses)
    if inputs.fit is not None:
        pairs.append(
            ("Fit", "the numbers above are those of the study; the section Fit has its own")
        )
    yield Part("model", "Model", [], content={"pairs": pairs})


def _oscillator(responses: xr.Dataset) -> list[tuple[str, str]]:
    """Equation, numbers and contact laws of an oscillator."""
    study = json.loads(responses.attrs["study_json"])
    fixed, wave = {**OF_WALLS, **study["oscillator"]}, list[tuple[str, str]]()
    if isinstance(points := fixed["forcing"], dict):
        forces = points.get("f") or points["levels"]
        fixed["forcing"] = max(map(abs, forces))
        wave = [("Wave", f"in place of the cosine of p: {len(forces)} points in a period")]
    held = {n: responses[n].values if n in responses else fixed[n] for n in _NUMBERS}
    is_moving = bool(np.any(held["unbalance"]) or np.any(held["base_amplitude"]))
    absent = {name for name in _OPTIONAL if not np.any(held[name])}
    absent |= {name for name in OF_LABELS if name not in responses}
    absent |= set() if is_moving else {*_OF_MOVING}
    numbers = [
        f"{symbol} {_text(held[name])} {unit}".strip()
        for name, (symbol, unit) in _NUMBERS.items()
        if name not in absent
    ]
    damping = "2ζω_n" if "c" in absent else "(2ζω_n + c / m)"
    equation = _EQUATION.format(
        damping=damping,
        force="F / m" if "alpha" in absent else "(α x³ + F) / m",
        load="(p / m) cos ωt" if "mean_load" in absent else "(p₀ + p cos ωt) / m",
        moving=_MOVING.format(damping=damping) * is_moving,
    )
    numbers.append(_walls(responses))
    if any(label.is_fitted for label in labels_of(responses)):
        numbers.append(f"fits over ±{1e3 * study['approximation']['range']:g} mm")
    return [
        ("Equation", equation),
        ("Numbers", ", ".join(numbers)),
        *wave,
        *_laws(responses),
    ]


def _system(responses: xr.Dataset) -> list[tuple[str, str]]:
    """Equation, matrices, loads and contacts of a system at the values in [parameters]."""
    held, study = (json.loads(responses.attrs[f"{name}_json"]) for name in ("system", "study"))
    at = ", ".join(
        f"{name} = {plain(value)}" for name, value in study.get("parameters", {}).items()
    )
    rows = [
        (f"{symbol}{f' at {at}' if at else ''}", _rows(held[name]))
        for name, symbol in _MATRICES.items()
    ]
    lags = held["lags"] or {}
    rows += [(symbol, _rows(lags[name])) for name, symbol in _OF_LAGS.items() if lags]
    rows += [(f"b of {name}", _rows(along)) for name, along in held["contacts"].items()]
    rows += [("a, α", f"{_rows(each['along'])}, {plain(each['alpha'])}") for each in held["cubic"]]
    for load in held["forcing"]:
        if wave := load.get("wave"):
            amplitude = np.multiply(load["peak"], load["along"])
            pieces = f"{len(wave['ends'])} pieces in a period"
            rows.append(("Load", f"{_rows(amplitude.tolist())} times {pieces}"))
            continue
        growth = f" ({_rate(load)}){'²' * (load['power'] == 2)}" if load["power"] else ""
        rows.append(("Load", f"{_rows(load['amplitude'])}{growth}{_turning(load)}"))
    for name, terms in held["modulation"].items():
        parts = (f"{plain(term['depth'])}{_turning(term)}" for term in terms)
        rows.append((f"F of {name}", f"times 1 + {' + '.join(parts)}"))
    rows += _numbers_of_contacts(responses, study.get("contact", {}))
    cubic = " + Σ α (a·q)³ a" if held["cubic"] else ""
    equation = _EQUATION_OF_SYSTEMS.format(cubic=cubic) + (_EQUATION_OF_LAGS if lags else "")
    names = ", ".join(held["coordinates"])
    return [
        ("Equation", f"{equation}; x = b·q, q = ({names})"),
        *rows,
        *_laws(responses),
    ]


def _numbers_of_contacts(
    responses: xr.Dataset, own: Mapping[str, Mapping[str, Any]]
) -> Iterator[tuple[str, str]]:
    """Swept settings of all contacts of a system, and separate settings of some."""
    for name, symbol in {"K_c": "K_c", "j_1": "j₁", "j_2": "j₂"}.items():
        if name in responses.dims:
            yield symbol, _text(responses[name].values)
    if "gap" in responses:
        yield "j₁/j₂", _listed([shortened(str(gap)) for gap in responses["gap"].values])
    if "K_ratio" in responses or "K_c" in responses.dims:
        ratios = np.ravel(responses["K_ratio"].values) if "K_ratio" in responses else np.ones(1)
        none = "" if ratios.all() else "; 0: no lower wall"
        yield _RATIO[0], f"{_text(ratios)} {_RATIO[1]}{none}"
    for name in (name for name in _LOSSES if name in responses):
        symbol, unit = _NUMBERS[name]
        yield symbol, f"{_text(np.ravel(responses[name].values))} {unit}".strip()
    for contact, table in own.items():
        settings = (
            f"{symbol} {_written(table[name])}".strip()
            for name, symbol in _OWN.items()
            if table.get(name) is not None
        )
        yield f"Only {contact}", ", ".join(settings)


def _written(value: Any) -> str:
    """Text of a label, a number, or the two distances of a gap."""
    if isinstance(value, str):
        return value
    return "/".join(map(plain, np.ravel(value)))


def _turning(term: Any) -> str:
    """The cosine factor of a load or a modulation; empty if it is constant."""
    angle = [f"{_rate(term)}t"] if term["k"] else []
    angle += [plain(term["phase"])] if term["phase"] else []
    return f" cos({' + '.join(angle)})" if angle else ""


def _rate(term: Any) -> str:
    """Text of the angular frequency of a load or modulation, as a multiple of ω in Hz."""
    return f"{2 * term['k']}πω"


def _rows(numbers: Any) -> str:
    """Text of the numbers of a vector or of a matrix, row by row."""
    if numbers and isinstance(numbers[0], list):
        return f"[{', '.join(map(_rows, numbers))}]"
    return f"[{', '.join(plain(number + 0.0) for number in numbers)}]"  # -0.0 as 0


def _walls(responses: xr.Dataset) -> str:
    """Text on the walls: the gaps, or both distances if these are swept."""
    if "gap" in responses:
        gaps = _listed([shortened(str(gap)) for gap in responses["gap"].values])
        return f"walls at −j₁ and j₂: {gaps} mm"
    j_1, j_2 = (_text(1e3 * responses[name].values) for name in ("j_1", "j_2"))
    return f"walls at −j₁ and j₂: j₁ {j_1} mm, j₂ {j_2} mm"


def _text(values: Any) -> str:
    return _listed([plain(number) for number in np.ravel(values)])


def _listed(texts: Sequence[str]) -> str:
    return ", ".join(texts) if len(texts) <= _MANY else f"{texts[0]} to {texts[-1]}"


def _laws(responses: xr.Dataset) -> list[tuple[str, str]]:
    """Name and formula of the force of each law; user laws are named by their label."""
    tables = json.loads(responses.attrs.get("tables_json", "{}"))
    # Contacts of a system may have no common unit.
    force = responses["force_max"].attrs.get("units", "") if "force_max" in responses else ""
    is_length = force == "N"
    unit = {"N": "[1/m]", "N m": "[1/rad]", "1": "[-]"}.get(force, "[1/unit of x]")
    found = {}
    for label in labels_of(responses):
        if label.law_type is not None:
            found[f"F of {label.family}"] = label.law_type.words.replace("[1/m]", unit)
        elif not label.is_auto:
            table = tables.get(label.law)
            found[f"F of {label.law}"] = _table(table, is_length) if table else "user-defined"
    return list(found.items())


def _table(table: Mapping[str, Any], is_length: bool) -> str:
    """Text on the number and range of the points of a measured force."""
    scale, unit = (1e3, " mm") if is_length else (1.0, "")
    low, high = (plain(scale * table[end]).replace("-", "−") for end in ("low", "high"))
    return (
        f"a table of {table['points']} points from {low} to {high}{unit}, monotone cubic "
        "interpolation"
    )
