"""Variables of datasets: the dimensions within a point, and how a variable is described."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gapsweep.status import Status

START = "initial_condition"
# Dimensions within a point: the parts of a system, and lists that are padded where they end.
COORDINATE, CONTACT, LAG = "coordinate", "contact", "lag"
EXTREMUM, SECTION_POINT, MULTIPLIER = "extremum", "section_point", "multiplier"
# Units that do not depend on the meaning of a coordinate.
_OWN_UNITS = {"1", "s", "s-1", "Hz"}


@dataclass(frozen=True, slots=True)
class Variable:
    """One dataset variable.

    Attributes
    ----------
    dtype : str
        NumPy type code, or ``"str"``.
    units : str
        UDUNITS text, ``"1"`` if nondimensional; empty if its user alone knows.
    long_name : str
    missing : float
        Value in cells that are no sweep point.
    flags : tuple of (str, int)
        Meanings and values, for flag variables.
    dims : tuple of str
        Dimensions within a point. An oscillator has no `COORDINATE`, `CONTACT` and `LAG`.
    """

    dtype: str
    units: str
    long_name: str
    missing: float = float("nan")
    flags: tuple[tuple[str, int], ...] = ()
    dims: tuple[str, ...] = ()

    @property
    def attributes(self) -> dict[str, Any]:
        """Attributes of the variable in a file."""
        attributes: dict[str, Any] = {"units": self.units} if self.units else {}
        attributes["long_name"] = self.long_name
        if self.flags:
            names, values = zip(*self.flags, strict=True)
            attributes["flag_values"] = np.array(values, dtype=self.dtype)
            attributes["flag_meanings"] = " ".join(names)
        return attributes

    @property
    def of_systems(self) -> "Variable":
        """The variable of a system, whose user alone knows whether coordinates are lengths."""
        return self if self.units in _OWN_UNITS else replace(self, units="")


# Of every variable the dimensions, and what it is.
Described = Mapping[str, tuple[tuple[str, ...], Variable]]


def empty(table: Described, sizes: Mapping[str, int]) -> dict[str, Any]:
    """Arrays of a table's variables, in which all is missing."""
    return {
        name: np.full([sizes[dim] for dim in dims], variable.missing, variable.dtype)
        for name, (dims, variable) in table.items()
    }


def with_attributes(table: Described, arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Arrays with their dimensions and attributes, as a dataset takes them."""
    return {
        name: (dims, arrays[name], variable.attributes) for name, (dims, variable) in table.items()
    }


STATUS_FLAGS = tuple((status.label, int(status)) for status in Status)
# Of every motion.
COUNTS = {
    "n_contacts": Variable("i8", "1", "wall crossings of the motion, in and out", 0),
    "n_steps": Variable("i8", "1", "accepted steps of the motion", 0),
    "n_rejected": Variable("i8", "1", "rejected steps of the motion", 0),
    "nfev": Variable("i8", "1", "right-hand sides of the motion", 0),
}
