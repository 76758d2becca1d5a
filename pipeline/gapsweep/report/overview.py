"""The section of the report in place of one per scene, where these would be too many.

Everything is drawn as meshes over two axes, the others at one value: neither the page nor the
memory grows with the number of scenes.
"""

from collections.abc import Iterator

import numpy as np
import xarray as xr

from gapsweep.analysis.grid import REPRESENTATION, SWEPT, scene_dims, swept
from gapsweep.analysis.systems import by_coordinate, is_of_systems
from gapsweep.errors import DatasetError
from gapsweep.report.drawing import said_of_walls
from gapsweep.report.figures import attractors as attractors_figure
from gapsweep.report.figures import bifurcation, maps
from gapsweep.report.maps import numeric_axes, on_grid, picture
from gapsweep.report.parts import Figured, Part
from gapsweep.report.scales import named
from gapsweep.report.selection import places
from gapsweep.report.tables import scene_tables
from gapsweep.status import Status
from gapsweep.study.grid import COORDINATE

MOST_SCENES, MOST_POINTS = 16, 200_000
_TOLD_APART = ("K_c", "gap")  # by these alone scenes have always had a figure each
_START = SWEPT[1]
_STATE = ("x_0", "v_0")
_FEW_STARTS = 500


def is_wide(responses: xr.Dataset) -> bool:
    """Whether a representation has too many scenes, or points, or parameters for figures of each.

    Parameters
    ----------
    responses : Dataset
        As stored in ``responses.nc``.
    """
    asked = responses["status"].load() != Status.NOT_REQUESTED
    dims = scene_dims(asked.dims)
    return (
        is_of_systems(responses)
        or any(asked.sizes[dim] > 1 for dim in dims if dim not in _TOLD_APART)
        or int(asked.any(swept(asked)).sum(dims).max()) > MOST_SCENES
        or int(asked.sum([*dims, *swept(asked)]).max()) > MOST_POINTS
    )


def overview(
    responses: xr.Dataset,
    agreement: xr.Dataset | None,
    timing: xr.Dataset,
    attractors: xr.Dataset | None,
) -> Part:
    """What stands in the report in place of its scenes.

    Parameters
    ----------
    responses, agreement, timing, attractors : Dataset
        As for `gapsweep.report.html.write_report`.
    """
    asked = responses["status"].load() != Status.NOT_REQUESTED
    n_points = asked.sum([dim for dim in asked.dims if dim != REPRESENTATION])
    labels = [str(label) for label in asked[REPRESENTATION].values[n_points.values > 0]]
    n_scenes = int(asked.any((REPRESENTATION, *swept(asked))).sum())
    axes = _axes(responses)
    names = [str(responses[axis].attrs.get("long_name", axis)) for axis in axes]
    of_all = ", of all else at one value, in place of figures of each scene" if n_scenes > 1 else ""
    sentence = (
        f"{n_scenes} scene{'s' * (n_scenes > 1)} with {int(n_points.sum())} sweep points"
        f"{': pictures over ' * bool(names)}{' and '.join(names)}{of_all}. "
        "ds.gapsweep.map() and bifurcation() draw any other."
    )
    over = f", median over {n_scenes} scenes" if n_scenes > 1 else ""
    plain = [label for label in labels if "@" not in label] or labels
    return Part(
        "overview",
        f"All scenes over {' and '.join(names)}" if names else "All scenes",
        [sentence],
        scene_tables(agreement, timing, labels, over),
        (
            figure
            for label in plain
            if axes
            for figure in _figures(responses, attractors, asked, label, axes)
        ),
    )


def _axes(responses: xr.Dataset) -> list[str]:
    """The two longest axes, frequency the horizontal one; states that many starts form, if none."""
    axes = numeric_axes(responses["status"].to_dataset())[:2]
    if len(axes) < 2 and responses.sizes[_START] > _FEW_STARTS and "x_0" in responses.coords:
        starts = responses[list(_STATE)].reset_coords()
        try:
            return [str(dim) for dim in on_grid(starts.set_coords(_STATE)).dims][::-1]
        except DatasetError:
            pass
    return sorted(axes, key=lambda axis: axis != "omega")


def _figures(
    responses: xr.Dataset,
    attractors: xr.Dataset | None,
    asked: xr.DataArray,
    label: str,
    axes: list[str],
) -> Iterator[Figured]:
    """Pictures of a representation, of the other axes at the values with the most points."""
    at = _most(asked, label, [_START] if axes[0] in _STATE else axes)
    here = responses.isel(at)
    found = None if attractors is None else attractors.isel(at, missing_dims="ignore")
    n_starts = responses.sizes[_START]
    is_one = n_starts > 1 and here[_START].ndim == 0
    start = f", start {int(here[_START]) + 1} of {n_starts}" if is_one else ""
    for part, suffix in by_coordinate(here):
        of_part = found
        if found is not None and suffix:
            of_part = found.sel({COORDINATE: part[COORDINATE].values})
        where = f"{', '.join([label, *_where(responses, here)])}{suffix}"
        yield from _pictures(part, of_part, axes, where, start)


def _pictures(
    here: xr.Dataset, found: xr.Dataset | None, axes: list[str], where: str, start: str
) -> Iterator[Figured]:
    if len(axes) == 1:
        yield from _curves(here, found, axes[0], where, start)
        return
    parts = [(here, name) for name in ("response_class", "period_multiple", "amplitude")]
    if axes[0] in _STATE:
        parts.append((here, "attractor"))
    elif found is not None:
        parts.append((found, "n_attractors"))
    pictures = (picture(part, name, axes[0], axes[1], {})[0] for part, name in parts)
    where += start
    yield Figured(
        maps(pictures), f"Class, period, amplitude and attractors: {where}.", f"Maps, {where}"
    )


def _curves(
    here: xr.Dataset, found: xr.Dataset | None, along: str, where: str, start: str
) -> Iterator[Figured]:
    """Diagrams over the only axis: from one start, and of the attractors from all."""
    shown = here[["extrema", "response_class"]].load().expand_dims([REPRESENTATION, _START])
    yield Figured(
        bifurcation(shown, along),
        f"All steady zero-velocity displacements: {where}{start}.{said_of_walls(here)}",
        f"Bifurcation diagram, {where}{start}",
    )
    if found is not None:
        shown = found[["x_max", "basin_share", "response_class"]].load()
        yield Figured(
            attractors_figure(shown.expand_dims(REPRESENTATION), along),
            f"Peak displacement of every attractor: {where}. The area of a dot is the share of "
            "all starts that end on it; hollow: not periodic.",
            f"Attractors and their basins, {where}",
        )


def _most(asked: xr.DataArray, label: str, over: list[str]) -> dict[str, int]:
    """Where a representation has the most points over some dimensions; the first such place."""
    r = asked[REPRESENTATION].values.tolist().index(label)
    counts = asked.isel({REPRESENTATION: r}).sum(over)
    place = np.unravel_index(int(counts.values.argmax()), counts.shape)
    return {REPRESENTATION: r} | {
        str(dim): int(i) for dim, i in zip(counts.dims, place, strict=True)
    }


def _where(responses: xr.Dataset, here: xr.Dataset) -> list[str]:
    """The values that a part is of, and among how many they are."""
    words = []
    for name in places(here):
        if here[name].ndim == 0:
            n = responses.sizes.get(name, 1)
            words.append(named(here[name]) + (f" (one of {n})" if n > 1 else ""))
    return words
