"""The exact engine against closed forms, independent integrators and invariants (E1-E23)."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from tests.conftest import golden
from tests.engines import exact as integrate

from gapsweep.integrate.taylor import exact, record
from gapsweep.integrate.taylor import exact_kernel as kernel
from gapsweep.integrate.taylor.exact import _by_point

PAPER = dict(
    zeta=0.03,
    omega_n=5.0,
    mass=3.0,
    alpha=7e8,
    forcing=4.0,
    K_c=1.4e4,
    j_1=0.4e-3,
    j_2=0.4e-3,
    omega=9.0,
)
FREE = dict(PAPER, zeta=0.0, forcing=0.0)
TIGHT = dict(rtol=1e-12, atol=1e-15)
CONTACTS = (record.ENTER_UPPER, record.LEAVE_UPPER, record.ENTER_LOWER, record.LEAVE_LOWER)
EXTREMA = (record.MINIMUM, record.MAXIMUM, record.INFLECTION)


def scene(**changes):
    return dict(PAPER, **changes)


def run(t_end, base=PAPER, **changes):
    return integrate(**{**TIGHT, **base, "t_end": t_end, **changes})


def contact_kinds(result, point=0):
    return result.events(point, *CONTACTS)[:, 3].astype(int)


def same_bits(a, b):
    return np.array_equal(np.asarray(a).view(np.int64), np.asarray(b).view(np.int64))


# ---------------------------------------------------------------- independent references


def interval(s, mode):
    return {0: (-s["j_1"], s["j_2"]), 1: (s["j_2"], np.inf), -1: (-np.inf, -s["j_1"])}[mode]


class LinearSegment:
    """Closed form of x(t) within one contact mode for alpha = 0."""

    def __init__(self, s, mode, t, x, v):
        w_n, self.w = 2 * np.pi * s["omega_n"], 2 * np.pi * s["omega"]
        k = w_n**2 + (s["K_c"] / s["mass"] if mode else 0.0)
        wall = s["j_2"] if mode > 0 else -s["j_1"]
        self.mean = s["K_c"] / s["mass"] * wall / k if mode else 0.0
        self.decay, c = s["zeta"] * w_n, 2 * s["zeta"] * w_n
        self.fast = np.sqrt(k - self.decay**2)
        response = s["forcing"] / s["mass"] / (k - self.w**2 + 1j * c * self.w)
        self.response, self.t = response, t
        part, slope = self._forced(t)
        a = x - part
        self.a, self.b = a, (v - slope + self.decay * a) / self.fast

    def _forced(self, t):
        z = self.response * np.exp(1j * self.w * t)
        return z.real + self.mean, (1j * self.w * z).real

    def __call__(self, t):
        part, slope = self._forced(t)
        u = t - self.t
        c, s, e = np.cos(self.fast * u), np.sin(self.fast * u), np.exp(-self.decay * u)
        x = e * (self.a * c + self.b * s)
        v = e * (
            (self.b * self.fast - self.decay * self.a) * c
            - (self.a * self.fast + self.decay * self.b) * s
        )
        return x + part, v + slope


def closed_form(s, x, v, t_end, mode=0, scan=2e-5):
    """End state and contacts of the piecewise-linear oscillator: scan, then bracketed roots."""
    t, times = 0.0, []
    while True:
        segment, (lo, hi) = LinearSegment(s, mode, t, x, v), interval(s, mode)
        grid = np.append(np.arange(t + scan, min(t + 0.3, t_end), scan), min(t + 0.3, t_end))
        positions = segment(grid)[0]
        outside = np.flatnonzero((positions > hi) | (positions < lo))
        if not len(outside):
            if grid[-1] >= t_end:
                return (*segment(t_end), times)
            t, (x, v) = grid[-1], segment(grid[-1])
            continue
        i = outside[0]
        wall = hi if positions[i] > hi else lo
        # from the last grid point inside: the segment's own start may lie on this very wall
        before = grid[i - 1] if i else t + 1e-9
        t = brentq(
            lambda u, g=segment, w=wall: g(u)[0] - w, before, grid[i], xtol=1e-17, rtol=1e-15
        )
        x, v = wall, segment(t)[1]
        mode = 0 if mode else (1 if wall == s["j_2"] else -1)
        times.append(t)


def restarted_dop853(s, x, v, t_end, mode=0):
    """scipy DOP853 at 1e-13 with terminal events and restarts."""
    w_n, w = 2 * np.pi * s["omega_n"], 2 * np.pi * s["omega"]
    t, n_contacts = 0.0, 0
    while t < t_end:
        lo, hi = interval(s, mode)
        k, wall = (s["K_c"], hi if mode < 0 else lo) if mode else (0.0, 0.0)

        def rhs(t, y, k=k, wall=wall):
            x, v = y
            force = s["forcing"] * np.cos(w * t) - s["alpha"] * x**3 - k * (x - wall)
            return v, force / s["mass"] - 2 * s["zeta"] * w_n * v - w_n**2 * x

        events = []
        for bound, direction in ((hi, 1), (lo, -1)):
            if np.isfinite(bound):
                events.append(lambda t, y, b=bound: y[0] - b)
                events[-1].terminal, events[-1].direction = True, direction
        r = solve_ivp(
            rhs, (t, t_end), (x, v), "DOP853", events=events, rtol=1e-13, atol=1e-16, max_step=2e-3
        )
        t, (x, v) = r.t[-1], r.y[:, -1]
        if r.status == 1:
            n_contacts += 1
            is_up = v > 0
            x = hi if is_up else lo
            mode = 0 if mode else (1 if is_up else -1)
    return x, v, n_contacts


# ---------------------------------------------------------------- against references


def test_truth_table_is_met_at_1e_12():
    rows = golden("piecewise.json")
    table = {k: np.array([r["scene"][k] for r in rows]) for k in rows[0]["scene"]}
    end, tail = (np.array([r[k] for r in rows]) for k in ("T", "tail_from"))
    result = integrate(**table, t_end=end, record_from=tail, **TIGHT)
    assert (result.status == kernel.OK).all()
    for i, r in enumerate(rows):
        amplitude = max(abs(r["tail_max"]), abs(r["tail_min"]))
        extrema = result.events(i, *EXTREMA)[:, 1]
        assert result.n_contacts[i] == r["contact_transitions"]
        assert abs(result.x[i] - r["x_T"]) < 1e-9 * amplitude
        assert abs(result.v[i] - r["v_T"]) < 1e-9 * amplitude * 2 * np.pi * max(
            r["scene"]["omega"], r["scene"]["omega_n"]
        )
        assert abs(extrema.max() - r["tail_max"]) < 1e-9 * amplitude
        assert abs(extrema.min() - r["tail_min"]) < 1e-9 * amplitude


def test_e1_piecewise_linear_motion_equals_the_closed_form_over_1000_contacts():
    s = scene(alpha=0.0, zeta=0.05, omega=11.0, j_1=0.1e-3, j_2=0.15e-3, K_c=1.4e4, forcing=8.0)
    result = run(30.0, s, record_from=0.0)
    x, v, times = closed_form(s, 0.0, 0.0, 30.0, scan=1e-4)
    contacts = result.events(0, *CONTACTS)
    assert result.n_contacts[0] == len(times) > 1000
    assert np.abs(contacts[:, 0] - times).max() < 1e-11
    assert abs(result.x[0] - x) < 1e-12 * 1e-3 * 100
    assert abs(result.v[0] - v) < 1e-12 * 0.05 * 100


@pytest.mark.parametrize(
    "changes",
    [
        dict(K_c=1.4e6, omega=12.0),
        dict(j_1=0.0, j_2=0.8e-3, omega=6.0),
        dict(alpha=-2e8, omega=3.0, forcing=1.0),
        dict(K_c=1.4e6, j_1=0.0, j_2=0.8e-3, omega=11.0, x_0=0.3e-3, v_0=-0.02),
    ],
)
@pytest.mark.parametrize("rtol", [1e-9, 1e-12])
def test_nonlinear_motion_equals_dop853_with_restarts(changes, rtol):
    s = scene(**{"x_0": 0.0, "v_0": 0.0, **changes})
    x, v, n_contacts = restarted_dop853(s, s["x_0"], s["v_0"], 0.7)
    result = run(0.7, s, rtol=rtol)
    assert result.n_contacts[0] == n_contacts
    assert abs(result.x[0] - x) < 1e-3 * max(300 * rtol, 1e-9)
    assert abs(result.v[0] - v) < 0.05 * max(300 * rtol, 1e-9)


def test_e3_walls_without_gap_give_the_plain_duffing_oscillator():
    s = scene(j_1=0.0, j_2=0.0)
    plain = scene(K_c=0.0, omega_n=np.sqrt((10 * np.pi) ** 2 + 1.4e4 / 3.0) / 2 / np.pi)
    plain["zeta"] = 0.03 * 5.0 / plain["omega_n"]
    a, b = run(5.0, s, record_from=0.0), run(5.0, plain, j_1=np.inf, j_2=np.inf)
    assert abs(a.x[0] - b.x[0]) < 1e-12
    assert a.n_contacts[0] == len(contact_kinds(a)) > 50
    assert b.n_contacts[0] == 0


def test_e4_an_unreachable_wall_is_no_wall():
    a, b = run(5.0, j_1=10.0, j_2=20.0, K_c=1e9), run(5.0, j_1=np.inf, j_2=np.inf)
    assert same_bits([a.x, a.v], [b.x, b.v])


# ---------------------------------------------------------------- starts, grazes, coincidences


@pytest.mark.parametrize(("forcing", "first"), [(4.0, None), (-4.0, record.LEAVE_LOWER)])
def test_e5_start_at_rest_on_a_wall_takes_the_side_of_the_force(forcing, first):
    s = scene(j_1=0.0, j_2=0.8e-3, omega=6.0, forcing=forcing, x_0=0.0, v_0=0.0)
    result = run(0.5, s, record_from=0.0)
    x, v, n_contacts = restarted_dop853(s, 0.0, 0.0, 0.5, mode=0 if forcing > 0 else -1)
    assert abs(result.x[0] - x) < 1e-12
    assert abs(result.v[0] - v) < 1e-10
    assert result.n_contacts[0] == n_contacts
    kinds = contact_kinds(result)
    assert (
        (kinds[0] == first)
        if first is not None
        else kinds[0] in (record.ENTER_UPPER, record.ENTER_LOWER)
    )


@pytest.mark.parametrize(
    ("v_0", "forcing", "mode"),
    [
        (0.01, 0.0, 1),
        (-0.01, 0.0, 0),
        (0.0, 50.0, 1),
        (0.0, -50.0, 0),
        (0.0, 0.0, 0),
        (0.01, -50.0, 1),
        (-0.01, 50.0, 0),
    ],
)
def test_e6_start_on_the_upper_wall_follows_velocity_then_acceleration(v_0, forcing, mode):
    result = run(1e-4, forcing=forcing, x_0=0.4e-3, v_0=v_0)
    assert (result.mode[0], result.n_contacts[0], result.status[0]) == (mode, 0, kernel.OK)


def test_e6_third_derivative_decides_where_velocity_and_acceleration_vanish():
    # forcing at a quarter period: cos = 0 to rounding and its slope points down
    for forcing, mode in ((40.0, -1), (-40.0, 0)):
        result = run(0.25 / 9.0 + 1e-4, forcing=forcing, j_1=0.0, t_0=0.25 / 9.0, x_0=0.0, v_0=0.0)
        assert (result.mode[0], result.n_contacts[0]) == (mode, 0)


@pytest.mark.parametrize(
    "depth", [1e-3, 1e-6, 1e-9, 1e-12, 1e-14, -1e-3, -1e-6, -1e-9, -1e-12, -1e-14, 0.0]
)
@pytest.mark.parametrize("rtol", [1e-3, 1e-8, 1e-12])
def test_e7_e8_a_dip_holds_both_crossings_or_none(depth, rtol):
    w_n, j = 10 * np.pi, 0.4e-3
    result = run(0.08, FREE, alpha=0.0, v_0=w_n * j * (1 + depth), rtol=rtol, record_from=0.0)
    kinds = list(contact_kinds(result))
    if abs(depth) > 1e-13 and abs(depth) > 100 * rtol:
        assert len(kinds) == (2 if depth > 0 else 0)
    assert kinds in ([], [record.ENTER_UPPER, record.LEAVE_UPPER])
    # a contact this shallow changes the end state by its own depth at most
    assert abs(result.x[0] - j * np.sin(w_n * 0.08)) < j * (2 * abs(depth) + 100 * rtol + 1e-13)


def test_e9_both_walls_within_one_step_come_in_the_order_of_time():
    result = run(1.0, FREE, j_1=1e-9, j_2=1e-9, v_0=0.05, record_from=0.0)
    contacts = result.events(0, *CONTACTS)
    cycle = [record.ENTER_UPPER, record.LEAVE_UPPER, record.ENTER_LOWER, record.LEAVE_LOWER]
    assert len(contacts) > 40
    assert list(contacts[:, 3]) == (cycle * len(contacts))[: len(contacts)]
    assert (np.diff(contacts[:, 0]) > 0).all()


def test_e10_a_contact_and_a_section_at_the_end_are_counted_once():
    contacts = run(1.0, record_from=0.0).events(0, *CONTACTS)
    for t in contacts[3:6, 0]:
        n = np.flatnonzero(contacts[:, 0] == t)[0]
        assert run(t - 1e-9).n_contacts[0] == n
        assert run(t + 1e-9).n_contacts[0] == n + 1
        assert run(t).n_contacts[0] in (n, n + 1)  # the end itself is rounded
    section = run(7 / 9.0, record_from=0.0).events(0, record.SECTION)
    assert np.allclose(section[:, 0], np.arange(1, 8) / 9.0, rtol=1e-15)


def test_e11_motions_of_any_size_have_the_same_contacts():
    s = scene(alpha=0.0, atol=0.0)
    scale = 2.0**-420  # energies, their squares, just do not underflow
    small = {k: s[k] * scale for k in ("forcing", "j_1", "j_2")}
    a, b = run(3.0, s), run(3.0, dict(s, **small))
    assert a.n_contacts[0] == b.n_contacts[0] > 10
    assert b.x[0] / scale == a.x[0]
    assert b.v[0] / scale == a.v[0]


def test_e12_tighter_tolerances_keep_the_sequence_of_contacts():
    sequences = [
        contact_kinds(run(10.0, omega=6.0, rtol=rtol, record_from=0.0))
        for rtol in (1e-7, 1e-9, 1e-11, 1e-13)
    ]
    assert len(sequences[0]) > 100
    assert all(np.array_equal(sequences[0], other) for other in sequences[1:])


@pytest.mark.parametrize("order", [8, 12])
def test_e13_error_falls_with_tolerance_as_fast_with_contacts_as_without(order):
    """One motion's errors scatter by a factor of three; the median of sixteen hardly."""
    rtols = 10.0 ** np.arange(-4, -9, -1.0)
    omega = np.linspace(4.0, 9.0, 16)
    slopes = []
    for gap in (np.inf, 0.4e-3):
        many = dict(t_end=2.0, omega=omega, j_1=gap, j_2=gap)
        best = run(**many, rtol=1e-13).x
        runs = (run(**many, rtol=rtol, atol=0.0, order=order) for rtol in rtols)
        errors = [np.median(np.abs(motions.x - best)) for motions in runs]
        slopes.append(np.polyfit(np.log(rtols), np.log(errors), 1)[0])
    assert all(0.7 < slope < 1.3 for slope in slopes), slopes
    assert abs(slopes[1] - slopes[0]) < 0.3


def test_e21_stopping_on_the_way_changes_nothing_but_rounding():
    whole = run(4.0, omega=6.0)
    t, state, n_contacts = 0.0, dict(x_0=0.0, v_0=0.0), 0
    for t_next in np.sort(np.append(np.random.default_rng(1).uniform(0, 4, 20), 4.0)):
        part = run(t_next, omega=6.0, t_0=t, **state)
        t, state, n_contacts = (
            t_next,
            dict(x_0=part.x[0], v_0=part.v[0]),
            n_contacts + part.n_contacts[0],
        )
    assert n_contacts == whole.n_contacts[0]
    assert abs(part.x[0] - whole.x[0]) < 1e-13


# ---------------------------------------------------------------- invariants


def energy(s, x, v):
    w_n = 2 * np.pi * s["omega_n"]
    penetration = np.maximum(x - s["j_2"], 0) + np.minimum(x + s["j_1"], 0)
    return (
        s["mass"] * (v**2 + (w_n * x) ** 2) / 2
        + s["alpha"] * x**4 / 4
        + s["K_c"] * penetration**2 / 2
    )


def test_e2_energy_is_kept_over_ten_thousand_contacts():
    s = dict(FREE, K_c=1.4e6)
    result = run(150.0, s, v_0=0.06)
    assert result.n_contacts[0] > 1e4
    assert abs(energy(s, result.x[0], result.v[0]) / energy(s, 0.0, 0.06) - 1) < 1e4 * 1e-12


@pytest.mark.parametrize("changes", [{}, dict(K_c=1.4e6, omega=3.0), dict(j_1=0.0, j_2=0.0)])
def test_e14_mirror_image_starts_give_bitwise_mirror_images(changes):
    s = scene(x_0=0.1e-3, v_0=0.03, **changes)
    a = run(5.0, s, record_from=0.0)
    b = run(5.0, dict(s, forcing=-4.0, x_0=-0.1e-3, v_0=-0.03), record_from=0.0)
    assert (a.x[0], a.v[0], a.n_steps[0]) == (-b.x[0], -b.v[0], b.n_steps[0])
    assert np.array_equal(a.events(0, *CONTACTS)[:, 1], -b.events(0, *CONTACTS)[:, 1])


@pytest.mark.parametrize(
    "changes", [{}, dict(K_c=1.4e6, omega=11.0, j_1=0.0, j_2=0.8e-3), dict(j_1=0.0, j_2=0.0)]
)
def test_e15_the_monodromy_contracts_areas_at_the_known_rate(changes):
    s = scene(**changes)
    result = run(0.6, s, tangent=True)
    rate = 2 * s["zeta"] * 2 * np.pi * s["omega_n"]
    assert abs(np.linalg.det(result.monodromy[0]) / np.exp(-rate * 0.6) - 1) < 1e-10


def test_e16_the_monodromy_is_the_derivative_of_the_motion():
    d = 1e-8
    s = scene(omega=6.0, t_end=0.6, **TIGHT)
    m = integrate(**s, tangent=True, x_0=1e-4, v_0=0.01).monodromy[0]
    ends = integrate(
        **s, x_0=[1e-4 + d, 1e-4 - d, 1e-4, 1e-4], v_0=[0.01, 0.01, 0.01 + 30 * d, 0.01 - 30 * d]
    )
    steps = np.array([d, 30 * d])
    differences = np.array([ends.x[::2] - ends.x[1::2], ends.v[::2] - ends.v[1::2]]) / (2 * steps)
    assert np.abs((differences - m) / np.abs(m).max(axis=1, keepdims=True)).max() < 1e-6


def test_the_tangent_does_not_change_the_motion():
    a, b = run(3.0), run(3.0, tangent=True)
    assert same_bits([a.x, a.v], [b.x, b.v])


def test_e17_reversing_the_velocity_leads_back_to_the_start():
    there = run(1.0, FREE, K_c=1.4e6, x_0=0.1e-3, v_0=0.06)
    back = run(1.0, FREE, K_c=1.4e6, x_0=there.x, v_0=-there.v)
    assert there.n_contacts[0] == back.n_contacts[0] > 10
    assert abs(back.x[0] - 0.1e-3) < 1e-12
    assert abs(back.v[0] + 0.06) < 1e-10


def test_e20_a_start_a_million_seconds_later_is_the_same_motion():
    whole = 1_000_000.0
    for omega, t_0 in (
        (8.0, whole),
        (9.0, whole),
        (6.3, 6_300_001 / 6.3),
        (11.0, 11_000_007 / 11.0),
    ):
        a, b = run(2.0, omega=omega), run(t_0 + 2.0, omega=omega, t_0=t_0)
        rounding = 2 * np.spacing(t_0)
        assert a.n_contacts[0] == b.n_contacts[0]
        assert abs(a.x[0] - b.x[0]) < 1e-14 + 0.05 * rounding
    a, b = run(7 / 6.3, omega=6.3), run(6_300_008 / 6.3, omega=6.3, t_0=6_300_001 / 6.3)
    assert same_bits([a.x, a.v], [b.x, b.v])


def test_e20_the_phase_survives_a_million_periods():
    s = scene(alpha=0.0, K_c=0.0, omega=30.0, zeta=0.3)
    n = 1_000_000
    result = run((n + 0.3) / 30.0, s, rtol=1e-10)
    w, w_n = 60 * np.pi, 10 * np.pi
    z = 4.0 / 3.0 / (w_n**2 - w**2 + 2j * 0.3 * w_n * w) * np.exp(2j * np.pi * 0.3)
    assert abs(result.x[0] - z.real) < 1e-9 * abs(z)


# ---------------------------------------------------------------- lanes


def many(n=70, seed=3):
    rng = np.random.default_rng(seed)
    return dict(
        zeta=rng.uniform(0.01, 0.1, n),
        omega_n=rng.uniform(3, 8, n),
        mass=rng.uniform(2, 4, n),
        alpha=rng.uniform(-1e8, 1e9, n),
        forcing=rng.uniform(-5, 5, n),
        K_c=10 ** rng.uniform(2, 6.5, n),
        j_1=rng.uniform(0, 1e-3, n),
        j_2=rng.uniform(0, 1e-3, n),
        omega=rng.uniform(1, 30, n),
        x_0=rng.uniform(-1e-3, 1e-3, n),
        v_0=rng.uniform(-0.05, 0.05, n),
        t_end=rng.uniform(0.2, 4, n),
    )


@pytest.fixture(scope="module")
def batch():
    points = many()
    return points, integrate(**points, record_from=0.0)


@pytest.mark.parametrize("size", [1, 2, 3, 4, 7, 8, 16, 64])
def test_e18_a_point_is_the_same_in_every_batch(batch, size):
    points, whole = batch
    order = np.random.default_rng(size).permutation(len(whole.x))[: size if size > 1 else 5]
    groups = [order[i : i + size] for i in range(0, len(order), size)]
    for group in groups:
        part = integrate(**{k: a[group] for k, a in points.items()}, record_from=0.0)
        assert same_bits([part.x, part.v], [whole.x[group], whole.v[group]])
        for i, p in enumerate(group):
            assert same_bits(part.events(i), whole.events(p))


def test_e18_another_process_gives_the_same_bits(batch):
    _, whole = batch
    code = (
        "import tests.physics.test_taylor as t; r = t.integrate(**t.many(), record_from=0.0);"
        "print(r.x.tobytes().hex() + r.v.tobytes().hex())"
    )
    printed = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parents[2],
    ).stdout
    assert printed.strip() == whole.x.tobytes().hex() + whole.v.tobytes().hex()


def test_e19_a_failing_lane_leaves_its_neighbours_alone(batch):
    points, whole = batch
    broken = {k: np.insert(a, [3, 20, 40], a[:3]) for k, a in points.items()}
    at = np.array([3, 21, 42])
    broken["alpha"][at[0]], broken["x_0"][at[0]], broken["j_2"][at[0]] = (
        -1e9,
        5.0,
        np.inf,
    )  # escapes
    broken["K_c"][at[1]], broken["x_0"][at[1]] = (
        1e35,
        5.0,
    )  # needs steps below the clock's resolution
    broken["x_0"][at[2]] = 1e90  # overflows at once
    broken["t_end"][at] = 10.0
    result = integrate(**broken)
    assert list(result.status[at]) == [kernel.DIVERGED, kernel.STEP_UNDERFLOW, kernel.DIVERGED]
    kept = np.delete(np.arange(len(result.x)), at)
    assert (result.status[kept] == whole.status).all()
    assert same_bits(result.x[kept], whole.x)


def test_chatter_ends_a_lane():
    result = run(1.0, FREE, j_1=1e-12, j_2=1e-12, v_0=0.05, max_chatter=0, record_from=0.0)
    assert result.status[0] == kernel.CHATTER
    # at once: from the middle of the gap to its wall
    assert 0.9e-12 / 0.05 < result.t[0] < 1.1e-12 / 0.05


def test_rest_in_equilibrium_on_a_wall_ends_normally():
    result = run(1.0, FREE, j_1=0.0, j_2=0.0, atol=0.0)
    assert (result.status[0], result.x[0], result.n_contacts[0]) == (kernel.OK, 0.0, 0)


# ---------------------------------------------------------------- recording


def test_extrema_are_all_zeros_of_the_velocity():
    s = scene(alpha=0.0, K_c=0.0, omega=23.0, x_0=0.0, v_0=0.01)
    result = run(2.0, s, record_from=0.0)
    segment = LinearSegment(s, 0, 0.0, 0.0, 0.01)
    t = np.linspace(0, 2, 200_001)
    v = segment(t)[1]
    at = np.flatnonzero(v[:-1] * v[1:] < 0)
    zeros = np.array([brentq(lambda u: segment(u)[1], t[i], t[i + 1], xtol=1e-16) for i in at])
    extrema = result.events(0, *EXTREMA)
    assert len(extrema) == len(zeros)
    assert np.abs(extrema[:, 0] - zeros).max() < 1e-11
    assert np.abs(extrema[:, 1] - segment(zeros)[0]).max() < 1e-14
    assert np.array_equal(extrema[:, 3] == record.MAXIMUM, v[at] > 0)


@pytest.mark.parametrize("t_touch", [0.05, 0.071, 0.093])
def test_e22_a_halt_without_return_is_one_inflection(t_touch):
    w, w_n = 18 * np.pi, 10 * np.pi
    amplitude = 4.0 / 3.0 / (w_n**2 - w**2)
    # free part such that v = a = 0 at t_touch, on top of the forced part
    a, c = (
        -amplitude * (w / w_n) ** 2 * np.cos(w * t_touch),
        -amplitude * (w / w_n) * np.sin(w * t_touch),
    )
    u = -w_n * t_touch
    x_0 = amplitude + a * np.cos(u) - c * np.sin(u)
    v_0 = -w_n * (a * np.sin(u) + c * np.cos(u))
    result = run(
        2 * t_touch, FREE, alpha=0.0, K_c=0.0, forcing=4.0, x_0=x_0, v_0=v_0, record_from=0.0
    )
    near = [e for e in result.events(0, *EXTREMA) if abs(e[0] - t_touch) < 1e-3]
    assert [e[3] for e in near] == [record.INFLECTION]
    assert abs(near[0][0] - t_touch) < 1e-6


def test_recording_starts_when_told_and_changes_nothing():
    plain, late, early = run(5.0), run(5.0, record_from=3.0), run(5.0, record_from=0.0)
    assert same_bits([plain.x, plain.v], [late.x, late.v])
    assert len(plain.turns) == len(plain.contacts) == len(plain.sections) == 0
    all_events = early.events(0)
    assert np.array_equal(late.events(0), all_events[all_events[:, 0] >= 3.0])
    section = early.events(0, record.SECTION)
    assert np.allclose(section[:, 0] * 9.0, np.arange(1, 46), atol=1e-9)


def test_section_points_lie_on_the_motion():
    section = run(2.0, omega=6.0, record_from=0.0).events(0, record.SECTION)
    for t, x, v, _ in section[[2, 7, 11]]:
        end = run(t, omega=6.0)
        assert abs(end.x[0] - x) < 1e-14
        assert abs(end.v[0] - v) < 1e-12


def test_dense_output_is_the_motion_at_any_time():
    result = integrate(
        **scene(omega=[6.0, 9.0]), **TIGHT, t_end=3.0, record_from=1.0, dense_output=True
    )
    times = np.random.default_rng(0).uniform(1.0, 3.0, 6)
    x, v = result.sample(times)
    for i, t in enumerate(times):
        ends = integrate(**scene(omega=[6.0, 9.0]), **TIGHT, t_end=t)
        assert np.abs(x[:, i] - ends.x).max() < 1e-13
        assert np.abs(v[:, i] - ends.v).max() < 1e-11
    with pytest.raises(ValueError, match="outside the recorded part"):
        result.sample([0.5])


def test_full_buffers_are_drained_and_nothing_is_lost(monkeypatch):
    points = {k: a[:20] for k, a in many().items()}
    whole = integrate(**points, record_from=0.0, dense_output=True)
    monkeypatch.setattr(exact, "_LOG_VALUES", 500)
    monkeypatch.setattr(exact, "_BUDGET", 7)
    drained = integrate(**points, record_from=0.0, dense_output=True)
    for log in ("turns", "contacts", "sections", "steps"):
        assert same_bits(getattr(whole, log), getattr(drained, log))


SCENES = dict(
    K_c=st.floats(1.0, 1e9),
    j_1=st.floats(0, 1e-3),
    j_2=st.floats(0, 1e-3),
    alpha=st.floats(-1e8, 1e9),
    forcing=st.floats(-8, 8),
    omega=st.floats(0.5, 30),
    x_0=st.floats(-1e-3, 1e-3),
    v_0=st.floats(-0.05, 0.05),
    rtol=st.sampled_from([1e-2, 1e-6, 1e-13]),
)


@given(order=st.sampled_from([8, 12, 16]), **SCENES)
def test_no_step_holds_a_crossing_that_was_not_reported(order, rtol, **changes):
    # the tolerance that belongs to a lower order makes steps so long that their series is wild
    s = scene(**changes)
    # Nearer to a wall than rounding of displacements of a millimetre, on which side is no question.
    assume(not any(0.0 < abs(s["x_0"] - wall) < 1e-20 for wall in (-s["j_1"], s["j_2"])))
    result = run(1.0, s, rtol=rtol, order=order, record_from=0.0, dense_output=True, x_bound=10.0)
    length, series = result.steps[:, 2:3], result.steps[:, 3:]
    part = np.linspace(0, 1, 65)
    x = sum(series[:, n : n + 1] * (length * part) ** n for n in range(order, -1, -1))
    low, high = x.min(axis=1), x.max(axis=1)
    # The time of a crossing is known to a rounding of the whole step that was tried, up to 1 s.
    degrees = np.arange(1, order + 1)
    speed = np.abs(degrees * series[:, 1:] * length ** (degrees - 1)).sum(axis=1)
    slack = 4e-15 * np.abs(series * length ** np.arange(order + 1)).sum(axis=1) + 4e-16 * speed
    lo, hi = -s["j_1"] - slack, s["j_2"] + slack
    in_gap, above, below = (low >= lo) & (high <= hi), low >= hi - 2 * slack, high <= lo + 2 * slack
    is_inside = in_gap | above | below
    assert is_inside.all(), result.steps[~is_inside][0]


@given(**SCENES)
def test_e23_contacts_alternate_and_point_the_right_way(
    K_c, j_1, j_2, alpha, forcing, omega, x_0, v_0, rtol
):
    result = integrate(
        zeta=0.03,
        omega_n=5.0,
        mass=3.0,
        alpha=alpha,
        forcing=forcing,
        K_c=K_c,
        j_1=j_1,
        j_2=j_2,
        omega=omega,
        x_0=x_0,
        v_0=v_0,
        t_end=1.0,
        record_from=0.0,
        rtol=rtol,
        x_bound=10.0,
    )
    assert result.status[0] in (kernel.OK, kernel.DIVERGED)
    contacts = result.events(0, *CONTACTS)
    for wall, enter, leave, sign in (
        (j_2, record.ENTER_UPPER, record.LEAVE_UPPER, 1),
        (-j_1, record.ENTER_LOWER, record.LEAVE_LOWER, -1),
    ):
        own = contacts[np.isin(contacts[:, 3], (enter, leave))]
        assert (own[:, 1] == wall).all()
        assert (np.diff(own[:, 3] == enter) != 0).all()
        assert (own[own[:, 3] == enter, 2] * sign >= 0).all()
        assert (own[own[:, 3] == leave, 2] * sign <= 0).all()
    assert len(contacts) == result.n_contacts[0]


def safe_velocity_zeros(length, series):
    """Zeros of a step's velocity, as parts of the step, by eigenvalues of the companion matrix.

    None if rounding may decide where one lies: next to another, to the step's ends, or in a motion
    of the smallest numbers, which have no digits.
    """
    terms = series[1:] * np.arange(1, len(series)) * length ** np.arange(len(series) - 1)
    size = np.abs(terms).sum()
    if length < 1e-8 or size < 1e-290:
        return None
    zeros = np.roots(terms[::-1] / size)
    zeros = zeros[(np.abs(zeros.imag) < 1e-4) & (np.abs(zeros.real - 0.5) < 0.5 + 1e-4)]
    real = np.sort(zeros.real)
    is_safe = (zeros.imag == 0).all() and (np.abs(real - 0.5) < 0.5 - 1e-4).all()
    return real if is_safe and (np.diff(real) > 1e-4).all() else None


def check_extrema(result, point):
    """Compare the recorded extrema with each step's zeros; the share of steps that are safe."""
    extrema, n_checked = result.events(point, *EXTREMA), 0
    steps = result.steps[result.steps[:, 0] == point]
    for _, start, length, *series in steps:
        expected = safe_velocity_zeros(length, np.array(series))
        if expected is None:
            continue
        part = (extrema[:, 0] - start) / length
        is_own = np.abs(part - 0.5) < 0.5 - 1e-5
        assert len(part[is_own]) == len(expected)
        assert np.allclose(part[is_own], expected, rtol=0.0, atol=1e-7)
        x = np.polynomial.polynomial.polyval(expected * length, series)
        size = np.abs(series) @ length ** np.arange(len(series))
        assert np.allclose(extrema[is_own, 1], x, rtol=0.0, atol=1e-13 * size)
        n_checked += 1
    turns = extrema[extrema[:, 3] != record.INFLECTION]
    assert (np.diff(turns[:, 3]) != 0).all()  # a maximum follows a minimum: none lost between steps
    return n_checked / len(steps)


@given(order=st.sampled_from([8, 12, 16, 20]), zeta=st.sampled_from([1e-3, 0.03, 0.5]), **SCENES)
def test_extrema_are_the_zeros_of_each_steps_velocity(order, rtol, **changes):
    # the tolerance of a lower order makes long steps, with several zeros and series that are wild
    s = scene(**changes)
    check_extrema(
        run(1.0, s, rtol=rtol, order=order, record_from=0.0, dense_output=True, x_bound=10.0), 0
    )


@pytest.mark.parametrize("rtol", [1e-6, 1e-9, 1e-12])
def test_extrema_of_usual_motions_are_the_zeros_of_each_steps_velocity(rtol):
    points = {k: a[:24] for k, a in many(seed=11).items()}
    result = integrate(**points, rtol=rtol, record_from=0.0, dense_output=True)
    shares = [check_extrema(result, p) for p in range(len(result.x))]
    assert np.mean(shares) > 0.95  # the comparison with numpy leaves next to nothing out


@pytest.mark.parametrize("tangent", [False, True])
def test_recording_and_dense_output_do_not_change_the_motion_of_any_lane(batch, tangent):
    points, recorded = batch
    plain = integrate(**points, tangent=tangent)
    # some lanes record from the start, some late, some never
    begin = np.resize([0.0, 0.5, np.inf], len(plain.x))
    mixed = integrate(**points, tangent=tangent, record_from=begin, dense_output=True)
    for other in (recorded, mixed):
        assert same_bits([plain.x, plain.v, plain.t], [other.x, other.v, other.t])
        assert np.array_equal(plain.n_steps, other.n_steps)
        assert np.array_equal(plain.n_contacts, other.n_contacts)
    for i, t in enumerate(begin):
        events = recorded.events(i)
        assert same_bits(mixed.events(i), events[events[:, 0] >= t])


def test_slow_forcing_with_hard_ringing_records_every_turn():
    s = scene(K_c=1.4e6, omega=0.5, zeta=0.002, v_0=0.05)
    result = run(4.0, s, rtol=1e-6, record_from=0.0, dense_output=True)
    t = np.linspace(1e-6, 4.0 - 1e-6, 400_001)
    v = result.sample(t)[1][0]
    at = np.flatnonzero(v[:-1] * v[1:] < 0)
    extrema = result.events(0, *EXTREMA)
    assert len(extrema) == len(at) > 100
    assert ((extrema[:, 0] >= t[at]) & (extrema[:, 0] <= t[at + 1])).all()
    assert np.array_equal(extrema[:, 3] == record.MAXIMUM, v[at] > 0)


def test_rows_are_put_in_the_order_of_their_points():
    rng = np.random.default_rng(5)
    rows = np.column_stack([rng.integers(0, 200_000, 300_000), np.arange(300_000)]).astype(float)
    pieces = [rows[:100], rows[100:100], rows[100:]]
    assert np.array_equal(_by_point(pieces, 200_000), rows[np.argsort(rows[:, 0], kind="stable")])


def test_bad_input_is_named():
    for name, value in (
        ("omega", 0.0),
        ("mass", -1.0),
        ("j_1", -1e-3),
        ("x_0", np.nan),
        ("K_c", np.inf),
        ("rtol", 1.0),
    ):
        with pytest.raises(ValueError, match="start" if name == "x_0" else name):
            run(1.0, **{name: value})


def test_a_motion_that_fails_leaves_the_sections_of_the_others_alone():
    """Their rows stand beside each other: those that it never passed are left out."""
    points = scene(omega=np.array([9.0, 7.0, 11.0]), v_0=np.array([0.0, 2.0, 0.01]))
    found = integrate(**points, t_end=2.0, record_from=0.5, x_bound=5e-3)
    assert found.status.tolist() == [kernel.OK, kernel.DIVERGED, kernel.OK]
    assert len(found.events(1, record.SECTION)) == 0
    for i in (0, 2):
        alone = {k: np.broadcast_to(a, 3)[i] for k, a in points.items()}
        one = integrate(**alone, t_end=2.0, record_from=0.5)
        assert same_bits(found.events(i, record.SECTION), one.events(0, record.SECTION))
        expected = np.floor(2.0 * alone["omega"]) - np.ceil(0.5 * alone["omega"]) + 1
        assert len(one.events(0, record.SECTION)) == expected


def test_section_points_are_the_same_with_places_and_without(monkeypatch):
    points = {k: a[:20] for k, a in many().items()}
    placed = integrate(**points, record_from=0.5)
    monkeypatch.setattr(exact, "_MOST_PLACED", 0)
    drained = integrate(**points, record_from=0.5)
    assert len(placed.sections) > 100
    assert same_bits(placed.sections, drained.sections)


def test_a_motion_that_fails_needs_no_room_for_what_it_never_reached():
    found = integrate(**scene(alpha=-7e8, x_0=5e-3), t_end=1e9, record_from=0.0)
    assert found.status[0] == kernel.DIVERGED
    assert len(found.sections) == 0


@pytest.mark.parametrize("t_0", [0.0, 0.37])
@pytest.mark.parametrize("j_2", [0.0, 4e-4])
def test_time_in_contact_is_that_beyond_the_walls(j_2, t_0):
    """Starts in the gap, beyond either wall and on one; also without a gap between the walls."""
    x_0 = np.array([0.0, 1e-3, -1e-3, j_2])
    points = scene(x_0=x_0, j_1=0.0, j_2=j_2, K_c=1.4e5)
    found = integrate(**points, t_0=t_0, t_end=t_0 + 2.0, record_from=t_0, dense_output=True)
    times = np.linspace(t_0, t_0 + 2.0, 100_001)
    x, _ = found.sample(times)
    beyond = ((x > j_2) | (x < 0.0)).mean(axis=1) * 2.0
    assert np.abs(found.contact_time[:, 0] - beyond).max() < 1e-3
    unlisted = integrate(**points, t_0=t_0, t_end=t_0 + 2.0, record_from=t_0, contacts=False)
    assert len(unlisted.contacts) == 0
    assert same_bits(unlisted.contact_time, found.contact_time)


def test_no_points_are_no_work():
    result = integrate(**scene(omega=np.empty(0)), t_end=1.0, record_from=0.0, dense_output=True)
    assert len(result.x) == len(result.turns) == 0
