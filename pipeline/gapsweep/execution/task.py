"""The tasks of Dask workers: from sweep points to responses.

A sweep point is the unit of work, of failure and of caching; a task has several points because
every task takes some time of Dask.
"""

import gc
import os
import platform
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from distributed import get_worker
from numpy.typing import NDArray

from gapsweep.errors import ModelError
from gapsweep.execution.isolated import CallError, Isolated, failure
from gapsweep.execution.sweeps import origins
from gapsweep.integrate.problem import Models
from gapsweep.integrate.simulate import loaded
from gapsweep.response.ensemble import Ensemble
from gapsweep.response.respond import respond_models
from gapsweep.response.result import Response, Responses
from gapsweep.response.scene import CONFIRMING_RTOL, TANGENT_RTOL
from gapsweep.store.slab import Slab, slabs
from gapsweep.study.points import KEY, SWEEPS, Kind, Points
from gapsweep.study.software import software, versions

_RESTARTED = "the preceding point has no end state; started from the last point that has"

# Kinds of points whose machine code is loaded.
_warm: set[Kind] = set()
# Compilation takes half a minute, on a busy machine minutes; a longer call hangs in a user law.
WARM_UP_SECONDS = 600.0
_NO_TIME = 1e9  # Hz: a forcing period without notable motion

States = NDArray[np.float64]
Ask = Callable[[Points, States], Responses]


@dataclass(frozen=True, slots=True, eq=False)
class Tile:
    """Sweep points of one kind that are computed together, sweep after sweep."""

    points: Points
    # Identity of their kind on the client, which keeps results of the same `software` only. Empty
    # for points that are not stored.
    identity: str
    # Shape (n,); content keys of the points, and of their preceding points.
    keys: NDArray[np.void]
    previous: NDArray[np.void]
    # Shape (m,); number of points of each sweep, that start where the one before them ends; a fixed
    # start is a sweep of one.
    lengths: NDArray[np.int64]
    # Shape (m, n_states); displacement [m] and velocity [m/s] from which each sweep starts, of a
    # system all of its state; of no meaning for fixed starts, which are among the points' numbers.
    states: States
    # Shape (m,); keys of the points whose ends those states are, as of `sweeps.origins`.
    origins: NDArray[np.void]

    def __len__(self) -> int:
        return len(self.points)

    @classmethod
    def of_one(cls, points: Points, state: States) -> "Tile":
        """The tile of a single point; `state` is its initial state if it is of a sweep."""
        nothing, state = np.zeros(1, KEY), state.reshape(1, -1)
        return cls(points, "", nothing, nothing, np.ones(1, int), state, nothing)

    @classmethod
    def joined(cls, tiles: "Sequence[Tile]") -> "Tile":
        """Return the sweeps of tiles that differ in the direction only, with one direction."""
        first = tiles[0]
        points = Points(first.points.kind, np.concatenate([each.points.numbers for each in tiles]))
        names = "keys", "previous", "lengths", "states", "origins"
        arrays = [np.concatenate([getattr(each, name) for each in tiles]) for name in names]
        return cls(points, first.identity, *arrays)

    @property
    def firsts(self) -> NDArray[np.int64]:
        """Number of the first point of each sweep."""
        return np.cumsum(self.lengths) - self.lengths

    def slabs(self, responses: Responses, host: str) -> list[Slab]:
        """Responses of all points as slabs; a message marks points with an unplanned origin."""
        libraries = ", ".join(f"{name} {number}" for name, number in versions().items())
        is_first = np.isin(np.arange(len(self)), self.firsts)
        started = origins(self.keys, is_first, responses.has_end, self.origins)
        for row in np.flatnonzero(started != self.previous).tolist():
            responses.messages.setdefault(row, _RESTARTED)
        tables = self.points.numbers, self.keys, started, responses
        return list(slabs(self.identity, *tables, host, libraries))


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """The argument of a Dask task; one object, because Dask would search lists for futures."""

    tiles: list[Tile]
    # Time [s] after which the worker process ends itself and loses its results; for points in
    # isolated processes, the CPU time limit of each.
    timeout: float
    client: tuple[str, int]  # the client's `process`, which must not be ended


@dataclass(frozen=True, slots=True, eq=False)
class TaskResult:
    """Slabs of results, their CPU time [s], the CPU time of the whole task, the `software`."""

    slabs: list[Slab]
    seconds: float
    spent: float  # compiling included
    software: Mapping[str, str]


def compute(task: Task) -> TaskResult:
    """Body of a Dask task: compute the points of a task in the worker."""
    for tile in task.tiles:
        load(tile.points.kind.solver.engine)
    is_ours = task.client == process()
    if not is_ours:
        _freeze(*{tile.points.kind.solver.engine for tile in task.tiles})
    begin = time.thread_time()
    found, n_warm = [], len(_warm)
    with nullcontext() if is_ours else _ending_after(task.timeout):
        for tiles in _both_directions(task.tiles):
            responses = respond_to(Tile.joined(tiles))
            ends = np.cumsum([len(tile) for tile in tiles])
            for tile, rows in zip(tiles, np.split(np.arange(ends[-1]), ends[:-1]), strict=True):
                found += tile.slabs(responses.take(rows), platform.node())
    seconds = spent = time.thread_time() - begin
    if len(_warm) > n_warm:  # that includes compilation, which happens once
        seconds = sum(slab.seconds for slab in found)
    return TaskResult(found, seconds, spent, software())


def _both_directions(tiles: Iterable[Tile]) -> list[list[Tile]]:
    """Tiles whose points are computed together: upward and downward sweeps of equal settings.

    A step of a sweep is one call for a single point, which costs about as much as one for two.
    """
    groups: dict[Kind, list[Tile]] = {}
    for tile in tiles:
        kind = tile.points.kind
        kind = replace(kind, start=SWEEPS[0]) if kind.is_sweep else kind
        groups.setdefault(kind, []).append(tile)
    return [*groups.values()]


def compute_isolated(task: Task) -> TaskResult:
    """Body of a Dask task like `compute`, with every point in an isolated process."""
    found = []
    with Isolated(task.timeout, get_worker().memory_manager.memory_limit) as isolated:

        def ask(points: Points, states: States) -> Responses:
            rows = range(len(points))
            each = [response_of(isolated, points.take([row]), states[row]) for row in rows]
            return Responses.concatenated(each)

        for tile in task.tiles:
            found += tile.slabs(respond_to(tile, ask), platform.node())
    seconds = sum(slab.seconds for slab in found)
    return TaskResult(found, seconds, seconds, software())


def response_of(isolated: Isolated, points: Points, state: States) -> Responses:
    """The response of one point in an isolated process, whose failure becomes its status."""
    tile = Tile.of_one(points, state)
    try:
        isolated.within(WARM_UP_SECONDS, warm_up, tile)
        return isolated(respond_to, tile)
    except CallError as lost:
        one = Response(status=lost.status, message=lost.message)
        return Responses.of([one], points.kind.structure)


@cache
def load(engine: str) -> None:
    """Load an engine into this process."""
    loaded(engine)


@cache
def _freeze(*_: str) -> None:
    """Collect garbage of a worker less often, and none of the objects that engines have loaded."""
    gc.freeze()
    gc.set_threshold(100_000)  # models of distinct points are many, and live as long as a task


def process() -> tuple[str, int]:
    """Machine and number of this process, which identify it in a cluster."""
    return platform.node(), os.getpid()


_watch = threading.local()


@contextmanager
def _ending_after(seconds: float) -> Iterator[None]:
    """End this process if the block takes longer; the time of an outer block restarts after it.

    Kernels run without the interpreter's lock. Dask restarts a worker whose user code never
    releases the lock, after ``distributed.scheduler.worker-ttl``.
    """
    outer: threading.Timer | None = getattr(_watch, "timer", None)
    if outer is not None:
        outer.cancel()
    _watch.timer = _exiting_after(seconds)
    try:
        yield
    finally:
        _watch.timer.cancel()
        _watch.timer = None if outer is None else _exiting_after(outer.interval)


def _exiting_after(seconds: float) -> threading.Timer:
    timer = threading.Timer(min(seconds, threading.TIMEOUT_MAX), os._exit, [1])
    timer.daemon = True
    timer.start()
    return timer


def respond_to(tile: Tile, ask: Ask | None = None) -> Responses:
    """Steady responses of a tile; failures are responses with a status and a message.

    The first points of all sweeps advance together, then the second ones, and so on. A point whose
    predecessor has no end state starts from the last one that has; `origins` says which.

    `ask`: function that returns responses of independent points from states, shape (n, n_states);
    None computes them in this process, all in one call.
    """
    points = tile.points
    respond = _together(points) if ask is None else lambda rows, y: ask(points.take(rows), y)
    states, first, lengths = tile.states.copy(), tile.firsts, tile.lengths
    order, parts = [], []
    for position in range(max(lengths, default=0)):
        here = np.flatnonzero(lengths > position)
        rows = first[here] + position
        found = respond(rows, states[here])
        states[here[found.has_end]] = found.ends[found.has_end]
        parts.append(found)
        order.append(rows)
    if len(parts) == 1:
        return parts[0]
    return Responses.concatenated(parts).take(np.argsort(np.concatenate(order)))


def respond_fixed(points: Points) -> Responses:
    """Steady responses of points from their fixed initial states."""
    return _together(points)(np.arange(len(points)), points.starts)


def _together(points: Points) -> Callable[[NDArray[np.intp], States], Responses]:
    """Function that returns responses of some of the points, all in one call.

    Models are made once for all of its calls. Refused models give failures.
    """
    (valid, models), refused = points.models()
    place = np.full(len(points), -1)
    place[valid] = np.arange(len(valid))

    def respond(rows: NDArray[np.intp], states: States) -> Responses:
        starts = states if points.kind.is_sweep else points.starts[rows]
        here, others = np.flatnonzero(place[rows] >= 0), np.flatnonzero(place[rows] < 0)
        some = models if len(here) == len(models) else models.take(place[rows[here]])
        found = _answered(points.kind, some, starts[here])
        if not others.size:
            return found
        failures = [failed(refused[row]) for row in rows[others].tolist()]
        whole = Responses.concatenated([found, Responses.of(failures, points.kind.structure)])
        return whole.take(np.argsort(np.concatenate([here, others])))

    return respond


def _warm_up(kind: Kind, models: Models, start: States) -> None:
    """Load or compile the kernels for a kind of point, so that no point's time includes it.

    It calls them for the first of some points of that kind: an error here is also an error of that
    point.
    """
    if kind in _warm or kind.solver.engine != "compiled":
        return
    is_watched = getattr(_watch, "timer", None) is not None
    with _ending_after(WARM_UP_SECONDS) if is_watched else nullcontext():
        first = models.take([0])
        fast = replace(first, omega=np.where(first.omega > 0.0, _NO_TIME, 0.0))
        ensemble = Ensemble(fast, kind.solver)
        y, one = start.reshape(-1, 1), np.ones(1, int)
        ensemble.call(np.arange(1), y, one, np.zeros(1))
        for each in (ensemble, *map(ensemble.tight, (TANGENT_RTOL, CONFIRMING_RTOL))):
            each.call(np.arange(1), y, one, np.zeros(1), tangent=True)
    _warm.add(kind)


def warm_up(tile: Tile) -> None:
    """Load or compile the code for the first point of a tile, before its time is measured."""
    if tile.points.kind.solver.engine != "compiled":  # if a law hangs, its point times out
        if tile.points.kind.own is not None:
            with suppress(ModelError):  # its points report it
                tile.points.kind.own.load()
        return
    first = tile.points.take(slice(1))
    (rows, models), _ = first.models()
    if rows.size:
        starts = tile.states if first.kind.is_sweep else first.starts
        _warm_up(first.kind, models, starts[0])


def _answered(kind: Kind, models: Models, starts: States) -> Responses:
    """Responses of models; after an error halves are retried, down to the point that raises it."""
    if not len(models):
        return Responses.of((), kind.structure)
    try:
        _warm_up(kind, models, starts[0])
        return respond_models(models, kind.solver, starts, kind.steady)
    except BaseException as error:  # the task boundary: SystemExit, too, is a point's result
        if len(models) > 1:
            halves = np.array_split(np.arange(len(models)), 2)
            parts = [_answered(kind, models.take(half), starts[half]) for half in halves]
            return Responses.concatenated(parts)
        return Responses.of([failed(error)], kind.structure)


def failed(error: BaseException) -> Response:
    """The response, with status and message, of a point that raised an error."""
    status, message = failure(error)
    return Response(status=status, message=message)
