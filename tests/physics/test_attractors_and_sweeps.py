"""Steady responses: known coexisting attractors, invariants, chaos, sweeps, grouping."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from tests.builders.attractors import attractors_of_scenes
from tests.builders.cache import sweep_tiles, tile_rows
from tests.builders.datasets import tables
from tests.oracles import exact_orbits
from tests.oracles.section_points import orbit_distance, parts

import gapsweep as gs
from gapsweep.execution.task import Task, compute, process
from gapsweep.integrate.problem import Models, Solver
from gapsweep.response import ensemble, thresholds
from gapsweep.response.autonomous import PoincareMap
from gapsweep.response.compiled import contracting_multiples, largest_parts
from gapsweep.response.ensemble import Ensemble
from gapsweep.response.respond import respond_all
from gapsweep.response.result import Responses
from gapsweep.response.scene import Scene
from gapsweep.response.section import (
    cloud_distances,
    period_multiple,
    period_multiples,
    prime_multiple,
    unit_of,
)
from gapsweep.status import Status
from gapsweep.store.slab import stored

SYMMETRIC, ASYMMETRIC = gs.Gap(0.4e-3, 0.4e-3), gs.Gap(0.0, 0.8e-3)
SOFT, HARD = 1.4e4, 1.4e6


def box(K_c, gap, omega, n=9):
    """Attractors from n x n starts in |x| <= 1 mm, |v| <= 0.05 m/s."""
    x, v = np.linspace(-1e-3, 1e-3, n), np.linspace(-0.05, 0.05, n)
    return gs.basins(gs.systems.paper_oscillator(), gs.Piecewise(K_c, gap), omega, x=x, v=v)


@pytest.mark.parametrize(
    ("K_c", "gap", "omega", "known"),
    [
        # Peaks in mm and period multiples, from fixed-step methods at several step sizes.
        (HARD, ASYMMETRIC, 11.0, [(0.8257, 1), (0.8326, 3), (0.8605, 2), (0.8634, 3)]),
        (HARD, SYMMETRIC, 16.0, [(0.146, 1), (0.45, 1)]),
        (SOFT, SYMMETRIC, 19.0, [(0.1005, 1), (0.50, 3)]),
        (HARD, ASYMMETRIC, 21.75, [(0.4229, 2), (0.8632, 1)]),
    ],
)
def test_known_coexisting_attractors_are_found(K_c, gap, omega, known):
    found = box(K_c, gap, omega)
    pairs = zip(found["x_max"].values * 1e3, found["period_multiple"].values, strict=True)
    for (peak, n), (known_peak, known_n) in zip(pairs, known, strict=True):
        digits = len(str(known_peak).split(".")[1])
        assert round(peak, digits) == known_peak
        assert n == known_n
    assert (found["multiplier_abs"] < 1).all()
    assert_allclose(found["basin_share"].sum(), 1.0)


TURN = 2.0 * math.pi
BISTABLE = gs.Oscillator(mass=1.0, omega_n=0.5 / math.pi, zeta=0.025, forcing=0.03)
BISTABLE_LAW = gs.Piecewise(2.0, gs.Gap(0.1745, 0.1745))


def settled_peaks(oscillator, law, omega, states, n_periods):
    """Largest displacements in the last two periods, by the classical Runge-Kutta method."""
    n_rad, rate, h = TURN * oscillator.omega_n, TURN * omega, 1.0 / (192.0 * omega)
    peak, (x, v) = np.full(len(states), -np.inf), np.array(states).T

    def slopes(t, x, v):
        wall = np.maximum(x - law.gap.j_2, 0.0) + law.K_ratio * np.minimum(x + law.gap.j_1, 0.0)
        spring = n_rad**2 * x + law.K_c / oscillator.mass * wall
        load = oscillator.forcing / oscillator.mass * math.cos(rate * t)
        return v, load - 2.0 * oscillator.zeta * n_rad * v - spring

    for k in range(192 * n_periods):
        t = k * h
        a = slopes(t, x, v)
        b = slopes(t + h / 2, x + h / 2 * a[0], v + h / 2 * a[1])
        c = slopes(t + h / 2, x + h / 2 * b[0], v + h / 2 * b[1])
        d = slopes(t + h, x + h * c[0], v + h * c[1])
        x = x + h / 6 * (a[0] + 2 * b[0] + 2 * c[0] + d[0])
        v = v + h / 6 * (a[1] + 2 * b[1] + 2 * c[1] + d[1])
        if k >= 192 * (n_periods - 2):
            peak = np.maximum(peak, x)
    return peak


def left(found, number, oscillator, law, omega, shares, n_periods):
    """Whether states leave an attractor; `shares` of its smallest disturbance, in scaled states."""
    of = found.isel(attractor_number=number)
    unit = np.array([1.0, TURN * omega])
    base = np.array([of["disturbed_x"], of["disturbed_v"]])
    states = base + of["disturbance"].item() * np.asarray(shares) * unit
    peaks = settled_peaks(oscillator, law, omega, states, n_periods)
    nearest = np.abs(np.log(peaks[:, None] / found["x_max"].values)).argmin(axis=1)
    return nearest != number


def test_the_smallest_disturbance_leaves_and_no_smaller_one_does():
    omega, axis = 1.3 / (2.0 * math.pi), np.linspace(-1.0, 1.0, 5)
    found = gs.basins(BISTABLE, BISTABLE_LAW, omega, x=axis, v=axis, rays=16)
    # The lower attractor and its kick, bisected by exact flows between the walls.
    assert_allclose(found["disturbed_x"][0], -0.04309582053817726, rtol=1e-9)
    assert_allclose(found["single_up_v"][0], 0.2862056641, rtol=2e-10)
    change = np.array([found["disturbance_x"], found["disturbance_v"] / 1.3])
    assert_allclose(found["disturbance"], np.hypot(*change), rtol=1e-12)
    direction = (change / found["disturbance"].values).T
    angles = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    rings = np.concatenate([share * circle for share in (0.25, 0.5, 0.75, 0.9, 0.99)])
    for number in (0, 1):
        turned = np.arctan2(*direction[number, ::-1]) + np.linspace(-0.2, 0.2, 61)
        near = 0.9997 * np.column_stack([np.cos(turned), np.sin(turned)])
        shares = np.concatenate([np.outer([1.0003, 0.9997], direction[number]), rings, near])
        leaves = left(found, number, BISTABLE, BISTABLE_LAW, omega, shares, 60)
        assert leaves[0]
        assert not leaves[1:].any()


def test_a_disturbance_after_which_the_motion_diverges_has_left():
    """A softening spring pulls back at rest up to x = 1, where k x = -alpha x^3."""
    softening = gs.Oscillator(mass=1.0, omega_n=0.5 / math.pi, zeta=0.1, alpha=-1.0, forcing=0.0)
    law, axis = gs.Piecewise(0.0, gs.Gap(10.0, 10.0)), np.linspace(-2.0, 2.0, 3)
    found = gs.basins(softening, law, 0.2, x=axis, v=axis, rays=8)
    assert_allclose(found["single_up_x"], 1.0, rtol=1e-9)
    assert_allclose(found["single_down_x"], -1.0, rtol=1e-9)
    assert found["disturbance"].item() < 1.0


def bistable_scenes(n):
    """Random oscillators with two attractors of the forcing period, in a grid of initial states."""
    rng = np.random.default_rng(11)
    while n:
        forcing, K_c = 10.0 ** rng.uniform(-2.0, -0.8), 10.0 ** rng.uniform(-0.3, 1.5)
        zeta, rate, lower = rng.uniform([0.02, 0.8, 0.6], [0.06, 2.2, 1.4])
        model = gs.Oscillator(mass=1.0, omega_n=0.5 / math.pi, zeta=zeta, forcing=forcing)
        law = gs.Piecewise(K_c, gs.Gap(0.1745 * lower, 0.1745), K_ratio=rng.choice([1.0, 2.0]))
        omega, axis = rate / (2.0 * math.pi), np.linspace(-1.0, 1.0, 9)
        starts = {"x": axis, "v": rate * axis}
        found = gs.basins(model, law, omega, **starts)
        if (
            found["period_multiple"].values.tolist() == [1, 1]
            and np.ptp(np.log(found["x_max"].values)) > 0.2
        ):
            n -= 1
            yield model, law, omega, gs.basins(model, law, omega, **starts, rays=32)


@pytest.mark.slow
def test_no_state_of_a_grid_needs_a_smaller_disturbance():
    axis = np.linspace(-1.0, 1.0, 41)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    grid = grid[np.hypot(*grid.T) < 1.0 - 0.5 * (axis[1] - axis[0])]
    for model, law, omega, found in bistable_scenes(50):
        n_periods = math.ceil(2.0 * omega / (model.zeta * model.omega_n))
        for number in (0, 1):
            leaves = left(found, number, model, law, omega, grid, n_periods)
            assert not leaves.any(), (model, law, omega)
            # Fixed steps are too inaccurate to tell which side of a boundary these states are on.
            of = found.isel(attractor_number=number)
            share = np.array([1.0, 0.999])
            x, v = (
                of[f"disturbed_{n}"].item() + share * of[f"disturbance_{n}"].item() for n in "xv"
            )
            peaks = gs.respond(model, law, omega, x, v).x_max
            assert_array_equal(np.isclose(peaks, of["x_max"], rtol=1e-6), [False, True])


def test_basins_are_drawn_with_a_name_for_every_attractor():
    found = box(SOFT, SYMMETRIC, 19.0, n=5)
    axes = found.gapsweep.attractors()
    shades = axes.images[0].get_array().reshape(-1, 4)
    patches = axes.get_legend().get_patches()
    of = {tuple(round(255 * c) for c in patch.get_facecolor()): patch for patch in patches}
    names = [of[tuple(shade)].get_label().split(",")[0] for shade in shades.tolist()]
    assert names == [["P1", "P3"][i] for i in found["attractor"].values.ravel()]


def test_chaos_has_a_positive_exponent():
    law = gs.Piecewise(SOFT, ASYMMETRIC)
    response = gs.respond(gs.systems.paper_oscillator(), law, 14.0)
    assert response.response_class is gs.ResponseClass.CHAOTIC
    assert response.status is gs.Status.OK
    assert response.lyapunov > 3 * response.lyapunov_error > 0
    assert math.isnan(response.multiplier_abs)


def test_exponents_of_the_tangent_and_of_neighbouring_motions_agree():
    # Two motions 1e-9 m apart separate like exp(lambda t) while they are close.
    law, omega = gs.Piecewise(SOFT, ASYMMETRIC), 14.0
    response = gs.respond(gs.systems.paper_oscillator(), law, omega)
    x, v = np.reshape(response.section, (-1, 2)).T
    t = math.ceil(1.0 * omega) / omega
    near, far = (
        gs.simulate(
            gs.systems.paper_oscillator(), law, omega, x + d, v, t_end=t, rtol=1e-12, atol=1e-15
        )
        for d in (0.0, 1e-9)
    )
    separation = np.hypot(far.x_end - near.x_end, (far.v_end - near.v_end) / (2 * math.pi * omega))
    growth = np.log(separation / 1e-9) / t
    spread = growth.std() / math.sqrt(len(growth))
    assert abs(growth.mean() - response.lyapunov) < 5 * (spread + response.lyapunov_error)


def grouped(responses, omega, *, symmetric):
    one = np.zeros(len(responses), int)
    return attractors_of_scenes(
        Responses.of(responses), one, unit=unit_of(omega), symmetric=symmetric
    )


def test_mirror_twins_are_named():
    found = box(HARD, SYMMETRIC, 3.0, n=6)
    periodic = found["period_multiple"].values == 1
    assert_allclose(found["x_max"][periodic], -found["x_min"][periodic][::-1], rtol=1e-6)
    law = gs.Piecewise(HARD, SYMMETRIC)
    pair = [
        gs.respond(gs.systems.paper_oscillator(), law, 3.0, x)
        for x in (0.0, 1e-4, 2e-4, -1e-4, -3e-4)
    ]
    groups = grouped(pair, 3.0, symmetric=True)
    twins = np.array([pair[i].period_multiple for i in groups.first]) == 1
    assert groups.mirror_of[twins].tolist() == [1, 0]


def test_symmetric_orbit_is_its_own_mirror_image():
    response = gs.respond(gs.systems.paper_oscillator(), gs.Piecewise(SOFT, SYMMETRIC), 9.0)
    only = grouped([response], 9.0, symmetric=True)
    assert only.mirror_of.tolist() == [0]
    assert only.basin_share.tolist() == [1.0]


def test_start_order_does_not_change_the_attractors():
    law = gs.Piecewise(HARD, ASYMMETRIC)
    starts = np.linspace(-1e-3, 1e-3, 12)
    found = [gs.respond(gs.systems.paper_oscillator(), law, 11.0, float(x)) for x in starts]
    ids = grouped(found, 11.0, symmetric=False).numbers.tolist()
    backwards = grouped(found[::-1], 11.0, symmetric=False).numbers.tolist()
    assert backwards[::-1] == ids
    assert set(ids) == set(range(max(ids) + 1))


def test_shooting_never_swaps_the_attractor_of_a_start():
    # Where no transient chaos lets rounding choose the basin, brute force must agree.
    law, omega = gs.Piecewise(SOFT, SYMMETRIC), 19.0
    x, v = (a.ravel() for a in np.meshgrid(np.linspace(-1e-3, 1e-3, 7), [-0.03, 0.0, 0.04]))
    settled = gs.simulate(gs.systems.paper_oscillator(), law, omega, x, v, t_end=60.0)
    window = gs.simulate(
        gs.systems.paper_oscillator(), law, omega, settled.x_end, settled.v_end, t_end=6 / omega
    )
    for i in range(len(x)):
        response = gs.respond(gs.systems.paper_oscillator(), law, omega, x[i], v[i])
        assert_allclose(response.x_max, window.extrema[i].max(), atol=1e-8)
        assert response.t_simulated < (24.4 + 64 / omega) / 2


def test_extremum_kinds_alternate():
    response = gs.respond(gs.systems.paper_oscillator(), gs.Piecewise(SOFT, SYMMETRIC), 1.0)
    kinds = np.array(response.extremum_kind)
    assert len(kinds) == response.n_extrema == 18
    assert np.all(kinds[1:] == -kinds[:-1])
    assert response.extrema[int(np.argmax(response.extrema))] == response.x_max
    assert kinds[np.argmax(response.extrema)] == 1


def test_upward_sweep_rides_the_upper_branch_beyond_the_fitted_range():
    whole = tables(["piecewise", "ratpoly-5/3", "poly-13"], np.arange(9.0, 19.1, 0.25))
    whole["sweep"][0] |= {"K_c": [SOFT], "initial_condition": "sweep_up"}
    study = gs.Study.from_dict(whole)
    exact, rational, polynomial = (tile_rows(study, r) for r in range(3))
    peak = {w: 1e3 * r.x_max for w, r in zip(study.grid.omega, exact, strict=True)}
    assert 3.8 < peak[14.0] < 4.2
    assert max(peak.values()) == pytest.approx(6.3, abs=0.15)
    assert 17.0 <= max(peak, key=peak.get) <= 18.0
    left = [r for r in rational if abs(r.x_max) > 4e-3]
    assert len(left) > 10, "the rational fit follows beyond its range, and keeps its values"
    assert all(r.status is gs.Status.OUT_OF_FIT_RANGE for r in left)
    ran_away = [r for r in polynomial if math.isnan(r.x_max)]
    assert ran_away, "the polynomial falls off its range"
    assert all(r.status is gs.Status.OUT_OF_FIT_RANGE and r.message for r in ran_away)


def test_sweeps_in_both_directions_are_the_same_together_and_one_by_one():
    """A fit of walls that overlap is refused, in rows before those of another gap."""
    whole = tables(["poly-5"], np.linspace(5.0, 20.0, 7))
    both = {"initial_condition": ["sweep_up", "sweep_down"]}
    whole["sweep"][0] |= {"K_c": [SOFT], "gap": [[-3e-4, 1e-4], [4e-4, 4e-4]]} | both
    tiles = sweep_tiles(gs.Study.from_dict(whole))
    assert [tile.points.kind.start for tile in tiles] == ["sweep_up", "sweep_down"]
    together = compute(Task(tiles, 600.0, process())).slabs
    apart = [slab for one in tiles for slab in compute(Task([one], 600.0, process())).slabs]
    assert [one.identity for one in together] == [one.identity for one in apart]
    for one, other in zip(map(stored, together), map(stored, apart), strict=True):
        assert_array_equal(one.previous, other.previous)
        left, right = one.responses, other.responses
        assert left.messages == right.messages
        assert {*left.columns["status"].tolist()} == {Status.OK, Status.MODEL_INVALID}
        for name in left.columns.keys() - {"cpu_time"}:
            assert_array_equal(left.columns[name], right.columns[name], err_msg=name)
        for name, (values, counts) in left.lists.items():
            assert_array_equal(values, right.lists[name][0], err_msg=name)
            assert_array_equal(counts, right.lists[name][1], err_msg=name)


def test_loose_tolerances_still_find_the_period():
    response = gs.respond(
        gs.systems.paper_oscillator(),
        gs.Piecewise(SOFT, SYMMETRIC),
        9.0,
        engine="scipy",
        rtol=1e-4,
        atol=1e-7,
    )
    assert response.period_multiple == 1
    assert response.multiplier_abs == pytest.approx(0.9006, abs=0.02)


part = st.floats(-1, 1)
orbits = st.lists(st.builds(complex, part, part), min_size=1, max_size=6)


@given(orbits, st.integers(0, 5))
def test_orbit_distance_ignores_where_the_orbit_starts(points, shift):
    orbit = np.array(points)
    assert orbit_distance(orbit, np.roll(orbit, shift)) == 0.0
    other = orbit + 0.5
    assert orbit_distance(orbit, other) == pytest.approx(orbit_distance(other, orbit))


def test_orbits_of_different_period_are_infinitely_apart():
    assert orbit_distance(np.zeros(1, complex), np.zeros(2, complex)) == math.inf


@given(orbits, st.integers(1, 4))
def test_prime_multiple_undoes_repetition(orbit, times):
    prime = prime_multiple(parts(orbit), 1e-12)
    assert len(orbit) % prime == 0
    assert prime_multiple(parts(orbit * times), 1e-12) == prime


def test_stretches_cut_anywhere_lead_to_the_same_orbits(monkeypatch):
    law, omega = gs.Piecewise(SOFT, SYMMETRIC), np.linspace(5.0, 30.0, 40)
    whole = gs.respond(gs.systems.paper_oscillator(), law, omega)
    monkeypatch.setattr(ensemble, "STEPS_AT_A_TIME", 37.0)
    cut = gs.respond(gs.systems.paper_oscillator(), law, omega)
    assert (whole.response_class == gs.ResponseClass.PERIODIC).all()
    assert np.array_equal(cut.period_multiple, whole.period_multiple)
    assert np.allclose(cut.amplitude, whole.amplitude, rtol=1e-7)
    assert (cut.t_simulated == whole.t_simulated).mean() > 0.9  # as many periods, in more calls


def test_a_window_is_the_same_in_its_pauses_call_and_in_its_own(monkeypatch):
    omega = np.linspace(5.0, 30.0, 40)
    monkeypatch.setattr(ensemble, "STEPS_AT_A_TIME", np.inf)
    for law in (gs.Piecewise(HARD, SYMMETRIC), gs.contact_law("tanh-1e4", SOFT, SYMMETRIC)):
        together = gs.respond(gs.systems.paper_oscillator(), law, omega)
        with monkeypatch.context() as patched:
            patched.setattr(Ensemble, "is_chained", False)
            apart = gs.respond(gs.systems.paper_oscillator(), law, omega)
        assert len(set(together.response_class.tolist())) > 1 or law.K_c == SOFT
        for name in ("response_class", "x_max", "x_min", "lyapunov", "t_simulated", "n_steps"):
            assert_array_equal(getattr(together, name), getattr(apart, name), err_msg=name)


def test_what_fails_in_a_pause_is_left_where_it_failed():
    """It softens: once out of its well it is pulled away for ever, as brute force sees too."""
    oscillator = gs.systems.paper_oscillator(alpha=-1e9, forcing=60.0)
    law = gs.Piecewise(1.0, gs.Gap(1e-3, 1e-3))
    found = gs.respond(oscillator, law, 9.0)
    run = gs.simulate(oscillator, law, 9.0, t_end=10.0)
    assert found.status == run.status == Status.DIVERGED
    assert found.n_steps == run.n_steps
    assert found.t_simulated == pytest.approx(run.t_end, rel=1e-12)
    said = float(found.message.split("t = ")[1].split(" s")[0])
    assert run.t_end <= said < run.t_end + 1.0 / 9.0


def test_shots_that_are_given_up_miss_no_attractor(monkeypatch):
    law, omega = gs.Piecewise(HARD, SYMMETRIC), np.linspace(12.0, 30.0, 60)
    found = gs.respond(gs.systems.paper_oscillator(), law, omega)
    monkeypatch.setattr(thresholds, "STRETCHED", np.inf)
    patient = gs.respond(gs.systems.paper_oscillator(), law, omega)
    assert np.array_equal(found.response_class, patient.response_class)
    assert np.array_equal(found.period_multiple, patient.period_multiple)
    assert (found.t_simulated <= patient.t_simulated).all()


def test_chaos_that_grows_much_faster_than_it_decays_has_an_exponent():
    """In blocks three times as long its tangents overflow."""
    oscillator = gs.Oscillator(zeta=0.006, omega_n=1.0, mass=0.75, alpha=0.0, forcing=14.4)
    law = gs.Piecewise(4.2e5, gs.Gap(1e-3, 3e-4))
    # At 2.8 Hz there is also an orbit of three periods, which chaos may end on.
    omega = 2.9
    found = gs.respond(oscillator, law, [omega, 3.0])
    assert (found.response_class == gs.ResponseClass.CHAOTIC).all()
    # One period after the other.
    state, vector, grown, n = (found.x_end[0], found.v_end[0]), np.array([1.0, 0.0]), 0.0, 500
    for _ in range(n):
        run = gs.simulate(oscillator, law, omega, *state, t_end=1.0 / omega, tangent=True)
        state, vector = (run.x_end, run.v_end), run.monodromy @ vector
        grown += math.log(np.linalg.norm(vector))
        vector /= np.linalg.norm(vector)
    assert abs(found.lyapunov[0] - grown * omega / n) < 0.2 * found.lyapunov[0]


def test_slow_motions_against_hard_smooth_walls_are_resolved():
    """Their tangents lost area to steps that suited the motion alone: no exponent was believed."""
    law = gs.contact_law("tanh-1e4", HARD, SYMMETRIC)
    found = gs.respond(
        gs.systems.paper_oscillator(), law, [0.144, 0.539, 0.583], rtol=1e-6, atol=1e-9
    )
    assert (found.response_class == gs.ResponseClass.PERIODIC).all()


@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(1, 5))
def test_the_largest_part_of_an_orbit_that_repeats_is_found(seed, n, m):
    rng = np.random.default_rng(seed)
    orbits, tolerance = rng.integers(0, 2, (2, m, n)).astype(float), rng.uniform(0.0, 1.5, m)
    longer = np.concatenate([orbits, np.ones((2, m, 2))], axis=2)
    found = largest_parts(longer, np.full(m, n), np.arange(m), tolerance)
    for k in range(m):
        shifts = [
            d
            for d in range(1, n)
            if n % d == 0
            and all(
                abs(orbits[i, k, j] - orbits[i, k, (j + d) % n]) < tolerance[k]
                for i in range(2)
                for j in range(n)
            )
        ]
        assert found[k] == max(shifts, default=n)


@pytest.mark.parametrize(
    ("oscillator", "law", "start", "n"),
    [
        (
            gs.systems.paper_oscillator(zeta=0.0324757787, forcing=1.0743388471),
            gs.Piecewise(346056.631, gs.Gap(0.8e-3, 0.4e-3)),
            (2.937153972, -0.9033185e-3, 0.0398937337),
            6,
        ),
        (
            gs.systems.paper_oscillator(zeta=0.02562759605523195, forcing=1.4188107019261256),
            gs.Piecewise(131990.88593246252, gs.Gap(0.1e-3, 0.8e-3), K_ratio=0.3),
            (13.038500087867213, -0.38790339811836097e-3, 0.018984965468696725),
            12,
        ),
    ],
)
def test_a_doubled_period_is_found_from_every_start(oscillator, law, start, n):
    """Its halves are so near to each other that shooting at half the period is tried, in vain."""
    omega, x_0, v_0 = start
    moved = x_0 * (1.0 + 1e-6 * np.random.default_rng(0).uniform(-1.0, 1.0, 12))
    found = gs.respond(oscillator, law, omega, moved, v_0)
    assert (found.period_multiple == n).all()


def test_contraction_is_told_from_drift_and_growth():
    def multiple(section, closeness, largest, same=0.0):
        # Beside a longer section, and with room behind it that holds nothing.
        sections = np.full((2, len(section) + 9), 1e9 + 0j)
        sections[0, : len(section)] = section
        lengths, both = np.array([len(section), len(section) + 9]), np.ones(2)
        given = parts(sections), lengths, np.arange(2), closeness * both, same * both
        return contracting_multiples(*given, largest).tolist()[0]

    k = np.arange(12.0)
    towards = 0.8**k + 0j
    assert multiple(towards, 1.0, 4) == 1
    assert multiple(towards, 1e-3, 4) == 0, "still too far apart"
    assert multiple(towards[:4], 1.0, 4) == 0, "n + 4 points are needed"
    away = 1e-3 * 1.2**k + 0j
    assert multiple(away, 1.0, 1) == 0
    inbound = np.append([1.0, -0.6, 0.5], 1e-3 * 1.15**k)
    assert multiple(inbound, 0.1, 1) == 0, "has been there, and is leaving"
    assert multiple(np.append(towards, towards[-5:]), 1.0, 1) == 1, (
        "rattled, but nearer than it was"
    )
    alternating = 1j * (-1.0) ** k * (1 + 0.1 * 0.8**k)
    assert multiple(alternating, 0.5, 4) == 2
    assert multiple(alternating, 0.5, 1) == 0, "larger than asked for"
    settled = 1e-9 * np.append([0.0, 1.0, 0.0, 1.0, 1.0, 0.0], [0.0, 2.0]) + 0j
    assert multiple(settled, 0.5, 1) == 0, "the last step is the longest"
    assert multiple(settled, 0.5, 1, same=3e-9) == 1, "all steps are noise"


@given(st.lists(orbits, min_size=1, max_size=4), st.floats(1e-9, 1.0), st.integers(1, 5))
def test_many_sections_repeat_as_each_does(given, tolerance, times):
    sections = [np.array(orbit * times) for orbit in given]
    lengths = np.array([len(section) for section in sections])
    table = np.full((len(sections), lengths.max()), complex(math.nan, math.nan))
    for row, section in zip(table, sections, strict=True):
        row[: len(section)] = section
    some = np.arange(len(sections))[::-1]
    found = period_multiples(parts(table), lengths, some, np.full(len(some), tolerance), 8)
    alone = [period_multiple(parts(sections[i]), tolerance, 8) for i in some]
    assert found.tolist() == alone


def test_one_outlier_does_not_separate_two_clouds():
    rng = np.random.default_rng(3)
    cloud = rng.normal(size=40) + 1j * rng.normal(size=40)
    other = np.append(cloud[1:], 100.0)
    cloud, other, away = (parts(each[None]) for each in (cloud, other, cloud + 100.0))
    assert cloud_distances(cloud, other)[0] < 1.0
    assert cloud_distances(cloud, away)[0] > 90.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"x": []}, r"x = \[\]: must be finite numbers and not empty"),
        ({"v": [math.nan]}, r"v = \[nan\]: must be finite numbers"),
        ({"omega": 0.0}, "omega = 0: must be > 0"),
        ({"omega": None}, "omega: missing"),
        ({"x": np.zeros(2000), "v": np.zeros(2000)}, "2000 x 2000 .*: must be <= 1000000"),
    ],
)
def test_bad_grids_of_starts_are_refused(arguments, message):
    given = {"omega": 9.0, "x": [0.0], "v": [0.0]} | arguments
    with pytest.raises(gs.ModelError, match=message):
        gs.basins(gs.systems.paper_oscillator(), gs.Piecewise(SOFT, SYMMETRIC), **given)


@pytest.mark.extended
@pytest.mark.parametrize("omega", [9.0, 0.0])
@pytest.mark.parametrize("label", ["piecewise", "piecewise-noevents", "tanh-1e4"])
def test_shots_are_no_part_of_what_a_motion_costs(label, omega):
    one = [[1.0]]
    free = gs.System(mass=one, damping=one, stiffness=[[1e3]], contacts={"stop": [1.0]})
    law, oscillator = (
        gs.contact_law(label, 1.4e5, SYMMETRIC),
        gs.systems.paper_oscillator() if omega else free,
    )
    models = Models.of([oscillator], [(law,)], np.array([omega]))
    solver = Solver.of("compiled")
    y, periods, never = np.array([[1e-3], [0.0]]), np.full(1, 4), np.full(1, np.inf)
    ensemble = Ensemble(models, solver) if omega else PoincareMap(models, solver, y)
    one, costs = np.zeros(1, np.intp), []
    for tangent in (False, True):
        call = ensemble.call(one, y, periods, never, tangent=tangent)
        assert call.is_ok.all()
        costs.append(ensemble.costs())
    seconds = [cost.pop("cpu_time")[0] for cost in costs]
    assert 0.0 < seconds[0] < seconds[1]
    assert costs[0] == costs[1]
    assert costs[0]["nfev"] >= costs[0]["n_steps"] > 0


@pytest.mark.parametrize("label", ["piecewise", "piecewise-noevents", "tanh-1e4", "poly-3"])
def test_tangents_of_a_chain_are_those_of_its_motions(label):
    """Also where another solver carries them, and where motions run away."""
    law, solver = gs.contact_law(label, 1.4e5, SYMMETRIC), Solver.of("compiled", 1e-5, 1e-8)
    oscillator = gs.systems.paper_oscillator(alpha=-1e10)
    omega = np.linspace(5.0, 30.0, 9)
    ensemble = Ensemble(Models.of([oscillator] * 9, [(law,)] * 9, omega), solver)
    assert ensemble.has_own_tangent == (label == "piecewise")

    def call(scenes, y, follows=None):
        periods, never = np.full(len(scenes), 2), np.full(len(scenes), np.inf)
        return ensemble.call(scenes, y, periods, never, tangent=True, follows=follows)

    y = np.stack([np.linspace(1e-3, 9e-3, 9), np.zeros(9)])
    follows = np.tile([False, True, True], 9)
    chain = call(np.repeat(np.arange(9), 3), np.repeat(y, 3, axis=1), follows)
    left, n_left = np.arange(9), []
    for k in range(3):
        alone = call(left, y)
        for name in ("monodromy", "strayed", "status"):
            assert_array_equal(getattr(chain, name)[left * 3 + k], getattr(alone, name))
        assert_array_equal(chain.y[:, left * 3 + k], alone.y)
        y, left = alone.y[:, alone.is_ok], left[alone.is_ok]
        assert (chain.status.reshape(9, 3)[np.setdiff1d(np.arange(9), left), k:] != Status.OK).all()
        n_left.append(len(left))
    assert 9 > n_left[0] >= n_left[-1] > 0


def orbit_at(omega):
    """A state on the orbit of the hard asymmetric case that is found from rest."""
    found = gs.respond(gs.systems.paper_oscillator(), gs.Piecewise(HARD, ASYMMETRIC), omega)
    return found, (found.x_end, found.v_end)


@pytest.mark.parametrize("rtol", [1e-3, 1e-4])
def test_a_doubled_period_is_not_halved_at_loose_tolerances(rtol):
    """Predicted noise hides how far apart its halves are: these were unresolved, or halved."""
    omega = np.linspace(3.0, 25.0, 700)[[2, 74, 148, 161, 310, 350, 382, 443, 444, 627]]
    fine, start = orbit_at(omega)
    assert (fine.period_multiple > 1).all()
    loose = gs.respond(
        gs.systems.paper_oscillator(),
        gs.Piecewise(HARD, ASYMMETRIC),
        omega,
        *start,
        rtol=rtol,
        atol=1e-3 * rtol,
    )
    assert_array_equal(loose.period_multiple, fine.period_multiple)
    assert_allclose(loose.amplitude, fine.amplitude, rtol=0.02)


def test_weak_chaos_is_measured_until_its_sign_is_certain():
    """6,000 periods of an independent integrator: .602 +- .009 1/s. The first measurement of an
    exponent left its sign open, and more time did not make it any longer.
    """
    oscillator = gs.systems.paper_oscillator(zeta=0.051250807930843446, forcing=3.7470489137481127)
    law, omega = gs.Piecewise(88860.89694574026, gs.Gap(4e-4, 8e-4)), 2.790289457015363
    settings = [gs.Steady(max_decay_times=n, max_periods=10**6) for n in (113.0, 3051.0)]
    short, long = (gs.respond(oscillator, law, omega, steady=each) for each in settings)
    for found in (short, long):
        assert found.response_class is gs.ResponseClass.CHAOTIC
        assert abs(found.lyapunov - 0.602) < 3.0 * math.hypot(found.lyapunov_error, 0.009)
    assert long.lyapunov_error < 0.4 * short.lyapunov_error


@pytest.mark.parametrize(("zeta", "last"), [(0.5, 5.0), (1.5, 20.0)])
def test_a_settled_motion_is_found_at_its_first_look(zeta, last):
    """It took a longer window for every second one: last digits decided whether it contracts."""
    omega = np.linspace(0.3, last, 40)
    law = gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4))
    found = gs.respond(gs.systems.paper_oscillator(zeta=zeta), law, omega)
    assert (found.period_multiple == 1).all()
    # Five periods to see it, three to shoot at it and to record it, and the time to settle.
    settling = omega / (zeta * 2.0 * math.pi * 5.0) * math.log(1e3)
    assert (found.t_simulated * omega < 10.0 + settling).all()


@pytest.mark.parametrize("zeta", [0.009, 0.03, 0.3])
def test_fast_forcing_at_a_loose_tolerance_is_periodic(zeta):
    """What the solver strays in a period adds up over 1 / (1 - multiplier) = 10,000 of them."""
    pulsation = 2.0 * math.pi * 2400.0
    oscillator = gs.Oscillator(zeta=zeta, omega_n=1.0, mass=1.0, alpha=0.0, forcing=pulsation**2)
    # Without a gap, a linear spring.
    law = gs.Piecewise(2.0 * (2.0 * math.pi) ** 2, gs.Gap(0.0, 0.0))
    found = gs.respond(oscillator, law, 2400.0, rtol=1e-4, atol=1e-7)
    assert (found.response_class, found.period_multiple) == (gs.ResponseClass.PERIODIC, 1)
    assert_allclose(found.amplitude, 1.0, rtol=1e-4)
    assert_allclose(found.multiplier_abs, math.exp(-zeta / 2400.0 * 2.0 * math.pi), rtol=1e-6)


def test_a_tangent_that_has_shrunk_to_nothing_is_zero():
    """Rounding would leave the smallest number that there is for ever."""
    law = gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4))
    for each in (law, gs.Tanh(1.4e4, gs.Gap(4e-4, 4e-4), 1e4)):
        run = gs.simulate(
            gs.systems.paper_oscillator(zeta=0.5), each, 1.0, t_end=60.0, tangent=True
        )
        assert not run.monodromy.any()


def test_reasons_for_unresolved_motions_say_what_was_measured():
    hill = gs.System(mass=[[1.0]], damping=[[0.1]], stiffness=[[-1.0]],
                     cubic=[gs.Cubic(along=[1.0], alpha=1.0)])  # fmt: skip
    found = gs.respond(hill, {})
    assert found.status is gs.Status.UNRESOLVED
    assert "unstable equilibrium" in found.message
    free = gs.System(mass=np.eye(2), stiffness=[[2.0, -1.0], [-1.0, 2.0]])
    found = gs.respond(free, {}, q_0=[1.0, 0.3])  # two frequencies, one the root of three times
    assert found.status is gs.Status.UNRESOLVED
    assert "without damping" in found.message


@pytest.mark.parametrize("rtol", [1e-6, 1e-7, 1e-9])
def test_a_motion_that_still_decays_is_not_given_twice_its_period(rtol):
    """Just before a period doubling, multiplier -.9997: over two periods noise hides the decay."""
    oscillator = gs.Oscillator(
        zeta=0.034362877546037354, omega_n=5.895811864635071, mass=2.640328790405397,
        alpha=134787075.5594873, forcing=9.846942415323008,
    )  # fmt: skip
    law = gs.Piecewise(83442.60736460447, gs.Gap(0.00046901049319167604, 0.0011412095596463237))
    spread = np.random.default_rng(0).normal(1.0, 0.3, (2, 12))
    found = gs.respond(
        oscillator, law, 3.4203341416757778, *([[7.9e-4], [6.6e-3]] * spread), rtol=rtol
    )
    assert (found.period_multiple == 1).all()
    assert_allclose(found.multiplier_abs, 0.99971, atol=2e-5)


def test_a_slow_orbit_is_waited_for_while_its_exponent_is_uncertain():
    oscillator = gs.Oscillator(
        zeta=0.058683619490886366, omega_n=22.936952450152123, mass=2.389001307182264,
        alpha=0.0, forcing=43.59405750440655,
    )  # fmt: skip
    law = gs.Piecewise(998889.4350542114, gs.Gap(0.0002465640644099716, 0.0002465640644099716))
    start = 0.00017574811262109933, -0.008884149786463796
    found = gs.respond(oscillator, law, 16.412240228581283, *start)
    assert found.period_multiple == 1
    assert_allclose(found.multiplier_abs, 0.99777, atol=1e-5)


@pytest.mark.parametrize("rtol", [1e-3, 1e-9])
def test_free_vibration_between_walls_is_periodic(rtol):
    stiff, walls = gs.System(mass=[[1.0]], stiffness=[[20.0]], contacts={"c": [1.0]}), 200.0
    found = gs.respond(
        stiff, gs.Piecewise(walls, gs.Gap(0.5, 0.5)), q_0=[1.0], rtol=rtol, atol=1e-3 * rtol
    )
    assert found.response_class is gs.ResponseClass.PERIODIC
    # A quarter period: from the wall to the turning point, and across half of the gap.
    inner, outer = math.sqrt(20.0), math.sqrt(20.0 + walls)
    speed, depth = math.sqrt(0.75 * 20.0 + 0.25 * walls), 0.5  # at the wall, beyond it
    middle = 20.0 * 0.5 / (20.0 + walls)  # of the outer swing, beyond the wall: at -middle
    outside = math.acos(middle / (depth + middle)) / outer
    inside = math.asin(0.5 / math.hypot(0.5, speed / inner)) / inner
    assert_allclose(found.period, 4.0 * (inside + outside), rtol=max(10.0 * rtol, 1e-8))
    assert_allclose(found.multiplier_abs, 1.0, atol=max(rtol, 1e-6))


def test_undamped_motion_ends_whatever_error_of_the_exponent_is_wanted():
    law, steady = gs.Piecewise(1.4e6, SYMMETRIC), gs.Steady(lyapunov_error=0.2)
    found = gs.respond(gs.systems.paper_oscillator(zeta=0.0), law, 9.0, steady=steady)
    assert found.response_class is gs.ResponseClass.UNRESOLVED
    assert np.isnan(found.lyapunov)
    assert "without damping" in found.message


def at_loose_tolerances(law, omega, contact_force="by_mode", **how):
    """Response of the paper's oscillator with MATLAB's ode45 and the paper's tolerances."""
    model = gs.Oscillator(zeta=0.03, omega_n=5.0, mass=3.0, alpha=7e8, forcing=4.0)
    solver = Solver.of("compiled", 1e-4, 1e-7, "ode45", contact_force=contact_force)
    scene = Scene(oscillator=model, law=law, omega=omega, solver=solver)
    return model, respond_all([scene], [0.0, 0.0], gs.Steady(**how)).row(0)


@pytest.mark.parametrize("law", [gs.Piecewise(1.4e6, gs.Gap(0.0, 8e-4), located=False),
                                 gs.Piecewise(1.4e6, gs.Gap(0.0, 8e-4)),
                                 gs.Tanh(1.4e6, gs.Gap(0.0, 8e-4), 1e6)])  # fmt: skip
@pytest.mark.parametrize("omega", [7.0, 13.0, 17.0])
def test_chaos_of_a_loose_solver_is_none_of_the_machine(law, omega):
    # the tangent along the motion of ode45 grows by 1.4 and 1.6 per second at 7 Hz
    model, found = at_loose_tolerances(law, omega, contact_force="as_written")
    assert found.response_class is gs.ResponseClass.PERIODIC
    assert found.stability_rtol == 1e-9
    exact = law if isinstance(law, gs.Tanh) else gs.Piecewise(1.4e6, law.gap)
    start = {"x_0": found.x_end, "v_0": found.v_end}
    truth = gs.respond(model, exact, omega, **start, rtol=1e-11, atol=1e-14)
    assert found.period_multiple == truth.period_multiple
    assert_allclose(found.multipliers, truth.multipliers, atol=1e-4)
    assert found.lyapunov < 0.0


def test_an_orbit_that_is_unstable_at_tight_tolerances_is_unresolved():
    model = gs.Oscillator(zeta=0.05214577321077409, omega_n=6.706748121395614, alpha=0.0,
                          mass=1.0787613932772222, forcing=1.0664019921426258)  # fmt: skip
    law = gs.Piecewise(66416.72331024821, gs.Gap(0.0, 0.0002882629469861148),
                       K_ratio=0.2588794425878812)  # fmt: skip
    omega, start = 2.616625965129294, (0.0002498030485829685, -0.004071268290971664)
    found = gs.respond(model, law, omega, *start, rtol=1.5e-3)
    assert found.status is gs.Status.UNRESOLVED
    assert found.period_multiple == 0
    assert not found.multipliers.size
    assert "5 periods" in found.message
    assert len(found.extrema) == found.n_extrema > 0  # the loose method's own
    # the same orbit by matrix exponentials, from a motion near it: a multiplier beyond -1
    equations = exact_orbits.Exact(lambda f: (exact_orbits.exact_system(model, law), f), 5)
    guess = np.array([found.section[0], found.section[1], omega])
    orbit = equations.orbit(guess, np.array([[0.0, 0.0, 1.0]]))
    assert np.abs(orbit.multipliers).max() > 1.05
    truth = gs.respond(model, law, omega, *start)
    assert truth.period_multiple == 10


def test_confirmed_multipliers_are_those_of_the_machine():
    rng = np.random.default_rng(7)
    omega, x_0 = rng.uniform(4.0, 20.0, 60), rng.normal(scale=1e-3, size=60)
    model = gs.Oscillator(zeta=0.05, omega_n=5.0, mass=3.0, alpha=0.0, forcing=4.0)
    law = gs.Piecewise(1.4e5, gs.Gap(2e-4, 6e-4))
    truth = gs.respond(model, law, omega, x_0)
    for rtol in (1e-3, 1e-4, 1e-6):
        loose = gs.respond(model, law, omega, x_0, rtol=rtol)
        alike = (loose.period_multiple == truth.period_multiple) & (truth.period_multiple > 0)
        assert alike.sum() > 30
        assert np.mean(loose.status == gs.Status.UNRESOLVED) < 0.1
        off = np.abs(loose.multiplier_abs - truth.multiplier_abs)[alike]
        assert np.quantile(off, 0.9) < 1e-6
        assert (loose.x_max != truth.x_max)[alike].all()  # the loose method's own


def test_a_response_within_its_noise_is_unresolved():
    model = gs.Oscillator(zeta=0.0238, omega_n=21.65, mass=0.2267, alpha=0.0, forcing=0.2408)
    tiny = model, gs.Piecewise(1.61e6, gs.Gap(0.0, 0.0)), 54.10, -1.795e-4, 6.95e-3
    found = gs.respond(*tiny, rtol=1e-3, atol=1e-7)
    assert found.noise > found.amplitude
    assert found.status is gs.Status.UNRESOLVED
    assert found.response_class is gs.ResponseClass.UNRESOLVED
    assert "lower atol" in found.message
    found = gs.respond(*tiny, rtol=1e-3)
    assert found.noise < 0.1 * found.amplitude
    assert found.status is gs.Status.OK
    assert found.atol < 1e-8
