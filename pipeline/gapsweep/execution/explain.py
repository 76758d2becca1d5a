"""Why a sweep point is a hit or a miss: its identity against what is stored."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from gapsweep.execution.plan import Plan
from gapsweep.store.cache import DAMAGED, Cache
from gapsweep.study.study import Index, Study


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
    fields: dict[bytes, dict[str, str]] = {}
    for number in range(min(plan.n_points, limit)):
        label = _label(study, plan.index(number))
        row = cache.rows([plan.keys[number]]).get(plan.keys[number])
        if row is not None:
            response = row.response
            yield Explanation(label, response.status.label, row.host, response.message)
            continue
        fields = fields or {key: _fields(text) for key, text, *_ in cache.records()}
        asked = _fields(study.point(plan.index(number)).identity(_previous(plan, number)))
        nearest = min(
            (_differences(asked, stored) for stored in fields.values()), key=len, default=None
        )
        status = "damaged" if plan.status[number] == DAMAGED else "missing"
        yield Explanation(label, status, differences=nearest)


def _previous(plan: Plan, number: int) -> str | None:
    return None if number in plan.chain_starts else plan.keys[number - 1].hex()


def _label(study: Study, index: Index) -> str:
    grid = study.grid
    r, k, g, w, i = index
    return (
        f"{grid.representations[r]}, K_c = {grid.K_c[k]:g} N/m, gap {grid.gaps[g].label} mm, "
        f"omega = {grid.omega[w]:g} Hz, initial_condition {i}"
    )


def _fields(identity: str) -> dict[str, str]:
    """An identity's fields by dotted name, as text; none if a run cannot have written it."""
    try:
        whole = json.loads(identity)
        # Format 1 kept the point alone.
        return dict(_flat("", whole.get("point", whole))) | {
            name: str(whole[name]) for name in ("numerics", "previous", "schema") if name in whole
        }
    except (ValueError, TypeError, AttributeError, RecursionError):
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
