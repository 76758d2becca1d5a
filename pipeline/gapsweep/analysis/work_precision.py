"""What every method costs for the error it makes: error, cost and status, scene by scene.

Errors are solver errors (against the method's own law, solved tightly) and total errors (against
the exact law); between them lies the model error, a floor under each law. Everything is run in one
process; for the costs all methods take turns, round by round. Definitions: docs/bench.md.
"""

import math
import os
import platform
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import xarray as xr

from gapsweep.analysis.costs import cost
from gapsweep.analysis.pareto import on_front
from gapsweep.analysis.scenes import (
    Method,
    Scene,
    coordinates,
    law_or_none,
    methods,
    scenes,
    tolerances,
)
from gapsweep.analysis.truth import (
    LARGEST_GROWTH,
    TIGHT,
    Truth,
    distance,
    event_time_distance,
    gap_scale,
    growth,
    motion,
    truth,
)
from gapsweep.execution.isolated import CallError, Isolated
from gapsweep.execution.progress import DEFAULT_TIMEOUT
from gapsweep.integrate.problem import Solver
from gapsweep.model.contact import Piecewise
from gapsweep.model.labels import EXACT
from gapsweep.response.attractors import NONE, attractors_of_scenes
from gapsweep.response.respond import respond_all
from gapsweep.response.result import Response, Responses, Steady
from gapsweep.response.scene import Scene as Asked
from gapsweep.response.section import unit_of
from gapsweep.status import Status
from gapsweep.study.study import Study
from gapsweep.variables import STATUS_FLAGS, Variable, empty, with_attributes

Cell = tuple[int, int, int]
Result = TypeVar("Result")

# Errors below so many distances of the two references are not told from nothing.
FLOOR = 10.0
# A call that takes longer than this [s] is repeated so many times only: its spread is small.
_SLOW, _FEW = 0.1, 3
_RESPONSE_TIGHT = Solver(engine="compiled", rtol=1e-12, atol=1e-15)

_CELL = ("scene", "method", "tolerance")
_PAIR = ("scene", "method")
_AGREES = (("not_compared", -1), ("no", 0), ("yes", 1))
VARIABLES = {
    "trajectory_error": (
        _CELL,
        Variable("f8", "1", "solver error: largest deviation at period ends from the same law"),
    ),
    "total_error": (
        _CELL,
        Variable("f8", "1", "largest deviation at period ends from the exact law"),
    ),
    "bounded_error": (
        _CELL,
        Variable("f8", "1", "total_error, or the largest it can be where it is not measurable"),
    ),
    "event_time_error": (_CELL, Variable("f8", "s", "largest deviation of a contact time")),
    "amplitude_error": (
        _CELL,
        Variable("f8", "1", "relative deviation of the steady amplitude from the same law"),
    ),
    "amplitude_total_error": (
        _CELL,
        Variable("f8", "1", "relative deviation of the steady amplitude from the exact law"),
    ),
    "same_attractor": (
        _CELL,
        Variable("i1", "1", "whether the start ends on the same law's attractor", -1, _AGREES),
    ),
    "same_attractor_total": (
        _CELL,
        Variable("i1", "1", "whether the start ends on the exact law's attractor", -1, _AGREES),
    ),
    "cpu_time": (_CELL, Variable("f8", "1", "processor time per simulated second, median")),
    "cpu_time_q25": (_CELL, Variable("f8", "1", "processor time, lower quartile")),
    "cpu_time_q75": (_CELL, Variable("f8", "1", "processor time, upper quartile")),
    "nfev": (_CELL, Variable("i8", "1", "right-hand sides evaluated", 0)),
    "n_steps": (_CELL, Variable("i8", "1", "accepted steps", 0)),
    "n_rejected": (_CELL, Variable("i8", "1", "rejected steps", 0)),
    "n_contacts": (_CELL, Variable("i8", "1", "wall crossings, in and out", 0)),
    "status": (
        _CELL,
        Variable("i1", "1", "outcome of the motion", Status.NOT_REQUESTED, STATUS_FLAGS),
    ),
    "at_reference_floor": (
        _CELL,
        Variable("i1", "1", "whether an error is too close to the truth to be measured", 0),
    ),
    "on_front": (
        _CELL,
        Variable("i1", "1", "whether nothing is both cheaper and closer to the exact law", 0),
    ),
    "model_error": (
        _PAIR,
        Variable("f8", "1", "largest deviation of the law's own solution from the exact law's"),
    ),
    "reference_distance": (
        _PAIR,
        Variable("f8", "1", "distance of two independent tight solutions of the law"),
    ),
    "first_call_time": (
        ("method",),
        Variable("f8", "s", "processor time of the slowest first call: it compiles or loads code"),
    ),
    "n_lanes": (("method",), Variable("i4", "1", "points that a timed call advances", 1)),
    "n_periods": (("scene",), Variable("i4", "1", "forcing periods that are compared", 0)),
    "growth": (("scene",), Variable("f8", "1", "growth of a disturbance of the start")),
}
ERROR_SCALE = "gap width; forcing's angular frequency times it for velocities"


def work_precision(
    study: Study,
    say: Callable[[str], None] | None = None,
    timeout: float = DEFAULT_TIMEOUT,
) -> xr.Dataset | None:
    """Error, cost and status of every method on every scene without a stated answer.

    Parameters
    ----------
    study : Study
    say : callable, optional
        Told what is done next, for this takes minutes.
    timeout : float
        Time [s] that each call of a law of the user's own may take; it is alone in a process.

    Returns
    -------
    Dataset
        Over `scene`, `method` and `tolerance` (the rung of a method's ladder); None if the study
        has no such scene.
    """
    found, ladder = scenes(study, with_answer=False), methods(study)
    if not found:
        return None
    assert study.spec.bench is not None
    # What else the machine was busy with, before this adds to it.
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else math.nan
    alone = Isolated(timeout)
    bench = Bench(found, ladder, study.spec.bench.lanes, study.steady, alone)
    repeats = study.spec.bench.repeats
    steps: list[tuple[str, Callable[[], None]]] = [
        # Costs first: their first calls are the first ones of the process.
        ("costs", lambda: bench.measure_costs(repeats)),
        ("errors and references", bench.measure_errors),
        ("steady responses", bench.measure_responses),
        ("fronts", bench.find_fronts),
    ]
    with alone:
        for name, step in steps:
            if say is not None:
                say(f"work-precision: {name} of {len(found)} scenes, {len(ladder)} methods")
            step()
    attributes = {
        **study.attributes,
        "error_scale": ERROR_SCALE,
        "n_repeats": repeats,
        "processor": processor(),
        "load_average": load,
    }
    coords = coordinates(bench.scenes, ladder) | tolerances(ladder)
    return xr.Dataset(with_attributes(VARIABLES, bench.arrays), coords, attributes)


def processor() -> str:
    """Name of the processor as the system gives it."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def followed(scene: Scene) -> Scene:
    """The scene, no longer than disturbances stay small enough to tell right from wrong."""
    law = scene.law(EXACT)
    exact = motion(scene, law, TIGHT["compiled"])
    if exact.status is not Status.OK:
        return scene
    small = growth(scene, law, exact.section) <= LARGEST_GROWTH
    return replace(scene, n_periods=max(int(np.sum(small)), 1))


def errors(scene: Scene, method: Method, own: Truth, exact: Truth) -> dict[str, Any]:
    """Errors, counts and statuses of a method on a scene: of the pair, and lists by rung."""
    scale = gap_scale(scene, exact.reach)
    apart = own.distance(scale)
    same = method.own == EXACT
    found: dict[str, Any] = {
        "reference_distance": apart,
        "model_error": 0.0 if same else distance(own.compiled, exact.compiled, scale),
    }
    law = law_or_none(scene, method.representation)
    located = isinstance(law, Piecewise) and law.located
    limit = FLOOR * max(apart, exact.distance(scale))
    rungs = []
    for solver in method.rungs:
        run = motion(scene, law, solver)
        target, true = own.for_engine(solver.engine), exact.for_engine(solver.engine)
        total = distance(run, true, scale)
        timed_right = located and run.status is Status.OK
        counts = ("status", "nfev", "n_steps", "n_rejected", "n_contacts")
        rungs.append(
            {name: getattr(run, name) for name in counts}
            | {
                "trajectory_error": distance(run, target, scale),
                "total_error": total,
                "event_time_error": event_time_distance(run, target) if timed_right else np.nan,
                "at_reference_floor": total < limit,
                "bounded_error": max(total, limit) if total == total else np.nan,
            }
        )
    return found | {name: [rung[name] for rung in rungs] for name in rungs[0]}


def responses(
    scenes: Sequence[Scene], representation: str, solver: Solver, steady: Steady
) -> list[Response | None]:
    """Steady responses of a law in some scenes; None where it cannot be built."""
    laws = [law_or_none(scene, representation) for scene in scenes]
    asked = {
        s: Asked(oscillator=scene.oscillator, law=law, omega=scene.omega, solver=solver)
        for s, (scene, law) in enumerate(zip(scenes, laws, strict=True))
        if law is not None
    }
    starts = np.reshape([(scenes[s].x_0, scenes[s].v_0) for s in asked], (-1, 2))
    answers = respond_all(list(asked.values()), starts, steady).rows()
    found = dict(zip(asked, answers, strict=True))
    return [found.get(s) for s in range(len(scenes))]


class Bench:
    """Scenes, methods, and the arrays that their measurements fill.

    What a law of the user's own does to its process, it does to that of `alone`.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        methods: Sequence[Method],
        n_lanes: int,
        steady: Steady,
        alone: Isolated,
    ) -> None:
        # Costs are those of the whole horizon, errors of what can be told right from wrong.
        self.whole, self.scenes = list(scenes), [followed(scene) for scene in scenes]
        self.methods, self.steady, self.alone = list(methods), steady, alone
        # Laws of the user's own that came to nothing, by scene and representation.
        self.lost: dict[tuple[int, str], Status] = {}
        # scipy solves one point after the other.
        self.n_lanes = [1 if m.rungs[0].engine == "scipy" else n_lanes for m in self.methods]
        sizes = {
            "scene": len(self.scenes),
            "method": len(self.methods),
            "tolerance": max(len(method.rungs) for method in self.methods),
        }
        self.arrays = empty(VARIABLES, sizes)
        self.arrays["n_lanes"][:] = self.n_lanes
        self.arrays["n_periods"][:] = [scene.n_periods for scene in self.scenes]

    def cells(self) -> Iterator[tuple[Cell, Scene, Method, Solver]]:
        """All cells with their whole scenes; methods take turns within a scene and rung."""
        n_rungs = self.arrays["status"].shape[2]
        for s, scene in enumerate(self.whole):
            for r in range(n_rungs):
                for m, method in enumerate(self.methods):
                    if r < len(method.rungs) and method.label not in scene.without:
                        yield (s, m, r), scene, method, method.rungs[r]

    def measure_costs(self, repeats: int) -> None:
        """Median and quartiles of repeated calls; all methods take turns, round by round."""
        times = np.full((repeats, *self.arrays["cpu_time"].shape), np.nan)
        first = np.full(self.arrays["cpu_time"].shape, np.nan)
        for cell, scene, method, solver in self.cells():
            found = self._cost(cell, scene, method, solver)
            if found is not None:
                first[cell] = found[0]
        for n in range(repeats):
            for cell, scene, method, solver in self.cells():
                if n >= _FEW and first[cell] > _SLOW:
                    continue
                found = self._cost(cell, scene, method, solver)
                if found is not None:
                    seconds, simulated = found
                    times[(n, *cell)] = seconds / simulated
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "All-NaN slice")  # no such rung, no such law
            for name, share in (("cpu_time_q25", 0.25), ("cpu_time", 0.5), ("cpu_time_q75", 0.75)):
                self.arrays[name] = np.nanquantile(times, share, axis=0)
            self.arrays["first_call_time"] = np.nanmax(first, axis=(0, 2))

    def _cost(
        self, cell: Cell, scene: Scene, method: Method, solver: Solver
    ) -> tuple[float, float] | None:
        s, m, _ = cell
        label, n_lanes = method.representation, self.n_lanes[m]
        return self._call(s, label, cost, scene, label, solver, n_lanes)

    def _call(
        self, s: int, representation: str, function: Callable[..., Result], *arguments: Any
    ) -> Result | None:
        """A call that may run a law of the user's own; None if that came to nothing here."""
        if ":" not in representation:
            return function(*arguments)
        if (s, representation) in self.lost:
            return None
        try:
            return self.alone(function, *arguments)
        except CallError as lost:
            self.lost[s, representation] = lost.status
            return None

    def measure_errors(self) -> None:
        """Errors, counts and statuses of the scenes' own motions."""
        for s, scene in enumerate(self.scenes):
            exact = truth(scene, EXACT)
            if exact.compiled.status is Status.OK:
                rates = growth(scene, scene.law(EXACT), exact.compiled.section)
                self.arrays["growth"][s] = rates[-1]
            truths: dict[str, Truth | None] = {EXACT: exact}
            for m, method in enumerate(self.methods):
                if method.label in scene.without:
                    continue
                own = method.own
                if own not in truths:
                    truths[own] = self._call(s, own, truth, scene, own)
                found = self._call(s, own, errors, scene, method, truths[own], exact)
                for name, value in (found or {}).items():
                    rungs = (slice(len(value)),) if isinstance(value, list) else ()
                    self.arrays[name][(s, m, *rungs)] = value

    def measure_responses(self) -> None:
        """Steady amplitude and attractor of every cell of the compiled engine."""
        exact = self._responses(EXACT, _RESPONSE_TIGHT)
        own: dict[str, list[Response | None]] = {EXACT: exact}
        for m, method in enumerate(self.methods):
            if method.rungs[0].engine == "scipy":
                continue
            if method.own not in own:
                own[method.own] = self._responses(method.own, _RESPONSE_TIGHT)
            for r, solver in enumerate(method.rungs):
                for s, found in enumerate(self._responses(method.representation, solver)):
                    for suffix, true in (("", own[method.own][s]), ("_total", exact[s])):
                        self._compare((s, m, r), suffix, found, true)
        self._state_losses()

    def _responses(self, representation: str, solver: Solver) -> list[Response | None]:
        """Steady responses of a law in all scenes; None where there are none."""
        if ":" not in representation:
            return responses(self.scenes, representation, solver, self.steady)
        asked = representation, solver, self.steady
        found = (
            self._call(s, representation, responses, [scene], *asked)
            for s, scene in enumerate(self.scenes)
        )
        return [one[0] if one else None for one in found]

    def _state_losses(self) -> None:
        """Where a law of the user's own came to nothing, that is the status."""
        for (s, representation), status in self.lost.items():
            for m, method in enumerate(self.methods):
                if method.representation == representation:
                    self.arrays["status"][s, m, : len(method.rungs)] = status

    def _compare(
        self, cell: Cell, suffix: str, found: Response | None, true: Response | None
    ) -> None:
        if found is None or true is None or not (found.section and true.section):
            return
        scene = self.scenes[cell[0]]
        if self.methods[cell[1]].label in scene.without:
            return
        pair = Responses.of([found, true])
        both = attractors_of_scenes(
            pair, [0, 0], unit=unit_of(scene.omega), symmetric=False
        ).of_response
        self.arrays[f"same_attractor{suffix}"][cell] = both[0] == both[1] != NONE
        error = abs(found.amplitude - true.amplitude) / true.amplitude
        name = f"amplitude{suffix}_error" if suffix else "amplitude_error"
        self.arrays[name][cell] = error

    def find_fronts(self) -> None:
        """Pareto fronts of total error and processor time, scene by scene."""
        arrays = self.arrays
        # A point too close to the truth to be measured still beats what is farther and dearer.
        error = np.where(arrays["status"] == Status.OK, arrays["bounded_error"], np.nan)
        for s in range(len(self.scenes)):
            front = on_front(error[s], arrays["cpu_time"][s])
            arrays["on_front"][s] = front & (arrays["at_reference_floor"][s] == 0)
