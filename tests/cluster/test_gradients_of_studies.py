"""Gradients in a study, on real worker processes: `gradients.nc` and its section of the report."""

import numpy as np
import pytest
import xarray as xr
from tests.builders.runs import run
from tests.builders.studies import PAPER

import gapsweep as gs
from gapsweep.analysis.datasets.gradients_file import Reason

pytestmark = pytest.mark.extended

BY = ["gap", "K_c", "forcing", "omega"]
BLOCK = {
    "representation": ["piecewise", "tanh-1e4"],
    "K_c": [1.4e4, 3e4],
    "gap": [4e-4, 4e-4],
    "omega": [7.0, 9.0, 11.0],
    "initial_condition": ["sweep_up", "sweep_down"],
}
TABLES = {
    "study": {"name": "slopes"},
    "oscillator": PAPER,
    "sweep": [BLOCK],
    "gradients": {"by": BY},
}


def files(folder):
    return [xr.open_dataset(folder / "out" / name) for name in ("gradients.nc", "attractors.nc")]


def test_attractors_of_a_study_have_the_gradients_of_a_call(client, tmp_path):
    run(TABLES, client, tmp_path)
    found, attractors = files(tmp_path)
    exact = found.sel(representation="piecewise")
    at = attractors.sel(representation="piecewise").squeeze("gap")
    several = np.argwhere(exact.squeeze("gap")["reason"].values == Reason.NONE)
    assert len(several) > 6  # two attractors coexist at some frequency
    for i, j, k in several:
        state = [at[name].values[i, j, k, 0] for name in ("section_x", "section_v")]
        law = gs.Piecewise(BLOCK["K_c"][i], gs.Gap(4e-4, 4e-4))
        omega, machine = BLOCK["omega"][j], gs.Oscillator(**PAPER)
        expected = gs.gradient(machine, law, BY, omega, *state).squeeze()
        one = exact.squeeze("gap").isel(K_c=i, omega=j, attractor=k)
        if at["period_multiple"].values[i, j, k] > 1:  # the call ends at another section point
            one, expected = (each.drop_sel(quantity=["x_end", "v_end"]) for each in (one, expected))
        np.testing.assert_allclose(one["gradient"], expected["gradient"], rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(one["value"], expected["value"], rtol=1e-9, atol=1e-14)
    smooth = found.sel(representation="tanh-1e4")
    assert {*np.unique(smooth["reason"])} == {Reason.NO_ATTRACTOR, Reason.REFUSED}
    assert np.isnan(smooth["gradient"]).all()
    assert "tanh-1e4" in found.attrs["refused"]
    page = (tmp_path / "out" / "report" / "index.html").read_text()
    assert f"{len(several)} attractors have derivatives" in page


def test_points_of_different_structure_have_separate_tables(client, tmp_path):
    block = BLOCK | {"representation": "piecewise", "K_c": 1.4e4, "damping": [0.0, 20.0]}
    block |= {"gap": [[4e-4, 4e-4], [np.inf, 4e-4]], "omega": 9.0, "initial_condition": [0.0, 0.0]}
    run(TABLES | {"sweep": [block], "gradients": {"by": ["damping"]}}, client, tmp_path)
    found, _ = files(tmp_path)
    reason = found["reason"].squeeze()
    assert (reason.sel(damping=0.0) == Reason.REFUSED).all()
    assert (reason.sel(damping=20.0) == Reason.NONE).all()
    assert "is 0" in found.attrs["refused"]


def test_gradients_by_a_parameter_of_a_system_follow_its_sweep(client, tmp_path):
    tables = {
        "study": {"name": "gears"},
        "system": {"function": "gear_pair"},
        "parameters": {"mean_load": 0.1},
        "sweep": [
            {
                **{"representation": "piecewise", "K_c": 1.0, "gap": [1.0, 1.0]},
                **{"omega": [0.05, 0.06], "mean_load": [0.1, 0.2]},
            }
        ],
        "gradients": {"by": ["mean_load", "K_c"]},
    }
    run(tables, client, tmp_path)
    found, attractors = files(tmp_path)
    assert (found["reason"] == Reason.NONE).any()
    for i, j in np.argwhere(found["reason"].squeeze().values == Reason.NONE):
        here = attractors.isel(omega=i, mean_load=j).squeeze()
        state = [here[name].values[0] for name in ("section_x", "section_v")]
        omega, load = tables["sweep"][0]["omega"][i], [0.1, 0.2][j]
        law = gs.Piecewise(1.0, gs.Gap(1.0, 1.0))
        expected = gs.gradient(
            gs.systems.gear_pair, law, ["mean_load", "K_c"], omega,
            q_0=state[0], v_0=state[1], values={"mean_load": load},
        ).squeeze()  # fmt: skip
        one = found.isel(omega=i, mean_load=j).squeeze()
        np.testing.assert_allclose(one["gradient"], expected["gradient"], rtol=1e-7, atol=1e-8)


def test_impacts_of_two_contacts_that_accumulate_together_are_a_reason(client, tmp_path):
    """The system of `test_gradients_of_impacts.py`, and a load at which no wall is met."""
    rigid = {"representation": "rigid", "restitution": 0.0, "K_c": 1.0, "gap": [0.2, 0.25]}
    tables = {
        "study": {"name": "stops"},
        "system": {
            "mass": [[1.0, 0.0], [0.0, 0.5]], "stiffness": [[1.0, 0.0], [0.0, 1.0]],
            "damping": [[0.1, 0.0], [0.0, 0.1]], "contacts": {"s": [1.0, -1.0], "e": [0.0, 1.0]},
            "forcing": [
                {"amplitude": [1.455, 0.905], "scale": "load"},
                {"amplitude": [-0.483, 0.0], "k": 0, "scale": "load"},
            ],
        },
        "parameters": {"load": 1.0},
        "contact": {"e": {"restitution": 0.3, "gap": [0.2, 0.2]}},
        "sweep": [rigid | {"omega": 0.425 / (2.0 * np.pi), "load": [0.1, 1.0]}],
        "gradients": {"by": ["load"]},
    }  # fmt: skip
    run(tables, client, tmp_path)
    found, _ = files(tmp_path)
    reason = found["reason"].squeeze().values
    assert reason.tolist() == [Reason.NONE, Reason.ACCUMULATION]
    assert np.isfinite(found["value"].squeeze().sel(quantity="amplitude[q_1]")).all()
    page = (tmp_path / "out" / "report" / "index.html").read_text()
    assert "1 attractors have derivatives, 1 have impacts of several contacts" in page


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"gradients": {"by": ["gapp"]}}, r"gradients\.by: parameter 'gapp': must be one of"),
        ({"gradients": {"by": []}}, r"gradients\.by.*: must have at least one value"),
        ({"sweep": [BLOCK | {"representation": "tanh-1e4"}]}, "gradients: .* add 'piecewise'"),
    ],
)
def test_gradients_that_no_attractor_has_are_refused(change, words):
    with pytest.raises(gs.StudyError, match=words) as raised:
        gs.Study.from_dict(TABLES | change)
    assert len(raised.value.problems) == 1
