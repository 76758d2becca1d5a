"""Models of a branch: one system whose parameters vary along it."""

import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import ModelError
from gapsweep.integrate.problem import Model, Models
from gapsweep.integrate.simulate import AnyLaw
from gapsweep.model.contact import ContactLaw, checked_law
from gapsweep.model.oscillator import Oscillator, checked
from gapsweep.model.parameters import GAP, check_owner, made_model, numbers_of, with_numbers
from gapsweep.model.structure import general_form
from gapsweep.model.system import System
from gapsweep.model.user_law import UserLaw
from gapsweep.model.waves import check_periodic
from gapsweep.quantities import without_units

Array = NDArray[np.float64]

AMPLITUDE = "amplitude"
_LOGARITHMIC = 10.0  # windows whose ends have a larger ratio are divided by ratios


@dataclass(frozen=True, slots=True)
class Window:
    """The range of a parameter, mapped to 0..1: by its logarithm where it spans a decade.

    Parameters
    ----------
    name : str
    low, high : float
        In the unit of the parameter, ``low < high``.
    """

    name: str
    low: float
    high: float

    @classmethod
    def of(cls, name: str, between: Any) -> "Window":
        """The window of a call.

        Raises
        ------
        ModelError
            If `between` is not two numbers in ascending order, or out of the parameter's range.
        """
        if not isinstance(name, str):
            raise ModelError(f"parameter = {name!r:.80}: must be one name, as 'gap'")
        ends = without_units(f"range of {name}", between)
        try:
            low, high = map(float, ends)
        except (TypeError, ValueError):
            raise ModelError(
                f"range of {name} = {between!r:.80}: must be its two ends, as (1e-4, 1e-3)"
            ) from None
        is_positive = name in ("omega", AMPLITUDE)
        checked(f"range of {name}", low, low=0.0 if is_positive else -math.inf, strict=True)
        checked(f"range of {name}", high)
        if not low < high:
            raise ModelError(
                f"range of {name} = {between!r:.80}: must be ascending, of two different values"
            )
        return cls(name, low, high)

    @property
    def _is_logarithmic(self) -> bool:
        return self.low > 0.0 and self.high / self.low >= _LOGARITHMIC

    def value(self, place: Any) -> Any:
        """Parameter values at places from 0 to 1; beyond, those at the ends."""
        place = np.clip(place, 0.0, 1.0)
        found = self.low + place * (self.high - self.low)
        if self._is_logarithmic:
            found = self.low * np.exp(place * math.log(self.high / self.low))
        return np.where(place == 1.0, self.high, found)[()]  # rounding must not miss the end

    def place(self, value: Any) -> Any:
        """Places from 0 to 1 of parameter values."""
        if self._is_logarithmic:
            return np.log(np.asarray(value) / self.low) / np.log(self.high / self.low)
        return (np.asarray(value) - self.low) / (self.high - self.low)


@dataclass(frozen=True)
class Family:
    """A model and its contact laws as functions of one or two parameters.

    Parameters
    ----------
    model : Oscillator, System, or callable
        A callable returns the model for keyword arguments, the parameters among them.
    law : ContactLaw or mapping of str to ContactLaw
        As in `gapsweep.simulate`.
    omega : float or None
        Forcing frequency [Hz] where it is no parameter.
    names : tuple of str
        ``"omega"``, ``"amplitude"`` (of free motions), a field of the oscillator or of the laws
        (``"K_c"``, ``"j_1"``, ``"gap"`` for both walls alike), or a keyword of the callable.
    values : mapping of str to float
        Default values of the parameters; the model with them is `example`.
    """

    model: Model | Callable[..., Model]
    law: AnyLaw
    omega: float | None
    names: tuple[str, ...]
    values: Mapping[str, float]

    def __post_init__(self) -> None:
        for name, one in self._arguments.items():
            is_needed = one.kind not in (one.VAR_POSITIONAL, one.VAR_KEYWORD)
            if is_needed and one.default is one.empty and name not in self.values:
                remedy = f"write functools.partial(function, {name}=1.0)"
                raise ModelError(f"oscillator: argument {name!r} has no default; {remedy}")
        if isinstance(self.law, Mapping) and set(self.law) != set(self.example.contacts):
            said = f"of {list(self.law)}: must name" if self.law else "missing for"
            raise ModelError(
                f"law: {said} {list(self.example.contacts)}, "
                "as law=gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4))"
            )
        for name in self.names:
            self._check(name)
        check_periodic(self.example)
        is_forced = self.example.is_forced
        if "omega" in self.names and not is_forced:
            raise ModelError("along = 'omega': this System is not forced; name another parameter")
        if AMPLITUDE in self.names:
            self._check_free()
        elif "omega" not in self.names and (self.omega is None) == is_forced:
            needed = "missing; this model is forced: write omega=9.0, in Hz"
            raise ModelError(f"omega: {needed if is_forced else 'this System is not forced'}")

    def _check(self, name: str) -> None:
        laws = self._laws
        if name in ("omega", AMPLITUDE):
            return
        if name in self._arguments:
            return
        check_owner(name, self.model, laws)
        if isinstance(self.model, Oscillator) and name in numbers_of(self.model):
            return
        if any(name in GAP or name in numbers_of(law) for law in laws):
            is_own = [isinstance(law, UserLaw) and name in law.parameters for law in laws]
            if not all(own or law.is_numbers for own, law in zip(is_own, laws, strict=True)):
                raise ModelError(
                    f"along = {name!r}: parameters of fitted laws and user laws cannot be "
                    "continued; use 'omega' or a parameter of the model"
                )
            return
        known = [each for law in laws for each in numbers_of(law)]
        known += numbers_of(self.model) if isinstance(self.model, Oscillator) else []
        known += self._arguments
        of_motion = "omega" if self.is_forced else AMPLITUDE
        known = known if self.omega else [of_motion, *known]
        allowed = ", ".join(dict.fromkeys([*known, *GAP]))
        raise ModelError(
            f"parameter {name!r}: must be one of {allowed}; for a parameter of a System, pass "
            "a function with this argument that returns the System"
        )

    def _check_free(self) -> None:
        model = self.example
        lost = any(law.losses.lose_energy for law in self._laws)
        if model.is_forced or model.decay_rate or lost:
            raise ModelError(
                "along = 'amplitude': continues undamped free motions; "
                "forcing and damping must be 0"
            )

    @cached_property
    def _laws(self) -> tuple[ContactLaw, ...]:
        laws = self.law.values() if isinstance(self.law, Mapping) else [self.law]
        return tuple(map(checked_law, laws))

    @cached_property
    def _arguments(self) -> Mapping[str, inspect.Parameter]:
        """Arguments of a function that returns the model; none of a model."""
        try:
            return inspect.signature(self.model).parameters if callable(self.model) else {}
        except ValueError:  # of what is written in C
            said = "must be a gapsweep.System, or a Python function that returns one"
            raise ModelError(f"oscillator = {self.model!r}: {said}") from None

    @cached_property
    def example(self) -> Any:
        """The model at `values`."""
        return self.model_at(self.values)

    @cached_property
    def is_forced(self) -> bool:
        """Whether the period of orbits is a multiple of the forcing's."""
        return bool(self.example.is_forced)

    @cached_property
    def is_conservative(self) -> bool:
        """Whether orbits come in families, one for each amplitude."""
        return AMPLITUDE in self.names

    def model_at(self, values: Mapping[str, float]) -> Model:
        """The model at parameter values."""
        model = self.model
        if callable(model):
            known = {name: value for name, value in values.items() if name in self._arguments}
            return made_model(model, known)
        if not isinstance(model, Oscillator | System):
            raise ModelError(
                f"oscillator = {model!r}: must be a gapsweep.Oscillator(...), a gapsweep.System(), "
                "or a function that returns one"
            )
        if not isinstance(model, Oscillator):
            return model
        found: Oscillator = with_numbers(model, values)
        if AMPLITUDE in self.names and not found.is_loaded:
            return replace(general_form(found), forcing=())
        return found

    def at(self, values: Mapping[str, float]) -> tuple[Any, dict[str, ContactLaw]]:
        """The model, or its function with some arguments set, and the laws by contact."""
        known = {name: value for name, value in values.items() if name in self._arguments}
        model = partial(self.model, **known) if callable(self.model) else self.model_at(values)
        return model, dict(zip(self.example.contacts, self.laws_at(values), strict=True))

    def laws_at(self, values: Mapping[str, float]) -> tuple[ContactLaw, ...]:
        """The laws of all contacts, in the model's order, at parameter values.

        An argument of the function that returns the model changes no law, whatever its name.
        """
        own = {name: value for name, value in values.items() if name not in self._arguments}
        if self._names_of_laws.isdisjoint(own):
            return self._laws_of_contacts
        return tuple(with_numbers(law, own) for law in self._laws_of_contacts)

    @cached_property
    def _laws_of_contacts(self) -> tuple[ContactLaw, ...]:
        """The laws of all contacts as they were given."""
        contacts = self.example.contacts
        if isinstance(self.law, Mapping):
            return tuple(self.law[contact] for contact in contacts)
        return (self.law,) * len(contacts)

    @cached_property
    def _names_of_laws(self) -> frozenset[str]:
        """Names of parameters that a law may have."""
        return frozenset(GAP).union(*map(numbers_of, self._laws))

    def value_of(self, name: str, values: Mapping[str, float]) -> float:
        """A parameter's value where others have some.

        Raises
        ------
        ModelError
            If the model does not have it, or not one value of it.
        """
        if name in self.names:
            raise ModelError(f"second = {name!r}: must differ from the first parameter")
        if name == "omega" and self.omega is not None:
            return self.omega
        given = {**self.values, **values}
        model, laws = self.model_at(given), self.laws_at(given)
        if name == "gap" and any(len({*law.gap.distances}) > 1 for law in laws):
            raise ModelError("second = 'gap': the walls differ; use 'j_1' or 'j_2'")
        known: dict[str, Any] = {}
        for law in laws[::-1]:
            known |= {"gap": law.gap.distances[0]} | numbers_of(law)
        known |= numbers_of(model)
        arguments = self._arguments.values()
        known |= {each.name: each.default for each in arguments if each.default is not each.empty}
        if name not in known:
            raise ModelError(f"second = {name!r}: not a parameter of the model, or without a value")
        return float(known[name])

    def models(self, windows: tuple[Window, ...], places: Array) -> Models:
        """Models at places in windows of the parameters.

        Parameters
        ----------
        windows : tuple of Window
            Ranges of `names`, in their order.
        places : ndarray, shape (m, number of names)
        """
        columns = (
            {}
            if self.is_conservative
            else {window.name: window.value(places[:, k]) for k, window in enumerate(windows)}
        )
        omega = columns.pop("omega", None)
        if omega is None:
            omega = np.full(len(places), self.omega or 0.0)
        if not columns:
            return Models.of([self.example], [self.laws_at({})], omega)
        rows = [
            dict(self.values) | dict(zip(columns, row, strict=True))
            for row in zip(*(column.tolist() for column in columns.values()), strict=True)
        ]
        of_model = callable(self.model) or bool(set(columns) & set(numbers_of(self.model)))
        systems = [self.model_at(row) for row in rows] if of_model else [self.example]
        laws = [self.laws_at(row) for row in rows]
        return Models.of(systems, laws, omega)
