"""Python beside a study: what it imports, what its digest holds, what is said when it is broken."""

import os
import sys
from pathlib import Path

import pytest

import gapsweep as gs
from gapsweep import beside, own_code
from gapsweep.stages import CLAIMS, HISTORIES, RESPONSES, SECTIONS, stages_of
from gapsweep.study.fingerprint import imports_fingerprint

MAIN = (
    '"""Words."""\nfrom . import other\nfrom .near import VALUE\n\ndef value():\n    return VALUE\n'
)


@pytest.fixture
def main(tmp_path):
    """A file with neighbours: one it takes a name from, one of that one's, one nobody imports."""
    (tmp_path / "main.py").write_text(MAIN)
    (tmp_path / "near.py").write_text("from .deep.far import VALUE\n")
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "far.py").write_text("VALUE = 1\n")
    (tmp_path / "other.py").write_text("import json\nimport gapsweep.model.contact\n")
    (tmp_path / "alone.py").write_text("raise SystemExit('imported by nobody')\n")
    return tmp_path / "main.py"


def edited(main, name, old, new):
    path = main.parent / name
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))


def test_neighbours_are_imported_relatively_from_any_folder(main, monkeypatch):
    monkeypatch.chdir("/")
    module = beside.load(main)
    assert module.value() == 1
    assert beside.load(main) is module  # nothing has changed
    assert not {"main", "near", "other"} & set(sys.modules)


def test_relative_paths_are_those_of_the_current_folder(main, monkeypatch):
    monkeypatch.chdir(main.parent)
    relative = main.relative_to(main.parent)
    assert beside.load(relative).value() == 1
    assert beside.digest(relative) == beside.digest(main)


@pytest.mark.parametrize(
    ("name", "old", "new"), [("deep/far.py", "1", "2"), ("main.py", "return VALUE", "return 2")]
)
def test_an_edit_is_seen_at_once(main, name, old, new):
    before = beside.load(main), beside.digest(main)
    edited(main, name, old, new)  # of the same size, within the same second
    assert beside.digest(main) != before[1]
    assert beside.load(main).value() == 2
    assert before[0].value() == 1


def test_comments_and_strangers_do_not_matter(main):
    before = beside.digest(main)
    edited(main, "main.py", "Words.", "Other words.")
    edited(main, "deep/far.py", "= 1", "=    1  # one")
    edited(main, "alone.py", "nobody", "no one")
    assert beside.digest(main) == before


def test_the_digest_is_that_of_the_code_wherever_it_stands(main, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere") / "copy"
    elsewhere.parent.joinpath("copy").mkdir()
    for path in [*main.parent.glob("*.py"), *main.parent.glob("*/*.py")]:
        there = elsewhere / path.relative_to(main.parent)
        there.parent.mkdir(exist_ok=True)
        there.write_text(path.read_text())
    assert beside.digest(elsewhere / "main.py") == beside.digest(main)


def test_what_it_imports_of_gapsweep_counts(main):
    imports = beside.sources(main).imports
    assert imports == {"json", "gapsweep.model.contact"}
    some = imports_fingerprint(imports)
    assert some != imports_fingerprint({"json"})
    assert some == imports_fingerprint({"gapsweep.model.contact", "numpy"})
    # The package itself hands out names of any module.
    assert imports_fingerprint({"gapsweep"}) == imports_fingerprint({"gapsweep", *imports}) != some


NEAR = """from .deep.far import VALUE
def one():
    return 1
def two():
    return 2
def made(n):
    def inner():
        return n
    return inner
class Holding:
    def __init__(self, n):
        self.n = n
    def __call__(self):
        return self.n
five = made(5)
"""


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("one", "two"),  # another function of the same file
        ("made(5)", "made(7)"),
        ("Holding(5)", "Holding(7)"),
        ("partial(made, 5)", "partial(made, 7)"),
        ("five", "one"),
        ("value", "one"),
        ("lambda: 5", "lambda: 7"),
        ("len", "sum"),
    ],
)
def test_the_digest_of_a_callable_tells_one_from_another(main, old, new):
    (main.parent / "near.py").write_text(NEAR)
    start = "from functools import partial\nfrom .near import Holding, five, made, one, two\n"
    found = []
    for callable in (old, new):
        main.write_text(f"{start}\ndef value():\n    return 3\n\nmine = {callable}\n")
        found.append(beside.digest_of(beside.load(main).mine, main))
    assert found[0] != found[1]


def test_a_function_of_a_neighbour_does_not_depend_on_the_rest(main):
    (main.parent / "near.py").write_text(NEAR)
    start = "from .near import one, made\nmine = one\n"
    digests = []
    for rest in ("a = 1\n", "a = 2\n"):
        main.write_text(start + rest)
        digests.append(beside.digest_of(beside.load(main).mine, main))
    edited(main, "deep/far.py", "1", "2")
    digests.append(beside.digest_of(beside.load(main).mine, main))
    assert digests[0] == digests[1] != digests[2]


@pytest.mark.parametrize("name", ["deep/far.py", "near.py"])
def test_what_a_function_imports_when_it_is_called_is_seen_too(main, monkeypatch, name):
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    main.write_text("def value():\n    from .near import VALUE, HERE\n    return VALUE + HERE\n")
    edited(main, "near.py", "VALUE\n", "VALUE\nHERE = 1\n")
    (main.parent / "deep" / "__init__.py").write_text("")
    stamps = [(main.parent / file).stat() for file in ("deep/far.py", "near.py")]
    assert beside.load(main).value() == 2
    edited(main, name, "= 1", "= 5")
    for file, stamp in zip(("deep/far.py", "near.py"), stamps, strict=True):
        os.utime(main.parent / file, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    assert beside.load(main).value() == 6
    assert not list(main.parent.rglob("__pycache__"))


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("main.py", "a = 1\nb = (\n", "main.py:2: SyntaxError: '(' was never closed"),
        ("near.py", "VALUE = = 1\n", "near.py:1: SyntaxError: invalid syntax"),
        ("near.py", "OTHER = 1\n", "main.py:3: ImportError: cannot import name 'VALUE'"),
        (
            "near.py",
            "from .gone import a\n",
            "near.py:1: ModuleNotFoundError: No module named '.gone'",
        ),
        ("near.py", "VALUE = 1 / 0\n", "near.py:1: ZeroDivisionError: division by zero"),
        ("near.py", "\nraise SystemExit\n", "near.py:2: SystemExit"),
        ("near.py", "open('/absent')\n", "near.py:1: FileNotFoundError: [Errno 2]"),
        ("near.py", "from ..above import x\n", "near.py:1: ImportError: attempted relative"),
        ("near.py", "import other\n", "a neighbour is imported relatively: from .other import"),
        ("main.py", "from .absent import x\n", "main.py:1: ModuleNotFoundError"),
        ("main.py", "a = '\0'\n", "source code string cannot contain null"),
    ],
)
def test_broken_modules_are_one_line(main, name, text, said):
    (main.parent / name).write_text(text)
    with pytest.raises(gs.StudyError) as refused:
        beside.load(main)
    (line,) = refused.value.problems
    assert line.startswith(str(main.parent))
    assert said in line
    assert "\n" not in line


def test_a_mended_module_is_loaded(main):
    edited(main, "deep/far.py", "1", "1 / 0")
    with pytest.raises(gs.StudyError):
        beside.load(main)
    edited(main, "deep/far.py", "1 / 0", "3")
    assert beside.load(main).value() == 3


def test_absent_files_are_named(tmp_path):
    with pytest.raises(gs.StudyError, match=r"absent\.py: cannot be read: No such file"):
        beside.load(tmp_path / "absent.py")


def study_of(tables, folder, **own):
    return gs.Study.from_dict({**tables, **own}, str(folder / "study.toml"))


def test_a_study_names_its_modules_and_runs_none(tables, main):
    own = {
        "claims": {"module": "alone.py"},
        "report": {"module": "../" + main.parent.name + "/a.py"},
    }
    (main.parent / "a.py").write_text("not Python")
    study = study_of(tables, main.parent, **own)
    assert study.claims_module == main.parent / "alone.py"
    assert study.report_module.samefile(main.parent / "a.py")


def test_what_a_study_does_not_make_is_not_read(tables, main):
    own = {"claims": {"module": "main.py"}, "report": {"module": "main.py"}}
    edited(main, "main.py", "def value", "DATASETS = {'mine': len}\n\ndef value")
    motion = {"representation": "piecewise", "K_c": 1.0, "gap": [0.0, 0.0], "omega": 9.0}
    for more, is_read in (({}, False), ({"history": [motion | {"t_end": 1.0}]}, True)):
        stages = {s.file: s.inputs for s in stages_of(study_of(tables, main.parent, **own, **more))}
        assert list(stages).index("mine.nc") < list(stages).index(CLAIMS)
        for file in (CLAIMS, SECTIONS):
            assert {RESPONSES, "mine.nc"} <= set(stages[file])
            assert (HISTORIES in stages[file]) == is_read


@pytest.mark.parametrize("name", ["paper/study.toml", "table2.toml"])
def test_the_papers_own_code_is_sound(name):
    own_code.check_modules(gs.Study.load(Path(__file__).parents[2] / "workflows" / name))


@pytest.mark.parametrize(
    ("own", "said"),
    [
        ({"claims": {"module": "absent.py"}}, "claims.module: .*absent.py cannot be read: No such"),
        ({"report": {"module": "deep.py"}}, "report.module: .*deep.py cannot be read: Is a dir"),
        ({"claims": {"module": "a.toml"}}, "claims.module = 'a.toml': must be .* Python file"),
        ({"report": {"module": "a-b.py"}}, "report.module = 'a-b.py': must be .* Python file"),
    ],
)
def test_a_study_refuses_modules_in_one_line(tables, tmp_path, own, said):
    (tmp_path / "deep.py").mkdir()
    with pytest.raises(gs.StudyError, match=said) as refused:
        study_of(tables, tmp_path, **own)
    assert len(refused.value.problems) == 1
