"""Study files: expansion, canonical coordinates, keys, and all problems at once."""

import json
import math
import os
import re
import shutil

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from tests.builders.cache import all_keys, point
from tests.builders.studies import PAPER, TOML

import gapsweep as gs
from gapsweep.cli.options import selected
from gapsweep.explorer.first_question import of_model
from gapsweep.explorer.question import numbers as slider_numbers
from gapsweep.model.oscillator import OSCILLATOR
from gapsweep.report.inputs import Inputs
from gapsweep.report.sections import model as report_model
from gapsweep.study import points
from gapsweep.study.oscillator_table import OscillatorTable
from gapsweep.study.points import canonical
from gapsweep.study.schema import COORDINATES
from gapsweep.user_code import package_digest


def study_of(tables, **changes):
    return gs.Study.from_dict(tables | changes)


# Settings that exclude each other.
WRONG = {"engine": "scipy", "controller": "ode45"}


def problems(tables):
    with pytest.raises(gs.StudyError) as caught:
        gs.Study.from_dict(tables)
    return caught.value.problems


def is_halfway(value):
    digits = value / 10.0 ** (np.floor(np.log10(value)) - 11)
    return abs(digits % 1.0 - 0.5) < 0.05


@given(st.floats(0.01, 100.0), st.floats(1e-3, 10.0), st.integers(1, 50), st.integers(2, 7))
def test_refined_grids_contain_the_coarse_coordinates(start, step, n, factor):
    # Halfway between two roundings the last bit decides, and a point more is computed.
    places = [start + i * step for i in range(n + 1)]
    coarse = [canonical(place) for place in places if not is_halfway(place)]
    stop = start + n * step
    by_num = [canonical(start + i * ((stop - start) / (n * factor))) for i in range(n * factor + 1)]
    by_step = [canonical(start + i * (step / factor)) for i in range(n * factor + 1)]
    assert set(coarse) <= set(by_num)
    assert set(coarse) <= set(by_step)


@given(st.floats(-1e6, 1e6))
def test_canonical_is_idempotent_and_close(x):
    assert canonical(canonical(x)) == canonical(x)
    assert abs(canonical(x) - x) <= 5e-12 * abs(x)


@pytest.mark.parametrize(
    ("omega", "expected"),
    [
        ({"start": 0.1, "stop": 0.5, "step": 0.1}, [0.1, 0.2, 0.3, 0.4, 0.5]),
        ({"start": 1.0, "stop": 2.0, "num": 5}, [1.0, 1.25, 1.5, 1.75, 2.0]),
        ({"start": 1.0, "stop": 1.95, "step": 0.5}, [1.0, 1.5]),
        ([3.0, 1.0, 3.0], [1.0, 3.0]),
    ],
)
def test_frequency_grids_include_their_stop(tables, omega, expected):
    tables["sweep"][0]["omega"] = omega
    assert gs.Study.from_dict(tables).grid.omega == tuple(expected)


def test_dataset_is_the_union_of_the_blocks(tables):
    other = tables["sweep"][0] | {"K_c": [1.4e6], "representation": ["tanh-1e6"], "omega": [5.0]}
    study = study_of(tables, sweep=[*tables["sweep"], other])
    assert study.grid.shape == (4, 2, 1, 4, 1)
    assert study.grid.requested.sum() == 9 + 1
    assert study.grid.representations == ("piecewise", "tanh-1e4", "poly-13", "tanh-1e6")


def test_a_byte_order_mark_is_no_part_of_a_study(tmp_path):
    block = {"representation": "piecewise", "K_c": 1e4, "gap": [4e-4, 4e-4], "omega": 9.0}
    text = "".join(f"{name} = {json.dumps(value)}\n" for name, value in block.items())
    file = tmp_path / "s.toml"
    file.write_text(
        f'oscillator = {TOML}\n[study]\nname = "s"\n[[sweep]]\n{text}', encoding="utf-8-sig"
    )
    assert gs.Study.load(file).grid.K_c == (1e4,)


def test_labels_are_made_canonical(tables):
    tables["sweep"][0]["representation"] = ["tanh-10000", "tanh-1e4"]
    assert gs.Study.from_dict(tables).grid.representations == ("tanh-1e4",)


def test_protocol_overrides_the_solver(tables):
    tables["sweep"][0]["representation"] = ["piecewise", "piecewise@paper"]
    study = study_of(
        tables, solver={"rtol": 1e-8}, protocol={"paper": {"rtol": 1e-4, "atol": 1e-7}}
    )
    plain, paper = (point(study, r, 0, 0, 0, 0).kind.solver for r in (0, 1))
    assert (plain.rtol, plain.atol, paper.rtol, paper.atol) == (1e-8, None, 1e-4, 1e-7)
    assert point(study, 1, 0, 0, 0, 0).kind.representation == "piecewise"


def test_sobol_starts_are_reproducible_and_inside_their_box(tables):
    box = {"sobol": 12, "x": [-2e-3, 2e-3], "v": [-0.05, 0.05], "seed": 3}
    tables["sweep"][0]["initial_condition"] = box
    starts = gs.Study.from_dict(tables).grid.starts
    assert list(starts) == list(gs.Study.from_dict(tables).grid.starts)
    assert len(set(starts)) == 12
    assert all(abs(x_0) <= 2e-3 and abs(v_0) <= 0.05 for _, (x_0, v_0) in starts)


def test_sweeps_are_chains_in_their_own_direction(tables):
    down = tables["sweep"][0] | {"initial_condition": "sweep_down", "representation": ["piecewise"]}
    study = study_of(tables, sweep=[down])
    (block,) = study.plan(cache="none").blocks()
    assert [study.grid.omega[cell] for cell in block.cells] == [20.0, 12.0, 7.0]
    assert block.follows.tolist() == [False, True, True]


def test_numbers_in_the_order_of_computation_are_those_of_cells(tables):
    starts = [[0.0, 0.0], "sweep_down", "sweep_up"]
    (block,) = tables["sweep"]
    grid = study_of(tables, sweep=[block | {"initial_condition": starts, "zeta": [0.1, 0.2]}]).grid
    numbers = np.arange(grid.requested.size)
    cells = grid.cells(numbers)
    assert np.array_equal(np.sort(cells), numbers)
    assert np.array_equal(grid.numbers(cells), numbers)
    _, _, _, omega, zeta, start = np.unravel_index(cells, grid.shape)
    n = len(grid.omega)
    assert omega[: 3 * n].tolist() == [0, 1, 2, 2, 1, 0, 0, 1, 2]
    assert start[: 3 * n : n].tolist() == [0, 1, 2]
    assert zeta[: 6 * n : 3 * n].tolist() == [0, 1]


def test_a_plan_without_a_cache_computes_keys_of_one_block(tables, monkeypatch):
    n_keys, keys = [], points.Points.keys

    def counted(table, follows=None):
        n_keys.append(len(table))
        return keys(table, follows)

    monkeypatch.setattr(points.Points, "keys", counted)
    omega = {"start": 1.0, "stop": 30.0, "num": 1000}
    (block,) = tables["sweep"]
    block |= {"representation": ["piecewise"], "omega": omega, "K_c": omega | {"num": 100}}
    planned = study_of(tables, sweep=[block]).plan(cache="none")
    assert (planned.n_points, planned.n_missing, len(planned.ends)) == (10**5, 10**5, 7)
    assert sum(n_keys) <= 16384
    assert sorted(number for one in planned.blocks() for number in one.numbers.tolist()) == [
        *range(10**5)
    ]


def test_a_list_of_starts_is_a_block_for_each(tables):
    box = {"sobol": 4, "x": [-1e-3, 1e-3], "v": [-0.1, 0.1]}
    forms = [[[0.0, 0.0], [1e-3, 0.0]], box, "sweep_up", "sweep_down"]
    (block,) = tables["sweep"]
    together = [*forms[0], *forms[1:]]
    several = study_of(tables, sweep=[block | {"initial_condition": together}])
    apart = study_of(tables, sweep=[block | {"initial_condition": form} for form in forms])
    assert list(several.grid.starts) == list(apart.grid.starts)
    assert all_keys(several) == all_keys(apart)
    assert several.spec.sweep[0].count == sum(one.count for one in apart.spec.sweep)
    wrong = ["up", 5.0, {"sobol": 0, "x": [0.0, 1.0], "v": [0.0, 1.0]}]
    found = problems(tables | {"sweep": [block | {"initial_condition": wrong}]})
    for words in (
        "[0] = 'up': must be 'sweep_up' or 'sweep_down'",
        "[1] = 5.0: must be",
        "[2].sobol = 0: must be >= 1",
    ):
        assert any(f"sweep[0].initial_condition{words}" in one for one in found), found


def test_key_of_a_sweep_point_depends_on_the_points_before_it(tables):
    block = tables["sweep"][0] | {"initial_condition": "sweep_up", "representation": ["piecewise"]}
    before = all_keys(study_of(tables, sweep=[block])).values()
    longer = study_of(tables, sweep=[block | {"omega": [6.0, 7.0, 12.0, 20.0]}])
    assert not set(before) & set(all_keys(longer).values())


def test_keys_ignore_how_a_study_is_written(tables):
    block = tables["sweep"][0]
    rewritten = {
        "oscillator": PAPER,
        "sweep": [block | {"omega": [20, 12, 7], "K_c": [14000], "representation": [label]}
                  for label in ("poly-013", "piecewise", "tanh-10000")],
        "study": {"name": "other", "title": "another title"},
        "steady": tables["steady"],
    }  # fmt: skip
    assert set(all_keys(study_of(tables)).values()) == set(all_keys(study_of(rewritten)).values())


@pytest.mark.parametrize(
    ("table", "change"),
    [
        ("oscillator", {"zeta": 0.031}),
        ("oscillator", {"forcing": -4.0}),
        ("solver", {"rtol": 1e-5}),
        ("solver", {"atol": 1e-12}),
        ("solver", {"start_jitter": 1e-9}),
        ("steady", {"n_periods": 18}),
    ],
)
def test_every_setting_that_moves_a_number_changes_every_key(tables, table, change):
    before = set(all_keys(study_of(tables)).values())
    changed = tables | {table: tables.get(table, {}) | change}
    assert not before & set(all_keys(study_of(changed)).values())


def test_fit_range_changes_only_the_keys_of_fits(tables):
    before, after = (
        all_keys(study_of(tables)),
        all_keys(study_of(tables, approximation={"range": 5e-3})),
    )
    changed = {index[0] for index in before if before[index] != after[index]}
    assert changed == {2}, "only poly-13 is fitted"


@pytest.mark.parametrize(
    ("place", "moves"),
    [
        ("model/contact.py", {"numerics", "data", "package"}),
        ("study/points.py", {"numerics", "data", "package"}),
        ("analysis/claims.py", {"data", "package"}),
        ("report/templates/report.html", {"package"}),
    ],
)
def test_digests_are_of_the_bytes_that_matter(tmp_path, monkeypatch, place, moves):
    copy = tmp_path / "gapsweep"
    shutil.copytree(package_digest.PACKAGE, copy)
    monkeypatch.setattr(package_digest, "PACKAGE", copy)

    def digests():
        return {
            name: getattr(package_digest, f"{name}_fingerprint").__wrapped__()
            for name in ("numerics", "data", "package")
        }

    before, file = digests(), copy / place
    os.utime(file)
    os.link(file, tmp_path / "linked.py")
    assert digests() == before, "dates and links are no edits"
    file.write_bytes(file.read_bytes() + b"\n")
    assert {name for name, digest in digests().items() if digest != before[name]} == moves


def test_many_problems_and_long_texts_make_a_short_message(tables):
    tables["oscillator"] = {f"key{n}": 1.0 for n in range(20_000)}
    said = problems(tables)
    assert len(said) < 100
    assert "19" in said[-1]  # so many more
    for long in ({"representation": ["x" * 200_000]}, {"x" * 200_000: 1.0}):
        block = tables["sweep"][0] | long
        (line,) = problems({"study": tables["study"], "oscillator": PAPER, "sweep": [block]})
        assert len(line) < 2000
    (line,) = problems(tables | {"oscillator": PAPER, "study": {"name": "x" * 200_000}})
    assert len(line) < 2000


def test_an_oscillator_states_its_numbers(tables):
    """Each missing one is a line with what to write, with all other problems."""
    required = ("zeta", "omega_n", "mass", "forcing")
    found = problems(tables | {"oscillator": {}, "steady": {"n": 1}})
    for name in required:
        assert sum(f"oscillator.{name}: missing; write {name} = " in line for line in found) == 1
    assert len(found) == 1 + len(required)
    del tables["oscillator"]
    assert len(problems(tables)) == len(required)
    spec = study_of(tables, oscillator={name: 1.0 for name in required}).spec
    assert spec.model["alpha"] == spec.model["c"] == spec.model["mean_load"] == 0.0


def test_a_number_that_each_block_sweeps_is_stated(tables):
    (block,) = tables["sweep"]
    tables["oscillator"] = {name: x for name, x in PAPER.items() if name not in ("zeta", "forcing")}
    swept = block | {"zeta": {"start": 0.02, "stop": 0.1, "num": 3}, "forcing": [2.0, 4.0]}
    study = study_of(tables, sweep=[swept, swept | {"forcing": 8.0}])
    assert study.grid.axes["forcing"] == (2.0, 4.0, 8.0)
    assert (study.oscillator.zeta, study.oscillator.forcing) == (0.02, 2.0)
    assert study_of(json.loads(study.json)).json == study.json
    (line,) = problems(tables | {"sweep": [swept, block | {"zeta": 0.1}]})
    assert "oscillator.forcing: missing" in line
    for wrong in ([], "a", [[1.0]], {"stop": 1.0}):
        assert any(
            "sweep[0].zeta" in x for x in problems(tables | {"sweep": [swept | {"zeta": wrong}]})
        )


@pytest.mark.parametrize(
    ("library", "engine", "moved"),
    [
        ("numba", "compiled", {0, 1, 2}),
        ("llvmlite", "compiled", {0, 1, 2}),
        ("scipy", "scipy", {0, 1, 2}),
        ("numba", "scipy", set()),
        ("scipy", "compiled", {2}),
        ("numpy", "compiled", {2}),
        ("Python", "compiled", set()),
    ],
)
def test_an_upgrade_moves_the_keys_of_what_the_library_decides(
    tables, monkeypatch, library, engine, moved
):
    def keys():
        points.identity_of.cache_clear()
        return all_keys(study_of(tables, solver={"engine": engine}))

    before, ours = keys(), points.versions()
    monkeypatch.setattr(points, "versions", lambda: {**ours, library: "99.9"})
    after = keys()
    points.identity_of.cache_clear()
    assert {index[0] for index in before if before[index] != after[index]} == moved


def test_result_schema_is_part_of_the_key(tables, monkeypatch):
    before = set(all_keys(study_of(tables)).values())
    monkeypatch.setattr(points, "RESULT_SCHEMA", points.RESULT_SCHEMA + 1)
    points.identity_of.cache_clear()
    after = set(all_keys(study_of(tables)).values())
    points.identity_of.cache_clear()
    assert not before & after


def test_all_problems_are_reported_at_once(tables):
    bad = tables | {
        "study": {"name": "../up", "colour": "red"},
        "oscillator": {"zeta": -1.0, "mass": "3"},
        "solver": {"engine": "magic", "rtol": 1e-20},
    }
    bad["sweep"][0] |= {
        "representation": ["tan-1e4"],
        "K_c": [-1.0, float("nan")],
        "gap": [[0.4e-3, 1e60], [1e-3]],
        "omega": [0.0],
    }
    found = "\n".join(problems(bad))
    for part in (
        "study.name = '../up'",
        "study.colour = 'red': unknown key",
        "oscillator.zeta = -1.0: must be >= 0",
        "oscillator.mass = '3': must be a number, in kg",
        "solver.engine = 'magic'",
        "solver.rtol = 1e-20: must be >= 1e-13",
        "sweep[0].representation[0] = 'tan-1e4': unknown representation",
        "sweep[0].K_c[0] = -1.0: must be >= 0",
        "sweep[0].K_c[1] = nan: must be finite",
        "sweep[0].gap[0][1] = 1e+60",
        "sweep[0].gap[1]",
        "sweep[0].omega[0] = 0.0: must be > 0",
    ):
        assert part in found


@pytest.mark.parametrize(
    ("omega", "part"),
    [
        ([], "sweep[0].omega = []: must have at least one value"),
        ({"start": 3.0, "stop": 1.0, "step": 1.0}, "stop 1 must be >= start 3"),
        ({"start": 1.0, "stop": 3.0, "step": 0.0}, "sweep[0].omega.step = 0.0"),
        ({"start": 1.0, "stop": 3.0}, "sweep[0].omega: give step or num"),
        ({"start": 1.0, "stop": 1e9, "step": 1e-3}, "step 0.001: must give <= 10000000 values"),
        ("all", "sweep[0].omega[0] = 'all'"),
    ],
)
def test_absurd_grids_are_refused_before_anything_is_allocated(tables, omega, part):
    tables["sweep"][0]["omega"] = omega
    (problem,) = problems(tables)
    assert part in problem


def test_sparse_blocks_that_span_a_huge_dataset_are_refused(tables):
    block = tables["sweep"][0] | {"representation": ["piecewise"]}
    n = 20_000
    wide = [
        block | {"omega": {"start": 1.0, "stop": 30.0, "num": n}},
        block | {"K_c": [float(k) for k in range(1, n)], "omega": [1.0]},
        block | {"gap": [[j * 1e-6, 0.0] for j in range(1, 10)], "omega": [1.0]},
    ]
    (problem,) = problems(tables | {"sweep": wide})
    assert "dataset cells" in problem


def test_undefined_protocol_is_named(tables):
    tables["sweep"][0]["representation"] = ["tanh-1e6@paper"]
    (problem,) = problems(tables)
    assert "[protocol.paper] is missing" in problem


@pytest.mark.parametrize(
    ("table", "named"),
    [({"protocol": {"paper": WRONG}}, "protocol.paper"), ({"solver": WRONG}, "")],
)
def test_wrong_settings_of_a_protocol_name_its_table(tables, table, named):
    (problem,) = problems(tables | table)
    assert f"study: {named or 'solver'}: controller = 'ode45': needs" in problem


@pytest.mark.parametrize(
    "settings",
    [{"contact_force": "as_written"}, {"restart": True}, {"controller": "ode45"}],
    ids=lambda settings: next(iter(settings)),
)
@pytest.mark.parametrize("swept", [{"mean_load": [0.0, 1.0]}, {"omega_n": [0.0, 5.0]}, {}])
def test_settings_that_cannot_locate_contacts_are_refused_before_a_run(tables, settings, swept):
    """By the check of a call; smooth laws and the reference engine have no such contacts."""
    labels = ["piecewise@paper", "tanh-1e4@paper", "piecewise-noevents@paper"]
    tables["sweep"][0] |= {"representation": labels, **swept}
    tables["protocol"] = {"paper": {**settings}}
    if not swept:
        gs.Study.from_dict(tables)
        return
    (problem,) = problems(tables)
    name = next(iter(settings))
    assert f"piecewise@paper: {name} = " in problem
    model = tables["oscillator"] | {name: max(axis) for name, axis in swept.items()}
    model |= {"omega_n": 0.0} if "omega_n" in swept else {}
    law = gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4))
    with pytest.raises(gs.ModelError) as refused:
        gs.simulate(gs.Oscillator(**model), law, 9.0, t_end=1.0, dense_output=True, **settings)
    assert str(refused.value) in problem
    if name != "controller":
        tables["protocol"]["paper"] |= {"engine": "scipy"}
        gs.Study.from_dict(tables)


def test_settings_that_cannot_locate_the_contacts_of_a_history_are_refused(tables):
    tables["protocol"] = {"paper": {"controller": "ode45"}}
    history = {"representation": ["piecewise@paper"], "K_c": 1.4e4, "gap": [4e-4, 4e-4]}
    history |= {"omega": 9.0, "start": [0.0, 0.0], "t_end": 1.0}
    gs.Study.from_dict(tables | {"history": [history]})
    (problem,) = problems(tables | {"history": [history | {"mean_load": 1.0}]})
    assert "piecewise@paper: controller = " in problem


def test_points_carry_canonical_values(tables):
    tables["sweep"][0]["omega"] = [0.1 + 0.2]
    assert gs.Study.from_dict(tables).grid.omega == (0.3,)
    assert np.isclose(0.3, 0.1 + 0.2)


def test_a_point_is_the_same_whatever_names_its_numbers(tables):
    (block,) = tables["sweep"]
    plain = set(all_keys(study_of(tables)).values())
    j_1, j_2 = block.pop("gap")[0]
    walls = study_of(tables, sweep=[block | {"j_1": j_1, "j_2": [j_2]}])
    assert walls.grid.dims == (
        "representation", "K_c", "j_1", "j_2", "omega", "initial_condition",
    )  # fmt: skip
    assert set(all_keys(walls).values()) == plain
    forced = study_of(
        tables, sweep=[block | {"gap": [j_1, j_2], "forcing": [4.0, 8.0], "zeta": 0.03}]
    )
    assert forced.grid.dims[3:] == ("omega", "zeta", "forcing", "initial_condition")
    keys = all_keys(forced)
    assert {key for place, key in keys.items() if place[5] == 0} == plain
    harder = {"oscillator": PAPER | {"forcing": 8.0}, "sweep": [block | {"gap": [[j_1, j_2]]}]}
    assert set(keys.values()) - plain == set(all_keys(study_of(tables, **harder)).values())


def test_a_grid_of_starts_is_a_list_of_them(tables):
    block = tables["sweep"][0] | {"representation": "piecewise", "omega": 7.0}
    form = {"grid": [3, 2], "x": [-1e-3, 1e-3], "v": [0.0, 0.1]}
    listed = [[x, v] for v in (0.0, 0.1) for x in (-1e-3, 0.0, 1e-3)]
    one, other = (
        study_of(tables, sweep=[block | {"initial_condition": starts}]) for starts in (form, listed)
    )
    assert list(one.grid.starts) == list(other.grid.starts)
    assert all_keys(one) == all_keys(other)
    alone = study_of(tables, sweep=[block | {"initial_condition": [1e-3, 0.1]}])
    assert set(all_keys(alone).values()) < set(all_keys(one).values())


def test_blocks_that_do_not_sweep_a_number_keep_that_of_the_oscillator(tables):
    block = tables["sweep"][0] | {"representation": "piecewise", "omega": 7.0}
    blocks = [block | {"forcing": [2.0, 8.0]}, block | {"omega": 12.0}]
    grid = study_of(tables, sweep=blocks).grid
    assert grid.axes["forcing"] == (2.0, 4.0, 8.0)
    assert grid.requested.squeeze().tolist() == [[True, False, True], [False, True, False]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gap": None}, "sweep[0].gap: missing; write gap = [4e-4, 4e-4], in m, or j_1 and j_2"),
        ({"j_1": 1e-3}, "sweep[0]: give gap, or j_1 and j_2"),
        ({"gap": None, "j_1": 1e-3}, "sweep[0]: give gap, or j_1 and j_2"),
        ({"forcing": []}, "sweep[0].forcing"),
        ({"mass": [0.0]}, "sweep[0].mass = 0: must be > 0"),
        ({"zeta": {"start": -0.1, "stop": 1.0, "num": 3}}, "sweep[0].zeta = -0.1: must be"),
        ({"alpha": "stiff"}, "sweep[0].alpha[0] = 'stiff': must be a number, in N/m³"),
        (
            {"forcing": {"start": -1e308, "stop": 1e308, "num": 3}},
            "forcing.stop = 1e+308: must be within -1e+50..1e+50",
        ),
        ({"zeta": {"start": 0.1, "stop": 1.0, "step": 1e-320}}, "must give <= 10000000 values"),
        (
            {"initial_condition": {"grid": [4000, 4000], "x": [0.0, 1.0], "v": [0.0, 1.0]}},
            "grid = [4000, 4000]: must have <= 10000000 initial conditions",
        ),
        ({"omega": 1e300}, "omega[0] = 1e+300: must be within -1e+50..1e+50"),
        ({"omega": 5e-324}, "omega[0] = 5e-324: must be >= 1e-50"),
        ({"omega": True}, "sweep[0].omega[0] = True: must be a number, in Hz"),
        ({"K_ratio": [1.0, -2.0]}, "sweep[0].K_ratio[1] = -2.0: must be >= 0"),
        ({"k_ratio": 2.0}, "sweep[0].k_ratio = 2.0: unknown key"),
        (
            {"initial_condition": {"grid": [1, 5], "x": [0.0, 1.0], "v": [0.0, 1.0]}},
            "sweep[0].initial_condition.grid[0] = 1: must be >= 2",
        ),
        (
            {
                "forcing": {"start": 0.0, "stop": 1.0, "num": 10**7},
                "zeta": {"start": 0.0, "stop": 1.0, "num": 10**3},
            },
            "sweep points: must be <= 1000000000",
        ),
    ],
)
def test_wrong_axes_are_refused(tables, change, message):
    block = {k: v for k, v in (tables["sweep"][0] | change).items() if v is not None}
    found = problems(tables | {"sweep": [block]})
    assert any(message in one for one in found), found


def test_walls_and_gaps_do_not_mix(tables):
    (block,) = tables["sweep"]
    other = {k: v for k, v in block.items() if k != "gap"} | {"j_1": 0.0, "j_2": 0.0}
    assert "j_1 and j_2 in every block" in problems(tables | {"sweep": [block, other]})[0]


def with_(**changes):
    return lambda tables: tables["sweep"][0].update(changes)


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (
            with_(gap=4e-4),
            ".gap = 0.0004: must be the distances of both walls [m], as [4e-4, 4e-4]",
        ),
        (with_(gap=["0.4/0.4"]), ".gap[0] = '0.4/0.4': must be the distances of both walls [m]"),
        (with_(gap=[[4e-4]]), ".gap[0] = [0.0004]: must be the distances of both walls [m]"),
        (with_(gap=[[math.inf, math.inf]]), ".gap[0] = [inf, inf]: no wall on either side"),
        (with_(gap=[[math.nan, 4e-4]]), ".gap[0][0] = nan: must be"),
        (
            with_(initial_condition=[0.0]),
            "_condition[0] = [0.0]: must be x [m] and v [m/s], as [0.0,",
        ),
        (
            with_(initial_condition=0.0),
            "_condition = 0.0: must be x [m] and v [m/s], as [0.0, 0.0]",
        ),
        (
            with_(initial_condition={"x": [0.0, 1.0], "v": [0.0, 1.0]}),
            "sweep[0].initial_condition: give sobol or grid",
        ),
        (
            with_(omega={"start": 1.0, "stop": 2.0, "num": 2, "step": 0.5}),
            "sweep[0].omega.step = 0.5: give step or num, not both",
        ),
        (with_(representation=[]), "sweep[0].representation = []: must have at least one value"),
        (with_(Kc=1e4), "sweep[0].Kc = 10000.0: unknown key; did you mean K_c?"),
        (lambda tables: tables.update(solvr={}), "solvr: unknown key; did you mean solver?"),
        (lambda tables: tables.update(solver={"rtl": 1.0}), "unknown key; did you mean rtol?"),
        (lambda tables: tables["study"].update(name="a b"), "'a b': must be letters, digits, '.'"),
        (
            lambda tables: tables.update(sweep=tables["sweep"][0]),
            "study: sweep: must be a list of tables; write [[sweep]]",
        ),
        (lambda tables: tables.pop("sweep"), "study: sweep: missing"),
        (lambda tables: tables.update(oscillator=3), "oscillator = 3: must be a table"),
    ],
)
def test_problems_say_what_would_do(tables, edit, said):
    edit(tables)
    (problem,) = problems(tables)
    assert said in problem


def test_a_missing_wall_is_infinity_in_a_study_file(tables):
    tables["sweep"][0]["gap"] = [[math.inf, 4e-4], [4e-4, math.inf]]
    study = gs.Study.from_dict(tables)
    gaps = gs.Gap(None, 4e-4), gs.Gap(4e-4, None)
    assert study.grid.gaps == gaps
    assert study.grid.coordinates()["gap"].tolist() == ["inf/0.4", "0.4/inf"]
    assert study.grid.coordinates()["j_1"].tolist() == [math.inf, 4e-4]
    ((_, table),) = study.points(np.arange(2))
    (_, models), refused = table.models()
    assert not refused
    assert {law.gap for (law,) in models.laws} <= {*gaps}


@pytest.mark.parametrize(
    "wanted",
    [
        "0/0.8",
        (0.0, 0.8e-3),
        [[0.0, 0.8e-3]],
        np.array([0.0, 0.8e-3]),
        selected(("gap=0,0.8e-3",))["gap"],
    ],
)
def test_a_gap_is_selected_as_a_study_file_gives_it(tables, wanted):
    tables["sweep"][0]["gap"] = [[0.4e-3, 0.4e-3], [0.0, 0.8e-3], [0.8e-3, 0.0]]
    study = gs.Study.from_dict(tables)
    gap = study.grid.dims.index("gap")
    assert study.select(gap=wanted)[gap].tolist() == [1]
    assert study.select(gap=[(0.0, 0.8e-3), (0.8e-3, 0.0)])[gap].tolist() == [1, 2]
    assert study.select(gap=["0/0.8", "0.8/0"])[gap].tolist() == [1, 2]
    for wrong in (0.4e-3, (0.0, 0.9e-3), (-4e-4, 4e-4), "0.4", slice(0.0, 0.8e-3)):
        with pytest.raises(gs.StudyError, match="gap = "):
            study.select(gap=wrong)


def test_every_number_of_the_oscillator_is_known_wherever_they_are_listed(tables):
    numbers = set(OSCILLATOR)
    assert set(OscillatorTable.model_fields) == numbers
    assert numbers <= set(COORDINATES)
    assert numbers <= set(slider_numbers(of_model()))
    values = {name: 1.125 + i for i, name in enumerate(OSCILLATOR)} | {"base_damping": 0.625}
    tables["sweep"][0] |= {"representation": "piecewise", "omega": [7.0]}
    study = study_of(tables, oscillator=values)
    coords = {"representation": ["piecewise"], "K_c": [1.4e4], "omega": [7.0], "gap": ["0.4/0.4"]}
    responses = xr.Dataset({"x_max": 0.1}, coords, study.attributes)
    (part,) = report_model.sections(Inputs(responses, xr.Dataset()))
    in_report = dict(part.content["pairs"])["Numbers"]
    assert [value for value in values.values() if f" {value:g}" not in in_report] == []


def test_branches_have_defaults_and_stand_in_the_json(tables):
    study = gs.Study.from_dict(tables | {"branches": {}})
    assert study.spec.branches.along == "omega"
    assert json.loads(study.json)["branches"] == {"along": "omega", "follow": 0, "max_steps": 1000}
    assert "branches" not in json.loads(gs.Study.from_dict(tables).json)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"folow": 1}, "branches.folow = 1: unknown key; did you mean follow?"),
        ({"follow": 11}, "branches.follow = 11: must be <= 10"),
        ({"follow": 1.5}, "branches.follow = 1.5: must be a whole number"),
        ({"max_steps": 1}, "branches.max_steps = 1: must be >= 2"),
        ({"rtol": 0.0}, "branches.rtol = 0.0: must be >= 1e-13"),
        ({"atol": -1.0}, "branches.atol = -1.0: must be > 0"),
        ({"along": 3}, "branches.along = 3: must be text, in quotes"),
        ({"along": "K_c"}, "branches.along = 'K_c': must be a swept parameter: omega"),
        ({"along": "gap"}, "branches.along = 'gap': must be a swept parameter: omega"),
        ({"along": "speed"}, "must be a swept parameter: omega"),
    ],
)
def test_wrong_tables_of_branches_are_refused(tables, given, words):
    with pytest.raises(gs.StudyError, match=re.escape(words)):
        gs.Study.from_dict(tables | {"branches": given})


def test_branches_are_refused_with_all_other_errors_at_once(tables):
    tables["sweep"][0]["K_c"] = -1.0
    with pytest.raises(gs.StudyError) as error:
        gs.Study.from_dict(tables | {"branches": {"rtol": 1.0, "steps": 3}})
    assert len(error.value.problems) == 3


def test_branches_without_a_range_or_a_law_that_can_be_followed_are_refused(tables):
    tables["sweep"][0] |= {"representation": "piecewise-noevents", "omega": 9.0}
    with pytest.raises(gs.StudyError) as error:
        gs.Study.from_dict(tables | {"branches": {}})
    first, second = error.value.problems
    assert "branches.along = 'omega'" in first
    assert "write several values in [[sweep]]" in first
    assert "no representation of the study can be continued" in second


def test_branches_along_a_parameter_that_only_laws_with_a_protocol_have_are_refused(tables):
    (block,) = tables["sweep"]
    swept = block | {"representation": "huntcrossley@loose", "chi": [0.1, 1.0]}
    tables |= {"sweep": [block, swept], "protocol": {"loose": {"rtol": 1e-6}}}
    gs.Study.from_dict(tables)
    with pytest.raises(gs.StudyError, match=r"no representation .* continued along chi"):
        gs.Study.from_dict(tables | {"branches": {"along": "chi"}})


def test_branches_along_what_a_contact_has_of_its_own_are_refused():
    tables = {
        "study": {"name": "two"},
        "system": {
            "mass": [[1.0]],
            "stiffness": [[1.0]],
            "contacts": {"a": [1.0], "b": [1.0]},
            "forcing": [{"amplitude": [1.0]}],
        },
        "contact": {"a": {"K_c": 1.0}},
        "sweep": [
            {"representation": "piecewise", "K_c": [1.0, 2.0], "gap": [1.0, 1.0], "omega": 1.0}
        ],
        "branches": {"along": "K_c"},
    }
    with pytest.raises(gs.StudyError, match=r"must be set in .*sweep"):
        gs.Study.from_dict(tables)


def test_a_notebook_shows_title_dimensions_and_values(tables):
    tables["study"]["title"] = "Gaps < walls"
    study = gs.Study.from_dict(tables)
    page = study._repr_html_()
    assert "Gaps &lt; walls" in page
    assert all(f"<th>{name}</th>" in page for name in study.grid.dims)


def test_arrays_of_numpy_are_taken_as_lists(tables):
    (block,) = tables["sweep"]
    arrays = block | {"omega": np.array(block["omega"]), "K_c": np.float64(1e4)}
    lists = block | {"K_c": 1e4}
    assert study_of(tables, sweep=[arrays]).json == study_of(tables, sweep=[lists]).json


def test_methods_of_a_study_are_the_functions_of_the_package(tables, tmp_path, client):
    study = gs.Study.from_dict(tables)
    before = study.plan(cache=tmp_path / "cache")
    assert (before.n_hits, before.n_missing) == (0, before.n_points)
    found = study.query(client=client, cache=tmp_path / "cache")
    assert study.plan(cache=tmp_path / "cache").n_missing == 0
    with study.run(client=client, cache=tmp_path / "cache", out=tmp_path / "run") as ds:
        xr.testing.assert_equal(ds["x_max"].load(), found["x_max"])
