"""`gapsweep.choose`: intervals of a parameter in which demands on steady responses hold.

The margin of a response is negative where all demands hold. A value of the parameter holds if the
largest margin over the band, of all attractors that were found, is not positive. Bisection locates
the values at which this changes. Each of its values starts from the attractors that violated the
demand last: an attractor is followed to its end although no other initial condition leads to it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.continuation.dataset import special_points
from gapsweep.continuation.family import Window
from gapsweep.continuation.follow import branches
from gapsweep.continuation.special import Special
from gapsweep.design.chance import FREQUENCIES as CHANCE_FREQUENCIES
from gapsweep.design.chance import Chance, ChanceSurvey
from gapsweep.design.demands import Demand, margins, quantity
from gapsweep.design.machine import Machine
from gapsweep.errors import ModelError
from gapsweep.integrate.problem import Laws, Model
from gapsweep.integrate.simulate import AnyLaw
from gapsweep.model.arrays import numbers
from gapsweep.model.oscillator import called_as, checked
from gapsweep.quantities import UNITS, without_units, written
from gapsweep.response.result import Response, Responses

Array = NDArray[np.float64]

# Values of the parameter, and frequencies of a band, of the survey.
VALUES, FREQUENCIES = 129, 49
# A maximum between points is higher than the highest one by at most so many times the smaller
# decrease to its neighbours: 1/8 of a parabola, 2.4 of a square root, which ends at a fold.
HIGHER = 4.0
# Distance of neighbouring frequencies, as a share of the band, at which a maximum is located.
CLOSE = 1e-10
# Rounds that add values of the parameter near an extremum of the largest margin.
ROUNDS = 4
LOCATED = 1e-9  # distance of the two sides of an end, as a share of the range
SIZE = 33  # most frequencies of a slice from which the next slice begins
FEW = 9  # fewer frequencies get others between them
ROWS = 20_000  # responses of one call of the engine
REACHED = 1e-6  # relative margin of a limit below which a quantity reaches it
# Near a fold the search for attractors ends at a distance that depends on rtol. The branch gives
# the fold: shares of the range in which it is followed around an end, between its first orbit and
# the end, and within which a special point is the end; and most orbits.
NEAR, AWAY, SAME, STEPS = 0.01, 1e-5, 1e-4, 60
ENDS = {
    Special.FOLD: "fold",
    Special.PERIOD_DOUBLING: "period doubling",
    Special.TORUS: "torus bifurcation",
    Special.SYMMETRY_BREAKING: "symmetry breaking",
    Special.BRANCH_POINT: "branch point",
    Special.BORDER_FOLD: "border fold",
    Special.BORDER_FLIP: "border flip",
}
BEYOND = 1.5  # initial displacements over the walls' distances


@dataclass(frozen=True, slots=True)
class Interval:
    """An interval of the parameter in which all demands hold.

    Attributes
    ----------
    low, high : float
        Ends, in the unit of the parameter.
    low_limit, high_limit : str
        Reason for which a demand fails below and above.
    low_omega, high_omega : float
        Frequency [Hz] at which it fails there; NaN at the end of the range.
    """

    low: float
    high: float
    low_limit: str
    high_limit: str
    low_omega: float
    high_omega: float


@dataclass(frozen=True, slots=True, repr=False)
class Choice:
    """Intervals of a parameter in which demands hold, as returned by `choose`.

    Attributes
    ----------
    parameter : str
    between : tuple of float
        Range that was searched.
    so_that : tuple of Demand or Chance
    intervals : tuple of Interval
        In ascending order; none if the demands hold nowhere.
    nearest : float
        Value of the parameter at which the demands are violated least, or hold best.
    summary : str
        One line: where the demands hold, or that they hold nowhere.

    Examples
    --------
    >>> import gapsweep as gs
    >>> machine = gs.Oscillator(mass=1.0, omega_n=1.0, zeta=0.05, forcing=1.0)
    >>> law = gs.Piecewise(10.0, gs.Gap(0.1, 0.1))
    >>> found = gs.choose(
    ...     "gap", (0.01, 0.2), machine, law, so_that=gs.no_contact(), omega=0.5
    ... )
    >>> [round(each.low, 4) for each in found]
    [0.0337]
    """

    parameter: str
    between: tuple[float, float]
    so_that: tuple[Demand | Chance, ...]
    intervals: tuple[Interval, ...]
    nearest: float
    summary: str

    def __len__(self) -> int:
        return len(self.intervals)

    def __iter__(self) -> Iterator[Interval]:
        return iter(self.intervals)

    def __contains__(self, value: object) -> bool:
        """Whether the demands hold at a value of the parameter."""
        return isinstance(value, int | float) and any(i.low <= value <= i.high for i in self)

    def __repr__(self) -> str:
        lines = [
            f"  {each.low:.9g} .. {each.high:.9g}; below: {each.low_limit}; "
            f"above: {each.high_limit}"
            for each in self.intervals
        ]
        return "\n".join([self.summary, *lines])


@dataclass(slots=True)
class _Slice:
    """The responses with the largest margins at one value of the parameter, over the band."""

    place: float  # of the parameter in its range, 0 to 1
    omega: Array  # shape (k,), ascending
    margin: Array  # shape (k,)
    state: Array  # shape (k, n_states); end states of the responses
    start: Array  # shape (k, n_states); initial states that led to them

    @property
    def worst(self) -> float:
        """Largest margin."""
        return float(self.margin.max())

    @property
    def holds(self) -> bool:
        """Whether all demands hold at these frequencies."""
        return self.worst <= 0.0

    def maxima(self) -> NDArray[np.intp]:
        """Return numbers of local maxima next to which the margin may be positive."""
        padded = np.concatenate([[-np.inf], self.margin, [-np.inf]])
        left, right = padded[:-2], padded[2:]
        is_maximum = (self.margin >= left) & (self.margin >= right)
        drop = np.minimum(self.margin - left, self.margin - right)
        return np.flatnonzero(is_maximum & (self.margin + HIGHER * drop > 0.0))

    def between(self, centre: int, parts: int) -> Array:
        """Return frequencies that divide the intervals on both sides of a frequency."""
        found = [
            np.linspace(self.omega[i], self.omega[i + 1], parts + 1)[1:-1]
            for i in (centre - 1, centre)
            if 0 <= i < len(self.omega) - 1
        ]
        return np.concatenate([np.empty(0), *found])

    def seeds(self, omega: Array) -> Array:
        """Return the states at the neighbours of frequencies, shape (m, 2, n_states)."""
        right = np.clip(np.searchsorted(self.omega, omega), 0, len(self.omega) - 1)
        left = np.maximum(np.searchsorted(self.omega, omega, side="right") - 1, 0)
        return np.stack([self.state[left], self.state[right]], axis=1)

    def with_points(self, *columns: Array) -> _Slice:
        """Return the slice with further frequencies, their margins, states and initial states."""
        own = self.omega, self.margin, self.state, self.start
        every = [np.concatenate(pair) for pair in zip(own, columns, strict=True)]
        order = np.argsort(every[0], kind="stable")
        return _Slice(self.place, *(column[order] for column in every))


class _Survey:
    """Largest margins over a band at values of a parameter."""

    def __init__(
        self,
        machine: Machine,
        window: Window,
        demands: Sequence[Demand],
        band: Array,
        starts: Array,
        *,
        follows: bool,
    ) -> None:
        self.machine, self.window, self.demands = machine, window, demands
        self.band, self.starts, self.follows = band, starts, follows

    def respond(
        self, places: Array, omega: Array, states: Array
    ) -> tuple[Responses, Array, NDArray[np.intp]]:
        """Return responses, their margins and the demands with these."""
        values = self.window.value(places)[:, None]
        models, laws, which = self.machine.parts(values)
        of_rows = [laws[i] for i in which.tolist()]
        if self.follows:
            for i, parts in enumerate(zip(models, laws, strict=True)):
                states = np.where((which == i)[:, None], _inside(*parts, states), states)
        found = self.machine.respond(values, omega, states)
        return found, *margins(self.demands, found, self.machine.family.example, of_rows)

    def worst(
        self, places: Array, omega: Array, seeds: Array, *, starts: bool
    ) -> tuple[Array, Array, Array]:
        """Return the largest margin of each row, its response's end state and initial state.

        `places` and `omega`: shape (m,).
        `seeds`: shape (m, s, n_states); initial states of each row; a survey without following has
        none.
        `starts`: whether all rows start from the initial conditions of the call, too.
        """
        m, _, n = seeds.shape
        states = seeds if self.follows else seeds[:, :0]
        if starts or not self.follows:
            common = np.broadcast_to(self.starts, (m, *self.starts.shape))
            states = np.concatenate([common, states], axis=1)
        s = states.shape[1]
        margin, ends = np.empty((m, s)), np.empty((m, s, n))
        size = max(ROWS // s, 1)
        for first in range(0, m, size):
            rows = slice(first, first + size)
            flat = states[rows].reshape(-1, n)
            found, values, _ = self.respond(
                np.repeat(places[rows], s), np.repeat(omega[rows], s), flat
            )
            margin[rows] = values.reshape(-1, s)
            ends[rows] = np.where(found.has_end[:, None], found.ends, flat).reshape(-1, s, n)
        best = margin.argmax(axis=1)
        at = np.arange(m)
        return margin[at, best], ends[at, best], states[at, best]

    def slices(self, places: Array, known: Sequence[_Slice] = ()) -> list[_Slice]:
        """Return slices over the band at places, from neighbours that are known."""
        m, k = len(places), len(self.band)
        seeds = np.empty((m * k, 0, self.machine.n_states))
        if known:
            of = [each.place for each in known]
            near = np.clip(np.searchsorted(of, places), 1, len(known) - 1)
            sides = [
                np.concatenate([known[i - side].seeds(self.band) for i in near.tolist()])
                for side in (0, 1)
            ]
            seeds = np.concatenate(sides, axis=1)
        found = self.worst(np.repeat(places, k), np.tile(self.band, m), seeds, starts=True)
        margin, state, start = (each.reshape(m, k, *each.shape[1:]) for each in found)
        if self.follows and not known:
            self._spread(places, margin, state, start)
        return [
            _Slice(place, self.band, margin[i], state[i], start[i])
            for i, place in enumerate(places.tolist())
        ]

    def _spread(self, places: Array, margin: Array, state: Array, start: Array) -> None:
        """Follow the responses with the largest margins to neighbours: in frequency, then value."""
        at, of_band = np.meshgrid(places, self.band, indexing="ij")
        for axis in (1, 0):
            n = margin.shape[axis]
            for order in (range(1, n), range(n - 2, -1, -1)):
                step = 1 if order.step > 0 else -1
                for i in order:
                    here, before = ((slice(None),) * axis + (k,) for k in (i, i - step))
                    found = self.worst(
                        at[here], of_band[here], state[before][:, None], starts=False
                    )
                    larger = found[0] > margin[here]
                    for column, values in zip((margin, state, start), found, strict=True):
                        column[here][larger] = values[larger]

    def refined(self, slices: Sequence[_Slice]) -> list[_Slice]:
        """Return slices with the maxima of their margins located, where these may be positive."""
        slices = list(slices)
        shortest = CLOSE * float(np.ptp(self.band))
        while True:
            added = {}
            for i, each in enumerate(slices):
                if not each.holds:
                    continue
                new = [each.between(centre, 4) for centre in each.maxima().tolist()]
                omega = np.unique(np.concatenate([np.empty(0), *new]))
                right = np.searchsorted(each.omega, omega)
                omega = omega[each.omega[right] - each.omega[right - 1] > shortest]
                if omega.size:
                    added[i] = omega
            if not added:
                return slices
            places = np.concatenate([np.full(len(w), slices[i].place) for i, w in added.items()])
            omega = np.concatenate([*added.values()])
            seeds = np.concatenate([slices[i].seeds(w) for i, w in added.items()])
            found = self.worst(places, omega, seeds, starts=False)
            first = 0
            for i, w in added.items():
                rows = slice(first, first + len(w))
                slices[i] = slices[i].with_points(w, *(column[rows] for column in found))
                first += len(w)

    def next_slice(self, place: float, known: _Slice) -> _Slice:
        """Return the slice at a place near one that violates a demand, from its attractors."""
        fails = np.flatnonzero(known.margin > 0.0)
        rows = np.unique(np.clip([fails - 1, fails, fails + 1], 0, len(known.omega) - 1))
        if len(rows) > SIZE:
            rows = rows[np.round(np.linspace(0, len(rows) - 1, SIZE)).astype(int)]
        omega = known.omega[rows]
        if 1 < len(omega) < FEW:
            omega = np.sort(np.concatenate([omega, 0.5 * (omega[1:] + omega[:-1])]))
        at = np.full(len(omega), place)
        found = self.worst(at, omega, known.seeds(omega), starts=True)
        return self.refined([_Slice(place, omega, *found)])[0]

    def end(self, holds: float, known: _Slice) -> tuple[_Slice, _Slice]:
        """Return the slice where a demand begins to fail, and one a little away from there.

        The first slice is at `holds` if the demand fails there, too.

        `holds`: place at which all demands hold as far as known.
        `known`: a slice nearby that violates a demand.
        """
        trail, lost = [known], holds
        towards = LOCATED if holds > known.place else -LOCATED
        while trail[-1].place != holds:
            is_located = abs(lost - trail[-1].place) <= LOCATED
            # A long step may lose an attractor that goes on: a short one beyond the end decides.
            place = 0.5 * (lost + trail[-1].place)
            if is_located:
                place = holds if abs(holds - lost) <= LOCATED else lost + towards
            found = self.next_slice(place, trail[-1])
            if not found.holds:
                trail.append(found)
                lost = holds if is_located else lost
            elif is_located:
                break
            else:
                lost = place
        away = [each for each in trail if abs(each.place - trail[-1].place) > AWAY]
        return trail[-1], away[-1] if away else trail[-1]

    def shown(self, at: _Slice) -> tuple[str, Response, float, bool]:
        """Return what violates the demands most at a slice: in words, its response and margin."""
        i = int(at.margin.argmax())
        omega = at.omega[[i]]
        found, margin, which = self.respond(np.array([at.place]), omega, at.start[[i]])
        demand, row = self.demands[int(which[0])], found.row(0)
        words = f"{row.response_class.name.lower()} response"
        if row.period_multiple > 1:
            words = f"period-{row.period_multiple} response"
        if demand.quantity:
            values = quantity(demand.quantity, found, self.machine.family.example)
            largest = demand.sign * (demand.sign * values).max()
            words = f"{demand.quantity} = {largest:.6g}"
        elif demand.is_graded:
            words = "contact"
        is_reached = demand.is_graded and abs(margin[0]) <= REACHED
        return words, row, float(omega[0]), is_reached

    def reason(self, at: _Slice, away: _Slice) -> tuple[float, str, float]:
        """Return the value of the parameter at an end, what limits the demands, and where [Hz]."""
        words, row, omega, is_reached = self.shown(at)
        value = float(self.window.value(at.place))
        special = None if is_reached else self._special(value, away)
        if special is not None:
            value, event = special
            words = f"{event}, {words}"
        elif not is_reached:
            words = f"jump from {words}"
            if row.status.label != "ok":
                words = f"{row.status.label} response"
        if omega and self.window.name != "omega":
            words += f" at {omega:.6g} Hz"
        return value, words, omega

    def _special(self, value: float, away: _Slice) -> tuple[float, str] | None:
        """Return the place and kind of the special point of a branch near a value.

        It limits the demands only where the frequency is fixed: at an end of the band.
        """
        family, window = self.machine.family, self.window
        i = int(away.margin.argmax())
        omega, at = float(away.omega[i]), float(window.value(away.place))
        if window.name == "omega" or not family.is_forced or omega not in self.band[[0, -1]]:
            return None
        size = window.high - window.low
        near = min(value, at) - NEAR * size, max(value, at) + NEAR * size
        try:
            branch = branches(
                family.model, family.law, window.name, near, at, away.state[i],
                omega=omega, max_steps=STEPS,
            )  # fmt: skip
        except ModelError:  # no orbit near the state, or an invalid value beyond the range
            return None
        points = special_points(branch)
        kinds = points["special"].values
        ends = np.isin(kinds, [*ENDS])
        values = points[window.name].values[ends]
        if not values.size:
            return None
        nearest = int(np.abs(values - value).argmin())
        if abs(values[nearest] - value) > SAME * size:
            return None
        return float(values[nearest]), ENDS[Special(int(kinds[ends][nearest]))]


def _inside(model: Model, laws: Laws, states: Array) -> Array:
    """Return states with displacements that are scaled down to the rigid walls if beyond them.

    Displacements of a response at another value of the parameter may be beyond a rigid wall.
    """
    share = np.ones(len(states))
    for b, law in zip(np.reshape(model.directions, (-1, model.n)), laws, strict=True):
        if law.losses.is_rigid:
            gap = states[:, : model.n] @ b
            walls = np.where(gap > 0.0, law.walls[1], law.walls[0])
            is_beyond = np.abs(gap) > np.abs(walls)
            share = np.minimum(share, np.divide(walls, gap, out=np.ones(len(gap)), where=is_beyond))
    return np.hstack([share[:, None] * states[:, : model.n], states[:, model.n :]])


@called_as("gs.choose('gap', (1e-4, 1e-3), oscillator, law, so_that=gs.at_most('amplitude', 5e-4), "
           "omega=(6.0, 12.0))")  # fmt: skip
def choose(
    parameter: str,
    between: tuple[float, float],
    oscillator: Model | Callable[..., Model],
    law: AnyLaw | None = None,
    *,
    so_that: Demand | Chance | Sequence[Demand],
    omega: float | tuple[float, float] | None = None,
    starts: ArrayLike | None = None,
    rtol: float | None = None,
) -> Choice:
    """Return all intervals of a parameter in which demands hold for the steady responses.

    Parameters
    ----------
    parameter : str
        A field of the oscillator (``"forcing"``) or the law (``"K_c"``, ``"j_1"``, ``"j_2"``, or
        ``"gap"`` for both walls alike), ``"omega"``, or a keyword of the function.
    between : tuple of float
        Range of the parameter, ascending.
    oscillator : Oscillator, System, or callable
        Model, or a function that returns it for keywords, as ``gs.systems.typical_section``.
    law : ContactLaw or mapping of str to ContactLaw
        As in `gapsweep.simulate`; None of a System without contacts.
    so_that : Demand or sequence of Demand
        One demand or several, all of which must hold: `at_most`, `at_least`, `no_contact`,
        `no_chaos`, `periodic`; or one `probability`, without other demands.
    omega : float or tuple of float, optional
        Forcing frequency [Hz], or both ends of a band; None if it is the parameter, or for an
        unforced system.
    starts : array_like, shape (n, n_states), optional
        Initial states: a demand must hold for the responses from only these, as
        ``[[0.0, 0.0]]`` for rest. By default it must hold for every attractor that is found: from
        rest, from beyond either wall, and by following responses up and down in frequency and in
        the parameter.
    rtol : float, optional
        As in `gapsweep.respond`.

    Returns
    -------
    Choice
        Intervals with their ends, accurate to 1e-9 of the range unless solver error is larger, and
        the reason of each end. Intervals narrower than 1/128 of the range may be missed, where the
        largest margin jumps. Unresolved and failed responses violate every demand.

        With a probability, intervals hold where its whole 95 % interval is within the limit, at 33
        values and 13 frequencies of a band; ends are accurate to 1e-4 of the range.

    Raises
    ------
    ModelError
        If an argument is out of range.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> machine = gs.systems.paper_oscillator()
    >>> found = gs.choose(
    ...     "gap", (1e-4, 1e-3), machine, law, so_that=gs.at_most("amplitude", 8e-4), omega=8.0
    ... )
    >>> len(found), 1.8e-4 in found
    (2, True)
    """
    demands = tuple(so_that) if isinstance(so_that, list | tuple) else (so_that,)
    is_chance = len(demands) == 1 and isinstance(demands[0], Chance)
    if any(isinstance(each, Chance) for each in demands) and not is_chance:
        said = "a probability cannot be one of several demands; call gs.choose for each"
        raise ModelError(f"so_that: {said}")
    if not demands or not (is_chance or all(isinstance(each, Demand) for each in demands)):
        said = "must be demands, as gs.at_most('amplitude', 5e-4)"
        raise ModelError(f"so_that = {so_that!r:.80}: {said}")
    omega = without_units("omega", omega)
    window = Window.of(parameter, between)
    band = _band(omega)
    if parameter == "omega" and omega is not None:
        raise ModelError(f"omega = {omega!r}: leave it out, it is the parameter")
    ends = {parameter: (window.low, window.high)}
    machine = Machine.of(oscillator, law, ends, None if omega is None else band, rtol)
    if isinstance(demands[0], Chance):
        if starts is not None or rtol is not None:
            raise ModelError("starts, rtol: leave them out; gs.probability has the initial state")
        return _by_chance(machine, window, demands[0], band, omega)
    laws = machine.family.laws_at({window.name: window.value(0.5)})
    of_contacts = zip(machine.family.example.contacts, laws, strict=True)
    rigid = {name for name, each in of_contacts if each.losses.is_rigid}
    for demand in demands:
        name, _, label = demand.quantity.rstrip("]").partition("[")
        if name == "force_max" and (label in rigid or (rigid and not label)):
            said = "a rigid wall has no largest force; write gs.Piecewise with a large K_c"
            raise ModelError(f"so_that = {demand.words!r}: {said}")
    survey = _Survey(
        machine, window, demands, band, _states(machine, window, starts), follows=starts is None
    )
    slices = _surveyed(survey)
    return _choice(survey, slices, omega)


def _by_chance(machine: Machine, window: Window, chance: Chance, band: Array, omega: Any) -> Choice:
    """Intervals in which the probability of an event is within its limit."""
    rates = None if omega is None else np.unique(np.linspace(band[0], band[-1], CHANCE_FREQUENCIES))
    survey = ChanceSurvey(machine.family, window, chance, rates)
    found, least = survey.intervals()
    intervals = [
        Interval(low, high, below, above, low_omega, high_omega)
        for low, below, low_omega, high, above, high_omega in found
    ]
    nearest = float(window.value(least.place))
    where = _where(window, omega)
    summary = f"{window.name}: {_in_intervals(chance.words, len(found))} of {where}"
    if not found:
        summary = f"{window.name}: '{chance.words}' holds nowhere for certain in {where}; "
        summary += f"least at {nearest:.6g}: {least}"
    ends = window.low, window.high
    return Choice(window.name, ends, (chance,), tuple(intervals), nearest, summary)


def _where(window: Window, omega: Any) -> str:
    """The range of the parameter and the frequencies, in words."""
    where = f"{window.low:g}..{window.high:g} {written(UNITS.get(window.name, ''))}".rstrip()
    if omega is not None:
        where += f", omega {' .. '.join(f'{each:g}' for each in np.ravel(omega))} Hz"
    return where


def _in_intervals(words: str, n: int) -> str:
    return f"{words} in {n} interval{'s' * (n > 1)}"


def _surveyed(survey: _Survey) -> list[_Slice]:
    """Slices at values of the parameter, more of them where their largest margin may pass zero."""
    slices = survey.refined(survey.slices(np.linspace(0.0, 1.0, VALUES)))
    for _ in range(ROUNDS):
        worst = np.array([each.worst for each in slices])
        places = np.array([each.place for each in slices])
        sides = np.stack([worst[1:-1] - worst[:-2], worst[1:-1] - worst[2:]])
        sign = np.where(worst[1:-1] <= 0.0, 1.0, -1.0)
        drop = (sign * sides).min(axis=0)  # to both sides of an extremum towards zero
        near = np.flatnonzero((drop > 0.0) & (HIGHER * drop > np.abs(worst[1:-1]))) + 1
        cells = np.unique(np.concatenate([near - 1, near]))
        if not cells.size:
            break
        parts = np.array([0.25, 0.5, 0.75])
        new = (places[cells, None] + parts * np.diff(places)[cells, None]).ravel()
        found = survey.refined(survey.slices(new, slices))
        slices = sorted([*slices, *found], key=lambda each: each.place)
    return slices


def _choice(survey: _Survey, slices: list[_Slice], omega: Any) -> Choice:
    """Intervals of slices that hold, with their ends located."""
    name, window = survey.window.name, survey.window
    intervals = _intervals(survey, slices)
    words = " and ".join(demand.words for demand in survey.demands)
    where = _where(window, omega)
    best = min(slices, key=lambda each: each.worst)
    nearest = float(window.value(best.place))
    summary = f"{name}: {_in_intervals(words, len(intervals))} of {where}"
    if not intervals:
        shown, _, frequency, _ = survey.shown(best)
        shown += f" at {frequency:.6g} Hz" if len(survey.band) > 1 else ""
        summary = f"{name}: '{words}' holds nowhere in {where}; nearest at {nearest:.6g}: {shown}"
    return Choice(
        name, (window.low, window.high), tuple(survey.demands), tuple(intervals), nearest, summary
    )


def _intervals(survey: _Survey, slices: list[_Slice]) -> list[Interval]:
    """Intervals between the ends of slices that violate a demand."""
    ends: dict[tuple[float, float], tuple[_Slice, _Slice]] = {}
    n = len(slices)
    for i, j in [*pairwise(range(n)), *pairwise(range(n - 1, -1, -1))]:
        known, here = slices[i], slices[j]
        if here.holds and not known.holds:
            found = ends[known.place, here.place] = survey.end(here.place, known)
            if found[0].place == here.place:  # an attractor that nothing else leads to
                slices[j] = found[0]
    holds = np.array([False, *(each.holds for each in slices), False])
    first, last = (np.flatnonzero(holds[:-1] != holds[1:])[k::2] - k for k in (0, 1))
    intervals = []
    for i, j in zip(first.tolist(), last.tolist(), strict=True):
        sides: list[tuple[float, str, float]] = []
        for inside, outside in ((i, i - 1), (j, j + 1)):
            place = slices[inside].place
            if 0 <= outside < len(slices):
                sides.append(survey.reason(*ends[slices[outside].place, place]))
            else:
                sides.append((float(survey.window.value(place)), "end of the range", math.nan))
        (low, below, low_omega), (high, above, high_omega) = sides
        intervals.append(Interval(low, high, below, above, low_omega, high_omega))
    return intervals


def _band(omega: Any) -> Array:
    """Frequencies of the survey [Hz]: one, or those of a band; 0 if there is none."""
    if omega is None:
        return np.zeros(1)
    ends = np.ravel(numbers("omega", omega, "one or two numbers"))
    if len(ends) == 1:
        return np.array([checked("omega", float(ends[0]), low=0.0, strict=True)])
    if len(ends) != 2 or not 0.0 < ends[0] < ends[1] or not np.isfinite(ends).all():
        said = "must be a frequency > 0, or both ends of a band, ascending, as (6.0, 12.0)"
        raise ModelError(f"omega = {omega!r:.80}: {said}")
    return np.linspace(ends[0], ends[1], FREQUENCIES)


def _states(machine: Machine, window: Window, starts: ArrayLike | None) -> Array:
    """Initial states, shape (s, n_states)."""
    n = machine.n_states
    if starts is not None:
        given = numbers("starts", starts, "states")
        if not given.size or given.size % n or not np.isfinite(given).all():
            raise ModelError(f"starts = {starts!r:.80}: must be states of {n} numbers")
        return given.reshape(-1, n)
    displaced = [0.0]
    for law in machine.family.laws_at({window.name: window.value(0.5)}):
        walls = -law.gap.j_1, law.gap.j_2
        displaced += [BEYOND * wall for wall in walls if math.isfinite(wall)]
    return np.unique(np.outer(displaced, np.eye(n)[0]) + 0.0, axis=0)
