"""Figures 6 to 11 of the paper and the scan of initial conditions, from datasets to matplotlib."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gapsweep.model.labels import Representation
from gapsweep.report import backdrop, drawing, marks
from gapsweep.report.drawing import labels_of
from gapsweep.report.figures import key_above
from gapsweep.report.scales import axis_label, drawn
from gapsweep.report.style import GREY, NOT_PERIODIC, colour, looks
from gapsweep.status import Status

from .scenes import EXACT, NO_EVENTS, STARTS
from .static_figures import WIDTH

_DOT, _REAR = 1.6, 3.4  # diameters of dots in front and behind [points]
Layer = tuple[str, Sequence[int]]  # a law, and positions of initial conditions
SHOWN_PERIODS, _HARMONICS, _DECADES = 6, 5.5, 5


def diagram(
    scene: xr.Dataset,
    panels: Mapping[str, Sequence[Layer]],
    n_columns: int,
    *,
    peaks: bool = False,
    ticks: Mapping[str, NDArray[np.bool_]] | None = None,
) -> Figure:
    """Peaks or all extrema over frequency; the first law of the scene sets the vertical axis.

    Parameters
    ----------
    panels : mapping of str to sequence
        Titles, and what each panel shows: laws and positions of initial conditions, back to front.
    ticks : mapping of str to ndarray of bool, optional
        Titles, and the frequencies that have a red tick.
    """
    scene = drawing.with_setting(scene, "x_max" if peaks else "extrema")
    n_rows, n = -(-len(panels) // n_columns), len(panels)
    figure = Figure(figsize=(WIDTH, 0.9 + (2.4 if peaks else 1.4) * n_rows), layout="constrained")
    grid = figure.subplots(n_rows, n_columns, sharex=True, sharey=True, squeeze=False).ravel()
    low, high = drawing.frame(scene, "x_max" if peaks else "x_min", labels_of(scene)[0])
    omega = drawn(scene["omega"])
    for axes in grid[n:]:
        axes.remove()
    for i, (axes, (title, layers)) in enumerate(zip(grid, panels.items(), strict=False)):
        axes.xaxis.set_tick_params(labelbottom=i >= n - n_columns)
        marks.put(axes, backdrop.walls(scene, of_peaks=peaks))
        for (label, starts), size in zip(layers, (_REAR, _DOT)[-len(layers) :], strict=True):
            one = scene.sel(representation=label).isel(initial_condition=list(starts))
            if peaks:
                marks.put(axes, drawing.peaks(one, size, high=high))
                continue
            marks.put(axes, drawing.extrema(one, "omega", size=size))
            peak, trough = (drawn(one[name])[:, 0] for name in ("x_max", "x_min"))
            marks.put(axes, drawing.outside(omega[peak > high], high, label))
            marks.put(axes, drawing.outside(omega[trough < low], low, label))
        if len(layers) == 1 and not peaks:
            marks.put(axes, backdrop.bands(one))
        if ticks:
            look = {"series": "differ", "colour": NOT_PERIODIC}
            marks.put(axes, [marks.ticks(x=omega[ticks[title]], **look)])
        words = filter(None, [title, without_response(one)])
        axes.set_title("\n".join(words), fontsize=8, loc="left", pad=7 if ticks else 3)
    pad = 0.01 * float(np.ptp(omega)) or 0.5
    grid[0].set(xlim=(max(0.0, omega.min() - pad), omega.max() + pad), ylim=(low, high))
    figure.supxlabel("forcing frequency [Hz]", fontsize=9)
    figure.supylabel(f"{'peak displacement' if peaks else 'steady extrema'} [mm]", fontsize=9)
    if not peaks and not ticks:
        key_above(figure, scene)
    return figure


def histories_and_spectra(histories: xr.Dataset) -> Figure:
    """Displacement and spectrum of all laws of ``histories.nc`` overlaid, a row per history."""
    labels, n = labels_of(histories), histories.sizes["history"]
    widths = {EXACT: 3.2, NO_EVENTS: 2.0}  # thin lines lie on thick ones
    figure = Figure(figsize=(WIDTH, 0.6 + 2.2 * n), layout="constrained")
    panels = figure.subplots(n, 2, squeeze=False, sharex="col")
    for (motion, spectrum), (_, one) in zip(panels, histories.groupby("history"), strict=True):
        one = one.squeeze("history")
        marks.put(motion, backdrop.walls(one))
        for label, look in looks(labels).items():
            own = one.sel(representation=label)
            width = 1.2 if label.endswith("-mode") else widths.get(Representation(label).law, 0.9)
            style = {"colour": look.colour, "size": width, "dashes": look.dashes, "series": label}
            t, x = _last_periods(own)
            marks.put(motion, [marks.line(x=t, y=x, **style)])
            orders = drawn(own["frequency"]) / drawn(one["omega"])
            heights = drawn(own["spectrum"])
            marks.put(spectrum, [marks.line(x=orders, y=heights, entry=label, **style)])
        top = np.nanmax(drawn(one["spectrum"]), initial=0.0) or 1.0
        motion.set(xlim=(0.0, SHOWN_PERIODS), ylabel="displacement [mm]")
        limits = (top * 10.0**-_DECADES, 2.0 * top)
        spectrum.set(xlim=(0.0, _HARMONICS), ylabel="amplitude [mm]", yscale="log", ylim=limits)
        spectrum.minorticks_off()
        start = {at: name for name, at in STARTS.items()}
        at = float(one["x_0"]), float(one["v_0"])
        title = f"{float(one['omega']):g} Hz, from {start.get(at, f'{at[0]:g} m, {at[1]:g} m/s')}"
        motion.set_title(title, fontsize=9, loc="left")
    motion.set_xlabel("forcing periods")
    spectrum.set_xlabel("frequency / forcing frequency")
    entries = panels[0, 1].get_legend_handles_labels()
    figure.legend(*entries, loc="outside upper center", ncols=4, fontsize=8)
    return figure


def start_scan(scan: xr.Dataset) -> Figure:
    """Period 3 inside and outside the paper's band, over the initial condition."""
    figure = Figure(figsize=(WIDTH, 3.2), layout="constrained")
    along, all_of_them = figure.subplots(1, 2)
    shares = {"inside": (colour(EXACT), "o", "-"), "outside": (NOT_PERIODIC, "s", "--")}
    for name, (shade, marker, dashes) in shares.items():
        share = 100.0 * scan[name].sel(v_0=0.0).values
        look = {"colour": shade, "marker": marker, "dashes": dashes, "dots": 3.0}
        look |= {"size": 1.5, "series": name, "entry": name}
        marks.put(along, [marks.line(x=drawn(scan["x_0"]), y=share, **look)])
    along.set(xlabel=axis_label(scan["x_0"]), ylabel="frequencies with period 3 [%]")
    along.set_title("initial velocity 0", fontsize=9, loc="left")
    along.legend()
    x, y = (100.0 * scan[name].values.ravel() for name in ("outside", "inside"))
    some = {"size": 4.0, "colour": GREY, "series": "initial conditions"}
    marks.put(all_of_them, [marks.points(x=x, y=y, **some)])
    for name, (x_0, v_0) in STARTS.items():
        one = 100.0 * scan.sel(x_0=x_0, v_0=v_0, method="nearest")
        at = float(one["outside"]), float(one["inside"])
        look = {"size": 6.0, "colour": NOT_PERIODIC, "series": name}
        marks.put(all_of_them, [marks.points(x=[at[0]], y=[at[1]], **look)])
        all_of_them.annotate(name, at, (7, 4), textcoords="offset points")
    all_of_them.set(xlabel="outside the band [%]", ylabel="inside the band [%]")
    all_of_them.set_title("all initial conditions", fontsize=9, loc="left")
    return figure


def _last_periods(own: xr.Dataset) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Forcing periods from the first shown, and displacement."""
    steady = own.sel(part="steady")
    periods = steady["t"].values * float(own["omega"])
    periods = periods - (np.round(np.nanmax(periods, initial=0.0)) - SHOWN_PERIODS)
    shown = periods > -1e-9
    return periods[shown], drawn(steady["x"])[shown]


def without_response(scene: xr.Dataset) -> str:
    """The numbers of points without a steady response, or beyond the range of a fit."""
    status, is_steady = scene["status"].values, np.isfinite(scene["x_max"].values)
    fit = status == Status.OUT_OF_FIT_RANGE
    counts: dict[str, Any] = {
        "unresolved": status == Status.UNRESOLVED,
        "beyond the fit": fit & is_steady,
        "left the fit": fit & ~is_steady,
        "failed": status > Status.OUT_OF_FIT_RANGE,
    }
    return ", ".join(f"{hits.sum()} {name}" for name, hits in counts.items() if hits.any())
