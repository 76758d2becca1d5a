"""Assemble the cached results of a study into `responses.nc` and `attractors.nc`.

The files are exports: they can be written again from the cache at any time and are then
identical but for their file-level provenance. Results go to their place by position, piece
by piece (some frequencies of one representation, stiffness and gap), so that memory stays
small. Attractors are a property of a scene, not of a point: they are grouped here, from all
starts of a scene.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from gapsweep.execution.plan import Plan
from gapsweep.response.attractors import Attractor, attractors_of_scenes
from gapsweep.response.result import ResponseClass, Responses
from gapsweep.status import Status
from gapsweep.store.cache import Cache, Row
from gapsweep.store.netcdf import writing
from gapsweep.study.fingerprint import numerics_fingerprint
from gapsweep.study.points import FIXED
from gapsweep.study.schema import (
    ATTRACTOR,
    ATTRACTOR_VARIABLES,
    COORDINATES,
    EXTREMUM,
    LISTS,
    MULTIPLIER,
    MULTIPLIERS,
    N_ATTRACTORS,
    POINT_DIMS,
    SECTION_POINT,
    VARIABLES,
    Variable,
)
from gapsweep.study.study import Grid, Selection, Study

Arrays = dict[str, NDArray[Any]]

SCENE_DIMS = POINT_DIMS[:4]
# Sweep points in memory, and in a chunk of the file, at a time.
_PIECE = 4096


@dataclass(frozen=True, slots=True)
class Piece:
    """Some neighbouring frequencies of one representation, stiffness and gap.

    Attributes
    ----------
    position : tuple of int
        Representation, stiffness and gap.
    first, last : int
        Frequencies, one past the last.
    """

    position: tuple[int, ...]
    first: int
    last: int

    @property
    def cells(self) -> tuple[Any, ...]:
        """Where the piece lies in a variable over the grid."""
        return (*self.position, slice(self.first, self.last))

    def __len__(self) -> int:
        return self.last - self.first


def export(
    study: Study,
    plan: Plan,
    cache: Cache,
    responses: Path,
    attractors: Path,
    *,
    selection: Selection | None = None,
    made_from: str = "",
) -> None:
    """Write both files from the cache.

    Parameters
    ----------
    selection : Selection, optional
        Part of the study to write; attractors are then those of the selected starts.
    made_from : str
        Kept in the files' attribute `made_from`.

    Raises
    ------
    StoreError
        If a file cannot be written.
    """
    layout = _Layout.of(study, plan, selection)
    attributes = _attributes(study) | {"made_from": made_from}
    hosts: list[str] = []
    versions: set[str] = set()
    found: list[tuple[Piece, Arrays]] = []
    with writing(responses, attributes) as dataset:
        _define(dataset, layout)
        for piece in layout.pieces():
            if not layout.grid.requested[piece.cells].any():
                continue
            rows, at = layout.rows(piece, cache)
            versions.update(row.versions for row in rows)
            values = _point_arrays(layout, piece, rows, at, hosts)
            found.append((piece, _group(study, layout, piece, rows, at, values["attractor"])))
            _write(dataset, piece, values)
        _set_flags(dataset["host"], tuple((name, i) for i, name in enumerate(hosts)))
        dataset.computed_with = "; ".join(sorted(versions - {""}))
    with writing(attractors, attributes) as dataset:
        _define_attractors(dataset, layout, found)
        for piece, values in found:
            _write(dataset, piece, _padded(dataset, values))


def _attributes(study: Study) -> dict[str, str]:
    return {
        "title": study.title,
        "study": study.name,
        "study_json": study.json,
        "numerics_fingerprint": numerics_fingerprint(),
    }


@dataclass(frozen=True, slots=True)
class _Layout:
    """Where in the files the points of a plan belong.

    Attributes
    ----------
    grid : Grid
        What is written.
    cells, keys
        Flat position in that grid, ascending, of every point written, and its key.
    sizes : dict of str to int
        Lengths of the padded lists.
    """

    grid: Grid
    cells: NDArray[np.int64]
    keys: list[bytes]
    sizes: dict[str, int]

    @classmethod
    def of(cls, study: Study, plan: Plan, selection: Selection | None) -> "_Layout":
        grid = study.grid if selection is None else study.grid.cut(selection)
        cells = plan.cells
        if selection is not None:
            places = np.full(plan.shape, -1)
            places[np.ix_(*selection.positions)] = np.arange(grid.requested.size).reshape(
                grid.shape
            )
            cells = places.ravel()[cells]
        order = np.argsort(cells, kind="stable")
        order = order[cells[order] >= 0]
        sizes = {
            EXTREMUM: study.steady.max_extrema,
            SECTION_POINT: study.steady.max_period_multiple,
        }
        return cls(grid, cells[order], [plan.keys[i] for i in order.tolist()], sizes)

    @property
    def n_frequencies(self) -> int:
        """Frequencies in a piece."""
        *_, n_omega, n_starts = self.grid.shape
        return max(1, min(n_omega, _PIECE // n_starts))

    def pieces(self) -> Iterator[Piece]:
        *scenes, n_omega, _ = self.grid.shape
        for position in np.ndindex(*scenes):
            for first in range(0, n_omega, self.n_frequencies):
                yield Piece(position, first, min(first + self.n_frequencies, n_omega))

    def rows(self, piece: Piece, cache: Cache) -> tuple[list[Row], NDArray[np.int64]]:
        """Stored results of a piece, and the frequency and start of each, shape (2, n)."""
        n_starts = self.grid.shape[4]
        r, k, g = piece.position
        start = self.grid.flat((r, k, g, piece.first, 0))
        ends = np.searchsorted(self.cells, (start, start + len(piece) * n_starts))
        here = range(*ends.tolist())
        stored = cache.rows([self.keys[i] for i in here])
        places = [i for i in here if self.keys[i] in stored]
        at = np.array(np.divmod(self.cells[places] - start, n_starts))
        return [stored[self.keys[i]] for i in places], at


def _point_arrays(
    layout: _Layout, piece: Piece, rows: list[Row], at: NDArray[np.int64], hosts: list[str]
) -> Arrays:
    """Values of all variables of `responses.nc` over a piece; attractors not yet numbered."""
    requested = layout.grid.requested[piece.cells]
    shape = requested.shape
    values = {name: np.full(shape, v.missing, v.dtype) for name, v in VARIABLES.items()}
    # Unless a result follows:
    values["status"][requested] = Status.INTERRUPTED
    values["response_class"][requested] = ResponseClass.FAILED
    for name in VARIABLES:
        if name not in ("host", "attractor"):
            values[name][*at] = [getattr(row.response, name) for row in rows]
    for row in rows:
        if row.host and row.host not in hosts:
            hosts.append(row.host)
    values["host"][*at] = [hosts.index(row.host) if row.host else -1 for row in rows]
    lists: dict[str, Sequence[Sequence[float]]] = {
        "extrema": [row.response.extrema for row in rows],
        "extremum_kind": [row.response.extremum_kind for row in rows],
        "section_x": [row.response.section[::2] for row in rows],
        "section_v": [row.response.section[1::2] for row in rows],
    }
    for name, (dimension, variable) in LISTS.items():
        full = np.full((*shape, layout.sizes[dimension]), variable.missing, variable.dtype)
        full[*at] = _ragged(lists[name], full[*at])
        values[name] = full
    return values


def _ragged(lists: Sequence[Sequence[float]], padding: NDArray[Any]) -> NDArray[Any]:
    """Lists of different lengths as the rows of an array, the rest as in `padding`."""
    lengths = np.array([len(values) for values in lists], dtype=np.int64)
    filled = np.arange(padding.shape[1]) < lengths[:, None]
    padding[filled] = list(chain.from_iterable(lists))
    return padding


def _group(
    study: Study,
    layout: _Layout,
    piece: Piece,
    rows: list[Row],
    at: NDArray[np.int64],
    ids: NDArray[np.int32],
) -> Arrays:
    """Attractors of every frequency of a piece; their numbers go into `ids`."""
    *_, g = piece.position
    grid = layout.grid
    fixed = [start.kind == FIXED for start in grid.starts]
    responses = Responses.of([row.response for row in rows])
    all_of_them = attractors_of_scenes(
        responses,
        at[0],
        omega=grid.omega[piece.first : piece.last],
        symmetric=grid.gaps[g].is_symmetric,
        counted=np.array(fixed)[at[1]],
    )
    ids[*at] = all_of_them.numbers
    found: dict[int, list[Attractor]] = {}
    listed = all_of_them.listed(responses)
    for w, attractor in zip(all_of_them.scene.tolist(), listed, strict=True):
        found.setdefault(w, []).append(attractor)
    return _attractor_arrays(found, len(piece))


def _attractor_arrays(found: dict[int, list[Attractor]], n_omega: int) -> Arrays:
    """Attractors of a piece, no larger than they must be."""
    most = max((len(members) for members in found.values()), default=0)
    longest = max(
        (len(a.response.section) // 2 for members in found.values() for a in members), default=0
    )
    values: Arrays = {
        name: np.full((n_omega, most), v.missing, v.dtype)
        for name, v in ATTRACTOR_VARIABLES.items()
    }
    for name in MULTIPLIERS:
        values[name] = np.full((n_omega, most, 2), np.nan)
    for name in ("section_x", "section_v"):
        values[name] = np.full((n_omega, most, longest), np.nan)
    values["n_attractors"] = np.zeros(n_omega, N_ATTRACTORS.dtype)
    for w, members in found.items():
        values["n_attractors"][w] = len(members)
        for number, attractor in enumerate(members):
            _place_attractor(values, (w, number), attractor)
    return values


def _place_attractor(values: Arrays, at: tuple[int, int], attractor: Attractor) -> None:
    response = attractor.response
    for name in ATTRACTOR_VARIABLES:
        values[name][at] = getattr(attractor if hasattr(attractor, name) else response, name)
    for name, parts in (
        ("multiplier_real", response.multipliers[::2]),
        ("multiplier_imag", response.multipliers[1::2]),
        ("section_x", response.section[::2]),
        ("section_v", response.section[1::2]),
    ):
        values[name][at][: len(parts)] = parts


def _padded(dataset: netCDF4.Dataset, values: Arrays) -> Arrays:
    """Attractors of a piece, filled up to the dimensions of the file."""
    padded = {}
    for name, given in values.items():
        missing = ATTRACTOR_VARIABLES[name].missing if name in ATTRACTOR_VARIABLES else np.nan
        shape = (given.shape[0], *dataset[name].shape[len(SCENE_DIMS) :])
        padded[name] = np.full(shape, missing if given.ndim > 1 else 0, given.dtype)
        padded[name][tuple(slice(n) for n in given.shape)] = given
    return padded


def _write(dataset: netCDF4.Dataset, piece: Piece, values: Arrays) -> None:
    for name, value in values.items():
        dataset[name][piece.cells] = value


def _define(dataset: netCDF4.Dataset, layout: _Layout) -> None:
    _define_coordinates(dataset, layout.grid, POINT_DIMS)
    for name, size in layout.sizes.items():
        dataset.createDimension(name, size)
    chunk = (1, 1, 1, layout.n_frequencies, layout.grid.shape[4])
    for name, variable in VARIABLES.items():
        _create(dataset, name, variable, POINT_DIMS, chunk)
    for name, (dimension, variable) in LISTS.items():
        shape = (*chunk, layout.sizes[dimension])
        _create(dataset, name, variable, (*POINT_DIMS, dimension), shape)
    _name_auxiliary(dataset, POINT_DIMS)


def _define_attractors(
    dataset: netCDF4.Dataset, layout: _Layout, found: list[tuple[Piece, Arrays]]
) -> None:
    _define_coordinates(dataset, layout.grid, SCENE_DIMS)
    most = max((values["x_max"].shape[1] for _, values in found), default=1)
    sizes = {
        ATTRACTOR: max(most, 1),
        MULTIPLIER: 2,
        SECTION_POINT: layout.sizes[SECTION_POINT],
    }
    for name, size in sizes.items():
        dataset.createDimension(name, size)
    scene_chunk = (1, 1, 1, layout.n_frequencies)
    _create(dataset, "n_attractors", N_ATTRACTORS, SCENE_DIMS, scene_chunk)
    dimensions, chunk = (*SCENE_DIMS, ATTRACTOR), (*scene_chunk, sizes[ATTRACTOR])
    for name, variable in ATTRACTOR_VARIABLES.items():
        _create(dataset, name, variable, dimensions, chunk)
    for name, variable in MULTIPLIERS.items():
        _create(dataset, name, variable, (*dimensions, MULTIPLIER), (*chunk, 2))
    for name in ("section_x", "section_v"):
        last, variable = LISTS[name]
        _create(dataset, name, variable, (*dimensions, last), (*chunk, sizes[last]))
    _name_auxiliary(dataset, SCENE_DIMS)


def _define_coordinates(dataset: netCDF4.Dataset, grid: Grid, dimensions: tuple[str, ...]) -> None:
    for name, size in zip(POINT_DIMS, grid.shape, strict=True):
        if name in dimensions:
            dataset.createDimension(name, size)
    values = _coordinate_values(grid)
    for name, (dimension, variable) in COORDINATES.items():
        if dimension in dimensions:
            _create(dataset, name, variable, (dimension,), None)
            dataset[name][:] = values[name]


def _name_auxiliary(dataset: netCDF4.Dataset, dimensions: tuple[str, ...]) -> None:
    """CF: data variables name the coordinates that are no dimension."""
    auxiliary = [n for n, (d, _) in COORDINATES.items() if n != d and d in dimensions]
    for name, variable in dataset.variables.items():
        if name not in COORDINATES:
            variable.coordinates = " ".join(auxiliary)


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
    _set_flags(created, variable.flags)


def _set_flags(variable: Any, flags: tuple[tuple[str, int], ...]) -> None:
    if flags:
        variable.flag_values = np.array([value for _, value in flags], dtype=variable.dtype)
        # CF separates meanings by blanks.
        variable.flag_meanings = " ".join(meaning.replace(" ", "_") for meaning, _ in flags)


def _coordinate_values(grid: Grid) -> dict[str, NDArray[Any]]:
    fixed = [start.kind == FIXED for start in grid.starts]
    states = np.array([(start.x_0, start.v_0) for start in grid.starts])
    states[~np.array(fixed)] = np.nan
    return {
        "representation": np.array(grid.representations, dtype=object),
        "K_c": np.array(grid.K_c),
        "gap": np.array([gap.label for gap in grid.gaps], dtype=object),
        "j_1": np.array([gap.j_1 for gap in grid.gaps]),
        "j_2": np.array([gap.j_2 for gap in grid.gaps]),
        "omega": np.array(grid.omega),
        "initial_condition": np.arange(len(grid.starts)),
        "x_0": states[:, 0],
        "v_0": states[:, 1],
        "start": np.array([start.kind for start in grid.starts], dtype=object),
    }
