"""One section of the report in place of one per parameter set, if there are too many sets.

Figures are over two axes, with all other parameters at one value, so that neither the page nor the
memory grows with the number of sets: meshes over two long axes; curves over one axis, or for each
of a few values of the second.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import xarray as xr

from gapsweep.analysis.agreement.law_tables import NONE as NO_CLASS
from gapsweep.analysis.dimensions import (
    REPRESENTATION,
    SWEPT,
    At,
    by_coordinate,
    of_oscillator,
    scene_dims,
    scenes,
    swept,
)
from gapsweep.model.labels import EXACT, Representation
from gapsweep.report.captioned import LEAST, STATE, along_axis, curves_figure, maps_of, plane_of
from gapsweep.report.inputs import Inputs
from gapsweep.report.maps import numbered_as, numeric_axes
from gapsweep.report.parts import Figured, Part
from gapsweep.report.scales import long_name, named
from gapsweep.report.selection import places
from gapsweep.report.tables import scene_tables, special_points
from gapsweep.response.result import ResponseClass
from gapsweep.status import Status
from gapsweep.study.grid import COORDINATE

MOST_SCENES, MOST_POINTS = 16, 200_000
_SEPARATE = ("K_c", "gap")  # parameters whose sets have separate sections
_START = SWEPT[1]
_FEW_STARTS = 500
_OF_ATTRACTORS = ("x_max", "basin_share", "response_class")


def is_wide(responses: xr.Dataset) -> bool:
    """Whether an overview replaces figures of every set: for systems, many sets, points or axes.

    `responses`: as stored in ``responses.nc``.
    """
    asked = responses["status"].load() != Status.NOT_REQUESTED
    dims = scene_dims(asked.dims)
    return (
        not of_oscillator(responses)
        or any(asked.sizes[dim] > 1 for dim in dims if dim not in _SEPARATE)
        or int(asked.any(swept(asked)).sum(dims).max()) > MOST_SCENES
        or int(asked.sum([*dims, *swept(asked)]).max()) > MOST_POINTS
    )


def sections(inputs: Inputs) -> Iterator[Part]:
    """The section on all parameter sets, which replaces a section for each set."""
    responses = inputs.responses
    asked = responses["status"].load() != Status.NOT_REQUESTED
    n_scenes = int(asked.any((REPRESENTATION, *swept(asked))).sum())
    of_law = asked.any(swept(asked)).sum(scene_dims(asked.dims))  # parameter sets of each law
    labels = [Representation(one) for one in asked[REPRESENTATION].values[of_law.values > 0]]
    axes, few = _axes(responses)
    shown = {REPRESENTATION, _START, *axes, *few}
    is_cut = any(size > 1 for dim, size in asked.sizes.items() if dim not in shown)
    cuts = [{axis: [i]} for axis in few for i in range(responses.sizes[axis])] or [{}]
    is_alike = bool((of_law.sel({REPRESENTATION: labels}) == n_scenes).all())
    sets = f"{'' if is_alike else 'the computed ones of '}{n_scenes} parameter sets"
    over = f", median over {sets}" * (n_scenes > 1)
    lines = [] if few or is_cut or len(axes) != 1 else [inputs.branches, inputs.curves]
    names = " and ".join(long_name(responses[axis]) for axis in axes)
    title = "All parameter sets" if n_scenes > 1 else "Results"
    yield Part(
        "overview",
        f"{title} over {names}" if names else title,
        [_words(responses, asked, n_scenes, names, few, is_cut=is_cut)],
        [
            *scene_tables(inputs.agreement, inputs.timing, labels, over, _apart(asked, n_scenes)),
            *(table for found in lines for table in special_points(found, responses, axes[0])),
        ],
        (
            figure
            for label in [label for label in labels if not label.protocol] or labels
            if axes
            for cut in cuts
            if asked.isel(cut).sel({REPRESENTATION: label}).any()
            for figure in _figures(_cut_out(inputs, cut), asked.isel(cut), label, axes)
        ),
    )


def _cut_out(inputs: Inputs, cut: Mapping[str, list[int]]) -> Inputs:
    """The inputs with a part of the responses and attractors."""
    found = inputs.attractors
    return replace(
        inputs,
        responses=inputs.responses.isel(cut),
        attractors=None if found is None else found.isel(cut, missing_dims="ignore"),
    )


def _words(
    responses: xr.Dataset, asked: xr.DataArray, n_scenes: int, names: str, few: list[str],
    *, is_cut: bool,
) -> str:  # fmt: skip
    """Sentence on the numbers of parameter sets and points, and on what the figures show."""
    n_points = int(asked.sum())
    each = "".join(
        f", for each of {responses.sizes[axis]} values of {long_name(responses[axis])}"
        for axis in few
    )
    rest = ", at those values of other parameters that have most chaos and most attractors" * is_cut
    return (
        f"{n_scenes} parameter set{'s' * (n_scenes > 1)} with {n_points} sweep points"
        f"{': figures over ' * bool(names)}{names}{each}{rest}. "
        "ds.gapsweep.map() and bifurcation() draw others."
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
    few = axes[1:] if len(axes) > 1 and responses.sizes[axes[1]] < LEAST else []
    drawn = [axis for axis in axes if axis not in few]
    return sorted(drawn, key=lambda axis: axis != "omega"), few


def _figures(inputs: Inputs, asked: xr.DataArray, label: str, axes: list[str]) -> Iterator[Figured]:
    """Figures of a representation, with other parameters at the values with the most points.

    Among equals they are those at which most responses of the exact law are not periodic or
    coexist.
    """
    responses, attractors = inputs.responses, inputs.attractors
    at = _most(asked, label, [_START] if axes[0] in STATE else axes, _interesting(inputs))
    here = responses.isel(at)
    found = None if attractors is None else attractors.isel(at, missing_dims="ignore")
    n_starts = responses.sizes[_START]
    is_one = n_starts > 1 and here[_START].ndim == 0
    start = f", {_start_in_words(here)} of {n_starts}" if is_one else ""
    where = ", ".join([label, *_where(responses, here)])
    if len(axes) > 1:
        exact = responses[REPRESENTATION].values == EXACT
        if axes[0] in STATE and label != EXACT and exact.any():
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
        has_attractors = of_part is not None and n_starts > 1
        yield from along_axis(
            part[names].load().expand_dims([REPRESENTATION, _START]),
            of_part if has_attractors else None,
            inputs.branches,
            axes[0],
            where + suffix + start * (not has_attractors),
            of_starts=start.replace(",", " from", 1) * has_attractors,
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
    if axes[0] in STATE:
        parts.append((here, "attractor"))
    elif found is not None:
        parts.append((found, "n_attractors"))
    amplitudes = [(part, "amplitude") for part, _ in by_coordinate(here)]
    yield from maps_of(parts + amplitudes, axes, where)


def _interesting(inputs: Inputs) -> xr.DataArray:
    """Mask of the points at which the exact law is not periodic, or has several attractors.

    If the exact law was not computed, the first law replaces it.
    """
    labels = inputs.responses[REPRESENTATION].values.tolist()
    law = {REPRESENTATION: labels.index(EXACT) if EXACT in labels else 0}
    known = (ResponseClass.PERIODIC, ResponseClass.FAILED, NO_CLASS)
    found = ~inputs.responses["response_class"].isel(law).isin(known)
    if inputs.attractors is not None:
        found = found | (inputs.attractors["n_attractors"].isel(law) > 1)
    return found.drop_vars(REPRESENTATION)


def _most(
    asked: xr.DataArray, label: str, over: list[str], interesting: xr.DataArray
) -> dict[str, int]:
    """Position of a representation with the most points along the dimensions `over`.

    Among equals it is the one with most `interesting` points.
    """
    r = asked[REPRESENTATION].values.tolist().index(label)
    of_law = asked.isel({REPRESENTATION: r})
    counts = of_law.sum(over) + (of_law & interesting).sum(over) / (1.0 + of_law.size)
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
