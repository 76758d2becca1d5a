"""What the README prints works as printed."""

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
PRINTED = {0: ["ok 1"], 1: ["(64,)"], 2: ["contacts of the flap"]}


@pytest.mark.packaging
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
    assert all(words in done.stdout for words in PRINTED.get(number, ()))


def test_study_example_is_valid(tmp_path):
    (text,) = [code for kind, code in BLOCKS if kind == "toml"]
    (tmp_path / "study.toml").write_text(text)
    assert gs.Study.load(tmp_path / "study.toml").grid.shape == (3, 2, 2, 37, 2)


def test_the_answer_is_that_of_the_documentation():
    (answer,) = re.findall("<!-- answer -->\n(.*?)<!-- /answer -->", README, re.DOTALL)
    assert answer.count("\n|") > 3
    assert answer in (ROOT / "docs" / "answer.md").read_text()


@pytest.mark.parametrize("page", ["README.md", "docs/answer.md"])
def test_the_answer_was_made_by_these_numerics(page):
    """Else run workflows/paper/study.toml and benchmarks/answer.py again."""
    assert numerics_fingerprint() in (ROOT / page).read_text()


def test_quick_study_is_valid():
    study = gs.Study.load(ROOT / "workflows" / "quick.toml")
    assert study.grid.requested.sum() == 180
