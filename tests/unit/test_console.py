"""What a run tells while it goes on."""

import time
from types import SimpleNamespace

import pytest

from gapsweep import console
from gapsweep.console import _Watch, progress_bar, sentence
from gapsweep.execution.progress import Progress


@pytest.fixture
def clock(monkeypatch):
    """Time as a list of one number."""
    now = [0.0]
    monkeypatch.setattr("gapsweep.console.time.monotonic", lambda: now[0])
    return now


@pytest.mark.parametrize(
    ("progress", "rate", "said"),
    [
        (
            Progress(10, 2),
            0.0,
            "2/10 points, 2 from the cache, 0 failed, time left unknown",
        ),
        (Progress(10, 2, 4), 2.0, "6/10 points, 2.0/s, 2 from the cache, 0 failed, 0:00:02 left"),
        (Progress(9999, 0, 64), 8.0, "64/9999 points, 8.0/s, 0 failed, time left unknown"),
        (
            Progress(9999, 9979, 2),
            1.0,
            "9981/9999 points, 1.0/s, 9979 from the cache, 0 failed, 0:00:18 left",
        ),
        (Progress(10, 0, 10), 2.0, "10/10 points, 2.0/s, 0 failed, 0:00:00 left"),
        (Progress(3, 3), 0.0, "3/3 points, 3 from the cache, 0 failed, 0:00:00 left"),
    ],
)
def test_counts_and_the_time_left(progress, rate, said):
    assert sentence(progress, rate) == said


def test_the_longest_sentence_fits_a_terminal():
    assert len(sentence(Progress(138_578, 100_000, 38_000, 9), 1234.5)) <= 76


@pytest.mark.parametrize(
    ("seconds", "said"),
    [
        (65, "40/1000 points, 10.0/s, 0 failed, time left unknown"),  # of so few nobody knows
        (120, "590/1000 points, 10.0/s, 0 failed, 0:00:41 left"),
    ],
)
def test_the_time_left_is_that_of_recent_points(clock, seconds, said):
    """Nothing comes for a minute, for compilers; then ten a second, counted on in one object."""
    watch, progress = _Watch(), Progress(1000, 0)
    for clock[0] in range(seconds):
        progress.n_computed = max(0, 10 * (clock[0] - 60))
        watch(progress)
    assert watch.rate == pytest.approx(10.0)
    assert watch.said == said


def test_stages_are_named_with_the_time_they_take(clock):
    watch = _Watch()
    assert watch.said == ""
    watch(Progress(10, 2, stage="starting the workers"))
    clock[0] = 3.0
    assert watch.said == "starting the workers, 0:00:03"
    watch(Progress(10, 2))
    clock[0] = 10.0
    assert watch.said == "loading machine code, or compiling it once per machine, 0:00:07"
    watch(Progress(10, 2, 1))
    assert watch.said.startswith("3/10 points")


def test_a_log_has_a_line_per_stage_and_one_now_and_then(monkeypatch, capsys):
    monkeypatch.setattr(console, "_TICK_SECONDS", 0.01)
    with progress_bar() as observe:
        for stage in ("one", "two"):
            observe(Progress(10, 2, stage=stage))
            time.sleep(0.2)
        monkeypatch.setattr(console, "_LINE_SECONDS", 0.1)
        time.sleep(0.35)
    lines = capsys.readouterr().err.splitlines()
    assert lines[:2] == ["one, 0:00:00", "two, 0:00:00"]
    assert 3 <= len(lines) <= 6
    assert {line.partition(",")[0] for line in lines[2:]} == {"two"}


@pytest.mark.parametrize("is_terminal", [True, False])
def test_what_takes_its_time_is_named_on_a_terminal(monkeypatch, capsys, is_terminal):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr("rich.console.Console.is_terminal", is_terminal)
    with console.busy("making the report"):
        time.sleep(0.3)
    assert ("making the report, 0:00:00" in capsys.readouterr().err) == is_terminal


@pytest.mark.parametrize(
    ("last", "left"),
    [
        (
            Progress(10, 2, 8, stage="making"),
            "10/10 points, 2 from the cache, 0 failed, 0:00:00 left",
        ),
        (Progress(0, 0, stage="looking up"), ""),
    ],
)
def test_a_notebook_keeps_the_counts(monkeypatch, last, left):
    drawn = []
    handle = SimpleNamespace(update=lambda shown: drawn.append(shown.data))
    monkeypatch.setattr("IPython.display.display", lambda *_, **__: handle)
    with console._in_notebook() as observe:
        observe(last)
        time.sleep(0.5)
    assert drawn[0] == f"{last.stage}, 0:00:00"
    assert drawn[-1] == left


def test_what_is_soon_over_leaves_nothing(capsys):
    with progress_bar() as observe:
        observe(Progress(3, 3, stage="looking up"))
    assert capsys.readouterr().err == ""
