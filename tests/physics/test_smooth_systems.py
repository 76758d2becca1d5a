"""Systems whose contacts are not located: against other integrators, closed forms, invariants."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq

import gapsweep as gs

TIGHT = {"rtol": 1e-11, "atol": 1e-14}
W = 2.0 * math.pi
STOP, WALL = gs.Gap(1e-3, 2e-3), gs.Gap(3e-3, 1e-3)
LAWS = {"stop": gs.Tanh(2e3, STOP, 3e3), "wall": gs.LogArctan(1e3, WALL, 2e3, K_ratio=0.4)}
START = {"q_0": [1e-3, -2e-3], "v_0": [0.01, 0.02], "z_0": [1e-3]}


def hardening(x):
    return 900.0 * x + 4e7 * x * x * x


def machine(change=((1.0, 0.0), (0.0, 1.0))):
    """Two masses with all that a system may have, in any coordinates q = change p."""
    turn = np.array(change)
    return gs.System(
        mass=turn.T @ np.diag([1.0, 0.5]) @ turn,
        damping=turn.T @ [[0.8, -0.2], [-0.1, 0.5]] @ turn,
        stiffness=turn.T @ [[400.0, -150.0], [-120.0, 300.0]] @ turn,
        contacts={"stop": np.array([1.0, -1.0]) @ turn, "wall": np.array([0.0, 1.0]) @ turn},
        cubic=[gs.Cubic(along=np.array([1.0, 0.3]) @ turn, alpha=1e5)],
        forcing=[
            gs.Harmonic(amplitude=turn.T @ [3.0, 1.0], phase=0.3),
            gs.Harmonic(amplitude=turn.T @ [0.3, 0.0], k=0),
        ],
        modulation={"stop": [gs.Modulation(depth=0.3, k=2, phase=0.2)]},
        lags=gs.Lags(
            turn.T @ [[3.0], [1.0]],
            np.array([[0.1, 0.0]]) @ turn,
            np.array([[1.0, 2.0]]) @ turn,
            [[-8.0]],
        ),
    )


def tanh_force(x, K_c, gap, eps):
    below, above = x + gap.j_1, x - gap.j_2
    near = 0.5 * (1.0 - math.tanh(eps * below)) * below
    return K_c * (near + 0.5 * (1.0 + math.tanh(eps * above)) * above)


def logarctan_slope(x, K_c, gap, gamma, ratio):
    angles = math.atan(gamma * (x - gap.j_2)) - ratio * math.atan(gamma * (x + gap.j_1))
    return K_c * (0.5 * (1.0 + ratio) + angles / math.pi)


def by_hand(t, y, omega):
    """The machine's equation, written out; y holds the log-arctan force as its own state."""
    x_1, x_2, v_1, v_2, z, wall = y
    theta = W * omega * t
    stop = (1.0 + 0.3 * math.cos(2.0 * theta + 0.2)) * tanh_force(x_1 - x_2, 2e3, STOP, 3e3)
    cube = 1e5 * (x_1 + 0.3 * x_2) ** 3
    drive = math.cos(theta + 0.3)
    return (
        v_1,
        v_2,
        3.0 * drive + 0.3 - 0.8 * v_1 + 0.2 * v_2 - 400.0 * x_1 + 150.0 * x_2 - 3.0 * z
        - cube - stop,
        2.0 * (drive + 0.1 * v_1 - 0.5 * v_2 + 120.0 * x_1 - 300.0 * x_2 - z
               - 0.3 * cube + stop - wall),
        0.1 * v_1 + x_1 + 2.0 * x_2 - 8.0 * z,
        logarctan_slope(x_2, 1e3, WALL, 2e3, 0.4) * v_2,
    )  # fmt: skip


def solved(omega, t_end, events=()):
    start = [*START["q_0"], *START["v_0"], *START["z_0"]]
    wall = float(LAWS["wall"].force(start[1]))
    return solve_ivp(
        by_hand, (0.0, t_end), [*start, wall], args=(omega,), method="DOP853",
        rtol=1e-13, atol=1e-16, events=events, max_step=5e-3,
    )  # fmt: skip


@pytest.fixture(scope="module")
def motion():
    return gs.simulate(machine(), LAWS, 3.5, t_end=1.5, tangent=True, **START, **TIGHT)


def test_a_motion_is_that_of_the_equation_written_out(motion):
    truth = solved(3.5, 1.5).y[:5, -1]
    assert motion.status == gs.Status.OK
    assert_allclose([*motion.q_end, *motion.v_end, *motion.z_end], truth, rtol=0.0, atol=2e-8)
    assert_allclose(motion.q_end, truth[:2], rtol=0.0, atol=1e-9)


def test_its_events_are_those_of_the_equation(motion):
    def of(function):
        return lambda t, y, omega: function(y)

    events = [
        of(lambda y: y[2]), of(lambda y: y[3]),
        of(lambda y: y[0] - y[1] + STOP.j_1), of(lambda y: y[0] - y[1] - STOP.j_2),
        of(lambda y: y[1] + WALL.j_1), of(lambda y: y[1] - WALL.j_2),
    ]  # fmt: skip
    truth = solved(3.5, 1.5, events)
    for i, name in enumerate(("q_1", "q_2")):
        assert_allclose(motion.t_extrema[name], truth.t_events[i], atol=1e-7)
        assert_allclose(motion.extrema[name], truth.y_events[i][:, i], atol=1e-9)
    for i, name in enumerate(("stop", "wall")):
        passings = np.sort(np.concatenate(truth.t_events[2 + 2 * i : 4 + 2 * i]))
        assert len(passings) > 3
        assert_allclose(motion.t_contacts[name], passings, atol=1e-7)
    assert motion.n_contacts == sum(map(len, truth.t_events[2:]))
    at_periods = np.array([solved(3.5, k / 3.5).y[:5, -1] for k in (1, 5)])
    assert motion.section.shape == (5, 5)
    assert_allclose(motion.section[[0, 4]], at_periods, rtol=0.0, atol=2e-8)


def test_its_tangent_is_that_of_its_neighbours(motion):
    start = np.array([*START["q_0"], *START["v_0"], *START["z_0"]])
    for column, d in enumerate((1e-8, 1e-8, 1e-7, 1e-7, 1e-7)):
        ends = []
        for sign in (1.0, -1.0):
            y = start + sign * d * np.eye(5)[column]
            given = {"q_0": y[:2], "v_0": y[2:4], "z_0": y[4:]}
            end = gs.simulate(machine(), LAWS, 3.5, t_end=1.5, **given, **TIGHT)
            ends.append(np.concatenate([end.q_end, end.v_end, end.z_end]))
        slope = (ends[0] - ends[1]) / (2.0 * d)
        scale = np.abs(motion.monodromy[:, column]).max()
        assert_allclose(slope, motion.monodromy[:, column], rtol=0.0, atol=1e-4 * scale)
    # Volumes shrink as the linear part says, whatever the contacts do.
    trace = -(0.8 / 1.0 + 0.5 / 0.5 + 8.0)
    assert np.linalg.det(motion.monodromy) == pytest.approx(math.exp(1.5 * trace), rel=1e-5)


def test_its_samples_lie_on_it(motion):
    run = gs.simulate(machine(), LAWS, 3.5, t_end=1.5, dense_output=True, **START, **TIGHT)
    t = np.array([0.0, 0.4, 1.0 / 3.5, 1.5])
    q, v, z = run.sample(t)
    # Whose steps are not cut for a tangent.
    end = gs.simulate(machine(), LAWS, 3.5, t_end=1.5, **START, **TIGHT)
    assert_allclose(q[-1], end.q_end, rtol=0.0, atol=1e-12)
    assert_allclose([*q[2], *v[2], *z[2]], motion.section[0], rtol=0.0, atol=1e-9)
    middle = solved(3.5, 0.4).y[:5, -1]
    assert_allclose([*q[1], *v[1], *z[1]], middle, rtol=0.0, atol=1e-8)


def test_other_coordinates_give_the_same_motion(motion):
    change = np.array([[1.0, 0.4], [-0.3, 0.8]])
    back = np.linalg.inv(change)
    start = {"q_0": back @ START["q_0"], "v_0": back @ START["v_0"], "z_0": START["z_0"]}
    turned = gs.simulate(machine(change), LAWS, 3.5, t_end=1.5, **start, **TIGHT)
    assert_allclose(change @ turned.q_end, motion.q_end, rtol=0.0, atol=1e-9)
    assert_allclose(change @ turned.v_end, motion.v_end, rtol=0.0, atol=2e-8)
    assert turned.n_contacts == motion.n_contacts
    assert_allclose(turned.t_contacts["wall"], motion.t_contacts["wall"], atol=1e-7)


def test_company_changes_no_bit():
    omega = np.linspace(2.0, 8.0, 19)
    options = {"t_end": 1.0, "tangent": True, **START}
    together = gs.simulate(machine(), LAWS, omega, **options)
    for k in (0, 9, 18):
        alone = gs.simulate(machine(), LAWS, omega[k], **options)
        assert np.array_equal(alone.q_end, together.q_end[k])
        assert np.array_equal(alone.monodromy, together.monodromy[k])
        assert np.array_equal(alone.t_contacts["stop"], together.t_contacts[k]["stop"])


def test_errors_follow_the_tolerance():
    exact = gs.simulate(machine(), LAWS, 3.5, t_end=1.0, rtol=1e-13, atol=1e-16, **START)
    errors = []
    for rtol in (1e-4, 1e-6, 1e-8, 1e-10):
        run = gs.simulate(machine(), LAWS, 3.5, t_end=1.0, rtol=rtol, atol=1e-3 * rtol, **START)
        errors.append(np.abs(run.q_end - exact.q_end).max() / np.abs(exact.q_end).max())
    assert np.all(np.array(errors) < 300.0 * np.array([1e-4, 1e-6, 1e-8, 1e-10]))


def pair(*oscillators, contacts=True):
    """Oscillators side by side, that nothing couples."""
    n = len(oscillators)
    masses = np.array([o.mass for o in oscillators])
    rates = np.array([o.omega_n_rad for o in oscillators])
    return gs.System(
        mass=np.diag(masses),
        damping=np.diag([2.0 * o.zeta * o.omega_n_rad * o.mass for o in oscillators]),
        stiffness=np.diag(masses * rates**2),
        cubic=[gs.Cubic(along=a, alpha=o.alpha)
               for a, o in zip(np.eye(n), oscillators, strict=True)],
        contacts={f"stop {i}": np.eye(n)[i] for i in range(n)} if contacts else {},
        forcing=[gs.Harmonic(amplitude=[o.forcing for o in oscillators])],
    )  # fmt: skip


ONE, OTHER = gs.Oscillator(), gs.Oscillator(zeta=0.05, omega_n=7.0, mass=2.0, forcing=6.0)
GAP = gs.Gap(0.4e-3, 0.4e-3)
TABLE = gs.ForceTable((-4e-3, -1e-3, -0.4e-3, 0.4e-3, 1e-3, 4e-3), (-60.0, -9.0, 0, 0, 8.0, 50.0))


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (gs.Tanh(1.4e4, GAP, 1e4), gs.Tanh(3e4, gs.Gap(0.2e-3, 0.5e-3), 5e3)),
        (gs.Arctan(1.4e4, GAP, 1e4), TABLE),
        (gs.Polynomial(1.4e4, GAP, 9), gs.RationalPolynomial(1.4e4, GAP, 3, 2)),
        (gs.law(hardening, 1e3, GAP), gs.Piecewise(1.4e4, GAP, located=False)),
    ],
    ids=["tanh", "arctan and table", "fits", "user and noevents"],
)
def test_an_uncoupled_pair_moves_as_two_oscillators(first, second):
    omega, t_end = np.array([4.0, 9.0, 12.5]), 0.6
    together = gs.simulate(
        pair(ONE, OTHER), {"stop 0": first, "stop 1": second}, omega, t_end=t_end, **TIGHT
    )
    for i, (oscillator, law) in enumerate(((ONE, first), (OTHER, second))):
        alone = gs.simulate(oscillator, law, omega, t_end=t_end, **TIGHT)
        assert not alone.status.any()
        atol = 1e-9 if getattr(law, "located", True) else 1e-7  # its kinks are stepped over
        assert_allclose(together.q_end[:, i], alone.x_end, rtol=0.0, atol=atol)
        assert_allclose(together.v_end[:, i], alone.v_end, rtol=0.0, atol=50.0 * atol)
        for k in range(3):
            found = together.t_contacts[k][f"stop {i}"]
            assert_allclose(found, alone.t_contacts[k], atol=1e-5)
            assert_allclose(together.extrema[k][f"q_{i + 1}"], alone.extrema[k], atol=2 * atol)


def test_a_system_without_gaps_moves_as_a_matrix_exponential_says():
    """A smoothed contact without a gap is a plain spring."""
    none, K_c = gs.Gap(0.0, 0.0), 700.0
    mass, damping = np.diag([1.0, 0.5]), np.array([[0.8, -0.2], [-0.1, 0.5]])
    springs, b = np.array([[400.0, -150.0], [-120.0, 300.0]]), np.array([1.0, -1.0])
    system = gs.System(
        mass=mass, damping=damping, stiffness=springs, contacts={"stop": b, "wall": [0.0, 1.0]},
        forcing=[
            gs.Harmonic(amplitude=[3.0, 1.0], phase=0.3), gs.Harmonic(amplitude=[0.2, 0.1], k=0)
        ],
    )  # fmt: skip
    laws = {"stop": gs.Tanh(K_c, none, 1e3), "wall": gs.Tanh(300.0, none, 1e3)}
    start, w = np.array([1e-3, -2e-3, 0.01, 0.02]), W * 3.5
    found = gs.simulate(system, laws, 3.5, q_0=start[:2], v_0=start[2:], t_end=2.0, tangent=True,
                        **TIGHT)  # fmt: skip
    whole = springs + K_c * np.outer(b, b) + np.diag([0.0, 300.0])
    pulls = -np.linalg.solve(mass, np.hstack([whole, damping]))
    free = np.vstack([np.hstack([np.zeros((2, 2)), np.eye(2)]), pulls])
    # With cosine, sine and a constant as states of their own.
    loads = np.zeros((4, 3))
    push = np.linalg.solve(mass, [3.0, 1.0])
    loads[2:, 0], loads[2:, 1] = push * math.cos(0.3), -push * math.sin(0.3)
    loads[2:, 2] = np.linalg.solve(mass, [0.2, 0.1])
    turn = np.array([[0.0, -w, 0.0], [w, 0.0, 0.0], [0.0, 0.0, 0.0]])
    flow = expm(2.0 * np.block([[free, loads], [np.zeros((3, 4)), turn]]))
    end = flow @ [*start, 1.0, 0.0, 1.0]
    assert_allclose([*found.q_end, *found.v_end], end[:4], rtol=0.0, atol=1e-9)
    assert_allclose(found.monodromy, flow[:4, :4], rtol=0.0, atol=1e-7)


def test_a_thin_layer_is_not_stepped_over():
    omega, start = 3.5, {"q_0": START["q_0"], "v_0": START["v_0"]}
    system = pair(ONE, OTHER)
    exact = gs.simulate(system, gs.Piecewise(1.4e6, GAP), omega, t_end=0.5, **start, **TIGHT)
    thin = gs.simulate(system, gs.Tanh(1.4e6, GAP, 1e9), omega, t_end=0.5, rtol=1e-7, **start)
    assert exact.n_contacts == thin.n_contacts > 20
    assert_allclose(thin.q_end, exact.q_end, rtol=0.0, atol=1e-5 * np.abs(exact.q_end).max())


def test_a_table_that_one_contact_leaves_is_named_by_the_status():
    laws = {"stop 0": gs.Tanh(1.4e4, GAP, 1e4), "stop 1": TABLE}
    runs = [
        gs.simulate(pair(ONE, OTHER), laws, 5.0, q_0=[3e-4, x], t_end=0.05).status
        for x in (3e-3, 5e-3)
    ]
    assert runs == [gs.Status.OK, gs.Status.OUT_OF_FIT_RANGE]


# Steady responses.


def coupled():
    return gs.System(
        mass=np.diag([1.0, 0.5]),
        damping=[[0.8, -0.2], [-0.2, 0.5]],
        stiffness=[[400.0, -150.0], [-150.0, 300.0]],
        contacts={"stop": [1.0, -1.0], "wall": [0.0, 1.0]},
        forcing=[gs.Harmonic(amplitude=[3.0, 1.0])],
    )


COUPLED = {"stop": gs.Tanh(2e3, STOP, 3e3), "wall": gs.Tanh(2e3, gs.Gap(5e-3, 5e-3), 3e3)}


def test_responses_are_where_brute_force_settles():
    system, omega = coupled(), np.linspace(1.0, 8.0, 12)
    found = gs.respond(system, COUPLED, omega)
    settled = gs.simulate(system, COUPLED, omega, t_end=80.0)
    n_checked = 0
    for k in np.flatnonzero(found.response_class == gs.ResponseClass.PERIODIC):
        n = int(found.period_multiple[k])
        # From a whole number of periods on.
        start = settled.section[k][-1]
        run = gs.simulate(system, COUPLED, omega[k], q_0=start[:2], v_0=start[2:],
                          t_end=n / omega[k], dense_output=True)  # fmt: skip
        q = run.sample(np.linspace(0.0, n / omega[k], 4001))[0]
        if np.abs(q[-1] - q[0]).max() > 1e-7:
            continue
        n_checked += 1
        assert_allclose(found.x_max[k], q.max(axis=0), atol=1e-7)
        assert_allclose(found.x_min[k], q.min(axis=0), atol=1e-7)
        multipliers = np.reshape(found.multipliers[k], (-1, 2)) @ [1.0, 1j]
        shrinkage = math.exp(-1.8 * n / omega[k])
        assert_allclose(np.prod(multipliers), shrinkage, rtol=1e-5, atol=1e-12)
    assert n_checked > 5


def test_a_system_of_one_coordinate_responds_as_its_oscillator():
    law, omega = gs.Tanh(1.4e4, GAP, 1e4), np.linspace(4.0, 30.0, 20)
    same = gs.respond(pair(ONE), law, omega, q_0=[1e-4])
    one = gs.respond(ONE, law, omega, same.x_end, same.v_end)
    periodic = one.response_class == gs.ResponseClass.PERIODIC
    assert periodic.sum() > 12
    assert np.array_equal(one.response_class, same.response_class)
    for name in ("x_max", "x_min", "force_max"):
        assert_allclose(getattr(same, name)[periodic], getattr(one, name)[periodic], rtol=1e-6)
    assert_allclose(same.multiplier_abs[periodic], one.multiplier_abs[periodic], atol=1e-6)


def flapping(speed=12.36842):
    """The typical section with its freeplay rounded."""
    exact = gs.systems.typical_section_law("conner-scaled")
    section = gs.systems.typical_section(speed, "conner-scaled")
    return section, gs.Tanh(exact.K_c, exact.gap, 2e3)


def test_returns_of_what_nothing_forces_are_maxima_of_its_first_coordinate():
    section, law = flapping()
    # Long steps, so that a point is not found by the interpolant alone.
    loose = {"rtol": 1e-4, "atol": 1e-7, "dense_output": True}
    run = gs.simulate(section, law, q_0=[0.01, 0.0, 0.0], t_end=3.0, **loose)
    points, names = run.section, section.coordinates
    t = np.linspace(0.0, 3.0, 6001)
    heights = run.sample(t)[0][:, 0]
    maxima = np.flatnonzero((heights[1:-1] > heights[:-2]) & (heights[1:-1] > heights[2:])) + 1
    assert len(points) == len(maxima) > 5
    assert not points[:, section.n].any()
    for point, near in zip(points, maxima, strict=True):

        def speed(at):
            return float(run.sample([at])[1][0, 0])

        at = brentq(speed, t[near - 1], t[near + 1], xtol=1e-15)
        truth = np.concatenate([part[0] for part in run.sample([at])])
        assert_allclose(point, truth, rtol=0.0, atol=1e-10 * np.abs(points).max())
    assert len(run.extrema[names[0]]) >= len(points)


def test_a_limit_cycle_of_a_rounded_freeplay_is_found():
    section, law = flapping()
    found = gs.respond(section, law, q_0=[0.01, 0.0, 0.0])
    assert found.response_class == gs.ResponseClass.PERIODIC
    far = gs.simulate(section, law, q_0=[0.01, 0.0, 0.0], t_end=60.0)
    late = gs.simulate(section, law, q_0=far.q_end, v_0=far.v_end, z_0=far.z_end, t_end=2.0)
    assert_allclose(found.x_max[2], late.extrema["beta"].max(), rtol=1e-5)
    assert_allclose(found.x_min[2], late.extrema["beta"].min(), rtol=1e-5)


@pytest.mark.parametrize(
    ("law", "options", "said"),
    [
        ({"stop": gs.Piecewise(2e3, GAP), "wall": gs.Tanh(2e3, GAP, 1e4)}, {}, "only if all are"),
        (gs.Piecewise(2e3, GAP), {"restart": True}, "restart = true.*of an Oscillator"),
        (gs.Piecewise(2e3, GAP), {"controller": "ode45"}, "'ode45'.*of an Oscillator"),
    ],
)
def test_what_has_no_compiled_steps_is_refused(law, options, said):
    with pytest.raises(gs.ModelError, match=said):
        gs.simulate(coupled(), law, 3.0, t_end=1.0, **options)
