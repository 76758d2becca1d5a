"""What a figure shows, as CSV: a row per point, so that anybody can draw it again."""

import csv
import io
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

HEADER = ("panel", "series", "mark", "x", "y", "x_end")
_ABOUT = "# panel"  # how a line starts that says what a panel is
Row = tuple[str, ...]


def as_csv(figure: Figure) -> str:
    """All lines, points, bands and ticks of a figure, in the units of its axes.

    Lines that start with # say what the panels and their axes are. Points that lie on each other
    to six digits stand there once: many starts end on one attractor. Empty if the figure shows
    images, whose colours are not their numbers: these are in the datasets.
    """
    panels = [axes for axes in figure.axes if axes.get_visible()]
    if any(axes.images for axes in panels):
        return ""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    common = figure.get_supxlabel(), figure.get_supylabel()
    for number, axes in enumerate(panels, start=1):
        x, y = (label_of(axes, n) or alone for n, alone in zip("xy", common, strict=True))
        said = f"{axes.get_title(loc='left')}; x: {x}; y: {y}".replace("\n", " ")
        text.write(f"{_ABOUT} {number}: {said}\n")
    writer.writerow(HEADER)
    for number, axes in enumerate(panels, start=1):
        writer.writerows((number, *row) for row in _marks(axes))
    return text.getvalue()


def label_of(axes: Axes, which: str) -> str:
    """The label of an axis, or that of the panels it is shared with."""
    shared = getattr(axes, f"get_shared_{which}_axes")().get_siblings(axes)
    labels = [getattr(one, f"get_{which}label")() for one in (axes, *shared)]
    return next(filter(None, labels), "")


def _marks(axes: Axes) -> Iterator[Row]:
    """Series, mark, place and end of everything that lies where the data say."""
    for line in axes.lines:
        if line.get_transform() == axes.transData:  # lines across the panel say no data
            rows = _rows(line, _kind(line), *line.get_data())
            yield from rows if _kind(line) == "line" else dict.fromkeys(rows)
    for found in axes.collections:
        if isinstance(found, PathCollection):
            yield from dict.fromkeys(_rows(found, "point", *np.asarray(found.get_offsets()).T))
        elif isinstance(found, LineCollection):
            ticks = np.array([segment[0, 0] for segment in found.get_segments()])
            yield from _rows(found, "tick", ticks, np.full(ticks.shape, np.nan))
    for band in axes.patches:
        if isinstance(band, Rectangle):
            ends = _text(band.get_x()), _text(band.get_x() + band.get_width())
            yield _series(band), "band", ends[0], "", ends[1]


def _kind(line: Line2D) -> str:
    return "point" if line.get_linestyle() in ("None", "none", "") else "line"


def _rows(artist: Any, mark: str, x: Any, y: Any) -> Iterator[Row]:
    series = _series(artist)
    for at, value in zip(x, y, strict=True):
        yield series, mark, _text(at), _text(value), ""


def _text(value: Any) -> str:
    """A number, nothing for none, or one of the words of an axis of words."""
    if isinstance(value, str):
        return value
    return f"{float(value):.6g}" if np.isfinite(value) else ""


def _series(artist: Any) -> str:
    """What an artist's label says; matplotlib's own say nothing, others may start like them."""
    label = str(artist.get_label())
    return "" if re.fullmatch(r"_child\d+|_nolegend_", label) else label.removeprefix("_")
