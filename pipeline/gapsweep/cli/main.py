"""Commands on studies and runs, and how errors become exit codes."""

import json
import os
import shutil
import sys
import textwrap
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, TextIO

import click

from gapsweep import __version__, make, own_code, workflow
from gapsweep.cli import options
from gapsweep.cli.cache import cache_commands
from gapsweep.console import duration, progress_bar
from gapsweep.errors import GapsweepError
from gapsweep.stages import CLAIMS, REPORT, RESPONSES
from gapsweep.store import netcdf
from gapsweep.store.state import RunState
from gapsweep.study.study import Study

FINISHED, FAULT, SOME_FAILED, INTERRUPTED = 0, 1, 3, 130


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 80})
@click.version_option(__version__)
def commands() -> None:
    """Parameter studies of oscillators with freeplay.

    Exit codes: 0 finished, 1 a study, file or cluster error, 2 a wrong command line, 3 finished
    but some points failed, 130 interrupted (run again to resume).

    \b
    Examples:
      gapsweep run workflows/quick.toml
      gapsweep plan workflows/quick.toml
      gapsweep query workflows/quick.toml --sel omega=10:12 --to csv
      gapsweep status data/runs/quick
    """


commands.add_command(cache_commands)


@commands.command()
@options.study
@options.out
@options.workers
@options.scheduler
@options.engine
@options.cache
@click.option(
    "--batch",
    type=click.IntRange(min=1),
    help="Sweep points per task.  [default: chosen from measured cost]",
)
@options.timeout
@options.retry_failed
def run(study: Path, engine: str | None, **how: Any) -> int:
    """Compute a study, its datasets and its report; resumes by itself.

    \b
    Examples:
      gapsweep run workflows/quick.toml
      gapsweep run workflows/quick.toml --out /tmp/quick --workers 4
      gapsweep run workflows/quick.toml --scheduler tcp://host:8786
    """
    loaded = options.loaded(study, engine)
    with progress_bar() as observer:
        outcome = workflow.carry_out(loaded, on_progress=observer, **how)
    done = outcome.progress
    shared = f", {done.n_shared} by another run" if done.n_shared else ""
    click.echo(
        f"{done.n_points} points: {done.n_hits} from the cache, {done.n_computed} computed{shared}"
    )
    click.echo(f"report: {outcome.folder / REPORT}")
    crossings = netcdf.values(outcome.folder / RESPONSES, "n_contacts")
    if not (outcome.failures or crossings.any()):
        click.echo("no motion has reached a wall; gaps are in metres, as 4e-4", err=True)
    if outcome.failures:
        _say_failed("points", outcome.failures, RESPONSES)
    for file, counts in outcome.failed_motions.items():
        _say_failed("motions", counts, file)
    return SOME_FAILED if outcome.failures or outcome.failed_motions else FINISHED


def _say_failed(what: str, counts: Mapping[str, int], file: str) -> None:
    listed = ", ".join(f"{n} {label}" for label, n in sorted(counts.items()))
    click.echo(f"failed {what}: {listed}; see 'status' in {file}", err=True)


@commands.command()
@options.study
@options.cache
@options.out
@options.engine
@options.workers
@options.retry_failed
@options.as_json
def plan(
    study: Path,
    cache: Path | None,
    out: Path | None,
    engine: str | None,
    workers: int,
    retry_failed: bool,
    as_json: bool,
) -> int:
    """Say what a run would compute and make, without doing it.

    \b
    Examples:
      gapsweep plan workflows/quick.toml
      gapsweep plan workflows/quick.toml --json
    """
    loaded = options.loaded(study, engine)
    planned = workflow.plan(loaded, cache, retry_failed=retry_failed)
    expected = workflow.expected_seconds(planned, cache, workers)
    stages = workflow.stage_reasons(loaded, planned, out, cache)
    numbers = {
        "points": planned.n_points,
        "hits": planned.n_hits,
        "missing": planned.n_missing,
        "failed": planned.n_failed,
        "damaged": planned.n_damaged,
    }
    if as_json:
        rounded = None if expected is None else round(expected, 3)
        click.echo(json.dumps(numbers | {"expected_s": rounded, "stages": stages}))
        return FINISHED
    for name, value in numbers.items():
        click.echo(f"{name:>8}  {value}")
    click.echo(f"expected  {'unknown' if expected is None else duration(expected)}")
    for file, reason in stages.items():
        click.echo(f"{file}: {f'to be made: {reason}' if reason else 'up to date'}")
    return FINISHED


@commands.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@options.as_json
def status(folder: Path, as_json: bool) -> int:
    """Tell how a run is doing, or how it ended, from any shell.

    \b
    Example:
      gapsweep status data/runs/quick
    """
    state = RunState.read(folder)
    if as_json:
        click.echo(json.dumps(asdict(state)))
        return FINISHED
    click.echo(f"{state.study}: {state.state}{f' ({state.message})' if state.message else ''}")
    click.echo(
        f"{state.hits + state.computed} of {state.points} points: {state.hits} from the cache, "
        f"{state.computed} computed, {state.failed} failed"
    )
    click.echo(f"started {state.started}, last heard of {state.updated}, on {state.host}")
    return FINISHED


@commands.command()
@options.study
@options.selection
@options.cache
@options.engine
@options.workers
@options.scheduler
@click.option(
    "--to",
    "form",
    type=click.Choice(["csv", "json", "nc"]),
    default="csv",
    show_default=True,
    help="A row per point (csv), a JSON object per line (json), NetCDF (nc).",
)
@click.option(
    "--output", type=click.Path(path_type=Path, dir_okay=False), help="New file.  [default: stdout]"
)
def query(
    study: Path,
    wanted: tuple[str, ...],
    engine: str | None,
    form: str,
    output: Path | None,
    **how: Any,
) -> int:
    """Print a table of responses; computes only what is missing.

    \b
    Examples:
      gapsweep query workflows/quick.toml --sel omega=10:12
      gapsweep query workflows/quick.toml --sel representation=piecewise \\
          --to nc --output exact.nc
    """
    from gapsweep.cli.table import check_output, written

    if form == "nc" and output is None:
        raise click.UsageError("--to nc needs --output FILE")
    if output is not None:
        check_output(output)
    loaded = options.loaded(study, engine)
    with progress_bar() as observer:
        found = workflow.query(loaded, on_progress=observer, **how, **options.selected(wanted))
    click.echo(
        f"{found.attrs['n_points']} points, {found.attrs['n_hits']} from the cache", err=True
    )
    written(found, form, output)
    return FINISHED


@commands.command()
@options.study
@options.selection
@options.cache
@options.engine
@click.option(
    "--limit",
    type=click.IntRange(min=1),
    default=10,
    show_default=True,
    help="Points to explain.",
)
def explain(
    study: Path, wanted: tuple[str, ...], cache: Path | None, engine: str | None, limit: int
) -> int:
    """Say why points are in the cache or not.

    The key of each point, field by field, is set against the nearest one that is stored.

    \b
    Example:
      gapsweep explain workflows/quick.toml --sel omega=10
    """
    loaded = options.loaded(study, engine)
    for point in workflow.explain(loaded, cache, limit, **options.selected(wanted)):
        click.echo(f"{point.label}: {point.status}{f' on {point.host}' if point.host else ''}")
        if point.message:
            click.echo(f"  {point.message}")
        if point.differences is None and point.status in ("missing", "damaged"):
            click.echo("  nothing is stored")
        for name, (asked, stored) in (point.differences or {}).items():
            click.echo(f"  {name}: asked {_short(asked)}, nearest stored {_short(stored)}")
    return FINISHED


def _short(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:18]}...{text[-18:]}"


@commands.command()
@options.study
@click.option(
    "--error",
    type=float,
    help="Error of the steady amplitude to meet.  [default: [auto] of the study, else 1e-3]",
)
@options.as_json
def advise(study: Path, error: float | None, as_json: bool) -> int:
    """Name the least model that each scene needs.

    \b
    Example:
      gapsweep advise workflows/quick.toml --error 1e-2
    """
    from gapsweep.analysis.advice import advice, sentences

    found = advice(Study.load(study), error)
    scenes = sentences(found)
    if as_json:
        click.echo(json.dumps({"error": found.attrs["error"], "scenes": scenes}))
        return FINISHED
    click.echo(f"for an error of the steady amplitude of {found.attrs['error']:g}:")
    for scene in scenes:
        click.echo(_scene(scene))
        for one in scene["starts"]:
            click.echo(f"  from {one['start']}:")
            for part in one["advice"]:
                hertz = f"{part['from']:g} to {part['to']:g} Hz"
                model = f"{part['model']}, rtol {part['rtol']:g}"
                click.echo(f"    {hertz:<16} {model:<22} {part['reason']}")
        click.echo(f"  {scene['stand_ins']}")
    return FINISHED


def _scene(scene: dict[str, Any]) -> str:
    words = [f"K_c = {scene['K_c']:g} N/m", f"gap {scene['gap']} mm"]
    swept = scene.keys() - {"K_c", "gap", "starts", "stand_ins", "j_1", "j_2"}
    return ", ".join(words + [f"{name} = {scene[name]:g}" for name in sorted(swept)])


@commands.command()
@click.argument("path", metavar="[STUDY or DIR]", required=False, type=click.Path(path_type=Path))
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=0,
    show_default="any that is free",
    help="Port of this machine that the page is at.",
)
@click.option("--no-browser", is_flag=True, help="Print the address, open no browser.")
def explore(path: Path | None, port: int, no_browser: bool) -> int:
    """Open a page whose figures follow its sliders.

    Frequency response, motion, section and spectrum, computed while a slider moves. A study file
    says where the sliders start and end; of the folder of a run its points are shown too, and a
    click opens one. The page is for this machine only; Ctrl-C closes it.

    \b
    Examples:
      gapsweep explore
      gapsweep explore workflows/quick.toml
      gapsweep explore data/runs/quick --port 5006
    """
    from gapsweep.explorer.widget import explore_path

    page = explore_path(path, port)
    click.echo(f"{page.url} (Ctrl-C closes it)")
    if not no_browser:
        click.launch(page.url)
    with suppress(KeyboardInterrupt):
        page.wait()
    return FINISHED


@commands.command()
@options.study
@options.out
@options.timeout
@options.as_json
def bench(study: Path, out: Path | None, timeout: float, as_json: bool) -> int:
    """Measure error, cost and status of methods.

    Every method of the study's [bench] on every one of its scenes, in one process; laws of your
    own in another, so that they can harm nothing.

    \b
    Example:
      gapsweep bench workflows/work_precision.toml
    """
    from gapsweep.report.bench import conclusions

    loaded = options.loaded(study, None)
    files = make.bench(loaded, out, lambda text: click.echo(text, err=True), timeout=timeout)
    found, code = {}, FINISHED
    for file in files:
        if counts := make.failed_motions(file):
            _say_failed("motions", counts, file.name)
            code = SOME_FAILED
        with netcdf.read(file) as dataset:
            found[file.name] = conclusions(dataset)
    if as_json:
        numbers = {name: lines.numbers for name, lines in found.items()}
        click.echo(json.dumps({"files": [str(file) for file in files]} | numbers))
        return code
    for file in files:
        for sentence in found[file.name].sentences:
            click.echo(sentence)
        click.echo(f"written: {file}")
    shown = files[0].parent / REPORT
    click.echo(f"report: {shown}" if shown.exists() else "'gapsweep run' makes the report")
    return code


@commands.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@options.beside
def report(folder: Path, study: Path | None) -> int:
    """Rebuild the report of a run from its files alone.

    Sections that a study makes itself ([report] module) are shown as they are stored, or made
    anew with --study. No file in DIR is executed.

    \b
    Examples:
      gapsweep report data/runs/quick
      gapsweep report data/runs/paper --study workflows/paper/study.toml
    """
    shown = make.report(folder, Study.load(study) if study else None)
    click.echo(f"report: {shown}")
    return FINISHED


@commands.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@options.beside
@options.as_json
def claims(folder: Path, study: Path | None, as_json: bool) -> int:
    """Show the verdicts of a run, or decide its claims anew.

    With --study, the claims of that study ([claims] module) are decided from the datasets in DIR
    and written to claims.json there. No file in DIR is executed.

    \b
    Examples:
      gapsweep claims data/runs/paper
      gapsweep claims data/runs/paper --study workflows/paper/study.toml
    """
    decided = own_code.claims(folder, Study.load(study) if study else None)
    if as_json:
        click.echo(json.dumps(decided, ensure_ascii=False))
        return FINISHED
    width, margin = shutil.get_terminal_size().columns, " " * 5
    for claim in decided["claims"]:
        stated = f"{claim['id']:>3}  {claim['verdict']:<11}  {claim['place']}: {claim['claim']}"
        for text, indent in ((stated, ""), (claim["sentence"], margin)):
            click.echo(textwrap.fill(text, width, initial_indent=indent, subsequent_indent=margin))
    counts = ", ".join(f"{n} {verdict}" for verdict, n in decided["counts"].items())
    click.echo(f"{len(decided['claims'])} claims: {counts}")
    if study:
        click.echo(f"written: {folder / CLAIMS}")
    return FINISHED


def main() -> None:
    """Entry point: every known error becomes a line on stderr, never a traceback."""
    # In worker processes, too, no module of the current folder may stand in for a library.
    os.environ["PYTHONSAFEPATH"] = "1"
    sys.exit(exit_code())


def exit_code(arguments: list[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = _one_line
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


def _one_line(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    # Those of the libraries are not for the user.
    if category is UserWarning:
        click.echo(f"warning: {message}", err=True)
