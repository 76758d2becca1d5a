"""Results of the page: pure functions from a question to arrays.

Every response starts from rest, so that the same sliders show the same figure. Transients are
shorter than in a study (`settled`): if they are shorter than `DECAY_TIMES`, a motion that does not
repeat is called not settled.
"""

import math
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gapsweep.analysis.spectra import repetition, spectrum
from gapsweep.explorer.question import Question
from gapsweep.integrate.simulate import simulate
from gapsweep.model.contact import ContactLaw
from gapsweep.model.labels import EXACT
from gapsweep.model.oscillator import Oscillator
from gapsweep.response.respond import respond
from gapsweep.response.result import ResponseClass, Steady
from gapsweep.response.section import unit_of
from gapsweep.status import Status

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
    """A frequency response.

    Attributes
    ----------
    label, protocol : str
        Label of the law; `REST`, `UP`, `DOWN` or `STORED`.
    omega : ndarray, shape (n,)
        Frequencies [Hz].
    x_max : ndarray, shape (n,)
        Peaks [m]; NaN for failed responses.
    x_end, v_end : ndarray, shape (n,)
        State [m], [m/s] on each attractor, at forcing phase zero.
    response_class : ndarray of ResponseClass, shape (n,)
    period_multiple : ndarray of int, shape (n,)
    """

    label: str
    protocol: str
    omega: Array
    x_max: Array
    x_end: Array
    v_end: Array
    response_class: NDArray[np.object_]
    period_multiple: NDArray[np.int32]

    @property
    def is_periodic(self) -> NDArray[np.bool_]:
        return np.asarray(self.response_class == ResponseClass.PERIODIC)


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """Responses over two numbers, as far as their rows are computed.

    Attributes
    ----------
    label : str
        Label of the law.
    name : str
        `BASINS` or `MAP`.
    x, y : ndarray, shape (n_x,), (n_y,)
        Initial displacements [m] and velocities [m/s], or frequencies [Hz] and values of the
        question's `over` in SI units; of all rows, computed or not.
    x_max : ndarray, shape (m, n_x)
        Peaks [m] of the first m rows; NaN for failed responses.
    is_periodic : ndarray of bool, shape (m, n_x)
    """

    label: str
    name: str
    x: Array
    y: Array
    x_max: Array = field(default_factory=lambda: np.empty((0, 0)))
    is_periodic: NDArray[np.bool_] = field(default_factory=lambda: np.empty((0, 0), bool))


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """The motion at one frequency, without transients.

    Attributes
    ----------
    label : str
    omega : float
        Frequency [Hz].
    t, x, v : ndarray, shape (n,)
        Times [s] from the first sample on, displacements [m], velocities [m/s].
    section : ndarray, shape (m, 2)
        Displacements and velocities at the last 300 forcing periods, or 120 if the motion is
        periodic.
    frequency, spectrum : ndarray
        Frequencies [Hz] and amplitudes [m].
    period_multiple : int
        Forcing periods after which it repeats; 0 if none was found.
    problem : str
        Error message if there are no numbers; else empty.
    """

    label: str
    omega: float
    t: Array
    x: Array
    v: Array
    section: Array
    frequency: Array
    spectrum: Array
    period_multiple: int = 0
    problem: str = ""


def answers(question: Question) -> Iterator[Curve | Motion | Plane]:
    """All results of a question, the most visible first.

    The exact law from rest and its motion, the same for every approximation, then sweeps of the
    exact law in growing parts, and the planes of the exact law and the first approximation. The
    caller may stop iterating at any time.

    Raises
    ------
    ModelError
        If a law cannot be built, as a fit outside its range.
    """
    highest = max(question.gap.j_1, question.gap.j_2, _LEAST)
    for label in (EXACT, *question.approximations):
        curve = from_rest(question, label)
        yield curve
        yield motion(question, label)
        highest = max(highest, _height(curve, question.omega))
    for curve in sweeps(question):
        yield curve
        highest = max(highest, _height(curve, question.omega))
    shown = (EXACT, *question.approximations[:1])
    for label in shown:
        yield from basins(question, label, _BEYOND * highest)
    for label in shown:
        yield from response_map(question, label)


def frequencies(question: Question) -> Array:
    """Frequencies [Hz] of the response."""
    return np.linspace(*question.band, N_OMEGA)


def from_rest(question: Question, label: str) -> Curve:
    """The steady responses of a law from rest at all frequencies."""
    omega = frequencies(question)
    return _curve(question, label, REST, omega, np.zeros((2, N_OMEGA)))


def sweeps(question: Question) -> Iterator[Curve]:
    """Sweeps of the exact law up and down, in alternating parts.

    Each frequency starts from the end state of the one before it. Every curve holds all
    frequencies of its sweep so far.
    """
    law, omega = question.law(EXACT), frequencies(question)
    ends = {UP: (0.0, 0.0), DOWN: (0.0, 0.0)}
    parts: dict[str, list[Curve]] = {UP: [], DOWN: []}
    for first in range(0, N_OMEGA, _CHUNK):
        for protocol, along in ((UP, omega), (DOWN, omega[::-1])):
            here = along[first : first + _CHUNK]
            states = _carried(question.oscillator, law, here, ends[protocol])
            ends[protocol] = (states[0, -1], states[1, -1])
            parts[protocol].append(_curve(question, EXACT, protocol, here, states))
            yield _joined(parts[protocol])


def _carried(
    oscillator: Oscillator, law: ContactLaw, omega: Array, state: tuple[float, float]
) -> Array:
    """End states of a sweep at each frequency, shape (2, n)."""
    found, atol = [], _atol(oscillator)
    for at in omega.tolist():
        run = simulate(
            oscillator, law, at, *state, t_end=_settling(oscillator, at) / at, rtol=RTOL, atol=atol
        )
        # After a failed motion the sweep continues from rest.
        state = (run.x_end, run.v_end) if run.status == Status.OK else (0.0, 0.0)
        found.append(state)
    return np.transpose(found)


def _curve(question: Question, label: str, protocol: str, omega: Array, states: Array) -> Curve:
    """The steady responses of a law from given initial states."""
    found = respond(
        question.oscillator,
        question.law(label),
        omega,
        *states,
        rtol=RTOL,
        atol=_atol(question.oscillator),
        steady=settled(question.oscillator),
    )
    columns = (found.x_max, found.x_end, found.v_end)
    kinds = (found.response_class, found.period_multiple)
    return Curve(label, protocol, omega, *map(np.asarray, columns), *map(np.asarray, kinds))


def _height(curve: Curve, omega: float) -> float:
    """The peak [m] at the frequency nearest to `omega`; 0 for an incomplete sweep."""
    if curve.omega.size < N_OMEGA:
        return 0.0
    return float(np.nan_to_num(curve.x_max[np.argmin(np.abs(curve.omega - omega))]))


def basins(question: Question, label: str, reach: float) -> Iterator[Plane]:
    """Responses at the frequency of the motion, from initial displacements up to `reach` [m]."""
    x = np.linspace(-reach, reach, N_STARTS)
    v = x * unit_of(question.omega)[1]
    omega = np.full(N_STARTS, question.omega)
    starts = (np.stack([x, np.full(N_STARTS, each)]) for each in v)
    rows = (_curve(question, label, BASINS, omega, states) for states in starts)
    return _planes(Plane(label, BASINS, x, v), (question.of_basins, reach), rows)


def response_map(question: Question, label: str) -> Iterator[Plane]:
    """The responses from rest over frequency and the number `over` of the question."""
    omega, states = np.linspace(*question.band, N_MAP), np.zeros((2, N_MAP))
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
    names = ("omega", "x_max", "x_end", "v_end", "response_class", "period_multiple")
    columns = [np.concatenate([getattr(part, name) for part in parts]) for name in names]
    return Curve(parts[0].label, parts[0].protocol, *columns)


def settled(oscillator: Oscillator) -> Steady:
    """Convergence criteria of the page.

    No Lyapunov exponent is computed for motions that do not repeat, which would take longer than
    all other results: `_NEVER` is a tolerance that no transient reaches.
    """
    return Steady(
        settle_tol=_NEVER,
        t_max=_transient(oscillator),
        n_periods=32,
        max_period_multiple=16,
    )


def _atol(oscillator: Oscillator) -> float:
    """Absolute tolerance [m], small even for motions of micrometres."""
    deflection = oscillator.deflection
    return min(_ATOL, _OF_DEFLECTION * deflection) if deflection else _ATOL


def _transient(oscillator: Oscillator) -> float:
    """Length of transients [s]."""
    bound, rate = NATURAL_PERIODS / oscillator.omega_n, oscillator.settling_rate
    return min(bound, DECAY_TIMES / rate) if rate else bound


def decay_times(oscillator: Oscillator) -> float:
    """Length of transients in decay times; less than `DECAY_TIMES` for weak damping."""
    return min(DECAY_TIMES, NATURAL_PERIODS * oscillator.settling_rate / oscillator.omega_n)


def _settling(oscillator: Oscillator, omega: float) -> int:
    """Length of transients in forcing periods, rounded up."""
    return math.ceil(omega * _transient(oscillator))


def motion(question: Question, label: str) -> Motion:
    """The motion of a law at the frequency and initial condition of the question."""
    oscillator, omega = question.oscillator, question.omega
    first = _settling(oscillator, omega)
    n = first + N_SECTION
    run = simulate(
        oscillator,
        question.law(label),
        omega,
        *question.start,
        t_end=n / omega,
        rtol=RTOL,
        atol=_atol(oscillator),
        dense_output=True,
    )
    t = np.arange(N_PERIODS * SAMPLES_PER_PERIOD) / (SAMPLES_PER_PERIOD * omega)
    begin = (n - N_PERIODS) / omega
    if run.status != Status.OK:
        none = np.zeros(0)
        problem = f"{label}: the motion fails ({run.status.label})"
        return Motion(label, omega, none, none, none, np.zeros((0, 2)), none, none, problem=problem)
    x, v = run.sample(begin + t)
    steady = run.section[first:]
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


def nearest(
    shown: Sequence[Curve], omega: float, x_max: float, scale: tuple[float, float]
) -> tuple[Curve, int] | None:
    """The curve, and the position on it, nearest to a place in the figure; None without curves.

    Parameters
    ----------
    shown : sequence of Curve
    omega, x_max : float
        The place [Hz], [m].
    scale : (float, float)
        Distances that count as equal in the two directions [Hz], [m].
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
