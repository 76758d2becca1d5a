"""The command line in this process, for what does not end it: without imports and a cluster."""

import io
from contextlib import chdir, nullcontext, redirect_stderr, redirect_stdout
from types import SimpleNamespace

import pytest

from gapsweep.cli.main import exit_code


def on_a_cluster(client):
    """A function of a folder and arguments that runs ``gapsweep`` there on the client's workers."""

    def gapsweep(folder, *arguments, cache=None):
        out, errors = io.StringIO(), io.StringIO()
        with (
            chdir(folder), redirect_stdout(out), redirect_stderr(errors),
            pytest.MonkeyPatch.context() as patch,
        ):  # fmt: skip
            patch.setattr("gapsweep.execution.cluster._local", lambda *_: nullcontext(client))
            patch.setattr("gapsweep.execution.cluster._CONNECT_SECONDS", 1)
            if cache is None:
                patch.delenv("GAPSWEEP_CACHE", raising=False)
            else:
                patch.setenv("GAPSWEEP_CACHE", cache)
            code = exit_code(list(arguments))
        return SimpleNamespace(returncode=code, stdout=out.getvalue(), stderr=errors.getvalue())

    return gapsweep
