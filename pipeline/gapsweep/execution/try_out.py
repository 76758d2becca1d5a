"""First calls of a study's user code, in an isolated process.

A law is loaded and called at x = 0 before the computation. The client does both in this process
after an isolated process has survived them with the same snapshot. The isolated process also
compiles the law, if its points need that, and searches for jumps between the walls.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from gapsweep.errors import ModelError, StudyError
from gapsweep.execution.isolated import CallError, Isolated
from gapsweep.integrate.problem import Model, Models, Solver
from gapsweep.integrate.simulate import loaded
from gapsweep.model.oscillator import Gap
from gapsweep.model.own_law import OwnLaw, checked
from gapsweep.status import Status
from gapsweep.study.study import Study
from gapsweep.study.system_tables import in_words

LONGEST_TRIAL = 60.0  # s
SHORTEST_TRIAL = 10.0  # s, for imports and compilation, which no time limit of points includes
_MOST_GAPS = 100  # gaps in which jumps are searched for
_studies: list[Study] = []  # the study that an isolated process has loaded, for later calls


def try_out_system(function: str, path: Path) -> None:
    """Load a study, and make all systems of its user function, in an isolated process.

    Raises `StudyError` if the function ends its process or hangs. Other errors appear when the
    study is loaded.
    """
    with Isolated(LONGEST_TRIAL) as isolated:
        at = ""
        try:
            for some in isolated(_loads, path):
                at = f" at {in_words(some)}"
                isolated(_makes, some)
        except CallError as lost:
            if lost.status in (Status.KILLED, Status.TIMED_OUT):
                raise StudyError(f"{path}: system{at}: {function}: {lost.message}") from None


def _loads(path: Path) -> list[dict[str, float]]:
    """Load a study, and return the values at which it has systems."""
    study = Study.load(path)
    _studies[:] = [study]
    return study.model.swept(study.grid.axes, study.grid.requested)


def _makes(some: dict[str, float]) -> None:
    _studies[0].model.at(some)


def try_out(study: Study, timeout: float, say: Callable[[str], None]) -> None:
    """Import all user laws of a study, and call them, in an isolated process.

    Raises `StudyError` if a law ends the process, hangs, raises an error that is no `ModelError`,
    cannot be compiled although its points need that, or jumps.

    `timeout`: CPU time limit [s] of a point; the limit of a law here is this, but within 10 to 60
    s.
    `say`: called with a text before each step, with its time limit.
    """
    limit = min(max(timeout, SHORTEST_TRIAL), LONGEST_TRIAL)
    swept, axes = study.grid.representations, study.grid.axes
    compiled = {one.law for one in swept if study.solver(one).engine == "compiled"}
    gaps = study.grid.gaps[:_MOST_GAPS] if {"gap", "j_1"} & axes.keys() else (Gap(0.0, 0.0),)
    ends = {n: {min(axes[n]), max(axes[n])} for n in study.spec.parameters if n in axes}
    with Isolated(limit) as isolated:
        for label in study.own_laws:
            try:
                own = study.own_law(label)
            except ModelError:
                continue
            for step, function in (("importing {}", _imports), ("calling {}", _calls)):
                say(f"{step.format(label)} (timeout {limit:g} s)")
                try:
                    some = gaps if label in compiled else ()
                    isolated(function, own, study.model.default, some, ends)
                except CallError as lost:
                    if lost.status is Status.MODEL_INVALID and label in compiled:
                        raise StudyError(f"{study.source}: {lost.message}") from None
                    if lost.status is Status.MODEL_INVALID:
                        break  # the plan refuses it; in a history it is the status
                    why = lost.message
                    if lost.status is Status.TIMED_OUT and timeout < LONGEST_TRIAL:
                        why += f"; allow up to {LONGEST_TRIAL:g} s with --timeout"
                    where = f"{study.source}: {step.format(label)}"
                    raise StudyError(f"{where}: {why}") from None


def _imports(own: OwnLaw, *_: Any) -> None:
    own.load()


def _calls(own: OwnLaw, model: Model, gaps: Sequence[Gap], ends: Mapping[str, Any]) -> None:
    named = dict(checked(own).parameters)
    if gaps:
        laws = (own.law(0.0, Gap(0.0, 0.0)),) * len(model.contacts)
        loaded("compiled")(Models.of([model], [laws], np.ones(1)), Solver.of())
    for values in product(*(ends.get(name, (value,)) for name, value in named.items())):
        some = replace(own, parameters=tuple(zip(named, values, strict=True)))
        for gap in gaps:  # for compiled laws, which neither end a process nor raise
            some.law(0.0, gap)
