"""Sections of the report: what they hold, and how they are rendered once and for all.

A benchmark and a study's own ``[report] module`` give the same `Part`. Rendered, a part is texts
and SVG, fit for JSON: what is stored is shown later without running what made it.
"""

import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import matplotlib
from markupsafe import Markup
from matplotlib.figure import Figure

from gapsweep.report.style import MATPLOTLIB

# What matplotlib draws with. Others run scripts, lead elsewhere or change what is shown.
_DRAWING = {
    "svg", "g", "defs", "style", "path", "use", "clipPath", "rect", "circle", "image", "text",
    "tspan", "metadata", "RDF", "Work", "Agent", "creator", "title", "type", "format", "date",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Table:
    """A table of texts."""

    title: str
    header: list[str]
    rows: list[list[str]]


@dataclass(frozen=True, slots=True)
class Figured:
    """A figure with its caption and what a screen reader says."""

    figure: Figure
    caption: str
    description: str


@dataclass(frozen=True, slots=True)
class Part:
    """One section of the report.

    Attributes
    ----------
    anchor : str
        Its id in the page.
    title : str
    sentences : list of str
    tables : iterable of Table
    figures : iterable of Figured
        Looked at once: a generator holds one figure at a time in memory.
    """

    anchor: str
    title: str
    sentences: list[str]
    tables: Iterable[Table] = ()
    figures: Iterable[Figured] = ()


def rendered(parts: Iterable[Part]) -> list[dict[str, Any]]:
    """Parts as texts and SVG, in the report's style, without those that hold nothing."""
    with matplotlib.rc_context(MATPLOTLIB):
        made = [_rendered(part) for part in parts]
    return [part for part in made if part["sentences"] or part["tables"] or part["figures"]]


def _rendered(part: Part) -> dict[str, Any]:
    return {
        "anchor": part.anchor,
        "title": part.title,
        "sentences": [str(sentence) for sentence in part.sentences],
        "tables": [
            {"title": t.title, "header": list(t.header), "rows": [list(row) for row in t.rows]}
            for t in part.tables
        ],
        "figures": [
            {"svg": svg(each.figure, each.description), "caption": each.caption}
            for each in part.figures
        ],
    }


def for_page(part: Mapping[str, Any]) -> dict[str, Any]:
    """A part that was stored, its drawings as markup if they are nothing but drawings."""
    figures = [
        {**each, "svg": Markup(each["svg"]) if is_drawing(each["svg"]) else each["svg"]}
        for each in part["figures"]
    ]
    return {**part, "figures": figures}


def svg(figure: Figure, description: str) -> Markup:
    """The figure as inline SVG with an accessible description."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", dpi=150, metadata={"Date": None})
    figure.clear()  # its cycles would keep every figure's data until the collector comes by
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    label = Markup('<svg role="img" aria-label="{}"').format(description)
    # matplotlib made this text from numbers and escaped labels.
    return Markup(text.replace("<svg", str(label), 1))


def is_drawing(text: str) -> bool:
    """Whether a text is one SVG of matplotlib's elements, without links and scripts."""
    try:
        elements = list(ElementTree.fromstring(text).iter())
    except ElementTree.ParseError:
        return False
    return all(
        str(element.tag).rpartition("}")[2] in _DRAWING
        and not any(_leads_elsewhere(*item) for item in element.attrib.items())
        for element in elements
    )


def _leads_elsewhere(name: str, value: str) -> bool:
    name = name.rpartition("}")[2]
    is_link = name == "href" and not value.startswith(("#", "data:image/png;"))
    return is_link or name.startswith("on")
