"""One section of the report in place of one per parameter set, if there are too many sets.

Figures are over two axes, with all other parameters at one value, so that neither the page nor the
memory grows with the number of sets: meshes over two long axes; curves over one axis, or for each
of a few values of the second.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import xarray as xr

from gapsweep.analysis.dimensions import (
    REPRESENTATION,
    SWEPT,
    At,
    by_coordinate,
    in_metres,
    scene_dims,
    scenes,
    swept,
)
from gapsweep.errors import DatasetError
from gapsweep.model.labels import EXACT, Representation
from gapsweep.report.backdrop import caption_of_bands, caption_of_missing, caption_of_walls
from gapsweep.report.branch_lines import caption as caption_of_branches
from gapsweep.report.branch_lines import of_scene
from gapsweep.report.drawing import caption_of_peaks
from gapsweep.report.figures import attractors as attractors_figure
from gapsweep.report.figures import bifurcation, frequency_response, maps, special_curves
from gapsweep.report.inputs import Inputs
from gapsweep.report.maps import MapImage, numbered_as, numeric_axes, on_grid, picture
from gapsweep.report.parts import Figured, Part
from gapsweep.report.scales import long_name, named, shown_unit
from gapsweep.report.selection import places
from gapsweep.report.tables import number, scene_tables, special_points
from gapsweep.status import Status
from gapsweep.study.grid import COORDINATE

MOST_SCENES, MOST_POINTS = 16, 200_000
_SEPARATE = ("K_c", "gap")  # parameters whose sets have separate sections
_START = SWEPT[1]
_STATE = ("x_0", "v_0")
_FEW_STARTS = 500
_OF_ATTRACTORS = ("x_max", "basin_share", "response_class")
_LEAST = 5  # values of an axis of a map; with fewer, every value has curves
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


def is_wide(responses: xr.Dataset) -> bool:
    """Whether an overview replaces figures of every set: for systems, many sets, points or axes.

    Parameters
    ----------
    responses : Dataset
        As stored in ``responses.nc``.
    """
    asked = responses["status"].load() != Status.NOT_REQUESTED
    dims = scene_dims(asked.dims)
    return (
        not in_metres(responses)
        or any(asked.sizes[dim] > 1 for dim in dims if dim not in _SEPARATE)
        or int(asked.any(swept(asked)).sum(dims).max()) > MOST_SCENES
        or int(asked.sum([*dims, *swept(asked)]).max()) > MOST_POINTS
    )


def overview(inputs: Inputs) -> Part:
    """The section on all parameter sets, which replaces a section for each set."""
    responses, attractors, branches = inputs.responses, inputs.attractors, inputs.branches
    asked = responses["status"].load() != Status.NOT_REQUESTED
    n_points = asked.sum([dim for dim in asked.dims if dim != REPRESENTATION])
    labels = [Representation(one) for one in asked[REPRESENTATION].values[n_points.values > 0]]
    n_scenes = int(asked.any((REPRESENTATION, *swept(asked))).sum())
    axes, few = _axes(responses)
    cuts = [{axis: [i]} for axis in few for i in range(responses.sizes[axis])] or [{}]
    names, one_by_one = ([long_name(responses[axis]) for axis in some] for some in (axes, few))
    both = " and ".join(names)
    each = f", for each of {len(cuts)} values of {one_by_one[0]}" if few else ""
    others = {REPRESENTATION, _START, *axes, *few}
    is_part = any(size > 1 for dim, size in asked.sizes.items() if dim not in others)
    of_all = ", with all other parameters at one value" if is_part else ""
    is_one_line = len(axes) == 1 and not few and not is_part
    sentence = (
        f"{n_scenes} parameter set{'s' * (n_scenes > 1)} with {int(n_points.sum())} sweep points"
        f"{': figures over ' * bool(names)}{both}{each}{of_all}. "
        "ds.gapsweep.map() and bifurcation() draw others."
    )
    n_of_each = asked.any(swept(asked)).sum(scene_dims(asked.dims)).sel({REPRESENTATION: labels})
    is_alike = bool((n_of_each == n_scenes).all())
    over = f", median over {'' if is_alike else 'the computed ones of '}{n_scenes} parameter sets"
    over = over if n_scenes > 1 else ""
    plain = [label for label in labels if not label.protocol] or labels
    title = "All parameter sets" if n_scenes > 1 else "Results"
    return Part(
        "overview",
        f"{title} over {both}" if both else title,
        [sentence],
        [
            *scene_tables(inputs.agreement, inputs.timing, labels, over, _apart(asked, n_scenes)),
            *(special_points(branches, responses, axes[0]) if is_one_line else []),
            *(special_points(inputs.curves, responses, axes[0]) if is_one_line else []),
        ],
        (
            figure
            for label in plain
            if axes
            for cut in cuts
            if asked.isel(cut).sel({REPRESENTATION: label}).any()
            for figure in _figures(
                responses.isel(cut),
                None if attractors is None else attractors.isel(cut, missing_dims="ignore"),
                inputs,
                asked.isel(cut),
                label,
                axes,
            )
        ),
    )


def _apart(asked: xr.DataArray, n_scenes: int) -> list[tuple[str, At]]:
    """Words and position of each parameter set, if they are few enough to be listed."""
    if not 1 < n_scenes <= MOST_SCENES:
        return []
    dims = [dim for dim in scene_dims(asked.dims) if asked.sizes[dim] > 1]
    found: list[tuple[str, At]] = []
    for at in scenes(asked.to_dataset(name="asked"), dims):
        here = asked.isel(at)
        if here.any():
            found.append(("".join(f", {named(here[dim])}" for dim in dims), at))
    return found


def _axes(responses: xr.Dataset) -> tuple[list[str], list[str]]:
    """Axes of the figures, frequency first, and the axis with a figure for each value.

    The axes are the two longest ones; if the second has few values, the longest one, with a figure
    for each value of the second. Without a second axis, the plane of many initial conditions.
    """
    axes = numeric_axes(responses["status"].to_dataset())[:2]
    if len(axes) < 2 and responses.sizes[_START] > _FEW_STARTS and (plane := plane_of(responses)):
        return plane, []
    few = axes[1:] if len(axes) > 1 and responses.sizes[axes[1]] < _LEAST else []
    drawn = [axis for axis in axes if axis not in few]
    return sorted(drawn, key=lambda axis: axis != "omega"), few


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
    return list(_STATE) if min(sizes.values()) >= _LEAST else []


def _figures(
    responses: xr.Dataset,
    attractors: xr.Dataset | None,
    inputs: Inputs,
    asked: xr.DataArray,
    label: str,
    axes: list[str],
) -> Iterator[Figured]:
    """Figures of a representation, with other parameters at the values with the most points."""
    at = _most(asked, label, [_START] if axes[0] in _STATE else axes)
    here = responses.isel(at)
    found = None if attractors is None else attractors.isel(at, missing_dims="ignore")
    n_starts = responses.sizes[_START]
    is_one = n_starts > 1 and here[_START].ndim == 0
    start = f", {_start_in_words(here)} of {n_starts}" if is_one else ""
    where = ", ".join([label, *_where(responses, here)])
    if len(axes) > 1:
        exact = responses[REPRESENTATION].values == EXACT
        if axes[0] in _STATE and label != EXACT and exact.any():
            here = numbered_as(here, responses.isel({**at, REPRESENTATION: int(exact.argmax())}))
        yield from _maps(here, found, axes, where + start)
        return
    for part, suffix in by_coordinate(here):
        of_part = found
        if found is not None and suffix:
            of_part = found.sel({COORDINATE: part[COORDINATE].values})
        if of_part is not None:
            of_part = of_part[list(_OF_ATTRACTORS)].load().expand_dims(REPRESENTATION)
        names = ["amplitude", "extrema", "response_class"]
        yield from along_axis(
            part[names].load().expand_dims([REPRESENTATION, _START]),
            of_part if n_starts > 1 else None,
            inputs.branches,
            axes[0],
            where + suffix + start,
            has_curve=n_starts == 1,
        )
    yield from curves_figure(inputs.curves, here.expand_dims(REPRESENTATION), axes[0], where)


def _start_in_words(here: xr.Dataset) -> str:
    kind = str(here["start"].values)
    swept_from = "" if kind == "fixed" else f" ({kind.replace('_', ' ')} over frequency)"
    return f"initial condition {int(here[_START]) + 1}{swept_from}"


def _maps(
    here: xr.Dataset, found: xr.Dataset | None, axes: list[str], where: str
) -> Iterator[Figured]:
    """Figure of maps: class, period, attractors, and the amplitude of every coordinate."""
    parts = [(here, "response_class"), (here, "period_multiple")]
    if axes[0] in _STATE:
        parts.append((here, "attractor"))
    elif found is not None:
        parts.append((found, "n_attractors"))
    amplitudes = [(part, "amplitude") for part, _ in by_coordinate(here)]
    yield from maps_of(parts + amplitudes, axes, where)


def maps_of(
    parts: Sequence[tuple[xr.Dataset, str]], axes: list[str], where: str
) -> Iterator[Figured]:
    """One figure of maps; a value that is the same everywhere is stated in its caption.

    Parameters
    ----------
    parts : sequence of (Dataset, str)
        Dataset and name of each variable.
    axes : list of str
        The horizontal and the vertical axis.
    where : str
        Representation and parameters, for the caption.
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
    has_curve: bool,
    of_starts: str = "",
    of_attractors: str = "",
) -> Iterator[Figured]:
    """Figures over one axis: amplitude, extrema, attractors.

    Parameters
    ----------
    scene : Dataset
        Responses with dimensions representation, `along`, initial_condition.
    attractors : Dataset or None
        Their attractors, with dimensions representation, `along`, attractor; None draws none.
    branches : Dataset or None
        ``branches.nc``, drawn behind the dots.
    where : str
        The parameters, in words.
    has_curve : bool
        Whether amplitudes are drawn: lines of several initial conditions cross between attractors.
    of_starts, of_attractors : str
        The initial conditions of the extrema and of the attractors, in words.
    """
    if has_curve:
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


def _most(asked: xr.DataArray, label: str, over: list[str]) -> dict[str, int]:
    """Position of a representation with the most points along the dimensions `over`."""
    r = asked[REPRESENTATION].values.tolist().index(label)
    counts = asked.isel({REPRESENTATION: r}).sum(over)
    place = np.unravel_index(int(counts.values.argmax()), counts.shape)
    return {REPRESENTATION: r} | {
        str(dim): int(i) for dim, i in zip(counts.dims, place, strict=True)
    }


def _where(responses: xr.Dataset, here: xr.Dataset) -> list[str]:
    """Parameters with one value in words, each with the number of swept values."""
    words = []
    for name in places(here):
        if here[name].ndim == 0:
            n = responses.sizes.get(name, 1)
            words.append(named(here[name]) + (f" (one of {n})" if n > 1 else ""))
    return words
