"""The table ``[fit]`` of a study: measured sweeps, and the numbers that are fitted to them."""

from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from gapsweep.design.measured import noise_of, ranges, sweeps
from gapsweep.errors import ModelError, StudyError
from gapsweep.model.contact import OF_WALLS
from gapsweep.model.labels import unknown_number
from gapsweep.quantities import written
from gapsweep.response.result import RESPONSE
from gapsweep.study.axes import MAX_VALUES, Number, Positive, Range, TomlTable
from gapsweep.study.grid import START, Axes
from gapsweep.study.system_tables import ContactTable

_NO_NUMBERS = ("representation", "omega", START)


class FitTable(TomlTable):
    """Measured sweeps by the titles of their columns, and ranges of the fitted numbers."""

    data: dict[str, Annotated[list[Number | str], Field(max_length=MAX_VALUES)]]
    free: dict[str, Range]
    noise: Positive | None = None

    def problems(
        self, axes: Axes, known: Collection[str], contacts: Iterable[ContactTable]
    ) -> Iterator[str]:
        """Yield a line per number that cannot be fitted or has several values.

        `axes`: axes of the study.
        `known`: names of the numbers of the model and of all walls.
        `contacts`: tables of [contact].
        """
        own = {name for one in contacts for name in one.model_dump(exclude_none=True)}
        first = axes["representation"][0]
        if first.protocol or first.is_auto:
            yield f"fit: {first}: is fitted as the first representation; begin with 'piecewise'"
        walls = {"gap", "j_1", "j_2"}
        kind = first.law_type
        is_fixed = kind is None or not kind.is_numbers  # each of its walls is another law
        for name in self.free:
            if name not in known:
                yield f"fit.free.{name}: {unknown_number(name, known)}"
            elif name in own or (name in walls and own & walls):
                yield f"fit.free.{name}: must be set in [[sweep]], not in [contact]"
            elif is_fixed and name in (*walls, "K_c", *OF_WALLS):
                yield f"fit.free.{name}: cannot vary with {first}; begin with 'piecewise'"
        for name, values in axes.items():
            is_free = name in self.free or (name in walls and walls & {*self.free})
            if len(values) > 1 and name not in _NO_NUMBERS and not is_free:
                yield f"fit: {name}: swept by the study; sweep one value, or write it in free"


def with_sweep(tables: Any, source: str) -> Any:
    """Return the tables of a study with measured sweeps in SI units in place of their file.

    ``data = "sweep.csv"`` is a file next to the study. The study then has all numbers of the fit.

    Raises `StudyError` if the file cannot be read, or a range or the noise is invalid.
    """
    table = tables.get("fit") if isinstance(tables, dict) else None
    if not isinstance(table, dict) or "data" not in table:
        return tables
    data, found = table["data"], dict(table)
    try:
        measured = Path(source).absolute().parent / data if isinstance(data, str) else data
        quantity, several = sweeps(measured)
        units = RESPONSE[quantity].units
        columns = {
            "omega [Hz]": [x for one in several for x in one.omega.tolist()],
            f"{quantity} [{written(units) or 1}]": [
                x for one in several for x in one.values.tolist()
            ],
            "sweep": [one.direction for one in several for _ in one.omega],
        }
        noise = noise_of(table.get("noise"), quantity, several)
        if noise is not None and table.get("noise") is not None:
            found["noise"] = float(noise[0])
        elif noise is not None:
            columns[f"noise [{written(units) or 1}]"] = noise.tolist()
        found["data"] = columns
        if "free" in table:
            ranges(table["free"], len(columns["sweep"]))
    except ModelError as error:
        raise StudyError(f"{source}: fit: {error}") from None
    return tables | {"fit": found}
