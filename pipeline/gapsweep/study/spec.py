"""The study file: what may stand in it, checked all at once.

pydantic models mirror the TOML tables. `parse` turns text into a checked `StudySpec` or
raises one `StudyError` with a line per problem; `gapsweep.study.study` turns the spec into
the plain immutable values that the rest of the package works with.
"""

import tomllib
from pathlib import PurePath
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    model_validator,
)

from gapsweep.errors import ModelError, StudyError
from gapsweep.integrate.problem import LARGEST_RTOL, SMALLEST_RTOL
from gapsweep.model.labels import AUTO, canonical_label
from gapsweep.study.advice import DEFAULT_ERROR, LARGEST_ERROR, SMALLEST_ERROR

MAX_POINTS = 10**7
# Of a time history; its dense output is kept in memory.
MAX_HISTORY_PERIODS = 10_000
# Of a motion that is compared with its references.
MAX_BENCH_PERIODS = 100_000
# Share of rtol that is the absolute tolerance [m], [m/s] where a method states none: motions are
# about a millimetre wide.
ATOL_PER_RTOL = 1e-3

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=1, le=MAX_POINTS)]
Range = Annotated[list[float], Field(min_length=2, max_length=2)]
Pair = Annotated[list[NonNegative], Field(min_length=2, max_length=2)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


def _canonical(label: str) -> str:
    """Canonical label, its protocol suffix kept."""
    law, at, protocol = label.partition("@")
    try:
        return canonical_label(law) + at + protocol
    except ModelError as error:
        raise ValueError(str(error)) from None


Label = Annotated[str, AfterValidator(_canonical)]


class StudyTable(_Table):
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
    title: Annotated[str, Field(max_length=10_000)] = ""


class OscillatorTable(_Table):
    zeta: NonNegative = 0.03
    omega_n: Positive = 5.0
    mass: Positive = 3.0
    alpha: float = 7e8
    forcing: float = 4.0


class StepGrid(_Table):
    start: Positive
    stop: Positive
    step: Positive

    @property
    def count(self) -> int:
        # A stop that is a whole number of steps away is meant to be reached.
        return int((self.stop - self.start) / self.step + 1e-9) + 1

    def values(self) -> list[float]:
        return [self.start + i * self.step for i in range(self.count)]


class NumGrid(_Table):
    start: Positive
    stop: Positive
    num: Count

    @property
    def count(self) -> int:
        return self.num

    def values(self) -> list[float]:
        step = (self.stop - self.start) / max(self.num - 1, 1)
        return [self.start + i * step for i in range(self.num)]


def _ordered(grid: StepGrid | NumGrid) -> StepGrid | NumGrid:
    if grid.stop < grid.start:
        raise ValueError(f"stop {grid.stop:g} must be >= start {grid.start:g}")
    return grid


def _frequency_form(value: Any) -> str:
    if isinstance(value, NumGrid) or (isinstance(value, dict) and "num" in value):
        return "num"
    return "step" if isinstance(value, StepGrid | dict) else "list"


Frequencies = Annotated[
    Annotated[list[Positive], Field(min_length=1), Tag("list")]
    | Annotated[StepGrid, AfterValidator(_ordered), Tag("step")]
    | Annotated[NumGrid, AfterValidator(_ordered), Tag("num")],
    Discriminator(_frequency_form),
]


class SobolStarts(_Table):
    sobol: Annotated[int, Field(ge=1, le=65536)]
    x: Range
    v: Range
    seed: Annotated[int, Field(ge=0)] = 1

    @model_validator(mode="after")
    def _ascending(self) -> "SobolStarts":
        for name, (low, high) in (("x", self.x), ("v", self.v)):
            if not low < high:
                raise ValueError(f"{name} = [{low:g}, {high:g}] must ascend")
        return self


def _start_form(value: Any) -> str:
    if isinstance(value, str):
        return "sweep"
    if isinstance(value, list) and any(isinstance(v, str | dict | SobolStarts) for v in value):
        return "several"
    return "sobol" if isinstance(value, SobolStarts | dict) else "list"


Sobol = Annotated[SobolStarts, Tag("sobol")]
Sweep = Annotated[Literal["sweep_up", "sweep_down"], Tag("sweep")]
Starts = Annotated[
    Annotated[list[Range], Field(min_length=1), Tag("list")]
    | Annotated[list[Annotated[Sobol | Sweep, Discriminator(_start_form)]], Tag("several")]
    | Sobol
    | Sweep,
    Discriminator(_start_form),
]


class SweepTable(_Table):
    representation: Annotated[list[Label], Field(min_length=1)]
    K_c: Annotated[list[NonNegative], Field(min_length=1)]
    gap: Annotated[list[Pair], Field(min_length=1)]
    omega: Frequencies
    initial_condition: Starts = [[0.0, 0.0]]

    @property
    def count(self) -> int:
        """Sweep points, without expanding them."""
        given = self.initial_condition
        starts = given if isinstance(given, list) else [given]
        n_starts = sum(one.sobol if isinstance(one, SobolStarts) else 1 for one in starts)
        n_omega = len(self.omega) if isinstance(self.omega, list) else self.omega.count
        return len(self.representation) * len(self.K_c) * len(self.gap) * n_omega * n_starts


class SolverTable(_Table):
    """Solver settings; None means "as above" (protocol) or the engine's default."""

    engine: Literal["compiled", "scipy"] | None = None
    rtol: Annotated[float, Field(ge=SMALLEST_RTOL, le=LARGEST_RTOL)] | None = None
    atol: Positive | None = None
    controller: Literal["native", "ode45"] | None = None
    restart: bool | None = None
    start_jitter: float = 0.0


class SteadyTable(_Table):
    settle_tol: Annotated[float, Field(gt=0, le=0.1)] = 1e-6
    max_decay_times: Positive = 113.0
    max_periods: Annotated[int, Field(ge=1, le=10**7)] = 10_000
    t_max: Positive | None = None
    n_periods: Annotated[int, Field(ge=2, le=10**6)] = 64
    max_period_multiple: Annotated[int, Field(ge=1, le=256)] = 32
    max_extrema: Annotated[int, Field(ge=1, le=65536)] = 256

    @model_validator(mode="after")
    def _long_enough(self) -> "SteadyTable":
        if self.n_periods < 2 * self.max_period_multiple:
            raise ValueError(
                f"n_periods = {self.n_periods} must be >= 2 max_period_multiple "
                f"= {2 * self.max_period_multiple}"
            )
        return self


class FitTable(_Table):
    range: Positive = 4e-3


def _several(value: Any) -> Any:
    return [value] if isinstance(value, str) else value


class HistoryTable(_Table):
    """Motions to keep as time histories and spectra: one scene, one start."""

    representation: Annotated[list[Label], Field(min_length=1), BeforeValidator(_several)]
    K_c: NonNegative
    gap: Pair
    omega: Positive
    t_end: Positive
    start: Range = [0.0, 0.0]

    @model_validator(mode="after")
    def _whole_periods(self) -> "HistoryTable":
        if not 1.0 <= self.t_end * self.omega <= MAX_HISTORY_PERIODS:
            low, high = 1.0 / self.omega, MAX_HISTORY_PERIODS / self.omega
            raise ValueError(
                f"t_end = {self.t_end:g} s: must be within {low:g}..{high:g} s, "
                f"1 to {MAX_HISTORY_PERIODS} forcing periods"
            )
        return self


class AutoTable(_Table):
    """What representation "auto" and `gapsweep advise` have to meet."""

    error: Annotated[float, Field(ge=SMALLEST_ERROR, le=LARGEST_ERROR)] = DEFAULT_ERROR


class SceneOscillatorTable(_Table):
    """What a scene's oscillator has otherwise than the study's."""

    zeta: NonNegative | None = None
    omega_n: Positive | None = None
    mass: Positive | None = None
    alpha: float | None = None
    forcing: float | None = None


Expected = Literal["reference", "energy", "duffing", "linear", "phase", "mirror"]
Periods = Annotated[int, Field(ge=1, le=MAX_BENCH_PERIODS)]
Tolerance = Annotated[float, Field(ge=SMALLEST_RTOL, le=LARGEST_RTOL)]


class SceneTable(_Table):
    """One motion of a benchmark.

    `expected` says by what a right answer is known, `without` which methods it is too long for.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._+-]{0,63}$")]
    oscillator: SceneOscillatorTable = SceneOscillatorTable()
    K_c: NonNegative
    gap: Pair
    omega: Positive
    start: Range = [0.0, 0.0]
    expected: Expected | None = None
    horizon: Periods | None = None
    without: list[Label] = []

    def merged(self, oscillator: OscillatorTable) -> OscillatorTable:
        """The scene's own oscillator."""
        return oscillator.model_copy(update=self.oscillator.model_dump(exclude_none=True))

    def contradictions(self, oscillator: OscillatorTable) -> list[str]:
        """What keeps the expected answer from being one, for the study's oscillator."""
        own, touching = self.merged(oscillator), self.gap == [0.0, 0.0]
        needs = {
            "energy": ("zeta = 0 and forcing = 0", own.zeta == 0.0 and own.forcing == 0.0),
            "linear": (
                "alpha = 0, and K_c = 0 or gap = [0, 0]",
                own.alpha == 0.0 and (self.K_c == 0.0 or touching),
            ),
            "mirror": ("j_1 = j_2", self.gap[0] == self.gap[1]),
        }
        condition, is_met = needs.get(self.expected or "", ("", True))
        return [] if is_met else [f"expected = {self.expected!r}: needs {condition}"]


class MethodTable(_Table):
    """A representation with its solver, and the ladder of tolerances to climb."""

    label: Label
    rtol: Annotated[list[Tolerance], Field(min_length=1)]
    atol: Annotated[list[Positive], Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _pairs(self) -> "MethodTable":
        if self.atol is not None and len(self.atol) != len(self.rtol):
            raise ValueError(f"atol has {len(self.atol)} values, rtol {len(self.rtol)}")
        if sorted(set(self.rtol), reverse=True) != self.rtol:
            raise ValueError("rtol must descend: the loosest tolerance first, each only once")
        return self

    @property
    def rungs(self) -> list[tuple[float, float]]:
        """Relative [-] and absolute [m, m/s] tolerances."""
        atol = self.atol or [ATOL_PER_RTOL * rtol for rtol in self.rtol]
        return list(zip(self.rtol, atol, strict=True))


class BenchTable(_Table):
    """Presence asks for work-precision and stability: every method on every scene."""

    scene: Annotated[list[SceneTable], Field(min_length=1)]
    method: Annotated[list[MethodTable], Field(min_length=1)]
    horizon: Periods = 10
    repeats: Annotated[int, Field(ge=1, le=1000)] = 5
    lanes: Annotated[int, Field(ge=1, le=65536)] = 64

    @model_validator(mode="after")
    def _named_once(self) -> "BenchTable":
        names = [scene.name for scene in self.scene], [method.label for method in self.method]
        twice = [name for some in names for name in dict.fromkeys(some) if some.count(name) > 1]
        if twice:
            raise ValueError(f"{', '.join(twice)}: given more than once")
        unknown = {label for scene in self.scene for label in scene.without} - set(names[1])
        if unknown:
            raise ValueError(f"without {', '.join(sorted(unknown))}: no such method")
        return self


def _python_file(path: str) -> str:
    if not (path.endswith(".py") and PurePath(path).stem.isidentifier()):
        raise ValueError("must be the path of a Python file, as 'claims.py'")
    return path


class ModuleTable(_Table):
    """Python beside the study: `module` is a path relative to the study file."""

    module: Annotated[str, AfterValidator(_python_file)]


class ClaimsTable(ModuleTable):
    """Presence asks for verdicts."""

    @model_validator(mode="before")
    @classmethod
    def _not_of_old(cls, given: Any) -> Any:
        if isinstance(given, dict) and "file" in given:
            raise ValueError(
                f"file = {given['file']!r}: claims are functions now: write them in Python and put "
                'module = "claims.py" here instead, see docs/claims.md'
            )
        return given


class ReportTable(ModuleTable):
    """Presence asks for sections of the study's own in the report."""


class StudySpec(_Table):
    study: StudyTable
    oscillator: OscillatorTable = OscillatorTable()
    sweep: Annotated[list[SweepTable], Field(min_length=1)]
    solver: SolverTable = SolverTable()
    protocol: dict[Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")], SolverTable] = {}
    steady: SteadyTable = SteadyTable()
    fit: FitTable = FitTable()
    auto: AutoTable = AutoTable()
    history: list[HistoryTable] = []
    bench: BenchTable | None = None
    claims: ClaimsTable | None = None
    report: ReportTable | None = None

    @model_validator(mode="after")
    def _consistent(self) -> "StudySpec":
        tables: list[SweepTable | HistoryTable] = [*self.sweep, *self.history]
        labels = [label for table in tables for label in table.representation]
        scenes = self.bench.scene if self.bench else []
        labels += [method.label for method in self.bench.method] if self.bench else []
        used = {protocol for x in labels for protocol in x.split("@")[1:]}
        problems = [
            f"protocol {name!r} is used by a label but there is no [protocol.{name}]"
            for name in sorted(used - set(self.protocol))
        ]
        if any(label.startswith(f"{AUTO}@") for label in labels):
            problems.append("'auto' chooses its solver settings itself: it takes no protocol")
        if any(AUTO in table.representation for table in self.history):
            problems.append("'auto' has no time histories: name the representation")
        if self.bench and any(method.label == AUTO for method in self.bench.method):
            problems.append("bench: 'auto' is no method: name the representation")
        count = sum(block.count for block in self.sweep)
        if count > MAX_POINTS:
            problems.append(f"{count} sweep points: must be <= {MAX_POINTS}; coarsen a grid")
        problems += [
            f"bench.scene {scene.name!r}: {problem}"
            for scene in scenes
            for problem in scene.contradictions(self.oscillator)
        ]
        if problems:
            raise ValueError("; ".join(problems))
        return self


def parse(text: str, source: str = "study") -> StudySpec:
    """Check the text of a study file.

    Raises
    ------
    StudyError
        One line per problem, each naming `source`, the key, the value and what is allowed.
    """
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise StudyError([f"{source}: not valid TOML: {error}"]) from None
    return check(tables, source)


def check(tables: dict[str, Any], source: str = "study") -> StudySpec:
    """Check the tables of a study; see `parse`."""
    try:
        return StudySpec.model_validate(tables)
    except ValidationError as error:
        raise StudyError([_problem(source, e) for e in error.errors()]) from None


_BOUNDS = {
    "greater_than": ("gt", ">"),
    "greater_than_equal": ("ge", ">="),
    "less_than_equal": ("le", "<="),
}


def _problem(source: str, error: Any) -> str:
    """One line: where, the offending value, what is allowed."""
    message = error["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
    if error["type"] in _BOUNDS:
        name, sign = _BOUNDS[error["type"]]
        message = f"must be {sign} {error['ctx'][name]:g}"
    elif error["type"] == "extra_forbidden":
        message = "unknown key"
    elif error["type"] == "union_tag_invalid":
        message = "must be { sobol = ... }, 'sweep_up' or 'sweep_down'"
    where = _path(error["loc"])
    value = error["input"]
    shown = "" if error["type"] == "missing" or isinstance(value, dict) else f" = {value!r:.80}"
    return f"{source}: {where}{shown}: {message}" if where else f"{source}: {message}"


def _path(loc: tuple[str | int, ...]) -> str:
    """``("sweep", 0, "omega", "step", "step")`` as ``sweep[0].omega.step``."""
    text = ""
    for i, part in enumerate(loc):
        # The tag of a union member is ours, not the user's.
        tagged = loc[i - 1] in ("omega", "initial_condition") or loc[max(i - 2, 0)] == "several"
        if i and tagged and isinstance(part, str):
            continue
        text += f"[{part}]" if isinstance(part, int) else f".{part}"
    return text.lstrip(".")
