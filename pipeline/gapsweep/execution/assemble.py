"""Assemble the cached results of a study into `responses.nc` and `attractors.nc`.

The files are exports: they can be written again from the cache at any time and are then
identical but for their file-level provenance. Results go to their place by position, slab by
slab (one representation, stiffness and gap at a time), so that memory stays small. Attractors
are a property of a scene, not of a point: they are grouped here, from all starts of a scene.
"""

from itertools import groupby
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from gapsweep.execution.plan import Chain, Plan
from gapsweep.response.attractors import Attractor, attractors, numbers
from gapsweep.response.respond import Response
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
from gapsweep.study.study import Grid, Index, Study

Slab = dict[str, NDArray[Any]]
Position = tuple[int, int, int]
# Attractors of one slab, by frequency.
Found = dict[int, list[Attractor]]

SCENE_DIMS = POINT_DIMS[:4]
_NOISE_FACTOR = 20.0


def export(study: Study, plan: Plan, cache: Cache, responses: Path, attractors: Path) -> None:
    """Write both files from the cache.

    Raises
    ------
    StoreError
        If a file cannot be written.
    """
    found: dict[Position, Found] = {}
    grid = study.grid
    with writing(responses, _attributes(study)) as dataset:
        sizes = {EXTREMUM: study.steady.max_extrema}
        sizes[SECTION_POINT] = study.steady.max_period_multiple
        _define(dataset, grid, sizes)
        hosts: list[str] = []
        chains = {p: list(c) for p, c in groupby(plan.chains, lambda c: c.indices[0][:3])}
        for position in np.ndindex(*grid.shape[:3]):
            rows = _rows(chains.get(position, []), cache)
            slab = _empty_slab(grid.shape[3:], sizes)
            for index, row in rows.items():
                _place(slab, index[3:], row, hosts)
            found[position] = _group(study, rows, position, slab)
            _write_slab(dataset, position, slab)
        _set_flags(dataset["host"], tuple((name, i) for i, name in enumerate(hosts)))
    _export_attractors(study, found, attractors)


def _attributes(study: Study) -> dict[str, str]:
    return {
        "title": study.title,
        "study": study.name,
        "study_json": study.json,
        "numerics_fingerprint": numerics_fingerprint(),
        "source": "gapsweep",
    }


def _rows(chains: list[Chain], cache: Cache) -> dict[Index, Row]:
    """Stored results of some chains by position in the grid."""
    keys = [key for chain in chains for key in chain.keys]
    stored = cache.rows(keys)
    places = ((index, key) for c in chains for index, key in zip(c.indices, c.keys, strict=True))
    return {index: stored[key] for index, key in places if key in stored}


def _place(slab: Slab, at: tuple[int, ...], row: Row, hosts: list[str]) -> None:
    """Write one result into its cell."""
    response = row.response
    for name in VARIABLES:
        if name not in ("host", "attractor"):
            slab[name][at] = getattr(response, name)
    if row.host:
        if row.host not in hosts:
            hosts.append(row.host)
        slab["host"][at] = hosts.index(row.host)
    for name, values in _lists(response).items():
        slab[name][at][: len(values)] = values


def _lists(response: Response) -> Slab:
    section = np.reshape(response.section, (-1, 2))
    return {
        "extrema": np.array(response.extrema),
        "extremum_kind": np.array(response.extremum_kind),
        "section_x": section[:, 0],
        "section_v": section[:, 1],
    }


def _group(study: Study, rows: dict[Index, Row], position: Position, slab: Slab) -> Found:
    """Attractors of every frequency of a slab; their numbers go into the slab."""
    by_omega: dict[int, dict[int, Response]] = {}
    for index, row in rows.items():
        by_omega.setdefault(index[3], {})[index[4]] = row.response
    found: Found = {}
    for w, responses in by_omega.items():
        starts = sorted(responses)
        solver = study.point((*position, w, starts[0])).solver
        ordered = [responses[i] for i in starts]
        reach = max((abs(r.x_max) for r in ordered if np.isfinite(r.x_max)), default=0.0)
        found[w] = attractors(
            ordered,
            study.grid.omega[w],
            symmetric=study.grid.gaps[position[2]].is_symmetric,
            noise=_NOISE_FACTOR * (solver.atol + solver.rtol * reach),
            counted=[study.grid.starts[i].kind == FIXED for i in starts],
        )
        slab["attractor"][w, starts] = numbers(found[w], len(starts))
    return found


def _export_attractors(study: Study, found: dict[Position, Found], path: Path) -> None:
    grid = study.grid
    most = max((len(a) for slab in found.values() for a in slab.values()), default=0)
    sizes = {
        ATTRACTOR: max(most, 1),
        MULTIPLIER: 2,
        SECTION_POINT: study.steady.max_period_multiple,
    }
    with writing(path, _attributes(study)) as dataset:
        _define_attractors(dataset, grid, sizes)
        for position, slab in found.items():
            values = _attractor_slab(slab, len(grid.omega), sizes)
            _write_slab(dataset, position, values)


def _attractor_slab(found: Found, n_omega: int, sizes: dict[str, int]) -> Slab:
    shape = n_omega, sizes[ATTRACTOR]
    slab: Slab = {n: np.full(shape, v.missing, v.dtype) for n, v in ATTRACTOR_VARIABLES.items()}
    for name in MULTIPLIERS:
        slab[name] = np.full((*shape, sizes[MULTIPLIER]), np.nan)
    for name in ("section_x", "section_v"):
        slab[name] = np.full((*shape, sizes[SECTION_POINT]), np.nan)
    slab["n_attractors"] = np.zeros(n_omega, N_ATTRACTORS.dtype)
    for w, members in found.items():
        slab["n_attractors"][w] = len(members)
        for number, attractor in enumerate(members):
            _place_attractor(slab, (w, number), attractor)
    return slab


def _place_attractor(slab: Slab, at: tuple[int, int], attractor: Attractor) -> None:
    for name in ATTRACTOR_VARIABLES:
        source = attractor if hasattr(attractor, name) else attractor.response
        slab[name][at] = getattr(source, name)
    pairs = np.reshape(attractor.response.multipliers, (-1, 2))
    slab["multiplier_real"][at][: len(pairs)] = pairs[:, 0]
    slab["multiplier_imag"][at][: len(pairs)] = pairs[:, 1]
    lists = _lists(attractor.response)
    for name in ("section_x", "section_v"):
        slab[name][at][: len(lists[name])] = lists[name]


def _empty_slab(shape: tuple[int, ...], sizes: dict[str, int]) -> Slab:
    slab: Slab = {
        name: np.full(shape, variable.missing, variable.dtype)
        for name, variable in VARIABLES.items()
    }
    for name, (dimension, variable) in LISTS.items():
        slab[name] = np.full((*shape, sizes[dimension]), variable.missing, variable.dtype)
    slab["status"][...] = Status.NOT_REQUESTED
    return slab


def _write_slab(dataset: netCDF4.Dataset, position: tuple[int, ...], slab: Slab) -> None:
    for name, values in slab.items():
        dataset[name][position] = values


def _define(dataset: netCDF4.Dataset, grid: Grid, sizes: dict[str, int]) -> None:
    _define_coordinates(dataset, grid, POINT_DIMS)
    for name, size in sizes.items():
        dataset.createDimension(name, size)
    chunk = (1, 1, 1, *grid.shape[3:])
    for name, variable in VARIABLES.items():
        _create(dataset, name, variable, POINT_DIMS, chunk)
    for name, (dimension, variable) in LISTS.items():
        _create(dataset, name, variable, (*POINT_DIMS, dimension), (*chunk, sizes[dimension]))
    _name_auxiliary(dataset, POINT_DIMS)


def _define_attractors(dataset: netCDF4.Dataset, grid: Grid, sizes: dict[str, int]) -> None:
    _define_coordinates(dataset, grid, SCENE_DIMS)
    for name, size in sizes.items():
        dataset.createDimension(name, size)
    scene_chunk = (1, 1, 1, grid.shape[3])
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
        # Every cell is written, so no fill value: integers stay integers when opened.
        created = dataset.createVariable(
            name,
            variable.dtype,
            dimensions,
            fill_value=False,
            compression="zlib" if chunk else None,
            complevel=1,
            chunksizes=chunk,
            fletcher32=chunk is not None,
        )
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
