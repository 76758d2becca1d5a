"""What a law needs to serve a stiffness: polynomial degree, sharpness of tanh."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gapsweep.model.contact import Tanh
from gapsweep.model.equilibria import equilibria, linear_stiffness
from gapsweep.model.oscillator import Gap, Oscillator

Array = NDArray[np.float64]

# Largest share of the forcing that a law may exert between the walls.
LEAK = 0.1
# Largest z(1 - tanh z)/2, in closed form W(1/e)/2 with Lambert's W.
TANH_LOBE = 0.13923227138


def smallest_degree(
    in_gap_force: Array, degrees: Sequence[int], forcing: float
) -> NDArray[np.intp]:
    """First of the degrees (last axis) whose force [N] is below `LEAK` of the forcing, or 0."""
    enough = in_gap_force < LEAK * abs(forcing)
    return np.where(enough.any(axis=-1), np.array(degrees)[enough.argmax(axis=-1)], 0)


def predicted_threshold(oscillator: Oscillator, K_c: float, gap: Gap) -> float:
    """Convergence parameter [1/m] at which springs outweigh the inward lobe of tanh.

    Between the walls, tanh pulls the mass towards the nearer wall with up to
    ``0.139 K_c/ε``; the springs hold it back with ``k j + α j³``. Meant for layers much
    thinner than the gap; NaN if no wall has a distance to the origin.
    """
    distances = [j for j in (gap.j_1, gap.j_2) if j > 0.0]
    springs = [linear_stiffness(oscillator) * j + oscillator.alpha * j**3 for j in distances]
    weakest = min(springs, default=0.0)
    return TANH_LOBE * K_c / weakest if weakest > 0.0 else float("nan")


def tanh_threshold(oscillator: Oscillator, K_c: float, gap: Gap, x_max: float) -> float:
    """Convergence parameter [1/m] above which tanh has one static well, by bisection.

    Sought within a factor of 8 of `predicted_threshold`; NaN if the wells do not change there.
    """
    predicted = predicted_threshold(oscillator, K_c, gap)
    if not predicted > 0.0:
        return float("nan")

    def single(epsilon: float) -> bool:
        law = Tanh(K_c, gap, epsilon)
        return int(equilibria(oscillator, law, x_max).stable.sum()) == 1

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
