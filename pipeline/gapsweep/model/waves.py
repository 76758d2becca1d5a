"""Forces by pieces: polynomials between knots, over one forcing period or over a record in seconds.

A force is its largest modulus, `peak`, times a `Wave`, which has the values -1..1. Only the pieces
are kept: tables, switched levels and functions are integrated by the same code.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from os import PathLike
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError, described
from gapsweep.model.arrays import array, factor_of, numbers, read_columns
from gapsweep.model.oscillator import LARGEST, called_as, checked

Array = NDArray[np.float64]

MAX_KNOTS = 100_000
N_TERMS = 8  # most coefficients of a piece
_SAME_TIME = 1e-9  # of a period: a last time so close to its end is the end
_TOLERANCE = 1e-13  # of the largest value: largest error between the nodes of a function's piece
_LEAST = 2.0**-20  # of an interval between kinks: a shorter piece contains another kink


@dataclass(frozen=True, repr=False)
class Wave:
    """The values of a force by pieces, divided by its largest modulus."""

    # Ends of the pieces, ascending: in periods, from 0 to 1; or in seconds, up to infinity.
    ends: tuple[float, ...]
    # Polynomial of every piece, by powers of the time since its end (negative within it).
    coefficients: tuple[tuple[float, ...], ...]
    # Whether the wave is a record in seconds; otherwise it repeats in every period.
    in_seconds: bool = False

    @classmethod
    def read(cls, fields: Mapping[str, Any]) -> "Wave":
        """Return the wave with these fields, read from JSON."""
        pieces = tuple(tuple(map(float, each)) for each in fields["coefficients"])
        return cls(tuple(map(float, fields["ends"])), pieces, bool(fields["in_seconds"]))

    def __repr__(self) -> str:
        return f"<{len(self.ends)} pieces{' in seconds' if self.in_seconds else ''}>"

    @cached_property
    def table(self) -> tuple[Array, Array]:
        """Ends, shape (n,), and coefficients, shape (n, N_TERMS), as arrays."""
        found = np.array(self.coefficients)
        return np.array(self.ends), np.pad(found, ((0, 0), (0, N_TERMS - found.shape[1])))

    def at(self, t: ArrayLike) -> Array:
        """Return the values at times in periods or seconds; at a knot, of the piece behind it."""
        times = np.asarray(t, float)
        times = times if self.in_seconds else times - np.floor(times)
        ends, coefficients = self.table
        piece = np.searchsorted(ends, times, side="right").clip(max=len(ends) - 1)
        since = times - np.where(np.isfinite(ends), ends, 0.0)[piece]
        value = np.zeros_like(times)
        for k in reversed(range(N_TERMS)):
            value = value * since + coefficients[piece, k]
        return value


@dataclass(frozen=True, repr=False, eq=False)
class ForceByPieces:
    """A force by pieces, as `PeriodicForce`, `Switched` and `Record` make one: ``peak wave along``.

    Attributes
    ----------
    wave : Wave
    peak : float
        Largest modulus of the force [N].
    along : ndarray, shape (n,), or None
        Direction in a system [-]; None: the only coordinate.
    """

    phase: ClassVar[float] = 0.0
    power: ClassVar[int] = 0
    wave: Wave
    peak: float
    along: Any = None

    @property
    def k(self) -> int:
        """Multiple of the forcing frequency, as of a `Harmonic`: 0 for a record, which has none."""
        return int(not self.wave.in_seconds)

    @property
    def amplitude(self) -> Array:
        """Generalised forces at the peak [N], shape (n,)."""
        return np.asarray(self.peak * self.along)

    @property
    def start(self) -> float:
        """Factor of the amplitude at phase zero of the forcing."""
        return float(self.wave.at(0.0))

    def growth(self, omega_rad: Any) -> Any:
        """Return the factor of the amplitude at a frequency: 1."""
        return 1.0 + 0.0 * omega_rad

    def _set(self, ends: Any, pieces: Array, peak: float, along: Any, in_seconds: bool) -> None:
        n_terms = max(np.flatnonzero(pieces.any(axis=0)), default=0) + 1
        scaled = pieces[:, :n_terms] / (peak or 1.0)
        coefficients = tuple(map(tuple, scaled.tolist()))
        ends = tuple(np.asarray(ends, float).tolist())
        object.__setattr__(self, "wave", Wave(ends, coefficients, in_seconds))
        object.__setattr__(self, "peak", checked("f", peak))
        object.__setattr__(self, "along", None if along is None else numbers("f: along", along))

    def __repr__(self) -> str:
        return f"<gapsweep.{type(self).__name__}: peak {self.peak:g} N, {self.wave!r}>"

    def at(self, t: ArrayLike) -> Array:
        """Return the force [N] at times in forcing periods, or of a record at times [s]."""
        return self.peak * self.wave.at(t)

    def harmonics(self, mass: Array, damping: Array) -> tuple["ForceByPieces", ...]:
        """Return the load for matrices of a system, as the other kinds of loads do."""
        n = len(mass)
        if self.along is None and n > 1:
            raise ModelError(
                f"forcing = {self!r}: along is missing; write along={[1.0, *[0.0] * (n - 1)]}"
            )
        along = array("forcing: along", [1.0] if self.along is None else self.along, (n,))
        return (ForceByPieces(self.wave, self.peak, along),)


def check_periodic(model: Any) -> None:
    """Raise a `ModelError` if a load of an oscillator or a system is a record."""
    loads = [model] if hasattr(model, "wave") else model.forcing
    waves = [getattr(load, "wave", None) for load in loads]
    if any(wave is not None and wave.in_seconds for wave in waves):
        raise ModelError(
            "forcing: a gapsweep.Record has no period, so that responses to it are not steady: use "
            "gs.simulate, or a gs.PeriodicForce"
        )


@called_as("gs.PeriodicForce([0.0, 0.25, 0.75], [2.0, 0.0, -2.0]): fractions of a period, and N")
@dataclass(frozen=True, init=False, repr=False, eq=False)
class PeriodicForce(ForceByPieces):
    """A periodic force: straight lines between the points of a table, or a function of time.

    Parameters
    ----------
    t : array_like, shape (n,)
        Times of a table in fractions of the forcing period, ascending from 0; two equal times are a
        jump. If the last time is below 1, the force returns to ``f[0]`` at 1; otherwise ``f[-1]``
        is its value just before the period ends, and the force jumps if it differs from ``f[0]``.
        For a function the times of its kinks and jumps, ``[0.0]`` if there are none.
    f : array_like, shape (n,), or callable
        Forces [N], or a function of one time that returns a force. The function is replaced by
        polynomials of degree 7, with an error of about 1e-13 of the largest force.
    along : array_like, shape (n,), optional
        Direction of the force in a system [-].
    period : float
        Period in which times are given, ``> 0``; 1 by default. With ``period=0.02`` they are in
        seconds, of a period measured at 50 Hz. A model repeats the force at its own `omega`.

    Raises
    ------
    ModelError
        If times or forces are no table of one period, or a function has other kinks.

    Examples
    --------
    >>> import gapsweep as gs
    >>> triangle = gs.PeriodicForce([0.0, 0.5], [2.0, -2.0])
    >>> triangle.at([0.0, 0.125, 0.5, 1.25]).tolist()
    [2.0, 1.0, -2.0, 0.0]
    >>> oscillator = gs.Oscillator(mass=12.0, omega_n=18.0, zeta=0.02, forcing=triangle)
    >>> gs.respond(oscillator, gs.Piecewise(1e5, gs.Gap(1e-3, 1e-3)), omega=9.0).status.label
    'ok'
    """

    def __init__(
        self,
        t: ArrayLike,
        f: ArrayLike | Callable[[float], float],
        along: ArrayLike | None = None,
        period: float = 1.0,
    ) -> None:
        period = checked("forcing: period", period, low=0.0, strict=True)
        turns = _turns(t, period)
        if callable(f):
            ends, pieces, peak = _of_function(lambda turn: f(turn * period), turns)
        else:
            force = _forces(f, turns)
            if turns[-1] < 1.0:
                turns, force = np.append(turns, 1.0), np.append(force, force[0])
            ends, pieces, peak = _lines(turns, force)
        self._set(ends, pieces, peak, along, in_seconds=False)

    @classmethod
    def from_csv(
        cls, path: str | PathLike[str], along: ArrayLike | None = None, period: float = 1.0
    ) -> "PeriodicForce":
        """Return the force of a text file with the columns time and force; see `Record.from_csv`.

        The times are fractions of a period, or seconds of a period given as `period`.
        """
        return cls(*cls.points_of(path, period), along)

    @staticmethod
    def points_of(path: str | PathLike[str], period: float = 1.0) -> tuple[Array, Array]:
        """Return the points of a text file: fractions of a period, and forces [N]."""
        period = checked("forcing: period", period, low=0.0, strict=True)
        t, force = _columns(path, "s" if period != 1.0 else "1")
        return _turns(t, period), force


@called_as("gs.Switched([0.0, 0.25, 0.75], [5.0, -5.0, 5.0]): fractions of a period, and N")
@dataclass(frozen=True, init=False, repr=False, eq=False)
class Switched(ForceByPieces):
    """A periodic force that is switched between levels.

    Parameters
    ----------
    t : array_like, shape (n,)
        Times at which the levels begin, in fractions of the forcing period, ascending from 0.
    f : array_like, shape (n,)
        Levels [N]; the last one lasts until the period ends.
    along : array_like, shape (n,), optional
        Direction of the force in a system [-].

    Examples
    --------
    >>> import gapsweep as gs
    >>> square = gs.Switched([0.0, 0.25, 0.75], [5.0, -5.0, 5.0])  # the sign of a cosine
    >>> square.at([0.1, 0.25, 0.9]).tolist()
    [5.0, -5.0, 5.0]
    """

    def __init__(self, t: ArrayLike, f: ArrayLike, along: ArrayLike | None = None) -> None:
        turns = _turns(t, 1.0)
        force = _forces(f, turns)
        ends = np.append(turns[1:], 1.0)
        keeps = ends > turns
        self._set(ends[keeps], force[keeps, None], np.abs(force).max(), along, in_seconds=False)


@called_as("gs.Record([0.0, 0.1, 0.2], [0.0, 3.0, 1.0]): times in s, forces in N")
@dataclass(frozen=True, init=False, repr=False, eq=False)
class Record(ForceByPieces):
    """A measured force, as straight lines between its points; for `simulate` only.

    Before and after the record the force keeps its first and its last value.

    Parameters
    ----------
    t : array_like, shape (n,)
        Times [s], ascending; two equal times are a jump. 2 to 100,000 values.
    f : array_like, shape (n,)
        Forces [N].
    along : array_like, shape (n,), optional
        Direction of the force in a system [-].

    Raises
    ------
    ModelError
        If times or forces are no record.

    Examples
    --------
    >>> import gapsweep as gs
    >>> record = gs.Record([0.0, 0.5, 2.0], [0.0, 3.0, 0.0])
    >>> oscillator = gs.Oscillator(mass=12.0, omega_n=18.0, zeta=0.02, forcing=record)
    >>> run = gs.simulate(oscillator, gs.Piecewise(1e5, gs.Gap(1e-4, 1e-4)), t_end=2.0)
    >>> run.status.label
    'ok'
    """

    def __init__(self, t: ArrayLike, f: ArrayLike, along: ArrayLike | None = None) -> None:
        times = _times("t", t)
        force = _forces(f, times)
        if times.size < 2:
            raise ModelError(f"t: has {times.size} times, must have 2 or more")
        ends, pieces, peak = _lines(times, force)
        outside = np.zeros((2, pieces.shape[1]))
        outside[:, 0] = force[[0, -1]]
        pieces = np.concatenate([outside[:1], pieces, outside[1:]])
        self._set([times[0], *ends, math.inf], pieces, peak, along, in_seconds=True)

    @classmethod
    def from_csv(cls, path: str | PathLike[str], along: ArrayLike | None = None) -> "Record":
        """Return the record of a text file: times and forces in its first two columns.

        Columns are separated by commas, semicolons or blanks. A line of words at the top may have
        units, as ``time [ms], force (kN)`` or ``time_ms, force_kN``; without units they are s and
        N. Lines that begin with ``#`` are skipped.

        Raises
        ------
        ModelError
            If the file cannot be read, is no table, or has units of other dimensions.
        """
        return cls(*_columns(path, "s"), along)


def _columns(path: str | PathLike[str], of_time: str) -> tuple[Array, Array]:
    """Return times and forces of a file in SI units; `of_time` is the unit of times."""
    found = read_columns(path)
    several = []
    for place, (name, units) in enumerate((("time", of_time), ("force", "N"))):
        values = found.numbers(place)
        try:
            factor = factor_of(str(path), found.title(place), name, units)
        except ModelError as error:
            remedy = "; give the period [s], as period=0.02" if units == "1" else ""
            raise ModelError(f"{error}{remedy}") from None
        several.append(values * (1.0 if factor is None else factor))
    t, force = several
    return t, force


def _times(name: str, t: ArrayLike) -> Array:
    times = numbers(name, t, "a list of times")
    if times.ndim != 1 or not 1 <= times.size <= MAX_KNOTS:
        raise ModelError(f"{name}: has the shape {times.shape}, must be 1 to {MAX_KNOTS} times")
    _check_finite(name, times)
    (falls,) = np.nonzero(np.diff(times) < 0.0)
    for i in falls[:1].tolist():
        raise ModelError(
            f"{name}[{i + 1}] = {times[i + 1]:g}: must be >= {name}[{i}] = {times[i]:g}; sort the "
            "times"
        )
    return times


def _turns(t: ArrayLike, period: float) -> Array:
    """Return times as fractions of a period."""
    turns = _times("t", t) / period
    if turns[0] != 0.0:
        raise ModelError(f"t[0] = {turns[0] * period:g}: must be 0, where a period begins")
    if turns[-1] > 1.0 + _SAME_TIME:
        remedy = "divide times by the period, or give it, as period=0.02"
        raise ModelError(
            f"t[{turns.size - 1}] = {turns[-1] * period:g}: must be <= {period:g}, one period; "
            f"{remedy}"
        )
    turns[turns > 1.0 - _SAME_TIME] = 1.0
    return turns


def _forces(f: ArrayLike, t: Array) -> Array:
    force = numbers("f", f, "a list of forces")
    if force.shape != t.shape:
        raise ModelError(f"f: has the shape {force.shape}, must be {t.shape}: a force for each t")
    _check_finite("f", force)
    return force


def _check_finite(name: str, found: Array) -> None:
    for i in np.flatnonzero(~(np.abs(found) <= LARGEST))[:1].tolist():
        raise ModelError(f"{name}[{i}] = {found[i]}: must be finite; leave the point out")


def _lines(t: Array, f: Array) -> tuple[Array, Array, float]:
    """Return ends, coefficients and largest modulus of the straight lines between points."""
    length = np.diff(t)
    keeps = length > 0.0
    slope = np.diff(f)[keeps] / length[keeps]
    return t[1:][keeps], np.stack([f[1:][keeps], slope], axis=1), float(np.abs(f).max())


def _of_function(f: Callable[[float], Any], kinks: Array) -> tuple[Array, Array, float]:
    """Return ends, coefficients and largest modulus of polynomials that replace a function.

    Each interval between kinks is halved until polynomials through Chebyshev nodes meet the
    function between the nodes.
    """
    # Inside of a piece only: at its ends the function may have the value of another branch.
    nodes, tests = (-np.cos(np.pi * (np.arange(n) + 0.5) / n) for n in (N_TERMS, 2 * N_TERMS + 1))
    peak = float(np.abs(_values(f, (np.arange(997) + 0.5) / 997)).max())
    bounds = np.unique(np.append(kinks, 1.0)).tolist()
    todo = [*pairwise(bounds)][::-1]
    least = [_LEAST * (end - begin) for begin, end in todo]
    found: list[tuple[float, Any]] = []
    while todo:
        begin, end = todo.pop()
        middle, half = 0.5 * (begin + end), 0.5 * (end - begin)
        there = _values(f, middle + half * nodes)
        fitted = np.polynomial.chebyshev.chebfit(nodes, there, N_TERMS - 1)
        between = _values(f, middle + half * tests)
        error = np.abs(np.polynomial.chebyshev.chebval(tests, fitted) - between).max()
        peak = max(peak, float(np.abs(between).max()))
        if error > max(_TOLERANCE * peak, 4.0 * np.spacing(peak)):
            if half < 0.5 * max(least) or len(found) + len(todo) > MAX_KNOTS:
                raise ModelError(
                    f"f: has a kink or a jump at t = {middle:.6g} periods, or is not smooth; add "
                    "the time to t"
                )
            todo += [(middle, end), (begin, middle)]
            continue
        powers = np.polynomial.chebyshev.Chebyshev(fitted, domain=[begin - end, 0.0])
        found.append((end, powers.convert(kind=np.polynomial.Polynomial).coef))
    ends, pieces = zip(*found, strict=True)
    table = np.zeros((len(pieces), N_TERMS))
    for row, piece in zip(table, pieces, strict=True):
        row[: len(piece)] = piece
    return np.array(ends), table, peak


def _values(f: Callable[[float], Any], t: Array) -> Array:
    try:
        found = [f(each) for each in t.tolist()]
    except Exception as error:  # the user's code may raise anything
        raise ModelError(f"f: {described(error)}") from None
    return np.array([checked("f(t)", each) for each in found])
