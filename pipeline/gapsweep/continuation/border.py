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

    (Φ(T, 0) - I) y + φ_a a = κ u Φ(T, t) (0, β),   κ = 1 + e
    g_y y + g_a a = 0                         the turning point stays on the wall

A wall with a preload N₀ acts as such an impact. With the acceleration -r back from the wall, the
body returns with -u, after the time 2 u / (r + N₀ b'M⁻¹b) instead of 2 u / r::

    κ = 2 N₀ b'M⁻¹b / (r + N₀ b'M⁻¹b)

A graze from beyond the wall has the same κ, towards the side from which the orbit comes. The depth
is u² / 2 r of the motion without the contact: at a weak preload it is large at a short distance.

.. [1] M. di Bernardo, C. J. Budd, A. R. Champneys, P. Kowalczyk, Piecewise-smooth Dynamical
   Systems, Springer 2008, chapters 2 and 7.
.. [2] A. B. Nordmark, J. Sound Vib. 145 (1991) 279-297.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

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
    off: float  # distance past an orbit that is clear of the wall [m]
    past: Array  # direction of the contact, from the orbit's side of the wall to the other side
    jump: Array  # S
    kick: Array  # change of the state by a rigid wall or a preload, over the speed at the wall
    back: float  # acceleration away from the wall [m/s²]
    is_outer: bool  # whether the orbit comes from the gap, not from beyond the wall


@dataclass(frozen=True, slots=True)
class _Graze:
    """A graze of a rigid wall or a preload, with directions in the space of unknowns."""

    orbit: Orbit
    towards: Array  # tangent of the branch without the impact, towards the graze
    past: Array  # of the branch with the impact, away from the graze
    deep: Array  # change by which turning points are as deep as past the graze, at the distance 1
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
        slopes.append(touch.past @ flow[:n])
    aside = np.linalg.lstsq(np.array(slopes), [-touch.off for touch in touched])[0]
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

    Walls that never pull, rigid walls and those with a preload have such grazes.
    """
    begin = limit.OFF_TURNING * orbit.period  # the orbit may turn where it starts
    state = integrate(_pieces(orbit.state, np.array([0.0, begin]))).state[0]
    events = integrate(_pieces(state, np.array([begin, begin + orbit.period]))).events()
    models, n, found = equations.models_at(orbit), equations.n, []
    system = models.systems[0]
    for contact, law in enumerate(models.laws[0]):
        losses = law.losses
        if not (losses.never_pulls or losses.may_hold):
            continue
        near, b = on_wall(orbit, contact), np.reshape(system.directions[contact], -1)
        push = np.linalg.solve(np.atleast_2d(system.mass), b)
        jump = np.eye(equations.n_states)
        jump[n : 2 * n, :n] -= losses.damping * np.outer(push, b)
        for side, wall in walls(equations, orbit, contact).items():
            if wall is None:
                continue
            is_outer = bool((np.abs(beyond(orbit, contact, side, wall)[0]) <= near).any())
            past = side if is_outer else -side
            off = past * (events.extrema - wall)
            is_there = (events.extrema_of == equations.first_gap + contact) & (np.abs(off) <= near)
            if losses.may_hold:  # impacts are on the wall
                is_there &= off < -limit.IMPACT * near / limit.ON_WALL
            off += limit.CLEAR_OF_WALL * near
            for t, x in zip(events.t_extrema[is_there].tolist(), off[is_there], strict=True):
                earlier = np.array([begin, t - limit.EARLIER * orbit.period])
                speed = past * b @ integrate(_pieces(state, earlier)).state[0, n : 2 * n]
                back = float(speed) / (limit.EARLIER * orbit.period)
                share = losses.preload / (losses.preload + back / (b @ push))
                ratio = 1.0 + losses.restitution if losses.is_rigid else 2.0 * share
                kick = np.zeros(equations.n_states)
                kick[n : 2 * n] = -past * ratio * push / (b @ push)
                found.append(_Touch(t, x, past * b, jump, kick, back, is_outer))
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


def sharp_graze(
    corrector: Corrector,
    orbits: Sequence[Orbit],
    found: Orbit | None,
    step: float,
    reference: Reference,
) -> list[Orbit]:
    """Return the graze of a rigid wall or a preload that a branch passes in a step, and the orbit
    past it.

    `found` is the orbit at the end of the step, None where none is found. The tangent of the
    grazing orbit is that of the branch past it. Empty where no graze is passed.
    """
    equations, last = corrector.equations, orbits[-1]
    if last.special == Special.GRAZING or not any(equations.may_hold):
        return []
    (n, gap), before = _clearance(equations, last), orbits[-2] if len(orbits) > 1 else None
    if found is not None:
        change, far = _clearance(equations, found)[0] - n, step
        is_entry, is_exit = change > 0, change < 0
    else:  # no orbit: where the gap, or the reciprocal of the largest multiplier, would be zero
        if before is None or _clearance(equations, before)[0] != n:
            return []
        apart = float(np.sqrt(((last.unknowns - before.unknowns) ** 2).sum()))
        with np.errstate(divide="ignore", invalid="ignore"):  # multipliers are 0 after a hold
            spectral = [1.0 / np.abs(each.multipliers[0]) for each in (before, last)]
        far = _zero(spectral[0], spectral[1], apart)
        is_exit = n > 0 and spectral[1] < limit.STRONG and 0.0 < far <= 2.0 * step
        is_entry = 0.0 < _zero(_clearance(equations, before)[1], gap, apart) <= 2.0 * step
    for free in _without_impact(corrector, last, n, far, reference) if is_exit else ():
        for graze in _grazes(corrector, free, reference):
            way = graze.orbit.unknowns - last.unknowns
            is_near = float(np.sqrt(way @ way)) <= 3.0 * far
            if is_near and -graze.past @ last.tangent > np.cos(limit.TURN):
                return [replace(graze.orbit, tangent=-graze.towards)]
    for graze in _grazes(corrector, last, reference) if is_entry else ():
        if past := _with_impact(corrector, graze, reference):
            return past
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
        ahead = last.tangent.copy()  # the body is where it comes from or goes to at another speed
        off = float(outward @ (ahead[:n] * size[:n])) * (1.0 + ratio) / (outward @ push)
        ahead[:n] -= off * push / size[:n]
        slow = ahead.copy()
        slow[n : 2 * n] = 0.0  # the changes of its speed on either side may be unlike
        ways = np.concatenate([np.outer(limit.BEHIND, way) for way in (slow, ahead)])
        found, _ = corrector.orbits(
            guess + ways,
            np.tile(along, (len(ways), 1)),
            reference.take(np.zeros(len(ways), int)),
            np.full(len(ways), limit.LARGEST),
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

    The walls are those of the chosen contacts, by default the rigid ones and those with a preload.
    The distance is negative, as a share of the largest displacement. A turning point beyond a wall
    that points back to it is measured on that side; on the wall it joins two contacts.
    """
    n, nearest = 0, -np.inf
    for contact, side, wall in _walls_of(
        equations, orbit, equations.may_hold if chosen is None else chosen
    ):
        outer, inner = beyond(orbit, contact, side, wall)
        off = np.append(outer, -inner) * limit.ON_WALL / on_wall(orbit, contact)
        n += int((off > -limit.IMPACT).sum()) - len(inner)
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
        np.repeat(limit.ASIDE_SHARP * distances, 2 * len(ways)),
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
    scale = max(1.0, float(np.sqrt(graze.deep @ graze.deep)))  # weak: deep at short distances
    distances = np.repeat(limit.PAST_SHARP, len(depths)) / scale
    aside = graze.deep + np.outer(np.tile(depths, len(limit.PAST_SHARP)), graze.deeper)
    found, _ = corrector.orbits(
        graze.orbit.unknowns + np.outer(distances, graze.past) + distances[:, None] ** 2 * aside,
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
    s = -max(-0.01 * value, limit.BEFORE_SHARP)
    for _ in range(2 * limit.NEWTON_STEPS):
        if not abs(s) < 1.0:  # no turning point is left that could touch the wall
            return None
        (found,), _ = corrector.orbits(
            (orbit.unknowns + s * orbit.tangent)[None, :], orbit.tangent[None, :], reference,
            np.array([abs(s) + limit.BEFORE_SHARP]),
        )  # fmt: skip
        now = (n + 1, 0.0) if found is None else _clearance(equations, found, chosen)
        if found is None or now[0] != n:
            s *= 0.5
            continue
        along = float((found.unknowns - orbit.unknowns) @ found.tangent)
        slope = (now[1] - value) / along
        orbit, value = found, now[1]
        if abs(np.log(-value / limit.BEFORE_SHARP)) < 1.0:
            break
        s = (-limit.BEFORE_SHARP - value) / slope
    else:
        return None
    tangent = orbit.tangent * np.sign(slope)
    across = np.eye(len(tangent))[-1]
    graze, ahead = orbit, 0.0
    for nearer in (100.0, 1.0):
        ahead += (-nearer * limit.CLEAR_OF_WALL * limit.ON_WALL - value) / abs(slope)
        (found,), _ = corrector.orbits(
            (orbit.unknowns + ahead * tangent)[None, :], across[None, :], reference,
            np.array([limit.BEFORE_SHARP]),
        )  # fmt: skip
        now = (n + 1, 0.0) if found is None else _clearance(equations, found, chosen)
        if found is None or now[0] != n or now[1] < -limit.ON_WALL:
            return None
        graze, value = found, now[1]
    return graze, tangent, abs(slope)


def _grazes(corrector: Corrector, free: Orbit, reference: Reference) -> list[_Graze]:
    """The graze of a branch without the contact, with the directions of branches past it.

    Where the orbit touches several walls at once, or one twice in its period, they may pass all or
    some of them and leave the others; the branch that passes all is the first one.
    """
    equations = corrector.equations
    located = _located(corrector, free, reference, equations.may_hold)
    if located is None:
        return []
    graze, tangent, slope = located
    touched, pieces = _flow(equations, graze)
    n, states, m = equations.n, equations.n_states, len(touched)
    size = _largest(graze)
    # Changes of the state and of the turning points by the initial state and by the speeds.
    change, turned = np.eye(states, states + m), np.zeros((m, states + m))
    for k, touch in enumerate(touched):
        change = pieces[k] @ change
        turned[k] = touch.past @ change[:n] / size
        change[:, states + k] += touch.kick
    change = pieces[m] @ change
    try:
        start = np.linalg.solve(np.eye(states) - change[:, :states], change[:, states:])
    except np.linalg.LinAlgError:
        return []
    steepest = turned[:, :states] * reference.size[0]
    turned = np.column_stack([turned[:, :states] @ start + turned[:, states:], np.full(m, slope)])
    back = np.array([touch.back for touch in touched])
    orbit, found = replace(graze, special=int(Special.GRAZING), branching=0.0), []
    subsets = ([*some] for k in range(m, 0, -1) for some in combinations(range(m), k))
    for some in subsets:
        others = np.delete(np.arange(m), some)
        null = np.linalg.svd(turned[some][:, [*some, m]])[2][-1]
        speeds = np.zeros(m + 1)
        speeds[[*some, m]] = null * np.sign(null[0])
        if (speeds[some] > 0.0).all() and (turned[others] @ speeds < 0.0).all():
            past = speeds[m] * tangent
            past[:states] += start @ speeds[:m] / reference.size[0]
            deep, deeper, way = np.zeros_like(past), np.zeros_like(past), steepest[some[0]]
            depths = speeds[some] ** 2 / (2.0 * back[some] * size * (past @ past))
            deep[:states] = np.linalg.lstsq(steepest[some], depths)[0]
            deeper[:states] = way / (way @ way)
            found.append(_Graze(orbit, tangent, past / np.sqrt(past @ past), deep, deeper))
    return found


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
    along = touched[0].past @ pieces[0][: equations.n] * size / _largest(graze)
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
