"""The section on gradients: derivatives of the amplitude of attractors by parameters."""

from collections.abc import Iterator

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from gapsweep.analysis.datasets.gradients_file import Reason
from gapsweep.analysis.dimensions import REPRESENTATION
from gapsweep.analysis.dimensions import scenes as positions
from gapsweep.continuation.dataset import ATTRACTOR
from gapsweep.continuation.gradient import PARAMETER, QUANTITY
from gapsweep.report import marks
from gapsweep.report.drawing import labels_of
from gapsweep.report.inputs import Inputs
from gapsweep.report.labelled import finished
from gapsweep.report.parts import Figured, Part, Table
from gapsweep.report.risk_figures import along_of, by_wall
from gapsweep.report.scales import drawn, named, shown_unit
from gapsweep.report.style import looks
from gapsweep.report.tables import number

_WIDTH, _HEIGHT = 9.5, 1.8  # inches, the report's column and a panel
_MOST = 6  # cases with figures
_WORDS = {
    Reason.NOT_PERIODIC: "are not periodic",
    Reason.REFUSED: "have a law or a parameter without derivatives",
    Reason.NO_ORBIT: "have no orbit that Newton's method finds",
    Reason.ACCUMULATION: "have impacts of several contacts that accumulate at one time",
}


def sections(inputs: Inputs) -> Iterator[Part]:
    """Derivatives of the amplitude, largest ones first; none if the study asks for none."""
    if inputs.gradients is None:
        return
    found = inputs.gradients.load()
    along = along_of(found[["reason"]].isel({ATTRACTOR: 0}))
    if along == "gap":
        found, along = by_wall(found), "j_2"
    others = [d for d in found["reason"].dims if d not in (REPRESENTATION, along, ATTRACTOR)]
    names = [name for name in found[QUANTITY].values.tolist() if name.startswith("amplitude")]
    refused = [f"{line}." for line in found.attrs["refused"].splitlines()]
    sentences = [_counts(found), *refused]
    if not names:
        yield Part("gradients", "Gradients", sentences)
        return
    every = [found.isel(at) for at in positions(found, map(str, others))]
    cases = [one for one in every if (one["reason"] == Reason.NONE).any()]
    if len(cases) > _MOST:
        sentences.append(f"Figures show the first {_MOST} of {len(cases)} cases.")
    slopes = found["gradient"].sel({QUANTITY: names[0]})
    figures = (_figure(one, along, names[0], [str(dim) for dim in others]) for one in cases[:_MOST])
    yield Part("gradients", "Gradients", sentences, [_table(slopes, names[0])], figures)


def _counts(found: xr.Dataset) -> str:
    """Sentence on the numbers of attractors with and without derivatives."""
    reason = found["reason"].values
    lost = [f"{n} {words}" for kind, words in _WORDS.items() if (n := int((reason == kind).sum()))]
    n = int((reason == Reason.NONE).sum())
    words = ", ".join([f"{n} attractors have derivatives", *lost])
    return f"{words}. All quantities are in gradients.nc."


def _units(found: xr.DataArray | xr.Dataset, name: str) -> tuple[float, str]:
    """Factor to the shown unit of the derivative of a length by a parameter, and that unit."""
    own = str(found[f"{PARAMETER}_units"].sel({PARAMETER: name}).item())
    if not own:
        return 1.0, ""
    factor, unit = shown_unit(xr.DataArray(0.0, attrs={"units": own}))
    return 1e3 / factor, f" [mm per {unit}]" if unit else " [mm]"


def _table(slopes: xr.DataArray, quantity: str) -> Table:
    """The largest derivative by every parameter, with its place."""
    rows = []
    for name in slopes[PARAMETER].values.tolist():
        one = slopes.sel({PARAMETER: name})
        size = np.abs(one.values)
        if not np.isfinite(size).any():
            continue
        at = np.unravel_index(int(np.nanargmax(size)), size.shape)
        here = one.isel(dict(zip(one.dims, at, strict=True)))
        dims = [dim for dim in one.dims if one.sizes[dim] > 1 and dim in here.coords]
        factor, unit = _units(slopes, name)
        where = ", ".join(named(here[dim]) for dim in dims)
        rows.append([f"{name}{unit}", number(factor * float(here)), where])
    return Table(f"Largest derivatives of {quantity}", ["by", "derivative", "at"], rows)


def _figure(one: xr.Dataset, along: str, quantity: str, others: list[str]) -> Figured:
    """Derivatives by every parameter along an axis, a panel each."""
    names = one[PARAMETER].values.tolist()
    figure = Figure(figsize=(_WIDTH, 0.4 + _HEIGHT * len(names)))
    panels = figure.subplots(len(names), 1, squeeze=False, sharex=True)[:, 0]
    slopes = one["gradient"].sel({QUANTITY: quantity}).transpose(along, ATTRACTOR, ...)
    for axes, name in zip(panels, names, strict=True):
        factor, unit = _units(one, name)
        for label, look in looks(labels_of(one)).items():
            y = factor * slopes.sel({PARAMETER: name, REPRESENTATION: label}).values
            there, entry = np.isfinite(y), label if axes is panels[0] else ""
            points = {"x": drawn(one[along])[np.nonzero(there)[0]], "y": y[there]}
            style = {"colour": look.colour, "marker": look.marker, "size": 4.0}
            if there.any():
                marks.put(axes, [marks.points(**points, series=label, entry=entry, **style)])
        axes.set_ylabel(f"∂ {quantity} / ∂ {name}\n{unit}".rstrip())
        finished(axes, one, along).set_title("", loc="left")
        axes.label_outer()
    where = ", ".join(named(one[dim]) for dim in others if one[dim].size == 1)
    words = f"Derivatives of {quantity} by {', '.join(names)}, a point for each attractor"
    return Figured(figure, f"{words}{f': {where}' if where else ''}.", words)
