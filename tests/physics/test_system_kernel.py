"""Systems of several coordinates: against closed forms, other integrators and invariants."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from scipy.integrate import solve_ivp
from tests import piecewise_linear as exact
from tests.random_systems import LAGS, TOLERANCE, Case, as_gapsweep, random_case, relative

import gapsweep as gs
from gapsweep.model.system import first_order


def same_bits(a, b):
    return np.array_equal(np.asarray(a).view(np.int64), np.asarray(b).view(np.int64))


def solvable(n, n_contacts, count, **options):
    """Random cases that are not too chaotic for an end state to mean something."""
    cases, seed = [], 0
    while len(cases) < count:
        case = random_case([n, n_contacts, seed], n, n_contacts, **options)
        seed += 1
        if case.allowed < 1e-5:
            cases.append(case)
    return cases


@pytest.fixture(scope="module")
def case():
    """Three coordinates, two contacts, lags and a constant load."""
    return next(
        case
        for seed in range(100)
        if (case := random_case([seed], 3, 2)).system.n_lags == 2
        and len(case.system.harmonics) == 3
        and case.truth.n_crossings > 10
        and case.allowed < 1e-6
    )


@pytest.mark.parametrize(
    ("n", "n_contacts", "count", "tangent"), [(2, 1, 4, True), (3, 2, 4, True), (6, 3, 1, False)]
)
def test_random_systems_move_as_matrix_exponentials_say(n, n_contacts, count, tangent):
    for case in solvable(n, n_contacts, count):
        run = case.run(tangent=tangent)
        assert case.wrong(run) == "", case


def test_volume_of_states_shrinks_by_the_trace(case):
    trace = np.trace(first_order(as_gapsweep(case.system)[0]))
    run = case.run(t_end=-8.0 / trace, tangent=True)  # later, rounding is all that is left of it
    assert run.n_contacts > 0
    assert np.log(np.linalg.det(run.monodromy)) == pytest.approx(-8.0, abs=1e-9)


# ---------------------------------------------------------------- other coordinates and units


def test_a_change_of_coordinates_changes_nothing_else(case):
    rng = np.random.default_rng(1)
    n, old = case.system.n, case.system
    turn = np.linalg.qr(rng.standard_normal((n, n)))[0] @ np.diag(rng.uniform(0.5, 2.0, n))
    back = np.linalg.inv(turn)

    def congruent(matrix):
        return turn.T @ matrix @ turn

    mass = congruent(old.M)
    force, of_speed, of_place, of_lags = old.lags()
    system = exact.System(
        M=(mass + mass.T) / 2.0,
        C=congruent(old.C),
        K=congruent(old.K),
        contacts=tuple(replace(c, b=turn.T @ c.b) for c in old.contacts),
        harmonics=tuple(replace(h, p=turn.T @ h.p) for h in old.harmonics),
        D=turn.T @ force,
        E=of_speed @ turn,
        G=of_place @ turn,
        H=of_lags,
    )
    turned = replace(case, system=system, q_0=back @ case.q_0, v_0=back @ case.v_0).run(
        tangent=True
    )
    run = case.run(tangent=True)
    assert relative(turn @ turned.q_end, run.q_end) < case.allowed
    assert relative(turn @ turned.v_end, run.v_end) < case.allowed
    assert turned.n_contacts == run.n_contacts


def test_units_by_powers_of_two_change_no_bit(case):
    mass, length, time = 2.0**10, 2.0**-7, 2.0**3
    old = case.system
    spring = mass / time**2
    force, of_speed, of_place, of_lags = old.lags()
    system = exact.System(
        M=old.M * mass,
        C=old.C * (mass / time),
        K=old.K * spring,
        contacts=tuple(
            replace(c, K_c=c.K_c * spring, j_1=c.j_1 * length, j_2=c.j_2 * length)
            for c in old.contacts
        ),
        harmonics=tuple(replace(h, p=h.p * (spring * length)) for h in old.harmonics),
        D=force * spring,
        E=of_speed,
        G=of_place / time,
        H=of_lags / time,
    )
    scaled = Case(
        system,
        case.omega / time,
        case.q_0 * length,
        case.v_0 * (length / time),
        case.z_0 * length,
        case.t_end * time,
    )
    run, same = case.run(tangent=True), scaled.run(tangent=True, atol=1e-15 * length)
    assert same_bits(same.q_end, run.q_end * length)
    assert same_bits(same.v_end, run.v_end * (length / time))
    assert same_bits(same.z_end, run.z_end * length)
    assert same.n_steps == run.n_steps


def test_the_order_of_contacts_does_not_matter(case):
    contacts = case.system.contacts[::-1]
    turned = replace(case, system=replace(case.system, contacts=contacts)).run(tangent=True)
    run = case.run(tangent=True)
    assert turned.n_contacts == run.n_contacts
    assert relative(turned.q_end, run.q_end) < case.allowed


def test_a_point_is_the_same_alone_and_in_company(case):
    rng = np.random.default_rng(2)
    system, laws = as_gapsweep(case.system)
    n, size = case.system.n, np.abs(case.q_0).max()
    starts = np.vstack([rng.uniform(-2.0, 2.0, (30, n)) * size, case.q_0])
    omega = np.append(rng.uniform(0.5, 2.0, 30), 1.0) * case.omega
    given = {"v_0": case.v_0, "z_0": case.z_0, "t_end": case.t_end}
    tight = {"rtol": 1e-12, "atol": 1e-15, "tangent": True}
    many = gs.simulate(system, laws, omega, q_0=starts, **given, **tight)
    alone = case.run(tangent=True)
    assert many.q_end.shape == (31, n)
    for found, expected in (
        (many.q_end, alone.q_end),
        (many.v_end, alone.v_end),
        (many.z_end, alone.z_end),
    ):
        assert same_bits(found[-1], expected)
    assert same_bits(many.monodromy[-1], alone.monodromy)
    for name, extrema in alone.extrema.items():
        assert same_bits(many.extrema[-1][name], extrema)


# ---------------------------------------------------------------- starts


def rest(case, **changes):
    """A case without any load, from rest at the origin; `changes` are of its system."""
    n = case.system.n
    system = replace(
        case.system,
        harmonics=(exact.Harmonic(np.zeros(n)),),
        **{"C": 0.1 * case.system.C} | changes,
    )
    return replace(case, system=system, q_0=np.zeros(n), v_0=np.zeros(n), z_0=np.zeros(LAGS))


def test_what_only_lags_push_moves(case):
    pushed = replace(rest(case), z_0=np.array([1e-3, 0.0]))
    assert pushed.wrong(pushed.run(tangent=True)) == ""


def test_what_a_lag_pushes_through_another_moves(case):
    decay = np.abs(case.system.H).max()
    chain = rest(
        case,
        D=case.system.D * [1.0, 0.0],
        E=0.0 * case.system.E,
        G=0.0 * case.system.G,
        H=decay * np.array([[-1.0, 1.0], [0.0, -1.0]]),
    )
    pushed = replace(chain, z_0=np.array([0.0, 1e-3]))
    assert pushed.wrong(pushed.run(tangent=True)) == ""


def test_springs_that_only_circulate_move_a_start_at_rest(case):
    skew = np.triu(case.system.K, 1)
    circulating = rest(case, K=skew - skew.T, C=10.0 * case.system.C)
    far = max(max(c.j_1, c.j_2) for c in case.system.contacts)
    pushed = replace(circulating, q_0=far * np.array([0.3, -0.2, 0.1]), t_end=0.3 * case.t_end)
    assert pushed.wrong(pushed.run(tangent=True)) == ""


def test_rest_stays_rest(case):
    run = rest(case).run(tangent=True)
    assert run.status == gs.Status.OK
    assert not run.q_end.any()
    assert not run.v_end.any()


# ---------------------------------------------------------------- records


def test_samples_sections_and_contacts_lie_on_the_motion(case):
    run = case.run(tangent=True, dense_output=True)
    times = np.linspace(0.0, case.t_end, 7)
    q, v, z = run.sample(times)
    assert same_bits(q[0], case.q_0)
    assert relative(q[-1], run.q_end) < 1e-14
    assert relative(z[-1], run.z_end) < 1e-14
    for t, *state in zip(times[1:], q[1:], v[1:], strict=True):
        truth = replace(case, t_end=t).truth
        assert relative(np.array(state), np.array([truth.q, truth.v])) < case.allowed
    periods = np.arange(1, int(case.t_end * case.omega) + 1) / case.omega
    assert relative(run.section, np.hstack(run.sample(periods))) < 1e-12
    found = np.sort(np.concatenate(list(run.t_contacts.values())))
    truth = np.array([crossing.t for crossing in case.truth.crossings])
    np.testing.assert_allclose(found, truth, rtol=0.0, atol=case.allowed * case.t_end)
    for number, (name, times) in enumerate(run.t_contacts.items()):
        assert name == f"contact {number}"
        assert len(times) == sum(c.contact == number for c in case.truth.crossings)


def test_what_is_not_forced_passes_its_section_at_maxima_of_its_first_coordinate(case):
    system, laws = as_gapsweep(rest(case).system)
    free = replace(system, forcing=[gs.Harmonic(amplitude=np.zeros(3), k=0)] * 3)
    tight = {"rtol": 1e-12, "atol": 1e-15, "tangent": True}
    starts = np.stack([case.q_0, -case.q_0])
    many = gs.simulate(free, laws, q_0=starts, v_0=case.v_0, t_end=case.t_end, **tight)
    assert (many.n_contacts > 0).all()
    for section, extrema in zip(many.section, many.extrema, strict=True):
        assert (section[:, 3] == 0.0).all()
        # Every other extremum is a maximum.
        both = [extrema["q_1"][k::2] for k in (0, 1)]
        largest = max(both, key=lambda values: values.mean())
        np.testing.assert_allclose(section[:, 0], largest, atol=1e-13)
    run = gs.simulate(
        free, laws, q_0=case.q_0, v_0=case.v_0, t_end=case.t_end, dense_output=True, **tight
    )
    near = np.abs(run.extrema["q_1"][:, None] - many.section[0][:, 0]).min(axis=1)
    t = run.t_extrema["q_1"][near < 1e-12]
    np.testing.assert_allclose(np.hstack(run.sample(t)), many.section[0], atol=1e-9)


def test_extrema_of_every_coordinate_are_complete(case):
    run = case.run(tangent=True, dense_output=True)
    times = np.linspace(0.0, case.t_end, 200_001)
    q, v, _ = run.sample(times)
    assert list(run.extrema) == ["q_1", "q_2", "q_3"]
    for i, (name, extrema) in enumerate(run.extrema.items()):
        turns = np.flatnonzero(v[1:, i] * v[:-1, i] < 0.0)
        moments = run.t_extrema[name]
        assert len(turns) == len(extrema) == len(moments)
        assert np.all((times[turns] <= moments) & (moments <= times[turns + 1]))
        np.testing.assert_allclose(extrema, q[turns, i], atol=1e-4 * np.abs(q[:, i]).max())


# ---------------------------------------------------------------- oscillators, cubes, modulation


# Of no depth: one kernel serves this test and those of periodic stiffness.
STEADY = {"a": [gs.Modulation(depth=0.0)] * 2, "b": [gs.Modulation(depth=0.0)]}


def test_uncoupled_oscillators_move_as_each_alone():
    ones = [
        gs.Oscillator(),
        gs.Oscillator(zeta=0.05, omega_n=3.0, mass=0.5, alpha=-1e6, forcing=0.3),
    ]
    laws = [
        gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3)),
        gs.Piecewise(2e3, gs.Gap(0.0, 1e-3)),
    ]
    system = gs.System(
        mass=np.diag([o.mass for o in ones]),
        damping=np.diag([2.0 * o.mass * o.decay_rate for o in ones]),
        stiffness=np.diag([o.mass * o.omega_n_rad**2 for o in ones]),
        contacts={"a": [1.0, 0.0], "b": [0.0, 1.0]},
        cubic=[gs.Cubic(along=row, alpha=o.alpha) for row, o in zip(np.eye(2), ones, strict=True)],
        forcing=[gs.Harmonic(amplitude=[o.forcing for o in ones])],
        modulation=STEADY,
    )
    given = {"omega": 7.0, "t_end": 1.5, "rtol": 1e-12, "atol": 1e-16, "tangent": True}
    both = gs.simulate(system, dict(zip("ab", laws, strict=True)), q_0=[1e-4, -2e-4], **given)
    parts = [
        gs.simulate(one, law, x_0=x_0, **given)
        for one, law, x_0 in zip(ones, laws, (1e-4, -2e-4), strict=True)
    ]
    for i, part in enumerate(parts):
        assert both.q_end[i] == pytest.approx(part.x_end, rel=1e-9)
        assert both.v_end[i] == pytest.approx(part.v_end, rel=1e-9)
        assert len(both.t_contacts["ab"[i]]) == part.n_contacts > 0
        assert len(both.extrema[f"q_{i + 1}"]) == len(part.extrema)


# Two masses with cubic springs, of which one softens, between stops of periodic stiffness.
MASS, DAMPING = np.array([[2.0, 0.1], [0.1, 1.0]]), np.array([[0.3, -0.1], [-0.2, 0.4]])
STIFFNESS = np.array([[500.0, -100.0], [-80.0, 300.0]])
ALONG, ALPHA = np.array([[1.0, 0.0], [1.0, -1.0]]), np.array([4e6, -1e5])
DIRECTIONS, K_C, WALLS = (
    np.array([[1.0, -1.0], [0.0, 1.0]]),
    2e3,
    np.array([[-3e-3, 1e-3], [-2e-3, 2e-3]]),
)
LOAD, OMEGA = np.array([1.0, 0.5]), 2.0
DEPTHS = ([(0.4, 2, 0.3), (0.2, 3, -1.0)], [(-0.9, 1, 2.0)])  # depth, k, phase of either stop
SYSTEM = gs.System(
    mass=MASS,
    damping=DAMPING,
    stiffness=STIFFNESS,
    contacts=dict(zip("ab", DIRECTIONS, strict=True)),
    cubic=[gs.Cubic(along=a, alpha=alpha) for a, alpha in zip(ALONG, ALPHA, strict=True)],
    forcing=[gs.Harmonic(amplitude=LOAD)],
    modulation={
        name: [gs.Modulation(depth=d, k=k, phase=phase) for d, k, phase in terms]
        for name, terms in zip("ab", DEPTHS, strict=True)
    },
)
LAWS = {
    name: gs.Piecewise(K_C, gs.Gap(-lo, hi)) for name, (lo, hi) in zip("ab", WALLS, strict=True)
}
T_END = 1.7


@pytest.mark.parametrize("engine", ["compiled", "scipy"])
def test_inertial_loads_grow_with_the_square_of_their_frequency(engine):
    """One system at several frequencies, as systems made for each."""
    omega, k, tolerance = np.array([1.5, 2.0]), 2, {"rtol": 1e-10, "atol": 1e-12}
    how = {"engine": engine, "t_end": 0.5, "q_0": [2e-3, 0.0], **tolerance}
    load = gs.Harmonic(amplitude=1e-3 * LOAD, k=k, phase=0.4, inertial=True)
    inertial = gs.simulate(replace(SYSTEM, forcing=[load]), LAWS, omega, **how)
    for i, rate in enumerate(2.0 * np.pi * k * omega):
        plain = gs.Harmonic(amplitude=1e-3 * LOAD * rate**2, k=k, phase=0.4)
        alone = gs.simulate(replace(SYSTEM, forcing=[plain]), LAWS, omega[i], **how)
        np.testing.assert_allclose(inertial.q_end[i], alone.q_end, rtol=0, atol=1e-10)
        assert inertial.n_contacts[i] == alone.n_contacts > 0


def by_runge_kutta(q_0, v_0):
    """End state and number of crossings by DOP853, anew from every crossing."""
    inverse, modes = np.linalg.inv(MASS), [0, 0]

    def slope(t, y):
        q, v = y[:2], y[2:]
        force = LOAD * np.cos(2.0 * np.pi * OMEGA * t) - DAMPING @ v - STIFFNESS @ q
        force = force - (ALPHA * (ALONG @ q) ** 3) @ ALONG
        for mode, b, walls, terms in zip(modes, DIRECTIONS, WALLS, DEPTHS, strict=True):
            if mode:
                share = 1.0 + sum(
                    d * np.cos(2.0 * np.pi * k * OMEGA * t + phase) for d, k, phase in terms
                )
                force = force - share * K_C * (b @ q - walls[(mode + 1) // 2]) * b
        return np.concatenate([v, inverse @ force])

    def exit_over(i, side):
        def margin(t, y):
            return DIRECTIONS[i] @ y[:2] - WALLS[i, (side + 1) // 2]

        margin.terminal, margin.direction = True, side if modes[i] == 0 else -side
        return margin

    t, y, count = 0.0, np.concatenate([q_0, v_0]), 0
    while True:
        ways = [(i, side) for i, mode in enumerate(modes) for side in ([mode] if mode else [1, -1])]
        events = [exit_over(*way) for way in ways]
        run = solve_ivp(
            slope, (t, T_END), y, "DOP853", events=events, rtol=1e-13, atol=1e-17, max_step=4e-3
        )
        t, y = run.t[-1], run.y[:, -1]
        if run.status == 0:
            return y, count
        for (i, side), times in zip(ways, run.t_events, strict=True):
            if times.size:
                modes[i] = side if modes[i] == 0 else 0
                count += 1


def simulated(q_0, v_0):
    tight = {"rtol": 1e-12, "atol": 1e-16, "tangent": True}
    return gs.simulate(SYSTEM, LAWS, OMEGA, q_0=q_0, v_0=v_0, t_end=T_END, **tight)


def test_cubes_and_periodic_stiffness_agree_with_runge_kutta():
    for q_0, v_0 in (([0.0, 0.0], [0.0, 0.0]), ([2e-4, -3e-4], [0.05, 0.1])):
        run = simulated(q_0, v_0)
        state, count = by_runge_kutta(q_0, v_0)
        assert run.n_contacts == count > 10
        allowed = TOLERANCE * max(1.0, np.linalg.norm(run.monodromy, 2))
        assert relative(run.q_end, state[:2]) < allowed
        assert relative(run.v_end, state[2:]) < allowed


def test_monodromy_of_cubes_and_periodic_stiffness_is_the_derivative():
    start = np.array([2e-4, -3e-4, 0.05, 0.1])
    run = simulated(start[:2], start[2:])
    sizes = np.array([1e-8, 1e-8, 1e-6, 1e-6])
    for j, step in enumerate(np.diag(sizes)):
        ends = [simulated(*np.split(start + sign * step, 2)) for sign in (1.0, -1.0)]
        ahead, behind = (np.concatenate([end.q_end, end.v_end]) for end in ends)
        column = (ahead - behind) / (2.0 * sizes[j])
        assert relative(run.monodromy[:, j], column) < 1e-4
    trace = -T_END * np.trace(np.linalg.solve(MASS, DAMPING))
    assert np.log(np.linalg.det(run.monodromy)) == pytest.approx(trace, abs=1e-8)


def test_a_start_on_a_wall_that_only_lags_push_from_is_no_contact():
    """The third derivative of the first gap is the first that is not zero, and points inward."""
    truth = exact.System(
        M=np.eye(2),
        C=0.1 * np.eye(2),
        K=np.diag([4.0, 9.0]),
        contacts=(
            exact.Contact(np.array([1.0, 0.0]), 100.0, 0.0, 0.1),
            exact.Contact(np.array([0.0, 1.0]), 100.0, 0.1, 0.1),
        ),
        D=np.array([[0.5], [0.0]]),
        E=np.zeros((1, 2)),
        G=np.array([[0.0, 2.0]]),
        H=np.array([[-2.0]]),
    )
    q_0 = np.array([0.0, 0.05])
    crossings = exact.motion(truth, 0.0, q_0, np.zeros(2), np.zeros(1), 10.0).crossings
    system = gs.System(
        mass=truth.M,
        damping=truth.C,
        stiffness=truth.K,
        contacts={"a": [1.0, 0.0], "b": [0.0, 1.0]},
        lags=gs.Lags(*truth.lags()),
    )
    gaps = {"a": gs.Gap(0.0, 0.1), "b": gs.Gap(0.1, 0.1)}
    laws = {name: gs.Piecewise(100.0, gap) for name, gap in gaps.items()}
    run = gs.simulate(system, laws, q_0=q_0, t_end=10.0)
    assert run.n_contacts == sum(map(len, run.t_contacts.values())) == len(crossings)


@pytest.mark.parametrize("start", [1.0, 1.0 - 1e-9, 1.0 + 1e-9])
def test_a_mass_in_equilibrium_on_its_wall_stays_there_and_lets_the_others_move(start):
    """Its gap is its wall for ever, up to rounding, while another mass swings."""
    system = gs.System(
        mass=np.eye(2),
        damping=np.diag([0.3, 0.0]),
        stiffness=np.diag([1.0, 4.0]),
        contacts={"stop": [1.0, 0.0]},
        forcing=[gs.Harmonic(k=0, amplitude=[1.0, 0.0])],
    )
    law = gs.Piecewise(100.0, gs.Gap(1.0, 1.0))
    run = gs.simulate(system, law, q_0=[start, 0.5], t_end=50.0, rtol=1e-10, atol=1e-13)
    assert run.status == gs.Status.OK
    assert run.q_end == pytest.approx([1.0, 0.5 * np.cos(100.0)], abs=1e-8)


def test_a_contact_without_a_gap_that_rests_on_its_walls_is_a_spring():
    """From rest nothing but its tangent shows it."""
    system = gs.System(
        mass=np.eye(2),
        damping=0.5 * np.eye(2),
        stiffness=np.diag([80.0, 20.0]),
        contacts={"hold": [0.0, 1.0]},
        forcing=[gs.Harmonic(amplitude=[1.0, 0.0])],
    )
    law = gs.Piecewise(100.0, gs.Gap(0.0, 0.0))
    run = gs.simulate(system, law, 2.0, t_end=0.5, tangent=True, rtol=1e-11)
    expected = scipy.linalg.expm(0.5 * np.array([[0.0, 1.0], [-120.0, -0.5]]))
    assert run.monodromy[np.ix_([1, 3], [1, 3])] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("K_c", [1e3, 1e8])
@pytest.mark.parametrize("j_2", [0.1, 1e3])
def test_masses_that_touch_and_move_alike_move_as_one(K_c, j_2):
    """The wall between them is passed by rounding alone, on and on; it does nothing."""
    system = gs.System(
        mass=np.eye(2),
        damping=0.5 * np.eye(2),
        stiffness=[[300.0, -100.0], [-100.0, 300.0]],
        contacts={"stop": [1.0, -1.0]},
        forcing=[gs.Harmonic(amplitude=[1.3, 1.3])],
    )
    one = gs.System(
        mass=[[1.0]], damping=[[0.5]], stiffness=[[200.0]], forcing=[gs.Harmonic(amplitude=[1.3])]
    )
    law, free = gs.Piecewise(K_c, gs.Gap(0.0, j_2)), gs.Piecewise(0.0, gs.Gap(1.0, 1.0))
    how = {"t_end": 40.0, "rtol": 1e-11, "atol": 1e-13}
    run = gs.simulate(system, law, 2.5, q_0=[0.013, 0.013], **how)
    alone = gs.simulate(one, free, 2.5, q_0=[0.013], **how)
    assert run.status == gs.Status.OK
    assert run.q_end == pytest.approx([alone.q_end[0], alone.q_end[0]], abs=1e-9)


def test_walls_at_one_place_are_passed_at_once_and_no_step_underflows():
    """Crossings of three contacts next to zero; what is unclear of one must not cut the step."""
    system = gs.System(
        mass=[[1.0]],
        stiffness=[[200.0]],
        damping=[[0.4]],
        contacts={"a": [-0.43], "b": [1.0], "c": [1.0]},
        forcing=[gs.Harmonic(amplitude=[-0.28])],
    )
    laws = {
        "a": gs.Piecewise(1e3, gs.Gap(0.01, 0.0)),
        "b": gs.Piecewise(2e4, gs.Gap(0.01, 0.01)),
        "c": gs.Piecewise(2.7e5, gs.Gap(0.0, 0.01)),
    }
    q_0 = np.linspace(-0.02, 0.02, 300)[:, None]
    run, tight = (
        gs.simulate(system, laws, 0.73, q_0=q_0, v_0=[5.0], t_end=2.0, rtol=rtol, atol=1e-14)
        for rtol in (1e-9, 1e-11)
    )
    assert (run.status == gs.Status.OK).all()
    assert run.n_contacts.mean() == pytest.approx(tight.n_contacts.mean(), rel=2e-3)
