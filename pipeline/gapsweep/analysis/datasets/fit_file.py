"""The fit of a study to its measured sweeps: ``fit.nc``."""

import numpy as np
import xarray as xr

from gapsweep.design.fit import fit
from gapsweep.errors import ModelError, StudyError
from gapsweep.execution.branch_tasks import model_of
from gapsweep.integrate.problem import DEFAULT_ENGINE
from gapsweep.study.study import Study
from gapsweep.user_code.package_digest import numerics_fingerprint


def fit_of(study: Study) -> xr.Dataset:
    """Return the fit of ``[fit]``, as `gapsweep.Fit.to_dataset` does.

    The law is that of the first representation; numbers that are not free have their values in the
    study.

    Raises
    ------
    StudyError
        If the model is invalid in a range.
    """
    table, grid = study.spec.fit, study.grid
    assert table is not None
    first = np.flatnonzero(grid.requested)[:1]  # representations are the first axis
    ((_, point),) = study.points(first)
    system = study.model.along(tuple(table.free), {})
    model, laws, _ = model_of(point, system)
    solver = point.kind.solver
    rtol = solver.rtol if solver.engine == DEFAULT_ENGINE else None
    try:
        found = fit(table.data, model, laws, free=table.free, noise=table.noise, rtol=rtol)
    except ModelError as error:
        raise StudyError(f"{study.source}: fit: {error}") from None
    made = found.to_dataset()
    representation = grid.representations[0]
    return made.assign_attrs(
        **study.attributes,
        representation=str(representation),
        numerics_fingerprint=numerics_fingerprint(),
    )
