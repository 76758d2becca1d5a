"""Absolute displacements of oscillators on a moving base: trough and peak of a steady motion."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import ModelError
from gapsweep.integrate.problem import Models, Solver
from gapsweep.integrate.simulate import motion_of
from gapsweep.integrate.trajectory import Trajectory
from gapsweep.model.oscillator import Oscillator
from gapsweep.response.result import Response
from gapsweep.variables import objects

Array = NDArray[np.float64]
_SAMPLES = 512  # a forcing period
N_PERIODS = 64  # of a motion without a period


def absolute_range(response: Response) -> tuple[Any, Any]:
    """Return trough and peak of the absolute displacement of an oscillator on a moving base.

    Displacements of a response are relative to the base. Every response is simulated once more from
    its section, over its period or 64 forcing periods.

    Parameters
    ----------
    response : Response
        Result of `gapsweep.respond`, one or an array of them.

    Returns
    -------
    low, high : float or ndarray
        [m], in the shape of the responses; NaN for a failure.

    Raises
    ------
    ModelError
        If the model is a system.

    Examples
    --------
    >>> import gapsweep as gs
    >>> machine = gs.Oscillator(
    ...     mass=3.0, omega_n=5.0, zeta=0.03, forcing=0.0, base_amplitude=1e-4
    ... )
    >>> law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> low, high = gs.absolute_range(gs.respond(machine, law, omega=40.0))
    >>> bool(high < 1e-5)  # far above resonance the mass stands still
    True
    """
    inputs, shape = response.inputs, np.shape(response.status)
    columns = [objects(inputs["oscillator"]), objects(inputs["law"]), inputs["omega"]]
    models, laws, omega = (np.broadcast_to(each, shape) for each in columns)
    multiple = np.asarray(response.period_multiple)
    if not all(isinstance(model, Oscillator) for model in models.flat):
        raise ModelError(
            "absolute_range: a System does not hold its base; add gs.BaseMotion.at(omega, t)"
        )
    solver = Solver.of(inputs["engine"], inputs["rtol"], inputs["atol"])
    found = np.full((2, *shape), np.nan)
    for at in np.ndindex(shape):
        section = np.asarray(response.section[at] if shape else response.section)
        if section.size:
            model: Any = models[at]
            law: Any = laws[at]
            one = Models.of([model], [(law,)], np.array([omega[at]]))
            run = motion_of(one, solver, section[:2], int(multiple[at]) or N_PERIODS)
            found[:, *at] = extremes(run, model.base_amplitude)
    return found[0][()], found[1][()]


def extremes(run: Trajectory, base_amplitude: float) -> tuple[float, float]:
    """Return trough and peak of the absolute displacement of an oscillator in a motion [m].

    Parabolas through three of 512 samples a forcing period interpolate both.
    """
    turns = float(run.inputs["omega"] * run.t_end)
    t = np.linspace(0.0, float(run.t_end), round(_SAMPLES * turns) + 1)
    x = np.ravel(run.sample(t)[0])
    x += base_amplitude * np.cos(2.0 * np.pi * run.inputs["omega"] * t)
    return -_peak(-x), _peak(x)


def _peak(x: Array) -> float:
    """Largest value of a smooth function from its samples, the last of which is the first."""
    before, here, after = np.roll(x[:-1], 1), x[:-1], x[1:]
    k = int(here.argmax())
    slope, bend = 0.5 * (after[k] - before[k]), 2.0 * here[k] - after[k] - before[k]
    return float(here[k] + (0.5 * slope**2 / bend if bend > 0.0 else 0.0))
