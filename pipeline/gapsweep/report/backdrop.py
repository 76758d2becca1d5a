"""What stands behind the points of a figure, and what a caption says of it: walls, and bands."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from gapsweep.report.scales import drawn
from gapsweep.report.style import BANDS, WALL
from gapsweep.response.result import ResponseClass
from gapsweep.study.grid import COORDINATE, START

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NOT_DRAWN = {
    ResponseClass.EQUILIBRIUM: "what is at rest",
    ResponseClass.FAILED: "what has no steady response",
}
_UNRESOLVED = "unresolved"
_WALLS = {"j_1": -1.0, "j_2": 1.0}


def said_of_walls(scene: xr.Dataset, *, of_peaks: bool = False) -> str:
    """What a caption says of walls, with a blank before: nothing where none is drawn.

    A system's walls bound the gap of its contact, whatever coordinates that is made of.
    """
    if COORDINATE in scene.coords:
        return ""
    return " Dashed: the upper wall." if of_peaks else " Dashed: walls."


def walls(axes: "Axes", scene: xr.Dataset, along: str = "omega", *, of_peaks: bool = False) -> None:
    """Both walls of the gap, or the upper one, where they can be drawn; what moves is a curve."""
    if not said_of_walls(scene):
        return
    for name, sign in _WALLS.items():
        if of_peaks and name == "j_1":
            continue
        if name == along:
            axes.plot(drawn(scene[name]), sign * drawn(scene[name]), label="_wall", **WALL)
        elif name in scene.coords and scene[name].ndim == 0:
            axes.axhline(sign * float(drawn(scene[name])), **WALL)


def bands(
    axes: "Axes", one: xr.Dataset, along: str = "omega", *, of: Iterable[str] = tuple(BANDS)
) -> None:
    """Pale bands behind what is drawn where any response is of a class that is not periodic."""
    x = drawn(one[along])
    width = np.gradient(x) if x.size > 1 else np.ones(1)
    kinds = one["response_class"].transpose(along, ...).values.reshape(x.size, -1)
    left = np.ones(x.size, dtype=bool)
    for kind in of:
        where = left & (kinds == ResponseClass[kind.upper()]).any(axis=1)
        left &= ~where
        look: dict[str, Any] = {"color": BANDS[kind], "zorder": 0, "antialiased": False}
        bars = axes.bar(x[where], 1.0, width[where], transform=axes.get_xaxis_transform(), **look)
        for bar in bars:
            bar.set_label(f"_{kind}")


def unresolved(axes: "Axes", scene: xr.Dataset, along: str) -> None:
    """The bands of what is unresolved, named in the legend, where there is any."""
    if _UNRESOLVED in _has(scene):
        bands(axes, scene, along, of=[_UNRESOLVED])
        look: dict[str, Any] = {"color": BANDS[_UNRESOLVED], "markersize": 8}
        axes.plot([], [], "s", label=_UNRESOLVED, **look)


def _has(scene: xr.Dataset) -> list[str]:
    """The kinds of bands that a scene has."""
    found = np.unique(scene["response_class"].values)
    return [kind for kind in BANDS if ResponseClass[kind.upper()] in found]


def key_of_bands(figure: "Figure", scene: xr.Dataset) -> None:
    """What the bands of a figure mean, if it has any."""
    from matplotlib.patches import Patch

    handles = [Patch(color=BANDS[kind], label=kind) for kind in _has(scene)]
    if handles:
        figure.legend(handles=handles, loc="outside upper right", ncols=len(handles), fontsize=8)


def said_of_bands(scene: xr.Dataset) -> str:
    """What a caption says of bands, with a blank before."""
    if not (kinds := _has(scene)):
        return ""
    whose = " from some start" if scene.sizes.get(START, 1) > 1 else ""
    beyond = " Unresolved ones may lie beyond the axis." if _UNRESOLVED in kinds else ""
    return f" Bands: the response{whose} is {' or '.join(kinds)}.{beyond}"


def said_of_missing(scene: xr.Dataset) -> str:
    """What a caption says of responses that have no extrema, with a blank before."""
    found = np.unique(scene["response_class"].values)
    missing = [words for kind, words in _NOT_DRAWN.items() if kind in found]
    return f" Not drawn: {', or '.join(missing)}." if missing else ""
