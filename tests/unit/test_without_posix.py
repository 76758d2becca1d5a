"""Windows-like conditions, as far as Linux has them: no POSIX modules and calls, spawn only."""

import os
import subprocess
import sys
from pathlib import Path, PureWindowsPath

import pytest

import gapsweep as gs

pytestmark = pytest.mark.extended

# Run by every Python process that has its folder on the path: caller, helpers and workers.
SITE = """
import multiprocessing, os, sys
import filelock, locket, psutil  # have their own code for Windows, and are not the subject
for name in ("fcntl", "resource", "pwd", "grp", "multiprocessing.forkserver"):
    sys.modules[name] = None
for name in ("fork", "forkpty", "killpg", "setsid", "getpgid"):
    vars(os).pop(name, None)
contexts = multiprocessing.context._concrete_contexts
for name in ("fork", "forkserver"):
    contexts.pop(name, None)
multiprocessing.get_all_start_methods = lambda: ["spawn"]
multiprocessing.set_start_method("spawn", force=True)
"""
SCRIPT = """
import os, sys
import gapsweep as gs
assert not hasattr(os, "fork") and sys.modules["fcntl"] is None
law = gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4))
assert gs.respond(gs.systems.paper_oscillator(), law, omega=9.0).status.label == "ok"
block = {"representation": ["piecewise", "tanh-1e4@tight"], "K_c": 1.4e4, "gap": [4e-4, 4e-4]}
tables = {"study": {"name": "small"}, "protocol": {"tight": {"rtol": 1e-10}}}
tables["oscillator"] = {"mass": 3.0, "omega_n": 5.0, "zeta": 0.03, "forcing": 4.0, "alpha": 7e8}
tables["sweep"] = [block | {"omega": [8.0, 9.0]}]
if __name__ == "__main__":
    with gs.run(gs.Study.from_dict(tables), out="run", cache="points", workers=1) as ds:
        print((ds.status == 0).all().item(), ds.sizes["omega"])
    print(gs.Study.from_dict(tables).plan(cache="points"))
"""
RESERVED = set('<>:"|?*\\')


def test_a_study_runs_without_posix(tmp_path):
    (tmp_path / "sitecustomize.py").write_text(SITE)
    (tmp_path / "script.py").write_text(SCRIPT)
    paths = os.pathsep.join([str(tmp_path), str(Path(gs.__file__).parents[1])])
    done = subprocess.run(
        [sys.executable, "script.py"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": paths},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("True 2")
    assert "0 missing" in done.stdout
    files = [path.relative_to(tmp_path) for path in tmp_path.rglob("*")]
    assert Path("run/report/index.html") in files
    # Names that Windows takes, though a label holds a colon.
    assert not any(PureWindowsPath(path).is_reserved() for path in files)
    assert not any(RESERVED & set(path.as_posix()) for path in files)
