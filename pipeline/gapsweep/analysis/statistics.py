"""Statistics over frequencies and starts that let a scene without any result be NaN."""

import warnings

import xarray as xr

from gapsweep.analysis.grid import SWEPT


def quantile(values: xr.DataArray, q: float) -> xr.DataArray:
    """Quantile over frequencies and starts; NaN entries do not count."""
    with warnings.catch_warnings():
        # numpy warns where no entry is left: NaN is what we want there.
        warnings.simplefilter("ignore", RuntimeWarning)
        return values.quantile(q, SWEPT).drop_vars("quantile")


def mean(values: xr.DataArray) -> xr.DataArray:
    """Mean over frequencies and starts; NaN entries do not count."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return values.mean(SWEPT)
