"""Progress of a run: a bar on a terminal, a line now and then elsewhere; both on stderr."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from gapsweep.execution.progress import OnProgress, Progress

_LINE_SECONDS = 10.0


@contextmanager
def progress_bar() -> Iterator[OnProgress]:
    """An observer of a run that draws what it sees."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _line_writer()
        return
    columns = (
        BarColumn(bar_width=None),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]:.1f}/s"),
        TextColumn("{task.fields[hits]} hits"),
        TextColumn("{task.fields[failed]} failed"),
        TimeRemainingColumn(),
    )
    with Bar(*columns, console=console) as bar:
        task = bar.add_task("", total=None, rate=0.0, hits=0, failed=0)

        def update(progress: Progress) -> None:
            bar.update(
                task,
                total=progress.n_points,
                completed=progress.n_done,
                rate=progress.rate,
                hits=progress.n_hits,
                failed=progress.n_failed,
            )

        yield update


def _line_writer() -> OnProgress:
    last = time.monotonic()

    def write(progress: Progress) -> None:
        nonlocal last
        finished = progress.n_done == progress.n_points
        if not finished and time.monotonic() - last < _LINE_SECONDS:
            return
        last = time.monotonic()
        left = (progress.n_points - progress.n_done) / progress.rate if progress.rate else 0.0
        print(
            f"{progress.n_done}/{progress.n_points} points, {progress.rate:.1f}/s, "
            f"{progress.n_hits} hits, {progress.n_failed} failed, {duration(left)} left",
            file=sys.stderr,
        )

    return write


def duration(seconds: float) -> str:
    """Hours, minutes and seconds."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}"
