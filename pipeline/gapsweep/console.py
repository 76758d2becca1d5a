"""What a terminal shows: tables that fit it, and the progress of a run.

Progress is a bar on a terminal or in a notebook, elsewhere a line now and then.
"""

import sys
import textwrap
import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from html import escape
from threading import Event, Thread

from rich.console import Console
from rich.progress import BarColumn, ProgressColumn, SpinnerColumn, Task
from rich.progress import Progress as Bar
from rich.table import Column, Table
from rich.text import Text

from gapsweep.execution.progress import OnProgress, Progress

_LINE_SECONDS = 10.0
_EARLY = 512  # points
# The first line comes so soon, and those of stages as soon after they have begun.
_TICK_SECONDS = 1.0
_NOTEBOOK_SECONDS = 0.2
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
    """An observer of a run that draws what it sees."""
    console = Console(stderr=True)
    if console.is_jupyter:
        draw = _in_notebook()
    elif console.is_terminal:
        draw = _on_terminal(console)
    else:
        draw = _in_lines()
    with draw as observer:
        yield observer


@contextmanager
def busy(stage: str) -> Iterator[None]:
    """Say on a terminal what is done in this block, while it lasts."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield
        return
    with _on_terminal(console) as tell:
        tell(Progress(0, 0, stage=stage))
        yield


class _Said(ProgressColumn):
    """The words of a watch, at every refresh."""

    max_refresh = 0.1

    def __init__(self, watch: _Watch) -> None:
        super().__init__(Column(no_wrap=True))
        self.watch = watch

    def render(self, task: Task) -> Text:
        return Text(self.watch.said)


@contextmanager
def _on_terminal(console: Console) -> Iterator[OnProgress]:
    """A bar that moves by itself, and leaves nothing: what remains to be said comes after it."""
    watch = _Watch()
    console.width -= len("^C ")  # which the terminal puts at the end, and must not break the line
    rest = BarColumn(bar_width=None, table_column=Column(ratio=1))
    with Bar(
        SpinnerColumn(), _Said(watch), rest, console=console, transient=True, expand=True
    ) as bar:
        # Hidden until something is told: all may be up to date.
        task = bar.add_task("", total=None, visible=False)

        def observe(progress: Progress) -> None:
            watch(progress)
            n_points = progress.n_points or None
            bar.update(task, visible=True, total=n_points, completed=progress.n_done)

        yield observe


@contextmanager
def _in_notebook() -> Iterator[OnProgress]:
    """A bar in the output of a notebook's cell, which keeps its last counts."""
    from IPython.display import HTML, display

    watch, shown, drawn = _Watch(), display(HTML(""), display_id=True), ("", 0.0)

    def draw(words: str, attributes: str) -> None:
        shown.update(HTML(f"<progress {attributes}></progress> {escape(words)}"))

    def counts() -> str:
        return f'max="{watch.progress.n_points}" value="{watch.progress.n_done}"'

    def observe(progress: Progress) -> None:
        nonlocal drawn
        watch(progress)
        now = time.monotonic()
        if watch.stage != drawn[0] or now - drawn[1] >= _NOTEBOOK_SECONDS:
            drawn = watch.stage, now
            # Without numbers the browser keeps it moving.
            draw(watch.stage or watch.said, "" if watch.stage else counts())

    try:
        yield observe
    finally:
        if watch.progress.n_points:
            draw(sentence(watch.progress, watch.rate), counts())
        else:
            shown.update(HTML(""))


@contextmanager
def _in_lines() -> Iterator[OnProgress]:
    """Lines in a log: none of what is soon over, else one for every stage and now and then."""
    watch, ended = _Watch(), Event()

    def write() -> None:
        stage, last = "", -_LINE_SECONDS
        while not ended.wait(_TICK_SECONDS):
            now = time.monotonic()
            if watch.said and (watch.stage != stage or now - last >= _LINE_SECONDS):
                stage, last = watch.stage, now
                print(watch.said, file=sys.stderr, flush=True)

    thread = Thread(target=write, daemon=True)
    thread.start()
    try:
        yield watch
    finally:
        ended.set()
        thread.join()


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
