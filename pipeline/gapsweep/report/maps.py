"""Maps: one variable over two numeric axes, as a mesh of coloured cells."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.analysis.agreement.law_tables import CHAOTIC, CLASSES, class_numbers
from gapsweep.analysis.dimensions import selected
from gapsweep.errors import DatasetError
from gapsweep.model.labels import EXACT
from gapsweep.report.scales import axis_label, drawn, is_crowded_low, is_log
from gapsweep.report.selection import missing_variable, scene
from gapsweep.report.style import BLANK, CLASS_COLOURS, GREY, NUMBERED, sequence
from gapsweep.response.result import ResponseClass
from gapsweep.status import Status
from gapsweep.variables import flags_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_START = "initial_condition"
MOST_KINDS = 8  # colours that can be distinguished; more whole numbers have a colour bar
_TAIL = 0.005  # share of the numbers at either end that may lie beyond the colour bar
_ALIKE = 0.05  # of the peak: largest difference of matching attractors of two laws
_FAILED = "failed"
_NO_PICTURE = ("unresolved", _FAILED)
_HATCH = "////"
_FINENESS = 2000  # cells of equal width that represent an uneven axis
_LETTERS_PER_INCH = 13.0  # of a legend
_HANDLE = 7  # letters as wide as the handle of an entry and the space after it


@dataclass
class MapImage:
    """Contents of a map: axes, kinds of cells and numbers."""

    # `x`, `y`: shapes (n_x,) and (n_y,).
    x: xr.DataArray
    y: xr.DataArray
    # Shape (n_y, n_x); values of the colour bar; NaN for cells without a number.
    numbers: xr.DataArray
    # Shape (n_y, n_x); position in `names`; -1: the cell shows a number, or is blank.
    kind: NDArray[np.int64]
    # `names`, `colours`: name and colour of each kind.
    names: list[str] = field(default_factory=list)
    colours: list[str] = field(default_factory=list)
    blank: str = "no value"  # meaning of a cell without a colour

    def mark(self, where: NDArray[np.bool_], name: str, colour: str) -> None:
        """Give cells a named kind with a colour, instead of their number."""
        if where.any():
            self.kind[where] = len(self.names)
            self.names.append(name)
            self.colours.append(colour)


_WHOLE = ("period_multiple", "n_attractors")


def picture(
    dataset: xr.Dataset, variable: str, x: str, y: str | None, wanted: Mapping[str, Any]
) -> tuple[MapImage, xr.Dataset]:
    """A map of a variable, and the part of the dataset that it shows.

    Raises `DatasetError` if a variable or coordinate is missing, or another dimension has several
    values.

    `x` and `y`: numeric dimensions, or ``x_0`` and ``v_0`` if the initial conditions form a full
    grid; `y` is the longest other numeric dimension if None.
    `wanted`: as for `gapsweep.analysis.dimensions.selected`; all other dimensions must have one
    value.
    """
    if variable not in dataset.data_vars:
        raise DatasetError(missing_variable(dataset, variable))
    part = selected(dataset, wanted)
    y = next((dim for dim in numeric_axes(part) if dim != x), "K_c") if y is None else y
    for name in (x, y):
        _check_axis(part, name)
    if x == y:
        raise DatasetError(f"{x}: both axes of the map; give two different ones")
    names = [variable, *_companions(part, variable)]
    if _START in part[x].dims and _START in part[y].dims:
        shown = on_grid(scene(part, dict.fromkeys(names, (_START,)), {}), y, x)
    else:
        shown = scene(part, dict.fromkeys(names, (y, x)), {}).sortby([x, y])
    return _picture(shown, variable, x, y), shown


def numeric_axes(dataset: xr.Dataset) -> list[str]:
    """Numeric dimensions with several values, the longest first, without initial conditions."""
    found = [
        str(dim)
        for dim, n in dataset.sizes.items()
        if n > 1 and dim != _START and dim in dataset.coords and dataset[dim].dtype.kind in "iuf"
    ]
    return sorted(found, key=lambda dim: -dataset.sizes[dim])


def on_grid(starts: xr.Dataset, y: str = "v_0", x: str = "x_0") -> xr.Dataset:
    """Variables over initial conditions, reshaped to a grid of two coordinates, without sweeps.

    Raises `DatasetError` if the fixed initial conditions do not form a full grid.
    """
    here = starts.isel({_START: np.isfinite(starts[x].values) & np.isfinite(starts[y].values)})
    others = [name for name, held in here.coords.items() if held.ndim and name not in (x, y)]
    table = here.set_coords([x, y]).drop_vars(others).set_index(initial_condition=[y, x])
    index: Any = table.indexes[_START]
    if not index.size or index.has_duplicates or math.prod(index.levshape) != index.size:
        raise DatasetError(
            f"{x}, {y}: the {index.size} fixed starts are no full grid of the two; attractors() "
            "draws a mark for each"
        )
    grid = table.unstack(_START)
    return grid.assign_coords({name: grid[name].assign_attrs(here[name].attrs) for name in (y, x)})


def numbered_as(starts: xr.Dataset, exact: xr.Dataset) -> xr.Dataset:
    """Number the attractors of a law as the matching attractors of the exact law.

    Two attractors match if their periods are equal and their peaks within `_ALIKE`; the closest
    pair is matched first. Attractors without a match have numbers after those of the exact law.

    `starts` and `exact`: ``attractor(initial_condition)``, ``period_multiple`` and ``x_max`` of
    each law.
    """
    ours, theirs = _attractors(starts), _attractors(exact)
    pairs = sorted(
        (abs(peak - their_peak), own, other)
        for own, (period, peak) in ours.items()
        for other, (their_period, their_peak) in theirs.items()
        if period == their_period and abs(peak - their_peak) <= _ALIKE * abs(their_peak)
    )
    number: dict[int, int] = {}
    for _, own, other in pairs:
        if own not in number and other not in number.values():
            number[own] = other
    free = max(theirs, default=-1) + 1
    for own in ours:
        if own not in number:
            number[own], free = free, free + 1
    found = starts["attractor"].copy()
    for own, other in number.items():
        found = found.where(starts["attractor"] != own, other)
    return starts.assign(attractor=found.assign_attrs(numbered_as=EXACT))


def _attractors(starts: xr.Dataset) -> dict[int, tuple[int, float]]:
    """Period multiple and peak of every attractor that an initial condition leads to."""
    attractor = starts["attractor"].values
    return {
        int(i): (
            int(starts["period_multiple"].values[attractor == i][0]),
            float(np.median(starts["x_max"].values[attractor == i])),
        )
        for i in np.unique(attractor[attractor >= 0])
    }


def draw(axes: "Axes", shown: MapImage) -> None:
    """Draw a map: mesh, colour bar of the numbers, legend of the kinds."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import to_rgba_array

    values = drawn(shown.numbers)
    is_number = (shown.kind < 0) & np.isfinite(values)
    rgba = np.zeros((*values.shape, 4), dtype=np.uint8)
    if is_number.any():
        norm, extend = _norm(values[is_number])
        bar = ScalarMappable(norm, "viridis")
        rgba[is_number] = bar.to_rgba(values[is_number], bytes=True)
        axes.figure.colorbar(bar, ax=axes, label=axis_label(shown.numbers), extend=extend)
    if shown.names:
        palette = np.rint(255 * to_rgba_array(shown.colours)).astype(np.uint8)
        rgba[shown.kind >= 0] = palette[shown.kind[shown.kind >= 0]]
    mesh(axes, shown.x, shown.y, rgba)
    _hatch(axes, shown)
    axes.set_xlabel(axis_label(shown.x))
    axes.set_ylabel(axis_label(shown.y))
    is_blank = not (is_number | (shown.kind >= 0)).all()
    names = shown.names + [f"blank: {shown.blank}"] * is_blank
    # The colour bar has its own label.
    title = "" if is_number.any() else re.sub(", -?[0-9]+: none", "", axis_label(shown.numbers))
    _key(axes, names, shown.colours + [BLANK] * is_blank, title)


def _hatch(axes: "Axes", shown: MapImage) -> None:
    from matplotlib.colors import ListedColormap

    if _FAILED in shown.names:
        ends = (edges(drawn(each), log=is_log(each)) for each in (shown.x, shown.y))
        is_other = shown.kind != shown.names.index(_FAILED)
        cells = np.ma.masked_array(np.ones(is_other.shape), is_other)
        look: dict[str, Any] = {"edgecolor": "white", "linewidth": 0.0, "rasterized": True}
        axes.pcolor(*ends, cells, cmap=ListedColormap(["none"]), hatch=_HATCH, **look)


def _key(axes: "Axes", names: Sequence[str], colours: Sequence[str], title: str) -> None:
    """Add a legend of the kinds below the axes."""
    from matplotlib.patches import Patch

    if not names:
        return
    # As many columns as fit below the axes; a wider legend would squeeze them.
    figure: Any = axes.figure
    wide = figure.get_figwidth() * axes.get_position().width * _LETTERS_PER_INCH
    n_columns = min(4, max(1, int(wide / (max(map(len, names)) + _HANDLE))))
    patches = [
        Patch(facecolor=shade, edgecolor=GREY, linewidth=0.4, label=name)
        for name, shade in zip(names, colours, strict=True)
    ]
    if _FAILED in names:
        patches[names.index(_FAILED)].set(hatch=_HATCH, edgecolor="white", linewidth=0.0)
    axes.legend(
        handles=patches,
        loc="upper left",
        bbox_to_anchor=(0.0, -0.16),
        ncols=n_columns,
        title=title,
        alignment="left",
        fontsize=8,
        title_fontsize=8,
        frameon=False,
    )


def _check_axis(part: xr.Dataset, name: str) -> None:
    if name not in part.coords:
        axes = ", ".join(numeric_axes(part)) or "none"
        raise DatasetError(f"{name}: no coordinate of this dataset; numeric axes: {axes}")
    if part[name].dtype.kind not in "iuf":
        axes = ", ".join(numeric_axes(part)) or "none"
        raise DatasetError(f"{name}: holds text, which is no axis of a map; numeric axes: {axes}")


def _companions(part: xr.Dataset, variable: str) -> list[str]:
    """``status`` and ``response_class``, which explain missing numbers, if of the same dims."""
    needed = ("status", "response_class")
    dims = set(part[variable].dims)
    return [n for n in needed if n in part and n != variable and dims == set(part[n].dims)]


def _picture(shown: xr.Dataset, variable: str, x: str, y: str) -> MapImage:
    # Whole numbers of a masked dataset are floats with NaN: xarray has no missing integers.
    restored = {
        name: each.fillna(Status.NOT_REQUESTED if name == "status" else -1).astype(int)
        for name, each in shown.data_vars.items()
        if each.dtype.kind == "f" and (name in _WHOLE or "flag_values" in each.attrs)
    }
    shown = shown.assign(restored)
    values = shown[variable].transpose(y, x)
    asked = np.ones(values.shape, dtype=bool)
    if "status" in shown:
        asked = shown["status"].transpose(y, x).values != Status.NOT_REQUESTED
    made = MapImage(shown[x], shown[y], values.where(asked), np.full(values.shape, -1))
    classes = shown["response_class"].transpose(y, x).values if "response_class" in shown else None
    if variable == "period_multiple" and classes is not None:
        _mark_periods(made, class_numbers(asked, classes, values.values))
    elif values.dtype.kind in "iu":
        _mark_whole_numbers(made, values.where(asked, -1))
    if classes is not None and variable != "response_class":
        for name in _NO_PICTURE:
            where = asked & (classes == ResponseClass[name.upper()])
            if name not in made.names:
                made.mark(where, name, CLASS_COLOURS[name])
    if "status" in shown and ((made.kind >= 0) | np.isfinite(made.numbers.values) | ~asked).all():
        made.blank = "not requested"
    elif variable == "n_attractors":
        made.blank = "none found, or not requested"
    return made


def _mark_periods(made: MapImage, numbers: NDArray[np.int64]) -> None:
    """Give the cells of each period and of each other class a kind with its colour."""
    shades = sequence(CHAOTIC)
    for number in np.unique(numbers[numbers >= 0]).tolist():
        name = CLASSES[number]
        made.mark(numbers == number, name, CLASS_COLOURS.get(name) or shades[number])
    made.numbers = made.numbers.where(False)


def _mark_whole_numbers(made: MapImage, values: xr.DataArray) -> None:
    """Give the cells of each flag or whole number a kind; more than 8 stay numbers."""
    whole, known = values.values, flags_of(values)
    first = 1 if values.name == "n_attractors" else 0
    there = np.unique(whole[whole >= first]).tolist()
    if not known and len(there) > MOST_KINDS:
        made.numbers = made.numbers.where(whole >= first)
        return
    # Numbers of attractors are names, with the same colour in the maps of all laws.
    is_name = values.name == "attractor" and max(there, default=0) < len(NUMBERED)
    several = sorted(known) or there  # a flag has one colour, whichever others there are
    shades = dict(zip(several, sequence(len(several)), strict=True))
    for number in there:
        shade = NUMBERED[number] if is_name else shades[number]
        name = known.get(number, str(number))
        made.mark(whole == number, name.replace("_", " "), CLASS_COLOURS.get(name, shade))
    made.numbers = made.numbers.where(False)


def _norm(numbers: NDArray[np.float64]) -> tuple[Any, str]:
    """Normalization of a colour bar, without a few outliers, and its ends with outliers."""
    from matplotlib.colors import LogNorm, Normalize

    low, high = (float(end) for end in (numbers.min(), numbers.max()))
    inner = np.quantile(numbers, [_TAIL, 1.0 - _TAIL]).tolist()
    # A few large values at a resonance must not leave one colour for all others.
    if high - low > 3.0 * (inner[1] - inner[0]) > 0.0:
        low, high = inner
    beyond = bool(numbers.min() < low), bool(numbers.max() > high)
    extend = {(True, True): "both", (True, False): "min", (False, True): "max"}
    within = numbers[(numbers >= low) & (numbers <= high)]
    norm = LogNorm if is_crowded_low(within) else Normalize
    return norm(low, high), extend.get(beyond, "neither")


def edges(values: NDArray[np.float64], *, log: bool) -> NDArray[np.float64]:
    """Edges of the cells of an axis, halfway between its values.

    `values`: shape (n,); ascending.
    `log`: whether halfway on a logarithmic axis.
    Result: shape (n + 1,).
    """
    at = np.log(values) if log else values
    if at.size == 1:
        half = 0.05 if log else 0.05 * abs(float(at[0])) or 0.5
        ends = np.array([at[0] - half, at[0] + half])
    else:
        inner = 0.5 * (at[1:] + at[:-1])
        ends = np.concatenate([[2.0 * at[0] - inner[0]], inner, [2.0 * at[-1] - inner[-1]]])
        if at[0] > 0.0 and not log:
            ends[0] = max(ends[0], 0.0)  # positive values have no cells below zero
    return np.exp(ends) if log else ends


def mesh(axes: "Axes", x: xr.DataArray, y: xr.DataArray, cells: NDArray[Any], **style: Any) -> Any:
    """Draw cells as one image, with edges halfway between the values; returns the image.

    `cells`: shape (n_y, n_x, ...); values or colours, as for `matplotlib.axes.Axes.imshow`.
    """
    scaled: dict[int, NDArray[np.float64]] = {}
    for axis, coordinate in ((1, x), (0, y)):
        ends = edges(drawn(coordinate), log=is_log(coordinate))
        which = "yx"[axis]
        axes.set(**{f"{which}scale": "log" if is_log(coordinate) else "linear"})
        axes.set(**{f"{which}lim": (ends[0], ends[-1])})
        scaled[axis] = getattr(axes, f"{which}axis").get_transform().transform(ends)
        cells = _even(cells, scaled[axis], axis)
    limits = axes.get_xlim(), axes.get_ylim()
    # Evenly spaced on the scale, not in the data: matplotlib would transform it a second time.
    look = {"transform": axes.transLimits + axes.transAxes, "interpolation": "none", **style}
    extent = *scaled[1][[0, -1]].tolist(), *scaled[0][[0, -1]].tolist()
    made = axes.imshow(cells, extent=extent, origin="lower", aspect="auto", **look)
    axes.set(xlim=limits[0], ylim=limits[1])
    axes.grid(visible=False)
    return made


def _even(cells: NDArray[Any], ends: NDArray[np.float64], axis: int) -> NDArray[Any]:
    """Cells of equal width along an axis: unchanged, or repeated to fit their edges.

    `ends`: shape (n + 1,); the edges on the scale of the axis.
    """
    even = np.linspace(ends[0], ends[-1], ends.size)
    if np.allclose(ends, even, rtol=0.0, atol=0.01 * (even[1] - even[0])):
        return cells
    middles = np.linspace(ends[0], ends[-1], 2 * _FINENESS + 1)[1::2]
    return np.take(cells, np.searchsorted(ends, middles, side="right") - 1, axis=axis)
