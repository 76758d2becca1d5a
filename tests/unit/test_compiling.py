"""How kernels are compiled, and that none is loaded after an edit."""

import math

import numpy as np
import pytest
from numba import njit
from tests.stored import points

from gapsweep.errors import ClusterError
from gapsweep.execution.task import Task, Tile, compute, load, process
from gapsweep.integrate import jit
from gapsweep.study import fingerprint
from gapsweep.study.software import software


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
