"""Samples of uncertain numbers: an axis of which each label stands for several numbers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.variables import canonical_values

Array = NDArray[np.float64]

SAMPLE = "sample"
DRAWN = "drawn_"  # beginning of the coordinate with the drawn values of a number
# Matrices of the design: two independent sets of samples; B with the column of the i-th number
# replaces that column of A in matrix 2 + i.
A, B, MIXED = 0, 1, 2
_SMALLEST = 2.0**-33  # share of a distribution: Sobol points may be 0, where it may be infinite


class Distribution(Protocol):
    """A continuous distribution, as those of `scipy.stats` with all arguments."""

    def ppf(self, q: Any, /) -> Any:
        """Return the values below which the shares q of the distribution lie."""

    def cdf(self, x: Any, /) -> Any:
        """Return the shares of the distribution up to the values x."""


@dataclass(frozen=True, slots=True)
class Measured:
    """The distribution of measured values, linear between their sorted values."""

    values: tuple[float, ...]

    def ppf(self, q: Any) -> Any:
        """Return the values below which the shares q of the distribution lie."""
        return np.quantile(np.array(self.values), q)

    def cdf(self, x: Any) -> Any:
        """Return the shares of the distribution up to the values x."""
        ordered = np.sort(self.values)
        return np.interp(x, ordered, np.linspace(0.0, 1.0, len(ordered)), left=0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Samples(Sequence[int]):
    """n samples of uncertain numbers."""

    numbers: Mapping[str, Array]  # shape (n,); drawn values by name of the uncertain number
    # `matrix`, `repeat`, `row`: shape (n,); matrix of the design (`A`, `B`, `MIXED` + i); repeat;
    # place among the Sobol points.
    matrix: NDArray[np.int32]
    repeat: NDArray[np.int32]
    row: NDArray[np.int32]
    # How a drawn value acts on the value of the study, ``"plus"`` or ``"times"``; without an entry
    # it replaces that value.
    nominal: Mapping[str, str]
    number: NDArray[np.int32]  # shape (n,); labels

    def __len__(self) -> int:
        return len(self.number)

    def __getitem__(self, number: Any) -> Any:
        """Label of a sample."""
        return self.number[number]

    def take(self, some: Any) -> "Samples":
        """Return some of the samples, with their labels."""
        columns = {n: getattr(self, n)[some] for n in ("matrix", "repeat", "row", "number")}
        return replace(self, numbers={n: of[some] for n, of in self.numbers.items()}, **columns)

    def combined(self, name: str, value: Any, places: NDArray[np.intp]) -> Any:
        """Return the values of a number at samples, or its value in the study if it is certain.

        Parameters
        ----------
        value : array_like, shape () or (n,)
            In the study.
        places : ndarray of int, shape (n,)
            Samples.
        """
        if name not in self.numbers:
            return value
        drawn, nominal = self.numbers[name][places], self.nominal.get(name)
        if nominal is None:
            return drawn
        return canonical_values(drawn + value if nominal == "plus" else drawn * value)


def drawn(
    distributions: Mapping[str, Distribution],
    samples: int,
    repeats: int,
    seed: int,
    *,
    indices: bool = False,
    correlation: ArrayLike | None = None,
    nominal: Mapping[str, str] | None = None,
) -> Samples:
    """Draw samples of uncertain numbers: scrambled Sobol points in independent repeats.

    The first samples of a repeat do not depend on their number.

    Parameters
    ----------
    samples : int
        Sobol points of a repeat, a power of two.
    indices : bool
        Whether to add the samples that Sobol indices need: ``2 + d`` times as many for d numbers.
    correlation : array_like, shape (d, d), optional
        Of the normal scores of the numbers (Gaussian copula); None: independent.
    nominal : dict of str to str, optional
        As of `Samples`.
    """
    from scipy.special import ndtr, ndtri
    from scipy.stats import qmc  # a second to import, and few studies need it

    d, parts = len(distributions), []
    for repeat in range(repeats):
        rng = np.random.default_rng([seed, repeat])
        sobol = qmc.Sobol((1 + indices) * d, scramble=True, rng=rng)
        shares = np.clip(sobol.random(samples), _SMALLEST, 1.0 - _SMALLEST)
        if correlation is not None:
            scores = ndtri(shares) @ np.linalg.cholesky(np.asarray(correlation, float)).T
            shares = np.clip(ndtr(scores), _SMALLEST, 1.0 - _SMALLEST)
        first, second = shares[:, :d], shares[:, d:]
        matrices = [first, second] if indices else [first]
        for i in range(d * indices):
            matrices.append(first.copy())
            matrices[-1][:, i] = second[:, i]
        parts.append(np.stack(matrices))
    shares = np.concatenate([np.concatenate(each) for each in parts])
    # The same numbers on all machines, although their last bits vary.
    numbers = {
        name: canonical_values(of.ppf(shares[:, i]))
        for i, (name, of) in enumerate(distributions.items())
    }
    of_repeat, matrix, row = np.indices((repeats, len(parts[0]), samples), np.int32).reshape(3, -1)
    label = np.arange(len(shares), dtype=np.int32)
    return Samples(numbers, matrix, of_repeat, row, nominal or {}, label)
