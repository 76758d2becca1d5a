"""Figure of a fit: measured sweeps over the branches of the fitted model, and residuals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from gapsweep.continuation.follow import branches
from gapsweep.design.fit import Fit
from gapsweep.errors import ModelError
from gapsweep.report import branch_lines, marks
from gapsweep.report.scales import axis_label, drawn
from gapsweep.report.style import NUMBERED, SWEEPS
from gapsweep.response.result import RESPONSE
from gapsweep.variables import COORDINATE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ORBITS = "#000000"  # of the fitted model


def draw(above: Axes, below: Axes, found: Fit) -> None:
    """Draw measured points over stable and unstable branches, and their residuals below.

    Hollow points are not on the branch of the model and do not count. Branches have peaks, troughs
    and amplitudes; a line joins the computed values of other quantities.
    """
    orbits = _orbits(found)
    attributes = (
        RESPONSE[found.quantity].attributes if orbits is None else orbits[found.quantity].attrs
    )
    described = xr.DataArray(found.measured, dims="point", attrs=attributes)
    if orbits is not None:
        marks.put(above, branch_lines.orbits(orbits, "omega", [found.quantity], _ORBITS))
    values = drawn(described)
    scale = float(np.nanmax(np.abs(values)) / np.nanmax(np.abs(found.measured)))
    for direction in dict.fromkeys(found.direction.tolist()):
        kind = f"sweep_{direction}"
        look = {"marker": SWEEPS[kind], "colour": NUMBERED[list(SWEEPS).index(kind)], "size": 3.6}
        for counts, face, word in ((True, "", ""), (False, "none", ", other branch")):
            here = (found.direction == direction) & (found.is_on_branch == counts)
            if here.any():
                name = f"measured {direction}{word}"
                about = {"series": name, "face": face, **look}
                points = {"x": found.omega[here], "y": values[here]}
                marks.put(above, [marks.points(**points, entry=name, zorder=1.7, **about)])
                if counts:
                    points["y"] = scale * found.residual[here]
                    marks.put(below, [marks.points(**points, **about)])
    if orbits is None:
        order = np.argsort(found.omega, kind="stable")
        line = marks.line(x=found.omega[order], y=scale * found.computed[order], colour=_ORBITS)
        marks.put(above, [line])
    label = axis_label(described, found.quantity)
    above.set(ylabel=label, xlim=(found.omega.min(), found.omega.max()))
    marks.put(below, [marks.level(y=sign * scale * found.noise) for sign in (-1.0, 1.0)])
    below.set(xlabel="forcing frequency [Hz]", ylabel="residual", xlim=above.get_xlim())
    if orbits is not None:
        branch_lines.name_points(above, orbits, "omega", found.quantity)
    above.legend(fontsize=8)


def _orbits(found: Fit) -> xr.Dataset | None:
    """Branches of the fitted model over the measured frequencies; None without the quantity."""
    if found.quantity not in ("amplitude", "x_max", "x_min"):
        return None
    model = found.oscillator
    own = {COORDINATE: model.coordinates[0]} if COORDINATE in model.parts else {}
    between = float(found.omega.min()), float(found.omega.max())
    try:
        orbits = branches(model, found.law, "omega", between)
    except ModelError:  # no periodic orbit
        return None
    return branch_lines.shown(orbits, ["omega", found.quantity], own)
