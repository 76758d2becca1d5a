"""The stages after the cache: which file each one makes, from what, and whether it must.

A file says in `made_from` what it was made from: the digests of its inputs and of the code. A
stage runs only if its file is absent or damaged, or if one of these is no longer the same.
"""

import hashlib
import html
import json
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from gapsweep.errors import ModelError, StoreError
from gapsweep.execution.plan import Plan
from gapsweep.store.artefact import digests, is_intact, sha256
from gapsweep.store.cache import Cache
from gapsweep.store.netcdf import attributes
from gapsweep.study.fingerprint import code_fingerprint
from gapsweep.study.points import OURS, law_code
from gapsweep.study.study import Study

RESPONSES, ATTRACTORS = "responses.nc", "attractors.nc"
STATIC, AGREEMENT, TIMING = "static.nc", "agreement.nc", "timing.nc"
HISTORIES, ADVICE, CLAIMS = "histories.nc", "advice.nc", "claims.json"
WORK_PRECISION, STABILITY = "work_precision.nc", "stability.nc"
REPORT = "report/index.html"

MadeFrom = Mapping[str, str]

DAMAGED = "damaged"  # why a stage runs whose file is not as it was written
_ROWS = 10_000  # looked up at a time
_META = r'<meta name="gapsweep-made-from" content="([^"]*)">'


@dataclass(frozen=True, slots=True)
class Stage:
    """One file of a run.

    Attributes
    ----------
    file : str
        Its path in the run's folder.
    code : str
        The module that makes it; all that it imports counts too.
    inputs : tuple of str
        What it is made from: files of the run, `STUDY`, `POINTS` or `CLAIMS_FILE`.
    """

    file: str
    code: str
    inputs: tuple[str, ...]


# What is made from no file: the settings of the study, and its results in the cache.
STUDY, POINTS, CLAIMS_FILE = "study", "sweep points", "claims file"

STAGES = (
    Stage(RESPONSES, "execution/assemble.py", (STUDY, POINTS)),
    Stage(ATTRACTORS, "execution/assemble.py", (STUDY, POINTS)),
    Stage(STATIC, "analysis/static.py", (STUDY,)),
    Stage(AGREEMENT, "analysis/agreement.py", (RESPONSES, ATTRACTORS)),
    Stage(TIMING, "analysis/timing.py", (RESPONSES,)),
    Stage(HISTORIES, "analysis/histories.py", (STUDY,)),
    Stage(ADVICE, "analysis/advice.py", (STUDY,)),
    Stage(
        CLAIMS,
        "analysis/claims.py",
        (CLAIMS_FILE, RESPONSES, ATTRACTORS, STATIC, AGREEMENT, TIMING),
    ),
    Stage(WORK_PRECISION, "analysis/work_precision.py", (STUDY,)),
    Stage(STABILITY, "analysis/stability.py", (STUDY,)),
    Stage(
        REPORT,
        "report/html.py",
        (
            RESPONSES,
            ATTRACTORS,
            STATIC,
            AGREEMENT,
            TIMING,
            HISTORIES,
            ADVICE,
            CLAIMS,
            WORK_PRECISION,
            STABILITY,
        ),
    ),
)


def sources(study: Study, plan: Plan, cache: Cache) -> MadeFrom:
    """Digests of what is no file of the run: settings of a study, its rows in the cache, claims."""
    digest = hashlib.sha256()
    for start in range(0, len(plan.keys), _ROWS):
        some = plan.keys[start : start + _ROWS]
        stored = cache.checksums(some)
        for key in some:
            digest.update(key + stored.get(key, b"missing"))
    found = {**study_source(study), POINTS: digest.hexdigest()}
    return {**found, **(claims_source(study.claims_file) if study.claims_file else {})}


def study_source(study: Study) -> MadeFrom:
    """Digest of the settings of a study, and of the user's own laws in it."""
    return {STUDY: hashlib.sha256((study.json + _own_laws(study)).encode()).hexdigest()}


def claims_source(path: Path) -> MadeFrom:
    """Digest of a claims file: a threshold changed there makes every verdict stale.

    Raises
    ------
    StoreError
        If the file cannot be read.
    """
    try:
        return {CLAIMS_FILE: sha256(path)}
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror}") from None


def _own_laws(study: Study) -> str:
    """Code of the user's own laws outside of sweeps; that of sweeps is in their keys."""
    codes = []
    labels = [r for table in study.spec.history for r in table.representation]
    labels += [method.label for method in study.spec.bench.method] if study.spec.bench else []
    for label in labels:
        # A law that cannot be imported is a matter of its motion's status.
        with suppress(ModelError):
            codes.append(law_code(label.partition("@")[0]))
    return "".join(code for code in codes if code != OURS)


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
    return {"code": code_fingerprint(stage.code), **inputs}


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
    return f"{', '.join(changed)} changed" if changed else None


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
