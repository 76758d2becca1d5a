"""Figures of contacts: impact speeds, and the walls that responses touch."""

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from gapsweep.analysis.dimensions import Array, selected
from gapsweep.errors import DatasetError
from gapsweep.integrate.trajectory import Trajectory
from gapsweep.report import losses, maps
from gapsweep.report.continued import motions, number_of, weights
from gapsweep.report.dynamics import CURVES, dots
from gapsweep.report.labelled import axes_of, axis_of, scene_along, titled
from gapsweep.report.scales import axis_label
from gapsweep.report.selection import missing_variable, too_many
from gapsweep.response.absolute import N_PERIODS
from gapsweep.study.grid import CONTACT, START

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_HELD = 1e-9  # of the largest impact speed: the end of a hold
_TOUCHED = "walls_touched"
_KINDS = "no_wall lower_wall upper_wall both_walls always_on_lower_wall always_on_upper_wall"


def impacts(
    dataset: xr.Dataset,
    /,
    n_periods: int = N_PERIODS,
    *,
    along: str | None = None,
    ax: "Axes | None" = None,
    **wanted: Any,
) -> "Axes":
    """Speed [m/s] of every impact of the steady responses over a parameter.

    Files hold no impact speeds: every response is simulated from its first section point. An impact
    is the passage of a wall outwards; its speed is the relative velocity at the contact there.

    Parameters
    ----------
    dataset : Dataset
        ``responses.nc``, or a part of it with the full state.
    n_periods : int
        Forcing periods of responses that are not periodic; others take one of their periods.
    along, ax, **wanted
        As for `GapsweepAccessor.frequency_response`; for systems with several contacts, `contact`
        must select one.
    """
    along = axis_of(dataset, along, wanted)
    needed = {"force_max": CURVES, "response_class": CURVES}  # force_max requires one contact
    shown = scene_along(dataset, along, needed, wanted)
    dims = ("representation", along, START)
    found = {at: _impacts(run, shown) for at, run in motions(dataset, dims, wanted, n_periods)}
    sizes = [shown.sizes[dim] for dim in dims]
    speeds = np.full((*sizes, max([1, *map(len, found.values())])), np.nan)
    for at, each in found.items():
        speeds[at][: len(each)] = each
    velocity = dataset["section_v"].attrs.get("units", "")
    about = {"long_name": "impact speed", "units": velocity}
    shown = shown.assign(impact_speed=((*dims, "impact"), speeds, about))
    label = axis_label(shown["impact_speed"])
    axes = dots(axes_of(ax), shown, "impact_speed", along, label)
    axes.set_ylim(bottom=0.0)
    return axes


def _impacts(run: Trajectory, shown: xr.Dataset) -> Array:
    """Speeds at which a motion passes the walls of a contact outwards, or meets rigid ones."""
    number = number_of(shown, CONTACT)
    law, times = run.laws[number], losses.times_of(run)[number]
    if not len(times):
        return np.empty(0)
    if law.losses.is_rigid:
        speeds = np.abs(losses.before_impacts(run, number))
        return np.asarray(speeds[speeds > _HELD * speeds.max()])
    along = weights(run, shown, "contact_section_x")
    x, v = (each.reshape(len(times), -1) @ along for each in run.sample(times)[:2])
    is_upper = (x > 0.5 * (law.gap.j_2 - law.gap.j_1)) == (law.gap.width >= 0.0)
    return np.asarray(np.abs(v[np.where(is_upper, v > 0.0, (v < 0.0) & (law.K_ratio > 0.0))]))


def contact_map(
    dataset: xr.Dataset,
    /,
    x: str = "omega",
    y: str | None = None,
    *,
    ax: "Axes | None" = None,
    **wanted: Any,
) -> "Axes":
    """Map of the walls that each steady response touches, over two parameters.

    Computed from the stored extrema of the relative displacement: no wall (free motion within the
    freeplay), one, both, or never off one of them (no loss of contact). ``map("contact_share")``
    has the share of the time beyond the walls.

    Parameters
    ----------
    dataset : Dataset
        ``responses.nc``, or a part of it.
    x, y, ax, **wanted
        As for `GapsweepAccessor.map`; for systems with several contacts, `contact` must select
        one.
    """
    part = selected(dataset, wanted)
    if CONTACT in part.dims:
        raise DatasetError(too_many(part, CONTACT))
    names = ("contact_x_min", "contact_x_max") if "contact_x_max" in part else ("x_min", "x_max")
    for name in names:
        if name not in part:
            raise DatasetError(missing_variable(part, name))
    (lower, upper), factor = _walls(part)
    ends = xr.concat([factor * part[name] for name in names], "end")
    low, high = ends.min("end", skipna=False), ends.max("end", skipna=False)
    kind: Any = (low <= -lower) + 2 * (high >= upper)  # motions end on rigid walls
    kind = kind.where(high >= -lower, 4).where(low <= upper, 5).where(low.notnull(), -1)
    about = {"flag_values": np.arange(6, dtype="i1"), "flag_meanings": _KINDS}
    kind.attrs = {"long_name": "walls touched", "units": "1", **about}
    part = part.assign({_TOUCHED: kind.astype("i1", keep_attrs=True)})
    picture, shown = maps.picture(part, _TOUCHED, x, y, {})
    axes = axes_of(ax)
    maps.draw(axes, picture)
    return titled(axes, shown)


def _walls(part: xr.Dataset) -> tuple[list[Any], float]:
    """Distances of the lower and upper wall, and the factor of the stored displacement."""
    own, factor = dict[str, Any](), 1.0
    if "system_json" in part.attrs:
        contacts = json.loads(part.attrs["system_json"])["contacts"]
        name = part[CONTACT].item() if CONTACT in part.coords else next(iter(contacts))
        own = json.loads(part.attrs["study_json"]).get("contact", {}).get(name, {})
        factor = 1.0 if "contact_x_max" in part else float(contacts[name][0])
    lower, upper = own.get("gap") or (part["j_1"], part["j_2"])
    ratio = own.get("K_ratio")
    if ratio is None:
        ratio = part.coords.get("K_ratio", 1.0)
    none = np.inf * (xr.DataArray(ratio) == 0.0)
    return [lower + none.where(none > 0.0, 0.0), upper], factor  # no stiffness: no wall
