"""``gapsweep init`` writes studies that can be run, over nothing that is there."""

import re

import pytest

import gapsweep as gs
from gapsweep.cli.init import STUDIES
from gapsweep.cli.main import exit_code
from gapsweep.study_code import check_modules


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", STUDIES)
def test_a_study_is_written_that_can_be_run(name, capsys):
    assert exit_code(["init", name]) == 0
    written, file = STUDIES[name]
    said = capsys.readouterr().out
    assert f"written: {written}\n" in said
    assert f"gapsweep run {file}" in said
    study = gs.Study.load(file)
    assert study.name == name
    check_modules(study)  # with the Python beside it


def test_the_defaults_that_quick_shows_are_the_defaults(folder):
    exit_code(["init", "quick"])
    text = (folder / "quick.toml").read_text()
    (folder / "shown.toml").write_text(re.sub(r"^# (\w+ = )", r"\1", text, flags=re.MULTILINE))
    quick, shown = gs.Study.load("quick.toml"), gs.Study.load("shown.toml")
    # a study states the wave of a force within `forcing`
    assert shown.spec.oscillator.model_fields_set == {*gs.Oscillator.__slots__} - {"wave"}
    assert shown.oscillator == quick.oscillator
    assert shown.solver("piecewise") == quick.solver("piecewise")
    assert len(shown.grid.starts) == 2


@pytest.mark.parametrize("name", STUDIES)
def test_what_is_there_stays_as_it_is(name, folder, capsys):
    written, _ = STUDIES[name]
    (folder / written).write_text("mine")
    assert exit_code(["init", name]) == 1
    error = f"error: {written}: exists already; move it"
    assert error in capsys.readouterr().err
    assert (folder / written).read_text() == "mine"


def test_quick_is_what_is_written_if_nothing_is_named(folder):
    assert exit_code(["init"]) == 0
    assert [path.name for path in folder.iterdir()] == ["quick.toml"]


def test_no_byte_code_is_written(folder):
    exit_code(["init", "paper"])
    names = {path.name for path in folder.rglob("*")}
    assert {"study.toml", "claims.py", "figures.py"} <= names
    assert "__pycache__" not in names
