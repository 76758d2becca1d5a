"""What a worker runs: sweep points in, responses out.

A sweep point is the unit of work, of failure and of caching; a task carries several of
them only because a task has a price of its own.
"""

import math
import platform
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from gapsweep.errors import ModelError
from gapsweep.response.respond import Response, respond
from gapsweep.status import Status
from gapsweep.study.fingerprint import numerics_fingerprint
from gapsweep.study.points import FIXED, Point

State = tuple[float, float]
REST: State = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class TaskResult:
    """Responses in the order of the points, and what computed them."""

    responses: list[Response]
    host: str
    fingerprint: str


def compute(chains: Sequence[tuple[Sequence[Point], State]]) -> TaskResult:
    """Body of a Dask task: chains of points, each with the state its first point starts from."""
    results = [response for points, state in chains for response in responses(points, state)]
    return TaskResult(results, platform.node(), numerics_fingerprint())


def responses(points: Sequence[Point], state: State = REST) -> list[Response]:
    """Steady responses of a chain of points; a failure is a response with its status.

    Parameters
    ----------
    points : sequence of Point
    state : (float, float)
        Displacement [m] and velocity [m/s] from which the first point starts if its start
        is a sweep. Later ones go on from where the point before ended, if it did.
    """
    found = []
    for point in points:
        response = _response(point, state)
        if math.isfinite(response.x_end) and math.isfinite(response.v_end):
            state = response.x_end, response.v_end
        found.append(response)
    return found


def _response(point: Point, state: State) -> Response:
    solver = point.solver
    if point.start.kind == FIXED:
        state = point.start.x_0 + solver.start_jitter, point.start.v_0
    begin = time.thread_time()
    try:
        law = point.law
        begin = time.thread_time()
        response = respond(
            point.oscillator,
            law,
            point.omega,
            *state,
            engine=solver.engine,
            rtol=solver.rtol,
            atol=solver.atol,
            steady=point.steady,
        )
    except ModelError as error:
        response = Response(status=Status.MODEL_INVALID, message=str(error))
    except Exception as error:  # the task boundary: whatever a point raises is its result
        response = Response(status=Status.ERROR, message=f"{type(error).__name__}: {error}")
    return replace(response, cpu_time=time.thread_time() - begin)
