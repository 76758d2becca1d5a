"""Lyapunov exponents by the growth of one tangent vector along each motion, in batch means.

The exponents of a motion add up to ``-r``, as the multipliers of an orbit do
(`gapsweep.response.shooting`). A measurement has ten batches of six parts at first; as the parts
become longer, more batches of fewer parts. A block in front aligns the vector with the direction of
growth.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.response import thresholds as limit
from gapsweep.response.ensemble import Ensemble
from gapsweep.response.section import norm
from gapsweep.response.window_call import Call
from gapsweep.status import Status

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Mask = NDArray[np.bool_]
Numbers = NDArray[np.intp]

_PARTS, _N_PARTS = 6, 60  # of a batch at first, and of all
_AT_ONCE = 512  # blocks of one motion in a call
_MOST_NUMBERS = 1 << 16  # of tangents in one call: ten megabytes with all other arrays


class LyapunovExponents:
    """Growth of one tangent vector along each motion, block by block.

    Attributes
    ----------
    y : ndarray, shape (n_states, n_points)
        Present states of the motions.
    n_periods : ndarray of int, shape (n_points,)
        Forcing periods in a motion's blocks; 0 if no measurement was started.
    n_blocks : ndarray of int, shape (n_points,)
        Blocks done since the measurement was started or extended.
    n_least : int
        Blocks of the shortest measurement.
    """

    n_least = 1 + _N_PARTS

    def __init__(self, n_states: int, n_points: int) -> None:
        self.y = np.empty((n_states, n_points))
        self.n_periods, self.n_blocks, self._goal = np.zeros((3, n_points), np.int64)
        self._in_part, self._first = np.ones((2, n_points), np.int64)  # blocks, now and at first
        self._direction = np.empty((n_points, n_states))
        # Logarithm of the growth and duration [s] of the aligning block, then of every part.
        self._growth, self._time = np.zeros((2, n_points, self.n_least))

    def start(
        self, points: Numbers, y: Array, rate: Array, omega: Array, longest: NDArray[Any]
    ) -> None:
        """Start measurements at states.

        `points`: shape (m,).
        `y`: shape (n_states, m).
        `rate`: shape (m,); settling rate [1/s], > 0.
        `omega`: shape (m,); forcing frequency [Hz].
        `longest`: shape (m,); forcing periods of the search for a period: about the most that all
        blocks last.
        """
        # Every coordinate has a component: growth of one may never reach another one.
        start = np.linspace(1.0, 0.0, len(y))
        self.y[:, points], self._direction[points], self.n_blocks[points] = y, start, 0
        self._growth[points], self._time[points] = 0.0, 0.0
        wanted = np.minimum(limit.BATCH / _PARTS / rate * omega, longest / self.n_least)
        self.n_periods[points] = n_periods = np.maximum(1, np.ceil(wanted))
        in_part = np.maximum(1, limit.EXPONENT_SHARE * longest // (n_periods * self.n_least))
        self._in_part[points] = self._first[points] = in_part
        self._goal[points] = 1 + _N_PARTS * self._in_part[points]

    def extend(self, points: Numbers, y: Array) -> None:
        """Double measurements: as many blocks again, after one that realigns the tangent vector."""
        half = _N_PARTS // 2
        for each in (self._growth, self._time):
            each[points, 1 + half :] = each[points, 1::2] + each[points, 2::2]
            each[points, : 1 + half] = 0.0
        self.y[:, points], self.n_blocks[points] = y, 0
        self._in_part[points] *= 2
        self._goal[points] = 1 + half * self._in_part[points]

    def n_all_periods(self, points: Numbers) -> Counts:
        """Return the periods that measurements last; 1 if none was started."""
        n_blocks = 1 + _N_PARTS * self._in_part[points]
        return np.asarray(np.maximum(n_blocks * self.n_periods[points], 1))

    def is_long(self, points: Numbers) -> Mask:
        """Whether measurements are so long that they are not doubled for a decision."""
        grew = self._in_part[points] >= limit.LONGEST_EXPONENT * self._first[points]
        return np.asarray(grew & (self.n_all_periods(points) >= limit.EXPONENT_PERIODS))

    def advance(self, ensemble: Ensemble, points: Numbers) -> tuple[Numbers, Counts]:
        """Integrate the next blocks of some points; return points that ended, and their status."""
        n = 1
        if ensemble.is_chained:
            # The length of a chain of blocks may not depend on other points.
            left = np.minimum(self._goal - self.n_blocks, _AT_ONCE)[points]
            n, points = int(left[0]), points[left == left[0]]
            points = points[: max(1, _MOST_NUMBERS // (n * len(self.y) ** 2))]
        blocks = np.repeat(points, n)
        follows = np.append(False, blocks[1:] == blocks[:-1])
        call = ensemble.call(
            blocks, self.y[:, blocks], self.n_periods[blocks], np.full(len(blocks), math.inf),
            tangent=True, follows=follows if n > 1 else None,
        )  # fmt: skip
        is_over, status = self.step(points, n, call)
        return points[is_over], status[is_over]

    def step(self, points: Numbers, n: int, call: Call) -> tuple[Mask, Counts]:
        """Add the growth of the next blocks, from the motions of a call.

        Parameters
        ----------
        points : ndarray of int, shape (m,)
            Points of the motions of the call, in this order.
        n : int
            Number of blocks of each, one after the other.

        Returns
        -------
        is_over : ndarray of bool, shape (m,)
            Whether a point has all blocks, or failed.
        status : ndarray of int, shape (m,)
            `Status` values; a block that failed does not count.
        """
        m = len(points)
        is_ok = call.is_ok.reshape(m, n)
        counts = np.logical_and.accumulate(is_ok, axis=1).sum(axis=1)  # blocks before a failure
        ends = np.arange(m) * n + np.minimum(counts, n - 1)
        status, self.y[:, points] = call.status[ends], call.y[:, ends]
        counted = np.arange(n) < counts[:, None]
        with np.errstate(all="ignore"):  # for tangents that overflowed
            lengths, self._direction[points] = _stretched(
                call.monodromy.reshape(m, n, *call.monodromy.shape[1:]),
                self._direction[points],
                counted,
            )
            lengths[~call.is_sound.reshape(m, n)] = np.nan
        row, block = np.nonzero(counted)
        # numpy's logarithm differs between processors.
        logs = [math.log(each) if each else -math.inf for each in lengths[row, block].tolist()]
        now = points[row]
        part = (self.n_blocks[now] + block - 1) // self._in_part[now] + 1  # the block in front: 0
        np.add.at(self._growth, (now, part), logs)
        np.add.at(self._time, (now, part), self.n_periods[now] / call.omega[row * n + block])
        self.n_blocks[points] += counts
        return (status != Status.OK) | (self.n_blocks[points] == self._goal[points]), status

    def exponents(self, points: Numbers) -> tuple[Array, Array]:
        """Largest Lyapunov exponents [1/s] of motions that have all blocks; standard errors.

        The errors are those of batch means. NaN where the tangent was unsound.
        """
        exponent, error = np.empty((2, len(points)))
        # The first block turns the vector into the direction of growth.
        growth, time = (each[points, 1:] for each in (self._growth, self._time))
        parts = -(-_PARTS // self._in_part[points])  # of a batch: 6, 3, 2 or 1
        for n in np.unique(parts).tolist():
            some = parts == n
            batches = (
                each[some].reshape(-1, _N_PARTS // n, n).sum(axis=2) for each in (growth, time)
            )
            exponent[some], error[some] = _batch_means(*batches)
        return exponent, error

    def omega(self, points: Numbers) -> Array:
        """Return the mean rate of section points [Hz] over measurements that have all blocks."""
        return np.asarray(self.n_all_periods(points) / self._time[points].sum(axis=1))

    def linear_growth(self, points: Numbers, omega: Array) -> Array:
        """Apparent exponents [1/s] of linear growth, with which neighbours on a torus separate.

        `points`: shape (m,); points that have all blocks.
        `omega`: shape (m,); forcing frequency [Hz].
        """
        n_periods = self.n_all_periods(points)
        # numpy's logarithm differs between processors.
        return np.fromiter(map(math.log, n_periods.tolist()), float) * omega / n_periods


def _batch_means(growth: Array, time: Array) -> tuple[Array, Array]:
    """Mean rates of growth and their standard errors, of batches along the second axis."""
    with np.errstate(invalid="ignore"):  # for vectors that shrank to zero, or overflowed
        # Returns take longer or shorter: a mean of rates would count the short ones too much.
        exponent = growth.sum(axis=1) / time.sum(axis=1)
        share = time / time.mean(axis=1)[:, None]
        apart = (growth / time - exponent[:, None]) * share
        error = np.sqrt(np.square(apart).mean(axis=1) / (growth.shape[1] - 1))
    return exponent, error


def _stretched(tangents: Array, directions: Array, counted: Mask) -> tuple[Array, Array]:
    """Apply n tangents in succession to a direction; return growth factors and last directions.

    Parameters
    ----------
    tangents : ndarray, shape (m, n, n_states, n_states)
    directions : ndarray, shape (m, n_states)
    counted : ndarray of bool, shape (m, n)
        Tangents that are applied; others leave the direction, with length NaN.

    Returns
    -------
    lengths : ndarray, shape (m, n)
    directions : ndarray, shape (m, n_states)
    """
    lengths = np.full(counted.shape, np.nan)
    for block in range(counted.shape[1]):
        turned = np.matmul(tangents[:, block], directions[:, :, None])[:, :, 0]
        length = norm(turned.T)
        here = counted[:, block]
        lengths[here, block] = length[here]
        directions = np.where(here[:, None], turned / length[:, None], directions)
    return lengths, directions
