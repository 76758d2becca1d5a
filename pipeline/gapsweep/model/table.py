"""Contact law from measured forces at displacements, interpolated by a curve."""

from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gapsweep.errors import ModelError
from gapsweep.model.arrays import factor_of, numbers, read_columns
from gapsweep.model.contact import ContactLaw, checked_gap
from gapsweep.model.oscillator import LARGEST, Gap, called_as, checked

Array = NDArray[np.float64]

MAX_POINTS = 10_000
_LENGTHS = {"m": 1.0, "mm": 1e-3, "um": 1e-6}
_FORCES = {"N": 1.0, "mN": 1e-3, "kN": 1e3}
_X, _LOADS = ("m", "rad"), ("N", "N m")
_NO_WALL = 1e-12  # of the other chord's slope: the ratio of two needs both


@called_as(
    "gs.ForceTable(x=[-1e-3, 0.0, 1e-3], F=[-8.0, 0.0, 8.0]), or "
    "gs.ForceTable.from_csv('stop.csv', x='mm') for a file"
)
@dataclass(frozen=True, init=False, repr=False)
class ForceTable(ContactLaw):
    """A measured force curve, interpolated by monotone piecewise cubics.

    The curve (PCHIP: Fritsch & Butland, 1984) has a continuous slope, passes through every point
    and is monotone between neighbouring points: a range of zeros stays zero. Beyond the table it is
    extrapolated linearly, and a motion there gets the status ``out_of_fit_range``.

    Parameters
    ----------
    x : array_like, shape (n,)
        Displacements [m], ascending; their range contains 0. 2 to 10,000 values.
    F : array_like, shape (n,)
        Restoring forces on the mass at `x` [N].
    gap : Gap, optional
        Walls at which contacts are counted; by default the ends of the interval around x = 0 in
        which the forces are zero; without such an interval no gap.
    noise : float
        Largest force [N] that is measurement noise, ``>= 0``: in the interval around zero in which
        no force is larger, all forces are set to zero. The walls then lie ``noise / K_c`` further
        out than those of the noiseless force.

    Raises
    ------
    ModelError
        If the table is invalid.

    Notes
    -----
    `K_c` and `K_ratio` are the slopes of the chords from the walls to the ends of the table.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.ForceTable(x=[-1e-3, -0.4e-3, 0.4e-3, 1e-3], F=[-8.0, 0.0, 0.0, 8.0])
    >>> law.gap.label, law.force(1e-3).item()
    ('0.4/0.4', 8.0)
    """

    adds_walls: ClassVar[bool] = False

    x: tuple[float, ...]
    F: tuple[float, ...]

    def __init__(
        self, x: ArrayLike, F: ArrayLike, gap: Gap | None = None, noise: float = 0.0
    ) -> None:
        places, forces = _column("x", x), _column("F", F)
        _check(places, forces)
        quiet = _quiet(places, forces, checked("noise", noise, low=0.0))
        forces[quiet] = 0.0
        gap = _width(places[quiet]) if gap is None else checked_gap(gap)
        lower = _chord(-places[0] - gap.j_1, -forces[0])
        upper = _chord(places[-1] - gap.j_2, forces[-1]) or _NO_WALL * lower
        given: dict[str, Any] = {"x": tuple(places.tolist()), "F": tuple(forces.tolist())}
        given |= {"gap": gap, "K_c": upper, "K_ratio": lower / upper if upper else 1.0}
        for name, value in given.items():
            object.__setattr__(self, name, value)
        self.__post_init__()

    @classmethod
    def from_csv(
        cls,
        path: str | PathLike[str],
        x: str | None = None,
        force: str | None = None,
        gap: Gap | None = None,
        noise: float = 0.0,
    ) -> "ForceTable":
        """Return the table of a text file: displacements and forces in its first two columns.

        Columns are separated by commas, semicolons or blanks; lines of words at the top and lines
        that begin with ``#`` are skipped. Units of `x` are ``"m"``, ``"mm"``, ``"um"``, of `force`
        ``"N"``, ``"mN"``, ``"kN"``; None: the unit in the title of the column, as ``x [mm]``, or m
        and N. `gap` and `noise` are those of the class, in SI units.

        Raises
        ------
        ModelError
            If the file cannot be read or is no table, or a title has another unit.
        """
        for name, unit, known in (("x", x, _LENGTHS), ("force", force, _FORCES)):
            if unit is not None and (not isinstance(unit, str) or unit not in known):
                raise ModelError(f"{name} = {unit!r}: must be a unit: {', '.join(known)}")
        found = read_columns(path)
        places, forces = found.numbers(0), found.numbers(1)
        places *= _factor(path, found.title(0), "x", None if x is None else _LENGTHS[x], _X)
        given = None if force is None else _FORCES[force]
        forces *= _factor(path, found.title(1), "force", given, _LOADS)
        return cls(places, forces, gap, noise)

    def __repr__(self) -> str:
        low, high = self.valid_range
        return f"<gapsweep.ForceTable: {len(self.x)} points, {low:g}..{high:g} m>"

    def between(self, gap: Gap) -> "ForceTable":
        """Return the same table with other walls at which contacts are counted."""
        return ForceTable(self.x, self.F, gap)

    @property
    def is_symmetric(self) -> bool:
        return self.gap.is_symmetric and self.is_odd

    @property
    def is_odd(self) -> bool:
        """Whether ``F(-x) = -F(x)``."""
        mirrored = tuple(-x for x in reversed(self.x)), tuple(-f for f in reversed(self.F))
        return mirrored == (self.x, self.F)

    @property
    def valid_range(self) -> tuple[float, float]:
        return self.x[0], self.x[-1]

    @cached_property
    def pieces(self) -> Array:
        """Left end [m] and coefficients, highest power first, of every piece of the curve.

        Shape (n + 1, 5): the line below the table, the pieces, the line above it. A displacement
        lies in the piece whose index is the number of table points not above the displacement.
        """
        from scipy.interpolate import PchipInterpolator  # slow to import, and few laws are tables

        x, curve = self._places, PchipInterpolator(self.x, self.F)
        found = np.zeros((len(x) + 1, 5))
        found[:, 0] = x[[0, *range(len(x))]]
        found[1:-1, 1:] = curve.c.T
        found[[0, -1], 3] = curve.derivative()(x[[0, -1]])
        found[[0, -1], 4] = self.F[0], self.F[-1]
        return found

    @property
    def turns(self) -> tuple[float, ...]:
        """Displacements [m] where the sign of the slope changes, ends of plateaus included."""
        rises = np.sign(np.diff(self.F))
        return tuple(self._places[1:-1][rises[1:] != rises[:-1]].tolist())

    def force(self, x: ArrayLike, v: ArrayLike = 0.0) -> Array:
        d, c_3, c_2, c_1, c_0 = self._piece(x)
        return np.asarray(((c_3 * d + c_2) * d + c_1) * d + c_0)

    def derivative(self, x: ArrayLike, v: ArrayLike = 0.0) -> Array:
        d, c_3, c_2, c_1, _ = self._piece(x)
        return np.asarray((3.0 * c_3 * d + 2.0 * c_2) * d + c_1)

    def _piece(self, x: ArrayLike) -> Array:
        """Distance of `x` [m] from the lower end of its piece, and coefficients of the piece."""
        x = numbers("x", x)
        piece = self.pieces[np.searchsorted(self._places, x, side="right")]
        return np.stack([x - piece[..., 0], *np.moveaxis(piece[..., 1:], -1, 0)])

    @cached_property
    def _places(self) -> Array:
        return np.array(self.x)


def _column(name: str, values: ArrayLike) -> Array:
    found = numbers(name, values, "a list of numbers")
    if found.ndim != 1 or not 2 <= found.size <= MAX_POINTS:
        raise ModelError(
            f"{name}: has the shape {found.shape}, must be one column of 2 to {MAX_POINTS} numbers"
        )
    wrong = np.flatnonzero(~(np.abs(found) <= LARGEST))
    if wrong.size:
        raise ModelError(f"{name}[{wrong[0]}] = {found[wrong[0]]}: must be finite; leave it out")
    return found


def _factor(
    path: str | PathLike[str],
    title: str,
    name: str,
    given: float | None,
    units: tuple[str, str],
) -> float:
    """Return the factor of a column to SI units; `units` are those of a force and of a torque."""
    written = factor_of(str(path), title, name, *units)
    if None not in (given, written) and given != written:
        raise ModelError(
            f"{path}: column {title.strip()!r}: has another unit than the argument {name}; leave "
            "out one of both"
        )
    return next((each for each in (given, written) if each is not None), 1.0)


def _check(x: Array, force: Array) -> None:
    if x.size != force.size:
        raise ModelError(f"F: has {force.size} numbers, x has {x.size}: must be one for each")
    (falls,) = np.nonzero(np.diff(x) <= 0.0)
    if falls.size:
        i = falls[0]
        raise ModelError(
            f"x[{i + 1}] = {x[i + 1]:g}: must be > x[{i}] = {x[i]:g}; sort the table by x and "
            "take the mean of forces at the same place"
        )
    if not x[0] <= 0.0 <= x[-1]:
        raise ModelError(
            f"x: goes from {x[0]:g} to {x[-1]:g} m, must hold 0; add the points up to there, of "
            "force 0 where nothing touches"
        )


def _quiet(x: Array, force: Array, noise: float) -> slice:
    """Slice of the table points around zero at which no force is larger than the noise."""
    loud = np.flatnonzero(np.abs(force) > noise)
    below, above = loud[x[loud] <= 0.0], loud[x[loud] >= 0.0]
    return slice(below[-1] + 1 if below.size else 0, above[0] if above.size else x.size)


def _width(x: Array) -> Gap:
    """The gap with walls at the ends of an interval; zero gap if the interval excludes zero."""
    # Zero may be a single point without force, or lie between two with one.
    return Gap(0.0 - x[0], x[-1]) if x.size and x[0] <= 0.0 <= x[-1] else Gap(0.0, 0.0)


def _chord(length: float, force: float) -> float:
    return max(float(force / length), 0.0) if length > 0.0 else 0.0
