"""Calls that nothing can harm: in a child process, one by one, each with a time limit.

Suspects of a sweep are computed this way, as the body of a task: when a worker is lost, nobody
can tell which of its points was to blame. So are the motions of histories and benchmarks with a
law of the user's own, which may end its process, hang or raise anything.
"""

import ctypes
import faulthandler
import multiprocessing
import os
import platform
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler  # what a Connection sends with
from typing import Any, TypeVar

import psutil

from gapsweep.errors import ClusterError
from gapsweep.execution.task import (
    WARM_UP_SECONDS,
    States,
    Task,
    TaskResult,
    Tile,
    failure,
    respond_to,
    software_with_engines,
    warm_up,
)
from gapsweep.response.result import Response, Responses
from gapsweep.status import Status
from gapsweep.study.points import Points
from gapsweep.study.software import software

Result = TypeVar("Result")

_LONGEST = 1e8  # s: what watches over time limits knows no longer ones
_START_SECONDS = 120.0
_LOOK_SECONDS = 0.1
_LEAVE_SECONDS = 2.0
# Share of the processor below which a call that takes too long waits for something that will not
# come. Whoever gets more is held up by a busy machine, up to 50 time limits.
_IDLE = 0.02
# An answer: mark, number of the call, length in bytes, then the pickled result.
_MARK = b"gapsweep"
_HEAD = struct.Struct(">8sQQ")
_PIECE = 2**20
_OTHERWISE = "its process answered with something else"
_PR_SET_PDEATHSIG = 1  # of Linux's prctl
_CHILD = "from gapsweep.execution.alone import child; child()"


def time_limit(timeout: float) -> float:
    """A time limit [s] that is a number > 0, and none that nobody would live to see.

    Raises
    ------
    ClusterError
        If it is none.
    """
    if not timeout > 0.0:
        raise ClusterError(f"timeout = {timeout:g} s: must be > 0")
    return min(timeout, _LONGEST)


class CallError(Exception):
    """A call that gave no result.

    Attributes
    ----------
    status : Status
        `KILLED`, `TIMED_OUT`, `MODEL_INVALID` or `ERROR`.
    """

    def __init__(self, status: Status, message: str) -> None:
        super().__init__(status, message)
        self.status, self.message = status, message


class Alone:
    """Carries out calls in a child process; a context manager.

    The process is started by the first call, and again after one that has ended it.

    Parameters
    ----------
    timeout : float
        Time [s] that a call may take: of the processor, so that a busy machine fails nobody, or
        of the clock if the call makes next to no use of the processor.
    """

    def __init__(self, timeout: float) -> None:
        self.timeout = time_limit(timeout)
        self._child: _Child | None = None

    def __enter__(self) -> "Alone":
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def __call__(self, function: Callable[..., Result], *arguments: Any) -> Result:
        """What a function of a module returns for arguments that can be pickled.

        Raises
        ------
        CallError
            If it raises, ends its process or takes too long.
        ClusterError
            If the process has other code than the caller.
        """
        return self.within(self.timeout, function, *arguments)

    def within(self, timeout: float, function: Callable[..., Result], *arguments: Any) -> Result:
        """A call with a time limit [s] of its own."""
        if self._child is not None and self._child.is_spent:
            self._end()  # that is no fault of this call
        if self._child is None:
            self._child = _Child()
            self._check()
        try:
            found = self._child.ask(function, arguments, timeout)
        except BaseException:
            self._end()
            raise
        if isinstance(found, CallError | ClusterError):
            raise found
        result: Result = found
        return result

    def _check(self) -> None:
        """Refuse a process with other software: it was installed since this one started."""
        theirs = self.within(_START_SECONDS, software_with_engines)
        if theirs != software():
            self._end()
            raise ClusterError("gapsweep was installed anew during the run: start it again")

    def _end(self) -> None:
        if self._child is not None:
            self._child.end()
            self._child = None


def compute_alone(task: Task) -> TaskResult:
    """Body of a Dask task: like `compute`, but nothing that a point does can harm the worker."""
    ours, found = software(), []
    with Alone(task.timeout) as alone:

        def ask(points: Points, states: States) -> Responses:
            rows = range(len(points))
            each = [response_of(alone, points.take([row]), states[row]) for row in rows]
            return Responses.concatenated(each)

        for tile in task.tiles:
            found += tile.slabs(respond_to(tile, ask), platform.node())
    return TaskResult(found, sum(slab.seconds for slab in found), ours)


def response_of(alone: Alone, points: Points, state: States) -> Responses:
    """The response of one point; what became of its process is its status."""
    tile = Tile.of_one(points, state)
    try:
        alone.within(WARM_UP_SECONDS, warm_up, tile)
        return alone(respond_to, tile)
    except CallError as lost:
        lost_one = Response(status=lost.status, message=lost.message)
        return Responses.of([lost_one], points.kind.structure)


class _Child:
    """A process that answers one call at a time."""

    def __init__(self) -> None:
        self.connection, theirs = multiprocessing.Pipe()
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-c", _CHILD, str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
            env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        theirs.close()
        self.n_calls, self.is_busy = 0, True
        began = time.monotonic()

        def is_late() -> bool:
            return time.monotonic() - began > _START_SECONDS

        # Starting up does not count against the first call.
        try:
            self._answer(is_late, _START_SECONDS)
        except BaseException:
            self.end()
            raise

    @property
    def is_spent(self) -> bool:
        """Whether it has ended, or said something that nobody asked for."""
        return self.connection.poll()

    def ask(self, function: Callable[..., Any], arguments: Any, timeout: float) -> Any:
        """What a call returns, or as a `CallError` what it raised; without either it is raised."""
        self.n_calls, self.is_busy = self.n_calls + 1, True
        try:
            self.connection.send((self.n_calls, function, arguments, timeout))
        except (BrokenPipeError, ConnectionResetError):
            raise CallError(Status.KILLED, self._end_of_process(timeout)) from None
        began, spent = time.monotonic(), self._processor_seconds()

        def is_late() -> bool:
            took, used = time.monotonic() - began, self._processor_seconds() - spent
            return used > timeout or (took > timeout and used < _IDLE * took)

        return self._answer(is_late, timeout)

    def _answer(self, is_late: Callable[[], bool], timeout: float) -> Any:
        """The answer to the latest call.

        Read piece by piece: whatever else writes into the pipe may announce more than comes.
        """
        said = b""
        while not _is_whole(said, self.n_calls):
            if self.connection.poll(min(_LOOK_SECONDS, timeout)):
                piece = self._piece()
                if not piece:
                    raise CallError(Status.KILLED, self._end_of_process(timeout))
                said += piece
            elif is_late():
                raise _too_long(timeout)
        self.is_busy = False
        try:
            return ForkingPickler.loads(said[_HEAD.size :])
        except Exception:  # user code wrote into the pipe: unpickling noise raises any type
            raise CallError(Status.KILLED, _OTHERWISE) from None

    def _piece(self) -> bytes:
        try:
            return os.read(self.connection.fileno(), _PIECE)
        except ConnectionResetError:
            return b""

    def _processor_seconds(self) -> float:
        try:
            times = psutil.Process(self.process.pid).cpu_times()
        except psutil.Error:  # it has just ended
            return 0.0
        return float(times.user + times.system)

    def _end_of_process(self, timeout: float) -> str:
        # Its end of the pipe is closed, which the process itself may outlive.
        try:
            code = self.process.wait(timeout)
        except subprocess.TimeoutExpired:
            raise _too_long(timeout) from None
        if code >= 0:
            return f"its process ended with exit code {code}"
        return f"its process was ended by {signal.Signals(-code).name}"

    def end(self) -> None:
        """End the process: it goes by itself, and cleans up, unless it is held up by a call."""
        started = _started_by(self.process.pid)
        self.connection.close()
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(0.0 if self.is_busy else _LEAVE_SECONDS)
        self.process.kill()
        self.process.wait()
        for process in started:
            with suppress(psutil.Error):  # it has ended
                process.kill()


def _started_by(pid: int) -> list[psutil.Process]:
    """What a law has started, if its process is still there to tell."""
    try:
        found: list[psutil.Process] = psutil.Process(pid).children(recursive=True)
    except psutil.Error:
        return []
    return found


def _is_whole(said: bytes, number: int) -> bool:
    """Whether all of the answer to a call has come.

    Raises
    ------
    CallError
        If it is something else.
    """
    mark, given, length = _HEAD.unpack(said[: _HEAD.size].ljust(_HEAD.size, b"\0"))
    whole: int = _HEAD.size + length
    if len(said) >= _HEAD.size and ((mark, given) != (_MARK, number) or len(said) > whole):
        raise CallError(Status.KILLED, _OTHERWISE)
    return _HEAD.size <= len(said) == whole


def _too_long(timeout: float) -> CallError:
    return CallError(Status.TIMED_OUT, f"took longer than {timeout:g} s")


def child() -> None:
    """Answer until nobody asks any more."""
    # A terminal sends Ctrl-C to all processes; the client alone decides how a run ends.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _end_with(os.getppid())
    connection = Connection(int(sys.argv[1]))
    _say(connection, 0, None)
    while True:
        try:
            number, function, arguments, timeout = connection.recv()
        except EOFError:
            return
        # Should the client have died, nobody else ends a call that hangs where there is no Linux.
        faulthandler.dump_traceback_later(timeout / _IDLE, exit=True)
        _say(connection, number, _answer(function, arguments))
        faulthandler.cancel_dump_traceback_later()


def _end_with(parent: int) -> None:
    """Let Linux end this process with its parent, who may be killed while a call hangs."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it has gone meanwhile
            os.kill(os.getpid(), signal.SIGKILL)


def _say(connection: Connection, number: int, answer: Any) -> None:
    try:
        said = bytes(ForkingPickler.dumps(answer))
    except Exception as error:  # pickling runs methods of the user's objects: any type, told
        said = bytes(ForkingPickler.dumps(CallError(*failure(error))))
    with open(connection.fileno(), "wb", closefd=False) as pipe:
        pipe.write(_HEAD.pack(_MARK, number, len(said)) + said)


def _answer(function: Callable[..., Any], arguments: Any) -> Any:
    try:
        return function(*arguments)
    except ClusterError as error:  # of the process itself, so of none of its points
        return error
    except BaseException as error:  # a law may raise SystemExit, or what is no Exception at all
        return CallError(*failure(error))
