"""Figures of the benchmark: work-precision diagrams and the failure atlas."""

import math
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from gapsweep.analysis.bench.judge import CellOutcome
from gapsweep.report import marks
from gapsweep.report.drawing import work_precision
from gapsweep.report.labelled import loglog
from gapsweep.report.style import GREY, NUMBERED, looks
from gapsweep.status import Status

_WIDTH = 9.5  # inches, the report's column
_COLUMNS = 3
# Letter, words and colour, from best to worst: a cell of the atlas shows the worst of its runs.
_OUTCOMES = {
    CellOutcome.NOT_REQUESTED: ("", "blank: not run", "#ffffff"),
    CellOutcome.RIGHT: ("R", "R: right", "#cfe8dc"),
    CellOutcome.MODEL_ERROR: ("M", "M: law differs from the exact one", "#f3d08a"),
    CellOutcome.UNDECIDED: ("?", "?: undecided", "#d5d5d5"),
    CellOutcome.FAILED: ("", "ended with a status", "#9fd0f0"),
    CellOutcome.SILENT_WRONG: ("!", "!: wrong without a warning", NUMBERED[1]),
}
_SEVERITY = list(_OUTCOMES)
_RANK = np.array([_SEVERITY.index(outcome) for outcome in CellOutcome])
STATUS_LETTERS = {
    "out of fit range": "O",
    "diverged": "D",
    "model invalid": "P",
    "step underflow": "U",
    "chatter": "C",
    "timed out": "T",
    "killed": "K",
    "error": "E",
}
_QUANTITIES = {
    "trajectory_error": "error at period ends",
    "event_time_error": "error of contact times [s]",
    "amplitude_error": "error of the amplitude",
}


def work_precision_figure(bench: xr.Dataset) -> Figure:
    """Figure of cost over total error, a panel per scenario.

    `bench`: ``work_precision.nc``, or some of its scenarios.
    """
    n_rows = math.ceil(bench.sizes["scene"] / _COLUMNS)
    columns = min(_COLUMNS, bench.sizes["scene"])
    figure = Figure(figsize=(_WIDTH, 1.3 + 2.6 * n_rows), layout="constrained")
    panels = figure.subplots(n_rows, columns, squeeze=False, sharex=True, sharey=True)
    for axes, s in zip(panels.flat, range(bench.sizes["scene"]), strict=False):
        one = bench.isel(scene=s)
        loglog(axes)
        marks.put(axes, work_precision(one))
        title = f"{one['gap'].item()} mm, {float(one['omega']):g} Hz"
        axes.set_title(title, fontsize=9, loc="left")
    _widen(panels[0, 0])
    for axes in panels.flat[bench.sizes["scene"] :]:
        axes.set_visible(False)
    for axes in panels[:, 0]:
        axes.set_ylabel("processor time per\nsimulated second")
    for axes in panels[-1]:
        axes.set_xlabel("error compared with the exact law")
    figure.legend(
        *panels[0, 0].get_legend_handles_labels(),
        loc="outside upper center",
        ncols=5,
        fontsize=8,
    )
    return figure


def _widen(axes: Axes) -> None:
    """Widen each axis with a single value to a decade.

    Error bars split one value into two that differ by rounding: the axis would be too narrow.
    """
    for (low, high), set_limits in (
        (axes.get_xlim(), axes.set_xlim),
        (axes.get_ylim(), axes.set_ylim),
    ):
        if high < 1.01 * low:
            set_limits(low / math.sqrt(10.0), high * math.sqrt(10.0))


def tolerance_figure(bench: xr.Dataset) -> Figure:
    """Figure of solver errors over the tolerance, as medians over the scenarios."""
    figure = Figure(figsize=(_WIDTH, 4.2), layout="constrained")
    panels = figure.subplots(1, len(_QUANTITIES))
    labels = bench["method"].values.tolist()
    styles = looks(labels)
    for axes, (name, title) in zip(panels, _QUANTITIES.items(), strict=True):
        loglog(axes)
        middle = bench[name].median("scene")
        for label in labels:
            x, y = bench["rtol"].sel({"method": label}), middle.sel({"method": label})
            y, own = y.where(y > 0.0), styles[label]
            look: dict[str, Any] = {"colour": own.colour, "dashes": own.dashes, "dots": 3.0}
            look |= {"marker": own.marker, "size": 0.9, "series": label, "entry": label}
            marks.put(axes, [marks.line(x=x.values, y=y.values, **look)])
        ends = [float(bench["rtol"].min()), float(bench["rtol"].max())]
        marks.put(axes, [marks.line(x=ends, y=ends, dashes="--", colour=GREY, size=0.8)])
        axes.set_title(title, fontsize=9, loc="left")
        axes.set(xlabel="relative tolerance", ylabel="error")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=5,
                  fontsize=8)  # fmt: skip
    return figure


def in_range(stability: xr.Dataset, *, tight: bool) -> xr.DataArray:
    """Mask of the runs at tight tolerances, or at loose ones."""
    limit = stability.attrs["tight_rtol"] * 1.01
    rtol: xr.DataArray = stability["rtol"]
    return xr.DataArray(rtol <= limit if tight else rtol > limit)


def worst(stability: xr.Dataset, *, tight: bool) -> xr.DataArray:
    """Worst outcome over the tight or the loose tolerances, per scenario and method."""
    ranked = stability["outcome"].transpose("scene", "method", "tolerance")
    counts = in_range(stability, tight=tight).transpose("method", "tolerance").values
    ranks = np.where(counts, _RANK[ranked.values - min(CellOutcome)], 0).max(axis=-1)
    found: xr.DataArray = ranked.isel(tolerance=0).copy(data=np.array(_SEVERITY)[ranks])
    return found


def atlas(stability: xr.Dataset, *, tight: bool) -> Figure:
    """Figure of outcomes by scenario and method, as colours and as letters."""
    outcome = worst(stability, tight=tight)
    n_scenes, n_methods = outcome.shape
    figure = Figure(figsize=(_WIDTH, 2.1 + 0.24 * n_scenes), layout="constrained")
    axes = figure.subplots()
    ranks = _RANK[outcome.values - min(CellOutcome)]
    shades = ListedColormap([shade for _, _, shade in _OUTCOMES.values()])
    axes.imshow(ranks, cmap=shades, vmin=0, vmax=len(_OUTCOMES) - 1, aspect="auto")
    chosen = in_range(stability, tight=tight)
    for s in range(n_scenes):
        for m in range(n_methods):
            what = CellOutcome(outcome.values[s, m])
            status = stability["status"].where(chosen, 0).isel(scene=s).isel(method=m).max()
            word = Status(int(status)).label.replace("_", " ")
            failed = what is CellOutcome.FAILED
            letter = STATUS_LETTERS.get(word, "F") if failed else _OUTCOMES[what][0]
            bold = "bold" if what is CellOutcome.SILENT_WRONG else "normal"
            axes.text(m, s, letter, ha="center", va="center", fontsize=8, fontweight=bold)
    axes.set_xticks(range(n_methods), outcome["method"].values.tolist(), rotation=60, ha="left",
                    rotation_mode="anchor", fontsize=8)  # fmt: skip
    axes.xaxis.tick_top()
    axes.set_yticks(range(n_scenes), outcome["scene"].values.tolist(), fontsize=8)
    axes.grid(visible=False)
    axes.tick_params(length=0)
    for edge in np.arange(0.5, n_scenes - 1):
        axes.axhline(edge, color="white", linewidth=1.0)
    for edge in np.arange(0.5, n_methods - 1):
        axes.axvline(edge, color="white", linewidth=1.0)
    axes.spines[:].set_visible(False)
    ended = ", ".join(f"{letter}: {words}" for words, letter in STATUS_LETTERS.items())
    axes.set_xlabel(f"Ended with a status: {ended}", fontsize=8)
    patches = [
        Patch(facecolor=shade, edgecolor="#999999", label=words)
        for _, words, shade in _OUTCOMES.values()
    ]
    figure.legend(handles=patches, loc="outside lower center", ncols=3, fontsize=8)
    return figure
