"""Code that is edited while clients and workers stand: new numbers or a refusal, never old ones.

The workers have another working folder, another home and no path to the study's folder.
"""

import json
import os
import shutil
import subprocess
import sys

import pytest
from tests.builders.runs import in_a_process, replaced
from tests.builders.studies import PAPER
from tests.cluster.test_external_clusters import SOURCES, scheduler, stored, worker

import gapsweep as gs

pytestmark = pytest.mark.extended

# The code of a law by file. An edit has the size of what it replaces.
LAWS = {
    "laws.py": """
from pathlib import Path

from .made import scaled
from .walls import GAP, wall

__data__ = ["k.csv"]
SHARE = 1.0
K = float(Path(__file__).with_name("k.csv").read_text())


@scaled
def spring(x):
    from mine.late import LATE

    return wall(x, GAP) * K * SHARE * LATE
""",
    "walls.py": """
from numba import njit

GAP = 4e-4


@njit
def cubed(x):
    return 1.0 * x**3


@njit(cache=True)
def wall(x, gap):
    return x + cubed(x) / gap**2  # smooth, so that it settles soon
""",
    "late.py": "LATE = 1.0\n",
    "k.csv": "1.0e4\n",
    "made.py": """
def scaled(function, factor=1.0):
    return lambda x: factor * function(x)
""",
    "__init__.py": "",
}
EDITS = [
    ("laws.py", "SHARE = 1.0", "SHARE = 2.0"),  # the law
    ("made.py", "factor=1.0", "factor=1.1"),  # a helper
    ("late.py", "LATE = 1.0", "LATE = 1.5"),  # a constant
    ("k.csv", "1.0e4", "3.0e4"),  # data
    ("walls.py", "1.0 * x**3", "3.0 * x**3"),  # a kernel whose caller numba keeps on disk
]


@pytest.fixture
def mine(tmp_path):
    """The package ``mine`` next to the study."""
    folder = tmp_path / "study" / "mine"
    folder.mkdir(parents=True)
    for name, text in LAWS.items():
        (folder / name).write_text(text)
    return folder


@pytest.fixture
def stranger(tmp_path, monkeypatch):
    """A worker that knows nothing of the study."""
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "numba"))
    surroundings = {"HOME": str(home), "PYTHONPATH": os.pathsep.join(map(str, [SOURCES.parent]))}

    def start(address, **more):
        here = os.getcwd()
        os.chdir(home)
        try:
            return worker(address, **(surroundings | more))
        finally:
            os.chdir(here)

    return start


@pytest.fixture
def of_mine(tables):
    tables["sweep"][0] |= {"representation": ["mine.laws:spring"], "omega": [20.0]}
    tables["oscillator"] = PAPER | {"zeta": 0.3}  # settles soon
    tables["solver"] = {"engine": "scipy"}
    return tables


def asked(study, folder, **options):
    """The peak of the study's one point, and whether it was stored already."""
    ds = gs.query(study, cache=folder / "c-cache", **options)
    assert ds["status"].item() == gs.Status.OK
    return ds["x_max"].item(), ds.attrs["n_hits"]


ORACLE = """
import json, sys
sys.path[:0] = [sys.argv[2]]
import gapsweep as gs
from mine.laws import spring
steady = gs.Steady(**json.loads(sys.argv[1]))
law = gs.law(spring, 1.4e4, gs.Gap(4e-4, 4e-4))
machine = gs.systems.paper_oscillator(zeta=0.3)
print(gs.respond(machine, law, 20.0, engine="scipy", steady=steady).x_max.hex())
"""


def fresh_peak(tables, mine, home):
    """The peak in a process that starts now, without gapsweep's cache or Dask."""
    command = [sys.executable, "-B", "-c", ORACLE, json.dumps(tables["steady"]), str(mine.parent)]
    environment = os.environ | {"NUMBA_CACHE_DIR": str(home / "fresh")}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return float.fromhex(done.stdout)


def test_a_standing_worker_and_a_standing_client_compute_the_edited_law(
    of_mine, tmp_path, mine, stranger
):
    study = gs.Study.from_dict(of_mine, str(mine.parent / "study.toml"))
    with scheduler() as (address, _), stranger(address):
        found = [asked(study, tmp_path, scheduler=address)]
        for file, old, new in EDITS:
            replaced(mine / file, old, new)
            found.append(asked(study, tmp_path, scheduler=address))
        assert found[-1][0] == fresh_peak(of_mine, mine, tmp_path)
        assert len({peak for peak, _ in found}) == len(found)
        for file, old, new in EDITS[::-1]:
            replaced(mine / file, new, old)
    # Nothing is left of the edits, so nothing has to be computed.
    assert asked(study, tmp_path) == (found[0][0], 1)


TABLE = "import gapsweep as gs\nwall = gs.ForceTable(x=[-1e-2, 1e-2], F=[-100.0, 100.0])\n"
SYSTEM = """
import gapsweep as gs


def make(k):
    forcing = [gs.Harmonic(amplitude=[1.0])]
    matrices = {"mass": [[1.0]], "stiffness": [[k]], "damping": [[2.0]]}
    return gs.System(**matrices, contacts={"c": [1.0]}, forcing=forcing)
"""
OF_SYSTEM = {
    "study": {"name": "system"},
    "system": {"function": "machine:make"},
    "parameters": {"k": 40.0},
    "solver": {"engine": "scipy"},
    "sweep": [{"representation": "mine.laws:spring", "K_c": 10.0, "gap": [1.0, 1.0], "omega": 1.0}],
}


def test_workers_need_no_file_of_the_study(of_mine, tmp_path, mine, stranger):
    folder, hidden = mine.parent, tmp_path / "hidden"
    (folder / "measured.py").write_text(TABLE)
    (folder / "machine.py").write_text(SYSTEM)
    table = of_mine | {"sweep": [of_mine["sweep"][0] | {"representation": ["measured:wall"]}]}
    several = table, OF_SYSTEM | {"steady": of_mine["steady"]}, of_mine
    studies = [gs.Study.from_dict(tables, str(folder / "study.toml")) for tables in several]

    def hide(progress):  # the plan is made, no worker has been sent any file of this study
        if progress.stage.startswith("connecting") and folder.exists():
            folder.rename(hidden)

    theirs = []
    with scheduler() as (address, _), stranger(address):
        for study in studies:
            theirs.append(asked(study, tmp_path, scheduler=address, on_progress=hide))
            assert not folder.exists()
            hidden.rename(folder)
    for study, (peak, _) in zip(studies, theirs, strict=True):
        assert asked(study, tmp_path / "ours") == (peak, 0)


@pytest.mark.parametrize(("library", "runs"), [("llvmlite", "runs"), ("scipy_like", "a process")])
def test_a_worker_with_other_libraries_is_refused(
    of_mine, tmp_path, mine, stranger, monkeypatch, library, runs
):
    """What gapsweep computes with, and what the law imports."""
    for place, number in (("here", "0.2"), ("there", "0.1")):
        folder = tmp_path / place / "site-packages" / f"{library}-{number}.dist-info"
        folder.mkdir(parents=True)
        text = f"Metadata-Version: 2.1\nName: {library}\nVersion: {number}\n"
        (folder / "METADATA").write_text(text)
        if library == "scipy_like":
            (folder.parent / f"{library}.py").write_text("")
    if library == "scipy_like":
        monkeypatch.syspath_prepend(tmp_path / "here" / "site-packages")
        (mine / "late.py").write_text("import scipy_like\nLATE = 1.0\n")
    study = gs.Study.from_dict(of_mine, str(mine.parent / "study.toml"))
    path = os.pathsep.join([str(tmp_path / "there" / "site-packages"), str(SOURCES.parent)])
    with (
        scheduler() as (address, _),
        stranger(address, PYTHONPATH=path),
        pytest.raises(
            gs.ClusterError, match=rf"{runs}.* {library} 0\.[12]|{library} 0\.2, but {runs}"
        ),
    ):
        asked(study, tmp_path, scheduler=address)
    assert stored(tmp_path) == 0


STUDY = """
[study]
name = "edited"
[oscillator]
mass = 3.0
omega_n = 5.0
zeta = 0.3
forcing = 4.0
alpha = 7e8
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


def test_an_edited_helper_and_edited_numerics_remake_the_files_of_a_run(
    run_command, tmp_path, mine
):
    (mine.parent / "s.toml").write_text(STUDY)
    command = ["run", str(mine.parent / "s.toml"), "--out", "out", "--cache", "c-cache"]
    copy = tmp_path / "package" / "gapsweep"
    made = []

    def in_the_copy(*arguments):
        return in_a_process(tmp_path, *arguments, variables={"PYTHONPATH": str(copy.parent)})

    def check(done):
        assert "0 from the cache, 1 computed" in done.stdout
        with gs.open(tmp_path / "out" / "histories.nc") as ds:
            made.append((ds["x"].max().item(), ds.attrs["created"]))

    check(run_command(tmp_path, *command))
    replaced(mine / "made.py", "factor=1.0", "factor=3.0")
    check(run_command(tmp_path, *command))
    assert made[1][0] != made[0][0]
    shutil.copytree(SOURCES, copy)  # with __pycache__, which costs seconds to make
    planned = in_the_copy("plan", *command[1:], "--json")
    assert json.loads(planned.stdout)["missing"] == 0, "a copy has the same numerics"
    windows = copy / "response" / "windows.py"  # of the numerics, but no kernel to compile again
    windows.write_text(windows.read_text() + "_EDITED = True\n")
    check(in_the_copy(*command))
    assert made[2][0] == made[1][0]
    assert made[2][1] > made[1][1]
