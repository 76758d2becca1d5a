"""How the files of a run are made, each by its stage: datasets, verdicts, benchmarks, report.

What a file is made from and whether it must be made stands in `gapsweep.stages`. numba, xarray and
matplotlib are imported by the stages that need them: a run that finds everything up to date ends
before they would be loaded.
"""

import json
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gapsweep.errors import StoreError, StudyError
from gapsweep.execution.assemble import export
from gapsweep.execution.plan import Plan
from gapsweep.execution.progress import DEFAULT_TIMEOUT
from gapsweep.model import own_law
from gapsweep.model.labels import AUTO
from gapsweep.stages import (
    ADVICE,
    AGREEMENT,
    ATTRACTORS,
    CLAIMS,
    DAMAGED,
    HISTORIES,
    REPORT,
    RESPONSES,
    STABILITY,
    STAGES,
    STATIC,
    TIMING,
    WORK_PRECISION,
    MadeFrom,
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
from gapsweep.store.cache import Cache
from gapsweep.store.state import RunState
from gapsweep.study.claims import read_claims
from gapsweep.study.study import Study

if TYPE_CHECKING:
    import xarray as xr

RUNS = Path("data/runs")
EXACT = "piecewise"
CLAIMS_COPY = "claims.toml"
# The files by which one sees whose folder it is.
_OWNED = (RESPONSES, WORK_PRECISION, STABILITY)


def run_folder(study: Study, out: str | Path | None = None) -> Path:
    """Where a run leaves its files: the argument, else ``data/runs/<study name>``."""
    return Path(out) if out is not None else RUNS / study.name


def stages_of(study: Study) -> list[Stage]:
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


def update(
    study: Study,
    planned: Plan,
    store: Cache,
    folder: Path,
    *,
    timeout: float = DEFAULT_TIMEOUT,
    retry_failed: bool = False,
) -> None:
    """Make every file of a run that is not up to date.

    Parameters
    ----------
    timeout : float
        Time [s] that a motion with a law of the user's own may take.
    retry_failed : bool
        Whether files with failed motions are made again.
    """
    given = sources(study, planned, store)
    for stage in stages_of(study):
        now = made_from(stage, folder, given)
        reason = reason_to_run(stage, folder, now)
        again = retry_failed and bool(failed_motions(folder / stage.file))
        if reason is None and not again:
            continue
        if reason == DAMAGED:
            warnings.warn(
                f"{folder / stage.file}: damaged or changed since it was written, made again",
                stacklevel=2,
            )
        if stage.file in (RESPONSES, ATTRACTORS):
            files = folder / RESPONSES, folder / ATTRACTORS
            export(study, planned, store, *files, made_from=as_text(now))
        elif stage.file == CLAIMS:
            assert study.claims_file is not None, "the stage is left out without claims"
            _claims(folder, study.claims_file)
        elif stage.file == REPORT:
            _report(folder)
        else:
            _analyse(stage, study, folder, now, timeout)


def _analyse(
    stage: Stage,
    study: Study,
    folder: Path,
    now: MadeFrom,
    timeout: float,
    say: Callable[[str], None] | None = None,
) -> None:
    """Make the file of an analysis stage.

    Parameters
    ----------
    now : MadeFrom
        What it is made from, taken before: an edit meanwhile makes the file stale, not current.
    """
    result = _unedited(stage, study, folder, timeout, say)
    netcdf.write(result, folder / stage.file, {"made_from": as_text(now)})


def _unedited(
    stage: Stage,
    study: Study,
    folder: Path,
    timeout: float,
    say: Callable[[str], None] | None = None,
) -> "xr.Dataset":
    """The dataset of an analysis stage, if the laws that it was made with are still there."""
    before = study_source(study)
    made = _analysed(stage, study, folder, timeout, say)
    own_law.refresh()
    if study_source(study) != before:
        raise StudyError([f"{study.source}: a law of your own was edited meanwhile; run again"])
    return made


def _analysed(
    stage: Stage,
    study: Study,
    folder: Path,
    timeout: float,
    say: Callable[[str], None] | None = None,
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
        HISTORIES: partial(histories, timeout=timeout),
        WORK_PRECISION: partial(work_precision, say=say, timeout=timeout),
        STABILITY: partial(stability, say=say, timeout=timeout),
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
    *,
    timeout: float = DEFAULT_TIMEOUT,
) -> list[Path]:
    """Measure a study's ``[bench]`` afresh; its report follows if there is one.

    Laws of the user's own have a process for themselves, all others this one.

    Parameters
    ----------
    study : Study
    out : path, optional
        Output folder, ``data/runs/<study name>`` if None.
    say : callable, optional
        Told what is measured next.
    timeout : float
        Time [s] that a call of a law of the user's own may take.

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
    try_out_own_laws(study)
    own_law.refresh()
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


def try_out_own_laws(study: Study) -> None:
    """Refuse laws of the user's own that would end this process, or hang, where keys are made."""
    if study.own_laws:
        from gapsweep.execution.try_out import try_out

        try_out(study)


def failed_motions(path: Path) -> dict[str, int]:
    """Number of motions in a file per status that says that they failed.

    Of a benchmark, which looks for failures of methods, only those of the user's own code.
    """
    if path.name not in (HISTORIES, WORK_PRECISION, STABILITY):
        return {}
    first = Status.DIVERGED if path.name == HISTORIES else Status.TIMED_OUT
    found = netcdf.values(path, "status")
    counts = {status.label: int((found == status).sum()) for status in Status if status >= first}
    return {label: n for label, n in counts.items() if n}


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
    folder = Path(folder)
    with _run_in(folder):
        return _claims(folder, Path(file) if file is not None else folder / CLAIMS_COPY)


@contextmanager
def _run_in(folder: Path) -> Iterator[None]:
    """Keep others from writing into the folder of a run.

    Raises
    ------
    StoreError
        If it holds none.
    """
    if not (folder / RESPONSES).exists():
        raise StoreError(f"{folder / RESPONSES}: no such file; 'gapsweep run' makes it")
    with alone_in(folder):
        yield


def _claims(folder: Path, path: Path) -> dict[str, Any]:
    from gapsweep.analysis.claims import check_variables, verdicts

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
    with _run_in(Path(folder)):
        return _report(Path(folder))


def _report(folder: Path) -> Path:
    from gapsweep.report.html import write_report

    if (folder / REPORT).parent.is_symlink():
        raise StoreError(
            f"{(folder / REPORT).parent}: a symbolic link, which could lead anywhere: remove it"
        )
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


def check_owner(study: Study, folder: Path) -> None:
    """Refuse a folder in which another study has left its files.

    Raises
    ------
    StoreError
        If its run or one of its datasets is that of a study with another name.
    """
    owners = {netcdf.attributes(folder / name).get("study") for name in _OWNED}
    with suppress(StoreError):  # no run yet, or its state is damaged
        owners.add(RunState.read(folder).study)
    for owner in owners - {None, study.name}:
        raise StoreError(
            f"{folder}: holds the files of study {owner!r}, this one is {study.name!r}: choose "
            "another folder with --out, or delete this one"
        )


def check_writable(folder: Path) -> None:
    """Fail before anything is computed if the results could not be stored."""
    existing = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        raise StoreError(f"{folder}: cannot be written: {existing}: {error.strerror}") from None
