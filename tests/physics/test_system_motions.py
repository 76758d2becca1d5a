"""Systems of several coordinates: against closed forms, other integrators and invariants."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from tests.builders.random_systems import LAGS, random_case
from tests.oracles import piecewise_linear as exact

import gapsweep as gs

HARD = gs.Piecewise(2e3, gs.Gap(4e-4, 4e-4))


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
    ("n", "n_contacts", "count", "tangent"),
    [
        (2, 1, 4, True),
        pytest.param(3, 2, 4, True, marks=pytest.mark.extended),
        pytest.param(6, 3, 1, False, marks=pytest.mark.extended),
    ],
)
def test_random_systems_move_as_matrix_exponentials_say(n, n_contacts, count, tangent):
    for case in solvable(n, n_contacts, count):
        run = case.run(tangent=tangent)
        assert case.wrong(run) == "", case


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


# ---------------------------------------------------------------- contacts that are not located


def two_masses():
    """Each with a stop, and nothing between them."""
    return gs.System(
        mass=np.diag([3.0, 2.0]),
        stiffness=np.diag([3e3, 4e3]),
        damping=np.diag([5.0, 8.0]),
        contacts={"stop": [1.0, 0.0], "wall": [0.0, 1.0]},
        forcing=[gs.Harmonic(amplitude=[4.0, 6.0])],
    )


def test_a_table_that_one_contact_leaves_is_named_by_the_status():
    table = gs.ForceTable((-4e-3, -4e-4, 4e-4, 4e-3), (-60.0, 0.0, 0.0, 50.0))
    laws = {"stop": gs.Tanh(1.4e4, gs.Gap(4e-4, 4e-4), 1e4), "wall": table}
    runs = [
        gs.simulate(two_masses(), laws, 5.0, q_0=[3e-4, x], t_end=0.05).status for x in (3e-3, 5e-3)
    ]
    assert runs == [gs.Status.OK, gs.Status.OUT_OF_FIT_RANGE]


@pytest.mark.parametrize(
    ("law", "options", "named"),
    [
        ({"stop": HARD, "wall": gs.Tanh(2e3, HARD.gap, 1e4)}, {}, "all"),
        (HARD, {"restart": True}, "restart"),
        (HARD, {"controller": "ode45"}, "ode45"),
        (HARD, {"contact_force": "as_written"}, "contact_force = 'as_written': needs"),
    ],
)
def test_what_has_no_compiled_steps_is_refused(law, options, named):
    with pytest.raises(gs.ModelError, match=named):
        gs.simulate(two_masses(), law, 3.0, t_end=1.0, **options)
