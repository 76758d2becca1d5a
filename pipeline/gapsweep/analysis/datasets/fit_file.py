"""A fit to measured sweeps as a dataset, and the fit of a study: ``fit.nc``."""

from dataclasses import replace
from functools import partial

import numpy as np
import xarray as xr

from gapsweep.continuation.follow import branches
from gapsweep.design.fit import Fit, fit
from gapsweep.errors import ModelError
from gapsweep.execution.branch_tasks import model_of
from gapsweep.integrate.problem import DEFAULT_ENGINE
from gapsweep.response.result import RESPONSE
from gapsweep.status import Status
from gapsweep.study.study import Study
from gapsweep.user_code.package_digest import numerics_fingerprint
from gapsweep.variables import STATUS_FLAGS, Variable, with_attributes

PARAMETER, OTHER = "parameter", "other_parameter"
_MEASUREMENT, _MINIMUM = "measurement", "minimum"
_of_point = partial(Variable, dims=(_MEASUREMENT,))
_STATUS = {"fit_status": Variable("i1", "1", "outcome of the fit", Status.OK, STATUS_FLAGS)}
# Variables of ``fit.nc``; those of the quantity have its unit.
VARIABLES = {
    **_STATUS,
    "value": Variable("f8", "", "fitted value, in SI units", dims=(PARAMETER,)),
    "standard_error": Variable("f8", "", "standard error, inf: unknown", dims=(PARAMETER,)),
    "covariance": Variable("f8", "", "covariance of the parameters", dims=(PARAMETER, OTHER)),
    "correlation": Variable("f8", "1", "correlation of the parameters", dims=(PARAMETER, OTHER)),
    "measured_omega": _of_point("f8", "Hz", "frequency of the measured point"),
    "direction": _of_point("str", "1", "direction of the sweep of the measured point"),
    "measured": _of_point("f8", "", "measured value"),
    "measured_noise": _of_point("f8", "", "standard deviation of the measured value"),
    "computed": _of_point("f8", "", "value of the fitted model"),
    "residual": _of_point("f8", "", "measured minus computed value"),
    "is_on_branch": _of_point("i1", "1", "whether measurement and model are on the same branch"),
    "minimum_value": Variable("f8", "", "values at every minimum", dims=(_MINIMUM, PARAMETER)),
    "misfit": Variable("f8", "1", "mean square of the residuals over the noise", dims=(_MINIMUM,)),
}


_OF_QUANTITY = ("measured", "measured_noise", "computed", "residual")


def fit_of(study: Study) -> xr.Dataset:
    """Return the fit of ``[fit]``, as a dataset.

    The law is that of the first representation; numbers that are not free have their values in the
    study. If the model is invalid in a range, the dataset has only `fit_status`, and the error as
    the attribute `message`.
    """
    table, grid = study.spec.fit, study.grid
    assert table is not None
    first = np.flatnonzero(grid.requested)[:1]  # representations are the first axis
    ((_, point),) = study.points(first)
    some = {name: axis[0] for name, axis in grid.axes.items() if name in study.spec.model}
    system = study.model.along(tuple(table.free), some)
    model, laws, _ = model_of(point, system)
    solver = point.kind.solver
    rtol = solver.rtol if solver.engine == DEFAULT_ENGINE else None
    try:
        found = dataset(fit(table.data, model, laws, free=table.free, noise=table.noise, rtol=rtol))
    except ModelError as error:
        status = with_attributes(_STATUS, {"fit_status": np.int8(Status.MODEL_INVALID)})
        found = xr.Dataset(status, attrs={"message": str(error)})
    return found.assign_attrs(
        **study.attributes,
        representation=grid.representations[0],
        numerics_fingerprint=numerics_fingerprint(),
    )


def dataset(fitted: Fit) -> xr.Dataset:
    """Return the fit with the branches of the fitted model over the measured frequencies.

    Returns
    -------
    Dataset
        `value`, `standard_error`, `covariance` and `correlation` over `parameter`; the points
        over `measurement`; `minimum_value` and `misfit` over `minimum`. Attributes are
        `quantity` and `notes`. Branches, over `branch` and `step`, are those of
        `gapsweep.branches`; a fit to another quantity than amplitude, peak or trough has none.
    """
    names = [*fitted.values]
    of_minima = [[one[name] for name in names] for one in fitted.minima]
    arrays = {
        "fit_status": np.int8(Status.OK),
        "value": [*fitted.values.values()],
        "standard_error": [*fitted.errors.values()],
        "covariance": fitted.covariance,
        "correlation": fitted.correlation,
        "measured_omega": fitted.omega,
        "measured_noise": fitted.noise,
        **{name: getattr(fitted, name) for name in ("direction", "measured", "computed")},
        **{name: getattr(fitted, name) for name in ("residual", "is_on_branch")},
        "minimum_value": of_minima,
        "misfit": [one["misfit"] for one in fitted.minima],
    }
    units = RESPONSE[fitted.quantity].units
    described = {
        name: replace(one, units=units) if name in _OF_QUANTITY else one
        for name, one in VARIABLES.items()
    }
    found = with_attributes(described, {name: np.asarray(x) for name, x in arrays.items()})
    coords = {
        PARAMETER: names,
        OTHER: names,
        f"{PARAMETER}_units": (PARAMETER, [*fitted.units.values()]),
    }
    made = xr.Dataset(found, coords)
    if (orbits := _orbits(fitted)) is not None:
        made = orbits.merge(made)
    attributes = {
        "quantity": fitted.quantity,
        "notes": "\n".join(fitted.notes),
    }
    return made.assign_attrs(attributes)


def _orbits(fitted: Fit) -> xr.Dataset | None:
    """Branches of the fitted model over the measured frequencies; None without the quantity."""
    if fitted.quantity not in ("amplitude", "x_max", "x_min"):
        return None
    between = float(fitted.omega.min()), float(fitted.omega.max())
    try:
        found = branches(fitted.oscillator, fitted.law, "omega", between)
    except ModelError:  # no periodic orbit
        return None
    found.encoding.clear()
    return found
