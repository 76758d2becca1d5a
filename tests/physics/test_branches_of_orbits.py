"""Branches of periodic orbits against closed forms, harmonic balance and exact propagation."""

import itertools
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, fsolve, minimize_scalar
from scipy.special import ellipk, mathieu_a, mathieu_b
from tests.builders.random_oscillators import random_cases
from tests.oracles import random_branches
from tests.oracles.exact_orbits import (
    TURN,
    Exact,
    drawn_branches,
    exact_system,
    is_trilinear,
    kinds,
    largest_step,
    located,
    multipliers,
    return_error,
    rows,
    special_points,
    trilinear,
    trilinear_cases,
    trilinear_error,
    trilinear_guess,
    unexplained,
    unknowns,
)

import gapsweep as gs
from gapsweep.continuation.family import Window
from gapsweep.model.parameters import Parameter
from gapsweep.model.system import first_order

RATE = 1.0 / TURN  # Hz at 1 rad/s
NO_CONTACT = gs.Piecewise(0.0, gs.Gap(1.0, 1.0))
PYVIB = gs.Oscillator(zeta=0.025, omega_n=RATE, mass=1.0, alpha=0.0, forcing=0.03)
PYVIB_LAW = gs.Piecewise(3.0, gs.Gap(0.1745, 0.1745))
SYSTEMS = gs.systems

# model, contact law, window [rad/s], frequency of the start [rad/s], other arguments
FORCED = {
    "pyvib": (PYVIB, PYVIB_LAW, (0.6, 1.9), 0.8, {}),
    "soft impact": (
        SYSTEMS.soft_impact_oscillator(),
        SYSTEMS.soft_impact_oscillator_law(),
        (0.70, 1.5),
        0.95,
        {"starts": [[0.0, 0.0], [1.0, 1.0]], "follow": 1},
    ),
    "two masses": (SYSTEMS.two_masses(), SYSTEMS.two_masses_law(), (0.6, 0.8), 0.635, {}),
}


@cache
def forced(name):
    model, law, window, at, options = FORCED[name]
    low, high = np.array(window) * RATE
    return gs.branches(model, law, "omega", (low, high), at=at * RATE, **options)


def listed(branch):
    """Special points of a branch: kinds and frequencies [rad/s]."""
    return [(kind, branch["omega"].values[i] * TURN) for kind, i in special_points(branch)]


def assert_listed(branch, expected, rtol=1e-10):
    found = listed(branch)
    assert [kind for kind, _ in found] == [kind for kind, _ in expected]
    assert_allclose([x for _, x in found], [x for _, x in expected], rtol=rtol)


# --- Published systems --------------------------------------------------------------------------


def peak_between_walls(branch):
    """Largest displacement [m] of symmetric orbits near a branch's largest one, and its omega."""
    top = int(branch["x_max"].values.argmax())
    about = float(branch["omega"][top])
    guess = trilinear_guess(PYVIB, PYVIB_LAW, about, branch["start_state"].values[top])

    def missing(omega):
        return -trilinear(PYVIB, PYVIB_LAW, omega, guess)[1]

    window = 0.9995 * about, 1.0005 * about
    found = minimize_scalar(missing, bounds=window, method="bounded", options={"xatol": 1e-9})
    return -found.fun, found.x


def test_folds_and_grazes_of_the_piecewise_linear_oscillator_are_the_known_ones():
    def beyond(w):
        return 0.1745**2 * ((1.0 - w**2) ** 2 + (0.05 * w) ** 2) - 0.03**2

    ds = forced("pyvib")
    assert ds.sizes["branch"] == 1
    branch = rows(ds, 0)
    grazes = [brentq(beyond, *ends, xtol=1e-15) for ends in ((0.8, 1.0), (1.0, 1.2))]
    expected = [
        ("grazing", grazes[0]),
        ("fold", 1.534979533623),
        ("fold", 1.078508348107),
        ("grazing", grazes[1]),
    ]
    assert_listed(branch, expected, rtol=1e-11)
    steps = [i for _, i in special_points(branch)]
    expected = [0.1745, 0.396677003530, 0.174683765636, 0.1745]
    assert_allclose(branch["x_max"].values[steps], expected, rtol=1e-9)
    peak, omega = peak_between_walls(branch)
    top = int(branch["x_max"].values.argmax())
    at, near = float(branch["omega"][top]), branch["start_state"].values[top]
    window = 0.999 * omega, 1.0005 * omega
    fine = rows(gs.branches(PYVIB, PYVIB_LAW, "omega", window, at=at, start=near), 0)
    assert fine["x_max"].max() == pytest.approx(peak, rel=1e-6)
    unstable = (branch["stable"] == 0).values
    assert unstable[steps[1] + 1 : steps[2]].all()
    assert not unstable[: steps[1]].any()
    assert not unstable[steps[2] + 1 :].any()


@pytest.mark.extended
def test_two_masses_have_their_bifurcations_in_the_order_of_the_branch():
    ds = forced("two masses")
    branch = rows(ds, 0)
    found = listed(branch)
    expected = [
        ("torus", 0.618606874267),
        ("period_doubling", 0.7387830253732),
        ("period_doubling", 0.7555861593562),
        ("fold", 0.7556273526091),
    ]
    assert [kind for kind, _ in found[:4]] == [kind for kind, _ in expected]
    assert_allclose([x for _, x in found[:4]], [x for _, x in expected], rtol=1e-11)
    steps = [i for _, i in special_points(branch)]
    assert branch["x_max"].values[steps[1], 0] == pytest.approx(1.071841003725, rel=1e-10)
    moduli = np.abs(multipliers(branch)[steps[0]])
    assert_allclose(moduli[:2], 1.0, atol=1e-8)
    # Unstable from the first doubling to the second one, and behind the fold.
    assert not branch["stable"].values[steps[1] + 1 : steps[2]].any()
    assert branch["stable"].values[steps[2] + 1 : steps[3]].all()
    behind = branch["omega"].values[steps[3] :] * TURN
    assert behind.min() < 0.7097


def test_both_branches_of_the_soft_impact_oscillator_are_found():
    ds = forced("soft impact")
    assert ds["attractor_on_branch"].values.tolist() == [0, 1]
    third, first = rows(ds, 0), rows(ds, 1)
    assert third["period_multiple"].values[0] == 3
    assert first["period_multiple"].values[0] == 1
    for branch, x_max, modulus in ((third, 1.236163277, 0.8200), (first, 1.120418325, 0.9360)):
        at = np.abs(branch["omega"].values * TURN - 0.95) < 1e-9
        near = np.abs(branch["x_max"].values - x_max) < 1e-8
        (step,) = np.flatnonzero(at & near)
        assert np.abs(multipliers(branch)[step]).max() == pytest.approx(modulus, abs=1e-4)
    graze, fold = listed(third)[:2]
    assert graze[0] == "grazing"
    assert 1.030713 < graze[1] < 1.030720
    assert fold == ("fold", pytest.approx(1.0308404625, rel=1e-10))
    counts = third["n_contacts"].values
    at = special_points(third)[0][1]
    assert counts[[at - 1, at + 1]].tolist() == [4, 6]
    assert [kind for kind, _ in listed(first)] == ["grazing", "period_doubling", "period_doubling"]


@pytest.mark.parametrize(
    ("name", "branch"),
    [("pyvib", 0), ("two masses", 0), ("soft impact", 0), ("soft impact", 1), ("soft impact", 3)],
)
def test_special_points_are_where_exact_propagation_has_them(name, branch):
    model, law, *_ = FORCED[name]
    ds = forced(name)
    found, system = rows(ds, branch), exact_system(model, law)
    orbits = Exact(lambda omega: (system, omega), int(found["period_multiple"][0]))
    last = found.sizes["step"] - 1
    points = [(kind, step) for kind, step in special_points(found) if 0 < step < last]
    assert points
    for kind, step in points:
        point = located(found, step, orbits)
        where = found["omega"].values[step]
        assert point.unknowns[-1] == pytest.approx(where, rel=1e-10), (kind, where * TURN)
        assert_allclose(
            found["start_state"].values[step], point.unknowns[:-1], rtol=1e-5, atol=1e-6
        )
        mu = multipliers(found)[step]
        if kind != "grazing":
            expected = {"fold": mu - 1.0, "period_doubling": mu + 1.0, "torus": np.abs(mu) - 1.0}
            assert np.abs(expected[kind]).min() <= 1e-8, (kind, where * TURN, mu)
    assert not unexplained(found)


# --- Closed forms and harmonic balance ----------------------------------------------------------


@pytest.mark.parametrize("zeta", [0.02, 0.3])
def test_a_linear_oscillator_follows_its_closed_form(zeta):
    model = gs.Oscillator(zeta=zeta, omega_n=5.0, mass=2.0, alpha=0.0, forcing=3.0)
    branch = rows(gs.branches(model, NO_CONTACT, "omega", (1.0, 20.0)), 0)
    assert not special_points(branch)
    assert (branch["stable"] == 1).all()
    w_n, w = TURN * 5.0, TURN * branch["omega"].values
    z = 3.0 / (2.0 * (w_n**2 - w**2 + 2j * zeta * w_n * w))
    assert_allclose(branch["amplitude"].values, np.abs(z), rtol=1e-9)
    states = np.array([z.real, -w * z.imag]).T
    assert_allclose(branch["start_state"].values, states, atol=1e-9 * np.abs(states).max())
    roots = w_n * (-zeta + 1j * math.sqrt(1.0 - zeta**2))
    expected = np.exp(roots * TURN / w)
    mu = multipliers(branch)
    apart = np.minimum(np.abs(mu[:, 0] - expected), np.abs(mu[:, 0] - expected.conj()))
    assert apart.max() < 1e-8
    assert_allclose(np.prod(mu, axis=1).real, np.abs(expected) ** 2, atol=1e-9)


class HarmonicBalance:
    """Forced orbits of x'' + c x' + x + x³ = F cos w t as Fourier series with odd harmonics."""

    def __init__(self, c, F, n=40, n_times=512):
        self.c, self.F, self.k = c, F, np.arange(1, 2 * n, 2)
        t = TURN * np.arange(n_times) / n_times
        self.basis = np.concatenate([np.cos(np.outer(t, self.k)), np.sin(np.outer(t, self.k))], 1)

    def residual(self, u):
        """Residual and its derivatives by coefficients and frequency."""
        a, w, n = u[:-1], u[-1], len(self.k)
        x = self.basis @ a
        linear, by_w = np.zeros((2, 2 * n, 2 * n))
        for i, k in enumerate(self.k):
            block = np.ix_([i, n + i], [i, n + i])
            linear[block] = [
                [1 - (k * w) ** 2, self.c * k * w],
                [-self.c * k * w, 1 - (k * w) ** 2],
            ]
            by_w[block] = [[-2 * k * k * w, self.c * k], [-self.c * k, -2 * k * k * w]]
        project = 2.0 / len(x) * self.basis.T
        load = np.zeros(2 * n)
        load[0] = self.F
        found = linear @ a + project @ x**3 - load
        return found, np.column_stack(
            [linear + project @ (3.0 * x[:, None] ** 2 * self.basis), by_w @ a]
        )

    def on_plane(self, guess, normal):
        """Orbit on a plane through a guess, and the frequency's component of its tangent."""
        u = guess.copy()
        for _ in range(12):
            residual, jacobian = self.residual(u)
            matrix = np.vstack([jacobian, normal])
            u = u - np.linalg.solve(matrix, np.append(residual, normal @ (u - guess)))
        tangent = np.linalg.solve(matrix, np.append(np.zeros(len(u) - 1), 1.0))
        return u, tangent[-1]

    def guess(self, state, w):
        """Coefficients of a motion over one period."""
        period, n = TURN / w, len(self.basis)
        run = solve_ivp(
            lambda t, y: [y[1], self.F * math.cos(w * t) - self.c * y[1] - y[0] - y[0] ** 3],
            (0.0, period),
            state,
            t_eval=period * np.arange(n) / n,
            rtol=1e-8,
            atol=1e-10,
        )
        return np.append(2.0 / n * self.basis.T @ run.y[0], w)

    def fold(self, before, after):
        normal = (after - before) / np.sqrt(((after - before) ** 2).sum())

        def slope(s):
            return self.on_plane(before + s * (after - before), normal)[1]

        s = brentq(slope, 0.0, 1.0, xtol=1e-12)
        return self.on_plane(before + s * (after - before), normal)[0]


def test_folds_of_duffing_without_contact_are_those_of_harmonic_balance():
    c, F = 0.1, 0.5
    model = gs.Oscillator(zeta=c / 2.0, omega_n=RATE, mass=1.0, alpha=1.0, forcing=F)
    ds = gs.branches(model, NO_CONTACT, "omega", (0.8 * RATE, 4.0 * RATE), at=RATE)
    branch = rows(ds, 0)
    points = special_points(branch)
    assert [kind for kind, _ in points] == ["fold", "fold"]
    balance = HarmonicBalance(c, F)
    states, omega = branch["start_state"].values, branch["omega"].values
    for _, i in points:
        before, after = (balance.guess(states[j], omega[j] * TURN) for j in (i - 1, i + 1))
        truth = balance.fold(before, after)
        assert np.abs(truth[len(balance.k) - 1]) < 1e-12  # the series has converged
        assert omega[i] * TURN == pytest.approx(truth[-1], rel=1e-9)
        assert branch["x_max"].values[i] == pytest.approx(
            (balance.basis @ truth[:-1]).max(), rel=1e-3
        )
        assert np.abs(multipliers(branch)[i] - 1.0).min() <= 1e-8


def half_period(model, y, omega):
    """Minus the state after half a forcing period, and its derivatives, by DOP853.

    States in static deflections of the spring and in those times the forcing's rate.
    """
    m, w = model.mass, TURN * omega
    k = m * (TURN * model.omega_n) ** 2
    c, x_0 = 2.0 * model.zeta * math.sqrt(k * m), model.forcing / k

    def rates(t, u):
        x, v = x_0 * u[0], x_0 * w * u[1]
        force = model.forcing * math.cos(w * t) - c * v - k * x - model.alpha * x**3
        tangent = u[2:].reshape(2, 2)
        slope = -(k + 3.0 * model.alpha * x**2) / (m * w) * tangent[0] - c / m * tangent[1]
        return np.concatenate([[w * u[1], force / (m * x_0 * w)], w * tangent[1], slope])

    run = solve_ivp(
        rates,
        (0.0, 0.5 / omega),
        [*y, 1.0, 0.0, 0.0, 1.0],
        method="DOP853",
        rtol=1e-11,
        atol=1e-13,
    )
    return -run.y[:2, -1], -run.y[2:, -1].reshape(2, 2)


def broken_symmetry(model, state, omega):
    """Frequency at which minus the motion over half a period has a multiplier -1."""
    x_0 = model.forcing / (model.mass * (TURN * model.omega_n) ** 2)
    start = np.array([state[0], state[1] / (TURN * omega)]) / x_0

    def value(omega):
        y, step = start, np.inf
        while np.abs(step).max() > 1e-10:
            end, tangent = half_period(model, y, omega)
            step = -np.linalg.solve(tangent - np.eye(2), end - y)
            y = y + step
        return np.linalg.det(tangent + np.eye(2))

    return brentq(value, (1.0 - 2e-4) * omega, (1.0 + 2e-4) * omega, xtol=1e-13 * omega)


@pytest.mark.parametrize(
    ("alpha", "zeta"),
    [
        (5.0, 0.05),
        (20.0, 0.03),
    ],
)
def test_symmetry_of_duffing_breaks_where_half_a_period_says(alpha, zeta):
    model = gs.Oscillator(zeta=zeta, omega_n=RATE, mass=1.0, alpha=alpha, forcing=1.0)
    window = 0.2 * RATE, 1.5 * RATE
    branch = rows(gs.branches(model, NO_CONTACT, "omega", window, at=0.85 * RATE), 0)
    steps = [i for kind, i in special_points(branch) if kind == "symmetry_breaking"]
    assert len(steps) >= 2
    for step in steps:
        found, state = float(branch["omega"][step]), branch["start_state"].values[step]
        assert found == pytest.approx(broken_symmetry(model, state, found), rel=1e-6)


@pytest.mark.extended
def test_the_backbone_of_duffing_has_elliptic_periods():
    model = gs.Oscillator(zeta=0.0, omega_n=RATE, mass=1.0, alpha=1.0, forcing=0.0)
    branch = rows(gs.branches(model, NO_CONTACT, "amplitude", (0.1, 3.0)), 0)
    a = branch["amplitude"].values
    assert_allclose([a.min(), a.max()], [0.1, 3.0], rtol=1e-9)
    periods = 4.0 * ellipk(a**2 / (2.0 * (1.0 + a**2))) / np.sqrt(1.0 + a**2)
    # Newton's method ends at steps of 1e-10 of the unknowns.
    assert_allclose(branch["period"].values, periods, rtol=1e-9)
    ends = branch["period"].values[[a.argmin(), a.argmax()]]
    assert_allclose(ends, [6.259762302133, 2.294401860614], rtol=1e-10)
    middle = rows(gs.branches(model, NO_CONTACT, "amplitude", (0.5, 1.0)), 0)
    assert middle["period"].values.min() == pytest.approx(4.768022029102, rel=1e-10)
    assert (branch["stable"] == 1).all()


@pytest.mark.parametrize("ratio", [0.5, 8.0])
def test_free_periods_of_a_bilinear_oscillator_are_the_mean_of_both_springs(ratio):
    model = gs.Oscillator(zeta=0.0, omega_n=RATE, mass=1.0, alpha=0.0, forcing=0.0)
    law = gs.Piecewise(ratio, gs.Gap(0.0, 0.0), K_ratio=0.0)
    branch = rows(gs.branches(model, law, "amplitude", (0.1, 10.0)), 0)
    expected = math.pi * (1.0 + 1.0 / math.sqrt(1.0 + ratio))
    assert_allclose(branch["period"].values, expected, rtol=1e-9)
    share = -branch["x_min"].values / branch["x_max"].values
    assert_allclose(share, math.sqrt(1.0 + ratio), rtol=1e-9)
    half_range = 0.5 * (1.0 + share) * branch["x_max"].values
    assert_allclose(branch["amplitude"].values, half_range, rtol=1e-12)


def test_symmetric_orbits_between_walls_solve_four_equations_in_closed_form():
    n_compared = 0
    for model, law, omega in trilinear_cases(16, 5):
        window = 0.98 * omega, 1.02 * omega
        ds = gs.branches(model, law, "omega", window, at=omega, max_steps=10)
        for number in ds["branch"].values:
            branch = rows(ds, number)
            is_wanted = is_trilinear(branch)
            steps = np.flatnonzero(is_wanted)[:: max(1, int(is_wanted.sum()) - 1)]
            for step in steps:
                assert trilinear_error(model, law, branch, step) < 1e-8
            n_compared += bool(len(steps))
    assert n_compared >= 12


# --- Self-excited and two-well systems ----------------------------------------------------------


def two_well(load=0.7):
    """Schoukens and Pintelon, exercise 79: y'' + y' - 10 y + 100 y³ = load cos 3.5 t."""
    return gs.System(
        mass=[[1.0]],
        damping=[[1.0]],
        stiffness=[[-10.0]],
        cubic=[gs.Cubic(along=[1.0], alpha=100.0)],
        forcing=[gs.Harmonic(amplitude=[load])],
    )


@pytest.mark.extended
def test_doublings_of_a_two_well_oscillator_in_its_load():
    ds = gs.branches(
        two_well, {}, "load", (0.6, 0.9), at=0.67, omega=3.5 * RATE, starts=[[0.2, -0.2]], follow=2
    )
    assert ds["period_multiple"].values[:, 0].tolist() == [1, 2, 4]
    assert ds["parent"].values.tolist() == [-1, 0, 1]
    doublings = []
    for number in range(2):
        branch = rows(ds, number)
        (step,) = (i for kind, i in special_points(branch) if kind == "period_doubling" and i > 0)
        doublings.append(float(branch["load"][step]))
        assert np.abs(multipliers(branch)[step] + 1.0).min() <= 1e-8
        child = rows(ds, number + 1)
        assert child["load"].values[0] == pytest.approx(doublings[-1], rel=1e-9)
        assert child["stable"].values[2:5].all()
    assert 0.70 < doublings[0] < 0.81
    assert 0.81 < doublings[1] < 0.82
    # On either side, motions settle on so many periods.
    for at, below, above in zip(doublings, (1, 2), (2, 4), strict=True):
        for load, multiple in ((at - 3e-4, below), (at + 3e-4, above)):
            found = gs.respond(two_well(load), {}, 3.5 * RATE, q_0=[0.2], v_0=[-0.2])
            assert found.period_multiple == multiple


CONNER = "conner-scaled"


def section(speed):
    return SYSTEMS.typical_section(speed, copy=CONNER)


@cache
def flutter():
    law, speed = SYSTEMS.typical_section_law(copy=CONNER), 12.36842
    start = gs.respond(section(speed), law, q_0=[0.01, 0.0, 0.0])
    return gs.branches(section, law, "speed", (9.0, 13.0), at=speed, start=start, max_steps=60)


@pytest.mark.extended
def test_the_asymmetric_cycle_of_the_typical_section_leaves_the_symmetric_one():
    ds, law = flutter(), SYSTEMS.typical_section_law(copy=CONNER)
    branch = rows(ds, 0)
    flap = np.degrees([branch["x_min"].values[:, 2], branch["x_max"].values[:, 2]])
    start = int(np.abs(branch["speed"].values - 12.36842).argmin())
    assert 1.0 / branch["period"].values[start] == pytest.approx(5.1001, abs=5e-4)
    assert_allclose(flap[:, start], [-2.462, 3.429], atol=1e-3)
    orbits = Exact(lambda speed: (exact_system(section(speed), law), 1.0), 0)
    (step,) = (i for kind, i in special_points(branch) if kind == "symmetry_breaking")
    assert_allclose(flap[0, step], -flap[1, step], rtol=1e-3)
    # Symmetry breaks where minus the motion over half a period has a multiplier -1.
    near = unknowns(branch, step)
    aside = np.array([*np.ones(len(near) - 2), 1.001, 1.0])
    truth = replace(orbits, is_halved=True).crossing(near / aside, near * aside, "period_doubling")
    assert branch["speed"].values[step] == pytest.approx(truth.unknowns[-2], rel=1e-8)
    # Beyond it come the same special points as before it, of the mirror images.
    for kind in ("torus", "fold", "period_doubling"):
        i = next(i for each, i in special_points(branch) if each == kind and i > step)
        found = located(branch, i, orbits)
        assert branch["speed"].values[i] == pytest.approx(found.unknowns[-2], rel=1e-9)
        assert branch["period"].values[i] == pytest.approx(found.unknowns[-1], rel=1e-9)
    assert not unexplained(branch)


def growth(speed):
    """The eigenvalue [1/s] of the typical section without the flap's spring that grows fastest."""
    system = SYSTEMS.typical_section(speed)
    n, lags = system.n, system.lags
    inverse = np.linalg.inv(system.mass)
    rates = np.block(
        [
            [np.zeros((n, n)), np.eye(n), np.zeros((n, lags.of_lags.shape[0]))],
            [-inverse @ system.stiffness, -inverse @ system.damping, -inverse @ lags.force],
            [lags.of_place, lags.of_speed, lags.of_lags],
        ]
    )
    values = np.linalg.eigvals(rates)
    return values[values.real.argmax()]


def test_cycles_within_the_freeplay_have_the_flutter_speed_of_a_loose_flap():
    law = SYSTEMS.typical_section_law()
    start = gs.respond(SYSTEMS.typical_section(8.0), law, q_0=[0.01, 0.0, 0.0])
    ds = gs.branches(SYSTEMS.typical_section, law, "speed", (2.0, 9.0), at=8.0, start=start)
    branch = rows(ds, 0)
    is_within = (branch["x_max"].values[:, 2] < law.gap.j_2) & (kinds(branch) == "none")
    assert is_within.sum() >= 5
    flutter_speed = brentq(lambda speed: growth(speed).real, 6.0, 7.5, xtol=1e-13)
    speeds, periods = (branch[name].values[is_within] for name in ("speed", "period"))
    assert_allclose(speeds, flutter_speed, rtol=1e-9)
    assert_allclose(periods, TURN / abs(growth(flutter_speed).imag), rtol=1e-9)
    assert (branch["n_contacts"].values[is_within] == 0).all()
    (graze,) = (i for kind, i in special_points(branch) if kind == "grazing")
    assert branch["speed"].values[graze] == pytest.approx(flutter_speed, rel=1e-9)
    assert branch["x_max"].values[graze, 2] == pytest.approx(law.gap.j_2, rel=1e-9)


# --- Smooth approximations ----------------------------------------------------------------------


def special_frequencies(model, law, window, at, kind):
    low, high = window
    branch = rows(gs.branches(model, law, "omega", (low, high), at=at), 0)
    steps = [i for each, i in special_points(branch) if each == kind]
    return branch["omega"].values[steps]


@pytest.mark.parametrize(
    ("model", "law", "window", "at", "kind", "decades"),
    [
        (PYVIB, PYVIB_LAW, (0.9 * RATE, 1.9 * RATE), 1.2 * RATE, "fold", (3, 4, 5)),
        (
            gs.systems.paper_oscillator(),
            gs.Piecewise(1.4e4, gs.Gap(0.0, 0.8e-3)),
            (6.2, 7.4),
            6.3,
            "period_doubling",
            (4, 5, 6),
        ),
    ],
    ids=["folds", "doublings"],
)
def test_special_points_of_tanh_converge_to_those_of_exact_contact(
    model, law, window, at, kind, decades
):
    exact = special_frequencies(model, law, window, at, kind)
    assert len(exact) == 2
    errors = []
    for decade in decades:
        smooth = gs.Tanh(law.K_c, law.gap, epsilon=10.0**decade)
        errors.append(np.abs(special_frequencies(model, smooth, window, at, kind) / exact - 1.0))
    errors = np.array(errors)
    # The force differs by the layer's area, 1 / epsilon²: a tenth of its width, a hundredth of it.
    ratios = errors[:-1] / errors[1:]
    assert (ratios > 20.0).all(), errors
    assert (errors[-1] < 1e-6).all(), errors


# --- Invariants ---------------------------------------------------------------------------------


@pytest.mark.extended
def test_drawn_branches_hold_periodic_orbits_without_jumps():
    n_branches = n_points = n_stable = 0
    for case, ds in drawn_branches(25, seed=3, max_steps=60):
        assert (ds["attractor_on_branch"] >= 0).all()
        for which in ds["branch"].values:
            branch = rows(ds, which)
            n_branches += 1
            assert not unexplained(branch), case
            assert largest_step(branch) <= 0.2
            for step in range(0, branch.sizes["step"], 6):
                assert return_error(case.oscillator, case.law, branch, step) < 1e-9, case
            for kind, step in special_points(branch):
                one = {"fold": 1.0, "symmetry_breaking": 1.0, "period_doubling": -1.0}.get(kind)
                # A branch of double period ends where it meets that of the single one.
                is_end = kind == "period_doubling" and step in (0, branch.sizes["step"] - 1)
                if one is not None and not beside_a_graze(branch, step):
                    n_points += 1
                    apart = multipliers(branch)[step] - (1.0 if is_end else one)
                    assert np.abs(apart).min() <= 1e-6, (case, kind)
            # The attractor that it started from is stable, and motions stay on stable orbits.
            here = np.isclose(branch["omega"].values, case.omega, rtol=1e-9)
            assert (branch["stable"].values[here] == 1).any(), case
            stable = np.flatnonzero((branch["stable"] == 1) & (kinds(branch) == "none"))
            for step in stable[[0, len(stable) // 2]]:
                row = branch.isel(step=step)
                if np.abs(multipliers(branch)[step]).max() > 0.99:
                    continue
                n_stable += 1
                response = gs.respond(
                    case.oscillator, case.law, float(row["omega"]), *row["start_state"].values
                )
                assert response.period_multiple == int(row["period_multiple"]), case
                assert response.x_max == pytest.approx(float(row["x_max"]), rel=1e-6), case
    assert n_branches >= 22
    assert n_points >= 5
    assert n_stable >= 20


def beside_a_graze(branch, step):
    """Whether a graze is so near that multipliers change at once there."""
    omega, names = branch["omega"].values, kinds(branch)
    grazes = omega[names == "grazing"]
    return bool((np.abs(grazes / omega[step] - 1.0) < 1e-8).any())


# --- Errors -------------------------------------------------------------------------------------

SOFT = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"along": "stiffness"}, "parameter 'stiffness': must be one of omega, .*zeta.*function"),
        ({"along": "epsilon"}, "parameter 'epsilon': must be one of omega, "),
        ({"between": (12.0, 6.0)}, r"range of omega = \(12.0, 6.0\): must be ascending"),
        ({"between": (0.0, 6.0)}, "range of omega = 0: must be > 0"),
        ({"between": (6.0, math.inf)}, "range of omega = inf: must be finite"),
        ({"between": 6.0}, r"range of omega = 6.0: must be its two ends"),
        ({"at": 13.0}, r"at = 13.0: must lie within between = \(6, 12\)"),
        ({"along": "zeta", "between": (-0.5, 0.5), "omega": 9.0}, "zeta = -0.5: must be >= 0"),
        ({"along": "forcing", "between": (1.0, 2.0)}, "omega: missing; .* omega=9.0"),
        (
            {"at": 8.0, "start": [10.0, 0.0]},
            "start: .* no periodic orbit near it at omega = 8; ",
        ),
        ({"at": 8.0, "start": [1.0, 2.0, 3.0]}, r"start = \[.*\]: must be a state of 2 numbers"),
        ({"start": [0.0, 0.0]}, "at: missing; give the value of omega"),
        ({"at": 8.0, "starts": [1.0, 2.0, 3.0]}, "starts: must be states of 2 numbers"),
        ({"along": "located", "between": (0.0, 1.0), "omega": 9.0}, "parameter 'located': must be"),
        ({"omega": 3.0}, "omega = 3.0: leave it out, it is the parameter"),
        ({"at": 8.0, "follow": -1}, r"follow = -1: must be a whole number in 0..10"),
        ({"at": 8.0, "max_steps": 1}, r"max_steps = 1: must be a whole number in 2..100000"),
        ({"along": "amplitude"}, "along = 'amplitude': .* forcing and damping must be 0"),
        ({"at": 8.0, "start": [0.0, 0.0], "starts": [0.0, 0.0]}, "start and starts: "),
        ({"at": [8.0, 9.0], "start": [0.0, 0.0]}, r"at = \[8.0, 9.0\]: .*one value of omega"),
        ({"law": None}, r"law: missing for \['x'\], as law=gs.Piecewise"),
        ({"law": {"x": None}}, "law = None: must be a contact law"),
        (
            {"along": "forcing", "between": (0.0, 5.0), "at": 0.0, "omega": 9.0},
            r"starts: no motion .*\(3 equilibrium\)",
        ),
    ],
)
def test_bad_input_gives_one_line(options, message):
    given = {"between": (6.0, 12.0)} | options
    with pytest.raises(gs.ModelError, match=message) as caught:
        gs.branches(gs.systems.paper_oscillator(), given.pop("law", SOFT), **given)
    assert "\n" not in str(caught.value)


def test_a_response_at_another_frequency_is_refused():
    start = gs.respond(gs.systems.paper_oscillator(), SOFT, omega=8.0)
    for options in (
        {"between": (6.0, 12.0), "at": 9.0},
        {"along": "zeta", "between": (0.01, 0.1), "at": 0.03, "omega": 9.0},
    ):
        with pytest.raises(gs.ModelError, match="= 9: must be omega = 8 of the response"):
            gs.branches(gs.systems.paper_oscillator(), SOFT, start=start, **options)


def test_a_response_of_another_model_is_refused():
    start = gs.respond(gs.systems.paper_oscillator(), SOFT, omega=0.1)
    system, law = gs.systems.two_masses(), gs.systems.two_masses_law()
    with pytest.raises(
        gs.ModelError, match=r"start: must be a response of this model.* 4 .* forced"
    ):
        gs.branches(system, law, between=(0.05, 0.2), start=start)
    cycle, free = gs.respond(duffing(), {}, q_0=[0.5]), {"along": "amplitude"}
    for model, other, wall, given in (
        (gs.systems.paper_oscillator(), cycle, SOFT, {}),
        (duffing(), start, {}, free),
    ):
        with pytest.raises(gs.ModelError, match="start: must be a response of this model"):
            gs.branches(model, wall, between=(0.05, 2.0), start=other, **given)
    with pytest.raises(gs.ModelError, match=r"oscillator = .*dict.*: must be a gapsweep"):
        gs.branches(dict, law, "forcing", (1.0, 2.0), omega=1.0)


def test_a_parameter_that_a_system_lacks_is_named_with_the_remedy():
    law = SYSTEMS.typical_section_law()
    message = "parameter 'speed': must be one of .* a function with this argument"
    with pytest.raises(gs.ModelError, match=message):
        gs.branches(SYSTEMS.typical_section(12.0), law, "speed", (2.0, 20.0))
    message = "start: an unforced system needs a gapsweep.Response"
    with pytest.raises(gs.ModelError, match=message):
        gs.branches(SYSTEMS.typical_section, law, "speed", (2.0, 20.0), at=12.0, start=np.zeros(8))


# --- Mended defects ------------------------------------------------------------------------------


def test_free_motions_stay_within_their_window():
    model = gs.Oscillator(zeta=0.0, omega_n=RATE, mass=1.0, alpha=1.0, forcing=0.0)
    ds = gs.branches(model, NO_CONTACT, "amplitude", (0.5, 1.0))
    assert float(ds["amplitude"].min()) >= 0.5 * (1.0 - 1e-9)


def free(**changes):
    """An undamped oscillator with a cubic spring, and a wall on one side where asked for."""
    return gs.Oscillator(
        **{"zeta": 0.0, "omega_n": RATE, "mass": 1.0, "alpha": 1.0, "forcing": 0.0} | changes
    )


def duffing(*loads):
    """The oscillator without contact: x'' + (0.1 x' if it is forced) + x + x³."""
    return gs.System(
        mass=[[1.0]],
        stiffness=[[1.0]],
        damping=[[0.1 * len(loads)]],
        cubic=[gs.Cubic(along=[1.0], alpha=1.0)],
        forcing=loads,
    )


def test_a_system_without_contacts_has_the_branches_of_walls_out_of_reach():
    window, at = (0.8 * RATE, 4.0 * RATE), RATE
    system = duffing(gs.Harmonic(amplitude=[0.5]))
    ours = rows(gs.branches(system, {}, between=window, at=at), 0)
    other = free(zeta=0.05, forcing=0.5)
    walls = rows(gs.branches(other, NO_CONTACT, "omega", window, at=at), 0)
    folds = [
        [branch["omega"].values[i] for _, i in special_points(branch)] for branch in (ours, walls)
    ]
    assert len(folds[0]) == 2
    assert_allclose(*folds, rtol=1e-9)


@pytest.mark.extended
def test_free_motions_of_a_system_without_contacts_have_elliptic_periods():
    branch = rows(gs.branches(duffing(), {}, along="amplitude", between=(0.1, 2.0)), 0)
    a = branch["amplitude"].values
    periods = 4.0 * ellipk(a**2 / (2.0 * (1.0 + a**2))) / np.sqrt(1.0 + a**2)
    assert_allclose(branch["period"].values, periods, rtol=1e-9)
    assert_allclose([a.min(), a.max()], [0.1, 2.0], rtol=1e-9)


def test_free_motions_start_at_every_value_and_stay_between():
    """A bilinear oscillator: with 9 times the stiffness on one side it swings 3 times as far."""
    model, law = free(alpha=0.0), gs.Piecewise(8.0, gs.Gap(0.0, 0.0), K_ratio=0.0)
    ds = gs.branches(model, law, "amplitude", (0.2, 0.8), at=[0.2, 0.3])
    assert_allclose(ds["attractor_amplitude"], [0.4, 0.6], rtol=1e-9)
    assert ds["attractor_on_branch"].values.tolist() == [0, 0]
    assert ds.sizes["branch"] == 1
    assert ds.attrs["initial_conditions"].startswith("free motions;")
    a = rows(ds, 0)["amplitude"].values
    assert_allclose([a.min(), a.max()], [0.2, 0.8], rtol=1e-9)
    for wrong in ({"at": 0.4, "start": [0.3, 0.0]}, {"start": [1.5, 0.0]}, {"at": 0.7}):
        with pytest.raises(gs.ModelError, match=r"^(at|amplitude) = [\d.\[\]]+: must "):
            gs.branches(model, law, "amplitude", (0.2, 0.8), **wrong)
    with pytest.raises(gs.ModelError, match=r"starts: .* free motions; .* at"):
        gs.branches(model, law, "amplitude", (0.2, 0.8), starts=[[0.3, 0.0]])
    response = gs.respond(duffing(), {}, q_0=[0.5])
    ds = gs.branches(duffing(), {}, "amplitude", (0.3, 0.8), start=response)
    assert float(ds["attractor_amplitude"][0]) == pytest.approx(0.5, rel=1e-6)


def coupled(rate):
    """Two masses whose coupling feeds one from the other: flutter beyond 0.251."""
    return gs.System(
        mass=np.eye(2),
        stiffness=[[1.0, rate], [-rate, 1.5]],
        damping=0.02 * np.eye(2),
        cubic=[gs.Cubic(along=each, alpha=1.0) for each in ([1.0, 0.0], [0.0, 1.5])],
    )


@pytest.mark.extended
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("law", [{}, gs.law(lambda x: 0.5 * x**3, K_c=0.0, gap=gs.Gap(0.0, 0.0))])
def test_default_starts_leave_the_equilibrium_without_warnings(law):
    def make(rate):
        return replace(coupled(rate), contacts={"spring": [1.0, 0.0]} if law else {})

    ds = gs.branches(make, law, "rate", (0.3, 0.4), at=0.35)
    assert ds.sizes["branch"] >= 1
    with pytest.raises(gs.ModelError, match=r"starts: no motion .* \(\d+ equilibrium\)"):
        gs.branches(make, law, "rate", (0.05, 0.1), at=0.07)


@pytest.mark.filterwarnings("error")
def test_a_motion_that_starts_where_it_counts_as_diverged_gives_no_warning():
    response = gs.respond(coupled(0.3), {}, q_0=[1e9, 0.0])
    assert response.status == gs.Status.DIVERGED


@pytest.mark.parametrize("ends", [(1.0, 1e6), (0.3, 7.7), (1e-3, 0.7), (-0.1, 0.7)])
def test_a_window_has_the_values_that_it_was_given(ends):
    window = Window.of("K_c", ends)
    assert (window.value(0.0), window.value(1.0)) == ends
    assert window.value(np.array([0.0, 2.0, -1.0])).tolist() == [ends[0], ends[1], ends[0]]
    assert (window.place(ends[0]), window.place(ends[1])) == (0.0, 1.0)


TURNS_BACK = 17  # a drawn scene whose branch turns back at a graze


def drawn(number, seed=3, max_steps=250):
    """The branches of one of the drawn scenes."""
    (case,) = itertools.islice(random_cases(number + 1, seed), number, None)
    window = 0.7 * case.omega, 1.5 * case.omega
    return gs.branches(
        case.oscillator, case.law, between=window, at=case.omega, max_steps=max_steps
    )


def test_multipliers_are_one_where_the_branch_of_scene_17_ends():
    branch = rows(drawn(TURNS_BACK), 0)
    for kind, step in special_points(branch):
        if kind in ("branch_point", "period_doubling") and not beside_a_graze(branch, step):
            mu = multipliers(branch)[step]
            assert min(np.abs(mu - 1.0).min(), np.abs(mu + 1.0).min()) < 1e-3


@pytest.mark.extended
def test_each_graze_of_many_contacts_is_located_or_counted():
    """With 270 turning points, pairs of them appear and disappear beyond a wall within one step.

    Short steps around its kinks: 250 of them pass 12 grazes only. Those that are lost are counted;
    how many differs by the errors of the integration, 3 and 5 with series of degree 20 and 16.
    """
    ds = drawn(193, max_steps=400)
    branch = rows(ds, 0)
    assert (kinds(branch) == "grazing").sum() > 15
    assert len(unexplained(branch)) <= ds.attrs["n_lost"] <= 6


def test_a_state_of_an_orbit_of_three_periods_starts_its_branch():
    branch = rows(forced("soft impact"), 0)
    row = branch.isel(step=int(np.flatnonzero(branch["stable"].values == 1)[5]))
    at, model, law = float(row["omega"]), *FORCED["soft impact"][:2]
    window = 0.99 * at, 1.01 * at
    ds = gs.branches(
        model, law, "omega", window, at=at, start=row["start_state"].values, max_steps=5
    )
    assert ds["period_multiple"].values[0, 0] == 3


@pytest.mark.parametrize("at", [[], "x"])
def test_at_without_numbers_gives_one_line(at):
    with pytest.raises(gs.ModelError):
        gs.branches(gs.systems.paper_oscillator(), SOFT, "omega", (6.0, 12.0), at=at)


@pytest.mark.extended
def test_far_from_the_freeplay_cycles_approach_the_linear_flutter_speed():
    """There an eigenvalue of the section with the flap on its spring crosses the axis."""
    law = SYSTEMS.typical_section_law()

    def growth(speed):
        system = SYSTEMS.typical_section(speed)
        matrix, spring = first_order(system), np.diag([0.0, 0.0, law.K_c])
        matrix[3:6, :3] -= np.linalg.solve(system.mass, spring)
        return np.linalg.eigvals(matrix).real.max()

    flutter = brentq(growth, 22.0, 26.0, xtol=1e-10)
    start = gs.respond(SYSTEMS.typical_section(23.8), law, q_0=[1.0, 0.0, 0.0])
    ds = gs.branches(SYSTEMS.typical_section, law, "speed", (23.7, 24.5), at=23.8, start=start)
    flap = ds["x_max"].sel(coordinate="beta") / SYSTEMS.FREEPLAY
    far = ds["speed"].values[(flap > 1000.0).values]
    assert far.size > 10
    assert_allclose(far, flutter, rtol=1e-4)


# --- Curves of special points -------------------------------------------------------------------


def point(ds, kind):
    """Number of the first special point of a kind, as `gs.special_curve` counts them."""
    names = ds["special"].attrs["flag_meanings"].split()
    special = ds["special"].values[ds["special"].values > 0]
    return int(np.flatnonzero(special == names.index(kind))[0])


def test_grazes_of_a_linear_oscillator_follow_its_resonance_curve():
    ds = forced("pyvib")
    curve = gs.special_curve(ds, point(ds, "grazing"), "forcing", (0.01, 0.1))
    rate = curve["omega"].values * TURN
    stiffness = np.hypot(1.0 - rate**2, 0.05 * rate)
    assert_allclose(curve["forcing"].values, 0.1745 * stiffness, rtol=1e-8)
    assert np.ptp(rate) > 0.3
    assert int(curve["curve_kind"]) == 5
    assert not curve["special"].any()


@pytest.mark.parametrize(
    ("kind", "value"), [("fold", 1.0), ("period_doubling", -1.0), ("torus", None)]
)
def test_curves_of_two_masses_keep_their_multiplier(kind, value):
    ds = forced("two masses")
    curve = gs.special_curve(ds, point(ds, kind), "K_c", (50.0, 200.0))
    mu = multipliers(curve)
    if value is None:
        complex_ones = np.where(mu.imag != 0.0, mu, np.inf)
        apart = np.abs(np.abs(complex_ones) - 1.0).min(axis=1)
    else:
        apart = np.abs(mu - value).min(axis=1)
    assert apart.max() < 1e-7
    assert curve["K_c"].values.min() < 60.0 < 190.0 < curve["K_c"].values.max()
    # Multipliers of the bifurcation are on the unit circle; no other one may be outside.
    assert (curve["stable"] == (np.abs(mu).max(axis=1) < 1.0 + 1e-6)).all()


def hardening(F=0.3):
    """x'' + 0.1 x' + x + x³ = F cos w t, a System without contacts."""
    return duffing(gs.Harmonic(amplitude=[F]))


@cache
def hardening_folds():
    return gs.branches(hardening, {}, between=(0.1, 0.6), at=0.15)


def test_the_curve_of_folds_has_its_cusp_where_harmonic_balance_has_it():
    """There the frequency over the first harmonic has a slope whose largest value is zero."""
    curve = gs.special_curve(hardening_folds(), 0, "F", (0.01, 0.5))
    (cusp,) = np.flatnonzero(curve["special"].values == 9)
    # At a fold one multiplier is 1 and their product is below 1.
    assert (curve["stable"] == 1).all()
    at = curve.isel(step=cusp)

    def steepest(F):
        """Largest slope of the frequency over a coefficient, and the frequency there."""
        balance = HarmonicBalance(0.1, F, n=8, n_times=128)
        guess = balance.guess(at["start_state"].values, float(at["omega"]) * TURN)
        normal = np.eye(len(guess))[np.abs(guess[:-1]).argmax()]

        def orbit(s):
            return balance.on_plane(guess + s * normal, normal)

        options = {"bounds": (-0.07, 0.07), "method": "bounded", "options": {"xatol": 1e-9}}
        top = minimize_scalar(lambda s: -orbit(s)[1], **options)
        return -top.fun, orbit(top.x)[0][-1]

    truth = brentq(lambda F: steepest(F)[0], 0.045, 0.06, xtol=1e-12)
    assert float(at["F"]) == pytest.approx(truth, rel=1e-8)
    assert float(at["omega"]) * TURN == pytest.approx(steepest(truth)[1], rel=1e-8)


def test_a_closed_curve_is_stored_once():
    """The folds of an asymmetric orbit of a loose joint over its gap: a loop with two cusps."""
    joint = gs.Oscillator(mass=3.0, omega_n=5.0, zeta=0.03, alpha=7e8, forcing=4.0)
    ds, other = (
        gs.branches(
            joint,
            gs.Piecewise(1.4e4, gs.Gap(gap, gap)),
            between=(3.5, 6.0),
            at=4.6,
            starts=[[6e-4, 0.0]],
        )
        for gap in (0.4e-3, 0.39e-3)
    )
    curve = gs.special_curve(ds, point(ds, "fold"), "gap", (1e-5, 2e-3))
    reasons = curve["ends"].attrs["flag_meanings"].split()
    assert reasons[int(curve["ends"])] == reasons[int(curve["begins"])] == "closed"
    assert (curve["special"] == 9).sum() == 2
    off, omega = curve["gap"].values - 0.39e-3, curve["omega"].values
    passes = np.flatnonzero(off[:-1] * off[1:] < 0.0)
    ours = omega[passes] + off[passes] / (off[passes] - off[passes + 1]) * np.diff(omega)[passes]
    folds = other["omega"].values[other["special"].values == 1]
    assert_allclose(sorted(ours), sorted(folds), rtol=1e-3)


def stiffer(F=0.3):
    return replace(hardening(F), stiffness=[[1.01]])


def test_a_curve_of_a_reopened_file_is_that_of_the_call(tmp_path):
    ds = hardening_folds()
    ds.to_netcdf(tmp_path / "branches.nc")
    with xr.open_dataset(tmp_path / "branches.nc") as again:
        with pytest.raises(gs.ModelError, match="oscillator, law: missing"):
            gs.special_curve(again, 1, "F", (0.2, 0.4))
        with pytest.raises(gs.ModelError, match="oscillator, law: must be those"):
            gs.special_curve(again, 1, "F", (0.2, 0.4), oscillator=stiffer, law={})
        ours = gs.special_curve(again, 1, "F", (0.2, 0.4), oscillator=hardening, law={})
    expected = gs.special_curve(ds, 1, "F", (0.2, 0.4))
    assert_allclose(ours["omega"], expected["omega"], rtol=1e-12)


def test_speeds_of_folds_with_freeplay_do_not_depend_on_its_width():
    law = SYSTEMS.typical_section_law()
    start = gs.respond(SYSTEMS.typical_section(12.0), law, q_0=[0.01, 0.0, 0.0])
    ds = gs.branches(SYSTEMS.typical_section, law, "speed", (11.0, 13.0), at=12.0, start=start)
    curve = gs.special_curve(ds, point(ds, "fold"), "gap", (0.02, 0.06), max_steps=20)
    assert_allclose(curve["speed"].values, float(curve["speed"][0]), rtol=1e-9)
    # Lengths scale with the freeplay: so do all motions.
    assert_allclose(
        curve["x_max"].sel(coordinate="beta") / curve["gap"],
        float(curve["x_max"].sel(coordinate="beta")[0] / curve["gap"][0]),
        rtol=1e-7,
    )


def named(ds, kind):
    """The rows of a curve with a kind of special point."""
    names = ds["special"].attrs["flag_meanings"].split()
    return ds.isel(step=ds["special"].values == names.index(kind))


def test_folds_of_an_undamped_oscillator_are_resonances_1_1():
    """The product of both multipliers is exp(-c T): a fold without damping has both at 1."""

    def model(damping=0.1):
        return replace(hardening(), damping=[[damping]])

    ds = gs.branches(model, {}, between=(0.1, 0.6), at=0.15)
    at = named(gs.special_curve(ds, 1, "damping", (-0.05, 0.2)), "resonance_1_1").squeeze("step")
    assert float(at["damping"]) == pytest.approx(0.0, abs=1e-9)
    w = TURN * float(at["omega"])

    def rates(t, y):
        x, v = y[:2]
        slope = np.array([[0.0, 1.0], [-1.0 - 3.0 * x**2, 0.0]])
        return np.r_[v, -x - x**3 + 0.3 * np.cos(w * t), (slope @ y[2:].reshape(2, 2)).ravel()]

    start = np.r_[at["start_state"].values, np.eye(2).ravel()]
    end = solve_ivp(rates, (0.0, TURN / w), start, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    assert_allclose(end[:2], start[:2], atol=1e-8)
    assert np.trace(end[2:].reshape(2, 2)) == pytest.approx(2.0, abs=1e-6)


def mathieu(a=2.5, damping=0.02):
    """y'' + damping y' + (a - 2 cos 2t) y = 0; x is forced fast, so that time steps are short."""
    return gs.System(
        mass=np.eye(2),
        damping=np.diag([0.1, damping]),
        stiffness=np.diag([300.0, a - 1.0]),
        contacts={"y": [0.0, 1.0]},
        modulation={"y": [gs.Modulation(depth=2.0, phase=np.pi)]},
        forcing=[gs.Harmonic(amplitude=[1.0, 0.0], k=8)],
        coordinates=("x", "y"),
    )


def test_resonances_lie_at_characteristic_values_of_mathieu():
    """Without damping both multipliers of y are -1 at a_1(1) and 1 at b_2(1)."""
    law, more = gs.Piecewise(1.0, gs.Gap(0.0, 0.0)), {"starts": [[0.0] * 4], "omega": 1.0 / np.pi}
    ds = gs.branches(mathieu, law, "a", (1.2, 3.5), at=2.5, **more)
    doubled = gs.special_curve(ds, point(ds, "period_doubling"), "damping", (-0.02, 0.1))
    at = named(doubled, "resonance_1_2").squeeze("step")
    assert float(at["a"]) == pytest.approx(mathieu_a(1, 1.0), rel=1e-8)
    assert float(at["damping"]) == pytest.approx(0.0, abs=1e-7)
    ds = gs.branches(mathieu, law, "damping", (-0.02, 0.1), at=0.05, **more)
    torus = gs.special_curve(ds, point(ds, "torus"), "a", (1.2, 4.6))
    reasons = torus["ends"].attrs["flag_meanings"].split()
    assert {reasons[int(torus[name])] for name in ("begins", "ends")} == {"resonance"}
    ends = [float(named(torus, f"resonance_1_{n}")["a"].item()) for n in (2, 1)]
    assert_allclose(ends, [mathieu_a(1, 1.0), mathieu_b(2, 1.0)], rtol=1e-8)
    assert_allclose([torus["a"].min(), torus["a"].max()], ends, rtol=1e-12)


def test_points_without_a_curve_and_ranges_without_the_branch_are_refused():
    ds = forced("pyvib")
    for arguments in (
        *((99, "forcing", (0.01, 0.1)), (0, "forcing", (0.1, 0.2)), (0, "x", (1, 2))),
        ("fold", "forcing", (0.01, 0.1)),
        (0, "omega", (1.0, 2.0)),
    ):
        with pytest.raises(gs.ModelError):
            gs.special_curve(ds, *arguments)
    with pytest.raises(gs.ModelError, match=r"branches = None: must be .* gs\.branches"):
        gs.special_curve(None, 0, "forcing", (0.01, 0.1))


def test_a_branch_passes_no_kink_twice():
    """A stop 1,000 times as stiff as the spring: kinks are narrower than any step."""
    stop = gs.Piecewise(1e6, gs.Gap(1e-3, 0.6e-3), K_ratio=0.0)
    joint = gs.systems.paper_oscillator(mass=1.0, zeta=0.005, alpha=0.0, forcing=0.5, mean_load=0.1)
    ds = gs.branches(joint, stop, between=(2.5, 8.0), at=2.875, follow=1, max_steps=150)
    assert ds.attrs["n_lost"] == 0
    for number in ds.branch.values:
        orbits = rows(ds, number)
        points = orbits.isel(step=orbits.special.values > 0)
        places = np.column_stack([points.special, points.omega, 1e3 * points.start_state])
        assert len(np.unique(places.round(8), axis=0)) == len(places)


def test_a_step_jumps_over_no_kink():
    """Between 73223 and 73948 N/m a turning point leaves the wall, and the branch bends twice."""
    scene = random_branches.drawn(seed=77, number=57)
    first = {name: scene.options[name][:1] for name in ("at", "starts")}
    ds = gs.branches(scene.model, scene.law, **{**scene.options, **first})
    assert ds.attrs["n_lost"] == 0
    assert "missed graze" not in {kind for kind, _ in random_branches.faults(scene, ds)}


def test_a_branch_that_ends_at_its_range_says_so():
    stop = gs.Piecewise(4e5, gs.Gap(1e-3, 0.6e-3), K_ratio=0.0)
    joint = gs.systems.paper_oscillator(mass=1.0, zeta=0.005, alpha=0.0, forcing=0.5, mean_load=0.1)
    ds = gs.branches(joint, stop, between=(2.52, 3.0), at=2.875, follow=1)
    for end in (ds["begins"], ds["ends"]):
        reasons = dict(
            zip(end.attrs["flag_values"], end.attrs["flag_meanings"].split(), strict=True)
        )
        assert {reasons[value] for value in end.values} <= {"window", "branch_point"}


def flutter_in_two_cubic_springs(coupling):
    """Two masses with a coupling that is not symmetric: the origin has a Hopf point."""
    return gs.System(
        mass=np.eye(2),
        stiffness=[[1.0, coupling], [-coupling, 1.5]],
        damping=0.02 * np.eye(2),
        contacts={"none": [1.0, 0.0]},
        cubic=[gs.Cubic(along=[1.0, 0.0], alpha=-1.0), gs.Cubic(along=[0.0, 1.0], alpha=1.5)],
    )


def test_cycles_end_at_the_hopf_point_of_the_equilibrium():
    def growth(coupling):
        return np.linalg.eigvals(first_order(flutter_in_two_cubic_springs(coupling))).real.max()

    hopf = brentq(growth, 0.2, 0.3, xtol=1e-14)
    ds = gs.branches(
        flutter_in_two_cubic_springs,
        NO_CONTACT,
        along="coupling",
        between=(0.15, 0.4),
        at=0.3,
        starts=[[0.1, 0.1, 0.0, 0.0]],
    )
    assert ds.sizes["branch"] == 1
    branch = rows(ds, 0)
    ((kind, step),) = special_points(branch)
    assert kind == "hopf"
    assert step in (0, branch.sizes["step"] - 1)
    assert float(branch["coupling"][step]) == pytest.approx(hopf, abs=1e-8)
    assert_allclose(branch["amplitude"].values[step], 0.0, atol=1e-12)
    # Cycles exist on one side of the point.
    assert (branch["coupling"].values >= hopf - 1e-8).all()


def test_a_hopf_point_of_a_loaded_equilibrium_is_found():
    """A constant load displaces the equilibrium, so that cubic springs change its eigenvalues."""
    load = np.array([0.1, 0.05])

    def loaded(coupling):
        system = flutter_in_two_cubic_springs(coupling)
        return replace(system, forcing=[gs.Harmonic(amplitude=load, k=0)])

    def growth(coupling):
        system, cubic = flutter_in_two_cubic_springs(coupling), np.array([-1.0, 1.5])
        q = fsolve(lambda q: system.stiffness @ q + cubic * q**3 - load, [0.1, 0.05], xtol=1e-12)
        matrix = first_order(system)
        matrix[2:, :2] -= np.diag(3.0 * cubic * q**2)
        return np.linalg.eigvals(matrix).real.max()

    hopf = brentq(growth, 0.25, 0.3, xtol=1e-14)
    window = 0.8 * hopf, 1.3 * hopf
    at, starts = 1.1 * hopf, [[0.2, 0.15, 0.0, 0.0]]
    ds = gs.branches(loaded, NO_CONTACT, "coupling", window, at=at, starts=starts)
    branch = rows(ds, 0)
    (step,) = (i for kind, i in special_points(branch) if kind == "hopf")
    assert float(branch["coupling"][step]) == pytest.approx(hopf, abs=1e-8)


def test_a_coordinate_that_stands_still_does_no_harm():
    model = gs.System(
        mass=np.eye(2),
        stiffness=np.diag([30.0, 20.0]),
        damping=np.diag([0.3, 0.2]),
        contacts={"stop": [1.0, 0.0]},
        forcing=[gs.Harmonic(amplitude=[1.0, 0.0])],
    )
    wall, starts = gs.Piecewise(100.0, gs.Gap(0.02, 0.02)), np.diag([0.03, 0.01, 0.0, 0.0])
    ds = gs.branches(model, wall, between=(0.8, 1.2), at=1.0, starts=starts)
    assert ds.sizes["attractor"] == 1
    branch = rows(ds, 0)
    alone = gs.Oscillator(
        mass=1.0, omega_n=math.sqrt(30.0) / TURN, zeta=0.15 / math.sqrt(30.0), forcing=1.0
    )
    again = rows(gs.branches(alone, wall, between=(0.8, 1.2), at=1.0), 0)
    assert_allclose(branch["x_max"].max(), again["x_max"].max(), rtol=1e-3)
    assert [kind for kind, _ in special_points(branch)] == [k for k, _ in special_points(again)]


def test_a_branch_of_twice_the_period_ends_on_that_of_the_period():
    """Started on the doubled orbit, `follow` finds the orbit of one period through its end."""
    model, law, *_ = FORCED["two masses"]
    low, high = 0.745 * RATE, 0.753 * RATE
    ds = gs.branches(model, law, "omega", (low, high), at=0.749 * RATE, follow=1)
    for number in ds["branch"].values:
        branch = rows(ds, number)
        for kind, step in special_points(branch):
            if kind == "period_doubling":
                one = 1.0 if step in (0, branch.sizes["step"] - 1) else -1.0
                assert np.abs(multipliers(branch)[step] - one).min() < 1e-6


def test_a_loop_longer_than_max_steps_holds_each_orbit_once():
    law = gs.Piecewise(1.4e5, gs.Gap(0.2e-3, 0.6e-3))
    model = gs.Oscillator(mass=3.0, omega_n=5.0, zeta=0.03, forcing=4.0, alpha=7e8)
    whole = gs.branches(model, law, between=(4.0, 16.0), at=7.5)
    loops = (whole["ends"] == 2) & (whole["begins"] == 2)
    assert loops.any()
    n = int(whole["n_orbits"].where(loops, 0).max())
    half = gs.branches(model, law, between=(4.0, 16.0), at=7.5, max_steps=n // 2 + 10)
    loop = int(half["n_orbits"].values.argmax())
    assert abs(int(half["n_orbits"][loop]) - n) < 40


def _hertz(x, n):
    depth = abs(x) - 0.4e-3
    return 0.0 if depth <= 0.0 else math.copysign(1e6 * depth**n, x)


def test_branches_go_along_a_parameter_of_an_own_law():
    """Each orbit closes in the other engine, with the law at the branch's own value."""
    o = gs.Oscillator(mass=3.0, omega_n=5.0, zeta=0.03, alpha=0.0, forcing=4.0)
    law = gs.law(_hertz, 1.4e4, gs.Gap(0.4e-3, 0.4e-3), n=1.5)
    found = gs.branches(o, law, along="n", between=(1.4, 1.6), omega=9.0)
    assert_allclose([found.n.min(), found.n.max()], [1.4, 1.6])
    n, state = found.n.values[0], found.start_state.values[0]
    for step in (0, len(n) // 2):
        law = gs.law(_hertz, 1.4e4, gs.Gap(0.4e-3, 0.4e-3), n=n[step])
        given = {"engine": "scipy", "rtol": 1e-10, "atol": 1e-13}
        periods = int(found.period_multiple[0, step])
        run = gs.simulate(o, law, 9.0, *state[step], n_periods=periods, **given)
        assert_allclose([run.x_end, run.v_end], state[step], rtol=1e-5, atol=1e-8)


def _stop(x, v, c):
    return max(1.4e4 * (x - 0.4e-3) + c * v, 0.0) if x > 0.4e-3 else 0.0


def test_a_name_of_the_oscillator_and_of_an_own_law_is_no_parameter():
    o = gs.Oscillator(mass=3.0, omega_n=5.0, zeta=0.03, forcing=4.0)
    law = gs.law(_stop, 1.4e4, gs.Gap(None, 0.4e-3), c=60.0)
    named = {"oscillator": o, "law": law, "omega": 9.0}
    with pytest.raises(gs.ModelError, match=r"'c': the oscillator has one.*_stop"):
        gs.branches(**named, along="c", between=(10.0, 60.0))
    with pytest.raises(gs.ModelError, match=r"'c': the oscillator has one.*_stop"):
        gs.choose("c", (10.0, 60.0), so_that=gs.at_most("amplitude", 5e-4), **named)
    with pytest.raises(gs.ModelError, match=r"'c': the oscillator has one.*_stop"):
        Parameter("c").values(o, [law], 9.0)


def test_curves_of_grazes_end_where_the_wall_loses_its_stiffness():
    joint = gs.systems.paper_oscillator(zeta=0.05, alpha=0.0)
    found = gs.branches(joint, gs.Piecewise(1.4e3, gs.Gap(4e-3, 4e-3)), between=(3.0, 8.0))
    curve = gs.special_curve(found, 0, "K_c", (0.0, 2e4))
    assert 0.0 <= curve.K_c.min() < 10.0
    with pytest.raises(gs.ModelError, match="K_c = -10000: must be >= 0"):
        gs.special_curve(found, 0, "K_c", (-1e4, 2e4))
