"""Errors of a contact law: integrals over the range, which resolve every smoothing layer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gapsweep.model.contact import FIT_RANGE, ContactLaw, Tanh, checked_law
from gapsweep.model.equilibria import (
    linear_stiffness,
    panels,
    restoring_force,
    restoring_slope,
    search_points,
    sign_changes,
)
from gapsweep.model.oscillator import Gap, Oscillator, called_as

Array = NDArray[np.float64]


def in_gap(gap: Gap, x_max: float) -> tuple[float, float]:
    """The part of the gap that lies in ``±x_max`` [m]."""
    return -min(gap.j_1, x_max), min(gap.j_2, x_max)


def largest_in_gap(law: ContactLaw, x_max: float) -> float:
    """Largest magnitude of the force between the walls [N]; zero for the exact law."""
    low, high = in_gap(law.gap, x_max)
    points = search_points(law, x_max)
    points = points[(points >= low) & (points <= high)]
    peaks, _ = sign_changes(law.derivative, points)
    return float(np.max(np.abs(law.force(np.append(points, peaks)))))


@called_as("gs.static_error(law)")
def static_error(law: ContactLaw, fit_range: float = FIT_RANGE) -> tuple[float, float]:
    """RMSE [N] and R² [-] of any law against the exact force, integrated over ``±fit_range`` [m].

    Examples
    --------
    >>> import gapsweep as gs
    >>> law = gs.contact_law("tanh-1e4", 1.4e4, gs.Gap(0.4e-3, 0.4e-3))
    >>> rmse, r_squared = gs.static_error(law)
    >>> r_squared > 0.99
    True
    """
    _, weights, exact, error = _sampled(checked_law(law), fit_range)
    residual, length = (error**2 * weights).sum(), weights.sum()
    spread = ((exact - (exact * weights).sum() / length) ** 2 * weights).sum()
    # A gap wider than the range leaves nothing to explain: any exact zero is a perfect fit.
    r_squared = 1.0 - residual / spread if spread > 0.0 else residual == 0.0
    return float(np.sqrt(residual / length)), float(r_squared)


def error_of_parts(law: ContactLaw, x_max: float) -> tuple[float, float]:
    """RMSE [N] in the gap and in the rest of ``±x_max`` [m]; NaN for a part that does not exist."""
    nodes, weights, _, error = _sampled(law, x_max)
    low, high = in_gap(law.gap, x_max)
    # No panel extends over a wall: the walls are search points.
    inside = (nodes[:, 2] > low) & (nodes[:, 2] < high)
    squares, lengths = (error**2 * weights).sum(axis=1), weights.sum(axis=1)
    within, rest = (
        float(np.sqrt(squares[part].sum() / lengths[part].sum())) if part.any() else np.nan
        for part in (inside, ~inside)
    )
    return within, rest


def _sampled(law: ContactLaw, x_max: float) -> tuple[Array, Array, Array, Array]:
    """Nodes [m] of a quadrature, their weights [m], the exact force and the error there [N]."""
    nodes, weights = panels(search_points(law, x_max))
    exact = law.exact.force(nodes)
    return nodes, weights, exact, law.force(nodes) - exact


# Largest z(1 - tanh z)/2, in closed form W(1/e)/2 with Lambert's W.
TANH_LOBE = 0.13923227138


def predicted_threshold(
    oscillator: Oscillator, K_c: float, gap: Gap, K_ratio: float = 1.0
) -> float:
    """Convergence parameter [1/m] at which springs outweigh the inward lobe of tanh.

    Between the walls, tanh pulls the mass towards the nearer wall with up to 0.139 of the wall's
    stiffness over ε; the springs hold it back with ``k j + α j³``. Meant for layers much
    thinner than the gap; NaN if no wall has a distance to the origin, or a mean load acts.
    """
    if oscillator.mean_load:
        return float("nan")
    walls = [(K, j) for K, j in ((K_ratio * K_c, gap.j_1), (K_c, gap.j_2)) if j > 0.0]
    springs = [linear_stiffness(oscillator) * j + oscillator.alpha * j**3 for _, j in walls]
    if not min(springs, default=0.0) > 0.0:
        return float("nan")
    return max(TANH_LOBE * K / spring for (K, _), spring in zip(walls, springs, strict=True))


def tanh_threshold(
    oscillator: Oscillator, K_c: float, gap: Gap, x_max: float, K_ratio: float = 1.0
) -> float:
    """Convergence parameter [1/m] above which tanh has one static well, by bisection.

    Sought within a factor of 8 of `predicted_threshold`; NaN if the wells do not change there.
    """
    predicted = predicted_threshold(oscillator, K_c, gap, K_ratio)
    if not predicted > 0.0:
        return float("nan")

    points = search_points(Tanh(K_c, gap, predicted), x_max)  # the same for any sharpness and ratio

    def single(epsilon: float) -> bool:
        """Whether the restoring force has one rising zero, that is, one stable equilibrium."""
        law = Tanh(K_c, gap, epsilon, K_ratio=K_ratio)
        turns, _ = sign_changes(lambda x: restoring_slope(oscillator, law, x), points)
        sign = np.sign(restoring_force(oscillator, law, np.union1d(points, turns)))
        return int(np.sum(np.diff(sign[sign != 0.0]) > 0.0)) == 1

    high, steps = 8.0 * predicted, np.geomspace(4.0, 0.125, 11) * predicted
    for low in steps.tolist():
        if not single(low):
            break
        high = low
    else:
        return float("nan")
    while high > low * (1.0 + 1e-6):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if single(middle) else (middle, high)
    return high
