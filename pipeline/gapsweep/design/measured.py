"""Measured sweeps in SI units, and ranges of the parameters that are fitted to them.

A table has a column of frequencies (``omega`` or ``frequency``), a column of one quantity
(``amplitude``, ``x_max`` or ``peak``, ``x_min``, ``force_max``) and, if they are known, a column
``sweep`` with the words up and down, and a column ``noise`` of standard deviations. The name of a
column ends in its unit: ``frequency [Hz]``, ``amplitude (mm)``, ``peak_up_um``. Without a column
``sweep``, rising frequencies are a sweep up and falling ones a sweep down. ``amplitude up [mm]``
and ``amplitude down [mm]`` in two columns are two sweeps.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.continuation.family import AMPLITUDE, Window
from gapsweep.design.demands import QUANTITIES
from gapsweep.errors import ModelError
from gapsweep.model.arrays import factor_of, read_columns, split_title
from gapsweep.model.oscillator import checked, is_number
from gapsweep.quantities import allowed, without_units, written
from gapsweep.response.result import RESPONSE

Array = NDArray[np.float64]

_OTHER_NAMES = {
    **dict.fromkeys(("frequency", "freq", "f"), "omega"),
    **dict.fromkeys(("peak", "maximum"), "x_max"),
    **dict.fromkeys(("trough", "minimum"), "x_min"),
    "force": "force_max",
    "direction": "sweep",
}
_NAMES = ("omega", "sweep", "noise", *QUANTITIES)
_EXAMPLE = "frequency [Hz], amplitude [mm], sweep"
_FEWEST = 3  # points of a sweep
DIRECTIONS = {"up": 1, "down": -1}


@dataclass(frozen=True, slots=True)
class Sweep:
    """Values of one quantity over frequencies, in the order of the measurement."""

    direction: str  # up or down
    omega: Array  # [Hz]
    values: Array  # in the unit of the quantity
    noise: Array | None  # standard deviations of the values


@dataclass(frozen=True, slots=True)
class _Column:
    name: str
    direction: str  # empty unless the name has it
    title: str  # as in the file


def sweeps(measured: Any) -> tuple[str, list[Sweep]]:
    """Return the measured quantity, and its sweeps.

    Raises `ModelError` if the table cannot be read, a unit is missing or wrong, a number is
    missing, or the frequencies are not sorted.

    Parameters
    ----------
    measured : str, path, mapping, pandas.DataFrame or xarray.Dataset
        A CSV or ``.mat`` file, or a table by the names of its columns. Units of an xarray variable
        may be its attribute ``units`` instead. A ``.mat`` file has arrays named as
        ``frequency_Hz``, ``amplitude_mm``.
    """
    where, table = _table(measured)
    columns = [(_column(title), values) for title, values in table.items()]
    of_omega = [each for each in columns if each[0].name == "omega"]
    of_values = [each for each in columns if each[0].name in QUANTITIES]
    words = [values for column, values in columns if column.name == "sweep"]
    if len(of_omega) != 1:
        found = ", ".join(table) or "none"
        raise ModelError(f"{where}: columns {found}: must be as {_EXAMPLE}")
    names = sorted({column.name for column, _ in of_values})
    if len(names) != 1:
        said = " and ".join(names) or ", ".join(table)
        raise ModelError(f"{where}: columns {said}: must hold one quantity, as {_EXAMPLE}")
    units = RESPONSE[names[0]].units
    omega = _numbers(where, *of_omega[0], "Hz")
    of_noise = {each[0].direction: each for each in columns if each[0].name == "noise"}
    several: list[Sweep] = []
    for column, values in of_values:
        noise = of_noise.get(column.direction, of_noise.get(""))
        if of_noise and noise is None:
            raise ModelError(f"{where}: {column.title}: has no noise, other columns have")
        points = [omega]
        for title, of_points in [(column, values)] if noise is None else [(column, values), noise]:
            points.append(_numbers(where, title, of_points, units))
            if len(points[-1]) != len(omega):
                raise ModelError(
                    f"{where}: {title.title}: {len(points[-1])} values for {len(omega)} "
                    "frequencies; must be as many"
                )
        if column.direction:
            parts = [(column.direction, np.arange(len(omega)))]
        elif words:
            parts = _by_words(where, np.ravel(words[0]), len(omega))
        else:
            parts = _by_order(omega)
        several += [_sweep(where, name, np.stack(points)[:, rows]) for name, rows in parts]
    return names[0], several


def noise_of(noise: Any, quantity: str, several: Sequence[Sweep]) -> Array | None:
    """Return the standard deviation of every measured value, in the unit of the quantity, or None.

    `noise`: that of all values, a number > 0 or text with a unit; None: that of the sweeps.

    Raises `ModelError` if `noise` is out of range, or the sweeps have noise as well.
    """
    columns = [each.noise for each in several if each.noise is not None]
    if noise is None:
        return np.concatenate(columns) if columns else None
    if columns:
        raise ModelError(f"noise = {noise!r}: leave it out, the table has a column noise")
    units = RESPONSE[quantity].units
    value = without_units("noise", noise, units)
    if not is_number(value):
        raise ModelError(f"noise = {noise!r:.80}: must be {allowed(units)}")
    n_points = sum(len(each.omega) for each in several)
    return np.full(n_points, checked("noise", value, low=0.0, strict=True))


def ranges(free: Any, n_points: int) -> tuple[Window, ...]:
    """Return the ranges of free parameters, of which `n_points` measured points may decide.

    Raises `ModelError` if they are no ranges of parameters, or too many for the points.
    """
    if not isinstance(free, Mapping) or not free:
        raise ModelError(f"free = {free!r:.80}: must be ranges by name, as {{'gap': (1e-4, 1e-3)}}")
    for name in free:
        if name in ("omega", AMPLITUDE):
            raise ModelError(f"free: {name!r} is measured; name parameters of the model")
    if {"gap"} < {*free} and {"j_1", "j_2"} & {*free}:
        raise ModelError("free: 'gap' means both walls; leave it out with 'j_1' or 'j_2'")
    if n_points <= len(free):
        said = f"{n_points} points for {len(free)} free parameters; must be more points"
        raise ModelError(f"measured: {said}")
    return tuple(Window.of(name, ends) for name, ends in free.items())


def _sweep(where: str, direction: str, points: Array) -> Sweep:
    """A sweep in its order, from points in this or the opposite order.

    `points`: shape (2, n) or (3, n); frequencies [Hz], values and, if it is measured, their noise.
    """
    omega = points[0]
    if len(omega) < _FEWEST:
        said = f"has {len(omega)} points; must have >= {_FEWEST}"
        raise ModelError(f"{where}: the sweep {direction} {said}")
    steps = np.diff(omega)
    if not (np.all(steps > 0.0) or np.all(steps < 0.0)):
        k = int(np.flatnonzero(steps * np.sign(steps.sum() or 1.0) <= 0.0)[0])
        raise ModelError(
            f"{where}: {omega[k]:g} Hz before {omega[k + 1]:g} Hz in the sweep {direction}: "
            "frequencies must be sorted and different"
        )
    if np.sign(steps[0]) != DIRECTIONS[direction]:
        points = points[:, ::-1]
    omega, values, *noise = points.copy()
    return Sweep(direction, omega, values, noise[0] if noise else None)


def _by_words(where: str, words: NDArray[Any], n: int) -> list[tuple[str, NDArray[np.intp]]]:
    """Rows of each direction of a column of words."""
    said = [str(word).strip().lower() for word in words]
    wrong = [word for word in said if word not in DIRECTIONS]
    if wrong or len(said) != n:
        raise ModelError(
            f"{where}: sweep = {wrong[0] if wrong else len(said)!r}: must be up or down"
        )
    every = np.array(said)
    return [(name, np.flatnonzero(every == name)) for name in DIRECTIONS if name in said]


def _by_order(omega: Array) -> list[tuple[str, NDArray[np.intp]]]:
    """Rows of sweeps by their order: up while the frequency rises, down while it falls."""
    steps = np.sign(np.diff(omega))
    turns = np.flatnonzero(steps[1:] != steps[:-1]) + 1
    if len(turns) != 1:  # one direction, or unsorted, which is an error later
        return [("down" if steps.sum() < 0 else "up", np.arange(len(omega)))]
    rows = np.split(np.arange(len(omega)), turns + 1)
    return [
        ("up" if steps[0] > 0 else "down", rows[0]),
        ("up" if steps[-1] > 0 else "down", rows[1]),
    ]


def _numbers(where: str, column: _Column, values: Any, units: str) -> Array:
    """Values of a column in a unit."""
    factor = factor_of(where, column.title, column.name, units)
    if factor is None and units != "1":
        example = {"Hz": "Hz", "m": "mm"}.get(units, written(units))
        raise ModelError(f"{where}: {column.title}: has no unit; write {column.title} [{example}]")
    try:
        if np.iscomplexobj(values):
            raise ValueError(column.title)
        found: Array = np.atleast_1d(np.squeeze(np.asarray(values, float)))
        if found.ndim > 1:
            raise ValueError(found.shape)
    except (TypeError, ValueError):
        raise ModelError(f"{where}: {column.title}: must be one column of numbers") from None
    wrong = np.flatnonzero(~np.isfinite(found))
    if wrong.size:
        said = f"row {wrong[0] + 1} is {found[wrong[0]]}"
        raise ModelError(f"{where}: {column.title}: {said}; leave out rows without a number")
    least = found.min(initial=1.0)
    if column.name in ("omega", "noise") and least <= 0.0:
        raise ModelError(f"{where}: {column.title}: {least:g}: must be > 0")
    if column.name == AMPLITUDE and least < 0.0:
        raise ModelError(f"{where}: {column.title}: {least:g}: must be >= 0")
    return found * (1.0 if factor is None else factor)


def _column(title: str) -> _Column:
    """The quantity and direction that the title of a column names."""
    text = re.sub(r"[\s_]+", "_", split_title(title)[0].lower())
    for start in (text, text.rpartition("_")[0]):  # without a unit as of amplitude_up_mm
        direction = next((each for each in DIRECTIONS if start.endswith(f"_{each}")), "")
        quantity = start.removesuffix(f"_{direction}") if direction else start
        name = _OTHER_NAMES.get(quantity, quantity)
        if name in _NAMES:
            break
    return _Column(name, direction, title.strip())


def _table(measured: Any) -> tuple[str, Mapping[str, Any]]:
    """A name of the table for messages, and its columns by their titles."""
    if isinstance(measured, str | PathLike):
        path = Path(fspath(measured))
        reader = _mat if path.suffix.lower() == ".mat" else _csv
        return str(path), reader(path)
    if hasattr(measured, "to_dataframe") and hasattr(measured, "variables"):  # of xarray
        flat = measured.to_dataframe().reset_index()
        units = {str(name): measured[name].attrs.get("units", "") for name in flat}
        return "measured", {
            f"{name} [{units[name]}]" if units[name] else str(name): flat[name].to_numpy()
            for name in flat
        }
    try:
        names: Iterable[Any] = measured.keys()
        return "measured", {str(name): np.asarray(measured[name]) for name in names}
    except (AttributeError, TypeError):
        said = "must be a file, a table by the names of its columns, a DataFrame or a Dataset"
        raise ModelError(f"measured = {measured!r:.80}: {said}") from None


def _csv(path: Path) -> dict[str, Any]:
    """Columns of a CSV file by their titles."""
    found = read_columns(path)
    named = list(enumerate(found.titles))
    for title in found.titles:
        if found.titles.count(title) > 1:
            raise ModelError(f"{path}: column {title}: occurs twice; name one of both otherwise")
    has_numbers = [_column(title).name in ("omega", "noise", *QUANTITIES) for title in found.titles]
    return {
        title: found.numbers(k) if has_numbers[k] else np.array(found.texts(k))
        for k, title in named
    }


def _mat(path: Path) -> dict[str, Any]:
    """Arrays of a MATLAB file by their names."""
    from scipy.io import loadmat  # a quarter of a second to import, and few sweeps need it

    try:
        found = loadmat(path, squeeze_me=True)
    except Exception as error:  # scipy raises errors of many kinds for damaged files
        raise ModelError(f"{path}: cannot be read: {error}") from None
    return {name: values for name, values in found.items() if not name.startswith("__")}
