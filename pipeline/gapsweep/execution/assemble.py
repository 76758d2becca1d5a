"""Assemble the cached results of a study into `responses.nc` and `attractors.nc`.

The files are exports: they can be rewritten from the cache at any time and are then
identical except for their file-level provenance. Results are placed by position, piece by piece
(neighbouring parameter sets with all initial conditions), so that memory stays small. Attractors
are a property of a parameter set, not of a point: they are grouped here.
"""

import json
import math
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import StoreError
from gapsweep.execution.layout import (
    PIECE,
    Arrays,
    Layout,
    Piece,
    define,
    define_attractors,
    set_flags,
)
from gapsweep.execution.plan import ABSENT, Plan
from gapsweep.model.table import ForceTable
from gapsweep.response.attractors import NONE, Attractors, Grouping
from gapsweep.response.disturbances import smallest_disturbances
from gapsweep.response.result import ResponseClass, Responses
from gapsweep.status import Status
from gapsweep.store.cache import Found
from gapsweep.store.netcdf import LOCK, writing
from gapsweep.study.grid import Grid, Selection
from gapsweep.study.points import Points
from gapsweep.study.study import Study
from gapsweep.user_code.package_digest import numerics_fingerprint
from gapsweep.variables import EXTREMUM, MULTIPLIER, SECTION_POINT

# Function of tables of points that returns their responses.
Respond = Callable[[list[Points]], list[Responses]]

_LOOKED_AT = 256  # pieces of the grid in search of one that is complete


def export(
    plan: Plan,
    responses: Path,
    attractors: Path,
    *,
    made_from: Callable[[], str] = str,
    respond: Respond | None = None,
) -> Iterator[bool]:
    """Write ``responses.nc`` and ``attractors.nc`` from the cache, while points are computed.

    Each step writes a piece of the grid if all its points are stored. The files take their places
    at the end; if the iteration is left before, nothing remains of them. A study that asks for
    disturbances has its first piece written when all points are stored: the workers are free then.
    Raises `StoreError` if a file cannot be written.

    Parameters
    ----------
    plan : Plan
        Results that are stored meanwhile are entered in it.
    made_from : callable
        Returns the value of the files' attribute `made_from`; called when all points are stored.
    respond : callable, optional
        Returns the responses of tables of points from their fixed initial states. With it,
        attractors have the smallest disturbances that leave them.

    Yields
    ------
    bool
        Whether a piece was written; otherwise points of all pieces looked at are missing.
    """
    attributes = attributes_of(plan.study)
    with writing(attractors, attributes) as others, writing(responses, attributes) as dataset:
        filling = _Filling(dataset, others, plan, respond=respond)
        while filling.pieces:
            yield filling.step()
        digests = made_from()
        with LOCK:
            filling.finish()
            for each in (others, dataset):
                each.made_from = digests


def fill(
    dataset: netCDF4.Dataset,
    others: netCDF4.Dataset,
    plan: Plan,
    selection: Selection | None = None,
) -> None:
    """Fill empty datasets with the cached responses and attractors of a study.

    `dataset` and `others`: the datasets of `responses.nc` and `attractors.nc`.
    `selection`: part of the study to write; attractors are then those of the selected initial
    conditions.
    """
    filling = _Filling(dataset, others, plan, selection)
    while filling.pieces:
        filling.step()
    filling.finish()


class _Filling:
    """The pieces of the grid that are still to be written into both datasets."""

    def __init__(
        self,
        dataset: netCDF4.Dataset,
        others: netCDF4.Dataset,
        plan: Plan,
        selection: Selection | None = None,
        respond: Respond | None = None,
    ) -> None:
        self.dataset, self.others, self.respond = dataset, others, respond
        self.plan, self.selection, study = plan, selection, plan.study
        grid = study.grid if selection is None else study.grid.cut(selection)
        laws = {label: study.own_law(label) for label in grid.representations}
        uneven = [label for label, own in laws.items() if own is not None and not own.is_odd]
        mean_load = study.spec.model.get("mean_load", 0.0)
        symmetry: dict[str, Any] = {"uneven": uneven, "mean_load": mean_load}
        has_disturbances = respond is not None
        self.layout = Layout.of(grid, study.steady, **symmetry, has_disturbances=has_disturbances)
        self.hosts: list[str] = []
        self.versions: set[str] = set()
        with LOCK:
            define(dataset, self.layout)
            define_attractors(others, self.layout)
        self.pieces = deque(self.layout.pieces())

    def step(self) -> bool:
        """Write the next piece whose points are all stored; False if there is none among a few."""
        if self.layout.has_disturbances and self.plan.n_missing:
            return False
        for _ in range(min(len(self.pieces), _LOOKED_AT)):
            piece = self.pieces.popleft()
            numbers = _numbers(self.plan, self.layout.grid, self.selection, piece)
            if not self.plan.is_missing[numbers[numbers >= 0]].any():
                with LOCK:
                    self._write(piece, numbers)
                return True
            self.pieces.append(piece)
        return False

    def finish(self) -> None:
        """Write what is known only when all pieces are written."""
        set_flags(self.dataset["host"], tuple((name, i) for i, name in enumerate(self.hosts)))
        self.dataset.computed_with = "; ".join(sorted(self.versions - {""}))

    def _write(self, piece: Piece, numbers: NDArray[np.int64]) -> None:
        layout, requested = self.layout, numbers >= 0
        if not requested.any():
            return
        stored = _PieceResults(self.plan, numbers)
        units, directions = _sections(self.plan.study, layout, piece, stored, requested)
        attractors, ids, cells = _grouped(layout, piece, stored, units)
        left = {}
        if layout.has_disturbances:
            first = numbers.flat[cells[attractors.first]]
            left = self._disturbances(first, attractors.leaders, units[:, attractors.scene])
        of_scenes = _attractor_arrays(layout, attractors, left, requested.shape[:-1], directions)
        _write(self.others, piece[:-1], of_scenes)
        for starts in layout.starts():
            found, at = stored.of(starts)
            self.versions |= found.versions
            hosts = self.hosts
            hosts += [host for host in np.unique(found.host).tolist() if {host} - {"", *hosts}]
            values = _point_arrays(layout, requested[..., starts], found, at, hosts, directions)
            values["attractor"] = ids[..., starts]
            _write(self.dataset, (*piece[:-1], starts), values)

    def _disturbances(
        self, first: NDArray[np.int64], leaders: Responses, unit: NDArray[np.float64]
    ) -> Arrays:
        """Smallest disturbances that leave attractors; `first` are the points of the leaders."""
        study, respond = self.plan.study, self.respond
        assert respond is not None
        assert study.spec.attractors is not None
        tables = study.points(study.grid.cells(first))

        def answer(of: NDArray[np.intp], states: NDArray[np.float64]) -> Responses:
            order, parts = [], []
            for numbers, points in tables:
                here = np.flatnonzero(np.isin(of, numbers))
                for some in np.split(here, range(PIECE, len(here), PIECE)):
                    rows = np.searchsorted(numbers, of[some])
                    parts.append(points.take(rows).from_states(states[some]))
                    order.append(some)
            found = Responses.concatenated(respond(parts))
            return found.take(np.argsort(np.concatenate(order)))

        starts = self.layout.grid.starts.states
        found = smallest_disturbances(leaders, unit, starts, study.spec.attractors.rays, answer)
        return found.arrays(study.structure.n)


def attributes_of(study: Study) -> dict[str, str]:
    """Attributes of both files: study, measured laws, fingerprint of the numerics."""
    return {
        **study.attributes,
        **_tables(study),
        "numerics_fingerprint": numerics_fingerprint(),
    }


def _tables(study: Study) -> dict[str, str]:
    """Attribute ``tables_json``: points, range and symmetry of the swept laws from tables."""
    labels = {one.law for one in study.grid.representations}
    laws = {n: own.load() for n in sorted(labels) if (own := study.own_law(n)) is not None}
    found = {
        label: {"points": len(law.x), "low": law.x[0], "high": law.x[-1], "is_odd": law.is_odd}
        for label, law in laws.items()
        if isinstance(law, ForceTable)
    }
    return {"tables_json": json.dumps(found)} if found else {}


def _numbers(
    plan: Plan, grid: Grid, selection: Selection | None, piece: Piece
) -> NDArray[np.int64]:
    """Number in the plan of the point of every cell of a piece, -1 without a point."""
    whole = plan.study.grid
    some = selection or [np.arange(n) for n in whole.shape]
    at = np.ix_(*(axis[part] for axis, part in zip(some, piece, strict=True)))
    numbers = whole.numbers(np.ravel_multi_index(at, whole.shape))
    is_point = (plan.status[numbers] != ABSENT) & grid.requested[piece]
    return np.where(is_point, numbers, -1)


class _PieceResults:
    """Cached results of a piece of the grid, for part of its initial conditions at a time.

    The results are read twice, to group them and to write them. Most pieces have one part, which is
    kept in memory.
    """

    def __init__(self, plan: Plan, numbers: NDArray[np.int64]) -> None:
        assert plan.cache is not None, "where the results are stored"
        self._plan, self._cache, self._numbers = plan, plan.cache, numbers
        self._kept: tuple[slice, tuple[Found, NDArray[np.intp]]] | None = None

    def of(self, starts: slice) -> tuple[Found, NDArray[np.intp]]:
        """Results of some initial conditions, and the cell of each in the piece, as indices.

        Points without a result are left out. Raises `StoreError` if some are no longer stored.
        """
        if self._kept is None or self._kept[0] != starts:
            numbers = self._numbers[..., starts]
            here = np.nonzero(numbers >= 0)
            self._kept = None
            places = self._plan.places[numbers[here]]
            found = self._cache.found(places, self._plan.study.structure)
            if lost := int((places["slab"] >= 0).sum()) - len(found.at):
                raise StoreError(
                    f"{self._cache.path}: {lost} points of this run were removed by another "
                    "process or a disk failure; run again to resume"
                )
            self._kept = starts, (found, np.array(here)[:, found.at])
        return self._kept[1]


def _point_arrays(
    layout: Layout,
    requested: NDArray[np.bool_],
    found: Found,
    at: NDArray[np.intp],
    hosts: list[str],
    directions: NDArray[np.float64],
) -> Arrays:
    """Values of all variables but ``attractor`` in a piece, for some initial conditions."""
    responses, shape = found.responses, requested.shape
    sizes = _sizes(layout, responses)
    values = {
        name: np.full((*shape, *(sizes[dim] for dim in layout.within(v))), v.missing, v.dtype)
        for name, v in layout.variables.items()
        if name != "attractor"
    }
    # For requested points without a result:
    values["status"][requested] = Status.INTERRUPTED
    values["response_class"][requested] = ResponseClass.FAILED
    scene = np.ravel_multi_index(tuple(at[:-1]), shape[:-1])
    arrays = responses.arrays(sizes, directions[scene])
    for name in values.keys() & arrays.keys():
        values[name][*at] = arrays[name]
    for i, host in enumerate(hosts):
        values["host"][tuple(of[found.host == host] for of in at)] = i
    return values


def _grouped(
    layout: Layout, piece: Piece, stored: _PieceResults, units: NDArray[np.float64]
) -> tuple[Attractors, NDArray[np.int32], NDArray[np.intp]]:
    """The attractors of a piece, the number of each point's attractor, and the responses' cells."""
    shape = tuple(part.stop - part.start for part in piece)
    grouping, cells = Grouping(units), []
    for starts in layout.starts():
        found, at = stored.of(starts)
        scene, start = np.ravel_multi_index(tuple(at[:-1]), shape[:-1]), at[-1] + starts.start
        cells.append(scene * shape[-1] + start)
        grouping.add(found.responses, scene, layout.grid.starts.is_fixed[start])
    attractors = grouping.attractors(layout.is_symmetric(piece))
    ids, of_responses = np.full(shape, NONE, np.int32), np.concatenate(cells)
    ids.flat[of_responses] = attractors.numbers
    return attractors, ids, of_responses


def _attractor_arrays(
    layout: Layout,
    found: Attractors,
    left: Arrays,
    shape: tuple[int, ...],
    directions: NDArray[np.float64],
) -> Arrays:
    """Values of all variables of `attractors.nc` in a piece of the grid; `left`: disturbances."""
    leaders, most = found.leaders, int(found.number.max(initial=0)) + 1
    place = (*np.unravel_index(found.scene, shape), found.number)
    sizes = {**_sizes(layout, leaders), EXTREMUM: 0}
    arrays, values = leaders.arrays(sizes, directions[found.scene]) | left, {}
    for name, variable in layout.attractor_variables.items():
        within = [sizes[dim] for dim in layout.within(variable)]
        values[name] = np.full((*shape, most, *within), variable.missing, variable.dtype)
        values[name][place] = arrays[name] if name in arrays else getattr(found, name)
    counts = np.bincount(found.scene, minlength=math.prod(shape))
    values["n_attractors"] = counts.reshape(shape).astype(np.int32)
    return values


def _sizes(layout: Layout, responses: Responses) -> dict[str, int]:
    """Sizes of the dimensions within a point up to the longest lists; the rest is not written."""
    widths = {MULTIPLIER: ("multipliers", 1), SECTION_POINT: ("section", responses.ends.shape[1])}
    longest = {
        dim: int(responses.lists[name][1].max(initial=0)) // width
        for dim, (name, width) in widths.items()
    }
    n_extrema = int(responses.columns["n_extrema"].max(initial=0))
    return {**layout.sizes, **longest, EXTREMUM: min(n_extrema, layout.sizes[EXTREMUM])}


def _sections(
    study: Study, layout: Layout, piece: Piece, stored: _PieceResults, requested: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Units of the states and directions of the contacts in a piece, as from `study.model`."""
    rates = np.full(requested.shape[:-1], np.nan)
    if "omega" not in layout.grid.axes:
        for starts in layout.starts():
            found, at = stored.of(starts)
            _set_rates(rates, found.responses, tuple(at[:-1]))
    # Only for requested cells: a user's function may have no system elsewhere.
    asked = np.flatnonzero(requested.any(axis=-1))
    places = {name: place[asked] for name, place in layout.places(piece).items()}
    of = layout.grid.structure
    units = np.ones((of.n_states, rates.size))
    directions = np.ones((rates.size, len(of.contacts), of.n))
    units[:, asked], directions[asked] = study.model.sections(
        layout.grid.axes, places, rates.ravel()[asked]
    )
    return units, directions


def _set_rates(
    rates: NDArray[np.float64], responses: Responses, scene: tuple[NDArray[np.intp], ...]
) -> None:
    """Set unknown section rates [1/s] of unforced parameter sets from their first response."""
    columns = responses.columns
    first = np.isnan(rates[scene]) & (columns["period"] > 0.0)
    some = np.flatnonzero(first)[::-1]  # the first response is assigned last
    found = columns["period_multiple"][some] / columns["period"][some]
    rates[tuple(at[some] for at in scene)] = found


def _write(dataset: netCDF4.Dataset, cells: tuple[slice, ...], values: Arrays) -> None:
    for name, value in values.items():
        n_more = len(dataset[name].dimensions) - len(cells)
        ends = [slice(0, size) for size in value.shape[value.ndim - n_more :]] if n_more else []
        if value.size:
            dataset[name][*cells, *ends] = value
