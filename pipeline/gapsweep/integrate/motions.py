"""Results of an engine: end states, events and dense output of motions."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

COUNTS = ("n_contacts", "n_steps", "n_rejected", "nfev")
SCALARS = ("t", "status", *COUNTS)
# Smaller components of a tangent are set to zero: subnormal doubles lose digits, and take some
# processors a hundred times as long.
VANISHED = 1e-290
# Counts of `Events`, and the lists that they count.
_LISTS = {
    "n_extrema": ("t_extrema", "extrema", "extrema_of"),
    "n_contacts": ("t_contacts", "contacts_of"),
    "n_section": ("t_section", "section"),
}


@dataclass(slots=True, kw_only=True)  # creating a frozen one takes three times as long
class Events:
    """Recorded events of n motions: those of the first motion, then of the second, and so on.

    Attributes
    ----------
    t_extrema, extrema : ndarray, shape (sum of n_extrema,)
        Times [s] and values [m] of all zero-velocity points after `t_0`: of coordinates, and
        of the gaps of a system's contacts.
    extrema_of : ndarray of int, shape (sum of n_extrema,)
        Number of the coordinate of each extremum; gaps are numbered after all coordinates.
    t_contacts : ndarray, shape (sum of n_contacts,)
        Times [s] at which a contact crossed a wall, in or out. They ascend, except where a hold on
        a rigid wall ends before the last of its summed flights would have ended.
    contacts_of : ndarray of int, shape (sum of n_contacts,)
        Number of the contact of each crossing.
    t_section : ndarray, shape (sum of n_section,)
        Times [s] of section points.
    section : ndarray, shape (sum of n_section, n_states)
        Poincaré section: the state at every whole forcing period after `t_0`; for an unforced
        motion, at every maximum of its first coordinate.
    n_extrema, n_contacts, n_section : ndarray of int, shape (n,)
        Numbers of events of each motion.
    """

    t_extrema: Array
    extrema: Array
    extrema_of: Counts
    t_contacts: Array
    contacts_of: Counts
    t_section: Array
    section: Array
    n_extrema: Counts
    n_contacts: Counts
    n_section: Counts


@dataclass(slots=True, kw_only=True)
class Motions:
    """The solutions of `Problems`, in their order.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Time [s] reached: ``t_end`` unless the motion failed; with dense output, the end of what
        `sampler` covers, its beginning if nothing is recorded.
    state : ndarray, shape (n, n_states)
        Coordinates [m], their velocities [m/s], then first-order states at `t`.
    status : ndarray of int, shape (n,)
        `gapsweep.status.Status` values.
    n_contacts, n_steps, n_rejected, nfev : ndarray of int, shape (n,)
        Wall crossings in and out, accepted and rejected steps, right-hand sides of the motion
        itself (for a Taylor method, expansions).
    reach : ndarray, shape (n, n_coordinates)
        Largest modulus of every coordinate initially and at the ends of steps [m].
    contact_time : ndarray, shape (n, n_contacts), or None
        Time in which every contact's force acts [s]; None: to be computed from the events.
    contact_loss : ndarray, shape (n,)
        Integral of the rate at which contacts shrink volumes in state space [-]: the sum over all
        contacts of damping times b'M⁻¹b times time in contact; 0 for elastic contacts.
    contact_force : ndarray, shape (n, n_contacts), or None
        Largest contact forces [N] of motions recorded from their beginning, for contacts that lose
        energy; None: to be computed from displacements.
    events : callable
        Function that returns the `Events` of all motions; motions not recorded have none.
    sampler : callable
        Function of times that gives the states of all motions there, shape (n_states, n, n_times).
    monodromy : ndarray, shape (n, n_states, n_states), or None
        Derivative of the end state with respect to the initial state.
    columns : ndarray, shape (n, n_states, n_columns), or None
        Derivative of the end state with respect to parameters, at fixed time or, by the frequency,
        at fixed phase; the speed by the frequency then is ``omega`` times that by the phase.
    """

    t: Array
    state: Array
    status: Counts
    n_contacts: Counts
    n_steps: Counts
    n_rejected: Counts
    nfev: Counts
    reach: Array
    events: Callable[[], Events]
    sampler: Callable[[Array], Array]
    monodromy: Array | None = None
    contact_time: Array | None = None
    contact_loss: Array
    contact_force: Array | None = None
    columns: Array | None = None


def merged(parts: Sequence[Motions], rows: Sequence[NDArray[np.intp]]) -> Motions:
    """Join the motions of several calls, each part at its `rows` of the result.

    Times and largest forces of contacts are left out: only motions of some laws have them.
    """
    if len(parts) == 1:
        return parts[0]
    order = np.argsort(np.concatenate(rows))
    columns: dict[str, Any] = {}
    for name in (*SCALARS, "state", "reach", "monodromy", "columns", "contact_loss"):
        values = [getattr(part, name) for part in parts]
        columns[name] = None if values[0] is None else np.concatenate(values)[order]

    def events() -> Events:
        return _merged_events([part.events() for part in parts], np.concatenate(rows))

    def sampler(t: Array) -> Array:
        return np.concatenate([part.sampler(t) for part in parts], axis=1)[:, order]

    return Motions(events=events, sampler=sampler, **columns)


def _merged_events(parts: Sequence[Events], places: NDArray[np.intp]) -> Events:
    """Join the events of several calls; `places` are the rows of their motions in the result."""
    found = {
        field.name: np.concatenate([getattr(part, field.name) for part in parts])
        for field in fields(Events)
    }
    for counts in [name for name in found if name.startswith("n_")]:
        order = np.argsort(np.repeat(places, found[counts]), kind="stable")
        for name in _LISTS[counts]:
            found[name] = found[name][order]
        found[counts] = found[counts][np.argsort(places)]
    return Events(**found)
