"""Branches of periodic orbits in all scenes of a study: ``branches.nc``.

A scene is all that is swept but the parameter of the branches and the initial states. Its branches
start from its periodic attractors. They are stored next to the cache by content, one file a scene,
so that a run that was interrupted computes only the scenes that it lacks.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.analysis.branch_agreement import special_points
from gapsweep.continuation.branches import Attractor
from gapsweep.continuation.call import DEFAULT_ATOL, DEFAULT_RTOL
from gapsweep.continuation.dataset import ATTRACTOR, BRANCH, OF_BRANCH, VARIABLES
from gapsweep.continuation.family import Window
from gapsweep.errors import StoreError
from gapsweep.execution.branch_tasks import Followed, Scene, followed
from gapsweep.response.result import ResponseClass
from gapsweep.status import Status
from gapsweep.store import netcdf
from gapsweep.study.grid import START
from gapsweep.study.schema import coordinates
from gapsweep.study.spec import is_followed
from gapsweep.study.study import Study
from gapsweep.user_code.package_digest import numerics_fingerprint
from gapsweep.variables import SECTION_POINT, STATUS_FLAGS, Variable

SCENE, FOLDER = "scene", "branches"
_NONE = np.zeros((0, 2), np.intp)
TABLES = {
    "branch_scene": Variable("i4", "1", "number of the scene"),
    "attractor_number": Variable("i4", "1", "number of the attractor in its scene"),
    "attractor_on_branch": Variable("i4", "1", "branch that the attractor lies on, -1: none"),
    "scene_status": Variable("i1", "1", "outcome of the scene", Status.NOT_REQUESTED, STATUS_FLAGS),
    "scene_message": Variable("str", "1", "why the scene has no branches"),
    "scene_n_lost": Variable("i4", "1", "orbits and special points not found"),
}

Places = Mapping[str, int]


def branches(
    study: Study,
    attractors: xr.Dataset,
    cache: Path,
    connect: Callable[[], AbstractContextManager[Any]],
    timeout: float,
    say: Callable[[str], None],
) -> xr.Dataset:
    """Branches of all scenes of a study.

    Parameters
    ----------
    study : Study
        With a table ``[branches]``.
    attractors : Dataset
        ``attractors.nc`` of the study.
    cache : Path
        Folder of the cache.
    connect : callable
        Starts or joins a cluster; called if scenes are missing.
    timeout : float
        Time [s] that a scene with user code may take.
    say : callable
        Called with the progress.
    """
    scenes = list(_scenes(study, attractors))
    found: dict[int, Followed] = {}
    missing = []
    for number, (_, _, scene) in enumerate(scenes):
        path = _path(cache, scene)
        if not scene.attractors:
            found[number] = Followed(Status.OK, "no periodic attractor")
        elif (stored := _stored(path)) is not None:
            found[number] = Followed(Status.OK, branches=stored)
        else:
            missing.append(number)
    if missing:
        with connect() as client:
            tasks = [scenes[number][2] for number in missing]
            for i, one in followed(tasks, client, timeout, lambda: say("waiting for workers")):
                found[missing[i]] = one
                if one.branches is not None:
                    netcdf.write(one.branches, _path(cache, tasks[i]), {})
                say(f"making branches.nc, {len(found)} of {len(scenes)} scenes")
    where = [(at, numbers) for at, numbers, _ in scenes]
    return _assembled(study, where, [found[number] for number in range(len(scenes))])


def _path(cache: Path, scene: Scene) -> Path:
    """Where the branches of a scene are stored; the folder has a digest of this file alone."""
    return cache / FOLDER / scene.key / "scene.nc"


def _stored(path: Path) -> xr.Dataset | None:
    """Branches that are stored; None if they are not, or are damaged."""
    try:
        return netcdf.read(path) if path.exists() else None
    except StoreError:
        return None


def _scenes(
    study: Study, attractors: xr.Dataset
) -> Iterator[tuple[Places, NDArray[np.intp], Scene]]:
    """The scenes of a study: place on their axes, places of their attractors, and the scene."""
    table, grid = study.spec.branches, study.grid
    assert table is not None
    along, axes = table.along, grid.axes
    dims = [name for name in grid.dims if name not in (along, START)]
    window = Window.of(along, (min(axes[along]), max(axes[along])))
    order = [grid.dims.index(name) for name in (*dims, along, START)]
    requested = grid.requested.transpose(order)
    is_orbit = attractors["response_class"].transpose(*dims, along, ATTRACTOR).values
    is_orbit = is_orbit == ResponseClass.PERIODIC
    for place in np.ndindex(*(len(axes[name]) for name in dims)):
        at = dict(zip(dims, place, strict=True))
        label = axes["representation"][at["representation"]]
        if not is_followed(label) or not requested[place].any():
            continue
        first = np.argwhere(requested[place])[0].tolist()
        cell = at | dict(zip((along, START), first, strict=True))
        flat = np.ravel_multi_index([cell[name] for name in grid.dims], grid.shape)
        ((_, point),) = study.points(np.array([flat]))
        numbers = np.argwhere(is_orbit[place])
        some = {n: axes[n][i] for n, i in at.items() if n in study.spec.model}
        omega = axes["omega"][at["omega"]] if "omega" in at else None
        yield (
            at,
            numbers,
            Scene(
                model=study.model.along(along, some),
                point=point,
                omega=omega,
                window=window,
                table=table,
                attractors=tuple(_attractors(study, attractors.isel(at), along, numbers)),
            ),
        )


def _attractors(
    study: Study, here: xr.Dataset, along: str, numbers: NDArray[np.intp]
) -> Iterator[Attractor]:
    """The periodic attractors of a scene, by their number along the parameter and in its scene."""
    names = [name for name in ("section_x", "section_v", "section_z") if name in here]
    here = here[[*names, "period_multiple", *(["period"] if "period" in here else [])]].load()
    for i, k in numbers.tolist():
        one = here.isel({along: i, ATTRACTOR: k})
        parts = [one[name].transpose(SECTION_POINT, ...).values for name in names]
        section = np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1)
        yield Attractor(
            value=study.grid.axes[along][i],
            section=section[np.isfinite(section).all(axis=1)],
            period=float(one.get("period", np.nan)),
            multiple=int(one["period_multiple"]),
        )


def _assembled(
    study: Study, where: list[tuple[Places, NDArray[np.intp]]], found: list[Followed]
) -> xr.Dataset:
    """One dataset of the branches of all scenes."""
    table = study.spec.branches
    assert table is not None
    scenes, numbers = [at for at, _ in where], np.concatenate([_NONE, *(n for _, n in where)])
    parts, lies_on, sizes, lost, n_branches = [], [np.zeros(0, int)], [], [], 0
    for one, (_, some) in zip(found, where, strict=True):
        on, size = np.full(len(some), -1), 0
        if (part := one.branches) is not None:
            size, on = part.sizes[BRANCH], part["attractor_on_branch"].values
            part[BRANCH] = part[BRANCH] + n_branches
            parent = part["parent"]
            parent[:] = np.where(parent < 0, -1, parent + n_branches)
            parts.append(part.drop_dims(ATTRACTOR))
        lost.append(0 if part is None else part.attrs["n_lost"])
        lies_on.append(np.where(on < 0, -1, on + n_branches))
        sizes.append(size)
        n_branches += size
    made = _joined(parts)
    described = coordinates(study.grid.dims, study.structure)

    def of_scenes(dim: str, which: NDArray[np.intp], prefix: str) -> Iterator[tuple[str, Any]]:
        """Coordinates that say in which scenes the entries of a dimension are."""
        values = study.grid.coordinates()
        for name, (along, variable) in described.items():
            if len(along) == 1 and along[0] in (scenes[0] if scenes else ()):
                at = np.array([place[along[0]] for place in scenes])[which]
                yield prefix + name, (dim, values[name][at], variable.attributes)

    every = np.arange(len(scenes))
    made = made.assign_coords(
        {
            **dict(of_scenes(BRANCH, np.repeat(every, sizes), "")),
            **dict(of_scenes(SCENE, every, "scene_")),
            **dict(
                of_scenes(ATTRACTOR, np.repeat(every, [len(n) for _, n in where]), "attractor_")
            ),
            f"attractor_{table.along}": (
                ATTRACTOR,
                np.asarray(study.grid.axes[table.along])[numbers[:, 0]],
                described[table.along][1].attributes,
            ),
        }
    )
    columns = {
        "branch_scene": (BRANCH, np.repeat(every, sizes)),
        "attractor_number": (ATTRACTOR, numbers[:, 1]),
        "attractor_on_branch": (ATTRACTOR, np.concatenate(lies_on)),
        "scene_status": (SCENE, [int(one.status) for one in found]),
        "scene_message": (SCENE, np.array([one.message for one in found], str)),
        "scene_n_lost": (SCENE, lost),
    }
    for name, (dim, values) in columns.items():
        form = TABLES[name]
        made[name] = (dim, np.asarray(values, form.dtype), form.attributes)
    made = made.merge(special_points(made, table.along), combine_attrs="override")
    axis = study.grid.axes[table.along]
    settings = {"rtol": DEFAULT_RTOL, "atol": DEFAULT_ATOL, **table.model_dump(exclude_none=True)}
    return made.assign_attrs(
        **study.attributes,
        numerics_fingerprint=numerics_fingerprint(),
        between=[min(axis), max(axis)],
        **settings,
    )


def _joined(parts: list[xr.Dataset]) -> xr.Dataset:
    """Branches one after the other; missing values behind the ends of shorter ones."""
    if not parts:
        return xr.Dataset(coords={BRANCH: np.zeros(0, int)})
    missing = {name: each.missing for name, each in (VARIABLES | OF_BRANCH).items()}
    fill = {name: missing.get(str(name), np.nan) for name in parts[0].data_vars}
    made = xr.concat(parts, BRANCH, join="outer", fill_value=fill, combine_attrs="override")
    return made.astype({name: parts[0][name].dtype for name in fill}).drop_attrs(deep=False)
