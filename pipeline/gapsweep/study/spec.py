"""The study file: what may stand in it, checked all at once.

pydantic models mirror the TOML tables. `parse` turns text into a checked `StudySpec` or
raises one `StudyError` with a line per problem; `gapsweep.study.study` turns the spec into
the plain immutable values that the rest of the package works with.
"""

import math
import tomllib
from pathlib import PurePath
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, ValidationError, model_validator

from gapsweep.errors import StudyError
from gapsweep.integrate.problem import LARGEST_RTOL, SMALLEST_RTOL
from gapsweep.model.labels import AUTO
from gapsweep.study.advice import DEFAULT_ERROR, LARGEST_ERROR, SMALLEST_ERROR
from gapsweep.study.axes import (
    MAX_POINTS,
    SWEEPABLE,
    AnyAxis,
    Label,
    NonNegative,
    NonNegativeAxis,
    OscillatorTable,
    Pair,
    Pairs,
    Positive,
    PositiveAxis,
    Range,
    Starts,
    Table,
    count,
    n_starts,
    several,
)
from gapsweep.study.bench import BenchTable
from gapsweep.study.problems import problems

# Of a time history; its dense output is kept in memory.
MAX_HISTORY_PERIODS = 10_000


class StudyTable(Table):
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
    title: Annotated[str, Field(max_length=10_000)] = ""


class SweepTable(Table):
    """A block of points: every combination of its axes."""

    representation: Annotated[list[Label], Field(min_length=1), BeforeValidator(several)]
    K_c: NonNegativeAxis
    gap: Pairs | None = None
    j_1: NonNegativeAxis | None = None
    j_2: NonNegativeAxis | None = None
    omega: PositiveAxis
    zeta: NonNegativeAxis | None = None
    omega_n: PositiveAxis | None = None
    mass: PositiveAxis | None = None
    alpha: AnyAxis | None = None
    forcing: AnyAxis | None = None
    K_ratio: NonNegativeAxis | None = None
    initial_condition: Starts = Field([[0.0, 0.0]])

    @model_validator(mode="after")
    def _walls(self) -> "SweepTable":
        given = [name for name in ("gap", "j_1", "j_2") if getattr(self, name) is not None]
        if given not in (["gap"], ["j_1", "j_2"]):
            raise ValueError("give gap, or both j_1 and j_2 in its place")
        return self

    @property
    def swept(self) -> tuple[str, ...]:
        """Parameters of the oscillator, and the ratio of the walls, that are axes here."""
        return tuple(name for name in SWEEPABLE if getattr(self, name) is not None)

    @property
    def count(self) -> int:
        """Sweep points, without making them."""
        numeric = ("K_c", "j_1", "j_2", "omega", *SWEEPABLE)
        sizes = [count(axis) for name in numeric if (axis := getattr(self, name)) is not None]
        n_gaps = 1 if self.gap is None else len(self.gap)
        return math.prod(
            (*sizes, len(self.representation), n_gaps, n_starts(self.initial_condition))
        )


class SolverTable(Table):
    """Solver settings; None means "as above" (protocol) or the engine's default."""

    engine: Literal["compiled", "scipy"] | None = None
    rtol: Annotated[float, Field(ge=SMALLEST_RTOL, le=LARGEST_RTOL)] | None = None
    atol: Positive | None = None
    controller: Literal["native", "ode45"] | None = None
    restart: bool | None = None
    start_jitter: float = 0.0


class SteadyTable(Table):
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


class FitTable(Table):
    range: Positive = 4e-3


class HistoryTable(Table):
    """Motions to keep as time histories and spectra: one scene, one start."""

    representation: Annotated[list[Label], Field(min_length=1), BeforeValidator(several)]
    K_c: NonNegative
    gap: Pair
    omega: Positive
    t_end: Positive
    start: Range = Field([0.0, 0.0])

    @model_validator(mode="after")
    def _whole_periods(self) -> "HistoryTable":
        if not 1.0 <= self.t_end * self.omega <= MAX_HISTORY_PERIODS:
            low, high = 1.0 / self.omega, MAX_HISTORY_PERIODS / self.omega
            raise ValueError(
                f"t_end = {self.t_end:g} s: must be within {low:g}..{high:g} s, "
                f"1 to {MAX_HISTORY_PERIODS} forcing periods"
            )
        return self


class AutoTable(Table):
    """What representation "auto" and `gapsweep advise` have to meet."""

    error: Annotated[float, Field(ge=SMALLEST_ERROR, le=LARGEST_ERROR)] = DEFAULT_ERROR


def _python_file(path: str) -> str:
    if not (path.endswith(".py") and PurePath(path).stem.isidentifier()):
        raise ValueError("must be the path of a Python file, as 'claims.py'")
    return path


class ModuleTable(Table):
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


class StudySpec(Table):
    study: StudyTable
    oscillator: OscillatorTable = OscillatorTable()
    sweep: Annotated[list[SweepTable], Field(min_length=1)]
    solver: SolverTable = SolverTable()
    protocol: dict[Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")], SolverTable] = Field({})
    steady: SteadyTable = SteadyTable()
    fit: FitTable = FitTable()
    auto: AutoTable = AutoTable()
    history: list[HistoryTable] = Field([])
    bench: BenchTable | None = None
    claims: ClaimsTable | None = None
    report: ReportTable | None = None

    @model_validator(mode="after")
    def _consistent(self) -> "StudySpec":
        tables: list[SweepTable | HistoryTable] = [*self.sweep, *self.history]
        labels = [label for table in tables for label in table.representation]
        scenes = self.bench.scene if self.bench else []
        labels += [method.label for method in self.bench.method] if self.bench else []
        used = {x.partition("@")[2] for x in labels if "@" in x}
        wrong = [
            f"protocol {name!r} is used by a label but there is no [protocol.{name}]"
            for name in sorted(used - set(self.protocol))
        ]
        if any(label.startswith(f"{AUTO}@") for label in labels):
            wrong.append("'auto' chooses its solver settings itself: it takes no protocol")
        if any(AUTO in table.representation for table in self.history):
            wrong.append("'auto' has no time histories: name the representation")
        if self.bench and any(method.label == AUTO for method in self.bench.method):
            wrong.append("bench: 'auto' is no method: name the representation")
        if len({block.gap is None for block in self.sweep}) > 1:
            wrong.append("sweep: give gap in every block, or j_1 and j_2 in every block")
        n_points = sum(block.count for block in self.sweep)
        if n_points > MAX_POINTS:
            wrong.append(f"{n_points} sweep points: must be <= {MAX_POINTS}; coarsen a grid")
        wrong += [
            f"bench.scene {scene.name!r}: {problem}"
            for scene in scenes
            for problem in scene.contradictions(self.oscillator)
        ]
        if wrong:
            raise ValueError("; ".join(wrong))
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
        raise StudyError(problems(source, error, StudySpec)) from None
