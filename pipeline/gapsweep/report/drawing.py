"""Functions that draw into given axes, for the report's figures and the accessor.

Every function takes matplotlib axes and a dataset that holds the dimensions it names. matplotlib
itself comes with the axes, so that importing this module is cheap.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.analysis.agreement.jumps import breaks
from gapsweep.model.labels import EXACT, Representation
from gapsweep.report.scales import drawn, shown_unit
from gapsweep.report.style import WALL, by_colour, colour, lines
from gapsweep.response.result import ResponseClass
from gapsweep.status import Status

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MANY = 60  # points; more are rasterized, to limit the size of the file
_SPARE = 0.5  # room around the exact law, in widths of its range
_DOT = 12.0  # points², dot of an attractor with an unknown basin share


def labels_of(dataset: xr.Dataset) -> list[Representation]:
    """Representations of a dataset."""
    return [Representation(label) for label in dataset["representation"].values]


SETS = "sets_axis"
MARKERS = ("o", "s", "^", "D", "v")
DOTS = (".", "x", "+", "1", "2")  # markers of many points, one for each representation of a colour
_ERRORS = (1e-14, 1e2)
# Variables of a work-precision diagram.
WORK_PRECISION = (
    *("total_error", "cpu_time", "cpu_time_q25", "cpu_time_q75"),
    *("model_error", "status", "on_front", "at_reference_floor"),
)


def curves(
    axes: "Axes", variable: xr.DataArray, along: str, kinds: xr.DataArray | None = None
) -> None:
    """Draw a curve per representation and initial state, broken at jumps; the exact law thick.

    Parameters
    ----------
    variable : DataArray
        Dimensions representation, `along`, initial_condition.
    kinds : DataArray, optional
        The ``response_class`` of each value; unresolved responses set no axis.
    """
    setting = variable.notnull() if kinds is None else sets_axis(variable, kinds)
    x = drawn(variable[along])
    labels = [str(label) for label in variable["representation"].values]
    styles = lines(labels)
    for label in labels:
        order = ("initial_condition", along)
        y = drawn(variable.sel(representation=label).transpose(*order))
        if not np.isfinite(y).any():
            continue
        sets = setting.sel(representation=label).transpose(*order).values
        exact = label == EXACT
        for start, curve in enumerate(y):
            # Dots show the frequencies of an initial condition, which may be every second one.
            there = np.isfinite(curve)
            gaps = breaks(curve[there])
            _line(
                axes,
                np.insert(x[there], gaps, np.nan),
                np.insert(curve[there], gaps, np.nan),
                np.insert(sets[start, there], gaps, False),
                linestyle=styles[label],
                color=colour(label),
                label=label if start == 0 else f"_{label}",  # one legend entry per law
                linewidth=2.2 if exact else 1.2,
                zorder=1 if exact else 2,
                marker=".",  # shows single values between two jumps
                markersize=5 if exact else 3,
            )


def extrema(
    axes: "Axes", one: xr.Dataset, along: str, *, other: str | None = None, marker: str = "."
) -> None:
    """Draw all steady extrema of one representation as dots.

    Parameters
    ----------
    one : Dataset
        ``extrema(along, initial_condition, extremum)``, ``response_class`` and `SETS`.
    other : str, optional
        Colour of responses that are not periodic; None: the colour of the representation.
    marker : str
        Symbol of matplotlib.
    """
    label, own = _label(one), colour(_label(one))
    x, y = _broadcast(one, "extrema", along)
    kinds = one["response_class"].transpose(along, "initial_condition")
    sets = one[SETS].transpose(*kinds.dims, ...).values
    periodic = (kinds.values == ResponseClass.PERIODIC)[..., None]
    for chosen, shade, kind in (
        (periodic, own, "periodic"),
        (~periodic, other or own, "not periodic"),
    ):
        shown = chosen & np.isfinite(y)
        look = {"color": shade, "marker": marker, "markersize": 2.5, "label": f"_{label}, {kind}"}
        _points(axes, x[shown], y[shown], sets[shown], **look)


def peaks(
    axes: "Axes",
    one: xr.Dataset,
    size: float,
    low: float = -np.inf,
    high: float = np.inf,
    *,
    along: str = "omega",
) -> None:
    """Draw peaks of one representation: periodic opaque, others pale, triangles at the frame.

    Parameters
    ----------
    one : Dataset
        ``x_max(along, initial_condition)``, ``response_class`` and `SETS`.
    size : float
        Diameter [points].
    low, high : float
        Edges of the frame.
    """
    label = _label(one)
    places, height = _broadcast(one, "x_max", along)
    kinds = one["response_class"].transpose(along, "initial_condition")
    sets = one[SETS].transpose(*kinds.dims).values
    periodic = kinds.values == ResponseClass.PERIODIC
    below, above = height < low, height > high
    style = {"color": colour(label), "marker": "o", "markersize": size, "markeredgewidth": 0.0}
    for where, alpha, kind in ((~periodic, 0.35, "not periodic"), (periodic, 1.0, "periodic")):
        shown = where & np.isfinite(height) & ~below & ~above
        style["label"] = f"_{label}, {kind}"
        _points(axes, places[shown], height[shown], sets[shown], alpha=alpha, **style)
    outside(axes, places[below], low, "v", label)
    outside(axes, places[above], high, "^", label)


def caption_of_marks(figure: "Figure") -> str:
    """Caption sentences on pale dots and triangles, with leading blanks; empty without any."""
    lines = [line for axes in figure.axes for line in axes.lines]
    labels = {str(line.get_label()) for line in lines if np.size(line.get_xdata())}
    kinds = {
        "not periodic": " Pale: not periodic.",
        "outside": " Triangles: outside the axes.",
    }
    return "".join(v for kind, v in kinds.items() if any(name.endswith(kind) for name in labels))


def frame(scene: xr.Dataset, lowest: str, exact: str) -> tuple[float, float]:
    """Limits of a common axis: range of the exact law, extended by up to half of it for others.

    Parameters
    ----------
    lowest : str
        The variable of the lower limit; ``x_max`` is the variable of the upper limit.
    exact : str
        The exact law's label.
    """
    bottom, top = (
        drawn(scene[name].where(sets_axis(scene[name], scene["response_class"])))
        for name in (lowest, "x_max")
    )
    is_exact = scene["representation"].values == exact
    if not np.isfinite(top[is_exact]).any():
        is_exact[:] = True
    low, high = np.nanmin(bottom, initial=np.inf), np.nanmax(top, initial=-np.inf)
    if not low <= high:  # without any result
        return -1.0, 1.0
    own_low, own_high = np.nanmin(bottom[is_exact]), np.nanmax(top[is_exact])
    spare = _SPARE * (own_high - own_low)
    low, high = max(low, own_low - spare), min(high, own_high + spare)
    margin = 0.06 * (high - low) or 1.0
    return float(low - margin), float(high + margin)


def outside(axes: "Axes", omega: Any, edge: float, marker: str, label: str) -> None:
    """Draw triangles on the edge of the frame for points beyond it."""
    if len(omega):
        edges = np.full(len(omega), edge)
        look: dict[str, Any] = {"color": colour(label), "label": f"_{label}, outside"}
        axes.plot(omega, edges, marker, markersize=2.5, clip_on=False, **look)


def attractor_peaks(axes: "Axes", one: xr.Dataset, along: str) -> None:
    """Draw the peak of every attractor of one representation; dot area grows with basin share.

    Parameters
    ----------
    one : Dataset
        ``x_max(along, attractor)``, ``basin_share`` and ``response_class``.
    """
    order = (along, "attractor")
    height = drawn(one["x_max"].transpose(*order))
    x = np.broadcast_to(drawn(one[along])[:, None], height.shape)
    share = one["basin_share"].transpose(*order).values
    # Attractors that only sweeps reach have no share: a dot of fixed size.
    area = np.where(np.isfinite(share), 4.0 + 20.0 * share, _DOT)
    periodic = one["response_class"].transpose(*order).values == ResponseClass.PERIODIC
    label, shade = _label(one), colour(_label(one))
    for where, face, kind in ((periodic, shade, "periodic"), (~periodic, "none", "not periodic")):
        shown = where & np.isfinite(height)
        axes.scatter(
            x[shown],
            height[shown],
            area[shown],
            facecolors=face,
            edgecolors=shade,
            linewidths=0.8,
            rasterized=bool(shown.sum() > MANY / 4),  # each dot is a separate path
            label=f"_{label}, {kind}",
        )


def caption_of_peaks(found: xr.Dataset) -> str:
    """Caption sentence on the dots of attractors, with a leading blank, or empty."""
    has_peak = np.isfinite(found["x_max"].values)
    kinds = {*np.unique(found["response_class"].values[has_peak]).tolist()}
    rest = " or in equilibrium" if ResponseClass.EQUILIBRIUM in kinds else ""
    words = []
    if np.isfinite(found["basin_share"].values).any():
        words.append("Dot area: share of the initial conditions that lead to the attractor")
    if kinds - {ResponseClass.PERIODIC}:
        words.append(f"{'hollow' if words else 'Hollow'}: not periodic{rest}")
    return f" {'; '.join(words)}." if words else ""


def sections(axes: "Axes", one: xr.Dataset) -> None:
    """Draw the stroboscopic section of every attractor in the phase plane.

    Parameters
    ----------
    one : Dataset
        ``section_x(attractor, section_point)``, ``section_v``, ``period_multiple``, ``x_max``.
    """
    order = ("attractor", "section_point")
    x, v = (drawn(one[name].transpose(*order)) for name in ("section_x", "section_v"))
    names = attractor_names(one["period_multiple"], one["x_max"])
    shades = _shades(len(names))
    for n, name in enumerate(names):
        if np.isfinite(x[n]).any():
            axes.plot(x[n], v[n], "o", color=shades(n), markersize=4, label=name)


def starts(axes: "Axes", one: xr.Dataset) -> None:
    """Draw fixed initial conditions in the colour of their attractor; a cross without attractor.

    Parameters
    ----------
    one : Dataset
        ``attractor(initial_condition)``, ``period_multiple``, ``x_max``.
    """
    one = one.isel(initial_condition=np.isfinite(one["x_0"].values))
    ids = one["attractor"].values
    x, v = drawn(one["x_0"]), drawn(one["v_0"])
    shades = _shades(int(ids.max(initial=0)) + 1)
    axes.plot(x[ids < 0], v[ids < 0], "x", color="#888888", markersize=4)
    for n in np.unique(ids[ids >= 0]):
        here = ids == n
        first = one.isel(initial_condition=slice(int(np.argmax(here)), int(np.argmax(here)) + 1))
        (name,) = attractor_names(first["period_multiple"], first["x_max"])
        axes.plot(x[here], v[here], "o", color=shades(n), markersize=4, label=name)


def attractor_names(period_multiple: xr.DataArray, x_max: xr.DataArray) -> list[str]:
    """Name of each attractor: its period and peak."""
    unit = shown_unit(x_max)[1]
    pairs = zip(period_multiple.values, drawn(x_max), strict=True)
    return [f"{f'P{n}' if n else 'chaotic'}, peak {x:.4g} {unit}" for n, x in pairs]


def summary(
    axes: "Axes",
    value: xr.DataArray,
    interval: xr.DataArray | None,
    floor: xr.DataArray | None,
) -> None:
    """Draw a row per representation: number, confidence interval, and reproducibility limit.

    Parameters
    ----------
    value : DataArray
        Over representation.
    interval : DataArray, optional
        Over representation and bound.
    floor : DataArray, optional
        One number, of the exact law with other settings.
    """
    labels = [str(label) for label in value["representation"].values]
    numbers = drawn(value)
    for row, (label, number) in enumerate(zip(labels, numbers, strict=True)):
        if interval is not None:
            ends = drawn(interval.sel(representation=label))
            axes.plot(ends, [row, row], color=colour(label), linewidth=1.2)
        axes.plot([number], [row], "o", color=colour(label), markersize=5)
    if floor is not None and np.isfinite(floor):
        axes.axvline(float(drawn(floor)), **WALL, label="exact law, other settings")
    axes.set_yticks(range(len(labels)), labels)
    axes.set_ylim(len(labels) - 0.5, -0.5)


def work_precision(axes: "Axes", scene: xr.Dataset) -> None:
    """Draw cost over error of every method in one scenario, a point per tolerance.

    Parameters
    ----------
    scene : Dataset
        The variables `WORK_PRECISION`, over method and tolerance.
    """
    labels = scene["method"].values.tolist()
    styles, marks = lines(labels), by_colour(labels, MARKERS)
    axes.set_xscale("log")
    axes.set_yscale("log")
    shown = (scene["status"] == Status.OK) & (scene["at_reference_floor"] == 0)
    error = scene["total_error"].where(shown).clip(*_ERRORS)
    for label in labels:
        one, x = scene.sel({"method": label}), error.sel({"method": label}).values
        y = one["cpu_time"].values
        look: dict[str, Any] = {"color": colour(label), "linewidth": 0.9, "markersize": 3}
        look["label"] = label
        axes.plot(x, y, styles[label], marker=marks[label], markerfacecolor="white", **look)
    for label in labels:
        one, x = scene.sel({"method": label}), error.sel({"method": label}).values
        y, front = one["cpu_time"].values, one["on_front"].values.astype(bool)
        bars = np.abs(np.stack([y - one["cpu_time_q25"].values, one["cpu_time_q75"].values - y]))
        shade = colour(label)
        look = {"fmt": "none", "ecolor": shade, "elinewidth": 0.6, "alpha": 0.6}
        axes.errorbar(x, y, bars, label=f"_{label}, quartiles", **look)
        named = f"_{label}, on the front"
        axes.plot(
            x[front], y[front], marks[label], color=shade, markersize=6, zorder=4, label=named
        )
        ring: dict[str, Any] = {"markerfacecolor": "none", "markeredgecolor": "#D55E00"}
        axes.plot(x[front], y[front], "o", markersize=9, zorder=3, label=named, **ring)
        model = float(one["model_error"].max())
        if model > 0.0:
            edge: dict[str, Any] = {"ymax": 0.06, "color": shade, "linewidth": 1.4}
            axes.axvline(min(model, _ERRORS[1]), label=f"_{label}, its own error", **edge)
        failed = (one["status"] > Status.NOT_REQUESTED).values & np.isfinite(y)
        if failed.any():
            look = {"color": shade, "markersize": 5, "clip_on": False}
            look |= {"transform": axes.get_yaxis_transform(), "label": f"_{label}, failed"}
            crosses = axes.plot(np.ones(failed.sum()), y[failed], "x", **look)
            crosses[0].set_in_layout(False)
    axes.grid(which="minor", visible=False)
    failures = _failed_words(scene, labels)
    if failures:
        axes.text(0.98, 0.97, failures, transform=axes.transAxes, ha="right", va="top", fontsize=7)


def _failed_words(scene: xr.Dataset, labels: list[str]) -> str:
    """Failed methods and their status, one per line."""
    found = []
    for label in labels:
        status = np.unique(scene["status"].sel({"method": label}).values).tolist()
        words = [Status(s).label.replace("_", " ") for s in status if s > Status.NOT_REQUESTED]
        found += [f"× {label}: {word}" for word in words]
    return "\n".join(found[:4] + (["…"] if len(found) > 4 else []))


def _label(one: xr.Dataset) -> str:
    return str(one["representation"].values)


def _broadcast(one: xr.Dataset, name: str, along: str) -> Iterator[NDArray[np.float64]]:
    """Positions along the axis, and values of a variable, both of the shape of the values."""
    values = drawn(one[name].transpose(along, "initial_condition", ...))
    places = drawn(one[along]).reshape(-1, *[1] * (values.ndim - 1))
    return iter((np.broadcast_to(places, values.shape), values))


def with_setting(scene: xr.Dataset, name: str) -> xr.Dataset:
    """The parameter set with a variable `SETS`: mask of values that set the axis, for all laws."""
    return scene.assign({SETS: sets_axis(scene[name], scene["response_class"])})


def sets_axis(values: xr.DataArray, kinds: xr.DataArray) -> xr.DataArray:
    """Mask of the values that set the axis: of steady responses, or of all if none is steady.

    An unresolved motion that still grows may be larger than all steady ones.
    """
    known = values.notnull()
    steady = known & (kinds != ResponseClass.UNRESOLVED)
    return steady if steady.any() else known


def _points(
    axes: "Axes", x: NDArray[Any], y: NDArray[Any], sets: NDArray[np.bool_], **style: Any
) -> None:
    _line(axes, x, y, sets, linestyle="none", rasterized=bool(x.size > MANY), **style)


def _line(
    axes: "Axes", x: NDArray[Any], y: NDArray[Any], sets: NDArray[np.bool_], **style: Any
) -> None:
    """Draw a line; only values in `sets` set the vertical axis, others may be outside it."""
    from matplotlib.lines import Line2D

    axes.add_artist(Line2D(x, y, **style))  # unlike plot, this does not change the limits
    places = np.column_stack([x, y])
    axes.update_datalim(places, updatey=False)
    axes.update_datalim(places[sets])
    axes.autoscale_view()


def _shades(n: int) -> Any:
    from matplotlib import colormaps

    return colormaps["cividis"].resampled(max(n, 1))
