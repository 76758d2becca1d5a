"""Figures of the static part: what is drawn, and in which units."""

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import to_hex
from numpy.testing import assert_allclose
from tests.figure_texts import overlaps
from tests.redrawn import is_redrawn
from workflows.paper import ladders as ladder
from workflows.paper.static_figures import (
    constrained_forces,
    force_curves,
    forces_of,
    static_convergence,
)

import gapsweep as gs
from gapsweep.analysis.static import static
from gapsweep.report.style import MATPLOTLIB, colour

GAP = [0.4e-3, 0.4e-3]
FREE = ("poly-5", "poly-13")


@pytest.fixture(scope="module")
def scene():
    sweep = {"representation": ["piecewise"], "K_c": [1.4e4], "gap": [GAP], "omega": [7.0]}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ladder, "RATIOS", ((3, 2), (5, 2)))
        study = gs.Study.from_dict({"study": {"name": "drawn"}, "sweep": [sweep]})
        return static(study).assign(ladder.ladders(study)).isel(gap=0)


@pytest.fixture(autouse=True)
def report_style():
    with mpl.rc_context(MATPLOTLIB):
        yield


def test_no_text_lies_on_another(scene):
    forces = forces_of(scene, FREE) | constrained_forces(scene, FREE)
    assert not overlaps(force_curves(scene, forces))
    assert not overlaps(static_convergence(scene))


def test_the_csv_of_a_figure_draws_it_again(scene):
    forces = forces_of(scene, FREE) | constrained_forces(scene, FREE)
    assert is_redrawn(force_curves(scene, forces))
    assert is_redrawn(static_convergence(scene))


def test_every_law_is_drawn_in_every_panel(scene):
    forces = forces_of(scene, ("tanh-1e3", "tanh-1e4", "arctan-1e4"))
    figure = force_curves(scene, forces)
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["exact", *forces]
    for axes in figure.axes:
        colours = [to_hex(line.get_color()) for line in axes.lines]
        assert colours == ["#000000", *(colour(label).lower() for label in forces)]
        shade = axes.patches[0].get_extents().transformed(axes.transData.inverted())
        assert_allclose([shade.x0, shade.x1], [-0.4, 0.4])


def test_curves_are_the_forces_near_the_gap_and_the_errors_in_the_range(scene):
    near, near_error, error = force_curves(scene, forces_of(scene, ["poly-13"])).axes
    law, exact = (
        gs.contact_law(label, 1.4e4, gs.Gap(*GAP)).force for label in ("poly-13", "piecewise")
    )
    x, y = near.lines[1].get_data()
    assert_allclose(y, law(np.array(x) * 1e-3), rtol=1e-9)
    assert_allclose(np.ptp(x), 2.0, rtol=0.02)  # the gap and three quarters of it on both sides
    assert_allclose(near_error.lines[0].get_ydata(), 0.0)
    x, y = error.lines[1].get_data()
    assert_allclose(y, law(x * 1e-3) - exact(x * 1e-3), atol=1e-9)
    assert_allclose(np.ptp(x), 8.0)


def test_constrained_fits_have_no_linear_term_and_the_error_of_the_ladder(scene):
    (force,) = constrained_forces(scene, ["poly-13"]).values()
    x = scene["x"].values
    middle = np.abs(x) < 2e-5
    assert np.max(np.abs(force[middle])) < 2e-5 * 14.0  # a thousandth of K_c as slope would show
    u = np.linspace(x[0], x[-1], 8001)
    exact = gs.contact_law("piecewise", 1.4e4, gs.Gap(*GAP)).force(u)
    rmse = np.sqrt(np.mean((np.interp(u, x, force) - exact) ** 2))
    rung = scene["poly_rmse"].sel(constraint="no constant or linear term", degree=13)
    assert_allclose(rmse, 1.4e4 * rung, rtol=1e-3)


def test_a_constrained_fit_has_the_line_of_the_free_one_in_another_shade(scene):
    forces = forces_of(scene, FREE) | constrained_forces(scene, FREE)
    lines = force_curves(scene, forces).axes[0].lines[1:]
    styles = [line.get_linestyle() for line in lines]
    assert styles[:2] == styles[2:]
    assert styles[0] == "-" != styles[1]
    assert len({line.get_color() for line in lines}) == 2


def test_convergence_is_in_newtons_of_the_soft_contact(scene):
    axes = static_convergence(scene).axes
    degrees, rmse = axes[0].lines[0].get_data()
    assert_allclose(rmse, 1.4e4 * scene["poly_rmse"].sel(constraint="none"))
    assert list(degrees) == list(ladder.DEGREES)
    assert_allclose(axes[4].lines[0].get_ydata(), 1.0 - scene["ratpoly_r_squared"])
    bounds = [one.lines[-1].get_ydata()[0] for one in (axes[0], axes[5])]
    assert_allclose(bounds, [0.5, 0.002])
    assert all(one.get_yscale() == "log" for one in axes)
