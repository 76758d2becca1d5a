"""Calls in a separate process: whatever they do to it, the caller gets an answer or an error."""

import ctypes
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from tests.misbehaving import calls

import gapsweep as gs
from gapsweep.execution import isolated as module
from gapsweep.execution.isolated import CallError, Isolated
from gapsweep.status import Status

SCRIPT = """
import psutil
from tests.misbehaving import calls
from gapsweep.execution.isolated import Isolated
print("began", flush=True)
"""


@pytest.fixture(scope="module")
def isolated():
    with Isolated(10.0) as isolated:
        yield isolated


@pytest.mark.parametrize(
    ("status", "function", "arguments"),
    [
        (Status.KILLED, ctypes.string_at, (0,)),
        (Status.KILLED, os._exit, (7,)),
        (Status.KILLED, os.kill, (0, signal.SIGKILL)),
        (Status.KILLED, calls.closing, ()),
        (Status.ERROR, sys.exit, (3,)),
        (Status.ERROR, calls.raising, (GeneratorExit("bye"),)),
        (Status.ERROR, calls.raising, (KeyboardInterrupt(),)),
        (Status.ERROR, calls.mute, ()),
        (Status.ERROR, calls.hungry, ()),
        (Status.ERROR, calls.unpicklable, ()),
        (Status.ERROR, calls.Unreadable, ()),
        (Status.MODEL_INVALID, calls.raising, (gs.ModelError("no model"),)),
    ],
)
def test_a_call_that_fails_has_a_status_and_the_next_one_works(
    isolated, status, function, arguments
):
    with pytest.raises(CallError) as raised:
        isolated(function, *arguments)
    assert raised.value.status is status
    assert isolated(calls.same, 3) == 3


def test_output_of_a_call_is_no_answer(isolated, capfd):
    assert isolated(calls.noisy, 3) == 3
    assert capfd.readouterr() == ("", "")


def test_processor_time_is_what_counts_and_idling_is_a_hang():
    with Isolated(1.0) as isolated:
        assert isolated(calls.working, 1.5) == 1.5, "longer than the limit by the clock alone"
        for hang in (time.sleep, calls.working):
            began = time.monotonic()
            with pytest.raises(CallError, match="exceeded the time limit of 1 s") as raised:
                isolated(hang, 100.0)
            assert raised.value.status is Status.TIMED_OUT
            assert time.monotonic() - began < 30.0


@pytest.mark.parametrize("timeout", [math.inf, 1e12])
def test_a_call_may_take_any_time(timeout):
    with Isolated(timeout) as isolated:
        assert isolated(calls.same, 3) == 3


@pytest.mark.parametrize(
    ("code", "status"),
    [
        ("import time; time.sleep(60)", Status.TIMED_OUT),
        ("raise SystemExit(5)", Status.KILLED),
    ],
)
def test_a_process_that_does_not_start_is_an_error_of_the_call(monkeypatch, code, status):
    monkeypatch.setattr(module, "CHILD", code)
    monkeypatch.setattr(module, "START_SECONDS", 1.0)
    with Isolated(10.0) as isolated, pytest.raises(CallError) as raised:
        isolated(calls.same, 1)
    assert raised.value.status is status


def test_a_process_of_other_code_answers_nothing(monkeypatch):
    monkeypatch.setattr(module, "software", lambda: {"numerics": "before the edit"})
    with Isolated(10.0) as isolated, pytest.raises(gs.ClusterError, match="changed during the run"):
        isolated(calls.same, 1)


def test_a_process_cleans_up_and_all_that_it_started_ends_with_it():
    with Isolated(10.0) as isolated:
        kept = Path(isolated(calls.keeping))
        left_behind = psutil.Process(isolated(calls.forking))
        assert kept.is_dir()
    assert not kept.exists()
    _, alive = psutil.wait_procs([left_behind], timeout=10.0)
    assert not alive
    began = time.monotonic()
    with Isolated(10.0) as isolated:
        assert isolated(calls.staying) == "here"
    assert time.monotonic() - began < 20.0


@pytest.mark.parametrize("call", ["calls.working, 600.0", "calls.same, 1"])
def test_nothing_outlives_a_killed_caller_and_its_script_is_not_imported(call, tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        f"{SCRIPT}isolated = Isolated(600.0)\nisolated({call})\nisolated(calls.working, 600.0)\n"
    )
    root = str(Path(__file__).parents[2])
    caller = subprocess.Popen(
        [sys.executable, script], stdout=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([root, *sys.path])},
    )  # fmt: skip
    found, deadline = [], time.monotonic() + 120.0
    while not any(one.cpu_times().user > 1.5 for one in found):
        assert time.monotonic() < deadline, "no call"
        time.sleep(0.1)
        found = psutil.Process(caller.pid).children()
    caller.kill()
    assert caller.communicate()[0] == "began\n"
    _, alive = psutil.wait_procs(found, timeout=10.0)
    assert not alive


def test_a_lost_process_is_no_longer_waited_for_than_its_children_live():
    """A child that it has forked holds its connection open."""
    with Isolated(60.0) as isolated:
        began = time.monotonic()
        with pytest.raises(CallError) as lost:
            isolated(calls.dying_with_a_child)
        assert lost.value.status is gs.Status.KILLED
        assert time.monotonic() - began < 20.0
