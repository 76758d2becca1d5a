"""Representations that compare the exact law with itself: the reproducibility limit of metrics.

Two runs of the exact law differ where rounding selects among attractors or samples chaos. A study
can define protocols that measure this, such as ::

    [protocol.half]
    rtol = 5e-10
    atol = 5e-13
    [protocol.jitter]
    start_jitter = 1e-9

and sweep ``piecewise@half`` and ``piecewise@jitter``. The worst of their values is then stored with
every metric; smaller differences between two laws are not significant.
"""

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from gapsweep.integrate.problem import Solver
from gapsweep.model.labels import EXACT, Representation

# Largest shift [m] of an initial displacement that counts as noise.
_LARGEST_JITTER = 1e-8


def floor_labels(study_json: str, labels: Sequence[str]) -> list[str]:
    """Labels ``piecewise@NAME`` that measure reproducibility.

    The protocol NAME differs from ``[solver]`` only in tighter tolerances or a `start_jitter` of at
    most 1e-8 m. Labels with any other protocol are ordinary representations.

    `study_json`: the checked study, as in the attribute of ``responses.nc``; empty if there is
    none.
    """
    study = json.loads(study_json) if study_json else {}
    plain, protocols = study.get("solver", {}), study.get("protocol", {})
    return [
        one
        for one in map(Representation, labels)
        if one.law == EXACT
        and one.protocol in protocols
        and _is_floor(plain, protocols[one.protocol])
    ]


def _is_floor(plain: dict[str, Any], protocol: dict[str, Any]) -> bool:
    usual, usual_jitter = _solver(plain)
    other, jitter = _solver({**plain, **protocol})
    same_method = replace(other, rtol=usual.rtol, atol=usual.atol) == usual
    # The default of atol is rtol times a length of about a millimetre.
    atols = [each.atol or 1e-3 * each.rtol for each in (other, usual)]
    not_looser = other.rtol <= usual.rtol and atols[0] <= atols[1]
    # A protocol that changes nothing has the same points, whose differences are 0 by definition.
    changed = other != usual or jitter != usual_jitter
    return same_method and not_looser and changed and abs(jitter) <= _LARGEST_JITTER


def _solver(table: dict[str, Any]) -> tuple[Solver, float]:
    settings = dict(table)
    jitter = float(settings.pop("start_jitter", 0.0))
    return Solver.of(**settings), jitter
