"""`simulate` on the reference engine: events, symmetry, conserved quantities, refusals."""

import math
import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose

import gapsweep as gs
from gapsweep.model.systems import paper_oscillator

SOFT = 1.4e4
SYMMETRIC = gs.Gap(0.4e-3, 0.4e-3)
ASYMMETRIC = gs.Gap(0.0, 0.8e-3)
ENGINES = ("compiled", "scipy")
LOOSE = {"engine": "scipy", "rtol": 1e-4, "atol": 1e-7}


@pytest.fixture(params=ENGINES)
def tight(request):
    """Every engine at tight tolerances: one operation, several engines."""
    return {"engine": request.param, "rtol": 1e-10, "atol": 1e-14}


@pytest.mark.parametrize("wall", [3e-4, 0.0])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("towards", [-math.inf, math.inf])
@pytest.mark.parametrize("v_0", [-0.01, 0.01])
def test_a_start_that_rounding_put_beside_a_wall_is_on_it(wall, sign, towards, v_0):
    law = gs.Piecewise(1e5, gs.Gap(wall, wall))
    start, given = sign * wall, {"omega": 9.0, "v_0": v_0, "t_end": 0.5}
    exact = gs.simulate(paper_oscillator(), law, x_0=start, **given)
    for engine in ("compiled", "scipy"):
        beside = gs.simulate(
            paper_oscillator(), law, x_0=np.nextafter(start, towards), engine=engine,
            rtol=1e-9, atol=1e-12, **given,
        )  # fmt: skip
        assert beside.status == gs.Status.OK
        # The wall itself is passed, or is not, a moment after the start.
        assert abs(beside.n_contacts - exact.n_contacts) <= (1 if wall else 2)
        assert abs(beside.x_end - exact.x_end) < 1e-10


def test_contacts_shorter_than_a_step_are_not_missed(tight):
    # DOP853 at a loose tolerance steps over whole contacts of this scene.
    scene = paper_oscillator(), gs.Piecewise(1.4e3, gs.Gap(0.0, 0.8e-3)), 30.0
    coarse = gs.simulate(*scene, t_end=5.0, engine="scipy", rtol=9.9e-7, atol=1e-6)
    fine = gs.simulate(*scene, t_end=5.0, **tight)
    assert coarse.n_contacts == fine.n_contacts


@pytest.mark.parametrize(
    ("label", "engine"),
    [("piecewise", "compiled"), ("tanh-1e4", "compiled"), ("piecewise", "scipy")],
)
def test_the_history_is_the_motion_and_is_fine_enough_to_plot(label, engine):
    """Its polygon lies within 1 % of the largest displacement of samples at any other time."""
    law, options = gs.contact_law(label, SOFT, SYMMETRIC), {"t_0": 0.5, "t_end": 3.0}
    given = {"x_0": 1e-4, "engine": engine, "dense_output": True, **options}
    run = gs.simulate(paper_oscillator(), law, 25.0, **given)
    assert run.t.shape == run.x.shape == run.v.shape
    assert_allclose([run.t[0], run.t[-1], run.t_end], [0.5, 3.0, 3.0])
    assert_allclose(np.diff(run.t), run.t[1] - run.t[0])
    assert_allclose([run.x[0], run.x[-1], run.v[-1]], [1e-4, run.x_end, run.v_end], rtol=1e-9)
    between = np.random.default_rng(1).uniform(0.5, 3.0, 500)
    for samples, history in zip(run.sample(between), (run.x, run.v), strict=True):
        error = np.abs(np.interp(between, run.t, history) - samples).max()
        assert error < 0.01 * np.abs(history).max()


def test_the_history_of_many_motions_has_their_shape():
    law, given = gs.Piecewise(SOFT, SYMMETRIC), {"t_end": 0.5, "dense_output": True}
    runs = gs.simulate(paper_oscillator(), law, [[7.0], [9.0]], [0.0, 1e-4, 2e-4], **given)
    assert runs.x.shape == runs.v.shape == (2, 3, runs.t.size)
    assert_allclose(runs.x[..., -1], runs.x_end, rtol=1e-9)
    system = gs.System(mass=np.eye(2), stiffness=[[30.0, -10.0], [-10.0, 20.0]])
    run = gs.simulate(system, {}, q_0=[[0.1, 0.0]] * 3, **given)
    assert run.q.shape == run.v.shape == (3, run.t.size, 2)
    assert run.z.shape == (3, run.t.size, 0)
    assert_allclose(run.q[:, -1], run.q_end, rtol=1e-9)
    assert_allclose(run.q, run.sample(run.t)[0])


@pytest.mark.parametrize("name", ["t", "x", "v"])
def test_a_run_without_a_history_says_how_to_keep_one(name):
    run = gs.simulate(paper_oscillator(), gs.Piecewise(SOFT, SYMMETRIC), 9.0, t_end=0.1)
    with pytest.raises(gs.ModelError, match="dense_output=True"):
        getattr(run, name)


def test_a_motion_that_fails_at_once_has_no_history():
    law, given = gs.contact_law("poly-13", SOFT, SYMMETRIC), {"t_end": 1.0, "dense_output": True}
    run = gs.simulate(paper_oscillator(), law, 9.0, [0.0, 1e3], **given)
    with pytest.raises(gs.ModelError, match="first step"):
        _ = run.x
    exact = gs.Piecewise(SOFT, SYMMETRIC)
    run = gs.simulate(paper_oscillator(), exact, 9.0, 1e10, **given)
    with pytest.raises(gs.ModelError, match="first step"):
        _ = run.x


def test_arrays_broadcast_to_many_points():
    law = gs.Piecewise(SOFT, SYMMETRIC)
    runs = gs.simulate(
        paper_oscillator(), law, [[7.0], [9.0]], [0.0, 1e-4, 2e-4], t_end=0.5, **LOOSE
    )
    single = gs.simulate(paper_oscillator(), law, 9.0, 1e-4, t_end=0.5, **LOOSE)
    assert runs.x_end.shape == runs.status.shape == (2, 3)
    assert runs.x_end[1, 1] == single.x_end
    assert_allclose(runs.extrema[1, 1], single.extrema)


def test_run_away_ends_as_diverged():
    softening = paper_oscillator(alpha=-7e8)
    given = {"t_end": 5.0, "dense_output": True, "rtol": 1e-4}
    run = gs.simulate(softening, gs.Piecewise(0.0, SYMMETRIC), 5.0, x_0=5e-3, **given)
    assert run.status is gs.Status.DIVERGED
    assert run.t_end < 5.0
    assert 0.0 < run.t[-1] <= run.t_end  # without the last step
    assert np.isfinite(run.x).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"omega": 0.0}, "omega = 0: must be > 0"),
        ({"omega": math.nan}, "omega = nan: must be finite"),
        ({"x_0": math.inf}, "x_0 = inf: must be finite"),
        ({"t_end": 0.0}, "t_end = 0 s: must be > t_0 = 0 s"),
        ({"rtol": 1.0}, "rtol = 1: must be <= 0.1"),
        ({"rtol": 0.0}, "rtol = 0: must be >= 1e-13"),
        ({"atol": 0.0}, "atol = 0: must be > 0"),
        ({"engine": "magic"}, "engine = 'magic': must be one of"),
        (
            {"omega": [1.0, 2.0], "x_0": [0.0] * 3},
            r"shapes omega \(2,\), x_0 \(3,\), .*omega\[:, None\]",
        ),
    ],
)
def test_bad_arguments_are_refused_by_name(arguments, message):
    given = {"omega": 5.0, "t_end": 1.0} | arguments
    with pytest.raises(gs.ModelError, match=message):
        gs.simulate(paper_oscillator(), gs.Piecewise(SOFT, SYMMETRIC), **given)


MODELS = [
    paper_oscillator(zeta=0.05),
    paper_oscillator(mean_load=0.5, c=2.0),
    paper_oscillator(forcing=9.0),
]
LAWS = [
    gs.Piecewise(SOFT, SYMMETRIC),
    gs.Piecewise(1.4e5, ASYMMETRIC),
    gs.Tanh(SOFT, SYMMETRIC, epsilon=1e4),
]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("law", LAWS, ids=str)
def test_a_number_of_periods_ends_on_the_section(law, engine):
    rng = np.random.default_rng(5)
    n = 3 if engine == "scipy" else 100
    omega, n_periods = rng.uniform(5.0, 30.0, n), rng.integers(1, 9, n)
    runs = gs.simulate(paper_oscillator(), law, omega, n_periods=n_periods, engine=engine)
    assert_allclose(runs.t_end, n_periods / omega, rtol=1e-15)
    for k, section in enumerate(runs.section):
        assert len(section) == n_periods[k]
        end = [runs.x_end[k], runs.v_end[k]]
        if engine == "scipy":  # whose section is read off between steps
            assert_allclose(section[-1], end, rtol=1e-6, atol=1e-9)
        else:
            assert section[-1].tolist() == end
    again = gs.simulate(
        paper_oscillator(), law, omega[0], t_end=n_periods[0] / omega[0], engine=engine
    )
    assert (again.x_end, again.v_end) == (runs.x_end[0], runs.v_end[0])


def test_periods_are_counted_from_the_start():
    given = {"omega": 8.0, "t_0": 0.3, "tangent": True}
    run = gs.simulate(paper_oscillator(), LAWS[0], n_periods=12, **given)
    assert_allclose(run.t_end, 0.3 + 12 / 8.0, rtol=1e-15)
    rate = paper_oscillator().decay_rate
    assert_allclose(np.linalg.det(run.monodromy), math.exp(-2.0 * rate * 12 / 8.0), rtol=1e-6)


def test_several_models_and_laws_give_what_each_gives_alone():
    omega, n_periods = np.array([[9.0], [7.0]]), [20, 30, 10]
    given = {"rtol": 1e-7, "tangent": True}
    runs = gs.simulate(MODELS, LAWS, omega, n_periods=n_periods, **given)
    assert runs.shape == (2, 3)
    for i, j in np.ndindex(2, 3):
        alone = gs.simulate(
            MODELS[j], LAWS[j], omega[i, 0], n_periods=n_periods[j], **given
        )  # fmt: skip
        for name in ("t_end", "x_end", "v_end", "n_steps", "nfev", "monodromy"):
            assert_same(getattr(runs, name)[i, j], getattr(alone, name))
        for name in ("extrema", "t_extrema", "t_contacts", "section", "t_section"):
            assert_same(getattr(runs, name)[i, j], getattr(alone, name))
        assert runs.laws[i, j] == alone.laws


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0)])
def test_walls_with_and_without_losses_stand_in_one_call(order):
    every = [
        gs.HuntCrossley(SOFT, SYMMETRIC, chi=2.0),
        gs.Piecewise(SOFT, SYMMETRIC),
        gs.Rigid(SYMMETRIC, restitution=0.7),
    ]
    laws = [every[i] for i in order]
    runs = gs.simulate(paper_oscillator(), laws, 9.0, t_end=0.5)
    for j, law in enumerate(laws):
        alone = gs.simulate(paper_oscillator(), law, 9.0, t_end=0.5)
        assert_same(runs.x_end[j], alone.x_end)
        assert_same(runs.t_contacts[j], alone.t_contacts)


def test_several_models_can_be_sampled():
    runs = gs.simulate(MODELS, LAWS, 9.0, t_end=1.0, dense_output=True)
    x, _ = runs.sample([0.25, 0.5])
    for j, (model, law) in enumerate(zip(MODELS, LAWS, strict=True)):
        alone = gs.simulate(model, law, 9.0, t_end=1.0, dense_output=True)
        assert_same(x[j], alone.sample([0.25, 0.5])[0])


def test_several_systems_start_from_their_own_states():
    one, law = gs.systems.two_masses(), gs.systems.two_masses_law()
    other = replace(one, damping=2.0 * one.damping)
    q_0 = np.array([[0.1, 0.0], [0.2, -0.1]])
    runs = gs.simulate([one, other], law, 0.6, q_0=q_0, n_periods=[3, 4])
    for k, system in enumerate((one, other)):
        alone = gs.simulate(system, law, 0.6, q_0=q_0[k], n_periods=3 + k)
        assert_same(runs.q_end[k], alone.q_end)
        assert_same(runs.extrema[k], alone.extrema)


def test_extrema_of_a_loaded_oscillator_are_listed_once():
    run = gs.simulate(MODELS[1], LAWS[0], 9.0, t_end=2.0, dense_output=True)
    v = run.sample(np.linspace(1e-3, run.t_end, 20_001))[1]
    assert len(run.extrema) == np.count_nonzero(np.diff(np.sign(v)))
    assert np.all(np.diff(run.t_extrema) > 0.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "t_end = missing: give either, as t_end=10.0 or n_periods=100"),
        ({"t_end": 1.0, "n_periods": 3}, "t_end = 1.0, and n_periods = 3: give either"),
        ({"n_periods": 0}, "n_periods = 0: must be a whole number > 0, as n_periods=100"),
        ({"n_periods": [3, 2.5]}, "n_periods = 2.5: must be a whole number > 0"),
        ({"n_periods": "3"}, "n_periods = '3': must be a number"),
        ({"n_periods": True}, "n_periods = True: must be a number"),
        ({"n_periods": [1, 2], "x_0": [0.0] * 3}, "n_periods: shape mismatch"),
        ({"t_end": 1.0, "law": []}, r"law = \[\]: must be one object or a sequence, not empty"),
        ({"t_end": 1.0, "law": LAWS[:2], "x_0": [0.0] * 3}, "law, omega, .*: shape mismatch"),
        ({"t_end": 1.0, "oscillator": [paper_oscillator(), 3]}, "oscillator = 3: must be"),
        (
            {"t_end": 1.0, "oscillator": [paper_oscillator(), gs.systems.two_masses()]},
            "'x_1', 'x_2', 'stop'.*: must be oscillators, or systems with equal",
        ),
    ],
)
def test_bad_spans_and_sequences_are_refused(arguments, message):
    given = {"oscillator": paper_oscillator(), "law": LAWS[0], "omega": 5.0} | arguments
    with pytest.raises(gs.ModelError, match=message):
        gs.simulate(**given)


def test_periods_of_a_system_that_nothing_forces_are_refused():
    section, law = gs.systems.typical_section(8.0), gs.systems.typical_section_law()
    with pytest.raises(gs.ModelError, match="n_periods = 3: this System is not forced; give t_end"):
        gs.simulate(section, law, q_0=[0.01, 0.0, 0.0], n_periods=3)


def test_a_wall_too_stiff_for_one_step_is_a_status():
    law = gs.Piecewise(1e35, gs.Gap(0.0, 8e-4))
    run = gs.simulate(paper_oscillator(), law, 9.0, t_end=0.5, engine="scipy")
    assert run.status is gs.Status.STEP_UNDERFLOW
    assert run.t_end < 0.5


@pytest.mark.parametrize("label", ["piecewise", "tanh-1e5", "poly-13"])
def test_the_end_of_a_run_can_be_sampled_wherever_rounding_puts_it(label):
    law = gs.contact_law(label, 1.4e4, gs.Gap(4e-4, 4e-4))
    for omega in np.random.default_rng(3).uniform(1.0, 30.0, 20).tolist():
        for t_end in (1.0 / omega, np.nextafter(1.0 / omega, 1.0)):
            run = gs.simulate(paper_oscillator(), law, omega, t_end=t_end, dense_output=True)
            x, v = run.sample(run.t_end)
            assert [x, v] == pytest.approx([run.x_end, run.v_end], rel=1e-9, abs=1e-12)


SEVERAL = np.array([[8.0, 9.0], [10.0, 11.0]])
TWO_MASSES = gs.systems.two_masses(), gs.systems.two_masses_law()


def linear(x):
    """A contact force that is pickled by its name, in a module that no study imports again."""
    return 1e3 * x


@pytest.mark.parametrize("dense_output", [False, True])
@pytest.mark.parametrize(
    ("model", "law", "omega", "engine"),
    [
        (paper_oscillator(), gs.Piecewise(SOFT, SYMMETRIC), 9.0, "compiled"),
        (paper_oscillator(), gs.Tanh(SOFT, SYMMETRIC, epsilon=1e4), SEVERAL, "compiled"),
        (paper_oscillator(), gs.law(linear, 1e3, SYMMETRIC), 9.0, "scipy"),
        (*TWO_MASSES, 0.6, "compiled"),
        (*TWO_MASSES, SEVERAL / 16.0, "compiled"),
    ],
)
def test_a_trajectory_is_the_same_after_pickling(model, law, omega, engine, dense_output):
    how = {"t_end": 2.0, "dense_output": dense_output, "tangent": True, "engine": engine}
    run, asked = (gs.simulate(model, law, omega, **how) for _ in range(2))
    _ = values(asked)  # its records are there when it is pickled; those of the other are not
    for sent in (run, asked):
        received = pickle.loads(pickle.dumps(sent))
        assert_same(values(received), values(asked))
        if dense_output:
            for t in (0.5, [0.1, 2.0]):
                assert_same(received.sample(t), asked.sample(t))
        with pytest.raises(gs.ModelError):
            received.sample(-1.0)


def test_the_end_of_a_motion_is_not_computed_again_after_pickling(monkeypatch):
    run = gs.simulate(paper_oscillator(), gs.Piecewise(SOFT, SYMMETRIC), SEVERAL, t_end=2.0)
    sent = pickle.dumps(run)
    monkeypatch.setattr("gapsweep.integrate.simulate.prepared", None)
    assert_same(pickle.loads(sent).n_steps, run.n_steps)


@pytest.mark.parametrize("engine", ENGINES)
def test_trajectories_come_back_from_a_pool_of_processes(engine):
    asked = partial(
        gs.simulate, paper_oscillator(), gs.Piecewise(SOFT, SYMMETRIC), t_end=1.0, engine=engine,
        dense_output=True,
    )  # fmt: skip
    omega = [8.0, 9.0, 10.0]
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        there = list(pool.map(asked, omega))
    for ours, theirs in zip(map(asked, omega), there, strict=True):
        assert_same(values(theirs), values(ours))
        assert_same(theirs.sample(0.7), ours.sample(0.7))


def values(run):
    """All attributes that a trajectory has, but for the model that moves."""
    found = {}
    for name in dir(run):
        if not name.startswith("_") and name not in ("inputs", "laws", "system"):
            with suppress(gs.ModelError):
                if not callable(value := getattr(run, name)):
                    found[name] = value
    assert {"status", "n_steps", "extrema", "t_contacts", "section"} <= found.keys()
    return found


def assert_same(one, other):
    """Equal to the last bit, in mappings and ragged arrays too."""
    if isinstance(other, dict):
        assert one.keys() == other.keys()
        one, other = one.values(), other.values()
    elif isinstance(other, np.ndarray) and other.dtype.hasobject:
        one, other = one.flat, other.flat
    elif not isinstance(other, tuple):
        np.testing.assert_array_equal(one, other)
        return
    for each in zip(one, other, strict=True):
        assert_same(*each)
