"""Steady responses: closed forms, energy balance, period multiples, outcomes."""

import math
import re
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from tests.builders.studies import LABELS
from tests.oracles.section_points import parts

import gapsweep as gs
from gapsweep.integrate.problem import Solver
from gapsweep.model.systems import paper_oscillator
from gapsweep.response.lyapunov import LyapunovExponents
from gapsweep.response.respond import respond_all
from gapsweep.response.scene import Scene
from gapsweep.response.section import likely_multiple, period_multiple
from gapsweep.response.shooting import NewtonShooting, floquet_multipliers, newton_steps
from gapsweep.status import Status

SYMMETRIC, ASYMMETRIC = gs.Gap(0.4e-3, 0.4e-3), gs.Gap(0.0, 0.8e-3)
TIGHT = {"engine": "scipy", "rtol": 1e-8, "atol": 1e-12}


def test_a_time_limit_ends_motions_and_says_so():
    o = gs.Oscillator(zeta=1e-7, omega_n=1.0, mass=1.0, alpha=0.3, forcing=0.1)
    law, begin = gs.Piecewise(10.0, gs.Gap(0.1, 0.1)), time.monotonic()
    found = gs.respond(o, law, [0.1, 1.0, 3.7], 0.5, time_limit=0.3)
    assert time.monotonic() - begin < 60.0
    assert Status.TIMED_OUT in {*found.status}
    assert all("timed_out" in text for text in found.message[found.status == Status.TIMED_OUT])
    n_periods = [3, 10**8, 10**8]
    runs = gs.simulate(o, law, 1.0, 0.5, n_periods=n_periods, time_limit=0.3)
    assert [*runs.status] == [Status.OK, Status.TIMED_OUT, Status.TIMED_OUT]
    whole = gs.simulate(o, law, 1.0, 0.5, n_periods=3)
    assert (runs.x_end[0], runs.v_end[0]) == (whole.x_end, whole.v_end)
    assert gs.respond(gs.systems.paper_oscillator(), law, 9.0).status is Status.OK, (
        "the limit is of one call"
    )


def test_autonomous_motions_that_are_not_begun_in_time_have_timed_out():
    springs = [gs.Cubic(along=[1.0], alpha=1.0)]
    matrices = {"mass": [[1.0]], "stiffness": [[1.0]], "damping": [[-1e-5]]}
    system = gs.System(**matrices, contacts={"a": [1.0]}, cubic=springs)
    starts = np.linspace(0.1, 1.0, 200)[:, None]
    found = gs.respond(system, gs.Piecewise(1.0, gs.Gap(0.1, 0.1)), q_0=starts, time_limit=1e-3)
    assert {*found.status} == {Status.TIMED_OUT}


@pytest.mark.extended
def test_a_slow_law_of_a_user_ends_soon_after_its_time_limit():
    def slow(x):
        for _ in range(1000):
            x = math.sin(x)
        return 0.0 * x

    law = gs.law(slow, K_c=0.0, gap=SYMMETRIC)
    assert gs.simulate(paper_oscillator(), law, 9.0, n_periods=1).status is Status.OK  # compiles
    begin = time.thread_time()
    run = gs.simulate(paper_oscillator(), law, 9.0, n_periods=10**6, time_limit=0.1)
    assert run.status is Status.TIMED_OUT
    assert time.thread_time() - begin < 10.0


@pytest.mark.extended
@pytest.mark.parametrize("engine", ["compiled", "scipy"])
def test_where_a_force_is_no_number_the_model_is_invalid(engine):
    def undefined(x, far):
        return math.nan if x > 5e-4 else (math.inf if x < -far else -1e9 * x * abs(x))

    # Beyond 5e-4 m no number; left of -far infinite; a spring that pushes outwards diverges.
    laws = [gs.law(undefined, K_c=0.0, gap=SYMMETRIC, far=far) for far in (5e-4, 1e9)]
    found = gs.respond(paper_oscillator(alpha=0.0), laws, 9.0, [4e-4, -0.1], engine=engine)
    assert [*found.status] == [Status.MODEL_INVALID, Status.DIVERGED]
    assert "force" in found.message[0]
    assert "force" not in found.message[1]


def rooted(x):
    return 1.4e4 * x * math.sqrt(1e-4 - abs(x))


def raised(x):
    return 1.4e4 * x * (1e-4 - abs(x)) ** 0.5


def divided(x):
    return 1.4e4 * x / (0.0 if abs(x) > 1e-4 else 1.0)


@pytest.mark.parametrize("atol", [None, 1e-9])  # a default tolerance calls the law, too
@pytest.mark.parametrize("engine", ["compiled", "scipy"])
@pytest.mark.parametrize("function", [rooted, raised, divided])
def test_where_arithmetic_has_no_result_the_model_is_invalid(function, engine, atol):
    """Python raises an exception or returns a complex number where compiled code has NaN."""
    law = gs.law(function, K_c=0.0, gap=SYMMETRIC)
    found = gs.respond(paper_oscillator(), law, 9.0, engine=engine, atol=atol)
    assert found.status is Status.MODEL_INVALID
    assert "force" in found.message


def at_rest_only(x):
    return 0.0 if x == 0.0 else 1.0 / 0.0


def below_rest_only(x):
    return math.sqrt(-x) - 1.4e4 * x


@pytest.mark.parametrize("rtol", [1e-4, 1e-9])  # both methods of scipy
@pytest.mark.parametrize("engine", ["compiled", "scipy"])
@pytest.mark.parametrize("function", [at_rest_only, below_rest_only])
def test_a_force_that_is_undefined_next_to_the_first_state_ends_the_motion(function, engine, rtol):
    """Steps of scipy are limited by the rounding of the time, which is zero here."""
    law = gs.law(function, K_c=0.0, gap=SYMMETRIC)
    how = {"engine": engine, "rtol": rtol, "time_limit": 20.0}
    found = gs.respond(paper_oscillator(), law, 9.0, **how)
    assert found.status is Status.MODEL_INVALID


@pytest.mark.parametrize("time_limit", [0.0, -1.0, math.nan, "1"])
def test_a_time_limit_is_a_time(time_limit):
    for call in (gs.respond, partial(gs.simulate, t_end=1.0, dense_output=True)):
        with pytest.raises(gs.ModelError, match="time_limit = "):
            call(
                gs.systems.paper_oscillator(),
                gs.Piecewise(1.0, SYMMETRIC),
                9.0,
                time_limit=time_limit,
            )


def test_linear_oscillator_reaches_its_closed_form_amplitude():
    oscillator = paper_oscillator(alpha=0.0)
    response = gs.respond(oscillator, gs.Piecewise(0.0, SYMMETRIC), 7.0, **TIGHT)
    r = 7.0 / oscillator.omega_n
    static = oscillator.forcing / (oscillator.mass * oscillator.omega_n_rad**2)
    expected = static / math.hypot(1 - r**2, 2 * oscillator.zeta * r)
    assert response.status is gs.Status.OK
    assert response.period_multiple == 1
    assert response.n_extrema == 2
    assert_allclose(response.amplitude, expected, rtol=2e-6)


@pytest.mark.parametrize(("omega", "rtol"), [(500.0, 1e-6), (2000.0, 1e-6), (2000.0, 1e-9)])
def test_an_orbit_is_found_where_a_period_hardly_contracts(omega, rtol):
    # Ends that meet to the solver's noise are no orbit's: it is 1 / |1 - multiplier| times as far.
    oscillator = paper_oscillator(alpha=0.0)
    # The amplitude is 8e-9 m at 2,000 Hz: an absolute tolerance of 1e-9 m says nothing of it.
    found = gs.respond(
        oscillator, gs.Piecewise(1e4, SYMMETRIC), omega, 1e-4, rtol=rtol, atol=1e-4 * rtol
    )
    stiffness = oscillator.mass * oscillator.omega_n_rad**2
    r = omega / oscillator.omega_n
    amplitude = oscillator.forcing / stiffness / math.hypot(1 - r * r, 2 * oscillator.zeta * r)
    assert found.period_multiple == 1
    assert_allclose([found.x_max, -found.x_min], amplitude, rtol=2e-2)


def test_an_exponent_is_growth_per_time_however_long_returns_take():
    rng, growths = np.random.default_rng(4), LyapunovExponents(2, 1)
    n, time = growths.n_least, rng.uniform(0.5, 3.0, growths.n_least)
    logs = rng.normal(
        0.3, 0.1, n
    )  # whatever time they take: the mean of rates is 1.4 times as much
    point, one = np.array([0]), np.ones(1)
    growths.start(point, np.zeros((2, 1)), one, one, np.array([1.0 * n]))
    blocks = SimpleNamespace(
        is_ok=np.ones(n, bool), status=np.zeros(n, int), y=np.zeros((2, n)), omega=1.0 / time,
        monodromy=np.exp(logs)[:, None, None] * np.eye(2), is_sound=np.ones(n, bool),
    )  # fmt: skip
    growths.step(point, n, blocks)
    (found,), (error,) = growths.exponents(point)
    assert found == pytest.approx(logs[1:].sum() / time[1:].sum())  # the first one aligns
    # What overflows and then shrinks to nothing grew by no number, without a word.
    growths.start(point, np.zeros((2, 1)), one, one, np.array([1.0 * n]))
    with np.errstate(all="ignore"):
        blocks.monodromy = np.exp(np.where(np.arange(n) % 2, 1e3, -1e3))[:, None, None] * np.eye(2)
    growths.step(point, n, blocks)
    assert np.isnan(growths.exponents(point)[0]).all()
    # As a sample of such ratios scatters.
    drawn = np.random.default_rng(5)
    ratios = [
        drawn.normal(0.3, 0.1, 60).sum() / drawn.uniform(0.5, 3.0, 60).sum() for _ in range(999)
    ]
    assert 0.5 < error / np.std(ratios) < 2.0


def test_newton_goes_on_while_ends_still_come_nearer():
    """Where multipliers nearly turn once in a shot, ends meet far away from the orbit."""
    shots, point, noise = NewtonShooting(2, 1, 2), np.array([0]), 5e-5
    nowhere = np.zeros((2, 1))
    shots.start(point, nowhere, np.ones(1, int), *np.array([[1e-9], [noise], [1.0]]))

    def shot(missed, length):
        """Whether an orbit is found where ends are so far apart and Newton's step is so long."""
        one = np.ones(1, bool)
        call = SimpleNamespace(
            y=shots.y + np.array([[missed], [0.0]]), unit=np.ones((2, 1)), is_ok=one, is_sound=one,
            monodromy=(1.0 - missed / length) * np.eye(2)[None], swing=np.array([np.inf]),
            determinant=np.array([(1.0 - missed / length) ** 2]), omega=np.ones(1),
            section=nowhere, period_ends=np.array([0, 1]),
        )  # fmt: skip
        (is_found,), (is_lost,) = shots.step(point, call)
        assert not is_lost
        return is_found

    assert not shot(3e-3, 1.5e-3)
    assert not shot(2e-5, 1.2e-3)  # within the noise, but a hundred times nearer than before
    assert shot(1.8e-5, 1.1e-3)


def test_slow_orbits_of_any_multiple_are_their_own():
    """Their windows hold whole periods of three, of which 64 is no multiple."""
    oscillator, omega = (
        paper_oscillator(zeta=0.0032, forcing=3.75),
        np.array([17.925, 18.025, 18.325]),
    )
    law = gs.Piecewise(5900.0, gs.Gap(0.1e-3, 0.5e-3))
    found = gs.respond(oscillator, law, omega, x_0=-1e-3, v_0=-0.05)
    assert found.period_multiple.tolist() == [3, 3, 3]
    assert (found.multiplier_abs > 0.98).all()
    # As it is told without the limit of a window: for as many periods, the section repeats itself.
    late = gs.simulate(oscillator, law, omega, x_0=-1e-3, v_0=-0.05, t_end=4000.0 / 17.9)
    for each, orbit in zip(late.section, found.x_end, strict=True):
        places = np.sort(np.array(each)[-3:, 0])
        assert np.abs(places - orbit).min() < 1e-9


@pytest.mark.parametrize("n_periods", [64, 66])
def test_a_slow_orbit_that_a_solver_rattles_is_waited_for_once(n_periods):
    """About it noise adds up to more than the solver's own: it comes no nearer, however long."""
    rng = np.random.default_rng(77)
    for _ in range(7):
        zeta, forcing = 10.0 ** rng.uniform(-3.3, -2.0), rng.uniform(1.0, 5.0)
        K_c, gap = 10.0 ** rng.uniform(3.0, 5.0), gs.Gap(*rng.uniform(0.0, 1e-3, 2))
        omega, rtol = np.sort(rng.uniform(4.0, 25.0, 12)), 10.0 ** -rng.choice([5, 6, 9])
        x_0, v_0 = rng.uniform(-1e-3, 1e-3), rng.uniform(-0.06, 0.06)
    oscillator, law = paper_oscillator(zeta=zeta, forcing=forcing), gs.Tanh(K_c, gap, epsilon=3e4)
    given = {"omega": omega, "x_0": x_0, "v_0": v_0, "rtol": rtol, "atol": 1e-3 * rtol}
    steady = gs.Steady(n_periods=n_periods)
    found = gs.respond(oscillator, law, **given, steady=steady)
    longest = steady.max_decay_times / oscillator.decay_rate * omega
    assert (found.t_simulated * omega < 4.0 * np.maximum(longest, steady.max_periods)).all()


def test_long_lists_of_extrema_are_cut_and_counted():
    steady = gs.Steady(settle_tol=1e-3, t_max=8.0, max_extrema=20)
    law = gs.Piecewise(1.4e4, gs.Gap(0.0, 0.8e-3))
    response = gs.respond(paper_oscillator(), law, 14.0, steady=steady)
    assert response.period_multiple == 0
    assert response.n_extrema > len(response.extrema) == len(response.extremum_kind) == 20


@pytest.mark.parametrize(
    ("zeta", "omega", "t_max"),
    [(1e-3, 9.0, 50.0), (3e-3, 9.0, 20.0), (1e-4, 2.0, 600.0), (2e-4, 0.05, 400.0)],
)
def test_a_motion_that_never_settles_is_watched_no_longer_than_said(zeta, omega, t_max):
    law, steady = gs.Piecewise(1e5, gs.Gap(0.4e-3, 0.1e-3)), gs.Steady(t_max=t_max)
    found = gs.respond(paper_oscillator(zeta=zeta, forcing=2.0), law, omega, steady=steady)
    assert found.response_class == gs.ResponseClass.UNRESOLVED
    assert found.t_settled <= t_max + steady.n_periods / omega


def test_slow_forcing_takes_no_more_periods_than_said_and_are_shown():
    law, steady = gs.Piecewise(1e5, gs.Gap(0.4e-3, 0.1e-3)), gs.Steady(t_max=20.0)
    found = gs.respond(paper_oscillator(zeta=0.03, forcing=2.0), law, omega=0.02, steady=steady)
    assert found.t_settled * 0.02 <= 20.0 * 0.02 + steady.n_periods + 10  # first looks are short


def test_light_damping_is_never_called_settled():
    oscillator = paper_oscillator(zeta=1e-5, alpha=0.0)
    steady = gs.Steady(t_max=2.0)
    response = gs.respond(oscillator, gs.Piecewise(0.0, SYMMETRIC), 5.0, steady=steady, **TIGHT)
    assert response.status is gs.Status.UNRESOLVED
    assert response.response_class is gs.ResponseClass.UNRESOLVED


def test_any_number_of_looks_may_be_taken():
    # Chaos at hard contact, and a settling time that takes more looks than doublings fit a number.
    steady = gs.Steady(settle_tol=1e-50, n_periods=2, max_period_multiple=1)
    response = gs.respond(paper_oscillator(), gs.Piecewise(1.4e6, ASYMMETRIC), 11.0, steady=steady)
    assert response.t_simulated > math.log(1e50) / paper_oscillator().decay_rate


def test_a_motion_without_damping_names_the_damping_of_its_model():
    ends, law, given = gs.Steady(max_periods=60), gs.Piecewise(1.0, gs.Gap(0.5, 0.5)), 0.11
    held = gs.Oscillator(mass=1.0, omega_n=0.16, zeta=0.0, forcing=0.3)
    found = gs.respond(held, law, given, steady=ends)
    assert found.status is Status.UNRESOLVED
    assert "zeta" in found.message
    stiffness, push = [[2.0, -1.0], [-1.0, 1.0]], gs.Harmonic(amplitude=[0.3, 0.0])
    matrices = {"mass": np.eye(2), "stiffness": stiffness, "contacts": {"a": [1.0, 0.0]}}
    found = gs.respond(gs.System(**matrices, forcing=[push]), law, given, steady=ends)
    assert found.status is Status.UNRESOLVED
    assert "zeta" not in found.message
    remedy = re.search(r"damping = (.*)", found.message).group(1)
    damped = gs.System(**matrices, forcing=[push], damping=eval(remedy, {"np": np}))
    assert gs.respond(damped, law, given).status is Status.OK


def test_response_that_leaves_the_fitted_range_keeps_its_values():
    law = gs.Polynomial(1.4e4, SYMMETRIC, degree=3, fit_range=1e-3)
    response = gs.respond(paper_oscillator(), law, 10.0, **TIGHT)
    assert response.x_max > law.fit_range
    assert response.status is gs.Status.OUT_OF_FIT_RANGE


def test_run_away_beyond_the_fitted_range_is_told_from_divergence():
    softening = paper_oscillator(alpha=-7e8)
    fitted = gs.Polynomial(0.0, SYMMETRIC, degree=3)
    exact = gs.Piecewise(0.0, SYMMETRIC)
    outcomes = [gs.respond(softening, law, 5.0, x_0=5e-3).status for law in (fitted, exact)]
    assert outcomes == [gs.Status.OUT_OF_FIT_RANGE, gs.Status.DIVERGED]


def test_cost_counts_the_whole_point():
    steady = gs.Steady(settle_tol=1e-2, n_periods=16, max_period_multiple=8)
    law = gs.Piecewise(1.4e4, SYMMETRIC)
    response = gs.respond(paper_oscillator(), law, 9.0, steady=steady, **TIGHT)
    settled = gs.simulate(paper_oscillator(), law, 9.0, t_end=response.t_settled, **TIGHT)
    assert response.nfev > settled.nfev
    assert response.n_contacts > settled.n_contacts


@pytest.mark.parametrize("label", ["piecewise", "piecewise-noevents", "tanh-1e6"])
def test_chaos_is_the_same_alone_and_beside_more_than_one_call_takes(label):
    law, omega = gs.contact_law(label, 1.4e6, SYMMETRIC), np.linspace(1.5, 4.0, 400)
    options = {"rtol": 1e-5, "atol": 1e-8}
    together = gs.respond(paper_oscillator(), law, omega, **options)
    chaotic = np.flatnonzero(together.response_class == gs.ResponseClass.CHAOTIC)
    assert len(chaotic) > 268  # whose growths one call takes
    for i in chaotic[[0, 150, -1]].tolist():
        alone = gs.respond(paper_oscillator(), law, float(omega[i]), **options)
        assert alone.lyapunov == together.lyapunov[i] > 0.0
        assert (alone.x_max, alone.t_simulated) == (together.x_max[i], together.t_simulated[i])


def test_a_response_is_the_same_alone_and_in_any_company():
    asymmetric = gs.Gap(0.0, 0.8e-3)
    laws = [
        *(gs.Piecewise(K_c, gap) for K_c in (1.4e4, 1.4e6) for gap in (SYMMETRIC, asymmetric)),
        gs.Piecewise(1.4e4, SYMMETRIC, located=False),
        gs.Tanh(1.4e4, asymmetric, 1e4),
        gs.Polynomial(1.4e4, SYMMETRIC, degree=3, fit_range=1e-3),
        gs.Polynomial(1.4e5, SYMMETRIC, degree=3, fit_range=1e-3),
        *(
            gs.contact_law(label, 1.4e4, gs.Gap(0.2e-3, 0.5e-3), K_ratio=K_ratio)
            for label in ("piecewise", "piecewise-noevents", *LABELS[4:])
            for K_ratio in (1.0, 0.2, 0.0, 5.0)
        ),
    ]
    steady = gs.Steady(settle_tol=1e-2, max_decay_times=6.0)
    softening = paper_oscillator(alpha=-7e8)
    points = [(paper_oscillator(), law, omega, (0.0, 0.0)) for omega in (7.0, 14.0) for law in laws]
    points.append((softening, laws[0], 5.0, (5e-3, 0.0)))
    points.append((paper_oscillator(zeta=0.0), laws[0], 7.3, (0.0, 0.0)))  # without end
    scenes = [
        Scene(oscillator=oscillator, law=law, omega=omega, solver=Solver.of())
        for oscillator, law, omega, _ in points
    ]
    starts = [start for *_, start in points]
    together = respond_all(scenes[::-1], starts[::-1], steady).rows()[::-1]
    alone = [
        respond_all([scene], start, steady).row(0)
        for scene, start in zip(scenes, starts, strict=True)
    ]
    assert [repr(replace(r, cpu_time=0.0)) for r in together] == [
        repr(replace(r, cpu_time=0.0)) for r in alone
    ]
    of_systems = {gs.ResponseClass.QUASIPERIODIC, gs.ResponseClass.EQUILIBRIUM}
    kinds = {response.response_class for response in alone}
    assert kinds == set(gs.ResponseClass) - of_systems
    assert all(response.cpu_time > 0.0 for response in together)


def test_every_point_has_its_own_solver():
    scenes = [
        Scene(oscillator=paper_oscillator(), law=gs.Piecewise(1.4e4, SYMMETRIC), omega=9.0,
              solver=Solver.of(rtol=rtol, atol=1e-3 * rtol))
        for rtol in (1e-4, 1e-9)
    ]  # fmt: skip
    loose, tight = respond_all(scenes, (0.0, 0.0), gs.Steady()).rows()
    assert loose.noise > 1e3 * tight.noise


def test_arrays_of_points_give_arrays_of_what_each_gives_alone():
    law, steady = gs.Piecewise(1.4e6, gs.Gap(0.0, 0.8e-3)), gs.Steady(settle_tol=1e-2)
    omega, x_0 = np.array([[7.0], [21.75], [14.0]]), [0.0, 1e-4]
    together = gs.respond(paper_oscillator(), law, omega, x_0, steady=steady)
    for i, j in np.ndindex(3, 2):
        alone = gs.respond(paper_oscillator(), law, omega[i, 0], x_0[j], steady=steady)
        for field in fields(gs.Response):
            if field.name == "inputs":
                continue
            value = getattr(together, field.name)
            assert value.shape[:2] == (3, 2), field.name
            if field.name != "cpu_time":
                assert_array_equal(value[i, j], getattr(alone, field.name), field.name)
    assert together.period_multiple.dtype.kind == "i"
    assert np.isfinite([together.x_end, together.v_end]).all()
    assert gs.respond(paper_oscillator(), law, [9.0], steady=steady).x_max.shape == (1,)


def test_scipy_records_only_what_is_asked_for():
    law, steady = gs.Piecewise(1.4e4, SYMMETRIC), gs.Steady(settle_tol=1e-2, max_decay_times=6.0)
    tolerances = {"engine": "scipy", "rtol": 1e-4, "atol": 1e-7, "steady": steady}
    # One settles slowly and pauses while the other is recorded.
    omega = np.linspace(3.0, 25.0, 8)
    together = gs.respond(paper_oscillator(zeta=0.1), law, omega, **tolerances)
    for k, each in enumerate(omega.tolist()):
        alone = gs.respond(paper_oscillator(zeta=0.1), law, each, **tolerances)
        assert_array_equal(together.section[k], alone.section)
        assert together.n_steps[k] == alone.n_steps


def test_several_models_and_laws_give_what_each_gives_alone():
    models = [
        paper_oscillator(zeta=0.05),
        paper_oscillator(mean_load=0.5),
        paper_oscillator(forcing=9.0),
    ]
    laws = [[gs.Piecewise(1.4e4, SYMMETRIC)], [gs.Tanh(1.4e4, SYMMETRIC, epsilon=1e4)]]
    together = gs.respond(models, laws, omega=[9.0, 8.0, 7.0])
    assert together.status.shape == (2, 3)
    for i, j in np.ndindex(2, 3):
        alone = gs.respond(models[j], laws[i][0], omega=9.0 - j)
        for name in ("x_max", "x_min", "multiplier_abs", "n_steps", "contact_share", "force_max"):
            assert getattr(together, name)[i, j] == getattr(alone, name)
        assert_array_equal(together.section[i, j], alone.section)


@pytest.mark.parametrize(
    ("omega", "x_0", "said"),
    [
        ([7.0, -1.0], 0.0, "omega = -1: must be > 0"),
        ([], 0.0, "at least one"),
        ([7.0, math.nan], 0.0, "omega = nan: must be finite"),
        ([7.0, 8.0], [0.0, 0.0, 0.0], r"shapes omega \(2,\), x_0 \(3,\), .*omega\[:, None\]"),
    ],
)
def test_arrays_out_of_range_are_refused(omega, x_0, said):
    with pytest.raises(gs.ModelError, match=said):
        gs.respond(paper_oscillator(), gs.Piecewise(1.4e6, SYMMETRIC), omega, x_0)


def test_a_singular_or_overflowing_map_spoils_no_other():
    monodromy = np.array([[[0.5, 0.1], [0.0, 0.2]], np.eye(2), np.full((2, 2), np.inf)])
    moved = np.ones((3, 2))
    steps = newton_steps(monodromy, moved)
    assert_allclose((np.eye(2) - monodromy[0]) @ steps[0], moved[0])
    assert np.all(np.isinf(steps[1]))
    multipliers = floquet_multipliers(monodromy, np.array([0.1, 1.0, 1.0]))
    assert_allclose(multipliers[0], [0.5, 0.2])
    assert np.all(np.isnan(multipliers[2]))


@given(st.tuples(*[st.floats(-2.0, 2.0)] * 3), st.floats(1e-3, 2.0))
def test_multipliers_follow_from_trace_and_determinant(entries, determinant):
    a, b, shear = entries
    # Any matrix of this trace and determinant has the same ones.
    matrix = np.array([[a, 1.0], [a * b - determinant, b]])
    turn = np.array([[1.0, shear], [0.0, 1.0]])
    matrix = turn @ matrix @ np.linalg.inv(turn)
    found = floquet_multipliers(matrix[None], np.array([determinant]))[0]
    assert abs(found[0]) >= abs(found[1]) * (1.0 - 1e-15)
    assert_allclose(found.sum(), a + b, atol=1e-12)
    assert_allclose(found.prod(), determinant, rtol=1e-12)


def test_the_smaller_multiplier_of_an_overdamped_motion_is_known_too():
    oscillator = paper_oscillator(zeta=3.0, alpha=0.0)
    found = gs.respond(oscillator, gs.Piecewise(1.0, gs.Gap(1.0, 1.0)), 1.0)
    # Far below what rounding leaves of a determinant: 5e-3 and 1e-79.
    rates = oscillator.decay_rate + math.sqrt(8.0) * oscillator.omega_n_rad * np.array([-1.0, 1.0])
    assert_allclose(found.multipliers, np.exp(-rates), rtol=1e-6)


@pytest.mark.parametrize("zeta", [0.0, 0.03])
def test_a_response_ends_at_its_last_section_point(zeta):
    law, steady = gs.Piecewise(1.4e4, ASYMMETRIC), gs.Steady(settle_tol=1e-2, max_decay_times=6.0)
    found = gs.respond(paper_oscillator(zeta=zeta), law, [7.0, 14.0], steady=steady)
    for k in range(2):
        assert found.section[k][-2:].tolist() == [found.x_end[k], found.v_end[k]]


# Chaos from which nearly every start escapes, to one orbit of period one, after many decay times.
ESCAPING = (
    gs.Oscillator(
        zeta=0.1,
        omega_n=11.117086247303757,
        mass=0.40110934813009175,
        alpha=-1e6,
        forcing=4.801352817692459,
    ),
    gs.Piecewise(331869.6780197071, ASYMMETRIC),
    17.555070502053812,
)


def test_transient_chaos_that_ends_while_its_growth_is_measured_is_no_chaos():
    oscillator, law, omega = ESCAPING
    start = 3.227497825438147e-05, -0.018514426861966353
    found = gs.respond(oscillator, law, omega, *start)
    settled = gs.simulate(oscillator, law, omega, *start, t_end=1000 / omega)
    window = gs.simulate(oscillator, law, omega, settled.x_end, settled.v_end, t_end=1 / omega)
    assert_allclose(window.x_end, settled.x_end, rtol=1e-9)
    assert (found.response_class, found.period_multiple) == (gs.ResponseClass.PERIODIC, 1)
    assert_allclose(found.x_max, window.extrema.max(), rtol=1e-8)
    assert found.lyapunov < 0.0 == found.lyapunov_error


def test_what_a_solver_cannot_rattle_is_no_scatter():
    # A disturbance that flips as it decays, to P2 as an independent solver with bisected contacts
    # has it after 4,000 periods: from 64 of them it looked like a rattled P4.
    law = gs.Piecewise(1.4e5, ASYMMETRIC, located=False)
    found = gs.respond(paper_oscillator(), law, 9.40)
    if found.response_class is gs.ResponseClass.PERIODIC:
        assert found.period_multiple == 2
        assert_allclose(found.x_max, 1.0358741e-3, rtol=1e-5)
    else:
        assert found.response_class is gs.ResponseClass.UNRESOLVED


def test_scatter_beyond_its_bound_has_no_multiple():
    rng = np.random.default_rng(0)
    section = np.tile([0.0, 1.0j], 32) + 1e-3 * rng.normal(size=64)
    distance = 1e-3 * math.sqrt(2.0)
    assert likely_multiple(parts(section), 0.1, 8) == 2
    assert likely_multiple(parts(section), 0.1, 8, scatter=1.5 * distance) == 2
    assert likely_multiple(parts(section), 0.1, 8, scatter=0.5 * distance) == 0


def test_an_orbit_that_is_not_approached_leaves_no_gap_in_the_window():
    # A P3 beside the P9 that this start settles on; over a gap the section repeated after 30.
    law, omega = gs.Piecewise(1462568.5819342812, ASYMMETRIC), 25.15090406639029
    found = gs.respond(paper_oscillator(), law, omega, 4.548126282479751e-05, 0.028058411772597366)
    n = found.period_multiple
    period = gs.simulate(paper_oscillator(), law, omega, found.x_end, found.v_end, t_end=n / omega)
    assert_allclose([period.x_end, period.v_end], [found.x_end, found.v_end], rtol=1e-6)
    assert n == 9


def test_a_multiple_of_the_period_is_no_dead_end():
    # Noise of the last digits chose which multiple of a settled section contracts.
    oscillator, law, omega = ESCAPING
    rng = np.random.default_rng(1)
    starts = rng.uniform(-5e-4, 5e-4, 300), rng.uniform(-0.03, 0.03, 300)
    found = gs.respond(oscillator, law, omega, *starts)
    others = found.response_class != gs.ResponseClass.PERIODIC
    x, v = found.x_end[others], found.v_end[others]
    ends = gs.simulate(oscillator, law, omega, x, v, t_end=1 / omega)
    moved = np.hypot(ends.x_end - x, (ends.v_end - v) / (2.0 * math.pi * omega))
    assert (moved > 1e-6 * found.x_max[others]).all()


def test_an_exponent_that_nothing_is_left_of_is_not_invented():
    # The slow part decays at 5.39/s, to exp(-1078) in a period: below any double.
    oscillator = paper_oscillator(zeta=3.0, alpha=0.0)
    found = gs.respond(oscillator, gs.Piecewise(1e6, gs.Gap(1.0, 1.0)), 0.005)
    assert found.response_class is gs.ResponseClass.PERIODIC
    assert math.isnan(found.lyapunov)
    assert found.multipliers.tolist() == [0.0, 0.0]


def test_period_multiple_is_the_smallest_repeat():
    one = [1.0 + 0.0j] * 16
    three = [1.0 + 0.0j, 2.0 + 0.0j, 1.0 + 3.0j] * 6
    assert period_multiple(parts(one), 1e-9, 8) == 1
    assert period_multiple(parts(three), 1e-9, 8) == 3
    assert period_multiple(parts(three), 1e-9, 2) == 0
    assert period_multiple(parts(three[:5]), 1e-9, 8) == 0, "two whole repeats are needed"


def test_slow_drift_is_no_period():
    drifting = [1e-3 * k + 0.0j for k in range(16)]
    assert period_multiple(parts(drifting), 1e-4, 8) == 0


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("settle_tol", 0.5, "settle_tol = 0.5: must be <= 0.1"),
        ("t_max", -1.0, "t_max = -1: must be > 0"),
        ("max_extrema", 0, "max_extrema = 0: must be a whole number in 1..65536"),
        ("n_periods", 10, "n_periods = 10: must be >= 2 max_period_multiple"),
    ],
)
def test_bad_steady_settings_are_refused_by_name(field, value, message):
    with pytest.raises(gs.ModelError, match=message):
        gs.Steady(**{field: value})


def made_call(tangent, ok, sound, omega):
    """A call of the engine, of which all blocks are made up."""
    n = len(ok)
    return SimpleNamespace(
        is_ok=ok,
        status=np.where(ok, int(Status.OK), int(Status.DIVERGED)),
        y=np.arange(3.0 * n).reshape(3, n),
        monodromy=tangent,
        is_sound=sound,
        omega=np.full(n, omega),
    )


def test_blocks_of_growth_in_one_call_are_those_of_one_call_each():
    """Also where a block fails, first, in the middle or last, and where one is unsound."""
    rng, omega = np.random.default_rng(1), 9.0
    points, n = np.array([4, 1, 3, 0]), LyapunovExponents(3, 1).n_least
    tangent = rng.normal(size=(4, n, 3, 3))
    ok, sound = np.ones((4, n), bool), np.ones((4, n), bool)
    for row, block in ((1, 0), (2, 20), (3, n - 1)):
        ok[row, block:] = False
        tangent[row, block:] = np.nan
    sound[0, 5] = False
    together, apart = LyapunovExponents(3, 5), LyapunovExponents(3, 5)
    for growths in (together, apart):
        given = np.full(4, 0.9), np.full(4, omega), np.full(4, 1000)
        growths.start(points, np.zeros((3, 4)), *given)
    given = (each.reshape(-1, *each.shape[2:]) for each in (tangent, ok, sound))
    call = made_call(*given, omega)
    is_over, status = together.step(points, n, call)
    assert is_over.all()
    assert (status == Status.OK).tolist() == [True, False, False, False]
    alive = np.arange(4)
    for block in range(n):
        one = made_call(*(each[alive, block] for each in (tangent, ok, sound)), omega)
        one.y = call.y[:, alive * n + block]
        _, now = apart.step(points[alive], 1, one)
        alive = alive[now == Status.OK]
    assert_array_equal(together.y[:, points], apart.y[:, points])
    assert_array_equal(together.n_blocks[points], apart.n_blocks[points])
    assert together.n_blocks[points].tolist() == [n, 0, 20, n - 1]
    whole = points[:1]
    assert_array_equal(together.exponents(whole), apart.exponents(whole))
    assert np.isnan(together.exponents(whole)[0]).all()  # a block was unsound


def test_the_default_atol_is_rtol_times_the_static_deflection_or_the_start():
    k = 3.0 * (10.0 * math.pi) ** 2
    model = gs.Oscillator(zeta=0.05, omega_n=5.0, mass=3.0, alpha=0.0, forcing=4.0)
    far, near = (gs.Piecewise(9.0 * k, gs.Gap(0.0, wall)) for wall in (1.0, 4.0 / k / 3.0))
    # beyond the farther wall, at a third of the deflection, a tenth of the rest
    for law, share in ((far, 1.0), (near, 0.4)):
        for rtol in (1e-9, 1e-4):
            found = gs.respond(model, law, 9.0, rtol=rtol)
            assert found.atol == pytest.approx(rtol * share * 4.0 / k)
    assert gs.respond(model, far, 9.0, atol=1e-11).atol == 1e-11
    run = gs.simulate(model, far, 9.0, t_end=0.1, engine="scipy")
    assert run.atol == pytest.approx(1e-4 * 4.0 / k)
    assert float(run.to_dataset()["atol"]) == run.atol
    free = replace(model, forcing=0.0)
    runs = gs.simulate(free, far, 9.0, x_0=[1e-3, 2e-3], t_end=0.1)
    assert_allclose(runs.atol, [1e-12, 2e-12])
    assert_array_equal(runs.x_end[1], gs.simulate(free, far, 9.0, x_0=2e-3, t_end=0.1).x_end)
    still = gs.simulate(free, gs.Piecewise(k, gs.Gap(0.0, 5e-4)), 9.0, t_end=0.1)
    assert still.atol == pytest.approx(5e-13)


def test_multipliers_are_complex_and_largest_first():
    model = gs.Oscillator(zeta=0.05, omega_n=5.0, mass=3.0, alpha=0.0, forcing=4.0)
    found = gs.respond(model, gs.Piecewise(0.0, gs.Gap(1.0, 1.0)), [3.0, 9.0])
    rate = model.omega_n_rad * (-0.05 + 1j * math.sqrt(1.0 - 0.05**2))
    for omega, multipliers in zip((3.0, 9.0), found.multipliers, strict=True):
        expected = np.exp(rate / omega)
        assert_allclose(multipliers.real, [expected.real] * 2, rtol=1e-7)
        assert_allclose(np.abs(multipliers.imag), [abs(expected.imag)] * 2, rtol=1e-7)
    made = found.to_dataset()
    stored = made["multiplier_real"].values + 1j * made["multiplier_imag"].values
    assert_array_equal(stored, np.stack(found.multipliers))


def test_threads_do_not_share_the_work_space_of_motions():
    """The kernel runs without Python's lock, so that motions of two threads overlap."""
    omegas, law = (7.0, 9.0), gs.Piecewise(1.4e4, SYMMETRIC)

    def motion(omega):
        return gs.simulate(paper_oscillator(), law, omega, n_periods=3000).section.tolist()

    with ThreadPoolExecutor(2) as threads:
        together = list(threads.map(motion, omegas))
    assert together == [motion(omega) for omega in omegas]
