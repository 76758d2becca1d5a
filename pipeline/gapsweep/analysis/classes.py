"""Classes of responses, to be compared with each other (A9)."""

import numpy as np

from gapsweep.analysis.arrays import Bools, Ints
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
