"""Made-up datasets of studies that sweep more than stiffness, gap and frequency."""

import numpy as np
import xarray as xr

from tests.made import datasets, tables

FORCING = {"units": "N", "long_name": "forcing amplitude"}
WALL = {"units": "m", "long_name": "distance of the wall from the origin"}


def over_forcing(folder, study, answer, values):
    """Responses and attractors over a dimension ``forcing`` [N] before the last one of points.

    Parameters
    ----------
    answer : callable
        From label, frequency [Hz], number of the start and forcing [N] to a Response.
    """
    parts = [datasets(folder, study, lambda *at, f=f: answer(*at, f)) for f in values]
    axis = xr.DataArray(np.array(values), dims="forcing", name="forcing", attrs=FORCING)
    own = {"data_vars": "all", "coords": "minimal", "compat": "override", "join": "exact"}
    whole = [xr.concat(some, axis, **own) for some in zip(*parts, strict=True)]
    first = ("representation", "K_c", "gap", "omega", "forcing")
    return [ds.transpose(*first, "initial_condition", ..., missing_dims="ignore") for ds in whole]


def over_walls(folder, label, omega, j_1, j_2, answer):
    """Responses and attractors over ``j_1`` and ``j_2`` [m], and the same over ``gap``.

    Parameters
    ----------
    answer : callable
        From label, frequency [Hz] and number of the start to a Response.
    """
    study = tables(label, omega)
    study["sweep"][0]["gap"] = [[a, b] for a in j_1 for b in j_2]
    files = datasets(folder, study, answer)
    return [_unstacked(ds, j_1, j_2) for ds in files], files


def _unstacked(ds, j_1, j_2):
    def split(variable):
        at = variable.dims.index("gap")
        dims = (*variable.dims[:at], "j_1", "j_2", *variable.dims[at + 1 :])
        shape = (*variable.shape[:at], len(j_1), len(j_2), *variable.shape[at + 1 :])
        return dims, variable.values.reshape(shape), variable.attrs

    coordinates = {n: c for n, c in ds.coords.items() if "gap" not in c.dims}
    walls = {"j_1": ("j_1", j_1, WALL), "j_2": ("j_2", j_2, WALL)}
    variables = {n: split(v) if "gap" in v.dims else v for n, v in ds.data_vars.items()}
    return xr.Dataset(variables, {**coordinates, **walls}, ds.attrs)
