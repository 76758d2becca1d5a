"""Layout of the files of a run: positions of the grid's points, dimensions and variables."""

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from gapsweep.response.disturbances import DISTURBANCES
from gapsweep.response.result import Steady, exists, sizes_of
from gapsweep.store.netcdf import create_texts
from gapsweep.study.grid import START, Grid
from gapsweep.study.samples import SAMPLE, Samples
from gapsweep.study.schema import (
    ATTRACTOR,
    ATTRACTOR_VARIABLES,
    N_ATTRACTORS,
    VARIABLES,
    Found,
    coordinates,
)
from gapsweep.variables import EXTREMUM, LAG, MULTIPLIER, SECTION_POINT, Variable

Arrays = dict[str, NDArray[Any]]

# Sweep points in memory, and in a chunk of the file, at a time.
PIECE = 4096
# Attractors of a parameter set in a chunk: few have more.
_ATTRACTORS = 4
# Items of a list in a chunk: chunks behind the longest list of their points are not written.
_ITEMS = 8


# Slices of a variable over the grid: neighbouring parameter sets with all initial conditions.
Piece = tuple[slice, ...]


@dataclass(frozen=True)
class Layout:
    """Positions of a grid's points in the files, and the variables of the files."""

    grid: Grid
    sizes: dict[str, int]  # lengths of the padded lists, and of the dimensions within a point
    # Labels of user tables with a force that is not odd in the displacement.
    uneven: Collection[str] = ()
    mean_load: float = 0.0  # mean load [N] of the model if it is not swept
    # Whether attractors have the smallest disturbances that leave them.
    has_disturbances: bool = False

    @classmethod
    def of(cls, grid: Grid, steady: Steady, **others: Any) -> "Layout":
        """The layout of a grid; `others` are further attributes."""
        return cls(grid, sizes_of(grid.structure, steady), **others)

    @property
    def variables(self) -> dict[str, Variable]:
        """Variables of `responses.nc`."""
        return self._described(VARIABLES)

    @property
    def attractor_variables(self) -> dict[str, Variable]:
        """Variables of `attractors.nc` over its attractors."""
        left_out = () if self.has_disturbances else DISTURBANCES
        return self._described({n: v for n, v in ATTRACTOR_VARIABLES.items() if n not in left_out})

    def coordinates(self, dims: Collection[str]) -> Found:
        """The coordinates of a dataset with these dimensions."""
        samples = self.grid.axes.get(SAMPLE)
        drawn = samples.numbers if isinstance(samples, Samples) else ()
        return coordinates(dims, self.grid.structure, self.grid.units, drawn)

    def _described(self, variables: Mapping[str, Variable]) -> dict[str, Variable]:
        """The variables that exist for the models, with their units where these are known."""
        structure = self.grid.structure
        return {
            name: variable.in_units(self.grid.units)
            for name, variable in variables.items()
            if exists(name, structure) and (structure.m or LAG not in variable.dims)
        }

    def within(self, variable: Variable) -> dict[str, int]:
        """Sizes of a variable's dimensions other than those of the grid, by name."""
        return {dim: self.sizes[dim] for dim in variable.dims if dim in self.sizes}

    @property
    def chunk(self) -> tuple[int, ...]:
        """Chunk sizes of a variable: large along initial conditions first, then frequencies."""
        sizes, room = {}, PIECE
        for dim in sorted(self.grid.dims[::-1], key=lambda dim: (dim != START, dim != "omega")):
            sizes[dim] = max(1, min(len(self.grid.axes[dim]), room))
            room //= sizes[dim]
        return tuple(sizes[dim] for dim in self.grid.dims)

    def pieces(self) -> Iterator[Piece]:
        """Pieces of the grid, as large as a chunk, but with all initial conditions."""
        *sizes, _ = zip(self.grid.shape, self.chunk, strict=True)
        parts = ([slice(i, min(i + k, n)) for i in range(0, n, k)] for n, k in sizes)
        yield from product(*parts, [slice(0, len(self.grid.starts))])

    def is_symmetric(self, piece: Piece) -> NDArray[np.bool_]:
        """Whether each parameter set of a piece is known to be symmetric under x to -x, flat.

        It is if both walls have the same distance and stiffness, no mean load acts, and the law is
        no uneven table. No set of a system or of a force by pieces is known to be symmetric.
        """
        if not self.grid.structure.is_odd:
            return np.zeros(math.prod(part.stop - part.start for part in piece[:-1]), bool)
        along = self.coordinates(self.grid.dims)

        def over(name: str, default: float) -> NDArray[np.float64] | float:
            if name not in along:
                return default
            return self._over(piece, along[name][0][0], self._coordinates[name])

        labels = self.grid.representations
        lopsided = [i for i, label in enumerate(labels) if label in self.uneven]
        own = np.isin(self._over(piece, "representation", np.arange(len(labels))), lopsided)
        are_equal = (over("j_1", 0.0) == over("j_2", 0.0)) & (over("K_ratio", 1.0) == 1.0)
        return np.asarray(are_equal & (over("mean_load", self.mean_load) == 0.0) & ~own)

    @cached_property
    def _coordinates(self) -> Arrays:
        return self.grid.coordinates()

    def places(self, piece: Piece) -> dict[str, NDArray[np.intp]]:
        """Positions of a piece's parameter sets on every axis but initial conditions, flat."""
        dims = self.grid.dims[:-1]
        return {dim: self._over(piece, dim, np.arange(len(self.grid.axes[dim]))) for dim in dims}

    def _over(self, piece: Piece, dim: str, values: NDArray[Any]) -> NDArray[Any]:
        """Values along a dimension, for every parameter set of a piece, flat."""
        axis = self.grid.dims.index(dim)
        shape = [part.stop - part.start for part in piece[:-1]]
        along = np.expand_dims(values[piece[axis]], [i for i in range(len(shape)) if i != axis])
        return np.broadcast_to(along, shape).ravel()

    def starts(self) -> Iterator[slice]:
        """Slices of the initial conditions, each written at a time."""
        n_starts = len(self.grid.starts)
        for first in range(0, n_starts, PIECE):
            yield slice(first, min(first + PIECE, n_starts))


def define(dataset: netCDF4.Dataset, layout: Layout) -> None:
    """Create dimensions, coordinates and variables of `responses.nc`."""
    dims, chunk = layout.grid.dims, layout.chunk
    _define_coordinates(dataset, layout, dims)
    for name in (EXTREMUM, SECTION_POINT):
        dataset.createDimension(name, layout.sizes[name])
    for name, variable in layout.variables.items():
        _create(dataset, layout, name, variable, dims, chunk)
    _name_auxiliary(dataset, layout, dims)


def define_attractors(dataset: netCDF4.Dataset, layout: Layout) -> None:
    """Create dimensions, coordinates and variables of `attractors.nc`, unlimited in attractors."""
    scenes, chunk = layout.grid.dims[:-1], layout.chunk[:-1]
    _define_coordinates(dataset, layout, scenes)
    for name, size in {**layout.sizes, ATTRACTOR: None}.items():
        if name in (MULTIPLIER, SECTION_POINT, ATTRACTOR):
            dataset.createDimension(name, size)
    _create(dataset, layout, "n_attractors", N_ATTRACTORS, scenes, chunk)
    dims, chunk = (*scenes, ATTRACTOR), (*chunk, min(len(layout.grid.starts), _ATTRACTORS))
    for name, variable in layout.attractor_variables.items():
        _create(dataset, layout, name, variable, dims, chunk)
    _name_auxiliary(dataset, layout, scenes)


def _define_coordinates(dataset: netCDF4.Dataset, layout: Layout, dims: tuple[str, ...]) -> None:
    grid = layout.grid
    for name, size in zip(grid.dims, grid.shape, strict=True):
        if name in dims:
            dataset.createDimension(name, size)
    for name, names in grid.parts.items():
        dataset.createDimension(name, len(names))
    values = grid.coordinates()
    for name, (along, variable) in layout.coordinates(dims).items():
        if variable.dtype == "str":
            _describe(create_texts(dataset, name, along, values[name]), variable)
        else:
            _create(dataset, layout, name, variable, along, None)
            dataset[name][:] = values[name]


def _name_auxiliary(dataset: netCDF4.Dataset, layout: Layout, dims: tuple[str, ...]) -> None:
    """Set the CF attribute ``coordinates``: auxiliary coordinates along a variable's dimensions."""
    found = layout.coordinates(dims)
    for name, variable in dataset.variables.items():
        if name not in found:
            variable.coordinates = " ".join(
                other
                for other, (along, _) in found.items()
                if along != (other,) and {*along} <= {*variable.dimensions}
            )


def _create(
    dataset: netCDF4.Dataset,
    layout: Layout,
    name: str,
    variable: Variable,
    dimensions: tuple[str, ...],
    chunk: tuple[int, ...] | None,
) -> None:
    if chunk:
        within = layout.within(variable)
        dimensions, chunk = (
            (*dimensions, *within),
            (*chunk, *(min(n, _ITEMS) for n in within.values())),
        )
    created = dataset.createVariable(
        name,
        variable.dtype,
        dimensions,
        fill_value=variable.missing if chunk else False,
        compression="zlib" if chunk else None,
        complevel=1,
        chunksizes=chunk,
        fletcher32=chunk is not None,
        chunk_cache=1,  # every chunk is written once: a cache would only take memory
    )
    if chunk:
        # Chunks never written read as missing; without the attribute integers stay integers.
        created.delncattr("_FillValue")
    _describe(created, variable)


def _describe(created: "netCDF4.Variable[Any]", variable: Variable) -> None:
    if variable.units:
        created.units = variable.units
    created.long_name = variable.long_name
    set_flags(created, variable.flags)


def set_flags(variable: Any, flags: tuple[tuple[str, int], ...]) -> None:
    """Set the CF attributes for the values and meanings of a flag variable."""
    if flags:
        variable.flag_values = np.array([value for _, value in flags], dtype=variable.dtype)
        # CF separates meanings by blanks.
        variable.flag_meanings = " ".join(meaning.replace(" ", "_") for meaning, _ in flags)
