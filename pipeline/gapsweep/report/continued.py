"""Simulation of stored steady responses, for figures that need more than the stored data."""

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from gapsweep.analysis.dimensions import Array, point_dims
from gapsweep.errors import DatasetError
from gapsweep.integrate.simulate import motion_of
from gapsweep.integrate.trajectory import SystemTrajectory, Trajectory
from gapsweep.report.selection import scene
from gapsweep.response.absolute import N_PERIODS, extremes
from gapsweep.study.axis_selection import listed, positions
from gapsweep.study.grid import CONTACT, COORDINATE, LAG, START, Grid
from gapsweep.study.samples import SAMPLE
from gapsweep.study.study import Study
from gapsweep.variables import SECTION_POINT

DISPLACEMENTS = ("section_x", "contact_section_x")
_WITHIN = {"section_x": COORDINATE, "section_v": COORDINATE, "section_z": LAG}


def motions(
    dataset: xr.Dataset,
    dims: Sequence[str],
    wanted: Mapping[str, Any],
    n_periods: int,
    *,
    once: bool = True,
) -> Iterator[tuple[tuple[int, ...], Trajectory]]:
    """Simulate stored responses further, each from its first section point.

    Models, contact laws and solvers are those of the study, which datasets hold as JSON. Raises
    `DatasetError` if the dataset lacks the study, a parameter or a part of the state. Raises
    `ModelError` if a contact law cannot be built.

    Parameters
    ----------
    dataset : Dataset
        ``responses.nc`` or ``attractors.nc``, or a selection with the full state.
    dims : sequence of str
        Dimensions of the responses; all other dimensions must have one value.
    wanted : mapping
        Selection by coordinate; `coordinate` and `contact` select no part of the state.
    n_periods : int
        Forcing periods, ``> 0``.
    once : bool
        Whether to simulate a periodic response for one of its periods only.

    Yields
    ------
    at : tuple of int
        Position along `dims`. Failed responses are left out.
    motion : Trajectory
        With dense output, from time zero on.
    """
    study = _study(dataset)
    kept = {name: value for name, value in wanted.items() if name not in (COORDINATE, CONTACT)}
    names = [name for name in _WITHIN if name in dataset] or ["section_x"]
    needed = {name: (*dims, SECTION_POINT, _WITHIN[name]) for name in names}
    shown = scene(dataset, {**needed, "period_multiple": tuple(dims)}, kept)
    first = shown.isel({SECTION_POINT: 0})
    columns = [first[name].transpose(*dims, _WITHIN[name]).values for name in names]
    states = np.concatenate(columns, axis=-1)
    if states.shape[-1] != study.structure.n_states:
        raise DatasetError(
            f"section_x: holds {states.shape[-1]} of the {study.structure.n_states} components of "
            "a state; give coordinate= or contact= in the call, not in a selection before"
        )
    there = np.argwhere(np.isfinite(states).all(axis=-1))
    multiple = shown["period_multiple"].transpose(*dims).values
    where = [shown.isel(dict(zip(dims, at, strict=True))) for at in there.tolist()]
    cells = np.array([_cell(study.grid, one) for one in where], dtype=np.int64)
    for rows, points in study.points(cells):
        (some, models), refused = points.models()
        for error in refused.values():
            raise error
        for number, row in enumerate(rows[some].tolist()):
            at = tuple(there[row].tolist())
            n = int(multiple[at]) if once and multiple[at] > 0 else n_periods
            yield at, motion_of(models.take([number]), points.kind.solver, states[at], n)


def with_absolute(dataset: xr.Dataset) -> xr.Dataset:
    """Return responses with `absolute_max` and `absolute_min` of oscillators on a moving base.

    Every response is simulated once more from its section. Raises `DatasetError` if the dataset
    lacks the study, or its models are systems.
    """
    study = _study(dataset)
    if not study.model.is_oscillator:
        raise DatasetError("with_absolute: a system does not hold its base; use gs.BaseMotion.at")
    dims = point_dims(dataset)
    base = dataset.coords.get("base_amplitude", xr.DataArray(study.oscillator.base_amplitude))
    moved = base.broadcast_like(dataset["status"]).transpose(*dims).values
    found = np.full((2, *dataset["status"].shape), np.nan)
    for at, run in motions(dataset, dims, {}, N_PERIODS):
        found[0][at], found[1][at] = extremes(run, float(moved[at]))
    words = {"absolute_min": "trough", "absolute_max": "peak"}
    for (name, word), values in zip(words.items(), found, strict=True):
        about = {"units": "m", "long_name": f"{word} of the absolute displacement"}
        dataset = dataset.assign({name: (dims, values, about)})
    return dataset


def weights(run: Trajectory, shown: xr.Dataset, variable: str) -> Array:
    """Weights of the coordinates, shape (n,), in the displacement that a variable holds.

    Raises `DatasetError` if `variable` is no displacement of a section.
    """
    if variable not in DISPLACEMENTS:
        raise DatasetError(f"variable = {variable!r}: must be {' or '.join(DISPLACEMENTS)}")
    if not isinstance(run, SystemTrajectory):
        return np.ones(1)
    if variable.startswith(CONTACT):
        return np.asarray(run.system.directions[number_of(shown, CONTACT)])
    return np.asarray(np.eye(run.system.n)[number_of(shown, COORDINATE)])


def number_of(shown: xr.Dataset, part: str) -> int:
    """Position of a selected coordinate or contact among those of the system."""
    if part not in shown.coords:
        return 0
    names = list(json.loads(shown.attrs["system_json"])[f"{part}s"])
    return names.index(shown[part].item())


def _study(dataset: xr.Dataset) -> Study:
    if "study_json" not in dataset.attrs:
        raise DatasetError(
            "study_json: no attribute of this dataset, so its motions cannot be simulated; "
            "gs.open, gs.run and gs.query return datasets that have it"
        )
    tables = json.loads(dataset.attrs["study_json"])
    # No motion needs the modules of [claims] and [report], and a dataset may have come without.
    study = Study.from_dict({k: v for k, v in tables.items() if k not in ("claims", "report")})
    if "omega" not in study.grid.axes:
        raise DatasetError(
            "omega: nothing forces this system, so its section is not stroboscopic; draw a motion "
            "by gs.plot(gs.simulate(...))"
        )
    return study


def _cell(grid: Grid, one: xr.Dataset) -> int:
    """Flat position of a response in the grid of its study, at the first initial condition."""
    at = []
    for name in grid.dims:
        values = grid.labels(name)
        if name == START or len(values) == 1:
            at.append(0)
        elif name not in one.coords:
            raise DatasetError(
                f"{name}: no coordinate of this dataset, and the study has {listed(values)}; "
                "select without drop=True to keep it"
            )
        elif name == SAMPLE:
            at.append(int(one[name]))  # samples of a study are numbered from 0
        else:
            at.append(int(positions(name, values, one[name].item(), "the study")[0]))
    return int(np.ravel_multi_index(at, grid.shape))
