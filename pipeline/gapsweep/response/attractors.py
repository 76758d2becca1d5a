"""Grouping of responses from different initial conditions into attractors.

A response belongs to the first attractor of its case whose first response it repeats. In each
round all responses that are left are compared, as arrays, with the first of them in their case: a
case of a million initial conditions takes as many rounds as it has attractors, and a million
cases of one initial condition take one round.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.response.ragged import spans
from gapsweep.response.result import ResponseClass, Responses
from gapsweep.response.section import CLOUD_CLOSE, cloud_distances, own_neighbours, reach_of, scaled
from gapsweep.response.thresholds import DEVIATIONS

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Numbers = NDArray[np.intp]
# Function of pairs of responses, given by their numbers: whether they are on the same attractor.
Same = Callable[[Numbers, Numbers], Mask]

NONE = -1
# Two periodic orbits closer than this share of their reach are one, polished or not.
_SAME_ORBIT = 1e-3
# Equilibria are known better.
_SAME_REST = 1e-6
# Two orbits blurred by solver errors are known to this share only.
_SAME_NOISY = 0.1
# Two chaotic samples are of one attractor if they overlap within `CLOUD_CLOSE`, or if at most this
# share of their points has its nearest neighbour in the same sample. For 32 points of one
# distribution the share is one half, and three quarters or more in one case of a thousand.
_MIXED = 0.75
# A coordinate that moves by less than this share of the others counts as still.
_ROUNDING = 1e-3
_DIGITS = 9  # of displacements [m], so that the last bits of twins do not decide their order
_BLOCK = 1 << 20  # numbers that are compared at a time


@dataclass(frozen=True, slots=True, eq=False)
class Attractors:
    """Attractors of many cases as columns, sorted by case, then by peak."""

    # Shape (n_responses,); row, in the columns below, of the attractor of each response, `NONE`
    # without an attractor.
    of_response: Numbers
    # `scene`, `number`: shape (n,); number of the attractor's case, and of the attractor within the
    # case.
    scene: Numbers
    number: Numbers
    first: Numbers  # shape (n,); number of the first response on the attractor
    leaders: Responses  # the first response on each attractor
    # `n_ending`, `n_starts`: shape (n,); number of the case's counted initial conditions that lead
    # to it, and of all counted ones.
    n_ending: Numbers
    n_starts: Numbers
    # Shape (n,); number of the attractor that is its mirror image (the same if it is symmetric),
    # `NONE` if none was found, or if the gap is not symmetric.
    mirror_of: Numbers

    @property
    def numbers(self) -> Numbers:
        """Number of the attractor of every response within its case, `NONE` if it has none."""
        return np.append(self.number, NONE)[self.of_response]

    @property
    def basin_share(self) -> Array:
        """Share of the case's counted initial conditions that lead to each attractor [-]."""
        # NaN, not infinite, without counted initial conditions.
        n_starts = np.where(self.n_starts > 0, self.n_starts, np.nan)
        return np.asarray(self.n_ending / n_starts)

    @property
    def basin_share_error(self) -> Array:
        """Standard error of `basin_share` [-], of a binomial sample."""
        share, n_starts = self.basin_share, np.maximum(self.n_starts, 1)
        return np.sqrt(share * (1.0 - share) / n_starts)


class Grouping:
    """Groups the responses of many cases, which are added in parts, into attractors.

    A case of a million initial conditions need not be in memory at once: of earlier parts only the
    first response on each attractor is kept. The result does not depend on the parts.

    Each part should have as many cases as possible: a case then costs one or two microseconds,
    and half a millisecond in a separate part.

    Parameters
    ----------
    unit : ndarray, shape (n_states, n_scenes)
        Value of each component of a state that corresponds to one metre of the section.
    """

    def __init__(self, unit: Array) -> None:
        self._unit, self._n_responses = unit, 0
        self._leaders: Responses | None = None
        self._scene, self._first, self._n_ending = np.zeros((3, 0), np.intp)
        self._n_starts = np.zeros(unit.shape[1], np.intp)
        self._of_response: list[Numbers] = []

    def add(self, responses: Responses, scene: ArrayLike, counted: ArrayLike | None = None) -> None:
        """Group further responses.

        Unresolved and failed responses belong to no attractor, but count for basin shares.

        Parameters
        ----------
        responses : Responses
            Responses of all cases, in any order.
        scene : array_like of int, shape (n_responses,)
            Number of each response's case, from 0 on.
        counted : array_like of bool, shape (n_responses,), optional
            Whether an initial condition counts for basin shares; all if None. A sweep's do not.
        """
        n, scene = len(self._scene), np.asarray(scene, np.intp)
        sample = np.ones(len(scene), bool) if counted is None else np.asarray(counted, bool)
        of_all = np.concatenate([self._scene, scene])
        if self._leaders is not None:
            responses = Responses.concatenated([self._leaders, responses])
        first = _firsts(responses, of_all, self._unit)[n:]
        new = np.unique(first[first >= n])
        place = np.full(len(of_all) + 1, NONE, np.intp)  # that of `NONE` comes last
        place[:n], place[new] = np.arange(n), n + np.arange(len(new))
        of_response, leaders = place[first], np.append(np.arange(n), new)
        self._of_response.append(of_response)
        self._leaders, self._scene = responses.take(leaders), of_all[leaders]
        self._first = np.append(self._first, self._n_responses + new - n)
        ending = np.bincount(of_response[sample & (first >= 0)], minlength=len(leaders))
        ending[:n] += self._n_ending
        self._n_ending, self._n_responses = ending, self._n_responses + len(scene)
        self._n_starts += np.bincount(scene[sample], minlength=len(self._n_starts))

    def attractors(self, symmetric: ArrayLike) -> Attractors:
        """Return the attractors; within a case by peaks, troughs and period multiples.

        Parameters
        ----------
        symmetric : bool or array_like of bool, shape (n_scenes,)
            Whether the gap is symmetric, so that mirror images of attractors are attractors. Mirror
            images are not searched for systems.
        """
        leaders = Responses.of(()) if self._leaders is None else self._leaders
        order = _order(leaders, self._scene)
        place = np.append(np.argsort(order), NONE)
        scene, leaders = self._scene[order], leaders.take(order)
        number = np.arange(len(order)) - np.searchsorted(scene, scene)
        mirror_of = np.full(len(order), NONE, np.intp)
        if leaders.columns["x_max"].ndim == 1:
            rows = np.flatnonzero(np.broadcast_to(symmetric, self._n_starts.shape)[scene])
            mirror_of[rows] = _mirrors(rows, leaders, scene, number)
        return Attractors(
            of_response=place[np.concatenate([np.zeros(0, np.intp), *self._of_response])],
            scene=scene,
            number=number,
            first=self._first[order],
            leaders=leaders,
            n_ending=self._n_ending[order],
            n_starts=self._n_starts[scene],
            mirror_of=mirror_of,
        )


# --- which are the same ---------------------------------------------------------------------------


def _firsts(responses: Responses, scene: Numbers, unit: Array) -> Numbers:
    """Number of the first response on each response's attractor, `NONE` if it is on none."""
    kind = responses.columns["response_class"]
    states, lengths = responses.lists["section"]
    n_states = len(unit)
    n_points, begin = lengths // n_states, (np.cumsum(lengths) - lengths) // n_states
    points = scaled(states.reshape(-1, n_states), unit[:, np.repeat(scene, n_points)])
    first = np.full(len(scene), NONE, np.intp)
    reach = _reach(responses, unit[:, scene])
    # Without a restoring force every position is an equilibrium, and none is an attractor.
    is_free = (kind == ResponseClass.EQUILIBRIUM) & (responses.columns["lyapunov"] == 0.0)
    for closed in (ResponseClass.PERIODIC, ResponseClass.EQUILIBRIUM):
        is_orbit = (kind == closed) & (n_points > 0) & ~is_free
        for n in np.unique(n_points[is_orbit]).tolist():
            rows = np.flatnonzero(is_orbit & (n_points == n))
            first[rows] = _led(rows, scene, _same_orbits(responses, reach, points, begin, n))
    for cloud in (ResponseClass.CHAOTIC, ResponseClass.QUASIPERIODIC):
        rows = np.flatnonzero((kind == cloud) & (n_points > 0))
        if rows.size:
            first[rows] = _led(rows, scene, _same_clouds(points, begin, n_points))
    return first


def _reach(responses: Responses, unit: Array) -> Array:
    """Scale [m] of each component of a section point, to compare orbits; shape as `unit`.

    A coordinate and its velocity have the coordinate's largest modulus, first-order states that of
    all coordinates: a large coordinate hides no difference in another one, except rounding.
    """
    x_max, x_min = (np.atleast_2d(responses.columns[name].T) for name in ("x_max", "x_min"))
    x = np.maximum(np.abs(x_max), np.abs(x_min))
    own, of_all = x / unit[: len(x)], reach_of(x, unit)
    lags = np.broadcast_to(of_all, (len(unit) - 2 * len(x), len(of_all)))
    return np.asarray(np.maximum(np.concatenate([own, own, lags]), _ROUNDING * of_all))


def _led(rows: Numbers, scene: Numbers, same: Same) -> Numbers:
    """Return, for each response, the first response of its case on the same attractor."""
    order = np.argsort(scene[rows], kind="stable")
    left, led = rows[order], np.empty(len(rows), np.intp)
    places = order
    while left.size:
        where = scene[left]
        is_first = np.diff(where, prepend=NONE) != 0
        leaders = left[np.flatnonzero(is_first)[np.cumsum(is_first) - 1]]
        joins = is_first
        others = np.flatnonzero(~is_first)
        joins[others] = same(leaders[others], left[others])
        led[places[joins]] = leaders[joins]
        left, places = left[~joins], places[~joins]
    return led


def _same_orbits(responses: Responses, reach: Array, points: Array, begin: Numbers, n: int) -> Same:
    """Return the comparison of periodic orbits of n points, or of equilibria."""
    columns = responses.columns
    is_rest = columns["response_class"] == ResponseClass.EQUILIBRIUM
    error = columns["lyapunov_error"]
    noise = np.where(np.isfinite(columns["noise"]), columns["noise"], 0.0)

    def same(a: Numbers, b: Numbers) -> Mask:
        noisy = np.where(error[b] > error[a], error[b], error[a]) > 0.0
        share = np.where(noisy, _SAME_NOISY, np.where(is_rest[a], _SAME_REST, _SAME_ORBIT))
        allowed = np.maximum(share * reach[:, a], DEVIATIONS * np.maximum(noise[a], noise[b]))
        found = np.zeros(len(a), bool)
        for shift in range(n):
            # In most cases the first point decides.
            left = np.flatnonzero(~found)
            for k in range(n):
                i, j = begin[a[left]] + (k - shift) % n, begin[b[left]] + k
                are_near = np.ones(len(left), bool)
                for part, most in zip(points, allowed, strict=True):
                    are_near &= np.abs(part[i] - part[j]) <= most[left]
                left = left[are_near]
            found[left] = True
        return found

    return same


def _same_clouds(points: Array, begin: Numbers, n_points: Numbers) -> Same:
    """Return the comparison of samples of chaotic or quasiperiodic motions."""

    def same(a: Numbers, b: Numbers) -> Mask:
        found = np.empty(len(a), bool)
        sizes = n_points[a] * (n_points.max() + 1) + n_points[b]
        for size in np.unique(sizes).tolist():
            pairs = np.flatnonzero(sizes == size)
            n_a, n_b = (n_points[each[pairs[0]]] for each in (a, b))
            for some in _blocks(pairs, int(n_a * n_b)):
                p = points[:, begin[a[some], None] + np.arange(n_a)]
                q = points[:, begin[b[some], None] + np.arange(n_b)]
                extent = np.max([np.ptp(each, axis=2) for each in (p, q)], axis=(0, 1))
                overlap = cloud_distances(p, q) <= CLOUD_CLOSE * extent
                found[some] = overlap | (own_neighbours(p, q) < _MIXED)
        return found

    return same


def _blocks(rows: Numbers, size: int) -> Iterator[Numbers]:
    """Split rows into parts that need at most `_BLOCK` numbers, with `size` numbers a row."""
    step = max(1, _BLOCK // size)
    return (rows[k : k + step] for k in range(0, len(rows), step))


# --- order and images -----------------------------------------------------------------------------


def _order(leaders: Responses, scene: Numbers) -> Numbers:
    """Return the order of first responses by case, peak, trough and period multiple."""
    # Rounding in Python is slow, and a single attractor needs no order.
    several = np.flatnonzero(np.bincount(scene)[scene] > 1)
    keys = np.zeros((3, len(leaders)))
    for key, name in zip(keys, ("x_max", "x_min", "period_multiple"), strict=True):
        # For a system, of its first coordinate.
        values = np.atleast_2d(leaders.columns[name].T)[0, several].tolist()
        key[several] = [round(value, _DIGITS) for value in values]
    x_max, x_min, n = keys
    return np.lexsort((n, x_min, x_max, scene))


def _mirrors(rows: Numbers, found: Responses, scene: Numbers, number: Numbers) -> Numbers:
    """Return the number of the mirror image of each attractor in `rows`, within the same case.

    The image has the same class and period multiple. All extrema of an orbit are negated; of a
    chaotic attractor only the largest and smallest displacements are compared. `NONE`: no image.

    `rows`: shape (m,); attractors of symmetric models.
    `found`: the first responses of all attractors.
    `scene` and `number`: as in `Attractors`.
    """
    mirror = np.full(len(rows), NONE, np.intp)
    items, lengths = found.lists["extrema"]
    # Extrema of chaotic motions, which have the most, are not compared.
    is_orbit = found.columns["response_class"] != ResponseClass.CHAOTIC
    items, lengths = items[np.repeat(is_orbit, lengths)], np.where(is_orbit, lengths, 0)
    begin, of_item = np.cumsum(lengths) - lengths, np.repeat(np.arange(len(found)), lengths)
    items = items[np.lexsort((items, of_item))]
    ends = [np.searchsorted(scene, scene[rows], side) for side in ("left", "right")]
    n_others = ends[1] - ends[0]
    # Rows are compared in parts of at most one block of pairs, or one row.
    parts = np.cumsum(n_others) // _BLOCK
    for part in np.unique(parts).tolist():
        here = np.flatnonzero(parts == part)
        a, b = np.repeat(here, n_others[here]), spans(ends[0][here], n_others[here])
        is_image = _are_images(rows[a], b, found, items, begin, lengths)
        # The first image of each is kept, since it is written last.
        mirror[a[is_image][::-1]] = number[b[is_image][::-1]]
    return mirror


def _are_images(
    a: Numbers, b: Numbers, found: Responses, extrema: Array, begin: Numbers, lengths: Numbers
) -> Mask:
    """Whether attractors `a` and `b` are mirror images; `extrema` are sorted for each attractor."""
    columns = found.columns
    x_max, x_min, kind = columns["x_max"], columns["x_min"], columns["response_class"]
    is_chaotic = kind[a] == ResponseClass.CHAOTIC
    reach = np.maximum(np.abs(x_max[a]), np.abs(x_min[a]))
    close = np.where(is_chaotic, CLOUD_CLOSE, 2.0 * _SAME_ORBIT) * reach
    apart = np.maximum(np.abs(x_max[b] + x_min[a]), np.abs(x_min[b] + x_max[a]))
    n = columns["period_multiple"]
    may = (kind[a] == kind[b]) & (apart <= close) & (n[a] == n[b])
    is_image = may & is_chaotic
    orbits = np.flatnonzero(may & ~is_chaotic & (lengths[a] == lengths[b]))
    a, b, size = a[orbits], b[orbits], lengths[a[orbits]]
    # The last extremum of one meets the first of the other.
    pair = np.repeat(np.arange(len(orbits)), size)
    up = spans(np.zeros_like(size), size)
    gaps = extrema[begin[b][pair] + up] + extrema[(begin[a] + size - 1)[pair] - up]
    n_off = np.bincount(pair[~(np.abs(gaps) <= close[orbits][pair])], minlength=len(orbits))
    is_image[orbits] = n_off == 0
    return np.asarray(is_image)
