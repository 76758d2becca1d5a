"""Engines through the public calls: against each other, an oracle, and in any company."""

import cmath
import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp
from tests.labels import LABELS
from tests.oracles import exact_end_state

import gapsweep as gs
from gapsweep.integrate.problem import Models, Problems, Solver
from gapsweep.integrate.simulate import prepared

SYMMETRIC = gs.Gap(0.4e-3, 0.4e-3)
TIGHT = {"rtol": 1e-12, "atol": 1e-15}


def prints_a_number(x):
    return float(format(x))


@given(
    zeta=st.floats(0.01, 0.2),
    omega_n=st.floats(2.0, 10.0),
    alpha=st.floats(0.0, 1e9),
    forcing=st.floats(1.0, 8.0),
    stiffness=st.floats(3.0, 6.0),
    j_1=st.floats(1e-5, 1e-3),
    j_2=st.floats(1e-5, 1e-3),
    omega=st.floats(0.5, 30.0),
    place=st.floats(-0.9, 0.9),
    v_0=st.floats(-0.05, 0.05),
    K_ratio=st.sampled_from([1.0, 0.2, 5.0]),
)
def test_random_scenes_reach_the_end_state_of_an_independent_method(
    zeta, omega_n, alpha, forcing, stiffness, j_1, j_2, omega, place, v_0, K_ratio
):
    oscillator = gs.Oscillator(zeta=zeta, omega_n=omega_n, alpha=alpha, forcing=forcing)
    law = gs.Piecewise(10.0**stiffness, gs.Gap(j_1, j_2), K_ratio=K_ratio)
    x_0 = place * (j_2 if place > 0 else j_1)
    run = gs.simulate(oscillator, law, omega, x_0, v_0, t_end=1.0, tangent=True, **TIGHT)
    # A touch that rounding alone decides belongs to no sequence of contacts.
    tops = run.extrema
    assume(np.all(np.abs(tops - j_2) > 1e-9) and np.all(np.abs(tops + j_1) > 1e-9))
    x, v, n_contacts = exact_end_state(oscillator, law, omega, x_0, v_0, 1.0)
    amplitude = max(np.abs(tops).max(initial=0.0), abs(v_0) / oscillator.omega_n_rad, abs(x_0))
    # What a disturbance of the start by one part in 1e12 does to the end, at least 1e-9.
    sensitivity = np.abs(run.monodromy / [[1, 1 / oscillator.omega_n_rad]]).max()
    allowed = amplitude * max(1e-9, 1e-11 * sensitivity)
    assert run.n_contacts == n_contacts
    assert abs(run.x_end - x) < allowed
    assert abs(run.v_end - v) / (oscillator.omega_n_rad + 2 * math.pi * omega) < 10 * allowed


@pytest.mark.parametrize(
    ("label", "gap"), [("piecewise", 100.0), ("piecewise", 0.0), ("tanh-1e4", 100.0)]
)
def test_a_thousand_fast_cycles_in_no_time_of_a_slow_forcing_keep_their_clock(label, gap):
    # 10^-4 of a forcing period: at every step its phase is rounded by more than the steps' error.
    # A gap of nothing makes walls of one stiffness a spring, passed through every half cycle.
    osc = gs.Oscillator(zeta=1e-5, omega_n=1e4, mass=1.0, alpha=0.0, forcing=1.0)
    law = gs.contact_law(label, K_c=1e9, gap=gs.Gap(gap, gap))
    omega, t_0, t_end = 1e-3, 400.0, 400.100025
    stiffness = osc.omega_n_rad**2 + (law.K_c if gap == 0.0 else 0.0)
    x_0 = 3.0 / stiffness
    run = gs.simulate(osc, law, omega, x_0, t_0=t_0, t_end=t_end, rtol=1e-12, atol=1e-30)
    w, time = 2.0 * math.pi * omega, t_end - t_0
    root = -osc.decay_rate + 1j * math.sqrt(stiffness - osc.decay_rate**2)
    driven = cmath.exp(1j * w * t_0) / (stiffness - w**2 + 2j * osc.decay_rate * w)
    # the free part starts where the driven one does not
    free = x_0 - driven.real
    free += 1j * (root.real * free + (1j * w * driven).real) / root.imag
    x = (driven * cmath.exp(1j * w * time)).real + (free * cmath.exp(root * time)).real
    assert run.n_contacts == 0 if gap else run.n_contacts > 2000
    # the end's phase is rounded once, and the cycles to some 1e-12
    assert abs(run.x_end - x) < x_0 * (2.0**-54 / omega * abs(root) + 1e-10)


@pytest.mark.parametrize("label", ["piecewise", "piecewise-noevents"])
def test_a_start_on_a_whole_period_has_no_section_just_after_it(label):
    law = gs.contact_law(label, K_c=1.4e4, gap=SYMMETRIC)
    for omega in np.random.default_rng(3).uniform(2.0, 30.0, 40).tolist():
        for n in (1, 3, 7):
            t_0 = n / omega
            run = gs.simulate(gs.Oscillator(), law, omega, t_0=t_0, t_end=t_0 + 2.5 / omega)
            assert_allclose(run.t_section, [(n + 1) / omega, (n + 2) / omega], rtol=1e-12)


@pytest.mark.parametrize("label", ["piecewise", "piecewise-noevents"])
def test_runs_end_to_end_at_whole_periods_have_every_section_once(label):
    law = gs.contact_law(label, K_c=1.4e4, gap=SYMMETRIC)
    rng = np.random.default_rng(4)
    for n in (1, 7, 100, 1000, 5000, 10**6):
        for omega in [*rng.uniform(2.0, 30.0, 30).tolist(), 19.83492724500072, 17.22149976103184]:
            for first, last in ((n, n + 1), (n + 1, n + 3)):
                t_0, t_end = first / omega, last / omega
                run = gs.simulate(gs.Oscillator(), law, omega, t_0=t_0, t_end=t_end)
                expected = [k / omega for k in range(first + 1, last + 1)]
                assert_allclose(run.t_section, expected, rtol=1e-12)


def test_an_end_on_a_wall_and_on_a_whole_period_has_one_section():
    """To the last bit: the landing rounds its clock up to the period, what it owes unmakes that."""
    run = gs.simulate(
        gs.Oscillator(zeta=0.01, forcing=0.0, alpha=0.0),
        gs.contact_law("piecewise", K_c=1.4e4, gap=SYMMETRIC),
        omega=1.0 / 0.0700526573770261, x_0=5.327375970964657e-05, v_0=0.03683064822309625,
        t_end=0.0700526573770261, controller="ode45", restart=True,
    )  # fmt: skip
    assert abs(abs(run.x_end) - 4e-4) < 1e-15
    assert_allclose(run.t_section, [0.0700526573770261], rtol=1e-12)


@pytest.mark.parametrize("label", LABELS)
def test_a_point_is_the_same_alone_and_in_any_company(label):
    law = gs.contact_law(label, 1.4e5, gs.Gap(0.0, 0.8e-3))
    omega = np.linspace(3.0, 25.0, 37)
    together = gs.simulate(gs.Oscillator(), law, omega, t_end=2.0)
    backwards = gs.simulate(gs.Oscillator(), law, omega[::-1], t_end=2.0)
    assert together.x_end.tobytes() == backwards.x_end[::-1].tobytes()
    for i in (0, 17, 36):
        alone = gs.simulate(gs.Oscillator(), law, omega[i], t_end=2.0)
        assert (alone.x_end, alone.v_end, alone.nfev) == (
            together.x_end[i],
            together.v_end[i],
            together.nfev[i],
        )
        assert alone.extrema.tobytes() == together.extrema[i].tobytes()


def softening_pair():
    """Two masses with a lag; thrown far, they run away."""
    along = np.array([1.0, -1.0])
    return gs.System(
        mass=np.diag([1.0, 0.6]),
        damping=[[4.0, -1.0], [-1.0, 3.0]],
        stiffness=[[1500.0, -400.0], [-400.0, 900.0]],
        cubic=[gs.Cubic(along=along, alpha=-1e10)],
        contacts={"stop": along},
        forcing=[gs.Harmonic(amplitude=[2.0, 0.5])],
        lags=gs.Lags([[30.0], [0.0]], [[1.0, 0.0]], [[0.0, 8.0]], [[-20.0]]),
    )


def one_after_the_other(models, integrate, start, n_runs):
    """A chain of runs of a period each of every model, which must be these runs one by one.

    Returns
    -------
    chain : Motions
        n_runs of the first model, then of the second.
    left : ndarray of int
        The models of which no run failed.
    """

    def problems(which, start, follows=None):
        return Problems(
            which=which,
            start=start,
            t_0=np.zeros(len(which)),
            t_end=1.0 / models.omega[which],
            record_from=np.zeros(len(which)),
            follows=follows,
            tangent=True,
        )

    n, start = len(models.omega), start.copy()
    which = np.repeat(np.arange(n), n_runs)
    follows = np.tile(np.arange(n_runs) > 0, n)
    chain = integrate(problems(which, start[which], follows))
    left, sections = np.arange(n), 0
    for k in range(n_runs):
        alone = integrate(problems(left, start[left]))
        rows = left * n_runs + k
        for name in ("t", "state", "status", "n_contacts", "n_steps", "nfev", "monodromy"):
            assert_array_equal(getattr(chain, name)[rows], getattr(alone, name), err_msg=name)
        start[left], sections = alone.state, sections + len(alone.events().section)
        left = left[alone.t == 1.0 / models.omega[left]]
    assert len(chain.events().section) == sections
    never = follows & (chain.n_steps == 0)
    assert_array_equal(np.flatnonzero(never), np.flatnonzero(follows & (chain.t == 0.0)))
    assert (chain.status[never] == chain.status[np.flatnonzero(never) - 1]).all()
    return chain, left


@pytest.mark.parametrize("engine", ["compiled", "scipy"])
@pytest.mark.parametrize("system", [gs.Oscillator(alpha=-1e10), softening_pair()])
@pytest.mark.parametrize("label", ["piecewise", "piecewise-noevents", "tanh-1e4", "poly-3"])
def test_runs_that_follow_each_other_are_those_one_after_the_other(label, system, engine):
    """Also where some diverge, sooner or later, and where one starts on a wall."""
    n, n_runs = (23, 5) if engine == "compiled" else (8, 3)
    rng, law = np.random.default_rng(8), gs.contact_law(label, 1.4e5, SYMMETRIC)
    is_plain = isinstance(system, gs.Oscillator)
    models = Models.of([system] * n, [(law,)] * n, rng.uniform(5.0, 30.0, n))
    span = [12e-3, 0.5] if is_plain else [12e-3, 12e-3, 0.5, 0.5, 1e-2]
    start = rng.uniform(-1.0, 1.0, (n, len(span))) * span
    start[0] = 0.0
    start[0, 0] = SYMMETRIC.j_2
    integrate = prepared(models, Solver.of(engine, 1e-6, 1e-9))
    _, left = one_after_the_other(models, integrate, start, n_runs)
    assert 0 < len(left) < n


def test_a_run_that_ends_on_a_wall_is_followed_from_there():
    """Where the mode says more than the state does: on its way in and on its way out."""
    n, rng, law = 12, np.random.default_rng(5), gs.contact_law("piecewise", 1.4e4, SYMMETRIC)
    free = gs.Oscillator(zeta=0.01, forcing=0.0, alpha=0.0)
    start = np.stack([rng.uniform(-2e-4, 2e-4, n), rng.choice([-0.03, 0.03], n)], axis=1)
    nth = np.arange(n) % 4  # the contact that the first run ends on
    ends = [
        gs.simulate(free, law, 10.0, x_0, v_0, t_end=1.0, tangent=True).t_contacts[k]
        for (x_0, v_0), k in zip(start.tolist(), nth.tolist(), strict=True)
    ]
    # Nothing forces them, so that a period may be as long as the way to the wall.
    models = Models.of([free] * n, [(law,)] * n, 1.0 / np.array(ends))
    integrate = prepared(models, Solver.of("compiled"))
    chain, left = one_after_the_other(models, integrate, start, 3)
    assert len(left) == n
    off = np.abs(np.abs(chain.state[::3, 0]) - SYMMETRIC.j_2)
    assert np.sum(off <= 1e-15) > n // 2
    assert len(set(np.sign(np.prod(chain.state[::3], axis=1)[off <= 1e-15]))) == 2


@pytest.mark.parametrize("label", [*LABELS, "tests.laws:innocent"])
def test_both_engines_find_the_same_steady_response(label):
    law = gs.contact_law(label, 1.4e4, SYMMETRIC)
    fast = gs.respond(gs.Oscillator(), law, 12.0, rtol=1e-10, atol=1e-13)
    plain = gs.respond(gs.Oscillator(), law, 12.0, engine="scipy", rtol=1e-9, atol=1e-12)
    assert fast.period_multiple == plain.period_multiple > 0
    assert fast.n_extrema == plain.n_extrema
    assert_allclose(sorted(fast.extrema), sorted(plain.extrema), atol=3e-9)
    assert_allclose([fast.x_max, fast.x_min], [plain.x_max, plain.x_min], atol=3e-9)


@pytest.mark.parametrize("label", ["piecewise", "tanh-1e4"])
def test_sample_agrees_between_engines(label):
    law = gs.contact_law(label, 1.4e4, SYMMETRIC)
    t = np.linspace(0.0, 2.0, 301)
    runs = [
        gs.simulate(gs.Oscillator(), law, 9.0, t_end=2.0, engine=engine, rtol=1e-11, atol=1e-14,
                    dense_output=True).sample(t)
        for engine in ("compiled", "scipy")
    ]  # fmt: skip
    # scipy's dense output is of lower order than its steps.
    assert_allclose(runs[0][0], runs[1][0], atol=2e-9)
    assert_allclose(runs[0][1], runs[1][1], atol=1e-6)


@pytest.mark.parametrize("controller", ["native", "ode45"])
def test_restart_changes_the_price_not_the_motion(controller):
    scene = gs.Oscillator(), gs.Piecewise(1.4e4, SYMMETRIC), 9.0
    options = {"t_end": 2.0, "rtol": 1e-9, "atol": 1e-12}
    located = gs.simulate(*scene, **options)
    restarted = gs.simulate(*scene, restart=True, controller=controller, **options)
    assert restarted.n_contacts == located.n_contacts
    assert_allclose(restarted.x_end, located.x_end, atol=1e-8)
    assert restarted.nfev > 3 * located.nfev


@pytest.mark.parametrize(("rtol", "atol"), [(1e-4, 1e-7), (1e-6, 1e-9)])
@pytest.mark.parametrize("K_c", [1.4e4, 1.4e6])
def test_ode45_locates_contacts_without_restarting(K_c, rtol, atol):
    """Over a short time, nearer to the truth than if they are stepped over."""
    law, omega = gs.Piecewise(K_c, SYMMETRIC), np.linspace(8.0, 12.0, 16)
    options = {"omega": omega, "t_end": 0.4, "rtol": rtol, "atol": atol, "controller": "ode45"}
    truth = gs.simulate(gs.Oscillator(), law, omega, t_end=0.4, **TIGHT)
    located, restarted, over = (
        gs.simulate(gs.Oscillator(), one, restart=restart, **options)
        for one, restart in ((law, False), (law, True), (replace(law, located=False), False))
    )
    assert np.all(located.n_contacts > 5)
    assert not np.any((located.x_end == over.x_end) | (located.x_end == restarted.x_end))
    errors = [np.median(np.abs(run.x_end - truth.x_end)) for run in (located, restarted, over)]
    assert errors[0] < 0.5 * errors[2]
    assert errors[0] < 5.0 * errors[1]


@pytest.mark.parametrize("restart", [False, True])
@pytest.mark.parametrize("K_c", [1.4e4, 1.4e6])
def test_contacts_of_ode45_lie_within_1e_9_of_a_period(K_c, restart):
    scene = gs.Oscillator(), gs.Piecewise(K_c, SYMMETRIC), 11.0
    truth = gs.simulate(*scene, t_end=0.4, tangent=True, rtol=1e-13, atol=1e-16)
    run = gs.simulate(*scene, t_end=0.4, tangent=True, rtol=1e-12, atol=1e-15, controller="ode45",
                      restart=restart)  # fmt: skip
    assert len(run.t_contacts) > 5
    assert_allclose(run.t_contacts, truth.t_contacts, rtol=0.0, atol=1e-9 / 11.0)
    assert_allclose(run.monodromy, truth.monodromy, rtol=0.0,
                    atol=1e-8 * np.abs(truth.monodromy).max())  # fmt: skip


def test_restarts_at_walls_of_hardly_any_stiffness_end():
    scene = gs.Oscillator(), gs.Piecewise(1e-15, SYMMETRIC), 9.0
    located, restarted = (gs.simulate(*scene, t_end=1.0, restart=r) for r in (False, True))
    assert restarted.n_contacts == located.n_contacts > 5
    assert_allclose(restarted.x_end, located.x_end, atol=1e-8)


def test_ode45_steps_over_contacts_it_does_not_locate():
    law = gs.Piecewise(1.4e6, SYMMETRIC, located=False)
    options = {"t_end": 1.0, "rtol": 1e-4, "atol": 1e-7}
    ode45 = gs.simulate(gs.Oscillator(), law, 12.0, controller="ode45", **options)
    located = gs.simulate(gs.Oscillator(), gs.Piecewise(1.4e6, SYMMETRIC), 12.0, **options)
    # The kinks show as rejected steps, the price of not locating them.
    assert ode45.n_rejected > 0.1 * ode45.n_steps
    assert located.n_rejected == 0


@pytest.mark.parametrize("label", LABELS)
def test_area_contracts_at_the_rate_of_the_damping(label):
    oscillator, law = gs.Oscillator(), gs.contact_law(label, 1.4e4, SYMMETRIC)
    run = gs.simulate(oscillator, law, 9.0, t_end=0.5, tangent=True, **TIGHT)
    expected = math.exp(-2.0 * oscillator.decay_rate * 0.5)
    assert_allclose(np.linalg.det(run.monodromy), expected, rtol=1e-8)


def test_memory_does_not_grow_with_the_length_of_a_run():
    law = gs.Piecewise(1.4e4, SYMMETRIC)

    def peak(t_end):
        gs.simulate(gs.Oscillator(), law, 9.0, t_end=t_end)  # compiled before measuring
        tracemalloc.start()
        gs.simulate(gs.Oscillator(), law, 9.0, t_end=t_end)
        size = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return size

    # Its steps alone, kept, would take 40 MB; threads of the shared cluster allocate meanwhile.
    assert peak(2000.0) < peak(20.0) + 4_000_000


def test_law_that_numba_cannot_compile_says_what_to_do():
    law = gs.law(prints_a_number, 1.4e4, SYMMETRIC)
    with pytest.raises(
        gs.ModelError, match=r"prints_a_number: numba cannot compile .*engine='scipy'"
    ):
        gs.simulate(gs.Oscillator(), law, 9.0, t_end=0.1)


def test_the_reference_counts_the_right_hand_sides_of_steps_alone():
    """Not those of the output between them."""
    o, law, w = gs.Oscillator(), gs.Tanh(1.4e4, SYMMETRIC, 1e4), 9.0
    run = gs.simulate(o, law, w, t_end=0.1, engine="scipy", rtol=1e-8, atol=1e-11)

    def rhs(t, y):
        push = (o.forcing * math.cos(2.0 * math.pi * w * t) - law.force(y[0])) / o.mass
        spring = o.omega_n_rad**2 * y[0] + o.alpha / o.mass * y[0] ** 3
        return [y[1], push - spring - 2.0 * o.decay_rate * y[1]]

    bare = solve_ivp(rhs, (0.0, 0.1), [0.0, 0.0], method="DOP853", rtol=1e-8, atol=1e-11)
    assert run.nfev == bare.nfev
    assert run.n_steps == len(bare.t) - 1


def test_reference_engine_has_no_ode45():
    scene = gs.Oscillator(), gs.Piecewise(1.4e4, SYMMETRIC), 9.0
    with pytest.raises(gs.ModelError, match="needs engine = 'compiled'"):
        gs.simulate(*scene, t_end=1.0, engine="scipy", controller="ode45")


@pytest.mark.parametrize("depth", [1e-3, 1e-6])
@pytest.mark.parametrize("rtol", [1e-7, 1e-9, 1e-11, 1e-13])
def test_reference_engine_misses_no_shallow_contact_of_either_wall(depth, rtol):
    # From rest beyond one wall to rest beyond the other: both contacts fit between step ends.
    free = gs.Oscillator(zeta=0.0, forcing=0.0)
    law = gs.Piecewise(1.4e6, SYMMETRIC)
    start = -0.4e-3 * (1.0 + depth)
    run = gs.simulate(free, law, 5.0, start, t_end=1.0, engine="scipy", rtol=rtol, atol=1e-3 * rtol)
    assert run.n_contacts == 21
    assert_allclose(np.abs(run.extrema), -start, rtol=100.0 * rtol)


@pytest.mark.parametrize("options", [{"tangent": True}, {"dense_output": True}])
@pytest.mark.parametrize("rtol", [1e-4, 1e-6, 1e-9, 1e-12])
def test_few_points_in_fewer_lanes_are_the_same(rtol, options):
    """One and four points share four lanes, five are given sixteen."""
    law, omega = gs.Piecewise(1.4e4, gs.Gap(0.3e-3, 0.4e-3)), np.array([9.0, 7.0, 3.0, 13.0, 24.0])
    times = np.linspace(0.1, 4.9, 50)
    alone, four, five = (
        gs.simulate(gs.Oscillator(), law, at, 1e-3, t_end=5.0, rtol=rtol, **options)
        for at in (omega[0], omega[:4], omega)
    )
    for run in (four, five):
        for name in ("x_end", "v_end", "n_steps", "n_contacts"):
            assert getattr(run, name)[0] == getattr(alone, name), name
        assert_array_equal(run.extrema[0], alone.extrema)
        assert_array_equal(run.t_contacts[0], alone.t_contacts)
        if "tangent" in options:
            assert_array_equal(run.monodromy[0], alone.monodromy)
        else:
            for part, own in zip(run.sample(times), alone.sample(times), strict=True):
                assert_array_equal(part[0], own)
    assert four.x_end.tolist() == five.x_end[:4].tolist()
    assert alone.n_contacts > 10


@pytest.mark.parametrize("label", LABELS)
def test_both_engines_find_the_same_monodromy(label):
    law = gs.contact_law(label, 1.4e4, SYMMETRIC)
    fast, plain = (
        gs.simulate(gs.Oscillator(), law, 9.0, t_end=0.5, tangent=True, engine=engine, rtol=1e-10,
                    atol=1e-14).monodromy
        for engine in ("compiled", "scipy")
    )  # fmt: skip
    # Where contacts are not located, the tangent sees the jump of the slope up to a step late.
    allowed = 1e-3 if label == "piecewise-noevents" else 1e-6
    assert_allclose(fast, plain, rtol=allowed, atol=allowed * np.abs(plain).max())


@pytest.mark.parametrize("label", ["piecewise", "piecewise-noevents", "tanh-1e4", "poly-13"])
def test_a_section_alone_is_the_section_of_a_full_record(label):
    """Nor does what is recorded change the motion; reach is that of its extrema, nearly."""
    gap = gs.Gap(0.0, 0.8e-3)
    law = gs.Piecewise(1.4e4, gap) if "piecewise" in label else gs.contact_law(label, 1.4e4, gap)
    law = replace(law, located=False) if label == "piecewise-noevents" else law
    omega = np.linspace(3.0, 29.0, 40)
    models = Models.of([gs.Oscillator()] * 40, [(law,)] * 40, omega)
    integrate = prepared(models, Solver.of(rtol=1e-6, atol=1e-9))
    problems = Problems(
        which=np.arange(40),
        start=np.linspace([-1e-3, 0.0], [1e-3, 0.0], 40),
        t_0=np.zeros(40),
        t_end=30.0 / omega,
        record_from=np.where(np.arange(40) % 3 == 0, np.inf, 10.0 / omega),
    )
    full = integrate(problems)
    alone = integrate(replace(problems, section_only=True, effort=np.arange(40.0)))
    for name in ("state", "n_steps", "reach"):
        assert getattr(full, name).tolist() == getattr(alone, name).tolist()
    assert_array_equal(full.events().section, alone.events().section)
    assert full.events().n_section.tolist() == alone.events().n_section.tolist()
    assert set(alone.events().n_section.tolist()) == {0, 21}
    assert not alone.events().extrema.size
    whole = integrate(replace(problems, record_from=np.zeros(40))).events()
    owner = np.repeat(np.arange(40), whole.n_extrema)
    largest = np.abs(problems.start[:, 0])
    np.maximum.at(largest, owner, np.abs(whole.extrema))
    assert np.all(full.reach[:, 0] <= largest * (1 + 1e-9))
    assert np.all(full.reach[:, 0] > 0.5 * largest)
