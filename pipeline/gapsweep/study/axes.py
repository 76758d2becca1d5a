"""Types of the axes of a sweep in a study file: one value, a list, or a grid."""

import math
from collections.abc import Sequence
from typing import Annotated, Any, Generic, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    GetPydanticSchema,
    Tag,
    model_validator,
)

from gapsweep.errors import ModelError
from gapsweep.model.labels import Representation
from gapsweep.model.oscillator import LARGEST, SMALLEST

MAX_POINTS = 10**9  # of a study
MAX_VALUES = 10**7  # of an axis or a list
_LARGEST = 1e100  # of spans; far beyond any parameter of a model


def _bounded(value: float) -> float:
    """Return a number whose modulus models allow; refuse larger ones."""
    if abs(value) > LARGEST:
        raise ValueError(f"must be within -{LARGEST:g}..{LARGEST:g}")
    return value


def _distance(value: float) -> float:
    """Return the distance of a wall; infinity: no wall."""
    if math.isnan(value):
        raise ValueError("must be a number; inf: no wall")
    return value if value == math.inf else _bounded(value)


def _not_tiny(value: float) -> float:
    if value < SMALLEST:
        raise ValueError(f"must be >= {SMALLEST:g}")
    return value


def _has_wall(pair: list[float]) -> list[float]:
    if min(pair) == math.inf:
        raise ValueError("no wall on either side; give one distance, as [inf, 4e-4]")
    return pair


Number = Annotated[float, AfterValidator(_bounded)]
Positive = Annotated[float, Field(gt=0), AfterValidator(_bounded), AfterValidator(_not_tiny)]
NonNegative = Annotated[float, Field(ge=0), AfterValidator(_bounded)]
Share = Annotated[float, Field(ge=0, le=1)]
Wall = Annotated[float, Field(allow_inf_nan=True), AfterValidator(_distance)]
Count = Annotated[int, Field(ge=1, le=MAX_VALUES)]
Range = Annotated[list[Number], Field(min_length=2, max_length=2)]
Pair = Annotated[list[Wall], Field(min_length=2, max_length=2), AfterValidator(_has_wall)]

Value = TypeVar("Value", bound=float)


class TomlTable(BaseModel):
    """A table of a study file: unknown keys, conversions and infinite numbers are errors."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


def _parsed(label: str) -> Representation:
    try:
        return Representation.parsed(label)
    except ModelError as error:
        raise ValueError(str(error)) from None


# To pydantic a text; `_parsed` makes it a `Representation`.
_LABEL = Annotated[str, AfterValidator(_parsed)]
Label = Annotated[Representation, GetPydanticSchema(lambda _, schema_of: schema_of(_LABEL))]


class _RangeTable(TomlTable, Generic[Value]):
    start: Value
    stop: Value

    @property
    def span(self) -> float:
        return self.stop - self.start

    @model_validator(mode="after")
    def _ordered(self) -> "_RangeTable[Value]":
        if self.span < 0.0:
            raise ValueError(f"stop {self.stop:g} must be >= start {self.start:g}")
        if not self.span <= _LARGEST:
            raise ValueError(f"stop {self.stop:g} - start {self.start:g} must be <= {_LARGEST:g}")
        return self


class StepGrid(_RangeTable[Value], Generic[Value]):
    step: Annotated[float, Field(gt=0)]

    @property
    def count(self) -> int:
        # A stop at a whole number of steps, within rounding, is included.
        return int(min(self.span / self.step, _LARGEST) + 1e-9) + 1

    @model_validator(mode="after")
    def _coarse(self) -> "StepGrid[Value]":
        if self.count > MAX_VALUES:
            raise ValueError(f"step {self.step:g}: must give <= {MAX_VALUES} values")
        return self

    def values(self) -> list[float]:
        start = float(self.start)
        return [start + i * self.step for i in range(self.count)]


class NumGrid(_RangeTable[Value], Generic[Value]):
    num: Count

    @property
    def count(self) -> int:
        return self.num

    def values(self) -> list[float]:
        start = float(self.start)
        step = self.span / max(self.num - 1, 1)
        return [start + i * step for i in range(self.num)]


def _form(value: Any) -> str:
    if isinstance(value, NumGrid) or (isinstance(value, dict) and "num" in value):
        return "num"
    return "step" if isinstance(value, StepGrid | dict) else "list"


def several(value: Any) -> Any:
    """Return a single value as a list of one; lists and tables as they are."""
    return value if isinstance(value, list | dict | BaseModel) else [value]


def _axis(value: Any) -> Any:
    """Return the type of a numeric axis with values of a type: a list, or a grid by step or num."""
    return Annotated[
        Annotated[list[value], Field(min_length=1), Tag("list")]
        | Annotated[StepGrid[value], Tag("step")]
        | Annotated[NumGrid[value], Tag("num")],
        Discriminator(_form),
        BeforeValidator(several),
    ]


AnyAxis, PositiveAxis, NonNegativeAxis = map(_axis, (Number, Positive, NonNegative))
ShareAxis, WallAxis = map(_axis, (Share, Wall))


def count(axis: Any) -> int:
    """Number of values of a numeric axis, without creating them."""
    return len(axis) if isinstance(axis, list) else int(axis.count)


def values(axis: Any) -> list[float]:
    """Return the values of a numeric axis."""
    return axis if isinstance(axis, list) else list(axis.values())


def _one_pair(value: Any) -> Any:
    """Return a single pair of numbers as a list of one pair; other values as they are."""
    is_pair = isinstance(value, list) and len(value) == 2
    return [value] if is_pair and not any(isinstance(v, list | dict) for v in value) else value


Pairs = Annotated[list[Pair], Field(min_length=1), BeforeValidator(_one_pair)]


Ranges = Annotated[list[Range], Field(min_length=1), BeforeValidator(_one_pair)]


class _Box(TomlTable):
    """A box of coordinates x and velocities v, a range for each; first-order states are zero."""

    x: Ranges
    v: Ranges

    @model_validator(mode="after")
    def _ascending(self) -> "_Box":
        if len(self.x) != len(self.v):
            raise ValueError(f"x has {len(self.x)} ranges, v has {len(self.v)}: must be equal")
        for name, ranges in (("x", self.x), ("v", self.v)):
            for low, high in ranges:
                if not low <= high:
                    raise ValueError(
                        f"{name} = [{low:g}, {high:g}]: must be ascending, as [-1e-3, 1e-3]"
                    )
                if not max(-low, high) <= _LARGEST:
                    raise ValueError(
                        f"{name} = [{low:g}, {high:g}]: must be within -{_LARGEST:g}..{_LARGEST:g}"
                    )
        return self


class SobolStarts(_Box):
    """Initial conditions spread evenly over a box of displacements [m] and velocities [m/s]."""

    sobol: Annotated[int, Field(ge=1, le=65536)]
    seed: Annotated[int, Field(ge=0)] = 1

    @property
    def count(self) -> int:
        return self.sobol

    def states(self) -> NDArray[np.float64]:
        return spread([*self.x, *self.v], self.sobol, self.seed)


def spread(box: Sequence[Sequence[float]], n: int, seed: int) -> NDArray[np.float64]:
    """Return the first n Sobol points in a box, shape (n, number of ranges)."""
    from scipy.stats import qmc  # a second to import, and few studies need it

    # Sobol points are balanced in powers of two; the first ones of the next power.
    sobol = qmc.Sobol(d=len(box), scramble=True, rng=seed)
    low, high = np.array(box).T
    return np.asarray(low + sobol.random_base2((n - 1).bit_length())[:n] * (high - low))


class GridStarts(_Box):
    """Initial conditions on a grid over a box of one coordinate; the velocity changes last."""

    grid: Annotated[list[Annotated[Count, Field(ge=2)]], Field(min_length=2, max_length=2)]

    @model_validator(mode="after")
    def _plane(self) -> "GridStarts":
        if len(self.x) != 1:
            raise ValueError(
                "grid: must have one range of x and of v; use sobol for several coordinates"
            )
        if self.count > MAX_VALUES:
            raise ValueError(f"grid = {self.grid}: must have <= {MAX_VALUES} initial conditions")
        return self

    @property
    def count(self) -> int:
        return self.grid[0] * self.grid[1]

    def states(self) -> NDArray[np.float64]:
        ((left, right),), ((slowest, fastest),), (n_x, n_v) = self.x, self.v, self.grid
        x, v = np.meshgrid(np.linspace(left, right, n_x), np.linspace(slowest, fastest, n_v))
        return np.stack((x.ravel(), v.ravel()), axis=1)


def _start_form(value: Any) -> str:
    if isinstance(value, str):
        return "sweep"
    if isinstance(value, list):
        is_several = any(isinstance(v, str | dict | BaseModel) for v in value)
        return "several" if is_several else "list"
    is_grid = isinstance(value, GridStarts) or (isinstance(value, dict) and "grid" in value)
    return "grid" if is_grid else "sobol"


def _one_state(value: Any) -> Any:
    """Return a single state as a list of one; join the states among other forms in one form."""
    if not isinstance(value, list) or not value:
        return value
    n_numbers = sum(isinstance(each, int | float) for each in value)
    if n_numbers == len(value) or (n_numbers, len(value)) == (1, 2):
        return [value]  # the other one of two may be a quantity of the wrong dimension
    states = [each for each in value if isinstance(each, list)]
    others = [each for each in value if not isinstance(each, list)]
    is_grouped = any(isinstance(number, list) for state in states for number in state)
    return [states, *others] if states and others and not is_grouped else value


_Box_ = Annotated[SobolStarts, Tag("sobol")] | Annotated[GridStarts, Tag("grid")]
_Sweep = Annotated[Literal["sweep_up", "sweep_down"], Tag("sweep")]
State = Annotated[list[Number], Field(min_length=2)]
_States = Annotated[list[State], Field(min_length=1), Tag("list")]
Starts = Annotated[
    _States
    | Annotated[
        list[Annotated[_States | _Box_ | _Sweep, Discriminator(_start_form)]], Tag("several")
    ]
    | _Box_
    | _Sweep,
    Discriminator(_start_form),
    BeforeValidator(_one_state),
]


def forms(starts: Any) -> list[Any]:
    """Return the forms (states, grid, Sobol, sweep) of initial conditions; states are one form."""
    is_several = isinstance(starts, list) and any(_start_form(each) != "list" for each in starts)
    return starts if is_several else [starts]


def n_starts(starts: Any) -> int:
    """Number of initial conditions, without creating them."""
    return sum(
        1 if isinstance(form, str) else len(form) if isinstance(form, list) else form.count
        for form in forms(starts)
    )
