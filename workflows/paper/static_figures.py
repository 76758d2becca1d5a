"""Figures 2 to 5 of the paper, each from `static.nc` or `ladders.nc` to a matplotlib figure.

All take a dataset of one gap, ``static.sel(gap=…)``.
"""

import math
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gapsweep.report.style import colour, lines

_MM = 1e3
_WIDTH = 9.5  # inches, the report's column
_GAP_SHADE = "#eeeeee"
_FAINT: dict[str, Any] = {"color": "#777777", "linewidth": 0.8, "linestyle": ":"}
# What is shown on either side of the gap, in widths of the gap.
_MARGIN = 0.75
# Errors below this are those of the arithmetic, be they of R² [-] or of lengths [m].
_ROUNDING = 1e-16
_CONSTRAINTS = {"none": ("o-", "#E69F00"), "no constant or linear term": ("s--", "#8a5a00")}
_LADDER_ROWS = {
    "rmse": "RMS error / K_c [m]",
    "r_squared": "1 − R²",
    "in_gap_force": "in-gap force / K_c [m]",
}


def polynomial_forces(static: xr.Dataset) -> Figure:
    """Polynomials (figure 2): force and force error, around the gap and over the fit range."""
    return _forces(static, ("poly",))


def rational_forces(static: xr.Dataset) -> Figure:
    """Rational polynomials (figure 3), as `polynomial_forces`."""
    return _forces(static, ("ratpoly",))


def smooth_forces(static: xr.Dataset) -> Figure:
    """Tanh, arctan and log-arctan (figure 4), as `polynomial_forces`."""
    return _forces(static, ("tanh", "arctan", "logarctan"))


def static_convergence(ladders: xr.Dataset, forcing: float) -> Figure:
    """Errors against degree and convergence parameter (figure 5).

    Everything is per unit contact stiffness, so one curve serves all stiffnesses; dotted
    lines mark where the in-gap force is a tenth of the forcing at those of the study. Errors
    of smooth laws are integrals; crosses are what 8001 uniform points make of them.

    Parameters
    ----------
    ladders : Dataset
        One gap.
    forcing : float
        Its amplitude [N].
    """
    figure = Figure(figsize=(_WIDTH, 7.8), layout="constrained")
    panels = figure.subplots(3, 3, sharex="col")
    for row, (name, label) in zip(panels, _LADDER_ROWS.items(), strict=True):
        row[0].sharey(row[1])
        _polynomials(row[0], ladders, name)
        _rationals(row[1], ladders, name)
        _smooth_laws(row[2], ladders, name)
        row[0].set_ylabel(label)
        for axes in row:
            # A gap wider than the fit range leaves polynomials no error at all.
            if any(np.isfinite(line.get_ydata()).any() for line in axes.lines):
                axes.set_yscale("log")
            axes.minorticks_off()
    _mark_leaks(panels[2], ladders, abs(forcing))
    titles = ("polynomial", "rational polynomial", "smooth law")
    below = ("degree", "degrees of N/D", "convergence parameter [1/m]")
    for column, title, label in zip(panels.T, titles, below, strict=True):
        column[0].set_title(title, fontsize=9, loc="left")
        column[2].set_xlabel(label)
    panels[0, 0].legend(title="terms left out", fontsize=8, title_fontsize=8)
    panels[0, 2].legend(fontsize=8)
    return figure


def _forces(static: xr.Dataset, families: tuple[str, ...]) -> Figure:
    labels = [r for r in static["representation"].values.tolist() if r.split("-")[0] in families]
    stiffnesses = np.atleast_1d(static["K_c"].values)
    figure = Figure(figsize=(_WIDTH, 7.8), layout="constrained")
    panels = figure.subplots(3, stiffnesses.size, squeeze=False)
    near = _near_gap(static)
    for column, K_c in zip(panels.T, stiffnesses, strict=True):
        scene = static.sel(K_c=K_c) if "K_c" in static.dims else static
        _curves(column[0], scene.sel(x=near), labels, "force")
        _curves(column[1], scene.sel(x=near), labels, "force_error")
        _curves(column[2], scene, labels, "force_error")
        _mark_forcing(column[1], scene)
        column[0].set_title(f"K_c = {K_c:g} N/m", fontsize=9, loc="left")
        column[2].set_xlabel("displacement [mm]")
    names = ("force near the gap [N]", "error near the gap [N]", "error in the fit range [N]")
    for axes, label in zip(panels[:, 0], names, strict=True):
        axes.set_ylabel(label)
    n_rows = math.ceil((len(labels) + 1) / 5)
    figure.legend(
        panels[0, 0].lines,
        ["exact", *labels],
        loc="outside upper center",
        ncols=math.ceil((len(labels) + 1) / n_rows),
    )
    return figure


def _near_gap(static: xr.Dataset) -> slice:
    """Displacements [m] of the gap and its surroundings, inside the fit range."""
    low, high = -float(static["j_1"]), float(static["j_2"])
    end = float(static["x"].max())
    margin = _MARGIN * (high - low) or 0.25 * end
    return slice(max(low - margin, -end), min(high + margin, end))


def _curves(axes: Axes, scene: xr.Dataset, labels: list[str], name: str) -> None:
    """One quantity of the exact law and of `labels` over x, the gap as a shade."""
    x = scene["x"] * _MM
    some = scene.isel(representation=0)
    exact = some[name] - some["force_error"]
    if name == "force_error":
        exact = xr.zeros_like(x)
    axes.plot(x, exact, color=colour("piecewise"), linewidth=2.2)
    for label, style in lines(labels).items():
        curve = scene[name].sel(representation=label)
        axes.plot(x, curve, style, color=colour(label), linewidth=1.3)
    axes.set_xlim(float(x.min()), float(x.max()))
    walls = -float(scene["j_1"]) * _MM, float(scene["j_2"]) * _MM
    axes.axvspan(*walls, color=_GAP_SHADE, zorder=0)


def _mark_forcing(axes: Axes, scene: xr.Dataset) -> None:
    """Lines at ± the forcing where the panel reaches that far."""
    forcing = abs(float(scene["forcing"]))
    low, high = axes.get_ylim()
    for level in (-forcing, forcing):
        if forcing and low < level < high:
            axes.axhline(level, **_FAINT)
    if forcing and low < forcing < high:
        right = axes.get_xlim()[1]
        axes.text(right, forcing, "± p ", ha="right", va="bottom", fontsize=8, color="#555555")


def _polynomials(axes: Axes, ladders: xr.Dataset, name: str) -> None:
    for constraint, (mark, shade) in _CONSTRAINTS.items():
        rung = ladders[f"poly_{name}"].sel(constraint=constraint)
        loss = _loss(rung, name)
        axes.plot(rung["degree"], loss, mark, color=shade, markersize=3.5, label=constraint)


def _rationals(axes: Axes, ladders: xr.Dataset, name: str) -> None:
    rung = ladders[f"ratpoly_{name}"]
    axes.plot(rung["ratio"].values, _loss(rung, name), "o", color=colour("ratpoly"), markersize=5)
    axes.tick_params(axis="x", labelsize=8)


def _smooth_laws(axes: Axes, ladders: xr.Dataset, name: str) -> None:
    axes.set_xscale("log")
    source = "rmse_resolved" if name == "rmse" else name
    for family in ladders["family"].values.tolist():
        rung = ladders[f"smooth_{source}"].sel(family=family)
        shade = colour(family)
        loss = _loss(rung, name)
        axes.plot(rung["parameter"], loss, "o-", color=shade, markersize=3, label=family)
    if name != "rmse":
        return
    # Samples that miss every layer find errors of nothing but rounding: not shown.
    lowest = 0.1 * ladders["smooth_rmse_resolved"].min()
    for family in ladders["family"].values.tolist():
        sampled = ladders["smooth_rmse"].sel(family=family)
        sampled = sampled.where(sampled > lowest)
        shade = colour(family)
        axes.plot(sampled["parameter"], sampled, "x", color=shade, markersize=4.5, alpha=0.6)
    axes.plot([], [], "x", color="#777777", markersize=4.5, label="on 8001 points")


def _loss(rung: xr.DataArray, name: str) -> xr.DataArray:
    """What a logarithmic axis can show: R² as its distance from 1, no rounding errors."""
    values = 1.0 - rung if name == "r_squared" else rung
    return values.where(values > _ROUNDING)


def _mark_leaks(row: np.ndarray, ladders: xr.Dataset, forcing: float) -> None:
    for axes in row:
        low, high = axes.get_ylim()
        for K_c in np.atleast_1d(ladders["K_c"].values).tolist():
            level = 0.1 * forcing / K_c if K_c else 0.0
            if not low < level < high:
                continue
            axes.axhline(level, **_FAINT)
            if axes is row[-1]:
                text = f" 0.1 p /\n {K_c:g} N/m"
                where = axes.get_yaxis_transform()
                axes.text(1.0, level, text, transform=where, va="center", fontsize=7)
