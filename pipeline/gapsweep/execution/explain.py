"""Explanations why sweep points are in the cache or missing, from identities of stored points."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.execution.plan import Plan
from gapsweep.quantities import UNITS, written
from gapsweep.store.maintenance import contents_of
from gapsweep.store.slab import Slab, Stored
from gapsweep.study.grid import Starts
from gapsweep.study.points import Points
from gapsweep.study.study import Study

# Fields in which two points differ, each with the requested and the stored value.
Differences = dict[str, tuple[str, str]]


@dataclass(frozen=True, slots=True)
class Explanation:
    """Stored status of one sweep point, or its differences from the nearest stored point.

    Attributes
    ----------
    label : str
        The point's coordinates.
    status : str
        Stored status, or ``"missing"``.
    host, message : str
        Machine and message of a stored result.
    differences : dict of str to (str, str)
        For a missing point, the fields in which the nearest stored one differs, each with the
        requested and the stored value.
    """

    label: str
    status: str
    host: str = ""
    message: str = ""
    differences: Differences | None = None


def explain(plan: Plan, limit: int) -> Iterator[Explanation]:
    """Explain the first points of a plan, at most `limit`."""
    study, cache = plan.study, plan.cache
    each = ((block, row) for block in plan.blocks() for row in range(len(block.keys)))
    points = list(islice(each, limit))
    nearest: dict[int, Differences] = {}
    missing = [number for number, (block, row) in enumerate(points) if block.status[row] < 0]
    if cache and missing:
        asked, previous = [], []
        for block, row in (points[number] for number in missing):
            asked.append(study.points(block.cells[[row]])[0][1])
            previous.append(block.previous(np.array([row])))
        for _, slab in cache.slabs():
            if (contents := contents_of(slab)) is not None:
                for number, one, before in zip(missing, asked, previous, strict=True):
                    found = _differing(one, before, slab, contents)
                    if number not in nearest or len(found) < len(nearest[number]):
                        nearest[number] = found
    for number, (block, row) in enumerate(points):
        label = _label(study, int(block.cells[row]))
        place = cache.place(block.keys[[row]]) if cache else None
        if place is not None:
            slab, contents, row_of_slab = place
            response = contents.responses.row(row_of_slab)
            yield Explanation(label, response.status.label, slab.host, response.message)
        else:
            yield Explanation(label, "missing", differences=nearest.get(number))


def _differing(
    asked: Points, previous: NDArray[np.void], slab: Slab, contents: Stored
) -> Differences:
    """Fields in which a requested point differs from the most similar point of a slab.

    For systems of another structure these are only fields that all points of the slab share.

    `asked`: the requested point.
    `previous`: shape (1,); key of the preceding point of its sweep; zero without one.
    `contents`: the points of the slab.
    Result: requested and stored value, by field.
    """
    differing = _differences(_fields(asked.kind.identity), _fields(slab.identity))
    stored, (numbers,) = contents.numbers, asked.numbers
    if stored.shape[1] != len(numbers):  # points of systems of another structure
        return differing
    unlike, is_other = stored != numbers, contents.previous != previous
    row = int(np.argmin(unlike.sum(axis=1) + is_other))
    for column in np.flatnonzero(unlike[row]).tolist():
        both = numbers[column].item(), stored[row, column].item()
        differing[asked.kind.numbers[column]] = repr(both[0]), repr(both[1])
    if is_other[row]:
        differing["previous"] = _hex(previous.tobytes()), _hex(contents.previous[row].tobytes())
    return differing


def _hex(key: bytes) -> str:
    return key.hex() if any(key) else "-"


def _label(study: Study, cell: int) -> str:
    grid, words = study.grid, []
    in_metres = grid.in_metres
    for (name, axis), at in zip(grid.axes.items(), np.unravel_index(cell, grid.shape), strict=True):
        value = grid.labels(name)[int(at)]
        if name == "representation":
            words.append(str(value))
        elif isinstance(axis, Starts):
            words.append(f"{name} {value}")
        elif name == "gap":
            words.append(f"gap {value} mm" if in_metres else f"gap {value}")
        else:
            unit = written(UNITS.get(name, "")) if in_metres else ""
            words.append(f"{name} = {value:g} {unit}".rstrip())
    return ", ".join(words)


def _fields(identity: str) -> dict[str, str]:
    """Fields of an identity by dotted name, as text; empty if it is not in a run's form."""
    try:
        whole = json.loads(identity)
        others = {name: whole[name] for name in ("numerics", "schema", "versions")}
        return dict(_flat("", {**whole["kind"], **others}))
    except (ValueError, TypeError, AttributeError, KeyError, RecursionError):
        return {}


def _flat(prefix: str, values: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _flat(f"{prefix}{name}.", value)
        else:
            yield prefix + name, str(value)


def _differences(asked: Mapping[str, str], stored: Mapping[str, str]) -> Differences:
    names = [name for name in {**asked, **stored} if asked.get(name) != stored.get(name)]
    return {name: (asked.get(name, "-"), stored.get(name, "-")) for name in names}
