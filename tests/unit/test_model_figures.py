"""`gapsweep.frequency_response`, `gapsweep.map`, and `gapsweep.plot` of a steady response."""

import pickle

import numpy as np
import pytest
from matplotlib.image import imread
from numpy.testing import assert_allclose

import gapsweep as gs

OSCILLATOR = gs.systems.paper_oscillator()
LAW = gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4))


def dots(figure, word):
    """Places of the filled symbols of a sweep, as an array of shape (n, 2)."""
    (line,) = (each for each in figure.axes[0].lines if each.get_label() == f"sweep {word}")
    return line.get_xydata()


def dashed(figure):
    """Whether any dashed line has data of a branch."""
    lines = (each for each in figure.axes[0].lines if each.get_linestyle() == "--")
    return any(len(each.get_xdata()) > 2 for each in lines)


def test_sweeps_up_and_down_differ_between_the_folds_and_follow_their_states():
    omega = np.arange(9.0, 19.0, 0.25)
    figure = gs.frequency_response(OSCILLATOR, LAW, omega)
    up, down = dots(figure, "up"), dots(figure, "down")
    # Where the sweep up is on the upper branch, the sweep down is on the lower one.
    both = np.isin(up[:, 0], down[down[:, 1] < 0.4, 0]) & (up[:, 1] > 1.0)
    assert both.sum() > 5
    # The sweep by single calls, each from the end of the one before.
    x, v, peaks = 0.0, 0.0, []
    for each in omega[:6].tolist():
        found = gs.respond(OSCILLATOR, LAW, each, x, v)
        x, v = found.x_end, found.v_end
        peaks.append(1e3 * found.x_max)
    assert_allclose(up[:6, 1], peaks, rtol=1e-9)
    assert dashed(figure)  # the unstable branch between the folds


def test_a_linear_oscillator_has_the_closed_form():
    oscillator = gs.Oscillator(alpha=0.0, zeta=0.2, forcing=4.0, omega_n=5.0, mass=3.0)
    far = gs.Piecewise(1e3, gs.Gap(1.0, 1.0))
    omega = np.array([3.0, 5.0, 8.0])
    found = dots(gs.frequency_response(oscillator, far, omega, sweeps=["up"], branches=False), "up")
    w, w_n = 2.0 * np.pi * omega, 10.0 * np.pi
    closed_form = 4.0 / 3.0 / np.hypot(w_n**2 - w**2, 0.4 * w_n * w)
    assert_allclose(found, np.stack([omega, 1e3 * closed_form], axis=1), rtol=1e-6)


def test_a_coordinate_of_a_system_is_drawn():
    pair, laws = gs.systems.two_masses(), gs.systems.two_masses_law()
    name = pair.coordinates[1]
    omega = [0.1, 0.12] if pair.is_forced else []
    figure = gs.frequency_response(pair, laws, omega, coordinate=name, branches=False)
    expected = gs.respond(pair, laws, omega[0]).x_max[1]
    assert dots(figure, "up")[0] == pytest.approx([omega[0], expected])
    assert name in figure.axes[0].get_ylabel()


def test_cells_of_a_map_are_responses_from_rest():
    omega, gaps = [8.0, 9.0, 10.0], [3e-4, 4e-4]
    figure = gs.map(OSCILLATOR, LAW, ("omega", omega), ("gap", gaps), show="amplitude")
    (image,), (axes, bar) = figure.axes[0].images, figure.axes
    laws = [[gs.Piecewise(1.4e4, gs.Gap(gap, gap))] for gap in gaps]
    found = 1e3 * gs.respond(OSCILLATOR, laws, [omega, omega]).amplitude
    assert image.get_array().shape[:2] == (2, 3)
    assert bar.get_ylim() == pytest.approx((found.min(), found.max()))
    assert axes.get_xlabel() == "forcing frequency [Hz]"


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: gs.frequency_response(OSCILLATOR, LAW, 9.0), "two frequencies"),
        (lambda: gs.frequency_response(OSCILLATOR, LAW, [0.0, 9.0]), "> 0 Hz"),
        (lambda: gs.frequency_response(OSCILLATOR, LAW, [8.0, 9.0], sweeps="up"), "sweeps"),
        (lambda: gs.frequency_response(OSCILLATOR, LAW, [8.0, 9.0], coordinate="y"), "coordinate"),
        (lambda: gs.map(OSCILLATOR, LAW, "omega", ("gap", [1e-4])), "name and values"),
        (lambda: gs.map(OSCILLATOR, LAW, ("omega", [9.0]), ("omega", [8.0])), "two parameters"),
        (lambda: gs.map(OSCILLATOR, LAW, ("omega", [9.0]), ("mas", [8.0])), "mass"),
        (lambda: gs.map(OSCILLATOR, LAW, ("omega", [9.0]), ("gap", [1e-4]), "peak"), "show"),
        (lambda: gs.map(OSCILLATOR, LAW, ("omega", [-9.0]), ("gap", [1e-4])), "omega"),
        (lambda: gs.map(OSCILLATOR, LAW, ("omega", []), ("gap", [1e-4])), "not empty"),
        (lambda: gs.map(OSCILLATOR, LAW, ("mass", [3.0]), ("gap", [1e-4])), "omega"),
        (lambda: gs.plot(gs.respond(OSCILLATOR, LAW, [8.0, 9.0])), "array"),
    ],
)
def test_wrong_arguments_are_named(call, words):
    with pytest.raises(gs.GapsweepError, match=words):
        call()


def test_the_motion_of_a_steady_response_has_its_extrema():
    found = gs.respond(OSCILLATOR, LAW, 9.0)
    history = gs.plot(found).axes[0]
    x = next(line.get_ydata() for line in history.lines if line.get_linestyle() != "--")
    assert (x.max(), x.min()) == pytest.approx((1e3 * found.x_max, 1e3 * found.x_min), rel=1e-4)


@pytest.mark.parametrize(
    ("name", "call"),
    [("lyapunov", "respond"), ("attractors", "basins"), ("Osillator", "did you mean Oscillator")],
)
def test_names_of_other_software_lead_to_the_call(name, call):
    with pytest.raises(AttributeError, match=call):
        getattr(gs, name)
    assert not hasattr(gs, "__wrapped__")


def test_a_response_leads_to_its_plot():
    found = gs.respond(OSCILLATOR, LAW, 9.0)
    with pytest.raises(AttributeError, match=r"gs.plot\(response\)"):
        found.plot()
    assert pickle.loads(pickle.dumps(found)).x_max == found.x_max


def test_a_picture_is_stored_large_enough_for_a_slide(tmp_path):
    figure = gs.frequency_response(OSCILLATOR, LAW, [8.0, 9.0], branches=False)
    figure.savefig(tmp_path / "response.png")
    assert imread(tmp_path / "response.png").shape[1] >= 1400
