"""A dataset of responses as a table."""

import difflib
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import xarray as xr

from gapsweep.cli.options import echo
from gapsweep.console import print_table, print_text
from gapsweep.errors import StoreError
from gapsweep.execution.layout import Layout
from gapsweep.report.scales import shown_unit
from gapsweep.store.artefact import replacing
from gapsweep.study.study import Study
from gapsweep.variables import to_dataframe

# Variables of a table, which fits a terminal, and of a CSV file, next to the dimensions; those that
# the responses have.
_SHORT = {
    "table": ("amplitude", "period_multiple", "response_class", "status"),
    "csv": (
        *("start", "x_max", "x_min", "amplitude", "force_max", "contact_share", "period_multiple"),
        *("multiplier_abs", "lyapunov", "response_class", "status"),
    ),
}
_ALL = "all"
_DIGITS = 4
_OF_TABLE = "more columns: --columns x_max,x_min,... or all; more digits: --digits 6"
_OF_CSV = "output: csv; for all columns: --columns all; for a short table: --to table"
# A longer name has two lines above its column.
_LONG = 10


@dataclass(frozen=True, slots=True)
class Form:
    """Format of the output."""

    kind: str  # ``table``, ``csv``, ``json`` or ``nc``
    # Variables in addition to the dimensions; all if empty, those of `_SHORT` if None.
    columns: Sequence[str] | None = ()
    digits: int | None = None  # significant digits; all if None
    hint: str = ""  # printed below the output: how to select columns; empty if columns were named

    @classmethod
    def of(
        cls, kind: str | None, columns: str | None, digits: int | None, output: Path | None
    ) -> "Form":
        """The format that command-line options ask for; by default a table on a terminal."""
        hint = ""
        if kind is None:
            kind = "table" if output is None and sys.stdout.isatty() else "csv"
            hint = _OF_CSV if kind == "csv" and not columns else ""
        if kind == "nc" and output is None:
            raise click.UsageError("--to nc needs --output FILE")
        if kind == "nc" and (columns or digits):
            raise click.UsageError(
                "--to nc writes all variables and digits; leave out --columns and --digits"
            )
        if kind == "table" and output is not None:
            raise click.UsageError(
                "--to table prints on the terminal; with --output use csv, json or nc"
            )
        short = None if kind in _SHORT else ()
        named = () if columns == _ALL else tuple(columns.split(",")) if columns else short
        if kind == "table":
            return cls(kind, named, digits or _DIGITS, "" if columns else _OF_TABLE)
        return cls(kind, named, digits, hint)

    def check(self, study: Study) -> None:
        """Raise an error for columns that the study's responses do not have."""
        layout = Layout.of(study.grid, study.steady)
        known = [*study.grid.coordinates(), *layout.variables]
        _chosen([_base(name) for name in self.columns or ()], known)


def check_output(output: Path) -> None:
    """Raise an error if an output file exists or its folder does not.

    Raises
    ------
    StoreError
        If the file exists or its folder does not.
    """
    if output.exists():
        raise StoreError(f"{output}: exists already; choose another name")
    if not output.parent.is_dir():
        raise StoreError(f"{output}: folder {output.parent} does not exist")


def written(responses: xr.Dataset, form: Form, output: Path | None) -> None:
    """Write a dataset: one row per sweep point, or a NetCDF file.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    if form.kind == "table":
        _print(responses, form)
    elif output is None:
        echo(_text(responses, form), nl=False)
    else:
        with replacing(output) as temporary:
            if form.kind == "nc":
                responses.to_netcdf(temporary, engine="netcdf4", format="NETCDF4")
            else:
                temporary.write_text(_text(responses, form), encoding="utf-8")


def _text(responses: xr.Dataset, form: Form) -> str:
    frame = _frame(responses, form)
    if form.kind == "csv":
        named = {name: f"{name}{_units(responses, name, ' [{}]')}" for name in frame.columns}
        return str(frame.rename(columns=named).to_csv(index=False))
    rows = json.loads(frame.to_json(orient="records", double_precision=15))
    return "".join(json.dumps(row) + "\n" for row in rows)


def _print(responses: xr.Dataset, form: Form) -> None:
    """Print a table; dimensions with one value are printed once above it."""
    frame = _frame(responses, form)
    dims = [str(dim) for dim in responses["status"].dims]
    same = [dim for dim in dims if frame[dim].nunique() == 1 and dim not in (form.columns or ())]
    if same:
        words = [f"{dim} {_word(frame[dim].iloc[0])}{_units(responses, dim)}" for dim in same]
        print_text(", ".join(words))
    names = [name for name in frame.columns if name not in same]
    rows = [[_word(value) for value in row] for row in frame[names].itertuples(index=False)]
    print_table([_head(responses, name) for name in names], rows)


def _word(value: Any) -> str:
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def _units(responses: xr.Dataset, name: str, form: str = " {}") -> str:
    """The unit in which tables show a variable, in a text; empty if it has none."""
    unit = shown_unit(responses[_base(name)])[1]
    return form.format(unit) if unit else ""


def _head(responses: xr.Dataset, name: str) -> str:
    base, bracket, of = name.partition("[")
    title = base.replace("_", "_\n", 1) if len(base) > _LONG else base
    title += f"\n{bracket}{of}" if of else ""
    return title + _units(responses, name, "\n[{}]")


def _frame(responses: xr.Dataset, form: Form) -> Any:
    """DataFrame with a row per sweep point and the selected variables; flags as words.

    Lengths are in millimetres in a table and in CSV, which have units in their headers, as in
    figures; in metres in JSON.
    """
    points = responses["status"].dims
    frame = to_dataframe(responses)
    columns = form.columns
    if columns is None:
        known = {_base(name) for name in frame.columns}
        columns = [name for name in _SHORT[form.kind] if name in known]
    if columns:
        frame = frame[list(dict.fromkeys([*points, *_chosen(columns, frame.columns)]))]
    if form.kind != "json":
        for name in frame.select_dtypes("floating").columns:
            frame[name] *= shown_unit(responses[_base(name)])[0]
    if form.digits is not None:
        floats = frame.select_dtypes("floating").columns.difference(points)
        frame[floats] = frame[floats].map(lambda value: float(f"{value:.{form.digits}g}"))
    return frame


def _chosen(wanted: Sequence[str], known: Sequence[str]) -> list[str]:
    """The selected columns; a variable selects the columns of all its coordinates or contacts."""
    bases = [_base(name) for name in known]
    found = []
    for name in wanted:
        if name not in (*known, *bases):
            alike = difflib.get_close_matches(name, [*known, *bases], n=1)
            likely = f"did you mean {alike[0]}? " if alike else ""
            message = (
                f"{name!r}: no such variable; {likely}choose from {', '.join(dict.fromkeys(bases))}"
            )
            raise click.BadParameter(message, param_hint="--columns")
        found += [one for one, base in zip(known, bases, strict=True) if name in (one, base)]
    return found


def _base(name: str) -> str:
    return name.partition("[")[0]
