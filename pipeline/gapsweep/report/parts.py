"""Sections of the report: their contents, and their rendering to texts and pictures.

Benchmarks and the ``[report] module`` of a study give the same `Part`. A rendered part has texts
and pictures for JSON: the report shows stored parts without running the code that made them.
"""

import re
import sys
import zlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from itertools import chain, count
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from gapsweep.report.pictures import PACKED, is_picture, pictures, size, unpacked
from gapsweep.report.style import MATPLOTLIB

_LONGEST = 64  # characters of an id
HERO = "figure-hero"  # id of the first figure of the report


@dataclass(frozen=True, slots=True)
class Table:
    """A table of texts; every row has as many cells as the header."""

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
    """A figure with its caption, its description for screen readers, and its name in claims.

    A claim whose place is the name, such as "Fig. 8b", leads to the figure.
    """

    figure: Figure
    caption: str
    description: str
    name: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.figure, Figure):
            kind = type(self.figure).__name__
            raise TypeError(f"figure: must be a matplotlib.figure.Figure, not {kind}")
        _check_text("caption", self.caption)
        _check_text("description", self.description)
        _check_text("name", self.name)


@dataclass(frozen=True, slots=True)
class Part:
    """A section of the report.

    Attributes
    ----------
    anchor : str
        Its id in the page: letters a to z, digits and hyphens.
    title : str
    sentences : list of str
    tables : iterable of Table
    figures : iterable of Figured
        Iterated once: with a generator, one figure at a time is in memory.
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
    """Render parts to texts and SVG in the report's style; empty parts are left out."""
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
        "tables": [asdict(table) for table in part.tables],
        "figures": [pictured(each) for each in part.figures],
    }


def pictured(figured: Figured) -> dict[str, str]:
    """A figure as pictures, with its name, caption and description."""
    names = ("name", "caption", "description")
    words = {name: getattr(figured, name) for name in names}
    return {**words, **pictures(figured.figure)}


def for_page(
    parts: Iterable[Mapping[str, Any]], most: int = sys.maxsize, folder: str = ""
) -> list[dict[str, Any]]:
    """Stored parts with ids, links and addresses of pictures.

    Parameters
    ----------
    parts : iterable of mapping
    most : int
        Figures on one page; with more, every part has its own page in the folder.
    folder : str

    Returns
    -------
    list of dict
        Every part also has the name of its page as ``file`` (empty: the report's page) and a link
        to it from the report as ``href``; every figure has an ``id`` and a ``href``.
    """
    made: list[dict[str, Any]] = []
    used = {HERO}
    for part in parts:
        figures = [shown(each) for each in part["figures"] if _is_sound(each)]
        for figure in figures:
            name = (figure.get("name") or part["anchor"]).removeprefix("Fig. ")
            figure["id"] = _unused("figure", name, used)
        made.append({**part, "figures": figures})
    is_long = sum(len(part["figures"]) for part in made) > most
    for part in made:
        part["file"] = f"{_unused('section', part['anchor'], used)}.html" if is_long else ""
        page = f"{folder}/{part['file']}" if is_long else ""
        part["href"] = page or f"#{part['anchor']}"
        for figure in part["figures"]:
            figure["href"] = f"{page}#{figure['id']}"
    return made


def _unused(kind: str, name: str, used: set[str]) -> str:
    """A new id of letters, digits and hyphens, also for file names; it is added to `used`."""
    slug = f"{kind}-{re.sub('[^a-z0-9]+', '-', name.lower())[:_LONGEST]}"
    found = next(
        each for each in chain([slug], (f"{slug}-{n}" for n in count(2))) if each not in used
    )
    used.add(found)
    return found


def shown(figure: Mapping[str, str]) -> dict[str, Any]:
    """A stored figure with its size, its files, and the data of its page (may be empty)."""
    files = {"svg": figure["svg"].encode()}
    for kind in PACKED:
        with suppress(KeyError, ValueError, zlib.error):  # absent, or not in packed form
            files[kind] = unpacked(figure[kind])
    data = files.pop("json", b"").decode()
    return {**figure, **size(figure["svg"]), "data": data, "files": files}


def _is_sound(figure: Mapping[str, str]) -> bool:
    return is_picture(figure.get("svg", ""))
