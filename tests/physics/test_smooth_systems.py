"""Systems whose contacts are not located: against other integrators, closed forms, invariants."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq

import gapsweep as gs

GAP = gs.Gap(0.4e-3, 0.4e-3)
STOP = gs.Gap(1e-3, 2e-3)


def pair(*oscillators):
    """Oscillators side by side, that nothing couples."""
    n = len(oscillators)
    masses = np.array([o.mass for o in oscillators])
    rates = np.array([o.omega_n_rad for o in oscillators])
    return gs.System(
        mass=np.diag(masses),
        damping=np.diag([2.0 * o.zeta * o.omega_n_rad * o.mass for o in oscillators]),
        stiffness=np.diag(masses * rates**2),
        cubic=[gs.Cubic(along=a, alpha=o.alpha)
               for a, o in zip(np.eye(n), oscillators, strict=True)],
        contacts={f"stop {i}": np.eye(n)[i] for i in range(n)},
        forcing=[gs.Harmonic(amplitude=[o.forcing for o in oscillators])],
    )  # fmt: skip


ONE, OTHER = gs.Oscillator(), gs.Oscillator(zeta=0.05, omega_n=7.0, mass=2.0, forcing=6.0)
TABLE = gs.ForceTable((-4e-3, -1e-3, -0.4e-3, 0.4e-3, 1e-3, 4e-3), (-60.0, -9.0, 0, 0, 8.0, 50.0))


def test_a_table_that_one_contact_leaves_is_named_by_the_status():
    laws = {"stop 0": gs.Tanh(1.4e4, GAP, 1e4), "stop 1": TABLE}
    runs = [
        gs.simulate(pair(ONE, OTHER), laws, 5.0, q_0=[3e-4, x], t_end=0.05).status
        for x in (3e-3, 5e-3)
    ]
    assert runs == [gs.Status.OK, gs.Status.OUT_OF_FIT_RANGE]


# Steady responses.


def coupled():
    return gs.System(
        mass=np.diag([1.0, 0.5]),
        damping=[[0.8, -0.2], [-0.2, 0.5]],
        stiffness=[[400.0, -150.0], [-150.0, 300.0]],
        contacts={"stop": [1.0, -1.0], "wall": [0.0, 1.0]},
        forcing=[gs.Harmonic(amplitude=[3.0, 1.0])],
    )


COUPLED = {"stop": gs.Tanh(2e3, STOP, 3e3), "wall": gs.Tanh(2e3, gs.Gap(5e-3, 5e-3), 3e3)}


def test_responses_are_where_brute_force_settles():
    system, omega = coupled(), np.linspace(1.0, 8.0, 12)
    settled = gs.simulate(system, COUPLED, omega, t_end=80.0)
    # From there: from rest two motions of this scene may settle on two attractors.
    at = np.array([section[-1] for section in settled.section])
    found = gs.respond(system, COUPLED, omega, q_0=at[:, :2], v_0=at[:, 2:])
    n_checked = 0
    for k in np.flatnonzero(found.response_class == gs.ResponseClass.PERIODIC):
        n = int(found.period_multiple[k])
        # From a whole number of periods on.
        start = settled.section[k][-1]
        run = gs.simulate(system, COUPLED, omega[k], q_0=start[:2], v_0=start[2:],
                          t_end=n / omega[k], dense_output=True)  # fmt: skip
        q = run.sample(np.linspace(0.0, n / omega[k], 4001))[0]
        if np.abs(q[-1] - q[0]).max() > 1e-7:
            continue
        n_checked += 1
        assert_allclose(found.x_max[k], q.max(axis=0), atol=1e-7)
        assert_allclose(found.x_min[k], q.min(axis=0), atol=1e-7)
        multipliers = np.reshape(found.multipliers[k], (-1, 2)) @ [1.0, 1j]
        shrinkage = math.exp(-1.8 * n / omega[k])
        assert_allclose(np.prod(multipliers), shrinkage, rtol=1e-5, atol=1e-12)
    assert n_checked > 5


def test_a_system_of_one_coordinate_responds_as_its_oscillator():
    law, omega = gs.Tanh(1.4e4, GAP, 1e4), np.linspace(4.0, 30.0, 20)
    same = gs.respond(pair(ONE), law, omega, q_0=[1e-4])
    one = gs.respond(ONE, law, omega, same.x_end, same.v_end)
    periodic = one.response_class == gs.ResponseClass.PERIODIC
    assert periodic.sum() > 12
    assert np.array_equal(one.response_class, same.response_class)
    for name in ("x_max", "x_min", "force_max"):
        assert_allclose(getattr(same, name)[periodic], getattr(one, name)[periodic], rtol=1e-6)
    assert_allclose(same.multiplier_abs[periodic], one.multiplier_abs[periodic], atol=1e-6)


def flapping(speed=12.36842):
    """The typical section with its freeplay rounded."""
    exact = gs.systems.typical_section_law("conner-scaled")
    section = gs.systems.typical_section(speed, "conner-scaled")
    return section, gs.Tanh(exact.K_c, exact.gap, 2e3)


def test_returns_of_what_nothing_forces_are_maxima_of_its_first_coordinate():
    section, law = flapping()
    # Long steps, so that a point is not found by the interpolant alone.
    loose = {"rtol": 1e-4, "atol": 1e-7, "dense_output": True}
    run = gs.simulate(section, law, q_0=[0.01, 0.0, 0.0], t_end=3.0, **loose)
    points, names = run.section, section.coordinates
    t = np.linspace(0.0, 3.0, 6001)
    heights = run.sample(t)[0][:, 0]
    maxima = np.flatnonzero((heights[1:-1] > heights[:-2]) & (heights[1:-1] > heights[2:])) + 1
    assert len(points) == len(maxima) > 5
    assert not points[:, section.n].any()
    for point, near in zip(points, maxima, strict=True):

        def speed(at):
            return float(run.sample([at])[1][0, 0])

        at = brentq(speed, t[near - 1], t[near + 1], xtol=1e-15)
        truth = np.concatenate([part[0] for part in run.sample([at])])
        assert_allclose(point, truth, rtol=0.0, atol=1e-10 * np.abs(points).max())
    assert len(run.extrema[names[0]]) >= len(points)


def test_a_limit_cycle_of_a_rounded_freeplay_is_found():
    section, law = flapping()
    found = gs.respond(section, law, q_0=[0.01, 0.0, 0.0])
    assert found.response_class == gs.ResponseClass.PERIODIC
    far = gs.simulate(section, law, q_0=[0.01, 0.0, 0.0], t_end=60.0)
    late = gs.simulate(section, law, q_0=far.q_end, v_0=far.v_end, z_0=far.z_end, t_end=2.0)
    assert_allclose(found.x_max[2], late.extrema["beta"].max(), rtol=1e-5)
    assert_allclose(found.x_min[2], late.extrema["beta"].min(), rtol=1e-5)


@pytest.mark.parametrize(
    ("law", "options", "said"),
    [
        ({"stop": gs.Piecewise(2e3, GAP), "wall": gs.Tanh(2e3, GAP, 1e4)}, {}, "only if all are"),
        (gs.Piecewise(2e3, GAP), {"restart": True}, "restart = true.*of an Oscillator"),
        (gs.Piecewise(2e3, GAP), {"controller": "ode45"}, "'ode45'.*of an Oscillator"),
    ],
)
def test_what_has_no_compiled_steps_is_refused(law, options, said):
    with pytest.raises(gs.ModelError, match=said):
        gs.simulate(coupled(), law, 3.0, t_end=1.0, **options)
