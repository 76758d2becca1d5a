"""Largest contact force and share of the time in contact: closed forms, scipy, brute force."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

import gapsweep as gs
from gapsweep.model.laws.fitted import RationalPolynomial
from gapsweep.model.systems import paper_oscillator
from gapsweep.model.user_law import UserLaw
from gapsweep.response.loads import largest_forces

LINEAR = paper_oscillator(alpha=0.0)
SYMMETRIC, ASYMMETRIC = gs.Gap(0.4e-3, 0.4e-3), gs.Gap(0.1e-3, 0.6e-3)
CLOSED = gs.Gap(0.0, 0.0)
TIGHT = {"rtol": 1e-10, "atol": 1e-13}


def linear_amplitude(stiffness, omega):
    """Amplitude [m] of the default mass, damping and forcing on one linear spring."""
    o, omega_rad = LINEAR, 2.0 * math.pi * omega
    damping = 2.0 * o.decay_rate * o.mass
    return o.forcing / math.hypot(stiffness - o.mass * omega_rad**2, damping * omega_rad)


SLIGHT = 1e-15  # N/m: felt by nothing
SPRING = LINEAR.mass * LINEAR.omega_n_rad**2


@pytest.mark.parametrize(
    ("law", "rtol"),
    [
        (gs.Piecewise(1.4e4, CLOSED), 1e-8),
        (gs.Piecewise(1.4e4, CLOSED, located=False), 1e-8),
        (gs.Tanh(1.4e4, CLOSED, 1e4), 1e-8),
    ],
)
def test_a_contact_without_a_gap_is_a_spring_that_always_bears(law, rtol):
    response = gs.respond(LINEAR, law, 13.0, **TIGHT)
    assert_allclose(response.force_max, 1.4e4 * linear_amplitude(SPRING + 1.4e4, 13.0), rtol=rtol)
    assert_allclose(response.contact_share, 1.0, rtol=1e-12)


@pytest.mark.parametrize("gap", [SYMMETRIC, ASYMMETRIC])
@pytest.mark.parametrize("law", [gs.Piecewise, gs.Tanh, "no events", "scipy"])
def test_walls_of_hardly_any_stiffness_are_passed_by_a_known_sine(law, gap):
    tolerances = {"engine": "scipy", "rtol": 1e-9, "atol": 1e-13} if law == "scipy" else TIGHT
    laws = {
        gs.Tanh: gs.Tanh(SLIGHT, gap, 1e4),
        "no events": gs.Piecewise(SLIGHT, gap, located=False),
    }
    law = laws.get(law, gs.Piecewise(SLIGHT, gap))
    omega = np.array([4.5, 5.0, 6.0])
    amplitude = np.array([linear_amplitude(SPRING, each) for each in omega])
    assert np.all(amplitude > gap.j_2)
    angles = np.arccos(gap.j_1 / amplitude) + np.arccos(gap.j_2 / amplitude)
    response = gs.respond(LINEAR, law, omega, **tolerances)
    assert_allclose(response.contact_share, angles / math.pi, rtol=1e-6)
    assert_allclose(response.force_max, 0.0, atol=SLIGHT)


@pytest.mark.parametrize("engine", ["compiled", "scipy"])
def test_what_never_touches_bears_nothing(engine):
    response = gs.respond(paper_oscillator(), gs.Piecewise(1.4e4, SYMMETRIC), 25.0, engine=engine)
    assert response.x_max < 0.4e-3
    assert response.force_max == response.contact_share == 0.0


def test_rest_in_the_gap_and_on_a_wall():
    still = paper_oscillator(forcing=0.0)
    for gap in (SYMMETRIC, CLOSED):
        response = gs.respond(still, gs.Piecewise(1.4e4, gap), 5.0)
        assert response.force_max == response.contact_share == 0.0


def test_a_failed_point_has_neither():
    response = gs.respond(
        paper_oscillator(alpha=-7e8), gs.Piecewise(1.4e4, SYMMETRIC), 5.0, x_0=5e-3
    )
    assert response.status is gs.Status.DIVERGED
    assert math.isnan(response.force_max)
    assert math.isnan(response.contact_share)


@pytest.mark.parametrize("located", [True, False])
def test_what_is_not_periodic_has_the_share_of_its_last_window(located):
    # Undamped and linear: two frequencies, known for all times.
    oscillator, omega = paper_oscillator(zeta=0.0, alpha=0.0), 6.1
    steady = gs.Steady(t_max=20.0)
    law = gs.Piecewise(SLIGHT, ASYMMETRIC, located=located)
    response = gs.respond(oscillator, law, omega, steady=steady, **TIGHT)
    assert response.response_class is gs.ResponseClass.UNRESOLVED
    end = response.t_settled
    t = end - (np.arange(400_000) + 0.5) / 400_000 * (64 / omega)
    own, forced = oscillator.omega_n_rad, 2.0 * math.pi * omega
    size = oscillator.forcing / oscillator.mass / (own**2 - forced**2)
    x = size * (np.cos(forced * t) - np.cos(own * t))
    share = np.mean((x < -ASYMMETRIC.j_1) | (x > ASYMMETRIC.j_2))
    assert_allclose(response.contact_share, share, atol=2e-5)


def wavy(x):
    return 5.0 * math.sin(9e3 * x) + 2e3 * x


def walled(x):
    """A law that is asked for nothing but its own motions."""
    if abs(x) > 0.7e-3:
        raise ArithmeticError("no motion leads here")
    return 40.0 - 1e5 * abs(x - 0.2e-3)


GAPS = [gs.Gap(*(1e-3 * np.array(gap))) for gap in ((0.4, 0.4), (0.0, 0.8), (0.01, 0.02), (0, 0))]
RATIOS = (0.0, 0.2, 1.0, 50.0)
LAWS = [
    [gs.Piecewise(k, gap) for gap in GAPS for k in (1e3, 1e5)],
    [gs.Arctan(1e4, gap, epsilon) for gap in GAPS for epsilon in (1e3, 1e4, 1e6)],
    [gs.LogArctan(1e4, gap, gamma) for gap in GAPS for gamma in (1e3, 1e4, 1e6)],
    [gs.Tanh(k, gap, epsilon) for gap in GAPS for epsilon in (1e3, 1e4, 1e5) for k in (1e3, 1e5)],
    [gs.Piecewise(1e4, gap, K_ratio=r) for gap in GAPS for r in RATIOS],
    [gs.Arctan(1e4, gap, 1e4, K_ratio=r) for gap in GAPS for r in RATIOS],
    [gs.LogArctan(1e4, gap, 1e4, K_ratio=r) for gap in GAPS for r in RATIOS],
    [gs.Tanh(1e4, gap, e, K_ratio=r) for gap in GAPS for e in (1e3, 1e5) for r in RATIOS],
    [gs.Polynomial(1e4, GAPS[0], degree=13)],
    [gs.Polynomial(1e4, GAPS[1], degree=4)],
    [gs.Polynomial(0.0, GAPS[1], degree=4)],
    [RationalPolynomial(1e4, GAPS[0], 5, 4)],
    [UserLaw(0.0, GAPS[0], wavy)],
    [UserLaw(0.0, GAPS[0], walled)],
]


@pytest.mark.parametrize("laws", LAWS, ids=lambda laws: str(laws[0])[:40])
def test_the_largest_force_is_that_of_a_fine_grid(laws):
    rng = np.random.default_rng(3)
    laws = [laws[i] for i in rng.integers(len(laws), size=60)]
    ends = np.sort(rng.normal(size=(60, 2)) * 10.0 ** rng.uniform(-6, -3.3, (60, 1)), axis=1)
    x_min, x_max = np.clip(ends, -0.7e-3, 0.7e-3).T
    found = largest_forces(laws, x_min, x_max)
    for law, low, high, largest in zip(laws, x_min, x_max, found, strict=True):
        grid = np.abs(law.force(np.linspace(low, high, 4001))).max()
        assert largest >= grid * (1.0 - 1e-12) - 1e-14
        assert_allclose(largest, grid, rtol=2e-3, atol=1e-12)
        # Alone it is the same to the last bit.
        assert largest_forces([law], np.array([low]), np.array([high]))[0] == largest


def test_the_force_before_the_wall_counts():
    law = gs.Tanh(1.4e4, SYMMETRIC, 1e4)
    (largest,) = largest_forces([law], np.array([-0.38e-3]), np.array([0.38e-3]))
    assert largest > 1.2 * abs(float(law.force(0.38e-3)))


def test_only_a_users_own_code_may_fail(monkeypatch):
    # What a bug in one of ours raised made the largest force too small.
    def broken(self, x):
        raise ArithmeticError("no law of a user's")

    x = np.array([0.5e-3])
    assert largest_forces([UserLaw(0.0, GAPS[0], walled)], -2.0 * x, x) == [40.0]
    law = gs.Tanh(1e4, GAPS[0], 1e4, K_ratio=0.5)
    monkeypatch.setattr(gs.Tanh, "derivative", broken)
    with pytest.raises(ArithmeticError):
        largest_forces([law], -x, x)
