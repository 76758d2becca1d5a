"""The steady response of one sweep point: what it is, how stable, and how sure that is.

A disturbance shrinks like ``exp(-ζ ω_n t)``, so damping sets the time scale. After each pause a
window of forcing periods is recorded. If the section contracts towards a repeat, shooting
finds the periodic orbit itself; it is accepted only if it is close, stable, of that prime
period, and if the motion then really approaches it. A motion that has found no orbit once
transients must have decayed (`settle_tol`) may still be in transient chaos: it is looked at again
and again (`max_decay_times`, `max_periods`). What has found none by then is asked for its Lyapunov
exponent: positive beyond three standard errors is chaotic. Without a positive one, a motion that
passes kinks unlocated may be a periodic one that its solver rattles. Anything else is `unresolved`.
With ζ > 0 every area of the section shrinks by the same factor, so there is no third kind.
"""

import math
from collections.abc import Callable, Generator, Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gapsweep.errors import ModelError
from gapsweep.integrate.problem import DEFAULT_ENGINE, Solver, law_kind
from gapsweep.model.contact import ContactLaw
from gapsweep.model.oscillator import Oscillator, checked
from gapsweep.response.result import ExtremumKind, Response, ResponseClass, Steady
from gapsweep.response.section import (
    converging_multiple,
    likely_multiple,
    period_multiple,
    prime_multiple,
)
from gapsweep.response.stability import (
    Exponents,
    Growth,
    Orbit,
    Shot,
    growths,
    is_own,
    lyapunov,
    orbits,
    shoot,
)
from gapsweep.response.walk import Ensemble, Scene, State, Stretch, Walk
from gapsweep.status import Status

Array = NDArray[np.float64]
Request = Stretch | Shot | Growth

_FIRST_WINDOW = 6
# The next look comes when disturbances have shrunk to this share.
_LOOK = 0.25
# Shooting is worth a try when section points repeat within this share of the reach.
_CLOSE = 0.1
_ON_CIRCLE = 1e-6  # how near to 1 an undamped orbit's multipliers are found
_NOTHING = 1e-290  # below it doubles lose digits
_ENDLESS = 1e7  # forcing periods that no motion is watched for


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """What a steady response is asked for: the checked arguments of `respond`."""

    scene: Scene
    start: State
    steady: Steady

    def __post_init__(self) -> None:
        for name, value, kind in (
            ("oscillator", self.scene.oscillator, Oscillator),
            ("steady", self.steady, Steady),
        ):
            if not isinstance(value, kind):
                raise ModelError(f"{name} = {value!r}: must be a gapsweep.{kind.__name__}")


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
    return respond_all(
        [Question(scene=scene, start=start, steady=Steady() if steady is None else steady)]
    )[0]


def respond_all(questions: Sequence[Question]) -> list[Response]:
    """Steady responses of many points with one solver, advanced together.

    No point sees the others: each response is the same to the last bit in any company.
    """
    groups: dict[Hashable, list[int]] = {}
    for i, question in enumerate(questions):
        groups.setdefault(law_kind(question.scene.law), []).append(i)
    answers: dict[int, Response] = {}
    for numbers in groups.values():
        answers |= zip(numbers, _answered([questions[i] for i in numbers]), strict=True)
    return [answers[i] for i in range(len(questions))]


def _answered(questions: Sequence[Question]) -> list[Response]:
    """Responses of points of one kind.

    Each point is a generator that asks for one thing after the other: a stretch of motion, a
    periodic orbit, the growth of a disturbance. Points that ask for the same are answered together.
    """
    ensemble = Ensemble([question.scene for question in questions])
    points = [_steady_response(question) for question in questions]
    outcomes: dict[int, dict[str, Any]] = {}
    asked: dict[type, dict[int, Any]] = {Stretch: {}, Shot: {}, Growth: {}}
    answers: dict[type, Callable[[Ensemble, dict[int, Any]], Sequence[Any]]] = {
        Stretch: Ensemble.parts,
        Shot: orbits,
        Growth: growths,
    }

    def go_on(i: int, answer: Any) -> None:
        try:
            request = points[i].send(answer)
        except StopIteration as finished:
            outcomes[i] = finished.value
        else:
            asked[type(request)][i] = request

    for i in range(len(points)):
        go_on(i, None)
    while any(asked.values()):
        # What most points wait for; growth last, for its many calls are best shared by all.
        kind = max(Stretch, Shot, key=lambda each: len(asked[each]))
        kind = kind if asked[kind] else Growth
        waiting, asked[kind] = asked[kind], {}
        for i, answer in zip(waiting, answers[kind](ensemble, waiting), strict=True):
            go_on(i, answer)
    costs = ensemble.costs()
    return [Response(**outcomes[i], **costs[i]) for i in range(len(questions))]


@dataclass(frozen=True, slots=True)
class _Limits:
    """How many forcing periods a motion is given: between looks, to settle, and at most."""

    pause: int
    settled: int
    last: int

    @classmethod
    def of(cls, scene: Scene, steady: Steady) -> "_Limits":
        rate = scene.oscillator.settling_rate
        # Without damping nothing settles: what does not repeat at once never will.
        decay_periods = scene.omega / rate if rate > 0.0 else 0.0
        pause, settled, longest = (
            math.ceil(min(times * decay_periods, _ENDLESS))
            for times in (
                math.log(1.0 / _LOOK),
                math.log(1.0 / steady.settle_tol),
                steady.max_decay_times,
            )
        )
        # A full window more: slow forcing leaves no period between settling and the end.
        last = max(settled, min(longest, steady.max_periods)) + steady.n_periods
        if steady.t_max is not None:
            last = math.floor(min(last, max(1.0, steady.t_max * scene.omega)))
        return cls(max(1, min(pause, last)), settled, last)


def _steady_response(question: Question) -> Generator[Request, Any, dict[str, Any]]:
    walk, steady = Walk(question.scene, question.start), question.steady
    limits = _Limits.of(question.scene, steady)
    window = _FIRST_WINDOW
    while walk.status is Status.OK:
        yield from walk.advance(limits.pause, record=False)
        settled = walk.n_periods >= limits.settled
        largest = steady.n_periods if settled else min(window, steady.n_periods)
        orbit = yield from _find_orbit(walk, steady, largest, limits)
        if orbit is None and settled:
            orbit = yield from _repeated(walk, steady)
        if orbit is not None:
            return _periodic(walk, steady, orbit)
        if walk.n_periods >= limits.last and walk.status is Status.OK:
            # A motion that was given no time to settle is nobody's example.
            exponents: Exponents | None = Exponents(math.nan, math.nan)
            if settled:
                exponents = yield from lyapunov(walk, limits.last)
            if exponents is None:
                break
            orbit = yield from _rattled(walk, steady, exponents)
            if orbit is not None:
                return _periodic(walk, steady, orbit, exponents)
            return _aperiodic(walk, steady, exponents)
        window *= 2
    return _failure(walk)


def _find_orbit(
    walk: Walk, steady: Steady, n_periods: int, limits: _Limits
) -> Generator[Request, Any, Orbit | None]:
    """Record a window, doubling it up to `n_periods`, until shooting finds the motion's orbit."""
    walk.forget()
    size = _FIRST_WINDOW
    while len(walk.section) < n_periods and walk.status is Status.OK:
        yield from walk.advance(min(size, n_periods) - len(walk.section), record=True)
        size *= 2
        closeness = max(_CLOSE * walk.reach, walk.same)
        n = converging_multiple(walk.section, closeness, steady.max_period_multiple)
        if n and walk.status is Status.OK:
            orbit = yield from shoot(walk, n)
            n_left = max(limits.last - walk.n_periods, 0)
            if orbit is not None and (yield from is_own(walk, orbit, n_left)):
                return orbit
    return None


def _repeated(walk: Walk, steady: Steady) -> Generator[Shot, Orbit | None, Orbit | None]:
    """A settled motion that repeats itself, though shooting could not improve on it.

    At loose tolerances the solver's noise is larger than any Newton residual allowed. What repeats
    less well than that may creep past where there is no orbit at all.
    """
    n = period_multiple(walk.section, walk.same, steady.max_period_multiple)
    if not n:
        return None
    # So coarse that it also repeats sooner?
    n = prime_multiple(walk.section[-n:], walk.same * math.sqrt(n))
    if not walk.scene.has_own_tangent:
        # A kink that is passed unlocated scatters more than that.
        sooner = likely_multiple(walk.section, _CLOSE * walk.reach, n)
        n = sooner if sooner and n % sooner == 0 else n
    return (yield from _as_it_is(walk, n))


def _rattled(
    walk: Walk, steady: Steady, exponents: Exponents
) -> Generator[Shot, Orbit | None, Orbit | None]:
    """A motion whose solver rattles it about a periodic orbit, more than its tolerances say.

    A kink that is passed unlocated throws a step off by more than its error estimate. The tangent
    is another solver's, so that the exponent tells this from chaos.
    """
    if walk.scene.has_own_tangent or not exponents.largest <= 3.0 * exponents.error:
        return None
    n = likely_multiple(walk.section, _CLOSE * walk.reach, steady.max_period_multiple)
    return (yield from _as_it_is(walk, n)) if n else None


def _as_it_is(walk: Walk, n: int) -> Generator[Shot, Orbit | None, Orbit | None]:
    """The next n forcing periods as a periodic orbit, closed or not, if they contract."""
    orbit = yield Shot(walk.y, n, goal=math.inf, furthest=0.0)
    largest = 1.0 if walk.scene.oscillator.zeta > 0.0 else 1.0 + _ON_CIRCLE
    return orbit if orbit is not None and abs(orbit.multipliers[0]) < largest else None


def _periodic(
    walk: Walk, steady: Steady, orbit: Orbit, measured: Exponents | None = None
) -> dict[str, Any]:
    modulus = abs(orbit.multipliers[0])
    if measured is None:
        # What has shrunk to nothing shrank on average as areas do.
        exponent = -walk.scene.oscillator.decay_rate
        if modulus > _NOTHING:
            exponent = math.log(modulus) * walk.omega / orbit.n
        measured = Exponents(exponent, 0.0)
    stability = {
        "response_class": ResponseClass.PERIODIC,
        "period_multiple": orbit.n,
        "multipliers": tuple(part for z in orbit.multipliers for part in (z.real, z.imag)),
        "multiplier_abs": modulus,
        "lyapunov": measured.largest,
        "lyapunov_error": measured.error,
        "section": tuple(orbit.part.states),
        "noise": walk.noise(orbit.n),
        "x_end": orbit.y[0],
        "v_end": orbit.y[1],
    }
    return _outcome(walk, steady, Status.OK, _turns(walk.scene, orbit), stability)


def _turns(scene: Scene, orbit: Orbit) -> list[float]:
    """Displacements [m] of the extrema of one whole period.

    Its end does not meet its start to the last bit. A turn just there would be missed, or counted
    at both: then the velocities have opposite signs, and the acceleration says which it is.
    """
    (_, v_start), (x_end, v_end) = orbit.y, orbit.part.y
    extrema = orbit.part.extrema
    if v_start * v_end >= 0.0:
        return extrema
    o, force = scene.oscillator, float(scene.law.force(x_end))
    springs = o.mass * o.omega_n_rad**2 * x_end + o.alpha * x_end**3 + force
    is_missed = (v_start - v_end) * (o.forcing - springs) > 0.0
    return [*extrema, x_end] if is_missed else extrema[1:]


def _aperiodic(walk: Walk, steady: Steady, exponents: Exponents) -> dict[str, Any]:
    # On an unstable orbit a disturbance grows too; but there the motion repeats itself.
    repeats = period_multiple(walk.section, walk.step_error, steady.max_period_multiple)
    chaotic = exponents.is_positive and not repeats
    section = walk.section[-steady.max_period_multiple :]
    stability = {
        "response_class": ResponseClass.CHAOTIC if chaotic else ResponseClass.UNRESOLVED,
        "lyapunov": exponents.largest,
        "lyapunov_error": exponents.error,
        "section": tuple(part for z in section for part in (z.real, z.imag * walk.omega_rad)),
        "noise": walk.noise(),
        "x_end": walk.y[0],
        "v_end": walk.y[1],
    }
    status = Status.OK if chaotic else Status.UNRESOLVED
    return _outcome(walk, steady, status, walk.extrema, stability)


def _outcome(
    walk: Walk,
    steady: Steady,
    status: Status,
    extrema: list[float],
    stability: dict[str, Any],
) -> dict[str, Any]:
    """Attributes of a `Response` but for what it has cost."""
    # A response without a turning point in its window still has a position.
    seen = extrema or [stability["x_end"]]
    x_max, x_min = max(seen), min(seen)
    left_range = max(abs(x_max), abs(x_min)) > walk.scene.law.valid_range
    n, closed = steady.max_extrema, stability["response_class"] is ResponseClass.PERIODIC
    values = {
        "status": Status.OUT_OF_FIT_RANGE if left_range else status,
        "extrema": tuple(extrema[:n]),
        "extremum_kind": _kinds(extrema, closed=closed)[:n],
        "n_extrema": len(extrema),
        "x_max": x_max,
        "x_min": x_min,
        "amplitude": 0.5 * (x_max - x_min),
        "t_settled": walk.t,
    }
    return values | stability


def _failure(walk: Walk) -> dict[str, Any]:
    left_range = not abs(walk.y[0]) <= walk.scene.law.valid_range
    status = Status.OUT_OF_FIT_RANGE if left_range else walk.status
    where = f"{walk.status.label} before t = {walk.t:.6g} s at x = {walk.y[0]:.3g} m"
    return {"status": status, "message": where}


def _kinds(x: list[float], *, closed: bool) -> tuple[int, ...]:
    """`ExtremumKind` of zero-velocity displacements in the order of time.

    What is passed on the way from one neighbour to the other is an inflection. `closed`: the first
    follows the last.
    """
    if len(x) < 2:
        return (int(ExtremumKind.INFLECTION),) * len(x)
    before, after = (np.roll(x, 1), np.roll(x, -1))
    if not closed:
        before[0], after[-1] = x[1], x[-2]
    is_maximum = (x > before) & (x > after)
    is_minimum = (x < before) & (x < after)
    return tuple((is_maximum.astype(int) - is_minimum).tolist())
