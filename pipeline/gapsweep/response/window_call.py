"""What a call of the engine found: motions, their events and tangents, as section points."""

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.motions import Events, Motions
from gapsweep.response.section import norm, reach_of, scaled
from gapsweep.status import Status

Array = NDArray[np.float64]

# How far a tangent's determinant may be off, and from which share of its size squared on its own
# rounding shows.
_UNSOUND, _ROUNDING = 1e-2, 1e-3
_OK = int(Status.OK)  # numpy compares with a member of an enumeration four times as slowly


class Call:
    """What one call of the engine found: n motions.

    Attributes
    ----------
    y : ndarray, shape (n_states, n)
        Their ends: displacements [m], velocities [m/s], first-order states.
    unit : ndarray, shape (n_states, n)
        What one metre of the section is in each component of a state.
    omega : ndarray, shape (n,)
        Section points per second [Hz].
    status : ndarray of int, shape (n,)
        `Status` values.
    is_ok : ndarray of bool, shape (n,)
        Which motions did not fail.
    n_steps : ndarray of int, shape (n,)
    n_contacts : ndarray of int, shape (n,)
        How many walls they passed.
    t, t_end : ndarray, shape (n,)
        How long they lasted [s], and how long they were to last.
    contact_time : ndarray, shape (n, n_contacts), or None
        Time spent beyond the walls of every contact [s]; None: only the events tell.
    swing : ndarray, shape (n,), or float
        How far [m] motions swing by themselves; infinity where they are driven.
    """

    swing: Array | float = math.inf

    def __init__(
        self,
        found: Motions,
        unit: Array,
        omega: Array,
        t_end: Array,
        volume_rate: Array,
        monodromy: Array | None,
        tangent_end: Array,
    ) -> None:
        self.unit, self.omega, self._monodromy = unit, omega, monodromy
        self._read = found.events
        self._volume_rate, self.t_end = volume_rate, t_end
        self.contact_time, self.n_contacts = found.contact_time, found.n_contacts
        self.y, self.t, self._tangent_end = found.state.T, found.t, tangent_end
        self.n_steps, self.status, self._reach = found.n_steps, found.status, found.reach
        if self.status.any():
            # A fit that was left on the way but did not run away goes on; where its steady
            # response lies decides in the end.
            excused = arrived(found, t_end) & (found.status == Status.OUT_OF_FIT_RANGE)
            self.status = np.where(excused, Status.OK, found.status)
        self.is_ok = self.status == _OK

    @property
    def reach(self) -> Array:
        """Largest moduli of displacements at the ends of steps, as section points [m]."""
        return reach_of(self._reach.T, self.unit)

    @property
    def monodromy(self) -> Array:
        """Derivatives of the map of the section; shape (n, n_states, n_states)."""
        return self.tangent

    @property
    def determinant(self) -> Array:
        """Determinants [-] of the monodromies."""
        return self.shrinkage

    @cached_property
    def tangent(self) -> Array:
        """Derivatives of the ends by the starts, as section points; shape (n, n_states, n_states).

        With the tangent only. Without units, no arithmetic on them sees how fast clocks run.
        """
        assert self._monodromy is not None
        unit = self.unit.T
        return self._monodromy * (unit[:, None, :] / unit[:, :, None])

    @property
    def strayed(self) -> Array:
        """How far [m] motions have strayed from those that their tangents belong to.

        These start where they do, and their kinks are located.
        """
        return norm((self.y - self._tangent_end) / self.unit)

    @cached_property
    def shrinkage(self) -> Array:
        """Shares [-] of a volume of the section that damping leaves, whatever the forces."""
        # numpy's own exponential is another one on another processor.
        return np.fromiter(map(math.exp, (-self._volume_rate * self.t_end).tolist()), float)

    @property
    def is_sound(self) -> NDArray[np.bool_]:
        """Where the tangent shrinks volumes as damping says, whatever the forces.

        Its directions shrink so differently that the determinant is known to no better than
        rounding of as many factors of its size.
        """
        with np.errstate(all="ignore"):  # of motions that failed
            size = np.square(self.tangent).sum(axis=(1, 2))
            missed = np.abs(np.linalg.det(self.tangent) - self.shrinkage)
            allowed = np.maximum(self.shrinkage, _ROUNDING * size ** (0.5 * len(self.unit)))
        return np.asarray(missed <= _UNSOUND * allowed)

    @cached_property
    def events(self) -> Events:
        """Their events; none of a motion that was not recorded."""
        events = self._read()
        del self._read  # what the engine keeps for it is larger
        return events

    @property
    def passings(self) -> tuple[Array, NDArray[np.int64]]:
        """States on the section, motion by motion, and how many each has."""
        return self.events.section, self.events.n_section

    @cached_property
    def section(self) -> Array:
        """All section points [m], motion by motion; shape (n_states, sum of those of each)."""
        states, counts = self.passings
        return scaled(states, np.repeat(self.unit, counts, axis=1))

    @cached_property
    def period_ends(self) -> NDArray[np.int64]:
        """Where each motion's section points end, after a zero; shape (n + 1,)."""
        return np.concatenate(([0], np.cumsum(self.passings[1])))


def arrived(found: Motions, t_end: Array) -> NDArray[np.bool_]:
    """Which motions came to their ends."""
    return np.asarray(found.t >= t_end * (1.0 - 1e-9))
