"""Contact forces over displacement, and the energy that contacts lose."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from gapsweep.analysis.dimensions import Array, point_dims
from gapsweep.integrate.trajectory import SystemTrajectory, Trajectory
from gapsweep.report import marks
from gapsweep.report.continued import motions, number_of
from gapsweep.report.drawing import labels_of
from gapsweep.report.labelled import axes_of, titled
from gapsweep.report.marks import Marks
from gapsweep.report.scales import axis_label, shown_unit
from gapsweep.report.selection import scene
from gapsweep.report.style import Look, looks
from gapsweep.response.absolute import N_PERIODS
from gapsweep.study.grid import CONTACT
from gapsweep.variables import objects

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PANELS = 32  # of a forcing period, each with Gauss points
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_SAMPLES = 1024  # of a loop, in a forcing period
_APART = 1e-9  # of a forcing period: distance from a contact event at which a loop is sampled
LOOP_PERIODS = 8  # of the loop of a response without a period
ENERGY = {"units": "J", "long_name": "energy lost in a contact per forcing period"}


def energy_lost(run: Trajectory, contact: int, start: float = 0.0) -> float:
    """Return the energy [J] that a contact loses from `start` [s] to the end of a motion.

    It is the work of the contact force less the energy stored in its spring. Gauss's formula
    integrates between the located times at which a force begins or ends. Periodic stiffness, which
    supplies energy, is left out. At rigid walls it is the energy that impacts lose.

    Parameters
    ----------
    run : Trajectory
        One motion with dense output.
    contact : int
        Number of the contact.
    start : float
        First time [s].
    """
    law = run.laws[contact]
    if law.losses.is_rigid:
        model = objects(run.inputs["oscillator"]).item()
        b = np.reshape(model.directions, (-1, model.n))[contact]
        compliance = b @ np.linalg.solve(np.atleast_2d(model.mass), b)
        u = before_impacts(run, contact, start)
        return float(0.5 * (1.0 - law.losses.restitution**2) * (u @ u) / compliance)
    t, weights = _gauss(
        [start, *np.concatenate(times_of(run)), run.t_end], 1.0 / (_PANELS * _rate(run))
    )
    (x, v), (x_0, x_1) = _moved(run, contact, t), _moved(run, contact, [start, run.t_end])[0]
    # A force may jump at a wall.
    place, share = _gauss([x_0, *law.walls, x_1], math.inf)
    stored = np.sign(x_1 - x_0) * (share @ law.force(place))
    return float(weights @ (law.force(x, v) * v) - stored)


def before_impacts(run: Trajectory, contact: int, start: float = 0.0) -> Array:
    """Return the relative velocities with which a contact meets rigid walls from `start` [s] on."""
    times, apart = np.unique(times_of(run)[contact]), _APART / _rate(run)
    before = np.maximum(times[times > start] - apart, start)
    earlier = np.maximum(before - apart, start)
    return 2.0 * _moved(run, contact, before)[1] - _moved(run, contact, earlier)[1]


def loop(run: Trajectory, contact: int, start: float = 0.0) -> tuple[Array, Array, Array]:
    """Return times, relative displacements and forces of a contact from `start` [s] on.

    Forces on rigid walls are NaN.
    """
    period = 1.0 / _rate(run)
    n = math.ceil(_SAMPLES * (run.t_end - start) / period)
    jumps = np.concatenate(times_of(run)) + _APART * period * np.array([[-1.0], [1.0]])
    t = np.unique([*np.linspace(start, run.t_end, n + 1), *jumps.ravel()])
    t = t[(t >= start) & (t <= run.t_end)]
    x, v = _moved(run, contact, t)
    law, varying = run.laws[contact], np.zeros(t.size)
    if isinstance(run, SystemTrajectory):
        for term in run.system.modulation.get([*run.system.contacts][contact], ()):
            varying += term.depth * np.cos(2.0 * math.pi * term.k * t / period + term.phase)
    force = law.force(x, v) + varying * law.force(x)
    return t, x, np.where(np.isfinite(force), force, np.nan)  # of impacts


def _gauss(cuts: Sequence[float], longest: float) -> tuple[Array, Array]:
    """Points and weights of Gauss's formula between the first and the last of some numbers.

    Intervals end at the others in between, and have at most a length.
    """
    low, high = sorted((cuts[0], cuts[-1]))
    n = math.ceil((high - low) / longest) if longest < math.inf else 1
    ends = np.unique(np.clip([*np.linspace(low, high, n + 1), *cuts], low, high))
    half = 0.5 * np.diff(ends)[:, None]
    return (ends[:-1, None] + half * (1.0 + _NODES)).ravel(), (half * _WEIGHTS).ravel()


def _moved(run: Trajectory, contact: int, t: ArrayLike) -> tuple[Array, Array]:
    """Relative displacements and velocities of a contact at times."""
    along = run.system.directions[contact] if isinstance(run, SystemTrajectory) else np.ones(1)
    x, v = (each.reshape(np.size(t), -1) @ along for each in run.sample(t)[:2])
    return x, v


def _rate(run: Trajectory) -> float:
    """Forcing frequency [Hz]; of a motion without forcing the inverse of its length."""
    return float(run.inputs["omega"] or 1.0 / (run.t_end - run.t_0))


def times_of(run: Trajectory) -> list[Array]:
    """Return the times [s] at which the force of each contact begins or ends."""
    times: Any = run.t_contacts
    return [*times.values()] if isinstance(times, dict) else [np.asarray(times)]


def words_of(x_max: xr.DataArray) -> str:
    """Return words for a contact's displacement, from the variable of its peak."""
    return "displacement" if x_max.name == "x_max" else "relative displacement"


def with_losses(dataset: xr.Dataset) -> xr.Dataset:
    """Return responses with `energy_lost`; every response is simulated once more from its section.

    Raises `DatasetError` if the dataset lacks the study or a part of the state.
    """
    dims = point_dims(dataset)
    of_contacts = (CONTACT,) if CONTACT in dataset.dims else ()
    found = np.full([*(dataset.sizes[dim] for dim in dims), dataset.sizes.get(CONTACT, 1)], np.nan)
    for at, run in motions(dataset, dims, {}, N_PERIODS):
        n_periods = run.inputs["n_periods"]
        found[at] = [energy_lost(run, k) / n_periods for k in range(found.shape[-1])]
    values = found if of_contacts else found[..., 0]
    return dataset.assign(energy_lost=((*dims, *of_contacts), values, ENERGY))


def force_loop(dataset: xr.Dataset, /, *, ax: "Axes | None" = None, **wanted: Any) -> "Axes":
    """Contact force over displacement of one steady response of each representation.

    The area of a loop is the energy that the contact loses, per forcing period in the legend; an
    elastic contact has a line, a rigid wall only the zero force between the walls. Each response is
    simulated from its first section point.

    Parameters
    ----------
    dataset : Dataset
        ``responses.nc``, or a part of it with the full state.
    ax : Axes, optional
        Drawn into; new ones if None.
    **wanted
        Selection by coordinate: all but `representation` must have one value; for systems with
        several contacts, `contact` must select one.
    """
    displacement = "contact_x_max" if "contact_x_max" in dataset else "x_max"
    needed = dict.fromkeys(("force_max", displacement), ("representation",))
    shown = scene(dataset, needed, wanted)
    axes = axes_of(ax)
    labels, contact = labels_of(shown), number_of(shown, CONTACT)
    styles = looks(labels)
    for (i,), run in motions(dataset, ("representation",), wanted, LOOP_PERIODS):
        name = labels[i]
        marks.put(axes, [line(run, contact, name, styles[name], shown[displacement])])
    axes.set(
        xlabel=axis_label(shown[displacement], words_of(shown[displacement])),
        ylabel=axis_label(shown["force_max"], "contact force"),
    )
    return titled(axes, shown)


def line(run: Trajectory, contact: int, name: str, look: Look, x_max: xr.DataArray) -> Marks:
    """Return a contact's force over its displacement, in the drawn unit of `x_max`."""
    _, x, force = loop(run, contact)
    entry = name
    if run.laws[contact].losses.lose_energy:
        lost = energy_lost(run, contact) / run.inputs["n_periods"]
        entry = f"{name}, {lost:.3g} J per forcing period"
    style = {"colour": look.colour, "dashes": look.dashes}
    return marks.line(x=shown_unit(x_max)[0] * x, y=force, series=name, entry=entry, **style)
