"""Display of a run's progress."""

import time
from dataclasses import replace
from types import SimpleNamespace

import pytest

from gapsweep import console
from gapsweep.console import busy, print_table, print_text, progress_bar, sentence
from gapsweep.errors import printable
from gapsweep.execution.progress import Progress


def test_the_sentence_has_the_counts_and_the_time_left():
    progress = Progress(100, 20, n_computed=30, n_failed=4, n_shared=10, seconds_left=80.0)
    text = sentence(progress)
    for part in ("60/100 points", "20 from the cache", "4 failed", "0:01:20 left"):
        assert part in text
    assert "left" not in sentence(replace(progress, seconds_left=None))
    assert len(sentence(Progress(138_578, 100_000, 38_000, 9, seconds_left=1e5))) <= 76


@pytest.mark.parametrize("sign", ["\x1b", "\x9b", "\u202e", "\u2066", "\u200f", "\u200b", "\ufeff"])
def test_signs_that_reorder_or_hide_a_text_are_not_printed(capsys, sign):
    print_text(f"a{sign}b")
    print_table(["c"], [[f"d{sign}e"]])
    assert "".join(capsys.readouterr().out.split()) == "abcde"
    assert sentence(Progress(10, 2, stage=f"a{sign}b")) == "ab"
    assert printable(f"K_c\tε ≤ 10⁻³\n{sign}") == "K_c\tε ≤ 10⁻³\n"


def test_a_stage_takes_the_place_of_the_counts():
    assert "3/10 points" in sentence(Progress(10, 2, 1))
    assert sentence(Progress(10, 2, stage="starting")) == "starting"


def test_a_log_has_a_line_per_stage_that_lasts_and_one_now_and_then(monkeypatch, capsys):
    monkeypatch.setattr(console, "SOON_SECONDS", 0.1)
    monkeypatch.setattr(console, "LINE_SECONDS", 0.3)
    with progress_bar() as observe:
        observe(Progress(10, 2, stage="brief"))
        observe(Progress(10, 2, stage="long"))
        time.sleep(0.3)
        for n in range(1, 7):
            observe(Progress(10, 2, n))
            time.sleep(0.1)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "long"
    assert 2 <= len(lines[1:]) <= 4
    assert all("/10 points" in line for line in lines[1:])


def test_what_is_soon_over_leaves_nothing_in_a_log(capsys):
    with progress_bar() as observe:
        observe(Progress(3, 3, stage="looking up"))
    assert capsys.readouterr().err == ""


def test_a_terminal_shows_the_stage_and_clears_it(monkeypatch, capsys):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr("rich.console.Console.is_terminal", True)
    with busy("making the report"):
        time.sleep(0.3)
    shown = capsys.readouterr().err
    assert "making the report" in shown
    assert shown.rstrip("\x1b[?25h").endswith("\x1b[2K")


@pytest.mark.parametrize(
    ("last", "left"),
    [(Progress(10, 2, 8, stage="making"), "10/10 points"), (Progress(0, 0, stage="looking"), "")],
)
def test_a_notebook_keeps_the_counts(monkeypatch, last, left):
    drawn = []
    handle = SimpleNamespace(update=lambda shown: drawn.append(shown.data))
    monkeypatch.setattr("IPython.display.display", lambda *_, **__: handle)
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    with progress_bar() as observe:
        observe(last)
    assert drawn[0] == last.stage
    assert drawn[-1].startswith(left)
    assert bool(drawn[-1]) == bool(left)
