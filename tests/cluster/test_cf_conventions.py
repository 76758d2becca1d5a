"""Datasets against the CF conventions, by the checker of the IOOS."""

import json
import subprocess
import sys
from pathlib import Path

import netCDF4
import pytest
from tests.builders.studies import PAPER, SECTION, changed

import gapsweep as gs

pytestmark = pytest.mark.extended

OSCILLATOR = {
    "study": {"name": "checked", "creator": "A. Nother", "license": "CC-BY-4.0"},
    "oscillator": PAPER,
    "sweep": [
        {
            "representation": ["piecewise", "tanh-1e4"],
            "K_c": 1.4e4,
            "gap": [[0.4e-3, 0.4e-3], [0.0, 0.8e-3]],
            "omega": [7.0, 12.0],
            "forcing": [4.0, 5.0],
            "initial_condition": {"sobol": 2, "x": [-1e-3, 1e-3], "v": [-0.1, 0.1]},
        }
    ],
    "history": [
        {
            "representation": ["piecewise"],
            "K_c": 1.4e4,
            "gap": [0.4e-3, 0.4e-3],
            "omega": 7.0,
            "forcing": 4.0,
            "t_end": 1.0,
        }
    ],
    "steady": {"settle_tol": 1e-2, "n_periods": 16, "max_period_multiple": 8},
}
SYSTEM = changed(SECTION, sweep__0__speed=[6.0, 12.0], solver={"rtol": 1e-5})


@pytest.mark.parametrize("tables", [OSCILLATOR, SYSTEM], ids=["oscillator", "system"])
def test_no_dataset_breaks_a_convention(tables, client, tmp_path):
    out = tmp_path / "out"
    gs.run(gs.Study.from_dict(tables), client, out=out, cache=tmp_path / "c-cache").close()
    files = sorted(out.glob("*.nc"))
    assert len(files) >= 3
    assert complaints(*files) == {file.name: [] for file in files}
    for file in files:
        with netCDF4.Dataset(file) as dataset:
            said = tables["study"]
            assert getattr(dataset, "creator_name", None) == said.get("creator")
            assert getattr(dataset, "license", None) == said.get("license")


def test_a_file_that_breaks_them_is_complained_of(tmp_path):
    with netCDF4.Dataset(tmp_path / "bad.nc", "w") as dataset:
        dataset.Conventions = "CF-1.11"
        dataset.createVariable("x", "f8").units = "parsecs per fortnight squared"
    assert complaints(tmp_path / "bad.nc")["bad.nc"]


def complaints(*files):
    """Messages of the CF compliance checker on each file, by file name."""
    checker = Path(sys.executable).with_name("compliance-checker")
    command = [checker, "-t", "cf:1.11", "-f", "json_new", "-o", "found.json"]
    folder, names = files[0].parent, [file.name for file in files]
    subprocess.run([*command, *names], cwd=folder, capture_output=True, check=False)
    found = json.loads((folder / "found.json").read_text())
    return {name: messages_of(report["cf:1.11"]) for name, report in found.items()}


def messages_of(report):
    levels = ("high_priorities", "medium_priorities", "low_priorities")
    waiting, messages = [each for level in levels for each in report[level]], []
    while waiting:
        each = waiting.pop()
        messages += each["msgs"]
        waiting += each["children"]
    return messages
