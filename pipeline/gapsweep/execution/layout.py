"""Where in the files of a run the points of a grid belong, and what these files hold."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from gapsweep.response.result import Steady
from gapsweep.study.grid import START, Grid
from gapsweep.study.schema import (
    ATTRACTOR,
    ATTRACTOR_VARIABLES,
    COORDINATES,
    EXTREMUM,
    LISTS,
    MULTIPLIER,
    MULTIPLIERS,
    N_ATTRACTORS,
    SECTION,
    SECTION_POINT,
    VARIABLES,
    Variable,
    coordinates,
)

Arrays = dict[str, NDArray[Any]]

# Sweep points in memory, and in a chunk of the file, at a time.
_PIECE = 4096
# Attractors of a scene in a chunk: few have more.
_ATTRACTORS = 4


# Where in a variable over the grid some neighbouring points lie: whole scenes, with all starts.
Piece = tuple[slice, ...]


@dataclass(frozen=True)
class Layout:
    """How the points of a grid lie in the files.

    Attributes
    ----------
    grid : Grid
    sizes : dict of str to int
        Lengths of the padded lists.
    """

    grid: Grid
    sizes: dict[str, int]

    @classmethod
    def of(cls, grid: Grid, steady: Steady) -> "Layout":
        sizes = {EXTREMUM: steady.max_extrema, SECTION_POINT: steady.max_period_multiple}
        return cls(grid, sizes)

    @property
    def chunk(self) -> tuple[int, ...]:
        """Sizes of a chunk of a variable over the grid: starts first, then frequencies."""
        sizes, room = {}, _PIECE
        for dim in sorted(self.grid.dims[::-1], key=lambda dim: (dim != START, dim != "omega")):
            sizes[dim] = max(1, min(len(self.grid.axes[dim]), room))
            room //= sizes[dim]
        return tuple(sizes[dim] for dim in self.grid.dims)

    def pieces(self) -> Iterator[Piece]:
        """Pieces of the grid, as large as a chunk, but with all starts."""
        *sizes, _ = zip(self.grid.shape, self.chunk, strict=True)
        parts = ([slice(i, min(i + k, n)) for i in range(0, n, k)] for n, k in sizes)
        yield from product(*parts, [slice(0, len(self.grid.starts))])

    def omega(self, piece: Piece) -> NDArray[np.float64]:
        """Forcing frequency of every scene of a piece [Hz], flat."""
        return self._over(piece, "omega", self._coordinates["omega"])

    def is_symmetric(self, piece: Piece) -> NDArray[np.bool_]:
        """Whether both walls are equally far from the origin and equally stiff, in every scene of a
        piece, flat.
        """
        along = coordinates(self.grid.dims)
        j_1, j_2, *ratio = (
            self._over(piece, along[name], self._coordinates[name])
            for name in ("j_1", "j_2", "K_ratio")
            if name in along
        )
        return np.asarray((j_1 == j_2) & (ratio[0] == 1.0 if ratio else True))

    @cached_property
    def _coordinates(self) -> Arrays:
        return self.grid.coordinates()

    def _over(self, piece: Piece, dim: str, values: NDArray[Any]) -> NDArray[Any]:
        """Values along a dimension, for every scene of a piece, flat."""
        axis = self.grid.dims.index(dim)
        shape = [part.stop - part.start for part in piece[:-1]]
        along = np.expand_dims(values[piece[axis]], [i for i in range(len(shape)) if i != axis])
        return np.broadcast_to(along, shape).ravel()

    def starts(self) -> Iterator[slice]:
        """Parts of all starts that are written at a time."""
        n_starts = len(self.grid.starts)
        for first in range(0, n_starts, _PIECE):
            yield slice(first, min(first + _PIECE, n_starts))


def define(dataset: netCDF4.Dataset, layout: Layout) -> None:
    """Dimensions, coordinates and variables of `responses.nc`."""
    dims, chunk = layout.grid.dims, layout.chunk
    _define_coordinates(dataset, layout.grid, dims)
    for name, size in layout.sizes.items():
        dataset.createDimension(name, size)
    for name, variable in VARIABLES.items():
        _create(dataset, name, variable, dims, chunk)
    for name, (dimension, variable) in LISTS.items():
        _create(dataset, name, variable, (*dims, dimension), (*chunk, layout.sizes[dimension]))
    _name_auxiliary(dataset, dims)


def define_attractors(dataset: netCDF4.Dataset, layout: Layout) -> None:
    """Dimensions, coordinates and variables of `attractors.nc`; it grows with their number."""
    scenes, chunk = layout.grid.dims[:-1], layout.chunk[:-1]
    _define_coordinates(dataset, layout.grid, scenes)
    sizes = {MULTIPLIER: 2, SECTION_POINT: layout.sizes[SECTION_POINT]}
    for name, size in {ATTRACTOR: None, **sizes}.items():
        dataset.createDimension(name, size)
    _create(dataset, "n_attractors", N_ATTRACTORS, scenes, chunk)
    dims, chunk = (*scenes, ATTRACTOR), (*chunk, min(len(layout.grid.starts), _ATTRACTORS))
    for name, variable in ATTRACTOR_VARIABLES.items():
        _create(dataset, name, variable, dims, chunk)
    for name, variable in MULTIPLIERS.items():
        _create(dataset, name, variable, (*dims, MULTIPLIER), (*chunk, 2))
    for name in SECTION:
        last, variable = LISTS[name]
        _create(dataset, name, variable, (*dims, last), (*chunk, sizes[last]))
    _name_auxiliary(dataset, scenes)


def _define_coordinates(dataset: netCDF4.Dataset, grid: Grid, dims: tuple[str, ...]) -> None:
    for name, size in zip(grid.dims, grid.shape, strict=True):
        if name in dims:
            dataset.createDimension(name, size)
    values = grid.coordinates()
    for name, dimension in coordinates(dims).items():
        variable = COORDINATES[name][1]
        _create(dataset, name, variable, (dimension,), None)
        is_text = variable.dtype == "str"
        dataset[name][:] = values[name].astype(object) if is_text else values[name]


def _name_auxiliary(dataset: netCDF4.Dataset, dims: tuple[str, ...]) -> None:
    """CF: data variables name the coordinates that are no dimension."""
    found = coordinates(dims)
    auxiliary = " ".join(name for name, dimension in found.items() if name != dimension)
    for name, variable in dataset.variables.items():
        if name not in found:
            variable.coordinates = auxiliary


def _create(
    dataset: netCDF4.Dataset,
    name: str,
    variable: Variable,
    dimensions: tuple[str, ...],
    chunk: tuple[int, ...] | None,
) -> None:
    if variable.dtype == "str":
        created = dataset.createVariable(name, str, dimensions)
    else:
        created = dataset.createVariable(
            name,
            variable.dtype,
            dimensions,
            fill_value=variable.missing if chunk else False,
            compression="zlib" if chunk else None,
            complevel=1,
            chunksizes=chunk,
            fletcher32=chunk is not None,
            chunk_cache=1,  # every chunk is written once: to keep it would only fill memory
        )
        if chunk:
            # Chunks never written read as missing; without the attribute integers stay integers.
            created.delncattr("_FillValue")
    created.units, created.long_name = variable.units, variable.long_name
    set_flags(created, variable.flags)


def set_flags(variable: Any, flags: tuple[tuple[str, int], ...]) -> None:
    """Meanings of the values of a flag variable."""
    if flags:
        variable.flag_values = np.array([value for _, value in flags], dtype=variable.dtype)
        # CF separates meanings by blanks.
        variable.flag_meanings = " ".join(meaning.replace(" ", "_") for meaning, _ in flags)
