"""Arguments, options and exit codes that several commands share.

Nothing slow is imported here, so that help appears at once.
"""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gapsweep.errors import ModelError, printable
from gapsweep.execution.progress import DEFAULT_TIMEOUT

if TYPE_CHECKING:
    from gapsweep.execution.progress import OnProgress
    from gapsweep.study.study import Study

FINISHED, FAULT, SOME_FAILED, INTERRUPTED = 0, 1, 3, 130
FEW = 5  # names that are listed
ENGINES = ("compiled", "scipy")  # as in gapsweep.integrate.problem, without its imports

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
    "--engine", type=click.Choice(ENGINES), help="Solver engine.  [default: engine of the study]"
)
retry_failed = click.option("--retry-failed", is_flag=True, help="Recompute failed points.")
timeout = click.option(
    "--timeout",
    type=click.FloatRange(min=0, min_open=True),
    default=DEFAULT_TIMEOUT,
    show_default=True,
    help="CPU time limit of one sweep point or motion [s].",
)
workers = click.option(
    "--workers", type=click.IntRange(min=1), default=2, show_default=True, help="Local processes."
)
scheduler = click.option("--scheduler", metavar="ADDRESS", help="Use a running Dask scheduler.")
of_study = click.option(
    "--study",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Study file whose Python modules are executed.  [default: show stored results]",
)
as_json = click.option("--json", "as_json", is_flag=True, help="Print JSON.")
selection = click.option(
    "--sel",
    "wanted",
    metavar="KEY=VALUE",
    multiple=True,
    help="Select points. KEY: a dimension of the study, such as representation, K_c, gap or omega. "
    "VALUE: one value, a list A,B,... or a range of numbers A:B, ends included. Repeatable.",
)

_LABELLED = ("representation", "gap")


def echo(message: str = "", *, err: bool = False, nl: bool = True) -> None:
    """Print a text without control characters, which a terminal would execute."""
    click.echo(printable(message), err=err, nl=nl)


def first(names: Sequence[str]) -> str:
    """Text of the first `FEW` names and of the number of further ones."""
    more = [f"{len(names) - FEW} more"] if len(names) > FEW else []
    return ", ".join([*names[:FEW], *more])


def loaded(path: Path, engine: str | None) -> "Study":
    """The study of a file, with another engine if one is named."""
    from gapsweep.study.spec import read
    from gapsweep.study.study import Study

    system = read(path).system
    if system is not None and system.user_function:
        from gapsweep.execution.try_out import try_out_system

        try_out_system(system.user_function, path)
    with redirect_stdout(sys.stderr):
        found = Study.load(path)
    if found.grid.starts.kind.any() and len(found.grid.omega) == 1:
        reason = "sweeps need several values of omega; this sweep starts from rest"
        echo(f"warning: {path}: initial_condition: {reason}", err=True)
    return found.with_engine(engine) if engine else found


@contextmanager
def at_work() -> Iterator["OnProgress"]:
    """Show progress; output of a study's code goes to stderr."""
    from gapsweep.console import progress_bar

    with redirect_stdout(sys.stderr), progress_bar() as observer:
        yield observer


def selected(wanted: tuple[str, ...]) -> dict[str, Any]:
    """Keyword arguments of `Study.select` from ``KEY=VALUE`` texts."""
    found = [_selected(text) for text in wanted]
    keys = [key for key, _ in found]
    for key in keys:
        if keys.count(key) > 1:
            message = f"{key!r} occurs {keys.count(key)} times; write {key}=A,B"
            raise click.BadParameter(message, param_hint="--sel")
    return dict(found)


def _selected(text: str) -> tuple[str, Any]:
    from gapsweep.quantities import without_units
    from gapsweep.study.schema import OF_CALLS

    key, equals, value = text.partition("=")
    if not equals or not value:
        raise click.BadParameter(f"{text!r}: must be KEY=VALUE, as omega=10", param_hint="--sel")
    if key in OF_CALLS:
        raise click.BadParameter(f"{key!r}: not a dimension of a study", param_hint="--sel")
    if key in _LABELLED:
        return key, value.split(",")
    if key == "initial_condition" and not value.replace(",", "").replace(":", "").isdecimal():
        return key, value.split(",")  # the study checks the names

    def number(part: str) -> float:
        if key == "initial_condition":
            return int(part)
        return float(without_units(key, part))

    try:
        if ":" in value:
            low, _, high = value.partition(":")
            return key, slice(number(low) if low else None, number(high) if high else None)
        return key, [number(part) for part in value.split(",")]
    except ModelError as error:
        raise click.BadParameter(str(error), param_hint="--sel") from None
    except ValueError:
        raise click.BadParameter(
            f"{text!r}: must be a number, a list or a range; {', '.join(_LABELLED)} take text",
            param_hint="--sel",
        ) from None
