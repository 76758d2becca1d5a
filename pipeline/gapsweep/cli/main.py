"""The command ``gapsweep``, and the translation of errors into exit codes."""

import gc
import logging
import os
import signal
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import click

from gapsweep.cli import runs, studies
from gapsweep.cli.cache_commands import cache_commands
from gapsweep.cli.init import init
from gapsweep.cli.options import FAULT, FINISHED, INTERRUPTED, echo
from gapsweep.errors import STOPPING, GapsweepError


class _InOrder(click.Group):
    """A group whose help lists commands in the order of a workflow."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)


@click.group(
    cls=_InOrder, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 80}
)
@click.version_option(package_name="gapsweep")
def commands() -> None:
    """Parameter studies of mechanical systems with freeplay.

    Exit codes: 0 finished, 1 a study, file or cluster error, 2 a wrong command line, 3 finished
    but some points failed, 130 interrupted (a new run resumes).

    \b
    Examples:
      gapsweep init quick
      gapsweep run quick.toml
      gapsweep query quick.toml --sel omega=10:12 --to csv
      gapsweep status data/runs/quick
    """


_COMMANDS = (
    *(init, studies.plan, studies.run, runs.status, runs.report),
    *(studies.query, studies.explain, studies.advise, runs.claims, studies.bench),
    runs.explore,
    cache_commands,
)
for command in _COMMANDS:
    commands.add_command(command)


def main() -> None:
    """Run the command line and exit; an error is printed in one line, without a traceback."""
    # In worker processes, too, no module of the current folder may replace a library.
    os.environ["PYTHONSAFEPATH"] = "1"
    # Objects of imports and figures stay alive: garbage collection at the default rate takes an
    # eighth of the time of a short run.
    gc.set_threshold(20_000, 25, 25)
    for number in STOPPING:  # Ctrl-C is one of them, batch systems send the others
        if signal.getsignal(number) is not signal.SIG_IGN:  # as nohup ignores SIGHUP
            signal.signal(number, signal.default_int_handler)
    if sys.stdout is None:  # closed, by >&-
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115  # open until the process ends
    code = exit_code()
    try:
        sys.stdout.flush()
    except OSError:
        # The output is lost; at exit Python would try again to write it, and print an error.
        with suppress(OSError):
            sys.stdout.close()
    if code == INTERRUPTED:
        # The clean-up of libraries must print nothing, and no Ctrl-C may interrupt it.
        logging.disable()
        for number in STOPPING:
            signal.signal(number, signal.SIG_IGN)
    sys.exit(code)


def exit_code(arguments: list[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    with warnings.catch_warnings():
        warnings.simplefilter("default", UserWarning)
        warnings.showwarning = _one_line_once()
        try:
            result = commands.main(arguments, prog_name="gapsweep", standalone_mode=False)
            sys.stdout.flush()  # a device may be full
        except GapsweepError as error:
            for line in str(error).splitlines():
                echo(f"error: {line}", err=True)
            return FAULT
        except OSError as error:  # of any file whose errors no other code handles
            where = f"{error.filename}: " if error.filename else ""
            echo(f"error: {where}{error.strerror or error}", err=True)
            return FAULT
        except click.ClickException as error:
            error.show()
            return error.exit_code
        except (click.Abort, KeyboardInterrupt):
            echo("interrupted; run again to resume", err=True)
            return INTERRUPTED
    return int(result or FINISHED)


def _one_line_once() -> Callable[..., None]:
    """Function for `warnings.showwarning` that prints every UserWarning once, in one line.

    Python forgets the warnings it has shown when a library changes the filters.
    """
    shown = set()

    def show(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
        # Warnings of libraries are not for the user.
        if category is UserWarning and str(message) not in shown:
            shown.add(str(message))
            echo(f"warning: {message}", err=True)

    return show
