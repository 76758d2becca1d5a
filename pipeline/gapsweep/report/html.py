"""The HTML report: one self-contained file, built from the NetCDF datasets of a run."""

import base64
import hashlib
import json
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import jinja2
import matplotlib
import numpy as np
import xarray as xr
from markupsafe import Markup

from gapsweep.analysis.dimensions import At, in_metres, scene_dims
from gapsweep.analysis.dimensions import scenes as all_scenes
from gapsweep.errors import StoreError
from gapsweep.model.labels import EXACT
from gapsweep.report.answer import (
    MOST_CONTACTS,
    SIGNS,
    Contact,
    Judged,
    contacts,
    how_many,
    in_words,
    times,
)
from gapsweep.report.backdrop import said_of_bands, said_of_missing, said_of_walls
from gapsweep.report.benchmarks import bench_parts
from gapsweep.report.branches import said as said_of_branches
from gapsweep.report.drawing import labels_of, said_of_marks, said_of_peaks
from gapsweep.report.figures import attractors as attractor_panels
from gapsweep.report.figures import beside_exact, bifurcation, by_contact, frequency_response
from gapsweep.report.findings import findings, outcomes, said_of_far_walls
from gapsweep.report.heat import GROUPS, MANY, heads, heat, swept_columns
from gapsweep.report.maps import numbered_as
from gapsweep.report.model import model
from gapsweep.report.overview import is_wide, maps_of, overview, plane_of
from gapsweep.report.parts import Figured, Part, for_page, pictured, rendered
from gapsweep.report.provenance import provenance
from gapsweep.report.scales import named, plain
from gapsweep.report.scenes import Scenes, said_of_starts, starts_of, swept
from gapsweep.report.selection import anchor_of, beside, gap_label
from gapsweep.report.style import MATPLOTLIB, colour
from gapsweep.report.tables import (
    VERDICTS,
    Row,
    claim_rows,
    number,
    percent,
    scene_tables,
    special_points,
)
from gapsweep.status import Status
from gapsweep.store.artefact import is_recorded, recording, remove

ANSWER = "own-answer"  # the study's own part that the page begins with
FIGURES = "figures"  # the folder of their files, beside the page
# What stands there under such a name, reports have written.
_FIGURE = re.compile(r"figure-[a-z0-9-]*\.(svg|csv|html)")
_TEMPLATES = Path(__file__).parent / "templates"
_FEW = 5  # frequencies, which a caption names


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
    branches: xr.Dataset | None = None,
    made_from: str = "",
) -> Path:
    """Write the report: the files of its figures, and the page last.

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
    branches : Dataset, optional
        As stored in the run's folder; drawn behind the attractors.
    made_from : str
        Kept in a meta element, so that the report is made again only if that changes.
    """
    files = (responses, agreement, timing, attractors, branches)
    ours = chain(
        bench_parts(work_precision, stability),
        [overview(*files)] if is_wide(responses) else _scenes(*files),
    )
    headline = [
        line for part in own_parts if part["anchor"] == ANSWER for line in part["sentences"]
    ]
    own_parts = [part for part in own_parts if part["anchor"] != ANSWER]
    parts = for_page([*own_parts, *rendered(ours)], taken=["figure-hero"])
    # Its rules are those of one displacement between two walls.
    is_judged = in_metres(responses)
    found = contacts(agreement, static) if agreement is not None and is_judged else []
    told = found[:MOST_CONTACTS]
    hero = _hero(responses, told)
    figures = [*([hero] if hero else []), *(one for part in parts for one in part["figures"])]
    environment = _environment()
    page = environment.get_template("report.html").render(
        title=responses.attrs["title"],
        made_from=made_from,
        study=responses.attrs["study"],
        findings=findings(
            responses, found, claims, advice, attractors=attractors, agreement=agreement
        ),
        contacts=told,
        far=said_of_far_walls(responses) if is_judged else "",
        headline=headline or in_words(found)[:1],
        answer=in_words(found)[0 if headline else 1 :],
        signs=SIGNS,
        groups=GROUPS,
        stiffnesses=heads(contact.K_c for contact in told),
        gaps=heads((contact.K_c, contact.gap) for contact in told),
        beside=swept_columns(told) if any(contact.swept for contact in told) else None,
        is_many=len(told) > MANY,
        has_own_starts=any(len({law.n_exact for law in one.laws}) > 1 for one in told),
        heat=heat(told),
        cut=f"The first {how_many(len(told), found)}. " if len(found) > len(told) else "",
        starts=[starts_of(responses, EXACT, one.at) for one in told],
        anchors={part["anchor"] for part in parts},
        own=[part["anchor"] for part in own_parts],
        hero=hero,
        folder=FIGURES,
        claims=claims and {"counts": claims["counts"], "rows": _claims(claims, parts)},
        verdicts=VERDICTS,
        scripts=[_script("figures"), *([_script("claims")] if claims else [])],
        parts=parts,
        measured_on=timing.attrs["measured_on"],
        is_compared=agreement is not None,
        has_protocols=any("@" in label for label in labels_of(responses)),
        model=model(responses),
        provenance=provenance(responses),
        settings=_indented(responses.attrs["study_json"]),
        version=json.loads(responses.attrs["versions"]).get("gapsweep", ""),
        fingerprint=responses.attrs["numerics_fingerprint"],
    )
    folder, written = path.parent / FIGURES, set[str]()
    for figure in figures:
        written |= _write_files(folder, figure, _page(environment, figure))
    with recording(path, _is_ours) as temporary:
        temporary.write_text(page, encoding="utf-8")
    _remove_others(folder, written)
    return path


def _indented(document: str) -> str:
    return json.dumps(json.loads(document), indent=2, ensure_ascii=False)


def _environment() -> jinja2.Environment:
    found = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    filters = {"number": number, "percent": percent, "times": times, "colour": colour}
    found.filters.update(**filters, plain=plain, digest=_digest)
    return found


def _page(environment: jinja2.Environment, figure: Mapping[str, Any]) -> str:
    """A page on which a figure is drawn from its data; empty if these are images."""
    if not figure["data"]:
        return ""
    data = Markup(figure["data"].replace("<", "\\u003c"))  # so that no text in it ends the element
    return environment.get_template("figure.html").render(
        title=figure["name"] or figure["description"],
        figure=figure,
        data=data,
        scripts=[_script("figure")],
    )


def _script(name: str) -> Markup:
    """A file of our own, without anything of the user's."""
    return Markup((_TEMPLATES / f"{name}.js").read_text(encoding="utf-8"))


def _write_files(folder: Path, figure: Mapping[str, Any], page: str) -> set[str]:
    """A figure as files beside the report; returns their names."""
    if folder.is_symlink():
        raise StoreError(f"{folder}: a symbolic link, which could lead anywhere: remove it")
    pages = {"html": page.encode()} if page else {}
    files = {f"{figure['id']}.{kind}": data for kind, data in (figure["files"] | pages).items()}
    for name, data in files.items():
        # In this folder all of such a name are ours, also where SHA256SUMS is lost.
        with recording(folder / name, lambda path: True) as temporary:
            temporary.write_bytes(data)
    return set(files)


def _remove_others(folder: Path, written: Collection[str]) -> None:
    """Remove figures that a report before this one had."""
    if folder.is_symlink() or not folder.is_dir():
        return
    files = [path for path in folder.iterdir() if path.is_file() and not path.is_symlink()]
    ours = {path.name for path in files if _FIGURE.fullmatch(path.name)}
    remove(folder, ours - set(written))


def _hero(responses: xr.Dataset, found: Sequence[Contact]) -> dict[str, Any] | None:
    """What the verdicts look like, where they differ most; None without frequencies."""
    if not found or responses.sizes["omega"] < 2:
        return None
    contact = max(found, key=lambda one: (len(list(filter(None, one.columns.values()))), one.K_c))
    scene = Scenes(responses).at(contact.at)
    laws = {o.law: f"{o.law}: {o.verdict}{' ±' * (not o.is_firm)}" for o in _telling(contact)}
    if scene is None or not laws:
        return None
    said = f"Peaks at {contact.place}, laws on the exact one's larger dots, from the same starts"
    with matplotlib.rc_context(MATPLOTLIB):
        figure = beside_exact(swept(scene.sel(representation=[EXACT, *laws])), EXACT, laws)
        looks = f"{said_of_walls(scene, of_peaks=True)}{said_of_marks(figure)}"
        made = pictured(Figured(figure, f"{said}.{looks}", said))
    (part,) = for_page([{"anchor": "hero", "figures": [made]}])
    return dict(part["figures"][0])


def _telling(contact: Contact) -> list[Judged]:
    """Of each verdict the cheapest approximation, firm if any is; best and worst if all alike."""
    columns = ([one for one in laws if one.is_approximation] for laws in contact.columns.values())
    shown = [next((one for one in laws if one.is_firm), laws[0]) for laws in columns if laws]
    if len(shown) > 1:
        return shown
    told = [one for one in contact.laws if one.is_approximation]
    told.sort(key=lambda one: np.nan_to_num(one.values["p95"][0], nan=np.inf))
    return told[:1] + told[1:][-1:]


def _claims(decided: Mapping[str, Any], parts: Sequence[Mapping[str, Any]]) -> list[Row]:
    """The claims, each with what of the page its place names."""
    names = {f.get("name"): f["id"] for part in parts for f in reversed(part["figures"])}
    return [{**row, "leads_to": _place(row["place"], names, parts)} for row in claim_rows(decided)]


def _place(place: str, names: Mapping[str, str], parts: Sequence[Mapping[str, Any]]) -> str:
    """The id of the figure or section that a claim is about, the nearest by name; empty if none.

    "Fig. 11ab" is about "Fig. 11" or "Fig. 11, their solver", "Fig. 2" about the first of "Fig. 2a"
    and "Fig. 2b".
    """
    near = [n for n in names if n and (_begins(place, n.split(",")[0]) or _begins(n, place))]
    titled = [part["anchor"] for part in parts if part["title"].endswith(f" {place}")]
    return names[min(near, key=lambda n: n != place)] if near else next(iter(titled), "")


def _begins(text: str, start: str) -> bool:
    """Whether a name begins with another one, of the same number."""
    return text.startswith(start) and not text[len(start) : len(start) + 1].isdigit()


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
    branches: xr.Dataset | None,
) -> Iterator[Part]:
    """Everything about one scene after the other; what would be columns of dots, in one figure."""
    scenes = Scenes(responses)
    columns = list(_columns(scenes, responses)) if responses.sizes["omega"] == 1 else []
    is_joint = len(columns) > 1
    if is_joint:
        yield _at_one_frequency(scenes, columns, f"{responses['omega'].item():g} Hz")
    for at, here in _found(scenes, responses):
        labels = labels_of(here)
        title = _title(here)
        compared = None if agreement is None else agreement.isel(at)
        yield Part(
            anchor_of(at),
            title,
            [outcomes(here)],
            [
                *scene_tables(compared, timing.isel(at), labels),
                *special_points(branches, here, "omega"),
            ],
            ()
            if is_joint and at in columns
            else _scene_figures(_without_protocols(here), attractors, branches, at, title),
        )


def _found(scenes: Scenes, responses: xr.Dataset) -> Iterator[tuple[At, xr.Dataset]]:
    """Every scene that was swept, and where it is."""
    for at in all_scenes(responses, scene_dims(responses["status"].dims)):
        here = scenes.at(at)
        if here is not None:
            yield at, here


def _title(scene: xr.Dataset) -> str:
    return ", ".join(_said(scene))


def _said(scene: xr.Dataset) -> list[str]:
    """What a scene has one value of."""
    others = [named(scene[name]) for name in beside(scene)]
    return [named(scene["K_c"]), f"gap {gap_label(scene)} mm", *others]


def _columns(scenes: Scenes, responses: xr.Dataset) -> Iterator[At]:
    """Scenes of one frequency whose starts form no plane to be drawn."""
    return (at for at, here in _found(scenes, responses) if not plane_of(here))


def _at_one_frequency(scenes: Scenes, columns: Sequence[At], omega: str) -> Part:
    """One figure in place of one of a single column of dots for each scene."""
    said, peaks = [], []
    for at in columns:  # one after the other in memory
        scene = scenes.at(at)
        assert scene is not None, "a column is of a scene that was swept"
        said.append(_said(scene))
        names = ["x_max", "response_class"]
        peaks.append(_without_protocols(scene)[names].isel(omega=0).load())
    differs = [len(set(column)) > 1 for column in zip(*said, strict=True)]
    names = [", ".join(word for word, d in zip(each, differs, strict=True) if d) for each in said]
    told = [  # of what differs by less than is printed, the first, the second, ...
        f"{name} ({names[: i + 1].count(name)})" if names.count(name) > 1 else name
        for i, name in enumerate(names)
    ]
    caption = "Peak displacement of the steady response from every start."
    figure = Figured(by_contact(dict(zip(told, peaks, strict=True))), caption, f"Peaks at {omega}")
    return Part("contacts", f"All contacts at {omega}", [], (), [figure])


def _scene_figures(
    scene: xr.Dataset,
    attractors: xr.Dataset | None,
    branches: xr.Dataset | None,
    at: At,
    title: str,
) -> Iterator[Figured]:
    if scene.sizes["omega"] == 1 and (plane := plane_of(scene)):
        at_once = scene.isel(omega=0)
        exact = at_once.sel(representation=EXACT) if EXACT in labels_of(scene) else None
        for label in labels_of(scene):
            one, where = at_once.sel(representation=label), f"{title}, {named(scene['omega'][0])}"
            if exact is not None and label != EXACT:
                one = numbered_as(one, exact)
            yield from maps_of([(one, "attractor"), (one, "x_max")], plane, f"{label}, {where}")
        return
    found = _attractors(attractors, scene, at)
    if found is None:  # curves of many starts would cross between attractors
        caption = "Amplitude (half the range) of the steady response; broken where it jumps."
        yield Figured(frequency_response(scene), caption, f"Frequency response, {title}")
    yield Figured(
        bifurcation(scene, continued=branches),
        f"All steady zero-velocity displacements{said_of_starts(scene)}."
        f"{said_of_bands(scene)}{said_of_missing(scene)}{said_of_walls(scene)}"
        f"{said_of_branches(branches, scene, 'omega')}",
        f"Bifurcation diagram, {title}",
    )
    if found is not None:
        yield Figured(
            attractor_panels(found, continued=branches),
            f"Peak displacement of every attractor that the starts reach{_where_few(found, scene)}."
            f"{said_of_peaks(found)}{said_of_walls(scene, of_peaks=True)}"
            f"{said_of_branches(branches, scene, 'omega')}",
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


def _where_few(found: xr.Dataset, scene: xr.Dataset) -> str:
    """At which few of its frequencies a scene was swept from several starts, in words."""
    omega = found["omega"].values
    if omega.size > min(_FEW, scene.sizes["omega"] - 1):
        return ""
    return f", swept from several at {', '.join(map(plain, omega))} Hz only"


def _without_protocols(scene: xr.Dataset) -> xr.Dataset:
    """The representations as they are; those of other solver settings if there is nothing else."""
    plain = [i for i, label in enumerate(scene["representation"].values) if "@" not in str(label)]
    return swept(scene.isel(representation=plain)) if plain else scene
