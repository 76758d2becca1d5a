"""Figures computed for one model at once, without a study: a frequency response, and a map."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from matplotlib import rc_context
from numpy.typing import ArrayLike, NDArray

from gapsweep.continuation.family import Family
from gapsweep.continuation.follow import branches as continued
from gapsweep.design.machine import Machine
from gapsweep.errors import ModelError
from gapsweep.integrate.problem import TIME_LIMIT, Model, Models, Solver, within
from gapsweep.integrate.simulate import AnyLaw
from gapsweep.model.arrays import numbers
from gapsweep.model.doubts import doubts, warn_of
from gapsweep.model.oscillator import Oscillator, called_as, checked
from gapsweep.report import branch_lines, maps, marks
from gapsweep.report.motion import Picture, walls
from gapsweep.report.scales import axis_label, drawn
from gapsweep.report.style import MATPLOTLIB, NUMBERED, SWEEPS, WALL
from gapsweep.response.respond import check_steady, respond_models
from gapsweep.response.result import RESPONSE, ResponseClass, Responses, Steady
from gapsweep.study.schema import COORDINATES, PARAMETER
from gapsweep.variables import CONTACT, COORDINATE, Variable

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

_BOTH = Variable("f8", "m", "distance of both walls from the origin")
_DIRECTIONS = {"up": 1, "down": -1}
_CONTACT = "#f2f2f2"  # background beyond a wall
_MOST_CELLS = 10**6
_SIZE = 7.0, 4.2  # inches
_ORBITS = "#000000"  # of any law, the only one of the figure


@called_as("gs.frequency_response(oscillator, law, omega=np.linspace(2, 16, 300)), in Hz")
def frequency_response(
    oscillator: Model,
    law: AnyLaw | None,
    omega: ArrayLike,
    *,
    coordinate: str | None = None,
    sweeps: Sequence[str] = ("up", "down"),
    branches: bool = True,
    rtol: float | None = None,
    steady: Steady | None = None,
    time_limit: float = TIME_LIMIT,
) -> Picture:
    """Draw peaks over frequency: sweeps up and down, and stable and unstable periodic orbits.

    A sweep starts from rest, and each of its points where the one before ended. Hollow symbols are
    responses that are not periodic. Lines are periodic orbits, dashed where unstable, with their
    special points. The dashed horizontal line is the upper wall; the area above it, contact with
    it: a response below may still touch a nearer lower wall.

    Parameters
    ----------
    oscillator : Oscillator or System
    law : ContactLaw or mapping of str to ContactLaw
        As in `gapsweep.simulate`; None of a System without contacts.
    omega : array_like
        Forcing frequencies [Hz], ``> 0``, at least two different ones.
    coordinate : str, optional
        Name of a coordinate of a system; None: the first.
    sweeps : sequence of str
        ``"up"``, ``"down"``, both or none.
    branches : bool
        Whether to continue periodic orbits between the first and the last frequency, with the
        defaults of `gapsweep.branches`.
    rtol, steady, time_limit
        As in `gapsweep.respond`, for sweeps.

    Returns
    -------
    matplotlib.figure.Figure
        ``.savefig("response.png")`` stores it; a notebook shows it.

    Raises
    ------
    ModelError
        If an argument is out of range, or the system is not forced.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> machine = gs.systems.paper_oscillator()
    >>> figure = gs.frequency_response(machine, law, omega=[8.0, 8.5, 9.0], branches=False)
    >>> figure.axes[0].get_xlabel()
    'forcing frequency [Hz]'
    """
    frequencies = _axis("omega", omega)
    if frequencies.size < 2 or not frequencies[0] > 0.0:
        raise ModelError(f"omega = {omega!r:.80}: must be at least two frequencies > 0 Hz")
    if isinstance(sweeps, str) or set(sweeps) - set(_DIRECTIONS):
        raise ModelError(f"sweeps = {sweeps!r}: must be a list of 'up', 'down', both or none")
    family = Family(oscillator, {} if law is None else law, float(frequencies[0]), (), {})
    model, laws = family.example, family.laws_at({})
    names = getattr(model, "coordinates", ("x",))
    coordinate = names[0] if coordinate is None else coordinate
    if coordinate not in names:
        raise ModelError(f"coordinate = {coordinate!r}: must be one of {', '.join(names)}")
    steady = Steady() if steady is None else steady
    check_steady(steady)
    warn_of(doubts([model], [laws], frequencies, np.zeros((1, model.n_states))))
    orders = [frequencies[:: _DIRECTIONS[each]] for each in sweeps]
    with within(time_limit):
        found = Machine(family, Solver.of(rtol=rtol), steady).sweeps(np.zeros((1, 0)), orders)
    x_max = [_part("x_max", each, model, coordinate) for each in found]
    lines = None
    if branches:
        ends = float(frequencies[0]), float(frequencies[-1])
        own = {COORDINATE: coordinate} if COORDINATE in model.parts else {}
        orbits = continued(oscillator, law, "omega", ends)
        lines = branch_lines.shown(orbits, ["omega", "x_max"], own)
    with rc_context(MATPLOTLIB):
        figure = Picture(figsize=_SIZE)
        axes = figure.subplots()
        if lines is not None:
            marks.put(axes, branch_lines.orbits(lines, "omega", ["x_max"], _ORBITS))
        for direction, omega, swept, values in zip(sweeps, orders, found, x_max, strict=True):
            _dots(axes, omega, drawn(values), swept, f"sweep {direction}")
        described = lines["x_max"] if lines is not None else x_max[0]
        axes.set(xlabel="forcing frequency [Hz]", ylabel=axis_label(described, "peak"))
        axes.set_xlim(frequencies[0], frequencies[-1])
        _upper_walls(axes, model, laws, np.eye(len(names))[list(names).index(coordinate)])
        if lines is not None:
            branch_lines.name_points(axes, lines, "omega", "x_max")
        axes.legend(fontsize=8)
    return figure


def _dots(axes: Axes, x: Array, y: Array, found: Responses, name: str) -> None:
    """Draw the peaks of a sweep: filled if periodic, else hollow."""
    is_periodic = found.columns["response_class"] == ResponseClass.PERIODIC
    kind = name.replace(" ", "_")
    shade = NUMBERED[list(SWEEPS).index(kind)]
    look: dict[str, Any] = {"marker": SWEEPS[kind], "colour": shade, "size": 3.6}
    for chosen, face, word in ((is_periodic, "", ""), (~is_periodic, "none", ", not periodic")):
        shown = chosen & np.isfinite(y)
        if shown.any():
            about = {"face": face, "series": name + word, "entry": name + word, "zorder": 1.7}
            marks.put(axes, [marks.points(x=x[shown], y=y[shown], **about, **look)])


def _upper_walls(axes: Axes, model: Model, laws: Sequence[Any], along: Array) -> None:
    """Draw the walls above zero within the axis, and the area of contact above the lowest."""
    low, high = axes.get_ylim()
    unit = 1e3 if model.part_units[COORDINATE][int(along.argmax())] == "m" else 1.0
    heights = [unit * wall for wall in walls(model, laws, along)]
    heights = [height for height in heights if 0.0 <= height < high]
    if heights:
        axes.axhspan(min(heights), high, color=_CONTACT, zorder=0.0, linewidth=0.0)
    marks.put(axes, [marks.level(y=height, **WALL) for height in heights])
    axes.set_ylim(low, high)


@called_as("gs.map(oscillator, law, x=('omega', frequencies), y=('gap', gaps)), in Hz and m")
def parameter_map(
    oscillator: Model | Callable[..., Model],
    law: AnyLaw | None,
    x: tuple[str, ArrayLike],
    y: tuple[str, ArrayLike],
    show: str = "period_multiple",
    *,
    omega: float | None = None,
    part: str | None = None,
    rtol: float | None = None,
    steady: Steady | None = None,
    time_limit: float = TIME_LIMIT,
) -> Picture:
    """Draw a number of the steady response from rest over two parameters, a cell per response.

    Parameters
    ----------
    oscillator : Oscillator, System, or callable
        Model, or a function that returns it for keywords, as ``gs.systems.typical_section``.
    law : ContactLaw or mapping of str to ContactLaw
        As in `gapsweep.simulate`; None of a System without contacts.
    x, y : tuple of (str, array_like)
        Name and values of the parameter of either axis: ``"omega"`` [Hz], a field of the oscillator
        (``"forcing"``) or the law (``"K_c"``, ``"j_1"``, ``"j_2"``, or ``"gap"`` for both walls
        alike), or a keyword of the function. At most 10⁶ cells in all.
    show : str
        Variable: ``"period_multiple"``, ``"amplitude"``, ``"x_max"``, ``"contact_share"``,
        ``"force_max"``, ``"lyapunov"``, or another that has one value per response, contact or
        coordinate.
    omega : float, optional
        Forcing frequency [Hz], if it is no axis.
    part : str, optional
        Name of the coordinate or contact of a system that is shown; None: the first.
    rtol, steady, time_limit
        As in `gapsweep.respond`.

    Returns
    -------
    matplotlib.figure.Figure
        ``.savefig("map.png", dpi=200)`` stores it; a notebook shows it.

    Raises
    ------
    ModelError
        If an argument is out of range, or a parameter or variable is unknown.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.Piecewise(1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> figure = gs.map(
    ...     gs.systems.paper_oscillator(), law, x=("omega", [8.0, 9.0]), y=("forcing", [2.0, 4.0])
    ... )
    >>> figure.axes[0].get_ylabel()
    'forcing amplitude [N]'
    """
    if show not in RESPONSE or set(RESPONSE[show].dims) - {COORDINATE, CONTACT}:
        raise ModelError(f"show = {show!r}: must be a variable as 'period_multiple', 'amplitude'")
    axes = {}
    for which, given in (("x", x), ("y", y)):
        try:
            name, values = given
        except (TypeError, ValueError):
            said = "must be a name and values, as ('omega', [8.0, 9.0])"
            raise ModelError(f"{which} = {given!r:.80}: {said}") from None
        axes[name] = _axis(name, values)
    if len(axes) < 2:
        raise ModelError(f"x and y: both are {x[0]!r}; give two parameters")
    names = tuple(axes)
    grid = np.stack(np.meshgrid(*axes.values()), axis=-1).reshape(-1, 2)
    if len(grid) > _MOST_CELLS:
        raise ModelError(f"{len(grid)} cells: must be <= {_MOST_CELLS}")
    first = dict(zip(names, grid[0].tolist(), strict=True))
    if omega is not None:
        omega = checked("omega", omega, low=0.0, strict=True)
    family = Family(oscillator, {} if law is None else law, omega, names, first)
    rows = [dict(zip(names, row, strict=True)) for row in grid.tolist()]
    models, laws = [family.model_at(row) for row in rows], [family.laws_at(row) for row in rows]
    at = [checked("omega", row.get("omega", omega or 0.0), low=0.0) for row in rows]
    start = np.zeros((len(grid), family.example.n_states))
    steady = Steady() if steady is None else steady
    check_steady(steady)
    warn_of(doubts(models, laws, np.array(at), start[:1]))
    with within(time_limit):
        many = Models.of(models, laws, np.array(at))
        found = respond_models(many, Solver.of(rtol=rtol), start, steady)
    shape = tuple(axes[name].size for name in names[::-1])
    needed = dict.fromkeys([show, "status", "response_class"])
    data = {n: _part(n, found, family.example, part, names[::-1], shape) for n in needed}
    coordinates = {name: (name, values, _described(name)) for name, values in axes.items()}
    dataset = xr.Dataset(data, coordinates)
    with rc_context(MATPLOTLIB):
        figure = Picture(figsize=_SIZE)
        maps.draw(figure.subplots(), maps.picture(dataset, show, names[0], names[1], {})[0])
    return figure


def _part(
    name: str,
    found: Responses,
    model: Model,
    part: str | None,
    dims: Sequence[str] = ("point",),
    shape: Sequence[int] = (-1,),
) -> xr.DataArray:
    """A variable of responses, of one coordinate or contact of a system; None: the first."""
    if name not in found.columns:
        raise ModelError(f"{name!r}: not a variable of this model's responses")
    variable, values = RESPONSE[name], found.columns[name]
    if isinstance(model, Oscillator):
        return xr.DataArray(values.reshape(shape), {}, dims, name, variable.attributes)
    coordinates, units = {}, dict[str, Sequence[str]](model.part_units)
    for dim in variable.dims:
        labels = [*(model.coordinates if dim == COORDINATE else model.contacts)]
        label = labels[0] if part is None else part
        if label not in labels:
            raise ModelError(f"part = {part!r}: must be one of {', '.join(labels)}")
        values = values[:, labels.index(label)] if dim in model.parts else values
        coordinates[dim] = label
        units[dim] = [units[dim][labels.index(label)]]
    attributes = variable.in_units(units).attributes
    return xr.DataArray(values.reshape(shape), coordinates, dims, name, attributes)


def _described(name: str) -> dict[str, Any]:
    """Attributes of a parameter's values."""
    if name == "gap":
        return _BOTH.attributes
    unknown = name, Variable("f8", "", f"{PARAMETER} {name}")
    return COORDINATES.get(name, unknown)[1].attributes


def _axis(name: str, values: ArrayLike) -> Array:
    """Ascending distinct values of an axis."""
    said = "finite numbers and not empty"
    found = np.unique(numbers(name, values, said))
    if not (found.size and np.isfinite(found).all()):
        raise ModelError(f"{name} = {values!r:.80}: must be {said}")
    return found
