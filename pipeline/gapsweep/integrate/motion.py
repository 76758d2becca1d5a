"""What an engine returns."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Sampler = Callable[[Array], tuple[Array, Array]]

SCALARS = ("t", "x", "v", "status", "n_contacts", "n_steps", "n_rejected", "nfev", "reach")


@dataclass(frozen=True, slots=True, kw_only=True)
class Events:
    """What was recorded of n motions: the events of the first one, of the second, and so on.

    Attributes
    ----------
    t_extrema, extrema : ndarray, shape (sum of n_extrema,)
        Times [s] and displacements [m] of all zero-velocity points after the start.
    t_contacts : ndarray, shape (sum of n_contacts,)
        Times [s] at which the displacement crossed a wall, in or out.
    section : ndarray, shape (sum of n_section, 2)
        Stroboscopic section: ``(x, v)`` at every whole forcing period after the start.
    n_extrema, n_contacts, n_section : ndarray of int, shape (n,)
        How many of them belong to each motion.
    """

    t_extrema: Array
    extrema: Array
    t_contacts: Array
    section: Array
    n_extrema: Counts
    n_contacts: Counts
    n_section: Counts


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
    reach : ndarray, shape (n,)
        Largest modulus of the displacement at the start and at the ends of steps [m].
    events : callable
        Events of all motions; none of one that was not recorded.
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
    reach: Array
    events: Callable[[], Events]
    sampler: Callable[[int], Sampler]
    monodromy: Array | None = None
