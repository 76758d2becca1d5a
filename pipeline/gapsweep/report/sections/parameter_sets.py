"""Sections of the report on each parameter set: outcomes, agreement, cost and figures."""

from collections.abc import Iterator

import xarray as xr

from gapsweep.analysis.dimensions import At, scene_dims
from gapsweep.analysis.dimensions import scenes as all_scenes
from gapsweep.model.labels import EXACT
from gapsweep.report.captioned import along_axis, curves_figure, maps_of, plane_of
from gapsweep.report.drawing import labels_of
from gapsweep.report.inputs import Inputs
from gapsweep.report.maps import numbered_as
from gapsweep.report.parts import Figured, Part
from gapsweep.report.scales import named, plain
from gapsweep.report.scenes import Scenes, caption_of_starts, swept
from gapsweep.report.sections.findings import outcomes
from gapsweep.report.selection import anchor_of, gap_label, other_parameters
from gapsweep.report.tables import scene_tables, special_points
from gapsweep.status import Status

_FEW = 5  # frequencies, which a caption names


def sections(inputs: Inputs) -> Iterator[Part]:
    """A section for each computed parameter set."""
    responses, agreement = inputs.responses, inputs.agreement
    scenes = Scenes(responses)
    for at in all_scenes(responses, scene_dims(responses["status"].dims)):
        here = scenes.at(at)
        if here is None:
            continue
        title, drawn = title_of(here), _without_protocols(here)
        compared = None if agreement is None else agreement.isel(at)
        yield Part(
            anchor_of(at),
            title,
            [outcomes(here)],
            [
                *scene_tables(compared, inputs.timing.isel(at), labels_of(here)),
                *special_points(inputs.branches, here, "omega"),
                *special_points(inputs.curves, here, "omega"),
            ],
            _basins(drawn, plane, title)
            if drawn.sizes["omega"] == 1 and (plane := plane_of(drawn))
            else _over_frequency(inputs, drawn, at, title),
        )


def title_of(scene: xr.Dataset) -> str:
    """Title of a parameter set: its values in words."""
    others = [named(scene[name]) for name in other_parameters(scene)]
    return ", ".join([named(scene["K_c"]), f"gap {gap_label(scene)} mm", *others])


def _basins(scene: xr.Dataset, plane: list[str], title: str) -> Iterator[Figured]:
    """Maps of every law over the plane of initial conditions at the only frequency."""
    at_once = scene.isel(omega=0)
    exact = at_once.sel(representation=EXACT) if EXACT in labels_of(scene) else None
    for label in labels_of(scene):
        one, where = at_once.sel(representation=label), f"{title}, {named(scene['omega'][0])}"
        if exact is not None and label != EXACT:
            one = numbered_as(one, exact)
        yield from maps_of([(one, "attractor"), (one, "x_max")], plane, f"{label}, {where}")


def _over_frequency(inputs: Inputs, scene: xr.Dataset, at: At, title: str) -> Iterator[Figured]:
    """Figures of all laws over frequency; without attractors, amplitudes are drawn as lines."""
    attractors = _several(inputs.attractors, scene, at)
    yield from along_axis(
        scene, attractors, inputs.branches, "omega", title, of_starts=caption_of_starts(scene),
        of_attractors="" if attractors is None else _where_few(attractors, scene),
    )  # fmt: skip
    yield from curves_figure(inputs.curves, scene, "omega", title)


def _several(attractors: xr.Dataset | None, scene: xr.Dataset, at: At) -> xr.Dataset | None:
    """Attractors of a parameter set at frequencies with several initial conditions, or None."""
    several = (scene["status"] != Status.NOT_REQUESTED).sum("initial_condition") > 1
    if attractors is None or not several.any():
        return None
    names = ["x_max", "basin_share", "response_class"]
    found = attractors[names].isel(at).load()
    here = several.any("omega")
    return found.sel(
        representation=scene["representation"].values[here.values],
        omega=scene["omega"].values[several.any("representation").values],
    )


def _where_few(found: xr.Dataset, scene: xr.Dataset) -> str:
    """Caption words for up to 5 frequencies with several initial conditions; empty for more."""
    omega = found["omega"].values
    if omega.size > min(_FEW, scene.sizes["omega"] - 1):
        return ""
    return f" (from several initial conditions at {', '.join(map(plain, omega))} Hz only)"


def _without_protocols(scene: xr.Dataset) -> xr.Dataset:
    """The parameter set without protocols such as ``@half``; with them if all laws have one."""
    plain = [i for i, label in enumerate(labels_of(scene)) if not label.protocol]
    return swept(scene.isel(representation=plain)) if plain else scene
