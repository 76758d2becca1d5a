"""Walls and class bands behind the points of a figure, and the sentences for its caption."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.report.scales import drawn
from gapsweep.report.style import BANDS, WALL
from gapsweep.response.result import ResponseClass
from gapsweep.study.grid import COORDINATE, START

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

_NOT_DRAWN = {
    ResponseClass.EQUILIBRIUM: "equilibria",
    ResponseClass.FAILED: "failed points",
}
_UNRESOLVED = "unresolved"
_SYSTEM = "system_json"
_WALLS = {"j_1": -1.0, "j_2": 1.0}


def caption_of_walls(scene: xr.Dataset, along: str = "omega", *, of_peaks: bool = False) -> str:
    """Caption sentence on walls, with a leading blank; empty if none is drawn."""
    n = len(list(_walls(scene, along, of_peaks)))
    if n and _SYSTEM in scene.attrs:
        return " Dashed: walls within the axis."
    which = "the upper wall" if of_peaks else "walls" if n > 1 else "the wall"
    return f" Dashed: {which}." if n else ""


def walls(axes: "Axes", scene: xr.Dataset, along: str = "omega", *, of_peaks: bool = False) -> None:
    """Draw both walls of the gap, or the upper one; a wall that depends on the axis is a curve.

    For systems, only walls of contacts on the drawn coordinate.
    """
    from matplotlib.lines import Line2D

    for height in _walls(scene, along, of_peaks):
        if _SYSTEM not in scene.attrs and height.ndim:
            axes.plot(drawn(scene[along]), height, label="_wall", **WALL)
        elif _SYSTEM not in scene.attrs:
            axes.axhline(float(height), **WALL)
        # A distant wall of a system, as of gears under load, does not set the axis.
        elif height.ndim:
            axes.add_artist(Line2D(drawn(scene[along]), height, label="_wall", **WALL))
        else:
            across = {"transform": axes.get_yaxis_transform(), **WALL}
            axes.add_artist(Line2D([0.0, 1.0], [float(height)] * 2, **across))


def _walls(scene: xr.Dataset, along: str, of_peaks: bool) -> Iterator[NDArray[np.float64]]:
    """Height of each wall in the figure: one number, or an array along the axis."""
    for factor, own in _contacts(scene):
        for name, sign in _WALLS.items():
            # Without stiffness there is no wall.
            is_none = name == "j_1" and _one("K_ratio", scene, own) == 0.0
            if is_none or (of_peaks and sign * factor < 0.0):
                continue
            if name in own:
                yield np.asarray(sign / factor * own[name])
            elif name == along or (name in scene.coords and scene[name].ndim == 0):
                yield sign / factor * drawn(scene[name])


def _one(name: str, scene: xr.Dataset, own: Mapping[str, float]) -> float:
    """The value of a parameter in a parameter set; NaN if it has several values or none."""
    if name in own:
        return own[name]
    return float(scene[name]) if name in scene.coords and scene[name].ndim == 0 else np.nan


def _contacts(scene: xr.Dataset) -> Iterator[tuple[float, dict[str, float]]]:
    """Contacts on the drawn coordinate: each with the coordinate's factor, and separate settings.

    The factors hold at the values in ``[parameters]``; files have no others.
    """
    if _SYSTEM not in scene.attrs:
        yield 1.0, {}
        return
    system = json.loads(scene.attrs[_SYSTEM])
    own = json.loads(scene.attrs["study_json"]).get("contact", {})
    names = system["coordinates"]
    shown = np.ravel(scene.coords.get(COORDINATE, names)).tolist()
    if len(shown) > 1:
        return
    number = names.index(*shown)
    for name, direction in system["contacts"].items():
        factor, table = float(direction[number]), own.get(name, {})
        if not factor or np.count_nonzero(direction) > 1:
            continue  # not a contact on this coordinate only
        gap = dict(zip(_WALLS, table.get("gap") or (), strict=False))
        ratio = table.get("K_ratio")
        yield factor, gap | ({} if ratio is None else {"K_ratio": ratio})


def bands(
    axes: "Axes", one: xr.Dataset, along: str = "omega", *, of: Iterable[str] = tuple(BANDS)
) -> None:
    """Draw pale bands where any response has one of the classes `of`."""
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
            bar.sticky_edges.y.clear()  # their heights are shares of the axis


def unresolved(axes: "Axes", scene: xr.Dataset, along: str) -> None:
    """Draw bands of unresolved responses, with a legend entry, if there are any."""
    if _UNRESOLVED in _has(scene):
        bands(axes, scene, along, of=[_UNRESOLVED])
        look: dict[str, Any] = {"color": BANDS[_UNRESOLVED], "markersize": 8}
        axes.plot([], [], "s", label=_UNRESOLVED, **look)


def _has(scene: xr.Dataset) -> list[str]:
    """Response classes in a parameter set that have bands."""
    found = np.unique(scene["response_class"].values)
    return [kind for kind in BANDS if ResponseClass[kind.upper()] in found]


def key(figure: "Figure", scene: xr.Dataset, marks: Sequence["Line2D"] = ()) -> None:
    """Add a legend of the bands, and of these markers, to a figure, if it has any."""
    from matplotlib.patches import Patch

    handles = [*marks, *(Patch(color=BANDS[kind], label=kind) for kind in _has(scene))]
    if handles:
        figure.legend(handles=handles, loc="outside upper right", ncols=len(handles), fontsize=8)


def caption_of_bands(scene: xr.Dataset) -> str:
    """Caption sentence on bands, with a leading blank; empty without bands."""
    if not (kinds := _has(scene)):
        return ""
    whose = " from some initial conditions" if scene.sizes.get(START, 1) > 1 else ""
    beyond = " Unresolved responses may lie beyond the axis." if _UNRESOLVED in kinds else ""
    return f" Bands: the response{whose} is {' or '.join(kinds)}.{beyond}"


def caption_of_missing(scene: xr.Dataset) -> str:
    """Caption sentence on responses that are not drawn, with a leading blank, or empty."""
    found = np.unique(scene["response_class"].values)
    missing = [words for kind, words in _NOT_DRAWN.items() if kind in found]
    return f" Not drawn: {', '.join(missing)}." if missing else ""
