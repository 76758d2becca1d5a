"""Many motions in the engine together: scenes, and calls that advance them by whole periods.

No result depends on the others that share a call.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

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


class Call:
    """What one call of the engine found: n motions.

    Attributes
    ----------
    y : ndarray, shape (2, n)
        Their ends [m], [m/s].
    status : ndarray of int, shape (n,)
        `Status` values.
    n_steps : ndarray of int, shape (n,)
    reach : ndarray, shape (n,)
        Largest modulus of the displacement at the ends of steps [m].
    t_end : ndarray, shape (n,)
        How long they are [s].
    """

    def __init__(
        self,
        found: Motions,
        omega: Array,
        t_end: Array,
        area_rate: Array,
        monodromy: Array | None,
        tangent_end: Array,
    ) -> None:
        self._omega, self._monodromy, self._read = omega, monodromy, found.events
        self._area_rate, self.t_end = area_rate, t_end
        self.y, self._tangent_end = found.state.T, tangent_end
        self.status = found.status
        self.n_steps, self.reach = found.n_steps, found.reach[:, 0]
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
    def strayed(self) -> Array:
        """How far [m] motions have strayed from those that their tangents belong to.

        These start where they do, and their kinks are located.
        """
        return np.asarray(np.hypot(*(self.y - self._tangent_end) / self.unit))

    @cached_property
    def shrinkage(self) -> Array:
        """Shares [-] of an area of the section that damping leaves, whatever the force."""
        # numpy's own exponential is another one on another processor.
        return np.fromiter(map(math.exp, (-self._area_rate * self.t_end).tolist()), float)

    @property
    def is_sound(self) -> NDArray[np.bool_]:
        """Where the tangent shrinks areas as damping says, whatever the force.

        Its two directions shrink so differently that the determinant is known to no better than
        rounding of its size squared.
        """
        with np.errstate(all="ignore"):  # of motions that failed
            size = np.square(self.monodromy).sum(axis=(1, 2))
            missed = np.abs(np.linalg.det(self.monodromy) - self.shrinkage)
            allowed = np.maximum(self.shrinkage, _ROUNDING * size)
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
    def period_ends(self) -> NDArray[np.int64]:
        """Where each motion's section points end, after a zero; shape (n + 1,)."""
        return np.concatenate(([0], np.cumsum(self.events.n_section)))


class Ensemble:
    """Scenes of one solver and one kind of law: one call of the engine can take them all.

    Attributes
    ----------
    scenes : sequence of Scene, length n
    solver : Solver
    omega : ndarray, shape (n,)
        Forcing frequencies [Hz].
    decay_rate, settling_rate : ndarray, shape (n,)
        As of an `Oscillator` [1/s].
    valid_range : ndarray, shape (n,)
        Of the laws [m].
    walls : ndarray, shape (2, n)
        Displacements of the lower and of the upper wall [m].
    has_own_tangent : bool
        As of a `Scene`.
    """

    def __init__(self, scenes: Sequence[Scene]) -> None:
        self.scenes, self.solver = scenes, scenes[0].solver
        self.omega = np.array([scene.omega for scene in scenes])
        self.decay_rate = np.array([scene.oscillator.decay_rate for scene in scenes])
        self.settling_rate = np.array([scene.oscillator.settling_rate for scene in scenes])
        self.valid_range = np.array([scene.law.valid_range for scene in scenes])
        gaps = [scene.law.gap for scene in scenes]
        self.walls = np.array([[-gap.j_1 for gap in gaps], [gap.j_2 for gap in gaps]])
        self.has_own_tangent = scenes[0].has_own_tangent
        models = Models(
            systems=[scene.oscillator for scene in scenes],
            laws=[scene.law for scene in scenes],
            omega=self.omega,
        )
        self._integrate = prepared(models, self.solver)
        self._integrate_tangent: Integrate | None = None
        if not self.has_own_tangent:
            models = replace(models, laws=[scene.tangent_law for scene in scenes])
            self._integrate_tangent = prepared(models, scenes[0].tangent_solver)
        # Steps that a forcing period took last; about a first guess only their ratio matters.
        self._pace = 1.0 / self.omega
        # Of every call, by motion: number of the scene, then what it has cost.
        self._costs: list[tuple[NDArray[Any], ...]] = []

    def call(
        self,
        scenes: NDArray[np.intp],
        y: Array,
        n_periods: NDArray[np.int64],
        record_from: Array,
        *,
        section_only: bool = True,
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
        section_only : bool
            Whether of these only the section is wanted.
        tangent : bool
            Whether the tangent equations are integrated along.
        """
        omega = self.omega[scenes]
        t_end = n_periods / omega
        problems = Problems(
            which=scenes,
            start=np.ascontiguousarray(y.T),
            t_0=np.zeros(len(scenes)),
            t_end=t_end,
            record_from=record_from,
            effort=self._pace[scenes] * n_periods,
            section_only=section_only,
            contacts=not section_only,
            tangent=tangent and self._integrate_tangent is None,
        )
        found = self._solved(self._integrate, problems, n_periods)
        self._pace[scenes] = found.n_steps / n_periods
        monodromy, end = found.monodromy, found.state.T
        if tangent and self._integrate_tangent is not None:
            never = np.full(len(scenes), math.inf)
            problems = replace(problems, record_from=never, tangent=True)
            exact = self._solved(self._integrate_tangent, problems, n_periods)
            monodromy, end = exact.monodromy, exact.state.T
        return Call(found, omega, t_end, 2.0 * self.decay_rate[scenes], monodromy, end)

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

    def costs(self) -> dict[str, NDArray[Any]]:
        """What the motions of each scene have cost so far, as columns of `Responses`."""
        scenes, *columns = map(np.concatenate, zip(*self._costs, strict=True))
        n = len(self.omega)
        *counts, n_periods, seconds = (np.bincount(scenes, column, n) for column in columns)
        found = {name: count.astype(np.int64) for name, count in zip(_COUNTS, counts, strict=True)}
        return found | {"t_simulated": n_periods / self.omega, "cpu_time": seconds}
