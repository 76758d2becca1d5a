"""Study files with [system]: what they mean, and what they refuse."""

import json
import os
from copy import deepcopy

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from scipy.integrate import solve_ivp
from tests.builders.random_systems import as_gapsweep, random_case
from tests.builders.runs import COMMAND, in_a_process
from tests.builders.studies import PAPER, SECTION, TWO_MASSES, changed

import gapsweep as gs
from gapsweep.execution.layout import Layout
from gapsweep.execution.task import Tile, respond_to
from gapsweep.model.structure import Structure
from gapsweep.study.points import Kind
from gapsweep.variables import CONTACT, COORDINATE, LAG


def points_of(tables):
    """All points of a study, with the cells that they belong to."""
    study = gs.Study.from_dict(tables)
    ((rows, table),) = study.points(np.flatnonzero(study.grid.requested))
    return study, rows, table


@given(seed=st.integers(0, 10**6))
def test_a_system_is_what_its_row_says(seed):
    n = 1 + seed % 4
    system, _ = as_gapsweep(random_case([seed], n, seed % (n + 1)).system)
    structure = Structure.of(system)
    row = structure.row(system)
    again = structure.system(row)
    assert len(row) == len(structure.names) == len(set(structure.names))
    assert_array_equal(structure.row(again), row)
    for name in ("mass", "damping", "stiffness", "directions"):
        assert_array_equal(getattr(again, name), getattr(system, name))
    assert again.sizes == system.sizes


def test_rows_hold_loads_modulation_and_lags():
    systems = [gs.systems.gear_pair(), gs.systems.typical_section(15.0), gs.systems.two_masses()]
    for system in systems:
        structure = Structure.of(system)
        again = structure.system(structure.row(system))
        assert again.sizes == system.sizes
        assert Structure.read(json.loads(json.dumps(vars_of(structure)))) == structure
        for ours, theirs in zip(again.forcing, system.forcing, strict=True):
            assert_array_equal(ours.amplitude, theirs.amplitude)
            assert (ours.k, ours.phase, ours.power) == (theirs.k, theirs.phase, theirs.power)
        terms = [*again.modulation.values()], [*system.modulation.values()]
        assert [[vars_of(t) for t in each] for each in terms[0] if each] == [
            [vars_of(t) for t in each] for each in terms[1] if each
        ]
        if system.lags is not None:
            for name in ("force", "of_speed", "of_place", "of_lags"):
                assert_array_equal(getattr(again.lags, name), getattr(system.lags, name))


def vars_of(value):
    return {name: getattr(value, name) for name in value.__dataclass_fields__}


def test_points_have_their_walls_their_frequency_and_their_start():
    study, rows, table = points_of(TWO_MASSES)
    assert study.grid.dims == ("representation", "K_c", "gap", "omega", "initial_condition")
    assert study.grid.parts == {"coordinate": ("q_1", "q_2"), "contact": ("stop", "between")}
    at = np.transpose(np.unravel_index(rows, study.grid.shape)).tolist()
    for place, point in zip(at, range(len(table)), strict=True):
        _, k, _, w, s = place
        value = {name: table.column(name)[point] for name in table.kind.numbers}
        walls = [value[f"{name}[0]"] for name in ("K_c", "j_1", "j_2", "K_ratio")]
        assert walls == [[10.0, 100.0][k], 0.1, 0.2, 1.0]
        assert [value[f"{n}[1]"] for n in ("K_c", "j_1", "j_2", "K_ratio")] == [50.0, 0.5, 0.4, 2.0]
        assert value["omega"] == [0.3, 0.5][w]
        start = [value[n] for n in ("q_0[0]", "q_0[1]", "v_0[0]", "v_0[1]")]
        assert start == TWO_MASSES["sweep"][0]["initial_condition"][s]


def test_parameters_are_dimensions_where_they_are_swept():
    study, _rows, table = points_of(SECTION)
    assert study.grid.dims == ("representation", "K_c", "gap", "speed", "initial_condition")
    assert study.grid.parts["lag"] == ("z_1", "z_2")
    for speed, point in zip((8.0, 10.0), range(2), strict=True):
        system = gs.systems.typical_section(speed, density=1.2)
        structure = Structure.of(system)
        first = table.kind.numbers.index("mass[0,0]")
        assert_array_equal(
            table.numbers[point, first : first + len(structure.names)], structure.row(system)
        )
    assert not table.column("omega").any()


def test_arrays_are_the_identity(tmp_path, monkeypatch):
    """The same matrices from a function, with other names in them, have the same keys."""
    (tmp_path / "masses.py").write_text(
        "import gapsweep as gs\n"
        "def masses(k):\n"
        "    return gs.System(mass=[[1, 0], [0, 2]], stiffness=[[k, -10], [-10, 20]],\n"
        "        damping=[[.3, -.1], [-.1, .2]], contacts={'a': [1, 0], 'b': [1, -1]},\n"
        "        forcing=[gs.Harmonic(amplitude=[1, 0])], coordinates=('left', 'right'))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    function = changed(
        TWO_MASSES,
        system={"function": "masses:masses"},
        parameters={"k": 30.0},
        contact={"b": TWO_MASSES["contact"]["between"]},
    )
    ours, theirs = (points_of(tables)[2].keys() for tables in (TWO_MASSES, function))
    assert_array_equal(ours, theirs)
    other = changed(function, parameters__k=31.0)
    assert not set(points_of(other)[2].keys().tolist()) & set(ours.tolist())


def test_kinds_of_systems_are_read_back():
    for tables in (TWO_MASSES, SECTION):
        kind = points_of(tables)[2].kind
        assert Kind.of(kind.identity) == kind


def test_the_study_in_a_dataset_is_the_study():
    for tables in (TWO_MASSES, SECTION):
        study = gs.Study.from_dict(tables)
        assert gs.Study.from_dict(json.loads(study.json)).spec == study.spec


def test_sobol_starts_of_systems_fill_their_box():
    box = {"sobol": 33, "x": [[-1.0, 1.0], [0.5, 0.5]], "v": [[0.0, 2.0], [-3.0, 0.0]]}
    starts = gs.Study.from_dict(changed(TWO_MASSES, sweep__0__initial_condition=box)).grid.starts
    low, high = np.array([*box["x"], *box["v"]]).T
    assert starts.states.shape == (33, 4)
    assert np.all((starts.states >= low) & (starts.states <= high))
    assert len({*map(tuple, starts.states.tolist())}) == 33


REFUSED = {
    "both forms": (TWO_MASSES, {"system__function": "two_masses"}, "not both"),
    "no stiffness": (TWO_MASSES, {"system__stiffness": None}, "write mass and stiffness"),
    "other function": (SECTION, {"system__function": "wing"}, "module:function, or one of"),
    "absent module": (SECTION, {"system__function": "nowhere:wing"}, "nowhere"),
    "argument": (SECTION, {"parameters__chord": 1.0}, "chord"),
    "taken name": (SECTION, {"parameters__omega": 1.0}, "choose another name"),
    "oscillator": (SECTION, {"oscillator": {"zeta": 0.1}}, "oscillator: not allowed with [system]"),
    "bad matrix": (TWO_MASSES, {"system__mass": [[1.0, 2.0]]}, "mass"),
    "contact": (
        TWO_MASSES,
        {"contact__stopp": {"K_c": 1.0}},
        "'stopp': must be a contact of the system: stop",
    ),
    "own law": (
        TWO_MASSES,
        {"contact__stop": {"representation": "a:b"}},
        "write the representation of all contacts in [[sweep]]",
    ),
    "no K_c": (TWO_MASSES, {"sweep__0__K_c": None}, "K_c: missing"),
    "no gap": (TWO_MASSES, {"sweep__0__gap": None}, "gap: missing"),
    "no omega": (TWO_MASSES, {"sweep__0__omega": None}, "omega: missing"),
    "omega": (SECTION, {"sweep__0__omega": 3.0}, "the system is not forced"),
    "sweep": (SECTION, {"sweep__0__initial_condition": "sweep_up"}, "sweeps need omega"),
    "start": (TWO_MASSES, {"sweep__0__initial_condition": [0.1, 0.2]}, "must be 4"),
    "auto": (SECTION, {"sweep__0__representation": "auto"}, "'auto' needs a forcing and a contact"),
    "taken by agreement": (SECTION, {"parameters__recall": 1.0}, "choose another name"),
    "parameter without use": (TWO_MASSES, {"parameters": {"k": 1.0}}, "'k': must be in"),
    "scale without value": (TWO_MASSES, {"system__forcing__0__scale": "p"}, "'p': must be in"),
    "list of parameters": (SECTION, {"parameters": [1.0]}, "parameters"),
    "number of parameters": (SECTION, {"parameters": 5}, "parameters"),
    "our own key": (SECTION, {"sweep__0__parameter": {"foo": [1.0]}}, "unknown key"),
    "nobody's law": (
        TWO_MASSES,
        {
            "contact": {n: {"representation": "piecewise"} for n in ("stop", "between")},
            "sweep__0__representation": ["piecewise", "tanh-1e4"],
        },
        "representation: unused",
    ),
    "unknown": (SECTION, {"sweep__0__sped": [1.0]}, "unknown key"),
    "zeta": (TWO_MASSES, {"sweep__0__zeta": [0.1]}, "unknown key"),
    "box": (
        TWO_MASSES,
        {"sweep__0__initial_condition": {"sobol": 4, "x": [[0.0, 1.0]], "v": [[0.0, 1.0]]}},
        "must be 4",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_does_not_fit_is_refused_in_words(name):
    tables, changes, said = REFUSED[name]
    with pytest.raises(gs.StudyError) as refused:
        gs.Study.from_dict(changed(tables, **changes))
    assert said in str(refused.value)
    assert "Traceback" not in str(refused.value)


def test_loads_of_matrices_are_swept():
    """A free gear with drag: forcing and mean load are axes, equal to systems made by hand."""
    tables = {
        "study": {"name": "gear"},
        "system": {
            "mass": [[1.0]], "stiffness": [[0.0]], "damping": [[0.4]], "contacts": {"mesh": [1.0]},
            "forcing": [
                {"amplitude": [1.0], "scale": "p"}, {"amplitude": [-1.0], "k": 0, "scale": "drag"}
            ],
        },
        "parameters": {"p": 0.2, "drag": 0.1},
        "sweep": [
            {
                "representation": "piecewise", "K_c": 1.0, "gap": [1.0, 1.0], "omega": [0.13],
                "p": [0.2, 0.4], "drag": [0.05, 0.1], "initial_condition": [[-1.2, 0.0]],
            }
        ],
    }  # fmt: skip
    study, rows, table = points_of(tables)
    assert {"p", "drag"} <= {*study.grid.dims}
    by_hand = []
    for p in (0.2, 0.4):
        for drag in (0.05, 0.1):
            loads = [gs.Harmonic(amplitude=[p]), gs.Harmonic(amplitude=[-drag], k=0)]
            gear = gs.System(
                mass=[[1.0]], stiffness=[[0.0]], damping=[[0.4]], contacts={"mesh": [1.0]},
                forcing=loads,
            )  # fmt: skip
            law = gs.Piecewise(1.0, gs.Gap(1.0, 1.0))
            found = gs.respond(gear, law, 0.13, q_0=[-1.2])
            by_hand.append(found.x_max)

            def rates(t, y, p=p, drag=drag):
                mesh = y[0] - np.clip(y[0], -1.0, 1.0)
                return y[1], p * np.cos(0.26 * np.pi * t) - drag - 0.4 * y[1] - mesh

            state, period = [found.x_end, found.v_end], found.period_multiple / 0.13
            run = solve_ivp(rates, (0.0, period), state, rtol=1e-10, atol=1e-12, max_step=0.01)
            assert found.response_class is gs.ResponseClass.PERIODIC
            assert run.y[0].max() == pytest.approx(found.x_max, abs=1e-4)
            assert run.y[:, -1] == pytest.approx(np.array(state), abs=1e-6)
    several = [Tile.of_one(table.take([i]), np.zeros(2)) for i in range(4)]
    assert sorted(respond_to(tile).columns["x_max"].item() for tile in several) == sorted(by_hand)
    assert len(rows) == 4


def of_function(tmp_path, monkeypatch, name, text):
    """Tables of a study of a user's function of k, `make` of a new module."""
    (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    tables = changed(SECTION, system={"function": f"{name}:make"}, parameters={"k": 1.0})
    del tables["sweep"][0]["speed"]
    return tables


def test_tables_of_systems_need_one():
    for name in ("parameters", "contact"):
        tables = {n: t for n, t in SECTION.items() if n != "system"} | {name: {"a": 1.0}}
        with pytest.raises(gs.StudyError):
            gs.Study.from_dict(tables)


def test_an_edited_function_is_that_of_the_next_study(tmp_path, monkeypatch):
    """Of a study that was loaded before it stays what it was, whatever is asked of it later."""
    monkeypatch.syspath_prepend(tmp_path)
    source = (
        "import gapsweep as gs\n"
        "def spring(k):\n"
        "    return gs.System(mass=[[1.0]], stiffness=[[{} * k]])\n"
    )
    tables = {
        "study": {"name": "spring"},
        "system": {"function": "edited:spring"},
        "parameters": {"k": 1.0},
        "sweep": [{"representation": "piecewise", "k": [1.0, 2.0]}],
    }

    def stiffness(study):
        ((_, table),) = study.points(np.arange(2))
        return table.column("stiffness[0,0]").tolist()

    studies = []
    for factor in (30.0, 40.0):
        (tmp_path / "edited.py").write_text(source.format(factor))
        studies.append(gs.Study.from_dict(tables))
    assert stiffness(studies[1]) == [40.0, 80.0]
    assert stiffness(studies[0]) == [30.0, 60.0]


@pytest.mark.parametrize(
    "raised", ["SystemExit", "ValueError('no')", "KeyError('k')", "GeneratorExit", "BaseException"]
)
def test_what_a_function_raises_is_one_line(tmp_path, monkeypatch, raised):
    name = f"raising{abs(hash(raised))}"
    tables = of_function(tmp_path, monkeypatch, name, f"def make(k):\n    raise {raised}\n")
    with pytest.raises(gs.StudyError, match=rf"{name}\.py:2: {name}:make: ") as refused:
        gs.Study.from_dict(tables)
    assert "[parameters]" not in str(refused.value)
    assert len(refused.value.problems) == 1


def test_a_call_that_fails_inside_a_function_is_told_from_a_call_of_the_function(
    tmp_path, monkeypatch
):
    """Both are a TypeError of arguments: the line of the first, the parameters for the second."""
    inside = "import gapsweep as gs\ndef make(k):\n    return gs.Harmonic([k, 0.0])\n"
    tables = of_function(tmp_path, monkeypatch, "calls_inside", inside)
    with pytest.raises(gs.StudyError, match=r"calls_inside\.py:3: .*Harmonic: ") as refused:
        gs.Study.from_dict(tables)
    assert "[parameters]" not in str(refused.value)
    tables = of_function(tmp_path, monkeypatch, "other_names", "def make(stiffness):\n    pass\n")
    with pytest.raises(
        gs.StudyError, match=r"TypeError.*the function needs the arguments of \[parameters\]"
    ):
        gs.Study.from_dict(tables)


def test_numbers_are_rounded_alike_wherever_they_stand():
    third = changed(TWO_MASSES, contact__between__K_c=1.0 / 3.0)
    rounded = changed(TWO_MASSES, contact__between__K_c=0.333333333333)
    zeros = changed(TWO_MASSES, system__mass=[[1.0, -0.0], [-0.0, 2.0]])
    keys = [points_of(tables)[2].keys() for tables in (third, rounded, zeros, TWO_MASSES)]
    assert_array_equal(keys[0], keys[1])
    assert_array_equal(keys[2], keys[3])


def test_a_system_must_keep_its_structure(tmp_path, monkeypatch):
    (tmp_path / "growing.py").write_text(
        "import numpy as np, gapsweep as gs\n"
        "def growing(size):\n"
        "    return gs.System(mass=np.eye(int(size)), stiffness=np.eye(int(size)))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    tables = {
        "study": {"name": "growing"},
        "system": {"function": "growing:growing"},
        "parameters": {"size": 1.0},
        "sweep": [{"representation": "piecewise", "size": [1.0, 2.0]}],
    }
    study = gs.Study.from_dict(tables)
    with pytest.raises(gs.StudyError, match="size = 2: has other coordinates"):
        study.points(np.arange(2))


def test_the_library_that_fits_a_contact_is_part_of_the_key():
    for label, has_scipy in (("poly-13", True), (None, False)):
        tables = changed(TWO_MASSES, sweep__0__representation="tanh-1e4")
        if label is not None:
            tables["contact"]["between"]["representation"] = label
        ((_, points),) = gs.Study.from_dict(tables).points(np.arange(1))
        assert ("scipy" in json.loads(points.kind.identity)["versions"]) == has_scipy


def told(tmp_path, module, text, more, *command, code=0):
    """A command on a study whose system a function `make` of a module in the folder makes."""
    (tmp_path / f"{module}.py").write_text(text)
    (tmp_path / "s.toml").write_text(
        f'[study]\nname = "s"\n[system]\nfunction = "{module}:make"\n[parameters]\nk = 4.0\n'
        f'[[sweep]]\nrepresentation = "piecewise"\n{more}'
    )
    return in_a_process(tmp_path, *command, command=[COMMAND], code=code)


def test_a_function_in_the_current_folder_is_found_from_the_command_line(tmp_path):
    text = (
        "import gapsweep as gs\n\n\ndef make(k):\n    given = {'contacts': {'stop': [1.0]}}\n"
        "    return gs.System(mass=[[1.0]], damping=[[1.0]], stiffness=[[k]], **given)\n"
    )
    more = "K_c = 5.0\ngap = [0.1, 0.1]\nk = [1.0, 2.0]\n"
    done = told(tmp_path, "my_sys", text, more, "plan", "s.toml")
    assert "points  2" in done.stdout


def test_what_a_function_prints_is_no_part_of_what_a_command_says(tmp_path):
    text = (
        "import gapsweep as gs\nprint('imported')\n\n\ndef make(k):\n    print('made')\n"
        "    return gs.System(mass=[[1.0]], damping=[[1.0]], stiffness=[[k]])\n"
    )
    done = told(tmp_path, "loud", text, "", "plan", "s.toml", "--json")
    assert json.loads(done.stdout)["points"] == 1
    assert "imported" in done.stderr
    assert "made" in done.stderr


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("import os; os._exit(0)", "its process ended with exit code 0"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "ended by SIGSEGV"),
    ],
)
def test_a_function_that_ends_its_process_ends_no_command(tmp_path, body, said):
    done = told(tmp_path, "ending", f"def make(k):\n    {body}\n", "", "run", "s.toml", code=1)
    assert said in done.stderr
    assert "s.toml: system: ending:make: " in done.stderr


def test_a_function_that_ends_its_process_at_a_swept_value_ends_no_command(tmp_path):
    text = (
        "import os\nimport gapsweep as gs\n\n\n"
        "def make(k):\n    if k == 2.0:\n        os._exit(0)\n"
        "    return gs.System(mass=[[1.0]], damping=[[1.0]], stiffness=[[k]])\n"
    )
    done = told(tmp_path, "late", text, "k = [1.0, 2.0]\n", "run", "s.toml", code=1)
    assert "s.toml: system at k = 2: late:make: its process ended with exit code 0" in done.stderr


def test_systems_are_made_of_the_values_that_points_have():
    tables = changed(SECTION, sweep__0__speed=[8.0, 10.0])
    block = deepcopy(tables["sweep"][0])
    tables["sweep"].append({**block, "speed": 12.0, "density": 1.1})
    study = gs.Study.from_dict(tables)
    assert study.model.swept(study.grid.axes, study.grid.requested) == [
        {"speed": 8.0, "density": 1.2},
        {"speed": 10.0, "density": 1.2},
        {"speed": 12.0, "density": 1.1},
    ]


def test_a_function_may_ask_for_laws_in_threads(tmp_path, monkeypatch):
    tables = of_function(
        tmp_path, monkeypatch, "pooled",
        "from concurrent.futures import ThreadPoolExecutor\nimport gapsweep as gs\n\n\n"
        "def force(x):\n    return 2.0 * x\n\n\n"
        "def make(k):\n    with ThreadPoolExecutor() as pool:\n"
        "        law = pool.submit(gs.contact_law, 'pooled:force', k, gs.Gap(0.0, 0.0)).result()\n"
        "    return gs.System(mass=[[1.0]], damping=[[1.0]], stiffness=[[law.force(1.0)]])\n",
    )  # fmt: skip
    del tables["sweep"][0]["K_c"], tables["sweep"][0]["gap"]
    study = gs.Study.from_dict(tables)
    assert study.model.default.stiffness.tolist() == [[2.0]]


def test_what_is_no_system_is_told_by_its_type(tmp_path, monkeypatch):
    """Its own words may raise anything."""
    tables = of_function(
        tmp_path, monkeypatch, "mute",
        "class Mute:\n    def __repr__(self):\n        raise SystemExit\n\n\n"
        "def make(k):\n    return Mute()\n",
    )  # fmt: skip
    with pytest.raises(gs.StudyError, match=r"must return a gapsweep\.System, not Mute"):
        gs.Study.from_dict(tables)


@pytest.mark.parametrize(
    ("name", "more", "at"),
    [("loose", "next(count)", ""), ("sometimes", "0.0 if k == 1.0 else next(count)", " at k = 2")],
)
def test_a_function_of_more_than_its_arguments_is_refused(tmp_path, monkeypatch, name, more, at):
    tables = of_function(
        tmp_path, monkeypatch, name,
        "import itertools\nimport gapsweep as gs\n\ncount = itertools.count()\n\n\n"
        f"def make(k):\n    mass = [[1.0 + ({more})]]\n"
        "    return gs.System(mass=mass, stiffness=[[k]], contacts={'stop': [1.0]})\n",
    )  # fmt: skip
    with pytest.raises(gs.StudyError, match=f"system{at}: two calls return different systems"):
        gs.Study.from_dict(tables).model.at({"k": 2.0})


def test_half_a_system_is_refused(tmp_path, monkeypatch):
    tables = of_function(
        tmp_path, monkeypatch, "half",
        "import gapsweep as gs\n\n\nclass make(gs.System):\n"
        "    def __init__(self, k):\n        pass\n",
    )  # fmt: skip
    with pytest.raises(gs.StudyError, match=r"half:make: AttributeError: .*no attribute 'mass'"):
        gs.Study.from_dict(tables)


def test_a_function_that_goes_elsewhere_takes_nobody_with_it(tmp_path, monkeypatch):
    tables = of_function(
        tmp_path, monkeypatch, "elsewhere",
        "import os\n\n\ndef make(k):\n    os.chdir('/')\n    raise ValueError('far away')\n",
    )  # fmt: skip
    here = os.getcwd()
    with pytest.raises(gs.StudyError, match="far away"):
        gs.Study.from_dict(tables)
    assert os.getcwd() == here


@pytest.mark.parametrize("name", ["workers", "self", "study", "along"])
def test_names_of_arguments_are_no_parameters(name):
    """`gs.query(study, workers=1)` would take the value for a number of processes."""
    tables = changed(SECTION, sweep__0__speed=[8.0])
    tables["parameters"] = {**tables["parameters"], name: 1.0}
    with pytest.raises(gs.StudyError, match=f"'{name}' is a reserved name"):
        gs.Study.from_dict(tables)


def test_datasets_say_what_system_a_function_made():
    study = gs.Study.from_dict(changed(SECTION, sweep__0__speed=[8.0, 10.0]))
    held = json.loads(study.attributes["system_json"])
    made = gs.systems.typical_section(**study.spec.parameters)
    assert_array_equal(held["stiffness"], made.stiffness)
    assert_array_equal(held["lags"]["of_lags"], made.lags.of_lags)
    assert list(held["contacts"]) == list(made.contacts)


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (
            "contacts['more'] = [1.0, 2.0]",
            r"contact 'more': has the shape \(2,\), must have \(1,\)",
        ),
        ("contacts['more'] = [float('nan')]", "contact 'more': must be finite numbers"),
        ("modulation['more'] = []", "modulation of 'more': must be one of"),
    ],
)
def test_a_system_that_was_edited_is_checked_anew(tmp_path, monkeypatch, edit, said):
    tables = of_function(
        tmp_path, monkeypatch, "changing",
        "import gapsweep as gs\n\n\ndef make(k):\n"
        f"    made = gs.System(mass=[[1.0]], stiffness=[[k]])\n    made.{edit}\n    return made\n",
    )  # fmt: skip
    with pytest.raises(gs.StudyError, match=f"system at k = 1: {said}"):
        gs.Study.from_dict(tables)


@pytest.mark.parametrize(
    ("unit", "label"), [("1", "1000/1"), ("rad", "1000/1"), ("m", "1e+06/1000")]
)
def test_gaps_of_systems_are_labelled_in_their_own_unit(unit, label):
    tables = changed(
        TWO_MASSES, sweep__0__gap=[[1e3, 1.0]], system__units={"q_1": unit, "q_2": unit}
    )
    study = gs.Study.from_dict(tables)
    (found,) = study.grid.labels("gap")
    assert [*map(float, found.split("/"))] == [*map(float, label.split("/"))]
    assert study.grid.shape == study.grid.cut(study.select(gap=found)).shape


def test_units_of_coordinates_name_columns_and_change_no_number():
    tables = changed(TWO_MASSES, system__units={"q_1": "rad"})
    one, other = (gs.Study.from_dict(each) for each in (tables, TWO_MASSES))
    keys = [points_of(each)[2].keys() for each in (tables, TWO_MASSES)]
    assert_array_equal(*keys)
    found, plain = (Layout.of(study.grid, study.steady) for study in (one, other))
    assert plain.variables["x_max"].units == "m"
    assert plain.variables["force_max"].units == "N"
    # Coordinates of different units have no common one, but each its own.
    assert not found.variables["x_max"].units
    assert one.grid.coordinates()["coordinate_unit"].tolist() == ["rad", "m"]
    assert one.grid.coordinates()["contact_unit"].tolist() == ["rad", "m"]


@pytest.mark.parametrize(
    ("units", "said"), [({"q_9": "rad"}, "must be one of q_1"), ({"q_1": "mm"}, "SI units")]
)
def test_wrong_units_of_coordinates_are_refused(units, said):
    with pytest.raises(gs.StudyError, match=said):
        gs.Study.from_dict(changed(TWO_MASSES, system__units=units))


def test_a_system_of_one_coordinate_has_the_variables_and_dimensions_of_an_oscillator():
    gear = changed(SECTION, system={"function": "gear_pair"}, parameters=None, sweep__0__speed=None)
    gear["sweep"][0]["omega"] = 0.13
    plain = {"study": {"name": "plain"}, "oscillator": PAPER, "sweep": gear["sweep"]}
    one, other = (gs.Study.from_dict(tables) for tables in (gear, plain))
    found, expected = (Layout.of(study.grid, study.steady) for study in (one, other))
    assert found.sizes == expected.sizes
    for name in ("variables", "attractor_variables"):
        here, there = getattr(found, name), getattr(expected, name)
        assert [*here] == [*there]
        assert [*map(found.within, here.values())] == [*map(expected.within, there.values())]
        assert not {COORDINATE, CONTACT, LAG} & {
            dim for v in here.values() for dim in found.within(v)
        }
    along = [
        {name: dims for name, (dims, _) in layout.coordinates(layout.grid.dims).items()}
        for layout in (found, expected)
    ]
    assert along[0] == along[1]
    assert {*along[0]} == {*one.grid.coordinates()} == {*other.grid.coordinates()}


def test_a_wrong_system_is_told_beside_a_wrong_sweep():
    study = deepcopy(TWO_MASSES)
    study["system"]["contacts"]["stop"] = [1.0]
    study["sweep"][0]["omega"] = {"start": 1.0, "stop": 2.0}
    study["sweep"][0]["Kc"] = study["sweep"][0].pop("K_c")
    with pytest.raises(gs.StudyError) as refused:
        gs.Study.from_dict(study)
    said = [problem.split(": ", 1)[1] for problem in refused.value.problems]
    assert "system: contact 'stop': has the shape (1,), must have (2,)" in said
    assert "sweep[0].omega: give step or num" in said
    assert any(problem.startswith("sweep[0].Kc") for problem in said)


@pytest.mark.parametrize("tables", [3, [], {"system": 3}, {"system": {"mass": "heavy"}}])
def test_what_is_no_study_is_refused_whatever_it_is(tables):
    with pytest.raises(gs.StudyError):
        gs.Study.from_dict(tables)
