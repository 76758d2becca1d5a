"""The tables of a study file that describe a system: matrices, or a function of named numbers."""

from collections.abc import Iterable, Mapping
from contextlib import chdir
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, ValidationError, model_validator

from gapsweep.errors import ModelError, StudyError, described
from gapsweep.model import systems
from gapsweep.model.contact import OF_LABELS
from gapsweep.model.labels import FUNCTION
from gapsweep.model.own_law import OwnLaw
from gapsweep.model.system import BaseMotion, Cubic, Harmonic, Lags, Modulation, System, Unbalance
from gapsweep.model.waves import PeriodicForce, Switched
from gapsweep.study.axes import Label, NonNegative, Pair, Share, TomlTable
from gapsweep.study.oscillator_table import Points
from gapsweep.user_code.load import blame

Vector = Annotated[list[float], Field(min_length=1)]
Matrix = Annotated[list[Vector], Field(min_length=1)]

# The functions of `gapsweep.systems`: each has a second function that returns its law.
READY_MADE = tuple(name for name in systems.__all__ if f"{name}_law" in systems.__all__)


class ScaledTable(TomlTable):
    """A table whose strength may be multiplied by a parameter of the study."""

    scale: str | None = None

    def values(self, strength: str, parameters: Mapping[str, float]) -> dict[str, Any]:
        """Return the arguments of the described object, at some values of the parameters."""
        found = self.model_dump(exclude={"scale"})
        if self.scale is not None:
            found[strength] = np.multiply(found[strength], parameters[self.scale]).tolist()
        return found


# Kinds of loads by the key that has their strength.
_LOADS: dict[str, Any] = {
    "amplitude": Harmonic,
    "unbalance": Unbalance,
    "base_amplitude": BaseMotion,
    "f": PeriodicForce,
    "levels": Switched,
}


class CubicTable(ScaledTable):
    along: Vector
    alpha: float


class LoadTable(ScaledTable):
    """A harmonic with an amplitude, an unbalance, a base motion, or a force by pieces."""

    amplitude: Vector | None = None
    unbalance: float | None = None
    base_amplitude: float | None = None
    base_damping: float | None = None
    t: Points | None = None
    f: Points | None = None
    levels: Points | None = None
    along: Vector | None = None
    k: int | None = None
    phase: float | None = None
    power: int | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> "LoadTable":
        given = [name for name in _LOADS if getattr(self, name) is not None]
        if len(given) != 1 or (self.along is None) == (given != ["amplitude"]):
            raise ValueError(
                "give amplitude = [1.0, 0.0]; or along = [1.0, 0.0] and one of unbalance, "
                "base_amplitude, f or levels (with t), or table"
            )
        return self

    def load(self, parameters: Mapping[str, float]) -> Any:
        """Return the load at some values of the parameters."""
        (name,) = (name for name in _LOADS if getattr(self, name) is not None)
        values = self.values(name, parameters)
        if name == "levels":
            values["f"] = values.pop("levels")
        return _LOADS[name](**{key: value for key, value in values.items() if value is not None})


class ModulationTable(ScaledTable):
    depth: float
    k: int = 1
    phase: float = 0.0


class LagsTable(TomlTable):
    force: Matrix
    of_speed: Matrix
    of_place: Matrix
    of_lags: Matrix


class SystemTable(TomlTable):
    """`function`, a ready-made system or ``module:function``, or the arguments of a `System`."""

    function: str | None = None
    mass: Matrix | None = None
    stiffness: Matrix | None = None
    damping: Matrix | None = None
    contacts: dict[str, Vector] = Field({})
    cubic: list[CubicTable] = Field([])
    forcing: list[LoadTable] = Field([])
    modulation: dict[str, list[ModulationTable]] = Field({})
    lags: LagsTable | None = None
    coordinates: list[str] = Field([])
    units: dict[str, str] = Field({})

    @property
    def user_function(self) -> str:
        """The user's function, ``module:function``; empty without one."""
        return "" if self.function in READY_MADE else self.function or ""

    @property
    def scales(self) -> set[str]:
        """Names of the parameters that multiply loads, springs and modulations."""
        terms = [term for terms in self.modulation.values() for term in terms]
        return {each.scale for each in (*self.cubic, *self.forcing, *terms) if each.scale}

    @model_validator(mode="after")
    def _one_of_both(self) -> "SystemTable":
        others = self.model_dump(exclude={"function"}, exclude_none=True)
        if self.function is not None and any(others.values()):
            raise ValueError("give function, or matrices (mass, stiffness), not both")
        if self.function is None and (self.mass is None or self.stiffness is None):
            raise ValueError('missing; write mass and stiffness, or function = "module:name"')
        if self.function is not None and not (
            self.function in READY_MADE or FUNCTION.fullmatch(self.function)
        ):
            raise ValueError(
                f"function = {self.function!r}: must be module:function, or one of "
                f"{', '.join(READY_MADE)}"
            )
        return self


class ContactTable(TomlTable):
    """Values of one contact that replace those of the sweep."""

    representation: Label | None = None
    K_c: NonNegative | None = None
    gap: Pair | None = None
    K_ratio: NonNegative | None = None
    damping: NonNegative | None = None
    preload: NonNegative | None = None
    chi: NonNegative | None = None
    restitution: Share | None = None

    @model_validator(mode="after")
    def _no_code(self) -> "ContactTable":
        own = self.representation
        if own is not None and (own.is_own or own.is_auto or own.protocol):
            raise ValueError(
                f"representation = {own!r}: must be a law of gapsweep without a protocol; "
                "write the representation of all contacts in [[sweep]]"
            )
        for name in OF_LABELS:
            if own is not None and getattr(self, name) is not None and not own.takes(name):
                raise ValueError(f"{name}: {own.refusal(name)}")
        return self


@dataclass(frozen=True)
class Maker:
    """Function that makes the system of a study from parameter values; it can be pickled."""

    table: SystemTable
    source: str  # name of the study, for messages
    own: OwnLaw | None  # the code of the user's function

    def __call__(self, parameters: Mapping[str, float]) -> System:
        """Return the system at some values of the parameters.

        Raises `StudyError` if the system is invalid, or the function raises.
        """
        name = self.table.function
        try:
            if name is None:
                return _of_matrices(self.table, parameters)
            return _made(name, self.own.load() if self.own else getattr(systems, name), parameters)
        except ModelError as error:
            at = f" at {in_words(parameters)}" if parameters else ""
            raise StudyError(f"{self.source}: system{at}: {error}") from None


def maker(table: SystemTable, source: str, folders: Iterable[Path] = ()) -> Maker:
    """Return the `Maker` of the system of a study, with the present code of its function.

    Raises `StudyError` if the code cannot be read.

    Parameters
    ----------
    source : str
        Name of the study, for messages.
    folders : iterable of Path
        Folders in which the function's module is searched after Python's path.
    """
    try:
        own = OwnLaw.of(table.user_function, folders) if table.user_function else None
        if own is not None:
            own.load()
    except ModelError as error:
        raise StudyError(f"{source}: system: {error}") from None
    return Maker(table, source, own)


def wrong_matrices(tables: Any, source: str) -> list[str]:
    """Return the problems of a system of matrices, for a study that has other problems, too."""
    try:
        table = SystemTable.model_validate(tables["system"])
        if table.function is None:  # no code is run for that
            maker(table, source)(dict.fromkeys(table.scales, 1.0))
    except (ValidationError, TypeError, LookupError):  # already reported
        return []
    except StudyError as error:
        return list(error.problems)
    return []


def in_words(parameters: Mapping[str, float]) -> str:
    """Return names and values of parameters as text, for messages."""
    return ", ".join(f"{name} = {value:g}" for name, value in parameters.items())


def _made(name: str, function: Any, parameters: Mapping[str, float]) -> System:
    """Return the system that a function returns for these parameters; refuse other results."""
    try:
        with chdir("."):  # wherever it goes, cache and results stay here
            found = function(**parameters)
            parts = {}
            if isinstance(found, System):
                parts = {each.name: getattr(found, each.name) for each in fields(System)}
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # the user's code may raise anything, SystemExit too
        what = str(error) if isinstance(error, ModelError) else described(error)
        message = f"{name}: {what}; the function needs the arguments of [parameters]"
        if error.__traceback__ is not None and error.__traceback__.tb_next:  # it has been called
            message = blame(None, error, f"{name}: {what}")
        raise ModelError(message) from None
    if not isinstance(found, System):
        raise ModelError(f"{name}: must return a gapsweep.System, not {type(found).__name__}")
    # Checked again: contacts and modulations are dictionaries, which the function may have changed
    # after it created the system.
    return System(**parts)


def _of_matrices(table: SystemTable, parameters: Mapping[str, float]) -> System:
    return System(
        mass=table.mass,
        stiffness=table.stiffness,
        damping=table.damping,
        contacts=table.contacts,
        cubic=[Cubic(**each.values("alpha", parameters)) for each in table.cubic],
        forcing=[each.load(parameters) for each in table.forcing],
        modulation={
            name: [Modulation(**each.values("depth", parameters)) for each in terms]
            for name, terms in table.modulation.items()
        },
        lags=None if table.lags is None else Lags(**table.lags.model_dump()),
        coordinates=table.coordinates,
        units=table.units,
    )
