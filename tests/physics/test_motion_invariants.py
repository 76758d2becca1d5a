"""Properties of every motion: each engine, method, model and contact law, by public calls alone."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import simpson
from tests.builders.random_oscillators import random_cases
from tests.builders.rescaled import rescaled_law, rescaled_model
from tests.oracles.equation import Equation, laws_of
from tests.physics import test_response_invariants as responses

import gapsweep as gs
from gapsweep.model.laws import LAWS

GAP = gs.Gap(0.2e-3, 0.5e-3)
SYMMETRIC, STOP, WALL = gs.Gap(0.4e-3, 0.4e-3), gs.Gap(1e-3, 2e-3), gs.Gap(3e-3, 1e-3)
OSCILLATOR = gs.systems.paper_oscillator()
FREE = gs.systems.paper_oscillator(zeta=0.0, forcing=0.0)
LOADED = gs.systems.paper_oscillator(mean_load=1.5, c=10.0)
TABLE = gs.ForceTable((-4e-3, -1e-3, -0.4e-3, 0.3e-3, 1e-3, 4e-3), (-60.0, -9.0, 0, 0, 8.0, 50.0))
GEARS, SECTION = gs.systems.gear_pair(), gs.systems.typical_section(12.36842, "conner-scaled")
FLAP = gs.systems.typical_section_law("conner-scaled")
MACHINE = gs.System(
    mass=[[1.0, 0.1], [0.1, 0.5]],
    damping=[[0.8, -0.2], [-0.1, 0.5]],
    stiffness=[[400.0, -150.0], [-120.0, 300.0]],
    contacts={"stop": [1.0, -1.0], "wall": [0.0, 1.0]},
    cubic=[gs.Cubic(along=[1.0, 0.3], alpha=1e5), gs.Cubic(along=[0.0, 1.0], alpha=-2e4)],
    forcing=[
        gs.Harmonic(amplitude=[3.0, 1.0], phase=0.3),
        gs.Harmonic(amplitude=[0.3, 0.0], k=0),
        gs.Harmonic(amplitude=[1e-3, 5e-4], k=2, power=2),
    ],
    modulation={"stop": [gs.Modulation(depth=0.3, k=2, phase=0.2), gs.Modulation(depth=0.2)]},
    lags=gs.Lags([[3.0], [1.0]], [[0.1, 0.0]], [[1.0, 2.0]], [[-8.0]]),
)


def spring(x):
    return 900.0 * x + 4e8 * x * x * x if abs(x) < 0.01 else math.nan


@dataclass(frozen=True, eq=False)
class Case:
    """A motion, how it is computed, and how far its error may lie from the tolerance."""

    model: Any
    law: Any
    omega: float | None
    start: Mapping[str, Any]
    t_end: float
    how: Mapping[str, Any] = field(default_factory=dict)
    within: float = 1e-10  # of the largest state, per unit of the monodromy matrix

    def run(self, **options):
        given = {"t_end": self.t_end, **TIGHT, **self.start, **self.how, **options}
        return gs.simulate(self.model, self.law, given.pop("omega", self.omega), **given)

    @property
    def laws(self):
        return laws_of(self.model, self.law)

    @cached_property
    def equation(self):
        return Equation(self.model, self.laws, self.omega)

    @cached_property
    def truth(self):
        return self.equation.motion(start_of(self), self.t_end)

    @cached_property
    def motion(self):
        """The motion of the case, with its tangent and all records."""
        return self.run(tangent=True)

    @cached_property
    def sampled(self):
        return self.run(dense_output=True)

    @cached_property
    def size(self):
        """Largest value of each state, of those of one kind together."""
        states = np.abs([self.truth(t) for t in np.linspace(0.0, self.t_end, 200)]).max(axis=0)
        kinds = np.split(states, [self.model.n, 2 * self.model.n])
        return np.concatenate([np.full(len(kind), kind.max(initial=0.0)) for kind in kinds])

    @property
    def unit(self):
        """Factors from a monodromy matrix to the matrix for states in units of `size`."""
        return self.size / self.size[:, None]

    @cached_property
    def growth(self):
        """The largest factor by which errors grow."""
        return max(1.0, np.abs(self.motion.monodromy * self.unit).max())

    @property
    def allowed(self):
        """Error of a state in units of `size`."""
        return self.within * self.growth

    def error(self, found, expected):
        """Largest difference of two states, or of several, in units of `size`."""
        return (np.abs(found - expected) / self.size).max()


TIGHT = {"rtol": 1e-11, "atol": 1e-15}
ODE45, RESTART, SCIPY = {"controller": "ode45"}, {"restart": True}, {"engine": "scipy"}


def oscillator(law, how=None, model=OSCILLATOR, **more):
    return Case(model, law, 9.0, {"x_0": 1e-4, "v_0": 0.02}, 0.6, how or {}, **more)


def machine(stop, wall, how=None, **more):
    start = {"q_0": [5e-4, -2e-3], "v_0": [0.01, 0.02], "z_0": [1e-3]}
    return Case(MACHINE, {"stop": stop, "wall": wall}, 3.5, start, 1.0, how or {}, **more)


def gears(law, how=None):
    return Case(GEARS, law, 0.84 / (2.0 * math.pi), {"q_0": [0.3], "v_0": [0.1]}, 60.0, how or {})


def section(law, how=None):
    start = {"q_0": [0.01, 0.002, 0.01], "v_0": [0.01, 0.1, 0.1], "z_0": [1e-3, 2e-3]}
    return Case(SECTION, law, None, start, 0.8, how or {})


def two_masses(law, how=None):
    start = {"q_0": [0.95, 0.6], "v_0": [0.3, 0.1]}
    return Case(gs.systems.two_masses(), law, 0.1, start, 50.0, how or {})


PIECEWISE = gs.Piecewise(1.4e4, GAP, K_ratio=0.5)
UNLOCATED = replace(PIECEWISE, located=False)
CLOSED = gs.Piecewise(1.4e4, gs.Gap(0.0, 0.0), K_ratio=0.5)
TANH = gs.Tanh(1.4e4, GAP, 1e4, K_ratio=0.5)
HARD = gs.Piecewise(2e3, STOP), gs.Piecewise(1e3, WALL, K_ratio=0.5)
STOP_TABLE = gs.ForceTable((-2e-2, -1e-3, 2e-3, 5e-3, 2e-2), (-30.0, 0.0, 0.0, 4.0, 40.0))
FAINT = gs.Arctan(1e3, WALL, 2e3)
KINKS = {"within": 1e-8}
# With poles near the path: four times as many steps as for the exact law, whose errors add up.
POLES = {"within": 2e-10}
CASES = {
    "taylor oscillator": oscillator(PIECEWISE),
    "taylor closed": oscillator(CLOSED),
    "taylor free": oscillator(PIECEWISE, model=FREE),
    "taylor loaded": oscillator(PIECEWISE, model=LOADED),
    "taylor machine": machine(*HARD),
    "taylor two masses": two_masses(gs.systems.two_masses_law()),
    "taylor gears": gears(gs.systems.gear_pair_law()),
    "taylor section": section(FLAP),
    "native restart": oscillator(PIECEWISE, RESTART),
    "native closed": oscillator(CLOSED, RESTART),
    "taylor tanh": oscillator(TANH, **POLES),
    "taylor thin tanh": oscillator(gs.Tanh(1.4e5, SYMMETRIC, 1e6), **POLES),
    "taylor hard tanh": oscillator(gs.Tanh(1.4e6, SYMMETRIC, 2e5), **POLES),
    "taylor closed tanh": oscillator(gs.Tanh(1e5, gs.Gap(0.0, 0.0), 3e4, K_ratio=2.0), **POLES),
    **{
        f"taylor {law.family}": oscillator(gs.contact_law(law.examples[0], 1.4e4, GAP, K_ratio=0.5))
        for law in LAWS
        if law not in (gs.Piecewise, gs.Tanh)
    },
    "native table": oscillator(TABLE, within=3e-9),
    "native user": oscillator(gs.law(spring, 1.4e4, GAP)),
    "native unlocated": oscillator(UNLOCATED, **KINKS),
    "taylor free tanh": oscillator(TANH, model=FREE, **POLES),
    "taylor loaded arctan": oscillator(gs.Arctan(1.4e4, GAP, 1e4), model=LOADED),
    "native machine": machine(gs.Tanh(2e3, STOP, 3e3), gs.LogArctan(1e3, WALL, 2e3, K_ratio=0.4)),
    "native machine table": machine(STOP_TABLE, FAINT, within=1e-9),
    "native machine fits": machine(
        gs.Polynomial(2e3, STOP, 7, fit_range=2e-2),
        gs.RationalPolynomial(1e3, WALL, 3, 2, fit_range=2e-2),
    ),
    "native machine unlocated": machine(
        replace(HARD[0], located=False), gs.Tanh(1e3, WALL, 2e3), **KINKS
    ),
    "native gears": gears(gs.Tanh(1.0, gs.Gap(1.0, 1.0), 10.0)),
    "native section": section(gs.Tanh(FLAP.K_c, FLAP.gap, 2e3)),
    "ode45 located": oscillator(PIECEWISE, ODE45, within=1e-9),
    "ode45 restart": oscillator(PIECEWISE, ODE45 | RESTART, within=1e-9),
    "ode45 free": oscillator(PIECEWISE, ODE45, model=FREE, within=1e-9),
    "ode45 tanh": oscillator(TANH, ODE45, within=1e-9),
    "ode45 unlocated": oscillator(UNLOCATED, ODE45, **KINKS),
    "ode45 machine": machine(gs.Tanh(2e3, STOP, 3e3), FAINT, ODE45, within=1e-9),
    "scipy oscillator": oscillator(PIECEWISE, SCIPY),
    "scipy tanh": oscillator(TANH, SCIPY),
    "scipy two masses": two_masses(gs.systems.two_masses_law(), SCIPY),
}
COMPILED = [name for name, case in CASES.items() if case.how is not SCIPY]
# Most of these share their kernels with other tests; with all others, tests are extended.
COMMON = ("taylor oscillator", "taylor closed", "taylor free", "taylor tanh", "taylor machine")
COMMON += ("taylor arctan", "taylor poly", "scipy oscillator")
params = partial(responses.params, common=COMMON)


@pytest.fixture(params=params(CASES))
def case(request):
    return CASES[request.param]


def start_of(case):
    return np.concatenate([np.atleast_1d(each) for each in case.start.values()])


def state(run):
    """Displacements, velocities and first-order states at the end."""
    if isinstance(run, gs.SystemTrajectory):
        return np.concatenate([run.q_end, run.v_end, run.z_end], axis=-1)
    return np.stack([run.x_end, run.v_end], axis=-1)


def sampled(run, t):
    """States at times, one row each."""
    parts = run.sample(t)
    if isinstance(run, gs.SystemTrajectory):
        return np.concatenate(parts, axis=-1)
    return np.stack(parts, axis=-1)


def lists(found):
    """Ragged records of one motion as a list of arrays."""
    return [*found.values()] if isinstance(found, dict) else [found]


# --- An independent integrator --------------------------------------------------------------------


def test_the_end_is_that_of_the_equation(case):
    assert case.motion.status is gs.Status.OK
    for run in (case.motion, case.sampled):
        assert case.error(state(run), case.truth(case.t_end)) < case.allowed


def test_samples_are_those_of_the_equation(case):
    times = np.append(np.linspace(0.0, case.t_end, 14), 0.7123 * case.t_end)
    truth = np.array([case.truth(t) for t in times])
    within = case.allowed if case.how is not SCIPY else 1e-6
    assert case.error(sampled(case.sampled, times), truth) < within


def test_contacts_are_those_of_the_equation(case):
    found = lists(case.motion.t_contacts)
    assert case.motion.n_contacts == sum(map(len, case.truth.t_contacts)) > 3
    for times, truth in zip(found, case.truth.t_contacts, strict=True):
        assert len(times) == len(truth)
        assert_allclose(times, truth, rtol=0.0, atol=100.0 * case.allowed * case.t_end)


def test_extrema_are_those_of_the_equation(case):
    motion, truth = case.motion, case.truth
    found = zip(lists(motion.t_extrema), lists(motion.extrema), strict=True)
    for i, (times, values) in enumerate(found):
        assert len(times) == len(truth.extrema[i]) > 2
        assert_allclose(times, truth.t_extrema[i], rtol=0.0, atol=100.0 * case.allowed * case.t_end)
        assert_allclose(values, truth.extrema[i], rtol=0.0, atol=case.allowed * case.size[i])


def test_sections_are_states_at_whole_periods_or_at_maxima(case):
    motion = case.motion
    if case.omega:
        times = np.arange(1, math.floor(case.t_end * case.omega * (1.0 + 1e-12)) + 1) / case.omega
        assert_allclose(motion.t_section, times, rtol=1e-13)
    else:
        maxima = np.diff(np.append(0.0, case.truth.extrema[0])) > 0.0
        times = case.truth.t_extrema[0][maxima]
        assert_allclose(motion.t_section, times, rtol=0.0, atol=1e-7 * case.t_end)
        assert not motion.section[:, case.model.n].any()
    truth = np.array([case.truth(t) for t in motion.t_section])
    assert case.error(motion.section, truth) < case.allowed


@pytest.mark.extended
@pytest.mark.parametrize("seed", range(8))
def test_random_oscillators_move_as_the_equation_says(seed):
    rng = np.random.default_rng(seed)
    model = gs.Oscillator(
        zeta=rng.uniform(0.01, 0.2),
        omega_n=rng.uniform(2.0, 10.0),
        mass=rng.uniform(0.5, 4.0),
        alpha=rng.uniform(-1e8, 1e9),
        forcing=rng.uniform(-8.0, 8.0),
    )
    walls = {
        "K_c": 10.0 ** rng.uniform(3.0, 6.0),
        "gap": gs.Gap(*rng.uniform(0.0, 1e-3, 2)),
        "K_ratio": 2.0 ** (seed - 4),
    }
    start = {"x_0": 0.0, "v_0": rng.uniform(-0.05, 0.05)}
    for law in (gs.Piecewise(**walls), gs.Tanh(**walls, epsilon=10.0 ** rng.uniform(3.5, 4.5))):
        case = Case(model, law, rng.uniform(0.5, 30.0), start, 0.5, within=1e-9)
        test_the_end_is_that_of_the_equation(case)
        test_extrema_are_those_of_the_equation(case)


@pytest.mark.parametrize("j_1", [0.0, 0.4e-3])
def test_a_smoothed_wall_moves_what_is_at_rest(j_1):
    """Nothing else does: without forcing or energy only it tells the size of the motion."""
    model = gs.systems.paper_oscillator(zeta=0.1, forcing=0.0, alpha=0.0)
    law, start = gs.Tanh(1e3, gs.Gap(j_1, 0.8e-3), 1e3), {"x_0": 0.0, "v_0": 0.0}
    for rtol in (1e-9, 1e-11):
        how = {"rtol": rtol, "atol": 1e-3 * rtol}
        case = Case(model, law, 9.0, start, 0.5, how, within=100.0 * rtol)
        test_the_end_is_that_of_the_equation(case)


def test_steps_that_touch_a_thin_layer_come_to_an_end():
    """They turn back in it: where they enter it, their interpolant is not nearly straight."""
    model = gs.Oscillator(zeta=0.03, omega_n=5.0, mass=3.0, forcing=4.0, alpha=7e8)
    start = {"x_0": 0.00010771443845100566, "v_0": 0.0016050810222214573}
    law = gs.Arctan(14e3, gs.Gap(0.0, 0.8e-3), 1e6)
    motion = gs.simulate(model, law, 22.8, **start, n_periods=5, rtol=1e-9, atol=1e-12)
    assert motion.n_rejected < motion.n_steps < 1000


@pytest.mark.parametrize("omega", [0.0906, 0.0916])
def test_steps_that_end_at_the_edge_of_a_thin_layer_are_kept(omega):
    start = {"q_0": [1.46637568995, 0.436441358179], "v_0": [0.364278484136, -0.61994410865]}
    law = gs.Tanh(100.0, gs.Gap(1000.0, 1.0), 1e5, K_ratio=0.0)
    motion = gs.simulate(gs.systems.two_masses(), law, omega, **start, n_periods=2)
    assert motion.n_rejected < motion.n_steps < 1000


@pytest.mark.parametrize("epsilon", [1e9, 1e12, 1e15])
def test_the_sharpest_tanh_is_the_exact_law(epsilon):
    walls, at = (1e6, gs.Gap(0.4e-3, 0.4e-3)), {"x_0": 0.01, "n_periods": 1}
    model = gs.systems.paper_oscillator(alpha=0.0)
    exact = gs.simulate(model, gs.Piecewise(*walls), 9.0, **at)
    motion = gs.simulate(model, gs.Tanh(*walls, epsilon), 9.0, **at)
    assert motion.n_contacts == exact.n_contacts > 30
    assert_allclose(state(motion), state(exact), rtol=1e-6)


def test_a_start_within_a_thin_layer_is_followed_out_of_it():
    """The layer lies before the first stage of a step that leaves it."""
    model, law = gs.systems.paper_oscillator(mean_load=1.0), gs.Tanh(1e6, GAP, 1e6)
    loose, tight = (
        gs.simulate(model, law, 9.0, GAP.j_2, -0.05, t_end=0.02, rtol=rtol, atol=1e-3 * rtol)
        for rtol in (1e-7, 1e-11)
    )
    assert_allclose(loose.x_end, tight.x_end, rtol=1e-6)


# --- Tangents -------------------------------------------------------------------------------------


def has_unlocated_kinks(case):
    """Whether kinks are passed that are not located: tangents see their slopes up to a step late.

    Each adds an error that no tolerance bounds.
    """
    return any(isinstance(law, gs.Piecewise) and not law.located for law in case.laws)


def test_volumes_shrink_by_the_trace(case):
    sign, logarithm = np.linalg.slogdet(case.motion.monodromy)
    assert sign == 1.0
    lost = max(1.0, 1e-11 * math.exp(-logarithm))  # by rounding, where hardly anything is left
    expected = case.equation.trace * case.t_end
    assert_allclose(logarithm, expected, rtol=0.0, atol=2e-9 * lost)


def test_the_monodromy_is_the_slope_of_the_motion(case):
    n, start = len(case.size), start_of(case)
    shifts = 1e-5 * case.size * np.eye(n)
    shifted = np.vstack([start + shifts, start - shifts])
    parts = np.split(shifted, [case.model.n, 2 * case.model.n], axis=1)
    if isinstance(case.model, gs.Oscillator):
        parts = [part[:, 0] for part in parts[:2]]
    ends = state(case.run(**dict(zip(case.start, parts, strict=False))))
    slopes = ((ends[:n] - ends[n:]) / (2e-5 * case.size[:, None])).T
    # each of both ends may be off by what is allowed
    within = 0.1 if has_unlocated_kinks(case) else 1e-5 + case.allowed / 1e-5
    assert np.abs((slopes - case.motion.monodromy) * case.unit).max() < within * case.growth


# --- Energy ---------------------------------------------------------------------------------------


def has_energy(case):
    return isinstance(case.model, gs.Oscillator) or case.model.coordinates == ("x_1", "x_2")


@pytest.mark.parametrize("name", params(n for n, case in CASES.items() if has_energy(case)))
def test_energy_changes_by_the_work_of_loads_and_damping(name):
    case = CASES[name]
    times, equation = np.linspace(0.0, case.t_end, 20_001), case.equation
    states = sampled(case.sampled, times)
    work = simpson(equation.power(times, states), x=times)
    begun, ended = equation.energy(states[0]), equation.energy(states[-1])
    assert (work == 0.0) == (case.model is FREE)
    assert_allclose(ended - begun, work, rtol=0.0, atol=begun * max(1e-7, 30.0 * case.within))


@pytest.mark.extended
@pytest.mark.parametrize("how", [{}, ODE45, RESTART, SCIPY])
def test_energy_is_kept_over_thousands_of_contacts(how):
    law, rtol = gs.Piecewise(1.4e6, gs.Gap(0.4e-3, 0.4e-3)), 1e-10 if how else 1e-12
    t_end = 5.0 if how else 150.0
    case = Case(FREE, law, 1.0, {"x_0": 0.0, "v_0": 0.06}, t_end)
    run = case.run(rtol=rtol, atol=1e-3 * rtol, **how)
    assert run.n_contacts > (300 if how else 10_000)
    energy = case.equation.energy
    assert_allclose(energy(state(run)), energy(start_of(case)), rtol=run.n_contacts * rtol)


@pytest.mark.parametrize("name", params(n for n, case in CASES.items() if case.model == FREE))
def test_a_motion_without_damping_leads_back_when_it_is_reversed(name):
    case = CASES[name]
    there = case.run()
    back = case.run(x_0=there.x_end, v_0=-there.v_end)
    assert there.n_contacts == back.n_contacts > 3
    assert case.error(state(back), start_of(case) * [1.0, -1.0]) < 3.0 * case.allowed


# --- Mirror images, units and clocks --------------------------------------------------------------


def mirrored_law(law):
    if isinstance(law, gs.ForceTable):
        return gs.ForceTable([-x for x in law.x[::-1]], [-force for force in law.F[::-1]])
    walls = {"K_c": law.K_ratio * law.K_c, "K_ratio": 1.0 / law.K_ratio}
    return replace(law, gap=gs.Gap(law.gap.j_2, law.gap.j_1), **walls)


def mirrored(case):
    start = {name: -np.array(value) for name, value in case.start.items()}
    if isinstance(case.model, gs.Oscillator):
        loads = {name: -getattr(case.model, name) for name in ("forcing", "mean_load")}
        model = replace(case.model, **loads)
        return replace(case, model=model, law=mirrored_law(case.law), start=start)
    contacts = {name: -b for name, b in case.model.contacts.items()}
    forcing = [replace(load, amplitude=-load.amplitude) for load in case.model.forcing]
    return replace(case, model=replace(case.model, contacts=contacts, forcing=forcing), start=start)


def test_mirror_images_of_a_model_and_its_start_move_as_mirror_images(case):
    ours, other = case.motion, mirrored(case).run(tangent=True)
    by_series = {gs.Piecewise, gs.Tanh} if isinstance(case.model, gs.Oscillator) else {gs.Piecewise}
    if not case.how and {*map(type, case.laws)} <= by_series:
        assert (state(other) == -state(ours)).all()
        assert (other.monodromy == ours.monodromy).all()
    assert case.error(state(other), -state(ours)) < case.allowed
    assert other.n_contacts == ours.n_contacts


def rescaled(case, mass, length, time):
    """The case in other units of mass, length and time."""
    model = rescaled_model(case.model, mass, length, time)
    start = {
        name: np.array(value) * (length / time if name == "v_0" else length)
        for name, value in case.start.items()
    }
    laws = [rescaled_law(law, mass, length, time) for law in case.laws]
    law = dict(zip(case.law, laws, strict=True)) if isinstance(case.law, Mapping) else laws[0]
    omega = case.omega and case.omega / time
    return replace(case, model=model, law=law, omega=omega, start=start, t_end=case.t_end * time)


@pytest.mark.parametrize("name", params(name for name in COMPILED if name != "native user"))
def test_units_by_powers_of_two_change_no_bit(name):
    case, (mass, length, time) = CASES[name], (2.0**10, 2.0**-7, 2.0**3)
    other = rescaled(case, mass, length, time)
    # The layers of tanh depend on atol, a length.
    ours = case.run(atol=1e-45, tangent=True)
    theirs = other.run(atol=1e-45 * length, tangent=True)
    n, m = case.model.n, len(case.size) - 2 * case.model.n
    units = np.repeat([length, length / time, length], [n, n, m])
    assert (state(theirs) == state(ours) * units).all()
    assert (theirs.monodromy == ours.monodromy * units[:, None] / units).all()
    assert (theirs.n_steps, theirs.n_contacts) == (ours.n_steps, ours.n_contacts)


def test_whole_periods_before_the_start_change_nothing(case):
    t_0 = 2.0**20 / (case.omega or 1.0)
    late = case.run(t_0=t_0, t_end=t_0 + case.t_end)
    rounded = 1e3 * np.spacing(t_0) / case.t_end
    assert case.error(state(late), state(case.sampled)) < case.allowed + rounded
    assert late.n_contacts == case.sampled.n_contacts
    assert np.shape(late.section) == np.shape(case.sampled.section)


# --- The same motion, however it is asked for -----------------------------------------------------


def test_stopping_on_the_way_changes_nothing_but_rounding(case):
    t, start, n_contacts, extrema = 0.0, dict(case.start), 0, []
    for until in (0.31 * case.t_end, 0.74 * case.t_end, case.t_end):
        part = case.run(t_0=t, t_end=until, **start)
        t, n_contacts = until, n_contacts + part.n_contacts
        extrema.append(lists(part.extrema)[0])
        is_system = isinstance(case.model, gs.System)
        names = ("q_end", "v_end", "z_end") if is_system else ("x_end", "v_end")
        start = {name: getattr(part, end) for name, end in zip(case.start, names, strict=False)}
    assert case.error(state(part), state(case.sampled)) < 2.0 * case.allowed
    assert n_contacts == case.sampled.n_contacts
    assert len(np.concatenate(extrema)) == len(lists(case.sampled.extrema)[0])


# Series cross a layer of tanh at once where no motion within it is wanted.
ALIKE = [name for name in COMPILED if not name.endswith(" tanh") or name.startswith("ode45")]


@pytest.mark.extended
@pytest.mark.parametrize("name", ALIKE)
def test_records_and_samples_change_no_bit(name):
    case = CASES[name]
    plain = case.run()
    assert (state(plain) == state(case.sampled)).all()
    assert plain.nfev == case.sampled.nfev
    assert [*map(np.ndarray.tobytes, lists(plain.extrema))] == [
        *map(np.ndarray.tobytes, lists(case.sampled.extrema))
    ]
    if name.startswith("taylor"):
        assert (state(case.motion) == state(plain)).all()  # others' steps are cut for the tangent
    if case.omega:
        whole = case.run(t_end=2.0 / case.omega)
        assert (whole.section[-1] == state(whole)).all()


@pytest.mark.extended
@pytest.mark.parametrize("name", COMPILED)
def test_records_are_as_good_as_motions_that_end_there(name):
    """Steps are long: an interpolant between their ends is not as good."""
    case, rtol = CASES[name], 1e-5
    given, n = {"rtol": rtol, "atol": 1e-3 * rtol * case.size.min()}, case.model.n
    within = 10.0 * rtol if has_unlocated_kinks(case) else rtol
    run = case.run(**given)
    extrema = zip(lists(run.t_extrema), lists(run.extrema), strict=True)
    for i, (times, values) in enumerate(extrema):
        for t, value in zip(times[1:4], values[1:4], strict=True):
            end = state(case.run(t_end=t, **given))
            expected = end.copy()
            expected[i % n], expected[n + i % n] = value, 0.0
            assert case.error(end, expected) < within
    for t, point in zip(run.t_section[:3], run.section[:3], strict=True):
        assert case.error(state(case.run(t_end=t, **given)), point) < within
    contacts = zip(lists(run.t_contacts), case.equation.directions, case.laws, strict=True)
    for times, b, law in contacts:
        for t in times[1:4]:
            gap = b @ state(case.run(t_end=t, **given))[:n]
            assert min(abs(gap - wall) for wall in law.walls) < within * case.size[0]


def bits(run, i, t):
    """All numbers of one of several motions, or of the only one."""
    own = [state(run), run.status, run.n_steps, run.n_rejected, run.nfev, run.n_contacts]
    own += [run.section, run.t_section] + ([] if run.monodromy is None else [run.monodromy])
    named = [run.extrema, run.t_extrema, run.t_contacts]
    if i is not None:
        own, named = ([each[i] for each in values] for values in (own, named))
    if t is not None:
        own.append(sampled(run, t) if i is None else sampled(run, t)[i])
    own += [each for records in named for each in lists(records)]
    return [np.asarray(each).tobytes() for each in own]


@pytest.mark.extended
@pytest.mark.parametrize("options", [{"tangent": True}, {"dense_output": True}])
@pytest.mark.parametrize("name", COMPILED)
def test_a_motion_is_the_same_in_any_batch(name, options):
    case, n = CASES[name], 19
    first = next(iter(case.start))
    starts = np.moveaxis(np.multiply.outer(case.start[first], np.linspace(0.5, 1.5, n)), -1, 0)
    omega = None if case.omega is None else case.omega * np.linspace(1.2, 0.8, n)
    t = np.linspace(0.0, 0.5 * case.t_end, 5) if "dense_output" in options else None
    given = {"t_end": 0.5 * case.t_end, "rtol": 1e-6, "atol": 1e-9, **options}

    def of(chosen):
        rate = {} if omega is None else {"omega": omega[chosen]}
        return case.run(**{first: starts[chosen]}, **rate, **given)

    together, order = of(np.arange(n)), np.arange(n)[::-1]
    expected = [bits(together, i, t) for i in range(n)]
    backwards = of(order)
    assert [bits(backwards, i, t) for i in range(n)] == expected[::-1]
    for group in ([0, 7, 12, 18], [1, 2, 3, 4, 5]):
        few = of(np.array(group))
        assert [bits(few, i, t) for i in range(len(group))] == [expected[k] for k in group]
    for k in (0, 9, 18):
        assert bits(of(k), None, t) == expected[k]


def test_thin_layers_are_met_alike_in_any_batch():
    omega, start = np.linspace(3.0, 9.0, 16), {"x_0": 6e-4, "v_0": 6e-3, "t_end": 1.0}
    law = gs.Arctan(5e5, gs.Gap(1e-4, 7e-4), 2.7e6)
    together = gs.simulate(OSCILLATOR, law, omega, **start)
    for i, frequency in enumerate(omega):
        assert bits(gs.simulate(OSCILLATOR, law, frequency, **start), None, None) == bits(
            together, i, None
        )


@pytest.mark.parametrize("rtol", [1e-4, 1e-6])
def test_series_meet_thin_layers_that_are_far_away(rtol):
    """At the beginning of a step its series shows nothing of a layer at the other end."""
    law, omega = gs.Arctan(1.4e4, gs.Gap(4e-4, 4e-4), 1e6), np.array([5.0, 7.0, 9.0, 12.0])
    run, truth = (
        gs.simulate(OSCILLATOR, law, omega, 1e-4, t_end=1.0, **how)
        for how in ({"rtol": rtol}, {"engine": "scipy", "rtol": 1e-12, "atol": 1e-16})
    )
    reach = np.array([np.abs(each).max() for each in truth.extrema])
    assert run.n_contacts.tolist() == truth.n_contacts.tolist()
    assert (truth.n_contacts > 10).all()
    assert (np.abs(run.x_end - truth.x_end) < 30.0 * rtol * reach).all()


@pytest.mark.parametrize("label", ["poly-13", "ratpoly-5/3"])
def test_asymmetric_fits_have_idle_lanes(label):
    """An asymmetric fit has a force at x = 0, where idle lanes rest."""
    law, omega = gs.contact_law(label, 1.4e4, gs.Gap(1e-4, 6e-4)), np.array([5.0, 7.0, 12.0])
    assert abs(law.force(0.0)) > 1e-4
    start, t = {"x_0": 1e-4, "t_end": 1.0, "dense_output": True}, np.linspace(0.0, 1.0, 9)
    run = gs.simulate(OSCILLATOR, law, omega, **start)
    assert (run.status == gs.Status.OK).all()
    truth = gs.simulate(OSCILLATOR, law, omega, engine="scipy", rtol=1e-12, atol=1e-16, **start)
    reach = max(np.abs(each).max() for each in truth.extrema)
    assert_allclose(run.x_end, truth.x_end, rtol=0.0, atol=100.0 * 1e-9 * reach)  # of rtol 1e-9
    for i, frequency in enumerate(omega):
        alone = gs.simulate(OSCILLATOR, law, frequency, **start)
        assert bits(alone, None, t) == bits(run, i, t)


@pytest.mark.parametrize("law", [PIECEWISE, TANH], ids=["taylor", "native"])
def test_more_records_than_buffers_hold_lose_nothing(law):
    many = Case(OSCILLATOR, law, np.linspace(9.0, 18.0, 97), {"x_0": 1e-4}, 12.0)
    given = {"dense_output": True, "rtol": 1e-7, "atol": 1e-10}
    together, t = many.run(**given), np.linspace(0.0, 12.0, 7)
    assert sum(map(len, together.extrema)) > 20_000
    assert together.n_steps.sum() > 30_000
    for i in (0, 41, 96):
        alone = many.run(omega=many.omega[i], **given)
        assert bits(together, i, t) == bits(alone, None, t)


def test_a_force_that_is_no_number_ends_a_motion():
    alone, speeds = CASES["native user"].run(v_0=5.0), np.linspace(0.5, 5.0, 40)
    assert alone.status == gs.Status.MODEL_INVALID
    assert CASES["native user"].run(v_0=speeds).status[-1] == alone.status


# --- Tolerances -----------------------------------------------------------------------------------


def test_errors_follow_the_tolerance(case):
    truth = case.truth(case.t_end)
    for rtol in (1e-4, 1e-6, 1e-8):
        run = case.run(rtol=rtol, atol=1e-3 * rtol * case.size.min())
        within = 1e4 if has_unlocated_kinks(case) else 300.0
        assert case.error(state(run), truth) < within * rtol * case.growth


def hardened(x):
    return 1.4e3 * x * math.sqrt(1.0 + 1e6 * x * x)


@pytest.mark.extended
@pytest.mark.parametrize(
    ("law", "how", "order"),
    [
        (gs.law(hardened, K_c=0.0, gap=GAP), {}, 8),
        (gs.Tanh(1.4e3, GAP, 2e3), ODE45, 5),
        (PIECEWISE, ODE45, 5),
    ],
)
def test_error_falls_with_the_order_of_the_method(law, how, order):
    many = Case(OSCILLATOR, law, np.linspace(5.0, 9.0, 32), {"v_0": 0.0}, 1.0, how)
    exact = many.run(rtol=1e-13, atol=1e-17)
    errors, steps = [], []
    for rtol in 10.0 ** np.arange(-6, -10.6, -0.5):
        run = many.run(rtol=rtol, atol=rtol * 1e-3)
        errors.append(np.mean(np.log(np.abs(run.x_end - exact.x_end) + 1e-20)))
        steps.append(np.log(run.n_steps.mean()))
    slope = -np.polyfit(steps, errors, 1)[0]
    assert order - 0.8 < slope < order + 1.2


@pytest.mark.parametrize("gap", [gs.Gap(1.0, 1.0), gs.Gap(0.4e-3, 0.4e-3)])
def test_error_of_series_falls_with_tolerance_with_contacts_as_without(gap):
    """The median of sixteen motions: the errors of one scatter by a factor of three."""
    many = Case(OSCILLATOR, gs.Piecewise(1.4e4, gap), np.linspace(4.0, 9.0, 16), {}, 2.0)
    rtols, best = 10.0 ** np.arange(-4, -9, -1.0), many.run(rtol=1e-13).x_end
    errors = [np.median(np.abs(many.run(rtol=rtol, atol=1e-40).x_end - best)) for rtol in rtols]
    assert 0.7 < np.polyfit(np.log(rtols), np.log(errors), 1)[0] < 1.3


# --- Records of random motions --------------------------------------------------------------------


def sign_of(values, size):
    """Signs, zero of what is too small to have one."""
    return np.sign(values) * (np.abs(values) > size)


@pytest.mark.extended
@pytest.mark.parametrize(
    ("method", "rtol"),
    [("taylor", rtol) for rtol in (1e-1, 1e-3, 1e-7, 1e-13)]
    + [(m, rtol) for m in ("native", "ode45", "ode45 located", "restart") for rtol in (1e-3, 1e-6)],
)
def test_records_tell_where_random_motions_turn_and_touch(method, rtol):
    """Also with steps so long that they hold several events."""
    how = {"ode45": ODE45, "ode45 located": ODE45, "restart": RESTART}.get(method, {})
    eps = 1e-9 if method == "taylor" else max(1e-9, 3.0 * rtol)
    rng = np.random.default_rng(5)
    for drawn in random_cases(16, 21):
        o, law = drawn.oscillator, drawn.law
        length = o.forcing / (o.mass * o.omega_n_rad**2)
        if method in ("native", "ode45"):
            law = gs.Tanh(law.K_c, law.gap, 10.0 / length)
        far = 0.2 if method == "ode45 located" else 2.0  # steps from wall to wall repeat
        starts = rng.uniform(-far, far, (2, 16)) * length
        t_end = min(3.0 / drawn.omega, 20.0 / o.omega_n)
        given = {"t_end": t_end, "rtol": rtol, "atol": 1e-3 * rtol * length, "dense_output": True}
        x_0, v_0 = starts * [[1.0], [o.omega_n_rad]]
        runs = gs.simulate(o, law, drawn.omega, x_0, v_0, **given, **how)
        t = np.linspace(0.0, t_end, 4001)[1:-1]
        for i, (x, v) in enumerate(zip(*runs.sample(t), strict=True)):
            x_size, v_size = eps * np.abs(x).max(), eps * np.abs(v).max()
            n_turns = np.searchsorted(runs.t_extrema[i], t)
            signs = sign_of(v, v_size) * (-1.0) ** n_turns
            assert abs(signs.sum()) == np.abs(signs).sum(), (drawn, i, "turns")
            n_passed, (low, high) = np.searchsorted(runs.t_contacts[i], t), law.walls
            side = sign_of(np.maximum(x - high, low - x) if low < high else x, x_size)
            signs = side * (-1.0) ** (n_passed if low < high else n_passed // 2)
            assert abs(signs.sum()) == np.abs(signs).sum(), (drawn, i, "contacts")


# --- A user's law ---------------------------------------------------------------------------------


@pytest.mark.extended
def test_responses_to_a_users_law_are_those_of_the_equation():
    """Here, where the process has compiled the kernels of this law for its motions."""
    case = responses.Case(OSCILLATOR, CASES["native user"].law)
    responses.test_orbits_are_those_of_the_equation(case)
    responses.test_multipliers_are_those_of_the_tangent_along_the_orbit(case)
    responses.test_scipy_finds_the_same_response(case)
    responses.test_a_response_is_the_same_in_any_company(case)
