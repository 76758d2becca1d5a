"""Periodic orbits by shooting, their Floquet multipliers, and Lyapunov exponents.

The tangent equations carry the monodromy matrix along with the motion. The contact force is
continuous, so nothing jumps at a contact. Two facts hold for all forces that depend on places
alone and check all of it: the product of the multipliers over n periods T is ``exp(-r n T)``, and
the Lyapunov exponents add up to ``-r``; r is ``2 ζ ω_n`` for an oscillator, for a system
``tr(M⁻¹C) - tr H``.

`Shots` and `Growths` are columns, a row per point. Both go on by calls with the tangent.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.response.call import Call
from gapsweep.response.ensemble import Ensemble
from gapsweep.response.maps import floquet_multipliers, newton_steps
from gapsweep.response.section import largest_parts, norm
from gapsweep.status import Status

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Mask = NDArray[np.bool_]
Numbers = NDArray[np.intp]

_MAX_NEWTON = 6
# What is stretched by more than this on its way is taken to be near no orbit that attracts it, as
# most shots of chaotic motions. Nearer to one that does, it is shot again.
_STRETCHES = 2.0
# Newton's steps that shorten no more than this are the solver's noise, if they are as short as this
# beside how far they may lead.
_SHORTENS, _HARDLY = 0.5, 0.05
# A part of an orbit closes so much better than the parts are alike, or as well as the whole; no
# better than rounding lets it, as a share of the largest component.
_MUCH_BETTER, _AS_WELL, _ROUNDING = 0.1, 5.0, 1e-10
# Least that an orbit takes from a disturbance, so that noise does not pass for one about a rest.
_TAKES = 1e-3

# Lyapunov exponent: the mean of batches, each of about so many decay times at least: what one of
# them finds says nothing of the next one. There are ten batches of six parts at first; as the parts
# become longer, more batches of fewer parts. A block in front aligns the vector.
_BATCH, _PARTS, _N_PARTS = 2.82, 6, 60
_AT_ONCE = 512  # blocks of one motion in a call
_MOST_NUMBERS = 1 << 16  # of tangents in one call: with what else belongs to them, ten megabytes
# A first growth lasts at least this share of the time that a motion had to find a period.
_SHARE = 0.25
# A growth that decides nothing is doubled until it lasts so many times as long as the first, for a
# third of its error, and so many forcing periods, in which chaos outgrows linear growth.
_LONGER, _LONG = 8, 8192


class Shots:
    """Newton on the map over n forcing periods, from a state near the orbit.

    Attributes
    ----------
    y : ndarray, shape (n_states, n_points)
        The states: of an orbit where one is found.
    n : ndarray of int, shape (n_points,)
        Forcing periods of the orbits.
    multipliers : ndarray of complex, shape (n_points, n_states)
        Floquet multipliers over n periods of an orbit that was found, largest modulus first.
    n_multipliers : int
        How many of them there are; what the map of a section has beyond is zero.
    omega : ndarray, shape (n_points,)
        Section points per second [Hz] on an orbit that was found.
    section : list of ndarray, shape (n_states, n)
        Section points [m] of an orbit that was found.
    last_step : ndarray, shape (n_points,)
        Length of the last Newton step [m].
    """

    def __init__(self, n_states: int, n_points: int, n_multipliers: int) -> None:
        self.y, self.n_multipliers = np.empty((n_states, n_points)), n_multipliers
        self.n = np.zeros(n_points, np.int64)
        self.multipliers = np.empty((n_points, n_states), complex)
        self.omega = np.full(n_points, np.nan)
        self.section = [np.empty((n_states, 0))] * n_points
        self._moved, self._tries = np.zeros_like(self.y), np.zeros(n_points, np.int64)
        self.last_step, self._apart = np.zeros((2, n_points))  # _apart: distance of the ends
        self._goal, self._noise, self._furthest = np.zeros((3, n_points))
        # By point: an orbit that was found, while part of its period is tried.
        self._whole: dict[int, tuple[Any, ...]] = {}

    def aim(
        self, points: Numbers, y: Array, n: Counts, goal: Array, noise: Array, furthest: Array
    ) -> None:
        """Begin near states.

        Parameters
        ----------
        points : ndarray of int, shape (m,)
        y : ndarray, shape (n_states, m)
        n : ndarray of int, shape (m,)
        goal : ndarray, shape (m,)
            Distance [m] from the orbit at which it is found.
        noise : ndarray, shape (m,)
            How far apart [m] the solver's noise may keep an orbit's ends, where it lets no step be
            as short.
        furthest : ndarray, shape (m,)
            Distance [m] from `y` beyond which it is given up.
        """
        self.y[:, points], self.n[points] = y, n
        self._goal[points], self._noise[points], self._furthest[points] = goal, noise, furthest
        self._moved[:, points], self._tries[points] = 0.0, 0
        self.last_step[points] = self._apart[points] = np.inf
        for k in points.tolist():
            self._whole.pop(k, None)

    def shorten(self, points: Numbers, n: Counts, *, is_scattered: bool) -> None:
        """Begin again at orbits that were found, over fewer forcing periods.

        The shorter orbit must close much better than the parts of the whole one are alike, or as
        well as that one closed: predicted noise may hide a doubled period. If it does not, the
        whole is the orbit (`restore`). A solver that scatters sections shows nothing of this.
        """
        kept = [] if is_scattered else zip(points.tolist(), n.tolist(), strict=True)
        for k, part in kept:
            of_point = self.y[:, k].copy(), self.n[k], self.multipliers[k].copy(), self.omega[k]
            self._whole[k] = *of_point, self.section[k]
            unlike = np.abs(self.section[k] - np.roll(self.section[k], part, axis=1)).max()
            least = _ROUNDING * np.abs(self.section[k]).max()
            self._goal[k] = min(self._goal[k], max(_MUCH_BETTER * unlike, least))
            self._noise[k] = _AS_WELL * self._apart[k]
        self.n[points], self._tries[points] = n, 0
        self.last_step[points] = self._apart[points] = np.inf

    def restore(self, points: Numbers) -> Mask:
        """Return to the whole orbits of shots over parts of their periods; which those are."""
        is_part = np.array([k in self._whole for k in points.tolist()], bool)
        for k in points[is_part].tolist():
            self.y[:, k], self.n[k], self.multipliers[k], self.omega[k], self.section[k] = (
                self._whole.pop(k)
            )
        return is_part

    def advance(self, ensemble: Ensemble, points: Numbers) -> tuple[Mask, Mask]:
        """Shoot once more; returns as `step`."""
        y, n = self.y[:, points], self.n[points]
        return self.step(points, ensemble.call(points, y, n, np.zeros(len(n)), tangent=True))

    def parts(self, points: Numbers, tolerance: Array) -> Counts:
        """Forcing periods of the largest parts after which orbits repeat; of the whole if none do.

        Parameters
        ----------
        points : ndarray of int, shape (m,)
            Whose orbit is found.
        tolerance : ndarray, shape (m,)
            Distances [m] within which two of its section points are the same.
        """
        found = self.n[points]
        for n in np.unique(found[found > 1]).tolist():
            here = found == n
            orbits = np.stack([self.section[point] for point in points[here].tolist()], axis=1)
            found[here] = largest_parts(orbits, tolerance[here])
        return found

    def step(self, points: Numbers, call: Call) -> tuple[Mask, Mask]:
        """One step of Newton's method from what a call found.

        Parameters
        ----------
        points : ndarray of int, shape (m,)
            Whose motions the call holds, in this order.

        Returns
        -------
        is_found, is_lost : ndarray of bool, shape (m,)
            Whose orbit is closed; who went too far, did not converge, or failed.
        """
        y, is_ok = self.y[:, points], call.is_ok
        goal = self._goal[points]
        with np.errstate(over="ignore", invalid="ignore"):  # of motions that failed
            missed = (call.y - y) / call.unit
            step = newton_steps(call.monodromy, missed.T).T
            length = norm(step)
            # Ends that meet are not enough: weakly contracting, the orbit is much farther away.
            apart = norm(missed)
            is_near = apart <= np.maximum(goal, self._noise[points])
            shortens = length < _SHORTENS * self.last_step[points]
            shortens |= apart < _SHORTENS * self._apart[points]
            is_at_best = is_near & ~shortens & (length <= _HARDLY * self._furthest[points])
            is_found = is_ok & call.is_sound & ((length <= goal) | is_at_best)
            multipliers = floquet_multipliers(call.monodromy, call.determinant)
            modulus = np.abs(multipliers[:, 0])
            # About a rest, Newton's orbits shrink until they close within the noise.
            is_rest = call.swing <= self._noise[points] / np.maximum(1.0 - modulus, _TAKES)
            is_rest &= np.isfinite(goal)  # of an orbit as it is, Newton moves nothing
            is_found &= ~is_rest
            self._keep(points, np.flatnonzero(is_found), multipliers, call)
            self._tries[points] += 1
            self.last_step[points], self._apart[points] = length, apart
            moved = self._moved[:, points] + step
            goes_on = is_ok & ~is_found & ~is_rest & (modulus <= _STRETCHES)
            goes_on &= norm(moved) <= self._furthest[points]
            goes_on &= self._tries[points] < _MAX_NEWTON
        left = points[goes_on]
        self._moved[:, left] = moved[:, goes_on]
        self.y[:, left] = (y + step * call.unit)[:, goes_on]
        return is_found, ~is_found & ~goes_on

    def _keep(self, points: Numbers, found: Numbers, multipliers: Any, call: Call) -> None:
        if not found.size:
            return
        points = points[found]
        self.multipliers[points], self.omega[points] = multipliers[found], call.omega[found]
        first, last = call.period_ends[found], call.period_ends[found + 1]
        for point, i, j in zip(points.tolist(), first.tolist(), last.tolist(), strict=True):
            self.section[point] = call.section[:, i:j]


class Growths:
    """How one tangent vector grows along each motion, block by block.

    Attributes
    ----------
    y : ndarray, shape (n_states, n_points)
        Where the motions are.
    n_periods : ndarray of int, shape (n_points,)
        Forcing periods in a motion's blocks; 0 if a growth was never begun.
    n_blocks : ndarray of int, shape (n_points,)
        Blocks behind it, since the growth was begun or doubled.
    strayed : ndarray, shape (n_points,)
        How far [m] the solver strayed in a block: root of the mean square.
    n_least : int
        Blocks that a growth has at least.
    """

    n_least = 1 + _N_PARTS

    def __init__(self, n_states: int, n_points: int) -> None:
        self.y = np.empty((n_states, n_points))
        self.n_periods, self.n_blocks, self._goal = np.zeros((3, n_points), np.int64)
        self._in_part, self._first = np.ones((2, n_points), np.int64)  # blocks, now and at first
        self._direction, self.strayed = np.empty((n_points, n_states)), np.zeros(n_points)
        # Of the block in front, then of every part: logarithm of the growth, and duration [s].
        self._growth, self._time = np.zeros((2, n_points, self.n_least))

    def begin(
        self, points: Numbers, y: Array, rate: Array, omega: Array, longest: NDArray[Any]
    ) -> None:
        """Begin at states.

        Parameters
        ----------
        points : ndarray of int, shape (m,)
        y : ndarray, shape (n_states, m)
        rate : ndarray, shape (m,)
            Settling rate [1/s], > 0.
        omega : ndarray, shape (m,)
            Forcing frequency [Hz].
        longest : ndarray, shape (m,)
            Forcing periods that the motion had to find a period: all blocks have no more, about.
        """
        # No coordinate may be left out: another one's growth may never reach it.
        start = np.linspace(1.0, 0.0, len(y))
        self.y[:, points], self._direction[points], self.n_blocks[points] = y, start, 0
        self._growth[points], self._time[points] = 0.0, 0.0
        wanted = np.minimum(_BATCH / _PARTS / rate * omega, longest / self.n_least)
        self.n_periods[points] = n_periods = np.maximum(1, np.ceil(wanted))
        in_part = np.maximum(1, _SHARE * longest // (n_periods * self.n_least))
        self._in_part[points] = self._first[points] = in_part
        self._goal[points] = 1 + _N_PARTS * self._in_part[points]

    def double(self, points: Numbers, y: Array) -> None:
        """Go on for as long as growths have lasted, after a block that aligns the vector again."""
        half = _N_PARTS // 2
        for each in (self._growth, self._time):
            each[points, 1 + half :] = each[points, 1::2] + each[points, 2::2]
            each[points, : 1 + half] = 0.0
        self.y[:, points], self.n_blocks[points] = y, 0
        self._in_part[points] *= 2
        self._goal[points] = 1 + half * self._in_part[points]

    def n_all_periods(self, points: Numbers) -> Counts:
        """How many forcing periods growths last; one if never begun."""
        n_blocks = 1 + _N_PARTS * self._in_part[points]
        return np.asarray(np.maximum(n_blocks * self.n_periods[points], 1))

    def is_long(self, points: Numbers) -> Mask:
        """Which growths are no longer doubled for a decision."""
        grew = self._in_part[points] >= _LONGER * self._first[points]
        return np.asarray(grew & (self.n_all_periods(points) >= _LONG))

    def advance(self, ensemble: Ensemble, points: Numbers) -> tuple[Numbers, Counts]:
        """Go on with some of the points; who is then over, and as what, as in `step`."""
        n = 1
        if ensemble.is_chained:
            # Where a chain is cut may not depend on its company.
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
        """The next blocks from what a call found.

        Parameters
        ----------
        points : ndarray of int, shape (m,)
            Whose motions the call holds, in this order.
        n : int
            How many blocks of each, one after the other.

        Returns
        -------
        is_over : ndarray of bool, shape (m,)
            Who has all blocks, or failed.
        status : ndarray of int, shape (m,)
            `Status` values; a block that failed does not count.
        """
        m = len(points)
        is_ok = call.is_ok.reshape(m, n)
        counts = np.logical_and.accumulate(is_ok, axis=1).sum(axis=1)  # blocks before a failure
        ends = np.arange(m) * n + np.minimum(counts, n - 1)
        status, self.y[:, points] = call.status[ends], call.y[:, ends]
        counted = np.arange(n) < counts[:, None]
        with np.errstate(all="ignore"):  # of tangents that overflowed
            lengths, self._direction[points] = _stretched(
                call.monodromy.reshape(m, n, *call.monodromy.shape[1:]),
                self._direction[points],
                counted,
            )
            lengths[~call.is_sound.reshape(m, n)] = np.nan
            strayed = np.where(counted, call.strayed.reshape(m, n), 0.0)
        row, block = np.nonzero(counted)
        # numpy's own logarithm is another one on another processor.
        logs = [math.log(each) if each else -math.inf for each in lengths[row, block].tolist()]
        now = points[row]
        part = (self.n_blocks[now] + block - 1) // self._in_part[now] + 1  # the block in front: 0
        np.add.at(self._growth, (now, part), logs)
        np.add.at(self._time, (now, part), self.n_periods[now] / call.omega[row * n + block])
        before = self.n_blocks[points]
        self.n_blocks[points] += counts
        squares = before * self.strayed[points] ** 2 + np.square(strayed).sum(axis=1)
        self.strayed[points] = np.sqrt(squares / np.maximum(before + counts, 1))
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
        """Section points per second [Hz] while growths that have all blocks lasted."""
        return np.asarray(self.n_all_periods(points) / self._time[points].sum(axis=1))

    def shear(self, points: Numbers, omega: Array) -> Array:
        """Exponents [1/s] of what grows in proportion to time, as neighbours on a torus part.

        Parameters
        ----------
        points : ndarray of int, shape (m,)
            That have all blocks.
        omega : ndarray, shape (m,)
            Forcing frequency [Hz].
        """
        n_periods = self.n_all_periods(points)
        # numpy's own logarithm is another one on another processor.
        return np.fromiter(map(math.log, n_periods.tolist()), float) * omega / n_periods

    def scatter(self, point: int, omega: float, exponent: float) -> float:
        """Distance [m] of two points of a motion that its solver rattles: root of the mean square.

        What it strays in each block adds up in random directions, and shrinks with the exponent
        [1/s], < 0.
        """
        shrinks = 2.0 * exponent * int(self.n_periods[point]) / omega
        return math.sqrt(2.0 / -math.expm1(shrinks)) * float(self.strayed[point])


def _batch_means(growth: Array, time: Array) -> tuple[Array, Array]:
    """Mean rates of growth and their standard errors, of batches along the second axis."""
    with np.errstate(invalid="ignore"):  # of vectors that shrank to nothing, or overflowed
        # Returns take longer or shorter: a mean of rates would count the short ones too much.
        exponent = growth.sum(axis=1) / time.sum(axis=1)
        share = time / time.mean(axis=1)[:, None]
        apart = (growth / time - exponent[:, None]) * share
        error = np.sqrt(np.square(apart).mean(axis=1) / (growth.shape[1] - 1))
    return exponent, error


def _stretched(tangents: Array, directions: Array, counted: Mask) -> tuple[Array, Array]:
    """How much each of so many tangents stretches what the one before it left of a direction.

    Parameters
    ----------
    tangents : ndarray, shape (m, n, n_states, n_states)
    directions : ndarray, shape (m, n_states)
    counted : ndarray of bool, shape (m, n)
        Others leave the direction; their lengths are not read.

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
