"""No room left: a clear error, nothing lost, and the run resumes when there is room.

The room of a process is bounded by the operating system (RLIMIT_FSIZE), so that no special
file system is needed: no file may grow beyond the limit.
"""

import os
import re
import resource
import subprocess
import sys
from contextlib import contextmanager
from functools import partial

import pytest
from tests.builders.runs import in_a_process
from tests.builders.studies import study_text

import gapsweep as gs
from gapsweep.execution.recorder import Recorder
from gapsweep.store.cache import Cache
from gapsweep.store.maintenance import verify
from gapsweep.store.state import RunState

OMEGA = "{ start = 10.0, stop = 20.0, num = 1201 }"
STUDY = study_text(["piecewise"], OMEGA, name="full")
SMALL = {
    "study": {"name": "small"},
    "oscillator": {"mass": 3.0, "omega_n": 5.0, "zeta": 0.03, "forcing": 4.0},
    "sweep": [{"representation": "piecewise", "K_c": 1e4, "gap": [4e-4, 4e-4], "omega": 9.0}],
}
RUN = "from gapsweep.cli import main; main()"


def limited_run(folder, *options, room):
    def limited():
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))

    # Workers inherit the limit: their logs and code must not meet it, only what we write.
    command = ["run", "full.toml", "--cache", "cache", "--out", *options]
    return in_a_process(folder, *command, preexec_fn=limited, code=1)


@pytest.fixture
def run(run_command, folder):
    return partial(run_command, folder, "run", "full.toml", "--cache", "cache", "--out")


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "full.toml").write_text(STUDY)
    return tmp_path


def one_error(done):
    (error,) = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    return error


@pytest.mark.extended
def test_full_disk_while_committing(run, folder):
    (folder / "full.toml").write_text(STUDY.replace("num = 1201", "num = 13"))
    run("few")
    (folder / "full.toml").write_text(STUDY)
    error = one_error(limited_run(folder, "out", "--batch", "600", room=40_000))
    assert "cannot be written: " in error
    assert "disk space" in error
    with Cache(folder / "cache") as cache:
        kept = verify(cache)
    assert kept.is_sound
    assert 13 <= kept.n_points < 1201
    assert not list((folder / "cache").glob(".*"))
    assert not (folder / "out" / "responses.nc").exists()
    done = run("out")
    assert done.stdout.startswith(
        f"1201 points: {kept.n_points} from the cache, {1201 - kept.n_points} computed"
    )


@pytest.mark.extended
def test_full_disk_while_exporting(run, folder):
    run("whole")
    size = (folder / "whole" / "responses.nc").stat().st_size
    error = one_error(limited_run(folder, "out", room=size // 2))
    # Both are written side by side: either may be the first without room.
    assert re.search(r"(responses|attractors)\.nc: cannot be written", error)
    assert "disk space" in error
    assert [p.name for p in (folder / "out").iterdir() if p.name != "run.json"] == []
    done = run("out")
    assert done.stdout.startswith("1201 points: 1201 from the cache, 0 computed\n")
    with gs.open(folder / "out" / "responses.nc") as ds:
        assert (ds["status"] == gs.Status.OK).all()


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("arguments", [["--version"], ["plan", "full.toml"], ["plan", "--help"]])
def test_a_full_device_is_one_line(folder, arguments, unbuffered):
    command = [sys.executable, "-c", RUN, *arguments]
    environment = os.environ | {"PYTHONUNBUFFERED": unbuffered}
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            command, cwd=folder, env=environment, stdout=full, stderr=subprocess.PIPE, text=True
        )
    assert done.returncode == 1
    assert done.stderr == "error: No space left on device\n"


def test_a_closed_output_hinders_nothing(folder):
    command = f"{sys.executable} -c '{RUN}' plan full.toml >&-"
    done = subprocess.run(["sh", "-c", command], cwd=folder, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_state_that_finds_no_room_for_a_new_file_takes_that_of_the_old(tmp_path, monkeypatch):
    """As on a full disk, on which status told of a run that died."""
    plan = gs.plan(gs.Study.from_dict(SMALL), cache=tmp_path / "none")
    recorder = Recorder(tmp_path, gs.Study.from_dict(SMALL), tmp_path, plan, None)
    recorder.write()

    @contextmanager
    def full(path, **_):
        raise gs.StoreError("No space left on device")
        yield

    monkeypatch.setattr("gapsweep.store.state.replacing", full)
    with pytest.raises(ZeroDivisionError), recorder:
        raise ZeroDivisionError("of the run")
    state = RunState.read(tmp_path)
    assert (state.state, state.message) == ("failed", "of the run")
