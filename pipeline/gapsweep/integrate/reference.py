"""Reference engine: scipy's `solve_ivp`, restarted at every contact.

The plain method that the paper uses, made safe. For the exact law the contact mode (below,
in the gap, above) is frozen while `solve_ivp` runs, a terminal event directed by the mode
ends the run at the wall, and a new run starts there. Three problems of that method are solved:

* a run starts *on* its own event: the event function is divided by the time since the
  start, which removes that root and leaves all others;
* a contact shorter than a step changes no sign between step ends: every zero-velocity
  point of the dense output is checked against the walls, and the run is cut at the
  crossing that `solve_ivp` did not see;
* an event that makes no progress would restart for ever: counted, then status chatter.

Smooth laws, and the exact law without location, are integrated in one plain run.
"""

import math
from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853, RK45, solve_ivp
from scipy.interpolate import PPoly
from scipy.optimize import brentq

from gapsweep.integrate.motions import COUNTS, SCALARS, Events, Motions
from gapsweep.integrate.overlap import apart
from gapsweep.integrate.problem import Integrate, Models, Problems, Solver
from gapsweep.integrate.reference_impacts import (
    Meeting,
    changed,
    has_dependent_holds,
    held_tangent,
    hold_ends,
    hold_force,
    is_caught,
    is_inside,
    longest_step,
    meet,
    moving,
    on_walls,
    settled,
    still,
    stopped,
    turned,
)
from gapsweep.integrate.reference_motion import (
    extrema_of,
    gap_of,
    joined,
    polynomial,
    resting,
    roots,
    sampled,
    section_of,
    turning,
)
from gapsweep.integrate.reference_scenes import (
    Force,
    Modes,
    Pressure,
    ReferenceScene,
    State,
    Watched,
    scene_of,
)
from gapsweep.model.contact_modes import HOLD, MODES
from gapsweep.model.user_law import UserLaw
from gapsweep.status import DIVERGED_AT, Status

Array = NDArray[np.float64]
Event = Callable[[float, Sequence[float]], float]

# Fields of `Events` that are lists of events; the others are their lengths.
_EVENTS = [each.name for each in fields(Events) if not each.name.startswith("n_")]
_MAX_STALLED = 100
_MAX_IMPACTS = 10_000  # at one time
# Parts of a step at which a force is sampled; nodes and weights of Gauss's rule on [-1, 1].
_SAMPLES = np.linspace(0.0, 1.0, 17)
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_NEAR = 1e-9  # of a gap: how far rounding puts a contact from the wall that it has just passed

# solve_ivp does not report rejected steps; they follow from its evaluation count.
_START_NFEV = 2
_STEP_NFEV = {"RK45": 6, "DOP853": 12}
_DENSE_NFEV = {"RK45": 0, "DOP853": 3}


class _ShortestStep:
    """Mixin of a method of scipy: a step below the rounding of the end time fails.

    scipy compares a step with the present time, which is zero when a motion begins: where the force
    is undefined next to that state, it would go on with steps of 1e-160 s.
    """

    t: float
    t_bound: float
    h_previous: float
    TOO_SMALL_STEP: str

    def _step_impl(self) -> tuple[bool, str | None]:
        is_done, message = super()._step_impl()  # type: ignore[misc]  # of the method of scipy
        if is_done and self.t < self.t_bound and self.h_previous < np.spacing(self.t_bound):
            return False, self.TOO_SMALL_STEP
        return is_done, message


class _RK45(_ShortestStep, RK45):
    pass


class _DOP853(_ShortestStep, DOP853):
    pass


_METHODS = {"RK45": _RK45, "DOP853": _DOP853}


@dataclass(frozen=True, slots=True)
class _Segment:
    """A part of the motion in constant contact modes, and what has ended it."""

    t: float
    y: State
    motion: PPoly
    hit: Watched | None = None


@dataclass(slots=True)
class _Record:
    """Contacts, counts and pieces of motion, accumulated over the segments of a run."""

    time: list[float]  # in which each contact acts, if located
    force: list[float]  # the largest one of each
    contacts: list[tuple[float, int]] = field(default_factory=list)  # time, contact
    n_steps: int = 0
    n_rejected: int = 0
    nfev: int = 0
    pieces: list[PPoly] = field(default_factory=list)
    loss: float = 0.0
    status: Status = Status.OK
    rebounds: list[tuple[float, State, State]] = field(default_factory=list)
    holds: list[tuple[int, float, float]] = field(default_factory=list)  # contact, beginning, end
    reach: Array | float = 0.0  # largest displacements at the ends of segments

    def count(self, scene: ReferenceScene, nfev: int, n_steps: int) -> None:
        method = scene.method
        nfev -= n_steps * _DENSE_NFEV[method]  # evaluations for dense output
        self.nfev += nfev
        self.n_steps += n_steps
        self.n_rejected += (nfev - _START_NFEV) // _STEP_NFEV[method] - n_steps


@apart
def prepared(models: Models, solver: Solver) -> Integrate:
    """Return the function that integrates these models with scipy, one motion after the other.

    RK45 for ``rtol >= 1e-6``, DOP853 below; the absolute tolerance holds for both m and m/s.
    """
    solver.check_located(models.n_located, len(models.laws[0]), is_oscillator=False)
    models.check_losses(solver)
    is_lossy = models.is_lossy
    has_modes = is_lossy and models.n_located > 0
    atol = models.absolute(solver)

    def integrate(problems: Problems) -> Motions:
        runs: list[_ReferenceMotion] = []
        for i in range(len(problems)):
            before = runs[-1] if problems.follows is not None and problems.follows[i] else None
            tolerances = solver.rtol, float(atol[problems.which[i]])
            given = *tolerances, problems.tangent, solver.contact_force
            runs.append(_run(models, problems, i, given, before))
        columns = {name: np.array([getattr(run, name) for run in runs]) for name in SCALARS}

        def sampler(t: Array) -> Array:
            motions = zip(runs, problems.t_0, strict=True)
            states = [run.motion(t - t_0)[:, : run.n_states] for run, t_0 in motions if run.motion]
            return np.moveaxis(np.reshape(states, (len(runs), t.size, -1)), -1, 0)

        monodromy = None
        if problems.tangent:
            n_states = problems.start.shape[1]
            columns_first = np.array([run.tangent for run in runs])
            monodromy = columns_first.reshape(-1, n_states, n_states).transpose(0, 2, 1)
        return Motions(
            state=np.array([run.state for run in runs]).reshape(problems.start.shape),
            reach=np.array([run.reach for run in runs]).reshape(len(runs), -1),
            events=lambda: _events(runs),
            sampler=sampler,
            monodromy=monodromy,
            contact_loss=np.array([run.loss for run in runs]),
            contact_time=np.array([run.time for run in runs]) if has_modes else None,
            contact_force=np.array([run.force for run in runs]) if is_lossy else None,
            **columns,
        )

    return integrate


@dataclass(frozen=True, slots=True, kw_only=True)
class _ReferenceMotion:
    """One finished motion; names as in `Motions`."""

    t: float
    state: State
    status: Status
    n_contacts: int
    n_steps: int
    n_rejected: int
    nfev: int
    loss: float
    time: list[float]
    force: list[float]
    reach: Array
    tangent: State
    t_extrema: Array
    extrema: Array
    extrema_of: NDArray[np.int64]
    t_contacts: Array
    contacts_of: NDArray[np.int64]
    t_section: Array
    section: Array
    motion: PPoly | None  # with dense output only: it is as large as all of its steps

    @property
    def n_states(self) -> int:
        return len(self.state)


def _events(runs: Sequence[_ReferenceMotion]) -> Events:
    lists = {name: [getattr(run, name) for run in runs] for name in _EVENTS}
    return Events(
        **{name: np.concatenate(arrays) for name, arrays in lists.items()},
        n_extrema=np.array([len(extrema) for extrema in lists["extrema"]]),
        n_contacts=np.array([len(t_contacts) for t_contacts in lists["t_contacts"]]),
        n_section=np.array([len(section) for section in lists["section"]]),
    )


def _run(
    models: Models,
    problems: Problems,
    i: int,
    given: tuple[float, float, bool, str],
    before: "_ReferenceMotion | None",
) -> _ReferenceMotion:
    """Integrate problem i, from the end of the run `before` if it follows one."""
    if before and before.t < problems.t_end[i - 1]:
        cost: dict[str, Any] = dict.fromkeys(COUNTS, 0)
        nothing = {name: getattr(before, name)[:0] for name in _EVENTS}
        return replace(before, t=float(problems.t_0[i]), loss=0.0, **cost, **nothing)
    model = int(problems.which[i])
    t_0, omega = float(problems.t_0[i]), float(models.omega[model])
    t_end = float(problems.t_end[i])
    theta_0 = 2.0 * math.pi * math.fmod(omega * t_0, 1.0)
    system = models.systems[models.system[model]]
    scene = scene_of(system)(
        system,
        models.laws[models.law[model]],
        omega,
        theta_0,
        *given,
        t_0=t_0,
    )
    largest = [math.nan if law.losses.is_rigid else 0.0 for law in scene.laws]
    run = _Record(time=[0.0] * len(scene.laws), force=largest)
    start: State = before.state if before else tuple(problems.start[i].tolist())
    if problems.tangent:
        start += tuple(np.eye(len(start)).ravel().tolist())
    # An overflow on the way to divergence is an outcome, not an error.
    with np.errstate(all="ignore"):
        t, y = 0.0, start
        for knot in scene.knots(t_end - t_0):
            part = replace(scene, piece=0.5 * (t + knot))
            t, y = (_located if scene.located else _plain)(part, run, t, y, knot)
            if run.status is not Status.OK:
                break
    motion, since = joined(run.pieces), float(problems.record_from[i]) - t_0
    n, turns = scene.n_states, _turns(scene, run, motion)
    t_extrema, extrema = (np.concatenate([turn[k] for turn in turns]) for k in (0, 1))
    of = np.repeat(range(len(turns)), [len(turn[0]) for turn in turns])
    is_late, contacts = t_extrema >= since, np.array(run.contacts).reshape(-1, 2)
    contacts = contacts[contacts[:, 0] >= since]
    t_section, section = section_of(motion, scene, since, t)
    return _ReferenceMotion(
        t=t_end if run.status is Status.OK else t_0 + t,
        state=y[:n],
        status=_judged(run.status, scene, motion),
        n_contacts=len(run.contacts),
        n_steps=run.n_steps,
        n_rejected=run.n_rejected,
        nfev=run.nfev,
        loss=run.loss,
        time=run.time,
        force=run.force,
        # at the ends of its pieces
        reach=np.abs([y[: scene.n], *motion.c[-1, :, : scene.n]]).max(axis=0),
        tangent=y[n:],
        t_extrema=t_0 + t_extrema[is_late],
        extrema=extrema[is_late],
        extrema_of=of[is_late],
        t_contacts=t_0 + contacts[:, 0],
        contacts_of=contacts[:, 1].astype(np.int64),
        t_section=t_0 + t_section,
        section=section,
        motion=motion if problems.dense_output else None,
    )


def _turns(scene: ReferenceScene, run: _Record, motion: PPoly) -> list[tuple[Array, Array]]:
    """Times and values of the extrema of all quantities, in the order of time."""
    found = []
    for i, each in enumerate(turning(scene, motion)):
        times, values = extrema_of(each)
        contact = i - scene.n
        for held, begin, end in run.holds:  # rounding errors of its place on the wall
            is_free = (times <= begin) | (times > end) | (held != contact)
            times, values = times[is_free], values[is_free]
        on_walls = [
            (t, _along(scene, i, y[: scene.n]))
            for t, y, before in run.rebounds
            if _turns_back(*(_along(scene, i, v[scene.n :]) for v in (before, y)))
        ]
        if on_walls:
            more = np.array(on_walls).T
            times, values = np.append(times, more[0]), np.append(values, more[1])
            order = np.argsort(times, kind="stable")
            times, values = times[order], values[order]
        found.append((times, values))
    return found


def _along(scene: ReferenceScene, i: int, vector: Sequence[float]) -> float:
    """Coordinate i of a vector, or its component along a contact after all coordinates."""
    return vector[i] if i < scene.n else scene.gap(i - scene.n, vector)


def _turns_back(before: float, after: float) -> bool:
    return before != 0.0 and before * after <= 0.0


def _judged(status: Status, scene: ReferenceScene, motion: PPoly) -> Status:
    """Return `status`, or OUT_OF_FIT_RANGE if a gap has left the valid range of its law."""
    if status not in (Status.OK, Status.DIVERGED, Status.STEP_UNDERFLOW):
        return status
    for contact, law in enumerate(scene.laws):
        low, high = law.valid_range
        gap = gap_of(scene, motion, contact)
        seen = np.concatenate([extrema_of(gap)[1], gap(motion.x[[0, -1]])[:, 0]])
        if np.any((seen < low) | (seen > high)):
            return Status.OUT_OF_FIT_RANGE
    return status


def _plain(
    scene: ReferenceScene, run: _Record, t: float, y_0: State, t_end: float
) -> tuple[float, State]:
    """Integrate without stops; wall crossings are roots of the dense output, found afterwards."""
    segment = _solve(scene, run, None, t, y_0, t_end, None)
    for contact, law in enumerate(scene.laws):
        gap = gap_of(scene, segment.motion, contact)
        for wall in law.walls:
            run.contacts += [(t, contact) for t in roots(gap, 0, wall).tolist()]
    run.contacts.sort()
    _add_losses(scene, run, None, segment)
    run.pieces.append(segment.motion)
    return segment.t, segment.y


def _located(
    scene: ReferenceScene, run: _Record, t: float, y_0: State, t_end: float
) -> tuple[float, State]:
    """Integrate in segments of constant contact modes, restarted at every located contact."""
    y, modes, stalled = y_0, scene.modes_at(t, y_0), 0
    passed: Watched | None = None
    if not is_inside(scene, y):
        run.status = Status.MODEL_INVALID
        run.pieces.append(resting(t, np.array(y)))
        return t, y
    run.reach = np.maximum(run.reach, np.abs(y[: scene.n]))
    on = on_walls(scene, y)
    for contact, side in on.items():
        if scene.laws[contact].losses.is_rigid:
            y = _on_wall(scene, y, Watched(contact, side, False, scene.wall(contact, side)))
    y, modes = _impacts(scene, run, t, y, modes, on)
    y, modes = _with_holds(scene, run, t, y, modes, on)
    while t < t_end and run.status is Status.OK:
        found = _solve(scene, run, modes, t, y, t_end, passed, on)
        segment = _cut_at_missed_contact(scene, modes, found)
        run.pieces.append(segment.motion)
        for contact, mode in enumerate(modes):
            run.time[contact] += (segment.t - t) * MODES[abs(mode)].acts
            if abs(mode) == HOLD:
                run.holds.append((contact, t, segment.t))
        _add_losses(scene, run, modes, segment)
        stalled = stalled + 1 if segment.t <= t + 16.0 * np.spacing(t) else 0
        t, y = segment.t, segment.y
        if segment.hit is None:
            break
        if stalled > _MAX_STALLED:
            run.status = Status.CHATTER
            break
        passed, contact, previous = segment.hit, segment.hit.contact, modes
        on = {k: 1 if mode > 0 else -1 for k, mode in enumerate(modes) if abs(mode) == HOLD}
        run.reach = np.maximum(run.reach, np.abs(y[: scene.n]))
        is_at_wall = passed.force is None and not passed.hold
        if is_at_wall:
            on[contact] = 1 if (modes[contact] or passed.side) > 0 else -1
        if is_at_wall and scene.laws[contact].losses.is_rigid:
            y, modes = _impacts(scene, run, t, y, modes, on)
        else:
            if is_at_wall:
                y, modes = _caught(scene, run, t, y, modes, contact, on[contact])
            if modes is previous:
                modes = scene.passed(t, y, modes, passed)
            if passed.force is None:
                y = held_tangent(scene, scene.jumped(y, previous, modes), modes)
            run.contacts += changed(t, previous, modes)
        moved = modes
        undecided = {k: side for k, side in on.items() if not (passed.hold and k == contact)}
        y, modes = _with_holds(scene, run, t, y, modes, undecided)
        if modes != moved and is_at_wall and not scene.laws[contact].losses.is_rigid:
            y = turned(scene, t, y, moved, modes, contact)
        run.contacts += changed(t, moved, modes)
    return t, y


def _impacts(
    scene: ReferenceScene,
    run: _Record,
    t: float,
    y: State,
    modes: tuple[int, ...],
    on: dict[int, int],
) -> tuple[State, tuple[int, ...]]:
    """Return state and modes after impacts of contacts on rigid walls, one after the other."""
    # Speeds of plastic walls that are met at one time fall in a geometric series.
    slow = {contact: still(scene, contact, y) for contact in on}
    for _ in range(_MAX_IMPACTS):
        meeting = [
            (contact, side)
            for contact, side in on.items()
            if scene.laws[contact].losses.is_rigid
            and not modes[contact]
            and side * scene.gap(contact, y[scene.n :]) > slow[contact]
        ]
        if not meeting or run.status is not Status.OK:
            return y, modes
        y, modes = _met(scene, run, t, y, meet(scene, t, y, modes, *min(meeting)))
    run.status = Status.CHATTER
    return y, modes


def _with_holds(
    scene: ReferenceScene,
    run: _Record,
    t: float,
    y: State,
    modes: tuple[int, ...],
    on: dict[int, int],
) -> tuple[State, tuple[int, ...]]:
    """Return state and modes in which walls hold those contacts `on` them that they must hold."""
    found = settled(scene, t, y, modes, on)
    if has_dependent_holds(scene, found):
        run.status = Status.MODEL_INVALID
        return y, found
    if any(abs(new) == HOLD and old != new for old, new in zip(modes, found, strict=True)):
        y, run.loss = stopped(scene, y, found), math.inf
    return y, found


def _met(
    scene: ReferenceScene, run: _Record, t: float, y: State, met: Meeting
) -> tuple[State, tuple[int, ...]]:
    """Record the meeting of a rigid wall; return state and modes after it."""
    if has_dependent_holds(scene, met.modes):
        run.status = Status.MODEL_INVALID
    run.contacts += met.changes
    run.loss += met.loss
    run.rebounds.append((t, met.y, y))
    for contact, mode in enumerate(met.modes):
        if abs(mode) == HOLD and met.rest:
            run.time[contact] -= met.rest * (met.changes[-1][1] == contact)
    return met.y, met.modes


def _caught(
    scene: ReferenceScene,
    run: _Record,
    t: float,
    y: State,
    modes: tuple[int, ...],
    contact: int,
    side: int,
) -> tuple[State, tuple[int, ...]]:
    """Return state and modes at a wall, in mode hold if it is a preload that holds."""
    if not is_caught(scene, t, y, modes, contact, side, np.asarray(run.reach)):
        return y, modes
    modes, run.loss = (*modes[:contact], side * HOLD, *modes[contact + 1 :]), math.inf
    return stopped(scene, y, modes), modes


def _add_losses(scene: ReferenceScene, run: _Record, modes: Modes, segment: _Segment) -> None:
    """Add a segment's part of `Motions.contact_loss`, and keep the largest forces."""
    steps = np.diff(segment.motion.x)
    for contact, law in enumerate(scene.laws):
        if not law.losses:
            continue
        gap, force = gap_of(scene, segment.motion, contact), scene.force(contact, modes)
        damping = scene.damping(contact, modes)
        rates = _sampled(gap, 0.5 + 0.5 * _NODES, damping) @ _WEIGHTS
        run.loss += float(scene.compliance[contact] * (0.5 * steps @ rates))
        is_held = modes is not None and abs(modes[contact]) == HOLD and law.losses.preload
        if is_held or isinstance(force, Pressure):
            if isinstance(force, Pressure):
                along = _force_motion(gap, force)
            else:
                along = sampled(segment.motion, hold_force(scene, modes or (), contact))
            seen = np.append(along(gap.x[[0, -1]])[:, 0], extrema_of(along)[1])
        else:
            seen = _with_vertices(_sampled(gap, _SAMPLES, force))
        run.force[contact] = max(run.force[contact], float(np.abs(seen).max()))


def _sampled(gap: PPoly, parts: Array, function: Force) -> Array:
    """Values of a function of gap and speed after parts of each step; shape (n_steps, n_parts)."""
    times = gap.x[:-1, None] + np.diff(gap.x)[:, None] * parts
    states = gap(times).reshape(-1, 2).tolist()
    return np.reshape([function(*state) for state in states], times.shape)


def _with_vertices(sampled: Array) -> Array:
    """Values at equal distances along the last axis, and vertices of the parabolas through them."""
    before, middle, after = sampled[:, :-2], sampled[:, 1:-1], sampled[:, 2:]
    is_turn = (middle - before) * (middle - after) > 0.0
    bend = np.where(is_turn, 2.0 * middle - before - after, 1.0)
    vertices = middle + np.where(is_turn, (before - after) ** 2 / (8.0 * bend), 0.0)
    return np.concatenate([sampled, vertices], axis=1)


def _solve(
    scene: ReferenceScene,
    run: _Record,
    modes: Modes,
    t: float,
    y: State,
    t_end: float,
    passed: Watched | None,
    on: Container[int] = (),
) -> _Segment:
    """Run `solve_ivp` until `t_end`, the next contact or divergence.

    Parameters
    ----------
    passed : Watched, optional
        The wall or zero force that the motion has passed just before.
    on : container of int
        Contacts on a wall at `t`.
    """
    exits = _exits(scene, modes)
    solution = solve_ivp(
        scene.rhs(modes) if modes is None else moving(scene, modes),
        (t, t_end),
        y,
        _METHODS[scene.method],
        dense_output=True,
        events=[_contact_event(scene, each, t, y, passed, on) for each in exits]
        + [_Stop(lambda t, y: max(map(abs, y[: scene.n])) - DIVERGED_AT)],
        rtol=scene.rtol,
        atol=scene.atol,
        max_step=longest_step(scene, modes or ()),
    )
    run.count(scene, solution.nfev, len(solution.t) - 1)
    moved = len(solution.t) > 1
    motion = polynomial(solution.sol) if moved else resting(t, solution.y[:, 0])
    end = tuple(solution.y[:, -1].tolist())
    *contacts, diverged = solution.t_events
    if diverged.size or not all(map(math.isfinite, end)):
        run.status = Status.DIVERGED
    elif solution.status < 0:
        ahead = 10.0 * np.spacing(max(solution.t[-1], t_end))
        lost = _is_undefined_ahead(scene.rhs(modes), solution.t[-1], solution.y[:, -1], ahead)
        why = Status.MODEL_INVALID if UserLaw in map(type, scene.laws) else Status.DIVERGED
        run.status = why if lost else Status.STEP_UNDERFLOW
    hits = [each for each, times in zip(exits, contacts, strict=True) if times.size]
    end = _on_wall(scene, end, hits[0]) if hits else end
    return _Segment(float(solution.t[-1]), end, motion, hits[0] if hits else None)


def _on_wall(scene: ReferenceScene, y: State, hit: Watched) -> State:
    """Return the state, moved onto the wall if the contact's gap is the only coordinate."""
    is_gap = (
        hit.force is None
        and not hit.hold
        and scene.n == 1
        and scene.gap(hit.contact, (1.0,)) == 1.0
    )
    return (hit.at, *y[1:]) if is_gap else y


def _is_undefined_ahead(
    rhs: Callable[[float, Array], State], t: float, y: Array, shortest: float
) -> bool:
    """Whether the right-hand side is not finite just ahead, so that steps became too small."""
    for step in shortest * 10.0 ** np.arange(7):
        # Two steps of Euler's method: from rest, the first one changes velocities only.
        after = y + step * np.asarray(rhs(t, y))
        slope = np.asarray(rhs(t + step, after))
        last = rhs(t + 2.0 * step, after + step * slope)
        if not (np.isfinite(slope).all() and np.isfinite(last).all()):
            return True
    return False


def _exits(scene: ReferenceScene, modes: Modes) -> list[Watched]:
    """Return all that can end the modes."""
    found = []
    for contact, mode in enumerate(modes or ()):
        if abs(mode) == HOLD:
            found += hold_ends(scene, modes or (), contact)
        else:
            found += scene.watched(contact, mode)
    return found


class _Stop:
    """Terminal event of `solve_ivp`: a zero of a function of time and state."""

    terminal = True

    def __init__(self, distance: Event, direction: float = 0.0) -> None:
        self.distance, self.direction = distance, direction

    def __call__(self, t: float, y: Sequence[float]) -> float:
        return self.distance(t, y)


def _contact_event(
    scene: ReferenceScene,
    watched: Watched,
    t_start: float,
    y_start: State,
    passed: Watched | None,
    on: Container[int],
) -> _Stop:
    """Return the event that ends a mode: a zero of the distance from a value after `t_start`."""
    contact, side, at = watched.contact, watched.side, watched.at
    at_start = scene.value(watched, t_start, y_start)
    starts_there = at_start == at
    sign = 1.0 if watched.falls else -1.0
    if watched.force is not None and passed is not None and passed.contact == contact:
        starts_there |= passed.force is not None
    elif watched.force is None and not watched.hold:
        near = _NEAR * (scene.laws[contact].gap.size + abs(at_start)) * (contact in on)
        # beyond: it has passed where the event of another contact ended the segment before
        starts_there |= sign * side * (at_start - at) <= near

    def event(t: float, y: Sequence[float]) -> float:
        if not starts_there:
            return float(side * (scene.value(watched, t, y) - at))
        beyond = side * (scene.value(watched, t, y) - at_start)
        return float(beyond / (t - t_start)) if t > t_start else sign

    return _Stop(event, direction=-sign)


def _cut_at_missed_contact(
    scene: ReferenceScene, modes: tuple[int, ...], segment: _Segment
) -> _Segment:
    """Cut a segment at the first contact between step ends that `solve_ivp` has missed, if any."""
    missed = []
    for each in _exits(scene, modes):
        value = _watched_motion(scene, segment.motion, each)
        # where another contact ends the segment, this one has perhaps passed and not yet turned
        turns = np.append(roots(value, 1, 0.0), segment.motion.x[-1])
        law = scene.laws[each.contact]
        # A touch within rounding of the wall is not a contact.
        size = max(map(abs, law.gap.distances))
        if law.losses.may_hold:  # it may be at rest on the wall
            size += np.abs(scene.directions[each.contact]) @ np.abs(segment.y[: scene.n])
        slack = 8.0 * np.finfo(float).eps * size
        slack *= law.K_c if each.force or each.hold else 1.0
        allowed = 1.0 if each.falls else -1.0
        inside = allowed * each.side * (value(turns)[:, 0] - each.at)
        inside -= min(allowed * each.side * (value(segment.motion.x[0])[0] - each.at), 0.0)
        inside[-1] += scene.atol * (not each.hold) + scene.rtol * abs(value.c[-1, :, 0]).max()
        wrong = np.flatnonzero(inside < -slack)
        if wrong.size and (segment.hit != each or turns[wrong[0]] < segment.t):
            before = turns[wrong[0] - 1] if wrong[0] else segment.motion.x[0]
            missed.append((turns[wrong[0]], before, each))
    if not missed:
        return segment
    # The earliest one, of any wall: the motion after it is wrong.
    beyond, before, hit = min(missed, key=lambda one: one[:2])
    return _cut(scene, segment, before, beyond, hit)


def _watched_motion(scene: ReferenceScene, motion: PPoly, watched: Watched) -> PPoly:
    """Return a watched quantity and its rate along a motion."""
    if watched.hold:
        return sampled(motion, watched.hold)
    gap = gap_of(scene, motion, watched.contact)
    return gap if watched.force is None else _force_motion(gap, watched.force)


def _force_motion(gap: PPoly, force: Pressure) -> PPoly:
    """Return the force of a contact and its rate along a motion, from its gap and the gap's."""
    depth, speed = gap.c[:, :, 0].copy(), gap.c[:, :, 1]
    depth[-1] -= force.rest
    values = force.stiffness * depth + force.damping * speed
    if force.chi:
        product = np.zeros((2 * len(depth) - 1, depth.shape[1]))
        for i, one in enumerate(depth):
            product[i : i + len(speed)] += force.stiffness * force.chi * one * speed
        product[-len(values) :] += values
        values = product
    rates = np.zeros_like(values)
    rates[1:] = PPoly.construct_fast(values, gap.x).derivative().c
    return PPoly.construct_fast(np.stack([values, rates], axis=-1), gap.x)


def _cut(
    scene: ReferenceScene,
    segment: _Segment,
    t_before: float,
    t_beyond: float,
    hit: Watched,
) -> _Segment:
    def distance(t: float) -> float:
        return scene.value(hit, t, segment.motion(t)) - hit.at

    straddles = distance(t_before) * distance(t_beyond) < 0.0
    t = float(brentq(distance, t_before, t_beyond, xtol=1e-15)) if straddles else t_before
    last = int(np.searchsorted(segment.motion.x, t, side="left"))
    if not last:  # at once
        start = resting(t, segment.motion(t))
        return _Segment(t, _on_wall(scene, tuple(start(t)), hit), start, hit)
    breaks = np.append(segment.motion.x[:last], t)
    motion = PPoly.construct_fast(segment.motion.c[:, : breaks.size - 1], breaks)
    return _Segment(t, _on_wall(scene, tuple(motion(t)), hit), motion, hit)
