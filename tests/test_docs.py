"""Every code block of the documentation runs as printed, and no name is missing in it."""

import re
import shlex
import shutil
import tomllib
from pathlib import Path

import matplotlib as mpl
import pytest
from matplotlib import pyplot as plt

import gapsweep as gs
from gapsweep.cli.main import commands, exit_code
from gapsweep.report.accessor import GapsweepAccessor
from gapsweep.study.spec import check
from tests.builders.studies import PAPER

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
MADE = {"_build", "generated"}
PAGES = sorted(p for p in DOCS.rglob("*.md") if not MADE & set(p.relative_to(DOCS).parts))
BLOCK = re.compile(r"^```(\w+)( no-test)?\n(.*?)^```$", re.DOTALL | re.MULTILINE)
MINIMAL = {
    "study": {"name": "fragment"},
    "oscillator": PAPER,
    "sweep": [{"representation": ["piecewise"], "K_c": [1.0], "gap": [[0, 0]], "omega": [1.0]}],
}
# What a block may need that a test has not: a cluster, or an installation.
NEEDS = ("dask ", "dask_", "Client(", "kubectl", "pip install", "_COMPLETE=")

pages = pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(DOCS)))


def blocks(page, *kinds):
    found = BLOCK.findall(page.read_text())
    return [code for kind, skip, code in found if kind in kinds and not skip]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder in which the pages' code runs: with the quick study and its results."""
    folder = tmp_path_factory.mktemp("clone")
    shutil.copytree(ROOT / "workflows", folder / "workflows")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.delenv("GAPSWEEP_CACHE", raising=False)
        assert exit_code(["run", "workflows/quick.toml"]) == 0
    return folder


@pytest.mark.parametrize("page", [*PAGES, *ROOT.glob("*.md")], ids=lambda p: p.name)
def test_links_lead_somewhere_in_a_clone(page):
    links = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", BLOCK.sub("", page.read_text()))
    assert [link for link in links if not (page.parent / link).exists()] == []


def test_pages_that_code_names_exist():
    folders = [ROOT / name for name in ("pipeline", "workflows", "benchmarks", ".github")]
    files = [path for folder in folders for path in folder.rglob("*.*") if path.is_file()]
    texts = [path.read_text() for path in files if path.suffix in {".py", ".toml", ".yml", ".md"}]
    named = {name for text in texts for name in re.findall(r"docs/[\w/-]+\.md", text)}
    assert named
    assert [name for name in named if not (ROOT / name).exists()] == []


@pages
def test_every_block_is_of_a_kind_that_is_tested(page):
    text = page.read_text()
    kinds = {kind for kind, *_ in BLOCK.findall(text)}
    assert kinds <= {"python", "sh", "toml", "text"}
    assert not re.search(r"\n\n    \S", BLOCK.sub("", text)), "an indented block is not tested"
    for _, skip, code in BLOCK.findall(text):
        assert not skip or any(need in code for need in NEEDS), "no reason not to test this"


@pytest.mark.extended
@pytest.mark.parametrize(
    "page", [p for p in PAGES if blocks(p, "python")], ids=lambda p: str(p.relative_to(DOCS))
)
def test_python_blocks_run_in_order(page, folder, monkeypatch):
    monkeypatch.chdir(folder)
    mpl.use("Agg")
    for data in page.parent.glob("*.csv"):  # which the page reads
        shutil.copy(data, folder)
    quick = Path("quick.toml")  # left by `gapsweep init quick`, which refuses to overwrite it
    is_new = not quick.exists()
    shutil.copy("workflows/quick.toml", quick)
    try:
        exec(compile("".join(blocks(page, "python")), page.name, "exec"), {})  # the pages are ours
    finally:
        plt.close("all")
        if is_new:
            quick.unlink()


@pytest.mark.extended
@pytest.mark.parametrize(
    "page", [p for p in PAGES if blocks(p, "sh")], ids=lambda p: str(p.relative_to(DOCS))
)
def test_commands_run(page, folder, monkeypatch):
    monkeypatch.chdir(folder)
    for line in "".join(blocks(page, "sh")).splitlines():
        name, *arguments = shlex.split(line)
        assert name == "gapsweep"
        assert exit_code(arguments) == 0, line


@pages
def test_toml_blocks_are_valid(page):
    for text in blocks(page, "toml"):
        tables = tomllib.loads(text)
        minimal = {k: v for k, v in MINIMAL.items() if k != "oscillator" or "system" not in tables}
        check({**minimal, **tables}, str(page))


def test_study_reference_names_every_key():
    text = (DOCS / "reference" / "study.md").read_text()
    spec = check(MINIMAL)
    for name in type(spec).model_fields:
        assert f"[{name}" in text, name
        table = getattr(spec, name)
        keys = getattr(type(table), "model_fields", {}) if table is not None else {}
        assert not [key for key in keys if f"{key} = " not in text and key != "start_jitter"]


def test_every_public_name_is_in_the_reference():
    listed = re.findall(r":: gapsweep\.(\w+)$", (DOCS / "reference" / "api.md").read_text(), re.M)
    assert sorted(listed) == sorted(gs.__all__)


def test_every_plot_is_in_the_reference():
    text = (DOCS / "reference" / "plots.md").read_text()
    plots = {name for name in vars(GapsweepAccessor) if not name.startswith("_")}
    members = re.search(r":members: ([\w,\s]+?)\n```", text)[1]
    assert plots - set(re.findall(r"\w+", members)) <= {"to_dataframe"}


def test_every_command_is_in_the_readme_or_the_guide():
    text = "".join(page.read_text() for page in PAGES) + (ROOT / "README.md").read_text()
    assert not [name for name in commands.commands if f"gapsweep {name}" not in text]


@pages
def test_pages_show_the_pictures_that_their_code_draws(page):
    """In the gallery and the tutorials; `python -m docs.pictures` draws them again."""
    code = "".join(blocks(page, "python"))
    shown = re.findall(r"^!\[.+\]\((\w[\w-]*\.png)\)$", page.read_text(), re.MULTILINE)
    saved = re.findall(r"savefig\(\"([\w-]+\.png)\"", code)
    if page.parent.name in ("gallery", "tutorials"):
        assert shown == saved
    assert page.parent.name != "gallery" or page.stem == "index" or shown == [f"{page.stem}.png"]


def test_the_gallery_shows_every_example():
    text = (DOCS / "gallery" / "index.md").read_text()
    shown = re.findall(r"\[!\[.+?\]\((\w+)\.png\)\]\((\w+)\.md\)", text)
    assert sorted(shown) == sorted(
        (p.stem, p.stem) for p in DOCS.glob("gallery/*.md") if p.stem != "index"
    )


def test_every_page_and_notebook_is_in_the_contents():
    listed = set()
    for page in PAGES:
        for tree in re.findall(r"^```{toctree}\n(.*?)^```$", page.read_text(), re.DOTALL | re.M):
            names = re.findall(r"^[\w/-]+$", tree, re.MULTILINE)
            listed |= {str((page.parent / name).relative_to(DOCS)) for name in names}
    written = {
        str(p.relative_to(DOCS).with_suffix("")) for p in PAGES if "decisions" not in p.parts
    }
    notebooks = {f"notebooks/{p.stem}" for p in (DOCS / "notebooks").glob("*.ipynb")}
    assert listed == (written | notebooks) - {"index"}


@pytest.mark.extended
@pytest.mark.parametrize("name", ["responses", "attractors", "agreement", "timing", "static"])
def test_every_variable_of_a_run_is_in_the_reference(name, folder, monkeypatch):
    monkeypatch.syspath_prepend(DOCS)
    import tables

    made = tables.pages()
    with gs.open(folder / "data" / "runs" / "quick" / f"{name}.nc") as ds:
        missing = [v for v in ds.data_vars if f"`{v}`" not in made[name]]
    assert not [v for v in missing if v != "forcing" and "ladder" not in v]
    assert f"generated/{name}.md" in (DOCS / "reference" / "datasets.md").read_text()


def test_the_states_of_the_search_are_in_the_docs(monkeypatch):
    monkeypatch.syspath_prepend(DOCS)
    import tables

    page = DOCS / "explanation" / "steady_states.md"
    assert f"```text\n{tables.states()}```" in page.read_text()


def test_every_command_is_in_the_generated_reference(monkeypatch):
    monkeypatch.syspath_prepend(DOCS)
    import tables

    made = tables.pages()["commands"]
    names = [*commands.commands, *(f"cache {n}" for n in commands.commands["cache"].commands)]
    assert all(f"## gapsweep {name}\n" in made for name in names)
    assert made.count("-h, --help") == len(names) + 1
