"""Figures of the report: functions from a dataset to a matplotlib figure."""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gapsweep.report import backdrop, branch_lines, drawing, marks
from gapsweep.report.drawing import labels_of
from gapsweep.report.figure_data import Choice
from gapsweep.report.maps import MapImage, draw
from gapsweep.report.scales import axis_label, drawn, is_log
from gapsweep.status import Status

_WIDTH = 9.5  # inches, the report's column


def frequency_response(responses: xr.Dataset, along: str = "omega") -> Figure:
    """Amplitude over frequency, a curve per representation and initial state, broken at jumps.

    Parameters
    ----------
    responses : Dataset
        Dimensions representation, `along`, initial_condition.
    along : str
        Numeric dimension of the horizontal axis.
    """
    figure = Figure(figsize=(_WIDTH, 4.2))
    axes = figure.subplots()
    marks.put(axes, drawing.curves(responses["amplitude"], along, responses.get("response_class")))
    marks.put(axes, drawing.key_of_marks(responses))
    _axis(axes, responses[along])
    axes.set_ylabel(axis_label(responses["amplitude"], "amplitude"))
    axes.set_ylim(bottom=0)
    if axes.lines:
        axes.legend(ncols=2)
    return figure


def bifurcation(
    responses: xr.Dataset, along: str = "omega", continued: xr.Dataset | None = None
) -> Figure:
    """Steady extrema over frequency, a panel per representation.

    Behind the dots are pale bands where a response is not periodic, and the branches.
    """

    def extrema(axes: Axes, one: xr.Dataset) -> None:
        marks.put(axes, backdrop.walls(responses, along), backdrop.bands(one, along))
        branch_lines.behind(axes, continued, one, along, ("x_max", "x_min"))
        marks.put(axes, drawing.extrema(one, along))

    shown = drawing.with_setting(responses, "extrema")
    figure = _grid(shown, along, axis_label(responses["extrema"], "extrema"), extrema)
    key_above(figure, responses)
    return figure


def key_above(figure: Figure, scene: xr.Dataset) -> None:
    """Add a legend of the symbols and bands of extrema above the panels, if they have any."""
    entries = [*drawing.key_of_marks(scene, "extrema"), *backdrop.key_of_bands(scene)]
    if entries:
        marks.put(figure.axes[0], entries)
        handles = figure.axes[0].get_legend_handles_labels()[0][-len(entries) :]
        figure.legend(handles=handles, loc="outside upper right", ncols=len(entries), fontsize=8)


def attractors(
    found: xr.Dataset, along: str = "omega", continued: xr.Dataset | None = None
) -> Figure:
    """Peak of every attractor over frequency, its dot as large as its basin, a panel per label.

    `found`: part of ``attractors.nc``; dimensions representation, `along`, attractor.
    `along`: numeric dimension of the horizontal axis.
    `continued`: ``branches.nc``, drawn behind.
    """

    def peaks(axes: Axes, one: xr.Dataset) -> None:
        marks.put(axes, backdrop.walls(found, along, of_peaks=True))
        branch_lines.behind(axes, continued, one, along, ("x_max",))
        marks.put(axes, drawing.attractor_peaks(one, along))

    return _grid(found, along, axis_label(found["x_max"], "peak"), peaks)


def special_curves(curves: xr.Dataset, here: xr.Dataset, along: str, second: str) -> Figure:
    """Curves of special points over two parameters, a panel per representation."""

    def lines(axes: Axes, one: xr.Dataset) -> None:
        shown = branch_lines.of_scene(curves, one, along, second)
        if shown is not None:
            marks.put(axes, branch_lines.orbits(shown, along, [second]))
            branch_lines.name_points(axes, shown, along, second)
            axes.set_yscale("log" if branch_lines.is_log(shown[second]) else "linear")
            axes.legend(fontsize=7)

    return _grid(here, along, branch_lines.label(curves[second]), lines)


def compared_with_exact(scene: xr.Dataset, shown: Choice) -> Figure:
    """Figure of `peaks_of_laws` of a parameter set."""
    figure = Figure(figsize=(_WIDTH, 2.3), layout="constrained")
    panels = figure.subplots(1, len(shown.panels), sharex=True, sharey=True, squeeze=False)[0]
    for axes, (title, several) in zip(panels, shown.panels, strict=True):
        marks.put(axes, several)
        axes.set_title(title, fontsize=9, loc="left")
        _axis(axes, scene["omega"])
    panels[0].set_ylim(shown.limits)
    panels[0].set_ylabel(axis_label(scene["x_max"], "peak"))
    return figure


def peaks_of_laws(
    name: str,
    scene: xr.Dataset,
    exact: str,
    titles: Mapping[str, str],
    continued: xr.Dataset | None = None,
) -> Choice:
    """Peaks of laws in front of the exact law's, which show in black if missed; a panel per law.

    `name`: the parameter set in words.
    `scene`: dimensions representation, omega, initial_condition.
    `exact`: label of the exact law.
    `titles`: title of the panel of each law.
    `continued`: ``branches.nc``; unstable orbits are drawn behind.
    """
    scene = drawing.with_setting(scene, "x_max")
    low, high = drawing.frame(scene, "x_max", exact)
    sizes = (7.0, 3.2) if scene.sizes["omega"] <= drawing.FEW else (3.4, 1.6)
    panels = []
    for label, title in titles.items():
        several = [*backdrop.walls(scene, of_peaks=True)]
        law = scene.sel(representation=label)
        for one in (scene.sel(representation=exact), law):
            several += branch_lines.unstable(continued, one, "omega", "x_max")
        for one, size in zip((_where_asked(law, scene, exact), law), sizes, strict=True):
            several += drawing.peaks(one, size, low, high)
        panels.append((title, several))
    return Choice(name, (low, high), panels)


def _where_asked(law: xr.Dataset, scene: xr.Dataset, exact: str) -> xr.Dataset:
    """Responses of the exact law, restricted to the points of another law."""
    theirs, asked = scene.sel(representation=exact), law["status"] != Status.NOT_REQUESTED
    known = {"x_max": np.nan, "status": int(Status.NOT_REQUESTED)}
    return theirs.assign({name: theirs[name].where(asked, other) for name, other in known.items()})


def maps(pictures: Sequence[MapImage]) -> Figure:
    """Figure of several maps, two in a row."""
    n_rows = math.ceil(len(pictures) / 2)
    figure = Figure(figsize=(_WIDTH, 1.0 + 3.4 * n_rows))
    panels = iter(figure.subplots(n_rows, 2, squeeze=False).ravel())
    for shown in pictures:
        draw(next(panels), shown)
    for axes in panels:
        axes.set_visible(False)
    return figure


def _grid(
    found: xr.Dataset,
    along: str,
    y_label: str,
    drawn_in: Callable[[Axes, xr.Dataset], None],
) -> Figure:
    """Figure with a panel per representation, as many columns as rows or one more."""
    labels = labels_of(found)
    n_columns = math.ceil(math.sqrt(len(labels)))
    n_rows = math.ceil(len(labels) / n_columns)
    figure = Figure(figsize=(_WIDTH, 0.7 + 2.1 * n_rows))
    panels = figure.subplots(n_rows, n_columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes, label in zip(panels, labels, strict=False):
        drawn_in(axes, found.sel(representation=label))
        axes.set_title(label, fontsize=9, loc="left")
    for axes in panels[len(labels) :]:
        axes.set_visible(False)
    for axes in panels[max(0, len(labels) - n_columns) : len(labels)]:
        _axis(axes, found[along])
        axes.xaxis.set_tick_params(labelbottom=True)
    for axes in panels[::n_columns]:
        axes.set_ylabel(y_label)
    return figure


def _axis(axes: Axes, coordinate: xr.DataArray) -> None:
    values = drawn(coordinate)
    axes.set_xlabel(axis_label(coordinate))
    if is_log(coordinate):
        axes.set_xscale("log")
        return
    # Without this margin, dots would lie on the frame.
    pad = max(0.02, 0.25 / values.size) * (values.max() - values.min()) or 0.5
    low = values.min() - pad
    axes.set_xlim(max(0.0, low) if values.min() >= 0.0 else low, values.max() + pad)
