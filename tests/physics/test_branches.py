"""Branches of periodic orbits against closed forms, harmonic balance and exact propagation."""

from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq, minimize_scalar
from tests.exact_orbits import (
    TURN,
    Exact,
    exact_system,
    located,
    multipliers,
    rows,
    special_points,
    trilinear,
    trilinear_guess,
    unexplained,
)

import gapsweep as gs

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
