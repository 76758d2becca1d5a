"""What a study's own code makes of a run: datasets, verdicts, sections of the report.

xarray and matplotlib are imported by what needs them: a run that finds everything up to date ends
before they would be loaded.
"""

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gapsweep.errors import StoreError, StudyError
from gapsweep.folder import alone_in_run, check_owner
from gapsweep.stages import (
    CLAIMS,
    SECTIONS,
    MadeFrom,
    Stage,
    is_of_run,
    made_from,
    module_sources,
    own_datasets,
    stages_of,
)
from gapsweep.store import netcdf
from gapsweep.store.artefact import is_intact, is_recorded, recording
from gapsweep.study.study import Study
from gapsweep.user_code.load import load_module, user_errors
from gapsweep.user_code.snapshot import Snapshot

if TYPE_CHECKING:
    import xarray as xr

    from gapsweep.analysis.claims import Claim, Run


def own_dataset(file: str, make: Callable[[Study], Any], study: Study) -> "xr.Dataset":
    """A dataset that the study's claims module makes."""
    import xarray as xr

    assert study.claims_module is not None, "datasets come from there"
    with user_errors(study.claims_module, file, make):
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
    if study.claims_code is not None:
        _stated(study.claims_code)
    if study.report_code is not None:
        _sections(study.report_code)


def _stated(code: Snapshot) -> "list[Claim]":
    """The claims that a module states."""
    from gapsweep.analysis.claims import stated

    try:
        return stated(vars(load_module(code)))
    except ValueError as error:
        raise StudyError([f"{code.path}: {error}"]) from None


def _sections(code: Snapshot) -> "Callable[[Run], Any]":
    """The function of a module that makes sections of the report."""
    found: Callable[[Run], Any] | None = getattr(load_module(code), "sections", None)
    if not callable(found):
        message = f"{code.path}: no function sections(run), which returns parts of the report"
        raise StudyError([message])
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
    folder = Path(folder).absolute()
    with alone_in_run(folder):
        if study is not None:
            return decide(*own_stage(CLAIMS, Study.of(study), folder))
        decided = stored(folder / CLAIMS)
    if decided is None:
        raise StoreError(
            f"{folder / CLAIMS}: no verdicts on the responses of this run: "
            f"'gapsweep claims {folder} --study FILE' decides the claims of a study"
        )
    return decided


def own_stage(file: str, study: Study, folder: Path) -> tuple[Stage, Study, Path, MadeFrom]:
    """What a stage of code beside a study is made with, for a run that may be another study's."""
    check_owner(study, folder)
    stage = next((stage for stage in stages_of(study) if stage.file == file), None)
    if stage is None:
        table, name = ("claims", "claims.py") if file == CLAIMS else ("report", "figures.py")
        example = f'[{table}] module = "{name}" names the Python file'
        raise StudyError([f"{study.source}: {table}: missing; {example}"])
    return stage, study, folder, made_from(stage, folder, module_sources(study))


@contextmanager
def _read(stage: Stage, folder: Path) -> "Iterator[Run]":
    """The datasets that a stage reads, those that are there."""
    from gapsweep.analysis.claims import Run

    with ExitStack() as opened:
        yield Run(
            {
                name.removesuffix(".nc"): opened.enter_context(
                    netcdf.read(folder / name, lazy=True)
                )
                for name in stage.inputs
                if name.endswith(".nc") and (folder / name).exists()
            }
        )


def decide(stage: Stage, study: Study, folder: Path, now: MadeFrom) -> dict[str, Any]:
    """Decide the claims of a study and write ``claims.json``."""
    from gapsweep.analysis.claims import counted

    code, path = study.claims_code, study.claims_module
    assert code is not None
    assert path is not None, "the stage is left out without claims"
    claims, decided = _stated(code), []
    with _read(stage, folder) as run:
        for claim in claims:
            with user_errors(path, f"claim {claim.id}", claim.find):
                decided.append(claim.decided(run))
    return _write(folder / CLAIMS, study, path, now, counted(decided))


def draw(stage: Stage, study: Study, folder: Path, now: MadeFrom) -> dict[str, Any]:
    """Make a study's own sections of the report and write ``sections.json``."""
    from gapsweep.report.parts import rendered

    code, path = study.report_code, study.report_module
    assert code is not None
    assert path is not None, "the stage is left out without sections"
    sections = _sections(code)
    with _read(stage, folder) as run, user_errors(path, "sections", sections):
        # Apart from the report's own.
        parts = [part | {"anchor": f"own-{part['anchor']}"} for part in rendered(sections(run))]
        found = {"sections": parts}
    return _write(folder / SECTIONS, study, path, now, found)


def _write(
    path: Path, study: Study, module: Path, now: MadeFrom, found: dict[str, Any]
) -> dict[str, Any]:
    """Write what code beside a study has found as JSON, with where it came from."""
    named = "claims_module" if path.name == CLAIMS else "report_module"
    origin = {"study": study.name, named: module.name, "made_from": dict(now)}
    whole = {**origin, **netcdf.provenance(), **found}
    with user_errors(module, path.stem):  # texts that are none, half characters
        text = json.dumps(whole, indent=1, ensure_ascii=False, allow_nan=False).encode()
    with recording(path, is_recorded) as temporary:
        temporary.write_bytes(text + b"\n")
    return whole


def stored(path: Path) -> dict[str, Any] | None:
    """Verdicts or sections of a run; None if there are none, or none of these responses."""
    if not path.exists():
        return None
    if not (intact := is_intact(path)):
        command = "claims" if path.name == CLAIMS else "report"
        why = "damaged" if intact is False else "no SHA-256 of it is recorded in SHA256SUMS"
        raise StoreError(
            f"{path}: {why}; 'gapsweep {command} {path.parent} --study FILE' makes it again"
        )
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found if is_of_run(path) else None
