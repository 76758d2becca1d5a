"""Where the points of a sweep start: from the last point before them that has an end."""

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import StoreError
from gapsweep.store.cache import Cache
from gapsweep.study.points import KEY


def origins(
    keys: NDArray[np.void],
    is_first: NDArray[np.bool_],
    has_end: NDArray[np.bool_],
    before: NDArray[np.void],
) -> NDArray[np.void]:
    """Keys of the points at whose ends points start that stand sweep after sweep; zero at rest.

    `is_first` says which begin a sweep or a part of one, `has_end` which have an end (`Responses`);
    `before` holds the origins of the first ones.
    """
    numbers = np.arange(len(keys))
    first = np.maximum.accumulate(np.where(is_first, numbers, 0))
    last = np.maximum.accumulate(np.append(-1, np.where(has_end, numbers, -1)))[:-1]
    found = keys[last]
    at_first = last < first
    found[at_first] = before[np.cumsum(is_first) - 1][at_first]
    return found


def start_of(
    cache: Cache, previous: NDArray[np.void], n_states: int
) -> tuple[NDArray[np.float64], NDArray[np.void]]:
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
                f"{cache.path}: the preceding point of a sweep is no longer stored; run "
                "again to resume"
            )
        _, contents, row = place
        response = contents.responses.take([row])
        if response.has_end.all():
            return response.ends[0], previous
        previous = contents.previous[[row]]
    return np.zeros(n_states), previous
