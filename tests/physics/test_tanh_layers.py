"""Contacts smoothed by tanh: Taylor steps across their thin layers, against scipy's engine."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import gapsweep as gs

OSCILLATOR = gs.systems.paper_oscillator()
TIGHT = {"engine": "scipy", "rtol": 1e-12, "atol": 1e-15}
FINE = {"rtol": 1e-10, "atol": 1e-13}
T_END = 0.3
EPSILONS = 1e3, 3e4, 2e5, 1e6, 1e7
# forcing frequency [Hz], stiffness of the upper wall [N/m], gap, that of the lower wall over it
CASES = {
    "soft": (6.0, 1.4e4, gs.Gap(0.0, 8e-4), 1.0),
    "hard": (12.0, 1.4e6, gs.Gap(4e-4, 4e-4), 1.0),
    "unequal": (9.0, 1e5, gs.Gap(2e-4, 4e-4), 0.3),
    "no gap": (9.0, 1e5, gs.Gap(0.0, 0.0), 2.0),
}


def scene(case, epsilon):
    omega, K_c, gap, K_ratio = CASES[case]
    return OSCILLATOR, gs.Tanh(K_c, gap, epsilon, K_ratio=K_ratio), omega


@pytest.mark.parametrize("epsilon", EPSILONS)
@pytest.mark.parametrize("case", CASES)
def test_motions_and_events_are_those_of_scipy(case, epsilon):
    # 1e-10 of 0.03 m/s, 1e-3 m and a period, and some for the growth of errors at hard walls
    run, truth = (
        gs.simulate(*scene(case, epsilon), 1e-4, 0.03, t_end=T_END, dense_output=True, **settings)
        for settings in (FINE, TIGHT)
    )
    assert_allclose(run.x_end, truth.x_end, rtol=0.0, atol=1e-11)
    assert_allclose(run.v_end, truth.v_end, rtol=0.0, atol=5e-10)
    assert run.n_contacts == len(run.t_contacts) == truth.n_contacts
    assert_allclose(run.t_contacts, truth.t_contacts, rtol=0.0, atol=2e-10)
    assert_allclose(run.section, truth.section, rtol=0.0, atol=5e-10)
    assert_allclose(run.extrema, truth.extrema, rtol=0.0, atol=1e-11)
    t = np.linspace(0.0, T_END, 1000)  # some of them within a layer
    assert_allclose(run.sample(t), truth.sample(t), rtol=0.0, atol=1e-9)


def test_thin_layers_cost_about_what_the_exact_law_costs():
    for case in ("soft", "hard", "unequal"):
        oscillator, law, omega = scene(case, 1e6)
        steps = [
            gs.simulate(oscillator, each, omega, t_end=10.0, rtol=1e-7, atol=1e-10).n_steps
            for each in (law, law.exact)
        ]
        assert steps[0] < 1.3 * steps[1]


@pytest.mark.parametrize("epsilon", [1e5, 1e6])
@pytest.mark.parametrize(("K_c", "gap"), [(7.44e5, gs.Gap(1.2446e-4, 7.336e-4)),
                                          (1.6e6, gs.Gap(4.5e-4, 8.4e-4)),
                                          (5e5, gs.Gap(5.5e-5, 2.26e-4))])  # fmt: skip
def test_crossing_a_layer_at_once_is_integrating_through_it(K_c, gap, epsilon):
    # a run that is to be sampled integrates through every layer
    rng = np.random.default_rng(1)
    law, n = gs.Tanh(K_c, gap, epsilon), 200
    start = rng.uniform(2.0, 30.0, n), rng.uniform(-8e-4, 8e-4, n), rng.uniform(-0.05, 0.05, n)
    at_once, through = (
        gs.simulate(OSCILLATOR, law, *start, t_end=0.05, tangent=True, dense_output=dense)
        for dense in (False, True)
    )
    assert at_once.n_steps.sum() < through.n_steps.sum()
    scale = np.array([[1.0, 1 / 30.0], [30.0, 1.0]])
    stretch = np.maximum(1.0, np.abs(through.monodromy / scale).max(axis=(1, 2)))
    apart = np.abs(at_once.x_end - through.x_end) / stretch
    assert apart.max() < 7e-12  # 14 tolerances of half a millimetre
    assert at_once.n_contacts.tolist() == through.n_contacts.tolist()
    pairs = zip(at_once.t_contacts, through.t_contacts, strict=True)
    late = np.array([np.abs(one - other).max(initial=0.0) for one, other in pairs])
    assert np.quantile(late / stretch, 0.9) < 1e-11
    turned = np.abs(at_once.monodromy - through.monodromy) / scale / stretch[:, None, None]
    assert turned.max() < 1e-4


def test_a_tight_atol_leaves_out_no_tail_of_far_walls():
    # at rest in the gap: a linear oscillator under the constant sum of both tails
    k, zeta, t = 3.0 * (10.0 * np.pi) ** 2, 0.03, 0.73
    still = gs.Oscillator(zeta=zeta, omega_n=5.0, mass=3.0, alpha=0.0, forcing=0.0)
    law = gs.Tanh(1e5, gs.Gap(1e-3, 1.2e-3), 1.6e4)
    tails = 1e5 * (1e-3 / (1.0 + np.exp(32.0)) - 1.2e-3 / (1.0 + np.exp(38.4)))
    root = np.sqrt(1.0 - zeta**2)
    turned = 10.0 * np.pi * root * t
    decayed = np.exp(-zeta * 10.0 * np.pi * t) * (np.cos(turned) + zeta / root * np.sin(turned))
    truth = -tails / k * (1.0 - decayed)  # -5.6e-16 m
    for atol in (1e-16, 1e-20, 1e-24):
        run = gs.simulate(still, law, 1.0, t_end=t, atol=atol)
        assert abs(run.x_end - truth) < max(atol, 1e-9 * abs(truth))


@pytest.mark.parametrize(("rtol", "t_end"), [(1e-6, 40.0), (1e-8, 1100.0)])
def test_motions_that_turn_back_within_a_layer_go_on(rtol, t_end):
    # Chaotic: sooner or later it passes the wall slowly, where the acceleration is about zero but
    # grows, and turns back before it has left the layer.
    law = gs.Tanh(1.4e4, gs.Gap(4e-4, 4e-4), 1e6)
    run = gs.simulate(OSCILLATOR, law, 1.6, 4e-4, t_end=t_end, rtol=rtol)
    assert run.status == gs.Status.OK
