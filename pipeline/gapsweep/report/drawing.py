"""Marks of one panel from a dataset, which `marks.put` draws, and texts that explain them.

A function that yields marks names the dimensions that it needs.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.analysis.agreement.jumps import breaks
from gapsweep.model.labels import EXACT, Representation
from gapsweep.report import marks
from gapsweep.report.marks import Marks
from gapsweep.report.scales import drawn, shown_unit
from gapsweep.report.style import GREY, NUMBERED, SWEEPS, WALL, colour, looks
from gapsweep.response.result import ResponseClass
from gapsweep.status import Status

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FEW = 60  # places along an axis, up to which marks are larger
SETS = "sets_axis"
_SPARE = 0.5  # room around the exact law, in widths of its range
_DOT = 12.0  # points², dot of an attractor with an unknown basin share
_FIXED = "fixed"  # coordinate ``start`` of initial conditions that are not swept
_ERRORS = (1e-14, 1e2)
# Variables of a work-precision diagram.
WORK_PRECISION = (
    *("total_error", "cpu_time", "cpu_time_q25", "cpu_time_q75"),
    *("model_error", "status", "on_front", "at_reference_floor"),
)


def labels_of(dataset: xr.Dataset) -> list[Representation]:
    """Representations of a dataset."""
    return [Representation(label) for label in dataset["representation"].values]


def curves(
    variable: xr.DataArray, along: str, kinds: xr.DataArray | None = None
) -> Iterator[Marks]:
    """A curve per representation and initial state, broken at jumps; the exact law thick.

    `variable`: dimensions representation, `along`, initial_condition.
    `kinds`: the ``response_class`` of each value; unresolved responses set no axis.
    """
    setting = variable.notnull() if kinds is None else sets_axis(variable, kinds)
    x, order = drawn(variable[along]), ("initial_condition", along)
    labels = [str(label) for label in variable["representation"].values]
    for label, look in looks(labels).items():
        y = drawn(variable.sel(representation=label).transpose(*order))
        if not np.isfinite(y).any():
            continue
        sets = setting.sel(representation=label).transpose(*order).values
        exact = label == EXACT
        for n, (curve, kind) in enumerate(zip(y, start_kinds(variable), strict=True)):
            # Symbols show the frequencies of an initial condition, which may be every second one,
            # single values between two jumps, and the direction of a sweep.
            there = np.isfinite(curve)
            gaps = breaks(curve[there])
            yield marks.line(
                x=np.insert(x[there], gaps, np.nan),
                y=np.insert(curve[there], gaps, np.nan),
                sets=np.insert(sets[n, there], gaps, False),
                series=label,
                entry=label if n == 0 else "",  # one per law
                colour=look.colour,
                size=2.2 if exact else 1.2,
                dashes=look.dashes,
                marker=SWEEPS.get(kind, "o"),
                dots=(2.5 if exact else 1.5) * (1.6 if kind in SWEEPS else 1.0),
                zorder=1.0 if exact else 2.0,
            )


def start_kinds(shown: Any) -> list[str]:
    """``fixed``, ``sweep_up`` or ``sweep_down`` for each initial condition."""
    kinds = shown.coords["start"].values if "start" in shown.coords else _FIXED
    names: list[str] = np.broadcast_to(kinds, shown.sizes.get("initial_condition", 1)).tolist()
    return names


def key_of_marks(shown: xr.Dataset, variable: str = "", other: str = "") -> Iterator[Marks]:
    """Legend entries of the symbols of a figure: sweeps, and responses that are not periodic.

    `variable`: variable that is drawn; if empty, all responses are drawn alike.
    `other`: colour of responses that are not periodic; empty: grey.
    """
    for kind in SWEEPS:
        if kind in start_kinds(shown):
            yield marks.key(entry=kind, colour=GREY, marker=SWEEPS[kind])
    if variable:
        is_other = shown["response_class"] != ResponseClass.PERIODIC
        if shown[variable].where(is_other).notnull().any():
            yield marks.key(entry="not periodic", colour=other or GREY, face="none")


def extrema(
    one: xr.Dataset, along: str, *, other: str = "", marker: str = "o", size: float = 0.0
) -> Iterator[Marks]:
    """All steady extrema of one representation: filled if periodic, else hollow.

    Parameters
    ----------
    one : Dataset
        ``extrema(along, initial_condition, extremum)``, ``response_class`` and `SETS`.
    other : str
        Colour of responses that are not periodic; empty: the colour of the representation.
    marker : str
        Symbol of matplotlib for initial conditions that are not swept.
    size : float
        Diameter of filled marks [points]; hollow ones are larger. 0: by the number of places.
    """
    own, size = colour(_label(one)), size or (3.0 if one.sizes[along] <= FEW else 1.6)
    for points, look in _by_mark(one, "extrema", along, marker):
        is_hollow = bool(look["face"])
        look |= {"colour": (is_hollow and other) or own, "size": size + 0.8 * is_hollow}
        yield marks.points(**points, **look)


def peaks(
    one: xr.Dataset,
    size: float,
    low: float = -np.inf,
    high: float = np.inf,
    *,
    along: str = "omega",
) -> Iterator[Marks]:
    """Peaks of one representation: filled if periodic, else hollow; ticks at the frame.

    `one`: ``x_max(along, initial_condition)``, ``response_class`` and `SETS`.
    `size`: diameter [points].
    `low` and `high`: edges of the frame; a tick marks a point beyond them.
    """
    label = _label(one)
    for points, look in _by_mark(one, "x_max", along):
        x, y = points["x"], points["y"]
        inside = (y >= low) & (y <= high)
        points = {name: values[inside] for name, values in points.items()}
        yield marks.points(**points, **look, colour=colour(label), size=size)
        yield from outside(x[y < low], low, label)
        yield from outside(x[y > high], high, label)


def _by_mark(
    one: xr.Dataset, name: str, along: str, marker: str = "o"
) -> Iterator[tuple[dict[str, NDArray[Any]], dict[str, Any]]]:
    """Points of one representation, with style, by initial condition and periodicity."""
    values = drawn(one[name].transpose(along, "initial_condition", ...))
    places = drawn(one[along]).reshape(-1, *[1] * (values.ndim - 1))
    kinds = one["response_class"].transpose(along, "initial_condition")
    sets, of_start = one[SETS].transpose(*kinds.dims, ...).values, np.array(start_kinds(one))
    columns = {"x": np.broadcast_to(places, values.shape), "y": values, "sets": sets}
    for word, face in (("not periodic", "none"), ("periodic", "")):
        is_kind = (kinds.values == ResponseClass.PERIODIC) == (not face)
        for kind in dict.fromkeys(of_start.tolist()):
            chosen = (is_kind & (of_start == kind))[(..., *[None] * (values.ndim - 2))]
            shown = chosen & np.isfinite(values)
            series = ", ".join(part for part in (_label(one), kind, word) if part != _FIXED)
            look = {"marker": SWEEPS.get(kind, marker), "face": face, "series": series}
            yield {column: each[shown] for column, each in columns.items()}, look


def caption_of_marks(figure: "Figure") -> str:
    """Caption sentences on hollow dots and ticks, with leading blanks; empty without any."""
    series = {each.series for axes in figure.axes for each in marks.marks_of(axes)}
    kinds = {
        "not periodic": " Hollow: not periodic.",
        "outside": " Ticks on the frame: outside the axes.",
    }
    return "".join(v for kind, v in kinds.items() if any(name.endswith(kind) for name in series))


def frame(scene: xr.Dataset, lowest: str, exact: str) -> tuple[float, float]:
    """Limits of a common axis: range of the exact law, extended by up to half of it for others.

    `lowest`: the variable of the lower limit; ``x_max`` is the variable of the upper limit.
    `exact`: the exact law's label.
    """
    bottom, top = (
        drawn(scene[name].where(sets_axis(scene[name], scene["response_class"])))
        for name in (lowest, "x_max")
    )
    is_exact = scene["representation"].values == exact
    if not np.isfinite(top[is_exact]).any():
        is_exact[:] = True
    low, high = np.nanmin(bottom, initial=np.inf), np.nanmax(top, initial=-np.inf)
    if not low <= high:  # without any result
        return -1.0, 1.0
    own_low, own_high = np.nanmin(bottom[is_exact]), np.nanmax(top[is_exact])
    spare = _SPARE * (own_high - own_low)
    low, high = max(low, own_low - spare), min(high, own_high + spare)
    margin = 0.06 * (high - low) or 1.0
    return float(low - margin), float(high + margin)


def outside(omega: Any, edge: float, label: str) -> Iterator[Marks]:
    """Ticks on the edge of the frame for points beyond it."""
    if len(omega):
        look: dict[str, Any] = {"marker": "|", "size": 5.0, "is_clipped": False}
        heights = np.full(len(omega), edge)
        series = f"{label}, outside"
        yield marks.points(x=omega, y=heights, series=series, colour=colour(label), **look)


def attractor_peaks(one: xr.Dataset, along: str) -> Iterator[Marks]:
    """The peak of every attractor of one representation; dot area grows with basin share.

    `one`: ``x_max(along, attractor)``, ``basin_share`` and ``response_class``.
    """
    order = (along, "attractor")
    height = drawn(one["x_max"].transpose(*order))
    x = np.broadcast_to(drawn(one[along])[:, None], height.shape)
    share = one["basin_share"].transpose(*order).values
    # Attractors that only sweeps reach have no share: a dot of fixed size.
    size = np.sqrt(np.where(np.isfinite(share), 4.0 + 20.0 * share, _DOT))
    periodic = one["response_class"].transpose(*order).values == ResponseClass.PERIODIC
    for where, face, kind in ((periodic, "", "periodic"), (~periodic, "none", "not periodic")):
        shown = where & np.isfinite(height)
        look = {"colour": colour(_label(one)), "face": face, "series": f"{_label(one)}, {kind}"}
        yield marks.points(x=x[shown], y=height[shown], size=size[shown], **look)


def caption_of_peaks(found: xr.Dataset) -> str:
    """Caption sentence on the dots of attractors, with a leading blank, or empty."""
    has_peak = np.isfinite(found["x_max"].values)
    kinds = {*np.unique(found["response_class"].values[has_peak]).tolist()}
    rest = " or in equilibrium" if ResponseClass.EQUILIBRIUM in kinds else ""
    words = []
    if np.isfinite(found["basin_share"].values).any():
        words.append("Dot area: share of the initial conditions that lead to the attractor")
    if kinds - {ResponseClass.PERIODIC}:
        words.append(f"{'hollow' if words else 'Hollow'}: not periodic{rest}")
    return f" {'; '.join(words)}." if words else ""


def sections(one: xr.Dataset) -> Iterator[Marks]:
    """The stroboscopic section of every attractor in the phase plane.

    `one`: ``section_x(attractor, section_point)``, ``section_v``, ``period_multiple``, ``x_max``.
    """
    order = ("attractor", "section_point")
    x, v = (drawn(one[name].transpose(*order)) for name in ("section_x", "section_v"))
    for n, name in enumerate(attractor_names(one["period_multiple"], one["x_max"])):
        if np.isfinite(x[n]).any():
            yield _attractor(x[n], v[n], n, name)


def starts(one: xr.Dataset) -> Iterator[Marks]:
    """Fixed initial conditions in the colour of their attractor; a cross without attractor.

    `one`: ``attractor(initial_condition)``, ``period_multiple``, ``x_max``.
    """
    one = one.isel(initial_condition=np.isfinite(one["x_0"].values))
    ids = one["attractor"].values
    x, v = drawn(one["x_0"]), drawn(one["v_0"])
    yield marks.points(x=x[ids < 0], y=v[ids < 0], marker="x", colour=GREY, size=4.0)
    for n in np.unique(ids[ids >= 0]):
        here = ids == n
        first = one.isel(initial_condition=slice(int(np.argmax(here)), int(np.argmax(here)) + 1))
        (name,) = attractor_names(first["period_multiple"], first["x_max"])
        yield _attractor(x[here], v[here], n, name)


def _attractor(x: Any, v: Any, n: int, name: str) -> Marks:
    shade = NUMBERED[n % len(NUMBERED)]
    return marks.points(x=x, y=v, colour=shade, size=5.0, series=name, entry=name)


def attractor_names(period_multiple: xr.DataArray, x_max: xr.DataArray) -> list[str]:
    """Name of each attractor: its period and peak."""
    unit = shown_unit(x_max)[1]
    pairs = zip(period_multiple.values, drawn(x_max), strict=True)
    return [f"{f'P{n}' if n else 'chaotic'}, peak {x:.4g} {unit}" for n, x in pairs]


def summary(
    value: xr.DataArray, interval: xr.DataArray | None, floor: xr.DataArray | None
) -> Iterator[Marks]:
    """A row per representation: number, confidence interval, and reproducibility limit.

    `value`: over representation.
    `interval`: over representation and bound.
    `floor`: one number, of the exact law with other settings.
    """
    labels = [str(label) for label in value["representation"].values]
    for row, (label, number) in enumerate(zip(labels, drawn(value), strict=True)):
        look: dict[str, Any] = {"colour": colour(label), "series": label}
        if interval is not None:
            ends = drawn(interval.sel(representation=label))
            yield marks.line(x=ends, y=[row, row], size=1.2, **look)
        yield marks.points(x=[number], y=[row], size=5.0, **look)
    if floor is not None and np.isfinite(floor):
        words = "exact law, other settings"
        yield marks.level(x=float(drawn(floor)), entry=words, **WALL)


def work_precision(scene: xr.Dataset) -> Iterator[Marks]:
    """Cost over error of every method in one scenario, a point per tolerance; both logarithmic.

    `scene`: the variables `WORK_PRECISION`, over method and tolerance.
    """
    labels = scene["method"].values.tolist()
    shown = (scene["status"] == Status.OK) & (scene["at_reference_floor"] == 0)
    error = scene["total_error"].where(shown).clip(*_ERRORS)
    for label, look in looks(labels).items():
        one, x = scene.sel({"method": label}), error.sel({"method": label}).values
        y, front = one["cpu_time"].values, one["on_front"].values.astype(bool)
        own: dict[str, Any] = {"colour": look.colour, "marker": look.marker}
        yield marks.line(x=x, y=y, dashes=look.dashes, size=0.9, dots=3.0, face="white",
            series=label, entry=label, **own,
        )  # fmt: skip
        quartiles = (one[f"cpu_time_{name}"].values for name in ("q25", "q75"))
        about = {"colour": look.colour, "opacity": 0.6, "series": f"{label}, quartiles"}
        yield marks.bars(x, *quartiles, size=0.6, **about)
        best: dict[str, Any] = {"x": x[front], "y": y[front], "series": f"{label}, on the front"}
        yield marks.points(size=6.0, zorder=4.0, **best, **own)
        ring: dict[str, Any] = {"face": "none", "colour": NUMBERED[1]}
        yield marks.points(size=9.0, zorder=3.0, **best, **ring)
        model = float(one["model_error"].max())
        if model > 0.0:
            edge = {"x_end": (0.0, 0.06), "series": f"{label}, its own error"}
            at = min(model, _ERRORS[1])
            yield marks.level(x=at, colour=look.colour, size=1.4, **edge)
        failed = (one["status"] > Status.NOT_REQUESTED).values & np.isfinite(y)
        if failed.any():
            yield marks.edge(y=y[failed], marker="x", size=5.0, colour=look.colour,
                series=f"{label}, failed",
            )  # fmt: skip
    if failures := _failed_words(scene, labels):
        place: dict[str, Any] = {"x": 0.98, "y": 0.97, "in_data": False, "size": 7.0}
        yield marks.text(series=failures, align=("right", "top"), **place)


def _failed_words(scene: xr.Dataset, labels: list[str]) -> str:
    """Failed methods and their status, one per line."""
    found = []
    for label in labels:
        status = np.unique(scene["status"].sel({"method": label}).values).tolist()
        words = [Status(s).label.replace("_", " ") for s in status if s > Status.NOT_REQUESTED]
        found += [f"× {label}: {word}" for word in words]
    return "\n".join(found[:4] + (["…"] if len(found) > 4 else []))


def _label(one: xr.Dataset) -> str:
    return str(one["representation"].values)


def with_setting(scene: xr.Dataset, name: str) -> xr.Dataset:
    """The parameter set with a variable `SETS`: mask of values that set the axis, for all laws."""
    return scene.assign({SETS: sets_axis(scene[name], scene["response_class"])})


def sets_axis(values: xr.DataArray, kinds: xr.DataArray) -> xr.DataArray:
    """Mask of the values that set the axis: of steady responses, or of all if none is steady.

    An unresolved motion that still grows may be larger than all steady ones.
    """
    known = values.notnull()
    steady = known & (kinds != ResponseClass.UNRESOLVED)
    return steady if steady.any() else known
