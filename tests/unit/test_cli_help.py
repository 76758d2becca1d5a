"""``--help``: fits 80 columns, has examples that can be typed, and completion works."""

import shlex
import subprocess
import sys

import click
import pytest
from tests.builders.runs import in_a_process

from gapsweep.cli.main import commands
from gapsweep.cli.options import ENGINES, selected
from gapsweep.integrate import problem

WIDTH = 80


def every(command, path=("gapsweep",)):
    """All commands with the words that call them."""
    yield path, command
    for name, child in getattr(command, "commands", {}).items():
        yield from every(child, (*path, name))


COMMANDS = dict(every(commands))
ids = pytest.mark.parametrize("path", COMMANDS, ids=" ".join)


def help_of(path):
    settings = commands.context_settings | {"terminal_width": WIDTH}
    with click.Context(COMMANDS[path], info_name=" ".join(path), **settings) as context:
        return COMMANDS[path].get_help(context)


def examples(path):
    """The lines under Example(s), continued ones joined."""
    _, _, rest = help_of(path).replace("\\\n", " ").partition("Example")
    return [line.strip() for line in rest.splitlines() if line.strip().startswith("gapsweep ")]


@ids
def test_help_fits_the_terminal_and_truncates_nothing(path):
    text = help_of(path)
    assert max(len(line) for line in text.splitlines()) <= WIDTH
    assert not [line for line in text.splitlines() if line.endswith("...") and "Usage" not in line]


@ids
def test_every_option_says_what_it_does(path):
    options = [p for p in COMMANDS[path].params if isinstance(p, click.Option)]
    assert all(option.help for option in options)


@ids
def test_examples_can_be_typed(path):
    assert examples(path)
    for line in examples(path):
        words, command = shlex.split(line), commands
        assert tuple(words[: len(path)]) == path
        with click.Context(commands) as context:
            arguments = words[1:]
            while isinstance(command, click.Group):
                name, command, arguments = command.resolve_command(context, arguments)
            command.make_context(name, arguments, parent=context)


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("gapsweep ru", "plain,run"),
        ("gapsweep cache ver", "plain,verify"),
        ("gapsweep run --engine comp", "plain,compiled"),
        ("gapsweep run --retry", "plain,--retry-failed"),
    ],
)
def test_shell_completion_offers_what_fits(words, offered, tmp_path):
    environment = {
        "_GAPSWEEP_COMPLETE": "bash_complete",
        "COMP_WORDS": words,
        "COMP_CWORD": str(len(words.split()) - 1),
    }
    done = in_a_process(tmp_path, variables=environment)
    assert done.stdout.split() == [offered]


def test_help_waits_for_nothing():
    """A fifth of a second of processor time, in which no library that computes is imported."""
    code = (
        "import atexit, sys, time\n"
        "from gapsweep.cli import main\n"
        "atexit.register(lambda: print(time.process_time(), *sys.modules, file=sys.stderr))\n"
        "main()"
    )
    done = subprocess.run([sys.executable, "-c", code, "--help"], capture_output=True, text=True)
    seconds, *modules = done.stderr.split()
    assert "gapsweep.cli.studies" in modules
    assert not {"numpy", "pydantic", "rich", "importlib.metadata"} & set(modules)
    assert float(seconds) < 0.2


def test_engines_are_those_of_the_solver():
    assert ENGINES == problem.ENGINES


def test_a_key_of_a_selection_is_given_once():
    with pytest.raises(click.BadParameter, match="'omega' occurs 2 times; write omega=A,B"):
        selected(("omega=2", "K_c=1e4", "omega=20"))
