"""Static equilibria of springs, contact and mean load, without harmonic forcing.

Only ``force`` and ``derivative`` of a law are used. The search samples the slope of
the restoring force on points that resolve smoothing layers of any width, splits the range
where the slope changes sign, and finds the one root that each monotone piece can hold.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray

from gapsweep.model.contact import ContactLaw
from gapsweep.model.laws.fitted import Fitted
from gapsweep.model.oscillator import Oscillator

Array = NDArray[np.float64]

# Points in half the range: ten to each half-wave of a polynomial of the highest degree.
_N_COARSE = 1001
# Distances from a wall [m]: from far below any smoothing layer, 40 per decade.
_FINEST = 1e-13
_N_PER_DECADE = 40
# Poles closer to the real axis than this share of the range need additional points.
_NEAR_POLE = 0.02
# Roots are located to the last digits of a double, also those next to zero.
_X_TOL, _R_TOL = 1e-20, 1e-15
_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(5)


@dataclass(frozen=True, slots=True)
class Equilibria:
    """Static equilibria in ascending order."""

    x: Array  # shape (n,); positions [m]
    # Shape (n,); whether the restoring force rises through zero: a minimum of the potential.
    stable: NDArray[np.bool_]
    # Shape (n,); potential energy of springs, contact and mean load [J], zero at ``x = 0``.
    energy: Array

    @property
    def barrier(self) -> Array:
        """Energy [J] needed to leave each well; NaN at maxima and for unbounded wells."""
        neighbours = np.full((2, self.x.size), np.inf)
        neighbours[0, 1:] = self.energy[:-1]
        neighbours[1, :-1] = self.energy[1:]
        lowest = np.min(neighbours, axis=0, initial=np.inf)
        return np.where(self.stable & np.isfinite(lowest), lowest - self.energy, np.nan)


def restoring_force(oscillator: Oscillator, law: ContactLaw, x: ArrayLike) -> Array:
    """Force of springs and contact less the mean load [N]: ``k x + α x³ + F_c(x) - p_0``."""
    x = np.asarray(x, dtype=float)
    springs = x * (linear_stiffness(oscillator) + oscillator.alpha * x**2)
    return np.asarray(springs + law.force(x) - oscillator.mean_load)


def restoring_slope(oscillator: Oscillator, law: ContactLaw, x: ArrayLike) -> Array:
    """Derivative of `restoring_force` [N/m]."""
    x = np.asarray(x, dtype=float)
    springs = linear_stiffness(oscillator) + 3.0 * oscillator.alpha * x**2
    return np.asarray(springs + law.derivative(x))


def linear_stiffness(oscillator: Oscillator) -> float:
    """Stiffness k of the linear spring [N/m]."""
    return oscillator.mass * oscillator.omega_n_rad**2


def equilibria(oscillator: Oscillator, law: ContactLaw, x_max: float) -> Equilibria:
    """All static equilibria with ``|x| < x_max`` [m].

    A root at which the restoring force touches zero without crossing it is found only if it
    falls on a sampled point, and counts as unstable. A pole is no root. A law of the user
    is resolved to about ``x_max/600``, and finely near its walls.
    """
    points = search_points(law, x_max)
    turns, _ = sign_changes(lambda x: restoring_slope(oscillator, law, x), points)
    points = np.union1d(points, turns)
    x, direction = sign_changes(lambda x: restoring_force(oscillator, law, x), points)
    return Equilibria(x, direction > 0.0, _potential(oscillator, law, x, points))


def search_points(law: ContactLaw, x_max: float) -> Array:
    """Displacements [m] in ``±x_max`` that resolve all features of a law, ascending.

    Dense near the ends, where a polynomial oscillates, and graded towards the walls, to resolve
    smoothing layers; zero, the walls and near poles are among them.
    """
    half = x_max * np.sin(np.linspace(0.0, 0.5 * np.pi, _N_COARSE))
    n = round(_N_PER_DECADE * np.log10(2.0 * x_max / _FINEST))
    steps = np.geomspace(_FINEST, 2.0 * x_max, max(n, 2))
    offsets = np.concatenate([-steps, [0.0], steps])
    centres = np.array([-law.gap.j_1, law.gap.j_2, *_near_poles(law)])
    points = np.concatenate([half, -half, np.add.outer(centres, offsets).ravel()])
    return np.unique(points[np.abs(points) <= x_max])


def sign_changes(function: Callable[[Array], Array], points: Array) -> tuple[Array, Array]:
    """Zeros of a function between ascending points, and the direction of each crossing.

    Returns
    -------
    zeros, direction : ndarray, shape (n,)
        Direction 1: rising, -1: falling, 0: touching. Excluded are zeros outside the first and the
        last point at which the function is not zero, poles, and zeros next to which the function
        is not finite.
    """
    from scipy.optimize import brentq  # slow to import, and most responses need no equilibria

    values = function(points)
    sign = np.where(np.isfinite(values), np.sign(values), np.nan)
    here = np.flatnonzero(sign != 0.0)
    left, right = here[:-1], here[1:]
    jump = sign[right] - sign[left]
    is_zero = np.isfinite(jump) & ((jump != 0.0) | (right > left + 1))
    found = []
    for i, k in zip(left[is_zero].tolist(), right[is_zero].tolist(), strict=True):
        if k > i + 1:
            x = points[(i + k) // 2]
        else:
            x = brentq(function, points[i], points[k], xtol=_X_TOL, rtol=_R_TOL, maxiter=500)
        if abs(function(x)) <= max(abs(values[i]), abs(values[k])):
            found.append((x, (sign[k] - sign[i]) / 2.0))
    zeros, direction = np.reshape(found, (-1, 2)).T
    return zeros, direction


def panels(points: Array) -> tuple[Array, Array]:
    """Gauss–Legendre nodes and weights, shape (panel, node), between ascending points."""
    centre, half = 0.5 * (points[1:] + points[:-1]), 0.5 * np.diff(points)
    return centre[:, None] + half[:, None] * _GAUSS_NODES, half[:, None] * _GAUSS_WEIGHTS


def _near_poles(law: ContactLaw) -> list[float]:
    """Real parts [m] of the poles of a rational fit that are close to the real axis."""
    if not isinstance(law, Fitted):
        return []
    roots = chebyshev.chebroots(chebyshev.chebtrim(law.coefficients[1], tol=1e-14))
    near = np.abs(roots.imag) < _NEAR_POLE
    return [float(x) for x in roots.real[near] * law.fit_range]


def _potential(oscillator: Oscillator, law: ContactLaw, x: Array, points: Array) -> Array:
    if not x.size:
        return x
    points = np.union1d(points, np.append(x, 0.0))
    nodes, weights = panels(points)
    work = np.sum(law.force(nodes) * weights, axis=1)
    # Summed outwards from zero: the energies near it are small, and the barriers there too.
    origin = int(np.searchsorted(points, 0.0))
    left, right = -np.cumsum(work[:origin][::-1])[::-1], np.cumsum(work[origin:])
    contact = np.concatenate([left, [0.0], right])[np.searchsorted(points, x)]
    springs = 0.5 * linear_stiffness(oscillator) * x**2 + 0.25 * oscillator.alpha * x**4
    return np.asarray(springs + contact - oscillator.mean_load * x)
