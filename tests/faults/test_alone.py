"""Calls in a child process: whatever they do to it, the caller gets its own answer or an error."""

import math
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from tests import calls

import gapsweep as gs
from gapsweep.execution import alone as module
from gapsweep.execution.alone import Alone, CallError
from gapsweep.execution.task import failure
from gapsweep.status import Status


def lost(alone, function, *arguments):
    with pytest.raises(CallError) as raised:
        alone(function, *arguments)
    return raised.value.status, raised.value.message


def test_a_process_that_closes_its_pipe_and_stays_is_ended():
    with Alone(2.0) as alone:
        began = time.monotonic()
        assert lost(alone, calls.closing) == (Status.TIMED_OUT, "took longer than 2 s")
        assert time.monotonic() - began < 20.0
        assert alone(calls.same, 3) == 3


def test_what_a_call_has_started_ends_with_its_process():
    with Alone(10.0) as alone:
        left_behind = psutil.Process(alone(calls.forking))
    _, alive = psutil.wait_procs([left_behind], timeout=10.0)
    assert not alive


@pytest.mark.skipif(sys.platform != "linux", reason="the process is ended by Linux")
def test_a_call_that_hangs_ends_with_its_killed_caller():
    asks = "from tests import calls\nfrom gapsweep.execution.alone import Alone\n"
    asks += "Alone(600.0)(calls.working, 600.0)"
    caller = subprocess.Popen([sys.executable, "-c", asks], cwd=Path(__file__).parents[2])
    deadline = time.monotonic() + 120.0
    found = []
    while not any(one.cpu_times().user > 1.5 for one in found):
        assert time.monotonic() < deadline, "no call"
        time.sleep(0.1)
        found = psutil.Process(caller.pid).children()
    caller.kill()
    caller.wait()
    _, alive = psutil.wait_procs(found, timeout=10.0)
    assert not alive


OTHERWISE = Status.KILLED, "its process answered with something else"


def test_only_the_answer_to_a_call_is_its_answer():
    with Alone(10.0) as alone:
        assert lost(alone, calls.speaking, 1) == OTHERWISE
        assert alone(calls.same, 2) == 2
        for data in (b"\xff" * 64, b"\x7f\xff\xff\xff", bytes(24)):
            assert lost(alone, calls.writing, data) == OTHERWISE
        assert lost(alone, calls.unreadable) == OTHERWISE
        assert alone(calls.same, 3) == 3


def test_a_result_that_cannot_be_sent_is_an_error_of_the_call():
    with Alone(10.0) as alone:
        status, message = lost(alone, calls.unpicklable)
        assert status is Status.ERROR
        assert "lambda" in message


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        ("import time; time.sleep(60)", (Status.TIMED_OUT, "took longer than 1 s")),
        ("raise SystemExit(5)", (Status.KILLED, "its process ended with exit code 5")),
        ("import os, sys; os.write(int(sys.argv[1]), b'hello' * 9)", OTHERWISE),
    ],
)
def test_a_process_that_does_not_start_is_an_error_of_the_call(monkeypatch, code, expected):
    monkeypatch.setattr(module, "_CHILD", code)
    monkeypatch.setattr(module, "_START_SECONDS", 1.0)
    with Alone(10.0) as alone:
        assert lost(alone, calls.same, 1) == expected


def test_a_process_of_other_code_answers_nothing(monkeypatch):
    monkeypatch.setattr("gapsweep.study.software.numerics_fingerprint", lambda: "other")
    with Alone(10.0) as alone, pytest.raises(gs.ClusterError, match="installed anew"):
        alone(calls.same, 1)


@pytest.mark.parametrize("timeout", [math.inf, 1e12])
def test_a_call_may_take_any_time(timeout):
    with Alone(timeout) as alone:
        assert alone(calls.same, 3) == 3


def test_an_error_that_cannot_be_told_is_named():
    assert failure(calls.MuteError()) == (Status.ERROR, "MuteError")
    assert failure(ValueError("one\ntwo")) == (Status.ERROR, "ValueError: one")
    with pytest.raises(gs.ModelError, match=r"mute\(0\.0\) raised MuteError$"):
        gs.law(calls.mute, 1.0, gs.Gap(1.0, 1.0))
    with Alone(10.0) as alone:
        assert lost(alone, calls.mute) == (Status.ERROR, "MuteError")


def test_a_process_cleans_up_when_it_is_no_longer_needed():
    with Alone(10.0) as alone:
        kept = Path(alone(calls.keeping))
        assert kept.is_dir()
    assert not kept.exists()


def test_a_process_that_does_not_go_is_ended():
    with Alone(10.0) as alone:
        assert alone(calls.staying) == "here"
        began = time.monotonic()
    assert time.monotonic() - began < 20.0
