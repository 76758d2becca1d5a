"""Runs of studies: by a call, by the command line in this process, and in other processes."""

import io
import os
import subprocess
import sys
import time
from contextlib import chdir, nullcontext, redirect_stderr, redirect_stdout
from pathlib import Path
from types import SimpleNamespace

import pytest

import gapsweep as gs
from gapsweep.cli.main import exit_code

ROOT = Path(__file__).parents[2]
SOURCES = Path(gs.__file__).parent
ENTRY = "import sys; from gapsweep.cli import main; sys.argv[0] = 'gapsweep'; main()"
# The line of a shell, as users type it: unlike ``python -c``, it finds no module in its folder.
COMMAND = Path(sys.executable).with_name("gapsweep")


def run(tables, client, folder, out="out", **options):
    """Responses, in memory, of a study that runs into a folder there, with a cache next to it."""
    study = gs.Study.from_dict(tables)
    options = {"cache": folder / f"{out}-cache"} | options
    with gs.run(study, client, out=folder / out, **options) as ds:
        return ds.load()


def on_a_cluster(client):
    """A function of a folder and arguments that runs ``gapsweep`` there on the client's workers.

    In this process, for runs that do not end it: without imports and a cluster. It must end with
    the exit code `code`, and show no traceback.
    """

    def gapsweep(folder, *arguments, cache=None, code=0):
        out, errors = io.StringIO(), io.StringIO()
        with (
            chdir(folder), redirect_stdout(out), redirect_stderr(errors),
            pytest.MonkeyPatch.context() as patch,
        ):  # fmt: skip
            local = "gapsweep.execution.cluster.local_cluster"
            patch.setattr(local, lambda *_: nullcontext(client))
            patch.setattr("gapsweep.execution.cluster.CONNECT_SECONDS", 1)
            if cache is None:
                patch.delenv("GAPSWEEP_CACHE", raising=False)
            else:
                patch.setenv("GAPSWEEP_CACHE", cache)
            found = exit_code(list(arguments))
        assert found == code, errors.getvalue()
        assert "Traceback" not in errors.getvalue()
        return SimpleNamespace(stdout=out.getvalue(), stderr=errors.getvalue())

    return gapsweep


def _process(folder, arguments, command, variables):
    """Arguments and options of a process in a folder; variables that are None are removed."""
    command = [sys.executable, "-c", ENTRY] if command is None else command
    path = os.pathsep.join(map(str, [SOURCES.parent, ROOT]))
    variables = {**os.environ, "PYTHONPATH": path, "GAPSWEEP_CACHE": None, **(variables or {})}
    environment = {name: value for name, value in variables.items() if value is not None}
    return [*command, *arguments], {"cwd": folder, "env": environment, "text": True}


def in_a_process(folder, *arguments, command=None, variables=None, code=0, **options):
    """The text that ``gapsweep`` with these arguments writes in a process.

    It must end with the exit code `code`, and show no traceback.
    """
    command, settings = _process(folder, arguments, command, variables)
    options = {"capture_output": True, "timeout": 300} | settings | options
    done = subprocess.run(command, check=False, **options)
    assert done.returncode == code, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return done


def started(folder, *arguments, command=None, variables=None, **options):
    """``gapsweep`` with these arguments in a process that goes on, first of its process group."""
    command, settings = _process(folder, arguments, command, variables)
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, start_new_session=True, **pipes | settings | options)


def wait_until(is_so, seconds=60):
    """Wait until a function returns something true; fail after that many seconds."""
    deadline = time.monotonic() + seconds
    while not is_so():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def replaced(path, old, new):
    """An edit of equal size that leaves the time of modification as it was."""
    text, before = path.read_text(), path.stat()
    assert old in text
    assert len(old) == len(new)
    path.write_text(text.replace(old, new))
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
