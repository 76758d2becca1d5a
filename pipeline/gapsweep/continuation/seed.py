"""First orbits of branches: orbits near attractors that motions have settled on."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gapsweep.continuation.newton import Corrector
from gapsweep.continuation.orbits import Orbit, OrbitEquations, Reference, motions, swing
from gapsweep.continuation.thresholds import OFF_TURNING

Array = NDArray[np.float64]


@dataclass(slots=True, kw_only=True)
class Attractor:
    """A known periodic orbit, from which a branch can be followed.

    Its section are states, shape (n, n_states), at whole forcing periods, or at maxima of the first
    coordinate.
    """

    value: float  # of the parameter
    section: Array
    period: float  # [s]; NaN where the forcing sets it
    multiple: int
    x_max: float = math.nan  # peak of the first coordinate [m]
    branch: int = -1  # that it lies on; -1: none


def seeds(
    equations: OrbitEquations, attractors: Sequence[Attractor]
) -> list[tuple[Orbit, Reference, Attractor]]:
    """Orbits of attractors at their parameter values, of those that Newton's method finds.

    Attractors get the sections of their orbits, and the shortest period after which these repeat:
    of settled motions both are known to the tolerance of another solver.
    """
    found = _orbits(equations, attractors)
    is_prime = True
    for orbit, _, attractor in found:
        k, prime = len(orbit.identity.section), orbit.identity.prime
        if prime < k:
            is_prime = False
            attractor.multiple = max(attractor.multiple * prime // k, 1)
            attractor.period *= prime / k
    if not is_prime:
        found = _orbits(equations, [attractor for *_, attractor in found])
    for orbit, reference, attractor in found:
        attractor.section = orbit.identity.section * reference.size
    return found


def _orbits(
    equations: OrbitEquations, attractors: Sequence[Attractor]
) -> list[tuple[Orbit, Reference, Attractor]]:
    """Orbits of attractors by Newton's method, with the sizes of their states."""
    if not attractors:
        return []
    values, states = np.array([[each.value] for each in attractors]), None
    if equations.has_period:
        models = equations.family.models(equations.windows, equations.windows[0].place(values))
        begin = np.array([each.section[0] for each in attractors])
        times = OFF_TURNING * np.array([each.period for each in attractors])
        states = motions(models, equations.solver, begin, times, np.inf).state
    unknowns, reference = started(equations, attractors, values, states)
    direction = np.zeros_like(unknowns)
    direction[:, 0 if equations.family.is_conservative else -1] = 1.0
    furthest = np.full(len(attractors), 0.5)
    orbits, _ = Corrector(equations).orbits(unknowns, direction, reference, furthest)
    return [
        (orbit, reference.take([k]), attractors[k])
        for k, orbit in enumerate(orbits)
        if orbit is not None
    ]


def started(
    equations: OrbitEquations,
    attractors: Sequence[Attractor],
    values: Array,
    states: Array | None = None,
) -> tuple[Array, Reference]:
    """Unknowns near attractors at values of the parameters, with the sizes of their states.

    Orbits begin at the first points of the sections, or at other states.
    """
    n = len(attractors)
    states = np.array([each.section[0] for each in attractors]) if states is None else states
    windows = equations.windows
    places = np.stack([w.place(values[:, k]) for k, w in enumerate(windows)], axis=1)
    models = equations.family.models(windows, places)
    period, rate = np.ones(n), 2.0 * np.pi * models.omega
    if equations.has_period:
        period = np.array([each.period for each in attractors])
        rate = 2.0 * np.pi / period
    size = np.empty_like(states)
    for i, each in enumerate(attractors):
        unit = np.asarray(models.systems[models.system[i]].unit(rate[i]), float)
        size[i] = unit * swing(np.concatenate([states[i : i + 1], each.section]) / unit)
    reference = Reference(
        size=size,
        duration=period,
        multiple=np.array([each.multiple for each in attractors]),
        y=states,
        rate=np.zeros_like(states),
    )
    unknowns = equations.unknowns(states, period, values, reference)
    if equations.has_period:
        reference.rate = equations.rates(states, unknowns)
    return unknowns, reference
