"""Verdicts on claims, computed from the datasets of a run: ``claims.json``.

`gapsweep.study.claims` says what a test may ask for. A number is a statistic of one variable over a
selection. Its floor is the spread of the same number among the exact laws of the study (`piecewise`
and the labels of `gapsweep.analysis.floors`): what rounding alone can do to it. A test whose
threshold lies within the floor decides nothing; nor does one whose data are not there.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.analysis import ladders, metrics, static, timing
from gapsweep.analysis.floors import REFERENCE, floor_labels
from gapsweep.errors import StudyError
from gapsweep.status import Status
from gapsweep.study.claims import Claim, Number, Test, varied
from gapsweep.study.schema import (
    ATTRACTOR,
    ATTRACTOR_VARIABLES,
    MULTIPLIER,
    MULTIPLIERS,
    POINT_DIMS,
    VARIABLES,
)

CONFIRMED, REFUTED, PARTLY, UNDECIDABLE = "confirmed", "refuted", "partly", "undecidable"
VERDICTS = (CONFIRMED, REFUTED, PARTLY, UNDECIDABLE)

Datasets = Mapping[str, xr.Dataset]
Outcome = dict[str, Any]

_DURATION = "t_simulated"
_RESPONSES, _STATIC = "responses", "static"
_SHOWN = 3  # tests of a kind that a sentence quotes; all stand beside it
# Labels of numbers are found within this relative distance.
_SAME = 1e-9
_HOLDS: dict[str, Callable[[float, float], bool]] = {
    "<": lambda a, b: a < b,
    "<=": lambda a, b: a <= b,
    ">": lambda a, b: a > b,
    ">=": lambda a, b: a >= b,
}


class UndecidedError(Exception):
    """Why a test cannot be decided."""


@dataclass(frozen=True, slots=True)
class Value:
    """A number, how many values are in it, and how many of the selection had none."""

    value: float
    n: int
    n_missing: int


def known_variables() -> dict[str, dict[str, tuple[str, ...]]]:
    """Dimensions of every variable that a claim may name, by dataset."""
    scene = static.SCENE_DIMS
    return {
        "responses": dict.fromkeys(VARIABLES, POINT_DIMS),
        "attractors": {
            "n_attractors": POINT_DIMS[:4],
            **dict.fromkeys(ATTRACTOR_VARIABLES, (*POINT_DIMS[:4], ATTRACTOR)),
            **dict.fromkeys(MULTIPLIERS, (*POINT_DIMS[:4], ATTRACTOR, MULTIPLIER)),
        },
        "agreement": {name: metric.dims for name, metric in metrics.variables()},
        "static": {
            **dict.fromkeys(static.SCENE_VARIABLES, scene),
            **dict.fromkeys(static.CURVES, (*scene, "x")),
            **dict.fromkeys(static.LIST_VARIABLES, (*scene, static.EQUILIBRIUM)),
            **{name: dims for name, (dims, _) in ladders.LADDER.items()},
        },
        "timing": {
            f"{name}_{statistic}": POINT_DIMS[:3]
            for name in timing.COSTS
            for statistic in ("mean", "median")
        },
    }


def check_variables(claims: Iterable[Claim], source: str) -> None:
    """Refuse claims that name variables or dimensions which no dataset has.

    Raises
    ------
    StudyError
        One line per problem.
    """
    known = known_variables()
    problems = []
    for claim in claims:
        for test in claim.test:
            for number in _numbers(test):
                where = f"{source}: claim {claim.id}: test.number"
                named = (number.variable, number.weight, *number.where)
                for name in (name for name in named if name):
                    dims = known[number.data].get(name)
                    if dims is None:
                        problems.append(f"{where}.variable = {name!r}: not in {number.data}.nc")
                        continue
                    for key, selected in (("at", number.at), ("range", number.range)):
                        problems += [
                            f"{where}.{key}.{dim}: {name} has no such dimension"
                            for dim in selected
                            if dim not in dims
                        ]
    if problems:
        raise StudyError(list(dict.fromkeys(problems)))


def verdicts(claims: Iterable[Claim], datasets: Datasets) -> dict[str, Any]:
    """Decide claims.

    Parameters
    ----------
    claims : iterable of Claim
    datasets : mapping of str to Dataset
        By name without suffix; claims that need one which is absent are undecidable.

    Returns
    -------
    dict
        ``claims``, one entry per claim with its verdict, sentence and tests, and ``counts`` by
        verdict; fit for JSON.
    """
    claims = list(claims)
    loaded = _loaded(claims, datasets)
    decided = [_decided(claim, loaded) for claim in claims]
    counts = Counter(entry["verdict"] for entry in decided)
    return {"counts": {verdict: counts[verdict] for verdict in VERDICTS}, "claims": decided}


def _loaded(claims: list[Claim], datasets: Datasets) -> Datasets:
    """The variables that claims name, in memory: each is used many times."""
    used: dict[str, set[str]] = {name: set() for name in datasets}
    used.setdefault(_RESPONSES, set()).add("status")
    for number in (n for claim in claims for test in claim.test for n in _numbers(test)):
        named = (number.variable, number.weight, *number.where, _DURATION)
        used.setdefault(number.data, set()).update(named)
    return {
        name: dataset[[variable for variable in used[name] if variable in dataset]].load()
        for name, dataset in datasets.items()
    }


def _numbers(test: Test) -> list[Number]:
    return [test.number, *(varied(test.number, changes) for changes in test.changes)]


def _decided(claim: Claim, datasets: Datasets) -> Outcome:
    tests = [outcome(test, datasets) for test in claim.test]
    verdict = _verdict(claim, [test["holds"] for test in tests])
    return {
        "id": claim.id,
        "place": claim.place,
        "claim": claim.text,
        "verdict": verdict,
        "sentence": _sentence(claim, verdict, tests),
        "why": claim.why,
        "tests": tests,
    }


def _verdict(claim: Claim, holds: list[bool | None]) -> str:
    if not holds:
        return UNDECIDABLE
    yes, no = True in holds, False in holds
    if claim.combine == "any":
        if yes:
            return CONFIRMED
        return UNDECIDABLE if None in holds else REFUTED
    if yes and no:
        return PARTLY  # whatever the undecided ones would say
    if None in holds:
        return UNDECIDABLE
    return CONFIRMED if yes else REFUTED


def _sentence(claim: Claim, verdict: str, tests: list[Outcome]) -> str:
    if not tests:
        return f"Not stated in the paper: {claim.undecidable}"
    parts = []
    for name, holds in (("holds", True), ("does not hold", False), ("open", None)):
        some = [_shown(test) for test in tests if test["holds"] is holds]
        if some:
            more = [f"and {len(some) - _SHOWN} more"] if len(some) > _SHOWN else []
            parts.append(f"{name} ({len(some)} of {len(tests)}): {'; '.join(some[:_SHOWN] + more)}")
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}."


def _shown(test: Outcome) -> str:
    if test["holds"] is None:
        return f"{test['says']} ({test['reason']})"
    floor = f", floor {test['floor']:.2g}" if test["floor"] else ""
    return f"{test['says']} ({test['found']}{floor})"


def outcome(test: Test, datasets: Datasets) -> Outcome:
    """Decide one test: whether it `holds` (None: undecided), and the numbers."""
    result: Outcome = {
        "says": test.says,
        "kind": test.kind,
        "holds": None,
        "value": None,
        "values": [],
        "op": test.op if test.kind == "compare" else None,
        "threshold": test.threshold,
        "floor": None,
        "n": 0,
        "n_missing": 0,
        "found": "",
        "reason": "",
    }
    numbers = [varied(test.number, changes) for changes in test.changes]
    if test.kind == "compare":
        numbers.insert(0, test.number)
    try:
        values = [evaluated(number, datasets) for number in numbers]
        result["values"] = [_finite(v.value) for v in values]
        result["n"] = sum(v.n for v in values)
        result["n_missing"] = sum(v.n_missing for v in values)
        found = [v.value for v in values]
        if test.kind == "order":
            _decide_order(numbers, found, datasets, result)
        else:
            _decide_threshold(test, numbers, found, datasets, result)
    except UndecidedError as undecided:
        result["reason"] = str(undecided)
    result["value"], result["floor"] = _finite(result["value"]), _finite(result["floor"])
    return result


def _decide_order(
    numbers: list[Number], found: list[float], datasets: Datasets, result: Outcome
) -> None:
    result["found"] = ", ".join(f"{v:.3g}" for v in found)
    floors = [_floor(number, datasets) for number in numbers]
    result["floor"] = max(floors)
    differences = np.diff(found)
    if np.all(differences > result["floor"]):
        result["holds"] = True
    elif np.any(differences < -result["floor"]) or result["floor"] == 0.0:
        result["holds"] = False
    else:
        raise UndecidedError(
            f"{result['found']}: a difference lies within the floor {result['floor']:.2g}"
        )


def _decide_threshold(
    test: Test, numbers: list[Number], found: list[float], datasets: Datasets, result: Outcome
) -> None:
    assert test.threshold is not None, "checked when the claims were read"
    floors = [_floor(number, datasets) for number in numbers]
    value, floor = _combined(test, found, floors)
    op = test.op if test.kind == "compare" else "<="
    result["value"], result["floor"] = value, floor
    if len(numbers) == 1 and test.number.data == "agreement":
        # A distance from the exact law: the floor must be nearer to it than the threshold is.
        ideal = evaluated(_of(test.number, REFERENCE), datasets).value
        margin = abs(test.threshold - ideal)
    else:
        margin = abs(value - test.threshold)
    holds = _HOLDS[op](value, test.threshold)
    result["found"] = f"{value:.3g}{'' if holds else ', not'} {op} {test.threshold:.3g}"
    if floor != 0.0 and not floor < margin:
        raise UndecidedError(
            f"{value:.3g} against {test.threshold:.3g}: the floor, {floor:.2g}, is not below the "
            "distance of the threshold"
        )
    result["holds"] = holds


def _combined(test: Test, found: list[float], floors: list[float]) -> tuple[float, float]:
    """The number that is compared with the threshold, and its floor."""
    if len(found) == 1:
        return found[0], floors[0]
    if test.kind == "alike":
        low, high = min(found), max(found)
        value = high / low if low > 0.0 else (1.0 if high == low else math.inf)
        return value, value * max(floors) / low if low > 0.0 else max(floors)
    ours, other = found
    if test.by == "difference":
        return ours - other, max(floors)
    if other == 0.0:
        raise UndecidedError(f"the ratio of {ours:.3g} to 0 is not defined")
    value = ours / other
    # The first order of what both floors can do to the ratio.
    return value, (floors[0] + abs(value) * floors[1]) / abs(other)


def _floor(number: Number, datasets: Datasets) -> float:
    """Spread of a number among the exact laws; 0 for what comes from forces alone.

    Raises
    ------
    UndecidedError
        If there are no exact laws to compare at this selection.
    """
    if number.data == _STATIC:
        return 0.0
    labels = _floor_labels(datasets)
    spreads = []
    try:
        exact = evaluated(_of(number, REFERENCE), datasets).value
        for label in labels:
            spreads.append(abs(evaluated(_of(number, label), datasets).value - exact))
    except UndecidedError as undecided:
        raise UndecidedError(f"no floor: {undecided}") from None
    if not spreads:
        raise UndecidedError("no floor: the study has no second exact law")
    return max(spreads)


def _floor_labels(datasets: Datasets) -> list[str]:
    responses = datasets.get(_RESPONSES)
    if responses is None:
        return []
    labels = [str(label) for label in responses["representation"].values]
    return floor_labels(responses.attrs.get("study_json", ""), labels)


def _of(number: Number, representation: str) -> Number:
    return varied(number, {"at": {"representation": representation}})


def evaluated(number: Number, datasets: Datasets) -> Value:
    """Compute a number.

    Raises
    ------
    UndecidedError
        If the dataset, a variable or the selection is not there, or holds no value.
    """
    dataset = _selected(number, datasets)
    counts = _counted(number, dataset, datasets)
    if number.statistic == "share":
        return _share(number, dataset, counts)
    if number.statistic == "first":
        hits = (_conditions(number, dataset) & counts).any(
            [d for d in counts.dims if d != number.along]
        )
        reached = hits[number.along].values[hits.values]
        if not reached.size:
            raise UndecidedError(f"no {number.along} fulfils the condition")
        return Value(float(np.min(reached)), hits.size, 0)
    asked, values = xr.broadcast(counts, dataset[number.variable])
    if number.per_period:
        values = values / (dataset[_DURATION] * dataset["omega"])
    values = abs(values) if number.absolute else values
    n_missing = int((asked & values.isnull()).sum())
    if number.missing == "worst":
        values = values.fillna(np.inf)
    values = values.where(asked & _conditions(number, dataset))
    finite = int(values.notnull().sum())
    if not finite:
        raise UndecidedError(f"{number.variable} has no value at {_place(number)}")
    if number.along:
        return Value(_along(number, values), finite, n_missing)
    if number.statistic == "only":
        if values.size != 1:
            raise UndecidedError(
                f"{number.variable}: {values.size} numbers at {_place(number)}, not one"
            )
        return Value(float(values.values.item()), 1, 0)
    flat = values.values.ravel()
    return Value(_STATISTICS[number.statistic](flat[~np.isnan(flat)]), finite, n_missing)


_STATISTICS: dict[str, Callable[[NDArray[Any]], float]] = {
    "mean": lambda v: float(np.mean(v)),
    "sum": lambda v: float(np.sum(v)),
    "median": lambda v: float(np.median(v)),
    "p95": lambda v: float(np.quantile(v, 0.95)),
    "max": lambda v: float(np.max(v)),
    "min": lambda v: float(np.min(v)),
}


def _share(number: Number, dataset: xr.Dataset, counts: xr.DataArray) -> Value:
    hits = _conditions(number, dataset)
    if number.weight:
        weights = dataset[number.weight].where(hits).sum(number.any_over)
        counts = counts.any(number.any_over) if number.any_over in counts.dims else counts
        n = int(counts.sum())
        total = float(weights.where(counts).sum())
    else:
        hits, counts = xr.broadcast(hits & counts, counts)
        if number.any_over:
            hits, counts = hits.any(number.any_over), counts.any(number.any_over)
        n, total = int(counts.sum()), float(hits.sum())
    if not n:
        raise UndecidedError(f"nothing was asked for at {_place(number)}")
    return Value(total / n, n, 0)


def _along(number: Number, values: xr.DataArray) -> float:
    others = [dim for dim in values.dims if dim != number.along]
    line = values.max(others) if number.statistic == "argmax" else values.mean(others)
    there = line.notnull().values
    coordinate, height = line[number.along].values[there], line.values[there]
    if number.statistic == "argmax":
        return float(coordinate[np.argmax(height)])
    if height.size < 2:
        raise UndecidedError(f"{number.variable}: fewer than two values along {number.along}")
    if number.statistic == "largest_rise":
        return float(np.max(height[1:] / height[:-1])) - 1.0
    if np.any(height <= 0.0):
        raise UndecidedError(f"{number.variable}: not positive along {number.along}, no slope")
    return float(np.polyfit(np.log(coordinate.astype(float)), np.log(height), 1)[0])


def _selected(number: Number, datasets: Datasets) -> xr.Dataset:
    """The variables of a number over its selection."""
    dataset = datasets.get(number.data)
    if dataset is None:
        raise UndecidedError(f"no {number.data}.nc in this run")
    wanted = [n for n in (number.variable, number.weight, *number.where) if n]
    wanted += ["status"] if number.data == _RESPONSES else []
    wanted += [_DURATION] if number.per_period else []
    missing = [name for name in wanted if name not in dataset]
    if missing:
        raise UndecidedError(f"{number.data}.nc has no {', '.join(missing)}")
    return _cut(number, dataset[list(dict.fromkeys(wanted))])


def _cut(number: Number, dataset: xr.Dataset) -> xr.Dataset:
    for dim, label in number.at.items():
        if dim in dataset.dims:
            dataset = dataset.isel({dim: _positions(dim, dataset[dim].values, label)})
    for dim, (low, high) in number.range.items():
        if dim in dataset.dims:
            axis = dataset[dim].values
            slack = _SAME * max(abs(low), abs(high))
            dataset = dataset.isel(
                {dim: np.flatnonzero((axis >= low - slack) & (axis <= high + slack))}
            )
    if number.every is not None and "omega" in dataset.dims:
        steps = dataset["omega"].values / number.every
        dataset = dataset.isel(omega=np.flatnonzero(np.abs(steps - np.round(steps)) < 1e-6))
    if number.start != "all" and "initial_condition" in dataset.dims:
        dataset = dataset.isel(initial_condition=np.flatnonzero(_starts(number.start, dataset)))
    empty = [str(dim) for dim, size in dataset.sizes.items() if not size]
    if empty:
        raise UndecidedError(f"the study has no {', '.join(empty)} at {_place(number)}")
    return dataset


def _starts(which: str, dataset: xr.Dataset) -> NDArray[np.bool_]:
    kind = dataset["start"].values
    fixed = kind == "fixed"
    rest = fixed & (dataset["x_0"].values == 0.0) & (dataset["v_0"].values == 0.0)
    groups = {"rest": rest, "fixed": fixed, "scattered": fixed & ~rest}
    chosen: NDArray[np.bool_] = groups.get(which, kind == which)
    return chosen


def _positions(dim: str, axis: NDArray[Any], wanted: Any) -> Any:
    """Where labels stand on an axis: a position for one, a list for several."""
    if isinstance(wanted, list):
        return [_positions(dim, axis, one) for one in wanted]
    if isinstance(wanted, str):
        at = np.flatnonzero(axis.astype(str) == wanted)
    elif axis.dtype.kind in "iuf":
        at = np.flatnonzero(np.abs(axis - wanted) <= _SAME * abs(wanted))
    else:
        at = np.array([], dtype=int)
    if not at.size:
        raise UndecidedError(f"the study has no {dim} = {wanted}")
    return int(at[0])


def _counted(number: Number, dataset: xr.Dataset, datasets: Datasets) -> xr.DataArray:
    """Which cells of a selection were asked for."""
    if number.data == _RESPONSES:
        return dataset["status"] != Status.NOT_REQUESTED
    responses = datasets.get(_RESPONSES)
    if responses is None or "omega" not in dataset.dims:
        return xr.DataArray(True)
    asked = _cut(number, responses[["status"]])["status"] != Status.NOT_REQUESTED
    if "initial_condition" not in dataset.dims:
        asked = asked.any("initial_condition")
    return asked.drop_vars(("j_1", "j_2"), errors="ignore")


def _conditions(number: Number, dataset: xr.Dataset) -> xr.DataArray:
    met = xr.DataArray(True)
    for name, condition in number.where.items():
        ((relation, wanted),) = condition.items()
        values = dataset[name]
        if relation == "above":
            met = met & (values > wanted)
        elif relation == "below":
            met = met & (values < wanted)
        elif relation == "outside":
            met = met & ((values < wanted[0]) | (values > wanted[1]))
        else:
            listed = wanted if relation == "in" else [wanted]
            met = met & values.isin([_flag(values, one) for one in listed])
    return met


def _flag(values: xr.DataArray, wanted: Any) -> Any:
    """The number that stands for a flag's meaning; anything else as it is."""
    meanings = str(values.attrs.get("flag_meanings", "")).split()
    if isinstance(wanted, str) and meanings:
        if wanted not in meanings:
            raise UndecidedError(f"{values.name} has no meaning {wanted!r}")
        return np.ravel(values.attrs["flag_values"])[meanings.index(wanted)]
    return wanted


def _place(number: Number) -> str:
    parts = [f"{dim} {label}" for dim, label in number.at.items()]
    parts += [f"{dim} {low:g} to {high:g}" for dim, (low, high) in number.range.items()]
    parts += [f"start {number.start}"] if number.start != "all" else []
    return ", ".join(parts) or "any place"


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None
