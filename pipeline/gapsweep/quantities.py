"""Units of parameters, and quantities with units as the plain SI numbers that gapsweep stores.

A quantity is an object of pint, of any registry. Frequencies are in hertz. To pint one hertz is one
radian per second; here, the angle in a frequency's unit decides.
"""

import math
import re
from typing import Any

from gapsweep.errors import ModelError

# Unit of every parameter as UDUNITS text, ``"1"`` if nondimensional.
UNITS = {
    **dict.fromkeys(("omega", "omega_n"), "Hz"),
    **dict.fromkeys(("gap", "j_1", "j_2", "x_0", "q_0", "x", "atol", "range", "start_jitter"), "m"),
    **dict.fromkeys(("visited", "amplitude", "base_amplitude"), "m"),
    **dict.fromkeys(("v_0", "v", "speed"), "m s-1"),
    **dict.fromkeys(("t", "t_0", "t_end", "t_max", "time_limit", "timeout"), "s"),
    "forcing: period": "s",
    **dict.fromkeys(("forcing", "mean_load", "preload", "forcing: amplitude", "F", "f"), "N"),
    **dict.fromkeys(("f(t)", "noise"), "N"),
    **dict.fromkeys(
        ("zeta", "K_ratio", "restitution", "depth", "rtol", "settle_tol", "error", "ratio"), "1"
    ),
    **dict.fromkeys(("epsilon", "gamma"), "m-1"),
    "chi": "s m-1",
    **dict.fromkeys(("K_c", "stiffness"), "N m-1"),
    **dict.fromkeys(("c", "damping"), "N s m-1"),
    **dict.fromkeys(("unbalance", "forcing: amplitude at power 2"), "kg m"),
    "base_damping": "1",
    "forcing: amplitude at power 1": "N s",
    "mass": "kg",
    "alpha": "N m-3",
    **dict.fromkeys(("phase", "freeplay"), "rad"),
    "density": "kg m-3",
}
# Units as engineers write them, by their UDUNITS text.
_WRITTEN = {
    "1": "",
    "N m-1": "N/m",
    "N m-3": "N/m³",
    "m s-1": "m/s",
    "N s m-1": "N s/m",
    "s-1": "1/s",
    "m-1": "1/m",
    "s m-1": "s/m",
    "rad s-1": "rad/s",
    "N m rad-1": "N m/rad",
    "N m s rad-1": "N m s/rad",
    "rad-1": "1/rad",
    "kg m-3": "kg/m³",
}
# A number, then a unit, in which no power is raised again: that could take forever.
_TEXT = re.compile(
    r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*"
    r"(?!.*\d\s*(?:\^|\*\*))((?:1\s*/|[^\W\d_]|[%°]).{,40})"
)


def written(units: str) -> str:
    """Return a unit as engineers write it, from its UDUNITS text."""
    return _WRITTEN.get(units, units)


def without_units(name: str, value: Any, units: str | None = None) -> Any:
    """Return a value with its quantities as plain numbers in the unit of a parameter.

    Raises `ModelError` if a quantity has another dimension, or is a frequency in 1/s, which may
    mean Hz or rad/s.

    Parameters
    ----------
    name : str
        Name of the parameter, as in messages; it or its last word is looked up in `UNITS`.
    value : object
        A quantity of pint, text that is one, as ``"0.4 mm"``, or a list or tuple that may contain
        some. Any other value is returned unchanged.
    units : str, optional
        UDUNITS text instead of that of `UNITS`; empty: any dimension, in SI base units.
    """
    if isinstance(value, list | tuple):
        return [without_units(name, each, units) for each in value]
    given, value = value, _parsed(value) if isinstance(value, str) else value
    if not (hasattr(value, "to_root_units") and hasattr(value, "magnitude")):
        return given
    units = _units_of(name) if units is None else units
    shown = f"{name} = {given!r}" if isinstance(given, str) else f"{name} = {given}"
    if units is None:
        raise ModelError(f"{shown}: must be a number, without a unit")
    try:
        return _rounded(_number(value, units))
    # The classes of errors are pint's, which is not imported here.
    except (AttributeError, TypeError, ValueError, ArithmeticError):
        raise ModelError(f"{shown}: must be {allowed(units)}") from None


def _units_of(name: str) -> str | None:
    return UNITS.get(name, UNITS.get(name.rpartition(" ")[2]))


def allowed_of(name: str) -> str:
    """Return the numbers and quantities that a named parameter may have, for messages."""
    units = _units_of(name)
    return "a number" if units is None else allowed(units)


def allowed(units: str) -> str:
    """Return the numbers and quantities that a parameter may have, for messages."""
    special = {
        "": "a number, or a quantity that is no frequency: write frequencies as numbers",
        "1": "a number or a quantity without dimension, as 2 %",
        "Hz": "a number in Hz, or a quantity in Hz, rad/s or rpm",
    }
    return special.get(units, f"a number in {written(units)}, or a quantity of this dimension")


def _parsed(text: str) -> Any:
    """Return the quantity that a text describes, as ``"0.4 mm"``; None for other text."""
    found = _TEXT.fullmatch(text)
    if found is None:
        return None
    import pint  # takes half a second, which plain numbers do not need

    registry: Any = pint
    try:
        return registry.get_application_registry().Quantity(float(found[1]), found[2].strip())
    except Exception:  # the parser of pint raises errors of Python's tokenizer, too
        return None


def _number(value: Any, units: str) -> Any:
    """Return the magnitude of a quantity in a unit; raise errors of pint or a `ValueError`."""
    root = value.to_root_units()
    kind = {str(name): power for name, power in root.unit_items()}
    per_second, is_in_hertz = kind.get("second") == -1, "hertz" in str(value.units)
    if units == "Hz":
        if kind == {"radian": 1, "second": -1}:
            return root.magnitude / (2.0 * math.pi)
        if kind == {"second": -1} and is_in_hertz:
            return root.magnitude
        raise ValueError(units)
    if is_in_hertz or (not units and per_second and {*kind} <= {"radian", "second"}):
        raise ValueError(units)
    if not units:
        return value.to_base_units().magnitude
    return value.to(re.sub(r"(?<=[a-z])(-?\d)", r"**\1", units) if units != "1" else "").magnitude


def _rounded(number: Any) -> Any:
    """Return numbers without the rounding of a conversion: 0.3 mm are 0.0003 m."""
    if isinstance(number, int | float):
        return float(f"{number:.15g}")
    import numpy as np  # there: this is an array

    flat = [float(f"{each:.15g}") for each in np.ravel(number).tolist()]
    return np.reshape(flat, np.shape(number))
