"""What a worker runs: sweep points in, responses out.

A sweep point is the unit of work, of failure and of caching; a task carries several of
them only because a task has a price of its own.
"""

import faulthandler
import math
import os
import platform
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from gapsweep.errors import ModelError, described
from gapsweep.integrate.problem import Solver
from gapsweep.response.ensemble import Ensemble, Scene, State
from gapsweep.response.respond import Question, respond_all
from gapsweep.response.result import Response
from gapsweep.status import Status
from gapsweep.study.points import FIXED, Point
from gapsweep.study.software import software

REST: State = (0.0, 0.0)
_RESTARTED = "the point before it failed: starts from the last settled one"

# What points share that are computed in one call: representation, code of a user's law, range of
# fits, solver. One that was computed before has its machine code.
_Kind = tuple[str, str, float, Solver]
_warm: set[_Kind] = set()

# Points that follow each other, and the state that the first one starts from.
Work = tuple[Sequence[Point], State]


@dataclass(frozen=True, slots=True)
class Task:
    """What a worker is sent; one object, because Dask would search lists for futures.

    Attributes
    ----------
    work : list of (points, state)
    timeout : float
        Time [s] after which the worker process gives up, and with it all that it held; of
        points that are computed alone, the time for each.
    client : (str, int)
        The client's `process`, which must not end that way.
    """

    work: list[Work]
    timeout: float
    client: tuple[str, int]


@dataclass(frozen=True, slots=True)
class TaskResult:
    """Responses in the order of the points, and where and by what `software` they were computed."""

    responses: list[Response]
    host: str
    software: Mapping[str, str]


def compute(task: Task) -> TaskResult:
    """Body of a Dask task."""
    ours = software()  # of what runs now: it may be edited meanwhile
    with _ending_after(task.timeout if task.client != process() else math.inf):
        return TaskResult(responses(task.work), platform.node(), ours)


def process() -> tuple[str, int]:
    """What tells this process from all others."""
    return platform.node(), os.getpid()


_deadlines: dict[int, float] = {}
_watch = threading.Lock()


@contextmanager
def _ending_after(timeout: float) -> Iterator[None]:
    """End this process if the block takes longer [s].

    A computation that hangs in compiled code holds the interpreter: no Python code could stop
    it. `faulthandler` watches from a thread that needs no interpreter, one deadline at a time.
    """
    if timeout == math.inf:
        yield
        return
    thread = threading.get_ident()
    _rearm(thread, time.monotonic() + timeout)
    try:
        yield
    finally:
        _rearm(thread, None)


def _rearm(thread: int, deadline: float | None) -> None:
    with _watch:
        _deadlines.pop(thread, None)
        if deadline is not None:
            _deadlines[thread] = deadline
        faulthandler.cancel_dump_traceback_later()
        if _deadlines:
            left = max(min(_deadlines.values()) - time.monotonic(), 0.001)
            faulthandler.dump_traceback_later(left, exit=True, file=_nowhere())


@lru_cache(maxsize=1)
def _nowhere() -> int:
    # What hung is found out later, point by point; a traceback on the terminal helps nobody.
    return os.open(os.devnull, os.O_WRONLY)


def responses(work: Sequence[Work]) -> list[Response]:
    """Steady responses of chains of points; a failure is a response with its status.

    The first points of all chains advance together, then the second ones, and so on.

    Parameters
    ----------
    work : sequence of (points, state)
        `state`, displacement [m] and velocity [m/s], is where the first point starts if its
        start is a sweep. Later ones go on from where the point before ended, if it did.

    Returns
    -------
    list of Response
        Chain by chain.
    """
    states = [state for _, state in work]
    found: list[list[Response]] = [[] for _ in work]
    for position in range(max((len(points) for points, _ in work), default=0)):
        here = [i for i, (points, _) in enumerate(work) if position < len(points)]
        together = [(work[i][0][position], states[i]) for i in here]
        for i, response in zip(here, _together(together), strict=True):
            found[i].append(continued(response, found[i][-1] if found[i] else None))
            states[i] = state_after(response, states[i])
    return [response for chain in found for response in chain]


def continued(response: Response, previous: Response | None) -> Response:
    """A response of a sweep, with a word on the one before it if that failed."""
    if previous is None or not previous.status.failed:
        return response
    return replace(response, message=response.message or _RESTARTED)


def state_after(response: Response, state: State) -> State:
    """Where the next point of a sweep starts: where this one ended, if it did, else as this."""
    return (response.x_end, response.v_end) if response.ended else state


def _together(points: Sequence[tuple[Point, State]]) -> list[Response]:
    """Responses of independent points, those with one solver and law family in one call."""
    answers: dict[int, Response] = {}
    groups: dict[_Kind, dict[int, Question]] = {}
    for i, (point, state) in enumerate(points):
        try:
            question = _question(point, state)
        except ModelError as error:
            status, message = failure(error)
            answers[i] = Response(status=status, message=message)
        else:
            kind = point.representation, point.law_code, point.fit_range, point.solver
            groups.setdefault(kind, {})[i] = question
    for kind, group in groups.items():
        answers |= zip(group, _answered(kind, list(group.values())), strict=True)
    return [answers[i] for i in range(len(points))]


def _warm_up(kind: _Kind, question: Question) -> None:
    """Load or compile what a kind of point needs: no point's processor time may hold that.

    With a point of that kind, from where it starts: what this raises, the point raises as well.
    """
    if kind in _warm or question.scene.solver.engine != "compiled":
        return
    ensemble, start = Ensemble([question.scene]), np.reshape(question.start, (2, 1))
    for tangent in (False, True):
        ensemble.call(np.arange(1), start, np.ones(1, int), np.zeros(1), tangent=tangent)
    _warm.add(kind)


def _question(point: Point, state: State) -> Question:
    if point.start.kind == FIXED:
        state = point.start.x_0 + point.start_jitter, point.start.v_0
    scene = Scene(
        oscillator=point.oscillator, law=point.law, omega=point.omega, solver=point.solver
    )
    return Question(scene=scene, start=state, steady=point.steady)


def _answered(kind: _Kind, questions: Sequence[Question]) -> list[Response]:
    """Responses; what a point raises is its own response, the others are asked again alone."""
    try:
        _warm_up(kind, questions[0])
        return respond_all(questions).rows()
    except BaseException as error:  # the task boundary: SystemExit, too, is a point's own result
        if len(questions) > 1:
            return [response for question in questions for response in _answered(kind, [question])]
        status, message = failure(error)
        return [Response(status=status, message=message)]


def failure(error: BaseException) -> tuple[Status, str]:
    """Status and message of a point or motion that raised."""
    if isinstance(error, ModelError):
        return Status.MODEL_INVALID, str(error)
    return Status.ERROR, described(error)
