"""What a run has to do: decided here, without doing any of it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gapsweep.model import own_law
from gapsweep.status import Status
from gapsweep.store.cache import DAMAGED, MISSING
from gapsweep.study.study import Index, Selection, Study

# Stored status of each of the given keys, or `MISSING`, or `DAMAGED`.
Look = Callable[[list[bytes]], NDArray[np.int8]]


@dataclass(frozen=True, slots=True)
class Piece:
    """Consecutive points of one chain, by their numbers in the plan."""

    chain: int
    first: int
    last: int  # one past the last point

    def __len__(self) -> int:
        return self.last - self.first


@dataclass(frozen=True, slots=True)
class Plan:
    """Every sweep point of a study, in the order of its chains, and what the cache holds of it.

    A chain is what must be computed in order: all frequencies of a sweep, else one point.
    Arrays and not objects per point, because a study may have millions.

    Attributes
    ----------
    cells : ndarray of int, shape (n_points,)
        Flat position of each point in the study's grid.
    keys : list of bytes, length n_points
    status : ndarray of int8, shape (n_points,)
        Stored status, `MISSING` or `DAMAGED`.
    chain_starts : ndarray of int, shape (n_chains + 1,)
        Number of each chain's first point, and the end.
    n_done : ndarray of int, shape (n_chains,)
        How many of a chain's first points need no computation.
    shape : tuple of int
        Of the study's grid.
    """

    cells: NDArray[np.int64]
    keys: list[bytes]
    status: NDArray[np.int8]
    chain_starts: NDArray[np.int64]
    n_done: NDArray[np.int64]
    shape: tuple[int, ...]

    @property
    def n_points(self) -> int:
        return len(self.keys)

    @property
    def n_missing(self) -> int:
        return self.n_points - self.n_hits

    @property
    def n_hits(self) -> int:
        return int(self.n_done.sum())

    @property
    def n_failed(self) -> int:
        """Stored points without a result."""
        return int(np.sum(self.status > Status.OUT_OF_FIT_RANGE))

    @property
    def n_damaged(self) -> int:
        """Stored points that fail their checksum; they count as missing."""
        return int(np.sum(self.status == DAMAGED))

    @property
    def is_missing(self) -> NDArray[np.bool_]:
        """Which points are to be computed."""
        ends = self.chain_starts[:-1] + self.n_done
        chain = np.repeat(np.arange(len(ends)), np.diff(self.chain_starts))
        return np.asarray(np.arange(self.n_points) >= ends[chain])

    def index(self, point: int) -> Index:
        """Position of a point in the study's grid."""
        rest, at = int(self.cells[point]), []
        for size in reversed(self.shape):
            rest, i = divmod(rest, size)
            at.append(i)
        i, w, g, k, r = at
        return r, k, g, w, i

    def unfinished(self) -> NDArray[np.int64]:
        """Numbers of the chains that are not done."""
        return np.flatnonzero(self.n_done < np.diff(self.chain_starts))

    def piece(self, chain: int) -> Piece:
        """What is left of a chain."""
        first = self.chain_starts[chain] + self.n_done[chain]
        return Piece(chain, int(first), int(self.chain_starts[chain + 1]))


def nothing_stored(keys: list[bytes]) -> NDArray[np.int8]:
    """Stored status where there is no cache."""
    return np.full(len(keys), MISSING, np.int8)


def plan(
    study: Study,
    look: Look = nothing_stored,
    *,
    selection: Selection | None = None,
    retry_failed: bool = False,
) -> Plan:
    """Compare a study with the cache.

    Parameters
    ----------
    study : Study
    look : callable
        What is stored of the given keys.
    selection : Selection, optional
        Part of the study that is wanted; all if None. Points of a sweep that lead to a
        selected one are wanted too.
    retry_failed : bool
        Whether stored failures count as missing.
    """
    own_law.refresh()
    cells: list[int] = []
    keys: list[bytes] = []
    chain_starts = [0]
    for chain in study.chains(selection):
        keys += study.keys(chain)
        cells += (study.grid.flat(index) for index in chain)
        chain_starts.append(len(keys))
    status = look(keys)
    done = status >= 0
    if retry_failed:
        done &= status <= Status.OUT_OF_FIT_RANGE
    starts = np.array(chain_starts)
    return Plan(
        np.array(cells, np.int64), keys, status, starts, _n_done(done, starts), study.grid.shape
    )


def _n_done(done: NDArray[np.bool_], starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Per chain, how many points are done before the first that is not.

    What follows a missing point of a sweep starts elsewhere: its key says so too.
    """
    undone = np.append(np.flatnonzero(~done), len(done))
    first_undone = undone[np.searchsorted(undone, starts[:-1])]
    return np.asarray(np.minimum(first_undone, starts[1:]) - starts[:-1])
