"""Checked arrays of numbers, from arguments and from files of measured points."""

import re
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError, shown
from gapsweep.model.oscillator import LARGEST, is_number
from gapsweep.quantities import without_units

Array = NDArray[np.float64]

# In the first or in the second number of a line.
_DECIMAL_COMMA = r"\s*[-+]?\d+,\d+[;\s]+[-+.\d]|\s*[-+.\deE]+[;\s]+[-+]?\d+,\d"
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


def factor_of(title: str, name: str, units: str) -> float | None:
    """Return the factor from the unit in a column's title to `units`; None without a unit.

    The last word of ``time_ms`` is a unit, too, if it has the right dimension.

    Raises
    ------
    ModelError
        If the unit has another dimension or is unknown.
    """
    words, unit = split_title(title)
    tail = "" if unit else words.rpartition("_")[2] if "_" in words else ""
    if unit in ("", "1", "-") and not tail:
        return None
    try:
        factor = without_units(name, f"1 {unit or tail}", units)
        if isinstance(factor, str):
            raise ModelError(f"{name} = {unit!r}: must be a unit, as {units!r}")
    except ModelError:
        if tail:
            return None
        raise
    return float(factor)


def read_columns(path: str | PathLike[str]) -> tuple[list[str], Array]:
    """Return the words above the first two columns of a text file, and the numbers.

    Columns are separated by commas, semicolons or blanks. Lines of words at the top and lines that
    begin with ``#`` are skipped; the words are those of the last of these lines, two or none.

    Returns
    -------
    words : list of str
    rows : ndarray, shape (n, 2)

    Raises
    ------
    ModelError
        If the file cannot be read or is no table.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8-sig").splitlines()
    except (OSError, TypeError, ValueError) as error:
        raise ModelError(f"{path!s:.200}: cannot be read: {error}") from None
    words: list[str] = []
    rows: list[tuple[float, float]] = []
    for number, line in enumerate(lines, 1):
        where = f"{path}: line {number}: {line:.60}: must be two numbers"
        if re.match(_DECIMAL_COMMA, line):
            raise ModelError(f"{where} with decimal points, as -0.4; 12.5")
        first, *others = re.split(r"[,;\s]+", line.strip())
        try:
            rows.append((float(first), float(others[0])))
        except (ValueError, IndexError):
            if rows and first[:1] not in ("", "#"):
                raise ModelError(where) from None
            several = re.split(r"[,;\t]", line.lstrip("# "))
            words = several[:2] if not rows and len(several) > 1 else words
    if not rows:
        raise ModelError(f"{path}: no line of two numbers, as -0.4, 12.5")
    return words, np.array(rows)
