"""Commands on studies.

The numerical modules take seconds to import: each command imports only those it uses.
"""

import json
from collections.abc import Mapping
from datetime import timedelta
from pathlib import Path
from typing import Any

import click

from gapsweep.cli import options
from gapsweep.cli.options import FINISHED, SOME_FAILED, echo


@click.command()
@options.study
@options.out
@options.workers
@options.scheduler
@options.engine
@options.cache
@click.option(
    "--batch",
    type=click.IntRange(min=1),
    help="Sweep points per task.  [default: from measured cost]",
)
@options.timeout
@options.retry_failed
@click.option(
    "--dashboard",
    is_flag=True,
    help="Serve Dask's dashboard of the local processes at http://127.0.0.1:8787/status.",
)
def run(study: Path, engine: str | None, **how: Any) -> int:
    """Compute a study with its datasets and report, or resume it.

    \b
    Examples:
      gapsweep run quick.toml
      gapsweep run quick.toml --out /tmp/quick --workers 4
      gapsweep run quick.toml --scheduler tcp://host:8786
    """
    from gapsweep import pipeline
    from gapsweep.run_folder import REPORT

    loaded = options.loaded(study, engine)
    with options.at_work() as observer:
        outcome = pipeline.carry_out(loaded, on_progress=observer, **how)
    done = outcome.progress
    shared = f", {done.n_shared} by another run" if done.n_shared else ""
    echo(
        f"{done.n_points} points: {done.n_hits} from the cache, {done.n_computed} computed{shared}"
    )
    echo(f"report: {outcome.folder / REPORT}")
    if outcome.failures:
        _say_failed("points", outcome.failures, f"'gapsweep status {outcome.folder}'")
    for file, counts in outcome.failed_motions.items():
        _say_failed("motions", counts, f"'status' in {file}")
    for doubt in outcome.doubts:  # last, since they may put the results in doubt
        echo(doubt)
    return SOME_FAILED if outcome.failures or outcome.failed_motions else FINISHED


def _say_failed(what: str, counts: Mapping[str, int], where: str) -> None:
    listed = ", ".join(f"{n} {label}" for label, n in sorted(counts.items()))
    echo(f"failed {what}: {listed}; see {where}", err=True)


@click.command()
@options.study
@options.cache
@options.out
@options.engine
@options.workers
@options.retry_failed
@options.as_json
def plan(
    study: Path,
    cache: Path | None,
    out: Path | None,
    engine: str | None,
    workers: int,
    retry_failed: bool,
    as_json: bool,
) -> int:
    """Show what a run would compute and which files it would make.

    \b
    Examples:
      gapsweep plan quick.toml
      gapsweep plan quick.toml --json
    """
    from gapsweep import pipeline
    from gapsweep.console import print_table
    from gapsweep.execution.plan import BYTES
    from gapsweep.study.unit_check import bounded, doubts_of

    loaded = options.loaded(study, engine)
    with options.at_work() as observer:
        planned = pipeline.plan(loaded, cache, retry_failed=retry_failed, on_progress=observer)
        expected = pipeline.expected_seconds(planned, workers)
        stages = pipeline.stage_reasons(loaded, planned, out)
    doubts = [*doubts_of(loaded, bounded(loaded))]
    numbers = {
        "points": planned.n_points,
        "hits": planned.n_hits,
        "missing": planned.n_missing,
        "failed": planned.n_failed,
    }
    if as_json:
        rounded = None if expected is None else round(expected, 3)
        echo(json.dumps(numbers | {"expected_s": rounded, "stages": stages, "doubts": doubts}))
        return FINISHED
    for name, value in numbers.items():
        echo(f"{name:>8}  {value}")
    unknown = "unknown (no comparable points cached)"
    time = unknown if expected is None else f"{timedelta(seconds=round(expected))} (h:mm:ss)"
    echo(f"expected  {time}")
    echo(f"    disk  about {planned.n_points * BYTES / 1e6:.3g} MB when all points are stored")
    states = {
        file: f"to be written: {why}" if why else "up to date" for file, why in stages.items()
    }
    echo()
    print_table(("file", "state"), states.items())
    for doubt in doubts:
        echo(f"\n{doubt}")
    return FINISHED


@click.command()
@options.study
@options.selection
@options.cache
@options.engine
@options.workers
@options.scheduler
@click.option(
    "--to",
    "form",
    type=click.Choice(["table", "csv", "json", "nc"]),
    help="Format: a short table, csv or json lines with a row per point, or NetCDF (nc). Lengths "
    "are in mm in table and csv, which have units in their headers, else in m.  "
    "[default: table on a terminal, else csv]",
)
@click.option(
    "--columns",
    metavar="NAME,...",
    help="Variables to print, or all.  [default: four in a table, eleven in csv, all in json]",
)
@click.option(
    "--digits",
    type=click.IntRange(1, 17),
    help="Significant digits.  [default: 4 in a table, else all]",
)
@click.option(
    "--output", type=click.Path(path_type=Path, dir_okay=False), help="New file.  [default: stdout]"
)
def query(
    study: Path,
    wanted: tuple[str, ...],
    engine: str | None,
    form: str | None,
    columns: str | None,
    digits: int | None,
    output: Path | None,
    **how: Any,
) -> int:
    """Print responses; compute only points missing in the cache.

    \b
    Examples:
      gapsweep query quick.toml --sel omega=10:12
      gapsweep query quick.toml --sel K_c=14000 --columns x_max,status --digits 6
      gapsweep query quick.toml --sel representation=piecewise \\
          --to nc --output exact.nc
    """
    from gapsweep import pipeline
    from gapsweep.cli.query_output import Form, check_output, written
    from gapsweep.status import Status

    shown = Form.of(form, columns, digits, output)
    if output is not None:
        check_output(output)
        output = output.absolute()
    loaded = options.loaded(study, engine)
    shown.check(loaded)
    with options.at_work() as observer:
        found = pipeline.query(loaded, on_progress=observer, **how, **options.selected(wanted))
    n_points = found.attrs["n_points"]
    n_before = n_points - int((found["status"] != Status.NOT_REQUESTED).sum())
    before = f"; {n_before} precede the selection in a sweep" if n_before > 0 else ""
    echo(f"{n_points} points, {found.attrs['n_hits']} from the cache{before}", err=True)
    written(found, shown, output)
    if shown.hint:
        echo(shown.hint, err=True)
    return FINISHED


@click.command()
@options.study
@options.selection
@options.cache
@options.engine
@click.option(
    "--limit",
    type=click.IntRange(min=1),
    default=10,
    show_default=True,
    help="Largest number of points.",
)
def explain(
    study: Path, wanted: tuple[str, ...], cache: Path | None, engine: str | None, limit: int
) -> int:
    """Explain why points are in the cache or missing.

    Compares the fields of each point's key with those of the nearest stored key.

    \b
    Example:
      gapsweep explain quick.toml --sel omega=10
    """
    from gapsweep import pipeline

    loaded = options.loaded(study, engine)
    with options.at_work() as observer:
        points = pipeline.explain(loaded, cache, limit + 1, observer, **options.selected(wanted))
    for n, point in enumerate(points):
        if n == limit:
            echo(f"more points: --limit {10 * limit}")
            break
        echo(f"{point.label}: {point.status}{f' on {point.host}' if point.host else ''}")
        if point.message:
            echo(f"  {point.message}")
        if point.differences is None and point.status == "missing":
            echo("  no comparable points cached")
        for name, (asked, stored) in (point.differences or {}).items():
            echo(f"  {name}: {_short(asked)}; nearest cached point: {_short(stored)}")
    return FINISHED


def _short(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:18]}...{text[-18:]}"


@click.command()
@options.study
@click.option(
    "--error",
    type=float,
    help="Allowed relative error of the steady amplitude, 1e-9 to 0.1.  "
    "[default: [auto] of the study, else 1e-3]",
)
@click.option(
    "--share",
    type=float,
    default=0.95,
    show_default=True,
    help="Share of the exact law's periodic attractors that a smooth law is to find: 0.95, 0.9 "
    "or 0.8.",
)
@options.as_json
def advise(study: Path, error: float | None, share: float, as_json: bool) -> int:
    """Recommend the simplest adequate model for each case.

    \b
    Example:
      gapsweep advise quick.toml --error 1e-2
    """
    from gapsweep.analysis.datasets.recommendations import advice, sentences
    from gapsweep.console import print_table, print_text
    from gapsweep.model.labels import EXACT

    loaded = options.loaded(study, None)
    found = advice(loaded, error, share)
    scenes, error = sentences(found), found.attrs["error"]
    labels = dict.fromkeys(one.law for one in loaded.spec.representations)
    left = [one for one in labels if one.is_own or (one.is_located and one != EXACT)]
    if as_json:
        echo(json.dumps({"error": error, "share": share, "not_assessed": left, "scenes": scenes}))
        return FINISHED
    print_text(f"allowed relative error of the steady amplitude, for the simplest model: {error:g}")
    for scene in scenes:
        print_text(_case(scene, loaded.model.is_oscillator))
        for one in scene["starts"]:
            echo(f"\nfrom {one['start']}:")
            print_table(
                ("from [Hz]", "to [Hz]", "simplest model", "rtol", "reason"),
                [
                    (*(f"{part[end]:g}" for end in ("from", "to")), part["model"],
                     f"{part['rtol']:g}", part["reason"])
                    for part in one["advice"]
                ],
            )  # fmt: skip
        echo()
        print_text(scene["approximations"])
    for label in left:
        print_text(
            f"{label}: not assessed; advice covers walls with a linear spring of stiffness K_c"
        )
    return FINISHED


def _case(scene: dict[str, Any], is_oscillator: bool) -> str:
    from gapsweep.quantities import UNITS, written

    words = [f"K_c = {scene['K_c']:g} N/m"] if "K_c" in scene else []
    words += [f"gap {scene['gap']}{' mm' * is_oscillator}"] if "gap" in scene else []
    swept = scene.keys() - {"K_c", "gap", "starts", "approximations", "laws", "j_1", "j_2"}
    others = [
        f"{name} = {scene[name]:g} {written(UNITS.get(name, ''))}".strip() for name in sorted(swept)
    ]
    return ", ".join(words + others)


@click.command()
@options.study
@options.out
@options.timeout
@options.as_json
def bench(study: Path, out: Path | None, timeout: float, as_json: bool) -> int:
    """Measure error, cost and status of methods.

    Every method of the study's [bench] runs on every scenario. Costs are measured in one process.
    Errors are computed in one process per processor, user laws in separate processes.

    \b
    Example:
      gapsweep bench study.toml
    """
    from gapsweep import pipeline
    from gapsweep.report.sections.benchmarks import conclusions
    from gapsweep.run_folder import REPORT
    from gapsweep.store import netcdf

    loaded = options.loaded(study, None)
    made = pipeline.bench(loaded, out, lambda text: echo(text, err=True), timeout=timeout)
    files, found, code = list(made), {}, FINISHED
    for file, counts in made.items():
        if counts:
            _say_failed("motions", counts, f"'status' in {file.name}")
            code = SOME_FAILED
        with netcdf.read(file) as dataset:
            found[file.name] = conclusions(dataset)
    if as_json:
        numbers = {name: lines.numbers for name, lines in found.items()}
        echo(json.dumps({"files": [str(file) for file in files]} | numbers))
        return code
    for file in files:
        for sentence in found[file.name].sentences:
            echo(sentence)
        echo(f"written: {file}")
    shown = files[0].parent / REPORT
    echo(f"report: {shown}" if shown.exists() else "'gapsweep run' writes the report")
    return code
