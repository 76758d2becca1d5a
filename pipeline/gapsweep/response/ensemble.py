"""Ensembles of motions, and calls of the engine that advance them by whole periods.

No result depends on the other motions of a call.
"""

import math
import time
from copy import copy
from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import ModelError
from gapsweep.integrate.motions import COUNTS, Motions
from gapsweep.integrate.problem import LOADING, Integrate, Laws, Models, Problems, Solver
from gapsweep.integrate.simulate import prepared
from gapsweep.model.contact import ContactLaw
from gapsweep.model.oscillator import Oscillator
from gapsweep.model.structure import structure_of
from gapsweep.model.user_law import UserLaw
from gapsweep.model.waves import check_periodic
from gapsweep.response.scene import TANGENT_RTOL, Forces, located
from gapsweep.response.window_call import Call, arrived
from gapsweep.status import Status

Array = NDArray[np.float64]
# A call: number of each motion's case, CPU time of all [s], the counts of `COUNTS`, and the
# periods of motions; None of calls that are no part of motions.
_Cost = tuple[NDArray[np.intp], float, list[NDArray[np.int64]], NDArray[Any] | None]

# In addition to `Status` values: the motion has come to rest, or never returns to its section.
AT_REST, ASTRAY = -1, -2
STEPS_AT_A_TIME = 10_000.0  # some five milliseconds of a lane
_UNKNOWN = 1e-100  # steps a second: any number of periods then takes one call


class Ensemble:
    """Motions of one kind with one solver, which one call of the engine can integrate together.

    Attributes
    ----------
    models : Models
        Parameter sets, n of them.
    solver : Solver
    atol : ndarray, shape (n,)
        Absolute tolerances [m].
    omega : ndarray, shape (n,)
        Forcing frequencies [Hz].
    n_multipliers : int
        Number of Floquet multipliers of a periodic orbit.
    has_families : ndarray of bool, shape (n,)
        Whether periodic orbits come in families, one for each energy.
    decay_rate, settling_rate : ndarray, shape (n,)
        As in `Oscillator` and `System` [1/s].
    unit : ndarray, shape (n_states, n)
        As in `Call`.
    structure : Structure or OscillatorStructure
    n_coordinates : int
    first_gap : int
        Row of the first contact's gap in `turning`: 0 if the gap is the only coordinate.
    swing : ndarray, shape (n,)
        Largest displacement [m] of each unforced motion so far.
    valid_range : ndarray, shape (2, n_contacts, n)
        Lowest and highest gaps at which the laws are valid [m].
    walls : ndarray, shape (2, n_contacts, n)
        Positions of the lower and the upper walls in the contacts' gaps [m].
    felt_walls : ndarray, shape (2, n_contacts, n)
        `walls`, but NaN for equal walls with zero gap, where the stiffness does not change.
    may_hold : ndarray of bool, shape (n_contacts, n)
        Whether a wall may hold a contact.
    is_modulated : ndarray of bool, shape (n_contacts, n)
        Whether the force of a contact changes with time.
    has_own_tangent, is_noisy : bool
        As in `Forces`.
    is_chained : bool
        Whether motions with their tangent may follow each other in a call.
    """

    is_chained = True

    def __init__(self, models: Models, solver: Solver) -> None:
        self.models, self.solver = models.sized() if solver.atol is None else models, solver
        models, self.atol = self.models, self.models.absolute(solver)
        n, n_contacts, system = len(models), len(models.laws[0]), models.systems[0]
        # Systems for what all oscillators have in common: one stands for all of them.
        self._alike = models
        if isinstance(system, Oscillator):
            one = np.zeros_like(models.system)
            self._alike = replace(models, systems=[system], system=one)
        for each in self._alike.systems:
            check_periodic(each)
        self.structure = structure_of(system)
        self.n_coordinates = system.n
        self.first_gap = 0 if isinstance(system, Oscillator) else system.n
        self.decay_rate = models.of_systems(attrgetter("decay_rate"))
        self.settling_rate = models.of_systems(attrgetter("settling_rate"))
        self.n_multipliers, self.has_families = system.n_states, np.zeros(n, bool)
        is_forced = models.omega.any()
        self.set_clock(models.omega if is_forced else models.of_systems(attrgetter("slowest")))
        self.swing = np.zeros(n)
        self.valid_range, self.walls, self.felt_walls = (
            models.of_laws(_places).reshape(n, n_contacts, 3, 2).transpose(2, 3, 1, 0)
        )
        self.may_hold = models.of_laws(attrgetter("losses.may_hold")).astype(bool).T
        self._directions: Array = self._alike.of_systems(attrgetter("directions"))
        self.is_modulated = self._alike.of_systems(attrgetter("is_modulated")).T
        forces = Forces(models.laws[0], solver)
        self.has_own_tangent, self.is_noisy = forces.has_own_tangent, forces.is_noisy
        self._integrate = prepared(models, solver)
        self._integrate_tangent: Integrate | None = None
        if not self.has_own_tangent:
            self._integrate_tangent = prepared(models.with_laws(located), forces.tangent_solver)
        nobody = np.zeros(0, np.int64)
        self._costs: list[_Cost] = [(nobody, 0.0, [nobody] * len(COUNTS), nobody)]

    def tight(self, rtol: float) -> "Ensemble":
        """Return the ensemble with the tolerance that decides stability, and located contacts.

        An ensemble whose solver is tight enough is returned itself. Both share their costs.
        """
        if self.solver.rtol <= TANGENT_RTOL:
            return self
        other, models = copy(self), self.models.with_laws(located)
        # numba may be unable to compile a user's law.
        is_users = any(isinstance(law, UserLaw) for law in models.laws[0])
        other.solver = Solver.of(self.solver.engine if is_users else "compiled", rtol)
        other.atol, other.has_own_tangent, other.is_noisy = (
            models.absolute(other.solver),
            True,
            False,
        )
        other._integrate, other._integrate_tangent = prepared(models, other.solver), None
        return other

    def set_clock(self, omega: Array) -> None:
        """Count time in periods of these frequencies [Hz], shape (n,).

        Raises
        ------
        ModelError
            If one is zero.
        """
        if not omega.all():
            raise ModelError(
                "oscillator: this System has no springs, damping or lags, hence no time scale; "
                "use gapsweep.simulate"
            )
        self.omega, rate = omega, 2.0 * math.pi * omega
        self.unit = np.empty((self.models.systems[0].n_states, len(omega)))
        for i, system in enumerate(self._alike.systems):
            here = self._alike.system == i
            self.unit[:, here] = system.unit(rate[here])
        self._pace = _UNKNOWN / omega  # steps that a period took last

    def duration(self, n_periods: NDArray[np.int64], elapsed: Array) -> Array:
        """Return the times [s] of `n_periods`; `elapsed` is the sum of the times of all calls."""
        return np.asarray(n_periods / self.omega)

    def bounded_transient(
        self, transient: NDArray[np.int64], n_periods: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Return the periods of the next transient, after `n_periods`; unchanged if forced."""
        return transient

    def stays_bounded(self, scenes: NDArray[np.intp], y: Array) -> NDArray[np.bool_]:
        """Whether aperiodic motions stay bounded: True for all forced motions."""
        return np.ones(len(scenes), bool)

    def system(self, scene: int) -> Any:
        """Return the model of a case."""
        return self.models.systems[int(self.models.system[scene])]

    def laws(self, scene: int) -> Laws:
        """Return the laws of a case's contacts."""
        return self.models.laws[int(self.models.law[scene])]

    def at_a_time(
        self, scenes: NDArray[np.intp], n_periods: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Return how many of `n_periods` one call should take, from the steps per period so far.

        A single lane with a long motion costs as much as all lanes. All calls for one motion get
        about equal numbers of periods.
        """
        n_calls = np.maximum(np.ceil(n_periods * self._pace[scenes] / STEPS_AT_A_TIME), 1.0)
        return np.ceil(n_periods / n_calls).astype(np.int64)

    def turning(self, scenes: NDArray[np.intp], parts: Array) -> Array:
        """Return the quantities whose extrema are recorded: coordinates, then gaps of a system.

        Parameters
        ----------
        scenes : ndarray of int, shape (m,)
        parts : ndarray, shape (n_states or fewer, m)
            States, whose displacements are taken, or velocities, or accelerations.

        Returns
        -------
        ndarray, shape (n_turning, m)
        """
        q = parts[: self.n_coordinates]
        if not self.first_gap:
            return q
        gaps = np.einsum("skj,js->ks", self._directions[scenes], q)
        return np.concatenate([q, gaps])

    def gap_units(self, scenes: NDArray[np.intp]) -> Array:
        """Gaps [m] that correspond to one metre of the section, shape (n_contacts, m)."""
        unit = self.unit[: self.n_coordinates, scenes]
        if not self.first_gap:
            return unit
        return np.asarray(np.sqrt(np.einsum("skj,js->ks", self._directions[scenes] ** 2, unit**2)))

    def gaps(self, turning: Array) -> Array:
        """Return the rows of the contacts' gaps among those of `turning`."""
        return turning[self.first_gap :]

    def call(
        self,
        scenes: NDArray[np.intp],
        y: Array,
        n_periods: NDArray[np.int64],
        record_from: Array,
        *,
        section_only: bool = True,
        tangent: bool = False,
        follows: NDArray[np.bool_] | None = None,
    ) -> Call:
        """Integrate cases over whole forcing periods, from phase zero.

        Parameters
        ----------
        scenes : ndarray of int, shape (n,)
            Numbers of cases; a number is repeated only for motions that follow each other.
        y : ndarray, shape (n_states, n)
            Initial states.
        n_periods : ndarray of int, shape (n,)
        record_from : ndarray, shape (n,)
            Time [s] from which events are recorded; infinity: never.
        section_only : bool
            Whether only section points are recorded.
        tangent : bool
            Whether the tangent equations are integrated too.
        follows : ndarray of bool, shape (n,), optional
            As in `Problems`; only if `is_chained`.
        """
        omega = self.omega[scenes]
        t_end = n_periods / omega
        found, tangents = self._run(
            scenes, y, n_periods, t_end, record_from,
            section_only=section_only, tangent=tangent, follows=follows, is_motion=not tangent,
        )  # fmt: skip
        given = self.unit[:, scenes], omega, t_end, self._shrinks(scenes)
        return Call(found, *given, *tangents)

    def _shrinks(self, scenes: NDArray[np.intp]) -> Array:
        """Return the rates [1/s] at which volumes in state space shrink."""
        return len(self.unit) * self.decay_rate[scenes]

    def _run(
        self,
        scenes: NDArray[np.intp],
        y: Array,
        n_periods: NDArray[Any],
        t_end: Array,
        record_from: Array,
        *,
        section_only: bool,
        tangent: bool,
        follows: NDArray[np.bool_] | None = None,
        is_motion: bool,
    ) -> tuple[Motions, tuple[Array | None, Array]]:
        """Integrate cases up to `t_end`; return motions, tangents and end states of tangents.

        `is_motion`: whether the cost counts as motion (transient, recording), not as shooting.
        """
        problems = Problems(
            which=scenes,
            start=np.ascontiguousarray(y.T),
            t_0=np.zeros(len(scenes)),
            t_end=t_end,
            record_from=record_from,
            effort=self._pace[scenes] * n_periods,
            follows=follows,
            section_only=section_only,
            contact_time=not section_only,
            tangent=tangent and self._integrate_tangent is None,
        )
        found = self._solved(self._integrate, problems, n_periods, is_motion=is_motion)
        self._pace[scenes] = np.maximum(found.n_steps, 1) / n_periods
        if not tangent or self._integrate_tangent is None:
            return found, (found.monodromy, found.state.T)
        return found, self._tangents(problems, found, n_periods)

    def _tangents(
        self, problems: Problems, found: Motions, n_periods: NDArray[Any]
    ) -> tuple[Array, Array]:
        """Return tangents along motions, integrated by a different solver, and their end states.

        Each tangent starts at the initial state of its motion, so that all run at the same time.
        """
        starts, begun = problems.start, _begun(problems, found)
        if problems.follows is not None:
            starts = np.where(problems.follows[:, None], np.roll(found.state, 1, axis=0), starts)
        assert self._integrate_tangent is not None
        assert problems.effort is not None
        exact = self._solved(
            self._integrate_tangent,
            Problems(
                which=problems.which[begun],
                start=starts[begun],
                t_0=problems.t_0[begun],
                t_end=problems.t_end[begun],
                record_from=np.full(begun.sum(), math.inf),
                effort=problems.effort[begun],
                tangent=True,
            ),
            n_periods[begun],
            is_motion=False,
        )
        assert exact.monodromy is not None
        tangents = np.full((len(problems), *exact.monodromy.shape[1:]), math.nan)
        ends = np.full(starts.shape, math.nan)
        tangents[begun], ends[begun] = exact.monodromy, exact.state
        return tangents, ends.T

    def _solved(
        self, integrate: Integrate, problems: Problems, n_periods: NDArray[Any], *, is_motion: bool
    ) -> Motions:
        begin = time.thread_time() - LOADING.seconds
        found = integrate(problems)
        spent = time.thread_time() - LOADING.seconds - begin
        lasted = None
        if is_motion:
            lasted = n_periods
            if found.status.any():
                part = found.t * self.omega[problems.which] * _begun(problems, found)
                lasted = np.where(arrived(found, problems.t_end), n_periods, part)
        counts = [getattr(found, name) for name in COUNTS]
        self._costs.append((problems.which, spent, counts, lasted))
        return found

    def costs(self) -> dict[str, NDArray[Any]]:
        """Return the cost of each case so far, as columns of `Responses`.

        Counts and simulated time are those of the motion; the CPU time includes its analysis.
        """
        n, seconds, motions = len(self.omega), np.zeros(len(self.omega)), []
        for which, spent, counts, lasted in self._costs:
            # Motions of a call share the CPU time in proportion to their steps.
            n_steps = counts[COUNTS.index("n_steps")]
            seconds += np.bincount(which, spent / max(int(n_steps.sum()), 1) * n_steps, n)
            if lasted is not None:
                motions.append((which, *counts, lasted))
        which, *columns = map(np.concatenate, zip(*motions, strict=True))
        *counts, n_periods = (np.bincount(which, column, n) for column in columns)
        found = {name: count.astype(np.int64) for name, count in zip(COUNTS, counts, strict=True)}
        return found | {"t_simulated": n_periods / self.omega, "cpu_time": seconds}


def _begun(problems: Problems, found: Motions) -> NDArray[np.bool_]:
    """Whether motions were begun: False for motions that follow a failed one."""
    if problems.follows is None:
        return np.ones(len(problems), bool)
    # A motion that diverges in its last step has arrived, too: the status decides as well.
    is_ok = np.isin(found.status, (Status.OK, Status.OUT_OF_FIT_RANGE))
    is_ok &= arrived(found, problems.t_end) & np.isfinite(found.state).all(axis=1)
    return ~problems.follows | np.roll(is_ok, 1)


def _places(law: ContactLaw) -> tuple[tuple[float, float], ...]:
    """Valid range of a law, its walls, and the walls at which the stiffness changes, else NaN."""
    is_felt, walls = law.gap.width != 0.0 or law.K_ratio != 1.0, law.walls
    return law.valid_range, walls, walls if is_felt else (math.nan, math.nan)
