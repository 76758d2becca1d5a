"""Terminal output fits 80 columns and breaks between words."""

import json
from pathlib import Path

import click
import numpy as np
import pytest
import xarray as xr
from tests.builders.studies import study_text

import gapsweep as gs
from gapsweep.cli.main import FINISHED, exit_code
from gapsweep.cli.query_output import Form, written
from gapsweep.console import print_table, print_text
from gapsweep.report.scales import shortened

WIDTH = 80
LONG = "the exact law, contacts located, is the cheapest adequate one, and this goes on and on"
LABELS = ["piecewise", "tanh-1e4", "poly-13", "ratpoly-5/3", "arctan-1e4", "logarctan-1e4"]
STUDY = study_text(LABELS, "[7.0, 30.0]", name="wide")


@pytest.fixture(autouse=True)
def terminal(tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def responses():
    """Two laws at two frequencies; one cell is no sweep point."""
    dims = ("representation", "K_c", "omega")
    status = np.array([[[0, 0]], [[0, 1]]], np.int8)
    flags = {"flag_values": np.array([0, 1], np.int8), "flag_meanings": "ok not_requested"}
    x_max = np.array([[[1.23456789e-3, 2e-3]], [[3e-3, np.nan]]])
    return xr.Dataset(
        {
            "x_max": (dims, x_max, {"units": "m"}),
            "period_multiple": (dims, np.ones((2, 1, 2), int), {"units": "1"}),
            "response_class": (dims, status, {"flag_values": [0], "flag_meanings": "periodic"}),
            "amplitude": (dims, x_max, {"units": "m"}),
            "status": (dims, status, flags),
            "extrema": ((*dims, "extremum"), np.zeros((2, 1, 2, 3))),
        },
        coords={
            "representation": ["piecewise", "tanh-1e4"],
            "K_c": ("K_c", [1.4e4], {"units": "N m-1"}),
            "omega": ("omega", [10.12345, 11.0], {"units": "Hz"}),
        },
    )


def shown(capsys):
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= WIDTH
    return text


def test_long_texts_go_on_below_with_whole_words(capsys):
    print_table(("n", "for"), [("1", LONG), ("20", "short")])
    text = shown(capsys)
    assert set(LONG.split()) <= set(text.split())
    assert " 1  the exact" in text
    assert "\n20  short" in text
    print_text(LONG)
    assert set(LONG.split()) <= set(shown(capsys).split())


def test_nothing_in_a_table_is_markup(capsys):
    print_table(("name",), [("[bold]x[/bold]",), (":smile:",)])
    assert "[bold]x[/bold]" in (text := shown(capsys))
    assert ":smile:" in text


def test_advice_fits(capsys):
    Path("wide.toml").write_text(STUDY)
    assert exit_code(["advise", "wide.toml"]) == FINISHED
    text = shown(capsys)
    assert "simplest model" in text
    assert "logarctan-1e4 (force error 0." in " ".join(text.split())


def test_plan_fits(capsys):
    Path("wide.toml").write_text(STUDY)
    assert exit_code(["plan", "wide.toml"]) == FINISHED
    text = shown(capsys)
    assert "expected  unknown (no comparable points cached)" in text
    assert "responses.nc" in text


def test_a_table_says_once_what_all_rows_share(responses, capsys):
    written(responses, Form("table", ("x_max", "status"), 4), None)
    first, *rest = shown(capsys).splitlines()
    assert first == "K_c 14000 N/m"
    assert [line.split() for line in rest[-3:]] == [
        ["piecewise", "10.12345", "1.235", "ok"],  # in mm; a coordinate keeps its digits
        ["piecewise", "11", "2", "ok"],
        ["tanh-1e4", "10.12345", "3", "ok"],
    ]
    assert "[Hz]" in "".join(rest)


def test_columns_and_digits_of_rows(responses, capsys):
    written(responses, Form("json", ("x_max",), 3), None)
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert rows[0] == {
        "representation": "piecewise", "K_c": 14000.0, "omega": 10.12345, "x_max": 1.23e-3
    }  # fmt: skip
    assert len(rows) == 3
    written(responses, Form("csv"), None)
    assert "1.23456789," in capsys.readouterr().out


def test_a_variable_of_several_coordinates_has_a_column_for_each(responses, capsys):
    per_mass = responses["x_max"].expand_dims(coordinate=["x_1", "x_2"], axis=-1)
    machine = responses.drop_vars("amplitude").assign(amplitude=per_mass)
    written(machine, Form("csv", ("amplitude",), 3), None)
    assert capsys.readouterr().out.startswith(
        "representation,K_c [N/m],omega [Hz],amplitude[x_1] [mm],amplitude[x_2] [mm]\n"
        "piecewise,14000.0,10.12345,1.23,"
    )
    written(machine, Form("table", ("amplitude[x_2]", "status"), 3), None)
    assert "amplitude[x_1]" not in shown(capsys)


def test_an_unknown_column_is_refused_with_the_nearest(responses):
    with pytest.raises(gs.DatasetError, match="'xmax': no such variable; did you mean x_max"):
        written(responses, Form("csv", ("xmax",)), None)


@pytest.mark.parametrize(
    ("is_terminal", "output", "kind"),
    [(True, None, "table"), (False, None, "csv"), (True, Path("a.csv"), "csv")],
)
def test_tables_are_for_terminals(monkeypatch, is_terminal, output, kind):
    monkeypatch.setattr("sys.stdout.isatty", lambda: is_terminal)
    assert Form.of(None, None, None, output).kind == kind


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("nc", None, None, None), "needs --output"),
        (("nc", "x_max", None, Path("a.nc")), "writes all variables"),
        (("nc", None, 3, Path("a.nc")), "all variables and digits"),
        (("table", None, None, Path("a.txt")), "--output use csv, json or nc"),
    ],
)
def test_forms_that_cannot_be_are_refused(arguments, said):
    with pytest.raises(click.UsageError, match=said):
        Form.of(*arguments)


@pytest.mark.parametrize(
    ("label", "said"),
    [("1000000/1", "1e6/1"), ("0.4/0.4", "0.4/0.4"), ("1200000/0.0000001", "1200000/0.0000001")],
)
def test_rows_of_zeros_are_told_as_powers(label, said):
    assert shortened(label) == said
