"""A motion that a sweep point advances by whole forcing periods.

A point does not integrate: it is a generator that asks for a `Stretch` of motion and is sent
the `Part` that answers it. So many points can advance together in the engine's lanes, and none
of them sees the others.
"""

import math
import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.motion import Events
from gapsweep.integrate.problem import Problems, Solver
from gapsweep.integrate.simulate import integrate
from gapsweep.model.contact import ContactLaw
from gapsweep.model.oscillator import Oscillator
from gapsweep.response.section import scaled
from gapsweep.status import Status

Array = NDArray[np.float64]
State = tuple[float, float]

COSTS = ("n_contacts", "n_steps", "n_rejected", "nfev")
# What the solver's tolerances admit per step, times this, is taken for noise.
_NOISE_FACTOR = 20.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """What moves: the model, its forcing frequency [Hz] and the solver."""

    oscillator: Oscillator
    law: ContactLaw
    omega: float
    solver: Solver


@dataclass(frozen=True, slots=True)
class Stretch:
    """Whole forcing periods that a point asks for, from phase zero, so that time never grows."""

    scene: Scene
    y: State
    n_periods: int
    recorded: bool = False
    tangent: bool = False


@dataclass(frozen=True, slots=True)
class Part:
    """The stretch of motion that answers a `Stretch`."""

    y: State
    status: Status
    cost: tuple[int, ...]
    cpu_time: float
    events: Events
    monodromy: Array | None


def integrated(stretches: Sequence[Stretch]) -> list[Part]:
    """Answer stretches of one solver: one call with the tangent, one without."""
    answers: dict[int, Part] = {}
    for tangent in (False, True):
        some = [i for i, stretch in enumerate(stretches) if stretch.tangent == tangent]
        if some:
            answers |= zip(some, _solved([stretches[i] for i in some], tangent), strict=True)
    return [answers[i] for i in range(len(stretches))]


def _solved(stretches: Sequence[Stretch], tangent: bool) -> list[Part]:
    omega = np.array([s.scene.omega for s in stretches])
    problems = Problems(
        oscillators=[s.scene.oscillator for s in stretches],
        laws=[s.scene.law for s in stretches],
        omega=omega,
        x_0=np.array([s.y[0] for s in stretches]),
        v_0=np.array([s.y[1] for s in stretches]),
        t_0=np.zeros(len(stretches)),
        t_end=np.array([s.n_periods for s in stretches]) / omega,
        record_from=np.array([0.0 if s.recorded else math.inf for s in stretches]),
        tangent=tangent,
    )
    begin = time.thread_time()
    found = integrate(problems, stretches[0].scene.solver)
    # What ran together shares the processor time in proportion to its steps.
    seconds = (time.thread_time() - begin) * found.n_steps / max(found.n_steps.sum(), 1)
    # A fit that was left on the way but did not run away goes on; where its steady response
    # lies decides in the end.
    arrived = found.t >= problems.t_end * (1.0 - 1e-9)
    excused = arrived & (found.status == Status.OUT_OF_FIT_RANGE)
    costs = np.transpose([getattr(found, name) for name in COSTS]).tolist()
    return [
        Part(
            y=(float(found.x[i]), float(found.v[i])),
            status=Status.OK if excused[i] else Status(found.status[i]),
            cost=tuple(costs[i]),
            cpu_time=float(seconds[i]),
            events=found.events(i) if stretch.recorded else Events(),
            monodromy=None if found.monodromy is None else found.monodromy[i],
        )
        for i, stretch in enumerate(stretches)
    ]


class Walk:
    """Where a motion is, what it has cost, and the window recorded last."""

    def __init__(self, scene: Scene, y: State) -> None:
        self.scene = scene
        self.omega = scene.omega
        self.y = y
        self.status = Status.OK
        self.n_periods = 0
        self.n_simulated = 0
        self.cost: dict[str, Any] = {**dict.fromkeys(COSTS, 0), "cpu_time": 0.0}
        self.section: Array
        self.t_extrema: Array
        self.extrema: Array
        self.forget()

    @property
    def t(self) -> float:
        """Time since the start [s]."""
        return self.n_periods / self.omega

    @property
    def t_simulated(self) -> float:
        """Simulated time in all [s], side trips of the shooting included."""
        return self.n_simulated / self.omega

    @property
    def reach(self) -> float:
        """Largest displacement of the window [m]."""
        return float(np.max(np.abs(self.extrema), initial=abs(self.y[0])))

    @property
    def noise(self) -> float:
        """Distance [m] below which two states are the same to this solver."""
        solver = self.scene.solver
        return _NOISE_FACTOR * (solver.atol + solver.rtol * self.reach)

    def forget(self) -> None:
        """Start an empty window here."""
        self.section = np.empty((0, 2))
        self.t_extrema = self.extrema = np.empty(0)

    def advance(self, n_periods: int, *, record: bool) -> Generator[Stretch, Part, None]:
        """Go on for whole periods; recorded ones are added to the window."""
        part = yield Stretch(self.scene, self.y, n_periods, recorded=record)
        self._pay(part, n_periods)
        self.y, self.status = part.y, part.status
        self.t_extrema = np.append(self.t_extrema, self.t + part.events.t_extrema)
        self.extrema = np.append(self.extrema, part.events.extrema)
        self.section = np.append(self.section, scaled(part.events.section, self.omega), axis=0)
        self.n_periods += n_periods

    def probe(
        self, y: State, n_periods: int, *, record: bool = False, tangent: bool = True
    ) -> Generator[Stretch, Part, Part]:
        """A side trip from any state; the motion itself stays where it is."""
        part = yield Stretch(self.scene, y, n_periods, recorded=record, tangent=tangent)
        self._pay(part, n_periods)
        return part

    def _pay(self, part: Part, n_periods: int) -> None:
        self.n_simulated += n_periods
        for name, cost in zip(COSTS, part.cost, strict=True):
            self.cost[name] += cost
        self.cost["cpu_time"] += part.cpu_time
