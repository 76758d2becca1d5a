"""Walls and class bands behind the points of a figure, and the sentences for its caption."""

import json
from collections.abc import Iterable, Iterator, Mapping

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.report import marks
from gapsweep.report.marks import Marks
from gapsweep.report.scales import drawn
from gapsweep.report.style import BANDS, WALL
from gapsweep.response.result import ResponseClass
from gapsweep.study.grid import COORDINATE, START

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


def walls(scene: xr.Dataset, along: str = "omega", *, of_peaks: bool = False) -> Iterator[Marks]:
    """Both walls of the gap, or the upper one; a wall that depends on the axis is a curve.

    For systems, only walls of contacts on the drawn coordinate.
    """
    # A distant wall of a system, as of gears under load, does not set the axis.
    sets = False if _SYSTEM in scene.attrs else None
    for height in _walls(scene, along, of_peaks):
        if height.ndim:
            line = {"x": drawn(scene[along]), "y": height, "series": "wall"}
            yield marks.line(sets=sets, **line, **WALL)
        else:
            yield marks.level(y=float(height), sets=sets, **WALL)


def _walls(scene: xr.Dataset, along: str, of_peaks: bool) -> Iterator[NDArray[np.float64]]:
    """Height of each wall in the figure: one number, or an array along the axis."""
    for factor, own in _contacts(scene):
        for name, sign in _WALLS.items():
            # Without stiffness there is no wall.
            is_none = name == "j_1" and _one("K_ratio", scene, own) == 0.0
            is_none |= _one(name, scene, own) == np.inf
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

    Gaps are in drawn units.

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
    scale = 1e3 if system["units"].get(names[number], "m") == "m" else 1.0
    for name, direction in system["contacts"].items():
        factor, table = float(direction[number]), own.get(name, {})
        if not factor or np.count_nonzero(direction) > 1:
            continue  # not a contact on this coordinate only
        gap = {wall: scale * j for wall, j in zip(_WALLS, table.get("gap") or (), strict=False)}
        ratio = table.get("K_ratio")
        yield factor, gap | ({} if ratio is None else {"K_ratio": ratio})


def bands(
    one: xr.Dataset, along: str = "omega", *, of: Iterable[str] = tuple(BANDS)
) -> Iterator[Marks]:
    """Pale bands where any response has one of the classes `of`."""
    x = drawn(one[along])
    half = 0.5 * (np.gradient(x) if x.size > 1 else np.ones(1))
    kinds = one["response_class"].transpose(along, ...).values.reshape(x.size, -1)
    left = np.ones(x.size, dtype=bool)
    for kind in of:
        where = left & (kinds == ResponseClass[kind.upper()]).any(axis=1)
        left &= ~where
        ends = {"x": (x - half)[where], "x_end": (x + half)[where]}
        yield marks.band(series=kind, colour=BANDS[kind], **ends)


def unresolved(scene: xr.Dataset, along: str) -> Iterator[Marks]:
    """Bands of unresolved responses, with a legend entry, if there are any."""
    if _UNRESOLVED in _has(scene):
        yield from bands(scene, along, of=[_UNRESOLVED])
        yield marks.key(entry=_UNRESOLVED, colour=BANDS[_UNRESOLVED], marker="s", size=8.0)


def _has(scene: xr.Dataset) -> list[str]:
    """Response classes in a parameter set that have bands."""
    found = np.unique(scene["response_class"].values)
    return [kind for kind in BANDS if ResponseClass[kind.upper()] in found]


def key_of_bands(scene: xr.Dataset) -> Iterator[Marks]:
    """Legend entries of the bands in a figure."""
    return (marks.key(entry=kind, colour=BANDS[kind], marker="s", size=8.0) for kind in _has(scene))


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
