"""Classes of responses: which agree, and how much of that is more than chance (A9)."""

import numpy as np

from gapsweep.analysis.arrays import Array, Bools, Ints
from gapsweep.response.result import ResponseClass as R

_LONGEST = 8
CLASSES = (
    *(f"P{n}" for n in range(1, _LONGEST + 1)),
    f"P>{_LONGEST}",
    "chaotic",
    "quasiperiodic",  # of systems, as what follows
    "equilibrium",
    "unresolved",
    "failed",
)
CHAOTIC, UNRESOLVED, FAILED = (CLASSES.index(n) for n in ("chaotic", "unresolved", "failed"))
_NAMED = {kind: CLASSES.index(kind.name.lower()) for kind in R if kind != R.PERIODIC}
NONE = -1


def class_numbers(requested: Bools, response_class: Ints, period_multiple: Ints) -> Ints:
    """Number in `CLASSES` of every response; `NONE` where nothing was asked for."""
    periodic = np.minimum(period_multiple, _LONGEST + 1) - 1
    which = [response_class == kind for kind in (R.PERIODIC, *_NAMED)]
    numbers = np.select(which, [periodic, *_NAMED.values()], FAILED)
    return np.where(requested, numbers, NONE)


def confusion(ours: Ints, theirs: Ints) -> Array:
    """How often class i of the second goes with class j of the first, per frequency.

    Parameters
    ----------
    ours, theirs : ndarray of int, shape (n_omega, n_starts)
        Class numbers; `NONE` in either is left out.

    Returns
    -------
    ndarray, shape (n_omega, n_classes, n_classes)
        Indices: frequency, class of `theirs`, class of `ours`.
    """
    counts = np.zeros((len(ours), len(CLASSES), len(CLASSES)))
    w, s = np.nonzero((ours != NONE) & (theirs != NONE))
    np.add.at(counts, (w, theirs[w, s], ours[w, s]), 1.0)
    return counts


def kappa(confusion: Array) -> Array:
    """Cohen's kappa: the share of agreement beyond that of chance (Cohen 1960).

    Parameters
    ----------
    confusion : ndarray, shape (..., n_classes, n_classes)

    Returns
    -------
    ndarray, shape (...)
        1 for complete agreement. NaN for an empty table, and where the exact law (rows) shows
        one class only but the other law others too: nothing was there to be told apart.
    """
    total = confusion.sum(axis=(-2, -1))
    with np.errstate(invalid="ignore", divide="ignore"):
        agreed = np.trace(confusion, axis1=-2, axis2=-1) / total
        rows, columns = confusion.sum(axis=-1), confusion.sum(axis=-2)
        chance = (rows * columns).sum(axis=-1) / total**2
        value = (agreed - chance) / (1.0 - chance)
    one_class = np.count_nonzero(rows, axis=-1) <= 1
    return np.where(agreed == 1.0, 1.0, np.where(one_class, np.nan, value))
