"""Stored results computed a second time, to see whether they still come out the same."""

from dataclasses import fields
from typing import Any

from gapsweep.execution.alone import Alone, CallError, response_of
from gapsweep.execution.task import REST
from gapsweep.response.ensemble import State
from gapsweep.response.result import Response
from gapsweep.store.cache import Cache
from gapsweep.study.points import OURS, Point, law_code, point_of


def differences(cache: Cache, key: bytes, alone: Alone) -> list[str]:
    """Names of the values of a stored result that come out otherwise now; `cpu_time` may."""
    row = cache.rows([key])[key]
    try:
        point, previous = point_of(row.identity)
    except (ValueError, TypeError, KeyError, AttributeError):
        return ["identity"]  # whoever wrote this, it was not a run
    if not _is_current(point, alone):
        return []
    again = response_of(alone, point, _start(cache, previous))
    names = [field.name for field in fields(Response) if field.name not in ("cpu_time", "message")]
    return [n for n in names if not _same(getattr(again, n), getattr(row.response, n))]


def _is_current(point: Point, alone: Alone) -> bool:
    """Whether the user's own law of a point, if it has one, is still the one that computed it."""
    if point.law_code == OURS:
        return True
    try:
        return point.law_code == alone(law_code, point.representation)
    except CallError:  # it has gone, or does to its process what it did not when it was stored
        return False


def _start(cache: Cache, previous: str | None) -> State:
    """Where the sweep that leads to a point had got to."""
    while previous is not None:
        row = cache.rows([bytes.fromhex(previous)]).get(bytes.fromhex(previous))
        if row is None:
            return REST
        if row.response.ended:
            return row.response.x_end, row.response.v_end
        previous = point_of(row.identity)[1]
    return REST


def _same(a: Any, b: Any) -> bool:
    return bool(a == b) or (a != a and b != b)
