"""Marks: what a panel of a figure shows, as values.

Functions of figures yield marks. `put` draws them with matplotlib and keeps them: from them
`gapsweep.report.figure_data` writes the files that the page draws and that users download.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

POINT, LINE, TICK, BAND, LEVEL = "point", "line", "tick", "band", "level"
TEXT, EDGE = "text", "edge"
_ORDER = {BAND: 0.0, LEVEL: 1.6, TEXT: 3.0}
_MANY = 60  # points; more are rasterized, to limit the size of the file
# The marks that each artist of matplotlib was drawn from, as long as it is in its panel.
_DRAWN: "WeakKeyDictionary[Artist, Marks]" = WeakKeyDictionary()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Marks:
    """Marks of one appearance, in the units of their axes."""

    # `POINT`; `LINE`; `TICK` above the panel; `BAND` behind it, from `x` to `x_end`; `LEVEL`, no
    # data, at one `x` or `y` from the first to the second share of the panel in `x_end`; `TEXT`,
    # which is `series`; `EDGE`, symbols on the right frame, which are no data.
    kind: str
    # `x`, `y`: numbers, or words on an axis of words; NaN: a gap of a line, or the whole panel.
    x: Any = np.nan
    y: Any = np.nan
    x_end: Any = ()
    series: str = ""  # name of the data; the label of a representation comes first
    entry: str = ""  # text in the legend; empty: none
    colour: str = "#000000"
    opacity: float = 1.0
    size: Any = 1.0  # width of a line, diameter of points, or of each point [points]
    # `dashes`, `marker`: line style and symbol of matplotlib; a line has symbols of the diameter
    # `dots` [points].
    dashes: str = "-"
    marker: str = "o"
    dots: float = 0.0
    face: str = ""  # colour inside symbols, ``"none"`` if hollow; empty: `colour`
    zorder: float | None = None
    sets: Any = None  # which values set the vertical axis, others may be outside it; None: all
    align: tuple[str, str] = ("left", "baseline")  # horizontal and vertical alignment of a text
    in_data: bool = True  # whether the place of a text is in data; else it is a share of the panel
    is_clipped: bool = True  # whether marks end at the frame

    @property
    def order(self) -> float:
        """Order of drawing, from back to front."""
        return _ORDER.get(self.kind, 2.0) if self.zorder is None else self.zorder


# Marks of one kind, from the other attributes.
points: Callable[..., Marks] = partial(Marks, kind=POINT)
line: Callable[..., Marks] = partial(Marks, kind=LINE)
ticks: Callable[..., Marks] = partial(Marks, kind=TICK)
band: Callable[..., Marks] = partial(Marks, kind=BAND)
level: Callable[..., Marks] = partial(Marks, kind=LEVEL, x_end=(0.0, 1.0))
text: Callable[..., Marks] = partial(Marks, kind=TEXT)
edge: Callable[..., Marks] = partial(Marks, kind=EDGE)
# A legend entry without data.
key: Callable[..., Marks] = partial(Marks, kind=POINT, x=(), y=(), size=4.0)


def bars(x: Any, low: Any, high: Any, **style: Any) -> Marks:
    """Vertical bars, as a line with gaps."""
    gap = np.full(np.shape(x), np.nan)
    places, ends = (np.stack(each, axis=-1).ravel() for each in ((x, x, gap), (low, high, gap)))
    return line(x=places, y=ends, **style)


def flat_bars(low: Any, high: Any, y: Any, **style: Any) -> Marks:
    """Horizontal bars, as a line with gaps."""
    upright = bars(y, low, high, **style)
    return replace(upright, x=upright.y, y=upright.x)


def put(axes: "Axes", *several: Iterable[Marks]) -> None:
    """Draw marks into axes, with their legend entries."""
    for each in chain(*several):
        draw = _DRAW.get(each.kind, _data)
        label = each.entry or f"_{each.series}"
        artist = draw(axes, each, {"label": label, "zorder": each.order})
        if np.size(each.x):
            _DRAWN[artist] = each


def marks_of(axes: "Axes") -> list[Marks]:
    """The marks in a panel, from back to front."""
    drawn = [_DRAWN[artist] for artist in axes.get_children() if artist in _DRAWN]
    return sorted(drawn, key=lambda marks: marks.order)


def _data(axes: "Axes", marks: Marks, look: dict[str, Any]) -> "Artist":
    """Draw a line, or points."""
    from matplotlib.lines import Line2D

    is_line, n = marks.kind == LINE, np.size(marks.x)
    look |= {"alpha": marks.opacity, "clip_on": marks.is_clipped}
    edge = 0.6 if marks.face or marks.marker in "|x+" else 0.0
    if np.ndim(marks.size):
        area, face = np.square(marks.size), marks.face or marks.colour
        look |= {"facecolors": face, "edgecolors": marks.colour, "linewidths": 0.8}
        # Rasterized early, since each dot is a separate path.
        return axes.scatter(marks.x, marks.y, area, rasterized=n > _MANY / 4, **look)
    look |= {"color": marks.colour, "markerfacecolor": marks.face or marks.colour}
    look |= {"linestyle": marks.dashes if is_line else "none", "markeredgewidth": edge}
    look |= {"marker": marks.marker if not is_line or marks.dots else "none"}
    look |= {"markersize": marks.dots} if is_line else {"markersize": marks.size}
    look |= {"linewidth": marks.size} if is_line else {"rasterized": n > _MANY}
    if marks.sets is None:
        return axes.plot(marks.x, marks.y, **look)[0]
    artist = axes.add_artist(Line2D(marks.x, marks.y, **look))  # unlike plot, changes no limits
    places = np.column_stack([marks.x, marks.y])
    axes.update_datalim(places, updatey=False)
    axes.update_datalim(places[np.broadcast_to(marks.sets, n)])
    axes.autoscale_view()
    return artist


def _ticks(axes: "Axes", marks: Marks, look: dict[str, Any]) -> "Artist":
    look |= {"transform": axes.get_xaxis_transform(), "clip_on": False}
    return axes.vlines(marks.x, 1.0, 1.04, colors=marks.colour, **look)


def _bands(axes: "Axes", marks: Marks, look: dict[str, Any]) -> "Artist | None":
    """Draw bands; returns the first one."""
    low, label = np.asarray(marks.x), look.pop("label")
    look |= {"color": marks.colour, "antialiased": False, "align": "edge"}
    widths = np.asarray(marks.x_end) - low
    bars = axes.bar(low, 1.0, widths, transform=axes.get_xaxis_transform(), **look).patches
    for bar in bars:
        bar.set_label(label)
        bar.sticky_edges.y.clear()  # their heights are shares of the axis
    return next(iter(bars), None)


def _level(axes: "Axes", marks: Marks, look: dict[str, Any]) -> "Artist":
    from matplotlib.lines import Line2D

    look |= {"color": marks.colour, "linewidth": marks.size, "linestyle": marks.dashes}
    is_high = np.isnan(marks.y)
    low, high = marks.x_end
    if marks.sets is None:
        draw: Any = axes.axvline if is_high else axes.axhline
        artist: Artist = draw(marks.x if is_high else marks.y, low, high, **look)
        return artist
    across = axes.get_xaxis_transform() if is_high else axes.get_yaxis_transform()
    at = ([marks.x] * 2, (low, high)) if is_high else ((low, high), [marks.y] * 2)
    return axes.add_artist(Line2D(*at, transform=across, **look))


def _edge(axes: "Axes", marks: Marks, look: dict[str, Any]) -> "Artist":
    look |= {"transform": axes.get_yaxis_transform(), "clip_on": False, "color": marks.colour}
    places = np.ones(np.size(marks.y))
    (line,) = axes.plot(places, marks.y, marks.marker, markersize=marks.size, **look)
    line.set_in_layout(False)
    return line


def _text(axes: "Axes", marks: Marks, look: dict[str, Any]) -> "Artist":
    del look["label"]
    where = axes.transData if marks.in_data else axes.transAxes
    look |= dict(zip(("ha", "va"), marks.align, strict=True)) | {"color": marks.colour}
    look |= {"fontsize": marks.size, "transform": where, "clip_on": marks.in_data}
    return axes.text(marks.x, marks.y, marks.series, **look)


_DRAW: dict[str, Any] = {TICK: _ticks, BAND: _bands, LEVEL: _level, TEXT: _text, EDGE: _edge}
