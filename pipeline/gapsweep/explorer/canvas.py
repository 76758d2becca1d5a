"""What every figure of the page begins as."""

from typing import Any

from bokeh.models import Span
from bokeh.plotting import figure

_TOOLS = "pan,wheel_zoom,box_zoom,reset,save"


def blank(x: str, y: str, height: int, *, min_width: int = 250, **how: Any) -> figure:
    """An empty figure with these labels."""
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
    """A grey line through the whole figure."""
    span = Span(dimension=dimension, line_color="#888888", line_dash=dash)
    shown.add_layout(span)
    return span
