"""First orbits of branches that leave another one, or that another one ends on."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gapsweep.continuation.orbits import Orbit, OrbitEquations, Reference
from gapsweep.continuation.special import Special
from gapsweep.continuation.thresholds import UNLIKE

Array = NDArray[np.float64]


def with_direction(equations: OrbitEquations, orbit: Orbit, reference: Reference) -> Orbit:
    """A period doubling with the direction of the branch of twice the period.

    It is the null vector of M + I; the parameter is stationary.
    """
    n, size, d = equations.n_states, reference.size[0], len(orbit.unknowns)
    matrix = orbit.monodromy * size[None, :] / size[:, None] + np.eye(n)
    if equations.has_period:
        normal = equations.reference_at(reference, orbit).rate[0] / size
        matrix = np.vstack([matrix, normal / np.sqrt(normal @ normal)])
    across = np.zeros(d)
    across[:n] = np.linalg.svd(matrix)[2][-1]
    return replace(orbit, across=across)


def switched(
    equations: OrbitEquations, orbit: Orbit, reference: Reference
) -> tuple[Orbit, Reference] | None:
    """The first orbit of the branch across another one, and what it is computed with.

    At a period doubling or a border flip its period is twice that of the orbit, or half of an orbit
    that is twice one of half the period.
    """
    assert orbit.across is not None
    reference = equations.reference_at(reference, orbit)
    is_doubling = orbit.special in (Special.PERIOD_DOUBLING, Special.BORDER_FLIP)
    ratio = 1.0 if not is_doubling else 0.5 if orbit.identity.halves <= UNLIKE else 2.0
    unknowns, tangent, across = (x.copy() for x in (orbit.unknowns, orbit.across, orbit.tangent))
    reference.multiple = (ratio * reference.multiple).astype(np.int64)
    if equations.has_period:
        for vector in (unknowns, tangent, across):
            vector[equations.n_states] *= ratio
    first = equations.orbit(unknowns, tangent / np.sqrt(tangent @ tangent), reference)
    if first is None:
        return None
    across = across / np.sqrt(across @ across)
    return replace(first, across=across, special=orbit.special), reference
