"""Contents of sdist and wheel; the wheel needs only its declared dependencies.

The environment into which the wheel is installed is empty but for the dependencies that stand in
this one: to download them again would cost minutes and show less than `test_no_library_is_missing`.
"""

import ast
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest
import yaml

from gapsweep.cli.init import STUDIES

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "pipeline" / "gapsweep"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# Names on conda-forge, where they are others or stand for more.
CONDA = {"dask": "dask-core", "matplotlib": "matplotlib-base", "netCDF4": "netcdf4"}
# Imported only where something else has brought them: a notebook, jinja2, numba.
BROUGHT = {"IPython", "llvmlite", "markupsafe", "tornado"}


def run(command, **options):
    """The output of a command that must succeed."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=900, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def recipe():
    return yaml.safe_load((ROOT / ".ci" / "conda" / "recipe.yaml").read_text())


@pytest.fixture(scope="module")
def dist(tmp_path_factory):
    """The sdist, and the wheel that is built from it."""
    folder = tmp_path_factory.mktemp("dist")
    run([sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(ROOT)])
    (sdist,), (wheel,) = folder.glob("*.tar.gz"), folder.glob("*.whl")
    return sdist, wheel


@pytest.fixture(scope="module")
def elsewhere(dist, tmp_path_factory):
    """A folder outside the clone, and an environment with the wheel whose home is empty."""
    folder = tmp_path_factory.mktemp("elsewhere")
    venv.create(folder / "env", symlinks=True)
    scripts = folder / "env" / "bin"
    run([sys.executable, "-m", "pip", "--python", str(scripts / "python"), "install", "--no-deps",
         "--no-index", "--quiet", str(dist[1])])  # fmt: skip
    (installed,) = folder.glob("env/lib/python*/site-packages")
    # A folder named in a .pth file adds its modules, not the .pth files in it: not the clone.
    libraries = [path for path in sys.path if path.endswith("site-packages")]
    (installed / "dependencies.pth").write_text("\n".join(libraries))
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "GAPSWEEP"))}
    environment |= {"HOME": str(folder), "PATH": f"{scripts}:{os.environ['PATH']}"}
    return {"cwd": folder, "env": environment}


@pytest.mark.extended
def test_sdist_and_wheel_are_in_order(dist):
    run([sys.executable, "-m", "twine", "check", "--strict", *map(str, dist)])


@pytest.mark.extended
def test_all_studies_and_templates_are_in_the_wheel_once(dist):
    names = zipfile.ZipFile(dist[1]).namelist()
    for carried, study in STUDIES.values():
        assert f"gapsweep/workflows/{study}" in names, carried
    in_package = {
        str(path.relative_to(PACKAGE.parent))
        for path in PACKAGE.rglob("*")
        if path.is_file() and path.suffix != ".pyc"
    }
    assert in_package <= set(names)
    assert len(names) == len(set(names))
    assert not [name for name in names if name.endswith(".pyc")]


@pytest.mark.extended
def test_the_sdist_holds_what_its_tests_need(dist):
    with tarfile.open(dist[0]) as sdist:
        names = {name.partition("/")[2] for name in sdist.getnames()}
    needed = [
        *ROOT.glob("tests/**/*.py"),
        *ROOT.glob("workflows/**/*.*"),
        *ROOT.glob("data/golden/*"),
    ]
    ours = {str(path.relative_to(ROOT)) for path in needed if path.suffix != ".pyc"}
    assert ours <= names


@pytest.mark.extended
def test_the_wheel_runs_where_nothing_else_is(elsewhere):
    where = run(["python", "-c", "import gapsweep; print(gapsweep.__file__)"], **elsewhere)
    assert Path(where.strip()).is_relative_to(elsewhere["cwd"] / "env")
    assert PROJECT["version"] in run(["gapsweep", "--version"], **elsewhere)
    run(["gapsweep", "init", "quick"], **elsewhere)
    assert run(["gapsweep", "run", "quick.toml"], **elsewhere).startswith("1212 points: 0 from")
    assert (elsewhere["cwd"] / "data" / "runs" / "quick" / "report" / "index.html").exists()


@pytest.mark.extended
def test_the_wheel_carries_the_whole_paper(elsewhere):
    run(["gapsweep", "init", "paper"], **elsewhere)
    ours = {p.relative_to(ROOT / "workflows") for p in (ROOT / "workflows/paper").glob("*.*")}
    assert ours <= {p.relative_to(elsewhere["cwd"]) for p in elsewhere["cwd"].glob("paper/*")}
    assert "report/index.html" in run(["gapsweep", "plan", "paper/study.toml"], **elsewhere)


def test_no_library_is_missing():
    asked = [*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["explore"]]
    declared = {re.split("[>=<]", text)[0] for text in asked}
    names = set(imported())
    assert names - BROUGHT <= declared
    # Imported by xarray; by Dask, which makes the keys of a local cluster with it.
    assert declared <= names | {"netCDF4", "cryptography"}


def imported():
    """Libraries that the package imports, and the Python of the studies that it carries."""
    files = [*PACKAGE.rglob("*.py"), *(ROOT / "workflows" / "paper").glob("*.py")]
    names = set()
    for node in (node for file in files for node in ast.walk(ast.parse(file.read_text()))):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names.add((node.module or "").partition(".")[0])
    return names - sys.stdlib_module_names - {"gapsweep"}


def test_one_version_everywhere():
    newest = re.search(r"^## \[(\d.*?)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert newest is not None
    assert newest[1] == PROJECT["version"] == cited["version"] == recipe()["context"]["version"]


def test_one_author_and_licence_everywhere():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    (author,) = [author["name"] for author in PROJECT["authors"]]
    assert cited["authors"] == [{"name": author}]
    assert author in (ROOT / "LICENSE").read_text()
    assert PROJECT["license"] == cited["license"] == recipe()["about"]["license"] == "MIT"


@pytest.mark.extended
def test_the_builder_of_conda_packages_understands_the_recipe(tmp_path):
    """It refuses fields that it does not know, and fills in what is given by name."""
    builder = pytest.importorskip("rattler_build")  # not on every platform
    path = ROOT / ".ci" / "conda" / "recipe.yaml"
    read = builder.Stage0Recipe.from_file
    (made,) = read(path).render(builder.VariantConfig(), builder.RenderConfig())
    found = made.recipe.to_dict()
    assert found["package"] == {"name": "gapsweep", "version": PROJECT["version"]}
    assert found["build"]["noarch"] == "python"
    (tmp_path / "recipe.yaml").write_text(path.read_text().replace("noarch:", "no_arch:"))
    with pytest.raises(builder.RattlerBuildError, match="no_arch"):
        read(tmp_path / "recipe.yaml")


def test_the_recipe_asks_for_the_same_libraries():
    asked = [text.split(" ", 1) for text in recipe()["requirements"]["run"][1:]]
    split = [re.fullmatch(r"([\w-]+)(>=.*)", text).groups() for text in PROJECT["dependencies"]]
    assert asked == [[CONDA.get(name, name), bound] for name, bound in split]
    assert PROJECT["requires-python"] == f">={recipe()['context']['python_min']}"
