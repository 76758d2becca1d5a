"""The plan of a run: all sweep points of a study, and which of them must be computed."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gapsweep.execution.progress import Progress
from gapsweep.execution.sweeps import origins
from gapsweep.status import Status
from gapsweep.store.cache import Cache
from gapsweep.store.index import MISSING
from gapsweep.study.grid import Selection
from gapsweep.study.points import KEY
from gapsweep.study.study import Study

# Points in memory at a time while keys are computed.
_PART = 65_536


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """All sweep points of a study, in the order of computation, with their status in the cache.

    Attributes
    ----------
    cells : ndarray of int, shape (n_points,)
        Flat position of each point in the study's grid.
    follows : ndarray of bool, shape (n_points,)
        Whether a point of a sweep starts from the end state of the point before it.
    keys : ndarray of void, shape (n_points,)
        Content keys.
    status : ndarray of int8, shape (n_points,)
        Stored status, or `MISSING`.
    is_missing : ndarray of bool, shape (n_points,)
        Whether a point must be computed.
    shape : tuple of int
        Shape of the study's grid.
    """

    cells: NDArray[np.int64]
    follows: NDArray[np.bool_]
    keys: NDArray[np.void]
    status: NDArray[np.int8]
    is_missing: NDArray[np.bool_]
    shape: tuple[int, ...]

    def __repr__(self) -> str:
        counts = f"{self.n_hits} in the cache, {self.n_missing} missing, {self.n_failed} failed"
        return f"<Plan: {self.n_points} sweep points, {counts}>"

    @property
    def n_points(self) -> int:
        return len(self.keys)

    @property
    def n_missing(self) -> int:
        return int(self.is_missing.sum())

    @property
    def n_hits(self) -> int:
        return self.n_points - self.n_missing

    @property
    def n_failed(self) -> int:
        """Number of stored points without a result."""
        return int(np.sum(self.status > Status.OUT_OF_FIT_RANGE))

    @property
    def progress(self) -> Progress:
        """Counts before the computation; cached failures that are not retried count as failed."""
        n_failed = int(np.sum(~self.is_missing & (self.status > Status.OUT_OF_FIT_RANGE)))
        return Progress(self.n_points, self.n_hits, n_failed=n_failed)

    def representation(self, points: NDArray[np.intp]) -> NDArray[np.int64]:
        """Position of the representation of some points in the study."""
        return self.cells[points] // int(np.prod(self.shape[1:]))

    def previous(self, points: NDArray[np.intp]) -> NDArray[np.void]:
        """Keys of the preceding points in sweeps; zero for points that follow none."""
        found = self.keys[points - 1]
        found[~self.follows[points]] = np.zeros(1, KEY)
        return found


def plan(
    study: Study,
    cache: Cache | None = None,
    *,
    selection: Selection | None = None,
    retry_failed: bool = False,
) -> Plan:
    """Compare a study with the cache.

    Parameters
    ----------
    study : Study
    cache : Cache, optional
        None if there is no cache yet.
    selection : Selection, optional
        Part of the study; all if None. The points of a sweep before a selected point are
        included.
    retry_failed : bool
        Whether stored failures count as missing.
    """
    grid = study.grid
    wanted = grid.requested
    if selection is not None:
        selected = np.zeros(grid.shape, bool)
        selected[np.ix_(*selection)] = True
        wanted = wanted & selected
    cells, follows = grid.order(wanted)
    keys = np.empty(len(cells), KEY)
    for part in _parts(follows):
        for rows, points in study.points(cells[part]):
            keys[part.start + rows] = points.keys(follows[part][rows])
    status = np.full(len(keys), MISSING, np.int8) if cache is None else cache.status(keys)
    # Stored points after a lost point of a sweep stay valid: they were computed from its result.
    # Points that started from another state, since an earlier point had failed, are recomputed.
    missing = status < 0
    if cache is not None:
        missing |= _after(_started_elsewhere(cache, keys, status, follows), follows)
    if retry_failed:
        missing |= _after(status > Status.OUT_OF_FIT_RANGE, follows)
    return Plan(cells, follows, keys, status, missing, grid.shape)


def _parts(follows: NDArray[np.bool_]) -> Iterator[slice]:
    """Slices of the points, each of whole sweeps."""
    starts = np.flatnonzero(~follows)
    at = np.unique(np.searchsorted(starts, range(0, len(follows), _PART)))
    firsts = [*starts[at[at < len(starts)]].tolist(), len(follows)]
    yield from map(slice, firsts[:-1], firsts[1:])


def _started_elsewhere(
    cache: Cache, keys: NDArray[np.void], status: NDArray[np.int8], follows: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Mask of stored points that started from another point than they would now."""
    rows = np.flatnonzero(follows | np.append(follows[1:], False))
    is_first = ~follows[rows]
    started, has_end = cache.origins(keys[rows])
    expected = origins(keys[rows], is_first, has_end, np.zeros(is_first.sum(), KEY))
    found = np.zeros(len(keys), bool)
    found[rows] = (started != expected) & (status[rows] >= 0)
    return found


def _after(failed: NDArray[np.bool_], follows: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mask of the failed points and of all later points of their sweeps."""
    so_far = np.append(0, np.cumsum(failed))
    first = np.maximum.accumulate(np.where(follows, 0, np.arange(len(follows))))
    return np.asarray(so_far[1:] > so_far[first])
