"""Figures as SVG files with searchable text.

A page includes them as images, not as elements: a study has tens of thousands of points, and the
browser need not lay them out. Scripts do not run in images.
"""

import base64
import io
import re
import zlib
from collections.abc import Iterable
from typing import Any
from xml.etree import ElementTree

from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.text import Text

from gapsweep.report.figure_data import Choice, as_csv, as_json, choices_as_json

PACKED = "csv", "json", "choices"
# Elements that matplotlib uses. Others could run scripts, link elsewhere or change the page.
_DRAWING = {
    "svg", "g", "defs", "style", "path", "use", "clipPath", "rect", "circle", "image", "text",
    "tspan",
}  # fmt: skip
_SMALLEST = 8.5  # points of a font, 11 pixels
_SIZE = re.compile(r'width="([\d.]+)pt" height="([\d.]+)pt"')
_AS_TEXT: dict[Any, Any] = {"svg.fonttype": "none", "savefig.dpi": 130}
_NO_METADATA = dict.fromkeys(("Creator", "Date", "Format", "Type"))


def pictures(figure: Figure, choices: Iterable[Choice] = ()) -> dict[str, str]:
    """A figure as texts for JSON; the figure is cleared.

    Result: ``svg``; if the figure shows numbers, also ``csv``, and ``json`` for a page that draws
    them, with the data of its `choices`; all as from `packed`.
    """
    texts = as_csv(figure), as_json(figure), choices_as_json(figure, choices)
    labels: list[Any] = figure.findobj(Text)
    for label in labels:
        label.set_fontsize(max(_SMALLEST, label.get_fontsize()))
    buffer = io.StringIO()
    with rc_context(_AS_TEXT):
        figure.savefig(buffer, format="svg", metadata=_NO_METADATA)
    figure.clear()  # reference cycles would keep the data of every figure in memory
    files = {kind: packed(t.encode()) for kind, t in zip(PACKED, texts, strict=True) if t}
    return {"svg": buffer.getvalue(), **files}


def packed(data: bytes) -> str:
    """Compress bytes with zlib; returns them as base64 text, for JSON."""
    return base64.b64encode(zlib.compress(data, 9)).decode()


def unpacked(text: str) -> bytes:
    """Bytes of a file from its text as of `packed`."""
    return zlib.decompress(base64.b64decode(text))


def size(picture: str) -> dict[str, Any]:
    """Width and height of a picture in pixels, so that the page keeps its layout on loading."""
    found = _SIZE.search(picture)
    width, height = (round(float(n) * 4 / 3) for n in found.groups()) if found else (0, 0)
    return {"width": width, "height": height}


def is_picture(text: str) -> bool:
    """Whether a text is an SVG with elements of matplotlib only, without links and scripts."""
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
