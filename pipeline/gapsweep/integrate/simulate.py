"""One call for every engine, for one point or many."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from gapsweep.errors import ModelError
from gapsweep.integrate import reference
from gapsweep.integrate.trajectory import Trajectories, Trajectory
from gapsweep.model.contact import ContactLaw
from gapsweep.model.oscillator import Oscillator, checked

ENGINES: dict[str, Callable[..., Trajectory]] = {"scipy": reference.integrate}
DEFAULT_ENGINE = "scipy"
DEFAULT_TOLERANCES = {"scipy": (reference.RTOL, reference.ATOL)}

# Tighter than this the reference methods only add rounding.
SMALLEST_RTOL = 1e-13


def tolerances(engine: str, rtol: float | None, atol: float | None) -> tuple[float, float]:
    """Checked tolerances, the engine's defaults where None.

    Raises
    ------
    ModelError
        If the engine is unknown or a tolerance out of range.
    """
    if engine not in ENGINES:
        raise ModelError(f"engine = {engine!r}: must be one of {', '.join(ENGINES)}")
    default_rtol, default_atol = DEFAULT_TOLERANCES[engine]
    rtol = checked("rtol", default_rtol if rtol is None else rtol, low=SMALLEST_RTOL)
    atol = checked("atol", default_atol if atol is None else atol, low=0.0, strict=True)
    if rtol > 0.1:
        raise ModelError(f"rtol = {rtol:g}: must be <= 0.1")
    return rtol, atol


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
    engine : str
        ``"scipy"``, the reference.
    rtol, atol : float, optional
        Relative [-] and absolute [m, m/s] tolerance; None takes the engine's default.
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
    rtol, atol = tolerances(engine, rtol, atol)
    t_0, t_end = checked("t_0", t_0), checked("t_end", t_end)
    if t_end <= t_0:
        raise ModelError(f"t_end = {t_end:g} s: must be > t_0 = {t_0:g} s")
    try:
        points = np.broadcast(
            np.asarray(omega, dtype=float), np.asarray(x_0, dtype=float), np.asarray(v_0, float)
        )
    except ValueError as error:
        raise ModelError(f"omega, x_0, v_0: {error}") from None
    runs = [
        ENGINES[engine](
            oscillator,
            law,
            checked("omega", w, low=0.0, strict=True),
            (checked("x_0", x), checked("v_0", v)),
            (t_0, t_end),
            rtol=rtol,
            atol=atol,
            record=record,
            dense_output=dense_output,
        )
        for w, x, v in points
    ]
    return Trajectories(runs, points.shape) if points.shape else runs[0]
