"""Assemble the cached results of a study into `responses.nc`.

The file is an export: it can be written again from the cache at any time and is then
identical but for its file-level provenance. Results go to their place by position, slab by
slab (one representation, stiffness and gap at a time), so that memory stays small.
"""

from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from gapsweep.execution.plan import Chain, Plan
from gapsweep.store.cache import Cache, Row
from gapsweep.store.netcdf import writing
from gapsweep.study.fingerprint import numerics_fingerprint
from gapsweep.study.points import FIXED
from gapsweep.study.schema import COORDINATES, EXTREMA, EXTREMUM, POINT_DIMS, VARIABLES, Variable
from gapsweep.study.study import Grid, Study

Slab = dict[str, NDArray[Any]]


def export(study: Study, plan: Plan, cache: Cache, path: Path) -> None:
    """Write `responses.nc` from the cache.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    grid = study.grid
    attributes = {
        "title": study.title,
        "study": study.name,
        "study_json": study.json,
        "numerics_fingerprint": numerics_fingerprint(),
        "source": "gapsweep",
    }
    with writing(path, attributes) as dataset:
        _define(dataset, grid, study.steady.max_extrema)
        _write_coordinates(dataset, grid)
        hosts: list[str] = []
        chains = {p: list(c) for p, c in groupby(plan.chains, lambda c: c.indices[0][:3])}
        for position in np.ndindex(grid.shape[:3]):
            slab = _empty_slab(grid, study.steady.max_extrema)
            for index, row in _results(chains.get(position, []), cache):
                _place(slab, index[3:], row, hosts)
            _write_slab(dataset, position, slab)
        _set_flags(dataset["host"], tuple((name, i) for i, name in enumerate(hosts)))


def _results(chains: list[Chain], cache: Cache) -> Iterator[tuple[tuple[int, ...], Row]]:
    places = {
        key: index for chain in chains for key, index in zip(chain.keys, chain.indices, strict=True)
    }
    rows = cache.rows(places)
    for key, index in places.items():
        if key in rows:
            yield index, rows[key]


def _place(slab: Slab, at: tuple[int, ...], row: Row, hosts: list[str]) -> None:
    """Write one result into its cell."""
    for name in VARIABLES:
        if name != "host":
            slab[name][at] = getattr(row.response, name)
    if row.host:
        if row.host not in hosts:
            hosts.append(row.host)
        slab["host"][at] = hosts.index(row.host)
    extrema = row.response.extrema
    slab["extrema"][at][: len(extrema)] = extrema


def _empty_slab(grid: Grid, max_extrema: int) -> Slab:
    shape = grid.shape[3:]
    slab: Slab = {
        name: np.full(shape, variable.missing, dtype=variable.dtype)
        for name, variable in VARIABLES.items()
    }
    slab["extrema"] = np.full((*shape, max_extrema), np.nan)
    return slab


def _write_slab(dataset: netCDF4.Dataset, position: tuple[int, ...], slab: Slab) -> None:
    for name, values in slab.items():
        dataset[name][position] = values


def _define(dataset: netCDF4.Dataset, grid: Grid, max_extrema: int) -> None:
    for name, size in zip(POINT_DIMS, grid.shape, strict=True):
        dataset.createDimension(name, size)
    dataset.createDimension(EXTREMUM, max_extrema)
    for name, (dimension, variable) in COORDINATES.items():
        _create(dataset, name, variable, (dimension,), None)
    chunk = (1, 1, 1, *grid.shape[3:])
    for name, variable in VARIABLES.items():
        _create(dataset, name, variable, POINT_DIMS, chunk)
    _create(dataset, "extrema", EXTREMA, (*POINT_DIMS, EXTREMUM), (*chunk, max_extrema))
    auxiliary = [name for name, (dimension, _) in COORDINATES.items() if name != dimension]
    for name in (*VARIABLES, "extrema"):
        dataset[name].coordinates = " ".join(auxiliary)  # CF: coordinates that are no dimension


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
            name, variable.dtype, dimensions, fill_value=False,
            compression="zlib" if chunk else None, complevel=1, chunksizes=chunk,
            fletcher32=chunk is not None,
        )  # fmt: skip
    created.units, created.long_name = variable.units, variable.long_name
    _set_flags(created, variable.flags)


def _set_flags(variable: Any, flags: tuple[tuple[str, int], ...]) -> None:
    if flags:
        variable.flag_values = np.array([value for _, value in flags], dtype=variable.dtype)
        # CF separates meanings by blanks.
        variable.flag_meanings = " ".join(meaning.replace(" ", "_") for meaning, _ in flags)


def _write_coordinates(dataset: netCDF4.Dataset, grid: Grid) -> None:
    fixed = [start.kind == FIXED for start in grid.starts]
    states = np.array([(start.x_0, start.v_0) for start in grid.starts])
    states[~np.array(fixed)] = np.nan
    values = {
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
    for name, value in values.items():
        dataset[name][:] = value
