"""Answers: the recorded motion of every response, and what is read off it.

One last call records a whole period of every orbit. What is not periodic has its last window, which
was recorded with all events.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.response.ensemble import Call, Ensemble
from gapsweep.response.result import ExtremumKind, Response, ResponseClass, Steady
from gapsweep.response.shooting import Shots
from gapsweep.response.walks import Walks
from gapsweep.status import Status

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Mask = NDArray[np.bool_]
Numbers = NDArray[np.intp]

_NOTHING = 1e-290  # below it doubles lose digits


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
) -> list[Response]:
    """Responses of all scenes of an ensemble."""
    t_settled = walks.t
    orbits = np.flatnonzero(found.is_periodic)
    states = _record(orbits, ensemble, walks, shots)
    points = np.flatnonzero(walks.status == Status.OK)
    columns = _read_off(points, ensemble, walks, found, states, steady)
    columns |= _stability(points, ensemble, walks, shots, found)
    columns["t_settled"] = t_settled[points].tolist()
    rows = dict(zip(points.tolist(), _rows(columns), strict=True))
    costs = {name: column.tolist() for name, column in ensemble.costs().items()}
    return [
        Response(**(rows[k] if k in rows else _failure(ensemble, walks, k)), **cost)
        for k, cost in enumerate(_rows(costs))
    ]


def _rows(columns: Mapping[str, list[Any]]) -> list[dict[str, Any]]:
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _failure(ensemble: Ensemble, walks: Walks, point: int) -> dict[str, Any]:
    x, reached = float(walks.y[0, point]), Status(walks.status[point])
    left_range = not abs(x) <= ensemble.scenes[point].law.valid_range
    where = f"{reached.label} before t = {walks.t[point]:.6g} s at x = {x:.3g} m"
    return {"status": Status.OUT_OF_FIT_RANGE if left_range else reached, "message": where}


def _stability(
    points: Numbers, ensemble: Ensemble, walks: Walks, shots: Shots, found: Found
) -> dict[str, list[Any]]:
    """Columns that say what the responses of some points are, and how sure that is."""
    is_orbit, is_chaotic = found.is_periodic[points], found.is_chaotic[points]
    n, omega = shots.n[points], ensemble.omega[points]
    lyapunov, error = found.lyapunov[points], found.lyapunov_error[points]
    multipliers: list[tuple[float, ...]] = [()] * len(points)
    modulus = np.full(len(points), np.nan)
    for k in np.flatnonzero(is_orbit).tolist():
        pair = shots.multipliers[points[k]].tolist()
        multipliers[k] = tuple(part for z in pair for part in (z.real, z.imag))
        modulus[k] = abs(pair[0])
        if math.isnan(lyapunov[k]):
            # What has shrunk to nothing shrank on average as areas do.
            lyapunov[k], error[k] = -ensemble.decay_rate[points[k]], 0.0
            if modulus[k] > _NOTHING:
                lyapunov[k] = math.log(modulus[k]) * omega[k] / n[k]
    kinds = np.where(
        is_orbit,
        ResponseClass.PERIODIC,
        np.where(is_chaotic, ResponseClass.CHAOTIC, ResponseClass.UNRESOLVED),
    )
    return {
        "response_class": [ResponseClass(kind) for kind in kinds.tolist()],
        "period_multiple": np.where(is_orbit, n, 0).tolist(),
        "multipliers": multipliers,
        "multiplier_abs": modulus.tolist(),
        "lyapunov": lyapunov.tolist(),
        "lyapunov_error": error.tolist(),
        "noise": walks.noise(np.where(found.is_periodic, shots.n, 1))[points].tolist(),
    }


def _record(orbits: Numbers, ensemble: Ensemble, walks: Walks, shots: Shots) -> dict[int, Array]:
    """States ``x, v, x, v, ...`` [m], [m/s] of orbits after each forcing period of a whole period.

    Their extrema join those of the last windows of other motions.
    """
    if not orbits.size:
        return {}
    y, n = shots.y[:, orbits], shots.n[orbits]
    call = ensemble.call(orbits, y, n, np.zeros(len(orbits)), section_only=False)
    walks.y[:, orbits], walks.status[orbits] = y, call.status
    extrema, counts = _whole_period(ensemble, orbits, y, call)
    walks.extrema |= zip(orbits.tolist(), np.split(extrema, np.cumsum(counts)[:-1]), strict=True)
    sections = np.split(call.events.section, call.period_ends[1:-1])
    return {k: each.ravel() for k, each in zip(orbits.tolist(), sections, strict=True)}


def _read_off(
    points: Numbers,
    ensemble: Ensemble,
    walks: Walks,
    found: Found,
    states: dict[int, Array],
    steady: Steady,
) -> dict[str, list[Any]]:
    """Columns that are read off the recorded motions of some points."""
    is_orbit, y = found.is_periodic[points], walks.y[:, points]
    extrema = [walks.extrema[point] for point in points.tolist()]
    x, counts = np.concatenate([np.empty(0), *extrema]), np.array(list(map(len, extrema)), int)
    kinds, ends = _kinds(x, counts, is_orbit), np.cumsum(counts)
    # A response without a turning point in its window still has a position.
    x_max, x_min, seen = y[0].copy(), y[0].copy(), np.flatnonzero(counts)
    if seen.size:
        x_max[seen] = np.maximum.reduceat(x, (ends - counts)[seen])
        x_min[seen] = np.minimum.reduceat(x, (ends - counts)[seen])
    walks.reach[points] = np.maximum(np.abs(x_max), np.abs(x_min))
    scenes = [ensemble.scenes[point] for point in points.tolist()]
    has_left = walks.reach[points] > np.array([scene.law.valid_range for scene in scenes])
    is_known = is_orbit | found.is_chaotic[points]
    status = np.where(is_known, Status.OK, Status.UNRESOLVED)
    status[has_left] = Status.OUT_OF_FIT_RANGE
    first = ends - counts
    shown = list(map(slice, first, first + np.minimum(counts, steady.max_extrema)))
    listed, kind_listed = x.tolist(), kinds.tolist()
    return {
        "status": [Status(each) for each in status.tolist()],
        "extrema": [tuple(listed[each]) for each in shown],
        "extremum_kind": [tuple(kind_listed[each]) for each in shown],
        "n_extrema": counts.tolist(),
        "x_max": x_max.tolist(),
        "x_min": x_min.tolist(),
        "amplitude": (0.5 * (x_max - x_min)).tolist(),
        "section": [
            tuple((states[k] if k in states else _last(walks, k, steady)).tolist())
            for k in points.tolist()
        ],
        "x_end": y[0].tolist(),
        "v_end": y[1].tolist(),
    }


def _last(walks: Walks, point: int, steady: Steady) -> Array:
    """The last states of a window, ``x, v, x, v, ...`` [m], [m/s]."""
    section = walks.window(point)[-steady.max_period_multiple :]
    omega_rad = 2.0 * math.pi * walks.ensemble.omega[point]
    return np.stack((section.real, section.imag * omega_rad), axis=1).ravel()


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
