"""Hopf points, at which the cycles of a branch shrink to an equilibrium."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root_scalar

from gapsweep.continuation import thresholds as limit
from gapsweep.continuation.identity import Identity
from gapsweep.continuation.orbits import Orbit, OrbitEquations, Reference
from gapsweep.continuation.special import Special
from gapsweep.response.equilibrium import Rates

Array = NDArray[np.float64]


def hopf_point(equations: OrbitEquations, orbit: Orbit, reference: Reference) -> Orbit | None:
    """The Hopf point near a small cycle: an equilibrium with a pair of imaginary eigenvalues.

    None where the equilibrium has no such pair within the range of the parameter.
    """
    n, size = equations.n, reference.size[0]
    state = orbit.state.copy()
    state[:n], state[n : 2 * n] = 0.5 * (orbit.x_max + orbit.x_min), 0.0
    rate = 2.0 * np.pi / orbit.period

    def growth(place: float) -> float:
        _, values = _equilibrium(equations, place, state, size)
        return float(_nearest(values, rate).real) / rate

    place = float(orbit.unknowns[-1])
    near = place + (1e-6 if place < 0.5 else -1e-6)
    found = root_scalar(growth, x0=place, x1=near, xtol=limit.HOPF_LOCATED, maxiter=30)
    if not (
        found.converged and 0.0 <= found.root <= 1.0 and abs(growth(found.root)) < limit.HOPF_RATE
    ):
        return None
    place = float(found.root)
    state, values = _equilibrium(equations, place, state, size)
    own = _nearest(values, rate)
    if not abs(own.imag / rate - 1.0) < 0.1:
        return None
    period = 2.0 * np.pi / abs(own.imag)
    unknowns = np.concatenate([state / size, [period / reference.duration[0], place]])
    multipliers = np.exp(values * period)
    # One of the pair is along the motion.
    rest = np.delete(multipliers, int(np.argmin(np.abs(values - own))))
    q = state[:n]
    gaps = equations.family.example.directions @ q if equations.n_contacts else []
    way = unknowns - orbit.unknowns
    return replace(
        orbit,
        unknowns=unknowns,
        tangent=way / np.sqrt(way @ way),
        parameters=equations.parameters(unknowns),
        period=period,
        state=state,
        multipliers=rest[np.argsort(-np.abs(rest), kind="stable")],
        x_max=q,
        x_min=q,
        turning=[(np.array([gap]), np.array([gap])) for gap in gaps],
        n_contacts=0,
        identity=Identity((state / size)[None, :], 0.0),
        special=int(Special.HOPF),
    )


def _nearest(values: NDArray[np.complex128], rate: float) -> complex:
    """The eigenvalue [1/s] nearest to i times a rate."""
    return complex(values[np.argmin(np.abs(values - 1j * rate))])


def _equilibrium(
    equations: OrbitEquations, place: float, state: Array, size: Array
) -> tuple[Array, NDArray[np.complex128]]:
    """The equilibrium near a state at a place of the parameter, and its eigenvalues [1/s]."""
    rates = Rates(equations.family.models(equations.windows, np.array([[place]])))
    y = state
    for _ in range(limit.NEWTON_STEPS):
        rate, slope = _linearised(rates, y, size)
        step = -np.linalg.lstsq(slope, rate)[0]
        y = y + step
        if np.abs(step / size).max() <= limit.CLOSED:
            break
    y = np.where(np.abs(y) > limit.ROUNDING * size, y, 0.0)
    return y, np.linalg.eigvals(_linearised(rates, y, size)[1]).astype(complex)


def _linearised(rates: Any, y: Array, size: Array) -> tuple[Array, Array]:
    """Derivative of a state by time, and its derivative by the state."""
    n = len(y)
    shifts = limit.EQUILIBRIUM_DIFFERENCE * np.diag(size)
    states = np.concatenate([y[None, :], y + shifts, y - shifts])
    found = np.asarray(rates(np.zeros(2 * n + 1, int), states.T)).T
    slope = (found[1 : n + 1] - found[n + 1 :]) / (
        2.0 * limit.EQUILIBRIUM_DIFFERENCE * size[:, None]
    )
    return found[0], slope.T
