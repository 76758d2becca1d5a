"""Data of a figure: CSV for users, JSON for the page that draws it interactively."""

import base64
import csv
import io
import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.category import StrCategoryLocator
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator

from gapsweep.report.marks import EDGE, LEVEL, POINT, TEXT, Marks, marks_of

HEADER = ("panel", "series", "mark", "x", "y", "x_end")
_ABOUT = "# panel"  # prefix of the lines that describe panels
Row = tuple[str, ...]


def as_csv(figure: Figure) -> str:
    """Lines, points, bands and ticks of a figure as CSV, in the units of its axes.

    Lines that begin with # describe the panels and their axes. Points that agree to six digits
    occur once: many initial conditions lead to one attractor. Empty without marks, as of images,
    whose numbers are in the datasets, and of figures drawn without `put`.
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
        for marks in marks_of(axes):
            writer.writerows((number, *row) for row in _rows(marks))
    return text.getvalue()


def as_json(figure: Figure) -> str:
    """Panels of a figure as JSON for the page that draws them: marks, places, scales, styles.

    Numbers of marks are single precision, little-endian, in base64. Empty without marks, and if the
    panels do not form a grid (insets, a second axis).
    """
    panels = _panels(figure)
    places = [str(axes.get_subplotspec()) for axes in panels if axes.get_subplotspec()]
    is_grid = len(set(places)) == len(panels) and {a.name for a in panels} == {"rectilinear"}
    return json.dumps([_panel(axes, panels) for axes in panels]) if is_grid else ""


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """Data that a reader may choose for the panels of a figure, in place of what is drawn.

    Attributes
    ----------
    name : str
    limits : tuple of float
        Ends of the common vertical axis.
    panels : sequence of (str, sequence of Marks)
        Title and marks of each panel.
    """

    name: str
    limits: tuple[float, float]
    panels: Sequence[tuple[str, Sequence[Marks]]]


def choices_as_json(figure: Figure, choices: Iterable[Choice]) -> str:
    """Choices as JSON for the page of a figure; each appearance of marks is listed once.

    Empty without choices.
    """
    axes, looks = figure.axes[0], dict[str, int]()
    listed = []
    for choice in choices:
        panels = []
        for title, several in choice.panels:
            marks = []
            for each in (_drawn(axes, one) for one in several if one.kind not in (TEXT, EDGE)):
                x, y = each.pop("x"), each.pop("y")
                marks.append([looks.setdefault(json.dumps(each), len(looks)), x, y])
            panels.append({"title": title, "marks": marks})
        listed.append({"name": choice.name, "limits": choice.limits, "panels": panels})
    made = {"looks": [json.loads(look) for look in looks], "choices": listed}
    return json.dumps(made, separators=(",", ":")) if listed else ""


def label_of(axes: Axes, which: str) -> str:
    """The label of an axis, or the first label of panels that share it."""
    shared = getattr(axes, f"get_shared_{which}_axes")().get_siblings(axes)
    labels = [getattr(one, f"get_{which}label")() for one in (axes, *shared)]
    return next(filter(None, labels), "")


def _panels(figure: Figure) -> list[Axes]:
    panels = [axes for axes in figure.axes if axes.get_visible()]
    return panels if any(map(marks_of, panels)) else []


def _labels(axes: Axes) -> tuple[str, str]:
    """Labels of both axes, or else the labels of the whole figure."""
    figure: Any = axes.figure
    common = figure.get_supxlabel(), figure.get_supylabel()
    x, y = (label_of(axes, n) or alone for n, alone in zip("xy", common, strict=True))
    return x, y


def _rows(marks: Marks) -> Iterator[Row]:
    if marks.kind in (LEVEL, TEXT, EDGE):
        return
    x, y, ends = np.broadcast_arrays(marks.x, marks.y, marks.x_end if len(marks.x_end) else "")
    rows = [
        (_cell(marks.series or marks.entry), marks.kind, _text(at), _text(value), _text(end))
        for at, value, end in zip(x.tolist(), y.tolist(), ends.tolist(), strict=True)
    ]
    yield from dict.fromkeys(rows) if marks.kind == POINT else rows


def _text(value: Any) -> str:
    """A number (empty for NaN) or a word of a categorical axis, as text for CSV."""
    if isinstance(value, str):
        return _cell(value)
    return f"{float(value):.6g}" if np.isfinite(value) else ""


def _cell(text: str) -> str:
    """The text, with a leading quote if a spreadsheet would take it for a formula."""
    return f"'{text}" if text[:1] in tuple("=+-@\t\r") else text


def _panel(axes: Axes, panels: list[Axes]) -> dict[str, Any]:
    place: Any = axes.get_subplotspec()
    labels, marks = _labels(axes), marks_of(axes)
    made: dict[str, Any] = {
        "title": axes.get_title(loc="left"),
        "row": place.rowspan.start + 1,
        "column": [place.colspan.start + 1, place.colspan.stop + 1],
        "texts": [_note(each) for each in marks if each.kind == TEXT],
        "marks": [_drawn(axes, each) for each in marks if each.kind not in (TEXT, EDGE)],
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


def _note(text: Marks) -> dict[str, Any]:
    """A text in a panel with its place."""
    ha, va = text.align
    place = {"x": float(text.x), "y": float(text.y), "in_data": text.in_data}
    return {"text": text.series, "ha": ha, "va": va, **place}


def _drawn(axes: Any, marks: Marks) -> dict[str, Any]:
    x, y = np.broadcast_arrays(
        np.asarray(axes.convert_xunits(marks.x), np.float32).ravel(),
        np.asarray(axes.convert_yunits(marks.y), np.float32).ravel(),
    )
    size = np.broadcast_to(marks.size, x.shape)
    if marks.kind == POINT:
        # once, and in their order
        _, first = np.unique(np.stack([x, y]), axis=1, return_index=True)
        x, y, size = (column[np.sort(first)] for column in (x, y, size))
    return {
        "series": marks.series or marks.entry,
        "kind": marks.kind,
        "colour": marks.colour,
        "opacity": marks.opacity,
        "size": _packed(size if np.unique(size).size > 1 else size[:1]),
        "dashes": marks.dashes,
        "marker": marks.marker,
        "dots": marks.dots,
        "hollow": bool(marks.face),
        "x": _packed(x),
        "y": _packed(y),
        "end": _packed(marks.x_end),
    }


def _packed(numbers: Any) -> str:
    return base64.b64encode(np.asarray(numbers, "<f4").tobytes()).decode()
