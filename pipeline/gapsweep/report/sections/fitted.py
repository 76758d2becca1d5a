"""The section on a fit: fitted numbers with their errors, and measured points over branches."""

import json
from collections.abc import Iterator

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from gapsweep.analysis.datasets.fit_file import OTHER, PARAMETER
from gapsweep.report import fit_figure
from gapsweep.report.inputs import Inputs
from gapsweep.report.parts import Figured, Part, Table
from gapsweep.report.scales import plain, shown_unit
from gapsweep.report.tables import number
from gapsweep.status import Status

_SIZE = (9.5, 5.4)  # inches, the report's column


def sections(inputs: Inputs) -> Iterator[Part]:
    """The fitted numbers, doubts of them, and the measured points; none without a fit."""
    if inputs.fit is None:
        return
    found = inputs.fit.load()
    if found["fit_status"] != Status.OK:
        yield Part("fit", "Fit", [f"The fit has failed: {found.attrs['message']}"])
        return
    figure = Figure(figsize=_SIZE)
    above, below = figure.subplots(2, 1, height_ratios=(3, 1))
    fit_figure.draw(above, below, found)
    words = f"Measured {found.attrs['quantity']} over the branches of the fitted model"
    caption = (
        f"{words}, dashed where unstable, and residuals with the noise (lines below). Hollow "
        "points are on another branch than the model and do not count."
    )
    other = "All other sections show the numbers of the study, not the fitted ones."
    sentences = [_values(found), *found.attrs["notes"].splitlines(), _about(found), other]
    yield Part("fit", "Fit", sentences, [_table(found)], [Figured(figure, caption, words)])


def _parameters(found: xr.Dataset) -> Iterator[tuple[str, str, str, str]]:
    """Name, value, standard error and unit of every parameter, in shown units."""
    units = found[f"{PARAMETER}_units"].values.tolist()
    values, errors = found["value"].values.tolist(), found["standard_error"].values.tolist()
    names = found[PARAMETER].values.tolist()
    for name, value, error, own in zip(names, values, errors, units, strict=True):
        factor, unit = shown_unit(xr.DataArray(0.0, attrs={"units": own}))
        known = np.isfinite(error) and error > 0.0
        digits = int(np.ceil(np.log10(abs(value) / error))) + 2 if known and value else 4
        text = plain(float(f"{factor * value:.{max(digits, 2)}g}"))
        yield name, text, f"{factor * error:.2g}" if np.isfinite(error) else "unknown", unit


def _values(found: xr.Dataset) -> str:
    """Sentence with all values and their standard errors."""
    several = [
        f"{name} = {value} ± {error} {unit}".strip()
        for name, value, error, unit in _parameters(found)
        if error != "unknown"
    ]
    return f"{', '.join(several)} (standard errors)." if several else "No number is determined."


def _about(found: xr.Dataset) -> str:
    """Sentence on the law, the points and their noise."""
    factor, unit = shown_unit(found["measured"])
    directions = found["direction"].values
    counts = [f"{(directions == one).sum()} {one}" for one in dict.fromkeys(directions.tolist())]
    table = json.loads(found.attrs["study_json"])["fit"]
    given = "noise" in table or any(title.startswith("noise") for title in table["data"])
    how = "given" if given else "estimated from the residuals"
    ends = {factor * end(found["measured_noise"].values).item(): None for end in (np.min, np.max)}
    noise = f"{' to '.join(map(number, ends))} {unit}".strip()
    return (
        f"Law: {found.attrs['representation']}. Points by direction of the sweep: "
        f"{', '.join(counts)}. Noise: {noise}, {how}."
    )


def _table(found: xr.Dataset) -> Table:
    """Values, standard errors and correlations of the parameters."""
    names = found[PARAMETER].values.tolist()
    correlation = found["correlation"].transpose(PARAMETER, OTHER).values
    several = len(names) > 1
    rows = [
        [*row, *(map(number, correlation[i]) if several else ())]
        for i, row in enumerate(_parameters(found))
    ]
    of_names = [f"correlation with {name}" for name in names] if several else []
    header = ["number", "value", "standard error", "unit", *of_names]
    return Table("Fitted numbers", header, rows)
