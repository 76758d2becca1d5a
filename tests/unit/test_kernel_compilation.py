"""Compilation of kernels; after an edit of the source no cached kernel is loaded."""

import math

import numpy as np
from numba import njit

from gapsweep.integrate import jit


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
