"""The HTML report of a run: ``index.html``, and next to it its figures and long sections."""

import base64
import hashlib
import re
from collections.abc import Collection, Mapping
from itertools import groupby
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from gapsweep.errors import ModelError, StoreError
from gapsweep.model.labels import EXACT, Representation
from gapsweep.report.contents import SECTIONS
from gapsweep.report.inputs import Inputs
from gapsweep.report.links import Links, for_page
from gapsweep.report.parts import rendered
from gapsweep.report.style import colour
from gapsweep.store.artefact import is_recorded, recording, remove, text_of

FIGURES = "figures"  # the folder of figures and sections, next to the page
# Names of files in that folder that a report has written.
_OURS = re.compile(r"(figure-[a-z0-9-]*\.(svg|csv)|(figure|section)-[a-z0-9-]*\.html)")
MOST_FIGURES = 8  # of groups on one page; with more figures every section has its own page
_TEMPLATES = Path(__file__).parent / "templates"


def write_report(path: Path, inputs: Inputs, made_from: str = "") -> Path:
    """Write the report: the files of its figures, and the page last.

    `path`: the HTML file.
    `made_from`: value of a meta element, so that the report is rewritten only if it changes.
    """
    parts = for_page(_parts(inputs), MOST_FIGURES, FIGURES)
    scripts = dict.fromkeys(["figures", *(part["script"] for part in parts if part["script"])])
    environment = _environment()
    environment.globals.update(
        links=Links(parts),
        report=inputs.responses.attrs["title"],
        # Neighbours of the same group together; a part without a group has no neighbour.
        groups=[list(g) for _, g in groupby(parts, lambda part: part["group"] or part["anchor"])],
    )
    page = environment.get_template("report.html").render(
        made_from=made_from, folder=f"{FIGURES}/", scripts=list(map(_script, scripts))
    )
    folder, written = path.parent / FIGURES, set[str]()
    for part in parts:
        for figure in part["figures"]:
            back = part["file"] or f"../{path.name}"
            written |= _write(folder, _files(environment, figure, back))
        if part["file"]:
            section = environment.get_template("section.html")
            text = section.render(part=part, folder="", scripts=[_script("figures")])
            written |= _write(folder, {part["file"]: text.encode()})
    with recording(path, _is_ours) as temporary:
        temporary.write_text(page, encoding="utf-8")
    _remove_others(folder, written)
    return path


def _parts(inputs: Inputs) -> list[dict[str, Any]]:
    """The rendered parts of all sections, each with its group, template and script."""
    return [
        part | {"group": each.group, "template": each.template, "script": each.script}
        for each in SECTIONS
        for part in rendered(each.parts(inputs))
    ]


def _environment() -> jinja2.Environment:
    found = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.filters.update(swatch=_swatch, digest=_digest)
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
            # No text of the data may close a script element.
            data=Markup(figure["data"].replace("<", "\\u003c")),
            choices=Markup(figure["choices"].replace("<", "\\u003c")),
            back=back,
            scripts=[_script("figure")],
        )
        files[f"{figure['id']}.html"] = page.encode()
    return files


def _script(name: str) -> Markup:
    # Without texts of users.
    return Markup((_TEMPLATES / f"{name}.js").read_text(encoding="utf-8"))


def _write(folder: Path, files: Mapping[str, bytes]) -> set[str]:
    """Write files into the report's folder of figures; returns their names.

    Raises `StoreError` if the folder is a symbolic link, or cannot be written.
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


def _swatch(text: str) -> str:
    """Colour of the law that a text begins with, as ``tanh-1e4, K_ratio = 0.5``."""
    law = text.partition(", ")[0]
    try:
        return colour(Representation.parsed(EXACT if law == "exact law" else law))
    except ModelError:  # a table of a study may have any text
        return "none"


def _digest(script: str) -> str:
    """SHA-256 of a script in base64, for the page's content security policy."""
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


def _is_ours(path: Path) -> bool:
    """Whether the file is a report of gapsweep, possibly changed; then it may be replaced."""
    return is_recorded(path) or '<meta name="generator" content="gapsweep">' in text_of(path)[:1000]
