"""Branches of periodic orbits in all cases of a study, and curves of their special points.

A case has one value of every swept parameter, except the parameter of the branches and the initial
states. Its branches (``branches.nc``) begin at its periodic attractors, its curves (``curves.nc``)
at the special points of its branches. Each case has a file next to the cache, by content key, so
that an interrupted run computes only the missing cases.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.analysis.agreement.branch_agreement import MATCH, compared
from gapsweep.continuation.curves import KINDS
from gapsweep.continuation.dataset import (
    ATTRACTOR,
    BRANCH,
    OF_BRANCH,
    OF_CURVE,
    VARIABLES,
    of_attractors,
    special_points,
)
from gapsweep.continuation.family import Window
from gapsweep.continuation.follow import DEFAULT_RTOL
from gapsweep.continuation.seed import Attractor
from gapsweep.errors import StoreError
from gapsweep.execution.branch_tasks import BranchScene, Followed, followed
from gapsweep.response.result import ResponseClass
from gapsweep.status import Status
from gapsweep.store import netcdf
from gapsweep.study.grid import START
from gapsweep.study.schema import coordinates
from gapsweep.study.spec import WALLS
from gapsweep.study.study import Study
from gapsweep.user_code.package_digest import numerics_fingerprint
from gapsweep.variables import POINT, SECTION_POINT, STATUS_FLAGS, Variable

FOLDER = "branches"
_attractor = partial(Variable, dims=(ATTRACTOR,))
OF_STUDY = {
    "n_lost": Variable(
        "i4", "1", "orbits and special points of the case that were not found", dims=(BRANCH,)
    ),
    "attractor_number": _attractor("i4", "1", "number of the attractor of the case"),
    "attractor_status": _attractor(
        "i1", "1", "outcome of the case of the attractor", flags=STATUS_FLAGS
    ),
    "attractor_message": _attractor("str", "1", "reason why the case has no branches"),
}


@dataclass(slots=True, kw_only=True)
class _SceneBranches:
    """A case of a study, and the result of the continuation of its branches."""

    at: Mapping[str, int]  # position of the case on the axes of the study
    # Shape (n, 2); positions of its n periodic attractors along the parameter and in
    # ``attractors.nc``.
    numbers: NDArray[np.intp]
    scene: BranchScene  # inputs of the continuation
    found: Followed  # its outcome, with the branches or curves


def branches(
    study: Study,
    attractors: xr.Dataset,
    cache: Path,
    connect: Callable[[], Any],
    timeout: float,
    say: Callable[[str], None],
    meanwhile: Iterable[bool],
    followed_branches: xr.Dataset | None = None,
) -> xr.Dataset:
    """Branches of all cases of a study, or the curves of their special points.

    Parameters
    ----------
    study : Study
        With a table ``[branches]``.
    attractors : Dataset
        ``attractors.nc`` of the study.
    cache : Path
        Folder of the cache.
    connect : callable
        Returns the client of a cluster; called if cases are missing.
    timeout : float
        CPU time limit of a case with user code [s].
    say : callable
        Called with the progress.
    meanwhile : iterable of bool
        Other work of this process, a step each while no case has arrived.
    followed_branches : Dataset, optional
        ``branches.nc`` of the study, to return the curves of its special points. Cases that failed
        in it have none; branches missing in the cache are recomputed.
    """
    parts = [part for part in cases(study, attractors) if part.scene.attractors]
    is_curves = followed_branches is not None
    if followed_branches is not None:
        first = np.cumsum([0, *(len(part.numbers) for part in parts)])[:-1]
        status = followed_branches["attractor_status"].values[first]
        parts = [part for part, one in zip(parts, status, strict=True) if not Status(one).failed]
    for file in ("branches.nc", "curves.nc")[: 1 + is_curves]:
        if file == "curves.nc":
            parts = [part for part in map(_with_points, parts) if part.scene.points]
        # Cases with equal inputs, as of laws without a swept parameter, are computed once.
        missing: dict[Path, list[_SceneBranches]] = {}
        for part in parts:
            # Each case has its folder, so that SHA256SUMS has one writer.
            path = cache / FOLDER / part.scene.key / "scene.nc"
            with suppress(StoreError):
                part.found = Followed(Status.OK, branches=netcdf.read(path))
            if part.found.branches is None:
                missing.setdefault(path, []).append(part)
        if missing:
            paths = [*missing]
            tasks = [several[0].scene for several in missing.values()]
            waiting = partial(say, "waiting for workers")
            n_stored = len(parts) - len(missing)
            # Closed here, also by an error: once the cluster has ended, nothing can be cancelled.
            with closing(followed(tasks, connect(), timeout, waiting, meanwhile)) as arriving:
                for n_done, (number, found) in enumerate(arriving, n_stored + 1):
                    path = paths[number]
                    for part in missing[path]:
                        own = found.branches and found.branches.copy(deep=True)
                        part.found = replace(found, branches=own)
                    if found.branches is not None:
                        netcdf.write(found.branches, path, {})
                    say(f"making {file}, {n_done} of {len(parts)} cases")
    return _assembled(study, parts, is_curves=is_curves)


def _with_points(part: _SceneBranches) -> _SceneBranches:
    """A case with those special points of its branches that have curves; None: it has none."""
    points = part.found.branches and special_points(part.found.branches)
    points = points and points.isel({POINT: np.isin(points["special"], KINDS)})
    points = points if points and points.sizes[POINT] else None
    return replace(part, scene=replace(part.scene, points=points), found=Followed(Status.OK))


def cases(study: Study, attractors: xr.Dataset) -> Iterator[_SceneBranches]:
    """Yield the requested cases that can be continued, each with its periodic attractors."""
    table, grid = study.spec.branches, study.grid
    assert table is not None
    along, axes = table.along, grid.axes
    dims = [name for name in grid.dims if name not in (along, START)]
    laws = enumerate(axes["representation"])
    followed = [i for i, law in laws if study.model.is_followed(law, along)]
    order = [grid.dims.index(name) for name in (*dims, along, START)]
    requested = grid.requested.transpose(order)
    # Blocks with other laws only have the value of an elastic contact.
    of_laws = np.moveaxis(requested.take(followed, dims.index("representation")), -2, 0)
    values = np.array(axes[along])[of_laws.any(axis=tuple(range(1, of_laws.ndim)))]
    window = Window.of(along, (values.min(), values.max()))
    kind = attractors["response_class"].transpose(*dims, along, ATTRACTOR).values
    for place in np.ndindex(*requested.shape[:-2]):
        at = dict(zip(dims, place, strict=True))
        if at["representation"] not in followed or not requested[place].any():
            continue
        cell = at | dict(zip((along, START), np.argwhere(requested[place])[0], strict=True))
        flat = np.ravel_multi_index([cell[name] for name in grid.dims], grid.shape)
        ((_, point),) = study.points(np.array([flat]))
        numbers = np.argwhere(kind[place] == ResponseClass.PERIODIC)
        some = {name: axes[name][i] for name, i in at.items() if name in study.spec.model}
        scene = BranchScene(
            point=point,
            system=study.model.along((along, table.second or ""), some),
            window=window,
            table=table,
            attractors=tuple(_attractors(attractors.isel(at), along, numbers)),
        )
        yield _SceneBranches(at=at, numbers=numbers, scene=scene, found=Followed(Status.OK))


def _attractors(here: xr.Dataset, along: str, numbers: NDArray[np.intp]) -> Iterator[Attractor]:
    """The periodic attractors of a case."""
    sections = [name for name in ("section_x", "section_v", "section_z") if name in here]
    names = [name for name in ("period_multiple", "period", "x_max") if name in here]
    # Arrays, since every selection from a Dataset takes longer than the rest.
    found = {
        name: here[name].transpose(along, ATTRACTOR, *own, ...).values
        for several, own in ((sections, [SECTION_POINT]), (names, []))
        for name in several
    }
    values = here[along].values
    for i, k in numbers.tolist():
        columns = [found[name][i, k] for name in sections]
        section = np.concatenate([each.reshape(len(each), -1) for each in columns], axis=1)
        yield Attractor(
            value=float(values[i]),
            section=section[np.isfinite(section).all(axis=1)],
            period=float(found["period"][i, k]) if "period" in found else np.nan,
            multiple=int(found["period_multiple"][i, k]),
            x_max=np.ravel(found["x_max"][i, k])[0].item(),
        )


def _assembled(study: Study, parts: list[_SceneBranches], *, is_curves: bool) -> xr.Dataset:
    """The dataset of the branches, or of the curves, of all cases."""
    table, grid = study.spec.branches, study.grid
    assert table is not None
    columns: dict[str, list[Any]] = {name: [] for name in OF_STUDY}
    several: list[xr.Dataset] = []
    on_branch: list[int] = []
    of_branch: list[Mapping[str, int]] = []
    of_attractor: list[Mapping[str, int]] = []
    for part in parts:
        n, before = len(part.numbers), len(of_branch)
        on = np.full(n, -1)
        if (found := part.found.branches) is not None:
            on = on if is_curves else found["attractor_on_branch"].values
            size, parent = found.sizes[BRANCH], found["parent"]
            parent[:] = np.where(parent < 0, -1, parent + before)
            several.append(found.drop_dims(ATTRACTOR).drop_vars(BRANCH))
            columns["n_lost"] += size * [found.attrs["n_lost"]]
            of_branch += size * [part.at]
        on_branch += np.where(on < 0, -1, on + before).tolist()
        columns["attractor_number"] += part.numbers[:, 1].tolist()
        columns["attractor_status"] += n * [part.found.status]
        columns["attractor_message"] += n * [part.found.message]
        of_attractor += [{**part.at, table.along: i} for i in part.numbers[:, 0].tolist()]
    scenes = [] if is_curves else [(part.at, part.found.branches) for part in parts]
    matches, of_match = compared(scenes, grid.representations, table.along)
    attractors = [each for part in parts for each in part.scene.attractors]
    own = of_attractors(attractors, study.structure.n_states)
    made = _joined(several).merge(matches).assign(own)
    made["attractor_on_branch"][:] = on_branch
    for name, form in OF_STUDY.items():
        made[name] = (form.dims, np.array(columns[name], form.dtype), form.attributes)
    described, values = coordinates(grid.dims, grid.structure, grid.units), grid.coordinates()
    others = {"second", "range"}
    if is_curves:  # the second parameter is a variable; attractors are there for their statuses
        swept, others = {*WALLS} if table.second in WALLS else {table.second}, set()
        described = {name: form for name, form in described.items() if name not in swept}
        made = made.drop_vars(["attractor_on_branch", *matches])
    places = (BRANCH, "", of_branch), (ATTRACTOR, "attractor_", of_attractor)
    for dim, prefix, where in (*places, (MATCH, "match_", of_match)):
        for name, (over, variable) in described.items():
            if where and {*over} <= {*where[0]}:
                at = [place[over[0]] for place in where]
                made.coords[prefix + name] = (dim, values[name][at], variable.attributes)
    made.coords[BRANCH] = np.arange(made.sizes[BRANCH])
    made.coords.update({name: list(of) for name, of in grid.parts.items() if name in made.dims})
    axis = grid.axes[table.along]
    settings = {"rtol": DEFAULT_RTOL, **table.model_dump(exclude_none=True, exclude=others)}
    return made.assign_attrs(
        **study.attributes,
        numerics_fingerprint=numerics_fingerprint(),
        between=[min(axis), max(axis)],
        initial_conditions="attractors.nc; other initial conditions may lead to further branches",
        **settings,
    )


def _joined(several: list[xr.Dataset]) -> xr.Dataset:
    """Concatenated branches of all cases; shorter branches are padded with missing values."""
    if not several:
        return xr.Dataset({"stable": ((BRANCH, "step"), np.zeros((0, 0), np.int8))})
    missing = {name: each.missing for name, each in (VARIABLES | OF_BRANCH | OF_CURVE).items()}
    first = several[0]
    fill = {name: missing.get(str(name), np.nan) for name in first.data_vars}
    made = xr.concat(several, BRANCH, join="outer", fill_value=fill, combine_attrs="override")
    return made.astype({name: first[name].dtype for name in fill}).drop_attrs(deep=False)
