"""Division of the missing points into tasks: their order, and their number in a task."""

import random
import time
from collections import deque
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gapsweep.execution.plan import BLOCK, Block, Plan

# Short enough for progress and for the loss by a kill. The more points share the lanes, the less
# each costs: in a task of 16,384 a third of the cost in a task of 250.
_TASK_SECONDS = 4.0
# Client and scheduler take 200 to 400 tasks a second: twice the time, so that they keep up.
_CLIENT_SECONDS = 0.01
# A task has the time limit of one point: it aims at this part of it, since costs differ.
_PART_OF_TIMEOUT = 0.25
_RECENT_SECONDS = 60.0
_FEW = np.array([256, 16])  # points of each kind with a weight equal to the mean of other kinds
# Before any cost is known: a compiled kernel wants its lanes filled, scipy takes seconds a point.
_FIRST_BATCH = {"compiled": 16, "scipy": 1}
# A long sweep is computed in parts, so that a kill loses one part and not the whole sweep; parts
# are longer if few sweeps fill a task.
SWEEP_PART = 16

# Numbers of points in a block, ascending.
Rows = NDArray[np.intp]


def is_first_of_sweep(rows: Rows, follows: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mask of points that begin a sweep, or whose preceding point is not among `rows`."""
    is_next = np.diff(rows, prepend=-2) == 1
    return np.asarray(~(is_next & follows[rows]))


def cut(rows: Rows, follows: NDArray[np.bool_], room: int) -> tuple[Rows, Rows, Rows]:
    """Divide points: those of a task of size `room`, later points of their sweeps, and others."""
    is_first = is_first_of_sweep(rows, follows)
    sweep = np.cumsum(is_first) - 1
    firsts = np.flatnonzero(is_first)
    # The part of a sweep leaves room for the other direction, which is computed with it.
    part = max(SWEEP_PART, room // max(len(firsts), 2))
    is_late = np.arange(len(rows)) - firsts[sweep] >= part
    size = np.cumsum(np.bincount(sweep[~is_late]))
    n_sweeps = max(int(np.searchsorted(size, room, side="right")), 1)
    is_drawn = sweep < n_sweeps
    return rows[is_drawn & ~is_late], rows[is_drawn & is_late], rows[~is_drawn]


class Costs:
    """Mean CPU time of the points of each kind, as far as it has been measured.

    A kind is the number of a representation, and 1 for points of sweeps, which fill few lanes.
    """

    def __init__(self, engine: str, timeout: float, n_representations: int) -> None:
        self.unknown = _FIRST_BATCH[engine]
        self.aim = min(_TASK_SECONDS, _PART_OF_TIMEOUT * timeout)  # s for a task
        self.seconds, self.n_points = np.zeros((2, n_representations, 2))
        # Times at which recent tasks were completed, and CPU time [s] of all tasks until then.
        self.spent: deque[tuple[float, float]] = deque()

    def add(self, kind: tuple[int, int], n_points: int, seconds: float, spent: float) -> None:
        """Add the measured costs of a task; `spent` is its CPU time [s] including compilation."""
        if not self.n_points[kind[0]].any():  # until now workers compiled or waited
            self.spent.clear()
        now, before = time.monotonic(), self.spent[-1][1] if self.spent else 0.0
        self.spent.append((now, before + spent))
        while len(self.spent) > 2 and self.spent[1][0] < now - _RECENT_SECONDS:
            self.spent.popleft()
        self.seconds[kind] += seconds
        self.n_points[kind] += n_points

    def knows(self, kind: tuple[int, int]) -> bool:
        """Whether the cost of this kind has been measured."""
        return bool(self.n_points[kind])

    def seconds_left(self, n_left: NDArray[np.integer]) -> float | None:
        """Remaining time [s] of the points; None until every representation is compiled.

        Computed from costs and from the recent CPU time of tasks per second: the machine may be
        busy.

        `n_left`: shape (n_representations, 2); numbers of points by kind.
        """
        n_all = self.n_points.sum(axis=0)
        is_compiled = self.n_points.any(axis=1) | ~n_left.any(axis=1)
        if not (self.spent and is_compiled.all() and n_all[n_left.any(axis=0)].all()):
            return None
        (begin, before), (now, spent) = self.spent[0], self.spent[-1]
        if spent == before or now - begin < _TASK_SECONDS:
            return None
        # A kind with few measured points is taken to cost about as much as others.
        mean = self.seconds.sum(axis=0) / np.maximum(n_all, 1.0)
        cost = (self.seconds + _FEW * mean) / (self.n_points + _FEW)
        return float(np.sum(n_left * cost) * (now - begin) / (spent - before))

    def room(self, kind: tuple[int, int]) -> int:
        """Number of points of a kind that fill a task."""
        if not self.knows(kind):
            return self.unknown * (1 + kind[1])  # upward and downward sweeps, which go together
        return max(self._computed_in(self.aim, kind), 1)

    def least(self, kind: tuple[int, int], n_threads: int) -> int:
        """Number of points of a kind that a thread computes while the client serves all threads."""
        return self._computed_in(n_threads * _CLIENT_SECONDS, kind) if self.knows(kind) else 0

    def _computed_in(self, seconds: float, kind: tuple[int, int]) -> int:
        """Number of points that take some CPU time [s], of which a task has room."""
        cost = self.seconds[kind] / self.n_points[kind]
        return int(min(seconds / max(cost, 1e-9), BLOCK))


def shuffled(plan: Plan) -> Iterator[tuple[Block, Rows]]:
    """The missing points of blocks in random order; neighbours have similar costs.

    One block of each representation comes first, in the study's order, so that workers compile
    different kernels: mostly the exact law's and another one.
    """
    wanted = [i for i, (a, b) in enumerate(plan.ends.tolist()) if plan.is_missing[a:b].any()]
    random.shuffle(wanted)
    _, leading = np.unique(plan.representation(plan.ends[wanted, 0]), return_index=True)
    heads = []
    for block in (plan.block(wanted[i]) for i in leading.tolist()):
        head, tail = _halves(block)
        heads.append((block, head))
        yield block, tail
    while heads:
        block, head = heads.pop(0)
        if head.size:
            yield block, head
    for number in np.delete(wanted, leading).tolist():
        block = plan.block(number)
        yield from ((block, half) for half in _halves(block)[::-1] if half.size)


def _halves(block: Block) -> tuple[Rows, Rows]:
    """The missing points of a block, cut in two at a random sweep.

    Runs without common locks then do different work.
    """
    missing = np.flatnonzero(block.is_missing)
    at = random.choice(np.flatnonzero(is_first_of_sweep(missing, block.follows)))
    return missing[:at], missing[at:]
