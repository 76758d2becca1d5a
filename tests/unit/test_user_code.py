"""A study's own code as a snapshot: what it holds, what its key tells apart, how it is executed."""

import json
import pickle
import shutil
import subprocess
import sys
import traceback
from pathlib import Path

import numpy as np
import pytest
from tests.builders.cache import cells_and_keys
from tests.builders.runs import replaced

import gapsweep as gs
from gapsweep import study_code
from gapsweep.execution.plan import plan
from gapsweep.model.own_law import OwnLaw
from gapsweep.run_folder import CLAIMS, RESPONSES, SECTIONS
from gapsweep.stages import RunContext, stages_of
from gapsweep.user_code.load import load, load_module
from gapsweep.user_code.snapshot import Snapshot

SPRING = "def spring(x):\n    return K * x\n"


@pytest.fixture
def own(tmp_path):
    """Write files of a package ``own`` and take its snapshot."""

    def write(**files):
        for name, text in ({"__init__": ""} | files).items():
            path = tmp_path / "own" / name.replace("__of__", "/")
            path = path if path.suffix else path.with_suffix(".py")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        return Snapshot.of_module("own.laws", [tmp_path])

    return write


CODE = {
    "a constant": {"laws": f"K = 1.0\n{SPRING}"},
    "a helper": {"laws": f"from .helper import K\n{SPRING}", "helper": "K = 1.0\n"},
    "all of a helper": {"laws": f"from .helper import *\n{SPRING}", "helper": "K = 1.0\n"},
    "a module": {"laws": f"from . import helper\nK = helper.K\n{SPRING}", "helper": "K = 1.0\n"},
    "an absolute name": {
        "laws": "import own.helper as h\ndef spring(x):\n    return h.K * x\n",
        "helper": "import own.laws\nK = 1.0\n",
    },
    "a package": {
        "laws": f"import own.deep.far\nK = own.deep.far.K\n{SPRING}",
        "deep__of__far": "from ..helper import K\n",
        "helper": "K = 1.0\n",
    },
    "within a function": {
        "laws": "def spring(x):\n    from .helper import K\n    return K * x\n",
        "helper": "K = 1.0\n",
    },
    "a data file": {
        "laws": f'from pathlib import Path\n__data__ = ["k.csv"]\n'
        f'K = float(Path(__file__).with_name("k.csv").read_text())\n{SPRING}',
        "k.csv": "1.0",
    },
    "compiled": {
        "laws": "from numba import njit\nfrom .helper import wall\n\n"
        "@njit(cache=True)\ndef spring(x):\n    return wall(x)\n",
        "helper": "from numba import njit\n\n@njit\ndef wall(x):\n    return 1.0 * x\n",
    },
}


@pytest.mark.parametrize("how", CODE)
def test_an_edit_gives_another_key_and_what_runs_is_what_was_read(own, tmp_path, monkeypatch, how):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "numba"))
    first = own(**CODE[how])
    assert first.key == own().key, "read twice"
    assert load(first).spring(1.0) == 1.0
    for path in (tmp_path / "own").rglob("*.*"):
        if "1.0" in path.read_text():
            replaced(path, "1.0", "3.0")
    second = own()
    assert load(second).spring(1.0) == 3.0
    assert load(first).spring(1.0) == 1.0
    assert load(first) is load(first)
    assert first.key != second.key
    assert not {"own", "own.laws", "own.helper"} & set(sys.modules)
    assert not list((tmp_path / "own").rglob("__pycache__"))


WHEREVER = """
import pickle, sys
from gapsweep.user_code.load import load
print(load(pickle.load(sys.stdin.buffer)).spring(2.0))
"""


@pytest.mark.parametrize("how", CODE)
def test_a_process_without_the_files_computes_the_same(own, tmp_path, how):
    snapshot = own(**CODE[how])
    folder = tmp_path / "own"
    shutil.move(folder, tmp_path / "moved")
    moved = pickle.loads(pickle.dumps(snapshot))
    assert moved == snapshot
    done = subprocess.run(
        [sys.executable, "-c", WHEREVER], input=pickle.dumps(snapshot), capture_output=True,
        cwd="/", check=True,
    )  # fmt: skip
    assert done.stdout.strip() == b"2.0"
    assert not folder.exists()


def test_the_key_tells_the_code_wherever_it_stands(own, tmp_path):
    before = own(**CODE["a data file"])
    (tmp_path / "elsewhere").mkdir()
    shutil.move(tmp_path / "own", tmp_path / "elsewhere" / "own")
    after = Snapshot.of_module("own.laws", [tmp_path / "elsewhere"])
    assert after == before
    (tmp_path / "elsewhere" / "own" / "stranger.py").write_text("K = 2.0\n")
    assert Snapshot.of_module("own.laws", [tmp_path / "elsewhere"]) == before


def test_versions_stand_for_what_is_installed(own, monkeypatch):
    found = own(laws=f"import math, numpy as np, gapsweep\nK = np.pi\n{SPRING}")
    assert set(found.versions) == {"numpy"}
    other = Snapshot(found.main, found.modules, {"numpy": "0.1"})
    assert other != found
    with pytest.raises(gs.ClusterError, match=r"imports numpy 0\.1, but a process has \d"):
        load(other)


def test_an_installed_module_is_read_and_its_versions_count(tmp_path, monkeypatch):
    folder = tmp_path / "site-packages"
    folder.mkdir()
    (folder / "installed_law.py").write_text(f"import numpy\nK = 1.0\n{SPRING}")
    monkeypatch.syspath_prepend(folder)
    before = Snapshot.of_module("installed_law")
    replaced(folder / "installed_law.py", "1.0", "2.0")
    after = Snapshot.of_module("installed_law")
    assert set(after.versions) == {"numpy"}
    assert (load(before).spring(1.0), load(after).spring(1.0)) == (1.0, 2.0)


def test_libraries_come_before_files_that_lie_about(tmp_path):
    for name in ("numpy", "queue"):
        (tmp_path / f"{name}.py").write_text("raise RuntimeError('not this one')\n")
    (tmp_path / "near.py").write_text(f"import numpy, queue\nK = 1.0\n{SPRING}")
    found = Snapshot.of_module("near", [tmp_path])
    assert load(found).spring(1.0) == 1.0
    assert len(found.modules) == 2  # the file and its folder


def test_what_is_optional_may_be_absent(own):
    found = own(laws=f"try:\n    from no_such import K\nexcept ImportError:\n    K = 2.0\n{SPRING}")
    assert load(found).spring(1.0) == 2.0


def test_classes_of_a_law_can_be_told_by_the_standard_library(own):
    text = (
        "from __future__ import annotations\nimport dataclasses, pickle\n\n"
        "@dataclasses.dataclass\nclass Wall:\n    k: float = 3.0\n\n"
        "def spring(x):\n    return pickle.loads(pickle.dumps(Wall())).k * x\n"
    )
    assert load(own(laws=text)).spring(1.0) == 3.0


def test_tracebacks_show_file_line_and_source(own, tmp_path):
    module = load(own(laws="def spring(x):\n    return x / 0  # here\n"))
    shutil.rmtree(tmp_path / "own")
    with pytest.raises(ZeroDivisionError) as raised:
        module.spring(1.0)
    shown = "".join(traceback.format_exception(raised.value))
    assert f'{tmp_path / "own" / "laws.py"}", line 2' in shown
    assert "# here" in shown


def law_of(own, tmp_path, **files):
    own(**files)
    return OwnLaw.of("own.laws:spring", [tmp_path]).law(0.0, gs.Gap(0.0, 0.0))


@pytest.mark.parametrize(
    ("laws", "message"),
    [
        ("import own._fast\n", r"laws\.py:1: .*No module named 'own\._fast'"),
        ("a = 1\ndef spring(x:\n", r"laws\.py:2: SyntaxError: '\(' was never closed"),
        ("a = '\0'\n", r"laws\.py: .*null bytes"),
        ("\n1 / 0\n", r"laws\.py:2: importing it raised ZeroDivisionError"),
        ("raise SystemExit(3)\n", r"laws\.py:1: importing it raised SystemExit: 3"),
        ("import no_such\n", r"laws\.py:1: .*No module named 'no_such'"),
        ("from .gone import a\n", r"laws\.py:1: .*No module named 'own\.gone'"),
        ("from .helper import gone\n", r"laws\.py:1: .*cannot import name 'gone' from 'own\.help"),
        ("from ...above import x\n", r"laws\.py:1: .*beyond top-level"),
        ("from . import broken\n", r"broken\.py:1: importing it raised NameError"),
        ("import importlib\nh = importlib.import_module('own.h')\n", r"line 2: import_module:"),
        ("h = __import__('own' + '.helper')\n", r"No module named 'own\.helper'"),
        ("h = __import__('loose')\n", r"No module named 'loose'"),
        ("K = 1.0\n", r"laws\.py: defines no 'spring'"),
        ("spring = 3.0\n", r"function = 3\.0: must be a function of x;"),
        ("def spring(x):\n    return 'a'\n", r"own\.laws:spring\(0\.0\) raised TypeError"),
        ('__data__ = ["k.csv"]\n', r"k\.csv: cannot be read: No such file"),
        ('__data__ = ["../k.csv"]\n', r"laws\.py: line 1: __data__: must be a list of file names"),
        ("__data__ = glob('*.csv')\n", r"laws\.py: line 1: __data__: must be a list of file names"),
    ],
)  # fmt: skip
def test_code_that_is_wrong_is_one_line(own, tmp_path, monkeypatch, laws, message):
    (tmp_path / "aside").mkdir()
    (tmp_path / "aside" / "loose.py").write_text("K = 1.0\n")
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "_fast.so").write_bytes(b"")
    with pytest.raises(gs.ModelError, match=message) as refused:
        law_of(own, tmp_path, laws=laws, helper="K = 1.0\n", broken="K = k\n")
    assert len(str(refused.value).splitlines()) == 1
    assert "gapsweep_user" not in str(refused.value)  # as modules of a snapshot are named


@pytest.mark.parametrize("label", ["no_such.laws:f", "math:sin", "__main__:f", "own.laws.f:f"])
def test_a_law_that_is_nowhere_is_one_line(own, tmp_path, label):
    own(laws="")
    with pytest.raises(gs.ModelError, match=f"^'{label}': No (user )?module named") as refused:
        OwnLaw.of(label, [tmp_path])
    assert len(str(refused.value).splitlines()) == 1


def test_a_study_reads_a_law_once_and_a_new_run_reads_it_again(tables, tmp_path):
    path = tmp_path / "near.py"
    path.write_text("CALLS = []\nK = 1.0\ndef spring(x):\n    CALLS.append(x)\n    return K * x\n")
    tables["sweep"][0]["representation"] = ["near:spring"]
    study = gs.Study.from_dict(tables, str(tmp_path / "study.toml"))
    first = cells_and_keys(study)[1].tolist()
    replaced(path, "1.0", "3.0")
    assert cells_and_keys(study)[1].tolist() == first
    assert study.law("near:spring", 0.0, gs.Gap(0.0, 0.0)).force(1.0) == 1.0
    again = gs.Study.of(study)
    assert not {*cells_and_keys(again)[1].tolist()} & {*first}
    assert again.law("near:spring", 0.0, gs.Gap(0.0, 0.0)).force(1.0) == 3.0
    assert load(study.own_law("near:spring").source).CALLS[:1] == [0.0]


HERTZ = """
import math
def depth(x):
    return abs(x) - 0.4e-3
def wall(x, n):
    d = depth(x)
    return 0.0 if d <= 0.0 else math.copysign(1e6 * d**n, x)
def spring(x):
    return 1e3 * x
"""


@pytest.fixture
def hertz(tables, tmp_path):
    """Tables of a study with a law whose exponent is swept, and where they are."""
    (tmp_path / "hertz.py").write_text(HERTZ)
    tables["sweep"][0] |= {"representation": ["hertz:wall", "piecewise", "hertz:spring"]}
    tables["sweep"][0] |= {"n": [1.6, 1.4], "omega": [8.0, 12.0]}
    return tables | {"parameters": {"n": 1.5}}, str(tmp_path / "study.toml")


def keys_on_grid(study):
    cells, keys = cells_and_keys(study)
    found = np.empty(study.grid.shape, keys.dtype)
    found.flat[cells] = keys
    return found


def test_parameters_of_a_law_are_an_axis_and_part_of_keys(hertz):
    tables, source = hertz
    study = gs.Study.from_dict(tables, source)
    assert study.grid.axes["n"] == (1.4, 1.6)
    assert gs.Study.from_dict(json.loads(study.json), source).json == study.json
    keys = keys_on_grid(study)  # the last axes: omega, n, start
    wall, exact, spring = (keys[i, 0, 0, :, :, 0] for i in range(3))
    assert len({*wall.ravel().tolist()}) == 4
    for other in (exact, spring):  # which do not depend on it
        assert (other[:, 0] == other[:, 1]).all()
    tables["sweep"][0]["n"] = [1.6, 1.5]
    again = keys_on_grid(gs.Study.from_dict(tables, source))
    assert (again[0, 0, 0, :, 1, 0] == wall[:, 1]).all()
    assert not {*again[0, 0, 0, :, 0, 0].tolist()} & {*wall.ravel().tolist()}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"parameters": {"n": 1.5, "m": 2.0}}, "parameters: m: must be arguments of hertz:wall"),
        ({"parameters": {"n": 1.5, "mass": 2.0}}, "'mass' is a reserved name"),
        ({"parameters": {"n": 1.5, "c": 2.0}}, "'c' is a reserved name"),
        ({"parameters": {"n": 1.5, "a b": 2.0}}, "'a b': must be a name of letters"),
        ({"parameters": {"n": "1.5"}}, r"parameters.n = '1.5': must be a number"),
        ({"parameters": {}}, r"sweep\[0\].n = .*unknown key"),
    ],
)
def test_parameters_that_no_law_takes_are_refused(hertz, change, message):
    tables, source = hertz
    with pytest.raises(gs.StudyError, match=message):
        plan(gs.Study.from_dict(tables | change, source))


def test_a_law_without_the_value_of_a_parameter_says_where_to_write_it(hertz):
    tables, source = hertz
    del tables["sweep"][0]["n"], tables["parameters"]
    with pytest.raises(gs.ModelError, match=r"hertz:wall\(x, n\).*\[parameters\]"):
        plan(gs.Study.from_dict(tables, source))


def test_a_table_travels_as_its_numbers(tables, tmp_path):
    keys = []
    for text in ("x=[-1, 1]", "x=[-1.0, +1.0]", "x=[-1, 2]"):
        table = f"import gapsweep as gs\nwall = gs.ForceTable({text}, F=[-1, 1])\n"
        (tmp_path / "measured.py").write_text(table)
        tables["sweep"][0]["representation"] = ["measured:wall"]
        study = gs.Study.from_dict(tables, str(tmp_path / "study.toml"))
        ((_, points),) = study.points(cells_and_keys(study)[0][:1])
        assert isinstance(points.kind.own.source, gs.ForceTable)
        keys.append(points.keys().tolist())
    assert keys[0] == keys[1] != keys[2]


@pytest.mark.parametrize("where", ["histories", "work_precision"])
def test_a_law_outside_of_sweeps_is_what_its_dataset_is_made_from(tables, tmp_path, where):
    (tmp_path / "near.py").write_text(f"from helper import K\n{SPRING}")
    (tmp_path / "helper.py").write_text("K = 1.0\n")
    scene = {"K_c": 1.4e4, "gap": [4e-4, 4e-4], "omega": 11.0}
    if where == "histories":
        tables["history"] = [scene | {"representation": ["near:spring"], "t_end": 2.0}]
    else:
        method = {"label": "near:spring", "rtol": [1e-3]}
        tables["bench"] = {"scene": [{"name": "one"} | scene], "method": [method]}
    study = gs.Study.from_dict(tables, str(tmp_path / "study.toml"))
    (stage,) = (s for s in stages_of(study) if s.file == f"{where}.nc")

    def made_from(study):
        return stage.made_from(tmp_path, RunContext(tmp_path, study))

    before = made_from(study)
    replaced(tmp_path / "helper.py", "1.0", "2.0")
    assert made_from(study) == before
    assert made_from(gs.Study.of(study)) != before


# --- modules next to a study ---------------------------------------------------------------------

MAIN = (
    "from . import other\nfrom .near import one\nimport near\n\n\ndef value():\n    return one()\n"
)


@pytest.fixture
def main(tmp_path):
    (tmp_path / "main.py").write_text(MAIN)
    (tmp_path / "near.py").write_text("from .far import VALUE\n\n\ndef one():\n    return VALUE\n")
    (tmp_path / "far.py").write_text("VALUE = 1\n")
    (tmp_path / "other.py").write_text("import json\nimport gapsweep.model.contact\n")
    (tmp_path / "alone.py").write_text("raise SystemExit('imported by nobody')\n")
    return tmp_path / "main.py"


def test_neighbours_are_imported_from_any_folder(main, monkeypatch):
    monkeypatch.chdir("/")
    before = Snapshot.of_file(main)
    assert load_module(before).value() == 1
    assert len(before.modules) == 7  # near both ways, far as near finds it, and their folder
    replaced(main.parent / "far.py", "1", "5")
    assert load_module(Snapshot.of_file(main)).value() == 5
    assert load_module(before).value() == 1


@pytest.mark.parametrize(
    ("mine", "edit", "is_other"),
    [
        ("one", "main.py", False),
        ("one", "far.py", True),
        ("value", "main.py", True),
        ("lambda: one()", "main.py", True),
    ],
)
def test_a_dataset_depends_on_the_code_that_makes_it(tables, main, mine, edit, is_other):
    main.write_text(f"{MAIN}\n\nREST = 1\nDATASETS = {{'mine': {mine}}}\n")
    given = tables | {"claims": {"module": "main.py"}}
    study = gs.Study.from_dict(given, str(main.with_name("study.toml")))

    def made_from(study):
        run = RunContext(main.parent, study)
        return {s.file: s.made_from(main.parent, run) for s in stages_of(study)[-3:-1]}

    before = made_from(study)
    replaced(main.with_name(edit), "= 1", "= 2")
    after = made_from(gs.Study.of(study))
    assert list(before) == ["mine.nc", CLAIMS]
    assert (after["mine.nc"] != before["mine.nc"]) == is_other
    assert after[CLAIMS] != before[CLAIMS]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("main.py", "b = (\n", "main.py:1: SyntaxError: '(' was never closed"),
        ("near.py", "OTHER = 1\n", "main.py:2: ImportError: cannot import name 'one'"),
        ("near.py", "from .gone import a\n", "near.py:1: ModuleNotFoundError: No module named"),
        ("far.py", "VALUE = 1 / 0\n", "far.py:1: ZeroDivisionError: division by zero"),
        ("far.py", "\nraise SystemExit\n", "far.py:2: SystemExit"),
        ("far.py", "open('/absent')\n", "far.py:1: FileNotFoundError: [Errno 2]"),
    ],
)
def test_broken_modules_are_one_line(tables, main, name, text, message):
    (main.parent / name).write_text(text)
    given = tables | {"claims": {"module": "main.py"}}
    study = gs.Study.from_dict(given, str(main.with_name("study.toml")))
    with pytest.raises(gs.StudyError) as refused:
        study_code.check_modules(study)
    (line,) = refused.value.problems
    assert line.startswith(str(main.parent))
    assert message in line
    assert "\n" not in line


def test_own_datasets_come_before_what_reads_them(tables, main):
    main.write_text("DATASETS = {'mine': len}\n")
    own = {"claims": {"module": "main.py"}, "report": {"module": "main.py"}}
    study = gs.Study.from_dict(tables | own, str(main.with_name("study.toml")))
    found = {s.file: s.inputs for s in stages_of(study)}
    assert list(found).index("mine.nc") < list(found).index(CLAIMS)
    for file in (CLAIMS, SECTIONS):
        assert {RESPONSES, "mine.nc"} <= set(found[file])


@pytest.mark.parametrize("name", ["paper/study.toml", "table2.toml"])
def test_the_papers_own_code_is_sound(name):
    study_code.check_modules(gs.Study.load(Path(__file__).parents[2] / "workflows" / name))


@pytest.mark.parametrize(
    ("own", "message"),
    [
        ({"claims": {"module": "absent.py"}}, "claims.module: .*absent.py cannot be read: No such"),
        ({"report": {"module": "deep.py"}}, "report.module: .*deep.py cannot be read: Is a dir"),
        ({"claims": {"module": "a.toml"}}, "claims.module = 'a.toml': must be .* Python file"),
        ({"report": {"module": "a-b.py"}}, "report.module = 'a-b.py': must be .* Python file"),
    ],
)
def test_a_study_refuses_modules_in_one_line(tables, tmp_path, own, message):
    (tmp_path / "deep.py").mkdir()
    with pytest.raises(gs.StudyError, match=message) as refused:
        gs.Study.from_dict(tables | own, str(tmp_path / "study.toml"))
    assert len(refused.value.problems) == 1


def test_a_data_file_that_is_not_named_is_told_by_its_name(tmp_path):
    (tmp_path / "k.csv").write_text("1.0")
    (tmp_path / "reading.py").write_text(
        "from pathlib import Path\n"
        "K = float((Path(__file__).parent / 'k.csv').read_text())\n"
        "def law(x): return K * x\n"
    )
    with pytest.raises(gs.ModelError, match=r'__data__ = \["k.csv"\]'):
        OwnLaw.of("reading:law", [tmp_path]).load()
