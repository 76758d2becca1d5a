"""Cells of a map as one image, their edges between the values of its axes."""

from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.report.scales import drawn, is_log

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FINENESS = 2000  # cells of one width along an axis of uneven ones


def edges(values: NDArray[np.float64], *, log: bool) -> NDArray[np.float64]:
    """Edges of the cells of an axis, halfway between its values.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Ascending.
    log : bool
        Whether halfway on a logarithmic axis.

    Returns
    -------
    ndarray, shape (n + 1,)
    """
    at = np.log(values) if log else values
    if at.size == 1:
        half = 0.05 if log else 0.05 * abs(float(at[0])) or 0.5
        ends = np.array([at[0] - half, at[0] + half])
    else:
        inner = 0.5 * (at[1:] + at[:-1])
        ends = np.concatenate([[2.0 * at[0] - inner[0]], inner, [2.0 * at[-1] - inner[-1]]])
        if at[0] > 0.0 and not log:
            ends[0] = max(ends[0], 0.0)  # what is positive has no cells below zero
    return np.exp(ends) if log else ends


def mesh(axes: "Axes", x: xr.DataArray, y: xr.DataArray, cells: NDArray[Any], **style: Any) -> Any:
    """Cells whose edges lie halfway between the values, as one image; logarithmic by `is_log`.

    Parameters
    ----------
    cells : ndarray, shape (n_y, n_x, ...)
        What `matplotlib.axes.Axes.imshow` takes.
    """
    scaled: dict[int, NDArray[np.float64]] = {}
    for axis, coordinate in ((1, x), (0, y)):
        ends = edges(drawn(coordinate), log=is_log(coordinate))
        which = "yx"[axis]
        axes.set(**{f"{which}scale": "log" if is_log(coordinate) else "linear"})
        axes.set(**{f"{which}lim": (ends[0], ends[-1])})
        scaled[axis] = getattr(axes, f"{which}axis").get_transform().transform(ends)
        cells = _even(cells, scaled[axis], axis)
    limits = axes.get_xlim(), axes.get_ylim()
    # Evenly spaced on the scale, not in the data: matplotlib would stretch it a second time.
    look = {"transform": axes.transLimits + axes.transAxes, "interpolation": "none", **style}
    extent = *scaled[1][[0, -1]].tolist(), *scaled[0][[0, -1]].tolist()
    made = axes.imshow(cells, extent=extent, origin="lower", aspect="auto", **look)
    axes.set(xlim=limits[0], ylim=limits[1])
    axes.grid(visible=False)
    return made


def _even(cells: NDArray[Any], ends: NDArray[np.float64], axis: int) -> NDArray[Any]:
    """Cells of one width along an axis: as they are, or repeated to fit their edges.

    Parameters
    ----------
    ends : ndarray, shape (n + 1,)
        The edges on the scale of the axis.
    """
    even = np.linspace(ends[0], ends[-1], ends.size)
    if np.allclose(ends, even, rtol=0.0, atol=0.01 * (even[1] - even[0])):
        return cells
    middles = np.linspace(ends[0], ends[-1], 2 * _FINENESS + 1)[1::2]
    return np.take(cells, np.searchsorted(ends, middles, side="right") - 1, axis=axis)
