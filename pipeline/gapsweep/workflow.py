"""The whole path of a study: points, responses, analyses, report.

Each step reads what the one before it stored; `report` needs nothing but the NetCDF files.
"""

import os
import tempfile
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import xarray as xr
from distributed import Client

from gapsweep.analysis.agreement import agreement
from gapsweep.analysis.timing import timing
from gapsweep.errors import StoreError
from gapsweep.execution.assemble import export
from gapsweep.execution.execute import OnProgress, Progress, cluster, execute
from gapsweep.execution.plan import Plan
from gapsweep.execution.plan import plan as make_plan
from gapsweep.report.html import write_report
from gapsweep.store import netcdf
from gapsweep.store.cache import Cache
from gapsweep.study.study import Study

DEFAULT_CACHE = Path("data/cache.sqlite")
RUNS = Path("data/runs")
RESPONSES, ATTRACTORS = "responses.nc", "attractors.nc"
AGREEMENT, TIMING = "agreement.nc", "timing.nc"
REPORT = Path("report/index.html")


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


def cache_path(cache: str | Path | None = None) -> Path:
    """The cache to use: the argument, else ``GAPSWEEP_CACHE``, else ``data/cache.sqlite``."""
    return Path(cache or os.environ.get("GAPSWEEP_CACHE") or DEFAULT_CACHE)


def plan(study: Study, cache: str | Path | None = None, *, retry_failed: bool = False) -> Plan:
    """Compare a study with a cache, without creating the cache or computing anything."""
    path = cache_path(cache)
    if not path.exists():
        return make_plan(study, lambda keys: {})
    with Cache(path) as store:
        return make_plan(study, store.statuses, retry_failed=retry_failed)


def expected_seconds(plan: Plan, cache: str | Path | None = None, workers: int = 2) -> float | None:
    """Time the missing points will take [s], from stored costs; None if none are stored.

    Points of the same representation set the price where there are any, else the mean.
    """
    path = cache_path(cache)
    if not path.exists():
        return None
    with Cache(path) as store:
        costs = store.cpu_times(key for chain in plan.chains for key in chain.keys)
    by_representation: dict[int, list[float]] = {}
    for chain in plan.chains:
        known = [costs[key] for key in chain.keys if key in costs]
        by_representation.setdefault(chain.indices[0][0], []).extend(known)
    if not costs:
        return None
    mean = sum(costs.values()) / len(costs)
    total = 0.0
    for chain in plan.missing:
        same = by_representation[chain.indices[0][0]]
        total += chain.n_missing * (sum(same) / len(same) if same else mean)
    return total / workers


def run(
    study: Study,
    client: Client | None = None,
    *,
    out: str | Path | None = None,
    cache: str | Path | None = None,
    workers: int = 2,
    scheduler: str | None = None,
    batch: int | None = None,
    retry_failed: bool = False,
    on_progress: OnProgress | None = None,
) -> xr.Dataset:
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
        retry_failed=retry_failed,
        on_progress=on_progress,
    )
    return netcdf.read(outcome.folder / RESPONSES)


def carry_out(
    study: Study,
    client: Client | None = None,
    *,
    out: str | Path | None,
    cache: str | Path | None,
    workers: int,
    scheduler: str | None,
    batch: int | None,
    retry_failed: bool,
    on_progress: OnProgress | None,
) -> Outcome:
    """`run`, with the outcome instead of the dataset."""
    folder = Path(out) if out is not None else RUNS / study.name
    check_writable(folder)
    planned = plan(study, cache, retry_failed=retry_failed)
    progress = Progress(planned.n_points, planned.n_hits)
    if planned.n_missing:
        joined = nullcontext(client) if client is not None else cluster(workers, scheduler)
        with joined as connected, Cache(cache_path(cache)) as store:
            progress = execute(
                study, planned, store, connected, batch=batch, on_progress=on_progress
            )
    with Cache(cache_path(cache)) as store:
        failures = _failures(store, planned)
        export(study, planned, store, folder / RESPONSES, folder / ATTRACTORS)
    analyse(folder)
    report(folder)
    return Outcome(folder, progress, failures)


def _failures(store: Cache, planned: Plan) -> dict[str, int]:
    counts: dict[str, int] = {}
    for status in store.statuses(k for c in planned.chains for k in c.keys).values():
        if status.failed:
            counts[status.label] = counts.get(status.label, 0) + 1
    return counts


def analyse(folder: Path) -> None:
    """Write the analysis datasets beside ``responses.nc``."""
    with (
        netcdf.read(folder / RESPONSES) as responses,
        netcdf.read(folder / ATTRACTORS) as attractors,
    ):
        compared = agreement(responses, attractors)
        if compared is not None:
            netcdf.write(compared, folder / AGREEMENT)
        else:
            (folder / AGREEMENT).unlink(missing_ok=True)
        netcdf.write(timing(responses), folder / TIMING)


def report(folder: str | Path) -> Path:
    """Write ``report/index.html`` from the NetCDF files of a run.

    Raises
    ------
    StoreError
        If the folder holds no run.
    """
    folder = Path(folder)
    if not (folder / RESPONSES).exists():
        raise StoreError(f"{folder / RESPONSES}: no such file; 'gapsweep run' makes it")
    with netcdf.read(folder / RESPONSES) as responses, netcdf.read(folder / TIMING) as costs:
        compared = netcdf.read(folder / AGREEMENT) if (folder / AGREEMENT).exists() else None
        return write_report(folder / REPORT, responses, compared, costs)


def check_writable(folder: Path) -> None:
    """Fail before anything is computed if the results could not be stored."""
    existing = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        raise StoreError(f"{folder}: cannot be written: {existing}: {error.strerror}") from None
