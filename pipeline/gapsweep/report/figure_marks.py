"""Data of a figure: CSV for users, JSON for the page that draws it interactively."""

import base64
import csv
import io
import json
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.category import StrCategoryLocator
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import to_hex, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedLocator

HEADER = ("panel", "series", "mark", "x", "y", "x_end")
_ABOUT = "# panel"  # prefix of the lines that describe panels
_NONE = ("None", "none", "", " ", None)  # matplotlib's names of no line and no marker
Row = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Marks:
    """Marks of one appearance, in the units of their axes.

    Attributes
    ----------
    kind : str
        ``line``, ``point``, ``tick`` above the panel, ``band`` behind it, from `x` to `x_end`, or
        ``level`` across the part of it from the first to the second of `x_end`, which is no data.
    x, y, x_end : sequence
        Numbers, or words on an axis of words.
    colour : RGBA tuple of float
    size : float or array
        Width of a line, or diameter or diameters of points [points].
    dashes : str
        Line style of matplotlib.
    dots : float
        Diameter of the marks on a line [points]; 0 without.
    zorder : float
    """

    series: str
    kind: str
    x: Any
    y: Any
    x_end: Any = ()
    colour: Any = (0.0, 0.0, 0.0, 1.0)
    size: Any = 1.0
    dashes: str = "-"
    dots: float = 0.0
    is_hollow: bool = False
    zorder: float = 0.0


def as_csv(figure: Figure) -> str:
    """Lines, points, bands and ticks of a figure as CSV, in the units of its axes.

    Lines that begin with # describe the panels and their axes. Points that agree to six digits
    occur once: many initial conditions lead to one attractor. Empty if the figure shows images,
    whose numbers are in the datasets.
    """
    panels = _panels(figure)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for number, axes in enumerate(panels, start=1):
        x, y = _labels(axes)
        words = f"{axes.get_title(loc='left')}; x: {x}; y: {y}".replace("\n", " ")
        text.write(f"{_ABOUT} {number}: {words}\n")
    writer.writerows([HEADER] if panels else [])
    for number, axes in enumerate(panels, start=1):
        for marks in _marks(axes):
            writer.writerows((number, *row) for row in _rows(marks))
    return text.getvalue()


def as_json(figure: Figure) -> str:
    """Panels of a figure as JSON for the page that draws them: marks, places, scales, styles.

    Numbers of marks are single precision, little-endian, in base64. Empty with images, and if the
    panels do not form a grid of rectangles (polar ones, insets, a second axis).
    """
    panels: list[Any] = _panels(figure)
    places = [str(axes.get_subplotspec()) for axes in panels if axes.get_subplotspec()]
    is_grid = len(set(places)) == len(panels) and {a.name for a in panels} == {"rectilinear"}
    return json.dumps([_panel(axes, panels) for axes in panels]) if is_grid else ""


def label_of(axes: Axes, which: str) -> str:
    """The label of an axis, or the first label of panels that share it."""
    shared = getattr(axes, f"get_shared_{which}_axes")().get_siblings(axes)
    labels = [getattr(one, f"get_{which}label")() for one in (axes, *shared)]
    return next(filter(None, labels), "")


def _panels(figure: Figure) -> list[Axes]:
    panels = [axes for axes in figure.axes if axes.get_visible()]
    return [] if any(axes.images for axes in panels) else panels


def _labels(axes: Axes) -> tuple[str, str]:
    """Labels of both axes, or else the labels of the whole figure."""
    figure: Any = axes.figure
    common = figure.get_supxlabel(), figure.get_supylabel()
    x, y = (label_of(axes, n) or alone for n, alone in zip("xy", common, strict=True))
    return x, y


def _marks(axes: Axes) -> Iterator[Marks]:
    """Marks of a panel from its matplotlib artists: data, ticks, bands and levels."""
    for line in axes.lines:
        yield from _line(axes, line)
    for found in axes.collections:
        look: dict[str, Any] = {"series": _series(found), "zorder": found.get_zorder()}
        if isinstance(found, PathCollection):
            x, y = np.asarray(found.get_offsets()).T
            faces, edges = np.asarray(found.get_facecolor()), np.asarray(found.get_edgecolor())
            look["is_hollow"] = not len(faces)
            look["colour"] = _first(faces if len(faces) else edges)
            look["size"] = np.resize(np.sqrt(found.get_sizes()), len(x))
            yield Marks(kind="point", x=x, y=y, **look)
        elif isinstance(found, LineCollection):
            look["colour"] = _first(np.asarray(found.get_colors()))
            segments = found.get_segments()
            if found.get_transform() == axes.transData:
                x, y = _apart(segments)
                yield Marks(kind="line", x=x, y=y, **look)
            else:
                x = np.array([segment[0, 0] for segment in segments])
                yield Marks(kind="tick", x=x, y=np.full(x.shape, np.nan), **look)
    for band in axes.patches:
        if isinstance(band, Rectangle):
            low = np.array([band.get_x()])
            look = {"series": _series(band), "zorder": band.get_zorder()}
            look["colour"] = to_rgba(band.get_facecolor())
            yield Marks(kind="band", x=low, y=[np.nan], x_end=low + band.get_width(), **look)


def _first(colours: Any) -> tuple[float, ...]:
    return tuple(colours[0]) if len(colours) else (0.0, 0.0, 0.0, 0.0)


def _line(axes: Axes, line: Line2D) -> Iterator[Marks]:
    x, y = line.get_data()
    look: dict[str, Any] = {"series": _series(line), "zorder": line.get_zorder()}
    look["colour"] = to_rgba(line.get_color(), line.get_alpha())
    look["dashes"] = str(line.get_linestyle())
    if line.get_transform() != axes.transData:
        is_high = line.get_transform() == axes.get_xaxis_transform(which="grid")
        if look["dashes"] in _NONE:
            return  # marks on the edge of the panel
        one, none = np.asarray(x if is_high else y)[:1], np.full(1, np.nan)
        look["x"], look["y"] = (one, none) if is_high else (none, one)
        look["x_end"] = np.asarray(y if is_high else x, float)
        yield Marks(kind="level", size=line.get_linewidth(), **look)
        return
    if look["dashes"] in _NONE:
        look["is_hollow"] = line.get_fillstyle() == "none"
        yield Marks(kind="point", x=x, y=y, size=line.get_markersize(), **look)
    else:
        look["dots"] = line.get_markersize() if line.get_marker() not in _NONE else 0.0
        yield Marks(kind="line", x=x, y=y, size=line.get_linewidth(), **look)


def _apart(segments: Any) -> tuple[Any, Any]:
    """x and y of segments as one line, with NaN between segments."""
    gap = np.full((1, 2), np.nan)
    pieces = [piece for segment in segments for piece in (segment, gap)]
    x, y = np.concatenate([np.empty((0, 2)), *pieces]).T
    return x, y


def _rows(marks: Marks) -> Iterator[Row]:
    if marks.kind == "level":
        return
    ends = [_text(end) for end in marks.x_end] or [""] * len(marks.x)
    rows = [
        (_cell(marks.series), marks.kind, _text(at), _text(value), end)
        for at, value, end in zip(marks.x, marks.y, ends, strict=True)
    ]
    yield from dict.fromkeys(rows) if marks.kind == "point" else rows


def _text(value: Any) -> str:
    """A number (empty for NaN) or a word of a categorical axis, as text for CSV."""
    if isinstance(value, str):
        return _cell(value)
    return f"{float(value):.6g}" if np.isfinite(value) else ""


def _cell(text: str) -> str:
    """The text, with a leading quote if a spreadsheet would take it for a formula."""
    return f"'{text}" if text[:1] in tuple("=+-@\t\r") else text


def _series(artist: Any) -> str:
    """The label of an artist; empty for automatic names of matplotlib."""
    label = str(artist.get_label())
    return "" if re.fullmatch(r"_child\d+|_nolegend_", label) else label.removeprefix("_")


def _panel(axes: Axes, panels: list[Axes]) -> dict[str, Any]:
    place: Any = axes.get_subplotspec()
    labels = _labels(axes)
    made: dict[str, Any] = {
        "title": axes.get_title(loc="left"),
        "row": place.rowspan.start + 1,
        "column": [place.colspan.start + 1, place.colspan.stop + 1],
        "texts": [_note(axes, text) for text in axes.texts],
        "marks": [_drawn(axes, m) for m in sorted(_marks(axes), key=lambda m: m.zorder)],
    }
    for which, label in zip("xy", labels, strict=True):
        shared = getattr(axes, f"get_shared_{which}_axes")().get_siblings(axes)
        made[which] = {
            "label": label,
            "limits": [float(end) for end in getattr(axes, f"get_{which}lim")()],
            "view": min(panels.index(one) for one in shared if one in panels),
            **_scale(getattr(axes, f"{which}axis")),
        }
    return made


def _scale(axis: Any) -> dict[str, Any]:
    transform = axis.get_transform()
    scale: dict[str, Any] = {"scale": axis.get_scale()}
    if hasattr(transform, "linthresh"):
        scale["threshold"] = float(transform.linthresh)
        scale["decades"] = float(transform.linscale / (1.0 - 1.0 / transform.base))
    if isinstance(axis.get_major_locator(), FixedLocator | StrCategoryLocator):
        places = axis.get_majorticklocs()
        names = axis.get_major_formatter().format_ticks(places)
        scale["words"] = [[float(p), name] for p, name in zip(places, names, strict=True)]
        # Whether tick labels are names, or only the numbers of their places.
        scale["named"] = not all(map(_is_number, places, names))
    return scale


def _is_number(place: float, name: str) -> bool:
    try:
        return math.isclose(float(name.replace("\N{MINUS SIGN}", "-")), place, rel_tol=1e-9)
    except ValueError:
        return not name


def _note(axes: Any, text: Any) -> dict[str, Any]:
    """A text in a panel with its position, in data coordinates or as a share of the panel."""
    x, y = text.get_position()
    if is_in_data := bool(text.get_transform() == axes.transData):
        x, y = axes.convert_xunits(x), axes.convert_yunits(y)
    look = {"ha": text.get_ha(), "va": text.get_va(), "in_data": is_in_data}
    return {"text": text.get_text(), "x": float(x), "y": float(y), **look}


def _drawn(axes: Any, marks: Marks) -> dict[str, Any]:
    x = np.asarray(axes.convert_xunits(marks.x), np.float32)
    y = np.asarray(axes.convert_yunits(marks.y), np.float32)
    size = np.broadcast_to(marks.size, x.shape)
    if marks.kind == "point":
        # once, and in their order
        _, first = np.unique(np.stack([x, y]), axis=1, return_index=True)
        x, y, size = (column[np.sort(first)] for column in (x, y, size))
    return {
        "series": marks.series,
        "kind": marks.kind,
        "colour": to_hex(marks.colour),
        "opacity": round(float(marks.colour[3]), 2),
        "size": _packed(size if np.unique(size).size > 1 else size[:1]),
        "dashes": marks.dashes,
        "dots": round(float(marks.dots), 2),
        "hollow": marks.is_hollow,
        "x": _packed(x),
        "y": _packed(y),
        "end": _packed(marks.x_end),
    }


def _packed(numbers: Any) -> str:
    return base64.b64encode(np.asarray(numbers, "<f4").tobytes()).decode()
