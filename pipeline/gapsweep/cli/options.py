"""Arguments, options and exit codes that several commands share.

Nothing is imported here that takes time: whoever asks for help shall not wait.
"""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gapsweep.execution.progress import DEFAULT_TIMEOUT

if TYPE_CHECKING:
    from gapsweep.execution.progress import OnProgress
    from gapsweep.study.study import Study

FINISHED, FAULT, SOME_FAILED, INTERRUPTED = 0, 1, 3, 130
FEW = 5  # of many names that are told
ENGINES = ("compiled", "scipy")  # those of gapsweep.integrate.problem, without its imports

study = click.argument("study", type=click.Path(path_type=Path))
cache = click.option(
    "--cache",
    type=click.Path(path_type=Path),
    help="Folder of the cache.  [default: $GAPSWEEP_CACHE, else data/cache]",
)
out = click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Output folder.  [default: data/runs/<study name>]",
)
engine = click.option(
    "--engine", type=click.Choice(ENGINES), help="Solver engine.  [default: as the study says]"
)
retry_failed = click.option("--retry-failed", is_flag=True, help="Compute failed points again.")
timeout = click.option(
    "--timeout",
    type=click.FloatRange(min=0, min_open=True),
    default=DEFAULT_TIMEOUT,
    show_default=True,
    help="Seconds of processor time that one sweep point or motion may take.",
)
workers = click.option(
    "--workers", type=click.IntRange(min=1), default=2, show_default=True, help="Local processes."
)
scheduler = click.option("--scheduler", metavar="ADDRESS", help="Use a running Dask scheduler.")
beside = click.option(
    "--study",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Study whose Python modules are run for this.  [default: show what is stored]",
)
as_json = click.option("--json", "as_json", is_flag=True, help="Machine-readable output.")
selection = click.option(
    "--sel",
    "wanted",
    metavar="KEY=VALUE",
    multiple=True,
    help="Points to take: KEY is any dimension of the study, as representation, K_c, gap or omega, "
    "VALUE one value, a list A,B,... or, for numbers, a range A:B that includes both ends. Repeat "
    "for several keys.",
)

_LABELLED = ("representation", "gap")


def first(names: Sequence[str]) -> str:
    """The first few of some names, and how many more there are."""
    more = [f"{len(names) - FEW} more"] if len(names) > FEW else []
    return ", ".join([*names[:FEW], *more])


def loaded(path: Path, engine: str | None) -> "Study":
    """The study in a file, on the engine asked for."""
    from gapsweep.study.spec import read
    from gapsweep.study.study import Study

    system = read(path).system
    if system is not None and ":" in (system.function or ""):
        from gapsweep.execution.try_out import try_out_system

        try_out_system(str(system.function), path)
    with redirect_stdout(sys.stderr):
        found = Study.load(path)
    if found.grid.starts.kind.any() and len(found.grid.omega) == 1:
        said = "sweeps follow the frequency, and there is one: they start from rest"
        click.echo(f"warning: {path}: initial_condition: {said}", err=True)
    return found.with_engine(engine) if engine else found


@contextmanager
def at_work() -> Iterator["OnProgress"]:
    """Show progress; what a study's code prints meanwhile is no result of the command."""
    from gapsweep.console import progress_bar

    with redirect_stdout(sys.stderr), progress_bar() as observer:
        yield observer


def selected(wanted: tuple[str, ...]) -> dict[str, Any]:
    """``KEY=VALUE`` texts as arguments of `Study.select`."""
    found = [_selected(text) for text in wanted]
    keys = [key for key, _ in found]
    for key in keys:
        if keys.count(key) > 1:
            message = f"{key!r} is given {keys.count(key)} times: write {key}=A,B"
            raise click.BadParameter(message, param_hint="--sel")
    return dict(found)


def _selected(text: str) -> tuple[str, Any]:
    from gapsweep.study.schema import OF_CALLS

    key, equals, value = text.partition("=")
    if not equals or not value:
        raise click.BadParameter(f"{text!r}: must read KEY=VALUE", param_hint="--sel")
    if key in OF_CALLS:
        raise click.BadParameter(f"{key!r}: no dimension of a study", param_hint="--sel")
    if key in _LABELLED:
        return key, value.split(",")
    if key == "initial_condition" and not value.replace(",", "").replace(":", "").isdecimal():
        return key, value.split(",")  # the study knows its starts, and names them
    number = int if key == "initial_condition" else float
    try:
        if ":" in value:
            low, _, high = value.partition(":")
            return key, slice(number(low) if low else None, number(high) if high else None)
        return key, [number(part) for part in value.split(",")]
    except ValueError:
        raise click.BadParameter(f"{text!r}: not a number", param_hint="--sel") from None
