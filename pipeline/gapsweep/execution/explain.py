"""Why a sweep point is a hit or a miss: its identity against what is stored."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.execution.plan import Plan
from gapsweep.store.cache import Cache
from gapsweep.store.index import DAMAGED
from gapsweep.store.maintenance import contents_of, readable
from gapsweep.store.slab import Slab, Stored
from gapsweep.study.grid import Starts
from gapsweep.study.points import KEY, NUMBERS
from gapsweep.study.study import Study

# As engineers write them.
UNITS = {
    **{"K_c": "N/m", "j_1": "m", "j_2": "m", "omega": "Hz", "omega_n": "Hz"},
    **{"mass": "kg", "alpha": "N/m³", "forcing": "N"},
}


@dataclass(frozen=True, slots=True)
class Explanation:
    """What is stored of one sweep point.

    Attributes
    ----------
    label : str
        The point's coordinates.
    status : str
        Stored status, ``"missing"`` or ``"damaged"``.
    host, message : str
        Of a stored result.
    differences : mapping of str to (str, str)
        For a missing point, the fields in which the nearest stored one differs: what is asked
        for, and what is stored.
    """

    label: str
    status: str
    host: str = ""
    message: str = ""
    differences: Mapping[str, tuple[str, str]] | None = None


def explain(study: Study, plan: Plan, cache: Cache, limit: int) -> Iterator[Explanation]:
    """Explain the first points of a plan, at most `limit` of them."""
    asked = [_Asked.of(study, plan, number) for number in range(min(plan.n_points, limit))]
    missing = [one for one in asked if plan.status[one.number] < 0]
    if missing:
        for slab in readable(cache):
            if (contents := contents_of(slab)) is not None:
                for one in missing:
                    one.compare(slab, contents)
    for one in asked:
        place = cache.place(plan.keys[[one.number]])
        if place is not None:
            slab, contents, row = place
            response = contents.responses.row(row)
            yield Explanation(one.label, response.status.label, slab.host, response.message)
        else:
            status = "damaged" if plan.status[one.number] == DAMAGED else "missing"
            yield Explanation(one.label, status, differences=one.nearest)


@dataclass(slots=True, eq=False)
class _Asked:
    """A point that is asked for, and in what the nearest stored one differs from it.

    Attributes
    ----------
    number : int
        Of the point in the plan.
    label : str
    identity : dict of str to str
        Fields that it shares with others of its kind, by dotted name.
    numbers : ndarray, shape (11,)
    previous : bytes
    nearest : dict of str to (str, str), or None if nothing is stored
    """

    number: int
    label: str
    identity: dict[str, str]
    numbers: NDArray[np.float64]
    previous: bytes
    nearest: dict[str, tuple[str, str]] | None = None

    @classmethod
    def of(cls, study: Study, plan: Plan, number: int) -> "_Asked":
        ((_, points),) = study.points(plan.cells[[number]])
        previous = plan.previous(np.array([number])).tobytes()
        label = _label(study, int(plan.cells[number]))
        return cls(number, label, _fields(points.kind.identity), points.numbers[0], previous)

    def compare(self, slab: Slab, contents: Stored) -> None:
        """Take the point of a slab that differs in the fewest fields, if none so far is nearer."""
        differing = _differences(self.identity, _fields(slab.identity))
        unlike = contents.numbers != self.numbers
        is_other = contents.previous != np.frombuffer(self.previous, KEY)
        row = int(np.argmin(unlike.sum(axis=1) + is_other))
        for column in np.flatnonzero(unlike[row]).tolist():
            both = self.numbers[column].item(), contents.numbers[row, column].item()
            differing[NUMBERS[column]] = repr(both[0]), repr(both[1])
        if is_other[row]:
            differing["previous"] = _hex(self.previous), _hex(contents.previous[row].tobytes())
        if self.nearest is None or len(differing) < len(self.nearest):
            self.nearest = differing


def _hex(key: bytes) -> str:
    return key.hex() if any(key) else "-"


def _label(study: Study, cell: int) -> str:
    grid, words = study.grid, []
    for (name, axis), at in zip(grid.axes.items(), np.unravel_index(cell, grid.shape), strict=True):
        value = grid.labels(name)[int(at)]
        if name == "representation":
            words.append(str(value))
        elif isinstance(axis, Starts):
            words.append(f"{name} {value}")
        elif name == "gap":
            words.append(f"gap {value} mm")
        else:
            unit = UNITS.get(name, "")
            words.append(f"{name} = {value:g} {unit}".rstrip())
    return ", ".join(words)


def _fields(identity: str) -> dict[str, str]:
    """An identity's fields by dotted name, as text; none if a run cannot have written it."""
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


def _differences(asked: Mapping[str, str], stored: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    names = [name for name in {**asked, **stored} if asked.get(name) != stored.get(name)]
    return {name: (asked.get(name, "-"), stored.get(name, "-")) for name in names}
