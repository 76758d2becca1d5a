"""Bands and walls behind points: what is drawn is what the key and the caption name."""

import json

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

import gapsweep.report.accessor  # noqa: F401  # plain datasets do not bring it along
from gapsweep.report import backdrop
from gapsweep.report.drawing import attractor_peaks, caption_of_peaks, frame
from gapsweep.report.figures import bifurcation, frequency_response
from gapsweep.report.style import BANDS
from gapsweep.response.result import ResponseClass

OMEGA = [4.0, 5.0, 6.0, 7.0]
HZ, METRES = {"units": "Hz", "long_name": "forcing frequency"}, {"units": "m", "long_name": "x"}


def scene(*kinds):
    """Responses of one law with these classes, one start, walls at -2 and 3 mm."""
    shape = (1, len(kinds), 1)
    codes = np.array([ResponseClass[kind.upper()] for kind in kinds]).reshape(shape)
    dims = ("representation", "omega", "initial_condition")
    return xr.Dataset(
        {
            "response_class": (dims, codes),
            "extrema": ((*dims, "extremum"), np.full((*shape, 2), 1e-3), METRES),
        },
        {
            "representation": ["tanh-10000"],
            "omega": ("omega", OMEGA[: len(kinds)], HZ),
            "j_1": ((), 2e-3, METRES),
            "j_2": ((), 3e-3, METRES),
        },
    )


def attractors(*shares, kind="periodic"):
    """Peaks of one attractor a frequency, with these shares of the starts."""
    n = len(shares)
    return xr.Dataset(
        {
            "x_max": (("omega", "attractor"), np.full((n, 1), 1e-3), METRES),
            "basin_share": (("omega", "attractor"), np.array(shares)[:, None]),
            "response_class": (
                ("omega", "attractor"),
                np.full((n, 1), ResponseClass[kind.upper()]),
            ),
        },
        {"representation": "tanh-10000", "omega": ("omega", OMEGA[:n], HZ)},
    )


@pytest.mark.parametrize(
    "kinds",
    [
        ("periodic", "failed"),
        ("periodic", "quasiperiodic", "periodic"),
        ("chaotic", "periodic", "unresolved", "quasiperiodic"),
    ],
)
def test_key_and_caption_name_the_bands_that_are_drawn(kinds):
    shown = scene(*kinds)
    figure = bifurcation(shown)
    (axes,) = figure.axes
    drawn = {bar.get_label().removeprefix("_") for bar in axes.patches}
    assert drawn == set(kinds) & set(BANDS)
    key = {text.get_text() for legend in figure.legends for text in legend.get_texts()}
    is_other = {"not periodic"} if set(kinds) - {"periodic"} else set()
    assert key == drawn | is_other
    said = backdrop.caption_of_bands(shown)
    assert {kind for kind in BANDS if kind in said} == drawn
    assert bool(said) == bool(drawn)


@pytest.mark.parametrize(("of_peaks", "heights"), [(False, [-2.0, 3.0]), (True, [3.0])])
def test_below_peaks_stands_no_wall_that_would_press_them_flat(of_peaks, heights):
    walls = backdrop.walls(scene("periodic"), of_peaks=of_peaks)
    assert [wall.y for wall in walls] == pytest.approx(heights)


def test_a_dot_without_a_known_basin_is_no_small_basin():
    filled, _ = attractor_peaks(attractors(np.nan, 0.01, 1.0), "omega")
    unknown, small, whole = filled.size
    assert small < unknown < whole


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (attractors(np.nan, np.nan), ""),
        (
            attractors(0.3, np.nan),
            " Dot area: share of the initial conditions that lead to the attractor.",
        ),
        (attractors(np.nan, kind="chaotic"), " Hollow: not periodic."),
        (
            attractors(0.5, kind="quasiperiodic"),
            " Dot area: share of the initial conditions that lead to the attractor; hollow: not "
            "periodic.",
        ),
    ],
)
def test_a_caption_says_of_dots_what_is_to_be_seen(found, said):
    assert caption_of_peaks(found) == said


def growing():
    """Two laws whose last response was still growing when it was left, far beyond the others."""
    shown = scene("periodic", "periodic", "unresolved")
    values = shown["extrema"] * xr.DataArray([1.0, -2.0], dims="extremum")
    shown["extrema"] = values.where(shown["omega"] < 6.0, 5e3 * values).assign_attrs(METRES)
    for name, over in (("x_max", shown["extrema"].max("extremum")), ("amplitude", 1.5e-3)):
        shown[name] = (0.0 * shown["extrema"].max("extremum") + over).assign_attrs(METRES)
    shown["amplitude"] = shown["amplitude"].where(shown["omega"] < 6.0, 7.5).assign_attrs(METRES)
    other = shown.assign_coords(representation=["piecewise"])
    return xr.concat([shown, other], "representation", coords="minimal", compat="override")


def test_what_is_still_growing_does_not_set_the_axis():
    shown = growing().drop_vars(["j_1", "j_2"])
    axes = [
        *bifurcation(shown).axes,
        *frequency_response(shown).axes,
        shown.gapsweep.bifurcation(ax=Figure().subplots()),
        shown.gapsweep.frequency_response(ax=Figure().subplots()),
        shown.gapsweep.compare("piecewise", "tanh-10000", ax=Figure().subplots()),
    ]
    for one in axes:
        low, high = one.get_ylim()
        assert -2.5 < low < high < 2.5  # mm: a little more than the steady ones need
        left, right = one.get_xlim()
        assert left < 4.0 < 6.0 < right
        drawn = np.concatenate([np.ravel(line.get_ydata()) for line in one.lines])
        assert np.nanmax(drawn) > 4e3  # there, and cut off; lines are broken by NaN at jumps
        assert {bar.get_label() for bar in one.patches} <= {"_unresolved"}
    assert [t.get_text() for t in axes[-1].get_legend().get_texts()][-1] == "unresolved"
    low, high = frame(shown, "x_max", "piecewise")
    assert low < 1.0 < high < 3.0


def test_a_law_of_which_all_is_growing_does_not_either():
    shown = growing().drop_vars(["j_1", "j_2"])
    other = shown["representation"] == "tanh-10000"
    kinds = shown["response_class"]
    shown["response_class"] = kinds.where(~other, int(ResponseClass.UNRESOLVED))
    for name in ("extrema", "x_max"):
        shown[name] = (shown[name] * (1.0 + 5e3 * other)).assign_attrs(METRES)
    for axes in (
        *bifurcation(shown).axes,
        shown.gapsweep.bifurcation(ax=Figure().subplots()),
        shown.gapsweep.compare("piecewise", "tanh-10000", ax=Figure().subplots()),
    ):
        assert axes.get_ylim()[1] < 2.5


def test_where_all_is_growing_it_is_seen():
    (axes,) = bifurcation(growing().isel(representation=[0], omega=[2])).axes
    assert axes.get_ylim()[1] > 5e3


def of_system(coordinate, K_ratio=1.0):
    """Responses of one coordinate of a system, with two contacts on the arm only."""
    system = {
        "coordinates": ["body", "arm"],
        "contacts": {"lever": [0.0, -2.0], "stop": [0.0, 1.0], "between": [1.0, -1.0]},
        "units": {"body": "1", "arm": "1"},
    }
    own = {"stop": {"gap": [5.0, 6.0], "K_ratio": 0.0, "K_c": None}}
    shown = scene("periodic", "periodic").assign_coords(coordinate=coordinate, K_ratio=K_ratio)
    shown.attrs = {"system_json": json.dumps(system), "study_json": json.dumps({"contact": own})}
    for name in ("extrema", "j_1", "j_2"):
        del shown[name].attrs["units"]
    return shown


@pytest.mark.parametrize(
    ("shown", "of_peaks", "heights", "said"),
    [
        (of_system("arm"), False, [-1.5e-3, 1e-3, 6.0], " Dashed: walls within the axis."),
        (of_system("arm", K_ratio=0.0), False, [-1.5e-3, 6.0], " Dashed: walls within the axis."),
        (of_system("arm"), True, [1e-3, 6.0], " Dashed: walls within the axis."),
        (of_system("body"), False, [], ""),
        (scene("periodic").assign_coords(K_ratio=0.0), False, [3.0], " Dashed: the wall."),
    ],
)
def test_walls_of_a_system_stand_where_its_coordinate_meets_them(shown, of_peaks, heights, said):
    walls = backdrop.walls(shown, of_peaks=of_peaks)
    assert sorted(np.ravel(wall.y)[0] for wall in walls) == pytest.approx(heights)
    assert backdrop.caption_of_walls(shown, of_peaks=of_peaks) == said


def test_a_wall_of_a_system_sets_no_axis():
    (axes,) = bifurcation(of_system("arm")).axes
    assert axes.get_ylim()[1] < 0.1


def test_a_figure_of_a_system_names_the_coordinate_and_what_is_fixed():
    (axes,) = bifurcation(of_system("arm")).axes
    assert axes.get_ylabel() == "arm: extrema"
    both = [of_system("arm"), of_system("arm")]
    shown = xr.concat(both, "initial_condition", coords="minimal", compat="override")
    shown = shown.assign_coords(
        initial_condition=[0, 1], start=("initial_condition", ["sweep_up", "fixed"])
    )
    for number, said in enumerate(("initial_condition = sweep_up", "initial_condition = 1")):
        axes = shown.gapsweep.bifurcation(initial_condition=number, ax=Figure().subplots())
        assert axes.get_ylabel() == "arm: steady extrema"
        assert axes.get_xlabel() == "forcing frequency [Hz]"
        title = axes.get_title(loc="left")
        assert title.startswith("tanh-10000, ")
        assert said in title.split(", ")[-1]
        assert "arm" in title.split(", ")
    only = shown.isel(initial_condition=[0]).gapsweep.bifurcation(ax=Figure().subplots())
    assert "initial_condition" not in only.get_title(loc="left")
