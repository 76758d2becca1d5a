"""The section on risk: probabilities, quantiles and indices of uncertain numbers."""

import json
from collections.abc import Iterator, Mapping
from itertools import chain
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from gapsweep.analysis.datasets.risk import EVENT, NUMBER, QUANTITY, safety
from gapsweep.analysis.dimensions import REPRESENTATION
from gapsweep.analysis.dimensions import scenes as positions
from gapsweep.model.labels import EXACT
from gapsweep.report import marks
from gapsweep.report.drawing import labels_of
from gapsweep.report.inputs import Inputs
from gapsweep.report.parts import Figured, Part, Table
from gapsweep.report.risk_figures import along_of, quantiles, risk, tornado
from gapsweep.report.scales import drawn, long_name, named, shown_unit
from gapsweep.report.style import WALL
from gapsweep.report.tables import number
from gapsweep.study.grid import START

_SIZE = (9.5, 3.6)  # inches, the report's column
_MOST = 6  # cases with figures
_LISTED = 16  # rows of a table
_LIMITS = ("probability", "low", "high")
_SETTINGS = {
    *("samples", "repeats", "seed", "indices", "correlation", "quantities", "event", "safe")
}


def sections(inputs: Inputs) -> Iterator[Part]:
    """The answer to "which value is safe" if it was asked, then probabilities and figures."""
    if inputs.risk is None:
        return
    found = inputs.risk.load()
    asked = json.loads(found.attrs["study_json"])["uncertain"]
    along = along_of(found)
    if found.sizes[START] == 1:
        found = found.squeeze(START, drop=True)
    others = [d for d in found["n_undecided"].dims if d not in (REPRESENTATION, along, EVENT)]
    cases = [found.isel(at) for at in positions(found, map(str, others))]
    sentences = [*_safe(found, asked.get("safe")), *_largest(found), _about(found, asked)]
    if len(cases) > _MOST:
        sentences.append(f"Figures show the first {_MOST} of {len(cases)} cases.")
    figures = chain(
        _designed(found, asked.get("safe")),
        (figure for one in cases[:_MOST] for figure in _figures(one, along, others)),
    )
    yield Part("risk", "Risk", sentences, [_table(found)], figures)


def _judged(found: xr.Dataset, asked: Mapping[str, Any] | None) -> Iterator[xr.Dataset]:
    """The judgement of the values of the designed parameter in each case; none if not asked."""
    if asked is None:
        return
    judged = safety(found, asked["along"], asked["event"], asked["probability"])
    others = [d for d in judged["safe"].dims if d not in (REPRESENTATION, asked["along"])]
    for at in positions(judged, map(str, others)):
        one = judged.isel(at)
        yield one.sortby("j_2" if asked["along"] == "gap" else asked["along"])


def _safe(found: xr.Dataset, asked: Mapping[str, Any] | None) -> Iterator[str]:
    """Sentences on the values of a designed parameter with a probability within the limit."""
    everywhere = " at all frequencies" * (found.sizes.get("omega", 1) > 1)
    for case in _judged(found, asked):
        for label in labels_of(case):
            assert asked is not None
            one = case.sel({REPRESENTATION: label})
            names = [name for name in _case(found, asked["along"]) if name in one.coords]
            where = [label, *(named(one[name]) for name in names)]
            yield f"{', '.join(where)}: {_in_words(one, everywhere, **asked)}"


def _case(found: xr.Dataset, along: str) -> list[str]:
    """Swept parameters of a case, next to a designed parameter."""
    own = (REPRESENTATION, "omega", START, EVENT, along)
    dims = found["n_undecided"].dims
    return [str(dim) for dim in dims if dim not in own and found.sizes[dim] > 1]


def _in_words(one: xr.Dataset, everywhere: str, along: str, event: str, probability: float) -> str:
    """Clause on the safe values along one axis."""
    safe, unit = one["safe"].values, shown_unit(one[along])[1]
    unit = unit or str(one[along].attrs.get("units", ""))
    values = one[along].values if along == "gap" else map(number, drawn(one[along]))
    texts = [f"{value} {unit}".removesuffix(" 1").strip() for value in values]
    name = "gap" if along == "gap" else long_name(one[along])
    target = f"P({event}) at most {probability:g}{everywhere}"
    is_safe = np.flatnonzero(safe > 0)
    if not is_safe.size:
        best = int(np.nanargmin(one["probability"]))
        least = f"the least is {_p(one.isel({along: best}))} at {texts[best]}"
        return f"no value of the {name} has {target} for certain; {least}."
    first, last = int(is_safe[0]), int(is_safe[-1])
    is_row = bool((safe[first : last + 1] > 0).all())
    if is_row and first == 0 and last == len(safe) - 1:
        words = f"every {name} from {texts[0]} to {texts[-1]} has {target}"
    elif is_row and (first == 0 or last == len(safe) - 1):
        end, which = (last, "largest") if first == 0 else (first, "smallest")
        words = f"the {which} {name} with {target} is {texts[end]}: {_p(one.isel({along: end}))}"
    else:
        words = f"the {name} has {target} at {', '.join(texts[i] for i in is_safe)}"
    unknown = ", ".join(texts[i] for i in np.flatnonzero(safe == 0))
    return f"{words}{f'; undecided at {unknown}' if unknown else ''}."


def _designed(found: xr.Dataset, asked: Mapping[str, Any] | None) -> Iterator[Figured]:
    """The largest probability over frequencies along the designed parameter, with the limit."""
    for case in _judged(found, asked):
        assert asked is not None
        figure, names = Figure(figsize=_SIZE), _case(found, asked["along"])
        axes = figure.subplots()
        risk(case, along=asked["along"], ax=axes)
        axes.set_ylabel(f"largest probability of “{asked['event']}”")
        marks.put(axes, [marks.level(y=asked["probability"], **WALL)])
        words = f"Largest probability of “{asked['event']}” over frequency"
        where = "".join(f", {named(case[name])}" for name in names)
        yield Figured(figure, f"{words}, and its limit (dashed){where}.", words)


def _p(one: xr.Dataset) -> str:
    """A probability with its interval, as text."""
    p, low, high = (float(one[name]) for name in _LIMITS)
    return f"{number(p)} ({number(low)} to {number(high)})"


def _largest(found: xr.Dataset) -> Iterator[str]:
    """A sentence per event: its largest probability with every representation."""
    for event in found[EVENT].values.tolist():
        several = [
            f"{label} {_worst(found.sel({EVENT: event, REPRESENTATION: label}))}"
            for label in labels_of(found)
        ]
        yield f"Largest probability of “{event}”: {'; '.join(several)}."


def _worst(one: xr.Dataset) -> str:
    """The largest probability in a part of the dataset, with its interval and place."""
    p = one["probability"]
    if not np.isfinite(p).any():
        return "unknown"
    places = np.unravel_index(int(np.nanargmax(p)), p.shape)
    here = one.isel(dict(zip(p.dims, places, strict=True)))
    where = ", ".join(named(here[dim]) for dim in p.dims if p.sizes[dim] > 1)
    return f"{_p(here)}{f' at {where}' if where else ''}"


def _about(found: xr.Dataset, asked: Mapping[str, Any]) -> str:
    """Sentence on the uncertain numbers and the samples."""
    tables = {name: table for name, table in asked.items() if name not in _SETTINGS}
    texts = [f"{name} {_in_short(table)}" for name, table in tables.items()]
    n, repeats = found.attrs["n_samples"], found.attrs["repeats"]
    undecided = int(found["n_undecided"].sum())
    words = f" {undecided} undecided responses (failed or unresolved) widen them." * bool(undecided)
    return (
        f"Uncertain, in SI units: {'; '.join(texts)}. {n} samples, in {repeats} independent "
        f"repeats of a scrambled Sobol sequence. In brackets: 95 % intervals.{words}"
    )


def _in_short(distribution: Mapping[str, Any]) -> str:
    """A distribution as text, measured values by their number."""
    if "data" in distribution:
        return f"{len(distribution['data'])} measured values"
    return ", ".join(f"{key} {value}" for key, value in distribution.items())


def _table(found: xr.Dataset) -> Table:
    """Probabilities of all events; of many cells, those with the largest ones."""
    dims = [str(dim) for dim in found["n_undecided"].dims]
    shown = [dim for dim in dims if found.sizes[dim] > 1 or dim in (REPRESENTATION, EVENT)]
    p = found["probability"].values
    order = np.argsort(-np.nan_to_num(p, nan=-1.0), axis=None, kind="stable")
    rows = []
    for at in np.sort(order[:_LISTED]).tolist():
        here = found.isel(dict(zip(dims, np.unravel_index(at, p.shape), strict=True)))
        values = [float(here[name]) for name in _LIMITS]
        if np.isfinite(values[0]):
            words = [named(here[dim]).removeprefix(f"{dim} = ") for dim in shown]
            rows.append([*words, *map(number, values), f"{float(here['n_undecided']):.0f}"])
    cut = f", the {_LISTED} largest of {p.size}; all are in risk.nc" if p.size > _LISTED else ""
    header = [*(dim.replace("_", " ") for dim in shown), "P", "from", "to", "undecided"]
    return Table(f"Probabilities{cut}", header, rows)


def _figures(one: xr.Dataset, along: str, others: list[Any]) -> Iterator[Figured]:
    """Figures of a case: probabilities and quantiles along the axis, and Sobol indices."""
    where = ", ".join(named(one[dim]) for dim in others if dim in one.coords)
    where = f": {where}." if where else "."

    def is_open(event: str) -> bool:
        """Whether the event happens in some samples and not in others."""
        p = one["probability"].sel({EVENT: event})
        return bool(((p > 0.0) & (p < 1.0)).any())

    events, quantities = (one[name].values.tolist() for name in (EVENT, QUANTITY))
    if one.sizes.get(along, 1) > 1:
        for event in filter(is_open, events):
            words = f"Probability of “{event}”"
            caption = f"{words}, with 95 % intervals side by side{where}"
            yield _figured(risk, caption, words, one, event, along)
        for quantity in quantities:
            words = f"Quantiles of the {quantity}"
            caption = f"{words}: median, side by side 25 to 75 % (wide bars) and 5 to 95 % (narrow)"
            caption += where
            yield _figured(quantiles, caption, words, one, quantity, along)
    if "total" not in one:
        return
    label = EXACT if EXACT in labels_of(one) else labels_of(one)[0]
    for event in filter(is_open, events):
        law = one.sel({REPRESENTATION: label})
        p = law["probability"].sel({EVENT: event})
        place = ""
        if p.sizes.get(along, 1) > 1:  # where it is most open
            law = law.isel({along: int(np.argmax(np.nan_to_num(p * (1.0 - p), nan=-1.0)))})
            place = f", {named(law[along])}"
        words = f"Shares of {', '.join(law[NUMBER].values.tolist())} in the variance of “{event}”"
        figure = Figure(figsize=(_SIZE[0], 1.4 + 0.45 * law.sizes[NUMBER]))
        tornado(law, event, ax=figure.subplots())
        yield Figured(figure, f"{words}, {label}{place}{where}", words)


def _figured(
    draw: Any, caption: str, words: str, one: xr.Dataset, name: str, along: str
) -> Figured:
    figure = Figure(figsize=_SIZE)
    draw(one, name, along=along, ax=figure.subplots())
    return Figured(figure, caption, words)
