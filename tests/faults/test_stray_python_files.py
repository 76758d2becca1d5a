"""Python files that happen to lie about, and rows that name code: nothing of it is run."""

from dataclasses import replace

import pytest
from tests.builders.cache import made, point
from tests.builders.runs import COMMAND, SOURCES, in_a_process
from tests.builders.studies import study_text

import gapsweep as gs
from gapsweep.store.cache import Cache

pytestmark = pytest.mark.extended

MARK = "import os\nopen(os.path.join(os.path.dirname(__file__), 'ran'), 'a').write(__name__)\n"
# Libraries, parts of Python, and what some of them look for in vain.
SHADOWS = ("xarray", "scipy", "numba", "queue", "socket", "random", "secrets", "cftime")
STARTS = "{ sobol = 2, seed = 1, x = [-1e-3, 1e-3], v = [-0.1, 0.1] }"
STUDY = study_text(["piecewise"], "[12.0]", sweep=f"initial_condition = {STARTS}")


def gapsweep(folder, *arguments):
    variables = {"GAPSWEEP_CACHE": "c-cache", "PYTHONPATH": str(SOURCES.parent)}
    return in_a_process(folder, *arguments, command=[COMMAND], variables=variables)


@pytest.fixture
def shadowed(tmp_path):
    """A folder that holds files named as libraries are."""
    (tmp_path / "tiny.toml").write_text(STUDY)
    for name in SHADOWS:
        (tmp_path / f"{name}.py").write_text(MARK)
    return tmp_path


def test_files_of_the_current_folder_never_stand_in_for_libraries(shadowed):
    for arguments in (
        ("plan", "tiny.toml"),
        ("run", "tiny.toml", "--out", "out"),
        ("query", "tiny.toml"),
    ):
        gapsweep(shadowed, *arguments)
        ran = shadowed / "ran"
        assert not ran.exists(), f"{arguments[0]} ran {ran.read_text()}"


def test_code_that_a_study_names_is_found_in_the_current_folder_after_libraries(shadowed):
    (shadowed / "springs.py").write_text("import random, queue\ndef soft(x):\n    return 1e3 * x\n")
    (shadowed / "tiny.toml").write_text(STUDY.replace('"piecewise"', '"springs:soft"'))
    done = gapsweep(shadowed, "run", "tiny.toml", "--engine", "scipy", "--out", "out")
    assert "2 computed" in done.stdout
    # cftime is no library here: where code is looked up, what is asked for is found.
    ran = shadowed / "ran"
    assert not ran.exists() or set(ran.read_text().split("cftime")) == {""}


def test_code_that_only_a_row_names_is_not_run(shadowed):
    (shadowed / "evil.py").write_text(MARK + "def law(x):\n    return 0.0\n")
    study = gs.Study.load(shadowed / "tiny.toml")
    evil = replace(point(study, 0, 0, 0, 0, 0).kind, representation="evil:law")
    with Cache(shadowed / "c-cache") as cache:
        cache.commit(made([1], [gs.Response(status=gs.Status.OK)], kind=evil))
    gapsweep(shadowed, "cache", "verify")
    assert not (shadowed / "ran").exists()
