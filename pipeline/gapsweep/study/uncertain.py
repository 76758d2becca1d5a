"""The table ``[uncertain]`` of a study: distributions of numbers, and events."""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, ValidationError, model_validator

from gapsweep.errors import ModelError, StudyError
from gapsweep.model.arrays import factor_of, read_columns
from gapsweep.model.contact import OF_WALLS
from gapsweep.model.labels import unknown_number
from gapsweep.model.structure import AnyStructure
from gapsweep.quantities import UNITS, without_units
from gapsweep.response.result import RESPONSE, ResponseClass, columns_of
from gapsweep.study.axes import MAX_VALUES, Number, Positive, Range, TomlTable
from gapsweep.study.oscillator_table import OscillatorTable
from gapsweep.study.problems import problems
from gapsweep.study.samples import Distribution, Measured, Samples, drawn
from gapsweep.study.units import ratios

_CLASSES = tuple(one.name.lower() for one in ResponseClass)
_KINDS = ("normal", "lognormal", "uniform", "triangular", "truncated", "data")
_NEEDS = {"normal": ("sd",), "lognormal": ("sd",), "truncated": ("sd", "low", "high"), "data": ()}
_EXAMPLE = "{ normal = 0.4e-3, sd = 0.02e-3 }"
_OF_CONTACTS = ("gap", "j_1", "j_2", "K_c", *OF_WALLS)
# Share of a distribution that may lie outside the range of its number.
_MOST_OUTSIDE = 1e-9


class DistributionTable(TomlTable):
    """The distribution of a number; exactly one of its kinds must be set."""

    normal: Number | Range | None = None  # mean; a pair for both walls of a gap, drawn separately
    lognormal: Positive | Annotated[list[Positive], Field(min_length=2, max_length=2)] | None = None
    uniform: Range | None = None
    triangular: Annotated[list[Number], Field(min_length=3, max_length=3)] | None = None
    truncated: Number | None = None  # mean of a normal one that is cut at low and high
    data: Annotated[list[Number], Field(min_length=2, max_length=MAX_VALUES)] | None = None
    sd: Positive | None = None  # of the logarithm for lognormal
    low: Number | None = None
    high: Number | None = None
    nominal: Literal["plus", "times"] | None = None

    @model_validator(mode="before")
    @classmethod
    def _without_units(cls, given: Any) -> Any:
        names = ratios(given) if isinstance(given, Mapping) else []
        return {**given, **{n: without_units(n, given[n], "1") for n in names}} if names else given

    @model_validator(mode="after")
    def _one_kind(self) -> "DistributionTable":
        given = [name for name in _KINDS if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"give one of {', '.join(_KINDS)}, as {_EXAMPLE}")
        needs = _NEEDS.get(self.kind, ())
        for name in ("sd", "low", "high"):
            if (getattr(self, name) is None) == (name in needs):
                words = "needs" if name in needs else "has no"
                raise ValueError(f"{self.kind} {words} {name}")
        ends = [self.low, self.high] if self.kind == "truncated" else None
        ordered: Any = self.uniform or self.triangular or ends or [0.0, 1.0]
        if sorted(ordered) != ordered or ordered[0] == ordered[-1]:
            raise ValueError(f"{self.kind}: {ordered}: must be ascending")
        return self

    @property
    def kind(self) -> str:
        return next(name for name in _KINDS if getattr(self, name) is not None)

    @property
    def of_walls(self) -> "list[DistributionTable]":
        """The distributions of the lower and the upper wall of a pair; empty if it is no pair."""
        pair = getattr(self, self.kind)
        if self.kind not in ("normal", "lognormal") or not isinstance(pair, list):
            return []
        return [self.model_copy(update={self.kind: one}) for one in pair]

    @property
    def distribution(self) -> Distribution:
        """The distribution of `scipy.stats`, or of measured values."""
        from scipy import stats  # a second to import, and few studies need it

        if self.data is not None:
            return Measured(tuple(self.data))
        sd: Any = self.sd
        found: Distribution
        match getattr(self, self.kind), self.low, self.high:
            case [low, high], None, None:
                found = stats.uniform(low, high - low)
            case [low, mode, high], None, None:
                found = stats.triang((mode - low) / (high - low), low, high - low)
            case mean, float(low), float(high):
                found = stats.truncnorm((low - mean) / sd, (high - mean) / sd, mean, sd)
            case centre, _, _:
                is_normal = self.kind == "normal"
                found = stats.norm(centre, sd) if is_normal else stats.lognorm(sd, scale=centre)
        return found


def with_data(tables: Any, source: str) -> Any:
    """Return the tables of a study with measured values in place of files.

    ``{ data = "gaps.csv", column = "gap" }`` has the values of the column ``gap [mm]`` of a file
    next to the study; without a unit in its title they are in SI units.

    Raises `StudyError` if a file cannot be read or has no such column of numbers.
    """
    given = tables.get("uncertain") if isinstance(tables, dict) else None
    if not isinstance(given, dict):
        return tables
    folder, found = Path(source).absolute().parent, dict(given)
    for name, table in given.items():
        if isinstance(table, dict) and isinstance(table.get("data"), str):
            where = f"{source}: uncertain.{name}"
            if not isinstance(column := table.get("column"), str):
                raise StudyError(f"{where}: data needs column, as column = 'gap'")
            rest = {key: value for key, value in table.items() if key != "column"}
            try:
                columns = read_columns(folder / table["data"])
                place = columns.place(column)
                factor = factor_of(columns.path, columns.title(place), name, UNITS.get(name, ""))
                values = columns.numbers(place) * (1.0 if factor is None else factor)
                found[name] = rest | {"data": values.tolist()}
            except ModelError as error:
                raise StudyError(f"{where}: {error}") from None
    return tables | {"uncertain": found}


class EventTable(TomlTable):
    """An event: a quantity above or below a limit, between both, or a response class."""

    name: Annotated[str, Field(min_length=1, max_length=64)]
    quantity: str | None = None
    above: Number | None = None
    below: Number | None = None
    response_class: Literal[_CLASSES] | None = None  # type: ignore[valid-type]  # names of the enumeration

    @model_validator(mode="before")
    @classmethod
    def _without_units(cls, given: Any) -> Any:
        quantity = given.get("quantity") if isinstance(given, Mapping) else None
        if (known := RESPONSE.get(str(quantity).partition("[")[0])) is None:
            return given
        limits = {"above", "below"} & {*given}
        return given | {name: without_units(name, given[name], known.units) for name in limits}

    @model_validator(mode="after")
    def _has_limit(self) -> "EventTable":
        has_limit = self.above is not None or self.below is not None
        if (self.quantity is None) == (self.response_class is None):
            raise ValueError("give quantity with above or below, or response_class")
        if has_limit == (self.quantity is None):
            words = "has no threshold; write above = 1e-3 or below = 1e-3"
            raise ValueError(f"quantity = {self.quantity!r} {words}" if self.quantity else words)
        if None not in (self.above, self.below) and not self.above < self.below:  # type: ignore[operator]  # both are numbers
            raise ValueError(f"above = {self.above:g}: must be < below = {self.below:g}")
        return self


def _power_of_two(n: int) -> int:
    if n & (n - 1):
        low = 1 << (n.bit_length() - 1)
        raise ValueError(f"must be a power of two, as {low} or {2 * low}")
    return n


class SafeTable(TomlTable):
    """A designed parameter, for its largest or smallest value with a probability below a limit."""

    along: str
    event: str
    probability: Annotated[float, Field(gt=0, lt=1)]


class UncertainTable(TomlTable):
    """Uncertain numbers and the events of which the probability is wanted."""

    samples: Annotated[int, Field(ge=2, le=2**24), AfterValidator(_power_of_two)]
    repeats: Annotated[int, Field(ge=2, le=1000)] = 8
    seed: Annotated[int, Field(ge=0)] = 1
    indices: bool = False
    correlation: list[list[Number]] | None = None
    quantities: list[str] = Field([])  # of which quantiles and indices are wanted; those of events
    event: list[EventTable] = Field([])
    safe: SafeTable | None = None
    parameter: dict[str, DistributionTable] = Field({}, alias="[parameters]")

    @model_validator(mode="before")
    @classmethod
    def _with_numbers_apart(cls, given: Any) -> Any:
        """Return the table with its numbers, which have any names, in a table within it."""
        if not isinstance(given, dict):
            return given
        own = {*cls.model_fields} - {"parameter"}
        rest = {name: value for name, value in given.items() if name in own}
        return rest | {"[parameters]": {n: x for n, x in given.items() if n not in own}}

    @model_validator(mode="after")
    def _consistent(self) -> "UncertainTable":
        wrong = [] if self.parameter else [f"no uncertain number; write gap = {_EXAMPLE}"]
        if not (self.event or self.quantities):
            wrong.append("give quantities = ['amplitude'], or an event")
        names = [event.name for event in self.event]
        wrong += [f"event {n!r}: occurs twice" for n in dict.fromkeys(names) if names.count(n) > 1]
        walls = {"gap"} & {*self.parameter} and {"j_1", "j_2"} & {*self.parameter}
        if walls:
            wrong.append("give gap, or j_1 and j_2")
        pairs = [n for n, table in self.parameter.items() if table.of_walls and n != "gap"]
        wrong += [f"{name}: must be one number; only a gap has a pair" for name in pairs]
        if self.correlation is not None and not wrong:
            wrong += self._wrong_correlation(np.array(self.correlation, dtype=object))
        if self.safe and self.safe.event not in names:
            wrong.append(f"safe.event = {self.safe.event!r}: must be one of {', '.join(names)}")
        if wrong:
            raise ValueError("; ".join(wrong))
        return self

    def _wrong_correlation(self, given: Any) -> list[str]:
        names, d = self.names, len(self.names)
        if given.shape != (d, d):
            return [f"correlation: must be {d} rows of {d} numbers, for {', '.join(names)}"]
        matrix = given.astype(float)
        if not np.array_equal(matrix, matrix.T) or not (np.diag(matrix) == 1.0).all():
            return ["correlation: must be symmetric, with ones on the diagonal"]
        if np.linalg.eigvalsh(matrix)[0] < 1e-12:
            return ["correlation: must be positive definite"]
        if self.indices:
            return ["correlation: Sobol indices are for independent numbers; leave out one of both"]
        return []

    @classmethod
    def of_call(
        cls, names: Collection[str], events: Mapping[str, Any], settings: Mapping[str, Any]
    ) -> "UncertainTable":
        """Return the table of a call, of which the distributions are no part.

        Raises `ModelError` if an event or a setting is invalid.
        """
        is_named = isinstance(events, Mapping)
        if not (is_named and all(isinstance(one, Mapping) for one in events.values())):
            example = "{'large': {'quantity': 'amplitude', 'above': 1e-3}}"
            raise ModelError(f"events = {events!r:.80}: must be events by name, as {example}")
        several = [{"name": name, **event} for name, event in events.items()]
        numbers = {name: {"uniform": [0.0, 1.0]} for name in names}
        try:
            return cls.model_validate({**settings, "event": several, **numbers})
        except ValidationError as error:
            raise ModelError("; ".join(problems("gs.risk", error, cls, ()))) from None

    def wrong_quantities(
        self, structure: AnyStructure, parts: Mapping[str, Sequence[str]]
    ) -> Iterator[str]:
        """Yield a line per quantity that responses of a structure do not have."""
        allowed = quantities_of(structure, parts)
        for quantity in self.all_quantities:
            if quantity not in allowed:
                yield f"quantity = {quantity!r}: must be one of {', '.join(allowed)}"

    @property
    def tables(self) -> dict[str, DistributionTable]:
        """Distributions by name; a pair of walls as j_1 and j_2."""
        found = dict[str, DistributionTable]()
        for name, table in self.parameter.items():
            found |= dict(zip(("j_1", "j_2"), table.of_walls, strict=False)) or {name: table}
        return found

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the uncertain numbers."""
        return tuple(self.tables)

    @property
    def count(self) -> int:
        """Number of samples, without drawing them."""
        return self.samples * self.repeats * ((2 + len(self.names)) if self.indices else 1)

    @property
    def all_quantities(self) -> tuple[str, ...]:
        """Quantities that have quantiles and indices."""
        of_events = [event.quantity for event in self.event if event.quantity]
        return tuple(dict.fromkeys([*self.quantities, *of_events]))

    def median(self, name: str) -> Any:
        """Return the median of a number, a pair for a gap; None if it is certain or a deviation."""
        tables = self.tables
        if name == "gap" and "gap" not in tables:
            pair = [self.median(wall) for wall in ("j_1", "j_2")]
            return None if None in pair else pair
        table = tables.get(name)
        if table is None or table.nominal:
            return None
        value = float(table.distribution.ppf(0.5))
        return [value, value] if name == "gap" else value

    def draw(self) -> Samples:
        """Draw the samples."""
        tables = self.tables
        return drawn(
            {name: table.distribution for name, table in tables.items()},
            self.samples,
            self.repeats,
            self.seed,
            indices=self.indices,
            correlation=self.correlation,
            nominal={name: table.nominal for name, table in tables.items() if table.nominal},
        )

    def problems(
        self,
        known: Mapping[str, Any],
        axes: Mapping[str, Sequence[Any]],
        structure: AnyStructure,
        parts: Mapping[str, Sequence[str]],
    ) -> Iterator[str]:
        """Yield a line per number, quantity or distribution that the study cannot have.

        `known`: values of the numbers that may be uncertain, by name; None without a value.
        `axes`: axes of the study.
        `structure` and `parts`: structure of its models, and dimensions within a point, with the
        names along them.
        """
        for name, table in self.tables.items():
            of = self.parameter.get(name, table)
            if name not in known:
                yield f"{name}: cannot be uncertain; {unknown_number(name, known)}"
                continue
            swept = axes.get("gap" if name in ("j_1", "j_2") and "gap" in axes else name, ())
            if len(swept) > 1 and not of.nominal:
                remedy = "add nominal = 'plus' or 'times', or sweep one value"
                yield f"{name}: swept and uncertain; {remedy}"
                continue
            values = [known[name]] if name not in axes else [*axes[name]]
            if "gap" in axes and name in ("gap", "j_1", "j_2"):
                ends = {"j_1": [0], "j_2": [1]}.get(name, [0, 1])
                values = [(gap.j_1, gap.j_2)[i] for gap in axes["gap"] for i in ends]
            given = table.kind, table.distribution, table.nominal
            found = (outside(name, *given, value, structure.in_metres) for value in values)
            yield from [problem for problem in found if problem][:1]
        yield from self.wrong_quantities(structure, parts)
        if self.safe and len(axes.get(self.safe.along, ())) < 2:
            yield f"safe.along = {self.safe.along!r}: must have several values in [[sweep]]"


def quantities_of(structure: AnyStructure, parts: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the numbers of a response, those of systems as ``x_max[h]`` for every part."""
    found = []
    for name, (dtype, shape) in columns_of(structure).items():
        if dtype != "str" and not RESPONSE[name].flags:
            of = [dim for dim in RESPONSE[name].dims if dim in parts] if shape else []
            found += [f"{name}[{part}]" for dim in of for part in parts[dim]] or [name]
    return found


def outside(
    name: str, kind: str, of: Distribution, nominal: str | None, value: Any, in_metres: bool
) -> str:
    """Return the problem of a distribution that leaves the range of its number; empty without.

    `kind`: kind of the distribution, for the message.
    `nominal`: how it acts on the nominal value, as of `Samples`.
    `value`: nominal value.
    `in_metres`: whether the model is an oscillator.
    """
    bounds = _range(name, in_metres=in_metres)
    if nominal == "plus":
        low, high = (bound - value for bound in bounds)
    elif nominal == "times" and value:
        low, high = (bound / value for bound in bounds)
    else:
        low, high = bounds
    at = "" if nominal is None else f" at the nominal value {value:g}"
    shares = float(of.cdf(low)), 1.0 - float(of.cdf(high))
    for share, sign, bound in zip(shares, "<>", bounds, strict=True):
        if share > _MOST_OUTSIDE:
            return (
                f"{name}: {kind} gives {name} {sign} {bound:g}{at} with probability {share:.3g}; "
                "choose a narrower one, or one that is truncated"
            )
    return ""


def _range(name: str, *, in_metres: bool) -> tuple[float, float]:
    """Return the range of a number that models allow, infinite without a bound."""
    if name in _OF_CONTACTS:
        return 0.0, 1.0 if name == "restitution" else math.inf
    fields = OscillatorTable.model_fields if in_metres else {}
    metadata = fields[name].metadata if name in fields else []
    low = [getattr(each, end) for each in metadata for end in ("ge", "gt") if hasattr(each, end)]
    high = [each.le for each in metadata if hasattr(each, "le")]
    return max(low, default=-math.inf), min(high, default=math.inf)
