"""One call for every engine, for one motion or many."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError
from gapsweep.integrate import compiled, reference
from gapsweep.integrate.motion import Motions
from gapsweep.integrate.problem import DEFAULT_ENGINE, Integrate, Models, Problems, Solver
from gapsweep.integrate.trajectory import Trajectory
from gapsweep.model.contact import ContactLaw
from gapsweep.model.oscillator import LARGEST, SMALLEST, Oscillator, checked

# Largest resolution of the clock, as a share of the natural period.
_CLOCK_SHARE = 1e-9
_ENGINES = {"compiled": compiled.prepared, "scipy": reference.prepared}


def prepared(models: Models, solver: Solver) -> Integrate:
    """Integration of models, each as if it were alone: the same numbers in any company."""
    return _ENGINES[solver.engine](models, solver)


def simulate(
    oscillator: Oscillator,
    law: ContactLaw,
    omega: ArrayLike,
    x_0: ArrayLike = 0.0,
    v_0: ArrayLike = 0.0,
    *,
    t_end: float,
    t_0: float = 0.0,
    engine: str = DEFAULT_ENGINE,
    rtol: float | None = None,
    atol: float | None = None,
    controller: str = "native",
    restart: bool = False,
    dense_output: bool = False,
    tangent: bool = False,
) -> Trajectory:
    """Simulate the oscillator from given initial states.

    Parameters
    ----------
    oscillator : Oscillator
    law : ContactLaw
    omega : float or array_like
        Forcing frequency [Hz], ``> 0``.
    x_0, v_0 : float or array_like
        Displacement [m] and velocity [m/s] at `t_0`; broadcast against `omega`.
    t_end, t_0 : float
        End and start [s], ``t_end > t_0``.
    engine, rtol, atol, controller, restart
        As in `gapsweep.integrate.problem.Solver`; tolerances that are None take the engine's
        defaults: compiled 1e-9 and 1e-12, scipy 1e-4 and 1e-7.
    dense_output : bool
        Whether ``sample(t)`` may be asked for.
    tangent : bool
        Whether to integrate the variational equations along, for ``monodromy``.

    Returns
    -------
    Trajectory
        Its attributes are arrays if any of `omega`, `x_0`, `v_0` is one.

    Raises
    ------
    ModelError
        If an argument is out of range. A numerical failure is no error but a `status`.
    """
    solver = Solver.of(engine, rtol, atol, controller, restart)
    t_0, t_end = checked("t_0", t_0), checked("t_end", t_end)
    if t_end <= t_0:
        raise ModelError(f"t_end = {t_end:g} s: must be > t_0 = {t_0:g} s")
    omega, x_0, v_0 = broadcast(omega=omega, x_0=x_0, v_0=v_0)
    models = Models(
        oscillators=[oscillator] * omega.size, laws=[law] * omega.size, omega=omega.ravel()
    )
    _check_clock(oscillator, omega, t_0)
    n = omega.size
    integrate = prepared(models, solver)

    def solve(record_from: float, dense_output: bool) -> Motions:
        return integrate(
            Problems(
                which=np.arange(n),
                x_0=x_0.ravel(),
                v_0=v_0.ravel(),
                t_0=np.full(n, t_0),
                t_end=np.full(n, t_end),
                record_from=np.full(n, record_from),
                dense_output=dense_output,
                tangent=tangent,
                contacts=math.isfinite(record_from) and not dense_output,
            )
        )

    return Trajectory(solve, t_0, omega.shape, dense_output)


def _check_clock(oscillator: Oscillator, omega: NDArray[np.float64], t_0: float) -> None:
    """Refuse a start at a forcing phase beside which a step of the motion is rounded away.

    Time is kept as whole forcing periods and a fraction, so a fraction to begin with limits what
    the clock can tell apart.
    """
    turns = omega.ravel() * t_0
    resolved = np.spacing(turns - np.floor(turns)) / omega.ravel()
    largest = _CLOCK_SHARE / oscillator.omega_n
    coarse = resolved > largest
    if coarse.any():
        raise ModelError(
            f"t_0 = {t_0:g} s: at omega = {omega.ravel()[coarse][0]:g} Hz its phase leaves a clock "
            f"of {resolved[coarse][0]:.2g} s, must be <= {largest:.2g} s; start at t_0 = 0"
        )


def broadcast(**values: ArrayLike) -> list[NDArray[np.float64]]:
    """Finite float arrays of one shape; `omega` positive.

    Raises
    ------
    ModelError
        If a value is out of range, or the shapes do not fit.
    """
    arrays = []
    for name, value in values.items():
        try:
            array = np.asarray([] if value is None else value, dtype=float)
        except (TypeError, ValueError):
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
