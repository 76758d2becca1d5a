"""What a grid is too coarse for: band ends by bisection, basins from hundreds of starts.

Both are asked for where the paper says "slightly", or where what is found depends on which
attractors there are. They are answered directly: a grid this fine would have all
other scenes on it too.
"""

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.stats import qmc

from gapsweep.model.labels import contact_law
from gapsweep.model.oscillator import Gap
from gapsweep.response.respond import respond_all
from gapsweep.response.result import Response
from gapsweep.response.scene import Scene
from gapsweep.study.study import Study

from .scenes import EXACT, HARD_ASYMMETRIC, NO_EVENTS, SOFT_SYMMETRIC, WEAK

Floats = NDArray[np.float64]

FINEST = 1e-3  # Hz; what "slightly" must be more than
_PEAK = (7.0, 16.0)  # Hz, where the primary resonance of the soft contact is
_SUBHARMONIC = (12.0, 30.0)
N_STARTS = 400
_BOX = ((-2e-3, -0.05), (2e-3, 0.05))  # x [m], v [m/s], as in the study
BASINS = {
    SOFT_SYMMETRIC: ((17.0, 19.0, 21.0), (EXACT, *WEAK)),
    HARD_ASYMMETRIC: ((11.0, 21.75), (EXACT, NO_EVENTS, "tanh-1e6", "tanh-1e9")),
}


def bands(study: Study) -> xr.Dataset:
    """Where the primary peak from rest and the period-3 band end, soft symmetric contact.

    Parameters
    ----------
    study : Study
        Its oscillator, solver and fit range are used.

    Returns
    -------
    Dataset
        Over ``representation``: ``peak_frequency``, ``period_3_low``, ``period_3_high`` [Hz], each
        within `FINEST`; NaN where there is none.
    """
    labels = (EXACT, *WEAK)
    found = np.array([(_peak(study, label), *_period_3(study, label)) for label in labels])
    names = {
        "peak_frequency": "frequency up to which the response from rest is on the upper branch",
        "period_3_low": "lowest frequency of the period-3 attractor",
        "period_3_high": "highest frequency of the period-3 attractor",
    }
    return xr.Dataset(
        {
            name: ("representation", found[:, i], {"units": "Hz", "long_name": says})
            for i, (name, says) in enumerate(names.items())
        },
        {"representation": list(labels)},
    )


def basins(study: Study) -> xr.Dataset:
    """Periods of the steady responses from `N_STARTS` starts where basins decide.

    Returns
    -------
    Dataset
        ``period_multiple`` (0: not periodic) over ``case`` and ``start``, with ``representation``,
        ``K_c``, ``gap`` and ``omega`` of each case.
    """
    starts = qmc.scale(qmc.Sobol(2, rng=1).random(512)[:N_STARTS], *_BOX)
    cases = [
        (label, *scene, omega)
        for scene, (frequencies, labels) in BASINS.items()
        for label in labels
        for omega in frequencies
    ]
    found = [_responses(study, law, (K_c, gap), f, *starts.T) for law, K_c, gap, f in cases]
    names = ("representation", "K_c", "gap", "omega")
    return xr.Dataset(
        {
            "period_multiple": (
                ("case", "start"),
                np.array([[r.period_multiple for r in case] for case in found], dtype="i4"),
                {"units": "1", "long_name": "n of a period-n response, 0: none"},
            ),
        },
        {
            name: ("case", list(values))
            for name, values in zip(names, zip(*cases, strict=True), strict=True)
        },
    )


def _responses(
    study: Study,
    label: str,
    scene: tuple[float, str],
    omega: ArrayLike,
    x_0: ArrayLike = 0.0,
    v_0: ArrayLike = 0.0,
) -> list[Response]:
    """Steady responses of a law, with the solver that the study has for it."""
    K_c, gap = scene
    law = contact_law(label, K_c, Gap(*(1e-3 * float(j) for j in gap.split("/"))))
    solver = study.solver(label)
    omega, x_0, v_0 = np.broadcast_arrays(*np.atleast_1d(omega, x_0, v_0))
    scenes = [
        Scene(oscillator=study.oscillator, law=law, omega=frequency, solver=solver)
        for frequency in omega.tolist()
    ]
    return respond_all(scenes, np.stack([x_0, v_0], axis=1), study.steady).rows()


def _peak(study: Study, label: str) -> float:
    """The frequency at which the largest response from rest jumps down."""
    omega = np.arange(*_PEAK, 0.1).round(1)
    amplitude = _amplitudes(study, label, omega)
    at = int(np.nanargmax(amplitude))
    if at + 1 == omega.size:
        return float("nan")
    low, high = omega[at], omega[at + 1]
    half = 0.5 * (amplitude[at] + amplitude[at + 1])
    while high - low > FINEST:
        between = np.linspace(low, high, 18)[1:-1]  # sixteen at the price of one
        above = _amplitudes(study, label, between) > half
        n = above.size if above.all() else int(np.argmin(above))
        low, high = (between[n - 1] if n else low), (between[n] if n < above.size else high)
    return float(low)


def _amplitudes(study: Study, label: str, omega: Floats) -> Floats:
    return np.array([r.amplitude for r in _responses(study, label, SOFT_SYMMETRIC, omega)])


def _period_3(study: Study, label: str) -> tuple[float, float]:
    """Both ends of the period-3 attractor, followed outwards from where starts find it."""
    omega = np.arange(*_SUBHARMONIC, 0.2).round(1)
    starts = qmc.scale(qmc.Sobol(2, rng=1).random(16), *_BOX)
    tried, x_0, v_0 = (
        np.ravel(a)
        for a in np.broadcast_arrays(omega[:, None], starts[None, :, 0], starts[None, :, 1])
    )
    found = _responses(study, label, SOFT_SYMMETRIC, tried, x_0, v_0)
    three = [(tried[i], r) for i, r in enumerate(found) if r.period_multiple == 3]
    if not three:
        return float("nan"), float("nan")
    (lowest, first), (highest, last) = three[0], three[-1]
    return _followed(study, label, lowest, first, -1.0), _followed(study, label, highest, last, 1.0)


def _followed(study: Study, label: str, omega: float, at: Response, sign: float) -> float:
    """How far the period-3 response at a frequency can be followed in one direction."""
    step = 0.1
    while step >= 0.5 * FINEST:
        beyond = omega + sign * step
        (found,) = _responses(study, label, SOFT_SYMMETRIC, beyond, at.x_end, at.v_end)
        if found.period_multiple == 3:
            omega, at = beyond, found
        else:
            step *= 0.5
    return float(omega)
