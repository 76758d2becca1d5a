"""Summary of a dataset in a few lines, as text and as HTML."""

import html
from collections.abc import Iterator

import numpy as np
import xarray as xr

from gapsweep.quantities import written
from gapsweep.report.selection import places
from gapsweep.study.axis_selection import is_numeric, listed
from gapsweep.variables import STATUS_FLAGS, flags_of

_FEW = 6  # values that are named one by one
_NOT_REQUESTED = "not_requested"
_PADDING = (_NOT_REQUESTED, "none")  # flags of cells without a sweep point or attractor


def as_text(dataset: xr.Dataset) -> str:
    """Summary of a dataset as text, a line per fact."""
    facts = list(_facts(dataset))
    width = max((len(name) for name, _ in facts), default=0)
    lines = [f"  {name:<{width}}  {text}" for name, text in facts]
    return "\n".join([f"gapsweep: {_title(dataset)}", *lines])


def as_html(dataset: xr.Dataset) -> str:
    """Summary of a dataset as an HTML table with escaped texts."""
    rows = "".join(
        f'<tr><th style="text-align:left">{html.escape(name)}</th>'
        f'<td style="text-align:left">{html.escape(text)}</td></tr>'
        for name, text in _facts(dataset)
    )
    title = html.escape(_title(dataset))
    return f"<table><caption><b>gapsweep</b>: {title}</caption>{rows}</table>"


def _title(dataset: xr.Dataset) -> str:
    return str(dataset.attrs.get("title") or dataset.attrs.get("study") or "dataset")


def _facts(dataset: xr.Dataset) -> Iterator[tuple[str, str]]:
    """Name and text of each fact: numbers and origin of points, outcomes, parameter values."""
    attributes = dataset.attrs
    if "n_points" in attributes:
        yield (
            "points",
            f"{attributes['n_points']}: {attributes['n_hits']} from the cache, "
            f"{attributes['n_computed']} computed",
        )
    elif "status" in dataset:
        asked = dataset["status"].values != dict(STATUS_FLAGS)[_NOT_REQUESTED]
        yield "points", str(int(asked.sum()))
    if "initial_conditions" in attributes:
        yield "initial conditions", attributes["initial_conditions"]
    if "attractor_on_branch" in dataset:
        lost = dataset["attractor_on_branch"].values < 0
        yield "attractors", f"{lost.size} periodic, {lost.sum()} of them on no branch"
    for name in ("status", "response_class"):
        if name in dataset:
            yield name.replace("_", " "), _counts(dataset[name])
    for name in ("representation", *places(dataset), "initial_condition"):
        if name in dataset.coords:
            yield name.replace("initial_condition", "initial condition"), _values(dataset[name])


def _counts(variable: xr.DataArray) -> str:
    flags = flags_of(variable).items()
    counts = {label: int((variable.values == value).sum()) for value, label in flags}
    shown = (f"{n} {label}" for label, n in counts.items() if n and label not in _PADDING)
    return ", ".join(label.replace("_", " ") for label in shown)


def _values(coordinate: xr.DataArray) -> str:
    values = np.atleast_1d(coordinate.values)
    written_unit = written(str(coordinate.attrs.get("units", "1")))
    unit = f" {written_unit}" if written_unit else ""
    if values.size > _FEW and is_numeric(values):
        return f"{values.size} values, {values.min():g} to {values.max():g}{unit}"
    return listed(values) + unit
