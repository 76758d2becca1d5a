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

from gapsweep.console import print_table, print_text
from gapsweep.errors import StoreError
from gapsweep.execution.layout import Layout
from gapsweep.store.artefact import replacing
from gapsweep.study.study import Study
from gapsweep.variables import to_dataframe

# What fits a terminal beside the dimensions: how the motion is, and whether it is one.
_COLUMNS = ("amplitude", "period_multiple", "response_class", "status")
_DIGITS = 4
_OF_TABLE = "more: --columns x_max,x_min,... prints others, --to csv all, --digits 6 more digits"
_OF_CSV = "all columns to the last digit, as csv: --to table prints the few that tell the motion"
# A longer name has two lines above its column.
_LONG = 10


@dataclass(frozen=True, slots=True)
class Form:
    """How responses are written.

    Attributes
    ----------
    kind : str
        ``table``, ``csv``, ``json`` or ``nc``.
    columns : sequence of str
        Variables, beside the dimensions; all if empty.
    digits : int, optional
        Significant digits; all if None.
    hint : str
        How to have other columns, to one who has not said which.
    """

    kind: str
    columns: Sequence[str] = ()
    digits: int | None = None
    hint: str = ""

    @classmethod
    def of(
        cls, kind: str | None, columns: str | None, digits: int | None, output: Path | None
    ) -> "Form":
        """What a command line asks for; a table is for whom sits at a terminal."""
        hint = ""
        if kind is None:
            kind = "table" if output is None and sys.stdout.isatty() else "csv"
            hint = _OF_CSV if kind == "csv" and output is None and not columns else ""
        if kind == "nc" and output is None:
            raise click.UsageError("--to nc needs --output FILE")
        if kind == "nc" and (columns or digits):
            raise click.UsageError("--to nc holds every variable to its last digit")
        if kind == "table" and output is not None:
            raise click.UsageError("--to table is for the terminal; --output takes csv, json or nc")
        named = tuple(columns.split(",")) if columns else ()
        if kind == "table":
            return cls(kind, named or _COLUMNS, digits or _DIGITS, "" if named else _OF_TABLE)
        return cls(kind, named, digits, hint)

    def check(self, study: Study) -> None:
        """Refuse columns that nothing of a study has, before anything is computed."""
        layout = Layout.of(study.grid, study.steady)
        wanted = [_base(name) for name in self.columns]
        _chosen(wanted, [*study.grid.coordinates(), *layout.variables])


def check_output(output: Path) -> None:
    """Refuse a file that is there, or has no folder, before anything is computed for it.

    Raises
    ------
    StoreError
    """
    if output.exists():
        raise StoreError(f"{output}: exists already; name a new file")
    if not output.parent.is_dir():
        raise StoreError(f"{output}: there is no folder {output.parent}")


def written(responses: xr.Dataset, form: Form, output: Path | None) -> None:
    """Write a dataset, one row per sweep point or, as ``nc``, whole.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    if form.kind == "table":
        _print(responses, form)
    elif output is None:
        click.echo(_text(responses, form), nl=False)
    else:
        with replacing(output) as temporary:
            if form.kind == "nc":
                responses.to_netcdf(temporary, engine="netcdf4", format="NETCDF4")
            else:
                temporary.write_text(_text(responses, form), encoding="utf-8")


def _text(responses: xr.Dataset, form: Form) -> str:
    frame = _frame(responses, form)
    if form.kind == "csv":
        return str(frame.to_csv(index=False))
    rows = json.loads(frame.to_json(orient="records", double_precision=15))
    return "".join(json.dumps(row) + "\n" for row in rows)


def _print(responses: xr.Dataset, form: Form) -> None:
    """A table for the eye: what all rows have in common stands above it, once."""
    frame = _frame(responses, form)
    dims = [str(dim) for dim in responses["status"].dims]
    same = [dim for dim in dims if frame[dim].nunique() == 1 and dim not in form.columns]
    if same:
        said = [f"{dim} {_word(frame[dim].iloc[0])}{_units(responses, dim)}" for dim in same]
        print_text(", ".join(said))
    names = [name for name in frame.columns if name not in same]
    rows = [[_word(value) for value in row] for row in frame[names].itertuples(index=False)]
    print_table([_head(responses, name) for name in names], rows)


def _word(value: Any) -> str:
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def _units(responses: xr.Dataset, name: str) -> str:
    units = responses[_base(name)].attrs.get("units", "1")
    return "" if units == "1" else f" {units}"


def _head(responses: xr.Dataset, name: str) -> str:
    base, bracket, of = name.partition("[")
    title = base.replace("_", "_\n", 1) if len(base) > _LONG else base
    title += f"\n{bracket}{of}" if of else ""
    units = _units(responses, name)
    return f"{title}\n[{units.strip()}]" if units else title


def _frame(responses: xr.Dataset, form: Form) -> Any:
    """A row per sweep point, with the variables asked for; flags in words."""
    points = responses["status"].dims
    frame = to_dataframe(responses)
    if form.columns:
        frame = frame[list(dict.fromkeys([*points, *_chosen(form.columns, frame.columns)]))]
    if form.digits is not None:
        floats = frame.select_dtypes("floating").columns.difference(points)
        frame[floats] = frame[floats].map(lambda value: float(f"{value:.{form.digits}g}"))
    return frame


def _chosen(wanted: Sequence[str], known: Sequence[str]) -> list[str]:
    """The columns that are asked for: of a variable those of all its coordinates or contacts."""
    bases = [_base(name) for name in known]
    found = []
    for name in wanted:
        if name not in (*known, *bases):
            alike = difflib.get_close_matches(name, [*known, *bases], n=1)
            likely = f"did you mean {alike[0]}? " if alike else ""
            message = f"{name!r}: {likely}Choose from {', '.join(dict.fromkeys(bases))}"
            raise click.BadParameter(message, param_hint="--columns")
        found += [one for one, base in zip(known, bases, strict=True) if name in (one, base)]
    return found


def _base(name: str) -> str:
    return name.partition("[")[0]
