"""Claims in a whole run: made once, made again when a threshold changes, shown by the command."""

import json

import pytest

import gapsweep as gs
from gapsweep import workflow
from gapsweep.analysis import static
from gapsweep.cli.main import FAULT, FINISHED, exit_code
from gapsweep.stages import CLAIMS, REPORT

TEXT = """
[[claim]]
id = 1
place = "Fig. 1"
text = "Tanh has a larger force error than the polynomial."
why = "The larger of two errors."

[[claim.test]]
says = "error of tanh over that of the polynomial"
kind = "compare"
number = { data = "static", variable = "rmse", at = { representation = "tanh-1e4" } }
against = { at = { representation = "poly-13" } }
op = ">"
threshold = 1.0

[[claim]]
id = 2
place = "Fig. 2"
text = "Tanh is nearly exact."
why = "There is no second exact law, so there is no floor."

[[claim.test]]
says = "amplitude error"
kind = "compare"
number.data = "agreement"
number.variable = "amplitude_error"
number.at = { representation = "tanh-1e4" }
number.statistic = "median"
op = "<"
threshold = 0.05
"""


@pytest.fixture
def study(tables, tmp_path, monkeypatch):
    # The ladders of fits take a minute, and no claim here asks for them.
    monkeypatch.setattr(static, "static", lambda study, **how: static.law_statics(study))
    (tmp_path / "claims.toml").write_text(TEXT)
    return gs.Study.from_dict(tables | {"claims": {"file": str(tmp_path / "claims.toml")}})


def test_claims_are_decided_once_and_again_when_a_threshold_changes(
    study, client, tmp_path, capsys
):
    out, cache = tmp_path / "out", tmp_path / "cache.sqlite"
    gs.run(study, client, out=out, cache=cache).close()
    decided = json.loads((out / CLAIMS).read_text())
    assert [claim["verdict"] for claim in decided["claims"]] == ["refuted", "undecidable"]
    assert "no floor" in decided["claims"][1]["sentence"]
    planned = workflow.plan(study, cache)
    assert not any(workflow.stage_reasons(study, planned, out, cache).values())

    (tmp_path / "claims.toml").write_text(TEXT.replace("threshold = 1.0", "threshold = 0.01"))
    reasons = workflow.stage_reasons(study, planned, out, cache)
    assert {file for file, reason in reasons.items() if reason} == {CLAIMS, REPORT}
    assert reasons[CLAIMS] == "claims file changed"
    gs.run(study, client, out=out, cache=cache).close()
    assert json.loads((out / CLAIMS).read_text())["claims"][0]["verdict"] == "confirmed"

    # The run keeps its claims, so that the command needs nothing but the folder.
    (tmp_path / "claims.toml").unlink()
    assert exit_code(["claims", str(out), "--json"]) == FINISHED
    assert json.loads(capsys.readouterr().out)["counts"]["confirmed"] == 1
    assert exit_code(["claims", str(out)]) == FINISHED
    assert "2 claims: 1 confirmed" in capsys.readouterr().out

    (out / "static.nc").unlink()
    assert exit_code(["claims", str(out)]) == FINISHED
    assert "no static.nc in this run" in capsys.readouterr().out


def test_a_claims_file_is_refused_before_anything_is_computed(study, client, tmp_path):
    (tmp_path / "claims.toml").write_text(TEXT.replace('"rmse"', '"nonsense"'))
    with pytest.raises(gs.GapsweepError, match="nonsense"):
        gs.run(study, client, out=tmp_path / "out", cache=tmp_path / "cache.sqlite")
    assert not (tmp_path / "out").exists()
    assert not (tmp_path / "cache.sqlite").exists()


def test_command_names_what_is_missing(tmp_path, capsys):
    assert exit_code(["claims", str(tmp_path)]) == FAULT
    assert "gapsweep run" in capsys.readouterr().err
