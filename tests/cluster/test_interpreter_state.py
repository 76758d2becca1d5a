"""A library leaves the interpreter of its caller as it was."""

import json
import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.extended

SCRIPT = """
import faulthandler, gc, json, logging, multiprocessing, os, signal, sys, threading, warnings
from multiprocessing import process, resource_tracker, spawn, util

# What these do is theirs.
import dask, distributed, matplotlib.pyplot, netCDF4, numba, numpy, xarray
import scipy.sparse, scipy.special
from distributed.dashboard import scheduler

def state():
    umask = os.umask(0o022)
    os.umask(umask)
    return {
        "paths": [*sys.path],
        "finders": [repr(each) for each in sys.meta_path],
        "byte code": [sys.pycache_prefix, sys.dont_write_bytecode],
        "hooks": [repr(each) for each in (sys.excepthook, sys.unraisablehook)],
        "streams": [repr(each) for each in (sys.stdin, sys.stdout, sys.stderr)],
        "files": [os.readlink(f"/proc/self/fd/{n}") for n in range(3)],
        "signals": [repr(signal.getsignal(n)) for n in signal.valid_signals()],
        "blocked": [*map(int, signal.pthread_sigmask(signal.SIG_BLOCK, []))],
        "timers": [signal.getitimer(n) for n in range(3)],
        "umask": umask,
        "folder": os.getcwd(),
        "environment": dict(os.environ),
        "garbage": [gc.isenabled(), gc.get_threshold(), gc.get_freeze_count()],
        "faults": faulthandler.is_enabled(),
        "hdf5": netCDF4.get_chunk_cache(),
        "numpy": [numpy.get_printoptions(), numpy.geterr(), repr(numpy.geterrcall())],
        "warnings": [repr(each) for each in warnings.filters if "timedelta" not in repr(each)],
        "shown by": repr(warnings.showwarning),
        "loggers": {
            name: [each.level, each.propagate, repr(each.filters)]
            for name, each in sorted(logging.root.manager.loggerDict.items())
            if isinstance(each, logging.Logger) and name in known
        } | {"root": [logging.root.level, repr(logging.root.handlers)]},
        "multiprocessing": [
            multiprocessing.get_start_method(allow_none=True),
            *(repr(value) for module in (spawn, process, util, resource_tracker)
              for name, value in sorted(vars(module).items()) if callable(value)),
        ],
        "dask": dask.config.config,
        "xarray": repr(sorted(xarray.get_options().items())),
        "threads": sorted(
            each.name for each in threading.enumerate() if not each.name.startswith(DASKS)
        ),
        "children": len(multiprocessing.active_children()),
    }

DASKS = "TCP-Executor", "Profile", "IO loop", "Dask-Offload", "asyncio", "Thread-", "ThreadPool"
known = {*logging.root.manager.loggerDict}
before = json.loads(json.dumps(state(), default=str))
import gapsweep as gs
law = gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4))
block = {"representation": ["piecewise"], "K_c": 1.4e4, "gap": [4e-4, 4e-4], "omega": [9.0, 12.0]}
machine = {"mass": 3.0, "omega_n": 5.0, "zeta": 0.03, "forcing": 4.0}
block |= {"representation": REPRESENTATIONS}
study = {"study": {"name": "small"}, "oscillator": machine, "sweep": [block]}
if what != "import":
    gs.respond(gs.systems.paper_oscillator(), law, 9.0)
if what == "run":
    with gs.run(gs.Study.from_dict(study), out="out", cache="cache") as ds:
        assert ds.sizes["omega"] == 2
    gs.open("out/responses.nc").close()
after = json.loads(json.dumps(state(), default=str))
print(json.dumps({k: [before[k], after[k]] for k in before if before[k] != after[k]}))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("what", ["import", "respond", "run"])
def test_the_interpreter_is_left_as_it_was(what, tmp_path):
    """With no guard of ``__main__``, which a cluster could import once more."""
    script = tmp_path / "script.py"
    script.write_text(f"what, REPRESENTATIONS = {what!r}, ['piecewise']\n{SCRIPT}")
    done = subprocess.run(
        [sys.executable, script], cwd=tmp_path, capture_output=True, text=True, timeout=200,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == {}
