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
from gapsweep.report.style import GREY, NUMBERED, SWEEPS, WALL, colour, looks
from gapsweep.response.result import ResponseClass
from gapsweep.status import Status

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

FEW = 60  # places along an axis, up to which marks are larger
MANY = 60  # points; more are rasterized, to limit the size of the file
_SPARE = 0.5  # room around the exact law, in widths of its range
_DOT = 12.0  # points², dot of an attractor with an unknown basin share


def labels_of(dataset: xr.Dataset) -> list[Representation]:
    """Representations of a dataset."""
    return [Representation(label) for label in dataset["representation"].values]


SETS = "sets_axis"
_FIXED = "fixed"  # coordinate ``start`` of initial conditions that are not swept
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
    styles = looks(labels)
    kinds_of_start = start_kinds(variable)
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
                linestyle=styles[label].dashes,
                color=styles[label].colour,
                label=label if start == 0 else f"_{label}",  # one legend entry per law
                linewidth=2.2 if exact else 1.2,
                zorder=1 if exact else 2,
                # Shows single values between two jumps, and the direction of a sweep.
                marker=SWEEPS.get(kinds_of_start[start], "."),
                markersize=5 if exact else 3,
            )


def start_kinds(shown: Any) -> list[str]:
    """``fixed``, ``sweep_up`` or ``sweep_down`` for each initial condition."""
    kinds = shown.coords["start"].values if "start" in shown.coords else _FIXED
    names: list[str] = np.broadcast_to(kinds, shown.sizes.get("initial_condition", 1)).tolist()
    return names


def key_of_marks(shown: xr.Dataset, variable: str = "", other: str | None = None) -> list["Line2D"]:
    """Legend entries of the markers in a figure: sweeps, and responses that are not periodic.

    Parameters
    ----------
    variable : str
        What is drawn; if empty, all responses are drawn alike.
    other : str, optional
        Colour of responses that are not periodic; None: grey.
    """
    from matplotlib.lines import Line2D

    kinds = [kind for kind in SWEEPS if kind in start_kinds(shown)]
    look: dict[str, Any] = {"color": GREY, "linestyle": "none", "markersize": 4}
    entries = [Line2D([], [], **look, marker=SWEEPS[kind], label=kind) for kind in kinds]
    if variable and _not_periodic(shown[variable], shown["response_class"]):
        look |= {"color": other or GREY, "markerfacecolor": "none", "label": "not periodic"}
        entries.append(Line2D([], [], **look, marker="o"))
    return entries


def _not_periodic(values: xr.DataArray, kinds: xr.DataArray) -> bool:
    return bool(values.where(kinds != ResponseClass.PERIODIC).notnull().any())


def name_marks(axes: "Axes", *about: Any) -> None:
    """Add the entries of `key_of_marks` to the legend of the axes."""
    for entry in key_of_marks(*about):
        axes.add_artist(entry)


def extrema(
    axes: "Axes",
    one: xr.Dataset,
    along: str,
    *,
    other: str | None = None,
    marker: str = "o",
    size: float = 0.0,
) -> None:
    """Draw all steady extrema of one representation: filled if periodic, else hollow.

    Parameters
    ----------
    one : Dataset
        ``extrema(along, initial_condition, extremum)``, ``response_class`` and `SETS`.
    other : str, optional
        Colour of responses that are not periodic; None: the colour of the representation.
    marker : str
        Symbol of matplotlib for initial conditions that are not swept.
    size : float
        Diameter of filled marks [points]; hollow ones are larger. 0: by the number of places.
    """
    own, size = colour(_label(one)), size or (3.0 if one.sizes[along] <= FEW else 1.6)
    for shown, name, look in _by_mark(one, "extrema", along, marker):
        is_hollow = "markerfacecolor" in look
        look["color"] = other or own if is_hollow else own
        look |= {"markersize": size + 0.8 * is_hollow, "markeredgewidth": 0.5 * is_hollow}
        _points(axes, *shown, label=f"_{name}", **look)


def peaks(
    axes: "Axes",
    one: xr.Dataset,
    size: float,
    low: float = -np.inf,
    high: float = np.inf,
    *,
    along: str = "omega",
) -> None:
    """Draw peaks of one representation: filled if periodic, else hollow; ticks at the frame.

    Parameters
    ----------
    one : Dataset
        ``x_max(along, initial_condition)``, ``response_class`` and `SETS`.
    size : float
        Diameter [points].
    low, high : float
        Edges of the frame; a tick marks a point beyond them.
    """
    label = _label(one)
    for (x, y, sets), name, look in _by_mark(one, "x_max", along):
        inside = (y >= low) & (y <= high)
        look |= {"color": colour(label), "markersize": size, "markeredgewidth": 0.0}
        if "markerfacecolor" in look:
            look |= {"markeredgewidth": 0.5}
        _points(axes, x[inside], y[inside], sets[inside], label=f"_{name}", **look)
        outside(axes, x[y < low], low, label)
        outside(axes, x[y > high], high, label)


def _by_mark(
    one: xr.Dataset, name: str, along: str, marker: str = "o"
) -> Iterator[tuple[tuple[Any, Any, Any], str, dict[str, Any]]]:
    """Points of one representation by marker: places, values and `SETS`; name; style."""
    x, y = _broadcast(one, name, along)
    kinds = one["response_class"].transpose(along, "initial_condition")
    sets = one[SETS].transpose(*kinds.dims, ...).values
    of_start = np.array(start_kinds(one))
    rest = (...,) + (None,) * (y.ndim - 2)
    for is_periodic in (False, True):
        for kind in dict.fromkeys(of_start.tolist()):
            chosen = (kinds.values == ResponseClass.PERIODIC) == is_periodic
            shown = (chosen & (of_start == kind))[rest] & np.isfinite(y)
            parts = [_label(one), kind, "periodic" if is_periodic else "not periodic"]
            look: dict[str, Any] = {"marker": SWEEPS.get(kind, marker)}
            if not is_periodic:
                look["markerfacecolor"] = "none"
            words = ", ".join(part for part in parts if part != _FIXED)
            yield (x[shown], y[shown], sets[shown]), words, look


def caption_of_marks(figure: "Figure") -> str:
    """Caption sentences on hollow dots and ticks, with leading blanks; empty without any."""
    lines = [line for axes in figure.axes for line in axes.lines]
    labels = {str(line.get_label()) for line in lines if np.size(line.get_xdata())}
    kinds = {
        "not periodic": " Hollow: not periodic.",
        "outside": " Ticks on the frame: outside the axes.",
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


def outside(axes: "Axes", omega: Any, edge: float, label: str) -> None:
    """Draw ticks on the edge of the frame for points beyond it."""
    if len(omega):
        look: dict[str, Any] = {"color": colour(label), "label": f"_{label}, outside"}
        axes.plot(omega, np.full(len(omega), edge), "|", markersize=5, clip_on=False, **look)


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
    for n, name in enumerate(names):
        if np.isfinite(x[n]).any():
            axes.plot(x[n], v[n], "o", color=_numbered(n), markersize=4, label=name)


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
    axes.plot(x[ids < 0], v[ids < 0], "x", color=GREY, markersize=4)
    for n in np.unique(ids[ids >= 0]):
        here = ids == n
        first = one.isel(initial_condition=slice(int(np.argmax(here)), int(np.argmax(here)) + 1))
        (name,) = attractor_names(first["period_multiple"], first["x_max"])
        axes.plot(x[here], v[here], "o", color=_numbered(n), markersize=4, label=name)


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
    styles = looks(labels)
    axes.set_xscale("log")
    axes.set_yscale("log")
    shown = (scene["status"] == Status.OK) & (scene["at_reference_floor"] == 0)
    error = scene["total_error"].where(shown).clip(*_ERRORS)
    for label in labels:
        one, x = scene.sel({"method": label}), error.sel({"method": label}).values
        y, own = one["cpu_time"].values, styles[label]
        look: dict[str, Any] = {"color": own.colour, "linewidth": 0.9, "markersize": 3}
        look["label"] = label
        axes.plot(x, y, own.dashes, marker=own.marker, markerfacecolor="white", **look)
    for label in labels:
        one, x = scene.sel({"method": label}), error.sel({"method": label}).values
        y, front = one["cpu_time"].values, one["on_front"].values.astype(bool)
        bars = np.abs(np.stack([y - one["cpu_time_q25"].values, one["cpu_time_q75"].values - y]))
        shade = colour(label)
        look = {"fmt": "none", "ecolor": shade, "elinewidth": 0.6, "alpha": 0.6}
        axes.errorbar(x, y, bars, label=f"_{label}, quartiles", **look)
        named = f"_{label}, on the front"
        axes.plot(
            x[front],
            y[front],
            styles[label].marker,
            color=shade,
            markersize=6,
            zorder=4,
            label=named,
        )
        ring: dict[str, Any] = {"markerfacecolor": "none", "markeredgecolor": NUMBERED[1]}
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


def _numbered(n: int) -> str:
    """Colour of an attractor."""
    return NUMBERED[n % len(NUMBERED)]
