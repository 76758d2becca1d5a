"""What a worker runs: sweep points in, responses out.

A sweep point is the unit of work, of failure and of caching; a task carries several of
them only because a task has a price of its own.
"""

import math
import platform
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from gapsweep.errors import ModelError
from gapsweep.integrate.problem import Solver
from gapsweep.model.labels import contact_law
from gapsweep.model.oscillator import Gap, Oscillator
from gapsweep.response.respond import Question, Response, respond_all
from gapsweep.response.walk import Ensemble, Scene, State
from gapsweep.status import Status
from gapsweep.study.fingerprint import numerics_fingerprint
from gapsweep.study.points import FIXED, Point

REST: State = (0.0, 0.0)
_RESTARTED = "the point before it failed: starts from the last settled one"


@dataclass(frozen=True, slots=True)
class TaskResult:
    """Responses in the order of the points, and what computed them."""

    responses: list[Response]
    host: str
    fingerprint: str


def compute(chains: Sequence[tuple[Sequence[Point], State]]) -> TaskResult:
    """Body of a Dask task: chains of points, each with the state its first point starts from."""
    return TaskResult(responses(chains), platform.node(), numerics_fingerprint())


def responses(chains: Sequence[tuple[Sequence[Point], State]]) -> list[Response]:
    """Steady responses of chains of points; a failure is a response with its status.

    The first points of all chains advance together, then the second ones, and so on.

    Parameters
    ----------
    chains : sequence of (points, state)
        `state`, displacement [m] and velocity [m/s], is where the first point starts if its
        start is a sweep. Later ones go on from where the point before ended, if it did.

    Returns
    -------
    list of Response
        Chain by chain.
    """
    states = [state for _, state in chains]
    found: list[list[Response]] = [[] for _ in chains]
    for position in range(max((len(points) for points, _ in chains), default=0)):
        here = [i for i, (points, _) in enumerate(chains) if position < len(points)]
        together = [(chains[i][0][position], states[i]) for i in here]
        for i, response in zip(here, _together(together), strict=True):
            if found[i] and found[i][-1].status.failed:
                response = replace(response, message=response.message or _RESTARTED)
            found[i].append(response)
            if math.isfinite(response.x_end) and math.isfinite(response.v_end):
                states[i] = response.x_end, response.v_end
    return [response for chain in found for response in chain]


def _together(points: Sequence[tuple[Point, State]]) -> list[Response]:
    """Responses of independent points, those with one solver and law family in one call."""
    answers: dict[int, Response] = {}
    groups: dict[tuple[str, float, Solver], dict[int, Question]] = {}
    for i, (point, state) in enumerate(points):
        try:
            question = _question(point, state)
        except ModelError as error:
            answers[i] = Response(status=Status.MODEL_INVALID, message=str(error))
        else:
            kind = point.representation, point.fit_range, point.solver
            groups.setdefault(kind, {})[i] = question
    for kind, group in groups.items():
        _warm_up(*kind)
        answers |= zip(group, _answered(list(group.values())), strict=True)
    return [answers[i] for i in range(len(points))]


@lru_cache(maxsize=256)
def _warm_up(representation: str, fit_range: float, solver: Solver) -> None:
    """Load or compile what a kind of point needs: no point's processor time may hold that."""
    if solver.engine != "compiled":
        return
    # Whatever is wrong here is wrong with the points themselves, and said there.
    with suppress(Exception):
        law = contact_law(representation, 1.0, Gap(1e-4, 1e-4), fit_range)
        scene = Scene(oscillator=Oscillator(), law=law, omega=5.0, solver=solver)
        ensemble = Ensemble([scene])
        rest, one = np.zeros((2, 1)), np.ones(1, int)
        for tangent in (False, True):
            ensemble.call(np.arange(1), rest, one, np.zeros(1), tangent=tangent)


def _question(point: Point, state: State) -> Question:
    if point.start.kind == FIXED:
        state = point.start.x_0 + point.start_jitter, point.start.v_0
    scene = Scene(
        oscillator=point.oscillator, law=point.law, omega=point.omega, solver=point.solver
    )
    return Question(scene=scene, start=state, steady=point.steady)


def _answered(questions: Sequence[Question]) -> list[Response]:
    """Responses; what a point raises is its own response, the others are asked again alone."""
    try:
        return respond_all(questions)
    except Exception as error:  # the task boundary: whatever a point raises is its result
        if len(questions) > 1:
            return [response for question in questions for response in _answered([question])]
        invalid = isinstance(error, ModelError)
        message = str(error) if invalid else f"{type(error).__name__}: {error}"
        return [Response(status=Status.MODEL_INVALID if invalid else Status.ERROR, message=message)]
