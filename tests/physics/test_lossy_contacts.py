"""Contacts that lose energy: closed forms, numbers of high precision, and scipy with events.

Numbers of high precision are from exact flows of linear pieces in 30 digits (mpmath).
"""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from tests.oracles.holds import Held
from tests.oracles.lossy_contacts import HOLD, Lossy, SmoothWall, Wall

import gapsweep as gs
from gapsweep.continuation.family import Family, Window
from gapsweep.continuation.orbits import OrbitEquations, Reference
from gapsweep.errors import StudyError
from gapsweep.integrate.problem import Solver
from gapsweep.report.losses import energy_lost

TURN = 2.0 * math.pi
TIGHT = {"rtol": 1e-12, "atol": 1e-15}
BOTH = pytest.mark.parametrize("engine", ["compiled", "scipy"])


def oscillator(forcing=0.03, mass=1.0, omega_n=1.0 / TURN, zeta=0.025):
    return gs.Oscillator(mass=mass, omega_n=omega_n, zeta=zeta, forcing=forcing)


def stop(K_c=20.0, damping=1.2, **named):
    """A wall on one side, at 0.1745 m."""
    return gs.Piecewise(K_c, gs.Gap(0.0, 0.1745), K_ratio=0.0, damping=damping, **named)


@BOTH
@pytest.mark.parametrize("pulls", [True, False])
def test_one_impact_has_the_restitution_of_the_closed_form(pulls, engine):
    """A free mass meets a damped spring; z is the damping ratio of the mass on the wall."""
    k, c, m = 1e4, 2.0, 0.01
    w, z = math.sqrt(k / m), c / (2.0 * math.sqrt(k * m))
    turned = math.pi
    if not pulls:
        turned -= math.atan2(2.0 * z * math.sqrt(1.0 - z * z), 1.0 - 2.0 * z * z)
    lasted = turned / (w * math.sqrt(1.0 - z * z))
    restitution = math.exp(-z * w * lasted)
    expected = (
        (0.7292476142876709, 3.15741941699828e-3)
        if pulls
        else (0.7440793977217797, 2.95607532474955e-3)
    )
    assert (restitution, lasted) == pytest.approx(expected, rel=1e-13)
    law = gs.Piecewise(k, gs.Gap(1.0, 0.0), damping=c, pulls=pulls)
    run = gs.simulate(
        oscillator(0.0, m, 0.0, 0.0), law, 1.0, 0.0, 0.5, t_end=0.02, tangent=True,
        engine=engine, rtol=1e-12, atol=1e-15,
    )  # fmt: skip
    # The end state is linear in the initial velocity, and the mass leaves at the same time.
    assert -run.v_end / 0.5 == pytest.approx(restitution, rel=1e-9)
    assert run.t_contacts == pytest.approx([lasted], rel=1e-9)
    assert run.monodromy[1, 1] == pytest.approx(-restitution, rel=1e-9)


@BOTH
@pytest.mark.parametrize(
    ("scaled", "restitution"),
    [(0.1, 0.937475579949905), (1.0, 0.593624260040040), (5.0, 0.196980245280519)],
)
def test_an_impact_of_hunt_crossley_has_its_restitution(scaled, restitution, engine):
    """U - ln(1 + U) = -e U - ln(1 - e U) for U = chi u_0, whatever the stiffness and the mass."""
    expected = scaled - math.log1p(scaled)
    assert -restitution * scaled - math.log1p(-restitution * scaled) == pytest.approx(expected)
    for K_c, mass, chi in ((1e4, 0.01, 1.0), (3.0, 2.0, 7.0)):
        law = gs.HuntCrossley(K_c, gs.Gap(100.0, 0.0), chi=chi)
        free, lasts = oscillator(0.0, mass, 0.0, 0.0), 10.0 * math.sqrt(mass / K_c)
        run = gs.simulate(
            free, law, 1.0, 0.0, scaled / chi, t_end=lasts, tangent=True, engine=engine, **TIGHT
        )
        assert -run.v_end * chi / scaled == pytest.approx(restitution, rel=1e-9)
        assert run.n_contacts == 1


@pytest.mark.parametrize(
    ("law", "scaled", "restitution"),
    [
        (gs.Piecewise(1e4, gs.Gap(1.0, 0.0), damping=2.0), 0.5, 0.7440793977217797),
        (gs.Piecewise(1e4, gs.Gap(1.0, 0.0), damping=2.0, pulls=True), 0.5, 0.7292476142876709),
        (gs.HuntCrossley(1e4, gs.Gap(100.0, 0.0), chi=1.0), 1.0, 0.593624260040040),
        (gs.Piecewise(1e4, gs.Gap(100.0, 0.0)), 0.5, 1.0),
    ],
)
def test_an_impact_loses_the_energy_of_its_restitution(law, scaled, restitution):
    mass = 0.01
    free = oscillator(0.0, mass, 0.0, 0.0)
    run = gs.simulate(free, law, 1.0, 0.0, scaled, t_end=0.02, dense_output=True, **TIGHT)
    kinetic = 0.5 * mass * scaled**2
    lost = kinetic * (1.0 - restitution**2)
    assert energy_lost(run, 0) == pytest.approx(lost, rel=1e-9, abs=1e-12 * kinetic)


ORBITS = {  # x_max, determinant and first multiplier
    True: (0.1808062719684468, 0.4207092935349863, -0.117338857855 + 0.637919184515j),
    False: (0.1806356044368126, 0.4513219785538716, -0.126202851011 + 0.659844541502j),
}


@BOTH
@pytest.mark.parametrize("pulls", [True, False])
def test_a_damped_orbit_has_the_multipliers_of_exact_flows(pulls, engine):
    x_max, determinant, multiplier = ORBITS[pulls]
    found = gs.respond(
        oscillator(), stop(pulls=pulls), 0.95 / TURN, 0.1, 0.1, rtol=1e-11, engine=engine
    )
    assert found.x_max == pytest.approx(x_max, rel=1e-9)
    largest = max(found.multipliers, key=lambda one: one.imag)
    assert largest == pytest.approx(multiplier, rel=1e-8)
    assert np.prod(found.multipliers).real == pytest.approx(determinant, rel=1e-9)


@pytest.mark.parametrize("pulls", [True, False])
def test_force_and_time_of_a_damped_contact_are_those_while_it_acts(pulls):
    o, law, omega = oscillator(), stop(pulls=pulls), 0.95
    found = gs.respond(o, law, omega / TURN, 0.1, 0.1, rtol=1e-11)
    wall = Wall([1.0], 0.1745, 20.0, 1.2, pulls=pulls)
    one = np.eye(1)
    oracle = Lossy(one, 0.05 * one, one, [0.03], omega, [wall])
    y = oracle.run([0.1, 0.1], 12 * TURN / omega, rtol=1e-8).y
    for _ in range(5):  # Newton's method
        ended = oracle.run(y, TURN / omega)
        y = y - np.linalg.solve(ended.tangent - np.eye(2), ended.y - y)
    ended = oracle.run(y, TURN / omega)
    assert found.contact_share == pytest.approx(ended.time[0] * omega / TURN, rel=1e-9)
    assert found.force_max == pytest.approx(ended.largest, rel=1e-6)  # at samples
    # what the forcing supplies in a period is lost in damping and contact
    assert ended.worked == pytest.approx(ended.lost, rel=1e-9)


def test_a_force_that_returns_ends_mode_slack():
    """The forcing presses bodies back before they have left the wall."""
    start, omega, one = [0.2300, 0.2450, 0.2540, 0.2930], [0.513, 0.512, 0.475, 0.473], np.eye(1)
    law = gs.Piecewise(2.0, gs.Gap(0.1745, 0.1745), damping=1.0)
    run = gs.simulate(oscillator(0.6), law, omega=omega, x_0=start, t_end=3.0)
    walls = [Wall([side], 0.1745, 2.0, 1.0, pulls=False) for side in (-1.0, 1.0)]
    for x_0, rate, x_end, n in zip(start, omega, run.x_end, run.n_contacts, strict=True):
        found = Lossy(one, 0.05 * one, one, [0.6], rate * TURN, walls).run([x_0, 0.0], 3.0)
        assert x_end == pytest.approx(found.y[0], abs=1e-9)
        assert n == found.n_contacts


def damper(x, v, low, high, k, c):
    """A spring and a damper beyond two walls, which pull."""
    if low <= x <= high:
        return 0.0
    return k * (x - (high if x > high else low)) + c * v


def hunt_crossley(x, v, low, high, k, c):
    if low <= x <= high:
        return 0.0
    return k * (x - high) * (1.0 + c * v) if x > high else k * (x - low) * (1.0 - c * v)


def drawn(seed, kind):
    """A random system of one or two coordinates and one to three contacts, in both forms."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 3))
    mass, k = np.diag(rng.uniform(0.5, 2.0, n)), rng.uniform(0.5, 3.0, 3)
    stiffness = np.array([[k[0] + k[1], -k[1]], [-k[1], k[1] + k[2]]])[:n, :n]
    damping = rng.uniform(0.01, 0.06) * stiffness + 0.02 * mass
    push, omega = np.eye(n)[0] * rng.uniform(0.05, 0.5), rng.uniform(0.6, 2.0)
    directions = [[1.0], [0.0], [1.0]][:1] if n == 1 else [[1.0, 0.0], [0.0, 1.0], [1.0, -1.0]]
    walls, laws, contacts = [], {}, {}
    q, v = rng.uniform(-0.3, 0.3, n), rng.uniform(-0.5, 0.5, n)
    for j, b in enumerate(directions[: 1 if n == 1 else int(rng.integers(1, 4))]):
        K_c, c, ratio = (
            # The oracle misses contacts shorter than its longest step.
            10 ** rng.uniform(0.3, 1.5 if kind.startswith("prestressed") else 2.5),
            10 ** rng.uniform(-2.0, 0.7),
            rng.choice([0.0, 1.5]),
        )
        j_1, j_2 = rng.uniform(0.02, 0.4, 2)
        of_wall = Wall
        if kind.startswith("prestressed"):  # at the origin both walls act, or one
            ratio, j_1, j_2 = 1.5, -j_1, (-0.5 if j != 1 else 1.5) * j_2
        elif kind == "one wall":
            ratio, j_1, j_2 = 1.5, *rng.permutation([math.inf, rng.choice([-0.2, 1.0]) * j_2])
        is_rigid = kind.startswith("rigid") and (j == 0 or kind == "rigid")
        if is_rigid or (kind.startswith("preload and") and j == 1):
            x, K_c, named = float(np.dot(b, q)), 0.0, {"e": rng.uniform(0.3, 1.0)}
            j_1, j_2 = max(j_1, 0.02 - x), max(j_2, 0.02 + x)
            law = gs.Rigid(gs.Gap(j_1, j_2), K_ratio=ratio, restitution=named["e"])
        elif (kind == "hunt-crossley" and j != 1) or (kind == "preload and others" and j == 2):
            named = {"c": 0.0, "chi": c}
            law = gs.HuntCrossley(K_c, gs.Gap(j_1, j_2), K_ratio=ratio, chi=c)
        elif kind == "function":
            named = {"c": c} if j != 1 else {"chi": c}
            low, given = -j_1 if ratio else -1e3, {"k": K_c, "c": c}
            function, ratio = (damper, hunt_crossley)[j == 1], float(ratio > 0.0)
            gap = gs.Gap(j_1, j_2)
            law = gs.law(function, K_c, gap, K_ratio=ratio, low=low, high=j_2, **given)
        elif kind == "tanh":
            sharpness = 10 ** rng.uniform(1.5, 2.5)
            named, of_wall = {"c": c, "sharpness": sharpness}, SmoothWall
            law = gs.Tanh(K_c, gs.Gap(j_1, j_2), sharpness, K_ratio=ratio, damping=c)
        else:
            c = 0.0 if kind in ("one wall", "prestressed") else c
            named = {"c": c, "pulls": not kind.endswith("never pulls") or j == 1}
            pulls = named["pulls"]
            if kind.startswith("preload"):
                named |= {"c": c * (kind != "preload"), "preload": 10 ** rng.uniform(-2.0, 0.3)}
            of_wall_ = {"damping": named["c"], "preload": named.get("preload", 0.0)}
            law = gs.Piecewise(K_c, gs.Gap(j_1, j_2), K_ratio=ratio, pulls=pulls, **of_wall_)
        if j_2 < math.inf:
            walls.append(of_wall(b, j_2, K_c, **named))
        if ratio and j_1 < math.inf:
            walls.append(of_wall([-each for each in b], j_1, ratio * K_c, **named))
        laws[str(j)], contacts[str(j)] = law, b
    system = gs.System(
        mass=mass, damping=damping, stiffness=stiffness, contacts=contacts,
        forcing=[gs.Harmonic(amplitude=push)],
    )  # fmt: skip
    start = np.concatenate([q, v])
    return Lossy(mass, damping, stiffness, push, omega, walls), system, laws, start


@pytest.mark.extended  # layouts of systems
@pytest.mark.parametrize(
    "kind",
    [
        *("pulls", "never pulls", "hunt-crossley", "function", "tanh"),
        *("one wall", "prestressed", "prestressed, pulls", "prestressed, never pulls"),
        *("rigid", "rigid and never pulls"),
        *("preload", "preload, pulls", "preload, never pulls", "preload and others"),
    ],
)
def test_drawn_systems_move_as_scipy_says(kind):
    """State, tangent, number of contacts, and determinant of the tangent."""
    for seed in range(6):
        oracle, system, laws, start = drawn(seed, kind)
        t_end, n = 2.0 * TURN / oracle.omega, system.n
        found = oracle.run(start, t_end)
        size = max(1.0, np.abs(found.tangent).max())  # what becomes of an error
        for engine, rtol, error in (("compiled", 1e-12, 1e-9), ("scipy", 1e-11, 1e-7)):
            run = gs.simulate(
                system, laws, oracle.omega / TURN, q_0=start[:n], v_0=start[n:], t_end=t_end,
                tangent=True, engine=engine, rtol=rtol,
            )  # fmt: skip
            ends = np.concatenate([run.q_end, run.v_end])
            assert ends == pytest.approx(found.y, abs=error * size)
            assert run.monodromy == pytest.approx(found.tangent, abs=error * size**2)
            if kind != "tanh":
                assert run.n_contacts == found.n_contacts
            assert np.linalg.det(run.monodromy) == pytest.approx(
                math.exp(-found.shrunk), abs=error * size**2
            )


@BOTH
@pytest.mark.parametrize("damping", [0.0, 0.2])
def test_a_response_between_walls_that_overlap_is_that_of_two_contacts(damping, engine):
    """Without separation it is linear; with it the oracle has a wall on each side."""
    k, j, omega, named = (2.0, 2.6), (0.1, 0.15), 1.5, {"damping": damping, "pulls": True}
    law = gs.Piecewise(k[0], gs.Gap(-j[0], -j[1]), K_ratio=k[1] / k[0], **named)
    found = gs.respond(oscillator(0.001), law, omega / TURN, engine=engine, rtol=1e-10)
    centre, spring = (k[1] * j[0] - k[0] * j[1]) / (1.0 + sum(k)), 1.0 + sum(k) - omega**2
    reach = 0.001 / math.hypot(spring, (0.05 + 2.0 * damping) * omega)
    assert found.x_max - centre == pytest.approx(reach, rel=1e-6)
    assert (found.contact_share, found.contacts_per_period) == (1.0, 0.0)
    if not damping:
        assert found.force_max == pytest.approx(k[0] * (found.x_max + j[1]), rel=1e-9)

    found = gs.respond(oscillator(0.3), law, omega / TURN, engine=engine, rtol=1e-10)
    walls = [Wall([1.0], -j[1], k[0], damping), Wall([-1.0], -j[0], k[1], damping)]
    one = np.eye(1)
    oracle = Lossy(one, 0.05 * one, one, [0.3], omega, walls)
    y = np.array([found.x_end, found.v_end])
    for _ in range(2):  # Newton's method
        ended = oracle.run(y, TURN / omega)
        y = y - np.linalg.solve(ended.tangent - np.eye(2), ended.y - y)
    assert y == pytest.approx([found.x_end, found.v_end], rel=1e-7)
    assert np.sort_complex(found.multipliers) == pytest.approx(
        np.sort_complex(np.linalg.eigvals(ended.tangent)), rel=1e-6
    )
    assert found.contacts_per_period == 0.5 * ended.n_contacts
    assert found.force_max == pytest.approx(ended.largest, rel=1e-6)  # at samples
    assert ended.worked == pytest.approx(ended.lost, rel=1e-9)


def test_a_mass_at_rest_between_walls_that_overlap_is_held_by_both():
    one = np.eye(1)
    free = gs.System(mass=one, stiffness=one, damping=0.1 * one, contacts={"x": [1.0]})
    laws = {"x": gs.Piecewise(2.0, gs.Gap(-0.1, -0.3))}
    found = gs.respond(free, laws, q_0=0.5)
    assert found.response_class == gs.ResponseClass.EQUILIBRIUM
    assert found.x_max == pytest.approx((2.0 * 0.1 - 2.0 * 0.3) / 5.0, rel=1e-9)
    assert found.contact_share == 1.0


@pytest.mark.parametrize("pulls", [True, False])
def test_gradients_and_branches_know_walls_that_overlap(pulls):
    def at(j_1=-0.1, damping=0.0):
        return gs.Piecewise(2.0, gs.Gap(j_1, -0.15), K_ratio=1.3, damping=damping, pulls=pulls)

    o, omega, h = oscillator(0.3), 1.5 / TURN, 1e-6
    found = gs.gradient(o, at(), ["j_1"], omega=omega)["gradient"].isel(parameter=0)
    above, below = (gs.respond(o, at(-0.1 + by), omega, rtol=1e-12) for by in (h, -h))
    for name in ("x_max", "x_min", "force_max"):
        slope = (getattr(above, name) - getattr(below, name)) / (2.0 * h)
        assert found.sel(quantity=name).item() == pytest.approx(slope, rel=1e-6), name
    assert found.sel(quantity="contact_share").item() == 0.0
    branch = gs.branches(o, at(damping=0.2), "omega", (0.8 / TURN, 2.5 / TURN))
    names = np.array(branch["special"].attrs["flag_meanings"].split())
    # where the mass begins to leave a wall, and ceases to
    assert (names[branch["special"].values] == "grazing").sum() == 2


@pytest.mark.parametrize(("pulls", "fold"), [(True, 1.259531780516715), (False, 1.263345037548026)])
def test_branches_find_the_fold_of_a_damped_contact(pulls, fold):
    law = gs.Piecewise(2.0, gs.Gap(0.1745, 0.1745), damping=0.1, pulls=pulls)
    found = gs.branches(oscillator(), law, between=(1.0 / TURN, 1.5 / TURN), rtol=1e-12)
    names = found["special"].attrs["flag_meanings"].split()
    is_fold = found["special"] == names.index("fold")
    assert np.max(found["omega"].values[is_fold.values]) * TURN == pytest.approx(fold, rel=1e-9)


GRAZE = 0.01892540793813967  # N: amplitude of the forcing at which the free motion grazes the wall


def multipliers_past_the_graze(law, share):
    """Floquet multipliers of the orbit at a forcing of ``GRAZE (1 + share)``."""
    omega = 0.95
    o = oscillator(GRAZE * (1.0 + share))
    phase = math.atan2(0.05 * omega, 1.0 - omega**2)
    y = 0.1745 * np.array([math.cos(phase), omega * math.sin(phase)])
    for _ in range(12):  # Newton's method
        run = gs.simulate(
            o, law, omega / TURN, *y, t_end=TURN / omega, tangent=True, rtol=1e-13, atol=1e-17
        )
        y = y - np.linalg.solve(run.monodromy - np.eye(2), [run.x_end - y[0], run.v_end - y[1]])
    return np.linalg.eigvals(run.monodromy)


def test_a_graze_of_a_contact_that_never_pulls_is_a_border_collision():
    """The trace jumps by damping times an entry of the free flow; past 12.143 N s/m it flips."""
    free = np.sum(multipliers_past_the_graze(stop(), -1e-9)).real
    assert free == pytest.approx(1.6044829407534, rel=1e-12)
    below, flow = math.exp(-0.025 * TURN / 0.95), math.sqrt(1.0 - 0.025**2)
    jump = below * math.sin(flow * TURN / 0.95) / flow
    assert free - 1.2 * jump == pytest.approx(1.2761114905748, rel=1e-12)
    past = [np.sum(multipliers_past_the_graze(stop(), each)).real for each in (1e-8, 1e-10)]
    apart = np.subtract(past, 1.2761114905748)
    assert apart[0] / apart[1] == pytest.approx(10.0, rel=0.01)  # as the root of the distance
    assert abs(apart[1]) < 1e-4
    stable, flipped = (multipliers_past_the_graze(stop(damping=c), 1e-9) for c in (12.0, 12.3))
    assert np.abs(stable) == pytest.approx([0.8476] * 2, abs=5e-5)
    assert np.min(flipped.real) == pytest.approx(-1.11933970298, rel=1e-6)
    smooth = np.sum(multipliers_past_the_graze(stop(pulls=True), 1e-10)).real
    assert smooth == pytest.approx(free, abs=1e-3)


def free_flow(rate, forcing, wall=0.1745):
    """Multipliers of the free flow, and the jump of the trace per unit damping, in closed form."""
    decay, turns = math.exp(-0.025 * TURN / rate), math.sqrt(1.0 - 0.025**2)
    trace = 2.0 * decay * math.cos(turns * TURN / rate)
    return trace, decay**2, -decay * math.sin(turns * TURN / rate) / turns


def borders(damping, rate, between):
    """A branch along the forcing at a graze, kinds of its points, and rows of the graze."""
    compliance = 1.0 / (1.0 - rate**2 + 0.05j * rate)  # of the free motion
    free = between[0] * np.array([compliance.real, -rate * compliance.imag])
    ds = gs.branches(
        oscillator(), stop(damping=damping), "forcing", between=between, omega=rate / TURN,
        at=between[0], start=free,
    ).isel(branch=0)  # fmt: skip
    names = np.array(ds["special"].attrs["flag_meanings"].split())
    seen = names[ds["special"].values]
    (rows,) = np.nonzero(np.isin(seen, ["grazing", "border_fold", "border_flip"]))
    return ds, seen, rows


@pytest.mark.parametrize(
    ("damping", "rate", "kind"),
    [
        (1.2, 0.95, "grazing"),
        (12.0, 0.95, "grazing"),
        (12.143228427173 * (1.0 - 1e-8), 0.95, "grazing"),
        (12.143228427173 * (1.0 + 1e-8), 0.95, "border_flip"),
        (12.3, 0.95, "border_flip"),
        (2.0, 1.3, "border_fold"),
        (12.0, 1.3, "border_fold"),
    ],
)
def test_a_border_collision_is_named_by_the_multipliers_on_both_sides(damping, rate, kind):
    graze = 0.1745 * math.hypot(1.0 - rate**2, 0.05 * rate)
    ds, seen, (row,) = borders(damping, rate, (0.99 * graze, 1.01 * graze))
    assert seen[row] == kind
    assert "fold" not in seen[row - 3 : row + 4]
    assert ds["forcing"].values[row] == pytest.approx(graze, rel=1e-9)
    trace, determinant, jump = free_flow(rate, graze)
    assert ds["forcing"].values[row - 1] == ds["forcing"].values[row]
    for step, sum_of_both in ((row - 1, trace), (row, trace + damping * jump)):
        here = ds.isel(step=step)
        mu = here["multiplier_real"].values + 1j * here["multiplier_imag"].values
        assert mu.sum().real == pytest.approx(sum_of_both, rel=1e-8)
        assert mu.prod().real == pytest.approx(determinant, rel=1e-12)
        assert here["stable"] == int(np.abs(mu).max() < 1.0)
        assert here["n_contacts"] == 2 * (step == row)


def test_orbits_past_a_border_flip_are_unstable():
    """The multiplier at a forcing 1e-9 beyond the graze is -1.11933970298, from exact flows."""
    ds, _, (row,) = borders(12.3, 0.95, (0.0188, 0.0190))
    past = (ds["forcing"] > GRAZE * (1 + 1e-7)) & (ds["forcing"] < GRAZE * (1 + 5e-5))
    assert (ds["stable"].values[past.values] == 0).all()
    at, near = ds["multiplier_real"].values[row].min(), -1.11933970298
    # as the root of the depth: a thousandth of the distance at 1e-3 of the range
    assert at == pytest.approx(near, abs=5e-4)
    assert at < near


@pytest.mark.parametrize("pulls", [True, None])
def test_a_graze_without_a_jump_is_one_orbit_of_its_branch(pulls):
    law = stop(damping=0.0 if pulls is None else 12.3, pulls=bool(pulls))
    ds = gs.branches(oscillator(), law, "forcing", (0.0188, 0.0190), omega=0.95 / TURN)
    forcing = ds["forcing"].values[0]
    assert (np.diff(forcing[np.isfinite(forcing)]) != 0.0).all()
    names = ds["special"].attrs["flag_meanings"].split()
    assert names[ds["special"].values.max()] == "grazing"


def test_a_branch_that_enters_and_leaves_contact_has_both_sides_of_each_graze_in_order():
    """At the two frequencies at which the amplitude of the free motion is the wall's distance."""
    ds = gs.branches(
        oscillator(0.01), stop(damping=1.2), "omega", between=(0.96 / TURN, 1.05 / TURN)
    ).isel(branch=0)
    here = np.isfinite(ds["omega"].values)
    rate, n_contacts = TURN * ds["omega"].values[here], ds["n_contacts"].values[here]
    (rows,) = np.nonzero(np.diff(n_contacts))
    assert n_contacts[rows].tolist() == [0, 2]
    # (1 - r^2)^2 + (r / 20)^2 = (F / j)^2 / k^2
    middle, size = 1.0 - 0.5 * 0.05**2, 0.01 / 0.1745
    apart = math.sqrt(middle**2 - 1.0 + size**2)
    grazes = np.sqrt([middle - apart, middle + apart])
    assert rate[rows] == pytest.approx(grazes, rel=1e-9)
    assert rate[rows + 1] == pytest.approx(grazes, rel=1e-9)


def test_two_orbits_meet_at_a_border_fold_and_none_is_beyond():
    """Newton's method of another integrator finds both before the graze."""
    rate, damping = 1.3, 2.0
    graze = 0.1745 * math.hypot(1.0 - rate**2, 0.05 * rate)
    ds, _, (row,) = borders(damping, rate, (0.99 * graze, 1.01 * graze))
    assert np.nanmax(ds["forcing"].values) == pytest.approx(graze, rel=1e-9)
    oracle = Lossy(
        np.eye(1),
        0.05 * np.eye(1),
        np.eye(1),
        [0.0],
        rate,
        [Wall([1.0], 0.1745, 20.0, damping, False)],
    )
    for side in (-1, 1):
        step = row + 20 * side
        here = ds.isel(step=step)
        one = replace(oracle, F=[here["forcing"].item()])
        ended = one.run(here["start_state"].values, TURN / rate)
        assert ended.y == pytest.approx(here["start_state"].values, abs=1e-9)
        assert (ended.n_contacts > 0) == (side > 0)
        assert (np.abs(np.linalg.eigvals(ended.tangent)).max() < 1.0) == (side < 0)


@pytest.mark.parametrize("at", [0.015, 0.022])
def test_a_branch_of_twice_the_period_begins_at_a_border_flip(at):
    """Its orbits touch the wall once in two periods, return after both and not after one."""
    law, omega = stop(damping=15.0), 0.95 / TURN
    found = gs.branches(oscillator(), law, "forcing", (0.01, 0.03), at=at, omega=omega, follow=1)
    assert found["parent"].values.tolist() == [-1, 0]
    along = found.isel(branch=1).dropna("step", how="all", subset=["forcing"])
    names = np.array(found["special"].attrs["flag_meanings"].split())[along["special"].values]
    ends = along.isel(step=[0, -1])
    assert {*names[[0, -1]]} == {"border_flip", "period_doubling"}
    flip = ends["forcing"].values[names[[0, -1]] == "border_flip"]
    assert flip == pytest.approx([GRAZE], rel=1e-9)
    assert set(along["period_multiple"].values) == {2}
    (rows,) = np.nonzero(
        (along["n_contacts"].values == 2) & (np.abs(along["forcing"] / GRAZE - 1.0).values > 1e-3)
    )
    assert len(rows) > 3
    one, walls = np.eye(1), [Wall([1.0], 0.1745, 20.0, 15.0, pulls=False)]
    for row in rows[[0, -1]]:
        oracle = Lossy(one, 0.05 * one, one, [along["forcing"].values[row]], 0.95, walls)
        y = along["start_state"].values[row]
        halfway, ended = (oracle.run(y, n * TURN / 0.95) for n in (1, 2))
        assert ended.n_contacts == 2
        assert ended.y == pytest.approx(y, abs=1e-10)
        assert np.abs(halfway.y - y).max() > 1e-4
        expected = np.sort(np.linalg.eigvals(ended.tangent))
        assert np.sort(along["multiplier_real"].values[row]) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("low", [0.0, 0.5])
def test_a_graze_along_the_damping_has_both_sets_of_multipliers(low):
    """A wall without damping at one end of the range is one that never pulls elsewhere."""
    omega = 0.95 / TURN
    upper = gs.Piecewise(20.0, gs.Gap(None, 0.1745), damping=1.0)
    lowest = gs.respond(oscillator(), upper, omega, rtol=1e-12).x_min
    both = replace(upper, gap=gs.Gap(-lowest, 0.1745))
    ds = gs.branches(oscillator(), both, "damping", (low, 3.0), omega=omega).isel(branch=0)
    at, n_contacts = ds["damping"].values, ds["n_contacts"].values
    (row,) = np.flatnonzero(np.diff(at) == 0.0)
    assert at[row] == pytest.approx(1.0, rel=1e-9)
    assert abs(np.diff(n_contacts)[row]) == 2
    assert abs(np.diff(ds["multiplier_real"].sum("multiplier").values)[row]) > 1e-3


@pytest.mark.extended
def test_grazes_of_a_chain_have_both_sets_of_multipliers():
    """A graze from beyond the wall, too: seed 230 of the drawn systems has both."""
    oracle, system, laws, _ = drawn(230, "never pulls")
    omega = oracle.omega / TURN
    ds = gs.branches(
        system, laws, between=(0.85 * omega, 1.15 * omega), at=1.1 * omega, max_steps=300
    )
    names = np.array(ds["special"].attrs["flag_meanings"].split())
    kinds = names[ds["special"].values]
    mu = ds["multiplier_real"].values + 1j * ds["multiplier_imag"].values
    more = []  # contacts with the graze than without it: none of a graze from beyond the wall
    for i, row in np.argwhere(np.isin(kinds, ["grazing", "border_fold", "border_flip"])):
        at, n_contacts = ds["omega"].values[i], ds["n_contacts"].values[i]
        pair = (row - 1, row) if at[row - 1] == at[row] else (row, row + 1)
        assert at[pair[0]] == at[pair[1]]
        apart = []  # of an orbit on either side from both sets
        for share in (-1e-9, 1e-9):
            now, y = at[row] * (1.0 + share), ds["start_state"].values[i, row]
            t_end = ds["period_multiple"].values[i, row] / now
            for _ in range(8):  # Newton's method
                run = gs.simulate(
                    system, laws, now, q_0=y[:2], v_0=y[2:], t_end=t_end, tangent=True, rtol=1e-13
                )
                missed = np.concatenate([run.q_end, run.v_end]) - y
                y = y - np.linalg.solve(run.monodromy - np.eye(4), missed)
            here = np.poly(run.monodromy)
            apart.append([np.abs(here - np.poly(mu[i, k])).max() for k in pair])
        assert np.argmin(apart[0]) != np.argmin(apart[1])
        assert np.min(apart, axis=1) == pytest.approx([0.0, 0.0], abs=0.2 * np.max(apart))
        more.append(int(abs(np.diff(n_contacts[[*pair]])[0])))
    assert len(more) > 3
    assert {*more} == {0, 2}


def rigid(restitution, place=1.0, **named):
    """A rigid wall on one side."""
    return gs.Rigid(gs.Gap(None, place), restitution=restitution, **named)


def refused(**named):
    return lambda: gs.simulate(oscillator(), stop(), 0.2, t_end=1.0, **named)


def of_two(law, other):
    """A motion of two masses, with a law each."""
    system = gs.System(
        mass=np.eye(2), stiffness=np.eye(2), contacts={"a": [1.0, 0.0], "b": [0.0, 1.0]},
        forcing=[gs.Harmonic(amplitude=[1.0, 0.0])],
    )  # fmt: skip
    return lambda: gs.simulate(system, {"a": law, "b": other}, 0.2, t_end=1.0)


FREE = gs.law(lambda x, v: x + v, 1.0, gs.Gap(0.1, 0.1))

REFUSED = [
    (of_two(FREE, stop()), r"f\(x, v\) not with damping = 1.2"),
    (
        of_two(FREE, gs.Tanh(1.0, gs.Gap(0.1, 0.1), 1e3)),
        r"smooth laws .* are not: .*located=False",
    ),
    (
        lambda: gs.simulate(oscillator(), FREE, 0.2, t_end=1.0, restart=True),
        r"a force f\(x, v\): not with restart",
    ),
    (lambda: stop(damping=-1.0), r"damping = -1.*>= 0"),
    (lambda: stop(damping=math.inf), r"damping = inf.*finite"),
    (lambda: stop(located=False), r"damping = 1\.2.*located=False"),
    (refused(restart=True), "damping.*restart"),
    (refused(controller="ode45"), "damping.*ode45"),
    (refused(contact_force="as_written"), "as_written"),
    (refused(contact_force="as_written", engine="scipy"), "as_written"),
    (lambda: gs.HuntCrossley(1.0, gs.Gap(0.1, 0.1), chi=-1.0), r"chi = -1: must be >= 0"),
    (
        lambda: gs.HuntCrossley(1.0, gs.Gap(0.1, 0.1), chi="3 N"),
        "chi = '3 N': must be a number in s/m",
    ),
    (
        lambda: gs.Piecewise(1.0, gs.Gap(0.1, 0.1), pulls="no"),
        "pulls = 'no': must be True or False",
    ),
    (lambda: gs.HuntCrossley(1.0, gs.Gap(0.1, 0.1)), "missing.*chi"),
    (lambda: gs.HuntCrossley(1.0, gs.Gap(0.1, 0.1), chi=1.0, damping=2.0), "damping"),
    (lambda: gs.contact_law("huntcrossley-x", 1.0, gs.Gap(0.1, 0.1)), "huntcrossley-x.*>= 0"),
    (lambda: gs.Tanh(1.0, gs.Gap(0.1, 0.1), 1e3, damping=-1.0), r"damping = -1: must be >= 0"),
    (lambda: stop(preload=-1.0), r"preload = -1.*>= 0"),
    (lambda: stop(preload=math.nan), "preload = nan.*finite"),
    (lambda: stop(preload="3 mm"), "preload = '3 mm'.*in N"),
    (lambda: stop(damping=0.0, preload=2.0, located=False), r"preload = 2: .*located=False"),
    (lambda: gs.Tanh(1.0, gs.Gap(0.1, 0.1), 1e3, preload=1.0), "Tanh.*preload"),
    (lambda: gs.HuntCrossley(1.0, gs.Gap(0.1, 0.1), chi=1.0, preload=2.0), "preload"),
    (lambda: rigid(0.8, preload=2.0), "preload"),
    (lambda: gs.Polynomial(1.0, gs.Gap(0.1, 0.1), 5, damping=1.0), "damping.*Piecewise"),
    (lambda: gs.contact_law("poly-5", 1.0, gs.Gap(0.1, 0.1), damping=1.0), "poly-5 has none.*tanh"),
    (lambda: rigid("120 %"), r"restitution = 1\.2: must be in 0\.\.1"),
    (
        lambda: gs.branches(
            gs.Oscillator(mass=1.0, omega_n=1.0, zeta=0.1, forcing=1.0),
            rigid(0.8),
            "omega",
            (1.0, 2.0),
            1.5,
            [9.0, 0.0],
        ),
        r"start = \[9\.0, 0\.0\]: no motion from there",
    ),
    (lambda: rigid(1.2), r"restitution = 1\.2: must be in 0\.\.1"),
    (lambda: rigid(-0.2), r"restitution = -0\.2: must be in 0\.\.1"),
    (lambda: rigid(math.nan), "restitution = nan"),
    (lambda: rigid(0.8, located=False), "Rigid.*located"),
    (lambda: gs.Rigid(gs.Gap(0.0, 0.0), restitution=0.8), "gap = 0/0"),
    (lambda: gs.contact_law("rigid-1.5", 1.0, gs.Gap(0.1, 0.1)), "rigid-1.5.*0 to 1"),
    (lambda: gs.static_error(rigid(0.8)), "rigid: an impact has no finite force"),
    (
        lambda: gs.simulate(oscillator(), rigid(0.8), 0.2, t_end=1.0, restart=True),
        r"restitution = 0\.8.*restart",
    ),
    (
        lambda: gs.branches(
            gs.Oscillator(mass=1.0, omega_n=1.0, zeta=0.0, forcing=0.0),
            stop(),
            "amplitude",
            (0.1, 1),
        ),
        "undamped",
    ),
]


@pytest.mark.parametrize(("call", "said"), REFUSED)
def test_damping_that_cannot_be_is_refused_in_one_line(call, said):
    with pytest.raises(gs.ModelError, match=said) as raised:
        call()
    assert "\n" not in str(raised.value)


def study(of_study=None, **block):
    """A study of the damped orbit."""
    tables = {
        "study": {"name": "damped", **(of_study or {})},
        "oscillator": {"zeta": 0.025, "omega_n": 1.0 / TURN, "mass": 1.0, "forcing": 0.03},
        "sweep": [
            {
                "representation": ["piecewise"],
                "K_c": [20.0],
                "gap": [[0.0, 0.1745]],
                "K_ratio": 0.0,
                "omega": [0.95 / TURN],
                "initial_condition": [[0.1, 0.1]],
                **block,
            }
        ],
    }
    return gs.Study.from_dict(tables)


def test_damping_is_an_axis_of_studies():
    found = study(damping=[0.0, 1.2])
    assert found.grid.dims[-2:] == ("damping", "initial_condition")
    ((_, table),) = found.points(np.arange(2))
    assert table.column("damping").tolist() == [0.0, 1.2]
    (_, models), refused = table.models()
    assert not refused
    assert [law.damping for (law,) in models.laws] == [0.0, 1.2]
    (label,) = {law.losses.never_pulls for (law,) in models.laws if law.damping}
    assert label


def test_a_preload_is_an_axis_of_studies():
    found = study(preload=[0.0, 0.4], damping=1.2)
    ((_, table),) = found.points(np.arange(2))
    assert table.column("preload").tolist() == [0.0, 0.4]
    laws = laws_of(table)
    assert [law.preload for law in laws] == [0.0, 0.4]
    assert {law.damping for law in laws} == {1.2}
    with pytest.raises(StudyError, match="preload: tanh-1e3 has none"):
        study({"pulls": True}, preload=[0.0, 0.4], representation=["piecewise", "tanh-1e3"])
    with pytest.raises(StudyError, match=r"preload.*-1.*>= 0"):
        study(preload=-1.0)


def test_studies_damp_all_laws_that_can_be_and_refuse_others():
    both = {"damping": [0.0, 1.2], "representation": ["piecewise", "tanh-1e3"]}
    found = study({"pulls": True}, **both)
    laws = [law for _, table in found.points(np.arange(4)) for law in laws_of(table)]
    exact = [law.exact for law in laws]
    assert sorted(law.damping for law in laws) == [0.0, 0.0, 1.2, 1.2]
    assert {law.losses.never_pulls for law in exact} == {False}
    with pytest.raises(StudyError, match=r"walls of tanh-1e3 pull; write pulls = true"):
        study(**both)
    with pytest.raises(StudyError, match="damping: poly-5 has none"):
        study(damping=[0.0, 1.2], representation=["piecewise", "poly-5"])
    with pytest.raises(StudyError, match="damping: piecewise-noevents has none"):
        study(damping=[0.0, 1.2], representation=["piecewise-noevents"])


@pytest.mark.parametrize(
    ("family", "name", "axis"),
    [("huntcrossley", "chi", [0.0, 0.3, 2.0]), ("rigid", "restitution", [0.0, 0.8, 1.0])],
)
def test_an_axis_has_the_laws_of_labels_with_its_values(family, name, axis):
    by_axis = study(representation=["piecewise", family], **{name: axis})
    by_label = study(representation=["piecewise", *(f"{family}-{value:g}" for value in axis)])
    (_, exact), (_, swept) = by_axis.points(np.arange(6))
    of_labels = [table for _, table in by_label.points(np.arange(4))]
    assert laws_of(swept) == [law for table in of_labels[1:] for law in laws_of(table)]
    assert len({*swept.keys().tolist()}) == 3
    # Points of another law are computed once: their keys are equal along the axis.
    assert {*exact.keys().tolist()} == {*of_labels[0].keys().tolist()}


def test_each_parameter_of_losses_changes_the_points_of_its_law_alone():
    laws = ["piecewise", "huntcrossley", "rigid"]
    found = study(representation=laws, chi=[0.1, 0.3], restitution=[0.6, 0.8])
    assert found.grid.dims[-3:-1] == ("chi", "restitution")
    tables = [table for _, table in found.points(np.arange(12))]
    assert [len({*table.keys().tolist()}) for table in tables] == [1, 2, 2]
    numbers = [[*zip(*map(table.column, ("chi", "restitution")), strict=True)] for table in tables]
    assert numbers[0] == [(0.0, 1.0)] * 4
    assert numbers[1] == [(0.1, 1.0)] * 2 + [(0.3, 1.0)] * 2
    assert numbers[2] == [(0.0, 0.6), (0.0, 0.8)] * 2
    assert {*tables[2].column("K_c")} == {0.0}  # no parameter of a rigid wall


def test_losses_have_one_value_each():
    swept = {"chi": [0.1, 0.3], "representation": ["piecewise", "huntcrossley"]}
    refused = {
        "chi: missing, huntcrossley": {"chi": None},
        "restitution: missing, rigid": {"representation": ["huntcrossley", "rigid"]},
        "chi: huntcrossley-0.3 has it in its label": {
            "representation": ["huntcrossley", "huntcrossley-0.3"]
        },
        "chi: no representation has it": {"representation": ["piecewise", "rigid-0.8"]},
        r"chi\[1\] = -0.1: must be >= 0": {"chi": [0.1, -0.1]},
        r"restitution\[0\] = 1.01: must be <= 1": {"representation": "rigid", "restitution": 1.01},
        r"restitution\[0\] = -0.1: must be >= 0": {"representation": "rigid", "restitution": -0.1},
        "damping: huntcrossley has none": {"damping": 1.2},
    }
    for words, changes in refused.items():
        with pytest.raises(StudyError, match=words):
            study(**{k: v for k, v in (swept | changes).items() if v is not None})
    with pytest.raises(gs.ModelError, match=r"chi: missing; give it, or write huntcrossley-0\.3"):
        gs.contact_law("huntcrossley", 20.0, gs.Gap(0.0, 0.1))
    with pytest.raises(gs.ModelError, match=r"chi = 0\.5: huntcrossley-0\.3 has it in its label"):
        gs.contact_law("huntcrossley-0.3", 20.0, gs.Gap(0.0, 0.1), chi=0.5)
    with pytest.raises(
        gs.ModelError, match=r"restitution = 0\.5: piecewise has none; rigid without"
    ):
        gs.contact_law("piecewise", 20.0, gs.Gap(0.0, 0.1), restitution=0.5)
    rigid = gs.contact_law("rigid", 20.0, gs.Gap(0.1, 0.1), restitution=0.5)
    assert rigid == gs.Rigid(gs.Gap(0.1, 0.1), restitution=0.5)


def test_a_wall_without_losses_in_another_block_is_at_the_elastic_value():
    block = {"K_c": 20.0, "gap": [0.0, 0.1745], "omega": 0.95 / TURN}
    tables = {
        "study": {"name": "blocks"},
        "oscillator": {"zeta": 0.025, "omega_n": 1.0 / TURN, "mass": 1.0, "forcing": 0.03},
        "sweep": [
            block | {"representation": "piecewise", "damping": [0.0, 1.2]},
            block | {"representation": "huntcrossley", "chi": [0.1, 0.3]},
        ],
    }
    found = gs.Study.from_dict(tables)
    assert found.grid.axes["chi"] == (0.0, 0.1, 0.3)
    assert found.grid.requested.sum() == 4
    tables["sweep"][0]["representation"] = ["huntcrossley-0.3"]
    del tables["sweep"][0]["damping"]
    with pytest.raises(StudyError, match=r"chi: huntcrossley-0\.3 has it in its label"):
        gs.Study.from_dict(tables)


def test_numbers_of_losses_are_drawn_within_their_range():
    def drawn(representation, **of):
        tables = study().spec.tables | {"uncertain": {"samples": 8, "quantities": ["x_max"], **of}}
        tables["sweep"][0]["representation"] = [representation]
        return gs.Study.from_dict(tables)

    uniform = {"uniform": [0.1, 0.9]}
    for family, name in (("huntcrossley", "chi"), ("rigid", "restitution")):
        found = drawn(family, **{name: uniform})
        ((_, table),) = found.points(np.arange(8))
        (law,) = {type(law) for law in laws_of(table)}
        assert law.family == family
        assert table.column(name).tolist() == found.grid.coordinates()[f"drawn_{name}"][:8].tolist()
        with pytest.raises(StudyError, match=f"uncertain.{name}: cannot be uncertain"):
            drawn("piecewise", **{name: uniform})
        with pytest.raises(StudyError, match=f"{name}: {family}-0.5 has it in its label"):
            drawn(f"{family}-0.5", **{name: uniform})
    for representation in ("poly-5", "huntcrossley-0.5"):
        with pytest.raises(StudyError, match=f"damping: {representation} has none"):
            drawn(representation, damping=uniform)
    with pytest.raises(StudyError, match="restitution > 1"):
        drawn("rigid", restitution={"uniform": [0.9, 1.1]})


def test_tables_of_a_study_name_only_parameters_that_its_laws_have():
    """Branches, fits, gradients and histories, by chi and by the restitution."""
    base = {
        "study": {"name": "tables"},
        "oscillator": {"zeta": 0.025, "omega_n": 1.0 / TURN, "mass": 1.0, "forcing": 0.03},
    }
    block = {"representation": ["huntcrossley", "piecewise"], "K_c": 20.0, "gap": [0.0, 0.1745]}
    block |= {"omega": 0.95 / TURN, "chi": [0.1, 0.3]}
    history = {"representation": "huntcrossley", "K_c": 20.0, "gap": [0.0, 0.1], "t_end": 100.0}
    history |= {"omega": 0.1}
    data = {"omega [Hz]": [0.1, 0.2, 0.3], "amplitude [m]": [0.1, 0.2, 0.3]}

    def checked(table, value, **others):
        return gs.Study.from_dict(base | {"sweep": [block | others], table: value})

    one = {"chi": 0.1}
    checked("branches", {"along": "chi"})
    checked("branches", {"along": "chi", "second": "K_c", "range": [10.0, 30.0]})
    checked("gradients", {"by": ["chi", "K_c"]})
    checked("fit", {"data": data, "free": {"chi": [0.0, 1.0]}}, **one)
    found = checked("history", [history | {"chi": 0.3}])
    assert laws_of(found.history_point(*of_history(found)))[0].chi == 0.3
    found = checked("history", [history], **one)
    assert laws_of(found.history_point(*of_history(found)))[0].chi == 0.1
    with pytest.raises(StudyError, match=r"history\[0\]\.chi: swept by the study"):
        checked("history", [history])
    with pytest.raises(StudyError, match=r"history\[0\]\.chi: huntcrossley-0\.3 has it"):
        checked("history", [history | {"representation": "huntcrossley-0.3", "chi": 0.3}])
    with pytest.raises(StudyError, match=r"history\[0\]\.restitution: missing, rigid"):
        checked("history", [history | {"representation": "rigid", "chi": 0.3}])
    for table, value in (
        ("branches", {"along": "omega", "second": "restitution", "range": [0.5, 0.8]}),
        ("gradients", {"by": ["restitution"]}),
        ("fit", {"data": data, "free": {"restitution": [0.5, 0.8]}}),
    ):
        said = "no representation has it" if table == "fit" else "must be one of .*chi"
        with pytest.raises(StudyError, match=f"{table}.*restitution.*: {said}"):
            checked(table, value, **one)
    with pytest.raises(StudyError, match=r"fit.free: chi = -0\.1: must be >= 0"):
        checked("fit", {"data": data, "free": {"chi": [-0.1, 1.0]}}, **one)


def of_history(found):
    (table,) = found.spec.history
    return table, table.representation[0]


def laws_of(table):
    (_, models), refused = table.models()
    assert not refused
    return [law for laws in models.laws for law in laws]


OWN = {"k": 20.0, "c": 1.2, "low": -1e3, "high": 0.1745}


@pytest.mark.parametrize("engine", ["scipy", pytest.param("compiled", marks=pytest.mark.extended)])
def test_a_function_of_displacement_and_velocity_is_the_damper_that_it_writes(engine):
    """Its walls are located: the tangent jumps there, and the determinant is exact."""
    law = gs.law(damper, 20.0, gs.Gap(0.0, 0.1745), K_ratio=0.0, **OWN)
    found = gs.respond(oscillator(), law, 0.95 / TURN, 0.1, 0.1, rtol=1e-11, engine=engine)
    expected = gs.respond(oscillator(), stop(pulls=True), 0.95 / TURN, 0.1, 0.1, rtol=1e-11)
    x_max, determinant, multiplier = ORBITS[True]
    assert found.x_max == pytest.approx(x_max, rel=1e-9)
    assert max(found.multipliers, key=lambda one: one.imag) == pytest.approx(multiplier, rel=1e-8)
    assert np.prod(found.multipliers).real == pytest.approx(determinant, rel=1e-9)
    assert found.contact_share == pytest.approx(expected.contact_share, rel=1e-9)
    assert found.force_max == pytest.approx(expected.force_max, rel=1e-6)  # at samples


@pytest.mark.extended  # a kernel of smooth damped contacts
def test_damped_tanh_becomes_the_damper_that_pulls():
    """With the square of the layer's width, in amplitude, multipliers and force."""
    missed = []
    for epsilon in (1e3, 1e4, 1e5):
        law = gs.Tanh(20.0, gs.Gap(0.0, 0.1745), epsilon, K_ratio=0.0, damping=1.2)
        found = gs.respond(oscillator(), law, 0.95 / TURN, 0.1, 0.1, rtol=1e-10)
        x_max, determinant, multiplier = ORBITS[True]
        largest = max(found.multipliers, key=lambda one: one.imag)
        errors = found.x_max - x_max, np.prod(found.multipliers).real - determinant
        missed.append([*errors, abs(largest - multiplier)])
    assert np.abs(missed[-1]) == pytest.approx([0.0] * 3, abs=2e-7)
    assert missed[1][0] / missed[0][0] == pytest.approx(0.01, rel=0.05)
    assert missed[2][0] / missed[1][0] == pytest.approx(0.01, rel=0.05)


@BOTH
def test_a_function_that_raises_or_returns_nan_ends_a_motion(engine):
    def hole(x, v):
        return math.sqrt(0.05 - x) - math.sqrt(0.05) + v

    law = gs.law(hole, 0.0, gs.Gap(0.0, 0.0))
    run = gs.simulate(oscillator(0.5), law, 0.2, t_end=20.0, engine=engine)
    assert run.status.label == "model_invalid"


def test_a_label_has_the_chi_of_hunt_crossley():
    law = gs.contact_law("huntcrossley-0.30", 20.0, gs.Gap(0.1, 0.1745), K_ratio=2.0)
    assert law == gs.HuntCrossley(20.0, gs.Gap(0.1, 0.1745), chi=0.3, K_ratio=2.0)
    assert gs.canonical_label("huntcrossley-3e-1") == "huntcrossley-0.3"
    x, v = np.array([0.2, 0.2, -0.2, 0.0]), np.array([1.0, -1.0, -1.0, 1.0])
    expected = [20.0 * 0.0255 * 1.3, 20.0 * 0.0255 * 0.7, -40.0 * 0.1 * 1.3, 0.0]
    assert law.force(x, v) == pytest.approx(expected)


@pytest.mark.parametrize("chi", [0.5, 5.0])
def test_responses_to_hunt_crossley_lose_what_the_forcing_supplies(chi):
    """Orbit, multipliers and largest force are those of the oracle, also on a branch along chi."""
    law = gs.HuntCrossley(20.0, gs.Gap(0.0, 0.1745), K_ratio=0.0, chi=chi)
    found = gs.respond(oscillator(), law, 0.95 / TURN, 0.1, 0.1, rtol=1e-11)
    one, wall = np.eye(1), Wall([1.0], 0.1745, 20.0, chi=chi)
    oracle = Lossy(one, 0.05 * one, one, [0.03], 0.95, [wall])
    y = oracle.run([0.1, 0.1], 20 * TURN / 0.95, rtol=1e-8).y
    for _ in range(6):  # Newton's method
        ended = oracle.run(y, TURN / 0.95)
        y = y - np.linalg.solve(ended.tangent - np.eye(2), ended.y - y)
    ended = oracle.run(y, TURN / 0.95)
    assert ended.worked == pytest.approx(ended.lost, rel=1e-9)
    assert np.prod(found.multipliers).real == pytest.approx(math.exp(-ended.shrunk), rel=1e-8)
    expected = np.linalg.eigvals(ended.tangent)
    assert np.sort_complex(found.multipliers) == pytest.approx(np.sort_complex(expected), rel=1e-7)
    assert found.force_max == pytest.approx(ended.largest, rel=1e-6)
    branch = gs.branches(
        oscillator(), law, "chi", between=(0.1, 6.0), omega=0.95 / TURN, rtol=1e-11
    ).isel(branch=0)
    along = branch.dropna("step", how="all", subset=["chi"])
    x_max = np.interp(chi, along["chi"].values, along["x_max"].values)
    assert x_max == pytest.approx(found.x_max, rel=1e-3)


# Trace of the monodromy, by central differences and by exact flows of an orbit with one impact.
TRACES = {0.11: -1.04873111950364, 0.15: -1.12143108139420, 0.2: -1.14004738651642}


@BOTH
@pytest.mark.parametrize("forcing", TRACES)
def test_an_orbit_with_impacts_has_the_multipliers_of_exact_flows(forcing, engine):
    """The product of all multipliers is e^2 exp(-c T)."""
    o, rtol, error = oscillator(forcing, zeta=0.05), 1e-11, 1e-9
    if engine == "scipy":
        rtol, error = 1e-10, 1e-8
    found = gs.respond(o, rigid(0.8), 1.0 / TURN, rtol=rtol, engine=engine)
    assert np.sum(found.multipliers).real == pytest.approx(TRACES[forcing], rel=error)
    assert np.prod(found.multipliers).real == pytest.approx(0.3414323782983, rel=1e-12)
    assert found.contacts_per_period == 1.0
    assert found.contact_share == 0.0
    assert found.x_max == 1.0
    assert found.n_extrema == 2
    assert math.isnan(found.force_max)


def test_the_trace_of_an_orbit_with_impacts_is_that_of_differences():
    oracle = Lossy(
        np.eye(1), 0.1 * np.eye(1), np.eye(1), [0.15], 1.0, [Wall([1.0], 1.0, 0.0, e=0.8)]
    )
    y = np.array([0.65755186, 0.73849094])
    apart = [
        oracle.run(y + h * of, TURN).y[i] for i, of in enumerate(np.eye(2)) for h in (1e-6, -1e-6)
    ]
    trace = (apart[0] - apart[1] + apart[2] - apart[3]) / 2e-6
    assert trace == pytest.approx(TRACES[0.15], rel=1e-7)


def test_impacts_begin_where_the_free_motion_grazes_the_wall():
    """Of amplitude F / (c omega), at resonance."""
    below, past = (
        gs.respond(oscillator(0.1 * (1.0 + by), zeta=0.05), rigid(0.8), 1.0 / TURN, rtol=1e-12)
        for by in (-1e-9, 1e-6)
    )
    assert below.contacts_per_period == 0.0
    assert below.x_max == pytest.approx(1.0, abs=1e-8)
    assert past.contacts_per_period > 0.0
    assert past.x_max == 1.0


@BOTH
@pytest.mark.parametrize("restitution", [0.0, 0.3, 0.8, 0.95])
def test_a_bouncing_ball_comes_to_rest_in_finite_time(restitution, engine):
    g, height = 9.81, 0.3
    ball = gs.System(
        mass=[[2.0]], stiffness=[[0.0]], contacts={"floor": [-1.0]},
        forcing=[gs.Harmonic(amplitude=[-2.0 * g], k=0)],
    )  # fmt: skip
    expected = (1.0 + restitution) / (1.0 - restitution) * math.sqrt(2.0 * height / g)
    run = gs.simulate(
        ball, rigid(restitution, 0.0), q_0=[height], t_end=1.5 * expected, engine=engine, rtol=1e-11
    )
    assert run.t_contacts["floor"][-1] == pytest.approx(expected, rel=1e-9)
    assert run.status == gs.Status.OK
    assert run.v_end == 0.0
    assert run.q_end == pytest.approx(0.0, abs=1e-14)
    # flights, each e times as long as the one before, and the hold
    assert run.n_contacts % 2 == 1
    assert run.n_steps < 1000


@BOTH
@pytest.mark.parametrize(("restitution", "omega"), [(0.3, 0.2), (0.8, 0.05)])
def test_chatter_ends_in_a_hold_until_the_load_lets_go(restitution, omega, engine):
    o = oscillator(1.5, zeta=0.05)
    found = gs.respond(o, rigid(restitution), omega / TURN, engine=engine, rtol=1e-9)
    assert found.response_class == gs.ResponseClass.PERIODIC
    assert found.period_multiple == 1
    assert not found.multipliers.any()  # the motion forgets all
    run = gs.simulate(
        o, rigid(restitution), omega / TURN, found.x_end, found.v_end, n_periods=2, engine=engine,
        rtol=1e-9, tangent=True,
    )  # fmt: skip
    assert run.n_steps < 5000
    assert run.x_end == pytest.approx(found.x_end, abs=1e-9)
    # the force of the hold, k x - F cos(omega t), ends it
    releases = (TURN + math.acos(1.0 / 1.5)) / omega
    assert np.abs(run.t_contacts - releases).min() == pytest.approx(0.0, abs=1e-7 * releases)
    before = run.t_contacts[run.t_contacts < releases - 1e-3]
    share = found.contact_share * TURN / omega
    assert releases - before.max() == pytest.approx(share, rel=1e-6)


def test_a_response_that_a_wall_at_zero_holds_is_that_at_a_shifted_wall():
    """A ball on a table that shakes with 1.1 times gravity; rounding moves it off a wall at 0."""
    g, shakes = 9.81, 5.0
    ball = gs.Oscillator(
        mass=1.0, omega_n=0.0, zeta=0.0, forcing=0.0, mean_load=g,
        base_amplitude=1.1 * g / (TURN * shakes) ** 2,
    )  # fmt: skip
    found = [
        gs.respond(ball, gs.Rigid(gs.Gap(None, wall), restitution=0.5), shakes, wall, rtol=1e-12)
        for wall in (0.0, 1.0)
    ]
    at_zero, shifted = ((one.amplitude, one.contact_share) for one in found)
    assert [one.period_multiple for one in found] == [1, 1]
    assert at_zero == pytest.approx(shifted, rel=1e-9)


def test_responses_with_impacts_lose_what_the_forcing_supplies():
    from gapsweep.report.losses import energy_lost

    o = oscillator(0.2, zeta=0.05)
    found = gs.respond(o, rigid(0.8), 1.0 / TURN, rtol=1e-12)
    run = gs.simulate(
        o, rigid(0.8), 1.0 / TURN, found.x_end, found.v_end, n_periods=1, rtol=1e-12,
        dense_output=True,
    )  # fmt: skip
    nodes, weights = np.polynomial.legendre.leggauss(60)
    ends, balance = [0.0, run.t_contacts[0], TURN], 0.0
    for a, b in itertools.pairwise(ends):
        t = a + 0.5 * (b - a) * (1.0 + nodes)
        v = run.sample(t)[1]
        balance += 0.5 * (b - a) * float(weights @ (0.2 * np.cos(t) * v - 0.1 * v * v))
    assert energy_lost(run, 0) == pytest.approx(balance, rel=1e-8)


@pytest.mark.extended  # layouts of systems
@pytest.mark.parametrize("pick", [(0, 1), (0, 2), (1, 2), (2, 0)])
def test_walls_hold_several_contacts_at_once(pick):
    """States and tangents through chatter and holds of two walls.

    In other draws the oracle passes a wall where impacts of both contacts meet at one time.
    """
    for seed in range(2):
        rng = np.random.default_rng([seed, *pick])
        mass = np.diag(rng.uniform(0.5, 2.0, 2)) + 0.3 * (seed % 2) * (1.0 - np.eye(2))
        k = rng.uniform(0.5, 3.0, 3)
        stiffness = np.array([[k[0] + k[1], -k[1]], [-k[1], k[1] + k[2]]])
        damping = rng.uniform(0.05, 0.2) * stiffness + 0.1 * mass
        push, omega = rng.uniform(0.8, 2.5, 2) * rng.choice([1, -1], 2), rng.uniform(0.15, 0.5)
        walls, laws, contacts = [], {}, {}
        for j in pick:
            b, e, place = (
                ([1.0, 0.0], [0.0, 1.0], [1.0, -1.0])[j],
                0.6 * rng.random(),
                rng.uniform(0.1, 0.4),
            )
            walls.append(Wall(b, place, 0.0, e=e))
            laws[str(j)], contacts[str(j)] = rigid(e, place), b
        system = gs.System(
            mass=mass, damping=damping, stiffness=stiffness, contacts=contacts,
            forcing=[gs.Harmonic(amplitude=push)],
        )  # fmt: skip
        t_end = 1.6 * TURN / omega
        found = Lossy(mass, damping, stiffness, push, omega, walls).run(np.zeros(4), t_end)
        for engine, rtol, error in (("compiled", 1e-12, 1e-9), ("scipy", 1e-10, 1e-7)):
            run = gs.simulate(
                system, laws, omega / TURN, t_end=t_end, tangent=True, engine=engine, rtol=rtol
            )
            ends = np.concatenate([run.q_end, run.v_end])
            assert ends == pytest.approx(found.y, abs=error)
            assert run.monodromy == pytest.approx(found.tangent, abs=1e-5)  # of other flights


def test_a_motion_that_starts_beyond_a_rigid_wall_is_no_motion():
    for engine in ("compiled", "scipy"):
        run = gs.simulate(oscillator(), rigid(0.8, 0.5), 0.2, 0.6, t_end=1.0, engine=engine)
        assert run.status == gs.Status.MODEL_INVALID
    assert "beyond a rigid wall" in gs.respond(oscillator(), rigid(0.8, 0.5), 0.2, 0.6).message


@pytest.mark.parametrize("at", [0.05, 0.15])
def test_a_branch_passes_the_graze_of_a_rigid_wall(at):
    """The free orbit grazes at F / (c omega) = 1; past it multipliers grow as 1 / u.

    With one impact of speed u in a period, the free part of the motion is u d before the impact.
    The rest, (1, u) - u d, has amplitude 10 F: least, at a fold, where F changes as 0 with u.
    """
    found = gs.branches(
        oscillator(zeta=0.05), rigid(0.8), "forcing", (0.02, 0.3), at=at, omega=1.0 / TURN
    ).isel(branch=0)
    found = found.dropna("step", how="all", subset=["forcing"])
    names = np.array(found["special"].attrs["flag_meanings"].split())[found["special"].values]
    forcing, n_contacts = found["forcing"].values, found["n_contacts"].values
    sums = found["multiplier_real"].sum("multiplier").values
    w = math.sqrt(1.0 - 0.05**2)
    c, s = math.cos(w * TURN), math.sin(w * TURN) / w
    free = math.exp(-0.05 * TURN) * np.array([[c + 0.05 * s, s], [-s, c - 0.05 * s]])
    d = free @ np.linalg.solve(np.eye(2) - free, [0.0, -1.8])

    (row,) = np.flatnonzero(names == "grazing")
    assert forcing[row] == pytest.approx(0.1, rel=1e-9)
    assert sums[row] == pytest.approx(np.trace(free), rel=1e-9)
    assert sorted(n_contacts[[row - 1, row + 1]]) == [0, 2]
    assert np.abs(sums[[row - 1, row + 1]]).max() > 10.0
    (fold,) = np.flatnonzero(names == "fold")
    assert forcing[fold] == pytest.approx(
        0.1 * (1.0 - d[1]) / math.hypot(d[0], 1.0 - d[1]), rel=1e-9
    )
    assert sums[fold] == pytest.approx(1.0 + 0.8**2 * np.linalg.det(free), rel=1e-5)
    assert sorted(forcing[[0, -1]]) == pytest.approx([0.02, 0.3], rel=1e-12)


def test_a_branch_goes_on_where_an_impact_passes_the_phase_of_the_initial_state():
    """The velocity there is reversed at once, as the impact comes before the end of the period."""
    found = gs.branches(
        oscillator(zeta=0.05), rigid(0.8), "forcing", (0.45, 2.0), at=0.6, omega=0.7 / TURN
    ).isel(branch=0)
    found = found.dropna("step", how="all", subset=["forcing"])
    assert sorted(found["forcing"].values[[0, -1]]) == pytest.approx([0.45, 2.0], rel=1e-12)
    (x, v), forcing = found["start_state"].values.T, found["forcing"].values
    jumps = np.flatnonzero(np.abs(np.diff(v)) > 0.5)
    assert len(jumps) == 1
    assert x[jumps] == pytest.approx([1.0], abs=1e-6)
    one = np.eye(1)
    for row in (jumps[0], jumps[0] + 1, len(x) - 1, 0):
        oracle = Lossy(one, 0.1 * one, one, [forcing[row]], 0.7, [Wall([1.0], 1.0, 0.0, e=0.8)])
        start = np.array([min(x[row], 1.0 - 1e-12), v[row]])
        one_later, two_later = (oracle.run(start, n * TURN / 0.7).y for n in (1.37, 2.37))
        assert two_later == pytest.approx(one_later, abs=1e-6)


@pytest.mark.extended  # the oracle takes seconds
@pytest.mark.parametrize("preload", [0.3, 0.5])
def test_a_branch_passes_the_graze_of_a_preload(preload):
    """The wall changes a small speed u by 2 u N_0 / (N_0 + a), a the acceleration back from it.

    The free orbit grazes at F / (c omega) = 1, with a = 1. Past it its part of the motion is
    (1, u) - u d before the contact, so that F changes as -0.1 u d_1. The depth is
    u^2 / 2 (N_0 + a).
    """
    found = gs.branches(
        oscillator(zeta=0.05), clutch(preload, place=1.0), "forcing", (0.02, 0.3), at=0.05,
        omega=1.0 / TURN,
    )  # fmt: skip
    assert found.attrs["n_lost"] == 0
    found = found.isel(branch=0)
    names = np.array(found["special"].attrs["flag_meanings"].split())[found["special"].values]
    forcing, n_contacts = found["forcing"].values, found["n_contacts"].values
    assert sorted(forcing[[0, -1]]) == pytest.approx([0.02, 0.3], rel=1e-12)
    (row,) = np.flatnonzero(names == "grazing")
    assert forcing[row] == pytest.approx(0.1, rel=1e-9)
    assert sorted(n_contacts[[row - 1, row + 1]]) == [0, 2]

    w, side = math.sqrt(1.0 - 0.05**2), 1 if n_contacts[row + 1] else -1
    c, s = math.cos(w * TURN), math.sin(w * TURN) / w
    free = math.exp(-0.05 * TURN) * np.array([[c + 0.05 * s, s], [-s, c - 0.05 * s]])
    kick = -2.0 * preload / (preload + 1.0)
    d = free @ np.linalg.solve(np.eye(2) - free, [0.0, kick])
    past = row + side * np.arange(1, 11)
    u = np.sqrt(2.0 * (preload + 1.0) * (found["x_max"].values[past] - 1.0))
    # Orbits are known to some 1e-9 of the forcing, which counts most next to the graze.
    first = np.polyfit(u, (forcing[past] - 0.1) / u, 2, w=u)[-1]
    assert first == pytest.approx(-0.1 * d[0], rel=1e-3)

    (fold,) = np.flatnonzero(names == "fold")
    one, walls = np.eye(1), [Wall([1.0], 1.0, 20.0, preload=preload)]
    for i in (fold, 0, -1):  # the oracle misses shorter contacts
        oracle = Lossy(one, 0.1 * one, one, [forcing[i]], 1.0, walls)
        y = found["start_state"].values[i]
        ended = oracle.run(y, TURN)
        assert ended.n_contacts == n_contacts[i]
        assert ended.y == pytest.approx(y, abs=1e-9)
        expected = np.sort(np.abs(np.linalg.eigvals(ended.tangent)))
        mu = found["multiplier_real"].values[i] + 1j * found["multiplier_imag"].values[i]
        assert np.sort(np.abs(mu)) == pytest.approx(expected, rel=1e-4)
        assert i != fold or expected[1] == pytest.approx(1.0, abs=1e-5)


@pytest.mark.extended  # the oracle takes seconds
def test_a_branch_passes_the_graze_of_a_preload_from_beyond_the_wall():
    """A load holds the mass in contact; the motion there is linear up to the graze."""
    load, preload, place, rate = 1.0, 0.4, 0.1, 1.3
    stiffness = 4.0
    depth = (load - preload - place) / stiffness
    graze = depth * math.hypot(stiffness - rate**2, 0.1 * rate)
    o = replace(oscillator(zeta=0.05), mean_load=load)
    found = gs.branches(
        o, clutch(preload, 3.0, place), "forcing", (0.02, 2.0 * graze), at=0.05, omega=rate / TURN
    ).isel(branch=0)
    names = np.array(found["special"].attrs["flag_meanings"].split())[found["special"].values]
    (row,) = np.flatnonzero(names == "grazing")
    forcing, n_contacts = found["forcing"].values, found["n_contacts"].values
    assert forcing[row] == pytest.approx(graze, rel=1e-9)
    assert sorted(n_contacts[[row - 1, row + 1]]) == [0, 2]
    assert sorted(forcing[[0, -1]]) == pytest.approx([0.02, 2.0 * graze], rel=1e-12)
    # of the coordinate without the mean load, with a wall that is so much closer
    one, walls = np.eye(1), [Wall([1.0], place - load, 3.0, preload=preload)]
    for i in (0, -1):
        oracle = Lossy(one, 0.1 * one, one, [forcing[i]], rate, walls)
        y = found["start_state"].values[i] - [load, 0.0]
        assert oracle.run(y, TURN / rate).y == pytest.approx(y, abs=1e-9)


def test_a_branch_of_twice_the_period_ends_at_a_graze_of_the_other_one():
    """Every other turn passes the wall, less and less; in the end the orbit has one period."""
    o, law = oscillator(0.184, zeta=0.04), clutch(0.009, 9.35, 0.438)
    found = gs.branches(o, law, between=(0.11, 0.16), at=0.15, follow=1)
    names = found["ends"].attrs["flag_meanings"].split()
    assert found["parent"].values.tolist() == [-1, 0]
    assert names[int(found["ends"][1])] == names[int(found["begins"][1])] == "branch_point"
    last = found.isel(branch=1, step=int(found["n_orbits"][1]) - 1)
    rate = TURN * last["omega"].item()
    assert 0.184 / math.hypot(1.0 - rate**2, 0.08 * rate) == pytest.approx(0.438, rel=1e-9)
    assert last["period_multiple"] == 2
    grazing = last["special"].attrs["flag_meanings"].split().index("grazing")
    assert last["special"] == grazing
    parent = found.isel(branch=0)
    at = np.flatnonzero(parent["special"].values == grazing)
    y = parent["start_state"].values[at[0]]
    assert last["start_state"].values == pytest.approx(y, rel=1e-7)


def test_a_branch_goes_on_where_a_damped_wall_passes_the_phase_of_the_initial_state():
    """There the acceleration jumps: the initial state has a kink along the branch."""
    o = oscillator(0.366, zeta=0.12)
    law = gs.Piecewise(20.0, gs.Gap(0.45, 0.377), damping=1.2, pulls=True)
    found = gs.branches(o, law, between=(0.06, 0.12), at=0.09).isel(branch=0)
    rate, (x, v) = TURN * found["omega"].values, found["start_state"].values.T
    assert sorted(rate[[0, -1]]) == pytest.approx([0.06 * TURN, 0.12 * TURN], rel=1e-12)
    order = np.argsort(rate)
    is_beyond = x[order] > 0.377
    (row,) = np.flatnonzero(np.diff(is_beyond))
    assert 3 < row < len(x) - 4
    slopes = np.diff(v[order])[[row - 1, row + 1]] / np.diff(rate[order])[[row - 1, row + 1]]
    assert abs(slopes[1] / slopes[0] - 1.0) > 0.1
    walls = [Wall([1.0], 0.377, 20.0, 1.2), Wall([-1.0], 0.45, 20.0, 1.2)]
    for i in order[[row - 2, row + 3]]:
        oracle = Lossy(np.eye(1), 0.24 * np.eye(1), np.eye(1), [0.366], rate[i], walls)
        ended = oracle.run([x[i], v[i]], TURN / rate[i])
        assert ended.y == pytest.approx([x[i], v[i]], abs=1e-10)
        mu = found["multiplier_real"].values[i] + 1j * found["multiplier_imag"].values[i]
        expected = np.linalg.eigvals(ended.tangent)
        assert np.sort_complex(mu) == pytest.approx(np.sort_complex(expected), abs=1e-8)


def test_a_branch_goes_on_where_a_preload_passes_the_phase_of_the_initial_state():
    """The branch has a fold and ends where it begins, on the other side of the phase."""
    o, law = oscillator(0.49, zeta=0.0388), gs.Piecewise(8.48, gs.Gap(0.136, 0.1809), preload=0.5)
    found = gs.branches(o, law, "preload", (0.326, 0.659), at=0.344, omega=0.0934).isel(branch=0)
    assert found["preload"].values[[0, -1]] == pytest.approx([0.659, 0.659], rel=1e-12)
    x, rate, one = found["start_state"].values[:, 0], 0.0934 * TURN, np.eye(1)
    assert x.min() < 0.1809 < x.max()
    for i in (int(x.argmin()), int(x.argmax())):  # an end of the branch on either side
        named = {"k": 8.48, "preload": found["preload"].values[i]}
        walls = [Wall([1.0], 0.1809, **named), Wall([-1.0], 0.136, **named)]
        y = found["start_state"].values[i]
        ended = Lossy(one, 2.0 * 0.0388 * one, one, [0.49], rate, walls).run(y, TURN / rate)
        assert ended.y == pytest.approx(y, abs=1e-9)
        assert ended.n_contacts == found["n_contacts"].values[i]


def test_a_branch_goes_on_where_a_moving_wall_passes_the_phase_of_the_initial_state():
    """The speed changes along the branch in another way on either side of the wall."""
    o, ends, one, rate = oscillator(0.421, zeta=0.032), (0.525, 0.895), np.eye(1), 0.1409 * TURN
    law = gs.Piecewise(3.79, gs.Gap(0.353, 0.599), damping=0.063, preload=0.461)
    found = gs.branches(o, law, "j_2", ends, at=0.7, omega=0.1409).isel(branch=0)
    assert found["j_2"].values[[0, -1]] == pytest.approx(np.array(ends), rel=1e-12)
    is_beyond = found["start_state"].values[:, 0] > found["j_2"].values
    assert is_beyond.any() != is_beyond.all()
    for i in (0, -1):
        place, named = found["j_2"].values[i], {"c": 0.063, "pulls": False, "preload": 0.461}
        walls = [Wall([1.0], place, 3.79, **named), Wall([-1.0], 0.353, 3.79, **named)]
        y = found["start_state"].values[i]
        ended = Lossy(one, 0.064 * one, one, [0.421], rate, walls).run(y, TURN / rate)
        assert ended.y == pytest.approx(y, abs=1e-9)


def test_a_doubling_is_located_where_rounding_is_larger_than_the_last_step():
    """A branch of two periods ends there: a multiplier of the orbit of one period is -1."""
    o, omega = oscillator(0.496, zeta=0.0176), 0.299
    law = gs.Piecewise(129.4, gs.Gap(0.489, 0.333), preload=0.0229)
    found = gs.branches(o, law, "j_2", (0.3, 0.45), at=0.333, omega=omega)
    names = found["ends"].attrs["flag_meanings"].split()
    (branch,) = np.flatnonzero(found["ends"].values == names.index("branch_point"))
    last = found.isel(branch=branch, step=int(found["n_orbits"][branch]) - 1)
    assert last["period_multiple"] == 2
    law = replace(law, gap=gs.Gap(0.489, last["j_2"].item()))
    run = gs.simulate(
        o, law, omega, *last["start_state"].values, n_periods=1, tangent=True, engine="scipy",
        rtol=1e-12,
    )  # fmt: skip
    assert [run.x_end, run.v_end] == pytest.approx(last["start_state"].values, abs=1e-6)
    assert np.linalg.eigvals(run.monodromy).real.min() == pytest.approx(-1.0, abs=1e-5)


@pytest.mark.parametrize("place", [2e-12, -2e-12])
def test_a_derivative_by_a_parameter_crosses_no_impact(place):
    """It is that of the free motion 2e-12 before an impact, and that past it as far behind."""
    free, window = (oscillator(f) for f in (0.0, 1.0)), Window("forcing", 0.2, 0.8)
    far = gs.Piecewise(1.0, gs.Gap(9.0, 9.0))
    first, second = (gs.simulate(o, far, 1.0, 0.0, 1.0, n_periods=1, **TIGHT) for o in free)
    by_x, by_v = second.x_end - first.x_end, second.v_end - first.v_end
    x, v = first.x_end + 0.5 * by_x, first.v_end + 0.5 * by_v
    family = Family(oscillator(), rigid(0.8, x + place), 1.0, ("forcing",), {"forcing": 0.5})
    equations = OrbitEquations(family, (window,), Solver.of(rtol=1e-12))
    one, y = np.ones((1, 2)), np.array([[0.0, 1.0]])
    reference = Reference(size=one, duration=one[0], multiple=np.ones(1, int), y=y, rate=y)
    found = equations.evaluate(np.array([[0.0, 1.0, 0.5]]), reference)
    if place < 0.0:  # the impact comes earlier by by_x / v
        before, after = 0.5 - 0.05 * v - x, 0.5 + 0.05 * 0.8 * v - x
        by_x, by_v = -0.8 * by_x, -0.8 * by_v + (after + 0.8 * before) * by_x / v
    assert found.is_ok.all()
    assert found.jacobian[0, :, -1] == pytest.approx([0.6 * by_x, 0.6 * by_v], rel=1e-4)


def test_a_branch_along_the_restitution_has_its_determinants():
    found = gs.branches(
        oscillator(0.2, zeta=0.05), rigid(0.8), "restitution", between=(0.6, 0.9),
        omega=1.0 / TURN, rtol=1e-11,
    ).isel(branch=0)  # fmt: skip
    along = found.dropna("step", how="all", subset=["restitution"])
    product = (along["multiplier_real"] + 1j * along["multiplier_imag"]).prod("multiplier").values
    expected = along["restitution"].values ** 2 * math.exp(-0.1 * TURN)
    assert product.real == pytest.approx(expected, rel=1e-9)


def test_a_label_has_the_restitution_of_rigid_walls():
    law = gs.contact_law("rigid-0.80", 20.0, gs.Gap(0.1, 0.2))
    assert law == gs.Rigid(gs.Gap(0.1, 0.2), restitution=0.8)
    assert gs.canonical_label("rigid-8e-1") == "rigid-0.8"
    assert law.force([0.0, 0.2, -0.1]).tolist() == [0.0, math.inf, -math.inf]


@pytest.mark.extended  # layouts of systems
@pytest.mark.parametrize("pulls", [True, False])
def test_a_damped_wall_does_not_move_what_a_rigid_wall_holds(pulls):
    """The other coordinate moves as if it were alone, and counts are those of recorded times."""
    damped = gs.Piecewise(20.0, gs.Gap(None, 0.1), damping=3.0, pulls=pulls)
    k, load = np.array([[2.0, -1.0], [-1.0, 2.0]]), {"k": 0, "amplitude": [5.0, 0.0]}
    both = gs.System(
        mass=np.eye(2), stiffness=k, damping=0.1 * k,
        contacts={"stop": [1.0, 0.0], "wall": [-1.0, 1.0]},
        forcing=[gs.Harmonic(**load), gs.Harmonic(amplitude=[0.0, 1.0])],
    )  # fmt: skip
    alone = gs.System(
        mass=[[1.0]], stiffness=[[2.0]], damping=[[0.2]], contacts={"wall": [1.0]},
        forcing=[gs.Harmonic(amplitude=[1.0])],
    )  # fmt: skip
    laws = {"stop": gs.Rigid(gs.Gap(None, 0.0), restitution=0.0), "wall": damped}
    expected = gs.simulate(alone, {"wall": damped}, 0.2, n_periods=3, tangent=True, **TIGHT)
    assert expected.n_contacts > 4
    for engine in ("compiled", "scipy"):
        run = gs.simulate(
            both, laws, 0.2, n_periods=3, tangent=True, engine=engine, rtol=1e-11, atol=1e-13
        )
        assert run.q_end == pytest.approx([0.0, expected.q_end[0]], abs=1e-9)
        assert run.n_contacts == len(run.t_contacts["wall"]) == expected.n_contacts
        assert run.monodromy[::2] == pytest.approx(np.zeros((2, 4)), abs=1e-15)
        assert run.monodromy[1::2, 1::2] == pytest.approx(expected.monodromy, abs=1e-7)


@BOTH
@pytest.mark.parametrize("second", [[], [0.0, 1.0]])
def test_what_a_rigid_wall_holds_all_the_time_is_a_response(second, engine):
    """A load of 5 N presses the first coordinate on its wall; the second one is linear."""
    n = 2 if second else 1
    k = np.array([[2.0, -1.0], [-1.0, 2.0]])[:n, :n]
    loads = [gs.Harmonic(k=0, amplitude=[5.0, 0.0][:n]), gs.Harmonic(amplitude=[0.3, 1.0][:n])]
    pressed = gs.System(
        mass=np.eye(n), stiffness=k, damping=0.1 * k, contacts={"stop": np.eye(n)[0]}, forcing=loads
    )
    law = gs.Rigid(gs.Gap(0.5, 0.2), restitution=0.6)
    found = gs.respond(pressed, law, 0.2, engine=engine, rtol=1e-9)
    assert found.response_class is gs.ResponseClass.PERIODIC, found.message
    assert (found.contact_share, found.contacts_per_period) == (1.0, 0.0)
    peak, trough = np.atleast_1d(found.x_max), np.atleast_1d(found.x_min)
    assert (peak[0], trough[0]) == pytest.approx((0.2, 0.2), rel=1e-12)
    assert found.multipliers[-2:] == pytest.approx(0.0, abs=1e-15)
    if second:
        w = 0.2 * TURN
        reach = 1.0 / abs(2.0 - w**2 + 0.2j * w)
        assert (peak[1], trough[1]) == pytest.approx((0.1 + reach, 0.1 - reach), rel=1e-6)


def clutch(preload, K_c=20.0, place=0.1745, **named):
    """A wall on one side with a preload."""
    return gs.Piecewise(K_c, gs.Gap(None, place), preload=preload, **named)


def pressed(load, *, forcing=0.0):
    """A mass that a load presses on a wall at the origin."""
    return gs.System(
        mass=[[1.0]], stiffness=[[1.0]], damping=[[0.05]], contacts={"wall": [1.0]},
        forcing=[gs.Harmonic(k=0, amplitude=[load]), gs.Harmonic(amplitude=[forcing])],
    )  # fmt: skip


@BOTH
def test_an_orbit_at_a_preload_has_the_multipliers_of_exact_flows(engine):
    """Tangent at entry I - (N_0 / u) P, at exit I + (N_0 / u) P: the wall changes no volumes."""
    run = gs.simulate(
        oscillator(), clutch(0.01), 0.95 / TURN, 0.16, 0.07, n_periods=1, tangent=True,
        engine=engine, **TIGHT,
    )  # fmt: skip
    assert (run.x_end, run.v_end) == pytest.approx(
        (0.16580780744531769, 0.0929658873149239), rel=1e-9
    )
    expected = [[1.033140875812348, 0.46740990492899], [-3.67288736446099, -0.966295069230326]]
    assert run.monodromy == pytest.approx(np.array(expected), rel=1e-8)
    found = gs.respond(oscillator(), clutch(0.01), 0.95 / TURN, 0.1, 0.1, rtol=1e-11, engine=engine)
    assert found.x_max == pytest.approx(0.18047407716891018, rel=1e-9)
    largest = max(found.multipliers, key=lambda one: one.imag)
    assert largest == pytest.approx(-0.17724310414961629 + 0.8288605924272671j, rel=1e-8)
    assert np.prod(found.multipliers).real == pytest.approx(math.exp(-0.05 * TURN / 0.95), rel=1e-9)
    assert found.force_max == pytest.approx(0.01 + 20.0 * (found.x_max - 0.1745), rel=1e-9)


def bounces(times, load=0.1, preload=0.5, speed=0.3):
    """Numbers of crossings of the wall up to times, by exact flows of both sides."""
    w, decay, t, n, found = math.sqrt(1.0 - 0.025**2), 0.025, 0.0, 0, []
    for until in times:
        while True:
            rest = load - preload if speed > 0.0 else load  # position of equilibrium
            of_sine = (speed - decay * rest) / w

            def x(s, rest=rest, of_sine=of_sine):
                return rest + math.exp(-decay * s) * (
                    of_sine * math.sin(w * s) - rest * math.cos(w * s)
                )

            step = 0.5 * abs(speed / rest)
            low, high = step, 2.0 * step
            while x(high) * speed > 0.0:
                low, high = high, high + step
            for _ in range(70):
                middle = 0.5 * (low + high)
                low, high = (middle, high) if x(middle) * speed > 0.0 else (low, middle)
            if t + high > until:
                break
            sine, cosine = math.sin(w * high), math.cos(w * high)
            rate = w * (of_sine * cosine + rest * sine) - decay * (of_sine * sine - rest * cosine)
            speed, t, n = math.exp(-decay * high) * rate, t + high, n + 1
        found.append(n)
    return found


def test_a_pressed_mass_bounces_on_a_preload_until_the_wall_holds_it():
    """Bounces become exponentially more frequent; the hold ends them, within the tolerance."""
    law = clutch(0.5, 1e-6, 0.0)  # a constant force
    counts = [
        gs.simulate(pressed(0.1), {"wall": law}, 0.2, v_0=[0.3], t_end=t_end, rtol=rtol)
        for rtol, t_end in ((1e-9, 64.0), (1e-9, 256.0), (1e-6, 460.0), (1e-6, 1e4))
    ]
    expected = bounces((64.0, 256.0))
    assert [run.n_contacts for run in counts[:2]] == expected
    assert counts[2].n_contacts == counts[3].n_contacts < 4e4
    assert counts[3].v_end == 0.0
    assert counts[3].q_end == pytest.approx(0.0, abs=1e-15)
    last = counts[2].t_contacts["wall"][-1]
    before = gs.simulate(
        pressed(0.1), {"wall": law}, 0.2, v_0=[0.3], t_end=last - 1e-6, rtol=1e-6
    )  # fmt: skip
    assert 1e-8 < before.v_end[0] ** 2 / (2.0 * 0.1) < 1e-6  # height of the first flight left out


@BOTH
@pytest.mark.parametrize("damping", [0.0, 2.0])
def test_a_mass_at_rest_on_a_preload_stays_until_the_load_is_more_or_none(damping, engine):
    """The load 0.3 - 0.2 cos(wt) exceeds the preload 0.4 at its third part of a turn."""
    one, w = np.eye(1), 0.5
    loads = [0.3, -0.2]
    run = gs.simulate(
        pressed(loads[0], forcing=loads[1]), {"wall": clutch(0.4, 5.0, 0.0, damping=damping)},
        w / TURN, n_periods=1, tangent=True, engine=engine, rtol=1e-12, dense_output=True,
    )  # fmt: skip
    begins = math.acos(-0.5) / w
    still = run.sample(np.linspace(0.0, begins, 20))
    assert np.abs(still[:2]).max() < 1e-12
    assert run.sample(begins + 0.5)[0] > 1e-4

    class Pressed(Lossy):
        def _rhs(self, modes, inverse):
            rates = super()._rhs(modes, inverse)

            def loaded(t, y):
                found = rates(t, y)
                found[1] += 0.0 if HOLD in modes else loads[0]
                return found

            return loaded

    wall = Wall([1.0], 0.0, 5.0, damping, pulls=not damping, preload=0.4)
    expected = Pressed(one, 0.05 * one, one, [loads[1]], w, [wall]).run([0.0, 0.0], TURN / w)
    assert (run.q_end[0], run.v_end[0]) == pytest.approx(expected.y, abs=1e-7)
    assert run.n_contacts == expected.n_contacts
    assert run.t_contacts["wall"] == pytest.approx(expected.times, abs=1e-7)
    assert not run.monodromy.any()
    assert not expected.tangent.any()


@pytest.mark.extended  # layouts of systems
@BOTH
def test_a_hold_ends_at_once_where_another_wall_changes_its_force(engine):
    """A stop between both masses has the force 1 N + 6 Ns/m u, more than the wall's 0.3 N."""
    system = gs.System(
        mass=np.eye(2), stiffness=np.eye(2), damping=0.1 * np.eye(2),
        contacts={"wall": [1.0, 0.0], "stop": [1.0, -1.0]},
        forcing=[gs.Harmonic(k=0, amplitude=[0.3, 0.0])],
    )  # fmt: skip
    laws = {
        "wall": clutch(0.5, 1.0, 0.0, damping=1.0),
        "stop": clutch(1.0, 1.0, 0.2, damping=6.0),
    }
    run = gs.simulate(
        system, laws, q_0=[0.0, 0.0], v_0=[0.0, -0.5], t_end=0.8, engine=engine, rtol=1e-10
    )
    assert len(run.t_contacts["wall"]) == 1
    w = math.sqrt(1.0 - 0.05**2)
    meets = brentq(lambda t: 0.5 * math.exp(-0.05 * t) * math.sin(w * t) / w - 0.2, 0.0, 1.0)
    assert run.t_contacts["wall"][0] == pytest.approx(meets, rel=1e-9)
    assert run.q_end[0] < -0.01


@pytest.mark.extended  # layouts of systems
@BOTH
@pytest.mark.parametrize(
    ("other", "along", "speed", "load"),
    [
        (gs.Piecewise(1.0, gs.Gap(None, 0.2), preload=1.0), [1.0, -1.0], -0.5, 0.3),
        (gs.Piecewise(1.0, gs.Gap(None, 0.2), damping=6.0), [1.0, -1.0], -0.5, 0.3),
        (gs.Rigid(gs.Gap(None, 0.2), restitution=0.4), [0.0, 1.0], 0.6, -0.1),
        (gs.Rigid(gs.Gap(None, 0.2), restitution=0.0), [0.0, 1.0], 0.6, -0.1),
    ],
)
def test_the_tangent_jumps_where_a_hold_ends_at_once(other, along, speed, load, engine):
    """The time of the end follows from the initial state of the second mass."""
    system = gs.System(
        mass=np.eye(2), stiffness=np.eye(2), damping=[[0.5, -0.4], [-0.4, 0.5]],
        contacts={"wall": [1.0, 0.0], "other": along},
        forcing=[gs.Harmonic(k=0, amplitude=[load, 0.0])],
    )  # fmt: skip
    laws = {"wall": rigid(0.0, 0.0), "other": other}

    def moved(q, v, **named):
        return gs.simulate(
            system, laws, q_0=[0.0, q], v_0=[0.0, v], t_end=1.2, engine=engine, rtol=1e-11, **named
        )

    run, step = moved(0.0, speed, tangent=True), 1e-3
    assert len(run.t_contacts["wall"]) == 1
    assert run.q_end[0] < -1e-3
    for column, shift in ((1, (step, 0.0)), (3, (0.0, step))):
        ends = [moved(k * shift[0], speed + k * shift[1]) for k in (-2, -1, 1, 2)]
        states = np.array([[*end.q_end, *end.v_end] for end in ends])
        expected = np.array([1.0, -8.0, 8.0, -1.0]) @ states / (12.0 * step)
        assert run.monodromy[:, column] == pytest.approx(expected, abs=1e-7)


@BOTH
def test_walls_in_one_place_with_a_preload_hold_a_mass_on_either_side(engine):
    """Between -N_0 and N_0 the load does not move it; beyond, it moves to either side."""
    law = gs.Piecewise(2.0, gs.Gap(0.0, 0.0), preload=0.5)
    still = gs.simulate(
        oscillator(0.4), law, 0.5 / TURN, n_periods=2, engine=engine, rtol=1e-9, tangent=True
    )
    assert (still.x_end, still.v_end, still.n_contacts) == (0.0, 0.0, 0)
    assert not still.monodromy.any()
    for sign in (1.0, -1.0):
        run = gs.simulate(
            pressed(0.0, forcing=0.7 * sign), {"wall": law}, 0.5 / TURN, t_end=1.0, engine=engine,
            rtol=1e-9,
        )  # fmt: skip
        # x'' + 0.05 x' + 3 x = 0.7 cos(0.5 t) - 0.5, from rest
        a, b = np.linalg.solve([[3.0 - 0.25, 0.025], [-0.025, 3.0 - 0.25]], [0.7, 0.0])
        w = math.sqrt(3.0 - 0.025**2)
        cosine = 0.5 / 3.0 - a
        sine = (0.025 * cosine - 0.5 * b) / w
        free = math.exp(-0.025) * (cosine * math.cos(w) + sine * math.sin(w))
        expected = a * math.cos(0.5) + b * math.sin(0.5) - 0.5 / 3.0 + free
        assert run.q_end[0] == pytest.approx(sign * expected, rel=1e-7)
        assert run.n_contacts == 0


@BOTH
@pytest.mark.parametrize("forcing", [0.0, 0.05])
def test_a_mass_pressed_on_any_wall_has_a_response(forcing, engine):
    """Held by a preload or a rigid wall, or at rest on a compressed spring."""
    o = gs.Oscillator(mass=1.0, omega_n=1.0 / TURN, zeta=0.05, forcing=forcing, mean_load=0.3)
    held = [clutch(0.5, 5.0, 0.1), gs.Rigid(gs.Gap(None, 0.1), restitution=0.5)]
    springs = [clutch(0.0, 5.0, 0.1), clutch(0.1, 5.0, 0.1), clutch(0.0, 5.0, 0.1, damping=0.3)]
    laws = springs + (held if engine == "compiled" else held[1:])  # bounces take minutes
    for law in laws:
        found = gs.respond(o, law, 0.2, engine=engine, rtol=1e-7)
        assert found.response_class is gs.ResponseClass.PERIODIC, found.message
        assert found.contact_share == 1.0
        if law in held:
            assert (found.x_max, found.x_min) == pytest.approx((0.1, 0.1), rel=1e-12)
            assert not found.multipliers.any()
        elif not forcing:
            place = (0.3 + 5.0 * 0.1 - law.preload) / 6.0
            assert (found.x_max, found.x_min) == pytest.approx((place, place), rel=1e-9)
        if law is held[0]:  # x = 0.1 all the time
            assert found.force_max == pytest.approx(0.2 + forcing, rel=1e-9)


@pytest.mark.parametrize("named", [{}, {"damping": 1.2}, {"damping": 1.2, "pulls": True}])
def test_a_response_at_a_preload_loses_what_the_forcing_supplies(named):
    o, w = oscillator(), 0.95
    found = gs.respond(o, clutch(0.01, **named), w / TURN, 0.1, 0.1, rtol=1e-12)
    run = gs.simulate(
        o, clutch(0.01, **named), w / TURN, found.x_end, found.v_end, n_periods=1, rtol=1e-12,
        dense_output=True,
    )  # fmt: skip
    nodes, weights = np.polynomial.legendre.leggauss(60)
    ends, balance = [0.0, *run.t_contacts, TURN / w], 0.0
    for a, b in itertools.pairwise(ends):
        t = a + 0.5 * (b - a) * (1.0 + nodes)
        v = run.sample(t)[1]
        balance += 0.5 * (b - a) * float(weights @ (0.03 * np.cos(w * t) * v - 0.05 * v * v))
    supplied = 0.03 * abs(found.x_max)
    assert energy_lost(run, 0) == pytest.approx(balance, abs=1e-9 * supplied)
    assert (energy_lost(run, 0) > 1e-3 * supplied) == bool(named)


def test_gradients_of_an_orbit_at_a_preload_are_those_of_differences():
    names = ["preload", "K_c", "forcing", "j_2"]
    nominal = dict(zip(names, (0.01, 20.0, 0.03, 0.1745), strict=True))
    w, start = 0.95, {"x_0": 0.1, "v_0": 0.1}
    found = gs.gradient(oscillator(), clutch(0.01), names, omega=w / TURN, **start)

    def extrema(**changed):
        of = nominal | changed
        law = clutch(of["preload"], of["K_c"], of["j_2"])
        one = gs.respond(oscillator(of["forcing"]), law, w / TURN, **start, rtol=1e-12)
        return np.array([one.x_max, one.x_min])

    for name, value in nominal.items():
        step = 1e-5 * value
        slope = (extrema(**{name: value + step}) - extrema(**{name: value - step})) / (2.0 * step)
        here = found["gradient"].sel(parameter=name, quantity=["x_max", "x_min"]).values
        assert here == pytest.approx(slope, rel=1e-6), name


def test_a_gradient_of_what_a_preload_holds_follows_the_wall():
    """The second coordinate is at (1 + place) / 2, plus the swing by the load."""
    k = np.array([[2.0, -1.0], [-1.0, 2.0]])
    machine = gs.System(
        mass=np.eye(2), stiffness=k, damping=0.1 * k, contacts={"stop": [1.0, 0.0]},
        forcing=[gs.Harmonic(k=0, amplitude=[1.0, 1.0]), gs.Harmonic(amplitude=[0.0, 0.3])],
    )  # fmt: skip
    law = clutch(2.0, 5.0, 0.2)
    found = gs.gradient(machine, {"stop": law}, ["j_2", "preload"], omega=0.2)["gradient"]
    second = [str(each) for each in found["quantity"].values if str(each).startswith("x_max")][1]
    assert found.sel(quantity=second).values == pytest.approx([0.5, 0.0], rel=1e-9, abs=1e-12)


@BOTH
def test_a_hold_of_a_place_that_rounding_separates_from_its_wall_ends_once(engine):
    """The coordinate is held a rounding error beyond the wall, which its gap keeps."""
    machine = gs.System(
        mass=[[1.8, 0.0], [0.0, 0.83]], damping=[[0.16, -0.08], [-0.08, 0.2]],
        stiffness=[[2.8, -1.73], [-1.73, 4.11]], contacts={"wall": [0.0, 1.0]},
        forcing=[gs.Harmonic(amplitude=[0.48, 0.0])],
    )  # fmt: skip
    for law in (rigid(0.3, 0.05), clutch(5.0, 20.0, 0.05)):
        run = gs.simulate(
            machine, {"wall": law}, 0.11, q_0=[0.2, math.nextafter(0.05, 1.0)], v_0=[-0.1, 0.0],
            t_end=4.0, engine=engine, rtol=1e-9,
        )  # fmt: skip
        assert run.n_contacts == 1
        assert run.t_contacts["wall"] == pytest.approx([1.08269882], rel=1e-6)


@pytest.mark.parametrize("kind", ["damping", "chi"])
def test_a_branch_along_a_loss_that_reaches_zero_ends_at_the_elastic_orbit(kind):
    def law(value):
        if kind == "chi":
            return gs.HuntCrossley(2.0, gs.Gap(1.0, 1.0), chi=value)
        return gs.Piecewise(2.0, gs.Gap(1.0, 1.0), damping=value)

    model, omega = oscillator(forcing=1.0), 1.2 / TURN
    branch = gs.branches(model, law(0.2), kind, (0.0, 0.3), omega=omega).isel(branch=0)
    at_zero = branch["x_max"].values[branch[kind].values == 0.0]
    elastic = gs.respond(model, gs.Piecewise(2.0, gs.Gap(1.0, 1.0)), omega, rtol=1e-11)
    assert elastic.contact_share > 0.0
    assert at_zero.size
    assert at_zero == pytest.approx(elastic.x_max, rel=1e-7)


def drawn_holds(kind, seed):
    """A drawn system with walls that hold, for the oracle and gapsweep, and its initial state.

    Between 2 rigid walls it moves at first; on 2 or 3 walls with a preload it is at rest.
    """
    rng = np.random.default_rng([("rigid", "preload").index(kind), seed])
    n_walls = 2 if kind == "rigid" else int(rng.integers(2, 4))
    n = int(rng.integers(n_walls, 4))
    k, one = rng.uniform(0.3, 3.0, n + 1), np.eye(n)
    mass = np.diag(rng.uniform(0.5, 2.0, n)) + 0.1 * (rng.random() < 0.4)
    stiffness = np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
    damping = rng.uniform(0.02, 0.15) * stiffness + 0.02 * one
    directions = np.concatenate([one, one[:-1] - one[1:], one[1:] - one[:-1]])
    b = np.zeros((n_walls, n))
    while np.linalg.matrix_rank(b) < n_walls:
        b = directions[rng.choice(len(directions), n_walls, replace=False)]
    q, v = np.round(rng.uniform(-0.2, 0.0, n), 2), np.zeros(n)
    push = rng.uniform(-1.0, 1.0, n) * rng.uniform(0.2, 0.8)
    load, walls, laws = np.zeros(n), [], []
    if kind == "preload":
        load, damped = stiffness @ q - push, rng.random() < 0.5
    else:
        v = rng.uniform(-0.3, 0.3, n)
    for row in b:
        if kind == "rigid":
            place, e = float(row @ q + rng.uniform(0.01, 0.2)), float(rng.uniform(0.0, 0.8))
            e *= rng.random() < 0.7
            walls.append(Wall(row, place, 0.0, e=e))
            laws.append(gs.Rigid(gs.Gap(None, place), restitution=e))
            load += row * rng.uniform(0.2, 1.0)
        else:
            most, spring = float(rng.uniform(0.1, 1.0)), float(10.0 ** rng.uniform(0.0, 2.0))
            c = float(damped * rng.uniform(0.05, 2.0))
            walls.append(Wall(row, float(row @ q), spring, c, preload=most))
            named = {"damping": c, "pulls": True} if damped else {}
            laws.append(gs.Piecewise(spring, gs.Gap(None, float(row @ q)), preload=most, **named))
            load += row * rng.uniform(-0.1, 1.1) * most
    omega, names = float(rng.uniform(0.3, 1.5)), [str(i) for i in range(n_walls)]
    oracle = Held(mass, damping, stiffness, load, push, omega, walls)
    system = gs.System(
        mass=mass, damping=damping, stiffness=stiffness, contacts=dict(zip(names, b, strict=True)),
        forcing=[gs.Harmonic(k=0, amplitude=load), gs.Harmonic(amplitude=push)],
    )  # fmt: skip
    return oracle, system, dict(zip(names, laws, strict=True)), q, v


@pytest.mark.extended  # layouts of systems
@BOTH
@pytest.mark.parametrize("kind", ["rigid", "preload"])
def test_walls_that_hold_together_do_so_as_a_search_of_all_modes_says(kind, engine):
    """Motions, and contacts that begin or end at the initial state: none where a body stays."""
    rtol, error = (1e-11, 1e-9) if engine == "compiled" else (1e-9, 1e-7)
    for seed in range(10):
        oracle, system, laws, q, v = drawn_holds(kind, seed)
        t_end = min(TURN / oracle.omega, 10.0 if kind == "rigid" else 4.0)
        run = gs.simulate(
            system, laws, oracle.omega / TURN, q_0=q, v_0=v, t_end=t_end, engine=engine, rtol=rtol,
            dense_output=True,
        )  # fmt: skip
        expected = oracle.run(q, v, t_end)
        assert run.status is gs.Status.OK
        assert np.append(run.q_end, run.v_end) == pytest.approx(expected.y, abs=error)
        places = run.sample(np.array([part[0] for part in expected.parts]))[0]
        starts = np.array([part[2][0][: system.n] for part in expected.parts], float)
        assert places == pytest.approx(starts, abs=error)
        if kind == "preload":
            times = np.concatenate([run.t_contacts[name] for name in laws])
            assert (times > 1e-3).all()


@pytest.mark.extended  # layouts of systems
@BOTH
def test_two_walls_at_the_origin_stop_masses_that_move_into_both(engine):
    """The impacts at one time have no largest displacement that speeds could be compared with."""
    system = gs.System(
        mass=np.eye(2), stiffness=np.eye(2), damping=0.1 * np.eye(2),
        contacts={"wall": [0.0, 1.0], "between": [1.0, -1.0]},
        forcing=[gs.Harmonic(k=0, amplitude=[1.0, 0.5])],
    )  # fmt: skip
    laws = {name: gs.Rigid(gs.Gap(None, 0.0), restitution=0.0) for name in system.contacts}
    run = gs.simulate(system, laws, q_0=[0.0, 0.0], v_0=[0.3, 0.2], t_end=2.0, engine=engine)
    assert run.status is gs.Status.OK
    assert np.append(run.q_end, run.v_end) == pytest.approx(np.zeros(4), abs=1e-12)


def test_impacts_of_two_plastic_walls_at_one_time_end_with_a_finite_tangent():
    """The masses push each other into their walls, at speeds that fall in a geometric series."""
    system = gs.System(
        mass=[[1.0, 0.05], [0.05, 1.0]], stiffness=np.eye(2), damping=0.1 * np.eye(2),
        contacts={"first": [1.0, 0.0], "second": [0.0, 1.0]},
        forcing=[gs.Harmonic(k=0, amplitude=[0.3, 0.0])],
    )  # fmt: skip
    laws = {"first": rigid(0.0, 0.0), "second": rigid(0.0, 0.2)}
    run = gs.simulate(
        system, laws, q_0=[0.0, 0.0], v_0=[0.0, 0.6], t_end=1.0, engine="scipy", tangent=True
    )
    assert run.status is gs.Status.OK
    assert len(run.t_contacts["second"]) > 0
    assert np.isfinite(run.monodromy).all()


@pytest.mark.parametrize("engine", ["scipy", pytest.param("compiled", marks=pytest.mark.extended)])
def test_two_preloads_in_one_place_that_would_hold_a_mass_are_no_model(engine):
    """Only the sum of their forces follows from the motion."""
    system = gs.System(
        mass=[[1.0]], stiffness=[[1.0]], damping=[[0.4]], contacts={"a": [1.0], "b": [1.0]},
        forcing=[gs.Harmonic(k=0, amplitude=[0.5])],
    )  # fmt: skip
    laws = {name: clutch(1.0, 5.0, 0.1) for name in system.contacts}
    run = gs.simulate(system, laws, q_0=[0.0], v_0=[0.1], t_end=60.0, engine=engine, rtol=1e-4)
    assert run.status is gs.Status.MODEL_INVALID


def test_a_hold_of_a_wall_that_never_pulls_takes_no_short_steps():
    law = clutch(0.4, 5.0, 0.0, damping=2.0)
    run = gs.simulate(pressed(0.1, forcing=0.05), {"wall": law}, 0.2, n_periods=4)
    assert (run.q_end[0], run.n_contacts) == (0.0, 0)
    assert run.n_steps < 200
