"""Carry out a plan on a Dask cluster and store every result as it arrives.

The client is the only writer. A bounded number of tasks is in flight, so that the scheduler's
memory does not grow with the study. Tasks are taken in random order, claimed and looked up in the
cache before they are submitted, so that two runs on one cache share the work. When a worker dies,
its points are retried one by one in isolated processes; only a point that fails there is marked
as failed.
"""

import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from distributed import Client, Future, as_completed
from distributed.scheduler import KilledWorker

from gapsweep.errors import ClusterError
from gapsweep.execution.cluster import check_workers
from gapsweep.execution.isolated import LONGEST
from gapsweep.execution.plan import Plan
from gapsweep.execution.portions import (
    MAX_BATCH,
    Costs,
    Rows,
    cut,
    is_first_of_sweep,
    once,
    repeated,
    shuffled,
)
from gapsweep.execution.progress import DEFAULT_TIMEOUT, OnProgress, Progress, tell
from gapsweep.execution.sweeps import start_of
from gapsweep.execution.task import Task, TaskResult, Tile, compute, compute_isolated, process
from gapsweep.integrate.problem import DEFAULT_ENGINE
from gapsweep.response.result import Response, Responses
from gapsweep.status import Status
from gapsweep.store.cache import Cache
from gapsweep.store.slab import Slab
from gapsweep.store.work_locks import WorkLocks
from gapsweep.study.points import KEY
from gapsweep.study.software import software
from gapsweep.study.study import Study

# A task takes at most this part of a thread's share of the points, so that all end together.
_PART_OF_SHARE = 0.5
_MIN_BATCH = 64
_KNOWN = 0.1  # share of the points to compute before the remaining time is estimated
_WINDOW = 3  # tasks in flight per worker thread
COMMIT_SECONDS = 0.5
_COMMIT_POINTS = 4096
# Workers that may die of an isolated task before its points are marked as killed.
_MAX_ATTEMPTS = 5
_MAX_LOSSES = 20  # lost results of a job: far more than workers die of other causes
_WAIT_SECONDS = 0.1
_CLUSTER_LOST = "the cluster was lost; run again to resume"


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    """The points of one task, with its numbers of failed attempts and of lost results."""

    rows: Rows  # shape (n,); all of one representation
    claimed: tuple[int, int]  # first and last number claimed
    tiles: list[Tile]
    rest: Rows  # later points of their sweeps
    attempts: int = 0
    losses: int = 0


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
        Points per task; None chooses it from measured costs.
    timeout : float
        CPU time limit [s] of one point, whose status is then ``timed_out``.
    retry_failed : bool
        Whether to recompute points with a stored failure.
    on_progress : callable, optional
        Called with the `Progress` after every task.

    Raises
    ------
    ClusterError
        If all workers run other code, or the cluster is lost; completed results are stored.
    """
    timeout = min(timeout, LONGEST)
    check_workers(client, partial(tell, on_progress, plan.progress, "waiting for workers"))
    with WorkLocks(cache.path, plan.keys.data) as claims:
        run = _Execution(study, plan, cache, claims, client, batch, timeout, retry_failed)
        try:
            run.finish(on_progress)
        finally:
            run.cancel()
            run.commit()
        cache.merge()
    return run.progress


class _Execution:
    """State of the computation of a plan: waiting points, tasks in flight, unstored results."""

    def __init__(
        self,
        study: Study,
        plan: Plan,
        cache: Cache,
        claims: WorkLocks,
        client: Client,
        batch: int | None,
        timeout: float,
        retry_failed: bool,
    ) -> None:
        self.study, self.plan, self.cache, self.claims = study, plan, cache, claims
        self.client, self.batch, self.timeout = client, batch, timeout
        # The last windows of all points of a task are in memory at once, state by state.
        self.largest_batch = 2 * MAX_BATCH // study.structure.n_states
        self.largest_hit = Status.OUT_OF_FIT_RANGE if retry_failed else max(Status)
        # Stored points to recompute: failures, and later points of their sweeps.
        self.is_stale = plan.is_missing & (plan.status >= 0)
        self.progress = plan.progress
        self.is_repeated = repeated(plan)
        missing = once(plan, self.is_repeated)
        self.blocks = shuffled(plan, missing)
        self.n_new = len(missing)
        is_swept = plan.follows | np.append(plan.follows[1:], False)
        self.kinds = plan.representation(np.arange(plan.n_points)), is_swept.astype(int)
        self.n_left = np.zeros((plan.shape[0], 2), int)
        self._count(missing, 1)
        self.n_once = plan.n_missing - len(missing)  # computed under another label only
        # Points taken before new ones: the rest of a block, and of long sweeps.
        self.begun: deque[Rows] = deque()
        # Points claimed by another run: tried when no other points are left.
        self.elsewhere: list[Rows] = []
        self.n_threads = 1
        self.suspects: deque[_Job] = deque()
        self.in_flight: dict[Future, _Job] = {}
        self.arrived: list[Slab] = []
        self.held: list[tuple[int, int]] = []  # claims on the points of those slabs
        self.last_commit = time.monotonic()
        self.costs = Costs(study.spec.solver.engine or DEFAULT_ENGINE, timeout, plan.shape[0])

    def finish(self, on_progress: OnProgress | None) -> None:
        completed = as_completed(loop=self.client.loop)
        while True:
            self._refill(completed)
            if on_progress is not None:
                n_known = self.progress.n_done - self.progress.n_hits
                if n_known >= _KNOWN * self.plan.n_missing:
                    self.progress.seconds_left = self.costs.seconds_left(self.n_left)
                on_progress(self.progress)
            if self.in_flight:
                future = next(completed)
                self._receive(future, self.in_flight.pop(future))
            elif self.elsewhere:
                # The other run may be waiting for claims that this run still holds.
                self.commit()
                time.sleep(_WAIT_SECONDS)
            else:
                break
        self.progress.n_computed += self.n_once
        if self.n_once and on_progress is not None:
            on_progress(self.progress)

    # --- sending ---------------------------------------------------------------------------------

    def _refill(self, completed: as_completed) -> None:
        try:
            self.n_threads = max(sum(self.client.nthreads().values()), 1)
        except OSError:  # the scheduler left in this very moment
            raise ClusterError(_CLUSTER_LOST) from None
        # Tasks are small until a cost is known: a second one in the queue of a worker gains little.
        window = _WINDOW if self.costs.n_points.any() else 1
        while len(self.in_flight) < window * self.n_threads:
            job = self.suspects.popleft() if self.suspects else self._next_job()
            if job is None:
                return
            task = Task(job.tiles, self.timeout, process())
            body = compute_isolated if job.attempts else compute
            future = self.client.submit(body, task, pure=False)
            self.in_flight[future] = job
            completed.add(future)

    def _next_job(self) -> _Job | None:
        """A job of claimed points that fill one task; None if no points are available now."""
        while (drawn := self._drawn()) is not None:
            rows, rest = drawn
            claimed = int(rows[0]), int(max(rows[-1], rest[-1] if rest.size else 0))
            if not self.claims.take(*claimed):
                self.elsewhere.append(np.union1d(rows, rest))
                continue
            # After the claim: the lookup sees all results stored before it.
            self.n_new -= len(rows)
            wanted = self._not_stored(rows)
            if wanted.size:
                return _Job(wanted, claimed, self._tiles(wanted), rest)
            self.claims.release(*claimed)
            if rest.size:
                self.begun.append(rest)
        return None

    def _drawn(self) -> tuple[Rows, Rows] | None:
        """Points that fill a task, and the later points of their sweeps; None if none is left."""
        # Until the cost of a law is known, take another law: workers then compile in parallel.
        if not self.begun or not self.costs.knows(self._kind(self.begun[0][0])):
            block = next(self.blocks, None)
            if block is not None:
                self.begun.appendleft(block)
        if not self.begun:
            self._take_back()
        if not self.begun:
            return None
        rows = self.begun.popleft()
        drawn, rest, others = cut(rows, self.plan.follows, self._room(rows[0]))
        if others.size:
            self.begun.appendleft(others)
        return drawn, rest

    def _room(self, point: np.intp) -> int:
        """Return the points of a task: `batch`, or a share that lets all threads end together.

        The share is at least as large as one client can send to all threads in time, but takes
        no longer than a task may.
        """
        if self.batch:
            return self.batch
        kind, of_thread = self._kind(point), self.plan.n_missing // self.n_threads
        least = min(self.costs.least(kind, self.n_threads), of_thread)
        share = int(_PART_OF_SHARE * self.n_new / self.n_threads)
        return min(max(share, least, _MIN_BATCH), self.costs.room(kind), self.largest_batch)

    def _kind(self, point: np.intp) -> tuple[int, int]:
        representation, is_swept = self.kinds
        return int(representation[point]), int(is_swept[point])

    def _count(self, rows: Rows, sign: int) -> None:
        """Add points to the counts of missing points (`sign` 1), or subtract them (-1)."""
        representation, is_swept = self.kinds
        np.add.at(self.n_left, (representation[rows], is_swept[rows]), sign)

    def _take_back(self) -> None:
        """Queue points that other runs had claimed and have released."""
        held = []
        for rows in self.elsewhere:
            ends = int(rows[0]), int(rows[-1])
            if self.claims.take(*ends):
                self.claims.release(*ends)
                self.begun.append(rows)
            else:
                held.append(rows)
        self.elsewhere = held

    def _not_stored(self, rows: Rows) -> Rows:
        """The points without a stored result; points found in the cache are counted as done.

        This run has stored them under another label, or another run has.
        """
        status = self.cache.status(self.plan.keys[rows])
        is_hit = (status >= 0) & (status <= self.largest_hit) & ~self.is_stale[rows]
        hits = rows[is_hit & self.plan.is_missing[rows]]
        n_ours = int(self.is_repeated[hits].sum())
        self.progress.n_computed += n_ours
        self.progress.n_shared += len(hits) - n_ours
        self._count(hits, -1)
        return rows[~is_hit]

    def _tiles(self, rows: Rows) -> list[Tile]:
        keys, previous = self.plan.keys[rows], self.plan.previous(rows)
        is_first = is_first_of_sweep(rows, self.plan.follows)
        tiles = []
        for at, points in self.study.points(self.plan.cells[rows]):
            firsts = np.flatnonzero(is_first[at])
            lengths = np.diff(firsts, append=len(at))
            states = np.zeros((len(firsts), points.kind.n_states))
            origins = np.zeros(len(firsts), KEY)
            if points.kind.is_sweep:
                for i, key in enumerate(previous[at[firsts], None]):
                    states[i], origins[[i]] = start_of(self.cache, key, states.shape[1])
            of_points = points.kind.identity, keys[at], previous[at]
            tiles.append(Tile(points, *of_points, lengths, states, origins))
        return tiles

    # --- receiving -------------------------------------------------------------------------------

    def _receive(self, future: Future, job: _Job) -> None:
        if is_gone(future):
            self._retry_lost(job)
            return
        try:
            result = future.result()
        except ClusterError:  # an error of the worker, not of its points
            raise
        except Exception as error:  # any error of a task is the failure of its points
            if is_gone(future) or future.status != "error":  # lost, perhaps being recomputed
                self._retry_lost(job)
            else:
                if not isinstance(error, KilledWorker):
                    check_workers(self.client)  # a worker with other code may have joined
                self._take_up(job, error)
        else:
            if result.software == software():
                self._keep(job, result)
                return
            check_workers(self.client)  # a worker with other code has joined
            self._retry_lost(job)

    def _retry_lost(self, job: _Job) -> None:
        if job.losses == _MAX_LOSSES:
            raise ClusterError(
                f"a result was lost {_MAX_LOSSES} times because workers died before it was "
                "fetched; see their logs, and run again to resume"
            )
        self.suspects.append(replace(job, losses=job.losses + 1))

    def _take_up(self, job: _Job, error: Exception) -> None:
        """Retry a failed job point by point in isolation, or mark its points as failed."""
        if job.attempts < (_MAX_ATTEMPTS if isinstance(error, KilledWorker) else 1):
            self.suspects.append(replace(job, attempts=job.attempts + 1))
            return
        killed = isinstance(error, KilledWorker)
        status = Status.KILLED if killed else Status.ERROR
        message = "its worker process died" if killed else f"{type(error).__name__}: {error}"
        failed = Response(status=status, message=message)
        slabs = [
            slab
            for tile in job.tiles
            for slab in tile.slabs(
                Responses.of([failed] * len(tile), tile.points.kind.structure), ""
            )
        ]
        self._keep(job, TaskResult(slabs, 0.0, 0.0, software()))

    def _keep(self, job: _Job, result: TaskResult) -> None:
        self.arrived += result.slabs
        self.progress.n_computed += len(job.rows)
        self.progress.n_failed += sum(slab.n_failed for slab in result.slabs)
        self._count(job.rows, -1)
        whole = sum(slab.seconds for slab in result.slabs)
        for is_swept in (False, True) if result.seconds else ():
            some = [slab for slab in result.slabs if slab.kind.is_sweep == is_swept]
            if n := sum(slab.n_points for slab in some):
                # Points of refused models take no measured time, but their tasks do.
                seconds = sum(slab.seconds for slab in some)
                share = seconds / whole if whole else n / len(job.rows)
                kind = self._kind(job.rows[0])[0], int(is_swept)
                self.costs.add(kind, n, share * result.seconds, share * result.spent)
        self.held.append(job.claimed)
        due = time.monotonic() - self.last_commit > COMMIT_SECONDS
        n_arrived = sum(slab.n_points for slab in self.arrived)
        if job.rest.size or due or n_arrived >= _COMMIT_POINTS:
            self.commit()
        if job.rest.size:
            self.begun.append(job.rest)

    def commit(self) -> None:
        """Store the completed results, and then release the claims on their points."""
        if self.arrived:
            self.cache.commit(self.arrived)
        for claimed in self.held:
            self.claims.release(*claimed)
        self.arrived, self.held = [], []
        self.last_commit = time.monotonic()

    def cancel(self) -> None:
        with suppress(Exception):  # Dask may raise any error if the cluster has ended
            self.client.cancel(list(self.in_flight))
        self.in_flight.clear()


def is_gone(future: Future) -> bool:
    """Whether the result of a task was lost with its worker before it was fetched.

    Raises
    ------
    ClusterError
        If the cluster itself is gone.
    """
    if future.status == "cancelled":
        raise ClusterError(_CLUSTER_LOST) from None
    return future.status in ("lost", "pending")
