"""Sections of the report: what they hold, and how they are rendered once and for all.

A benchmark and a study's own ``[report] module`` give the same `Part`. Rendered, a part is texts
and SVG, fit for JSON: what is stored is shown later without running what made it.
"""

import io
import re
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
    """A table of texts; every row has as many as the header."""

    title: str
    header: list[str]
    rows: list[list[str]]

    def __post_init__(self) -> None:
        _check_text("title", self.title)
        for i, row in enumerate([self.header, *self.rows]):
            where = f"row {i}" if i else "header"
            _check_texts(where, row)
            if len(row) != len(self.header):
                raise ValueError(f"{where}: {len(row)} texts for {len(self.header)} columns")


@dataclass(frozen=True, slots=True)
class Figured:
    """A figure with its caption and what a screen reader says."""

    figure: Figure
    caption: str
    description: str

    def __post_init__(self) -> None:
        if not isinstance(self.figure, Figure):
            kind = type(self.figure).__name__
            raise TypeError(f"figure: must be a matplotlib.figure.Figure, not {kind}")
        _check_text("caption", self.caption)
        _check_text("description", self.description)


@dataclass(frozen=True, slots=True)
class Part:
    """One section of the report.

    Attributes
    ----------
    anchor : str
        Its id in the page: letters a to z, digits and hyphens.
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

    def __post_init__(self) -> None:
        if not isinstance(self.anchor, str) or not re.fullmatch("[a-z][a-z0-9-]*", self.anchor):
            raise ValueError(f"anchor: must be of a to z, 0 to 9 and -, not {self.anchor!r:.40}")
        _check_text("title", self.title)
        _check_texts("sentences", self.sentences)


def _check_text(name: str, text: Any) -> None:
    if not isinstance(text, str):
        raise TypeError(f"{name}: must be text, not {text!r:.40}")


def _check_texts(name: str, texts: Any) -> None:
    if not isinstance(texts, list | tuple):
        raise TypeError(f"{name}: must be a list of texts, not {texts!r:.40}")
    for text in texts:
        _check_text(f"one of {name}", text)


def rendered(parts: Iterable[Part]) -> list[dict[str, Any]]:
    """Parts as texts and SVG, in the report's style, without those that hold nothing."""
    if not isinstance(parts, Iterable):
        raise TypeError(f"must give sections, as a list or by yield, not {parts!r:.40}")
    with matplotlib.rc_context(MATPLOTLIB):
        made = [_rendered(part) for part in parts]
    anchors = [part["anchor"] for part in made]
    for anchor in anchors:
        if anchors.count(anchor) > 1:
            raise ValueError(f"anchor {anchor!r}: stands for more than one section")
    return [part for part in made if part["sentences"] or part["tables"] or part["figures"]]


def _rendered(part: Part) -> dict[str, Any]:
    if not isinstance(part, Part):
        raise TypeError(f"a section must be a Part, not {part!r:.40}")
    return {
        "anchor": part.anchor,
        "title": part.title,
        "sentences": list(part.sentences),
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
