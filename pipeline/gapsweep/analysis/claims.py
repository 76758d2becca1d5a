"""Claims about the results of a run, and their verdicts.

A claim is a function of a `Run` that returns tests and a sentence with the result. A test compares
a number with a threshold. A number has an uncertainty (`floor`) by rounding or sampling; the test
is open if the threshold is within it.
"""

import math
import operator
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from numbers import Real
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from gapsweep.analysis.dimensions import selected
from gapsweep.errors import DatasetError
from gapsweep.status import Status

CONFIRMED, REFUTED, PARTLY, UNDECIDABLE = "confirmed", "refuted", "partly", "undecidable"
VERDICTS = (CONFIRMED, REFUTED, PARTLY, UNDECIDABLE)

_HOLDS = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}
_UNPRINTABLE = re.compile("[\x00-\x1f\x7f\ud800-\udfff]")
_RESPONSES = "responses"
Floats = NDArray[np.float64]


class NotInRunError(Exception):
    """The run lacks data that a claim needs; the claim is undecidable."""


@dataclass(frozen=True, slots=True)
class Number:
    """A number and its uncertainty.

    Attributes
    ----------
    value : float
        The number; NaN if unknown, which leaves its tests open.
    floor : float
        Numerical or sampling uncertainty of the value.
    n : int
        Number of values in the mean.
    each, of : ndarray, optional
        Values of a mean, NaN if unknown, and their coordinates, such as frequencies. Two means over
        the same points are compared in pairs, over the points that both have.
    """

    value: float
    floor: float = 0.0
    n: int = 1
    each: Floats | None = field(default=None, compare=False, repr=False)
    of: Floats | None = field(default=None, compare=False, repr=False)

    def __sub__(self, other: "Number") -> "Number":
        if pairs := self._pairs(other):
            return mean(pairs[0] - pairs[1])
        floor = math.hypot(self.floor, other.floor)
        return Number(self.value - other.value, floor, self.n + other.n)

    def __truediv__(self, other: "Number") -> "Number":
        """The ratio of two numbers that are not negative; NaN if the other is 0."""
        pairs = self._pairs(other)
        values = (self.value, other.value) if pairs is None else pairs
        above, below = (float(np.mean(value)) for value in values)
        n = self.n + other.n if pairs is None else pairs[0].size
        if not below:
            return Number(math.nan, 0.0, n)
        value = above / below
        if pairs is None:
            return Number(value, math.hypot(self.floor, value * other.floor) / below, n)
        return Number(value, _spread(pairs[0] - value * pairs[1]) / below, n)

    def _pairs(self, other: "Number") -> tuple[Floats, Floats] | None:
        """Values of both numbers at their common known points; None if their points differ."""
        if self.each is None or other.each is None or self.each.shape != other.each.shape:
            return None
        if self.of is None or other.of is None or not np.array_equal(self.of, other.of):
            return None
        both = np.isfinite(self.each) & np.isfinite(other.each)
        if not both.any():
            raise NotInRunError("the laws have no common point in this selection")
        return self.each[both], other.each[both]

    def __str__(self) -> str:
        return f"{self.value:.3g}"


def mean(values: ArrayLike, of: ArrayLike | None = None) -> Number:
    """Return the mean of values between -1 and 1, such as shares or their differences.

    The uncertainty is two standard errors with one additional squared deviation of 1, so that
    shares of 0 and 1 of few values are uncertain. It is an upper bound for regular frequency grids.

    Parameters
    ----------
    values : array_like
        Values; NaN if unknown.
    of : array_like, optional
        Coordinate of each value; None uses the coordinate ``omega`` of `values`, if present.
    """
    of = getattr(values, "omega", None) if of is None else of
    each = np.ravel(np.asarray(values, dtype=float))
    found = each[np.isfinite(each)]
    if not found.size:
        raise NotInRunError("the study has no points in this selection")
    value = float(found.mean())
    points = None if of is None else np.ravel(np.asarray(of))
    return Number(value, _spread(found - value), found.size, each, points)


def _spread(deviations: Floats) -> float:
    """Two standard errors of a mean, from the deviations of its values."""
    return 2.0 * math.sqrt(float(np.sum(deviations**2)) + 1.0) / deviations.size


def share(hits: ArrayLike, of: ArrayLike | None = None) -> Number:
    """Return the share of values that are true, as a `mean`; NaN values are unknown."""
    of = getattr(hits, "omega", None) if of is None else of
    each = np.asarray(hits, dtype=float)
    return mean(np.where(np.isnan(each), each, each != 0.0), of)


def ratio_of_sums(numerators: ArrayLike, denominators: ArrayLike) -> Number:
    """Return the ratio of two costs over the same points; uncertainty: two jackknife errors."""
    above, below = (np.ravel(np.asarray(v, dtype=float)) for v in (numerators, denominators))
    both = np.isfinite(above) & np.isfinite(below)
    above, below = above[both], below[both]
    if not below.sum() > 0.0:
        raise NotInRunError("no costs in this selection")
    value, n = float(above.sum() / below.sum()), below.size
    spread = 0.0
    if n > 1:
        without = (above.sum() - above) / (below.sum() - below)
        spread = 2.0 * math.sqrt((n - 1) / n * float(np.sum((without - without.mean()) ** 2)))
    return Number(value, spread, n)


@dataclass(frozen=True, slots=True)
class Test:
    """A comparison of a number with a threshold by the operator `op`.

    Attributes
    ----------
    says : str
        Name of the compared quantity.
    """

    __test__ = False  # pytest must not collect it

    says: str
    number: Number
    op: str
    threshold: float

    def __post_init__(self) -> None:
        _check_texts("a test", says=self.says)
        if not isinstance(self.number, Number):
            raise TypeError(f"a test: number: must be a Number, not {self.number!r:.40}")
        if self.op not in _HOLDS:
            raise ValueError(f"a test: op: must be one of {', '.join(_HOLDS)}, not {self.op!r:.40}")
        if not isinstance(self.threshold, Real):
            raise TypeError(f"a test: threshold: must be a number, not {self.threshold!r:.40}")

    @property
    def holds(self) -> bool | None:
        """Whether the comparison holds; None if the number is unknown or too uncertain."""
        number, margin = self.number, abs(self.number.value - self.threshold)
        if math.isnan(margin) or (number.floor and not number.floor < margin):
            return None
        return bool(_HOLDS[self.op](number.value, self.threshold))


Others = Mapping[str, list[Test]]
Found = tuple[list[Test], str] | tuple[list[Test], str, Others]


@dataclass(frozen=True, slots=True)
class Claim:
    """A statement, and a function that returns the tests which decide it.

    Attributes
    ----------
    id : int
    place : str
        Figure, table or section of the publication.
    text : str
        The claim, paraphrased.
    why : str
        The quoted sentence or figure, and reasons for tests and thresholds.
    find : callable
        Function from a `Run` to tests and a sentence with the result. Without tests the sentence
        names the missing information. If a setting is not known, such as an initial condition, the
        tests with its other values are a third result, by the words for each value.
    """

    id: int
    place: str
    text: str
    why: str
    find: Callable[["Run"], Found]

    def __post_init__(self) -> None:
        if not isinstance(self.id, int) or isinstance(self.id, bool) or self.id < 1:
            raise ValueError(f"claim {self.id!r:.40}: id: must be a whole number from 1")
        _check_texts(f"claim {self.id}", place=self.place, text=self.text, why=self.why)

    def decided(self, run: "Run") -> dict[str, Any]:
        """Return the claim with its verdict, as in ``claims.json``."""
        try:
            tests, sentence, others = _checked(self.find(run))
        except NotInRunError as missing:
            tests, sentence, others = [], f"Not decided: {missing}.", {}
        found = verdict(test.holds for test in tests)
        if unsettled := [test.says for test in tests if test.holds is None]:
            more = f" and {len(unsettled) - 3} more" if len(unsettled) > 3 else ""
            sentence += (
                f" Open (no number, or within its uncertainty): {'; '.join(unsettled[:3])}{more}."
            )
        return {
            "id": self.id,
            "place": self.place,
            "claim": self.text,
            "verdict": found,
            "sentence": sentence,
            "why": self.why,
            "otherwise": {words: verdict(test.holds for test in o) for words, o in others.items()},
            "tests": [_as_json(test) for test in tests],
        }


def _checked(found: Any) -> tuple[list[Test], str, Others]:
    """Tests, sentence and tests with other settings that a claim's function has returned.

    Raises `TypeError` if they have other types.
    """
    others = found[2] if isinstance(found, tuple) and len(found) == 3 else {}
    if not (
        isinstance(found, tuple)
        and len(found) in (2, 3)
        and isinstance(others, Mapping)
        and all(_are_tests(tests) for tests in (found[0], *others.values()))
    ):
        raise TypeError(
            f"must return a list of tests, a sentence, and at most a dict of lists of tests, "
            f"not {found!r:.40}"
        )
    _check_texts(
        "result", sentence=found[1], **{f"setting {words!r:.40}": words for words in others}
    )
    return found[0], found[1], others


def _are_tests(tests: Any) -> bool:
    return isinstance(tests, list) and all(isinstance(test, Test) for test in tests)


def _check_texts(whose: str, **texts: Any) -> None:
    for name, text in texts.items():
        if not isinstance(text, str):
            raise TypeError(f"{whose}: {name}: must be text, not {text!r:.40}")
        if found := _UNPRINTABLE.search(text):
            raise ValueError(f"{whose}: {name}: must be one printable line, without {found[0]!r}")


def stated(names: Mapping[str, Any]) -> list[Claim]:
    """Return the claims of a module in the order of their ids.

    Raises
    ------
    ValueError
        If there are none, or two have one id.
    """
    found = list(
        {id(value): value for value in names.values() if isinstance(value, Claim)}.values()
    )
    twice = [str(n) for n, count in Counter(one.id for one in found).items() if count > 1]
    if not found:
        raise ValueError(
            "no claims; define functions with the decorator @claim, see docs/explanation/claims.md"
        )
    if twice:
        raise ValueError(f"claim {', '.join(twice)}: must have different numbers")
    return sorted(found, key=lambda one: one.id)


def claim(id: int, place: str, text: str, why: str) -> Callable[[Callable[["Run"], Found]], Claim]:
    """Return a decorator that replaces a function by a `Claim` with it as `find`."""
    return lambda find: Claim(id, place, text, why, find)


def verdict(holds: Iterable[bool | None]) -> str:
    """Return ``confirmed`` if all tests hold, ``refuted`` if no decided test does, else ``partly``.

    ``undecidable``: no test is decided, or most are open and the decided tests agree.
    """
    outcomes = list(holds)
    decided = {outcome for outcome in outcomes if outcome is not None}
    if not decided or (len(decided) == 1 and 2 * outcomes.count(None) > len(outcomes)):
        return UNDECIDABLE
    if True not in decided:
        return REFUTED
    return CONFIRMED if all(outcomes) else PARTLY


def counted(decided: list[dict[str, Any]]) -> dict[str, Any]:
    """Return decided claims and the number of claims per verdict, for JSON.

    ``otherwise`` has these numbers with each other setting; a claim without a verdict for it counts
    with its own.
    """

    def counts(words: str) -> dict[str, int]:
        found = Counter(one["otherwise"].get(words, one["verdict"]) for one in decided)
        return {name: found[name] for name in VERDICTS}

    others = dict.fromkeys(words for one in decided for words in one["otherwise"])
    return {
        "counts": counts(""),
        "otherwise": {words: counts(words) for words in others},
        "claims": decided,
    }


def _as_json(test: Test) -> dict[str, Any]:
    number = test.number
    return {
        "says": test.says,
        "value": _finite(number.value),
        "floor": _finite(number.floor),
        "op": test.op,
        "threshold": _finite(test.threshold),
        "holds": test.holds,
        "n": int(number.n),
    }


def _finite(number: float) -> float | None:
    return float(number) if math.isfinite(number) else None


@dataclass(frozen=True)
class Run:
    """The datasets of a run, each read at first use.

    Attributes
    ----------
    datasets : mapping of str to Dataset
        Datasets by file name without suffix.
    """

    datasets: Mapping[str, xr.Dataset]
    _read: dict[Any, xr.Dataset] = field(default_factory=dict, repr=False)

    def __getitem__(self, name: str) -> xr.Dataset:
        if name not in self.datasets:
            raise NotInRunError(f"the run has no {name}.nc")
        return self.datasets[name]

    def select(self, name: str, *names: str, **at: Any) -> xr.Dataset:
        """Return a part of a dataset by coordinates, in memory, with all or some variables.

        Values are compared as by `gapsweep.Study.select`.

        Raises
        ------
        NotInRunError
            If the run has no such dataset, variables or labels.
        """
        key = (name, *names, *sorted(at.items()))
        if key not in self._read:
            dataset = self[name]
            if missing := [one for one in names if one not in dataset.variables]:
                raise NotInRunError(f"{name}.nc has no {', '.join(missing)}")
            try:
                found = dataset[list(names)] if names else dataset
                self._read[key] = selected(found, at).load()
            except DatasetError:
                where = ", ".join(f"{dim} {label}" for dim, label in at.items())
                raise NotInRunError(f"{name}.nc has no values at {where}") from None
        return self._read[key]

    def scene(
        self, name: str, representation: str, K_c: float, gap: str | None, *names: str, **at: Any
    ) -> xr.Dataset:
        """Return variables (`names`) of one representation in one case of a dataset (`name`).

        If the study sweeps wall distances, `gap` is None and ``j_1=``, ``j_2=`` [m] are arguments,
        as is every other swept parameter, as ``forcing=3.0``.
        """
        walls = {} if gap is None else {"gap": gap}
        here = {"representation": representation, "K_c": K_c, **walls, **at}
        return self.select(name, *names, **here)

    @cached_property
    def starts(self) -> dict[str, Any]:
        """Masks of the initial conditions: ``rest``, ``scattered`` (fixed, not rest), sweeps."""
        responses = self[_RESPONSES]
        kind = responses["start"].values.astype(str)
        fixed = kind == "fixed"
        rest = fixed & (responses["x_0"].values == 0.0) & (responses["v_0"].values == 0.0)
        sweeps = {name: kind == name for name in ("sweep_up", "sweep_down")}
        return {"rest": rest, "scattered": fixed & ~rest, "any": np.ones_like(fixed), **sweeps}

    def points(
        self,
        representation: str,
        K_c: float,
        gap: str | None,
        *names: str,
        band: tuple[float, float] = (0.0, math.inf),
        start: str | NDArray[np.bool_] = "rest",
        data: str = _RESPONSES,
        **at: Any,
    ) -> xr.Dataset:
        """Return sweep points of the study, along the dimension ``point``.

        Parameters
        ----------
        names : str
            Variables over frequency and initial condition.
        band : tuple of float
            Closed interval of frequencies [Hz].
        start : str or ndarray of bool
            A key of `starts`, or a mask of initial conditions.
        **at
            Values of the other swept parameters, as for `scene`.

        Raises
        ------
        NotInRunError
            If the study has no such point.
        """
        scene = (representation, K_c, gap)
        starts = self.starts[start] if isinstance(start, str) else start
        key = (data, *scene, *names, band, starts.tobytes(), *sorted(at.items()))
        if key not in self._read:
            status = self.scene(_RESPONSES, *scene, "status", **at)["status"]
            found = self.scene(data, *scene, *names, **at).assign(asked=status)
            found = found.sel(omega=slice(*band)).isel(initial_condition=starts)
            found = found.stack(point=("omega", "initial_condition"), create_index=False)
            self._read[key] = found.isel(point=found["asked"].values != Status.NOT_REQUESTED)
        if not self._read[key].sizes["point"]:
            raise NotInRunError(f"no points of {representation} at {K_c:g} N/m, {gap} mm")
        return self._read[key]
