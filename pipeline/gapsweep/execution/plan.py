"""The plan of a run: all sweep points of a study, and which of them must be computed.

A plan holds seven bytes for every cell of the grid: its status, and where its result is stored.
Cells and keys of points are made block by block where they are needed, so that memory does not
grow with them.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import prod

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.execution.progress import Progress
from gapsweep.execution.sweeps import origins
from gapsweep.status import Status
from gapsweep.store.cache import Cache
from gapsweep.store.index import MISSING, PLACE, Held
from gapsweep.study.grid import Selection
from gapsweep.study.points import KEY, Points
from gapsweep.study.study import Study

# Sweep points in a block, and at most in a task: keys of as many are in memory at a time.
BLOCK = 16384
_UNIT = 256  # numbers that no block cuts
# A point takes about as many bytes in the cache and in files of the run together.
BYTES = 1000
ABSENT = -2  # status of a cell of the grid that is no point of the plan


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Neighbouring points of a plan: of one representation, with whole sweeps."""

    # Shape (n,); their numbers in the order of computation (see `Grid.cells`), ascending.
    numbers: NDArray[np.int64]
    cells: NDArray[np.int64]  # shape (n,); flat positions in the study's grid
    representation: int  # position of their representation in the study
    # `is_swept`, `follows`: shape (n,); whether a point is of a sweep, and whether it starts from
    # the end of the point before it.
    is_swept: NDArray[np.bool_]
    follows: NDArray[np.bool_]
    # Points of one kind each, with their numbers in the block, as of `Study.points`.
    tables: list[tuple[NDArray[np.intp], Points]]
    keys: NDArray[np.void]  # shape (n,); content keys
    status: NDArray[np.int8]  # shape (n,); stored status, or `MISSING`
    is_missing: NDArray[np.bool_]  # shape (n,); whether a point must be computed

    def points(self, rows: NDArray[np.intp]) -> Iterator[tuple[NDArray[np.intp], Points]]:
        """Some points, of one kind each, with their positions in `rows`, which ascend."""
        for whole, points in self.tables:
            here = np.flatnonzero(np.isin(rows, whole, assume_unique=True))
            if here.size:
                yield here, points.take(np.searchsorted(whole, rows[here]))

    def previous(self, rows: NDArray[np.intp]) -> NDArray[np.void]:
        """Keys of the preceding points in sweeps; zero for points that follow none."""
        found = self.keys[rows - 1]
        found[~self.follows[rows]] = np.zeros(1, KEY)
        return found


@dataclass(eq=False)
class Plan:
    """All sweep points of a study, in the order of computation, with their status in the cache.

    Attributes
    ----------
    study : Study
    cache : Cache, optional
        Cache of the results; None if there is none yet.
    status : ndarray of int8, shape (n_cells,)
        Stored status of the point of each number, `MISSING`, or `ABSENT` without a point.
    is_missing : ndarray of bool, shape (n_cells,)
        Whether a point must be computed.
    ends : ndarray of int, shape (n_blocks, 2)
        First number of each block, and the number behind its last one.
    places : ndarray of PLACE, shape (n_cells,)
        Where the results are stored in the cache; slab -1 without a result.

    A run sets the cache, if there was none, and enters status and places of the results that it
    stores.
    """

    study: Study
    cache: Cache | None
    status: NDArray[np.int8]
    is_missing: NDArray[np.bool_]
    ends: NDArray[np.int64]
    places: NDArray[np.void]

    def __repr__(self) -> str:
        counts = f"{self.n_hits} in the cache, {self.n_missing} missing, {self.n_failed} failed"
        return f"<Plan: {self.n_points} sweep points, {counts}>"

    @cached_property
    def n_points(self) -> int:
        return int(np.count_nonzero(self.status != ABSENT))

    @property
    def n_missing(self) -> int:
        return int(np.count_nonzero(self.is_missing))

    @property
    def n_hits(self) -> int:
        return self.n_points - self.n_missing

    @property
    def n_failed(self) -> int:
        """Number of stored points without a result."""
        return int(np.count_nonzero(self.status > Status.OUT_OF_FIT_RANGE))

    @property
    def progress(self) -> Progress:
        """Counts before the computation; cached failures that are not retried count as failed."""
        is_failed = self.status > Status.OUT_OF_FIT_RANGE
        n_failed = int(np.count_nonzero(is_failed & ~self.is_missing))
        return Progress(self.n_points, self.n_hits, n_failed=n_failed)

    @property
    def n_left(self) -> NDArray[np.int64]:
        """Numbers of missing points by representation, without and in sweeps, shape (n, 2)."""
        grid, of_starts = self.study.grid, np.zeros((len(self.study.grid.representations), 2), int)
        kind = (grid.starts.kind > 0).astype(int)
        for r, missing in enumerate(np.split(self.is_missing, len(of_starts))):
            counts = missing.reshape(-1, len(kind), grid.n_omega).sum(axis=(0, 2))
            of_starts[r] = np.bincount(kind, counts, minlength=2)
        return of_starts

    @property
    def mark(self) -> bytes:
        """Bytes that are equal for equal studies, from which claims on points are made."""
        first = self.block(0).keys.tobytes() if len(self.ends) else b""
        return repr(self.study.grid.shape).encode() + first

    def representation(self, numbers: ArrayLike) -> NDArray[np.int64]:
        """Position in the study of the representation of points."""
        return np.asarray(numbers) // prod(self.study.grid.shape[1:])

    def block(self, number: int) -> Block:
        """One block of the plan."""
        first, last = self.ends[number].tolist()
        status, grid = self.status[first:last], self.study.grid
        here = np.flatnonzero(status != ABSENT)
        numbers = first + here
        cells = grid.cells(numbers)
        chain = numbers // grid.n_omega
        is_swept = grid.starts.kind[chain % len(grid.starts)] > 0
        follows = np.zeros(len(numbers), bool)
        follows[1:] = is_swept[1:] & (chain[1:] == chain[:-1])
        keys = np.empty(len(numbers), KEY)
        tables = self.study.points(cells)
        for rows, points in tables:
            keys[rows] = points.keys(follows[rows] if is_swept.any() else None)
        about = cells, int(self.representation(first)), is_swept, follows, tables, keys
        return Block(numbers, *about, status[here], self.is_missing[first:last][here])

    def blocks(self) -> Iterator[Block]:
        """All blocks, one after the other."""
        yield from map(self.block, range(len(self.ends)))

    def enter(self, numbers: NDArray[np.int64], held: Held) -> None:
        """Set status and places of points, which then are no longer missing."""
        self.is_missing[numbers] = False
        self.status[numbers] = held["status"]
        self.places[numbers] = held[list(PLACE.names or ())]

    def digest(self) -> str:
        """Digest of the places of all points in the grid and of their stored results."""
        assert self.cache is not None, "where the results are stored"
        found = hashlib.sha256()
        for first, last in self.ends.tolist():
            for part in self.cache.checksums(self.places[first:last]):
                found.update(part)
        return found.hexdigest()


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
    chosen = grid.order(wanted)
    status = np.where(chosen, np.int8(MISSING), np.int8(ABSENT))
    places = np.full(len(status), np.array((-1, 0), PLACE))
    made = Plan(study, cache, status, chosen, _ends(chosen, study), places)
    if cache is None:
        # Keys are not needed, but user code that fails shall do so now.
        for number in range(len(made.ends) if study.names_code else min(len(made.ends), 1)):
            made.block(number)
        return made
    for block in made.blocks():
        held = cache.held(block.keys)
        made.enter(block.numbers, held)
        # Stored points after a lost point of a sweep stay valid: they were computed from its
        # result. Those that started from another state, since an earlier point had failed, are
        # recomputed.
        missing = held["status"] < 0
        missing |= _after(_started_elsewhere(cache, block, held["status"]), block.follows)
        if retry_failed:
            missing |= _after(held["status"] > Status.OUT_OF_FIT_RANGE, block.follows)
        made.is_missing[block.numbers] = missing
    return made


def _ends(chosen: NDArray[np.bool_], study: Study) -> NDArray[np.int64]:
    """First numbers of blocks of about `BLOCK` points, and the numbers behind their last ones."""
    n_omega, n_rows = study.grid.n_omega, prod(study.grid.shape[1:])
    unit = -(-_UNIT // n_omega) * n_omega if study.grid.starts.kind.any() else _UNIT
    found: list[NDArray[np.int64]] = []
    for r in range(study.grid.shape[0]):
        of_units = np.arange(0, n_rows, unit)
        here = chosen[r * n_rows : (r + 1) * n_rows]
        so_far = np.cumsum(np.add.reduceat(here, of_units, dtype=np.int64))
        is_first = np.diff((so_far - 1) // BLOCK, prepend=-1) > 0
        firsts = np.append(of_units[is_first], n_rows) + r * n_rows
        found.append(np.stack([firsts[:-1], firsts[1:]], axis=1))
    return np.concatenate(found)


def _started_elsewhere(cache: Cache, block: Block, status: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Mask of stored points that started from another point than they would now."""
    found = np.zeros(len(block.keys), bool)
    rows = np.flatnonzero(block.follows | np.append(block.follows[1:], False))
    if rows.size:
        is_first, keys = ~block.follows[rows], block.keys[rows]
        started, has_end = cache.origins(keys)
        expected = origins(keys, is_first, has_end, np.zeros(is_first.sum(), KEY))
        found[rows] = (started != expected) & (status[rows] >= 0)
    return found


def _after(failed: NDArray[np.bool_], follows: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mask of the failed points and of all later points of their sweeps."""
    so_far = np.append(0, np.cumsum(failed))
    first = np.maximum.accumulate(np.where(follows, 0, np.arange(len(follows))))
    return np.asarray(so_far[1:] > so_far[first])
