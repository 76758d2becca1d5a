"""Test for quasiperiodic motions: weighted Birkhoff averages separate tori from chaos."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gapsweep.response.section import norm, period_multiple
from gapsweep.response.thresholds import PERSISTENCE
from gapsweep.response.windows import RecordedWindows

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Numbers = NDArray[np.intp]

_STILL = 1e-8  # of the largest scatter: a component with less does not move
_REPEATS, _ROUNDING = 4, 1e-3
MOST_POINTS = 1 << 20  # of sections kept at a time: with eight states, some tens of megabytes


class TorusTest(NamedTuple):
    """Result of the torus test of m motions."""

    is_torus: Mask  # shape (m,); whether the motion is on a torus
    is_locked: Mask  # shape (m,); whether the motion repeats after any number of periods
    y: Array  # shape (n_states, m); states at the end of the test
    n_periods: NDArray[np.int64]  # shape (m,); periods that the test took


def torus_test(
    motions: RecordedWindows, points: Numbers, windows: dict[int, float], longest: Array
) -> TorusTest:
    """Integrate motions until they are recognised as quasiperiodic, that is on a torus.

    A torus must be found in two successive windows: chaos may resemble it once by chance.

    `motions`: not changed.
    `points`: shape (m,); numbers of the motions to test.
    `windows`: periods of windows, which begin at the present states, and allowed difference of
    means.
    `longest`: shape (m,); largest number of periods to integrate.
    """
    is_torus, is_locked, seemed = np.zeros((3, len(points)), bool)
    y, n_periods = motions.y[:, points], np.zeros(len(points), np.int64)
    resolution, noise = motions.resolution(points), motions.noise(points)
    left, sections = np.arange(len(points)), [np.empty((len(y), 0))] * len(points)
    for length, allowed in windows.items():
        left = left[~(is_torus[left] | is_locked[left]) & (length <= longest[left])]
        if not left.size:
            break
        n = length - n_periods[left]
        call = motions.ensemble.call(points[left], y[:, left], n, np.zeros(len(left)))
        y[:, left], n_periods[left], left = call.y, length, left[call.is_ok]
        for k, i in zip(left.tolist(), np.flatnonzero(call.is_ok).tolist(), strict=True):
            new = call.section[:, call.period_ends[i] : call.period_ends[i + 1]]
            sections[k] = section = np.concatenate([sections[k], new], axis=1)
            is_locked[k] = _has_repeated(section, float(resolution[k]))
            seems = not is_locked[k] and is_quasiperiodic(section, allowed, float(noise[k]))
            is_torus[k], seemed[k] = seems and seemed[k], seems
    return TorusTest(is_torus, is_locked, y, n_periods)


def persists(
    motions: RecordedWindows, points: Numbers, repeat: Mask, longest: Array, largest: int
) -> Mask:
    """Whether motions that repeat themselves (`repeat`) still do so `PERSISTENCE` periods later.

    A torus that returns within the solver's noise drifts on, and is far away by then. There are no
    tori with two states. A motion that may not be integrated for so long does not persist.

    `motions`, `points` and `longest`: as in `torus_test`.
    `repeat`: shape (m,).
    `largest`: largest period multiple of the search.
    """
    if len(motions.y) == 2:
        return repeat
    found = repeat & (longest >= PERSISTENCE)
    at = points[found]
    if at.size:
        y, n = motions.y[:, at], np.full(len(at), PERSISTENCE)
        call = motions.ensemble.call(at, y, n, np.zeros(len(at)))
        ends = zip(call.period_ends, call.period_ends[1:], motions.resolution(at), strict=False)
        found[found] = call.is_ok & [
            period_multiple(call.section[:, first:last], float(resolution), largest) > 0
            for first, last, resolution in ends
        ]
    return found


def _has_repeated(section: Array, same: float) -> bool:
    """Whether the end of a section repeats earlier points: transient chaos may have ended.

    Means are then constant, as over an orbit of more periods than are searched. A torus may come as
    near to itself once, but its distance grows with each further repeat.
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

    Means over a torus, with weights that vanish at both ends, converge faster than any power of the
    time, so that those of both halves agree; over chaos they scatter as sample means do, and those
    of a drifting or decaying motion differ. Das et al., Nonlinearity 30 (2017) 4111, doi
    10.1088/1361-6544/aa84c2.

    `section`: shape (n_states, n_periods); section points [m], some hundreds or more.
    `allowed`: largest difference of the two means, as a share of the scatter.
    `noise`: scatter [m] due to the solver's tolerances; components with less are not used.
    """
    half = section.shape[1] // 2
    t = (np.arange(half) + 0.5) / half
    weights = np.exp(-1.0 / (t * (1.0 - t)))
    centred = section - section.mean(axis=1, keepdims=True)
    # Means show a drift, means of squares a decay.
    seen = np.concatenate([centred, np.square(centred)])
    means = [each @ weights / weights.sum() for each in (seen[:, :half], seen[:, -half:])]
    spread = seen.std(axis=1)
    # A component that hardly moves relative to the others is rounding, or noise of a smooth solver:
    # an uncoupled coordinate that repeats, or squares of one that alternates between two values.
    scatter, of_squares = spread.reshape(2, -1)
    moves = scatter > max(_STILL * scatter.max(), noise)
    used = np.concatenate([moves, moves & (of_squares > _STILL * scatter.max() ** 2)])
    is_same = np.abs(means[0] - means[1]) <= allowed * spread
    return bool(used.any() and is_same[used].all())
