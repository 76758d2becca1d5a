"""Carry out a plan on a Dask cluster and commit every result as it arrives.

The client is the only writer. A bounded window of tasks is in flight, so that the size of
the study does not show in the scheduler's memory. When a worker dies, the points it held
are tried again one by one; only a point that kills its worker alone is marked killed.
"""

import logging
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any, TypeVar

import dask
from distributed import Client, Future, LocalCluster, as_completed
from distributed.scheduler import KilledWorker

from gapsweep.errors import ClusterError
from gapsweep.execution.plan import Chain, Plan
from gapsweep.execution.task import REST, TaskResult, compute
from gapsweep.integrate.problem import DEFAULT_ENGINE
from gapsweep.response.respond import Response
from gapsweep.response.walk import State
from gapsweep.status import Status
from gapsweep.store.cache import Cache, Row
from gapsweep.study.fingerprint import numerics_fingerprint
from gapsweep.study.study import Study

# Long against the price of a task (a millisecond), short against a user's patience.
_TASK_SECONDS = 0.5
_MAX_BATCH = 1000
# Before any cost is known: a compiled kernel wants its lanes filled, scipy takes seconds a point.
_FIRST_BATCH = {"compiled": 16, "scipy": 1}
# A long sweep comes back in parts, so that a kill costs one of them and not the whole sweep.
_CHAIN_PART = 16
_WINDOW = 3  # tasks in flight per worker thread
_COMMIT_SECONDS = 0.5
_COMMIT_ROWS = 200
_CONNECT_SECONDS = 10

T = TypeVar("T")
Job = tuple[Chain, ...]
OnProgress = Callable[["Progress"], None]


@dataclass(slots=True)
class Progress:
    """Counts of a run so far; handed to the observer after every task."""

    n_points: int
    n_hits: int
    n_computed: int = 0
    n_failed: int = 0
    started: float = field(default_factory=time.monotonic)

    @property
    def n_done(self) -> int:
        return self.n_hits + self.n_computed

    @property
    def rate(self) -> float:
        """Computed points per second."""
        return self.n_computed / max(time.monotonic() - self.started, 1e-9)


@contextmanager
def cluster(workers: int = 2, scheduler: str | None = None) -> Iterator[Client]:
    """A client of a local cluster of worker processes, or of a running scheduler.

    Parameters
    ----------
    workers : int
        Processes of the local cluster, one thread each.
    scheduler : str, optional
        Address of a running scheduler, as ``tcp://127.0.0.1:8786``.

    Raises
    ------
    ClusterError
        If the scheduler cannot be reached.
    """
    if scheduler is None:
        # A free port on the loopback: a second cluster on this machine must not disturb.
        options: dict[str, Any] = {
            "processes": True,
            "threads_per_worker": 1,
            "dashboard_address": "127.0.0.1:0",
        }
        # What goes wrong on a worker becomes the status of its points; its log only repeats it.
        options["silence_logs"] = logging.CRITICAL
        with _deaf_to_interrupts():
            local = LocalCluster(n_workers=workers, **options)
        with local, Client(local) as client:
            yield client
        return
    try:
        client = Client(scheduler, timeout=_CONNECT_SECONDS)
    except (OSError, ValueError, TimeoutError) as error:
        raise ClusterError(
            f"scheduler {scheduler}: cannot be reached ({_first_line(error)}); start one with "
            "'dask scheduler' or leave out --scheduler"
        ) from None
    with client:
        yield client


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Processes started in this block ignore Ctrl-C, which a terminal sends to all of them.

    The client alone decides how a run ends; workers that die on their own only print.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)


def execute(
    study: Study,
    plan: Plan,
    cache: Cache,
    client: Client,
    *,
    batch: int | None = None,
    on_progress: OnProgress | None = None,
) -> Progress:
    """Compute all missing points of a plan and store them.

    Parameters
    ----------
    batch : int, optional
        Points per task; None lets measured costs decide.
    on_progress : callable, optional
        Called with the `Progress` after every task.

    Raises
    ------
    ClusterError
        If the workers run other code, or the cluster is lost; what arrived is stored.
    """
    _check_workers(client)
    run = _Execution(study, plan, cache, client, batch, on_progress)
    try:
        run.finish()
    finally:
        run.commit()
        run.cancel()
    return run.progress


class _Execution:
    """One run: jobs waiting, tasks in flight, rows not yet committed."""

    def __init__(
        self,
        study: Study,
        plan: Plan,
        cache: Cache,
        client: Client,
        batch: int | None,
        on_progress: OnProgress | None,
    ) -> None:
        self.study, self.cache, self.client, self.batch = study, cache, client, batch
        self.on_progress = on_progress
        self.progress = Progress(plan.n_points, plan.n_hits)
        self.missing = plan.missing
        # Jobs that come before new ones: retries, and what is left of long sweeps.
        self.waiting: deque[Job] = deque()
        self.in_flight: dict[Future, Job] = {}
        self.rows: list[tuple[Row, dict[str, Any]]] = []
        self.last_commit = time.monotonic()
        self.cpu_seconds = 0.0

    def finish(self) -> None:
        completed = as_completed(loop=self.client.loop)
        self._refill(completed)
        for future in completed:
            job = self.in_flight.pop(future)
            self._receive(future, job)
            if self.on_progress is not None:
                self.on_progress(self.progress)
            self._refill(completed)

    def _refill(self, completed: as_completed) -> None:
        n_threads = sum(self.client.nthreads().values())
        while len(self.in_flight) < _WINDOW * max(n_threads, 1):
            job = self.waiting.popleft() if self.waiting else self._next_job()
            if not job:
                return
            future = self.client.submit(compute, self._payload(job), pure=False)
            self.in_flight[future] = job
            completed.add(future)

    def _next_job(self) -> Job:
        """Chains for one task: as many as fill it, a sweep never being split."""
        size, job, n_points = self._batch_size(), [], 0
        for chain in self.missing:
            job.append(chain)
            n_points += min(chain.n_missing, _CHAIN_PART)
            if n_points >= size:
                break
        return tuple(job)

    def _batch_size(self) -> int:
        if self.batch is not None:
            return self.batch
        if not self.cpu_seconds:
            return _FIRST_BATCH[self.study.spec.solver.engine or DEFAULT_ENGINE]
        per_point = self.cpu_seconds / self.progress.n_computed
        return max(1, min(_MAX_BATCH, round(_TASK_SECONDS / per_point)))

    def _payload(self, job: Job) -> list[tuple[list[Any], State]]:
        return [
            ([self.study.point(i) for i in _part(chain.indices, chain)], self._state(chain))
            for chain in job
        ]

    def _state(self, chain: Chain) -> State:
        """Where the last finished point of a sweep ended."""
        done = chain.keys[: chain.n_done]
        for row in reversed([self.cache.rows([key]).get(key) for key in done]):
            if row is not None and row.response.x_end == row.response.x_end:
                return row.response.x_end, row.response.v_end
        return REST

    def _receive(self, future: Future, job: Job) -> None:
        if future.status in ("cancelled", "lost"):
            raise ClusterError("the cluster was lost; run again to resume")
        error = future.exception()
        if error is None:
            self._store(job, future.result())
        elif isinstance(error, KilledWorker) and len(job) > 1:
            self.waiting.extend((chain,) for chain in job)
        else:
            killed = isinstance(error, KilledWorker)
            status = Status.KILLED if killed else Status.ERROR
            message = "its worker process died" if killed else f"{type(error).__name__}: {error}"
            failed = Response(status=status, message=message)
            n_points = sum(len(_part(chain.keys, chain)) for chain in job)
            self._store(job, TaskResult([failed] * n_points, "", numerics_fingerprint()))

    def _store(self, job: Job, result: TaskResult) -> None:
        _check_fingerprints({"a worker": result.fingerprint})
        places = [
            (key, index)
            for chain in job
            for key, index in _part(list(zip(chain.keys, chain.indices, strict=True)), chain)
        ]
        for (key, index), response in zip(places, result.responses, strict=True):
            row = Row(key, response, result.host)
            self.rows.append((row, self.study.point(index).identity()))
            self.progress.n_computed += 1
            self.progress.n_failed += response.status.failed
            if response.cpu_time == response.cpu_time:
                self.cpu_seconds += response.cpu_time
        rest = [c for chain in job if (c := chain.after(_CHAIN_PART)).n_missing]
        if rest:
            self.commit()  # the next part starts where this one's rows say
            self.waiting.extend((chain,) for chain in rest)
        due = time.monotonic() - self.last_commit > _COMMIT_SECONDS
        if due or len(self.rows) >= _COMMIT_ROWS:
            self.commit()

    def commit(self) -> None:
        if self.rows:
            self.cache.commit(self.rows)
        self.rows = []
        self.last_commit = time.monotonic()

    def cancel(self) -> None:
        # The cluster may be gone already; nothing of ours runs on it then.
        with suppress(Exception):
            self.client.cancel(list(self.in_flight))
        self.in_flight.clear()


def _part(values: Sequence[T], chain: Chain) -> Sequence[T]:
    """Of a chain's values, those of the points that its next task computes."""
    return values[chain.n_done : chain.n_done + _CHAIN_PART]


def _check_workers(client: Client) -> None:
    try:
        client.wait_for_workers(1, timeout=_CONNECT_SECONDS)
        _check_fingerprints(client.run(numerics_fingerprint))
    except (OSError, TimeoutError, ImportError, dask.base.DaskError) as error:
        raise ClusterError(f"the cluster has no usable worker: {_first_line(error)}") from None


def _check_fingerprints(found: dict[str, str]) -> None:
    ours = numerics_fingerprint()
    for worker, fingerprint in found.items():
        if fingerprint != ours:
            raise ClusterError(
                f"{worker} runs other numerics ({fingerprint}, here {ours}): install the same "
                "gapsweep there"
            )


def _first_line(error: BaseException) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]
