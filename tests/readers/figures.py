"""Texts of a figure and which of them overlap; whether its CSV draws the same figure."""

import csv
import io

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from scipy.ndimage import binary_dilation

from gapsweep.report.figure_data import as_csv

NEAR = 5  # pixels: marks have other sizes


def texts(figure):
    """All texts of a figure that are in view."""
    for axes in figure.axes:
        yield from (
            axes.xaxis.label,
            axes.yaxis.label,
            axes._left_title,
            axes._right_title,
            *axes.texts,
        )
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            yield from (t.label1 for t in axis.get_major_ticks() if low <= t.get_loc() <= high)
    yield from figure.texts
    for legend in (*figure.legends, *filter(None, (axes.get_legend() for axes in figure.axes))):
        yield from legend.get_texts()


def overlaps(figure):
    """Pairs of texts of which one lies on the other."""
    FigureCanvasAgg(figure).draw()
    shown = [text for text in texts(figure) if text.get_text() and text.get_visible()]
    boxes = [(text.get_text(), text.get_window_extent()) for text in shown]
    return [
        (name, other)
        for i, (name, box) in enumerate(boxes)
        for other, another in boxes[:i]
        if box.width > 0 and another.width > 0 and box.overlaps(another)
    ]


def is_redrawn(figure):
    """Whether what the CSV of a figure draws has ink where the figure has it, and nowhere else."""
    text = as_csv(figure)
    panels = [axes for axes in figure.axes if axes.get_visible()]
    FigureCanvasAgg(figure).draw()
    again = Figure(figsize=figure.get_size_inches(), dpi=figure.dpi, layout="none")
    copies = [_copy(axes, again) for axes in panels]
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    for row in _grouped(csv.DictReader(io.StringIO("\n".join(lines)))):
        _draw(copies, *row)
    figure.set_layout_engine("none")
    for text in figure.findobj(Text):
        text.set_visible(False)
    for axes in panels:
        axes.set_axis_off()
        for line in axes.lines:  # across the panel, which says no data
            line.set_visible(line.get_transform() == axes.transData)
    for legend in (*figure.legends, *(axes.get_legend() for axes in panels)):
        if legend is not None:
            legend.set_visible(False)
    ours, theirs = _ink(figure), _ink(again)
    return bool(ours.any()) and _within(ours, theirs) and _within(theirs, ours)


def _copy(axes, figure):
    copy = figure.add_axes(axes.get_position())
    copy.set(xscale=axes.get_xscale(), yscale=axes.get_yscale())
    for which in "xy":
        scale = getattr(axes, f"{which}axis").get_transform()
        if hasattr(scale, "linthresh"):
            known = {"linthresh": scale.linthresh, "linscale": scale.linscale}
            getattr(copy, f"set_{which}scale")("symlog", **known)
    copy.set(xlim=axes.get_xlim(), ylim=axes.get_ylim(), autoscale_on=False)
    copy.set_axis_off()
    return copy


def _grouped(rows):
    """Rows that follow each other with one panel, series and mark."""
    groups = {}
    for row in rows:
        places = groups.setdefault((int(row["panel"]) - 1, row["series"], row["mark"]), [])
        places.append([_value(row[name]) for name in ("x", "y", "x_end")])
    for (panel, _, mark), places in groups.items():
        yield panel, mark, list(zip(*places, strict=True))


def _value(text):
    try:
        return float(text or "nan")
    except ValueError:
        return text


def _draw(copies, panel, mark, places):
    axes, (x, y, end) = copies[panel], places
    if mark == "line":
        axes.plot(x, y, "k-", linewidth=1.5)
    elif mark == "point":
        axes.plot(x, y, "ko", markersize=2.5, clip_on=False)
    elif mark == "tick":
        axes.vlines(x, 1.0, 1.04, transform=axes.get_xaxis_transform(), clip_on=False)
    else:
        for low, high in zip(x, end, strict=True):
            axes.axvspan(low, high, color="#cccccc")


def _ink(figure):
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].min(axis=-1) < 250


def _within(some, others):
    return not np.any(some & ~binary_dilation(others, iterations=NEAR))
