"""Statistics that let what has no result be NaN: over frequencies and starts, and of ratios."""

import warnings

import numpy as np
import xarray as xr
from scipy.special import stdtrit

from gapsweep.analysis.arrays import Array
from gapsweep.analysis.grid import swept


def quantile(values: xr.DataArray, q: float) -> xr.DataArray:
    """Quantile over frequencies and starts; NaN entries do not count."""
    with warnings.catch_warnings():
        # numpy warns where no entry is left: NaN is what we want there.
        warnings.simplefilter("ignore", RuntimeWarning)
        return values.quantile(q, swept(values)).drop_vars("quantile")


def mean(values: xr.DataArray) -> xr.DataArray:
    """Mean over frequencies and starts; NaN entries do not count."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return values.mean(swept(values))


def repeatability(ratios: Array) -> float:
    """How far the ratio of equal quantities is from 1 by chance, in 95 % of cases, as a logarithm.

    Parameters
    ----------
    ratios : ndarray
        As measured; NaN if none was.
    """
    known = np.log(ratios[np.isfinite(ratios) & (ratios > 0.0)])
    if not known.size:
        return np.nan
    return float(stdtrit(known.size, 0.975) * np.sqrt(np.mean(known**2)))


def widened(ratio: float, interval: Array, noise: float) -> tuple[float, float]:
    """The interval of a ratio and its `repeatability`, both in quadrature."""
    with np.errstate(divide="ignore", invalid="ignore"):
        below, above = np.exp(np.hypot(np.log(ratio / np.asarray(interval)), noise))
        return float(ratio / below), float(ratio * above)
