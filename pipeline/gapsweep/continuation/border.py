"""Border collisions: grazes at which the monodromy matrix jumps.

A contact that never pulls has the damping c at its entry, at any speed, and none at its exit. A
graze of it hence adds a factor S to the tangent, and the monodromy matrix of an orbit that grazes
at the time t has two values [1]_::

    Φ(T, t) Φ(t, 0)        without the contact
    Φ(T, t) S Φ(t, 0)      with it,    S = [[I, 0], [-c M⁻¹ b b', I]]

Both are those of the grazing orbit, not of orbits near it: their multipliers differ from these by
the root of the depth.

A graze of a rigid wall has Φ without the contact only. Past it the wall reverses a small speed u,
which changes the end of the motion by ``-(1 + e) u Φ(T, t) (0, β)``, β = M⁻¹b / b'M⁻¹b, and the
multipliers grow as 1/u [2]_. State y and parameter a of orbits with the impact are linear in u::

    (Φ(T, 0) - I) y + φ_a a = (1 + e) u Φ(T, t) (0, β)
    g_y y + g_a a = 0                         the turning point stays on the wall

.. [1] M. di Bernardo, C. J. Budd, A. R. Champneys, P. Kowalczyk, Piecewise-smooth Dynamical
   Systems, Springer 2008, chapters 2 and 7.
.. [2] A. B. Nordmark, J. Sound Vib. 145 (1991) 279-297.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gapsweep.continuation import thresholds as limit
from gapsweep.continuation.newton import Corrector
from gapsweep.continuation.orbits import Orbit, OrbitEquations, Reference
from gapsweep.continuation.special import Special, beyond, on_wall, walls
from gapsweep.integrate.problem import Integrate, Problems
from gapsweep.integrate.simulate import prepared

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Touch:
    """A turning point of a gap on a wall."""

    t: float  # [s]
    off: float  # distance beyond the wall [m]
    clear: float  # the same of an orbit without the contact
    outward: Array  # direction of the contact, towards the wall
    jump: Array  # S
    kick: Array  # change of the state by an impact on the rigid wall, over its speed
    is_outer: bool  # whether the orbit comes from the gap, not from beyond the wall


@dataclass(frozen=True, slots=True)
class _Graze:
    """A graze of a rigid wall, with directions in the space of unknowns."""

    orbit: Orbit
    towards: Array  # tangent of the branch without the impact, towards the graze
    past: Array  # of the branch with the impact, away from the graze
    deeper: Array  # change by which the turning point moves by the largest displacement


def both_sides(equations: OrbitEquations, orbit: Orbit, reference: Reference) -> list[Orbit]:
    """Return a grazing orbit without and with the contact, the latter as a special point.

    The orbits differ in multipliers and numbers of contacts. Empty where nothing jumps.
    """
    if not any(law.losses.never_pulls for law in equations.models_at(orbit).laws[0]):
        return []
    integrate, n = prepared(equations.models_at(orbit), equations.solver), equations.n
    begin, state, touched = _touched(equations, orbit, integrate)
    if not touched:
        return []
    times, end = [touch.t for touch in touched], begin + orbit.period
    until = integrate(_pieces(state, np.array([begin, *times]))).monodromy
    assert until is not None
    slopes, flow = [], np.eye(equations.n_states)
    for touch, piece in zip(touched, until, strict=True):
        flow = piece @ flow
        slopes.append(touch.outward @ flow[:n])
    aside = np.linalg.lstsq(np.array(slopes), [touch.clear - touch.off for touch in touched])[0]
    pieces = integrate(_pieces(state + aside, np.array([begin, *times, end])))
    assert pieces.monodromy is not None
    without = with_contact = pieces.monodromy[0]
    for touch, piece in zip(touched, pieces.monodromy[1:], strict=True):
        without, with_contact = piece @ without, piece @ touch.jump @ with_contact
    unknowns, states = (np.tile(x, (2, 1)) for x in (orbit.unknowns, state))
    multipliers = equations.multipliers(
        np.array([without, with_contact]),
        unknowns,
        reference.take([0, 0]),
        equations.rates(states, unknowns) if equations.has_period else states,
        np.full(2, orbit.period),
        np.full(2, pieces.contact_loss.sum()),
    )
    n_contacts = int(pieces.n_contacts.sum())
    n_more = 2 * sum(touch.is_outer for touch in touched)  # beyond the wall the force acts anyway
    kind = _kind(*multipliers)
    return [
        replace(orbit, multipliers=multipliers[0], n_contacts=n_contacts),
        replace(
            orbit, multipliers=multipliers[1], n_contacts=n_contacts + n_more, special=int(kind)
        ),
    ]


def _touched(
    equations: OrbitEquations, orbit: Orbit, integrate: Integrate
) -> tuple[float, Array, list[_Touch]]:
    """A time of an orbit [s], its state then, and its grazes in the period from there on.

    Walls that never pull and rigid walls have such grazes.
    """
    begin = limit.OFF_TURNING * orbit.period  # the orbit may turn where it starts
    state = integrate(_pieces(orbit.state, np.array([0.0, begin]))).state[0]
    events = integrate(_pieces(state, np.array([begin, begin + orbit.period]))).events()
    models, n, found = equations.models_at(orbit), equations.n, []
    system = models.systems[0]
    for contact, law in enumerate(models.laws[0]):
        losses = law.losses
        if losses.preload or not (losses.never_pulls or losses.is_rigid):
            continue  # at a preload S grows as 1 / u
        near, b = on_wall(orbit, contact), np.reshape(system.directions[contact], -1)
        jump, kick = np.eye(equations.n_states), np.zeros(equations.n_states)
        push = np.linalg.solve(np.atleast_2d(system.mass), b)
        jump[n : 2 * n, :n] -= losses.damping * np.outer(push, b)
        kick[n : 2 * n] = -(1.0 + losses.restitution) * push / (b @ push)
        for side, wall in walls(equations, orbit, contact).items():
            if wall is None:
                continue
            is_outer = bool((np.abs(beyond(orbit, contact, side, wall)[0]) <= near).any())
            clear = limit.CLEAR_OF_WALL * near * (-1.0 if is_outer else 1.0)
            off = side * (events.extrema - wall)
            is_there = (events.extrema_of == equations.first_gap + contact) & (np.abs(off) <= near)
            if losses.is_rigid:  # impacts are on the wall
                is_there &= off < -limit.IMPACT * near / limit.ON_WALL
            found += [
                _Touch(t, x, clear, side * b, jump, side * kick, is_outer)
                for t, x in zip(events.t_extrema[is_there].tolist(), off[is_there], strict=True)
            ]
    return begin, state, sorted(found, key=lambda touch: touch.t)


def _pieces(state: Array, times: Array) -> Problems:
    """A motion from a state in pieces between times [s]."""
    n = len(times) - 1
    return Problems(
        which=np.zeros(n, np.intp),
        start=np.tile(state, (n, 1)),
        t_0=times[:-1],
        t_end=times[1:],
        record_from=times[:-1],
        follows=np.arange(n) > 0,
        tangent=True,
    )


def _kind(without: Array, with_contact: Array) -> Special:
    """Kind of a graze: products of ``1 ∓ μ`` change signs with numbers of real μ beyond ±1."""
    for kind, at in ((Special.BORDER_FOLD, 1.0), (Special.BORDER_FLIP, -1.0)):
        if np.prod(at - without).real * np.prod(at - with_contact).real < 0.0:
            return kind
    return Special.GRAZING


def rigid_graze(
    corrector: Corrector,
    orbits: Sequence[Orbit],
    found: Orbit | None,
    step: float,
    reference: Reference,
) -> list[Orbit]:
    """Return the graze of a rigid wall that a branch passes in a step, and the orbit past it.

    `found` is the orbit at the end of the step, None where none is found. The tangent of the
    grazing orbit is that of the branch past it. Empty where no graze is passed.
    """
    equations, last = corrector.equations, orbits[-1]
    if last.special == Special.GRAZING or not any(equations.is_rigid):
        return []
    (n, gap), before = _clearance(equations, last), orbits[-2] if len(orbits) > 1 else None
    if found is not None:
        change = _clearance(equations, found)[0] - n
        is_entry, far = change > 0, step
    else:  # no orbit: where the gap, or the reciprocal of the largest multiplier, would be zero
        if before is None or _clearance(equations, before)[0] != n:
            return []
        apart = float(np.sqrt(((last.unknowns - before.unknowns) ** 2).sum()))
        with np.errstate(divide="ignore", invalid="ignore"):  # multipliers are 0 after a hold
            spectral = [1.0 / np.abs(each.multipliers[0]) for each in (before, last)]
        is_entry = 0.0 < _zero(_clearance(equations, before)[1], gap, apart) <= 2.0 * step
        is_exit = n > 0 and spectral[1] < limit.STRONG
        far = _zero(spectral[0], spectral[1], apart)
        change = int(is_entry) or -int(is_exit and 0.0 < far <= 2.0 * step)
    if not change:
        return []
    if is_entry:
        graze = _graze(
            equations, _located(corrector, last, reference, equations.is_rigid), reference
        )
        return [] if graze is None else _with_impact(corrector, graze, reference)
    for free in _without_impact(corrector, last, n, far, reference):
        graze = _graze(
            equations, _located(corrector, free, reference, equations.is_rigid), reference
        )
        if graze is not None:
            way = graze.orbit.unknowns - last.unknowns
            is_near = float(np.sqrt(way @ way)) <= 3.0 * far
            if is_near and -graze.past @ last.tangent > np.cos(limit.TURN):
                return [replace(graze.orbit, tangent=-graze.towards)]
    return []


def behind_start(corrector: Corrector, last: Orbit, reference: Reference) -> Orbit | None:
    """Return the next orbit of a branch where an impact, or a wall at which the force jumps, passes
    the phase at which orbits start.

    The branch has a kink there. The initial state at a rigid wall changes from that before the
    impact to that after it, or back.
    """
    equations, guess = corrector.equations, last.unknowns.copy()
    model, n, size = equations.models_at(last), equations.n, reference.size[0]
    for contact, side, wall in _walls_of(equations, last, equations.has_jump):
        outward = side * np.reshape(model.systems[0].directions[contact], -1)
        near = on_wall(last, contact) * limit.NEAR_EDGE / limit.ON_WALL
        speed, losses = float(outward @ last.state[n : 2 * n]), model.laws[0][contact].losses
        e = losses.restitution
        if abs(outward @ last.state[:n] - side * wall) > near or not (speed > 0.0 or e):
            continue
        push = np.linalg.solve(np.atleast_2d(model.systems[0].mass), outward)
        ratio = -1.0 if not losses.is_rigid else e if speed > 0.0 else 1.0 / e
        guess[n : 2 * n] -= speed * (1.0 + ratio) / (outward @ push) * push / size[n : 2 * n]
        along = np.copysign(1.0, last.tangent[-1]) * np.eye(len(guess))[-1]
        ahead = abs(last.tangent[-1]) * along
        ahead[:n] = last.tangent[:n]  # the body is where it comes from or goes to at another speed
        off = float(outward @ (last.tangent[:n] * size[:n])) * (1.0 + ratio) / (outward @ push)
        ahead[:n] -= off * push / size[:n]
        distances = np.array(limit.BEHIND)
        found, _ = corrector.orbits(
            guess + np.outer(distances, ahead),
            np.tile(along, (len(distances), 1)),
            reference.take(np.zeros(len(distances), int)),
            np.full(len(distances), limit.LARGEST),
        )
        for orbit in found:
            if orbit is not None and orbit.n_contacts == last.n_contacts:
                return orbit
    return None


def _zero(before: float, last: float, apart: float) -> float:
    """Distance from the last of two points to the zero of the line through both."""
    return last * apart / (before - last) if before != last else np.inf


def _walls_of(
    equations: OrbitEquations, orbit: Orbit, chosen: Sequence[bool]
) -> Iterator[tuple[int, int, float]]:
    """Contact, side and place of every wall of the chosen contacts."""
    for contact, is_chosen in enumerate(chosen):
        if is_chosen:
            for side, wall in walls(equations, orbit, contact).items():
                if wall is not None:
                    yield contact, side, wall


def _clearance(
    equations: OrbitEquations, orbit: Orbit, chosen: Sequence[bool] | None = None
) -> tuple[int, float]:
    """Number of contacts, and the largest distance of another turning point beyond a wall.

    The walls are those of the chosen contacts, by default the rigid ones. The distance is negative,
    as a share of the largest displacement.
    """
    n, nearest = 0, -np.inf
    for contact, side, wall in _walls_of(
        equations, orbit, equations.is_rigid if chosen is None else chosen
    ):
        off = beyond(orbit, contact, side, wall)[0] * limit.ON_WALL / on_wall(orbit, contact)
        n += int((off > -limit.IMPACT).sum())
        nearest = max(nearest, float(off[off <= -limit.IMPACT].max(initial=-np.inf)))
    return n, nearest


def _without_impact(
    corrector: Corrector, last: Orbit, n: int, far: float, reference: Reference
) -> list[Orbit]:
    """Orbits with fewer impacts than n near a graze at a distance ahead of an orbit."""
    d = len(last.unknowns)
    axes = np.eye(d)
    ways = np.concatenate([np.zeros((1, d)), axes[:-1], -axes[:-1]])
    distances = far * np.array([1.0, 10.0, 100.0])
    guesses = np.array(
        [h * (way + a * axes[-1]) for h in distances for a in (1, -1) for way in ways]
    )
    found, _ = corrector.orbits(
        last.unknowns + far * last.tangent + guesses,
        np.tile(axes[-1], (len(guesses), 1)),
        reference.take(np.zeros(len(guesses), int)),
        np.repeat(limit.ASIDE_RIGID * distances, 2 * len(ways)),
    )
    free = [o for o in found if o is not None and _clearance(corrector.equations, o)[0] < n]
    return sorted(free, key=lambda o: float(((o.unknowns - last.unknowns) ** 2).sum()))[:4]


def _with_impact(corrector: Corrector, graze: _Graze, reference: Reference) -> list[Orbit]:
    """A graze, and the orbit past it from which on the branch is followed.

    Newton's method needs a guess with the depth of the orbit, which has the order of the square of
    the distance: many are tried. Between both the largest multiplier has no value near the unit
    circle.
    """
    depths = np.append(0.0, np.outer([1.0, -1.0], 10.0 ** np.arange(-4.0, 1.5, 0.5)))
    distances = np.repeat(limit.PAST_RIGID, len(depths))
    aside = np.outer(distances**2 * np.tile(depths, len(limit.PAST_RIGID)), graze.deeper)
    found, _ = corrector.orbits(
        graze.orbit.unknowns + np.outer(distances, graze.past) + aside,
        np.tile(graze.past, (len(distances), 1)),
        reference.take(np.zeros(len(distances), int)),
        distances,
    )
    n = _clearance(corrector.equations, graze.orbit)[0]
    for orbit in found:
        if (
            orbit is not None
            and _clearance(corrector.equations, orbit)[0] > n
            and np.abs(orbit.multipliers[0]) > 1.0 / limit.STRONG
            and orbit.tangent @ graze.past > np.cos(limit.TURN)
        ):
            return [replace(graze.orbit, tangent=graze.past), orbit]
    return []


def _located(
    corrector: Corrector, orbit: Orbit, reference: Reference, chosen: Sequence[bool]
) -> tuple[Orbit, Array, float] | None:
    """The graze of a branch of orbits without the contact, its tangent there and the slope of the
    distance from the wall along it.

    Differences by the parameter must not pass the wall: the tangent is that of an orbit before it.
    """
    equations = corrector.equations
    n, value = _clearance(equations, orbit, chosen)
    s = -max(-0.01 * value, limit.BEFORE_RIGID)
    for _ in range(2 * limit.NEWTON_STEPS):
        if not abs(s) < 1.0:  # no turning point is left that could touch the wall
            return None
        (found,), _ = corrector.orbits(
            (orbit.unknowns + s * orbit.tangent)[None, :], orbit.tangent[None, :], reference,
            np.array([abs(s) + limit.BEFORE_RIGID]),
        )  # fmt: skip
        now = (n + 1, 0.0) if found is None else _clearance(equations, found, chosen)
        if found is None or now[0] != n:
            s *= 0.5
            continue
        along = float((found.unknowns - orbit.unknowns) @ found.tangent)
        slope = (now[1] - value) / along
        orbit, value = found, now[1]
        if abs(np.log(-value / limit.BEFORE_RIGID)) < 1.0:
            break
        s = (-limit.BEFORE_RIGID - value) / slope
    else:
        return None
    tangent = orbit.tangent * np.sign(slope)
    across = np.eye(len(tangent))[-1]
    graze, ahead = orbit, 0.0
    for nearer in (100.0, 1.0):
        ahead += (-nearer * limit.CLEAR_OF_WALL * limit.ON_WALL - value) / abs(slope)
        (found,), _ = corrector.orbits(
            (orbit.unknowns + ahead * tangent)[None, :], across[None, :], reference,
            np.array([limit.BEFORE_RIGID]),
        )  # fmt: skip
        now = (n + 1, 0.0) if found is None else _clearance(equations, found, chosen)
        if found is None or now[0] != n or now[1] < -limit.ON_WALL:
            return None
        graze, value = found, now[1]
    return graze, tangent, abs(slope)


def _graze(
    equations: OrbitEquations, located: tuple[Orbit, Array, float] | None, reference: Reference
) -> _Graze | None:
    """A graze with its directions; None if no branch has impacts on all walls that it touches."""
    if located is None:
        return None
    graze, tangent, slope = located
    touched, pieces = _flow(equations, graze)
    n, states, m = equations.n, equations.n_states, len(touched)
    size = _largest(graze)
    # Changes of the state and of the turning points by the initial state and by the speeds.
    change, turned = np.eye(states, states + m), np.zeros((m, states + m))
    for k, touch in enumerate(touched):
        change = pieces[k] @ change
        turned[k] = touch.outward @ change[:n] / size
        change[:, states + k] += touch.kick
    change = pieces[m] @ change
    try:
        start = np.linalg.solve(np.eye(states) - change[:, :states], change[:, states:])
    except np.linalg.LinAlgError:
        return None
    steepest = turned[0, :states] * reference.size[0]
    turned = turned[:, :states] @ start + turned[:, states:]
    *speeds, along = np.linalg.svd(np.column_stack([turned, np.full(m, slope)]))[2][-1]
    if not (np.all(np.array(speeds) > 0.0) or np.all(np.array(speeds) < 0.0)):
        return None
    past = along * tangent
    past[:states] += start @ speeds / reference.size[0]
    deeper = np.zeros_like(tangent)
    deeper[:states] = steepest / (steepest @ steepest)
    return _Graze(
        replace(graze, special=int(Special.GRAZING), branching=0.0),
        tangent,
        past * np.sign(speeds[0]) / np.sqrt(past @ past),
        deeper,
    )


def _flow(equations: OrbitEquations, graze: Orbit) -> tuple[list[_Touch], Array]:
    """Grazes of an orbit in order of phase, and the tangents of the motion between them."""
    integrate = prepared(equations.models_at(graze), equations.solver)
    *_, touched = _touched(equations, graze, integrate)
    touched = sorted(touched, key=lambda touch: touch.t % graze.period)
    times = [touch.t % graze.period for touch in touched]
    pieces = integrate(_pieces(graze.state, np.array([0.0, *times, graze.period]))).monodromy
    assert pieces is not None
    return touched, pieces


def _largest(orbit: Orbit) -> float:
    """Largest displacement of a contact [m]."""
    return max(on_wall(orbit, contact) for contact in range(len(orbit.turning))) / limit.ON_WALL


def doubled(corrector: Corrector, free: Orbit, reference: Reference) -> Array | None:
    """Direction of the branch of twice the period that begins at a border flip; None without one.

    Near the graze, states z relative to the orbit without the contact move by ``z' = A z``, with
    the contact by ``z' = A z - k (G z + γ)``, γ the distance of that orbit beyond the wall. Points
    of the orbit of two periods lie on either side: ``z = (I - B A)⁻¹ (-k γ)``, B = A - k G.
    """
    equations = corrector.equations
    located = _located(corrector, free, reference, equations.never_pulls)
    if located is None:
        return None
    graze, tangent, slope = located
    touched, pieces = _flow(equations, graze)
    if len(touched) != 1:
        return None
    states, size = equations.n_states, reference.size[0]
    scale = size[None, :] / size[:, None]
    along = touched[0].outward @ pieces[0][: equations.n] * size / _largest(graze)
    without = pieces[1] @ pieces[0] * scale
    jump = without - pieces[1] @ touched[0].jump @ pieces[0] * scale
    push = jump @ along / (along @ along)
    first = -np.linalg.solve(np.eye(states) - (without - jump) @ without, push)
    off = np.array([along @ first, along @ without @ first]) + 1.0  # of both points, for γ = 1
    if off[0] * off[1] >= 0.0:
        return None
    side = float(np.sign(off[1]))  # of γ, so that the first point has no contact
    across = side * tangent / slope
    across[:states] += side * first
    return np.asarray(across / np.sqrt(across @ across))
