"""Machine code that came with the package: loaded where it fits, and nowhere else."""

import json
import os
import subprocess
import sys

import pytest
from llvmlite.binding import get_host_cpu_features

from gapsweep.integrate import jit

pytestmark = pytest.mark.extended

KERNEL = """
from gapsweep.integrate.jit import entry
@entry
def fused(a, b, c):
    return a * b + c
"""
CALL = """
import json, pathlib, sys
from gapsweep.integrate import jit
jit.SHIPPED = pathlib.Path(sys.argv[1])
{before}
import kernel
value = kernel.fused(2.0, 3.0, 4.0)
print(json.dumps([value, sum(kernel.fused.stats.cache_hits.values())]))
"""
LEVEL = "x86-64-v3"


@pytest.fixture
def call(tmp_path):
    """Call the kernel in a process of its own, without any machine code but what was shipped."""
    (tmp_path / "kernel.py").write_text(KERNEL)

    def called(before="", name="", **environment):
        caches = tmp_path / f"cache{len(list(tmp_path.iterdir()))}"
        env = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
        env |= {"NUMBA_CACHE_DIR": str(caches), **environment}
        script = [sys.executable, "-c", CALL.format(before=before), str(tmp_path / "shipped")]
        found = subprocess.run(script, env=env, capture_output=True, text=True, check=True)
        value, n_hits = json.loads(found.stdout)
        assert value == 10.0
        return n_hits

    def shipped(level=LEVEL):
        target = tmp_path / "shipped" / jit.folder_of(level)
        target.mkdir(parents=True)
        asked = {"NUMBA_CPU_NAME": level, "NUMBA_CPU_FEATURES": "", jit.SHIP_TO: str(target)}
        assert not called(**asked)
        return target

    called.shipped = shipped
    return called


def has(level):
    features = {name for name, is_there in get_host_cpu_features().items() if is_there}
    return jit.LEVELS[level] <= features


def test_what_was_shipped_for_this_processor_is_not_compiled(call):
    assert not call()
    call.shipped()
    assert call() == has(LEVEL)


def test_code_of_other_sources_is_not_loaded(call):
    call.shipped()
    assert not call(before="jit.source_fingerprint = lambda: 'other'")


def test_code_for_another_python_or_processor_is_not_loaded(call):
    target = call.shipped()
    target.rename(target.with_name(target.name.replace("cp3", "cp9")))
    assert not call()


def test_whoever_says_what_to_compile_for_gets_that(call):
    call.shipped()
    assert not call(NUMBA_CPU_NAME="x86-64-v2", NUMBA_CPU_FEATURES="")


def test_folders_are_of_levels_that_the_processor_has():
    names = [jit.folder_of(level) for level in jit.LEVELS]
    found = jit.shipped_for()
    assert set(found) <= set(names)
    assert list(found) == sorted(found, key=names.index)
    assert (jit.folder_of(LEVEL) in found) == has(LEVEL)
