"""Quantities in the tables of a study, as text or as objects of pint: their numbers in SI units."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from gapsweep.errors import ModelError
from gapsweep.quantities import UNITS, without_units

# Keys of initial states of an oscillator: displacement and velocity.
_STATES = ("initial_condition", "start")
Path = Sequence[str | int]


def with_numbers(tables: Any) -> Any:
    """Return the tables of a study with numbers for their quantities, as 0.0004 for "0.4 mm".

    Text that is no quantity of the right dimension is left for the checks of the tables.
    """
    own = tables.get("parameters") if isinstance(tables, dict) else None
    return _numbers(tables, (), own if isinstance(own, dict) else ())


def units_of(path: Path, own: Collection[str] = ()) -> str | None:
    """Return the unit of a number in a study as UDUNITS text; None if it has none.

    `path`: keys and positions that lead to the number.
    `own`: parameters of user functions: their unit is empty, for any dimension.
    """
    for part in reversed(path):
        if part in _STATES and path[-1] in (0, 1):
            return UNITS[("x_0", "v_0")[int(path[-1])]]
        if part in own:
            return ""
        if part in UNITS:
            return UNITS[str(part)]
    return None


def ratios(table: Mapping[str, Any]) -> list[str]:
    """Return the keys of a distribution that are ratios, in no unit of the uncertain number.

    They are all keys of a factor of the nominal value, and the deviation of a logarithm.
    """
    of = ("sd",) if "lognormal" in table else ()
    return [key for key in table if table.get("nominal") == "times" or key in of]


def _numbers(value: Any, path: Path, own: Collection[str]) -> Any:
    if isinstance(value, dict):
        return {n: _numbers(each, (*path, _parameter(n, value)), own) for n, each in value.items()}
    if isinstance(value, list):
        return [_numbers(each, (*path, i), own) for i, each in enumerate(value)]
    if isinstance(value, int | float) or (units := units_of(path, own)) is None:
        return value
    try:
        found = without_units("", value, units)
    except ModelError:
        # Text, which the check of the tables refuses; a quantity in radians would act as a number.
        return value if isinstance(value, str) else f"{value.magnitude} {value.units}"
    return found.tolist() if hasattr(found, "tolist") else found


def _parameter(key: Any, table: dict[Any, Any]) -> Any:
    """Return the name in `UNITS` of the parameter that a key of a table stands for."""
    if key == "amplitude":
        return f"forcing: amplitude{f' at power {power}' if (power := table.get('power')) else ''}"
    if key in ("above", "below"):
        return table.get("quantity", key)
    if key == "period":
        return "forcing: period"
    if key in ratios(table):
        return "ratio"
    return table.get("second", key) if key == "range" else key
