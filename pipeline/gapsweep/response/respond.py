"""The steady response of one sweep point.

The motion runs until transients have decayed, which the damping decides: a disturbance
shrinks like ``exp(-ζ ω_n t)``, so ``ln(1/settle_tol) / (ζ ω_n)`` seconds bring it down to
`settle_tol` of itself. Then forcing periods are recorded, 8 at first and up to `n_periods`,
until the stroboscopic section repeats. If it never does, the next window is tried until
`t_max`; what has found no period by then is `unresolved`.
"""

import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import ModelError
from gapsweep.integrate.motion import Events
from gapsweep.integrate.problem import DEFAULT_ENGINE, Problems, Solver
from gapsweep.integrate.simulate import integrate
from gapsweep.model.contact import ContactLaw
from gapsweep.model.oscillator import Oscillator, checked
from gapsweep.response.section import period_multiple
from gapsweep.status import Status

Array = NDArray[np.float64]

_COSTS = ("n_contacts", "n_steps", "n_rejected", "nfev")
_FIRST_WINDOW = 8
# Two section points closer than this share of the amplitude are taken for one...
_SAME_POINT = 1e-4
# ... or closer than this multiple of what the solver's tolerances admit per step.
_NOISE_FACTOR = 20.0


class ResponseClass(IntEnum):
    """What kind of motion the steady response is; the order is part of the schema."""

    PERIODIC = 0
    CHAOTIC = 1
    UNRESOLVED = 2
    FAILED = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Steady:
    """When a response counts as steady, and how much of it is recorded.

    Parameters
    ----------
    settle_tol : float
        Share [-] of a disturbance that may be left when recording starts, in (0, 0.1].
    t_max : float
        Simulated time [s] after which no further window is tried, ``> 0``.
    n_periods : int
        Forcing periods in a full recording window, at least twice `max_period_multiple`.
    max_period_multiple : int
        Largest period multiple looked for, 1 to 256.
    max_extrema : int
        Extrema kept per point, 1 to 65536.
    """

    settle_tol: float = 1e-6
    t_max: float = 60.0
    n_periods: int = 64
    max_period_multiple: int = 32
    max_extrema: int = 256

    def __post_init__(self) -> None:
        if checked("settle_tol", self.settle_tol, low=0.0, strict=True) > 0.1:
            raise ModelError(f"settle_tol = {self.settle_tol:g}: must be <= 0.1")
        checked("t_max", self.t_max, low=0.0, strict=True)
        for name, largest in (("max_period_multiple", 256), ("max_extrema", 65536)):
            if not 1 <= getattr(self, name) <= largest:
                raise ModelError(f"{name} = {getattr(self, name)}: must be in 1..{largest}")
        if not 2 * self.max_period_multiple <= self.n_periods <= 10**6:
            raise ModelError(
                f"n_periods = {self.n_periods}: must be >= 2 max_period_multiple "
                f"({2 * self.max_period_multiple}) and <= 1000000"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """Steady response of one sweep point; an attribute for every dataset variable.

    Attributes
    ----------
    status : Status
    response_class : ResponseClass
    period_multiple : int
        n of a period-n response, 0 if none was found.
    extrema : tuple of float
        Steady zero-velocity displacements [m] in order of time: over n periods if periodic,
        else over the last window; at most `max_extrema`.
    n_extrema : int
        Their true count.
    x_max, x_min, amplitude : float
        Peak, trough and half their difference [m]; NaN if the point failed.
    n_contacts, n_steps, n_rejected, nfev : int
        Cost of the whole point, settling included.
    t_settled : float
        Simulated time [s] before the recorded window.
    x_end, v_end : float
        Last section point [m], [m/s]: where a sweep's next point starts.
    cpu_time : float
        Processor time of the integration [s].
    message : str
        Why the point failed, empty otherwise.
    """

    status: Status
    response_class: ResponseClass = ResponseClass.FAILED
    period_multiple: int = 0
    extrema: tuple[float, ...] = ()
    n_extrema: int = 0
    x_max: float = math.nan
    x_min: float = math.nan
    amplitude: float = math.nan
    n_contacts: int = 0
    n_steps: int = 0
    n_rejected: int = 0
    nfev: int = 0
    t_settled: float = math.nan
    x_end: float = math.nan
    v_end: float = math.nan
    cpu_time: float = math.nan
    message: str = ""


def respond(
    oscillator: Oscillator,
    law: ContactLaw,
    omega: float,
    x_0: float = 0.0,
    v_0: float = 0.0,
    *,
    engine: str = DEFAULT_ENGINE,
    rtol: float | None = None,
    atol: float | None = None,
    steady: Steady | None = None,
) -> Response:
    """Find the steady response from one initial state.

    Parameters
    ----------
    oscillator : Oscillator
    law : ContactLaw
    omega : float
        Forcing frequency [Hz], ``> 0``.
    x_0, v_0 : float
        Initial displacement [m] and velocity [m/s], at forcing phase zero.
    engine, rtol, atol
        As in `gapsweep.simulate`.
    steady : Steady, optional
        When the response counts as steady.

    Raises
    ------
    ModelError
        If an argument is out of range. A numerical failure is no error but a `status`.
    """
    question = Question(
        oscillator=oscillator,
        law=law,
        omega=checked("omega", omega, low=0.0, strict=True),
        x_0=checked("x_0", x_0),
        v_0=checked("v_0", v_0),
        solver=Solver.of(engine, rtol, atol),
        steady=steady or Steady(),
    )
    return respond_all([question])[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """What a steady response is asked for: the checked arguments of `respond`."""

    oscillator: Oscillator
    law: ContactLaw
    omega: float
    x_0: float
    v_0: float
    solver: Solver
    steady: Steady


@dataclass(frozen=True, slots=True)
class Stretch:
    """Whole forcing periods that a point asks for, from phase zero, so that time never grows."""

    question: Question
    y: tuple[float, float]
    n_periods: int
    recorded: bool


@dataclass(frozen=True, slots=True)
class Part:
    """The stretch of motion that answers a `Stretch`."""

    y: tuple[float, float]
    status: Status
    cost: tuple[int, ...]
    events: Events


Walk = Generator[Stretch, Part, None]


def respond_all(questions: Sequence[Question]) -> list[Response]:
    """Steady responses of many points with one solver, advanced together.

    Each point is a generator that asks for stretches of motion; every round, the stretches
    asked for by all points go to the engine in one call. No point sees the others.
    """
    walks = [_steady_response(_Run(question), question.steady) for question in questions]
    answers: dict[int, Response] = {}
    asked = {i: next(walk) for i, walk in enumerate(walks)}
    while asked:
        parts = _integrated(list(asked.values()))
        asked_next = {}
        for i, part in zip(asked, parts, strict=True):
            try:
                asked_next[i] = walks[i].send(part)
            except StopIteration as finished:
                answers[i] = finished.value
        asked = asked_next
    return [answers[i] for i in range(len(questions))]


def _integrated(stretches: Sequence[Stretch]) -> list[Part]:
    omega = np.array([s.question.omega for s in stretches])
    problems = Problems(
        oscillators=[s.question.oscillator for s in stretches],
        laws=[s.question.law for s in stretches],
        omega=omega,
        x_0=np.array([s.y[0] for s in stretches]),
        v_0=np.array([s.y[1] for s in stretches]),
        t_0=np.zeros(len(stretches)),
        t_end=np.array([s.n_periods for s in stretches]) / omega,
        record_from=np.array([0.0 if s.recorded else math.inf for s in stretches]),
    )
    found = integrate(problems, stretches[0].question.solver)
    costs = np.transpose([getattr(found, name) for name in _COSTS]).tolist()
    return [
        Part(
            y=(float(found.x[i]), float(found.v[i])),
            status=Status(found.status[i]),
            cost=tuple(costs[i]),
            events=found.events(i) if stretch.recorded else Events(),
        )
        for i, stretch in enumerate(stretches)
    ]


class _Run:
    """A motion advanced by whole forcing periods, its cost and its current window."""

    def __init__(self, question: Question) -> None:
        self.question = question
        self.omega = question.omega
        self.y = question.x_0, question.v_0
        self.status = Status.OK
        self.n_periods = 0
        self.cost: dict[str, Any] = dict.fromkeys(_COSTS, 0)
        self.section: Array
        self.t_extrema: Array
        self.extrema: Array
        self.forget()

    @property
    def t(self) -> float:
        return self.n_periods / self.omega

    def advance(self, n_periods: int, *, record: bool) -> Walk:
        """Go on for whole periods."""
        part = yield Stretch(self.question, self.y, n_periods, record)
        self.y, self.status = part.y, part.status
        for name, cost in zip(_COSTS, part.cost, strict=True):
            self.cost[name] += cost
        self.t_extrema = np.append(self.t_extrema, self.t + part.events.t_extrema)
        self.extrema = np.append(self.extrema, part.events.extrema)
        self.section = np.append(self.section, part.events.section, axis=0)
        self.n_periods += n_periods

    def forget(self) -> None:
        """Start an empty window here."""
        self.section = np.empty((0, 2))
        self.t_extrema = self.extrema = np.empty(0)

    def period_multiple(self, largest: int) -> int:
        scaled = self.section / (1.0, 2.0 * math.pi * self.omega)
        reach = float(np.max(np.abs(self.extrema), initial=0.0))
        solver = self.question.solver
        noise = _NOISE_FACTOR * (solver.atol + solver.rtol * reach)
        return period_multiple(scaled, max(noise, _SAME_POINT * reach), largest)


def _steady_response(run: _Run, steady: Steady) -> Generator[Stretch, Part, Response]:
    rate = run.question.oscillator.decay_rate
    needed = math.log(1.0 / steady.settle_tol) / rate if rate > 0.0 else math.inf
    yield from run.advance(math.ceil(min(needed, steady.t_max) * run.omega), record=False)
    n, t_settled = 0, 0.0
    while run.status is Status.OK and not n:
        run.forget()
        t_settled = run.t
        n = yield from _record_window(run, steady)
        if run.t >= steady.t_max:
            break
    if run.status is not Status.OK:
        return _failure(run)
    # A window that repeats before the transient had time to decay proves nothing.
    resolved = n > 0 and needed <= steady.t_max
    return _result(run, steady, n, t_settled, resolved)


def _record_window(run: _Run, steady: Steady) -> Generator[Stretch, Part, int]:
    """Record periods, doubling their number, until the section repeats; its multiple or 0."""
    size = _FIRST_WINDOW
    while len(run.section) < steady.n_periods and run.status is Status.OK:
        wanted = min(size, steady.n_periods) - len(run.section)
        yield from run.advance(wanted, record=True)
        n = run.period_multiple(steady.max_period_multiple)
        if n:
            return n
        size *= 2
    return 0


def _result(run: _Run, steady: Steady, n: int, t_settled: float, resolved: bool) -> Response:
    last = run.t_extrema > run.t - n / run.omega if n else slice(None)
    extrema = run.extrema[last]
    # A response without a turning point in its window still has a position.
    x_max, x_min = (float(f(extrema, initial=run.y[0])) for f in (np.max, np.min))
    if extrema.size:
        x_max, x_min = float(np.max(extrema)), float(np.min(extrema))
    left_range = max(abs(x_max), abs(x_min)) > run.question.law.valid_range
    status = Status.OK if resolved else Status.UNRESOLVED
    return Response(
        status=Status.OUT_OF_FIT_RANGE if left_range else status,
        response_class=ResponseClass.PERIODIC if resolved else ResponseClass.UNRESOLVED,
        period_multiple=n,
        extrema=tuple(extrema[: steady.max_extrema].tolist()),
        n_extrema=extrema.size,
        x_max=x_max,
        x_min=x_min,
        amplitude=0.5 * (x_max - x_min),
        t_settled=t_settled,
        x_end=run.y[0],
        v_end=run.y[1],
        **run.cost,
    )


def _failure(run: _Run) -> Response:
    left_range = not abs(run.y[0]) <= run.question.law.valid_range
    status = Status.OUT_OF_FIT_RANGE if left_range else run.status
    where = f"{run.status.label} before t = {run.t:.6g} s at x = {run.y[0]:.3g} m"
    return Response(status=status, message=where, **run.cost)
