"""Verdicts on approximations by case, and their cost.

A case is a stiffness and a gap. Verdicts follow from ``agreement.nc``:

exact here
    Neither number is worse than for the exact law with other settings: this study cannot
    distinguish the two.
use
    95 % of the amplitudes err by less than 5 %, the thickness of a plotted line, and the law finds
    95 % of the exact law's attractors.
with care
    A user may try the law: 95 % of the amplitudes err by less than 20 %, and the law finds 80 % of
    the attractors.
no
    The law misses more than one attractor in five, or 5 % of the amplitudes err by more than 20 %.

Two numbers decide, the 95th percentile of the error and the share of attractors found; both are in
the table. No threshold is stricter than what the exact law with other settings reaches, for laws
whose median error is below 5 % too. Amplitudes are those of paired attractors, since for equal
initial conditions a moved basin boundary would count as an amplitude error.

The cost ratio is processor time per forcing period, since total times also depend on how long
transients last. Its interval covers the choice of frequencies and the repeatability of timings: how
far the exact law with other settings is from 1, over all cases of the study. Without a second sweep
of the exact law there is no interval. No sentence depends on a processor time, which differs from
run to run. ±: the intervals of a law and of the exact law with other settings include a threshold,
or there are too few frequencies for intervals.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import chain, zip_longest
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.analysis.datasets.timing import repeatability, widened
from gapsweep.analysis.dimensions import At, scene_dims, scenes
from gapsweep.model.labels import NOT_LOCATED, Representation
from gapsweep.report.scales import NamedValue, plain
from gapsweep.report.selection import anchor_of, gap_label, other_parameters
from gapsweep.report.tables import number, percent
from gapsweep.study.grid import COORDINATE

# The largest error at the 95th percentile and the smallest share found, by verdict.
LIMITS = {"use": (0.05, 0.95), "with care": (0.2, 0.8)}
SIGNS = {"exact here": "=", "use": "✓", "with care": "◐", "no": "✗"}
SHOWN = {
    "median": "amplitude_error_paired_median",
    "p95": "amplitude_error_paired_p95",
    "found": "recall_pooled",
}
_COST_RATIO = "cpu_time_per_period_ratio"
_CONTACTS = "contacts_per_period"
COLUMNS = ("use", "with care", "no")
# Estimate of each number, and the best and the worst end of its interval.
Values = dict[str, NDArray[np.float64]]
Row = dict[str, Any]  # variables of one law in one case
_NEAR = 1.5  # cost ratios whose interval lies within this factor about 1 are shown as 1
MOST_CONTACTS = 16  # cases that are listed one by one


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """A law in a case: its numbers, and its verdict.

    `possible` holds the columns of the table that its intervals allow.
    """

    law: Representation
    values: Values
    n_exact: int
    verdict: str
    possible: frozenset[str]
    cost_ratio: float
    low: float
    high: float
    periodic_cost_ratio: float = np.nan  # at points with a periodic response of the exact law

    @property
    def is_approximation(self) -> bool:
        """Whether the law is an approximation: False for ``piecewise-noevents`` and ``auto``."""
        return not (self.law == NOT_LOCATED or self.law.is_auto)

    @property
    def error(self) -> float:
        """The 95th percentile of the error; infinity if no attractors are paired."""
        return float(np.nan_to_num(self.values["p95"][0], nan=np.inf))

    @property
    def is_firm(self) -> bool:
        """Whether its intervals allow one column of the table only."""
        return len(self.possible) == 1

    @property
    def column(self) -> str:
        """The column of the table that lists the law."""
        return _column(self.verdict)

    @property
    def name(self) -> str:
        """The label of the law, with ± if its verdict is not firm."""
        return self.law if self.is_firm else f"{self.law} ±"

    @property
    def said(self) -> str:
        """Sentence: whether the law is accurate enough, and the numbers that decide."""
        numbers = (float(self.values[name][0]) for name in ("p95", "found"))
        return consequence(self.name, self.verdict, *numbers)

    @property
    def cost(self) -> str:
        """The cost ratio in words, with a question mark if it has no interval."""
        if np.isnan(self.low):
            return f"{times(self.cost_ratio)} ?"
        if self.low <= 1.0 <= self.high:
            is_near = max(self.high, 1.0 / self.low) <= _NEAR
            return "≈ 1\u00a0×" if is_near else f"{times(self.low)} to {times(self.high)}"
        return times(self.cost_ratio)


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """A case: stiffness [N/m] and gap [mm], and the verdict on every law.

    Numbers of a contact that is no length are in its unit (`in_metres` is False); stiffness and gap
    are NaN and empty if each contact of a system has its own. `floors` are the errors of the exact
    law with other settings, `floor_cost_ratio` its cost ratio, `n_chaotic` its chaotic sweep
    points, `swept` the values of other swept parameters, `at` the position in the files, and
    `unjudged` the reason if no law can be judged.
    """

    K_c: float
    gap: str
    floors: Values
    laws: list[Judged]
    threshold: str
    swept: Sequence[NamedValue] = ()
    floor_cost_ratio: float = np.nan
    at: At = field(default_factory=dict)
    unjudged: str = ""
    n_chaotic: int = 0
    in_metres: bool = True

    @property
    def others(self) -> str:
        """Other swept parameters, in words."""
        return ", ".join(map(str, self.swept))

    @property
    def stiffness(self) -> str:
        """The stiffness [N/m] as text."""
        return "" if np.isnan(self.K_c) else plain(self.K_c)

    @property
    def place(self) -> str:
        """The parameters of the case, in words."""
        return ", ".join([*self.walls([self.gap]), *([self.others] if self.others else [])])

    def walls(self, gaps: Sequence[str]) -> list[str]:
        """The stiffness, and the gaps of cases that differ in them only, in words."""
        numbers = self.stiffness, ", ".join(gaps)
        if self.in_metres:
            return [f"{numbers[0]} N/m", f"{numbers[1]} mm"]
        named = zip(("K_c", "gap"), numbers, strict=True)
        return [f"{name} {text}" for name, text in named if text]

    @property
    def anchor(self) -> str:
        """The id of the case's section in the page."""
        return anchor_of(self.at)

    @property
    def error(self) -> float:
        """The largest error of an approximation (95th percentile), 0 if there is none."""
        return max((one.error for one in self.laws if one.is_approximation), default=0.0)

    @property
    def lost(self) -> float:
        """The largest share of the attractors that an approximation does not find."""
        found = [one.values["found"][0] for one in self.laws if one.is_approximation]
        return 1.0 - float(min(found, default=1.0))

    @property
    def columns(self) -> dict[str, list[Judged]]:
        """All laws by verdict, in the order of the study."""
        return {v: [one for one in self.laws if one.column == v] for v in COLUMNS}

    @property
    def picks(self) -> list[Judged]:
        """The adequate approximations; of a family the one with the smallest parameter."""
        usable = (one for one in self.columns["use"] if one.is_approximation)
        found: dict[str, Judged] = {}
        for one in sorted(usable, key=lambda one: _parameter(one.law)):
            found.setdefault(one.law.family or one.law, one)
        return list(found.values())

    @property
    def is_sure(self) -> bool:
        """Whether an approximation is adequate, with a firm verdict."""
        return any(one.is_firm and one.is_approximation for one in self.columns["use"])

    @property
    def is_open(self) -> bool:
        """Whether no approximation is adequate with a firm verdict, but one may be."""
        laws = [one for one in self.laws if one.is_approximation]
        return not self.is_sure and any("use" in one.possible for one in laws)

    def least(self, family: str) -> str:
        """The smallest adequate parameter [1/m] of a family, and what was tried.

        ``1e5``: the next smaller parameter is inadequate; ``≤ 1e3``: no smaller one was tried;
        ``> 1e9 tried``: none is adequate up to this; empty: none was tried.
        """
        tried = sorted(
            (one for one in self.laws if one.law.family == family),
            key=lambda one: _parameter(one.law),
        )
        usable = [one for one in tried if one.column == "use"]
        if not tried:
            return ""
        first = usable[0] if usable else tried[-1]
        value = first.name.removeprefix(f"{family}-")
        return f"{'≤ ' * (first is tried[0])}{value}" if usable else f"> {value} tried"


def _parameter(law: Representation) -> float:
    """The parameter of a tangent law or the degree of a polynomial; 0 of other laws."""
    with suppress(ValueError):
        return float(law.parameter)
    return 0.0


def contacts(agreement: xr.Dataset, static: xr.Dataset | None = None) -> list[Contact]:
    """The verdicts of every case of a study, ordered by stiffness and gap width.

    `agreement` and `static`: as stored in the run's folder; without `static`, thresholds of tanh
    are not known.
    """
    names = [*SHOWN.values(), _COST_RATIO, _CONTACTS]
    names += [*(f"{name}_ci" for name in names), "n_points", "n_attractors_exact"]
    of_all = of_worst(agreement[names].load())
    pooled = of_all.drop_vars("n_attractors_exact").sel(regime="all")
    n_exact = of_all["n_attractors_exact"]
    pooled["n_exact"] = n_exact.sum([dim for dim in n_exact.dims if dim == "omega"])
    exact = str(agreement.attrs["floor_representations"]).split()
    labels = [Representation(label) for label in pooled["representation"].values]
    laws = [n for n in labels if n != agreement.attrs["reference"] and not n.protocol]
    if not laws:
        return []
    dims = scene_dims(n_exact.dims)
    pooled = pooled.transpose("representation", *dims, ...)
    # As arrays: a study may have a thousand cases.
    tables = {str(name): pooled[name].values for name in pooled}
    periodic = of_all[_COST_RATIO].sel(regime="periodic")
    tables["periodic"] = periodic.transpose("representation", *dims).values
    chaotic = of_all["n_points"].sel(regime="chaotic")
    tables["n_chaotic"] = chaotic.transpose("representation", *dims).values
    noise = repeatability(tables[_COST_RATIO][[label in exact for label in labels]])
    found = []
    for at in scenes(pooled, dims):
        where: dict[str, Row] = {
            label: {name: table[r, *at.values()] for name, table in tables.items()}
            for r, label in enumerate(labels)
        }
        reference = where[str(agreement.attrs["reference"])]
        unjudged = _unjudged(reference)
        here_too = [law for law in laws if where[law]["n_points"] > 0]
        can_be = [] if unjudged else [law for law in here_too if _is_judged(law, where[law])]
        if not (here_too if unjudged else can_be):
            continue
        floors = worst([shown_values(where[label]) for label in exact])
        judged = [judged_law(law, where[law], floors, noise) for law in can_be]
        here = pooled.coords.to_dataset().isel(at)
        gap, swept = gap_label(here), [NamedValue.of(here[name]) for name in other_parameters(here)]
        known = _threshold(static, here), swept, _floor_cost_ratio(where, exact), at, unjudged
        n_chaotic = int(reference["n_chaotic"])
        K_c, *walls = (float(here[n]) if n in here else np.nan for n in ("K_c", "j_1", "j_2"))
        in_metres = "j_1" in here and here["j_1"].attrs.get("units") == "m"
        contact = Contact(K_c, gap, floors, judged, *known, n_chaotic, in_metres)
        found.append((K_c, float(np.round(sum(walls), 12)), walls[0], contact))
    return [contact for *_, contact in sorted(found, key=lambda one: one[:-1])]


def of_worst(agreement: xr.Dataset) -> xr.Dataset:
    """The numbers of the worst coordinate of a system: the largest errors and the smallest shares.

    Other numbers are the same for all coordinates.
    """
    if COORDINATE not in agreement.dims:
        return agreement
    shares = [name for name in agreement if str(name).startswith(SHOWN["found"])]
    return agreement.max(COORDINATE).assign(agreement[shares].min(COORDINATE))


def telling(found: Sequence[Contact], most: int = MOST_CONTACTS) -> list[Contact]:
    """At most `most` cases, in their order, that differ most from the exact law or are chaotic.

    In turn the case with the largest error, with the largest share of attractors not found, and
    with the most chaotic points.
    """
    measures: list[Callable[[Contact], float]] = [
        lambda case: case.error, lambda case: case.lost, lambda case: case.n_chaotic,
    ]  # fmt: skip
    ranks = [
        sorted((case for case in found if measure(case) > 0), key=measure, reverse=True)
        for measure in measures
    ]
    ranked = dict.fromkeys(chain(*zip_longest(*ranks), found))
    chosen = set([case for case in ranked if case][:most])
    return [case for case in found if case in chosen]


def verdict(values: Values, floors: Values) -> list[str]:
    """The best verdict whose thresholds are met, at each end of the intervals; NaN meets none."""
    known, floor = (
        {name: np.where(np.isnan(v), v[0], v) for name, v in some.items()}
        for some in (values, floors)
    )
    median, p95, found = (known[name] for name in SHOWN)
    # Rare errors of the exact law excuse no law whose median error is large.
    is_near = median <= np.fmax(LIMITS["use"][0], floor["median"])
    error, share = (np.where(is_near, floor[name], np.nan) for name in ("p95", "found"))
    demands = {"exact here": (p95 <= error) & (found >= share)}
    for name, (largest, smallest) in LIMITS.items():
        demands[name] = (p95 <= np.fmax(largest, error)) & (found >= np.fmin(smallest, share))
    best: list[str] = np.select(list(demands.values()), list(demands), "no").tolist()
    return best


def shown_values(row: Row) -> Values:
    """Median, 95th percentile and attractors found of a law: value and ends of the interval."""
    values = {}
    for name, long in SHOWN.items():
        low, high = row[f"{long}_ci"]
        values[name] = np.array([row[long], *((high, low) if name == "found" else (low, high))])
    return values


def _floor_cost_ratio(where: Mapping[str, Row], exact: Sequence[str]) -> float:
    """Cost ratio of the exact law with other settings, the farthest from 1; NaN without."""
    ratios = [ratio for label in exact if np.isfinite(ratio := float(where[label][_COST_RATIO]))]
    return max(ratios, key=lambda ratio: abs(np.log(ratio)), default=np.nan)


def worst(exact: Sequence[Values]) -> Values:
    """Numbers of the exact law with other settings, at each end; NaN if it was not computed."""
    worst = {}
    for name in SHOWN:
        measured = [values[name] for values in exact if np.isfinite(values[name][0])]
        of_all = np.min if name == "found" else np.max  # NaN if an interval is not known
        worst[name] = of_all(measured, axis=0) if measured else np.full(3, np.nan)
    return worst


def _unjudged(exact: Row) -> str:
    """Reason why no law can be judged in a case; empty if laws can be judged."""
    if np.isnan(exact[SHOWN["found"]]):  # no attractors
        return "the exact law was not computed, or has no steady response"
    return "" if exact[_CONTACTS] else "no steady response of the exact law crosses a wall"


def _is_judged(law: Representation, row: Row) -> bool:
    """Whether a law has a verdict: the exact law has attractors, and user code has not failed."""
    is_broken = law.is_own and np.isnan(row[SHOWN["median"]])
    return not is_broken and bool(np.isfinite(row[SHOWN["found"]]))


def judged_law(law: Representation, row: Row, floors: Values, noise: float) -> Judged:
    """Verdict of a law in a case, every verdict possible within its intervals, and its cost."""
    values = shown_values(row)
    # The best end of a law with the worst end of the exact law's limit, and the worst with the
    # best: their intervals are independent.
    ends = verdict(values, {name: floor[[0, 2, 1]] for name, floor in floors.items()})
    numbers = [*values.values(), *floors.values()]
    is_known = not any(np.isnan(v[1:]).any() and np.isfinite(v[0]) for v in numbers)
    possible = frozenset(map(_column, ends) if is_known else COLUMNS)
    ratio = float(row[_COST_RATIO])
    costs = ratio, *widened(ratio, row[f"{_COST_RATIO}_ci"], noise), float(row["periodic"])
    return Judged(law, values, int(row["n_exact"]), ends[0], possible, *costs)


def _column(verdict: str) -> str:
    """The column of the table, in which "exact here" counts as "use"."""
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
    """Sentences: in which cases approximations are adequate, and cases without verdicts."""
    judged = [contact for contact in found if not contact.unjudged]
    sentences = _recommendation(judged) if judged else []
    for reason, n in Counter(c.unjudged for c in found if c.unjudged).items():
        sentences.append(f"Laws cannot be judged in {how_many(n, found)}: {reason}.")
    return sentences


def how_many(n: int, found: Sequence[Contact]) -> str:
    """The number `n` of some cases in words, as "3 of 8 cases"."""
    return "the only case" if len(found) == 1 else f"{n} of {len(found)} cases"


def _recommendation(found: Sequence[Contact]) -> list[str]:
    if any(contact.picks for contact in found):
        return [f"Approximations {_adequate(found)}: {_picked(found)}."]
    laws = [one for contact in found for one in contact.laws if one.is_approximation]
    is_open = any(contact.is_open for contact in found)
    how = "has been shown to be adequate" if is_open else "is adequate"
    return [f"Use the exact law: no approximation {how if laws else 'was computed'}."]


def _adequate(found: Sequence[Contact]) -> str:
    """Number of cases with adequate approximations, in words."""
    n_sure, n_open = sum(c.is_sure for c in found), sum(c.is_open for c in found)
    if not n_sure:
        return f"may be adequate in {how_many(n_open, found)}"
    more = f" ({n_open} undecided)" * bool(n_open)
    return f"are adequate in {how_many(n_sure, found)}{more}"


def _picked(found: Sequence[Contact]) -> str:
    """The cheapest adequate approximations in words, with the cases they are for."""
    groups: dict[tuple[str, ...], list[Contact]] = {}
    is_counted = len(found) > MOST_CONTACTS
    for contact in found:
        laws = (str(one.law) if is_counted else one.name for one in contact.picks)
        groups.setdefault(tuple(sorted(laws)), []).append(contact)
    if is_counted:
        groups = dict(sorted(groups.items(), key=lambda group: -len(group[1])))
    return "; ".join(_pick(laws, some, is_counted) for laws, some in groups.items())


def _pick(laws: tuple[str, ...], some: Sequence[Contact], is_counted: bool) -> str:
    alike: dict[tuple[str, str], list[Contact]] = {}
    for contact in some:
        alike.setdefault((contact.stiffness, contact.others), []).append(contact)
    places = " and ".join(
        " with ".join(several[0].walls([one.gap for one in several]))
        + (f" at {others}" if others else "")
        for (_, others), several in alike.items()
    )
    if is_counted:
        places = f"{len(some)} case{'s' * (len(some) > 1)}"
    none = "undecided" if any(one.is_open for one in some) else "none of those computed"
    names = " or ".join([", ".join(laws[:-1]), laws[-1]] if laws[1:] else laws)
    return f"{names or none} for {places}"


def consequence(name: str, verdict: str, p95: float, found: float) -> str:
    """Sentence: whether a law is accurate enough, and the two numbers that decide."""
    if verdict == "exact here":
        return f"{name} is not distinguishable from the exact law with other settings."
    means = {"use": "is accurate enough", "with care": "may be accurate enough, check it"}
    said = f"{name} {means.get(verdict, 'is too inaccurate')}: "
    if verdict == "use":
        errs, finds = "95 % of its amplitudes err by less than", f"finds {percent(found)}"
    else:
        errs, finds = "5 % of its amplitudes err by more than", f"misses {percent(1.0 - found)}"
    error = f"{errs} {percent(p95)}, and " if np.isfinite(p95) else ""
    return f"{said}{error}it {finds} of the attractors."


def times(cost_ratio: float) -> str:
    """A ratio of processor times, two digits."""
    if not np.isfinite(cost_ratio):
        return "–"
    digits = ".0f" if cost_ratio >= 9.95 else ".1f" if cost_ratio >= 0.95 else ".2g"
    return f"{cost_ratio:{digits}}\u00a0×"
