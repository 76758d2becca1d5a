"""The Dask cluster a run works on: a local one, or any that is already there."""

import logging
import signal
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from multiprocessing import resource_tracker, spawn
from typing import Any

import dask
from distributed import Client, LocalCluster

from gapsweep.errors import ClusterError
from gapsweep.study.software import software

_CONNECT_SECONDS = 10
_WAIT_SECONDS = 0.1
_WORKER = "Dask Worker process"  # what Dask calls them
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


@contextmanager
def cluster(workers: int, scheduler: str | None = None) -> Iterator[Client]:
    """A client of a local cluster of worker processes, or of a running scheduler.

    Parameters
    ----------
    workers : int
        Processes of the local cluster, one thread each.
    scheduler : str, optional
        Address of a running scheduler, as ``tcp://127.0.0.1:8786``; for ``tls://`` the keys are
        those of Dask's configuration.

    Raises
    ------
    ClusterError
        If the scheduler cannot be reached, or no local cluster starts.
    """
    if scheduler is None:
        # Free ports on the loopback, so that no other cluster is disturbed. Temporary TLS keys, so
        # that no other process of the machine can run code in the workers or in this process.
        options: dict[str, Any] = {
            "host": "127.0.0.1",
            "processes": True,
            "threads_per_worker": 1,
            "security": True,
            "dashboard_address": "127.0.0.1:0",
        }
        # What goes wrong on a worker becomes the status of its points; its log only repeats it.
        options["silence_logs"] = logging.CRITICAL
        # Which Dask ends too early for this one, of connections to workers that died.
        logging.getLogger("distributed.batched").setLevel(logging.CRITICAL)
        with dask.config.set(_LOCAL_SETTINGS), _without_main(), ExitStack() as opened:
            with _deaf_to_interrupts():
                try:
                    local = opened.enter_context(LocalCluster(n_workers=workers, **options))
                except RuntimeError as error:  # what Dask makes of a worker that died too early
                    raise ClusterError(
                        f"no local cluster of {workers} workers ({first_line(error)}): a worker "
                        "process died as it started, perhaps for lack of memory; run again"
                    ) from None
            yield opened.enter_context(Client(local))
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
def _deaf_to_interrupts() -> Iterator[None]:
    """Processes started in this block never hear of Ctrl-C, which a terminal sends to all of them.

    The client alone decides how a run ends; workers that die on their own only print. What is
    blocked is inherited, by threads and processes; here it arrives when the block ends.
    """
    if not hasattr(signal, "pthread_sigmask"):  # not a POSIX system
        yield
        return
    stopping = {signal.SIGINT, signal.SIGHUP}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, stopping)
    resource_tracker.ensure_running()  # which lifts the block of Ctrl-C once it is started
    signal.pthread_sigmask(signal.SIG_BLOCK, stopping)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _without_main() -> Iterator[None]:
    """Workers started in this block do not run the script that called us once more.

    Python imports it into every process that it spawns: what stands there outside of ``if __name__
    == "__main__"``, as our caller may, would begin anew. Tasks need nothing of it.
    """
    usual = spawn.get_preparation_data

    def prepared(name: str) -> dict[str, Any]:
        data = usual(name)
        if name.startswith(_WORKER):
            for key in ("init_main_from_name", "init_main_from_path"):
                data.pop(key, None)
        return data

    spawn.get_preparation_data = prepared
    try:
        yield
    finally:
        spawn.get_preparation_data = usual


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
        raise ClusterError("client: asynchronous; pass a synchronous one, as Client(address)")
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
        warnings.warn(f"{worker} {reason}; this worker was retired", stacklevel=2)
        client.retire_workers([worker])


def _refusal(answer: Mapping[str, str] | BaseException) -> str:
    """Why a worker that answers so with its `software` is refused; empty if it is not."""
    if isinstance(answer, BaseException):
        return (
            f"cannot run gapsweep ({first_line(answer)}): install the same version there, in the "
            "environment that its 'dask worker' runs in"
        )
    for name, ours in software().items():
        if (theirs := answer.get(name)) != ours:
            what = "gapsweep with the sources" if name == "numerics" else name
            return f"runs {what} {theirs}, here {ours}: install the same there and start it again"
    return ""


def first_line(error: BaseException) -> str:
    """What an error says, short enough for a message."""
    return (str(error) or type(error).__name__).splitlines()[0]
