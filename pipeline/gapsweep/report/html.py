"""The HTML report: one self-contained file, built from the NetCDF datasets of a run."""

import io
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
import matplotlib
import numpy as np
import xarray as xr
from markupsafe import Markup
from matplotlib.figure import Figure

from gapsweep.report.bench import Part, bench_parts
from gapsweep.report.figures import bifurcation, frequency_response
from gapsweep.report.paper import Drawn, paper_figures, swept
from gapsweep.report.style import MATPLOTLIB, colour
from gapsweep.response.result import ResponseClass
from gapsweep.status import Status
from gapsweep.store.artefact import replacing

_TEMPLATES = Path(__file__).parent / "templates"


@dataclass(frozen=True, slots=True)
class Section:
    """Everything about one contact stiffness and gap."""

    title: str
    anchor: str
    summary: list[str]
    frequency_response: Markup
    bifurcation: Markup
    agreement: list[dict[str, Any]]
    timing: list[dict[str, Any]]


def write_report(
    path: Path,
    responses: xr.Dataset,
    agreement: xr.Dataset | None,
    timing: xr.Dataset,
    *,
    histories: xr.Dataset | None = None,
    static: xr.Dataset | None = None,
    work_precision: xr.Dataset | None = None,
    stability: xr.Dataset | None = None,
    made_from: str = "",
) -> Path:
    """Write the report; complete or not at all.

    Parameters
    ----------
    path : Path
        The HTML file.
    responses, agreement, timing : Dataset
        As stored in the run's folder; `agreement` is None if the exact law was not swept.
    histories, static : Dataset, optional
        As stored in the run's folder, for the paper's figures.
    work_precision, stability : Dataset, optional
        As stored in the run's folder, for the sections of the benchmark.
    made_from : str
        Kept in a meta element, so that the report is made again only if that changes.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    with matplotlib.rc_context(MATPLOTLIB):
        sections = list(_sections(responses, agreement, timing))
        paper = list(_paper(paper_figures(responses, histories, static)))
        bench = list(_bench(bench_parts(work_precision, stability)))
    page = environment.get_template("report.html").render(
        title=responses.attrs["title"],
        made_from=made_from,
        study=responses.attrs["study"],
        sections=sections,
        paper=paper,
        bench=bench,
        statuses=_status_counts(responses),
        measured_on=timing.attrs["measured_on"],
        provenance=_provenance(responses),
    )
    with replacing(path, _is_ours) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return path


def _is_ours(path: Path) -> bool:
    """Whether the file there is a report, which may be replaced."""
    return '<meta name="generator" content="gapsweep">' in path.read_text(errors="replace")[:1000]


def _sections(
    responses: xr.Dataset, agreement: xr.Dataset | None, timing: xr.Dataset
) -> Iterator[Section]:
    for k in range(responses.sizes["K_c"]):
        for g in range(responses.sizes["gap"]):
            at = {"K_c": k, "gap": g}
            here = swept(responses.isel(at)).load()
            if not here.sizes["representation"]:
                continue
            title = f"K_c = {_number(float(here['K_c']))} N/m, gap {here['gap'].item()} mm"
            compared = None if agreement is None else agreement.isel(at).load()
            rows = [] if compared is None else list(_agreement_rows(here, compared))
            yield Section(
                title=title,
                anchor=f"scene-{k}-{g}",
                summary=_summary(here, rows),
                frequency_response=_svg(frequency_response(here), f"Frequency response, {title}"),
                bifurcation=_svg(bifurcation(here), f"Bifurcation diagram, {title}"),
                agreement=rows,
                timing=list(_timing_rows(here, timing.isel(at).load())),
            )


def _paper(figures: Iterable[Drawn]) -> Iterator[dict[str, Any]]:
    for drawn in figures:
        yield {
            "number": drawn.number,
            "title": drawn.title,
            "caption": drawn.caption,
            "svg": _svg(drawn.figure, drawn.description),
        }


def _bench(parts: Iterable[Part]) -> Iterator[dict[str, Any]]:
    for part in parts:
        figures = [
            {"svg": _svg(each.figure, each.description), "caption": each.caption}
            for each in part.figures
        ]
        yield {
            "anchor": part.anchor,
            "title": part.title,
            "sentences": part.sentences,
            "tables": part.tables,
            "figures": figures,
        }


def _agreement_rows(responses: xr.Dataset, agreement: xr.Dataset) -> Iterator[dict[str, Any]]:
    for label in responses["representation"].values:
        if label == agreement.attrs["reference"]:
            continue
        row = agreement.sel(representation=label, regime="all")
        yield {
            "representation": str(label),
            "colour": colour(str(label)),
            "amplitude_median": _percent(row["amplitude_error_median"].item()),
            "amplitude_p95": _percent(row["amplitude_error_p95"].item()),
            "amplitude_median_value": row["amplitude_error_median"].item(),
            "distance_median": _number(1e3 * row["extrema_distance_median"].item()),
            "distance_p95": _number(1e3 * row["extrema_distance_p95"].item()),
            "same_class": _percent(row["class_agreement_mean"].item()),
            "n_compared": row["n_compared"].item(),
            "n_points": row["n_points"].item(),
        }


def _timing_rows(responses: xr.Dataset, timing: xr.Dataset) -> Iterator[dict[str, Any]]:
    for label in responses["representation"].values:
        row = timing.sel(representation=label)
        yield {
            "representation": str(label),
            "colour": colour(str(label)),
            "cpu": _number(1e3 * row["cpu_time_median"].item()),
            **{n: _number(row[f"{n}_median"].item()) for n in _COUNTS},
            "n_points": row["n_points"].item(),
            "n_elsewhere": row["n_points_elsewhere"].item(),
        }


_COUNTS = ("nfev", "n_steps", "n_rejected", "n_contacts")


def _summary(responses: xr.Dataset, rows: list[dict[str, Any]]) -> list[str]:
    """What the numbers say, in sentences."""
    sentences = []
    ranked = sorted(
        (row for row in rows if np.isfinite(row["amplitude_median_value"])),
        key=lambda row: row["amplitude_median_value"],
    )
    if ranked:
        best, worst = ranked[0], ranked[-1]
        sentences.append(
            f"Closest to the exact law in amplitude is {best['representation']} (median error "
            f"{best['amplitude_median']}); farthest is {worst['representation']} "
            f"({worst['amplitude_median']})."
        )
    status = responses["status"].values
    asked = status[status != Status.NOT_REQUESTED]
    unresolved, failed = (asked == Status.UNRESOLVED).sum(), (asked > Status.OUT_OF_FIT_RANGE).sum()
    chaotic = (responses["response_class"].values == ResponseClass.CHAOTIC).sum()
    sentences.append(
        f"Of {asked.size} sweep points {chaotic} are chaotic, {unresolved} unresolved, "
        f"{failed} failed; all others are periodic."
    )
    return sentences


def _status_counts(responses: xr.Dataset) -> list[tuple[str, int]]:
    status = responses["status"].values
    counts = [(s.label.replace("_", " "), int((status == s).sum())) for s in Status]
    return [(label, n) for label, n in counts if n and label != "not requested"]


def _provenance(responses: xr.Dataset) -> list[tuple[str, str]]:
    attributes = responses.attrs
    versions = json.loads(attributes["versions"])
    return [
        ("Study", attributes["study"]),
        ("Created", attributes["created"]),
        ("Numerics fingerprint", attributes["numerics_fingerprint"]),
        ("Machine", f"{attributes['host']} ({attributes['machine']})"),
        ("Versions", ", ".join(f"{name} {number}" for name, number in versions.items())),
    ]


def _svg(figure: Figure, description: str) -> Markup:
    """The figure as inline SVG with an accessible description."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", dpi=150, metadata={"Date": None})
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    label = Markup('<svg role="img" aria-label="{}"').format(description)
    # matplotlib made this text from numbers and escaped labels.
    return Markup(svg.replace("<svg", str(label), 1))


def _number(value: float) -> str:
    """Three significant digits, exponents only where they help."""
    if not np.isfinite(value):
        return "–"
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{float(mantissa):g}e{int(exponent)}"


def _percent(value: float) -> str:
    return f"{100.0 * value:.3g} %" if np.isfinite(value) else "–"
