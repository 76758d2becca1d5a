"""The table of cells: every method with every tolerance on every scenario.

A cell holds the errors, the counts and the outcome of one run. `work_precision` and `stability`
write parts of this table.
"""

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from queue import SimpleQueue
from typing import Any

import numpy as np
import xarray as xr

from gapsweep.analysis.bench.judge import CellOutcome, Judge, judge, observed
from gapsweep.analysis.bench.scenarios import Method, Scenario, coordinates, law_or_none, tolerances
from gapsweep.analysis.datasets.contact_errors import in_gap
from gapsweep.execution.isolated import CallError, Isolated
from gapsweep.model.contact import ContactLaw, Piecewise
from gapsweep.model.equilibria import equilibria, linear_stiffness, restoring_slope
from gapsweep.model.labels import EXACT
from gapsweep.model.oscillator import Oscillator
from gapsweep.status import Status
from gapsweep.variables import STATUS_FLAGS, Variable, empty, with_attributes

Say = Callable[[str], None]
CELL, PAIR, SCENE = ("scene", "method", "tolerance"), ("scene", "method"), ("scene",)
OUTCOME_FLAGS = tuple((outcome.name.lower(), int(outcome)) for outcome in CellOutcome)
_cell, _pair, _scene = (partial(Variable, dims=dims) for dims in (CELL, PAIR, SCENE))
VARIABLES = {
    "outcome": _cell("i1", "1", "outcome of the run", CellOutcome.NOT_REQUESTED, OUTCOME_FLAGS),
    "status": _cell("i1", "1", "status of the motion", Status.NOT_REQUESTED, STATUS_FLAGS),
    "solver_error": _cell("f8", "1", "deviation from the reference solution of the same law"),
    "total_error": _cell("f8", "1", "deviation from the reference solution of the exact law"),
    "allowed_error": _cell("f8", "1", "solver error above which a run counts as wrong"),
    "bounded_error": _cell("f8", "1", "total_error, or an upper bound if it is not measurable"),
    "at_reference_floor": _cell("i1", "1", "whether total_error is too small to be measured", 0),
    "event_time_error": _cell("f8", "s", "largest deviation of a contact time"),
    "nfev": _cell("i8", "1", "right-hand-side evaluations", 0),
    "n_steps": _cell("i8", "1", "accepted steps", 0),
    "n_rejected": _cell("i8", "1", "rejected steps", 0),
    "n_contacts": _cell("i8", "1", "wall crossings, in and out", 0),
    "layer_over_step": _cell(
        "f8", "1", "thickness of the smoothing layer over the mean length of a step"
    ),
    "model_error": _pair(
        "f8", "1", "largest deviation of the law's reference from the exact law's"
    ),
    "reference_distance": _pair(
        "f8", "1", "distance of two independent tight solutions of the law"
    ),
    "growth": _pair("f8", "1", "largest growth of a disturbance of the initial state"),
    "n_wells": _pair("i4", "1", "stable equilibria of the law", 0),
    "in_gap_frequency": _pair(
        "f8", "Hz", "frequency of small motions about the middle of the gap, NaN if unstable"
    ),
    "n_wells_exact": _scene("i4", "1", "stable equilibria of the exact law", 0),
    "stiffness_ratio": _scene("f8", "1", "stiffness in contact over that in the gap"),
    "n_periods": _scene("i4", "1", "compared forcing periods", 0),
}


def sizes(scenarios: Sequence[Scenario], methods: Sequence[Method]) -> dict[str, int]:
    """Sizes of the dimensions scenario, method and tolerance of a table."""
    longest = max(len(method.rungs) for method in methods)
    return {"scene": len(scenarios), "method": len(methods), "tolerance": longest}


def cell_table(
    scenarios: Sequence[Scenario],
    methods: Sequence[Method],
    timeout: float,
    say: Say,
) -> dict[str, Any]:
    """Compute every cell of a table; returns the arrays of `VARIABLES` by name.

    Several scenarios are computed in as many processes as there are processors; a single one in
    this process, user laws excepted.

    Parameters
    ----------
    timeout : float
        Processor time [s] of a scenario, and of a user law in a scenario. Cells that take longer
        have the status `timed_out`.
    say : callable
        Called with a line of text before each scenario.
    """
    arrays = empty(VARIABLES, sizes(scenarios, methods))
    arrays["n_periods"][:] = [scenario.n_periods for scenario in scenarios]
    tasks = [
        (s, scenario, some)
        for s, scenario in enumerate(scenarios)
        for some in _groups(scenario, methods)
    ]
    is_alone = len(scenarios) == 1
    computed = _computed(tasks, timeout, is_alone, say)
    for (s, _, some), found in zip(tasks, computed, strict=True):
        if isinstance(found, Status):
            lost = {"status": found, "outcome": CellOutcome.FAILED}
            found = [(m, r, lost) for m, method in some.items() for r in range(len(method.rungs))]
        for m, r, values in found:
            for name, value in values.items():
                arrays[name][(s, m, r)[: arrays[name].ndim]] = value
    return arrays


def cell_dataset(
    variables: Sequence[str],
    arrays: dict[str, Any],
    scenarios: Sequence[Scenario],
    methods: Sequence[Method],
    attributes: dict[str, Any],
    more: Mapping[str, Variable] | None = None,
) -> xr.Dataset:
    """Dataset of some `VARIABLES` and of `more` variables, from their arrays."""
    table = {**{name: VARIABLES[name] for name in variables}, **(more or {})}
    coords = coordinates(scenarios, methods) | tolerances(methods)
    return xr.Dataset(with_attributes(table, arrays), coords, attributes)


Group = dict[int, Method]
Task = tuple[int, Scenario, Group]
Cells = list[tuple[int, int, dict[str, Any]]]


def _groups(scenario: Scenario, methods: Sequence[Method]) -> Iterator[Group]:
    """Groups of a scenario's methods for one process each: all built-in laws, each user law."""
    asked = {m: method for m, method in enumerate(methods) if method.label not in scenario.without}
    ours = {m: method for m, method in asked.items() if not method.label.is_own}
    yield from [ours] * bool(ours)
    yield from ({m: method} for m, method in asked.items() if m not in ours)


def _computed(
    tasks: Sequence[Task], timeout: float, is_alone: bool, say: Say
) -> Iterator[Cells | Status]:
    """Cells of every task in order, or the status of the process that failed."""
    n_processes = min(len(tasks), os.cpu_count() or 1)
    idle: SimpleQueue[Isolated] = SimpleQueue()

    def call(task: Task) -> Cells | Status:
        _, scenario, group = task
        say(f"benchmark: scenario {scenario.name}, {len(group)} methods")
        if is_alone and not any(method.label.is_own for method in group.values()):
            return scenario_cells(scenario, group)
        process = idle.get()
        try:
            return process(scenario_cells, scenario, group)
        except CallError as lost:
            return lost.status
        finally:
            idle.put(process)

    with ExitStack() as stack:
        threads = stack.enter_context(ThreadPoolExecutor(n_processes))
        for _ in range(n_processes):
            idle.put(stack.enter_context(Isolated(timeout)))
        # On an interrupt: cancel what has not begun, end the processes, wait for the threads.
        stack.callback(threads.shutdown, wait=False, cancel_futures=True)
        yield from threads.map(call, tasks)


def scenario_cells(scenario: Scenario, group: Group) -> Cells:
    """Method, rung and values of all cells of some methods in one scenario."""
    judges: dict[str, Judge] = {EXACT: judge(scenario, EXACT, None)}
    found: Cells = []
    for m, method in group.items():
        if method.own not in judges:
            judges[method.own] = judge(scenario, method.own, judges[EXACT])
        own = judges[method.own]
        law = law_or_none(scenario, method.label.law)
        is_located = isinstance(law, Piecewise) and law.located
        predicted = predictors(scenario, law) if scenario.expected else {}
        for r, solver in enumerate(method.rungs):
            run = observed(scenario, law, solver)
            values = own.verdict(run, solver) | predicted
            if not is_located:
                values["event_time_error"] = math.nan
            values["layer_over_step"] = (math.nan if law is None else law.layer) / (
                own.step_length(run)
            )
            found.append((m, r, values))
    return found


def predictors(scenario: Scenario, law: ContactLaw | None) -> dict[str, Any]:
    """Variables that need no integration: equilibria, in-gap frequency, stiffness ratio."""
    exact = equilibria(scenario.oscillator, scenario.law(EXACT), scenario.fit_range)
    k = linear_stiffness(scenario.oscillator)
    found: dict[str, Any] = {
        "n_wells_exact": int(np.sum(exact.stable)),
        "stiffness_ratio": (k + scenario.K_c) / k,
    }
    if law is None:
        return found
    balance = equilibria(scenario.oscillator, law, scenario.fit_range)
    return found | {
        "n_wells": int(np.sum(balance.stable)),
        "in_gap_frequency": _in_gap_frequency(scenario.oscillator, law, scenario.fit_range),
    }


def _in_gap_frequency(oscillator: Oscillator, law: ContactLaw, x_max: float) -> float:
    low, high = in_gap(law.gap, x_max)
    plain = replace(oscillator, alpha=0.0)
    stiffness = float(restoring_slope(plain, law, 0.5 * (low + high)))
    return math.sqrt(stiffness / oscillator.mass) / (2.0 * math.pi) if stiffness > 0 else math.nan
