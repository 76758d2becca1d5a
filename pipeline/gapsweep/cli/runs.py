"""Commands on the folder of a run, and the explorer."""

import json
import tempfile
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

import click

from gapsweep.cli import options
from gapsweep.cli.options import FINISHED, echo


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@options.as_json
def status(folder: Path, as_json: bool) -> int:
    """Show progress, outcome and damaged files of a run.

    Works from any shell. Checksums of at most 100 MB of files are tested.

    \b
    Example:
      gapsweep status data/runs/quick
    """
    from gapsweep.store.artefact import SUMS, checked
    from gapsweep.store.state import RUNNING, RunState

    state = RunState.read(folder)
    # An active run replaces files, damaged ones too.
    damaged, unread = (None, None) if state.state == RUNNING else checked(folder)
    if as_json:
        echo(json.dumps(asdict(state) | {"damaged": damaged, "not_checked": unread}))
        return FINISHED
    echo(f"{state.study}: {state.state}{f' ({state.message})' if state.message else ''}")
    echo(
        f"{state.hits + state.computed} of {state.points} points: {state.hits} from the cache, "
        f"{state.computed} computed, {state.failed} failed"
    )
    echo(f"started {state.started} on {state.host}")
    echo(f"updated {state.updated}")
    if damaged:
        echo(f"damaged or missing: {options.first(damaged)}; 'gapsweep run' repairs them")
    if unread:
        echo(f"not checked (large): {options.first(unread)}; check with sha256sum --check {SUMS}")
    return FINISHED


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@options.of_study
def report(folder: Path, study: Path | None) -> int:
    """Rebuild the report of a run from its files.

    Sections of a [report] module are shown as stored; --study recomputes them. No file in DIR is
    executed.

    \b
    Examples:
      gapsweep report data/runs/quick
      gapsweep report data/runs/paper --study paper/study.toml
    """
    from gapsweep import pipeline
    from gapsweep.console import busy

    with busy("writing the report"):
        shown = pipeline.report(folder, options.loaded(study, None) if study else None)
    echo(f"report: {shown}")
    return FINISHED


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@options.of_study
@options.as_json
def claims(folder: Path, study: Path | None, as_json: bool) -> int:
    """Show the verdicts of a run's claims, or recompute them.

    --study evaluates the claims of that study's [claims] module on the datasets in DIR and writes
    claims.json there. No file in DIR is executed.

    \b
    Examples:
      gapsweep claims data/runs/paper
      gapsweep claims data/runs/paper --study paper/study.toml
    """
    from gapsweep import pipeline
    from gapsweep.console import busy, print_table
    from gapsweep.run_folder import CLAIMS
    from gapsweep.store.artefact import reading

    with reading(folder), busy("evaluating the claims"):
        decided = pipeline.claims(folder, options.loaded(study, None) if study else None)
    if as_json:
        echo(json.dumps(decided, ensure_ascii=False))
        return FINISHED
    with reading(folder):
        rows = [
            (str(one["id"]), one["verdict"], f"{one['place']}: {one['claim']}\n{one['sentence']}")
            for one in decided["claims"]
        ]
        tallies = {f"{len(rows)} claims": decided["counts"], **decided.get("otherwise", {})}
        lines = [
            f"{words}: {', '.join(f'{n} {verdict}' for verdict, n in counts.items())}"
            for words, counts in tallies.items()
        ]
        print_table(("id", "verdict", "claim and result"), rows)
    echo("\n".join(lines))
    if study:
        echo(f"written: {folder / CLAIMS}")
    return FINISHED


@click.command()
@click.argument("path", metavar="[STUDY or DIR]", required=False, type=click.Path(path_type=Path))
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=0,
    show_default="a free port",
    help="Port of the page on this machine.",
)
@click.option("--no-browser", is_flag=True, help="Print the address without opening a browser.")
def explore(path: Path | None, port: int, no_browser: bool) -> int:
    """Open an interactive page with sliders for the parameters.

    The page computes frequency response, motion, section and spectrum while a slider moves. A study
    file sets the ranges of the sliders. For the folder of a run the page also shows the points of
    the run; a click opens a point. Only this machine can open the page; Ctrl-C closes it.

    \b
    Examples:
      gapsweep explore
      gapsweep explore workflows/quick.toml
      gapsweep explore data/runs/quick --port 5006
    """
    from gapsweep.explorer.widget import explore_path

    page = explore_path(path, port)
    echo(f"{page.url} (Ctrl-C closes it)")
    with tempfile.TemporaryDirectory() as private, suppress(KeyboardInterrupt):
        if not no_browser:
            # All users of the machine can read the browser's command line, none but ours the file.
            link = Path(private) / "explore.html"
            link.write_text(f'<meta http-equiv="refresh" content="0; url={page.url}">')
            click.launch(link.as_uri())
        page.wait()
    return FINISHED
