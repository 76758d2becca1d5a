"""First orbits of branches: orbits near attractors that motions have settled on."""

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
    """A periodic orbit that is known: a start for a branch.

    Attributes
    ----------
    value : float
        Of the parameter.
    section : ndarray, shape (n, n_states)
        States on it at whole forcing periods, or at maxima of the first coordinate.
    period : float
        [s]; NaN where the forcing sets it.
    multiple : int
    branch : int
        Which branch it lies on; -1: none.
    """

    value: float
    section: Array
    period: float
    multiple: int
    branch: int = -1


def seeds(
    equations: OrbitEquations, attractors: Sequence[Attractor]
) -> tuple[list[Orbit], Reference, list[Attractor]]:
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
    orbits = [orbit for orbit, *_ in found]
    reference = Reference.joined([each for _, each, _ in found]) if found else _EMPTY
    return orbits, reference, [attractor for *_, attractor in found]


_EMPTY = Reference(
    size=np.empty((0, 0)),
    duration=np.empty(0),
    multiple=np.empty(0, np.int64),
    y=np.empty((0, 0)),
    rate=np.empty((0, 0)),
)


def _orbits(
    equations: OrbitEquations, attractors: Sequence[Attractor]
) -> list[tuple[Orbit, Reference, Attractor]]:
    """Orbits of attractors by Newton's method, with the sizes of their states."""
    n = len(attractors)
    if not n:
        return []
    states = np.array([each.section[0] for each in attractors])
    values = np.array([[each.value] for each in attractors])
    period = np.array([each.period for each in attractors])
    places = np.asarray(equations.windows[0].place(values))
    models = equations.family.models(equations.windows, places)
    multiple = np.array([each.multiple for each in attractors])
    if equations.has_period:
        later = motions(models, equations.solver, states, OFF_TURNING * period, np.inf)
        states, rate = np.asarray(later.state), 2.0 * np.pi / period
    else:
        period, rate = np.ones(n), 2.0 * np.pi * models.omega
    size = np.empty_like(states)
    for i in range(n):
        unit = np.asarray(models.systems[models.system[i]].unit(rate[i]), float)
        sections = np.concatenate([states[i : i + 1], attractors[i].section])
        size[i] = unit * swing(sections / unit)
    reference = Reference(
        size=size, duration=period, multiple=multiple, y=states, rate=np.zeros_like(states)
    )
    unknowns = equations.unknowns(states, period, values, reference)
    if equations.has_period:
        reference.rate = equations.rates(states, unknowns)
    direction = np.zeros_like(unknowns)
    direction[:, 0 if equations.family.is_conservative else -1] = 1.0
    orbits, _ = Corrector(equations).orbits(unknowns, direction, reference, np.full(n, 0.5))
    return [
        (orbit, reference.take([k]), attractors[k])
        for k, orbit in enumerate(orbits)
        if orbit is not None
    ]
