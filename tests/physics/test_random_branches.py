"""Random scenes: branches hold periodic orbits of their prime period, and each orbit once."""

from functools import cache

import numpy as np
import pytest
import xarray as xr
from tests.oracles.exact_orbits import kinds, rows
from tests.oracles.random_branches import Scene, drawn, examined, faults, nearly_symmetric

import gapsweep as gs

pytestmark = pytest.mark.extended


# Nearly symmetric, own parameter, two coordinates, self-excited, nearly symmetric and stiff,
# two branches that meet, one wall, unequal walls with doublings.
@pytest.mark.parametrize(
    ("seed", "number"),
    [(3, 1), (3, 10), (3, 22), (3, 25), (3, 43), (3, 60), (5, 4), (5, 5)],
)
def test_random_branches_have_no_faults(seed, number):
    result = examined(drawn(seed, number))
    assert result.n_branches
    assert not result.found


NEARLY = dict(nearly_symmetric())


@pytest.mark.parametrize("name", [name for name in NEARLY if name.startswith("duffing 0.4")])
def test_branches_of_nearly_symmetric_oscillators_do_not_cross(name):
    result = examined(NEARLY[name])
    assert result.n_orbits > 100
    assert not result.found


# --- The checks themselves ----------------------------------------------------------------------

SCENE = Scene(
    "",
    gs.Oscillator(mass=1.0, omega_n=1.0, zeta=0.02, alpha=0.0, forcing=1.0),
    gs.Piecewise(200.0, gs.Gap(0.03, 0.05)),
    {"along": "omega", "between": (1.1, 2.2), "at": 2.1, "max_steps": 300},
)


@cache
def correct():
    return SCENE.branches()


def changed(change):
    """The branches with some values changed."""
    ds = correct().copy(deep=True)
    names = ds["special"].attrs["flag_meanings"].split()
    return change(ds, lambda name: int(np.flatnonzero(kinds(rows(ds, 0)) == name)[0]), names) or ds


def moved(ds, first, names):
    ds["start_state"][0, 5] *= 1.0 + 1e-6


def doubled(ds, first, names):
    ds["period"][:] *= 2.0
    ds["period_multiple"][:] *= 2


def renamed(old, new):
    def change(ds, first, names):
        ds["special"][0, first(old)] = names.index(new)

    return change


def shifted_graze(ds, first, names):
    step = first("grazing")
    ds["special"][0, step + 2] = ds["special"][0, step]
    ds["special"][0, step] = 0


def ordinary_named(ds, first, names):
    ds["special"][0, first("fold") + 8] = names.index("period_doubling")


def other_stability(ds, first, names):
    ds["stable"][0, 3] = 1 - ds["stable"][0, 3]


def other_multipliers(ds, first, names):
    ds["multiplier_real"][0, 3] *= 1.5


def joined(one, other, dim):
    how = {"data_vars": "minimal", "coords": "minimal", "compat": "override", "join": "override"}
    return xr.concat([one, other], dim, **how)


def two_branches(ds, first, names):
    twice = joined(ds, ds, "branch")
    return twice.assign_coords(branch=range(twice.sizes["branch"]))


def walked_twice(ds, first, names):
    n = int(ds["n_orbits"][0])
    once = ds.isel(branch=[0], step=slice(0, n))
    back = once.isel(step=slice(None, None, -1))
    twice = joined(once, back, "step")
    twice["n_orbits"][:] = 2 * n
    return twice


CHANGES = {
    "not closed": moved,
    "not prime": doubled,
    "crossing without symmetry": renamed("fold", "branch_point"),
    "multiplier": ordinary_named,
    "unexplained": renamed("fold", "none"),
    "turn": renamed("fold", "grazing"),
    "missed graze": renamed("grazing", "none"),
    "graze": shifted_graze,
    "stable": other_stability,
    "multipliers": other_multipliers,
    "on two branches": two_branches,
    "twice in a branch": walked_twice,
}


def test_correct_branches_have_no_faults():
    assert {"fold", "grazing"} <= set(kinds(rows(correct(), 0)))
    assert not list(faults(SCENE, correct()))


@pytest.mark.parametrize("kind", CHANGES)
def test_every_check_finds_its_fault(kind):
    found = {each for each, _ in faults(SCENE, changed(CHANGES[kind]))}
    assert kind in found
