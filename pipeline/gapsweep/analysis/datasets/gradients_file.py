"""Derivatives of the quantities of all periodic attractors of a study: ``gradients.nc``."""

from collections.abc import Iterator, Sequence
from enum import IntEnum

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.continuation.dataset import ATTRACTOR
from gapsweep.continuation.gradient import PARAMETER, QUANTITY, VARIABLES, derivatives
from gapsweep.errors import ModelError
from gapsweep.integrate.problem import DEFAULT_ENGINE, Solver
from gapsweep.model.parameters import Parameter
from gapsweep.quantities import UNITS
from gapsweep.response.orbit_gradients import Cases
from gapsweep.response.result import ResponseClass
from gapsweep.study.grid import START
from gapsweep.study.points import Points
from gapsweep.study.study import Study
from gapsweep.user_code.package_digest import numerics_fingerprint
from gapsweep.variables import SECTION_POINT, Variable

Array = NDArray[np.float64]
Numbers = NDArray[np.intp]

_PART = 4096  # orbits of one call
_SECTIONS = ("section_x", "section_v", "section_z")


class Reason(IntEnum):
    """Why an attractor has no derivatives."""

    NONE = 0
    NO_ATTRACTOR = 1
    NOT_PERIODIC = 2
    REFUSED = 3  # the law or a parameter has none; `refused` of the dataset has the message
    NO_ORBIT = 4  # Newton's method finds no orbit
    ACCUMULATION = 5  # impacts of several contacts accumulate at one time


REASON = Variable(
    "i1", "1", "reason why there are no derivatives", Reason.NO_ATTRACTOR,
    tuple((each.name.lower(), int(each)) for each in Reason),
)  # fmt: skip


def gradients_of(study: Study, attractors: xr.Dataset) -> xr.Dataset:
    """Return derivatives of the quantities of periodic attractors by the parameters of a study.

    Parameters
    ----------
    study : Study
        With a table ``[gradients]``.
    attractors : Dataset
        ``attractors.nc`` of the study.

    Returns
    -------
    Dataset
        `gradient` over the dimensions of a case, `attractor`, `quantity` and `parameter`, `value`
        without `parameter`, as of `gapsweep.gradient`; `reason` why they are NaN. The attribute
        `refused` has the message of a law or a parameter without derivatives.
    """
    table = study.spec.gradients
    assert table is not None
    dims = [name for name in study.grid.dims if name != START]
    here = attractors.transpose(*dims, ATTRACTOR, SECTION_POINT, ..., missing_dims="ignore")
    classes = here["response_class"].load()
    reason = np.where(classes >= 0, Reason.NOT_PERIODIC, Reason.NO_ATTRACTOR).astype("i1")
    orbits = np.argwhere(classes.values == ResponseClass.PERIODIC)
    state, multiple, period = _states(here, tuple(orbits.T))
    arrays: dict[str, Array] = {}
    labels: tuple[str, ...] = ()
    refused: dict[str, None] = {}
    for rows, points, parameters in _tables(study, orbits[:, :-1], table.by):
        (_, models), _ = points.models()
        systems = [models.systems[i] for i in models.system.tolist()]
        laws = [models.laws[i] for i in models.law.tolist()]
        cases = Cases(systems, laws, models.omega, parameters)
        at, kind = tuple(orbits[rows].T), points.kind
        solver = kind.solver if kind.solver.engine == DEFAULT_ENGINE else Solver.of()
        try:
            found, labels = derivatives(cases, state[rows], multiple[rows], period[rows], solver)
        except ModelError as error:
            reason[at] = Reason.REFUSED
            refused[f"{kind.representation}: {error}"] = None
            continue
        for name, values in found.items():
            whole = arrays.setdefault(name, np.full((*reason.shape, *values.shape[1:]), np.nan))
            whole[at] = values
        is_orbit = np.isfinite(found["value"]).any(axis=1)
        why = np.where(is_orbit, Reason.ACCUMULATION, Reason.NO_ORBIT)
        reason[at] = np.where(np.isfinite(found["gradient"]).any(axis=(1, 2)), Reason.NONE, why)
    sizes = {QUANTITY: len(labels), PARAMETER: len(table.by)}
    data = {"reason": (classes.dims, reason, REASON.attributes)}
    for name, one in VARIABLES.items():
        absent = np.full((*reason.shape, *(sizes[dim] for dim in one.dims)), np.nan)
        data[name] = ((*classes.dims, *one.dims), arrays.get(name, absent), one.attributes)
    known = UNITS if study.model.is_oscillator else {"omega": "Hz"}
    units = [known.get(name, "") for name in table.by]
    coords = {QUANTITY: list(labels), PARAMETER: table.by, f"{PARAMETER}_units": (PARAMETER, units)}
    made = classes.to_dataset().assign(data).assign_coords(coords)
    about = {"numerics_fingerprint": numerics_fingerprint(), "refused": "\n".join(refused)}
    return made.assign_attrs(**study.attributes, **about)


def _states(
    here: xr.Dataset, places: tuple[Numbers, ...]
) -> tuple[Array, NDArray[np.int64], Array]:
    """Return first section points, period multiples and periods [s] of attractors."""
    sections = [here[name].values[places][:, 0] for name in _SECTIONS if name in here]
    n = len(places[0])
    state = np.concatenate([each.reshape(n, -1) for each in sections], axis=1)
    multiple = here["period_multiple"].values[places].astype(np.int64)
    period = here["period"].values[places] if "period" in here else np.full(n, np.nan)
    return state, multiple, period


def _tables(
    study: Study, places: Numbers, by: Sequence[str]
) -> Iterator[tuple[Numbers, Points, tuple[Parameter, ...]]]:
    """Yield rows of orbits, tables of their points, and the parameters of all of these.

    `places`: shape (n, number of dimensions of a case).
    """
    grid = study.grid
    first = np.moveaxis(grid.requested, grid.dims.index(START), -1).argmax(axis=-1)
    cell = np.insert(places, grid.dims.index(START), first[tuple(places.T)], axis=1)
    cells, which = np.unique(np.ravel_multi_index(cell.T, grid.shape), return_inverse=True)
    swept = [name for name in grid.dims if name in study.spec.model and name != START]
    for some, points in study.points(cells):
        row_of = np.full(len(cells), -1)
        row_of[some] = np.arange(len(some))
        rows = np.flatnonzero(row_of[which] >= 0)
        # Numbers that are zero, and walls that are absent, change the structure of a model.
        numbers = points.numbers[row_of[which[rows]], : -points.kind.n_states]
        same = [numbers == 0.0, np.isinf(numbers)]
        if study.model.along(by, {}) is not None:  # a function of values that differ
            same.append(cell[rows][:, [grid.dims.index(name) for name in swept]])
        number = np.unique(np.hstack(same), axis=0, return_inverse=True)[1].ravel()
        for group in (rows[number == k] for k in range(number.max(initial=-1) + 1)):
            values = {n: grid.axes[n][cell[group[0], grid.dims.index(n)]] for n in swept}
            function = study.model.along(by, values)
            own = {n: {**study.spec.model, **values}[n] for n in by if n in study.spec.model}
            parameters = tuple(Parameter(n, function, own if function else {}) for n in by)
            for begin in range(0, len(group), _PART):
                part = group[begin : begin + _PART]
                yield part, points.take(row_of[which[part]]), parameters
