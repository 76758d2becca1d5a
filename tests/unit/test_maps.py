"""Maps: every cell has its colour, at its place on the axes, and says what it is."""

import io
import re

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from numpy.testing import assert_allclose
from tests.builders.datasets import (
    chaotic,
    datasets,
    failed,
    over_forcing,
    over_walls,
    periodic,
    tables,
    unresolved,
)

import gapsweep as gs
import gapsweep.report.accessor  # plain xarray.load_dataset does not bring it along
from gapsweep.analysis.agreement.comparison import agreement
from gapsweep.report.maps import edges, mesh, numbered_as
from gapsweep.report.scales import is_log
from gapsweep.report.style import CLASS_COLOURS, colour
from gapsweep.study.points import canonical

mpl.use("Agg")
OMEGA, FORCING = [5.0, 6.0, 7.0, 8.0], [1.0, 10.0, 100.0]
NO_COLOUR = (1.0, 1.0, 1.0, 1.0)  # the paper


def answer(label, omega, start, forcing):
    """A class for every frequency; period 2 at the largest forcing."""
    if omega == 6.0:
        return chaotic([(1e-3, 0.0), (2e-3, 0.0)], omega)
    if omega == 7.0:
        return unresolved([(1e-3, 0.0), (2e-3, 0.0)], omega)
    if omega == 8.0:
        return failed()
    points = [(1e-3 * forcing, 0.0), (5e-4 * forcing, 0.0)]
    return periodic(points[: 2 if forcing == 100.0 else 1], omega)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    study = tables(["piecewise", "tanh-1e4"], OMEGA)
    study["sweep"][0]["K_c"] = [1e4, 1e5]
    block = {**study["sweep"][0], "K_c": [1e5], "representation": ["tanh-1e4"]}
    study["sweep"] = [{**study["sweep"][0], "representation": ["piecewise"]}, block]
    return over_forcing(tmp_path_factory.mktemp("made"), study, answer, FORCING)


@pytest.fixture
def ax():
    figure = Figure(figsize=(6, 5), layout="constrained")
    FigureCanvasAgg(figure)
    return figure.subplots()


def colours(axes, x, y):
    """Rendered RGBA colours at places of an axes."""
    axes.figure.canvas.draw()
    seen = np.asarray(axes.figure.canvas.buffer_rgba()) / 255.0
    at = axes.transData.transform(np.column_stack([np.ravel(x), np.ravel(y)])).astype(int)
    return seen[seen.shape[0] - 1 - at[:, 1], at[:, 0]]


def is_hatched(axes, x, y):
    """Whether white lines cross the colour of failures around a place."""
    axes.figure.canvas.draw()
    seen = np.asarray(axes.figure.canvas.buffer_rgba()) / 255.0
    column, row = axes.transData.transform((x, y)).astype(int)
    row = seen.shape[0] - 1 - row
    around = seen[row - 8 : row + 9, column - 8 : column + 9].reshape(-1, 4)
    face = np.isclose(around, to_rgba(CLASS_COLOURS["failed"]), atol=0.01).all(axis=1)
    return face.any() and around.min(axis=1).max() > 0.6


def key(axes):
    legend = axes.get_legend()
    return [text.get_text() for text in legend.get_texts()] if legend else []


def test_every_class_has_its_colour_where_it_is(made, ax):
    one = {"representation": "piecewise", "K_c": 1e4}
    assert made[0].gapsweep.map("response_class", y="forcing", ax=ax, **one) is ax
    x, y = np.meshgrid(OMEGA[:3], FORCING)
    shades = [CLASS_COLOURS[name] for name in ("periodic", "chaotic", "unresolved")]
    assert_allclose(colours(ax, x, y), [to_rgba(shade) for shade in shades * 3], atol=0.01)
    assert all(is_hatched(ax, 8.0, forcing) for forcing in FORCING)
    assert key(ax) == ["periodic", "chaotic", "unresolved", "failed"]
    assert (ax.get_xscale(), ax.get_yscale()) == ("linear", "log")
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("forcing frequency [Hz]", "forcing amplitude [N]")
    assert ax.get_title(loc="left") == "piecewise, K_c = 10000 N/m, gap 0.4/0.4 mm"


def test_periods_are_told_apart_and_what_has_none_too(made, ax):
    made[0].gapsweep.map("period_multiple", y="forcing", ax=ax, representation="piecewise", K_c=1e4)
    assert key(ax) == ["P1", "P2", "chaotic", "unresolved", "failed"]
    seen = colours(ax, [5.0, 5.0, 5.0, 6.0], [1.0, 10.0, 100.0, 1.0])
    assert_allclose(seen[0], seen[1])
    assert not np.allclose(seen[0], seen[2], atol=0.1)
    assert_allclose(seen[3], to_rgba(CLASS_COLOURS["chaotic"]), atol=0.01)


@pytest.mark.parametrize("variable", ["period_multiple", "response_class", "status", "x_max"])
def test_what_is_masked_is_blank_and_the_rest_as_before(made, variable):
    """xarray makes floats of masked flags."""
    axes = []
    for dataset in (made[0], made[0].where(made[0].omega < 7.5)):
        figure = Figure(figsize=(6, 5), layout="constrained")
        FigureCanvasAgg(figure)
        one = {"representation": "piecewise", "K_c": 1e4}
        axes.append(dataset.gapsweep.map(variable, y="forcing", ax=figure.subplots(), **one))
    x, y = np.meshgrid(OMEGA[:3], FORCING)
    # Frequencies that are left out leave their cells out, and the scale of the axis as it is.
    assert_allclose(*(colours(one, x, y) for one in axes), atol=0.02)
    assert_allclose(colours(axes[1], [8.0], [10.0]), [NO_COLOUR], atol=0.02)


def test_numbers_have_a_colour_bar_with_a_unit(made, ax):
    made[0].gapsweep.map("amplitude", y="forcing", ax=ax, representation="piecewise", K_c=1e4)
    (bar,) = (axes for axes in ax.figure.axes if axes is not ax)
    assert bar.get_ylabel() == "half the range of the steady response [mm]"
    assert key(ax) == ["unresolved", "failed"]
    seen = colours(ax, [5.0, 5.0, 7.0, 8.0], [1.0, 100.0, 1.0, 1.0])
    ends = [mpl.colormaps["viridis"](place) for place in (0.0, 1.0)]
    rest = [to_rgba(CLASS_COLOURS[name]) for name in ("unresolved", "failed")]
    assert_allclose(seen, [*ends, *rest], atol=0.02)


def test_what_was_not_asked_for_is_blank_and_said_to_be(made, ax):
    wanted = {"representation": "tanh-1e4", "forcing": 10.0}
    made[0].gapsweep.map("response_class", y="K_c", ax=ax, **wanted)
    seen = colours(ax, [5.0, 5.0], [1e4, 1e5])
    assert_allclose(seen, [NO_COLOUR, to_rgba(CLASS_COLOURS["periodic"])], atol=0.01)
    assert key(ax)[-1] == "blank: not requested"


def test_attractors_are_counted(made, ax):
    made[1].gapsweep.map("n_attractors", y="forcing", ax=ax, representation="piecewise", K_c=1e4)
    assert key(ax) == ["1", "blank: none found, or not requested"]
    assert ax.get_legend().get_title().get_text() == "number of attractors found"


def test_metrics_are_mapped_too(made, ax):
    compared = agreement(*made)
    where = {"representation": "tanh-1e4", "K_c": 1e5}
    compared.gapsweep.map("class_agreement", y="forcing", ax=ax, **where)
    assert key(ax) == []
    compared.gapsweep.map("f1_pooled", x="K_c", y="forcing", ax=ax, representation="tanh-1e4")
    assert "regime: all" in ax.get_title(loc="left")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda r, a: r.gapsweep.map(representation="piecewise"), "K_c: .* room for one value"),
        (lambda r, a: r.gapsweep.map(y="K_c"), "representation: .* room for one value"),
        (lambda r, a: r.gapsweep.map("n_attractors"), "n_attractors: .* it is in attractors.nc"),
        (lambda r, a: a.gapsweep.map("amplitude"), "amplitude: .* it is in responses.nc"),
        (lambda r, a: r.gapsweep.map(y="gap"), "gap: holds text.* axes: omega, forcing, K_c"),
        (lambda r, a: r.gapsweep.map(y="zeta"), "zeta: no coordinate .* axes: omega, forcing, K_c"),
        (lambda r, a: r.gapsweep.map(y="omega"), "omega: both axes"),
        (lambda r, a: r.gapsweep.map(forcing=3.0), "forcing = 3.0: not in this dataset, which has"),
    ],
)
def test_what_is_no_map_is_refused_with_the_remedy(made, call, message):
    with pytest.raises(gs.DatasetError, match=message):
        call(*made)


AXIS = st.lists(st.floats(0.1, 1e3).map(canonical), min_size=2, max_size=6, unique=True).map(sorted)


@given(AXIS)
def test_edges_lie_halfway_and_cells_touch(values):
    values = np.array(values)
    for log in (False, True):
        ends = edges(values, log=log)
        scaled, at = (np.log(v) if log else v for v in (ends, values))
        assert_allclose(scaled[1:-1], 0.5 * (at[1:] + at[:-1]))
        assert np.all((ends[:-1] < values) & (values < ends[1:]))


def test_what_is_positive_has_no_cells_below_zero():
    assert_allclose(edges(np.array([1e4, 1e5]), log=False), [0.0, 5.5e4, 1.45e5])
    assert_allclose(edges(np.array([0.0, 1.0]), log=False), [-0.5, 0.5, 1.5])


def far_enough(values):
    """Cells of a few pixels at least, on either scale; the first one may end at zero."""
    if values[0] < 0.03 * values[-1]:
        return False
    for scale in (values, np.log(values)):
        if np.diff(scale).min() < 0.03 * (scale[-1] - scale[0]):
            return False
    return True


@settings(max_examples=15, deadline=None)
@given(*[AXIS.filter(lambda values: far_enough(np.array(values)))] * 2, st.randoms())
def test_cells_of_any_width_are_where_their_values_are(x, y, random):
    axes = Figure(figsize=(6, 5)).subplots()
    FigureCanvasAgg(axes.figure)
    cells = np.array([[[*(random.randrange(256) for _ in range(3)), 255] for _ in x] for _ in y])
    at = [xr.DataArray(values, dims=name, name=name) for name, values in (("x", x), ("y", y))]
    mesh(axes, *at, cells.astype(np.uint8))
    seen = colours(axes, *np.meshgrid(x, y))
    assert_allclose(255 * seen, cells.reshape(-1, 4), atol=1.5)


def test_drawings_keep_every_cell():
    """Also of a logarithmic axis, where matplotlib would resample an image."""
    axes = Figure(figsize=(6, 5)).subplots()
    cells = np.zeros((40, 30, 4), np.uint8)
    places = {"omega": np.linspace(1.0, 9.0, 30), "K_c": np.geomspace(1.0, 1e4, 40)}
    mesh(axes, *(xr.DataArray(v, dims=n, name=n) for n, v in places.items()), cells)
    drawing = io.StringIO()
    axes.figure.savefig(drawing, format="svg")
    (image,) = re.findall("<image[^>]*>", drawing.getvalue())
    assert ('width="30"' in image, 'height="40"' in image) == (True, True)
    width, _, _, height, left, low = map(float, re.search(r"matrix\(([^)]*)\)", image)[1].split())
    box = axes.get_position()
    assert_allclose([left, left + 30 * width], [432.0 * box.x0, 432.0 * box.x1])
    assert_allclose([low, low + 40 * height], [360.0 * (1.0 - y) for y in (box.y0, box.y1)])


@pytest.mark.parametrize(
    ("name", "values", "log"),
    [
        ("K_c", np.geomspace(1e3, 1e6, 50), True),
        ("K_c", np.linspace(1e3, 1e6, 50), False),
        ("K_c", np.array([1.4e4, 1.4e6]), True),
        ("K_c", np.array([1.4e4, 2.8e4]), False),
        ("K_c", np.array([1e3, 2e3, 4e3, 8e3]), True),
        ("K_c", np.array([1.00e3, 1.01e3, 1.02e3]), False),
        ("omega", np.geomspace(0.1, 100.0, 50), False),
        ("alpha", np.array([-1e9, 0.0, 1e9]), False),
    ],
)
def test_axes_are_logarithmic_where_values_are_crowded(name, values, log):
    assert is_log(xr.DataArray(values, dims=name, name=name)) == log


def test_every_number_can_be_the_axis_of_a_curve(made, ax):
    one = {"representation": "piecewise", "K_c": 1e4, "omega": 5.0}
    made[0].gapsweep.bifurcation(along="forcing", ax=ax, **one)
    (line,) = (
        ln for ln in ax.lines if ln.get_color() == colour("piecewise") and len(ln.get_xdata())
    )
    peaks = [(1.0, 1.0), (10.0, 10.0), (100.0, 100.0), (100.0, 50.0)]
    pairs = sorted(peaks + [(force, -x) for force, x in peaks])
    assert_allclose(sorted(np.column_stack(line.get_data()).tolist()), pairs)
    assert ax.get_xlabel() == "forcing amplitude [N]"
    assert ax.get_title(loc="left").endswith("gap 0.4/0.4 mm, omega = 5 Hz")
    made[0].gapsweep.frequency_response(ax=ax, forcing=10.0, K_c=1e4)
    assert ax.get_title(loc="left").endswith("gap 0.4/0.4 mm, forcing = 10 N")


def test_a_wall_that_moves_along_the_axis_is_a_curve(tmp_path, ax):
    j_1, j_2 = [0.2e-3, 0.4e-3], [0.4e-3, 0.6e-3]
    (responses, _), _ = over_walls(
        tmp_path, ["piecewise"], [5.0], j_1, j_2, lambda _, w, i: periodic([(1e-3, 0.0)], w)
    )
    responses.gapsweep.bifurcation(along="j_2", j_1=0.2e-3, ax=ax)
    low, high = (line for line in ax.lines if line.get_linestyle() == "--")
    assert_allclose(low.get_ydata(), -0.2)
    assert_allclose(high.get_data(), [[0.4, 0.6], [0.4, 0.6]])
    assert ax.get_title(loc="left") == "piecewise, K_c = 14000 N/m, j_1 = 0.2 mm, omega = 5 Hz"
    assert "j_2" in repr(responses.gapsweep)


# --- maps of starts --------------------------------------------------------------------------


def starts(folder, n_x, n_v, lost=0):
    """A grid of starts: those left of the middle end on one attractor, the others on another."""
    x, v = np.linspace(-1e-3, 1e-3, n_x), np.linspace(-0.1, 0.1, n_v)
    states = [[float(a), float(b)] for a in x for b in v]
    states = states[: len(states) - lost]
    study = tables(["piecewise"], [5.0])
    study["sweep"][0]["initial_condition"] = states

    def answer(label, omega, i):
        size = 1e-3 if states[i][0] < 0.0 else 2e-3
        return failed() if i == 0 else periodic([(size, 0.0)], omega, extrema=[size, -size])

    return datasets(folder, study, answer)[0]


def test_starts_of_a_full_grid_are_a_map(tmp_path, ax):
    responses = starts(tmp_path, 4, 3)
    responses.gapsweep.map("amplitude", x="x_0", y="v_0", ax=ax)
    seen = colours(ax, [-1.0, -1.0, 1.0], [-100.0, 0.0, 0.0])
    low, high = (mpl.colormaps["viridis"](place) for place in (0.0, 1.0))
    assert_allclose(seen[1:], [low, high], atol=0.02)
    assert is_hatched(ax, -1.0, -100.0)
    assert (ax.get_xlabel(), ax.get_ylabel()) == (
        "initial displacement [mm]",
        "initial velocity [mm/s]",
    )
    with pytest.raises(gs.DatasetError, match="the 11 fixed starts are no full grid"):
        starts(tmp_path, 4, 3, lost=1).gapsweep.map("response_class", x="x_0", y="v_0", ax=ax)


def starts_on(attractors, peaks, periods):
    """Every start's attractor, with what that is."""
    at = np.array(attractors)
    return xr.Dataset(
        {
            "attractor": ("initial_condition", at),
            "x_max": ("initial_condition", np.array(peaks)[at]),
            "period_multiple": ("initial_condition", np.array(periods)[at]),
        }
    )


def test_attractors_of_a_law_are_numbered_as_the_exact_ones_that_they_are_like():
    exact = starts_on([0, 1, 2], peaks=[1.0, 2.0, 3.0], periods=[1, 1, 3])
    # the second first, another period, one that the exact law has not, and a start without one
    law = starts_on([0, 1, 2, 0], peaks=[2.02, 1.01, 3.0], periods=[1, 1, 1])
    law["attractor"][3] = -1
    assert numbered_as(law, exact)["attractor"].values.tolist() == [1, 0, 3, -1]
    assert numbered_as(exact, exact)["attractor"].values.tolist() == [0, 1, 2]
