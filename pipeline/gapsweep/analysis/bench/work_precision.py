"""Error and cost of every method at every tolerance: ``work_precision.nc``.

Errors are solver errors (against the method's own law, solved tightly) and total errors (against
the exact law); the difference is the model error, which no tolerance reduces. All methods are timed
in one process, in turns. Definitions: docs/reference/bench.md.
"""

import math
import os
import platform
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import xarray as xr

from gapsweep.analysis.bench.cells import CELL, Say, cell_dataset, cell_table, sizes
from gapsweep.analysis.bench.cells import VARIABLES as CELL_VARIABLES
from gapsweep.analysis.bench.costs import cost
from gapsweep.analysis.bench.pareto import on_front
from gapsweep.analysis.bench.references import LARGEST_GROWTH, TIGHT, growth, motion
from gapsweep.analysis.bench.scenarios import Method, Scenario, law_or_none, methods, scenarios
from gapsweep.analysis.dimensions import Array
from gapsweep.execution.isolated import CallError, Isolated
from gapsweep.execution.progress import DEFAULT_TIMEOUT
from gapsweep.integrate.problem import Solver
from gapsweep.model.labels import EXACT
from gapsweep.response.respond import respond_all
from gapsweep.response.result import Steady
from gapsweep.response.scene import Scene
from gapsweep.status import Status
from gapsweep.study.study import Study
from gapsweep.variables import Variable, empty

Cell = tuple[int, int, int]
Result = TypeVar("Result")

# A call that takes longer than this [s] is repeated only 3 times: its spread is small.
_SLOW, _FEW = 0.1, 3
_RESPONSE_TIGHT = Solver(engine="compiled", rtol=1e-12, atol=1e-15)

VARIABLES = (
    *("total_error", "bounded_error", "event_time_error", "nfev", "n_steps", "n_rejected"),
    *("n_contacts", "status", "at_reference_floor", "model_error", "reference_distance", "growth"),
    "n_periods",
)
_cell, _method = (partial(Variable, dims=dims) for dims in (CELL, ("method",)))
MEASURED = {
    "trajectory_error": CELL_VARIABLES["solver_error"],
    "amplitude_error": _cell(
        "f8", "1", "relative deviation of the steady amplitude from the reference of the same law"
    ),
    "cpu_time": _cell("f8", "1", "CPU time per simulated second, median"),
    "cpu_time_q25": _cell("f8", "1", "CPU time, lower quartile"),
    "cpu_time_q75": _cell("f8", "1", "CPU time, upper quartile"),
    "on_front": _cell(
        "i1", "1", "whether no other cell has both lower cost and lower total error", 0
    ),
    "first_call_time": _method(
        "f8", "s", "CPU time of the slowest first call, which compiles or loads code"
    ),
    "n_lanes": _method("i4", "1", "points per timed call", 1),
}
ERROR_SCALE = "gap width; for velocities, times the angular forcing frequency"


def work_precision(
    study: Study, say: Say = lambda text: None, timeout: float = DEFAULT_TIMEOUT
) -> xr.Dataset:
    """Error, cost and status of every method on every scenario without a stated solution.

    `say`: called with a line of text before each step.
    `timeout`: processor time [s] of a scenario, and of each call of a user law.
    Result: over `scene`, `method` and `tolerance` (the rung of a method's ladder).
    """
    found, ladder = scenarios(study, with_answer=False), methods(study)
    assert study.spec.bench is not None
    # The load of other processes, before the measurements.
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else math.nan
    repeats = study.spec.bench.repeats
    with Isolated(timeout) as isolated:
        bench = Measurements(found, ladder, study.spec.bench.lanes, study.steady, isolated)
        # Costs first: their first calls are the first ones of the process.
        say(f"work-precision: measuring costs of {len(found)} scenarios, {len(ladder)} methods")
        bench.measure_costs(repeats)
        say("work-precision: computing steady responses")
        bench.measure_responses()
    compared = [followed(bench.without_lost(s)) for s in range(len(found))]
    arrays = cell_table(compared, ladder, timeout, say) | bench.arrays
    arrays["trajectory_error"] = arrays["solver_error"]
    for (s, representation), status in bench.lost.items():
        for m, method in enumerate(ladder):
            if method.label.law == representation:
                arrays["status"][s, m, : len(method.rungs)] = status
    find_fronts(arrays)
    attributes = {
        **study.attributes,
        "error_scale": ERROR_SCALE,
        "n_repeats": repeats,
        "processor": processor(),
        "load_average": load,
    }
    return cell_dataset(VARIABLES, arrays, compared, ladder, attributes, MEASURED)


def processor() -> str:
    """Name of the processor, as the operating system reports it."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def followed(scenario: Scenario) -> Scenario:
    """The scenario, cut at the period where disturbances have grown by `LARGEST_GROWTH`."""
    law = scenario.law(EXACT)
    exact = motion(scenario, law, TIGHT["compiled"])
    if exact.status is not Status.OK:
        return scenario
    small = growth(scenario, law, exact.section) <= LARGEST_GROWTH
    return replace(scenario, n_periods=max(int(np.sum(small)), 1))


def amplitudes(
    scenarios: Sequence[Scenario], representation: str, solver: Solver, steady: Steady
) -> Array:
    """Steady amplitudes [m] of a law, shape (n_scenarios,); NaN without a steady response."""
    laws = {s: law_or_none(scenario, representation) for s, scenario in enumerate(scenarios)}
    known = {s: law for s, law in laws.items() if law is not None}
    cases = [
        Scene(oscillator=scenarios[s].oscillator, law=law, omega=scenarios[s].omega, solver=solver)
        for s, law in known.items()
    ]
    initial = np.reshape([(scenarios[s].x_0, scenarios[s].v_0) for s in known], (-1, 2))
    found = np.full(len(laws), np.nan)
    found[[*known]] = [
        each.amplitude if each.section else np.nan
        for each in respond_all(cases, initial, steady).rows()
    ]
    return found


class Measurements:
    """Measured costs and steady amplitudes of methods; user laws run in the process `isolated`."""

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        methods: Sequence[Method],
        n_lanes: int,
        steady: Steady,
        isolated: Isolated,
    ) -> None:
        self.scenarios, self.methods = list(scenarios), list(methods)
        self.steady, self.isolated = steady, isolated
        # Status of failed calls of user laws, by scenario and representation.
        self.lost: dict[tuple[int, str], Status] = {}
        self.arrays = empty(MEASURED, sizes(scenarios, methods))
        # scipy solves one point after the other.
        self.n_lanes = [1 if m.rungs[0].engine == "scipy" else n_lanes for m in self.methods]
        self.arrays["n_lanes"][:] = self.n_lanes

    def without_lost(self, s: int) -> Scenario:
        """A scenario without the user laws whose calls failed in it."""
        lost = (m.label for m in self.methods if (s, m.label.law) in self.lost)
        scenario = self.scenarios[s]
        return replace(scenario, without=(*scenario.without, *lost))

    def cells(self) -> Iterator[tuple[Cell, Scenario, Method, Solver]]:
        """Indices, scenario, method and solver of all cells; methods alternate within a rung."""
        n_rungs = self.arrays["cpu_time"].shape[2]
        for s, scenario in enumerate(self.scenarios):
            for r in range(n_rungs):
                for m, method in enumerate(self.methods):
                    if r < len(method.rungs) and method.label not in scenario.without:
                        yield (s, m, r), scenario, method, method.rungs[r]

    def measure_costs(self, repeats: int) -> None:
        """Measure medians and quartiles of the cost in rounds over all methods."""
        times = np.full((repeats, *self.arrays["cpu_time"].shape), np.nan)
        first = np.full(self.arrays["cpu_time"].shape, np.nan)
        for cell, scenario, method, solver in self.cells():
            found = self._cost(cell, scenario, method, solver)
            if found is not None:
                first[cell] = found[0]
        for n in range(repeats):
            for cell, scenario, method, solver in self.cells():
                if n >= _FEW and first[cell] > _SLOW:
                    continue
                found = self._cost(cell, scenario, method, solver)
                if found is not None:
                    seconds, simulated = found
                    times[(n, *cell)] = seconds / simulated
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "All-NaN slice")  # cells without a rung or a law
            for name, share in (("cpu_time_q25", 0.25), ("cpu_time", 0.5), ("cpu_time_q75", 0.75)):
                self.arrays[name] = np.nanquantile(times, share, axis=0)
            self.arrays["first_call_time"] = np.nanmax(first, axis=(0, 2))

    def _cost(
        self, cell: Cell, scenario: Scenario, method: Method, solver: Solver
    ) -> tuple[float, float] | None:
        s, m, _ = cell
        label, n_lanes = method.label.law, self.n_lanes[m]
        return self._call(s, method, cost, scenario, label, solver, n_lanes)

    def _call(
        self, s: int, method: Method, function: Callable[..., Result], *arguments: Any
    ) -> Result | None:
        """Result of a call, isolated for user laws; None if it failed now or before."""
        if not method.label.is_own:
            return function(*arguments)
        if (s, method.label.law) in self.lost:
            return None
        try:
            return self.isolated(function, *arguments)
        except CallError as lost:
            self.lost[s, method.label.law] = lost.status
            return None

    def measure_responses(self) -> None:
        """Measure the error of the steady amplitude in every cell of the compiled engine."""
        own: dict[str, Array] = {}
        for m, method in enumerate(self.methods):
            if method.rungs[0].engine == "scipy":
                continue
            if method.own not in own:
                own[method.own] = self._amplitudes(method, method.own, _RESPONSE_TIGHT)
            reference = own[method.own]
            asked = [method.label not in scenario.without for scenario in self.scenarios]
            for r, solver in enumerate(method.rungs):
                found = self._amplitudes(method, method.label.law, solver)
                error = np.abs(found - reference) / reference
                self.arrays["amplitude_error"][:, m, r] = np.where(asked, error, np.nan)

    def _amplitudes(self, method: Method, representation: str, solver: Solver) -> Array:
        asked = representation, solver, self.steady
        if not method.label.is_own:
            return amplitudes(self.scenarios, *asked)
        each = (
            self._call(s, method, amplitudes, [scenario], *asked)
            for s, scenario in enumerate(self.scenarios)
        )
        return np.array([np.nan if one is None else one[0] for one in each])


def find_fronts(arrays: dict[str, Any]) -> None:
    """Set ``on_front``: the Pareto front of total error and CPU time in each scenario."""
    # Points with an error too small to be measured still exclude worse points from the front.
    error = np.where(arrays["status"] == Status.OK, arrays["bounded_error"], np.nan)
    for s, measurable in enumerate(arrays["at_reference_floor"] == 0):
        arrays["on_front"][s] = on_front(error[s], arrays["cpu_time"][s]) & measurable
