"""Motions without a period that run round a torus: told from chaos and from slow settling."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gapsweep.response.section import norm, period_multiple
from gapsweep.response.walks import Walks

Array = NDArray[np.float64]
Numbers = NDArray[np.intp]

_STILL = 1e-8  # of the largest scatter: a component with less does not move
_REPEATS, _ROUNDING = 4, 1e-3
_STAYS = 1 << 10  # forcing periods; more than there are points of a window
_FARTHER = 1.1  # than the farthest ever
_MOST_POINTS = 1 << 20  # of sections kept at a time: with eight states, some tens of megabytes


def _strict(shortest: int, longest: int) -> dict[int, float]:
    """Over chaos means fall as the root of a window only, over a torus faster than any power."""
    return {n: n**-1.25 for n in (shortest << k for k in range((longest // shortest).bit_length()))}


# Windows in forcing periods, each twice the one before, and how much the means of their halves may
# differ as a share of the scatter: where growth is measured as zero, so that a drift is all that is
# left to exclude; where it has not told, near a locked motion; and where it was not measured long.
ZERO, LONG = {1 << k: 1e-3 for k in range(12, 17)}, _strict(1 << 13, 1 << 16)
SHORT = _strict(1 << 10, 1 << 13)


class Watched(NamedTuple):
    """What m motions that were watched turned out to be.

    Attributes
    ----------
    is_torus : ndarray of bool, shape (m,)
        Whether they run round a torus.
    is_locked : ndarray of bool, shape (m,)
        Whether they repeat themselves after however many periods.
    y : ndarray, shape (n_states, m)
        Where they are then.
    n_periods : ndarray of int, shape (m,)
        Forcing periods for which they were watched.
    """

    is_torus: NDArray[np.bool_]
    is_locked: NDArray[np.bool_]
    y: Array
    n_periods: NDArray[np.int64]


def watch(walks: Walks, points: Numbers, windows: dict[int, float], longest: Array) -> Watched:
    """Follow motions until they are seen to run round a torus.

    A torus shows in two windows in turn: chaos may look like one by chance, hardly twice.

    Parameters
    ----------
    walks : Walks
        Where they are; that is not changed.
    points : ndarray of int, shape (m,)
        Which of them.
    windows : dict of int to float
        Forcing periods of windows, which begin where the motions are, and how much means differ.
    longest : ndarray, shape (m,)
        Forcing periods for which each may be watched.
    """
    found = Watched(
        np.zeros(len(points), bool),
        np.zeros(len(points), bool),
        walks.y[:, points],
        np.zeros(len(points), np.int64),
    )
    at_a_time = max(1, _MOST_POINTS // max(windows))
    for first in range(0, len(points), at_a_time):
        some = np.arange(first, min(first + at_a_time, len(points)))
        _watch(found, some, walks, points, windows, longest)
    return found


def _watch(
    found: Watched,
    left: Numbers,
    walks: Walks,
    points: Numbers,
    windows: dict[int, float],
    longest: Array,
) -> None:
    """Watch some of the points together."""
    seemed, same, noise = np.zeros(len(points), bool), walks.same[points], walks.noise()[points]
    sections = dict.fromkeys(left.tolist(), np.empty((len(found.y), 0)))
    for length, allowed in windows.items():
        left = left[~(found.is_torus[left] | found.is_locked[left])]
        left = left[length <= longest[left]]
        if not left.size:
            break
        n = length - found.n_periods[left]
        call = walks.ensemble.call(points[left], found.y[:, left], n, np.zeros(len(left)))
        found.y[:, left], found.n_periods[left], left = call.y, length, left[call.is_ok]
        for k, i in zip(left.tolist(), np.flatnonzero(call.is_ok).tolist(), strict=True):
            new = call.section[:, call.period_ends[i] : call.period_ends[i + 1]]
            sections[k] = section = np.concatenate([sections[k], new], axis=1)
            found.is_locked[k] = _has_repeated(section, float(same[k]))
            seems = is_quasiperiodic(section, allowed, float(noise[k])) and not found.is_locked[k]
            found.is_torus[k] = seems and seemed[k]
            seemed[k] = seems


def stay(
    walks: Walks, points: Numbers, repeat: NDArray[np.bool_], longest: Array, largest: int
) -> NDArray[np.bool_]:
    """Which motions that repeat themselves, as `repeat` says, still do `_STAYS` periods on.

    A torus that comes near itself within the solver's noise creeps on, and is far away by then. Two
    states leave room for none. What may not be watched for so long is not known to stay.

    Parameters
    ----------
    walks, points, longest
        As of `watch`.
    repeat : ndarray of bool, shape (m,)
    largest : int
        Largest multiple of a forcing period that counts as one.
    """
    if len(walks.y) == 2:
        return repeat
    found = np.zeros(len(points), bool)
    some = np.flatnonzero(repeat & (longest >= _STAYS))
    if some.size:
        at, n = points[some], np.full(len(some), _STAYS)
        call, same = walks.ensemble.call(at, walks.y[:, at], n, np.zeros(len(at))), walks.same[at]
        for k in np.flatnonzero(call.is_ok).tolist():
            section = call.section[:, call.period_ends[k] : call.period_ends[k + 1]]
            found[some[k]] = period_multiple(section, float(same[k]), largest) > 0
    return found


def stay_within(walks: Walks, points: Numbers) -> NDArray[np.bool_]:
    """Which motions do not go farther and farther; forced ones do not.

    What grows without bound stretches disturbances too, and is no chaos. That goes farther than it
    ever was within `_STAYS` returns by chance, and hardly once more.
    """
    stays, swing, y = np.ones(len(points), bool), walks.ensemble.swing, walks.y[:, points]
    left = np.flatnonzero(stays & walks.ensemble.is_free)
    for n_returns in (_STAYS, 4 * _STAYS):
        if not left.size:
            break
        at, n = points[left], np.full(len(left), n_returns)
        before = swing[at]
        call = walks.ensemble.call(at, y[:, left], n, np.full(len(left), np.inf))
        farther, y[:, left] = swing[at] > _FARTHER * before, call.y
        stays[left] = call.is_ok & ~farther
        left = left[call.is_ok & farther]
    return stays


def _has_repeated(section: Array, same: float) -> bool:
    """Whether the last points of a section are those before: chaos may end while it is watched.

    Means are the same from then on, as they are over any orbit of more periods than are looked for.
    A torus may come as near to itself once, and is as many times as far away so many times later.
    """
    longest = section.shape[1] // (2 * _REPEATS)
    apart = norm(section[:, -longest - 1 : -1] - section[:, -1:])
    if apart.min() > same:
        return False
    n = int((apart <= same)[::-1].argmax()) + 1  # points ago
    last = section[:, -n:]
    once, later = (norm(last - section[:, -n - ago : -ago]).max() for ago in (n, _REPEATS * n))
    return bool(once <= same and later <= 2.0 * once + _ROUNDING * same)


def is_quasiperiodic(section: Array, allowed: float, noise: float) -> bool:
    """Whether a section without a period lies on a closed curve, or on a torus.

    There, means over time whose ends are faded out converge faster than any power of it, so that
    two halves have the same; over chaos they scatter as a sample does, and what creeps or shrinks
    has different ones. Das et al., Nonlinearity 30 (2017) 4111, doi 10.1088/1361-6544/aa84c2.

    Parameters
    ----------
    section : ndarray, shape (n_states, n_periods)
        Section points [m], some hundreds or more.
    allowed : float
        How much the two means may differ, as a share of the scatter.
    noise : float
        Scatter [m] that the solver's tolerances admit: of a component with less nothing is known.
    """
    half = section.shape[1] // 2
    weights = _faded(half)
    centred = section - section.mean(axis=1, keepdims=True)
    # Means tell what drifts, those of squares what shrinks.
    seen = np.concatenate([centred, np.square(centred)])
    means = [each @ weights / weights.sum() for each in (seen[:, :half], seen[:, -half:])]
    spread = seen.std(axis=1)
    # What hardly moves beside the others is rounding, or rattle of a smooth solver: a coordinate of
    # its own that repeats, or the squares of one that has two values in turn.
    scatter, of_squares = spread.reshape(2, -1)
    moves = scatter > max(_STILL * scatter.max(), noise)
    told = np.concatenate([moves, moves & (of_squares > _STILL * scatter.max() ** 2)])
    is_same = np.abs(means[0] - means[1]) <= allowed * spread
    return bool(told.any() and is_same[told].all())


def _faded(n: int) -> Array:
    """Weights of points whose ends are faded out, as smoothly as can be."""
    t = (np.arange(n) + 0.5) / n
    return np.asarray(np.exp(-1.0 / (t * (1.0 - t))))
