"""The study file: its tables and their checks, all at once.

pydantic models mirror the TOML tables. `parse` turns text into a checked `StudySpec` or
raises one `StudyError` with a line per problem; `gapsweep.study.study` turns the spec into
the plain immutable values that the rest of the package works with.
"""

import math
import re
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping
from os import PathLike
from pathlib import Path, PurePath
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, ValidationError, model_validator

from gapsweep.errors import StudyError
from gapsweep.integrate.problem import LARGEST_RTOL, SMALLEST_RTOL
from gapsweep.model.contact import FIT_RANGE, OF_WALLS
from gapsweep.model.labels import Representation
from gapsweep.response.result import Steady
from gapsweep.study.axes import (
    MAX_POINTS,
    AnyAxis,
    Label,
    NonNegative,
    NonNegativeAxis,
    Number,
    Pair,
    Pairs,
    Positive,
    PositiveAxis,
    Range,
    Share,
    ShareAxis,
    Starts,
    TomlTable,
    WallAxis,
    count,
    n_starts,
    several,
    values,
)
from gapsweep.study.bench_tables import BenchTable
from gapsweep.study.fit_table import FitTable, with_sweep
from gapsweep.study.grid import START, Axes
from gapsweep.study.least_model import DEFAULT_ERROR, LARGEST_ERROR, SMALLEST_ERROR
from gapsweep.study.oscillator_table import OscillatorTable, with_points
from gapsweep.study.problems import EXAMPLES, problems
from gapsweep.study.schema import TAKEN
from gapsweep.study.system_tables import ContactTable, SystemTable, wrong_matrices
from gapsweep.study.uncertain import UncertainTable, with_data
from gapsweep.study.units import with_numbers

# Key of the table with the model's parameters in a block or a history; not a key of a file.
PARAMETERS = "[parameters]"
# Longest time history; its dense output is kept in memory.
MAX_HISTORY_PERIODS = 10_000


Text = Annotated[str, Field(max_length=10_000)]


class StudyTable(TomlTable):
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
    title: Text = ""
    creator: Text = ""
    license: Text = ""
    pulls: bool = False  # whether exact walls with damping pull


class SweepTable(TomlTable):
    """A block of sweep points: all combinations of its axes."""

    representation: Annotated[list[Label], Field(min_length=1), BeforeValidator(several)]
    K_c: NonNegativeAxis | None = None
    gap: Pairs | None = None
    j_1: WallAxis | None = None
    j_2: WallAxis | None = None
    omega: PositiveAxis | None = None
    K_ratio: NonNegativeAxis | None = None
    damping: NonNegativeAxis | None = None
    preload: NonNegativeAxis | None = None
    chi: NonNegativeAxis | None = None
    restitution: ShareAxis | None = None
    parameter: dict[str, AnyAxis] = Field({}, alias="[parameters]")
    initial_condition: Starts | None = None  # None: at rest

    @model_validator(mode="after")
    def _walls(self) -> "SweepTable":
        given = [name for name in ("gap", "j_1", "j_2") if getattr(self, name) is not None]
        if given not in ([], ["gap"], ["j_1", "j_2"]):
            raise ValueError("give gap, or j_1 and j_2")
        if all(axis is not None and math.inf in values(axis) for axis in (self.j_1, self.j_2)):
            raise ValueError("j_1, j_2: inf in both: no wall on either side; write gap instead")
        return self

    @property
    def parameters(self) -> dict[str, Any]:
        """Axes of model parameters, and of those of both walls, that this block sweeps."""
        return {**self.parameter, **_of_walls(self)}

    @property
    def count(self) -> int:
        """Number of sweep points, without creating them."""
        axes = [self.K_c, self.j_1, self.j_2, self.omega, *self.parameters.values()]
        sizes = [count(axis) for axis in axes if axis is not None]
        n_gaps = 1 if self.gap is None else len(self.gap)
        starts = self.initial_condition
        n_all_starts = 1 if starts is None else n_starts(starts)
        return math.prod((*sizes, len(self.representation), n_gaps, n_all_starts))


def _of_walls(table: TomlTable) -> dict[str, Any]:
    """Parameters of both walls that a table sets."""
    found = {name: getattr(table, name) for name in OF_WALLS}
    return {name: value for name, value in found.items() if value is not None}


class SolverTable(TomlTable):
    """Solver settings; None means "as above" (protocol) or the engine's default."""

    engine: Literal["compiled", "scipy"] | None = None
    rtol: Annotated[float, Field(ge=SMALLEST_RTOL, le=LARGEST_RTOL)] | None = None
    atol: Positive | None = None
    controller: Literal["native", "ode45"] | None = None
    restart: bool | None = None
    contact_force: Literal["by_mode", "as_written"] | None = None
    start_jitter: float = 0.0


_STEADY = Steady()


class SteadyTable(TomlTable):
    settle_tol: Annotated[float, Field(gt=0, le=0.1)] = _STEADY.settle_tol
    max_decay_times: Positive = _STEADY.max_decay_times
    max_periods: Annotated[int, Field(ge=1, le=10**7)] = _STEADY.max_periods
    t_max: Positive | None = _STEADY.t_max
    n_periods: Annotated[int, Field(ge=2, le=10**6)] = _STEADY.n_periods
    max_period_multiple: Annotated[int, Field(ge=1, le=256)] = _STEADY.max_period_multiple
    lyapunov_error: Positive | None = _STEADY.lyapunov_error
    max_extrema: Annotated[int, Field(ge=1, le=65536)] = _STEADY.max_extrema

    @model_validator(mode="after")
    def _long_enough(self) -> "SteadyTable":
        if self.n_periods < 2 * self.max_period_multiple:
            raise ValueError(
                f"n_periods = {self.n_periods} must be >= 2 max_period_multiple "
                f"= {2 * self.max_period_multiple}"
            )
        return self


class ApproximationTable(TomlTable):
    range: Positive = FIT_RANGE


class HistoryTable(TomlTable):
    """Motions with time histories and spectra: one case, one initial condition.

    Parameters of the oscillator and the stiffness ratio have the values of the study as defaults.
    """

    representation: Annotated[list[Label], Field(min_length=1), BeforeValidator(several)]
    K_c: NonNegative
    gap: Pair
    K_ratio: NonNegative | None = None
    damping: NonNegative | None = None
    preload: NonNegative | None = None
    chi: NonNegative | None = None
    restitution: Share | None = None
    parameter: dict[str, Number] = Field({}, alias="[parameters]")
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

    @property
    def parameters(self) -> dict[str, float]:
        """Parameters of the model and of both walls that this history sets."""
        return {**self.parameter, **_of_walls(self)}

    def undecided(self, where: str, known: Mapping[str, float], axes: Axes) -> Iterator[str]:
        """Yield a problem for every parameter that the study sweeps and this history lacks."""
        for name in (*known, *OF_WALLS):
            axis = axes.get(name, ())
            if len(axis) > 1 and name not in self.parameters:
                remedy = f"choose one value, as {name} = {axis[0]:g}"
                yield f"{where}.{name}: swept by the study; {remedy}"


class AutoTable(TomlTable):
    """Allowed error of representation "auto" and `gapsweep advise`."""

    error: Annotated[float, Field(ge=SMALLEST_ERROR, le=LARGEST_ERROR)] = DEFAULT_ERROR


class AttractorsTable(TomlTable):
    """Rays from every attractor on which the smallest disturbance that leaves it is searched."""

    rays: Annotated[int, Field(ge=1, le=4096)]


def _python_file(path: str) -> str:
    if not (path.endswith(".py") and PurePath(path).stem.isidentifier()):
        raise ValueError("must be the path of a Python file, as 'claims.py'")
    return path


class ModuleTable(TomlTable):
    """A user module: `module` is a path relative to the study file."""

    module: Annotated[str, AfterValidator(_python_file)]


class BranchesTable(TomlTable):
    """Branches of periodic orbits, continued from the attractors."""

    along: str = "omega"
    second: str | None = None  # of the curves of special points
    range: Range | None = None
    follow: Annotated[int, Field(ge=0, le=10)] = 0
    max_steps: Annotated[int, Field(ge=2, le=100_000)] = 1000
    rtol: Annotated[float, Field(ge=SMALLEST_RTOL, le=LARGEST_RTOL)] | None = None
    atol: Positive | None = None

    def problems(
        self,
        axes: Axes,
        known: Mapping[str, float],
        contacts: Mapping[str, ContactTable],
        is_followed: Callable[[Representation, str], bool],
    ) -> Iterator[str]:
        """Problems of the parameters, for the axes and the other parameters of a study.

        `known` are values of the numbers of the model and of contacts in its representations.
        `is_followed`: that of the model.
        """
        names = [name for name in axes if name not in _NO_PARAMETERS and len(axes[name]) > 1]
        if self.along not in names:
            swept = ", ".join(names) or "none; write several values in [[sweep]]"
            yield f"branches.along = {self.along!r}: must be a swept parameter: {swept}"
        for key, value in (("along", self.along), ("second", self.second)):
            name = "gap" if value in WALLS else value or ""
            if any(getattr(contact, name, None) is not None for contact in contacts.values()):
                yield f"branches.{key} = {value!r}: must be set in [[sweep]], not in [contact]"
        yield from self._problems_of_second(axes, known)
        if not any(is_followed(one, self.along) for one in axes["representation"]):
            yield (
                "branches: no representation of the study can be continued along "
                f"{self.along}; add one that has it, as 'piecewise' or 'huntcrossley'"
            )

    def _problems_of_second(self, axes: Axes, known: Mapping[str, float]) -> Iterator[str]:
        """Problems of the second parameter and its range."""
        name, along = self.second, self.along
        if name is None or self.range is None:
            if (name is None) != (self.range is None):
                yield "branches: give both or neither, as second = 'K_c' and range = [1.0, 2.0]"
            return
        others = {"representation", START, along, *(["gap"] if along in WALLS else [])}
        every = dict.fromkeys([*axes, *known, *WALLS])
        allowed = [x for x in every if x not in others]
        if name not in allowed:
            yield f"branches.second = {name!r}: must be one of {', '.join(allowed)}"
            return
        (low, high), of_name = self.range, {*WALLS} if name in WALLS else {name}
        if any(len(axes[x]) > 1 for x in {*axes} & of_name - {along}):
            yield f"branches.second = {name!r}: must have one value in [[sweep]]; range varies it"
        value = axes[name][0] if name in axes else known.get(name)
        if name in WALLS and "gap" in axes:
            gap = axes["gap"][0]
            value = gap.distances[0] if name == "gap" else getattr(gap, name)
        if not low < high:
            yield f"branches.range = {self.range}: must be ascending, of two different values"
        elif value is not None and not low <= value <= high:
            yield f"branches.range = {self.range}: must contain {name} = {value:g} of the study"


class GradientsTable(TomlTable):
    """Derivatives of the quantities of all periodic attractors by parameters."""

    by: Annotated[list[str], Field(min_length=1)]


# Axes along which no branch is continued.
_NO_PARAMETERS = ("representation", "gap", START)
WALLS = ("gap", "j_1", "j_2")
# Tables that only studies of oscillators have.
_OF_OSCILLATORS = ("oscillator", "auto", "history", "bench")


class StudySpec(TomlTable):
    study: StudyTable
    oscillator: OscillatorTable | None = None  # None: of a [system]
    system: SystemTable | None = None
    parameters: dict[str, Number] = Field({})
    contact: dict[str, ContactTable] = Field({})
    sweep: Annotated[list[SweepTable], Field(min_length=1)]
    solver: SolverTable = SolverTable()
    protocol: dict[Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")], SolverTable] = Field({})
    steady: SteadyTable = SteadyTable()
    approximation: ApproximationTable = ApproximationTable()
    auto: AutoTable = AutoTable()
    history: list[HistoryTable] = Field([])
    bench: BenchTable | None = None
    attractors: AttractorsTable | None = None
    branches: BranchesTable | None = None
    uncertain: UncertainTable | None = None
    fit: FitTable | None = None
    gradients: GradientsTable | None = None
    claims: ModuleTable | None = None
    report: ModuleTable | None = None  # of additional sections of the report

    @model_validator(mode="before")
    @classmethod
    def _with_parameters_apart(cls, given: Any) -> Any:
        """Return a study's tables, each block and history with its parameters in a table within it.

        A missing number of the oscillator that all blocks sweep gets its first value there, and
        blocks with only user laws, without walls, get zeros for `K_c` and `gap`. Raises
        `ValueError` if a name in [parameters] is reserved or no identifier, or if a table is not
        allowed with [system].
        """
        if not isinstance(given, dict):
            return given
        own = given.get("parameters") or {}
        if not isinstance(own, dict) or not all(isinstance(name, str) for name in own):
            return given | {"sweep": []}  # reports only the problem of [parameters]
        given = _with_medians(given)
        is_system = given.get("system") is not None
        taken = TAKEN if is_system else TAKEN.union(OscillatorTable.model_fields)
        names = _parameters(given)
        wrong = [
            f"{name}: not allowed with [system]"
            for name in _OF_OSCILLATORS
            if is_system and given.get(name)
        ]
        wrong += [
            f"parameters: {name!r} is a reserved name; choose another name"
            for name in own
            if name in taken
        ]
        wrong += [
            f"parameters: {name!r}: must be a name of letters, digits and '_'"
            for name in own
            if not name.isidentifier()
        ]
        if wrong:
            raise ValueError("; ".join(wrong))
        if not is_system:
            blocks = given.get("sweep")
            if isinstance(blocks, list):
                given = given | {"sweep": [_with_walls(block) for block in blocks]}
            given = given | {"oscillator": _with_swept(given.get("oscillator"), blocks)}
        return given | {
            key: [_parted(table, names) for table in given[key]]
            for key in ("sweep", "history")
            if isinstance(given.get(key), list)
        }

    @property
    def representations(self) -> list[Representation]:
        """Representations of all sweeps, histories and methods of the benchmark."""
        tables: list[SweepTable | HistoryTable] = [*self.sweep, *self.history]
        methods = self.bench.method if self.bench else []
        several = [one for table in tables for one in table.representation]
        return [*several, *(method.label for method in methods)]

    @property
    def model(self) -> dict[str, float]:
        """Default values of all parameters of the model."""
        return self.oscillator.numbers if self.oscillator else self.parameters

    @property
    def tables(self) -> dict[str, Any]:
        """The checked study, defaults filled in, as the tables of its file."""
        left_out: tuple[str, ...] = _OF_OSCILLATORS if self.system else ("contact",)
        left_out = left_out if self.parameters else (*left_out, "parameters")
        tables = self.model_dump(exclude_none=True)
        uncertain = [tables["uncertain"]] if self.uncertain else []
        for table in (*tables["sweep"], *tables["history"], *uncertain):
            table |= table.pop("parameter")
        return {name: table for name, table in tables.items() if name not in left_out}

    @model_validator(mode="after")
    def _of_one_thing(self) -> "StudySpec":
        if self.system is None and self.contact:
            raise ValueError("contact: needs [system]")
        swept = [one for block in self.sweep for one in block.representation]
        if self.system is None and self.parameters and not any(one.is_own for one in swept):
            raise ValueError("parameters: needs [system], or an own contact law, as module:name")
        return self

    @model_validator(mode="after")
    def _consistent(self) -> "StudySpec":
        scenes = self.bench.scene if self.bench else []
        methods = self.bench.method if self.bench else []
        used = {one.protocol for one in self.representations if one.protocol}
        wrong = [
            f"protocol {name!r} is used by a label, but [protocol.{name}] is missing"
            for name in sorted(used - set(self.protocol))
        ]
        if any(one.is_auto and one.protocol for one in self.representations):
            wrong.append("'auto' chooses solver settings; leave out the protocol")
        if self.uncertain:
            several = [name for name in ("branches", "fit", "gradients") if getattr(self, name)]
            said = "not together with [uncertain]; write a separate study"
            wrong += [f"{name}: {said}" for name in several]
        if self.attractors and any(one.is_own for one in self.representations):
            wrong.append("attractors: not with user laws; call gs.basins(..., rays=32)")
        if any(one.is_auto for table in self.history for one in table.representation):
            wrong.append("history: 'auto' is not allowed; write a representation, as 'piecewise'")
        if any(method.label.is_auto for method in methods):
            wrong.append("bench: 'auto' is not allowed; write a representation, as 'piecewise'")
        if len({(block.gap is None, block.j_1 is None) for block in self.sweep}) > 1:
            wrong.append("sweep: give gap in every block, or j_1 and j_2 in every block")
        for name in ("K_c", "omega"):
            if len({getattr(block, name) is None for block in self.sweep}) > 1:
                wrong.append(f"sweep: give {name} in every block, or in none")
        n_points = sum(block.count for block in self.sweep)
        n_points *= self.uncertain.count if self.uncertain else 1
        if n_points > MAX_POINTS:
            number = n_points if n_points < 10**15 else "more than 10^15"
            wrong.append(f"{number} sweep points: must be <= {MAX_POINTS}; coarsen a grid")
        wrong += [
            f"bench.scene[{scene.name!r}]: {problem}"
            for scene in scenes
            if self.oscillator
            for problem in scene.contradictions(self.oscillator)
        ]
        if wrong:
            raise ValueError("; ".join(wrong))
        return self


def _parameters(tables: Any) -> Any:
    """Return the names of the parameters of model and laws in tables not yet checked."""
    given = (isinstance(tables, dict) and tables.get("parameters")) or {}
    if isinstance(tables, dict) and tables.get("system") is not None:
        return given
    return [*OscillatorTable.model_fields, *given]


def _with_medians(given: dict[str, Any]) -> dict[str, Any]:
    """Return a study's tables; a missing value of an uncertain number is its median."""
    try:
        uncertain = UncertainTable.model_validate(given.get("uncertain"))
    except ValidationError:  # reported with the other problems
        return given
    of_oscillator = given.get("oscillator", {})
    if given.get("system") is None and isinstance(of_oscillator, dict):
        known = {n: uncertain.median(n) for n in OscillatorTable.model_fields}
        known = {name: value for name, value in known.items() if value is not None}
        given = given | {"oscillator": {**known, **of_oscillator}}
    walls = {name: uncertain.median(name) for name in ("K_c", "gap")}
    blocks = given.get("sweep")
    if not isinstance(blocks, list):
        return given
    return given | {"sweep": [_walled(block, walls) for block in blocks]}


def _walled(block: Any, walls: Mapping[str, Any]) -> Any:
    """Return a block with these values of stiffness and gap if it has none."""
    if not isinstance(block, dict):
        return block
    more = {name: value for name, value in walls.items() if value is not None}
    if {"j_1", "j_2"} & block.keys():
        more.pop("gap", None)
    return {**more, **block}


def _with_swept(table: Any, blocks: Any) -> Any:
    """Return the oscillator table; a missing number that all blocks sweep is its first value."""
    table = {} if table is None else table
    if not (isinstance(table, dict) and isinstance(blocks, list) and blocks):
        return table
    for name, field in OscillatorTable.model_fields.items():
        swept = all(isinstance(block, dict) and name in block for block in blocks)
        if field.is_required() and name not in table and swept:
            first = blocks[0][name]
            first = first.get("start") if isinstance(first, dict) else first
            first = first[0] if isinstance(first, list) and first else first
            # Values of another form are refused in [[sweep]].
            table = table | {name: first if isinstance(first, int | float) else 1.0}
    return table


def _with_walls(block: Any) -> Any:
    """Return a block; if it has only user laws and no K_c and gap, with zeros for them."""
    labels = several(block.get("representation")) if isinstance(block, dict) else None
    own = isinstance(labels, list) and all(
        isinstance(label, str) and Representation(label).is_own for label in labels
    )
    if not own or {"K_c", "gap", "j_1", "j_2"} & block.keys():
        return block
    return block | {"K_c": 0.0, "gap": [0.0, 0.0]}


def _parted(block: Any, parameters: Collection[str]) -> Any:
    """Return a block or a history with its parameters moved to a table within it."""
    if not isinstance(block, dict):
        return block
    if PARAMETERS in block:  # no key of a file: refused as unknown
        return block | {"parameters": block[PARAMETERS]}
    apart = {name: axis for name, axis in block.items() if name in parameters}
    rest = {name: axis for name, axis in block.items() if name not in parameters}
    return rest | {PARAMETERS: apart}


def read(path: str | PathLike[str]) -> StudySpec:
    """Read and check a study file; none of the code that it names is run.

    Raises
    ------
    StudyError
        If the file cannot be read; or as in `parse`.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")  # as some editors save it
    except OSError as error:
        remedy = "write an example study with 'gapsweep init'"
        raise StudyError(f"{path}: cannot be read: {error.strerror}; {remedy}") from None
    except UnicodeDecodeError:
        raise StudyError(f"{path}: not valid TOML: must be UTF-8 text") from None
    return parse(text, str(path))


def parse(text: str, source: str = "study") -> StudySpec:
    """Check the text of a study file.

    Raises `StudyError` with one line per problem, each naming `source`, the key, the value and what
    is allowed.
    """
    try:
        tables = tomllib.loads(text)
    except RecursionError:
        problem = "brackets are nested too deeply; close them"
        raise StudyError(f"{source}: not valid TOML: {problem}") from None
    except ValueError as error:  # numbers too long, too
        raise StudyError(f"{source}: not valid TOML: {error}{_line(text, error)}") from None
    return check(tables, source)


def _line(text: str, error: ValueError) -> str:
    """Return the line of a TOML error, or the one before, where an open bracket or quote may be."""
    place = re.search(r"at line (\d+), column (\d+)\)", str(error))
    if place is None:
        return ""
    is_before = place[2] == "1" and place[1] != "1"
    number = int(place[1]) - is_before
    line = text.splitlines()[number - 1 : number]
    words = f"; is line {number} complete?" if is_before else ":"
    return "".join(f"{words} {each:.60}" for each in line)


def check(tables: dict[str, Any], source: str = "study") -> StudySpec:
    """Check the tables of a study; see `parse`."""
    tables = with_numbers(with_sweep(with_data(with_points(tables, source), source), source))
    try:
        return StudySpec.model_validate(tables)
    except ValidationError as error:
        also = wrong_matrices(tables, source)
        found = problems(source, error, StudySpec, _parameters(tables))
        raise StudyError(*found, *_missing(tables, source), *also) from None


def _missing(tables: Any, source: str) -> list[str]:
    """Return a problem per missing K_c or omega of a block, for a study with other problems."""
    given = isinstance(tables, dict) and tables.get("system") is None
    blocks = tables.get("sweep") if given else None
    return [
        f"{source}: sweep[{i}].{name}: missing; write {EXAMPLES[name]}"
        for i, block in enumerate(map(_with_walls, blocks if isinstance(blocks, list) else []))
        for name in ("K_c", "omega")
        if isinstance(block, dict) and name not in block
    ]
