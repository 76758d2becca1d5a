"""Output on a terminal: tables, paragraphs and the progress of a run.

Progress is a bar on a terminal, one line that is replaced in a notebook, and lines in a log.
"""

import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import timedelta
from threading import Timer

from rich.console import Console
from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar
from rich.table import Column, Table

from gapsweep.errors import printable
from gapsweep.execution.progress import OnProgress, Progress

SOON_SECONDS, LINE_SECONDS = 3.0, 10.0


def print_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table, as wide as the terminal at most, or as 80 columns where there is none.

    Numbers are aligned right; texts that are too long continue in the next line.
    """
    texts = [[printable(cell) for cell in row] for row in rows]
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for i, title in enumerate(head):
        is_text = any(not _is_number(row[i]) for row in texts)
        table.add_column(title, justify="left" if is_text else "right", overflow="fold")
    for row in texts:
        table.add_row(*row)
    # Names and numbers are no markup.
    Console(markup=False, highlight=False, emoji=False).print(table)


def print_text(text: str) -> None:
    """Print a paragraph as wide as the terminal, broken between words."""
    print(
        textwrap.fill(
            printable(text),
            Console().width,
            subsequent_indent="  ",
            break_long_words=False,
            break_on_hyphens=False,
        )
    )


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return not text
    return True


def sentence(progress: Progress) -> str:
    """The stage of a run, or its counts and the time left if it is known."""
    if progress.stage:
        return printable(progress.stage)
    left = ""
    if (progress.seconds_left or 0.0) > SOON_SECONDS:
        left = f", {timedelta(seconds=round(progress.seconds_left or 0.0))} left"
    stored = f"{progress.n_hits} from the cache, " if progress.n_hits else ""
    return f"{progress.n_done}/{progress.n_points} points, {stored}{progress.n_failed} failed{left}"


@contextmanager
def progress_bar() -> Iterator[OnProgress]:
    """Context with an observer that shows the `Progress` it is called with on stderr."""
    console = Console(stderr=True)
    if console.is_jupyter:
        shown = _in_notebook()
    elif console.is_terminal:
        shown = _on_terminal(console)
    else:
        shown = _in_lines(lambda text: print(text, file=sys.stderr, flush=True))
    with shown as observe:
        yield observe


@contextmanager
def busy(stage: str) -> Iterator[None]:
    """Show the text `stage` as long as the block runs."""
    with progress_bar() as observe:
        observe(Progress(0, 0, stage=stage))
        yield


@contextmanager
def _on_terminal(console: Console) -> Iterator[OnProgress]:
    """Observer with a progress bar, removed at the end: the command then prints its results."""
    console.width -= len("^C ")  # which the terminal adds at the end of the line
    text = TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True))
    rest = BarColumn(bar_width=None, table_column=Column(ratio=1))
    columns = SpinnerColumn(), text, rest, TimeElapsedColumn()
    with Bar(*columns, console=console, transient=True, expand=True) as bar:
        task, stage = bar.add_task("", total=None, visible=False), ""

        def observe(progress: Progress) -> None:
            nonlocal stage
            if progress.stage != stage:
                bar.reset(task)
                stage = progress.stage
            bar.update(
                task,
                visible=True,
                description=sentence(progress),
                total=None if stage else progress.n_points,
                completed=progress.n_done,
            )

        yield observe


@contextmanager
def _in_notebook() -> Iterator[OnProgress]:
    """Observer with one line below a notebook cell; the last counts stay there."""
    from IPython.display import Pretty, display

    shown, last = display(Pretty(""), display_id=True), Progress(0, 0)

    def observe(progress: Progress) -> None:
        nonlocal last
        last = progress
        shown.update(Pretty(sentence(progress)))

    yield observe
    shown.update(Pretty(sentence(replace(last, stage="")) if last.n_points else ""))


@contextmanager
def _in_lines(show: Callable[[str], None]) -> Iterator[OnProgress]:
    """Observer that prints a line for each stage longer than 3 s, and the counts every 10 s."""
    begun, shown, stage, timer = 0.0, 0.0, "", Timer(0.0, show)

    def observe(progress: Progress) -> None:
        nonlocal begun, shown, stage, timer
        now = time.monotonic()
        if progress.stage != stage or not begun:
            begun = shown = now
            stage = progress.stage
            timer.cancel()
            timer = Timer(SOON_SECONDS, show, [sentence(progress)])
            timer.start()
        elif now - shown >= LINE_SECONDS:
            shown = now
            show(sentence(progress))

    try:
        yield observe
    finally:
        timer.cancel()
