"""The HTML report: one self-contained file, built from the NetCDF datasets of a run."""

import base64
import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import jinja2
import xarray as xr
from markupsafe import Markup

from gapsweep.analysis.grid import At, scene_dims
from gapsweep.analysis.grid import scenes as all_scenes
from gapsweep.report.answer import MOST_CONTACTS, SIGNS, contacts, in_words, times
from gapsweep.report.bench import bench_parts
from gapsweep.report.drawing import labels_of, named
from gapsweep.report.figures import attractors as attractor_panels
from gapsweep.report.figures import bifurcation, frequency_response
from gapsweep.report.findings import findings, outcomes
from gapsweep.report.overview import is_wide, overview
from gapsweep.report.parts import Figured, Part, for_page, rendered
from gapsweep.report.scenes import Scenes, swept
from gapsweep.report.selection import anchor_of, beside, gap_label
from gapsweep.report.style import colour
from gapsweep.report.tables import VERDICTS, claim_rows, number, percent, scene_tables
from gapsweep.status import Status
from gapsweep.store.artefact import is_recorded, recording

_TEMPLATES = Path(__file__).parent / "templates"


def write_report(
    path: Path,
    responses: xr.Dataset,
    agreement: xr.Dataset | None,
    timing: xr.Dataset,
    *,
    attractors: xr.Dataset | None = None,
    advice: xr.Dataset | None = None,
    static: xr.Dataset | None = None,
    claims: Mapping[str, Any] | None = None,
    own_parts: Sequence[Mapping[str, Any]] = (),
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
    attractors : Dataset, optional
        As stored in the run's folder; drawn where there are several starts.
    advice : Dataset, optional
        As stored in the run's folder, where ``auto`` is a representation.
    static : Dataset, optional
        As stored in the run's folder; says from where tanh has no false well.
    claims : mapping, optional
        What stands in ``claims.json``.
    own_parts : sequence of mapping
        The sections that stand in ``sections.json``.
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
    script = (_TEMPLATES / "claims.js").read_text(encoding="utf-8")
    files = (responses, agreement, timing, attractors)
    ours = chain(
        bench_parts(work_precision, stability),
        [overview(*files)] if is_wide(responses) else _scenes(*files),
    )
    parts = [*own_parts, *rendered(ours)]
    environment.filters.update(number=number, percent=percent, times=times, colour=colour)
    found = [] if agreement is None else contacts(agreement, static)
    page = environment.get_template("report.html").render(
        title=responses.attrs["title"],
        made_from=made_from,
        study=responses.attrs["study"],
        findings=findings(responses, found, claims, advice),
        contacts=found[:MOST_CONTACTS],
        answer=in_words(found),
        signs=SIGNS,
        claims=claims and {"counts": claims["counts"], "rows": list(claim_rows(claims))},
        verdicts=VERDICTS,
        script=Markup(script),  # our own file, without anything of the user's
        script_digest=_digest(script),
        parts=[for_page(part) for part in parts],
        measured_on=timing.attrs["measured_on"],
        provenance=_provenance(responses),
        version=json.loads(responses.attrs["versions"]).get("gapsweep", ""),
        fingerprint=responses.attrs["numerics_fingerprint"],
    )
    with recording(path, _is_ours) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return path


def _digest(script: str) -> str:
    """SHA-256 by which the page allows its own script, and no other."""
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


def _is_ours(path: Path) -> bool:
    """Whether the file there is a report, sound or changed, which may be replaced."""
    return (
        is_recorded(path)
        or '<meta name="generator" content="gapsweep">' in path.read_text(errors="replace")[:1000]
    )


def _scenes(
    responses: xr.Dataset,
    agreement: xr.Dataset | None,
    timing: xr.Dataset,
    attractors: xr.Dataset | None,
) -> Iterator[Part]:
    """Everything about one scene after the other."""
    scenes = Scenes(responses)
    for at in all_scenes(responses, scene_dims(responses["status"].dims)):
        here = scenes.at(at)
        if here is None:
            continue
        labels = labels_of(here)
        others = "".join(f", {named(here[name])}" for name in beside(here))
        title = f"{named(here['K_c'])}, gap {gap_label(here)} mm{others}"
        compared = None if agreement is None else agreement.isel(at)
        yield Part(
            anchor_of(at),
            title,
            [outcomes(here)],
            scene_tables(compared, timing.isel(at), labels),
            _scene_figures(_without_protocols(here), attractors, at, title),
        )


def _scene_figures(
    scene: xr.Dataset, attractors: xr.Dataset | None, at: At, title: str
) -> Iterator[Figured]:
    found = _attractors(attractors, scene, at)
    if found is None:  # curves of many starts would cross between attractors
        caption = "Amplitude (half the range) of the steady response."
        yield Figured(frequency_response(scene), caption, f"Frequency response, {title}")
    yield Figured(
        bifurcation(scene),
        "All steady zero-velocity displacements. Red: chaotic or unresolved. Dashed: walls.",
        f"Bifurcation diagram, {title}",
    )
    if found is not None:
        yield Figured(
            attractor_panels(found),
            "Peak displacement of every attractor that the starts reach. The area of a dot is the "
            "share of the starts that end on it; hollow: not periodic.",
            f"Attractors and their basins, {title}",
        )


def _attractors(attractors: xr.Dataset | None, scene: xr.Dataset, at: At) -> xr.Dataset | None:
    """Attractors of a scene, at the frequencies that have several starts; None if none has."""
    several = (scene["status"] != Status.NOT_REQUESTED).sum("initial_condition") > 1
    if attractors is None or not several.any():
        return None
    names = ["x_max", "basin_share", "response_class"]
    found = attractors[names].isel(at).load()
    here = several.any("omega")
    return found.sel(
        representation=scene["representation"].values[here.values],
        omega=scene["omega"].values[several.any("representation").values],
    )


def _without_protocols(scene: xr.Dataset) -> xr.Dataset:
    """The representations as they are; those of other solver settings if there is nothing else."""
    plain = [i for i, label in enumerate(scene["representation"].values) if "@" not in str(label)]
    return swept(scene.isel(representation=plain)) if plain else scene


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
