"""Public cases: what people asked of other tools, solved here, against closed forms and oracles.

Two more stand elsewhere: trajectories between processes in `test_simulate`, scripts without a guard
in `test_queries`. This package does not express restitution, dry friction, radial
gaps, contacts on first-order states, and more than 16 coordinates.
"""

import math

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, root
from scipy.special import ellipk
from tests.builders.studies import PAPER
from tests.oracles import piecewise_linear as exact

import gapsweep as gs
from gapsweep.response.result import ResponseClass

pytestmark = pytest.mark.extended

W = 2.0 * math.pi


def single(stiffness, damping=0.0, cubic=1.0, **more):
    """One mass of 1 kg on a spring k x + cubic x^3, without contacts."""
    spring = [gs.Cubic(along=[1.0], alpha=cubic)]
    return gs.System(
        mass=[[1.0]], stiffness=[[stiffness]], damping=[[damping]], cubic=spring, **more
    )


def forced(amplitude):
    return {"forcing": [gs.Harmonic(amplitude=[amplitude])]}


def orbit(system, omega, guess):
    """State at phase zero and monodromy of a periodic motion, by Newton's method on exact ones."""
    u = np.array(guess, float).ravel()
    for _ in range(12):
        end = exact.motion(system, omega, u[:1], u[1:], [], 1.0 / omega)
        u = u - np.linalg.solve(end.monodromy - np.eye(2), end.state - u)
    return u, end.monodromy


def highest(system, omega, u):
    """Largest displacement of a periodic motion, by a root of its velocity."""

    def at(t):
        return exact.motion(system, omega, u[:1], u[1:], [], t)

    t = np.linspace(0.25, 1.35, 34) / omega
    best = 1 + int(np.argmax([at(each).q[0] for each in t[1:-1]]))
    return at(brentq(lambda s: at(s).v[0], t[best - 1], t[best + 1], xtol=1e-13)).q[0]


# --- Duffing oscillators between two wells --------------------------------------------------------


def test_the_exponent_of_a_two_well_duffing_oscillator():
    """ChaosTools.jl#301: .1589 in the thread; .1578 +- .0004 by 256 starts x 400 periods."""
    duffing = single(-1.0, 0.2, **forced(0.3))
    found = gs.respond(duffing, {}, 1.0 / W, q_0=[0.1], v_0=[0.25])
    assert found.response_class is ResponseClass.CHAOTIC
    assert 0.0 < found.lyapunov_error < 0.03
    assert_allclose(found.lyapunov, 0.1578, rtol=0.0, atol=2.5 * found.lyapunov_error + 4e-4)


@pytest.mark.parametrize(
    ("amplitude", "multiple", "x_min", "x_max"),
    [
        (0.67, 1, 0.095251, 0.432252),
        (0.70, 1, 0.090110, 0.432202),
        (0.81, 2, 0.045125, 0.435519),
        (0.82, 4, 0.039782, 0.436169),
        (0.90, 0, math.nan, math.nan),  # chaos
    ],
)
def test_a_forced_duffing_oscillator_doubles_its_period(amplitude, multiple, x_min, x_max):
    """Schoukens & Pintelon, Mastering System Identification, exercise 79."""
    omega, start = 3.5 / W, {"q_0": [0.2], "v_0": [-0.2]}
    found = gs.respond(single(-10.0, 1.0, 100.0, **forced(amplitude)), {}, omega, **start)
    assert found.period_multiple == multiple
    if not multiple:
        assert found.response_class is ResponseClass.CHAOTIC
        return

    def rhs(t, y):
        return y[1], amplitude * math.cos(3.5 * t) - y[1] + 10.0 * y[0] - 100.0 * y[0] ** 3

    start, end = [found.x_end, found.v_end], multiple / omega
    run = solve_ivp(rhs, (0.0, end), start, "DOP853", rtol=1e-12, atol=1e-14, dense_output=True)
    assert_allclose(run.y[:, -1], start, atol=1e-8)
    x = run.sol(np.linspace(0.0, end, 40_001))[0]
    assert_allclose([found.x_min, found.x_max], [x.min(), x.max()], atol=1e-7)
    assert_allclose([x.min(), x.max()], [x_min, x_max], atol=1e-6)


# --- Equilibria -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("damping", "exponent"), [(2.5, -0.5), (0.2, -0.1)])
@pytest.mark.parametrize("atol", [1e-6, 1e-12, 1e-30])
def test_the_exponent_of_an_equilibrium_needs_no_tiny_tolerance(damping, exponent, atol):
    """ChaosTools.jl#111: the real part of an eigenvalue, at any tolerance."""
    found = gs.respond(single(1.0, damping, 0.0), {}, q_0=[1.0], atol=atol)
    assert found.response_class is ResponseClass.EQUILIBRIUM
    assert_allclose(found.lyapunov, exponent, rtol=1e-12)


def test_multipliers_of_a_linear_oscillator():
    """ChaosTools.jl#111, forced: areas shrink by exp(-c T), and no direction is preferred."""
    found = gs.respond(single(1.0, 0.2, 0.0, **forced(1.0)), {}, 0.2, q_0=[1.0])
    assert (found.response_class, found.period_multiple) == (ResponseClass.PERIODIC, 1)
    assert_allclose(found.multiplier_abs, math.exp(-0.5), rtol=1e-12)
    assert_allclose(found.lyapunov, -0.1, rtol=1e-12)


def test_basins_of_two_wells():
    """ChaosTools.jl#179: half of the starts each, and DOP853 agrees where each ends."""
    at = (np.arange(20) - 9.5) * (4.0 / 19.0)
    x, v = (each.ravel() for each in np.meshgrid(at, at))
    found = gs.respond(single(-1.0, 0.1), {}, q_0=x[:, None], v_0=v[:, None])
    assert (found.response_class == ResponseClass.EQUILIBRIUM).all()
    ends = found.x_end
    assert_allclose(np.abs(ends), 1.0, atol=1e-8)
    assert (ends > 0.0).sum() == 200
    assert (np.sign(ends) == -np.sign(ends[::-1])).all()

    def rhs(t, y):
        x, v = np.split(y, 2)
        return np.concatenate([v, x - x**3 - 0.1 * v])

    run = solve_ivp(rhs, (0.0, 80.0), np.concatenate([x, v]), "DOP853", rtol=1e-10, atol=1e-12)
    assert (np.sign(run.y[:400, -1]) == np.sign(ends)).all()


# --- Free vibration -------------------------------------------------------------------------------


def period_of(run):
    """Period of a free motion from zero velocity: time between its last two maxima."""
    return float(np.diff(run.t_extrema[1::2])[-1])


@pytest.mark.parametrize("a", [0.1, 1.0, 3.0])
def test_the_backbone_of_a_duffing_oscillator(a):
    """BifurcationKit.jl#232: T = 4 K(m) / sqrt(1 + a^2), m = a^2 / (2 + 2 a^2)."""
    free = gs.Oscillator(zeta=0.0, omega_n=1.0 / W, mass=1.0, alpha=1.0, forcing=0.0)
    run = gs.simulate(
        free, gs.Piecewise(0.0, gs.Gap(0.0, 0.0)), 1.0, a, t_end=20.0, rtol=1e-11, atol=1e-14
    )
    period = 4.0 * ellipk(a * a / (2.0 + 2.0 * a * a)) / math.sqrt(1.0 + a * a)
    assert_allclose(period_of(run), period, rtol=1e-11)


def bilinear(zeta, forcing):
    """Natural frequencies of 1 rad/s below zero and 3 rad/s above."""
    oscillator = gs.Oscillator(zeta=zeta, omega_n=1.0 / W, mass=1.0, alpha=0.0, forcing=forcing)
    return oscillator, gs.Piecewise(8.0, gs.Gap(0.0, 0.0), K_ratio=0.0)


@pytest.mark.parametrize("a", [1e-3, 1.0, 100.0])
def test_the_frequency_of_a_breathing_crack_is_that_of_any_amplitude(a):
    """Chu & Shen (1992), and most papers on breathing cracks: T = pi / w_1 + pi / w_2."""
    run = gs.simulate(*bilinear(0.0, 0.0), 1.0, a, t_end=20.0)
    assert_allclose(period_of(run), math.pi + math.pi / 3.0, rtol=1e-12)


@pytest.mark.parametrize(
    ("turns", "multiple", "extremes", "multiplier"),
    [
        (3.0, 2, [-5.003523, 1.667535], None),  # twice the bilinear frequency: a subharmonic
        (0.75, 1, None, 0.98076),
    ],
)
def test_a_forced_bilinear_oscillator(turns, multiple, extremes, multiplier):
    """The same, forced: extremes by another code's matrix exponentials, closure by these."""
    oscillator, law = bilinear(0.025, 1.0)
    found = gs.respond(oscillator, law, turns / W)
    assert (found.response_class, found.period_multiple) == (ResponseClass.PERIODIC, multiple)
    contact = exact.Contact(np.ones(1), 8.0, 0.0, 0.0, 0.0)
    system = exact.System([[1.0]], [[0.05]], [[1.0]], (contact,), (exact.Harmonic(np.ones(1)),))
    end = exact.motion(system, turns / W, [found.x_end], [found.v_end], [], multiple * W / turns)
    assert_allclose(end.state, [found.x_end, found.v_end], atol=1e-8)
    largest = np.abs(np.linalg.eigvals(end.monodromy)).max()
    assert_allclose(found.multiplier_abs, largest, rtol=1e-7)
    if extremes:
        assert_allclose([found.x_min, found.x_max], extremes, atol=1e-6)
    if multiplier:
        assert_allclose(largest, multiplier, atol=1e-5)


@pytest.mark.parametrize("a", [0.1, 1.0, 3.0])
@pytest.mark.parametrize("cubic", [0.0, 1.0])
def test_free_vibration_that_starts_on_its_orbit_is_periodic(a, cubic):
    """BifurcationKit.jl#232: the backbone from `respond`; 2 pi without a cubic spring.

    The solver's energy drifts over the 130 cycles in which the motion is seen to repeat.
    """
    found = gs.respond(single(1.0, cubic=cubic), {}, q_0=[a])
    assert (found.status, found.response_class) == (gs.Status.OK, ResponseClass.PERIODIC)
    c = cubic * a * a
    period = 4.0 * ellipk(c / (2.0 + 2.0 * c)) / math.sqrt(1.0 + c)
    assert_allclose(found.period, period, rtol=1e-8)
    assert_allclose([found.x_min, found.x_max], [-a, a], rtol=1e-7)
    assert_allclose(found.multiplier_abs, 1.0, atol=1e-3)  # twice 1: rounding moves it by its root


@pytest.mark.parametrize("a", [1e-3, 1.0, 100.0])
def test_free_vibration_of_a_breathing_crack_is_periodic(a):
    """Chu & Shen (1992): the same period at any amplitude, from `respond`."""
    crack = gs.System(mass=[[1.0]], stiffness=[[1.0]], contacts={"crack": [1.0]})
    found = gs.respond(crack, bilinear(0.0, 0.0)[1], q_0=[a])
    assert found.response_class is ResponseClass.PERIODIC
    assert_allclose(found.period, math.pi + math.pi / 3.0, rtol=1e-8)
    assert_allclose([found.x_min, found.x_max], [-3.0 * a, a], rtol=1e-8)


# --- Impacts on stiff springs ---------------------------------------------------------------------


@pytest.mark.parametrize(("damping", "n_contacts"), [(0.2, 6), (1.0, 4)])
def test_backlash_between_two_inertias_does_not_chatter(damping, n_contacts):
    """Tiller, Modelica by Example, Backlash.mo."""
    matrices = (
        np.diag([0.4, 1.0]),
        np.array([[0.2, -0.2], [-0.2, 0.2 + damping]]),
        np.array([[11.0, -11.0], [-11.0, 16.0]]),
    )
    names = dict(zip(("mass", "damping", "stiffness"), matrices, strict=True))
    machine = gs.System(**names, contacts={"backlash": [-1.0, 1.0]})
    law, speeds = gs.Piecewise(1000.0, gs.Gap(0.5, 0.5)), [5.0, 0.0]
    run = gs.simulate(machine, law, v_0=speeds, t_end=10.0)
    contact = exact.Contact(np.array([-1.0, 1.0]), 1000.0, 0.5, 0.5)
    truth = exact.motion(exact.System(*matrices, (contact,)), 0.0, [0.0, 0.0], speeds, [], 10.0)
    assert run.n_contacts == truth.n_crossings == n_contacts
    assert_allclose([*run.q_end, *run.v_end], truth.state, atol=1e-10)
    if damping == 0.2:
        found = gs.respond(machine, law, v_0=speeds)
        assert found.response_class is ResponseClass.EQUILIBRIUM
        assert_allclose(found.lyapunov, -0.06703286082416965, rtol=1e-12)


def falling(stiffness, damping=0.0, forcing=0.0):
    """A ball of 1 kg over a floor at zero: the floor is the upper wall of -x."""
    loads = [gs.Harmonic(amplitude=[-9.8], k=0), gs.Harmonic(amplitude=[forcing])]
    ball = gs.System(
        mass=[[1.0]], stiffness=[[0.0]], damping=[[damping]], contacts={"floor": [-1.0]},
        forcing=loads,
    )  # fmt: skip
    return ball, gs.Piecewise(stiffness, gs.Gap(1.0, 0.0), K_ratio=0.0)


def test_a_ball_bounces_on_a_stiff_floor_without_loss():
    """StackOverflow, "odeint not applicable?": k = 1e5 N/m, from 1 m, in closed form."""
    run = gs.simulate(*falling(1e5), 1.0, q_0=[1.0], t_end=10.0)
    turn, speed = math.sqrt(1e5), math.sqrt(2.0 * 9.8)
    fall = speed / 9.8
    contact = (math.pi + 2.0 * math.atan(9.8 / (turn * speed))) / turn  # the mass sinks by m g / k
    assert_allclose([contact, 2.0 * fall + contact], [9.978859429952e-3, 0.9134867623352])
    late = math.fmod(10.0, 2.0 * fall + contact)
    height = 1.0 - 4.9 * min(late, 2.0 * fall + contact - late) ** 2
    assert_allclose(run.q_end[0], height, rtol=1e-10)
    assert_allclose(height, 0.9885430815855681, rtol=1e-12)
    assert_allclose(9.8 * run.q_end[0] + 0.5 * run.v_end[0] ** 2, 9.8, rtol=1e-11)
    assert run.n_contacts == 22


def test_a_ball_that_stays_on_a_shaken_floor():
    """The same ball, forced: pressed down all the time, so that the floor is a spring."""
    found = gs.respond(*falling(1e4, 0.5, 3.0), 20.0 / W)
    assert (found.response_class, found.period_multiple) == (ResponseClass.PERIODIC, 1)
    top = -9.8e-4 + 3.0 / abs(1e4 - 400.0 + 10.0j)
    assert_allclose(found.x_max, top, rtol=1e-8)
    assert_allclose(top, -6.675e-4, rtol=1e-4)
    assert_allclose(found.contact_share, 1.0)


# --- Folds of a frequency response ----------------------------------------------------------------

PYVIB = gs.Oscillator(zeta=0.025, omega_n=1.0 / W, mass=1.0, alpha=0.0, forcing=0.03)
PYVIB_LAW = gs.Piecewise(3.0, gs.Gap(0.1745, 0.1745))
PYVIB_EXACT = exact.System(
    [[1.0]], [[0.05]], [[1.0]],
    (exact.Contact(np.ones(1), 3.0, 0.1745, 0.1745),), (exact.Harmonic([0.03]),),
)  # fmt: skip


def swept(omegas):
    """Responses that follow each other."""
    found, start = [], (0.0, 0.0)
    for omega in omegas:
        found.append(gs.respond(PYVIB, PYVIB_LAW, omega, *start))
        start = found[-1].x_end, found[-1].v_end
    return found


@pytest.mark.parametrize(
    ("fold", "x_max", "first", "last"),
    [
        (1.534979533623, 0.396677003530, 0.16, 0.2450),  # from below
        (1.078508348107, 0.174683765636, 0.24, 0.1710),  # from above, just before it would graze
    ],
)
def test_folds_lie_between_the_jumps_of_a_sweep(fold, x_max, first, last):
    """pyvib's piecewise-linear example; folds by another code's pseudo-arclength."""
    step = math.copysign(5e-4, last - first)
    omegas = np.arange(first, last, step)
    peaks = np.array([each.x_max for each in swept(omegas.tolist())])
    jump = int(np.argmax(np.abs(np.diff(np.log(peaks)))))
    assert min(omegas[jump : jump + 2]) < fold / W < max(omegas[jump : jump + 2])

    # The fold itself: the orbit closes, and one multiplier is 1.
    def condition(unknown):
        *u, turns = unknown
        end = exact.motion(PYVIB_EXACT, turns / W, u[:1], u[1:], [], W / turns)
        return [*(end.state - u), np.linalg.det(end.monodromy - np.eye(2))]

    near = fold * (1.0 - 1e-5 * math.copysign(1.0, step))
    found = swept([*omegas[:jump], *np.linspace(omegas[jump], near / W, 20)])[-1]
    solved = root(condition, [found.x_end, found.v_end, near], tol=1e-13).x
    assert_allclose(solved[2], fold, rtol=1e-8)
    assert_allclose(highest(PYVIB_EXACT, fold / W, solved[:2]), x_max, rtol=1e-7)


@pytest.mark.parametrize("turns", [0.85, 1.0, 1.3, 1.5])
def test_the_frequency_response_beside_the_folds(turns):
    """The same: orbit, multiplier and peak of exact motions."""
    found = gs.respond(PYVIB, PYVIB_LAW, turns / W)
    u, monodromy = orbit(PYVIB_EXACT, turns / W, (found.x_end, found.v_end))
    assert_allclose([found.x_end, found.v_end], u, atol=1e-9)
    assert_allclose(found.x_max, highest(PYVIB_EXACT, turns / W, u), rtol=1e-8)
    assert_allclose(found.multiplier_abs, np.abs(np.linalg.eigvals(monodromy)).max(), rtol=1e-7)


# --- Prestress, and a force that switches ---------------------------------------------------------


def test_a_prestressed_stop_by_a_shifted_coordinate():
    """Modelica Standard Library #44: F = 4 (x + .2) beyond x = -.2; gaps are >= 0 here.

    With y = x + .2 the wall stands at zero, and the spring pulls with a constant .2 N.
    """
    loads = [gs.Harmonic(amplitude=[0.2], k=0), gs.Harmonic(amplitude=[1.0])]
    system = gs.System(
        mass=[[1.0]], stiffness=[[1.0]], damping=[[0.1]], contacts={"stop": [1.0]}, forcing=loads
    )
    omega = 1.3 / W
    found = gs.respond(system, gs.Piecewise(4.0, gs.Gap(1.0, 0.0), K_ratio=0.0), omega)
    contact = exact.Contact(np.ones(1), 4.0, 0.0, 0.0, 0.0)
    harmonics = exact.Harmonic([0.2], 0), exact.Harmonic([1.0])
    truth = exact.System([[1.0]], [[0.1]], [[1.0]], (contact,), harmonics)
    u, _ = orbit(truth, omega, ([found.x_end], [found.v_end]))
    assert_allclose(found.x_max, highest(truth, omega, u), rtol=1e-9)
    assert_allclose(found.x_max - 0.2, 1.885363233145, atol=1e-9)


def test_limit_stops_under_a_force_that_switches():
    """discourse.julialang.org, "Limit stops in a spring-mass system" (2020).

    What is not possible: rigid stops (here they are springs of 1e5 N/m), and a switched force in
    one run. Runs of two seconds under a constant force are exact; a Fourier sum of 25 terms is 7e-3
    off.
    """
    law, q, v = gs.Piecewise(1e5, gs.Gap(3.0, 3.0)), [1.0], [1.0]
    for number in range(5):
        load = gs.Harmonic(amplitude=[-5.0 * (-1.0) ** number], k=0)
        system = gs.System(
            mass=[[1.0]], stiffness=[[1.0]], damping=[[0.2]], contacts={"stop": [1.0]},
            forcing=[load],
        )  # fmt: skip
        run = gs.simulate(system, law, q_0=q, v_0=v, t_end=2.0)
        q, v = run.q_end, run.v_end
    assert_allclose(q[0], -0.45295359, atol=1e-8)


# --- A law of the user's own ----------------------------------------------------------------------


def hertz(x):
    depth = abs(x) - 0.4e-3
    return 0.0 if depth <= 0.0 else (1e6 if x > 0.0 else -1e6) * depth**1.5


def test_hertzian_contact():
    """As in railFE and Serweta et al. (2014): force as depth^1.5, against DOP853.

    Compiling the law, which takes seconds, is no part of the first responses' cost.
    """
    o, law = gs.systems.paper_oscillator(), gs.law(hertz, 1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    first, second = (gs.respond(o, law, [20.0, 25.0]).cpu_time.sum() for _ in range(2))
    assert first < second + 0.05
    run = gs.simulate(o, law, 9.0, t_end=3.0)

    def rhs(t, y):
        x, v = y
        springs = o.omega_n_rad**2 * x + (o.alpha * x**3 + hertz(x)) / o.mass
        return v, o.forcing / o.mass * math.cos(9.0 * W * t) - 2.0 * o.decay_rate * v - springs

    truth = solve_ivp(rhs, (0.0, 3.0), [0.0, 0.0], "DOP853", rtol=1e-12, atol=1e-16).y[:, -1]
    assert_allclose([run.x_end, run.v_end / 50.0], truth / [1.0, 50.0], atol=1e-10)


# --- Datasets -------------------------------------------------------------------------------------

FOLDER = "a#b %41?ü"


@pytest.fixture(scope="module")
def finished(client, tmp_path_factory):
    """A study of two laws at 11 frequencies, its folder and its cache."""
    sweep = {
        "representation": ["piecewise", "piecewise-noevents"], "K_c": [1.4e4],
        "gap": [[4e-4, 4e-4]], "omega": {"start": 9.0, "stop": 10.0, "step": 0.1},
    }  # fmt: skip
    steady = {"settle_tol": 1e-2, "n_periods": 16, "max_period_multiple": 8}
    study = gs.Study.from_dict(
        {"study": {"name": "public"}, "oscillator": PAPER, "sweep": [sweep], "steady": steady}
    )
    folder = tmp_path_factory.mktemp("cases") / FOLDER
    cache = folder / "points-cache"
    with gs.run(study, client, out=folder / "out", cache=cache) as ds:
        yield study, ds.load(), folder, cache


@pytest.mark.parametrize(
    "omega", [9.3, np.nextafter(9.1, 10.0), np.arange(9.0, 10.05, 0.1), [9.0 + 0.1 * 3]]
)
def test_frequencies_are_found_as_they_are_written(finished, omega):
    """xarray#2694 and #3137: floats as coordinates."""
    study, ds, _, cache = finished
    found = gs.query(study, cache=cache, omega=omega)
    assert found.attrs["n_computed"] == 0
    expected = ds.sel(omega=np.round(np.atleast_1d(omega), 1))
    assert found.sizes["omega"] == np.size(omega)
    assert (found["x_max"].values == expected["x_max"].values).all()


@pytest.mark.parametrize("value", [np.float32(9.1), 9.1001])
def test_another_frequency_is_refused_with_those_there_are(finished, value):
    """The same: a number of single precision is another number."""
    study, _, _, cache = finished
    with pytest.raises(gs.StudyError, match=r"9, 9\.1, 9\.2"):
        gs.query(study, cache=cache, omega=value)


def test_folders_with_any_characters_work(finished):
    """ALEAPP#711 and memU#503: run, query and report."""
    study, _, folder, cache = finished
    assert folder.name == FOLDER
    assert (folder / "out" / "report" / "index.html").is_file()
    assert gs.query(study, cache=cache).attrs["n_hits"] == 22


# How xarray says that labels are stored as characters is not what is tested here.
@pytest.mark.parametrize("form", ["NETCDF4", "NETCDF3_64BIT"])
def test_parts_that_are_put_together_and_saved_again_are_whole(finished, tmp_path, form):
    """xarray#11250, #1225, #11028 and #156: no label is cut, no value changed."""
    _, ds, _, _ = finished
    parts = [ds.isel(representation=[i]) for i in (1, 0)]
    whole = xr.concat(
        parts,
        "representation",
        data_vars="minimal",
        coords="minimal",
        compat="equals",
        join="exact",
    )
    for number, part in enumerate(np.array_split(np.arange(11), 3)):
        whole.isel(omega=part).to_netcdf(tmp_path / f"{number}.nc", format=form)
    files = sorted(tmp_path.glob("*.nc"))
    parts = [xr.load_dataset(file) for file in files]
    again = xr.concat(
        parts, "omega", data_vars="minimal", coords="minimal", compat="equals", join="exact"
    )
    xr.testing.assert_equal(again, whole)
    assert again["representation"].values.tolist() == ["piecewise-noevents", "piecewise"]
    assert again["status"].dtype == ds["status"].dtype == np.int8
