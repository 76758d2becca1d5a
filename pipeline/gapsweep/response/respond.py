"""The steady response of one sweep point: what it is, how stable, and how sure that is.

A disturbance shrinks like ``exp(-ζ ω_n t)``, so damping sets the time scale. After each pause a
window of forcing periods is recorded. If the section contracts towards a repeat, shooting
finds the periodic orbit itself; it is accepted only if it is close, stable, of that prime
period, and if the motion then really approaches it. A motion that has found no orbit once
transients must have decayed (`settle_tol`) may still be in transient chaos: it is looked at again
and again until `t_max`. What has found none by then is asked for its Lyapunov exponent: positive
beyond three standard errors is chaotic, anything else is `unresolved`. With ζ > 0 every area of
the section shrinks by the same factor, so there is no third kind.
"""

import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.integrate.problem import DEFAULT_ENGINE, Solver
from gapsweep.model.contact import ContactLaw
from gapsweep.model.oscillator import Oscillator, checked
from gapsweep.response.result import ExtremumKind, Response, ResponseClass, Steady
from gapsweep.response.section import converging_multiple, period_multiple
from gapsweep.response.stability import (
    Exponents,
    Orbit,
    floquet_multipliers,
    is_own,
    lyapunov,
    shoot,
)
from gapsweep.response.walk import Part, Scene, State, Stretch, Walk, integrated
from gapsweep.status import Status

Array = NDArray[np.float64]

_FIRST_WINDOW = 6
# The next look comes when disturbances have shrunk to this share.
_LOOK = 0.25
# Section points closer than this share of the reach are taken for one...
_SAME_POINT = 1e-4
# ... and within this share shooting is worth a try.
_CLOSE = 0.1
# Curvature below this share of the largest possible one is an inflection.
_FLAT = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """What a steady response is asked for: the checked arguments of `respond`."""

    scene: Scene
    start: State
    steady: Steady


def respond(
    oscillator: Oscillator,
    law: ContactLaw,
    omega: float,
    x_0: float = 0.0,
    v_0: float = 0.0,
    *,
    engine: str = DEFAULT_ENGINE,
    rtol: float | None = None,
    atol: float | None = None,
    steady: Steady | None = None,
) -> Response:
    """Find the steady response from one initial state.

    Parameters
    ----------
    oscillator : Oscillator
    law : ContactLaw
    omega : float
        Forcing frequency [Hz], ``> 0``.
    x_0, v_0 : float
        Initial displacement [m] and velocity [m/s], at forcing phase zero.
    engine, rtol, atol
        As in `gapsweep.simulate`.
    steady : Steady, optional
        When the response counts as steady.

    Raises
    ------
    ModelError
        If an argument is out of range. A numerical failure is no error but a `status`.
    """
    scene = Scene(
        oscillator=oscillator,
        law=law,
        omega=checked("omega", omega, low=0.0, strict=True),
        solver=Solver.of(engine, rtol, atol),
    )
    start = checked("x_0", x_0), checked("v_0", v_0)
    return respond_all([Question(scene=scene, start=start, steady=steady or Steady())])[0]


def respond_all(questions: Sequence[Question]) -> list[Response]:
    """Steady responses of many points with one solver, advanced together.

    Each point is a generator that asks for stretches of motion; every round, the stretches
    asked for by all points go to the engine in one call. No point sees the others.
    """
    walks = [_steady_response(question) for question in questions]
    answers: dict[int, Response] = {}
    asked = {i: next(walk) for i, walk in enumerate(walks)}
    while asked:
        parts = integrated(list(asked.values()))
        asked_next = {}
        for i, part in zip(asked, parts, strict=True):
            try:
                asked_next[i] = walks[i].send(part)
            except StopIteration as finished:
                answers[i] = finished.value
        asked = asked_next
    return [answers[i] for i in range(len(questions))]


def _steady_response(question: Question) -> Generator[Stretch, Part, Response]:
    walk, steady = Walk(question.scene, question.start), question.steady
    rate = question.scene.oscillator.decay_rate
    settle = math.log(1.0 / steady.settle_tol) / rate if rate > 0.0 else math.inf
    pause = math.log(1.0 / _LOOK) / rate if rate > 0.0 else steady.t_max
    window = _FIRST_WINDOW
    while walk.status is Status.OK:
        yield from walk.advance(math.ceil(min(pause, steady.t_max) * walk.omega), record=False)
        settled = walk.t >= settle
        largest = steady.n_periods if settled else min(window, steady.n_periods)
        orbit = yield from _find_orbit(walk, steady, largest)
        if orbit is None and settled:
            orbit = yield from _repeated(walk, steady)
        if orbit is not None:
            return _periodic(walk, steady, orbit)
        if walk.t >= steady.t_max and walk.status is Status.OK:
            exponents = yield from lyapunov(walk)
            if exponents is not None:
                return _aperiodic(walk, steady, exponents)
        window *= 2
    return _failure(walk)


def _find_orbit(
    walk: Walk, steady: Steady, n_periods: int
) -> Generator[Stretch, Part, Orbit | None]:
    """Record a window, doubling it up to `n_periods`, until shooting finds the motion's orbit."""
    walk.forget()
    size = _FIRST_WINDOW
    while len(walk.section) < n_periods and walk.status is Status.OK:
        yield from walk.advance(min(size, n_periods) - len(walk.section), record=True)
        size *= 2
        closeness = max(_CLOSE * walk.reach, walk.noise)
        n = converging_multiple(walk.section, closeness, steady.max_period_multiple)
        if n and walk.status is Status.OK:
            orbit = yield from shoot(walk, n)
            if orbit is not None and (yield from is_own(walk, orbit)):
                return orbit
    return None


def _repeated(walk: Walk, steady: Steady) -> Generator[Stretch, Part, Orbit | None]:
    """A settled motion that repeats itself, though shooting could not improve on it.

    At loose tolerances the solver's noise is larger than any Newton residual allowed.
    """
    same = max(walk.noise, _SAME_POINT * walk.reach)
    n = period_multiple(walk.section, same, steady.max_period_multiple)
    if not n:
        return None
    part = yield from walk.probe(walk.y, n, record=True)
    if part.status is not Status.OK or part.monodromy is None:
        return None
    multipliers = floquet_multipliers(part.monodromy)
    if abs(multipliers[0]) >= 1.0:
        return None
    return Orbit(walk.y, n, multipliers, part, walk.section[-n:])


def _periodic(walk: Walk, steady: Steady, orbit: Orbit) -> Response:
    events = orbit.part.events
    modulus = abs(orbit.multipliers[0])
    duration = orbit.n / walk.omega
    stability = {
        "response_class": ResponseClass.PERIODIC,
        "period_multiple": orbit.n,
        "multipliers": tuple(orbit.multipliers.view(float).tolist()),
        "multiplier_abs": float(modulus),
        "lyapunov": math.log(modulus) / duration if modulus > 0.0 else -math.inf,
        "lyapunov_error": 0.0,
        "section": tuple(events.section.ravel().tolist()),
        "x_end": orbit.y[0],
        "v_end": orbit.y[1],
    }
    return _result(walk, steady, Status.OK, events.t_extrema, events.extrema, stability)


def _aperiodic(walk: Walk, steady: Steady, exponents: Exponents) -> Response:
    chaotic = exponents.is_positive
    section = walk.section[-steady.max_period_multiple :] * (1.0, 2.0 * math.pi * walk.omega)
    stability = {
        "response_class": ResponseClass.CHAOTIC if chaotic else ResponseClass.UNRESOLVED,
        "lyapunov": exponents.largest,
        "lyapunov_error": exponents.error,
        "section": tuple(section.ravel().tolist()),
        "x_end": walk.y[0],
        "v_end": walk.y[1],
    }
    status = Status.OK if chaotic else Status.UNRESOLVED
    return _result(walk, steady, status, walk.t_extrema, walk.extrema, stability)


def _result(
    walk: Walk,
    steady: Steady,
    status: Status,
    t_extrema: Array,
    extrema: Array,
    stability: dict[str, Any],
) -> Response:
    # A response without a turning point in its window still has a position.
    seen = extrema if extrema.size else np.array([walk.y[0]])
    x_max, x_min = float(np.max(seen)), float(np.min(seen))
    left_range = max(abs(x_max), abs(x_min)) > walk.scene.law.valid_range
    kinds = _kinds(walk.scene, t_extrema, extrema)
    kept = slice(steady.max_extrema)
    return Response(
        status=Status.OUT_OF_FIT_RANGE if left_range else status,
        extrema=tuple(extrema[kept].tolist()),
        extremum_kind=tuple(kinds[kept].tolist()),
        n_extrema=extrema.size,
        x_max=x_max,
        x_min=x_min,
        amplitude=0.5 * (x_max - x_min),
        t_settled=walk.t,
        t_simulated=walk.t_simulated,
        **walk.cost,
        **stability,
    )


def _kinds(scene: Scene, t: Array, x: Array) -> NDArray[np.int64]:
    """`ExtremumKind` of zero-velocity points, by the sign of the acceleration there.

    `t` counts from a whole forcing period.
    """
    o = scene.oscillator
    drive = o.forcing * np.cos(2.0 * math.pi * scene.omega * t)
    springs = o.mass * o.omega_n_rad**2 * x + o.alpha * x**3 + scene.law.force(x)
    force = drive - springs
    is_turn = np.abs(force) > _FLAT * (abs(o.forcing) + np.abs(springs))
    return np.where(is_turn, -np.sign(force), int(ExtremumKind.INFLECTION)).astype(np.int64)


def _failure(walk: Walk) -> Response:
    left_range = not abs(walk.y[0]) <= walk.scene.law.valid_range
    status = Status.OUT_OF_FIT_RANGE if left_range else walk.status
    where = f"{walk.status.label} before t = {walk.t:.6g} s at x = {walk.y[0]:.3g} m"
    return Response(status=status, message=where, t_simulated=walk.t_simulated, **walk.cost)
