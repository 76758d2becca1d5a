"""Figures of `risk.nc`: probabilities, quantiles, and Sobol indices."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.analysis.datasets.risk import EVENT, LEVEL, NUMBER, QUANTITY, UNITS
from gapsweep.analysis.dimensions import REPRESENTATION
from gapsweep.errors import DatasetError
from gapsweep.report import marks
from gapsweep.report.labelled import axes_of, finished, scene_along, titled
from gapsweep.report.marks import Marks
from gapsweep.report.scales import axis_label, drawn
from gapsweep.report.selection import missing_variable, scene
from gapsweep.report.style import GREY, looks
from gapsweep.study.grid import START

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PROBABILITY = ("probability", "low", "high")
_BANDS = ((0.05, 0.95, 1.6, 0.45), (0.25, 0.75, 4.0, 0.45))  # levels, width, opacity
_INDICES = {"total": (9.0, 0.35), "first_order": (4.0, 1.0)}  # width, opacity
_WORDS = {"total": "total", "first_order": "without interactions"}
_INTERVAL = "95 % interval of the total"


def risk(
    dataset: xr.Dataset,
    /,
    event: str | None = None,
    *,
    along: str | None = None,
    ax: "Axes | None" = None,
    **wanted: Any,
) -> "Axes":
    """Probability of an event with its 95 % interval, a line per representation.

    Parameters
    ----------
    event : str, optional
        As in ``[[uncertain.event]]``; None: the only one.
    along : str, optional
        Horizontal axis, as ``"omega"`` or ``"gap"``; None: omega, or the longest other one.
    ax : Axes, optional
        Drawn into; new ones if None.
    **wanted
        Selection by coordinate; one stiffness and one value of every other parameter must be left.
    """
    wanted |= {} if event is None else {EVENT: event}
    shown, along = _along(dataset, along, dict.fromkeys(_PROBABILITY, ()), wanted)
    axes = axes_of(ax)
    for offset, (label, one, look) in zip(_offsets(shown, along), _laws(shown), strict=True):
        x, p, low, high = (drawn(one[name]) for name in (along, *_PROBABILITY))
        bars = _bars(x + offset, low, high, 3.0, 0.4, f"{label}, 95 % interval", look)
        marks.put(axes, [bars, marks.line(x=x, y=p, series=label, entry=label, **look)])
    name = str(shown[EVENT].item()) if EVENT in shown.coords else "event"
    axes.set(ylabel=f"probability of “{name}”", ylim=(-0.02, 1.02))
    return finished(axes, shown, along)


def quantiles(
    dataset: xr.Dataset,
    /,
    quantity: str | None = None,
    *,
    along: str | None = None,
    ax: "Axes | None" = None,
    **wanted: Any,
) -> "Axes":
    """Median of a quantity in front of bars from 5 to 95 % and from 25 to 75 % of the samples.

    Parameters
    ----------
    quantity : str, optional
        As ``"amplitude"``; None: the only one.
    along, ax, **wanted
        As for `risk`.
    """
    wanted |= {} if quantity is None else {QUANTITY: quantity}
    shown, along = _along(dataset, along, {"quantile": (LEVEL,)}, wanted)
    unit = str(shown[UNITS].item()) if UNITS in shown.coords else ""
    values = shown["quantile"].assign_attrs(units=unit) if unit else shown["quantile"]
    shown, axes = shown.assign(quantile=values), axes_of(ax)
    for offset, (label, one, look) in zip(_offsets(shown, along), _laws(shown), strict=True):
        x = drawn(one[along])
        level = {share: drawn(one["quantile"].sel({LEVEL: share})) for share in one[LEVEL].values}
        for low, high, width, opacity in _BANDS:
            series = f"{label}, {low:.0%} to {high:.0%}"
            marks.put(
                axes, [_bars(x + offset, level[low], level[high], width, opacity, series, look)]
            )
        entry = f"{label}: median; 25–75 %, 5–95 %"
        marks.put(axes, [marks.line(x=x, y=level[0.5], series=label, entry=entry, **look)])
    axes.set_ylabel(axis_label(values, str(shown[QUANTITY].item())))
    return finished(axes, shown, along)


def tornado(
    dataset: xr.Dataset,
    /,
    event: str | None = None,
    *,
    quantity: str | None = None,
    ax: "Axes | None" = None,
    **wanted: Any,
) -> "Axes":
    """Sobol indices of the uncertain numbers, the most important one at the top.

    A wide pale bar is the total index, a narrow one inside it the first index, a line the 95 %
    interval of the total index. Sobol points with an undecided sample are left out; the label of
    the axis has their number, or says that there is no variance.

    Parameters
    ----------
    event, quantity : str, optional
        One of both; None: the only event.
    ax : Axes, optional
        Drawn into; new ones if None.
    **wanted
        Selection by coordinate; one value of every dimension must be left.
    """
    own, prefix = {EVENT: event}, ""
    if quantity is not None:
        own, prefix = {QUANTITY: quantity}, "quantity_"
    wanted |= {name: value for name, value in own.items() if value is not None}
    names = [f"{prefix}{name}" for name in ("first_order", "total", "total_error")]
    if names[0] not in dataset:
        raise DatasetError(f"{missing_variable(dataset, names[0])}; write indices = true")
    left_out = f"{prefix}n_left_out"
    shown = scene(dataset, dict.fromkeys(names, (NUMBER,)) | {left_out: ()}, wanted)
    first, total, error = (shown[name].values for name in names)
    order = np.argsort(np.nan_to_num(total))
    labels, axes = shown[NUMBER].values[order], axes_of(ax)
    y = np.arange(len(order), dtype=float)
    for values, (name, (width, opacity)) in zip((total, first), _INDICES.items(), strict=True):
        ends, words = (0.0 * y, np.maximum(values[order], 0.0)), _WORDS[name]
        look = {"colour": "#0072b2", "size": width, "opacity": opacity}
        marks.put(axes, [marks.flat_bars(*ends, y, series=words, entry=words, **look)])
    ends, words = (total[order] - error[order], total[order] + error[order]), _INTERVAL
    look = {"colour": GREY, "size": 1.0, "series": words, "entry": words}
    marks.put(axes, [marks.flat_bars(*ends, y, **look)])
    axes.set_yticks(y, labels)
    n = int(shown[left_out])
    words = f"\n{n} Sobol points with an undecided sample are left out" if n else ""
    words = words if np.isfinite(total).any() else "\nthe variance is 0: all samples agree"
    axes.set(xlabel=f"share of the variance (Sobol index){words}", ylim=(-0.6, len(order) - 0.4))
    axes.set_xlim(left=0.0)
    return titled(axes, shown)


def along_of(dataset: xr.Dataset) -> str:
    """Name of the horizontal axis: omega if it has several values, else the longest axis."""
    own = (EVENT, QUANTITY, LEVEL, NUMBER, REPRESENTATION, START)
    sizes = {str(dim): n for dim, n in dataset.sizes.items() if dim not in own}
    if sizes.get("omega", 0) > 1 or not sizes:
        return "omega"
    return max(sizes, key=lambda dim: sizes[dim])


def by_wall(dataset: xr.Dataset) -> xr.Dataset:
    """A dataset in which the axis of gaps holds the distances of the upper wall, ascending."""
    if "gap" not in dataset.dims:
        return dataset
    return dataset.swap_dims(gap="j_2").sortby("j_2").reset_coords("gap", drop=True)


def _along(
    dataset: xr.Dataset,
    along: str | None,
    names: Mapping[str, tuple[str, ...]],
    wanted: dict[str, Any],
) -> tuple[xr.Dataset, str]:
    """The variables over representation, an axis and their own dimensions, and that axis."""
    along = along or along_of(dataset)
    if along == "gap" or along == "j_2":
        dataset, along = by_wall(dataset), "j_2"
    needed = {name: (REPRESENTATION, *dims) for name, dims in names.items()}
    return scene_along(dataset, along, needed, wanted), along


def _laws(shown: xr.Dataset) -> Iterator[tuple[str, xr.Dataset, dict[str, Any]]]:
    """Label, part and style of every representation."""
    labels: Sequence[str] = np.atleast_1d(shown[REPRESENTATION].values).tolist()
    for label, look in looks(labels).items():
        style = {"colour": look.colour, "dashes": look.dashes, "size": 1.2, "dots": 3.0}
        yield label, shown.sel({REPRESENTATION: label}), style | {"marker": look.marker}


def _offsets(shown: xr.Dataset, along: str) -> NDArray[np.float64]:
    """Offsets of the bars of representations from their place, so that none hides another."""
    x, n = np.sort(drawn(shown[along])), np.size(shown[REPRESENTATION])
    apart = 0.04 * float(np.diff(x).min()) if x.size > 1 else 0.0
    return np.asarray(apart * (np.arange(n) - 0.5 * (n - 1)))


def _bars(
    x: NDArray[Any], low: Any, high: Any, size: float, opacity: float, series: str, look: Any
) -> Marks:
    style = {"colour": look["colour"], "size": size, "opacity": opacity, "series": series}
    return marks.bars(x, low, high, zorder=1.5, **style)
