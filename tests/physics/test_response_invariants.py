"""Properties of every steady response: each model and contact law, by public calls."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from tests.builders.rescaled import rescaled_law, rescaled_model
from tests.builders.studies import LABELS
from tests.oracles.equation import Equation, laws_of

import gapsweep as gs
from gapsweep.model.structure import structure_of
from gapsweep.response.result import LISTS, columns_of

W = 2.0 * math.pi
SYMMETRIC, ASYMMETRIC = gs.Gap(0.4e-3, 0.4e-3), gs.Gap(0.0, 0.8e-3)
OSCILLATOR = gs.systems.paper_oscillator()
LOADED = gs.systems.paper_oscillator(mean_load=3.0, c=15.0)
GEAR = gs.systems.paper_oscillator(omega_n=0.0, alpha=0.0, mean_load=-2.0, c=20.0)
COUPLED = gs.System(
    mass=np.diag([1.0, 0.5]),
    damping=[[0.8, -0.2], [-0.2, 0.5]],
    stiffness=[[400.0, -150.0], [-150.0, 300.0]],
    contacts={"stop": [1.0, -1.0], "wall": [0.0, 1.0]},
    forcing=[gs.Harmonic(amplitude=[3.0, 1.0])],
)
HARD = {
    "stop": gs.Piecewise(2e3, gs.Gap(1e-3, 2e-3)),
    "wall": gs.Piecewise(2e3, gs.Gap(5e-3, 5e-3)),
}
ROUND = {name: gs.Tanh(law.K_c, law.gap, 3e3) for name, law in HARD.items()}
LAGGING = gs.System(
    mass=[[1.0]],
    damping=[[0.5]],
    stiffness=[[400.0]],
    contacts={"stop": [1.0]},
    forcing=[gs.Harmonic(amplitude=[2.0])],
    lags=gs.Lags([[30.0]], [[0.0]], [[1.0]], [[-8.0]]),
)
# Circulatory springs make two masses flutter; the stop and cubic springs bound it.
FLUTTERING = gs.System(
    mass=np.eye(2),
    damping=0.3 * np.eye(2),
    stiffness=[[100.0, 25.0], [-25.0, 110.0]],
    cubic=[gs.Cubic(along=[1.0, 0.0], alpha=4e4), gs.Cubic(along=[0.0, 1.0], alpha=1e4)],
    contacts={"stop": [1.0, 0.0]},
)
SECTION = gs.systems.typical_section(12.36842, "conner-scaled")
FLAP = gs.systems.typical_section_law("conner-scaled")


@dataclass(frozen=True, eq=False)
class Case:
    """Responses of a model over forcing frequencies [Hz], or without forcing."""

    model: Any
    law: Any
    omega: Any = (9.0, 12.0, 20.0)
    start: Any = None

    def respond(self, which=slice(None), **options):
        omega = None if self.omega is None else np.array(self.omega)[which]
        return gs.respond(self.model, self.law, omega, **((self.start or {}) | options))

    @property
    def laws(self):
        return laws_of(self.model, self.law)

    @cached_property
    def orbits(self):
        """Period [s], forcing frequency [Hz], state and response of each periodic one."""
        return [self.orbit(k) for k in range(len(self.omega or [None]))]

    def orbit(self, k):
        at = () if self.omega is None else k
        found = self.respond(at, rtol=1e-11, atol=1e-14)
        assert found.response_class is gs.ResponseClass.PERIODIC
        omega = self.omega and self.omega[k]
        period = found.period_multiple / omega if omega else found.period
        n_points = found.period_multiple
        return period, omega, np.reshape(found.section, (n_points, -1))[-1], found


CASES = {
    **{label: Case(OSCILLATOR, gs.contact_law(label, 1.4e4, SYMMETRIC)) for label in LABELS},
    **{
        f"{label}, one-sided": Case(OSCILLATOR, gs.contact_law(label, 1.4e4, ASYMMETRIC))
        for label in LABELS
    },
    "hard": Case(OSCILLATOR, gs.Piecewise(1.4e6, ASYMMETRIC), [7.0, 21.75]),
    "sharp": Case(OSCILLATOR, gs.LogArctan(1.4e4, gs.Gap(1e-4, 6e-4), 1e5), [9.0]),
    "softer below": Case(OSCILLATOR, gs.Piecewise(1.4e4, gs.Gap(2e-4, 5e-4), K_ratio=0.2)),
    "harder below": Case(OSCILLATOR, gs.Piecewise(1.4e4, gs.Gap(2e-4, 5e-4), K_ratio=5.0)),
    "loaded": Case(LOADED, gs.Piecewise(2e4, gs.Gap(3e-4, 6e-4)), [7.5, 8.0, 10.0]),
    "loaded tanh": Case(LOADED, gs.Tanh(2e4, gs.Gap(3e-4, 6e-4), 2e4), [7.5, 8.0, 10.0]),
    "gear": Case(GEAR, gs.Piecewise(1e5, gs.Gap(1e-4, 1e-4)), [20.0, 24.0]),
    "coupled": Case(COUPLED, HARD, [2.2, 3.5, 5.5]),
    "coupled tanh": Case(COUPLED, ROUND, [2.0, 4.0, 5.5]),
    "lagging": Case(LAGGING, gs.Piecewise(3e3, gs.Gap(1e-3, 1e-3)), [2.0, 4.0, 7.0]),
    "two masses": Case(
        gs.systems.two_masses(), gs.systems.two_masses_law(), [0.635 / W], {"q_0": [0.95, 0.6]}
    ),
    "fluttering": Case(
        FLUTTERING, gs.Piecewise(2e3, gs.Gap(5e-3, 6e-3)), None, {"q_0": [1e-3, 0.0]}
    ),
    "section": Case(SECTION, FLAP, None, {"q_0": [0.01, 0.0, 0.0]}),
    "section tanh": Case(
        SECTION, gs.Tanh(FLAP.K_c, FLAP.gap, 2e3), None, {"q_0": [0.01, 0.0, 0.0]}
    ),
}  # fmt: skip


# These share their kernels with other tests.
COMMON = ("piecewise", "tanh-1e4", "poly-13", "hard", "coupled")


def params(names, common=COMMON):
    """Names of cases for a test; the test is extended with all that are not common."""
    return [
        pytest.param(name, marks=() if name in common else pytest.mark.extended) for name in names
    ]


@pytest.fixture(params=params(CASES))
def case(request):
    return CASES[request.param]


def test_orbits_are_those_of_the_equation(case):
    """Ends, extrema, forces and time in contact, by an independent integrator."""
    for period, omega, start, found in case.orbits:
        equation, n = Equation(case.model, case.laws, omega), case.model.n
        truth = equation.motion(start, period)
        t = np.sort(np.concatenate([np.linspace(0.0, period, 4001), *truth.t_extrema]))
        states = np.array([truth(each) for each in t])
        size = np.abs(states).max(axis=0)
        assert np.abs((states[-1] - start) / size).max() < 1e-6
        assert_allclose(np.ravel(found.x_end), start[:n])
        assert_allclose(np.ravel(found.v_end), start[n : 2 * n])
        for i in range(n):
            turns = truth.extrema[i]
            if case.omega:
                assert np.ravel(found.n_extrema)[i] == len(turns)
            elif (
                i == 0
            ):  # a section point is a maximum: that at an end may be on either side, or both
                if np.isclose(turns[0], turns[-1], rtol=1e-9):
                    turns = turns[:-1]
                n_maxima = np.sum(np.diff(np.append(turns, turns[:2])) < 0.0)
                assert abs(n_maxima - found.period_multiple) <= 1
            assert_allclose(np.ravel(found.x_max)[i], turns.max(), atol=1e-7 * size[i])
            assert_allclose(np.ravel(found.x_min)[i], turns.min(), atol=1e-7 * size[i])
        for i, (b, law) in enumerate(zip(equation.directions, case.laws, strict=True)):
            gap = states[:, :n] @ b
            if hasattr(found, "contact_x_max") and n * len(case.laws) > 1:
                assert_allclose(np.ravel(found.contact_x_max)[i], gap.max(), rtol=1e-5)
                assert_allclose(np.ravel(found.contact_x_min)[i], gap.min(), rtol=1e-5)
            force, share = np.ravel(found.force_max)[i], np.ravel(found.contact_share)[i]
            assert_allclose(force, np.abs(law.force(gap)).max(), rtol=1e-5)
            ends = np.array([0.0, *truth.t_contacts[i], period])
            inside = np.array([truth(each)[:n] @ b for each in 0.5 * (ends[1:] + ends[:-1])])
            beyond = (inside > law.walls[1]) | (inside < law.walls[0])
            assert_allclose(share, np.diff(ends)[beyond].sum() / period, atol=1e-6)


def states(model, start):
    """A state as arguments of calls."""
    if isinstance(model, gs.Oscillator):
        return {"x_0": start[0], "v_0": start[1]}
    n = model.n
    return {"q_0": start[:n], "v_0": start[n : 2 * n], "z_0": start[2 * n :]}


def test_multipliers_are_those_of_the_tangent_along_the_orbit(case):
    law = case.law
    if isinstance(law, gs.Piecewise):  # a tangent sees kinks that are not located a step late
        law = replace(law, located=True)
    for period, omega, start, found in case.orbits:
        how = {"t_end": period, "rtol": 1e-11, "atol": 1e-14, "tangent": True}
        run = gs.simulate(case.model, law, omega, **states(case.model, start), **how)
        multipliers = found.multipliers
        assert multipliers.dtype == complex
        assert multipliers.shape == (case.model.n_states - (not case.omega),)
        assert (np.diff(np.abs(multipliers)) <= 1e-12).all()
        trace = Equation(case.model, case.laws, omega).trace
        assert_allclose(np.prod(multipliers), math.exp(trace * period), rtol=1e-6, atol=1e-12)
        along = [] if case.omega else [1.0]
        expected = np.poly(run.monodromy)
        assert_allclose(np.poly([*multipliers, *along]), expected, rtol=1e-4, atol=1e-6)
        assert found.multiplier_abs == abs(multipliers[0]) < 1.0
        assert_allclose(found.lyapunov, math.log(abs(multipliers[0])) / period)


# Of walls at unequal distances: those of "sharp", "softer below", "loaded".
@pytest.mark.parametrize("case", params(n for n in CASES if "one-sided" not in n), indirect=True)
def test_scipy_finds_the_same_response(case):
    _, omega, start, found = case.orbits[0]
    how = {"engine": "scipy", "rtol": 1e-9, "atol": 1e-12}
    other = gs.respond(case.model, case.law, omega, **states(case.model, start), **how)
    assert other.response_class is found.response_class
    assert other.period_multiple == found.period_multiple
    assert_array_equal(other.n_extrema, found.n_extrema)
    size = np.abs([found.x_max, found.x_min]).max(axis=0)
    for name in ("x_max", "x_min"):
        assert (np.abs(getattr(other, name) - getattr(found, name)) < 3e-6 * size).all()
    for name in ("force_max", "contact_share"):
        assert_allclose(getattr(other, name), getattr(found, name), rtol=1e-3)


@pytest.mark.parametrize("rtol", [None, 1e-4])
def test_lengths_by_powers_of_two_change_no_bit(case, rtol):
    """Nothing has a length of its own: default tolerances and thresholds follow the problem."""
    length = 2.0**-20
    laws = [rescaled_law(law, 1.0, length, 1.0) for law in case.laws]
    law = dict(zip(case.law, laws, strict=True)) if isinstance(case.law, dict) else laws[0]
    start = {name: np.array(value) * length for name, value in (case.start or {}).items()}
    other = replace(case, model=rescaled_model(case.model, 1.0, length, 1.0), law=law, start=start)
    which = slice(1) if case.omega else ()
    ours, theirs = case.respond(which, rtol=rtol), other.respond(which, rtol=rtol)
    for name in ("x_max", "x_end", "v_end", "noise", "atol"):
        assert_array_equal(getattr(theirs, name), getattr(ours, name) * length)
    for name in ("response_class", "period_multiple", "multiplier_abs", "n_steps", "lyapunov"):
        assert_array_equal(getattr(theirs, name), getattr(ours, name))


def test_a_response_is_the_same_in_any_company(case):
    names = [*columns_of(structure_of(case.model)), *LISTS]
    if case.omega is None:
        which = np.multiply.outer([0.7, 1.0, 1.2], case.start["q_0"])
        together, backwards = (case.respond((), q_0=each) for each in (which, which[::-1]))
        alone = [case.respond((), q_0=each) for each in which]
    else:
        together, backwards = case.respond(), case.respond(slice(None, None, -1))
        alone = [case.respond(k) for k in range(len(case.omega))]
    for name in {*names} - {"cpu_time"}:
        for k, one in enumerate(alone):
            for other in (getattr(together, name)[k], getattr(backwards, name)[-1 - k]):
                assert_array_equal(other, getattr(one, name), err_msg=name)
