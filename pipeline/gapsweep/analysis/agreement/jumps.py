"""Jumps of the amplitude along frequency, and their shifts from the exact law's jumps (A5).

A jump lies between neighbouring frequencies of one initial condition (a sweep up or down, or a
fixed state): its frequency is known to half a frequency step.
"""

from dataclasses import dataclass

import numpy as np

from gapsweep.analysis.agreement.law_tables import LawTable
from gapsweep.analysis.agreement.matching import matches_on_line
from gapsweep.analysis.dimensions import Array, Ints

# A jump is at least this share of the larger amplitude (or of half the gap) ...
JUMP = 0.02
# ... and this many times the adjacent steps, so that a steep flank is not a jump.
STEEPER = 3.0
# Largest distance [Hz] of two jumps that match.
WINDOW = 1.0


@dataclass(frozen=True, slots=True)
class Jumps:
    """The jumps along one curve."""

    at: Ints  # position of the frequency below each jump
    omega: Array  # middle of the two frequencies [Hz]
    step: Array  # change of the amplitude [m]


def jumps(table: LawTable, start: int, along: Ints, half_gap: float) -> Jumps:
    """Jumps of amplitude between periodic responses at neighbouring frequencies of `along`."""
    amplitude = np.where(table.periodic, table.amplitude, np.nan)[along, start]
    steps = np.diff(amplitude)
    size = np.abs(steps)
    scale = np.maximum(np.maximum(amplitude[1:], amplitude[:-1]), half_gap)
    padded = np.pad(np.nan_to_num(size), 1)
    adjacent = np.maximum(padded[:-2], padded[2:])
    # Comparisons with NaN are false: no jump next to a response that is not periodic.
    chosen = np.flatnonzero((size >= JUMP * scale) & (size > STEEPER * adjacent))
    below, above = along[chosen], along[chosen + 1]
    return Jumps(below, 0.5 * (table.omega[below] + table.omega[above]), steps[chosen])


def breaks(curve: Array) -> Ints:
    """Positions in a curve before which a plotted line is broken, so that it joins no branches.

    The rule is that of `jumps`, except that the neighbours of a step may be near either of its
    ends: a branch may have a single value.
    """
    if len(curve) < 3:  # a single step has no measure
        return np.empty(0, int)
    padded = np.concatenate([curve[:1], curve, curve[-1:]])
    before, here, there, after = (padded[i : len(padded) - 3 + i] for i in range(4))
    size, scale = np.abs(there - here), np.maximum(np.abs(here), np.abs(there))
    sides = (np.fmin(np.abs(side - here), np.abs(side - there)) for side in (before, after))
    near = np.maximum(*sides)
    near[[0, -1]] = size[[1, -2]]  # at the ends the only neighbour
    return np.flatnonzero((size >= JUMP * scale) & (size > STEEPER * near)) + 1


def shifts(ours: Jumps, theirs: Jumps) -> Array:
    """Shift [Hz] of the jump that matches each of `theirs`, in direction and within `WINDOW`;
    NaN without a match.
    """
    shift = np.full(len(theirs.omega), np.nan)
    for is_up in (True, False):
        a, b = (np.flatnonzero((one.step > 0.0) == is_up) for one in (ours, theirs))
        i, j = matches_on_line(ours.omega[a], theirs.omega[b], WINDOW)
        shift[b[j]] = ours.omega[a[i]] - theirs.omega[b[j]]
    return shift


def jump_shifts(ours: LawTable, theirs: LawTable, half_gap: float) -> Array:
    """Shifts [Hz] at the exact jumps, shape (n_omega, n_starts); NaN elsewhere."""
    shift = np.full(ours.requested.shape, np.nan)
    common = ours.requested & theirs.requested
    for start in np.flatnonzero(common.any(axis=0)).tolist():
        along = np.flatnonzero(common[:, start])
        own, exact = (jumps(table, start, along, half_gap) for table in (ours, theirs))
        shift[exact.at, start] = shifts(own, exact)
    return shift
