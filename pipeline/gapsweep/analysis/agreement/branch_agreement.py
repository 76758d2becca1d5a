"""Special points on branches of approximations, matched with those of the exact law.

In each parameter set, points of one kind on branches of one period multiple are paired one to one
so that the sum of the distances along the parameter is least. Unpaired points of either law have
NaN in place of the other value: they are missing in the approximation, or extra.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

from gapsweep.analysis.agreement.matching import assignment
from gapsweep.analysis.dimensions import Array
from gapsweep.continuation.dataset import SPECIAL_FLAGS
from gapsweep.continuation.special import Special
from gapsweep.model.labels import EXACT
from gapsweep.variables import Variable

MATCH = "match"
_SAME = 1e-8  # largest relative difference of the parameter at a point that is on two branches
VARIABLES = {
    "match_kind": Variable("i1", "1", "kind of special point", flags=SPECIAL_FLAGS),
    "match_period_multiple": Variable("i4", "1", "forcing periods in one period of the orbit"),
    "match_exact": Variable("f8", "", "parameter on the branch of the exact law, NaN: extra"),
    "match_law": Variable("f8", "", "parameter on the branch of the approximation, NaN: missing"),
    "match_difference": Variable("f8", "", "approximation minus exact law"),
}

Place = Mapping[str, int]


def compared(
    scenes: Sequence[tuple[Place, xr.Dataset | None]], labels: Sequence[str], along: str
) -> tuple[xr.Dataset, list[Place]]:
    """Special points of every approximation, matched with those of the exact law.

    Parameters
    ----------
    scenes : sequence of (mapping of str to int, Dataset or None)
        Positions of parameter sets on the axes of the study, and their branches.
    labels : sequence of str
        Representations.
    along : str
        The parameter of the branches.

    Returns
    -------
    Dataset
        Matches, over dimension `match`.
    list of mapping of str to int
        The position of the approximation of every match.
    """
    rows: list[tuple[float, ...]] = []
    places: list[Place] = []
    exact = {
        tuple(at.values())[1:]: found
        for at, found in scenes
        if labels[at["representation"]] == EXACT and found is not None
    }
    for at, found in scenes:
        reference = exact.get(tuple(at.values())[1:])
        if reference is None or found is None or labels[at["representation"]] == EXACT:
            continue
        ours, theirs = (_points(each, along) for each in (found, reference))
        for key in np.unique(np.concatenate([ours, theirs])[:, :2], axis=0).tolist():
            a, b = (each[(each[:, :2] == key).all(axis=1), 2] for each in (theirs, ours))
            i, j = assignment(np.abs(a[:, None] - b[None, :]), np.inf)
            pairs = [*zip(a[i], b[j], strict=True), *((x, np.nan) for x in np.delete(a, i))]
            pairs += [(np.nan, x) for x in np.delete(b, j)]
            rows += [(*key, x, y, y - x) for x, y in pairs]
            places += len(pairs) * [at]
    columns = np.reshape(rows, (-1, len(VARIABLES))).T
    named = zip(VARIABLES.items(), columns, strict=True)
    table = {name: (MATCH, of.astype(form.dtype), form.attributes) for (name, form), of in named}
    return xr.Dataset(table), places


def _points(branches: xr.Dataset, along: str) -> Array:
    """Kind, period multiple and parameter of special points, shape (n, 3).

    A doubled branch ends at the point where it leaves: that point counts with half the multiple.
    """
    special = branches["special"].values
    names = "special", "period_multiple", along
    every = np.stack([branches[name].values[special > 0].astype(float) for name in names], axis=1)
    kind, multiple, value = (each[:, None] - each for each in every.T)
    is_same = (kind == 0.0) & (np.abs(value) <= _SAME * np.abs(every[:, 2]))
    is_doubled = (every[:, :1] == Special.PERIOD_DOUBLING) & is_same & (multiple > 0.0)
    found: Array = every[~is_doubled.any(axis=1)]
    return found
