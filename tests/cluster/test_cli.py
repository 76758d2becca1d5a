"""The command line as a user meets it: real processes, exit codes, one clear line per error."""

import csv
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys

import psutil
import pytest
from tests.builders.cache import damaged_row, n_stored
from tests.builders.runs import ENTRY, in_a_process, started, wait_until
from tests.builders.studies import study_text

# A stage and its time, told of what takes longer than a moment.
PROGRESS = re.compile(r", \d+:\d\d:\d\d$")
QUICK = study_text(["piecewise", "tanh-1e4"], "[9.0, 20.0]")


@pytest.fixture(scope="session")
def gapsweep(run_command):
    return run_command


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "tiny.toml").write_text(QUICK)
    return tmp_path


@pytest.fixture(scope="module")
def finished_once(tmp_path_factory):
    folder = tmp_path_factory.mktemp("finished")
    (folder / "tiny.toml").write_text(QUICK)
    done = in_a_process(folder, "run", "tiny.toml")
    assert done.stdout.startswith("4 points: 0 from the cache, 4 computed\n")
    return folder


@pytest.fixture
def finished(finished_once, tmp_path):
    """A folder of its own in which the tiny study has run."""
    return shutil.copytree(finished_once, tmp_path / "finished")


def test_run_writes_datasets_and_report(finished):
    run = finished / "data" / "runs" / "tiny"
    names = sorted(str(p.relative_to(run)) for p in run.rglob("*") if p.is_file())
    stored = ["agreement.nc", "attractors.nc", "responses.nc", "static.nc", "timing.nc"]
    figures = ["answer", "scene-0-0", "scene-0-0-2"]
    files = [
        "SHA256SUMS",
        *(f"figure-{name}.{kind}" for name in figures for kind in ("csv", "html", "svg")),
    ]
    page = ["SHA256SUMS", "index.html", *(f"figures/{name}" for name in files)]
    assert names == sorted([*stored, *(f"report/{n}" for n in page), "SHA256SUMS", "run.json"])
    sums = ["sha256sum", "--check", "--quiet", "SHA256SUMS"]
    assert subprocess.run(sums, cwd=run).returncode == 0
    assert subprocess.run(sums, cwd=run / "report").returncode == 0
    assert subprocess.run(sums, cwd=run / "report" / "figures").returncode == 0
    page = (run / "report" / "index.html").read_text()
    assert page.count("<img ") == 3
    # XML namespaces are names, not requests; nothing else may point outside.
    outside = re.findall(r'(?:src|href|url)\s*[=(]\s*["\']?(https?:[^"\'\s)]*)', page)
    assert [url for url in outside if "w3.org" not in url] == []


def planned(gapsweep, folder, *arguments):
    return json.loads(gapsweep(folder, "plan", *arguments, "--json").stdout)


COUNTS = ("points", "hits", "missing", "failed")


def test_plan_counts_hits_and_missing_points(gapsweep, finished):
    text = (finished / "tiny.toml").read_text()
    (finished / "more.toml").write_text(text.replace("20.0]", "20.0, 25.0]"))
    numbers = planned(gapsweep, finished, "more.toml")
    assert numbers["expected_s"] > 0
    assert [numbers[name] for name in COUNTS] == [6, 4, 2, 0]
    assert numbers["stages"]["responses.nc"] == "sweep points are missing"
    assert all(numbers["stages"].values())


def test_plan_without_a_cache_creates_none(gapsweep, folder):
    numbers = planned(gapsweep, folder, "tiny.toml")
    assert [numbers[name] for name in COUNTS] == [4, 0, 4, 0]
    assert numbers["expected_s"] is None
    assert not (folder / "data").exists()


def test_plan_says_why_a_stage_would_run(gapsweep, finished):
    run = finished / "data" / "runs" / "tiny"
    assert set(planned(gapsweep, finished, "tiny.toml")["stages"].values()) == {None}
    (run / "timing.nc").unlink()
    assert planned(gapsweep, finished, "tiny.toml")["stages"] == {
        "responses.nc": None,
        "attractors.nc": None,
        "static.nc": None,
        "agreement.nc": None,
        "timing.nc": "absent",
        "report/index.html": "timing.nc will be made",
    }
    text = (finished / "tiny.toml").read_text()
    (finished / "tiny.toml").write_text(text.replace('"tiny"', '"tiny"\ntitle = "Other"'))
    stages = planned(gapsweep, finished, "tiny.toml")["stages"]
    assert stages["responses.nc"] == "study changed"
    assert stages["agreement.nc"] == "responses.nc, attractors.nc will be made"
    assert stages["static.nc"] == "study changed"


def test_finished_run_makes_nothing_again(finished):
    found = (finished / "data" / "runs").rglob("*")
    files = [p for p in found if p.is_file() and p.name != "run.json"]
    before = {p: p.stat().st_mtime_ns for p in files}
    done = in_a_process(finished, "run", "tiny.toml")
    assert done.stdout.startswith("4 points: 4 from the cache, 0 computed\n")
    assert {p: p.stat().st_mtime_ns for p in files} == before


def test_status_tells_how_a_run_ended(gapsweep, finished):
    state = json.loads(gapsweep(finished, "status", "data/runs/tiny", "--json").stdout)
    assert {name: state[name] for name in ("state", "points", "hits", "computed", "failed")} == {
        "state": "finished", "points": 4, "hits": 0, "computed": 4, "failed": 0
    }  # fmt: skip
    assert (state["damaged"], state["not_checked"]) == ([], [])
    said = gapsweep(finished, "status", "data/runs/tiny").stdout
    assert "4 of 4 points" in said
    assert "damaged" not in said


def test_status_of_a_run_that_goes_on_says_nothing_of_its_files(gapsweep, finished, tmp_path):
    state = json.loads((finished / "data/runs/tiny/run.json").read_text())
    state |= {"state": "running", "pid": os.getpid()}
    state |= {"process_started": psutil.Process().create_time()}
    (tmp_path / "run.json").write_text(json.dumps(state))
    told = json.loads(gapsweep(tmp_path, "status", ".", "--json").stdout)
    assert (told["damaged"], told["not_checked"]) == (None, None)


def test_status_names_what_is_no_longer_as_written(gapsweep, finished, tmp_path):
    """And waits for no pipe; a list that was cut names what it still holds."""
    shutil.copytree(finished / "data/runs/tiny", tmp_path / "run")
    (tmp_path / "run/static.nc").write_bytes(b"other")
    (tmp_path / "run/timing.nc").unlink()
    os.mkfifo(tmp_path / "run/timing.nc")
    sums = tmp_path / "run/SHA256SUMS"
    sums.write_text(sums.read_text() + "0123456789abcdef")
    told = json.loads(gapsweep(tmp_path / "run", "status", ".", "--json").stdout)
    assert told["damaged"] == ["static.nc", "timing.nc"]


def test_query_prints_what_was_selected_and_computes_only_the_rest(gapsweep, finished):
    text = (finished / "tiny.toml").read_text()
    (finished / "more.toml").write_text(text.replace("20.0]", "20.0, 25.0]"))
    done = gapsweep(finished, "query", "more.toml", "--sel", "omega=9:20", "--to", "csv")
    assert done.stderr == "4 points, 4 from the cache\n"
    rows = list(csv.DictReader(io.StringIO(done.stdout)))
    assert {(r["representation"], float(r["omega [Hz]"])) for r in rows} == {
        (label, omega) for label in ("piecewise", "tanh-1e4") for omega in (9.0, 20.0)
    }
    assert {r["status"] for r in rows} == {"ok"}
    one = ["--sel", "omega=25", "--sel", "representation=piecewise", "--to", "json"]
    done = gapsweep(finished, "query", "more.toml", *one)
    assert done.stderr.endswith("1 points, 0 from the cache\n")
    assert json.loads(done.stdout)["omega"] == 25.0
    assert planned(gapsweep, finished, "more.toml")["missing"] == 1


def rows_of(text):
    return list(csv.DictReader(io.StringIO(text)))


def test_query_prints_the_columns_and_digits_asked_for(gapsweep, finished):
    given = ("--sel", "representation=piecewise", "--columns", "x_max,status")
    rounded = rows_of(gapsweep(finished, "query", "tiny.toml", *given, "--digits", "3").stdout)
    exact = rows_of(gapsweep(finished, "query", "tiny.toml", *given).stdout)
    assert [row["x_max [mm]"] for row in rounded] == [
        str(float(f"{float(row['x_max [mm]']):.3g}")) for row in exact
    ]
    assert list(exact[0])[-2:] == ["x_max [mm]", "status"]
    lines = gapsweep(finished, "query", "tiny.toml", *given, "--to", "json").stdout.splitlines()
    assert [1e3 * json.loads(line)["x_max"] for line in lines] == pytest.approx(
        [float(row["x_max [mm]"]) for row in exact]
    )
    shown = gapsweep(finished, "query", "tiny.toml", "--to", "table")
    table = shown.stdout
    assert max(map(len, table.splitlines())) <= 80
    assert table.count("piecewise") == 2
    assert "x_max" not in table
    assert "--columns" in shown.stderr


def test_query_says_how_to_have_other_columns_to_one_who_names_none(gapsweep, finished):
    short = gapsweep(finished, "query", "tiny.toml")
    (header, *_) = rows_of(short.stdout)
    assert {"x_max [mm]", "force_max [N]", "contact_share"} <= {*header}
    assert "n_steps" not in header
    assert "--columns all" in short.stderr
    whole = gapsweep(finished, "query", "tiny.toml", "--columns", "all")
    assert {*header, "n_steps", "cpu_time [s]"} <= {*rows_of(whole.stdout)[0]}
    assert "--columns" not in whole.stderr


def test_explain_names_the_field_that_differs(gapsweep, finished):
    text = (finished / "tiny.toml").read_text()
    (finished / "more.toml").write_text(text.replace("20.0]", "20.0, 25.0]"))
    found = gapsweep(finished, "explain", "more.toml", "--sel", "representation=piecewise").stdout
    assert found.count(": ok on ") == 2
    assert (
        "omega = 25 Hz, initial_condition 0: missing\n  omega: 25.0; nearest cached point: "
        in found
    )


def test_explain_needs_no_cache(gapsweep, finished):
    found = gapsweep(finished, "explain", "tiny.toml", cache="none-yet")
    assert found.stdout.count(": missing") == 4
    assert not (finished / "none-yet").exists()


def test_cache_commands(gapsweep, finished):
    info = json.loads(gapsweep(finished, "cache", "info", "--json").stdout)
    assert (info["points"], info["current"], info["status"]) == (4, 4, {"ok": 4})
    done = gapsweep(finished, "cache", "verify")
    assert done.stdout == "4 intact points, 0 damaged segments\n"
    assert "0 points" in gapsweep(finished, "cache", "gc").stdout
    damaged_row(shutil.copytree(finished / "data" / "cache", finished / "copy"))
    copy = ("--cache", "copy")
    done = gapsweep(finished, "cache", "verify", *copy, code=1)
    # Runs begin at a random point, so segments hold one to three of the four points.
    n = int(done.stdout.split()[0])
    assert 0 < n < 4
    assert done.stdout == f"{n} intact points, 1 damaged segments\n"
    again = gapsweep(finished, "run", "tiny.toml", *copy)
    assert again.stdout.startswith(f"4 points: {n} from the cache, {4 - n} computed\n")
    assert again.stderr.count(".seg: damaged, ") == 1
    gapsweep(finished, "cache", "verify", *copy)


def test_report_is_rebuilt_from_the_datasets_alone(gapsweep, finished):
    run = finished / "data" / "runs" / "tiny"
    before = (run / "report" / "index.html").read_text()
    (run / "report" / "index.html").unlink()
    shutil.rmtree(finished / "data" / "cache")
    gapsweep(finished, "report", "data/runs/tiny")
    assert (run / "report" / "index.html").read_text() == before


def test_failed_points_end_with_their_own_exit_code(gapsweep, folder):
    (folder / "springs.py").write_text("def bad(x):\n    return 1.0 if x == 0 else {}[x]\n")
    text = QUICK.replace('"tanh-1e4"', '"springs:bad"')
    (folder / "tiny.toml").write_text(text + '[solver]\nengine = "scipy"\n')
    done = gapsweep(folder, "run", "tiny.toml", code=3)
    assert "failed points: 2 error" in done.stderr
    told = [json.loads(gapsweep(folder, "status", "data/runs/tiny", "--json").stdout)]
    gapsweep(folder, "run", "tiny.toml", code=3)
    told += [json.loads(gapsweep(folder, "status", "data/runs/tiny", "--json").stdout)]
    counts = [[state[name] for name in ("hits", "computed", "failed")] for state in told]
    assert counts == [[0, 4, 2], [4, 0, 2]]
    assert all("2 error: " in state["message"] for state in told)
    assert all("KeyError" in state["message"] for state in told)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("[study]", "[study"), "tiny.toml: not valid TOML"),
        (("[study]", f"a = {9999 * '['}"), "not valid TOML: brackets are nested too deeply"),
        (("tanh-1e4", "tanhh-1e4"), "sweep[0].representation[1] = 'tanhh-1e4': unknown"),
    ],
)
def test_bad_study_is_one_clear_line(gapsweep, folder, change, message):
    (folder / "tiny.toml").write_text(QUICK.replace(*change))
    done = gapsweep(folder, "run", "tiny.toml", code=1)
    assert [message in line for line in done.stderr.splitlines()] == [True]
    assert not (folder / "data").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("run", "none.toml"), "none.toml: cannot be read: No such file"),
        (("run", "tiny.toml", "--out", "tiny.toml/out"), "tiny.toml/out: cannot be written"),
        (("run", "tiny.toml", "--scheduler", "tcp://127.0.0.1:9"), "tcp://127.0.0.1:9: cannot be"),
        (("run", "tiny.toml", "--scheduler", "nonsense://x"), "nonsense://x: cannot be reached"),
        (("run", "tiny.toml", "--cache", "tiny.toml"), "tiny.toml: must be a folder"),
        (("plan", "none.toml"), "none.toml: cannot be read"),
        (("report", "."), "responses.nc: no such file; 'gapsweep run' writes it"),
        (("status", "."), "run.json: no such file; 'gapsweep run' writes it"),
        (("cache", "info"), "data/cache: no such folder; 'gapsweep run' creates it"),
        (("query", "tiny.toml", "--sel", "omega=13"), "omega = 13.0: not in the study"),
        (
            ("query", "tiny.toml", "--sel", "omega=30:40"),
            "omega = 30 to 40: no values in this range",
        ),
        (("query", "tiny.toml", "--sel", "speed=1"), "speed: not a dimension of the study"),
        (
            ("query", "tiny.toml", "--sel", "initial_condition=sweep_up"),
            "initial_condition = 'sweep_up': not in the study, which has 0: 0 is [0, 0]",
        ),
        (("query", "tiny.toml", "--output", "no/a.csv"), "no/a.csv: folder no does not exist"),
        (("query", "tiny.toml", "--output", "tiny.toml"), "tiny.toml: exists already"),
        (("run", "tiny.toml", "--out", "/proc/out"), "choose another folder with --out"),
    ],
)
def test_impossible_request_is_one_clear_line(gapsweep, folder, arguments, message):
    done = gapsweep(folder, *arguments, code=1)
    (line,) = [line for line in done.stderr.splitlines() if not PROGRESS.search(line)]
    assert message in line
    assert sorted(p.name for p in folder.iterdir()) == ["tiny.toml"]


@pytest.mark.parametrize(
    ("right", "wrong", "named"),
    [
        ("[[0.4e-3, 0.4e-3]]", "[[0.4, 0.4]]", "gap = 0.4 m: more than"),  # in millimetres
        ("[9.0, 20.0]", "[3000.0, 9425.0]", "omega = 9425 Hz"),  # in rad/s
        ("zeta = 0.03", "zeta = 3", "zeta = 3"),  # in percent
    ],
)
def test_a_wall_that_is_never_reached_is_noticed(gapsweep, folder, right, wrong, named):
    """By plan, before anything is computed, and in the last line of run."""
    text = QUICK.replace("alpha = 7e8", "alpha = 0.0").replace(right, wrong)
    (folder / "tiny.toml").write_text(text)
    largest = []
    for command in ("plan", "run"):
        done = gapsweep(folder, command, "tiny.toml")
        last = done.stdout.splitlines()[-1]
        assert named in done.stdout
        gap = re.search(r"the wall is never reached: .* ([0-9.e-]+) mm, gap ([0-9.]+) mm", last)
        assert gap, last
        assert float(gap[2]) == (400 if "0.4, 0.4" in text else 0.4)
        largest.append(float(gap[1]))
    assert 0.0 < largest[1] <= largest[0] < float(gap[2])
    planned = json.loads(gapsweep(folder, "plan", "tiny.toml", "--json").stdout)
    assert "never reached" in planned["doubts"][-1]
    page = (folder / "data" / "runs" / "tiny" / "report" / "index.html").read_text()
    assert page.index("The wall is never reached") < page.index("cannot be judged")
    assert named[1:] in page


def test_a_wall_that_is_reached_is_no_matter(gapsweep, finished_once):
    done = gapsweep(finished_once, "run", "tiny.toml")
    assert "never reached" not in done.stdout + done.stderr
    assert json.loads(gapsweep(finished_once, "plan", "tiny.toml", "--json").stdout)["doubts"] == []


def test_wrong_command_line_is_clicks_own(folder):
    in_a_process(folder, "run", code=2)
    in_a_process(folder, "run", "tiny.toml", "--workers", "0", code=2)
    in_a_process(folder, "--help")


NOHUP = ("nohup",)
# As a script starts what ends with &: Ctrl-C is ignored.
IN_BACKGROUND = "sh", "-c", 'trap "" INT; exec "$@"', "sh"


@pytest.mark.parametrize(
    ("number", "send", "prefix"),
    [
        (signal.SIGINT, os.killpg, ()),  # a terminal sends it to all processes, workers included
        (signal.SIGTERM, os.killpg, IN_BACKGROUND),
        (signal.SIGTERM, os.kill, NOHUP),
        (signal.SIGHUP, os.killpg, ()),
    ],
)
def test_a_signal_stops_a_run_and_the_next_one_resumes(gapsweep, folder, number, send, prefix):
    process = slow_run(folder, *prefix)
    workers = psutil.Process(process.pid).children(recursive=True)
    if prefix == NOHUP:  # it goes on when its terminal is closed
        reached = stored_points(folder)
        os.killpg(process.pid, signal.SIGHUP)
        wait_for_points(folder, reached + 4)
        assert process.poll() is None
    send(process.pid, number)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert errors.strip().splitlines()[-1] == "interrupted; run again to resume"
    assert "Traceback" not in errors
    assert not psutil.wait_procs(workers, timeout=10.0)[1], "no process of the run is left"
    assert "interrupted" in gapsweep(folder, "status", "data/runs/tiny").stdout
    kept = json.loads(gapsweep(folder, "plan", "tiny.toml", "--json").stdout)
    assert 3 <= kept["hits"] < 800


def test_the_clean_up_of_libraries_after_ctrl_c_prints_nothing(folder):
    """As dask's of the folder of a scheduler, which the interrupted run has removed."""
    entry = (
        "import atexit, logging, signal, gapsweep.pipeline as pipeline; "
        "atexit.register(logging.getLogger('distributed').error, 'Failed to remove'); "
        "pipeline.plan = lambda *_, **__: signal.raise_signal(signal.SIGTERM); "
        f"{ENTRY}"
    )
    done = in_a_process(
        folder, "plan", "tiny.toml", command=[sys.executable, "-c", entry], code=130
    )
    assert done.stderr.strip() == "interrupted; run again to resume"


def slow_run(folder, *prefix):
    """A run in a process group of its own, that has stored its first points."""
    slow = QUICK.replace("omega = [9.0, 20.0]", "omega = { start = 6.0, stop = 30.0, num = 400 }")
    slow = slow.replace("settle_tol = 1e-2", "settle_tol = 1e-6")
    (folder / "tiny.toml").write_text(slow + '[solver]\nengine = "scipy"\nrtol = 1e-8\n')
    process = started(
        *(folder, "run", "tiny.toml"), command=[*prefix, sys.executable, "-c", ENTRY], stdout=None,
        # SIGINT is ignored if a script started pytest with &.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    wait_for_points(folder, 3)
    return process


def wait_for_points(folder, n):
    wait_until(lambda: stored_points(folder) >= n)


def stored_points(folder):
    return n_stored(folder / "data" / "cache")
