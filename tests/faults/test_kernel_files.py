"""Machine code on disk: never stale, safe to share, and in a folder that can be written."""

import compileall
import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import gapsweep

SOURCES = Path(gapsweep.__file__).parent
RUN = """
import gapsweep as gs
law = gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4))
run = gs.simulate(gs.systems.paper_oscillator(), law, 9.0, t_end=1.0, dense_output=True)
x, _ = run.sample(0.5)
print(run.x_end.hex(), run.n_contacts, float(x).hex())
"""
COUNTED = """
from gapsweep.integrate.lanes import start_rows
from gapsweep.integrate.stepping import loop, sample
used = loop.advance, sample.sample_steps, start_rows.set_starts
print(sum(sum(each.stats.cache_misses.values()) for each in used))
"""


def start(package_parent, code_folder, code=RUN, **environment):
    variables = os.environ | {
        "PYTHONPATH": str(package_parent),
        "NUMBA_CACHE_DIR": str(code_folder),
    }
    return subprocess.Popen(
        [sys.executable, "-c", code],
        env=variables | environment,
        cwd=package_parent,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def printed(process):
    out, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    return out.strip()


@pytest.fixture
def copy(tmp_path):
    """A copy of the package that a test may edit."""
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(SOURCES, tmp_path / "source" / "gapsweep", ignore=ignored)
    return tmp_path / "source"


@pytest.fixture(scope="module")
def machine_code(tmp_path_factory):
    """A package, a folder of its machine code, and the numbers that it gives."""
    folder = tmp_path_factory.mktemp("code")
    return SOURCES.parent, folder, printed(start(SOURCES.parent, folder))


@pytest.mark.extended
def test_edited_helper_gives_new_numbers_in_the_next_process(copy, tmp_path):
    before = printed(start(copy, tmp_path / "code"))
    # Sampling enters compiled code in sample.py and evaluates polynomials in roots.py.
    helper = copy / "gapsweep" / "integrate" / "stepping" / "roots.py"
    text = helper.read_text()
    assert text.count("    return value, slope\n") == 1
    helper.write_text(text.replace("    return value, slope\n", "    return 2.0 * value, slope\n"))
    after = printed(start(copy, tmp_path / "code"))
    ((_, _, x_before), (_, _, x_after)) = before.split(), after.split()
    assert float.fromhex(x_after) == 2.0 * float.fromhex(x_before)


@pytest.mark.extended
def test_processes_that_start_together_on_no_code_agree_and_compile_once(copy, tmp_path):
    together = [start(copy, tmp_path / "code", RUN + COUNTED) for _ in range(3)]
    said = [printed(process).splitlines() for process in together]
    assert len({numbers for numbers, _ in said}) == 1
    assert sum(int(count) for _, count in said) == 3


@pytest.mark.extended
def test_a_killed_process_leaves_no_lock_behind(copy, tmp_path):
    first = start(copy, tmp_path / "code")
    while not list(tmp_path.glob("code/gapsweep/compiled-*/*.lock")):
        assert first.poll() is None
    first.kill()
    first.communicate()
    assert printed(start(copy, tmp_path / "code"))


@pytest.mark.extended
@pytest.mark.parametrize("damage", [lambda code: b"", lambda code: code[:-9] + b"x" * 9])
def test_damaged_machine_code_is_made_again(machine_code, damage):
    package, folder, numbers = machine_code
    (file,) = folder.glob("gapsweep/compiled-*/*set_starts-*.code")
    file.write_bytes(damage(file.read_bytes()))
    assert printed(start(package, folder)) == numbers
    found = file.read_bytes()
    assert found[:32] == hashlib.sha256(found[32:]).digest()


@pytest.mark.extended
def test_machine_code_under_anothers_name_is_not_run(machine_code):
    """As a race could leave it, or a name that stands for two signatures."""
    package, folder, numbers = machine_code
    names = ("sample_steps", "set_starts")
    wrong, other = (next(folder.glob(f"gapsweep/compiled-*/*{n}-*.code")) for n in names)
    wrong.write_bytes(other.read_bytes())
    assert printed(start(package, folder)) == numbers


def test_code_in_a_folder_of_somebody_else_is_not_run(copy, tmp_path):
    temporary = tmp_path / "temporary"
    (temporary / f"gapsweep-{os.getuid()}").mkdir(parents=True)
    (temporary / f"gapsweep-{os.getuid()}").chmod(0o777)
    where = "from gapsweep.integrate.jit import code_folder; print(code_folder())"
    blocked = tmp_path / "file"
    blocked.touch()
    variables = {"XDG_CACHE_HOME": str(blocked), "TMPDIR": str(temporary)}
    folder = Path(printed(start(copy, blocked, where, **variables)))
    assert temporary in folder.parents
    private = temporary / folder.relative_to(temporary).parts[0]
    assert private.name != f"gapsweep-{os.getuid()}"
    assert not private.stat().st_mode & 0o077


@pytest.mark.extended
def test_unwritable_folders_fall_back_to_the_next(copy, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("no folder can be made below a file")
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    for module in list(copy.rglob("*.py")):  # nor beside the sources, as where they are read-only
        beside = module.parent / "__pycache__"
        if not beside.is_file():
            shutil.rmtree(beside, ignore_errors=True)
            beside.write_text("no folder can be made here")
    run = start(copy, blocked, XDG_CACHE_HOME=str(blocked), TMPDIR=str(temporary))
    assert printed(run)
    assert list(temporary.glob("gapsweep-*/gapsweep/compiled-*"))


IMPORTED = """
import gapsweep
from gapsweep.user_code.package_digest import numerics_fingerprint
print(numerics_fingerprint())
"""


@pytest.mark.extended
def test_importing_leaves_byte_code_as_it_is(copy, tmp_path):
    """Also where it is older than its source, as in an image or a restored copy."""
    compileall.compile_dir(copy / "gapsweep" / "model", quiet=1)
    kept = list(copy.rglob("*.pyc"))
    assert kept
    for file in kept:
        os.utime(file, (1e9, 1e9))
    assert printed(start(copy, tmp_path, IMPORTED))
    assert {file for file in kept if file.exists() and file.stat().st_mtime == 1e9} == set(kept)
