"""Figures 6 to 11 of the paper, each from a scene's dataset to a matplotlib figure.

`figures` says which scene each of them shows.
"""

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from gapsweep.report import drawing
from gapsweep.report.drawing import MANY, WALL, labels_of
from gapsweep.report.style import colour
from gapsweep.response.result import ResponseClass
from gapsweep.status import Status

_MM = 1e3
_WIDTH = 9.5  # inches, the report's column
_EXACT = "piecewise"
# Backgrounds by response class: light enough for every point colour, and told apart by depth.
_CHAOTIC, _UNRESOLVED, _FAILED = "#fbd9d3", "#c8d8e6", "#8a8a8a"
_RIM = 1.8  # of the exact law's points around those of a stand-in, points
# A peak so many wall distances out needs a logarithmic axis beside motions within the gap.
_FAR = 4.0
SHOWN_PERIODS = 6
_SHOWN_HARMONICS = 5
# Lines of a spectrum are shown over so many decades.
_DECADES = 5


def peak_curves(scene: xr.Dataset) -> Figure:
    """Peak displacement over frequency from all starts, a panel per representation.

    The exact law is drawn in black, alone and then behind each of the others: black that shows
    is missed, colour without black is invented.

    Parameters
    ----------
    scene : Dataset
        One stiffness and gap; dimensions representation, omega, initial_condition.
    """
    labels = labels_of(scene)
    n_columns = min(3, len(labels))
    n_rows = -(-len(labels) // n_columns)
    figure = Figure(figsize=(_WIDTH, 0.7 + 2.5 * n_rows), layout="constrained")
    panels = figure.subplots(n_rows, n_columns, sharex=True, sharey=True, squeeze=False)
    low, high = _peak_range(scene)
    size = _marker_size(scene, n_columns)
    exact = next((label for label in labels if _law(label) == _EXACT), None)
    for axes, label in zip(panels.flat, labels, strict=False):
        drawing.walls(axes, scene)
        if exact is not None:
            rim = 0.0 if label == exact else _RIM
            drawing.peaks(axes, scene.sel(representation=exact), size + rim, high)
        if label != exact:
            drawing.peaks(axes, scene.sel(representation=label), size, high)
        axes.set_title(label, fontsize=9, loc="left")
        _note_failures(axes, scene.sel(representation=label))
    _scale_peaks(panels, scene, low, high)
    _finish(scene, panels, len(labels), "peak displacement [mm]")
    return figure


def stacked_bifurcations(scene: xr.Dataset) -> Figure:
    """All steady extrema over frequency, a panel per representation on common axes.

    Parameters
    ----------
    scene : Dataset
        One stiffness, gap and start; dimensions representation, omega.
    """
    labels = labels_of(scene)
    figure = Figure(figsize=(_WIDTH, 1.0 + 1.35 * len(labels)), layout="constrained")
    panels = figure.subplots(len(labels), 1, sharex=True, sharey=True, squeeze=False)
    for axes, label in zip(panels.flat, labels, strict=True):
        one = scene.sel(representation=label)
        _class_bands(axes, one)
        drawing.walls(axes, scene)
        extrema = one["extrema"].transpose("omega", "extremum").values * _MM
        omega = np.broadcast_to(one["omega"].values[:, None], extrema.shape)
        shown = np.isfinite(extrema)
        axes.plot(
            omega[shown],
            extrema[shown],
            "o",
            color=colour(label),
            markersize=_marker_size(scene, 1),
            markeredgewidth=0.0,
            rasterized=bool(shown.sum() > MANY),
        )
        axes.grid(axis="y", visible=False)
        axes.set_title(label, fontsize=9, loc="left", pad=3)
        _note_failures(axes, one)
    _limit_to_exact(list(panels.flat), scene)
    _finish(scene, panels, len(labels), "")
    figure.supylabel("steady extrema [mm]", fontsize=9)
    bands = {"chaotic": _CHAOTIC, "unresolved": _UNRESOLVED, "failed": _FAILED}
    handles: list[Artist] = [Patch(color=shade, label=name) for name, shade in bands.items()]
    handles.append(Line2D([], [], **WALL, label="wall"))
    figure.legend(handles=handles, loc="outside upper right", ncols=4, fontsize=8)
    return figure


def histories_and_spectra(histories: xr.Dataset) -> Figure:
    """Steady displacement and its amplitude spectrum, for every history side by side.

    Parameters
    ----------
    histories : Dataset
        Dimensions history, representation, part, sample, frequency_bin.
    """
    labels = labels_of(histories)
    n = histories.sizes["history"]
    figure = Figure(figsize=(_WIDTH, 1.0 + 1.45 * len(labels)), layout="constrained")
    panels = figure.subplots(
        len(labels), 2 * n, sharex="col", squeeze=False, width_ratios=[1.15, 1.0] * n
    )
    for h in range(n):
        one = histories.isel(history=h)
        omega = float(one["omega"])
        motion, lines = panels[:, 2 * h], panels[:, 2 * h + 1]
        for row, label in enumerate(labels):
            _motion(motion[row], one.sel(representation=label), colour(label))
            _spectrum(lines[row], one.sel(representation=label), colour(label))
        for column in (motion, lines):
            for axes in column[1:]:
                axes.sharey(column[0])
        motion[0].set_title(f"{omega:g} Hz: displacement [mm]", fontsize=9, loc="left", pad=15)
        lines[0].set_title("amplitude [mm]", fontsize=9, loc="left", pad=15)
        motion[-1].set_xlabel("forcing periods")
        lines[-1].set_xlabel(f"frequency / {omega:g} Hz")
        _spectrum_limits(lines[0], one)
    for axes, label in zip(panels[:, 0], labels, strict=True):
        axes.set_ylabel(label, fontsize=8)
    return figure


def _law(label: str) -> str:
    return label.partition("@")[0]


def _peak_range(scene: xr.Dataset) -> tuple[float, float]:
    """Common axis [mm]: room for the exact law, and for what others add within reason."""
    exact = next((label for label in labels_of(scene) if _law(label) == _EXACT), None)
    peaks = scene["x_max"].values * _MM
    top = np.nanmax(peaks, initial=0.0)
    if exact is not None:
        reach = np.nanmax(scene["x_max"].sel(representation=exact).values * _MM, initial=0.0)
        top = min(top, 1.5 * reach) if reach > 0.0 else top
    low = max(-top, np.nanmin(peaks, initial=0.0))
    margin = 0.05 * (top - low) or 1.0
    return float(low - (margin if low else 0.0)), float(top + margin)


def _marker_size(scene: xr.Dataset, n_columns: int) -> float:
    """Diameter [points] at which neighbouring frequencies just do not touch, within reason."""
    spacing = 60.0 * _WIDTH / n_columns / scene.sizes["omega"]
    return float(np.clip(0.6 * spacing, 1.3, 2.4))


def _scale_peaks(panels: np.ndarray, scene: xr.Dataset, low: float, high: float) -> None:
    """Linear; logarithmic beyond a quarter of the wall distance if the peaks go far out."""
    wall = max(float(scene["j_1"]), float(scene["j_2"])) * _MM
    linear = 0.25 * wall
    is_far = 0.0 < _FAR * wall < high
    for axes in panels.flat:
        axes.set_ylim(low, high)
        if is_far:
            axes.set_yscale("symlog", linthresh=linear, linscale=0.5)
            axes.set_ylim(max(low, np.nanmin(scene["x_max"]) * _MM - 0.3 * linear), 1.2 * high)
            ticks = [0.0, *(n * 10.0**k for k in range(-2, 4) for n in (1, 3))]
            axes.set_yticks([tick for tick in ticks if tick == 0.0 or linear <= tick <= high])
            axes.yaxis.set_major_formatter("{x:g}")
            axes.minorticks_off()


def _limit_to_exact(panels: list[Axes], scene: xr.Dataset) -> None:
    """Common axis with room for the exact law; extrema far outside it become triangles."""
    labels = labels_of(scene)
    bounds = {
        label: (
            np.fmin.reduce(scene["x_min"].sel(representation=label).values, initial=np.inf) * _MM,
            np.fmax.reduce(scene["x_max"].sel(representation=label).values, initial=-np.inf) * _MM,
        )
        for label in labels
    }
    low = min(low for low, _ in bounds.values())
    high = max(high for _, high in bounds.values())
    if not low <= high:  # there is no result at all
        return
    own = bounds.get(next((label for label in labels if _law(label) == _EXACT), ""), (low, high))
    if np.all(np.isfinite(own)):
        spare = 0.75 * (own[1] - own[0])
        low, high = max(low, own[0] - spare), min(high, own[1] + spare)
    margin = 0.06 * (high - low) or 1.0
    low, high = low - margin, high + margin
    panels[0].set_ylim(low, high)
    for axes, label in zip(panels, labels, strict=True):
        one = scene.sel(representation=label)
        omega = one["omega"].values
        drawing.outside(axes, omega[one["x_max"].values * _MM > high], high, "^", label)
        drawing.outside(axes, omega[one["x_min"].values * _MM < low], low, "v", label)


def _class_bands(axes: Axes, one: xr.Dataset) -> None:
    """Shade the frequencies whose response is not periodic, by its class."""
    omega = one["omega"].values
    edges = np.concatenate([omega[:1], 0.5 * (omega[1:] + omega[:-1]), omega[-1:]])
    kinds = one["response_class"].values
    failed = one["status"].values > Status.OUT_OF_FIT_RANGE
    for where, shade in (
        ((kinds == ResponseClass.CHAOTIC) & ~failed, _CHAOTIC),
        ((kinds == ResponseClass.UNRESOLVED) & ~failed, _UNRESOLVED),
        (failed, _FAILED),
    ):
        turns = np.flatnonzero(np.diff(where, prepend=False, append=False))
        spans = [(edges[a], edges[b] - edges[a]) for a, b in turns.reshape(-1, 2)]
        axes.broken_barh(
            spans,
            (0.0, 1.0),
            transform=axes.get_xaxis_transform(),
            color=shade,
            linewidth=0.0,
            zorder=0,
        )


def _note_failures(axes: Axes, one: xr.Dataset) -> None:
    """Counts that must not go unseen, beside the panel's title."""
    status = one["status"].values
    counts = {
        "unresolved": status == Status.UNRESOLVED,
        "beyond the fit": status == Status.OUT_OF_FIT_RANGE,
        "failed": status > Status.OUT_OF_FIT_RANGE,
    }
    note = ", ".join(f"{n.sum()} {name}" for name, n in counts.items() if n.any())
    axes.set_title(note, fontsize=7, loc="right", color="#555555")


def _finish(scene: xr.Dataset, panels: np.ndarray, n: int, ylabel: str) -> None:
    """Labels on the outer axes only, a common frequency axis, no empty panels."""
    omega = scene["omega"].values
    pad = 0.01 * float(omega.max() - omega.min()) or 0.5
    n_columns = panels.shape[1]
    for i, axes in enumerate(panels.flat):
        if i >= n:
            axes.set_visible(False)
            continue
        axes.set_xlim(max(0.0, float(omega.min()) - pad), float(omega.max()) + pad)
        if i + n_columns >= n:
            axes.set_xlabel("forcing frequency [Hz]")
            axes.xaxis.set_tick_params(labelbottom=True)
        if i % n_columns == 0 and ylabel:
            axes.set_ylabel(ylabel)


def kind(one: xr.Dataset) -> str:
    """What a motion is, in a word."""
    status = Status(int(one["status"]))
    if not np.isfinite(one["x"]).any():
        return status.label.replace("_", " ")
    n = int(one["period_multiple"])
    return f"P{n}" if n else "no period"


def _motion(axes: Axes, one: xr.Dataset, shade: str) -> None:
    """The last periods, counted from the first one shown."""
    steady = one.sel(part="steady")
    periods = steady["t"].values * float(one["omega"])
    end = np.nanmax(periods, initial=0.0)
    shown = periods > np.round(end) - SHOWN_PERIODS - 1e-9
    first = np.round(end) - SHOWN_PERIODS
    drawing.walls(axes, one)
    axes.plot(periods[shown] - first, steady["x"].values[shown] * _MM, color=shade, linewidth=1.1)
    axes.set_xlim(0.0, SHOWN_PERIODS)
    axes.set_xticks(range(SHOWN_PERIODS + 1))
    axes.text(1.0, 1.02, kind(one), transform=axes.transAxes, ha="right", va="bottom", fontsize=8)


def _spectrum(axes: Axes, one: xr.Dataset, shade: str) -> None:
    omega = float(one["omega"])
    multiple = one["frequency"].values / omega
    shown = multiple <= _SHOWN_HARMONICS + 0.5
    axes.plot(multiple[shown], one["spectrum"].values[shown] * _MM, color=shade, linewidth=0.9)
    axes.set_yscale("log")
    axes.minorticks_off()
    axes.set_xlim(0.0, _SHOWN_HARMONICS + 0.5)
    axes.set_xticks(range(_SHOWN_HARMONICS + 1))


def _spectrum_limits(axes: Axes, one: xr.Dataset) -> None:
    top = np.nanmax(one["spectrum"].values, initial=0.0) * _MM
    if top > 0.0:
        axes.set_ylim(top * 10.0**-_DECADES, 2.0 * top)
