"""Compilation of kernels; parts of numba that integrate/jit.py replaces or calls."""

import inspect
import math

import numba
import numpy as np
import pytest
from numba import njit
from numba.core import codegen, compiler, serialize, sigutils
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.dispatcher import Dispatcher

import gapsweep as gs
from gapsweep.integrate import jit
from gapsweep.integrate.problem import LOADING
from gapsweep.integrate.stepping.loop import advance


def chaos(x, out):
    """Branches, a loop and a call into mathematics: what kernels are made of."""
    for i in range(out.size):
        x = 3.9 * x * (1.0 - x) if x < 0.9 else math.sin(7.0 * x)
        out[i] = x
    return x


def test_parts_that_are_optimised_with_their_caller_give_the_same_bits():
    part, values = jit.internal(chaos), []
    for function in (njit(chaos), njit(lambda x, out: part(x, out))):
        out = np.empty(1000)
        values.append([function(0.3, out), *out])
    assert values[0] == values[1]


# Owner, name and parameters of each method of numba that jit.py replaces or calls.
METHODS = [
    (codegen.JITCodeLibrary, "_optimize_final_module", "self"),
    (codegen.JITCodeLibrary, "_finalize_final_module", "self"),
    (codegen.JITCodeLibrary, "get_pointer_to_function", "self, name"),
    (codegen.JITCodeLibrary, "codegen", "property"),
    (codegen.JITCPUCodegen, "set_env", "self, env_name, env"),
    (compiler.Compiler, "compile_extra", "self, func"),
    (FunctionCache, "_load_overload", "self, sig, target_context"),
    (FunctionCache, "_save_overload", "self, sig, data"),
    (FunctionCache, "_index_key", "self, sig, codegen"),
    (CompileResultCacheImpl, "check_cachable", "self, cres"),
    (CompileResultCacheImpl, "reduce", "self, cres"),
    (CompileResultCacheImpl, "rebuild", "self, target_context, payload"),
    (Dispatcher, "compile", "self, sig"),
    (Dispatcher, "_compile_for_args", "self, *args, **kws"),
    (serialize, "dumps", "obj"),
    (sigutils, "normalize_signature", "sig"),
]


def sentence(of_numba, of_jit):
    return (
        f"numba {numba.__version__}: {of_numba}; integrate/jit.py {of_jit}: adapt it there, or "
        "keep this version out by the cap of numba in pyproject.toml"
    )


def change(owner, name, parameters):
    """A sentence on a method that numba has removed, or has with other parameters; else empty."""
    method = f"{owner.__name__}.{name}"
    found = inspect.getattr_static(owner, name, None)
    if found is None:
        return sentence(f"there is no {method} any more", f"relies on {name}({parameters})")
    if isinstance(found, property) or parameters == "property":
        now = "property" if isinstance(found, property) else "a method"
        is_same = now == parameters
    else:
        signature = inspect.signature(found)
        now = ", ".join(map(str, signature.parameters.values()))
        is_same = now.split(", ") == parameters.split(", ")
    if is_same:
        return ""
    return sentence(f"{method} is now ({now})", f"relies on ({parameters})")


@pytest.mark.parametrize(("owner", "name", "parameters"), METHODS)
def test_numba_has_the_methods_that_are_replaced_or_called(owner, name, parameters):
    changed = change(owner, name, parameters)
    assert not changed, changed


def test_a_changed_method_of_numba_is_named_in_a_sentence():
    class Changed:
        def compile(self, sig, target): ...

        codegen = compile

    assert "there is no Changed.reduce any more" in change(Changed, "reduce", "self, cres")
    assert "compile is now (self, sig, target)" in change(Changed, "compile", "self, sig")
    assert "codegen is now (a method)" in change(Changed, "codegen", "property")


def allocating(n):
    return np.zeros(n)


def test_numba_compiles_parts_only_within_their_callers():
    """The library of a part is `InlinedCode`, which holds no machine code."""
    part = jit.internal(chaos)
    njit(lambda x, out: part(x, out))(0.3, np.empty(3))
    (found,) = part.overloads.values()
    replaced = sentence("code of a part is compiled separately", "sets state.library for parts")
    assert isinstance(found.library, jit.InlinedCode), replaced
    assert found.library.get_pointer_to_function(found.fndesc.llvm_func_name) == 0, replaced


def test_numba_refuses_allocations_in_parts():
    """The option `_nrt=False` leaves out the counts of references."""
    part = jit.internal(allocating)
    try:
        njit(lambda n: part(n))(3)
    except numba.core.errors.NumbaError:
        return
    pytest.fail(sentence("the option _nrt=False has no effect", "compiles parts with it"))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder of machine code that is empty."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    jit.code_folder.cache_clear()
    yield tmp_path
    jit.code_folder.cache_clear()


def test_numba_keeps_and_loads_machine_code_by_the_cache_of_jit(folder):
    before = LOADING.seconds
    assert jit.entry(chaos)(0.3, np.empty(3)) == chaos(0.3, np.empty(3))
    counts = sentence("_compile_for_args is not called to compile", "measures loading by it")
    assert LOADING.seconds > before, counts
    assert LOADING.elapsed >= LOADING.seconds
    files = [path.name for path in folder.rglob("*.code")]
    kept = sentence("machine code is not kept by dispatcher._cache", "replaces that cache")
    assert len(files) == 1, kept
    locks = sentence("dispatcher.compile is not called to compile", "locks a file in it")
    assert [*folder.rglob("*.lock")], locks
    again = jit.entry(chaos)
    again(0.3, np.empty(3))
    loaded = sentence("machine code is not loaded by dispatcher._cache", "replaces that cache")
    assert sum(again.stats.cache_hits.values()) == 1, loaded


def test_numba_takes_its_folder_from_the_setting_that_jit_replaces(folder):
    """numba's own cache would refuse a function without a folder to write to."""
    usual = numba.config.CACHE_DIR
    made = jit.MachineCodeCache(chaos)
    ignored = sentence("config.CACHE_DIR is not the folder of a cache", "sets it to its folder")
    assert made.cache_path.startswith(str(jit.code_folder())), ignored
    assert usual == numba.config.CACHE_DIR


@pytest.mark.parametrize("law", [gs.Piecewise, gs.Tanh])
def test_one_kernel_serves_all_tolerances_and_sizes_of_batches(law):
    contact = law(1.4e4, gs.Gap(4e-4, 4e-4), *([1e5] if law is gs.Tanh else []))

    def run(omega, rtol):
        oscillator = gs.systems.paper_oscillator()
        return gs.simulate(oscillator, contact, omega, n_periods=2, rtol=rtol).n_steps

    run(9.0, 1e-9)
    before = len(advance.signatures)
    for rtol in (1e-3, 1e-6, 1e-12):
        assert run(9.0, rtol) > 0
        assert np.all(run(np.linspace(8.0, 9.0, 20), rtol) > 0)
    assert len(advance.signatures) == before


def in_parts(n, n_modulations=1):
    """A system whose load, cubic spring and periodic stiffness are n equal parts each."""
    modulation = gs.Modulation(depth=0.2 / n_modulations, k=2, phase=0.4)
    return gs.System(
        mass=[[3.0]],
        stiffness=[[3e3]],
        damping=[[5.0]],
        contacts={"stop": [1.0]},
        forcing=[gs.Harmonic(amplitude=[4.0 / n], k=3, phase=0.3)] * n,
        cubic=[gs.Cubic(along=[1.0], alpha=7e8 / n)] * n,
        modulation={"stop": [modulation] * n_modulations},
    )


def test_one_kernel_serves_all_numbers_of_loads_springs_and_modulations():
    law = gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4))
    given = {"n_periods": 3, "rtol": 1e-12, "tangent": True}
    whole = gs.simulate(in_parts(1), law, 4.0, **given)
    assert whole.n_contacts > 0
    before = len(advance.signatures)
    for system in (in_parts(2), in_parts(7, 3)):
        run = gs.simulate(system, law, 4.0, **given)
        np.testing.assert_allclose(run.q_end, whole.q_end, rtol=1e-9)
        np.testing.assert_allclose(run.v_end, whole.v_end, rtol=1e-9)
        np.testing.assert_allclose(run.monodromy, whole.monodromy, rtol=1e-9, atol=1e-9)
    assert len(advance.signatures) == before
