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
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gapsweep import beside
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
    CLAIMS_MODULE,
    DAMAGED,
    HISTORIES,
    REPORT,
    REPORT_MODULE,
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
    made_from,
    module_sources,
    own_dataset,
    own_datasets,
    reason_to_run,
    sources,
    study_source,
)
from gapsweep.status import Status
from gapsweep.store import netcdf
from gapsweep.store.artefact import alone_in, digests, is_intact, is_recorded, recording
from gapsweep.store.cache import Cache
from gapsweep.store.state import RunState
from gapsweep.study.study import Study

if TYPE_CHECKING:
    import xarray as xr

    from gapsweep.analysis.verdicts import Claim, Run

RUNS = Path("data/runs")
EXACT = "piecewise"
# The files by which one sees whose folder it is.
_OWNED = (RESPONSES, WORK_PRECISION, STABILITY)


def run_folder(study: Study, out: str | Path | None = None) -> Path:
    """Where a run leaves its files: the argument, else ``data/runs/<study name>``."""
    return Path(out) if out is not None else RUNS / study.name


def stages_of(study: Study) -> list[Stage]:
    """The stages of a study.

    Without the exact law there is nothing to agree with, without claims nothing to decide,
    motions are kept only where some are asked for, and advice where ``auto`` took it. Scenes of a
    benchmark whose right answer is stated make one file, the others another. Datasets of the
    study's own come before what reads them.
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
        CLAIMS: study.claims_module is None,
        SECTIONS: study.report_module is None,
    }
    own = tuple(own_datasets(study))
    stages: list[Stage] = []
    for stage in STAGES:
        if stage.file in (CLAIMS, SECTIONS):
            # What another study has left in the folder is not read.
            there = tuple(name for name in stage.inputs if not left_out.get(name))
            stage = replace(stage, inputs=there + own)
        if stage.file == CLAIMS:
            stages += map(own_dataset, own)
        if not left_out.get(stage.file):
            stages.append(stage)
    return stages


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
            _decide(stage, study, folder, now)
        elif stage.file == SECTIONS:
            _draw(stage, study, folder, now)
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
        return _own_dataset(stage.file, own[stage.file], study)
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


def _own_dataset(file: str, make: Callable[[Study], Any], study: Study) -> "xr.Dataset":
    """A dataset that the study's claims module makes."""
    import xarray as xr

    assert study.claims_module is not None, "datasets come from there"
    with beside.blaming(study.claims_module, file):
        made = make(study)
        if not isinstance(made, xr.Dataset):
            raise TypeError(
                f"its function must return an xarray.Dataset, not a {type(made).__name__}"
            )
    return made.assign_attrs(title=study.title, study=study.name, study_json=study.json)


def check_modules(study: Study) -> None:
    """Import the code beside a study, so that what is wrong with it is said before anything else.

    Raises
    ------
    StudyError
        If it cannot be imported, or does not hold what it must.
    """
    own_datasets(study)
    if study.claims_module is not None:
        _stated(study.claims_module)
    if study.report_module is not None:
        _sections(study.report_module)


def _stated(path: Path) -> "list[Claim]":
    """The claims that a module states."""
    from gapsweep.analysis.verdicts import stated

    module = beside.load(path)
    try:
        return stated(vars(module))
    except ValueError as error:
        raise StudyError([f"{path}: {error}"]) from None


def _sections(path: Path) -> "Callable[[Run], Any]":
    """The function of a module that makes sections of the report."""
    found: Callable[[Run], Any] | None = getattr(beside.load(path), "sections", None)
    if not callable(found):
        raise StudyError([f"{path}: no function sections(run), which gives parts of the report"])
    return found


def claims(folder: str | Path, study: Study | None = None) -> dict[str, Any]:
    """The verdicts of a run: those that are stored, or decided anew by a study's claims module.

    Parameters
    ----------
    folder : path
        Of the run; no file in it is ever executed. Datasets that are not there leave the claims
        that need them undecidable.
    study : Study, optional
        Whose claims are decided and written to ``claims.json``; None reads what is there.

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
        if study is not None:
            return _decide(*_own_stage(CLAIMS, study, folder))
        decided = _stored(folder / CLAIMS)
    if decided is None:
        raise StoreError(
            f"{folder / CLAIMS}: no verdicts on the responses of this run: "
            f"'gapsweep claims {folder} --study FILE' decides the claims of a study"
        )
    return decided


def _own_stage(file: str, study: Study, folder: Path) -> tuple[Stage, Study, Path, MadeFrom]:
    """What a stage of code beside a study is made with, for a run that may be another study's."""
    check_owner(study, folder)
    stage = next((stage for stage in stages_of(study) if stage.file == file), None)
    if stage is None:
        table, name = ("claims", "claims.py") if file == CLAIMS else ("report", "figures.py")
        example = f'[{table}] module = "{name}" names the Python file'
        raise StudyError([f"{study.source}: {table}: missing; {example}"])
    return stage, study, folder, made_from(stage, folder, module_sources(study))


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


@contextmanager
def _read(stage: Stage, folder: Path) -> "Iterator[Run]":
    """The datasets that a stage reads, those that are there."""
    from gapsweep.analysis.verdicts import Run

    with ExitStack() as opened:
        yield Run(
            {
                name.removesuffix(".nc"): opened.enter_context(netcdf.read(folder / name))
                for name in stage.inputs
                if name.endswith(".nc") and (folder / name).exists()
            }
        )


def _decide(stage: Stage, study: Study, folder: Path, now: MadeFrom) -> dict[str, Any]:
    """Decide the claims of a study and write ``claims.json``."""
    from gapsweep.analysis.verdicts import FaultyClaimError, verdicts

    path = study.claims_module
    assert path is not None, "the stage is left out without claims"
    claims = _stated(path)
    with _read(stage, folder) as run:
        try:
            found = verdicts(claims, run)
        except FaultyClaimError as error:
            cause = error.__cause__ or error
            raise StudyError([beside.blame(path, cause, str(error))]) from None
    return _write(folder / CLAIMS, study, {"claims_module": path.name}, now, found)


def _draw(stage: Stage, study: Study, folder: Path, now: MadeFrom) -> dict[str, Any]:
    """Make a study's own sections of the report and write ``sections.json``."""
    from gapsweep.report.parts import rendered

    path = study.report_module
    assert path is not None, "the stage is left out without sections"
    sections = _sections(path)
    with _read(stage, folder) as run, beside.blaming(path, "sections"):
        found = {"sections": rendered(sections(run))}
    return _write(folder / SECTIONS, study, {"report_module": path.name}, now, found)


def _write(
    path: Path, study: Study, module: dict[str, str], now: MadeFrom, found: dict[str, Any]
) -> dict[str, Any]:
    """Write what code beside a study has found as JSON, with where it came from."""
    whole = {"study": study.name, **module, "made_from": dict(now), **netcdf.provenance(), **found}
    with recording(path, is_recorded) as temporary:
        text = json.dumps(whole, indent=1, ensure_ascii=False, allow_nan=False)
        temporary.write_text(text + "\n", encoding="utf-8")
    return whole


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
    folder = Path(folder)
    with _run_in(folder):
        if study is not None:
            _draw(*_own_stage(SECTIONS, study, folder))
        return _report(folder)


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
        return write_report(
            folder / REPORT,
            responses,
            stored(AGREEMENT),
            files.enter_context(netcdf.read(folder / TIMING)),
            attractors=stored(ATTRACTORS),
            advice=stored(ADVICE),
            static=stored(STATIC),
            claims=_stored(folder / CLAIMS),
            own_parts=(_stored(folder / SECTIONS) or {}).get("sections", ()),
            work_precision=stored(WORK_PRECISION),
            stability=stored(STABILITY),
            made_from=as_text(made_from(stage, folder, {})),
        )


def _stored(path: Path) -> dict[str, Any] | None:
    """Verdicts or sections of a run; None if there are none, or if they rest on other responses."""
    if not path.exists():
        return None
    if not is_intact(path):
        command = "claims" if path.name == CLAIMS else "report"
        raise StoreError(
            f"{path}: damaged; 'gapsweep {command} {path.parent} --study FILE' makes it again"
        )
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    same = found["made_from"].get(RESPONSES) == " ".join(digests(path.parent / RESPONSES))
    is_of_now = CLAIMS_MODULE in found["made_from"] or REPORT_MODULE in found["made_from"]
    return found if same and is_of_now else None


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
