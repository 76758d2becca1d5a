"""A motion that a sweep point advances by whole forcing periods.

A point does not integrate: it is a generator that asks for a `Stretch` of motion and is sent
the `Part` that answers it. So many points can advance together in the engine's lanes, and none
of them sees the others. What is arithmetic on arrays is done for all of them here; a part gives
plain numbers, because for the few that one point asks for, numpy costs more than the motion.
"""

import math
import time
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import repeat
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.motion import Events, Motions
from gapsweep.integrate.problem import Models, Problems, Solver
from gapsweep.integrate.simulate import prepared
from gapsweep.model.contact import ContactLaw
from gapsweep.model.oscillator import Oscillator
from gapsweep.response.maps import floquet_multipliers, newton_steps
from gapsweep.response.section import scaled
from gapsweep.status import Status

Array = NDArray[np.float64]
State = tuple[float, float]

_COUNTS = ("n_contacts", "n_steps", "n_rejected", "nfev")
# What the solver's tolerances admit per step, times this, is taken for noise.
_NOISE_FACTOR = 20.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """What moves: the model, its forcing frequency [Hz] and the solver."""

    oscillator: Oscillator
    law: ContactLaw
    omega: float
    solver: Solver


class Stretch(NamedTuple):
    """Whole forcing periods that a point asks for, from phase zero, so that time never grows."""

    y: State
    n_periods: int
    recorded: bool = False
    tangent: bool = False


class Part(NamedTuple):
    """The stretch of motion that answers a `Stretch`: one of those in a call of the engine.

    Events are there if they were asked for, `monodromy` and what follows from it with the tangent.

    Attributes
    ----------
    y : (float, float)
        Its end [m], [m/s].
    status : Status
    call : Call
        What the call found.
    number : int
        Which of the call's stretches this one is.
    """

    y: State
    status: Status
    call: "Call"
    number: int

    @property
    def extrema(self) -> list[float]:
        """Displacements [m] of its zero-velocity points."""
        return self.call.records.extrema[self.call.records.turns(self.number)]

    @property
    def t_extrema(self) -> list[float]:
        """Times [s] of `extrema` since its start."""
        return self.call.records.t_extrema[self.call.records.turns(self.number)]

    @property
    def reach(self) -> float:
        """Largest modulus of `extrema` [m], 0 if there are none."""
        return self.call.records.reach[self.number]

    @property
    def states(self) -> list[float]:
        """``x, v, x, v, ...`` at the end of every forcing period [m], [m/s]."""
        periods = self.call.records.periods(self.number)
        return self.call.records.states[2 * periods.start : 2 * periods.stop]

    @property
    def section(self) -> list[complex]:
        """The same as section points [m]."""
        return self.call.records.section[self.call.records.periods(self.number)]

    @property
    def monodromy(self) -> Array:
        """Derivative of the end by the start, shape (2, 2)."""
        return np.asarray(self.call.monodromy[self.number])

    @property
    def newton_step(self) -> State:
        """Step from the start [m], [m/s] towards a fixed point of the map over the stretch."""
        x, v = self.call.newton_steps
        return x[self.number], v[self.number]

    @property
    def multipliers(self) -> tuple[complex, complex]:
        """Floquet multipliers of the stretch, largest modulus first."""
        first, second = self.call.multipliers
        return first[self.number], second[self.number]


class Call:
    """What one call of the engine found for all its stretches; worked out when first asked for."""

    def __init__(self, found: Motions, start: Array, omega: Array) -> None:
        self._found, self._start, self._omega = found, start, omega

    @cached_property
    def records(self) -> "Records":
        return Records(self._found.events(), self._omega)

    @property
    def monodromy(self) -> Array:
        assert self._found.monodromy is not None
        return self._found.monodromy

    @cached_property
    def newton_steps(self) -> list[list[float]]:
        moved = np.stack((self._found.x, self._found.v)) - self._start
        x_and_v: list[list[float]] = newton_steps(self.monodromy, moved.T).T.tolist()
        return x_and_v

    @cached_property
    def multipliers(self) -> list[list[complex]]:
        first_and_second: list[list[complex]] = floquet_multipliers(self.monodromy).T.tolist()
        return first_and_second


class Records:
    """What a call recorded: the events of its stretches in a row, and where each one's end."""

    def __init__(self, events: Events, omega: Array) -> None:
        n = len(omega)
        self.t_extrema: list[float] = events.t_extrema.tolist()
        self.extrema: list[float] = events.extrema.tolist()
        self.states: list[float] = events.section.ravel().tolist()
        scales = np.repeat(omega, events.n_section)
        self.section: list[complex] = scaled(events.section, scales).tolist()
        self.turn_ends: list[int] = [*np.cumsum(events.n_extrema).tolist(), 0]
        self.period_ends: list[int] = [*np.cumsum(events.n_section).tolist(), 0]
        reach = np.zeros(n)
        owners = np.repeat(np.arange(n), events.n_extrema)
        np.maximum.at(reach, owners, np.abs(events.extrema))
        self.reach: list[float] = reach.tolist()

    def turns(self, number: int) -> slice:
        """Where the extrema of one stretch are."""
        # What lies before the first stretch is the last entry.
        return slice(self.turn_ends[number - 1], self.turn_ends[number])

    def periods(self, number: int) -> slice:
        """Where the section points of one stretch are."""
        return slice(self.period_ends[number - 1], self.period_ends[number])


class Ensemble:
    """Scenes of one solver and one kind of law: one call of the engine can take them all."""

    def __init__(self, scenes: Sequence[Scene]) -> None:
        self._omega = np.array([scene.omega for scene in scenes])
        models = Models(
            oscillators=[scene.oscillator for scene in scenes],
            laws=[scene.law for scene in scenes],
            omega=self._omega,
        )
        self._integrate = prepared(models, scenes[0].solver)
        # Of every call, by stretch: number of the scene, then the attributes of a response.
        self._costs: list[tuple[NDArray[Any], ...]] = []

    def parts(self, asked: Mapping[int, Stretch]) -> list[Part]:
        """Answers to stretches, all with the tangent or all without, by number of their scene."""
        which = np.fromiter(asked, np.intp, len(asked))
        y, n_periods, recorded, tangent = zip(*asked.values(), strict=True)
        start, omega = np.array(y).T.copy(), self._omega[which]
        t_end = np.array(n_periods) / omega
        problems = Problems(
            which=which,
            x_0=start[0],
            v_0=start[1],
            t_0=np.zeros(len(which)),
            t_end=t_end,
            record_from=np.where(recorded, 0.0, math.inf),
            tangent=tangent[0],
        )
        begin = time.thread_time()
        found = self._integrate(problems)
        # What ran together shares the processor time in proportion to its steps.
        seconds = (time.thread_time() - begin) * found.n_steps / max(found.n_steps.sum(), 1)
        counts = (getattr(found, name) for name in _COUNTS)
        self._costs.append((which, *counts, np.array(n_periods), seconds))
        ends = zip(found.x.tolist(), found.v.tolist(), strict=True)
        call = Call(found, start, omega)
        return list(map(Part, ends, _statuses(found, t_end), repeat(call), range(len(which))))

    def costs(self) -> list[dict[str, Any]]:
        """What the stretches of each scene have cost so far, as attributes of a `Response`."""
        which, *columns = map(np.concatenate, zip(*self._costs, strict=True))
        n = len(self._omega)
        *counts, n_periods, seconds = (np.bincount(which, column, n) for column in columns)
        totals = [
            *(count.astype(np.int64).tolist() for count in counts),
            (n_periods / self._omega).tolist(),
            seconds.tolist(),
        ]
        names = (*_COUNTS, "t_simulated", "cpu_time")
        return [dict(zip(names, row, strict=True)) for row in zip(*totals, strict=True)]


def _statuses(found: Motions, t_end: Array) -> list[Status]:
    if not found.status.any():
        return [Status.OK] * len(t_end)
    # A fit that was left on the way but did not run away goes on; where its steady response
    # lies decides in the end.
    arrived = found.t >= t_end * (1.0 - 1e-9)
    excused = arrived & (found.status == Status.OUT_OF_FIT_RANGE)
    return list(map(Status, np.where(excused, Status.OK, found.status).tolist()))


class Walk:
    """Where a motion is, and the window recorded last.

    Attributes
    ----------
    y : (float, float)
        State [m], [m/s], at forcing phase zero.
    n_periods : int
        Forcing periods since the start.
    section : list of complex
        Section points of the window [m].
    reach : float
        Largest displacement of the window, its end included [m].
    omega, omega_rad : float
        Forcing frequency [Hz], [rad/s].
    """

    def __init__(self, scene: Scene, y: State) -> None:
        self.scene = scene
        self.omega = scene.omega
        self.omega_rad = 2.0 * math.pi * scene.omega
        self.y = y
        self.status = Status.OK
        self.n_periods = 0
        self.forget()

    @property
    def t(self) -> float:
        """Time since the start [s]."""
        return self.n_periods / self.omega

    @property
    def noise(self) -> float:
        """Distance [m] below which two states are the same to this solver."""
        solver = self.scene.solver
        return _NOISE_FACTOR * (solver.atol + solver.rtol * self.reach)

    @property
    def extrema(self) -> list[float]:
        """Displacements [m] of the window's zero-velocity points."""
        return [x for _, part in self._window for x in part.extrema]

    @property
    def t_extrema(self) -> list[float]:
        """Times [s] of `extrema` since the start."""
        return [begin + t for begin, part in self._window for t in part.t_extrema]

    def forget(self) -> None:
        """Start an empty window here."""
        self._window: list[tuple[float, Part]] = []
        self._extent = 0.0
        self.section: list[complex] = []
        self.reach = abs(self.y[0])

    def advance(self, n_periods: int, *, record: bool) -> Generator[Stretch, Part, None]:
        """Go on for whole periods; recorded ones are added to the window."""
        part = yield Stretch(self.y, n_periods, record)
        self.y, self.status = part.y, part.status
        if record:
            self._window.append((self.t, part))
            self._extent = max(self._extent, part.reach)
            self.section += part.section
        self.reach = max(self._extent, abs(self.y[0]))
        self.n_periods += n_periods
