"""A user's own law: what its code is, what is refused, and that the files decide."""

import importlib
import importlib.machinery
import json
import os
import py_compile
import subprocess
import sys

import numpy as np
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
    return own_law.named(LABEL)(x)


SPRING = "def spring(x):\n    return K * x\n"


def test_a_helper_imported_within_a_function_is_read_from_its_file(own, monkeypatch):
    """Its byte code looks current: of the same size, and of the same second."""
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    folder = own(
        laws="def spring(x):\n    from .helper import K\n    return K * x\n", helper="K = 1.0\n"
    )
    helper = folder / "helper.py"
    assert force() == 1.0
    second = helper.stat().st_mtime
    helper.write_text("K = 3.0\n")
    os.utime(helper, (second, second))
    assert force() == 3.0


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


def test_numbers_read_by_a_module_that_only_the_law_imports_are_in_its_code(own, tmp_path):
    file = tmp_path / "table.txt"
    file.write_text("1.0\n2.0\n")
    own(
        laws="def spring(x):\n    from .tables import K\n    return K * x\n",
        tables=f"import numpy as np\nK = float(np.loadtxt({str(file)!r})[0])\n",
    )
    before = code(), force()
    file.write_text("4.0\n2.0\n")
    after = code(), force()
    assert (before[1], after[1]) == (1.0, 4.0)
    assert before[0] != after[0]


def test_a_module_that_cannot_be_imported_and_is_not_needed_stands_in_nobodys_way(own):
    own(
        laws="def spring(x):\n    return x\ndef never():\n    from . import broken\n",
        broken="raise RuntimeError('not here')\n",
    )
    assert force(2.0) == 2.0


# Of `X`, which the environment decides.
SOFT_AND_HARD = "def soft(x):\n    return x\n\ndef hard(x):\n    return 3 * x\n\n"
LOCAL = "def made(k):\n    return lambda x: k * x\n\n"
CHOSEN = {
    "function by name": f"{SOFT_AND_HARD}spring = hard if X == '1.0' else soft\n",
    "function in a table": f"{SOFT_AND_HARD}spring = {{'1.0': soft}}.get(X, hard)\n",
    "local function": (
        "def made():\n    if X == '1.0':\n        f = lambda x: x\n"
        "    else:\n        f = lambda x: 2 * x\n    return f\nspring = made()\n"
    ),
    "eval": "spring = eval(f'lambda x: {X} * x')\n",
    "eval of names": "spring = eval('lambda x: a' + ('x' if X == '1.0' else 'y'))\n",
    "exec": "space = {'k': float(X)}\nexec('def spring(x):\\n    return k * x', space)\n"
    "spring = space['spring']\ndel space\n",
    "builtin": "import math\nspring = getattr(math, 'sin' if X == '1.0' else 'cos')\n",
    "bare builtin": "spring = abs if X == '1.0' else float\n",
    "ufunc": "import numpy as np\nspring = np.sin if X == '1.0' else np.cos\n",
    "numpy function": "import numpy as np\nspring = np.sum if X == '1.0' else np.prod\n",
    "module": "import cmath, math\nm = math if X == '1.0' else cmath\n",
    "attribute of a function": "def spring(x):\n    return spring.k * x\nspring.k = float(X)\n",
    "keyword default": "def spring(x, *, k=float(X)):\n    return k * x\n",
    "bound method": (
        "class Wall:\n    def __init__(self, k):\n        self.k = k\n"
        "    def force(self, x):\n        return self.k * x\nspring = Wall(float(X)).force\n"
    ),
    "method of a copy": "spring = float(X).__mul__\n",
    "lru_cache": f"import functools\n{LOCAL}spring = functools.lru_cache(made(float(X)))\n",
    "cached property": (
        f"import functools\n{LOCAL}class A:\n    k = functools.cached_property(made(X))\n"
    ),
    "slots": (
        "class Wall:\n    __slots__ = ('k',)\n    def __init__(self, k):\n        self.k = k\n"
        "    def __call__(self, x):\n        return self.k * x\nspring = Wall(float(X))\n"
    ),
    "an object that tells a copy nothing": (
        "class Wall:\n    def __reduce__(self):\n        return Wall, ()\n"
        "wall = Wall()\nwall.k = float(X)\n"
    ),
    "classmethod": f"{LOCAL}class A:\n    spring = classmethod(made(float(X)))\n",
    "staticmethod": f"{LOCAL}class A:\n    spring = staticmethod(made(float(X)))\n",
    "property": f"{LOCAL}class A:\n    spring = property(made(float(X)))\n",
    "base": "A = type('A', (int if X == '1.0' else float,), {})\n",
    "namespace": "import types\nT = types.SimpleNamespace(k=float(X))\n",
    "deque": "import collections\nT = collections.deque([float(X)])\n",
    "array.array": "import array\nT = array.array('d', [float(X)])\n",
    "bytearray": "T = bytearray(X.encode())\n",
    "attrgetter": "import operator\nT = operator.attrgetter('a' if X == '1.0' else 'b')\n",
    "configuration": (
        "import configparser\nT = configparser.ConfigParser()\n"
        "T.read_string('[a]\\nk = ' + X)\n"
    ),
    "np.vectorize": f"import numpy as np\n{LOCAL}spring = np.vectorize(made(float(X)))\n",
    "subclass of arrays": (
        "import numpy as np\nclass A(np.ndarray):\n    pass\n"
        "T = np.zeros(2).view(A)\nT.k = float(X)\n"
    ),
    "array of objects": f"import numpy as np\n{LOCAL}T = np.array([made(X)], dtype=object)\n",
    "array of no import": "from scipy import linalg\nT = linalg.hilbert(2) * float(X)\n",
    "numba": f"import numba\n{LOCAL}spring = numba.njit(made(float(X)))\n",
    "numba option": f"import numba\n{LOCAL}spring = numba.njit(made(1), fastmath=X == '1.0')\n",
    "numba type": "import numba\nT = numba.float32 if X == '1.0' else numba.float64\n",
    "numba vectorize": f"import numba\n{LOCAL}spring = numba.vectorize(made(float(X)))\n",
    "enumeration": "import enum\nclass E(enum.Enum):\n    A = float(X)\n",
    "member": "import enum\nE = enum.Enum('E', 'A B')\nT = E.A if X == '1.0' else E.B\n",
    "dataclass": "import dataclasses\n@dataclasses.dataclass\nclass D:\n    k: float = float(X)\n",
    "named tuple": "from typing import NamedTuple\nclass N(NamedTuple):\n    k: float = float(X)\n",
    "pattern": "import re\nT = re.compile(X)\n",
    "logger": "import logging\nT = logging.getLogger(X)\n",
    "set": "T = {frozenset([X, 'a']), 3}\n",
    "subclass of int": "class I(int):\n    pass\nT = I(float(X))\n",
    "text with a stroke": "T = 'a/' + X\n",
    "absolute text": "T = '/' + X\n",
    "two underscores": "__K = float(X)\n",
    "entry None": "T = {'a': None} if X == '1.0' else {}\n",
    "order": "T = {'a': 1, 'b': 2} if X == '1.0' else {'b': 2, 'a': 1}\n",
    "key of a type": "T = {1: 0} if X == '1.0' else {'1': 0}\n",
    "truth or text": "T = True if X == '1.0' else 'True'\n",
    "number or text": "T = 1.0 if X == '1.0' else '1.0'\n",
    "integer or float": "T = 1 if X == '1.0' else 1.0\n",
    "truth or integer": "T = True if X == '1.0' else 1\n",
    "sign of zero": "T = 0.0 if X == '1.0' else -0.0\n",
    "list or tuple": "T = [1] if X == '1.0' else (1,)\n",
    "None or nothing": "if X == '1.0':\n    T = None\n",
    "where texts end": "T = ['ab', 'c'] if X == '1.0' else ['a', 'bc']\n",
    "which is shared": "A = []\nB = []\nT = [A, B, A] if X == '1.0' else [A, B, B]\n",
    "long integer": "T = 10**5000 + int(float(X))\n",
    "partial": "import functools\nspring = functools.partial(pow, float(X))\n",
    "union": "T = int | (float if X == '1.0' else str)\n",
}  # fmt: skip


@pytest.mark.parametrize("how", CHOSEN)
def test_whatever_the_environment_decides_is_in_the_code(own, monkeypatch, how):
    own(laws=f"import os\nX = os.environ['OWN_X']\n{CHOSEN[how]}\ndel X\n")
    found = []
    for x in ("1.0", "2.0", "1.0"):
        monkeypatch.setenv("OWN_X", x)
        found.append(code())
    assert found[0] == found[2]
    assert found[0] != found[1]


def test_the_code_is_the_same_in_every_process(own):
    more = (
        "import os, pathlib, typing\nfrom os import environ\nfrom sys import stdout\n"
        "S = {'a', 'b', 'c', ('d', 1), frozenset('xyz')}\nHERE = pathlib.Path(__file__).parent\n"
        "cycle = []\ncycle.append({'again': cycle})\nsentinel = object()\n"
        "T = typing.TypeVar('T')\nO = typing.Optional[typing.Callable[[float], 'T']]\n"
        "class P(typing.Protocol[T]):\n    def f(self) -> T: ...\n"
        "def among(x):\n    return x in {'a', 'b', 'c', 'd'}\n"
    )
    parts = {f"part{n}": f"X = '1.0'\n{text}" for n, text in enumerate(CHOSEN.values())}
    folder = own(laws="\n".join([f"from . import {', '.join(parts)}", more]), **parts)
    program = f"from gapsweep.model import own_law; print(own_law.code({LABEL!r}))"
    found = {
        subprocess.run(
            [sys.executable, "-c", program],
            env=os.environ | {"PYTHONPATH": str(folder.parent), "PYTHONHASHSEED": seed},
            capture_output=True, text=True, check=True,
        ).stdout.strip()
        for seed in ("1", "2")
    }  # fmt: skip
    assert found == {code()}


@pytest.mark.parametrize(
    ("laws", "message"),
    [
        ("import threading\nT = [threading.Lock()]\n", r"own\.laws\.T .*: a _thread\.lock: keep"),
        ("T = open(__file__)\nT.close()\n", r"own\.laws\.T .*: a _io\.TextIOWrapper: keep"),
        ("T = (i for i in ())\n", r"own\.laws\.T .*: a generator: keep"),
        ("import numpy as np\nT = np.frompyfunc(abs, 1, 1)\n", r"own\.laws\.T .*: the ufunc"),
        (
            "class A:\n    def __getattribute__(self, name):\n        raise OSError\nT = A()\n",
            r"own\.laws\.T .*: a own\.laws\.A: keep|own\.laws\.T .*: a A: OSError: keep",
        ),
        ("T = []\nfor _ in range(5000):\n    T = [T]\n", r"own\.laws\.T .*: RecursionError: keep"),
        (
            "import importlib\nT = {'a': importlib.import_module('be' + 'side')}\n",
            r"own\.laws\.T .*: the module beside, which no import",
        ),
    ],
)  # fmt: skip
def test_values_that_cannot_be_keyed_are_refused_by_name(own, laws, message):
    folder = own(laws=f"{laws}\ndef spring(x):\n    return x\n")
    (folder.parent / "beside.py").write_text("K = 1.0\n")
    with pytest.raises(gs.ModelError, match=message) as refused:
        code()
    assert len(str(refused.value).splitlines()) == 1
    assert "cannot be keyed: " in str(refused.value)


def test_an_attribute_that_raises_is_no_traceback(own):
    own(
        laws="class A:\n    def __getattr__(self, name):\n        raise RuntimeError(name)\n"
        f"T = A()\nK = 1.0\n{SPRING}"
    )
    assert force() == 1.0


@pytest.mark.parametrize(
    ("value", "name"),
    [("time.time()", "START"), ("np.random.default_rng()", "START"), ("[time.time()]", "START")],
)
def test_a_value_that_is_another_at_every_import_is_named(own, value, name):
    own(laws=f"import time\nimport numpy as np\n{name} = {value}\nK = 1.0\n{SPRING}")
    theirs = code()
    own_law.refresh()
    message = rf"own\.laws\.{name} is another at every import: make it a constant, or"
    # No ModelError: that would be stored as the result of a point.
    with pytest.raises(gs.ClusterError, match=message):
        own_law.require(LABEL, theirs)


def test_a_number_by_a_computed_import_is_keyed_as_it_is_at_import(own):
    folder = own(laws=f"K = __import__('be' + 'side').K\n{SPRING}")
    (folder.parent / "beside.py").write_text("K = 1.0\n")
    before = code()
    del sys.modules["beside"]  # as in a new process
    (folder.parent / "beside.py").write_text("K = 22.0\n")
    assert code() != before


def test_comments_docstrings_and_the_machine_are_not(own, tmp_path):
    text = f'"""Laws."""\nimport os\nHERE = os.path.dirname(__file__)\nK = 1.0  # N/m\n{SPRING}'
    text += 'def other(x):\n    """Laws."""\n    return (lambda y: y)(x), HERE\n'
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
    own_law.named(LABEL).__globals__["K"] = 5.0
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
    assert own_law.named(LABEL)(1.0) == 1.0
    with pytest.raises(gs.ClusterError, match=r"^'own.laws:spring': own.laws differ between"):
        own_law.require(LABEL, before.replace(before[-8:-2], "000000"))
    assert own_law.named(LABEL)(1.0) == 2.0


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
    assert own_law.named(label)(1.0) == 2.0
    own_law.refresh()


def test_a_study_tries_a_law_out_once_for_every_code(own, tables):
    folder = own(
        laws="K = 1.0\nCALLS = []\n\ndef spring(x):\n    CALLS.append(x)\n    return K * x\n"
    )
    tables["sweep"][0]["representation"] = [LABEL]
    study = gs.Study.from_dict(tables)
    first = plan(study).keys.tolist()
    assert own_law.named(LABEL).__globals__["CALLS"] == [0.0]
    assert plan(study).keys.tolist() == first
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
        assert own_law.named(label)(1.0) == number
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


def test_a_law_that_returns_an_array_is_refused_with_a_remedy():
    law = gs.law(lambda x: np.where(x > 4e-4, 1e4 * (x - 4e-4), 0.0), 1.0, gs.Gap(0.0, 0.0))
    with pytest.raises(gs.ModelError, match=r"it returns array\(.*not a number.*engine='scipy'"):
        gs.simulate(gs.Oscillator(), law, omega=9.0, t_end=0.1)
