"""Which approximation may be taken for which contact, and at what price: what a report opens with.

Judged contact by contact (stiffness and gap), from ``agreement.nc``:

exact here
    Neither number worse than the exact law against itself: this study cannot tell them apart.
use
    95 % of the amplitudes within 5 %, the thickness of a plotted line, and 95 % of the exact
    attractors found: a diagram drawn with it reads the same.
with care
    Half of both: what is common is right, what is rare may be missing or invented.
no
    Less than that.

Each asks what those below it ask, and nothing that the exact law against itself does not reach: of
the error that 95 % stay below, of that which half stay below, of the share found. Amplitudes are
those of paired attractors, because start by start a moved basin boundary would count as a wrong
amplitude. The price is processor time per forcing period, because totals also count how long each
motion took to settle. The interval of a price covers the choice of frequencies and how far prices
repeat: what exact against exact is away from 1, over all contacts of the study. A study that does
not sweep the exact law twice has not measured that: its prices have no interval, and nothing is
said to save time. ±: the intervals of a law and of exact against exact leave it open on which side
of a line between "use", "with care" and "no" it lies, or the frequencies are too few for intervals.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.analysis.datasets.timing import repeatability, widened
from gapsweep.analysis.dimensions import At, scene_dims, scenes
from gapsweep.model.labels import AUTO
from gapsweep.report.scales import Told, plain
from gapsweep.report.selection import anchor_of, beside, gap_label
from gapsweep.report.tables import number

LINE, MOST, HALF = 0.05, 0.95, 0.5
SIGNS = {"exact here": "=", "use": "✓", "with care": "◐", "no": "✗"}
_SHOWN = {
    "median": "amplitude_error_paired_median",
    "p95": "amplitude_error_paired_p95",
    "found": "recall_pooled",
}
_PRICE = "cpu_time_per_period_ratio"
_CONTACTS = "n_contacts_per_period"
COLUMNS = ("use", "with care", "no")
_NO_APPROXIMATIONS = ("piecewise-noevents", AUTO)
# Of each number the estimate, and the best and the worst end of its interval.
Values = dict[str, NDArray[np.float64]]
Row = dict[str, Any]  # variables of one law in one contact
_NEAR = 1.5  # prices whose interval lies within this factor about 1 are called 1
_WITH = "with this study's solver"  # as a price is the solver's as much as the law's
MOST_CONTACTS = 16  # that are told one by one


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """A law in a contact: its numbers, and what follows from them.

    `possible` are the columns of the table that its intervals leave open.
    """

    law: str
    values: Values
    n_exact: int
    verdict: str
    possible: frozenset[str]
    price: float
    low: float
    high: float
    periodic_price: float = np.nan  # where the exact law is periodic

    @property
    def is_approximation(self) -> bool:
        """Unlocated contacts are the exact force, and ``auto`` chooses it where it is needed."""
        return self.law not in _NO_APPROXIMATIONS

    @property
    def is_firm(self) -> bool:
        """Whether its intervals leave no other verdict open."""
        return len(self.possible) == 1

    @property
    def column(self) -> str:
        """Where it stands in the table."""
        return _column(self.verdict)

    @property
    def name(self) -> str:
        """Its label, marked if its verdict is not firm."""
        return self.law if self.is_firm else f"{self.law} ±"

    @property
    def cost(self) -> str:
        """The price in words; in doubt where it has no interval."""
        if np.isnan(self.low):
            return f"{times(self.price)} ?"
        if self.low <= 1.0 <= self.high:
            is_near = max(self.high, 1.0 / self.low) <= _NEAR
            return "≈ 1\u00a0×" if is_near else f"{times(self.low)} to {times(self.high)}"
        return times(self.price)


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """A stiffness [N/m] and a gap [mm], the exact law against itself, and all that stands in.

    `swept` are the values of what the study sweeps beside, `at` is its position in the files,
    `floor_price` what the exact law with other settings costs over itself, `unjudged` why no law
    can be judged there.
    """

    K_c: float
    gap: str
    floors: Values
    laws: list[Judged]
    threshold: str
    swept: Sequence[Told] = ()
    floor_price: float = np.nan
    at: At = field(default_factory=dict)
    unjudged: str = ""

    @property
    def others(self) -> str:
        """What is swept beside, in words."""
        return ", ".join(map(str, self.swept))

    @property
    def place(self) -> str:
        """Where it is, in words."""
        others = f", {self.others}" if self.others else ""
        return f"{plain(self.K_c)} N/m, {self.gap} mm{others}"

    @property
    def anchor(self) -> str:
        """The id of its scene in the page."""
        return anchor_of(self.at)

    @property
    def columns(self) -> dict[str, list[Judged]]:
        """All laws by what may be done with them, the cheapest first."""
        laws = sorted(self.laws, key=lambda one: (np.isnan(one.price), one.price))
        return {v: [one for one in laws if one.column == v] for v in COLUMNS}

    @property
    def picks(self) -> list[Judged]:
        """The cheapest approximation to use, and those whose price cannot be told from its."""
        usable = [one for one in self.columns["use"] if one.is_approximation]
        best = next((one for one in usable if one.is_firm), usable[0] if usable else None)
        # Without an interval of either nothing says that their prices are alike.
        return [one for one in usable if best and (one is best or one.low <= best.high)]

    @property
    def is_sure(self) -> bool:
        """Whether an approximation may be used beyond doubt."""
        return any(one.is_firm for one in self.picks)

    @property
    def is_open(self) -> bool:
        """Whether none may be used beyond doubt, and one may be."""
        laws = [one for one in self.laws if one.is_approximation]
        return not self.is_sure and any("use" in one.possible for one in laws)

    @property
    def is_paying(self) -> bool:
        """Whether an approximation saves time beyond doubt."""
        return any(one.is_firm and one.high < 1.0 for one in self.picks)

    @property
    def least_tanh(self) -> str:
        """The smallest parameter [1/m] of tanh that was measured and may be used."""
        names = [one.name[5:] for one in self.columns["use"] if one.law.startswith("tanh-")]
        return min(names, key=lambda name: float(name.split()[0]), default="none")


def contacts(agreement: xr.Dataset, static: xr.Dataset | None = None) -> list[Contact]:
    """Every contact of a study with what stands in there, the softest and narrowest first.

    Parameters
    ----------
    agreement, static : Dataset
        As stored in the run's folder; without `static`, thresholds of tanh are not known.
    """
    names = [*_SHOWN.values(), _PRICE, _CONTACTS]
    pooled = agreement[[*names, *(f"{n}_ci" for n in names), "n_points"]].sel(regime="all").load()
    pooled["n_exact"] = agreement["n_attractors_exact"].sum("omega")
    exact = str(agreement.attrs["floor_representations"]).split()
    labels = [str(label) for label in pooled["representation"].values]
    laws = [n for n in labels if n != agreement.attrs["reference"] and "@" not in n]
    if not laws:
        return []
    dims = scene_dims(agreement["n_attractors_exact"].dims)
    pooled = pooled.transpose("representation", *dims, ...)
    # As arrays: a study may have a thousand contacts.
    tables = {str(name): pooled[name].values for name in pooled}
    periodic = agreement[_PRICE].sel(regime="periodic")
    tables["periodic"] = periodic.transpose("representation", *dims).values
    noise = repeatability(tables[_PRICE][[labels.index(label) for label in exact]])
    found = []
    for at in scenes(pooled, dims):
        where = {
            label: {name: table[r, *at.values()] for name, table in tables.items()}
            for r, label in enumerate(labels)
        }
        unjudged = _unjudged(where[str(agreement.attrs["reference"])])
        here_too = [law for law in laws if where[law]["n_points"] > 0]
        can_be = [] if unjudged else [law for law in here_too if _is_judged(law, where[law])]
        if not (here_too if unjudged else can_be):
            continue
        floors = _worst([_values(where[label]) for label in exact])
        judged = [_judged(law, where[law], floors, noise) for law in can_be]
        here = pooled.coords.to_dataset().isel(at)
        gap, swept = gap_label(here), [Told.of(here[name]) for name in beside(here)]
        known = _threshold(static, here), swept, _floor_price(where, exact), at, unjudged
        contact = Contact(float(here["K_c"]), gap, floors, judged, *known)
        order = float(np.round(here["j_1"] + here["j_2"], 12)), float(here["j_1"])
        found.append((contact.K_c, *order, contact))
    return [contact for *_, contact in sorted(found, key=lambda one: one[:-1])]


def verdict(values: Values, floors: Values) -> list[str]:
    """The first verdict whose demands are met, at each end of the intervals; NaN meets none."""
    known, floor = (
        {name: np.where(np.isnan(v), v[0], v) for name, v in some.items()}
        for some in (values, floors)
    )
    median, p95, found = (known[name] for name in _SHOWN)
    care = (median <= np.fmax(LINE, floor["median"])) & (found >= np.fmin(HALF, floor["found"]))
    demands = {
        "exact here": care & (p95 <= floor["p95"]) & (found >= floor["found"]),
        "use": care
        & (p95 <= np.fmax(LINE, floor["p95"]))
        & (found >= np.fmin(MOST, floor["found"])),
        "with care": care,
    }
    said: list[str] = np.select(list(demands.values()), list(demands), "no").tolist()
    return said


def _values(row: Row) -> Values:
    values = {}
    for name, long in _SHOWN.items():
        low, high = row[f"{long}_ci"]
        values[name] = np.array([row[long], *((high, low) if name == "found" else (low, high))])
    return values


def _floor_price(where: Mapping[str, Row], exact: Sequence[str]) -> float:
    """Price of the exact law's other settings, the farthest from 1; NaN if there are none."""
    prices = [price for label in exact if np.isfinite(price := float(where[label][_PRICE]))]
    return max(prices, key=lambda price: abs(np.log(price)), default=np.nan)


def _worst(exact: Sequence[Values]) -> Values:
    """What the exact law reaches against itself, at each end; NaN if nothing says that."""
    worst = {}
    for name in _SHOWN:
        measured = [values[name] for values in exact if np.isfinite(values[name][0])]
        of_all = np.min if name == "found" else np.max  # NaN if an interval is not known
        worst[name] = of_all(measured, axis=0) if measured else np.full(3, np.nan)
    return worst


def _unjudged(exact: Row) -> str:
    """Why no law can be judged by the exact one; empty where all can."""
    if np.isnan(exact[_SHOWN["found"]]):  # of no attractors
        return "the exact law has no steady response"
    return "" if exact[_CONTACTS] else "the exact law touches no wall"


def _is_judged(label: str, row: Row) -> bool:
    """Whether there is an attractor to find; code of the user's that only fails has a mistake."""
    is_broken = ":" in label and np.isnan(row[_SHOWN["median"]])
    return not is_broken and bool(np.isfinite(row[_SHOWN["found"]]))


def _judged(label: str, row: Row, floors: Values, noise: float) -> Judged:
    values = _values(row)
    # A law at its best against the floor at its worst, and the other way round: their intervals do
    # not move together, and a law and the exact one that differ by less are not told apart.
    ends = verdict(values, {name: floor[[0, 2, 1]] for name, floor in floors.items()})
    numbers = [*values.values(), *floors.values()]
    is_known = not any(np.isnan(v[1:]).any() and np.isfinite(v[0]) for v in numbers)
    possible = frozenset(map(_column, ends) if is_known else COLUMNS)
    price = float(row[_PRICE])
    costs = price, *widened(price, row[f"{_PRICE}_ci"], noise), float(row["periodic"])
    return Judged(label, values, int(row["n_exact"]), ends[0], possible, *costs)


def _column(verdict: str) -> str:
    """Of the table, which does not tell what is exact from what may be used."""
    return "use" if verdict == "exact here" else verdict


def _threshold(static: xr.Dataset | None, here: xr.Dataset) -> str:
    if static is None or "tanh_threshold" not in static or gap_label(here) == "0/0":
        return "?"
    known = static["tanh_threshold"]
    if not {str(dim) for dim in known.dims} <= {*here.coords}:
        return "?"
    value = float(known.sel({dim: here[dim].item() for dim in known.dims}))
    return f"ε > {number(float(f'{value:.2g}'))}" if np.isfinite(value) else "any ε"


def in_words(found: Sequence[Contact]) -> list[str]:
    """What to take, what an approximation costs, and where no law can be judged."""
    judged = [contact for contact in found if not contact.unjudged]
    said = _said(judged) if judged else []
    for reason, n in Counter(c.unjudged for c in found if c.unjudged).items():
        said.append(f"Laws cannot be judged in {how_many(n, found)}: {reason}.")
    return said


def how_many(n: int, found: Sequence[Contact]) -> str:
    """So many of some contacts, in words; settings where more is swept than these."""
    noun = "contact" if len({contact.others for contact in found}) < 2 else "setting"
    return f"the only {noun}" if len(found) == 1 else f"{n} of {len(found)} {noun}s"


def _said(found: Sequence[Contact]) -> list[str]:
    paying = [c for c in found if c.is_paying]
    others = [c for c in found if not c.is_paying]
    picks = [one for contact in others for one in contact.picks]
    if paying:
        count = how_many(len(paying), found)
        said = f"An approximation saves time {_WITH} in {count}: {_picked(paying)}"
    elif not picks:
        laws = [one for contact in found for one in contact.laws if one.is_approximation]
        is_open = any(contact.is_open for contact in found)
        how = "has been shown to be adequate" if is_open else "is adequate"
        said = f"Take the exact law: no approximation {how if laws else 'was swept'}"
    else:
        is_dearer = all(one.low > 1.0 for one in picks)
        but = f"cost {_range(picks)} as much" if is_dearer else "none saves time beyond doubt"
        said = f"Take the exact law: approximations {_adequate(found)}, but {but} {_WITH}"
    if not others or not (picks or paying):
        return [f"{said}."]
    where = "Elsewhere take the exact law; if" if paying else "If"
    return [f"{said}.", f"{where} it must be an approximation, the cheapest: {_picked(others)}."]


def _adequate(found: Sequence[Contact]) -> str:
    """In how many contacts approximations may be used, in words."""
    n_sure, n_open = sum(c.is_sure for c in found), sum(c.is_open for c in found)
    if not n_sure:
        return f"may be adequate in {how_many(n_open, found)}"
    more = f" and may be in {n_open} more" * bool(n_open)
    return f"are adequate in {how_many(n_sure, found)}{more}"


def _picked(found: Sequence[Contact]) -> str:
    """Which approximations for which contacts, contacts with the same ones together."""
    groups: dict[tuple[str, ...], list[Contact]] = {}
    for contact in found:
        groups.setdefault(tuple(sorted(one.name for one in contact.picks)), []).append(contact)
    return "; ".join(_pick(laws, some) for laws, some in groups.items())


def _pick(laws: tuple[str, ...], some: Sequence[Contact]) -> str:
    gaps: dict[tuple[str, str], list[str]] = {}
    for contact in some:
        gaps.setdefault((plain(contact.K_c), contact.others), []).append(contact.gap)
    places = " and ".join(
        f"{K_c} N/m with {', '.join(mm)} mm{f' at {others}' if others else ''}"
        for (K_c, others), mm in gaps.items()
    )
    if len(some) > MOST_CONTACTS:
        places = f"{len(some)} contacts"
    if not laws:
        none = "none beyond doubt" if any(one.is_open for one in some) else "none of those swept"
        return f"{none} for {places}"
    names = " or ".join([", ".join(laws[:-1]), laws[-1]] if laws[1:] else laws)
    return f"{names} for {places} ({_range([one for contact in some for one in contact.picks])})"


def _range(laws: Sequence[Judged]) -> str:
    prices = [one.price for one in laws if np.isfinite(one.price)] or [np.nan]
    return " to ".join(dict.fromkeys(times(price) for price in (min(prices), max(prices))))


def times(price: float) -> str:
    """A ratio of processor times, two digits."""
    if not np.isfinite(price):
        return "–"
    digits = ".0f" if price >= 9.95 else ".1f" if price >= 0.95 else ".2g"
    return f"{price:{digits}}\u00a0×"
