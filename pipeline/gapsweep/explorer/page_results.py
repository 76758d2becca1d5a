"""Results of the page: pure functions from a question to arrays.

Every response starts from rest, so that the same sliders show the same figure. Transients are
shorter than in a study (`settled`): if they are shorter than `DECAY_TIMES`, a motion that does not
repeat is called not settled.
"""

import math
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.analysis.datasets.basins import arguments
from gapsweep.analysis.spectra import repetition, spectrum
from gapsweep.errors import ModelError
from gapsweep.explorer.question import Question
from gapsweep.integrate.problem import Laws, Model, Models, Solver
from gapsweep.integrate.simulate import simulate
from gapsweep.integrate.trajectory import SystemTrajectory, Trajectory
from gapsweep.model.labels import EXACT
from gapsweep.model.oscillator import Oscillator
from gapsweep.response.respond import respond_models
from gapsweep.response.result import ResponseClass, Steady
from gapsweep.status import Status
from gapsweep.variables import members

Array = NDArray[np.float64]

N_OMEGA = 200
RTOL = 1e-6
_ATOL, _OF_DEFLECTION = 1e-9, 1e-6  # m; or this share of the static deflection, if less
REST, UP, DOWN, STORED = "from rest", "sweep up", "sweep down", "stored"
BASINS, MAP = "basins", "map"
# Decay times after which a transient counts as settled, and largest number of natural periods,
# which limits the waiting time for damping ratios below 0.02.
DECAY_TIMES, NATURAL_PERIODS = 13.0, 104.0
_NEVER = 1e-9  # tolerance that no transient reaches: a disturbance after 20 decay times
# Forcing periods in the section of a motion; last periods, shown by other figures; samples.
N_SECTION, N_PERIODS, SAMPLES_PER_PERIOD = 300, 60, 128
# Cells along each axis of the basins, and along each axis of the map.
N_STARTS, N_MAP = 48, 40
_BEYOND = 1.3  # largest initial displacement relative to walls and the highest response
_LEAST = 1e-6  # m, smallest range of initial displacements
_CHUNK = 20  # frequencies of a sweep between two checks for a newer question


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """A frequency response."""

    # `label`, `protocol`: label of the law; `REST`, `UP`, `DOWN` or `STORED`.
    label: str
    protocol: str
    omega: Array  # shape (n,); frequencies [Hz]
    # Shape (n,); peaks [m] of the displacement that is shown; NaN for failed responses.
    x_max: Array
    end: Array  # shape (n, n_states); state [m], [m/s] on each attractor, at forcing phase zero
    response_class: NDArray[np.object_]  # shape (n,)
    period_multiple: NDArray[np.int32]  # shape (n,)

    @property
    def is_periodic(self) -> NDArray[np.bool_]:
        return np.asarray(self.response_class == ResponseClass.PERIODIC)


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """Responses over two numbers, as far as their rows are computed."""

    label: str  # label of the law
    name: str  # `BASINS` or `MAP`
    # `x`, `y`: shape (n_x,), (n_y,); values of two initial states [m], [m/s], or frequencies [Hz]
    # and values of the question's `over` in SI units; of all rows, computed or not.
    x: Array
    y: Array
    # Shape (m, n_x); peaks [m] of the first m rows; NaN for failed responses.
    x_max: Array = field(default_factory=lambda: np.empty((0, 0)))
    # Shape (m, n_x).
    is_periodic: NDArray[np.bool_] = field(default_factory=lambda: np.empty((0, 0), bool))


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """The motion at one frequency, without transients."""

    label: str
    omega: float  # frequency [Hz]
    # `t`, `x`, `v`: shape (n,); times [s] from the first sample on, displacements [m], velocities
    # [m/s].
    t: Array
    x: Array
    v: Array
    # Shape (m, 2); displacements and velocities at the last 300 forcing periods, or 120 if the
    # motion is periodic.
    section: Array
    # `frequency`, `spectrum`: frequencies [Hz] and amplitudes [m].
    frequency: Array
    spectrum: Array
    period_multiple: int = 0  # forcing periods after which it repeats; 0 if none was found
    problem: str = ""  # error message if there are no numbers; else empty


def answers(question: Question) -> Iterator[Curve | Motion | Plane]:
    """All results of a question, the most visible first.

    The exact law from rest and its motion, the same for every approximation, then sweeps of the
    exact law in growing parts, and the planes of the exact law and the first approximation. The
    caller may stop iterating at any time. An approximation that cannot be built, as a fit outside
    its range, is a motion with a `problem` only. Raises `ModelError` if the exact law cannot be
    built.
    """
    walls = np.abs([each for each in question.clearance if math.isfinite(each)])
    least = _LEAST if question.machine.is_oscillator else 1e-3 * question.model.deflection
    highest = max(*walls.tolist(), _LEAST) if walls.any() else least
    shown = []
    for label in (EXACT, *question.approximations):
        try:
            question.laws(label)
        except ModelError as error:
            if label == EXACT:
                raise
            yield _no_motion(label, question.omega, f"{label}: {error}")
            continue
        shown.append(label)
        curve = from_rest(question, label)
        yield curve
        yield motion(question, label)
        highest = max(highest, _height(curve, question.omega))
    for curve in sweeps(question):
        yield curve
        highest = max(highest, _height(curve, question.omega))
    of_planes = [label for label in (EXACT, *question.approximations[:1]) if label in shown]
    for label in of_planes:
        yield from basins(question, label, _BEYOND * highest)
    for label in of_planes:
        yield from response_map(question, label)


def frequencies(question: Question) -> Array:
    """Frequencies [Hz] of the response."""
    return np.linspace(*question.band, N_OMEGA)


def from_rest(question: Question, label: str) -> Curve:
    """The steady responses of a law from rest at all frequencies."""
    omega = frequencies(question)
    return _curve(question, label, REST, omega, np.zeros((N_OMEGA, question.model.n_states)))


def sweeps(question: Question) -> Iterator[Curve]:
    """Sweeps of the exact law up and down, in alternating parts.

    Each frequency starts from the end state of the one before it. Every curve holds all
    frequencies of its sweep so far.
    """
    laws, omega = question.laws(EXACT), frequencies(question)
    rest = np.zeros(question.model.n_states)
    ends = {UP: rest, DOWN: rest}
    parts: dict[str, list[Curve]] = {UP: [], DOWN: []}
    for first in range(0, N_OMEGA, _CHUNK):
        for protocol, along in ((UP, omega), (DOWN, omega[::-1])):
            here = along[first : first + _CHUNK]
            states = _carried(question.model, laws, here, ends[protocol])
            ends[protocol] = states[-1]
            parts[protocol].append(_curve(question, EXACT, protocol, here, states))
            yield _joined(parts[protocol])


def _carried(model: Model, laws: Laws, omega: Array, state: Array) -> Array:
    """End states of a sweep at each frequency, shape (n, n_states)."""
    found = []
    for at in omega.tolist():
        run = _moved(model, laws, at, state, _settling(model, at) / at)
        # After a failed motion the sweep continues from rest.
        state = _end(run) if run.status == Status.OK else np.zeros(model.n_states)
        found.append(state)
    return np.array(found)


def _moved(
    model: Model, laws: Laws, omega: float, state: Array, t_end: float, *, dense: bool = False
) -> Trajectory:
    """The motion from an initial state."""
    is_one = isinstance(model, Oscillator)
    return simulate(
        model,
        laws[0] if is_one else dict(zip(model.contacts, laws, strict=True)),
        omega,
        **arguments(model, state),
        t_end=t_end,
        rtol=RTOL,
        atol=_atol(model),
        dense_output=dense,
    )


def _end(run: Trajectory) -> Array:
    """State at the end of a motion."""
    if isinstance(run, SystemTrajectory):
        return np.concatenate([run.q_end, run.v_end, run.z_end])
    return np.array([run.x_end, run.v_end])


def _curve(question: Question, label: str, protocol: str, omega: Array, states: Array) -> Curve:
    """The steady responses of a law from given initial states, shape (n, n_states)."""
    model = question.model
    found = respond_models(
        Models.of([model], [question.laws(label)], omega),
        Solver.of(rtol=RTOL, atol=_atol(model)),
        states,
        settled(model),
    ).columns
    ends = [found[name].reshape(len(omega), -1) for name in ("x_end", "v_end")]
    if model.n_lags:
        ends.append(found["z_end"].reshape(len(omega), -1))
    kinds = members(ResponseClass, found["response_class"]), found["period_multiple"]
    return Curve(label, protocol, omega, peak(question, found), np.hstack(ends), *kinds)


def peak(question: Question, found: Mapping[str, NDArray[Any]]) -> Array:
    """Peaks of the displacement that is shown, from the variables of responses, shape (n,)."""
    model, shown = question.model, question.shown
    if shown in model.coordinates:
        name, number = "x_max", [*model.coordinates].index(shown)
    else:
        name, number = "contact_x_max", [*model.contacts].index(shown)
    values = np.asarray(found[name], float)
    peaks: Array = values.reshape(len(values), -1)[:, number]
    return peaks


def _height(curve: Curve, omega: float) -> float:
    """The peak [m] at the frequency nearest to `omega`; 0 for an incomplete sweep."""
    if curve.omega.size < N_OMEGA:
        return 0.0
    return float(np.nan_to_num(curve.x_max[np.argmin(np.abs(curve.omega - omega))]))


def basins(question: Question, label: str, reach: float) -> Iterator[Plane]:
    """Responses at the frequency of the motion, from initial states that displace up to `reach`.

    The two states of the question's plane differ, others are zero.
    """
    scales = np.asarray(question.model.unit(2.0 * math.pi * question.omega), float)
    which = [question.machine.states.index(name) for name in question.plane]
    x, y = (reach * scales[number] * np.linspace(-1.0, 1.0, N_STARTS) for number in which)
    omega, rest = np.full(N_STARTS, question.omega), np.zeros((N_STARTS, len(scales)))

    def starts(value: float) -> Array:
        states = rest.copy()
        states[:, which[1]] = value
        states[:, which[0]] = x
        return states

    rows = (_curve(question, label, BASINS, omega, starts(value)) for value in y.tolist())
    return _planes(Plane(label, BASINS, x, y), (question.of_basins, reach), rows)


def response_map(question: Question, label: str) -> Iterator[Plane]:
    """The responses from rest over frequency and the number `over` of the question."""
    omega, states = np.linspace(*question.band, N_MAP), np.zeros((N_MAP, question.model.n_states))
    settings = (question.at(question.over, value) for value in question.over_values)
    rows = (_curve(each, label, MAP, omega, states) for each in settings)
    values = np.array(question.over_values)
    return _planes(Plane(label, MAP, omega, values), question.of_map, rows)


# The latest complete planes: a click on an initial condition needs the same basins again.
_whole: dict[Hashable, Plane] = {}
_N_WHOLE = 8


def _planes(empty: Plane, basis: Hashable, rows: Iterator[Curve]) -> Iterator[Plane]:
    """A plane after every computed row; a plane computed before is returned at once."""
    key = empty.label, empty.name, basis
    # The thread of another session may remove it meanwhile.
    if (known := _whole.get(key)) is not None:
        yield known
        return
    x_max, is_periodic, plane = [], [], empty
    for row in rows:
        x_max.append(row.x_max)
        is_periodic.append(row.is_periodic)
        plane = replace(empty, x_max=np.array(x_max), is_periodic=np.array(is_periodic))
        yield plane
    if not x_max:
        return
    _whole[key] = plane
    for oldest in list(_whole)[:-_N_WHOLE]:
        _whole.pop(oldest, None)


def _joined(parts: list[Curve]) -> Curve:
    names = ("omega", "x_max", "end", "response_class", "period_multiple")
    columns = [np.concatenate([getattr(part, name) for part in parts]) for name in names]
    return Curve(parts[0].label, parts[0].protocol, *columns)


def settled(model: Model) -> Steady:
    """Convergence criteria of the page.

    No Lyapunov exponent is computed for motions that do not repeat, which would take longer than
    all other results: `_NEVER` is a tolerance that no transient reaches.
    """
    return Steady(
        settle_tol=_NEVER,
        t_max=_transient(model),
        n_periods=32,
        max_period_multiple=16,
    )


def _atol(model: Model) -> float:
    """Absolute tolerance [m], small even for motions of micrometres."""
    deflection = model.deflection
    return min(_ATOL, _OF_DEFLECTION * deflection) if deflection else _ATOL


def _transient(model: Model) -> float:
    """Length of transients [s]."""
    bound, rate = NATURAL_PERIODS / model.slowest, model.settling_rate
    return min(bound, DECAY_TIMES / rate) if rate else bound


def decay_times(model: Model) -> float:
    """Length of transients in decay times; less than `DECAY_TIMES` for weak damping."""
    return min(DECAY_TIMES, NATURAL_PERIODS * model.settling_rate / model.slowest)


def _settling(model: Model, omega: float) -> int:
    """Length of transients in forcing periods, rounded up."""
    return math.ceil(omega * _transient(model))


def motion(question: Question, label: str) -> Motion:
    """The motion of a law at the frequency and initial condition of the question."""
    omega = question.omega
    first = _settling(question.model, omega)
    n = first + N_SECTION
    laws, start = question.laws(label), np.array(question.start)
    run = _moved(question.model, laws, omega, start, n / omega, dense=True)
    t = np.arange(N_PERIODS * SAMPLES_PER_PERIOD) / (SAMPLES_PER_PERIOD * omega)
    begin = (n - N_PERIODS) / omega
    if run.status != Status.OK:
        return _no_motion(label, omega, f"{label}: the motion fails ({run.status.label})")
    along, n_q = question.direction, question.model.n
    x, v = (part.reshape(t.size, -1) @ along for part in run.sample(begin + t)[:2])
    states = run.section[first:]
    steady = np.stack([states[:, :n_q] @ along, states[:, n_q : 2 * n_q] @ along], axis=1)
    latest, n_bins = steady[-2 * N_PERIODS :], t.size // 2 + 1
    n_periods = repetition(latest, float(np.max(np.abs(x))), omega)
    return Motion(
        label,
        omega,
        t,
        x,
        v,
        latest if n_periods else steady,  # without the end of a transient
        np.arange(n_bins, dtype=np.float64) * np.float64(omega / N_PERIODS),
        spectrum(x),
        n_periods,
    )


def _no_motion(label: str, omega: float, problem: str) -> Motion:
    none = np.zeros(0)
    return Motion(label, omega, none, none, none, np.zeros((0, 2)), none, none, problem=problem)


def nearest(
    shown: Sequence[Curve], omega: float, x_max: float, scale: tuple[float, float]
) -> tuple[Curve, int] | None:
    """The curve, and the position on it, nearest to a place in the figure; None without curves.

    `omega` and `x_max`: the place [Hz], [m].
    `scale`: distances that count as equal in the two directions [Hz], [m].
    """
    found, least = None, math.inf
    for each in shown:
        apart = np.hypot((each.omega - omega) / scale[0], (each.x_max - x_max) / scale[1])
        if not np.isfinite(apart).any():
            continue
        k = int(np.nanargmin(apart))
        if apart[k] < least:
            least, found = float(apart[k]), (each, k)
    return found
