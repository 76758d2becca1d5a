"""The page of the explorer: sliders, and figures computed from their setting."""

from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from html import escape
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.events import Tap
from bokeh.layouts import column, row
from bokeh.models import Button, CustomJSTickFormatter, Div, RangeSlider, Select, Slider, TextInput

from gapsweep.errors import GapsweepError, ModelError
from gapsweep.explorer.latest import Latest
from gapsweep.explorer.page_figures import Figures, legend
from gapsweep.explorer.page_results import (
    BASINS,
    MAP,
    N_MAP,
    N_OMEGA,
    REST,
    Curve,
    Motion,
    Plane,
    answers,
    nearest,
)
from gapsweep.explorer.question import (
    MAX_APPROXIMATIONS,
    Dial,
    Question,
    asked,
    dials,
    labels,
    numbers,
)
from gapsweep.explorer.stored import StoredRun
from gapsweep.model.labels import EXACT, Representation
from gapsweep.report.style import NOT_PERIODIC

_SIDE = 300  # pixels
_FRAME = 60  # ms for the browser to draw the first figure before it gets others
_WARMING = "Compiling kernels (first run only, up to a minute) …"
_NOTE = (
    f"{N_OMEGA} frequencies: responses from rest, then frequency sweeps of the exact law. Compiled "
    "engine, rtol 1e-6, atol 1e-9 m or less. <code>gapsweep run</code> computes longer transients. "
    "Click a dot, an initial condition or a point of the map to see its motion."
)
# In dark mode the light page is inverted, with hues rotated back.
_TEMPLATE = """
{% block title %}gapsweep explore{% endblock %}
{% block postamble %}<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
:root { color-scheme: light; background: white; font-family: system-ui, sans-serif; }
body { margin: 12px 16px; }
@media (prefers-color-scheme: dark) { :root { filter: invert(0.92) hue-rotate(180deg); } }
</style>{% endblock %}
"""
# On a narrow screen the sliders stay above the figures that follow them.
_ABOVE = """@media (max-width: 700px) {
  :host { position: sticky; top: 0; z-index: 9; min-width: 100%; max-height: 42vh;
    overflow-y: auto; background: white; border-bottom: 1px solid #cccccc; }
}"""
_WORDS = ":host { font: 13px system-ui, sans-serif; line-height: 1.45; }"


class Page:
    """The page of one session: its sliders, its figures and the computing thread.

    Parameters
    ----------
    document : Document
        Bokeh document that gets the page.
    question : Question
        The initial setting.
    ranges : dict
        Ranges of sliders, as for `dials`.
    stored : StoredRun, optional
        A run whose points are shown.
    note : str
        A note on the figures; may be empty.
    """

    def __init__(
        self,
        document: Document,
        question: Question,
        ranges: dict[str, Any],
        stored: StoredRun | None,
        note: str = "",
    ) -> None:
        self._document, self._question, self._stored = document, question, stored
        self._note = note
        self._is_setting = False
        self._curves: dict[tuple[str, str], Curve] = {}
        self._motions: dict[str, Motion] = {}
        self._points: list[Curve] = []
        self._controls(question, ranges)
        self._figures = Figures(question)
        self._figures.look_at(question)
        self._figures.response.on_event(Tap, self._heeding(self._clicked))
        for (name, _), plane in self._figures.planes.figures.items():
            heed = self._start_clicked if name == BASINS else self._setting_clicked
            plane.on_event(Tap, self._heeding(heed))
        document.add_root(self._layout())
        document.title = "gapsweep explore"
        document.template = _TEMPLATE
        self._latest = Latest(answers, self._later(self._receive), self._later(self._refuse))
        document.on_session_destroyed(lambda _: self.stop())
        # Called once the session exists: Bokeh registers a callback twice, and refuses the page, if
        # the computing thread adds it while the session is made.
        document.add_next_tick_callback(self._begin)

    def _begin(self) -> None:
        if self._stored is None:
            self._ask()
        else:
            self._open_scene(next(iter(self._stored.scenes)))

    def stop(self) -> None:
        """End the computing thread."""
        self._latest.stop()

    # --- layout -----------------------------------------------------------------------------------

    def _controls(self, question: Question, ranges: dict[str, Any]) -> None:
        self._dials = {dial.name: dial for dial in dials(question, ranges)}
        self._sliders = {name: _slider(dial) for name, dial in self._dials.items()}
        self._put = {
            name: (self._sliders[name].value, number) for name, number in numbers(question).items()
        }
        for slider in self._sliders.values():
            slider.on_change("value", self._moved)
        low, high = question.band
        self._band = RangeSlider(
            title="Frequencies of the response [Hz]", name="band", start=min(0.1, low),
            end=2.0 * high, value=(low, high), step=min(0.1, high / 100.0), format="0[.]000",
            width=_SIDE,
        )  # fmt: skip
        self._band.on_change("value", self._moved)
        self._laws = TextInput(
            title=f"Approximations (up to {MAX_APPROXIMATIONS})", name="approximations",
            value=", ".join(question.approximations), placeholder="tanh-1e4, poly-13, ratpoly-5/3",
            width=_SIDE,
        )  # fmt: skip
        self._laws.on_change("value", self._moved)
        self._over = Select(
            title="Map over frequency and", name="over", value=question.over, width=_SIDE,
            options=[
                (name, dial.scale.title) for name, dial in self._dials.items() if name != "omega"
            ],
        )  # fmt: skip
        self._over.on_change("value", self._moved)
        machine = question.machine
        self._shown = _select("Displacement", "shown", question.shown, machine.displacements)
        self._plane = [
            _select(f"Basins, {way}", f"state {way}", name, machine.states)
            for way, name in zip(("across", "upwards"), question.plane, strict=True)
        ]
        # A single displacement leaves nothing to choose.
        several = [(self._shown, 1), *((each, 2) for each in self._plane)]
        self._choices = [choice for choice, least in several if len(choice.options) > least]
        for choice in self._choices:
            choice.on_change("value", self._moved)
        self._from_rest = Button(label="Show the motion from rest", width=_SIDE)
        self._from_rest.on_click(lambda: self._ask(start=()))
        self._status = Div(text=_WARMING, name="status", stylesheets=[_WORDS], width=_SIDE)
        self._legend = Div(
            text=legend(question, ()), name="legend", stylesheets=[_WORDS],
            sizing_mode="stretch_width",
        )  # fmt: skip

    def _layout(self) -> Any:
        head = Div(text="<b style='font-size:18px'>gapsweep explore</b>", stylesheets=[_WORDS])
        note = Div(text=_NOTE, stylesheets=[_WORDS], width=_SIDE)
        scenes = [] if self._stored is None else [self._scene_choice(self._stored)]
        if self._note:
            text = f"<b>{escape(self._note)}</b>"
            scenes.append(Div(text=text, name="note", stylesheets=[_WORDS], width=_SIDE))
        side = column(
            head, self._status, *scenes, *self._sliders.values(), self._band, self._laws,
            self._from_rest, self._over, *self._choices,
            note, width=_SIDE + 20, spacing=2, name="side",
            stylesheets=[_ABOVE],
        )  # fmt: skip
        shown = self._figures
        below = _side_by_side(shown.phase, shown.section, shown.spectrum)
        figures = shown.planes.figures
        planes = [_side_by_side(figures[name, 0], figures[name, 1]) for name in (BASINS, MAP)]
        main = column(
            self._legend, shown.response, below, shown.history, *planes,
            sizing_mode="stretch_width", min_width=320,
        )  # fmt: skip
        return _side_by_side(side, main)

    def _scene_choice(self, stored: StoredRun) -> Select:
        self._scene = Select(
            title="Parameter set of the run (squares: its points)", name="scene",
            options=list(stored.scenes),
            value=next(iter(stored.scenes)), width=_SIDE,
        )  # fmt: skip
        self._scene.on_change("value", lambda _attr, _old, new: self._open_scene(new))
        return self._scene

    # --- asking -----------------------------------------------------------------------------------

    def _moved(self, _attr: str, _old: Any, _new: Any) -> None:
        if not self._is_setting:
            self._ask()

    def _ask(self, **others: Any) -> None:
        """Compute results for the sliders; for values out of range, show the error only."""
        values = {name: self._read(name) for name in self._sliders}
        over = self._dials[self._over.value]
        kept = {"over": over.name, "over_values": over.along(N_MAP), "shown": self._shown.value}
        kept["plane"] = tuple(each.value for each in self._plane)
        try:
            if len({*kept["plane"]}) < 2:
                raise ModelError(f"basins: both states are {kept['plane'][0]}; choose two")
            approximations = labels(self._laws.value)
            question = asked(
                self._question, values, self._band.value,
                **{"approximations": approximations, **kept, **others},
            )  # fmt: skip
        except GapsweepError as error:
            self._refuse(self._question, str(error))
            return
        is_other = question.shown != self._question.shown
        self._question = question
        self._latest.ask(question)
        if is_other and self._stored is not None:
            self._show_stored(self._scene.value)

    def _read(self, name: str) -> float:
        """The value of a slider in SI units, exactly as set if the program has set it.

        Rounding by the logarithm of the slider would change a chaotic motion.
        """
        place = self._sliders[name].value
        put_at, number = self._put[name]
        return number if place == put_at else self._dials[name].at(place)

    def _set(self, values: dict[str, float]) -> None:
        """Set sliders to values in SI units, without starting a computation."""
        self._is_setting = True
        for name, value in values.items():
            slider, place = self._sliders[name], self._dials[name].place(value)
            slider.update(start=min(slider.start, place), end=max(slider.end, place))
            slider.value = place
            self._put[name] = place, value
        self._is_setting = False

    def _heeding(self, handler: Callable[[Tap], None]) -> Callable[[Tap], None]:
        """The handler of clicks, with errors shown on the page."""

        def heeded(event: Tap) -> None:
            try:
                handler(event)
            except GapsweepError as error:
                self._refuse(self._question, str(error))

        return heeded

    def _clicked(self, event: Tap) -> None:
        """Show the motion of the response nearest to the click."""
        low, high = self._question.band
        peaks = (float(np.nanmax(c.x_max, initial=1e-9)) for c in self._curves.values())
        # The figure is about three times as wide as high.
        scale = (high - low, 3.0 * max(peaks, default=1.0))
        shown = [*self._curves.values(), *self._points]
        length = self._question.machine.length(self._question.shown)
        found = nearest(shown, event.x, event.y * length.factor, scale)
        if found is not None:
            curve, k = found
            self._have(curve.label)
            self._set({"omega": float(curve.omega[k])})
            self._ask(start=tuple(curve.end[k].tolist()))

    def _start_clicked(self, event: Tap) -> None:
        """Show the motion from the initial condition clicked in the basins."""
        machine, start = self._question.machine, np.zeros(self._question.model.n_states)
        for name, place in zip(self._question.plane, (event.x, event.y), strict=True):
            start[machine.states.index(name)] = place * machine.state(name).factor
        self._ask(start=tuple(start.tolist()))

    def _setting_clicked(self, event: Tap) -> None:
        """Show the motion from rest at the clicked point of the map."""
        over = self._dials[self._question.over]  # parameter of the map's second axis
        low, high = self._question.band
        value = min(max(event.y, over.scaled(over.low)), over.scaled(over.high))
        self._set({"omega": min(max(event.x, low), high), over.name: over.at(value)})
        self._ask(start=())

    def _have(self, label: str) -> None:
        """Add the law of a stored point to the approximations; the last one goes if there are 3."""
        law = Representation(label)
        ours = labels(self._laws.value)
        if law in (EXACT, *ours) or law.is_auto or law.is_own:
            return
        self._is_setting = True
        self._laws.value = ", ".join((*ours[: MAX_APPROXIMATIONS - 1], law))
        self._is_setting = False

    def _open_scene(self, name: str) -> None:
        """Show the stored points of a parameter set of the run, and compute its figures."""
        assert self._stored is not None
        self._set(self._stored.scenes[name])
        self._ask(start=())
        self._show_stored(name)

    def _show_stored(self, scene: str) -> None:
        """Show the stored points of a parameter set, of the displacement that is shown."""
        if self._stored is not None:
            self._points = self._stored.points(scene, self._question)
            self._figures.show_stored(self._points, self._stored.branches(scene, self._question))

    # --- answering --------------------------------------------------------------------------------

    def _later(self, what: Callable[..., None]) -> Callable[..., None]:
        """A function for the thread that schedules a call in the document's event loop."""

        def soon(*given: Any) -> None:
            # The session may have ended meanwhile, and the document's contents with it.
            with suppress(AttributeError):
                self._document.add_next_tick_callback(partial(what, *given))

        return soon

    def _receive(self, question: Question, answer: Curve | Motion | Plane) -> None:
        """Show the first response at once, later results after the browser has drawn it."""
        if _is_first(answer):
            self._show(question, answer)
        else:
            self._document.add_timeout_callback(partial(self._show, question, answer), _FRAME)

    def _show(self, question: Question, answer: Curve | Motion | Plane) -> None:
        """Draw a result, unless its question is outdated, and update legend and status text."""
        is_first = _is_first(answer)
        # While a slider moves, only the first result of each question is shown.
        if question is not self._question and not is_first:
            return
        if is_first:
            self._curves, self._motions = {}, {}
            self._figures.look_at(question)
        self._figures.show(question, answer)
        if isinstance(answer, Curve):
            self._curves[answer.label, answer.protocol] = answer
        if isinstance(answer, Motion):
            # Not with the first curve: new text makes the browser lay out the page.
            self._motions[answer.label] = answer
            self._figures.planes.look_at(question, self._dials[question.over])
            self._status.text = self._words(question)
            self._legend.text = legend(question, self._motions.values())

    def _words(self, question: Question) -> str:
        machine = question.machine
        scales = [machine.state(name) for name in machine.states]
        several = zip(machine.states, scales, question.start, strict=True)
        state = ", ".join(
            f"{name} = {value / scale.factor:.4g} {scale.unit}".strip()
            for name, scale, value in several
            if value or machine.is_oscillator
        )
        state = state if any(question.start) else "rest"
        problems = [m.problem for m in self._motions.values() if m.problem]
        lines = [f"Motion at {question.omega:.4g} Hz from {state}", *map(escape, problems)]
        return "<br>".join(lines)

    def _refuse(self, _question: Question, problem: str) -> None:
        """Show an error message; the figures do not change."""
        self._status.text = f'<span style="color:{NOT_PERIODIC}">{escape(problem)}</span>'


def _is_first(answer: Curve | Motion | Plane) -> bool:
    return isinstance(answer, Curve) and (answer.label, answer.protocol) == (EXACT, REST)


# --- sliders --------------------------------------------------------------------------------------

_STEPS = 400


def _side_by_side(*figures: Any) -> Any:
    """A row of figures that wraps on narrow screens."""
    return row(*figures, sizing_mode="stretch_width", styles={"flex-wrap": "wrap"})


def _select(title: str, name: str, value: str, options: Iterable[str]) -> Select:
    return Select(title=title, name=name, value=value, options=[*options], width=_SIDE)


def _slider(dial: Dial) -> Slider:
    """The Bokeh slider of a dial, in decades if the dial is logarithmic."""
    low, high, value = map(dial.scaled, (dial.low, dial.high, dial.value))
    return Slider(
        title=dial.scale.label,
        name=dial.name,
        start=low,
        end=high,
        value=value,
        step=(high - low) / _STEPS,
        margin=(1, 5, 1, 5),
        format=CustomJSTickFormatter(code=dial.tick),
        width=_SIDE,
    )
