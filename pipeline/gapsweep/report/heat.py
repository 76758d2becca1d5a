"""The heat map at the head of the report: error, attractors found and cost of laws in cases.

One number per cell and group, the darker the worse:

error
    95th percentile of the amplitude error; its sign is the verdict.
found
    Share of the exact law's attractors.
cost
    Processor time per forcing period divided by that of the exact law, for the verdict "use" only.
"""

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Any, TypeVar

import numpy as np

from gapsweep.report.tables import number
from gapsweep.report.verdicts import SIGNS, Contact, Judged

GROUPS = {
    "error": "Amplitude error of paired attractors [%], 95th percentile",
    "found": "Exact attractors found [%]",
    "cost": "Cost of laws to use [×]",
}
MANY = 10  # cases; with more cases one group is shown at a time
_LEAST, _MOST = 0.005, 1.0  # errors of the palest and the darkest cell
_DEAREST = 10.0  # cost ratio of the darkest cell
T = TypeVar("T")


def heat(found: Sequence[Contact]) -> list[tuple[str, list[Judged | None]]]:
    """Rows of the heat map: each law with its verdicts by case, the most adequate law first.

    `found`: the cases, columns of every group; None for a law without a verdict in a case.
    """
    here = [{one.law: one for one in contact.laws} for contact in found]
    rows = {law: [judged.get(law) for judged in here] for judged in here for law in judged}
    return sorted(rows.items(), key=lambda row: _rank([one for one in row[1] if one]))


def cells(found: Sequence[Contact]) -> list[tuple[str, dict[str, list[dict[str, Any] | None]]]]:
    """Rows of the heat map as texts: each law with the cells of every group."""
    return [
        (law, {group: [_texts(*pair, group) for pair in zip(row, found, strict=True)]
               for group in GROUPS})
        for law, row in heat(found)
    ]  # fmt: skip


def _texts(one: Judged | None, contact: Contact, group: str) -> dict[str, Any] | None:
    if one is None:
        return None
    text, shade = cell(one, group)
    return {
        "text": text,
        "shade": round(100.0 * shade),
        "sign": SIGNS[one.verdict],
        "is_firm": one.is_firm,
        "anchor": contact.anchor,
        "about": f"{contact.place}: {one.said} Cost {one.cost}",
    }


def cell(one: Judged, group: str) -> tuple[str, float]:
    """Cell of a law in a group: its number as short text, and its darkness from 0 to 1."""
    error, share = (float(one.values[name][0]) for name in ("p95", "found"))
    if group == "error":
        shade = 1.0 if np.isnan(error) else _between(error, _LEAST, _MOST)
        return _short(100.0 * error), min(shade, 1.0)
    if group == "found":
        return _short(100.0 * share), float(np.nan_to_num(np.sqrt(1.0 - share)))
    if one.column != "use":
        return "–", 0.0
    return _cost(one), min(_between(one.cost_ratio, 1.0, _DEAREST), 1.0)


def _cost(one: Judged) -> str:
    """The cost ratio as short text, with a question mark if its interval is unknown."""
    if one.cost.startswith("≈"):
        return "≈\u00a01"
    if one.low <= 1.0 <= one.high:
        return f"{_short(one.low)}–{_short(one.high)}"
    return f"{_short(one.cost_ratio)}{'?' if np.isnan(one.low) else ''}"


def _rank(everywhere: Sequence[Judged]) -> tuple[float, float]:
    """The sorting key of a law: its verdicts, the worst last, then its errors."""
    verdicts = [list(SIGNS).index(one.verdict) for one in everywhere]
    errors = [one.values["p95"][0] for one in everywhere]
    return float(np.mean(verdicts)), float(np.mean(np.nan_to_num(errors, nan=np.inf)))


def _between(value: float, low: float, high: float) -> float:
    """The position of a value between two others, 0 to 1 on a logarithmic scale."""
    return float(np.log(max(value, low) / low) / np.log(high / low)) if value > 0.0 else 0.0


def _short(value: float) -> str:
    """A number as text with two digits, to fit a column on a phone."""
    if not np.isfinite(value) or value == 0.0:
        return number(value)
    if value >= 999.5:
        return ">999"
    if value < 0.005:
        return "≈0"
    return f"{value:.0f}" if value >= 9.95 else f"{round(float(f'{value:.2g}'), 2):g}"


def heads(found: Iterable[T]) -> list[tuple[T, int]]:
    """Headings over the columns of a group, each with its number of columns."""
    return [(head, len(list(same))) for head, same in groupby(found)]


def swept_columns(found: Sequence[Contact]) -> tuple[str, list[str]]:
    """Other swept parameters: their names with units, and their values, in three digits."""
    names = [f"{one.name} [{one.unit}]" if one.unit else one.name for one in found[0].swept]
    return ", ".join(names), [", ".join(one.short for one in c.swept) for c in found]
