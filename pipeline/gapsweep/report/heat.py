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
from dataclasses import dataclass
from itertools import groupby
from typing import TypeVar

import numpy as np

from gapsweep.report.answer import SIGNS, Contact, Judged
from gapsweep.report.tables import number, percent

GROUPS = {
    "error": "Amplitude error of paired attractors [%], 95th percentile",
    "found": "Exact attractors found [%]",
    "cost": "Cost of laws to use [×]",
}
MANY = 10  # contacts, of which more stand beside each other in one group only
_LEAST, _MOST = 0.005, 1.0  # errors that are pale and dark
_DEAREST = 10.0  # of costs
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Cell:
    """A number of a law in a contact: in short, in full, how dark (0 to 1), where it is drawn."""

    text: str
    said: str
    shade: float
    anchor: str
    verdict: str
    is_firm: bool


@dataclass(frozen=True, slots=True)
class Row:
    """All cells of a law, by group in the order of contacts; None where it was not swept."""

    law: str
    cells: dict[str, list[Cell | None]]


def heat(found: Sequence[Contact]) -> list[Row]:
    """Rows of the heat map, the law that may be used most first.

    Parameters
    ----------
    found : sequence of Contact
        The columns of every group.
    """
    here = [{one.law: one for one in contact.laws} for contact in found]
    laws = dict.fromkeys(law for judged in here for law in judged)
    return [
        Row(
            law,
            {
                group: [
                    _cell(group, contact, judged[law]) if law in judged else None
                    for contact, judged in zip(found, here, strict=True)
                ]
                for group in GROUPS
            },
        )
        for law in sorted(laws, key=lambda law: _rank([j[law] for j in here if law in j]))
    ]


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


def _cell(group: str, contact: Contact, one: Judged) -> Cell:
    error, share = (float(one.values[name][0]) for name in ("p95", "found"))
    is_usable = one.column == "use"
    text, shade = {
        "error": (
            _short(100.0 * error),
            1.0 if np.isnan(error) else _between(error, _LEAST, _MOST),
        ),
        "found": (_short(100.0 * share), np.sqrt(1.0 - share)),
        "cost": (
            _cost(one) if is_usable else "–",
            _between(one.price, 1.0, _DEAREST) if is_usable else np.nan,
        ),
    }[group]
    said = (
        f"{one.name}, {contact.place}: {one.verdict}; 95 % of amplitudes within {percent(error)}, "
        f"{percent(share)} of {one.n_exact} attractors found, cost {one.cost}"
    )
    dark = float(np.clip(np.nan_to_num(shade), 0.0, 1.0))
    return Cell(text, said, dark, contact.anchor, one.verdict, one.is_firm)


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
