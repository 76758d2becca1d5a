"""What an engine returns."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Sampler = Callable[[Array], tuple[Array, Array]]

SCALARS = ("t", "x", "v", "status", "n_contacts", "n_steps", "n_rejected", "nfev")


@dataclass(frozen=True, slots=True)
class Events:
    """What was recorded of one motion.

    Attributes
    ----------
    t_extrema, extrema : ndarray, shape (n,)
        Times [s] and displacements [m] of all zero-velocity points after the start.
    t_contacts : ndarray, shape (n,)
        Times [s] at which the displacement crossed a wall, in or out.
    section : ndarray, shape (n, 2)
        Stroboscopic section: ``(x, v)`` at every whole forcing period after the start.
    """

    t_extrema: Array = field(default_factory=lambda: np.empty(0))
    extrema: Array = field(default_factory=lambda: np.empty(0))
    t_contacts: Array = field(default_factory=lambda: np.empty(0))
    section: Array = field(default_factory=lambda: np.empty((0, 2)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Motions:
    """The solutions of `Problems`, in their order.

    Attributes
    ----------
    t, x, v : ndarray, shape (n,)
        Time [s] and state [m], [m/s] reached: at ``t_end`` unless the motion failed.
    status : ndarray of int, shape (n,)
        `gapsweep.status.Status` values.
    n_contacts, n_steps, n_rejected, nfev : ndarray of int, shape (n,)
        Wall crossings in and out, accepted and rejected steps, right-hand sides (for a Taylor
        method, expansions).
    events : callable
        Events of one motion, by its number; empty where nothing was recorded.
    sampler : callable
        Function of time that gives ``(x, v)`` of one motion, by its number.
    monodromy : ndarray, shape (n, 2, 2), or None
        Derivative of the end state by the initial state.
    """

    t: Array
    x: Array
    v: Array
    status: Counts
    n_contacts: Counts
    n_steps: Counts
    n_rejected: Counts
    nfev: Counts
    events: Callable[[int], Events]
    sampler: Callable[[int], Sampler]
    monodromy: Array | None = None


def merged(n: int, parts: Sequence[tuple[Sequence[int], Motions]]) -> Motions:
    """Motions of several calls put back into the order of their problems.

    Parameters
    ----------
    n : int
        Number of problems.
    parts : sequence of (numbers, motions)
        The problems that a call solved, and its result.
    """
    if len(parts) == 1:
        return parts[0][1]
    arrays: dict[str, Any] = {}
    for name in (*SCALARS, "monodromy"):
        first = getattr(parts[0][1], name)
        arrays[name] = None if first is None else np.empty((n, *first.shape[1:]), first.dtype)
        for numbers, motions in parts:
            if first is not None:
                arrays[name][list(numbers)] = getattr(motions, name)
    place = {i: (motions, j) for numbers, motions in parts for j, i in enumerate(numbers)}
    return Motions(
        events=lambda i: place[i][0].events(place[i][1]),
        sampler=lambda i: place[i][0].sampler(place[i][1]),
        **arrays,
    )
