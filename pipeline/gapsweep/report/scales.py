"""Values in figures and texts: units, labels, and whether an axis is logarithmic.

Units come from the dataset; lengths are drawn in millimetres.
"""

import re
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.quantities import written
from gapsweep.study.axis_selection import is_numeric
from gapsweep.study.grid import CONTACT, COORDINATE
from gapsweep.study.schema import PARAMETER, VARIABLES, parts_of
from gapsweep.variables import INPUTS, unit_in

_WIDE = 30.0  # smallest ratio of largest to smallest value for a logarithmic axis
_APART = 1.05  # smallest ratio of neighbouring values in a geometric series
# Units drawn in millimetres, by their UDUNITS text.
_IN_MILLIMETRES = {"m": "mm", "m s-1": "mm/s"}


def drawn(variable: xr.DataArray) -> NDArray[np.float64]:
    """Values of a variable in drawn units."""
    return np.asarray(variable.values * shown_unit(variable)[0], dtype=float)


def long_name(variable: xr.DataArray) -> str:
    """A variable's long name; for a parameter of a system, its name."""
    return str(variable.attrs.get("long_name", variable.name)).removeprefix(f"{PARAMETER} ")


def axis_label(variable: xr.DataArray, words: str = "") -> str:
    """Label of an axis: `words` or else the variable's long name, and its drawn unit.

    The name of a selected coordinate or contact of a system comes first.
    """
    words, unit = words or long_name(variable), shown_unit(variable)[1]
    for part in (COORDINATE, CONTACT):
        if part in variable.coords and parts_of(str(variable.name), [part]):
            words = f"{variable[part].item()}: {words}"
    return f"{words} [{unit}]" if unit else words


@dataclass(frozen=True, slots=True)
class NamedValue:
    """The only value of a coordinate as text, with its name and its unit (may be empty)."""

    name: str
    value: str
    unit: str

    @classmethod
    def of(cls, coordinate: xr.DataArray) -> "NamedValue":
        """The text of a coordinate with one value."""
        held = coordinate.values
        value = plain(drawn(coordinate).item()) if is_numeric(held) else str(held.item())
        if coordinate.name == "gap":
            value = shortened(value)
        return cls(str(coordinate.name), value, shown_unit(coordinate)[1])

    @property
    def short(self) -> str:
        """The value with three digits, to fit a column."""
        try:
            return plain(float(f"{float(self.value):.3g}"))
        except ValueError:  # a gap
            return self.value

    def __str__(self) -> str:
        """Text such as ``K_c = 14000 N/m``."""
        names = dict.fromkeys(("scene", "representation", COORDINATE), "")
        names |= {"gap": "gap ", "regime": "regime: "}
        return f"{names.get(self.name, f'{self.name} = ')}{self.value} {self.unit}".strip()


def named(coordinate: xr.DataArray) -> str:
    """The only value of a coordinate with name and unit, as ``K_c = 14000 N/m``."""
    return str(NamedValue.of(coordinate))


def plain(value: float) -> str:
    """A number as short text: 14000, and 1.4e6 for 1.4e+06."""
    return re.sub(r"e([+-])0*", lambda m: "e" + m[1].strip("+"), f"{value:g}")


def shortened(label: str) -> str:
    """A label without rows of zeros: ``1e6/1`` for a gap with one distant wall."""
    return re.sub(r"(?<![\d.])(\d)(0{5,})(?![\d.])", lambda m: f"{m[1]}e{len(m[2])}", label)


def is_crowded_low(values: NDArray[np.float64]) -> bool:
    """Whether values are positive, extend over a factor of 30, and mostly lie at the low end."""
    low, high = float(values.min()), float(values.max())
    if not (low > 0.0 and high > _WIDE * low):
        return False
    return values.size < 3 or float(np.median(values)) < 0.35 * (low + high)


def is_log(coordinate: xr.DataArray) -> bool:
    """Whether the axis of a coordinate is logarithmic; False for frequency."""
    values = coordinate.values
    return coordinate.name != "omega" and (is_crowded_low(values) or _is_geometric(values))


def _is_geometric(values: NDArray[np.float64]) -> bool:
    """Whether values form a geometric series."""
    if values.size < 3 or not (values > 0.0).all():
        return False
    ratios = np.sort(values)[1:] / np.sort(values)[:-1]
    return bool(ratios.min() > _APART and np.ptp(ratios) < 0.01 * ratios.min())


def shown_unit(variable: xr.DataArray) -> tuple[float, str]:
    """Factor from stored to drawn values (1000 for lengths in metres), and the drawn unit."""
    units = str(variable.attrs.get("units") or _of_part(variable))
    is_length = units in _IN_MILLIMETRES
    return (1e3, _IN_MILLIMETRES[units]) if is_length else (1.0, written(units))


def _of_part(variable: xr.DataArray) -> str:
    """The unit of a variable of the selected coordinate or contact; 1 if that is not known."""
    described, name = {**VARIABLES, **INPUTS}, str(variable.name)
    for part in (CONTACT, COORDINATE):
        own = variable.coords.get(f"{part}_unit")
        if own is not None and own.ndim == 0 and parts_of(name, [part]):
            return unit_in(described[name].units, str(own.item())) or "1"
    return "1"
