"""What a study finds stored: plan, price, why points and files are made. Computes nothing."""

import os
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gapsweep.errors import StoreError
from gapsweep.execution.explain import Explanation
from gapsweep.execution.explain import explain as explanations
from gapsweep.execution.plan import Plan
from gapsweep.execution.plan import plan as make_plan
from gapsweep.execution.progress import DEFAULT_TIMEOUT, OnProgress, Progress, tell
from gapsweep.folder import run_folder
from gapsweep.make import try_out_own_laws
from gapsweep.stages import made_from, reason_to_run, sources, stages_of
from gapsweep.store.cache import Cache
from gapsweep.study.grid import Selection
from gapsweep.study.study import Study

DEFAULT_CACHE = Path("data/cache")


def cache_path(cache: str | Path | None) -> Path:
    """The folder of the cache: the argument, else ``GAPSWEEP_CACHE``, else ``data/cache``."""
    return Path(cache or os.environ.get("GAPSWEEP_CACHE") or DEFAULT_CACHE).absolute()


def plan(
    study: Study,
    cache: str | Path | None = None,
    *,
    selection: Selection | None = None,
    retry_failed: bool = False,
    timeout: float = DEFAULT_TIMEOUT,
    on_progress: OnProgress | None = None,
) -> Plan:
    """Compare a study with a cache, without creating the cache or computing anything.

    Raises
    ------
    StudyError
        If a law of the user's own ends its process or hangs where keys are made.
    """
    path, say = cache_path(cache), partial(tell, on_progress, Progress(0, 0))
    try_out_own_laws(study, timeout, say)
    say("looking up what is stored")
    if not path.exists():
        return make_plan(study, selection=selection)
    with Cache(path, read_only=True) as store:
        return make_plan(study, store, selection=selection, retry_failed=retry_failed)


def expected_seconds(plan: Plan, cache: str | Path | None, workers: int) -> float | None:
    """Time the missing points will take [s], from stored costs; None if none are stored.

    Points of the same representation set the price where there are any, else the mean.
    """
    path = cache_path(cache)
    if not path.exists():
        return None
    with Cache(path, read_only=True) as store:
        cost = store.seconds(plan.keys)
    if np.isnan(cost).all():
        return None
    representation = plan.representation(np.arange(plan.n_points))
    total = 0.0
    for r in np.unique(representation[plan.is_missing]).tolist():
        here = representation == r
        known = cost[here & np.isfinite(cost)]
        price = known.mean() if known.size else np.nanmean(cost)
        total += price * np.sum(plan.is_missing & here)
    return float(total) / workers


def stage_reasons(
    study: Study, plan: Plan, out: str | Path | None, cache: str | Path | None
) -> dict[str, str | None]:
    """Why each stage would run; None for those that are up to date."""
    folder, path = run_folder(study, out), cache_path(cache)
    stages = stages_of(study)
    if plan.n_missing or not path.exists():
        return {stage.file: "sweep points are missing" for stage in stages}
    with Cache(path, read_only=True) as store:
        given = sources(study, plan, store)
    reasons: dict[str, str | None] = {}
    for stage in stages:
        anew = [name for name in stage.inputs if reasons.get(name)]
        now = made_from(stage, folder, given)
        reason = reason_to_run(stage, folder, now)
        reasons[stage.file] = reason or (f"{', '.join(anew)} made anew" if anew else None)
    return reasons


def explain(
    study: Study,
    cache: str | Path | None,
    limit: int,
    on_progress: OnProgress | None = None,
    /,
    **wanted: Any,
) -> list[Explanation]:
    """Why the selected points, the first `limit` of them, are hits or misses."""
    selection, path = study.select(**wanted), cache_path(cache)
    planned = plan(study, path, selection=selection, on_progress=on_progress)
    if not path.exists():
        raise StoreError(f"{path}: no such folder, so every point is missing")
    with Cache(path, read_only=True) as store:
        return list(explanations(study, planned, store, limit))
