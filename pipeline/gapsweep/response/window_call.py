"""Result of a call of the engine: motions, their events and tangents, as section points."""

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.motions import Events, Motions
from gapsweep.response.compiled import determinants_agree
from gapsweep.response.section import norm, reach_of, scaled
from gapsweep.status import Status

Array = NDArray[np.float64]

_OK = int(Status.OK)  # numpy compares with a member of an enumeration four times as slowly


class Call:
    """Result of one call of the engine: n motions over whole periods.

    Attributes
    ----------
    y : ndarray, shape (n_states, n)
        End states: displacements [m], velocities [m/s], first-order states.
    unit : ndarray, shape (n_states, n)
        Value of each component of a state that corresponds to one metre of the section.
    omega : ndarray, shape (n,)
        Section points per second [Hz].
    status : ndarray of int, shape (n,)
        `Status` values.
    is_ok : ndarray of bool, shape (n,)
        Whether a motion did not fail.
    n_steps : ndarray of int, shape (n,)
    n_contacts : ndarray of int, shape (n,)
        Numbers of wall crossings.
    t, t_end : ndarray, shape (n,)
        Durations of the motions [s], and requested durations.
    contact_time, contact_force : ndarray, shape (n, n_contacts), or None
        As in `Motions`.
    swing : ndarray, shape (n,), or float
        Amplitude [m] of autonomous motions; infinity for forced motions.
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
        self.contact_force, self._contact_loss = found.contact_force, found.contact_loss
        self.y, self.t, self._tangent_end = found.state.T, found.t, tangent_end
        self.n_steps, self.status, self._reach = found.n_steps, found.status, found.reach
        if self.status.any():
            # A motion that left the range of a fit but did not diverge goes on; the range of its
            # steady response decides in the end.
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
        """Derivatives of end by initial states, as section points; shape (n, n_states, n_states).

        Only if the tangent was integrated. Without units, results do not depend on the time scale.
        """
        assert self._monodromy is not None
        unit = self.unit.T
        return self._monodromy * (unit[:, None, :] / unit[:, :, None])

    @property
    def strayed(self) -> Array:
        """Distances [m] of the end states from those of the motions that the tangents belong to.

        Both start from the same states, but the latter have their kinks located.
        """
        return norm((self.y - self._tangent_end) / self.unit)

    @cached_property
    def shrinkage(self) -> Array:
        """Factors [-] by which damping, also of contacts, shrinks volumes in state space."""
        exponents = -self._volume_rate * self.t_end - self._contact_loss
        # numpy's exponential differs between processors.
        return np.fromiter(map(math.exp, exponents.tolist()), float)

    @property
    def is_sound(self) -> NDArray[np.bool_]:
        """Whether the determinant of the tangent is the one that damping determines."""
        return np.asarray(determinants_agree(np.ascontiguousarray(self.tangent), self.shrinkage))

    @cached_property
    def events(self) -> Events:
        """Events of the motions; motions that were not recorded have none."""
        events = self._read()
        del self._read  # what the engine keeps for it is larger
        return events

    @property
    def passings(self) -> tuple[Array, NDArray[np.int64]]:
        """States on the section, motion by motion, and their number for each motion."""
        return self.events.section, self.events.n_section

    @cached_property
    def section(self) -> Array:
        """All section points [m], motion by motion; shape (n_states, number of all points)."""
        states, counts = self.passings
        return scaled(states, np.repeat(self.unit, counts, axis=1))

    @cached_property
    def period_ends(self) -> NDArray[np.int64]:
        """Ends of each motion's points in `section`, after a zero; shape (n + 1,)."""
        return np.concatenate(([0], np.cumsum(self.passings[1])))


def arrived(found: Motions, t_end: Array) -> NDArray[np.bool_]:
    """Whether motions reached their ends `t_end`."""
    return np.asarray(found.t >= t_end * (1.0 - 1e-9))
