"""A motion that a sweep point advances by whole forcing periods.

A point does not integrate: it is a generator that asks, for example for a `Stretch` of motion,
and is sent the answer, a `Part`. So many points can advance together in the engine's lanes, and
none of them sees the others. Arithmetic on arrays is done for all of them at once; a point decides
on plain numbers, because on so few of them numpy would cost more than the motion.
"""

import math
import time
from collections.abc import Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import repeat
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.motion import Events, Motions
from gapsweep.integrate.problem import Integrate, Models, Problems, Solver
from gapsweep.integrate.simulate import prepared
from gapsweep.model.contact import ContactLaw, Piecewise
from gapsweep.model.oscillator import Oscillator
from gapsweep.response.section import scaled
from gapsweep.status import Status

Array = NDArray[np.float64]
State = tuple[float, float]

_COUNTS = ("n_contacts", "n_steps", "n_rejected", "nfev")
# A tangent is as good as its motion where all kinks are located; else it takes this tolerance.
_TANGENT_RTOL = 1e-8
# How far a tangent's determinant may be off, and from which share of its size squared on its own
# rounding shows.
_UNSOUND, _ROUNDING = 1e-2, 1e-3
DEVIATIONS = 4.0  # of the predicted scatter


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """What moves: the model, its forcing frequency [Hz] and the solver."""

    oscillator: Oscillator
    law: ContactLaw
    omega: float
    solver: Solver

    @property
    def tangent_law(self) -> ContactLaw:
        """The same force, its kinks located if they can be."""
        return replace(self.law, located=True) if isinstance(self.law, Piecewise) else self.law

    @property
    def tangent_solver(self) -> Solver:
        """What the tangent along the motion is integrated with.

        A step's error estimate does not see a kink that no event locates, nor the jump that the
        tangent makes there: at loose tolerances its growth would be the solver's own invention.
        """
        solver = self.solver
        is_located = isinstance(self.law, Piecewise) and self.law.located
        if is_located or (solver.rtol <= _TANGENT_RTOL and not isinstance(self.law, Piecewise)):
            return solver
        rtol = min(solver.rtol, _TANGENT_RTOL)
        return Solver.of(solver.engine, rtol, solver.atol / solver.rtol * rtol)

    @property
    def has_own_tangent(self) -> bool:
        """Whether motion and tangent are integrated together."""
        return self.tangent_law == self.law and self.tangent_solver == self.solver


class Stretch(NamedTuple):
    """What a point asks for: whole forcing periods, from phase zero, so that time never grows.

    Attributes
    ----------
    y : (float, float)
        State to start from [m], [m/s].
    n_periods : int
    recorded : bool
        Whether its events are wanted.
    """

    y: State
    n_periods: int
    recorded: bool


class Part(NamedTuple):
    """The stretch of motion that answers a `Stretch`: one of those in a call of the engine.

    Attributes
    ----------
    y : (float, float)
        Its end [m], [m/s].
    status : Status
    call : Call
        Where it is from, with the events of all.
    number : int
        Its number in the call.
    """

    y: State
    status: Status
    call: "Call"
    number: int

    @property
    def extrema(self) -> list[float]:
        """Displacements [m] of its zero-velocity points."""
        extrema: list[float] = self.call.events.extrema[self._turns].tolist()
        return extrema

    @property
    def n_steps(self) -> int:
        """Steps that the solver took for it."""
        return int(self.call.n_steps[self.number])

    @property
    def reach(self) -> float:
        """Largest modulus of `extrema` [m], 0 if there are none."""
        return self.call.reach[self.number]

    @property
    def states(self) -> list[float]:
        """``x, v, x, v, ...`` at the end of every forcing period [m], [m/s]."""
        return self.call.events.section[self._periods].ravel().tolist()

    @property
    def section(self) -> list[complex]:
        """The same as section points [m]."""
        section: list[complex] = self.call.section[self._periods].tolist()
        return section

    @property
    def _turns(self) -> slice:
        ends = self.call.turn_ends
        return slice(ends[self.number - 1], ends[self.number])

    @property
    def _periods(self) -> slice:
        ends = self.call.period_ends
        return slice(ends[self.number - 1], ends[self.number])


class Call:
    """What one call of the engine found: n motions.

    Attributes
    ----------
    y : ndarray, shape (2, n)
        Their ends [m], [m/s].
    status : ndarray of int, shape (n,)
        `Status` values.
    n_steps : ndarray of int, shape (n,)
    """

    def __init__(
        self, found: Motions, omega: Array, t_end: Array, shrinkage: Array, monodromy: Array | None
    ) -> None:
        self._omega, self._monodromy, self._read = omega, monodromy, found.events
        self._shrinkage = shrinkage
        self.y = np.array((found.x, found.v))
        self.status = found.status
        self.n_steps = found.n_steps
        if self.status.any():
            # A fit that was left on the way but did not run away goes on; where its steady
            # response lies decides in the end.
            arrived = found.t >= t_end * (1.0 - 1e-9)
            excused = arrived & (found.status == Status.OUT_OF_FIT_RANGE)
            self.status = np.where(excused, Status.OK, found.status)

    @property
    def omega_rad(self) -> Array:
        """Their angular forcing frequencies [rad/s]."""
        return 2.0 * math.pi * self._omega

    @property
    def is_ok(self) -> NDArray[np.bool_]:
        """Which motions did not fail."""
        return np.equal(self.status, Status.OK)

    @property
    def unit(self) -> Array:
        """What one metre of the section is in each component of a state, shape (2, n)."""
        return np.stack((np.ones_like(self._omega), self.omega_rad))

    @cached_property
    def monodromy(self) -> Array:
        """Derivatives of the ends by the starts, as section points; shape (n, 2, 2).

        With the tangent only. Without units, no arithmetic on them sees how fast clocks run.
        """
        assert self._monodromy is not None
        unit = self.unit.T
        return self._monodromy * (unit[:, None, :] / unit[:, :, None])

    @property
    def is_sound(self) -> NDArray[np.bool_]:
        """Where the tangent shrinks areas as damping says, whatever the force.

        Its two directions shrink so differently that the determinant is known to no better than
        rounding of its size squared.
        """
        with np.errstate(all="ignore"):  # of motions that failed
            size = np.square(self.monodromy).sum(axis=(1, 2))
            missed = np.abs(np.linalg.det(self.monodromy) - self._shrinkage)
            allowed = np.maximum(self._shrinkage, _ROUNDING * size)
        return np.asarray(missed <= _UNSOUND * allowed)

    @cached_property
    def events(self) -> Events:
        """Their events; none of a motion that was not recorded."""
        events = self._read()
        del self._read  # what the engine keeps for it is larger
        return events

    @cached_property
    def section(self) -> NDArray[np.complex128]:
        """All section points [m], motion by motion."""
        return scaled(self.events.section, np.repeat(self._omega, self.events.n_section))

    @cached_property
    def reach(self) -> list[float]:
        """Largest modulus of each motion's extrema [m], 0 if there are none."""
        reach = np.zeros(len(self.status))
        owners = np.repeat(np.arange(len(reach)), self.events.n_extrema)
        np.maximum.at(reach, owners, np.abs(self.events.extrema))
        largest: list[float] = reach.tolist()
        return largest

    @cached_property
    def turn_ends(self) -> list[int]:
        """Where each motion's extrema end; the last entry is where those of the first begin."""
        return [*np.cumsum(self.events.n_extrema).tolist(), 0]

    @cached_property
    def period_ends(self) -> list[int]:
        """Where each motion's section points end; the last is where those of the first begin."""
        return [*np.cumsum(self.events.n_section).tolist(), 0]

    def part(self, number: int) -> Part:
        """One of the motions."""
        x, v = self.y[:, number].tolist()
        return Part((x, v), Status(self.status[number]), self, number)

    def parts(self) -> list[Part]:
        """All motions, in their order."""
        ends = zip(*self.y.tolist(), strict=True)
        statuses: Iterable[Status] = repeat(Status.OK)
        if self.status.any():
            statuses = map(Status, self.status.tolist())
        return list(map(Part, ends, statuses, repeat(self), range(len(self.status))))


class Ensemble:
    """Scenes of one solver and one kind of law: one call of the engine can take them all."""

    def __init__(self, scenes: Sequence[Scene]) -> None:
        self._omega = np.array([scene.omega for scene in scenes])
        self._shrink_rate = np.array([2.0 * scene.oscillator.decay_rate for scene in scenes])
        models = Models(
            oscillators=[scene.oscillator for scene in scenes],
            laws=[scene.law for scene in scenes],
            omega=self._omega,
        )
        first = scenes[0]
        self._integrate = prepared(models, first.solver)
        self._integrate_tangent: Integrate | None = None
        if not first.has_own_tangent:
            models = replace(models, laws=[scene.tangent_law for scene in scenes])
            self._integrate_tangent = prepared(models, first.tangent_solver)
        # Of every call, by motion: number of the scene, then what it has cost.
        self._costs: list[tuple[NDArray[Any], ...]] = []

    def parts(self, asked: Mapping[int, Stretch]) -> list[Part]:
        """Answers to stretches, by number of their scene."""
        scenes = np.fromiter(asked, np.intp, len(asked))
        y, n_periods, recorded = map(np.array, zip(*asked.values(), strict=True))
        return self.call(scenes, y.T, n_periods, np.where(recorded, 0.0, math.inf)).parts()

    def call(
        self,
        scenes: NDArray[np.intp],
        y: Array,
        n_periods: NDArray[np.int64],
        record_from: Array,
        *,
        tangent: bool = False,
    ) -> Call:
        """Integrate scenes over whole forcing periods, from phase zero.

        Parameters
        ----------
        scenes : ndarray of int, shape (n,)
            Their numbers, no number twice.
        y : ndarray, shape (2, n)
            States to start from [m], [m/s].
        n_periods : ndarray of int, shape (n,)
        record_from : ndarray, shape (n,)
            Time [s] from which events are wanted; infinity: never.
        tangent : bool
            Whether the tangent equations are integrated along.
        """
        omega = self._omega[scenes]
        t_end = n_periods / omega
        x_0, v_0 = np.ascontiguousarray(y)
        problems = Problems(
            which=scenes,
            x_0=x_0,
            v_0=v_0,
            t_0=np.zeros(len(scenes)),
            t_end=t_end,
            record_from=record_from,
            tangent=tangent and self._integrate_tangent is None,
        )
        found = self._solved(self._integrate, problems, n_periods)
        monodromy = found.monodromy
        if tangent and self._integrate_tangent is not None:
            never = np.full(len(scenes), math.inf)
            problems = replace(problems, record_from=never, tangent=True)
            monodromy = self._solved(self._integrate_tangent, problems, n_periods).monodromy
        shrinkage = np.exp(-self._shrink_rate[scenes] * t_end)
        return Call(found, omega, t_end, shrinkage, monodromy)

    def _solved(
        self, integrate: Integrate, problems: Problems, n_periods: NDArray[np.int64]
    ) -> Motions:
        begin = time.thread_time()
        found = integrate(problems)
        # What ran together shares the processor time in proportion to its steps.
        seconds = (time.thread_time() - begin) * found.n_steps / max(found.n_steps.sum(), 1)
        counts = (getattr(found, name) for name in _COUNTS)
        self._costs.append((problems.which, *counts, n_periods, seconds))
        return found

    def costs(self) -> list[dict[str, Any]]:
        """What the stretches of each scene have cost so far, as attributes of a `Response`."""
        scenes, *columns = map(np.concatenate, zip(*self._costs, strict=True))
        n = len(self._omega)
        *counts, n_periods, seconds = (np.bincount(scenes, column, n) for column in columns)
        totals = [
            *(count.astype(np.int64).tolist() for count in counts),
            (n_periods / self._omega).tolist(),
            seconds.tolist(),
        ]
        names = (*_COUNTS, "t_simulated", "cpu_time")
        return [dict(zip(names, row, strict=True)) for row in zip(*totals, strict=True)]


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
        Largest displacement of the window [m].
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
        self._steps_per_period = 1.0
        self.forget()

    @property
    def t(self) -> float:
        """Time since the start [s]."""
        return self.n_periods / self.omega

    def noise(self, n_periods: int = 1) -> float:
        """Predicted scatter [m] of section points so many forcing periods apart.

        It is what the solver's tolerances admit in each step, in as many random steps as it
        takes. What scatters more than `same` is not the solver's doing.
        """
        return self.step_error * math.sqrt(self._steps_per_period * n_periods)

    @property
    def step_error(self) -> float:
        """What the solver's tolerances admit in a step [m]."""
        return self.scene.solver.atol + self.scene.solver.rtol * self.reach

    @property
    def same(self) -> float:
        """Distance [m] below which two states are the same to this solver."""
        return DEVIATIONS * self.noise()

    @property
    def extrema(self) -> list[float]:
        """Displacements [m] of the window's zero-velocity points."""
        return [x for _, part in self._window for x in part.extrema]

    def forget(self) -> None:
        """Start an empty window here."""
        self._window: list[tuple[int, Part]] = []
        self._extent = 0.0
        self.section: list[complex] = []
        self.reach = abs(self.y[0])

    def advance(self, n_periods: int, *, record: bool) -> Generator[Stretch, Part, None]:
        """Go on for whole periods; recorded ones are added to the window."""
        part = yield Stretch(self.y, n_periods, record)
        self._steps_per_period = max(part.n_steps / n_periods, 1.0)
        if record:
            self._window.append((self.n_periods, part))
            self._extent = max(self._extent, part.reach)
            self.section += part.section
        self.arrive(part.y, part.status, n_periods)

    def arrive(self, y: State, status: Status, n_periods: int) -> None:
        """Be at a state that whole periods of motion led to."""
        self.y, self.status = y, status
        self.n_periods += n_periods
        self.reach = max(self._extent, abs(y[0]))
