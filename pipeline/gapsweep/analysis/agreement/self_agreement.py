"""Which representations compare the exact law with itself: the floor of every metric.

Two runs of the exact law differ too, where rounding chooses among attractors or samples chaos. A
study that defines protocols for it, such as ::

    [protocol.half]
    rtol = 5e-10
    atol = 5e-13
    [protocol.jitter]
    start_jitter = 1e-9

and sweeps ``piecewise@half`` and ``piecewise@jitter``, gets the worst of their values beside every
metric: a smaller difference between two laws means nothing.
"""

import json
from typing import Any

from gapsweep.integrate.problem import Solver
from gapsweep.model.labels import EXACT

# A start moved by more [m] is another start.
_LARGEST_JITTER = 1e-8


def floor_labels(study_json: str, labels: list[str]) -> list[str]:
    """Labels ``piecewise@NAME`` that are meant as a floor.

    The protocol NAME differs from ``[solver]`` by nothing but tolerances that are tighter, or a
    `start_jitter` of at most 1e-8 m. Others, such as a looser one, are representations like any.

    Parameters
    ----------
    study_json : str
        The checked study, as in the attribute of ``responses.nc``; empty if there is none.
    labels : list of str
    """
    study = json.loads(study_json) if study_json else {}
    plain, protocols = study.get("solver", {}), study.get("protocol", {})
    found = []
    for label in labels:
        law, _, name = label.partition("@")
        if law == EXACT and name in protocols and _is_floor(plain, protocols[name]):
            found.append(label)
    return found


def _is_floor(plain: dict[str, Any], protocol: dict[str, Any]) -> bool:
    usual, usual_jitter = _solver(plain)
    other, jitter = _solver({**plain, **protocol})
    same_method = (other.engine, other.controller, other.restart) == (
        usual.engine,
        usual.controller,
        usual.restart,
    )
    not_looser = other.rtol <= usual.rtol and other.atol <= usual.atol
    # A protocol that changes nothing names the same points: a floor of 0 that means nothing.
    changed = other != usual or jitter != usual_jitter
    return same_method and not_looser and changed and abs(jitter) <= _LARGEST_JITTER


def _solver(table: dict[str, Any]) -> tuple[Solver, float]:
    settings = dict(table)
    jitter = float(settings.pop("start_jitter", 0.0))
    return Solver.of(**settings), jitter
