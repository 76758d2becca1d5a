"""Figure of a fit: measured sweeps over the branches of the fitted model, and residuals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from gapsweep.report import branch_lines, marks
from gapsweep.report.scales import axis_label, drawn
from gapsweep.report.style import NUMBERED, SWEEPS
from gapsweep.variables import COORDINATE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ORBITS = "#000000"  # of the fitted model


def draw(above: Axes, below: Axes, found: xr.Dataset) -> None:
    """Draw measured points over stable and unstable branches, and their residuals below.

    Hollow points are not on the branch of the model and do not count. Branches have peaks, troughs
    and amplitudes; a line joins the computed values of other quantities.

    `found`: as `dataset` of `analysis/datasets/fit_file.py` returns it.
    """
    quantity, omega = found.attrs["quantity"], found["measured_omega"].values
    values, residual, computed = (
        drawn(found[name]) for name in ("measured", "residual", "computed")
    )
    orbits = _orbits(found, quantity)
    if orbits is not None:
        marks.put(above, branch_lines.orbits(orbits, "omega", [quantity], _ORBITS))
    directions, is_on = found["direction"].values, found["is_on_branch"].values == 1
    for direction in dict.fromkeys(directions.tolist()):
        kind = f"sweep_{direction}"
        look = {"marker": SWEEPS[kind], "colour": NUMBERED[list(SWEEPS).index(kind)], "size": 3.6}
        for counts, face, word in ((True, "", ""), (False, "none", ", other branch")):
            here = (directions == direction) & (is_on == counts)
            if here.any():
                name = f"measured {direction}{word}"
                about = {"series": name, "face": face, **look}
                points = {"x": omega[here], "y": values[here]}
                marks.put(above, [marks.points(**points, entry=name, zorder=1.7, **about)])
                if counts:
                    points["y"] = residual[here]
                    marks.put(below, [marks.points(**points, **about)])
    if orbits is None:
        order = np.argsort(omega, kind="stable")
        marks.put(above, [marks.line(x=omega[order], y=computed[order], colour=_ORBITS)])
    label = axis_label(found["measured"], quantity)
    above.set(ylabel=label, xlim=(omega.min(), omega.max()))
    order = np.argsort(omega, kind="stable")
    noise = drawn(found["measured_noise"])[order]
    for sign in (-1.0, 1.0):
        marks.put(below, [marks.line(x=omega[order], y=sign * noise)])
    below.set(
        xlabel="forcing frequency [Hz]",
        ylabel=axis_label(found["measured"], "residual"),
        xlim=above.get_xlim(),
    )
    if orbits is not None:
        branch_lines.name_points(above, orbits, "omega", quantity)
    above.legend(fontsize=8)


def _orbits(found: xr.Dataset, quantity: str) -> xr.Dataset | None:
    """Branches of the fitted model; None without them."""
    if "special" not in found:
        return None
    own = {COORDINATE: found[COORDINATE].values[0]} if COORDINATE in found.dims else {}
    return branch_lines.shown(found, ["omega", quantity], own)
