"""A study: its settings and the labelled grid of its sweep points."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import ModelError, StudyError
from gapsweep.integrate.problem import Solver
from gapsweep.model.labels import AUTO, canonical_label
from gapsweep.model.oscillator import Gap, Oscillator
from gapsweep.response.result import Steady
from gapsweep.study.advice import Advice, advise
from gapsweep.study.points import FIXED, Point, Start, canonical, content_key, law_code
from gapsweep.study.spec import (
    MAX_POINTS,
    HistoryTable,
    ModuleTable,
    SobolStarts,
    SolverTable,
    StudySpec,
    SweepTable,
    check,
    parse,
)

Index = tuple[int, int, int, int, int]


@dataclass(frozen=True)
class Grid:
    """Coordinates of the dataset and which of its cells are sweep points.

    Attributes
    ----------
    representations : tuple of str
        Labels in order of first appearance, protocol included.
    K_c, omega : tuple of float
        Ascending [N/m], [Hz].
    gaps : tuple of Gap
    starts : tuple of Start
        In order of first appearance over the blocks.
    requested : ndarray of bool, shape (representation, K_c, gap, omega, initial_condition)
    """

    representations: tuple[str, ...]
    K_c: tuple[float, ...]
    gaps: tuple[Gap, ...]
    omega: tuple[float, ...]
    starts: tuple[Start, ...]
    requested: NDArray[np.bool_]

    @property
    def shape(self) -> tuple[int, ...]:
        return self.requested.shape

    def flat(self, index: Index) -> int:
        """Position of a cell when all are counted in order."""
        position = 0
        for size, i in zip(self.shape, index, strict=True):
            position = position * size + i
        return position

    def cut(self, selection: "Selection") -> "Grid":
        """The selected part, as a grid of its own."""
        r, k, g, w, i = selection.positions
        return Grid(
            representations=tuple(self.representations[n] for n in r),
            K_c=tuple(self.K_c[n] for n in k),
            gaps=tuple(self.gaps[n] for n in g),
            omega=tuple(self.omega[n] for n in w),
            starts=tuple(self.starts[n] for n in i),
            requested=self.requested[np.ix_(*selection.positions)],
        )


@dataclass(frozen=True, slots=True)
class Selection:
    """Part of a study's grid: the positions wanted along each dimension, ascending."""

    positions: tuple[tuple[int, ...], ...]

    def mask(self, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """Which cells of a grid are selected."""
        wanted = np.zeros(shape, dtype=bool)
        wanted[np.ix_(*self.positions)] = True
        return wanted


@dataclass(frozen=True)
class Study:
    """Everything a run needs to know; immutable.

    Attributes
    ----------
    name, title : str
    spec : StudySpec
        The checked study file.
    source : str
        Where it came from, for messages.
    """

    spec: StudySpec
    source: str = "study"

    @classmethod
    def load(cls, path: str | Path) -> "Study":
        """Read and check a study file.

        Raises
        ------
        StudyError
            If the file is missing or anything in it is wrong, one line per problem.
        """
        path = Path(path)
        try:
            text = path.read_text(encoding="utf-8")
        except OSError as error:
            raise StudyError([f"{path}: cannot be read: {error.strerror}"]) from None
        except UnicodeDecodeError:
            raise StudyError([f"{path}: not valid TOML: must be UTF-8 text"]) from None
        return cls(parse(text, str(path)), str(path))._checked()

    @classmethod
    def from_dict(cls, tables: dict[str, Any], source: str = "study") -> "Study":
        """Check a study given as the tables of its TOML file."""
        return cls(check(tables, source), source)._checked()

    def _checked(self) -> "Study":
        try:
            _ = self._protocols
        except ModelError as error:
            raise StudyError([f"{self.source}: solver: {error}"]) from None
        self._check_modules()
        cells = int(np.prod([len(axis) for axis in self._axes], dtype=np.int64))
        if cells > MAX_POINTS:
            raise StudyError(
                [
                    f"{self.source}: the blocks together span {cells} dataset cells, must be "
                    f"<= {MAX_POINTS}; split them into several studies"
                ]
            )
        return self

    def _check_modules(self) -> None:
        """Refuse code beside the study that cannot be read; none of it is run."""
        problems = []
        for table, path in (("claims", self.claims_module), ("report", self.report_module)):
            try:
                if path is not None:
                    path.read_bytes()
            except OSError as error:
                problems.append(
                    f"{self.source}: {table}.module: {path} cannot be read: {error.strerror}"
                )
        if problems:
            raise StudyError(problems)

    @property
    def name(self) -> str:
        return self.spec.study.name

    @property
    def title(self) -> str:
        return self.spec.study.title or self.name

    @property
    def json(self) -> str:
        """The checked study, defaults filled in, as JSON."""
        return json.dumps(self.spec.model_dump(exclude_none=True), sort_keys=True)

    @property
    def claims_module(self) -> Path | None:
        """The Python file that states the claims, beside the study file."""
        return self._beside(self.spec.claims)

    @property
    def report_module(self) -> Path | None:
        """The Python file that makes sections of the report, beside the study file."""
        return self._beside(self.spec.report)

    def _beside(self, table: ModuleTable | None) -> Path | None:
        return None if table is None else Path(self.source).parent / table.module

    @cached_property
    def oscillator(self) -> Oscillator:
        return Oscillator(**self.spec.oscillator.model_dump())

    @cached_property
    def steady(self) -> Steady:
        return Steady(**self.spec.steady.model_dump())

    @property
    def own_laws(self) -> tuple[str, ...]:
        """The code that the study names: laws of the user's own, as ``module:function``."""
        tables: list[SweepTable | HistoryTable] = [*self.spec.sweep, *self.spec.history]
        labels = [label for table in tables for label in table.representation]
        labels += [method.label for method in self.spec.bench.method] if self.spec.bench else []
        return tuple(dict.fromkeys(x.partition("@")[0] for x in labels if ":" in x))

    def with_engine(self, engine: str) -> "Study":
        """The same study on another engine."""
        solver = self.spec.solver.model_copy(update={"engine": engine})
        return Study(self.spec.model_copy(update={"solver": solver}), self.source)

    @cached_property
    def _protocols(self) -> dict[str, tuple[Solver, float]]:
        """Solver and start jitter by protocol; the empty name is plain ``[solver]``."""
        return {name: self._protocol(name) for name in ("", *self.spec.protocol)}

    def _protocol(self, name: str) -> tuple[Solver, float]:
        tables = [self.spec.solver] + ([self.spec.protocol[name]] if name else [])
        given = {k: v for table in tables for k, v in _given(table).items()}
        jitter = given.pop("start_jitter", 0.0)
        return Solver.of(**given), jitter

    @cached_property
    def _blocks(self) -> list[tuple[list[Any], ...]]:
        return [_expanded(block) for block in self.spec.sweep]

    @cached_property
    def _axes(self) -> tuple[tuple[Any, ...], ...]:
        unions = [
            tuple(dict.fromkeys(value for block in self._blocks for value in block[axis]))
            for axis in range(5)
        ]
        for ascending in (1, 3):
            unions[ascending] = tuple(sorted(unions[ascending]))
        return tuple(unions)

    @cached_property
    def grid(self) -> Grid:
        """The labelled grid: the union of all blocks."""
        requested = np.zeros([len(axis) for axis in self._axes], dtype=bool)
        places = [{value: i for i, value in enumerate(axis)} for axis in self._axes]
        for block in self._blocks:
            at = [[place[v] for v in values] for place, values in zip(places, block, strict=True)]
            requested[np.ix_(*at)] = True
        representations, K_c, gaps, omega, starts = self._axes
        return Grid(representations, K_c, gaps, omega, starts, requested)

    def select(self, **wanted: Any) -> Selection:
        """Select among the study's own coordinates.

        Parameters
        ----------
        representation, gap : str or sequence of str, optional
            Labels, as ``"tanh-1e4"`` and ``"0.4/0.4"``.
        K_c, omega : float, slice or sequence of float, optional
            Values [N/m], [Hz]; slices include both ends. Compared after rounding to 12
            significant digits.
        initial_condition : int, slice or sequence of int, optional
            Numbers of starts.

        Raises
        ------
        StudyError
            If a name is no dimension, or a value is not among the study's own.
        """
        grid = self.grid
        axes: dict[str, Sequence[Any]] = {
            "representation": grid.representations,
            "K_c": grid.K_c,
            "gap": [gap.label for gap in grid.gaps],
            "omega": grid.omega,
            "initial_condition": range(len(grid.starts)),
        }
        problems = [
            f"{self.source}: {name}: no dimension of the study; choose from {', '.join(axes)}"
            for name in wanted.keys() - axes.keys()
        ]
        positions = []
        for name, axis in axes.items():
            try:
                positions.append(_positions(name, axis, wanted.get(name, slice(None))))
            except ValueError as error:
                problems.append(f"{self.source}: {error}")
        if problems:
            raise StudyError(problems)
        return Selection(tuple(positions))

    def point(self, index: Index) -> Point:
        """The sweep point at a position of the grid; for ``auto``, the one that it chooses."""
        grid = self.grid
        r, k, g, w, i = index
        full = grid.representations[r]
        point = Point(
            oscillator=self.oscillator,
            representation=full.partition("@")[0],
            K_c=grid.K_c[k],
            gap=grid.gaps[g],
            omega=grid.omega[w],
            start=grid.starts[i],
            solver=self.solver(full),
            steady=self.steady,
            fit_range=self.spec.fit.range,
            start_jitter=self.start_jitter(full),
            law_code=law_code(full.partition("@")[0]),
        )
        if full != AUTO:
            return point
        least = self.advice(index)
        return replace(
            point,
            representation="piecewise",
            oscillator=least.oscillator,
            K_c=least.K_c,
            solver=point.solver.with_rtol(least.rtol),
        )

    def advice(self, index: Index, error: float | None = None) -> Advice:
        """The least model that is adequate at a position of the grid, whatever representation.

        Parameters
        ----------
        index : Index
        error : float, optional
            What it has to meet; that of ``[auto]`` if None.
        """
        grid = self.grid
        _, k, g, w, i = index
        start = grid.starts[i]
        return advise(
            self.oscillator,
            grid.K_c[k],
            grid.gaps[g],
            grid.omega[w],
            (start.x_0, start.v_0) if start.kind == FIXED else None,
            error=self.spec.auto.error if error is None else error,
        )

    def chains(self, selection: Selection | None = None) -> Iterator[tuple[Index, ...]]:
        """Indices of all sweep points, grouped: what must be computed in order, together.

        A fixed start makes a chain of one. A sweep makes a chain of all its frequencies; of a
        selection, up to the last one selected.
        """
        grid = self.grid
        wanted = grid.requested
        if selection is not None:
            wanted = wanted & selection.mask(grid.shape)
        for r, k, g in np.ndindex(grid.shape[:3]):
            for i, start in enumerate(grid.starts):
                ends = np.flatnonzero(wanted[r, k, g, :, i]).tolist()
                if start.kind == FIXED:
                    yield from (((r, k, g, w, i),) for w in ends)
                elif ends:
                    along = np.flatnonzero(grid.requested[r, k, g, :, i]).tolist()
                    up = start.kind == "sweep_up"
                    order = (
                        along[: along.index(ends[-1]) + 1]
                        if up
                        else along[along.index(ends[0]) :][::-1]
                    )
                    yield tuple((r, k, g, w, i) for w in order)

    def solver(self, label: str) -> Solver:
        """Solver settings of a representation, its protocol's where the label has one.

        Of ``auto`` the loosest that it may choose for a point.
        """
        solver = self._protocols[label.partition("@")[2]][0]
        return solver.with_rtol(self.spec.auto.error) if label == AUTO else solver

    def start_jitter(self, label: str) -> float:
        """What a representation's protocol adds to fixed initial displacements [m]."""
        return self._protocols[label.partition("@")[2]][1]

    def identities(self, chain: tuple[Index, ...]) -> list[str]:
        """Canonical JSON of a chain's points; each holds the key of the point before it."""
        identities: list[str] = []
        previous = None
        for index in chain:
            identities.append(self.point(index).identity(previous))
            previous = content_key(identities[-1]).hex()
        return identities

    def keys(self, chain: tuple[Index, ...]) -> list[bytes]:
        """Content keys of a chain's points."""
        return [content_key(identity) for identity in self.identities(chain)]


def _given(table: SolverTable) -> dict[str, Any]:
    return {k: v for k, v in table.model_dump(exclude_unset=True).items() if v is not None}


def _expanded(block: SweepTable) -> tuple[list[Any], ...]:
    """A block's values along the five dimensions, canonical and without repeats."""
    omega = block.omega if isinstance(block.omega, list) else block.omega.values()
    values = (
        block.representation,
        [canonical(K_c) for K_c in block.K_c],
        [Gap(canonical(j_1), canonical(j_2)) for j_1, j_2 in block.gap],
        [canonical(w) for w in omega],
        _starts(block.initial_condition),
    )
    return tuple(list(dict.fromkeys(v)) for v in values)


def _starts(spec: Any) -> list[Start]:
    """The starts of one form, or of a list of forms."""
    if isinstance(spec, str):
        return [Start(spec)]
    if isinstance(spec, list) and isinstance(spec[0], str | SobolStarts):
        return [start for form in spec for start in _starts(form)]
    if isinstance(spec, SobolStarts):
        from scipy.stats import qmc  # a second to import, and few studies need it

        # Sobol points are balanced in powers of two; the first ones of the next power.
        exponent = (spec.sobol - 1).bit_length()
        unit = qmc.Sobol(d=2, scramble=True, rng=spec.seed).random_base2(exponent)[: spec.sobol]
        low, high = zip(spec.x, spec.v, strict=True)
        states = (np.array(low) + unit * (np.array(high) - np.array(low))).tolist()
    else:
        states = spec
    return [Start(FIXED, canonical(x), canonical(v)) for x, v in states]


def _positions(name: str, axis: Sequence[Any], wanted: Any) -> tuple[int, ...]:
    """Where on an axis the wanted values lie; ValueError if one is not there."""
    if isinstance(wanted, slice):
        if wanted.step is not None:
            raise ValueError(f"{name} = {wanted}: a slice has no step here")
        if wanted == slice(None):
            return tuple(range(len(axis)))
        if name in ("representation", "gap"):
            raise ValueError(f"{name} = {wanted}: give labels, not a slice")
        low = canonical(axis[0] if wanted.start is None else wanted.start)
        high = canonical(axis[-1] if wanted.stop is None else wanted.stop)
        found = tuple(i for i, value in enumerate(axis) if low <= value <= high)
        if not found:
            raise ValueError(
                f"{name} = {low:g} to {high:g}: nothing there; the study has {_listed(axis)}"
            )
        return found
    several = isinstance(wanted, Sequence | np.ndarray) and not isinstance(wanted, str)
    places = {value: i for i, value in enumerate(axis)}
    found_all = []
    for value in wanted if several else [wanted]:
        at = places.get(_comparable(name, value))
        if at is None:
            raise ValueError(f"{name} = {value!r}: not in the study, which has {_listed(axis)}")
        found_all.append(at)
    if not found_all:
        raise ValueError(f"{name} = []: nothing selected")
    return tuple(sorted(set(found_all)))


def _comparable(name: str, value: Any) -> Any:
    """A wanted value in the form in which the axis holds it; None if it has none."""
    try:
        if name == "representation":
            law, at, protocol = str(value).partition("@")
            return canonical_label(law) + at + protocol
        return str(value) if name == "gap" else canonical(value)
    except (TypeError, ValueError):
        return None


def _listed(axis: Sequence[Any]) -> str:
    """Some of an axis' values for a message."""
    shown = [f"{value:g}" if isinstance(value, float) else str(value) for value in axis]
    return ", ".join(shown if len(shown) <= 8 else [*shown[:3], "...", *shown[-3:]])
