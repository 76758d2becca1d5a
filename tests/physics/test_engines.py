"""Engines through the public calls: against each other, an oracle, and in any company."""

import cmath
import math
import subprocess
import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp

import gapsweep as gs
from gapsweep.integrate.problem import Models, Problems, Solver
from gapsweep.integrate.simulate import prepared
from gapsweep.integrate.stepping import batch
from gapsweep.integrate.stepping.loop import advance_users

SYMMETRIC = gs.Gap(0.4e-3, 0.4e-3)
TIGHT = {"rtol": 1e-12, "atol": 1e-15}


def prints_a_number(x):
    return float(format(x))


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
            run = gs.simulate(
                gs.systems.paper_oscillator(), law, omega, t_0=t_0, t_end=t_0 + 2.5 / omega
            )
            assert_allclose(run.t_section, [(n + 1) / omega, (n + 2) / omega], rtol=1e-12)


@pytest.mark.parametrize("label", ["piecewise", "piecewise-noevents"])
def test_runs_end_to_end_at_whole_periods_have_every_section_once(label):
    law = gs.contact_law(label, K_c=1.4e4, gap=SYMMETRIC)
    rng = np.random.default_rng(4)
    for n in (1, 7, 100, 1000, 5000, 10**6):
        for omega in [*rng.uniform(2.0, 30.0, 30).tolist(), 19.83492724500072, 17.22149976103184]:
            for first, last in ((n, n + 1), (n + 1, n + 3)):
                t_0, t_end = first / omega, last / omega
                run = gs.simulate(gs.systems.paper_oscillator(), law, omega, t_0=t_0, t_end=t_end)
                expected = [k / omega for k in range(first + 1, last + 1)]
                assert_allclose(run.t_section, expected, rtol=1e-12)


def test_an_end_on_a_wall_and_on_a_whole_period_has_one_section():
    """To the last bit: the landing rounds its clock up to the period, what it owes unmakes that."""
    run = gs.simulate(
        gs.systems.paper_oscillator(zeta=0.01, forcing=0.0, alpha=0.0),
        gs.contact_law("piecewise", K_c=1.4e4, gap=SYMMETRIC),
        omega=1.0 / 0.0700526573770261, x_0=5.327375970964657e-05, v_0=0.03683064822309625,
        t_end=0.0700526573770261, atol=1e-12, controller="ode45", restart=True,
    )  # fmt: skip
    assert abs(abs(run.x_end) - 4e-4) < 1e-15
    assert_allclose(run.t_section, [0.0700526573770261], rtol=1e-12)


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


@pytest.mark.extended
@pytest.mark.parametrize(
    ("label", "engine"),
    [
        *(
            (label, "compiled")
            for label in ("piecewise", "piecewise-noevents", "tanh-1e4", "poly-3")
        ),
        *((label, "scipy") for label in ("piecewise", "tanh-1e4")),
    ],
)
@pytest.mark.parametrize("system", [gs.systems.paper_oscillator(alpha=-1e10), softening_pair()])
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
    free = gs.systems.paper_oscillator(zeta=0.01, forcing=0.0, alpha=0.0)
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


def test_restarts_at_walls_of_hardly_any_stiffness_end():
    scene = gs.systems.paper_oscillator(), gs.Piecewise(1e-15, SYMMETRIC), 9.0
    located, restarted = (gs.simulate(*scene, t_end=1.0, restart=r) for r in (False, True))
    assert restarted.n_contacts == located.n_contacts > 5
    assert_allclose(restarted.x_end, located.x_end, atol=1e-8)


def test_memory_does_not_grow_with_the_length_of_a_run():
    law = gs.Piecewise(1.4e4, SYMMETRIC)

    def peak(t_end):
        gs.simulate(
            gs.systems.paper_oscillator(), law, 9.0, t_end=t_end
        )  # compiled before measuring
        tracemalloc.start()
        gs.simulate(gs.systems.paper_oscillator(), law, 9.0, t_end=t_end)
        size = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return size

    # Its steps alone, kept, would take 40 MB; threads of the shared cluster allocate meanwhile.
    assert peak(2000.0) < peak(20.0) + 4_000_000


@pytest.mark.extended
def test_law_that_numba_cannot_compile_says_what_to_do():
    law = gs.law(prints_a_number, 1.4e4, SYMMETRIC)
    with pytest.raises(
        gs.ModelError, match=r"prints_a_number: numba cannot compile .*engine='scipy'"
    ):
        gs.simulate(gs.systems.paper_oscillator(), law, 9.0, t_end=0.1)


FACTOR = {"k": 1e3}


def deep(x):
    return deeper(x, 3.0) / 3.0 if x > 0.0 else -deep(-x) if x < 0.0 else 0.0


def deeper(x, n):
    return x * n


def calls_helpers(x):
    return 1e3 * deep(x)


@pytest.mark.extended
def test_helpers_of_a_law_are_compiled_with_it():
    """Global and local ones, and one that calls itself; the linear law is what they come to."""
    inner = calls_helpers
    several = [gs.law(calls_helpers, 0.0, SYMMETRIC), gs.law(lambda x: inner(x), 0.0, SYMMETRIC)]
    runs = gs.simulate(gs.systems.paper_oscillator(), several, 9.0, 1e-3, t_end=0.5)
    direct = gs.simulate(
        gs.systems.paper_oscillator(), gs.law(springy, 0.0, SYMMETRIC), 9.0, 1e-3, t_end=0.5
    )
    assert_allclose(runs.x_end, direct.x_end, rtol=1e-7)


def springy(x):
    return 1e3 * x


@pytest.mark.extended
def test_a_law_that_is_mended_compiles_in_the_same_process():
    def law(x):
        return factor["k"] * x

    factor = FACTOR
    for _ in range(2):  # not the second time otherwise than the first
        with pytest.raises(
            gs.ModelError, match=r"law: numba cannot compile it .*factor"
        ) as refused:
            gs.simulate(gs.systems.paper_oscillator(), gs.law(law, 0.0, SYMMETRIC), 9.0, t_end=0.1)
        assert len(str(refused.value)) < 500
    factor = np.array([(1e3,)], [("k", "f8")])[0]
    run = gs.simulate(
        gs.systems.paper_oscillator(), gs.law(law, 0.0, SYMMETRIC), 9.0, 1e-3, t_end=0.1
    )
    assert run.status is gs.Status.OK


@pytest.mark.extended
def test_parameters_of_a_law_are_numbers_for_one_compiled_function():
    """Against the closed form of a linear oscillator with springs k + s, each law in its row."""
    k, s = np.array([0.0, 1e3, 2e3]), 500.0
    o = gs.Oscillator(mass=3.0, omega_n=5.0, zeta=0.03, alpha=0.0, forcing=4.0)
    laws = [gs.law(sprung, 0.0, gs.Gap(each, 1.0), s=s, k=each) for each in k]
    before = len(advance_users.signatures)
    found = gs.respond(o, laws, 7.0)
    compiled = len(advance_users.signatures)
    gs.respond(o, gs.law(sprung, 0.0, SYMMETRIC, k=123.0, s=1.0), 7.0)
    assert len(advance_users.signatures) == compiled > before
    w = 2.0 * math.pi * 7.0
    stiffness = o.mass * o.omega_n_rad**2 + k + s
    amplitude = o.forcing / np.hypot(stiffness - o.mass * w**2, 2.0 * o.mass * o.decay_rate * w)
    assert_allclose(found.amplitude, amplitude, rtol=1e-7)


def sprung(x, k, s):
    return k * x + s * x


def test_the_reference_counts_the_right_hand_sides_of_steps_alone():
    """Not those of the output between them."""
    o, law, w = gs.systems.paper_oscillator(), gs.Tanh(1.4e4, SYMMETRIC, 1e4), 9.0
    run = gs.simulate(o, law, w, t_end=0.1, engine="scipy", rtol=1e-8, atol=1e-11)

    def rhs(t, y):
        push = (o.forcing * math.cos(2.0 * math.pi * w * t) - law.force(y[0])) / o.mass
        spring = o.omega_n_rad**2 * y[0] + o.alpha / o.mass * y[0] ** 3
        return [y[1], push - spring - 2.0 * o.decay_rate * y[1]]

    bare = solve_ivp(rhs, (0.0, 0.1), [0.0, 0.0], method="DOP853", rtol=1e-8, atol=1e-11)
    assert run.nfev == bare.nfev
    assert run.n_steps == len(bare.t) - 1


def test_reference_engine_has_no_ode45():
    scene = gs.systems.paper_oscillator(), gs.Piecewise(1.4e4, SYMMETRIC), 9.0
    with pytest.raises(gs.ModelError, match="needs engine = 'compiled'"):
        gs.simulate(*scene, t_end=1.0, engine="scipy", controller="ode45")


@pytest.mark.parametrize("depth", [1e-3, 1e-6])
@pytest.mark.parametrize("rtol", [1e-7, 1e-9, 1e-11, 1e-13])
def test_reference_engine_misses_no_shallow_contact_of_either_wall(depth, rtol):
    # From rest beyond one wall to rest beyond the other: both contacts fit between step ends.
    free = gs.systems.paper_oscillator(zeta=0.0, forcing=0.0)
    law = gs.Piecewise(1.4e6, SYMMETRIC)
    start = -0.4e-3 * (1.0 + depth)
    run = gs.simulate(free, law, 5.0, start, t_end=1.0, engine="scipy", rtol=rtol, atol=1e-3 * rtol)
    assert run.n_contacts == 21
    assert_allclose(np.abs(run.extrema), -start, rtol=100.0 * rtol)


@pytest.mark.parametrize("label", ["piecewise", "piecewise-noevents", "tanh-1e4", "poly-13"])
def test_a_section_alone_is_the_section_of_a_full_record(label, monkeypatch):
    """Nor does what is recorded change the motion; reach is that of its extrema, nearly."""
    gap = gs.Gap(0.0, 0.8e-3)
    law = gs.Piecewise(1.4e4, gap) if "piecewise" in label else gs.contact_law(label, 1.4e4, gap)
    law = replace(law, located=False) if label == "piecewise-noevents" else law
    omega = np.linspace(3.0, 29.0, 40)
    models = Models.of([gs.systems.paper_oscillator()] * 40, [(law,)] * 40, omega)
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
    is_late = whole.t_extrema >= problems.record_from[owner]
    assert_allclose(full.events().t_extrema, whole.t_extrema[is_late], rtol=1e-12)
    assert_allclose(full.events().extrema, whole.extrema[is_late], rtol=0.0, atol=1e-14)
    monkeypatch.setattr(batch, "MOST_PLACED", 0)  # section points are given no places beforehand
    assert_array_equal(integrate(problems).events().section, full.events().section)
    largest = np.abs(problems.start[:, 0])
    np.maximum.at(largest, owner, np.abs(whole.extrema))
    assert np.all(full.reach[:, 0] <= largest * (1 + 1e-9))
    assert np.all(full.reach[:, 0] > 0.5 * largest)


@pytest.mark.parametrize("t_0", [0.0, 0.37])
@pytest.mark.parametrize("j_2", [0.0, 4e-4])
def test_time_in_contact_is_that_beyond_the_walls(j_2, t_0):
    """Starts in the gap, beyond either wall and on one; also without a gap between the walls."""
    start = np.array([[0.0, 0.0], [1e-3, 0.0], [-1e-3, 0.0], [j_2, 0.0]])
    law = gs.Piecewise(1.4e5, gs.Gap(0.0, j_2))
    models = Models.of([gs.systems.paper_oscillator()] * 4, [(law,)] * 4, np.full(4, 9.0))
    t_0, t_end = np.full(4, t_0), np.full(4, t_0 + 2.0)
    given = {"which": np.arange(4), "start": start, "t_0": t_0, "t_end": t_end, "record_from": t_0}
    problems = Problems(**given, contact_time=True, dense_output=True)
    integrate = prepared(models, Solver.of())
    found = integrate(problems)
    x = found.sampler(np.linspace(t_0[0], t_end[0], 100_001))[0]
    beyond = ((x > j_2) | (x < 0.0)).mean(axis=1) * 2.0
    assert_allclose(found.contact_time[:, 0], beyond, rtol=0.0, atol=1e-3)
    assert_array_equal(integrate(replace(problems, contacts=True)).contact_time, found.contact_time)
    none = {name: each[:0] for name, each in given.items()}
    assert not integrate(Problems(**none, dense_output=True)).events().extrema.size


def ends(label):
    """End states of motions at 37 frequencies, as hexadecimal text."""
    law = gs.contact_law(label, K_c=1.4e4, gap=SYMMETRIC)
    run = gs.simulate(gs.systems.paper_oscillator(), law, np.linspace(3.0, 29.0, 37), t_end=2.0)
    return run.x_end.tobytes().hex() + run.v_end.tobytes().hex()


@pytest.mark.extended
@pytest.mark.parametrize("label", ["piecewise", "tanh-1e4"])
def test_another_process_gives_the_same_bits(label):
    code = f"from tests.physics.test_engines import ends; print(ends({label!r}))"
    there = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parents[2],
    )
    assert there.stdout.strip() == ends(label)


def test_a_restart_is_of_located_contacts():
    law = gs.Tanh(1.4e4, gs.Gap(0.4e-3, 0.4e-3), 1e5)
    plain, restarted = (
        gs.simulate(gs.systems.paper_oscillator(), law, 9.0, t_end=2.0, restart=r) for r in (0, 1)
    )
    assert (plain.x_end, plain.nfev) == (restarted.x_end, restarted.nfev)
