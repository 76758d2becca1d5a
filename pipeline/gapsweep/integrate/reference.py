"""Reference engine: scipy's `solve_ivp`, restarted at every contact.

The plain method that the paper uses, made safe. For the exact law the contact mode (below,
in the gap, above) is frozen while `solve_ivp` runs, a terminal event directed by the mode
ends the run at the wall, and a new run starts there. Three traps of that method are met:

* a run starts *on* its own event: the event function is divided by the time since the
  start, which removes that root and leaves all others;
* a contact shorter than a step changes no sign between step ends: every zero-velocity
  point of the dense output is checked against the walls, and the run is cut at the
  crossing that `solve_ivp` did not see;
* an event that makes no progress would restart for ever: counted, then status chatter.

Smooth laws, and the exact law without location, are integrated in one plain run.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import OdeSolution, solve_ivp
from scipy.interpolate import PPoly
from scipy.optimize import brentq

from gapsweep.errors import ModelError
from gapsweep.integrate.motion import SCALARS, Events, Motions, Sampler
from gapsweep.integrate.problem import Integrate, Models, Problems, Solver
from gapsweep.model.contact import ContactLaw, Piecewise
from gapsweep.model.oscillator import Oscillator
from gapsweep.status import Status

Array = NDArray[np.float64]
# Displacement and velocity; with the tangent also the images of a unit displacement and of a
# unit velocity at the start.
State = tuple[float, ...]
_UNIT_TANGENT = (1.0, 0.0, 0.0, 1.0)
Event = Callable[[float, Sequence[float]], float]

# Below this tolerance RK45 needs ten times the steps of DOP853.
TIGHT = 1e-6

# A displacement [m] that no machine survives; finite, so that blow-up is caught early.
DIVERGED_AT = 1e3
_MAX_STALLED = 100
_TOUCH = 1e-12

# solve_ivp does not report rejected steps; its evaluation count gives them away.
_START_NFEV = 2
_STEP_NFEV = {"RK45": 6, "DOP853": 12}
_DENSE_NFEV = {"RK45": 0, "DOP853": 3}

# A polynomial of this degree reproduces the dense output of both methods exactly.
_DEGREE = 7
_NODES = 0.5 - 0.5 * np.cos(np.pi * np.arange(_DEGREE + 1) / _DEGREE)
_TO_POWERS = np.linalg.inv(np.vander(_NODES, _DEGREE + 1))


@dataclass(frozen=True, slots=True)
class _Scene:
    """One point of a sweep, in the units of the right-hand side (seconds, radians)."""

    oscillator: Oscillator
    law: ContactLaw
    omega: float
    theta_0: float
    rtol: float
    atol: float
    tangent: bool

    @property
    def method(self) -> str:
        return "RK45" if self.rtol >= TIGHT else "DOP853"

    @property
    def located(self) -> bool:
        return isinstance(self.law, Piecewise) and self.law.located

    def wall(self, mode: int) -> float:
        return self.law.gap.j_2 if mode > 0 else -self.law.gap.j_1

    def force(self, mode: int | None) -> Callable[[float], float]:
        """Contact force: the law itself, or one branch of the exact one."""
        if mode is None:
            law = self.law
            return lambda x: float(law.force(x))
        stiffness = self.law.K_c if mode else 0.0
        wall = self.wall(mode)
        return lambda x: stiffness * (x - wall)

    def slope(self, mode: int | None) -> Callable[[float], float]:
        """Slope of `force`."""
        if mode is None:
            law = self.law
            return lambda x: float(law.derivative(x))
        stiffness = self.law.K_c if mode else 0.0
        return lambda x: stiffness

    def rhs(self, mode: int | None) -> Callable[[float, Array], State]:
        o = self.oscillator
        damping, stiffness = 2.0 * o.decay_rate, o.omega_n_rad**2
        cubic, forcing, mass = o.alpha / o.mass, o.forcing / o.mass, o.mass
        omega_rad, theta_0 = 2.0 * math.pi * self.omega, self.theta_0
        contact = self.force(mode)

        def f(t: float, y: Array) -> State:
            x, v = y.tolist()
            drive = forcing * math.cos(omega_rad * t + theta_0)
            return v, drive - damping * v - (stiffness + cubic * x * x) * x - contact(x) / mass

        if not self.tangent:
            return f
        contact_slope = self.slope(mode)

        def with_tangent(t: float, y: Array) -> State:
            x, _, *tangent = y.tolist()
            slope = stiffness + 3.0 * cubic * x * x + contact_slope(x) / mass
            (a, a_dot), (b, b_dot) = tangent[:2], tangent[2:]
            images = a_dot, -damping * a_dot - slope * a, b_dot, -damping * b_dot - slope * b
            return (*f(t, y[:2]), *images)

        return with_tangent

    def mode_at(self, t: float, y: State) -> int:
        """Contact mode; on a wall the direction of motion decides, then acceleration."""
        x, v = y[:2]
        a = self.rhs(0)(t, np.array(y))[1]
        # A contact shorter than a picosecond cannot be told from a touch.
        heading = v if abs(v) > _TOUCH * abs(a) else a
        for mode in (1, -1):
            beyond = mode * (x - self.wall(mode))
            if beyond > 0.0 or (beyond == 0.0 and mode * heading > 0.0):
                return mode
        return 0


@dataclass(frozen=True, slots=True)
class _Segment:
    """A stretch of motion in one contact mode, and the wall it ended on."""

    t: float
    y: State
    motion: PPoly
    wall: float | None = None


@dataclass(slots=True)
class _Record:
    """What accumulates over the segments of a run."""

    t_contacts: list[float] = field(default_factory=list)
    n_steps: int = 0
    n_rejected: int = 0
    nfev: int = 0
    pieces: list[PPoly] = field(default_factory=list)
    status: Status = Status.OK

    def count(self, scene: _Scene, nfev: int, n_steps: int) -> None:
        method = scene.method
        attempts = nfev - _START_NFEV - n_steps * _DENSE_NFEV[method]
        self.nfev += nfev
        self.n_steps += n_steps
        self.n_rejected += attempts // _STEP_NFEV[method] - n_steps


def prepared(models: Models, solver: Solver) -> Integrate:
    """Integration of models with scipy, one after the other.

    RK45 for ``rtol >= 1e-6``, DOP853 below; `solver.atol` holds for both m and m/s.

    Raises
    ------
    ModelError
        If a model is no oscillator.
    """
    if not models.is_plain:
        raise ModelError("engine = 'scipy': moves oscillators alone; a System needs 'compiled'")

    def integrate(problems: Problems) -> Motions:
        runs = [_run(models, problems, i, solver) for i in range(len(problems))]
        columns = {name: np.array([getattr(run, name) for run in runs]) for name in SCALARS}

        def sampler(i: int) -> Sampler:
            motion, t_0 = runs[i].motion, problems.t_0[i]
            return lambda t: np.moveaxis(motion(t - t_0), -1, 0)[:2]

        monodromy = None
        if problems.tangent:
            columns_first = np.array([run.tangent for run in runs]).reshape(-1, 2, 2)
            monodromy = columns_first.transpose(0, 2, 1)
        return Motions(
            state=np.array([run.state for run in runs]).reshape(-1, 2),
            reach=np.array([[run.reach] for run in runs]).reshape(-1, 1),
            events=lambda: _events(runs),
            sampler=sampler,
            monodromy=monodromy,
            **columns,
        )

    return integrate


@dataclass(frozen=True, slots=True, kw_only=True)
class _Run:
    """One finished motion; names as in `Motions`."""

    t: float
    state: State
    status: Status
    n_contacts: int
    n_steps: int
    n_rejected: int
    nfev: int
    reach: float
    tangent: State
    t_extrema: Array
    extrema: Array
    t_contacts: Array
    section: Array
    motion: PPoly


def _events(runs: Sequence[_Run]) -> Events:
    names = ("t_extrema", "extrema", "t_contacts", "section")
    lists = {name: [getattr(run, name) for run in runs] for name in names}
    merged = {name: np.concatenate(arrays) for name, arrays in lists.items()}
    return Events(
        **merged,
        extrema_of=np.zeros(len(merged["extrema"]), np.int64),
        contacts_of=np.zeros(len(merged["t_contacts"]), np.int64),
        n_extrema=np.array([len(extrema) for extrema in lists["extrema"]]),
        n_contacts=np.array([len(t_contacts) for t_contacts in lists["t_contacts"]]),
        n_section=np.array([len(section) for section in lists["section"]]),
    )


def _run(models: Models, problems: Problems, i: int, solver: Solver) -> _Run:
    model = int(problems.which[i])
    t_0, omega = float(problems.t_0[i]), float(models.omega[model])
    t_end = float(problems.t_end[i])
    theta_0 = 2.0 * math.pi * math.fmod(omega * t_0, 1.0)
    scene = _Scene(
        models.systems[model],
        models.laws[model],
        omega,
        theta_0,
        solver.rtol,
        solver.atol,
        problems.tangent,
    )
    run = _Record()
    start: State = tuple(problems.start[i].tolist())
    if problems.tangent:
        start += _UNIT_TANGENT
    # An overflow on the way to divergence is an outcome, not a fault of this code.
    with np.errstate(all="ignore"):
        t, y = (_located if scene.located else _plain)(scene, run, start, t_end - t_0)
    motion, since = _joined(run.pieces), float(problems.record_from[i]) - t_0
    t_extrema, extrema = _extrema(motion)
    is_late, t_contacts = t_extrema >= since, np.array(run.t_contacts)
    return _Run(
        t=t_end if run.status is Status.OK else t_0 + t,
        state=y[:2],
        status=run.status,
        n_contacts=len(run.t_contacts),
        n_steps=run.n_steps,
        n_rejected=run.n_rejected,
        nfev=run.nfev,
        reach=float(np.abs([y[0], *motion.c[-1, :, 0]]).max()),  # at the ends of its pieces
        tangent=y[2:],
        t_extrema=t_0 + t_extrema[is_late],
        extrema=extrema[is_late],
        t_contacts=t_0 + t_contacts[t_contacts >= since],
        section=_section(motion, scene, since, t),
        motion=motion,
    )


def _plain(scene: _Scene, run: _Record, y_0: State, t_end: float) -> tuple[float, State]:
    """One run without stops; wall crossings are read off the motion afterwards."""
    segment = _solve(scene, run, None, 0.0, y_0, t_end)
    crossings = [_roots(segment.motion, 0, scene.wall(mode)) for mode in (-1, 1)]
    run.t_contacts = np.sort(np.concatenate(crossings)).tolist()
    run.pieces.append(segment.motion)
    return segment.t, segment.y


def _located(scene: _Scene, run: _Record, y_0: State, t_end: float) -> tuple[float, State]:
    """Segments of one contact mode each, restarted at every contact."""
    t, y, mode, stalled = 0.0, y_0, scene.mode_at(0.0, y_0), 0
    while t < t_end:
        segment = _cut_at_missed_contact(scene, mode, _solve(scene, run, mode, t, y, t_end))
        run.pieces.append(segment.motion)
        stalled = stalled + 1 if segment.t <= t + 16.0 * np.spacing(t) else 0
        t, y = segment.t, segment.y
        if segment.wall is None:
            break
        if stalled > _MAX_STALLED:
            run.status = Status.CHATTER
            break
        y = (segment.wall, *y[1:])
        previous, mode = mode, scene.mode_at(t, y)
        # With both walls in one place a single crossing leaves one and enters the other.
        run.t_contacts += [t] * abs(mode - previous)
    return t, y


def _solve(
    scene: _Scene, run: _Record, mode: int | None, t: float, y: State, t_end: float
) -> _Segment:
    """Run `solve_ivp` until `t_end`, the next contact or divergence."""
    sides = _exits(mode)
    solution = solve_ivp(
        scene.rhs(mode),
        (t, t_end),
        y,
        scene.method,
        dense_output=True,
        events=[_contact_event(scene, mode, side, t, y) for side in sides] + [_diverged],
        rtol=scene.rtol,
        atol=scene.atol,
    )
    run.count(scene, solution.nfev, len(solution.t) - 1)
    moved = len(solution.t) > 1
    motion = _polynomial(solution.sol) if moved else _resting(t, solution.y[:, 0])
    end = tuple(solution.y[:, -1].tolist())
    *contacts, diverged = solution.t_events
    if diverged.size or not all(map(math.isfinite, end)):
        run.status = Status.DIVERGED
    elif solution.status < 0:
        lost = _is_undefined_ahead(scene.rhs(mode), solution.t[-1], solution.y[:, -1])
        run.status = Status.DIVERGED if lost else Status.STEP_UNDERFLOW
    hit = [scene.wall(side) for side, times in zip(sides, contacts, strict=True) if times.size]
    return _Segment(float(solution.t[-1]), end, motion, hit[0] if hit else None)


def _is_undefined_ahead(rhs: Callable[[float, Array], State], t: float, y: Array) -> bool:
    """Whether steps became too small because a little farther on the force is no number."""
    slope = np.asarray(rhs(t, y))
    steps = 10.0 * np.spacing(t) * 10.0 ** np.arange(7)
    return any(not np.all(np.isfinite(rhs(t + h, y + h * slope))) for h in steps)


def _exits(mode: int | None) -> tuple[int, ...]:
    """Sides (-1 lower, 1 upper wall) on which a contact mode can end."""
    return () if mode is None else (mode,) if mode else (-1, 1)


def _contact_event(
    scene: _Scene, mode: int | None, side: int, t_start: float, y_start: State
) -> Event:
    """Terminal event at a wall: the distance beyond it, blind to a root at its own start."""
    wall = scene.wall(side)
    on_wall = y_start[0] == wall
    sign = 1.0 if mode else -1.0

    def event(t: float, y: Sequence[float]) -> float:
        beyond = side * (y[0] - wall)
        if not on_wall:
            return float(beyond)
        return float(beyond / (t - t_start)) if t > t_start else sign

    event.terminal = True  # type: ignore[attr-defined]  # how scipy takes event options
    event.direction = -sign  # type: ignore[attr-defined]  # how scipy takes event options
    return event


def _diverged(t: float, y: Sequence[float]) -> float:
    return abs(y[0]) - DIVERGED_AT


_diverged.terminal = True  # type: ignore[attr-defined]  # how scipy takes event options


def _cut_at_missed_contact(scene: _Scene, mode: int, segment: _Segment) -> _Segment:
    """End a segment at the contact that two step ends straddle unseen, if there is one."""
    turns = _roots(segment.motion, 1, 0.0)
    if not turns.size:
        return segment
    x_turns = segment.motion(turns)[:, 0]
    # A touch within rounding of the wall is not a contact.
    slack = 8.0 * np.finfo(float).eps * max(scene.law.gap.j_1, scene.law.gap.j_2)
    allowed = 1.0 if mode else -1.0
    missed = []
    for side in _exits(mode):
        wall = scene.wall(side)
        wrong = np.flatnonzero(allowed * side * (x_turns - wall) < -slack)
        if wrong.size and (segment.wall != wall or turns[wrong[0]] < segment.t):
            missed.append((int(wrong[0]), wall))
    if not missed:
        return segment
    # The earliest one, of either wall: what follows it is no motion.
    first, wall = min(missed)
    t_before = turns[first - 1] if first else segment.motion.x[0]
    return _cut(segment, t_before, turns[first], wall)


def _cut(segment: _Segment, t_before: float, t_beyond: float, wall: float) -> _Segment:
    def distance(t: float) -> float:
        return float(segment.motion(t)[0]) - wall

    straddles = distance(t_before) * distance(t_beyond) < 0.0
    t = float(brentq(distance, t_before, t_beyond, xtol=1e-15)) if straddles else t_before
    last = int(np.searchsorted(segment.motion.x, t, side="left"))
    breaks = np.append(segment.motion.x[:last], t)
    motion = PPoly.construct_fast(segment.motion.c[:, : breaks.size - 1], breaks)
    return _Segment(t, (wall, *motion(t)[1:].tolist()), motion, wall)


def _resting(t: float, y: Array) -> PPoly:
    """A motion that ends where it starts, because its first step has failed."""
    powers = np.zeros((_DEGREE + 1, 1, len(y)))
    powers[-1] = y
    return PPoly.construct_fast(powers, np.array([t, np.nextafter(t, math.inf)]))


def _polynomial(solution: OdeSolution) -> PPoly:
    """The dense output of `solve_ivp` as one piecewise polynomial of the state."""
    breaks = np.asarray(solution.ts)
    h = np.diff(breaks)
    nodes = breaks[:-1, None] + h[:, None] * _NODES
    # Shared step ends belong to the step on their left or right: both give the same value.
    values = solution(nodes.ravel()).reshape(-1, h.size, _DEGREE + 1)
    powers = np.einsum("pn,ysn->psy", _TO_POWERS, values)
    powers /= h[None, :, None] ** np.arange(_DEGREE, -1, -1)[:, None, None]
    return PPoly.construct_fast(powers, breaks)


def _joined(pieces: list[PPoly]) -> PPoly:
    coefficients = np.concatenate([piece.c for piece in pieces], axis=1)
    breaks = np.concatenate([pieces[0].x[:1], *(piece.x[1:] for piece in pieces)])
    return PPoly.construct_fast(coefficients, breaks)


def _roots(motion: PPoly, component: int, value: float) -> Array:
    """Times after the start at which x (component 0) or v (component 1) takes a value."""
    single = PPoly.construct_fast(np.ascontiguousarray(motion.c[:, :, component]), motion.x)
    roots = np.sort(single.solve(value, discontinuity=False, extrapolate=False))
    roots = roots[np.isfinite(roots)]
    # A root on a step end is reported by both steps, the one at the start belongs to before.
    resolution = 1e-9 * float(np.min(np.diff(motion.x)))
    after_start = np.diff(roots, prepend=motion.x[0]) > resolution
    return np.asarray(roots[after_start])


def _extrema(motion: PPoly) -> tuple[Array, Array]:
    t = _roots(motion, 1, 0.0)
    return t, motion(t)[:, 0] if t.size else t


def _section(motion: PPoly, scene: _Scene, since: float, t_end: float) -> Array:
    """(x, v) at every whole forcing period after the start, from the time `since` on."""
    phase = scene.theta_0 / (2.0 * math.pi)
    last = math.floor(scene.omega * t_end + phase + 1e-9)
    t = (np.arange(math.floor(phase + 1e-9) + 1, last + 1) - phase) / scene.omega
    return np.asarray(motion(np.minimum(t[t >= since], t_end)))[:, :2]
