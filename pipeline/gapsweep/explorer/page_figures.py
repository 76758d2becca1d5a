"""The figures of the explorer's page, except its maps."""

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, DataRange1d, HoverTool, Range1d
from bokeh.plotting import figure

from gapsweep.explorer.page_results import (
    DECAY_TIMES,
    DOWN,
    REST,
    SAMPLES_PER_PERIOD,
    UP,
    Curve,
    Motion,
    Plane,
    decay_times,
)
from gapsweep.explorer.planes import Planes, blank, guide
from gapsweep.explorer.question import MAX_APPROXIMATIONS, Question, Scale
from gapsweep.model.labels import EXACT
from gapsweep.report.style import NOT_PERIODIC, NOT_SETTLED, colour, looks

_N_SHOWN = 8  # forcing periods in the time history
_ORDERS = 6  # multiples of the forcing frequency in the spectrum
_FLOOR = 1e-6  # smallest amplitude of the spectrum that is shown, relative to the largest
_MARKERS = {REST: "circle", UP: "triangle", DOWN: "inverted_triangle"}
_EXACT_SIZE, _SIZE = 6, 3.5  # pixels: of dots; the exact law behind is larger
_EXACT_WIDTH, _WIDTH = 3.0, 1.3  # pixels: width of lines
_DASHES = {"-": "solid", "--": "dashed", ":": "dotted", "-.": "dotdash"}

_RESPONSE = ("omega", "x_max", "colour", "fill", "law", "protocol", "kind", "unit")
_LINES = ("x", "y")
_BRANCH = (*_LINES, "colour", "dash")
_TIPS = [
    ("law", "@law, @protocol"),
    ("ω", "@omega{0.000} Hz"),
    ("peak", "@x_max{%.4g} @unit"),
    ("motion", "@kind"),
]


class Figures:
    """All figures of the page; initially empty.

    Attributes
    ----------
    response, phase, section, history, spectrum : figure
    planes : Planes
    """

    def __init__(self, question: Question) -> None:
        self._scale = question.machine.length(question.shown)
        self.response = blank("forcing frequency ω [Hz]", "", 330, title="Frequency response")
        self.response.y_range = DataRange1d(start=0.0)
        plane = "", "", 300
        self.phase = blank(*plane, title="Phase portrait")
        # With separate ranges, the numerical noise of a few points would fill the figure.
        self.section = blank(
            *plane, title="Stroboscopic section",
            x_range=self.phase.x_range, y_range=self.phase.y_range,
        )  # fmt: skip
        self.history = blank(
            "time t [s]", "", 230,
            title=f"Time history, {_N_SHOWN} forcing periods",
        )  # fmt: skip
        self.spectrum = blank(
            "frequency [Hz]", "", 300, y_axis_type="log",
            title=f"Amplitude spectrum to {_ORDERS} ω",
            x_range=Range1d(0.0, 1.0), y_range=Range1d(1e-6, 1.0),
        )  # fmt: skip
        self._branches = ColumnDataSource(_empty(_BRANCH), name="branches")
        self.response.multi_line(
            "x", "y", source=self._branches, line_color="colour", line_dash="dash", line_alpha=0.7
        )
        self._stored = self._dots("stored", "square", 7)
        # The exact law is behind: its visible dots are missed by the approximations.
        self._curves = {
            (slot, protocol): self._dots(
                f"response {slot} {protocol}", marker, _SIZE if slot else _EXACT_SIZE
            )
            for slot in range(MAX_APPROXIMATIONS + 1)
            for protocol, marker in _MARKERS.items()
            if slot == 0 or protocol == REST
        }
        self._lines = {
            name: [_line(getattr(self, name), name, n) for n in range(MAX_APPROXIMATIONS + 1)]
            for name in ("phase", "section", "history", "spectrum")
        }
        self.planes = Planes(question.machine)
        self._at = guide(self.response, "height", "solid")
        self._top = guide(self.response, "width")
        across = [(shown, "height") for shown in (self.phase, self.section)]
        self._walls = [
            [guide(shown, side) for shown, side in (*across, (self.history, "width"))]
            for _ in range(2)
        ]
        dots = [one for one in self.response.renderers if one.data_source is not self._branches]
        formats = {"@x_max": "printf"}
        self.response.add_tools(HoverTool(tooltips=_TIPS, renderers=dots, formatters=formats))

    def _dots(self, name: str, marker: str, size: float) -> ColumnDataSource:
        source = ColumnDataSource(_empty(_RESPONSE), name=name)
        self.response.scatter(
            "omega", "x_max", source=source, marker=marker, size=size, color="colour",
            fill_alpha="fill",
        )  # fmt: skip
        return source

    def look_at(self, question: Question) -> None:
        """Move the lines of frequency and walls, and remove results of other approximations."""
        self._scale = scale = question.machine.length(question.shown)
        self._name_axes(question)
        self._at.location = question.omega
        low, high = (
            wall / scale.factor if np.isfinite(wall) else None for wall in question.clearance
        )
        self._top.location = high
        for spans, wall in zip(self._walls, (low, high), strict=True):
            for span in spans:
                span.location = wall
        # Clear removed approximations, and sweeps of other parameters.
        for slot, source in self._curves.items():
            if slot[1] != REST or slot[0] > len(question.approximations):
                source.data = _empty(_RESPONSE)
        for drawn in self._lines.values():
            for source, _ in drawn[len(question.approximations) + 1 :]:
                source.data = _empty(_LINES)

    def _name_axes(self, question: Question) -> None:
        """Label all axes with the displacement that is shown."""
        length, speed = self._scale, question.machine.speed(question.shown)
        of_peaks = f"peak {length.label}"
        for shown in (self.phase, self.section):
            shown.xaxis.axis_label, shown.yaxis.axis_label = length.label, speed.label
        self.history.yaxis.axis_label = length.label
        self.response.yaxis.axis_label = of_peaks
        self.spectrum.yaxis.axis_label = f"amplitude of {length.label}"

    def show(self, question: Question, answer: Curve | Motion | Plane) -> None:
        """Draw a result of a question."""
        labels = (EXACT, *question.approximations)
        slot = labels.index(answer.label)
        if isinstance(answer, Plane):
            self.planes.show(slot, answer)
        elif isinstance(answer, Curve):
            self._curves[slot, answer.protocol].data = _response(answer, question, self._scale)
        else:
            self._show_motion(slot, _DASHES[looks(labels)[answer.label].dashes], answer)

    def _show_motion(self, slot: int, dash: str, motion: Motion) -> None:
        x, v, (section_x, section_v) = motion.x, motion.v, motion.section.T
        n = _N_SHOWN * SAMPLES_PER_PERIOD
        factor = self._scale.factor  # of displacements and velocities
        columns = {
            "phase": (x / factor, v / factor),
            "section": (section_x / factor, section_v / factor),
            "history": (motion.t[:n], x[:n] / factor),
            "spectrum": (motion.frequency, motion.spectrum / factor),
        }
        for name, values in columns.items():
            source, renderer = self._lines[name][slot]
            source.data = dict(zip(_LINES, values, strict=True))
            if name != "section":
                renderer.glyph.line_dash = dash
                renderer.glyph.line_color = colour(motion.label)
            else:
                renderer.glyph.line_color = renderer.glyph.fill_color = colour(motion.label)
        if slot == 0 and motion.spectrum.size:
            largest = 2.0 / factor * max(float(motion.spectrum.max()), 1e-12)
            self.spectrum.y_range.update(start=_FLOOR * largest, end=largest)
            self.spectrum.x_range.end = _ORDERS * motion.omega

    def show_stored(
        self, points: Sequence[Curve], branches: Sequence[tuple[str, bool, Any]]
    ) -> None:
        """Draw the points of a run, and its branches as lines: unstable ones dashed."""
        columns = [
            (*line.T, colour(label), "solid" if is_stable else "dashed")
            for label, is_stable, line in branches
        ]
        self._branches.data = {n: [row[i] for row in columns] for i, n in enumerate(_BRANCH)}
        tables = [
            _columns(each, [colour(each.label)], 0.0, ["click to open"], self._scale)
            for each in points
        ]
        self._stored.data = {
            name: [value for table in tables for value in table[name]] for name in _RESPONSE
        }


def legend(question: Question, motions: Iterable[Motion]) -> str:
    """HTML legend of colours and marks, with the period of each law's motion."""
    given = decay_times(question.model)
    kinds = {motion.label: _kind(motion, given) for motion in motions}
    exact = " and ".join(dict.fromkeys(law.family for law in question.laws(EXACT)))
    laws = "".join(
        f'<span style="margin-right:1.4em"><b style="color:{colour(label)}">●</b> '
        f"{f'{exact} (exact)' if label == EXACT else escape(label)}"
        f"{': ' + kinds[label] if label in kinds else ''}</span>"
        for label in (EXACT, *question.approximations)
    )
    marks = (
        "● from rest&ensp;▲ exact law, sweep up&ensp;▼ sweep down&ensp;"
        f'<b style="color:{NOT_PERIODIC}">○</b> not periodic (hollow; red: exact law)&ensp;'
        f'<b style="color:{NOT_SETTLED}">○</b> not settled (settling time: {given:.2g} of the '
        f"{DECAY_TIMES:g} decay times that a transient needs)&ensp;┈ walls"
    )
    return f'{laws}<br><span style="color:#555">{marks}</span>'


def _kind(motion: Motion, given: float) -> str:
    if motion.problem:
        return "fails"
    n = motion.period_multiple
    return f"period {n}" if n else "not settled" if given < DECAY_TIMES else "no period found"


def _response(curve: Curve, question: Question, scale: Scale) -> dict[str, Any]:
    """Columns of a computed curve; colour and fill of marks show the class of responses."""
    own, is_exact = colour(curve.label), curve.label == EXACT
    strange, name = NOT_PERIODIC if is_exact else own, "not periodic"
    if decay_times(question.model) < DECAY_TIMES:
        strange, name = NOT_SETTLED, "not settled"
    shades = np.where(curve.is_periodic, own, strange)
    kinds = [f"period {n}" if n else name for n in curve.period_multiple]
    return _columns(curve, shades, curve.is_periodic.astype(float), kinds, scale)


def _columns(
    curve: Curve, colours: Any, fill: Any, kinds: Sequence[str], scale: Scale
) -> dict[str, Any]:
    n = curve.omega.size
    return {
        "omega": curve.omega,
        "x_max": curve.x_max / scale.factor,
        "colour": np.broadcast_to(colours, n).tolist(),
        "fill": np.broadcast_to(fill, n),
        "law": [curve.label] * n,
        "protocol": [curve.protocol] * n,
        "kind": np.broadcast_to(kinds, n).tolist(),
        "unit": [scale.unit] * n,
    }


def _line(shown: figure, name: str, slot: int) -> tuple[ColumnDataSource, Any]:
    """Data source and renderer for the motion of a law in one figure."""
    source = ColumnDataSource(_empty(_LINES), name=f"{name} {slot}")
    if name == "section":
        return source, shown.scatter("x", "y", source=source, size=_SIZE if slot else _EXACT_SIZE)
    return source, shown.line("x", "y", source=source, line_width=_WIDTH if slot else _EXACT_WIDTH)


def _empty(columns: Sequence[str]) -> dict[str, Any]:
    # Lists, since an empty array of numbers is no list of colours.
    return {name: [] for name in columns}
