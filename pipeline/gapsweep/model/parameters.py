"""Numbers of models and of contact laws by name, and models with other values of them."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

from gapsweep.errors import ModelError, described
from gapsweep.model.contact import ContactLaw
from gapsweep.model.oscillator import OSCILLATOR, Oscillator
from gapsweep.model.system import System
from gapsweep.model.user_law import UserLaw
from gapsweep.model.waves import ForceByPieces
from gapsweep.user_code.load import blame, plain

WALLS = ("j_1", "j_2")
GAP = ("gap", *WALLS)
_OF_CONTACT = re.compile(r"(\w+)\[(.+)\]")


def made_model(function: Callable[..., Any], values: Mapping[str, float]) -> Oscillator | System:
    """Return the model that a user's function makes of parameter values.

    Raises `ModelError` if the function raises, or returns no model.
    """
    try:
        made = function(**values)
    except ModelError:
        raise
    except Exception as error:  # a user's function may raise any type
        given = ", ".join(f"{name}={value!r}" for name, value in values.items())
        name = plain(str(getattr(function, "__qualname__", function)))
        message = f"oscillator: {name}({given}) raised {described(error)}"
        raise ModelError(blame(None, error, message)) from error
    if not isinstance(made, Oscillator | System):
        raise ModelError(f"oscillator: {made!r:.80}: must return a gapsweep.System")
    return made


@dataclass(frozen=True, slots=True)
class Parameter:
    """A number of a model or of its contact laws.

    Parameters
    ----------
    name : str
        ``"omega"`` [Hz]; a field of an oscillator; ``"forcing"`` of a system, a factor of all its
        loads, with the value 1; a number of all contact laws (``"K_c"``), ``"j_1"``, ``"j_2"``, or
        ``"gap"`` for both walls; a number of one contact of a system, as ``"K_c[stop]"``; or one of
        the arguments of `function`.
    function : callable, optional
        Function that returns the model for keyword arguments.
    arguments : mapping of str to float
        Its arguments.
    """

    name: str
    function: Callable[..., Any] | None = None
    arguments: Mapping[str, float] = field(default_factory=dict)

    def _is_of_model(self, model: Any) -> bool:
        if isinstance(model, System):
            return self.name == "forcing"
        return self.name in numbers_of(model)

    def _of_laws(self, model: Any, laws: Sequence[ContactLaw]) -> list[dict[str, float]]:
        """Numbers of the law of every contact that it changes, by name."""
        found = _OF_CONTACT.fullmatch(self.name)
        name, contact = found.groups() if found else (self.name, None)
        names = WALLS if name == "gap" else (name,)
        return [
            {each: value for each, value in numbers_of(law).items() if each in names}
            if contact in (None, place)
            else {}
            for place, law in zip(model.contacts, laws, strict=True)
        ]

    def values(self, model: Any, laws: Sequence[ContactLaw], omega: float) -> list[float]:
        """Return the value, or those of all contacts and walls that it changes together.

        Raises `ModelError` if there is no such parameter.
        """
        if self.name in self.arguments:
            return [self.arguments[self.name]]
        if self.name == "omega" and model.is_forced:
            return [omega]
        check_owner(self.name, model, laws)
        if self._is_of_model(model):
            return [1.0 if isinstance(model, System) else float(getattr(model, self.name))]
        if found := [value for own in self._of_laws(model, laws) for value in own.values()]:
            return found
        known = [*self.arguments] + (["omega"] if model.is_forced else [])
        known += ["forcing"] if isinstance(model, System) and model.forcing else numbers_of(model)
        own = list(dict.fromkeys(each for law in laws for each in [*numbers_of(law), "gap"]))
        known += own + [f"{own[0]}[{place}]" for place in model.contacts if len(laws) > 1]
        raise ModelError(f"parameter {self.name!r}: must be one of {', '.join(known)}")

    def shifted(
        self, model: Any, laws: Sequence[ContactLaw], omega: float, by: float
    ) -> tuple[Any, tuple[ContactLaw, ...], float]:
        """Return model, laws and frequency with the parameter's value changed by a number."""
        if self.function is not None and self.name in self.arguments:
            arguments = {**self.arguments, self.name: self.arguments[self.name] + by}
            return self.function(**arguments), tuple(laws), omega
        if self.name == "omega":
            return model, tuple(laws), omega + by
        if self._is_of_model(model):
            if isinstance(model, System):
                loads = tuple(_scaled(load, 1.0 + by) for load in model.forcing)
                return replace(model, forcing=loads), tuple(laws), omega
            value = getattr(model, self.name) + by
            return with_numbers(model, {self.name: value}), tuple(laws), omega
        found = zip(laws, self._of_laws(model, laws), strict=True)
        moved = [(law, {name: value + by for name, value in own.items()}) for law, own in found]
        return model, tuple(with_numbers(law, own) for law, own in moved), omega


def check_owner(name: str, model: Any, laws: Sequence[ContactLaw]) -> None:
    """Raise a `ModelError` if a name is both an oscillator's and an argument of a user's law."""
    if isinstance(model, Oscillator) and name in OSCILLATOR:
        for law in laws:
            if isinstance(law, UserLaw) and name in law.parameters:
                raise ModelError(
                    f"parameter {name!r}: the oscillator has one, and so has {law}; give the "
                    "argument of the function another name"
                )


def numbers_of(of: Any) -> dict[str, float]:
    """Return the numbers of an oscillator or of a law by name, with its walls; none of a system."""
    if isinstance(of, System):
        return {}
    if isinstance(of, Oscillator):
        return {name: getattr(of, name) for name in OSCILLATOR}
    walls = {wall: j for wall in WALLS if (j := getattr(of.gap, wall)) < math.inf}
    if isinstance(of, UserLaw):
        return {**walls, **of.parameters}
    own = {each.name: getattr(of, each.name) for each in fields(of) if each.init}
    return {name: value for name, value in own.items() if type(value) is float} | walls


def with_numbers(of: Any, values: Mapping[str, float]) -> Any:
    """Return an oscillator or a law with other values of its numbers; other names are ignored.

    ``"gap"`` is the distance of every wall of a law. Walls of user laws stay where they are.
    """
    if isinstance(of, UserLaw):
        own = {name: value for name, value in values.items() if name in of.parameters}
        return replace(of, parameters={**of.parameters, **own}) if own else of
    own = {name: values[name] for name in numbers_of(of).keys() & values if name not in WALLS}
    if isinstance(of, ContactLaw) and not values.keys().isdisjoint(GAP):
        gap = of.gap.at(values["gap"]) if "gap" in values else of.gap
        walls = {wall: values[wall] for wall in WALLS if wall in values}
        return replace(of, **own, gap=replace(gap, **walls))
    return replace(of, **own) if own else of


def _scaled(load: Any, factor: float) -> Any:
    if isinstance(load, ForceByPieces):
        return replace(load, peak=load.peak * factor)
    return replace(load, amplitude=load.amplitude * factor)
