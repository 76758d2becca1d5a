"""The HTML report of a run: ``index.html``, and next to it its figures and long sections."""

import base64
import hashlib
import json
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
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
    LIMITS,
    MOST_CONTACTS,
    SIGNS,
    Contact,
    Judged,
    contacts,
    how_many,
    in_words,
    times,
)
from gapsweep.report.backdrop import caption_of_walls
from gapsweep.report.benchmarks import bench_parts
from gapsweep.report.drawing import caption_of_marks, labels_of
from gapsweep.report.figures import compared_with_exact
from gapsweep.report.findings import findings, outcomes, unreached_walls
from gapsweep.report.heat import GROUPS, MANY, cell, heads, heat, swept_columns
from gapsweep.report.inputs import Inputs
from gapsweep.report.maps import numbered_as
from gapsweep.report.model import model
from gapsweep.report.overview import along_axis, curves_figure, is_wide, maps_of, overview, plane_of
from gapsweep.report.parts import HERO, Figured, Part, for_page, pictured, rendered, shown
from gapsweep.report.provenance import provenance
from gapsweep.report.scales import named, plain
from gapsweep.report.scenes import Scenes, caption_of_starts, starts_of, swept
from gapsweep.report.selection import anchor_of, gap_label, other_parameters
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
from gapsweep.store.artefact import is_recorded, recording, remove, text_of

ANSWER = "own-answer"  # anchor of a user section that replaces the headline of the page
FIGURES = "figures"  # the folder of figures and sections, next to the page
# Names of files in that folder that a report has written.
_OURS = re.compile(r"(figure-[a-z0-9-]*\.(svg|csv)|(figure|section)-[a-z0-9-]*\.html)")
MOST_FIGURES = 8  # on one page; with more figures every section has its own page
_TEMPLATES = Path(__file__).parent / "templates"
_FEW = 5  # frequencies, which a caption names


def write_report(path: Path, inputs: Inputs, made_from: str = "") -> Path:
    """Write the report: the files of its figures, and the page last.

    Parameters
    ----------
    path : Path
        The HTML file.
    inputs : Inputs
    made_from : str
        Value of a meta element, so that the report is rewritten only if it changes.
    """
    responses, claims = inputs.responses, inputs.claims
    own = [part for part in inputs.own_parts if part["anchor"] != ANSWER]
    drawn, top = sections(inputs), head(inputs)
    parts = for_page([*own, *rendered(drawn)], MOST_FIGURES, FIGURES)
    hero = _hero(responses, top["contacts"])
    environment = _environment()
    shared = {
        "parts": [part | {"is_own": i < len(own)} for i, part in enumerate(parts)],
        "measured_on": inputs.timing.attrs["measured_on"],
        "is_compared": inputs.agreement is not None,
        "has_protocols": any(label.protocol for label in labels_of(responses)),
    }
    page = environment.get_template("report.html").render(
        **shared,
        **top,
        made_from=made_from,
        hrefs={part["anchor"]: part["href"] for part in parts},
        hero=hero,
        folder=f"{FIGURES}/",
        claims=claims and {"otherwise": {}, **claims, "rows": _claims(claims, parts)},
        scripts=[_script("figures"), *([_script("claims")] if claims else [])],
    )
    folder, written, home = path.parent / FIGURES, set[str](), f"../{path.name}"
    if hero:
        written |= _write(folder, _files(environment, hero, home))
    for part in shared["parts"]:
        for figure in part["figures"]:
            written |= _write(folder, _files(environment, figure, part["file"] or home))
        if part["file"]:
            section = environment.get_template("section.html").render(
                **shared,
                part=part,
                title=part["title"],
                report=responses.attrs["title"],
                scripts=[_script("figures")],
            )
            written |= _write(folder, {part["file"]: section.encode()})
    with recording(path, _is_ours) as temporary:
        temporary.write_text(page, encoding="utf-8")
    _remove_others(folder, written)
    return path


def sections(inputs: Inputs) -> Iterator[Part]:
    """The sections of a report, except the user sections of the study."""
    yield from bench_parts(inputs.work_precision, inputs.stability)
    yield from [overview(inputs)] if is_wide(inputs.responses) else _scenes(inputs)


def head(inputs: Inputs) -> dict[str, Any]:
    """The texts of a report outside its sections, as its template names them."""
    responses = inputs.responses
    # The rules of the answer are for one displacement between two walls.
    is_judged = in_metres(responses)
    found = (
        contacts(inputs.agreement, inputs.static)
        if inputs.agreement is not None and is_judged
        else []
    )
    listed, answer = found[:MOST_CONTACTS], in_words(found)
    own_answer = [part["sentences"] for part in inputs.own_parts if part["anchor"] == ANSWER]
    own = [sentence for sentences in own_answer for sentence in sentences]
    return {
        "title": responses.attrs["title"],
        "study": responses.attrs["study"],
        "findings": findings(inputs, found),
        "contacts": listed,
        "far": unreached_walls(responses) if is_judged else "",
        "headline": own or answer[:1],
        "answer": answer[0 if own else 1 :],
        "signs": SIGNS,
        "limits": LIMITS,
        "groups": GROUPS,
        "verdicts": VERDICTS,
        "stiffnesses": heads(contact.K_c for contact in listed),
        "gaps": heads((contact.K_c, contact.gap) for contact in listed),
        "swept": swept_columns(listed) if any(contact.swept for contact in listed) else None,
        "is_many": len(listed) > MANY,
        "has_own_starts": any(len({law.n_exact for law in one.laws}) > 1 for one in listed),
        "heat": heat(listed),
        "cut": f"The first {how_many(len(listed), found)}. " if len(found) > len(listed) else "",
        "starts": [starts_of(responses, EXACT, one.at) for one in listed],
        "model": model(responses),
        "provenance": provenance(responses),
        "settings": _indented(responses.attrs["study_json"]),
        "version": json.loads(responses.attrs["versions"]).get("gapsweep", ""),
        "fingerprint": responses.attrs["numerics_fingerprint"],
    }


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
    found.filters.update(**filters, cell=cell, plain=plain, digest=_digest)
    return found


def _files(
    environment: jinja2.Environment, figure: Mapping[str, Any], back: str
) -> dict[str, bytes]:
    """Files of a figure by name; a figure with numbers also has a page that draws them."""
    files = {f"{figure['id']}.{kind}": data for kind, data in figure["files"].items()}
    if figure["data"]:
        page = environment.get_template("figure.html").render(
            title=figure["name"] or figure["description"],
            figure=figure,
            # No text of the data may close the script element.
            data=Markup(figure["data"].replace("<", "\\u003c")),
            back=back,
            scripts=[_script("figure")],
        )
        files[f"{figure['id']}.html"] = page.encode()
    return files


def _script(name: str) -> Markup:
    """A script of the package, without user texts."""
    return Markup((_TEMPLATES / f"{name}.js").read_text(encoding="utf-8"))


def _write(folder: Path, files: Mapping[str, bytes]) -> set[str]:
    """Write files into the report's folder of figures; returns their names.

    Raises
    ------
    StoreError
        If the folder is a symbolic link, or cannot be written.
    """
    if folder.is_symlink():
        raise StoreError(f"{folder}: a symbolic link, which could lead anywhere: remove it")
    for name, data in files.items():
        # gapsweep owns files of such names in this folder, even if SHA256SUMS is lost.
        with recording(folder / name, lambda path: True) as temporary:
            temporary.write_bytes(data)
    return set(files)


def _remove_others(folder: Path, written: Collection[str]) -> None:
    """Remove figures and sections of earlier reports that this report has not written."""
    if folder.is_symlink() or not folder.is_dir():
        return
    files = [path for path in folder.iterdir() if path.is_file() and not path.is_symlink()]
    ours = {path.name for path in files if _OURS.fullmatch(path.name)}
    remove(folder, ours - set(written))


def _hero(responses: xr.Dataset, found: Sequence[Contact]) -> dict[str, Any] | None:
    """First figure of the report, of the case with the most verdicts; None without frequencies."""
    if not found or responses.sizes["omega"] < 2:
        return None
    contact = max(found, key=lambda one: (len(list(filter(None, one.columns.values()))), one.K_c))
    scene = Scenes(responses).at(contact.at)
    laws: dict[str, str] = {
        o.law: f"{o.law}: {o.verdict}{' ±' * (not o.is_firm)}" for o in _telling(contact)
    }
    if scene is None or not laws:
        return None
    description = (
        f"Peak displacement at {contact.place}: contact laws (coloured) and the exact law (larger "
        "dots behind), for the same initial conditions"
    )
    with matplotlib.rc_context(MATPLOTLIB):
        figure = compared_with_exact(swept(scene.sel(representation=[EXACT, *laws])), EXACT, laws)
        looks = f"{caption_of_walls(scene, of_peaks=True)}{caption_of_marks(figure)}"
        made = pictured(Figured(figure, f"{description}.{looks}", description))
    return {**shown(made), "id": HERO}


def _telling(contact: Contact) -> list[Judged]:
    """Approximations for the first figure: one of each verdict, a firm one if any.

    If all have the same verdict, the most and the least accurate.
    """
    columns = ([one for one in laws if one.is_approximation] for laws in contact.columns.values())
    shown = [next((one for one in laws if one.is_firm), laws[0]) for laws in columns if laws]
    if len(shown) > 1:
        return shown
    laws = [one for one in contact.laws if one.is_approximation]
    laws.sort(key=lambda one: np.nan_to_num(one.values["p95"][0], nan=np.inf))
    return laws[:1] + laws[1:][-1:]


def _claims(decided: Mapping[str, Any], parts: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Rows of the claims table, each with a link to the figure or section of its place."""
    names = {f.get("name"): f["href"] for part in parts[::-1] for f in part["figures"][::-1]}
    return [{**row, "leads_to": _place(row["place"], names, parts)} for row in claim_rows(decided)]


def _place(place: str, names: Mapping[str, str], parts: Sequence[Mapping[str, Any]]) -> str:
    """Link to the figure or section that a claim is about, the nearest by name; empty if none.

    "Fig. 11ab" is about "Fig. 11" or "Fig. 11, their solver", "Fig. 2" about the first of "Fig. 2a"
    and "Fig. 2b".
    """
    near = [n for n in names if n and (_begins(place, n.split(",")[0]) or _begins(n, place))]
    titled = [part["href"] for part in parts if part["title"].endswith(f" {place}")]
    return names[min(near, key=lambda n: n != place)] if near else next(iter(titled), "")


def _begins(text: str, start: str) -> bool:
    """Whether a name begins with another one, and no digit follows (not "Fig. 11" for "Fig. 1")."""
    return text.startswith(start) and not text[len(start) : len(start) + 1].isdigit()


def _digest(script: str) -> str:
    """SHA-256 of a script in base64, for the page's content security policy."""
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


def _is_ours(path: Path) -> bool:
    """Whether the file is a report of gapsweep, possibly changed; then it may be replaced."""
    return is_recorded(path) or '<meta name="generator" content="gapsweep">' in text_of(path)[:1000]


def _scenes(inputs: Inputs) -> Iterator[Part]:
    """Sections of the report for each parameter set: outcomes, tables and figures."""
    responses = inputs.responses
    for at, here in _found(Scenes(responses), responses):
        labels = labels_of(here)
        title = _title(here)
        compared = None if inputs.agreement is None else inputs.agreement.isel(at)
        yield Part(
            anchor_of(at),
            title,
            [outcomes(here)],
            [
                *scene_tables(compared, inputs.timing.isel(at), labels),
                *special_points(inputs.branches, here, "omega"),
                *special_points(inputs.curves, here, "omega"),
            ],
            _scene_figures(inputs, _without_protocols(here), at, title),
        )


def _found(scenes: Scenes, responses: xr.Dataset) -> Iterator[tuple[At, xr.Dataset]]:
    """Position and responses of every computed parameter set."""
    for at in all_scenes(responses, scene_dims(responses["status"].dims)):
        here = scenes.at(at)
        if here is not None:
            yield at, here


def _title(scene: xr.Dataset) -> str:
    """Title of a parameter set: its values in words."""
    others = [named(scene[name]) for name in other_parameters(scene)]
    return ", ".join([named(scene["K_c"]), f"gap {gap_label(scene)} mm", *others])


def _scene_figures(inputs: Inputs, scene: xr.Dataset, at: At, title: str) -> Iterator[Figured]:
    if scene.sizes["omega"] == 1 and (plane := plane_of(scene)):
        at_once = scene.isel(omega=0)
        exact = at_once.sel(representation=EXACT) if EXACT in labels_of(scene) else None
        for label in labels_of(scene):
            one, where = at_once.sel(representation=label), f"{title}, {named(scene['omega'][0])}"
            if exact is not None and label != EXACT:
                one = numbered_as(one, exact)
            yield from maps_of([(one, "attractor"), (one, "x_max")], plane, f"{label}, {where}")
        return
    found = _attractors(inputs.attractors, scene, at)
    yield from along_axis(
        scene, found, inputs.branches, "omega", title, has_curve=found is None,
        of_starts=caption_of_starts(scene),
        of_attractors="" if found is None else _where_few(found, scene),
    )  # fmt: skip
    yield from curves_figure(inputs.curves, scene, "omega", title)


def _attractors(attractors: xr.Dataset | None, scene: xr.Dataset, at: At) -> xr.Dataset | None:
    """Attractors of a parameter set at frequencies with several initial conditions, or None."""
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
    """Caption words for up to 5 frequencies with several initial conditions; empty for more."""
    omega = found["omega"].values
    if omega.size > min(_FEW, scene.sizes["omega"] - 1):
        return ""
    return f" (from several initial conditions at {', '.join(map(plain, omega))} Hz only)"


def _without_protocols(scene: xr.Dataset) -> xr.Dataset:
    """The parameter set without protocols such as ``@half``; with them if all laws have one."""
    plain = [i for i, label in enumerate(labels_of(scene)) if not label.protocol]
    return swept(scene.isel(representation=plain)) if plain else scene
