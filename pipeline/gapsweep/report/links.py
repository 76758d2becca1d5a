"""Ids, files and links of the parts and figures of a report."""

import re
import zlib
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from itertools import chain, count
from typing import Any

from gapsweep.report.pictures import PACKED, is_picture, size, unpacked

_LONGEST = 64  # characters of an id


class Links:
    """Addresses of the parts and figures of a report, for templates.

    Parameters
    ----------
    parts : sequence of mapping
        As `for_page` returns them.
    """

    def __init__(self, parts: Sequence[Mapping[str, Any]]) -> None:
        self._parts: dict[str, str] = {part["anchor"]: part["href"] for part in parts}
        group = next((part["group"] for part in parts if part["group"]), "")
        self._results = f"#{group.lower()}"
        self._titles: list[tuple[str, str]] = [(part["title"], part["href"]) for part in parts]
        figures = [figure for part in parts for figure in part["figures"]]
        self._figures: dict[str, str] = {
            f["name"]: f["href"] for f in figures[::-1] if f.get("name")
        }

    def part(self, anchor: str) -> str:
        """Address of a part; of the first group if there is no such part."""
        return self._parts.get(anchor, self._results)

    def place(self, place: str) -> str:
        """Address of the figure or part that a claim is about, the nearest by name, else empty.

        "Fig. 11ab" is about "Fig. 11" or "Fig. 11, their solver", "Fig. 2" about the first of
        "Fig. 2a" and "Fig. 2b".
        """
        near = [
            name for name in self._figures
            if _begins(place, name.split(",")[0]) or _begins(name, place)
        ]  # fmt: skip
        if near:
            return self._figures[min(near, key=lambda name: name != place)]
        titled = (href for title, href in self._titles if title.endswith(f" {place}"))
        return next(titled, "")


def _begins(text: str, start: str) -> bool:
    """Whether a name begins with another one, and no digit follows (not "Fig. 11" for "Fig. 1")."""
    return text.startswith(start) and not text[len(start) : len(start) + 1].isdigit()


def for_page(parts: Iterable[Mapping[str, Any]], most: int, folder: str) -> list[dict[str, Any]]:
    """Rendered parts with ids, links and addresses of pictures.

    `parts`: each with the name of its `group`, empty for parts that are always on the report's
    page.
    `most`: figures of groups on one page; with more, every part of a group has its own page.
    `folder`: folder of the pages of parts.
    Result: every part also has the name of its page as ``file`` (empty: the report's page) and a
    link to it from the report as ``href``; every figure has an ``id`` and a ``href``.
    """
    made: list[dict[str, Any]] = []
    used = set[str]()
    for part in parts:
        figures = [_shown(each) for each in part["figures"] if is_picture(each.get("svg", ""))]
        for figure in figures:
            name = (figure.get("name") or part["anchor"]).removeprefix("Fig. ")
            figure["id"] = _unused("figure", name, used)
        made.append({**part, "figures": figures})
    is_long = sum(len(part["figures"]) for part in made if part["group"]) > most
    for part in made:
        is_cut = is_long and part["group"]
        part["file"] = f"{_unused('section', part['anchor'], used)}.html" if is_cut else ""
        page = f"{folder}/{part['file']}" if is_cut else ""
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


def _shown(figure: Mapping[str, str]) -> dict[str, Any]:
    """A stored figure with its size, its files, and the data and choices of its page, or empty."""
    files = {"svg": figure["svg"].encode()}
    for kind in PACKED:
        with suppress(KeyError, ValueError, zlib.error):  # absent, or not in packed form
            files[kind] = unpacked(figure[kind])
    data, choices = (files.pop(kind, b"").decode() for kind in PACKED[1:])
    return {**figure, **size(figure["svg"]), "data": data, "choices": choices, "files": files}
