"""Intervals of a parameter in which the probability of an event is small.

The probability at each value is from the same samples of the uncertain numbers, so that it changes
with the parameter only. A value holds if the whole 95 % interval of the probability is within the
limit. Bisection locates where this ends, and from where on the whole interval is above the limit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.continuation.family import Family, Window

Array = NDArray[np.float64]

VALUES, FREQUENCIES = 33, 13  # values of the parameter, and frequencies of a band
LOCATED = 1e-4  # width of the bracket of an end, as a share of the range


@dataclass(frozen=True, slots=True, repr=False)
class Chance:
    """A demand on the probability of an event, made by `gapsweep.probability`."""

    words: str
    limit: float  # largest probability
    # Returns probabilities and both ends of their 95 % intervals, shape (3, n_frequencies), for the
    # model, its laws and n frequencies at a value of the parameter; the parameter and the value are
    # its last arguments.
    of: Callable[[Any, Any, Array | None, str, float], Array] = field(compare=False)

    def __repr__(self) -> str:
        return f"<gapsweep.Chance: {self.words}>"


@dataclass(frozen=True, slots=True)
class Judged:
    """Largest probability over frequencies at a place in the range of the parameter."""

    place: float
    probability: float
    low: float
    high: float
    omega: float  # [Hz], where the upper end is largest; 0 if unforced

    def __str__(self) -> str:
        at = f" at {self.omega:.6g} Hz" if self.omega else ""
        return f"P = {self.probability:.3g} ({self.low:.3g} to {self.high:.3g}){at}"


@dataclass(frozen=True, slots=True)
class ChanceSurvey:
    """Probabilities over the range of a parameter."""

    family: Family
    window: Window
    chance: Chance
    omega: Array | None

    def at(self, place: float) -> Judged:
        """Return the largest probability at a place, 0 to 1, in the range."""
        name, value = self.window.name, float(self.window.value(place))
        omega = np.array([value]) if name == "omega" else self.omega
        p, low, high = self.chance.of(*self.family.at({name: value}), omega, name, value)
        worst = int(high.argmax())
        rate = 0.0 if omega is None else float(omega[worst])
        return Judged(place, float(p.max()), float(low.max()), float(high.max()), rate)

    def holds(self, one: Judged) -> bool:
        """Whether the whole interval of the probability is within the limit."""
        return one.high <= self.chance.limit

    def fails(self, one: Judged) -> bool:
        """Whether the whole interval of the probability is above the limit."""
        return one.low > self.chance.limit

    def located(self, inside: Judged, outside: Judged, is_outside: Any) -> tuple[Judged, Judged]:
        """Return neighbouring places between which a test changes, by bisection."""
        while abs(inside.place - outside.place) > LOCATED:
            middle = self.at(0.5 * (inside.place + outside.place))
            inside, outside = (inside, middle) if is_outside(middle) else (middle, outside)
        return inside, outside

    def end(self, several: Sequence[Judged], i: int, step: int) -> tuple[float, str, float]:
        """Return an end of an interval that holds at place i: its value, reason and frequency [Hz].

        `several`: judged places in ascending order.
        `i`: the last one that holds.
        `step`: -1 for the lower end, 1 for the upper end.
        """
        outside = several[i + step :: step] if i + step >= 0 else []
        if not outside:
            return float(self.window.value(several[i].place)), "end of the range", np.nan
        last, _ = self.located(several[i], outside[0], lambda one: not self.holds(one))
        words = f"{self.chance.words}: {last}"
        sure = next((k for k, one in enumerate(outside) if self.fails(one) or self.holds(one)), -1)
        if sure >= 0 and self.fails(outside[sure]):
            before = outside[sure - 1] if sure else last
            _, beyond = self.located(before, outside[sure], self.fails)
            words += f"; above the limit from {self.window.value(beyond.place):.6g}"
        else:
            words += "; undecided beyond"
        return float(self.window.value(last.place)), words, last.omega or np.nan

    def intervals(self) -> tuple[list[tuple[float, str, float, float, str, float]], Judged]:
        """Return ends of all intervals that hold, and the place of the least probability."""
        several = [self.at(place) for place in np.linspace(0.0, 1.0, VALUES).tolist()]
        holds = np.array([False, *map(self.holds, several), False])
        first, after = np.flatnonzero(holds[:-1] != holds[1:]).reshape(-1, 2).T
        found = [
            (*self.end(several, i, -1), *self.end(several, j - 1, 1))
            for i, j in zip(first.tolist(), after.tolist(), strict=True)
        ]
        return found, min(several, key=lambda one: one.high)
