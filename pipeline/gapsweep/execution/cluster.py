"""The Dask cluster a run works on: a local one, or any that is already there."""

import logging
import os
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import dask
from distributed import Client, LocalCluster
from distributed.system import MEMORY_LIMIT

from gapsweep.errors import ClusterError
from gapsweep.execution.workers import end_workers, start_workers, worker_process
from gapsweep.study.software import software

_CONNECT_SECONDS = 10
_WAIT_SECONDS = 0.1
_LOOK_SECONDS = 0.01
_LONGEST_PLACE = 71  # characters: multiprocessing adds 32, and macOS allows 103 in all
# What goes wrong on a worker becomes the status of its points; its log only repeats it.
_SILENT = logging.CRITICAL
_LOCAL_SETTINGS = {
    # Points of a lost worker are tried again by us, where they can harm nobody.
    "distributed.scheduler.allowed-failures": 0,
    # Dask's logs of messages hold the sweep points that were in them: a thousand tasks' worth.
    "distributed.admin.low-level-log-length": 10,
    # A hundred times a second Dask would look where every thread is; nobody looks at that here.
    "distributed.worker.profile.enabled": False,
    # Nor need its processes be looked at more often than once a second.
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.worker.memory.monitor-interval": "1s",
}

# Nothing is served to whoever connects.
_ROUTES = "distributed.scheduler.http.routes", "distributed.worker.http.routes"


@contextmanager
def cluster(
    workers: int, scheduler: str | None = None, *, dashboard: bool = False
) -> Iterator[Client]:
    """A client of a local cluster of worker processes, or of a running scheduler.

    Parameters
    ----------
    workers : int
        Processes of the local cluster, one thread each.
    scheduler : str, optional
        Address of a running scheduler, as ``tcp://127.0.0.1:8786``; for ``tls://`` the keys are
        those of Dask's configuration.
    dashboard : bool
        Whether a local cluster serves Dask's dashboard.

    Raises
    ------
    ClusterError
        If the scheduler cannot be reached, or no local cluster starts.
    """
    if scheduler is None:
        settings = _LOCAL_SETTINGS | ({} if dashboard else dict.fromkeys(_ROUTES, ()))
        with dask.config.set(settings), _local(workers, dashboard) as client:
            yield client
        return
    try:
        client = Client(scheduler, timeout=_CONNECT_SECONDS)
    except (OSError, ValueError, TypeError, TimeoutError) as error:
        raise ClusterError(
            f"scheduler {scheduler}: cannot be reached ({first_line(error)}); start one with "
            "'dask scheduler' or leave out --scheduler"
        ) from None
    with client:
        yield client


@contextmanager
def _local(workers: int, dashboard: bool) -> Iterator[Client]:
    place = tempfile.gettempdir()
    if os.name == "posix" and len(os.fsencode(place)) > _LONGEST_PLACE:
        raise ClusterError(
            f"TMPDIR = {place}: must have <= {_LONGEST_PLACE} characters (of the names of workers' "
            "sockets); write TMPDIR=/tmp gapsweep run ..."
        )
    # Free ports on the loopback, so that no other cluster is disturbed. Temporary TLS keys, so that
    # no other process of the machine can run code in the workers or in this process.
    options: dict[str, Any] = {"host": "127.0.0.1", "security": True, "silence_logs": _SILENT}
    page = f"127.0.0.1:{8787 if dashboard else 0}"  # Dask warns if it takes another port
    pages = {"dashboard_address": page, "scheduler_kwargs": {"dashboard": dashboard}}
    with (
        tempfile.TemporaryDirectory(prefix="gapsweep-", ignore_cleanup_errors=True) as folder,
        dask.config.set({"temporary-directory": folder}),
        _quiet("distributed.batched"),  # of connections to workers that died
        worker_process(folder) as process,  # which imports while the scheduler starts
        LocalCluster(n_workers=0, **pages, **options) as local,
    ):
        memory = MEMORY_LIMIT // workers
        options |= {"security": local.security, "nthreads": 1, "memory_limit": memory}
        start_workers(process, local.scheduler_address, workers, options)
        try:
            with Client(local) as client:
                while len(local.scheduler.workers) < workers:
                    if process.poll() is not None:
                        raise ClusterError(
                            f"no local cluster of {workers} workers: a worker process died during "
                            "startup, perhaps for lack of memory, processes "
                            "or open files (ulimit -a); try fewer --workers"
                        )
                    time.sleep(_LOOK_SECONDS)
                yield client
        finally:
            end_workers(process)


@contextmanager
def _quiet(name: str) -> Iterator[None]:
    """Switch a logger off."""
    logger = logging.getLogger(name)
    level = logger.level
    logger.setLevel(_SILENT)
    try:
        yield
    finally:
        logger.setLevel(level)


def check_workers(client: Client, waiting: Callable[[], None] = lambda: None) -> None:
    """Retire the workers that run other code; `waiting` is called until there is a worker.

    Raises
    ------
    ClusterError
        If no other workers would be left, or the client is asynchronous.

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
    """Why a worker that answers so with its `software` is refused; empty if it is not."""
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
    """First line of an error, or its kind."""
    return (str(error) or type(error).__name__).splitlines()[0]
