"""Motions without a period that run round a torus: told from chaos and from slow settling."""

import numpy as np
from numpy.typing import NDArray

from gapsweep.response.section import period_multiple
from gapsweep.response.walks import Walks

Array = NDArray[np.float64]

# Faded means of two halves differ by less than this share of the scatter, over the number of
# points: those over chaos fall as its root only, those over a torus faster than any power.
_SAME_MEAN = 1.0
_STILL = 1e-8  # of the largest scatter: a component with less does not move
_MOST_POINTS = 1 << 19  # of sections in one call: with what else belongs to them, tens of megabytes


def rotations(walks: Walks, points: NDArray[np.intp], n_periods: int, largest: int) -> Array:
    """Rotation numbers of motions on tori; NaN of others.

    Parameters
    ----------
    walks : Walks
        Where they are; that is not changed.
    points : ndarray of int, shape (m,)
        Which of them.
    n_periods : int
        Forcing periods for which each is watched.
    largest : int
        Largest multiple of a forcing period that counts as one.

    Returns
    -------
    ndarray, shape (m,)
    """
    found, same = np.full(len(points), np.nan), walks.same[points]
    at_a_time = max(1, _MOST_POINTS // n_periods)
    for first in range(0, len(points), at_a_time):
        some = points[first : first + at_a_time]
        n = np.full(len(some), n_periods)
        call = walks.ensemble.call(some, walks.y[:, some], n, np.zeros(len(some)))
        for k in np.flatnonzero(call.is_ok).tolist():
            section = call.section[:, call.period_ends[k] : call.period_ends[k + 1]]
            # Chaos that ends in a period while it is watched has the same means from then on.
            last = section[:, -2 * largest :]
            has_ended = period_multiple(last, float(same[first + k]), largest) > 0
            if is_quasiperiodic(section) and not has_ended:
                found[first + k] = rotation_number(section)
    return found


def is_quasiperiodic(section: Array) -> bool:
    """Whether a section without a period lies on a closed curve, or on a torus.

    There, means over time whose ends are faded out converge faster than any power of it, so that
    two halves have the same; over chaos they scatter as a sample does, and what creeps or shrinks
    has different ones. Das et al., Nonlinearity 30 (2017) 4111, doi 10.1088/1361-6544/aa84c2.

    Parameters
    ----------
    section : ndarray, shape (n_states, n_periods)
        Section points [m], some hundreds or more.
    """
    half = section.shape[1] // 2
    t = (np.arange(half) + 0.5) / half
    weights = np.exp(-1.0 / (t * (1.0 - t)))
    centred = section - section.mean(axis=1, keepdims=True)
    # Means tell what drifts, those of squares what shrinks.
    seen = np.concatenate([centred, np.square(centred)])
    means = [each @ weights / weights.sum() for each in (seen[:, :half], seen[:, -half:])]
    spread = seen.std(axis=1)
    # What hardly moves beside the others, as a coordinate of its own that repeats, is rounding.
    scatter = centred.std(axis=1)
    moves = np.tile(scatter > _STILL * scatter.max(), 2)
    allowed = _SAME_MEAN / section.shape[1] * spread
    return bool((np.abs(means[0] - means[1]) <= allowed)[moves].all())


def rotation_number(section: Array) -> float:
    """How many turns a motion makes about its torus from one section point to the next.

    The strongest line in the spectrum of the section, in the plane in which it scatters most, its
    ends faded out (Laskar, Physica D 67 (1993) 257, doi 10.1016/0167-2789(93)90210-R). A section
    cannot tell a turn more, nor in which sense, so that it is within 0..1/2.

    Parameters
    ----------
    section : ndarray, shape (n_states, n_periods)
        Section points [m] on a closed curve, some hundreds or more.
    """
    from scipy.optimize import minimize_scalar  # tenths of a second to import, and few are on tori

    centred = section - section.mean(axis=1, keepdims=True)
    _, directions = np.linalg.eigh(centred @ centred.T)
    first, second = directions[:, -1] @ centred, directions[:, -2] @ centred
    n = section.shape[1]
    t = (np.arange(n) + 0.5) / n
    faded = np.exp(-1.0 / (t * (1.0 - t))) * (first + 1j * second)
    spectrum = np.abs(np.fft.fft(faded))
    near = float(np.fft.fftfreq(n)[spectrum.argmax()])

    def weakness(frequency: float) -> float:
        return -float(abs(np.vdot(np.exp(2j * np.pi * frequency * np.arange(n)), faded)))

    found = minimize_scalar(weakness, (near - 1.0 / n, near, near + 1.0 / n), tol=1e-10)
    return float(abs((found.x + 0.5) % 1.0 - 0.5))
