"""`gapsweep.plot`: what its panels show, and what it refuses."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.readers.figures import overlaps

import gapsweep as gs
from gapsweep.model.systems import paper_oscillator

LAW = gs.contact_law("piecewise", 1.4e4, gs.Gap(4e-4, 4e-4))
OMEGA = 9.0


def simulated(**options):
    given = {"omega": OMEGA, "t_end": 20.0, "dense_output": True, **options}
    return gs.simulate(paper_oscillator(), LAW, **given)


def data(axes):
    (line,) = (line for line in axes.get_lines() if line.get_linestyle() != "--")
    return line.get_xdata(), line.get_ydata()


def test_panels_show_the_motion_in_millimetres():
    run = simulated()
    figure = gs.plot(run)
    history, phase, section, spectrum = figure.axes
    t, x = data(history)
    assert (t[-1] - t[0]) * OMEGA == pytest.approx(16.0, abs=0.1)
    assert_allclose(x, 1e3 * run.sample(t)[0])
    t = np.linspace(10.0, 20.0, data(phase)[0].size, endpoint=False)
    assert_allclose(data(phase), 1e3 * np.stack(run.sample(t)), rtol=1e-9, atol=1e-12)
    late = run.section[run.t_section >= 10.0]
    assert_allclose(np.transpose(data(section)), 1e3 * late)
    frequency, amplitude = data(spectrum)
    # A settled motion of one period has its largest line at the frequency of the forcing.
    assert frequency[amplitude.argmax()] == pytest.approx(OMEGA, abs=0.1)
    assert overlaps(figure) == []


def test_a_contact_that_loses_energy_has_panels_of_its_force():
    gap, mesh = gs.Gap(1.0, 1.0), gs.systems.gear_pair()
    stop = gs.Piecewise(1.0, gap, damping=0.4, pulls=True)
    run = gs.simulate(mesh, stop, 0.1, n_periods=60, dense_output=True)
    figure = gs.plot(run, "mesh")
    *_, over_x, _, _, over_t = figure.axes
    t, force = data(over_t)
    x, v = (each[:, 0] for each in run.sample(t)[:2])
    assert_allclose(data(over_x), [x, force])
    depths, phase = (-0.2, -0.1, -0.05), 2.0 * np.pi * 0.1 * t
    stiffness = 1.0 + sum(d * np.cos(k * phase) for k, d in enumerate(depths, 1))
    assert_allclose(force, np.where(x > 1.0, stiffness * (x - 1.0) + 0.4 * v, 0.0), atol=1e-12)
    assert (x > 1.0).all()  # so that the energy is that of the damper alone
    lost = 0.4 * np.trapezoid(v**2, t) * 10.0 / (t[-1] - t[0])
    assert float(over_x.get_title().split()[0]) == pytest.approx(lost, rel=5e-3)
    assert len(gs.plot(run, "x").axes) == 6
    assert len(gs.plot(simulated()).axes) == 4


@pytest.mark.parametrize("t_end", [20.0, 20.05, 20.111, 4000.0])
def test_the_line_of_a_linear_motion_has_its_frequency_and_its_amplitude(t_end):
    """However long the run is, and wherever in a period it ends."""
    oscillator = gs.Oscillator(alpha=0.0, zeta=0.2, forcing=4.0, omega_n=5.0, mass=3.0)
    law = gs.Piecewise(1e3, gs.Gap(1.0, 1.0))
    run = gs.simulate(oscillator, law, OMEGA, t_end=t_end, dense_output=True)
    frequency, amplitude = data(gs.plot(run).axes[3])
    w, w_n = 2 * np.pi * OMEGA, 2 * np.pi * 5.0
    closed_form = 4.0 / 3.0 / np.hypot(w_n**2 - w**2, 2 * 0.2 * w_n * w)
    assert frequency[amplitude.argmax()] == pytest.approx(OMEGA, rel=1e-9)
    assert data(gs.plot(run).axes[2])[0].size <= 257  # the section is that of what is shown
    assert amplitude.max() == pytest.approx(1e3 * closed_form, rel=1e-6)


def test_a_motion_much_faster_than_its_forcing_has_its_own_line():
    oscillator = gs.Oscillator(omega_n=200.0, mass=1.0, alpha=0.0, zeta=1e-4, forcing=1.0)
    law = gs.Piecewise(1e3, gs.Gap(1.0, 1.0))
    run = gs.simulate(oscillator, law, 0.1, x_0=1e-3, t_end=10.0, dense_output=True)
    frequency, amplitude = data(gs.plot(run).axes[3])
    assert frequency[amplitude.argmax()] == pytest.approx(200.0, abs=0.2)


def test_a_coordinate_of_a_system_is_chosen_by_name():
    system = gs.systems.two_masses()
    law = gs.Piecewise(100.0, gs.Gap(0.1, 0.1))
    run = gs.simulate(system, law, 0.6, t_end=50.0, dense_output=True)
    second = system.coordinates[1]
    t, x = data(gs.plot(run, second, start=40.0).axes[0])
    assert_allclose(x, run.sample(t)[0][:, 1])
    with pytest.raises(gs.ModelError, match=f"'x_9': must be one of .*{second}"):
        gs.plot(run, "x_9")


def levels(axes, side):
    """Positions of the dashed lines of an axes along one side."""
    ends = (getattr(line, f"get_{side}data")() for line in axes.get_lines())
    dashed = (line.get_linestyle() == "--" for line in axes.get_lines())
    return sorted(end[0] for end, is_one in zip(ends, dashed, strict=True) if is_one)


def test_walls_are_dashed_and_set_no_axis():
    history, phase, section, spectrum = gs.plot(simulated()).axes
    assert_allclose(levels(history, "y"), [-0.4, 0.4])
    for axes in (phase, section):
        assert_allclose(levels(axes, "x"), [-0.4, 0.4])
    assert not levels(spectrum, "y")
    law = gs.Piecewise(1e3, gs.Gap(9.0, 9.0))
    far = gs.simulate(paper_oscillator(), law, OMEGA, t_end=9.0, dense_output=True)
    history = gs.plot(far).axes[0]
    _, x = data(history)
    assert x.max() < history.get_ylim()[1] < 2.0 * x.max()


def test_walls_stand_where_the_coordinate_meets_them():
    """Half as far where the contact feels it twice, on the other side where it is reversed."""
    system = gs.System(
        mass=[[1.0, 0.0], [0.0, 1.0]],
        stiffness=[[30.0, -10.0], [-10.0, 20.0]],
        contacts={"lever": [0.0, -2.0], "stop": [0.0, 1.0], "between": [1.0, -1.0]},
        forcing=[gs.Harmonic(amplitude=[1.0, 0.0])],
        coordinates=("body", "arm"),
        units={"body": "1", "arm": "rad", "between": "1"},
    )
    laws = {
        "lever": gs.Piecewise(100.0, gs.Gap(0.1, 0.3)),
        "stop": gs.Piecewise(100.0, gs.Gap(0.5, 0.6), K_ratio=0.0),
        "between": gs.Piecewise(100.0, gs.Gap(0.7, 0.8)),
    }
    run = gs.simulate(system, laws, 0.6, t_end=50.0, dense_output=True)
    assert_allclose(levels(gs.plot(run, "arm").axes[0], "y"), [-0.15, 0.05, 0.6])
    assert levels(gs.plot(run, "body").axes[0], "y") == []


def test_at_rest_there_is_a_picture_too():
    run = gs.simulate(paper_oscillator(forcing=0.0), LAW, omega=OMEGA, t_end=1.0, dense_output=True)
    assert not data(gs.plot(run).axes[0])[1].any()


@pytest.mark.parametrize(
    ("options", "given", "message"),
    [
        ({"dense_output": False}, {}, "dense_output=True"),
        ({"x_0": [0.0, 1e-3]}, {}, "must be one motion"),
        ({}, {"start": 21.0}, "must be within 0..20 s"),
        ({}, {"start": -1.0}, "must be within 0..20 s"),
        ({}, {"coordinate": "x"}, "leave it out"),
    ],
)
def test_what_cannot_be_drawn_is_refused(options, given, message):
    with pytest.raises(gs.ModelError, match=message):
        gs.plot(simulated(**options), **given)


def test_what_is_no_motion_is_refused():
    with pytest.raises(gs.ModelError, match="run = 3"):
        gs.plot(3)
