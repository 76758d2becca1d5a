"""The Dask cluster of a run: a local one, or one that runs already."""

import logging
import os
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from threading import Thread
from typing import Any

import dask
from distributed import Client, LocalCluster
from distributed.system import MEMORY_LIMIT

from gapsweep.errors import ClusterError
from gapsweep.execution.workers import (
    end_workers,
    is_lost,
    start_workers,
    worker_process,
    workers_run,
)
from gapsweep.study.software import software

CONNECT_SECONDS = 10
_WAIT_SECONDS = 0.1
_LONGEST_PLACE = 71  # characters: multiprocessing adds 32, and macOS allows 103 in all
# Errors on a worker become the status of its points; its log only repeats them.
_SILENT = logging.CRITICAL
_LOCAL_SETTINGS = {
    # gapsweep retries the points of a lost worker in isolated processes.
    "distributed.scheduler.allowed-failures": 0,
    # Dask's logs of messages would keep the sweep points of a thousand tasks in memory.
    "distributed.admin.low-level-log-length": 10,
    # Dask would sample the stack of every thread a hundred times a second.
    "distributed.worker.profile.enabled": False,
    # Dask's monitors need not run more often than once a second.
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.worker.memory.monitor-interval": "1s",
}

# HTTP routes, which a cluster without dashboard does not serve.
_ROUTES = "distributed.scheduler.http.routes", "distributed.worker.http.routes"


@contextmanager
def cluster(
    workers: int,
    scheduler: str | None = None,
    *,
    dashboard: bool = False,
    meanwhile: Callable[[], object] = lambda: None,
) -> Iterator[Client]:
    """A client of a local cluster of worker processes, or of a running scheduler.

    Raises `ClusterError` if the scheduler cannot be reached, or no local cluster starts.

    `workers`: processes of the local cluster, one thread each.
    `scheduler`: address of a running scheduler, as ``tcp://127.0.0.1:8786``; for ``tls://`` the
    keys are those of Dask's configuration.
    `dashboard`: whether a local cluster serves Dask's dashboard.
    `meanwhile`: called while the processes of a local cluster start.
    """
    if scheduler is None:
        settings = _LOCAL_SETTINGS | ({} if dashboard else dict.fromkeys(_ROUTES, ()))
        with dask.config.set(settings), local_cluster(workers, dashboard, meanwhile) as client:
            yield client
        return
    try:
        client = Client(scheduler, timeout=CONNECT_SECONDS)
    except (OSError, ValueError, TypeError, TimeoutError) as error:
        raise ClusterError(
            f"scheduler {scheduler}: cannot be reached ({first_line(error)}); start one with "
            "'dask scheduler' or leave out --scheduler"
        ) from None
    # Its log of a lost scheduler would be a traceback before the error of the run.
    with _quiet("distributed.client"), client:
        yield client


@contextmanager
def local_cluster(
    workers: int, dashboard: bool, meanwhile: Callable[[], object]
) -> Iterator[Client]:
    """Client of a cluster of worker processes on this machine, which ends with the block."""
    place = tempfile.gettempdir()
    if os.name == "posix" and len(os.fsencode(place)) > _LONGEST_PLACE:
        raise ClusterError(
            f"TMPDIR = {place}: too long for the names of the workers' sockets; must have at most "
            f"{_LONGEST_PLACE} bytes, as TMPDIR=/tmp"
        )
    # Free ports on the loopback, so that no other cluster is disturbed. Temporary TLS keys, so that
    # no other process of the machine can run code in the workers or in this process.
    options: dict[str, Any] = {"host": "127.0.0.1", "security": True, "silence_logs": _SILENT}
    page = f"127.0.0.1:{8787 if dashboard else 0}"  # Dask warns if it takes another port
    pages = {"dashboard_address": page, "scheduler_kwargs": {"dashboard": dashboard}}
    with (
        tempfile.TemporaryDirectory(prefix="gapsweep-", ignore_cleanup_errors=True) as folder,
        dask.config.set({"temporary-directory": folder}),
        _quiet("distributed.batched"),  # logger of connections to dead workers
        worker_process(folder) as process,  # which imports while the scheduler starts
        LocalCluster(n_workers=0, **pages, **options) as local,
    ):
        memory = MEMORY_LIMIT // workers
        options |= {"security": local.security, "nthreads": 1, "memory_limit": memory}
        start_workers(process, local.scheduler_address, workers, options)
        try:
            meanwhile()
            with Client(local) as client:
                if not workers_run(process):
                    raise ClusterError(
                        f"no local cluster of {workers} workers: a worker process died during "
                        "startup, perhaps for lack of memory, processes "
                        "or open files (ulimit -a); try fewer --workers"
                    )

                def close_if_lost() -> None:
                    if is_lost(process):  # without a scheduler, Dask ends all waits for workers
                        local.loop.add_callback(local.scheduler.close)

                Thread(target=close_if_lost, daemon=True).start()
                yield client
        finally:
            end_workers(process)


@contextmanager
def _quiet(name: str) -> Iterator[None]:
    """Silence a logger during the block."""
    logger = logging.getLogger(name)
    level = logger.level
    logger.setLevel(_SILENT)
    try:
        yield
    finally:
        logger.setLevel(level)


def check_workers(client: Client, waiting: Callable[[], None] = lambda: None) -> None:
    """Retire workers with other versions of the code; `waiting` is called until one connects.

    Raises `ClusterError` if no worker would be left, or the client is asynchronous.

    Warns
    -----
    UserWarning
        For each worker that is retired.
    """
    if client.asynchronous:
        raise ClusterError("client: must be synchronous, as Client(address)")
    try:
        task = None
        while not client.nthreads():
            # A cluster that adapts to its work starts workers once there is a task.
            task = task or client.submit(int, pure=False)
            waiting()
            time.sleep(_WAIT_SECONDS)
        answers = client.run(software, on_error="return")
    except OSError as error:
        raise ClusterError(f"the cluster was lost: {first_line(error)}; run again") from None
    # An OSError: the worker left meanwhile.
    found = {w: _refusal(a) for w, a in answers.items() if not isinstance(a, OSError)}
    refused = {worker: reason for worker, reason in found.items() if reason}
    for worker, reason in refused.items():
        if len(refused) == len(found):
            raise ClusterError(f"{worker} {reason}")
        warnings.warn(f"{worker} {reason}; gapsweep stopped using this worker", stacklevel=2)
        client.retire_workers([worker])


def _refusal(answer: Mapping[str, str] | BaseException) -> str:
    """Reason to refuse a worker, given its `software` or an error; empty if it is accepted."""
    if isinstance(answer, BaseException):
        return (
            f"cannot run gapsweep ({first_line(answer)}); install the same version in the "
            "environment of its 'dask worker'"
        )
    for name, ours in software().items():
        if (theirs := answer.get(name)) != ours:
            what = "gapsweep with the sources" if name == "gapsweep" else name
            return (
                f"runs {what} {theirs}, here {ours}; install the same there and restart the worker"
            )
    return ""


def first_line(error: BaseException) -> str:
    """First line of an error's message, or its class name without a message."""
    return (str(error) or type(error).__name__).splitlines()[0]
