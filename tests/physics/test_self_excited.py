"""Steady motions that nothing forces: limit cycles, rest, and what their return map says."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.builders.attractors import attractors_of_scenes

import gapsweep as gs
from gapsweep.integrate.problem import Models, Solver
from gapsweep.response.autonomous import PoincareMap
from gapsweep.response.ensemble import Ensemble
from gapsweep.response.equilibrium import Rates, rates
from gapsweep.response.respond import respond_all
from gapsweep.response.scene import Scene

pytestmark = pytest.mark.extended

PERIODIC, EQUILIBRIUM = gs.ResponseClass.PERIODIC, gs.ResponseClass.EQUILIBRIUM
LAW = gs.Piecewise(2e3, gs.Gap(5e-3, 6e-3))


def fluttering(circulation=25.0, loss=0.3, order=(0, 1)):
    """Two masses that circulatory springs make flutter; the stop and cubic springs bound it."""
    stiffness = np.array([[100.0, circulation], [-circulation, 110.0]])
    along = np.eye(2)[list(order)]
    turn = np.ix_(order, order)
    return gs.System(
        mass=np.eye(2),
        damping=loss * np.eye(2),
        stiffness=stiffness[turn],
        cubic=[gs.Cubic(along=along[:, 0], alpha=4e4), gs.Cubic(along=along[:, 1], alpha=1e4)],
        contacts={"stop": along[:, 0]},
    )


@pytest.mark.parametrize("rtol", [1e-3, 1e-4])
def test_a_loose_solver_tells_a_limit_cycle_from_rest(rtol):
    start = {"q_0": [0.1, -0.1]}  # from far away: the cycle is small beside it
    tight = gs.respond(fluttering(), LAW, **start)
    loose = gs.respond(fluttering(), LAW, **start, rtol=rtol)
    assert loose.response_class == gs.ResponseClass.PERIODIC
    share = rtol / (1.0 - tight.multiplier_abs)  # errors of so many periods add up
    assert_allclose(loose.x_max, tight.x_max, rtol=share)
    assert loose.period == pytest.approx(tight.period, rel=share)
    # Held against its stop by a load: to come to rest there is no orbit that closes.
    load = gs.Harmonic(amplitude=[3.0, 0.0], k=0)
    held = replace(fluttering(circulation=5.0), cubic=(), forcing=(load,))
    found = gs.respond(held, LAW, q_0=[1e-2, -1e-2], rtol=rtol)
    assert found.response_class == gs.ResponseClass.EQUILIBRIUM
    assert found.lyapunov == pytest.approx(-0.15)  # half of the damping


@pytest.mark.parametrize(
    ("copy", "speed", "largest", "smallest", "hertz"),
    [
        ("conner-scaled", 8.0, 2.8149284, -2.8149284, 4.8077082),
        ("conner-scaled", 12.36842, 3.4291061, -2.4621163, 5.1000493),
    ],
)
def test_the_published_limit_cycles_are_found_at_once(copy, speed, largest, smallest, hertz):
    section, law = gs.systems.typical_section(speed, copy), gs.systems.typical_section_law(copy)
    found = gs.respond(section, law, q_0=[0.01, 0.0, 0.0])
    assert found.response_class == PERIODIC
    flap = sorted(np.degrees([abs(found.x_max[2]), abs(found.x_min[2])]))
    assert_allclose(flap, sorted([largest, abs(smallest)]), rtol=1e-5)
    assert_allclose(1.0 / found.period, hertz, rtol=1e-5)
    assert_allclose(found.lyapunov, math.log(found.multiplier_abs) / found.period, rtol=1e-9)


def test_the_order_of_coordinates_changes_the_section_alone():
    first, second = (
        gs.respond(fluttering(order=order), LAW, q_0=q)
        for order, q in (((0, 1), [1e-3, 0.0]), ((1, 0), [0.0, 1e-3]))
    )
    assert first.response_class == second.response_class == PERIODIC
    assert_allclose(first.period, second.period, rtol=1e-8)
    assert_allclose(first.x_max, second.x_max[::-1], rtol=1e-7)
    assert_allclose(first.force_max, second.force_max, rtol=1e-7)
    assert_allclose(first.multiplier_abs, second.multiplier_abs, rtol=1e-5)


def test_what_loses_more_than_it_gains_comes_to_rest():
    system = fluttering(circulation=2.0)
    found = gs.respond(system, LAW, q_0=[0.01, 0.0])
    assert found.response_class == EQUILIBRIUM
    assert found.status == gs.Status.OK
    assert np.abs(found.x_max).max() < 1e-8
    matrix = np.block([[np.zeros((2, 2)), np.eye(2)], [-system.stiffness, -system.damping]])
    assert_allclose(found.lyapunov, np.linalg.eigvals(matrix).real.max(), rtol=1e-9)
    assert found.contact_share == 0.0
    assert found.force_max == 0.0


def test_a_load_holds_a_mass_at_rest_against_its_stop():
    system = gs.System(
        mass=[[1.0]], damping=[[2.0]], stiffness=[[100.0]], contacts={"stop": [1.0]},
        forcing=[gs.Harmonic(amplitude=[30.0], k=0)],
    )  # fmt: skip
    found = gs.respond(system, gs.Piecewise(500.0, gs.Gap(0.1, 0.1)))
    at = (30.0 + 500.0 * 0.1) / 600.0
    assert found.response_class == EQUILIBRIUM
    assert_allclose(found.x_max, [at], rtol=1e-6)
    assert_allclose(found.force_max, [500.0 * (at - 0.1)], rtol=1e-5)
    assert found.contact_share == 1.0


def test_what_creeps_back_has_no_returns_and_comes_to_rest():
    system = gs.System(
        mass=[[1.0]], damping=[[50.0]], stiffness=[[100.0]], contacts={"stop": [1.0]}
    )
    found = gs.respond(system, LAW, q_0=[[0.002], [0.02]])
    assert found.response_class.tolist() == [EQUILIBRIUM, EQUILIBRIUM]


@pytest.mark.parametrize("load", [0.0, 4.0])
@pytest.mark.parametrize("rtol", [1e-4, 1e-9])
def test_every_place_of_rest_is_one_attractor(load, rtol):
    """A mass that a negative spring presses against either stop."""
    system = gs.System(
        mass=[[1.0]], damping=[[1.0]], stiffness=[[-100.0]], contacts={"stop": [1.0]},
        forcing=[gs.Harmonic(amplitude=[load], k=0)],
    )  # fmt: skip
    starts = np.random.default_rng(1).uniform(-1.0, 1.0, (40, 2)) * [0.3, 3.0]
    law = gs.Piecewise(500.0, gs.Gap(0.1, 0.1))
    found, attractors = grouped(system, law, starts, rtol)
    assert (found["response_class"] == EQUILIBRIUM).all()
    places = found["x_end"][attractors.first]
    at = (load + np.array([-50.0, 50.0])) / 400.0
    assert_allclose(places, at, rtol=10 * max(rtol, 1e-8))
    side = (found["x_end"] > 0.0).astype(int)
    # A place is as near as is said of it.
    assert (np.abs(found["x_end"] - at[side]) <= 1.01 * found["noise"] + 1e-15).all()
    assert attractors.numbers.tolist() == side.tolist()
    assert attractors.n_ending.tolist() == np.bincount(side).tolist()


def test_where_nothing_brings_a_mass_back_no_place_is_an_attractor():
    system = gs.System(mass=[[1.0]], damping=[[1.0]], stiffness=[[0.0]], contacts={"stop": [1.0]})
    starts = np.random.default_rng(1).uniform(-0.05, 0.05, (6, 2))
    found, attractors = grouped(system, gs.Piecewise(500.0, gs.Gap(1.0, 1.0)), starts)
    assert (found["response_class"] == EQUILIBRIUM).all()
    assert attractors.numbers.tolist() == [-1] * 6


def test_a_far_shot_changes_nothing_for_those_after_it():
    system = fluttering()
    near, far = (np.array([[x], [0.0], [0.0], [0.0]]) for x in (0.01, 500.0))
    models = Models.of([system], [(LAW,)], np.zeros(1))
    returns, one = PoincareMap(models, Solver.of(), near), np.ones(1, int)

    def shot(y):
        call = returns.call(np.zeros(1, int), y, one, np.full(1, np.inf), tangent=True)
        return call.status.tolist(), call.y.tolist()

    before = shot(near)
    shot(far)
    assert shot(near) == before
    assert before[0] == [gs.Status.OK]


def test_rests_in_the_middle_are_one_however_near_they_came():
    starts = [[1e-6, 0.0, 0.0, 0.0], [0.01, 0.0, 0.0, 0.0], [0.1, 0.2, 0.0, 0.0], [3.0, -1.0, 0, 0]]
    found, attractors = grouped(fluttering(circulation=2.0), LAW, starts)
    assert (found["response_class"] == EQUILIBRIUM).all()
    assert attractors.numbers.tolist() == [0, 0, 0, 0]
    assert (found["noise"] >= 0.99 * np.hypot(*found["x_end"].T)).all()


def grouped(system, law, starts, rtol=1e-6):
    """Responses of one system from many starts, as columns, and their attractors."""
    solver = Solver.of("compiled", rtol, None)
    scene = Scene(oscillator=system, law=(law,), omega=0.0, solver=solver)
    found = respond_all([scene] * len(starts), starts, gs.Steady())
    one, unit = np.zeros(len(starts), int), system.unit(2.0 * np.pi * system.slowest)[:, None]
    return found.columns, attractors_of_scenes(found, one, unit=unit, symmetric=False)


def test_on_top_of_a_hill_nothing_is_steady():
    found = gs.respond(fluttering(), LAW)
    assert found.response_class == gs.ResponseClass.UNRESOLVED
    assert found.lyapunov > 0.0


# --- where the first coordinate says nothing -----------------------------------------------------

WIDE = gs.Piecewise(3.0, gs.Gap(1.0, 1.0))


def beside(coupling=0.0, stiffness=1.7, loss=0.3):
    """A coordinate beside a pair that flutters between walls; its period is 5.5236733 s."""
    springs = np.array([[stiffness, 0, -coupling], [0, 1.0, 0.3], [0, -0.3, 1.3]])
    damping = np.diag([loss, 0.05, 0.05])
    stop = {"stop": [0, 0, 1]}
    return gs.System(mass=np.eye(3), stiffness=springs, damping=damping, contacts=stop)


def test_a_coordinate_that_follows_faintly_still_tells():
    found = gs.respond(beside(coupling=1e-6), WIDE, q_0=[0.3, 0.5, 0.0])
    assert found.response_class == PERIODIC
    assert_allclose(found.period, 5.5236733, rtol=1e-7)


@pytest.mark.parametrize(
    "q_0", [[0.3, 0.5, 0.0], [0.0, 0.5, 0.0], [[0.0, 0.5, 0.0], [0.3, 0.5, 0.0]]]
)
def test_a_coordinate_that_dies_out_tells_nothing(q_0):
    found = gs.respond(beside(), WIDE, q_0=q_0)
    assert np.all(found.response_class == gs.ResponseClass.UNRESOLVED)
    assert "another coordinate must be the first" in np.ravel(found.message)[0]


def test_rest_on_a_wall_has_a_class_but_no_exponent():
    system = gs.System(
        mass=np.eye(2), stiffness=[[1.0, 0.3], [-0.3, 1.3]], damping=0.05 * np.eye(2),
        contacts={"stop": [0, 1]},
    )  # fmt: skip
    starts = np.random.default_rng(0).uniform(-1, 1, (12, 2))
    found = gs.respond(system, gs.Piecewise(3.0, gs.Gap(1.0, 0.0)), q_0=starts)
    assert (found.response_class == EQUILIBRIUM).all()
    assert np.isnan(found.lyapunov).all()


def test_what_nothing_holds_is_refused():
    system = gs.System(mass=np.eye(2), stiffness=np.zeros((2, 2)), contacts={"stop": [0, 1]})
    with pytest.raises(gs.ModelError, match="no time scale"):
        gs.respond(system, WIDE, q_0=[0.3, -0.1])


def test_rates_of_many_systems_are_those_of_each_equation():
    """Against the right side that scipy integrates, bit-equal in any company."""
    rng, solver = np.random.default_rng(5), Solver.of()
    loads = [gs.Harmonic(amplitude=[3.0, -1.0], k=0)]
    systems = [fluttering(), fluttering(circulation=9.0), fluttering(loss=2.0)]
    systems = [replace(each, forcing=loads) for each in systems]
    laws = [(LAW,)] * 20 + [(gs.Piecewise(7e3, gs.Gap(0.0, 1e-3), K_ratio=0.3),)] * 20
    models = Models.of([rng.choice(systems) for _ in laws], laws, np.zeros(40))
    ensemble = Ensemble(models, solver)
    y, every = rng.normal(size=(4, 40)) * 0.01, np.arange(40)
    found = Rates(models)(every, y)
    expected = np.transpose([rates(ensemble, i, y[:, i]) for i in range(40)])
    assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
    some = rng.permutation(40)[:7]
    np.testing.assert_array_equal(Rates(models)(some, y[:, some]), found[:, some])


@pytest.mark.parametrize(("k", "c"), [(1e6, 100.0), (1.0, 0.3), (1e-6, 1e-4)])
def test_the_distance_of_a_rest_has_the_units_of_its_clock(k, c):
    """Of one coordinate in closed form: its place is the load over the stiffness."""
    system = gs.System(
        mass=[[1.0]], stiffness=[[k]], damping=[[c]], contacts={"stop": [1.0]},
        forcing=[gs.Harmonic(amplitude=[k * 1e-3], k=0)],
    )  # fmt: skip
    found = gs.respond(system, gs.Piecewise(k, gs.Gap(1.0, 1.0)), q_0=[0.0])
    assert found.response_class == EQUILIBRIUM
    off = abs(found.x_end - 1e-3)
    assert 0.99 * off <= found.noise <= 1e3 * off + 1e-12


@pytest.mark.parametrize("wall", [0.0, 1.0])
def test_a_rest_on_a_wall_grows_as_the_worse_of_its_sides(wall):
    """Held by its stop on one side, pushed away by a negative spring on the other."""
    system = gs.System(
        mass=[[1.0]], stiffness=[[-1.0]], damping=[[30.0]], contacts={"stop": [1.0]},
        forcing=[gs.Harmonic(amplitude=[-wall], k=0)],
    )  # fmt: skip
    law = gs.Piecewise(20.0, gs.Gap(100.0 if wall else 0.0, wall), K_ratio=0.0)
    found = gs.respond(system, law, q_0=[wall + 0.2])
    assert found.response_class == gs.ResponseClass.UNRESOLVED
    assert_allclose(found.lyapunov, -15.0 + math.sqrt(226.0), rtol=1e-6)


@pytest.mark.parametrize("w", [1.0, 1e6, 1e7])
def test_the_start_is_no_extremum_however_fast_the_clock(w):
    system = gs.System(
        mass=[[1.0]], stiffness=[[w * w]], damping=[[0.01 * w]], contacts={"stop": [1.0]}
    )
    law = gs.Tanh(w * w, gs.Gap(0.1, 0.1), epsilon=1000.0)
    run = gs.simulate(system, law, q_0=[1.0], t_end=100.0 / w)
    exact = gs.simulate(system, law.exact, q_0=[1.0], t_end=100.0 / w)
    assert len(run.extrema["q_1"]) == len(exact.extrema["q_1"]) == 43
    # From tiny first steps on; the wall is as thick as a thousandth.
    assert_allclose(run.extrema["q_1"], exact.extrema["q_1"], atol=5e-3)


SCALE = np.array([0.01, 0.05, 0.1, 0.1, 0.5, 1.0])  # of states of the section


@pytest.fixture(scope="module")
def slow_responses():
    """Rows of responses of the section by speed: thousands of returns, in one call."""
    starts = {
        10.352352: SCALE * np.random.default_rng(5).uniform(-1.0, 1.0, (12, 6)),
        10.504505: SCALE * np.random.default_rng(5).uniform(-1.0, 1.0, (12, 6)),
        10.295295: SCALE * np.random.default_rng(2).uniform(-1.0, 1.0, (16, 6)),
        10.181182: np.array([[0.005, 0.02, 0.05, 0.0, 0.0, 0.0]]),
    }
    speeds = np.repeat(list(starts), [len(each) for each in starts.values()])
    sections = [gs.systems.typical_section(speed) for speed in speeds]
    start = np.concatenate(list(starts.values()))
    law = gs.systems.typical_section_law()
    found = gs.respond(sections, law, q_0=start[:, :3], v_0=start[:, 3:])
    names = ("response_class", "message", "lyapunov", "x_end", "v_end")
    return {s: {name: getattr(found, name)[speeds == s] for name in names} for s in starts}


@pytest.mark.parametrize(("speed", "is_torus"), [(10.352352, False), (10.504505, True)])
def test_thin_chaos_of_the_section_is_no_torus(slow_responses, speed, is_torus):
    """One window in ten of this chaos has means as even as a torus has."""
    section, law = gs.systems.typical_section(speed), gs.systems.typical_section_law()
    found = slow_responses[speed]
    is_quasiperiodic = found["response_class"] == gs.ResponseClass.QUASIPERIODIC
    is_chaotic = found["response_class"] == gs.ResponseClass.CHAOTIC
    assert is_quasiperiodic.all() if is_torus else not is_quasiperiodic.any()
    assert not is_chaotic.any() if is_torus else is_chaotic.mean() > 0.5
    # By no tangent: neighbours part in proportion to time on a torus.
    state = np.concatenate([found["x_end"], found["v_end"]], axis=1)[:1]
    near = state + 1e-9 * np.eye(6, 2).T * SCALE
    run = gs.simulate(
        section, law, q_0=near[:, :3], v_0=near[:, 3:], t_end=400.0, rtol=1e-12, atol=1e-15
    )
    apart = np.concatenate([run.q_end[1] - run.q_end[0], run.v_end[1] - run.v_end[0]]) / SCALE
    assert (np.abs(apart).max() < 1e-5) == is_torus


def test_where_growth_sets_in_no_motion_is_watched_for_long():
    """Damping about rest says nothing there of how long a limit cycle takes."""
    section, law = gs.systems.typical_section(6.681682), gs.systems.typical_section_law()
    found = gs.respond(section, law, q_0=[0.005, 0.02, 0.05])
    assert found.response_class == PERIODIC
    assert found.t_simulated < 100.0


def test_an_orbit_of_too_many_returns_is_no_torus(slow_responses):
    """Locked after 116 maxima: its means are as even as over a torus, but disturbances shrink."""
    section, law = gs.systems.typical_section(10.181182), gs.systems.typical_section_law()
    found = slow_responses[10.181182]
    assert found["response_class"] == gs.ResponseClass.UNRESOLVED
    assert found["lyapunov"] < -0.05
    assert "max_period_multiple = 32" in found["message"][0]
    steady = gs.Steady(max_period_multiple=128, n_periods=257)
    patient = gs.respond(section, law, q_0=[0.005, 0.02, 0.05], steady=steady)
    assert (patient.response_class, patient.period_multiple) == (PERIODIC, 116)
    assert_allclose(patient.lyapunov, found["lyapunov"], rtol=0.1)


def test_an_orbit_that_is_long_settled_on_is_neither_chaos_nor_torus(slow_responses):
    """Locked after 298 maxima: on the way disturbances grow for a while."""
    section, law = gs.systems.typical_section(10.295295), gs.systems.typical_section_law()
    found = slow_responses[10.295295]
    assert (found["response_class"] == gs.ResponseClass.UNRESOLVED).all()
    assert any("repeats after more" in one for one in found["message"])
    # By no search: where a long motion has led, it repeats itself after 298 maxima, and no sooner.
    run = gs.simulate(section, law, q_0=[0.005, 0.02, 0.05], t_end=9000.0, rtol=1e-9)
    late = np.asarray(run.section)[-2000:]
    far = np.abs(late[-1] - late[:-1]).max(axis=1)[::-1]
    assert np.flatnonzero(far < 1e-9)[0] == 297


@pytest.mark.parametrize(
    ("damping", "steady", "said"),
    [(-0.05, gs.Steady(), "without damping"), (0.2, gs.Steady(t_max=2.0), "t_max")],
)
def test_what_is_unresolved_says_why(damping, steady, said):
    system = gs.System(
        mass=[[1.0]], stiffness=[[100.0]], damping=[[damping]], contacts={"stop": [1.0]}
    )
    found = gs.respond(system, LAW, q_0=[1e-3], steady=steady)
    assert found.status == gs.Status.UNRESOLVED
    assert said in found.message


def test_an_exact_law_has_no_range_to_leave():
    """Where nothing is a number, no gap is beyond any wall."""
    light = gs.System(
        mass=[[1e-50]], stiffness=[[1.0]], damping=[[0.1]], contacts={"stop": [1.0]},
        forcing=[gs.Harmonic(amplitude=[1.0])],
    )  # fmt: skip
    found = gs.respond(light, gs.Piecewise(20.0, gs.Gap(0.1, 0.1)), 0.2)
    assert found.status.failed
    assert found.status is not gs.Status.OUT_OF_FIT_RANGE


@pytest.mark.parametrize("rtol", [1e-5, 1e-7, 1e-9])
def test_what_shrinks_slower_than_damping_says_is_given_time(rtol):
    """Preloaded against its stop: out of contact it would settle at another rate."""
    system = gs.System(
        mass=[[2.15, -0.19], [-0.19, 2.28]], stiffness=[[1.35, 0.69], [0.55, 1.16]],
        damping=[[0.124, 0.081], [0.116, -0.0146]], contacts={"stop": [0.75, 0.58]},
        forcing=[gs.Harmonic(amplitude=[0.38, 0.03], k=0)],
        cubic=[
            gs.Cubic(along=[0.077, 0.2], alpha=1.19), gs.Cubic(along=[-1.05, -1.33], alpha=1.81)
        ],
        lags=gs.Lags([[0.23], [2.02]], [[-2.04, 0.71]], [[0.98, -0.34]], [[-0.445]]),
    )  # fmt: skip
    law = gs.Piecewise(11.3, gs.Gap(0.26, 0.74), K_ratio=0.5)
    found = gs.respond(system, law, q_0=[-1.1, -0.6], rtol=rtol, atol=1e-3 * rtol)
    assert found.response_class == gs.ResponseClass.EQUILIBRIUM
    # It shrinks at that rate, by an integrator that knows no rest.
    state = {"q_0": [-1.1, -0.6]}
    early, late = (
        gs.simulate(system, law, **state, t_end=t, rtol=1e-11).q_end - found.x_end
        for t in (300.0, 500.0)
    )
    rate = math.log(np.linalg.norm(late) / np.linalg.norm(early)) / 200.0
    assert found.lyapunov == pytest.approx(rate, abs=0.01)


def test_what_grows_without_bound_is_not_chaotic():
    """A hardening spring makes it faster and faster: disturbances grow in proportion to it."""
    system = gs.System(
        mass=[[1.19183728733539]], stiffness=[[0.3934567834255728]],
        damping=[[-0.023693476944914537]], contacts={"stop": [0.92136423]},
        lags=gs.Lags([[-0.0734788]], [[1.19387572]], [[0.24663904]], [[-0.112592]]),
        cubic=[gs.Cubic(along=[0.63271976], alpha=1.3369748136671296)],
    )  # fmt: skip
    law = gs.Piecewise(0.5666465797054446, gs.Gap(0.0, 0.18606140284921324), K_ratio=0.5)
    steady = gs.Steady(t_max=3e4)
    found = gs.respond(system, law, q_0=[0.26798492], steady=steady)
    assert found.response_class == gs.ResponseClass.UNRESOLVED
    assert "grew until the end" in found.message
    run = gs.simulate(system, law, q_0=[0.26798492], t_end=2000.0)
    assert run.status is gs.Status.DIVERGED


@pytest.mark.parametrize("gap", [gs.Gap(0.0, 0.5), gs.Gap(0.5, 0.5)])
def test_a_rest_on_a_wall_that_spreads_on_both_sides_is_not_steady(gap):
    system = gs.System(
        mass=[[1.0]], stiffness=[[1.0]], damping=[[-0.1]], contacts={"stop": [1.0]},
        cubic=[gs.Cubic(along=[1.0], alpha=1.0)],
    )  # fmt: skip
    found = gs.respond(system, gs.Piecewise(2.0, gap))
    assert found.response_class == gs.ResponseClass.UNRESOLVED
    assert found.lyapunov == pytest.approx(0.05)
    run = gs.simulate(system, gs.Piecewise(2.0, gap), q_0=[1e-6], t_end=200.0)
    assert abs(run.q_end[0]) > 1e-3


@pytest.mark.extended  # a layout with impacts
def test_a_cycle_whose_second_mass_rests_on_a_stop_at_the_section_is_an_orbit():
    """The stop holds the mass at the maxima of the first one: its acceleration is zero there."""

    def machine(c=-0.2, load=0.1):
        return gs.System(
            mass=np.diag([1.0, 0.5]), stiffness=[[1.3, -0.3], [-0.3, 0.8]],
            damping=[[c, 0.0], [0.0, 0.8]],
            contacts={"limit": [1.0, 0.0], "stop": [0.0, 1.0]},
            forcing=[gs.Harmonic(k=0, amplitude=[load, load])],
        )  # fmt: skip

    laws = {
        "limit": gs.Piecewise(10.0, gs.Gap(0.4, 0.4), damping=1.0),
        "stop": gs.Rigid(gs.Gap(None, 0.02), restitution=0.4),
    }
    start = {"q_0": [0.05, -0.03], "v_0": [0.1, 0.02], "rtol": 1e-12}
    found = gs.respond(machine(), laws, **start)
    assert found.response_class == gs.ResponseClass.PERIODIC
    assert found.x_end[1] == pytest.approx(0.02, rel=1e-12)
    slopes = gs.gradient(machine, laws, ["c", "load"], values={"c": -0.2, "load": 0.1}, **start)
    by = slopes["gradient"]
    assert (by.sel(quantity=["x_end[q_2]", "v_end[q_2]"]) == 0.0).all()
    for name, value in (("c", -0.2), ("load", 0.1)):
        ends = [gs.respond(machine(**{name: value * f}), laws, **start) for f in (0.999, 1.001)]
        for quantity, get in (("period", "period"), ("x_min[q_2]", "x_min")):
            low, high = (np.ravel(getattr(end, get))[-1] for end in ends)
            expected = (high - low) / (0.002 * value)
            got = by.sel(quantity=quantity, parameter=name).item()
            assert got == pytest.approx(expected, rel=1e-4)
