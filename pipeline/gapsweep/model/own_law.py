"""User laws as values that can be sent to workers: code of ``module:name``, or a table."""

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from gapsweep.errors import ModelError
from gapsweep.model.contact import ContactLaw
from gapsweep.model.oscillator import Gap
from gapsweep.model.table import ForceTable
from gapsweep.model.user_law import UserLaw, parameters_of
from gapsweep.user_code.load import load_for_law
from gapsweep.user_code.snapshot import Snapshot


@dataclass(frozen=True)
class OwnLaw:
    """A user's contact law, independent of stiffness and gap."""

    # `module`, `name`: module and name of a function or table; or file and unit of measured forces.
    module: str
    name: str
    source: Snapshot | ForceTable  # the code that defines the function, or the table itself
    # Values of named numbers; a function uses those that are its arguments.
    parameters: tuple[tuple[str, float], ...] = ()

    @classmethod
    def of(cls, label: str, folders: Iterable[Path]) -> "OwnLaw":
        """Read the code of a label; the module is searched on Python's path, then in `folders`.

        A module that ends in ``.csv`` is a file of measured forces, the name the unit of its
        displacements; forces are in newtons. Raises `ModelError` if the module or file cannot be
        read.
        """
        module, _, name = label.partition(":")
        try:
            if module.endswith(".csv"):
                paths = [folder / module for folder in folders]
                path = next((path for path in paths if path.exists()), paths[0])
                return cls(module, name, ForceTable.from_csv(path, name))
            return cls(module, name, Snapshot.of_module(module, folders))
        except ModelError as error:
            raise ModelError(f"{label!r}: {error}") from None

    @property
    def label(self) -> str:
        """Label of the law, ``"module:name"``."""
        return f"{self.module}:{self.name}"

    @property
    def key(self) -> str:
        """Digest of the code and of the versions that it imports, or of the table's numbers."""
        if isinstance(self.source, Snapshot):
            return " ".join([self.source.key, *(f"{name}={x!r}" for name, x in self.parameters)])
        numbers = np.array([self.source.x, self.source.F], "<f8").tobytes()
        return f"table {hashlib.sha256(numbers).hexdigest()[:32]}"

    def load(self) -> Callable[..., float] | ForceTable:
        """Return the function or table of the label; its module is executed if need be.

        Raises `ModelError` if the code raises, or has no such name.
        """
        if isinstance(self.source, ForceTable):
            return self.source
        module = load_for_law(self.source, self.label)
        try:
            found: Callable[..., float] | ForceTable = getattr(module, self.name)
        except AttributeError:
            where = f"{self.label!r}: {self.source.path}"
            raise ModelError(f"{where}: defines no {self.name!r}") from None
        return found

    def law(self, K_c: float, gap: Gap, K_ratio: float = 1.0) -> ContactLaw:
        """Return the law for a stiffness and gap; with ``K_c = 0`` a table keeps its own gap."""
        found = self.load()
        if isinstance(found, ForceTable):
            return found.between(gap) if K_c else found
        return UserLaw(K_c, gap, found, dict(self._of(found)), K_ratio=K_ratio)

    def _of(self, found: Callable[..., float]) -> tuple[tuple[str, float], ...]:
        """The parameters, with their values, that are arguments of a function."""
        names = parameters_of(found) if callable(found) else ()
        return tuple(each for each in self.parameters if each[0] in names)

    @property
    def is_odd(self) -> bool:
        """Whether a table has ``F(-x) = -F(x)``; True for functions, which are not tested."""
        found = self.load()
        return not isinstance(found, ForceTable) or found.is_odd


@lru_cache(maxsize=64)
def checked(own: OwnLaw) -> OwnLaw:
    """Return the law, tested by a call at x = 0, with only the parameters that it takes.

    A table that the module defines is returned as numbers, without the code. Raises `ModelError` if
    the law cannot be loaded, or is no function of x.
    """
    own.law(0.0, Gap(0.0, 0.0))
    found = own.load()
    if not isinstance(found, ForceTable):
        return replace(own, parameters=own._of(found))
    if type(found) is not ForceTable:
        raise ModelError(f"{own.label!r}: a subclass of ForceTable; write a function of x instead")
    return replace(own, source=found, parameters=())
