"""Querying a study larger than what was run."""

import subprocess
import sys

import numpy as np
import pytest
import xarray as xr
from tests.builders.studies import study_text

import gapsweep as gs
from gapsweep.store.cache import Cache
from gapsweep.store.maintenance import verify

pytestmark = pytest.mark.extended

TOML = study_text(["piecewise", "tanh-1e4"], "[7.0, 12.0]", name="small")


@pytest.fixture
def study(tables):
    tables["sweep"][0]["omega"] = {"start": 7.0, "stop": 12.0, "num": 11}
    tables["sweep"][0]["representation"] = ["piecewise", "tanh-1e4"]
    return gs.Study.from_dict(tables)


def counts(ds):
    return [ds.attrs[name] for name in ("n_points", "n_hits", "n_computed")]


def test_only_what_is_missing_is_computed(study, client, tmp_path, monkeypatch):
    path = tmp_path / "c-cache"
    some = gs.query(study, client, cache=path, representation="tanh-1e4", omega=slice(8, 9))
    assert counts(some) == [3, 0, 3]
    assert some.omega.values.tolist() == [8.0, 8.5, 9.0]
    more = gs.query(study, client, cache=path, representation="tanh-10000", omega=slice(8.5, 10))
    assert counts(more) == [4, 2, 2]
    monkeypatch.setattr("gapsweep.execution.cluster.cluster", None)  # no cluster for hits alone
    again = gs.query(study, cache=path, omega=[8.5, 10.0], representation=["tanh-1e4"])
    assert counts(again) == [2, 2, 0]
    shared = more.sel(omega=[8.5, 10.0])
    xr.testing.assert_equal(again["x_max"], shared["x_max"])


def test_query_equals_the_selection_of_a_whole_run(study, client, tmp_path):
    path = tmp_path / "c-cache"
    with gs.run(study, client, out=tmp_path / "out", cache=path) as ds:
        whole = ds.load()
    wanted = {"K_c": 1.4e4, "gap": "0.4/0.4", "omega": slice(8, 10)}
    part = gs.query(study, cache=path, **wanted, initial_condition=0)
    expected = whole.sel(omega=slice(8, 10))
    for name in part.data_vars:
        xr.testing.assert_equal(part[name], expected[name])


def test_selected_point_of_a_sweep_brings_those_that_lead_to_it(tables, client, tmp_path):
    omega = {"start": 9.0, "stop": 12.0, "num": 7}
    tables["sweep"][0] |= {"representation": ["piecewise"], "omega": omega}
    tables["sweep"][0]["initial_condition"] = "sweep_up"
    study = gs.Study.from_dict(tables)
    found = gs.query(study, client, cache=tmp_path / "part-cache", omega=10.5)
    assert counts(found) == [4, 0, 4]
    assert found.omega.values.tolist() == [10.5]
    with gs.run(study, client, out=tmp_path / "out", cache=tmp_path / "whole-cache") as whole:
        assert found["x_max"].item() == whole["x_max"].sel(omega=10.5).item()


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ({"omega": 8.1}, "omega = 8.1: not in the study, which has 7, 7.5, 8, ..., 11, 11.5, 12"),
        ({"omega": slice(20, 30)}, "omega = 20 to 30: no values in this range"),
        ({"K_c": "hard"}, "K_c = 'hard': not in the study, which has 14000"),
        ({"representation": "poly-9"}, "representation = 'poly-9': not in the study"),
        ({"gap": slice(0, 1)}, "gap = slice.*: must be a label"),
        ({"omega": []}, r"omega = \[\]: empty"),
        ({"speed": 1}, "speed: not a dimension of the study; choose from representation, K_c"),
    ],
)
def test_what_is_not_in_the_study_is_refused(study, tmp_path, wanted, message):
    with pytest.raises(gs.StudyError, match=message):
        gs.query(study, cache=tmp_path / "c-cache", **wanted)
    assert not (tmp_path / "c-cache").exists()


def test_a_selection_in_place_of_the_client_is_refused(study, client, tmp_path):
    """Also if all points are stored, where no client is needed."""
    gs.query(study, client, cache=tmp_path / "c-cache")
    with pytest.raises(gs.ClusterError, match=r"client = \{'omega': 7.0\}: .*omega="):
        gs.query(study, {"omega": 7.0}, cache=tmp_path / "c-cache")


def test_what_no_block_asks_for_is_refused(tables, tmp_path):
    tables["sweep"].append(tables["sweep"][0] | {"representation": ["piecewise"], "omega": [3.0]})
    study = gs.Study.from_dict(tables)
    said = r"= 'tanh-1e4', omega = \[3.0\]: no block has a point with these values$"
    with pytest.raises(gs.StudyError, match=said):
        gs.query(study, cache=tmp_path / "c-cache", representation="tanh-1e4", omega=[3.0])
    assert not (tmp_path / "c-cache").exists()


SCRIPT = """
import sys
import gapsweep as gs

print("begun")
ds = gs.query(sys.argv[1], cache=sys.argv[2], representation="piecewise", omega=7.0)
print(ds.attrs["n_computed"], "computed")
"""


def test_scripts_need_no_guard(tmp_path):
    """Workers do not run the script that has started them, and a path will do for a study."""
    (tmp_path / "script.py").write_text(SCRIPT)
    (tmp_path / "study.toml").write_text(TOML)
    done = subprocess.run(
        [sys.executable, "script.py", "study.toml", "c-cache"],
        cwd=tmp_path, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("\n") == ["begun", "1 computed", ""]
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("given", [None, {"study": {"name": "small"}}, 3])
@pytest.mark.parametrize("ask", [gs.run, gs.query])
def test_what_is_no_study_is_refused(ask, given):
    with pytest.raises(gs.StudyError, match=r"must be a gapsweep\.Study or the path of a study"):
        ask(given)


def test_an_interrupt_says_that_what_was_computed_is_kept(study, client, tmp_path):
    def press(progress):
        if progress.n_computed:
            raise KeyboardInterrupt

    path = tmp_path / "c-cache"
    with pytest.raises(KeyboardInterrupt) as interrupted:
        gs.query(study, client, cache=path, on_progress=press)
    assert interrupted.value.__notes__ == [f"computed points are in {path}; run again to resume"]
    with Cache(path) as cache:
        assert verify(cache).n_points > 0


@pytest.mark.parametrize("form", ["num", "step"])
def test_refined_grids_compute_exactly_the_new_points(tables, client, tmp_path, form):
    tables["sweep"][0]["representation"] = ["piecewise"]
    computed = []
    # 0.7 in steps that binary numbers cannot hold.
    for n in (21, 101, 201):
        grid = {"start": 9.1, "stop": 9.8}
        grid |= {"num": n} if form == "num" else {"step": 0.7 / (n - 1)}
        tables["sweep"][0]["omega"] = grid
        seen = []
        study = gs.Study.from_dict(tables)
        with gs.run(
            study, client, out=tmp_path / "out", cache=tmp_path / "c-cache",
            on_progress=lambda p, seen=seen: seen.append(p.n_computed),
        ) as ds:  # fmt: skip
            assert ds.sizes["omega"] == n
            assert np.all(ds["status"] == gs.Status.OK)
        computed.append(seen[-1])
    assert computed == [21, 80, 100]
    with Cache(tmp_path / "c-cache") as cache:
        assert verify(cache).n_points == 201
