"""A study with Python beside it: verdicts, datasets and sections of its own, in a whole run."""

import json
import os
import re
import shutil

import pytest
from tests.builders.studies import study_text

import gapsweep as gs
from gapsweep import pipeline
from gapsweep.cli.main import FAULT, FINISHED, exit_code
from gapsweep.run_folder import AGREEMENT, CLAIMS, REPORT, SECTIONS

pytestmark = pytest.mark.extended

LABELS = ["piecewise", "tanh-1e4", "poly-13"]
MODULES = '[claims]\nmodule = "claims.py"\n[report]\nmodule = "figures.py"'
STUDY = study_text(LABELS, "[7.0, 12.0, 20.0]", name="small", more=MODULES)
WIDTHS = """
import xarray as xr

def widths(study):
    return xr.Dataset({"width": ("gap", [gap.width for gap in study.grid.gaps])})
"""
CLAIMS_PY = """
from gapsweep.analysis.claims import Number, Test, claim
from .widths import widths

DATASETS = {"widths": widths}

@claim(1, "Fig. 1", "Tanh has a larger force error than the polynomial.", "The larger of two.")
def larger(run):
    rmse = run["static"]["rmse"]
    tanh, poly = (rmse.sel(representation=r).item() for r in ("tanh-1e4", "poly-13"))
    ratio = tanh / poly
    return [Test("error over that of poly-13", Number(ratio), ">", 1.0)], f"{ratio:.2g} times."

@claim(2, "Fig. 2", "The gap is wide.", "It is the width.")
def wide(run):
    width = Number(run["widths"]["width"].item())
    return [Test("width [m]", width, ">=", 0.5e-3)], f"{width} m."
"""
FIGURES_PY = """
from matplotlib.figure import Figure
from gapsweep.report.parts import Figured, Part, Table

def sections(run):
    figure = Figure()
    figure.subplots().plot(run["responses"]["omega"], label="<b>")
    figured = Figured(figure, "Frequencies <i>.", "A rising line")
    yield Part("own", "Own section", ["Said."], [Table("Widths", ["a"], [["1 < 2"]])], [figured])
"""


def written(folder):
    texts = {"study.toml": STUDY, "claims.py": CLAIMS_PY, "figures.py": FIGURES_PY}
    for name, text in {**texts, "widths.py": WIDTHS}.items():
        (folder / name).write_text(text)
    return folder


@pytest.fixture
def folder(tmp_path):
    return written(tmp_path)


@pytest.fixture(scope="module")
def run_once(client, tmp_path_factory):
    """A finished run in `out`, beside its study."""
    folder = written(tmp_path_factory.mktemp("run"))
    study = gs.Study.load(folder / "study.toml")
    gs.run(study, client, out=folder / "out", cache=folder / "cache").close()
    return folder


@pytest.fixture
def finished(run_once, tmp_path):
    """A copy of it."""
    return shutil.copytree(run_once, tmp_path / "copy")


def changed(folder, name, old, new):
    path = folder / name
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))


def test_own_code_in_a_whole_run(folder, client, capsys, monkeypatch):
    out, cache = folder / "out", folder / "cache"
    study = gs.Study.load(folder / "study.toml")

    def again():
        gs.run(study, client, out=out, cache=cache).close()
        return json.loads((out / CLAIMS).read_text())

    def reasons():
        fresh = gs.Study.of(study)
        found = pipeline.stage_reasons(fresh, pipeline.plan(fresh, cache), out)
        return {file: reason for file, reason in found.items() if reason}

    decided = again()
    assert [claim["verdict"] for claim in decided["claims"]] == ["refuted", "confirmed"]
    assert decided["claims_module"] == "claims.py"
    assert reasons() == {}
    page = (out / REPORT).read_text()
    assert page.index("Own section") < page.index("K_c = ")
    for words in ("1 &lt; 2", "Frequencies &lt;i&gt;.", 'alt="A rising line"', "not &gt; 1"):
        assert words in page, words

    # A threshold re-decides, and computes no dataset anew.
    changed(folder, "claims.py", '">", 1.0', '">", 0.01')
    assert reasons() == {CLAIMS: "claims module changed", REPORT: "claims.json will be made"}
    before = (out / "widths.nc").stat().st_mtime_ns
    assert [claim["verdict"] for claim in again()["claims"]] == ["confirmed", "confirmed"]
    assert (out / "widths.nc").stat().st_mtime_ns == before

    # The code of a dataset is that of the neighbour that holds it.
    changed(folder, "widths.py", "gap.width for", "gap.width / 2 for")
    assert set(reasons()) == {"widths.nc", CLAIMS, SECTIONS, REPORT}
    assert reasons()["widths.nc"] == "code of widths.nc changed"
    assert [claim["verdict"] for claim in again()["claims"]] == ["confirmed", "refuted"]
    changed(folder, "figures.py", "Own section", "Section of mine")
    assert set(reasons()) == {SECTIONS, REPORT}
    again()

    # The commands run no file of the run's folder.
    capsys.readouterr()
    for name in ("claims.py", "figures.py", "widths.py", "gapsweep.py", "sitecustomize.py"):
        (out / name).write_text("raise SystemExit('executed')")
    monkeypatch.chdir(out)
    for arguments in (["claims", "."], ["report", "."]):
        assert exit_code(arguments) == FINISHED
    told = capsys.readouterr().out
    assert "2 claims: 1 confirmed, 1 refuted" in told
    assert "written" not in told
    assert "Section of mine" in (out / REPORT).read_text()

    # With the study, both are made anew.
    changed(folder, "claims.py", '">", 0.01', '">", 1.0')
    changed(folder, "figures.py", "Section of mine", "Another")
    given = ["--study", os.fspath(folder / "study.toml")]
    assert exit_code(["claims", ".", "--json", *given]) == FINISHED
    assert json.loads(capsys.readouterr().out)["counts"]["refuted"] == 2
    assert exit_code(["report", ".", *given]) == FINISHED
    assert "Another" in (out / REPORT).read_text()
    assert reasons() == {}

    (out / "widths.nc").unlink()
    assert exit_code(["claims", ".", *given]) == FINISHED
    assert "the run has no widths.nc" in capsys.readouterr().out

    # What is wrong with a claim is one line.
    changed(folder, "claims.py", 'rmse = run["static"]', 'rmse = 1 / 0\n    rmse = run["static"]')
    assert exit_code(["claims", ".", *given]) == FAULT
    line = CLAIMS_PY[: CLAIMS_PY.index("rmse =")].count("\n") + 1
    expected = f"error: {folder / 'claims.py'}:{line}: claim 1: ZeroDivisionError: division by zero"
    assert capsys.readouterr().err == expected + "\n"
    changed(folder, "figures.py", "figure = Figure()", "figure = None.figure")
    assert exit_code(["report", ".", *given]) == FAULT
    assert "figures.py:6: sections: AttributeError: 'Non" in capsys.readouterr().err


def test_the_report_shows_nothing_that_rests_on_other_responses(tables, client, tmp_path):
    """Another study of the same name leaves files in the folder that this one does not make."""
    out, where = tmp_path / "out", {"out": tmp_path / "out", "cache": tmp_path / "cache"}
    for laws, is_compared in ((["piecewise", "tanh-1e4"], True), (["tanh-1e4"], False)):
        tables["sweep"][0]["representation"] = laws
        gs.run(gs.Study.from_dict(tables), client, **where).close()
        assert ("Approximations " in (out / REPORT).read_text()) == is_compared
        assert exit_code(["report", str(out)]) == FINISHED
        assert ("Approximations " in (out / REPORT).read_text()) == is_compared
    assert (out / AGREEMENT).exists()


def test_what_a_dataset_raises_is_one_line(folder, client):
    study = gs.Study.load(folder / "study.toml")
    where = {"out": folder / "out", "cache": folder / "cache"}
    for new, said in (
        ("len(1)", "widths.py:5: widths.nc: TypeError: object of"),
        ("1", "not a int"),
    ):
        (folder / "widths.py").write_text(WIDTHS)
        old = WIDTHS[WIDTHS.index("xr.Dataset(") :].strip()
        changed(folder, "widths.py", old, new)
        with pytest.raises(gs.StudyError, match=said):
            gs.run(study, client, **where)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("    tanh, poly", "    raise SystemExit(0)\n    tanh, poly", "claim 1: SystemExit: 0"),
        ("    tanh, poly", "    raise BaseException\n    tanh, poly", "claim 1: BaseException"),
        ('f"{ratio:.2g} times."', "5", "claim 1: TypeError: result: sentence: must be"),
        (
            "    return [Test(",
            "    return None\n    return [Test(",
            "claim 1: TypeError: must return",
        ),
        ('">", 1.0', '">", "1"', "claim 1: TypeError: a test: threshold: must be"),
        ("{ratio:.2g} times", "\\ud800", "claim 1: ValueError: result: sentence: must"),
        ('"The larger of two."', "None", "TypeError: claim 1: why: must be text, not None"),
        ("@claim(2", "@claim('2'", "ValueError: claim '2': id: must be a whole number from 1"),
    ],
)
def test_what_a_claim_does_wrong_is_one_line(finished, old, new, said, capsys):
    out, given = finished / "out", ["--study", os.fspath(finished / "study.toml")]
    stored = (out / CLAIMS).read_bytes()
    changed(finished, "claims.py", old, new)
    assert exit_code(["claims", os.fspath(out), *given]) == FAULT
    (line,) = capsys.readouterr().err.splitlines()
    assert re.search(r"claims\.py:(\d+: )?", line)
    assert said in line
    # What was stored before is still there, and can be read.
    assert (out / CLAIMS).read_bytes() == stored
    assert exit_code(["claims", os.fspath(out)]) == FINISHED


@pytest.mark.parametrize("left", [b"", b"[]", b"\xff\xfe", b'{"claims": ['])
def test_verdicts_that_nothing_vouches_for_are_refused(finished, capsys, left):
    out = finished / "out"
    (out / "SHA256SUMS").unlink()
    (out / CLAIMS).write_bytes(left or (out / CLAIMS).read_bytes())
    assert exit_code(["claims", os.fspath(out)]) == FAULT
    (line,) = capsys.readouterr().err.splitlines()
    assert "claims.json: has no checksum in SHA256SUMS" in line


def test_a_half_character_in_a_section_is_one_line(finished, capsys):
    changed(finished, "figures.py", '["Said."]', '["\\ud800"]')
    out, given = finished / "out", ["--study", os.fspath(finished / "study.toml")]
    stored = (out / SECTIONS).read_bytes()
    assert exit_code(["report", os.fspath(out), *given]) == FAULT
    assert "figures.py: sections: UnicodeEncodeError" in capsys.readouterr().err.splitlines()[-1]
    assert (out / SECTIONS).read_bytes() == stored


@pytest.mark.parametrize(
    ("name", "old", "new", "said"),
    [
        ("claims.py", "@claim", "# claim", "claims.py: no claims"),
        ("claims.py", '"widths":', '"static":', "'static': the name of a file of gapsweep"),
        ("claims.py", '"widths":', '"Widths":', "'Widths': names must have the letters"),
        ("claims.py", ": widths}", ": 1}", "'widths': must be a function of the study, not 1"),
        (
            "figures.py",
            "def sections",
            "def others",
            "figures.py: function sections(run) is missing",
        ),
    ],
)
def test_faulty_code_is_refused_before_anything_is_computed(folder, name, old, new, said, capsys):
    changed(folder, name, old, new)
    command = ["run", str(folder / "study.toml"), "--out", str(folder / "out")]
    assert exit_code([*command, "--cache", str(folder / "cache")]) == FAULT
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line
    assert line.count(str(folder)) == 1
    assert not (folder / "out").exists()
    assert not (folder / "cache").exists()


def test_commands_name_what_is_missing(folder, tables, client, capsys):
    assert exit_code(["claims", str(folder)]) == FAULT
    assert "gapsweep run" in capsys.readouterr().err
    out = folder / "plain"
    gs.run(gs.Study.from_dict(tables), client, out=out, cache=folder / "cache").close()
    capsys.readouterr()
    assert exit_code(["claims", str(out)]) == FAULT
    (line,) = capsys.readouterr().err.splitlines()
    assert f"with 'gapsweep claims {out} --study FILE'" in line
    other = STUDY.replace('"small"', '"other"')
    (folder / "other.toml").write_text(other)
    assert exit_code(["claims", str(out), "--study", str(folder / "other.toml")]) == FAULT
    assert "has the files of study 'small', not of 'other'" in capsys.readouterr().err
    plain = folder / "plain.toml"
    plain.write_text(STUDY.replace(MODULES, ""))
    for command in ("claims", "report"):
        assert exit_code([command, str(out), "--study", str(plain)]) == FAULT
        (line,) = capsys.readouterr().err.splitlines()
        assert f"plain.toml: {command}: missing" in line
