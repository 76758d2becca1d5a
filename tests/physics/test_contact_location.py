"""Located contacts where rounding decides: starts on walls, grazes, coincidences; and failures."""

import math

import numpy as np
import pytest

import gapsweep as gs
from gapsweep.integrate.stepping import batch
from gapsweep.model.systems import paper_oscillator

GAP = gs.Gap(0.4e-3, 0.4e-3)
LAW = gs.Piecewise(1.4e4, GAP)
FREE = paper_oscillator(zeta=0.0, forcing=0.0)
LINEAR = paper_oscillator(zeta=0.0, forcing=0.0, alpha=0.0)
TIGHT = {"rtol": 1e-12, "atol": 1e-15}
OK, DIVERGED, UNDERFLOW = gs.Status.OK, gs.Status.DIVERGED, gs.Status.STEP_UNDERFLOW


@pytest.mark.parametrize(
    "how", [{}, {"restart": True}, {"controller": "ode45"}, {"engine": "scipy"}, {"located": False}]
)
@pytest.mark.parametrize(
    ("v_0", "forcing", "side"),
    [
        (0.01, 0.0, 1),
        (-0.01, 0.0, -1),
        (0.0, 50.0, 1),
        (0.0, -50.0, -1),
        (0.0, 0.0, -1),
        (0.01, -50.0, 1),
        (-0.01, 50.0, -1),
    ],
)
def test_a_start_on_a_wall_follows_velocity_then_acceleration(v_0, forcing, side, how):
    """To leave the wall that it starts on is no contact; the stiffness is that of its side."""
    o, K_c, options = paper_oscillator(forcing=forcing), 1.4e6, dict(how)
    law = gs.Piecewise(K_c, GAP, located=options.pop("located", True))
    for wall in (0.4e-3, -0.4e-3):
        towards = math.copysign(1.0, wall)
        mirrored = paper_oscillator(forcing=towards * forcing)
        run = gs.simulate(mirrored, law, 9.0, wall, towards * v_0, t_end=1e-4, **TIGHT, **options)
        assert (run.n_contacts, run.status) == (0, OK)
        depth = abs(run.x_end) - 0.4e-3
        assert depth * side > 0.0
        a = (forcing - o.alpha * 0.4e-3**3) / o.mass - 2 * o.decay_rate * v_0
        a -= o.omega_n_rad**2 * 0.4e-3
        # The third derivative, in which the contact shows first.
        jerk = -(3.0 * o.alpha / o.mass * 0.4e-3**2 + o.omega_n_rad**2 + K_c / o.mass * (side > 0))
        jerk = jerk * v_0 - 2 * o.decay_rate * a
        taylor = v_0 * 1e-4 + a * 1e-8 / 2.0 + jerk * 1e-12 / 6.0
        assert depth == pytest.approx(taylor, rel=1e-3)


@pytest.mark.parametrize(("forcing", "side"), [(40.0, -1.0), (-40.0, 1.0)])
def test_the_third_derivative_decides_where_velocity_and_acceleration_vanish(forcing, side):
    """At a quarter of a forcing period its cosine is zero and falls."""
    o, law = paper_oscillator(forcing=forcing), gs.Piecewise(1.4e4, gs.Gap(0.0, 0.4e-3))
    run = gs.simulate(o, law, 9.0, t_0=0.25 / 9.0, t_end=0.25 / 9.0 + 1e-4, **TIGHT)
    assert (math.copysign(1.0, run.x_end), run.n_contacts) == (side, 0)


@pytest.mark.parametrize("size", [1e-3, 1e-6, 1e-9, 1e-12, 1e-14, 0.0])
@pytest.mark.parametrize("rtol", [1e-3, 1e-8, 1e-12])
@pytest.mark.parametrize("how", [{}, {"restart": True}, {"engine": "scipy"}])
def test_a_dip_holds_both_crossings_or_none(size, rtol, how):
    w_n, j = LINEAR.omega_n_rad, GAP.j_2
    for depth in (size, -size):
        run = gs.simulate(
            LINEAR, LAW, 9.0, v_0=w_n * j * (1 + depth), t_end=0.08, rtol=rtol, atol=1e-15, **how
        )
        if size > max(1e-13, 100 * rtol):
            assert run.n_contacts == (2 if depth > 0 else 0)
        assert run.n_contacts in (0, 2)
        # a contact this shallow changes the end state by its own depth at most
        off = abs(run.x_end - j * math.sin(w_n * 0.08))
        assert off < j * (2 * size + 100 * rtol + 1e-13)


def test_both_walls_within_one_step_come_in_the_order_of_time():
    law = gs.Piecewise(1.4e4, gs.Gap(1e-9, 1e-9))
    run = gs.simulate(FREE, law, 9.0, v_0=0.05, t_end=1.0, dense_output=True, **TIGHT)
    assert len(run.t_contacts) > 40
    assert (np.diff(run.t_contacts) > 0.0).all()
    x, v = run.sample(run.t_contacts)
    assert np.abs(np.abs(x) - 1e-9).max() < 1e-15
    # In over one wall, out over it, in over the other, out.
    assert (np.sign(x) == np.resize([1, 1, -1, -1], x.size)).all()
    assert (np.sign(v) == np.resize([1, -1, -1, 1], x.size)).all()


@pytest.mark.parametrize("how", [{}, {"restart": True}])
def test_a_throw_over_one_wall_that_falls_through_the_other_passes_both(how):
    """Within one step, and the earlier one first: x = v t - a t² / 2."""
    o = paper_oscillator(zeta=0.0, alpha=0.0, omega_n=0.01, forcing=-4.0)
    a, wall, top = 4.0 / 3.0, 1e-9, 1.5e-9
    law, v = gs.Piecewise(1e-6, gs.Gap(wall, wall)), math.sqrt(2.0 * a * top)
    run = gs.simulate(o, law, 1e-3, v_0=v, t_end=0.01, **how)
    roots = [v / a + sign * math.sqrt(v * v - 2.0 * a * x) / a
             for x, sign in ((wall, -1), (wall, 1), (-wall, 1))]  # fmt: skip
    assert run.t_contacts == pytest.approx(roots, rel=1e-6)


def test_a_contact_at_the_end_is_counted_once():
    times = gs.simulate(paper_oscillator(), LAW, 9.0, t_end=1.0, **TIGHT).t_contacts
    for n, t in enumerate(times[:6]):
        ends = (t - 1e-9, t + 1e-9, t)
        counts = [
            gs.simulate(paper_oscillator(), LAW, 9.0, t_end=e, **TIGHT).n_contacts for e in ends
        ]
        assert counts[:2] == [n, n + 1]
        assert counts[2] in (n, n + 1)  # the end itself is rounded


@pytest.mark.parametrize("t_touch", [0.05, 0.071, 0.093])
def test_a_halt_without_return_is_one_extremum(t_touch):
    o, w = paper_oscillator(zeta=0.0, alpha=0.0), 18 * math.pi
    amplitude = o.forcing / o.mass / (o.omega_n_rad**2 - w**2)
    # A free part such that v = a = 0 at t_touch, added to the forced part.
    a = -amplitude * (w / o.omega_n_rad) ** 2 * math.cos(w * t_touch)
    c = -amplitude * (w / o.omega_n_rad) * math.sin(w * t_touch)
    u = -o.omega_n_rad * t_touch
    x_0 = amplitude + a * math.cos(u) - c * math.sin(u)
    v_0 = -o.omega_n_rad * (a * math.sin(u) + c * math.cos(u))
    law = gs.Piecewise(0.0, GAP)
    run = gs.simulate(o, law, 9.0, x_0, v_0, t_end=2 * t_touch, **TIGHT)
    near = run.t_extrema[np.abs(run.t_extrema - t_touch) < 1e-3]
    assert near == pytest.approx([t_touch], abs=1e-6)


def test_rest_on_a_wall_ends_normally():
    run = gs.simulate(FREE, gs.Piecewise(1.4e4, gs.Gap(0.0, 0.0)), 9.0, t_end=1.0)
    assert (run.status, run.x_end, run.n_contacts) == (OK, 0.0, 0)


def test_chatter_ends_a_motion_at_once(monkeypatch):
    monkeypatch.setattr(batch, "MOST_SHORT", 0.0)
    run = gs.simulate(FREE, gs.Piecewise(1.4e4, gs.Gap(1e-12, 1e-12)), 9.0, v_0=0.05, t_end=1.0)
    assert run.status is gs.Status.CHATTER
    assert run.t_end == pytest.approx(1e-12 / 0.05, rel=0.1)


@pytest.mark.parametrize("law", [LAW, gs.Tanh(1.4e4, GAP, 1e4)], ids=["exact", "smooth"])
def test_motions_that_fail_leave_the_others_as_they_are(law):
    """They need no room for what they never reach, and record nothing that they have not passed."""
    softening, omega = paper_oscillator(alpha=-1e7), np.array([9.0, 7.0, 11.0, 6.0, 8.0])
    v_0, x_0 = np.array([0.0, 5.0, 0.01, 0.0, 0.02]), np.array([0.0, 0.0, 0.0, 1e40, 0.0])
    runs = gs.simulate(softening, law, omega, x_0, v_0, t_end=2.0)
    assert runs.status.tolist() == [OK, DIVERGED, OK, DIVERGED, OK]
    for i in range(5):
        alone = gs.simulate(softening, law, omega[i], x_0[i], v_0[i], t_end=2.0)
        for name in ("extrema", "t_contacts", "section"):
            assert getattr(runs, name)[i].tobytes() == getattr(alone, name).tobytes()
        assert (runs.n_steps[i], runs.t_end[i]) == (alone.n_steps, alone.t_end)
    endless = gs.simulate(softening, law, 9.0, v_0=5.0, t_end=1e9)
    assert endless.status is DIVERGED
    assert len(endless.section) == 0


def test_a_wall_too_stiff_for_any_step_is_a_status():
    run = gs.simulate(paper_oscillator(), gs.Piecewise(1e35, GAP), 9.0, 5.0, t_end=1.0)
    assert run.status is UNDERFLOW
    assert run.t_end < 1.0
