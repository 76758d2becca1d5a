"""What a terminal shows: tables that fit it, and the progress of a run.

Progress is a bar on a terminal or in a notebook, elsewhere a line now and then.
"""

import sys
import textwrap
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar
from rich.table import Table

from gapsweep.execution.progress import OnProgress, Progress

_LINE_SECONDS = 10.0
_NOTEBOOK_SECONDS = 0.2


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


def print_text(text: str, indent: str = "") -> None:
    """Print a paragraph as wide as the terminal, broken between words."""
    filled = textwrap.fill(
        text, _plain().width, initial_indent=indent, subsequent_indent=indent + "  ",
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip
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


@contextmanager
def progress_bar() -> Iterator[OnProgress]:
    """An observer of a run that draws what it sees."""
    console = Console(stderr=True)
    if console.is_jupyter:
        yield _notebook_bar()
        return
    if not console.is_terminal:
        yield _line_writer()
        return
    columns = (
        BarColumn(bar_width=None),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]:.1f}/s"),
        TextColumn("{task.fields[hits]} from the cache"),
        TextColumn("{task.fields[failed]} failed"),
        TimeRemainingColumn(),
    )
    with Bar(*columns, console=console) as bar:
        # Hidden until something is computed: everything may be in the cache.
        task = bar.add_task("", total=None, visible=False, rate=0.0, hits=0, failed=0)

        def update(progress: Progress) -> None:
            bar.update(
                task,
                visible=True,
                total=progress.n_points,
                completed=progress.n_done,
                rate=progress.rate,
                hits=progress.n_hits,
                failed=progress.n_failed,
            )

        yield update


def _notebook_bar() -> OnProgress:
    """A bar in the output of a notebook's cell, which keeps its last state."""
    from IPython.display import HTML, display

    shown = display(HTML(""), display_id=True)

    def write(progress: Progress) -> None:
        bar = f'<progress max="{progress.n_points}" value="{progress.n_done}"></progress>'
        shown.update(HTML(f"{bar} {_sentence(progress)}"))

    return _now_and_then(write, _NOTEBOOK_SECONDS)


def _line_writer() -> OnProgress:
    return _now_and_then(
        lambda progress: print(_sentence(progress), file=sys.stderr), _LINE_SECONDS
    )


def _now_and_then(write: OnProgress, seconds: float) -> OnProgress:
    """The observer, called at the end and not more often than so many seconds before."""
    last = time.monotonic()

    def observe(progress: Progress) -> None:
        nonlocal last
        finished = progress.n_done == progress.n_points
        if finished or time.monotonic() - last >= seconds:
            last = time.monotonic()
            write(progress)

    return observe


def _sentence(progress: Progress) -> str:
    missing = progress.n_points - progress.n_done
    left = (
        duration(missing / progress.rate) if progress.rate else "unknown" if missing else "0:00:00"
    )
    return (
        f"{progress.n_done}/{progress.n_points} points, {progress.rate:.1f}/s, "
        f"{progress.n_hits} from the cache, {progress.n_failed} failed, {left} left"
    )


def duration(seconds: float) -> str:
    """Hours, minutes and seconds."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}"
