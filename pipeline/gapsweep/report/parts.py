"""Parts of the report: their contents, and their rendering to texts and pictures.

gapsweep's sections and the ``[report] module`` of a study give the same `Part`. A rendered part has
texts and pictures for JSON: the report shows stored parts without running the code that made them.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from gapsweep.report.figure_data import Choice
from gapsweep.report.pictures import pictures
from gapsweep.report.style import MATPLOTLIB


@dataclass(frozen=True, slots=True)
class Table:
    """A table of texts; every row has as many cells as the header.

    `notes` define the words of its header; sections of one group on a page show each note once,
    below their last table.
    """

    title: str
    header: list[str]
    rows: list[list[str]]
    notes: Sequence[str] = ()

    def __post_init__(self) -> None:
        _check_text("title", self.title)
        _check_texts("notes", self.notes)
        for i, row in enumerate([self.header, *self.rows]):
            where = f"row {i}" if i else "header"
            _check_texts(where, row)
            if len(row) != len(self.header):
                raise ValueError(f"{where}: {len(row)} texts for {len(self.header)} columns")


@dataclass(frozen=True, slots=True)
class Figured:
    """A figure with its caption, its description for screen readers, and its name in claims.

    A claim whose place is the name, such as "Fig. 8b", leads to the figure. `choices` are other
    data that the page of the figure shows on demand.
    """

    figure: Figure
    caption: str
    description: str
    name: str = ""
    choices: Iterable[Choice] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.figure, Figure):
            kind = type(self.figure).__name__
            raise TypeError(f"figure: must be a matplotlib.figure.Figure, not {kind}")
        _check_text("caption", self.caption)
        _check_text("description", self.description)
        _check_text("name", self.name)


@dataclass(frozen=True, slots=True)
class Part:
    """A section of the report, or a part of one.

    Attributes
    ----------
    anchor : str
        Its id in the page: letters a to z, digits and hyphens.
    title : str
    sentences : list of str
    tables : iterable of Table
    figures : iterable of Figured or mapping
        Iterated once: with a generator, one figure at a time is in memory. A mapping is a rendered
        figure, as `pictured` returns it.
    content : mapping
        Values for the template of a section of gapsweep; the sections of a study have none.
    """

    anchor: str
    title: str
    sentences: list[str]
    tables: Iterable[Table] = ()
    figures: Iterable[Figured | Mapping[str, str]] = ()
    content: Mapping[str, Any] = field(default_factory=dict)

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
    """Render parts to texts and SVG in the report's style; empty parts are left out."""
    if not isinstance(parts, Iterable):
        raise TypeError(f"must give sections, as a list or by yield, not {parts!r:.40}")
    with matplotlib.rc_context(MATPLOTLIB):
        made = [_rendered(part) for part in parts]
    anchors = [part["anchor"] for part in made]
    for anchor in anchors:
        if anchors.count(anchor) > 1:
            raise ValueError(f"anchor {anchor!r}: stands for more than one section")
    contents = ("sentences", "tables", "figures", "content")
    return [part for part in made if any(part[name] for name in contents)]


def _rendered(part: Part) -> dict[str, Any]:
    if not isinstance(part, Part):
        raise TypeError(f"a section must be a Part, not {part!r:.40}")
    return {
        "anchor": part.anchor,
        "title": part.title,
        "sentences": list(part.sentences),
        "tables": [asdict(table) for table in part.tables],
        "figures": [
            pictured(each) if isinstance(each, Figured) else dict(each) for each in part.figures
        ],
        "content": dict(part.content),
    }


def pictured(figured: Figured) -> dict[str, str]:
    """A figure as pictures, with its name, caption and description."""
    names = ("name", "caption", "description")
    words = {name: getattr(figured, name) for name in names}
    return {**words, **pictures(figured.figure, figured.choices)}
