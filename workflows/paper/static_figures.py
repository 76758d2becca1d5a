"""Figures 2 to 5 of the paper: contact laws before anything is integrated."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gapsweep.model.labels import Representation, contact_law
from gapsweep.model.oscillator import Gap
from gapsweep.report import marks
from gapsweep.report.scales import axis_label, drawn, plain
from gapsweep.report.style import GREY, NUMBERED, colour, looks

from .ladders import polynomial
from .scenes import EXACT, SOFT

Forces = dict[str, NDArray[np.float64]]

WIDTH = 9.5  # inches, the report's column
CONSTRAINED, _OTHER = ", constrained", NUMBERED[1]  # colour of constrained polynomials
_MARGIN = 0.75  # what is shown on either side of the gap, in widths of the gap
_ROUNDING = 1e-15  # errors below this are those of the arithmetic
# "Each model has RMSE < 0.5 and R² > 0.998" (Sect. 4.1).
_QUALITY = {"rmse": ("RMS error [N]", 0.5), "r_squared": ("1 − R²", 1.0 - 0.998)}


def unit_forces(static: xr.Dataset, labels: tuple[str, ...]) -> Forces:
    """Force per contact stiffness [m] of some laws and the exact one, at the displacements.

    The label of a polynomial that ends in `CONSTRAINED` is fitted without its constant and linear
    terms. Every law is proportional to the contact stiffness.
    """
    gap, x = Gap(static["j_1"].item(), static["j_2"].item()), static["x"].values
    found = {}
    for label in (EXACT, *labels):
        law = Representation(label.removesuffix(CONSTRAINED))
        if law == label:
            found[label] = contact_law(label, 1.0, gap, x[-1]).force(x)
        else:
            found[label] = polynomial(gap, int(law.parameter), x[-1], 2)(x)
    return found


def force_curves(static: xr.Dataset, forces: Forces, stiffnesses: Sequence[float]) -> Figure:
    """Force near the gap and error over the fit range, a row per stiffness; `static` at one gap."""
    n = len(stiffnesses)
    figure = Figure(figsize=(WIDTH, 0.6 + 2.7 * n), layout="constrained")
    panels = figure.subplots(n, 2, squeeze=False, sharex="col")
    x, (low, high) = drawn(static["x"]), (-drawn(static["j_1"]).item(), drawn(static["j_2"]).item())
    near = np.abs(x - 0.5 * (low + high)) <= (0.5 + _MARGIN) * (high - low)
    styles = looks(dict.fromkeys(name.removesuffix(CONSTRAINED) for name in forces))
    for row, K_c in zip(panels, stiffnesses, strict=True):
        for label, force in forces.items():
            law = label.removesuffix(CONSTRAINED)
            look = {
                "colour": styles[law].colour if law == label else _OTHER,
                "size": 2.2 if law == EXACT else 1.3,
                "dashes": styles[law].dashes,
                "series": label,
            }
            marks.put(row[0], [marks.line(x=x[near], y=K_c * force[near], entry=label, **look)])
            marks.put(row[1], [marks.line(x=x, y=K_c * (force - forces[EXACT]), **look)])
        for axes, title in zip(row, ("force near the gap", "error in the fit range"), strict=True):
            marks.put(axes, [marks.band(x=[low], x_end=[high], colour="#eeeeee", series="gap")])
            axes.set_title(f"{plain(K_c)} N/m: {title} [N]", fontsize=9, loc="left")
            axes.margins(x=0.0)
    for axes in panels[-1]:
        axes.set_xlabel(axis_label(static["x"]))
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure


def static_convergence(ladders: xr.Dataset) -> Figure:
    """Errors against degrees and convergence parameter (figure 5); `ladders` is at one gap."""
    figure = Figure(figsize=(WIDTH, 5.2), layout="constrained")
    panels = figure.subplots(2, 3, sharex="col", sharey="row")
    curves = (
        ("polynomials", "poly", "constraint", "degree"),
        ("rational", "ratpoly", "", "ratio"),  # no line leads from one ratio to the next
        ("smooth", "smooth", "family", "parameter"),
    )
    for row, (error, (says, bound)) in zip(panels, _QUALITY.items(), strict=True):
        for axes, (title, kind, by, along) in zip(row, curves, strict=True):
            rungs = ladders[f"{kind}_{error}"]
            loss = 1.0 - rungs if error == "r_squared" else SOFT * rungs
            for n, one in enumerate(loss.transpose(by, ...) if by else [loss]):
                name = str(one[by].values).replace("none", "free") if by else ""
                shade = colour(name if kind == "smooth" else kind)
                look = {"colour": _OTHER if kind == "poly" and n else shade, "entry": name}
                look |= {"x": one[along].values, "y": one.where(one > _ROUNDING).values}
                look |= {"series": name}
                if by:
                    marks.put(axes, [marks.line(size=1.5, dots=3.5, **look)])
                else:
                    marks.put(axes, [marks.points(size=3.5, **look)])
            marks.put(axes, [marks.level(y=bound, colour=GREY, size=0.8, dashes=":")])
            axes.set_yscale("log")
            if row is panels[0]:
                axes.set_title(title, fontsize=9, loc="left")
        row[0].set_ylabel(says)
        row[2].set_xscale("log")
    named = ("degree", "degrees of N/D", "convergence parameter [1/m]")
    for axes, label in zip(panels[1], named, strict=True):
        axes.set_xlabel(label)
    panels[1, 1].tick_params(axis="x", labelsize=7)
    for axes in panels[0, ::2]:
        axes.legend(fontsize=7)
    return figure
