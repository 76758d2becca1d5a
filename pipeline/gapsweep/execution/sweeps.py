"""Where a sweep goes on whose first part is stored."""

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import StoreError
from gapsweep.execution.task import States
from gapsweep.store.cache import Cache
from gapsweep.study.points import KEY


def start_of(
    cache: Cache, previous: NDArray[np.void], n_states: int
) -> tuple[States, NDArray[np.void]]:
    """Where a sweep that has come to the point of a key goes on, and the key of whose end that is.

    At rest, a state of `n_states` zeros, and zero, if it has not begun.

    Raises
    ------
    StoreError
        If that point is not stored.
    """
    while previous != np.zeros(1, KEY):
        place = cache.place(previous)
        if place is None:
            raise StoreError(
                f"{cache.path}: the point from which a sweep goes on is no longer stored: run "
                "again to resume"
            )
        _, contents, row = place
        (end,) = contents.responses.take([row]).ends
        if np.isfinite(end).all():
            return end, previous
        previous = contents.previous[[row]]
    return np.zeros(n_states), previous
