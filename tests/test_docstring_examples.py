"""Every public object has an example in its docstring, and it says what it shows."""

import doctest

import numpy as np
import pytest

import gapsweep as gs

pytestmark = pytest.mark.extended

# What needs none: errors are raised by others.
NAMES = [name for name in gs.__all__ if not name.endswith("Error") and name != "systems"]
PUBLISHED = [name for name in dir(gs.systems) if not name.startswith("_") and name.islower()]


@pytest.mark.parametrize("name", [*NAMES, *(f"systems.{name}" for name in PUBLISHED)])
def test_the_example_of_a_public_object_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = gs
    for part in name.split("."):
        found = getattr(found, part)
    if isinstance(found, type(np)):
        return
    tests = [t for t in doctest.DocTestFinder(recurse=False).find(found, name) if t.examples]
    assert len(tests) == 1, "has no example"
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    assert runner.run(tests[0]).failed == 0
