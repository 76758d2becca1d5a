"""Figure of a simulated motion: history, phase portrait, section and spectrum."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from gapsweep.analysis.datasets import fit_file
from gapsweep.analysis.dimensions import Array
from gapsweep.analysis.spectra import spectrum
from gapsweep.design.fit import Fit
from gapsweep.errors import ModelError
from gapsweep.integrate.problem import Model
from gapsweep.integrate.simulate import simulate
from gapsweep.integrate.trajectory import SystemTrajectory, Trajectory
from gapsweep.model.contact import ContactLaw
from gapsweep.quantities import written
from gapsweep.report import fit_figure, losses, marks
from gapsweep.report.style import MATPLOTLIB, NOT_PERIODIC, WALL
from gapsweep.response.result import Response
from gapsweep.variables import CONTACT, COORDINATE, objects

_PER_PERIOD = 512  # samples per period: resolves harmonics up to the 256th
_MOST_PERIODS = 256
_FEWEST = 2**15  # samples in all: motions may be much faster than their forcing
_N_PERIODS = 16  # last periods, shown by the history
_FLOOR = 1e-6  # smallest amplitude shown, relative to the largest
_WORTH = 1e-3  # relative amplitude; the axis ends at twice the highest frequency with it
_MM = 1e3
_STEADY_PERIODS = 64  # of the motion drawn for a steady response
_SETTINGS = ("oscillator", "law", "omega", "engine", "rtol", "atol")
_SECTIONS = {True: "Stroboscopic section", False: "Section at maxima of the first coordinate"}


class Picture(Figure):
    """A figure that a notebook shows without pyplot, which would show it twice.

    ``savefig`` stores a picture with 200 dots per inch, for a slide.
    """

    def __init__(self, figsize: tuple[float, float]) -> None:
        super().__init__(figsize, dpi=200)

    def _repr_png_(self) -> bytes:
        file = BytesIO()
        self.savefig(file, format="png", dpi=100)
        return file.getvalue()


def plot(
    run: Trajectory | Response | Fit,
    coordinate: str | None = None,
    *,
    start: float | None = None,
) -> Figure:
    """Draw a motion: its history, phase portrait, stroboscopic section and amplitude spectrum.

    Of a fit: the measured points over the stable and unstable branches of the fitted model, hollow
    where they are not on its branch, and the residuals.

    Dashed: the walls; for systems, only those of contacts on that coordinate. If a contact there
    loses energy, two more panels have its force over displacement and time, and the energy lost.

    Parameters
    ----------
    run : Trajectory, Response or Fit
        One motion, simulated with ``dense_output=True``, or one steady response, of which the
        motion from its last section point is simulated.
    coordinate : str, optional
        Name of a coordinate of a system (None: the first), or of a contact for its relative
        displacement.
    start : float, optional
        First time [s] that is shown, at most the last 256 periods; the middle of a run if None, to
        leave out most of the transient. The history shows the last sixteen periods. The spectrum is
        over whole periods: forcing periods, or of unforced systems mean times between maxima of the
        first coordinate; with fewer than two, over the whole time shown.

    Returns
    -------
    matplotlib.figure.Figure
        ``.savefig("motion.pdf")`` stores it; a notebook shows it.

    Raises
    ------
    ModelError
        If `run` is an array, a failed response or a motion without dense output, the coordinate
        does not exist, or `start` is outside the run.

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.contact_law("piecewise", 1.4e4, gs.Gap(4e-4, 4e-4))
    >>> machine = gs.systems.paper_oscillator()
    >>> run = gs.simulate(machine, law, omega=9.0, t_end=20.0, dense_output=True)
    >>> figure = gs.plot(run)
    >>> len(figure.axes)
    4
    """
    if isinstance(run, Fit):
        with rc_context(MATPLOTLIB):
            figure = Picture(figsize=(7.0, 5.6))
            above, below = figure.subplots(2, 1, height_ratios=(3, 1))
            fit_figure.draw(above, below, fit_file.dataset(run))
        return figure
    if isinstance(run, Response):
        run, start = _steady_motion(run), 0.0 if start is None else start
    along, name, scale, unit = _quantity(run, coordinate)
    start = 0.5 * (run.t_0 + run.t_end) if start is None else start
    if not run.t_0 <= start < run.t_end:
        raise ModelError(f"start = {start:g} s: must be within {run.t_0:g}..{run.t_end:g} s")
    period, n_periods = _periods(run, start)
    per_period = max(_PER_PERIOD, _FEWEST // n_periods)
    back = np.arange(n_periods * per_period, 0, -1) / per_period
    t = np.maximum(run.t_end - period * back, run.t_0)
    x, v = (scale * each.reshape(t.size, -1) @ along for each in run.sample(t)[:2])
    at_end = t >= run.t_end - _N_PERIODS * period
    is_forced = run.inputs["omega"] is not None
    labels = f"{name}{unit}", f"velocity{unit.replace(']', '/s]')}"
    with rc_context(MATPLOTLIB):
        lossy = _lossy(run, along)
        figure = Picture(figsize=(9.0 if lossy is None else 13.0, 6.0))
        panels = figure.subplots(2, 2 if lossy is None else 3)
        (history, phase), (section, lines) = panels[:, :2]
        marks.put(history, [marks.line(x=t[at_end], y=x[at_end], size=0.8)])
        ended = "" if t[at_end][0] <= run.t_0 else " (end)"
        history.set(xlabel="time [s]", ylabel=labels[0], title=f"Time history{ended}")
        marks.put(phase, [marks.line(x=x, y=v, size=0.5)])
        phase.set(xlabel=labels[0], ylabel=labels[1], title="Phase portrait")
        points = dict(zip("xy", _section(run, float(t[0]), scale * along), strict=True))
        marks.put(section, [marks.points(colour=NOT_PERIODIC, size=2.0, **points)])
        section.set(xlabel=labels[0], ylabel=labels[1], title=_SECTIONS[is_forced])
        for axes in (phase, section):
            axes.locator_params(nbins=5)
        section.set(xlim=phase.get_xlim(), ylim=phase.get_ylim())  # same axes as the phase portrait
        amplitude, frequency = spectrum(x), np.fft.rfftfreq(x.size, period / per_period)
        marks.put(lines, [marks.line(x=frequency, y=amplitude, size=0.8)])
        lines.set(xlabel="frequency [Hz]", ylabel=f"amplitude{unit}", title="Amplitude spectrum")
        if (largest := float(amplitude.max())) > 0.0:
            highest = 2.0 * frequency[amplitude > _WORTH * largest].max()
            lines.set(yscale="log", ylim=(_FLOOR * largest, 2.0 * largest))
            lines.set_xlim(0.0, min(max(highest, 10.0 * frequency[1]), frequency[-1]))
        for wall in walls(
            objects(run.inputs["oscillator"]).item(), run.laws, along
        ):  # they set no axis: they may be far away
            look = {"sets": False, **WALL}
            marks.put(history, [marks.level(y=scale * wall, **look)])
            for axes in (phase, section):
                marks.put(axes, [marks.level(x=scale * wall, **look)])
        if lossy is not None:
            _draw_force(panels[:, 2], run, lossy, float(t[at_end][0]), period, labels[0], scale)
    return figure


def _lossy(run: Trajectory, along: Array) -> int | None:
    """Number of the first contact of the drawn displacement that loses energy."""
    directions = np.reshape(objects(run.inputs["oscillator"]).item().directions, (-1, along.size))
    several = enumerate(zip(directions, run.laws, strict=True))
    return next((k for k, (b, law) in several if _draws(law) and np.array_equal(b, along)), None)


def _draws(law: ContactLaw) -> bool:
    """Whether a contact loses energy by a finite force."""
    return law.losses.lose_energy and not law.losses.is_rigid


def _draw_force(
    panels: Any, run: Trajectory, contact: int, start: float, period: float, label: str,
    scale: float,
) -> None:  # fmt: skip
    """Draw the force of a contact from `start` on, over displacement and over time."""
    t, x, force = losses.loop(run, contact, start)
    lost = losses.energy_lost(run, contact, start) * period / (run.t_end - start)
    in_joules = {"[mm]": ("N", " J"), "[rad]": ("N m", " J")}
    unit, energy = in_joules.get(label.rpartition(" ")[2], ("", ""))
    words = f"contact force [{unit}]" if unit else "contact force"
    over_x, over_t = panels
    marks.put(over_x, [marks.line(x=scale * x, y=force, size=0.8)])
    over_x.set(xlabel=label, ylabel=words, title=f"{lost:.3g}{energy} lost per period")
    marks.put(over_t, [marks.line(x=t, y=force, size=0.8)])
    over_t.set(xlabel="time [s]", ylabel=words, title="Contact force")


def _steady_motion(found: Response) -> Trajectory:
    """The motion of a steady response, from its last section point."""
    if np.ndim(found.status):
        raise ModelError(
            "run: an array of responses; found.to_dataset().gapsweep.bifurcation() draws them"
        )
    if not np.isfinite(found.x_end).all():
        raise ModelError(f"run: a response without a steady motion ({found.status.label})")
    call: dict[str, Any] = {name: found.inputs[name] for name in _SETTINGS}
    call |= {"q_0" if "q_0" in found.inputs else "x_0": found.x_end, "v_0": found.v_end}
    if "z_0" in found.inputs:
        call["z_0"] = found.z_end
    if call["omega"] is not None:
        return simulate(**call, n_periods=_STEADY_PERIODS, dense_output=True)
    is_periodic = np.isfinite(found.period)
    t_end = _STEADY_PERIODS * found.period if is_periodic else found.t_simulated
    return simulate(**call, t_end=t_end, dense_output=True)


def _periods(run: Trajectory, start: float) -> tuple[float, int]:
    """The period [s] of the section, and the number of whole periods after `start`, ``>= 1``."""
    shown = run.t_end - start
    times = run.t_section[run.t_section >= start]
    if times.size < 2:
        return shown, 1
    period = float(times[-1] - times[0]) / (times.size - 1)
    return period, min(int(shown / period + 1e-9), _MOST_PERIODS)


def _quantity(run: Trajectory, coordinate: str | None) -> tuple[Array, str, float, str]:
    """Weights of the coordinates in the drawn quantity, its name, scale and unit."""
    if not isinstance(run, Trajectory) or run.shape:
        raise ModelError(f"run = {run!r:.80}: must be one motion of gapsweep.simulate or respond")
    if not isinstance(run, SystemTrajectory):
        if coordinate is not None:
            raise ModelError(f"coordinate = {coordinate!r}: an oscillator has one; leave it out")
        return np.ones(1), "displacement", _MM, " [mm]"
    own = dict(zip(run.system.coordinates, np.eye(run.system.n), strict=True))
    known = {**run.system.contacts, **own}
    name = run.system.coordinates[0] if coordinate is None else coordinate
    if name not in known:
        names = f"coordinates {', '.join(own)}, contacts {', '.join(run.system.contacts) or 'none'}"
        raise ModelError(f"coordinate = {coordinate!r}: must be one of {names}")
    parts = run.system.part_units
    units = dict(zip(run.system.contacts, parts[CONTACT], strict=True))
    units |= dict(zip(own, parts[COORDINATE], strict=True))
    scale, unit = (_MM, "mm") if units[name] == "m" else (1.0, written(units[name]))
    return np.asarray(known[name]), name, scale, f" [{unit}]" if unit else ""


def walls(model: Model, laws: Sequence[ContactLaw], along: Array) -> list[float]:
    """Positions of walls along the drawn displacement, of contacts parallel to it."""
    found = []
    for direction, law in zip(np.reshape(model.directions, (-1, along.size)), laws, strict=True):
        factor = direction @ along / (along @ along)
        if factor and np.allclose(direction, factor * along):
            found += _both(float(factor), law)
    return found


def _both(factor: float, law: ContactLaw) -> list[float]:
    """Positions of both walls of a contact on `factor` times the coordinate."""
    places = zip((-law.gap.j_1, law.gap.j_2), law.stiffnesses, strict=True)
    return [place / factor for place, stiffness in places if stiffness]  # no wall without stiffness


def _section(run: Trajectory, start: float, along: Array) -> tuple[Array, Array]:
    """Displacement and velocity at the section points from `start` on."""
    shown, n = run.section[run.t_section >= start], along.size
    return shown[:, :n] @ along, shown[:, n : 2 * n] @ along
