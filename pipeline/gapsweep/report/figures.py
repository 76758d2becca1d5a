"""Figures of the report, each from a dataset to a matplotlib figure."""

import math

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gapsweep.report.style import colour, lines
from gapsweep.response.result import ResponseClass

_MM = 1e3
_WIDTH = 9.5  # inches, the report's column


def frequency_response(responses: xr.Dataset) -> Figure:
    """Amplitude over frequency, one curve per representation and start.

    Parameters
    ----------
    responses : Dataset
        One stiffness and one gap; dimensions representation, omega, initial_condition.
    """
    figure = Figure(figsize=(_WIDTH, 4.2))
    axes = figure.subplots()
    labels = [str(label) for label in responses["representation"].values]
    styles = lines(labels)
    for label in labels:
        curves = responses.sel(representation=label)
        if not np.isfinite(curves["amplitude"]).any():
            continue
        exact = label == "piecewise"
        for start in range(curves.sizes["initial_condition"]):
            curve = curves.isel(initial_condition=start)
            axes.plot(
                curve["omega"],
                curve["amplitude"] * _MM,
                styles[label],
                color=colour(label),
                label=label if start == 0 else None,
                linewidth=2.2 if exact else 1.2,
                zorder=1 if exact else 2,
                marker="." if curve.sizes["omega"] <= 60 else None,
                markersize=5 if exact else 3,
            )
    _frequency_axis(axes, responses)
    axes.set_ylabel("amplitude [mm]")
    axes.set_ylim(bottom=0)
    if axes.lines:
        axes.legend(ncols=2)
    return figure


def bifurcation(responses: xr.Dataset) -> Figure:
    """All steady extrema over frequency, a panel per representation.

    Periodic responses are drawn in the representation's colour, all others in red.
    """
    labels = [str(label) for label in responses["representation"].values]
    n_rows = math.ceil(len(labels) / 2)
    n_columns = min(2, len(labels))
    figure = Figure(figsize=(_WIDTH, 1.1 + 2.3 * n_rows))
    panels = figure.subplots(n_rows, n_columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes, label in zip(panels, labels, strict=False):
        _extrema_panel(axes, responses.sel(representation=label), label)
    for axes in panels[len(labels) :]:
        axes.set_visible(False)
    for axes in panels[max(0, len(labels) - n_columns) : len(labels)]:
        _frequency_axis(axes, responses)
        axes.xaxis.set_tick_params(labelbottom=True)
    for axes in panels[::n_columns]:
        axes.set_ylabel("extrema [mm]")
    return figure


def basins(found: xr.Dataset) -> Figure:
    """Attractor of every start, as returned by `gapsweep.basins`; white where there is none.

    Parameters
    ----------
    found : Dataset
        ``attractor(v_0, x_0)`` and what each attractor is.
    """
    figure = Figure(figsize=(0.75 * _WIDTH, 4.2), layout="constrained")
    axes = figure.subplots()
    n = max(found.sizes["attractor_number"], 1)
    ids = found["attractor"].where(found["attractor"] >= 0)
    shades = colormaps["cividis"].resampled(n)
    mesh = axes.pcolormesh(
        found["x_0"] * _MM, found["v_0"] * _MM, ids, cmap=shades, vmin=-0.5, vmax=n - 0.5
    )
    bar = figure.colorbar(mesh, ax=axes, ticks=range(n))
    peaks = zip(found["period_multiple"].values, found["x_max"].values, strict=True)
    names = [f"{f'P{k}' if k else 'chaotic'}, peak {x * _MM:.4g} mm" for k, x in peaks]
    bar.ax.set_yticklabels(names)
    axes.set_xlabel("initial displacement [mm]")
    axes.set_ylabel("initial velocity [mm/s]")
    axes.grid(visible=False)
    return figure


def _extrema_panel(axes: Axes, responses: xr.Dataset, label: str) -> None:
    for wall in (-float(responses["j_1"]), float(responses["j_2"])):
        axes.axhline(wall * _MM, color="#888888", linewidth=0.8, linestyle="--", zorder=0)
    periodic = responses["response_class"].values == ResponseClass.PERIODIC
    omega = np.broadcast_to(responses["omega"].values[:, None], periodic.shape)
    extrema = responses["extrema"].values * _MM
    for chosen, shade in ((periodic, colour(label)), (~periodic, "#c00000")):
        x = np.repeat(omega[chosen], extrema.shape[-1])
        y = extrema[chosen].ravel()
        shown = np.isfinite(y)
        # Thousands of points as vectors would make the report heavy.
        axes.plot(
            x[shown], y[shown], ".", color=shade, markersize=2.5, rasterized=shown.sum() > 2000
        )
    axes.set_title(label, fontsize=9, loc="left")


def _frequency_axis(axes: Axes, responses: xr.Dataset) -> None:
    omega = responses["omega"].values
    axes.set_xlabel("forcing frequency [Hz]")
    pad = 0.02 * (omega.max() - omega.min()) or 0.5
    axes.set_xlim(max(0.0, omega.min() - pad), omega.max() + pad)
