"""How sharp tanh must be to serve a stiffness."""

import numpy as np

from gapsweep.model.contact import Tanh
from gapsweep.model.equilibria import (
    linear_stiffness,
    restoring_force,
    restoring_slope,
    search_points,
    sign_changes,
)
from gapsweep.model.oscillator import Gap, Oscillator

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

    points = search_points(Tanh(K_c, gap, predicted), x_max)  # of any sharpness and ratio

    def single(epsilon: float) -> bool:
        """Whether the force rises through zero once; where, and at which energy, is not asked."""
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
