"""``ds.gapsweep``: draws what is in the data, of any selection, and says what it cannot draw."""

import contextlib
import subprocess
import sys
import weakref

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from numpy.testing import assert_allclose
from tests.builders.datasets import branches as of_branches
from tests.builders.datasets import chaotic, datasets, failed, periodic, tables

import gapsweep as gs
import gapsweep.report.accessor  # plain xarray.load_dataset does not bring it along
from gapsweep.analysis.agreement.comparison import agreement
from gapsweep.continuation.special import Special
from gapsweep.model.systems import paper_oscillator
from gapsweep.report.branch_lines import caption, of_scene
from gapsweep.report.figure_data import as_csv
from gapsweep.report.figures import frequency_response
from gapsweep.report.style import GREY, MATPLOTLIB, NOT_PERIODIC, colour

mpl.use("Agg")
LABELS = ["piecewise", "tanh-1e4", "poly-13"]
OMEGA = [5.0, 6.0, 7.0, 8.0]
SCENE = {"K_c": 1.4e4, "gap": "0.4/0.4"}


def answer(label, omega, start):
    """Peaks fall with frequency; tanh is chaotic at 7 Hz, the polynomial fails at 8 Hz."""
    x = (1.0 + 0.1 * LABELS.index(label) + 0.3 * start) * 1e-3 / omega
    if label == "tanh-1e4" and omega == 7.0:
        return chaotic([(x, 0.0), (0.5 * x, 0.0)], omega)
    if label == "poly-13" and omega == 8.0:
        return failed()
    return periodic([(x, 0.0)], omega)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    wanted = tables(LABELS, OMEGA, starts=2, sweeps=["sweep_up"])
    return datasets(folder, wanted, answer)


@pytest.fixture(scope="module")
def responses(made):
    return made[0]


@pytest.fixture(scope="module")
def attractors(made):
    return made[1]


@pytest.fixture(scope="module")
def compared(made):
    return agreement(*made)


@pytest.fixture
def ax():
    return Figure().subplots()


@pytest.fixture(scope="module")
def precision():
    """Made-up costs: each method is a straight line, and one fails at its loosest tolerance."""
    dims = ("scene", "method", "tolerance")
    error = np.geomspace(1e-2, 1e-8, 4) * np.array([[[1.0], [3.0]], [[1.0], [3.0]]])
    status = np.zeros(error.shape, "i1")
    status[:, 1, 0] = gs.Status.DIVERGED
    status[:, 0, 3] = gs.Status.NOT_REQUESTED
    return xr.Dataset(
        {
            "total_error": (dims, error, {"units": "1", "long_name": "end error"}),
            "cpu_time": (dims, 1e-6 / error**0.1, {"units": "s", "long_name": "cost per second"}),
            "cpu_time_q25": (dims, 0.9e-6 / error**0.1),
            "cpu_time_q75": (dims, 1.2e-6 / error**0.1),
            "at_reference_floor": (dims, np.zeros(error.shape, "i1")),
            "model_error": (dims[:2], [[0.0, 1e-3], [0.0, 1e-3]], {"units": "1"}),
            "status": (dims, status),
            "on_front": (dims, np.zeros(error.shape, "i1") + np.array([[1], [0]], "i1")),
        },
        {
            "scene": ["soft", "hard"],
            "K_c": ("scene", [1.4e4, 1.4e6], {"units": "N m-1"}),
            "method": ["piecewise", "tanh-1e4"],
            "rtol": (dims[1:], [[1e-3, 1e-5, 1e-7, 1e-9]] * 2),
        },
    )


def drawn(axes, shade=None):
    """All points of an axes, of one colour if given, walls and legends left out; sorted."""
    lines = [line for line in axes.lines if len(line.get_xdata()) and line.get_linestyle() != "--"]
    chosen = [ln for ln in lines if shade in (None, to_hex(ln.get_color()))]
    pairs = np.concatenate([np.column_stack(ln.get_data()) for ln in chosen] or [np.empty((0, 2))])
    pairs = pairs[np.isfinite(pairs).all(axis=1)]
    return pairs[np.lexsort(pairs.T)]


def expected(variable):
    """Frequencies [Hz] and values [mm] of all finite values of a variable; sorted."""
    omega, values = xr.broadcast(variable["omega"], variable)
    pairs = np.column_stack([omega.values.ravel(), 1e3 * values.values.ravel()])
    pairs = pairs[np.isfinite(pairs).all(axis=1)]
    return pairs[np.lexsort(pairs.T)]


def walls(axes):
    return sorted(line.get_ydata()[0] for line in axes.lines if line.get_linestyle() == "--")


def test_no_line_leads_over_a_jump(tmp_path, ax):
    """In a figure of the report neither, nor in its numbers; every value is drawn all the same."""
    size = dict(
        zip(np.arange(7.0, 15.0), [0.98, 1.13, 1.35, 1.7, 0.35, 0.29, 0.24, 0.2], strict=True)
    )

    def answer(label, omega, start):
        return periodic([(1e-3 * size[omega], 0.0)], omega)

    found, _ = datasets(tmp_path, tables(["piecewise", "tanh-1e4"], size), answer)
    found.gapsweep.frequency_response(ax=ax)
    with mpl.rc_context(MATPLOTLIB):
        figure = frequency_response(found.isel(K_c=0, gap=0))
    for axes in (ax, figure.axes[0]):
        for line in axes.lines:
            x, y = line.get_xdata(), line.get_ydata()
            assert_allclose(x[np.isfinite(y)], list(size))
            assert_allclose(y[np.isfinite(y)], list(size.values()))
            assert np.nanmax(np.abs(np.diff(y))) < 0.4  # mm, of neighbours that a line joins
    values = [row.split(",")[4] for row in as_csv(figure).splitlines() if ",line," in row]
    assert values.count("") == 2


def test_frequency_response_draws_every_amplitude(responses, ax):
    assert responses.gapsweep.frequency_response(ax=ax, **SCENE) is ax
    for label in LABELS:
        assert_allclose(
            drawn(ax, colour(label).lower()),
            expected(responses["amplitude"].sel(representation=label)),
        )
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("forcing frequency [Hz]", "amplitude [mm]")
    assert ax.get_legend_handles_labels()[1] == [*LABELS, "sweep_up"]
    assert ax.get_title(loc="left") == "K_c = 14000 N/m, gap 0.4/0.4 mm"


def test_bifurcation_draws_every_extremum_between_the_walls(responses, ax):
    responses.gapsweep.bifurcation(along="omega", ax=ax, **SCENE)
    assert_allclose(drawn(ax), expected(responses["extrema"]))
    assert_allclose(walls(ax), [-0.4, 0.4])
    assert ax.get_ylabel() == "steady extrema [mm]"


def test_one_representation_shows_what_is_not_periodic_in_red(responses, ax):
    responses.gapsweep.bifurcation(ax=ax, representation="tanh-10000")
    tanh = responses["extrema"].sel(representation="tanh-1e4")
    assert_allclose(drawn(ax, NOT_PERIODIC), expected(tanh.sel(omega=[7.0])))
    assert_allclose(
        drawn(ax, colour("tanh-1e4").lower()), expected(tanh.sel(omega=[5.0, 6.0, 8.0]))
    )


def test_compare_draws_the_second_before_the_first(responses, ax):
    responses.gapsweep.compare("piecewise", "tanh-1e4", ax=ax, omega=slice(6, 8))
    for label in ("piecewise", "tanh-1e4"):
        peaks = responses["x_max"].sel(representation=label, omega=slice(6, 8))
        assert_allclose(drawn(ax, colour(label).lower()), expected(peaks))
    of_laws = [ln for ln in ax.lines if "piecewise" in ln.get_label() or "tanh" in ln.get_label()]
    sizes = {to_hex(ln.get_color()): ln.get_markersize() for ln in of_laws}
    assert sizes[colour("piecewise")] > sizes[colour("tanh-1e4").lower()]
    assert to_hex(of_laws[-1].get_color()) == colour("tanh-1e4")


@pytest.mark.parametrize("wanted", [{"start": "sweep_up"}, {"initial_condition": "sweep_up"}])
def test_a_sweep_is_selected_by_its_name_and_has_its_marker(responses, ax, wanted):
    responses.gapsweep.frequency_response(ax=ax, representation="piecewise", **wanted)
    up = responses["amplitude"].sel(representation="piecewise", initial_condition=2)
    assert_allclose(drawn(ax), expected(up))
    assert {line.get_marker() for line in ax.lines if len(line.get_xdata())} == {"^"}
    assert "sweep_up" in ax.get_legend_handles_labels()[1]


def test_attractors_over_frequency_are_as_large_as_their_basins(attractors, ax):
    attractors.gapsweep.attractors(ax=ax, representation="piecewise")
    dots = np.concatenate([dots.get_offsets() for dots in ax.collections])
    one = attractors.sel(representation="piecewise")
    assert_allclose(dots[np.lexsort(dots.T)], expected(one["x_max"]))
    areas = np.concatenate([dots.get_sizes() for dots in ax.collections])
    shares = one["basin_share"].values.ravel()
    assert_allclose(np.unique(areas), np.unique(4.0 + 20.0 * shares[np.isfinite(shares)]))


def test_attractors_keep_their_track_where_their_numbers_change(ax):
    """A branch from 0.5 m down, one from 0.1 m up: they cross in the order of peaks."""
    peaks = [[0.1, 0.5], [0.12, 0.4], [0.15, 0.25], [np.nan, 0.2], [0.25, 0.9]]
    shares = [[0.2, 0.8], [0.3, 0.7], [0.4, 0.6], [np.nan, 1.0], [0.9, 0.1]]
    dims = ("omega", "attractor")
    mm = {"units": "m"}
    found = xr.Dataset(
        {
            "x_max": (dims, peaks, mm),
            "x_min": (dims, -np.array(peaks), mm),
            "period_multiple": (dims, np.ones((5, 2), int)),
            "basin_share": (dims, shares),
            "basin_share_error": (dims, np.full((5, 2), 0.05)),
        },
        {"omega": [1.0, 2.0, 3.0, 4.0, 5.0], "representation": "piecewise"},
    )
    found["x_max"].loc[{"omega": 4.0}] = [np.nan, 0.22]
    track = found.gapsweep.with_tracks()["track"].values.tolist()
    assert track == [[0, 1], [0, 1], [0, 1], [-1, 1], [1, 2]]
    found.gapsweep.basin_shares(ax=ax)
    lines = {line.get_label(): line for line in ax.lines if not line.get_label().startswith("_")}
    assert_allclose(lines["P1, peak 500 mm"].get_ydata(), [0.8, 0.7, 0.6, 1.0, 0.9])
    assert_allclose(lines["P1, peak 100 mm"].get_xdata(), [1.0, 2.0, 3.0])
    ends = np.concatenate([line.get_ydata() for line in ax.lines if line.get_linewidth() == 3.0])
    assert_allclose(np.nanmin(ends), 0.1 - 1.96 * 0.05)
    assert np.nanmax(ends) == 1.0


def test_attractors_at_one_frequency_are_sections(attractors, ax):
    attractors.gapsweep.attractors(ax=ax, representation="tanh-1e4", omega=7.0)
    one = attractors.sel(representation="tanh-1e4", omega=7.0)
    x = one["section_x"].values[np.isfinite(one["section_x"].values)]
    assert_allclose(np.sort(drawn(ax)[:, 0]), np.sort(1e3 * x))
    assert ax.get_xlabel() == "displacement at whole forcing periods [mm]"
    assert ax.get_ylabel() == "velocity at whole forcing periods [mm/s]"
    assert "chaotic" in ax.get_legend_handles_labels()[1][0]


def test_attractors_of_starts_are_told_by_colour(responses, ax):
    responses.gapsweep.attractors(ax=ax, representation="piecewise", omega=5.0)
    assert_allclose(np.unique(drawn(ax)[:, 0]), [0.0, 0.01])
    names = ax.get_legend_handles_labels()[1]
    assert names == ["P1, peak 0.2 mm", "P1, peak 0.26 mm"]
    assert ax.get_xlabel() == "initial displacement [mm]"


def test_basins_are_a_map_of_the_starts(ax):
    found = gs.basins(
        paper_oscillator(), gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4)), 20.0, x=[0.0, 1e-3], v=[0.0]
    )
    found.gapsweep.attractors(ax=ax)
    shades = ax.images[0].get_array().reshape(-1, 4)
    ids = found["attractor"].values.ravel()
    assert [[tuple(a) == tuple(b) for b in shades] for a in shades] == [
        [a == b for b in ids] for a in ids
    ]
    assert ax.get_ylabel() == "initial velocity [mm/s]"


def test_agreement_has_a_row_per_representation(compared, ax):
    compared.gapsweep.agreement("amplitude_error_median", ax=ax)
    assert [text.get_text() for text in ax.get_yticklabels()] == LABELS[1:]
    row = compared["amplitude_error_median"].sel(regime="all", representation=LABELS[1:])
    dots = [line.get_xdata()[0] for line in ax.lines if line.get_marker() == "o"]
    assert_allclose(dots, row.values.ravel())
    assert ax.get_xlabel() == row.attrs["long_name"]


def test_agreement_shows_interval_and_floor(compared, ax):
    with_interval = compared.copy(deep=True)
    with_interval["amplitude_error_median_ci"][:] = [0.01, 0.2]
    with_interval["amplitude_error_median_floor"][:] = 0.015
    with_interval.gapsweep.agreement(ax=ax, representation="poly-13")
    ends = [list(line.get_xdata()) for line in ax.lines if line.get_linestyle() == "-"]
    assert [0.01, 0.2] in ends
    assert [line.get_xdata()[0] for line in ax.lines if line.get_linestyle() == "--"] == [0.015]


def test_agreement_over_frequency_is_a_curve(compared, ax):
    compared.gapsweep.agreement("amplitude_error", ax=ax, representation="poly-13")
    error = compared["amplitude_error"].sel(representation="poly-13")
    pairs = expected(error / 1e3)
    assert_allclose(drawn(ax), pairs, rtol=1e-6)
    assert len(pairs) == 9


def test_work_precision_shows_front_and_failures(precision, ax):
    precision.gapsweep.work_precision(scene="soft", ax=ax)
    assert ax.get_legend_handles_labels()[1] == ["piecewise", "tanh-1e4"]
    assert [text.get_text() for text in ax.texts] == ["× tanh-1e4: diverged"]
    assert ax.get_title(loc="left") == "soft, K_c = 14000 N/m"
    soft = precision.sel(scene="soft")
    there = {"piecewise": slice(3), "tanh-1e4": slice(1, None)}
    lines = {str(line.get_label()): line for line in ax.lines}
    for position, (name, tolerances) in enumerate(there.items()):
        one, line = soft.isel({"method": position, "tolerance": tolerances}), lines[name]
        is_shown = np.isfinite(line.get_xdata())
        assert_allclose(line.get_xdata()[is_shown], one["total_error"])
        assert_allclose(line.get_ydata()[is_shown], one["cpu_time"])
    assert list(lines["_tanh-1e4, its own error"].get_xdata()) == [1e-3, 1e-3]
    assert "_piecewise, its own error" not in lines
    assert len(lines["_tanh-1e4, failed"].get_ydata()) == 1
    rings = [name for name, line in lines.items() if "front" in name and len(line.get_xdata())]
    assert rings == ["_piecewise, on the front"]
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("end error", "cost per second [s]")


def test_axes_are_made_where_none_are_given(responses):
    axes = responses.gapsweep.frequency_response()
    assert isinstance(axes, Axes)
    plt.close(axes.figure)


def test_units_are_those_of_the_dataset(responses, ax):
    inches = responses.copy()
    inches["amplitude"] = (responses["amplitude"] / 0.0254).assign_attrs(units="inch")
    inches.gapsweep.frequency_response(ax=ax)
    assert ax.get_ylabel() == "amplitude [inch]"
    assert_allclose(drawn(ax), expected(inches["amplitude"] / 1e3))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda r, a: a.gapsweep.bifurcation(), "extrema: no variable .* it is in responses.nc"),
        (lambda r, a: r.gapsweep.agreement(), "amplitude_error_median: .* in agreement.nc"),
        (lambda r, a: r.gapsweep.work_precision(), "total_error: .* work_precision.nc"),
        (lambda r, a: r.gapsweep.bifurcation(K_c=3.0), r"K_c = 3.0: .* which has 14000"),
        (lambda r, a: r.gapsweep.bifurcation(stiffness=3.0), "stiffness: not a coordinate"),
        (lambda r, a: r.gapsweep.bifurcation(gap=slice(1, 2)), "gap = slice.*: must be a label"),
        (lambda r, a: r.gapsweep.bifurcation(representation="tan"), ".tan.: not in this"),
        (lambda r, a: r.gapsweep.bifurcation(omega=[5.0, 5.5]), r"omega = 5.5: not in this"),
        (lambda r, a: r.gapsweep.compare("piecewise", "poly-7"), "'poly-7': not in this"),
        (lambda r, a: r.gapsweep.attractors(omega=5.0), "room for one .* representation='piece"),
        (lambda r, a: r.gapsweep.bifurcation(along="gap"), "draw along omega or K_c"),
        (
            lambda r, a: r.isel(omega=0, drop=True).gapsweep.bifurcation(),
            "omega: no coordinate .* without drop=True",
        ),
        (
            lambda r, a: xr.concat([r, r.assign_coords(K_c=[9.0])], "K_c").gapsweep.bifurcation(),
            "K_c: .* room for one value .* 14000, 9; choose: K_c=14000",
        ),
    ],
)
def test_what_cannot_be_drawn_is_refused_with_the_remedy(responses, attractors, call, message):
    with pytest.raises(gs.DatasetError, match=message):
        call(responses, attractors)


@pytest.fixture
def branched():
    """A fold at step 2 and a graze at 4 of one branch; a shorter one with a doubling at its end."""
    stable = [[1, 1, 1, 0, 0, 1], [0, 0, 1, -1, -1, -1]]
    special = [[0, 0, 1, 0, 5, 0], [0, 0, 2, 0, 0, 0]]
    return of_branches(stable, special)


def ends(axes, dashes):
    """First and last heights [mm] of all unbroken lines drawn in a style."""
    found = []
    for line in axes.lines:
        y = np.asarray(line.get_ydata(), float)
        if line.get_linestyle() == dashes and y.size:
            pieces = np.split(y, np.flatnonzero(np.isnan(y)))
            pieces = [each[np.isfinite(each)] for each in pieces]
            found += [(each[0], each[-1]) for each in pieces if each.size]
    return sorted(found)


def marks(axes):
    """Heights [mm] of the special points, by the words of the legend."""
    kinds = [line for line in axes.lines if line.get_linestyle() == "None"]
    return {line.get_label(): list(line.get_ydata()) for line in kinds}


def test_unstable_parts_of_branches_are_dashed(branched, ax):
    """At the fold, where the flag is rounding, the steps on either side decide."""
    branched.gapsweep.branches(ax=ax)
    assert ends(ax, "-") == [(0.0, 2.0)]
    assert ends(ax, "--") == [(2.0, 5.0), (10.0, 12.0)]
    branched["stable"][0, 2] = 0
    other = branched.gapsweep.branches(ax=Figure().subplots())
    assert ends(other, "-") == [(0.0, 2.0)]


def test_special_points_are_marked_and_named(branched, ax):
    branched.gapsweep.branches(ax=ax)
    assert marks(ax) == {"LP fold": [2.0], "PD period doubling": [12.0], "GR graze": [4.0]}
    assert sorted(text.get_text().strip() for text in ax.texts) == ["GR", "LP", "PD"]
    told = [text.get_text() for text in ax.get_legend().get_texts()]
    assert told[:4] == ["branch 0, period 1", "branch 1, period 2", "unstable", "LP fold"]


def test_two_points_of_a_kind_at_one_place_have_one_symbol(ax):
    """As a bifurcation that is on the branch that it leaves, and on the one that it starts."""
    made = of_branches(np.ones((2, 3), "i1"), [[0, 6, 5], [0, 6, 0]])
    made["x_max"][1] = made["x_max"][0]
    made.gapsweep.branches(ax=ax)
    assert sorted(text.get_text().strip() for text in ax.texts) == ["GR", "SB"]


def test_special_points_are_numbered_in_a_table(branched):
    n = branched.sizes["step"]
    real = np.array([[0.5, 1.0]] * n + [[-1.0, 0.2]] * n).reshape(2, n, 2)
    dims = ("branch", "step", "multiplier")
    made = branched.assign(multiplier_real=(dims, real), multiplier_imag=(dims, 0.0 * real))
    made["status"] = xr.where(made["stable"] < 0, 1, 0).assign_attrs(
        flag_values=[0, 1], flag_meanings="ok not_requested"
    )
    height = xr.DataArray([1.0, -7.0], {"coordinate": ["h", "beta"]}, "coordinate")
    made["x_max"] = made["x_max"] * height
    table = made.gapsweep.special_points()
    assert table.index.name == "point"
    assert table.columns.tolist() == [
        *("branch", "step", "kind", "symbol", "omega", "x_max[h]", "x_max[beta]"),
        *("period_multiple", "multiplier"),
    ]
    assert table["branch"].tolist() == [0, 0, 1]
    assert table["step"].tolist() == [2, 4, 2]
    assert table["symbol"].tolist() == ["LP", "GR", "PD"]
    assert table["multiplier"].tolist() == [1.0, 1.0, -1.0]
    assert_allclose(table["x_max[beta]"], -7e-3 * np.array([2.0, 4.0, 12.0]))
    none = made.isel(step=[0, 1]).gapsweep.special_points()
    assert none.columns.tolist() == table.columns.tolist()
    assert none.empty
    with pytest.raises(gs.DatasetError, match="branches: none in this dataset"):
        made.drop_vars("special").gapsweep.special_points()


def test_a_curve_is_one_line_over_both_parameters(ax):
    made = of_branches(np.ones((1, 6), "i1"), [[0, 0, 9, 0, 0, 0]])
    made["forcing"] = 2.0 * made["omega"]
    made["curve_kind"] = ("branch", np.array([Special.PERIOD_DOUBLING], "i1"))
    made.attrs["second"] = "forcing"
    made.isel(branch=0, drop=True).gapsweep.branches(ax=ax)
    assert ax.get_ylabel().startswith("forcing amplitude")
    assert marks(ax) == {"CP cusp": [12.0]}
    told = [text.get_text() for text in ax.get_legend().get_texts()]
    assert told == ["PD period doubling", "CP cusp"]


def test_attractors_on_no_branch_are_counted(branched):
    here = xr.Dataset(coords={"representation": "piecewise"})
    found = branched.assign_coords(representation=("branch", ["piecewise"] * 2)).assign(
        attractor_on_branch=("attractor", [0, -1, -1])
    )
    found.attrs["initial_conditions"] = "states [[0.0, 0.0]] at omega = [5.0]"
    assert "2 of 3 periodic attractors lie on no branch" in caption(found, here, "omega")
    assert "3 periodic, 2 of them on no branch" in repr(found.gapsweep)
    assert "[[0.0, 0.0]]" in repr(found.gapsweep)
    labels = ["piecewise", "piecewise", "tanh-1e4"]
    found = found.assign_coords(attractor_representation=("attractor", labels))
    assert "1 of 2 periodic attractors" in caption(found, here, "omega")


def test_symbols_that_would_overlap_are_left_out(ax):
    made = of_branches(np.ones((1, 60), "i1"), np.full((1, 60), 5))
    made["x_max"][:] = 1e-3 + 1e-9 * np.arange(60)
    ax.set_ylim(0.0, 2.0)
    made.gapsweep.branches(ax=ax)
    assert len(marks(ax)["GR graze"]) == 60
    ax.figure.canvas.draw()
    boxes = [text.get_window_extent() for text in ax.texts]
    assert 8 < len(boxes) < 60
    pairs = [(a, b) for i, a in enumerate(boxes) for b in boxes[:i] if a.overlaps(b)]
    assert pairs == []
    beyond = Figure().subplots()
    beyond.set_xlim(0.0, 1.0)
    assert not made.gapsweep.branches(ax=beyond).texts


def test_branches_of_several_representations_have_their_colours(branched, ax):
    branched = branched.assign_coords(representation=("branch", ["piecewise", "tanh-1e4"]))
    branched.gapsweep.branches(ax=ax)
    shades = {to_hex(line.get_color()) for line in ax.lines if "stable" in str(line.get_label())}
    assert shades <= {colour("piecewise").lower(), colour("tanh-1e4").lower(), GREY}
    assert len(shades) == 3
    one = branched.gapsweep.branches(representation="tanh-1e4", ax=Figure().subplots())
    assert list(marks(one)) == ["PD period doubling"]


def test_branches_over_another_variable(branched, ax):
    branched.gapsweep.branches("frequency", along="x_max", ax=ax)
    assert ax.get_ylabel() == "frequency of the orbit [Hz]"
    assert marks(ax)["LP fold"] == [5.0]
    branched.attrs["along"] = "amplitude"  # a family of free motions: a backbone
    branched["amplitude"] = branched["x_max"]
    free = branched.gapsweep.branches("amplitude", ax=Figure().subplots())
    assert free.get_xlabel() == "frequency of the orbit [Hz]"


def test_branches_lie_behind_the_attractors_of_their_scene(responses, branched, ax):
    branched = branched.assign_coords(
        representation=("branch", ["piecewise", "tanh-1e4"]), K_c=("branch", [1.4e4, 1.4e4])
    )
    responses.gapsweep.bifurcation(representation="piecewise", branches=branched, ax=ax, **SCENE)
    assert {k: v for k, v in marks(ax).items() if "LP" in k or "PD" in k} == {"LP fold": [2.0]}
    assert set(ends(ax, "--")) >= {(2.0, 5.0), (-2.0, -5.0)}
    dots = [line for line in ax.lines if ", periodic" in line.get_label()]
    behind = [line for line in ax.lines if "unstable" in str(line.get_label())]
    behind = [line.get_zorder() for line in behind if len(line.get_xdata())]
    assert 0 < max(behind) < min(line.get_zorder() for line in dots)
    elsewhere = branched.assign_coords(K_c=("branch", [1.0, 1.0]))
    alone = responses.gapsweep.bifurcation(
        representation="piecewise", branches=elsewhere, ax=Figure().subplots(), **SCENE
    )
    assert "LP fold" not in marks(alone)


def test_branches_of_systems_are_those_of_the_coordinate_that_is_drawn(branched, ax):
    """A figure without coordinates, as of a system with one, has the first."""
    size = xr.DataArray([1.0, -7.0], {"coordinate": ["h", "beta"]}, "coordinate")
    both = branched.assign(x_max=(branched["x_max"] * size).assign_attrs(units="m"))
    with pytest.raises(gs.DatasetError, match="coordinate: this plot has room for one"):
        both.gapsweep.branches(ax=ax)
    both.gapsweep.branches(coordinate="beta", ax=ax)
    assert marks(ax)["LP fold"] == [-14.0]
    here = xr.Dataset(coords={"representation": "piecewise"})
    assert of_scene(both, here, "omega", "x_max")["x_max"].max() == pytest.approx(0.012)
    beta = of_scene(both, here.assign_coords(coordinate="beta"), "omega", "x_max")
    assert beta["x_max"].min() == pytest.approx(-0.084)


def test_what_holds_no_branches_is_refused(responses, branched, ax):
    for call in (
        lambda: responses.gapsweep.branches(ax=ax),
        lambda: responses.gapsweep.bifurcation(branches=responses, **SCENE),
    ):
        with pytest.raises(gs.DatasetError, match=r"^branches: none in this dataset; gs\.branches"):
            call()
    branched.attrs["along"] = "K_c"
    branched["K_c"] = branched["omega"]
    with pytest.raises(gs.DatasetError, match=r"^branches: continued along K_c, .* along omega$"):
        responses.gapsweep.bifurcation(branches=branched, **SCENE)
    with pytest.raises(gs.DatasetError, match="nothing: no variable of this dataset"):
        branched.gapsweep.branches("nothing")


def test_branches_that_gapsweep_computes_are_drawn(ax):
    law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    found = gs.branches(paper_oscillator(), law, between=(9.0, 16.0), at=14.0)
    found.gapsweep.branches(ax=ax)
    n = sum(len(heights) for heights in marks(ax).values())
    assert n == int((found["special"] > 0).sum()) > 1
    assert ax.get_xlabel() == "forcing frequency [Hz]"
    assert ends(ax, "--")


@pytest.fixture(scope="module")
def unforced(responses):
    """Responses as of an unforced system: over a parameter `speed`, without frequency."""
    one = responses.isel(omega=0, drop=True)
    faster = one.copy()
    for name in ("x_max", "amplitude", "extrema"):
        faster[name] = 2.0 * one[name]
    return xr.concat([one, faster], xr.DataArray([10.0, 12.0], dims="speed", name="speed"))


def test_what_has_no_frequency_is_drawn_along_what_is_swept(unforced, ax):
    unforced.gapsweep.bifurcation(ax=ax)
    assert_allclose(drawn(ax), expected(unforced["extrema"].rename(speed="omega")))
    for other in (
        unforced.gapsweep.frequency_response(),
        unforced.gapsweep.compare("piecewise", "tanh-1e4"),
    ):
        assert other.get_xlabel() == ax.get_xlabel() == "speed"
        plt.close(other.figure)


def test_a_summary_of_every_speed_is_a_curve(compared, ax):
    one = compared[["amplitude_error_median"]]
    speeds = xr.DataArray([10.0, 12.0], dims="speed", name="speed")
    xr.concat([one, 3.0 * one], speeds).gapsweep.agreement(representation="tanh-1e4", ax=ax)
    (line,) = ax.lines
    here = one["amplitude_error_median"].sel(representation="tanh-1e4", regime="all").item()
    assert_allclose(line.get_xydata(), [[10.0, here], [12.0, 3.0 * here]])


def test_of_several_swept_numbers_one_is_asked_for(unforced):
    stiffer = unforced.assign_coords(K_c=2.0 * unforced["K_c"])
    both = xr.concat([unforced, stiffer], "K_c", coords="minimal", compat="override")
    with pytest.raises(
        gs.DatasetError, match=r"omega: no .*: choose, as along='(K_c|speed)'"
    ) as refused:
        both.gapsweep.bifurcation()
    assert "drop=True" not in str(refused.value)
    axes = both.gapsweep.bifurcation(K_c=1.4e4)
    assert axes.get_xlabel() == "speed"
    plt.close(axes.figure)


def test_attractors_of_the_starts_of_a_system_are_looked_for_in_another_file(responses):
    of_system = responses.drop_vars(["x_0", "v_0"]).assign_coords(coordinate="arm")
    with pytest.raises(gs.DatasetError, match=r"x_0 and v_0 .* are in attractors\.nc"):
        of_system.gapsweep.attractors()


def part(n):
    """Positions along a dimension: one, or some."""
    return st.integers(0, n - 1) | st.lists(st.integers(0, n - 1), min_size=1, unique=True)


@given(st.fixed_dictionaries({"representation": part(3), "omega": part(4)}), part(3), st.booleans())
def test_any_selection_is_drawn_whole(responses, selection, starts, drop):
    chosen = responses.isel(selection).isel(initial_condition=starts)
    chosen = chosen.isel(K_c=0, gap=0, drop=drop)
    axes = Figure().subplots()
    chosen.gapsweep.bifurcation(ax=axes)
    assert_allclose(drawn(axes), expected(chosen["extrema"]))
    assert bool(walls(axes)) != drop
    axes = Figure().subplots()
    chosen.gapsweep.frequency_response(ax=axes)
    assert_allclose(drawn(axes), expected(chosen["amplitude"]))


@settings(max_examples=10)
@given(st.fixed_dictionaries({"representation": part(3), "omega": part(4)}), part(3), st.booleans())
def test_every_plot_of_any_selection_is_drawn_or_refused(made, compared, selection, starts, drop):
    """Never another error, and no warning."""
    scene = {"K_c": 0, "gap": 0}
    responses, attractors = (ds.isel(selection).isel(scene, drop=drop) for ds in made)
    numbers = compared.isel(selection).isel(scene, drop=drop)
    responses = responses.isel(initial_condition=starts)
    labels = np.atleast_1d(responses["representation"].values).tolist()
    for draw in (
        lambda ax: responses.gapsweep.compare(labels[0], labels[-1], ax=ax),
        lambda ax: responses.gapsweep.attractors(ax=ax),
        lambda ax: attractors.gapsweep.attractors(ax=ax),
        lambda ax: numbers.gapsweep.agreement(ax=ax),
        lambda ax: numbers.gapsweep.agreement("amplitude_error_paired", ax=ax),
        lambda ax: numbers.isel(regime=1).gapsweep.agreement("f1_pooled", ax=ax),
    ):
        axes = Figure().subplots()
        with contextlib.suppress(gs.DatasetError):
            assert draw(axes) is axes
            assert axes.get_xlabel()


def test_agreement_of_the_reference_alone_is_refused(compared):
    with pytest.raises(gs.DatasetError, match=r"piecewise: the reference"):
        compared.gapsweep.agreement(representation="piecewise")


def test_stiffness_can_be_the_axis(responses, ax):
    stiffer = responses.assign_coords(K_c=responses["K_c"] * 100)
    stiffer["amplitude"] = (2.0 * stiffer["amplitude"]).assign_attrs(units="m")
    both = xr.concat([responses, stiffer], "K_c").sel(omega=6.0, gap="0.4/0.4")
    both.gapsweep.frequency_response(along="K_c", ax=ax, representation="piecewise", start="fixed")
    assert ax.get_xlabel() == "contact stiffness [N/m]"
    assert ax.get_xscale() == "log"
    at_rest = both["amplitude"].sel(representation="piecewise").isel(initial_condition=0)
    assert_allclose(ax.lines[0].get_xdata(), [1.4e4, 1.4e6])
    assert_allclose(ax.lines[0].get_ydata(), 1e3 * at_rest)


def test_a_dropped_label_does_not_hinder(responses, ax):
    one = responses.isel(representation=0, drop=True)
    one.gapsweep.bifurcation(ax=ax)
    assert_allclose(drawn(ax), expected(one["extrema"]))


def test_summary_says_what_was_asked_and_where_it_came_from(responses):
    asked = responses.isel(omega=slice(2)).assign_attrs(n_points=18, n_hits=12, n_computed=6)
    text = repr(asked.gapsweep)
    assert "18: 12 from the cache, 6 computed" in text
    assert "5, 6 Hz" in text
    page = asked.gapsweep._repr_html_()
    assert "18: 12 from the cache, 6 computed" in page
    assert page.count("<tr>") == page.count("</tr>") == len(text.splitlines()) - 1


def test_summary_counts_classes_and_failures(responses):
    text = repr(responses.gapsweep)
    assert "points             36\n" in text
    assert "33 ok, 3 diverged" in text
    assert "3 chaotic" in text


def test_summary_does_not_count_padding(attractors):
    assert "none" not in repr(attractors.gapsweep)


def test_hostile_texts_in_a_summary_are_harmless(responses):
    hostile = '"><img src=x onerror=alert(1)>'
    bad = responses.assign_attrs(title=hostile).assign_coords(gap=[hostile])
    assert "<img" not in bad.gapsweep._repr_html_()
    assert "&lt;img" in bad.gapsweep._repr_html_()


def test_a_dataset_that_was_drawn_is_let_go(responses, ax):
    """An open file must not wait for the garbage collector."""
    copy = responses.copy()
    copy.gapsweep.bifurcation(ax=ax)
    alive = weakref.ref(copy)
    del copy
    assert alive() is None


def test_datasets_bring_the_accessor_and_matplotlib_waits_for_a_plot():
    code = (
        "import sys, gapsweep as gs; assert 'xarray' not in sys.modules; gs.open;"
        "import xarray; assert hasattr(xarray.Dataset, 'gapsweep');"
        "assert 'matplotlib' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
