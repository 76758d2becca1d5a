"""Rows of a table of responses, one per sweep point, in the units of figures."""

import difflib
from collections.abc import Sequence
from typing import Any

import xarray as xr

from gapsweep.errors import DatasetError
from gapsweep.report.scales import shown_unit
from gapsweep.study.samples import DRAWN
from gapsweep.variables import PARTS, to_dataframe

# Columns of a CSV file next to the dimensions by default, of those that the responses have.
OF_CSV = (
    *("start", "x_max", "x_min", "amplitude", "force_max", "contact_share"),
    *("contacts_per_period", "period_multiple", "response_class", "status"),
)


def to_csv(
    responses: xr.Dataset, columns: Sequence[str] | None = None, digits: int | None = None
) -> str:
    """Return a row per sweep point as CSV, with units in the header.

    Lengths are in millimetres, as in figures. Raises `DatasetError` if a variable is not in the
    responses.

    `responses`: as ``responses.nc``, or a part of it.
    `columns`: variables in addition to the dimensions, all if empty; None: `OF_CSV`.
    `digits`: significant digits of variables; None: all.
    """
    shown = rows(responses, short(responses, OF_CSV) if columns is None else columns, digits)
    named = {name: f"{name}{unit_of(responses, name, ' [{}]')}" for name in shown.columns}
    return str(shown.rename(columns=named).to_csv(index=False))


def rows(
    responses: xr.Dataset,
    columns: Sequence[str],
    digits: int | None = None,
    *,
    in_metres: bool = False,
) -> Any:
    """Return a DataFrame of the dimensions and some variables, all if empty; flags as words.

    Lengths are in millimetres, or `in_metres`.
    """
    frame = to_dataframe(responses)
    if columns:
        dims = [name for name in responses["status"].dims if name in frame]
        frame = frame[list(dict.fromkeys([*dims, *chosen(columns, frame.columns)]))]
    if not in_metres:
        for name in frame.select_dtypes("floating").columns:
            frame[name] *= shown_unit(_column(responses, name))[0]
    if digits is not None:
        floats = frame.select_dtypes("floating").columns.difference(responses["status"].dims)
        frame[floats] = frame[floats].map(lambda value: float(f"{value:.{digits}g}"))
    return frame


def short(responses: xr.Dataset, names: Sequence[str]) -> list[str]:
    """Return the names of variables that the responses have, and of drawn values of samples."""
    drawn = [str(name) for name in responses.coords if str(name).startswith(DRAWN)]
    return [*drawn, *(name for name in names if name in responses.variables)]


def chosen(wanted: Sequence[str], known: Sequence[str]) -> list[str]:
    """Return the selected columns; a variable selects those of all its coordinates or contacts."""
    bases = [base(name) for name in known]
    found = []
    for name in wanted:
        if base(name) not in bases:
            alike = difflib.get_close_matches(name, [*known, *bases], n=1)
            likely = f"did you mean {alike[0]}? " if alike else ""
            raise DatasetError(
                f"{name!r}: no such variable; {likely}choose from {', '.join(dict.fromkeys(bases))}"
            )
        found += [one for one, base in zip(known, bases, strict=True) if name in (one, base)]
    return found


def unit_of(responses: xr.Dataset, name: str, form: str = " {}") -> str:
    """Return the unit in which tables show a column, in a text; empty if it has none."""
    unit = shown_unit(_column(responses, name))[1]
    return form.format(unit) if unit else ""


def _column(responses: xr.Dataset, name: str) -> xr.DataArray:
    """The variable of a column, of its coordinate or contact."""
    variable, part = responses[base(name)], name.partition("[")[2].removesuffix("]")
    own = {dim: part for dim in PARTS if dim in variable.dims and part}
    return variable.sel(own)


def base(name: str) -> str:
    """Return the variable of a column, without the coordinate or contact of a system."""
    return name.partition("[")[0]
