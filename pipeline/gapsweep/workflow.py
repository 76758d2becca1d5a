"""The whole path of a study: points, plan, responses, and then the files of the run.

Each step reads what the one before it stored; `gapsweep.make` makes the files.
Dask, numba, xarray and matplotlib are imported by the steps that need them: a run that finds
everything up to date ends before they would be loaded.
"""

import os
import warnings
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gapsweep.analysis.unit_check import never_reached
from gapsweep.console import progress_bar
from gapsweep.errors import StoreError
from gapsweep.execution.assemble import attributes_of, fill
from gapsweep.execution.plan import Plan
from gapsweep.execution.plan import plan as make_plan
from gapsweep.execution.progress import DEFAULT_TIMEOUT, OnProgress, Progress, tell
from gapsweep.execution.recorder import Recorder
from gapsweep.folder import check_owner, check_writable, run_folder
from gapsweep.lookup import cache_path, plan
from gapsweep.make import failed_motions, try_out_own_laws, update, update_points
from gapsweep.own_code import check_modules
from gapsweep.stages import RESPONSES, stages_of
from gapsweep.status import Status
from gapsweep.store import netcdf
from gapsweep.store.artefact import alone_in
from gapsweep.store.cache import Cache
from gapsweep.study.grid import Selection
from gapsweep.study.study import Study

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run left behind.

    Attributes
    ----------
    folder : Path
    progress : Progress
    failures : mapping of str to int
        Number of sweep points per failure status.
    failed_motions : mapping of str to mapping
        By file, the number of motions in it per failure status.
    walls : str
        In which cases the exact law touches no wall; empty if in none.
    """

    folder: Path
    progress: Progress
    failures: Mapping[str, int]
    failed_motions: Mapping[str, Mapping[str, int]]
    walls: str


def run(
    study: Study | str | os.PathLike[str],
    client: "Client | None" = None,
    *,
    out: str | Path | None = None,
    cache: str | Path | None = None,
    workers: int = 2,
    scheduler: str | None = None,
    batch: int | None = None,
    timeout: float = DEFAULT_TIMEOUT,
    retry_failed: bool = False,
    on_progress: OnProgress | None = None,
) -> "xr.Dataset":
    """Compute a study, store its datasets and report, and open the responses.

    Only what the cache does not hold is computed; an interrupted run goes on where it was.

    Parameters
    ----------
    study : Study or path
        A study, or the path of its file.
    client : distributed.Client, optional
        A Dask cluster to use; None starts a local one, or joins `scheduler`.
    out : path, optional
        Output folder, ``data/runs/<study name>`` if None.
    cache : path, optional
        Folder of the cache; see `cache_path`.
    workers : int
        Processes of the local cluster.
    scheduler : str, optional
        Address of a running Dask scheduler.
    batch : int, optional
        Points per task; None lets measured costs decide.
    timeout : float
        Time [s] that one point may take before it is given up as ``timed_out``.
    retry_failed : bool
        Compute points again whose stored outcome is a failure.
    on_progress : callable, optional
        Observer of the `Progress`; None shows a bar.

    Returns
    -------
    Dataset
        ``responses.nc``, opened.

    Raises
    ------
    GapsweepError
        If the cluster, the cache or the output folder cannot be used.

    Examples
    --------
    >>> import gapsweep as gs
    >>> block = {"representation": "piecewise", "K_c": 1e4, "gap": [4e-4, 4e-4], "omega": 9.0}
    >>> study = gs.Study.from_dict({"study": {"name": "small"}, "sweep": [block]})
    >>> with gs.run(study, out="small", cache="points") as ds:
    ...     ds["amplitude"].dims
    ('representation', 'K_c', 'gap', 'omega', 'initial_condition')
    """
    study = Study.of(study)
    with progress_bar() if on_progress is None else nullcontext(on_progress) as observer:
        outcome = carry_out(
            study,
            client,
            out=out,
            cache=cache,
            workers=workers,
            scheduler=scheduler,
            batch=batch,
            timeout=timeout,
            retry_failed=retry_failed,
            on_progress=observer,
        )
    if outcome.walls:
        warnings.warn(outcome.walls, stacklevel=2)
    found = netcdf.read(outcome.folder / RESPONSES)
    if found.attrs["study_json"] != study.json:  # since the folder was let go
        found.close()
        raise StoreError(
            f"{outcome.folder}: another run has put a study of the same name there: name another "
            "folder with out="
        )
    return found


def carry_out(
    study: Study,
    client: "Client | None" = None,
    *,
    out: str | Path | None = None,
    cache: str | Path | None = None,
    on_progress: OnProgress | None = None,
    timeout: float = DEFAULT_TIMEOUT,
    retry_failed: bool = False,
    **how: Any,
) -> Outcome:
    """`run`, with the outcome instead of the dataset."""
    folder, path = run_folder(study, out), cache_path(cache)
    check_writable(folder)
    check_owner(study, folder)
    planned = plan(study, path, retry_failed=retry_failed, timeout=timeout, on_progress=on_progress)
    if planned.n_missing:
        check_modules(study)  # now, though what they make comes last
    with Recorder(folder, study, path, planned, on_progress) as recorder:

        def begin() -> None:
            # Whoever comes next sees at once whose folder it is, not when this one has computed.
            with alone_in(folder):
                check_owner(study, folder)
                recorder.write()

        how |= {"timeout": timeout, "retry_failed": retry_failed, "begin": begin}
        progress = _computed(study, client, planned, path, recorder, **how)
        say = partial(tell, recorder, progress)
        recorder.write()
        with alone_in(folder):
            check_owner(study, folder)
            with Cache(path, read_only=True) as store:
                # Even if nothing was missing: rows may have been deleted meanwhile.
                planned = _as_stored(planned, store)
                given = update_points(study, planned, store, folder, say)
            failures = _failures(planned)
            del planned, store  # a tenth of a gigabyte of keys at a million points
            update(
                study,
                folder,
                given,
                n_points=progress.n_points,
                cache=path,
                connect=partial(_connected, client, how.get("workers", 2), how.get("scheduler")),
                timeout=timeout,
                retry_failed=retry_failed,
                say=say,
            )
    walls = ""
    if study.spec.system is None:
        values, grid = partial(netcdf.values, folder / RESPONSES), study.grid
        walls = never_reached(values, grid.dims, grid.representations)
    motions = {stage.file: failed_motions(folder / stage.file) for stage in stages_of(study)}
    failed = {file: counts for file, counts in motions.items() if counts}
    return Outcome(folder, progress, failures, failed, walls)


def query(
    study: Study | str | os.PathLike[str],
    client: "Client | None" = None,
    *,
    cache: str | Path | None = None,
    workers: int = 2,
    scheduler: str | None = None,
    on_progress: OnProgress | None = None,
    **wanted: Any,
) -> "xr.Dataset":
    """Steady responses of a part of a study, from the cache; only what is missing is computed.

    A query whose points are all stored starts no cluster.

    Parameters
    ----------
    study : Study or path
        A study, or the path of its file.
    client, cache, workers, scheduler, on_progress
        As for `run`.
    **wanted
        What is wanted of the study's own points, by dimension, as ``omega=slice(7.0, 12.0)``: a
        value, a list or, for numbers, a slice that includes both ends. All if left out.

    Returns
    -------
    Dataset
        In memory, as ``responses.nc``, of the selected coordinates; attractors are numbered
        among the selected starts. Attributes `n_points`, `n_hits` and `n_computed` say where
        the points came from; those of a sweep that lead to a selected one count too.

    Raises
    ------
    GapsweepError
        If a value is not among the study's own, or cluster or cache cannot be used.

    Examples
    --------
    >>> import gapsweep as gs
    >>> block = {"representation": "piecewise", "K_c": 1e4, "gap": [4e-4, 4e-4], "omega": 9.0}
    >>> study = gs.Study.from_dict({"study": {"name": "small"}, "sweep": [block]})
    >>> ds = gs.query(study, cache="points", omega=9.0)
    >>> ds.attrs["n_points"], ds.attrs["n_computed"]
    (1, 1)
    """
    study = Study.of(study)
    selection, path = study.select(**wanted), cache_path(cache)
    with progress_bar() if on_progress is None else nullcontext(on_progress) as observer:
        try_out_own_laws(study, DEFAULT_TIMEOUT, partial(tell, observer, Progress(0, 0)))
        if path.exists():
            # One opening for both: to read what is stored of a million points takes .3 s.
            with Cache(path, read_only=True) as store:
                planned = make_plan(study, store, selection=selection)
                if not planned.n_missing:
                    done = Progress(planned.n_points, planned.n_hits)
                    return _exported(study, planned, store, selection, done)
        else:
            planned = make_plan(study, selection=selection)
        progress = _computed(
            study, client, planned, path, observer, workers=workers, scheduler=scheduler
        )
    with Cache(path, read_only=True) as store:
        return _exported(study, _as_stored(planned, store), store, selection, progress)


def _exported(
    study: Study, planned: Plan, store: Cache, selection: Selection, progress: Progress
) -> "xr.Dataset":
    """A part of a study from the cache, in memory, with where its points came from."""
    counts = {name: getattr(progress, name) for name in ("n_points", "n_hits", "n_computed")}
    with (
        netcdf.passing({}) as others,
        netcdf.passing(attributes_of(study)) as dataset,
    ):
        fill(dataset, others, study, planned, store, selection)
        return netcdf.loaded(dataset).assign_attrs(counts)


def _as_stored(planned: Plan, store: Cache) -> Plan:
    """A plan that has been carried out, with what is stored now."""
    status = store.status(planned.keys)
    if lost := int(np.sum(status < 0)):
        raise StoreError(
            f"{store.path}: {lost} points of this run are no longer stored: another process has "
            "removed them, or a disk failed: run again to resume"
        )
    return replace(planned, status=status)


def _computed(
    study: Study,
    client: "Client | None",
    planned: Plan,
    path: Path,
    on_progress: OnProgress | None,
    *,
    workers: int = 2,
    scheduler: str | None = None,
    begin: Callable[[], None] | None = None,
    **how: Any,
) -> Progress:
    """Compute what a plan misses; a cluster is started only if that is something.

    `begin` is called once it is there, before anything is computed.
    """
    if not planned.n_missing:
        if begin is not None:
            begin()
        return Progress(planned.n_points, planned.n_hits)
    before = Progress(planned.n_points, planned.n_hits)
    # Now, before anybody waits for workers.
    check_writable(path if path.exists() else path.parent, "a cache elsewhere with --cache")
    if client is None:
        tell(on_progress, before, f"joining {scheduler}" if scheduler else "starting the workers")
    from gapsweep.execution.execute import execute

    with _connected(client, workers, scheduler) as connected:
        if begin is not None:
            begin()
        with Cache(path) as store:
            try:
                done = execute(study, planned, store, connected, on_progress=on_progress, **how)
            except KeyboardInterrupt as interrupt:
                tell(on_progress, before, "interrupted, stopping")
                interrupt.add_note(f"{store.path} keeps what was computed: run again to resume")
                raise
        if client is None and not scheduler:
            tell(on_progress, done, "stopping the workers")
    return done


def _connected(
    client: "Client | None", workers: int, scheduler: str | None
) -> "AbstractContextManager[Client]":
    """The client of a call, or one of a cluster that is started or joined."""
    from gapsweep.execution.cluster import cluster

    return nullcontext(client) if client is not None else cluster(workers, scheduler)


def _failures(planned: Plan) -> dict[str, int]:
    counts = {s.label: int(np.sum(planned.status == s)) for s in Status if s.failed}
    return {label: n for label, n in counts.items() if n}
