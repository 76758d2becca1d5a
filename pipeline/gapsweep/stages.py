"""The files of a run in the order in which they are made, with inputs, functions and studies.

A file is made only if it is absent or damaged, or if one of its inputs or the code has changed.
numba, xarray and matplotlib are imported by the stages that need them: a run that finds everything
up to date ends before they would be loaded.
"""

import gc
import hashlib
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gapsweep.errors import ModelError, StoreError, StudyError
from gapsweep.execution.assemble import export
from gapsweep.execution.plan import Plan
from gapsweep.execution.progress import DEFAULT_TIMEOUT
from gapsweep.model.labels import AUTO, EXACT
from gapsweep.run_folder import (
    ADVICE,
    AGREEMENT,
    ATTRACTORS,
    BRANCHES,
    CLAIMS,
    CURVES,
    DAMAGED,
    FIT,
    GRADIENTS,
    HISTORIES,
    REPORT,
    RESPONSES,
    RISK,
    SECTIONS,
    STABILITY,
    STATIC,
    STUDY,
    TIMING,
    WORK_PRECISION,
    MadeFrom,
    as_text,
    is_of_run,
    read_json,
    reason_to_make,
    write,
)
from gapsweep.status import Status
from gapsweep.store import netcdf
from gapsweep.store.artefact import digests, reading
from gapsweep.study.study import Study
from gapsweep.study_code import (
    dataset_key,
    decide_claims,
    draw_sections,
    make_dataset,
    own_datasets,
)
from gapsweep.user_code.package_digest import data_fingerprint, package_fingerprint
from gapsweep.user_code.snapshot import Snapshot

if TYPE_CHECKING:
    import xarray as xr

    from gapsweep.response.result import Responses
    from gapsweep.study.points import Points

    Content = xr.Dataset | dict[str, Any] | None

_MANY = 100_000  # points; larger datasets justify a garbage collection after each stage


def _ignore(stage: str) -> None:
    """Do nothing: the default observer of stages."""


@dataclass(frozen=True, slots=True)
class RunContext:
    """Arguments of the stages of a run."""

    folder: Path  # folder of the run
    study: Study
    # The sweep points and where they are stored, for stages that read them.
    plan: Plan | None = None
    # Steps of `meanwhile` that a run has begun while points were computed.
    exporting: Iterator[bool] | None = None
    cache: Path = Path()  # folder of the cache
    # Returns the client of a cluster, for branches that are not stored.
    connect: Callable[[], Any] | None = None
    # Makes files that do not need the present one, one in each step.
    meanwhile: Iterable[bool] = ()
    timeout: float = DEFAULT_TIMEOUT  # time [s] that a motion with a user's law may take
    say: Callable[[str], None] = _ignore  # called with a text before each stage
    inputs: tuple[str, ...] = ()  # files of the run that the present stage is made from
    made_from: str = ""  # digests of the inputs of the present file, as JSON
    # Digests of the sources, once they are known.
    digests: dict[str, str] = field(default_factory=dict)

    def digest(self, source: "Source") -> str:
        """The digest of a source, computed at its first use and kept."""
        if source.name not in self.digests:
            self.digests[source.name] = source.digest(self)
        return self.digests[source.name]

    @contextmanager
    def datasets(self) -> "Iterator[dict[str, xr.Dataset]]":
        """The datasets among the inputs of the present stage, as `opened` returns them."""
        with opened(self.folder, self.inputs) as found:
            yield found


@dataclass(frozen=True, slots=True)
class Source:
    """An input of a stage that is no file, with the function that computes its digest."""

    name: str
    digest: Callable[[RunContext], str]


@dataclass(frozen=True, slots=True)
class Stage:
    """A file of a run, with its inputs and the function that makes it."""

    file: str  # its path in the run's folder
    inputs: tuple[str, ...]  # files of the run that it is made from
    sources: tuple[Source, ...]  # inputs that are no files
    # Makes it; returns what is to be written, or None if it has written the file.
    make: Callable[[RunContext], "Content"]
    applies: Callable[[Study], bool] = lambda study: True  # whether a study has such a file
    # The variable in it that holds statuses of motions, and the first one that is a failure.
    failures: tuple[str, Status] | None = None
    is_drawn: bool = False  # whether it depends on code that draws, too

    def made_from(self, folder: Path, run: RunContext | None = None) -> MadeFrom:
        """Present digests of the file's inputs and of the code, to compare with the stored ones.

        `folder`: folder of the run.
        `run`: gives the digests of sources; not needed for a page, which has no sources.
        """
        found = {"code": package_fingerprint() if self.is_drawn else data_fingerprint()}
        for name in self.inputs:
            found[name] = " ".join(digests(folder / name)) or "absent"
        for source in self.sources:
            assert run is not None, "digests of sources need the run"
            found[source.name] = run.digest(source)
        return found

    def failed_motions(self, folder: Path) -> dict[str, int]:
        """Number of failed motions in the file, by label of their status."""
        if self.failures is None:
            return {}
        variable, first = self.failures
        found = netcdf.values(folder / self.file, variable)
        counts = {
            status.label: int((found == status).sum()) for status in Status if status >= first
        }
        return {label: n for label, n in counts.items() if n}


def make_files(
    stages: Iterable[Stage], run: RunContext, *, n_points: int = 0, retry_failed: bool = False
) -> None:
    """Make those files of some stages that are not up to date.

    While workers compute branches, this process makes the next files that need none. If one of
    these fails, its error is raised after the branches are written.

    `n_points`: sweep points of the study.
    `retry_failed`: whether to rewrite files with failed motions.
    """
    left, failed = deque(stages), list[Exception]()

    def next_files(file: str) -> Iterator[bool]:
        while left and file not in left[0].inputs and not failed:
            try:
                make(left.popleft())
            except Exception as error:  # raised after the file that was being made
                failed.append(error)
            yield True

    def make(stage: Stage) -> None:
        path, now = run.folder / stage.file, stage.made_from(run.folder, run)
        reason = reason_to_make(path, now)
        if reason == DAMAGED:
            warnings.warn(
                f"{path}: damaged or changed since it was written; gapsweep rewrites it",
                stacklevel=4,
            )
        if reason or (retry_failed and stage.failed_motions(run.folder)):
            run.say(f"making {stage.file}")
            make_file(stage, replace(run, meanwhile=next_files(stage.file)))
            if n_points > _MANY:
                gc.collect()  # reference cycles would keep their memory during the next stage

    while left:
        make(left.popleft())
        if failed:
            raise failed[0]


def make_file(stage: Stage, run: RunContext) -> None:
    """Make the file of a stage, whether it is up to date or not."""
    made_from = as_text(stage.made_from(run.folder, run))
    content = stage.make(replace(run, inputs=stage.inputs, made_from=made_from))
    if content is not None:
        write(run.folder / stage.file, content, made_from)


def stages_of(study: Study) -> list[Stage]:
    """The stages of a study; user datasets come before the stages that read them."""
    own = _own_stages(study)
    found: list[Stage] = []
    for stage in (stage for stage in STAGES if stage.applies(study)):
        if stage.file == CLAIMS:
            found += own
        if stage.file in (CLAIMS, SECTIONS):
            stage = replace(stage, inputs=(*stage.inputs, *(each.file for each in own)))
        found.append(stage)
    return found


def _own_stages(study: Study) -> list[Stage]:
    """The stages of the datasets that a study's claims module makes."""
    taken = {stage.file.partition(".")[0] for stage in STAGES}
    stages = []
    for file, function in own_datasets(study).items():
        name = file.removesuffix(".nc")
        if name in taken:
            assert study.claims_code is not None, "datasets come from there"
            where = f"{study.claims_code.path}: DATASETS: {name!r}"
            raise StudyError(f"{where}: the name of a file of gapsweep; choose another name")
        code = Source(f"code of {file}", partial(_own_code, function))
        stages.append(Stage(file, (), (SETTINGS, code), partial(_own_dataset, file, function)))
    return stages


def _own_code(function: Callable[[Study], Any], run: RunContext) -> str:
    return dataset_key(run.study, function)


def _own_dataset(file: str, function: Callable[[Study], Any], run: RunContext) -> "xr.Dataset":
    return make_dataset(run.study, file, function)


@contextmanager
def opened(folder: Path, names: Iterable[str]) -> "Iterator[dict[str, xr.Dataset]]":
    """Open the datasets among some files of a run, as a dict by name without suffix.

    Files that are absent or belong to another study are left out.
    """
    with ExitStack() as files:
        found = {}
        for path in (folder / name for name in names if name.endswith(".nc")):
            if path.exists():
                dataset = files.enter_context(netcdf.read(path, lazy=True))
                if is_of_run(path):
                    found[path.stem] = dataset
        yield found


def write_page(folder: Path) -> Path:
    """Write the report of a run from the files in its folder; no code there is executed."""
    from gapsweep.report.html import write_report
    from gapsweep.report.inputs import Inputs

    page = folder / REPORT
    if page.parent.is_symlink():
        raise StoreError(f"{page.parent}: must be a folder, is a symbolic link; remove it")
    with reading(folder), opened(folder, PAGE.inputs) as found:
        inputs = Inputs(
            **found,
            claims=read_json(folder / CLAIMS),
            sections=(read_json(folder / SECTIONS) or {}).get("sections"),
        )
        return write_report(page, inputs, as_text(PAGE.made_from(folder)))


def _points_digest(run: RunContext) -> str:
    """Digest of the stored results of a study's sweep points."""
    assert run.plan is not None, "stages that read points are made with them"
    return run.plan.digest()


def _settings_digest(run: RunContext) -> str:
    """Digest of the settings of a study, and of the user's laws outside of its sweeps.

    The laws of sweeps are part of the keys of points.
    """
    study, codes = run.study, []
    labels = [label for table in study.spec.history for label in table.representation]
    labels += [method.label for method in study.spec.bench.method] if study.spec.bench else []
    for label in labels:
        # A law that cannot be imported is a matter of its motion's status.
        with suppress(ModelError):
            if (own := study.own_law(label)) is not None:
                codes.append(own.key)
    return hashlib.sha256("".join([study.json, *codes, study.model.json]).encode()).hexdigest()


def _code_key(code: Snapshot | None) -> str:
    assert code is not None, "the stage does not apply without a module"
    return code.key


SETTINGS, POINTS = Source(STUDY, _settings_digest), Source("sweep points", _points_digest)
CLAIMS_MODULE = Source("claims module", lambda run: _code_key(run.study.claims_code))
REPORT_MODULE = Source("report module", lambda run: _code_key(run.study.report_code))


def load_report() -> bool:
    """Load the code of the report, which takes a second."""
    from gapsweep.report import html

    return bool(html)


def meanwhile(run: RunContext) -> Generator[bool, None, None]:
    """Load the code of the report, and write ``responses.nc`` and ``attractors.nc``, in steps.

    A run takes these steps while it waits for points; see `export`.
    """
    yield load_report()
    yield from _export(run)


def _export(run: RunContext) -> Iterator[bool]:
    assert run.plan is not None
    return export(
        *(run.plan, run.folder / RESPONSES, run.folder / ATTRACTORS),
        made_from=lambda: as_text(STAGES[0].made_from(run.folder, run)),
        respond=partial(_on_workers, run) if run.study.spec.attractors else None,
    )


def _on_workers(run: RunContext, tables: "list[Points]") -> "list[Responses]":
    """Responses of tables of points from their fixed initial states."""
    from gapsweep.execution.execute import responses_from

    assert run.connect is not None
    return responses_from(tables, run.connect())


def _responses(run: RunContext) -> None:
    """Write ``responses.nc`` and ``attractors.nc`` from the cache, both in one pass."""
    for _ in run.exporting or _export(run):
        pass


def _static(run: RunContext) -> "xr.Dataset":
    from gapsweep.analysis.datasets.static import static

    with run.datasets() as found:
        return static(run.study, found.get("responses"))


def _agreement(run: RunContext) -> "xr.Dataset":
    from gapsweep.analysis.agreement.comparison import agreement

    with run.datasets() as found:
        return agreement(**found)


def _timing(run: RunContext) -> "xr.Dataset":
    from gapsweep.analysis.datasets.timing import timing

    with run.datasets() as found:
        return timing(**found)


def _histories(run: RunContext) -> "xr.Dataset":
    from gapsweep.analysis.datasets.histories import histories

    return histories(run.study, timeout=run.timeout)


def _advice(run: RunContext) -> "xr.Dataset":
    from gapsweep.analysis.datasets.recommendations import advice

    return advice(run.study)


def _branches(run: RunContext) -> "xr.Dataset":
    from gapsweep.analysis.datasets.branches_file import branches

    assert run.connect is not None
    how = run.cache, run.connect, run.timeout, run.say, run.meanwhile
    with run.datasets() as found:
        return branches(run.study, found["attractors"], *how, found.get("branches"))


def _risk(run: RunContext) -> "xr.Dataset":
    from gapsweep.analysis.datasets.risk import risk_of

    assert run.study.spec.uncertain is not None
    with run.datasets() as found:
        return risk_of(found["responses"], run.study.spec.uncertain)


def _fit(run: RunContext) -> "xr.Dataset":
    from gapsweep.analysis.datasets.fit_file import fit_of

    return fit_of(run.study)


def _gradients(run: RunContext) -> "xr.Dataset":
    from gapsweep.analysis.datasets.gradients_file import gradients_of

    with run.datasets() as found:
        return gradients_of(run.study, found["attractors"])


def _claims(run: RunContext) -> dict[str, Any]:
    with run.datasets() as found:
        return decide_claims(run.study, found)


def _work_precision(run: RunContext) -> "xr.Dataset":
    from gapsweep.analysis.bench.work_precision import work_precision

    return work_precision(run.study, say=run.say, timeout=run.timeout)


def _stability(run: RunContext) -> "xr.Dataset":
    from gapsweep.analysis.bench.stability import stability

    return stability(run.study, say=run.say, timeout=run.timeout)


def _sections(run: RunContext) -> dict[str, Any]:
    with run.datasets() as found:
        return draw_sections(run.study, found)


def _report(run: RunContext) -> None:
    write_page(run.folder)


def _has_contacts_to_fit(study: Study) -> bool:
    """Whether the study is of an oscillator and sweeps a law other than ``auto``."""
    return study.model.is_oscillator and study.grid.representations != (AUTO,)


def _compares(study: Study) -> bool:
    """Whether the study compares the exact law and another one in single parameter sets."""
    if study.spec.uncertain:  # their risks are compared
        return False
    return EXACT in study.grid.representations and len(study.grid.representations) > 1


def _bench_scenes(study: Study) -> list[bool]:
    """Whether the solution is stated, for every benchmark scenario."""
    scenes = study.spec.bench.scene if study.spec.bench else []
    return [scene.expected is not None for scene in scenes]


_DATASETS = (
    *(RESPONSES, ATTRACTORS, STATIC, AGREEMENT, TIMING, HISTORIES, BRANCHES, CURVES, RISK),
    *(FIT, GRADIENTS),
)
PAGE = Stage(
    REPORT,
    (
        *(RESPONSES, ATTRACTORS, STATIC, AGREEMENT, TIMING, ADVICE, BRANCHES, CURVES),
        *(RISK, FIT, GRADIENTS, CLAIMS, SECTIONS, WORK_PRECISION, STABILITY),
    ),
    (),
    _report,
    is_drawn=True,
)
STAGES = (
    Stage(RESPONSES, (), (SETTINGS, POINTS), _responses),
    Stage(ATTRACTORS, (), (SETTINGS, POINTS), _responses),
    # Costs are measured while no worker computes branches.
    # Failures of methods are results; only a status of user code counts as a failure.
    Stage(
        WORK_PRECISION,
        (),
        (SETTINGS,),
        _work_precision,
        lambda study: not all(_bench_scenes(study)),
        failures=("status", Status.TIMED_OUT),
    ),
    Stage(
        STABILITY,
        (),
        (SETTINGS,),
        _stability,
        lambda study: any(_bench_scenes(study)),
        failures=("status", Status.TIMED_OUT),
    ),
    Stage(
        BRANCHES,
        (ATTRACTORS,),
        (SETTINGS,),
        _branches,
        lambda study: study.spec.branches is not None,
        failures=("attractor_status", Status.DIVERGED),
    ),
    # Made while workers compute the branches, down to the first stage that needs them.
    Stage(STATIC, (RESPONSES,), (SETTINGS,), _static, _has_contacts_to_fit),
    Stage(AGREEMENT, (RESPONSES, ATTRACTORS), (), _agreement, _compares),
    Stage(TIMING, (RESPONSES,), (), _timing),
    Stage(
        HISTORIES,
        (),
        (SETTINGS,),
        _histories,
        lambda study: bool(study.spec.history),
        failures=("status", Status.DIVERGED),
    ),
    Stage(ADVICE, (), (SETTINGS,), _advice, lambda study: AUTO in study.grid.representations),
    Stage(
        CURVES,
        (ATTRACTORS, BRANCHES),
        (SETTINGS,),
        _branches,
        lambda study: study.spec.branches is not None and study.spec.branches.second is not None,
        failures=("attractor_status", Status.DIVERGED),
    ),
    Stage(RISK, (RESPONSES,), (SETTINGS,), _risk, lambda study: study.spec.uncertain is not None),
    Stage(
        GRADIENTS,
        (ATTRACTORS,),
        (SETTINGS,),
        _gradients,
        lambda study: study.spec.gradients is not None,
    ),
    Stage(
        FIT,
        (),
        (SETTINGS,),
        _fit,
        lambda study: study.spec.fit is not None,
        failures=("fit_status", Status.DIVERGED),
    ),
    Stage(
        CLAIMS,
        _DATASETS,
        (CLAIMS_MODULE,),
        _claims,
        lambda study: study.spec.claims is not None,
    ),
    Stage(
        SECTIONS,
        _DATASETS,
        (REPORT_MODULE,),
        _sections,
        lambda study: study.spec.report is not None,
        is_drawn=True,
    ),
    PAGE,
)
