"""Figures as SVG with text as text.

In a page they stand as images, not as elements of their own: a study has tens of thousands of
points, and a browser lays out none of them. As images they cannot run scripts either.
"""

import base64
import io
import re
import zlib
from collections import Counter
from typing import Any
from urllib.parse import quote
from xml.etree import ElementTree

from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

from gapsweep.report.figure_marks import as_csv, as_json

PACKED = "csv", "json"
# What matplotlib draws with. Others run scripts, lead elsewhere or change what is shown.
_DRAWING = {
    "svg", "g", "defs", "style", "path", "use", "clipPath", "rect", "circle", "image", "text",
    "tspan",
}  # fmt: skip
_SMALLEST = 8.5  # points of a font, 11 pixels
_COLOURS = 64  # of points drawn as pixels
_PIXELS = re.compile("data:image/png;base64,([^\"']*)")
# Hundredths of a point are enough, but not of the numbers in texts.
_TAG, _DIGITS = re.compile("<[^>]*>"), re.compile(r"([1-9]\d*\.\d\d)\d+")
_VALUE = re.compile('="([^"\']*)"')
_SIZE = re.compile(r'width="([\d.]+)pt" height="([\d.]+)pt"')
_AS_TEXT: dict[Any, Any] = {"svg.fonttype": "none", "savefig.dpi": 130}
# What says nothing: rotations by zero, fonts that nobody has, names that nothing refers to.
_IDLE = re.compile(
    r" transform=\"rotate\(-0 [^\"]*\"|, 'Bitstream[^;]*(?=, sans-serif)|<metadata>.*</metadata>"
    r"|<!--.*?-->| id=\"[a-zA-Z.]+[a-z0-9]*_[0-9]+\"| (?=/?>)"
)
_GROUP = re.compile(r"<g>((?:(?!</?g\b).)*)</g>")  # that says nothing of what is in it
_NAME = re.compile('(?<= id=")[a-z][0-9a-f]{10}(?=")')
_PATH, _BLANKS = re.compile(' d="([^"]*)"'), re.compile(" ?[A-Za-z] ?| $")
_LINES = re.compile(r"L [-\d.]+ [-\d.]+(?: L [-\d.]+ [-\d.]+)+")
_STYLE = re.compile(' style="([^"]*)"')
# What need not be escaped in an address between double quotes, where a blank would end it.
_PLAIN = "<>/:;=,.'()!*+-_~@[]{}|^`$?"


def pictures(figure: Figure) -> dict[str, str]:
    """A figure as texts that JSON can hold; the figure is cleared.

    Returns
    -------
    dict of str to str
        ``svg``, and if the figure shows numbers, these `PACKED` as ``csv``, and as ``json`` for a
        page that draws them.
    """
    numbers = as_csv(figure).encode(), as_json(figure).encode()
    texts: list[Any] = figure.findobj(Text)
    for text in texts:
        text.set_fontsize(max(_SMALLEST, text.get_fontsize()))
    picture = svg(figure)
    figure.clear()  # its cycles would keep every figure's data until the collector comes by
    files = {kind: packed(h) for kind, h in zip(PACKED, numbers, strict=True) if h}
    return {"svg": picture, **files}


def packed(data: bytes) -> str:
    """A file as text, for JSON."""
    return base64.b64encode(zlib.compress(data, 9)).decode()


def unpacked(text: str) -> bytes:
    """The file that was `packed`."""
    return zlib.decompress(base64.b64decode(text))


def svg(figure: Figure) -> str:
    """A figure as SVG: no longer than it must be, the same for the same data."""
    buffer = io.StringIO()
    with rc_context(_AS_TEXT):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    text = _IDLE.sub("", " ".join(text[text.index("<svg") :].split())).replace("> <", "><")
    text = _PATH.sub(_shortened, _TAG.sub(lambda m: _DIGITS.sub(r"\1", m[0]), text))
    while (fewer := _GROUP.sub(r"\1", text)) != text:
        text = fewer
    for i, name in enumerate(dict.fromkeys(_NAME.findall(text))):
        text = text.replace(name, f"n{i}")
    return _PIXELS.sub(_fewer_colours, _with_classes(text))


def _shortened(found: re.Match[str]) -> str:
    """The same path without needless letters and blanks."""
    lines = _LINES.sub(lambda m: m[0].replace(" L ", " "), found[1])
    return f' d="{_BLANKS.sub(lambda m: m[0].strip(), lines).replace(" ", ",")}"'


def _with_classes(text: str) -> str:
    """The same picture, every style that is used again said once."""
    used = Counter(_STYLE.findall(text))
    again = [style for style, n in used.items() if n > 1]
    names = {style: f"s{i}" for i, style in enumerate(again)}
    rules = "".join(f".{name}{{{style}}}" for style, name in names.items())
    text = _STYLE.sub(lambda m: f' class="{names[m[1]]}"' if m[1] in names else m[0], text)
    return text.replace("</style>", f"{rules}</style>", 1)


def _fewer_colours(found: re.Match[str]) -> str:
    """The same pixels of some colours only, a third as long."""
    buffer = io.BytesIO()
    with Image.open(io.BytesIO(base64.b64decode(found[1]))) as pixels:
        few = pixels.convert("RGBA").quantize(_COLOURS, method=Image.Quantize.FASTOCTREE)
        few.save(buffer, "png", optimize=True)
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}"


def address(picture: str) -> Markup:
    """A picture as an address between double quotes, for an image in the page itself."""
    single = _VALUE.sub(r"='\1'", picture)
    return Markup(f"data:image/svg+xml,{quote(single, safe=_PLAIN)}")


def size(picture: str) -> dict[str, Any]:
    """Width and height of a picture in pixels, so that the page does not move when it comes."""
    found = _SIZE.search(picture)
    width, height = (round(float(n) * 4 / 3) for n in found.groups()) if found else (0, 0)
    return {"width": width, "height": height}


def is_picture(text: str) -> bool:
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
