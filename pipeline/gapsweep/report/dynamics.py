"""Figures of nonlinear dynamics: functions of a dataset that draw into one axes.

`poincare` and `waterfall` need more than the stored data: they simulate stored responses further
(`gapsweep.report.continued`).
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from gapsweep.analysis.datasets.tracks import with_tracks
from gapsweep.analysis.dimensions import Array
from gapsweep.analysis.spectra import N_PERIODS, SAMPLES_PER_PERIOD, spectrum
from gapsweep.errors import DatasetError
from gapsweep.report import backdrop, drawing, marks
from gapsweep.report import branch_lines as of_branches
from gapsweep.report.continued import motions, weights
from gapsweep.report.drawing import labels_of
from gapsweep.report.labelled import axes_of, axis_of, finished, scene_along, titled
from gapsweep.report.scales import axis_label, drawn, shown_unit
from gapsweep.report.selection import places, scene
from gapsweep.report.style import GREY, NOT_PERIODIC, NUMBERED, colour, looks
from gapsweep.response.result import ResponseClass
from gapsweep.study.axis_selection import listed
from gapsweep.study.grid import START
from gapsweep.study.schema import ATTRACTOR
from gapsweep.variables import EXTREMUM, SECTION_POINT

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CURVES = ("representation", START)
# Labels of vertical axes that are shorter than long names.
WORDS = {
    "amplitude": "amplitude",
    "force_max": "largest contact force",
    "contact_share": "share of time in contact",
    "energy_lost": "energy lost per forcing period",
    "contact_x_max": "peak relative displacement",
    "contact_x_min": "trough relative displacement",
    "extrema": "steady extrema",
    "section_x": "section displacement",
    "section_v": "section velocity",
    "contact_section_x": "relative displacement",
    "contact_section_v": "relative velocity",
}
_HISTORY, _BIN = "history", "frequency_bin"
_ERRORS = 3.0  # standard errors of an exponent, beyond which its sign counts as certain
_FEW = 500  # section points, up to which dots are larger
_DECADES = 3.0  # decades of amplitude in a waterfall
_RISE = 4.0  # height of its largest peak, in rows
_MOST_TICKS = 9
_WORTH = 1e-2  # of the largest amplitude: smallest one that sets the horizontal axis
_MARGIN = 1.1  # beyond the highest frequency of a waterfall


def bifurcation(
    dataset: xr.Dataset,
    /,
    variable: str = "extrema",
    *,
    along: str | None = None,
    branches: xr.Dataset | None = None,
    ax: "Axes | None" = None,
    **wanted: Any,
) -> "Axes":
    """Bifurcation diagram: steady extrema, or section points, for all initial conditions.

    Unresolved responses have a pale band and set no axis: their dots may be outside it. Marks of
    responses that are not periodic are hollow, and red in a plot of a single representation;
    triangles show the direction of sweeps.

    Parameters
    ----------
    dataset : Dataset
        ``responses.nc``, or a part of it.
    variable : str
        ``"extrema"``; ``"section_x"`` or ``"section_v"``: the stroboscopic (Poincaré) section, of
        which a response of period n has n points; of systems also ``"contact_section_x"``.
    along, ax, **wanted
        As for `GapsweepAccessor.frequency_response`.
    branches : Dataset, optional
        Periodic orbits continued along the same axis, as `gapsweep.branches` returns them: the
        largest and smallest displacements of the branches of this parameter set are lines behind
        the extrema, dashed where unstable, with their special points.
    """
    is_section = variable != "extrema"
    along = axis_of(dataset, along, wanted)
    inner = SECTION_POINT if is_section else EXTREMUM
    shown = scene_along(
        dataset, along, {variable: (*CURVES, inner), "response_class": CURVES}, wanted
    )
    if branches is not None and (its := of_branches.default_axis(branches)) != along:
        raise DatasetError(f"branches: continued along {its}, and this plot is along {along}")
    axes = axes_of(ax)
    if variable in ("extrema", "section_x"):
        marks.put(axes, backdrop.walls(shown, along))
    if not is_section:
        of_branches.behind(axes, branches, shown, along, ("x_max", "x_min"))
    words = WORDS.get(variable, "")
    return dots(axes, shown, variable, along, axis_label(shown[variable], words))


def dots(axes: "Axes", shown: xr.Dataset, variable: str, along: str, label: str) -> "Axes":
    """Draw marks of a variable for every response, hollow if it is not periodic."""
    labels = labels_of(shown)
    other = NOT_PERIODIC if len(labels) == 1 else ""
    # Any variable is drawn in the same way as extrema.
    renamed = drawing.with_setting(shown.rename({variable: "extrema"}), "extrema")
    for name, look in looks(labels).items():
        one = renamed.sel(representation=name)
        marks.put(axes, drawing.extrema(one, along, other=other, marker=look.marker))
        marks.put(axes, [marks.key(entry=name, colour=look.colour, marker=look.marker)])
    marks.put(axes, drawing.key_of_marks(shown, variable, other), backdrop.unresolved(shown, along))
    axes.set_ylabel(label)
    return finished(axes, shown, along)


def lyapunov(
    dataset: xr.Dataset, /, *, along: str | None = None, ax: "Axes | None" = None, **wanted: Any
) -> "Axes":
    """Largest Lyapunov exponent [1/s] over a parameter.

    Dots: periodic responses, whose exponent follows from the Floquet multipliers. Hollow: not
    periodic, with bars of three standard errors. Above the zero line a response is chaotic.

    Parameters
    ----------
    dataset : Dataset
        ``responses.nc``, or a part of it.
    along, ax, **wanted
        As for `GapsweepAccessor.frequency_response`.
    """
    along = axis_of(dataset, along, wanted)
    names = ("lyapunov", "lyapunov_error", "response_class")
    shown = scene_along(dataset, along, dict.fromkeys(names, CURVES), wanted)
    axes, labels = axes_of(ax), labels_of(shown)
    x = np.repeat(drawn(shown[along]), shown.sizes[START])
    marks.put(axes, [marks.level(y=0.0, colour=GREY, size=0.8)])
    for name in labels:
        one = shown.sel(representation=name).transpose(along, START)
        value, error = (one[each].values.ravel() for each in names[:2])
        kind = one["response_class"].values.ravel()
        for is_periodic, face in ((True, ""), (False, "none")):
            here = ((kind == ResponseClass.PERIODIC) == is_periodic) & np.isfinite(value)
            here &= kind != ResponseClass.UNRESOLVED
            if not here.any():
                continue
            shade = colour(name) if is_periodic or len(labels) > 1 else NOT_PERIODIC
            series = name if is_periodic else f"{name}, not periodic"
            look: dict[str, Any] = {"colour": shade, "series": series}
            at, y, half = x[here], value[here], _ERRORS * np.nan_to_num(error[here])
            if not is_periodic:
                marks.put(axes, [marks.bars(at, y - half, y + half, size=0.8, **look)])
            size = 2.5 if is_periodic else 3.5
            marks.put(axes, [marks.points(x=at, y=y, size=size, face=face, entry=series, **look)])
    marks.put(axes, backdrop.unresolved(shown, along))
    axes.set_ylabel(axis_label(shown["lyapunov"]))
    return finished(axes, shown, along)


def basin_shares(
    dataset: xr.Dataset,
    /,
    *,
    along: str | None = None,
    ax: "Axes | None" = None,
    **wanted: Any,
) -> "Axes":
    """Share of the initial conditions that lead to each attractor, a line per attractor.

    Attractors are continued along the axis (`with_tracks`). Bars are 1.96 standard errors; an
    attractor that only sweeps reach has no share.

    Parameters
    ----------
    dataset : Dataset
        ``attractors.nc``, or a part of it.
    along, ax, **wanted
        As for `GapsweepAccessor.frequency_response`; one representation must be left.
    """
    along = axis_of(dataset, along, wanted)
    names = ("x_max", "x_min", "period_multiple", "basin_share", "basin_share_error")
    shown = scene_along(dataset, along, dict.fromkeys(names, (ATTRACTOR,)), wanted)
    shown, axes = with_tracks(shown, along), axes_of(ax)
    track = shown["track"].values
    for number in range(int(track.max(initial=-1)) + 1):
        values, places_of = np.nonzero(track == number)
        at = {along: xr.DataArray(values), ATTRACTOR: xr.DataArray(places_of)}
        one = shown.isel(at)
        x, share = drawn(shown[along])[values], one["basin_share"].values
        half = 1.96 * one["basin_share_error"].values
        (entry,) = drawing.attractor_names(one["period_multiple"][:1], one["x_max"][:1])
        look = {"colour": NUMBERED[number % len(NUMBERED)], "series": f"{number}: {entry}"}
        ends = np.clip(share - half, 0.0, 1.0), np.clip(share + half, 0.0, 1.0)
        gaps = np.flatnonzero(np.diff(values) > 1) + 1
        line = (np.insert(each, gaps, np.nan) for each in (x, share))
        curve = dict(zip("xy", line, strict=True)) | {"size": 1.2, "dots": 3.0, "entry": entry}
        interval = marks.bars(x, *ends, size=3.0, opacity=0.4, zorder=1.5, **look)
        marks.put(axes, [interval, marks.line(**curve, **look)])
    axes.set(ylabel="share of the initial conditions", ylim=(-0.02, 1.02))
    return finished(axes, shown, along)


def poincare(
    dataset: xr.Dataset,
    /,
    variable: str = "section_x",
    *,
    n_points: int = 10_000,
    ax: "Axes | None" = None,
    **wanted: Any,
) -> "Axes":
    """Stroboscopic section of one steady response of each representation, in many points.

    Files hold a few section points: the response is simulated from the first one. 10,000 forcing
    periods take tenths of a second. A periodic response has a point for each of its periods.

    Parameters
    ----------
    dataset : Dataset
        ``responses.nc`` or ``attractors.nc``, or a part of it with the full state.
    variable : str
        ``"section_x"``, or of systems ``"contact_section_x"``: relative displacement and velocity
        at a contact.
    n_points : int
        Forcing periods, ``> 0``.
    ax : Axes, optional
        Drawn into; new ones if None.
    **wanted
        Selection by coordinate: all but `representation` must have one value.
    """
    pair = variable, variable.replace("section_x", "section_v")
    shown = scene(dataset, dict.fromkeys(pair, ("representation", SECTION_POINT)), wanted)
    axes = axes_of(ax)
    factors = [shown_unit(shown[name])[0] for name in pair]
    for at, run in motions(dataset, ("representation",), wanted, n_points):
        name, direction = labels_of(shown)[at[0]], weights(run, shown, variable)
        n = direction.size
        x, v = run.section[:, :n] @ direction, run.section[:, n : 2 * n] @ direction
        look: dict[str, Any] = {"colour": colour(name), "series": name}
        size = 0.8 if len(x) > _FEW else 2.5
        marks.put(axes, [marks.points(x=factors[0] * x, y=factors[1] * v, size=size, **look)])
        marks.put(axes, [marks.key(entry=name, colour=colour(name))])
    labels = [axis_label(shown[name], WORDS.get(name, "")) for name in pair]
    axes.set(xlabel=labels[0], ylabel=labels[1])
    return titled(axes, shown)


def waterfall(
    dataset: xr.Dataset,
    /,
    variable: str = "section_x",
    *,
    along: str | None = None,
    ax: "Axes | None" = None,
    **wanted: Any,
) -> "Axes":
    """Amplitude spectra of steady displacements, one above the other over a parameter.

    ``histories.nc`` has the spectra. Each response of ``responses.nc`` is simulated for 60 forcing
    periods from its first section point on, with 256 samples a period and a Hann window. Heights
    are logarithmic over three decades, as the bar at the right shows; smaller amplitudes are flat.
    The mean displacement is left out.

    Parameters
    ----------
    dataset : Dataset
        ``histories.nc`` or ``responses.nc``, or a part of it.
    variable : str
        The displacement, as for `poincare`; for ``histories.nc`` always its `spectrum`.
    along : str, optional
        Parameter of the rows; None: omega, or the only swept number.
    ax : Axes, optional
        Drawn into; new ones if None.
    **wanted
        Selection by coordinate: all but `along` must have one value.
    """
    along = axis_of(dataset, along, wanted)
    rows: _Rows = []
    if "spectrum" in dataset:
        variable, shown = "spectrum", _histories(dataset, along, wanted)
        pair = (shown[name].transpose(_HISTORY, _BIN).values for name in ("frequency", variable))
        for number, (frequency, amplitude) in enumerate(zip(*pair, strict=True)):
            there = np.isfinite(amplitude)
            rows.append((number, frequency[there], amplitude[there]))
    else:
        shown = scene_along(dataset, along, {variable: (along, SECTION_POINT)}, wanted)
        n = N_PERIODS * SAMPLES_PER_PERIOD
        for at, run in motions(dataset, (along,), wanted, N_PERIODS, once=False):
            q = run.sample(run.t_end * np.arange(n) / n)[0].reshape(n, -1)
            x = q @ weights(run, shown, variable)
            rows.append((at[0], np.fft.rfftfreq(n, run.t_end / n), spectrum(x)))
    # Without the mean, which a Hann window has in the first two bins.
    rows = [(at, f[2:], a[2:]) for at, f, a in rows if a.size]
    if not rows:
        raise DatasetError(f"{variable}: no motion here has a spectrum; all of them failed")
    axes = axes_of(ax)
    _ridges(axes, shown[along], rows, shown_unit(shown[variable]))
    if _HISTORY in shown.dims:
        shown = shown.isel({_HISTORY: 0}).drop_vars(along)
    return titled(axes, shown)


# Rows: position along the parameter, frequencies [Hz] and amplitudes.
_Rows = list[tuple[int, Array, Array]]


def _histories(dataset: xr.Dataset, along: str, wanted: Mapping[str, Any]) -> xr.Dataset:
    """Selected spectra of ``histories.nc``; DatasetError unless only `along` varies."""
    shown = scene(dataset, {"spectrum": (_HISTORY, _BIN)}, wanted)
    if along not in shown.coords or _HISTORY not in shown[along].dims:
        raise DatasetError(f"{along}: no parameter of these histories; choose, as along='omega'")
    for name in places(shown):
        values = np.unique(shown[name].values)
        if name != along and len(values) > 1:
            why = f"{name}: this plot has room for one value and the histories have"
            raise DatasetError(f"{why} {listed(values)}; choose: {name}={values[0].item()!r}")
    return shown


def _ridges(axes: "Axes", places: xr.DataArray, rows: _Rows, unit: tuple[float, str]) -> None:
    """Draw spectra as lines with logarithmic heights, each line in front of the one above."""
    at = drawn(places)
    rows = sorted(rows, key=lambda row: float(at[row[0]]))
    largest = max(float(amplitude.max()) for _, _, amplitude in rows)
    floor = largest * 10.0**-_DECADES or 1.0
    highest = max(f[a > _WORTH * largest].max(initial=0.0) for _, f, a in rows) or rows[0][1][-1]
    ground = axes.get_facecolor()
    for row, (_, frequency, amplitude) in enumerate(rows):
        here = frequency <= _MARGIN * highest
        height = np.log10(np.maximum(amplitude[here] / floor, 1.0)) * _RISE / _DECADES
        order = 3.0 - row / len(rows)
        axes.fill_between(frequency[here], row, row + height, color=ground, zorder=order)
        look: dict[str, Any] = {"size": 0.7, "zorder": order}
        marks.put(axes, [marks.line(x=frequency[here], y=row + height, **look)])
    if places.name == "omega":
        line = {"x": [at[n] for n, _, _ in rows], "y": range(len(rows))}
        look = {"colour": NUMBERED[1], "dashes": "--", "zorder": 4.0}
        marks.put(axes, [marks.line(entry="forcing frequency", **line, **look)])
    ticks = np.unique(np.linspace(0, len(rows) - 1, _MOST_TICKS).round().astype(int))
    axes.set_yticks(ticks, [f"{at[rows[i][0]]:.4g}" for i in ticks])
    axes.set(xlabel="frequency [Hz]", ylabel=axis_label(places))
    axes.set(xlim=(0.0, _MARGIN * highest), ylim=(-0.5, len(rows) - 0.5 + _RISE))
    axes.grid(visible=False)
    side: dict[str, Any] = {"transform": axes.get_yaxis_transform(), "clip_on": False}
    ends = len(rows) - 1.0, len(rows) - 1.0 + _RISE
    axes.plot([1.02, 1.02], ends, color="black", linewidth=1.5, **side)
    for height, value in zip(ends, (floor, largest), strict=True):
        axes.text(1.03, height, f"{unit[0] * value:.2g} {unit[1]}", va="center", fontsize=8, **side)
