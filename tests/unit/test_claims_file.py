"""The paper's claims file and studies, and what is said about a damaged one."""

import json
import tomllib
from pathlib import Path

import pytest

import gapsweep as gs
from gapsweep import make
from gapsweep.analysis.claims import check_variables
from gapsweep.errors import StudyError
from gapsweep.stages import CLAIMS, STAGES, claims_source, made_from, reason_to_run
from gapsweep.store.artefact import is_recorded, recording
from gapsweep.study.claims import read_claims

ROOT = Path(__file__).parents[2]
PAPER = ROOT / "data" / "paper" / "claims.toml"
SOUND = """
[[claim]]
id = 7
place = "Fig. 1"
text = "It is small."
why = "Small is below one."

[[claim.test]]
says = "small"
kind = "compare"
number.data = "agreement"
number.variable = "f1"
number.at = { representation = "tanh-1e4" }
number.statistic = "mean"
op = "<"
threshold = 1.0
"""


def written(folder, text):
    path = folder / "claims.toml"
    path.write_text(text)
    return path


def test_all_74_claims_stand_there_once():
    assert [claim.id for claim in read_claims(PAPER)] == list(range(1, 75))


def test_every_claim_names_variables_and_dimensions_that_exist():
    check_variables(read_claims(PAPER), "claims.toml")


def test_at_least_60_claims_have_tests_and_all_have_reasons():
    claims = read_claims(PAPER)
    assert sum(bool(claim.test) for claim in claims) >= 60
    assert all(claim.why and (claim.test or claim.undecidable) for claim in claims)


@pytest.mark.parametrize("name", ["paper", "table2"])
def test_studies_load_and_have_what_the_claims_select(name):
    study = gs.Study.load(ROOT / "workflows" / f"{name}.toml")
    assert study.claims_file.resolve() == PAPER
    if name == "paper":
        swept = {label.partition("@")[0] for label in study.grid.representations}
        labels = {*study.grid.representations, *swept}
        gaps = {gap.label for gap in study.grid.gaps}
        for number in (test.number for claim in read_claims(PAPER) for test in claim.test):
            chosen = number.at.get("representation", [])
            assert set([chosen] if isinstance(chosen, str) else chosen) <= labels
            if number.at.get("gap") and isinstance(number.at["gap"], str):
                assert number.at["gap"] in gaps
        assert 8e4 < study.grid.requested.sum() < 1.5e5


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("threshold = 1.0", "", "claim 7: test[0]: kind 'compare' needs threshold"),
        ('op = "<"', 'op = "="', "claim 7: test[0].op"),
        ('kind = "compare"', 'kind = "guess"', "claim 7: test[0].kind"),
        ('"agreement"', '"weather"', "claim 7: test[0].number.data"),
        ('says = "small"', 'says = "small"\nhint = 1', "claim 7: test[0].hint = 1: unknown key"),
        ("1.0", "nan", "claim 7: test[0].threshold"),
        ("id = 7", "id = 0", "claim 0: id = 0"),
        ('why = "Small is below one."', "", "claim 7: why"),
        ('"mean"', '"share"', "claim 7: test[0].number: where"),
        ("[[claim.test]]", "[[claim.test]", "not valid TOML"),
    ],
)
def test_damage_is_named_in_one_line(tmp_path, old, new, named):
    path = written(tmp_path, SOUND.replace(old, new))
    with pytest.raises(StudyError) as error:
        read_claims(path)
    (line,) = error.value.problems
    assert str(path) in line
    assert named in line


def test_unknown_variables_and_dimensions_are_named(tmp_path):
    for old, new, named in (
        ('"f1"', '"f2"', "claim 7: test.number.variable = 'f2': not in agreement.nc"),
        (
            "representation =",
            "degree =",
            "claim 7: test.number.at.degree: f1 has no such dimension",
        ),
    ):
        claims = read_claims(written(tmp_path, SOUND.replace(old, new)))
        with pytest.raises(StudyError) as error:
            check_variables(claims, "claims.toml")
        assert named in str(error.value)


def test_a_claim_stands_there_once(tmp_path):
    with pytest.raises(StudyError, match=r"claim\.id = 7"):
        read_claims(written(tmp_path, SOUND + SOUND))


def test_study_refuses_an_absent_or_damaged_claims_file(tmp_path, tables):
    tables["claims"] = {"file": str(tmp_path / "none.toml")}
    with pytest.raises(StudyError, match=r"none\.toml: cannot be read"):
        gs.Study.from_dict(tables)


def test_path_is_relative_to_the_study_file(tmp_path):
    written(tmp_path, SOUND)
    (tmp_path / "studies").mkdir()
    file = tmp_path / "studies" / "a.toml"
    file.write_text(
        '[study]\nname = "a"\n[claims]\nfile = "../claims.toml"\n[[sweep]]\n'
        'representation = ["piecewise"]\nK_c = [1.4e4]\ngap = [[4e-4, 4e-4]]\nomega = [7.0]\n'
    )
    assert gs.Study.load(file).claims_file.resolve() == (tmp_path / "claims.toml").resolve()


def test_a_changed_threshold_changes_what_the_verdicts_are_made_from(tmp_path):
    stage = next(stage for stage in STAGES if stage.file == CLAIMS)
    path = written(tmp_path, SOUND)
    before = made_from(stage, tmp_path, claims_source(path))
    with recording(tmp_path / CLAIMS, is_recorded) as temporary:
        temporary.write_text(json.dumps({"made_from": before}))
    assert reason_to_run(stage, tmp_path, before) is None
    written(tmp_path, SOUND.replace("1.0", "0.9"))
    after = made_from(stage, tmp_path, claims_source(path))
    assert reason_to_run(stage, tmp_path, after) == "claims file changed"


def test_without_a_run_there_is_nothing_to_decide(tmp_path):
    with pytest.raises(gs.GapsweepError, match="no such file"):
        make.claims(tmp_path, PAPER)


def test_file_is_plain_data():
    tables = tomllib.loads(PAPER.read_text(encoding="utf-8"))
    assert set(tables) == {"claim"}
