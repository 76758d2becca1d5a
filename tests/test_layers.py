"""The architecture, enforced: who may import whom, and where outside libraries may appear."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import gapsweep

PACKAGE = Path(gapsweep.__file__).parent
LAYERS = (
    {"errors", "status"},
    {"quantities", "variables"},
    {"user_code"},
    {"model"},
    {"integrate"},
    {"response"},
    {"continuation"},
    {"design"},
    {"study"},
    {"store"},
    {"execution"},
    {"analysis"},
    {"report"},
    {"run_folder", "console"},
    {"explorer", "study_code"},
    {"stages"},
    {"pipeline"},
    {"cli", "__init__"},
    {"__main__"},
)
# Within `integrate/`: modules of one floor do not import each other; a folder is one module.
FLOORS = (
    {"motions", "vectors"},
    {"problem", "elementary"},
    {"jit", "simd", "overlap"},
    {"lanes"},
    {"taylor", "runge_kutta", "stepping"},
    {
        "compiled",
        "reference",
        "reference_motion",
        "reference_impacts",
        "reference_scenes",
        "simulate",
        "trajectory",
    },
)
FENCES = {
    "scipy": {"model", "integrate", "response", "continuation", "design", "study", "analysis"},
    "numba": {"model", "integrate", "response"},
    "xarray": {
        *("variables", "continuation", "store", "analysis", "report"),
        *("run_folder", "study_code", "stages", "pipeline", "cli", "explorer"),
    },
    "pandas": set(),
    "netCDF4": {"store", "execution"},
    "psutil": {"store", "execution"},
    "filelock": {"integrate"},
    "dask": {"execution", "store"},
    "distributed": {"execution", "pipeline"},
    "matplotlib": {"report"},
    "bokeh": {"explorer"},
    "tornado": {"explorer"},
    "pydantic": {"study"},
    "click": {"cli"},
    "rich": {"console"},
    "jinja2": {"report"},
}


# Methods of a study and of a fit that call the package's functions of the same name.
SHORTHANDS = {
    "study": {"gapsweep.plan", "gapsweep.query", "gapsweep.run"},
    "design": {"gapsweep.plot"},
}


def part(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def level(name):
    return next(i for i, names in enumerate(LAYERS) if name in names)


def dotted(path):
    """A module's name; a package's ends in `__init__`."""
    return ".".join(["gapsweep", *path.relative_to(PACKAGE).with_suffix("").parts])


def imports(path):
    """Modules imported at the top of a file, and those imported inside functions."""
    tree = ast.parse(path.read_text())
    # What stands under a top-level `if TYPE_CHECKING` is at the top too.
    guarded = [inner for node in tree.body if isinstance(node, ast.If) for inner in node.body]
    top = set(map(id, tree.body + guarded))
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, id(node) in top) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            # Of level 1 is the module's own package, of level 2 the one above it.
            above = dotted(path).split(".")[: -node.level] if node.level else []
            start = ".".join([*above, *filter(None, [node.module])])
            yield from ((f"{start}.{a.name}", id(node) in top) for a in node.names)


MODULES = sorted(PACKAGE.rglob("*.py"))


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_modules_import_only_what_stands_below_them(path):
    here = part(path)
    for name, at_top in imports(path):
        library = name.split(".")[0]
        if library == "gapsweep":
            target = name.split(".")[1]
            target = target if any(target in names for names in LAYERS) else "__init__"
            if name in SHORTHANDS.get(here, ()):
                continue
            assert target == here or level(target) < level(here) or name == "gapsweep.__version__"
            # Only the whole path may put off what a run with nothing to do never needs, and the
            # explorer what needs an extra; the one call for all engines loads the one asked for.
            late = here in ("study_code", "stages", "pipeline", "cli", "explorer")
            late |= path.relative_to(PACKAGE).as_posix() == "integrate/simulate.py"
            assert at_top or late, f"{name} is imported inside a function"
        elif library in FENCES:
            assert here in FENCES[library], f"{library} does not belong into {here}"


def floor(name):
    """Floor of a module's name, with all packages above it, within `integrate/`."""
    return next(i for i, names in enumerate(FLOORS) if name.split(".")[2] in names)


@pytest.mark.parametrize(
    "path", sorted((PACKAGE / "integrate").rglob("*.py")), ids=lambda p: p.stem
)
def test_steppers_and_the_stepping_loop_meet_only_in_the_rows_of_lanes(path):
    here = dotted(path)
    if here == "gapsweep.integrate.__init__":
        return
    for name, _ in imports(path):
        if not name.startswith("gapsweep.integrate."):
            continue
        if floor(here) == len(FLOORS) - 1:
            assert floor(name) <= floor(here), name
        else:
            is_own = name.split(".")[2] == here.split(".")[2]
            assert is_own or floor(name) < floor(here), f"{name} is imported in {here}"


def test_relative_imports_are_followed():
    path = PACKAGE / "integrate" / "stepping" / "batch.py"
    assert ("gapsweep.integrate.stepping.record", True) in imports(path)
    assert ("gapsweep.integrate.stepping.roots.work_space", True) in imports(path)


def test_no_modules_import_each_other_in_a_circle():
    # The package itself loads all others, when they are asked for.
    known = {dotted(path): path for path in MODULES if path != PACKAGE / "__init__.py"}

    def module(name):
        above = name.rpartition(".")[0]
        places = name, f"{name}.__init__", above, f"{above}.__init__"
        return next((place for place in places if place in known), None)

    graph = {
        one: {module(name) for name, at_top in imports(path) if at_top} - {None}
        for one, path in known.items()
    }
    assert "gapsweep.integrate.stepping.record" in graph["gapsweep.integrate.stepping.batch"]
    assert "gapsweep.model.own_law" in graph["gapsweep.model.labels"]
    # Raises CycleError, which names the modules.
    TopologicalSorter(graph).prepare()


def test_public_names_exist_and_are_sorted():
    assert sorted(gapsweep.__all__) == list(gapsweep.__all__)
    assert all(hasattr(gapsweep, name) for name in gapsweep.__all__)
    assert all(getattr(gapsweep, name).__doc__ for name in gapsweep.__all__)


@pytest.mark.parametrize("use_jedi", [True, False])
def test_completion_offers_the_public_names_and_nothing_else(use_jedi):
    completer = pytest.importorskip("IPython.core.completer")
    given = {"use_jedi": use_jedi, "disable_matchers": ["IPCompleter.magic_matcher"]}
    offered = completer.IPCompleter(namespace={"gapsweep": gapsweep}, **given)
    with completer.provisionalcompleter():
        found = [each.text for each in offered.completions("gapsweep.", 9)]
    assert sorted(text.rpartition(".")[2] for text in found) == gapsweep.__all__
    assert set(dir(gapsweep)) == {*gapsweep.__all__, "__version__"}


def test_the_command_line_prints_through_one_function():
    """It leaves out control characters of foreign files."""
    printing = [
        path.name for path in (PACKAGE / "cli").glob("*.py") if "click.echo(" in path.read_text()
    ]
    assert printing == ["options.py"]
