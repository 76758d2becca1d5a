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
    is_missing : ndarray of bool, shape (n_points,)
        Which points are to be computed.
    shape : tuple of int
        Of the study's grid.
    """

    cells: NDArray[np.int64]
    keys: list[bytes]
    status: NDArray[np.int8]
    chain_starts: NDArray[np.int64]
    is_missing: NDArray[np.bool_]
    shape: tuple[int, ...]

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
    def n_damaged(self) -> int:
        """Stored points that fail their checksum; they count as missing."""
        return int(np.sum(self.status == DAMAGED))

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
        return np.unique(_chain_of(self.chain_starts)[self.is_missing])

    def piece(self, chain: int) -> Piece:
        """A chain from its first missing point on."""
        first, last = (int(n) for n in self.chain_starts[chain : chain + 2])
        return Piece(chain, first + int(np.argmax(self.is_missing[first:last])), last)


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
    starts = np.array(chain_starts)
    # What lies beyond a lost row of a sweep was computed when it was there, and still holds.
    missing = status < 0
    if retry_failed:
        missing |= _after(status > Status.OUT_OF_FIT_RANGE, starts)
    return Plan(np.array(cells, np.int64), keys, status, starts, missing, study.grid.shape)


def _after(failed: NDArray[np.bool_], starts: NDArray[np.int64]) -> NDArray[np.bool_]:
    """The failed points and all behind them in their chains, which may now start elsewhere."""
    so_far = np.append(0, np.cumsum(failed))
    before = so_far[starts[:-1]][_chain_of(starts)]
    return np.asarray(so_far[1:] > before)


def _chain_of(starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of each point's chain."""
    return np.repeat(np.arange(len(starts) - 1), np.diff(starts))
