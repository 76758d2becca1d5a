"""A user's own law: what its code is, what is refused, and that the files decide."""

import importlib
import importlib.machinery
import json
import os
import py_compile
import subprocess
import sys

import pytest

import gapsweep as gs
from gapsweep import stages
from gapsweep.execution.plan import plan
from gapsweep.model import own_law

LABEL = "own.laws:spring"


@pytest.fixture
def own(tmp_path, monkeypatch):
    """Write modules of a package ``own``, and import nothing of older ones."""

    def write(**modules):
        folder = tmp_path / "own"
        folder.mkdir(exist_ok=True)
        for name, text in ({"__init__": ""} | modules).items():
            (folder / f"{name}.py").write_text(text)
        own_law.refresh()
        return folder

    monkeypatch.syspath_prepend(tmp_path)
    yield write
    own_law._loaded.clear()
    for name in [n for n in sys.modules if n.partition(".")[0] in ("own", "beside")]:
        del sys.modules[name]


def code():
    own_law.refresh()
    return own_law.code(LABEL)


def force(x=1.0):
    own_law.refresh()
    return own_law.function(LABEL)(x)


SPRING = "def spring(x):\n    return K * x\n"


@pytest.mark.parametrize(
    ("laws", "helper"),
    [
        (f"K = 1.0\n{SPRING}", ""),
        (f"from .helper import K\n{SPRING}", "K = 1.0\n"),
        (f"from .helper import *\n{SPRING}", "K = 1.0\n"),
        (f"from . import helper\nK = helper.K\n{SPRING}", "K = 1.0\n"),
        (f"import own.helper\nK = own.helper.K\n{SPRING}", "K = 1.0\n"),
        ("def spring(x):\n    from .helper import K\n    return K * x\n", "K = 1.0\n"),
        ("from own.helper import spring\n", "def spring(x, k=1.0):\n    return k * x\n"),
        (
            "from functools import partial\nfrom .helper import line\nspring = partial(line, 1.0)",
            "def line(k, x):\n    return k * x\n",
        ),
        (
            "from .helper import made\nspring = made()\n",
            "def made(k=1.0):\n    return lambda x: k * x\n",
        ),
        (
            "from .helper import twice\n\n@twice\ndef spring(x):\n    return x\n",
            "def twice(f):\n    return lambda x: 1.0 * f(x)\n",
        ),
        (f"try:\n    from .helper import K\nexcept ImportError:\n    K = 2.0\n{SPRING}", "K = 1.0"),
    ],
)  # fmt: skip
def test_every_number_that_a_law_uses_is_in_its_code(own, laws, helper):
    folder = own(laws=laws, helper=helper)
    before = code(), force()
    for name in ("laws", "helper"):
        path = folder / f"{name}.py"
        path.write_text(path.read_text().replace("1.0", "3.0"))
    after = code(), force()
    assert before[1] == 1.0
    assert after[1] == 3.0
    assert before[0] != after[0]


# Below `FIRST`, the first number of a file.
FROM_OUTSIDE = {
    "number": "def spring(x):\n    return FIRST * x\n",
    "array": "T = np.array([FIRST, 2.0])\ndel FIRST\ndef spring(x):\n    return T[0] * x\n",
    "dict": "T = {'k': [FIRST]}\ndel FIRST\nspring = lambda x: T['k'][0] * x\n",
    "closure": "def made(k):\n    return lambda x: k * x\nspring = made(FIRST)\ndel FIRST\n",
    "default": "def spring(x, k=FIRST):\n    return k * x\ndel FIRST\n",
    "partial": "from functools import partial\nspring = partial(float.__mul__, FIRST)\ndel FIRST\n",
    "class": "class Wall:\n    k = FIRST\ndel FIRST\ndef spring(x):\n    return Wall.k * x\n",
    "object": (
        "class Wall:\n    def __init__(self, k):\n        self.k = k\n"
        "wall = Wall(FIRST)\ndel FIRST\ndef spring(x):\n    return wall.k * x\n"
    ),
    "spline": (
        "from scipy.interpolate import CubicSpline\ns = CubicSpline([0, 1], [0.0, FIRST])\n"
        "del FIRST\ndef spring(x):\n    return float(s(x))\n"
    ),
}


@pytest.mark.parametrize("how", FROM_OUTSIDE)
def test_numbers_read_when_the_module_is_imported_are_in_its_code(own, tmp_path, how):
    file = tmp_path / "table.txt"
    file.write_text("1.0\n2.0\n")
    first = f"import numpy as np\nFIRST = np.loadtxt({str(file)!r})[0]\n"
    own(laws=first + FROM_OUTSIDE[how])
    before = code(), force()
    assert own_law.code(LABEL) == before[0]
    file.write_text("4.0\n2.0\n")
    after = code(), force()
    assert (before[1], after[1]) == (1.0, 4.0)
    assert before[0] != after[0]


def test_comments_docstrings_and_the_machine_are_not(own, tmp_path):
    text = f'"""Laws."""\nimport os\nHERE = os.path.dirname(__file__)\nK = 1.0  # N/m\n{SPRING}'
    folder = own(laws=text)
    before = code()
    own(laws=text.replace("# N/m", "# stiffness").replace("Laws.", "My laws."))
    assert code() == before
    # Elsewhere, in another process.
    other = tmp_path / "elsewhere"
    other.mkdir()
    folder.rename(other / "own")
    program = f"from gapsweep.model import own_law; print(own_law.code({LABEL!r}))"
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | {"PYTHONPATH": str(other), "PYTHONHASHSEED": "7"},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.strip() == before


def test_versions_stand_in_for_what_is_installed(own, monkeypatch):
    own(laws="import numpy as np\nimport math\ndef spring(x):\n    return np.sin(x)\n")
    assert json.loads(code())["numpy"] == importlib.metadata.version("numpy")
    assert {name for name in json.loads(code()) if not name.startswith("own")} == {"numpy"}
    before = code()
    monkeypatch.setattr(own_law, "_version", lambda package: "0.1")
    assert code() != before


@pytest.mark.parametrize(
    ("laws", "message"),
    [
        (
            "import own._fast\ndef spring(x):\n    return x\n",
            r"_fast.*: cannot be keyed: must be a",
        ),
        ("def spring(x:\n", r"laws.py: cannot be keyed: "),
        ("1 / 0\n", r"own.laws:spring.*importing it raised ZeroDivisionError"),
        ("raise SystemExit(3)\n", r"importing it raised SystemExit: 3"),
        ("import no_such\n", r"No module named 'no_such'; the module must be importable here"),
        (
            "import importlib\nhelper = importlib.import_module('own.' + 'helper')\n"
            "def spring(x):\n    return x\n",
            r"uses own.helper \(.*\), which no import statement leads to",
        ),
        (
            "import importlib\nK = importlib.import_module('own.' + 'helper').line\n"
            "def spring(x):\n    return x\n",
            r"uses own.helper \(.*\), which no import statement leads to",
        ),
        (
            "import os, sys\nsys.path.append(os.path.join(os.path.dirname(__file__), 'more'))\n"
            "import beside\ndef spring(x):\n    return x\n",
            r"own.laws uses beside \(.*\), which no import statement leads to",
        ),
    ],
)
def test_what_cannot_be_keyed_is_refused_by_name(own, laws, message, monkeypatch):
    folder = own(laws=laws, helper="def line(x):\n    return x\n")
    (folder / f"_fast{importlib.machinery.EXTENSION_SUFFIXES[0]}").write_bytes(b"")
    (folder / "more").mkdir()
    (folder / "more" / "beside.py").write_text("K = 1.0\n")
    monkeypatch.setattr(sys, "path", [*sys.path])
    with pytest.raises(gs.ModelError, match=message) as refused:
        code()
    assert len(str(refused.value).splitlines()) == 1


def test_a_notebooks_own_function_has_no_module_that_workers_could_import():
    with pytest.raises(gs.ModelError, match="__main__"):
        own_law.code("__main__:spring")


def test_byte_code_of_an_older_file_is_not_believed(own):
    folder = own(laws=f"K = 1.0\n{SPRING}")
    path = folder / "laws.py"
    os.utime(path, (1e9, 1e9))
    py_compile.compile(str(path))
    path.write_text(path.read_text().replace("1.0", "2.0"))
    os.utime(path, (1e9, 1e9))  # edited within the second, to the same size
    assert force() == 2.0


def test_the_file_decides_whatever_is_in_memory(own):
    folder = own(laws=f"K = 1.0\n{SPRING}")
    laws = importlib.import_module("own.laws")
    (folder / "laws.py").write_text(f"K = 2.0\n{SPRING}")
    first = code()
    assert force() == 2.0, "imported before it was edited"
    assert laws.spring(1.0) == 1.0, "what somebody else holds stays as it was"
    own_law.function(LABEL).__globals__["K"] = 5.0
    assert (force(), code()) == (2.0, first)
    (folder / "laws.py").write_text(f"K = 33.0\n{SPRING}")
    importlib.reload(importlib.import_module("own.laws"))
    assert force() == 33.0
    assert code() != first


def test_a_law_in_use_stays_as_it_was_until_it_is_asked_for_anew(own):
    folder = own(laws=f"K = 1.0\n{SPRING}")
    before = own_law.code(LABEL)
    (folder / "laws.py").write_text(f"K = 2.0\n{SPRING}")
    own_law.require(LABEL, before)
    assert own_law.function(LABEL)(1.0) == 1.0
    with pytest.raises(gs.ClusterError, match=r"^'own.laws:spring': own.laws differ between"):
        own_law.require(LABEL, before.replace(before[-8:-2], "000000"))
    assert own_law.function(LABEL)(1.0) == 2.0


def test_other_modules_of_the_package_stay_where_they_are(own):
    folder = own(laws=f"K = 1.0\n{SPRING}", plots="n_imported = 1\n")
    force()
    plots = importlib.import_module("own.plots")
    (folder / "laws.py").write_text(f"K = 2.0\n{SPRING}")
    assert force() == 2.0
    assert sys.modules["own"].plots is plots


def test_a_law_that_is_installed_is_still_what_its_file_says(tmp_path, monkeypatch):
    folder = tmp_path / "site-packages"
    folder.mkdir()
    (folder / "installed_law.py").write_text(f"K = 1.0\n{SPRING}")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setattr(own_law, "_version", lambda package: "0.1")
    label = "installed_law:spring"
    before = own_law.code(label)
    (folder / "installed_law.py").write_text(f"K = 2.0\n{SPRING}")
    own_law.refresh()
    assert own_law.code(label) != before
    assert own_law.function(label)(1.0) == 2.0
    own_law.refresh()


def test_a_study_tries_a_law_out_once_for_every_code(own, tables):
    folder = own(
        laws="K = 1.0\nCALLS = []\n\ndef spring(x):\n    CALLS.append(x)\n    return K * x\n"
    )
    tables["sweep"][0]["representation"] = [LABEL]
    study = gs.Study.from_dict(tables)
    first = plan(study).keys
    assert own_law.function(LABEL).__globals__["CALLS"] == [0.0]
    assert plan(study).keys == first
    (folder / "laws.py").write_text("spring = 3.0\n")
    with pytest.raises(gs.ModelError, match=r"^function = 3\.0: must be a function of x;"):
        plan(study)
    (folder / "laws.py").write_text("")
    with pytest.raises(
        gs.ModelError, match=r"^'own.laws:spring': .* has no attribute 'spring'; the"
    ):
        plan(study)


def test_folders_without_an_init_file_are_packages_too(own, tmp_path):
    folder = own() / "deeper" / "down"
    folder.mkdir(parents=True)
    label = "own.deeper.down.laws:spring"
    (folder / "laws.py").write_text(f"from ... import helper\nfrom .k import K\n{SPRING}")
    for number in (1.0, 2.0):
        (folder / "k.py").write_text(f"K = {number}\n")
        own(helper="")
        assert own_law.function(label)(1.0) == number
    assert {"own", "own.helper", "own.deeper.down.k"} < set(json.loads(own_law.code(label)))


def test_machine_code_that_numba_keeps_is_not_that_of_an_older_helper(own, monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "numba"))
    laws = (
        "from numba import njit\nfrom .helper import wall\n\n"
        "@njit(cache=True)\ndef spring(x):\n    return wall(x)\n"
    )
    helper = "from numba import njit\n\n@njit\ndef wall(x):\n    return 1.0 * x\n"
    folder = own(laws=laws, helper=helper)
    assert force() == 1.0
    (folder / "helper.py").write_text(helper.replace("1.0", "2.0"))
    assert force() == 2.0


@pytest.mark.parametrize("where", ["history", "bench"])
def test_a_law_outside_of_sweeps_is_what_its_dataset_is_made_from(own, tables, where):
    folder = own(laws=f"from .helper import K\n{SPRING}", helper="K = 1.0\n")
    scene = {"K_c": 1.4e4, "gap": [4e-4, 4e-4], "omega": 11.0}
    if where == "history":
        tables["history"] = [scene | {"representation": [LABEL], "t_end": 2.0}]
    else:
        method = {"label": LABEL, "rtol": [1e-3]}
        tables["bench"] = {"scene": [{"name": "one"} | scene], "method": [method]}
    study = gs.Study.from_dict(tables)
    before = stages.study_source(study)
    (folder / "helper.py").write_text("K = 2.0\n")
    own_law.refresh()
    assert stages.study_source(study) != before
