"""Carry out a plan on a Dask cluster and commit every result as it arrives.

The client is the only writer. A bounded window of tasks is in flight, so that the size of
the study does not show in the scheduler's memory. Points are taken in random order, looked
up once more and claimed before they are sent out, so that two runs on one cache share the
work. When a worker is lost, its points are computed again one by one where they can harm
nobody; only what fails alone is marked as failed.
"""

import math
import random
import time
from collections import Counter, deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from distributed import Client, Future, as_completed
from distributed.scheduler import KilledWorker

from gapsweep.errors import ClusterError
from gapsweep.execution.alone import compute_alone
from gapsweep.execution.cluster import check_software, check_workers
from gapsweep.execution.plan import Piece, Plan
from gapsweep.execution.progress import DEFAULT_TIMEOUT, OnProgress, Progress
from gapsweep.execution.task import REST, Task, TaskResult, Work, compute, process
from gapsweep.integrate.problem import DEFAULT_ENGINE
from gapsweep.model.labels import AUTO
from gapsweep.response.ensemble import State
from gapsweep.response.result import Response
from gapsweep.status import Status
from gapsweep.store.cache import Cache, Row
from gapsweep.store.claims import Claims
from gapsweep.study.software import software, versions
from gapsweep.study.study import Study

# Short against a user's patience and against what a kill may cost; until then, the more points
# share the lanes, the less each costs: half in 4,096 of what it costs in 250.
_TASK_SECONDS = 4.0
_MAX_BATCH = 4096
# A task takes at most this part of a thread's share of what is left, so that all end together.
_PART_OF_SHARE = 0.5
_MIN_BATCH = 64
# What a point costs beside its integration [s].
_POINT_SECONDS = 3e-4
# Before any cost is known: a compiled kernel wants its lanes filled, scipy takes seconds a point.
_FIRST_BATCH = {"compiled": 16, "scipy": 1}
# A long sweep comes back in parts, so that a kill costs one of them and not the whole sweep.
_CHAIN_PART = 16
# Neighbours stay together, because they cost alike and share their lanes: a block of them is not
# mixed with others.
_BLOCK = 4096
_WINDOW = 3  # tasks in flight per worker thread
_COMMIT_SECONDS = 0.5
_COMMIT_ROWS = 200
# Workers that a suspect may lose, before it is taken for guilty although it was alone.
_MAX_ATTEMPTS = 5
_WAIT_SECONDS = 0.1
_CLUSTER_LOST = "the cluster was lost; run again to resume"


@dataclass(frozen=True, slots=True)
class _Job:
    """What one task computes, and how often its worker was lost."""

    pieces: tuple[Piece, ...]
    attempts: int = 0

    @property
    def n_points(self) -> int:
        return sum(map(len, self.pieces))


def execute(
    study: Study,
    plan: Plan,
    cache: Cache,
    client: Client,
    *,
    batch: int | None = None,
    timeout: float = DEFAULT_TIMEOUT,
    retry_failed: bool = False,
    on_progress: OnProgress | None = None,
) -> Progress:
    """Compute all missing points of a plan and store them.

    Parameters
    ----------
    batch : int, optional
        Points per task; None lets measured costs decide.
    timeout : float
        Time [s] that one point may take before it is given up as ``timed_out``.
    retry_failed : bool
        Whether stored failures are computed again.
    on_progress : callable, optional
        Called with the `Progress` after every task.

    Raises
    ------
    ClusterError
        If the workers run other code, or the cluster is lost; what arrived is stored.
    """
    check_workers(client)
    with Claims(cache.path) as claims:
        run = _Execution(study, plan, cache, claims, client, batch, timeout, retry_failed)
        try:
            run.finish(on_progress)
        finally:
            run.cancel()
            run.commit()
    return run.progress


class _Execution:
    """One run: pieces waiting, tasks in flight, rows not yet committed."""

    def __init__(
        self,
        study: Study,
        plan: Plan,
        cache: Cache,
        claims: Claims,
        client: Client,
        batch: int | None,
        timeout: float,
        retry_failed: bool,
    ) -> None:
        self.study, self.plan, self.cache, self.claims = study, plan, cache, claims
        self.client, self.batch, self.timeout = client, batch, timeout
        self.largest_hit = Status.OUT_OF_FIT_RANGE if retry_failed else max(Status)
        # What must be computed although it is stored: failures, and what follows them in a sweep.
        self.stale = {
            plan.keys[point] for point in np.flatnonzero(plan.is_missing & (plan.status >= 0))
        }
        self.repeated = _repeated(study, plan)
        self.progress = Progress(plan.n_points, plan.n_hits)
        self.blocks = _shuffled(plan)
        self.block: deque[Piece] = deque()
        self.n_new = plan.n_missing
        # What comes before new pieces: the rest of long sweeps.
        self.begun: deque[Piece] = deque()
        # What another run has claimed: looked at again when nothing else is left.
        self.elsewhere: list[Piece] = []
        self.suspects: deque[_Job] = deque()
        self.in_flight: dict[Future, _Job] = {}
        self.rows: list[Row] = []
        self.held: list[bytes] = []  # claims on the points of those rows
        self.last_commit = time.monotonic()
        # The workers' too, or they are refused.
        self.versions = ", ".join(f"{name} {number}" for name, number in versions().items())
        self.costs = _Costs(study.spec.solver.engine or DEFAULT_ENGINE)

    def finish(self, on_progress: OnProgress | None) -> None:
        completed = as_completed(loop=self.client.loop)
        while True:
            self._refill(completed)
            if on_progress is not None:
                on_progress(self.progress)
            if self.in_flight:
                future = next(completed)
                self._receive(future, self.in_flight.pop(future))
            elif self.elsewhere:
                # The other run may be waiting for what we have not let go of yet.
                self.commit()
                time.sleep(_WAIT_SECONDS)
            else:
                return

    def _refill(self, completed: as_completed) -> None:
        n_threads = sum(self.client.nthreads().values())
        while len(self.in_flight) < _WINDOW * max(n_threads, 1):
            job = self.suspects.popleft() if self.suspects else self._next_job()
            if job is None:
                return
            future = self._submit(job)
            self.in_flight[future] = job
            completed.add(future)

    def _submit(self, job: _Job) -> Future:
        task = Task([self._work(piece) for piece in job.pieces], self.timeout, process())
        return self.client.submit(compute_alone if job.attempts else compute, task, pure=False)

    def _next_job(self) -> _Job | None:
        """Pieces for one task, as many as fill it; None if there is nothing to do now."""
        while candidates := self._drawn():
            if pieces := self._claimed(candidates):
                return _Job(tuple(pieces))
        return None

    def _drawn(self) -> list[Piece]:
        """The next pieces that would fill a task."""
        drawn: list[Piece] = []
        room, n_left = 1.0, self._share_of_rest()
        while room > 0.0 and n_left > 0:
            piece = self.begun.popleft() if self.begun else self._drawn_new(is_first=not drawn)
            if piece is None:
                if not drawn and self._returned():
                    continue
                break
            drawn.append(piece)
            n = min(len(piece), _CHAIN_PART)
            room, n_left = room - n * self._share_of_task(piece.first), n_left - n
        return drawn

    def _drawn_new(self, *, is_first: bool) -> Piece | None:
        """The next piece that nobody has looked at; of the next block only if it is the first."""
        if not self.block and is_first:
            self.block.extend(next(self.blocks, ()))
        if not self.block:
            return None
        piece = self.block.popleft()
        self.n_new -= len(piece)
        return piece

    def _share_of_rest(self) -> int:
        """Points that a task may take, so that all threads have work to the end."""
        n_threads = max(sum(self.client.nthreads().values()), 1)
        return max(int(_PART_OF_SHARE * self.n_new / n_threads), _MIN_BATCH)

    def _returned(self) -> bool:
        """Whether other runs gave up some of their claims; those pieces are drawn again."""
        held = []
        for piece in self.elsewhere:
            key = self.plan.keys[piece.first]
            if self.claims.take(key):
                self.claims.release(key)
                self.begun.append(piece)
            else:
                held.append(piece)
        self.elsewhere = held
        return bool(self.begun)

    def _claimed(self, candidates: list[Piece]) -> list[Piece]:
        """Of some pieces, the parts to be computed now, and by us."""
        mine, keys = [], []
        for piece in candidates:
            if self.claims.take(self.plan.keys[piece.first]):
                mine.append(piece)
                keys += self.plan.keys[piece.first : piece.last]
            else:
                self.elsewhere.append(piece)
        # Only now: what was stored before we claimed it has been seen.
        status = self.cache.status(keys)
        hit = (status >= 0) & (status <= self.largest_hit)
        done = {key for key, is_hit in zip(keys, hit, strict=True) if is_hit} - self.stale
        return [part for piece in mine if (part := self._undone(piece, done))]

    def _undone(self, piece: Piece, done: set[bytes]) -> Piece | None:
        """The next part of a piece that is not stored, up to what is."""
        first = piece.first
        while first < piece.last and self.plan.keys[first] in done:
            self._count_done(first)
            first += 1
        if first > piece.first:
            self.claims.release(self.plan.keys[piece.first])
            if first < piece.last:
                self.begun.append(Piece(piece.chain, first, piece.last))
            return None
        last = first + 1
        while last < min(first + _CHAIN_PART, piece.last) and self.plan.keys[last] not in done:
            last += 1
        return Piece(piece.chain, first, last)

    def _count_done(self, point: int) -> None:
        """Count a point that turns out to be stored: by us under another label, or by others."""
        if not self.plan.is_missing[point]:
            return
        if self.plan.keys[point] in self.repeated:
            self.progress.n_computed += 1
        else:
            self.progress.n_shared += 1

    def _share_of_task(self, point: int) -> float:
        """Share of a task that a point fills."""
        return 1.0 / self.batch if self.batch else self.costs.share(self._representation(point))

    def _representation(self, point: int) -> int:
        return int(self.plan.cells[point]) // math.prod(self.plan.shape[1:])

    def _work(self, piece: Piece) -> Work:
        points = [self.study.point(self.plan.index(p)) for p in range(piece.first, piece.last)]
        return points, self._start_of(piece)

    def _start_of(self, piece: Piece) -> State:
        """Where the last finished point of a sweep ended."""
        chain_start = int(self.plan.chain_starts[piece.chain])
        for point in range(piece.first - 1, chain_start - 1, -1):
            row = self.cache.rows([self.plan.keys[point]]).get(self.plan.keys[point])
            if row is not None and row.response.ended:
                return row.response.x_end, row.response.v_end
        return REST

    def _receive(self, future: Future, job: _Job) -> None:
        if future.status in ("cancelled", "lost"):
            raise ClusterError(_CLUSTER_LOST)
        try:
            result = future.result()
        except ClusterError:  # of the worker itself, so of none of its points
            raise
        except Exception as error:  # whatever a task raised, or Dask about its worker
            # Also a worker's that died with a result which nobody had fetched yet.
            if future.status != "error":
                raise ClusterError(_CLUSTER_LOST) from None
            self._take_up(job, error)
        else:
            self._store(job, result)

    def _take_up(self, job: _Job, error: Exception) -> None:
        """Compute a job that failed as a whole once more, alone; or give it up."""
        if job.attempts < (_MAX_ATTEMPTS if isinstance(error, KilledWorker) else 1):
            self.suspects.append(_Job(job.pieces, job.attempts + 1))
        else:
            killed = isinstance(error, KilledWorker)
            status = Status.KILLED if killed else Status.ERROR
            message = "its worker process died" if killed else f"{type(error).__name__}: {error}"
            failed = [Response(status=status, message=message)] * job.n_points
            self._store(job, TaskResult(failed, "", software()))

    def _store(self, job: _Job, result: TaskResult) -> None:
        check_software("a worker", result.software)
        responses = iter(result.responses)
        for piece in job.pieces:
            for point in range(piece.first, piece.last):
                self._keep(piece, point, next(responses), result.host)
            self.held.append(self.plan.keys[piece.first])
        rest = [r for piece in job.pieces if len(r := self._rest(piece))]
        due = time.monotonic() - self.last_commit > _COMMIT_SECONDS
        if rest or due or len(self.rows) >= _COMMIT_ROWS:
            self.commit()
        self.begun.extend(rest)  # starts where the rows just stored say

    def _keep(self, piece: Piece, point: int, response: Response, host: str) -> None:
        is_first = point == self.plan.chain_starts[piece.chain]
        previous = None if is_first else self.plan.keys[point - 1].hex()
        identity = self.study.point(self.plan.index(point)).identity(previous)
        self.rows.append(Row(self.plan.keys[point], identity, response, host, self.versions))
        self.progress.n_computed += 1
        self.progress.n_failed += response.status.failed
        self.costs.add(self._representation(point), response.cpu_time)

    def _rest(self, piece: Piece) -> Piece:
        """What of its chain follows a piece."""
        return Piece(piece.chain, piece.last, int(self.plan.chain_starts[piece.chain + 1]))

    def commit(self) -> None:
        """Store what has arrived; only then may others look for it."""
        if self.rows:
            self.cache.commit(self.rows)
        for key in self.held:
            self.claims.release(key)
        self.rows, self.held = [], []
        self.last_commit = time.monotonic()

    def cancel(self) -> None:
        # The cluster may be gone already; nothing of ours runs on it then.
        with suppress(Exception):
            self.client.cancel(list(self.in_flight))
        self.in_flight.clear()


def _repeated(study: Study, plan: Plan) -> set[bytes]:
    """Keys of the points that a study names under several labels."""
    labels = study.grid.representations
    if AUTO not in labels and len({x.partition("@")[0] for x in labels}) == len(labels):
        return set()
    return {key for key, n in Counter(plan.keys).items() if n > 1}


class _Costs:
    """Mean cost of the points of each representation, as far as it is known."""

    def __init__(self, engine: str) -> None:
        self.unknown = 1.0 / _FIRST_BATCH[engine]
        self.seconds: dict[int, float] = {}
        self.n_points: dict[int, int] = {}

    def add(self, representation: int, cpu_time: float) -> None:
        """Learn from a point; NaN is a point that was not measured."""
        if math.isfinite(cpu_time):
            self.seconds[representation] = self.seconds.get(representation, 0.0) + cpu_time
            self.n_points[representation] = self.n_points.get(representation, 0) + 1

    def share(self, representation: int) -> float:
        """Share of a task that one point fills."""
        n_points = self.n_points.get(representation, 0)
        if not n_points:
            return self.unknown
        seconds = _POINT_SECONDS + self.seconds[representation] / n_points
        return max(seconds / _TASK_SECONDS, 1.0 / _MAX_BATCH)


def _shuffled(plan: Plan) -> Iterator[list[Piece]]:
    """What is missing, in blocks of neighbours in random order."""
    missing = plan.unfinished()
    blocks = list(range(0, len(missing), _BLOCK))
    random.shuffle(blocks)
    return ([plan.piece(int(chain)) for chain in missing[i : i + _BLOCK]] for i in blocks)
