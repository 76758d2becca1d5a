"""Figures of the static part: what is drawn, and that odd studies draw too."""

import matplotlib as mpl
import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.figure_texts import overlaps
from workflows.paper import ladders as ladder
from workflows.paper.static_figures import (
    polynomial_forces,
    rational_forces,
    smooth_forces,
    static_convergence,
)

import gapsweep as gs
from gapsweep.analysis.static import static
from gapsweep.report.style import MATPLOTLIB, colour


def convergence(scene):
    return static_convergence(scene, float(scene["forcing"]))


FIGURES = (polynomial_forces, rational_forces, smooth_forces, convergence)
LABELS = ["piecewise", "poly-5", "poly-13", "ratpoly-3/2", "tanh-1e4", "arctan-1e4"]


def static_of(labels, K_c, gap):
    sweep = {"representation": labels, "K_c": K_c, "gap": [gap], "omega": [7.0]}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ladder, "RATIOS", ((3, 2), (5, 2)))
        study = gs.Study.from_dict({"study": {"name": "drawn"}, "sweep": [sweep]})
        return static(study).assign(ladder.ladders(study)).isel(gap=0)


@pytest.fixture(scope="module")
def scene():
    return static_of(LABELS, [1.4e4, 1.4e6], [0.4e-3, 0.4e-3])


@pytest.fixture(autouse=True)
def report_style():
    with mpl.rc_context(MATPLOTLIB):
        yield


@pytest.mark.parametrize("draw", FIGURES, ids=lambda f: f.__name__)
def test_no_text_lies_on_another(scene, draw):
    assert not overlaps(draw(scene))


@pytest.mark.parametrize(
    ("draw", "labels"),
    [
        (polynomial_forces, ["poly-5", "poly-13"]),
        (rational_forces, ["ratpoly-3/2"]),
        (smooth_forces, ["tanh-1e4", "arctan-1e4"]),
    ],
)
def test_every_law_of_a_family_is_drawn_in_every_panel(scene, draw, labels):
    figure = draw(scene)
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["exact", *labels]
    assert len(figure.axes) == 6
    for axes in figure.axes:
        colours = [line.get_color() for line in axes.lines[: 1 + len(labels)]]
        assert colours == ["#000000", *map(colour, labels)]
        shade = axes.patches[0].get_extents().transformed(axes.transData.inverted())
        assert_allclose([shade.x0, shade.x1], [-0.4, 0.4])


def test_curves_are_those_of_the_dataset(scene):
    force, near, whole = polynomial_forces(scene).axes[1::2]
    law = gs.contact_law("poly-13", 1.4e6, gs.Gap(0.4e-3, 0.4e-3))
    x, y = force.lines[2].get_data()
    assert_allclose(y, law.force(np.array(x) * 1e-3), rtol=1e-9)
    assert_allclose(np.ptp(x), 2.0, rtol=0.02)  # the gap and three quarters of it on both sides
    assert_allclose(np.ptp(whole.lines[2].get_xdata()), 8.0)
    assert_allclose(near.lines[0].get_ydata(), 0.0)


def test_forcing_is_marked_where_it_fits(scene):
    soft, hard = polynomial_forces(scene).axes[2:4]
    assert [t.get_text().strip() for t in hard.texts] == ["± p"]
    assert not soft.texts


def test_convergence_shows_ladders_and_the_leak_of_each_stiffness(scene):
    figure = convergence(scene)
    polynomial = figure.axes[0].lines[0]
    expected = scene["poly_rmse"].sel(constraint="none")
    assert_allclose(polynomial.get_ydata(), expected)
    levels = [line.get_ydata()[0] for line in figure.axes[8].lines[-2:]]
    assert_allclose(levels, [0.4 / 1.4e4, 0.4 / 1.4e6])
    assert all(axes.get_yscale() == "log" for axes in figure.axes)


@pytest.mark.parametrize(
    ("labels", "gap"),
    [(["piecewise"], [0.4e-3, 0.4e-3]), (["tanh-1e4"], [0.0, 0.0]), (LABELS, [5e-3, 5e-3])],
    ids=["no stand-in", "no gap", "gap beyond the range"],
)
def test_odd_studies_draw_too(labels, gap, tmp_path):
    scene = static_of(labels, [1.4e4], gap)
    for draw in FIGURES:
        draw(scene).savefig(tmp_path / "figure.png", dpi=30)


@pytest.mark.parametrize("draw", FIGURES, ids=lambda f: f.__name__)
def test_one_stiffness_may_be_selected(scene, draw):
    one = draw(scene.sel(K_c=1.4e6))
    assert len(one.axes) == (9 if draw is convergence else 3)
