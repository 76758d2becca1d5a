"""Code that is edited while clients and workers stand: new numbers or a refusal, never old ones."""

import json
import os
import shutil
import subprocess
import sys

import pytest
from distributed import Client
from tests.cluster.test_dask import ROOT, SOURCES, scheduler, stored, worker

import gapsweep as gs

GAP = gs.Gap(0.4e-3, 0.4e-3)

# What the law computes with, by file; `FORCE` is the constant that a test edits.
PACKAGE = {
    "__init__.py": "",
    "laws.py": """
import numpy as np
from pathlib import Path

from . import damping, walls
from .stiffness import K
from .walls import GAP
from .made import factory, scaled

SHARE = 1.0
TABLE = np.loadtxt(Path(__file__).with_name("table.txt"))
made = factory(0.5)


@scaled
def spring(x):
    from mine.late import LATE

    push = walls.beyond(x, GAP) * K * SHARE * TABLE[0] * LATE
    return push + made(x) + damping.none(x)
""",
    "walls.py": """
GAP = 0.4e-3


def beyond(x, gap):
    return x + x**3 / gap**2  # smooth, so that it settles soon
""",
    "stiffness.py": "K = 1.0e4\n",
    "damping.py": "from .zero import ZERO\n\n\ndef none(x):\n    return ZERO * x\n",
    "zero.py": "ZERO = 0.0\n",
    "late.py": "LATE = 1.0\n",
    "table.txt": "1.0 2.0\n",
    "made.py": """
import functools


def factory(k):
    return lambda x: k * x


def scaled(function):
    @functools.wraps(function)
    def wrapped(x, factor=1.0):
        return factor * function(x)

    return wrapped
""",
}
# Edits of one number each, some of them as long as what they replace.
EDITS = [
    ("laws.py", "SHARE = 1.0", "SHARE = 2.0"),
    ("stiffness.py", "1.0e4", "3.0e4"),
    ("walls.py", "x + x**3", "x + 3 * x**3"),
    ("zero.py", "0.0", "9.9"),
    ("late.py", "1.0", "1.5"),
    ("table.txt", "1.0 2.0", "1.7 2.0"),
    ("made.py", "factor=1.0", "factor=1.1"),
]


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """A package that holds a law, on the path of this process and of those that it starts."""
    folder = tmp_path / "laws" / "mine"
    folder.mkdir(parents=True)
    for name, text in PACKAGE.items():
        (folder / name).write_text(text)
    monkeypatch.syspath_prepend(folder.parent)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(folder.parent), str(ROOT)]))
    yield folder
    for name in [n for n in sys.modules if n.partition(".")[0] == "mine"]:
        del sys.modules[name]


def replaced(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


@pytest.fixture
def of_mine(tables):
    tables["sweep"][0] |= {"representation": ["mine.laws:spring"], "omega": [20.0]}
    tables["oscillator"] = {"zeta": 0.3}  # settles soon
    tables["solver"] = {"engine": "scipy"}
    return tables


def asked(tables, folder, **options):
    """The peak of the study's one point, and whether it was stored already."""
    ds = gs.query(gs.Study.from_dict(tables), cache=folder / "c.sqlite", **options)
    assert ds["status"].item() == gs.Status.OK
    return ds["x_max"].item(), ds.attrs["n_hits"]


ORACLE = """
import json, sys
import gapsweep as gs
from mine.laws import spring
steady = gs.Steady(**json.loads(sys.argv[1]))
law = gs.law(spring, 1.4e4, gs.Gap(4e-4, 4e-4))
print(gs.respond(gs.Oscillator(zeta=0.3), law, 20.0, engine="scipy", steady=steady).x_max.hex())
"""


def fresh_peak(tables):
    """What a process that starts now, without gapsweep's cache or Dask, finds."""
    command = [sys.executable, "-B", "-c", ORACLE, json.dumps(tables["steady"])]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return float.fromhex(done.stdout)


def test_a_standing_worker_and_a_standing_client_compute_the_edited_law(of_mine, tmp_path, mine):
    with scheduler() as (address, _), worker(address):
        found = [asked(of_mine, tmp_path, scheduler=address)]
        for file, old, new in EDITS:
            replaced(mine / file, old, new)
            found.append(asked(of_mine, tmp_path, scheduler=address))
        assert found[-1][0] == fresh_peak(of_mine)
        assert len({peak for peak, _ in found}) == len(found)
        for file, old, new in EDITS[::-1]:
            replaced(mine / file, new, old)
    # Nothing is left of the edits, so nothing has to be computed.
    assert asked(of_mine, tmp_path) == (found[0][0], 1)


def test_a_worker_with_another_copy_of_the_law_is_refused(of_mine, tmp_path, mine):
    theirs = tmp_path / "theirs"
    shutil.copytree(mine, theirs / "mine")
    replaced(theirs / "mine" / "zero.py", "0.0", "9.9")
    path = os.pathsep.join([str(theirs), str(ROOT)])
    with scheduler() as (address, _), worker(address, PYTHONPATH=path):
        refusal = r"^'mine.laws:spring': mine.damping, mine.zero differ between client and"
        with pytest.raises(gs.ClusterError, match=refusal):
            asked(of_mine, tmp_path, scheduler=address)
        assert stored(tmp_path) == 0
        (theirs / "mine" / "laws.py").unlink()
        shutil.copyfile(mine / "zero.py", theirs / "mine" / "zero.py")
        with pytest.raises(gs.ClusterError, match=r"a worker cannot use the law 'mine.laws:spring"):
            asked(of_mine, tmp_path, scheduler=address)
        shutil.copyfile(mine / "laws.py", theirs / "mine" / "laws.py")
        shutil.copyfile(mine / "table.txt", theirs / "mine" / "table.txt")
        assert asked(of_mine, tmp_path, scheduler=address)[1] == 0


def test_a_law_in_a_single_file_can_be_sent_to_the_workers(tables, tmp_path, monkeypatch):
    (tmp_path / "hertz.py").write_text("def wall(x):\n    return 1e4 * x\n")
    monkeypatch.syspath_prepend(tmp_path)
    tables["sweep"][0] |= {"representation": ["hertz:wall"], "omega": [20.0]}
    tables["oscillator"] = {"zeta": 0.3}
    with scheduler() as (address, _), worker(address), Client(address) as client:
        with pytest.raises(gs.ClusterError, match=r"client\.upload_file\("):
            asked(tables, tmp_path, client=client)
        client.upload_file(str(tmp_path / "hertz.py"))
        assert asked(tables, tmp_path, client=client)[1] == 0
    sys.modules.pop("hertz", None)


def test_a_worker_with_other_libraries_is_refused(tables, tmp_path):
    folder = tmp_path / "llvmlite-0.1.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: llvmlite\nVersion: 0.1\n")
    path = os.pathsep.join([str(tmp_path), str(ROOT)])
    with (
        scheduler() as (address, _),
        worker(address, PYTHONPATH=path),
        pytest.raises(
            gs.ClusterError, match=r"^tcp://\S+ runs llvmlite 0.1, here \d\S+: install the"
        ),
    ):
        asked(tables, tmp_path, scheduler=address)
    assert stored(tmp_path) == 0


def command(*arguments, path, folder):
    done = subprocess.run(
        [sys.executable, "-c", "from gapsweep.cli import main; main()", *arguments],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(map(str, path))},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


STUDY = """
[study]
name = "edited"
[oscillator]
zeta = 0.3
[solver]
engine = "scipy"
[[sweep]]
representation = ["mine.laws:spring"]
K_c = [1.4e4]
gap = [[0.4e-3, 0.4e-3]]
omega = [20.0]
[[history]]
representation = ["mine.laws:spring"]
K_c = 1.4e4
gap = [0.4e-3, 0.4e-3]
omega = 20.0
t_end = 2.0
"""


def test_an_edited_helper_and_an_edited_kernel_remake_the_files_of_a_run(tmp_path, mine):
    copy = tmp_path / "package" / "gapsweep"
    shutil.copytree(SOURCES, copy, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "s.toml").write_text(STUDY)
    here = {"path": [copy.parent, mine.parent], "folder": tmp_path}
    arguments = "s.toml", "--out", "out", "--cache", "c.sqlite"
    made = []

    def run():
        said = command("run", *arguments, **here)
        with gs.open(tmp_path / "out" / "histories.nc") as ds:
            made.append((ds["x"].max().item(), ds.attrs["created"]))
        return said

    assert "0 from the cache, 1 computed" in run()
    replaced(mine / "walls.py", "x + x**3", "x + 3 * x**3")
    assert "0 from the cache, 1 computed" in run()
    assert made[1][0] != made[0][0]
    # Imported by nothing but a relative import, three modules away from the stage.
    replaced(copy / "integrate" / "taylor" / "record.py", '"""\n\n', '"""\n\n_EDITED = True\n')
    assert "0 from the cache, 1 computed" in run()
    assert made[2][0] == made[1][0]
    assert made[2][1] > made[1][1]
