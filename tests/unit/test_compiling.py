"""The compiler of the kernels: numba's own, without what kernels have no use for."""

import math

import numpy as np
import pytest
from numba import njit
from numba.core.compiler import Compiler, Flags

from gapsweep.integrate import jit


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
