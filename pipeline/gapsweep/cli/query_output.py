"""A dataset of responses as a table."""

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
from gapsweep.errors import DatasetError, StoreError
from gapsweep.execution.layout import Layout
from gapsweep.report.rows import base, chosen, rows, short, to_csv, unit_of
from gapsweep.store.artefact import replacing
from gapsweep.study.study import Study

# Variables of a table, which fits a terminal, of those that the responses have.
_SHORT = ("amplitude", "period_multiple", "response_class", "status")
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
    # Variables in addition to the dimensions; all if empty, a few if None.
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
        few = None if kind in ("table", "csv") else ()
        named = () if columns == _ALL else tuple(columns.split(",")) if columns else few
        if kind == "table":
            return cls(kind, named, digits or _DIGITS, "" if columns else _OF_TABLE)
        return cls(kind, named, digits, hint)

    def check(self, study: Study) -> None:
        """Raise an error for columns that the study's responses do not have."""
        layout = Layout.of(study.grid, study.steady)
        known = [*study.grid.coordinates(), *layout.variables]
        try:
            chosen([base(name) for name in self.columns or ()], known)
        except DatasetError as error:
            raise click.BadParameter(str(error), param_hint="--columns") from None


def check_output(output: Path) -> None:
    """Raise an error if an output file exists or its folder does not.

    Raises `StoreError` if the file exists or its folder does not.
    """
    if output.exists():
        raise StoreError(f"{output}: exists already; choose another name")
    if not output.parent.is_dir():
        raise StoreError(f"{output}: folder {output.parent} does not exist")


def written(responses: xr.Dataset, form: Form, output: Path | None) -> None:
    """Write a dataset: one row per sweep point, or a NetCDF file.

    Raises `StoreError` if the file cannot be written.
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
    if form.kind == "csv":
        return to_csv(responses, form.columns, form.digits)
    frame = rows(responses, form.columns or (), form.digits, in_metres=True)
    records = json.loads(frame.to_json(orient="records", double_precision=15))
    return "".join(json.dumps(row) + "\n" for row in records)


def _print(responses: xr.Dataset, form: Form) -> None:
    """Print a table; dimensions with one value are printed once above it."""
    columns = short(responses, _SHORT) if form.columns is None else form.columns
    frame = rows(responses, columns, form.digits)
    dims = [str(dim) for dim in responses["status"].dims]
    same = [dim for dim in dims if frame[dim].nunique() == 1 and dim not in columns]
    if same:
        values = [f"{dim} {_word(frame[dim].iloc[0])}{unit_of(responses, dim)}" for dim in same]
        print_text(", ".join(values))
    names = [name for name in frame.columns if name not in same]
    words = [[_word(value) for value in row] for row in frame[names].itertuples(index=False)]
    print_table([_head(responses, name) for name in names], words)


def _word(value: Any) -> str:
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def _head(responses: xr.Dataset, name: str) -> str:
    variable, bracket, of = name.partition("[")
    title = variable.replace("_", "_\n", 1) if len(variable) > _LONG else variable
    title += f"\n{bracket}{of}" if of else ""
    return title + unit_of(responses, name, "\n[{}]")
