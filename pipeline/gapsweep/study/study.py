"""A study: its settings and the labelled grid of its sweep points."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from html import escape
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import ModelError, StudyError
from gapsweep.integrate.problem import Solver
from gapsweep.model.contact import OF_WALLS, ContactLaw, Piecewise
from gapsweep.model.labels import EXACT, Representation, contact_law
from gapsweep.model.oscillator import Gap, Oscillator
from gapsweep.model.own_law import OwnLaw, checked
from gapsweep.model.parameters import Parameter, with_numbers
from gapsweep.model.structure import AnyStructure
from gapsweep.response.result import Steady
from gapsweep.study.axes import MAX_POINTS, MAX_VALUES, forms
from gapsweep.study.axis_selection import listed, numbers_of_sweeps, positions
from gapsweep.study.blocks import expanded, requested_of, union
from gapsweep.study.grid import START, Axes, Grid, Selection, Starts
from gapsweep.study.least_model import (
    Least,
    check_error,
    least_of,
    unknown,
    without_what_has_no_effect,
)
from gapsweep.study.parametric_model import ParametricModel
from gapsweep.study.points import FIXED, SWEEPS, Kind, Points, canonical, columns_of
from gapsweep.study.samples import SAMPLE, Samples
from gapsweep.study.spec import HistoryTable, ModuleTable, StudySpec, check, read
from gapsweep.user_code.snapshot import Snapshot


@dataclass(frozen=True)
class Study:
    """A parameter study: models, swept values and settings; immutable.

    Attributes
    ----------
    name, title : str
    spec : StudySpec
        The checked study file.
    source : str
        Path of the study file, for messages.

    Examples
    --------
    >>> import gapsweep as gs
    >>> block = {"representation": "piecewise", "K_c": 1e4, "gap": [4e-4, 4e-4], "omega": 9.0}
    >>> m = {"mass": 3.0, "omega_n": 5.0, "zeta": 0.03, "forcing": 4.0}
    >>> study = gs.Study.from_dict({"study": {"name": "small"}, "oscillator": m, "sweep": [block]})
    >>> study
    <Study 'small': 1 sweep point, representation 1, K_c 1, gap 1, omega 1, initial_condition 1>
    """

    spec: StudySpec
    source: str = "study"

    def __post_init__(self) -> None:
        if not isinstance(self.spec, StudySpec):
            raise StudyError(
                f"{self.spec!r:.80}: write gs.Study.load(path) or gs.Study.from_dict(tables)"
            )

    def __repr__(self) -> str:
        n = int(self.grid.requested.sum())
        sizes = (
            f"{name} {size}" for name, size in zip(self.grid.dims, self.grid.shape, strict=True)
        )
        points = f"{n} sweep point{'s' * (n != 1)}"
        return f"<Study {self.name!r}: {', '.join([points, *sizes])}>"

    def _repr_html_(self) -> str:
        """Return the study as HTML for notebooks: title, and values along each dimension."""
        rows = [
            f"<tr><th>{name}</th><td>{size}</td><td>{escape(_ends(self.grid.labels(name)))}</td></tr>"
            for name, size in zip(self.grid.dims, self.grid.shape, strict=True)
        ]
        return (
            f"<b>{escape(self.title)}</b>: {int(self.grid.requested.sum())} sweep points"
            f"<table><tr><th>dimension</th><th>size</th><th>values</th></tr>{''.join(rows)}</table>"
        )

    def plan(self, **options: Any) -> Any:
        """Return the cached and the missing points: `gapsweep.plan` of this study."""
        from gapsweep import plan

        return plan(self, **options)

    def run(self, **options: Any) -> Any:
        """Compute the study and open its responses: `gapsweep.run` with the same options."""
        from gapsweep import run

        return run(self, **options)

    def query(self, **wanted: Any) -> Any:
        """Return responses of a part of the study, computed if missing: `gapsweep.query` of it."""
        from gapsweep import query

        return query(self, **wanted)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> "Study":
        """Read and check a study file.

        Raises
        ------
        StudyError
            If the file is missing or invalid; the message has one line per problem.
        """
        return cls(read(path), str(path))._checked()

    @classmethod
    def from_dict(cls, tables: dict[str, Any], source: str = "study") -> "Study":
        """Return the study of a dict with the tables of a study file; checked as by `load`."""
        try:
            return cls(check(_lists(tables), source), source)._checked()
        except RecursionError:
            problem = f"{source}: nested too deeply; a table or list must not contain itself"
            raise StudyError(problem) from None

    @classmethod
    def of(cls, study: "Study | str | PathLike[str]") -> "Study":
        """Return the study of a file, or a study with its user modules reread."""
        if isinstance(study, str | PathLike):
            return cls.load(study)
        if not isinstance(study, Study):
            raise StudyError(
                f"study = {study!r:.80}: must be a gapsweep.Study or the path of a study file"
            )
        return replace(study) if study.names_code else study

    def _checked(self) -> "Study":
        for name in self.spec.protocol:
            self._protocol(name)  # to refuse wrong settings now
        try:
            axes = self._axes
        except ModelError as error:
            raise StudyError(f"{self.source}: sweep: {error}") from None
        self._check_modules()
        self.model.check()
        known = {**self.spec.model, **self.spec.parameters}
        histories = enumerate(self.spec.history)
        lines = chain(
            self._problems_of_solvers(),
            *(table.undecided(f"history[{i}]", known, axes) for i, table in histories),
        )
        if self.spec.branches:
            several = {**known, **self._of_contacts}
            about = axes, several, self.spec.contact, self.model.is_followed
            of_branches = self.spec.branches.problems(*about)
            second = {self.spec.branches.second or "": self.spec.branches.range or []}
            lines = chain(lines, of_branches, self._problems_of_ranges("branches.range", second))
        if fit := self.spec.fit:
            first = self.model.laws(axes["representation"][0].law)
            kinds = [law.law_type or ContactLaw for law in first]
            of_law = [n for n in ("K_c", "gap", *OF_WALLS) if any(k.takes(n) for k in kinds)]
            walls = [*of_law, "j_1", "j_2"] if first else []
            of_fit = fit.problems(axes, [*walls, *known], self.spec.contact.values())
            lines = chain(lines, of_fit, self._problems_of_ranges("fit.free", fit.free))
        if self.spec.gradients:
            lines = chain(lines, self._problems_of_gradients(self.spec.gradients.by))
        if self.spec.uncertain:
            lines = chain(lines, self._problems_of_uncertain())
        problems = [f"{self.source}: {line}" for line in lines]
        if problems:
            raise StudyError(*problems)
        cells = math.prod(map(len, axes.values()))
        if cells > MAX_POINTS:
            raise StudyError(
                f"{self.source}: all blocks together have {cells} dataset cells, must be "
                f"<= {MAX_POINTS}; split them into several studies"
            )
        return self

    @property
    def _of_contacts(self) -> dict[str, float]:
        """Elastic values of the parameters of contacts that some representation takes."""
        laws, takes = self._axes["representation"], self.model.takes
        return {n: x for n, x in OF_WALLS.items() if any(takes(one.law, n) for one in laws)}

    def _problems_of_solvers(self) -> Iterator[str]:
        """Representations with solver settings with which the engine cannot locate contacts."""
        asked = [(one, self._axes) for one in self._axes["representation"]]
        for table in self.spec.history:
            asked += [(one, self.history_axes(table)) for one in table.representation]
        for one, axes in asked:
            swept = {n: axes[n] for n in self.spec.model if n in axes and self.model.is_oscillator}
            ends = [{name: end(axis) for name, axis in swept.items()} for end in (min, max)]
            laws = self.model.laws(one.law)
            n_located = sum(law.is_located or law.is_auto for law in laws)
            try:
                models = [self.model.at(some) for some in ends]
                is_classic = all(isinstance(m, Oscillator) and m.is_classic for m in models)
                self.solver(one).check_located(n_located, len(laws), is_oscillator=is_classic)
            except ModelError as error:
                yield f"{one}: {error}"

    def _problems_of_ranges(
        self, where: str, ranges: Mapping[str, Sequence[float]]
    ) -> Iterator[str]:
        """Values of ranges of numbers that no model can have."""
        for name, value in ((name, value) for name, ends in ranges.items() for value in ends):
            try:
                for law in (Piecewise(1.0, Gap(1.0, 1.0)), *chain(*self._examples)):
                    with_numbers(law, {name: value})
                if self.model.is_oscillator and name in self.spec.model:
                    with_numbers(self.oscillator, {name: value})
            except ModelError as error:
                yield f"{where}: {error}"

    def _problems_of_gradients(self, names: Sequence[str]) -> Iterator[str]:
        """Names that are no parameters of the model or of the exact law."""
        model, examples = self.model.default, self._examples
        own = {} if self.model.is_oscillator else self.spec.parameters
        if not examples:
            yield f"gradients: no representation has located contacts; add {str(EXACT)!r}"
        for name in names:
            refused = []
            for laws in examples:
                try:
                    Parameter(name, None, own).values(model, laws, 1.0)
                except ModelError as error:
                    refused.append(f"gradients.by: {error}")
            yield from refused[:1] if len(refused) == len(examples) else ()

    @property
    def _examples(self) -> list[tuple[ContactLaw, ...]]:
        """Laws of all contacts of each representation with located contacts, with any numbers."""
        laws = [self.model.laws(one.law) for one in self._axes["representation"]]
        return [
            tuple(self.law(law, 1.0, Gap(1.0, 1.0)) for law in several)
            for several in laws
            if all(law.is_located for law in several)
        ]

    def _check_modules(self) -> None:
        """Refuse modules of [claims] and [report] that cannot be read; none of them is run."""
        problems = []
        for name, table in (("claims", self.spec.claims), ("report", self.spec.report)):
            if table is not None:
                path = self._next_to_study(table)
                try:
                    path.read_bytes()
                except OSError as error:
                    why = f"{path} cannot be read: {error.strerror}"
                    problems.append(f"{self.source}: {name}.module: {why}")
        if problems:
            raise StudyError(*problems)

    @property
    def name(self) -> str:
        return self.spec.study.name

    @property
    def title(self) -> str:
        return self.spec.study.title or self.name

    @property
    def attributes(self) -> dict[str, str]:
        """Global attributes of every dataset of the study, named by the CF and ACDD conventions."""
        table = self.spec.study
        texts = {"creator_name": table.creator, "license": table.license}
        given = {name: text for name, text in texts.items() if text}
        if not self.model.is_oscillator:
            given["system_json"] = self.model.json
        return {"title": self.title, "study": self.name, "study_json": self.json, **given}

    @property
    def json(self) -> str:
        """The checked study, defaults filled in, as JSON."""
        return json.dumps(self.spec.tables, sort_keys=True)

    @cached_property
    def model(self) -> ParametricModel:
        """The model as a function of its parameters."""
        return ParametricModel(self.spec, self.source, self.folders)

    @property
    def oscillator(self) -> Oscillator:
        """The oscillator at the default values of its parameters; not of a [system]."""
        assert isinstance(self.model.default, Oscillator)
        return self.model.default

    @property
    def structure(self) -> AnyStructure:
        """Numbers of coordinates, contacts and loads, the same for all points."""
        return self.model.structure

    @cached_property
    def steady(self) -> Steady:
        return Steady(**self.spec.steady.model_dump())

    @cached_property
    def claims_code(self) -> Snapshot | None:
        """Code of the module of [claims] and of its imports, read once."""
        return self._code(self.spec.claims)

    @cached_property
    def report_code(self) -> Snapshot | None:
        """Code of the module of [report] and of its imports, read once."""
        return self._code(self.spec.report)

    def _code(self, table: ModuleTable | None) -> Snapshot | None:
        try:
            return None if table is None else Snapshot.of_file(self._next_to_study(table))
        except ModelError as error:
            raise StudyError(str(error)) from None

    def _next_to_study(self, table: ModuleTable) -> Path:
        return Path(self.source).absolute().parent / table.module

    @cached_property
    def folders(self) -> tuple[Path, ...]:
        """Folders searched for user modules after Python's path: the study's and the current."""
        return tuple(dict.fromkeys((Path(self.source).absolute().parent, Path.cwd())))

    @cached_property
    def _known_laws(self) -> dict[str, OwnLaw]:
        """Cache of the user laws that have been read, by label."""
        return {}

    def own_law(self, label: str, **parameters: float) -> OwnLaw | None:
        """Return the user law of a label with some values of [parameters] replaced; None for laws
        of gapsweep.

        Raises
        ------
        ModelError
            If the code of the law cannot be read.
        """
        name = Representation(label).law
        if not name.is_own:
            return None
        if name not in self._known_laws:
            self._known_laws[name] = OwnLaw.of(name, self.folders)
        named = {**self.spec.parameters, **parameters}
        return replace(self._known_laws[name], parameters=tuple(named.items()))

    def law(self, label: str, K_c: float, gap: Gap, K_ratio: float = 1.0) -> ContactLaw:
        """Return the contact law of a label, without losses that the label does not set.

        The label may name a user law.

        Raises
        ------
        ModelError
            If the law cannot be built.
        """
        own = self.own_law(label)
        if own is not None:
            return own.law(K_c, gap, K_ratio)
        law = Representation(label).law
        numbers: dict[str, Any] = {
            "K_ratio": K_ratio,
            **{name: OF_WALLS[name] for name in law.missing},
        }
        return contact_law(law, K_c, gap, self.spec.approximation.range, **numbers)

    @property
    def own_laws(self) -> tuple[Representation, ...]:
        """The user laws of the study, as ``module:name``."""
        return tuple(dict.fromkeys(one.law for one in self.spec.representations if one.is_own))

    @property
    def names_code(self) -> bool:
        """Whether the study has user code: laws, the function of a system, modules."""
        system, modules = self.spec.system, (self.spec.claims, self.spec.report)
        return bool(self.own_laws or (system and system.user_function)) or any(modules)

    @property
    def nominal(self) -> "Study":
        """The study without uncertainty, at the nominal values of its numbers."""
        return Study(self.spec.model_copy(update={"uncertain": None}), self.source)

    def with_engine(self, engine: str) -> "Study":
        """Return the study with another engine."""
        solver = self.spec.solver.model_copy(update={"engine": engine})
        return Study(self.spec.model_copy(update={"solver": solver}), self.source)

    @cached_property
    def _protocols(self) -> dict[str, tuple[Solver, float]]:
        """Solver and start jitter by protocol; the empty name is ``[solver]`` without protocol."""
        return {name: self._protocol(name) for name in ("", *self.spec.protocol)}

    def _protocol(self, name: str) -> tuple[Solver, float]:
        tables = [self.spec.solver] + ([self.spec.protocol[name]] if name else [])
        explicit = [table.model_dump(exclude_unset=True) for table in tables]
        given = {k: v for one in explicit for k, v in one.items() if v is not None}
        jitter = given.pop("start_jitter", 0.0)
        try:
            return Solver.of(**given), jitter
        except ModelError as error:
            table = f"protocol.{name}" if name else "solver"
            raise StudyError(f"{self.source}: {table}: {error}") from None

    @cached_property
    def _blocks(self) -> list[Axes]:
        swept = {name for block in self.spec.sweep for name in block.parameters}
        known = {**self.spec.model, **self.spec.parameters, **OF_WALLS}
        default = {n: x for n, x in known.items() if n in swept}
        return [
            expanded(block, default)
            | ({SAMPLE: self._samples} if self._samples else {})
            | {START: self._starts(block.initial_condition, i)}
            for i, block in enumerate(self.spec.sweep)
        ]

    @cached_property
    def _samples(self) -> Samples | None:
        """The samples of uncertain numbers; None without [uncertain]."""
        table = self.spec.uncertain
        return None if table is None else table.draw()

    def _problems_of_uncertain(self) -> Iterator[str]:
        """Numbers of [uncertain] that the study does not have or that leave their range."""
        assert self.spec.uncertain is not None
        of_laws = set() if self.spec.system else set(self.spec.parameters)
        known: dict[str, Any] = {**self.spec.model, **self._of_contacts}
        walls = [name for name in ("K_c", "gap", "j_1", "j_2") if name in self._axes]
        walls += ["j_1", "j_2"] if "gap" in self._axes else []
        known |= dict.fromkeys([*walls, *columns_of(self.structure)[-self.structure.n_states :]])
        known = {name: value for name, value in known.items() if name not in of_laws}
        about = known, self._axes, self.structure, self.model.parts
        yield from (f"uncertain.{line}" for line in self.spec.uncertain.problems(*about))

    def _starts(self, given: Any, block: int) -> Starts:
        where = f"sweep[{block}].initial_condition"

        def starts(form: Any) -> Starts:
            if isinstance(form, str):
                return Starts.sweep(form, self.structure.n_states)
            states = form if isinstance(form, list) else form.states()
            return Starts.fixed(self.model.starts(states, where))

        if given is None:
            return Starts.fixed(self.model.starts(None))
        return Starts.union(map(starts, forms(given)))

    @cached_property
    def _axes(self) -> Axes:
        return union(self._blocks)

    @cached_property
    def grid(self) -> Grid:
        """The grid of sweep points: the union of all blocks."""
        requested = requested_of(self._blocks, self._axes)
        units = self.model.default.part_units
        return Grid(self._axes, requested, self.structure, self.model.parts, units)

    def select(self, /, **wanted: Any) -> Selection:
        """Return the points with the selected values.

        Parameters
        ----------
        **wanted
            Values by dimension: a value, a list or, for numbers, a slice that includes both
            ends. `representation` and `gap` have labels, as ``"tanh-1e4"`` and ``"0.4/0.4"``; a
            gap may also be a pair [m], as ``(4e-4, 4e-4)``, or a list of pairs.
            `initial_condition` has numbers from 0; sweeps also have names, as ``"sweep_up"``.
            Numbers are compared after rounding to 12 significant digits.

        Raises
        ------
        StudyError
            If a name is not a dimension, the study does not have a value, or no block has a point
            with the selected values.
        """
        if isinstance(gap := wanted.get("gap"), Gap):
            wanted["gap"] = gap.j_1, gap.j_2
        with suppress(KeyError, TypeError, ValueError):  # labels already
            pairs = np.array(wanted["gap"], dtype=float).reshape(-1, 2).tolist()
            wanted["gap"] = [self.grid.label(Gap(*pair)) for pair in pairs]
        axes = {name: self.grid.labels(name) for name in self.grid.axes}
        problems = [
            f"{self.source}: {name}: not a dimension of the study; choose from {', '.join(axes)}"
            for name in wanted.keys() - axes.keys()
        ]
        found = []
        for name, axis in axes.items():
            try:
                values = wanted.get(name, slice(None))
                if name == START:
                    values = numbers_of_sweeps(values, [kind for kind, _ in self.grid.starts])
                found.append(positions(name, axis, values, "the study"))
            except ValueError as error:
                named = f": {self._starts_in_words()}" if name == START else ""
                problems.append(f"{self.source}: {error}{named}")
        if problems:
            raise StudyError(*problems)
        if not self.grid.requested[np.ix_(*found)].any():
            values = ", ".join(f"{name} = {value!r}" for name, value in wanted.items())
            raise StudyError(f"{self.source}: {values}: no block has a point with these values")
        return tuple(found)

    def _starts_in_words(self) -> str:
        """Return the numbers of the initial conditions with their states or sweeps, as text."""
        states = [
            kind if kind in SWEEPS else f"[{', '.join(f'{value:g}' for value in state)}]"
            for kind, state in self.grid.starts
        ]
        return listed([f"{number} is {state}" for number, state in enumerate(states)])

    def points(self, cells: NDArray[np.int64]) -> list[tuple[NDArray[np.intp], Points]]:
        """Return the sweep points of cells of the grid, in one table per kind.

        Parameters
        ----------
        cells : ndarray of int, shape (n,)
            Flat positions.

        Returns
        -------
        list of (ndarray of int, Points)
            Numbers of the cells, ascending, and their points; for ``auto``, the points that it
            chooses.
        """
        tables = []
        for rows, table, one in self._requested(cells):
            found = self._adequate(table) if one.is_auto else [(np.arange(len(rows)), table)]
            tables += [(rows[some], points) for some, points in found]
        return tables

    def _requested(
        self, cells: NDArray[np.int64]
    ) -> Iterator[tuple[NDArray[np.intp], Points, Representation]]:
        """Yield tables of the points of some cells and their representation, maybe ``auto``."""
        axes, starts, names = self.grid.axes, self.grid.starts, self._law_parameters
        at = dict(zip(axes, np.unravel_index(cells, self.grid.shape), strict=True))
        kind = at["representation"] * len(Starts.KINDS) + starts.kind[at[START]]
        for one in np.flatnonzero(np.bincount(kind)).tolist():  # sorting takes longer
            rows = np.flatnonzero(kind == one)
            r, start = divmod(one, len(Starts.KINDS))
            found = self.grid.representations[r]
            swept = [name for name in names.get(found.law, ()) if name in axes]
            places = np.column_stack([0 * rows, *(at[name][rows] for name in swept)])
            for place in np.unique(places, axis=0) if swept else places[:1]:
                some = rows[(places == place).all(axis=1)]
                here = {name: of[some] for name, of in at.items()}
                named = {n: axes[n][i] for n, i in zip(swept, place[1:].tolist(), strict=True)}
                numbers = self.model.numbers(found.law, axes, here, len(some))
                yield some, Points(self._kind(found, Starts.KINDS[start], named), numbers), found

    @cached_property
    def _law_parameters(self) -> dict[str, list[str]]:
        """Names of the parameters of each user law; refuse parameters that nothing uses."""
        laws = {one.law: self.own_law(one) for one in self.grid.representations}
        found: dict[str, list[str]] = {
            law: [name for name, _ in checked(own).parameters] for law, own in laws.items() if own
        }
        system = self.spec.system
        taken = (system.scales if system else set()).union(*found.values())
        unused = self.spec.parameters.keys() - taken
        if unused and not (system and system.function):  # which refuses other names
            problem = (
                f"parameters: {', '.join(sorted(unused))}: must be arguments of {', '.join(found)}"
            )
            raise StudyError(f"{self.source}: {problem}")
        return found

    def history_axes(self, table: HistoryTable) -> Axes:
        """Return the axes of a ``[[history]]``, each of one value.

        Values of the history come first, then the single values of sweep axes, then the model's.
        """
        given = {**self.spec.model, **self.spec.parameters, **OF_WALLS}
        given |= {name: self._axes[name][0] for name in given if name in self._axes}
        walls = {"K_c": table.K_c, "gap": Gap(*map(canonical, table.gap)), "omega": table.omega}
        values = given | table.parameters | walls
        return {n: (x,) for n, x in values.items()} | {START: Starts.fixed([table.start])}

    def history_point(self, table: HistoryTable, one: Representation) -> Points:
        """Return the sweep point, a table of one row, in which a motion of a history starts.

        Raises
        ------
        ModelError
            If the code of a user law cannot be loaded.
        """
        axes = self.history_axes(table)
        named = {name: axes[name][0] for name in self.spec.parameters}
        places = dict.fromkeys(axes, np.zeros(1, np.intp))
        numbers = self.model.numbers(one.law, axes, places, 1)
        return Points(self._kind(one, FIXED, named), numbers)

    def _kind(self, one: Representation, start: str, parameters: Mapping[str, float]) -> Kind:
        own = self.own_law(one, **parameters)
        own = None if own is None else checked(own)
        return Kind(
            representation=one.law,
            solver=self.solver(one),
            steady=self.steady,
            fit_range=self.spec.approximation.range,
            pulls=self.spec.study.pulls,
            start=start,
            start_jitter=self.start_jitter(one),
            law_code=None if own is None else own.key,
            structure=self.structure,
            contacts=self.model.laws(one.law),
            own=own,
        )

    def _adequate(self, table: Points) -> list[tuple[NDArray[np.intp], Points]]:
        """Return the points that ``auto`` chooses, in tables of one tolerance each."""
        least = self._least(table, self.spec.auto.error)
        numbers = without_what_has_no_effect(table, least)
        found = []
        for one in np.unique(least.rtol).tolist():
            rows = np.flatnonzero(least.rtol == one)
            solver = table.kind.solver.with_rtol(one)
            kind = replace(
                table.kind, representation=EXACT, contacts=self.model.laws(EXACT), solver=solver
            )
            found.append((rows, Points(kind, numbers[rows])))
        return found

    def _least(self, table: Points, error: float) -> Least:
        is_exact = all(law.law_type is Piecewise for law in self.model.laws(EXACT))
        return least_of(table, error, is_exact=is_exact)

    def advice(self, cells: NDArray[np.int64], error: float | None = None) -> Least:
        """Return the simplest adequate models of cells, independent of their representation.

        Parameters
        ----------
        cells : ndarray of int, shape (n,)
            Flat positions.
        error : float, optional
            Allowed relative error of the steady amplitude; None: that of ``[auto]``.
        """
        error = self.spec.auto.error if error is None else check_error(error)
        found = unknown(len(cells), len(self.model.contacts), error)
        for rows, table, _ in self._requested(cells):
            found.put(rows, self._least(table, error))
        return found

    def solver(self, label: str) -> Solver:
        """Return the solver settings of a representation, with its protocol if the label has one.

        For ``auto`` they are the loosest settings that it may choose for a point.
        """
        one = Representation(label)
        solver = self._protocols[one.protocol][0]
        return solver.with_rtol(self.spec.auto.error) if one.is_auto else solver

    def start_jitter(self, label: str) -> float:
        """Return the shift [m] of fixed initial displacements by a representation's protocol."""
        return self._protocols[Representation(label).protocol][1]


def _lists(tables: Any) -> Any:
    """Return tables with Python lists and numbers for those of NumPy; refuse too long lists."""
    if isinstance(tables, dict):
        return {name: _lists(value) for name, value in tables.items()}
    is_list = isinstance(tables, list | tuple)
    n = len(tables) if is_list else getattr(tables, "size", 0)
    if n > MAX_VALUES:  # before each value is checked
        raise StudyError(f"a list of {n} values: must have <= {MAX_VALUES}; coarsen a grid")
    if is_list:
        return [_lists(value) for value in tables]
    return tables.tolist() if isinstance(tables, np.ndarray | np.generic) else tables


def _ends(values: Sequence[Any]) -> str:
    """Return values as text; if there are many, only the first ones and the last one."""
    shown = [f"{x:.6g}" if isinstance(x, float) else str(x) for x in values]
    return ", ".join(shown if len(shown) <= 8 else [*shown[:3], "…", shown[-1]])
