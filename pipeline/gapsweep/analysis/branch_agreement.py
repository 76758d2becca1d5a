"""Special points of approximations against those of the exact law: where they move, come and go.

In each scene, points of one kind on branches of one period multiple are paired one to one so that
the sum of the distances along the parameter is least. Points of either law that are left over have
NaN in place of the other value: they are missing in the approximation, or extra.
"""

from collections.abc import Iterator

import numpy as np
import xarray as xr

from gapsweep.analysis.matching import assignment
from gapsweep.continuation.dataset import BRANCH, SPECIAL_FLAGS
from gapsweep.continuation.special import Special
from gapsweep.model.labels import EXACT
from gapsweep.variables import Variable

MATCH = "match"
VARIABLES = {
    "match_scene": Variable("i4", "1", "number of the scene of the approximation"),
    "match_kind": Variable("i1", "1", "kind of special point", 0, SPECIAL_FLAGS),
    "match_period_multiple": Variable("i4", "1", "forcing periods in one period of the orbit"),
    "match_exact": Variable("f8", "", "parameter on the branch of the exact law, NaN: extra"),
    "match_law": Variable("f8", "", "parameter on that of the approximation, NaN: missing"),
    "match_difference": Variable("f8", "", "approximation minus exact law"),
}

Row = tuple[int, int, int, float, float]
Points = dict[tuple[int, int], list[float]]


def special_points(branches: xr.Dataset, along: str) -> xr.Dataset:
    """Special points of every approximation, matched with those of the exact law.

    Parameters
    ----------
    branches : Dataset
        As ``branches.nc``, with the coordinates of its scenes.
    along : str
        The parameter.

    Returns
    -------
    Dataset
        Over `match`; empty without the exact law.
    """
    rows = list(_rows(branches, along)) if "special" in branches else []
    columns = list(zip(*rows, strict=True)) or [()] * 5
    law, exact = np.array(columns[4], float), np.array(columns[3], float)
    values = dict(zip(VARIABLES, (*columns[:3], exact, law, law - exact), strict=True))
    units = branches[along].attrs.get("units", "") if along in branches else ""
    found = {}
    for name, form in VARIABLES.items():
        about = form.attributes | ({"units": units} if form.dtype == "f8" and units else {})
        found[name] = (MATCH, np.asarray(values[name], form.dtype), about)
    return xr.Dataset(found)


def _rows(branches: xr.Dataset, along: str) -> Iterator[Row]:
    names = [name for name in branches.coords if str(name).startswith("scene_")]
    columns = zip(*(branches[name].values.tolist() for name in names), strict=True)
    scenes = [dict(zip(names, row, strict=True)) for row in columns]
    numbers = {tuple(scene.values()): number for number, scene in enumerate(scenes)}
    for number, scene in enumerate(scenes):
        other = numbers.get(tuple((scene | {"scene_representation": EXACT}).values()))
        if other in (None, number) or (branches["scene_status"][[number, other]] > 0).any():
            continue
        ours, exact = (_points(branches, along, i) for i in (number, other))
        for key in sorted({*ours, *exact}):
            for pair in _pairs(exact.get(key, []), ours.get(key, [])):
                yield (number, *key, *pair)


def _points(branches: xr.Dataset, along: str, scene: int) -> Points:
    """Parameters at the special points of a scene, by kind and period multiple."""
    here = branches.isel({BRANCH: branches["branch_scene"].values == scene})
    special = here["special"].values
    found: Points = {}
    for at in zip(*np.nonzero(special != Special.NONE), strict=True):
        key = int(special[at]), int(here["period_multiple"].values[at])
        found.setdefault(key, []).append(float(here[along].values[at]))
    return found


def _pairs(exact: list[float], ours: list[float]) -> Iterator[tuple[float, float]]:
    """Pairs of parameters; NaN stands for the missing one of a point that is left over."""
    a, b = np.array(exact), np.array(ours)
    rows, columns = assignment(np.abs(a[:, None] - b[None, :]), np.inf)
    yield from zip(a[rows].tolist(), b[columns].tolist(), strict=True)
    yield from ((x, np.nan) for x in np.delete(a, rows).tolist())
    yield from ((np.nan, x) for x in np.delete(b, columns).tolist())
