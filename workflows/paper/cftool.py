"""Rational fits as MATLAB's cftool makes them, beside the least-squares optimum of the study.

Its models ``ratNM`` have a denominator whose leading coefficient is one, and random starts in
[0, 1] for every other coefficient. The paper states neither its coefficients nor the unit of x,
on which such a start depends: three are tried.
"""

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.optimize import least_squares

from gapsweep.model.fit import N_RATIONAL_POINTS, unit_force
from gapsweep.model.oscillator import Gap
from gapsweep.study.study import Study

from .scenes import LARGE, SYMMETRIC

Floats = NDArray[np.float64]

RATIOS = ("3/2", "5/3", "5/5")
UNITS = {"m": 1.0, "mm": 1e3, "4 mm": 250.0}
GAPS = (SYMMETRIC, LARGE)
N_RANDOM = 20
_SAME = 1.0 + 1e-3  # errors of the same fit
_MOST_EVALUATIONS = 400  # of the residual: cftool's limit of iterations


def cftool(study: Study) -> xr.Dataset:
    """What random starts end on, per gap, ratio of degrees and unit of x.

    Returns
    -------
    Dataset
        ``pole_share``, ``best_share``: shares of random initial values that lead to a pole in the
        fit range, and to the best other fit. Its ``rmse`` and ``force_at_zero`` are per unit
        contact stiffness [m], NaN if there is none.
    """
    gaps = [gap for gap in study.grid.gaps if gap.label in GAPS]
    x_max = study.spec.approximation.range
    found = np.array([[[_fits(g, r, u, x_max) for u in UNITS] for r in RATIOS] for g in gaps])
    names = {
        "pole_share": ("1", "share of random fits with a pole in the fit range"),
        "best_share": ("1", "share of random fits that are the best fit without a pole"),
        "rmse": ("m", "RMS force error of the best fit, per unit contact stiffness"),
        "force_at_zero": ("m", "force of the best fit at x = 0, per unit contact stiffness"),
    }
    return xr.Dataset(
        {
            name: (("gap", "ratio", "unit"), found[..., i], {"units": units, "long_name": says})
            for i, (name, (units, says)) in enumerate(names.items())
        },
        {"gap": [gap.label for gap in gaps], "ratio": list(RATIOS), "unit": list(UNITS)},
    )


def _fits(gap: Gap, ratio: str, unit: str, x_max: float) -> tuple[float, ...]:
    n, m = (int(degree) for degree in ratio.split("/"))
    x = np.linspace(-x_max, x_max, N_RATIONAL_POINTS)
    # Newtons at the paper's soft contact: the size of the force decides what a start of 1 means.
    exact, newtons = unit_force(x, gap), 1.4e4
    x = UNITS[unit] * x
    top, bottom = np.vander(x, n + 1), np.vander(x, m + 1)

    def denominator(p: Floats) -> Floats:
        values = bottom @ np.append(1.0, p[n + 1 :])
        return np.where(np.abs(values) < 1e-300, 1e-300, values)

    def residual(p: Floats) -> Floats:
        return np.asarray(top @ p[: n + 1] / denominator(p) - newtons * exact)

    rng = np.random.default_rng(1)
    without_pole = []
    for start in rng.uniform(size=(N_RANDOM, n + m + 1)):
        p = least_squares(residual, start, x_scale="jac", max_nfev=_MOST_EVALUATIONS).x
        roots = np.roots(np.append(1.0, p[n + 1 :]))
        real = roots.real[np.abs(roots.imag) < 1e-9 * np.abs(roots)]
        if not np.any(np.abs(real) <= np.abs(x[0])):
            rmse = float(np.sqrt(np.mean(residual(p) ** 2))) / newtons
            without_pole.append((rmse, float(p[n] / p[-1]) / newtons))
    best = min(without_pole, default=(np.nan, np.nan))
    found = sum(rmse <= best[0] * _SAME for rmse, _ in without_pole)
    return (1.0 - len(without_pole) / N_RANDOM, found / N_RANDOM, *best)
