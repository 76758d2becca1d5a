"""Function calls in a separate Python process, which may crash, hang or run out of memory.

The process is a fresh interpreter that imports no script of the caller. Calls and results travel
over a private socket, so output of the called code does not mix with them.
"""

import ctypes
import os
import pickle  # only for data of the process started here, over a private connection
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from math import ceil
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

import psutil
from distributed.system import MEMORY_LIMIT

from gapsweep.errors import ClusterError, ModelError, described
from gapsweep.execution.workers import end_group, search_path
from gapsweep.status import Status
from gapsweep.study.software import software
from gapsweep.user_code.load import TEMPORARY

try:
    import resource
except ImportError:  # not a POSIX system: there only the time of calls is limited
    resource = None  # type: ignore[assignment]  # `_limit` tests for the missing module

Result = TypeVar("Result")

LONGEST = 1e8  # s: the operating system takes no infinite limit
START_SECONDS = 120.0
_LOOK_SECONDS = 0.1
_LEAVE_SECONDS = 2.0
# A call beyond its time limit on the clock is ended if it used a smaller share of the processor.
# With a larger share the machine is busy: the call has up to 50 times the limit on the clock.
IDLE_SHARE = 0.02
_PR_SET_PDEATHSIG = 1  # option of prctl on Linux
CHILD = "from gapsweep.execution.isolated import serve; serve()"


class CallError(Exception):
    """Failure of a call; its `status` is `KILLED`, `TIMED_OUT`, `MODEL_INVALID` or `ERROR`."""

    def __init__(self, status: Status, message: str) -> None:
        super().__init__(status, message)
        self.status, self.message = status, message


class Isolated:
    """Run calls in a separate process; a context manager.

    The first call starts the process, as does a call after one that ended the process.

    Parameters
    ----------
    timeout : float
        Processor time [s] that a call may take, rounded up to seconds; wall time if the call
        leaves the processor idle.
    memory : int, optional
        Address space [bytes] that the process may add to its initial one; by default the memory of
        the machine, or of the container.
    """

    def __init__(self, timeout: float, memory: int | None = None) -> None:
        self.timeout, self.memory = min(timeout, LONGEST), int(memory or MEMORY_LIMIT)
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> "Isolated":
        return self

    def __exit__(self, *_: object) -> None:
        self._end(_LEAVE_SECONDS)

    def __call__(self, function: Callable[..., Result], *arguments: Any) -> Result:
        """Call a function with picklable arguments in the process, and return its result.

        Raises `CallError` if the function raises, ends its process or takes too long. Raises
        `ClusterError` if the process runs other code than the caller.
        """
        return self.within(self.timeout, function, *arguments)

    def within(self, timeout: float, function: Callable[..., Result], *arguments: Any) -> Result:
        """Call a function as `__call__` does, with this time limit [s]."""
        if self._process is not None and self._process.poll() is not None:
            self._end()  # ended since the last call
        try:
            process = self._process or self._started()
            call = pickle.dumps((function, arguments))
            with suppress(ConnectionError):  # how the process ended is reported below
                self._pipe.send((timeout, self.memory, call))
            found: Result | CallError | ClusterError = self._answer(process, timeout)
        except BaseException:
            self._end()
            raise
        if isinstance(found, CallError | ClusterError):
            raise found
        return found

    def _started(self) -> "subprocess.Popen[bytes]":
        self._pipe, theirs = Pipe()
        self._folder = TemporaryDirectory(
            prefix="gapsweep-", dir=os.environ.get(TEMPORARY), ignore_cleanup_errors=True
        )
        with theirs:
            process = self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", CHILD, str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                env=os.environ | {"PYTHONPATH": search_path(), TEMPORARY: self._folder.name},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # gets no Ctrl-C; its group holds all processes it starts
            )
        if self._answer(process, START_SECONDS) != software():
            raise ClusterError("the code of gapsweep changed during the run; run again to resume")
        return process

    def _answer(self, process: "subprocess.Popen[bytes]", timeout: float) -> Any:
        """The next object that the process sends; a CallError if it ends or takes too long."""
        began, spent = time.monotonic(), _processor_seconds(process.pid)
        try:
            while not self._pipe.poll(_LOOK_SECONDS) and process.poll() is None:
                took, used = time.monotonic() - began, _processor_seconds(process.pid) - spent
                if took > timeout and not IDLE_SHARE * took < used < timeout + 2.0:
                    raise _too_long(timeout)
            if not self._pipe.poll():  # a child of the process may hold the connection open
                raise _lost(process, timeout)
            return self._pipe.recv()
        except (EOFError, ConnectionError):
            raise _lost(process, timeout) from None
        except (CallError, OSError):
            raise
        except Exception as error:  # unpickling a user's object may raise any error
            raise CallError(*failure(error)) from None

    def _end(self, patience: float = 0.0) -> None:
        """End the process and its children, after `patience` seconds for its clean-up."""
        # Another thread, whose call this ends, calls this too and finds no process.
        process, self._process = self._process, None
        if process is not None:
            self._pipe.close()
            with suppress(subprocess.TimeoutExpired):
                process.wait(patience)
            end_group(process.pid)
            process.wait()
            self._folder.cleanup()


def failure(error: BaseException) -> tuple[Status, str]:
    """Status and message of a call that raised an error."""
    if isinstance(error, ModelError):
        return Status.MODEL_INVALID, str(error)
    return Status.ERROR, described(error)


def _too_long(timeout: float) -> CallError:
    return CallError(Status.TIMED_OUT, f"exceeded the time limit of {timeout:g} s")


def _lost(process: "subprocess.Popen[bytes]", timeout: float) -> CallError:
    """CallError that says how a process ended that has closed its connection."""
    try:
        code = process.wait(_LEAVE_SECONDS)
    except subprocess.TimeoutExpired:
        return CallError(Status.KILLED, "its process closed the connection")
    if code == -signal.SIGXCPU:
        return _too_long(timeout)
    if code < 0:
        return CallError(Status.KILLED, f"its process was ended by {signal.Signals(-code).name}")
    return CallError(Status.KILLED, f"its process ended with exit code {code}")


def _processor_seconds(pid: int) -> float:
    try:
        times = psutil.Process(pid).cpu_times()
    except psutil.Error:  # it has just ended
        return 0.0
    return float(times.user + times.system)


def serve() -> None:
    """Main loop of the isolated process: run calls until the caller closes the connection."""
    if sys.platform == "linux":  # the caller may be killed while a call hangs
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    pipe, at_start = Connection(int(sys.argv[1])), psutil.Process().memory_info().vms
    _limit("RLIMIT_CORE", 0)
    with suppress(EOFError, ConnectionError):  # the caller has gone
        pipe.send(software())
        while True:
            timeout, memory, call = pipe.recv()
            _limit("RLIMIT_AS", at_start + memory)
            _limit("RLIMIT_CPU", ceil(time.process_time() + timeout))
            pipe.send_bytes(_result(call))


def _limit(name: str, value: int) -> None:
    if resource is None:
        return
    kind = getattr(resource, name)
    _, hard = resource.getrlimit(kind)
    resource.setrlimit(kind, (value if hard < 0 else min(value, hard), hard))


def _result(call: bytes) -> bytes:
    try:
        function, arguments = pickle.loads(call)  # sent by the process that started this one
        return pickle.dumps(function(*arguments))
    except ClusterError as error:  # an error of the process, not of its points
        return pickle.dumps(error)
    except BaseException as error:  # a law may raise any BaseException, as SystemExit
        return pickle.dumps(CallError(*failure(error)))
