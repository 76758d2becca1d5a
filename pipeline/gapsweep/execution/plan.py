"""Plan of a run: the points to compute."""

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

# Points whose numbers are in memory at a time.
_PART = 65_536


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Every sweep point of a study, in the order of computation, and what the cache holds of it.

    Attributes
    ----------
    cells : ndarray of int, shape (n_points,)
        Flat position of each point in the study's grid.
    follows : ndarray of bool, shape (n_points,)
        Which points of sweeps start where the one before them ends.
    keys : ndarray of void, shape (n_points,)
        Content keys.
    status : ndarray of int8, shape (n_points,)
        Stored status, or `MISSING`.
    is_missing : ndarray of bool, shape (n_points,)
        Which points are to be computed.
    shape : tuple of int
        Of the study's grid.
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
        """Stored points without a result."""
        return int(np.sum(self.status > Status.OUT_OF_FIT_RANGE))

    @property
    def progress(self) -> Progress:
        """Counts before anything is computed; stored failures that are hits count as failed."""
        n_failed = int(np.sum(~self.is_missing & (self.status > Status.OUT_OF_FIT_RANGE)))
        return Progress(self.n_points, self.n_hits, n_failed=n_failed)

    def representation(self, points: NDArray[np.intp]) -> NDArray[np.int64]:
        """Number of the representation of some points."""
        return self.cells[points] // int(np.prod(self.shape[1:]))

    def previous(self, points: NDArray[np.intp]) -> NDArray[np.void]:
        """Keys of the points that some points start from; zero where there is none."""
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
        Nothing is stored if None.
    selection : Selection, optional
        Part of the study that is wanted; all if None. Points of a sweep that lead to a
        selected one are wanted too.
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
    # What lies beyond a lost row of a sweep was computed when it was there, and still holds. But
    # what started elsewhere, since a point before it had failed that has a result now, does not.
    missing = status < 0
    if cache is not None:
        missing |= _after(_started_elsewhere(cache, keys, status, follows), follows)
    if retry_failed:
        missing |= _after(status > Status.OUT_OF_FIT_RANGE, follows)
    return Plan(cells, follows, keys, status, missing, grid.shape)


def _parts(follows: NDArray[np.bool_]) -> Iterator[slice]:
    """Parts of all points, each of some whole sweeps."""
    starts = np.flatnonzero(~follows)
    at = np.unique(np.searchsorted(starts, range(0, len(follows), _PART)))
    firsts = [*starts[at[at < len(starts)]].tolist(), len(follows)]
    yield from map(slice, firsts[:-1], firsts[1:])


def _started_elsewhere(
    cache: Cache, keys: NDArray[np.void], status: NDArray[np.int8], follows: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Stored points whose start would be another one now."""
    rows = np.flatnonzero(follows | np.append(follows[1:], False))
    is_first = ~follows[rows]
    started, has_end = cache.origins(keys[rows])
    expected = origins(keys[rows], is_first, has_end, np.zeros(is_first.sum(), KEY))
    found = np.zeros(len(keys), bool)
    found[rows] = (started != expected) & (status[rows] >= 0)
    return found


def _after(failed: NDArray[np.bool_], follows: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The failed points and all behind them in their sweeps, which may now start elsewhere."""
    so_far = np.append(0, np.cumsum(failed))
    first = np.maximum.accumulate(np.where(follows, 0, np.arange(len(follows))))
    return np.asarray(so_far[1:] > so_far[first])
