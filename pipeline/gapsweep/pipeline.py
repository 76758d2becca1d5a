"""Functions that compute a study, and read or rewrite the files of its runs.

A run goes from the sweep points over a plan to stored responses, and then from file to file; each
step reads what the one before it stored.
Dask, numba, xarray and matplotlib are imported by the steps that need them: a run that finds
everything up to date ends before they would be loaded.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import cache as cached
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gapsweep.console import progress_bar
from gapsweep.errors import ClusterError, StoreError, StudyError
from gapsweep.execution.assemble import attributes_of, fill
from gapsweep.execution.explain import Explanation
from gapsweep.execution.explain import explain as explanations
from gapsweep.execution.plan import Plan
from gapsweep.execution.plan import plan as make_plan
from gapsweep.execution.progress import DEFAULT_TIMEOUT, OnProgress, Progress, tell
from gapsweep.execution.recorder import Recorder
from gapsweep.model.doubts import warn_of
from gapsweep.model.oscillator import called_as, checked, whole
from gapsweep.run_folder import (
    CLAIMS,
    RESPONSES,
    RISK,
    SECTIONS,
    STABILITY,
    TIMING,
    WORK_PRECISION,
    cache_path,
    check_owner,
    check_writable,
    locked_run,
    read_json,
    reason_to_make,
    run_folder,
)
from gapsweep.stages import (
    POINTS,
    RunContext,
    load_report,
    make_file,
    make_files,
    meanwhile,
    stages_of,
    write_page,
)
from gapsweep.status import Status
from gapsweep.store import netcdf
from gapsweep.store.artefact import alone_in
from gapsweep.store.cache import Cache
from gapsweep.study.axes import MAX_POINTS
from gapsweep.study.grid import Selection
from gapsweep.study.study import Study
from gapsweep.study.unit_check import doubts_of, doubts_of_run
from gapsweep.study_code import check_modules

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of a run: its folder, counts of points, failures and warnings."""

    folder: Path
    progress: Progress
    failures: Mapping[str, int]  # number of sweep points per failure status
    # By file, the number of motions in it per failure status.
    failed_motions: Mapping[str, Mapping[str, int]]
    # Warnings of numbers in another unit, and of cases in which no steady response touches a wall.
    doubts: tuple[str, ...]


@called_as("gs.run(study, workers=2)")
def run(
    study: Study | str | os.PathLike[str],
    client: Client | None = None,
    *,
    out: str | Path | None = None,
    cache: str | Path | None = None,
    workers: int = 2,
    scheduler: str | None = None,
    batch: int | None = None,
    timeout: float = DEFAULT_TIMEOUT,
    retry_failed: bool = False,
    on_progress: OnProgress | None = None,
) -> xr.Dataset:
    """Compute a study, store its datasets and report, and open the responses.

    Points in the cache are not recomputed, so that an interrupted run resumes.

    Parameters
    ----------
    study : Study or path
        A study, or the path of its file.
    client : distributed.Client, optional
        Dask cluster to use; None starts a local cluster, or joins `scheduler`.
    out : path, optional
        Output folder, ``data/runs/<study name>`` if None.
    cache : path, optional
        Folder of the cache; by default ``$GAPSWEEP_CACHE``, else ``data/cache``.
    workers : int
        Number of processes of the local cluster, 1 to 1024.
    scheduler : str, optional
        Address of a running Dask scheduler.
    batch : int, optional
        Points per task, ``>= 1``; None chooses it from measured costs.
    timeout : float
        CPU time limit of a point [s], ``> 0``; a point that exceeds it has status ``timed_out``.
    retry_failed : bool
        Whether to recompute points whose stored status is a failure.
    on_progress : callable, optional
        Called with the `Progress`; None shows a progress bar.

    Returns
    -------
    Dataset
        The opened file ``responses.nc``; see the page *Datasets* of the documentation.

    Raises
    ------
    GapsweepError
        If the cluster, the cache or the output folder cannot be used.

    Examples
    --------
    >>> import gapsweep as gs
    >>> block = {"representation": "piecewise", "K_c": 1e4, "gap": [4e-4, 4e-4], "omega": 9.0}
    >>> m = {"mass": 3.0, "omega_n": 5.0, "zeta": 0.03, "forcing": 4.0}
    >>> study = gs.Study.from_dict({"study": {"name": "small"}, "oscillator": m, "sweep": [block]})
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
    warn_of(outcome.doubts)
    found = netcdf.read(outcome.folder / RESPONSES)
    if found.attrs["study_json"] != study.json:  # since the folder was let go
        found.close()
        raise StoreError(
            f"{outcome.folder}: overwritten by another study of the same name; choose another "
            "folder with out="
        )
    return found


def carry_out(
    study: Study,
    client: Client | None = None,
    *,
    out: str | Path | None = None,
    cache: str | Path | None = None,
    on_progress: OnProgress | None = None,
    timeout: float = DEFAULT_TIMEOUT,
    retry_failed: bool = False,
    workers: int = 2,
    scheduler: str | None = None,
    batch: int | None = None,
    dashboard: bool = False,
) -> Outcome:
    """Compute a study as `run` does, and return the `Outcome` instead of the dataset."""
    _check_call(client, scheduler, workers=workers, batch=batch, timeout=timeout)
    folder, path = run_folder(study, out), cache_path(cache)
    check_writable(folder)
    check_owner(study, folder)
    _prepare(study, timeout, on_progress)
    planned = make_plan(study, _opened(path), retry_failed=retry_failed)
    stages = stages_of(study)
    if planned.n_missing:
        check_modules(study)  # before the computation, although their files come last
    say = partial(tell, on_progress, planned.progress)
    how: dict[str, Any] = {"workers": workers, "dashboard": dashboard, "meanwhile": load_report}
    with (
        Recorder(folder, study, path, planned, on_progress) as recorder,
        _connection(client, say, scheduler, **how) as connect,
        closing(
            meanwhile(
                of_points := RunContext(
                    folder, study, planned, cache=path, connect=connect, timeout=timeout
                )
            )
        ) as steps,
    ):

        def begin() -> None:
            # The state marks the folder as this study's before the computation begins.
            with alone_in(folder):
                check_owner(study, folder)
                recorder.write()

        progress = _computed(
            planned,
            path,
            recorder,
            connect,
            begin,
            timeout=timeout,
            retry_failed=retry_failed,
            batch=batch,
            meanwhile=steps,
        )
        recorder.write()
        say = partial(tell, recorder, progress)
        make = partial(make_files, n_points=progress.n_points, retry_failed=retry_failed)
        with alone_in(folder):
            check_owner(study, folder)
            exports = [stage for stage in stages if POINTS in stage.sources]
            make(exports, replace(of_points, say=say, exporting=steps))
            failures = _failures(planned)
            n_failed, why = sum(failures.values()), _reasons(planned)
            recorder.state = replace(recorder.state, failed=n_failed, message=why)
            run = replace(of_points, plan=None, say=say)
            make([stage for stage in stages if POINTS not in stage.sources], run)
    doubts = tuple(doubts_of_run(study, partial(netcdf.values, folder / RESPONSES)))
    motions = {stage.file: stage.failed_motions(folder) for stage in stages}
    failed = {file: counts for file, counts in motions.items() if counts}
    return Outcome(folder, progress, failures, failed, doubts)


def risk(
    model: Any, law: Any = None, uncertain: Any = None, *args: Any, **options: Any
) -> xr.Dataset:
    """Return probabilities of events, quantiles and Sobol indices with uncertain numbers.

    ``gs.risk(study)`` computes a study with ``[uncertain]`` and opens its ``risk.nc``;
    ``gs.risk(oscillator, law, uncertain, omega, ...)`` computes in this process, without a file.

    Parameters
    ----------
    model : Study or path, or Oscillator, System, or callable
        A study, with the options of `run` as further arguments; or a model. A callable returns it
        for keywords, as ``gs.systems.typical_section``.
    law : ContactLaw or mapping of str to ContactLaw
        As in `gapsweep.simulate`.
    uncertain : mapping of str to distribution
        Distributions as ``scipy.stats.norm(4e-4, 2e-5)``, with ``ppf`` and ``cdf``, by name: a
        field of the oscillator or the law, ``"gap"`` for both walls alike, ``"j_1"``, ``"j_2"``, a
        keyword of the callable, or an initial state, as ``"x_0"``, of systems ``"v_0[1]"``. Other
        numbers have the values of model and law.
    omega : float or array_like, optional
        Forcing frequencies [Hz]; None for an unforced system.
    x_0, v_0, q_0, z_0 : float or array_like
        Initial state where it is certain, as in `gapsweep.respond`.
    events : mapping of str to mapping, optional
        By name ``{"quantity": "amplitude", "above": 1e-3}``, with `above`, `below` or both, or
        ``{"response_class": "chaotic"}``. A quantity of one coordinate or contact is written
        ``"x_max[h]"``.
    quantities : sequence of str
        Variables of which quantiles and indices are wanted, in addition to those of events.
    samples, repeats : int
        Sobol points of a repeat, a power of two; independent repeats, from which intervals follow,
        at least 2. By default 1024 and 8.
    seed : int
        Seed of the scrambling; 1 by default.
    indices : bool
        Whether to compute Sobol indices, with ``d + 2`` times as many responses for d numbers.
    correlation : array_like, shape (d, d), optional
        Of the normal scores of the numbers (Gaussian copula); None: independent.
    engine, rtol, atol, steady
        As in `gapsweep.respond`.

    Returns
    -------
    Dataset
        `probability`, `low` and `high` over `event`; `quantile` over `quantity` and `level`;
        `first_order` and `total` over `event` and `number`; see *Datasets* in the documentation.

    Raises
    ------
    GapsweepError
        If an argument is invalid: a distribution that leaves the range of its number, for example.

    Examples
    --------
    >>> import gapsweep as gs, scipy.stats
    >>> law = gs.Piecewise(1.4e4, gs.Gap(4e-4, 4e-4))
    >>> gap = scipy.stats.norm(4e-4, 2e-5)
    >>> events = {"contact": {"quantity": "force_max", "above": 0.0}}
    >>> ds = gs.risk(
    ...     gs.systems.paper_oscillator(), law, {"gap": gap}, 9.0, events=events, samples=16
    ... )
    >>> ds["probability"].dims, float(ds["probability"][0, 0])
    (('omega', 'event'), 1.0)
    """
    if not isinstance(model, Study | str | os.PathLike):
        from gapsweep.analysis.datasets.risk import risk as of_call

        example = "gs.risk(oscillator, law, {'gap': scipy.stats.norm(4e-4, 2e-5)}, omega=9.0)"
        return called_as(example)(of_call)(model, law, uncertain, *args, **options)
    study = Study.of(model)
    if study.spec.uncertain is None:
        example = "write uncertain numbers, as gap = { normal = 0.4e-3, sd = 0.02e-3 }"
        raise StudyError(f"{study.source}: uncertain: missing; {example}")
    run(study, **options).close()
    return netcdf.read(run_folder(study, options.get("out")) / RISK)


@called_as("gs.plan(study)")
def plan(
    study: Study | str | os.PathLike[str],
    cache: str | Path | None = None,
    *,
    selection: Selection | None = None,
    retry_failed: bool = False,
    timeout: float = DEFAULT_TIMEOUT,
    on_progress: OnProgress | None = None,
) -> Plan:
    """Compare a study with a cache, without creating the cache or computing anything.

    Parameters
    ----------
    study : Study or path
        A study, or the path of its file.
    cache : path, optional
        Folder of the cache, as for `run`.
    selection : tuple of sequences of int, optional
        Part of the study, as `Study.select` returns it.
    retry_failed : bool
        Whether points with a stored failure count as missing.
    timeout : float
        Time [s] that a user's law may take where keys are made.
    on_progress : callable, optional
        Observer of the `Progress`.

    Returns
    -------
    Plan
        Numbers of points `n_points`, `n_hits`, `n_missing` and `n_failed`.

    Raises
    ------
    StudyError
        If a user's law ends its process or takes longer.

    Examples
    --------
    >>> import gapsweep as gs
    >>> block = {"representation": "piecewise", "K_c": 1e4, "gap": [4e-4, 4e-4], "omega": 9.0}
    >>> m = {"mass": 3.0, "omega_n": 5.0, "zeta": 0.03, "forcing": 4.0}
    >>> study = gs.Study.from_dict({"study": {"name": "small"}, "oscillator": m, "sweep": [block]})
    >>> gs.plan(study, cache="no-cache-yet")
    <Plan: 1 sweep points, 0 in the cache, 1 missing, 0 failed>
    """
    study = Study.of(study)
    _check_call(timeout=timeout)
    _prepare(study, timeout, on_progress)
    warn_of(doubts_of(study))
    return make_plan(
        study, _opened(cache_path(cache)), selection=selection, retry_failed=retry_failed
    )


def _prepare(study: Study, timeout: float, on_progress: OnProgress | None) -> None:
    """Try out the user laws of a study before its keys are made."""
    say = partial(tell, on_progress, Progress(0, 0))
    _try_out_own_laws(study, timeout, say)
    say("looking up cached points")


def _opened(path: Path) -> Cache | None:
    """The cache in a folder; None if there is no folder."""
    return Cache(path, read_only=True) if path.exists() else None


def expected_seconds(plan: Plan, workers: int) -> float | None:
    """Expected time [s] of the missing points, from stored costs; None without stored costs.

    The mean cost of stored points of the same representation, or of all where there are none.
    """
    if plan.cache is None:
        return None
    n_left = plan.n_left.sum(axis=1)
    seconds, n_known = np.zeros((2, len(n_left)))
    for r, places in enumerate(np.split(plan.places, len(n_left))):
        cost = plan.cache.seconds(places)
        seconds[r], n_known[r] = np.nansum(cost), np.count_nonzero(np.isfinite(cost))
    if not n_known.any():
        return None
    mean = np.full(len(n_left), seconds.sum() / n_known.sum())
    np.divide(seconds, n_known, out=mean, where=n_known > 0)
    return float(n_left @ mean) / workers


def stage_reasons(study: Study, plan: Plan, out: str | Path | None) -> dict[str, str | None]:
    """Reason to make each file of a run, by file; None for files that are up to date."""
    folder = run_folder(study, out)
    reasons: dict[str, str | None] = {}
    run = RunContext(folder, study, plan=plan)
    for stage in stages_of(study):
        made = ", ".join(name for name in stage.inputs if reasons.get(name))
        if POINTS in stage.sources and (plan.n_missing or plan.cache is None):
            reason: str | None = "sweep points are missing"
        else:
            reason = reason_to_make(folder / stage.file, stage.made_from(folder, run))
        reasons[stage.file] = reason or (f"{made} will be made" if made else None)
    return reasons


def explain(
    study: Study,
    cache: str | Path | None,
    limit: int,
    on_progress: OnProgress | None = None,
    /,
    **wanted: Any,
) -> list[Explanation]:
    """Explain for the first `limit` selected points why they are in the cache or missing."""
    selection = study.select(**wanted)
    planned = plan(study, cache, selection=selection, on_progress=on_progress)
    return list(explanations(planned, limit))


def report(folder: str | Path, study: Study | None = None) -> Path:
    """Write ``report/index.html`` from the files of a run.

    Parameters
    ----------
    folder : path
        Folder of the run; no file in it is ever executed.
    study : Study, optional
        A study whose own sections are computed first; None shows the stored sections.

    Raises
    ------
    GapsweepError
        If the folder holds no run, one of its files is damaged, or the study has no sections.
    """
    folder = Path(folder).absolute()
    with locked_run(folder):
        if study is not None:
            _make_one(SECTIONS, Study.of(study), folder)
        return write_page(folder)


def claims(folder: str | Path, study: Study | None = None) -> dict[str, Any]:
    """The verdicts of a run, as stored, or decided by a study's claims module.

    Parameters
    ----------
    folder : path
        Folder of the run; no file in it is ever executed. Claims that need an absent dataset are
        undecidable.
    study : Study, optional
        A study whose claims are decided and written to ``claims.json``; None reads the file.

    Returns
    -------
    dict
        Content of ``claims.json``.

    Raises
    ------
    GapsweepError
        If there are no responses or no claims, or a file is damaged.
    """
    folder = Path(folder).absolute()
    with locked_run(folder):
        if study is not None:
            _make_one(CLAIMS, Study.of(study), folder)
        decided = read_json(folder / CLAIMS)
    if decided is None:
        raise StoreError(
            f"{folder / CLAIMS}: no verdicts for the responses of this run; evaluate the claims "
            f"of a study with 'gapsweep claims {folder} --study FILE'"
        )
    return decided


def _make_one(file: str, study: Study, folder: Path) -> None:
    """Rewrite ``claims.json`` or ``sections.json`` of a run by the user modules of a study."""
    check_owner(study, folder)
    stage = next((stage for stage in stages_of(study) if stage.file == file), None)
    if stage is None:
        table, name = ("claims", "claims.py") if file == CLAIMS else ("report", "figures.py")
        example = f'name a Python file, as [{table}] module = "{name}"'
        raise StudyError(f"{study.source}: {table}: missing; {example}")
    make_file(stage, RunContext(folder, study))


def bench(
    study: Study,
    out: str | Path | None = None,
    say: Callable[[str], None] | None = None,
    *,
    timeout: float = DEFAULT_TIMEOUT,
) -> dict[Path, Mapping[str, int]]:
    """Measure the ``[bench]`` of a study, and rewrite the report of its run if there is one.

    User laws run in an isolated process, all others in this process.

    Parameters
    ----------
    study : Study
    out : path, optional
        Output folder, ``data/runs/<study name>`` if None.
    say : callable, optional
        Called with a text before each measurement.
    timeout : float
        Time [s] that a call of a user's law may take, ``> 0``.

    Returns
    -------
    dict of Path to mapping
        Paths of ``work_precision.nc`` and ``stability.nc``, as far as the scenarios need them, each
        with the number of motions in which user code failed, by status.

    Raises
    ------
    GapsweepError
        If the study has no ``[bench]``, or the output folder cannot be used.
    """
    if study.spec.bench is None:
        raise StudyError(f"{study.source}: bench: missing; add [bench] with scenarios and methods")
    _check_call(timeout=timeout)
    folder = run_folder(study, out)
    check_writable(folder)
    study, say = Study.of(study), say or (lambda _: None)
    _try_out_own_laws(study, timeout, say)
    stages = [one for one in stages_of(study) if one.file in (WORK_PRECISION, STABILITY)]
    with alone_in(folder):
        check_owner(study, folder)
        for stage in stages:
            make_file(stage, RunContext(folder, study, timeout=timeout, say=say))
        if (folder / RESPONSES).exists() and (folder / TIMING).exists():
            write_page(folder)
    return {folder / stage.file: stage.failed_motions(folder) for stage in stages}


def _try_out_own_laws(study: Study, timeout: float, say: Callable[[str], None]) -> None:
    """Raise a StudyError for user laws that would end this process, or hang."""
    if study.own_laws:
        from gapsweep.execution.try_out import try_out

        try_out(study, timeout, say)


def query(
    study: Study | str | os.PathLike[str],
    client: Client | None = None,
    *,
    cache: str | Path | None = None,
    workers: int = 2,
    scheduler: str | None = None,
    on_progress: OnProgress | None = None,
    **wanted: Any,
) -> xr.Dataset:
    """Return steady responses of a part of a study; compute only points missing in the cache.

    If all points are cached, no cluster is started.

    Parameters
    ----------
    study : Study or path
        A study, or the path of its file.
    client, cache, workers, scheduler, on_progress
        As for `run`.
    **wanted
        Selection by dimension, as ``omega=slice(7.0, 12.0)``: a value of the study, a list of
        values or, for numbers, a slice that includes both ends. By default all points.

    Returns
    -------
    Dataset
        In memory, with the variables of ``responses.nc``; attractors are numbered among the
        selected initial conditions. The attributes `n_points`, `n_hits` and `n_computed` are the
        numbers of points, cached points and computed points, including the points of a sweep
        that lead to a selected point.

    Raises
    ------
    GapsweepError
        If the study has no such value, or cluster or cache cannot be used.

    Examples
    --------
    >>> import gapsweep as gs
    >>> block = {"representation": "piecewise", "K_c": 1e4, "gap": [4e-4, 4e-4], "omega": 9.0}
    >>> m = {"mass": 3.0, "omega_n": 5.0, "zeta": 0.03, "forcing": 4.0}
    >>> study = gs.Study.from_dict({"study": {"name": "small"}, "oscillator": m, "sweep": [block]})
    >>> ds = gs.query(study, cache="points", omega=9.0)
    >>> ds.attrs["n_points"], ds.attrs["n_computed"]
    (1, 1)
    """
    study = Study.of(study)
    _check_call(client, scheduler, workers=workers)
    selection, path = study.select(**wanted), cache_path(cache)
    with progress_bar() if on_progress is None else nullcontext(on_progress) as observer:
        _prepare(study, DEFAULT_TIMEOUT, observer)
        warn_of(doubts_of(study))
        planned = make_plan(study, _opened(path), selection=selection)
        say = partial(tell, observer, planned.progress)
        with _connection(client, say, scheduler, workers=workers) as connect:
            progress = _computed(planned, path, observer, connect)
    return _exported(planned, selection, progress)


def _check_call(
    client: Any = None,
    scheduler: str | None = None,
    *,
    workers: int = 1,
    batch: int | None = None,
    timeout: float = math.inf,
) -> None:
    """Raise an error for invalid arguments of a call, even if it would compute nothing."""
    whole("workers", workers, 1, 1024)
    if batch is not None:
        whole("batch", batch, 1, MAX_POINTS)
    if timeout != math.inf:
        checked("timeout", timeout, low=0.0, strict=True)
    if not isinstance(scheduler, str | None):
        raise ClusterError(f"scheduler = {scheduler!r:.80}: must be an address, as tcp://host:8786")
    if client is not None and not hasattr(client, "nthreads"):
        raise ClusterError(
            f"client = {client!r:.80}: must be a distributed.Client; select by name, as omega=9.0"
        )


def _exported(planned: Plan, selection: Selection, progress: Progress) -> xr.Dataset:
    """Dataset of a selection of a study from the cache, with the counts of points as attributes."""
    counts = {name: getattr(progress, name) for name in ("n_points", "n_hits", "n_computed")}
    with (
        netcdf.passing({}) as others,
        netcdf.passing(attributes_of(planned.study)) as dataset,
    ):
        fill(dataset, others, planned, selection)
        return netcdf.loaded(dataset).assign_attrs(counts)


def _computed(
    planned: Plan,
    path: Path,
    on_progress: OnProgress | None,
    connect: Callable[[], Client],
    begin: Callable[[], None] = lambda: None,
    **how: Any,
) -> Progress:
    """Compute the missing points of a plan; without missing points no cluster is started.

    `begin` is called once: before the computation, when the cluster is connected, or at once if
    no point is missing.
    """
    before = planned.progress
    if not planned.n_missing:
        begin()
        return before
    # Before the user waits for workers.
    check_writable(path if path.exists() else path.parent, "another cache with --cache")
    from gapsweep.execution.execute import execute

    connected = connect()
    begin()
    planned.cache = planned.cache or Cache(path)
    try:
        return execute(planned, connected, on_progress=on_progress, **how)
    except KeyboardInterrupt as interrupt:
        tell(on_progress, before, "stopping the computation")
        interrupt.add_note(f"computed points are in {path}; run again to resume")
        raise


@contextmanager
def _connection(
    client: Client | None, say: Callable[[str], None], scheduler: str | None, **how: Any
) -> Iterator[Callable[[], Client]]:
    """A function that returns the client of the call, or else that of a cluster.

    Its first call starts or joins the cluster, which ends with the block.
    """
    with ExitStack() as stack:

        @cached
        def connect() -> Client:
            if client is not None:
                return client
            from gapsweep.execution.cluster import cluster

            say(f"connecting to {scheduler}" if scheduler else "starting the workers")
            return stack.enter_context(cluster(scheduler=scheduler, **how))

        yield connect


def _failures(planned: Plan) -> dict[str, int]:
    counts = {s.label: int(np.count_nonzero(planned.status == s)) for s in Status if s.failed}
    return {label: n for label, n in counts.items() if n}


def _reasons(planned: Plan) -> str:
    """Numbers of failed points by status, each with the message of its first point."""
    reasons = []
    for status in filter(lambda status: status.failed, Status):
        rows = np.flatnonzero(planned.status == status)
        if rows.size and planned.cache is not None:
            found = planned.cache.found(planned.places[rows[:1]], planned.study.structure)
            message = found.responses.messages.get(0, "")
            reasons.append(f"{rows.size} {status.label}: {message:.200}".rstrip(": "))
    return "; ".join(reasons)
