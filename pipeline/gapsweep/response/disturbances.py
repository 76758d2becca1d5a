"""Smallest disturbance of a state on an attractor after which the motion leaves the attractor.

The distance of two states is the Euclidean norm in metres of the section: each component of their
difference is divided by its value for a motion of one metre (`Ensemble.unit`), so that a velocity
counts as the amplitude of a motion with this velocity at the forcing frequency. Rays from every
section point are scanned up to a largest distance, the interval before the first disturbance that
leaves is divided again and again, and the direction is refined. Between two neighbouring trials, a
thin tongue of another basin may be missed: the result is an upper bound.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gapsweep.response.attractors import NONE, Grouping
from gapsweep.response.ragged import spans
from gapsweep.response.result import ResponseClass, Responses
from gapsweep.response.section import norm
from gapsweep.status import Status
from gapsweep.variables import COORDINATE, LAG, Variable

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Numbers = NDArray[np.intp]
# Function of attractors, given by their numbers, and of states, shape (m, n_states): responses.
Answer = Callable[[Numbers, Array], Responses]

_OF_STATES = (
    ("x", "m", "displacement", COORDINATE),
    ("v", "m s-1", "velocity", COORDINATE),
    ("z", "", "first-order state", LAG),
)
# Variables of attractors.
DISTURBANCES = {
    "disturbance": Variable(
        "f8", "m", "norm of the smallest disturbance found that leaves the attractor"
    ),
    **{
        f"{name}_{of}": Variable("f8", units, text.format(state), dims=(dim,))
        for name, text in (
            ("disturbance", "part of the smallest disturbance, a {0}"),
            ("disturbed", "{0} on the attractor that is disturbed, at forcing phase zero"),
            ("single_down", "smallest decrease of one {0}, without other changes, that leaves"),
            ("single_up", "smallest increase of one {0}, without other changes, that leaves"),
        )
        for of, units, state, dim in _OF_STATES
    },
}

_PARTS = 16  # of an interval; their ends are computed in one call
_AT_ONCE = 1 << 16  # motions of a call
_FINE = 64  # of a ray along one state
_DIVISIONS = 8  # of an interval: to 16^-8, 2e-10 of the largest distance
_WIDEST, _NARROWEST = 0.2, 1e-4  # rad: directions tried next to the best one
_SHARES = np.array([1.0, 0.5, 0.25, 0.125])  # of the width
_TURNS = 24  # at most
_LEAST = 1e-9  # relative gain
_ROUNDS = 4  # of rays in new directions


@dataclass(frozen=True, slots=True, eq=False)
class Disturbances:
    """The smallest disturbances that leave n attractors; NaN where none was found."""

    size: Array  # shape (n,); norm of the disturbance [m]
    # Shape (n, n_states); state on the attractor that is disturbed, at forcing phase zero.
    state: Array
    change: Array  # shape (n, n_states); disturbance, added to `state`
    # Shape (n, n_states, 2); smallest changes of one state and no other, down and up, each in the
    # unit of the state.
    single: Array

    def arrays(self, n_coordinates: int) -> dict[str, Array]:
        """Return the values of `DISTURBANCES`; those of a single coordinate have shape (n,)."""
        down, up = np.moveaxis(self.single, -1, 0)
        parts = {"disturbance": self.change, "disturbed": self.state}
        found = {"disturbance": self.size}
        for name, values in (parts | {"single_down": down, "single_up": up}).items():
            split = np.split(values, [n_coordinates, 2 * n_coordinates], axis=1)
            for of, part in zip(_OF_STATES, split, strict=True):
                if part.shape[1]:
                    found[f"{name}_{of[0]}"] = part[:, 0] if part.shape[1] == 1 else part
        return found


def smallest_disturbances(
    leaders: Responses, unit: Array, starts: Array, n_rays: int, answer: Answer
) -> Disturbances:
    """Return the smallest disturbances that leave attractors, found by search.

    A motion has left if its response is on another attractor, or if it diverges. Unresolved and
    failed responses count as not left.

    Parameters
    ----------
    leaders : Responses, length n
        A response on each attractor.
    unit : ndarray, shape (n_states, n)
        As in `Ensemble`.
    starts : ndarray, shape (n_starts, n_states)
        Initial states: disturbances are searched up to the farthest one from each attractor.
    n_rays : int
        Number of rays from every section point of a periodic orbit or equilibrium, and from the
        first one of other attractors.
    answer : callable
        Function of numbers of attractors, shape (m,), and states, shape (m, n_states), that returns
        the responses of the attractors' models from these states.
    """
    return _Search(leaders, unit, starts, answer).found(n_rays)


class _Search:
    """The search for n attractors at once, with the best disturbance of each so far.

    `of` has the attractor, `base` the state and `far` the farthest disturbance of every section
    point.
    """

    def __init__(self, leaders: Responses, unit: Array, starts: Array, answer: Answer) -> None:
        self._leaders, self._unit, self._answer = leaders, unit, answer
        n, n_states = unit.shape[1], len(unit)
        items, lengths = leaders.lists["section"]
        kind, counts = leaders.columns["response_class"], lengths // n_states
        is_orbit = np.isin(kind, (ResponseClass.PERIODIC, ResponseClass.EQUILIBRIUM))
        first, counts = np.cumsum(counts) - counts, np.where(is_orbit, counts, counts > 0)
        self.of = np.repeat(np.arange(n), counts)
        self.base = items.reshape(-1, n_states)[spans(first, counts)]
        pairs = zip(self.base, unit.T[self.of], strict=True)
        far = [norm((starts - y).T / one[:, None]).max() for y, one in pairs]
        self.far, self.size = np.array(far), np.full(n, np.inf)
        self.start, self.direction = np.zeros(n, np.intp), np.zeros((n, n_states))

    def found(self, n_rays: int) -> Disturbances:
        """Return the disturbances after all rounds."""
        n_states, n = self._unit.shape
        axes = np.concatenate([-np.eye(n_states), np.eye(n_states)])
        bases, directions = self._crossed(axes)
        radii = self._first_leaving(bases, directions, self.far[bases], _FINE)
        self._keep(bases, directions, radii)
        single = np.full((n, 2 * n_states), np.inf)
        np.minimum.at(single, self.of, radii.reshape(-1, 2 * n_states))
        for rays in _rays(n_states, n_rays):
            bases, directions = self._crossed(rays)
            far = np.minimum(self.size[self.of[bases]], self.far[bases])
            if self._improve(bases, directions, far, _FINE).size:
                self._refine()
        size, single = (np.where(np.isinf(each), np.nan, each) for each in (self.size, single))
        sides = single.reshape(n, 2, n_states).transpose(0, 2, 1) * self._unit.T[:, :, None]
        return Disturbances(
            size=size,
            state=self.base[self.start] if len(self.base) else self.direction,
            change=size[:, None] * self.direction * self._unit.T,
            single=sides * np.array([-1.0, 1.0]),
        )

    def _refine(self) -> None:
        """Turn the best directions until their rays leave at the smallest radius."""
        width = np.full(len(self.size), _WIDEST)
        for _ in range(_TURNS):
            some = np.flatnonzero((width > _NARROWEST) & np.isfinite(self.size))
            if not some.size:
                break
            steps = np.concatenate([_tangents(self.direction[i]) for i in some.tolist()])
            owner = np.repeat(some, len(steps) // len(some))
            share = np.tile(_SHARES, len(steps))
            owner, steps = np.repeat(owner, len(_SHARES)), np.repeat(steps, len(_SHARES), axis=0)
            directions = self.direction[owner] + (share * width[owner])[:, None] * steps
            directions /= norm(directions.T)[:, None]
            best = self._improve(self.start[owner], directions, self.size[owner], _PARTS)
            moved = np.zeros(len(width))
            moved[owner[best]] = share[best]
            width[some] = np.where(moved[some] == 1.0, width[some], 0.25 * width[some])

    def _improve(self, bases: Numbers, directions: Array, far: Array, parts: int) -> Numbers:
        """Keep the best of some rays where it leaves before the best one so far."""
        radii = self._first_leaving(bases, directions, far, parts, only_best=True)
        return self._keep(bases, directions, radii)

    def _keep(self, bases: Numbers, directions: Array, radii: Array) -> Numbers:
        """Keep the rays with the smallest radii, where smaller than before; return their rows."""
        order = np.lexsort((radii, self.of[bases]))
        _, first = np.unique(self.of[bases[order]], return_index=True)
        best = order[first]
        best = best[radii[best] < (1.0 - _LEAST) * self.size[self.of[bases[best]]]]
        of = self.of[bases[best]]
        self.size[of], self.direction[of], self.start[of] = (
            radii[best],
            directions[best],
            bases[best],
        )
        return best

    def _crossed(self, directions: Array) -> tuple[Numbers, Array]:
        """Return all pairs of section points and directions."""
        bases = np.arange(len(self.of))
        return np.repeat(bases, len(directions)), np.tile(directions, (len(bases), 1))

    def _first_leaving(
        self, bases: Numbers, directions: Array, far: Array, parts: int, *, only_best: bool = False
    ) -> Array:
        """Return the smallest radii at which rays were seen to leave, shape (m,); infinite: none.

        Each interval is divided, and the part before its first radius that leaves is the next one.
        With `only_best`, rays that cannot be the best of their attractor are dropped on the way.
        """
        of = self.of[bases]
        low, high, leaves = np.zeros(len(of)), far.copy(), np.zeros(len(of), bool)
        for division in range(_DIVISIONS):
            here = np.flatnonzero(leaves) if division else np.arange(len(of))
            if only_best and division:
                best = np.full(len(self.size), np.inf)
                np.minimum.at(best, of[here], high[here])
                here = here[low[here] < best[of[here]]]
            if not here.size:
                break
            n = parts if division == 0 else _PARTS
            # The last radius of an interval is known to leave, except the farthest one of a ray.
            shares = np.arange(1, n + (division == 0)) / n
            radii = low[here, None] + (high - low)[here, None] * shares
            is_out = self._leaves(bases[here], directions[here], radii)
            leaves[here] |= is_out.any(axis=1)
            first = np.where(is_out.any(axis=1), is_out.argmax(axis=1), len(shares))
            ends = np.column_stack([low[here], radii, high[here]])
            rows = np.arange(len(here))
            low[here], high[here] = ends[rows, first], ends[rows, first + 1]
        return np.where(leaves, high, np.inf)

    def _leaves(self, bases: Numbers, directions: Array, radii: Array) -> Mask:
        """Whether motions leave their attractors, disturbed by radii, shape (m, k)."""
        found, step = np.zeros(radii.shape, bool), max(1, _AT_ONCE // radii.shape[1])
        for first in range(0, len(radii), step):
            some = slice(first, first + step)
            of = self.of[bases[some]]
            along = directions[some] * self._unit.T[of]
            states = self.base[bases[some], None] + radii[some, :, None] * along[:, None]
            rows = np.repeat(of, radii.shape[1])
            there = self._answer(rows, states.reshape(len(rows), -1))
            found[some] = self._is_elsewhere(rows, there).reshape(-1, radii.shape[1])
        return found

    def _is_elsewhere(self, of: Numbers, found: Responses) -> Mask:
        """Whether responses are on another attractor than those of numbers `of`, or diverge."""
        n, grouping = len(self._leaders), Grouping(self._unit)
        grouping.add(self._leaders, np.arange(n))
        grouping.add(found, of)
        own, number = np.split(grouping.attractors(False).of_response, [n])
        is_other = (number != NONE) & (number != own[of])
        return np.asarray(is_other | (found.columns["status"] == Status.DIVERGED))


def _rays(n_states: int, n: int) -> Iterator[Array]:
    """Yield unit vectors in n directions for every round, shape (n, n_states).

    In a plane they have equal angles, turned from round to round, else random directions.
    """
    for number in range(_ROUNDS):
        if n_states == 2:
            angle = 2.0 * np.pi * (np.arange(n) + number / _ROUNDS) / n
            yield np.column_stack([np.cos(angle), np.sin(angle)])
        else:
            found = np.random.default_rng([1, number]).standard_normal((n, n_states))
            yield found / norm(found.T)[:, None]


def _tangents(direction: Array) -> Array:
    """Return unit vectors perpendicular to a direction, with both signs."""
    _, _, rows = np.linalg.svd(direction[None])
    return np.concatenate([rows[1:], -rows[1:]])
