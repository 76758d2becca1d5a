"""The function `simulate`: one call for every engine, for one motion or many."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from operator import attrgetter
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError
from gapsweep.integrate.motions import Motions, merged
from gapsweep.integrate.problem import (
    DEFAULT_ENGINE,
    TIME_LIMIT,
    Integrate,
    Models,
    Problems,
    Solver,
    within,
)
from gapsweep.integrate.trajectory import SystemTrajectory, Trajectory
from gapsweep.model.arrays import numbers
from gapsweep.model.contact import ContactLaw, checked_law
from gapsweep.model.doubts import doubts, warn_of
from gapsweep.model.oscillator import LARGEST, SMALLEST, Oscillator, called_as, checked
from gapsweep.model.system import System
from gapsweep.variables import objects

Array = NDArray[np.float64]
T = TypeVar("T")
Several: TypeAlias = T | Sequence[T] | NDArray[Any]
AnyModel = Oscillator | System
AnyLaw = ContactLaw | Mapping[str, ContactLaw]

# Largest resolution of the clock, as a share of the natural period.
_CLOCK_SHARE = 1e-9
_MOST_PERIODS = 2**53  # the largest whole number up to which floats are exact


def prepared(models: Models, solver: Solver) -> Integrate:
    """Return the integrator of some models; no result depends on the other rows of a call."""
    return loaded(solver.engine)(models, solver)


def loaded(engine: str) -> Callable[[Models, Solver], Integrate]:
    """Import an engine, which takes tenths of a second; return its function `prepared`."""
    if engine == "scipy":
        from gapsweep.integrate.reference import prepared
    else:
        from gapsweep.integrate.compiled import prepared
    return prepared


@called_as("gs.simulate(oscillator, law, omega=9.0, t_end=2.0), in Hz and s")
def simulate(
    oscillator: Several[AnyModel],
    law: Several[AnyLaw],
    omega: ArrayLike | None = None,
    x_0: ArrayLike = 0.0,
    v_0: ArrayLike = 0.0,
    *,
    t_end: float | None = None,
    n_periods: ArrayLike | None = None,
    q_0: ArrayLike = 0.0,
    z_0: ArrayLike = 0.0,
    t_0: float = 0.0,
    engine: str = DEFAULT_ENGINE,
    rtol: float | None = None,
    atol: float | None = None,
    controller: str = "native",
    restart: bool = False,
    contact_force: str = "by_mode",
    dense_output: bool = False,
    tangent: bool = False,
    time_limit: float = TIME_LIMIT,
) -> Trajectory:
    """Integrate the motion of an oscillator or a system; return its trajectory.

    Parameters
    ----------
    oscillator : Oscillator or System, or sequence of them
        The elements of a sequence must be oscillators, or systems with equal coordinates, contacts
        and numbers of first-order states.
    law : ContactLaw or mapping of str to ContactLaw, or sequence of them
        One law for all contacts, or one law per contact of a system, by name.
    omega : float or array_like
        Forcing frequency [Hz], ``> 0``; None for an unforced system, or under a `Record`.
    x_0 : float or array_like
        Displacement [m] of an oscillator at `t_0`. Sequences of models and laws, `omega`, initial
        states and `n_periods` are broadcast together, as NumPy arrays.
    v_0 : float or array_like
        Velocity [m/s] at `t_0`; for a system, velocities along the last axis.
    q_0, z_0 : float or array_like
        Coordinates [m] and first-order states of a system at `t_0`, along the last axis. The axis
        may be omitted if the system has one.
    t_end, t_0 : float
        End and start of the integration [s], ``t_end > t_0``.
    n_periods : int or array_like of int
        Forcing periods from `t_0` to the end, ``> 0``; instead of `t_end`. With ``t_0 = 0`` the
        end is the last point of `section`.
    engine, rtol, atol, controller, restart, contact_force
        As in `gapsweep.integrate.problem.Solver`. Default of `rtol` [-] is 1e-9 with engine
        ``"compiled"``, 1e-4 with ``"scipy"``; default of `atol` [m] is `rtol` times the static
        deflection, else the initial displacement, else the gap.
    dense_output : bool
        Whether to keep the history `t`, `x`, `v` and to enable ``sample(t)``.
    tangent : bool
        Whether to integrate the variational equations, for ``monodromy``; they also limit the
        steps of smooth laws. Kinks of the force that are not located (``located=False``, a user law
        with corners) add an error that does not depend on the tolerance, 1e-4 to 1e-2 of the
        matrix in measurements; ``contact_force="as_written"`` adds 1e-5 to 5e-2. `respond`
        computes multipliers with located contacts and forces by mode if possible.
    time_limit : float
        Time [s], ``> 0``, after which motions under way have the status ``timed_out``; compiling
        does not count. The engine ``"scipy"`` ends a motion before it looks at the time.

    Returns
    -------
    Trajectory
        Attributes are arrays if an argument is an array or a sequence. A system has a
        `SystemTrajectory`.

    Raises
    ------
    ModelError
        If an argument is out of range, shapes differ, or both or none of `t_end` and `n_periods`
        are given. A numerical failure is a `status`, not an error.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> run = gs.simulate(gs.systems.paper_oscillator(), law, omega=9.0, t_end=2.0)
    >>> run.status.label, run.n_contacts > 0
    ('ok', True)
    >>> laws = [gs.Piecewise(K_c, gs.Gap(0.4e-3, 0.4e-3)) for K_c in (1.4e3, 1.4e4, 1.4e5)]
    >>> runs = gs.simulate(gs.systems.paper_oscillator(), laws, omega=9.0, n_periods=100)
    >>> runs.x_end.shape
    (3,)
    """
    solver = Solver.of(engine, rtol, atol, controller, restart, contact_force)
    t_0, time_limit = checked("t_0", t_0), checked("time_limit", time_limit, low=0.0, strict=True)
    span: dict[str, Any] = {"t_end": t_end}
    if n_periods is not None:
        span = {"n_periods": _whole_periods(n_periods)}
    if (t_end is None) == (n_periods is None):
        given = "missing" if t_end is None else f"{t_end!r}, and n_periods = {n_periods!r}"
        raise ModelError(f"t_end = {given}: give either, as t_end=10.0 or n_periods=100")
    models, start, shape = cases(
        oscillator, law, omega, x_0, v_0, q_0, z_0, np.shape(span.get("n_periods", 0))
    )
    warn_of(doubts(objects(oscillator).ravel().tolist(), models.laws, models.omega, start))
    if t_end is not None:
        span["t_end"] = t_end = checked("t_end", t_end)
        if t_end <= t_0:
            raise ModelError(f"t_end = {t_end:g} s: must be > t_0 = {t_0:g} s")
        ends = np.full(len(models), t_end)
    elif not models.omega.all():
        raise ModelError(f"n_periods = {n_periods!r}: this System is not forced; give t_end [s]")
    else:
        periods = np.broadcast_to(span["n_periods"], shape).ravel()
        ends = (t_0 * models.omega + periods) / models.omega
    _check_clock(models, t_0)
    if dense_output:  # nothing runs yet, but invalid settings are refused now
        for _, some in models.by_kind():
            prepared(some, solver)
    solve = partial(_solved, models, solver, start, t_0, ends, tangent, dense_output, time_limit)
    inputs = {
        **inputs_of(oscillator, law, models, start, shape),
        **span,
        "t_0": t_0,
        **{name: getattr(solver, name) for name in Solver.__slots__},
        **{"dense_output": dense_output, "tangent": tangent},
    }
    kind = SystemTrajectory if "q_0" in inputs else Trajectory
    return kind(inputs, _laws_of(models, shape), models.absolute(solver).reshape(shape)[()], solve)


def motion_of(models: Models, solver: Solver, state: Array, n_periods: int) -> Trajectory:
    """Return the motion of one parameter set over whole forcing periods, with dense output.

    Raises `ModelError` if the engine cannot integrate the model.

    Parameters
    ----------
    models : Models
        One row.
    state : ndarray, shape (n_states,)
        Displacements [m], velocities [m/s] and first-order states at time zero.
    n_periods : int
        ``> 0``.
    """
    (system,), (laws,) = models.systems, models.laws
    n = system.n
    start = dict(zip(("x_0", "v_0"), state.tolist(), strict=False))
    law: Any = laws[0]
    if isinstance(system, System):
        start = {"q_0": state[:n], "v_0": state[n : 2 * n]}
        start |= {"z_0": state[2 * n :]} if system.n_lags else {}
        law = dict(zip(system.contacts, laws, strict=True))
    options = {"n_periods": n_periods, "dense_output": True, **asdict(solver)}
    return simulate(system, law, float(models.omega[0]), **start, **options)


def _solved(
    models: Models,
    solver: Solver,
    start: Array,
    t_0: float,
    t_end: Array,
    tangent: bool,
    sampled: bool,
    time_limit: float,
    record_from: float,
    dense_output: bool,
) -> Motions:
    """Integrate all motions once; events and dense output are recorded from a time [s] on."""
    groups = models.by_kind()
    with within(time_limit):
        parts = [
            prepared(some, solver)(
                Problems(
                    which=np.arange(len(rows)),
                    start=start[rows],
                    t_0=np.full(len(rows), t_0),
                    t_end=t_end[rows],
                    record_from=np.full(len(rows), record_from),
                    dense_output=dense_output,
                    sampled=sampled,
                    section_only=dense_output,
                    tangent=tangent,
                    contacts=math.isfinite(record_from) and not dense_output,
                )
            )
            for rows, some in groups
        ]
    return merged(parts, [rows for rows, _ in groups])


def _whole_periods(n_periods: ArrayLike) -> Any:
    """Return `n_periods` as an int or an array of int; refuse values that are not whole or < 1."""
    (given,) = broadcast(n_periods=n_periods)
    is_whole = (given == np.rint(given)) & (given >= 1.0) & (given <= _MOST_PERIODS)
    for wrong in given[~is_whole].flat:
        raise ModelError(f"n_periods = {wrong:g}: must be a whole number > 0, as n_periods=100")
    return given.astype(np.int64)[()]


def cases(
    oscillator: Several[AnyModel],
    law: Several[AnyLaw],
    omega: ArrayLike | None,
    x_0: ArrayLike,
    v_0: ArrayLike,
    q_0: ArrayLike,
    z_0: ArrayLike,
    *shapes: tuple[int, ...],
) -> tuple[Models, Array, tuple[int, ...]]:
    """Return the parameter sets of a call, and their initial states.

    Raises `ModelError` if an argument is out of range, or does not apply to the model.

    Parameters
    ----------
    oscillator, law, omega, x_0, v_0, q_0, z_0
        As in `simulate`.
    *shapes : tuple of int
        Shapes of further arguments.

    Returns
    -------
    models : Models
        n parameter sets; `omega` is zero for unforced systems.
    start : ndarray, shape (n, n_states)
        Displacements [m], velocities [m/s] and first-order states.
    shape : tuple of int
        Common shape of all arguments.
    """
    systems, given = _several("oscillator", oscillator), _several("law", law)
    first = _alike(systems)
    if isinstance(first, System):
        _zero("x_0", x_0, "a System starts from q_0, v_0 and z_0")
        frequency, start = _system_starts(first, omega, q_0, v_0, z_0)
        laws = [_laws(first, each) for each in given.flat]
    else:
        for name, value in (("q_0", q_0), ("z_0", z_0)):
            _zero(name, value, "an Oscillator starts from x_0 and v_0")
        if omega is None and first.is_forced:
            raise ModelError(
                "omega: missing; write omega = 9.0, in Hz; a machine without forcing is a gs.System"
            )
        if omega is not None and not first.is_forced:
            raise ModelError(
                "omega: a gapsweep.Record has no frequency; leave omega out of gs.simulate"
            )
        given_omega = {} if omega is None else {"omega": omega}
        *several, x_0, v_0 = broadcast(**given_omega, x_0=x_0, v_0=v_0)
        frequency = several[0] if several else np.zeros(x_0.shape)
        start = np.stack([x_0, v_0], axis=-1)
        laws = [(checked_law(each),) for each in given.flat]
    shape = frequency.shape
    if any((systems.shape, given.shape, *shapes)):
        try:
            shape = np.broadcast_shapes(shape, systems.shape, given.shape, *shapes)
        except ValueError as error:
            raise ModelError(
                f"oscillator, law, omega, initial states, n_periods: {error}"
            ) from None
        frequency = np.broadcast_to(frequency, shape)
        start = np.broadcast_to(start, (*shape, start.shape[-1]))
    rows = _rows(list(systems.flat), systems, shape), _rows(laws, given, shape)
    start = start.reshape(frequency.size, -1)
    return Models.of(*rows, frequency.ravel(), start), start, shape


def inputs_of(
    oscillator: Several[AnyModel],
    law: Several[AnyLaw],
    models: Models,
    start: Array,
    shape: tuple[int, ...],
) -> dict[str, Any]:
    """Return the arguments of a call by name, in the common shape that `cases` returned."""
    inputs: dict[str, Any] = {"oscillator": oscillator, "law": law}
    start = start.reshape(*shape, start.shape[-1])
    first = objects(oscillator).flat[0]
    if isinstance(first, System):
        n, is_forced = first.n, first.is_forced
        states = {"q_0": start[..., :n], "v_0": start[..., n : 2 * n], "z_0": start[..., 2 * n :]}
    else:
        is_forced, states = first.is_forced, {"x_0": start[..., 0], "v_0": start[..., 1]}
    inputs["omega"] = np.array(models.omega.reshape(shape))[()] if is_forced else None
    return inputs | {name: np.array(each)[()] for name, each in states.items() if each.size}


def _laws_of(models: Models, shape: tuple[int, ...]) -> Any:
    """Return the laws of all contacts as a tuple; for several sets of laws an array of tuples."""
    if len(models.laws) == 1:
        return models.laws[0]
    found = np.empty(len(models), object)
    for i, law in enumerate(models.law.tolist()):
        found[i] = models.laws[law]
    return found.reshape(shape)


def _several(name: str, value: Any) -> NDArray[Any]:
    """Return one object or a sequence of objects as an array; refuse an empty sequence."""
    try:
        found = objects(value)
    except ValueError as error:
        raise ModelError(f"{name}: {error}") from None
    if not found.size:
        raise ModelError(f"{name} = {value!r}: must be one object or a sequence, not empty")
    return found


def _alike(systems: NDArray[Any]) -> Any:
    """Return the first of several models; refuse models of different kinds or names."""
    for each in systems.flat:
        if not isinstance(each, Oscillator | System):
            raise ModelError(
                f"oscillator = {each!r}: must be a gapsweep.Oscillator(...) or a gapsweep.System()"
            )
    first, *others = systems.flat
    for each in others:
        if _names(each) != _names(first):
            raise ModelError(
                f"oscillator: {_names(first)} and {_names(each)}: must be oscillators, or systems "
                "with equal coordinates, contacts and numbers of first-order states"
            )
    return first


def _names(model: AnyModel) -> tuple[Any, ...]:
    """Return kind, names, number of lags and forcing: equal for all models of a call."""
    form = type(model).__name__, *model.coordinates, *model.contacts
    return *form, model.n_lags, "forced" if model.is_forced else "not forced"


def _rows(values: list[T], of: NDArray[Any], shape: tuple[int, ...]) -> list[T]:
    """Broadcast values, in the shape of `of`, to a list for all points; a single one stays."""
    if len(values) == 1:
        return values
    places = np.broadcast_to(np.arange(len(values)).reshape(of.shape), shape)
    return [values[i] for i in places.flat]


def _zero(name: str, value: ArrayLike, remedy: str) -> None:
    """Refuse an initial state that a model of this kind does not have, unless it is zero."""
    if type(value) is float and value == 0.0:  # the default
        return
    (given,) = broadcast(**{name: value})
    if given.any():
        raise ModelError(f"{name} = {value!r}: {remedy}")


def _laws(system: System, law: AnyLaw) -> tuple[ContactLaw, ...]:
    """Return the law of every contact, in the system's order."""
    if not isinstance(law, Mapping):
        return (checked_law(law),) * len(system.contacts)
    if set(law) != set(system.contacts):
        raise ModelError(f"law: of {list(law)}: must name {list(system.contacts)}")
    return tuple(checked_law(law[name]) for name in system.contacts)


def _system_starts(
    system: System, omega: ArrayLike | None, q_0: ArrayLike, v_0: ArrayLike, z_0: ArrayLike
) -> tuple[Array, Array]:
    """Return forcing frequencies, zero if unforced, and initial states along the last axis."""
    if (omega is None) == system.is_forced:
        why = "missing; this System is forced" if system.is_forced else "this System is not forced"
        raise ModelError(f"omega: {why}")
    sizes = {"q_0": (q_0, system.n), "v_0": (v_0, system.n), "z_0": (z_0, system.n_lags)}
    parts = []
    for name, (value, size) in sizes.items():
        if not size:  # a System without lags
            if np.asarray(value, dtype=object).size:
                _zero(name, value, "this System has no first-order states")
            parts.append(np.zeros(0))
            continue
        (given,) = broadcast(**{name: value})
        if size == 1 and given.shape[-1:] != (1,):  # responses of one coordinate have no such axis
            given = given[..., None]
        if given.ndim and given.shape[-1] != size:
            raise ModelError(
                f"{name}: has the shape {given.shape}; its last axis must have length {size}"
            )
        parts.append(given if given.ndim else np.full(size, given))
    (frequency,) = [np.zeros(())] if omega is None else broadcast(omega=omega)
    try:
        shape = np.broadcast_shapes(frequency.shape, *(part.shape[:-1] for part in parts))
    except ValueError as error:
        raise ModelError(f"omega, q_0, v_0, z_0: {error}") from None
    states = [np.broadcast_to(part, (*shape, part.shape[-1])) for part in parts]
    return np.broadcast_to(frequency, shape), np.concatenate(states, axis=-1)


def _check_clock(models: Models, t_0: float) -> None:
    """Refuse an initial forcing phase whose rounding error is not small against time steps.

    Time is kept as whole forcing periods and a fraction, so a nonzero initial fraction limits
    the resolution of the clock.
    """
    omega = models.omega
    if not t_0 or not omega.all():
        return
    turns = omega * t_0
    resolved = np.spacing(turns - np.floor(turns)) / omega
    # If only contacts hold the masses, there is no limit.
    coarse = resolved * models.of_systems(attrgetter("fastest")) > _CLOCK_SHARE
    for k in np.flatnonzero(coarse)[:1].tolist():
        fastest = models.systems[models.system[k]].fastest
        raise ModelError(
            f"t_0 = {t_0:g} s: at omega = {omega[k]:g} Hz the phase resolves times of "
            f"{resolved[k]:.2g} s, must be <= {_CLOCK_SHARE / fastest:.2g} s; start at t_0 = 0"
        )


def broadcast(**values: ArrayLike | None) -> list[NDArray[np.float64]]:
    """Return the values as finite float arrays of one shape; `omega` must be positive.

    Raises `ModelError` if a value is out of range, or the shapes do not fit.
    """
    arrays = []
    for name, value in values.items():
        array = numbers(name, value, "a number or numbers")
        if array.size == 0:
            raise ModelError(f"{name} = {value!r}: must be a number or numbers, at least one")
        # `checked` raises the error for the first wrong value.
        is_omega = name == "omega"
        is_good = (np.abs(array) <= LARGEST) & (array >= (SMALLEST if is_omega else -LARGEST))
        for suspect in array[~is_good].flat:
            checked(name, suspect, low=0.0 if is_omega else -math.inf, strict=is_omega)
        arrays.append(array)
    try:
        return list(np.broadcast_arrays(*arrays))
    except ValueError:
        shapes = ", ".join(
            f"{name} {each.shape}" for name, each in zip(values, arrays, strict=True)
        )
        raise ModelError(
            f"shapes {shapes}: must broadcast as in NumPy; for every pair of frequency and initial "
            "state write omega[:, None]"
        ) from None
