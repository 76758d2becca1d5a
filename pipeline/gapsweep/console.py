"""What a terminal shows: tables that fit it, and the progress of a run.

Progress is a bar on a terminal or in a notebook, elsewhere a line now and then.
"""

import sys
import textwrap
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from threading import Event, Thread

from rich.console import Console
from rich.progress import BarColumn, SpinnerColumn, TextColumn
from rich.progress import Progress as Bar
from rich.table import Column, Table

from gapsweep.execution.progress import OnProgress, Progress

_LINE_SECONDS = 10.0
_EARLY = 512  # points
# The first line comes so soon, and those of stages as soon after they have begun.
_TICK_SECONDS = 1.0
_DRAWN_SECONDS = 0.1
_RECENT_SECONDS = 30.0
_NO_POINT_YET = "loading machine code, or compiling it once per machine"


def print_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table, as wide as the terminal at most, or as 80 columns where there is none.

    Numbers stand on the right; texts that are too long go on in the next line.
    """
    texts = list(rows)
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for i, title in enumerate(head):
        is_text = any(not _is_number(row[i]) for row in texts)
        table.add_column(title, justify="left" if is_text else "right", overflow="fold")
    for row in texts:
        table.add_row(*row)
    _plain().print(table)


def print_text(text: str) -> None:
    """Print a paragraph as wide as the terminal, broken between words."""
    filled = textwrap.fill(
        text, _plain().width, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    )
    print(filled)


def _plain() -> Console:
    # What is printed are names and numbers, in which no markup is meant.
    return Console(markup=False, highlight=False, emoji=False)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return not text
    return True


class _Watch:
    """What a run has told last, in words that are right whenever they are asked for."""

    def __init__(self) -> None:
        self.progress, self._n_computed = Progress(0, 0), 0
        self._stage, self._begun = "", time.monotonic()
        self._seen: deque[tuple[float, int]] = deque()

    def __call__(self, progress: Progress) -> None:
        now = time.monotonic()
        if progress.n_computed and not self._n_computed:
            self._seen.clear()  # until the first points came, machine code was made or loaded
        # The number too: whoever tells may count on in the same object.
        self.progress, self._n_computed = progress, progress.n_computed
        if self.stage != self._stage:
            self._stage, self._begun = self.stage, now
        self._seen.append((now, progress.n_done))
        while len(self._seen) > 1 and self._seen[1][0] < now - _RECENT_SECONDS:
            self._seen.popleft()

    @property
    def stage(self) -> str:
        """What is done now; empty while points come in."""
        progress = self.progress
        is_waiting = progress.n_hits == progress.n_done < progress.n_points
        return progress.stage or (_NO_POINT_YET if is_waiting else "")

    @property
    def rate(self) -> float:
        """Points per second of late: the first ones wait for compilers."""
        if not self._seen:
            return 0.0
        begun, n_before = self._seen[0]
        return (self.progress.n_done - n_before) / max(time.monotonic() - begun, 1e-9)

    @property
    def said(self) -> str:
        if self.stage:
            return f"{self.stage}, {duration(time.monotonic() - self._begun)}"
        return sentence(self.progress, self.rate) if self.progress.n_points else ""


@contextmanager
def progress_bar() -> Iterator[OnProgress]:
    """An observer of a run that shows what it is called with."""
    console = Console(stderr=True)
    if console.is_jupyter:
        shown = _in_notebook()
    elif console.is_terminal:
        shown = _on_terminal(console)
    else:
        shown = _in_log()
    with shown as observe:
        yield observe


@contextmanager
def busy(stage: str) -> Iterator[None]:
    """Show on a terminal what is done in this block, while it lasts."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield
        return
    with _on_terminal(console) as observe:
        observe(Progress(0, 0, stage=stage))
        yield


@contextmanager
def _updating(update: Callable[[_Watch], None], seconds: float) -> Iterator[_Watch]:
    """A watch that a thread shows by `update` every so many seconds."""
    watch, ended = _Watch(), Event()

    def show() -> None:
        while not ended.wait(seconds):
            update(watch)

    thread = Thread(target=show, daemon=True)
    thread.start()
    try:
        yield watch
    finally:
        ended.set()
        thread.join()


@contextmanager
def _on_terminal(console: Console) -> Iterator[OnProgress]:
    """A bar, which leaves nothing behind: the command prints its results afterwards."""
    console.width -= len("^C ")  # which the terminal puts at the end, and must not break the line
    text = TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True))
    rest = BarColumn(bar_width=None, table_column=Column(ratio=1))
    with Bar(SpinnerColumn(), text, rest, console=console, transient=True, expand=True) as bar:
        task = bar.add_task("", total=None, visible=False)  # until something is done

        def update(watch: _Watch) -> None:
            total, done = watch.progress.n_points or None, watch.progress.n_done
            if watch.said:
                bar.update(task, visible=True, description=watch.said, total=total, completed=done)

        with _updating(update, _DRAWN_SECONDS) as watch:
            yield watch


@contextmanager
def _in_notebook() -> Iterator[OnProgress]:
    """A line in the output of a notebook's cell, which keeps the last counts."""
    from IPython.display import Pretty, display

    shown = display(Pretty(""), display_id=True)
    try:
        with _updating(lambda watch: shown.update(Pretty(watch.said)), _DRAWN_SECONDS) as watch:
            yield watch
    finally:
        known = watch.progress.n_points
        shown.update(Pretty(sentence(watch.progress, watch.rate) if known else ""))


@contextmanager
def _in_log() -> Iterator[OnProgress]:
    """Lines in a log: none of what is soon over, else one for every stage and now and then."""
    stage, last = "", -_LINE_SECONDS

    def update(watch: _Watch) -> None:
        nonlocal stage, last
        now = time.monotonic()
        if watch.said and (watch.stage != stage or now - last >= _LINE_SECONDS):
            stage, last = watch.stage, now
            print(watch.said, file=sys.stderr, flush=True)

    with _updating(update, _TICK_SECONDS) as watch:
        yield watch


def sentence(progress: Progress, rate: float) -> str:
    """Counts of a run, and the time left at some points per second."""
    missing = progress.n_points - progress.n_done
    # The first tasks are small, whose points cost ten times as much as those of a full one.
    is_early = progress.n_computed < min(_EARLY, 0.05 * (progress.n_points - progress.n_hits))
    known = rate > 0.0 and not is_early
    left = f"{duration(missing / rate)} left" if known and missing else "time left unknown"
    left = left if missing else "0:00:00 left"
    stored = f"{progress.n_hits} from the cache, " if progress.n_hits else ""
    pace = f"{rate:.{0 if rate >= 100.0 else 1}f}/s, " if rate > 0.0 else ""
    return (
        f"{progress.n_done}/{progress.n_points} points, {pace}"
        f"{stored}{progress.n_failed} failed, {left}"
    )


def duration(seconds: float) -> str:
    """Hours, minutes and seconds."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}"
