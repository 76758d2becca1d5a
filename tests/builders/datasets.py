"""Made-up responses and branches, and datasets of them through the real cache and export."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from gapsweep import Response, ResponseClass, Status, Study
from gapsweep.execution.assemble import export
from gapsweep.execution.plan import plan
from gapsweep.store.cache import Cache
from tests.builders.cache import commit
from tests.builders.studies import PAPER

COST = {"n_steps": 10, "nfev": 100, "n_rejected": 0, "n_contacts": 4, "cpu_time": 0.5}

KINDS = (
    "none fold period_doubling torus branch_point grazing symmetry_breaking hopf unresolved cusp"
)

FORCING = {"units": "N", "long_name": "forcing amplitude"}
WALL = {"units": "m", "long_name": "distance of the wall from the origin"}


def branches(stable, special, **coordinates):
    """Branches whose peak [m] is the number of the step plus ten times that of the branch."""
    stable, special = np.array(stable, "i1"), np.array(special, "i1")
    dims, there = ("branch", "step"), stable >= 0
    branch, step = np.indices(stable.shape)
    x = np.where(there, 1e-3 * (step + 10 * branch), np.nan)
    metres = {"units": "m", "long_name": "displacement"}
    return xr.Dataset(
        {
            "omega": (dims, np.where(there, 5.0 + 0.5 * step, np.nan), {"units": "Hz"}),
            "period": (dims, np.where(there, 0.2, np.nan), {"units": "s"}),
            "x_max": (dims, x, metres),
            "x_min": (dims, -x, metres),
            "period_multiple": (dims, there.astype("i4") * (1 + branch)),
            "stable": (dims, stable),
            "special": (dims, special, {"flag_meanings": KINDS, "flag_values": np.arange(10)}),
        },
        {
            "branch": np.arange(len(stable)),
            "step": np.arange(stable.shape[1]),
            **{n: ("branch", v) for n, v in coordinates.items()},
        },
        {"along": "omega"},
    )


def motion(kind, section, omega, extrema=None, **changes):
    """A response with these section points ``(x, v / (2π ω))`` [m].

    Its extrema are the section's displacements and their opposites, if not given.
    """
    points = np.reshape(section, (-1, 2))
    x = np.array([*points[:, 0], *-points[:, 0]] if extrema is None else extrema, dtype=float)
    values: dict[str, Any] = {
        "status": Status.UNRESOLVED if kind is ResponseClass.UNRESOLVED else Status.OK,
        "response_class": kind,
        "period_multiple": len(points) if kind is ResponseClass.PERIODIC else 0,
        "section": tuple((points * (1.0, 2.0 * np.pi * omega)).ravel().tolist()),
        "extrema": tuple(x.tolist()),
        "extremum_kind": (1,) * len(x),
        "n_extrema": len(x),
        "x_max": float(x.max()),
        "x_min": float(x.min()),
        "amplitude": float(np.ptp(x)) / 2.0,
        "lyapunov": 1.0 if kind is ResponseClass.CHAOTIC else -1.0,
        "lyapunov_error": 0.1 if kind is ResponseClass.CHAOTIC else 0.0,
        "t_simulated": 10.0,
        "contact_share": 0.5,
        "contacts_per_period": 2.0,
        **COST,
    }
    return Response(**(values | changes))


def periodic(section, omega, extrema=None, **changes):
    return motion(ResponseClass.PERIODIC, section, omega, extrema, **changes)


def chaotic(section, omega, extrema=None, **changes):
    return motion(ResponseClass.CHAOTIC, section, omega, extrema, **changes)


def unresolved(section, omega, extrema=None, **changes):
    return motion(ResponseClass.UNRESOLVED, section, omega, extrema, **changes)


def failed(**changes):
    return Response(**({"status": Status.DIVERGED} | changes))


def tables(labels, omega, *, gap=(0.4e-3, 0.4e-3), starts=1, sweeps=(), **more):
    """A study of one stiffness and one gap with that many fixed starts, and sweeps."""
    block = {
        "representation": list(labels),
        "K_c": [1.4e4],
        "gap": [list(gap)],
        "omega": [float(w) for w in omega],
        "initial_condition": [[1e-5 * i, 0.0] for i in range(starts)],
    }
    blocks = [block, *({**block, "initial_condition": sweep} for sweep in sweeps)]
    return {"study": {"name": "made"}, "oscillator": PAPER, "sweep": blocks, **more}


def datasets(folder, study_tables, answer) -> tuple[xr.Dataset, xr.Dataset]:
    """Responses and attractors of a study whose points have been answered by a function.

    `answer`: from label, frequency [Hz] and number of the start to a Response; None: not in the
    cache.
    """
    study = Study.from_dict(study_tables)
    grid = study.grid

    def at(place):
        label, omega = grid.representations[place["representation"]], grid.omega[place["omega"]]
        return answer(label, omega, place["initial_condition"])

    return datasets_by_place(folder, study, at)


def exported(planned, folder):
    """Write both files of a plan; points without a result are interrupted."""
    planned.is_missing[:] = False
    for _ in export(planned, folder / "responses.nc", folder / "attractors.nc"):
        pass


def datasets_by_place(folder, study, at) -> tuple[xr.Dataset, xr.Dataset]:
    """Both datasets of a study, with responses from a function of a point's place by axis."""
    folder = Path(folder)
    shutil.rmtree(folder / "cache", ignore_errors=True)
    with Cache(folder / "cache") as cache:
        commit(cache, study, at)
        planned = plan(study, cache)
        exported(planned, folder)
    return tuple(
        xr.load_dataset(folder / f"{name}.nc", engine="netcdf4")
        for name in ("responses", "attractors")
    )


def over_forcing(folder, study, answer, values):
    """Responses and attractors over a dimension ``forcing`` [N] before the last one of points.

    `answer`: from label, frequency [Hz], number of the start and forcing [N] to a Response.
    """
    parts = [datasets(folder, study, lambda *at, f=f: answer(*at, f)) for f in values]
    axis = xr.DataArray(np.array(values), dims="forcing", name="forcing", attrs=FORCING)
    own = {"data_vars": "all", "coords": "minimal", "compat": "override", "join": "exact"}
    whole = [xr.concat(some, axis, **own) for some in zip(*parts, strict=True)]
    first = ("representation", "K_c", "gap", "omega", "forcing")
    return [ds.transpose(*first, "initial_condition", ..., missing_dims="ignore") for ds in whole]


def over_walls(folder, label, omega, j_1, j_2, answer):
    """Responses and attractors over ``j_1`` and ``j_2`` [m], and the same over ``gap``.

    `answer`: from label, frequency [Hz] and number of the start to a Response.
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
