"""The whole path of a study: points, responses, analyses, report.

Each step reads what the one before it stored; `report` needs nothing but the NetCDF files.
Dask, numba, xarray and matplotlib are imported by the steps that need them: a run that finds
everything up to date ends before they would be loaded.
"""

import json
import os
import random
import tempfile
import time
import warnings
from collections.abc import Callable, Mapping
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

from gapsweep.console import progress_bar
from gapsweep.errors import StoreError, StudyError
from gapsweep.execution.assemble import export
from gapsweep.execution.explain import Explanation
from gapsweep.execution.explain import explain as explanations
from gapsweep.execution.plan import Plan
from gapsweep.execution.plan import plan as make_plan
from gapsweep.execution.progress import DEFAULT_TIMEOUT, OnProgress, Progress
from gapsweep.model.labels import AUTO
from gapsweep.stages import (
    ADVICE,
    AGREEMENT,
    ATTRACTORS,
    CLAIMS,
    HISTORIES,
    REPORT,
    RESPONSES,
    STABILITY,
    STAGES,
    STATIC,
    TIMING,
    WORK_PRECISION,
    Stage,
    as_text,
    claims_source,
    made_from,
    reason_to_run,
    sources,
    study_source,
)
from gapsweep.status import Status
from gapsweep.store import netcdf
from gapsweep.store.artefact import alone_in, digests, is_intact, is_recorded, recording
from gapsweep.store.cache import Cache, is_sound
from gapsweep.store.maintenance import numerics_of
from gapsweep.store.state import FAILED, FINISHED, INTERRUPTED, RUNNING, RunState
from gapsweep.study.claims import read_claims
from gapsweep.study.fingerprint import numerics_fingerprint
from gapsweep.study.study import Selection, Study

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client

DEFAULT_CACHE = Path("data/cache.sqlite")
RUNS = Path("data/runs")
EXACT = "piecewise"
CLAIMS_COPY = "claims.toml"
_STATE_SECONDS = 1.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run left behind.

    Attributes
    ----------
    folder : Path
    progress : Progress
    failures : mapping of str to int
        Number of sweep points per failure status.
    """

    folder: Path
    progress: Progress
    failures: Mapping[str, int]


def run_folder(study: Study, out: str | Path | None = None) -> Path:
    """Where a run leaves its files: the argument, else ``data/runs/<study name>``."""
    return Path(out) if out is not None else RUNS / study.name


def cache_path(cache: str | Path | None = None) -> Path:
    """The cache to use: the argument, else ``GAPSWEEP_CACHE``, else ``data/cache.sqlite``."""
    return Path(cache or os.environ.get("GAPSWEEP_CACHE") or DEFAULT_CACHE)


def plan(
    study: Study,
    cache: str | Path | None = None,
    *,
    selection: Selection | None = None,
    retry_failed: bool = False,
) -> Plan:
    """Compare a study with a cache, without creating the cache or computing anything."""
    path = cache_path(cache)
    if not path.exists():
        return make_plan(study, selection=selection)
    with Cache(path) as store:
        return make_plan(study, store.status, selection=selection, retry_failed=retry_failed)


def expected_seconds(plan: Plan, cache: str | Path | None = None, workers: int = 2) -> float | None:
    """Time the missing points will take [s], from stored costs; None if none are stored.

    Points of the same representation set the price where there are any, else the mean.
    """
    path = cache_path(cache)
    if not path.exists():
        return None
    with Cache(path) as store:
        stored = store.cpu_times(plan.keys)
    if not stored:
        return None
    cost = np.array([stored.get(key, np.nan) for key in plan.keys])
    representation = plan.cells // int(np.prod(plan.shape[1:]))
    missing = plan.is_missing
    total = 0.0
    for r in np.unique(representation[missing]):
        same = cost[(representation == r) & np.isfinite(cost)]
        price = same.mean() if same.size else np.nanmean(cost)
        total += price * np.sum(missing & (representation == r))
    return float(total) / workers


def stage_reasons(
    study: Study, plan: Plan, out: str | Path | None = None, cache: str | Path | None = None
) -> dict[str, str | None]:
    """Why each stage would run; None for those that are up to date."""
    folder, path = run_folder(study, out), cache_path(cache)
    stages = _stages(study)
    if plan.n_missing or not path.exists():
        return {stage.file: "sweep points are missing" for stage in stages}
    with Cache(path) as store:
        given = sources(study, plan, store)
    reasons: dict[str, str | None] = {}
    for stage in stages:
        anew = [name for name in stage.inputs if reasons.get(name)]
        now = made_from(stage, folder, given)
        reason = reason_to_run(stage, folder, now)
        reasons[stage.file] = reason or (f"{', '.join(anew)} made anew" if anew else None)
    return reasons


def run(
    study: Study,
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
    study : Study
    client : distributed.Client, optional
        A Dask cluster to use; None starts a local one, or joins `scheduler`.
    out : path, optional
        Output folder, ``data/runs/<study name>`` if None.
    cache : path, optional
        Cache file; see `cache_path`.
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
        Observer of the `Progress`.

    Returns
    -------
    Dataset
        ``responses.nc``, opened.

    Raises
    ------
    GapsweepError
        If the cluster, the cache or the output folder cannot be used.
    """
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
        on_progress=on_progress,
    )
    return netcdf.read(outcome.folder / RESPONSES)


def carry_out(
    study: Study,
    client: "Client | None" = None,
    *,
    out: str | Path | None = None,
    cache: str | Path | None = None,
    on_progress: OnProgress | None = None,
    retry_failed: bool = False,
    **how: Any,
) -> Outcome:
    """`run`, with the outcome instead of the dataset."""
    folder = run_folder(study, out)
    check_writable(folder)
    planned = plan(study, cache, retry_failed=retry_failed)
    if study.claims_file is not None and planned.n_missing:
        from gapsweep.analysis.claims import check_variables

        # Before anything is computed: the datasets that it names come last.
        check_variables(read_claims(study.claims_file), str(study.claims_file))
    with _Recorder(folder, study, cache_path(cache), planned, on_progress) as recorder:
        progress = _computed(
            study, client, planned, cache, recorder, retry_failed=retry_failed, **how
        )
        with Cache(cache_path(cache)) as store:
            if planned.n_missing:
                planned = replace(planned, status=store.status(planned.keys))
            with alone_in(folder):
                update(study, planned, store, folder)
    return Outcome(folder, progress, _failures(planned))


def query(
    study: Study,
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
    study : Study
    client, cache, workers, scheduler
        As for `run`.
    on_progress : callable, optional
        Observer of the `Progress`; None shows a bar while points are computed.
    representation, K_c, gap, omega, initial_condition : optional
        What is wanted, among the study's own points: a value, a list or, for numbers, a slice
        that includes both ends. All if left out.

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
    """
    selection = study.select(**wanted)
    planned = plan(study, cache, selection=selection)
    shown = (
        progress_bar() if on_progress is None and planned.n_missing else nullcontext(on_progress)
    )
    with shown as observer:
        progress = _computed(
            study, client, planned, cache, observer, workers=workers, scheduler=scheduler
        )
    with tempfile.TemporaryDirectory() as folder, Cache(cache_path(cache)) as store:
        responses = Path(folder) / RESPONSES
        export(study, planned, store, responses, Path(folder) / ATTRACTORS, selection=selection)
        with netcdf.read(responses) as dataset:
            counts = {
                "n_points": progress.n_points,
                "n_hits": progress.n_hits,
                "n_computed": progress.n_computed,
            }
            return dataset.load().assign_attrs(counts)


def _computed(
    study: Study,
    client: "Client | None",
    planned: Plan,
    cache: str | Path | None,
    on_progress: OnProgress | None,
    *,
    workers: int = 2,
    scheduler: str | None = None,
    **how: Any,
) -> Progress:
    """Compute what a plan misses; a cluster is started only if that is something."""
    if planned.n_damaged:
        warnings.warn(
            f"{cache_path(cache)}: {planned.n_damaged} damaged rows, computed again", stacklevel=3
        )
    if not planned.n_missing:
        return Progress(planned.n_points, planned.n_hits)
    from gapsweep.execution.cluster import cluster
    from gapsweep.execution.execute import execute

    joined = nullcontext(client) if client is not None else cluster(workers, scheduler)
    with joined as connected, Cache(cache_path(cache)) as store:
        if store.on_network:
            warnings.warn(
                f"{store.path}: on a network file system, so without SQLite's write-ahead log: "
                "slower; a local disk (--cache) is better",
                stacklevel=3,
            )
        return execute(study, planned, store, connected, on_progress=on_progress, **how)


class _Recorder:
    """Keeps `run.json` up to date while a run goes on, and hands progress on."""

    def __init__(
        self,
        folder: Path,
        study: Study,
        cache: Path,
        planned: Plan,
        on_progress: OnProgress | None,
    ) -> None:
        self.folder, self.on_progress = folder, on_progress
        self.state = RunState(
            state=RUNNING,
            study=study.name,
            cache=str(cache.absolute()),
            points=planned.n_points,
            hits=planned.n_hits,
        )
        self.written = -np.inf

    def __enter__(self) -> "_Recorder":
        return self

    def __call__(self, progress: Progress) -> None:
        self.state = replace(self.state, computed=progress.n_computed, failed=progress.n_failed)
        if time.monotonic() - self.written > _STATE_SECONDS:
            self.state.write(self.folder)
            self.written = time.monotonic()
        if self.on_progress is not None:
            self.on_progress(progress)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if error is None:
            replace(self.state, state=FINISHED).write(self.folder)
        elif self.written > -np.inf:
            state = INTERRUPTED if isinstance(error, KeyboardInterrupt) else FAILED
            # The disk may be full: that is what the error says already.
            with suppress(StoreError):
                replace(self.state, state=state, message=str(error)).write(self.folder)


def explain(study: Study, cache: str | Path | None, limit: int, **wanted: Any) -> list[Explanation]:
    """Why the selected points, the first `limit` of them, are hits or misses."""
    selection = study.select(**wanted)
    planned = plan(study, cache, selection=selection)
    path = cache_path(cache)
    if not path.exists():
        raise StoreError(f"{path}: no such file, so every point is missing")
    with Cache(path) as store:
        return list(explanations(study, planned, store, limit))


def recomputed_otherwise(cache: Cache, sample: int) -> list[tuple[str, list[str]]]:
    """Compute random rows of the present code again; those that came out otherwise.

    Returns
    -------
    list of (str, list of str)
        Key in hex, and the names of the values that differ; `cpu_time` always may.
    """
    from gapsweep.execution.again import differences

    now = numerics_fingerprint()
    ours = [r[0] for r in cache.records() if numerics_of(r) == now and is_sound(r)]
    chosen = random.sample(ours, min(sample, len(ours)))
    return [(key.hex(), names) for key in chosen if (names := differences(cache, key))]


def _failures(planned: Plan) -> dict[str, int]:
    counts = {s.label: int(np.sum(planned.status == s)) for s in Status if s.failed}
    return {label: n for label, n in counts.items() if n}


def _stages(study: Study) -> list[Stage]:
    """The stages of a study.

    Without the exact law there is nothing to agree with, without claims nothing to decide,
    motions are kept only where some are asked for, and advice where ``auto`` took it. Scenes of a
    benchmark whose right answer is stated make one file, the others another.
    """
    labels, bench = study.grid.representations, study.spec.bench
    stated = [scene.expected is not None for scene in bench.scene] if bench else []
    left_out = {
        STATIC: labels == (AUTO,),
        AGREEMENT: EXACT not in labels,
        ADVICE: AUTO not in labels,
        HISTORIES: not study.spec.history,
        WORK_PRECISION: all(stated),
        STABILITY: not any(stated),
        CLAIMS: study.claims_file is None,
    }
    return [stage for stage in STAGES if not left_out.get(stage.file)]


def update(study: Study, planned: Plan, store: Cache, folder: Path) -> None:
    """Make every file of a run that is not up to date."""
    given = sources(study, planned, store)
    for stage in _stages(study):
        now = made_from(stage, folder, given)
        if reason_to_run(stage, folder, now) is None:
            continue
        if stage.file in (RESPONSES, ATTRACTORS):
            files = folder / RESPONSES, folder / ATTRACTORS
            export(study, planned, store, *files, made_from=as_text(now))
        elif stage.file == CLAIMS:
            assert study.claims_file is not None, "the stage is left out without claims"
            claims(folder, study.claims_file)
        elif stage.file == REPORT:
            report(folder)
        else:
            result = _analysed(stage, study, folder)
            netcdf.write(result, folder / stage.file, {"made_from": as_text(now)})


def _analysed(
    stage: Stage, study: Study, folder: Path, say: Callable[[str], None] | None = None
) -> "xr.Dataset":
    """The dataset of an analysis stage."""
    from gapsweep.analysis.advice import advice
    from gapsweep.analysis.agreement import agreement
    from gapsweep.analysis.histories import histories
    from gapsweep.analysis.stability import stability
    from gapsweep.analysis.static import static
    from gapsweep.analysis.timing import timing
    from gapsweep.analysis.work_precision import work_precision

    if stage.file == STATIC:
        # Only claims ask for the ladders. What a user's law may do, it does on workers.
        decides = study.claims_file is not None
        return static(study, with_ladders=decides, with_own_laws=False)
    asked: dict[str, Callable[[Study], xr.Dataset | None]] = {
        ADVICE: advice,
        HISTORIES: histories,
        WORK_PRECISION: partial(work_precision, say=say),
        STABILITY: partial(stability, say=say),
    }
    if stage.file in asked:
        made = asked[stage.file](study)
        assert made is not None, "the stage is left out where none is asked for"
        return made
    with (
        netcdf.read(folder / RESPONSES) as responses,
        netcdf.read(folder / ATTRACTORS) as attractors,
    ):
        if stage.file == TIMING:
            return timing(responses)
        compared = agreement(responses, attractors)
        assert compared is not None, "the stage is left out where the exact law is"
        return compared


def bench(
    study: Study,
    out: str | Path | None = None,
    say: Callable[[str], None] | None = None,
) -> list[Path]:
    """Measure a study's ``[bench]`` afresh, in this process; its report follows if there is one.

    Parameters
    ----------
    study : Study
    out : path, optional
        Output folder, ``data/runs/<study name>`` if None.
    say : callable, optional
        Told what is measured next.

    Returns
    -------
    list of Path
        ``work_precision.nc`` and ``stability.nc``, those that the scenes ask for.

    Raises
    ------
    GapsweepError
        If the study has no ``[bench]``, or the output folder cannot be used.
    """
    if study.spec.bench is None:
        raise StudyError([f"{study.source}: bench: missing; it names scenes and methods"])
    folder = run_folder(study, out)
    check_writable(folder)
    made = []
    with alone_in(folder):
        for stage in _stages(study):
            if stage.file in (WORK_PRECISION, STABILITY):
                measured = _analysed(stage, study, folder, say)
                now = made_from(stage, folder, study_source(study))
                netcdf.write(measured, folder / stage.file, {"made_from": as_text(now)})
                made.append(folder / stage.file)
        if (folder / RESPONSES).exists() and (folder / TIMING).exists():
            report(folder)
    return made


def claims(folder: str | Path, file: str | Path | None = None) -> dict[str, Any]:
    """Decide claims from the NetCDF files of a run and write ``claims.json``.

    Parameters
    ----------
    folder : path
        Of the run; datasets that are not there leave the claims that need them undecidable.
    file : path, optional
        The claims; the copy that the run left in its folder if None.

    Returns
    -------
    dict
        What stands in ``claims.json``.

    Raises
    ------
    GapsweepError
        If there are no responses or no claims, or a file is damaged.
    """
    from gapsweep.analysis.claims import check_variables, verdicts

    folder = Path(folder)
    if not (folder / RESPONSES).exists():
        raise StoreError(f"{folder / RESPONSES}: no such file; 'gapsweep run' makes it")
    path = Path(file) if file is not None else folder / CLAIMS_COPY
    stated = read_claims(path)
    check_variables(stated, str(path))
    stage = next(stage for stage in STAGES if stage.file == CLAIMS)
    with ExitStack() as opened:
        datasets = {
            name.removesuffix(".nc"): opened.enter_context(netcdf.read(folder / name))
            for name in stage.inputs
            if name.endswith(".nc") and (folder / name).exists()
        }
        decided = {
            "study": datasets["responses"].attrs["study"],
            "claims_file": path.name,
            "made_from": dict(made_from(stage, folder, claims_source(path))),
            **netcdf.provenance(),
            **verdicts(stated, datasets),
        }
    if path.absolute() != (folder / CLAIMS_COPY).absolute():
        with recording(folder / CLAIMS_COPY, is_recorded) as temporary:
            temporary.write_bytes(path.read_bytes())
    with recording(folder / CLAIMS, is_recorded) as temporary:
        text = json.dumps(decided, indent=1, ensure_ascii=False, allow_nan=False)
        temporary.write_text(text + "\n", encoding="utf-8")
    return decided


def report(folder: str | Path) -> Path:
    """Write ``report/index.html`` from the NetCDF files of a run.

    Raises
    ------
    StoreError
        If the folder holds no run, or one of its files is damaged.
    """
    from gapsweep.report.html import write_report

    folder = Path(folder)
    if not (folder / RESPONSES).exists():
        raise StoreError(f"{folder / RESPONSES}: no such file; 'gapsweep run' makes it")
    stage = next(stage for stage in STAGES if stage.file == REPORT)
    with ExitStack() as files:

        def stored(name: str) -> "xr.Dataset | None":
            there = (folder / name).exists()
            return files.enter_context(netcdf.read(folder / name)) if there else None

        responses = files.enter_context(netcdf.read(folder / RESPONSES))
        motions = stored(HISTORIES)
        # A study that has since dropped its time histories leaves their file behind.
        if motions is not None and motions.attrs["study_json"] != responses.attrs["study_json"]:
            motions = None
        return write_report(
            folder / REPORT,
            responses,
            stored(AGREEMENT),
            files.enter_context(netcdf.read(folder / TIMING)),
            attractors=stored(ATTRACTORS),
            histories=motions,
            static=stored(STATIC),
            advice=stored(ADVICE),
            claims=_decided(folder),
            work_precision=stored(WORK_PRECISION),
            stability=stored(STABILITY),
            made_from=as_text(made_from(stage, folder, {})),
        )


def _decided(folder: Path) -> dict[str, Any] | None:
    """The verdicts of a run; None if there are none, or if they rest on other responses."""
    path = folder / CLAIMS
    if not path.exists():
        return None
    if not is_intact(path):
        raise StoreError(f"{path}: damaged; 'gapsweep claims {folder}' decides again")
    decided: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    same = decided["made_from"].get(RESPONSES) == " ".join(digests(folder / RESPONSES))
    return decided if same else None


def check_writable(folder: Path) -> None:
    """Fail before anything is computed if the results could not be stored."""
    existing = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        raise StoreError(f"{folder}: cannot be written: {existing}: {error.strerror}") from None
