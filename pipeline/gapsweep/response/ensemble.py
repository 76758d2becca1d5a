"""Many motions in the engine together, and calls that advance them by whole periods.

No result depends on the others that share a call.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import ModelError
from gapsweep.integrate.motion import COUNTS, Motions
from gapsweep.integrate.problem import LOADING, Integrate, Models, Problems
from gapsweep.integrate.simulate import prepared
from gapsweep.model.contact import ContactLaw
from gapsweep.model.oscillator import Oscillator
from gapsweep.model.structure import Structure
from gapsweep.model.system import System
from gapsweep.response.call import Call, arrived
from gapsweep.response.scene import Scene
from gapsweep.response.section import unit_of
from gapsweep.status import Status

Array = NDArray[np.float64]

# Beside the `Status` values of a call: the motion has come to rest, or never comes back.
AT_REST, ASTRAY = -1, -2
_STEPS_AT_A_TIME = 10_000.0  # some five milliseconds of a lane
_UNKNOWN = 1e-100  # steps a second: whatever is asked, it takes one call


class Ensemble:
    """Scenes of one solver and one kind of model: one call of the engine can take them all.

    Attributes
    ----------
    scenes : sequence of Scene, length n
    solver : Solver
    omega : ndarray, shape (n,)
        Forcing frequencies [Hz].
    is_free : bool
        Whether nothing forces them.
    decay_rate, settling_rate : ndarray, shape (n,)
        As of an `Oscillator` or a `System` [1/s].
    unit : ndarray, shape (n_states, n)
        As of a `Call`.
    structure : Structure or None
        Of systems.
    n_coordinates : int
    swing : ndarray, shape (n,)
        How far [m] each motion has come from the origin so far, where nothing forces it.
    valid_range : ndarray, shape (2, n_contacts, n)
        Lowest and highest gaps at which the laws hold [m].
    walls : ndarray, shape (2, n_contacts, n)
        Places of the lower and of the upper walls in the contacts' gaps [m].
    felt_walls : ndarray, shape (2, n_contacts, n)
        The same, NaN where no gap lies between equal walls.
    is_modulated : ndarray of bool, shape (n_contacts, n)
        Whether the force of a contact changes with time.
    has_own_tangent, is_rattled : bool
        As of a `Scene`.
    is_chained : bool
        Whether motions with their tangent may follow each other in a call.
    """

    is_chained = True

    def __init__(self, scenes: Sequence[Scene]) -> None:
        self.scenes, self.solver = scenes, scenes[0].solver
        models: list[Any] = [scene.oscillator for scene in scenes]
        forcing = np.array([scene.omega for scene in scenes])
        self.is_free = not forcing.any()
        self.omega = _of_objects(models, lambda model: model.slowest) if self.is_free else forcing
        self.is_plain = isinstance(models[0], Oscillator)
        self.structure = None if self.is_plain else Structure.of(models[0])
        self.n_coordinates = 1 if self.is_plain else models[0].n
        self.decay_rate = _of_objects(models, lambda model: model.decay_rate)
        self.settling_rate = _of_objects(models, lambda model: model.settling_rate)
        self.set_clock(self.omega)
        self.swing = np.zeros(len(scenes))
        laws = _of_objects([scene.law for scene in scenes], _of_laws)
        shape = len(scenes), len(scenes[0].laws), 2
        self.valid_range, self.walls, self.felt_walls = (
            laws[:, i].reshape(shape).T for i in range(3)
        )
        self._directions: Array | None = None
        self.is_modulated = np.zeros(self.walls.shape[1:], bool)
        if not self.is_plain:
            self._directions = _of_objects(models, lambda model: model.directions)
            self.is_modulated = _of_objects(models, lambda model: model.is_modulated).T
        self.has_own_tangent, self.is_rattled = scenes[0].has_own_tangent, scenes[0].is_rattled
        prepared_models = Models(
            systems=models, laws=[scene.law for scene in scenes], omega=forcing
        )
        self._integrate = prepared(prepared_models, self.solver)
        self._integrate_tangent: Integrate | None = None
        if not self.has_own_tangent:
            located = replace(prepared_models, laws=[scene.tangent_law for scene in scenes])
            self._integrate_tangent = prepared(located, scenes[0].tangent_solver)
        # Of every call, by motion: number of the scene, then what it has cost.
        self._costs: list[tuple[NDArray[Any], ...]] = []

    def set_clock(self, omega: Array) -> None:
        """Count time in periods of these frequencies [Hz], shape (n,).

        Raises
        ------
        ModelError
            If one is zero.
        """
        if not omega.all():
            raise ModelError(
                "oscillator: neither springs nor damping nor lags give this System a time of its "
                "own; `simulate` it"
            )
        models: list[Any] = [scene.oscillator for scene in self.scenes]
        self.omega = omega
        self.unit = unit_of(omega) if self.is_plain else _units(models, omega)
        self._pace = _UNKNOWN / omega  # steps that a period took last

    def at_a_time(
        self, scenes: NDArray[np.intp], n_periods: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """How many of these forcing periods one call should take, by what motions took so far.

        A lane that is left alone with a long motion costs what all of them do. All calls for one
        stretch are about as long.
        """
        n_calls = np.maximum(np.ceil(n_periods * self._pace[scenes] / _STEPS_AT_A_TIME), 1.0)
        return np.ceil(n_periods / n_calls).astype(np.int64)

    def turning(self, scenes: NDArray[np.intp], parts: Array) -> Array:
        """What extrema are recorded of: coordinates, then a system's gaps.

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
        if self._directions is None:
            return q
        gaps = np.einsum("skj,js->ks", self._directions[scenes], q)
        return np.concatenate([q, gaps])

    def gap_units(self, scenes: NDArray[np.intp]) -> Array:
        """What one metre of the section is in the contacts' gaps, shape (n_contacts, m)."""
        unit = self.unit[: self.n_coordinates, scenes]
        if self._directions is None:
            return unit
        return np.asarray(np.sqrt(np.einsum("skj,js->ks", self._directions[scenes] ** 2, unit**2)))

    def gaps(self, turning: Array) -> Array:
        """Rows of the contacts' gaps among those of `turning`."""
        return turning[0 if self.is_plain else self.n_coordinates :]

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
        """Integrate scenes over whole forcing periods, from phase zero.

        Parameters
        ----------
        scenes : ndarray of int, shape (n,)
            Their numbers, none twice but where a motion follows another one of it.
        y : ndarray, shape (n_states, n)
            States to start from.
        n_periods : ndarray of int, shape (n,)
        record_from : ndarray, shape (n,)
            Time [s] from which events are wanted; infinity: never.
        section_only : bool
            Whether of these only the section is wanted.
        tangent : bool
            Whether the tangent equations are integrated along.
        follows : ndarray of bool, shape (n,), optional
            As of `Problems`; only if `is_chained`.
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
        """Rates [1/s] at which volumes of states shrink."""
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
        """Integrate scenes for some time: motions, their tangents, and where these lead.

        `is_motion`: whether they settle or are recorded, rather than being shots or repeated.
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
        """Tangents along motions by a solver of their own, and where they lead.

        Each from where its motion begins, so that none waits for the one before it.
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
        # What ran together shares the processor time in proportion to its steps.
        seconds = spent * found.n_steps / max(found.n_steps.sum(), 1)
        counts = (is_motion * getattr(found, name) for name in COUNTS)
        lasted = found.t * self.omega[problems.which] * _begun(problems, found)
        n_periods = is_motion * np.where(arrived(found, problems.t_end), n_periods, lasted)
        self._costs.append((problems.which, *counts, n_periods, seconds))
        return found

    def costs(self) -> dict[str, NDArray[Any]]:
        """What each scene has cost so far, as columns of `Responses`.

        Counts and simulated time are of its motion; the processor time is of its analysis too.
        """
        scenes, *columns = map(np.concatenate, zip(*self._costs, strict=True))
        n = len(self.omega)
        *counts, n_periods, seconds = (np.bincount(scenes, column, n) for column in columns)
        found = {name: count.astype(np.int64) for name, count in zip(COUNTS, counts, strict=True)}
        return found | {"t_simulated": n_periods / self.omega, "cpu_time": seconds}


def _begun(problems: Problems, found: Motions) -> NDArray[np.bool_]:
    """Which motions were begun: not what follows a failure."""
    if problems.follows is None:
        return np.ones(len(problems), bool)
    # What leaves the bounds in its last step has arrived, too.
    is_ok = np.isin(found.status, (Status.OK, Status.OUT_OF_FIT_RANGE))
    is_ok &= arrived(found, problems.t_end) & np.isfinite(found.state).all(axis=1)
    return ~problems.follows | np.roll(is_ok, 1)


def _of_objects(objects: Sequence[Any], value: Callable[[Any], Any]) -> NDArray[Any]:
    """A value of each object; the same one again and again costs nothing."""
    numbers: dict[int, int] = {}
    values: list[Any] = []
    for each in objects:
        if id(each) not in numbers:
            numbers[id(each)] = len(values)
            values.append(value(each))
    return np.array(values)[[numbers[id(each)] for each in objects]]


def _of_laws(law: Any) -> list[list[tuple[float, float]]]:
    """Of the laws of a scene's contacts: valid ranges, walls, and walls that are felt."""
    laws = law if isinstance(law, tuple) else (law,)
    return [
        [each.valid_range for each in laws],
        [each.walls for each in laws],
        [_felt_walls(each) for each in laws],
    ]


def _felt_walls(law: ContactLaw) -> tuple[float, float]:
    """Places of the walls at which the stiffness changes, at once or, of a smooth law, around."""
    return (math.nan, math.nan) if law.gap.width == 0.0 and law.K_ratio == 1.0 else law.walls


def _units(systems: Sequence[System], omega: Array) -> Array:
    """What one metre of the section is in each component of systems' states."""
    known: dict[tuple[int, float], Array] = {}
    keys = [(id(system), at) for system, at in zip(systems, omega.tolist(), strict=True)]
    for key, system in zip(keys, systems, strict=True):
        if key not in known:
            known[key] = system.unit(2.0 * math.pi * key[1])
    return np.stack([known[key] for key in keys], axis=1)
