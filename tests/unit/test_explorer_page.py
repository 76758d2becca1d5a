"""Results and questions of the page of `gapsweep explore`, without a browser."""

import asyncio
import gc
import json
import re
import stat
import subprocess
import sys
import threading
import tomllib
import urllib.request
from dataclasses import replace
from pathlib import Path
from urllib.parse import urljoin, urlsplit

import numpy as np
import psutil
import pytest
import xarray as xr
from bokeh.document import Document
from tests.builders.datasets import branches, datasets, periodic, tables
from tests.builders.runs import wait_until
from tests.builders.studies import PAPER, TWO_MASSES, changed
from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

import gapsweep as gs
from gapsweep.cli.main import exit_code
from gapsweep.errors import GapsweepError, ModelError
from gapsweep.explorer import page_results as shown
from gapsweep.explorer.first_question import not_computed, of_model, of_study
from gapsweep.explorer.latest import Latest
from gapsweep.explorer.page import Page
from gapsweep.explorer.page_figures import Figures, legend
from gapsweep.explorer.page_results import (
    BASINS,
    DOWN,
    MAP,
    NATURAL_PERIODS,
    REST,
    SAMPLES_PER_PERIOD,
    UP,
    Motion,
    Plane,
    answers,
    basins,
    decay_times,
    from_rest,
    motion,
    nearest,
    response_map,
    sweeps,
)
from gapsweep.explorer.question import EXACT, asked, dials, labels, numbers
from gapsweep.explorer.stored import StoredRun
from gapsweep.report.style import NOT_PERIODIC, NOT_SETTLED

SOON = 30.0  # seconds that something may take before a test gives up
FREE = gs.Piecewise(K_c=0.0, gap=gs.Gap(1e-3, 1e-3))
LINEAR = gs.systems.paper_oscillator(alpha=0.0)


def linear_amplitude(oscillator, omega):
    """Amplitude of a forced linear oscillator, from its transfer function."""
    ratio = omega / oscillator.omega_n
    static = oscillator.forcing / (oscillator.mass * oscillator.omega_n_rad**2)
    return static / np.hypot(1.0 - ratio**2, 2.0 * oscillator.zeta * ratio)


# --- questions ------------------------------------------------------------------------------------


def test_the_numbers_of_the_sliders_make_the_question():
    law = gs.Tanh(K_c=2e4, gap=gs.Gap(1e-4, 3e-4), K_ratio=0.5, epsilon=1e5)
    question = of_model(gs.systems.paper_oscillator(alpha=-1e8, zeta=0.0), law, approximations=())
    assert asked(question, numbers(question)) == question


def test_every_slider_can_reach_where_it_starts():
    strange = gs.systems.paper_oscillator(alpha=-1e8, zeta=0.0, forcing=0.0)
    for dial in dials(of_model(strange, FREE)):
        assert dial.low <= dial.value <= dial.high, dial.name
        assert dial.low < dial.high, dial.name


def test_a_study_gives_the_ranges():
    study = gs.Study.from_dict(
        {
            "study": {"name": "ranges"},
            "oscillator": PAPER | {"mass": 2.0},
            "sweep": [
                {
                    "representation": ["piecewise@fine", "poly-7"],
                    "K_c": [1e3, 1e6],
                    "gap": [[1e-4, 2e-4], [3e-4, 2e-4]],
                    "zeta": [0.01, 0.2],
                    "omega": {"start": 4.0, "stop": 12.0, "num": 9},
                }
            ],
            "protocol": {"fine": {"rtol": 1e-10}},
        }
    )
    question, ranges = of_study(study)
    found = {dial.name: dial for dial in dials(question, ranges)}
    assert question.band == (4.0, 12.0)
    assert question.approximations == ("poly-7",)
    assert question.model.mass == 2.0
    assert (found["K_c"].low, found["K_c"].high) == (1e3, 1e6)
    assert (found["zeta"].low, found["zeta"].high) == (0.01, 0.2)
    assert (found["j_1"].low, found["j_1"].high) == pytest.approx((0.1, 0.3))
    assert found["j_2"].value == pytest.approx(0.2)


def test_a_study_of_blocks_starts_where_one_has_a_point():
    study = gs.Study.load("workflows/paper/study.toml")
    question, _ = of_study(study)
    K_c, gap = numbers(question)["K_c"], question.gap("x").label
    study.select(K_c=K_c, gap=gap)  # raises if no block asks for it


@pytest.mark.parametrize(
    ("model", "law", "said"),
    [
        (gs.systems.typical_section(speed=12.0), None, "needs a forcing"),
        (3.0, None, r"must be a gapsweep\.Oscillator, a gapsweep\.System"),
        (gs.systems.typical_section, None, "speed: has no default"),
        (gs.systems.two_masses(), {"wall": FREE}, r"must name \['stop'\]"),
    ],
)
def test_what_has_no_page_is_refused(model, law, said):
    with pytest.raises(ModelError, match=said):
        of_model(model, law)


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("os:system", "cannot be typed"),
        ("auto", "cannot be typed"),
        ("tanh-1e4 tanh-1e5 tanh-1e6 poly-3", "must be <= 3"),
        ("tangent", "unknown representation"),
    ],
)
def test_labels_that_cannot_be_shown_are_refused(typed, said):
    with pytest.raises(ModelError, match=said):
        labels(typed)


def test_approximations_are_typed_as_one_likes():
    assert labels("tanh-10000,poly-13  piecewise, tanh-1e4") == ("tanh-1e4", "poly-13")


# --- answers --------------------------------------------------------------------------------------


def test_the_response_of_a_linear_oscillator_is_its_transfer_function():
    curve = from_rest(of_model(LINEAR, FREE), EXACT)
    assert len(curve.omega) == 200
    np.testing.assert_allclose(curve.x_max, linear_amplitude(LINEAR, curve.omega), rtol=1e-4)
    assert curve.is_periodic.all()


def test_a_force_by_pieces_stays_one_when_a_slider_moves(monkeypatch):
    monkeypatch.setattr(shown, "N_OMEGA", 3)
    force = gs.Switched([0.0, 0.25, 0.75], [4.0, -4.0, 4.0])
    wave = gs.Oscillator(mass=3.0, omega_n=5.0, zeta=0.05, forcing=force)
    question = of_model(wave, FREE).at("zeta", 0.1)
    found = gs.respond(replace(wave, zeta=0.1), FREE, shown.frequencies(question))
    np.testing.assert_allclose(from_rest(question, EXACT).x_max, found.x_max, rtol=1e-4)


def test_sweeps_of_a_hardening_spring_differ_where_two_motions_are_stable():
    question = of_model(gs.systems.paper_oscillator(), FREE)
    last = {curve.protocol: curve for curve in sweeps(question)}
    up, down = last[UP], last[DOWN]
    assert np.array_equal(up.omega, down.omega[::-1])
    higher = up.x_max > 2.0 * down.x_max[::-1]
    # One stretch of frequencies, with one motion on either side.
    assert np.count_nonzero(np.diff(higher.astype(int)) == 1) == 1
    assert higher.any()
    assert not higher[0]


def test_the_motion_of_a_linear_oscillator_is_a_sine():
    question = of_model(LINEAR, FREE)
    found = motion(question, EXACT)
    amplitude = linear_amplitude(LINEAR, question.omega)
    assert found.period_multiple == 1
    k = int(np.argmax(found.spectrum))
    assert found.frequency[k] == pytest.approx(question.omega)
    assert found.spectrum[k] == pytest.approx(amplitude, rel=1e-4)
    v = 2.0 * np.pi * question.omega * amplitude
    np.testing.assert_allclose(np.hypot(found.x / amplitude, found.v / v), 1.0, rtol=1e-4)
    assert len(found.section) == 120
    np.testing.assert_allclose(found.section, np.tile(found.section[0], (120, 1)), atol=1e-4 * v)


def test_a_motion_starts_where_the_question_says():
    # Between the jumps a hardening spring has two motions; each start stays on its own.
    question = of_model(gs.systems.paper_oscillator(), FREE)
    up, down = {curve.protocol: curve for curve in sweeps(question)}.values()
    k = int(np.argmax(up.x_max - down.x_max[::-1]))
    peaks = []
    for curve, row in ((up, k), (down, len(up.omega) - 1 - k)):
        state = tuple(curve.end[row].tolist())
        here = replace(question.at("omega", curve.omega[row].item()), start=state)
        peaks.append(motion(here, EXACT).x.max())
        # A peak between two samples, four times as sharp as that of a sine.
        between = 0.5 * 4.0 * (np.pi / SAMPLES_PER_PERIOD) ** 2
        assert peaks[-1] == pytest.approx(curve.x_max[row], rel=between)
    assert peaks[0] > 2.0 * peaks[1]


def test_what_is_looked_at_first_comes_first():
    question = of_model(approximations=("tanh-1e4",))
    first = [next(found) for found in [answers(question)] for _ in range(4)]
    kinds = [(type(answer).__name__, answer.label) for answer in first]
    laws = (EXACT, "tanh-1e4")
    assert kinds == [(kind, law) for law in laws for kind in ("Curve", "Motion")]


def test_the_planes_come_last_of_the_exact_law_and_one_approximation(monkeypatch):
    monkeypatch.setattr(shown, "N_STARTS", 3)
    monkeypatch.setattr(shown, "N_MAP", 3)
    question = replace(of_model(approximations=("tanh-1e4", "poly-13")), over_values=(1e3, 1e4))
    every = list(answers(question))
    found = [answer for answer in every if isinstance(answer, Plane)]
    assert every[-len(found) :] == found
    laws = (EXACT, "tanh-1e4")
    asked_for = [(name, law) for name in (BASINS, MAP) for law in laws]
    assert list(dict.fromkeys((plane.name, plane.label) for plane in found)) == asked_for


def test_every_start_of_a_linear_oscillator_ends_alike():
    question = of_model(LINEAR, FREE)
    *_, plane = basins(question, EXACT, 2e-3)
    assert plane.x_max.shape == (len(plane.y), len(plane.x))
    assert plane.is_periodic.all()
    expected = linear_amplitude(LINEAR, question.omega)
    np.testing.assert_allclose(plane.x_max, expected, rtol=1e-3)


def test_basins_are_those_of_the_grid_of_starts():
    # Between the jumps a hardening spring has two motions.
    question = of_model(gs.systems.paper_oscillator(), FREE).at("omega", 11.0)
    *_, plane = basins(question, EXACT, 5e-3)
    found = gs.basins(question.model, FREE, 11.0, x=plane.x, v=plane.y, rtol=1e-6, atol=1e-9)
    peaks = np.append(found["x_max"].values, np.nan)[found["attractor"].values]
    assert found.sizes["attractor_number"] == 2
    np.testing.assert_allclose(plane.x_max, peaks, rtol=1e-3)


def test_the_map_varies_what_it_says():
    dampings = (0.01, 0.1)
    question = replace(of_model(LINEAR, FREE), over="zeta", over_values=dampings)
    *_, plane = response_map(question, EXACT)
    for zeta, x_max in zip(dampings, plane.x_max, strict=True):
        expected = linear_amplitude(replace(LINEAR, zeta=zeta), plane.x)
        np.testing.assert_allclose(x_max, expected, rtol=1e-3)


def test_places_on_a_slider_are_values_there_and_back():
    for dial in dials(of_model()):
        values = dial.along(5)
        assert values[0] == pytest.approx(dial.low * dial.scale.factor)
        assert values[-1] == pytest.approx(dial.high * dial.scale.factor)
        places = [dial.place(value) for value in values]
        np.testing.assert_allclose(np.diff(places), places[1] - places[0], rtol=1e-9)


def test_a_motion_that_fails_says_so():
    runaway = of_model(gs.systems.paper_oscillator(alpha=-1e10, forcing=1e3), FREE)
    found = motion(runaway, EXACT)
    assert isinstance(found, Motion)
    assert found.problem.startswith("piecewise: the motion fails")


def test_little_damping_bounds_what_a_redraw_costs():
    steady = shown.settled(gs.systems.paper_oscillator(zeta=0.0))
    assert steady.t_max == pytest.approx(NATURAL_PERIODS / 5.0)


@pytest.mark.parametrize("zeta", [0.0, 1e-3, 0.01, 0.02, 0.5, 3.0])
def test_the_settling_time_that_is_stated_is_the_one_that_is_used(zeta):
    oscillator = gs.systems.paper_oscillator(zeta=zeta, alpha=0.0)
    given = shown.settled(oscillator).t_max * oscillator.settling_rate
    assert decay_times(oscillator) == pytest.approx(given)
    (stated,) = re.findall(r"([0-9.]+) of the 13 decay times", legend(of_model(oscillator), ()))
    assert float(stated) == pytest.approx(given, rel=0.05)


def looked_at(question):
    """The figures of a question, as if its motion had been shown."""
    found = Figures(question)
    found.look_at(question)
    found.planes.look_at(question, {dial.name: dial for dial in dials(question)}[question.over])
    return found


@pytest.mark.parametrize(("zeta", "is_given"), [(1e-3, False), (0.03, True)])
def test_what_has_not_settled_is_grey_and_called_so(zeta, is_given):
    """A nearly linear response that had 0.65 of 13 decay times is none that is not periodic."""
    question = of_model(
        gs.systems.paper_oscillator(zeta=zeta), gs.Piecewise(1e3, gs.Gap(0.4e-3, 0.4e-3))
    )
    curve = from_rest(question, EXACT)
    kind = gs.ResponseClass.UNRESOLVED
    curve = replace(curve, response_class=np.full(200, kind), period_multiple=np.zeros(200, int))
    found = looked_at(question)
    found.show(question, curve)
    (drawn,) = (
        each for each in found.response.renderers if each.data_source.name == f"response 0 {REST}"
    )
    data = drawn.data_source.data
    assert set(data["colour"]) == {NOT_PERIODIC if is_given else NOT_SETTLED}
    assert set(data["kind"]) == {"not periodic" if is_given else "not settled"}
    nothing = np.zeros(0)
    wild = Motion(EXACT, 9.0, *[nothing] * 3, np.zeros((0, 2)), nothing, nothing)
    words = legend(question, [wild]).split("<br>")[0]
    assert ("not settled" in words) != is_given


def test_rows_of_a_map_have_settled_by_their_own_damping():
    dampings = (1e-3, 0.3)
    question = replace(
        of_model(gs.systems.paper_oscillator(), approximations=()),
        over="zeta",
        over_values=dampings,
    )
    found = looked_at(question)
    never = np.zeros((2, 3), bool)
    plane = Plane(EXACT, MAP, np.arange(3.0), np.array(dampings), np.ones((2, 3)), never)
    found.planes.show(0, plane)
    drawn = found.planes.figures[MAP, 0].renderers[1]
    (image,) = drawn.data_source.data["image"]
    assert image.tolist() == [[0.0] * 3, [1.0] * 3]
    mapper = drawn.glyph.color_mapper
    assert (mapper.palette, mapper.low, mapper.high) == ([NOT_SETTLED, NOT_PERIODIC], 0.0, 1.0)


def test_motions_of_micrometres_are_as_good_as_those_of_millimetres():
    """Lengths and forces 1e-6 of the others, stiffnesses the same: so are the motions."""
    small = 1e-6
    large = of_model(
        gs.systems.paper_oscillator(alpha=0.0),
        gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4)),
        approximations=(),
    )
    tiny = of_model(
        gs.systems.paper_oscillator(alpha=0.0, forcing=4.0 * small),
        gs.Piecewise(1.4e4, gs.Gap(4e-4 * small, 4e-4 * small)),
        approximations=(),
    )
    ours, theirs = from_rest(tiny, EXACT), from_rest(large, EXACT)
    same = ours.is_periodic & theirs.is_periodic & (ours.period_multiple == theirs.period_multiple)
    assert same.mean() > 0.8
    apart = np.abs(ours.x_max / small / theirs.x_max - 1.0)[same]
    assert np.quantile(apart, 0.9) < 1e-4


@pytest.mark.parametrize("port", [-1, 65536, 70000, "x", None])
def test_a_port_that_is_none_is_refused(port):
    with pytest.raises(GapsweepError, match=rf"port = {port!r}: must be .* 0\.\.65535"):
        gs.explore(port=port)


def test_no_motion_is_asked_for_an_exponent():
    curve = from_rest(of_model(law=gs.Piecewise(1.4e6, gs.Gap(0.4e-3, 0.4e-3))), EXACT)
    wild = curve.response_class[~curve.is_periodic]
    assert wild.size
    assert set(wild.tolist()) == {gs.ResponseClass.UNRESOLVED}


def test_the_nearest_response_is_found():
    curve = from_rest(of_model(LINEAR, FREE), EXACT)
    shown = [replace(curve, omega=curve.omega + 100.0), curve]
    found, k = nearest(shown, curve.omega[70] + 1e-4, curve.x_max[70], (1.0, 1e-3))
    assert found is curve
    assert k == 70
    assert nearest([], 1.0, 1.0, (1.0, 1.0)) is None


# --- systems --------------------------------------------------------------------------------------


def pair(k: float = 10.0, load: float = 1.0) -> gs.System:
    return gs.System(
        mass=[[1.0, 0.0], [0.0, 2.0]],
        stiffness=[[20.0 + k, -k], [-k, 10.0 + k]],
        damping=[[1.8, -0.6], [-0.6, 1.2]],
        contacts={"stop": [1.0, 0.0], "between": [1.0, -1.0]},
        forcing=[gs.Harmonic(amplitude=[load, 0.0])],
    )


PAIR_LAWS = {
    "stop": gs.Piecewise(100.0, gs.Gap(0.05, 0.06)),
    "between": gs.Piecewise(50.0, gs.Gap(0.1, 0.12), K_ratio=2.0),
}


def test_a_function_of_systems_has_a_slider_for_each_keyword_and_wall():
    question = of_model(pair, PAIR_LAWS, approximations=())
    found = {dial.name: dial for dial in dials(question)}
    assert (found["k"].value, found["load"].value) == (10.0, 1.0)
    assert found["K_c of between"].value == 50.0
    changed = asked(question, numbers(question) | {"k": 4.0, "j_2 of stop": 0.07})
    assert changed.model.stiffness[0, 1] == -4.0
    stop, between = changed.laws("tanh-1e4")
    assert (stop.gap, stop.K_c) == (gs.Gap(0.05, 0.07), 100.0)
    assert (between.gap, between.K_ratio) == (gs.Gap(0.1, 0.12), 2.0)
    (one,) = {dial.name for dial in dials(of_model(gs.systems.two_masses))} & {"K_c of stop", "K_c"}
    assert one == "K_c"  # one law for all contacts


def test_damping_of_contacts_has_a_slider_and_pulls_is_kept():
    laws = {
        "stop": gs.Piecewise(100.0, gs.Gap(0.05, 0.06), damping=3.0, pulls=True),
        "between": gs.HuntCrossley(50.0, gs.Gap(0.1, 0.12), chi=0.4),
    }
    question = of_model(pair, laws, approximations=["poly-5", "huntcrossley-2"])
    found = {dial.name: dial for dial in dials(question)}
    assert (found["damping of stop"].value, found["chi of between"].value) == (3.0, 0.4)
    assert not {"damping of between", "chi of stop"} & {*found}
    moved = numbers(question) | {"damping of stop": 4.0, "chi of between": 0.5}
    stop, between = asked(question, moved).laws(EXACT)
    assert stop == replace(laws["stop"], damping=4.0)
    assert between == replace(laws["between"], chi=0.5)
    stop, _ = asked(question, moved).laws("huntcrossley-2")  # in place of the damper
    assert stop == gs.HuntCrossley(100.0, gs.Gap(0.05, 0.06), chi=2.0)
    assert [dial.value for dial in dials(of_model(LINEAR, FREE)) if dial.name == "damping"] == [0.0]


def test_a_law_that_cannot_be_built_is_a_message_and_the_others_are_shown(monkeypatch):
    monkeypatch.setattr(shown, "N_OMEGA", 3)
    damped = gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4), damping=50.0)
    question = of_model(LINEAR, damped, approximations=["poly-5", "piecewise-noevents"])
    found = list(answers(question))
    problems = [one.problem for one in found if isinstance(one, Motion) and one.problem]
    assert len(problems) == 2
    assert "damping = 50" in problems[0]
    (rest,) = (one for one in found if getattr(one, "protocol", "") == REST)
    omega = shown.frequencies(question)
    steady = shown.settled(question.model)
    settings = {"rtol": shown.RTOL, "atol": shown._atol(question.model), "steady": steady}
    np.testing.assert_array_equal(rest.x_max, gs.respond(LINEAR, damped, omega, **settings).x_max)
    assert {one.protocol for one in found if hasattr(one, "protocol")} == {REST, UP, DOWN}


def test_a_wall_on_one_side_has_one_slider():
    stop = gs.Piecewise(1.4e4, gs.Gap(None, 4e-4), damping=5.0)
    question = of_model(LINEAR, stop, approximations=[])
    assert "j_1" not in question.machine.names
    assert question.at("j_2", 5e-4).laws(EXACT) == (replace(stop, gap=gs.Gap(None, 5e-4)),)
    assert question.clearance == (-np.inf, 4e-4)
    block = {"representation": ["piecewise"], "K_c": 1.4e4, "omega": [5.0, 9.0]}
    study = {"study": {"name": "one"}, "oscillator": PAPER}
    one = study | {"sweep": [{**block, "gap": [np.inf, 4e-4]}]}
    question, _ = of_study(gs.Study.from_dict(one))
    assert question.laws(EXACT)[0].gap == gs.Gap(None, 4e-4)
    mixed = study | {"sweep": [{**block, "gap": [[np.inf, 4e-4], [4e-4, 4e-4]]}]}
    with pytest.raises(ModelError, match="j_1 = inf next to other values"):
        of_study(gs.Study.from_dict(mixed))


def test_a_prestressed_wall_has_a_slider_of_both_signs(monkeypatch):
    monkeypatch.setattr(shown, "N_OMEGA", 3)
    pressed = gs.Piecewise(1.4e4, gs.Gap(-1e-4, 4e-4))
    question = of_model(LINEAR, pressed, approximations=[])
    (dial,) = (dial for dial in dials(question) if dial.name == "j_1")
    assert dial.low < dial.value < 0.0 < dial.high
    omega = shown.frequencies(question)
    settings = {"rtol": shown.RTOL, "atol": shown._atol(question.model)}
    found = gs.respond(LINEAR, pressed, omega, steady=shown.settled(question.model), **settings)
    np.testing.assert_array_equal(from_rest(question, EXACT).x_max, found.x_max)


def test_a_study_with_damping_has_its_range():
    study = changed(TWO_MASSES, sweep__0__damping=[0.5, 2.0])
    question, ranges = of_study(gs.Study.from_dict(study))
    (dial,) = (one for one in dials(question, ranges) if one.name == "damping")
    assert (dial.low, dial.high) == (0.5, 2.0)
    stop, _ = asked(question, numbers(question) | {"damping": 1.5}).laws(EXACT)
    assert (stop.damping, stop.pulls) == (1.5, False)
    question, _ = of_study(gs.Study.from_dict(changed(study, study__pulls=True)))
    stop, _ = question.laws(EXACT)
    assert (stop.gap, stop.damping, stop.pulls) == (gs.Gap(0.1, 0.2), 0.5, True)


def test_losses_of_single_laws_have_sliders():
    swept = {"sweep__0__representation": ["piecewise", "huntcrossley"], "sweep__0__chi": [0.1, 0.3]}
    question, ranges = of_study(gs.Study.from_dict(changed(TWO_MASSES, **swept)))
    (dial,) = (one for one in dials(question, ranges) if one.name == "chi")
    assert (dial.low, dial.high) == (0.1, 0.3)
    moved = asked(question, numbers(question) | {"chi": 0.2})
    assert moved.laws("huntcrossley")[0].chi == 0.2
    assert moved.laws("huntcrossley-2")[0].chi == 2.0
    assert moved.laws(EXACT)[0] == gs.Piecewise(10.0, gs.Gap(0.1, 0.2))
    for machine in (LINEAR, gs.systems.two_masses()):
        question = of_model(machine, gs.Rigid(gs.Gap(0.1, 0.2), restitution=0.8), approximations=[])
        (dial,) = (one for one in dials(question) if one.name == "restitution")
        assert (dial.low, dial.value, dial.high) == (0.0, 0.8, 1.0)
        law = next(iter(asked(question, numbers(question) | {"restitution": 0.5}).laws(EXACT)))
        assert law == gs.Rigid(gs.Gap(0.1, 0.2), restitution=0.5)


def test_a_study_of_systems_gives_ranges_and_keeps_its_own_contacts():
    study = gs.Study.from_dict(TWO_MASSES)
    question, ranges = of_study(study)
    found = {dial.name: dial for dial in dials(question, ranges)}
    assert {*found} == {"K_c", "j_1", "j_2", "K_ratio", "damping", "preload", "omega"}
    assert (found["K_c"].low, found["K_c"].high) == (10.0, 100.0)
    assert (found["omega"].low, found["omega"].high) == (0.3, 0.5)
    stop, between = asked(question, numbers(question) | {"K_c": 20.0}).laws(EXACT)
    assert (stop.K_c, stop.gap) == (20.0, gs.Gap(0.1, 0.2))
    assert between == gs.Piecewise(50.0, gs.Gap(0.5, 0.4), K_ratio=2.0)


@pytest.mark.parametrize("shown_", ["q_2", "between"])
def test_figures_of_a_system_show_the_chosen_displacement(shown_, monkeypatch):
    monkeypatch.setattr(shown, "N_OMEGA", 3)
    question = replace(of_model(pair, PAIR_LAWS).at("omega", 0.9), shown=shown_, band=(0.7, 0.9))
    settings = {"rtol": shown.RTOL, "atol": shown._atol(question.model)}
    steady = shown.settled(question.model)
    found = gs.respond(pair(), PAIR_LAWS, [0.7, 0.8, 0.9], steady=steady, **settings)
    peaks = found.x_max[:, 1] if shown_ == "q_2" else found.contact_x_max[:, 1]
    curve = from_rest(question, EXACT)
    np.testing.assert_array_equal(curve.x_max, peaks)
    np.testing.assert_array_equal(curve.end[:, :2], found.x_end)
    moved = motion(question, EXACT)
    assert moved.x.max() == pytest.approx(peaks[2], rel=1e-2)
    low, high = question.clearance
    assert (low, high) == ((-0.1, 0.12) if shown_ == "between" else (-np.inf, np.inf))


def test_basins_of_a_system_vary_the_chosen_states(monkeypatch):
    monkeypatch.setattr(shown, "N_STARTS", 3)
    question = replace(of_model(pair, PAIR_LAWS).at("omega", 0.9), plane=("q_2", "v_q_1"))
    *_, plane = basins(question, EXACT, 0.2)
    found = gs.basins(pair(), PAIR_LAWS, 0.9, x=("q_2", plane.x), v=("v_q_1", plane.y), rtol=1e-6)
    peaks = found["x_max"].values[found["attractor"].values, 0]
    np.testing.assert_allclose(plane.x_max, peaks, rtol=1e-3)


def test_every_state_has_its_scale():
    lags = gs.Lags(
        force=[[1.0], [0.0]], of_speed=[[0.0, 1.0]], of_place=[[0.0, 0.0]], of_lags=[[-5.0]]
    )
    small = {name: gs.Piecewise(1.0, gs.Gap(1e-3, 1e-3)) for name in PAIR_LAWS}
    model = replace(pair(), lags=lags, units={"q_2": "rad", "between": "1"})
    machine = of_model(model, small).machine
    found = [machine.state(name).label for name in machine.states]
    assert found == ["q_1 [mm]", "q_2 [10⁻³ rad]", "v_q_1 [mm/s]", "v_q_2 [10⁻³ rad/s]", "z_1"]
    assert machine.length("between").label == "between [10⁻³]"


def test_a_page_of_a_system_offers_displacements_and_states():
    document = Document()
    page = Page(document, of_model(pair, PAIR_LAWS), {}, None)
    (of_shown,) = document.select({"name": "shown"})
    assert of_shown.options == ["q_1", "q_2", "between"]
    (across,) = document.select({"name": "state across"})
    assert across.options == ["q_1", "q_2", "v_q_1", "v_q_2"]
    of_shown.value = "between"
    assert page._question.shown == "between"
    across.value = "v_q_1"  # as upwards
    (status,) = document.select({"name": "status"})
    assert "choose two" in status.text
    page.stop()
    one = Document()
    Page(one, of_model(LINEAR, FREE), {}, None).stop()
    assert not one.select({"name": "shown"})


def test_points_of_a_run_of_systems_are_those_of_the_chosen_displacement(tmp_path):
    study = changed(TWO_MASSES, sweep__0__K_c=100.0, sweep__0__initial_condition=None)
    system = gs.Study.from_dict(study).model.default
    gaps = {"stop": gs.Gap(0.1, 0.2), "between": gs.Gap(0.5, 0.4)}
    laws = {name: gs.Piecewise(100.0, gap) for name, gap in gaps.items()}
    found = {omega: gs.respond(system, laws, omega) for omega in (0.3, 0.5)}
    for each in datasets(tmp_path, study, lambda label, omega, start: found[omega]):
        each.close()
    stored = StoredRun(tmp_path)
    (name,) = stored.scenes
    assert stored.scenes[name] == {"K_c": 100.0, "j_1": 0.1, "j_2": 0.2}
    for shown_, peaks in (
        ("q_2", [one.x_max[1] for one in found.values()]),
        ("between", [one.contact_x_max[1] for one in found.values()]),
    ):
        question = replace(stored.question, shown=shown_)
        (points,) = stored.points(name, question)
        np.testing.assert_allclose(points.x_max, peaks)
        np.testing.assert_allclose(points.end[0], np.ravel(found[0.3].section)[:4])
        assert stored.branches(name, question) == []


# --- the newest question --------------------------------------------------------------------------


def test_an_error_of_any_kind_is_a_word_and_the_next_question_is_answered():
    said, answered = [], threading.Event()

    def raising(question):
        if question == 1:
            raise OverflowError("too large")
        yield "first"

    latest = Latest(raising, lambda *_: answered.set(), lambda _, problem: said.append(problem))
    latest.ask(1)
    wait_until(lambda: said, SOON)
    latest.ask(2)
    assert answered.wait(SOON)
    latest.stop()
    assert said == ["OverflowError: too large"]


@pytest.mark.parametrize("wrong", [{"omega": float("nan")}, {"K_c": float("inf")}])
def test_what_is_no_number_is_no_question(wrong):
    question = of_model()
    with pytest.raises(ModelError, match="must be"):
        list(answers(asked(question, numbers(question) | wrong)))
    with pytest.raises(ModelError, match="must be"):
        replace(question, start=(0.0, float("inf")))


def test_a_newer_question_takes_the_place_of_all_older_ones():
    begun, go_on, done = threading.Event(), threading.Event(), threading.Event()
    seen = []

    def slowly(question):
        if question == 1:
            begun.set()
            assert go_on.wait(SOON)
        yield "first"
        yield "second"

    def deliver(question, answer):
        seen.append((question, answer))
        if seen[-1] == (9, "second"):
            done.set()

    latest = Latest(slowly, deliver, lambda *_: None)
    latest.ask(1)
    assert begun.wait(SOON)
    for question in range(2, 10):
        latest.ask(question)
    go_on.set()
    assert done.wait(SOON)
    latest.stop()
    assert seen == [(1, "first"), (9, "first"), (9, "second")]


def test_what_cannot_be_answered_is_refused_and_the_next_is_answered():
    heard, done = [], threading.Event()

    def answer(question):
        if question == "bad":
            raise ModelError("zeta = -1: must be >= 0")
        yield question

    def refuse(question, problem):
        heard.append((question, problem))
        latest.ask("good")

    latest = Latest(answer, lambda *_: done.set(), refuse)
    latest.ask("bad")
    assert done.wait(SOON)
    latest.stop()
    assert heard == [("bad", "zeta = -1: must be >= 0")]


# --- runs -----------------------------------------------------------------------------------------


@pytest.fixture
def run(tmp_path):
    study = tables(("piecewise", "tanh-1e4"), (5.0, 6.0, 7.0), starts=2)
    made, attractors = datasets(
        tmp_path,
        study,
        lambda label, omega, start: (
            None if omega == 6.0 else periodic([(1e-3 * omega, 1e-5 * start)], omega)
        ),
    )
    made.close()
    attractors.close()
    return tmp_path


def test_the_points_of_a_run_are_found_in_their_scenes(run):
    stored = StoredRun(run)
    (name,) = stored.scenes
    assert "14000 N/m" in name
    assert stored.scenes[name] == {"K_c": 1.4e4, "j_1": 0.4e-3, "j_2": 0.4e-3}
    curves = stored.points(name, stored.question)
    assert [curve.label for curve in curves] == ["piecewise", "tanh-1e4"]
    for points in curves:
        assert sorted(points.omega) == [5.0] * 2 + [7.0] * 2
        np.testing.assert_allclose(points.x_max, 1e-3 * points.omega)
        np.testing.assert_allclose(points.end[:, 0], 1e-3 * points.omega)
        assert len(set(points.end[:, 1].tolist())) == 3  # at rest, or one at either frequency
        assert points.is_periodic.all()


def test_branches_of_a_run_are_lines_behind_its_points(run):
    """Of the scene alone; without the file there are none."""
    (name,) = StoredRun(run).scenes
    stored = StoredRun(run)
    assert stored.branches(name, stored.question) == []
    labels, K_c, gap = ["piecewise", "tanh-1e4"], [1.4e4, 1.0], ["0.4/0.4"] * 2
    found = branches([[1, 1, 0]] * 2, [[0, 1, 0]] * 2, representation=labels, K_c=K_c, gap=gap)
    found.attrs["created"] = "9999"
    found.to_netcdf(run / "branches.nc", engine="netcdf4")
    with pytest.warns(UserWarning, match="not checked for damage"):
        stored = StoredRun(run)
    lines = stored.branches(name, stored.question)
    assert [(label, is_stable) for label, is_stable, _ in lines] == [
        ("piecewise", False),
        ("piecewise", True),
    ]
    np.testing.assert_allclose(lines[1][2][:2], [[5.0, 0.0], [5.5, 1.0]])
    figures = Figures(stored.question)
    figures.show_stored(stored.points(name, stored.question), lines)
    assert figures.response.select_one({"name": "branches"}).data["dash"] == ["dashed", "solid"]


# --- the server -----------------------------------------------------------------------------------


def test_the_page_is_there_and_for_this_machine_only():
    with_page = gs.explore(approximations=())
    try:
        for _ in range(2):  # visitors, each with a document of their own
            with urllib.request.urlopen(with_page.url, timeout=SOON) as answer:
                page = answer.read()
                assert b"gapsweep explore" in page
                assert b'name="viewport" content="width=device-width' in page
        port = urlsplit(with_page.url).port
        listening = [each.laddr for each in psutil.Process().net_connections("tcp")]
        assert {place.ip for place in listening if place.port == port} == {"127.0.0.1"}
        assert with_page.url in with_page._repr_html_()
    finally:
        with_page.stop()
    for thread in threading.enumerate():
        if thread.name == "explorer":
            thread.join(SOON)
            assert not thread.is_alive()


# Tornado leaves the socket that it could not bind to the garbage collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_port_that_is_taken_is_refused():
    page = gs.explore(approximations=())
    try:
        with pytest.raises(GapsweepError, match="in use; choose another"):
            gs.explore(port=urlsplit(page.url).port)
    finally:
        page.stop()
    gc.collect()


def test_a_page_computes_nothing_before_its_session_exists(monkeypatch):
    """Bokeh refuses the page if a thread adds a callback while it makes the session."""
    questions = []
    monkeypatch.setattr(Latest, "ask", lambda _, question: questions.append(question))
    document = Document()
    page = Page(document, of_model(LINEAR, FREE), {}, None)
    try:
        assert not questions
        (begin,) = document.session_callbacks
        begin.callback()
        assert len(questions) == 1
    finally:
        page.stop()


def test_another_site_cannot_talk_to_the_page():
    page = gs.explore(approximations=())

    async def knock():
        there = page.url.replace("http", "ws") + "ws"
        await websocket_connect(HTTPRequest(there, headers={"Origin": "http://elsewhere.example"}))

    try:
        with pytest.raises(HTTPClientError, match="403"):
            asyncio.run(knock())
    finally:
        page.stop()


@pytest.mark.parametrize("path", ["/", "/ws", "/static/js/bokeh.min.js", "/guessed/ws", "known"])
def test_a_site_that_takes_the_name_of_this_machine_does_not_know_the_path(path):
    """DNS rebinding: its pages reach the port, with a host and an origin that agree."""
    page = gs.explore(approximations=())
    path = urlsplit(page.url).path if path == "known" else path
    port = urlsplit(page.url).port
    headers = {"Host": f"rebound.example:{port}", "Origin": f"http://rebound.example:{port}"}

    async def knock():
        if path.endswith("ws"):
            await websocket_connect(HTTPRequest(f"ws://127.0.0.1:{port}{path}", headers=headers))
        await AsyncHTTPClient().fetch(f"http://127.0.0.1:{port}{path}", headers=headers)

    try:
        with pytest.raises(HTTPClientError, match="404"):
            asyncio.run(knock())
        with urllib.request.urlopen(page.url, timeout=SOON) as answer:
            (script, *_) = re.findall(rb'src="([^"]*/static/[^"]*)"', answer.read())
        urllib.request.urlopen(urljoin(page.url, script.decode()), timeout=SOON).close()
    finally:
        page.stop()


def test_the_command_line_of_a_browser_does_not_hold_the_path(monkeypatch, capsys):
    launched = []

    def launch(address):
        file = Path(urlsplit(address).path)
        modes = [stat.S_IMODE(file.parent.stat().st_mode), file.read_text()]
        launched.extend([address, *modes])

    monkeypatch.setattr("click.launch", launch)
    monkeypatch.setattr("gapsweep.explorer.server.Explorer.wait", lambda page: page.stop())
    assert exit_code(["explore"]) == 0
    url = capsys.readouterr().out.split()[0]
    address, mode, text = launched
    assert url in text
    assert urlsplit(url).path not in address
    assert mode == 0o700


def test_a_wrong_path_is_a_line_not_a_traceback(tmp_path, capsys):
    assert exit_code(["explore", str(tmp_path / "none.toml"), "--no-browser"]) == 1
    assert "cannot be read" in capsys.readouterr().err
    assert exit_code(["explore", str(tmp_path), "--no-browser"]) == 1
    assert "error: " in capsys.readouterr().err


SYSTEM = """
[study]
name = "moved"
[system]
function = "moved_nowhere:system"
[[sweep]]
representation = "piecewise"
K_c = 1.0
gap = [0.1, 0.1]
"""


def test_no_code_is_executed_that_a_run_names(tmp_path, capsys):
    told = xr.Dataset(attrs={"study_json": json.dumps(tomllib.loads(SYSTEM))})
    told.to_netcdf(tmp_path / "responses.nc", engine="netcdf4")
    assert exit_code(["explore", str(tmp_path), "--no-browser"]) == 1
    said = capsys.readouterr().err
    assert "made by 'moved_nowhere:system'" in said
    assert "explore the study file" in said


def test_the_page_says_that_its_line_is_no_law_of_the_users(tmp_path):
    tables_ = tables(("bump:clean@fine", "piecewise"), (5.0, 6.0), protocol={"fine": {}})
    said = not_computed(gs.Study.from_dict(tables_))
    assert "Not computed here: the user-defined bump:clean." in said
    document = Document()
    Page(document, of_model(LINEAR, FREE), {}, None, said).stop()
    (div,) = document.select({"name": "note"})
    assert said in div.text
    assert not not_computed(gs.Study.from_dict(tables(("piecewise",), (5.0, 6.0))))


def test_without_bokeh_the_remedy_is_named():
    code = "import sys; sys.modules['bokeh'] = None; import gapsweep; gapsweep.explore()"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "ModelError: explore: needs Bokeh" in ended.stderr
    assert "pip install 'gapsweep[explore]'" in ended.stderr


def test_rigid_walls_are_named_and_have_no_smooth_approximation():
    gap = gs.Gap(4e-4, 4e-4)
    question = of_model(gs.systems.paper_oscillator(), gs.Rigid(gap, restitution=0.7))
    assert question.approximations == ()
    assert "rigid (exact)" in legend(question, ())
    both = replace(question, approximations=labels("tanh-1e4, rigid-0.5"))
    with pytest.raises(ModelError, match="rigid walls have no stiffness"):
        both.laws("tanh-1e4")
    assert both.laws("rigid-0.5") == (gs.Rigid(gap, restitution=0.5),)
    rubber = of_model(gs.systems.paper_oscillator(), gs.HuntCrossley(1e4, gap, chi=1.0))
    assert "huntcrossley (exact)" in legend(rubber, ())
