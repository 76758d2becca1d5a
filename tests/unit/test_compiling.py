"""The compiler of the kernels: numba's own, without what kernels have no use for."""

import math

import numpy as np
import pytest
from numba import njit
from numba.core.compiler import Compiler, Flags
from tests.stored import points

from gapsweep.errors import ClusterError
from gapsweep.execution.task import Task, Tile, compute, load, process, software_with_engines
from gapsweep.integrate import jit
from gapsweep.study import fingerprint
from gapsweep.study.software import software


def chaos(x, out):
    """Branches, a loop and a call into mathematics: what kernels are made of."""
    for i in range(out.size):
        x = 3.9 * x * (1.0 - x) if x < 0.9 else math.sin(7.0 * x)
        out[i] = x
    return x


def test_the_same_bits_as_by_numbas_own_compiler():
    values = []
    for pipeline in (Compiler, jit._OurCompiler):
        out = np.empty(1000)
        values.append([njit(pipeline_class=pipeline)(chaos)(0.3, out), *out])
    assert values[0] == values[1]


def test_every_pass_that_is_left_out_is_one_of_numbas():
    """One with another name in another version of numba would be kept without a word."""
    kept = []
    for pipeline in (Compiler, jit._OurCompiler):

        class Spied(pipeline):
            def define_pipelines(self):
                found = super().define_pipelines()
                kept.append({each for each, _ in found[0].passes})
                return found

        njit(pipeline_class=Spied)(chaos)(0.3, np.empty(1))
    assert kept[0] - kept[1] == jit._NEEDLESS


def test_equal_options_are_one_object_that_nobody_changes():
    """As one would for one function, it would for all functions compiled after it."""
    options = Flags()
    options.nrt = True
    ours = jit._known_flags(Flags(options))
    assert ours is jit._known_flags(Flags(options)) is ours.copy()
    assert ours.nrt
    assert ours.values() == options.values()
    with pytest.raises(TypeError):
        ours.nrt = False
    options.nrt = False
    assert jit._known_flags(options) is not ours


@pytest.fixture
def edited(monkeypatch):
    """The first file of the numerics is another one than this process has read."""
    file = fingerprint._numerics(fingerprint._PACKAGE)[0]
    known = fingerprint._bytes

    def edit():
        monkeypatch.setattr(fingerprint, "_bytes", lambda p: b"" if p == file else known(p))

    return edit


def test_no_engine_is_loaded_after_an_edit(edited):
    """What a process says of its code was read before; what it loads now may be another."""
    load("scipy")
    edited()
    load("scipy")  # as it is loaded
    load.cache_clear()
    with pytest.raises(ClusterError, match="edited after this process loaded gapsweep"):
        load("scipy")


def test_a_worker_computes_nothing_with_what_it_loads_after_an_edit(edited):
    software()  # what a run asks every worker as it begins
    edited()
    load.cache_clear()
    tile = Tile.of_one(points(1.4e4), np.zeros(2))
    with pytest.raises(ClusterError, match="edited"):
        compute(Task([tile], 60.0, process()))
    with pytest.raises(ClusterError, match="edited"):
        software_with_engines()  # a process for laws of the user's own
