"""The table of styles of all figures: report, accessor, explorer and documentation.

The style of a law depends on its label only. The exact law is black; every other family has a hue,
and within it a tone and a dash pattern for the convergence parameter or the degree: the sharper,
the darker. The marker shows the initial condition; a hollow marker, a response that is not
periodic. Marks have a contrast of at least 3 on white, and laws of different families are
distinguishable with deuteranopia and protanopia (``tests/unit/test_style.py`` computes both).
Cells and bands are areas with a key, and may be paler.
"""

import math
import zlib
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from gapsweep.model.labels import EXACT, NOT_LOCATED, Representation

GREY = "#767676"
BLANK = "#ffffff"
_NOEVENTS = "#8c8c8c"  # the exact law without located contacts
NOT_PERIODIC, NOT_SETTLED = "#c00000", GREY
CLASS_COLOURS = {
    "periodic": "#9ecae1",
    "chaotic": NOT_PERIODIC,
    "quasiperiodic": "#762a83",
    "equilibrium": "#d9d9d9",
    "unresolved": "#E69F00",
    "failed": "#555555",
}
# Backgrounds by class: light enough for every point colour, distinguished by lightness.
BANDS = {"chaotic": "#fbd9d3", "quasiperiodic": "#e6d6ee", "unresolved": "#c8d8e6"}
# Marks of walls.
WALL: dict[str, Any] = {"colour": GREY, "size": 0.8, "dashes": "--", "zorder": 1.6}
# Attractors and branches, which have numbers: hues without an order.
NUMBERED = (
    *("#0072b2", "#d55e00", "#00976d", "#8a3ffc"),
    *("#3d3d12", "#2b96a8", "#5b4fc9", "#3b1f6b"),
)
# Light to dark in blue and green, apart from red and orange, also for colour-blind readers.
_SEQUENCE = "YlGnBu"
_LINES = ("-", "--", ":", "-.")
_MARKERS = ("o", "s", "D", "p", "P")
# Markers of sweeps, by the coordinate ``start``; fixed initial conditions have the law's.
SWEEPS = {"sweep_up": "^", "sweep_down": "v"}

MATPLOTLIB: dict[Any, Any] = {
    "figure.constrained_layout.use": True,
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "svg.hashsalt": "gapsweep",  # the same data give the same file
}


@dataclass(frozen=True, slots=True)
class _Family:
    """Colours of the coarsest and the sharpest law of a family, and its scale of sharpness.

    A law is ``(number - reference) / step`` steps from the reference, where the number is the
    degree, the sum of both degrees, the decimal logarithm of the convergence parameter, or chi.
    """

    coarse: str
    sharp: str
    reference: float
    step: float = 1.0


_FAMILIES = {
    "poly": _Family("#855222", "#502c00", 13.0, 4.0),
    "ratpoly": _Family("#7a28c3", "#530789", 8.0, 2.0),
    "tanh": _Family("#eb7001", "#c04f00", 4.0),
    "arctan": _Family("#12824d", "#195a45", 4.0),
    "logarctan": _Family("#4b80ce", "#1d5698", 4.0),
    "huntcrossley": _Family("#d4579f", "#8d0f5c", 0.0, 4.0),
}
_USER = _Family("#3d9dc0", "#18728f", 0.0)
_STEPS = -2.0, 5.0  # from the coarse colour to the sharp one


@dataclass(frozen=True, slots=True)
class Look:
    """Style of a representation: colour, line style and marker of matplotlib."""

    colour: str
    dashes: str = "-"
    marker: str = "o"


def looks(labels: Iterable[str]) -> dict[str, Look]:
    """Styles of the representations of a figure, in their order.

    The plain law, or else the first representation of a law, has the law's style; further ones,
    under other protocols, differ from it in line style and marker.
    """
    used: Counter[str] = Counter()
    labels, found = list(labels), {}
    for label in sorted(labels, key=lambda label: Representation(label).protocol != ""):
        law = _law_of(label)
        (shade, n), more = _law(law), used[law]
        used[law] += 1
        dashes, marker = _LINES[(n + more) % len(_LINES)], _MARKERS[(n - more) % len(_MARKERS)]
        found[label] = Look(shade, dashes, marker)
    return {label: found[label] for label in labels}


def colour(label: str) -> str:
    """Colour of the law of a representation, or of a family."""
    return _law(_law_of(label))[0]


def _law_of(label: str) -> Representation:
    """Law of a representation, which a figure may name with swept values after a comma."""
    return Representation(label.partition(", ")[0]).law


def _law(law: Representation) -> tuple[str, int]:
    """Colour of a law, and the number of its line style."""
    if law in (EXACT, NOT_LOCATED):
        return ("#000000", 0) if law == EXACT else (_NOEVENTS, 1)
    family = _FAMILIES.get(law.family, _USER)
    low, high = _STEPS
    if law.law_type is None:  # distinct laws of users rarely agree in this number
        steps = zlib.crc32(law.encode()) % 8 + low
    elif law.parameter:
        number = sum(map(float, law.parameter.split("/")))
        number = math.log10(number) if law.law_type.is_sharpened else number
        steps = (number - family.reference) / family.step
    else:
        steps = 0.0
    return _mixed(family, min(max((steps - low) / (high - low), 0.0), 1.0)), round(steps)


def _mixed(family: _Family, share: float) -> str:
    """Colour between the coarse one (share 0) and the sharp one (share 1) of a family."""
    ends = (bytes.fromhex(end[1:]) for end in (family.coarse, family.sharp))
    return "#" + bytes(round(a + share * (b - a)) for a, b in zip(*ends, strict=True)).hex()


def sequence(n: int) -> list[str]:
    """`n` colours for counted kinds, from pale to dark, with larger steps at the pale end."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    places = [0.12 + 0.88 * (i / max(n - 1, 1)) ** 0.6 for i in range(n)]
    return [to_hex(colormaps[_SEQUENCE](place)) for place in places]
