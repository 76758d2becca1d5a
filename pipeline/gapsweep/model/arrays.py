"""Checked arrays of numbers, from arguments and from files of measured points."""

import csv
import math
import re
from contextlib import suppress
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError, shown
from gapsweep.model.oscillator import LARGEST, is_number
from gapsweep.quantities import without_units, written

Array = NDArray[np.float64]

_DECIMAL_COMMA = re.compile(r"\s*[-+]?\d+,\d+\s*")
_NUMBER = re.compile(r"[-+.\deE,]*\d\.?")
_TITLE = re.compile(r"(.*?)\s*(?:\[(.*)\]|\((.*)\)|/\s*(.*))\s*")


def array(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return `value` as a read-only array of this shape; raise a `ModelError` that names it."""
    found = numbers(name, value)
    if found.shape != shape:
        raise ModelError(f"{name}: has the shape {found.shape}, must have {shape}")
    if not np.all(np.abs(found) <= LARGEST):
        raise ModelError(f"{name}: must be finite numbers within -{LARGEST:g}..{LARGEST:g}")
    found.setflags(write=False)
    return found


def numbers(name: str, value: Any, words: str = "an array of numbers") -> Array:
    """Return a copy of `value` as an array of floats; raise a `ModelError` that names it.

    Quantities of pint become numbers in the unit of the parameter. Text and booleans, which numpy
    would accept, are no numbers. `words` say in the message which value is allowed.
    """
    given = without_units(name, value)
    is_plain = getattr(getattr(given, "dtype", None), "kind", "O") != "O"  # one kind for all
    try:
        if all(map(is_number, [given] if is_plain else np.asarray(given, dtype=object).flat)):
            return np.array(given, dtype=float)
    except (TypeError, ValueError, OverflowError):
        pass
    raise ModelError(f"{name} = {shown(value)}: must be {words}")


def split_title(title: str) -> tuple[str, str]:
    """Return the words and the unit of a column's title, as ``time [ms]``, ``(ms)`` or ``/ ms``."""
    match = _TITLE.fullmatch(title)
    if match is None:
        return title.strip(), ""
    return match[1].strip(), next(filter(None, match.groups()[1:]), "").strip()


def factor_of(where: str, title: str, name: str, *units: str) -> float | None:
    """Return the factor from the unit in a column's title to one of `units`; None without a unit.

    The last word of ``time_ms`` is a unit, too, if it has the right dimension. Raises `ModelError`
    if the unit has another dimension or is unknown.

    Parameters
    ----------
    where : str
        Name of the table, for messages.
    name : str
        Name of the numbers, for messages.
    *units : str
        Units of the numbers that are allowed, as UDUNITS text.
    """
    words, unit = split_title(title)
    tail = "" if unit else words.rpartition("_")[2] if "_" in words else ""
    if unit in ("", "1", "-") and not tail:
        return None
    said = ""
    for one in units:
        try:
            factor = without_units(name, f"1 {unit or tail}", one)
        except ModelError as error:
            said = str(error)
            continue
        if not isinstance(factor, str):
            return float(factor)
        said = f"{name} = {unit!r}: must be a unit, as {written(one)!r}"
    if tail:
        return None
    raise ModelError(f"{where}: column {title.strip()!r}: {said}")


@dataclass(frozen=True, slots=True)
class Columns:
    """Columns of a text file."""

    path: str
    titles: list[str]  # titles above the columns; empty without titles
    # The lines of the columns: their numbers in the file, texts and cells.
    lines: list[tuple[int, str, list[str]]]

    def texts(self, place: int) -> list[str]:
        """Return the cells of a column, empty where a line is shorter."""
        return [cells[place].strip() if place < len(cells) else "" for *_, cells in self.lines]

    def numbers(self, place: int) -> Array:
        """Return the numbers of a column, shape (n,); ModelError if a cell is no finite number."""
        found = np.full(len(self.lines), math.nan)
        for row, text in enumerate(self.texts(place)):
            with suppress(ValueError):
                found[row] = float(text)
            if not math.isfinite(found[row]):
                number, line, _ = self.lines[row]
                said = f"must have a finite number in column {place + 1}; leave the line out"
                raise ModelError(f"{self.path}: line {number}: {line:.60}: {said}")
        return found

    def title(self, place: int) -> str:
        """Return the title of a column; empty without titles."""
        return self.titles[place] if place < len(self.titles) else ""

    def place(self, name: str) -> int:
        """Return the place of the column with a title, without its unit.

        Raises `ModelError` if the file has no such column.
        """
        names = [split_title(title)[0] for title in self.titles]
        if name not in names:
            has = ", ".join(names) or "no titles above its columns"
            raise ModelError(f"column {name!r}: {Path(self.path).name} has {has}")
        return names.index(name)


def read_columns(path: str | PathLike[str]) -> Columns:
    """Return the columns of a text file.

    Columns are separated by commas, semicolons, tabs or blanks. They begin at the first line with a
    number; the last line of words above it has the titles. Lines that begin with ``#`` are skipped,
    unless no other line has the titles. Raises `ModelError` if the file cannot be read, has no line
    with a number, or decimal commas.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8-sig").splitlines()
    except (OSError, TypeError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise ModelError(f"{path!s:.200}: cannot be read: {why}") from None
    titles: list[str] = []
    rows: list[tuple[int, str, list[str]]] = []
    for number, line in enumerate(lines, 1):
        is_comment = line.lstrip().startswith("#")
        cells = _cells(f"{path}: line {number}: {line:.60}", line)
        if rows or (any(map(_is_number, cells)) and not is_comment):
            rows += [(number, line, cells)] if cells and not is_comment else []
        elif cells and not (is_comment and titles):
            titles = [each.strip() for each in re.split(r"[,;\t]", line.lstrip("# "))]
    if not rows:
        raise ModelError(f"{path}: no line with a number, as -0.4, 12.5")
    is_title = len(titles) > 1 or len(rows[0][2]) == 1
    return Columns(str(path), titles if is_title else [], rows)


def _cells(where: str, line: str) -> list[str]:
    """Return the cells of a line; none of an empty one."""
    separator = max(";\t,", key=line.count)
    wide = next((each for each in ";\t" if each in line), None)
    parts = line.split(wide)
    is_decimal = any(map(_DECIMAL_COMMA.fullmatch, parts))
    if wide is None:  # commas within numbers that are separated by blanks
        is_decimal &= len(parts) > 1 and all(map(_NUMBER.fullmatch, parts))
    if is_decimal:
        raise ModelError(f"{where}: must have decimal points, as -0.4; 12.5")
    if separator not in line:
        return line.split()
    return next(csv.reader([line], delimiter=separator, skipinitialspace=True))


def _is_number(cell: str) -> bool:
    with suppress(ValueError):
        return math.isfinite(float(cell))
    return False
