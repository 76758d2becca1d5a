"""Branches of periodic orbits in figures: lines, and special points with their symbols."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gapsweep.continuation.dataset import (
    ATTRACTOR,
    BRANCH,
    CURVE_KIND,
    END_FLAGS,
    STEP,
    VARIABLES,
    special_points,
)
from gapsweep.continuation.special import GRAZES, Special
from gapsweep.errors import DatasetError
from gapsweep.report import marks, scales
from gapsweep.report.marks import Marks
from gapsweep.report.scales import drawn
from gapsweep.report.selection import places, scene
from gapsweep.report.style import GREY, NUMBERED, colour
from gapsweep.status import Status
from gapsweep.study.grid import COORDINATE
from gapsweep.study.schema import COORDINATES
from gapsweep.variables import MULTIPLIER, POINT, to_dataframe

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

FREQUENCY, REPRESENTATION = "frequency", "representation"
_LOOP = "is_loop"
_OF_ORBITS = "stable", "special", "period_multiple"
_LISTED = "period_multiple", MULTIPLIER
KINDS = {
    Special.FOLD: ("o", "fold"),
    Special.PERIOD_DOUBLING: ("s", "period doubling"),
    Special.TORUS: ("D", "Neimark\N{EN DASH}Sacker"),
    Special.BRANCH_POINT: ("^", "branch point"),
    Special.SYMMETRY_BREAKING: ("P", "symmetry breaking"),
    Special.GRAZING: ("v", "graze"),
    Special.HOPF: ("*", "Hopf"),
    Special.UNRESOLVED: ("x", "unresolved"),
    Special.CUSP: ("d", "cusp"),
    Special.RESONANCE_1_1: ("h", "resonance 1:1"),
    Special.RESONANCE_1_2: ("p", "resonance 1:2"),
    Special.BORDER_FOLD: ("<", "border fold"),
    Special.BORDER_FLIP: (">", "border flip"),
}
_MOST_NAMES = 8  # branches in a legend
_FONT, _DARK = 8.0, "#222222"  # points
_LETTERS = 2.1, 1.1  # width and height of a symbol of two letters, in sizes of its font
_WAYS = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1), (1, 0), (-1, 0)])
_MOST_SYMBOLS = 100  # special points of a figure, beyond which markers must do


def shown(found: xr.Dataset, names: Sequence[str], wanted: Mapping[str, Any]) -> xr.Dataset:
    """Dataset of the drawn variables of branches, over branch and step.

    Raises `DatasetError` if the dataset holds no branches, lacks a variable, or has several
    coordinates left.
    """
    found = _checked(found)
    if "period" in found:
        about = {"units": "Hz", "long_name": "frequency of the orbit"}
        found = found.assign({FREQUENCY: (1.0 / found["period"]).assign_attrs(about)})
    if "ends" in found:
        closed = dict(END_FLAGS)["closed"]
        found = found.assign_coords(
            {_LOOP: (found["ends"] == closed) & (found["begins"] == closed)}
        )
    found = found.set_coords({CURVE_KIND} & {*found})
    return scene(found, dict.fromkeys([*names, *_OF_ORBITS], (BRANCH, STEP)), wanted)


def special_table(found: xr.Dataset) -> Any:
    """Special points as a `pandas.DataFrame`; see `GapsweepAccessor.special_points`."""
    names = [str(found.attrs.get(name, "")) for name in ("along", "second")]
    points = special_points(_checked(found))
    parts = points["multiplier_real"] + 1j * points["multiplier_imag"]
    off = abs(abs(parts.fillna(0.0)) - 1.0)
    symbols = [Special(kind).symbol for kind in points["special"].values.tolist()]
    points = points.assign(
        kind=points["special"],
        symbol=(POINT, np.array(symbols, object)),
        nearest=parts.isel({MULTIPLIER: off.argmin(MULTIPLIER)}),
    )
    frame = to_dataframe(points).set_index(POINT).rename(columns={"nearest": MULTIPLIER})
    wanted = *points.coords, BRANCH, STEP, "kind", "symbol", *names, "x_max", *_LISTED
    return frame[[c for name in dict.fromkeys(wanted) for c in frame if c.split("[")[0] == name]]


def default_axis(found: xr.Dataset) -> str:
    """Name of the horizontal axis: the parameter of branches, or frequency for free motions."""
    along = str(_checked(found).attrs.get("along", "omega"))
    return along if along in found and along != "amplitude" else FREQUENCY


def _checked(found: Any) -> xr.Dataset:
    if not isinstance(found, xr.Dataset) or "special" not in found or "stable" not in found:
        raise DatasetError("branches: none in this dataset; gs.branches(...) returns branches")
    return found if BRANCH in found.dims else found.expand_dims(BRANCH)


def of_scene(
    found: xr.Dataset | None, here: xr.Dataset, along: str, *heights: str
) -> xr.Dataset | None:
    """Branches of the parameter sets in `here`, as from `shown`; None if none is along the axis."""
    if found is None or not found.sizes.get(BRANCH, 1) or default_axis(found) != along:
        return None
    found = _checked(found)
    inside = in_scene(found, here, BRANCH)
    first = found[COORDINATE].values[:1].item() if COORDINATE in found.dims else ""
    one = {COORDINATE: np.ravel(here.coords.get(COORDINATE, first))[0]} if first else {}
    return shown(found.isel({BRANCH: inside}), [along, *heights], one) if inside.any() else None


def in_scene(found: xr.Dataset, here: xr.Dataset, dim: str, prefix: str = "") -> NDArray[np.bool_]:
    """Mask of entries along `dim` at the values of `here`; `prefix` begins their coordinates."""
    inside = np.ones(found.sizes[dim], bool)
    for name in [*places(here), REPRESENTATION]:
        if prefix + name in found.coords and name in here.coords:
            inside &= np.isin(np.broadcast_to(found[prefix + name], inside.shape), here[name])
    return inside


def label(variable: xr.DataArray) -> str:
    """The label of an axis; parameters have the same names as in other datasets."""
    words = scales.long_name(variable).removesuffix(" along the branch")
    is_known = words in COORDINATES and words != "gap"  # the name of "gap" is of both walls
    return scales.axis_label(variable, COORDINATES[words][1].long_name if is_known else words)


def is_log(variable: xr.DataArray) -> bool:
    """Whether the axis of a branch variable is logarithmic; False for all but parameters."""
    if variable.name in (*VARIABLES, FREQUENCY):
        return False
    return scales.is_log(variable.stack(point=(BRANCH, STEP)).dropna("point"))


def behind(
    axes: "Axes", found: xr.Dataset | None, here: xr.Dataset, along: str, heights: Sequence[str]
) -> None:
    """Draw branches behind a figure's dots, in the colour of a single representation or grey."""
    branches = of_scene(found, here, along, *heights)
    if branches is not None:
        labels = np.atleast_1d(here[REPRESENTATION].values)
        shade = colour(labels[0]) if len(labels) == 1 else GREY
        marks.put(axes, orbits(branches, along, heights, shade))
        name_points(axes, branches, along, heights[0])


def unstable(
    found: xr.Dataset | None, here: xr.Dataset, along: str, height: str
) -> Iterator[Marks]:
    """Unstable orbits of one representation as dashed lines in its colour."""
    branches = of_scene(found, here, along, height)
    if branches is not None:
        label = str(np.ravel(here[REPRESENTATION].values)[0])
        look: dict[str, Any] = {"colour": colour(label), "size": 0.9, "dashes": "--"}
        for _, is_stable, part in lines(branches, along, height):
            if not is_stable:
                about = {"series": f"{label}, unstable", "sets": False, "zorder": 1.8}
                yield marks.line(x=part[:, 0], y=part[:, 1], **look, **about)


def on_no_branch(found: xr.Dataset) -> NDArray[np.bool_]:
    """Whether each attractor lies on no branch; false in cases of a study that failed."""
    is_lost = found["attractor_on_branch"].values < 0
    if "attractor_status" in found:
        is_lost &= found["attractor_status"].values == Status.OK
    return np.asarray(is_lost)


def caption(found: xr.Dataset | None, here: xr.Dataset, along: str) -> str:
    """Caption sentences on branches, with a leading blank; empty if none is drawn."""
    branches = of_scene(found, here, along)
    if found is None or branches is None:
        return ""
    marks = [f"{k.symbol}: {KINDS[k][1]}" for k in KINDS if (branches["special"] == k).any()]
    words = f" Lines: periodic orbits, dashed where unstable. {', '.join(marks)}{'.' * bool(marks)}"
    if "attractor_on_branch" in found:
        inside = in_scene(found, here, ATTRACTOR, "attractor_")
        n = int(on_no_branch(found)[inside].sum())
        words += f" {n} of {inside.sum()} periodic attractors lie on no branch." * bool(n)
    return words


def orbits(
    branches: xr.Dataset, along: str, heights: Sequence[str], shade: str = ""
) -> Iterator[Marks]:
    """Branches as lines, solid where stable, with their special points.

    `branches`: branches as from `shown`.
    `along`: variable of the horizontal axis.
    `heights`: variables of the vertical axis; the first has the special points.
    `shade`: one colour for all; if empty, a colour for each representation, or for each branch of a
    single representation, named in the legend.
    """
    look = _looks(branches) if not shade else [(shade, "")] * branches.sizes[BRANCH]
    style: dict[str, Any] = {"size": 1.3, "zorder": 1.8}
    for name in heights:
        for number, is_stable, part in lines(branches, along, name):
            own, entry = look[number]
            dashes, word = ("-", "stable") if is_stable else ("--", "unstable")
            about = {"dashes": dashes, "series": f"{entry or BRANCH} {word}"}
            yield marks.line(x=part[:, 0], y=part[:, 1], colour=own, **about, **style)
    for entry, own in {entry: own for own, entry in look if entry}.items():
        yield marks.key(entry=entry, kind=marks.LINE, colour=own, **style)
    if shade and (branches["stable"] == 1).any():
        yield marks.key(entry=f"{BRANCH} stable", kind=marks.LINE, colour=shade, **style)
    if (branches["stable"] == 0).any():
        name = f"{BRANCH} unstable" if shade else "unstable"
        yield marks.key(entry=name, kind=marks.LINE, colour=shade or GREY, dashes="--", **style)
    x, y, special = of_orbits(branches, along, heights[0], "special")
    for kind, (marker, word) in KINDS.items():
        here, name = special == kind, f"{kind.symbol} {word}"
        if here.any():
            look_of: dict[str, Any] = {"marker": marker, "colour": _DARK, "face": "white"}
            look_of |= {"size": 4.0 if kind != Special.GRAZING else 3.0, "zorder": 2.8}
            yield marks.points(x=x[here], y=y[here], series=name, entry=name, **look_of)


def of_orbits(branches: xr.Dataset, *names: str) -> list[Array]:
    """Values of variables in drawn units, each of shape (n_branches, n_steps)."""
    return [drawn(branches[name].transpose(BRANCH, STEP)) for name in names]


def _looks(branches: xr.Dataset) -> list[tuple[str, str]]:
    """Colour and legend entry of every branch; curves are named by their special point."""
    n = branches.sizes[BRANCH]
    if CURVE_KIND in branches.coords:
        kinds = map(Special, np.broadcast_to(branches[CURVE_KIND].values, n).tolist())
        return [
            (NUMBERED[(kind - 1) % len(NUMBERED)], f"{kind.symbol} {KINDS[kind][1]}")
            for kind in kinds
        ]
    if REPRESENTATION in branches.coords:
        labels = np.broadcast_to(branches[REPRESENTATION].values, n).tolist()
        if len(set(labels)) > 1:
            return [(colour(label), label) for label in labels]
    numbers = np.broadcast_to(branches[BRANCH].values, n) if BRANCH in branches.coords else range(n)
    multiple = branches["period_multiple"].transpose(BRANCH, STEP).values[:, 0]
    names = [
        f"branch {number}" + f", period {times}" * bool((multiple > 1).any())
        for number, times in zip(numbers, multiple, strict=True)
    ]
    is_named = 1 < n <= _MOST_NAMES
    return [(NUMBERED[i % len(NUMBERED)], name * is_named) for i, name in enumerate(names)]


def lines(branches: xr.Dataset, along: str, height: str) -> Iterator[tuple[int, bool, Array]]:
    """For each branch its number, whether the part is stable, and points with NaN in gaps."""
    columns = of_orbits(branches, along, height, "stable", "special")
    n = branches.sizes[BRANCH]
    is_loop = np.broadcast_to(branches.coords.get(_LOOP, False), n)
    for number, (x, y, stable, special) in enumerate(zip(*columns, strict=True)):
        there = np.isfinite(x) & np.isfinite(y)
        # At a bifurcation rounding decides whether a multiplier exceeds 1: take the neighbour's.
        is_at = (special > 0) & ~np.isin(special, GRAZES)
        of_step = np.where(is_at[:-1], stable[1:], stable[:-1])
        for is_stable in (False, True):
            chosen = (of_step == is_stable) & there[:-1] & there[1:]
            ends = np.flatnonzero(np.diff(chosen.astype(int), prepend=0, append=0)).reshape(-1, 2)
            pieces = [np.r_[np.c_[x, y][a : b + 1], [[np.nan, np.nan]]] for a, b in ends]
            if is_loop[number] and stable[0] == is_stable:  # closes the line at its first orbit
                last = np.flatnonzero(there)[-1]
                pieces.append(np.c_[x, y][[last, 0]])
            if pieces:
                yield number, is_stable, np.concatenate(pieces)


def name_points(axes: "Axes", branches: xr.Dataset, along: str, height: str) -> None:
    """Draw symbols next to special points where they overlap no other symbol; to be called last.

    Rare kinds come first. Points of a kind that are closer than a symbol share one.
    """
    x, y, special = of_orbits(branches, along, height, "special")
    there = np.isfinite(x) & np.isfinite(y)
    if not 0 < (special[there] > 0).sum() <= _MOST_SYMBOLS:
        return
    axes.autoscale_view()
    at = axes.transData.transform(np.stack([x, y], axis=2).reshape(-1, 2)).reshape(*x.shape, 2)
    size = _FONT * axes.figure.dpi / 72.0 * np.array(_LETTERS)
    is_inside = axes.bbox.padded(-0.5 * size[1]).contains
    taken = np.empty((0, 2))
    for kind in sorted(KINDS, key=lambda kind: int((special == kind).sum())):
        named = np.empty((0, 2))
        for branch, step in np.argwhere(there & (special == kind)):
            if (np.abs(at[branch, step] - named) < size).all(axis=1).any():
                continue
            named = np.vstack([named, at[branch, step]])
            centres = at[branch, step] + 0.5 * _WAYS * size
            is_free = ~(np.abs(centres[:, None] - taken) < size).all(axis=2).any(axis=1)
            is_free &= [is_inside(*centre) for centre in centres]
            if not is_free.any():
                continue
            best = int(is_free.argmax())
            taken = np.vstack([taken, centres[best]])
            right, up = _WAYS[best]
            words = f" {kind.symbol}" if right > 0 else f"{kind.symbol} "
            sides = "left" if right > 0 else "right", ("center", "bottom", "top")[up]
            place = {"x": x[branch, step], "y": y[branch, step], "size": _FONT}
            marks.put(axes, [marks.text(series=words, align=sides, colour=_DARK, **place)])
