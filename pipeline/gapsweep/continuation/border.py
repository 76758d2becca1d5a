"""Border collisions: grazes at which the monodromy matrix jumps.

A contact that never pulls has the damping c at its entry, at any speed, and none at its exit. A
graze of it hence adds a factor S to the tangent, and the monodromy matrix of an orbit that grazes
at the time t has two values [1]_::

    Φ(T, t) Φ(t, 0)        without the contact
    Φ(T, t) S Φ(t, 0)      with it,    S = [[I, 0], [-c M⁻¹ b b', I]]

Both are those of the grazing orbit, not of orbits near it: their multipliers differ from these by
the root of the depth.

.. [1] M. di Bernardo, C. J. Budd, A. R. Champneys, P. Kowalczyk, Piecewise-smooth Dynamical
   Systems, Springer 2008, chapters 2 and 7.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gapsweep.continuation.orbits import Orbit, OrbitEquations, Reference
from gapsweep.continuation.special import Special, beyond, on_wall, walls
from gapsweep.continuation.thresholds import CLEAR_OF_WALL, OFF_TURNING
from gapsweep.integrate.motions import Events
from gapsweep.integrate.problem import Problems
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
    is_outer: bool  # whether the orbit comes from the gap, not from beyond the wall


def both_sides(equations: OrbitEquations, orbit: Orbit, reference: Reference) -> list[Orbit]:
    """Return a grazing orbit without and with the contact, the latter as a special point.

    The orbits differ in multipliers and numbers of contacts. Empty where nothing jumps.
    """
    if not any(law.losses.never_pulls for law in equations.models_at(orbit).laws[0]):
        return []
    integrate, n = prepared(equations.models_at(orbit), equations.solver), equations.n
    begin = OFF_TURNING * orbit.period  # the orbit may turn where it starts
    state = integrate(_pieces(orbit.state, np.array([0.0, begin]))).state[0]
    end = begin + orbit.period
    events = integrate(_pieces(state, np.array([begin, end]))).events()
    touched = _touched(equations, orbit, events)
    if not touched:
        return []
    times = [touch.t for touch in touched]
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


def _touched(equations: OrbitEquations, orbit: Orbit, events: Events) -> list[_Touch]:
    """Turning points on walls that never pull, in order of time."""
    models, n, found = equations.models_at(orbit), equations.n, []
    system = models.systems[0]
    for contact, law in enumerate(models.laws[0]):
        near, b = on_wall(orbit, contact), np.reshape(system.directions[contact], -1)
        jump = np.eye(equations.n_states)
        push = np.linalg.solve(np.atleast_2d(system.mass), b)
        jump[n : 2 * n, :n] -= law.losses.damping * np.outer(push, b)
        for side, wall in walls(equations, orbit, contact).items():
            if wall is None or not law.losses.never_pulls:
                continue
            is_outer = bool((np.abs(beyond(orbit, contact, side, wall)[0]) <= near).any())
            clear = CLEAR_OF_WALL * near * (-1.0 if is_outer else 1.0)
            off = side * (events.extrema - wall)
            is_there = (events.extrema_of == equations.first_gap + contact) & (np.abs(off) <= near)
            found += [
                _Touch(t, x, clear, side * b, jump, is_outer)
                for t, x in zip(events.t_extrema[is_there].tolist(), off[is_there], strict=True)
            ]
    return sorted(found, key=lambda touch: touch.t)


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
