"""Input of an engine: models, initial value problems and solver settings."""

import math
import threading
import time
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import ModelError
from gapsweep.integrate.motions import Motions
from gapsweep.model.contact import ContactLaw, checked_law
from gapsweep.model.laws.tanh import Tanh
from gapsweep.model.oscillator import Oscillator, checked
from gapsweep.model.structure import general_form, with_walls_apart
from gapsweep.model.system import System
from gapsweep.model.table import ForceTable
from gapsweep.model.user_law import UserLaw

Array = NDArray[np.float64]
Numbers = NDArray[np.intp]
Model = Oscillator | System
Laws = tuple[ContactLaw, ...]
T = TypeVar("T")

DEFAULT_RTOL = {"compiled": 1e-9, "scipy": 1e-4}  # by engine
ENGINES = tuple(DEFAULT_RTOL)
DEFAULT_ENGINE = "compiled"
CONTROLLERS = ("native", "ode45")
CONTACT_FORCES = ("by_mode", "as_written")

# Tighter than this all methods only add rounding.
SMALLEST_RTOL = 1e-13
LARGEST_RTOL = 0.1
_STIFF = 1e6  # stiffness of a rigid wall, times that of the springs, in a static displacement
_LOWEST_BOUNCE = 1e-9  # at any tolerance: the number of bounces grows as the root of its inverse
_NO_LENGTH = 1e-3  # [m] of a problem without loads, initial state and gap


class _Integrated(list[Any]):
    """Systems as engines integrate them, of rows that have been checked."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Models:
    """Parameter sets of n motions of one `kind`: rows that refer to distinct systems and laws.

    An engine prepares them once and then solves them from many initial states.

    Attributes
    ----------
    systems : sequence of Oscillator or of System
        Oscillators that are not classic become systems; those that are have all damping in `zeta`.
    laws : sequence of tuple of ContactLaw
        The laws of all contacts, in the system's order.
    system, law : ndarray of int, shape (n,)
        Number of each row's system in `systems`, and of its laws in `laws`.
    omega : ndarray, shape (n,)
        Forcing frequency [Hz]; 0 for unforced systems.
    start : ndarray, shape (n, n_states), optional
        Initial states of the whole motions; a default `atol` may depend on them.
    size : ndarray, shape (n,), optional
        Length of each problem [m] to which a default `atol` relates; None: computed.
    """

    systems: Sequence[Any]
    laws: Sequence[Laws]
    system: Numbers
    law: Numbers
    omega: Array
    start: Array | None = None
    size: Array | None = None

    def __post_init__(self) -> None:
        if isinstance(self.systems, _Integrated):
            return
        # One object of each type: there may be as many objects as rows.
        for system in {type(system): system for system in self.systems}.values():
            if not isinstance(system, Oscillator | System):
                raise ModelError(
                    f"oscillator = {system!r}: must be a gapsweep.Oscillator(...) or a "
                    "gapsweep.System()"
                )
        for law in {type(law): law for laws in self.laws for law in laws}.values():
            checked_law(law)
        systems = _Integrated(_integrated(system) for system in self.systems)
        object.__setattr__(self, "systems", systems)

    @classmethod
    def of(
        cls,
        systems: Sequence[Model],
        laws: Sequence[Laws],
        omega: Array,
        start: Array | None = None,
    ) -> "Models":
        """Return rows with these systems, laws and frequencies; a single one holds for all rows."""
        found, system = _distinct(systems, id)
        several, law = _distinct(laws, lambda these: tuple(map(id, these)))
        n = len(omega)
        system, law = (each if len(each) == n else np.repeat(each, n) for each in (system, law))
        return cls(systems=found, laws=several, system=system, law=law, omega=omega, start=start)

    def __len__(self) -> int:
        return len(self.omega)

    def take(self, rows: Any) -> "Models":
        """Return some of the rows, with only the systems and laws that they refer to."""
        some, system = np.unique(self.system[rows], return_inverse=True)
        others, law = np.unique(self.law[rows], return_inverse=True)
        return Models(
            systems=_Integrated(self.systems[i] for i in some.tolist()),
            laws=[self.laws[i] for i in others.tolist()],
            system=system,
            law=law,
            omega=self.omega[rows],
            start=None if self.start is None else self.start[rows],
            size=None if self.size is None else self.size[rows],
        )

    def by_kind(self) -> list[tuple[Numbers, "Models"]]:
        """Return groups that an engine can integrate together: their row numbers and models."""
        if len(self.systems) == len(self.laws) == 1:
            return [(np.arange(len(self)), self)]
        sizes = _distinct([system.sizes for system in self.systems], lambda size: size)[1]
        kinds, which = _distinct([tuple(map(law_kind, laws)) for laws in self.laws], lambda k: k)
        if len(kinds) == 1 and not sizes.any():
            return [(np.arange(len(self)), self)]
        group = sizes[self.system] * len(kinds) + which[self.law]
        groups = [np.flatnonzero(group == one) for one in np.unique(group).tolist()]
        return [(rows, self.take(rows)) for rows in groups]

    @property
    def n_located(self) -> int:
        """Number of contacts that are located, of the first row as of all."""
        return sum(law.is_located for law in self.laws[0])

    @property
    def is_lossy(self) -> bool:
        """Whether contacts lose energy."""
        return any(law.losses for laws in self.laws for law in laws)

    def of_systems(self, value: Callable[[Any], Any]) -> NDArray[Any]:
        """Return a function's value for every row's system, shape (n, ...)."""
        return np.array([value(system) for system in self.systems])[self.system]

    def of_laws(self, value: Callable[[ContactLaw], Any]) -> NDArray[Any]:
        """Return a function's value for every row's laws, shape (n, n_contacts, ...)."""
        return np.array([[value(law) for law in laws] for laws in self.laws])[self.law]

    def absolute(self, solver: "Solver") -> Array:
        """Absolute tolerances [m], shape (n,): by default `rtol` times the length of each problem.

        The length is the static deflection under all loads, limited by the farther wall or a user
        law. Without loads it is the initial displacement (or velocity over angular frequency), else
        the distance of the farther wall. It does not depend on other rows.
        """
        if solver.atol is not None:
            return np.full(len(self), solver.atol)
        return np.asarray(solver.rtol * (self._length if self.size is None else self.size))

    def sized(self) -> "Models":
        """Return the models with their `size`, so that it is computed once."""
        return replace(self, size=self._length)

    @property
    def _length(self) -> Array:
        """Length [m] of each problem, as in `absolute`."""
        farther = self.of_laws(_farther).max(axis=1, initial=0.0)
        softer = self.of_laws(_stiffness).max(axis=1, initial=0.0)
        spring = self.of_systems(_spring)
        length = self.of_systems(attrgetter("deflection"))
        held = softer / np.maximum(spring + softer, np.finfo(float).tiny)
        length = length - np.maximum(length - farther, 0.0) * held
        if self.systems[0].n > 1:  # walls may hold coordinates that springs do not
            for number, kind in {*zip(self.system.tolist(), self.law.tolist(), strict=True)}:
                system, laws = self.systems[number], self.laws[kind]
                rows = np.flatnonzero((self.system == number) & (self.law == kind))
                walls = np.zeros((system.n, system.n))
                stiffest = _STIFF * (np.abs(system.stiffness).max() or 1.0)
                for b, law in zip(system.contacts.values(), laws, strict=True):
                    walls += (stiffest if law.losses.is_rigid else _stiffness(law)) * np.outer(b, b)
                length[rows] = np.minimum(length[rows], system.held(walls) + farther[rows])
        for number, laws in enumerate(self.laws):
            if len(laws) == 1 and isinstance(law := laws[0], UserLaw | ForceTable):
                rows = np.flatnonzero((self.law == number) & np.isfinite(spring) & (length > 0.0))
                x, load = length[rows], spring[rows] * length[rows]
                with np.errstate(all="ignore"):  # far outside the range of the law
                    force = np.minimum(abs(law.force(x)), abs(law.force(-x)))
                    length[rows] = np.where(np.isfinite(force), x * load / (load + force), x)
        if not length.all():
            rate = [2.0 * math.pi * (one.slowest or one.fastest or 1.0) for one in self.systems]
            units = np.array([one.unit(w) for one, w in zip(self.systems, rate, strict=True)])
            start = np.zeros(1) if self.start is None else self.start / units[self.system]
            for other in (np.abs(start).max(axis=-1), farther):
                length = np.where(length > 0.0, length, other)
        return np.where(length > 0.0, length, _NO_LENGTH)

    def with_walls_apart(self) -> "Models":
        """Return the models of one kind with the walls of pairs that overlap as two contacts."""
        pairs = [with_walls_apart(system, self.laws[0]) for system in self.systems]
        several = [with_walls_apart(self.systems[0], laws) for laws in self.laws]
        systems, laws = [system for system, _ in pairs], [laws for _, laws in several]
        return replace(self.sized(), systems=systems, laws=laws)

    def check_losses(self, solver: "Solver") -> None:
        """Raise a `ModelError` if contacts lose energy in a way that the solver cannot integrate.

        Steps that pass a wall before they are cut there would see the jump of the force.
        """
        lossy = [law for laws in self.laws for law in laws if law.losses and law.has_modes]
        losses = [law.losses for law in lossy]
        if not losses:
            return
        own = [law for law in lossy if law.losses.by_function]
        if own and len(own) < len(lossy):
            others = next(each for each in losses if not each.by_function)
            raise ModelError(f"{own[0]}: f(x, v) not with {others} in one system; use f for both")
        setting = solver.runge_kutta_setting
        if setting and (solver.engine == "compiled" or solver.contact_force == "as_written"):
            raise ModelError(f"{losses[0]}: not with {setting}; leave that setting out")
        for system, law in {*zip(self.system.tolist(), self.law.tolist(), strict=True)}:
            modulated, laws = self.systems[system].is_modulated, self.laws[law]
            for each in [law.losses for law, m in zip(laws, modulated, strict=True) if m]:
                if each.never_pulls or each.chi or each.by_function or each.may_hold:
                    raise ModelError(
                        f"{each}: a contact with periodic stiffness must be a damper that pulls; "
                        "write gs.Piecewise(K_c, gap, damping=60.0, pulls=True)"
                    )

    def with_laws(self, value: Callable[[Laws], Laws]) -> "Models":
        """Return the rows with their laws replaced by a function of them."""
        return replace(self, laws=[value(laws) for laws in self.laws])


def _spring(system: Model) -> float:
    """Linear stiffness [N/m] of a model with one coordinate; infinite for several coordinates."""
    if isinstance(system, Oscillator):
        return system.mass * system.omega_n_rad**2
    return abs(float(system.stiffness[0, 0])) if system.n == 1 else math.inf


def _stiffness(law: ContactLaw) -> float:
    """Stiffness [N/m] of the softer wall, 0 for one wall, user laws and tables."""
    return 0.0 if isinstance(law, UserLaw | ForceTable) else min(law.stiffnesses)


def _farther(law: ContactLaw) -> float:
    """Distance [m] of the farther wall that has stiffness."""
    lower = law.gap.j_1 if law.K_ratio else 0.0
    return max(abs(j) if j < math.inf else 0.0 for j in (lower, law.gap.j_2))


def _integrated(system: Model) -> Model:
    """Return the model as the engines integrate it: a classic oscillator or a `System`."""
    if not isinstance(system, Oscillator):
        return system
    if not system.is_classic:
        return general_form(system)
    return replace(system, zeta=system.damping_ratio, c=0.0) if system.c else system


def _distinct(objects: Sequence[T], key: Callable[[T], Hashable]) -> tuple[list[T], Numbers]:
    """Objects with distinct keys, by first appearance, and the number among them of each object."""
    if len(objects) == 1:
        return list(objects), np.zeros(1, np.intp)
    numbers: dict[Hashable, int] = {}
    which = [numbers.setdefault(key(each), len(numbers)) for each in objects]
    found = dict(zip(reversed(which), reversed(objects), strict=True))
    return [found[i] for i in range(len(found))], np.array(which, np.intp)


def law_kind(law: ContactLaw) -> Hashable:
    """Return a key that is equal for laws which an engine can integrate together.

    The key is the family of the law, or the user's function; every fit has a different key.

    Raises
    ------
    ModelError
        If `law` is no contact law.
    """
    if isinstance(law, UserLaw):
        return law.function
    if checked_law(law).is_numbers:
        is_thin = isinstance(law, Tanh) and law.has_thin_layers
        kind = law.is_located, law.losses.kind, law.gap.width < 0.0
        return type(law), is_thin, *kind
    return law


def low_bounce(rtol: float) -> float:
    """Return the height, over the largest displacement, below which a preload holds a gap.

    A gap that a load presses on a wall with a preload bounces from side to side without a loss.
    """
    return max(rtol, _LOWEST_BOUNCE)


@dataclass(frozen=True, slots=True, kw_only=True)
class Shifts:
    """Derivatives by parameters, as sums over models with shifted parameters.

    A call that differentiates by parameters has n models, then, for every parameter and shift,
    these models with that parameter shifted.

    Attributes
    ----------
    names : tuple of str
        The parameters.
    weights : ndarray, shape (n_parameters, n_shifts, n)
        Weights of shifted values in the derivative at each model; their sum is zero.
    """

    names: tuple[str, ...]
    weights: Array

    @property
    def n(self) -> int:
        """Number of models."""
        return int(self.weights.shape[2])

    def derivatives(self, values: Array) -> Array:
        """Return derivatives of values of all rows, shape (n_parameters, n, ...).

        Exactly zero of values that do not change.
        """
        shifted = values[self.n :].reshape(*self.weights.shape, *values.shape[1:])
        return np.asarray(np.einsum("psn,psn...->pn...", self.weights, shifted - values[: self.n]))


@dataclass(slots=True, kw_only=True)  # creating a frozen one takes three times as long
class Problems:
    """Initial value problems, m of them, that an engine solves in one call.

    Attributes
    ----------
    which : ndarray of int, shape (m,)
        Row of the model of each problem.
    start : ndarray, shape (m, n_states)
        Coordinates [m], velocities [m/s] and first-order states at `t_0`.
    t_0, t_end : ndarray, shape (m,)
        Initial and final time [s]. The forcing phase at `t_0` is wrapped, so that whole periods
        before it cost no accuracy.
    record_from : ndarray, shape (m,)
        Time [s] from which extrema, contact times and section are recorded; infinity: never.
    effort : ndarray, shape (m,), optional
        Expected cost of each problem, in any unit; by default its time span. The most expensive
        ones are begun first, so that few lanes idle at the end.
    follows : ndarray of bool, shape (m,), optional
        Problems that begin in the end state of the one before, instead of `start`; default none. A
        problem that follows a failed one fails without a step; its state is undefined.
    section_only : bool
        Whether only the section is needed: the compiled engine then records no other events.
    dense_output : bool
        Whether the motions are kept for sampling, from `record_from` on.
    sampled : bool
        Whether another pass, with the same steps, has `dense_output`.
    tangent : bool
        Whether the variational equations are integrated too.
    contacts : bool
        Whether times at which walls are passed must be among the events.
    contact_time : bool
        Whether the time spent beyond the walls is needed. Methods that do not sum it up record the
        wall crossings instead.
    """

    which: NDArray[np.intp]
    start: Array
    t_0: Array
    t_end: Array
    record_from: Array
    effort: Array | None = None
    follows: NDArray[np.bool_] | None = None
    section_only: bool = False
    dense_output: bool = False
    sampled: bool = False
    tangent: bool = False
    contacts: bool = False
    contact_time: bool = False

    def __len__(self) -> int:
        return len(self.which)


Integrate = Callable[[Problems], Motions]


class Loading(threading.local):
    """Time that a thread has spent on loading or compiling an engine so far.

    The first call of a process waits for it; it does not count as cost of a motion, nor for its
    time limit. On a busy machine, or while another process compiles, much more time passes than the
    processor works.
    """

    seconds: float = 0.0  # processor time [s]
    elapsed: float = 0.0  # [s]
    end: float = math.inf  # deadline of motions, on the clock `_now`


LOADING = Loading()
TIME_LIMIT = 3600.0  # s of a call in Python


def _now() -> float:
    return time.monotonic() - LOADING.elapsed


def is_late() -> bool:
    """Whether motions of this thread have exceeded the time limit of `within`."""
    return _now() > LOADING.end


@contextmanager
def within(time_limit: float) -> Iterator[None]:
    """Limit the time [s] of motions in this thread; loading an engine does not count."""
    LOADING.end = _now() + checked("time_limit", time_limit, low=0.0, strict=True)
    try:
        yield
    finally:
        LOADING.end = math.inf


@dataclass(frozen=True, slots=True, kw_only=True)
class Solver:
    """Engine, tolerances and step-size control; `Solver.of` fills in an engine's defaults.

    Parameters
    ----------
    engine : str
        ``"compiled"``, or ``"scipy"`` for the reference engine.
    rtol : float
        Relative tolerance [-], 1e-13 to 0.1; `Solver.of` takes 1e-9 for engine ``"compiled"`` and
        1e-4 for ``"scipy"`` by default.
    atol : float or None
        Absolute tolerance [m, m/s], ``> 0``; None: `rtol` times a length, see `Models.absolute`.
    controller : str
        ``"native"``, or ``"ode45"`` for the step-size control of MATLAB's ode45 with its
        Dormand–Prince 5(4) pair, which locates contacts of an Oscillator (compiled engine only).
    restart : bool
        Whether the solver restarts at every located contact, with a new first step size, as the
        paper's solver. The reference engine always restarts.
    contact_force : str
        Force of a located contact inside a step: ``"by_mode"`` keeps the contact mode until the
        step ends at the wall; ``"as_written"`` evaluates the piecewise force at every stage, so
        that a step passes its kink before it is cut at the wall. No effect on smooth laws.

    Raises
    ------
    ModelError
        If a value is out of range.
    """

    engine: str
    rtol: float
    atol: float | None = None
    controller: str = "native"
    restart: bool = False
    contact_force: str = "by_mode"

    def __post_init__(self) -> None:
        _one_of("engine", self.engine, ENGINES)
        _one_of("controller", self.controller, CONTROLLERS)
        _one_of("contact_force", self.contact_force, CONTACT_FORCES)
        if self.engine == "scipy" and self.controller != "native":
            raise ModelError("controller = 'ode45': needs engine = 'compiled'")
        object.__setattr__(self, "rtol", checked("rtol", self.rtol, low=SMALLEST_RTOL))
        if self.atol is not None:
            object.__setattr__(self, "atol", checked("atol", self.atol, low=0.0, strict=True))
        if self.rtol > LARGEST_RTOL:
            raise ModelError(f"rtol = {self.rtol:g}: must be <= {LARGEST_RTOL:g}")

    @classmethod
    def of(
        cls,
        engine: str = DEFAULT_ENGINE,
        rtol: float | None = None,
        atol: float | None = None,
        controller: str = "native",
        restart: bool = False,
        contact_force: str = "by_mode",
    ) -> "Solver":
        """Return solver settings; `rtol` None means the engine's default."""
        default = DEFAULT_RTOL[_one_of("engine", engine, ENGINES)]
        rtol = default if rtol is None else rtol
        return cls(
            engine=engine,
            rtol=rtol,
            atol=atol,
            controller=controller,
            restart=restart,
            contact_force=contact_force,
        )

    @property
    def runge_kutta_setting(self) -> str:
        """The setting for which a compiled motion with located contacts takes Runge-Kutta steps.

        As in a study file; empty if there is none.
        """
        if self.contact_force == "as_written":
            return "contact_force = 'as_written'"
        if self.restart:
            return "restart = true"
        return "" if self.controller == "native" else "controller = 'ode45'"

    def check_located(self, n_located: int, n_contacts: int, *, is_oscillator: bool) -> None:
        """Raise a `ModelError` if the engine cannot locate contacts with these settings.

        Parameters
        ----------
        n_located, n_contacts : int
            Numbers of contacts that are located, and of all contacts.
        is_oscillator : bool
            Whether the models are oscillators with ``is_classic``.
        """
        if (
            self.engine == "compiled"
            and n_located
            and self.runge_kutta_setting
            and not is_oscillator
        ):
            raise ModelError(
                f"{self.runge_kutta_setting}: needs an Oscillator with omega_n > 0, "
                "mean_load = 0, base_damping = 1, no force by pieces and j_1 + j_2 >= 0; "
                "otherwise use engine='scipy', or located=False (piecewise-noevents)"
            )
        if 0 < n_located < n_contacts:
            raise ModelError(
                "contacts are located for all contacts or none; those of smooth laws and own "
                "functions f(x) are not: next to them use located=False (piecewise-noevents)"
            )

    def with_rtol(self, rtol: float) -> "Solver":
        """Return the solver with another relative tolerance, `atol` scaled by the same factor."""
        atol = None if self.atol is None else self.atol / self.rtol * rtol
        return replace(self, rtol=rtol, atol=atol)


def _one_of(name: str, value: str, allowed: tuple[str, ...]) -> str:
    if value not in allowed:
        raise ModelError(f"{name} = {value!r}: must be one of {', '.join(allowed)}")
    return value
