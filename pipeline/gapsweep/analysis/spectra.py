"""Amplitude spectra of sampled motions."""

import numpy as np

from gapsweep.analysis.dimensions import Array

N_PERIODS = 60  # forcing periods of a spectrum: 2² · 3 · 5
SAMPLES_PER_PERIOD = 256


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
