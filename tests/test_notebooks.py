"""Every notebook runs from top to bottom in an empty folder; stored and new outputs agree."""

from pathlib import Path

import pytest

nbclient = pytest.importorskip("nbclient")
nbformat = pytest.importorskip("nbformat")

pytestmark = pytest.mark.extended

FOLDER = Path(__file__).parents[1] / "docs" / "notebooks"
# What must be read in the outputs, and how many figures must be drawn.
PROMISES = {
    "first_steps": (["303: 303 from the cache, 0 computed", "omega"], 4),
    "query_the_cache": (
        [
            "11: 0 from the cache, 11 computed",
            "11 of 42 points were stored",
            "11/11 points",
            "K_c = 20000.0",
        ],
        1,
    ),
    "own_representation": (["18: 0 from the cache, 18 computed"], 1),
    "own_oscillator": (["wall crossings", "564: 0 from the cache", "242: 0 from", "PERIODIC"], 3),
    "on_a_cluster": (["10 of 10 points were stored"], 1),
}

# A first cell whose last value is a picture.
PLOT = """
import gapsweep as gs
law = gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4))
gs.plot(gs.simulate(gs.systems.paper_oscillator(), law, 9.0, t_end=2.0, dense_output=True))
"""


def test_every_notebook_is_tested():
    assert {path.stem for path in FOLDER.glob("*.ipynb")} == set(PROMISES)


def assert_shows(notebook, words, n_figures):
    outputs = [out for cell in notebook.cells for out in cell.get("outputs", [])]
    shown = "".join(str(out) for out in outputs)
    assert not [text for text in words if text not in shown]
    assert sum("image/png" in out.get("data", {}) for out in outputs) == n_figures


@pytest.mark.parametrize("name", PROMISES)
def test_notebook_runs_and_shows_what_it_promises(name, tmp_path, monkeypatch):
    monkeypatch.delenv("GAPSWEEP_CACHE", raising=False)
    monkeypatch.setenv("PYDEVD_DISABLE_FILE_VALIDATION", "1")
    notebook = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    assert_shows(notebook, *PROMISES[name])
    where = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=300, resources=where).execute()
    assert_shows(notebook, *PROMISES[name])
    assert (tmp_path / "data" / "cache").exists()


@pytest.mark.parametrize("before", ["", "import matplotlib.pyplot as plt", "%matplotlib inline"])
def test_a_plot_as_the_first_cell_shows_one_picture(before, tmp_path, monkeypatch):
    monkeypatch.setenv("PYDEVD_DISABLE_FILE_VALIDATION", "1")
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(before + PLOT)])
    where = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=300, resources=where).execute()
    shown = [out.get("data", {}) for out in notebook.cells[0].outputs]
    assert sum("image/png" in each for each in shown) == 1
