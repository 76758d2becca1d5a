"""The identity of an orbit: its states on a section, and what the section repeats or mirrors."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gapsweep.continuation.thresholds import ALIKE, UNLIKE

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Identity:
    """Section and asymmetry of an orbit, which distinguish it at its parameter values."""

    # Shape (k, n_states); states in order of time, as shares of the size of the state: at whole
    # forcing periods; of an unforced orbit at the maxima of its first coordinate.
    section: Array
    # Largest sum of the extreme values of a coordinate, as a share of its size; zero of an orbit
    # that is its own mirror image.
    asymmetry: float

    def repeats(self, length: int) -> float:
        """Largest distance of section points that are `length` points apart; inf of the whole."""
        if len(self.section) % length or length == len(self.section):
            return np.inf
        return float(np.abs(np.roll(self.section, -length, axis=0) - self.section).max())

    @property
    def halves(self) -> float:
        """Distance of the second half of the orbit from the first half."""
        k = len(self.section)
        return self.repeats(k // 2) if k > 1 and k % 2 == 0 else np.inf

    @property
    def prime(self) -> int:
        """Section points after which the orbit repeats itself."""
        k = len(self.section)
        return next((n for n in range(1, k) if self.repeats(n) <= ALIKE), k)

    @property
    def is_prime(self) -> bool:
        """Whether the orbit repeats itself after its period, not before."""
        return self.prime == len(self.section)

    def is_same(self, other: "Identity", within: float = ALIKE) -> bool:
        """Whether another orbit at the same parameter values is this one, in any phase."""
        apart = np.abs(self.section[:1] - other.section).max(axis=1)
        return bool(apart.min() <= within)

    def is_part_of(self, before: "Identity") -> bool:
        """Whether an orbit may lie on a branch with another one: both repeat themselves, or not."""
        return self.is_prime or not before.is_prime

    def is_kept(self, after: "Identity") -> bool:
        """Whether an orbit and the next one of a branch are both alike in their halves, or neither,
        and both symmetric, or neither.
        """
        pairs = (self.halves, after.halves), (self.asymmetry, after.asymmetry)
        return not any(min(pair) < ALIKE / 10.0 and max(pair) > UNLIKE for pair in pairs)
