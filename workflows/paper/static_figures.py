"""Figures 2 to 5 of the paper: contact laws before anything is integrated.

Every law is proportional to the contact stiffness: the paper's soft one shows them all.
"""

from collections.abc import Iterable

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from gapsweep.model.fit import N_FIT_POINTS, unit_force
from gapsweep.model.labels import contact_law
from gapsweep.model.oscillator import Gap
from gapsweep.report.scales import axis_label, drawn
from gapsweep.report.style import colour, lines

from .scenes import EXACT, SOFT

Forces = dict[str, NDArray[np.float64]]

WIDTH = 9.5  # inches, the report's column
_CONSTRAINED, _DARK = ", constrained", "#7a4b00"  # a darker shade of polynomials
_MARGIN = 0.75  # what is shown on either side of the gap, in widths of the gap
_ROUNDING = 1e-15  # errors below this are those of the arithmetic
# "Each model has RMSE < 0.5 and R² > 0.998" (Sect. 4.1).
_QUALITY = {"rmse": 0.5, "r_squared": 1.0 - 0.998}


def forces_of(static: xr.Dataset, labels: Iterable[str]) -> Forces:
    """Contact force [N] of laws with the soft stiffness, at the displacements of one gap."""
    gap, x = Gap(static["j_1"].item(), static["j_2"].item()), static["x"].values
    return {label: contact_law(label, SOFT, gap, x[-1]).force(x) for label in labels}


def constrained_forces(static: xr.Dataset, labels: Iterable[str]) -> Forces:
    """The same of polynomials that are fitted without their constant and linear terms."""
    gap, x = Gap(static["j_1"].item(), static["j_2"].item()), static["x"].values
    u, at = np.linspace(-1.0, 1.0, N_FIT_POINTS), x / x[-1]
    found = {}
    for label in labels:
        columns = u[:, None] ** 2 * chebyshev.chebvander(u, int(label.partition("-")[2]) - 2)
        fit = np.linalg.lstsq(columns, SOFT * unit_force(u * x[-1], gap), rcond=None)[0]
        found[label + _CONSTRAINED] = at**2 * chebyshev.chebval(at, fit)
    return found


def force_curves(static: xr.Dataset, forces: Forces) -> Figure:
    """Force and its error near the gap, and over the fit range; `static` is at one gap."""
    figure = Figure(figsize=(WIDTH, 3.5), layout="constrained")
    panels = figure.subplots(1, 3)
    (exact,) = forces_of(static, [EXACT]).values()
    x, walls = drawn(static["x"]), (-float(drawn(static["j_1"])), float(drawn(static["j_2"])))
    near = np.abs(x - np.mean(walls)) <= (0.5 + _MARGIN) * (walls[1] - walls[0])
    # A constrained fit has the line of the free one, in another shade.
    styles = lines(list(dict.fromkeys(name.removesuffix(_CONSTRAINED) for name in forces)))
    for axes, shown, minus, title in (
        (panels[0], near, 0.0 * exact, "force near the gap [N]"),
        (panels[1], near, exact, "error near the gap [N]"),
        (panels[2], x == x, exact, "error in the fit range [N]"),
    ):
        axes.axvspan(*walls, color="#eeeeee", zorder=0, label="_gap")
        look = {"color": colour(EXACT), "linewidth": 2.2, "label": "_exact"}
        axes.plot(x[shown], (exact - minus)[shown], **look)
        for name, force in forces.items():
            law = name.removesuffix(_CONSTRAINED)
            shade = colour(law) if law == name else _DARK
            look = {"color": shade, "linewidth": 1.3, "label": f"_{name}"}
            axes.plot(x[shown], (force - minus)[shown], styles[law], **look)
        axes.set_title(title, fontsize=9, loc="left")
        axes.set_xlabel(axis_label(static["x"]))
        axes.margins(x=0.0)
    figure.legend(panels[0].lines, ["exact", *forces], loc="outside upper center", ncols=5)
    return figure


def static_convergence(ladders: xr.Dataset) -> Figure:
    """Errors against degrees and convergence parameter (figure 5); `ladders` is at one gap."""
    figure = Figure(figsize=(WIDTH, 5.2), layout="constrained")
    panels = figure.subplots(2, 3, sharex="col")
    free, constrained = ladders["constraint"].values
    for row, (name, bound) in zip(panels, _QUALITY.items(), strict=True):
        for left_out, shade in ((free, colour("poly")), (constrained, _DARK)):
            rungs = ladders[f"poly_{name}"].sel(constraint=left_out)
            _rungs(row[0], rungs, "degree", shade, "free" if left_out == free else left_out)
        _rungs(row[1], ladders[f"ratpoly_{name}"], "ratio", colour("ratpoly"), "")
        for family in ladders["family"].values.tolist():
            rungs = ladders[f"smooth_{name}"].sel(family=family)
            _rungs(row[2], rungs, "parameter", colour(family), family)
        row[0].sharey(row[1])
        row[2].set_xscale("log")
        for axes in row:
            axes.set_yscale("log")
            axes.axhline(bound, color="#777777", linewidth=0.8, linestyle=":")
    for axes, title in zip(panels[0], ("polynomials", "rational", "smooth"), strict=True):
        axes.set_title(title, fontsize=9, loc="left")
    panels[0, 0].set_ylabel("RMS error [N]")
    panels[1, 0].set_ylabel("1 − R²")
    panels[1, 0].set_xlabel("degree")
    panels[1, 1].set_xlabel("degrees of N/D")
    panels[1, 2].set_xlabel("convergence parameter [1/m]")
    panels[1, 1].tick_params(axis="x", labelsize=7)
    panels[0, 0].legend(fontsize=7, loc="upper right")
    panels[0, 2].legend(fontsize=7)
    return figure


def _rungs(axes: Axes, rungs: xr.DataArray, along: str, shade: str, label: str) -> None:
    """One curve, as far as a logarithmic axis can show it; lengths per stiffness as newtons."""
    loss = 1.0 - rungs if str(rungs.name).endswith("r_squared") else SOFT * rungs
    mark = "o" if along == "ratio" else "o-"  # no line leads from one ratio to the next
    shown = loss.where(loss > _ROUNDING)
    axes.plot(rungs[along].values, shown, mark, color=shade, markersize=3.5, label=label)
