"""Contact loads of a steady response: largest force, and share of time in contact."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.model.contact import ContactLaw, Piecewise
from gapsweep.model.equilibria import search_points, sign_changes
from gapsweep.model.user_law import UserLaw
from gapsweep.response.ensemble import Ensemble
from gapsweep.response.window_call import Call

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Numbers = NDArray[np.intp]

# An initial state this close to a wall, as a share of its displacement, is on the wall: even the
# contact time of a grazing motion that deep is negligible.
_ON_WALL = 1e-9


# --- force ----------------------------------------------------------------------------------------


def largest_forces(laws: Sequence[ContactLaw], x_min: Array, x_max: Array) -> Array:
    """Largest magnitudes [N] of contact forces, of a wall, between two displacements.

    The maximum is at an end, or at an extremum of the force between the ends.

    Parameters
    ----------
    laws : sequence of ContactLaw, length n
    x_min, x_max : ndarray, shape (n,)
        Displacements [m].
    """
    rows: dict[tuple[int, int], list[int]] = {}
    # Searched up to the next power of two of each motion: results do not depend on other points.
    _, powers = np.frexp(np.maximum(np.abs(x_min), np.abs(x_max)))
    for row, (law, power) in enumerate(zip(laws, powers.tolist(), strict=True)):
        # By identity: the laws stay alive, and some hash slowly. Exact laws have one formula.
        which = 0 if _has_springs(law) else id(law)
        rows.setdefault((which, power if law.turns is None else 0), []).append(row)
    found = np.empty(len(laws))
    for (_, power), here in rows.items():
        law, low, high = laws[here[0]], x_min[here], x_max[here]
        if _has_springs(law):
            found[here] = _largest_of_exact([laws[row] for row in here], low, high)
            continue
        turns = _searched_turns(law, 2.0**power) if law.turns is None else law.turns
        x = np.array([low, high, *(np.clip(turn, low, high) for turn in turns)])
        forces = [_values(each, each.force, x) for each in law.of_walls]
        found[here] = np.fmax.reduce(np.abs(np.concatenate(forces)))
    return found


def _has_springs(law: ContactLaw) -> bool:
    """Whether a law has linear springs at its walls."""
    return isinstance(law, Piecewise) and not law.losses.is_rigid


def _largest_of_exact(laws: Sequence[ContactLaw], x_min: Array, x_max: Array) -> Array:
    """Largest magnitudes [N] of the springs' forces, as `largest_forces`, of all laws at once."""
    numbers = [(law.K_c, law.K_ratio, law.gap.j_1, law.gap.j_2) for law in laws]
    K_c, ratio, j_1, j_2 = np.array(numbers).T
    above, below = np.maximum(x_max - j_2, 0.0), ratio * np.maximum(-j_1 - x_min, 0.0)
    return np.asarray(np.fmax(K_c * above, K_c * below))


@lru_cache(maxsize=256)
def _searched_turns(law: ContactLaw, reach: float) -> tuple[float, ...]:
    """Displacements [m] of all extrema of a law's force within ``±reach``, found by search."""
    turns, _ = sign_changes(lambda x: _values(law, law.derivative, x), search_points(law, reach))
    return tuple(turns.tolist())


def _values(law: ContactLaw, function: Any, x: Any) -> Any:
    """Values of a law's force or slope at `x`; NaN where a user's code raises."""
    with np.errstate(all="ignore"):
        return _tolerant(function, x) if isinstance(law, UserLaw) else function(x)


def _tolerant(function: Any, x: Any) -> Any:
    try:
        return function(x)
    except Exception:  # a user's function raises any type out of its range: no force known there
        if not np.ndim(x):
            return np.nan
        return np.array([_tolerant(function, each) for each in x])


# --- time -----------------------------------------------------------------------------------------


def contact_shares(
    ensemble: Ensemble, scenes: Numbers, y_0: Array, call: Call, *, closed: bool = False
) -> Array:
    """Shares [-] of their time that motions spend beyond the walls of each contact.

    A motion is always beyond one of two walls that overlap.

    Parameters
    ----------
    ensemble : Ensemble
    scenes : ndarray of int, shape (n,)
        Cases of the motions.
    y_0 : ndarray, shape (n_states, n)
        Initial states of the motions.
    call : Call
        Motions recorded from their beginning, with all events.
    closed : bool
        Whether each motion ends where it starts.

    Returns
    -------
    ndarray, shape (n_contacts, n)
    """
    walls = ensemble.walls[:, :, scenes]
    ends = [ensemble.gaps(ensemble.turning(scenes, y)) for y in (y_0, call.y)]
    if call.contact_time is not None:
        shares = np.minimum(call.contact_time.T / call.t_end, 1.0)
        # A motion that stays on a wall does not press on it, unless the wall holds it.
        stays = [(end == walls[0]) | (end == walls[1]) for end in ends]
        touches = stays[0] & stays[1] & (call.n_contacts == 0) & ~ensemble.may_hold[:, scenes]
        shares = np.where(touches, 0.0, shares)
        return np.where(walls[0] > walls[1], 1.0, shares)
    events = call.events
    found = []
    for k in range(walls.shape[1]):
        passings = _of_one(events.t_contacts, events.contacts_of, events.n_contacts, k)
        turns, n_turns = _of_one(
            np.stack([events.t_extrema, events.extrema], axis=1),
            events.extrema_of,
            events.n_extrema,
            ensemble.first_gap + k,
        )
        gap_ends = [end[k] for end in ends]
        found.append(
            _shares(passings, (*turns.T, n_turns), call.t_end, gap_ends, walls[:, k], closed)
        )
    return np.where(walls[0] > walls[1], 1.0, np.reshape(found, walls.shape[1:]))


def _of_one(values: Array, owners: Counts, counts: Counts, which: int) -> tuple[Array, Counts]:
    """Return the events of contact or gap `which`, motion by motion, and their numbers."""
    is_its = owners == which
    motions = np.repeat(np.arange(len(counts)), counts)
    return values[is_its], np.bincount(motions[is_its], minlength=len(counts))


def _shares(
    passings: tuple[Array, Counts],
    turns: tuple[Array, Array, Counts],
    t_end: Array,
    ends: Sequence[Array],
    walls: Array,
    closed: bool,
) -> Array:
    """Shares [-] of their time that motions spend beyond two walls.

    Wall crossings divide a motion into parts. A part beyond a wall has an extremum there, which
    distinguishes it from the parts in the gap.

    Parameters
    ----------
    passings : tuple of ndarray, shape (number of contacts,), and ndarray of int, shape (n,)
        Times of wall crossings [s], motion by motion, and their number in each.
    turns : tuple of ndarray, shape (number of turns,), twice, and ndarray of int, shape (n,)
        Times [s] and values [m] of the gap's extrema, and their number in each motion.
    t_end : ndarray, shape (n,)
    ends : sequence of ndarray, shape (n,), two
        Gap [m] initially and at the end.
    walls : ndarray, shape (2, n)
    closed : bool
        As in `contact_shares`.
    """
    t_contacts, n_contacts = passings
    t_turns, turn, n_turns = turns
    n_stretches = n_contacts + 1
    last = np.cumsum(n_stretches) - 1
    first = last - n_contacts
    begin, end = np.zeros(n_stretches.sum()), np.empty(n_stretches.sum())
    inner = np.ones(len(begin), bool)
    inner[first] = False
    begin[inner] = t_contacts
    inner[first], inner[last] = True, False
    end[inner], end[last] = t_contacts, t_end

    def beyond(x: Array, motion: Numbers, slack: Array | float = 0.0) -> Any:
        low, high = walls[:, motion]
        return (x > high + slack) | (x < low - slack)

    motions = np.arange(len(t_end))
    of_contact, of_turn = (np.repeat(motions, n) for n in (n_contacts, n_turns))
    # All motions on one time axis, with unit length each.
    contact = of_contact + np.minimum(t_contacts / t_end[of_contact], 1.0)
    outside = np.flatnonzero(beyond(turn, of_turn))
    of_turn = of_turn[outside]
    turned = of_turn + np.minimum(t_turns[outside] / t_end[of_turn], 1.0)
    is_beyond = np.zeros(len(begin), bool)
    is_beyond[np.searchsorted(contact, turned) + of_turn] = True
    slack = _ON_WALL * np.abs(ends[0])
    with np.errstate(invalid="ignore"):  # for motions that failed
        is_beyond[first] |= beyond(ends[0], motions, slack)
        is_beyond[last] |= beyond(ends[1], motions, slack)
    if closed:
        is_beyond[first] = is_beyond[last] = is_beyond[first] | is_beyond[last]
    lengths = np.where(is_beyond, end - begin, 0.0)
    return np.asarray(np.add.reduceat(lengths, first) / t_end)
