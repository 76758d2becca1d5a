"""Parameters of models and of contact laws by name, with shifted values."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import chain
from typing import Any

from gapsweep.errors import ModelError
from gapsweep.model.contact import ContactLaw
from gapsweep.model.system import System
from gapsweep.model.user_law import UserLaw
from gapsweep.model.waves import ForceByPieces

_WALLS = {"gap": ("j_1", "j_2"), "j_1": ("j_1",), "j_2": ("j_2",)}
_OF_CONTACT = re.compile(r"(\w+)\[(.+)\]")


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

    @property
    def _of_law(self) -> tuple[str, str | None]:
        """Name of a law's number, and the contact if it is only one's."""
        found = _OF_CONTACT.fullmatch(self.name)
        return (found[1], found[2]) if found else (self.name, None)

    def _is_of_model(self, model: Any) -> bool:
        if isinstance(model, System):
            return self.name == "forcing"
        return self.name in _numbers(model)

    def values(self, model: Any, laws: Sequence[ContactLaw], omega: float) -> list[float]:
        """Return the value, or those of all contacts and walls that it changes together.

        Raises
        ------
        ModelError
            If there is no such parameter.
        """
        if self.name in self.arguments:
            return [self.arguments[self.name]]
        if self.name == "omega" and model.is_forced:
            return [omega]
        if self._is_of_model(model):
            return [1.0 if isinstance(model, System) else float(getattr(model, self.name))]
        name, contact = self._of_law
        found: list[float] = []
        for place, law in zip(model.contacts, laws, strict=True):
            if contact in (None, place):
                found += _distances(law, name).values()
                found += [getattr(law, name)] if name in _numbers(law) else []
        if found:
            return found
        known = [*self.arguments] + (["omega"] if model.is_forced else [])
        known += ["forcing"] if isinstance(model, System) and model.forcing else _numbers(model)
        several = (
            [*_numbers(law), *(name for name in _WALLS if _distances(law, name))] for law in laws
        )
        own = list(dict.fromkeys(chain.from_iterable(several)))
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
            changed = replace(model, **{self.name: getattr(model, self.name) + by})
            return changed, tuple(laws), omega
        name, contact = self._of_law
        pairs = zip(model.contacts, laws, strict=True)
        found = [_shifted(law, name, by) if contact in (None, x) else law for x, law in pairs]
        return model, tuple(found), omega


def _numbers(of: Any) -> list[str]:
    """Names of the numbers of an oscillator or a law; none of a system or of a user law."""
    if isinstance(of, System | UserLaw):
        return []
    return [each.name for each in fields(of) if type(getattr(of, each.name)) is float]


def _distances(law: ContactLaw, name: str) -> dict[str, float]:
    """Distances [m] of the walls of a law that a name means, without missing walls."""
    several = {wall: getattr(law.gap, wall) for wall in _WALLS.get(name, ())}
    return {wall: j for wall, j in several.items() if j < math.inf}


def _scaled(load: Any, factor: float) -> Any:
    if isinstance(load, ForceByPieces):
        return replace(load, peak=load.peak * factor)
    return replace(load, amplitude=load.amplitude * factor)


def _shifted(law: ContactLaw, name: str, by: float) -> ContactLaw:
    if name in _WALLS:
        walls = {wall: j + by for wall, j in _distances(law, name).items()}
        return replace(law, gap=replace(law.gap, **walls))
    return replace(law, **{name: getattr(law, name) + by})
