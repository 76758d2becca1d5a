"""Data of figures as CSV and as JSON: equal numbers, and their style."""

import base64
import csv
import io
import json

import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

from gapsweep.report import marks
from gapsweep.report.figure_data import as_csv, as_json
from gapsweep.report.marks import put

ONE = marks.points(x=[1.0], y=[1.0])


def numbers(text):
    return np.frombuffer(base64.b64decode(text), "<f4")


@pytest.fixture
def figure():
    """One of everything: lines with gaps, words, points twice, bars, bands, levels, ticks."""
    figure = Figure()
    left, right = figure.subplots(1, 2)
    tanh = {"entry": "tanh-1e4", "colour": "#0072b2", "dashes": "--"}
    x = [1.0, 2.0]
    put(
        left,
        [
            marks.line(x=[1.0, 2.0, 3.0], y=[1.0, np.nan, 2.0], **tanh),
            marks.points(x=[1.0, 1.0, 2.0], y=[5.0, 5.0, 6.0], series="pale", opacity=0.5),
            marks.points(x=x, y=[4.0, 4.0], series="up", marker="^"),
            marks.line(x=x, y=[3.0, 3.0], series="dotted", dashes=":", dots=5.0),
            marks.bars(x, [0.9, 1.8], [1.1, 2.2], series="error"),
            marks.band(x=[1.0], x_end=[1.5], series="chaotic"),
            marks.level(y=0.4),
            marks.ticks(x=[2.5], series="differ"),
            marks.edge(y=[1.0], marker="x"),
            marks.text(x=0.5, y=0.9, series="here", in_data=False, align=("right", "top")),
            marks.key(entry="an entry without data"),
        ],
    )
    put(
        right,
        [
            marks.points(x=["a", "b"], y=[1.0, 10.0], size=3.0),
            marks.points(x=[0, 1], y=[2.0, 3.0], size=[2.0, 4.0], face="none", colour="#ff0000"),
        ],
    )
    right.set(yscale="log", ylabel="cost [s]")
    right.set_title("by word", loc="left")
    return figure


def test_json_and_csv_hold_the_same_numbers(figure):
    rows = [line for line in as_csv(figure).splitlines() if not line.startswith("#")]
    expected = {}
    words = {"a": 0.0, "b": 1.0, "": np.nan}
    for row in csv.DictReader(io.StringIO("\n".join(rows))):
        place = [words[row[n]] if row[n] in words else float(row[n]) for n in ("x", "y")]
        key = int(row["panel"]) - 1, row["series"], row["mark"]
        expected.setdefault(key, []).append(place)
    found = {}
    for n, panel in enumerate(json.loads(as_json(figure))):
        for mark in panel["marks"]:
            if mark["kind"] != "level":
                places = np.stack([numbers(mark["x"]), numbers(mark["y"])], axis=1)
                found.setdefault((n, mark["series"], mark["kind"]), []).extend(places)
    assert found.keys() == expected.keys()
    for key, places in expected.items():
        order = np.lexsort(np.transpose(places))
        theirs = np.array(found[key])
        assert_allclose(
            theirs[np.lexsort(theirs.T)], np.array(places)[order], rtol=1e-6, err_msg=str(key)
        )


def test_a_panel_says_how_it_is_drawn(figure):
    left, right = json.loads(as_json(figure))
    assert [right["row"], right["column"]] == [1, [2, 3]]
    assert right["title"] == "by word"
    assert right["x"]["words"] == [[0.0, "a"], [1.0, "b"]]
    assert right["y"]["scale"] == "log"
    assert right["y"]["label"] == "cost [s]"
    assert left["y"]["limits"] == pytest.approx(figure.axes[0].get_ylim())
    assert [left["x"]["view"], right["x"]["view"]] == [0, 1]
    (hollow,) = [mark for mark in right["marks"] if mark["hollow"]]
    assert hollow["colour"] == "#ff0000"
    assert numbers(hollow["size"]).tolist() == [2.0, 4.0]  # diameters of areas
    (level,) = [mark for mark in left["marks"] if mark["kind"] == "level"]
    assert numbers(level["y"]) == pytest.approx([0.4])
    assert np.isnan(numbers(level["x"])).all()
    dashed, pale = (
        next(mark for mark in left["marks"] if mark["series"] == series)
        for series in ("tanh-1e4", "pale")
    )
    assert [dashed["dashes"], dashed["colour"]] == ["--", "#0072b2"]
    assert pale["opacity"] == 0.5
    assert [dashed["dots"], pale["dots"]] == [0.0, 0.0]
    assert next(m for m in left["marks"] if m["series"] == "dotted")["dots"] == 5.0
    assert next(m for m in left["marks"] if m["series"] == "up")["marker"] == "^"
    assert left["marks"][0]["kind"] == "band"  # behind all else
    assert [(note["text"], note["ha"], note["in_data"]) for note in left["texts"]] == [
        ("here", "right", False)
    ]


def test_panels_that_share_an_axis_share_its_view():
    figure = Figure()
    panels = figure.subplots(2, 2, sharex="col", sharey="row")
    for axes in panels.ravel():
        put(axes, [marks.line(x=[1.0, 2.0], y=[1.0, 2.0])])
    views = [(panel["x"]["view"], panel["y"]["view"]) for panel in json.loads(as_json(figure))]
    assert views == [(0, 0), (1, 0), (0, 2), (1, 2)]


def test_a_figure_of_matplotlib_alone_has_no_data():
    figure = Figure()
    figure.subplots().imshow(np.ones((2, 2)))
    figure.axes[0].plot([0.0, 1.0], [0.0, 1.0])
    assert as_csv(figure) == as_json(figure) == ""


def second_axis():
    figure = Figure()
    put(figure.subplots().twinx(), [ONE])
    return figure


def polar():
    figure = Figure()
    put(figure.subplots(subplot_kw={"projection": "polar"}), [ONE])
    return figure


def placed():
    figure = Figure()
    put(figure.add_axes((0.1, 0.1, 0.8, 0.8)), [ONE])
    return figure


@pytest.mark.parametrize("draw", [second_axis, polar, placed, Figure])
def test_what_is_no_grid_of_panels_stays_a_picture(draw):
    assert as_json(draw()) == ""


def test_marks_without_data_and_over_words_are_drawn_all_the_same():
    figure = Figure()
    axes = figure.subplots()
    put(axes, [marks.points(x=[], y=[], size=np.empty(0)), marks.line(x=["a", "b"], y=[1.0, 2.0])])
    put(axes, [marks.text(x=1.0, y=1.0, series="here")])
    (panel,) = json.loads(as_json(figure))
    assert [(note["text"], note["x"]) for note in panel["texts"]] == [("here", 1.0)]
    assert [numbers(mark["x"]).tolist() for mark in panel["marks"]] == [[0.0, 1.0]]


def test_marks_are_forgotten_with_their_artists():
    figure = Figure()
    axes = figure.subplots()
    put(axes, [ONE, marks.line(x=[1.0, 2.0], y=[3.0, 4.0], series="removed")])
    axes.lines[1].remove()
    assert [mark["series"] for mark in json.loads(as_json(figure))[0]["marks"]] == [""]
    axes.clear()
    assert as_json(figure) == as_csv(figure) == ""
