"""The command line: arguments in, exit code out.

Exit codes: 0 finished; 1 a study, file or cluster error; 2 a wrong command line; 3
finished, but some points failed; 130 interrupted, resumable.
"""

import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from gapsweep import __version__, workflow
from gapsweep.errors import GapsweepError
from gapsweep.execution.execute import OnProgress, Progress
from gapsweep.integrate.problem import ENGINES
from gapsweep.study.study import Study

FINISHED, FAULT, SOME_FAILED, INTERRUPTED = 0, 1, 3, 130
_LINE_SECONDS = 10.0

_study = click.argument("study", type=click.Path(path_type=Path))
_cache = click.option(
    "--cache",
    type=click.Path(path_type=Path),
    help="Cache file.  [default: $GAPSWEEP_CACHE, else data/cache.sqlite]",
)
_engine = click.option("--engine", type=click.Choice(ENGINES), help="Override [solver].")
_retry = click.option("--retry-failed", is_flag=True, help="Compute failed points again.")
_workers = click.option(
    "--workers", type=click.IntRange(min=1), default=2, show_default=True, help="Local processes."
)


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 80})
@click.version_option(__version__)
def commands() -> None:
    """Parameter studies of oscillators with freeplay.

    \b
    Examples:
      gapsweep run workflows/quick.toml
      gapsweep plan workflows/quick.toml
      gapsweep report data/runs/quick
    """


@commands.command()
@_study
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Output folder.  [default: data/runs/<study name>]",
)
@_workers
@click.option("--scheduler", metavar="ADDRESS", help="Use a running Dask scheduler.")
@_engine
@_cache
@click.option(
    "--batch",
    type=click.IntRange(min=1),
    help="Sweep points per task.  [default: chosen from measured cost]",
)
@_retry
def run(
    study: Path,
    out: Path | None,
    workers: int,
    scheduler: str | None,
    engine: str | None,
    cache: Path | None,
    batch: int | None,
    retry_failed: bool,
) -> int:
    """Compute a study, its datasets and its report; resumes by itself."""
    loaded = _loaded(study, engine)
    with _progress() as observer:
        outcome = workflow.carry_out(
            loaded,
            out=out,
            cache=cache,
            workers=workers,
            scheduler=scheduler,
            batch=batch,
            retry_failed=retry_failed,
            on_progress=observer,
        )
    done = outcome.progress
    click.echo(f"{done.n_points} points: {done.n_hits} from the cache, {done.n_computed} computed")
    click.echo(f"report: {outcome.folder / workflow.REPORT}")
    if outcome.failures:
        counts = ", ".join(f"{n} {label}" for label, n in sorted(outcome.failures.items()))
        click.echo(f"failed points: {counts}; see 'status' in {workflow.RESPONSES}", err=True)
        return SOME_FAILED
    return FINISHED


@commands.command()
@_study
@_cache
@_engine
@_workers
@_retry
@click.option("--json", "as_json", is_flag=True, help="Machine-readable output.")
def plan(
    study: Path,
    cache: Path | None,
    engine: str | None,
    workers: int,
    retry_failed: bool,
    as_json: bool,
) -> int:
    """Say what a run would compute, without computing."""
    planned = workflow.plan(_loaded(study, engine), cache, retry_failed=retry_failed)
    expected = workflow.expected_seconds(planned, cache, workers)
    numbers = {
        "points": planned.n_points,
        "hits": planned.n_hits,
        "missing": planned.n_missing,
        "failed": planned.n_failed,
        "expected_s": None if expected is None else round(expected, 3),
    }
    if as_json:
        click.echo(json.dumps(numbers))
    else:
        del numbers["expected_s"]
        for name, value in numbers.items():
            click.echo(f"{name:>8}  {value}")
        click.echo(f"expected  {'unknown' if expected is None else _duration(expected)}")
    return FINISHED


@commands.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
def report(folder: Path) -> int:
    """Rebuild the report of a run from its NetCDF files alone."""
    click.echo(f"report: {workflow.report(folder)}")
    return FINISHED


def main() -> None:
    """Entry point: every known error becomes a line on stderr, never a traceback."""
    # A user's own law is looked up where the command is typed.
    sys.path.insert(0, "")
    sys.exit(exit_code())


def exit_code(arguments: list[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    try:
        result = commands.main(arguments, prog_name="gapsweep", standalone_mode=False)
    except GapsweepError as error:
        for line in str(error).splitlines():
            click.echo(f"error: {line}", err=True)
        return FAULT
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (click.Abort, KeyboardInterrupt):
        click.echo("interrupted; run again to resume", err=True)
        return INTERRUPTED
    return int(result or FINISHED)


def _loaded(path: Path, engine: str | None) -> Study:
    study = Study.load(path)
    return study.with_engine(engine) if engine else study


@contextmanager
def _progress() -> Iterator[OnProgress]:
    """A bar on a terminal, a line now and then elsewhere; both on stderr."""
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
        click.echo(
            f"{progress.n_done}/{progress.n_points} points, {progress.rate:.1f}/s, "
            f"{progress.n_hits} hits, {progress.n_failed} failed, {_duration(left)} left",
            err=True,
        )

    return write


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}"
