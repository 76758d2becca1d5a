"""Amplitude spectra of sampled motions, and the periods after which they repeat."""

import numpy as np

from gapsweep.analysis.dimensions import Array
from gapsweep.response.section import period_multiple, scaled, unit_of

N_PERIODS = 60  # forcing periods of a spectrum: 2² · 3 · 5
SAMPLES_PER_PERIOD = 256
# Section points closer than this share of the largest displacement count as one.
_SAME_POINT = 1e-4


def repetition(section: Array, reach: float, omega: float) -> int:
    """Forcing periods, at most n/2, after which a motion repeats; 0: none.

    `section`, shape (n, 2), holds displacement [m] and velocity [m/s] at period ends; `reach` is
    the largest displacement [m].
    """
    points = scaled(section, unit_of(omega))
    return period_multiple(points, _SAME_POINT * reach, len(section) // 2)


def spectrum(x: Array) -> Array:
    """Amplitudes of the bins 0 to n/2 of n equidistant samples, Hann window.

    A sinusoid on a bin has its amplitude there and half of it in the two adjacent bins; a mean its
    absolute value in bin 0.
    """
    n = x.size
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(n) / n)
    amplitude: Array = 2.0 * np.abs(np.fft.rfft(window * x)) / window.sum()
    amplitude[0] *= 0.5
    if n % 2 == 0:
        amplitude[-1] *= 0.5
    return amplitude
