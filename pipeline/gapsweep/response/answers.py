"""Answers: the recorded motion of every response, and what is read off it.

One last call records a whole period of every orbit. What is not periodic has its last window, which
was recorded with all events.
"""

import math

import numpy as np
from numpy.typing import NDArray

from gapsweep.response.ensemble import Call, Ensemble
from gapsweep.response.lists import Lists, spans
from gapsweep.response.loads import contact_shares, largest_forces
from gapsweep.response.maps import NOTHING
from gapsweep.response.result import (
    LISTS,
    ExtremumKind,
    ResponseClass,
    Responses,
    Steady,
    missing,
)
from gapsweep.response.shooting import Shots
from gapsweep.response.walks import Walks
from gapsweep.status import Status

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Mask = NDArray[np.bool_]
Numbers = NDArray[np.intp]


class Found:
    """What motions turned out to be, n of them; one that is neither is unresolved, or failed.

    Attributes
    ----------
    is_periodic, is_chaotic : ndarray of bool, shape (n,)
    lyapunov, lyapunov_error : ndarray, shape (n,)
        Largest Lyapunov exponent [1/s] and its standard error, where it was measured.
    """

    def __init__(self, n: int) -> None:
        self.is_periodic, self.is_chaotic = np.zeros(n, bool), np.zeros(n, bool)
        self.lyapunov, self.lyapunov_error = np.full(n, np.nan), np.full(n, np.nan)


def answers(
    ensemble: Ensemble, walks: Walks, shots: Shots, found: Found, steady: Steady
) -> Responses:
    """Responses of all scenes of an ensemble."""
    n, t_settled = len(ensemble.omega), walks.t
    states = _record(np.flatnonzero(found.is_periodic), ensemble, walks, shots)
    is_ok = walks.status == Status.OK
    points, failures = np.flatnonzero(is_ok), np.flatnonzero(~is_ok)
    read, lists = _read_off(points, ensemble, walks, found, steady)
    read |= _stability(points, ensemble, walks, shots, found)
    read["t_settled"] = t_settled[points]
    lists["multipliers"] = _multipliers(points, shots, found)
    lists["section"] = section, counts = _section(points, walks, found, states, steady)
    ends = np.cumsum(counts)
    read["x_end"], read["v_end"] = section[ends - 2], section[ends - 1]
    columns = missing(n)
    for name, values in read.items():
        columns[name][points] = values
    columns["status"][failures], messages = _failures(failures, ensemble, walks)
    columns |= ensemble.costs()
    of_all = {}
    for name, dtype in LISTS.items():
        items, some = lists[name]
        counts = np.zeros(n, np.int64)
        counts[points] = some
        of_all[name] = items.astype(dtype, copy=False), counts
    return Responses(columns, of_all, messages)


def _failures(
    failures: Numbers, ensemble: Ensemble, walks: Walks
) -> tuple[list[Status], dict[int, str]]:
    """Status of the points that failed, and what to say of it by point."""
    statuses, messages = [], {}
    for point in failures.tolist():
        x, reached = float(walks.y[0, point]), Status(walks.status[point])
        left_range = not abs(x) <= ensemble.valid_range[point]
        statuses.append(Status.OUT_OF_FIT_RANGE if left_range else reached)
        messages[point] = f"{reached.label} before t = {walks.t[point]:.6g} s at x = {x:.3g} m"
    return statuses, messages


def _stability(
    points: Numbers, ensemble: Ensemble, walks: Walks, shots: Shots, found: Found
) -> dict[str, Array | Counts]:
    """Columns that say what the responses of some points are, and how sure that is."""
    is_orbit, is_chaotic = found.is_periodic[points], found.is_chaotic[points]
    n, omega = shots.n[points], ensemble.omega[points]
    lyapunov, error = found.lyapunov[points], found.lyapunov_error[points]
    modulus = np.full(len(points), np.nan)
    largest = shots.multipliers[points[is_orbit], 0]
    modulus[is_orbit] = np.hypot(largest.real, largest.imag)
    follows = is_orbit & np.isnan(lyapunov)
    shrinks = follows & (modulus > NOTHING)
    # What swings until it has shrunk to nothing shrank on average as areas do; what creeps did not.
    rate = ensemble.decay_rate[points]
    swings = follows & ~shrinks & (ensemble.settling_rate[points] == rate)
    lyapunov[swings] = -rate[swings]
    error[swings | shrinks] = 0.0
    # numpy's own logarithm is another one on another processor.
    logarithms = np.fromiter(map(math.log, modulus[shrinks].tolist()), float)
    lyapunov[shrinks] = logarithms * omega[shrinks] / n[shrinks]
    kinds = np.where(
        is_orbit,
        ResponseClass.PERIODIC,
        np.where(is_chaotic, ResponseClass.CHAOTIC, ResponseClass.UNRESOLVED),
    )
    return {
        "response_class": kinds,
        "period_multiple": np.where(is_orbit, n, 0),
        "multiplier_abs": modulus,
        "lyapunov": lyapunov,
        "lyapunov_error": error,
        "noise": walks.noise(np.where(found.is_periodic, shots.n, 1))[points],
    }


def _multipliers(points: Numbers, shots: Shots, found: Found) -> tuple[Array, Counts]:
    """Floquet multipliers of the orbits among some points, real part and imaginary part in turn."""
    is_orbit = found.is_periodic[points]
    return shots.multipliers[points[is_orbit]].view(float).ravel(), np.where(is_orbit, 4, 0)


def _record(orbits: Numbers, ensemble: Ensemble, walks: Walks, shots: Shots) -> Lists:
    """States ``x, v, x, v, ...`` [m], [m/s] of orbits after each forcing period of a whole period.

    Their extrema and contacts join those of the last windows of other motions.
    """
    states = Lists(len(ensemble.omega))
    if orbits.size:
        y, n = shots.y[:, orbits], shots.n[orbits]
        call = ensemble.call(orbits, y, n, np.zeros(len(orbits)), section_only=False)
        walks.y[:, orbits], walks.status[orbits] = y, call.status
        walks.extrema.put(orbits, *_whole_period(ensemble, orbits, y, call))
        walls = ensemble.walls[:, orbits]
        walks.contact_share[orbits] = contact_shares(call, y[0], walls, closed=True)
        states.put(orbits, call.events.section.ravel(), 2 * call.events.n_section)
    return states


def _section(
    points: Numbers, walks: Walks, found: Found, states: Lists, steady: Steady
) -> tuple[Array, Counts]:
    """States of some points: of orbits as recorded, of other motions the last of their windows."""
    others = points[~found.is_periodic[points]]
    length, width = walks.length[others], walks.section.shape[1]
    counts = np.minimum(length, steady.max_period_multiple)
    window = walks.section.ravel()[spans(others * width + length - counts, counts)]
    omega_rad = np.repeat(2.0 * math.pi * walks.ensemble.omega[others], counts)
    last = np.stack((window.real, window.imag * omega_rad), axis=1)
    states.put(others, last.ravel(), 2 * counts)
    return states.of(points)


def _read_off(
    points: Numbers, ensemble: Ensemble, walks: Walks, found: Found, steady: Steady
) -> tuple[dict[str, Array | Counts], dict[str, tuple[Array | Counts, Counts]]]:
    """Columns and lists that are read off the recorded extrema of some points."""
    is_orbit, y = found.is_periodic[points], walks.y[:, points]
    x, counts = walks.extrema.of(points)
    kinds, first = _kinds(x, counts, is_orbit), np.cumsum(counts) - counts
    # A response without a turning point in its window still has a position.
    x_max, x_min, seen = y[0].copy(), y[0].copy(), np.flatnonzero(counts)
    if seen.size:
        x_max[seen] = np.maximum.reduceat(x, first[seen])
        x_min[seen] = np.minimum.reduceat(x, first[seen])
    walks.reach[points] = np.maximum(np.abs(x_max), np.abs(x_min))
    has_left = walks.reach[points] > ensemble.valid_range[points]
    is_known = is_orbit | found.is_chaotic[points]
    status = np.where(is_known, Status.OK, Status.UNRESOLVED)
    status[has_left] = Status.OUT_OF_FIT_RANGE
    laws = [ensemble.scenes[point].law for point in points.tolist()]
    n_shown = np.minimum(counts, steady.max_extrema)
    shown = spans(first, n_shown)
    columns = {
        "status": status,
        "n_extrema": counts,
        "x_max": x_max,
        "x_min": x_min,
        "amplitude": 0.5 * (x_max - x_min),
        "force_max": largest_forces(laws, x_min, x_max),
        "contact_share": walks.contact_share[points],
    }
    return columns, {"extrema": (x[shown], n_shown), "extremum_kind": (kinds[shown], n_shown)}


def _whole_period(
    ensemble: Ensemble, orbits: Numbers, y: Array, call: Call
) -> tuple[Array, Counts]:
    """Displacements [m] of the extrema of orbits, and how many are each one's.

    The end of an orbit does not meet its start to the last bit. A turn just there would be missed,
    or counted at both: then the velocities have opposite signs, and the acceleration says which it
    is.
    """
    x, counts = call.events.extrema, call.events.n_extrema
    ends = np.cumsum(counts)
    missed, doubled = np.zeros(len(orbits), bool), np.zeros(len(orbits), bool)
    (_, v_start), (x_end, v_end) = y, call.y
    for k in np.flatnonzero(v_start * v_end < 0.0).tolist():
        scene, at = ensemble.scenes[orbits[k]], float(x_end[k])
        o, force = scene.oscillator, float(scene.law.force(at))
        springs = o.mass * o.omega_n_rad**2 * at + o.alpha * at**3 + force
        missed[k] = (v_start[k] - v_end[k]) * (o.forcing - springs) > 0.0
        doubled[k] = not missed[k] and counts[k] > 0
    x = np.delete(x, (ends - counts)[doubled])
    counts = counts - doubled
    x = np.insert(x, np.cumsum(counts)[missed], x_end[missed])
    return x, counts + missed


def _kinds(x: Array, counts: Counts, closed: Mask) -> Counts:
    """`ExtremumKind` of zero-velocity displacements, motion by motion in the order of time.

    What is passed on the way from one neighbour to the other is an inflection. `closed`: the first
    follows the last.
    """
    before, after = np.roll(x, 1), np.roll(x, -1)
    some = np.flatnonzero(counts)
    last, first = (np.cumsum(counts) - 1)[some], (np.cumsum(counts) - counts)[some]
    is_closed, two = closed[some], np.minimum(first + 1, last)
    before[first] = np.where(is_closed, x[last], x[two])
    after[last] = np.where(is_closed, x[first], x[np.maximum(last - 1, first)])
    is_maximum, is_minimum = (x > before) & (x > after), (x < before) & (x < after)
    return np.asarray(
        np.where(
            is_maximum,
            ExtremumKind.MAXIMUM,
            np.where(is_minimum, ExtremumKind.MINIMUM, ExtremumKind.INFLECTION),
        )
    )
