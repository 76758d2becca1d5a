"""Measured force tables: the curve, motions on it, its range, refusals."""

import json
import math
from contextlib import nullcontext

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.interpolate import PchipInterpolator
from tests.builders.studies import PAPER

import gapsweep as gs
from gapsweep.analysis.bench.references import motion
from gapsweep.analysis.bench.scenarios import Scenario
from gapsweep.execution.assemble import attributes_of
from gapsweep.execution.layout import Layout
from gapsweep.integrate.problem import Solver
from gapsweep.model.systems import paper_oscillator
from gapsweep.pipeline import plan
from gapsweep.response.loads import largest_forces

X = (-3e-3, -1e-3, -0.4e-3, 0.4e-3, 1e-3, 2e-3)
F = (-40.0, -9.0, 0.0, 0.0, 8.0, 30.0)
GAP = gs.Gap(0.4e-3, 0.4e-3)
TIGHT = {"rtol": 1e-11, "atol": 1e-14}


def sampled(law, n, reach=4e-3):
    """A table of a law's force, walls among its points."""
    x = np.union1d(np.linspace(-reach, reach, n), [-law.gap.j_1, law.gap.j_2])
    return gs.ForceTable(x, law.force(x))


def test_the_curve_is_the_monotone_cubic_of_scipy():
    table, curve = gs.ForceTable(X, F), PchipInterpolator(X, F)
    x = np.linspace(X[0], X[-1], 3001)
    assert_allclose(table.force(x), curve(x), atol=1e-12)
    assert_allclose(table.derivative(x), curve.derivative()(x), atol=1e-8)
    assert np.all(np.diff(table.force(x)) >= 0.0)
    assert not table.force(np.linspace(-0.4e-3, 0.4e-3, 101)).any()


def test_it_goes_on_straight_beyond_its_ends():
    table = gs.ForceTable(X, F)
    for end, d in ((X[0], -1e-3), (X[-1], 1e-3)):
        expected = table.force(end) + d * table.derivative(end)
        assert table.force(end + d) == pytest.approx(expected, rel=1e-12)
        assert table.derivative(end + d) == pytest.approx(table.derivative(end), rel=1e-12)


@pytest.mark.parametrize(
    ("x", "forces", "j_1", "j_2"),
    [
        (X, F, 0.4e-3, 0.4e-3),
        ((-1e-3, 0.0, 2e-3), (0.0, 0.0, 5.0), 1e-3, 0.0),
        ((-1e-3, 0.0, 2e-3), (-1.0, 0.1, 5.0), 0.0, 0.0),
        ((-1e-3, 1e-3, 2e-3), (-1.0, 0.0, 5.0), 0.0, 0.0),  # zero lies on a slope
        ((0.0, 1e-3, 2e-3), (0.0, 0.0, 5.0), 0.0, 1e-3),
    ],
)
def test_walls_stand_where_the_force_begins(x, forces, j_1, j_2):
    assert gs.ForceTable(x, forces).gap == gs.Gap(j_1, j_2)


def test_walls_may_be_given_for_a_table_with_noise():
    noisy = gs.ForceTable((-2e-3, 0.0, 0.5e-3, 2e-3), (-9.0, 0.01, -0.02, 9.0), gap=GAP)
    assert noisy.gap == GAP
    assert noisy.K_c == pytest.approx(9.0 / 1.6e-3)


def test_a_pair_of_numbers_is_a_gap():
    assert gs.ForceTable(X, F, gap=(4e-4, 4e-4)) == gs.ForceTable(X, F, gap=GAP)
    assert gs.Tanh(1e4, [4e-4, 4e-4], 1e4) == gs.Tanh(1e4, GAP, 1e4)


def test_noise_around_zero_is_set_to_zero_and_nothing_else():
    x = np.linspace(-2e-3, 2e-3, 81)
    wall, noise = 1e4 * np.clip(np.abs(x) - 4e-4, 0.0, None), 0.3
    forces = np.sign(x) * wall + noise * np.cos(np.arange(81.0))
    quiet = gs.ForceTable(x, forces, noise=noise)
    at_walls = np.abs(x) < 4e-4 + 2.0 * noise / 1e4  # where the force may be less than the noise
    assert not quiet.force(x[np.abs(x) <= 4e-4]).any()
    assert_allclose(quiet.force(x[~at_walls]), forces[~at_walls])
    assert 4e-4 <= quiet.gap.j_1 <= 4e-4 + 2.0 * noise / 1e4 + 5e-5
    assert gs.ForceTable(x, forces).gap == gs.Gap(0.0, 0.0)


def test_its_numbers_are_its_identity():
    assert gs.ForceTable(X, F) == gs.ForceTable(list(X), np.array(F))
    assert hash(gs.ForceTable(X, F)) == hash(gs.ForceTable(X, F))
    assert gs.ForceTable(X, F) != gs.ForceTable(X, (*F[:-1], 31.0))


def test_it_is_symmetric_if_its_points_are():
    x, forces = (-1e-3, -0.5e-3, 0.5e-3, 1e-3), (-4.0, 0.0, 0.0, 4.0)
    assert gs.ForceTable(x, forces).is_symmetric
    assert not gs.ForceTable(x, (-4.1, 0.0, 0.0, 4.0)).is_symmetric


def rhs(o, curve, omega):
    def f(t, y):
        springs = o.omega_n_rad**2 * y[0] + o.alpha / o.mass * y[0] ** 3 + curve(y[0]) / o.mass
        drive = o.forcing / o.mass * math.cos(2.0 * math.pi * omega * t)
        return y[1], drive - 2.0 * o.zeta * o.omega_n_rad * y[1] - springs

    return f


@pytest.mark.parametrize("engine", ["compiled", "scipy"])
def test_motions_are_those_on_scipys_curve(engine):
    o = paper_oscillator()
    rng = np.random.default_rng(5)
    x = np.concatenate([[-4e-3], np.sort(rng.uniform(-3e-3, 3e-3, 9)), [4e-3]])
    forces = np.sort(rng.normal(0.0, 20.0, x.size))
    curve = PchipInterpolator(x, forces)
    start = [1e-4, 0.03]
    truth = solve_ivp(
        rhs(o, curve, 7.0), (0.0, 0.5), start, method="DOP853", rtol=1e-12, atol=1e-15
    )
    found = gs.simulate(
        o, gs.ForceTable(x, forces), 7.0, *start, t_end=0.5, engine=engine, tangent=True, **TIGHT
    )
    assert found.status == gs.Status.OK
    assert_allclose([found.x_end, found.v_end], truth.y[:, -1], atol=1e-9, rtol=1e-7)
    shrinks = math.exp(-2.0 * o.zeta * o.omega_n_rad * 0.5)
    assert np.linalg.det(found.monodromy) == pytest.approx(shrinks, rel=1e-6)


@pytest.mark.parametrize(
    ("law", "gain"), [(gs.Tanh(1.4e4, GAP, 5e3), 6.0), (gs.Piecewise(1.4e4, GAP), 3.0)]
)
def test_a_finer_table_of_a_law_comes_closer_to_it(law, gain):
    """With the third order of its points' distance, at a corner with the second."""
    o, omega = paper_oscillator(), np.linspace(5.0, 12.0, 16)
    truth = gs.simulate(o, law, omega, t_end=0.5, **TIGHT)
    coarse, middle, fine = (
        np.abs(gs.simulate(o, sampled(law, n), omega, t_end=0.5, **TIGHT).x_end - truth.x_end).max()
        for n in (321, 641, 1281)
    )
    assert fine < middle / gain < coarse / gain**2
    assert fine < 1e-6


def test_its_walls_are_passed_as_often_as_those_of_its_law():
    law, o = gs.Piecewise(1.4e4, GAP), paper_oscillator()
    exact = gs.simulate(o, law, 9.0, t_end=2.0)
    found = gs.simulate(o, sampled(law, 2001), 9.0, t_end=2.0)
    assert found.n_contacts == exact.n_contacts > 20
    assert_allclose(found.t_contacts, exact.t_contacts, atol=1e-4)


@pytest.mark.parametrize("engine", ["compiled", "scipy"])
def test_a_motion_is_judged_by_the_end_that_it_passes(engine):
    """The table ends at -3 mm and at 2 mm."""
    free = paper_oscillator(alpha=0.0, forcing=0.0)
    table, options = gs.ForceTable(X, F), {"t_end": 0.01, "engine": engine}
    ends = {
        x_0: gs.simulate(free, table, 9.0, x_0, **options).status
        for x_0 in (-2.9e-3, -3.1e-3, 1.9e-3, 2.1e-3)
    }
    assert ends[-2.9e-3] == ends[1.9e-3] == gs.Status.OK
    assert ends[-3.1e-3] == ends[2.1e-3] == gs.Status.OUT_OF_FIT_RANGE


@pytest.mark.parametrize("engine", ["compiled", "scipy"])
def test_a_fit_is_left_alike_in_both_engines(engine):
    """With tenfold the speed it goes farther than the fit reaches."""
    free, law = (
        paper_oscillator(alpha=0.0, forcing=0.0),
        gs.Polynomial(1.4e4, GAP, 5, 1e-3),
    )
    ends = [
        gs.simulate(free, law, 9.0, 0.0, v_0, t_end=0.1, engine=engine).status
        for v_0 in (0.03, 0.3)
    ]
    assert ends == [gs.Status.OK, gs.Status.OUT_OF_FIT_RANGE]


def test_a_response_beyond_the_table_says_so():
    o, omega = paper_oscillator(), 9.0
    whole = gs.respond(o, gs.ForceTable(X, F), omega)
    assert whole.status == gs.Status.OK
    reach = 0.5 * (0.4e-3 + whole.x_max)
    short = gs.ForceTable((*X[:4], reach), (*F[:4], gs.ForceTable(X, F).force(reach)))
    assert gs.respond(o, short, omega).status == gs.Status.OUT_OF_FIT_RANGE


@pytest.mark.parametrize(("x_min", "x_max"), [(-1e-4, 1e-3), (-1e-4, 0.4e-3), (-1e-4, 0.2e-3)])
def test_the_largest_force_may_lie_at_a_point_of_the_table(x_min, x_max):
    table = gs.ForceTable((-4e-3, 0.0, 0.3e-3, 0.6e-3, 4e-3), (-40.0, 0.0, 14.0, 1.0, 20.0))
    (found,) = largest_forces([table], np.array([x_min]), np.array([x_max]))
    passed = np.abs(table.force(np.linspace(x_min, x_max, 100_001)))
    assert found == pytest.approx(passed.max(), rel=1e-6)


def test_company_changes_no_bit():
    o, omega = paper_oscillator(), np.linspace(5.0, 12.0, 19)
    together = gs.simulate(o, gs.ForceTable(X, F), omega, t_end=1.0)
    for k in (0, 7, 18):
        alone = gs.simulate(o, gs.ForceTable(X, F), omega[k], t_end=1.0)
        assert (alone.x_end, alone.v_end, alone.n_steps) == (
            together.x_end[k],
            together.v_end[k],
            together.n_steps[k],
        )


@pytest.mark.parametrize(
    ("x", "forces", "said"),
    [
        ([0.0], [0.0], r"x: has the shape \(1,\), must be one column of 2 to 10000 numbers"),
        ([[0.0, 1.0]], [0.0, 1.0], r"x: has the shape \(1, 2\), must be one column"),
        ([0.0, "a"], [0.0, 1.0], r"x = .*: must be a list of numbers"),
        ([0.0, 1.0], [0.0, math.nan], r"F\[1\] = nan: must be finite; leave it out"),
        ([0.0, 1.0], [0.0, 1.0, 2.0], r"F: has 3 numbers, x has 2: must be one for each"),
        ([0.0, 1.0, 1.0], [0.0, 1.0, 2.0], r"x\[2\] = 1: must be > x\[1\] = 1; sort the table"),
        ([1.0, 0.0], [1.0, 0.0], r"x\[1\] = 0: must be > x\[0\] = 1; sort the table"),
        ([1.0, 2.0], [0.0, 1.0], r"x: goes from 1 to 2 m, must hold 0; add the points"),
    ],
)
def test_a_bad_table_is_refused_with_a_remedy(x, forces, said):
    with pytest.raises(gs.ModelError, match=said):
        gs.ForceTable(x, forces)


def test_walls_must_be_a_gap():
    with pytest.raises(gs.ModelError, match=r"gap = 0.001: must be the distances"):
        gs.ForceTable(X, F, gap=1e-3)


def test_a_plateau_is_a_turn():
    """Nothing of it is lost where the force rises, stays and falls."""
    table = gs.ForceTable([-1.0, 0.0, 1.0, 2.0, 3.0], [0.0, 0.0, 1.0, 1.0, 0.0])
    assert {1.0, 2.0} <= {*table.turns}
    (largest,) = largest_forces([table], np.array([0.0]), np.array([3.0]))
    assert largest == 1.0


@given(st.lists(st.integers(-3, 3), min_size=3, max_size=12))
def test_the_largest_force_is_that_of_a_fine_grid(forces):
    x = np.arange(len(forces)) - 1.0
    table = gs.ForceTable(x, np.array(forces, float))
    fine = np.abs(table.force(np.linspace(x[0], x[-1], 1001))).max()
    (largest,) = largest_forces([table], x[:1], x[-1:])
    assert largest == pytest.approx(max(fine, np.abs(forces).max()), abs=1e-9)


@pytest.mark.parametrize(("x_0", "is_ok"), [(-2.5e-3, True), (1.9e-3, True), (2.1e-3, False)])
def test_a_benchmark_knows_both_ends_of_a_table(x_0, is_ok):
    table = gs.ForceTable([-1.0, -0.4e-3, 0.4e-3, 2.0e-3], [0.0, 0.0, 0.0, 24.5])
    scene = Scenario(
        name="stop", oscillator=paper_oscillator(forcing=0.0), K_c=1.0, gap=GAP, omega=9.0,
        x_0=x_0, v_0=0.0, n_periods=1, expected=None, fit_range=4e-3, without=(),
    )  # fmt: skip
    found = motion(scene, table, Solver.of())
    assert found.status == (gs.Status.OK if is_ok else gs.Status.OUT_OF_FIT_RANGE)


MODULE = """
from pathlib import Path

import gapsweep as gs
import numpy as np

__data__ = ["measured.csv"]
spring = gs.ForceTable(*np.loadtxt(Path(__file__).with_name("measured.csv"), delimiter=",").T)
"""


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """A module with a table that it reads from a file beside it; the file."""
    (tmp_path / "bench_spring.py").write_text(MODULE)
    file = tmp_path / "measured.csv"
    np.savetxt(file, np.transpose([X, F]), delimiter=",")
    monkeypatch.syspath_prepend(tmp_path)
    return file


def test_a_label_names_a_table_of_a_module(bench):
    law = gs.contact_law("bench_spring:spring", 1.0, gs.Gap(1e-4, 2e-4))
    assert (law.x, law.F, law.gap) == (X, F, gs.Gap(1e-4, 2e-4))


@pytest.mark.parametrize(
    ("factor", "gap", "is_odd"),
    [
        (1.0, [4e-4, 4e-4], False),
        (1e3, [4e-4, 4e-4], True),  # the table in mm
        (1.0, [0.4, 0.4], True),  # the gap in mm
        (1.0, [4e-4, 1.0], False),  # a wall that is out of reach
        (1e3, [0.0, 0.0], True),
    ],
)
def test_a_table_in_another_unit_than_the_gap_is_warned_of(tables, bench, factor, gap, is_odd):
    np.savetxt(bench, np.transpose([np.multiply(X, factor), F]), delimiter=",")
    tables["sweep"][0] |= {"representation": ["bench_spring:spring"], "gap": gap}
    study = gs.Study.from_dict(tables)
    nearest = 0.4 if factor == 1.0 else 1e3 * min(abs(x) for x in X if x)
    said = f"gap = {nearest:g} m: "
    warned = pytest.warns(UserWarning, match=said) if is_odd else nullcontext()
    with warned:
        plan(study)


def test_noise_in_the_gap_is_warned_of(tables, bench):
    x = np.linspace(-2e-3, 2e-3, 41)
    forces = np.interp(x, X, F) + 0.2 * np.cos(2.0 * np.arange(41))
    np.savetxt(bench, np.transpose([x, forces]), delimiter=",")
    tables["sweep"][0] |= {"representation": ["bench_spring:spring"]}
    with pytest.warns(UserWarning, match="measurement noise"):
        plan(gs.Study.from_dict(tables))


def test_a_study_of_tables_needs_no_walls(tables, bench):
    block = tables["sweep"][0]
    block["representation"] = ["bench_spring:spring"]
    del block["K_c"], block["gap"]
    study = gs.Study.from_dict(tables)
    law = study.law("bench_spring:spring", study.grid.axes["K_c"][0], study.grid.gaps[0])
    assert law == gs.ForceTable(X, F)
    block["representation"].append("piecewise")
    with pytest.raises(gs.StudyError, match=r"K_c: missing"):
        gs.Study.from_dict(tables)


def test_contacts_of_a_system_that_are_tables_need_no_walls(tables, bench):
    block = tables["sweep"][0] | {"representation": ["bench_spring:spring"], "omega": [9.0]}
    del block["K_c"], block["gap"]
    tables["system"] = {
        "mass": [[3.0, 0.0], [0.0, 1.0]], "stiffness": [[3e3, 0.0], [0.0, 1e3]],
        "contacts": {"a": [1.0, 0.0], "b": [1.0, -1.0]}, "forcing": [{"amplitude": [1.0, 0.0]}],
    }  # fmt: skip
    del tables["oscillator"]
    study = gs.Study.from_dict(tables | {"sweep": [block]})
    ((_, points),) = study.points(np.arange(study.grid.requested.size))
    numbers = dict(zip(points.kind.numbers, points.numbers[0].tolist(), strict=True))
    assert [numbers[name] for name in numbers if "K_c" in name] == [0.0, 0.0]
    law = study.law("bench_spring:spring", 0.0, gs.Gap(0.0, 0.0))
    assert law == gs.ForceTable(X, F)
    tables["contact"] = {"b": {"representation": "piecewise"}}
    with pytest.raises(gs.StudyError, match=r"K_c: missing.*contact 'b' needs"):
        gs.Study.from_dict(tables | {"sweep": [block]})


CSV = {
    "commas and a head": "x,F\n{}",
    "blanks": "# measured\n\n{}",
    "semicolons": "x [mm]; F [kN]\n{}\n",
}


@pytest.mark.parametrize("name", CSV)
def test_a_file_is_a_table_in_its_units(name, tmp_path):
    between = {"commas and a head": ",", "blanks": "  ", "semicolons": "; "}[name]
    rows = [f"{1e3 * x!r}{between}{1e-3 * f!r}{between}7" for x, f in zip(X, F, strict=True)]
    (tmp_path / "stop.csv").write_text(CSV[name].format("\n".join(rows)))
    found = gs.ForceTable.from_csv(tmp_path / "stop.csv", x="mm", force="kN", gap=GAP)
    assert_allclose([found.x, found.F], [X, F], rtol=1e-12)
    assert found.gap == GAP


@pytest.mark.parametrize(
    ("title", "x", "force"),
    [
        ("x [mm], F [kN]", 1e-3, 1e3),
        ("x_mm, F_N", 1e-3, 1.0),
        ("angle [deg], torque [N m]", math.pi / 180.0, 1.0),
    ],
)
def test_titles_of_a_file_have_its_units(title, x, force, tmp_path):
    path = tmp_path / "stop.csv"
    path.write_text(f"{title}\n-2, -30\n0, 0\n2, 40\n")
    found = gs.ForceTable.from_csv(path)
    assert_allclose(found.x, [-2.0 * x, 0.0, 2.0 * x], rtol=1e-12)
    assert_allclose(found.F, [-30.0 * force, 0.0, 40.0 * force], rtol=1e-12)


def test_titles_of_a_file_and_arguments_with_different_units_are_refused(tmp_path):
    path = tmp_path / "stop.csv"
    path.write_text("x [mm], F [N]\n-2, -30\n0, 0\n2, 40\n")
    with pytest.raises(gs.ModelError, match=r"'x \[mm\]': has another unit than the argument x"):
        gs.ForceTable.from_csv(path, x="m")
    path.write_text("x [N], F [N]\n-2, -30\n0, 0\n2, 40\n")
    with pytest.raises(gs.ModelError, match=r"'x \[N\]': x = '1 N': must be"):
        gs.ForceTable.from_csv(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x,F\n1,2\n3,a\n", "line 3: 3,a: must have a finite number in column 2"),
        ("0,1\n\n2\n", "line 3: 2: must have a finite number in column 2"),
        ("x,F\n", "no line with a number"),
        ("x,F\n0,0\n1,nan\n", "line 3: 1,nan: must have a finite number in column 2"),
        ("1,1\n2,2\n", "must hold 0"),
        ("x;F\n-1,5;-8,0\n0,0;0,0\n1,5;8,0\n", "line 2: -1,5;-8,0: must .* decimal points"),
        ("-1,5\t-8,0\n1,5\t8,0\n", "line 1: .*: must .* decimal points"),
        (None, "cannot be read"),
    ],
)
def test_a_file_that_is_no_table_is_refused(text, said, tmp_path):
    path = tmp_path / "stop.csv"
    if text is not None:
        path.write_text(text)
    with pytest.raises(gs.ModelError, match=said):
        gs.ForceTable.from_csv(path)


def test_a_file_in_place_of_points_names_the_way_to_read_it(tmp_path):
    with pytest.raises(gs.ModelError, match=r"write .*gs\.ForceTable\.from_csv\('stop.csv'"):
        gs.ForceTable("stop.csv")
    with pytest.raises(gs.ModelError, match="x = 'cm': must be a unit: m, mm"):
        gs.ForceTable.from_csv("stop.csv", x="cm")
    for path in (None, "stop\0.csv"):
        with pytest.raises(gs.ModelError, match="cannot be read"):
            gs.ForceTable.from_csv(path)
    with pytest.raises(gs.ModelError, match=r"force = \['N'\]: must be a unit: N, mN"):
        gs.ForceTable.from_csv("stop.csv", force=["N"])


def test_a_label_names_a_file_and_the_unit_of_its_displacements(tables, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rows = [f"{1e3 * x!r}, {f!r}" for x, f in zip(X, F, strict=True)]
    (tmp_path / "stop.csv").write_text("\n".join(rows))
    block = {"representation": "stop.csv:mm", "omega": [12.0]}
    study = gs.Study.from_dict(tables | {"sweep": [block]})
    law = study.law("stop.csv:mm", 0.0, gs.Gap(0.0, 0.0))
    assert_allclose([law.x, law.F], [X, F], rtol=1e-12)
    ((_, points),) = study.points(np.arange(1))
    assert points.kind.law_code == study.own_law("stop.csv:mm").key
    wrong = gs.Study.from_dict(tables | {"sweep": [block | {"representation": "stop.csv:cm"}]})
    with pytest.raises(gs.ModelError, match="must be a unit"):
        wrong.points(np.arange(1))


@pytest.mark.parametrize("engine", ["compiled", "scipy"])
def test_a_study_of_a_table_has_the_numbers_of_respond(client, tables, bench, tmp_path, engine):
    tables["sweep"][0] |= {"representation": ["bench_spring:spring"], "omega": [12.0, 20.0]}
    tables["oscillator"], tables["solver"] = PAPER | {"zeta": 0.3}, {"engine": engine}
    study, steady = gs.Study.from_dict(tables), gs.Steady(**tables["steady"])

    def asked():
        found = gs.query(study, client, cache=tmp_path / "c-cache")
        return found.attrs["n_hits"], found["x_max"].values.ravel()

    def expected(forces):
        law = gs.ForceTable(X, forces, GAP)
        return gs.respond(
            paper_oscillator(zeta=0.3), law, [12.0, 20.0], engine=engine, steady=steady
        ).x_max

    n_hits, peaks = asked()
    assert n_hits == 0
    np.testing.assert_array_equal(peaks, expected(F))
    assert asked()[0] == 2
    # Measured again: what is stored is of the old table.
    harder = tuple(2.0 * force for force in F)
    np.savetxt(bench, np.transpose([X, harder]), delimiter=",")
    n_hits, peaks = asked()
    assert n_hits == 0
    np.testing.assert_array_equal(peaks, expected(harder))


@pytest.mark.parametrize(("forces", "is_odd"), [((-5.0, 0.0, 5.0), True), (F, False)])
def test_only_a_table_that_is_odd_has_mirror_images(tables, bench, forces, is_odd):
    places = X if forces is F else (-1e-3, 0.0, 1e-3)
    np.savetxt(bench, np.transpose([places, forces]), delimiter=",")
    tables["sweep"][0]["representation"] = ["bench_spring:spring", "piecewise"]
    study = gs.Study.from_dict(tables)
    uneven = [] if study.own_law("bench_spring:spring").is_odd else ["bench_spring:spring"]
    layout = Layout.of(study.grid, study.steady, uneven=uneven)
    (piece,) = layout.pieces()
    found = layout.is_symmetric(piece).reshape(2, -1)
    assert (found[0] == is_odd).all()
    assert found[1].all()


def test_files_say_how_many_points_a_table_has_and_where_it_ends(tables, bench):
    label = "bench_spring:spring"
    tables["protocol"] = {"loose": {"rtol": 1e-5}}
    tables["sweep"][0]["representation"] = ["piecewise", label, f"{label}@loose"]
    held = json.loads(attributes_of(gs.Study.from_dict(tables))["tables_json"])
    assert held == {label: {"points": len(X), "low": X[0], "high": X[-1], "is_odd": False}}


def test_the_library_that_draws_the_curve_is_part_of_the_key(tables, bench):
    for label, has_scipy in (("bench_spring:spring", True), ("piecewise", False)):
        tables["sweep"][0]["representation"] = label
        ((_, points),) = gs.Study.from_dict(tables).points(np.arange(1))
        assert ("scipy" in json.loads(points.kind.identity)["versions"]) == has_scipy


def test_a_mistake_in_a_table_names_the_module_it_stands_in(bench):
    np.savetxt(bench, np.transpose([X[::-1], F]), delimiter=",")
    with pytest.raises(gs.ModelError, match=r"'bench_spring:spring': x\[1\] = .*must be > x\[0\]"):
        gs.contact_law("bench_spring:spring", 1.0, GAP)


def test_a_stop_below_only_is_the_mirror_image_of_one_above_only():
    above = gs.ForceTable([-1e-3, -4e-4, 4e-4, 1e-3], [0.0, 0.0, 0.0, 8.0])
    below = gs.ForceTable([-1e-3, -4e-4, 4e-4, 1e-3], [-8.0, 0.0, 0.0, 0.0])
    x = np.linspace(-1e-3, 1e-3, 101)
    np.testing.assert_allclose(below.exact.force(x), -above.exact.force(-x), atol=1e-9)
    np.testing.assert_allclose(gs.static_error(below, 1e-3), gs.static_error(above, 1e-3))


@pytest.mark.parametrize("line", ["-0,30;-60", "-300,5\t-60", "0,3 60,5", "-1;-60,5", "0\t60,5"])
def test_decimal_commas_of_a_file_are_refused_and_not_read_as_separators(line, tmp_path):
    path = tmp_path / "stop.csv"
    path.write_text(f"x;F\n{line}\n")
    with pytest.raises(gs.ModelError, match=r"stop\.csv: line 2: .*decimal points"):
        gs.ForceTable.from_csv(path)


@pytest.mark.parametrize("line", ["-0.3,-60", "-1,-60, 5", "-1 , -60", "-1,-60", "-1; -60"])
def test_separators_of_columns_are_no_decimal_commas(line, tmp_path):
    path = tmp_path / "stop.csv"
    path.write_text(f"{line}\n0.3, 60\n")
    assert gs.ForceTable.from_csv(path).F[0] == -60.0


def test_a_block_of_tables_lacks_no_stiffness_if_something_else_is_wrong(tmp_path):
    (tmp_path / "stop.csv").write_text("-0.3,-60\n0.3,60\n")
    (tmp_path / "study.toml").write_text(
        '[study]\nname = "t"\n[oscillator]\nmass = 1.0\nomega_n = 1.0\nforcing = 1.0\n'
        '[[sweep]]\nrepresentation = "stop.csv:mm"\nomega = 1.0\n'
    )
    with pytest.raises(gs.StudyError, match="zeta") as refused:
        gs.Study.load(tmp_path / "study.toml")
    assert "K_c" not in str(refused.value)
