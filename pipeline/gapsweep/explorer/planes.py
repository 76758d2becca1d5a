"""Basins and maps of the page: peaks over two numbers, for the exact law and an approximation."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from bokeh.models import (
    BasicTicker,
    ColorBar,
    ColumnDataSource,
    CustomJSTickFormatter,
    HoverTool,
    LinearColorMapper,
    Range1d,
    SingleIntervalTicker,
    Span,
)
from bokeh.plotting import figure

from gapsweep.explorer.page_results import BASINS, DECAY_TIMES, MAP, Plane, decay_times
from gapsweep.explorer.question import Dial, Question, SliderModel, numbers
from gapsweep.model.labels import EXACT
from gapsweep.report.style import CLASS_COLOURS, GREY, NOT_PERIODIC, NOT_SETTLED, sequence

_SLOTS = 2  # the exact law and the first approximation
_SHADES = 64
_ROWS = 8  # rows between two pictures: drawing takes longer than computing a row
_FAILED = CLASS_COLOURS["failed"]
_IMAGE = ("image", "x", "y", "dw", "dh")
_TOOLS = "pan,wheel_zoom,box_zoom,reset,save"


class Planes:
    """The figures of all planes; initially empty.

    Attributes
    ----------
    figures : mapping of (str, int) to figure
        Basins and maps, of the exact law (0) and the first approximation (1).
    """

    def __init__(self, machine: SliderModel) -> None:
        self._machine = machine
        # Both laws share the colour scale and the ranges of the axes.
        self._peaks = {
            name: LinearColorMapper(sequence(_SHADES), low=0.0, high=1.0, nan_color=_FAILED)
            for name in (BASINS, MAP)
        }
        drawn = {
            (name, slot): _plane(name, slot, mapper)
            for name, mapper in self._peaks.items()
            for slot in range(_SLOTS)
        }
        self._bars = [one.select_one({"type": ColorBar}) for one, _ in drawn.values()]
        self.figures: Mapping[tuple[str, int], figure] = {at: one for at, (one, _) in drawn.items()}
        self._images = {at: sources for at, (_, sources) in drawn.items()}
        for name in (BASINS, MAP):
            exact, other = (self.figures[name, slot] for slot in range(_SLOTS))
            other.x_range, other.y_range = exact.x_range, exact.y_range
        self._marks = {
            at: [guide(shown, side) for side in ("height", "width")]
            for at, shown in self.figures.items()
        }
        self._shown: dict[tuple[str, int], Any] = {}
        # Parameter, titles and labels of the present question.
        self._over: Dial
        self._titles: dict[str, str] = {}
        self._labels: tuple[str, ...] = ()

    def look_at(self, question: Question, over: Dial) -> None:
        """Move the marks to the question's place, and clear planes of other settings."""
        self._question, self._over = question, over
        here = {
            BASINS: [self._of_state(question, name) for name in question.plane],
            MAP: (question.omega, over.place(numbers(question)[over.name])),
        }
        depends_on = {BASINS: question.of_basins, MAP: question.of_map}
        length = self._machine.length(question.shown)
        for bar in self._bars:
            of = length.unit and f" [{length.unit}]"
            bar.title = f"peak{'' if self._machine.is_oscillator else f' {length.title}'}{of}"
        self._titles = {
            BASINS: f"Peak by initial condition, {question.omega:.4g} Hz",
            MAP: f"Peak from rest over ω and {over.scale.title.split()[-1]}",
        }
        self._labels = (EXACT, *question.approximations)[:_SLOTS]
        for (name, slot), shown in self.figures.items():
            for mark, place in zip(self._marks[name, slot], here[name], strict=True):
                mark.location = place
            shown.visible = slot < len(self._labels)
            wanted = shown.visible and (self._labels[slot], depends_on[name])
            if self._shown.get((name, slot)) != wanted:
                self._shown[name, slot] = wanted
                self._clear(name, slot)

    def _of_state(self, question: Question, name: str) -> float:
        """Initial value of a state, in the shown unit."""
        value = question.start[self._machine.states.index(name)]
        return value / self._machine.state(name).factor

    def _clear(self, name: str, slot: int) -> None:
        for source in self._images[name, slot]:
            if source.data["image"]:
                source.data = {each: [] for each in _IMAGE}
        shown = self.figures[name, slot]
        if shown.visible:
            shown.title.text = f"{self._titles[name]}, {self._labels[slot]}: computing …"

    def show(self, slot: int, plane: Plane) -> None:
        """Draw the computed part of a plane, every 8 rows and at the end."""
        is_map, (m, n) = plane.name == MAP, plane.x_max.shape
        if m % _ROWS and m < len(plane.y):
            return
        here = self._question
        axes = [self._machine.state(name) for name in here.plane]
        x = plane.x if is_map else plane.x / axes[0].factor
        y = plane.y / axes[1].factor
        if is_map:
            y = np.array(list(map(self._over.place, plane.y)))
        factor = self._machine.length(here.shown).factor
        wide, high = x[1] - x[0], y[1] - y[0]
        left, bottom = x[0] - wide / 2, y[0] - high / 2
        corner = {"x": [left], "y": [bottom], "dw": [n * wide], "dh": [m * high]}
        is_strange = ~plane.is_periodic & np.isfinite(plane.x_max)
        rows = [here.at(self._over.name, each) for each in plane.y[:m]] if is_map else [here]
        has_time = [[decay_times(each.model) >= DECAY_TIMES] for each in rows]
        pictures = plane.x_max / factor, np.where(is_strange, has_time, np.nan)
        for source, picture in zip(self._images[plane.name, slot], pictures, strict=True):
            source.data = {"image": [picture], **corner}
        shown = self.figures[plane.name, slot]
        shown.title.text = f"{self._titles[plane.name]}: {self._labels[slot]}"
        shown.axis.visible = True
        if is_map:
            shown.yaxis.axis_label = self._over.scale.label
            shown.yaxis.formatter = CustomJSTickFormatter(code=self._over.tick)
            decades = SingleIntervalTicker(interval=1.0, num_minor_ticks=0)
            shown.yaxis.ticker = decades if self._over.is_log else BasicTicker()
        else:
            shown.xaxis.axis_label, shown.yaxis.axis_label = (axis.label for axis in axes)
        if slot == 0:
            shown.x_range.update(start=left, end=left + len(x) * wide)
            shown.y_range.update(start=bottom, end=bottom + len(y) * high)
            self._peaks[plane.name].high = max(float(np.nanmax(pictures[0], initial=0.0)), 1e-9)


def _plane(
    name: str, slot: int, peaks: LinearColorMapper
) -> tuple[figure, tuple[ColumnDataSource, ...]]:
    """Figure of a plane, and the data sources of its images: peaks, and not periodic cells."""
    words = ("", "") if name == BASINS else ("forcing frequency ω [Hz]", "")
    ranges = {"x_range": Range1d(0.0, 1.0), "y_range": Range1d(0.0, 1.0)}
    shown = blank(*words, 330, min_width=320, **ranges)
    strange = LinearColorMapper(
        [NOT_SETTLED, NOT_PERIODIC], low=0.0, high=1.0, nan_color="#00000000"
    )
    sources = []
    for mapper, what in ((peaks, "peaks"), (strange, "not periodic")):
        source = ColumnDataSource({each: [] for each in _IMAGE}, name=f"{name} {slot} {what}")
        shown.image(**{each: each for each in _IMAGE}, source=source, color_mapper=mapper)
        sources.append(source)
    shown.grid.visible = shown.axis.visible = False
    shown.add_layout(ColorBar(color_mapper=peaks, width=10), "right")
    tips = [("peak", "@image{%.4g}")]
    formats = {"@image": "printf"}
    shown.add_tools(HoverTool(tooltips=tips, renderers=shown.renderers[:1], formatters=formats))
    return shown, tuple(sources)


def blank(x: str, y: str, height: int, *, min_width: int = 250, **how: Any) -> figure:
    """An empty Bokeh figure with these axis labels."""
    made = figure(
        height=height, sizing_mode="stretch_width", tools=_TOOLS, active_drag=None,
        x_axis_label=x, y_axis_label=y, output_backend="canvas", min_width=min_width, **how,
    )  # fmt: skip
    made.toolbar.logo = None
    made.toolbar.autohide = True
    made.outline_line_color = None
    made.grid.grid_line_color = "#dddddd"
    made.axis.axis_label_text_font_style = "normal"
    return made


def guide(shown: figure, dimension: str, dash: str = "dotted") -> Span:
    """Add a grey line across the whole figure, and return it."""
    span = Span(dimension=dimension, line_color=GREY, line_dash=dash)
    shown.add_layout(span)
    return span
