"""Events of laws without located contacts, and clocks at their limits, against scipy's engine."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import gapsweep as gs

OSCILLATOR = gs.systems.paper_oscillator()
SOFT = 1.4e4
GAPS = {"wide": gs.Gap(4e-4, 4e-4), "one-sided": gs.Gap(0.0, 8e-4), "none": gs.Gap(0.0, 0.0)}
TIGHT = {"rtol": 1e-11, "atol": 1e-14}


# ---- Contact times --------------------


@pytest.mark.parametrize("controller", ["native", "ode45"])
@pytest.mark.parametrize("rtol", [1e-1, 1e-4])
def test_every_contact_counted_has_its_time(rtol, controller):
    # Coarse steps hold several extrema and contacts each; softening motions run away on the way.
    rng = np.random.default_rng(5)
    starts = rng.uniform(-2e-3, 2e-3, 64), rng.uniform(-0.1, 0.1, 64)
    omega, n_diverged = rng.uniform(0.3, 40.0, 64), 0
    for oscillator in (OSCILLATOR, gs.systems.paper_oscillator(alpha=-1e11)):
        for label in ("tanh-1e4", "piecewise-noevents"):
            for gap in GAPS.values():
                law = gs.contact_law(label, 1e5, gap)
                runs = gs.simulate(oscillator, law, omega, *starts, t_end=1.0, rtol=rtol,
                                   atol=1e-3 * rtol, controller=controller)  # fmt: skip
                assert [len(t) for t in runs.t_contacts] == runs.n_contacts.tolist()
                assert all(np.all(np.diff(t) >= 0.0) for t in runs.t_contacts)
                n_diverged += np.sum(runs.status == gs.Status.DIVERGED)
    assert n_diverged > 0


# ---- Section points --------------------


@pytest.mark.parametrize("restart", [False, pytest.param(True, marks=pytest.mark.extended)])
def test_steps_over_many_forcing_periods_keep_every_section_point(restart):
    # Without forcing nothing keeps ode45's steps short of its period.
    free, law = gs.systems.paper_oscillator(forcing=0.0), gs.Tanh(SOFT, GAPS["wide"], 1e4)
    law = gs.Piecewise(SOFT, GAPS["wide"]) if restart else law
    run = gs.simulate(free, law, 500.0, 1e-3, t_end=0.5, rtol=1e-6, atol=1e-9,
                      controller="ode45", restart=restart)  # fmt: skip
    assert run.n_steps < 200
    truth = gs.simulate(free, law, 500.0, 1e-3, t_end=0.5, engine="scipy", **TIGHT)
    assert run.section.shape == truth.section.shape == (250, 2)
    assert_allclose(run.section / (1.0, 30.0), truth.section / (1.0, 30.0), rtol=0.0, atol=1e-7)


# ---- The clock --------------------


@pytest.mark.parametrize("omega", [1e-12, 1e-16, 1e-20, 1e-50])
@pytest.mark.parametrize("label", ["piecewise", "tanh-1e4"])
def test_forcing_slower_than_any_clock_is_a_constant_force(label, omega):
    law = gs.contact_law(label, SOFT, GAPS["wide"])
    run = gs.simulate(OSCILLATOR, law, omega, t_end=1.0, dense_output=True)
    truth = gs.simulate(OSCILLATOR, law, omega, t_end=1.0, engine="scipy", **TIGHT)
    assert run.status is gs.Status.OK
    assert run.t_end == 1.0
    assert_allclose([run.x_end, run.v_end], [truth.x_end, truth.v_end], rtol=1e-6)
    assert run.n_contacts == len(run.t_contacts) == truth.n_contacts > 20
    assert_allclose(run.extrema, truth.extrema, rtol=1e-7)
    assert_allclose(run.sample(0.5), run_half(law, omega), rtol=1e-7)


def run_half(law, omega):
    half = gs.simulate(OSCILLATOR, law, omega, t_end=0.5, engine="scipy", **TIGHT)
    return half.x_end, half.v_end


def test_the_phase_survives_a_million_periods():
    o, n, w = gs.systems.paper_oscillator(zeta=0.3, alpha=0.0), 1_000_000, 60.0 * np.pi
    end = (n + 0.3) / 30.0
    run = gs.simulate(o, gs.Piecewise(0.0, GAPS["wide"]), 30.0, t_end=end, rtol=1e-10, atol=1e-15)
    response = o.forcing / o.mass / (o.omega_n_rad**2 - w**2 + 2j * o.decay_rate * w)
    assert_allclose(
        run.x_end, (response * np.exp(0.6j * np.pi)).real, rtol=0.0, atol=1e-9 * abs(response)
    )


@pytest.mark.parametrize("label", ["piecewise", "tanh-1e4", "piecewise-noevents"])
@pytest.mark.parametrize(("t_0", "t_end"), [(0.0, 1.0), (0.1, 0.3), (1e3, 1e3 + 0.7)])
def test_a_motion_ends_at_the_time_asked_for(label, t_0, t_end):
    law = gs.contact_law(label, SOFT, GAPS["wide"])
    assert gs.simulate(OSCILLATOR, law, 8.7, t_0=t_0, t_end=t_end).t_end == t_end


@pytest.mark.parametrize("label", ["piecewise", "tanh-1e4"])
def test_phase_that_hides_the_steps_of_the_motion_is_refused(label):
    law = gs.contact_law(label, SOFT, GAPS["wide"])
    with pytest.raises(gs.ModelError, match=r"t_0 = 5e\+15 s: at omega = 1e-16 Hz .* t_0 = 0"):
        gs.simulate(OSCILLATOR, law, [9.0, 1e-16], t_0=5e15, t_end=5e15 + 2.0)
