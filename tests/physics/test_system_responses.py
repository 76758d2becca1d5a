"""Steady responses of systems: against oscillators, brute force, other coordinates, scipy."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose

import gapsweep as gs
from gapsweep.integrate.stepping import batch
from gapsweep.model.structure import general_form

GAP = gs.Gap(4e-4, 6e-4)
# Damped so that each scene has one attractor: which one a start ends on is another question.
OSCILLATORS = (
    gs.systems.paper_oscillator(zeta=0.2, alpha=0.0),
    gs.Oscillator(zeta=0.25, omega_n=7.0, mass=1.2, alpha=0.0, forcing=2.0),
)
LAWS = (gs.Piecewise(1.2e4, GAP), gs.Piecewise(6e3, gs.Gap(3e-4, 3e-4)))
BY_NAME = dict(zip(("stop 0", "stop 1"), LAWS, strict=True))


def joined(*oscillators, change=None):
    """Oscillators side by side as one system, in coordinates p with q = change @ p."""
    n = len(oscillators)
    change = np.eye(n) if change is None else np.asarray(change)
    mass = np.diag([o.mass for o in oscillators])
    damping = np.diag([2.0 * o.mass * o.decay_rate for o in oscillators])
    stiffness = np.diag([o.mass * o.omega_n_rad**2 for o in oscillators])
    return gs.System(
        mass=change.T @ mass @ change,
        damping=change.T @ damping @ change,
        stiffness=change.T @ stiffness @ change,
        contacts={f"stop {i}": row for i, row in enumerate(change)},
        cubic=[
            gs.Cubic(along=row, alpha=o.alpha)
            for row, o in zip(change, oscillators, strict=True)
            if o.alpha
        ],
        forcing=[gs.Harmonic(amplitude=change.T @ [o.forcing for o in oscillators])],
    )


def coupled(K_c=2e3, coupling=150.0):
    """Two masses with a stop between them and a wall for the second."""
    system = gs.System(
        mass=np.diag([1.0, 0.5]),
        damping=[[0.8, -0.2], [-0.2, 0.5]],
        stiffness=[[400.0, -coupling], [-coupling, 300.0]],
        contacts={"stop": [1.0, -1.0], "wall": [0.0, 1.0]},
        forcing=[gs.Harmonic(amplitude=[3.0, 1.0])],
    )
    law = {
        "stop": gs.Piecewise(K_c, gs.Gap(1e-3, 2e-3)),
        "wall": gs.Piecewise(K_c, gs.Gap(5e-3, 5e-3)),
    }
    return system, law


def two_equal_machines():
    """Two equal machines with equal loads, and a stop between them."""
    one = np.array([[90.0, 55.0], [-55.0, 200.0]])
    return gs.System(
        mass=np.eye(4), damping=0.3 * np.eye(4), stiffness=np.kron(np.eye(2), one),
        contacts={"stop": [1.0, 0.0, -1.0, 0.0]},
        forcing=[gs.Harmonic(amplitude=[1.0, 0.5, 1.0, 0.5])],
    )  # fmt: skip


@pytest.mark.extended
def test_uncoupled_oscillators_respond_each_as_alone():
    omega = np.linspace(4.0, 14.0, 30)
    together = gs.respond(
        joined(*OSCILLATORS), dict(zip(("stop 0", "stop 1"), LAWS, strict=True)), omega
    )
    alone = [gs.respond(o, law, omega) for o, law in zip(OSCILLATORS, LAWS, strict=True)]
    periodic = np.all([r.response_class == gs.ResponseClass.PERIODIC for r in alone], axis=0)
    assert periodic.sum() > 15
    assert np.all(together.response_class[periodic] == gs.ResponseClass.PERIODIC)
    multiple = np.lcm(*(r.period_multiple for r in alone))
    assert np.array_equal(together.period_multiple[periodic], multiple[periodic])
    for name in ("x_max", "x_min", "amplitude", "force_max"):
        expected = np.stack([getattr(r, name) for r in alone], axis=-1)
        assert_allclose(getattr(together, name)[periodic], expected[periodic], rtol=1e-5)
    shares = np.stack([r.contact_share for r in alone], axis=-1)
    assert_allclose(together.contact_share[periodic], shares[periodic], atol=1e-5)


@pytest.mark.extended
def test_other_coordinates_change_no_answer():
    change = np.array([[1.0, 0.4], [-0.3, 0.8]])
    omega = np.linspace(4.0, 14.0, 20)
    plain = gs.respond(joined(*OSCILLATORS), BY_NAME, omega)
    turned = gs.respond(joined(*OSCILLATORS, change=change), BY_NAME, omega)
    periodic = plain.response_class == gs.ResponseClass.PERIODIC
    assert periodic.sum() > 10
    assert np.array_equal(plain.response_class[periodic], turned.response_class[periodic])
    assert np.array_equal(plain.period_multiple[periodic], turned.period_multiple[periodic])
    # The contacts' gaps do not know of coordinates.
    assert_allclose(turned.force_max[periodic], plain.force_max[periodic], rtol=1e-5)
    assert_allclose(turned.contact_share[periodic], plain.contact_share[periodic], atol=1e-5)
    assert_allclose(turned.multiplier_abs[periodic], plain.multiplier_abs[periodic], atol=1e-5)


@pytest.mark.extended
@pytest.mark.parametrize("kind", [gs.Piecewise, partial(gs.Tanh, epsilon=3e3)])
def test_orbits_of_coupled_masses_are_where_brute_force_settles(kind):
    system, laws = coupled()
    law = {name: kind(each.K_c, each.gap) for name, each in laws.items()}
    omega, n_checked = np.linspace(3.0, 8.0, 20), 0  # below lie tori and chaos
    found = gs.respond(system, law, omega)
    settled = gs.simulate(system, law, omega, t_end=150.0)
    for k in np.flatnonzero(found.response_class == gs.ResponseClass.PERIODIC):
        last = settled.section[k][-1 - int(found.period_multiple[k]) :]
        if np.abs(last[-1] - last[0]).max() > 1e-7 * (1.0 - found.multiplier_abs[k]):
            continue  # settles later than that: the orbit is as many returns away as it shrinks
        n_checked += 1
        states = np.reshape(found.section[k], (-1, 4))
        assert np.abs(states - last[-1]).max(axis=1).min() < 1e-6
    assert n_checked > 10


@pytest.mark.extended
def test_a_linear_system_responds_as_its_transfer_function():
    system = gs.System(
        mass=np.diag([1.0, 0.5]),
        damping=[[0.8, -0.2], [-0.2, 0.5]],
        stiffness=[[400.0, -150.0], [-150.0, 300.0]],
        forcing=[gs.Harmonic(amplitude=[3.0, 1.0])],
    )
    found = gs.respond(system, {}, 3.0)
    w = 2.0 * math.pi * 3.0
    transfer = system.stiffness - w**2 * system.mass + 1j * w * system.damping
    amplitude = np.abs(np.linalg.solve(transfer, [3.0, 1.0]))
    assert_allclose(found.x_max, amplitude, rtol=1e-7)
    assert found.force_max.shape == found.contact_share.shape == (0,)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"x_0": 1e-3}, "x_0 = 0.001: a System starts from q_0, v_0 and z_0"),
        ({"omega": None}, "omega: missing; this System is forced"),
        ({"q_0": [0.0, 0.0, 0.0]}, "q_0: has the shape"),
        ({"law": {"stop": LAWS[0]}}, "law: of .* must name"),
        (
            {"law": {"stop": LAWS[0], "wall": gs.Tanh(1e4, GAP, 1e4)}},
            "contacts are located for all contacts or none",
        ),
    ],
)
def test_mistakes_are_named(arguments, message):
    system, law = coupled()
    with pytest.raises(gs.ModelError, match=message):
        gs.respond(system, **({"law": law, "omega": 3.0} | arguments))


@pytest.mark.parametrize("engine", ["compiled", "scipy"])
@pytest.mark.parametrize(
    "other", [gs.Tanh(1e4, GAP, 1e4), gs.Piecewise(1e4, GAP, located=False)], ids=["tanh", "none"]
)
def test_no_engine_locates_some_contacts_only(engine, other):
    system, law = coupled()
    law = law | {list(law)[-1]: other}
    with pytest.raises(gs.ModelError, match="all contacts or none"):
        gs.simulate(system, law, 3.0, t_end=0.1, engine=engine)


@pytest.mark.extended
def test_a_part_too_light_to_be_seen_is_not_judged():
    # Uncoupled parts, so that the heavy one cannot matter: the light one alone is chaotic.
    small, w = 1e-5, 0.9

    def both(amplitude):
        push = amplitude * 1e3 * abs(0.09 - w * w + 0.06j * w)
        return gs.System(
            mass=np.diag([1e3, 1e-3]), stiffness=np.diag([90.0, 1e-3]),
            damping=np.diag([60.0, 2e-5]), contacts={"stop": [0.0, 1.0]},
            forcing=[gs.Harmonic(amplitude=[push, 0.9 * 0.64 / 1.26 * 1e-3 * small])],
        )  # fmt: skip

    law, omega = gs.Piecewise(0.029, gs.Gap(1e6 * small, small)), w / (2.0 * math.pi)
    start = {"q_0": [0.0, 0.5 * small]}
    for amplitude in (0.0, 1e-3):
        found = gs.respond(both(amplitude), law, omega, **start)
        assert found.response_class == gs.ResponseClass.CHAOTIC
    found = gs.respond(both(0.1), law, omega, **start)
    assert found.response_class == gs.ResponseClass.UNRESOLVED
    assert "within solver error" in found.message


@pytest.mark.extended
@pytest.mark.parametrize(
    ("K_c", "gap", "said"),
    [(87.0, 0.1, gs.Status.UNRESOLVED), (87.0, 0.0, gs.Status.DIVERGED), (0.0, 0.1, gs.Status.OK)],
)
def test_nothing_is_claimed_of_a_motion_along_its_wall(K_c, gap, said):
    """Two equal machines that move alike never press on the stop between them.

    What the stop does to a disturbance is another thing: out of contact it decays; held by a spring
    of this stiffness it grows, by matrix exponentials 3.3 times in a period.
    """
    system = two_equal_machines()
    law = gs.Piecewise(K_c, gs.Gap(0.0, gap))
    for apart in (0.0, 1e-12):
        found = gs.respond(system, law, 1.1, q_0=[0.013, 0.0, 0.013 + apart, 0.0])
        assert found.status in (said, gs.Status.DIVERGED if K_c and apart else said)


@pytest.mark.extended
def test_contact_that_chatter_ends_is_counted_once(monkeypatch):
    """Whether the last of many passings led into contact or out of it."""
    system = two_equal_machines()
    shares = []
    for most in (100.0, 99.0, 8.0, 7.0):
        monkeypatch.setattr(batch, "MOST_SHORT", most)
        law = gs.Piecewise(0.5, gs.Gap(0.0, 0.1))
        found = gs.respond(system, law, 1.1, q_0=[0.013, 0.0, 0.013, 0.0])
        shares.append(found.contact_share)
    assert_allclose(shares, shares[0], rtol=1e-6)


@pytest.mark.extended
@pytest.mark.parametrize(("small", "is_seen"), [(1e-3, True), (1e-7, False)])
def test_a_cubic_spring_too_light_to_be_seen_is_not_judged(small, is_seen):
    # Ueda's oscillator with two wells, chaotic, beside a linear one as its own.
    system = gs.System(
        mass=np.eye(2), stiffness=np.diag([2.0, -1.0]), damping=np.diag([0.4, 0.3]),
        cubic=[gs.Cubic(along=[0, 1], alpha=1.0 / small**2)],
        forcing=[gs.Harmonic(amplitude=[1.0, 0.5 * small])], contacts={"far": [1, 0]},
    )  # fmt: skip
    law, omega = gs.Piecewise(1.0, gs.Gap(1e5, 1e5)), 1.2 / (2.0 * math.pi)
    found = gs.respond(system, law, omega, q_0=[0.0, 0.1 * small], atol=1e-14)
    assert (found.response_class == gs.ResponseClass.CHAOTIC) == is_seen
    assert ("cubic spring" in found.message) != is_seen
    # Where it adds nothing, nothing is hidden.
    weak = replace(system, cubic=[gs.Cubic(along=[0, 1], alpha=1e-4 / small**2)])
    weak = replace(weak, stiffness=np.diag([2.0, 1.0]))
    found = gs.respond(weak, law, omega, q_0=[0.0, 0.1 * small], atol=1e-14)
    assert found.response_class == gs.ResponseClass.PERIODIC


@pytest.mark.extended
def test_a_torus_beside_a_part_that_repeats_is_found():
    # Without loss the first coordinate keeps its own frequency for ever; no contact is reached.
    system = gs.System(
        mass=np.eye(2), stiffness=np.diag([1.0, 2.0]), damping=np.diag([0.0, 0.2]),
        contacts={"stop": [0, 1]}, forcing=[gs.Harmonic(amplitude=[0.1, 0.1])],
    )  # fmt: skip
    w = math.sqrt(0.6)  # of a fraction both would repeat together
    law = gs.Piecewise(3.0, gs.Gap(1.0, 1.0))
    omega, q_0 = w / (2 * math.pi), [0.3, 0]
    found = gs.respond(system, law, omega, q_0=q_0)
    assert found.response_class == gs.ResponseClass.QUASIPERIODIC
    # Its exponent is measured to the error that is asked for.
    steady = gs.Steady(lyapunov_error=found.lyapunov_error / 2.0, max_periods=100_000)
    precise = gs.respond(system, law, omega, q_0=q_0, steady=steady)
    assert precise.response_class == gs.ResponseClass.QUASIPERIODIC
    assert precise.lyapunov_error <= steady.lyapunov_error


@pytest.mark.extended
def test_a_torus_is_not_given_the_slow_orbit_that_it_passes():
    """Every few dozen periods it comes within 1 % of its reach of a stable one (|mu| = .999)."""
    system = gs.System(
        mass=[[1.914, 0.689], [0.689, 1.81]], stiffness=[[3.247, -0.0404], [-0.0404, 0.4857]],
        damping=[[0.0071, 0.00166], [0.00166, 0.0048]],
        contacts={"a": [0.19, -1.46], "b": [0.135, 0.1835]},
        forcing=[
            gs.Harmonic(amplitude=[3.317, -2.016]), gs.Harmonic(amplitude=[-0.54, 0.2756], k=0)
        ],
        cubic=[
            gs.Cubic(along=[-0.072, -1.778], alpha=0.794),
            gs.Cubic(along=[-2.21, -0.268], alpha=1.438),
        ],
    )  # fmt: skip
    laws = {
        "a": gs.Piecewise(464.0, gs.Gap(0.02375, 0.00971)),
        "b": gs.Piecewise(574.0, gs.Gap(0.79, 0.387)),
    }
    start = {"q_0": [-0.1361, -0.0336], "v_0": [-0.0368, 0.0759]}
    found = gs.respond(system, laws, 1.5947, **start)
    assert found.response_class == gs.ResponseClass.QUASIPERIODIC
    state = found.x_end, found.v_end
    later = gs.simulate(system, laws, 1.5947, q_0=state[0], v_0=state[1], t_end=300.0)
    assert np.ptp(np.array(later.section)[:, 0]) > 0.05 * found.amplitude[0]  # it is no orbit


def whirling(growth, driven=1.3):
    """A driven coordinate beside two that whirl: q = A (cos wt, sin wt), A^2 = w^2 - 1."""
    w = 1.0 + growth
    thirds = [np.array([math.cos(t), math.sin(t)]) for t in (0.0, math.pi / 3, 2 * math.pi / 3)]
    system = gs.System(
        mass=np.eye(3), damping=np.diag([0.2, 0.1, 0.1]),
        stiffness=[[driven, 0, 0], [0, 1.0, 0.1 * w], [0, -0.1 * w, 1.0]],
        cubic=[gs.Cubic(along=[0, *each], alpha=8 / 9) for each in thirds],
        forcing=[gs.Harmonic(amplitude=[1.0, 0, 0])], contacts={"far": [1, 0, 0]},
    )  # fmt: skip
    return system, gs.Piecewise(1.0, gs.Gap(1e5, 1e5)), w, math.sqrt(w * w - 1.0)


@pytest.mark.extended
def test_a_torus_that_is_settled_on_slowly_is_read_off_its_end():
    """Damping says that this takes 20 s; towards the torus it takes up to 1e5, or too long."""
    systems, laws, w, amplitude = zip(*map(whirling, (0.0015, 0.001, 1e-4)), strict=True)
    omega = np.array(w) / (2 * math.pi * np.array([math.sqrt(2.7), math.sqrt(2.7), 1.643]))
    q_0 = [[0.0, 1e-3, 0.0], [0.0, 0.02, 0.0], [0.0, 0.02, 0.0]]
    found = gs.respond(systems, laws[0], omega, q_0=q_0)
    torus, unresolved = gs.ResponseClass.QUASIPERIODIC, gs.ResponseClass.UNRESOLVED
    assert found.response_class.tolist() == [torus, torus, unresolved]
    for one, expected in zip(found.x_max[:2], amplitude, strict=False):
        assert one[1:] == pytest.approx(expected, rel=1e-6)
    assert "allow more time" in found.message[2]


@pytest.mark.extended
def test_a_torus_that_nearly_closes_is_no_period_to_a_loose_solver():
    """After n periods it is back to within what a step may be off by, and creeps on."""
    system, law, w, _ = whirling(0.5)
    n, turns, off = np.transpose([(3, 1, 3e-4), (16, 5, 1e-4), (19, 3, 2e-4)])
    omega = w / (2 * math.pi * (1.0 + turns / n + off))
    found = gs.respond(system, law, omega, q_0=[0.0, 0.8, 0.0], rtol=1e-3)
    assert (found.response_class == gs.ResponseClass.QUASIPERIODIC).all()


@pytest.mark.extended
def test_a_torus_beside_a_smooth_solver_s_rattle_is_found():
    """The driven coordinate repeats to 1e-7, which is white: its own means are never even."""
    system, _, _, amplitude = whirling(0.5)
    law = gs.Tanh(3.0, gs.Gap(0.3, 0.3), epsilon=20.0)
    found = gs.respond(system, law, [0.1786, 0.31242600007541543], q_0=[0.5, 1.0, 0.0], rtol=1e-7)
    assert (found.response_class == gs.ResponseClass.QUASIPERIODIC).all()
    assert_allclose(found.x_max[:, 1:], amplitude, rtol=1e-5)


@pytest.mark.extended
def test_an_orbit_that_is_come_to_while_watched_is_found():
    """A spring of 3e-5 locks the whirl to its drive, over tens of thousands of periods."""
    system, _, w, amplitude = whirling(0.5, driven=2.0)
    coupling = 3e-5 * np.array([[1, -1, 0], [-1, 1, 0], [0, 0, 0]])
    locked = replace(system, stiffness=system.stiffness + coupling)
    law, phase = gs.Piecewise(1.0, gs.Gap(1e5, 1e5)), np.array([2.0, 4.0])
    q = amplitude * np.stack([0 * phase, np.cos(phase), np.sin(phase)], axis=1)
    v = amplitude * w * np.stack([0 * phase, -np.sin(phase), np.cos(phase)], axis=1)
    found = gs.respond(locked, law, w / (2 * math.pi), q_0=q, v_0=v)
    assert (found.response_class == gs.ResponseClass.PERIODIC).all()
    assert (found.period_multiple == 1).all()
    assert_allclose(found.x_end[0], found.x_end[1], atol=1e-6)


@pytest.mark.extended
@pytest.mark.parametrize("alpha", [1e-9, 1.0])
def test_a_part_that_its_stop_holds_is_not_hidden_by_a_weak_spring(alpha):
    # Pressed on the stop it moves by 1e-7 of the rest, and the cubic spring adds nothing to that.
    system = gs.System(
        mass=np.eye(2), stiffness=[[1.0, -1e-5], [-1e-5, 0.0]], damping=np.diag([0.2, 2.0]),
        cubic=[gs.Cubic(along=[0, 1], alpha=alpha)], contacts={"stop": [0, 1]},
        forcing=[gs.Harmonic(amplitude=[1.0, 0.0]), gs.Harmonic(amplitude=[0.0, 10.0], k=0)],
    )  # fmt: skip
    found = gs.respond(system, gs.Piecewise(100.0, gs.Gap(1e-3, 1e-3)), 0.2)
    assert found.response_class == gs.ResponseClass.PERIODIC


def fluttering(stiffness, *, mass, loss, cubic, contact, load):
    """Two masses that flutter by circulatory springs, driven, with a stop."""
    along = zip(([1, 0], [0, 1]), cubic, strict=True)
    return gs.System(
        mass=np.diag(mass), damping=loss * np.eye(2), stiffness=stiffness,
        cubic=[gs.Cubic(along=a, alpha=alpha) for a, alpha in along],
        contacts={"stop": contact}, forcing=[gs.Harmonic(amplitude=load)],
    )  # fmt: skip


def neighbours_part(system, law, omega, found, n_periods):
    """Growth factor of the distance of two motions in some forcing periods, without tangent."""
    state = np.concatenate([found.x_end, found.v_end])
    both = np.stack([state, state + 1e-9 * np.array([1.0, -1.0, 1.0, 1.0])])
    run = gs.simulate(
        system, law, np.full(2, omega), q_0=both[:, :2], v_0=both[:, 2:], t_end=n_periods / omega,
        rtol=1e-12, atol=1e-15,
    )  # fmt: skip
    return np.linalg.norm(np.diff(np.concatenate([run.q_end, run.v_end], axis=1), axis=0)) / 2e-9


@pytest.mark.extended
def test_a_torus_whose_disturbances_grow_for_a_while_is_not_chaotic():
    """It beats so slowly that a short growth puts its exponent up to five errors above zero."""
    law = gs.Piecewise(9357.2, gs.Gap(9.0356e-3, 9.6202e-3))
    system = fluttering(
        [[83.223, 20.954], [-20.954, 114.338]],
        mass=(1.2741, 1.5418), loss=0.7236, cubic=(7169.3, 18450.6), contact=[-0.1367, 0.4118],
        load=[-0.3463, -0.03],
    )  # fmt: skip
    omega = 2.729378 + np.linspace(-2e-4, 2e-4, 9)
    found = gs.respond(system, law, omega, q_0=[1e-3, -1e-3])
    assert (found.response_class == gs.ResponseClass.QUASIPERIODIC).all()
    assert (np.abs(found.lyapunov) < 5e-4 * omega).all()
    for at in omega[4:6]:
        one = gs.respond(system, law, at, q_0=[1e-3, -1e-3])
        assert neighbours_part(system, law, at, one, 1000) < 1e3  # as time goes by


@pytest.mark.extended
def test_an_exponent_is_measured_as_well_as_asked_for():
    law = gs.Piecewise(8087.68, gs.Gap(5.41548e-3, 16.65218e-3))
    system = fluttering(
        [[92.865, 19.006], [-19.006, 114.44]],
        mass=(0.6652, 1.1427), loss=0.6294, cubic=(3401.03, 40746.9), contact=[-0.9612, 0.8489],
        load=[-0.1312, -0.0778],
    )  # fmt: skip
    omega, start = 2.745044, {"q_0": [1e-3, -1e-3]}
    found = gs.respond(system, law, omega, **start)
    assert found.response_class == gs.ResponseClass.CHAOTIC
    assert neighbours_part(system, law, omega, found, 300) > 1e5
    wanted = 0.3 * found.lyapunov_error
    steady = gs.Steady(lyapunov_error=wanted, max_periods=100_000)
    precise = gs.respond(system, law, omega, **start, steady=steady)
    assert precise.lyapunov_error <= wanted
    assert abs(precise.lyapunov - found.lyapunov) < 4.0 * found.lyapunov_error


@pytest.mark.extended
def test_the_largest_force_of_a_stiffness_that_changes_is_not_said():
    system = gs.System(
        mass=[[1.0]], stiffness=[[0.0]], damping=[[0.1]], contacts={"mesh": [1.0]},
        forcing=[gs.Harmonic(amplitude=[0.1], k=0), gs.Harmonic(amplitude=[0.05], k=2)],
        modulation={"mesh": [gs.Modulation(depth=-0.2, k=1)]},
    )  # fmt: skip
    found = gs.respond(system, gs.Piecewise(1.0, gs.Gap(1.0, 1.0)), 1.6 / (2 * math.pi), q_0=[1.2])
    assert found.status == gs.Status.OK
    assert np.isnan(found.force_max).all()


def test_basins_over_two_states_of_a_system_are_those_of_its_responses():
    pair, laws = gs.systems.two_masses(), gs.systems.two_masses_law()
    q, v = np.linspace(-2.0, 2.0, 5), np.array([-1.0, 1.0])
    found = gs.basins(pair, laws, 0.1176, x=("x_2", q), v=("v_x_1", v))
    assert found["attractor"].dims == ("v_x_1", "x_2")
    second, first_v = np.meshgrid(q, v)
    zero = np.zeros_like(second)
    states = np.stack([zero, second], axis=-1), np.stack([first_v, zero], axis=-1)
    expected = gs.respond(pair, laws, 0.1176, q_0=states[0], v_0=states[1])
    number = found["attractor"].values
    assert len(found["attractor_number"]) > 1
    period = found["period_multiple"].values[number]
    np.testing.assert_array_equal(period, expected.period_multiple)
    np.testing.assert_allclose(found["x_max"].values[number], expected.x_max, rtol=1e-5)


def test_basins_of_an_oscillator_and_of_its_general_form_are_equal():
    machine, law = gs.systems.paper_oscillator(), gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4))
    axes = np.linspace(-2e-3, 2e-3, 4), np.linspace(-0.1, 0.1, 3)
    found = gs.basins(machine, law, 13.0, x=axes[0], v=axes[1])
    general = gs.basins(general_form(machine), law, 13.0, x=axes[0], v=axes[1])
    assert len(found["attractor_number"]) > 1
    np.testing.assert_array_equal(found["attractor"].values, general["attractor"].values)


def test_basins_of_an_unforced_system_are_over_its_states():
    section = gs.systems.typical_section(14.0), gs.systems.typical_section_law()
    found = gs.basins(*section, x=("alpha", [0.02, 0.03]), v=("z_1", [0.0]))
    assert found["attractor"].shape == (1, 2)
    assert (found["attractor"] >= 0).all()


def test_a_mass_without_contact_does_not_change_the_smallest_disturbance():
    """Searched in four dimensions; the second mass moves, but the first one does not feel it."""
    pair = gs.System(
        mass=np.eye(2), stiffness=np.diag([1.0, 1.7]), damping=np.diag([0.05, 0.2]),
        contacts={"stop": [1.0, 0.0]}, forcing=[gs.Harmonic(amplitude=[0.03, 0.01], k=1)],
    )  # fmt: skip
    one = gs.Oscillator(mass=1.0, omega_n=0.5 / math.pi, zeta=0.025, forcing=0.03)
    law, omega, axis = gs.Piecewise(2.0, gs.Gap(0.1745, 0.1745)), 0.65 / math.pi, [-1.0, 0.0, 1.0]
    found = gs.basins(pair, law, omega, x=("q_1", axis), v=("v_q_1", axis), rays=16)
    expected = gs.basins(one, law, omega, x=axis, v=axis, rays=16)
    np.testing.assert_allclose(found["disturbance"], expected["disturbance"], rtol=1e-6)
    single = found["single_up_v"].sel(coordinate="q_1")
    np.testing.assert_allclose(single, expected["single_up_v"], rtol=1e-7)
    assert np.isnan(found["single_up_x"].sel(coordinate="q_2")).all()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"omega": None}, "omega"),
        ({"omega": 3.0, "x": ("x", [0.0])}, "states: q_1, q_2, v_q_1, v_q_2"),
        ({"omega": 3.0, "x": ("q_2", [0.0]), "v": ("q_2", [0.0])}, "two states"),
        ({"omega": 3.0, "x": ("q_2", [])}, "not empty"),
    ],
)
def test_bad_states_of_basins_are_named(given, words):
    system, law = coupled()
    with pytest.raises(gs.ModelError, match=words):
        gs.basins(system, law, **{"x": [0.0], "v": [0.0], **given})


@pytest.mark.extended
def test_what_leaves_an_orbit_slowly_is_not_chaotic():
    """Beside a period doubling: a tiny, steady growth that a sweep comes upon."""
    system, law = gs.systems.two_masses(), gs.systems.two_masses_law()
    q, v = [0.46824958473702544, 0.4997710354331705], [0.6422515990315049, 0.9849925555462388]
    found = gs.respond(system, law, 0.1176, q_0=q, v_0=v)
    assert found.response_class in (gs.ResponseClass.PERIODIC, gs.ResponseClass.UNRESOLVED)
    settled = gs.respond(system, law, 0.1176, q_0=[0.9, 0.2])
    assert (settled.response_class, settled.period_multiple) == (gs.ResponseClass.PERIODIC, 2)


@pytest.mark.extended
def test_beyond_its_torus_the_two_masses_are_chaotic():
    system, law = gs.systems.two_masses(), gs.systems.two_masses_law()
    found = gs.respond(system, law, 0.0966, q_0=[0.5, 0.1])
    assert found.response_class == gs.ResponseClass.CHAOTIC
    assert found.lyapunov > 5.0 * found.lyapunov_error


@pytest.mark.extended
@pytest.mark.parametrize("stiffness", [1.0, 1e-3])
def test_a_mass_that_walls_hold_has_the_default_tolerance_of_the_same_oscillator(stiffness):
    """A soft spring alone would let it move 4 m and 4 km."""
    wall = gs.Piecewise(1e5, gs.Gap(1e-4, 1e-4))
    system = gs.System(
        mass=[[1.0]],
        stiffness=[[stiffness]],
        damping=[[5.0]],
        contacts={"stop": [1.0]},
        forcing=[gs.Harmonic(amplitude=[4.0])],
    )
    oscillator = gs.Oscillator(
        mass=1.0, omega_n=math.sqrt(stiffness) / (2.0 * math.pi), zeta=0.0, c=5.0, forcing=4.0
    )
    own = gs.law(held_by_hard_walls, 10.0, gs.Gap(1.0, 1.0))
    tight = gs.respond(system, wall, omega=20.0, atol=1e-14)
    assert tight.status == gs.Status.OK
    for found in (
        gs.respond(system, wall, omega=20.0),
        gs.respond(oscillator, wall, omega=20.0),
        gs.respond(system, own, omega=20.0),
    ):
        assert found.status == gs.Status.OK
        assert found.atol < 1e-12
        assert found.amplitude == pytest.approx(tight.amplitude, rel=1e-8)


def held_by_hard_walls(x):
    return 1e5 * (x - 1e-4 if x > 1e-4 else x + 1e-4 if x < -1e-4 else 0.0)
