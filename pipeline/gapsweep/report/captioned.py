"""Figures of the report with their captions: over one axis, and maps over two."""

from collections.abc import Iterator, Sequence

import numpy as np
import xarray as xr

from gapsweep.errors import DatasetError
from gapsweep.report.backdrop import caption_of_bands, caption_of_missing, caption_of_walls
from gapsweep.report.branch_lines import caption as caption_of_branches
from gapsweep.report.branch_lines import of_scene
from gapsweep.report.drawing import caption_of_peaks
from gapsweep.report.figures import attractors as attractors_figure
from gapsweep.report.figures import bifurcation, frequency_response, maps, special_curves
from gapsweep.report.maps import MapImage, on_grid, picture
from gapsweep.report.parts import Figured
from gapsweep.report.scales import long_name, shown_unit
from gapsweep.report.tables import number
from gapsweep.study.grid import COORDINATE

STATE = ("x_0", "v_0")
LEAST = 5  # values of an axis of a map; with fewer, every value has curves
_NOISE = 1e-4  # relative differences that colours do not show
# Variables of maps, as captions name them.
_WORDS = {
    "response_class": "class",
    "period_multiple": "period",
    "n_attractors": "number of attractors",
    "attractor": "attractor",
    "amplitude": "amplitude",
    "x_max": "peak",
}


def plane_of(responses: xr.Dataset) -> list[str]:
    """Names ``x_0`` and ``v_0`` if fixed initial conditions form a grid of at least 5 by 5.

    Otherwise, and for systems, the list is empty.
    """
    if COORDINATE in responses.dims:
        return []
    try:
        sizes = on_grid(responses.coords.to_dataset()).sizes
    except DatasetError:
        return []
    return list(STATE) if min(sizes.values()) >= LEAST else []


def maps_of(
    parts: Sequence[tuple[xr.Dataset, str]], axes: list[str], where: str
) -> Iterator[Figured]:
    """One figure of maps; a value that is the same everywhere is stated in its caption.

    `parts`: dataset and name of each variable.
    `axes`: the horizontal and the vertical axis.
    `where`: representation and parameters, for the caption.
    """
    pictures = [(name, picture(part, name, axes[0], axes[1], {})[0]) for part, name in parts]
    alike = [(name, value) for name, one in pictures if (value := _everywhere(one))]
    shown = [(name, one) for name, one in pictures if not _everywhere(one)] or pictures[:1]
    drawn = dict.fromkeys(_WORDS[name] for name, _ in shown)
    text = f"{', '.join(drawn)}: {where}."
    if "attractor" in drawn and any("numbered_as" in part[name].attrs for part, name in parts):
        text += " Attractors have the numbers and colours of matching ones of the exact law."
    text += "".join(f" {_WORDS[name].capitalize()}: {value} everywhere." for name, value in alike)
    yield Figured(maps([one for _, one in shown]), text[0].upper() + text[1:], f"Maps, {where}")


def _everywhere(one: MapImage) -> str:
    """The only value of a map; empty if there are several."""
    values = one.numbers.values
    if len(one.names) == 1 and (one.kind == 0).all():
        return one.names[0]
    scale, unit = shown_unit(one.numbers)
    is_even = (one.kind < 0).all() and np.ptp(values) < _NOISE * np.abs(values).max()
    return f"{number(scale * values.mean())} {unit}".strip() if is_even else ""


def along_axis(
    scene: xr.Dataset,
    attractors: xr.Dataset | None,
    branches: xr.Dataset | None,
    along: str,
    where: str,
    *,
    of_starts: str = "",
    of_attractors: str = "",
) -> Iterator[Figured]:
    """Figures over one axis: extrema, and attractors or else amplitudes.

    Lines of amplitudes from several initial conditions would cross between attractors.

    `scene`: responses with dimensions representation, `along`, initial_condition.
    `attractors`: their attractors, with dimensions representation, `along`, attractor.
    `branches`: ``branches.nc``, drawn behind the dots.
    `where`: the parameters, in words.
    `of_starts` and `of_attractors`: the initial conditions of the extrema and of the attractors, in
    words.
    """
    if attractors is None:
        caption = "Amplitude (half the range) of the steady response, broken at jumps"
        figure = frequency_response(scene, along)
        yield Figured(figure, f"{caption}: {where}.", f"Amplitude, {where}")
    behind = caption_of_branches(branches, scene, along)
    where += ", branches behind" * bool(behind)
    yield Figured(
        bifurcation(scene, along, branches),
        f"Extrema of the steady response{of_starts}: {where}.{caption_of_bands(scene)}"
        f"{caption_of_missing(scene)}{caption_of_walls(scene, along)}{behind}",
        f"Bifurcation diagram, {where}",
    )
    if attractors is not None:
        yield Figured(
            attractors_figure(attractors, along, branches),
            f"Peak displacement of every attractor{of_attractors}: {where}."
            f"{caption_of_peaks(attractors)}"
            f"{caption_of_walls(scene, along, of_peaks=True)}{behind}",
            f"Attractors and their basins, {where}",
        )


def curves_figure(
    curves: xr.Dataset | None, scene: xr.Dataset, along: str, where: str
) -> Iterator[Figured]:
    """The curves of special points of ``curves.nc``, if there are any along an axis."""
    second = "" if curves is None else str(curves.attrs["second"])
    if curves is None or of_scene(curves, scene, along, second) is None:
        return
    said = f"Curves of special points over {long_name(scene[along])} and {second}"
    figure = special_curves(curves, scene, along, second)
    yield Figured(figure, f"{said}: {where}.", f"Curves of special points, {where}")
