"""Where the response jumps or changes its class along frequency, and how far off that is (A5).

Found between neighbouring frequencies of one start (a sweep up or down, or a fixed state), so
known to half the frequency step either way.
"""

from dataclasses import dataclass

import numpy as np

from gapsweep.analysis.arrays import Array, Ints
from gapsweep.analysis.classes import NONE, UNRESOLVED
from gapsweep.analysis.matching import matches_on_line
from gapsweep.analysis.slab import Slab

# A jump is at least this share of the larger amplitude (or of half the gap) ...
JUMP = 0.02
# ... and this many times the steps next to it, so that a steep flank is none.
STEEPER = 3.0
# Farther apart [Hz] than this, two jumps or changes are not the same.
WINDOW = 1.0


@dataclass(frozen=True, slots=True)
class Events:
    """Jumps or changes along one curve.

    Attributes
    ----------
    at : ndarray of int
        Position of the frequency below each.
    omega : ndarray
        Middle of the two frequencies [Hz].
    kind : ndarray of int
        Only events of one kind are matched: jumps up or down, changes from one class to another.
    size : ndarray
        Of a jump, in amplitude [m].
    """

    at: Ints
    omega: Array
    kind: Ints
    size: Array


def jumps(slab: Slab, start: int, along: Ints, half_gap: float) -> Events:
    """Jumps in amplitude between periodic responses at neighbours of the frequencies `along`."""
    amplitude = np.where(slab.periodic, slab.amplitude, np.nan)[along, start]
    steps = np.diff(amplitude)
    size = np.abs(steps)
    scale = np.maximum(np.maximum(amplitude[1:], amplitude[:-1]), half_gap)
    padded = np.pad(np.nan_to_num(size), 1)
    beside = np.maximum(padded[:-2], padded[2:])
    # Comparisons with NaN are false: no jump next to a response that is not periodic.
    chosen = np.flatnonzero((size >= JUMP * scale) & (size > STEEPER * beside))
    return _events(slab, along, chosen, np.sign(steps[chosen]).astype(np.int64), size[chosen])


def breaks(curve: Array) -> Ints:
    """Positions in a curve before which a line is broken, as no line joins two branches.

    As of `jumps`, but a step's neighbours may lie near either end: one value may be on a branch.
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


def changes(slab: Slab, start: int, along: Ints) -> Events:
    """Changes of class or period multiple; to or from unresolved and failed is none."""
    numbers = slab.class_number[along, start]
    known = np.where(numbers < UNRESOLVED, numbers, NONE)
    before, after = known[:-1], known[1:]
    chosen = np.flatnonzero((before != after) & (before != NONE) & (after != NONE))
    kind = before[chosen] * UNRESOLVED + after[chosen]
    return _events(slab, along, chosen, kind, np.zeros(len(chosen)))


def _events(slab: Slab, along: Ints, chosen: Ints, kind: Ints, size: Array) -> Events:
    below, above = along[chosen], along[chosen + 1]
    return Events(below, 0.5 * (slab.omega[below] + slab.omega[above]), kind, size)


def shifts(ours: Events, theirs: Events) -> Array:
    """Shift [Hz] of the match of each of `theirs`, NaN where it has none within `WINDOW`."""
    shift = np.full(len(theirs.omega), np.nan)
    for kind in np.unique(theirs.kind):
        a, b = np.flatnonzero(ours.kind == kind), np.flatnonzero(theirs.kind == kind)
        i, j = matches_on_line(ours.omega[a], theirs.omega[b], WINDOW)
        shift[b[j]] = ours.omega[a[i]] - theirs.omega[b[j]]
    return shift


def largest_jump(events: Events) -> float:
    """Frequency of the largest jump [Hz], NaN if there is none."""
    return float(events.omega[np.argmax(events.size)]) if len(events.size) else float("nan")


def curve_metrics(
    ours: Slab, theirs: Slab, half_gap: float
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Shifts at the exact jumps and changes, and what there is to count on every curve.

    Returns
    -------
    points : dict of str to ndarray, shape (n_omega, n_starts)
    curves : dict of str to ndarray, shape (n_starts,)
    """
    shape = ours.requested.shape
    points = {name: np.full(shape, np.nan) for name in ("jump_shift", "change_shift")}
    counts = {name: np.zeros(shape[1]) for name in ("n_jumps", "n_changes")}
    largest = np.full((2, shape[1]), np.nan)
    common = ours.requested & theirs.requested
    for start in np.flatnonzero(common.any(axis=0)).tolist():
        along = np.flatnonzero(common[:, start])
        both = [jumps(slab, start, along, half_gap) for slab in (ours, theirs)]
        largest[:, start] = [largest_jump(events) for events in both]
        for name, (a, b) in (
            ("jump", both),
            ("change", [changes(slab, start, along) for slab in (ours, theirs)]),
        ):
            points[f"{name}_shift"][b.at, start] = shifts(a, b)
            counts[f"n_{name}s"][start] = len(a.omega)
    curves = {"largest_jump": largest[0], "largest_jump_shift": largest[0] - largest[1], **counts}
    return points, curves
