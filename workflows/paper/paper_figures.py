"""Figures 6 to 11 of the paper, each from a scene's dataset to a matplotlib figure."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gapsweep.model.labels import law_of
from gapsweep.report import backdrop, drawing
from gapsweep.report.drawing import MANY, labels_of
from gapsweep.report.scales import drawn
from gapsweep.report.style import NOT_PERIODIC, colour, lines
from gapsweep.status import Status

from .scenes import EXACT, NO_EVENTS
from .static_figures import WIDTH

_DOT, _REAR = 1.6, 1.8  # points; what lies behind is larger by so much
_FAR = 4.0  # peaks so many wall distances out need a logarithmic axis
SHOWN_PERIODS, _HARMONICS, _DECADES = 6, 5.5, 5

Overlay = tuple[str, str, NDArray[np.float64]]


def peak_curves(scene: xr.Dataset) -> Figure:
    """Peak displacements in a scene, a panel per law with the exact one behind it."""
    labels, scene = labels_of(scene), drawing.with_setting(scene, "x_max")
    figure, panels = _panels(scene, "peak displacement [mm]", len(labels), 3, 2.4, of_peaks=True)
    low, high = drawing.frame(scene, "x_max", _exact(scene))
    for axes, label in zip(panels, labels, strict=True):
        for one, size in {_exact(scene): _DOT + _REAR, label: _DOT}.items():
            drawing.peaks(axes, scene.sel(representation=one), size, high=high)
        _title(axes, scene.sel(representation=label))
    _scale(panels[0], scene, low, high)
    return figure


def stacked_bifurcations(scene: xr.Dataset) -> Figure:
    """All extrema in a scene from one start, a panel per law on common axes."""
    labels, omega = labels_of(scene), drawn(scene["omega"])
    figure, panels = _panels(scene, "steady extrema [mm]", len(labels), 1, 1.35)
    low, high = drawing.frame(scene, "x_min", _exact(scene))
    for axes, label in zip(panels, labels, strict=True):
        one = scene.sel(representation=label)
        backdrop.bands(axes, one)
        _extrema(axes, one, _DOT)
        _title(axes, one)
        drawing.outside(axes, omega[drawn(one["x_max"]) > high], high, "^", label)
        drawing.outside(axes, omega[drawn(one["x_min"]) < low], low, "v", label)
    panels[0].set_ylim(low, high)
    backdrop.key_of_bands(figure, scene)
    return figure


def overlaid_bifurcations(scene: xr.Dataset, overlays: Sequence[Overlay]) -> Figure:
    """Extrema of one law over those of another, a panel per pair (figure 10).

    Each pair says which law is in front, which behind, and at which frequencies [Hz] they differ.
    """
    figure, panels = _panels(scene, "steady extrema [mm]", len(overlays), 1, 2.1)
    for axes, (front, rear, apart) in zip(panels, overlays, strict=True):
        _extrema(axes, scene.sel(representation=rear), _DOT + 1.1 * _REAR)
        _extrema(axes, scene.sel(representation=front), _DOT)
        edge = axes.get_xaxis_transform()
        axes.vlines(apart, 1.0, 1.04, NOT_PERIODIC, transform=edge, clip_on=False, label="_differ")
        axes.set_title(f"{law_of(front)} on {law_of(rear)}", fontsize=9, loc="left", pad=7)
    return figure


def histories_and_spectra(histories: xr.Dataset) -> Figure:
    """Displacement and spectrum of all laws of ``histories.nc`` overlaid, a row per history."""
    labels, n = labels_of(histories), histories.sizes["history"]
    widths = {EXACT: 3.2, NO_EVENTS: 2.0}  # what is thin lies before what is thick
    figure = Figure(figsize=(WIDTH, 0.6 + 2.6 * n), layout="constrained")
    panels = figure.subplots(n, 2, squeeze=False)
    for h, (motion, spectrum) in enumerate(panels):
        one = histories.isel(history=h)
        backdrop.walls(motion, one)
        for label, line in lines(labels).items():
            own = one.sel(representation=label)
            style = {"color": colour(label), "linewidth": widths.get(law_of(label), 0.9)}
            style["label"] = f"_{label}"
            motion.plot(*_last_periods(own), line, **style)
            multiple = own["frequency"] / one["omega"]
            spectrum.plot(multiple, drawn(own["spectrum"]), line, **style)
        top = np.nanmax(drawn(one["spectrum"]), initial=0.0) or 1.0
        motion.set(xlim=(0.0, SHOWN_PERIODS), ylabel="displacement [mm]")
        motion.set_xlabel("forcing periods")
        spectrum.set_xlabel("frequency / forcing frequency")
        limits = (top * 10.0**-_DECADES, 2.0 * top)
        spectrum.set(xlim=(0.0, _HARMONICS), ylabel="amplitude [mm]", yscale="log", ylim=limits)
        spectrum.minorticks_off()
        motion.set_title(f"{float(one['omega']):g} Hz", fontsize=9, loc="left")
    figure.legend(panels[0, 1].lines, labels, loc="outside upper center", ncols=4, fontsize=8)
    return figure


def _exact(scene: xr.Dataset) -> str:
    return next(label for label in labels_of(scene) if law_of(label) == EXACT)


def _last_periods(own: xr.Dataset) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Forcing periods from the first shown, and displacement."""
    steady = own.sel(part="steady")
    periods = steady["t"].values * float(own["omega"])
    periods = periods - (np.round(np.nanmax(periods, initial=0.0)) - SHOWN_PERIODS)
    shown = periods > -1e-9
    return periods[shown], drawn(steady["x"])[shown]


def _panels(
    scene: xr.Dataset,
    label: str,
    n: int,
    n_columns: int,
    height: float,
    *,
    of_peaks: bool = False,
) -> tuple[Figure, NDArray[np.object_]]:
    """Panels over frequency on common axes, with walls."""
    n_rows = -(-n // n_columns)
    figure = Figure(figsize=(WIDTH, 0.9 + height * n_rows), layout="constrained")
    panels = figure.subplots(n_rows, n_columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes in panels[n:]:
        axes.remove()
    for axes in panels[max(n - n_columns, 0) : n]:
        axes.xaxis.set_tick_params(labelbottom=True)
    for axes in panels[:n]:
        backdrop.walls(axes, scene, of_peaks=of_peaks)
    omega = drawn(scene["omega"])
    pad = 0.01 * float(np.ptp(omega)) or 0.5
    panels[0].set_xlim(max(0.0, omega.min() - pad), omega.max() + pad)
    figure.supxlabel("forcing frequency [Hz]", fontsize=9)
    figure.supylabel(label, fontsize=9)
    return figure, panels[:n]


def _scale(axes: Axes, scene: xr.Dataset, low: float, high: float) -> None:
    """Linear; logarithmic beyond a quarter of the wall distance if the peaks go far out."""
    linear = 0.25 * max(float(drawn(scene["j_1"])), float(drawn(scene["j_2"])))
    if 0.0 < 4.0 * _FAR * linear < high:
        axes.set_yscale("symlog", linthresh=linear, linscale=0.5)
        ticks = [n * 10.0**k for k in range(-2, 4) for n in (1, 3)]
        axes.set_yticks([0.0, *(tick for tick in ticks if linear <= tick <= high)])
        axes.yaxis.set_major_formatter("{x:g}")
        axes.minorticks_off()
        axes.figure.supylabel(f"peak displacement [mm], logarithmic above {linear:g}", fontsize=9)
        low = max(low, float(np.nanmin(drawn(scene["x_max"]))) - 0.3 * linear)
    axes.set_ylim(low, high)


def _extrema(axes: Axes, one: xr.Dataset, size: float) -> None:
    extrema = drawn(one["extrema"].transpose("omega", "extremum"))
    omega = np.broadcast_to(drawn(one["omega"])[:, None], extrema.shape)
    shown = np.isfinite(extrema)
    label = one["representation"].item()
    style: dict[str, Any] = {"color": colour(label), "markersize": size, "label": f"_{label}"}
    many = bool(shown.sum() > MANY)
    axes.plot(omega[shown], extrema[shown], "o", mew=0.0, rasterized=many, **style)


def _title(axes: Axes, one: xr.Dataset) -> None:
    """Whose panel it is, and counts that must not go unseen."""
    status = one["status"].values
    is_steady, fit = np.isfinite(one["x_max"].values), Status.OUT_OF_FIT_RANGE
    beyond, left = (status == fit) & is_steady, (status == fit) & ~is_steady
    lost = (status == Status.UNRESOLVED, beyond, left, status > fit)
    names = ("unresolved", "beyond the fit", "left the fit", "failed")
    note = ", ".join(f"{n.sum()} {name}" for n, name in zip(lost, names, strict=True) if n.any())
    axes.set_title(str(one["representation"].values), fontsize=9, loc="left", pad=3)
    axes.set_title(note, fontsize=7, loc="right", color="#555555", pad=3)
