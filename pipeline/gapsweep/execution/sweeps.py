"""Initial states of sweep points: the end state of the last earlier point that has one."""

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
    """Keys of the points from whose end state each point starts; zero for rest.

    The points are in order, sweep after sweep. `is_first` marks the first point of a sweep or of a
    part of one, `has_end` points with an end state; `before` holds the origins of first points.
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
    """State from which a sweep continues after the point `previous`, and the key of its origin.

    The origin is the last point up to `previous` that has an end state. Without one, the state is
    rest (`n_states` zeros) and the key zero. Raises `StoreError` if a point of the sweep is not
    stored.
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
