"""The models of a study: one structure, and numbers that differ from point to point."""

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from inspect import Parameter, Signature
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError, StudyError
from gapsweep.model.contact import OF_LABELS, OF_WALLS
from gapsweep.model.labels import EXACT, NOT_LOCATED, TAKEN_BY, Representation, unknown_number
from gapsweep.model.oscillator import Oscillator
from gapsweep.model.structure import AnyStructure, structure_of
from gapsweep.model.system import System
from gapsweep.study.axes import count, forms, several, values
from gapsweep.study.grid import START, Axes, starts_of
from gapsweep.study.points import OF_CONTACT, SWEEPS, canonical, columns_of
from gapsweep.study.problems import EXAMPLES
from gapsweep.study.samples import SAMPLE, Samples
from gapsweep.study.spec import StudySpec, SweepTable
from gapsweep.study.system_tables import Maker, in_words, maker

Array = NDArray[np.float64]
Places = Mapping[str, NDArray[np.intp]]

# So many systems are made twice, to detect functions that do not depend on their arguments only.
_MADE_AGAIN = 4


Model = Oscillator | System


@dataclass(frozen=True, eq=False)
class AlongParameter:
    """The system of a study as a function of some parameters, given by name; can be pickled."""

    make: Maker
    values: Mapping[str, float]
    names: tuple[str, ...]

    @property
    def __signature__(self) -> Signature:
        kind = Parameter.KEYWORD_ONLY
        return Signature([Parameter(name, kind, default=self.values[name]) for name in self.names])

    def __call__(self, **given: float) -> System:
        return self.make({**self.values, **given})

    @property
    def identity(self) -> list[Any]:
        """Table, code, values and name that the system depends on, for JSON."""
        own = self.make.own
        return [self.make.table.model_dump(), own and own.key, dict(self.values), self.names]


@dataclass(frozen=True)
class ParametricModel:
    """The model that a study sweeps: `Oscillator` or, with ``[system]``, `System` of parameters."""

    spec: StudySpec
    source: str  # name of the study, for messages
    # Folders in which the function's module is searched after Python's path.
    folders: tuple[Path, ...]

    @property
    def is_oscillator(self) -> bool:
        """Whether the model is an `Oscillator`, not a `System`."""
        return self.spec.system is None

    @cached_property
    def _make(self) -> Callable[[Mapping[str, float]], Model]:
        """Function that makes a model from its parameters; its code is read once per study."""
        table = self.spec.system
        if table is None:
            return self._oscillator
        unlike = table.scales ^ set(self.spec.parameters)
        if any(one.is_own for block in self.spec.sweep for one in block.representation):
            unlike = table.scales - set(self.spec.parameters)  # others belong to laws
        if table.function is None and unlike:
            raise StudyError(
                *[
                    f"{self.source}: parameters: {name!r}: must be in [parameters], and the "
                    "scale of a load, a cubic spring or a modulation in [system]"
                    for name in sorted(unlike)
                ]
            )
        return maker(table, self.source, self.folders)

    def _oscillator(self, values: Mapping[str, float]) -> Oscillator:
        try:
            return Oscillator(**values, wave=self.spec.oscillator and self.spec.oscillator.wave)
        except ModelError as error:
            raise StudyError(f"{self.source}: oscillator: {error}") from None

    @cached_property
    def _known(self) -> dict[tuple[float, ...], Model]:
        """Cache of the models made so far, by parameter values."""
        return {}

    @cached_property
    def default(self) -> Model:
        """The model at the default values of its parameters."""
        return self.at({})

    @property
    def json(self) -> str:
        """The `default` model as JSON; the study file lacks its numbers if a function made it."""
        return json.dumps(asdict(self.default), default=lambda array: array.tolist())

    @cached_property
    def structure(self) -> AnyStructure:
        return structure_of(self.default)

    @property
    def contacts(self) -> tuple[str, ...]:
        """Names of the contacts."""
        return tuple(self.default.contacts)

    @property
    def parts(self) -> dict[str, tuple[str, ...]]:
        """Dimensions within a point that have several entries, and the names along them."""
        return self.default.parts

    def laws(self, law: Representation) -> tuple[Representation, ...]:
        """Return the law of every contact: that of [contact], else this law."""
        return tuple(self._own(name, "representation") or law for name in self.contacts)

    def takes(self, law: Representation, name: str) -> bool:
        """Whether some contact has a parameter of contacts from the sweep, with this law."""
        pairs = zip(self.contacts, self.laws(law), strict=True)
        return any(one.takes(name) and self._own(contact, name) is None for contact, one in pairs)

    def is_followed(self, one: Representation, along: str) -> bool:
        """Whether branches of a representation are followed along a parameter that it has.

        Its contacts are located, and it has no protocol.
        """
        is_exact = not (one.protocol or one.is_auto or one == NOT_LOCATED)
        return is_exact and (along not in OF_LABELS or self.takes(one, along))

    def numbers(self, law: Representation, axes: Axes, places: Places, n: int) -> Array:
        """Return the columns of a table of n points of a law, from their positions on the axes."""
        omega = np.asarray(axes["omega"])[places["omega"]] if "omega" in axes else np.zeros(n)
        walls = self._walls(self.laws(law), axes, places, n)
        parts = [walls, omega[:, None], self._arrays(axes, places, n)]
        start = starts_of(axes).states[places[START]]
        for i, name in enumerate(columns_of(self.structure)[-start.shape[1] :]):
            start[:, i] = _at(name, start[:, i], axes, places)
        return np.concatenate([*parts, start], axis=1)

    def sections(self, axes: Axes, places: Places, rate: Array) -> tuple[Array, Array]:
        """Return the units of section points, and the contact directions, of n points.

        Parameters
        ----------
        rate : ndarray, shape (n,)
            Section points per second; if NaN, the frequency of the forcing or the slowest mode.

        Returns
        -------
        unit : ndarray, shape (n_states, n)
            Value of each component of a state that corresponds to one metre of the section.
        directions : ndarray, shape (n, n_contacts, n_coordinates)
            Directions of the contacts.
        """
        number, models = np.zeros(len(rate), np.intp), [self.default]
        if not self.is_oscillator:
            number, models = self._models(axes, places, len(rate))
        slowest = np.array([model.slowest for model in models])[number]
        other = np.asarray(axes["omega"])[places["omega"]] if "omega" in axes else slowest
        omega = np.where(rate > 0.0, rate, other)
        omega_rad = 2.0 * math.pi * np.where(omega > 0.0, omega, 1.0)
        unit = np.empty((self.structure.n_states, len(rate)))
        for i, model in enumerate(models):
            unit[:, number == i] = model.unit(omega_rad[number == i])
        return unit, np.array([model.directions for model in models])[number]

    def starts(self, states: ArrayLike | None, where: str = "initial_condition") -> Array:
        """Return initial states as long as the model's; missing first-order states are zero."""
        n, n_states = self.structure.n, self.structure.n_states
        if states is None:
            return np.zeros((1, n_states))
        found = []
        for state in np.asarray(states, dtype=object):
            if len(state) not in (2 * n, n_states):
                allowed = " or ".join(map(str, sorted({2 * n, n_states})))
                lags = ", and first-order states if they are not zero" * (n_states > 2 * n)
                raise StudyError(
                    f"{self.source}: {where}: {len(state)} numbers: must be {allowed}: "
                    f"coordinates {', '.join(self.default.coordinates)}, their velocities{lags}"
                )
            found.append([*map(float, state), *[0.0] * (n_states - len(state))])
        return np.array(found)

    def swept(self, axes: Axes, requested: NDArray[np.bool_]) -> list[dict[str, float]]:
        """Return all combinations of swept model parameters that requested points have."""
        names = [name for name in axes if name in self.spec.model]
        others = tuple(i for i, name in enumerate(axes) if name not in names)
        places = np.argwhere(requested.any(axis=others)) if names else np.empty((0, 0), np.intp)
        rows = (zip(names, place, strict=True) for place in places.tolist())
        return [{name: axes[name][i] for name, i in row} for row in rows]

    def at(self, some: Mapping[str, float]) -> Model:
        """Return the model with these values of some parameters, and defaults of the others.

        Raises `StudyError` if the model is invalid, or its structure differs from that of the
        default.
        """
        given = {**self.spec.model, **some}
        values = {name: canonical(value) for name, value in given.items()}
        key = tuple(values.values())
        if key not in self._known:
            made = self._make(values)
            if len(self._known) < _MADE_AGAIN and not _are_alike(made, self._make(values)):
                at = f" at {in_words(some)}" if some else ""
                raise StudyError(
                    f"{self.source}: system{at}: two calls return different systems; the "
                    "function must depend on its arguments only"
                )
            self._known[key] = made
        made = self._known[key]
        if some and _form(made) != _form(self.default):
            raise StudyError(
                f"{self.source}: system at {in_words(some)}: has other coordinates, contacts "
                "or loads than at the values in [parameters]; write a separate study"
            )
        return made

    def along(self, names: Sequence[str], some: Mapping[str, float]) -> AlongParameter | None:
        """The system as a function of those parameters that are its own, others at some values."""
        own = tuple(name for name in names if name in self.spec.model)
        if self.is_oscillator or not own:
            return None
        values = {**self.spec.model, **some}
        assert isinstance(self._make, Maker)
        return AlongParameter(self._make, {n: canonical(x) for n, x in values.items()}, own)

    def check(self) -> None:
        """Refuse tables that do not fit the model.

        Raises `StudyError` with one line per problem.
        """
        spec, names = self.spec, self.contacts
        wrong = [
            f"contact: {name!r}: must be a contact of the system: {', '.join(names) or 'none'}"
            for name in spec.contact
            if name not in names
        ]
        laws = {
            law for block in spec.sweep for one in block.representation for law in self.laws(one)
        }
        tables = [*spec.sweep, *spec.contact.values()]
        wrong += [
            f"{name}: {unknown_number(name, ())}"
            for name in OF_LABELS
            if any(getattr(table, name) is not None for table in tables)
            if not any(law.takes(name) for law in laws)
        ]
        swept = {name: axis for block in spec.sweep for name, axis in block.parameters.items()}
        for i, block in enumerate(spec.sweep):
            found = [*self._problems(block)]
            found += self._problems_of_losses(block.representation, block.parameters)
            wrong += [f"sweep[{i}].{problem}" for problem in dict.fromkeys(found)]
        for i, history in enumerate(spec.history):
            for name, value in history.parameter.items():
                outside = _out_of_range(spec.model, name, [value])
                wrong += [f"history[{i}].{problem}" for problem in outside]
            given = {**swept, **history.parameters}
            of_losses = dict.fromkeys(self._problems_of_losses(history.representation, given))
            wrong += [f"history[{i}].{problem}" for problem in of_losses]
        if wrong:
            raise StudyError(*[f"{self.source}: {problem}" for problem in wrong])

    def _problems(self, block: SweepTable) -> list[str]:
        found = []
        for name in ("K_c", "gap"):
            is_given = getattr(block, name) is not None or (name == "gap" and block.j_1 is not None)
            takes = [c for c in self.contacts if self._own(c, name) is None]
            has_walls = all(one.is_own for one in block.representation)
            needs = [c for c in takes if self._own(c, "representation") or not has_walls]
            if needs and not is_given:
                of_contact = "" if self.is_oscillator else f", which contact {needs[0]!r} needs"
                found.append(f"{name}: missing; write {EXAMPLES[name]}{of_contact}")
            if is_given and not takes:
                found.append(f"{name}: unused, [contact] sets it for all contacts; leave it out")
        if (block.omega is not None) != self.default.is_forced:
            words = f"missing; write {EXAMPLES['omega']}"
            surplus = "the system is not forced; leave omega out, or add forcing to [system]"
            found.append(f"omega: {surplus if block.omega else words}")
        is_bounded = self.default.is_forced and bool(self.contacts)
        if not is_bounded and any(one.is_auto for one in block.representation):
            found.append("representation: 'auto' needs a forcing and a contact; write 'piecewise'")
        starts = [] if block.initial_condition is None else forms(block.initial_condition)
        if not self.default.is_forced and any(form in SWEEPS for form in starts):
            found.append("initial_condition: sweeps need omega, and this system is not forced")
        axes: dict[str, Any] = {"representation": block.representation}
        axes |= {name: getattr(block, name) for name in OF_WALLS}
        for name, axis in axes.items():
            takes = [c for c in self.contacts if self._own(c, name) is None]
            if axis is not None and count(axis) > 1 and not takes:
                found.append(f"{name}: unused, [contact] sets it for all contacts; keep one value")
        if self.is_oscillator:
            swept = block.parameter.items()
            found += [x for each in swept for x in _out_of_range(self.spec.model, *each)]
        return found

    def _problems_of_losses(
        self, representations: Sequence[Representation], given: Mapping[str, Any]
    ) -> Iterator[str]:
        """Yield a problem per representation that has no or two values of a parameter of losses.

        `given` are axes or values of parameters of the model and of both walls.
        """
        drawn = self.spec.uncertain.names if self.spec.uncertain else ()
        swept = {*given, *drawn}.union(*(block.parameters for block in self.spec.sweep))
        for contact, one in product(self.contacts, representations):
            law = self._own(contact, "representation") or one
            for name in (name for name in TAKEN_BY if name not in OF_LABELS):
                number = self._own(contact, name)
                axis = given.get(name, 0.0) if number is None else number
                is_drawn = name in drawn and number is None
                if not (is_drawn or any(values(several(axis)))):
                    continue
                if not law.takes(name):
                    yield f"{name}: {law.refusal(name)}"
                elif law.law != EXACT and not self.spec.study.pulls:
                    yield f"{name}: walls of {law} pull; write pulls = true in [study], for all"
            for name in OF_LABELS:
                is_own = self._own(contact, name) is not None
                if name in law.missing and not is_own and name not in {*given, *drawn}:
                    yield f"{name}: missing, {law} needs it; write {EXAMPLES[name]}"
                elif law is one and name in law.numbers and (is_own or name in swept):
                    yield f"{name}: {law.refusal(name)}"

    def _own(self, contact: str, name: str) -> Any:
        table = self.spec.contact.get(contact)
        return None if table is None else getattr(table, name)

    def _walls(self, laws: Sequence[Representation], axes: Axes, places: Places, n: int) -> Array:
        """Return the columns of every contact; parameters that its law lacks are constant."""
        elastic = {"K_c": 0.0, **OF_WALLS}
        swept: dict[str, Any] = {"j_1": 0.0, "j_2": 0.0, **elastic}
        if "gap" in axes:
            gaps = np.array([(gap.j_1, gap.j_2) for gap in axes["gap"]])[places["gap"]]
            swept["j_1"], swept["j_2"] = gaps.T
        for name, value in swept.items():
            swept[name] = _at(name, value, axes, places)
            if name in ("j_1", "j_2"):
                drawn = _drawn("gap", swept[name], axes, places)
                swept[name] = np.where(np.isinf(swept[name]), np.inf, drawn)  # no wall, no gap
        columns = []
        for contact, law in zip(self.contacts, laws, strict=True):
            own = {name: self._own(contact, name) for name in elastic}
            own["j_1"], own["j_2"] = self._own(contact, "gap") or (None, None)
            own |= {name: x for name, x in (elastic | law.numbers).items() if not law.takes(name)}
            columns += [swept[n] if own[n] is None else canonical(own[n]) for n in OF_CONTACT]
        table = [np.broadcast_to(np.asarray(column, float), n) for column in columns]
        return np.stack(table, axis=1) if table else np.empty((n, 0))

    def _arrays(self, axes: Axes, places: Places, n: int) -> Array:
        if self.is_oscillator:  # its parameters are the numbers of a row
            columns: dict[str, Any] = {n: canonical(x) for n, x in self.spec.model.items()}
            columns = {name: _at(name, value, axes, places) for name, value in columns.items()}
            rows = [np.broadcast_to(columns[name], n) for name in self.structure.names]
            return np.stack(rows, axis=1)
        number, models = self._models(axes, places, n)
        return np.array([self.structure.row(model) for model in models])[number]

    def _models(self, axes: Axes, places: Places, n: int) -> tuple[NDArray[np.intp], list[Model]]:
        """Return the number of each point's model, and the models."""
        values = {
            name: _at(name, canonical(value), axes, places)
            for name, value in self.spec.model.items()
        }
        varied = {name: value for name, value in values.items() if np.ndim(value)}
        if not varied:
            return np.zeros(n, np.intp), [self.default]
        several, number = np.unique(np.stack([*varied.values()]), axis=1, return_inverse=True)
        found = [dict(zip(varied, one, strict=True)) for one in several.T.tolist()]
        return number.reshape(-1), [self.at(some) for some in found]


def _at(name: str, value: Any, axes: Axes, places: Places) -> Any:
    """Return the values of a number at some points: swept or drawn, else this value."""
    if name in axes:
        value = np.asarray(axes[name])[places[name]]
    return _drawn(name, value, axes, places)


def _drawn(name: str, value: Any, axes: Axes, places: Places) -> Any:
    """Return the values of a number at some points with what its samples make of them."""
    samples = axes.get(SAMPLE)
    return samples.combined(name, value, places[SAMPLE]) if isinstance(samples, Samples) else value


def _out_of_range(others: Mapping[str, float], name: str, axis: Any) -> Iterator[str]:
    """Yield problems of an axis of an oscillator parameter; testing its ends is sufficient."""
    several = values(axis)
    for value in {min(several), max(several)} if name in others else ():  # others belong to laws
        try:
            Oscillator(**{**others, name: value})
        except ModelError as error:
            yield str(error)


def _form(model: Model) -> tuple[Any, ...]:
    """Return names and structure of a model, which all models of a study share."""
    return model.coordinates, tuple(model.contacts), structure_of(model)


def _are_alike(a: Model, b: Model) -> bool:
    return _form(a) == _form(b) and np.array_equal(structure_of(a).row(a), structure_of(b).row(b))
