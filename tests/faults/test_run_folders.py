"""The folder of a run: whose it is, what is left in it, and who may write."""

import json
import os
import shutil
import subprocess
import sys
from contextlib import suppress
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import netCDF4
import pytest
from click.testing import CliRunner
from tests.builders.cache import damaged_row
from tests.builders.runs import COMMAND, in_a_process, wait_until
from tests.builders.studies import study_text

import gapsweep as gs
from gapsweep import pipeline, stages
from gapsweep.cli.main import commands
from gapsweep.errors import StoreError
from gapsweep.execution.portions import SWEEP_PART
from gapsweep.explorer.widget import explore_path
from gapsweep.store import netcdf
from gapsweep.store.artefact import alone_in, checked, recording, sha256
from gapsweep.store.state import RunState

pytestmark = pytest.mark.extended

STUDY = study_text(
    ["piecewise", "piecewise@same"], "{ start = 10.0, stop = 15.0, num = 20 }",
    sweep='initial_condition = "sweep_up"', more="[protocol.same]",
)  # fmt: skip


@pytest.fixture(scope="session")
def gapsweep(run_command):
    return partial(run_command, cache="c-cache")


@pytest.fixture(scope="module")
def finished(gapsweep, tmp_path_factory):
    """A run whose study names every point under two labels; the tests go on with it."""
    folder = tmp_path_factory.mktemp("finished")
    (folder / "tiny.toml").write_text(STUDY)
    done = gapsweep(folder, "run", "tiny.toml", "--out", "out")
    assert done.stdout.startswith("40 points: 0 from the cache, 40 computed\n")
    return folder


def test_another_study_is_refused_in_a_folder_that_is_taken(gapsweep, finished):
    other = STUDY.replace('"tiny"', '"other"')
    (finished / "other.toml").write_text(other)
    before = (finished / "out" / "responses.nc").read_bytes()
    done = gapsweep(finished, "run", "other.toml", "--out", "out", code=1)
    assert done.stderr.count("\n") == 1
    assert "out: has the files of study 'tiny', not of 'other'" in done.stderr
    assert (finished / "out" / "responses.nc").read_bytes() == before


def test_status_knows_a_run_of_which_everything_is_stored(gapsweep, finished, monkeypatch):
    (finished / "out" / "run.json").unlink()
    seen = []

    def make_files(*_, **__):
        seen.append(json.loads(gapsweep(finished, "status", "out", "--json").stdout))

    monkeypatch.setattr(pipeline, "make_files", make_files)
    study = gs.Study.load(finished / "tiny.toml")
    pipeline.carry_out(study, out=finished / "out", cache=finished / "c-cache")
    assert [(one["state"], one["hits"]) for one in seen] == [("running", 40)] * 2


def test_repairs_are_told(gapsweep, finished):
    page = finished / "out" / "report" / "index.html"
    whole = page.read_text()
    page.write_text(whole.replace("median", "MEDIAN"))
    data = bytearray((finished / "out" / "timing.nc").read_bytes())
    data[len(data) // 2] ^= 1
    (finished / "out" / "timing.nc").write_bytes(data)
    done = gapsweep(finished, "run", "tiny.toml", "--out", "out")
    told = [line for line in done.stderr.splitlines() if "damaged or changed" in line]
    repaired = [Path(line.split(":")[1].strip()) for line in told]
    assert repaired == [finished / "out" / "timing.nc", page]
    assert "MEDIAN" not in page.read_text()


def test_lost_and_damaged_figures_are_made_again(gapsweep, finished):
    figures = finished / "out" / "report" / "figures"
    whole = {file.name: file.read_bytes() for file in figures.iterdir()}
    lost, damaged = (next(figures.glob(f"*.{kind}")) for kind in ("svg", "html"))
    lost.unlink()
    damaged.write_bytes(damaged.read_bytes()[:-9])
    gapsweep(finished, "run", "tiny.toml", "--out", "out")
    assert {file.name: file.read_bytes() for file in figures.iterdir()} == whole
    shutil.rmtree(figures)
    gapsweep(finished, "run", "tiny.toml", "--out", "out")
    assert {file.name: file.read_bytes() for file in figures.iterdir()} == whole


def test_what_stands_in_the_place_of_a_file_is_one_line(gapsweep, finished, tmp_path):
    out = shutil.copytree(finished / "out", tmp_path / "out")
    command = ("run", "tiny.toml", "--out", os.fspath(out))
    for name in ("SHA256SUMS", "report/figures/SHA256SUMS", "static.nc"):
        (out / name).unlink()
        (out / name).mkdir()
        done = gapsweep(finished, *command, code=1)
        (*_, line) = (line for line in done.stderr.splitlines() if "error" in line)
        assert line.startswith("error: ")
        (out / name).rmdir()
        gapsweep(finished, *command)


PIPES = {
    "status": ("run.json", 1),
    "report": ("SHA256SUMS", 1),
    "claims": ("claims.json", 1),
    "run tiny.toml --out": ("responses.nc", 0),  # it is rewritten
    "run tiny.toml --cache c-cache --out": ("../c-cache/claims", 1),
}


@pytest.mark.parametrize("kind", ["pipe", "endless"])
@pytest.mark.parametrize("command", PIPES)
def test_a_pipe_or_device_in_the_place_of_a_file_is_not_read(finished, tmp_path, command, kind):
    """In a process, for a pipe would be waited for until the end of the test."""
    out = shutil.copytree(finished / "out", tmp_path / "out")
    (tmp_path / "c-cache").mkdir()
    shutil.copy(finished / "tiny.toml", tmp_path)
    name, code = PIPES[command]
    path = out / name
    path.unlink(missing_ok=True)
    os.mkfifo(path) if kind == "pipe" else path.symlink_to("/dev/zero")
    in_a_process(tmp_path, *command.split(), "out", code=code)


def test_a_pipe_is_no_dataset(tmp_path):
    os.mkfifo(tmp_path / "responses.nc")
    with pytest.raises(gs.StoreError, match="damaged or changed"):
        gs.open(tmp_path / "responses.nc")
    assert netcdf.attributes(tmp_path / "responses.nc") == {}


@pytest.mark.parametrize(
    "wrong",
    [[], {"claims": 1}, {"claims": [{"id": 1}], "counts": {}}, {"claims": [], "counts": 3}, "deep"],
)
def test_forged_claims_are_one_line(gapsweep, finished, tmp_path, wrong):
    out = shutil.copytree(finished / "out", tmp_path / "out")
    text = "[" * 100_000 if wrong == "deep" else json.dumps(wrong)
    if isinstance(wrong, dict):
        made_from = {"responses.nc": sha256(out / "responses.nc")}
        text = json.dumps(wrong | {"made_from": made_from})
    with recording(out / "claims.json", lambda _: True) as temporary:
        temporary.write_text(text)
    done = gapsweep(tmp_path, "claims", "out", code=1)
    assert [line[:7] for line in done.stderr.splitlines()] == ["error: "]


def test_a_link_to_nowhere_is_one_line(gapsweep, finished, tmp_path):
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere" / "else")
    study = os.fspath(finished / "tiny.toml")
    done = gapsweep(tmp_path, "run", study, "--out", "dangling", code=1)
    assert "dangling: is a broken symbolic link" in done.stderr.splitlines()[-1]


def test_a_claims_file_that_is_a_link_is_one_line(gapsweep, tmp_path):
    (tmp_path / "tiny.toml").write_text(STUDY.replace("num = 20", "num = 1"))
    (tmp_path / "c-cache").mkdir()
    (tmp_path / "c-cache" / "claims").symlink_to(tmp_path / "nowhere")
    done = gapsweep(tmp_path, "run", "tiny.toml", "--out", "out", code=1)
    assert "c-cache/claims: must be a regular file" in done.stderr.splitlines()[-1]
    assert not (tmp_path / "nowhere").exists()


@pytest.mark.parametrize("command", ["run", "plan", "report", "status"])
def test_a_folder_whose_name_is_no_utf_8_is_one_line(gapsweep, finished, tmp_path, command):
    folder = os.fsdecode(os.fsencode(tmp_path) + b"/o\xff")
    shutil.copytree(finished / "out", folder)
    others = ["tiny.toml", "--out"] if command in ("run", "plan") else []
    code = 0 if command in ("plan", "status") else 1
    done = gapsweep(finished, command, *others, folder, code=code)
    assert "compiling kernels" not in done.stderr
    if command == "run":
        assert "not UTF-8" in done.stderr.splitlines()[-1]


def forged(folder, name, change):
    """Another file of a run, with its right checksum."""
    path = folder / name
    with netCDF4.Dataset(path, "a") as dataset:
        change(dataset)
    with recording(path, lambda _: True) as temporary:
        shutil.copyfile(path, temporary)


FORGED = {
    "a variable of another name": lambda ds: ds.renameVariable("x_max", "x_most"),
    "a coordinate of another name": lambda ds: ds.renameVariable("omega", "frequency"),
    "no versions": lambda ds: ds.delncattr("versions"),
    "a study of other tables": lambda ds: ds.setncattr("study_json", "[1]"),
    "a study that is no JSON": lambda ds: ds.setncattr("study_json", "{'"),
    "a study that is nested deeply": lambda ds: ds.setncattr("study_json", "[" * 100_000),
}


@pytest.mark.parametrize("what", FORGED)
def test_datasets_of_other_contents_are_one_line(finished, tmp_path, what):
    """Of another version, or made by somebody else."""
    out = shutil.copytree(finished / "out", tmp_path / "out")
    forged(out, "responses.nc", FORGED[what])
    pages = [pipeline.report]
    if what.startswith("a study"):
        pages.append(lambda folder: explore_path(folder, 0))
    for show in pages:
        with pytest.raises(gs.GapsweepError) as caught:
            show(out)
        assert str(out) in str(caught.value)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("place", ["/proc/nowhere/c-cache", "dangling/c-cache"])
def test_a_cache_that_cannot_be_written_waits_for_no_workers(gapsweep, finished, tmp_path, place):
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    study = os.fspath(finished / "tiny.toml")
    done = gapsweep(tmp_path, "run", study, "--out", "out", "--cache", place, code=1)
    assert "starting the workers" not in done.stderr
    assert done.stderr.splitlines()[-1].endswith("choose another cache with --cache")


@pytest.mark.parametrize("said", ["x{", "[]", "3"])
def test_damaged_settings_of_a_dataset_are_made_again(gapsweep, finished, tmp_path, said):
    out = shutil.copytree(finished / "out", tmp_path / "out")
    with netCDF4.Dataset(out / "responses.nc", "a") as dataset:
        dataset.study_json = said
    gapsweep(finished, "run", "tiny.toml", "--out", os.fspath(out))
    with netCDF4.Dataset(out / "responses.nc") as dataset:
        assert json.loads(dataset.study_json)["study"]["name"] == "tiny"


def test_one_lost_row_of_a_sweep_is_one_point_to_compute(gapsweep, finished):
    path = finished / "c-cache"
    n_lost = 2 * damaged_row(path)
    assert 0 < n_lost <= 2 * SWEEP_PART
    done = gapsweep(finished, "run", "tiny.toml", "--out", "out")
    # One part of the sweep of twenty, for each label, and none that comes behind it.
    said = f"40 points: {40 - n_lost} from the cache, {n_lost} computed\n"
    assert done.stdout.startswith(said)
    assert ".seg: damaged, " in done.stderr


LEFT = """
import os, signal, sys, time
from dataclasses import asdict, replace
from pathlib import Path
from gapsweep.store.artefact import replacing
with replacing(Path(sys.argv[1])) as temporary:
    temporary.write_text("half of it")
    print(temporary.name, flush=True)
    if sys.argv[2] == "dies":
        os.kill(os.getpid(), signal.SIGKILL)
    sys.stdin.read()
"""


def test_temporary_files_of_the_dead_are_removed_and_no_others(gapsweep, finished):
    responses = finished / "out" / "responses.nc"
    command = [sys.executable, "-c", LEFT, str(responses)]
    with subprocess.Popen(
        [*command, "waits"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as alive:
        theirs = alive.stdout.readline().strip()
        dead = subprocess.run([*command, "dies"], capture_output=True, text=True)
        assert (responses.parent / dead.stdout.strip()).exists()
        responses.unlink()
        gapsweep(finished, "run", "tiny.toml", "--out", "out")
        assert [p.name for p in responses.parent.glob(".*")] == [theirs]
        alive.kill()


def test_claims_wait_for_whoever_writes_into_the_folder(finished):
    (finished / "claims.py").write_text(
        "from gapsweep.analysis.claims import Number, Test, claim\n"
        "@claim(1, 'here', 'Something.', 'It is.')\n"
        "def something(run):\n"
        "    mean = Number(float(run['responses']['x_max'].mean()))\n"
        "    return [Test('a number', mean, '>', 0.0)], 'It is.'\n"
    )
    (finished / "claiming.toml").write_text(STUDY + '[claims]\nmodule = "claims.py"\n')
    command = [COMMAND, "claims", "out", "--study", "claiming.toml"]
    with alone_in(finished / "out"):
        with (finished / "stderr").open("w") as stderr:
            waiting = subprocess.Popen(command, cwd=finished, stderr=stderr)
        wait_until(lambda: "out: waiting for" in (finished / "stderr").read_text())
        assert waiting.poll() is None
        assert not (finished / "out" / "claims.json").exists()
    assert waiting.wait(60) == 0, (finished / "stderr").read_text()
    assert (finished / "out" / "claims.json").exists()


SLOW = STUDY.replace("[steady]", '[solver]\nengine = "scipy"\nrtol = 1e-7\natol = 1e-10\n[steady]')


def test_two_runs_in_one_folder_tell_of_one_that_goes_on(gapsweep, tmp_path):
    (tmp_path / "long.toml").write_text(SLOW.replace("num = 20", "num = 999"))
    (tmp_path / "short.toml").write_text(STUDY.replace("num = 20", "num = 1"))
    command = [COMMAND, "run", "long.toml", "--out", "out", "--cache", "l-cache"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, cwd=tmp_path, start_new_session=True, **quiet) as long:
        wait_until((tmp_path / "out" / "run.json").exists)
        # The same study, as far as its name goes; it ends first.
        gapsweep(tmp_path, "run", "short.toml", "--out", "out")
        assert long.poll() is None
        state = json.loads((tmp_path / "out" / "run.json").read_text())
        assert (state["state"], state["pid"]) == ("running", long.pid)
        os.killpg(long.pid, 9)
    with gs.open(tmp_path / "out" / "responses.nc") as ds:
        assert ds.sizes["omega"] == 1


def test_of_two_studies_started_at_once_one_is_refused_before_it_computes(tmp_path):
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    runs = {}
    for name in ("one", "two"):
        text = SLOW.replace("num = 20", "num = 999").replace('"tiny"', f'"{name}"')
        (tmp_path / f"{name}.toml").write_text(text)
        command = [COMMAND, "run", f"{name}.toml", "--out", "out", "--cache", f"{name}-cache"]
        runs[name] = subprocess.Popen(
            command, cwd=tmp_path, text=True, start_new_session=True, **quiet
        )
    try:
        wait_until(lambda: any(run.poll() is not None for run in runs.values()))
        (refused,) = (name for name, run in runs.items() if run.poll() is not None)
        assert runs[refused].returncode == 1
        assert "out: has the files of study" in runs[refused].stderr.read()
        assert not (tmp_path / f"{refused}-cache").exists()
    finally:
        for run in runs.values():
            with suppress(ProcessLookupError):  # its workers are in its group
                os.killpg(run.pid, 9)
            run.communicate()


def test_benchmarks_name_what_they_were_made_from_before_they_began(tables, tmp_path, monkeypatch):
    tables["bench"] = {
        "scene": [{"name": "one", "K_c": 1.4e4, "gap": [0.4e-3, 0.4e-3], "omega": 12.0}],
        "method": [{"label": "piecewise", "rtol": [1e-4]}],
    }
    order = []
    monkeypatch.setattr(stages.Stage, "made_from", lambda *_: order.append("made from") or {})
    monkeypatch.setattr(stages, "write", lambda *_: order.append("written"))
    analysis = "gapsweep.analysis.bench.work_precision.work_precision"
    monkeypatch.setattr(analysis, lambda *_, **__: order.append("analysis") or {})
    pipeline.bench(gs.Study.from_dict(tables), tmp_path)
    assert order == ["made from", "analysis", "written"]


@pytest.mark.parametrize(
    "wrong",
    [
        {"host": "elsewhere", "updated": "nonsense"},
        {"host": "elsewhere", "updated": "2026-01-01T00:00:00"},
        {"host": "elsewhere", "updated": 3},
        {"pid": "one"},
        {"pid": -1},
        {"hits": None},
        {"study": ["s"]},
    ],
)
def test_a_state_that_no_run_has_written_is_one_line(tmp_path, wrong):
    whole = RunState(state="running", study="s", cache="c", points=1, hits=0)
    whole.write(tmp_path)
    assert RunState.read(tmp_path).state == "running"
    (tmp_path / "run.json").write_text(json.dumps(asdict(replace(whole, **wrong))))
    with pytest.raises(
        gs.StoreError, match=r"run\.json: not the state of a run; run the study again"
    ):
        RunState.read(tmp_path)
    assert not whole.is_hidden_in(tmp_path)


def test_a_terminal_is_sent_no_commands_of_a_folder(gapsweep, finished, tmp_path):
    out, bad = shutil.copytree(finished / "out", tmp_path / "out"), "\x1b]0;a\x07b\x9b31m\r"
    state = RunState.read(out)
    replace(state, study=bad, message=bad).write(out)
    claims = [{"id": 1, "verdict": bad, "place": bad, "claim": bad, "sentence": bad}]
    made_from = {"responses.nc": sha256(out / "responses.nc")}
    with recording(out / "claims.json", lambda _: True) as temporary:
        whole = {"claims": claims, "counts": {bad: 1}, "made_from": made_from}
        temporary.write_text(json.dumps(whole))
    for command in ("status", "claims"):
        for options in ([], ["--json"]):
            done = gapsweep(tmp_path, command, "out", *options)
            assert "]0;ab31m" in done.stdout or options
            shown = done.stdout + done.stderr
            assert not [c for c in shown if (ord(c) < 32 and c != "\n") or 127 <= ord(c) < 160]


def test_status_names_files_that_are_not_as_written(tmp_path):
    def told():
        said = CliRunner().invoke(commands, ["status", str(tmp_path)])
        assert said.exit_code == 0, said.output
        return said.output

    names = ["responses.nc", "report/index.html", "report/figures/peaks.svg"]
    for name in names:
        with recording(tmp_path / name, lambda path: True) as temporary:
            temporary.write_text(name)
    state = RunState(state="finished", study="s", cache="c", points=1, hits=1)
    state.write(tmp_path)
    assert "damaged" not in told()
    (tmp_path / "responses.nc").write_text("responses.nC")
    (tmp_path / "report" / "figures" / "peaks.svg").unlink()
    assert "\ndamaged or missing: report/figures/peaks.svg, responses.nc; " in told()
    replace(state, state="running").write(tmp_path)
    assert "damaged" not in told(), "what goes on replaces files"
    (tmp_path / "report" / "index.html").write_text("y")
    assert checked(tmp_path, most=1) == (
        ["report/figures/peaks.svg", "report/index.html"], ["responses.nc"]
    )  # fmt: skip


def test_files_that_need_no_branches_are_made_while_these_are_computed(tmp_path):
    """`first` stands for branches.nc, with two steps of other work while its tasks run."""
    order = []

    def made(name):
        def make(run):
            order.append(f"{name} begins")
            for _ in run.meanwhile if name == "first" else ():
                order.append("step")
            order.append(f"{name} ends")

        return make

    inputs = {"first": (), "apart": (), "alike": ("apart",), "after": ("first",), "last": ()}
    several = [stages.Stage(name, needs, (), made(name)) for name, needs in inputs.items()]
    stages.make_files(several, stages.RunContext(tmp_path, None))
    inside = ["apart begins", "apart ends", "step", "alike begins", "alike ends", "step"]
    outside = [f"{name} {what}" for name in ("after", "last") for what in ("begins", "ends")]
    assert order == ["first begins", *inside, "first ends", *outside]


def test_branches_are_written_before_the_error_of_a_file_that_was_made_meanwhile(tmp_path):
    """`first` stands for branches.nc, with two steps of other work while its tasks run."""

    def branches(run):
        return {"steps": len(list(run.meanwhile))}

    def fails(run):
        raise StoreError("the first error")

    several = [
        stages.Stage("first", (), (), branches),
        *(stages.Stage(name, (), (), fails) for name in ("apart", "later")),
    ]
    with pytest.raises(StoreError, match="the first error"):
        stages.make_files(several, stages.RunContext(tmp_path, None))
    assert json.loads((tmp_path / "first").read_text())["steps"] == 1, "none after the error"


def test_costs_are_measured_while_no_worker_computes():
    """Files of benchmarks are made before branches, hence not while these are computed."""
    files = [stage.file for stage in stages.STAGES]
    assert max(map(files.index, ("work_precision.nc", "stability.nc"))) < files.index("branches.nc")
