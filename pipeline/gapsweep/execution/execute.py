"""Carry out a plan on a Dask cluster and store every result as it arrives.

The client is the only writer. A bounded number of tasks is in flight, so that the scheduler's
memory does not grow with the study. Tasks are taken in random order, claimed and looked up in the
cache before they are submitted, so that two runs on one cache share the work. When a worker dies,
its points are retried one by one in isolated processes; only a point that fails there is marked
as failed.
"""

import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from distributed import Client, Future, as_completed
from distributed.scheduler import KilledWorker
from numpy.typing import NDArray

from gapsweep.errors import ClusterError
from gapsweep.execution.cluster import check_workers
from gapsweep.execution.isolated import LONGEST
from gapsweep.execution.plan import BLOCK, Block, Plan
from gapsweep.execution.portions import Costs, Rows, cut, is_first_of_sweep, shuffled
from gapsweep.execution.progress import DEFAULT_TIMEOUT, OnProgress, Progress, tell
from gapsweep.execution.sweeps import start_of
from gapsweep.execution.task import (
    Task,
    TaskResult,
    Tile,
    compute,
    compute_isolated,
    process,
    respond_fixed,
)
from gapsweep.integrate.problem import DEFAULT_ENGINE
from gapsweep.response.result import Response, Responses
from gapsweep.status import Status
from gapsweep.store.cache import Cache
from gapsweep.store.index import words
from gapsweep.store.slab import Slab
from gapsweep.store.work_locks import WorkLocks
from gapsweep.study.points import KEY, Points
from gapsweep.study.software import software

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
_COUNT_SECONDS = 1.0  # between two looks at the threads of the cluster
# Points that are computed together; numbers in their block, ascending.
Portion = tuple[Block, Rows]
_CLUSTER_LOST = "the cluster was lost; run again to resume"


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    """The points of one task, with its numbers of failed attempts and of lost results."""

    block: Block
    rows: Rows  # shape (n,)
    claimed: tuple[int, int]  # first and last number claimed
    tiles: list[Tile]
    rest: Rows  # later points of their sweeps
    attempts: int = 0
    losses: int = 0


def execute(
    plan: Plan,
    client: Client,
    *,
    batch: int | None = None,
    timeout: float = DEFAULT_TIMEOUT,
    retry_failed: bool = False,
    on_progress: OnProgress | None = None,
    meanwhile: Iterator[bool] | None = None,
) -> Progress:
    """Compute all missing points of a plan and store them.

    Raises `ClusterError` if all workers run other code, or the cluster is lost; completed results
    are stored.

    Parameters
    ----------
    plan : Plan
        Status and places of results are entered when they are stored.
    batch : int, optional
        Points per task; None chooses it from measured costs.
    timeout : float
        CPU time limit [s] of one point, whose status is then ``timed_out``.
    retry_failed : bool
        Whether to recompute points with a stored failure.
    on_progress : callable, optional
        Called with the `Progress` after every task.
    meanwhile : iterator of bool, optional
        Other work of this process, a step each, while no result has arrived. False: nothing can
        be done until further points are stored.
    """
    timeout = min(timeout, LONGEST)
    check_workers(client, partial(tell, on_progress, plan.progress, "waiting for workers"))
    cache = plan.cache
    assert cache is not None, "where results are stored"
    with WorkLocks(cache.path, plan.mark) as claims:
        run = _Execution(plan, cache, claims, client, batch, timeout, retry_failed)
        try:
            run.finish(on_progress, meanwhile or iter(()))
        finally:
            run.cancel()
            run.commit()
        cache.merge()
    return run.progress


def responses_from(tables: Sequence[Points], client: Client) -> list[Responses]:
    """Responses of tables of points from their fixed initial states; they are not stored.

    Tables of a worker that dies are recomputed. Raises `ClusterError` if workers die of a
    table again and again, or the cluster is lost.
    """
    found: dict[int, Responses] = {}
    for _ in range(_MAX_ATTEMPTS):
        left = [i for i in range(len(tables)) if i not in found]
        futures = {client.submit(respond_fixed, tables[i], pure=False): i for i in left}
        for future in as_completed(futures, loop=client.loop):
            with suppress(KilledWorker):
                if not is_gone(future):
                    found[futures[future]] = future.result()
        if len(found) == len(tables):
            return [found[i] for i in range(len(tables))]
    raise ClusterError(
        f"workers died in {_MAX_ATTEMPTS} attempts to compute disturbances; see their logs, and "
        "run again with more memory or fewer --workers"
    )


class _Execution:
    """State of the computation of a plan: waiting points, tasks in flight, unstored results."""

    def __init__(
        self,
        plan: Plan,
        cache: Cache,
        claims: WorkLocks,
        client: Client,
        batch: int | None,
        timeout: float,
        retry_failed: bool,
    ) -> None:
        self.plan, self.cache, self.claims, study = plan, cache, claims, plan.study
        self.client, self.batch, self.timeout = client, batch, timeout
        # The last windows of all points of a task are in memory at once, state by state.
        self.largest_batch = 2 * BLOCK // study.structure.n_states
        self.largest_hit = Status.OUT_OF_FIT_RANGE if retry_failed else max(Status)
        self.progress = plan.progress
        self.blocks = shuffled(plan)
        self.n_missing = self.n_new = plan.n_missing
        self.n_left = plan.n_left
        # Points taken before new ones: the rest of a block, and of long sweeps.
        self.begun: deque[Portion] = deque()
        # Points claimed by another run, or equal to points in flight under another label: tried
        # when no other points are left.
        self.elsewhere: list[Portion] = []
        self.computing: set[int] = set()  # heads of the keys of points in flight
        self.n_threads, self.counted = 1, -np.inf  # of the cluster, and when they were counted
        self.suspects: deque[_Job] = deque()
        self.in_flight: dict[Future, _Job] = {}
        self.arrived: list[Slab] = []
        self.held: list[_Job] = []  # the jobs of those slabs, with claims on their points
        self.stored: set[bytes] = set()  # checksums of slabs that this run has stored
        self.last_commit = time.monotonic()
        self.costs = Costs(study.spec.solver.engine or DEFAULT_ENGINE, timeout, len(self.n_left))

    def finish(self, on_progress: OnProgress | None, meanwhile: Iterator[bool]) -> None:
        completed = as_completed(loop=self.client.loop)
        while True:
            self._refill(completed)
            if on_progress is not None:
                n_known = self.progress.n_done - self.progress.n_hits
                if n_known >= _KNOWN * self.n_missing:
                    self.progress.seconds_left = self.costs.seconds_left(self.n_left)
                if self.in_flight and not self.progress.n_computed:
                    tell(on_progress, self.progress, self._first_stage())
                else:
                    on_progress(self.progress)
            if self.in_flight:
                while not completed.has_ready() and next(meanwhile, False):
                    pass
                future = next(completed)
                self._receive(future, self.in_flight.pop(future))
            elif self.elsewhere:
                # The other run may be waiting for claims that this run still holds.
                self.commit()
                time.sleep(_WAIT_SECONDS)
            else:
                break

    def _first_stage(self) -> str:
        """Stage until the first result arrives: workers load or compile code for their laws."""
        numbers = {job.block.representation for job in self.in_flight.values()}
        laws = ", ".join(self.plan.study.grid.representations[i] for i in sorted(numbers))
        return f"loading kernels of {laws} (the first run compiles them)"

    # --- sending ---------------------------------------------------------------------------------

    def _refill(self, completed: as_completed) -> None:
        if (now := time.monotonic()) > self.counted + _COUNT_SECONDS:
            try:
                self.n_threads = max(sum(self.client.nthreads().values()), 1)
            except OSError:  # the scheduler left in this very moment
                raise ClusterError(_CLUSTER_LOST) from None
            self.counted = now
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
            block, rows, rest = drawn
            claimed = _ends(block, np.append(rows, rest))
            if not self._take(block, rows, claimed):
                self.elsewhere.append((block, np.union1d(rows, rest)))
                continue
            # After the claim: the lookup sees all results stored before it.
            self.n_new -= len(rows)
            wanted = self._not_stored(block, rows)
            if wanted.size:
                self.computing.update(_heads(block, wanted).tolist())
                return _Job(block, wanted, claimed, self._tiles(block, wanted), rest)
            self.claims.release(*claimed)
            if rest.size:
                self.begun.append((block, rest))
        return None

    def _take(self, block: Block, rows: Rows, claimed: tuple[int, int]) -> bool:
        """Claim points; False if another run has claimed some, or equal ones are in flight."""
        is_free = self.computing.isdisjoint(_heads(block, rows).tolist())
        return is_free and self.claims.take(*claimed)

    def _drawn(self) -> tuple[Block, Rows, Rows] | None:
        """Points that fill a task, and the later points of their sweeps; None if none is left."""
        # Until the cost of a law is known, take another law: workers then compile in parallel.
        is_known = bool(self.begun) and self.costs.knows(_kind(*self.begun[0]))
        if not is_known and (new := next(self.blocks, None)) is not None:
            self.begun.appendleft(self._once(*new))
        if not self.begun:
            self._take_back()
        if not self.begun:
            return None
        block, rows = self.begun.popleft()
        drawn, rest, others = cut(rows, block.follows, self._room(_kind(block, rows)))
        if others.size:
            self.begun.appendleft((block, others))
        return block, drawn, rest

    def _room(self, kind: tuple[int, int]) -> int:
        """Return the points of a task: `batch`, or a share that lets all threads end together.

        The share is at least as large as one client can send to all threads in time, but takes
        no longer than a task may.
        """
        if self.batch:
            return self.batch
        of_thread = self.n_missing // self.n_threads
        least = min(self.costs.least(kind, self.n_threads), of_thread)
        share = int(_PART_OF_SHARE * self.n_new / self.n_threads)
        return min(max(share, least, _MIN_BATCH), self.costs.room(kind), self.largest_batch)

    def _count(self, block: Block, rows: Rows) -> None:
        """Subtract points from the counts of missing points."""
        self.n_left[block.representation] -= np.bincount(block.is_swept[rows], minlength=2)

    def _take_back(self) -> None:
        """Queue points that other runs had claimed and have released."""
        waiting, self.elsewhere = self.elsewhere, []
        for block, rows in waiting:
            ends = _ends(block, rows)
            if self._take(block, rows, ends):
                self.claims.release(*ends)
                self.begun.append(self._once(block, rows))
            else:
                self.elsewhere.append((block, rows))

    def _once(self, block: Block, rows: Rows) -> Portion:
        """Equal points, as of laws that do not depend on a swept parameter, once; others wait."""
        _, first = np.unique(_heads(block, rows), return_index=True)
        if len(first) < len(rows):
            self.elsewhere.append((block, np.delete(rows, first)))
        return block, rows[np.sort(first)]

    def _not_stored(self, block: Block, rows: Rows) -> Rows:
        """The points without a stored result; points found in the cache are counted as done.

        This run has stored them under another label, or another run has.
        """
        held = self.cache.held(block.keys[rows])
        is_ours = self.cache.is_in(held, self.stored)
        is_stale = block.status[rows] >= 0  # to be recomputed, although stored
        is_stored = (held["status"] >= 0) & (held["status"] <= self.largest_hit) & ~is_stale
        is_hit = is_ours | is_stored
        n_ours, n_hits = int(is_ours.sum()), int(is_hit.sum())
        self.progress.n_computed += n_ours
        self.progress.n_shared += n_hits - n_ours
        self._count(block, rows[is_hit])
        self.plan.enter(block.numbers[rows[is_hit]], held[is_hit])
        return rows[~is_hit]

    def _tiles(self, block: Block, rows: Rows) -> list[Tile]:
        keys, previous = block.keys[rows], block.previous(rows)
        is_first = is_first_of_sweep(rows, block.follows)
        tiles = []
        for at, points in block.points(rows):
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
        self._count(job.block, job.rows)
        whole = sum(slab.seconds for slab in result.slabs)
        for is_swept in (False, True) if result.seconds else ():
            some = [slab for slab in result.slabs if slab.kind.is_sweep == is_swept]
            if n := sum(slab.n_points for slab in some):
                # Points of refused models take no measured time, but their tasks do.
                seconds = sum(slab.seconds for slab in some)
                share = seconds / whole if whole else n / len(job.rows)
                kind = job.block.representation, int(is_swept)
                self.costs.add(kind, n, share * result.seconds, share * result.spent)
        self.held.append(job)
        due = time.monotonic() - self.last_commit > COMMIT_SECONDS
        n_arrived = sum(slab.n_points for slab in self.arrived)
        if job.rest.size or due or n_arrived >= _COMMIT_POINTS:
            self.commit()
        if job.rest.size:
            self.begun.append((job.block, job.rest))

    def commit(self) -> None:
        """Store the completed results, and then release the claims on their points."""
        if self.arrived:
            self.stored.update(self.cache.commit(self.arrived))
        if self.held:
            numbers = np.concatenate([job.block.numbers[job.rows] for job in self.held])
            keys = np.concatenate([job.block.keys[job.rows] for job in self.held])
            self.plan.enter(numbers, self.cache.recorded(keys))
        for job in self.held:
            self.claims.release(*job.claimed)
            self.computing.difference_update(_heads(job.block, job.rows).tolist())
        self.arrived, self.held = [], []
        self.last_commit = time.monotonic()

    def cancel(self) -> None:
        with suppress(Exception):  # Dask may raise any error if the cluster has ended
            self.client.cancel(list(self.in_flight))
        self.in_flight.clear()


def _kind(block: Block, rows: Rows) -> tuple[int, int]:
    """Kind of some points, as of `Costs`, by the first of them."""
    return block.representation, int(block.is_swept[rows[0]])


def _ends(block: Block, rows: Rows) -> tuple[int, int]:
    """First and last number of some points in the order of computation."""
    return int(block.numbers[rows.min()]), int(block.numbers[rows.max()])


def _heads(block: Block, rows: Rows) -> NDArray[np.uint64]:
    """First eight bytes of the keys of some points: they tell keys from each other."""
    return words(block.keys[rows])[:, 0]


def is_gone(future: Future) -> bool:
    """Whether the result of a task was lost with its worker before it was fetched.

    Raises `ClusterError` if the cluster itself is gone.
    """
    if future.status == "cancelled":
        raise ClusterError(_CLUSTER_LOST) from None
    return future.status in ("lost", "pending")
