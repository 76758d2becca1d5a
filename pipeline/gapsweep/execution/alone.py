"""Suspects: points whose worker died or took too long, computed one by one in a child process.

When a worker is lost, nobody can tell which of its points was to blame, if any. Here every
point has the child process for itself and a time limit: what kills or hangs it is known, and
all others are computed. Runs on a worker, as the body of a task.
"""

import multiprocessing
import os
import platform
import signal
import subprocess
import sys
from contextlib import suppress
from multiprocessing.connection import Connection

from gapsweep.errors import GapsweepError
from gapsweep.execution.task import Task, TaskResult, Work, continued, responses, state_after
from gapsweep.response.result import Response
from gapsweep.status import Status
from gapsweep.study.software import software

_START_SECONDS = 120.0
_CHILD = "from gapsweep.execution.alone import child; child()"


def compute_alone(task: Task) -> TaskResult:
    """Body of a Dask task: like `compute`, but nothing that a point does can harm the worker."""
    ours = software()
    found: list[Response] = []
    child: _Child | None = None
    try:
        for points, state in task.work:
            previous: Response | None = None
            for point in points:
                child = child or _Child()
                response = child.ask(([point], state), task.timeout)
                if response.status in (Status.KILLED, Status.TIMED_OUT):
                    child.end()
                    child = None
                previous = continued(response, previous)
                found.append(previous)
                state = state_after(response, state)
    finally:
        if child is not None:
            child.end()
    return TaskResult(found, platform.node(), ours)


class _Child:
    """A process that answers one point at a time."""

    def __init__(self) -> None:
        self.connection, theirs = multiprocessing.Pipe()
        self.process = subprocess.Popen(
            [sys.executable, "-c", _CHILD, str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
            env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        theirs.close()
        # Starting up does not count against the first point.
        with suppress(EOFError):
            if self.connection.poll(_START_SECONDS):
                self.connection.recv()

    def ask(self, work: Work, timeout: float) -> Response:
        """The response of a point, or what became of the process."""
        try:
            self.connection.send(work)
            if not self.connection.poll(timeout):
                message = f"took longer than {timeout:g} s"
                return Response(status=Status.TIMED_OUT, message=message)
            answer: Response | GapsweepError = self.connection.recv()
        except (EOFError, BrokenPipeError, ConnectionResetError):
            return Response(status=Status.KILLED, message=self._end_of_process())
        if isinstance(answer, GapsweepError):  # of the process itself, so of none of its points
            raise answer
        return answer

    def _end_of_process(self) -> str:
        code = self.process.wait()
        if code >= 0:
            return f"its process ended with exit code {code}"
        return f"its process was ended by {signal.Signals(-code).name}"

    def end(self) -> None:
        self.connection.close()
        self.process.kill()
        self.process.wait()


def child() -> None:
    """Answer until nobody asks any more."""
    connection = Connection(int(sys.argv[1]))
    connection.send("ready")
    while True:
        try:
            work: Work = connection.recv()
        except EOFError:
            return
        try:
            connection.send(responses([work])[0])
        except GapsweepError as error:
            connection.send(error)
