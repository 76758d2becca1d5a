"""The stages after the cache: which file each one makes, from what, and whether it must.

A file says in `made_from` what it was made from: the digests of its inputs and of the code. A
stage runs only if its file is absent or damaged, or if one of these is no longer the same.
"""

import hashlib
import html
import json
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import FunctionType
from typing import Any

from gapsweep.errors import ModelError, StudyError
from gapsweep.execution.plan import Plan
from gapsweep.model.labels import AUTO, EXACT
from gapsweep.store.artefact import digests, is_intact, sha256
from gapsweep.store.cache import Cache
from gapsweep.store.netcdf import attributes
from gapsweep.study.study import Study
from gapsweep.user_code.load import inner_name, load_module
from gapsweep.user_code.package_digest import data_fingerprint, package_fingerprint
from gapsweep.user_code.snapshot import Snapshot

RESPONSES, ATTRACTORS = "responses.nc", "attractors.nc"
STATIC, AGREEMENT, TIMING = "static.nc", "agreement.nc", "timing.nc"
HISTORIES, ADVICE, CLAIMS = "histories.nc", "advice.nc", "claims.json"
BRANCHES = "branches.nc"
WORK_PRECISION, STABILITY = "work_precision.nc", "stability.nc"
SECTIONS = "sections.json"
REPORT = "report/index.html"

MadeFrom = Mapping[str, str]

DAMAGED = "damaged"  # why a stage runs whose file is not as it was written
_META = r'<meta name="gapsweep-made-from" content="([^"]*)">'


@dataclass(frozen=True, slots=True)
class Stage:
    """One file of a run.

    Attributes
    ----------
    file : str
        Its path in the run's folder.
    inputs : tuple of str
        What it is made from: files of the run, `STUDY`, `POINTS`, or code beside the study.
    """

    file: str
    inputs: tuple[str, ...]


# What is no file of the run: the settings of the study, its results in the cache, code beside it.
STUDY, POINTS = "study", "sweep points"
CLAIMS_MODULE, REPORT_MODULE = "claims module", "report module"
# What claims and sections read, apart from the datasets that the study makes itself.
_READ = (RESPONSES, ATTRACTORS, STATIC, AGREEMENT, TIMING, HISTORIES, BRANCHES)

STAGES = (
    Stage(RESPONSES, (STUDY, POINTS)),
    Stage(ATTRACTORS, (STUDY, POINTS)),
    Stage(STATIC, (STUDY,)),
    Stage(AGREEMENT, (RESPONSES, ATTRACTORS)),
    Stage(TIMING, (RESPONSES,)),
    Stage(HISTORIES, (STUDY,)),
    Stage(ADVICE, (STUDY,)),
    Stage(BRANCHES, (STUDY, ATTRACTORS)),
    Stage(CLAIMS, (CLAIMS_MODULE, *_READ)),
    Stage(WORK_PRECISION, (STUDY,)),
    Stage(STABILITY, (STUDY,)),
    Stage(SECTIONS, (REPORT_MODULE, *_READ)),
    Stage(
        REPORT,
        (
            RESPONSES,
            ATTRACTORS,
            STATIC,
            AGREEMENT,
            TIMING,
            ADVICE,
            BRANCHES,
            CLAIMS,
            SECTIONS,
            WORK_PRECISION,
            STABILITY,
        ),
    ),
)


def _own_dataset(file: str) -> Stage:
    """The stage of a dataset that a claims module makes."""
    return Stage(file, (STUDY, _code_of(file)))


def _code_of(file: str) -> str:
    return f"code of {file}"


def own_datasets(study: Study) -> dict[str, Callable[[Study], Any]]:
    """What a study's claims module makes beside its claims: functions by the file they make.

    Raises
    ------
    StudyError
        If the module cannot be imported, or its ``DATASETS`` are not what they must be.
    """
    path = study.claims_module
    if path is None:
        return {}
    assert study.claims_code is not None
    given = getattr(load_module(study.claims_code), "DATASETS", {})
    if not isinstance(given, Mapping):
        raise StudyError([f"{path}: DATASETS: must be a dict from names to functions of the study"])
    taken = {stage.file for stage in STAGES}
    for name, function in given.items():
        where = f"{path}: DATASETS: {name!r}"
        if not isinstance(name, str) or not re.fullmatch("[a-z_]+", name):
            raise StudyError([f"{where}: a name must be of the letters a to z and _"])
        if {f"{name}.nc", f"{name}.json"} & taken:
            raise StudyError([f"{where}: a file of gapsweep's own; choose another name"])
        if not callable(function):
            raise StudyError([f"{where}: must be a function of the study, not {function!r:.40}"])
    return {f"{name}.nc": function for name, function in given.items()}


def stages_of(study: Study) -> list[Stage]:
    """The stages of a study.

    Without the exact law there is nothing to agree with, and nothing that could if it is alone;
    without claims nothing to decide. Motions are kept and branches followed only where some are
    asked for, and advice where ``auto`` took it. Scenes of a benchmark whose right answer is stated
    make one file, the others another. Datasets of the study's own come before what reads them.
    """
    labels, bench = study.grid.representations, study.spec.bench
    stated = [scene.expected is not None for scene in bench.scene] if bench else []
    left_out = {
        STATIC: labels == (AUTO,) or not study.model.is_oscillator,  # it is of one displacement
        AGREEMENT: EXACT not in labels or len(labels) == 1,
        ADVICE: AUTO not in labels,
        HISTORIES: not study.spec.history,
        BRANCHES: study.spec.branches is None,
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
            stages += map(_own_dataset, own)
        if not left_out.get(stage.file):
            stages.append(stage)
    return stages


def sources(study: Study, plan: Plan, cache: Cache) -> MadeFrom:
    """Digests of what is no file of the run: settings of a study, rows in the cache, own code."""
    digest = hashlib.sha256()
    digest.update(plan.keys.data)
    for part in cache.checksums(plan.keys):
        digest.update(part)
    return {**study_source(study), POINTS: digest.hexdigest(), **module_sources(study)}


def study_source(study: Study) -> MadeFrom:
    """Digest of the settings of a study, and of the user's own laws in it."""
    said = study.json + _own_laws(study) + study.model.json
    return {STUDY: hashlib.sha256(said.encode()).hexdigest()}


def module_sources(study: Study) -> MadeFrom:
    """Digests of the code beside a study: an edit there makes what it decides or draws stale.

    Raises
    ------
    StudyError
        If it cannot be read or imported.
    """
    modules = {CLAIMS_MODULE: study.claims_code, REPORT_MODULE: study.report_code}
    found = {name: code.key for name, code in modules.items() if code is not None}
    for file, function in own_datasets(study).items():
        assert study.claims_code is not None, "datasets come from there"
        found[_code_of(file)] = _key_of(function, study.claims_code)
    return found


def _key_of(function: Any, code: Snapshot) -> str:
    """Key of the code of a callable that a module names.

    A function of another module depends on that module alone: the rest of the code may be edited.
    Everything else, such as a closure, depends on all of the code.
    """
    name = getattr(function, "__qualname__", "")
    module = sys.modules.get(getattr(function, "__module__", None) or "")
    if isinstance(function, FunctionType) and vars(module).get(name) is function:
        assert module is not None
        if (inner := inner_name(module.__name__, code)) is not None:
            return f"{name} {code.part(inner).key}"
    return code.key


def _own_laws(study: Study) -> str:
    """Code of the user's own laws outside of sweeps; that of sweeps is in their keys."""
    codes = []
    labels = [r for table in study.spec.history for r in table.representation]
    labels += [method.label for method in study.spec.bench.method] if study.spec.bench else []
    for label in labels:
        # A law that cannot be imported is a matter of its motion's status.
        with suppress(ModelError):
            if (own := study.own_law(label)) is not None:
                codes.append(own.key)
    return "".join(codes)


def made_from(stage: Stage, folder: Path, sources: MadeFrom) -> MadeFrom:
    """What a stage's file would be made from now.

    Parameters
    ----------
    stage : Stage
    folder : Path
        Of the run; the files of earlier stages are up to date there.
    sources : mapping
        Digests of the inputs that are no files, as from the function `sources`.
    """
    inputs = {
        name: sources.get(name) or " ".join(digests(folder / name)) or "absent"
        for name in stage.inputs
    }
    is_drawn = stage.file in (SECTIONS, REPORT)
    return {"code": package_fingerprint() if is_drawn else data_fingerprint(), **inputs}


def reason_to_run(stage: Stage, folder: Path, now: MadeFrom) -> str | None:
    """Why a stage must run; None if its file is up to date."""
    path = folder / stage.file
    if not path.exists():
        return "absent"
    intact = is_intact(path)
    if not intact:
        return DAMAGED if intact is False else "no SHA-256 of it is recorded"
    before = _recorded(path)
    if not before:
        return "not known what it was made from"
    changed = [name for name in {**now, **before} if now.get(name) != before.get(name)]
    if changed:
        return f"{', '.join(changed)} changed"
    lost = next((each for each in _beside(path) if not (each.exists() and is_intact(each))), None)
    return f"{lost.relative_to(folder)} absent or damaged" if lost else None


def _beside(path: Path) -> Iterator[Path]:
    """The files in folders of its own that a page leads to."""
    if path.suffix == ".html":
        page = path.read_text(encoding="utf-8", errors="replace")
        for name in dict.fromkeys(re.findall(r'href="(\w+/[\w.-]+)"', page)):
            yield path.parent / name


def is_of_run(path: Path) -> bool:
    """Whether a file rests on the responses beside it, or on the settings of their study.

    Another study of the same name may have left it there. What is measured after the responses
    counts too: scenes of a benchmark are changed without a new sweep.
    """
    responses, before = path.with_name(RESPONSES), _recorded(path)
    if RESPONSES in before:
        present = digests(responses) or [sha256(responses)]  # SHA256SUMS may not have come along
        return before[RESPONSES] == " ".join(present)
    ours, theirs = (attributes(file).get("created", "") for file in (path, responses))
    return ours >= theirs or before.get(STUDY) == _recorded(responses).get(STUDY)


def as_text(made_from: MadeFrom) -> str:
    """What a file was made from, for its attribute or meta element."""
    return json.dumps(dict(made_from), sort_keys=True)


def _recorded(path: Path) -> MadeFrom:
    """What a file says it was made from; nothing if it cannot be made out."""
    try:
        if path.suffix == ".nc":
            return dict(json.loads(attributes(path).get("made_from", "{}")))
        if path.suffix == ".json":
            return dict(json.loads(path.read_text(encoding="utf-8"))["made_from"])
        found = re.search(_META, path.read_text(encoding="utf-8", errors="replace"))
        return dict(json.loads(html.unescape(found[1]))) if found else {}
    except (OSError, ValueError, TypeError, KeyError):
        return {}
