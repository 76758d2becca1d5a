"""Commands on what runs have left, and the explorer."""

import json
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

import click

from gapsweep.cli import options
from gapsweep.cli.options import FINISHED


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@options.as_json
def status(folder: Path, as_json: bool) -> int:
    """Show the progress or the end of a run, from any shell.

    Names damaged files; reads at most 100 MB to find them.

    \b
    Example:
      gapsweep status data/runs/quick
    """
    from gapsweep.store.artefact import SUMS, checked
    from gapsweep.store.state import RUNNING, RunState

    state = RunState.read(folder)
    # A run that goes on makes anew what is damaged, and replaces files meanwhile.
    damaged, unread = (None, None) if state.state == RUNNING else checked(folder)
    if as_json:
        click.echo(json.dumps(asdict(state) | {"damaged": damaged, "not_checked": unread}))
        return FINISHED
    click.echo(f"{state.study}: {state.state}{f' ({state.message})' if state.message else ''}")
    click.echo(
        f"{state.hits + state.computed} of {state.points} points: {state.hits} from the cache, "
        f"{state.computed} computed, {state.failed} failed"
    )
    click.echo(f"started {state.started} on {state.host}")
    click.echo(f"updated {state.updated}")
    if damaged:
        click.echo(f"damaged or absent: {options.first(damaged)}; run again to repair them")
    if unread:
        click.echo(f"large, so not checked: {options.first(unread)}; sha256sum --check {SUMS}")
    return FINISHED


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@options.beside
def report(folder: Path, study: Path | None) -> int:
    """Rebuild the report of a run from its files.

    Sections of the study's own [report] module are shown as stored; --study makes them again. No
    file in DIR is executed.

    \b
    Examples:
      gapsweep report data/runs/quick
      gapsweep report data/runs/paper --study paper/study.toml
    """
    from gapsweep import pipeline
    from gapsweep.console import busy

    with busy("making the report"):
        shown = pipeline.report(folder, options.loaded(study, None) if study else None)
    click.echo(f"report: {shown}")
    return FINISHED


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@options.beside
@options.as_json
def claims(folder: Path, study: Path | None, as_json: bool) -> int:
    """Show the verdicts of a run, or decide its claims again.

    --study decides the claims of that study's [claims] module from the datasets in DIR and writes
    claims.json there. No file in DIR is executed.

    \b
    Examples:
      gapsweep claims data/runs/paper
      gapsweep claims data/runs/paper --study paper/study.toml
    """
    from gapsweep import pipeline
    from gapsweep.console import busy, print_table
    from gapsweep.run_folder import CLAIMS

    with busy("deciding the claims"):
        decided = pipeline.claims(folder, options.loaded(study, None) if study else None)
    if as_json:
        click.echo(json.dumps(decided, ensure_ascii=False))
        return FINISHED
    told = [
        (str(one["id"]), one["verdict"], f"{one['place']}: {one['claim']}\n{one['sentence']}")
        for one in decided["claims"]
    ]
    print_table(("id", "verdict", "claim, and what was found"), told)
    counts = ", ".join(f"{n} {verdict}" for verdict, n in decided["counts"].items())
    click.echo(f"{len(decided['claims'])} claims: {counts}")
    if study:
        click.echo(f"written: {folder / CLAIMS}")
    return FINISHED


@click.command()
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

    Computes frequency response, motion, section and spectrum while a slider moves. A study file
    sets the ranges of the sliders. For the folder of a run the page also shows its points; a click
    opens one. Only this machine can open the page; Ctrl-C closes it.

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
