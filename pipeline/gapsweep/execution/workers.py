"""The workers of a local cluster, in processes that are independent of the caller's.

A fresh interpreter, which imports no script of the caller (no ``if __name__ == "__main__"`` is
needed there), runs Dask's nannies. It has a separate session: a terminal sends Ctrl-C only
to the client. The workers are forks of one process, which imports their modules while the scheduler
is still starting.
"""

import asyncio
import multiprocessing
import os
import pickle  # only for data of the process that started this one, over standard input
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import RawIOBase
from multiprocessing.util import get_temp_dir
from typing import Any

import psutil

from gapsweep.user_code.load import TEMPORARY

_CODE = "from gapsweep.execution.workers import serve; serve()"
_RUNNING, _FAILED = b".", b"!"
_LEAVE_SECONDS = 2.0
_PRELOADED = ["distributed.worker", "gapsweep.execution.task", "gapsweep.integrate.compiled"]


@contextmanager
def worker_process(folder: str) -> "Iterator[subprocess.Popen[bytes]]":
    """Start a process that waits for `start_workers`, with its temporary files in a folder.

    It ends with the block or with this process.
    """
    import dask  # the process starts without it

    settings = dask.config.get("distributed.nanny.pre-spawn-environ")
    with subprocess.Popen(
        [sys.executable, "-P", "-c", _CODE],
        env={name: str(value) for name, value in settings.items()}
        | os.environ
        | {"PYTHONPATH": search_path(), TEMPORARY: folder},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    ) as process:
        try:
            yield process
        finally:
            end_workers(process)


def start_workers(process: "subprocess.Popen[bytes]", address: str, n: int, options: Any) -> None:
    """Make a `worker_process` start workers, and restart them when they die.

    `address`: address of the scheduler.
    `options`: arguments of Dask's ``Nanny``.
    """
    import dask

    assert process.stdin is not None, "it is a pipe"
    with suppress(BrokenPipeError):  # the process has ended
        process.stdin.write(pickle.dumps((dask.config.config, address, n, options)))
        process.stdin.flush()


def workers_run(process: "subprocess.Popen[bytes]") -> bool:
    """Wait until all workers run and are restarted when they die; False if one did not start."""
    assert process.stdout is not None, "it is a pipe"
    return process.stdout.read(1) == _RUNNING


def is_lost(process: "subprocess.Popen[bytes]") -> bool:
    """Wait until a `worker_process` ends; True if `end_workers` did not end it."""
    assert process.stdin is not None, "it is a pipe"
    assert process.stdout is not None, "it is a pipe"
    process.stdout.read()
    return not process.stdin.closed


def end_workers(process: "subprocess.Popen[bytes]") -> None:
    """End a `worker_process` and its workers; to be called while the scheduler still runs."""
    assert process.stdin is not None, "it is a pipe"
    if process.returncode is not None:  # it has ended already
        return
    with suppress(BrokenPipeError):
        process.stdin.close()
    with suppress(subprocess.TimeoutExpired):
        process.wait(_LEAVE_SECONDS)
    end_group(process.pid)
    process.wait()


def end_group(pid: int) -> None:
    """Kill the leader of a session, and all processes of its group.

    On Windows, which has no sessions, the process and its descendants are killed.
    """
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError):  # nothing is left of its group
            os.killpg(pid, signal.SIGKILL)
        return
    with suppress(psutil.NoSuchProcess):
        leader = psutil.Process(pid)
        for each in (*leader.children(recursive=True), leader):
            each.kill()


def search_path() -> str:
    """``PYTHONPATH`` with which another process finds the same modules as this one."""
    return os.pathsep.join(str(folder) or os.getcwd() for folder in sys.path)


def serve() -> None:
    """Main of the worker process: run workers while stdin is open, then remove their files."""
    # Only this process writes to stdout; what workers print is dropped.
    with os.fdopen(os.dup(1), "wb", 0) as stdout, open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        _serve(stdout)
    end_group(os.getpid())  # this process and its remaining workers


def _serve(stdout: RawIOBase) -> None:
    method = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
    if method == "forkserver":
        from multiprocessing import forkserver

        multiprocessing.set_forkserver_preload(_PRELOADED)
        forkserver.ensure_running()
    import dask  # while the other process imports as well
    from distributed import Nanny, Status

    async def run(address: str, n: int, options: Any) -> None:
        nannies = [Nanny(address, **options) for _ in range(n)]
        started = asyncio.gather(*nannies, return_exceptions=True)
        # The caller may end, or end the workers, while they start.
        caller_left = asyncio.create_task(asyncio.to_thread(sys.stdin.buffer.read))
        await asyncio.wait({started, caller_left}, return_when=asyncio.FIRST_COMPLETED)
        # A nanny gives up a worker that dies before the nanny knows that it runs.
        all_run = {nanny.status for nanny in nannies} == {Status.running}
        with suppress(BrokenPipeError):  # the caller was killed
            stdout.write(_RUNNING if all_run else _FAILED)
        await caller_left
        closing = [asyncio.create_task(each.close(timeout=_LEAVE_SECONDS / 2)) for each in nannies]
        await asyncio.wait(closing, timeout=_LEAVE_SECONDS / 2)  # they remove their folders

    with suppress(EOFError):  # the starting process was killed before it asked for workers
        config, *asked = pickle.load(sys.stdin.buffer)  # of the starting process
        dask.config.set(config | {"distributed.worker.multiprocessing-method": method})
        asyncio.run(run(*asked))
    for folder in (os.environ[TEMPORARY], get_temp_dir()):  # the caller may have been killed
        shutil.rmtree(folder, ignore_errors=True)
