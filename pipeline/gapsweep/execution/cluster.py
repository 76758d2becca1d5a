"""The Dask cluster a run works on: a local one, or any that is already there."""

import logging
import signal
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from multiprocessing import resource_tracker, spawn
from typing import Any

import dask
from distributed import Client, LocalCluster

from gapsweep.errors import ClusterError
from gapsweep.study.software import software

_CONNECT_SECONDS = 10
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


def check_workers(client: Client) -> None:
    """Refuse a cluster whose workers are missing, or run other code than we do.

    Raises
    ------
    ClusterError
        If there is no worker, or one cannot answer, or one has other numerics, another Python,
        or other versions of the libraries that compute.
    """
    if client.asynchronous:
        raise ClusterError("client: asynchronous; pass a synchronous one, as Client(address)")
    try:
        client.wait_for_workers(1, timeout=_CONNECT_SECONDS)
        answers = client.run(software, on_error="return")
    except (OSError, TimeoutError) as error:
        raise ClusterError(f"the cluster has no usable worker: {first_line(error)}") from None
    for worker, answer in answers.items():
        if isinstance(answer, OSError):
            continue  # it left meanwhile; what comes instead is checked with its first result
        if isinstance(answer, BaseException):
            raise ClusterError(
                f"{worker} cannot run gapsweep ({first_line(answer)}): install the same version "
                "there, in the environment that its 'dask worker' runs in"
            )
        check_software(worker, answer)


def check_software(worker: str, theirs: Mapping[str, str]) -> None:
    """Refuse a worker that would compute something else; `theirs` is its `software`.

    Raises
    ------
    ClusterError
        If its numerics, its Python or a library differ from ours.
    """
    for name, ours in software().items():
        if name == "numerics" and theirs[name] != ours:
            raise ClusterError(
                f"{worker} runs other numerics (sources {theirs[name]}, here {ours}): install the "
                "same gapsweep there and start it again"
            )
        if theirs[name] != ours:
            raise ClusterError(
                f"{worker} runs {name} {theirs[name]}, here {ours}: use the same on both sides"
            )


def first_line(error: BaseException) -> str:
    """What an error says, short enough for a message."""
    return (str(error) or type(error).__name__).splitlines()[0]
