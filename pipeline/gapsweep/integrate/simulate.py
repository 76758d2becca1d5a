"""One call for every engine, for one motion or many."""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError
from gapsweep.integrate.motion import Motions
from gapsweep.integrate.problem import DEFAULT_ENGINE, Integrate, Models, Problems, Solver
from gapsweep.integrate.trajectory import SystemTrajectory, Trajectory
from gapsweep.model.contact import ContactLaw, checked_law
from gapsweep.model.oscillator import LARGEST, SMALLEST, Oscillator, checked
from gapsweep.model.system import System, floats

Array = NDArray[np.float64]

# Largest resolution of the clock, as a share of the natural period.
_CLOCK_SHARE = 1e-9


def prepared(models: Models, solver: Solver) -> Integrate:
    """Integration of models, each as if it were alone: the same numbers in any company."""
    return loaded(solver.engine)(models, solver)


def loaded(engine: str) -> Callable[[Models, Solver], Integrate]:
    """The function `prepared` of an engine; to load one takes tenths of a second."""
    if engine == "scipy":
        from gapsweep.integrate.reference import prepared
    else:
        from gapsweep.integrate.compiled import prepared
    return prepared


def simulate(
    oscillator: Oscillator | System,
    law: ContactLaw | Mapping[str, ContactLaw],
    omega: ArrayLike | None = None,
    x_0: ArrayLike = 0.0,
    v_0: ArrayLike = 0.0,
    *,
    t_end: float,
    q_0: ArrayLike = 0.0,
    z_0: ArrayLike = 0.0,
    t_0: float = 0.0,
    engine: str = DEFAULT_ENGINE,
    rtol: float | None = None,
    atol: float | None = None,
    controller: str = "native",
    restart: bool = False,
    dense_output: bool = False,
    tangent: bool = False,
) -> Trajectory:
    """Simulate an oscillator or a system from given initial states.

    Parameters
    ----------
    oscillator : Oscillator or System
    law : ContactLaw or mapping of str to ContactLaw
        One law for all contacts, or that of each contact of a system, by its name.
    omega : float or array_like
        Forcing frequency [Hz], ``> 0``; None of a system that is not forced.
    x_0 : float or array_like
        Displacement [m] of an oscillator at `t_0`; broadcast against `omega`.
    v_0 : float or array_like
        Velocity [m/s], likewise; of a system, velocities along the last axis.
    q_0, z_0 : float or array_like
        Coordinates [m] and first-order states of a system, along the last axis, which may be left
        out if there is but one.
    t_end, t_0 : float
        End and start [s], ``t_end > t_0``.
    engine, rtol, atol, controller, restart
        As in `gapsweep.integrate.problem.Solver`; tolerances that are None take the engine's
        defaults: compiled 1e-9 and 1e-12, scipy 1e-4 and 1e-7.
    dense_output : bool
        Whether to keep the motion between steps, for its history `t`, `x`, `v` and ``sample(t)``.
    tangent : bool
        Whether to integrate the variational equations along, for ``monodromy``; steps of stand-ins
        are then cut for them, too. Where kinks of the force are not located (``located=False``, a
        law of your own with corners) every one that is passed adds an error that no tolerance
        bounds, 1e-4 to 1e-2 of the whole as measured; `respond` takes the located law's for
        multipliers where there is one.

    Returns
    -------
    Trajectory
        Its attributes are arrays if `omega` or a start is one. Of a system a `SystemTrajectory`.

    Raises
    ------
    ModelError
        If an argument is out of range. A numerical failure is no error but a `status`.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> run = gs.simulate(gs.Oscillator(), law, omega=9.0, t_end=2.0)
    >>> run.status.label, run.n_contacts > 0
    ('ok', True)
    """
    solver = Solver.of(engine, rtol, atol, controller, restart)
    t_0, t_end = checked("t_0", t_0), checked("t_end", t_end)
    if t_end <= t_0:
        raise ModelError(f"t_end = {t_end:g} s: must be > t_0 = {t_0:g} s")
    frequency, start, laws = starts(oscillator, law, omega, x_0, v_0, q_0, z_0)
    n = frequency.size
    models = Models.of([oscillator] * n, [laws] * n, frequency.ravel())
    _check_clock(oscillator, frequency, t_0)
    problems = Problems(
        which=np.arange(n),
        start=start.reshape(n, -1),
        t_0=np.full(n, t_0),
        t_end=np.full(n, t_end),
        record_from=np.full(n, math.inf),
        tangent=tangent,
    )
    if dense_output:  # nothing runs yet, but what no engine takes is refused now
        prepared(models, solver)
    solve = partial(_solved, models, solver, problems)
    inputs = {
        **inputs_of(oscillator, law, frequency, start),
        **{"t_end": t_end, "t_0": t_0},
        **asdict(solver),
        **{"dense_output": dense_output, "tangent": tangent},
    }
    kind = SystemTrajectory if isinstance(oscillator, System) else Trajectory
    return kind(inputs, laws, solve, frequency.shape)


def _solved(
    models: Models, solver: Solver, problems: Problems, record_from: float, dense_output: bool
) -> Motions:
    """One pass over the problems, recorded from a time [s] on."""
    return prepared(models, solver)(
        replace(
            problems,
            record_from=np.full(len(problems), record_from),
            dense_output=dense_output,
            section_only=dense_output,
            contacts=math.isfinite(record_from) and not dense_output,
        )
    )


def starts(
    oscillator: Oscillator | System,
    law: ContactLaw | Mapping[str, ContactLaw],
    omega: ArrayLike | None,
    x_0: ArrayLike,
    v_0: ArrayLike,
    q_0: ArrayLike,
    z_0: ArrayLike,
) -> tuple[Array, Array, Any]:
    """Forcing frequencies, the states to start from, and the laws of all contacts.

    Parameters
    ----------
    oscillator, law, omega, x_0, v_0, q_0, z_0
        As in `simulate`.

    Returns
    -------
    omega : ndarray
        In the shape that all have together [Hz]; zero where nothing is forced.
    start : ndarray, shape (..., n_states)
        Displacements [m], velocities [m/s] and first-order states.
    laws : tuple of ContactLaw

    Raises
    ------
    ModelError
        If an argument is out of range, or not one of such a model.
    """
    if isinstance(oscillator, System):
        _zero("x_0", x_0, "a System starts from q_0, v_0 and z_0")
        return *_system_starts(oscillator, omega, q_0, v_0, z_0), _laws(oscillator, law)
    contact_law: Any = law
    for name, value in (("q_0", q_0), ("z_0", z_0)):
        _zero(name, value, "an Oscillator starts from x_0 and v_0")
    frequency, x_0, v_0 = broadcast(omega=omega, x_0=x_0, v_0=v_0)
    return frequency, np.stack([x_0, v_0], axis=-1), (checked_law(contact_law),)


def inputs_of(
    oscillator: Oscillator | System,
    law: ContactLaw | Mapping[str, ContactLaw],
    omega: Array,
    start: Array,
) -> dict[str, Any]:
    """Arguments of a call by name, from what `starts` made of them."""
    inputs: dict[str, Any] = {"oscillator": oscillator, "law": law}
    if isinstance(oscillator, System):
        n, is_forced = oscillator.n, oscillator.is_forced
        states = {"q_0": start[..., :n], "v_0": start[..., n : 2 * n], "z_0": start[..., 2 * n :]}
    else:
        is_forced, states = True, {"x_0": start[..., 0], "v_0": start[..., 1]}
    inputs["omega"] = np.array(omega)[()] if is_forced else None
    return inputs | {name: np.array(each)[()] for name, each in states.items() if each.size}


def _zero(name: str, value: ArrayLike, remedy: str) -> None:
    """Refuse a start that a model of this kind does not have."""
    if type(value) is float and value == 0.0:  # as it stands when it is not given
        return
    (given,) = broadcast(**{name: value})
    if given.any():
        raise ModelError(f"{name} = {value!r}: {remedy}")


def _laws(system: System, law: ContactLaw | Mapping[str, ContactLaw]) -> tuple[ContactLaw, ...]:
    """The law of every contact, in the system's order."""
    if not isinstance(law, Mapping):
        return (checked_law(law),) * len(system.contacts)
    if set(law) != set(system.contacts):
        raise ModelError(f"law: of {list(law)}: must name {list(system.contacts)}")
    return tuple(law[name] for name in system.contacts)


def _system_starts(
    system: System, omega: ArrayLike | None, q_0: ArrayLike, v_0: ArrayLike, z_0: ArrayLike
) -> tuple[Array, Array]:
    """Forcing frequencies, zero where nothing is forced, and states along the last axis."""
    if (omega is None) == system.is_forced:
        said = "missing; this System is forced" if system.is_forced else "this System is not forced"
        raise ModelError(f"omega: {said}")
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
            raise ModelError(f"{name}: has the shape {given.shape}, its last axis must be {size}")
        parts.append(given if given.ndim else np.full(size, given))
    (frequency,) = [np.zeros(())] if omega is None else broadcast(omega=omega)
    try:
        shape = np.broadcast_shapes(frequency.shape, *(part.shape[:-1] for part in parts))
    except ValueError as error:
        raise ModelError(f"omega, q_0, v_0, z_0: {error}") from None
    states = [np.broadcast_to(part, (*shape, part.shape[-1])) for part in parts]
    return np.broadcast_to(frequency, shape), np.concatenate(states, axis=-1)


def _check_clock(system: Oscillator | System, omega: NDArray[np.float64], t_0: float) -> None:
    """Refuse a start at a forcing phase beside which a step of the motion is rounded away.

    Time is kept as whole forcing periods and a fraction, so a fraction to begin with limits what
    the clock can tell apart.
    """
    if not t_0 or not omega.all():
        return
    turns = omega.ravel() * t_0
    resolved = np.spacing(turns - np.floor(turns)) / omega.ravel()
    fastest = system.fastest
    if not fastest:  # nothing but contacts holds it
        return
    largest = _CLOCK_SHARE / fastest
    coarse = resolved > largest
    if coarse.any():
        raise ModelError(
            f"t_0 = {t_0:g} s: at omega = {omega.ravel()[coarse][0]:g} Hz its phase leaves a clock "
            f"of {resolved[coarse][0]:.2g} s, must be <= {largest:.2g} s; start at t_0 = 0"
        )


def broadcast(**values: ArrayLike | None) -> list[NDArray[np.float64]]:
    """Finite float arrays of one shape; `omega` positive.

    Raises
    ------
    ModelError
        If a value is out of range, or the shapes do not fit.
    """
    arrays = []
    for name, value in values.items():
        try:
            array = floats([] if value is None else value)
        except (TypeError, ValueError, OverflowError):
            raise ModelError(f"{name} = {value!r}: must be a number or numbers") from None
        if array.size == 0:
            raise ModelError(f"{name} = {value!r}: must be a number or numbers, at least one")
        # The first value that fails names itself.
        is_omega = name == "omega"
        is_good = (np.abs(array) <= LARGEST) & (array >= (SMALLEST if is_omega else -LARGEST))
        for suspect in array[~is_good].flat:
            checked(name, suspect, low=0.0 if is_omega else -math.inf, strict=is_omega)
        arrays.append(array)
    try:
        return list(np.broadcast_arrays(*arrays))
    except ValueError as error:
        raise ModelError(f"omega, x_0, v_0: {error}") from None
