"""Commands and code of the README work as printed."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import gapsweep as gs
from gapsweep.user_code.package_digest import numerics_fingerprint

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", README, re.DOTALL | re.MULTILINE)
PYTHON = [code for kind, code in BLOCKS if kind == "python"]
# What must be read in the output, by number of the block.


@pytest.mark.extended
@pytest.mark.parametrize("number", range(len(PYTHON)))
def test_every_python_block_is_a_script(number, tmp_path):
    """Saved to a file and run with plain ``python``, in a folder with the studies of a clone."""
    shutil.copytree(ROOT / "workflows", tmp_path / "workflows")
    (tmp_path / "block.py").write_text(PYTHON[number])
    environment = {name: text for name, text in os.environ.items() if name != "GAPSWEEP_CACHE"}
    done = subprocess.run(
        [sys.executable, "block.py"],
        cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert not re.search("Traceback|Warning", done.stderr)


def test_the_first_screen_is_short():
    """A newcomer reads what it is, a picture, the installation and a first script in 60 lines."""
    head = README[: README.index("| I have |")]
    assert head.count("\n") <= 65
    assert len(README.split()) <= 900


@pytest.mark.parametrize("page", ["README.md", "docs/answer.md"])
def test_the_answer_was_made_by_these_numerics(page):
    """Else run workflows/paper/study.toml and benchmarks/answer.py again."""
    assert numerics_fingerprint() in (ROOT / page).read_text()


def test_quick_study_is_valid():
    study = gs.Study.load(ROOT / "workflows" / "quick.toml")
    assert study.grid.requested.sum() == 1212
