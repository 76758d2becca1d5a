"""How the files of a run are made, each by its stage: datasets, verdicts, benchmarks, report.

What a file is made from and whether it must be made stands in `gapsweep.stages`. numba, xarray and
matplotlib are imported by the stages that need them: a run that finds everything up to date ends
before they would be loaded.
"""

import gc
import warnings
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gapsweep import own_code
from gapsweep.analysis.unit_check import wrong_tables
from gapsweep.errors import StoreError, StudyError
from gapsweep.execution.assemble import export
from gapsweep.execution.plan import Plan
from gapsweep.execution.progress import DEFAULT_TIMEOUT
from gapsweep.folder import alone_in_run, check_owner, check_writable, run_folder
from gapsweep.stages import (
    ADVICE,
    AGREEMENT,
    ATTRACTORS,
    BRANCHES,
    CLAIMS,
    DAMAGED,
    HISTORIES,
    REPORT,
    RESPONSES,
    SECTIONS,
    STABILITY,
    STAGES,
    STATIC,
    TIMING,
    WORK_PRECISION,
    MadeFrom,
    Stage,
    as_text,
    is_of_run,
    made_from,
    own_datasets,
    reason_to_run,
    sources,
    stages_of,
    study_source,
)
from gapsweep.status import Status
from gapsweep.store import netcdf
from gapsweep.store.artefact import alone_in, reading
from gapsweep.store.cache import Cache
from gapsweep.study.study import Study

if TYPE_CHECKING:
    import xarray as xr

_MANY = 100_000  # points, whose datasets hold so much memory that a collection is worth its time


def update_points(
    study: Study,
    planned: Plan,
    store: Cache,
    folder: Path,
    say: Callable[[str], None],
) -> MadeFrom:
    """Make what is made from the cache, if it is not up to date.

    Returns
    -------
    mapping of str to str
        Digests of what is no file of the run.
    """
    given = sources(study, planned, store)
    for stage in stages_of(study):
        if stage.file not in (RESPONSES, ATTRACTORS):
            continue
        now = made_from(stage, folder, given)
        if _must_run(stage, folder, now):
            say(f"making {stage.file}")
            files = folder / RESPONSES, folder / ATTRACTORS
            export(study, planned, store, *files, made_from=as_text(now))
    return given


def update(
    study: Study,
    folder: Path,
    given: MadeFrom,
    *,
    n_points: int,
    cache: Path,
    connect: Callable[[], AbstractContextManager[Any]],
    timeout: float,
    retry_failed: bool,
    say: Callable[[str], None],
) -> None:
    """Make every other file of a run that is not up to date.

    Parameters
    ----------
    given : mapping of str to str
        As `update_points` returns it.
    n_points : int
        Of the study.
    cache : Path
        Folder of the cache.
    connect : callable
        Starts or joins a cluster, for branches that are not stored.
    timeout : float
        Time [s] that a motion with a law of the user's own may take.
    retry_failed : bool
        Whether files with failed motions are made again.
    say : callable
        Told what is made next.
    """
    for stage in stages_of(study):
        if stage.file in (RESPONSES, ATTRACTORS):
            continue
        now = made_from(stage, folder, given)
        again = retry_failed and bool(failed_motions(folder / stage.file))
        if not _must_run(stage, folder, now) and not again:
            continue
        say(f"making {stage.file}")
        if stage.file == CLAIMS:
            own_code.decide(stage, study, folder, now)
        elif stage.file == SECTIONS:
            own_code.draw(stage, study, folder, now)
        elif stage.file == REPORT:
            _report(folder)
        elif stage.file == BRANCHES:
            from gapsweep.analysis.datasets.branches_file import branches

            with netcdf.read(folder / ATTRACTORS, lazy=True) as attractors:
                made = branches(study, attractors, cache, connect, timeout, say)
            netcdf.write(made, folder / stage.file, {"made_from": as_text(now)})
        else:
            _analyse(stage, study, folder, now, timeout, say)
        if n_points > _MANY:
            gc.collect()  # what refers to itself would hold its memory into the next stage


def _must_run(stage: Stage, folder: Path, now: MadeFrom) -> bool:
    """Whether a file is not up to date; warns if it is damaged."""
    reason = reason_to_run(stage, folder, now)
    if reason == DAMAGED:
        warnings.warn(
            f"{folder / stage.file}: damaged or changed since it was written, made again",
            stacklevel=3,
        )
    return reason is not None


def _analyse(
    stage: Stage,
    study: Study,
    folder: Path,
    now: MadeFrom,
    timeout: float,
    say: Callable[[str], None] | None,
) -> None:
    """Make the file of an analysis stage."""
    made = _analysed(stage, study, folder, timeout, say)
    netcdf.write(made, folder / stage.file, {"made_from": as_text(now)})


def _analysed(
    stage: Stage,
    study: Study,
    folder: Path,
    timeout: float,
    say: Callable[[str], None] | None,
) -> "xr.Dataset":
    """The dataset of an analysis stage."""
    from gapsweep.analysis.agreement.comparison import agreement
    from gapsweep.analysis.bench.stability import stability
    from gapsweep.analysis.bench.work_precision import work_precision
    from gapsweep.analysis.datasets.histories import histories
    from gapsweep.analysis.datasets.recommendations import advice
    from gapsweep.analysis.datasets.static import static
    from gapsweep.analysis.datasets.timing import timing

    if stage.file == STATIC:
        # What a user's law may do, it does on workers.
        return static(study, with_own_laws=False)
    asked: dict[str, Callable[[Study], xr.Dataset | None]] = {
        ADVICE: advice,
        HISTORIES: partial(histories, timeout=timeout),
        WORK_PRECISION: partial(work_precision, say=say, timeout=timeout),
        STABILITY: partial(stability, say=say, timeout=timeout),
    }
    if stage.file in asked:
        made = asked[stage.file](study)
        assert made is not None, "the stage is left out where none is asked for"
        return made
    if stage.file in (own := own_datasets(study)):
        return own_code.own_dataset(stage.file, own[stage.file], study)
    with (
        netcdf.read(folder / RESPONSES, lazy=True) as responses,
        netcdf.read(folder / ATTRACTORS, lazy=True) as attractors,
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
    *,
    timeout: float = DEFAULT_TIMEOUT,
) -> list[Path]:
    """Measure a study's ``[bench]`` afresh; its report follows if there is one.

    Costs are measured in this process; user laws run in separate ones.

    Parameters
    ----------
    study : Study
    out : path, optional
        Output folder, ``data/runs/<study name>`` if None.
    say : callable, optional
        Told what is measured next.
    timeout : float
        Processor time [s] of a scene, and of a call of a user law.

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
    study = Study.of(study)
    try_out_own_laws(study, timeout, say)
    made = []
    with alone_in(folder):
        check_owner(study, folder)
        for stage in stages_of(study):
            if stage.file in (WORK_PRECISION, STABILITY):
                now = made_from(stage, folder, study_source(study))
                _analyse(stage, study, folder, now, timeout, say)
                made.append(folder / stage.file)
        if (folder / RESPONSES).exists() and (folder / TIMING).exists():
            _report(folder)
    return made


def try_out_own_laws(study: Study, timeout: float, say: Callable[[str], None] | None) -> None:
    """Refuse laws of the user's own that would end this process, or hang; warn of other units."""
    if study.own_laws:
        from gapsweep.execution.try_out import try_out

        try_out(study, timeout, say or (lambda _: None))
        for said in wrong_tables(study):
            warnings.warn(said, stacklevel=3)


def failed_motions(path: Path) -> dict[str, int]:
    """Number of motions in a file per status that says that they failed.

    Of a benchmark, which looks for failures of methods, only those of the user's own code; of
    branches the attractors whose scenes failed.
    """
    if path.name not in (HISTORIES, WORK_PRECISION, STABILITY, BRANCHES):
        return {}
    is_bench = path.name in (WORK_PRECISION, STABILITY)
    first = Status.TIMED_OUT if is_bench else Status.DIVERGED
    found = netcdf.values(path, "attractor_status" if path.name == BRANCHES else "status")
    counts = {status.label: int((found == status).sum()) for status in Status if status >= first}
    return {label: n for label, n in counts.items() if n}


def report(folder: str | Path, study: Study | None = None) -> Path:
    """Write ``report/index.html`` from the files of a run.

    Parameters
    ----------
    folder : path
        Of the run; no file in it is ever executed.
    study : Study, optional
        Whose own sections are made anew; None shows those that are stored.

    Raises
    ------
    GapsweepError
        If the folder holds no run, one of its files is damaged, or the study has no sections.
    """
    folder = Path(folder).absolute()
    with alone_in_run(folder):
        if study is not None:
            own_code.draw(*own_code.own_stage(SECTIONS, Study.of(study), folder))
        return _report(folder)


def _report(folder: Path) -> Path:
    from gapsweep.report.html import write_report

    if (folder / REPORT).parent.is_symlink():
        raise StoreError(
            f"{(folder / REPORT).parent}: a symbolic link, which could lead anywhere: remove it"
        )
    stage = next(stage for stage in STAGES if stage.file == REPORT)
    with reading(folder), ExitStack() as files:

        def stored(name: str) -> "xr.Dataset | None":
            if not (folder / name).exists():
                return None
            found = files.enter_context(netcdf.read(folder / name, lazy=True))
            return found if is_of_run(folder / name) else None

        responses = files.enter_context(netcdf.read(folder / RESPONSES, lazy=True))
        return write_report(
            folder / REPORT,
            responses,
            stored(AGREEMENT),
            files.enter_context(netcdf.read(folder / TIMING, lazy=True)),
            attractors=stored(ATTRACTORS),
            advice=stored(ADVICE),
            static=stored(STATIC),
            claims=own_code.stored(folder / CLAIMS),
            own_parts=(own_code.stored(folder / SECTIONS) or {}).get("sections", ()),
            work_precision=stored(WORK_PRECISION),
            stability=stored(STABILITY),
            branches=stored(BRANCHES),
            made_from=as_text(made_from(stage, folder, {})),
        )
