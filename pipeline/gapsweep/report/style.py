"""Styles of figures: a colour per representation, distinguishable by colour-blind readers."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

from gapsweep.model.contact import ContactLaw
from gapsweep.model.labels import NOT_LOCATED, Representation

_NOEVENTS = "#999999"  # the exact law without located contacts
# Responses that are not periodic are red in every map; the most common classes are pale.
NOT_PERIODIC, NOT_SETTLED, BLANK = "#c00000", "#a0a0a0", "#ffffff"
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
WALL: dict[str, Any] = {"color": "#888888", "linewidth": 0.8, "linestyle": "--", "zorder": 1.6}
# Light to dark in blue and green, apart from red and orange, also for colour-blind readers.
_SEQUENCE = "YlGnBu"
_LINES = ("-", "--", ":", "-.")

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


def colour(label: str) -> str:
    """Colour of a representation, by its family."""
    law = Representation(label).law
    return _NOEVENTS if law == NOT_LOCATED else (law.law_type or ContactLaw).colour


def sequence(n: int) -> list[str]:
    """`n` colours for counted kinds, from pale to dark, with larger steps at the pale end."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    places = [0.12 + 0.88 * (i / max(n - 1, 1)) ** 0.6 for i in range(n)]
    return [to_hex(colormaps[_SEQUENCE](place)) for place in places]


def lines(labels: Sequence[str]) -> dict[str, str]:
    """Line style by representation: the first of a colour solid, the next dashed, ..."""
    return by_colour(labels, _LINES)


def by_colour(labels: Sequence[str], looks: Sequence[str]) -> dict[str, str]:
    """An entry of `looks` by label: labels of one colour get the first, the second, ..."""
    used: Counter[str] = Counter()
    found = {}
    for label in labels:
        found[label] = looks[used[colour(label)] % len(looks)]
        used[colour(label)] += 1
    return found
