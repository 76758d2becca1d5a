"""What the README prints works as printed."""

import re
from pathlib import Path

import gapsweep as gs

README = (Path(__file__).parents[1] / "README.md").read_text()
BLOCKS = re.findall(r"^```(\w+)( no-test)?\n(.*?)^```$", README, re.DOTALL | re.MULTILINE)


def test_python_examples_run_in_order(capsys):
    code = "".join(code for kind, skip, code in BLOCKS if kind == "python" and not skip)
    exec(compile(code, "README.md", "exec"), {})  # the README is ours
    printed = capsys.readouterr().out
    assert "ok 1" in printed
    assert "(64,)" in printed


def test_study_example_is_valid(tmp_path):
    (text,) = [code for kind, _, code in BLOCKS if kind == "toml"]
    (tmp_path / "study.toml").write_text(text)
    assert gs.Study.load(tmp_path / "study.toml").grid.shape == (3, 2, 2, 37, 2)


def test_the_answer_is_that_of_the_documentation():
    (answer,) = re.findall("<!-- answer -->\n(.*?)<!-- /answer -->", README, re.DOTALL)
    assert answer.count("\n|") > 3
    assert answer in (Path(__file__).parents[1] / "docs" / "answer.md").read_text()


def test_quick_study_is_valid():
    study = gs.Study.load(Path(__file__).parents[1] / "workflows" / "quick.toml")
    assert study.grid.requested.sum() == 180
