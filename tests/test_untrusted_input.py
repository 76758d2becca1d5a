"""Safety: files from disk are data, never code; printed text is never markup."""

import ast
from pathlib import Path

import pytest

import gapsweep

SOURCES = Path(gapsweep.__file__).parent
FORBIDDEN_MODULES = {"pickle", "cloudpickle", "dill", "marshal", "shelve", "joblib", "yaml"}
# Machine code is code: read with its checksum, from a folder that is ours (test_kernel_files).
# Processes that we start talk with us over private pipes, as Dask's do.
MAY_READ_CODE = {
    SOURCES / "integrate" / "jit.py": {"pickle"},
    SOURCES / "execution" / "isolated.py": {"pickle"},
    SOURCES / "execution" / "workers.py": {"pickle"},
}
FORBIDDEN_CALLS = {"eval", "exec", "compile", "__import__"}
# The code that a study names is run there, and nowhere else.
RUNS_USER_CODE = SOURCES / "user_code" / "load.py"


@pytest.mark.parametrize("path", sorted(SOURCES.rglob("*.py")), ids=lambda p: p.name)
def test_nothing_read_can_be_executed(path):
    forbidden = FORBIDDEN_MODULES - MAY_READ_CODE.get(path, set())
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            assert not {a.name.split(".")[0] for a in node.names} & forbidden
        elif isinstance(node, ast.ImportFrom):
            assert (node.module or "").split(".")[0] not in forbidden
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert path == RUNS_USER_CODE or node.func.id not in FORBIDDEN_CALLS


@pytest.mark.parametrize(
    "name", ["../up", "a/b", "/abs", "..", ".hidden", "a\\b", "a\nb", "", "x" * 65, "ä", "a b"]
)
def test_study_name_cannot_leave_the_output_folder(tables, name):
    tables["study"]["name"] = name
    with pytest.raises(gapsweep.StudyError, match=r"study\.name"):
        gapsweep.Study.from_dict(tables)


def test_hostile_texts_are_escaped_in_the_report(tables, client, tmp_path):
    hostile = '"><img src=x onerror=alert(1)><script>alert(2)</script>'
    tables["study"]["title"] = hostile
    tables["sweep"][0]["representation"] = ["piecewise", "tests.misbehaving.forces:raising"]
    tables["sweep"][0]["omega"] = [7.0]
    tables["solver"] = {"engine": "scipy"}  # nothing to compile
    study = gapsweep.Study.from_dict(tables)
    gapsweep.run(study, client, out=tmp_path / "out", cache=tmp_path / "c-cache").close()
    page = (tmp_path / "out" / "report" / "index.html").read_text()
    assert "<script>alert" not in page
    assert "<img src=x" not in page
    assert "&lt;script&gt;alert(2)" in page
