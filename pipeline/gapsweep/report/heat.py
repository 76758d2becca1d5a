"""The heat map at the top of the report: law × contact, its error, what it finds, its cost.

One number per cell and group, the darker the worse:

error
    95 % of the amplitudes are at least as close to those of the exact law. Its sign is the verdict.
found
    Share of the exact law's attractors.
cost
    Processor time per forcing period over the exact law's, of laws to use: no other is as close.
"""

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import TypeVar

import numpy as np

from gapsweep.report.answer import SIGNS, Contact, Judged
from gapsweep.report.tables import number

GROUPS = {
    "error": "Amplitude error of paired attractors [%], 95th percentile",
    "found": "Exact attractors found [%]",
    "cost": "Cost of laws to use [×]",
}
MANY = 10  # contacts, of which more stand beside each other in one group only
_LEAST, _MOST = 0.005, 1.0  # errors that are pale and dark
_DEAREST = 10.0  # of costs
T = TypeVar("T")


def heat(found: Sequence[Contact]) -> list[tuple[str, list[Judged | None]]]:
    """Every law with its verdicts in the order of contacts, the law that may be used most first.

    Parameters
    ----------
    found : sequence of Contact
        The columns of every group; a law that is not judged in one of them has None there.
    """
    here = [{one.law: one for one in contact.laws} for contact in found]
    rows = {law: [judged.get(law) for judged in here] for judged in here for law in judged}
    return sorted(rows.items(), key=lambda row: _rank([one for one in row[1] if one]))


def cell(one: Judged, group: str) -> tuple[str, float]:
    """The number of a law in a group as short text, and how dark it is drawn, 0 to 1."""
    error, share = (float(one.values[name][0]) for name in ("p95", "found"))
    if group == "error":
        shade = 1.0 if np.isnan(error) else _between(error, _LEAST, _MOST)
        return _short(100.0 * error), min(shade, 1.0)
    if group == "found":
        return _short(100.0 * share), float(np.nan_to_num(np.sqrt(1.0 - share)))
    if one.column != "use":
        return "–", 0.0
    return _cost(one), min(_between(one.price, 1.0, _DEAREST), 1.0)


def _cost(one: Judged) -> str:
    """The price in short; in doubt where nothing says how far it repeats."""
    if one.cost.startswith("≈"):
        return "≈\u00a01"
    if one.low <= 1.0 <= one.high:
        return f"{_short(one.low)}–{_short(one.high)}"
    return f"{_short(one.price)}{'?' if np.isnan(one.low) else ''}"


def _rank(everywhere: Sequence[Judged]) -> tuple[float, float]:
    """Where a law stands: by its verdicts, the worst last, then by its errors."""
    verdicts = [list(SIGNS).index(one.verdict) for one in everywhere]
    errors = [one.values["p95"][0] for one in everywhere]
    return float(np.mean(verdicts)), float(np.mean(np.nan_to_num(errors, nan=np.inf)))


def _between(value: float, low: float, high: float) -> float:
    """Where a value is between two others, on a logarithmic scale."""
    return float(np.log(max(value, low) / low) / np.log(high / low)) if value > 0.0 else 0.0


def _short(value: float) -> str:
    """Two digits, which fit a column of a phone."""
    if not np.isfinite(value) or value == 0.0:
        return number(value)
    if value >= 999.5:
        return ">999"
    if value < 0.005:
        return "≈0"
    return f"{value:.0f}" if value >= 9.95 else f"{round(float(f'{value:.2g}'), 2):g}"


def heads(found: Iterable[T]) -> list[tuple[T, int]]:
    """What stands over the columns of a group, each with how many it stands over."""
    return [(head, len(list(same))) for head, same in groupby(found)]


def swept_columns(found: Sequence[Contact]) -> tuple[str, list[str]]:
    """What is swept beside contacts: its names with units, and its values of every contact."""
    names = [f"{one.name} [{one.unit}]" if one.unit else one.name for one in found[0].swept]
    return ", ".join(names), [", ".join(one.value for one in c.swept) for c in found]
