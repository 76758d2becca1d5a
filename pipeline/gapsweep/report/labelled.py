"""Axes, horizontal coordinate and labels of all plots of the accessor."""

import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from gapsweep.analysis.dimensions import selected
from gapsweep.errors import DatasetError
from gapsweep.report import maps
from gapsweep.report.scales import axis_label, drawn, is_log, named
from gapsweep.report.selection import places, scene
from gapsweep.study.grid import CONTACT, COORDINATE, START

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WIDTH = 90  # characters of a title that fit over axes of the usual size
_COLUMN = 6  # entries of a legend in one column


def axes_of(ax: "Axes | None") -> "Axes":
    """The given axes, or new ones in the user's matplotlib style."""
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    return plt.subplots(layout="constrained")[1]


def loglog(axes: "Axes") -> None:
    """Make both axes logarithmic, with a grid of decades."""
    axes.set(xscale="log", yscale="log")
    axes.grid(which="minor", visible=False)


def axis_of(dataset: xr.Dataset, along: str | None, wanted: Mapping[str, Any]) -> str:
    """Name of the horizontal axis: `along`, or else omega or the only swept number."""
    if along is not None or "omega" in dataset.coords:
        return along or "omega"
    swept = maps.numeric_axes(selected(dataset, wanted))
    return swept[0] if len(swept) == 1 else "omega"


def scene_along(
    dataset: xr.Dataset,
    along: str,
    variables: Mapping[str, tuple[str, ...]],
    wanted: Mapping[str, Any],
) -> xr.Dataset:
    """Dataset of the drawn variables, over `along` and the other dimensions they need."""
    if along not in dataset.coords:
        swept = maps.numeric_axes(dataset)
        remedy = "select without drop=True to keep it"
        if swept:
            remedy = f"it sweeps {', '.join(swept)}: choose, as along={swept[0]!r}"
        why = f"{along}: no coordinate of this dataset, so nothing can be drawn along it"
        raise DatasetError(f"{why}; {remedy}")
    if dataset[along].dtype.kind not in "iuf":
        raise DatasetError(f"{along}: holds text; draw along omega or K_c")
    needed = {name: tuple(dict.fromkeys((along, *dims))) for name, dims in variables.items()}
    return scene(dataset, needed, wanted)


def finished(axes: "Axes", shown: xr.Dataset, along: str) -> "Axes":
    """Label the horizontal axis, and add title and legend; returns the axes.

    The axis contains all values of `along`, and is logarithmic if `is_log`.
    """
    axes.set_xlabel(axis_label(shown[along]))
    # The whole axis is shown, also values without dots.
    axes.update_datalim(np.column_stack([drawn(shown[along])] * 2), updatey=False)
    axes.autoscale_view()
    if is_log(shown[along]):
        axes.set_xscale("log")
    return titled(axes, shown)


def titled(axes: "Axes", shown: xr.Dataset) -> "Axes":
    """Add a legend, and a title with all parameters that have one value; returns the axes."""
    if axes.get_legend() is None and axes.get_legend_handles_labels()[0]:
        n = len(axes.get_legend_handles_labels()[0])
        axes.legend(fontsize=8, ncols=2 if n > _COLUMN else 1)
    names = ["scene", "representation", *places(shown), "regime", COORDINATE, CONTACT, START]
    one = [named(shown[name]) for name in names if name in shown.coords and shown[name].size == 1]
    if START in shown.coords and "start" in shown.coords and shown["start"].size == 1:
        one[-1] = one[-1] if shown["start"] == "fixed" else f"{START} = {shown['start'].item()}"
    words = textwrap.wrap(
        ", ".join(each.replace(" ", "\u00a0") for each in one),
        _WIDTH,
        break_long_words=False,
        break_on_hyphens=False,
    )
    axes.set_title("\n".join(words).replace("\u00a0", " "), fontsize=9, loc="left")
    return axes
