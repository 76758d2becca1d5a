"""Bands and walls behind points: what is drawn is what the key and the caption name."""

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

from gapsweep.report import backdrop
from gapsweep.report.drawing import attractor_peaks, said_of_peaks
from gapsweep.report.figures import bifurcation
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
    assert key == drawn
    said = backdrop.said_of_bands(shown)
    assert {kind for kind in BANDS if kind in said} == drawn
    assert bool(said) == bool(drawn)


@pytest.mark.parametrize(("of_peaks", "heights"), [(False, [-2.0, 3.0]), (True, [3.0])])
def test_below_peaks_stands_no_wall_that_would_press_them_flat(of_peaks, heights):
    axes = Figure().subplots()
    backdrop.walls(axes, scene("periodic"), of_peaks=of_peaks)
    assert [line.get_ydata()[0] for line in axes.lines] == pytest.approx(heights)


def test_a_dot_without_a_known_basin_is_no_small_basin():
    axes = Figure().subplots()
    attractor_peaks(axes, attractors(np.nan, 0.01, 1.0), "omega")
    unknown, small, whole = axes.collections[0].get_sizes()
    assert small < unknown < whole


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (attractors(np.nan, np.nan), ""),
        (attractors(0.3, np.nan), " The area of a dot is the share of the starts that end on it."),
        (attractors(np.nan, kind="chaotic"), " Hollow: not periodic."),
        (
            attractors(0.5, kind="quasiperiodic"),
            " The area of a dot is the share of the starts that end on it; hollow: not periodic.",
        ),
    ],
)
def test_a_caption_says_of_dots_what_is_to_be_seen(found, said):
    assert said_of_peaks(found) == said
