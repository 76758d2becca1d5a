"""One call for every engine, for one motion or many."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from gapsweep.errors import ModelError
from gapsweep.integrate import reference
from gapsweep.integrate.problem import DEFAULT_ENGINE, Problem, Solver
from gapsweep.integrate.trajectory import Trajectories, Trajectory
from gapsweep.model.contact import ContactLaw
from gapsweep.model.oscillator import Oscillator, checked


def integrate(problems: Sequence[Problem], solver: Solver) -> list[Trajectory]:
    """Integrate motions, each as if it were alone: the same numbers in any company."""
    return [reference.integrate(problem, solver.rtol, solver.atol) for problem in problems]


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
    record: bool = True,
    dense_output: bool = False,
) -> Trajectory | Trajectories:
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
    record : bool
        Whether to keep extrema, contact times and section.
    dense_output : bool
        Whether to keep the motion for ``sample(t)``.

    Returns
    -------
    Trajectory, or Trajectories if any of `omega`, `x_0`, `v_0` is an array.

    Raises
    ------
    ModelError
        If an argument is out of range. A numerical failure is no error but a `status`.
    """
    solver = Solver.of(engine, rtol, atol, controller, restart)
    t_0, t_end = checked("t_0", t_0), checked("t_end", t_end)
    if t_end <= t_0:
        raise ModelError(f"t_end = {t_end:g} s: must be > t_0 = {t_0:g} s")
    try:
        points = np.broadcast(*(np.asarray(values, dtype=float) for values in (omega, x_0, v_0)))
    except ValueError as error:
        raise ModelError(f"omega, x_0, v_0: {error}") from None
    problems = [
        Problem(
            oscillator=oscillator,
            law=law,
            omega=checked("omega", w, low=0.0, strict=True),
            x_0=checked("x_0", x),
            v_0=checked("v_0", v),
            t_0=t_0,
            t_end=t_end,
            record=record,
            dense_output=dense_output,
        )
        for w, x, v in points
    ]
    runs = integrate(problems, solver)
    return Trajectories(runs, points.shape) if points.shape else runs[0]
