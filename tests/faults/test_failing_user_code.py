"""Code of the user's own that ends, hangs or raises: what a real run makes of it."""

import re
from functools import partial

import pytest
from tests.builders import runs
from tests.builders.studies import study_text

import gapsweep as gs
from gapsweep import pipeline
from gapsweep.analysis.bench.work_precision import work_precision
from gapsweep.analysis.datasets.histories import histories
from gapsweep.execution import isolated, try_out
from gapsweep.status import Status
from gapsweep.store.cache import Cache
from gapsweep.store.maintenance import contents_of

pytestmark = pytest.mark.extended

SOLVER = '[solver]\nengine = "scipy"\nrtol = 1e-4\natol = 1e-7'
SWEEP = study_text("{laws}", "[12.0]", name="own", more=SOLVER).replace('"{laws}"', "{laws}")


def labels(*names):
    return [f"tests.misbehaving.forces:{name}" for name in names]


@pytest.fixture(scope="session")
def gapsweep(run_command):
    return partial(run_command, cache="c-cache")


def in_a_process(folder, *arguments):
    """The installed command, as a user types it."""
    variables = {"GAPSWEEP_CACHE": "c-cache"}
    return runs.in_a_process(folder, *arguments, command=[runs.COMMAND], variables=variables)


def study(folder, text, *laws):
    (folder / "own.toml").write_text(text.replace("{laws}", str(list(laws)).replace("'", '"')))


def errors(done):
    """The lines of a process, without those that tell that something takes its time."""
    waiting = "looking up", "importing ", "calling "
    return [line for line in done.stderr.splitlines() if not line.startswith(waiting)]


def test_a_law_that_exits_fails_its_own_points_only(gapsweep, tmp_path):
    study(tmp_path, SWEEP, "piecewise", *labels("exiting", "stopping"))
    done = gapsweep(tmp_path, "run", "own.toml", "--out", "out", code=3)
    assert "failed points: 2 error" in done.stderr
    with Cache(tmp_path / "c-cache") as cache:
        slabs = [contents_of(slab) for _, slab in cache.slabs()]
    messages = {one.message for slab in slabs for one in slab.responses.rows()}
    assert messages == {"", "SystemExit: bye", "Stopped: enough"}
    again = gapsweep(tmp_path, "run", "own.toml", "--out", "out", code=3)
    assert again.stdout.startswith("3 points: 3 from the cache, 0 computed\n")


def test_a_law_that_exits_when_imported_is_one_line(gapsweep, tmp_path):
    (tmp_path / "gone.py").write_text("raise SystemExit('bye')")
    study(tmp_path, SWEEP, "gone:law")
    (line,) = errors(gapsweep(tmp_path, "run", "own.toml", "--out", "out", code=1))
    assert line.endswith("gone.py:1: importing it raised SystemExit: bye")


GOES = """
import os
os.chdir("sub")
"""
MACHINE = """
import gapsweep as gs


def law(x):
    return 1e4 * x


def make():
    forcing = [gs.Harmonic(amplitude=[1.0])]
    matrices = {"mass": [[1.0]], "stiffness": [[40.0]], "damping": [[2.0]]}
    return gs.System(**matrices, contacts={"c": [1.0]}, forcing=forcing)
"""
MOVING = """
[study]
name = "own"
[system]
function = "goes:make"
[[sweep]]
representation = "goes:law"
K_c = 10.0
gap = [1.0, 1.0]
omega = [1.0]
[solver]
engine = "scipy"
[report]
module = "sections.py"
"""


def test_code_that_changes_the_current_folder_takes_no_file_with_it(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "goes.py").write_text(GOES + MACHINE)
    (tmp_path / "sections.py").write_text(GOES + "def sections(run):\n    return []\n")
    (tmp_path / "own.toml").write_text(MOVING)
    for n_computed in (1, 0):
        done = in_a_process(tmp_path, "run", "own.toml")
        assert f", {n_computed} computed" in done.stdout
        assert (tmp_path / done.stdout.split("report: ")[1].splitlines()[0]).is_file()
    there = {path.name for path in (tmp_path / "data" / "runs" / "own").iterdir()}
    assert {"run.json", "responses.nc", "sections.json"} <= there
    assert "missing  0" in in_a_process(tmp_path, "plan", "own.toml").stdout
    in_a_process(tmp_path, "query", "own.toml", "--to", "nc", "--output", "q.nc")
    assert (tmp_path / "q.nc").is_file()
    assert (tmp_path / "c-cache").is_dir()
    assert not list((tmp_path / "sub").iterdir())


AT_ZERO = """
import os
def law(x):
    if x == 0.0:
        {}
    return 0.0
"""
FATAL = [
    ("import os; os._exit(7)", "importing fatal:law: its process ended with exit code 7"),
    (
        AT_ZERO.format("os._exit(0)"),
        "calling fatal:law: its process ended with exit code 0",
    ),
    (AT_ZERO.format("raise KeyboardInterrupt"), "calling fatal:law: KeyboardInterrupt"),
]


@pytest.mark.parametrize(("code", "reason"), FATAL)
def test_a_law_that_would_end_the_client_is_one_line(gapsweep, tmp_path, code, reason):
    (tmp_path / "fatal.py").write_text(code)
    study(tmp_path, SWEEP, "fatal:law")
    for command in (["plan"], ["run", "--out", "out"]):
        (line,) = errors(gapsweep(tmp_path, command[0], "own.toml", *command[1:], code=1))
        assert line.endswith(f"own.toml: {reason}")


COMPILED = SWEEP.replace('engine = "scipy"', 'engine = "compiled"')
BAD = {
    "T = {'a': 1.0}\ndef law(x):\n    return T['a'] * x\n": "numba cannot compile it .*'T'",
    "def law(x):\n    return 5.0 if x > 0.4e-3 else 0.0\n": "jumps by 5 N at x = 0.0004 m",
    "def law(x, v, n):\n    return x\n": r"\(x, v, n\) with {}: must be a function of x",
}


@pytest.mark.parametrize("code", BAD)
def test_a_plan_refuses_what_no_point_can_be_computed_with(gapsweep, tmp_path, code):
    (tmp_path / "bad.py").write_text(code)
    study(tmp_path, COMPILED, "bad:law")
    for command in (["plan"], ["run", "--out", "out"]):
        (line,) = errors(gapsweep(tmp_path, command[0], "own.toml", *command[1:], code=1))
        assert re.search(f"own.toml: bad:law.*{BAD[code]}", line)
        assert len(line) < 500


def test_a_law_is_tried_out_at_the_ends_of_its_swept_parameters(gapsweep, tmp_path):
    code = "def law(x, n):\n    return 1e4 * x if n < 2.0 else (5.0 if x > 0.4e-3 else 0.0)\n"
    (tmp_path / "bad.py").write_text(code)
    swept = "omega = [12.0]\nn = [1.0, 1.5, 3.0]\n"
    study(
        tmp_path, COMPILED.replace("omega = [12.0]\n", swept) + "[parameters]\nn = 1.0\n", "bad:law"
    )
    (line,) = errors(gapsweep(tmp_path, "plan", "own.toml", code=1))
    assert "bad:law: the force jumps by 5 N at x = 0.0004 m" in line


def test_a_table_that_all_motions_leave_is_named_at_the_end_of_a_run(gapsweep, tmp_path):
    rows = [f"{x},{100.0 * x}" for x in (-0.01, -0.005, 0.005, 0.01)]  # mm, N
    (tmp_path / "stop.csv").write_text("\n".join(["x,F", *rows, ""]))
    study(tmp_path, SWEEP, "piecewise", "stop.csv:mm")
    done = gapsweep(tmp_path, "run", "own.toml", "--out", "out")
    (said,) = (line for line in done.stdout.splitlines() if "out_of_fit_range" in line)
    assert said.startswith("stop.csv:mm: all 1 points ")
    assert "table" in said


def test_benchmarks_too_try_laws_out_elsewhere(gapsweep, tmp_path):
    (tmp_path / "fatal.py").write_text(AT_ZERO.format("os._exit(7)"))
    bench = MEASURED + METHOD.format("fatal:law")
    study(tmp_path, SWEEP.replace("{laws}", '["piecewise"]') + bench)
    done = gapsweep(tmp_path, "bench", "own.toml", "--out", "out", code=1)
    assert "own.toml: calling fatal:law: its process ended" in done.stderr


def test_a_law_that_hangs_at_zero_is_refused(tmp_path, monkeypatch):
    (tmp_path / "endless.py").write_text(AT_ZERO.format("while True: pass"))
    study(tmp_path, SWEEP, "endless:law")
    monkeypatch.setattr(try_out, "SHORTEST_TRIAL", 1.0)
    told, loaded = [], gs.Study.load(tmp_path / "own.toml")

    def tell(progress):
        told.append(progress.stage)

    asked = {"cache": tmp_path / "c-cache", "on_progress": tell}
    advice = "exceeded the time limit of 2 s; allow up to 60 s with --timeout"
    with pytest.raises(gs.StudyError, match=advice):
        pipeline.carry_out(loaded, out=tmp_path / "out", timeout=2.0, **asked)
    assert told == [
        "importing endless:law (timeout 2 s)",
        "calling endless:law (timeout 2 s)",
    ]
    monkeypatch.setattr(try_out, "LONGEST_TRIAL", 1.5)
    with pytest.raises(gs.StudyError, match=r"exceeded the time limit of 1\.5 s") as refused:
        pipeline.query(loaded, **asked)
    assert "--timeout" not in str(refused.value), "no longer time is to be had"
    assert told[-1] == "calling endless:law (timeout 1.5 s)"


POISONS = {
    "innocent": Status.OK,
    "raising": Status.ERROR,
    "exiting": Status.ERROR,
    "leaving": Status.KILLED,
    "hanging": Status.TIMED_OUT,
    "spinning": Status.TIMED_OUT,
}
HISTORY = """
[[history]]
representation = {laws}
K_c = 1.4e4
gap = [0.4e-3, 0.4e-3]
omega = 12.0
t_end = 2.0
"""


def test_histories_survive_any_law_and_say_what_failed(gapsweep, tmp_path, monkeypatch):
    monkeypatch.setattr(isolated, "IDLE_SHARE", 0.3)  # of the time that has passed: seen sooner
    text = SWEEP.replace("{laws}", '["piecewise"]') + HISTORY
    study(tmp_path, text, *labels(*POISONS))
    command = (tmp_path, "run", "own.toml", "--out", "out", "--timeout", "3")
    done = gapsweep(*command, code=3)
    assert "failed motions: 2 error, 1 killed, 2 timed_out; see 'status' in histories.nc" in (
        done.stderr
    )
    with gs.open(tmp_path / "out" / "histories.nc") as kept:
        assert kept["representation"].values.tolist() == labels(*POISONS)
        assert kept["status"].values.ravel().tolist() == list(POISONS.values())
    assert (tmp_path / "out" / "report" / "index.html").exists()
    gapsweep(*command, code=3)  # what failed stays failed


SCENE = """
[[bench.scene]]
name = "{}"
K_c = 1.4e4
gap = [0.4e-3, 0.4e-3]
omega = 12.0
"""
MEASURED = "[bench]\nrepeats = 1\nlanes = 1\nhorizon = 2\n" + SCENE.format("measured")
STATED = SCENE.format("stated") + 'expected = "reference"\n'
METHOD = '[[bench.method]]\nlabel = "{}"\nrtol = [1e-4]\n'


def test_benchmarks_survive_any_law_and_say_what_failed(gapsweep, tmp_path):
    poisons = labels("leaving", "spinning")
    methods = "".join(map(METHOD.format, ["piecewise", *poisons]))
    study(tmp_path, SWEEP.replace("{laws}", '["piecewise"]') + MEASURED + STATED + methods)
    # To refuse to compile a law takes processor time, too: two seconds where others run beside.
    done = gapsweep(tmp_path, "bench", "own.toml", "--out", "out", "--timeout", "5", code=3)
    for file in ("work_precision.nc", "stability.nc"):
        assert f"failed motions: 1 killed, 1 timed_out; see 'status' in {file}" in done.stderr
        with gs.open(tmp_path / "out" / file) as measured:
            assert measured["method"].values.tolist() == ["piecewise", *poisons]
            status = measured["status"].values.ravel().tolist()
        assert status == [Status.OK, Status.KILLED, Status.TIMED_OUT]


@pytest.mark.parametrize("what", [histories, work_precision])
def test_motions_run_the_code_that_the_study_has_read(tmp_path, what):
    """An edit after the study has read the law waits for the next run."""
    law = tmp_path / "edited.py"
    law.write_text("def law(x):\n    return 0.0\n")
    bench = MEASURED + "".join(map(METHOD.format, ["piecewise", "edited:law"]))
    study(tmp_path, SWEEP + HISTORY + bench, "edited:law")
    loaded = gs.Study.load(tmp_path / "own.toml")
    loaded.own_law("edited:law")
    law.write_text("raise SystemExit\n")
    assert (what(loaded)["status"] == gs.Status.OK).all()
