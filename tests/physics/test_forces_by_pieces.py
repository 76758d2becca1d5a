"""Forces by pieces (tables, switched levels, functions, records) against other integrations."""

import math
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm
from tests.oracles.equation import Equation

import gapsweep as gs

W = 2.0 * math.pi
JOINT = gs.Piecewise(2.0, gs.Gap(0.1745, 0.1745))
OMEGA = 1.1 / W
SQUARE = [0.0, 0.25, 0.75]
FREE = gs.Piecewise(0.0, gs.Gap(1.0, 1.0))


def oscillator(force, **changes):
    return gs.Oscillator(
        **({"mass": 1.0, "omega_n": 1.0 / W, "zeta": 0.025} | changes), forcing=force
    )


def propagated(matrix, pull, knots, force, state, span):
    """State after x' = A x + b f(t) with straight lines between knots, by matrix exponentials."""
    times = np.unique([*span, *knots[(knots > span[0]) & (knots < span[1])]])
    n = len(state)
    for begin, end in pairwise(times):
        values = np.interp([begin, end], knots, force)
        step = np.zeros((n + 2, n + 2))
        step[:n, :n] = matrix
        step[:n, n], step[:n, n + 1] = pull * values[0], pull * np.diff(values)[0]
        step *= end - begin
        step[n + 1, n] = 1.0  # a clock from 0 to 1
        state = (expm(step) @ [*state, 1.0, 0.0])[:n]
    return state


class Lines(Equation):
    """The equation of motion with one force of straight lines between knots, piece by piece."""

    def __init__(self, model, law, omega, knots, force, along):
        super().__init__(model, (law,) * len(model.contacts), omega)
        self.knots, self.force, self.along = np.array(knots), np.array(force), np.array(along)

    def after(self, start, n_periods, period):
        state = np.array(start, float)
        for _ in range(n_periods):
            for i, length in enumerate(np.diff(self.knots) * period):
                slope = (self.force[i + 1] - self.force[i]) / length
                self.load = lambda t, i=i, slope=slope: np.multiply.outer(
                    self.force[i] + slope * np.asarray(t), self.along
                )
                state = self.motion(state, length)(length)
        return state


@pytest.mark.parametrize("engine", ["compiled", "scipy"])
def test_a_square_wave(engine):
    """Exact flows between contacts, in 30 digits: state, peak and monodromy of the orbit."""
    model = oscillator(gs.Switched(SQUARE, [0.03, -0.03, 0.03]))
    start, options = (0.2288499176611527, 0.1165842033228034), {"rtol": 1e-12, "engine": engine}
    run = gs.simulate(model, JOINT, OMEGA, *start, n_periods=1, tangent=True, **options)
    assert_allclose((run.x_end, run.v_end), start, rtol=1e-11)
    assert_allclose(run.extrema.max(), 0.2487583197415452, rtol=1e-11)
    assert_allclose(np.trace(run.monodromy), 0.93221718340405, rtol=1e-11)


def test_the_response_to_a_square_wave():
    model = oscillator(gs.Switched(SQUARE, [0.03, -0.03, 0.03]))
    found = gs.respond(model, JOINT, OMEGA, 0.3, rtol=1e-12)
    assert_allclose((found.x_end, found.v_end), (0.2288499176611527, 0.1165842033228034), rtol=1e-9)
    assert_allclose(found.x_max, 0.2487583197415452, rtol=1e-9)
    assert_allclose(found.multipliers.sum().real, 0.93221718340405, rtol=1e-9)


@pytest.mark.parametrize("along", ["omega", "forcing"])
def test_branches_under_a_square_wave(along):
    """Branches that end at the orbit of the exact flows; `forcing` scales the levels.

    Motions, force and gap of a piecewise linear joint grow together.
    """
    model = oscillator(gs.Switched(SQUARE, [0.03, -0.03, 0.03]))
    ends = {"omega": (0.95 * OMEGA, OMEGA), "forcing": (0.03, 0.033)}[along]
    factor, others = (1.0, {}) if along == "omega" else (1.1, {"omega": OMEGA})
    joint = gs.Piecewise(2.0, gs.Gap(0.1745 * factor, 0.1745 * factor))
    found = gs.branches(
        model,
        joint,
        along=along,
        between=ends,
        at=ends[1],
        starts=[(0.25, 0.1)],
        rtol=1e-11,
        **others,
    )
    last = np.isclose(found[along], ends[1], rtol=1e-12) & (found.x_max > 0.24)
    assert last.any()
    assert_allclose(found.x_max.to_numpy()[last], factor * 0.2487583197415452, rtol=1e-9)


def test_switched_every_two_seconds_between_stiff_stops():
    """discourse.julialang.org, "Limit stops in a spring-mass system" (2020)."""
    system = gs.System(
        mass=[[1.0]], stiffness=[[1.0]], damping=[[0.2]], contacts={"stop": [1.0]},
        forcing=[gs.Switched([0.0, 0.5], [-5.0, 5.0])],
    )  # fmt: skip
    law = gs.Piecewise(1e5, gs.Gap(3.0, 3.0))
    run = gs.simulate(system, law, 0.25, q_0=[1.0], v_0=[1.0], t_end=10.0)
    assert_allclose(run.q_end[0], -0.45295359, atol=1e-8)


@pytest.mark.parametrize("engine", ["compiled", "scipy"])
def test_a_wave_before_time_zero(engine):
    """It is periodic there, too."""
    knots, force = np.array([0.0, 0.2, 0.55, 1.0]), np.array([1.0, -2.0, 3.0, 1.0])
    model = oscillator(gs.PeriodicForce(knots, force))
    options = {"t_0": -2.6, "t_end": 1.0, "engine": engine, "rtol": 1e-12}
    run = gs.simulate(model, FREE, 0.5, 0.1, **options)
    matrix, pull = np.array([[0.0, 1.0], [-1.0, -0.05]]), np.array([0.0, 1.0])
    times = np.concatenate([2.0 * (knots[:-1] + k) for k in (-2, -1, 0, 1)])
    truth = propagated(matrix, pull, times, np.tile(force[:-1], 4), [0.1, 0.0], (-2.6, 1.0))
    assert_allclose((run.x_end, run.v_end), truth, rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("span", [(0.0, 20.0), (3.3, 17.0), (-2.0, 5.0), (15.0, 25.0)])
def test_a_record_against_matrix_exponentials(span):
    """2,000 points of noise at drawn times; before and after them the force is constant."""
    draw = np.random.default_rng(1)
    t, f = np.sort(draw.uniform(0.0, 20.0, 2000)), draw.normal(size=2000)
    model = oscillator(gs.Record(t, f))
    run = gs.simulate(model, FREE, x_0=0.1, v_0=-0.2, t_0=span[0], t_end=span[1], rtol=1e-12)
    matrix, pull = np.array([[0.0, 1.0], [-1.0, -0.05]]), np.array([0.0, 1.0])
    truth = propagated(matrix, pull, t, f, [0.1, -0.2], span)
    assert_allclose((run.x_end, run.v_end), truth, rtol=0.0, atol=1e-12)


def test_a_record_and_harmonics_on_two_masses():
    """The record has its own time, in seconds; the harmonic has the phase of the clock."""
    mass, stiffness = np.diag([1.0, 2.0]), np.array([[30.0, -10.0], [-10.0, 20.0]])
    t, f = np.array([0.5, 1.0, 1.7, 2.0]), np.array([0.0, 3.0, -1.0, 0.5])
    loads = [gs.Record(t, f, along=[1.0, -2.0]), gs.Harmonic(amplitude=[0.0, 4.0], phase=0.3)]
    system = gs.System(mass=mass, stiffness=stiffness, damping=0.01 * stiffness, forcing=loads)
    run = gs.simulate(system, {}, 1.3, q_0=[0.1, 0.0], t_0=0.2, t_end=3.0, rtol=1e-12)
    inverse = np.linalg.inv(mass)
    matrix = np.zeros((6, 6))  # with cos and sin of the harmonic
    matrix[:2, 2:4], matrix[2:4, :2], matrix[2:4, 2:4] = (
        np.eye(2),
        -inverse @ stiffness,
        -0.01 * inverse @ stiffness,
    )
    matrix[2:4, 4] = inverse @ [0.0, 4.0]
    matrix[4, 5], matrix[5, 4] = -1.3 * W, 1.3 * W
    phase = 1.3 * W * 0.2 + 0.3
    start = [0.1, 0.0, 0.0, 0.0, math.cos(phase), math.sin(phase)]
    pull = np.array([0.0, 0.0, *(inverse @ [1.0, -2.0]), 0.0, 0.0])
    truth = propagated(matrix, pull, t, f, start, (0.2, 3.0))
    assert_allclose([*run.q_end, *run.v_end], truth[:4], rtol=0.0, atol=1e-12)


def test_dense_output_sections_and_extrema():
    """A linear oscillator under a table: states between the steps, on the section, at extrema."""
    knots, force = np.array([0.0, 0.2, 0.55, 1.0]), np.array([1.0, -2.0, 3.0, 1.0])
    model = oscillator(gs.PeriodicForce(knots, force))
    run = gs.simulate(model, FREE, 0.5, 0.1, n_periods=3, dense_output=True, rtol=1e-12)
    matrix, pull = np.array([[0.0, 1.0], [-1.0, -0.05]]), np.array([0.0, 1.0])
    times = np.concatenate([2.0 * knots[:-1], 2.0 * (knots[:-1] + 1.0), 2.0 * (knots + 2.0)])
    values = np.concatenate([force[:-1], force[:-1], force])

    def truth(t):
        return propagated(matrix, pull, times, values, [0.1, 0.0], (0.0, t))

    places = np.linspace(0.1, 6.0, 13)
    found = np.array(run.sample(places)).T
    assert_allclose(found, [truth(t) for t in places], rtol=0.0, atol=1e-11)
    assert_allclose(run.t_section, [2.0, 4.0, 6.0], rtol=1e-14)
    assert_allclose(run.section, [truth(t) for t in run.t_section], rtol=0.0, atol=1e-11)
    assert run.extrema.size
    at_extrema = np.array([truth(t) for t in run.t_extrema])
    assert_allclose(at_extrema, np.stack([run.extrema, 0.0 * run.extrema], axis=1), atol=1e-11)


def test_forces_with_other_knots_add_up():
    """The linear response of two masses from rest to two forces is the sum of both responses."""
    forces = [
        gs.PeriodicForce([0.0, 0.37, 0.8], [1.0, -2.0, 3.0], along=[1.0, 0.5]),
        gs.PeriodicForce([0.0], lambda t: math.exp(math.cos(W * t)), along=[0.0, 1.0]),
    ]
    chain = np.array([[2.0, -1.0], [-1.0, 1.0]])

    def end(loads):
        system = gs.System(
            mass=np.diag([5.0, 1.0]), stiffness=90.0 * chain, damping=2.0 * chain, forcing=loads
        )
        run = gs.simulate(system, {}, 1.3, n_periods=4, rtol=1e-12)
        return np.concatenate([run.q_end, run.v_end])

    assert_allclose(end(forces), end(forces[:1]) + end(forces[1:]), rtol=0.0, atol=1e-13)


def test_runge_kutta_steps_begin_again_at_a_jump():
    """The derivative is evaluated after each jump: few steps are rejected, and the error is small.

    With the derivative from before the jump two in five steps are rejected.
    """
    model = oscillator(gs.Switched([0.0, 0.3, 0.7], [5.0, -9.0, 2.0]), omega_n=0.9, zeta=0.03)
    law = gs.Tanh(200.0, gs.Gap(0.1, 0.15), epsilon=50.0)
    run, truth = (
        gs.simulate(
            model, law, 0.7, 0.02, 0.1, n_periods=5, rtol=rtol, atol=rtol / 10, engine=engine
        )
        for rtol, engine in ((1e-9, "compiled"), (1e-12, "scipy"))
    )
    assert run.n_rejected < 0.25 * run.n_steps
    assert_allclose((run.x_end, run.v_end), (truth.x_end, truth.v_end), rtol=0.0, atol=3e-9)


def test_a_triangle_is_its_fourier_sum():
    """The linear response to every harmonic, in closed form, 2,000 of them."""
    model = oscillator(gs.PeriodicForce([0.0, 0.5], [2.0, -2.0]), zeta=0.1)
    omega, k = 0.21, np.arange(1, 4000, 2)
    w = W * omega * k
    amplitudes = 16.0 / (math.pi * k) ** 2 / (1.0 - w**2 + 0.2j * w)
    found = gs.respond(model, FREE, omega)
    assert_allclose(found.x_end, amplitudes.sum().real, rtol=1e-9)
    assert_allclose(found.v_end, (1j * w * amplitudes).sum().real, atol=1e-7)  # a slower sum


def test_a_smooth_function_is_the_harmonic():
    smooth = gs.PeriodicForce([0.0], lambda turn: 3.0 * math.cos(W * turn))
    found = [
        gs.simulate(oscillator(each), JOINT, OMEGA, 0.1, n_periods=20, rtol=1e-12).x_end
        for each in (smooth, 3.0)
    ]
    assert_allclose(*found, rtol=1e-10)


def test_kinks_of_a_function_are_its_knots():
    """A half-wave rectified sine, with jumps of the slope at .1 and .6."""

    def rectified(turn):
        return max(math.sin(W * (turn - 0.1)), 0.0)

    turns = np.linspace(0.0, 1.0, 1001)
    found = gs.PeriodicForce([0.0, 0.1, 0.6], rectified).at(turns)
    assert_allclose(found, np.maximum(np.sin(W * (turns - 0.1)), 0.0), atol=1e-12)
    with pytest.raises(gs.ModelError, match="kink"):
        gs.PeriodicForce([0.0], rectified)


LAWS = [
    gs.Piecewise(200.0, gs.Gap(0.1, 0.15)),
    gs.Piecewise(200.0, gs.Gap(0.1, 0.15), located=False),
    gs.Tanh(200.0, gs.Gap(0.1, 0.15), epsilon=50.0),
    gs.Arctan(200.0, gs.Gap(0.1, 0.15), epsilon=50.0),
    gs.LogArctan(200.0, gs.Gap(0.1, 0.15), gamma=50.0),
    gs.Polynomial(200.0, gs.Gap(0.1, 0.15), degree=7, fit_range=0.6),
    gs.RationalPolynomial(200.0, gs.Gap(0.1, 0.15), numerator=5, denominator=4, fit_range=0.6),
    gs.ForceTable([-1.0, -0.1, 0.15, 1.0], [-150.0, 0.0, 0.0, 170.0]),
]


@pytest.mark.extended
@pytest.mark.parametrize("law", LAWS, ids=lambda law: f"{type(law).__name__}-{law.K_c:g}")
@pytest.mark.parametrize("engine", ["compiled", "scipy"])
def test_a_drawn_table_in_both_engines_with_all_laws(engine, law):
    """Two periods against scipy's DOP853, begun again at every knot and at every wall."""
    draw = np.random.default_rng(7)
    knots = np.concatenate([[0.0], np.sort(draw.uniform(0.0, 1.0, 3)), [1.0]])
    force = 12.0 * draw.normal(size=5)  # the force jumps where the period ends
    model = oscillator(gs.PeriodicForce(knots, force), omega_n=0.9, zeta=0.03, alpha=30.0)
    exact = law if law in LAWS[:1] else LAWS[0] if law is LAWS[1] else law
    truth = Lines(model, exact, 0.7, knots, force, [1.0])
    static = truth.after([0.02, 0.1], 2, 1.0 / 0.7)
    run = gs.simulate(
        model, law, 0.7, 0.02, 0.1, n_periods=2, engine=engine, rtol=1e-12, atol=1e-13
    )
    atol = 1e-5 if law is LAWS[1] or isinstance(law, gs.ForceTable) else 2e-10
    assert run.status.label == "ok"
    assert_allclose((run.x_end, run.v_end), static, rtol=0.0, atol=atol)
